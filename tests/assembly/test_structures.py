"""Mechanisms that cannot move, or have nothing to move: right answers or one clear error."""

from __future__ import annotations

import mechanisms as known
import numpy as np
import odd_mechanisms as odd
import pytest
from masses import heavy
from variety import few, paired

import spatial_pin as sp

pytestmark = pytest.mark.delicate


def output(mechanism: sp.Mechanism) -> str:
    return mechanism.links[-1]


def some_driver(mechanism: sp.Mechanism) -> str:
    return next(iter(mechanism.drivers))


RATES = {
    "solve_rates": lambda m, s: sp.solve_rates(m, s, {some_driver(m): 1.0}),
    "solve_rates at rest": lambda m, s: sp.solve_rates(m, s),
    "solve_jerks": lambda m, s: sp.solve_jerks(m, s, {some_driver(m): 1.0}),
    "jacobian": lambda m, s: sp.jacobian(m, s, output(m)),
    "jacobian_rate": lambda m, s: sp.jacobian_rate(m, s, output(m)),
    "influence": lambda m, s: sp.influence(m, s),
    "sweep": lambda m, s: sp.sweep(m, some_driver(m), s.coordinate(some_driver(m)).value
                                   + np.linspace(0.0, 0.1, 5)),
    "sweep of many": lambda m, s: sp.sweep(m, some_driver(m), s.coordinate(some_driver(m)).value
                                           + np.linspace(0.0, 0.1, 400)),
    "sweep of one": lambda m, s: sp.sweep(m, some_driver(m), [s.coordinate(some_driver(m)).value]),
    "limits": lambda m, s: sp.limits(m, some_driver(m)),
    "trace": lambda m, s: sp.trace(m, some_driver(m)),
    "forward_dynamics": lambda m, s: sp.forward_dynamics(m, s),
    "inverse_dynamics": lambda m, s: sp.inverse_dynamics(m, s),
    "dynamics_derivatives": lambda m, s: sp.dynamics_derivatives(m, s),
    "simulate": lambda m, s: sp.simulate(m, s, 0.01, times=[0.0, 0.01]),
    "simulate projected": lambda m, s: sp.simulate(
        m, s, 0.01, times=[0.0, 0.01], accuracy=sp.Accuracy(formulation="projected")),
}


@pytest.mark.filterwarnings("ignore::spatial_pin.SpatialPinWarning")
@pytest.mark.parametrize("name", odd.STRUCTURES)
def test_what_can_only_be_shaken_has_no_rates(name, tmp_path):
    """The driver's freedom is instantaneous only: no speed of it is one of a motion."""
    mechanism = odd.STRUCTURES[name](tmp_path)
    state = sp.assemble(mechanism)
    mobility = sp.mobility(mechanism, state)
    assert mobility.instantaneous > mobility.dof
    for verb, ask in RATES.items():
        with pytest.raises(sp.SpatialPinError) as caught:
            ask(mechanism, state)
        assert isinstance(caught.value, sp.SingularError | sp.LimitError), verb


@pytest.mark.parametrize("size", [1e-4, 1.0, 1e4])
def test_it_is_stated_that_nothing_can_move(size, tmp_path):
    mechanism = odd.flat_truss(tmp_path, size=size)
    with pytest.raises(sp.SingularError, match="nothing can move: 1 freedom is instantaneous only"):
        sp.solve_rates(mechanism, sp.assemble(mechanism), {"a": 1.0})


def test_other_mistakes_are_reported_as_well(tmp_path):
    """A part that is shaky wherever it is carried; and branches that cross."""
    carried = odd.carried_truss(tmp_path)
    with pytest.raises(sp.SingularError, match="there, and 1 freedom is instantaneous only"):
        sp.solve_rates(carried, sp.assemble(carried), {"crank": 1.0})
    flat = known.bare_four_bar(tmp_path, 1.0, 0.3, 1.0, 0.3)
    with pytest.raises(sp.SingularError, match="branches cross"):
        sp.solve_rates(flat, sp.assemble(flat, {"crank": 0.0}, guess={"rocker_pin": 0.0}),
                       {"crank": 1.0})


