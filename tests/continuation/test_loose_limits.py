"""The end of a branch is told exactly, however loosely its samples are closed."""

import numpy as np
import pytest
from loaded_library import library
from variety import paired

import spatial_pin as sp


@pytest.mark.delicate
@pytest.mark.parametrize(("driven", "tolerance"), paired(
    [("rspc", "slide"), ("stewart", "leg_1"), ("four_bar", "rocker_pin"),
     ("watt_six_bar", "link_pin")], [1e-8, 1e-5, 1e-4, 1e-3]))
def test_a_loose_sweep_ends_at_the_limit(driven, tolerance):
    """Not with words that the branch was lost, whatever the number of values."""
    name, driver = driven
    mechanism = library(name)
    upper = sp.limits(mechanism, driver).upper.value
    begin = sp.assemble(mechanism).coordinate(driver).value
    for n in (3, 7, 20, 101, 401, 777, 1500):
        motion = sp.sweep(mechanism, driver, np.linspace(begin, upper + 0.02, n), on_limit="stop",
                          accuracy=sp.Accuracy(tolerance=tolerance))
        [limit] = [event for event in motion.events if event.kind == "limit"]
        assert limit.value == pytest.approx(upper, abs=1e-10)
