"""Several drivers go along one parameter, each by a piecewise polynomial of it."""

from __future__ import annotations

import numpy as np
import pytest
from loaded_library import library
from scipy.interpolate import BPoly, CubicSpline, PPoly
from variety import paired

import spatial_pin as sp
from spatial_pin.assembly.square_system import SquareSystem
from spatial_pin.kernel.kernel import Kernel
from spatial_pin.kernel.loop_equations import loops_of
from spatial_pin.kernel.paths import Path, PathSamples, Polynomials, prescribed_indices
from spatial_pin.rates.rates import prescribed_at
from spatial_pin.settings import Accuracy

ROWS = np.array([0.0, 0.3, 0.5, 1.1, 1.4, 2.0])  # of a table


def path_of(mechanism, accuracy=None, law=None) -> tuple[Path, sp.State]:
    """Return the path of all drivers of a mechanism, and the state it is to start at.

    The drivers go by a law, which is made for the state.
    """
    state = sp.assemble(mechanism)
    driven = prescribed_at(state, mechanism.drivers)
    with loops_of(mechanism) as evaluation:
        evaluation.angle_reference[:] = state.angles
        system = SquareSystem(evaluation, driven, state.q)
    kernel = Kernel(mechanism)
    return Path(kernel, system.equations, prescribed_indices(kernel.nv, driven), system.passive,
                accuracy or Accuracy(), law and law(state)), state


def table(mechanism, state, size=0.02) -> np.ndarray:
    """Values (m, k) of the drivers at the rows, those of the state first."""
    home = np.array([state.coordinate(name).value for name in mechanism.drivers])
    away = size * np.random.default_rng(4).standard_normal((len(ROWS), len(home)))
    away[0] = 0.0
    return home + away


def pieces(values, kind: str) -> PPoly:
    if kind == "linear":
        return PPoly(np.array([np.diff(values, axis=0) / np.diff(ROWS)[:, None], values[:-1]]),
                     ROWS)
    if kind == "cubic":
        return CubicSpline(ROWS, values, bc_type="clamped")
    ends = np.array([0, *[1] * (len(ROWS) - 2), 0])[:, None]  # at rest there
    slopes, bends = (ends * CubicSpline(ROWS, values)(ROWS, order) for order in (1, 2))
    return PPoly.from_bernstein_basis(BPoly.from_derivatives(
        ROWS, np.stack([values, slopes, bends], axis=1)))


def polynomials(spline: PPoly, begin: float = 0.0) -> Polynomials:
    # pieces, coordinates, rising powers
    return Polynomials(begin, spline.x, np.moveaxis(spline.c[::-1], 0, 2))


def by_table(mechanism, kind: str):
    """The law of a mechanism's drivers through a table."""
    return lambda state: polynomials(pieces(table(mechanism, state), kind))


def room(path: Path, n: int) -> PathSamples:
    return PathSamples.empty(n, path.kernel.nq, path.kernel.nv, path.kernel.n_angles)


def followed(path: Path, values) -> PathSamples:
    samples = room(path, len(values))
    assert path.follow(values, samples) == len(values)
    return samples


@pytest.mark.parametrize(("name", "kind"), paired(
    ["stewart", "delta", "watt_six_bar"], ["linear", "cubic", "quintic"]))
def test_drivers_go_by_a_table(name, kind):
    """Samples are those that are closed one by one, rates those of their drivers' there."""
    mechanism = library(name)
    path, state = path_of(mechanism, law=by_table(mechanism, kind))
    spline = pieces(table(mechanism, state), kind)
    assert path.start(state.q, state.angles)
    values = np.union1d(np.linspace(0.0, 2.0, 29), ROWS)
    samples = followed(path, values)
    assert samples.error.max() < 1e-13
    for k, value in enumerate(values):
        at = dict(zip(mechanism.drivers, spline(value), strict=True))
        alone = sp.assemble(mechanism, at, guess=state)
        for driver, wanted in at.items():
            assert alone.coordinate(driver).value == wanted
        turned = np.minimum(np.abs(samples.q[k] - alone.q), np.abs(samples.q[k] + alone.q))
        assert turned.max() < 1e-13 * max(1.0, np.abs(alone.q).max())
        # at a row rates are those behind it
        rates = [dict(zip(mechanism.drivers, derivative(value), strict=True))
                 for derivative in (spline.derivative(1), spline.derivative(2))]
        if value < 2.0:
            there = sp.solve_rates(mechanism, alone, *rates)
            for one, two in ((samples.t[k], there.v), (samples.c[k], there.a)):
                np.testing.assert_allclose(one, two, rtol=0,
                                           atol=1e-11 * max(1.0, np.abs(two).max()))


