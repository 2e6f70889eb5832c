"""The ladder of accelerations: the KKT system, the least constraint, a refusal."""

from __future__ import annotations

import mechanisms as known
import numpy as np
import pinocchio as pin
import pytest
from closure_trees import JOINTS, tree_with
from ladders import G, heavy_four_bar, ladder, leaning, moving, uniform
from masses import energy_rate, heavy, with_masses

import spatial_pin as sp
from spatial_pin.constraints.closure_equations import Evaluation
from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.dynamics.forces import joint_efforts
from spatial_pin.dynamics.solvers.accelerations import DOUBTFUL
from spatial_pin.dynamics.solvers.equations import Equations
from spatial_pin.mechanism.inertia import MassMatrix
from spatial_pin.numerics.linalg import decompose, null_space

OVERCONSTRAINED = ["bennett", "bricard", "double_cardan", "four_bar", "hooke_joint", "peaucellier",
                   "sarrus", "spherical_four_bar", "watt_six_bar"]


def by_null_space(mech, state, efforts=None, **load):
    """Accelerations of the freedoms by the mass matrix: M and gamma are Pinocchio's."""
    equations = Equations(mech)
    equations.update(state, **load)
    evaluation, scale, model = equations.evaluation, mech.velocity_scale, mech.model
    svd = decompose(equations.scaled)
    free = svd.null_space * scale
    a = -scale * svd.minimum_norm(evaluation.bias(state.q, state.v)[: equations.n_closure])
    needed = pin.rnea(model, model.createData(), state.q, state.v, a)
    load = free @ (joint_efforts(mech, efforts) + equations.given - needed)
    return a + np.linalg.solve(free @ MassMatrix(model)(state.q) @ free.T, load) @ free


def error_of_kkt(mech, state):
    """The error that the KKT system tells there."""
    equations, none = Equations(mech), np.zeros(mech.model.nv)
    equations.by_kkt(state.q, state.v, state.angles, none, none)
    return equations.kkt.error


def nearby(mech, rng):
    start = sp.assemble(mech, {})
    at = {d: start.coordinate(d).value + rng.uniform(-0.02, 0.02) for d in mech.drivers}
    state = sp.assemble(mech, at, guess=start)
    return sp.solve_rates(mech, state, {d: rng.uniform(-2, 2) for d in mech.drivers})


@pytest.mark.parametrize("name", sp.list_mechanisms())
def test_the_kkt_system_is_taken_and_is_right(name):
    mech, rng = sp.load(name), np.random.default_rng(8)
    if not mech.model.nv or not any(x.mass for x in mech.model.inertias):
        pytest.skip("nothing moves it")
    efforts = {d: float(rng.uniform(-2, 2)) for d in mech.drivers}
    for _ in range(4):
        state = nearby(mech, rng)
        found = sp.forward_dynamics(mech, state, efforts)
        want = by_null_space(mech, state, efforts)
        assert found.a == pytest.approx(want, abs=1e-12 * np.abs(want).max())
        assert found.error < DOUBTFUL and error_of_kkt(mech, state) < DOUBTFUL
        assert np.array_equal(found.a, sp.forward_dynamics(mech, state, efforts).a)


@pytest.mark.parametrize("name", OVERCONSTRAINED)
def test_no_regularisation_is_seen(name):
    """Every closure equation holds, and the power balances, to far below 1e-9."""
    mech, rng = sp.load(name), np.random.default_rng(5)
    state = nearby(mech, rng)
    efforts = {d: 1.5 for d in mech.drivers}
    answer = sp.forward_dynamics(mech, state, efforts)
    evaluation = Evaluation(constraints_of(mech))
    evaluation.update(state.q)
    rows = slice(0, evaluation.constraints.n_closure)
    gamma = evaluation.bias(state.q, state.v)[rows]
    change = evaluation.jacobian[rows] @ (answer.a / mech.velocity_scale)
    size = max(np.abs(gamma).max(), np.abs(answer.a).max())
    assert change + gamma == pytest.approx(np.zeros(len(gamma)), abs=1e-12 * size)
    power = sum(1.5 * state.coordinate(d).rate for d in mech.drivers)
    assert energy_rate(answer.state) == pytest.approx(power, abs=1e-12 * size + 1e-12 * power)


