"""The solvers of the equations of motion: KKT and least constraint, dense and sparse, in parts."""

from __future__ import annotations

import derivative_cases
import mechanisms as known
import numpy as np
import pinocchio as pin
import pytest
from closure_trees import JOINTS, tree_with
from ladders import G, heavy_four_bar, ladder, leaning, moving
from loaded_library import library
from masses import energy_rate, two_rods, with_masses
from resisting import CASES, hard
from variety import each, few, first

import spatial_pin as sp
from spatial_pin.constraints import kernel_tree
from spatial_pin.constraints.kernel_tree import KernelTree
from spatial_pin.dynamics.bushings import angle_over_sine
from spatial_pin.dynamics.derivatives.spring_derivatives import slope
from spatial_pin.dynamics.forces import joint_efforts
from spatial_pin.dynamics.inverse import Actuation, balance, internal_efforts
from spatial_pin.dynamics.solvers.equations_of_motion import DOUBTFUL, Equations
from spatial_pin.dynamics.solvers.least_constraint import Bounded, LeastConstraint
from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.numerics.linalg import SparseSpaces, decompose, null_space

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
    return a + np.linalg.solve(free @ mass_matrix(model, state.q) @ free.T, load) @ free


def mass_matrix(model, q):
    """The mass matrix by Pinocchio's inverse dynamics, column by column, without gravity."""
    still = model.copy()
    still.gravity = pin.Motion.Zero()
    data, none = still.createData(), np.zeros(model.nv)
    return np.array([pin.rnea(still, data, q, none, e).copy() for e in np.eye(model.nv)]).T


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


@pytest.mark.parametrize("name", each(sp.list_mechanisms()))
def test_the_kkt_system_is_taken_and_is_right(name):
    mech, rng = library(name), np.random.default_rng(8)
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


@pytest.mark.parametrize("name", few(OVERCONSTRAINED, "bennett", "four_bar", "hooke_joint"))
def test_no_regularisation_is_seen(name):
    """Every closure equation holds, and the power balances, to far below 1e-9."""
    mech, rng = library(name), np.random.default_rng(5)
    state = nearby(mech, rng)
    efforts = {d: 1.5 for d in mech.drivers}
    answer = sp.forward_dynamics(mech, state, efforts)
    evaluation = LoopEquations(mech)
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
    mech = library("four_bar")
    state = moving(mech)
    v = state.v.copy()
    v[1] += 1e-6
    other = sp.State(mech, state.q, v, closure_error=1e-6)
    assert sp.forward_dynamics(mech, other).a == pytest.approx(by_null_space(mech, state), rel=1e-4)


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


LIBRARY = sp.list_mechanisms()


def both(mech, state, efforts):
    """Accelerations, multipliers and reactions, dense and sparse."""
    for large in (False, True):
        equations = Equations(mech, large)
        equations.update(state)
        effort = joint_efforts(mech, efforts)
        a, closures, *_ = equations.solve(effort + equations.given)
        multipliers = equations.multipliers(closures)
        unique = {name: each.tolist() for name, each in equations.unique().items()}
        yield a, multipliers, *equations.reactions(a, multipliers, effort), unique


@pytest.mark.parametrize("name", [*each(LIBRARY), "ladder", "press", "rack"])
def test_sparse_equations_are_the_dense_ones(name, tmp_path):
    weight = (1.0, (0.01, 0.02, 0.03), (1e-2,) * 3)
    if name == "ladder":
        mech = ladder(tmp_path, 20)
        state = leaning(mech, 0.7, 1.3)[0]
    else:
        mech = {
            "press": lambda: with_masses(known.press_closure(tmp_path), tmp_path, wheel=weight,
                                         ram=weight),
            "rack": lambda: with_masses(known.rack_and_gears(tmp_path), tmp_path, g1=weight,
                                        g2=weight, r=weight),
        }.get(name, lambda: library(name))()
        state = moving(mech)
    dense, sparse = both(mech, state, dict.fromkeys(mech.drivers, 0.8))
    for x, y in zip(dense[:2], sparse[:2], strict=True):
        assert y == pytest.approx(x, abs=1e-10 * np.abs(x).max(initial=1e-3), rel=1e-10)
    size = max(np.abs(force).max() for force in dense[2].values())
    for pair, force in dense[2].items():
        assert sparse[2][pair] == pytest.approx(force, abs=1e-9 * size), pair
    assert sparse[3] == pytest.approx(dense[3], abs=1e-9 * size)
    assert sparse[4] == dense[4]


