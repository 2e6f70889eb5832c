"""Arguments of another kind than is needed are refused in words, or do no harm."""

from pathlib import Path

import pytest
from garbage import garbage, refusal, verbs

import spatial_pin as sp

EACH = 9  # of the pairs of an argument and a piece of garbage, one in so many is tried


@pytest.mark.filterwarnings("ignore::spatial_pin.SpatialPinWarning")
def test_what_nobody_means_is_refused_in_words(tmp_path: Path) -> None:
    pieces = garbage()
    names = list(pieces)
    found, k = [], 0
    for label, verb, good in verbs(tmp_path):
        for key in good:
            k += 1
            for name in names[k % EACH :: EACH]:
                try:
                    verb(**{**good, key: pieces[name]()})
                except Exception as error:
                    where = refusal(error)
                    if where:
                        found.append(f"{label}({key}={name}): {where}")
    assert not found


@pytest.mark.parametrize(("given", "words"), [
    ("rssr", r"a Mechanism is needed, not 'rssr' of type str: sp\.load"),
    (None, r"a Mechanism is needed, not NoneType"),
])
def test_what_is_needed_is_named_with_the_way_to_it(given: object, words: str) -> None:
    with pytest.raises(TypeError, match=rf"mobility: mechanism: {words}"):
        sp.mobility(given)  # type: ignore[arg-type]


def test_switches_numbers_and_names_are_told_apart() -> None:
    mechanism = sp.load("four_bar")
    with pytest.raises(TypeError, match="assemble: limits must be True or False, not 'no'"):
        sp.assemble(mechanism, {"crank": 0.4}, limits="no")  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="sweep: driver must be a name, not 3"):
        sp.sweep(mechanism, 3, [0.3])  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="trace: step must be a number, not 'small'"):
        sp.trace(mechanism, "crank", step="small")  # type: ignore[arg-type]