def test_a_law_and_a_spring_act_there_too(tmp_path):
    toml = ('[[springs]]\nname = "s"\nframes = ["tip", "ground"]\nstiffness = 300.0\n'
            "free_length = 0.1\n")
    mech = heavy_four_bar(tmp_path, toml)
    state = moving(mech)
    for laws in (None, {"s": lambda x, rate: 40 * x**2 + rate}):
        found = sp.forward_dynamics(mech, state, laws=laws).a
        want = by_null_space(mech, state, laws=laws)
        assert found == pytest.approx(want, abs=1e-12 * np.abs(want).max())


def test_open_loops_change_accelerations_by_as_much():
    mech = sp.load("four_bar")
    state = moving(mech)
    v = state.v.copy()
    v[1] += 1e-6
    other = sp.State(mech, state.q, v, closure_error=1e-6)
    assert sp.forward_dynamics(mech, other).a == pytest.approx(by_null_space(mech, state), rel=1e-4)


# ---------------------------------------------------------------- where it loses digits


@pytest.mark.parametrize(("near", "taken"), [(0.1, True), (1e-2, True), (1e-4, None),
                                             (1e-7, False), (1e-9, False)])
@pytest.mark.parametrize("n", [1, 3])
def test_near_the_flat_configuration(n, near, taken, tmp_path):
    """Against the one rod that the ladder falls as; round-off grows as the rank is lost."""
    mech = ladder(tmp_path, n)
    sp.forward_dynamics(mech, leaning(mech, 0.7, 1.3)[0])
    state, sense = leaning(mech, np.pi / 2 - near, 1.3)
    want = sense * ((n + 1) / 2 + n) * G / ((n + 1) / 3 + n) * np.cos(near)
    error = 1e-12 if near > 1e-3 else 3e-14 / near
    assert sp.forward_dynamics(mech, state).a == pytest.approx(want, abs=error)
    assert taken is None or (error_of_kkt(mech, state) < DOUBTFUL) == taken


def test_a_singular_configuration_after_a_regular_one_is_refused(tmp_path):
    mech = ladder(tmp_path, 2)
    for _ in range(2):
        sp.forward_dynamics(mech, leaning(mech, 0.7, 1.3)[0])
        with pytest.raises(sp.SingularError, match="lose 2 independent"):
            sp.forward_dynamics(mech, leaning(mech, np.pi / 2, 1.3)[0])


def test_a_crank_without_inertia_in_a_loop(tmp_path):
    """The tree's mass matrix is singular, the mechanism is not."""
    mech = known.bare_four_bar(tmp_path, 0.3, 0.1, 0.35, 0.25)
    mech = with_masses(mech, tmp_path, rocker=(1.0, (0.1, 0, 0), (1e-2,) * 3))
    state = nearby(mech, np.random.default_rng(2))
    driver = next(iter(mech.drivers), None) or mech.coordinates[0]
    found = sp.forward_dynamics(mech, state, {driver: 0.3})
    assert found.a == pytest.approx(by_null_space(mech, state, {driver: 0.3}), rel=1e-13)
    assert energy_rate(found.state) == pytest.approx(0.3 * state.coordinate(driver).rate, abs=1e-12)


def test_very_light_and_very_heavy_links(tmp_path):
    """Masses from a microgram to a tonne in one loop."""
    links = {"crank": (1e-9, (0.05, 0, 0), (1e-13,) * 3), "coupler": (1e3, (0.1, 0, 0), (9.0,) * 3),
             "rocker": (1e-3, (0.1, 0, 0), (1e-6,) * 3)}
    mech = with_masses(known.bare_four_bar(tmp_path, 0.3, 0.1, 0.35, 0.25), tmp_path, **links)
    state = nearby(mech, np.random.default_rng(2))
    answer = sp.forward_dynamics(mech, state)
    size = np.abs(answer.a).max()
    assert answer.a == pytest.approx(by_null_space(mech, state), abs=1e-9 * size)
    assert energy_rate(answer.state) == pytest.approx(0.0, abs=1e-9 * size)


