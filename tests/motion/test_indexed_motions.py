"""Samples of a motion by number, slice, mask and name; what a State has by name."""

from __future__ import annotations

import pickle

import numpy as np
import published_models as models
import pytest
from loaded_library import library

import spatial_pin as sp


@pytest.fixture(scope="module")
def motion() -> sp.Motion:
    return sp.sweep(library("rssr"), "crank", np.linspace(0.0, 6.0, 61), speed=25.0)


def test_a_number_is_a_state(motion):
    for k in (0, 7, -1, np.int64(7), np.int32(-3), np.array(5)):
        state = motion[k]
        assert isinstance(state, sp.State)
        assert np.array_equal(state.q, motion.q[int(k)])
        assert np.array_equal(state.v, motion.v[int(k)])
    assert [state.q.tolist() for state in motion] == motion.q.tolist()


@pytest.mark.parametrize("k", [61, -62, np.int64(99)])
def test_a_number_out_of_range_is_an_index_error_in_words(motion, k):
    with pytest.raises(IndexError, match=f"there is no sample {k}: 61 samples are 0 to 60"):
        motion[k]
    with pytest.raises(sp.SpatialPinError):
        motion[[0, k]]


@pytest.mark.parametrize("rows", [
    slice(10, 20), slice(None), slice(-5, None), slice(None, None, 3), slice(None, None, -1),
    slice(20, 10), [3, 5, 40], np.array([5, 3]), np.arange(61) % 2 == 0])
def test_rows_are_a_motion_of_these_samples(motion, rows):
    some = motion[rows]
    assert isinstance(some, sp.Motion)
    for name in ("q", "v", "a", "driver", "time", "closure_error", "driver_speed",
                 "error_estimates"):
        assert np.array_equal(getattr(some, name), getattr(motion, name)[rows])
    assert not some.q.flags.writeable
    assert np.array_equal(some.frame("rocker_b").position, motion.frame("rocker_b").position[rows])


def test_events_come_along_with_the_samples_around_them():
    mechanism = library("four_bar", r2=0.25)
    motion = sp.sweep(mechanism, "crank", np.linspace(0.0, 3.0, 31), on_limit="stop")
    assert [e.row for e in motion.events] == [25]
    assert motion[10:20].events == []
    assert [e.row for e in motion[5:].events] == [20]
    assert [e.row for e in motion[::2].events] == [13]
    assert [e.row for e in motion[::-1].events] == [0]
    assert motion[[1, 5, 2]].events == []
    again = pickle.loads(pickle.dumps(motion[5:]))
    assert again.events == motion[5:].events


def test_events_inside_are_numbered_anew():
    """A parallelogram that goes through its change points has an event at each."""
    motion = sp.sweep(models.ladder(1), "pin_0", np.linspace(0.3, 6.5, 63), guess={"pin_0": 0.3})
    inside = [e for e in motion.events if 20 <= e.row < 50]
    assert 0 < len(inside) < len(motion.events)
    assert motion[20:50].events == [e._replace(row=e.row - 20) for e in inside]


def test_a_simulation_is_indexed_with_its_energies():
    mechanism = library("four_bar")
    falling = sp.simulate(mechanism, sp.assemble(mechanism, {"crank": 1.0}), 0.2)
    some = falling[100:200:10]
    assert np.array_equal(some.energy, falling.energy[100:200:10])
    assert len(some) == 10


@pytest.mark.parametrize("bad", [1.5, (1, 2), True, None, np.ones(61), np.ones(3, bool), b"crank"])
def test_other_indices_are_refused(motion, bad):
    with pytest.raises(TypeError, match="a Motion is indexed by the number of a sample"):
        motion[bad]


def test_a_name_is_the_coordinate_or_the_frame(motion):
    assert np.array_equal(motion["rocker_pin"].value, motion.coordinate("rocker_pin").value)
    assert np.array_equal(motion["rocker_b"].velocity, motion.frame("rocker_b").velocity)
    assert motion["ball_a"].position.shape == (61, 3)  # a joint of three freedoms
    state = motion[7]
    assert state["crank_pin"] == state.coordinate("crank_pin")
    frame = state["rocker_b"]
    assert np.array_equal(frame.position, state.placement("rocker_b").translation)
    assert np.array_equal(frame.rotation, state.placement("rocker_b").rotation)
    assert np.array_equal(frame.velocity, state.velocity("rocker_b").linear)
    assert np.array_equal(frame.angular_acceleration, state.acceleration("rocker_b").angular)


def test_a_name_of_two_things_or_of_none_is_refused(motion):
    for subject in (motion, motion[0]):
        with pytest.raises(sp.SpatialPinError, match=r"\.coordinate\('crank'\) or \.frame\("):
            subject["crank"]
        with pytest.raises(sp.UnknownNameError, match="did you mean 'rocker_pin'"):
            subject["rocker_pn"]
    with pytest.raises(TypeError, match="indexed by a name"):
        motion[0][0]
    with pytest.raises(TypeError):
        list(motion[0])


def test_placements_are_those_of_the_states(motion):
    found = motion.placement("coupler_b")
    assert found.shape == (61, 4, 4)
    for k in (0, 30, 60):
        expected = motion[k].placement("coupler_b").homogeneous
        np.testing.assert_allclose(found[k], expected, rtol=0, atol=1e-15)
    with pytest.raises(sp.UnknownNameError):
        motion.placement("coupler_c")
