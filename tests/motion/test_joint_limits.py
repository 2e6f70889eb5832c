"""Joint limits of the URDF: where sweeps and simulations pass them, against closed forms."""

import json
import re

import mechanisms as known
import mpmath
import numpy as np
import pytest
from joint_limits import LOWER, UPPER, crank_at, hanging, limited_slider_crank
from loaded_library import library
from rsup import poses, rsup
from scipy.optimize import brentq
from scipy.special import ellipj, ellipk
from variety import paired

import spatial_pin as sp

G = 9.81
REFERENCE = sp.Accuracy.named("reference")
PACE = np.sqrt(1.5 * 0.4 * G / (0.02 + 1.5 * 0.4**2))  # of small swings of the rod [rad/s]


def swing(amplitude, t):
    """A pendulum released at an amplitude [Landau I, 11]."""
    k = np.sin(0.5 * amplitude)
    return 2.0 * np.arcsin(k * ellipj(ellipk(k**2) - PACE * t, k**2)[0])


QUARTER = ellipk(np.sin(0.6) ** 2) / PACE  # of the period at amplitude 1.2


@pytest.mark.parametrize(("second", "formulation"), [
    (False, "independent"), (True, "independent"), (False, "projected")])
def test_a_pendulum_passes_its_limit_when_elliptic_functions_say(second, formulation, tmp_path):
    mech = hanging(tmp_path, -0.7, 1.3, second)
    accuracy = sp.Accuracy(tolerance=1e-15, time_tolerance=1e-13, formulation=formulation)
    motion = sp.simulate(mech, sp.assemble(mech, {"pin": 1.2}), 9.0 * QUARTER, accuracy=accuracy)
    first = brentq(lambda t: swing(1.2, t) + 0.7, QUARTER, 2.0 * QUARTER, xtol=1e-15)
    want = [first + 4.0 * k * QUARTER for k in range(2)]
    assert [p.value for p in motion.joint_limits] == pytest.approx(want, abs=1e-11)
    assert {(p.limit.name, p.limit.value, p.limit.side) for p in motion.joint_limits} == {
        ("pin", -0.7, -1)}
    assert motion.events == [p.event for p in motion.joint_limits]
    for event in motion.events:
        assert event.kind == "joint limit"
        assert motion.time[event.row - 1] < event.value < motion.time[event.row]
        assert "lower limit -0.7 rad of pin passed at" in event.text


def test_to_report_a_limit_or_to_ignore_it_leaves_the_motion_as_it_is(tmp_path):
    mech = hanging(tmp_path, -0.7, 1.3)
    state = sp.assemble(mech, {"pin": 1.2})
    told = sp.simulate(mech, state, 2.0)
    ignored = sp.simulate(mech, state, 2.0, on_joint_limit="ignore")
    assert told.events and not ignored.events and not ignored.joint_limits
    np.testing.assert_array_equal(told.q, ignored.q)
    with pytest.raises(ValueError, match="on_joint_limit is 'halt'; it is one of 'report'"):
        sp.simulate(mech, state, 2.0, on_joint_limit="halt")


def test_it_stops_at_a_limit_with_a_last_row_there(tmp_path):
    mech = hanging(tmp_path, -0.7, 1.3)
    state = sp.assemble(mech, {"pin": 1.2})
    motion = sp.simulate(mech, state, 2.0, on_joint_limit="stop")
    assert [e.kind for e in motion.events] == ["joint limit", "stopped"]
    assert "by the lower limit -0.7 rad of pin" in motion.events[1].text
    assert motion.time[-1] == motion.events[0].value == motion.events[1].value
    assert motion.coordinate("pin").value[-1] == pytest.approx(-0.7, abs=1e-12)
    # what stops it first, stops it
    earlier = sp.simulate(mech, state, 2.0, on_joint_limit="stop",
                          stop_when=lambda t, s: s.coordinate("pin").value + 0.2)
    assert [e.kind for e in earlier.events] == ["stopped"]
    assert earlier.coordinate("pin").value[-1] == pytest.approx(-0.2, abs=1e-11)


