"""Machines in site coordinates are solved as at the origin, to the digits that these have."""

import numpy as np
import pinocchio as pin
import pytest
from far_sites import DIRECTION, on_site, sprung
from loaded_library import library
from variety import each, paired

import spatial_pin as sp

EPS = np.finfo(float).eps
NAMES = ("excavator", "four_bar", "rssr", "delta")
FAR = (1e2, 1e4, 1e5, 5e6, 1e7)  # m
CASES = [pytest.param(case.values, marks=case.marks) for case in paired(NAMES, FAR)]
FARTHEST = [(name, 5e6) for name in NAMES]
MADE = {}


@pytest.fixture
def pair(request, tmp_path):
    """A machine at the origin, the same on its site, and where that is."""
    name, away = request.param
    if request.param not in MADE:
        MADE[request.param] = on_site(tmp_path, name, away)
    return library(name), MADE[request.param], away * DIRECTION


def moving(mech):
    return sp.solve_rates(mech, sp.assemble(mech), dict.fromkeys(mech.drivers, 0.7))


def resolved(mech, at):
    """What coordinates of that size resolve of the machine."""
    return EPS * np.abs(at).max() / mech.characteristic_length


def close(found, wanted, part):
    np.testing.assert_allclose(found, wanted, rtol=0.0, atol=part * (np.abs(wanted).max() or 1.0))


@pytest.mark.parametrize("pair", CASES, indirect=True, ids=str)
def test_a_machine_is_as_large_and_as_free_as_at_the_origin(pair):
    near, mech, at = pair
    own, other = sp.mobility(mech), sp.mobility(near)
    assert abs(mech.characteristic_length / near.characteristic_length - 1.0) < 4 * resolved(
        near, at)
    assert (own.dof, own.rank, own.instantaneous) == (other.dof, other.rank, other.instantaneous)
    for one, two in zip(own.passive, other.passive, strict=True):
        across = np.eye(3) - np.outer(two.axis, two.axis)
        np.testing.assert_allclose(across @ (one.point - at - two.point), 0.0,
                                   atol=100 * EPS * np.abs(at).max())


@pytest.mark.parametrize("pair", CASES, indirect=True, ids=str)
def test_the_closure_error_bounds_how_far_loops_are_open_in_the_world(pair):
    near, mech, at = pair
    state, size = sp.assemble(mech), mech.characteristic_length
    open_by = [np.abs(np.subtract(*(state.placement(f).translation for f in closure.frames))).max()
               for closure in mech.closures if closure.type in ("revolute", "spherical")]
    assert max(open_by) / size <= state.closure_error <= 1e-15 + 1.1 * resolved(near, at)
    motion = sp.sweep(mech, *swept(near))
    assert motion.closure_error.min() >= 0.9 * resolved(near, at)


def swept(near):
    driver = next(iter(near.drivers))
    start = sp.assemble(near).coordinate(driver).value
    return driver, start + np.linspace(0.0, 0.3, 11)


@pytest.mark.parametrize("pair", CASES, indirect=True, ids=str)
def test_rates_are_those_at_the_origin_but_for_the_error_that_is_reported(pair):
    near, mech, at = pair
    one, two = moving(mech), moving(near)
    scale = mech.velocity_scale
    off = np.abs((one.v - two.v) / scale).max() / np.abs(two.v / scale).max()
    assert off <= one.rate_error <= two.rate_error * (1.0 + np.abs(at).max()
                                                      / near.characteristic_length)
    motion = sp.sweep(mech, *swept(near), speed=1.0)
    assert motion.state(5).rate_error < 1e-5


@pytest.mark.parametrize("pair", CASES, indirect=True, ids=str)
def test_a_simulation_takes_as_many_steps_and_its_drift_is_that_of_its_energy(pair):
    near, mech, at = pair
    one, two = (sp.simulate(m, sp.assemble(m), 0.3) for m in (mech, near))
    assert one.evaluations <= 1.2 * two.evaluations and one.energy_drift < 1e-9
    close(one.q, two.q, 100 * resolved(near, at) + 1e-9)
    data = near.model.createData()  # at the origin no digit is lost
    energies = [pin.computeKineticEnergy(near.model, data, q, v)
                + pin.computePotentialEnergy(near.model, data, q)
                for q, v in zip(one.q, one.v, strict=True)]
    told = one.energy - one.energy[0]
    exchanged = np.ptp(one.energy) + max(np.ptp(told), near_exchange(near))
    np.testing.assert_allclose(told, np.subtract(energies, energies[0]),
                               atol=(1e-11 + 10 * resolved(near, at)) * exchanged)


def near_exchange(near):
    return 9.81 * near.characteristic_length * sum(x.mass for x in near.model.inertias)


@pytest.mark.parametrize("pair", FARTHEST, indirect=True, ids=str)
def test_places_along_a_sweep_are_those_at_the_origin_moved(pair):
    near, mech, at = pair
    one, two = (sp.sweep(m, *swept(near), speed=1.0) for m in (mech, near))
    for name in (near.links[-1], near.links[1]):
        np.testing.assert_allclose(one.frame(name).position - at, two.frame(name).position,
                                   atol=20 * EPS * np.abs(at).max())
        close(one.frame(name).acceleration, two.frame(name).acceleration,
              1000 * resolved(near, at))
    jerks = [x.output(f"{near.links[-1]}.jerk").values for x in (one, two)]
    close(*jerks, 1e4 * resolved(near, at))


