"""Verbs of a State over a whole Motion: each row is the State's answer."""

from __future__ import annotations

import numpy as np
import published_models as models
import pytest
from loaded_library import library
from variety import each

import spatial_pin as sp

SAME = 1e-12  # of the size


def swept(mechanism: sp.Mechanism, n: int = 9) -> sp.Motion:
    """Return a sweep of the first driver near the guess, with speed."""
    driver = next(iter(mechanism.drivers))
    span = 0.1 if mechanism.coordinate(driver).unit == "rad" else 0.005
    first = sp.assemble(mechanism).coordinate(driver).value
    return sp.sweep(mechanism, driver, first + np.linspace(0.01, 1.0, n) * span, speed=2.0)


def assert_same(found: np.ndarray, expected: np.ndarray) -> None:
    assert found.shape == expected.shape
    assert np.abs(found - expected).max(initial=0.0) <= SAME * max(
        1e-3, np.abs(expected).max(initial=0.0))


@pytest.mark.parametrize("name", each(sp.list_mechanisms()))
def test_jacobians_of_a_motion_are_those_of_its_states(name):
    mechanism = library(name)
    motion, link = swept(mechanism), mechanism.links[-1]
    for verb in (sp.jacobian, sp.jacobian_rate):
        assert_same(verb(mechanism, motion, link),
                    np.array([verb(mechanism, state, link) for state in motion]))
    rows = sp.closure_jacobian(mechanism, motion)
    assert_same(rows, np.array([sp.closure_jacobian(mechanism, state) for state in motion]))


@pytest.mark.parametrize("name", each(sp.list_mechanisms()))
def test_influence_of_a_motion_is_that_of_its_states(name):
    mechanism = library(name)
    motion = swept(mechanism)
    found, one = sp.influence(mechanism, motion), [sp.influence(mechanism, s) for s in motion]
    assert_same(found.first, np.array([x.first for x in one]))
    assert_same(found.second, np.array([x.second for x in one]))


@pytest.mark.parametrize("name", each(sp.list_mechanisms()))
def test_rates_of_a_motion_are_those_of_its_states(name):
    mechanism = library(name)
    motion, rng = swept(mechanism), np.random.default_rng(1)
    speeds, accelerations = ({d: rng.uniform(-1.0, 1.0, len(motion)) for d in mechanism.drivers}
                             for _ in range(2))
    moving = sp.solve_rates(mechanism, motion, speeds, accelerations)
    states = [sp.solve_rates(mechanism, state, {d: x[k] for d, x in speeds.items()},
                             {d: x[k] for d, x in accelerations.items()})
              for k, state in enumerate(motion)]
    assert_same(moving.v, np.array([s.v for s in states]))
    assert_same(moving.a, np.array([s.a for s in states]))
    assert moving[3].rate_error == pytest.approx(states[3].rate_error, rel=1e-6)
    assert moving.per == "s"
    assert np.array_equal(moving.q, motion.q)


@pytest.mark.parametrize("name", each(sp.list_mechanisms()))
def test_transmission_along_a_motion_is_that_of_its_states(name):
    mechanism = library(name)
    motion, driver = swept(mechanism), next(iter(mechanism.drivers))
    for output in mechanism.coordinates:
        try:
            one = [sp.transmission(mechanism, state, output, driver) for state in motion]
        except sp.SpatialPinError as error:
            with pytest.raises(type(error)):
                sp.transmission(mechanism, motion, output, driver)
            continue
        found = sp.transmission(mechanism, motion, output, driver)
        assert_same(found.ratio, np.array([x.ratio for x in one]))
        assert np.abs(found.angle - [x.angle for x in one]).max() <= SAME
        assert found.at == one[0].at


def test_rates_of_a_coordinate_that_is_no_driver():
    mechanism = library("rssr")
    motion = swept(mechanism)
    moving = sp.solve_rates(mechanism, motion, {"rocker_pin": 2.0})
    one = sp.solve_rates(mechanism, motion[4], {"rocker_pin": 2.0})
    assert_same(moving.v[4], one.v)
    assert moving.coordinate("rocker_pin").rate == pytest.approx(2.0, rel=1e-13)


