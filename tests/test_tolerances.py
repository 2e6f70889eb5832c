"""One object of tolerances, the same in Python and in C."""

import re
from dataclasses import asdict
from pathlib import Path

import spatial_pin as sp
from spatial_pin.numerics.tolerances import TOLERANCES, Tolerances

KERNEL = Path(sp.__file__).parent / "kernel"


def test_the_compiled_kernel_has_the_same_numbers():
    header = (KERNEL / "core" / "tolerances.h").read_text(encoding="utf-8")
    found = dict(re.findall(r"#define TOLERANCE_(\w+) (\S+)", header))
    assert found
    assert {n.lower(): float(x) for n, x in found.items()}.items() <= asdict(TOLERANCES).items()


def test_every_tolerance_says_why_it_has_its_value():
    for name in asdict(TOLERANCES):
        assert f"\n        {name}: " in f"\n{Tolerances.__doc__}", name
