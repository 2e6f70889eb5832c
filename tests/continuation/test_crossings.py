"""Change points near each other, or where the loops hardly lose rank: followed straight on.

The delta robot: its rods are parallelograms, which keep the platform level. Where the three axes
that they let it turn about, each normal to its rods and its shoulder, lie in one plane, it may
turn: branches cross. Two such places are 0.03 to 0.2 rad apart.
"""

from functools import cache, partial

import closed_forms
import mechanisms as known
import numpy as np
import pytest
from ladders import ladder
from loaded_library import library
from machines import ROD, arms, change_points, delta
from masses import heavy
from variety import few, paired

import spatial_pin as sp

HELD = [(0.0, 0.0), (-0.1, 0.2), (-0.2, 0.3), (0.3, -0.3)]  # arms 2 and 3 [rad]
HELD_IDS = ["level", "little", "more", "opposite"]
EVERY_HELD = pytest.mark.parametrize("held", [
    pytest.param(held, id=name, marks=() if name == "more" else pytest.mark.slow)
    for held, name in zip(HELD, HELD_IDS, strict=True)])
pytestmark = pytest.mark.delicate
LEADS = [0.05, 0.03, 0.01, 3e-3, 1e-3, 1e-4]  # of the second parallelogram's cranks [rad]
TURN = 2 * np.pi


def off(angle, exact) -> float:
    """The largest difference of angles, turns apart [rad]."""
    return float(np.abs((np.asarray(angle) - exact + np.pi) % TURN - np.pi).max())


# ---------------------------------------------------------------- the delta robot


@cache
def robot() -> sp.Mechanism:
    return library("delta")


def beyond(held: tuple[float, float]) -> sp.State:
    """The level platform behind both change points, where the closed form has it."""
    home = sp.assemble(robot(), {"arm_1": 0.0, "arm_2": 0.0, "arm_3": 0.0}).q[:3]
    level = delta(2.7, others=held).links["platform"][:3, 3].astype(float)
    zero = delta(0.0, others=(0.0, 0.0)).links["platform"][:3, 3].astype(float)
    guess = {"pose": [*(home + level - zero), 0.0, 0.0, 0.0], "arm_1": 2.7, **arms(held)}
    state = sp.assemble(robot(), {"arm_1": 2.7, **arms(held)}, guess)
    np.testing.assert_allclose(state.placement("platform").translation, level, atol=1e-12)
    return state


@EVERY_HELD
def test_the_delta_robot_has_two_change_points(held):
    first, second = change_points(held)
    assert 0.03 < second - first < 0.21


@pytest.mark.parametrize(("held", "rows"), [
    pytest.param(held, rows, marks=() if case in {("level", 2), ("more", 3000)} else
                 pytest.mark.slow)
    for held, name in zip(HELD, HELD_IDS, strict=True) for rows in (2, 23, 3000)
    for case in [(name, rows)]])
