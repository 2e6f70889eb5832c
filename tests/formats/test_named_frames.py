"""Frames that a mechanism file adds to a URDF that nobody edits."""

import pickle

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st
from mechanisms import content_of, from_text

import spatial_pin as sp

BARE = """<robot name="bars">
  <link name="ground"/>
  <link name="crank"><inertial><origin xyz="0.15 0 0"/><mass value="2"/>
    <inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial></link>
  <link name="coupler"/><link name="rocker"/>
  <joint name="crank_pin" type="continuous">
    <parent link="ground"/><child link="crank"/><axis xyz="0 0 1"/></joint>
  <joint name="coupler_pin" type="continuous"><origin xyz="0.3 0 0"/>
    <parent link="crank"/><child link="coupler"/><axis xyz="0 0 1"/></joint>
  <joint name="rocker_pin" type="continuous"><origin xyz="0.7 0 0"/>
    <parent link="ground"/><child link="rocker"/><axis xyz="0 0 1"/></joint>
</robot>"""
ENDS = """  <link name="coupler_end"/><link name="rocker_end"/>
  <joint name="coupler_end_mount" type="fixed"><origin xyz="0.6 0 0"/>
    <parent link="coupler"/><child link="coupler_end"/></joint>
  <joint name="rocker_end_mount" type="fixed"><origin xyz="0.5 0 0"/>
    <parent link="rocker"/><child link="rocker_end"/></joint>
</robot>"""
CONTENT = {
    "name": "bars", "tree": "bars.urdf",
    "closures": [{"name": "pin", "type": "revolute", "frames": ["coupler_end", "rocker_end"]}],
    "drivers": {"crank": {"joint": "crank_pin"}},
    "guess": {"crank_pin": 0.5, "coupler_pin": 0.5, "rocker_pin": 1.5},
}
FRAMES = {"coupler_end": {"link": "coupler", "xyz": [0.6, 0.0, 0.0]},
          "rocker_end": {"link": "rocker_pin", "xyz": [0.5, 0, 0]}}


def bars(**more):
    return from_text(BARE, {**CONTENT, "frames": FRAMES, **more}, "bars.toml")


def refused(match, **frames):
    with pytest.raises(sp.MechanismFileError, match=match):
        bars(frames={**FRAMES, **frames})


def test_a_loop_closes_between_frames_that_the_urdf_does_not_have():
    edited = from_text(BARE.replace("</robot>", ENDS), CONTENT, "edited.toml")
    mech = bars()
    assert mech.characteristic_length == edited.characteristic_length
    for crank in np.linspace(0.0, 6.0, 7):
        q, expected = (sp.assemble(m, {"crank": crank}).q for m in (mech, edited))
        np.testing.assert_allclose(q, expected, atol=1e-14)
    state = sp.assemble(mech)
    np.testing.assert_allclose(state.placement("coupler_end").translation,
                               state.placement("rocker_end").translation, atol=1e-14)


def test_frames_hang_on_frames_links_joints_and_fixed_joints():
    urdf = BARE.replace("</robot>", ENDS)
    mech = from_text(urdf, {**CONTENT, "frames": {
        "tip": {"link": "middle", "xyz": [0.0, 0.1, 0.0]},
        "middle": {"link": "coupler_end_mount", "xyz": [-0.3, 0.0, 0.0],
                   "rpy": [0.0, 0.0, np.pi / 2]},
    }}, "bars.toml")
    joint, placement = mech.frame_on_joint("tip")
    assert mech.model.names[joint] == "coupler_pin"
    np.testing.assert_allclose(placement.translation, [0.2, 0.0, 0.0], atol=1e-15)
    assert list(mech.frames) == ["tip", "middle"]
    assert mech.frames["tip"].link == "middle"


def test_springs_passives_and_outputs_take_their_names():
    mech = bars(springs=[{"name": "spring", "frames": ["coupler_end", "anchor"],
                          "stiffness": 10.0}],
                frames={**FRAMES, "anchor": {"link": "ground", "xyz": [0.1, -0.8, 0.0]}})
    motion = sp.sweep(mech, "crank", np.linspace(0.0, 1.0, 5))
    position = motion.frame("coupler_end").position
    np.testing.assert_allclose(motion.frame("rocker_end").position, position, atol=1e-13)
    effort = sp.inverse_dynamics(mech, sp.assemble(mech, {"crank": 0.3})).efforts["crank"]
    assert abs(effort) > 1e-3
    rssr = sp.load("rssr")
    content = content_of(rssr)
    content["frames"] = {"end": {"link": "coupler_b"}}
    content["passive"]["coupler_spin"]["axis"] = ["ball_a", "end"]
    renamed = from_text(rssr.urdf, content, "rssr")
    values = {"crank": 0.7}
    np.testing.assert_allclose(
        sp.solve_rates(renamed, sp.assemble(renamed, values), {"crank": 1.0}).a,
        sp.solve_rates(rssr, sp.assemble(rssr, values), {"crank": 1.0}).a, atol=1e-12)