def statics(large, mech, state, actuated):
    """Efforts, multipliers and uniqueness of inverse dynamics, dense or sparse."""
    equations, actuation = Equations(mech, large), Actuation(mech, actuated)
    equations.update(state)
    efforts, _, closures, _ = balance(equations, actuation)
    spare = internal_efforts(equations, actuation)
    unique = equations.unique(actuation.all_generalised(spare, len(state.v)))
    return efforts, equations.multipliers(closures), len(spare), {
        name: each.tolist() for name, each in unique.items()}


@pytest.mark.parametrize("actuated", [["p0"], ["p3"], ["p0", "p2", "k3"]])
@pytest.mark.parametrize("n", few([20, 70], 20))
def test_sparse_inverse_dynamics_are_the_dense_ones(n, actuated, tmp_path):
    mech = ladder(tmp_path, n)
    state, sense = leaning(mech, 0.7, 1.3)
    state = sp.State(mech, state.q, state.v, 2.0 * sense, closure_error=0.0)
    dense, sparse = (statics(large, mech, state, actuated) for large in (False, True))
    for x, y in zip(dense[:2], sparse[:2], strict=True):
        assert y == pytest.approx(x, abs=1e-10 * np.abs(x).max(), rel=1e-10)
    assert sparse[2:] == dense[2:]


@pytest.mark.parametrize("name", [*each(LIBRARY), "ladder"])
def test_sparse_spaces_are_the_dense_ones(name, tmp_path):
    mech = ladder(tmp_path, 20) if name == "ladder" else library(name)
    state = leaning(mech, 0.7, 1.3)[0] if name == "ladder" else moving(mech)
    equations, dense = Equations(mech, True), Equations(mech, False)
    for either in (equations, dense):
        either.update(state)
    sparse, svd = equations.spaces, dense.spaces
    assert isinstance(sparse, SparseSpaces)
    assert sparse.rank == svd.rank
    freedoms = sparse.null_space
    assert freedoms @ freedoms.T == pytest.approx(np.eye(len(freedoms)), abs=1e-12)
    assert svd.null_space.T @ svd.null_space == pytest.approx(freedoms.T @ freedoms, abs=1e-10)
    stresses = equations.spaces.left_null_space
    assert len(stresses) == min(len(svd.left_null_space), 3)
    inside = stresses @ svd.left_null_space.T @ svd.left_null_space
    assert stresses == pytest.approx(inside, abs=1e-10)
    force = np.random.default_rng(1).standard_normal(equations.n_closure) @ dense.scaled
    assert sparse.minimum_norm_transposed(force) == pytest.approx(
        svd.minimum_norm_transposed(force), abs=1e-9)


@pytest.mark.parametrize(("f", "x", "want"), [
    (np.exp, 0.3, np.exp(0.3)), (lambda x: max(0.0, x - 1.0), 1.01, 1.0), (np.cbrt, 8.0, 1 / 12),
    (lambda x: 3.0, 1.0, 0.0)])
def test_extrapolated_differences(f, x, want):
    assert slope(f, x, 0.1) == pytest.approx(want, abs=1e-11)


@pytest.mark.parametrize("name", few(
    ["stewart", "delta", "rssr", "rod", "watt_six_bar", "excavator"], "delta", "rssr", "rod"))
def test_trees_in_the_kernel_have_the_same_derivatives(name, tmp_path, monkeypatch):
    def found():
        mech = derivative_cases.rod(tmp_path) if name == "rod" else sp.load(name)
        body = mech.model.names[-1]
        answer = sp.dynamics_derivatives(
            mech, derivative_cases.moving(mech), dict.fromkeys(mech.drivers, 0.3),
            external={body: pin.Force(np.array([1.0, 2.0, -3.0]), np.array([0.3, 0.1, 0.2]))})
        borne = [part for each in answer.reactions.values() for part in each]
        return [answer.a_by_q, answer.a_by_v, answer.a_by_effort, answer.multipliers_by_q, *borne,
                *answer.on_ground]

    whole = found()
    for constant in ("WHOLE", "BRANCHES"):
        monkeypatch.setattr(kernel_tree, constant, 1)
    size = max(np.nanmax(np.abs(x), initial=0.0) for x in whole)
    for one, other in zip(whole, found(), strict=True):
        assert other == pytest.approx(one, abs=1e-12 * size, nan_ok=True)


