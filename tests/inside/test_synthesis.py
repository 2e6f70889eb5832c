"""The insides of a design: slopes of goals and demands, peaks, atlases, contradictions."""

import dataclasses
from concurrent.futures import ProcessPoolExecutor
from itertools import pairwise

import numpy as np
import pytest
import synthesis_forms as forms
from crank_rockers import BOUNDS, FUNCTION, TURN, assert_same, least_transmission_of
from synthesis_forms import SYNTHESIS
from variety import few, first

import spatial_pin as sp
from spatial_pin.dimensions.bounds import bounds_of
from spatial_pin.dimensions.variants import Variants
from spatial_pin.synthesis import curve_atlas as atlas, demand, global_search as search
from spatial_pin.synthesis.curve_atlas import CurveDatabase
from spatial_pin.synthesis.demand import Candidate, smooth_peak
from spatial_pin.synthesis.design import refuse_off_plane
from spatial_pin.synthesis.design_problem import DesignProblem, ExactFit
from spatial_pin.view.scene.look import overlaid

goals = sp.goals


@pytest.mark.parametrize("make", [
    lambda places, values: goals.path("coupler", [x.translation for x in places], values,
                                      scale=True, placement=True, input_offset=True),
    lambda places, values: goals.poses("coupler", places, values, scale=True, placement=True),
    lambda places, values: goals.function("rocker_pin", values["crank"], values, offset=True)])
def test_slopes_of_goals_are_those_of_their_residuals(make):
    mechanism = sp.load("four_bar")
    values = np.array([0.3, 1.3, 2.6])
    states = [sp.assemble(mechanism, {"crank": x}) for x in values]
    goal = make([x.placement("coupler") for x in states], {"crank": values})
    family = Variants(mechanism, ["r2"])
    members = family.batch(np.full((1, 3), 0.1))
    at, nv = np.arange(3), mechanism.model.nv
    rng = np.random.default_rng(1)
    own = 0.3 * rng.standard_normal(len(goal.own_names))
    q = np.array([x.q for x in states]) + 0.1

    def bodies(step):
        moved = family.displaced(q, np.tile(step * mechanism.velocity_scale, (3, 1)))
        return family.bodies(members, moved, np.empty((3, 0)))

    found, moved, by_own = goal.slopes(bodies(np.zeros(nv)), at, own)
    assert found == pytest.approx(goal.residual(bodies(np.zeros(nv)), at, own), abs=1e-15)
    for k, step in enumerate(1e-6 * np.eye(nv)):
        there, back = (goal.residual(bodies(x), at, own) for x in (step, -step))
        assert moved[:, :, k] == pytest.approx((there - back) / 2e-6, abs=1e-8)
    for k, step in enumerate(1e-6 * np.eye(len(own))):
        there, back = (goal.residual(bodies(np.zeros(nv)), at, own + x) for x in (step, -step))
        assert by_own[:, :, k] == pytest.approx((there - back) / 2e-6, abs=1e-8)


def test_slopes_count_what_is_missed_beyond_the_end_of_a_curve():
    """A rocker that turns back before it comes to a point: no timing makes up for its links."""
    lengths = {"r1": 3.0, "r2": 0.6, "r3": 4.2, "r4": 2.1}
    mechanism = sp.load(SYNTHESIS / "four_bar_path.toml", **lengths)
    at = np.radians([0.0, 45.0, 90.0])
    points = np.column_stack([3.0 + 2.0 * np.cos(at), 2.0 * np.sin(at)])
    problem = DesignProblem(mechanism, [goals.path("rocker_end", points)],
                      {name: (0.2, 9.0) for name in ("r2", "r3", "r4")})
    (inner,), x = problem.inner_problems, problem.start
    (near,) = problem.start_states(x, None)

    def settled(x):
        found, left, is_closed = inner.exactly(problem.members(x), near, np.empty(0))
        assert is_closed.all()
        return found, left

    def cost(x):
        return 0.5 * np.sum(settled(x)[1] ** 2)

    there, left = settled(x)
    slopes = inner.slopes(problem.members(x), *problem.around(x), there, np.empty(0))
    gradient = np.einsum("kr,krn->n", left, slopes)
    steps = 1e-5 * np.eye(3)
    assert gradient == pytest.approx([(cost(x + d) - cost(x - d)) / 2e-5 for d in steps], rel=1e-5)


