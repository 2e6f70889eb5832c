"""The package is typed: a script that touches all of it passes `mypy --strict`, mistakes do not."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from folders import DATA, ROOT

import spatial_pin as sp

pytest.importorskip("mypy")
PACKAGE = Path(sp.__file__).parent


FILES = [DATA / "typed_user.py", DATA / "typed_mistakes.py"]


def told(folder: Path, *options: str) -> tuple[dict[str, dict[int, str]], str]:
    """Return what mypy says of both scripts, {file: {line: code of the error}}, and its text."""
    run = subprocess.run(
        [sys.executable, "-m", "mypy", *options, *map(str, FILES)],
        capture_output=True, text=True, cwd=folder, check=False,
        env={**os.environ, "PYTHONPATH": str(PACKAGE.parent)})
    found: dict[str, dict[int, str]] = {file.name: {} for file in FILES}
    for line in run.stdout.splitlines():
        if match := re.match(r"(\S+?\.py):(\d+): error: .*\[([\w-]+)\]$", line):
            found[Path(match[1]).name][int(match[2])] = match[3]
    assert not run.stderr and run.stdout.strip().splitlines()[-1].startswith("Found"), run.stdout
    return found, run.stdout


@pytest.fixture(scope="module", params=[
    "as the package is checked", pytest.param("as a strict user does", marks=pytest.mark.slow)])
def checked(request, tmp_path_factory):
    """By the package's own rules, where most is known from before, or anew from another folder."""
    if request.param == "as the package is checked":
        version = f"{sys.version_info.major}.{sys.version_info.minor}"
        return told(ROOT, "--python-version", version)  # NumPy's types are those for this one
    return told(tmp_path_factory.mktemp("typing"), "--strict", "--no-incremental", "--config-file=")


def test_a_script_that_touches_all_of_it_is_typed(checked):
    found, text = checked
    assert not found["typed_user.py"], text


def test_the_script_touches_every_public_name():
    touched = set(re.findall(r"\bsp\.(\w+)", (DATA / "typed_user.py").read_text("utf-8")))
    untouched = {n for n in sp.__all__ if n not in touched} - {"SpatialPinWarning"}
    assert not untouched


def test_mistakes_are_reported(checked):
    found, text = checked
    lines = (DATA / "typed_mistakes.py").read_text("utf-8").splitlines()
    wrong = {i: line.split("# WRONG ")[1] for i, line in enumerate(lines, 1) if "# WRONG " in line}
    assert len(wrong) > 20 and found["typed_mistakes.py"] == wrong, text


def test_the_package_says_that_it_is_typed():
    assert (PACKAGE / "py.typed").is_file()


def test_completion_offers_the_public_names_and_nothing_else():
    assert dir(sp) == sorted([*sp.__all__, "__version__"])
    assert sp.__all__ == sorted(sp.__all__)