def test_a_joint_that_turns_back_just_beyond_its_limit_has_passed_it(tmp_path):
    """Both ends of the step lie inside."""
    amplitude, beyond = 1.2, 1e-7
    mech = hanging(tmp_path, -amplitude + beyond, 1.3)
    motion = sp.simulate(mech, sp.assemble(mech, {"pin": amplitude}), 3.0 * QUARTER,
                         accuracy=REFERENCE)
    (passing,) = motion.joint_limits
    want = brentq(lambda t: swing(amplitude, t) + amplitude - beyond, QUARTER, 2.0 * QUARTER,
                  xtol=1e-15)
    assert passing.value == pytest.approx(want, abs=1e-7)  # it hardly moves there
    short = hanging(tmp_path, -amplitude - beyond, 1.3)
    assert not sp.simulate(short, sp.assemble(short, {"pin": amplitude}), 3.0 * QUARTER).events


def test_a_start_beyond_a_limit_is_reported_or_refused(tmp_path):
    mech = hanging(tmp_path, -2.0, 1.0)
    with pytest.warns(sp.SpatialPinWarning, match="beyond joint limits"):
        state = sp.assemble(mech, {"pin": 1.2})
    motion = sp.simulate(mech, state, 1.0)
    assert motion.events[0].kind == "joint limit" and motion.events[0].row == 0
    assert motion.events[0].text == "beyond the upper limit 1 rad of pin from the start"
    with pytest.raises(sp.SpatialPinError, match="beyond the upper limit 1 rad of pin"):
        sp.simulate(mech, state, 1.0, on_joint_limit="stop")
    at_rest = sp.assemble(mech, {"pin": 1.0})
    assert sp.simulate(mech, at_rest, 1.0, on_joint_limit="stop").time[-1] == 1.0


def test_legs_that_begin_at_rest_are_no_trouble():
    """Their rates of 1e-17 at the start have any sign; five of six then fall to their limits."""
    mech = library("stewart")
    state = sp.solve_rates(mech, sp.assemble(mech), {"leg_1": 0.1})
    motion = sp.simulate(mech, state, 0.2)
    assert {p.limit.name for p in motion.joint_limits} == {f"slide_{k}" for k in range(2, 7)}
    there = sp.simulate(mech, state, 0.2, times=[p.value for p in motion.joint_limits])
    for p, q in zip(motion.joint_limits, there.q, strict=True):
        assert abs(p.limit.room(q)) < 5e-12 * p.limit.size


def test_a_stop_function_whose_sign_at_the_start_is_noise_stops_there(tmp_path):
    mech = hanging(tmp_path, -0.7, 1.3)
    noise = iter([1e-17])
    motion = sp.simulate(mech, sp.assemble(mech, {"pin": 1.2}), 1.0,
                         stop_when=lambda t, s: next(noise, -1e-17 - t))
    assert motion.time[-1] == 0.0 and motion.events[-1].kind == "stopped"


def test_the_command_line_stops_at_limits(tmp_path, run):
    hanging(tmp_path, -0.7, 1.3)
    code, said, _ = run("simulate", tmp_path / "hanging.toml", "--duration", "1", "--at", "pin=1.2",
                        "--on-joint-limit", "stop", "--json", tmp_path / "m.json")
    assert code == 0 and "stopped at" in said
    events = json.loads((tmp_path / "m.json").read_text(encoding="utf-8"))["events"]
    assert [event["kind"] for event in events] == ["joint limit", "stopped"]


# ---------------------------------------------------------------- sweeps


@pytest.fixture
def slider_crank():
    return limited_slider_crank()


def passed(motion):
    """The joint limits that a motion tells, and how: (side, value) of the slide, and the event."""
    found = []
    for event in motion.events:
        if event.kind == "joint limit":
            side, value = re.search(r"(lower|upper) limit (\S+) m of slide", event.text).groups()
            found.append((side, float(value), event))
    return found


@pytest.mark.parametrize(("n", "way"), paired(
    [361, 37, 12, 5, 4], ["forward", "backward", "faster and faster"]))
