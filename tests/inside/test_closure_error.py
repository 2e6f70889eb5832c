"""The closure error is at least the round-off of the coordinates."""

import numpy as np
import pytest

import spatial_pin as sp
from spatial_pin.accuracy.extended import Extended


@pytest.mark.parametrize("name", ["four_bar", "rssr", "bennett", "oldham", "delta", "peaucellier"])
def test_the_closure_error_is_not_below_round_off(name):
    mechanism = sp.load(name)
    driver, joint = next((d, mechanism.coordinate(x.joint)) for d, x in mechanism.drivers.items())
    state = sp.assemble(mechanism)
    step = 0.02 * mechanism.velocity_scale[joint.v]
    values = state.coordinate(driver).value + step * np.arange(20)
    motion = sp.sweep(mechanism, driver, values, guess=state)
    real = Extended(motion.mechanism).closure_errors(motion.q, motion.angles)
    assert motion.closure_error.min() >= 2 * np.finfo(float).eps
    assert np.all(real < 1.2 * motion.closure_error)
    assert motion.state(3).closure_error == motion.closure_error[3]
