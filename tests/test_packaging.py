"""The built wheel carries the mechanism library."""

import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


@pytest.mark.slow
def test_a_wheel_in_an_empty_environment_loads_by_name_from_another_folder(tmp_path):
    """The dependencies come from this environment, spatial_pin from the wheel alone."""
    build = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir",
             str(tmp_path), str(ROOT)]
    subprocess.run(build, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("spatial_pin-*.whl")

    folder = tmp_path / "empty"
    venv.create(folder, with_pip=False)
    python = folder / "bin" / "python"
    site = Path(sysconfig.get_path("purelib", vars={"base": str(folder)}))
    here = Path(sysconfig.get_path("purelib"))
    cmeel = here / "cmeel.prefix" / "lib" / site.parent.name / "site-packages"
    (site / "dependencies.pth").write_text(f"{here}\n{cmeel}\n", encoding="utf-8")
    subprocess.run([sys.executable, "-m", "zipfile", "-e", str(wheel), str(site)], check=True)

    code = ("import spatial_pin as sp; m = sp.load('rssr', d=0.315); "
            "print(sp.__file__, sp.assemble(m, {'crank': 0.0}).coordinate('rocker_pin').value)")
    run = subprocess.run([str(python), "-c", code], check=True, capture_output=True, text=True,
                         cwd=tmp_path)
    file, angle = run.stdout.split()
    assert Path(file).is_relative_to(site)
    assert float(angle) == pytest.approx(1.238712380, abs=1e-8)  # 70.97299137°
