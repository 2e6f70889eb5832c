"""No answer depends on what was asked before, of the same load of a mechanism.

Every verb is asked at two configurations, of different branches where there are some, in both
orders; what it answers is to the last bit what a fresh load answers that was asked nothing else.
"""

from __future__ import annotations

import pickle

import mechanisms as known
import numpy as np
import pinocchio as pin
import pytest
from far_sites import on_site
from ladders import ladder, leaning
from machines import three_rods, translation
from variety import each, few

import spatial_pin as sp


def isolated(mechanism: sp.Mechanism) -> sp.State:
    """A mode in which the plate is turned: nothing moves there."""
    for a, b, c in np.random.default_rng(1).uniform(-3, 3, (60, 3)):
        try:
            state = sp.assemble(mechanism, guess={"a": a, "b": b, "c": c, "top": 2.0})
        except sp.AssemblyError:
            continue
        turned = state.placement("plate").rotation[0, 0]
        if turned < 0.99 and sp.mobility(mechanism, state).rank == 4:
            return state
    raise AssertionError("no isolated mode found")


def said(question) -> object:
    """The answer, or the error in its place."""
    try:
        return question()
    except sp.SpatialPinError as error:
        return type(error).__name__, str(error)


def numbers(dynamics) -> list:
    return [dynamics.a, dynamics.multipliers, dynamics.determined, dynamics.error,
            {name: force.vector for name, force in dynamics.reactions.items()}]


def inverse(mechanism, state):
    answer = sp.inverse_dynamics(mechanism, state)
    return answer.efforts, numbers(answer)


def derivatives(mechanism, state):
    found = sp.dynamics_derivatives(mechanism, state)
    return [value for name, value in sorted(vars(found).items())
            if isinstance(value, np.ndarray)]


def swept(mechanism, state):
    driver = next(iter(mechanism.drivers))
    start = state.coordinate(driver).value
    motion = sp.sweep(mechanism, driver, start + np.linspace(0, 0.02, 5), guess=state)
    loads = sp.kinetostatics(mechanism, motion)
    return motion.q, motion.v, motion.a, loads.efforts, loads.reactions, loads.determined


def simulated(mechanism, state):
    motion = sp.simulate(mechanism, state, 0.02, times=[0.0, 0.01, 0.02])
    return motion.q, motion.v


def moving(mechanism, state):
    return sp.solve_rates(mechanism, state, dict.fromkeys(mechanism.drivers, 0.3),
                          dict.fromkeys(mechanism.drivers, -0.2))


def last_link(mechanism):
    return list(mechanism.inertias)[-1] if mechanism.inertias else mechanism.links[-1]


QUESTIONS = {
    "rates": lambda m, s: [moving(m, s).v, moving(m, s).a, moving(m, s).rate_error],
    "jerks": lambda m, s: sp.solve_jerks(m, moving(m, s)).j,
    "jacobian": lambda m, s: sp.jacobian(m, s, last_link(m)),
    "rate of the jacobian": lambda m, s: sp.jacobian_rate(m, moving(m, s), last_link(m)),
    "closure jacobian": lambda m, s: sp.closure_jacobian(m, s),
    "influence": lambda m, s: sp.influence(m, s),
    "mobility": lambda m, s: str(sp.mobility(m, s)),
    "forward": lambda m, s: numbers(sp.forward_dynamics(m, s)),
    "forward in motion": lambda m, s: numbers(sp.forward_dynamics(m, moving(m, s))),
    "inverse": lambda m, s: inverse(m, moving(m, s)),
    "derivatives": derivatives,
    "sweep": swept,
    "simulation": simulated,
    "assembly": lambda m, s: sp.assemble(m, {}, guess=s).q,
}


def same(one, other) -> bool:
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[k], other[k]) for k in one)
    if isinstance(one, list | tuple):
        return (type(one) is type(other) and len(one) == len(other)
                and all(map(same, one, other)))
    return np.array_equal(one, other, equal_nan=np.asarray(one).dtype.kind == "f")


def carried(mechanism, q, angles):
    """The state of q on this load."""
    error = sp.assemble(mechanism, {}, guess=q).closure_error
    return sp.State(mechanism, q, closure_error=error, angles=angles)


def fresh(mechanism):
    """A copy that knows nothing of what was asked."""
    return pickle.loads(pickle.dumps(mechanism))


def in_both_orders(make, find) -> None:
    """Ask all at both states of a fresh load each, and of one load in both orders."""
    loaded = make()
    places = [(s.q, s.angles) for s in find(loaded)]
    want = []
    for place in places:
        want.append({name: said(lambda q=question, m=mechanism, p=place: q(m, carried(m, *p)))
                     for name, question in QUESTIONS.items() for mechanism in [fresh(loaded)]})
    for order in ((0, 1, 0), (1, 0)):
        mechanism = fresh(loaded)
        for k in order:
            for name, question in QUESTIONS.items():
                got = said(lambda q=question, k=k, m=mechanism: q(m, carried(m, *places[k])))
                assert same(got, want[k][name]), (name, order, k, got, want[k][name])


