"""MuJoCo's models: the same bodies, masses and loops as MuJoCo itself has."""

import os
import sys
from pathlib import Path

import numpy as np
import pytest
from beside_mujoco import (
    accelerations,
    beside,
    equality_jacobian,
    mass_matrices,
    placement_gap,
    put,
    random_configuration,
    rank,
    residual,
    without_meshes,
)
from mujoco_files import (
    ANKLE,
    ARMS,
    CASSIE,
    GRIPPER,
    SLIDER,
    closed_by_mujoco,
    mujoco,
    opened,
    written,
)

import spatial_pin as sp

FACTS = {  # file: coordinates, equations, rank, freedoms, passive, drivers
    CASSIE: (32, 12, 10, 22, 2, 10),
    GRIPPER: (8, 7, 5, 3, 0, 1),
    ANKLE: (8, 6, 6, 2, 0, 2),
}
files = pytest.mark.parametrize("file", FACTS, ids=lambda f: f.stem)






def both(tmp_path, text):
    """A mechanism and MuJoCo's model of the same text."""
    path = written(tmp_path, text)
    return beside(sp.load(path), mujoco.MjModel.from_xml_path(str(path)))


# ---------------------------------------------------------------- published robots


@pytest.mark.delicate
@files
def test_a_published_robot_has_its_freedoms(file):
    mech = opened(file)
    nv, equations, rank_, freedoms, passive, drivers = FACTS[file]
    mob = sp.mobility(mech)
    assert mech.model.nv == nv
    assert sum(c.n_rows for c in mech.closures) == equations
    assert (mob.rank, mob.dof, len(mob.passive)) == (rank_, freedoms, passive)
    assert len(mech.drivers) == drivers


@files
def test_bodies_stand_where_mujoco_has_them(file):
    pair, rng = beside(opened(file), without_meshes(file)), np.random.default_rng(1)
    for _ in range(5):
        assert placement_gap(pair, random_configuration(pair.mech, rng)) < 1e-13


@files
def test_the_mass_matrix_is_mujocos(file):
    pair, rng = beside(opened(file), without_meshes(file)), np.random.default_rng(2)
    for _ in range(3):
        ours, theirs = mass_matrices(pair, random_configuration(pair.mech, rng))
        assert np.abs(ours - theirs).max() < 1e-12 * np.abs(theirs).max()


@files
def test_closed_loops_are_closed_in_mujoco(file):
    pair = beside(opened(file), without_meshes(file))
    state = sp.assemble(pair.mech, {})
    assert residual(pair, state.q) < 1e-13
    assert rank(equality_jacobian(pair, state.q)) == FACTS[file][2]


def test_cassie_weighs_what_it_weighs_and_starts_at_home():
    mech = opened(CASSIE)
    assert sum(x.mass for x in mech.inertias.values()) == pytest.approx(33.312, abs=5e-4)
    assert mech.guess["torso_free"][:3] == [0.0, 0.0, 1.0059301]
    assert mech.guess["left-knee"] == -1.1997
    state = sp.assemble(mech, {})
    assert state.placement("torso").translation[2] == pytest.approx(1.0059301, abs=0.01)




def test_cassies_jacobian_is_the_difference_of_an_independent_solution():
    """Base held, springs locked: ten columns, against MuJoCo's kinematics and plain Newton."""
    mech = opened(CASSIE)
    motors = list(mech.drivers)
    springs = [s.joint for s in mech.springs]
    state = sp.assemble(mech, {})
    found = sp.jacobian(mech, state, "left-foot", hold=["base", *springs])
    assert found.shape == (6, 10)
    assert np.array_equal(sp.jacobian(mech, state, "left-foot", hold=["base", "springs"]), found)

    pair = beside(mech, without_meshes(CASSIE))
    put(pair, state.q)
    home, model, data = pair.data.qpos.copy(), pair.model, pair.data
    known = set(range(6)) | {int(model.joint(n).dofadr[0]) for n in motors + springs}
    unknown = np.array(sorted(set(range(model.nv)) - known))
    foot, h = model.body("left-foot").id, 1e-3
    weights = {-2: 1 / 12, -1: -8 / 12, 1: 8 / 12, 2: -1 / 12}  # of fourth order
    for k, name in enumerate(motors):
        twist = np.zeros(6)
        closed_by_mujoco(pair, home, unknown)
        turn = data.xmat[foot].reshape(3, 3).copy()
        rate = np.zeros((3, 3))
        for step, weight in weights.items():
            q = home.copy()
            q[model.joint(name).qposadr[0]] += step * h
            closed_by_mujoco(pair, q, unknown)
            twist[:3] += weight * data.xpos[foot] / h
            rate += weight * data.xmat[foot].reshape(3, 3) / h
        spin = rate @ turn.T
        twist[3:] = spin[2, 1], spin[0, 2], spin[1, 0]
        assert np.abs(found[:, k] - twist).max() < 1e-9, name