def test_the_delta_robot_stays_level_at_its_change_points(held, rows):
    """With few rows, followed one by one, as with many, followed together."""
    values = np.linspace(1.4, 2.7, rows)
    motion = sp.sweep(robot(), "arm_1", values, hold=arms(held))
    assert [e.kind for e in motion.events] == ["branch point"] * 2
    np.testing.assert_allclose([e.value for e in motion.events], change_points(held), atol=1e-11)
    for event in motion.events:
        assert values[event.row - 1] < event.value <= values[event.row]
        assert "straight on" in event.text
    platform = motion.frame("platform")
    for k in range(0, rows, max(rows // 10, 1)):
        rate = closed_forms.rates(partial(delta, others=held), values[k], 1.0, 0.0)
        for found, exact, tolerance in zip(
                (platform.position, platform.velocity, platform.acceleration), rate,
                (1e-12, 1e-9, 2e-6), strict=True):
            exact = exact.links["platform"][:3, 3].astype(float)
            np.testing.assert_allclose(found[k], exact, atol=tolerance)
    assert np.abs(platform.rotation - np.eye(3)).max() < 1e-11
    assert np.abs(platform.angular_velocity).max() < 1e-8
    assert motion.closure_error.max() < 1e-12


@EVERY_HELD
def test_the_delta_robot_comes_back_over_its_change_points(held):
    first, second = change_points(held)
    middle = 0.5 * (first + second)
    values = [2.7, middle, 2.7, 1.5, middle, 1.4]
    motion = sp.sweep(robot(), "arm_1", values, guess=beyond(held))
    np.testing.assert_allclose([e.value for e in motion.events],
                               [second, second, second, first, first, first], atol=1e-11)
    assert [e.row for e in motion.events] == [1, 2, 3, 3, 4, 5]
    exact = [delta(x, others=held).links["platform"][:3, 3].astype(float) for x in values]
    np.testing.assert_allclose(motion.frame("platform").position, exact, atol=1e-12)


@EVERY_HELD
def test_limits_of_the_delta_robot_end_at_its_change_points(held):
    for place, bound in ((1.0, "upper"), (2.0, "upper"), (2.7, "lower")):
        start = beyond(held) if place == 2.7 else {"arm_1": place, **arms(held)}
        end = getattr(sp.limits(robot(), "arm_1", start), bound)
        assert end.kind == "branch point"
        assert end.value == pytest.approx(change_points(held)[bound == "lower"], abs=5e-9)


def test_the_traced_delta_robot_passes_its_change_points():
    motion = sp.trace(robot(), "arm_1", {"arm_1": 2.0, **arms(HELD[0])}, step=0.1, most_rows=120)
    kinds = [e.kind for e in motion.events]
    assert kinds == ["branch point", "branch point", "limit", "not closed"]
    np.testing.assert_allclose([e.value for e in motion.events[:2]], change_points(HELD[0]),
                               atol=5e-9)
    at = int(np.argmin(np.abs(motion.driver - 2.8)))
    exact = delta(motion.driver[at], others=HELD[0]).links["platform"][:3, 3].astype(float)
    np.testing.assert_allclose(motion.frame("platform").position[at], exact, atol=1e-11)


# ---------------------------------------------------------------- two parallelograms in a row

VALUES = [[2.9, 3.3], np.linspace(2.5, 3.6, 12), np.linspace(0.5, 5.9, 7),
          np.linspace(5.9, 0.3, 400), [3.0, 3.0001, 3.3, 2.9]]
MADE = pytest.mark.parametrize("lead", few(LEADS, 0.03, 1e-4))
MADE_AND_FOLLOWED = pytest.mark.parametrize(("lead", "values"), paired(LEADS, VALUES))


def flat(first: float, last: float, lead: float) -> list[float]:
    """Where either of two parallelograms lies flat between two angles of the crank, in order."""
    found = sorted(x for k in range(-1, 4) for x in (k * np.pi, k * np.pi - lead)
                   if min(first, last) < x < max(first, last))
    return found if last > first else found[::-1]


def start(crank: float, lead: float) -> dict[str, float]:
    return {"crank_pin": crank, "rocker_pin": crank, "out_pin": crank + lead}


@MADE_AND_FOLLOWED
@pytest.mark.parametrize("second", few([0.1, 0.02], 0.02))
def test_two_parallelograms_in_a_row_go_straight_on_one_after_the_other(
        tmp_path, lead, values, second):
    mech = known.two_parallelograms(tmp_path, lead, second)
    motion = sp.sweep(mech, "crank", values, guess=start(values[0], lead))
    assert off(motion.coordinate("rocker_pin").value, motion.driver) < 1e-10
    assert off(motion.coordinate("out_pin").value, motion.driver + lead) < 1e-10
    expected = [x for k in range(1, len(values)) for x in flat(values[k - 1], values[k], lead)]
    np.testing.assert_allclose([e.value for e in motion.events], expected, atol=1e-11)
    for event in motion.events:
        low, high = sorted(values[event.row - 1 : event.row + 1])
        assert low < event.value < high


@pytest.mark.parametrize("values", VALUES)
def test_change_points_too_near_to_be_distinguished_are_passed_as_one(tmp_path, values):
    lead = 1e-6
    mech = known.two_parallelograms(tmp_path, lead)
    motion = sp.sweep(mech, "crank", values, guess=start(values[0], lead))
    assert off(motion.coordinate("out_pin").value, motion.driver + lead) < 1e-10
    expected = [x for k in range(1, len(values)) for x in flat(values[k - 1], values[k], lead)]
    middles = 0.5 * (np.array(expected[::2]) + expected[1::2])
    np.testing.assert_allclose([e.value for e in motion.events], middles, atol=1e-6)


@MADE_AND_FOLLOWED
def test_the_first_of_two_change_points_is_refused_where_that_is_requested(
        tmp_path, lead, values):
    mech = known.two_parallelograms(tmp_path, lead)
    motion = sp.sweep(mech, "crank", values, guess=start(values[0], lead), on_crossing="stop")
    met = next(x for k in range(1, len(values)) for x in flat(values[k - 1], values[k], lead))
    assert [e.kind for e in motion.events] == ["branch point"]
    assert motion.events[0].value == pytest.approx(met, abs=1e-9)


@MADE
def test_limits_of_two_parallelograms_are_the_nearest_change_points(tmp_path, lead):
    mech = known.two_parallelograms(tmp_path, lead)
    found = sp.limits(mech, "crank", start(1.0, lead))
    assert found.lower.value == pytest.approx(0.0, abs=1e-9)
    assert found.upper.value == pytest.approx(np.pi - lead, abs=1e-9)


@MADE
def test_traced_parallelograms_pass_four_change_points(tmp_path, lead):
    mech = known.two_parallelograms(tmp_path, lead)
    motion = sp.trace(mech, "crank", start(1.0, lead))
    assert motion.driver[-1] == pytest.approx(1.0 + TURN, abs=1e-12)
    assert off(motion.coordinate("out_pin").value, motion.driver + lead) < 1e-10
    assert [e.kind for e in motion.events] == ["branch point"] * 4
    np.testing.assert_allclose([e.value for e in motion.events], flat(1.0, 1.0 + TURN, lead),
                               atol=1e-9)


def uniform(mass: float, length: float) -> tuple:
    inertia = mass * length**2 / 12
    return mass, (0.5 * length, 0, 0), (0.0, inertia, inertia)


@pytest.mark.parametrize(("lead", "second"), paired([0.3, 0.05, 1e-3], [0.1, 0.02]))
def test_two_parallelograms_thrown_turn_at_a_constant_pace(tmp_path, lead, second):
    """Their inertia is the same in all positions, and no weight turns them."""
    def weigh(tree):
        return heavy(tree, crank=uniform(1.0, 0.1), rocker=uniform(1.0, 0.1),
                     coupler=uniform(0.5, 0.3), link=uniform(0.4, 0.3), out=uniform(0.7, second))

    mech = known.two_parallelograms(tmp_path, lead, second, weigh)
    state = sp.assemble(mech, {"crank": 1.0}, start(1.0, lead))
    motion = sp.simulate(mech, sp.solve_rates(mech, state, {"crank": 3.0}), 3.0)
    exact = 1.0 + 3.0 * motion.time
    assert np.abs(motion.coordinate("crank").value - exact).max() < 1e-7
    assert off(motion.coordinate("rocker_pin").value, exact) < 1e-7
    assert off(motion.coordinate("out_pin").value, exact + lead) < 1e-7
    rows = [int(np.searchsorted(exact, x)) for x in flat(1.0, 10.0, lead)]
    assert [e.kind for e in motion.events] == ["branch point"] * len(rows)
    assert np.abs(np.array([e.row for e in motion.events]) - rows).max() <= 1


# ---------------------------------------------------------------- chains that go flat together

CHAIN = pytest.mark.parametrize("windows", few([5, 10, 40], 5))


def upright(mech, angle):
    """All rods parallel, couplers level."""
    return {c: angle if c.startswith("p") else -angle for c in mech.coordinates}


def level(first, last):
    """Where a chain lies flat between two angles of its rods, in order."""
    places = (np.arange(-12, 12) + 0.5) * np.pi
    found = places[(places > min(first, last)) & (places < max(first, last))]
    return found if last > first else found[::-1]


def rods(motion):
    return np.array([motion.coordinate(c).value for c in motion.mechanism.coordinates
                     if c.startswith("p")])


@CHAIN
@pytest.mark.parametrize("values", [[0.5, 7.0], np.linspace(-1.0, -8.0, 30),
                                    np.linspace(0.5, 7.0, 361), [1.4, 1.6, 1.5, 1.65]],
                         ids=["one step", "few", "many", "to and fro"])
def test_windows_that_go_flat_together_go_straight_on(tmp_path, windows, values):
    """As many equations are lost at one place as there are windows: one event, in its place."""
    mech = ladder(tmp_path, windows)
    motion = sp.sweep(mech, "p0", values, guess=upright(mech, values[0]))
    assert np.abs(rods(motion) - motion.driver).max() < 1e-11
    expected = [x for k in range(1, len(values)) for x in level(values[k - 1], values[k])]
    assert {e.kind for e in motion.events} == {"branch point"}
    np.testing.assert_allclose([e.value for e in motion.events], expected, atol=1e-11)


@CHAIN
@pytest.mark.parametrize("accuracy", ["draft", "engineering"])
def test_windows_thrown_through_their_flat_positions_meet_each_once(
        tmp_path, windows, accuracy):
    mech = ladder(tmp_path, windows)
    start = sp.solve_rates(mech, sp.assemble(mech, {"p0": 0.0}), {"p0": -5.0})
    motion = sp.simulate(mech, start, 2.0, accuracy=sp.Accuracy.named(accuracy))
    angles = rods(motion)
    assert np.ptp(angles, axis=0).max() < 1e-11
    assert motion.closure_error.max() < 1e-14  # none is left out of the equations that are solved
    assert {e.kind for e in motion.events} == {"branch point"}
    met = sorted(abs(e.value) for e in motion.events)  # told as the angle of any of the joints
    np.testing.assert_allclose(met, np.abs(level(0.0, angles[0, -1])), atol=1e-9)
    assert len(met) > 1


@pytest.mark.parametrize("windows", few([120, 400], 120))
def test_hundreds_of_windows_thrown_through_a_flat_position_meet_it_once(tmp_path, windows):
    """Their determinant falls there below the smallest number there is."""
    mech = ladder(tmp_path, windows)
    start = sp.solve_rates(mech, sp.assemble(mech, {"p0": 1.0}, upright(mech, 1.0)),
                           {"p0": 5.0})
    motion = sp.simulate(mech, start, 0.2, accuracy=sp.Accuracy.named("draft"))
    assert np.ptp(rods(motion), axis=0).max() < 1e-10
    assert [e.kind for e in motion.events] == ["branch point"]
    assert abs(motion.events[0].value) == pytest.approx(np.pi / 2, abs=1e-9)


@CHAIN
def test_limits_and_trace_of_windows_that_go_flat_together(tmp_path, windows):
    """A step of arc length moves every one of the many joints by a small part of it only."""
    mech = ladder(tmp_path, windows)
    found = sp.limits(mech, "p0", upright(mech, 0.3))
    assert (found.lower.kind, found.upper.kind) == ("branch point",) * 2
    assert found.lower.value == pytest.approx(-np.pi / 2, abs=1e-9)
    assert found.upper.value == pytest.approx(np.pi / 2, abs=1e-9)
    motion = sp.trace(mech, "p0", upright(mech, 0.3), step=0.1)
    assert motion.driver[-1] == pytest.approx(0.3 + TURN, abs=1e-12)
    assert np.diff(motion.driver)[-1] < 0.1
    np.testing.assert_allclose([e.value for e in motion.events], level(0.3, 0.3 + TURN), atol=1e-9)


def test_the_traced_sarrus_linkage_comes_round():
    """Five joints and a platform share the arc length: after three steps it had seemed back."""
    motion = sp.trace(library("sarrus"), "arm", step=0.2)
    assert motion.driver[-1] - motion.driver[0] == pytest.approx(TURN, abs=1e-12)
    met = [0.5 * np.pi * k for k in (1, 2, 3, 4)]
    np.testing.assert_allclose([e.value for e in motion.events], met, atol=1e-8)


# ---------------------------------------------------------------- simulations and sweeps


@pytest.mark.parametrize("thrown", [
    lambda _: library("four_bar", r1=0.3, r2=0.1, r3=0.3, r4=0.1),  # parallelogram
    lambda _: library("four_bar", r1=0.3, r2=0.1, r3=0.1, r4=0.3),  # kite
    lambda _: library("four_bar", r1=0.1, r2=0.25, r3=0.15, r4=0.3),  # flat once a turn
    partial(ladder, n=5), lambda _: library("sarrus")],
    ids=["parallelogram", "kite", "flat once", "windows", "sarrus"])
def test_simulations_pass_branch_points_where_sweeps_do(tmp_path, thrown):
    """Two engines, the kernel in simulations and Python in sweeps, are on one smooth branch."""
    mech = thrown(tmp_path)
    driver = next(iter(mech.drivers), "p0")
    begin = {driver: 0.3 if driver == "p0" else 1.0}
    state = sp.solve_rates(mech, sp.assemble(mech, begin), {driver: -5.0})
    motion = sp.simulate(mech, state, 2.0)
    leading = motion.events[0].text.split()[3]  # the independent coordinate
    led = motion.coordinate(leading)
    swept = sp.sweep(mech, leading, led.value, guess=state, hold=None)
    assert np.abs(motion.q - swept.q).max() < 1e-11
    assert np.abs(motion.v - led.rate[:, None] * swept.v).max() < 1e-10 * np.abs(motion.v).max()
    assert {e.kind for e in motion.events} == {"branch point"}
    assert [e.row for e in motion.events] == [e.row for e in swept.events]
    np.testing.assert_allclose([e.value for e in motion.events], [e.value for e in swept.events],
                               rtol=0, atol=1e-11)


def plate_on_cranks(folder, feet) -> sp.Mechanism:
    """A plate on equal parallel cranks, which turn alike."""
    tree = known.turning("a0", "ground", "rod_0")
    tree += known.turning("top", "rod_0", "plate", (0.6, 0, 0))
    toml = "gravity = [0.0, -9.81, 0.0]\n" + known.driver("a0", "a0")
    for k, (x, y) in enumerate(feet, 1):
        tree += known.turning(f"a{k}", "ground", f"rod_{k}", (x, y, 0))
    rods = {f"rod_{k}": ROD for k in range(len(feet) + 1)}
    tree = heavy(tree, plate=(1.0, (0.4, 0.2, 0), (1e-3, 1e-2, 1e-2)), **rods)
    for k, (x, y) in enumerate(feet, 1):
        tree += known.point(f"end_{k}", f"rod_{k}", (0.6, 0, 0))
        tree += known.point(f"corner_{k}", "plate", (x, y, 0))
        toml += known.closure(f"pin_{k}", "revolute", f"end_{k}", f"corner_{k}")
    return known.load(folder, "plate_on_cranks", tree, toml)


@pytest.mark.parametrize(("feet", "speed"), paired([
    [(1.0, 0.0), (0.4, 0.7)], [(0.6, 0.5), (1.1, -0.2), (1.7, 0.7), (0.9, 1.2)],
    [(-0.8, 1e-5), (-0.4, -1e-4), (-1.2, -1e-3), (-0.9, -8e-4)],
    [(-0.97, 0.0), (-0.14, 1e-5), (0.32, 1e-6), (1.19, 1e-5)]], [15.0, -19.0]))
def test_cranks_that_line_up_beside_others_are_no_branch_point(tmp_path, feet, speed):
    """Each two of them line up in turn, where other equations are chosen: the others lead on."""
    mech = plate_on_cranks(tmp_path, feet)
    names = [f"a{k}" for k in range(len(feet) + 1)]
    state = sp.assemble(mech, guess={"top": -0.3} | dict.fromkeys(names, 0.3))
    state = sp.solve_rates(mech, state, {"a0": speed})
    thrown = sp.simulate(mech, state, 1.0)
    angle = thrown.coordinate("a0").value
    assert np.ptp(angle) > TURN
    for motion in (thrown, sp.sweep(mech, "a0", angle, guess=state)):
        assert not motion.events
        for name in names[1:]:
            assert np.abs(motion.coordinate(name).value - angle).max() < 1e-9


# ---------------------------------------------------------------- parallelograms, all but exactly


@pytest.mark.parametrize(("excess", "values"), paired(
    [1e-2, 1e-3, 1e-4, 1e-6, 1e-8, 1e-10],
    [[2.9, 3.3], np.linspace(1.0, 4.0, 10), np.linspace(1.0, 4.0, 301),
     np.linspace(1.0, 5.5, 3000)]))
def test_a_coupler_a_little_too_long_leads_to_the_crossed_linkage(tmp_path, excess, values):
    """No branches cross: the rocker stays on its side of the line from crank to rocker pin."""
    mech = known.bare_four_bar(tmp_path, 0.3, 0.1, 0.3 + excess, 0.1)
    x, y = 0.1 * np.cos(values) - 0.3, 0.1 * np.sin(values)
    cosine = (0.01 + x * x + y * y - (0.3 + excess) ** 2) / (0.2 * np.hypot(x, y))
    exact = np.arctan2(y, x) - np.arccos(cosine)
    motion = sp.sweep(mech, "crank", values, guess={"rocker_pin": exact[0]})
    assert off(motion.coordinate("rocker_pin").value, exact) < max(1e-11, 1e-15 / excess)
    assert not [e for e in motion.events if e.kind != "near limit"]


@pytest.mark.parametrize(("lack", "rows"), paired(
    [1e-2, 1e-3, 1e-4, 1e-6, 1e-8, 1e-10], [2, 10, 301, 3000]))
def test_a_coupler_a_little_too_short_has_a_limit(tmp_path, lack, rows):
    """Where coupler and rocker are in line, just before the crank is."""
    mech = known.bare_four_bar(tmp_path, 0.3, 0.1, 0.3 - lack, 0.1)
    limit = 2 * np.arcsin(np.sqrt(((0.4 - lack) ** 2 - 0.04) / 0.12))
    with pytest.raises(sp.LimitError) as caught:
        sp.sweep(mech, "crank", np.linspace(1.0, 4.0, rows), guess={"rocker_pin": 1.0})
    # a closure residual r moves it by about r / sqrt(lack)
    assert caught.value.limit == pytest.approx(limit, abs=max(1e-11, 1e-13 / np.sqrt(lack)))


# ---------------------------------------------------------------- Sarrus' linkage


@pytest.mark.parametrize("values", [[0.1, -0.1], [0.3, -0.2], [0.1, 0.101, -0.1], [1.5, 1.6, 1.5]])
def test_a_first_step_over_a_crossing_is_noticed(tmp_path, values):
    """Where two independent equations are lost at once the determinant keeps its sign."""
    mech = known.sarrus(tmp_path)
    guess = {"a_low": values[0], "a_mid": np.pi - 2 * values[0], "a_top": values[0] - np.pi,
             "b_low": values[0], "b_mid": np.pi - 2 * values[0]}
    motion = sp.sweep(mech, "arm", values, guess=guess)
    assert off(motion.coordinate("b_mid").value, np.pi - 2 * motion.driver) < 1e-11
    met = [np.pi / 2] * 2 if values[0] > 1 else [0.0]
    np.testing.assert_allclose([e.value for e in motion.events], met, atol=1e-11)


def test_sarrus_thrown_through_its_flat_positions_moves_as_it_is_swept():
    """Two equations are lost there; the links pass each other, the platform does not turn."""
    mech = library("sarrus")
    state = sp.solve_rates(mech, sp.assemble(mech), {"arm": -20.0})
    motion = sp.simulate(mech, state, 0.5)
    arm = motion.coordinate("arm")
    swept = sp.sweep(mech, "arm", arm.value, guess=state, speed=arm.rate)
    assert arm.value[-1] < -np.pi
    assert np.abs(motion.q - swept.q).max() < 1e-10
    assert np.abs(motion.v - swept.v).max() < 1e-7
    assert np.abs(motion.frame("platform").rotation - np.eye(3)).max() < 1e-11
    crossings = [e for e in motion.events if e.kind == "branch point"]
    assert len(crossings) >= 3
    assert [e.row for e in crossings] == [e.row for e in swept.events]


# ---------------------------------------------------------------- couplers that are rods


def rod_with_balls(folder, resolved: str) -> sp.Mechanism:
    """A parallelogram whose coupler spins about its line."""
    tree = (known.turning("crank_pin", "ground", "crank")
            + known.turning("rocker_pin", "ground", "rocker", (0.3, 0, 0))
            + known.floating("ball", "crank", "rod", (0.1, 0, 0))
            + known.point("tip", "rod", (0.3, 0, 0.05))
            + known.point("end", "rocker", (0.1, 0, 0.05)))
    return known.load(folder, "rod_with_balls", tree, known.refine("ball", "spherical")
                      + known.driver("crank", "crank_pin")
                      + known.closure("socket", "spherical", "tip", "end") + resolved)


def distance(folder) -> sp.Mechanism:
    """A parallelogram whose coupler is one equation."""
    tree = (known.turning("crank_pin", "ground", "crank")
            + known.turning("rocker_pin", "ground", "rocker", (0.3, 0, 0))
            + known.point("a", "crank", (0.1, 0, 0)) + known.point("b", "rocker", (0.1, 0, 0)))
    return known.load(folder, "distance", tree, known.driver("crank", "crank_pin")
                      + known.closure("coupler", "distance", "a", "b", length=0.3))


@pytest.mark.parametrize("make", [
    lambda folder: rod_with_balls(folder, '[passive.spin]\nbody = "rod"\naxis = ["ball", "tip"]\n'),
    lambda folder: rod_with_balls(folder, ""), distance],
    ids=["no spin", "least motion", "one equation"])
@pytest.mark.parametrize("rows", [2, 9, 300])
def test_a_parallelogram_with_a_rod_goes_straight_on(tmp_path, make, rows):
    motion = sp.sweep(make(tmp_path), "crank", np.linspace(1.0, 3.8, rows),
                      guess={"crank_pin": 1.0, "rocker_pin": 1.0})
    assert off(motion.coordinate("rocker_pin").value, motion.driver) < 1e-11
    np.testing.assert_allclose([e.value for e in motion.events], [np.pi], atol=1e-11)


@pytest.mark.parametrize("mode", [0, 1])
def test_accelerations_beside_a_change_point_are_those_of_the_configuration(mode):
    """Of a driver that speeds up, on the parallelogram and on the branch that crosses it."""
    mech = sp.load("four_bar", r1=0.3, r2=0.1, r3=0.3, r4=0.1)
    t = np.linspace(0.0, 1.0, 41)
    crank = 2.9 + 1.2 * t - 0.5 * t**2 + 0.3 * np.sin(3.0 * t)
    guess = sp.assembly_modes(mech, {"crank": crank[0]})[mode]
    motion = sp.follow(mech, {"crank": crank}, t, guess=guess)
    (event,) = motion.events
    near = [k for k in range(event.row - 3, event.row + 3) if abs(crank[k] - np.pi) > 5e-3]
    assert len(near) == 6
    at = mech.driven_coordinate("crank").v
    for k in near:
        rates = sp.solve_rates(mech, motion.state(k), {"crank": motion.v[k, at]},
                               {"crank": motion.a[k, at]})
        assert motion.a[k] == pytest.approx(rates.a, abs=1e-7)
