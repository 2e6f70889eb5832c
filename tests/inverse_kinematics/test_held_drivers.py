"""What stands still along a path of targets has the names that it has everywhere else."""

from __future__ import annotations

import numpy as np
import pytest
from loaded_library import library

import spatial_pin as sp


def path_and_hold(name, hold, target, way, **options):
    """Return the motion of a target from where it stands, and the start."""
    mechanism = library(name, **options)
    state = sp.assemble(mechanism)
    frame, _, part = target.partition(".position.")
    start = state.placement(frame).translation["xyz".index(part)]
    values = start + way * np.linspace(0.0, 1.0, 5)
    return sp.reach_path(mechanism, {target: values}, state=state, hold=hold), state


@pytest.mark.parametrize(("drivers", "coordinates"), [
    (["swing", "arm", "bucket"], ["swing", "arm_slide", "bucket_slide"]),
    pytest.param(["swing", "boom", "bucket"], ["swing", "boom_slide", "bucket_slide"],
                 marks=pytest.mark.slow),
    (["swing", "arm"], ["swing", "arm_slide"]),  # two are free: least motion
])
def test_drivers_are_held_by_their_own_names_and_by_those_of_their_joints(drivers, coordinates):
    one, start = path_and_hold("excavator", drivers, "teeth.position.z", -0.05)
    two, _ = path_and_hold("excavator", coordinates, "teeth.position.z", -0.05)
    assert np.abs(one.q - two.q).max() < 1e-12
    for name in drivers:
        still = start.coordinate(name).value
        assert one.coordinate(name).value == pytest.approx(np.full(5, still), abs=1e-12)


def test_a_driver_is_held_beside_a_free_base():
    motion, start = path_and_hold("excavator", ["base", "swing", "arm", "bucket"],
                                  "teeth.position.z", -0.05, free_flyer=True)
    assert motion.coordinate("arm").value == pytest.approx(
        np.full(5, start.coordinate("arm").value), abs=1e-12)
    assert motion.q[:, :7] == pytest.approx(np.tile(start.q[:7], (5, 1)), abs=1e-12)


def test_reach_and_the_path_that_begins_there_hold_the_same():
    mechanism = library("delta")
    state = sp.assemble(mechanism)
    height = state.placement("platform").translation[2]
    held = [*mechanism.drivers][:1]
    joint = mechanism.drivers[held[0]].joint
    reached = sp.reach(mechanism, {"platform.position.z": height - 0.02}, state, hold=held)
    path = sp.reach_path(mechanism, {"platform.position.z": [height, height - 0.02]}, state=state,
                         hold=held)
    for found in (reached, path.state(-1)):
        assert found.coordinate(joint).value == pytest.approx(state.coordinate(joint).value,
                                                              abs=1e-12)
