"""Passive freedoms of links that a closure welds, and of links carried by chains of hinges.

The measure of all is a spatial four-bar RSSR: its rod spins about the line of its balls, whether
it is one link, or cut and welded, and whether its balls are balls or three hinges that meet.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from folders import DATA
from rods_of_hinges import ROD, joint, link, rssr

import spatial_pin as sp

GEPETTO = DATA / "gepetto"
BARS = {  # finite freedoms, drivers, passive freedoms
    "cassie_like": (7, 5, 2), "talos_like": (7, 6, 1), "wl16_like": (12, 6, 6),
    "digit_like_2legs": (12, 12, 0), "digit_like_2legs_6D": (12, 12, 0),
}


CUTS = [(True, 0, 0), (False, 3, 0), (True, 3, 0), (True, 0, 3), (True, 3, 3)]


@pytest.fixture(params=CUTS, ids=lambda x: f"cut={x[0]} hinges={x[1:]}")
def pair(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[sp.Mechanism, sp.Mechanism]:
    """The RSSR as it is, and written in another way."""
    return rssr(tmp_path / "plain", False), rssr(tmp_path / "other", *request.param)


def states(pair: tuple[sp.Mechanism, sp.Mechanism], crank: float = 0.5) -> list[sp.State]:
    one, other = pair
    first = sp.assemble(one, {"crank": crank})
    rocker = first.coordinate("rocker_pin").value
    return [first, sp.assemble(other, {"crank": crank}, {"rocker_pin": rocker})]


@pytest.mark.delicate
def test_the_rod_spins_however_it_is_written(pair: tuple[sp.Mechanism, sp.Mechanism]) -> None:
    for mechanism, state in zip(pair, states(pair), strict=True):
        found = sp.mobility(mechanism, state)
        assert (found.dof, len(found.passive)) == (2, 1)
        (spin,) = found.passive
        line = state.placement("rod_b").translation - state.placement("rod_a").translation
        assert spin.kind == "spin"
        assert np.linalg.norm(np.cross(spin.axis, line / ROD)) < 1e-9


def test_the_spin_goes_through_both_ends_of_a_rod_that_is_cut(tmp_path: Path) -> None:
    found = sp.mobility(rssr(tmp_path, True))
    assert "through ball_a and ball_b" in str(found)


def test_the_rest_moves_alike(pair: tuple[sp.Mechanism, sp.Mechanism]) -> None:
    moving = [sp.solve_rates(m, s, {"crank": 2.0}, {"crank": -3.0})
              for m, s in zip(pair, states(pair), strict=True)]
    one, other = (np.array(x.coordinate("rocker_pin")) for x in moving)
    assert other == pytest.approx(one, abs=1e-11)
    tips = [sp.jacobian(m, s, "rocker") for m, s in zip(pair, states(pair), strict=True)]
    assert tips[1] == pytest.approx(tips[0], abs=1e-11)


def test_a_sweep_is_the_same(pair: tuple[sp.Mechanism, sp.Mechanism]) -> None:
    values = np.linspace(0.5, 0.7, 12)
    start = states(pair)
    one, other = (sp.sweep(m, "crank", values, speed=2.0, guess=s)
                  for m, s in zip(pair, start, strict=True))
    for x, y in zip(one.coordinate("rocker_pin"), other.coordinate("rocker_pin"), strict=True):
        assert y == pytest.approx(x, abs=1e-10)


@pytest.mark.delicate
def test_there_are_as_many_assembly_modes(pair: tuple[sp.Mechanism, sp.Mechanism]) -> None:
    one, other = (sp.assembly_modes(m, {"crank": 0.5}) for m in pair)
    rockers = [sorted(math.remainder(x.coordinate("rocker_pin").value, 2 * math.pi) for x in modes)
               for modes in (one, other)]
    assert rockers[1] == pytest.approx(rockers[0], abs=1e-9)


def test_forces_are_the_same(pair: tuple[sp.Mechanism, sp.Mechanism]) -> None:
    start = states(pair)
    efforts = [sp.inverse_dynamics(m, s).efforts["crank"] for m, s in zip(pair, start, strict=True)]
    assert efforts[1] == pytest.approx(efforts[0], abs=1e-11)
    falls = [sp.forward_dynamics(m, s).state.coordinate("rocker_pin").acceleration
             for m, s in zip(pair, start, strict=True)]
    assert falls[1] == pytest.approx(falls[0], abs=1e-8)


@pytest.mark.delicate
def test_a_ball_and_a_universal_joint_of_two_hinges_leave_no_spin(tmp_path: Path) -> None:
    for hinges in ((2, 0), (0, 2), (2, 3)):
        mechanism = rssr(tmp_path / str(hinges), True, *hinges)
        found = sp.mobility(mechanism)
        assert (found.dof, found.passive) == (1, ())
        sp.jacobian(mechanism, sp.assemble(mechanism), "rocker")


@pytest.mark.delicate
def test_a_link_at_the_end_is_counted_among_the_freedoms_to_prescribe(tmp_path: Path) -> None:
    names = ["ground", "a", "b", "c"]
    (tmp_path / "arm.urdf").write_text('<robot name="arm">' + "".join([
        *map(link, names), *(joint(f"on_{y}", "continuous", x, y, "0 0 1", axis=axis)
                             for x, y, axis in zip(names, names[1:], ("0 0 1", "1 0 0", "0 1 0"),
                                                   strict=False))]) + "</robot>")
    toml = tmp_path / "arm.toml"
    toml.write_text('name = "arm"\ntree = "arm.urdf"\n[drivers.p]\njoint = "on_a"\n')
    mechanism = sp.load(toml)
    with pytest.raises(sp.SingularError, match=r"2 of its freedoms .* more of on_b, on_c"):
        sp.jacobian(mechanism, sp.assemble(mechanism), "c")


@pytest.mark.delicate
@pytest.mark.parametrize("name", BARS)
def test_robots_whose_rods_are_cut_by_welds(name: str) -> None:
    dof, drivers, passive = BARS[name]
    mechanism = sp.load(GEPETTO / name)
    state = sp.assemble(mechanism)
    found = sp.mobility(mechanism, state)
    assert (found.dof, len(mechanism.drivers), len(found.passive)) == (dof, drivers, passive)
    assert dof == drivers + passive
    link = mechanism.links[-1]
    jacobian = sp.jacobian(mechanism, state, link)
    speeds = dict.fromkeys(mechanism.drivers, 0.0)
    for k, driver in enumerate(mechanism.drivers):
        moving = sp.solve_rates(mechanism, state, {**speeds, driver: 1.0})
        assert moving.velocity(link).vector == pytest.approx(jacobian[:, k], abs=1e-9)
    opened = sp.closure_jacobian(mechanism, state) @ moving.v
    assert opened == pytest.approx(np.zeros(len(opened)), abs=1e-10)
    assert pin.isNormalized(mechanism.model, state.q)
