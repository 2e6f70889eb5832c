"""Inside the command line: units, lines that fit, kinds of names, remedies in its own words."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import spatial_pin as sp
from spatial_pin.cli.completion import CALLED, KINDS, NAMED, kind_of
from spatial_pin.cli.printing import fitted, in_options
from spatial_pin.cli.running import parser
from spatial_pin.cli.tables import read_table
from spatial_pin.units import quantity
from spatial_pin.workspace.grid_axes import PARTS

PACKAGE = Path(sp.__file__).parent
RPM_240 = 8 * np.pi


# ---------------------------------------------------------------- units


@pytest.mark.parametrize(("text", "value"), [
    ("60deg", np.pi / 3), ("-60°", -np.pi / 3), ("0.5turn", np.pi), ("240rpm", RPM_240),
    ("12mm", 0.012), ("3.5cm", 0.035), ("1in", 0.0254), ("2.5", 2.5), ("+.5 m", 0.5),
    ("1e-3", 1e-3), ("1E3um", 1e-3), (" 90 deg ", np.pi / 2), ("-90deg/s", -np.pi / 2),
    ("3000rpm/s", 100 * np.pi), ("20mm/s2", 0.02), ("-0", 0.0), ("7rad", 7.0),
])
def test_a_quantity_is_a_number_with_a_unit(text, value):
    assert quantity(text) == pytest.approx(value, rel=1e-15, abs=0)


@pytest.mark.parametrize("text", [
    "", "deg", "sixty", "60 degrees", "nan", "inf", "-inf", "1e999", "1,5", "0x10", "1_000", "--5",
    "5m m", "5MM", "5%",
])
def test_what_is_no_quantity_is_refused_with_the_units_there_are(text):
    with pytest.raises(ValueError, match=r"deg|finite"):
        quantity(text)


# ---------------------------------------------------------------- words and lines


def test_a_broken_line_goes_on_below_its_last_column():
    line = "  coupler_pin  " + "word " * 20
    first, *rest = fitted(line.rstrip()).splitlines()
    assert first.startswith("  coupler_pin  word") and len(rest) == 1
    assert rest[0].startswith(" " * 15 + "word")
    assert fitted("wrote " + "x" * 100).splitlines()[-1].endswith("x" * 100)


def test_every_argument_that_names_something_says_what():
    options = parser().parse_args(["list"]).parsers
    actions = [action for sub in options.values() for action in sub._actions]
    kinds = {kind_of(action).removesuffix("=") for action in actions} - {""}
    assert kinds == set(KINDS)
    assert {*CALLED, *NAMED} <= {x for action in actions for x in (action.metavar, action.dest)}
    unknown = {action.dest for action in actions if not kind_of(action)
               and re.match("NAME|DRIVER|JOINT|LINK|FRAME|OUTPUT", str(action.metavar))}
    # folders, a new name, what is measured, and names in a file that is not read yet
    assert unknown == {"packages", "name", "sigma", "model", "without"}
    assert {*PARTS} <= {*KINDS["range"](sp.load("stewart"))}


def test_tables_with_forces_and_energies_are_read_again(tmp_path):
    mechanism = sp.load("four_bar")
    start = sp.solve_rates(mechanism, sp.assemble(mechanism, {"crank": 0.3}), {"crank": 2.0})
    driven = sp.simulate(mechanism, start, 0.2,
                         drives={"crank": sp.laws.constant_speed(0.3, 2.0)})
    values, times = read_table(driven.to_csv(tmp_path / "a.csv"), mechanism)
    assert set(values) == set(mechanism.coordinates)
    np.testing.assert_array_equal(times, driven.time)


def test_the_command_line_runs_as_a_module():
    done = subprocess.run([sys.executable, "-m", "spatial_pin.cli", "--version"],
                          capture_output=True, text=True, check=True)
    assert done.stdout == f"spatial-pin {sp.__version__}\n" and not done.stderr


# ---------------------------------------------------------------- remedies

# An argument with a value, or a call of something of the library, as Python has them.
PYTHON = re.compile(r"""\b[a-z_]+=(\[|\{|'|True|False|None|\d|\.\.\.)|\b[A-Za-z_.]+\(\.\.\."""
                    r"""|\bsp\.[a-z]\w+|\bspatial_pin\.[a-z]\w+\(|\bAccuracy\(""")
# What only callers can bring about: a folder or module, and a part of the sentence.
OF_CALLERS = (
    ("checks.py", ""), ("lazy.py", ""), ("__init__.py", ""), ("settings.py", "tradeoff("),
    ("columns.py", "pip install"), ("state.py", "a State is needed"),
    ("motion.py", "a Motion is needed"), ("coordinates.py", "a Mechanism is needed"),
    ("film.py", ""), ("overlays.py", "another motion"), ("overlays.py", "another one"),
    ("pair_tree.py", "sp.closures"), ("closures.py", ""), ("mechanism_writer.py", "tabulate="),
    ("mechanism_writer.py", "from_model"),
    ("tolerance.py", "to make a table of"), ("sweep.py", "speed=0.0 at rest"),
    ("sweep.py", "a sweep goes through a list"),
    ("outputs.py", "a motion by itself has no forces"), ("influence.py", "the whole mechanism"),
    ("influence.py", "dynamics=True"), ("reduce.py", "lump=True"), ("design.py", "goals"),
    ("integrators.py", "explicit integrator"), ("integrators.py", "needs a step"),
    ("simulate.py", "take a longer step"), ("jerks.py", "j="), ("state_forces.py", "a="),
    ("coordinates.py", "CoordinateRates"), ("pictures.py", ""), ("browser.py", ""),
    ("sdf_model.py", "canonical_link="),  # an attribute of SDFormat
)


@cache
def sentences() -> list[tuple[str, str]]:
    """Every text of the package that is no docstring, with a word for each value in it."""
    return list(sentences_of_files())


def sentences_of_files() -> Iterator[tuple[str, str]]:
    for path in sorted(PACKAGE.rglob("*.py")):
        if PACKAGE / "cli" in path.parents:
            continue
        parts = set()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):  # parts after the whole
            if id(node) in parts:
                continue
            if isinstance(node, ast.Expr):
                parts.add(id(node.value))
            elif isinstance(node, ast.JoinedStr):
                parts.update(map(id, node.values))
                yield path.name, "".join(x.value if isinstance(x, ast.Constant) else word(x)
                                         for x in node.values)
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield path.name, node.value


def word(part: ast.FormattedValue) -> str:
    return {"rates": "'a': 0.0", "named": "'a': FOLDER", "names[0]": "'a'", "name": "'a'",
            "empty[0]": "a"}.get(ast.unparse(part.value), "['base', 'a']")


def test_no_sentence_tells_the_command_line_of_arguments_of_python():
    commands = parser().parse_args(["list"]).parsers.values()
    found = []
    for name, text in sentences():
        if " " in text and "<" not in text and PYTHON.search(text) and not any(
                name == file and part in text for file, part in OF_CALLERS):
            told = {in_options(text, command._option_string_actions) for command in commands}
            found += [x for x in told if PYTHON.search(re.sub(r"--speed \S+", "", x))]
    assert not found


def test_warnings_name_the_option():
    (text,) = {in_options(text, ()) for _, text in sentences() if text.endswith("keeps them)")}
    assert text.endswith(" (`spatial-pin assemble --limits` keeps them)")
