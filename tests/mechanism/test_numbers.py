"""Numbers at the ends of what is accepted: they work, or are refused in words."""

import numpy as np
import pytest
from ladders import hanging
from loaded_library import library
from masses import heavy
from mechanisms import closure, driver, floating, load, point, refine, sliding, turning
from variety import few, paired

import spatial_pin as sp

FORMULATIONS = ["independent", "projected"]
SPRING = '[[springs]]\nname = "s"\nstiffness = {}\nfree_length = {}\n'


def drift(mechanism, state, formulation, duration=1.0, efforts=None):
    motion = sp.simulate(mechanism, state, duration, efforts, times=[0.3 * duration, duration],
                         accuracy=sp.Accuracy(formulation=formulation))
    assert np.isfinite(motion.energy).all()
    return motion.energy_drift


# ---------------------------------------------------------------- energy drift of what stands still


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("seed", range(4))
def test_a_hanging_pendulum_has_no_drift(tmp_path, seed, formulation):
    mech, guess = hanging(tmp_path, 0.4 * seed - 0.7, seed)
    assert drift(mech, sp.assemble(mech, guess=guess), formulation) < 1e-12


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize(("size", "mass", "gravity"), [
    (1e-9, 1e-20, 9.81), (1e-3, 1e-6, 1.6), (1e6, 1e15, 9.81), (1.0, 1.0, 1e-9), (1e3, 1e-9, 1e6)])
def test_units_make_no_difference(tmp_path, formulation, size, mass, gravity):
    tree = heavy(turning("pin", "ground", "rod", (0.0, size, 0.0), (0.3, 0.9, 0.1)),
                 rod=(mass, (0.3 * size, 0.0, -0.7 * size), [0.1 * mass * size**2] * 3))
    toml = f"gravity = [0.0, 0.0, {-gravity}]\n"
    axis = np.array([0.3, 0.9, 0.1]) / np.linalg.norm([0.3, 0.9, 0.1])
    mech = load(tmp_path, "rod", tree, toml)
    # at rest the lever, seen along the axis, points down
    com, down = np.array([0.3, 0.0, -0.7]), np.array([0.0, 0.0, -1.0])
    lever, low = com - (com @ axis) * axis, down - (down @ axis) * axis
    angle = np.arctan2(np.cross(lever, low) @ axis, lever @ low)
    time = np.sqrt(size / gravity)
    state = sp.assemble(mech, guess={"pin": float(angle)})
    assert drift(mech, state, formulation, 3.0 * time) < 1e-12


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("stiffness", [1e-6, 40.0, 1e9])
@pytest.mark.parametrize("free", [0.1, 0.37, 1e3])
def test_a_spring_at_rest_has_no_drift(tmp_path, stiffness, free, formulation):
    """Without gravity, between points whose distance is free to round-off only."""
    tree = heavy(turning("pin", "ground", "arm", axis=(0, 0.6, 0.8))
                 + sliding("slide", "arm", "bead", (0.1, 0.2, 0.3), (0.6, 0.8, 0)),
                 arm=(1.0, (0.1, 0, 0), (0.1, 0.1, 0.1)), bead=(2.0, (0, 0, 0), (0.1, 0.1, 0.1)))
    mech = load(tmp_path, "bead", tree + point("hook", "arm", (0.1, 0.2, 0.3)),
                "gravity = [0.0, 0.0, 0.0]\n" + SPRING.format(stiffness, free)
                + 'frames = ["hook", "bead"]\n')
    state = sp.assemble(mech, guess={"slide": free * (1.0 + 3e-16)})
    assert drift(mech, state, formulation, 3.0 / np.sqrt(stiffness)) < 1e-5


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_a_spring_that_carries_a_weight_has_no_drift(tmp_path, formulation):
    tree = heavy(sliding("slide", "ground", "bead"), bead=(2.0, (0, 0, 0.1), (0.1, 0.1, 0.1)))
    mech = load(tmp_path, "scales", tree, "gravity = [0.0, 0.0, -9.81]\n"
                + SPRING.format(100.0, 1.0) + 'joint = "slide"\n')
    state = sp.assemble(mech, guess={"slide": 1.0 - 2.0 * 9.81 / 100.0})
    assert drift(mech, state, formulation) < 1e-12


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("gravity", [0.0, 9.81])
def test_a_loop_at_rest_has_no_drift(tmp_path, formulation, gravity):
    """Its centre of mass as low as it gets, or anywhere where nothing pulls."""
    tree = heavy(turning("a", "ground", "left", axis=(0, 1, 0))
                 + turning("b", "left", "beam", (0, 0, -1.0), axis=(0, 1, 0))
                 + turning("c", "ground", "right", (1.0, 0, 0), axis=(0, 1, 0)),
                 left=(1.0, (0, 0, -0.5), (0.1, 0.1, 0.1)),
                 beam=(2.0, (0.5, 0, 0), (0.1, 0.1, 0.1)),
                 right=(1.0, (0, 0, -0.5), (0.1, 0.1, 0.1)))
    tree += point("end", "beam", (1.0, 0, 0)) + point("tip", "right", (0, 0, -1.0))
    mech = load(tmp_path, "swing", tree, f"gravity = [0.0, 0.0, {-gravity}]\n"
                + closure("pin", "spherical", "end", "tip"))
    assert drift(mech, sp.assemble(mech), formulation) < 1e-12


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_efforts_that_balance_have_no_drift(tmp_path, formulation):
    """Nothing weighs, nothing is stretched: round-off of the efforts is all that works."""
    tree = heavy(turning("a", "ground", "arm", axis=(0, 0.6, 0.8)),
                 arm=(1.0, (0.5, 0, 0), (0.1, 0.1, 0.1)))
    mech = load(tmp_path, "arm", tree, "gravity = [0.0, 0.0, 0.0]\n" + driver("motor", "a")
                + SPRING.format(10.0, 0.0).replace("free_length", "free_angle") + 'joint = "a"\n')
    state = sp.assemble(mech, guess={"a": 0.3})
    assert drift(mech, state, formulation, efforts={"motor": 3.0}) < 1e-12
    assert drift(mech, sp.assemble(mech, guess={"a": 0.0}), formulation) < 1e-12


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize(("pull", "duration"), paired(
    [(0.0, 0.0), (0.0, 1e7), (9.81, 0.0), (9.81, 1e7)], [1e-12, 1e-6, 1.0]))
