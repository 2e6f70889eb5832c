"""The seeded faults of `scripts/mutants.py` fit the code, and the script tells who catches what."""

import ast
import importlib.util
import sys
from pathlib import Path

import pytest
from folders import ROOT


@pytest.fixture(scope="module")
def mutants():
    """The script as a module."""
    spec = importlib.util.spec_from_file_location("mutants", ROOT / "scripts" / "mutants.py")
    module = sys.modules["mutants"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    yield module
    del sys.modules["mutants"]


def test_every_fault_finds_its_text_once_and_every_folder_has_one(mutants):
    faults = mutants.read()
    assert len(faults) >= 50
    assert mutants.misfits(faults) == []
    package = {x.parent.name for x in (ROOT / "spatial_pin").glob("*/__init__.py")}
    assert package <= {fault.room for fault in faults}
    assert sum(Path(fault.file).suffix in (".c", ".h") for fault in faults) >= 10
    for fault in faults:
        assert mutants.modules_of(ROOT, fault.tests), fault
        if fault.file.endswith(".py"):
            text = (ROOT / fault.file).read_text(encoding="utf-8")
            ast.parse(text.replace(fault.old, fault.new))


@pytest.mark.slow
def test_a_fault_is_caught_by_the_test_that_fails_of_it_and_survives_if_none_does(
        mutants, tmp_path, monkeypatch):
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")  # which take a second to load
    tree = tmp_path / "tree"
    (tree / "spatial_pin" / "rates").mkdir(parents=True)
    (tree / "tests" / "rates").mkdir(parents=True)
    for folder in ("spatial_pin", "spatial_pin/rates"):
        (tree / folder / "__init__.py").touch()
    (tree / "spatial_pin" / "rates" / "sums.py").write_text("one, two = 1, 2\n")
    (tree / "tests" / "rates" / "test_sums.py").write_text(
        "from spatial_pin.rates.sums import one\n\n\ndef test_one():\n    assert one == 1\n")
    (tree / "pyproject.toml").write_text("[tool.pytest.ini_options]\n")
    (tree / "tests" / "test_red.py").write_text("def test_red():\n    assert False\n")
    judge = mutants.Judge(tree, tmp_path, [])

    def end(new, *tests):
        row = judge.judged(mutants.Mutation("a", "spatial_pin/rates/sums.py", "1, 2", new, tests))
        assert row["room"] == "rates"
        return row["end"], row["by"]

    assert end("3, 2", "test_gone", "test_sums") == (
        "caught", "tests/rates/test_sums.py::test_one")
    assert end("1, 3", "test_sums") == ("survived", "")
    assert end("1, 3", "test_red")[0] == end("1, 3", "test_gone")[0] == "error"
