"""A mechanism is saved as a folder that loads as the same mechanism, wherever it is moved."""

import shutil

import numpy as np
import pytest
from folders import DATA
from mechanisms import content_of, from_text
from sameness import same_mechanisms
from variety import each

import spatial_pin as sp

NEEDS = {".xml": "mujoco", ".usda": "pxr"}
ARM = """<robot name="arm">
  <link name="base"/><link name="fore"/><link name="hand"/><link name="tip"/>
  <joint name="z" type="revolute"><parent link="base"/><child link="fore"/>
    <axis xyz="0 0.6 0.8"/><limit lower="-1" upper="2" effort="3" velocity="4"/></joint>
  <joint name="a" type="floating"><parent link="fore"/><child link="hand"/></joint>
  <joint name="b" type="floating"><parent link="fore"/><child link="tip"/></joint>
</robot>"""


def arm(**content):
    return from_text(ARM, {"name": "arm", "tree": "arm.urdf", **content}, "arm.toml")


def files(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def saved_twice(mech, folder):
    """Save, load, save: both times the same files; return what was loaded."""
    again = sp.load(mech.save(folder / "first"))
    again.save(folder / "second")
    assert files(folder / "first") == files(folder / "second")
    return again


@pytest.mark.parametrize("name", each(sp.list_mechanisms()))
def test_every_library_mechanism_is_saved_and_loaded_as_it_was(name, tmp_path):
    mech = sp.load(name)
    again = saved_twice(mech, tmp_path)
    same_mechanisms(again, mech)
    np.testing.assert_allclose(sp.assemble(again).q, sp.assemble(mech).q, atol=1e-12)
    assert len(again.visual_model.geometryObjects) == len(mech.visual_model.geometryObjects)


@pytest.mark.parametrize(("name", "output"), [
    ("rssr", "rocker_pin"), ("stewart", "platform"), ("watt_six_bar", "output_pin"),
    ("geared_five_bar", "coupler")])
@pytest.mark.parametrize("dynamics", [False, True])
def test_so_is_a_reduced_mechanism(name, output, dynamics, tmp_path):
    full = sp.load(name)
    outputs = output if output in (*full.links, *full.coordinates) else full.links[-1]
    reduced = sp.reduce(full, outputs, dynamics=dynamics)
    again = saved_twice(reduced, tmp_path)
    same_mechanisms(again, reduced)


IMPORTED = [p.relative_to(DATA) for ending in (".xml", ".sdf", ".usda", ".toml", ".urdf")
            for p in sorted(DATA.rglob(f"*{ending}"))
            if "far_starts" not in p.parts and p.name != "cases.toml"]  # numbers, no mechanisms


@pytest.mark.alike
@pytest.mark.parametrize("file", IMPORTED, ids=str)
@pytest.mark.filterwarnings("ignore::spatial_pin.SpatialPinWarning")
def test_so_is_what_was_imported(file, tmp_path):
    if file.suffix in NEEDS:
        pytest.importorskip(NEEDS[file.suffix])
    mech = sp.load(DATA / file)
    again = saved_twice(mech, tmp_path)
    same_mechanisms(again, mech)


@pytest.mark.parametrize("name", ["rssr", "four_bar", "stewart"])
def test_so_is_what_floats(name, tmp_path):
    mech = sp.load(name, free_flyer=True)
    same_mechanisms(saved_twice(mech, tmp_path), mech)


def test_limits_that_urdf_cannot_say_are_kept(tmp_path):
    inf = float("inf")
    mech = arm(joints={
        "z": {"lower": -0.5, "velocity": inf, "lower_effort": -1.0},
        "a": {"type": "cylindrical", "axis": [0.6, 0.0, 0.8], "lower": [-inf, 0.1],
              "upper": [3.0, 0.2], "effort": [5.0, 6.0], "velocity": 7.0},
        "b": {"type": "spherical", "lower_velocity": [-1.0, -2.0, -3.0]},
    })
    model = mech.model
    i = model.idx_qs[mech.joint_id("a")]
    assert model.lowerPositionLimit[i : i + 2].tolist() == [-inf, 0.1]
    z = model.idx_vs[mech.joint_id("z")]
    assert (model.lowerEffortLimit[z], model.upperEffortLimit[z]) == (-1.0, 3.0)
    assert (model.lowerVelocityLimit[z], model.upperVelocityLimit[z]) == (-inf, inf)
    assert "lower_velocity" not in content_of(mech)["joints"]["a"]
    same_mechanisms(saved_twice(mech, tmp_path), mech)


@pytest.mark.parametrize(("table", "says"), [
    ({"lower": 3.0}, r"joints\.z: a lower position limit is above"),
    ({"velocity": -1.0}, "a lower velocity limit is above"),
    ({"effort": [1.0, 2.0]}, r"effort has 2 numbers"),
    ({"upper": float("nan")}, "upper must be a number"),
    ({"upper": []}, "upper is an empty list"),
    ({"upper": "far"}, "upper must be a number"),
    ({"uper": 1.0}, "uper"),
    ({"type": "fixed", "upper": 1.0}, "upper: joint 'z' is fixed"),
])
def test_limits_that_cannot_be_are_refused(table, says):
    with pytest.raises(sp.MechanismFileError, match=says):
        arm(joints={"z": table})


def test_the_order_of_coordinates_can_be_chosen(tmp_path):
    assert list(arm().model.names) == ["universe", "z", "a", "b"]
    mech = arm(order=["z", "b", "a"], joints={"b": {"type": "prismatic", "axis": [1, 0, 0]}})
    assert mech.coordinates[:2] == ("z", "b")
    assert mech.model.frames[mech.frame_id("tip")].parentJoint == 2
    same_mechanisms(saved_twice(mech, tmp_path), mech)
    assert list(arm(order=["b"]).model.names)[1:] == ["z", "a", "b"]


@pytest.mark.parametrize(("order", "says"), [
    (["a", "z", "b"], "'a' comes before 'z', on which it hangs"),
    (["z", "a", "a"], "named twice"), (["z", "hand"], "no joint that moves is named 'hand'"),
    ("z", "order must be a list of names"),
])
def test_orders_that_cannot_be_are_refused(order, says):
    with pytest.raises(sp.MechanismFileError, match=says):
        arm(order=order)


def test_refined_axes_and_fixed_joints_are_kept(tmp_path):
    mech = arm(joints={"z": {"type": "revolute", "axis": [0.0, 1.0, 0.0]},
                       "a": {"type": "fixed"},
                       "b": {"type": "planar", "axis": [0.48, 0.6, 0.64]}})
    again = saved_twice(mech, tmp_path)
    same_mechanisms(again, mech)
    assert list(again.model.names) == ["universe", "z", "b"]


def test_mimic_joints_stay_in_the_urdf(tmp_path):
    urdf = ARM.replace('<joint name="b" type="floating">',
                       '<joint name="b" type="continuous"><mimic joint="z" multiplier="2"/>')
    mech = from_text(urdf, {"name": "arm", "tree": "arm.urdf"}, "arm.toml")
    again = saved_twice(mech, tmp_path)
    same_mechanisms(again, mech)
    assert [c.name for c in again.closures] == ["mimic_b"]
    assert "mimic_b" not in (tmp_path / "first" / "arm.toml").read_text()


def test_the_folder_can_be_moved_with_its_meshes(tmp_path):
    for folder in ("visual", "collision"):
        (tmp_path / "source" / folder).mkdir(parents=True)
        (tmp_path / "source" / folder / "part.obj").write_text(
            "mtllib part.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
        (tmp_path / "source" / folder / "part.mtl").write_text("newmtl a\nKd 1 0 0\n")
    shape = '<geometry><mesh filename="{}/part.obj"/></geometry>'
    (tmp_path / "source" / "part.urdf").write_text(
        '<robot name="part"><link name="base"><visual>' + shape.format("visual")
        + "</visual><collision>" + shape.format("collision") + "</collision></link></robot>")
    mech = sp.load(tmp_path / "source" / "part.urdf")
    again = saved_twice(mech, tmp_path / "out")
    shutil.rmtree(tmp_path / "source")
    shutil.move(tmp_path / "out" / "first", tmp_path / "moved")
    shutil.rmtree(tmp_path / "out")
    moved = sp.load(tmp_path / "moved" / "part.toml")
    assert {"meshes/visual/part.obj", "meshes/visual/part.mtl",
            "meshes/collision/part.obj"} <= files(tmp_path / "moved").keys()
    assert moved.visual_model.ngeoms == moved.collision_model.ngeoms == 1
    with pytest.warns(sp.SpatialPinWarning, match=r"2 mesh files are not there.*'part\.obj'"):
        again.save(tmp_path / "bare")


def test_meshes_that_nobody_found_stay_as_they_are_named(tmp_path, monkeypatch):
    (tmp_path / "part.stl").write_bytes(b"not of this mechanism")
    monkeypatch.chdir(tmp_path)
    shapes = "".join(f'<visual><geometry><mesh filename="{name}"/></geometry></visual>'
                     for name in ("package://nowhere/part.stl", "part.stl"))
    (tmp_path / "source").mkdir()
    (tmp_path / "source" / "a.urdf").write_text(
        f'<robot name="a"><link name="base">{shapes}</link></robot>')
    with pytest.warns(sp.SpatialPinWarning, match="not found"):
        mech = sp.load(tmp_path / "source" / "a.urdf")
    with pytest.warns(sp.SpatialPinWarning, match="not found"):
        again = sp.load(mech.save(tmp_path / "out"))
    assert files(tmp_path / "out").keys() == {"a.urdf", "a.toml"}
    assert again.urdf == mech.urdf


def test_no_file_of_the_mechanism_itself_is_overwritten(tmp_path):
    path = sp.load("four_bar").save(tmp_path)
    before = files(tmp_path)
    with pytest.raises(sp.SpatialPinError, match="a file of the mechanism itself"):
        sp.load(path).save(tmp_path)
    assert files(tmp_path) == before


def test_names_that_are_no_file_names_are_written_as_some(tmp_path):
    mech = from_text(ARM, {"name": "../Arm (left) \u00e4\x07\x7f\"\\ ", "tree": "x"}, "arm.toml")
    path = mech.save(tmp_path / "here")
    assert path.parent == tmp_path / "here" and path.name == "Arm_left_\u00e4.toml"
    assert sp.load(path).name == mech.name


@pytest.mark.parametrize("folder", [None, 3, b"a", "", "a\0b"])
def test_what_is_no_name_of_a_folder_is_refused(folder):
    with pytest.raises((TypeError, ValueError), match="name of a folder"):
        sp.load("four_bar").save(folder)


def test_a_file_is_no_folder(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ValueError, match="this is a file"):
        sp.load("four_bar").save(tmp_path / "file")
    with pytest.raises(sp.SpatialPinError, match=r"cannot write .*file"):
        sp.load("four_bar").save(tmp_path / "file" / "folder")


def test_the_command_line_saves_a_folder(tmp_path, run):
    code, out, _ = run("export", "rssr", "--folder", tmp_path / "out")
    assert code == 0 and str(tmp_path / "out" / "rssr.toml") in out
    same_mechanisms(sp.load(tmp_path / "out" / "rssr.toml"), sp.load("rssr"))


def test_a_mechanism_without_the_text_of_its_tree_says_so(tmp_path):
    bare = sp.load("four_bar").with_fields(urdf="")
    with pytest.raises(sp.SpatialPinError, match="URDF text of its tree is needed"):
        bare.save(tmp_path)
    assert sp.reduce(bare, "rocker_pin").verify().worst < 1e-12  # which needs none