@pytest.mark.parametrize("off", [0.05, 0.5, -1.0])
def test_held_springs_stand_where_the_state_has_them_though_a_sweep_begins_far_away(off):
    mech = opened(CASSIE)
    state = sp.assemble(mech)
    springs = [state.mechanism.coordinate(x.joint).q for x in mech.springs]
    knee = state.coordinate("left-knee").value + off + np.linspace(0.0, 0.1, 3)
    foot = np.full(3, state.coordinate("left-foot").value)
    hold = ["base", "springs"]
    for motion in (sp.sweep(mech, "left-knee", knee, guess=state, hold=hold),
                   sp.follow(mech, {"left-knee": knee, "left-foot": foot}, [0.0, 1.0, 2.0],
                             guess=state, hold=hold)):
        assert np.abs(motion.q[:, springs] - state.q[springs]).max() < 1e-12
        assert not any(event.kind == "released" for event in motion.events)


def test_the_grippers_fingers_stay_coupled_and_its_tendon_drives_them():
    mech = opened(GRIPPER)
    assert [c.type for c in mech.closures] == ["spherical", "spherical", "coupling"]
    assert mech.drivers["fingers_actuator"].joint == "right_driver_joint"
    state = sp.assemble(mech, {"fingers_actuator": 0.4})
    assert state.coordinate("left_driver_joint").value == pytest.approx(0.4, abs=1e-13)


def motor_angle(pitch, roll, side, height, anchor, hold):
    """Motor angle of the ankle by hand: the rod's length is that of the zero pose."""
    def turned(axis, angle, v):
        c, s = np.cos(angle), np.sin(angle)
        i, j = [(1, 2), (2, 0), (0, 1)][axis]
        out = np.array(v, dtype=float)
        out[i], out[j] = c * v[i] - s * v[j], s * v[i] + c * v[j]
        return out

    def end(pitch, roll):
        return turned(1, pitch, np.array([0.0, 0.0, -0.017558]) + turned(0, roll, hold))

    motor, anchor = np.array([0.022, 0.0, height]), np.array(anchor)
    length2 = np.sum((motor + anchor - end(0.0, 0.0)) ** 2)
    d = motor - end(pitch, roll)
    # |d + Rx(angle) anchor|^2 = length^2:  a cos + b sin = c
    a = 2 * (d[1] * anchor[1] + d[2] * anchor[2])
    b = 2 * (d[2] * anchor[1] - d[1] * anchor[2])
    c = length2 - d @ d - anchor @ anchor - 2 * d[0] * anchor[0]
    middle, half = np.arctan2(b, a), np.arccos(c / np.hypot(a, b))
    return min((middle - half, middle + half), key=lambda x: abs(np.arctan2(np.sin(x), np.cos(x))))


@pytest.mark.parametrize("pitch, roll", [(0.0, 0.0), (0.3, 0.1), (-0.5, 0.2), (0.4, -0.25)])
def test_the_ankles_motors_and_its_pitch_and_roll_obey_the_closed_form(pitch, roll):
    right = motor_angle(pitch, roll, -1, 0.21587, (0.0175, -0.016359, -0.0046245),
                        (0.022, -0.015, 0.0079999))
    left = motor_angle(pitch, roll, 1, 0.15087, (0.013, 0.016529, -0.0039746),
                       (0.022, 0.015, 0.0079999))
    mech = opened(ANKLE)
    state = sp.assemble(mech, {"pitch_joint": pitch, "roll_joint": roll})
    assert state.coordinate("right_motor_joint").value == pytest.approx(right, abs=1e-12)
    assert state.coordinate("left_motor_joint").value == pytest.approx(left, abs=1e-12)
    back = sp.assemble(mech, {"right_motor_joint": right, "left_motor_joint": left})
    assert back.coordinate("pitch_joint").value == pytest.approx(pitch, abs=1e-12)
    assert back.coordinate("roll_joint").value == pytest.approx(roll, abs=1e-12)


# ---------------------------------------------------------------- everything a body may have

