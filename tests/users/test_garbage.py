"""Arguments of another kind than is needed are refused in words, or do no harm."""

import webbrowser
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from garbage import garbage, long_verbs, refusal, verbs

import spatial_pin as sp

EACH = 18  # of the pairs of an argument and a piece of garbage, one in so many is tried


@pytest.mark.filterwarnings("ignore::spatial_pin.SpatialPinWarning")
@pytest.mark.parametrize("first", [0, pytest.param(9, marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", [verbs, long_verbs])
def test_what_nobody_means_is_refused_in_words(
    kind: Callable[[Path], Any], first: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", "")  # no browser is found
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(webbrowser, "open", lambda *args, **given: True)
    pieces = garbage()
    names = list(pieces)
    found, k = [], 0
    for label, verb, good in kind(tmp_path):
        for key in good:
            k += 1
            for name in names[(k + first) % EACH :: EACH]:
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


def test_switches_numbers_and_names_are_distinguished() -> None:
    mechanism = sp.load("four_bar")
    with pytest.raises(TypeError, match="assemble: limits must be True or False, not 'no'"):
        sp.assemble(mechanism, {"crank": 0.4}, limits="no")  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="sweep: driver must be a name, not 3"):
        sp.sweep(mechanism, 3, [0.3])  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="trace: step must be a number, not 'small'"):
        sp.trace(mechanism, "crank", step="small")  # type: ignore[arg-type]


def test_one_name_is_as_good_as_a_tuple_of_one() -> None:
    state = sp.assemble(sp.load("four_bar"))
    assert sp.Look(traces="coupler", arrows="coupler.velocity").traces == ("coupler",)
    assert sp.Look(arrows=["coupler.velocity"], ghosts=[state]).arrows == ("coupler.velocity",)
    with pytest.raises(TypeError, match="Look: ghosts: a State or Motion is needed, not int"):
        sp.Look(ghosts=(3,))
    with pytest.raises(TypeError, match="Look: axes must be True or False, not 'no'"):
        sp.Look(axes="no")


def test_a_function_that_says_nothing_stops_nothing() -> None:
    mechanism = sp.load("four_bar")
    state = sp.assemble(mechanism, {"crank": 0.4})
    for value in (None, "late", float("nan"), [1.0, 2.0]):
        with pytest.raises(ValueError, match="what stop_when returns at 0 s"):
            sp.simulate(mechanism, state, 0.01, stop_when=lambda t, s, x=value: x)
    sp.simulate(mechanism, state, 0.01, times=[0.01], stop_when=lambda t, s: s.q[:1] - 9.0)


def test_a_title_that_no_file_can_hold_is_refused(tmp_path: Path) -> None:
    motion = sp.sweep(sp.load("four_bar"), "crank", [0.3, 0.4])
    for verb, given in ((sp.export_html, {}), (sp.report, {}), (sp.plot, {"outputs": "crank"})):
        with pytest.raises(ValueError, match=r"title is .*no file can be written with"):
            verb(motion, path=tmp_path / "a.svg", title="\ud800", **given)