@pytest.mark.parametrize("size", few([1e-6, 1.0, 1e5], 1.0))
def test_a_plate_on_equal_legs_cannot_move(size, tmp_path):
    """Its loops open by the fourth power of the way, and stay closed to round-off at first."""
    mechanism = odd.plate_on_legs(tmp_path, size=size)
    mobility = sp.mobility(mechanism)
    assert (mobility.instantaneous, mobility.dof) == (1, 0)
    modes = sp.assembly_modes(mechanism, free=["leg"], most_starts=2000)
    heights = sorted(round(x.coordinate("pose.z").value / size, 6) for x in modes)
    assert heights == [-1.0, 1.0]
    assert {x.branch for x in modes} == {"singular 1", "singular 2"} and not modes.continua


@pytest.mark.parametrize(("number", "size"), paired(
    [(count, times) for count in (1, 2, 3) for times in (1, 2)], [1e-6, 1.0, 1e5]))
def test_dead_centres_in_a_row_cannot_move(number, size, tmp_path):
    """The loops open by the second, fourth, eighth power of the way."""
    count, times = number
    mechanism = odd.dead_centres(tmp_path, count, size, times)
    mobility = sp.mobility(mechanism)
    assert (mobility.instantaneous, mobility.dof) == (1, 0)
    carried = sp.mobility(odd.dead_centres(tmp_path, count, size, times, carried=True))
    assert (carried.instantaneous, carried.dof) == (2, 1)


@pytest.mark.parametrize(("count", "size"), paired([2, 3, 4], [1e-6, 1.0, 1e5]))
def test_dead_centres_without_the_last_bar_move(count, size, tmp_path):
    for carried in (False, True):
        mechanism = odd.dead_centres(tmp_path, count, size, 2, carried, is_locked=False)
        mobility = sp.mobility(mechanism)
        assert mobility.dof == mobility.instantaneous == 1 + carried
        with pytest.raises(sp.ContinuumError, match=f"{1 + carried} freedom"):
            sp.assembly_modes(mechanism)


def test_dead_centres_in_a_row_are_one_mode(tmp_path):
    """Round-off lets them stand anywhere within 0.1 about it."""
    for count in (2, 3):
        (mode,) = sp.assembly_modes(odd.dead_centres(tmp_path, count), most_starts=2000)
        assert mode.branch == "singular"


PAIRS_THAT_MOVE = {  # two curves of the guided points touch, or one turns back at a cusp
    "tacnode": ((1, 0.5, 0.3, 1 / 3), (1, 1, 0.3, 0.5)),
    "tacnode of unequal arms": ((1, 0.5, 0.4, 1 / 3), (0.5, 1, 0.3, 2 / 3)),
    "cusp": ((1, 1, 0.3, 0.5), (1, 1, 0.6, 0.5)),
}
# With the first arm held 0.1 rad away the least residual is 1.2e-5, 1.9e-6 and 9.8e-4: the fourth
# power twice, the square.
PAIRS_THAT_DO_NOT = {
    "fourth power": ((1, 1, 0.3, 0.5), (1, 0.5, 0.3, 1 / 3)),
    "a small fourth power": ((0.5, 1, 0.3, 2 / 3), (1, 0.5, 0.4, 1 / 3)),
    "square": ((1, 1, 0.3, 0.5), (1, 0.5, 0.3, 2 / 3)),
}


@pytest.mark.parametrize("name", PAIRS_THAT_MOVE)
def test_two_watt_linkages_move_where_their_curves_touch(name, tmp_path):
    mechanism = odd.watt_pair(tmp_path, *PAIRS_THAT_MOVE[name])
    mobility = sp.mobility(mechanism, mechanism.neutral)
    assert (mobility.instantaneous, mobility.dof) == (2, 1)
    with pytest.raises(sp.ContinuumError, match="1 freedom"):
        sp.assembly_modes(mechanism)


