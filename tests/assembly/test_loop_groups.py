"""Loops that share only what is held are closed one by one, however many there are."""

import numpy as np
import pinocchio as pin
import pytest
from legs import at, walker

import spatial_pin as sp

ANGLES = np.linspace(0.0, 6.0, 7)


def of_leg(state, k):
    return {name: state.coordinate(name).value for name in state.mechanism.coordinates
            if name.endswith(f"_{k}")}


@pytest.mark.parametrize("legs", [2, 12])
def test_many_legs_on_one_crank_close_at_every_angle_of_it(legs):
    mechanism = walker(legs)
    for angle in ANGLES:
        state = sp.assemble(mechanism, {"crank": angle})
        assert state.closure_error < 1e-12
        assert state.coordinate("crank").value == angle


@pytest.mark.slow
def test_two_dozen_legs_close_at_every_angle():
    mechanism = walker(24)
    for angle in np.linspace(0.0, 6.0, 25):
        assert sp.assemble(mechanism, {"crank": angle}).closure_error < 1e-12


@pytest.mark.delicate
def test_each_leg_stands_as_it_does_alone():
    for angle in ANGLES[::3]:
        together = sp.assemble(walker(6), {"crank": angle})
        for k in (0, 3, 5):
            alone = sp.assemble(walker(6, only=k), {"crank": angle})
            assert of_leg(together, k) == pytest.approx(of_leg(alone, k), abs=1e-9)


def test_a_crank_without_a_value_stands_though_no_start_closes_all_its_legs():
    state = sp.assemble(walker(12))
    assert state.coordinate("crank").value == 0.0
    assert state.released == {}


def test_a_leg_that_is_too_short_is_the_one_that_is_named():
    words = r"crank = 0 cannot be closed.*close at crank = 1\."
    with pytest.raises(sp.AssemblyError, match=words) as caught:
        sp.assemble(walker(8, sizes=[1.0, 1.0, 1.0, 0.4]), {"crank": 0.0})
    assert caught.value.worst_closure in ("a_3", "b_3", "c_3")
    state = caught.value.state  # the best attempt, in which all other legs are closed
    for closure in state.mechanism.closures:
        one, two = (state.placement(frame).translation for frame in closure.frames)
        assert closure.name.endswith("_3") or one == pytest.approx(two, abs=1e-9)


@pytest.mark.delicate
@pytest.mark.parametrize("crank", [1.2, pytest.param(5.0, marks=pytest.mark.slow)])
def test_a_crank_goes_only_as_far_as_the_one_leg_that_moves_it(crank):
    sizes = [1.0, 1.0, 1.0, 0.4]
    state = sp.assemble(walker(8, sizes=sizes), guess={"crank": crank})
    alone = sp.assemble(walker(8, sizes=sizes, only=3), guess={"crank": crank})
    assert state.closure_error < 1e-12
    assert list(state.released) == ["crank"]
    assert abs(state.released["crank"]) < abs(alone.released["crank"]) + 1e-3


def four_bars(n):
    """Return four-bars side by side whose cranks of 0.5 m come to 0.9147 rad, either way."""
    model, closures = pin.Model(), []
    for k in range(n):
        for name, parent, x in (("crank", 0, 0.0), ("coupler", f"crank_{k}", 0.5),
                                ("rocker", 0, 1.0)):
            on = model.getJointId(parent) if parent else 0
            model.addJoint(on, pin.JointModelRY(), at(x, 0.0, 0.0), f"{name}_{k}")
        closures.append(sp.closures.spherical(
            (f"coupler_{k}", at(0.4, 0.0, 0.0)), (f"rocker_{k}", at(-0.4, 0.0, 0.0)),
            name=f"pin_{k}"))
    return sp.Mechanism.from_model(model, closures, drivers=[f"crank_{k}" for k in range(n)])


def test_only_the_driver_that_cannot_stand_is_released_and_goes_least():
    limit = np.arccos((0.5**2 + 1.0**2 - 0.8**2) / (2.0 * 0.5 * 1.0))
    mechanism = four_bars(3)
    guess = {"crank_0": 2.0, "crank_1": 0.1}
    state = sp.assemble(mechanism, {"crank_2": 0.2}, guess)
    assert state.closure_error < 1e-12
    assert [state.coordinate(f"crank_{k}").value for k in (1, 2)] == [0.1, 0.2]
    assert state.released == {"crank_0": pytest.approx(limit - 2.0, abs=1e-6)}
    with pytest.raises(sp.AssemblyError, match="crank_0 = 2"):
        sp.assemble(mechanism, {"crank_2": 0.2}, guess, release=False)


def test_limits_are_kept_in_every_group():
    mechanism = walker(6, limit=2.9)
    state = sp.assemble(mechanism, {"crank": 1.0}, limits=True)
    assert state.beyond_limits == {}
    assert state.closure_error < 1e-12
