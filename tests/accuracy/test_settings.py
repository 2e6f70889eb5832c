"""Settings of accuracy: plain numbers, checked when given; nothing else is taken for one."""

import json
from dataclasses import FrozenInstanceError, asdict
from itertools import pairwise

import numpy as np
import pytest
from loaded_library import library

import spatial_pin as sp

ZERO = {"crank": 0.0}


def test_numbers_of_any_kind_become_plain_ones():
    given = sp.Accuracy(order=np.int64(2), corrections=np.float64(3.0), tolerance=np.float32(0.5),
                        time_tolerance=1, step=np.float64(0.01))
    assert given == sp.Accuracy(2, 3, 0.5, time_tolerance=1.0, step=0.01)
    assert hash(given) == hash(sp.Accuracy(2, 3, 0.5, time_tolerance=1.0, step=0.01))
    assert json.loads(json.dumps(asdict(given)))["corrections"] == 3


def test_settings_are_frozen():
    with pytest.raises(FrozenInstanceError):
        sp.Accuracy().order = 2  # type: ignore[misc]


@pytest.mark.parametrize("field", ["order", "corrections", "tolerance", "time_tolerance", "step"])
@pytest.mark.parametrize("value", ["2", True, np.nan, np.inf, -1, [1], 10**400])
def test_what_is_no_such_number_is_refused_by_name(field, value):
    with pytest.raises(ValueError, match=field):
        sp.Accuracy(**{field: value})


@pytest.mark.parametrize(("field", "value"), [
    ("order", 1.5), ("order", 4), ("order", None), ("corrections", 0.5), ("tolerance", 0.0),
    ("tolerance", None), ("step", 0.0)])
def test_numbers_out_of_range_are_refused_by_name(field, value):
    with pytest.raises(ValueError, match=field):
        sp.Accuracy(**{field: value})


@pytest.mark.parametrize("level", ["fast", None, ["draft"]])
def test_a_level_that_there_is_not_is_refused(level):
    with pytest.raises(ValueError, match=r"draft.*engineering.*reference"):
        sp.Accuracy.named(level)


@pytest.mark.parametrize("use", [
    lambda mech, x: sp.assemble(mech, ZERO, accuracy=x),
    lambda mech, x: sp.sweep(mech, "crank", [0.0, 1.0], accuracy=x),
    lambda mech, x: sp.assembly_modes(mech, ZERO, accuracy=x),
    lambda mech, x: sp.simulate(mech, sp.assemble(mech), 0.01, accuracy=x),
    lambda mech, x: sp.tradeoff(mech, settings=[x], repeats=1)])
@pytest.mark.parametrize("given", ["draft", 1e-6])
def test_a_level_is_not_taken_for_its_settings(use, given):
    with pytest.raises(TypeError, match=r"Accuracy\.named"):
        use(library("rssr"), given)


@pytest.mark.parametrize(("error", "task"), [
    (0.0, "sweep"), (-1.0, "sweep"), (np.nan, "simulate"), ("1e-6", "sweep"), (None, "sweep"),
    ([1e-6], "sweep"), (1e-6, "dance"), (1e-6, {"driver": "crank"})])
def test_an_error_or_a_task_that_is_none_is_refused(error, task):
    with pytest.raises(ValueError, match=r"error|task"):
        sp.Accuracy.for_error(error, task)


def test_for_error_takes_only_what_was_measured():
    with pytest.raises(TypeError, match="tradeoff"):
        sp.Accuracy.for_error(1e-6, measured="sweep")  # type: ignore[arg-type]


@pytest.mark.parametrize("task", ["sweep", "simulate"])
def test_a_looser_error_never_takes_a_tighter_setting(task):
    found = [sp.Accuracy.for_error(error, task) for error in (1e-7, 1e-5, 1e-3)]
    tight = [x.tolerance if task == "sweep" else x.time_tolerance for x in found]
    assert tight == sorted(tight)


def test_between_two_settings_that_were_measured_lies_one_for_each_error():
    errors = np.geomspace(3e-3, 1e-9, 30)
    steps = [sp.Accuracy.for_error(error, "simulate").time_tolerance for error in errors]
    assert all(x > y for x, y in pairwise(steps))  # none is much more exact than it is to be
    assert max(x / y for x, y in pairwise(steps)) < 10.0


def test_arguments_of_a_trade_off_are_checked():
    mech = sp.load("rssr")
    for wrong in ({"repeats": 0}, {"repeats": "x"}, {"budget": np.nan}, {"budget": "x"}):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            sp.tradeoff(mech, **wrong)
