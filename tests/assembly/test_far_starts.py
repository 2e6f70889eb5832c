"""Loops are closed from afar: from neutral, from opposite axes, from half a turn."""


import numpy as np
import pinocchio as pin
import pytest
from folders import DATA
from mechanisms import from_text

import spatial_pin as sp

FAR_STARTS = DATA / "far_starts"
ROBOTS = sorted(path.stem for path in FAR_STARTS.glob("*.toml"))
pytestmark = pytest.mark.delicate


def body(end, size=1.0, kind="floating"):
    """Return a base and a body that hangs on it, with frames where a closure joins them.

    Args:
        end: rotation vector of the body's frame.
        size: of the mechanism [m].
        kind: pair of the joint.
    """
    rpy = " ".join(map(repr, pin.rpy.matrixToRpy(pin.exp3(np.array(end))).tolist()))
    half = 0.5 * size
    urdf = f"""<robot name="body"><link name="base"/><link name="body"/>
      <link name="there"/><link name="mark"/>
      <joint name="fixed_mark" type="fixed"><parent link="base"/><child link="mark"/>
        <origin xyz="{size} {half} 0"/></joint>
      <joint name="hang" type="floating"><parent link="base"/><child link="body"/>
        <origin xyz="{half} 0 {half}"/></joint>
      <joint name="fixed_end" type="fixed"><parent link="body"/><child link="there"/>
        <origin xyz="0 {half} {-half}" rpy="{rpy}"/></joint></robot>"""
    return urdf, {"name": "body", "tree": "body", "joints": {"hang": {"type": kind}}}


def closed_by(pair, end, size=1.0, kind="floating"):
    urdf, content = body(end, size, kind)
    content["closures"] = [{"name": "loop", "type": pair, "frames": ["mark", "there"]}]
    return from_text(urdf, content, "body.toml")


def placements(state, names=("mark", "there")):
    return [state.placement(name) for name in names]


@pytest.mark.parametrize("name", ROBOTS)
def test_robots_that_their_authors_publish_open_close_from_neutral(name):
    mechanism = sp.load(FAR_STARTS / f"{name}.toml")
    state = sp.assemble(mechanism)
    assert state.closure_error < 1e-12
    for closure in mechanism.closures:
        one, two = placements(state, closure.frames)
        assert np.linalg.norm(pin.log6(one.actInv(two)).vector) < 1e-11


@pytest.mark.parametrize("name", ["cassie_like", "digit_like_2legs"])
def test_drivers_stand_at_neutral_where_the_loops_allow_it(name):
    mechanism = sp.load(FAR_STARTS / f"{name}.toml")
    state = sp.assemble(mechanism)
    assert not state.released
    assert all(state.coordinate(driver).value == 0.0 for driver in mechanism.drivers)


@pytest.mark.parametrize("name", ["disney_robot", "wl16_like"])
def test_drivers_that_cannot_stand_go_by_a_little_only(name):
    released = sp.assemble(sp.load(FAR_STARTS / f"{name}.toml")).released
    assert released
    assert max(map(abs, released.values())) < 0.03


TURNS = [(np.pi, 0.0, 0.0), (0.0, np.pi, 0.0), (0.0, 0.0, np.pi), (2.0, -2.0, 1.0),
         (np.pi - 1e-9, 0.0, 0.0), (1.2, 2.1, -1.6)]


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("turn", TURNS)
def test_a_weld_closes_from_half_a_turn(turn, size):
    state = sp.assemble(closed_by("weld", turn, size))
    one, two = placements(state)
    assert np.linalg.norm(pin.log3(one.rotation.T @ two.rotation)) < 1e-12
    assert np.linalg.norm(one.translation - two.translation) < 1e-12 * size


@pytest.mark.parametrize("pair", ["revolute", "cylindrical", "planar", "parallel", "prismatic",
                                  "weld"])
@pytest.mark.parametrize("turn", TURNS)
def test_axes_point_the_same_way_though_they_begin_opposite(pair, turn):
    state = sp.assemble(closed_by(pair, turn))
    one, two = placements(state)
    assert state.closure_error < 1e-12
    assert one.rotation[:, 2] @ two.rotation[:, 2] == pytest.approx(1.0, abs=1e-12)


def test_a_screw_closes_from_opposite_axes():
    urdf, content = body((np.pi, 0.0, 0.0))
    content["closures"] = [{"name": "loop", "type": "screw", "frames": ["mark", "there"],
                            "lead": 0.1}]
    state = sp.assemble(from_text(urdf, content, "body.toml"))
    one, two = placements(state)
    assert one.rotation[:, 2] @ two.rotation[:, 2] == pytest.approx(1.0, abs=1e-12)
    relative = one.actInv(two)
    angle = np.arctan2(relative.rotation[1, 0], relative.rotation[0, 0])
    assert relative.translation[2] == pytest.approx(0.1 * angle / (2.0 * np.pi), abs=1e-12)


def test_loops_stated_twice_close_from_afar_too():
    urdf, content = body((2.0, -2.0, 1.0))
    content["closures"] = [{"name": f"loop{k}", "type": "weld", "frames": ["mark", "there"]}
                           for k in range(3)]
    state = sp.assemble(from_text(urdf, content, "body.toml"))
    assert state.closure_error < 1e-12
    assert not sp.mobility(state.mechanism, state).dof


def test_an_orientation_that_no_joint_allows_is_reported_as_such():
    """A body that only slides cannot turn: half a turn stays open, and is no mirror image."""
    urdf, content = body((np.pi, 0.0, 0.0), kind="prismatic")
    content["closures"] = [{"name": "loop", "type": "prismatic", "frames": ["mark", "there"]}]
    with pytest.raises(sp.AssemblyError, match="loop"):
        sp.assemble(from_text(urdf, content, "body.toml"))


def test_what_does_not_close_from_here_is_reported_with_the_smallest_gap_found():
    """A ball on an arm of 0.7 m from its base, 1.1 m from where it is to be."""
    mechanism = closed_by("weld", (0.3, 0.2, 0.1), kind="spherical")
    with pytest.raises(sp.AssemblyError, match="the smallest gap found; no assembly") as caught:
        sp.assemble(mechanism)
    assert 0.1 < caught.value.closure_error < 1.0
    assert "closure 'loop' stays open by" in str(caught.value)