def test_time_is_that_of_a_steady_driver_and_of_no_other():
    mechanism = library("four_bar")
    motion = sp.sweep(mechanism, "crank", np.linspace(1.0, 2.0, 11))
    steady = sp.solve_rates(mechanism, motion, {"crank": 2.0})
    assert steady.time == pytest.approx(np.linspace(0.0, 0.5, 11))
    assert steady.driver_speed == pytest.approx(2.0)
    assert_same(steady.v, sp.sweep(mechanism, "crank", motion.driver, speed=2.0).v)
    assert sp.solve_rates(mechanism, motion, {"crank": np.linspace(1.0, 2.0, 11)}).time is None
    assert sp.solve_rates(mechanism, motion, {"crank": 0.0}).time is None


@pytest.mark.parametrize(("speeds", "words"), [
    ({"crank": np.ones(4)}, "speed of 'crank' has shape"),
    ({"crank": [np.nan] * 11}, "NaN or infinite"),
    ({"crank": "fast"}, "speed of 'crank'"),
    ({"crank": 1e200}, "sample 0"),
])
def test_bad_rates_of_a_motion_are_refused(speeds, words):
    mechanism = library("four_bar")
    motion = sp.sweep(mechanism, "crank", np.linspace(1.0, 2.0, 11))
    with pytest.raises(ValueError, match=words):
        sp.solve_rates(mechanism, motion, speeds)


@pytest.mark.delicate
def test_a_sample_at_which_nothing_is_determined_is_named():
    """A flat parallelogram can fold either way: where it does, the crank determines no rates."""
    mechanism = models.ladder(1)
    flat = sp.State(mechanism, sp.assemble(mechanism, {"pin_0": np.pi / 2}).q)
    motion = sp.sweep(mechanism, "pin_0", np.linspace(1.3, 1.5, 3), guess={"pin_0": 1.3})
    parts = {f: np.vstack([getattr(motion, f), getattr(flat, f)[None]]) for f in ("q", "v", "a")}
    whole = sp.Motion(mechanism, None, "", None, **parts, closure_error=np.zeros(4),
                      driver_speed=np.ones(4))
    for verb in (lambda x: sp.jacobian(mechanism, x, mechanism.links[-1], ["pin_0"]),
                 lambda x: sp.influence(mechanism, x, ["pin_0"]),
                 lambda x: sp.solve_rates(mechanism, x, {"pin_0": 1.0})):
        with pytest.raises(sp.SingularError) as one:
            verb(flat)
        with pytest.raises(sp.SingularError, match=r"\(sample 3\)") as all_of:
            verb(whole)
        assert str(all_of.value).startswith(str(one.value)[:60])


def test_a_motion_of_another_load_of_the_mechanism_is_one_of_it_too():
    mechanism = library("rssr")
    other = swept(library("rssr"))
    found = sp.jacobian(mechanism, other, "rocker_b")
    assert_same(found, sp.jacobian(other.mechanism, other, "rocker_b"))
    with pytest.raises(sp.SpatialPinError, match="other dimensions"):
        sp.jacobian(library("rssr", d=0.33), other, "rocker_b")
    with pytest.raises(sp.SpatialPinError, match="other coordinates"):
        sp.jacobian(library("four_bar"), other, "rocker_b")


def test_other_verbs_say_which_take_a_motion():
    mechanism = library("rssr")
    with pytest.raises(TypeError, match=r"motion\[k\] is that of sample k\. jacobian, "):
        sp.solve_jerks(mechanism, swept(mechanism))


def test_an_empty_motion_has_empty_answers():
    mechanism = library("rssr")
    none = swept(mechanism)[:0]
    assert sp.jacobian(mechanism, none, "rocker_b").shape == (0, 6, 1)
    assert sp.influence(mechanism, none).second.shape == (0, 5, 1, 1)
    assert sp.closure_jacobian(mechanism, none).shape[0] == 0
    assert len(sp.solve_rates(mechanism, none, {"crank": 1.0})) == 0
    assert sp.transmission(mechanism, none, "rocker_pin").angle.shape == (0,)
