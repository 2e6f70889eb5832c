"""Closures of a few bodies: what they close to, and what of them Pinocchio has."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from closure_trees import CLOSURE_TYPES, COUPLING, relative, somewhere, tree_with, two_bodies
from mechanisms import closure, coupling, driver, floating, load, point, turning

import spatial_pin as sp


@pytest.mark.parametrize("kind", ["weld", "prismatic", "revolute"])
def test_assembly_from_any_orientation_ends_in_the_right_one(tmp_path, kind):
    tree = floating("free", "ground", "body", (0.2, 0.1, 0)) + point("place", "ground", (0.3, 0,
                                                                                         0.2))
    mechanism = load(tmp_path, "loose", tree, closure("c", kind, "place", "body"))
    rng = np.random.default_rng(13)
    for _ in range(40):
        start = np.concatenate([rng.uniform(-0.5, 0.5, 3), pin.Quaternion(
            pin.exp3(rng.uniform(-1.8, 1.8, 3))).coeffs()])
        state = sp.assemble(mechanism, {}, guess=start)
        M = state.placement("place").actInv(state.placement("body"))
        assert M.rotation[2, 2] == pytest.approx(1.0, abs=1e-12)
        if kind != "revolute":
            np.testing.assert_allclose(M.rotation, np.eye(3), rtol=0, atol=1e-11)


@pytest.mark.parametrize("kind", ["spherical", "weld"])
def test_native_forms_measure_the_same_gap(tmp_path, kind):
    mechanism, rng = tree_with(tmp_path, "revolute", ("leaf", "right"), kind, 16)
    native = mechanism.constraint_models()[0]
    q = somewhere(mechanism, rng)
    data = mechanism.model.createData()
    pin.forwardKinematics(mechanism.model, data, q)
    first = data.oMi[native.joint1_id] * native.joint1_placement
    second = data.oMi[native.joint2_id] * native.joint2_placement
    M = first.actInv(second)
    assert M.isApprox(relative(mechanism, q), 1e-12)
    assert native.name == "c"


@pytest.mark.parametrize("kind", [t for t in CLOSURE_TYPES
                                  if t not in ("spherical", "weld", "fixed", COUPLING)])
def test_what_pinocchio_cannot_express_is_stated(tmp_path, kind):
    with pytest.raises(sp.ClosureTypeError, match=f"'c' is {kind}"):
        two_bodies(tmp_path, kind).constraint_models()


def test_driver_of_a_coupled_pair_keeps_its_name(tmp_path):
    tree = turning("a", "ground", "la") + turning("b", "ground", "lb", (0.1, 0, 0))
    mechanism = load(tmp_path, "named", tree, coupling("mesh", "a", "b", -3.0) + driver("in", "a"))
    state = sp.assemble(mechanism, {"in": 2.0})
    assert state.coordinate("b").value == pytest.approx(-6.0, abs=1e-14)
    with pytest.raises(sp.ClosureTypeError, match="coupling"):
        mechanism.constraint_models()
