"""Plain URDF whose links have several parents: its loops are cut, and told, not dropped."""

import math
import xml.etree.ElementTree as ET

import numpy as np
import pinocchio as pin
import pytest

import spatial_pin as sp

quiet = pytest.mark.filterwarnings("ignore::spatial_pin.errors.SpatialPinWarning")
LIMIT = "<limit lower='-9' upper='9' effort='1' velocity='1'/>"


def link(name: str, mass: float = 1.0) -> str:
    inertia = f"ixx='{mass}' iyy='{mass}' izz='{mass}' ixy='0' ixz='0' iyz='0'"
    body = f"<inertial><mass value='{mass}'/><inertia {inertia}/></inertial>" if mass else ""
    return f"<link name='{name}'>{body}</link>"


def joint(name: str, kind: str, parent: str, child: str, xyz: str = "0 0 0", more: str = "",
          axis: str = "0 0 1", rpy: str = "0 0 0") -> str:
    shown = f"<axis xyz='{axis}'/>" if kind not in ("fixed", "floating") else ""
    limit = LIMIT if kind in ("revolute", "prismatic") and "<limit" not in more else ""
    return (f"<joint name='{name}' type='{kind}'><origin xyz='{xyz}' rpy='{rpy}'/>"
            f"<parent link='{parent}'/><child link='{child}'/>{shown}{limit}{more}</joint>")


def four_bar(a=0.1, b=0.28, c=0.24, d=0.3, more: str = "", kind: str = "continuous") -> str:
    """At zero: crank, coupler and rocker all along x; the coupler's end has two parents."""
    return ("<robot name='r'>" + "".join(map(link, ("ground", "crank", "coupler", "rocker", "pin")))
            + joint("crank_pin", "continuous", "ground", "crank")
            + joint("coupler_pin", "continuous", "crank", "coupler", f"{a} 0 0")
            + joint("rocker_pin", "continuous", "ground", "rocker", f"{d} 0 0")
            + joint("mount", "fixed", "coupler", "pin", f"{b} 0 0")
            + joint("last_pin", kind, "rocker", "pin", f"{c} 0 0") + more + "</robot>")


def loaded(folder, text: str, toml: str = "") -> sp.Mechanism:
    path = folder / "r.urdf"
    path.write_text(text, encoding="utf-8")
    if toml:
        path = folder / "r.toml"
        path.write_text(f'name = "r"\ntree = "r.urdf"\n{toml}', encoding="utf-8")
    return sp.load(path)


def freudenstein(theta, phi, a, b, c, d):
    k1, k2, k3 = d / a, d / c, (a * a - b * b + c * c + d * d) / (2 * a * c)
    return k1 * np.cos(phi) - k2 * np.cos(theta) + k3 - np.cos(theta - phi)


@pytest.mark.parametrize("toml", ["", "[drivers.crank]\njoint = 'crank_pin'\n"])
def test_a_four_bar_whose_last_link_has_two_parents_follows_freudenstein(tmp_path, toml):
    with pytest.warns(sp.SpatialPinWarning, match=r"cut at joint 'last_pin' \(revolute\)"):
        mech = loaded(tmp_path, four_bar(), toml)
    assert [c.type for c in mech.closures] == ["revolute"]
    assert mech.coordinates == ("crank_pin", "coupler_pin", "rocker_pin")
    assert sp.mobility(mech, sp.assemble(mech, {"crank_pin": 1.0}, guess={
        "rocker_pin": 1.5}).q).dof == 1
    motion = sp.sweep(mech, "crank_pin", np.linspace(1.0, 4.0, 13))
    rocker = motion.coordinate("rocker_pin")[0]
    assert np.abs(freudenstein(np.linspace(1.0, 4.0, 13), rocker, 0.1, 0.28, 0.24, 0.3)
                  ).max() < 1e-12


@quiet
def test_the_tree_that_stays_is_plain_pinocchios_to_the_last_digit(tmp_path):
    text = four_bar(a=0.1234567890123, more=link("tool") + joint(
        "tool_mount", "fixed", "rocker", "tool", "0.1 0.2 0.3", rpy="0.3 1.5707963267948966 -2"))
    mech = loaded(tmp_path, text)
    root = ET.fromstring(text)
    root.remove(next(j for j in root.findall("joint") if j.get("name") == "last_pin"))
    model = pin.buildModelFromXML(ET.tostring(root, encoding="unicode"))
    for frame in model.frames:
        if frame.type == pin.FrameType.BODY:
            mine = mech.model.frames[mech.frame_id(frame.name)]
            assert np.array_equal(mine.placement.homogeneous, frame.placement.homogeneous)