def test_a_floating_body_has_no_drift(tmp_path, pull, duration, formulation):
    gravity, height = pull
    tree = heavy(floating("base", "ground", "body", (0.0, 0.0, height), (0.3, 0.2, 0.1)),
                 body=(2.0, (0.45, 0.1, 0), (0.1, 0.2, 0.25)))
    mech = load(tmp_path, "body", tree, f"gravity = [0.0, 0.0, {-gravity}]\n"
                + refine("base", "floating"))
    for v in (np.zeros(6), np.array([3.0, -1.0, 2.0, 0.0, 0.0, 0.0]),
              np.array([3.0, -1.0, 2.0, 0.4, -0.1, 0.2])):
        state = sp.State(mech, sp.assemble(mech).q, v, closure_error=0.0)
        assert drift(mech, state, formulation, duration) < 1e-9


# ---------------------------------------------------------------- settings at the ends


@pytest.fixture(scope="module")
def bar():
    return library("four_bar")


@pytest.fixture(scope="module")
def moving(bar):
    return sp.solve_rates(bar, sp.assemble(bar, {"crank": 0.4}), {"crank": 1.0})


TINY_TO_HUGE = [5e-324, 1e-300, 1e-17, 1e-3, 1.0, 1e300]
INTEGRATORS = ["automatic", "DOP853", "RK45", "Radau", "BDF", "LSODA"]


@pytest.mark.parametrize("tolerance", TINY_TO_HUGE)
def test_any_tolerance_of_closure_works(bar, moving, tolerance):
    """Below round-off it makes no difference; loops are closed as well as they can be."""
    accuracy = sp.Accuracy(tolerance=tolerance)
    values = np.linspace(0.3, 0.4, 50)
    good = max(tolerance, 1e-14)
    assert sp.assemble(bar, {"crank": 0.4}, accuracy=accuracy).closure_error < good
    for part in (values, values[:2]):
        assert sp.sweep(bar, "crank", part, accuracy=accuracy).closure_error.max() < good
    for formulation in FORMULATIONS:
        sp.simulate(bar, moving, 0.1, times=[0.1], accuracy=sp.Accuracy(
            tolerance=tolerance, formulation=formulation))


@pytest.mark.parametrize(("integrator", "tolerance"), paired(INTEGRATORS,
                                                             [5e-324, 1e-300, 1e-17, 1e-15]))
def test_a_time_tolerance_below_round_off_is_round_off(bar, moving, tolerance, integrator):
    duration = 0.1 if integrator != "BDF" else 0.01
    motions = [sp.simulate(bar, moving, duration, times=[duration], accuracy=sp.Accuracy(
        integrator=integrator, time_tolerance=x)) for x in (tolerance, 1e-13)]
    np.testing.assert_allclose(motions[0].q, motions[1].q, rtol=0.0, atol=1e-10)


