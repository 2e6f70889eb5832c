"""Paths that the kernel follows: they are those that arc length leads along, or end cleanly."""

from __future__ import annotations

import mechanisms
import numpy as np
import pytest
from loaded_library import library
from mechanisms import from_text
from variety import each, few, paired

import spatial_pin as sp
from spatial_pin.assembly.square_system import SquareSystem
from spatial_pin.continuation.path_tracker import PathTracker
from spatial_pin.formats.mechanism_writer import content_of
from spatial_pin.kernel.kernel import Kernel
from spatial_pin.kernel.loop_equations import loops_of
from spatial_pin.kernel.paths import Path, PathSamples
from spatial_pin.rates.rates import prescribed_at
from spatial_pin.settings import Accuracy


def path_of(mechanism, driver, accuracy=None) -> tuple[Path, sp.State]:
    """Return the path of a driver, and the state it is to start at."""
    state = sp.assemble(mechanism)
    driven = prescribed_at(state, [driver])
    with loops_of(mechanism) as evaluation:
        evaluation.angle_reference[:] = state.angles
        system = SquareSystem(evaluation, driven, state.q)
        return Path(Kernel(mechanism), system.equations, [c.v for c in driven], system.passive,
                    accuracy or Accuracy()), state


def room(path: Path, n: int) -> PathSamples:
    return PathSamples.empty(n, path.kernel.nq, path.kernel.nv, path.kernel.n_angles)


def by_arc_length(monkeypatch, *args, **keys) -> sp.Motion:
    with monkeypatch.context() as patch:
        patch.setattr(PathTracker, "from_guess", lambda *_: None)
        patch.setattr(PathTracker, "_path_from", lambda *_, **_keys: None)
        return sp.sweep(*args, **keys)


@pytest.mark.parametrize("name", each(mechanisms.KNOWN))
@pytest.mark.parametrize("n", [9, 120])
def test_the_kernel_follows_the_curve_that_arc_length_does(tmp_path, monkeypatch, name, n):
    known = mechanisms.KNOWN[name]
    mechanism = known.build(tmp_path)
    values = np.linspace(known.values[0], known.values[-1], n)
    keys = {"hold": known.hold} if known.hold else {}
    motion = sp.sweep(mechanism, known.driver, values, accuracy=Accuracy(tolerance=1e-15), **keys)
    other = by_arc_length(monkeypatch, mechanism, known.driver, values,
                         accuracy=Accuracy(tolerance=1e-15), **keys)
    idle = bool(mechanism.passives)  # arc length counts no idle rotation
    size = mechanism.velocity_scale
    for one, two, by in ((motion.v / size, other.v / size, 1e-12),
                         (motion.a / size, other.a / size, 1e-10)):
        if not idle:
            np.testing.assert_allclose(one, two, rtol=0, atol=by * (1 + np.abs(two).max()))
    if not idle:
        np.testing.assert_allclose(motion.q, other.q, rtol=0,
                                   atol=1e-13 * (1 + np.abs(other.q).max()))
    assert motion.closure_error.max() < 5e-15 * (1 + np.abs(values).max())


@pytest.mark.parametrize(("name", "n"), paired(
    ["rssr", "rssr_crossed", "swash_plate"], [2, 7, 37, 100]))
