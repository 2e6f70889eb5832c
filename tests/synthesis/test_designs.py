"""Designs: what is told of them is what their mechanisms do."""

import urllib.request
from functools import cache

import numpy as np
import pytest
from images import matrix_of, page, paths

import spatial_pin as sp

PHI, PSI = np.radians([40.0, 85.0, 130.0]), np.radians([80.0, 100.0, 130.0])
BOUNDS = {"r2": (0.05, 0.6), "r3": (0.05, 0.6), "r4": (0.05, 0.6)}


@cache
def loaded(name):
    return sp.load(name)


def designed(goal, bounds=BOUNDS, starts=3, most=10, name="four_bar"):
    return sp.design(loaded(name), goal, bounds, starts=starts, most=most)


@pytest.fixture(scope="module")
def function():
    return designed((sp.goals.function("rocker_pin", PSI, {"crank": PHI}),))


def test_freudensteins_linkage_meets_its_three_points(function):
    """k1 cos(psi) - k2 cos(phi) + k3 = cos(phi - psi) with k1 = d/a, k2 = d/c [Freudenstein]."""
    best = function[0]
    A = np.column_stack([np.cos(PSI), -np.cos(PHI), np.ones(3)])
    k1, k2, k3 = np.linalg.solve(A, np.cos(PHI - PSI))
    d = 0.30
    a, c = d / k1, d / k2
    b = np.sqrt(a * a + c * c + d * d - 2.0 * a * c * k3)
    assert list(best.dimensions.values()) == pytest.approx([a, b, c], rel=1e-9)
    assert best.mechanism.dimensions["r2"] == best.dimensions["r2"]
    assert best.errors["function of rocker_pin"].most < 1e-12 and best.error < 1e-12
    assert best.errors["function of rocker_pin"].unit == "rad"
    assert not best.at_bounds and best.evaluations > 0


def test_states_are_closed_states_of_its_mechanism_at_the_samples(function):
    best = function[0]
    assert len(best.states) == 3
    for state, phi, psi in zip(best.states, PHI, PSI, strict=True):
        assert state.mechanism is best.mechanism and state.closure_error < 1e-13
        assert state.coordinate("crank").value == pytest.approx(phi, abs=1e-13)
        assert state.coordinate("rocker_pin").value == pytest.approx(psi, abs=1e-12)
    assert best.met[0].targets == pytest.approx(PSI)


def test_a_design_is_saved_and_loaded(function, tmp_path):
    file = function[0].mechanism.save(tmp_path / "found")
    again = sp.load(file)
    state = sp.assemble(again, {"crank": PHI[1]}, guess=function[0].states[1].q)
    assert state.coordinate("rocker_pin").value == pytest.approx(PSI[1], abs=1e-12)


def test_a_dimension_on_its_bound_is_reported():
    best = designed((sp.goals.function("rocker_pin", PSI, {"crank": PHI}),),
                    {**BOUNDS, "r4": (0.05, 0.22)}, starts=1)[0]
    assert best.at_bounds == {"r4": "most"} and "r4 = 0.22 (its most)" in str(best)
    told = best.errors["function of rocker_pin"]
    missed = [s.coordinate("rocker_pin").value - psi
              for s, psi in zip(best.states, PSI, strict=True)]
    assert told.rms == pytest.approx(np.sqrt(np.mean(np.square(missed))), rel=1e-6)
    assert told.most == pytest.approx(np.abs(missed).max(), rel=1e-6)
    assert best.error == pytest.approx(np.linalg.norm(missed), rel=1e-6)


POINTS = np.array([[0.05, 0.0, 0.25], [0.10, 0.0, 0.30], [0.15, 0.0, 0.29], [0.22, 0.0, 0.24]])


@pytest.fixture(scope="module")
def path():
    return designed((sp.goals.path("coupler_b", POINTS, placement=True, scale=True),),
                    {"r2": (0.05, 0.2)}, starts=1)


