"""Forces from outside in simulations: constant, in rows of times, and as functions."""

import mechanisms as known
import numpy as np
import pinocchio as pin
import pytest
from masses import heavy
from variety import few

import spatial_pin as sp
from spatial_pin.errors import UnknownNameError

BODY = (2.0, (0.1, 0.02, 0.03), (0.02, 0.03, 0.04))
FORCE, MOMENT = np.array([0.3, -0.2, 0.5]), np.array([0.02, 0.05, -0.03])


def bead(folder, gravity=0.0):
    """A body of 2 kg on a slide along z."""
    tree = heavy(known.sliding("s", "ground", "bead", axis=(0, 0, 1)), bead=BODY)
    return known.load(folder, "bead", tree, f"gravity = [0.0, 0.0, {-gravity}]\n")


def wheel(folder):
    """A body on a hinge about a tilted axis; `rim` lies off the axis."""
    tree = known.turning("pin", "ground", "disc", axis=(0, 0.6, 0.8))
    tree += known.point("rim", "disc", (0.3, 0.1, 0.2), (0.4, 0.5, 0.6))
    return known.load(folder, "wheel", heavy(tree, disc=BODY), "gravity = [0.0, 0.0, 0.0]\n")


def forms(times):
    """The same force, given in three ways."""
    force = pin.Force(FORCE, MOMENT)
    return [force, np.tile(force.vector, (len(times), 1)), lambda t, state: force]


@pytest.mark.parametrize("formulation", ["independent", "projected"])
@pytest.mark.parametrize("form", range(3), ids=["constant", "rows", "function"])
@pytest.mark.parametrize("name, frame, driver", [
    ("four_bar", "coupler_b", "crank"), ("rssr", "rocker_b", "crank")])
def test_accelerations_are_those_of_forward_dynamics(name, frame, driver, form, formulation):
    mech, times = sp.load(name), np.linspace(0.0, 0.05, 6)
    state = sp.solve_rates(mech, sp.assemble(mech, {driver: 0.7}), {driver: 2.0})
    force = forms(times)[form]
    given = (lambda t, s: {frame: force(t, s)}) if callable(force) else {frame: force}
    motion = sp.simulate(mech, state, 0.05, times=times, external=given,
                         accuracy=sp.Accuracy(formulation=formulation))
    for row in (0, 5):
        want = sp.forward_dynamics(mech, motion.state(row),
                                   external={frame: pin.Force(FORCE, MOMENT)}).a
        assert motion.a[row] == pytest.approx(want, abs=1e-6 * np.abs(want).max())
    assert motion.energy_drift < 1e-8 and not motion.by_drivers
    free = sp.simulate(mech, state, 0.05, times=times)
    assert np.abs(motion.q[-1] - free.q[-1]).max() > 1e-5


def test_a_weight_from_outside_is_a_weight(tmp_path):
    mech = sp.load("four_bar")
    state = sp.assemble(mech, {"crank": 1.0})
    bare = sp.load("four_bar")
    bare.model.gravity = pin.Motion.Zero()
    data = mech.model.createData()
    lifted = {}
    for joint, inertia in enumerate(mech.model.inertias):
        if joint and inertia.mass:
            arm = pin.SE3(np.eye(3), inertia.lever)
            lifted[mech.model.names[joint]] = (inertia.mass, arm)

    def weights(t, at):
        pin.forwardKinematics(mech.model, data, at.q)
        found = {}
        for name, (mass, arm) in lifted.items():
            pull = mass * mech.model.gravity.linear
            turned = data.oMi[mech.joint_id(name)].rotation @ arm.translation
            found[name] = pin.Force(pull, np.cross(turned, pull))
        return found

    times = np.linspace(0.0, 0.3, 4)
    want = sp.simulate(mech, state, 0.3, times=times)
    found = sp.simulate(bare, sp.State(bare, state.q, closure_error=0.0), 0.3, times=times,
                        external=weights)
    assert found.q == pytest.approx(want.q, abs=1e-8)