def test_a_sweep_passes_limits_where_the_triangle_says(slider_crank, n, way):
    """However far its rows are apart."""
    values = np.linspace(0.0, 2.0 * np.pi, n)
    speed = np.linspace(1.0, 3.0, n) if way == "faster and faster" else 2.0
    motion = sp.sweep(slider_crank, "crank", values[::-1] if way == "backward" else values, speed)
    (side, _, start), *others = passed(motion)
    assert (side, start.row) == ("upper", 0) and start.text.endswith("from the start")
    low, high = crank_at(LOWER), crank_at(UPPER)
    want = [low, 2.0 * np.pi - high] if way != "backward" else [2.0 * np.pi - low, high]
    assert [value for _, value, _ in others] == [LOWER, UPPER]
    assert [event.value for _, _, event in others] == pytest.approx(want, abs=2e-13)
    for _, _, event in others:
        before, after = motion.swept[event.row - 1], motion.swept[event.row]
        assert min(before, after) <= event.value <= max(before, after)
    assert "upper limit 0.209 m of slide passed at crank = " in others[1][2].text


def test_rows_without_rates_pass_limits_at_the_same_place(slider_crank):
    motion = sp.sweep(slider_crank, "crank", np.linspace(0.2, 3.1, 4), 0.0)
    (lower,) = [event for side, _, event in passed(motion) if side == "lower"]
    assert lower.value == pytest.approx(crank_at(LOWER), abs=1e-13)


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize("beyond", [1e-5, -1e-5])
def test_a_slide_that_turns_back_between_far_rows_is_looked_at_where_it_does(
    slider_crank, way, beyond
):
    """The polynomial through these rows errs by more than the slide goes beyond, or stops short."""
    at, model = slider_crank.coordinate("slide").q, slider_crank.model
    limits = model.upperPositionLimit.copy()
    limits[at] = 0.21 - beyond
    model.upperPositionLimit = limits
    motion = sp.sweep(slider_crank, "crank", np.linspace(-0.9, 1.1, 2)[::way])
    found = [event.value for _, _, event in passed(motion)]
    want = [-way * crank_at(0.21 - beyond)] if beyond > 0.0 else []
    assert found == pytest.approx(want, abs=1e-11)


@pytest.mark.parametrize("n", [4, 7, 30])
def test_an_rsup_passes_the_limits_of_its_slide_where_closed_forms_say(n, tmp_path):
    mech = rsup(tmp_path, "S", 0.3)
    at, lower = mech.coordinate("P").q, -0.33
    limits = mech.model.lowerPositionLimit.copy()
    limits[at] = lower
    mech.model.lowerPositionLimit = limits
    motion = sp.sweep(mech, "motor", np.linspace(0.3, 0.3 + 2.0 * np.pi, n))
    angles = np.linspace(0.3, 0.3 + 2.0 * np.pi, 721)
    room = [float(poses(mpmath.mpf(x))[1][0]) - lower for x in angles]
    (k,) = np.flatnonzero((np.array(room[:-1]) > 0.0) & (np.array(room[1:]) < 0.0))
    want = float(mpmath.findroot(lambda x: poses(x)[1][0] - lower, tuple(angles[k : k + 2]),
                                 solver="anderson", tol=1e-28))
    assert [e.value for e in motion.events if e.kind == "joint limit" and " of P " in e.text] == (
        pytest.approx([want], abs=1e-12))


# ---------------------------------------------------------------- how far a driver can go


def test_a_range_ends_at_the_first_joint_limit(slider_crank):
    found = sp.limits(slider_crank, "crank", {"crank": 1.5}, joints=True)
    assert (found.lower.kind, found.upper.kind) == ("upper limit of slide", "lower limit of slide")
    assert not found.full_turn
    assert found.lower.value == pytest.approx(crank_at(UPPER), abs=1e-12)
    assert found.upper.value == pytest.approx(crank_at(LOWER), abs=1e-12)
    assert "(lower limit of slide)" in str(found)
    assert sp.limits(slider_crank, "crank", {"crank": 1.5}).full_turn
    with pytest.raises(sp.SpatialPinError, match=r"beyond the upper limit 0\.209 m of slide"):
        sp.limits(slider_crank, "crank", {"crank": 0.01}, joints=True)


