"""Hermite's polynomial of fifth degree: a quintic given by both its ends is that quintic."""

import numpy as np
from numpy.polynomial import Polynomial

from spatial_pin.numerics.piecewise import quintic


def test_a_quintic_is_found_from_values_and_derivatives_at_both_ends():
    given = [Polynomial(x) for x in np.random.default_rng(5).normal(size=(4, 6))]
    ends = [np.array([[p.deriv(order)(x) if order else p(x) for p in given] for x in (0.0, 1.0)])
            for order in range(3)]
    found = quintic(*ends)
    assert found.shape == (6, 4)
    for coefficients, p in zip(found.T, given, strict=True):
        np.testing.assert_allclose(coefficients, p.coef, rtol=0.0, atol=1e-13)