def test_rows_are_linear_between_their_times(tmp_path):
    """A force that grows from 0 to 6 N in a second, then falls to 0 in two."""
    mech, times = bead(tmp_path), np.array([0.0, 1.0, 3.0])
    rows = np.zeros((3, 6))
    rows[1] = [5.0, -7.0, 6.0, 1.0, 2.0, 3.0]  # all but the pull along the slide is borne
    motion = sp.simulate(mech, sp.assemble(mech), 3.0, times=times, external={"bead": rows})
    assert motion.coordinate("s").rate == pytest.approx([0.0, 1.5, 4.5], rel=1e-8)
    assert motion.coordinate("s").value == pytest.approx([0.0, 0.5, 7.5], rel=1e-8)
    assert motion.work[-1] == pytest.approx(0.5 * 2.0 * 4.5**2, rel=1e-8)


@pytest.mark.parametrize("integrator", few(["automatic", "Radau", "LSODA"], "automatic"))
def test_no_step_leaps_over_a_short_pull(integrator, tmp_path):
    """One row of a thousand: nothing before and behind it tells of it."""
    mech, rows = bead(tmp_path), np.zeros((1001, 6))
    rows[700, 2] = 1000.0
    motion = sp.simulate(mech, sp.assemble(mech), 10.0, external={"bead": rows},
                         accuracy=sp.Accuracy(integrator=integrator))
    assert motion.coordinate("s").rate[-1] == pytest.approx(5.0, rel=1e-5)
    assert not motion.coordinate("s").rate[:699].any()


def test_rows_that_begin_later_hold_their_first_value_until_then(tmp_path):
    mech = bead(tmp_path)
    motion = sp.simulate(mech, sp.assemble(mech), 2.0, times=[1.0, 2.0],
                         external={"bead": np.tile([0, 0, 4.0, 0, 0, 0], (2, 1))})
    assert motion.coordinate("s").value == pytest.approx([1.0, 4.0], rel=1e-9)


@pytest.mark.parametrize("form", range(3), ids=["constant", "rows", "function"])
def test_forces_act_at_the_origin_of_the_frame_in_world_axes(form, tmp_path):
    """Euler's equation about the hinge, the arm turning with the body, the force not."""
    mech, times = wheel(tmp_path), np.linspace(0.0, 1.0, 11)
    force = forms(times)[form]
    given = (lambda t, s: {"rim": force(t, s)}) if callable(force) else {"rim": force}
    motion = sp.simulate(mech, sp.assemble(mech), 1.0, times=times, external=given)
    axis = np.array([0.0, 0.6, 0.8])
    turning, arm = motion.a[:, 0], motion.frame("rim").position
    inertia = mech.model.inertias[1]
    about = axis @ (inertia.inertia + inertia.mass * (
        inertia.lever @ inertia.lever * np.eye(3) - np.outer(inertia.lever, inertia.lever))) @ axis
    want = (np.cross(arm, FORCE) + MOMENT) @ axis / about
    assert turning == pytest.approx(want, rel=1e-6)


def test_a_function_sees_time_and_state(tmp_path):
    """A spring and a damper from outside, pushed by a wave, as Lagrange says."""
    mech = bead(tmp_path)

    def pull(t, state):
        value, rate, _ = state.coordinate("s")
        return {"bead": pin.Force(np.array([0, 0, np.sin(t) - 8.0 * value - rate]), np.zeros(3))}

    times = np.linspace(0.0, 5.0, 21)
    motion = sp.simulate(mech, sp.assemble(mech, {"s": 0.3}), 5.0, times=times, external=pull,
                         accuracy=sp.Accuracy(time_tolerance=1e-11))
    # 2 x'' + x' + 8 x = sin t: the forced part, and the free one that fits the start
    forced = np.linalg.solve([[6.0, -1.0], [1.0, 6.0]], [1.0, 0.0])
    decay, turn = 0.25, np.sqrt(4.0 - 0.25**2)
    c = 0.3 - forced[1]
    s = (decay * c - forced[0]) / turn
    want = forced[0] * np.sin(times) + forced[1] * np.cos(times) + np.exp(-decay * times) * (
        c * np.cos(turn * times) + s * np.sin(turn * times))
    assert motion.coordinate("s").value == pytest.approx(want, abs=1e-8)