def test_a_range_without_a_joint_limit_in_it_is_as_without(slider_crank):
    slide = sp.limits(slider_crank, "slide", {"crank": 1.5})
    assert [slide.lower.kind, slide.upper.kind] == ["limit", "limit"]
    within = sp.limits(slider_crank, "slide", {"crank": 1.5}, joints=True)
    assert [within.lower.value, within.upper.value] == pytest.approx([LOWER, UPPER], abs=1e-12)
    model, at = slider_crank.model, slider_crank.coordinate("slide").q
    limits = model.upperPositionLimit.copy()
    limits[at] = 0.21 - 1e-6  # in the last thousandth of the way to the dead centre
    model.upperPositionLimit = limits
    assert sp.limits(slider_crank, "slide", {"crank": 1.5}, joints=True).upper.value == (
        pytest.approx(0.21 - 1e-6, abs=1e-12))
    found = sp.limits(slider_crank, "crank", {"crank": 1.5}, joints=True)
    assert found.lower.value == pytest.approx(crank_at(0.21 - 1e-6), abs=1e-10)
    for name in ("slider_crank", "four_bar", "stewart"):  # limits out of reach, none, telescopes
        mech = library(name)
        driver = next(iter(mech.drivers))
        free, held = (sp.limits(mech, driver, joints=joints) for joints in (False, True))
        assert (free == held) == (name != "stewart")


def test_a_driver_of_many_turns_has_its_own_limits(tmp_path):
    found = sp.limits(hanging(tmp_path, -20.0, 15.0), "pin", joints=True)
    assert (found.lower.kind, found.upper.kind) == ("lower limit of pin", "upper limit of pin")
    assert [found.lower.value, found.upper.value] == pytest.approx([-20.0, 15.0], abs=1e-12)


def test_a_sweep_tells_the_joint_limits_that_it_passes(tmp_path):
    mech = hanging(tmp_path, -0.7, 1.3)
    motion = sp.sweep(mech, "pin", np.linspace(0.0, 2.0, 101))
    assert [(e.kind, e.row) for e in motion.events] == [("joint limit", 66)]
    assert motion.events[0].value == pytest.approx(1.3, abs=1e-13)


def test_a_motion_without_time_passes_limits_at_samples():
    gough = library("stewart")
    upper = float(gough.model.upperPositionLimit[gough.coordinate("slide_1").q])
    home = sp.assemble(gough).coordinate("leg_1").value
    rising = home + (upper - home) * np.linspace(0.0, 1.25, 101)
    motion = sp.follow(gough, {"leg_1": rising, "leg_2": home})
    (event,) = motion.events
    assert event.value == pytest.approx(80.0, abs=1e-9)
    assert event.text.endswith(" of slide_1 passed at sample 80")


def test_rows_at_one_place_pass_no_limit_however_their_speeds_differ(tmp_path):
    mech = hanging(tmp_path, -0.7, 1.3)
    values = np.repeat(np.linspace(0.0, 2.0, 9), 3)
    speed = np.tile([1.0, -1.0], len(values))[: len(values)]
    with np.errstate(all="raise"):
        motion = sp.sweep(mech, "pin", values, speed=speed)
    events = [(e.value, e.row) for e in motion.events if e.kind == "joint limit"]
    assert events == [(pytest.approx(1.3, abs=1e-12), 18)]


@pytest.mark.filterwarnings("ignore::spatial_pin.SpatialPinWarning")  # beyond limits
@pytest.mark.parametrize("limits", [(0.0, 7.0), (-10.0, 10.0), (-1.0, 1.0)])
def test_limits_that_are_not_kept_leave_the_branch(limits, tmp_path):
    """An angle taken to another turn for its limits is where it was."""
    def four_bar(name, kind, limits):
        tree = (known.turning("crank", "ground", "a")
                + known.turning("knee", "a", "b", (0.1, 0, 0))
                + known.joint(kind, "rocker", "ground", "c", (0.3, 0, 0), axis=(0, 0, 1),
                                   limits=limits)
                + known.point("b_end", "b", (0.28, 0, 0))
                + known.point("c_end", "c", (0.24, 0, 0)))
        return known.load(tmp_path, name, tree, known.closure(
            "pin", "revolute", "b_end", "c_end") + known.driver("crank", "crank"))

    def rocker(mechanism, guess):
        state = sp.assemble(mechanism, {"crank": 0.4}, {"rocker": guess})
        return state.placement("c").rotation

    free, limited = four_bar("free", "continuous", None), four_bar("some", "revolute", limits)
    for guess in np.linspace(-12.0, 12.0, 41):
        assert rocker(limited, guess) == pytest.approx(rocker(free, guess), abs=1e-9)
