"""A table is opened in a spreadsheet: no name in it is a formula there, whatever it is called."""

import csv
import io

import numpy as np
import pytest

import spatial_pin as sp
from spatial_pin.formats.file_access import library_folder

FORMULAS = ("=cmd", "+sum", "-x", "@now")


def written(folder, name):
    """Write the four-bar with a name for its rocker's pin, a frame and a closure."""
    text = sp.load("four_bar").urdf.replace('"rocker_pin"', f'"{name}"').replace(
        '"coupler_b"', f'"{name}_tip"')
    (folder / "m.urdf").write_text(text, encoding="utf-8")
    (folder / "m.toml").write_text(
        f'name = "m"\ntree = "m.urdf"\n[[closures]]\nname = "{name}_pin"\ntype = "revolute"\n'
        f'frames = ["{name}_tip", "rocker_b"]\naxis = [0, -1, 0]\n[drivers.crank]\n'
        f'joint = "crank_pin"\n[guess]\ncrank_pin = 0.0\n"{name}" = 1.77\n', encoding="utf-8")
    return folder / "m.toml"


def is_formula(cell):
    try:
        float(cell)
    except ValueError:
        return len(cell) > 1 and cell.startswith(("=", "+", "-", "@"))
    return False


def holds_no_formula(text, name):
    """No cell begins as a formula does; the name is there all the same."""
    cells = [cell for row in csv.reader(io.StringIO(text)) for cell in row]
    assert not [cell for cell in cells if is_formula(cell)]
    assert any(name in cell for cell in cells)


@pytest.mark.parametrize("name", FORMULAS)
def test_no_table_of_a_motion_or_of_forces_holds_a_formula(name, tmp_path, run):
    path = written(tmp_path, name)
    motion = sp.sweep(sp.load(path), "crank", [0.0, 0.1], speed=1.0)
    holds_no_formula(motion.to_csv(), name)
    holds_no_formula(motion.to_csv(tmp_path / "f.csv").read_text("utf-8"), name)
    for words in (("sweep", path, "crank", "0", "1", "--steps", "3", "--csv", "-"),
                  ("sweep", path, "crank", "0", "1", "--steps", "3", "--csv", tmp_path / "g.csv"),
                  ("statics", path, "crank=0.5", "--csv", "-")):
        code, out, error = run(*words)
        assert code == 0, error
        holds_no_formula(out if words[-1] == "-" else (tmp_path / "g.csv").read_text("utf-8"), name)


@pytest.mark.parametrize("name", [*FORMULAS, "=a,b"])
def test_no_table_of_residuals_holds_a_formula(name, tmp_path):
    tree = (library_folder() / "four_bar.urdf.xacro").read_text("utf-8").replace(
        "parts.xacro", "$(find spatial_pin)/parts.xacro")
    (tmp_path / "m.urdf.xacro").write_text(tree.replace('"rocker_pin"', f'"{name}"'))
    path = written(tmp_path, name)
    path.write_text(path.read_text().replace("m.urdf", "m.urdf.xacro").replace(
        f"{name}_tip", "coupler_b"))
    mech = sp.load(path)
    seen = [({"crank": x}, {name: sp.assemble(mech, {"crank": x}).coordinate(name).value})
            for x in (0.0, 1.0, 2.0)]
    text = sp.calibrate(mech, seen, ["r3"]).to_csv(tmp_path / "r.csv").read_text("utf-8")
    holds_no_formula(text, name)
    assert {len(row) for row in csv.reader(io.StringIO(text))} == {6}


def test_a_table_that_was_written_is_read_again(tmp_path, run):
    path = written(tmp_path, "=cmd")
    mech = sp.load(path)
    motion = sp.sweep(mech, "crank", np.linspace(0.0, 1.0, 4))
    table = tmp_path / "t.csv"
    with table.open("w", newline="", encoding="utf-8") as file:
        motion.to_csv(file, ["=cmd"])
    heads = table.read_text("utf-8").splitlines()[0]
    assert "'=cmd" in heads
    only = tmp_path / "only.csv"
    rocker = motion.coordinate("=cmd").value
    only.write_text("'=cmd [rad]\n" + "\n".join(map(repr, rocker.tolist())) + "\n")
    code, _, error = run("follow", path, only, "--csv", tmp_path / "back.csv")
    assert code == 0, error
    back = np.genfromtxt(tmp_path / "back.csv", delimiter=",", names=True)
    assert len(back) == 4


def test_numbers_and_single_signs_stay_as_they_are():
    from spatial_pin._support.output_files import write_csv

    text = io.StringIO()
    write_csv(text, {"-": np.array(["-", "-1.5", "+2"], dtype=object), "x": np.array([-1.0, 2, 3])},
              "\n")
    assert text.getvalue() == "-,x\n-,-1.0\n-1.5,2.0\n+2,3.0\n"