def test_drives_bear_what_acts_from_outside(tmp_path):
    mech = sp.load("four_bar")
    law, force = sp.laws.constant_speed(0.4, 5.0), {"rocker_b": pin.Force(FORCE, MOMENT)}
    state = sp.solve_rates(mech, sp.assemble(mech, {"crank": 0.4}), {"crank": 5.0})
    motion = sp.simulate(mech, state, 0.5, times=np.linspace(0, 0.5, 6), drives={"crank": law},
                         external=force)
    loads = sp.kinetostatics(mech, motion, external=force)
    assert motion.efforts["crank"] == pytest.approx(loads.efforts["crank"], rel=1e-6)
    alone = sp.kinetostatics(mech, motion).efforts["crank"]
    assert np.abs(loads.efforts["crank"] - alone).max() > 1e-3


def test_a_body_that_floats_is_pushed_where_it_is(tmp_path):
    """Held by nothing, and turning: the force keeps its world axes."""
    tree = heavy(known.floating("free", "ground", "body"), body=(2.0, (0, 0, 0), BODY[2]))
    mech = known.load(tmp_path, "free", tree, "gravity = [0.0, 0.0, -3.0]\n")
    spin = np.array([0.0, 0.0, 0.0, 1.0, 2.0, 3.0])
    state = sp.State(mech, pin.neutral(mech.model), spin, closure_error=0.0)
    motion = sp.simulate(mech, state, 2.0, times=[1.0, 2.0],
                         external={"body": pin.Force(FORCE, np.zeros(3))})
    pull = FORCE / 2.0 + [0.0, 0.0, -3.0]
    for t, at in zip(motion.time, motion.frame("body").position, strict=True):
        assert at == pytest.approx(0.5 * pull * t * t, abs=1e-7)


def test_a_rod_that_could_spin_freely_is_turned_by_a_moment():
    mech = sp.load("rssr")
    state = sp.assemble(mech, {"crank": 0.7})
    moment = pin.Force(np.zeros(3), 0.05 * np.array([1.0, 0.5, 0.2]))
    motion = sp.simulate(mech, state, 0.02, times=[0.0, 0.02], external={"coupler": moment})
    want = sp.forward_dynamics(mech, motion.state(1), external={"coupler": moment}).a
    assert motion.a[1] == pytest.approx(want, abs=1e-5 * np.abs(want).max())


def test_what_is_refused(tmp_path):
    mech = bead(tmp_path)
    state, rows = sp.assemble(mech), np.zeros((3, 6))
    for given, error, words in [
            ({"baed": pin.Force.Zero()}, UnknownNameError, "bead"),
            ({"bead": rows}, ValueError, r"shape \(3, 6\).*one|row of .* 1001 times: \(1001, 6\)"),
            ({"bead": np.full((1001, 6), np.nan)}, ValueError, "NaN"),
            ({"bead": pin.Force(np.full(3, np.inf), np.zeros(3))}, ValueError, "NaN or infinite"),
            (lambda t, s: {"bead": 3.0}, sp.SpatialPinError, "no pin.Force but float"),
            (lambda t, s: 3.0, TypeError, "external"), (3.0, TypeError, "external"),
            (lambda t, s: {"baed": pin.Force.Zero()}, UnknownNameError, "bead")]:
        with pytest.raises(error, match=words):
            sp.simulate(mech, state, 1.0, external=given)
    for none in ({}, None):
        assert sp.simulate(mech, state, 0.1, external=none).by_drivers
