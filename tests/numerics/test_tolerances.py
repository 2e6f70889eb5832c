"""One object of tolerances, the same in Python and in C."""

import ast
import inspect
import re
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

import pytest

import spatial_pin as sp
from spatial_pin.numerics.tolerances import EPS, TOLERANCES, Tolerances

PACKAGE = Path(sp.__file__).parent
KERNEL = PACKAGE / "kernel"


def test_the_compiled_kernel_has_the_same_numbers():
    header = (KERNEL / "core" / "tolerances.h").read_text(encoding="utf-8")
    found = dict(re.findall(r"#define TOLERANCE_(\w+) (\S+)", header))
    assert found
    assert {n.lower(): float(x) for n, x in found.items()}.items() <= asdict(TOLERANCES).items()


def test_every_tolerance_says_why_it_has_its_value():
    for name in asdict(TOLERANCES):
        assert f"\n    {name}: " in inspect.cleandoc(Tolerances.__doc__), name


def is_number(node: ast.AST) -> bool:
    """Whether an expression is made of numbers, the tolerances and machine epsilon alone."""
    if isinstance(node, ast.Constant):
        return isinstance(node.value, int | float) and not isinstance(node.value, bool)
    if isinstance(node, ast.UnaryOp):
        return is_number(node.operand)
    if isinstance(node, ast.BinOp):
        return is_number(node.left) and is_number(node.right)
    return isinstance(node, ast.Name) and node.id == "EPS"


def python_constants() -> Iterator[tuple[Path, int, str, float]]:
    """Yield the numbers that modules name: file, line from 0, name, value."""
    for path in sorted(PACKAGE.rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        if not re.search(r"(?m)^[A-Z_0-9]+ = ", text):
            continue
        for node in ast.parse(text).body:
            if isinstance(node, ast.Assign) and is_number(node.value):
                target = node.targets[0]
                if isinstance(target, ast.Name) and target.id.isupper():
                    value = eval(ast.unparse(node.value), {"EPS": EPS})
                    yield path, node.lineno - 1, target.id, float(value)
            for name, value in constants_of_a_tuple(node):
                yield path, node.lineno - 1, name, value


def constants_of_a_tuple(node: ast.AST) -> Iterator[tuple[str, float]]:
    """Yield name and value of the numbers that one line names together: A, B = 1.0, 2.0."""
    if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Tuple) and isinstance(
            node.value, ast.Tuple):
        for target, value in zip(node.targets[0].elts, node.value.elts, strict=True):
            if isinstance(target, ast.Name) and target.id.isupper() and is_number(value):
                yield target.id, float(eval(ast.unparse(value), {"EPS": EPS}))


def c_constants() -> Iterator[tuple[Path, int, str, float]]:
    """Yield the same of the kernel's macros, but for those of one object in both languages."""
    for path in sorted(KERNEL.rglob("*.[ch]")):
        for i, line in enumerate(path.read_text(encoding="utf-8").splitlines()):
            found = re.match(r"#define (\w+) (\(?[-+0-9.][^/]*)", line)
            if found and path.name != "tolerances.h" and found[1] not in ("EPS", "PI"):
                value = eval(found[2].strip(), {"DBL_EPSILON": EPS, "EPS": EPS})
                yield path, i, found[1], float(value)


@pytest.fixture(scope="module")
def constants() -> list[tuple[Path, int, str, float]]:
    return [*python_constants(), *c_constants()]


def test_every_constant_says_why_it_has_its_value(constants):
    silent = []
    for path, at, name, _ in constants:
        lines = path.read_text(encoding="utf-8").splitlines()
        beside = re.search(r"#.*\w|/\*.*\w", re.sub(r"^#define", "", lines[at]))
        above = lines[at - 1].startswith("# ") or lines[at - 1].rstrip().endswith("*/")
        if not (beside or above):
            silent.append(f"{path.name}:{at + 1}: {name}")
    assert constants and not silent


def test_no_name_has_two_values(constants):
    values: dict[str, dict[float, list[str]]] = {}
    for path, at, name, value in constants:
        values.setdefault(name, {}).setdefault(value, []).append(f"{path.name}:{at + 1}")
    assert not {name: places for name, places in values.items() if len(places) > 1}