def test_idle_rotations_hang_on_the_path_and_not_on_its_samples(name, n):
    mechanism = library(name)
    driver = next(iter(mechanism.drivers))
    fine = np.linspace(0.0, 2.0 * np.pi, 99 * 36 + 1)
    exact = sp.sweep(mechanism, driver, fine).q
    coarse = sp.sweep(mechanism, driver, fine[:: 99 * 36 // (n - 1)]).q
    np.testing.assert_allclose(coarse, exact[:: 99 * 36 // (n - 1)], rtol=0, atol=3e-14)


@pytest.mark.parametrize(("name", "tolerance"), paired(
    ["rssr", "watt_six_bar", "stewart", "screw_press"], [1e-3, 1e-4, 1e-6, 1e-8, 1e-9]))
@pytest.mark.parametrize("n", few([20, 400, 3000], 20, 400))
def test_a_loose_tolerance_is_what_positions_and_rates_are_off(name, n, tolerance):
    """Samples are interpolated then, between points that are closed to round-off."""
    mechanism = library(name)
    driver = next(iter(mechanism.drivers))
    start = sp.assemble(mechanism).coordinate(driver).value
    values = start + np.linspace(0.0, 0.04 if name == "stewart" else 6.0, n)
    loose = sp.sweep(mechanism, driver, values, accuracy=Accuracy(tolerance=tolerance))
    exact = sp.sweep(mechanism, driver, values)
    assert loose.closure_error.max() <= tolerance
    for one, two in ((loose.q, exact.q), (loose.v, exact.v), (loose.a, exact.a)):
        assert np.abs(one - two).max() <= 2 * tolerance * max(1.0, np.abs(two).max())
    np.testing.assert_array_equal(loose.driver, values)
    np.testing.assert_array_equal(loose.coordinate(driver).value, values)


@pytest.mark.parametrize("tolerance", [1e-5, 1e-6, 1e-7, 1e-8])
def test_rates_of_interpolated_samples_hold_near_a_limit_position(tolerance):
    """Samples lie between a point and the next one, whichever the next was predicted from."""
    mechanism = library("elliptic_trammel")
    driver = next(iter(mechanism.drivers))
    start = sp.assemble(mechanism).coordinate(driver).value
    asked = np.linspace(start, start + 0.6, 4000)
    reached = len(sp.sweep(mechanism, driver, asked, on_limit="stop"))
    values = asked[: int(0.97 * reached)]
    loose = sp.sweep(mechanism, driver, values, accuracy=Accuracy(tolerance=tolerance))
    exact = sp.sweep(mechanism, driver, values)
    for one, two in ((loose.q, exact.q), (loose.v, exact.v), (loose.a, exact.a)):
        assert np.abs(one - two).max() <= tolerance * max(1.0, np.abs(two).max())


@pytest.mark.delicate
@pytest.mark.parametrize(("way", "tolerance"), paired(
    [("bricard", -1), ("bricard", 1), ("excavator", 1), ("elliptic_trammel", -1), ("stewart", 1)],
    [1e-2, 1e-3, 1e-5]))
@pytest.mark.parametrize("n", few([100, 361, 700, 1500], 361))
def test_the_last_samples_before_a_limit_are_as_good_as_is_requested(way, n, tolerance):
    """However few fit between the last point and the limit, where rates grow without bound."""
    name, sense = way
    mechanism = library(name)
    driver = next(iter(mechanism.drivers))
    start = sp.assemble(mechanism).coordinate(driver).value
    is_angle = mechanism.coordinate(driver).unit == "rad"
    far = 6.5 if is_angle else 3.0 * mechanism.characteristic_length
    asked = start + sense * np.linspace(0.0, far, n)
    exact = sp.sweep(mechanism, driver, asked, on_limit="stop")
    loose = sp.sweep(mechanism, driver, asked, on_limit="stop",
                     accuracy=Accuracy(tolerance=tolerance))
    assert len(loose) == len(exact) < n
    for one, two in ((loose.q, exact.q), (loose.v, exact.v), (loose.a, exact.a)):
        assert np.abs(one - two).max() <= 0.3 * tolerance * max(1.0, np.abs(two).max())


@pytest.mark.parametrize("tolerance", [1e-4, 1e-5, 1e-6, 1e-8])
def test_passive_freedoms_of_least_motion_are_not_interpolated(tolerance):
    """Their rates and accelerations are least by themselves: no curve has both."""
    rssr = library("rssr")
    content = content_of(rssr)
    del content["passive"]
    mechanism, values = from_text(rssr.urdf, content, "here.toml"), np.linspace(0.0, 1.0, 201)
    loose = sp.sweep(mechanism, "crank", values, accuracy=Accuracy(tolerance=tolerance))
    exact = sp.sweep(mechanism, "crank", values)
    assert loose.closure_error.max() <= tolerance
    for one, two in ((loose.q, exact.q), (loose.v, exact.v), (loose.a, exact.a)):
        assert np.abs(one - two).max() <= tolerance


@pytest.mark.parametrize(("name", "tolerance"), paired(
    ["four_bar", "rssr", "watt_six_bar", "oldham"], [1e-2, 1e-4, 1e-6]))
def test_the_looser_the_tolerance_the_fewer_points_are_closed(name, tolerance):
    """However samples and steps fall together: points of the path are those closed to round-off."""
    most = {1e-2: 30, 1e-4: 40, 1e-6: 120}[tolerance]
    mechanism = library(name)
    driver = next(iter(mechanism.drivers))
    values = np.linspace(0.0, 2.0 * np.pi, 361)
    motion = sp.sweep(mechanism, driver, values, accuracy=Accuracy(tolerance=tolerance))
    assert np.count_nonzero(motion.closure_error < 1e-13) <= most


def test_interpolated_samples_of_a_floating_platform_move_as_it_does(tmp_path):
    """Quaternions and the origin of a free joint: their rates are those of the body."""
    mechanism = library("stewart")
    driver = next(iter(mechanism.drivers))
    start = sp.assemble(mechanism).coordinate(driver).value
    values = start + np.linspace(0.0, 0.04, 500)
    motion = sp.sweep(mechanism, driver, values, accuracy=Accuracy(tolerance=1e-5))
    exact = sp.sweep(mechanism, driver, values)
    at, _, omega, alpha = (getattr(motion.frame("platform"), x) for x in (
        "position", "rotation", "angular_velocity", "angular_acceleration"))
    other = exact.frame("platform")
    np.testing.assert_allclose(at, other.position, rtol=0, atol=1e-5)
    np.testing.assert_allclose(omega, other.angular_velocity, rtol=0,
                               atol=1e-4 * np.abs(other.angular_velocity).max())
    np.testing.assert_allclose(alpha, other.angular_acceleration, rtol=0,
                               atol=1e-4 * np.abs(other.angular_acceleration).max())


@pytest.mark.parametrize("order", [0, 1, 2, 3])
def test_every_predictor_leads_to_the_same_branch(order):
    mechanism = library("four_bar")
    values = np.linspace(0.0, 2.0 * np.pi, 50)
    one = sp.sweep(mechanism, "crank", values, accuracy=Accuracy(order=order))
    np.testing.assert_allclose(one.q, sp.sweep(mechanism, "crank", values).q, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("name", "order"), paired(
    ["four_bar", "watt_six_bar", "stewart"], [1, 2, 3]))
def test_a_fixed_number_of_corrections_leaves_what_newton_leaves(name, order):
    """The first squares what prediction missed over a step, whose loops were open before."""
    mechanism = library(name)
    driver = next(iter(mechanism.drivers))
    start = sp.assemble(mechanism).coordinate(driver).value
    values = start + np.linspace(0.0, 0.04 if name == "stewart" else 6.0, 300)
    exact = sp.sweep(mechanism, driver, values)
    drift, once, twice = (
        sp.sweep(mechanism, driver, values, accuracy=Accuracy(order=order, corrections=k))
        for k in (0, 1, 2))
    first_step = drift.closure_error[1]
    assert 1e-15 < first_step <= drift.closure_error.max() < 1e-2
    assert once.closure_error.max() < max(100.0 * first_step**2, 1e-9)
    assert twice.closure_error.max() < 1e-12
    for motion, by in ((drift, 1e-1), (once, 1e-4), (twice, 1e-9)):
        np.testing.assert_allclose(motion.q, exact.q, rtol=0, atol=by)


def test_links_do_not_turn_idly_on_the_way_there_and_back():
    mechanism = library("rssr")
    values = np.concatenate([np.tile([0.0, 0.06, 0.0, -0.06], 20), np.linspace(0.0, 3.0, 100)])
    way = sp.sweep(mechanism, "crank", values)
    np.testing.assert_allclose(way.q[80], way.q[0], rtol=0, atol=3e-14)


@pytest.mark.parametrize("name", ["rssr", "swash_plate"])
@pytest.mark.parametrize("n", [6, 900])
def test_the_first_step_back_is_no_longer_than_two_points_tell(name, n):
    mechanism = library(name)
    away = np.linspace(0.0, 2.0, n)
    way = sp.sweep(mechanism, next(iter(mechanism.drivers)), [*away, *away[-2::-1]])
    np.testing.assert_allclose(way.q[n - 1:], way.q[n - 1::-1], rtol=0, atol=6e-14)


@pytest.mark.parametrize("name", each(mechanisms.KNOWN))
def test_close_samples_are_what_distant_ones_are(tmp_path, name):
    known = mechanisms.KNOWN[name]
    mechanism = known.build(tmp_path)
    values = np.linspace(known.values[0], known.values[-1], 481)
    keys = {"hold": known.hold} if known.hold else {}
    close = sp.sweep(mechanism, known.driver, values, **keys)
    distant = sp.sweep(mechanism, known.driver, values[::48], **keys)
    for field, by in (("q", 1e-13), ("v", 1e-12), ("a", 1e-10)):
        one, two = getattr(close, field)[::48], getattr(distant, field)
        np.testing.assert_allclose(one, two, rtol=0, atol=by * (1 + np.abs(two).max()))
    assert close.closure_error.max() < 1e-13 * (1 + np.abs(values).max())


@pytest.mark.delicate
def test_redundant_equations_are_chosen_anew_on_the_way(monkeypatch):
    """Those of Bennett's linkage that serve at the start are dependent elsewhere."""
    reached = []
    monkeypatch.setattr(PathTracker, "reach", lambda *given: reached.append(given))
    motion = sp.sweep(library("bennett"), "crank", np.linspace(0.0, 2.0 * np.pi, 500))
    assert not reached
    assert motion.closure_error.max() < 1e-14


@pytest.mark.delicate
@pytest.mark.parametrize("rows", [181, 361])
def test_accelerations_keep_their_digits_until_redundant_equations_are_chosen_anew(rows):
    """Those of Bennett's linkage that are chosen get worse on the way, and rates with them."""
    values = 1.0 + np.linspace(0.0, 2.0 * np.pi, rows)
    motion, exact = (sp.sweep(library("bennett"), "crank", values, accuracy=accuracy)
                     for accuracy in (None, sp.Accuracy.named("reference")))
    np.testing.assert_allclose(motion.a, exact.a, rtol=0, atol=2e-13)


@pytest.mark.delicate
@pytest.mark.parametrize("end", [1.5477, 0.024])
@pytest.mark.parametrize("rows", [40, 361])
def test_rates_near_a_crossing_are_as_good_as_their_equations_allow(rows, end):
    """Sarrus' linkage, all but flat: what a residual leaves open grows there, in rates too.

    Its links turn in proportion, so all accelerations are known.
    """
    values = np.linspace(0.8, end, rows)
    motion = sp.sweep(library("sarrus"), "arm", values, speed=2.0, acceleration=0.5)
    ratios = np.array([1.0, -2.0, 1.0, 1.0, -2.0])
    np.testing.assert_allclose(motion.v, 2.0 * np.tile(ratios, (rows, 1)), rtol=0, atol=1e-11)
    np.testing.assert_allclose(motion.a, 0.5 * np.tile(ratios, (rows, 1)), rtol=0, atol=1e-9)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e300])
def test_values_that_are_none_end_a_path_where_it_is(value):
    path, state = path_of(library("rssr"), "crank")
    assert path.start(state.q, state.angles)
    samples = room(path, 3)
    s = path.here[0]
    assert path.follow(np.array([s, value, s]), samples) == 1
    assert path.here[0] == s
    np.testing.assert_array_equal(path.here[1].q[0], state.q)
    assert path.follow(np.array([s + 0.1]), room(path, 1)) == 1  # and goes on from there


def test_no_path_starts_at_what_is_no_number():
    path, state = path_of(library("rssr"), "crank")
    assert not path.start(np.full_like(state.q, np.nan), state.angles)
    assert path.start(state.q, state.angles)


@pytest.mark.delicate
def test_no_path_starts_at_a_dead_centre():
    mechanism = library("elliptic_trammel")
    path, state = path_of(mechanism, "slider")
    limit = sp.limits(mechanism, "slider").upper
    dead = sp.assemble(mechanism, {"slider": limit.value - 1e-14}, guess=state)
    assert not path.start(dead.q, dead.angles)
    assert path.start(state.q, state.angles)


@pytest.mark.delicate
def test_a_path_ends_before_a_limit_and_stands_there():
    mechanism = library("elliptic_trammel")
    limit = sp.limits(mechanism, "slider").upper.value
    path, state = path_of(mechanism, "slider")
    path.start(state.q, state.angles)
    values = np.linspace(path.here[0], 1.1 * limit, 50)
    samples = room(path, 50)
    reached = path.follow(values, samples)
    assert reached == np.count_nonzero(values < limit)
    assert values[reached - 1] <= path.here[0] < limit
    assert samples.error[:reached].max() < 1e-14
