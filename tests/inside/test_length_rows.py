"""Distances that are those of two other frames: rows, by all that evaluates them, and pictures."""

from __future__ import annotations

import mechanisms as known
import numpy as np
import pinocchio as pin
import pytest
from closure_trees import (
    ENDS,
    FIRST,
    JOINTS,
    STEP,
    along,
    check_derivatives,
    somewhere,
    tree_between,
)
from derivative_cases import WEIGHT
from kernel_checks import assert_same, check_kernel, configurations
from masses import heavy
from mechanisms import RAM, between, load, point
from variety import paired

import spatial_pin as sp
from spatial_pin.accuracy.extended import Extended
from spatial_pin.constraints import kernel_tree
from spatial_pin.dynamics.solvers.equations_of_motion import Equations
from spatial_pin.kernel.loop_equations import LoopEquations, twist_derivatives
from spatial_pin.view.scene.film import film
from spatial_pin.view.scene.meshcat_commands import scene

WHERE = {"beside": ENDS[0], "within": ENDS[1], "across": ENDS[2]}
every_place = pytest.mark.parametrize("ends", WHERE.values(), ids=WHERE)
every_joint_and_place = pytest.mark.parametrize(("joint", "place"), paired(JOINTS, [*WHERE]))


def squares(mechanism: sp.Mechanism, q: np.ndarray) -> np.ndarray:
    """The squared distances of the two pairs of frames."""
    data = mechanism.model.createData()
    pin.framesForwardKinematics(mechanism.model, data, q)
    ends = [data.oMf[mechanism.frame_id(f"end_{k}")].translation for k in range(4)]
    return np.array([np.sum((ends[1] - ends[0]) ** 2), np.sum((ends[3] - ends[2]) ** 2)])


@every_place
def test_the_row_is_the_difference_of_the_lengths_near_the_guess(tmp_path, ends):
    mechanism, rng = tree_between(tmp_path, "floating", ends, 1)
    evaluation = LoopEquations(mechanism)
    length = np.sqrt(squares(mechanism, mechanism.neutral)[1])
    for _ in range(10):
        q = somewhere(mechanism, rng)
        one, other = squares(mechanism, q)
        evaluation.update(q)
        expected = (one - other) / (2.0 * length * mechanism.characteristic_length)
        assert evaluation.residual[0] == pytest.approx(expected, rel=1e-13, abs=1e-14)


@every_joint_and_place
def test_jacobian_and_bias_are_derivatives(tmp_path, joint, place):
    mechanism, rng = tree_between(tmp_path, joint, WHERE[place], 3)
    evaluation = LoopEquations(mechanism)
    q, nv = somewhere(mechanism, rng), mechanism.model.nv
    v = rng.uniform(-1.0, 1.0, nv)
    size = check_derivatives(evaluation, q, v)
    columns = np.array([FIRST @ along(evaluation, q, e) / STEP for e in np.eye(nv)]).T
    evaluation.update(q)
    np.testing.assert_allclose(sp.closure_jacobian(mechanism, q), columns, rtol=0,
                               atol=1e-10 * size)


@every_joint_and_place
def test_equations_of_many_configurations_and_of_the_kernel_are_the_same(tmp_path, joint, place):
    mechanism, _ = tree_between(tmp_path, joint, WHERE[place], 9)
    q = configurations(mechanism, 10)
    check_kernel(mechanism, q)
    evaluation, equations = LoopEquations(mechanism), Equations(mechanism)
    evaluation.update(q[:, 0])
    none, dense = np.zeros(mechanism.model.nv), np.zeros_like(evaluation.jacobian)
    kkt, (at, columns, indices) = equations.kkt, kernel_tree.mass_entries(equations.tree, True)
    kkt.mass[indices] = at == columns
    kkt.accelerations(q[:, 0], none, evaluation.angle_reference, none, none)
    rows, columns, values = kkt.entries
    assert len(set(zip(rows.tolist(), columns.tolist(), strict=True))) == len(rows)
    dense[rows, columns] = values
    assert_same(dense, evaluation.jacobian)