@pytest.mark.parametrize("dimensions", [(0.1, 0.28, 0.24), (0.25, 0.15, 0.38), (0.2, 0.2, 0.2)])
def test_a_swing_is_that_between_limits_too(dimensions):
    """Of a driver that turns back, outputs at its limits belong to it."""
    mechanism = sp.load("four_bar", **dict(zip(("r2", "r3", "r4"), dimensions, strict=True)))
    state = sp.assemble(mechanism)
    bounds = sp.limits(mechanism, "crank", state)
    values = (TURN if bounds.full_turn else
              np.linspace(bounds.lower.value + 1e-9, bounds.upper.value - 1e-9, 721))
    first = sp.sweep(mechanism, "crank", [state.coordinate("crank").value, values[0]], guess=state)
    motion = sp.sweep(mechanism, "crank", values, guess=first.state(-1))
    swing = np.ptp(motion.coordinate("rocker_pin").value)
    found = goals.swing("rocker_pin", 1.0).values(Candidate(mechanism, (state,)))
    assert found[0] == pytest.approx(swing - 1.0, abs=2e-4)  # samples are 1e-9 short of the limit


def test_peaks_between_samples_count():
    mechanism = sp.load("four_bar")
    asked = goals.transmission("rocker_pin", 1.0)
    found = asked.values(Candidate(mechanism, (sp.assemble(mechanism, {"crank": 0.123}),)))
    least = least_transmission_of(0.1, 0.28, 0.24)
    assert found.max() == pytest.approx(1.0 - least, abs=1e-12)


def test_smooth_peaks_are_found_by_parabolas_and_others_are_left():
    x = np.array([0.3, 0.5, 0.66])
    for at, smooth in (
        (lambda x: np.exp(np.sin(x + 1.07)) - 2.0, True),
        (lambda x: 1e3 / (1.0 + 50.0 * (x - 0.47) ** 2 + 30.0 * (x - 0.47) ** 3), True),
        (lambda x: -np.abs(x - 0.47), False),  # sharp
        (lambda x: np.minimum(x - 0.47, 0.3 * (0.47 - x)), False),
        (lambda x: -((x - 0.47) ** 4), False),  # flatter than a parabola
        (lambda x: np.full_like(x, 0.2), False),
        (lambda x: x, False),  # no peak
    ):
        for way in (1, -1):
            found = smooth_peak(x[::way], at(x[::way]), at)
            top = at(np.linspace(0.45, 0.52, 700001)).max()
            assert found == pytest.approx(top, rel=1e-11) if smooth else found is None


@pytest.mark.parametrize("goal", [
    goals.effort(0.8, loads={"rocker_b": np.array([0.0, 0.0, -10.0, 0.0, 0.0, 0.0])}),
    goals.size(0.45), goals.turns(), goals.transmission("rocker_pin", 0.6),
], ids=lambda goal: goal.name)
def test_peaks_are_those_of_a_search_that_takes_no_function_for_smooth(goal, monkeypatch):
    rng = np.random.default_rng(7)
    for _ in range(3):
        lengths = dict(zip(("r2", "r3", "r4"), (0.1, 0.28, 0.24) * rng.uniform(0.8, 1.2, 3),
                           strict=True))
        mechanism = sp.load("four_bar", **lengths)
        found = []
        for peak in (smooth_peak, lambda *_: None):
            monkeypatch.setattr(demand, "smooth_peak", peak)
            found.append(goal.values(Candidate(mechanism, (sp.assemble(mechanism),))))
        assert found[0] == pytest.approx(found[1], rel=1e-11, abs=1e-12)


