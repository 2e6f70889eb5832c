"""A motion tells its own error: it bounds the true one, and is of its size."""

import pickle

import numpy as np
import pinocchio as pin
import pytest
from loaded_library import library

import spatial_pin as sp

REFERENCE = sp.Accuracy.named("reference")
SWEEPS = {"four_bar": "crank", "rssr": "crank", "stewart": "leg_1", "rspc": "crank",
          "slider_crank": "crank", "geared_five_bar": "crank", "swash_plate": "shaft"}
ROUND_OFF = 1e-14  # that a configuration closed to round-off has


LINK = """<link name="{0}"><inertial><origin xyz="0 0 -0.5"/><mass value="1"/>
  <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
HINGE = """<joint name="{0}" type="continuous"><parent link="{1}"/><child link="{2}"/>
  <origin xyz="0 0 {3}"/><axis xyz="0 1 0"/></joint>"""
DOUBLE_PENDULUM = (
    '<robot name="wild"><link name="ground"/>' + LINK.format("upper") + LINK.format("lower")
    + HINGE.format("a", "ground", "upper", 0) + HINGE.format("b", "upper", "lower", -1)
    + "</robot>")


def true_errors(motion, exact):
    """Return errors of positions, and of v and a by the largest one."""
    scale = motion.mechanism.velocity_scale
    steps = [pin.difference(motion.mechanism.model, p, q)
             for p, q in zip(exact.q, motion.q, strict=True)]
    gaps = (np.array(steps), motion.v - exact.v, motion.a - exact.a)
    sizes = (1.0, np.abs(exact.v / scale).max(), np.abs(exact.a / scale).max())
    return [np.abs(gap / scale).max() / size for gap, size in zip(gaps, sizes, strict=True)]


def swept(name, n, accuracy, **more):
    mech = library(name)
    driver = SWEEPS.get(name, next(iter(mech.drivers)))
    driver = driver if driver in mech.drivers else next(iter(mech.drivers))
    start = sp.assemble(mech).coordinate(driver).value
    reach = 1.5 if mech.coordinate(driver).unit == "rad" else 0.1 * mech.characteristic_length
    return sp.sweep(mech, driver, np.linspace(start, start + reach, n), accuracy=accuracy, **more)


@pytest.mark.parametrize("name", SWEEPS)
@pytest.mark.parametrize("error", [1e-2, 1e-4, 1e-6, 1e-8, 1e-10, 4e-13])
def test_the_error_of_a_sweep_bounds_the_true_one(name, error):
    for n in (31, 400):
        motion = swept(name, n, sp.Accuracy.for_error(error), speed=2.0)
        exact = swept(name, n, REFERENCE, speed=2.0)
        own = exact.error[:3]
        for one, true, x in zip(motion.error[:3], true_errors(motion, exact), own, strict=True):
            assert true <= one + x
        assert motion.error.largest <= max(error, 1e-9)


@pytest.mark.parametrize("error", [1e-3, 1e-5, 1e-6, 1e-7])
def test_what_a_coupler_turns_about_itself_between_points_is_told(error):
    """No closure shows it."""
    values = np.linspace(0.0, 2.0 * np.pi, 151)
    motion, exact = (sp.sweep(library("rssr"), "crank", values, accuracy=accuracy)
                     for accuracy in (sp.Accuracy.for_error(error), REFERENCE))
    for one, true in zip(motion.error[:3], true_errors(motion, exact), strict=True):
        assert true <= one


@pytest.mark.parametrize("name", ["four_bar", "rssr", "stewart"])
@pytest.mark.parametrize("error", [1e-4, 1e-6])
def test_the_error_of_interpolated_samples_is_no_exaggeration(name, error):
    motion = swept(name, 1000, sp.Accuracy.for_error(error))
    true = true_errors(motion, swept(name, 1000, REFERENCE))
    assert all(one <= 30.0 * x for one, x in zip(motion.error[:3], true, strict=True))
    assert 0.03 * error <= motion.error.largest  # nor is it more exact than was wanted


def test_accelerations_of_the_driver_are_part_of_it():
    speeds = np.linspace(-3.0, 5.0, 400)
    motion = swept("four_bar", 400, sp.Accuracy.for_error(1e-5), speed=speeds, acceleration=100.0)
    exact = swept("four_bar", 400, REFERENCE, speed=speeds, acceleration=100.0)
    for one, true in zip(motion.error[:3], true_errors(motion, exact), strict=True):
        assert true <= one


def test_the_row_is_where_the_error_is():
    motion = swept("four_bar", 400, sp.Accuracy.for_error(1e-5))
    k = motion.error.row[2]
    largest = np.abs(motion.a / motion.mechanism.velocity_scale).max()
    assert motion.error.accelerations == motion.error_estimates[k, 2] / largest
    assert motion.error.end[0] == motion.error_estimates[-1, 0]


@pytest.mark.parametrize("error", [1e-3, 1e-6, 4e-13])
def test_several_drivers_along_tables_tell_it_too(error):
    mech = library("excavator")
    s = np.linspace(0.0, 2.0, 300)
    tables = {"boom": 2.7 + 0.1 * np.sin(s), "arm": 2.8 + 0.05 * np.cos(2.0 * s)}
    motion = sp.follow(mech, tables, s, accuracy=sp.Accuracy.for_error(error))
    exact = sp.follow(mech, tables, s, accuracy=REFERENCE)
    for one, true in zip(motion.error[:3], true_errors(motion, exact), strict=True):
        assert true <= one + ROUND_OFF
    assert motion.error.largest <= max(error, 1e-9)


def test_a_traced_curve_tells_it():
    mech = library("four_bar", r2=0.25)
    motion = sp.trace(mech, "crank")
    for k in range(0, len(motion), 25):  # the same configuration by the driver's value
        if abs(motion.driver_speed[k]) < 0.2:
            continue
        there = sp.assemble(mech, {"crank": motion.driver[k]}, guess=motion.state(k),
                            accuracy=REFERENCE)
        off = np.abs(motion.q[k] - there.q).max()
        assert off <= motion.error.positions + ROUND_OFF
    assert motion.error.positions < 1e-11


def test_through_a_branch_point_it_is_told_by_what_nodes_leave():
    mech = library("four_bar", r1=0.3, r2=0.1, r3=0.3, r4=0.1)  # a parallelogram
    motion = sp.sweep(mech, "crank", np.linspace(0.5, 5.5, 60))
    assert [e.kind for e in motion.events].count("branch point") == 1
    assert motion.error.positions < 1e-9 and motion.error.largest < 1e-4


def test_samples_keep_their_estimates_in_files_and_copies(tmp_path):
    motion = swept("rssr", 200, sp.Accuracy.for_error(1e-5))
    file = motion.save(tmp_path / "motion")
    for copy in (pickle.loads(pickle.dumps(motion)), sp.Motion.load(file, motion.mechanism)):
        assert copy.error == motion.error


def test_a_motion_put_together_by_hand_says_that_nobody_knows():
    whole = swept("four_bar", 5, None)
    bare = sp.Motion(whole.mechanism, whole.driver, whole.driver_name, None, whole.q, whole.v,
                     whole.a, whole.closure_error, whole.driver_speed)
    with pytest.raises(sp.SpatialPinError, match="estimated"):
        _ = bare.error
    with pytest.raises(sp.SpatialPinError, match="'four_bar': the motion has no samples"):
        _ = whole[:0].error
    assert "error:" in str(whole) and "error: " not in str(bare).replace("closure error", "")


# ---------------------------------------------------------------- simulations


@pytest.mark.parametrize(("name", "error"), [
    ("four_bar", 1e-2), ("four_bar", 1e-4), ("four_bar", 1e-6), ("rspc", 1e-3), ("oldham", 1e-5)])
def test_the_error_of_a_simulation_bounds_the_true_one(name, error, tmp_path):
    mech = library(name)
    times = np.linspace(0.0, 0.6, 61)
    state = sp.assemble(mech, {next(iter(mech.drivers)): 1.0})
    motion, exact = (sp.simulate(mech, state, 0.6, times=times, accuracy=x) for x in (
        sp.Accuracy.for_error(error, "simulate"), REFERENCE))
    true = true_errors(motion, exact)
    for one, x in zip(motion.error[:3], true, strict=True):
        assert x <= one <= 1e3 * x + 1e-9
    assert np.all(np.diff(motion.error_estimates, axis=0) >= 0.0)
    again = sp.Simulation.load(motion.save(tmp_path / "fall"), mech)
    assert again.error == motion.error


@pytest.mark.parametrize("name", ["four_bar", "watt_six_bar", "scotch_yoke"])
@pytest.mark.parametrize("error", [1e-2, 1e-4])
def test_few_long_steps_are_not_compared_with_the_same_ones(name, error):
    """Steps that grow as fast as they may are the same ones at any tolerance."""
    mech = library(name)
    times = np.linspace(0.0, 0.03, 31)
    state = sp.assemble(mech, {next(iter(mech.drivers)): 1.0})
    motion, exact = (sp.simulate(mech, state, 0.03, times=times, accuracy=x) for x in (
        sp.Accuracy.for_error(error, "simulate"), REFERENCE))
    for one, true in zip(motion.error[:3], true_errors(motion, exact), strict=True):
        assert true <= one + 1e-12


def test_closure_errors_of_interpolated_samples_are_bounds():
    for name in ("rssr", "four_bar", "stewart"):
        motion = swept(name, 800, sp.Accuracy.for_error(1e-4))
        for k in range(0, 800, 37):
            state = sp.State(motion.mechanism, motion.q[k])
            assert state.closure_error <= motion.closure_error[k] + ROUND_OFF


def test_errors_of_1e_9_are_met_by_interpolation():
    motion = swept("rssr", 2000, sp.Accuracy.for_error(1e-9))
    true = true_errors(motion, swept("rssr", 2000, REFERENCE))
    assert max(true) > 1e-12  # motions closed sample by sample are more exact
    assert all(x <= one <= 1e-9 for one, x in zip(motion.error[:3], true, strict=True))


@pytest.mark.parametrize(("error", "first"), [(1e-6, 0), (1e-8, 100)])
def test_a_short_tight_sweep_is_interpolated_from_its_first_samples_on(error, first):
    """A quarter of a radian, too short for a point that is far enough behind.

    At 1e-8 the idle rotation, which no residual shows, wants an eighth of the sweep closed first.
    """
    values = np.linspace(0.0, 0.25, 800)
    motion, exact = (sp.sweep(library("rssr"), "crank", values, speed=2.0, accuracy=x) for x in (
        sp.Accuracy.for_error(error), REFERENCE))
    off = np.abs(motion.a - exact.a).max(axis=1) / np.abs(exact.a).max()
    assert np.count_nonzero(off[first : first + 100] > 1e-12) > 60  # closed ones are more exact
    for one, x in zip(motion.error[:3], true_errors(motion, exact), strict=True):
        assert x <= one <= error


def test_an_unstable_simulation_says_so(tmp_path):
    """Double pendulums lose their digits in a few swings; one that hangs does not."""
    mech = library("four_bar")
    stable = sp.simulate(mech, sp.assemble(mech, {"crank": 1.0}), 0.3)
    (tmp_path / "wild.urdf").write_text(DOUBLE_PENDULUM, encoding="utf-8")
    wild = sp.load(tmp_path / "wild.urdf")
    start = sp.assemble(wild, {"a": 3.0, "b": 0.1})
    fall = sp.simulate(wild, start, 20.0, times=np.linspace(0.0, 20.0, 101))
    assert "unstable" in str(fall) and "unstable" not in str(stable)
    exact = sp.simulate(wild, start, 20.0, times=np.linspace(0.0, 20.0, 101), accuracy=REFERENCE)
    assert true_errors(fall, exact)[0] <= fall.error.positions
    coarse = sp.simulate(wild, start, 20.0, times=np.linspace(0.0, 20.0, 101),
                         accuracy=sp.Accuracy.for_error(1e-2, "simulate"))
    assert np.isfinite(coarse.error_estimates[0]).all() and np.isinf(coarse.error.end).all()
    assert "unstable" in str(coarse) and " inf " not in str(coarse).split("unstable")[1]