@pytest.mark.parametrize("name", ["delta", "rssr", "bricard", "watt_six_bar"])
def test_least_constraint_gives_the_accelerations_of_the_mass_matrix(name):
    """Moving bodies of any inertia, with efforts."""
    mech = library(name)
    rng = np.random.default_rng(3)
    q = pin.integrate(mech.model, sp.assemble(mech).q, rng.uniform(-0.3, 0.3, mech.model.nv))
    v, a, given = rng.normal(size=(3, mech.model.nv))
    columns = rng.normal(size=(mech.model.nv, 3))
    mass = mass_matrix(mech.model, q)
    missing = given - pin.rnea(mech.model, mech.model.createData(), q, v, a)
    want = np.linalg.solve(columns.T @ mass @ columns, columns.T @ missing)
    found = LeastConstraint(mech).solve(
        q, v, Bounded(a, 0.0 * a), Bounded(columns, 0.0 * columns), given)
    assert not len(found.still) and not found.pulled and found.error < 1e-9
    np.testing.assert_allclose(found.z, want, rtol=1e-8, atol=1e-9 * np.abs(want).max())


@pytest.mark.parametrize(("name", "joints"), first(3, CASES))
def test_dense_and_sparse_equations_say_the_same(name, joints):
    mech = hard(name, joints)
    state = moving(mech)
    answer = sp.forward_dynamics(mech, state)
    with np.errstate(all="raise"):
        equations = Equations(mech, large=True)
        equations.update(state)
        a = equations.solve(equations.given)[0]
    assert a == pytest.approx(answer.a, rel=1e-8, abs=1e-8 * np.abs(answer.a).max())
    mass = pin.crba(mech.model, mech.model.createData(), state.q)
    bare = pin.crba(library(name).model, mech.model.createData(), state.q)
    assert mass - bare == pytest.approx(np.diag(mech.model.armature), abs=1e-12)


@pytest.mark.parametrize("mass", [1e-200, 1e-24, 1e-16, 1e-3, 1e30, 1e150])
def test_the_mass_matrix_scales_with_the_mass(mass):
    """Pinocchio's `crba` is wrong below 2.2e-16 kg and above 1e154 kg."""
    light, usual, q = two_rods(mass), two_rods(1.0), np.array([0.3, 0.7])
    exact = pin.crba(usual.model, usual.model.createData(), q)
    np.testing.assert_allclose(KernelTree(light.model).mass_matrix(q) / mass, exact, rtol=1e-13)


def test_the_mass_matrix_of_any_tree_is_that_of_its_inverse_dynamics():
    """Pinocchio's `crba` is wrong where joints are not in the order of their branches."""
    for name in LIBRARY:
        mech = library(name)
        q = pin.integrate(mech.model, mech.neutral, np.linspace(-0.4, 0.5, mech.model.nv))
        want = mass_matrix(mech.model, q)
        found = KernelTree(mech.model).mass_matrix(q)
        assert found == pytest.approx(want, abs=1e-13 * np.abs(want).max(initial=0.0)), name


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 0.3, 0.45, 0.46, 1.0, 3.0])
def test_the_angle_over_its_sine_has_all_its_digits(angle):
    mpmath = pytest.importorskip("mpmath")
    with mpmath.workdps(50):
        cosine = mpmath.mpf(float(np.cos(angle)))
        if cosine == 1:
            wanted = [1.0, -1.0 / 3.0, 4.0 / 15.0]
        else:
            def g(c):
                return mpmath.acos(c) / mpmath.sqrt(1 - c * c)
            wanted = [float(mpmath.diff(g, cosine, n)) for n in range(3)]
    assert angle_over_sine(float(np.cos(angle))) == pytest.approx(wanted, rel=1e-10)
