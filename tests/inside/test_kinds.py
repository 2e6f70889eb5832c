"""A kind of closure equation is one entry in Python and one in C, and tells all derivatives."""

from __future__ import annotations

import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from closure_trees import check_derivatives, pose, refinement
from folders import ROOT
from kernel_checks import asked_at, assert_same_as_pinocchio
from masses import heavy
from mechanisms import closure, driver, floating, load, point
from mpmath import atan2, cos, exp, mp, sin, taylor

import spatial_pin as sp
from spatial_pin.constraints.closure_equations import Evaluation
from spatial_pin.constraints.compiled_equations import Constraints
from spatial_pin.constraints.composed_equations import composed_rates
from spatial_pin.constraints.kinds import KINDS, Kind, Parts
from spatial_pin.kernel.library import opened
from spatial_pin.mechanism.equations import ConstraintEquation
from spatial_pin.mechanism.pairs import PAIRS
from spatial_pin.numerics.taylor import Taylor, argument

sys.path.insert(0, str(ROOT / "scripts"))
import build_kernel

# ---------------------------------------------------------------- series


def series(function, order: int = 3) -> Taylor:
    return Taylor([float(c) for c in taylor(function, 0, order)])


def test_products_and_angles_of_series_are_those_of_functions():
    x, y = (lambda t: sin(t + 1) * exp(t)), (lambda t: cos(2 * t + 1) + t**3)
    for found, function in (
            (series(x) * series(y) - 2.0 * series(x) + 1.0, lambda t: x(t) * y(t) - 2 * x(t) + 1),
            (argument(series(x), series(y)), lambda t: atan2(x(t), y(t)))):
        with mp.workdps(30):
            expected = [float(c) for c in taylor(function, 0, 3)]
        np.testing.assert_allclose(found.values, expected, rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("order", [0, 1, 2])
def test_changes_are_derivatives_by_a_second_parameter(order):
    h = 1e-5
    slope = np.array([0.3, -0.7, 0.2])[: order + 1]
    other = np.array([-0.5, 0.1, 0.4])[: order + 1]
    s, c = np.array([0.6, 1.0, -0.5])[: order + 1], np.array([-0.2, 0.7, 0.9])[: order + 1]

    def of(e: float) -> Taylor:
        sine, cosine = Taylor([*(s + e * slope)]), Taylor([*(c + e * other)])
        return sine * cosine - argument(sine, cosine, 7.0)

    sine, cosine = Taylor([*s], [*slope]), Taylor([*c], [*other])
    found = sine * cosine - argument(sine, cosine, 7.0)
    assert found.values == of(0.0).values
    for k in range(order + 1):
        expected = (of(h).values[k] - of(-h).values[k]) / (2.0 * h)
        assert found.changes[k] == pytest.approx(expected, rel=1e-8, abs=1e-8)


# ---------------------------------------------------------------- a new kind

# slide - rise * sine * cosine of the turn: what a cam with two lobes would do
CAM = Kind(5, lambda slide, sine, cosine, rise: slide - rise * (sine * cosine),
           lambda compiler, closure, row: Parts(compiler.add_direction(closure, row), (),
                                                (row.offset * compiler.scale,)))
IN_C = """
static void value_of_cam(Kernel *k, Int equation, const Int *of, const Real *by)
{
    k->residual[equation] = k->value[of[0]] - by[0] * k->value[of[1]] * k->value[of[2]];
}

static void jacobian_of_cam(Kernel *k, Int equation, const Int *of, const Real *by)
{
    add_product_row(k, of[0], 1.0);
    add_product_row(k, of[1], -by[0] * k->value[of[2]]);
    add_product_row(k, of[2], -by[0] * k->value[of[1]]);
    store_row(k, equation);
}

static void bias_of_cam(Kernel *k, Int equation, const Int *of, const Real *by)
{
    const Real *p = k->value, *d = k->product_rate, *dd = k->product_bias;
    k->bias[equation] = dd[of[0]] - by[0] * (dd[of[1]] * p[of[2]] + 2.0 * d[of[1]] * d[of[2]] +
                                             p[of[1]] * dd[of[2]]);
}
"""
TABLE = "static const EquationTable TABLE[] = {\n"
LAST = "    [IDLE] ="


@pytest.fixture(scope="module")
def kernel_with_cams(tmp_path_factory):
    """The kernel, compiled with one entry more in the table of equations.c."""
    root = tmp_path_factory.mktemp("source")
    folder = root / build_kernel.KERNEL
    shutil.copytree(ROOT / build_kernel.KERNEL, folder, ignore=shutil.ignore_patterns("_*"))
    text = (folder / "core" / "equations.c").read_text()
    assert text.count(TABLE) == text.count(LAST) == 1
    text = text.replace(TABLE, IN_C + TABLE).replace(
        LAST, "    [5] = {3, 0, 0, value_of_cam, jacobian_of_cam, bias_of_cam},\n" + LAST)
    (folder / "core" / "equations.c").write_text(text)
    return opened(build_kernel.compile_kernel(root, ["-O0", "-fno-lto"]))


@pytest.fixture
def cams(monkeypatch, kernel_with_cams):
    """Screws become cams: one entry in the table of kinds, and a pair that has such a row."""

    def rows(g):
        return (ConstraintEquation(u=g.axes1[:, 2], offset=0.4, kind="cam",
                                   angle_from=g.axes1[:, :2].T, angle_of=g.axes2[:, 0]),)

    monkeypatch.setattr("spatial_pin.kernel.kernel.library", lambda: kernel_with_cams)
    monkeypatch.setitem(KINDS, "cam", CAM)
    monkeypatch.setitem(PAIRS, "screw", replace(PAIRS["screw"], rows=rows, aligned=""))


def cam(folder: Path, joint: str, seed: int = 3) -> sp.Mechanism:
    """Two moving bodies on a cam's two sides."""
    rng = np.random.default_rng(seed)
    tree = floating("to_a", "ground", "a", **pose(rng)) + floating("to_b", "a", "b", **pose(rng))
    tree += point("at_a", "ground", **pose(rng)) + point("at_b", "b", **pose(rng))
    bar = 1.2, (0.1, 0.0, 0.05), (0.02, 0.03, 0.015)
    tree = heavy(tree, a=bar, b=bar)
    toml = refinement("to_a", joint, rng) + refinement("to_b", "cylindrical", rng)
    return load(folder, "cam", tree, toml + driver("turn", "to_b.angle") + closure(
        "c", "screw", "at_a", "at_b", lead=0.1))


@pytest.mark.parametrize("joint", ["revolute", "spherical"])
def test_a_kind_is_one_entry_in_python_and_one_in_c(tmp_path, cams, joint):
    mechanism, rng = cam(tmp_path, joint), np.random.default_rng(1)
    for _ in range(5):
        q, v = asked_at(mechanism, rng)
        check_derivatives(Evaluation(Constraints(mechanism)), q, v)
        assert_same_as_pinocchio(mechanism, q, v)


def test_a_new_kind_moves_and_bears_forces(tmp_path, cams):
    """What is written of it is its formula alone: rates to the third order, forces, derivatives."""
    mechanism = cam(tmp_path, "revolute")
    state = sp.solve_rates(mechanism, sp.assemble(mechanism, {"turn": 0.4, "to_a": 0.1}),
                           {"turn": 1.3, "to_a": 0.7}, {"turn": 0.2, "to_a": -0.3})
    assert state.closure_error < 1e-12
    jerk = sp.solve_jerks(mechanism, state, {"turn": -0.5, "to_a": 0.6}).j
    h = 1e-4
    ends = [pin.integrate(mechanism.model, state.q,
                          t * state.v + t**2 / 2 * state.a + t**3 / 6 * jerk) for t in (-h, h)]
    evaluation = Evaluation(Constraints(mechanism))
    for q in ends:
        evaluation.update(q)
        assert evaluation.closure_error < 1e-13  # h^4
    answer = sp.forward_dynamics(mechanism, state)
    evaluation.update(state.q)
    rates = evaluation.bias(state.q, state.v) + evaluation.jacobian @ (
        answer.a / mechanism.velocity_scale)
    assert np.abs(rates).max() < 1e-10 * (1.0 + np.abs(answer.a).max())


def test_the_kinds_are_numbered_as_in_the_kernel():
    text = (ROOT / build_kernel.KERNEL / "core" / "kernel.h").read_text()
    assert [k.code for k in KINDS.values()] == list(range(len(KINDS)))
    for name, code in (("PRODUCT", 0), ("SCREW_ANGLE", 1), ("DIFFERENCE", 2), ("COUPLING", 3),
                       ("IDLE", 4)):
        assert f" {name} = {code}" in text


def test_composed_equations_have_their_products_rates(tmp_path, cams):
    """A polynomial of products: the rule of Leibniz, of order three."""
    c = Constraints(cam(tmp_path, "revolute"))
    (e,) = c.equations
    p = np.random.default_rng(0).normal(size=(4, len(c.constants)))
    s, co = p[:, e.products[1]], p[:, e.products[2]]
    third = s[3] * co[0] + 3 * s[2] * co[1] + 3 * s[1] * co[2] + s[0] * co[3]
    (found,) = composed_rates(c, list(p), [])
    assert found == pytest.approx(p[3, 0] - e.numbers[0] * third, rel=1e-14)