@every_place
def test_rates_in_extended_precision_are_the_same(tmp_path, ends):
    mechanism, rng = tree_between(tmp_path, "universal", ends, 5)
    nv = mechanism.model.nv
    q, v, a = somewhere(mechanism, rng), *rng.uniform(-1.0, 1.0, (2, nv))
    evaluation = LoopEquations(mechanism)
    evaluation.update(q)
    rates = [evaluation.residual.copy(), evaluation.jacobian @ (v / mechanism.velocity_scale)]
    second = evaluation.jacobian @ (a / mechanism.velocity_scale) + evaluation.bias(q, v)
    rows = [x[None].astype(np.longdouble) for x in (q, v, a)]
    found = Extended(mechanism).rows(*rows, np.zeros((1, 0)))[:, 0]
    assert np.abs(found - np.array([*rates, second])).max() < 1e-14


def test_a_twist_of_what_a_joint_carries_changes_the_row_as_its_coordinate_does(tmp_path):
    for ends in ENDS:
        mechanism, rng = tree_between(tmp_path, "revolute", ends, 6)
        evaluation = LoopEquations(mechanism)
        q = somewhere(mechanism, rng)
        evaluation.update(q)
        columns = np.array(evaluation.data.J).reshape(6, -1)
        for i in range(1, mechanism.model.njoints):
            k = mechanism.model.idx_vs[i]
            moved = twist_derivatives(mechanism, i, q[None], evaluation.placements[None],
                                      np.zeros((1, 0)))[0]
            assert_same(moved @ columns[:, k], evaluation.jacobian[:, k])


def test_many_of_them_by_sparse_factorisation(tmp_path, monkeypatch):
    """Arms one on the other, each held by a ram."""
    tree, toml, start, n = "", "", {}, 32
    for k in range(n):
        below, at = ("ground", 0.0) if k == 0 else (f"arm{k - 1}", 0.3)
        tree += known.turning(f"shoulder{k}", below, f"arm{k}", (at, 0, 0))
        tree += point(f"tip{k}", f"arm{k}", (0.3, 0, 0.1))
        tree += point(f"anchor{k}", below, (at + 0.4, 0.05, 0))
        tree += known.sliding(f"stroke{k}", "ground", f"piston{k}", axis=(0, 0.6, 0.8))
        tree += point(f"end{k}", f"piston{k}", RAM["start"])
        toml += between(f"rod{k}", (f"anchor{k}", f"tip{k}"), ("ground", f"end{k}"))
        start |= {f"shoulder{k}": 1.0, f"stroke{k}": 0.3}
    tree = heavy(tree, **{f"{part}{k}": WEIGHT for part in ("arm", "piston") for k in range(n)})
    found = []
    for large in (kernel_tree.WHOLE, 10**9):
        monkeypatch.setattr(kernel_tree, "WHOLE", large)
        mechanism = load(tmp_path, "chain", tree, toml + known.guess(**start))
        assert kernel_tree.is_large(mechanism.model) == (large < 10**9)
        found.append(sp.forward_dynamics(mechanism, sp.assemble(mechanism)))
    one, other = found
    np.testing.assert_allclose(one.a, other.a, atol=1e-12 * np.abs(other.a).max())
    largest = max(np.abs(r.vector).max() for r in other.reactions.values())
    for name, force in other.reactions.items():
        np.testing.assert_allclose(one.reactions[name].vector, force.vector, atol=1e-12 * largest)


def test_the_rod_grows_with_the_ram_and_a_gap_is_reported_by_it(tmp_path):
    mechanism = known.arm_on_a_ram(tmp_path)
    closed = sp.assemble(mechanism, {"ram": 0.3})
    q = closed.q.copy()
    q[mechanism.coordinate("shoulder").q] += 0.2
    state = sp.State(mechanism, q, closure_error=1.0)
    items = {item.name: item for item in scene(film(state)).layer.items}
    here, there = (items[f"gap rod {end}"].track.poses[0, :3] for end in ("from", "to"))
    tip, anchor = (state.placement(n).translation for n in ("tip", "anchor"))
    e = state.placement("end").translation - state.placement("foot").translation
    np.testing.assert_allclose(there, tip, atol=1e-12)
    assert np.linalg.norm(here - anchor) == pytest.approx(np.linalg.norm(e), abs=1e-12)
