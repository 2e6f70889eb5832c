"""First and second-order influence coefficients."""

import numpy as np
import pytest
from loaded_library import library

import spatial_pin as sp


@pytest.mark.parametrize("name", ["rssr", "rspc", "four_bar", "stewart", "satellite_dish",
                                  "swash_plate", "hooke_joint"])
def test_velocities_and_accelerations_follow_from_the_influence_coefficients(name):
    mechanism = library(name)
    state = sp.assemble(mechanism)
    rng = np.random.default_rng(5)
    s, ds = rng.normal(size=(2, len(mechanism.drivers)))
    solved = sp.solve_rates(mechanism, state, dict(zip(mechanism.drivers, s, strict=True)),
                            dict(zip(mechanism.drivers, ds, strict=True)))
    first, second = sp.influence(mechanism, state)
    scale = 1e-12 * (1.0 + np.abs(solved.a).max())
    np.testing.assert_allclose(first @ s, solved.v, atol=scale)
    np.testing.assert_allclose(first @ ds + s @ second @ s, solved.a, atol=scale)
    np.testing.assert_array_equal(second, second.transpose(0, 2, 1))


def test_the_second_order_of_the_rssr_is_that_of_its_closed_form():
    """SEEDS B7: 28.449 rad/s² of the rocker at a crank speed of 25.13 rad/s, 60°."""
    mechanism = library("rssr")
    found = sp.influence(mechanism, sp.assemble(mechanism, {"crank": np.pi / 3}))
    rocker = mechanism.coordinate("rocker_pin").v
    assert found.first[rocker, 0] == pytest.approx(0.424607246164, abs=1e-12)
    assert found.second[rocker, 0, 0] * (8 * np.pi) ** 2 == pytest.approx(-28.44939425, abs=1e-8)