@pytest.mark.parametrize("pair", FARTHEST, indirect=True, ids=str)
def test_forces_are_those_at_the_origin(pair):
    near, mech, at = pair
    part = 100 * resolved(near, at)
    push = {near.links[-1]: pin.Force(np.array([3.0, -1.0, 2.0, 0.1, 0.2, 0.3]))}
    one, two = (sp.forward_dynamics(m, moving(m), external=push) for m in (mech, near))
    close(one.a, two.a, part)
    close(*(np.array([x.reactions[name].vector for name in two.reactions]) for x in (one, two)),
          part)
    ground, other = one.on_ground, two.on_ground
    close(ground.linear, other.linear, part)
    # about the world's origin, which is far away
    close(ground.angular - np.cross(at, ground.linear), other.angular,
          part * max(1.0, np.abs(at).max() * 1e-6))
    one, two = (sp.inverse_dynamics(m, moving(m)) for m in (mech, near))
    for name, effort in two.efforts.items():
        close(one.efforts[name], effort, part)


@pytest.mark.parametrize("pair", FARTHEST, indirect=True, ids=str)
def test_derivatives_of_dynamics_are_those_at_the_origin(pair):
    near, mech, at = pair
    one, two = (sp.dynamics_derivatives(m, moving(m)) for m in (mech, near))
    close(one.a_by_q, two.a_by_q, 1000 * resolved(near, at))
    changes, others = (np.array([x.reactions[name].by_q for name in two.reactions])
                       for x in (one, two))
    assert np.array_equal(np.isnan(changes), np.isnan(others))
    close(np.nan_to_num(changes), np.nan_to_num(others), 1000 * resolved(near, at))
    moment = one.on_ground.by_q - two.on_ground.by_q
    moment[3:] -= np.cross(at, one.on_ground.by_q[:3], axisb=0, axisc=0)
    scale = np.abs(one.on_ground.by_q).max()
    np.testing.assert_allclose(moment[3:], 0.0, atol=1e-9 * scale)


@pytest.mark.parametrize("pair", [("four_bar", 1e7), ("delta", 5e6)], indirect=True, ids=str)
def test_points_of_the_world_are_reached(pair):
    near, mech, at = pair
    tip, (driver, values) = near.links[-1], swept(near)
    path = sp.sweep(near, driver, values).frame(tip).position
    state = sp.reach(mech, {tip: path[7] + at})
    np.testing.assert_allclose(state.placement(tip).translation, path[7] + at, rtol=4 * EPS)
    along = ({tip: path + at} if len(near.drivers) == 3 else
             {f"{tip}.position.x": path[:, 0] + at[0]})
    motion = sp.reach_path(mech, along)
    np.testing.assert_allclose(motion.frame(tip).position[:, 0], path[:, 0] + at[0],
                               rtol=20 * EPS)


@pytest.mark.parametrize("pair", [("rssr", 5e6), ("delta", 5e6)], indirect=True, ids=str)
def test_a_reduced_machine_stays_where_it_is(pair):
    near, mech, at = pair
    tip = near.links[-1]
    one = sp.sweep(sp.reduce(mech, tip), *swept(near)).frame(tip).position
    two = sp.sweep(near, *swept(near)).frame(tip).position
    np.testing.assert_allclose(one - at, two, atol=100 * EPS * np.abs(at).max())


def test_sensitivities_and_tolerances_are_those_at_the_origin(tmp_path):
    near, mech = library("rssr"), on_site(tmp_path, "rssr", 5e6)
    at, names = 5e6 * DIRECTION, ["a", "b", "d"]
    for output in ("rocker_pin", "rocker_b.position"):
        one, two = (sp.sensitivity(m, sp.assemble(m, {"crank": 1.0}), output, names)
                    for m in (mech, near))
        for name in names:
            off = np.abs(np.subtract(one.derivatives[name], two.derivatives[name])).max()
            size = 1.0 + np.abs(two.derivatives[name]).max()
            assert off <= np.max(one.errors[name]) + 100 * resolved(near, at) * size
    output = "rocker_b.position.y"
    one, two = (sp.tolerance(m, output, {"a": 1e-3, "b": 1e-3}, state={"crank": 1.0}, samples=20)
                for m in (mech, near))
    assert abs(one.nominal[output] - at[1] - two.nominal[output]) < 4 * EPS * at[1]
    close(one.linear[output], two.linear[output], 1e-5)
    close(one.samples[output] - at[1], two.samples[output], 1e-5)


def test_a_spring_to_the_ground_pulls_as_at_the_origin():
    ends = []
    for away in (0.0, 5e6):
        mech = sprung(away)
        motion = sp.simulate(mech, sp.assemble(mech, {"pin": 0.3}), 1.0)
        assert motion.energy_drift < 1e-9
        ends.append([motion.q[-1, 0], sp.forward_dynamics(mech, motion.state(-1)).a[0]])
    np.testing.assert_allclose(*ends, rtol=1e-7)


@pytest.mark.parametrize("name", each(sp.list_mechanisms()))
def test_near_the_origin_nothing_is_moved(name):
    mech = library(name)
    assert not mech.centre.any() and mech.centred_model is mech.model
    assert mech.extent.frames.all() and mech.extent.resolution == 0.0
