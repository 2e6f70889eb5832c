"""The package is typed: a script that touches all of it passes `mypy --strict`, mistakes do not."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from folders import DATA

import spatial_pin as sp

pytest.importorskip("mypy")
PACKAGE = Path(sp.__file__).parent


@pytest.fixture(scope="module")
def checked(tmp_path_factory):
    """What mypy says of both scripts: {file: {line: code of the error}}, from another folder."""
    folder = tmp_path_factory.mktemp("typing")
    files = [DATA / "typed_user.py", DATA / "typed_mistakes.py"]
    run = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", "--no-incremental", "--config-file=",
         *map(str, files)],
        capture_output=True, text=True, cwd=folder, check=False,
        env={**os.environ, "PYTHONPATH": str(PACKAGE.parent)})
    found: dict[str, dict[int, str]] = {file.name: {} for file in files}
    for line in run.stdout.splitlines():
        if match := re.match(r"(\S+?\.py):(\d+): error: .*\[([\w-]+)\]$", line):
            found[Path(match[1]).name][int(match[2])] = match[3]
    assert not run.stderr and run.stdout.strip().splitlines()[-1].startswith("Found"), run.stdout
    return found, run.stdout


@pytest.mark.slow
def test_a_script_that_touches_all_of_it_is_typed(checked):
    found, text = checked
    assert not found["typed_user.py"], text


def test_the_script_touches_every_public_name():
    touched = set(re.findall(r"\bsp\.(\w+)", (DATA / "typed_user.py").read_text("utf-8")))
    untouched = {n for n in sp.__all__ if n not in touched} - {"SpatialPinWarning"}
    assert not untouched


def test_mistakes_are_told(checked):
    found, text = checked
    lines = (DATA / "typed_mistakes.py").read_text("utf-8").splitlines()
    wrong = {i: line.split("# WRONG ")[1] for i, line in enumerate(lines, 1) if "# WRONG " in line}
    assert len(wrong) > 20 and found["typed_mistakes.py"] == wrong, text


def test_the_package_says_that_it_is_typed():
    assert (PACKAGE / "py.typed").is_file()


def test_completion_offers_the_public_names_and_nothing_else():
    assert dir(sp) == sorted([*sp.__all__, "__version__"])
    assert sp.__all__ == sorted(sp.__all__)