@pytest.mark.slow
def test_targets_of_a_path_are_where_the_drawing_was_placed(path):
    for one in path:
        met, told = one.met[0], one.errors["path of coupler_b"]
        points = np.array([s.placement("coupler_b").translation for s in met.states])
        away = np.linalg.norm(points - met.targets, axis=1)
        assert told.rms == pytest.approx(np.sqrt(np.mean(away**2)), rel=1e-4, abs=1e-12)
        sizes = [np.linalg.norm(np.diff(x, axis=0), axis=1) for x in (met.targets, POINTS)]
        scale = one.numbers["path of coupler_b: scale"]
        assert sizes[0] == pytest.approx(scale * sizes[1], rel=1e-9)
        shift = [one.numbers[f"path of coupler_b: placement.{x}"] for x in "xyz"]
        assert met.targets.mean(axis=0) - POINTS.mean(axis=0) == pytest.approx(shift, abs=1e-12)


def test_a_drawing_of_any_size_does_not_shrink_to_a_point():
    """Points of a coupler, drawn twice as large: the best drawing is not the smallest."""
    mechanism = sp.load("four_bar", r2=0.11)
    values = np.array([0.3, 1.3, 2.6, 4.0, 5.2])
    points = np.array([sp.assemble(mechanism, {"crank": x}).placement("coupler_b").translation
                       for x in values])
    centre = points.mean(axis=0)
    drawn = centre + 2.0 * (points - centre)
    goal = sp.goals.path("coupler_b", drawn, {"crank": values - 0.4}, scale=True, input_offset=True)
    best = designed((goal,), {"r2": (0.05, 0.2)}, starts=2)[0]
    assert best.dimensions["r2"] == pytest.approx(0.11, rel=1e-7)
    assert best.numbers["path of coupler_b: scale"] == pytest.approx(0.5, rel=1e-7)
    assert best.numbers["path of coupler_b: crank.zero"] == pytest.approx(0.4, abs=1e-6)
    assert best.met[0].targets == pytest.approx(points, abs=1e-8)


@pytest.mark.slow
def test_a_drawing_in_another_unit_begins_about_as_large_as_the_mechanism():
    mechanism = sp.load("four_bar", r2=0.11)
    values = np.array([0.3, 1.3, 2.6, 4.0, 5.2])
    points = np.array([sp.assemble(mechanism, {"crank": x}).placement("coupler_b").translation
                       for x in values])
    goal = sp.goals.path("coupler_b", [300.0, 0.0, 200.0] + 2000.0 * points, {"crank": values},
                      scale=True, placement=True)
    best = designed((goal,), {"r2": (0.05, 0.2)}, starts=2)[0]
    assert best.dimensions["r2"] == pytest.approx(0.11, rel=1e-6)
    assert best.numbers["path of coupler_b: scale"] == pytest.approx(1.0 / 2000.0, rel=1e-6)
    assert best.met[0].targets == pytest.approx(points, abs=1e-7)
    near = sp.goals.path("coupler_b", points, scale=True)
    assert near.own_start(mechanism).tolist() == [0.0]
    assert sp.goals.path("coupler_b", points[:1], scale=True).own_start(mechanism).tolist() == [0.0]


def test_the_report_fits_a_hundred_columns(path, function):
    for report in (str(path), str(function)):
        assert max(map(len, report.splitlines())) <= 100
    assert str(function).startswith("four_bar: 1 design from 3 starts")
    assert "scale = " in str(path) and "path of coupler_b: " in str(path)
    for k, one in enumerate(path, start=1):
        assert f"{k}. error {one.error:.3g}" in str(path)


@pytest.mark.slow
def test_defects_are_judged_goal_by_goal():
    flat = np.radians([40.0, 85.0, 130.0])
    found = designed((sp.goals.function("rocker_pin", PSI, {"crank": flat}),
                      sp.goals.function("rocker_pin", PSI + 0.3, {"crank": flat})), starts=1)[0]
    assert list(found.errors) == ["function of rocker_pin", "function of rocker_pin (2)"]
    assert len(found.states) == 6
    assert all("function of rocker_pin" in x.text for x in found.defects)


@pytest.mark.slow
def test_designs_are_a_sequence_of_which_the_first_is_the_best(path):
    assert isinstance(path, sp.Designs) and len(path[:1]) == 1 and next(iter(path)) is path[0]
    goal = sp.goals.path("coupler_b", POINTS[:1])
    some = designed((goal,), {"r2": (0.05, 0.2)}, starts=2)
    errors = [one.error for one in some]
    assert len(some) > 1 and errors == sorted(errors)
    assert len(designed((goal,), {"r2": (0.05, 0.2)}, starts=2, most=1)) == 1