def two_states(mechanism) -> list[sp.State]:
    """Of two branches if there are some, at different values of the drivers."""
    first = sp.assemble(mechanism)
    at = {d: first.coordinate(d).value - 0.02 for d in mechanism.drivers}
    rng = np.random.default_rng(5)
    for _ in range(6):
        guess = {c.name: rng.uniform(-2, 2) for c in mechanism.coordinate_table.values()
                 if c.q >= 0 and c.unit == "rad" and c.name not in at}
        try:
            other = sp.assemble(mechanism, at, guess=guess)
        except sp.AssemblyError:
            continue
        if np.abs(other.q - first.q).max() > 0.5:
            return [first, other]
    return [first, sp.assemble(mechanism, at)]


@pytest.mark.filterwarnings("ignore::spatial_pin.SpatialPinWarning")
@pytest.mark.parametrize("name", each(sp.list_mechanisms()))
def test_a_mechanism_of_the_library(name):
    in_both_orders(lambda: sp.load(name), two_states)


@pytest.mark.filterwarnings("ignore::spatial_pin.SpatialPinWarning")
@pytest.mark.parametrize("make", [
    known.press_closure,
    *(pytest.param(make, marks=pytest.mark.slow) for make in (
        known.rack_and_gears, known.rscr, known.leaning_pointer, known.swash_plate,
        known.arm_on_a_ram))])
def test_other_pairs(make, tmp_path):
    """Screws and couplings among them, which count turns."""
    in_both_orders(lambda: make(tmp_path), two_states)


@pytest.mark.parametrize("n", [45, pytest.param(80, marks=pytest.mark.slow)])
def test_many_loops(n, tmp_path):
    """To round-off, for the choice of rows stays as it was; what is refused is the same."""
    mechanism = ladder(tmp_path, n)
    states = [leaning(mechanism, angle, 1.3)[0] for angle in (0.7, 0.2, np.pi / 2)]

    def asked(load, k):
        state = carried(load, states[k].q, states[k].angles)
        return said(lambda: sp.forward_dynamics(load, state).a)

    want = [asked(fresh(mechanism), k) for k in range(3)]
    assert want[2][0] == "SingularError"
    for order in ((0, 1, 2, 0), (2, 1, 0, 2)):
        used = fresh(mechanism)
        for k in order:
            got = asked(used, k)
            if k == 2:
                assert got == want[k]
            else:
                assert got == pytest.approx(want[k], abs=1e-13 * np.abs(want[k]).max())


@pytest.mark.delicate
@pytest.mark.parametrize("wrap", few([str, known.tilted], known.tilted), ids=["level", "tilted"])
def test_modes_of_different_rank(wrap, tmp_path):
    """The rank of the loops belongs to the branch, not to the mechanism."""
    in_both_orders(lambda: three_rods(tmp_path, wrap),
                   lambda m: [translation(m, 0.5), isolated(m)])
    mechanism = three_rods(tmp_path, wrap)
    sp.forward_dynamics(mechanism, isolated(mechanism))
    answer = sp.forward_dynamics(mechanism, translation(mechanism, 0.5))
    assert answer.a[0] == pytest.approx(-answer.a[1]) == pytest.approx(answer.a[2])


def test_masses_that_have_been_changed():
    """What a simulation keeps of a mechanism is that of its masses and its gravity."""
    def swung(mechanism):
        return sp.simulate(mechanism, sp.assemble(mechanism), 0.4, times=[0.4]).q

    used, other = sp.load("four_bar"), sp.load("four_bar")
    first = swung(used)
    for mechanism in (used, other):
        mechanism.model.inertias[2] = pin.Inertia.FromSphere(3.0, 0.2)
    heavier = swung(used)
    assert np.array_equal(heavier, swung(other)) and not np.allclose(heavier, first)
    for mechanism in (used, other):
        mechanism.model.gravity.linear = np.array([0.0, 0.0, -1.6])
    assert np.array_equal(swung(used), swung(other)) and not np.allclose(swung(used), heavier)


@pytest.mark.parametrize(("name", "away"), [("four_bar", 1e3), ("delta", 0.0)])
def test_reactions_are_of_the_masses_and_the_gravity_that_there_are_now(tmp_path, name, away):
    """Also where the solvers' tree is a copy: far from the origin, and of split joints."""
    mechanism = on_site(tmp_path, name, away)
    driver = next(iter(mechanism.drivers))
    motion = sp.sweep(mechanism, driver, [0.1, 0.3], speed=2.0)
    state = motion.state(1)
    sp.kinetostatics(mechanism, motion)
    assert sp.dynamics_derivatives(mechanism, state).on_ground is not None
    mechanism.model.gravity.linear = np.array([0.3, 0.0, -1.6])
    mechanism.model.inertias[2] = pin.Inertia.FromSphere(3.0, 0.2)
    loads = sp.kinetostatics(mechanism, motion)
    alone = sp.inverse_dynamics(mechanism, state)
    size = max(np.abs(force.vector).max() for force in alone.reactions.values())
    for pair, force in alone.reactions.items():
        assert loads.reactions[pair][1] == pytest.approx(force.vector, abs=1e-9 * size), pair
    free = sp.forward_dynamics(mechanism, state)
    ground = sp.dynamics_derivatives(mechanism, state).on_ground.value
    assert ground == pytest.approx(free.on_ground.vector, rel=1e-9, abs=1e-9 * max(size, away))