ODD = """
<compiler angle="degree" eulerseq="zyx"/><option gravity="0 1 -3"/>
<default><joint armature="0.01"/><geom contype="0" conaffinity="0"/></default>
<worldbody>
  <geom type="plane" size="1 1 .1"/><geom type="box" size=".1 .2 .3" pos="3 3 3"/>
  <site name="ground" pos="1 1 1" euler="10 20 30"/>
  <body name="a" pos="1 2 3" euler="10 90 30">
    <joint name="h" axis="1 1 0" pos=".1 .2 .3" ref="20" range="-30 40" damping=".2"
           frictionloss=".3"/>
    <joint type="slide" axis="1 0 2" pos=".3 0 0" ref=".1"/><joint axis="0 0 1"/>
    <geom size=".1"/><site name="s1" pos=".1 0 0"/>
    <body pos="0 .1 0"><geom size=".1"/>
      <body name="deep" euler="0 30 0" pos=".1 0 0">
        <inertial pos=".01 .02 .03" mass="2" fullinertia=".02 .03 .04 .001 .002 -.001"/>
        <joint type="ball" pos="0 0.2 .1" damping=".4"/></body></body></body>
  <body name="b" pos="0 0 4" euler="40 50 60"><freejoint/><geom size=".2" pos=".1 .1 .1"/>
    <site name="s2" quat="1 2 3 4" pos=".1 .2 .3"/><site name="a" pos="0 1 0"/>
    <body name="slider" pos="1 0 0" quat="1 1 0 0">
      <joint name="a" type="slide" axis="0 1 1" range="-1 2" limited="true"/>
      <joint name="b_free" axis="0 1 1"/><geom size=".1"/></body></body>
  <body name="fixed" pos="1 0 0" euler="0 0 45"><geom size=".1"/>
    <body name="pendulum" pos="0 0 1"><joint axis="0 1 0"/><geom size=".1" pos="0 0 -1"/></body>
  </body>
</worldbody>"""


def test_every_kind_of_joint_body_and_frame_stands_where_mujoco_has_it(tmp_path):
    pair, rng = both(tmp_path, ODD), np.random.default_rng(3)
    for _ in range(5):
        q = random_configuration(pair.mech, rng)
        assert placement_gap(pair, q) < 1e-13
        ours, theirs = mass_matrices(pair, q)
        assert np.abs(ours - theirs).max() < 1e-12 * np.abs(theirs).max()
    assert pair.mech.model.gravity.linear.tolist() == [0.0, 1.0, -3.0]


def test_forces_are_mujocos(tmp_path):
    """Weight, springs, dampers and armatures of an open tree, moving."""
    text = ODD.replace('frictionloss=".3"', 'stiffness="3" springref="5"').replace(
        "</worldbody>", """</worldbody><tendon><spatial name="rope" stiffness="30" damping="2"
        springlength=".2"><site site="s1"/><site site="s2"/></spatial></tendon>""")
    rotor = 'armature=".5" damping=".7"' if hasattr(mujoco.MjsActuator, "armature") else ""
    text += f'<actuator><motor joint="h" gear="3" {rotor}/><motor joint="h" {rotor}/></actuator>'
    pair, rng = both(tmp_path, text), np.random.default_rng(7)
    for _ in range(3):
        ours, theirs = accelerations(pair, random_configuration(pair.mech, rng), rng)
        assert np.abs(ours - theirs).max() < 1e-10 * np.abs(theirs).max()


def test_joints_keep_mujocos_coordinates_limits_and_resistances(tmp_path):
    pair = both(tmp_path, ODD)
    model = pair.mech.model
    h = model.idx_qs[model.getJointId("h")]
    assert model.lowerPositionLimit[h] == pytest.approx(np.radians(-30))
    assert model.upperPositionLimit[h] == pytest.approx(np.radians(40))
    v = model.idx_vs[model.getJointId("h")]
    assert (model.damping[v], model.upperDryFrictionLimit[v], model.armature[v]) == (0.2, 0.3, 0.01)
    slide = model.idx_qs[model.getJointId("a_slide")]
    assert model.upperPositionLimit[slide] == np.inf
    assert pair.mech.guess["h"] == pytest.approx(np.radians(20))  # the pose that the file shows
    put(pair, sp.assemble(pair.mech, {}).q)
    assert np.abs(pair.data.qpos - pair.model.qpos0).max() < 1e-15


