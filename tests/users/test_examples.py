"""Every example runs, from any folder, and writes what it says it writes."""

import subprocess
import sys

import pytest
from folders import ROOT
from images import needs_browser

EXAMPLES = sorted((ROOT / "examples").glob("*.py"))


@pytest.mark.slow
@pytest.mark.browser
@needs_browser
@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_runs_and_writes_its_files(example, tmp_path):
    done = subprocess.run([sys.executable, example, tmp_path / "made"], cwd=tmp_path,
                          capture_output=True, text=True, timeout=300)
    if done.returncode and "pip install 'spatial_pin[" in done.stderr:
        pytest.skip(done.stderr.strip().splitlines()[-1])
    assert done.returncode == 0, done.stderr
    told = example.read_text(encoding="utf-8").split('"""')[1]
    made = {path.name for path in (tmp_path / "made").iterdir()}
    assert made, "it writes nothing"
    for name in made:
        assert name in told, f"{name} is written, and not told of"