def test_the_gradient_of_demands_and_goals_is_that_of_what_is_made_least():
    mechanism = sp.load("four_bar")
    problem = DesignProblem(mechanism, [
        goals.path("coupler_b", [[0.05, 0.0, 0.25], [0.1, 0.0, 0.3]], placement=True, scale=True),
        goals.size(0.3, weight=2.0)], {"r2": (0.05, 0.2), "r3": (0.2, 0.4)})
    x = problem.start + 0.01
    exact = ExactFit(problem, problem.start_states(x, None), x)
    gradient, step = exact.slopes(x).T @ exact.residual(x), 1e-6
    for k in range(len(x)):
        ends = [exact.residual(x + sign * step * np.eye(len(x))[k]) for sign in (1.0, -1.0)]
        costs = [0.5 * np.sum(residual**2) for residual in ends]
        assert gradient[k] == pytest.approx((costs[0] - costs[1]) / (2.0 * step), abs=1e-7)


@pytest.fixture
def small(monkeypatch):
    monkeypatch.setattr(atlas, "CURVES", 300)
    monkeypatch.setattr(search, "BATCHES", 2)


LINKS = {"r1": (0.2, 0.5), "r2": (0.05, 0.2), "r3": (0.1, 0.5), "r4": (0.1, 0.5)}


def drawn(k=12, **dimensions):
    """Return points that the middle of a four-bar's coupler passes."""
    mechanism = traced_four_bar(**dimensions)
    motion = sp.sweep(mechanism, "crank", 0.4 + 2.0 * np.pi * np.arange(k) / k)
    return motion.frame("tracer").position


def traced_four_bar(**dimensions):
    return sp.load(forms.SYNTHESIS / "four_bar_path.toml", **dimensions)


TRUE = {"r1": 0.32, "r2": 0.12, "r3": 0.30, "r4": 0.27, "cx": 0.15, "cy": 0.1}
FREE = {**LINKS, "cx": (-0.3, 0.3), "cy": (-0.3, 0.3)}


def path(points, **options):
    return goals.path("tracer", points, closed=True, **options)


@pytest.mark.slow
def test_a_drawing_of_any_place_and_size_is_met(small):
    """Its own numbers take it to the curve: no dimension moves that as a whole."""
    points = 40.0 * drawn(**TRUE)[:, [1, 0, 2]] * [1.0, -1.0, 1.0] + [3.0, 5.0, 0.0]
    best = sp.design(traced_four_bar(), path(points, placement=True, scale=True), FREE, starts=6,
                     method="atlas")[0]
    assert best.error < 1e-3
    assert all(low <= best.dimensions[name] <= high for name, (low, high) in FREE.items())


def test_how_dimensions_move_a_curve_as_a_whole_is_determined(small):
    """Pivots and the angle of the ground do, and all lengths together scale it."""
    points = drawn(**TRUE)
    for more, shifts, turns, scale in (
            ({}, [False] * 3, [False] * 3, True),
            ({"x0": (-1.0, 1.0)}, [True, False, False], [False] * 3, True),
            ({"x0": (-1.0, 1.0), "y0": (-1.0, 1.0), "theta0": (0.0, 6.28)},
             [True, True, False], [False, False, True], True)):
        names = FREE | more
        problem = DesignProblem(traced_four_bar(), [path(points)], names)
        one = CurveDatabase(problem)
        x, samples, _ = one._curves(np.array([problem.draw(np.random.default_rng(k))
                                              for k in range(60)]), np.random.default_rng(0))
        along, about, grows = one._movable(x[0], [s.taken(slice(0, 1)) for s in samples[:-1]])
        assert (along.tolist(), about.tolist()) == (shifts, turns)
        assert grows == (scale and {"x0", "y0"} <= names.keys())


def test_begins_are_at_the_path_within_bounds(small):
    points = drawn(**TRUE) + np.array([0.2, -0.1, 0.0])
    names = FREE | {"x0": (-1.0, 1.0), "y0": (-1.0, 1.0), "theta0": (-3.2, 3.2)}
    problem = DesignProblem(traced_four_bar(), [path(points)], names)
    found = CurveDatabase(problem).batch(np.random.default_rng(1))
    assert found and all(a.misfit <= b.misfit for a, b in pairwise(found))
    size = np.linalg.norm(points - points.mean(axis=0))
    for begin in found:
        assert ((problem.lower <= begin.x) & (begin.x <= problem.upper)).all()
        one = CurveDatabase(problem)
        there = one._points(one._same(begin.x, len(points)), begin.samples)
        assert np.linalg.norm(there - points) / size < 1.5 * begin.misfit + 0.1