def test_names_that_are_taken_or_missing_become_unique(tmp_path):
    mech = both(tmp_path, ODD).mech
    assert {"a_slide", "a_hinge", "deep_ball", "b_free", "b_free_2"} <= set(mech.model.names)
    assert {"world", "a", "a_site", "body_2", "s1"} <= set(mech.links)


# ---------------------------------------------------------------- equalities

TENDONS = """<tendon>
  <spatial name="rope"><site site="sf"/><site site="sv"/></spatial>
  <spatial name="belt"><site site="sf"/><site site="sv"/><site site="w"/></spatial>
  <fixed name="both"><joint joint="u1" coef="2"/><joint joint="v2" coef="-.7"/></fixed>
  <fixed name="one"><joint joint="u1" coef="2"/></fixed>
  <fixed name="other"><joint joint="u2" coef=".6"/></fixed>
  <fixed name="three"><joint joint="u1" coef="2"/><joint joint="u2" coef="1"/>
    <joint joint="v2" coef="-.7"/></fixed></tendon>"""
EQUALITIES = {
    "connect of bodies": '<connect body1="v_end" body2="f" anchor=".1 .2 .3"/>',
    "connect to the world": '<connect body1="v" anchor=".1 .2 .3"/>',
    "connect of sites": '<connect site1="sf" site2="sv"/>',
    "connect of a site and the world": '<connect site1="sf" site2="w"/>',
    "two connects": '<connect body1="f" body2="v" anchor=".1 .2 .3"/>'
                    '<connect body1="f" body2="v" anchor=".1 .5 .3"/>',
    "two connects on welded bodies, swapped": '<connect body1="f" body2="v_end" anchor=".1 .2 .3"/>'
                    '<connect body1="v_end" body2="f_tip" anchor=".4 .1 .3"/>',
    "three connects": '<connect body1="f" body2="v" anchor=".1 .2 .3"/>'
                    '<connect body1="v" body2="f" anchor=".1 .5 .3"/>'
                    '<connect body1="f_tip" body2="v" anchor=".2 .5 .1"/>',
    "weld of bodies": '<weld body1="v" body2="f"/>',
    "weld with a pose": '<weld body1="v" body2="f" relpose=".1 .2 .3 1 .2 .3 .4"/>',
    "weld with pose and anchor": '<weld body1="v" body2="f" relpose=".1 .2 .3 1 .2 .3 .4" '
                                 'anchor=".3 0 .1"/>',
    "weld to the world": '<weld body1="f_tip" relpose=".1 .2 .3 1 .2 .3 .4"/>',
    "weld of points only": '<weld body1="v" body2="f" relpose=".1 .2 .3 1 .2 .3 .4" '
                           'anchor=".3 0 .1" torquescale="0"/>',
    "weld of sites": '<weld site1="sv" site2="sf"/>',
    "coupling": '<joint joint1="u2" joint2="u1" polycoef=".1 -2 0 0 0"/>',
    "coupling of angle and slide": '<joint joint1="v2" joint2="u1" polycoef="0 .4 0 0 0"/>',
    "held hinge": '<joint joint1="u1" polycoef=".2 0 0 0 0"/>',
    "held slide": '<joint joint1="v2" polycoef=".2 0 0 0 0"/>',
    "tendon over two joints": '<tendon tendon1="both"/>',
    "two tendons": '<tendon tendon1="one" tendon2="other" polycoef=".1 .5 0 0 0"/>',
    "tendon over one joint": '<tendon tendon1="one" polycoef=".1 0 0 0 0"/>',
    "straight tendon": '<tendon tendon1="rope" polycoef=".1 0 0 0 0"/>',
    "polynomial": '<joint name="cam" joint1="u1" joint2="u2" polycoef=".1 1 .5 0 -.3"/>',
    "polynomial of a slide": '<joint joint1="v2" joint2="u1" polycoef="0 .1 .5 .2 0"/>',
    "tendon over three joints": '<tendon name="rope" tendon1="three" polycoef=".1 0 0 0 0"/>',
    "two tendons over three joints": '<tendon tendon1="both" tendon2="other" '
                                     'polycoef="0 1 0 0 0"/>',
    "straight tendon over three sites": '<tendon tendon1="belt" polycoef=".1 0 0 0 0"/>',
    "coupling without slope": '<joint joint1="u1" joint2="v2" polycoef=".2 0 0 0 0"/>',
}