@pytest.mark.parametrize(("integrator", "step"), paired([*INTEGRATORS, "RK4", "Gauss"],
                                                        TINY_TO_HUGE))
def test_a_step_works_or_cannot_be_that_short(bar, moving, integrator, step):
    accuracy = sp.Accuracy(integrator=integrator, step=step)
    if step < 1e-9:
        with pytest.raises(ValueError, match=r"step is .* steps of it, where 1000000 are allowed"):
            sp.simulate(bar, moving, 0.1, accuracy=accuracy)
    else:
        sp.simulate(bar, moving, 0.1, times=[0.1], accuracy=accuracy)


@pytest.mark.parametrize("order", [0, 1, 2, 3])
@pytest.mark.parametrize("corrections", [None, 1, 2, 10**6, 10**15])
def test_any_order_goes_with_any_corrections(bar, order, corrections):
    accuracy = sp.Accuracy(order=order, corrections=corrections)
    motion = sp.sweep(bar, "crank", np.linspace(0.3, 0.4, 20), accuracy=accuracy)
    assert motion.closure_error.max() < 1e-4


# ---------------------------------------------------------------- durations, times, values


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("duration", [1e-100, 1e-20, 1e-12])
def test_a_short_duration_goes_straight(bar, moving, duration, integrator):
    motion = sp.simulate(bar, moving, duration, times=[duration],
                         accuracy=sp.Accuracy(integrator=integrator))
    np.testing.assert_allclose(motion.v[0], moving.v, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("duration", [5e-324, 1e-300, 1e300, 1e308])
def test_a_duration_without_a_square_is_refused(bar, moving, duration):
    with pytest.raises(ValueError, match=r"duration is .* can be simulated"):
        sp.simulate(bar, moving, duration)


@pytest.mark.parametrize(("integrator", "duration"), paired(INTEGRATORS, [1e12, 1e100]))
def test_a_duration_without_end_is_given_up_early(bar, moving, integrator, duration):
    with pytest.raises(sp.StepLimitError, match=r"1000 steps have led to .* shorter duration"):
        sp.simulate(bar, moving, duration, times=[duration],
                    accuracy=sp.Accuracy(integrator=integrator))


def test_what_comes_to_rest_may_last_for_ever(tmp_path):
    tree = heavy(turning("pin", "ground", "rod", axis=(0, 1, 0)),
                 rod=(1.0, (0.0, 0.0, -1.0), (0.1, 0.1, 0.1)))
    mech = load(tmp_path, "rod", tree, "gravity = [0.0, 0.0, -9.81]\n[joints.pin]\ndamping = 9.0\n")
    motion = sp.simulate(mech, sp.assemble(mech, guess={"pin": 0.5}), 1e12, times=[1e12])
    assert abs(motion.q[0, 0]) < 1e-9


@pytest.mark.parametrize(("speed", "effort"), [(1e150, 0.0), (1.0, 1e300)])
def test_what_no_number_can_follow_is_stated(bar, speed, effort):
    state = sp.solve_rates(bar, sp.assemble(bar, {"crank": 0.4}), {"crank": speed})
    with pytest.raises(sp.SpatialPinError, match="it moves so fast, or forces are so large"):
        sp.simulate(bar, state, 0.1, {"crank": effort})


@pytest.mark.parametrize("values", [[0.4], [0.4, 0.4], [0.4] * 1000, [0.4, 0.4 + 6e-17, 0.4],
                                    [0.4, 5e-324]])
def test_values_that_hardly_differ_are_swept(bar, values):
    assert len(sp.sweep(bar, "crank", values, speed=1.0)) == len(values)


@pytest.mark.parametrize("value", [1e6, 1e17, 1e308])
def test_a_value_too_far_away_is_refused(bar, value):
    with pytest.raises(sp.SpatialPinError, match="too far from the sample before"):
        sp.sweep(bar, "crank", [0.4, value])


@pytest.mark.parametrize("times", [[0.0], [0.05], [0, 5e-324, 1e-17, 2e-17], [0.1 - 1e-16, 0.1],
                                   np.linspace(0.0, 0.1, 5000)])
def test_rows_at_any_times_that_rise(bar, moving, times):
    assert len(sp.simulate(bar, moving, 0.1, times=times)) == len(times)


@pytest.mark.parametrize("times", [[], [0.1, 0.0], [0.0, 0.0], [0.2], [-1e-300], [5e-324],
                                   [np.nan], "x"])
def test_other_times_are_refused(bar, moving, times):
    with pytest.raises(ValueError, match="times"):
        sp.simulate(bar, moving, 0.1, times=times)


# ---------------------------------------------------------------- how many


SHORT = {"task": {"driver": "crank", "values": [0.3, 0.4]}, "settings": [sp.Accuracy()]}


@pytest.mark.parametrize("number", [-1, 1, 0.5, 10**9, 1e15, 1e308, 2**62, 10**400])
def test_a_number_of_samples_that_cannot_be_is_refused(bar, number):
    with pytest.raises(ValueError, match="samples"):
        sp.tolerance(bar, "rocker_pin", {"r2": 1e-5}, samples=number)


@pytest.mark.parametrize("number", [-1, 0.5, 1e308])
def test_a_seed_that_is_none_is_refused(bar, number):
    for verb in (lambda: sp.tolerance(bar, "rocker_pin", {"r2": 1e-5}, samples=2, seed=number),
                 lambda: sp.assembly_modes(bar, {"crank": 0.4}, seed=number)):
        with pytest.raises(ValueError, match="seed"):
            verb()


def test_whole_numbers_may_come_as_other_numbers(bar):
    for whole in (float, np.float32, np.int8, np.uint64):
        spread = sp.tolerance(bar, "rocker_pin", {"r2": 1e-5}, samples=whole(5), seed=whole(3))
        assert len(spread.samples["rocker_pin"]) == 5
        modes = sp.assembly_modes(bar, {"crank": 0.4}, most_starts=whole(70), seed=whole(3))
        assert len(modes) == 2 and modes.starts == 70


@pytest.mark.parametrize("deviation", few([1e9, 1e100], 1e100))
def test_spreads_of_hardly_any_samples_are_not_known(bar, deviation):
    spread = sp.tolerance(bar, "rocker_pin", {"r2": deviation}, samples=3)
    assert spread.failed >= 2 and np.isnan(spread.sampled["rocker_pin"])
    with pytest.raises(ValueError, match="deviation of 'r2' is 1e\\+300"):
        sp.tolerance(bar, "rocker_pin", {"r2": 1e300}, samples=3)


@pytest.mark.parametrize("number", [0, -1, 0.5, 10**9, 1e308, 2**62])
def test_repeats_that_never_end_are_refused(bar, number):
    with pytest.raises(ValueError, match="repeats"):
        sp.tradeoff(bar, **SHORT, repeats=number, budget=0.01)
    sp.tradeoff(bar, **SHORT, repeats=1, budget=1e308)


def test_starts_that_never_end_are_refused(bar):
    for number in (10**9, 2**62):
        assert len(sp.assembly_modes(bar, {"crank": 0.4}, most_starts=number)) == 2
        assert len(sp.assembly_modes(bar, {"crank": 0.4}, patience=number, most_starts=300)) == 2
        with pytest.raises(ValueError, match=r"patience is .* and most_starts is"):
            sp.assembly_modes(bar, {"crank": 0.4}, patience=number, most_starts=number)


# ---------------------------------------------------------------- pictures; no browser is started


@pytest.mark.parametrize("size", [(0, 0), (-1, 5), (1, 20_000), (1e308, 1), (0.5, 1), (1, 2, 3),
                                  (1,), ("a", 1), (np.nan, 1)])
def test_a_size_that_no_picture_has_is_refused(moving, bar, tmp_path, size):
    motion = sp.sweep(bar, "crank", [0.3, 0.4])
    for verb in (sp.screenshot, sp.movie):
        with pytest.raises(ValueError, match=r"size is .*, each 1 to 16384 pixels"):
            verb(motion, tmp_path / "a.gif", size=size)


@pytest.mark.parametrize("fps", [0.0, -1.0, 5e-324, 1e-17, 1e9, 1e300, np.nan, np.inf])
@pytest.mark.parametrize("suffix", ["gif", "mp4"])
def test_frames_that_no_movie_has_are_refused(bar, tmp_path, fps, suffix):
    with pytest.raises(ValueError, match="fps"):
        sp.movie(sp.sweep(bar, "crank", [0.3, 0.4]), tmp_path / f"a.{suffix}", fps=fps)


@pytest.mark.parametrize("port", [-1, 65536, 2**62, 0.5])
def test_a_port_that_is_none_is_refused(bar, port):
    with pytest.raises(ValueError, match="port"):
        sp.live(bar, port=port, open_browser=False)
