"""`sp.design` as it is asked: what is refused, the same answer anywhere, what is kept."""

from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context

import numpy as np
import pinocchio as pin
import pytest
from crank_rockers import BOUNDS, FUNCTION, PHI, PSI, assert_same

import spatial_pin as sp

goals = sp.goals


@pytest.fixture(scope="module")
def four_bar():
    return sp.load("four_bar")


@pytest.fixture(scope="module")
def alone(four_bar):
    return sp.design(four_bar, FUNCTION, BOUNDS, starts=3)


def exactly(shift=0.0):
    return goals.function("rocker_pin", PSI + shift, {"crank": PHI}, weight=None)


# ---------------------------------------------------------------- what is refused


class Idle:
    """An executor that is given nothing to do."""

    def submit(self, *_):
        raise AssertionError("work began")


@pytest.mark.parametrize(("goal", "bounds", "options", "error", "says"), [
    (goals.path("tipp", [[0, 0, 1]]), BOUNDS, {}, sp.UnknownNameError, "frame or joint 'tipp'"),
    (goals.poses("tipp", [pin.SE3.Identity()]), BOUNDS, {}, sp.UnknownNameError, "'tipp'"),
    (goals.function("rocker", PSI, {"crank": PHI}), BOUNDS, {}, sp.UnknownNameError,
     "did you mean 'rocker_pin'"),
    (goals.function("rocker_pin", PSI, {"cranc": PHI}), BOUNDS, {}, sp.UnknownNameError,
     "did you mean 'crank'"),
    (goals.function("crank", PSI, {"crank": PHI}), BOUNDS, {}, ValueError, "is its own driver"),
    (goals.function("crank_pin", PSI, {"crank": PHI}), BOUNDS, {}, ValueError,
     "is its own driver"),
    (FUNCTION, {"r9": (0.1, 0.2)}, {}, sp.UnknownNameError, "no dimension 'r9'; there are: r1"),
    (FUNCTION, {"r2": (0.6, 0.05)}, {}, ValueError, "bounds of 'r2' are 0.6 to 0.05: the first"),
    (FUNCTION, {"r2": (0.6, 0.6)}, {}, ValueError, "the first must be the smaller one"),
    (FUNCTION, {"r2": 0.6}, {}, ValueError, "bounds of 'r2' are (least, most), not 0.6"),
    (FUNCTION, {"r2": (np.inf, None)}, {}, ValueError, "a bound of 'r2' has a value that is NaN"),
    (FUNCTION, {"r2": (None,)}, {}, ValueError, "bounds of 'r2' are (least, most), not (None,)"),
    (FUNCTION, {"r2": (0.1, np.nan)}, {}, ValueError, "a bound of 'r2' has a value that is NaN"),
    (FUNCTION, {}, {}, ValueError, "nothing may change"),
    (FUNCTION, ["r2", "r2"], {}, ValueError, "dimensions names one twice"),
    ([], BOUNDS, {}, ValueError, "goals is empty"),
    ("path", BOUNDS, {}, TypeError, "goals are of sp.goals"),
    (None, BOUNDS, {}, TypeError, "goals are of sp.goals"),
    ([exactly(), exactly(0.1)], BOUNDS, {}, ValueError, "goals contradict: function of rocker_pin"),
    (goals.path("coupler_b", [[0, 0, 1], [0, 0, 2]], {"crank": [1.0, 1.0]}, weight=None), BOUNDS,
     {}, ValueError, "sample 0, and path of coupler_b, sample 1, have the same drivers"),
    (goals.path("coupler_b", [[0.3, 0, 0.1], [0.3, 2e-9, 0.2]], weight=None), BOUNDS, {},
     ValueError, "'coupler_b' stays in a plane, and sample 1 is 2e-09 m off it"),
    ([goals.swing("rocker_pin", 1.0), goals.swing("rocker_pin", 1.2, "crank_pin")], BOUNDS, {},
     ValueError, "goals contradict: swing of rocker_pin is to be 1 and 1.2"),
    (goals.transmission("rocker_pin", 0.5, pair="pin"), BOUNDS, {}, sp.UnknownNameError,
     "no pair of the output's link 'pin'"),
    (goals.transmission("crank_pin", 0.5), BOUNDS, {}, sp.SpatialPinError, "is a driver itself"),
    (goals.clearance(0.1, [("crank_pin", "rocker")]), BOUNDS, {}, sp.UnknownNameError,
     "no link 'crank_pin'"),
    (goals.clearance(0.1, [("rocker", "rocker_b")]), BOUNDS, {}, sp.SpatialPinError,
     "has no <collision> and no <visual>"),
    (FUNCTION, BOUNDS, {"starts": 0}, ValueError, "starts is 0"),
    (FUNCTION, BOUNDS, {"starts": 1.5}, ValueError, "starts must be a whole number"),
    (FUNCTION, BOUNDS, {"seed": -1}, ValueError, "seed is -1"),
    (FUNCTION, BOUNDS, {"most": 0}, ValueError, "most is 0"),
    (FUNCTION, BOUNDS, {"method": "swarm"}, ValueError, "it is one of multistart, evolution"),
    (FUNCTION, BOUNDS, {"executor": 3}, TypeError, "an executor of concurrent.futures"),
    (FUNCTION, BOUNDS, {"guess": {"rockr": 1.0}}, sp.UnknownNameError, "'rockr'"),
    (FUNCTION, BOUNDS, {"resume": "no_such_folder/f"}, OSError, "there is no folder"),
])
def test_what_cannot_be_is_refused_before_the_work(
    four_bar, goal, bounds, options, error, says
):
    with pytest.raises(error) as told:
        sp.design(four_bar, goal, bounds, **{"executor": Idle(), **options})
    assert says in str(told.value)