@pytest.mark.parametrize("equality", EQUALITIES.values(), ids=EQUALITIES)
def test_an_equality_is_the_same_set_of_configurations(tmp_path, equality):
    """Closed here is closed there; the same motions are left; MuJoCo's own pose is closed here."""
    pair = both(tmp_path, f"{ARMS}{TENDONS}<equality>{equality}</equality>")
    rng = np.random.default_rng(4)
    for _ in range(3):
        start = pair.mech.neutral + 0.3 * (random_configuration(pair.mech, rng) - pair.mech.neutral)
        for i in range(1, pair.mech.model.njoints):
            if pair.mech.model.nqs[i] in (4, 7):
                end = pair.mech.model.idx_qs[i] + pair.mech.model.nqs[i]
                start[end - 4:end] /= np.linalg.norm(start[end - 4:end])
        q = sp.assemble(pair.mech, {}, guess=start).q
        assert residual(pair, q) < 1e-12
        ours, theirs = sp.closure_jacobian(pair.mech, q), equality_jacobian(pair, q)
        assert rank(ours) == rank(theirs) == rank(np.vstack([ours, theirs])) == len(ours)


def test_two_connects_on_one_axis_are_a_hinge(tmp_path):
    hinge = both(tmp_path, f"{ARMS}<equality>{EQUALITIES['two connects']}</equality>").mech
    assert [(c.type, c.n_rows) for c in hinge.closures] == [("revolute", 5)]
    weld = both(tmp_path, f"{ARMS}<equality>{EQUALITIES['three connects']}</equality>").mech
    assert [(c.type, c.n_rows) for c in weld.closures] == [("weld", 6)]


def test_connects_whose_points_cannot_all_meet_stay_balls(tmp_path):
    text = ARMS.replace('<site name="sf"', '<site name="sf2" pos="1 0 0"/><site name="sf"').replace(
        '<site name="sv"', '<site name="sv2" pos="0 0 0"/><site name="sv"')
    mech = both(tmp_path, f"""{text}<equality><connect site1="sf" site2="sv"/>
        <connect site1="sf2" site2="sv2"/></equality>""").mech
    assert [c.type for c in mech.closures] == ["spherical", "spherical"]


@pytest.mark.parametrize("equality, name", [
    ('<tendon name="two" tendon1="rope" tendon2="belt" polycoef="0 1 0 0 0"/>',
     "two.*neither a coupling"),
    ('<tendon tendon1="one" tendon2="other" polycoef="0 1 2 0 0"/>', "number 0.*neither"),
])
def test_an_equality_without_counterpart_is_refused_by_name(tmp_path, equality, name):
    path = written(tmp_path, f"{ARMS}{TENDONS}<equality>{equality}</equality>")
    with pytest.raises(sp.MechanismFileError, match=name):
        sp.load(path)


def test_an_equality_that_is_not_active_is_omitted_and_reported(tmp_path):
    path = written(tmp_path, f"""{ARMS}<equality>
        <weld name="off" body1="v" body2="f" active="false"/></equality>""")
    with pytest.warns(UserWarning, match="'off' is not active"):
        assert not sp.load(path).closures


# ---------------------------------------------------------------- drivers, springs, keys



def test_actuators_are_drivers_once_a_joint(tmp_path):
    path = written(tmp_path, f"""{SLIDER}<actuator>
        <motor name="turn" joint="q"/><velocity joint="q"/><position joint="s"/>
        <general name="grip" tendon="both"/></actuator>""")
    mech = sp.load(path)
    assert {k: d.joint for k, d in mech.drivers.items()} == {"turn": "q", "s": "s"}
    path = written(tmp_path, f'{SLIDER}<actuator><general name="grip" tendon="both"/></actuator>')
    assert {k: d.joint for k, d in sp.load(path).drivers.items()} == {"grip": "q"}


@pytest.mark.parametrize("actuator, why", [
    ('<motor name="x" tendon="apart"/>', "moves more than one coordinate"),
    ('<motor name="x" tendon="string"/>', "moves more than one coordinate"),
    ('<motor name="x" joint="ball" gear="0 0 1"/>', "several coordinates"),
    ('<motor name="x" site="sa"/>', "transmission"),
    ('<motor name="x" joint="q"/>', "joint 'q' is coupled to one that has a driver"),
])
def test_an_actuator_that_is_no_driver_is_reported(tmp_path, actuator, why):
    path = written(tmp_path, f'{SLIDER}<actuator><motor name="p" joint="p"/>{actuator}</actuator>')
    with pytest.warns(UserWarning, match=f"actuator 'x' is no driver.*{why}"):
        assert list(sp.load(path).drivers) == ["p"]