@quiet
@pytest.mark.parametrize(("first", "second", "cut", "kind"), [
    (("revolute", LIMIT), ("continuous", ""), "second", "revolute"),
    (("continuous", ""), ("revolute", LIMIT), "first", "revolute"),
    (("continuous", "<dynamics damping='1'/>"), ("continuous", ""), "second", "revolute"),
    (("prismatic", "<limit lower='-1' upper='1' effort='1' velocity='1'/>"),
     ("continuous", ""), "second", "revolute"),
    (("fixed", ""), ("continuous", ""), "second", "revolute"),
    (("fixed", ""), ("fixed", ""), "second", "weld")])
def test_of_two_joints_the_one_that_loses_least_is_cut(tmp_path, first, second, cut, kind):
    text = ("<robot name='r'>" + "".join(map(link, "abcd")) + joint("i", "continuous", "a", "b")
            + joint("j", "continuous", "a", "c", "1 0 0")
            + joint("first", first[0], "b", "d", "0 1 0", first[1].replace("9", "3"))
            + joint("second", second[0], "c", "d", "-1 1 0", second[1].replace("9", "3"))
            + "</robot>")
    mech = loaded(tmp_path, text)
    assert [(c.name, c.type) for c in mech.closures] == [(cut, kind)]
    assert mech.coordinates[:2] == ("i", "j") or mech.coordinates[0] == "i"


@quiet
def test_names_of_the_mechanism_file_are_kept(tmp_path):
    """A frame and a closure of the file that are called as those of the cut would be."""
    toml = ("[frames.last_pin_on_rocker]\nlink = 'crank'\nxyz = [1.0, 0.0, 0.0]\n[[closures]]\n"
            "name = 'last_pin'\ntype = 'coupling'\njoints = ['crank_pin', 'rocker_pin']\n")
    mech = loaded(tmp_path, four_bar(), toml)
    assert [(c.name, c.type) for c in mech.closures] == [
        ("last_pin", "coupling"), ("last_pin_2", "revolute")]
    assert mech.closures[1].frames == ("last_pin_on_rocker_2", "pin")


@quiet
@pytest.mark.parametrize("toml", [
    "[drivers.d]\njoint = 'last_pin'\n", "[guess]\nlast_pin = 0.1\n",
    "[[springs]]\nname = 's'\njoint = 'last_pin'\nstiffness = 1.0\n"])
def test_a_joint_that_something_refers_to_stays(tmp_path, toml):
    text = four_bar().replace("type='fixed'", "type='continuous'")
    mech = loaded(tmp_path, text, toml)
    assert [c.name for c in mech.closures] == ["mount"] and "last_pin" in mech.coordinates


@quiet
def test_a_mimic_needs_its_joint_more_than_limits_need_theirs(tmp_path):
    text = four_bar().replace("type='fixed'", "type='continuous'").replace(
        "continuous", "revolute").replace(LIMIT, "").replace(
        "<child", LIMIT.replace("9", "1") + "<child")
    text = text.replace("<joint name='mount' type='revolute'>",
                        "<joint name='mount' type='revolute'><mimic joint='crank_pin'/>")
    mech = loaded(tmp_path, text)
    assert "mount" in mech.coordinates
    assert [c.name for c in mech.closures] == ["last_pin", "mimic_mount"]


def test_when_all_are_referred_to_it_is_stated(tmp_path):
    text = four_bar().replace("type='fixed'", "type='continuous'")
    with pytest.raises(sp.MechanismFileError, match=r"r\.urdf: joint '(last_pin|mount)' closes"):
        loaded(tmp_path, text, "[guess]\nlast_pin = 0.1\nmount = 0.1\n")


def test_a_pair_that_the_mechanism_file_names_is_the_closures(tmp_path):
    with pytest.warns(sp.SpatialPinWarning, match=r"'last_pin' \(spherical\)"):
        mech = loaded(tmp_path, four_bar(kind="floating"),
                      "[joints.last_pin]\ntype = 'spherical'\n")
    assert [c.type for c in mech.closures] == ["spherical"]
    state = sp.assemble(mech, {"crank_pin": 1.0}, guess={"rocker_pin": 1.5})
    assert abs(freudenstein(1.0, state.coordinate("rocker_pin")[0], 0.1, 0.28, 0.24, 0.3)) < 1e-12


