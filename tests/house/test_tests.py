"""Rules for the tests: where they stand, what they import, and that a run leaves nothing behind."""

import ast
import re
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from folders import ROOT
from offenders import listed
from work_tree import git

import spatial_pin as sp

TESTS = ROOT / "tests"
ROOMS = {path.parent.name for path in (ROOT / "spatial_pin").glob("*/__init__.py")}
OTHERS = {"house", "users", "inside", "support", "data"}
LOOK_INSIDE = ("kernel", "numerics", "house", "inside", "support", "conftest.py")  # `run` is there
PUBLIC = {*sp.__all__, "__version__", "errors", "operators"}
MODULES = {path.name.removesuffix(".py") for path in (ROOT / "spatial_pin").iterdir()} - PUBLIC
TOP = {
    "pyproject.toml", "README.md", "CHANGELOG.md", "CONTRIBUTING.md", "CITATION.cff", "SECURITY.md",
    "LICENSE", "urdf", "spatial_pin", "tests", "scripts", "examples", "notebooks", "docs",
    "packaging", ".github", ".ci", ".gitignore"}


def files() -> list[Path]:
    return sorted(path for path in TESTS.rglob("*.py") if TESTS / "data" not in path.parents)


def place(path: Path) -> str:
    return path.relative_to(TESTS).as_posix()


@cache
def nodes(path: Path) -> list[ast.AST]:
    """Return what can import something: imports, attributes of the library, texts."""
    return [node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
            if isinstance(node, ast.Import | ast.ImportFrom | ast.Attribute | ast.Constant)]


def imported(path: Path) -> Iterator[str]:
    """Yield the names of modules, and of what is imported from them, that a file imports."""
    for node in nodes(path):
        if isinstance(node, ast.Import):
            yield from (a.name for a in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield from (f"{node.module}.{a.name}" for a in node.names)


def reached(path: Path) -> Iterator[str]:
    """Yield the parts of the library that a file reaches by imports, attributes or texts."""
    yield from (name.split(".")[1] for name in imported(path) if name.startswith("spatial_pin."))
    for node in nodes(path):
        if isinstance(node, ast.Attribute) and node.attr in MODULES:
            if isinstance(node.value, ast.Name) and node.value.id in ("sp", "spatial_pin"):
                yield node.attr
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            if re.fullmatch(r"spatial_pin(\.\w+)+", node.value):
                yield node.value.split(".")[1]
            yield from re.findall(r"\b(?:from|import) spatial_pin\.(\w+)", node.value)


def internals() -> dict[str, set[str]]:
    """Return the parts that are not public, of each file that reaches some."""
    found = {place(path): set(reached(path)) - PUBLIC for path in files()}
    return {name: parts for name, parts in found.items() if parts}


def test_tests_of_behaviour_speak_the_public_interface():
    wrong = {name: parts for name, parts in internals().items()
             if name.split("/")[0] not in LOOK_INSIDE}
    assert not wrong, listed(wrong)


def test_few_files_look_inside():
    assert len(internals()) <= 60, listed(internals())


def test_no_test_file_imports_another():
    names = {path.stem for path in files() if path.name.startswith("test_")}
    others = {place(path): names & {name.split(".")[0] for name in imported(path)}
              for path in files()}
    wrong = {name: found for name, found in others.items() if found}
    assert not wrong, listed(wrong)


def test_folders_are_named_after_the_rooms_that_they_test():
    """Or after the first words of one."""
    there = {path.name for path in TESTS.iterdir() if path.is_dir() and path.name != "__pycache__"}
    wrong = [name for name in there - OTHERS
             if not any(f"{room}_".startswith(f"{name}_") for room in ROOMS)]
    assert not wrong, listed(wrong)


def test_few_files_stand_straight_in_tests():
    assert len([path for path in TESTS.iterdir() if path.is_file()]) <= 15


def test_no_two_test_files_have_one_name():
    """Pytest imports each by its name."""
    counts = Counter(path.name for path in files() if path.name != "conftest.py")
    wrong = [name for name, n in counts.items() if n > 1]
    assert not wrong, listed(wrong)


# ---------------------------------------------------------------- what is left behind


@pytest.mark.skipif(git(ROOT, "ls-files") is None, reason="no checkout of git")
def test_the_top_level_has_no_other_entries():
    """Of those that git has, and of those that it neither has nor ignores."""
    there = git(ROOT, "ls-files", "--cached", "--others", "--exclude-standard")
    entries = {name.partition("/")[0] for name in there if (ROOT / name).exists()}
    assert not entries - TOP, listed(entries - TOP)


@pytest.mark.skipif(shutil.which("git") is None, reason="no git here")
@pytest.mark.slow
@pytest.mark.parametrize("options", [(), ("-n", "1")], ids=["alone", "workers"])
def test_a_run_that_leaves_a_file_in_the_work_tree_fails(tmp_path, options):
    subprocess.run(["git", "init", "-q", str(tmp_path)], check=True)
    (tmp_path / "pytest.ini").write_text("[pytest]\n")
    (tmp_path / ".gitignore").write_text("__pycache__\n")
    (tmp_path / "test_it.py").write_text("def test_it():\n    open('new.txt', 'w').close()\n")

    def run() -> tuple[int, str]:
        done = subprocess.run(
            [sys.executable, "-m", "pytest", "-q", "-p", "work_tree", "-p", "no:cacheprovider",
             *options], cwd=tmp_path, capture_output=True, text=True, check=False,
            env={"PYTHONPATH": str(TESTS / "support"), "PATH": "/usr/bin:/bin"})
        return done.returncode, done.stdout

    code, text = run()
    assert code == 1 and "1 passed" in text and "left files in the work tree" in text
    assert "new.txt" in text
    assert run()[0] == 0  # it was there before