def test_springs_are_mujocos(tmp_path):
    pair = both(tmp_path, SLIDER)
    springs = {s.joint or s.name: (s.stiffness, s.free) for s in pair.mech.springs}
    assert springs == {"string": (9.0, 0.4), "q": (3.0, pytest.approx(np.radians(20))),
                       "s": (7.0, 0.2)}


@pytest.mark.parametrize("keys, q", [
    ('<key name="up" qpos="1 0 0 1 0 0 0 0 0 0 1 0 0 0"/>'
     '<key name="home" qpos="2 .1 0 .5 .5 .5 .5 3 2 1 0 0 0 1"/>', 2.0),
    ('<key name="up" qpos="1 0 0 1 0 0 0 0 0 0 1 0 0 0"/><key qpos="0 0 0 1 0 0 0 0 0 0 1 0 0 0"/>',
     1.0)])
def test_the_key_home_else_the_first_is_the_guess(tmp_path, keys, q):
    pair = both(tmp_path, f"{SLIDER.split('<tendon>')[0]}<keyframe>{keys}</keyframe>")
    assert pair.mech.guess["q"] == q
    put(pair, sp.assemble(pair.mech, {}).q)
    names = [pair.model.key(k).name for k in range(2)]
    expected = pair.model.key_qpos[names.index("home") if "home" in names else 0]
    assert np.abs(pair.data.qpos - expected).max() < 1e-15


def test_what_the_file_switches_off_is_off(tmp_path):
    flags = """<option><flag gravity="disable" spring="disable" damper="disable" limit="disable"
        frictionloss="disable"/></option>"""
    mech = sp.load(written(tmp_path, flags + ODD.replace('gravity="0 1 -3"', "")))
    assert not np.any(mech.model.gravity.linear) and not mech.springs
    assert not np.any(mech.model.damping) and not np.any(mech.model.upperDryFrictionLimit)
    assert np.all(np.isinf(mech.model.upperPositionLimit))


LOST = {
    "gravity compensation of bodies .b.": SLIDER.replace('name="b"', 'name="b" gravcomp="1"'),
    "fluid": f'<option density="1.2"/>{SLIDER}',
    "tendon 'both': its stiffness": SLIDER.replace('name="both"', 'name="both" stiffness="2"'),
    "tendon 'string': its range": SLIDER.replace('name="string"', 'name="string" range="0 9"'),
    "ball joint 'ball': its range": SLIDER.replace('type="ball"', 'type="ball" range="0 1"'),
    "joint 'ball': a stiffness": SLIDER.replace('type="ball"', 'type="ball" stiffness="2"'),
    "mocap body 'm'": SLIDER.replace(
        "</worldbody>", '<body name="m" mocap="true"/></worldbody>'),
    "height field": f"""<asset><hfield name="hills" nrow="2" ncol="2" size="1 1 1 1"/></asset>
        {SLIDER.replace("<worldbody>", '<worldbody><geom type="hfield" hfield="hills"/>')}""",
}


@pytest.mark.parametrize("told", LOST)
def test_what_acts_in_mujoco_and_not_here_is_reported(told, tmp_path):
    with pytest.warns(UserWarning, match=told):
        sp.load(written(tmp_path, LOST[told]))


# ---------------------------------------------------------------- shapes

TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 2 0\nv 0 0 3\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
SOLIDS = """
<compiler meshdir="meshes"/>
<asset><mesh name="m" file="tet.obj" {asset}/>
  <material name="blue" rgba="0 0 1 1"/></asset>
<worldbody><body name="a" pos="0 0 1"><joint/>
  <geom type="mesh" mesh="m" material="blue" pos=".1 .2 .3" quat="1 2 3 4" contype="0"
        conaffinity="0"/>
  <geom type="box" size=".1 .2 .3" rgba="1 0 0 .5" group="3" mass="1"/></body></worldbody>"""


def with_mesh(tmp_path, asset="", text=SOLIDS):
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "tet.obj").write_text(TETRAHEDRON, encoding="utf-8")
    return both(tmp_path, text.format(asset=asset))


@pytest.mark.parametrize("asset", [
    "", 'scale=".1 -.2 .3"', 'refpos="1 2 3" scale="1 2 3"',
    'refpos="1 2 3" refquat="1 2 0 1" scale=".2 .2 .2"'])