def test_rows_too_many_and_a_resolved_spin(tmp_path):
    """Both together: the ball joint has a point on a line besides."""
    mech = sp.load("rssr")
    toml = mech.path.read_text(encoding="utf-8")
    assert "[passive" in toml
    for file in (mech.tree, mech.tree.parent / "parts.xacro"):
        (tmp_path / file.name).write_text(file.read_text(encoding="utf-8"), encoding="utf-8")
    closures = toml.index("[[closures]]")
    again = '[[closures]]\nname = "again"\ntype = "point_on_line"\n' + next(
        line for line in toml[closures:].splitlines() if line.startswith("frames")) + "\n"
    path = tmp_path / "rssr.toml"
    path.write_text(toml[:closures] + again + toml[closures:], encoding="utf-8")
    doubled = sp.load(path)
    for _ in range(2):
        assert sp.forward_dynamics(doubled, moving(doubled)).a == pytest.approx(
            sp.forward_dynamics(mech, moving(mech)).a, rel=1e-9)


@pytest.mark.parametrize("kind", ["spherical", "revolute", "weld"])
@pytest.mark.parametrize("joint", JOINTS)
def test_every_joint_of_the_tree(joint, kind, tmp_path):
    """A tree of one kind of joints, closed where it happens to be, moving as it then may."""
    mech, rng = tree_with(tmp_path, joint, ("leaf", "right"), kind, 3)
    q = pin.integrate(mech.model, mech.neutral, rng.uniform(-0.7, 0.7, mech.model.nv))
    at = sp.State(mech, q, closure_error=1.0)
    place = at.placement("right").actInv(at.placement("at_leaf"))  # where the closure is closed
    path = tmp_path / f"{mech.name}.urdf"
    head, mount, rest = path.read_text(encoding="utf-8").partition('name="at_right_mount"')
    old = rest[rest.index("<origin"):rest.index("/>", rest.index("<origin")) + 2]
    new = (f'<origin xyz="{known.words(place.translation)}" '
           f'rpy="{known.words(pin.rpy.matrixToRpy(place.rotation))}"/>')
    path.write_text(head + mount + rest.replace(old, new, 1), encoding="utf-8")
    links = dict.fromkeys(("trunk", "left", "leaf", "right"),
                          (1.0, (0.01, 0.02, 0.03), (0.02, 0.03, 0.04)))
    mech = with_masses(sp.load(tmp_path / f"{mech.name}.toml"), tmp_path, **links)
    freedoms = null_space(sp.closure_jacobian(mech, q) * mech.velocity_scale)
    v = mech.velocity_scale * (rng.uniform(-2, 2, len(freedoms)) @ freedoms)
    state = sp.State(mech, q, v, closure_error=0.0)
    want = by_null_space(mech, state)
    error = 1e-11 * max(np.abs(want).max(), G)  # some of these are structures, which rest
    assert sp.forward_dynamics(mech, state).a == pytest.approx(want, abs=error)


def test_what_round_off_leaves_of_an_equation_that_vanishes_holds_nothing(tmp_path):
    """A crank at the top of its circle, its tip on a plane it touches there; a second one hangs.

    The equation's derivative is cos(pi/2) = 6e-17: scaled up to one it would stop the crank.
    """
    tree = heavy(known.turning("a", "ground", "crank") + known.point("tip", "crank", (1, 0, 0))
                 + known.point("top", "ground", (0, 1, 0), (-np.pi / 2, 0, 0))
                 + known.turning("b", "ground", "other", (3, 0, 0)),
                 crank=uniform(1.0, 1.0), other=uniform(1.0, 1.0))
    mech = known.load(tmp_path, "touching", tree,
                      known.closure("plane", "point_on_plane", "top", "tip"))
    state = sp.State(mech, np.array([np.pi / 2, 0.3]), np.array([1.0, 0.0]), closure_error=0.0)
    with pytest.raises(sp.SingularError, match="lose 1 independent equation"):
        sp.forward_dynamics(mech, state)