@pytest.mark.slow
def test_the_answer_does_not_depend_on_the_workers(small):
    asked = dataclasses.replace(path(drawn(**TRUE)[:8]), closed=False)
    mechanism = traced_four_bar()

    def found(executor=None):
        return sp.design(mechanism, asked, {"r2": (0.05, 0.2), "cx": (0.0, 0.3)}, starts=2,
                         method="atlas", executor=executor)

    with ProcessPoolExecutor(2) as executor:
        assert str(found(executor)) == str(found())


def test_more_starts_than_curves_are_drawn_ones(small, monkeypatch):
    monkeypatch.setattr(atlas, "MOST_BROUGHT", 0)
    found = sp.design(traced_four_bar(), path(drawn(**TRUE)), {"r2": (0.05, 0.2)}, starts=2,
                      method="atlas")
    assert found.starts == 2 and found.evaluations > 2 * 300


@pytest.fixture(scope="module")
def four_bar():
    return sp.load("four_bar")


@pytest.fixture(scope="module")
def alone(four_bar):
    return sp.design(four_bar, FUNCTION, BOUNDS, starts=3)


@pytest.mark.parametrize(("name", "driver", "frame", "where"), first(3, [
    ("four_bar", "crank", "coupler_b", "in a plane"),
    ("screw_press", "screw", "platen", "on a line"),
    ("rssr", "crank", "coupler_b", None),
    ("watt_six_bar", "crank", "rocker_b", "in a plane"),
    ("rssr", "crank", "rocker_b", "in a plane"),
    ("spherical_four_bar", "crank", "rocker_b", None),
    ("crane", "luff", "tip", None),
]))
def test_points_are_refused_where_no_dimensions_lead_there_and_only_there(
    name, driver, frame, where
):
    mechanism = sp.load(name)
    bounds = {x: (0.9 * value, 1.1 * value) for x, value in mechanism.dimensions.items()}
    anywhere = DesignProblem(mechanism, (), bounds).anywhere()
    other = sp.load(name, **{x: 1.04 * value for x, value in mechanism.dimensions.items()})
    start = sp.assemble(other).coordinate(driver).value
    points = sp.sweep(other, driver, start + np.linspace(0.0, 0.2, 7)).frame(frame).position
    refuse_off_plane(anywhere, [goals.path(frame, points, weight=None)])
    away = [points + 0.01 * axis for axis in np.eye(3)]
    told = []
    for moved in away:
        try:
            refuse_off_plane(anywhere, [goals.path(frame, moved, weight=None)])
        except ValueError as error:
            told.append(str(error))
        refuse_off_plane(anywhere, [goals.path(frame, moved)])  # it has a weight
    assert bool(told) == bool(where) and all(f"stays {where}, and sample" in x for x in told)


@pytest.mark.parametrize("kind", [float, np.float64, np.float32])
def test_infinity_is_an_open_end_on_its_own_side_alone(kind):
    four_bar = sp.load("four_bar")
    least, most = kind(-np.inf), kind(np.inf)
    for given, wanted in (((least, 0.5), (None, 0.5)), ((0.125, most), (0.125, None)),
                          ((least, most), None)):
        assert bounds_of(four_bar, {"r2": given}) == bounds_of(four_bar, {"r2": wanted})
    for wrong in ((most, 0.5), (0.1, least), (kind(np.nan), 0.5), (0.1, kind(np.nan))):
        with pytest.raises(ValueError, match="a bound of 'r2' has a value that is NaN or infinite"):
            bounds_of(four_bar, {"r2": wrong})


SIZE = 0.54  # of the library's four-bar: ground and rocker in a line