def test_frames_count_for_the_characteristic_length_unless_they_are_far_from_all_joints():
    for x, length in ((-2.0, 3.2), (-9.0, 1.2)):
        far = bars(frames={**FRAMES, "far": {"link": "ground", "xyz": [x, 0.0, 0.0]}})
        assert far.characteristic_length == pytest.approx(length)


def test_they_survive_copies_files_and_reduction():
    mech = bars(frames={**FRAMES, "tip": {"link": "coupler_end", "xyz": [0.0, 0.2, 0.0]},
                        "aside": {"link": "rocker"}})
    again = from_text(mech.urdf, content_of(mech), "bars.toml")
    assert again.frames == pickle.loads(pickle.dumps(mech)).frames == mech.frames
    reduced = sp.reduce(mech, "tip")
    assert reduced.verify().worst < 1e-12
    assert "aside" not in reduced.frames
    assert sp.reduce(mech, "rocker_pin").verify().worst < 1e-12


def test_they_are_listed(tmp_path, run):
    path = bars().save(tmp_path)
    code, text, _ = run("info", path)
    assert code == 0
    assert "frames (2):" in text and "rocker_end   on rocker_pin" in text


def test_names_that_are_taken_missing_or_circular_are_refused():
    refused(r"frames\.crank: .*already", crank={"link": "ground"})
    refused(r"frames\.crank_pin: .*already", crank_pin={"link": "ground"})
    refused(r"frames\.tip: link: no link, joint or frame 'coupel'; did you mean",
            tip={"link": "coupel"})
    refused(r"hangs on itself: \w on \w on", a={"link": "b"}, b={"link": "a"})
    refused(r"hangs on itself", a={"link": "a"})
    refused(r"frames\.tip: link is missing.*'lnik'", tip={"lnik": "crank"})
    refused(r"frames\.tip: xzy is not a key", tip={"link": "crank", "xzy": [0, 0, 0]})
    refused(r"frames\.tip: xyz must be three finite", tip={"link": "crank", "xyz": [0, 0]})
    refused(r"frames\.tip: rpy must be three finite", tip={"link": "crank", "rpy": [0, 0, np.nan]})
    refused("a frame needs a name", **{"": {"link": "crank"}})
    refused("must be a table", tip="crank")


@pytest.mark.slow
def test_a_long_chain_of_frames_ends():
    count = 20_000
    chain = {f"f{k}": {"link": f"f{k + 1}", "xyz": [1e-6, 0.0, 0.0]} for k in range(count)}
    mech = bars(frames={**FRAMES, **chain, f"f{count}": {"link": "crank"}})
    _, placement = mech.frame_on_joint("f0")
    np.testing.assert_allclose(placement.translation, [1e-6 * count, 0.0, 0.0], rtol=1e-10)


def test_keys_of_frames_elsewhere_are_sent_there():
    with pytest.raises(sp.MechanismFileError, match=r"rpy is not a key .* in \[frames.NAME\]"):
        bars(closures=[{**CONTENT["closures"][0], "rpy": [0, 0, 0]}])


numbers = st.floats(-3.0, 3.0, allow_subnormal=False)
triples = st.tuples(numbers, numbers, numbers)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(triples, triples, st.integers(0, 9)), min_size=1, max_size=5))
def test_a_frame_stands_where_the_product_of_its_chain_says(chain):
    frames, places = {}, {}
    for k, (xyz, rpy, on) in enumerate(chain):
        link = f"f{on % k}" if k else "rocker"
        frames[f"f{k}"] = {"link": link, "xyz": list(xyz), "rpy": list(rpy)}
        own = pin.SE3(pin.rpy.rpyToMatrix(np.array(rpy)), np.array(xyz))
        places[f"f{k}"] = places.get(link, pin.SE3.Identity()) * own
    backwards = dict(reversed(frames.items()))
    mech = bars(frames={**FRAMES, **backwards})
    for name, expected in places.items():
        joint, found = mech.frame_on_joint(name)
        assert mech.model.names[joint] == "rocker_pin"
        np.testing.assert_allclose(found.homogeneous, expected.homogeneous, atol=1e-13)