@pytest.mark.slow
def test_a_start_at_which_loops_just_close_ends_in_words_not_in_an_error(four_bar):
    """A dimension at its bound, where the loop closes: beside it, it is open."""
    points = [[0.2, 0.0, 0.0], [0.22, 0.0, 0.01]]
    bounds = {"r2": (0.05, 0.2), "r3": (0.2, 0.6)}
    found = sp.design(four_bar, goals.path("coupler", points), bounds, starts=6)
    assert len(found) and found[0].error < 0.2


@pytest.mark.parametrize(("make", "says"), [
    (lambda: goals.path("tip", []), "points has shape"),
    (lambda: goals.path("tip", [[0.0, np.nan, 1.0]]), "NaN"),
    (lambda: goals.path("tip", [[0.0, 0.0, 0.0, 1.0]]), "points has shape (1, 4)"),
    (lambda: goals.path("tip", [[0, 0, 1]], {"crank": [1, 2]}), "drivers: values of 'crank' has"),
    (lambda: goals.path("tip", [[0, 0, 1]], weight=0.0), "weight is 0; it is larger than 0, or"),
    (lambda: goals.path("tip", [[0, 0, 1]], weight=np.inf), "weight has a value that is NaN"),
    (lambda: goals.path("tip", [[0, 0, 1]], weight="hard"), "weight must be a number or None"),
    (lambda: goals.poses("tip", []), "there are no placements"),
    (lambda: goals.poses("tip", [np.zeros((4, 4))]), "placement 0 has no rotation"),
    (lambda: goals.poses("tip", [np.eye(3)]), "placement 0 has shape (3, 3)"),
    (lambda: goals.function("out", [1.0], {}), "drivers names no driver"),
    (lambda: goals.function("out", 1.0, {"crank": 1.0}), "values of 'out' are a list of numbers"),
    (lambda: goals.dead_centres("out", None), "values of the driver are needed"),
    (lambda: goals.clearance(0.1, ["ab"]), "the names of two links, not 'ab'"),
    (lambda: goals.clearance(0.1, [("a", "b", "c")]), "the names of two links, not ('a', 'b', 'c"),
    (lambda: goals.clearance(0.1, []), "pairs is empty"),
])
def test_goals_that_are_none_are_refused_when_they_are_made(make, says):
    with pytest.raises(ValueError) as told:
        make()
    assert says in str(told.value)


# ---------------------------------------------------------------- bounds


@pytest.mark.slow
@pytest.mark.parametrize("bounds", [(0.02, None), (None, 0.5), (0.02, np.inf), None])
@pytest.mark.parametrize("method", ["multistart", "evolution"])
def test_a_dimension_may_have_one_bound_or_none(four_bar, alone, bounds, method):
    found = sp.design(four_bar, FUNCTION, {**BOUNDS, "r4": bounds}, starts=2, method=method)
    assert found[0].dimensions["r4"] == pytest.approx(alone[0].dimensions["r4"], rel=1e-8)
    low, high = found[0].bounds["r4"]
    assert (low, high) == (0.02 if bounds and bounds[0] else -np.inf,
                           0.5 if bounds and bounds[1] == 0.5 else np.inf)


def test_a_single_point_is_a_path_of_one():
    assert goals.path("tip", [0.0, 0.0, 1.0]).points.shape == (1, 3)
    assert goals.path("tip", [0.1, 0.2]).points.tolist() == [[0.1, 0.2, 0.0]]