def test_a_report_of_nothing_says_so():
    text = str(sp.Designs((), "four_bar", False, 3, 3, 12))
    assert " ".join(text.split()) == (
        "four_bar: 0 designs from 3 starts, 3 of them without one; 12 sets of dimensions tried; "
        "cut short; the loops closed at none of them")


def test_it_is_reported_how_far_the_nearest_is_from_what_is_to_be_met_exactly():
    goal = sp.goals.path("coupler_b", [[0.0, 0.0, 5.0], [0.1, 0.0, 5.0]], weight=None)
    found = designed((goal,), {"r2": (0.05, 0.2)}, starts=1)
    assert not found and 1.0 < found.nearest < 20.0
    words = f"the nearest misses an exact goal by {found.nearest:.2g} characteristic"
    assert words in " ".join(str(found).split())
    with pytest.raises(IndexError, match="there is no design 0; 0 were found, from 1 start; "):
        found[0]


def test_it_is_reported_why_a_demand_could_not_be_judged():
    asked = sp.goals.swing("rocker_pin", 0.5, values=[0.0, np.pi])  # the crank does not come there
    found = sp.design(sp.load("four_bar", r2=0.25), asked, {"r2": (0.24, 0.26)}, starts=1)
    assert not found and "out of reach" in found.why
    assert found.why.split(" (")[0] in " ".join(str(found).split())
    assert found.as_dict()["why"] == found.why
    with pytest.raises(IndexError, match=r"from 1 start; .*out of reach"):
        found[0]


def test_dimensions_with_which_the_file_makes_no_mechanism_are_no_design():
    """Without a length a link cannot be drawn, though the loops close."""
    found = sp.design(sp.load("four_bar"), sp.goals.path("coupler", [[0.0, 0.0, 0.0]]), ["r2"],
                      starts=1)
    assert not found and found.failed == 1
    assert "four_bar.urdf.xacro" in found.why and "division by zero" in str(found)


def test_designs_are_named_briefly(function):
    assert repr(function).startswith("Designs('four_bar': 1 from 3 starts, errors from ")
    assert repr(function[0]).startswith("Design('four_bar': error ") and len(repr(function)) < 90
    with pytest.raises(IndexError, match="there is no design 1; 1 were found, from 3 starts"):
        function[1]


@pytest.mark.slow
def test_of_equal_errors_those_without_defects_come_first():
    """The last point can be met on either side of the rocker's dead centre, as well."""
    bounds = {"r1": (0.1, 0.6), "r2": (0.05, 0.2), "r3": (0.1, 0.6), "r4": (0.1, 0.6)}
    found = designed((sp.goals.path("coupler_b", POINTS),
                      sp.goals.function("rocker_pin", PSI, {"crank": PHI}, weight=0.2)), bounds,
                     starts=2)
    graves = [sum(x.kind in ("circuit", "branch", "order") for x in one.defects) for one in found]
    assert len(found) > 1 and found[0].error == pytest.approx(found[1].error, rel=1e-9)
    assert graves == sorted(graves) and graves[-1] > graves[0]


# ---------------------------------------------------------------- motions and pictures


def test_its_motion_goes_through_the_samples(function, path):
    for one in (function[0], path[0]):
        motion = one.motion()
        assert motion.mechanism is one.mechanism
        tip = motion.frame("coupler_b").position
        for state in one.states:
            gaps = np.linalg.norm(tip - state.placement("coupler_b").translation, axis=1)
            assert gaps.min() < 5e-3
    with pytest.raises(sp.SpatialPinError, match="no goal 1 with samples"):
        function[0].motion(1)


def test_what_was_requested_is_shown_beside_the_path(path):
    one = path[0]
    text = page(one.motion(), look=sp.Look(design=one))
    points = [matrix_of(text, f"design 0 point {k}")[:3, 3] for k in range(len(POINTS))]
    assert np.array(points) == pytest.approx(one.met[0].targets)  # the view is the world here
    assert paths(text).count("path of coupler_b") == 1
    both = page(one.motion(), look=sp.Look(design=one, traces=("coupler_b",)))
    assert paths(both).count("path of coupler_b") == 1
    assert "target points of coupler_b</small>" in text
    still = page(one.states[0], look=sp.Look(design=one))
    assert not any(name.startswith("path") for name in paths(still))


