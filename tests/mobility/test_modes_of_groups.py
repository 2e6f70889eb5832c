"""Modes of loops that share nothing that may move are each group's with each of the others'."""

import numpy as np
import pinocchio as pin
import pytest
from legs import at, walker

import spatial_pin as sp


def side_by_side(*lengths, drivers=None):
    """Return four-bars of crank, coupler and rocker on a ground of 1 m, each by itself."""
    model, closures = pin.Model(), []
    for k, (crank, coupler, rocker) in enumerate(lengths):
        for name, parent, x in (("crank", 0, 0.0), ("coupler", f"crank_{k}", crank),
                                ("rocker", 0, 1.0)):
            on = model.getJointId(parent) if parent else 0
            model.addJoint(on, pin.JointModelRY(), at(x, 0.0, 0.0), f"{name}_{k}")
        closures.append(sp.closures.spherical(
            (f"coupler_{k}", at(coupler, 0.0, 0.0)), (f"rocker_{k}", at(-rocker, 0.0, 0.0)),
            name=f"pin_{k}"))
    return sp.Mechanism.from_model(model, closures, drivers=drivers or [
        f"crank_{k}" for k in range(len(lengths))])


def rockers(modes, n):
    return sorted(tuple(round(mode.coordinate(f"rocker_{k}").value, 6) for k in range(n))
                  for mode in modes)


@pytest.mark.delicate
def test_modes_of_three_four_bars_are_all_combinations_of_each():
    bars = [(0.3, 0.9, 0.7), (0.4, 0.9, 0.8), (0.2, 0.8, 0.6)]
    cranks = {f"crank_{k}": 0.5 + 0.4 * k for k in range(3)}
    modes = sp.assembly_modes(side_by_side(*bars), cranks)
    own = [[mode.coordinate("rocker_0").value for mode in sp.assembly_modes(
        side_by_side(bar), {"crank_0": cranks[f"crank_{k}"]})] for k, bar in enumerate(bars)]
    assert [len(x) for x in own] == [2, 2, 2]
    expected = sorted((round(a, 6), round(b, 6), round(c, 6))
                      for a in own[0] for b in own[1] for c in own[2])
    assert rockers(modes, 3) == expected
    assert max(mode.closure_error for mode in modes) < 1e-12
    assert len({mode.branch for mode in modes}) == 8
    assert modes.missing < 1e-6 and modes.is_whole
    assert modes.held == pytest.approx(cranks)


def test_branches_are_signed_as_the_determinant_of_all_loops():
    """Crossed and open four-bars have opposite signs; of two the product counts."""
    bars = [(0.3, 0.9, 0.7), (0.4, 0.9, 0.8)]
    modes = sp.assembly_modes(side_by_side(*bars), {"crank_0": 0.5, "crank_1": 0.9})
    angles = np.array([[mode.coordinate(f"rocker_{k}").value for k in (0, 1)] for mode in modes])
    signs = {tuple(pair): mode.branch[0] for pair, mode in zip(
        (angles > angles.mean(axis=0)).tolist(), modes, strict=True)}
    assert signs[True, True] == signs[False, False] != signs[True, False] == signs[False, True]


@pytest.mark.delicate
def test_modes_of_many_legs_are_found_in_a_fraction_of_the_starts():
    modes = sp.assembly_modes(walker(3), {"crank": 1.0})
    assert len(modes) == 8**3 / 2  # two of the legs have eight, and one has four
    assert modes.starts < 10_000
    assert max(mode.closure_error for mode in modes) < 1e-12
    angles = np.array([mode.q for mode in modes])
    apart = np.abs(np.exp(1j * angles[:, None]) - np.exp(1j * angles[None])).max(axis=2)
    assert (apart + np.eye(len(modes)) > 1e-4).all()


@pytest.mark.delicate
def test_a_group_that_can_move_is_reported_with_all_other_loops_closed():
    """A crank without a value moves its own four-bar only."""
    mechanism = side_by_side((0.3, 0.9, 0.7), (0.4, 0.9, 0.8), drivers=["crank_0"])
    with pytest.raises(sp.ContinuumError, match="1 freedom") as caught:
        sp.assembly_modes(mechanism, {"crank_0": 0.5})
    error = caught.value
    assert error.freedoms == 1
    assert set(error.coordinates) == {"crank_1", "coupler_1", "rocker_1"}
    assert error.state.mechanism is mechanism
    assert error.state.closure_error < 1e-10
    assert "with crank_0 = 0.5 held" in str(error)


@pytest.mark.slow
def test_of_more_modes_than_anyone_reads_a_thousand_are_listed():
    modes = sp.assembly_modes(walker(24), {"crank": 1.0})
    assert len(modes) == 1000
    assert modes.missing > 1e15
    assert max(mode.closure_error for mode in modes) < 1e-12
