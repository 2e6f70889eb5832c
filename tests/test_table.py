"""A mechanism of one freedom as functions of its coordinate: pieces, cells, crossings."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest

import spatial_pin as sp
from spatial_pin.accuracy.cases import CASES
from spatial_pin.constraints.closure_equations import Evaluation, constraints_of
from spatial_pin.dynamics.simulation.formulations.one_freedom import OneFreedom
from spatial_pin.dynamics.simulation.formulations.sample_energies import PlacedRows
from spatial_pin.dynamics.simulation.independent_coordinates import Lost
from spatial_pin.dynamics.simulation.problem import Problem
from spatial_pin.dynamics.simulation.simulate import _independent
from spatial_pin.numerics.chebyshev import NODES, points, polynomials_at

ONE_FREEDOM = ("ladder_1", "bricard")


def equations(name: str, tolerance: float = 1e-13) -> OneFreedom:
    case = CASES[name]
    mechanism = case.build()
    problem = Problem(mechanism, None, None, None, tolerance)
    found = _independent(problem, case.begin(mechanism))
    assert isinstance(found, OneFreedom)
    return found


@pytest.mark.parametrize("name", ONE_FREEDOM)
def test_nodes_closed_together_are_those_closed_one_by_one(name: str) -> None:
    together, alone = equations(name), equations(name)
    alone.table.rows._batch = None
    nodes = together.start + 0.4 * (1.0 + points(NODES))
    assert len(together.table.rows._together(nodes[::-1])) == NODES
    found, expected = together.table.rows(nodes), alone.table.rows(nodes)
    assert np.abs(found - expected).max() < 1e-12 * np.abs(expected).max()


@pytest.mark.parametrize("name", ONE_FREEDOM)
def test_the_inertial_force_is_half_the_slope_of_the_inertia(name: str) -> None:
    """Lagrange: m s'' + m'/2 s'^2 + V' = 0, so that h = m'/2 and g = V'."""
    table = equations(name).table
    table.reduced(table.path.start + 0.1)
    piece = table.piece
    assert piece is not None
    x = np.linspace(-0.9, 0.9, 7)
    values = polynomials_at(x) @ piece.coefficients[:, table.columns.reduced]
    slopes = np.polynomial.chebyshev.chebder(piece.coefficients[:, table.columns.reduced])
    slopes = np.polynomial.chebyshev.chebval(x, slopes) * 2.0 / (piece.last - piece.first)
    size = np.abs(values[:, 0]).max()
    assert np.abs(slopes[0] / 2.0 - values[:, 1]).max() < 1e-10 * size
    assert np.abs(slopes[3] - values[:, 2]).max() < 1e-10 * np.abs(values[:, 2]).max()


@pytest.mark.parametrize("name", ONE_FREEDOM)
def test_cells_are_the_chebyshev_polynomials_that_they_were_cut_from(name: str) -> None:
    table = equations(name).table
    for s in table.path.start + np.linspace(0.0, 0.3, 400):
        whole = table.columns_at(float(s))[table.columns.reduced][:3]
        assert np.abs(np.array(table.reduced(float(s))) - whole).max() < 2e-13 * np.abs(whole).max()


def test_a_crossing_is_found_from_where_pivots_fall() -> None:
    """The parallelogram's rods lie flat a quarter of a turn from upright."""
    path = equations("ladder_1").path
    path.go_to(path.start + 2.0)
    assert path.crossings == pytest.approx([math.pi / 2], abs=1e-9)
    path.go_to(path.start + 0.5)
    assert len(path.crossings) == 1


def test_a_limit_is_no_crossing_and_is_remembered() -> None:
    table = equations("bricard").table
    limit = 7.0 * math.pi / 6.0  # of the cube's first hinge
    with pytest.raises(Lost):
        table.reduced(limit + 0.01)
    assert not table.path.crossings
    assert table.path.limits == pytest.approx([limit], abs=1e-6)
    table.reduced(limit - 0.3)  # and the branch is not lost with it


def test_a_rough_closure_makes_a_rougher_table_with_fewer_nodes() -> None:
    fine, rough = equations("bricard"), equations("bricard", 1e-8)
    for system in (fine, rough):
        for s in (0.1, 1.2, 2.3):
            system.table.reduced(system.start + s)
    assert rough.table.nodes < fine.table.nodes
    for s in np.linspace(0.1, 2.3, 50):
        one, two = (x.table.columns_at(x.start + float(s)) for x in (fine, rough))
        assert np.abs(one - two).max() < 1e-8


def test_rows_have_the_energy_of_single_evaluations() -> None:
    case = CASES["bricard"]
    mechanism = case.build()
    motion = sp.simulate(mechanism, case.begin(mechanism), 1.0, times=np.linspace(0.0, 1.0, 20))
    problem = Problem(mechanism, None, None, None, 1e-13)
    evaluation = equations("bricard").evaluation
    for k, (q, v) in enumerate(zip(motion.q, motion.v, strict=True)):
        evaluation.update(q)
        assert problem.energy(q, v, evaluation) == pytest.approx(motion.energy[k], rel=1e-13)
        assert evaluation.closure_error == pytest.approx(motion.closure_error[k], abs=1e-15)


@pytest.mark.parametrize("name", sorted(CASES))
def test_rows_placed_together_are_those_placed_one_by_one(name: str) -> None:
    case = CASES[name]
    mechanism = case.build()
    problem, state = Problem(mechanism, None, None, None, 1e-13), case.begin(mechanism)
    evaluation = Evaluation(constraints_of(mechanism))
    placed, rng = PlacedRows(problem, evaluation), np.random.default_rng(1)
    v = rng.normal(size=(3, mechanism.model.nv))
    q = np.array([pin.integrate(mechanism.model, state.q, 0.1 * row) for row in v])
    near = np.tile(state.angles, (3, 1))
    for found, expected in zip(placed(q, v, near), placed._one_by_one(q, v, near), strict=True):
        assert np.abs(found - expected).max(initial=0.0) < 1e-12 * (
            1.0 + np.abs(expected).max(initial=0.0))