@pytest.mark.parametrize(("bounds", "least", "most"), [
    ((0.04, None), 0.14, 0.44), ((None, 0.34), 0.14, 0.29), (None, 0.12, 0.48),
    ((0.24, None), 0.24, 0.24 + SIZE), ((None, 0.24), 0.24 - SIZE, 0.24), ((0.1, 0.3), 0.1, 0.3)])
def test_starts_are_drawn_from_half_to_twice_a_dimension_or_its_distance_to_a_bound(
    four_bar, bounds, least, most
):
    """The rocker is 0.24 long; where that is a bound, the length of the mechanism counts."""
    assert four_bar.characteristic_length == pytest.approx(SIZE)
    ends = {"r4": tuple(x if x is not None else s * np.inf
                        for x, s in zip(bounds or (None, None), (-1, 1), strict=True))}
    problem, rng = DesignProblem(four_bar, [FUNCTION], ends), np.random.default_rng(0)
    drawn = np.array([problem.draw(rng)[0] for _ in range(300)])
    assert drawn.min() == pytest.approx(least, abs=0.02)
    assert drawn.max() == pytest.approx(most, abs=0.02)
    assert (least <= drawn).all() and (drawn <= most).all()


@pytest.mark.parametrize("interrupted_at", few([1, 2], 2))
def test_after_ctrl_c_it_goes_on_to_the_same_answer(
    four_bar, alone, tmp_path, monkeypatch, interrupted_at
):
    kept, solve = tmp_path / "kept", DesignProblem.solve
    calls = []

    def interrupted(*arguments):
        calls.append(arguments)
        if len(calls) == interrupted_at:
            raise KeyboardInterrupt
        return solve(*arguments)

    def ask():
        return sp.design(four_bar, FUNCTION, BOUNDS, starts=3, resume=kept)

    monkeypatch.setattr(DesignProblem, "solve", interrupted)
    if interrupted_at == 1:  # before anything was found
        with pytest.raises(KeyboardInterrupt):
            ask()
    else:
        with monkeypatch.context() as patched:  # defects are looked for when they are asked for
            patched.setattr("spatial_pin.synthesis.ranked_designs.defects", None)
            with pytest.raises(sp.Interrupted) as stopped:
                ask()
        found = stopped.value.result
        assert (found.is_whole, found.starts, len(found)) == (False, interrupted_at - 1, 1)
        assert str(found).splitlines()[0].endswith("cut short")
    assert_same(alone, ask())
    assert len(calls) == 3 + 1
    assert_same(alone, ask())
    assert len(calls) == 3 + 1


# ---------------------------------------------------------------- what is shown of a design


def test_the_best_design_is_shown_with_its_goals(alone):
    shown, look = overlaid(alone, None)
    assert shown.mechanism is alone[0].mechanism and look.design is alone[0]
    assert overlaid(alone[0], sp.Look(axes=True))[1].axes
    motion = alone[0].motion()
    assert overlaid(motion, None) == (motion, None)


def test_samples_that_no_motion_joins_are_shown_side_by_side(alone, monkeypatch):
    def apart(_self, goal=0):
        raise sp.SpatialPinError("the samples are on two branches")

    monkeypatch.setattr(sp.Design, "motion", apart)
    shown, look = overlaid(alone[0], None)
    assert shown is alone[0].states[0]
    assert look.ghosts == alone[0].states[1:] and look.design is alone[0]


def test_the_top_of_three_points_of_a_parabola_is_its_own():
    x = np.array([-1.0, 0.2, 2.0])
    place, height, bend = demand._top(x, 5.0 - 3.0 * (x - 0.3) ** 2)
    assert (place, height, bend) == pytest.approx((0.3, 5.0, -3.0), abs=1e-12)


@pytest.mark.parametrize("gap", [0.0, 0.3, 2.0, 6.0])
def test_a_full_turn_misses_the_angle_that_is_left_of_it(gap):
    mechanism = sp.load("four_bar")
    goal = sp.goals.turns()
    found = goal.errors(np.array([1.0 - np.cos(0.5 * gap)]), mechanism)
    assert found[0] == pytest.approx(gap, abs=1e-7)