def test_a_mesh_is_drawn_where_mujoco_has_it(tmp_path, asset):
    """MuJoCo moves a mesh to its centre of mass and turns it; the file's own points do not."""
    pair = with_mesh(tmp_path, asset)
    model, geom = pair.model, pair.mech.visual_model.geometryObjects[0]
    put(pair, pair.mech.neutral)
    turn, centre = pair.data.geom_xmat[0].reshape(3, 3), pair.data.geom_xpos[0]
    theirs = model.mesh_vert.astype(float) @ turn.T + centre
    shape = geom.geometry
    points = np.array(shape.vertices())
    body = pair.mech.model.jointPlacements[1] * geom.placement
    ours = np.array([body.act(p) for p in points])
    gaps = np.linalg.norm(ours[:, None] - theirs[None], axis=2)
    assert gaps.min(axis=0).max() < 1e-6 and gaps.min(axis=1).max() < 1e-6  # float32 there
    assert geom.meshColor.tolist() == [0.0, 0.0, 1.0, 1.0]


def test_a_box_that_is_fitted_to_a_mesh_has_its_size(tmp_path):
    pair = with_mesh(tmp_path, text=SOLIDS.replace('type="mesh" mesh="m"', 'type="box" mesh="m"'))
    box = pair.mech.visual_model.geometryObjects[0]
    assert 2.0 * pair.model.geom_size[0] == pytest.approx(2.0 * box.geometry.halfSide)
    put(pair, pair.mech.neutral)
    placement = pair.mech.model.jointPlacements[1] * box.placement
    assert placement.translation == pytest.approx(pair.data.geom_xpos[0], abs=1e-14)
    assert placement.rotation.ravel() == pytest.approx(pair.data.geom_xmat[0], abs=1e-14)


def test_shapes_that_touch_nothing_are_drawn_and_hidden_ones_only_collide(tmp_path):
    mech = with_mesh(tmp_path).mech
    assert len(mech.visual_model.geometryObjects) == 1
    assert len(mech.collision_model.geometryObjects) == 1


def test_an_inertia_that_comes_from_a_mesh_is_mujocos(tmp_path):
    pair = with_mesh(tmp_path)
    ours, theirs = mass_matrices(pair, pair.mech.neutral)
    assert np.abs(ours - theirs).max() < 1e-12 * np.abs(theirs).max()
    with pytest.warns(UserWarning) as seen:
        (tmp_path / "meshes" / "tet.obj").unlink()
        assert not sp.load(tmp_path / "model.xml").inertias
    assert any("inertia of bodies (a) comes from mesh files" in str(w.message) for w in seen)


@pytest.mark.parametrize("folder", ["", "gone/", r"C:\gone\\", "/gone/there/"])
def test_folders_of_meshes_are_stripped_where_the_file_says_so(tmp_path, folder):
    stripped = SOLIDS.replace("<compiler", "<compiler strippath='true'").replace(
        'file="', f'file="{folder}')
    pair = with_mesh(tmp_path, text=stripped)
    ours, theirs = mass_matrices(pair, pair.mech.neutral)
    assert np.abs(ours - theirs).max() < 1e-12 * np.abs(theirs).max()
    assert len(pair.mech.visual_model.geometryObjects) == 1


def test_an_ellipsoid_is_drawn_with_its_own_axes(tmp_path):
    mech = both(tmp_path, """<worldbody><body name="a"><joint/>
        <geom type="ellipsoid" size=".1 .2 .3" contype="0" conaffinity="0"/></body></worldbody>"""
                ).mech
    shape = mech.visual_model.geometryObjects[0].geometry
    points = np.array(shape.vertices())
    assert np.abs(points).max(axis=0) == pytest.approx([0.1, 0.2, 0.3])
    assert np.linalg.norm(points / [0.1, 0.2, 0.3], axis=1) == pytest.approx(1.0)


# ---------------------------------------------------------------- files


@pytest.mark.parametrize("before", [
    "<!-- ---- an arm -- as drawn ---- -->", "<!-- <robot/> -->", "<!-- \xfcber -->", "\ufeff",
    "<?xml version='1.0' encoding='utf-8'?>\n<!-- first -->"])
def test_what_mujoco_reads_is_read(before, tmp_path):
    """Comments of all kinds and encodings: MuJoCo is less strict than XML."""
    path = tmp_path / "arms.xml"
    coding = "latin-1" if "\xfc" in before else "utf-8"
    path.write_text(f"{before}<mujoco>{ARMS}</mujoco>", encoding=coding)
    assert sp.load(path).model.nv == sp.load(written(tmp_path, ARMS)).model.nv


