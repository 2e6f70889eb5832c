"""How far two sets of golden numbers are from each other."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from golden_numbers.answer import NUMBER, Answer, Array, Golden, Numbers

MARGIN = 10.0  # by which promised errors exceed estimated ones, as in `scripts/accuracy_table.py`
NOISE = 1e-10  # errors in a sentence that are as good as none
TELL = 60  # letters of a sentence around what has changed


class Difference(NamedTuple):
    """How far one quantity is from what it was.

    Attributes:
        mechanism, verb, name: which.
        size: largest difference relative to the quantity's own scale; infinite where it is another
            thing altogether. The row with the largest excess.
        allowed: the tolerance, or more where the library states so.
        by: what states it.
        text: the old and the new one.
    """

    mechanism: str
    verb: str
    name: str
    size: float
    allowed: float
    by: str
    text: str

    @property
    def excess(self) -> float:
        """The difference relative to the allowed one."""
        return self.size / self.allowed

    @property
    def is_beyond(self) -> bool:
        """Whether it is more than is allowed."""
        return self.size > self.allowed

    def __str__(self) -> str:
        stated = f", by {self.by}" if self.by else ""
        return (f"{self.mechanism:22}{self.verb:12}{self.size:8.1e} (allowed {self.allowed:.1e}"
                f"{stated}) {self.name}: {self.text}")


def compare(old: Golden, new: Golden, tolerance: float) -> list[Difference]:
    """Return the differences of common answers, the largest relative to the allowed one first."""
    differences = []
    for key in old.keys() & new.keys():
        differences += _of_answers(key, old[key], new[key], tolerance)
    return sorted(differences, key=lambda d: (-d.excess, d[:3]))


def _of_answers(
    key: tuple[str, str], old: Answer, new: Answer, tolerance: float
) -> list[Difference]:
    differences = []
    for name in sorted(old.keys() | new.keys()):
        a, b = old.get(name), new.get(name)
        if a is None or b is None:
            here = b if a is None else a
            kind = here if isinstance(here, str) else "numbers"
            words = "is new" if a is None else "is missing"
            difference = np.inf, tolerance, "", f"{words}: {kind[:2 * TELL]}"
        elif isinstance(a, str) or isinstance(b, str):
            difference = _of_texts(a, b, tolerance)
        else:
            difference = _of_numbers(a, b, tolerance)
        if difference is not None:
            differences.append(Difference(*key, name, *difference))
    return differences


def _of_numbers(
    old: Numbers, new: Numbers, tolerance: float
) -> tuple[float, float, str, str] | None:
    if old.values.shape != new.values.shape:
        return (np.inf, tolerance, "",
                f"has shape {new.values.shape}, had {old.values.shape}")
    if np.array_equal(old.values, new.values, equal_nan=True):
        return None
    size = _relative(old, new)
    known = old.known if old.at_most else MARGIN * np.maximum(old.known, new.known)
    allowed = np.maximum(tolerance, np.broadcast_to(known, size.shape))
    worst = np.unravel_index(np.argmax(size / allowed), size.shape)
    at = f" at {tuple(map(int, worst))}" if worst else ""
    by = old.by if allowed[worst] > tolerance else ""
    text = f"{old.values[worst]:.17g} -> {new.values[worst]:.17g}{at}"
    return float(size[worst]), float(allowed[worst]), by, text


def _relative(old: Numbers, new: Numbers) -> Array:
    """Return differences relative to the quantity's scale; infinite where one is no number."""
    with np.errstate(invalid="ignore"):
        gap = new.values - old.values if old.at_most else np.abs(new.values - old.values)
        # errors: as large as allowed is no difference
        gap = np.where(old.at_most & (gap <= 0.0), 0.0, gap)
        size = gap / np.maximum(np.broadcast_to(old.scale, gap.shape), 1e-300)
    same = (old.values == new.values) | (np.isnan(old.values) & np.isnan(new.values))
    return np.where(same, 0.0, np.where(np.isfinite(size), size, np.inf))


def _of_texts(
    old: Numbers | str, new: Numbers | str, tolerance: float
) -> tuple[float, float, str, str] | None:
    """Sentences are equal but for the last digit of numbers, and for noise."""
    if old == new:
        return None
    if not isinstance(old, str) or not isinstance(new, str):
        one = old if isinstance(old, str) else new
        return np.inf, tolerance, "", f"numbers where there was a sentence, or back: {one}"
    words = [NUMBER.split(text) for text in (old, new)]
    values = [NUMBER.findall(text) for text in (old, new)]
    if words[0] == words[1] and all(map(_reads_alike, *values)):
        return None
    first = next((k for k, (a, b) in enumerate(zip(old, new, strict=False)) if a != b),
                 min(len(old), len(new)))
    begin = max(first - TELL // 2, 0)
    return (np.inf, tolerance, "",
            f"{old[begin:begin + TELL]!r} -> {new[begin:begin + TELL]!r}")


def _reads_alike(old: str, new: str) -> bool:
    return abs(float(old) - float(new)) <= max(_last_digit(old), _last_digit(new), NOISE)


def _last_digit(text: str) -> float:
    """Return the unit of the last digit of a number as written; 0 of a whole number."""
    mantissa, _, exponent = text.lower().partition("e")
    places = len(mantissa.partition(".")[2])
    if not places and not exponent:
        return 0.0
    return 1.01 * 10.0 ** (int(exponent or 0) - places)
