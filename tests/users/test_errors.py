"""Errors keep what they speak of, also in a copy and on the way from another process."""

import copy
import multiprocessing
import pickle
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor

import numpy as np
import pytest

import spatial_pin as sp


def kinds(of: type = sp.SpatialPinError) -> Iterator[type[sp.SpatialPinError]]:
    yield of
    for kind in of.__subclasses__():
        yield from kinds(kind)


def raised(call: Callable[[], object]) -> sp.SpatialPinError:
    with pytest.raises(sp.SpatialPinError) as caught:
        call()
    return caught.value


def too_far() -> object:
    """Sweep a crank-rocker's rocker past its dead centre."""
    mechanism = sp.load("rssr")
    return sp.sweep(mechanism, "rocker_pin", np.linspace(1.3, 3.0, 40))


def out_of_reach() -> object:
    return sp.assemble(sp.load("rssr"), {"rocker_pin": 3.0})


def misspelt() -> object:
    return sp.load("rssr").coordinate("crnak")


def at_a_dead_centre() -> object:
    """Ask for rates where the driver cannot move."""
    mechanism = sp.load("slider_crank")
    state = sp.assemble(mechanism, {"crank": 0.0})
    return sp.solve_rates(mechanism, state, {"slide": 1.0})


def fields(error: sp.SpatialPinError) -> dict[str, object]:
    return {name: type(x) if isinstance(x, sp.State | sp.Motion) else x
            for name, x in vars(error).items()}


WAYS = {"pickle": lambda x: pickle.loads(pickle.dumps(x)), "copy": copy.copy,
        "deepcopy": copy.deepcopy}


@pytest.mark.alike
@pytest.mark.parametrize("way", WAYS.values(), ids=WAYS)
@pytest.mark.parametrize(("kind", "call"), [
    (sp.LimitError, too_far), (sp.AssemblyError, out_of_reach), (sp.UnknownNameError, misspelt),
    (sp.SingularError, at_a_dead_centre)])
def test_an_error_is_the_same_elsewhere(kind, call, way):
    error = raised(call)
    assert type(error) is kind
    again = way(error)
    assert type(again) is type(error)
    assert str(again) == str(error)
    assert fields(again) == fields(error)


def test_every_kind_of_error_survives_with_any_field():
    state = sp.assemble(sp.load("four_bar"))
    for kind in kinds():
        error = kind.__new__(kind, "a sentence")
        error.args, error.state, error.limit = ("a sentence",), state, 0.25
        again = pickle.loads(pickle.dumps(error))
        assert (type(again), str(again), again.limit) == (kind, "a sentence", 0.25)
        assert np.array_equal(again.state.q, state.q)


def test_what_an_error_holds_can_be_worked_with():
    error = raised(too_far)
    motion = pickle.loads(pickle.dumps(error)).motion
    assert np.array_equal(motion.q, error.motion.q)
    position = motion.frame("coupler").position
    assert np.array_equal(position, error.motion.frame("coupler").position)
    found = sp.solve_rates(motion.mechanism, motion.state(3), {"rocker_pin": 1.0})
    assert found.closure_error < 1e-12


@pytest.mark.parametrize("way", WAYS.values(), ids=WAYS)
def test_a_copied_state_is_as_read_only_and_as_true(way):
    motion = sp.sweep(sp.load("rssr"), "crank", np.linspace(0.0, 1.0, 5))
    for state in (motion.state(2), sp.solve_rates(motion.mechanism, motion.state(2), {"crank": 1})):
        again = way(state)
        assert again.rate_error == state.rate_error
        assert again.placement("rocker").isApprox(state.placement("rocker"))
        with pytest.raises(ValueError, match="read-only"):
            again.q[0] = 1.0


def test_a_copy_carries_nothing_that_is_worked_out_on_use():
    motion = sp.sweep(sp.load("stewart"), "leg_1", np.linspace(0.39, 0.4, 50))
    state = motion.state(0)
    sizes = len(pickle.dumps(motion)), len(pickle.dumps(state))
    motion.frame("platform")
    state.placement("platform")
    assert state.data is not None
    assert motion.mechanism.neutral is not None
    assert sizes == (len(pickle.dumps(motion)), len(pickle.dumps(state)))


def of_pool() -> object:
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply_async(too_far).get(timeout=120)


def of_executor() -> object:
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context) as executor:
        return executor.submit(too_far).result(timeout=120)


@pytest.mark.parametrize("pool", [
    of_pool, pytest.param(of_executor, marks=pytest.mark.slow)])
def test_a_pool_of_processes_hands_back_the_error_with_its_evidence(pool):
    error = raised(pool)
    assert isinstance(error, sp.LimitError)
    assert error.limit == pytest.approx(raised(too_far).limit, abs=1e-9)
    assert len(error.motion) == len(raised(too_far).motion)