@pytest.mark.parametrize("name", PAIRS_THAT_DO_NOT)
def test_two_watt_linkages_stand_where_their_curves_only_seem_to_touch(name, tmp_path):
    mechanism = odd.watt_pair(tmp_path, *PAIRS_THAT_DO_NOT[name])
    mobility = sp.mobility(mechanism, mechanism.neutral)
    assert (mobility.instantaneous, mobility.dof) == (2, 0)
    modes = sp.assembly_modes(mechanism, most_starts=2000)
    assert [x.branch for x in modes] == ["singular"]
    assert np.abs(modes[0].q).max() < 0.05
    assert len(modes.continua) == 1  # elsewhere they move


@pytest.mark.parametrize("height", [0.05, 1e-2])
def test_a_shallow_truss_is_rigid_and_a_bent_four_bar_moves(height, tmp_path):
    """Near structures that can be shaken there are those that cannot, and true mechanisms."""
    mechanism = odd.flat_truss(tmp_path)
    text = (tmp_path / "flat_truss.urdf").read_text(encoding="utf-8")
    (tmp_path / "flat_truss.urdf").write_text(
        text.replace("2.5 0.0 0.0", f"2.5 {height} 0.0"), encoding="utf-8")
    shallow = sp.load(tmp_path / "flat_truss.toml")
    assert mechanism.coordinates == shallow.coordinates
    with pytest.raises(sp.AssemblyError):
        sp.assemble(shallow, {"a": 0.0})
    four_bar = odd.stretched_four_bar(tmp_path)
    text = (tmp_path / "stretched_four_bar.urdf").read_text(encoding="utf-8")
    (tmp_path / "stretched_four_bar.urdf").write_text(
        text.replace("1.2 0.0 0.0", f"{1.2 - height} 0.0 0.0"), encoding="utf-8")
    bent = sp.load(tmp_path / "stretched_four_bar.toml")
    state = sp.assemble(bent, {"crank": 0.5 * height}, guess={"b": -0.1, "c": 0.1})
    assert four_bar.coordinates == bent.coordinates
    v = sp.solve_rates(bent, state, {"crank": 1.0}).v
    step = 1e-6
    there = sp.assemble(bent, {"crank": 0.5 * height + step}, guess=state)
    assert v == pytest.approx((there.q - state.q) / step, rel=1e-3, abs=1e-3)


def test_a_regular_overconstrained_mechanism_keeps_its_rates(tmp_path):
    """Rows that depend on others everywhere are no loss."""
    for make in (known.bennett, known.bricard, known.sarrus):
        mechanism = make(tmp_path)
        state = sp.assemble(mechanism)
        driver = some_driver(mechanism)
        v = sp.solve_rates(mechanism, state, {driver: 1.0}).v
        assert np.abs(sp.closure_jacobian(mechanism, state) @ v).max() < 1e-12


NOTHING = {
    "solve_rates": lambda m, s: sp.solve_rates(m, s).v,
    "solve_jerks": lambda m, s: sp.solve_jerks(m, s).j,
    "forward_dynamics": lambda m, s: sp.forward_dynamics(m, s).a,
    "multipliers": lambda m, s: sp.forward_dynamics(m, s).multipliers,
    "inverse_dynamics": lambda m, s: sp.inverse_dynamics(m, s).a,
    "closure_jacobian": lambda m, s: sp.closure_jacobian(m, s),
    "simulate": lambda m, s: sp.simulate(m, s, 0.01, times=[0.0, 0.01]).q,
    "simulate projected": lambda m, s: sp.simulate(
        m, s, 0.01, times=[0.0, 0.01], accuracy=sp.Accuracy(formulation="projected")).q,
    "influence": lambda m, s: sp.influence(m, s).first,
    "dynamics_derivatives": lambda m, s: sp.dynamics_derivatives(m, s).a_by_q,
}


