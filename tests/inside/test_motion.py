"""Inside of motions: where joint limits are passed, and how far joints swing between samples."""

from dataclasses import replace

import numpy as np
import pytest
from joint_limits import LOWER, UPPER, crank_at, hanging, limited_slider_crank

import spatial_pin as sp
from spatial_pin.motion.limit_events import (
    SWING_OF_ACCELERATIONS,
    SWING_OF_RATES,
    first_passing,
    joint_limits,
    joint_limits_passed,
)
from spatial_pin.numerics.piecewise import quintic


def test_a_joint_without_room_between_its_limits_has_none(tmp_path):
    """URDF says 0 and 0 where nothing is stated."""
    mech = hanging(tmp_path, 0.0, 0.0)
    assert not joint_limits(mech)
    assert [(x.value, x.side, x.unit) for x in joint_limits(hanging(tmp_path, -1.0, 2.0))] == [
        (-1.0, -1, "rad"), (2.0, 1, "rad")]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_what_lies_between_two_rows_may_differ_from_them_by_noise(sign, tmp_path):
    """A joint at rest at its limit, or near it, whose place and rate between rows are round-off."""
    mech = hanging(tmp_path, -0.7, 1.3)
    for upper in (x for x in joint_limits(mech) if x.side > 0):
        def at(t, upper=upper):
            return np.array([upper.value - sign * 1e-16]), np.array([sign * (t - 0.5) * 1e-17])

        for q0, v0 in ((upper.value, 1e-17), (upper.value - 1e-3, 1e-17), (upper.value, -1e-17)):
            ends = (np.array([q0]), np.array([v0])), (np.array([q0]), np.array([-v0]))
            assert first_passing(upper, at, (0.0, 1.0), ends) is None
    # an end just beyond, where the way there says just before
    ends = (np.array([1.2]), np.array([0.1])), (np.array([1.3 + 2e-11]), np.array([0.1]))
    assert first_passing(upper, lambda t: (np.array([1.2 + 0.1 * t]), np.array([0.1])),
                         (0.0, 1.0), ends) == 1.0


def test_rows_that_cannot_be_followed_again_give_an_estimate_with_few_digits():
    """As if another coordinate had been held: the branch does not lead from row to row."""
    slider_crank = limited_slider_crank()
    motion = sp.sweep(slider_crank, "crank", np.linspace(0.2, 3.1, 200), 0.0)
    rows = np.flatnonzero(motion.coordinate("slide").value < LOWER)
    q = motion.q.copy()
    q[rows, slider_crank.coordinate("coupler_pin").q] += 1e-3
    motion = replace(motion, q=q)
    (lower,) = [p for p in joint_limits_passed(motion) if p.limit.side < 0]
    assert lower.value == pytest.approx(crank_at(LOWER), abs=1e-3)  # by a straight line
    assert lower.where == f"at crank = {lower.value:.6g} rad"


def test_how_far_a_joint_swings_beyond_its_samples_is_bounded():
    """A polynomial of fifth degree leaves the range of its ends by no more than the screen says."""
    rng, x = np.random.default_rng(0), np.linspace(0.0, 1.0, 401)
    for _ in range(200):
        sizes = rng.choice([0.1, 1.0, 10.0], (3, 1))
        values, rates, accelerations = sizes * rng.normal(size=(3, 2))
        h = rng.uniform(0.1, 2.0)
        found = np.polynomial.Polynomial(
            quintic(values, h * rates, h * h * accelerations))(x)
        beyond = max(found.max() - values.max(), values.min() - found.min())
        assert beyond <= (SWING_OF_RATES * h * np.abs(rates).sum()
                          + SWING_OF_ACCELERATIONS * h * h * np.abs(accelerations).sum())


def test_a_traced_curve_passes_limits_too():
    """Its rows are no history in time; between them goes the arc length."""
    motion = sp.trace(limited_slider_crank(), "crank")
    passed = [p for p in joint_limits_passed(motion) if p.where]
    assert [p.value for p in passed] == pytest.approx(
        [crank_at(LOWER), 2.0 * np.pi - crank_at(UPPER)], abs=1e-12)