def test_placements_are_shown_as_triads():
    mechanism = sp.load("four_bar")
    states = [sp.assemble(mechanism, {"crank": x}) for x in (0.5, 1.0)]
    asked = [s.placement("coupler") for s in states]
    one = designed((sp.goals.poses("coupler", asked),), {"r2": (0.08, 0.2)}, starts=1)[0]
    text = page(one.states[0], look=sp.Look(design=one))
    for i, target in enumerate(asked):
        for k, name in enumerate("xyz"):
            place = matrix_of(text, f"design 0 placement {i} {name}")  # of a cylinder
            axis, middle = place[:3, 1], place[:3, 3] - target.translation
            assert axis == pytest.approx(target.rotation[:, k], abs=1e-12)
            assert middle == pytest.approx((axis @ middle) * axis, abs=1e-12)
            assert 0.005 < axis @ middle < 0.05  # it begins where the placement is


def test_a_design_of_other_dimensions_is_refused(function):
    motion = sp.sweep(sp.load("four_bar"), "crank", [0.0, 0.1])
    with pytest.raises(sp.SpatialPinError, match="other dimensions than the mechanism shown"):
        page(motion, look=sp.Look(design=function[0]))
    with pytest.raises(TypeError, match=r"sp\.design\(mechanism"):
        sp.Look(design=function)


def test_the_best_design_is_shown_with_what_was_requested(path, tmp_path):
    one = path[0]
    with sp.show(path, open_browser=False) as viewer:
        served = urllib.request.urlopen(viewer.url).read().decode()
    assert "target points of coupler_b" in served
    text = sp.report(path, tmp_path / "r.html").read_text("utf-8")
    assert "<h2>Design</h2>" in text and "path of coupler_b of four_bar, with its targets" in text
    assert "target points of" in sp.export_html(one, tmp_path / "e.html").read_text("utf-8")
    nothing = sp.Designs((), "four_bar", False, 3, 3, 12)
    with pytest.raises(sp.SpatialPinError, match="no design was found that could be shown"):
        sp.show(nothing, open_browser=False)


@pytest.fixture(scope="module")
def of_several_drivers():
    mechanism = loaded("delta")
    states = [sp.assemble(mechanism, dict.fromkeys(mechanism.drivers, x)) for x in (0.2, 0.3)]
    goal = sp.goals.path("platform", [s.placement("platform").translation for s in states])
    return designed((goal,), {"lu": (0.3, 0.8)}, starts=1, name="delta")[0]


@pytest.mark.slow
def test_several_drivers_go_from_sample_to_sample(of_several_drivers):
    tip = of_several_drivers.motion().frame("platform").position
    ends = [state.placement("platform").translation for state in of_several_drivers.states]
    assert tip[[0, -1]] == pytest.approx(np.array(ends), abs=1e-9)


@pytest.mark.slow
def test_a_path_of_several_drivers_is_reported_too(of_several_drivers, tmp_path):
    motion, look = of_several_drivers.motion(), sp.Look(design=of_several_drivers)
    told = sp.report(motion, tmp_path / "r.html", look=look).read_text("utf-8")
    assert "path of platform of delta, with its targets" in told


def test_a_report_has_what_was_requested_and_what_was_found(function, tmp_path):
    one = function[0]
    text = sp.report(one.motion(), tmp_path / "r.html", look=sp.Look(design=one)).read_text("utf-8")
    assert "<h2>Design</h2>" in text and "function of rocker_pin" in text
    assert "rocker_pin of four_bar, with its targets" in text
    assert all(name in text for name in one.dimensions)
    still = sp.report(one.states[0], tmp_path / "s.html", look=sp.Look(design=one))
    assert "with its targets" not in still.read_text("utf-8")
    assert "<h2>Design</h2>" not in sp.report(one.motion(), tmp_path / "t.html").read_text("utf-8")