@pytest.mark.parametrize("name", odd.EMPTY)
def test_without_joints_answers_are_empty(name, tmp_path):
    mechanism = odd.EMPTY[name](tmp_path)
    state = sp.assemble(mechanism)
    assert sp.mobility(mechanism, state).dof == 0
    for verb, ask in NOTHING.items():
        assert np.size(ask(mechanism, state)) == 0, verb
    for found in (sp.jacobian, sp.jacobian_rate):
        assert found(mechanism, state, output(mechanism)).shape == (6, 0)
    assert len(sp.assembly_modes(mechanism, {})) == 1
    with pytest.raises(sp.UnknownNameError):
        sp.sweep(mechanism, "crank", [0.0, 1.0])


@pytest.mark.parametrize("wrap", [str, known.tilted], ids=["level", "tilted"])
@pytest.mark.parametrize("name", ["turning", "sliding"])
def test_one_joint_is_a_mechanism(name, wrap, tmp_path):
    """Pinocchio gives matrices of one column as vectors."""
    kind = {"turning": known.turning, "sliding": known.sliding}[name]
    tree = odd.heavy(kind("one", "ground", "arm", (0.1, 0.2, 0.3), (0.0, 0.6, 0.8)), arm=odd.BAR)
    tree += known.point("tip", "arm", (0.4, -0.1, 0.2))
    mechanism = known.load(tmp_path, "one", wrap(tree), odd.DOWN + known.driver("one", "one"))
    state = sp.solve_rates(mechanism, sp.assemble(mechanism, {"one": 0.4}), {"one": 1.3},
                           {"one": -0.7})
    twist = sp.jacobian(mechanism, state, "tip")[:, 0]
    assert state.velocity("tip").vector == pytest.approx(1.3 * twist, abs=1e-14)
    rate = sp.jacobian_rate(mechanism, state, "tip")[:, 0]
    assert state.acceleration("tip").vector == pytest.approx(-0.7 * twist + 1.3 * rate, abs=1e-13)
    step = 1e-4
    moved = [sp.solve_rates(
        mechanism, sp.assemble(mechanism, {"one": 0.4 + 1.3 * t - 0.35 * t * t}),
        {"one": 1.3 - 0.7 * t}, {"one": -0.7}).acceleration("tip").vector for t in (-step, step)]
    jerk = sp.solve_jerks(mechanism, state).frame("tip").vector
    assert jerk == pytest.approx((moved[1] - moved[0]) / (2 * step), abs=1e-6)
    found = sp.dynamics_derivatives(
        mechanism, sp.assemble(mechanism, {"one": 0.4})).a_by_q
    a = [sp.forward_dynamics(mechanism, sp.assemble(mechanism, {"one": 0.4 + x})).a[0]
         for x in (-step, step)]
    assert found[0, 0] == pytest.approx((a[1] - a[0]) / (2 * step), abs=1e-5)


@pytest.mark.parametrize("mass", [0.0, 1.0, 1e13])
def test_a_triangle_of_any_masses_stands_still(mass, tmp_path):
    """No freedom is left, whichever way the accelerations are looked for."""
    tree = known.turning("left", "ground", "first", axis=(0, 1, 0))
    tree += known.turning("right", "ground", "second", (1, 0, 0), axis=(0, 1, 0))
    tree += known.point("first_end", "first", (0.4, 0, 0.7))
    tree += known.point("second_end", "second", (-0.6, 0, 0.7))
    tree = heavy(tree, first=(1.0, (0.2, 0, 0.3), (0.1, 0.2, 0.1)),
                 second=(mass, (-0.1, 0, 0.2), (mass, mass, mass)))
    mechanism = known.load(tmp_path, "triangle", tree,
                           known.closure("ridge", "spherical", "first_end", "second_end"))
    found = sp.forward_dynamics(mechanism, sp.assemble(mechanism))
    np.testing.assert_allclose(found.a, 0.0, rtol=0.0, atol=1e-12)
