"""Robots that stand on the ground: legs that close loops, more motors than freedoms."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from machines import free_bases

import spatial_pin as sp

LEGS = ("FL", "FR", "HL", "HR")
SIX = ["FL_HFE", "FL_KFE", "FR_HAA", "FR_HFE", "HL_HAA", "HL_KFE"]
CROUCH = {f"leg_{side}_{k}_joint": angle for side in ("left", "right")
          for k, angle in ((3, -0.4), (4, 0.8), (5, -0.4))}


def published(name: str) -> Path:
    """Return a URDF of the package example-robot-data."""
    roots = (Path(p) / "cmeel.prefix/share/example-robot-data/robots" for p in sys.path)
    found = next((root / name for root in roots if root.is_dir()), None)
    if found is None:
        pytest.skip("example-robot-data is not installed")
    return found


def standing(
    file: Path, folder: Path, feet: list[str], kind: str, pose: dict[str, float]
) -> sp.Mechanism:
    """Return a robot whose feet are joined to the ground where they are in a pose."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of meshes and inertias, which play no part
        free = sp.load(file, free_flyer=True)
        state = sp.assemble(free, {}, pose)
        closures = []
        for foot in feet:
            place = state.placement(foot)
            make = {"spherical": sp.closures.spherical, "weld": sp.closures.weld}[kind]
            closures.append(make(("world", place), foot, name=f"on_{foot}"))
        return sp.Mechanism.from_model(
            free.model, closures=closures, drivers=list(free.drivers), guess=pose)


@pytest.fixture(scope="module")
def solo(tmp_path_factory: pytest.TempPathFactory) -> sp.Mechanism:
    sense = dict(zip(LEGS, (1.0, 1.0, -1.0, -1.0), strict=True))
    pose = {f"{leg}_{joint}": sense[leg] * angle for leg in LEGS
            for joint, angle in (("HFE", 0.7), ("KFE", -1.4))}
    return standing(published("solo_description/robots/solo12.urdf"),
                    tmp_path_factory.mktemp("solo"), [f"{leg}_FOOT" for leg in LEGS],
                    "spherical", pose)


@pytest.fixture(scope="module")
def talos(tmp_path_factory: pytest.TempPathFactory) -> sp.Mechanism:
    return standing(published("talos_data/robots/talos_reduced.urdf"),
                    tmp_path_factory.mktemp("talos"), ["left_sole_link", "right_sole_link"],
                    "weld", CROUCH)


def weight(mechanism: sp.Mechanism) -> float:
    return float(sum(x.mass for x in mechanism.model.inertias) * 9.81)


@pytest.mark.delicate
def test_four_feet_leave_six_freedoms_and_twelve_motors(solo: sp.Mechanism) -> None:
    state = sp.assemble(solo)
    found = sp.mobility(solo, state)
    assert (found.dof, found.rank, found.passive, len(solo.drivers)) == (6, 12, (), 12)
    assert free_bases(solo) == ()  # its feet hold it: it is no free base


def test_the_feet_bear_the_weight(solo: sp.Mechanism) -> None:
    state = sp.assemble(solo)
    for actuated in (None, SIX):
        found = sp.inverse_dynamics(solo, state, actuated)
        feet = sum(np.array(force.linear) for name, force in found.reactions.items()
                   if name.startswith("on_"))
        assert feet == pytest.approx([0.0, 0.0, weight(solo)], abs=1e-9)
        assert feet[2] == pytest.approx(24.525, abs=1e-4)


@pytest.mark.delicate
def test_efforts_of_twelve_motors_are_one_of_many_and_of_six_are_not(solo: sp.Mechanism) -> None:
    state = sp.assemble(solo)
    twelve, six = sp.inverse_dynamics(solo, state), sp.inverse_dynamics(solo, state, SIX)
    assert not any(twelve.unique_efforts.values()) and all(six.unique_efforts.values())
    assert not twelve.unique["on_FL_FOOT"][:3].any() and twelve.unique["on_FL_FOOT"][3:].all()
    assert all(each.all() for each in six.unique.values())
    assert "FL_HFE: " in str(twelve) and "* (power" in str(twelve)
    assert "one of many" in str(twelve) and "one of many" not in str(six)
    assert sum(x * x for x in twelve.efforts.values()) <= sum(x * x for x in six.efforts.values())
    for found in (twelve, six):  # both hold it: no freedom of the loops is left with a force
        tau = np.zeros(solo.model.nv)
        for name, effort in found.efforts.items():
            tau[solo.coordinate(name).v] = effort
        gravity = pin.computeGeneralizedGravity(solo.model, solo.model.createData(), state.q)
        rows = sp.closure_jacobian(solo, state)
        left = np.linalg.svd(rows)[2][12:] @ (gravity - tau)
        assert left == pytest.approx(np.zeros(6), abs=1e-11)