def test_a_floating_joint_closes_nothing_and_limits_that_are_lost_are_reported(tmp_path):
    with pytest.warns(sp.SpatialPinWarning, match="'last_pin' is floating .* left out"):
        mech = loaded(tmp_path, four_bar(kind="floating"))
    assert mech.closures == ()
    limit = "<limit lower='-1' upper='2' effort='1' velocity='1'/><dynamics damping='0.5'/>"
    text = four_bar(kind="revolute").replace(LIMIT, limit)
    text = text.replace("type='fixed'", "type='revolute'")
    text = text.replace("<child link='pin'/>", f"<child link='pin'/>{limit}", 1)
    with pytest.warns(sp.SpatialPinWarning) as told:
        loaded(tmp_path, text)
    assert "damping 0.5, limits -1 to 2" in str(told[0].message)


def test_a_link_with_two_equal_placements_is_reported_and_with_two_different_ones_refused(tmp_path):
    text = ("<robot name='r'>" + link("a") + link("b") + link("c")
            + joint("i", "fixed", "a", "b", "1 0 0") + joint("j", "fixed", "b", "c", "0 1 0")
            + joint("k", "fixed", "a", "c", "1 1 0") + "</robot>")
    with pytest.warns(sp.SpatialPinWarning, match="fixed to each other already"):
        assert loaded(tmp_path, text).closures == ()
    with pytest.raises(sp.MechanismFileError, match=r"holds .* in another place"):
        loaded(tmp_path, text.replace("1 1 0", "1 2 0"))


def test_a_joint_of_a_link_with_itself_is_refused_by_name(tmp_path):
    for text in (four_bar(), "<robot name='r'>" + link("a") + "</robot>"):
        name = "a" if "crank" not in text else "crank"
        with pytest.raises(sp.MechanismFileError, match=f"'self' joins link '{name}' with itself"):
            loaded(tmp_path, text.replace("</robot>", joint("self", "fixed", name, name)
                                          + "</robot>"))


def test_a_cycle_without_a_root_stands_on_its_first_link(tmp_path):
    """A closed chain of three links and a slider that turns: a slider-crank without ground."""
    text = ("<robot name='r'>" + "".join(map(link, "abcd"))
            + joint("i", "continuous", "a", "b") + joint("j", "continuous", "b", "c", "0.1 0 0")
            + joint("k", "continuous", "c", "d", "0.3 0 0")
            + joint("s", "prismatic", "d", "a", "-0.4 0 0", axis="1 0 0") + "</robot>")
    with pytest.warns(sp.SpatialPinWarning, match="cut at joint 'k'"):
        mech = loaded(tmp_path, text)
    assert mech.links[0] == "a"
    state = sp.assemble(mech, {"i": 0.7}, guess={"j": -0.9})
    x = 0.1 * math.cos(0.7) + math.sqrt(0.3 ** 2 - (0.1 * math.sin(0.7)) ** 2)
    # the slide is that of the link `a` on `d`, along -x of the ground
    assert state.coordinate("s")[0] == pytest.approx(0.4 - x, abs=1e-12)
    assert state.placement("d").translation == pytest.approx([x, 0.0, 0.0], abs=1e-12)


@quiet
def test_roots_stand_on_the_same_ground(tmp_path):
    """Two legs, each from a root of its own, that hold the same link."""
    text = ("<robot name='r'>" + "".join(map(link, "abcde"))
            + joint("i", "continuous", "a", "c") + joint("j", "continuous", "b", "d", "0.5 0 0")
            + joint("k", "continuous", "c", "e", "1 0 0")
            + joint("l", "continuous", "d", "e", "0.5 0 0") + "</robot>")
    try:
        mech = loaded(tmp_path, text)
    except sp.MechanismFileError as error:  # several roots may be refused, but by name
        assert "a, b" in str(error)
    else:
        assert [c.name for c in mech.closures] == ["l"]


@quiet
def test_a_loop_of_three_massless_continuous_joints_is_cut_at_the_ball_they_are(tmp_path):
    text = ("<robot name='r'>" + link("base") + link("bar") + link("x", 0.0) + link("y", 0.0)
            + joint("hinge", "continuous", "base", "bar", "0 0 1")
            + joint("i", "continuous", "base", "x", axis="1 0 0")
            + joint("j", "continuous", "x", "y", axis="0 1 0")
            + joint("k", "continuous", "y", "bar") + "</robot>")
    mech = loaded(tmp_path, text)
    assert [(c.name, c.type) for c in mech.closures] == [("i+j+k", "spherical")]
    kept = loaded(tmp_path, text, "[frames.f]\nlink = 'x'\n")
    assert "i" in kept.coordinates  # a link that something refers to stays, and its joints