def test_an_xml_file_that_is_no_mjcf_is_reported_so(tmp_path):
    path = tmp_path / "other.xml"
    path.write_text("<scene/>", encoding="utf-8")
    with pytest.raises(sp.MechanismFileError, match=r"none of: .*MJCF"):
        sp.load(path)


def test_what_mujoco_refuses_is_refused_in_its_words(tmp_path):
    path = written(tmp_path, "<worldbody><body><joint type='spin'/></body></worldbody>")
    with pytest.raises(sp.MechanismFileError, match=r"model.xml: MuJoCo cannot read it: .*spin"):
        sp.load(path)


def test_without_mujoco_the_error_names_the_package_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    path = written(tmp_path, ARMS)
    with pytest.raises(sp.MechanismFileError, match=r"pip install 'spatial_pin\[mjcf\]'"):
        sp.load(path)


def test_what_mujoco_warns_of_is_reported_and_not_written_to_a_log(tmp_path, monkeypatch):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    path = written(tmp_path, ARMS + '<custom><numeric name="n" data="nan"/></custom>')
    with pytest.warns(UserWarning, match="MuJoCo: .*NaN"):
        sp.load(path)
    assert not list(Path().iterdir())


def test_endless_copies_are_refused_before_they_are_made(tmp_path):
    path = written(tmp_path, """<worldbody><replicate count="100000"><replicate count="100000">
        <body><joint/><geom size="1"/></body></replicate></replicate></worldbody>""")
    with pytest.raises(sp.MechanismFileError, match="copies"):
        sp.load(path)


@pytest.mark.parametrize(("joint", "actuators", "efforts"), [
    ("", ['gear="2" forcerange="-3 3"'], (-6.0, 6.0)),
    ("", ['gear="-2" forcerange="-1 3"'], (-6.0, 2.0)),
    ("", ['gear="2" forcerange="-3 3"', 'gear="-1" forcerange="-1 2"'], (-8.0, 7.0)),
    ("", ['gear="2" forcerange="-3 3"', 'gear="1"'], (-np.inf, np.inf)),
    ('actuatorfrcrange="-4 9"', ['gear="2" forcerange="-3 3"'], (-4.0, 6.0)),
    ('actuatorfrcrange="-4 4"', ['gear="2"'], (-4.0, 4.0)),
])
def test_efforts_are_those_of_the_actuators_at_the_joint(tmp_path, joint, actuators, efforts):
    motors = "".join(f'<motor joint="j" {x}/>' for x in actuators)
    path = written(tmp_path, f"""<worldbody><body><joint name="j" {joint}/><geom size=".1"/></body>
        </worldbody><actuator>{motors}</actuator>""")
    model = sp.load(path).model
    assert (model.lowerEffortLimit[0], model.upperEffortLimit[0]) == efforts
    if np.isfinite(efforts[0]):  # and MuJoCo has the same
        theirs = mujoco.MjModel.from_xml_path(str(path))
        data = mujoco.MjData(theirs)
        for end in efforts:
            data.ctrl[:] = np.sign(end) * 100.0 * theirs.actuator_gear[:, 0]
            mujoco.mj_forward(theirs, data)
            assert data.qfrc_actuator[0] == end


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes on this system")
@pytest.mark.parametrize(("file", "says"), [("pipe.xml", "is a pipe"), (".", "is a folder")])
@pytest.mark.parametrize("element", ["<include file='{}'/>",
                                     "<asset><model name='m' file='{}'/></asset>"])
def test_an_include_of_no_file_is_refused_by_who_includes_it(tmp_path, element, file, says):
    os.mkfifo(tmp_path / "pipe.xml")
    path = written(tmp_path, element.format(file) + "<worldbody/>")
    with pytest.raises(sp.MechanismFileError, match=rf"model\.xml: an include: .*{says}"):
        sp.load(path)


def test_included_files_and_attached_models_are_read(tmp_path):
    (tmp_path / "sub").mkdir()
    body = '<worldbody><body name="{}"><joint/><geom size=".1"/></body></worldbody>'
    written(tmp_path / "sub", body.format("c"), "child.xml")
    written(tmp_path, body.format("i"), "part.xml")
    mech = both(tmp_path, """<asset><model name="ch" file="sub/child.xml"/></asset>
        <include file="part.xml"/><worldbody><frame pos="1 0 0">
        <attach model="ch" body="c" prefix="p_"/></frame></worldbody>""").mech
    assert {"i", "p_c"} <= set(mech.links)
    assert mech.name == "model"