def test_a_mechanism_without_a_file_has_no_dimensions_to_change():
    robot = sp.Mechanism.from_model(pin.buildSampleModelManipulator())
    with pytest.raises(sp.SpatialPinError, match="has no file to change dimensions in"):
        sp.design(robot, goals.path("universe", [[0, 0, 1]]), ["a"])


def test_a_mechanism_that_does_not_close_is_refused():
    with pytest.raises(sp.AssemblyError):
        sp.design(sp.load("four_bar", r2=2.0), FUNCTION, BOUNDS)


# ---------------------------------------------------------------- the same answer anywhere


class AtOnce:
    """An executor that works where it stands."""

    def submit(self, work, *arguments):
        done = Future()
        done.set_result(work(*arguments))
        return done


@pytest.mark.parametrize("make", [
    pytest.param(AtOnce, marks=pytest.mark.slow), lambda: ProcessPoolExecutor(2),
    pytest.param(lambda: ThreadPoolExecutor(3), marks=pytest.mark.slow),
    pytest.param(lambda: ProcessPoolExecutor(2, mp_context=get_context("spawn")),
                 marks=pytest.mark.slow)],
    ids=["own", "processes", "threads", "spawned"])
def test_the_answer_is_the_same_wherever_it_is_worked_out(four_bar, alone, make):
    executor = make()
    try:
        found = sp.design(four_bar, FUNCTION, BOUNDS, starts=3, executor=executor)
    finally:
        getattr(executor, "shutdown", lambda: None)()
    assert_same(alone, found)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["multistart", "evolution"])
def test_a_dask_cluster_finds_the_same(four_bar, method):
    distributed = pytest.importorskip("distributed")
    options = {"starts": 2, "method": method}
    with (distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=False,
                                   dashboard_address=None) as cluster,
          distributed.Client(cluster) as client):
        found = [sp.design(four_bar, FUNCTION, BOUNDS, executor=executor, **options)
                 for executor in (client.get_executor(), client)]
    alone = sp.design(four_bar, FUNCTION, BOUNDS, **options)
    for same in found:
        assert_same(alone, same)


def test_an_executor_stays_open(four_bar):
    with ThreadPoolExecutor(1) as executor:
        sp.design(four_bar, FUNCTION, BOUNDS, starts=1, executor=executor)
        assert executor.submit(int).result() == 0


def test_a_design_that_was_computed_before_is_the_same(four_bar, alone):
    sp.design(four_bar, goals.path("coupler_b", [[0.1, 0.0, 0.3]]), {"r2": (0.05, 0.2)}, starts=1)
    assert_same(alone, sp.design(four_bar, FUNCTION, BOUNDS, starts=3))


@pytest.mark.slow
def test_what_was_kept_of_another_search_is_refused(four_bar, tmp_path):
    kept = tmp_path / "kept"
    sp.design(four_bar, FUNCTION, BOUNDS, starts=1, resume=kept)
    for bounds, options in (({**BOUNDS, "r2": (0.1, 0.6)}, {}), (BOUNDS, {"seed": 1})):
        with pytest.raises(sp.SpatialPinError, match="a search with another mechanism, other"):
            sp.design(four_bar, FUNCTION, bounds, starts=1, resume=kept, **options)
    kept.write_text("no search")
    with pytest.raises(sp.SpatialPinError, match="not a search for dimensions"):
        sp.design(four_bar, FUNCTION, BOUNDS, starts=1, resume=kept)


@pytest.mark.slow
def test_more_starts_find_at_least_as_much(four_bar, alone):
    more = sp.design(four_bar, FUNCTION, BOUNDS, starts=4)
    assert more[0].error <= alone[0].error + 1e-12 and len(more) >= len(alone)
    assert len(sp.design(four_bar, FUNCTION, BOUNDS, starts=2, most=1)) == 1


@pytest.mark.slow
def test_a_design_begins_where_branches_cross(problems):
    """A folded parallelogram: the crank alone does not say which way it goes."""
    mechanism = sp.load(problems["nine"].mechanism().path, r1=2.0, r2=1.0, r3=2.0, r4=1.0)
    folded = {"crank": 0.0, "coupler_pin": 0.0, "rocker_pin": 0.0}
    found = sp.design(mechanism, sp.goals.swing("rocker_pin", 1.0),
                      {"r2": (0.3, 1.5), "r4": (0.5, 2.5)}, guess=folded, starts=1)
    assert len(found)
    own = found[0]
    state = own.motion().coordinate("rocker_pin").value
    assert np.ptp(state) == pytest.approx(1.0, abs=1e-2)  # between its samples