@pytest.mark.parametrize("kind", ["cubic", "quintic"])
def test_rates_are_the_differences_of_samples(kind):
    mechanism = library("stewart")
    path, state = path_of(mechanism, law=by_table(mechanism, kind))
    assert path.start(state.q, state.angles)
    h = 1e-4
    for middle in (0.2, 0.4, 0.75, 1.9):
        q = followed(path, middle + h * np.arange(-2.0, 3.0))
        plain = [c for c in mechanism.coordinate_table.values() if c.q >= 0]
        at, v = np.array([(c.q, c.v) for c in plain]).T
        rate = (q.q[0] - 8 * q.q[1] + 8 * q.q[3] - q.q[4])[at] / (12 * h)
        bend = (-q.q[0] + 16 * q.q[1] - 30 * q.q[2] + 16 * q.q[3] - q.q[4])[at] / (12 * h * h)
        np.testing.assert_allclose(q.t[2][v], rate, rtol=0, atol=1e-10)
        np.testing.assert_allclose(q.c[2][v], bend, rtol=0, atol=1e-6)


@pytest.mark.parametrize("kind", ["linear", "cubic", "quintic"])
def test_samples_of_a_table_do_not_hang_on_each_other(kind):
    """The same come forth and back, few or many, and with a loose tolerance within it."""
    mechanism = library("stewart")
    values = np.union1d(np.linspace(0.0, 2.0, 401), ROWS)
    found = []
    for part, tolerance in ((values, 1e-13), (values[::-1], 1e-13), (values[::50], 1e-13),
                            (values, 1e-5)):
        path, state = path_of(mechanism, Accuracy(tolerance=tolerance), by_table(mechanism, kind))
        assert path.start(state.q, state.angles)
        found.append(followed(path, np.ascontiguousarray(part)))
    nothing = np.empty((0, 3))  # estimates of errors are those of the points that were closed
    forth, back, few, loose = (x._replace(estimate=nothing) for x in found)
    for one, two, three, four in zip(forth, back, few, loose, strict=True):
        if not one.size:
            continue
        size = max(1.0, np.abs(one).max())
        np.testing.assert_allclose(two[::-1], one, rtol=0, atol=1e-12 * size)
        np.testing.assert_allclose(three, one[::50], rtol=0, atol=1e-12 * size)
        np.testing.assert_allclose(four, one, rtol=0, atol=1e-4 * size)


def test_one_driver_by_itself_is_a_sweep():
    mechanism = library("rssr")
    path, state = path_of(mechanism, law=lambda _: Polynomials(
        0.0, np.array([0.0, 7.0]), np.array([[[0.0, 1.0]]])))
    assert path.start(state.q, state.angles)
    values = np.linspace(0.0, 2.0 * np.pi, 50)
    motion, samples = sp.sweep(mechanism, "crank", values), followed(path, values)
    np.testing.assert_allclose(samples.q, motion.q, rtol=0, atol=1e-13)
    np.testing.assert_allclose(samples.t, motion.v, rtol=0, atol=1e-12)
    np.testing.assert_allclose(samples.c, motion.a, rtol=0, atol=1e-12)


def test_a_path_is_a_cursor():
    """It goes back and forth, and stands before what it cannot pass."""
    mechanism = library("elliptic_trammel")
    limit = sp.limits(mechanism, "slider").upper.value
    path, state = path_of(mechanism)
    assert path.start(state.q, state.angles)
    begin, home = path.here
    near = limit - 1e-3
    for _ in range(3):
        assert path.go(near)
        s, sample = path.here
        assert s == near
        assert sample.error[0] < 1e-14
        assert path.go(begin)
    _, back = path.here
    np.testing.assert_allclose(back.q, home.q, rtol=0, atol=1e-14)
    np.testing.assert_allclose(back.t, home.t, rtol=0, atol=1e-13)
    assert path.go(near)
    assert not path.go(1.1 * limit)
    assert near < path.here[0] < limit
    for value in (1e300, np.nan, np.inf):
        assert not path.go(value)
    assert path.start(state.q, state.angles)  # placed anew
    assert path.here[0] == begin


@pytest.mark.parametrize("breaks, numbers", [
    ([0.0, 0.0], [[[0.0, 1.0]]]), ([1.0, 0.0], [[[0.0, 1.0]]]), ([0.0, np.nan], [[[0.0, 1.0]]]),
    ([0.0, 1.0], [[[np.inf, 1.0]]])])
def test_polynomials_that_are_none_are_refused(breaks, numbers):
    path, state = path_of(library("rssr"), law=lambda _: Polynomials(
        0.0, np.array(breaks), np.array(numbers)))
    with pytest.raises(sp.SpatialPinError):
        path.start(state.q, state.angles)


def test_two_paths_of_a_kernel_each_go_on_where_they_are():
    """Though the kernel follows one at a time."""
    one, state = path_of(library("rssr"))
    other = Path(one.kernel, None, prescribed_indices(one.kernel.nv, prescribed_at(
        state, ["rocker_pin"])), None, Accuracy())
    assert one.start(state.q, state.angles) and one.go(one.here[0] + 0.4)
    s, sample = one.here
    assert other.start(sample.q[0], sample.angles[0]) and other.go(other.here[0] + 0.1)
    assert one.go(s)
    np.testing.assert_allclose(one.here[1].q, sample.q, rtol=0, atol=1e-14)
    alone, _ = path_of(library("rssr"))
    assert alone.start(state.q, state.angles) and alone.go(s + 0.3) and one.go(s + 0.3)
    np.testing.assert_allclose(one.here[1].q, alone.here[1].q, rtol=0, atol=1e-13)