def test_kinetostatics_tells_the_same(solo: sp.Mechanism) -> None:
    motion = sp.sweep(solo, "FL_KFE", np.linspace(-1.4, -1.3, 4))
    found = sp.kinetostatics(solo, motion)
    assert not found.unique["on_HR_FOOT"][:, :3].any()
    assert sp.kinetostatics(solo, motion, SIX).determined["on_HR_FOOT"].all()


@pytest.mark.delicate
def test_drivers_are_chosen_where_there_are_too_many(solo: sp.Mechanism) -> None:
    state = sp.assemble(solo)
    jacobian = sp.jacobian(solo, state, "base_link", SIX)
    assert jacobian.shape == (6, 6)
    rates = [sp.solve_rates(solo, state, {name: float(name == one) for name in SIX})
             for one in SIX]
    columns = np.array([x.velocity("base_link").vector for x in rates]).T
    assert columns == pytest.approx(jacobian, abs=1e-11)
    turned = sp.jacobian(solo, state, "base_link", SIX[::-1])
    assert turned == pytest.approx(jacobian[:, ::-1], abs=1e-11)


@pytest.mark.delicate
def test_too_many_drivers_are_named_with_those_that_depend_on_others(solo: sp.Mechanism) -> None:
    state = sp.assemble(solo)
    with pytest.raises(sp.SingularError, match=r"12 coord.* 6 freedoms .*leave out 6, such as 'F"):
        sp.jacobian(solo, state, "base_link")
    with pytest.raises(sp.SingularError, match="leave out 1, such as 'HR_KFE', which the others"):
        sp.jacobian(solo, state, "base_link", [*SIX, "HR_KFE"])


def test_too_few_drivers_are_reported_with_the_freedoms_left(solo: sp.Mechanism) -> None:
    with pytest.raises(sp.SingularError, match=r"2 of its freedoms are not .*root_joint\.x"):
        sp.jacobian(solo, sp.assemble(solo), "base_link", SIX[:4])


@pytest.mark.delicate
def test_drivers_that_depend_on_each_other_are_named(solo: sp.Mechanism) -> None:
    state = sp.assemble(solo)
    with pytest.raises(sp.SingularError, match="only: 'HR_KFE' goes as the others do"):
        sp.jacobian(solo, state, "base_link",
                    ["FL_HAA", "FL_HFE", "FL_KFE", "HR_HAA", "HR_HFE", "HR_KFE"])
    with pytest.raises(ValueError, match="drivers: 'FL_HAA' is named twice"):
        sp.jacobian(solo, state, "base_link", ["FL_HAA", "FL_HAA"])


def test_the_trunks_rotation_is_held_while_it_goes_up_and_down(solo: sp.Mechanism) -> None:
    start = sp.assemble(solo)
    height = start.placement("base_link").translation[2]
    motion = sp.sweep(solo, "root_joint.z", height + np.linspace(0.0, -0.03, 5),
                      hold=["root_joint.rotation", "root_joint.x", "root_joint.y"])
    trunk = motion.frame("base_link")
    assert trunk.rotation == pytest.approx(np.tile(np.eye(3), (5, 1, 1)), abs=1e-12)
    assert trunk.position[:, 2] == pytest.approx(height + np.linspace(0.0, -0.03, 5), abs=1e-12)
    assert trunk.position[:, :2] == pytest.approx(np.zeros((5, 2)), abs=1e-12)
    assert motion.closure_error.max() < 1e-12


@pytest.mark.delicate
def test_welded_feet_of_three_hinges_a_leg_leave_one_freedom(tmp_path: Path) -> None:
    """All knees bend at once: the legs are parallel cranks."""
    sense = dict(zip(LEGS, (1.0, 1.0, -1.0, -1.0), strict=True))
    pose = {f"{leg}_{joint}": sense[leg] * angle for leg in LEGS
            for joint, angle in (("HFE", 0.7), ("KFE", -1.4))}
    solo = standing(published("solo_description/robots/solo12.urdf"), tmp_path,
                    [f"{leg}_FOOT" for leg in LEGS], "weld", pose)
    state = sp.assemble(solo)
    found = sp.mobility(solo, state)
    assert (found.dof, found.rank) == (1, 17)
    forces = sp.inverse_dynamics(solo, state).reactions
    feet = sum(np.array(x.linear) for name, x in forces.items() if name.startswith("on_"))
    assert feet == pytest.approx([0.0, 0.0, weight(solo)], abs=1e-9)


def test_talos_stands_on_both_feet(talos: sp.Mechanism) -> None:
    state = sp.assemble(talos)
    found = sp.mobility(talos, state)
    above = [name for name in talos.drivers if not name.startswith("leg")]
    assert (found.dof, found.rank, len(above)) == (6 + len(above), 12, 20)
    leg = [f"leg_left_{k}_joint" for k in range(1, 7)]
    assert sp.jacobian(talos, state, "base_link", [*leg, *above]).shape == (6, 26)
    forces = sp.inverse_dynamics(talos, state).reactions
    soles = sum(np.array(x.linear) for name, x in forces.items() if name.startswith("on_"))
    assert soles == pytest.approx([0.0, 0.0, weight(talos)], abs=1e-8)
