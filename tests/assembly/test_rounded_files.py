"""Overconstrained loops in rounded numbers: the freedoms, motions and forces that were meant.

The same file in full digits is the reference.
"""

import pickle
import warnings

import numpy as np
import pinocchio as pin
import pytest
import rounded
from folders import DATA
from mechanisms import from_text
from variety import first, paired

import spatial_pin as sp

SIDES = [0.2, 0.5, 0.45, 0.6]
LOOPS = {
    "four-bar": lambda r: rounded.plane(SIDES, r),
    "four-bar closed by a ball": lambda r: rounded.plane(SIDES, r, closure="spherical"),
    "five-bar": lambda r: rounded.plane([*SIDES, 0.3], r, drivers=2),
    "plane loop of seven": lambda r: rounded.plane([*SIDES, 0.3, 0.3, 0.2], r, drivers=4),
    "Bennett": rounded.bennett,
    "Bricard": rounded.bricard,
    "Sarrus": rounded.sarrus,
    **{f"{name}, exported": lambda r, name=name: rounded.exported(name, r)
       for name in ("peaucellier", "watt_six_bar", "geared_five_bar", "screw_press", "scotch_yoke",
                    "spherical_four_bar", "double_cardan")},
}
MOVED = ("four-bar", "Bennett", "Bricard", "Sarrus", "watt_six_bar, exported")
DIGITS = {"7 decimals": (rounded.to_digits(7), 1e-6), "6 decimals": (rounded.to_digits(6), 1e-5),
          "single precision": (rounded.to_float32, 1e-6)}
ALL_ROUNDED = pytest.mark.parametrize(("name", "digits"), paired([*LOOPS], [*DIGITS], (
    "four-bar closed by a ball", "five-bar", "Bennett", "Bricard", "Sarrus",
    "watt_six_bar, exported", "screw_press, exported")))
SOME = pytest.mark.parametrize("name", MOVED)
SOME_ROUNDED = pytest.mark.parametrize(("name", "digits"), paired(MOVED, [*DIGITS]))
pytestmark = pytest.mark.delicate


def both(name, digits):
    """Return the exact mechanism, the rounded one, and how far answers may be apart."""
    rounding, size = DIGITS[digits]
    return LOOPS[name](rounded.exactly), LOOPS[name](rounding), size


def assembled(mechanism, *args, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", sp.SpatialPinWarning)
        return sp.assemble(mechanism, *args, **options)


def values(state):
    return np.array([state.coordinate(c).value for c in state.mechanism.coordinates])


# ------------------------------------------------------------ closing


@ALL_ROUNDED
def test_a_rounded_loop_closes_where_the_exact_one_does(name, digits):
    exact, mechanism, size = both(name, digits)
    with pytest.warns(sp.SpatialPinWarning, match=r"equations? of .* hold to .*rounded"):
        state = sp.assemble(mechanism)
    assert state.closure_error < 1e-12
    assert 0.0 < state.gap < size
    assert np.abs(values(state) - values(sp.assemble(exact))).max() < 10.0 * size


@ALL_ROUNDED
def test_mobility_counts_as_of_the_exact_mechanism(name, digits):
    exact, mechanism, _ = both(name, digits)
    found, meant = sp.mobility(mechanism, assembled(mechanism)), sp.mobility(exact)
    for what in ("kutzbach", "grubler", "loops", "rank", "instantaneous", "dof"):
        assert getattr(found, what) == getattr(meant, what), what
    assert len(found.redundant) == len(meant.redundant)


def test_the_gap_is_reported_once_and_carried_by_the_state():
    mechanism = LOOPS["four-bar"](rounded.to_digits(6))
    with pytest.warns(sp.SpatialPinWarning, match="3 of 5 equations of 'last' hold to") as told:
        state = sp.assemble(mechanism)
    again = sp.assemble(mechanism, guess=state)  # silent, or warnings are errors here
    assert len(told) == 1
    assert state.gap == state.gap.closures["last"] == max(state.gap.closures.values())
    assert again.gap == pytest.approx(state.gap, abs=1e-13)
    assert f"gap {float(state.gap):.1e}" in repr(state)


def test_where_everything_closes_there_is_no_gap():
    state = sp.assemble(LOOPS["four-bar"](rounded.exactly))
    assert state.gap == 0.0 and not state.gap.closures
    assert state.mechanism.whole is None


def test_earlier_calls_make_no_difference():
    fresh, used = (LOOPS["Bricard"](rounded.to_digits(6)) for _ in range(2))
    first = assembled(used)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", sp.SpatialPinWarning)
        sp.assembly_modes(used, {"h0": 1.7})
        sp.sweep(used, "h0", [1.6, 1.7])
        assembled(used, {"h0": 1.75})
    assert np.array_equal(assembled(used).q, first.q)
    assert np.array_equal(assembled(fresh).q, first.q)


def test_a_state_of_another_load_and_a_pickled_one_serve_too():
    one, two = (LOOPS["four-bar"](rounded.to_digits(6)) for _ in range(2))
    state = assembled(one)
    for known in (state, pickle.loads(pickle.dumps(state))):
        rates = sp.solve_rates(two, known, {"h0": 1.0})
        assert np.array_equal(rates.v, sp.solve_rates(one, state, {"h0": 1.0}).v)
        assert rates.gap == state.gap


def test_the_published_five_bar_in_six_decimals_has_three_freedoms():
    urdf = (DATA / "rounded" / "five_bar.urdf").read_text()
    content = {"name": "five_bar", "tree": "five_bar", "closures": [
        {"name": "loop1", "type": "weld", "frames": ["closedloop1_A", "closedloop1_B"]}],
        "drivers": {"mot1": {"joint": "mot1"}, "mot2": {"joint": "mot2"}}}
    exact = sp.assemble(from_text(urdf, content, "five_bar"))
    six = from_text(rounded.rounded_text(urdf, rounded.to_digits(6)), content, "five_bar")
    with pytest.warns(sp.SpatialPinWarning, match="3 of 6 equations of 'loop1' hold to .* only"):
        state = sp.assemble(six)
    assert sp.mobility(six, state).dof == 3
    assert 1e-8 < state.gap < 1e-6
    assert np.abs(values(state) - values(exact)).max() < 1e-6


def slider_crank(gap):
    """A slider-crank in four digits, in two halves with a weld between: it just misses 1e-4."""
    urdf = (DATA / "rounded" / "slider_crank.urdf").read_text()
    return from_text(urdf, {
        "name": "slider_crank", "tree": "slider_crank", "drivers": {"crank": {"joint": "j0"}},
        "closures": [{"name": "coupler", "type": "weld", "frames": ["c0_weld_0", "c0_weld_1"]}],
        "gap": gap}, "slider_crank")


@pytest.mark.filterwarnings("ignore::spatial_pin.SpatialPinWarning")
def test_a_gap_that_is_just_too_small_is_named_though_another_branch_has_less():
    with pytest.raises(sp.AssemblyError, match=r"gap=[24]e-04\) leaves out redundant"):
        sp.assemble(slider_crank(1e-4))
    drawn = sp.assemble(slider_crank(4e-4))
    assert np.abs(drawn.q).max() < 1e-3
    wanted = sp.assemble(slider_crank(4e-4), {"crank": 0.28})
    assert wanted.coordinate("j2").value == pytest.approx(-0.046, abs=1e-3)
    with pytest.raises(sp.AssemblyError, match=r"beyond the gap of 1e-04 \(gap=2e-04 allows it"):
        sp.assemble(slider_crank(1.2e-4), {"crank": 0.28})


# ------------------------------------------------------------ wrong is not rounded


def bennett_off_by(error):
    """Return Bennett's loop with one link too long, relative."""
    good = rounded.bennett()
    text = good.urdf
    mark = text.index('name="link2"')  # the hinge after link 1
    at = text.index('xyz="', text.index("<joint", mark)) + 5
    end = text.index('"', at)
    longer = " ".join(repr(float(x) * (1.0 + error)) for x in text[at:end].split())
    return from_text(text[:at] + longer + text[end:], {
        "name": "off", "tree": "off", "guess": dict(good.guess), "drivers": {"h0": {"joint": "h0"}},
        "closures": [{"name": "last", "type": "revolute", "frames": ["start", "end"]}]}, "off")


def test_a_link_one_percent_too_long_is_refused_with_how_open_which_closure_is():
    with pytest.raises(sp.AssemblyError, match=r"closure 'last' stays open by .* m") as caught:
        sp.assemble(bennett_off_by(1e-2))
    assert 1e-4 < caught.value.closure_error < 1e-1
    assert caught.value.worst_closure == "last"


def test_the_threshold_is_an_argument_and_a_setting():
    off = bennett_off_by(1e-2)
    state = assembled(off, gap=1e-2)
    assert 1e-4 < state.gap < 1e-2
    same = assembled(bennett_off_by(1e-2), accuracy=sp.Accuracy(gap=1e-2))
    assert np.array_equal(same.q, state.q)
    near = LOOPS["four-bar"](rounded.to_digits(6))
    with pytest.raises(sp.AssemblyError, match="'last' stays open by"):
        sp.assemble(near, gap=0.0)
    with pytest.raises(ValueError, match="gap"):
        sp.Accuracy(gap=-1.0)


def test_the_state_carries_its_gap_on_into_motions():
    state = assembled(bennett_off_by(1e-2), gap=1e-2)
    whole = state.mechanism.whole
    h = state.coordinate("h0").value
    motion = sp.sweep(whole, "h0", [h, h + 0.1], guess=state)
    assert motion.closure_error.max() < 1e-12


def test_a_stretched_structure_that_does_not_quite_fit_is_no_rounded_mechanism():
    with pytest.raises(sp.AssemblyError, match="stays open by"):
        sp.assemble(stretched(1e-6))


def stretched(error):
    """Return a plane loop of four whose longest side is a little longer than all others."""
    return rounded.loop([*map(rounded.step, (0.2, 0.3, 0.4)), rounded.step(-(0.9 + error))],
                        [0.0, 0.0, 0.0])


@pytest.mark.parametrize("crank", [1e-3, 1e-4, 1e-5, 3e-6, 1e-6, 1e-7])
def test_cranks_that_are_next_to_nothing_are_no_rounding(crank):
    """A parallelogram whose cranks are so short that its equations nearly depend on each other."""
    steps = [rounded.step(x) for x in (crank, 1.0, crank, 1.0)]
    mechanism = rounded.loop(steps, [1.3, 1.9, 1.2], seed=1)
    state = sp.assemble(mechanism, {"h0": 1.2})
    assert state.gap == 0.0 and state.mechanism is mechanism
    assert state.closure_error < 1e-12


# ------------------------------------------------------------ moving


def span(name, state):
    h = state.coordinate(driver(state)).value
    return h + {"Bricard": np.linspace(0.0, 0.3, 31), "Sarrus": np.linspace(0.0, 0.4, 31),
                "watt_six_bar, exported": np.linspace(0.0, 0.4, 31)}.get(
                    name, np.linspace(0.0, 2.0 * np.pi, 181))


def driver(state):
    return next(iter(state.mechanism.drivers))


@SOME_ROUNDED
def test_sweeps_follow_the_exact_motion_without_a_jump(name, digits):
    exact, mechanism, size = both(name, digits)
    state = assembled(mechanism)
    wanted = span(name, sp.assemble(exact))
    found, meant = (sp.sweep(m, driver(state), wanted, speed=1.0) for m in (mechanism, exact))
    assert found.closure_error.max() < 1e-12
    assert max(found.state(k).gap for k in range(len(found))) < 20.0 * size
    for x, y in ((found.q, meant.q), (found.v, meant.v)):
        assert np.abs(x - y).max() < 200.0 * size * np.abs(y).max()
    bends = [np.abs(np.diff(m.q, 3, axis=0)).max() for m in (found, meant)]
    assert bends[0] < bends[1] + size
    assert {found.state(k).mechanism for k in range(len(found))} == {found.mechanism}


@pytest.mark.parametrize(("seed", "end"), first(2, [(1, 1.0), (23, -1.0), (6, 0.75)]))
def test_no_limit_stands_where_equations_near_the_guess_depend_on_each_other(seed, end):
    """Bricard's loops, in which no equations that may be left out serve all along a motion."""
    exact, found = (rounded.line_symmetric(seed, r)
                    for r in (rounded.exactly, rounded.to_digits(7)))
    assembled(found)
    meant, found = (sp.sweep(m, "h0", np.linspace(0.0, end, 76), speed=1.0) for m in (exact, found))
    assert found.closure_error.max() < 1e-12
    assert max(found.state(k).gap for k in range(76)) < 1e-5
    for x, y in ((found.q, meant.q), (found.v, meant.v)):
        assert np.abs(x - y).max() < 1e-4 * np.abs(y).max()


def test_rates_of_the_driver_are_those_given_where_other_equations_lead_further():
    """Those near the guess lead to sample 129 of 201, others all along."""
    loop = rounded.line_symmetric(20, rounded.to_digits(7))
    assembled(loop)
    motion = sp.sweep(loop, "h0", np.linspace(0.0, -2.0, 201), speed=-1.0, acceleration=0.5)
    assert np.array_equal(motion.driver_speed, np.full(201, -1.0))
    assert np.abs(motion.coordinate("h0").acceleration - 0.5).max() < 1e-9


def test_a_motion_on_which_no_equations_are_independent_ends_and_goes_on_from_there():
    """Rounding decides no more than that: the limit of the exact loop is far away."""
    exact, loop = (rounded.line_symmetric(13, r)
                   for r in (rounded.exactly, rounded.to_digits(7)))
    assembled(loop)
    values = np.linspace(0.0, 1.0, 101)
    first = sp.sweep(loop, "h0", values, on_limit="stop")
    assert first.events[-1].kind == "gap" and 0.5 < first.driver[-1] < 1.0
    with pytest.raises(sp.LimitError, match=r"no choice of its redundant equations .* guess="):
        sp.sweep(loop, "h0", values)
    rest = sp.sweep(loop, "h0", values[len(first):], guess=first.state(-1))
    meant = sp.sweep(exact, "h0", values)
    assert np.abs(np.vstack([first.q, rest.q]) - meant.q).max() < 1e-4


@SOME_ROUNDED
def test_rates_are_those_of_the_equations_that_hold(name, digits):
    exact, mechanism, size = both(name, digits)
    state = assembled(mechanism)
    drive = driver(state)
    found = sp.solve_rates(mechanism, state, {drive: 1.0}, {drive: 0.5})
    meant = sp.solve_rates(exact, sp.assemble(exact), {drive: 1.0}, {drive: 0.5})
    for x, y in ((found.v, meant.v), (found.a, meant.a)):
        assert np.abs(x - y).max() < 100.0 * size * max(np.abs(y).max(), 1.0)
    h, at = 1e-4, state.coordinate(drive).value
    ahead, behind = (assembled(mechanism, {drive: at + s * h}, guess=state) for s in (1.0, -1.0))
    slope = (values(ahead) - values(behind)) / (2.0 * h)
    assert np.abs(slope - found.v).max() < 1e-5 * np.abs(found.v).max()
    link = mechanism.links[-1]
    assert np.abs(sp.jacobian(mechanism, state, link)
                  - sp.jacobian(exact, sp.assemble(exact), link)).max() < 100.0 * size


@SOME
def test_modes_are_those_of_the_exact_mechanism(name):
    if name == "Sarrus":
        pytest.skip("half of its modes are crossings of branches, which rounding takes apart")
    exact, mechanism, size = both(name, "6 decimals")
    at = sp.assemble(exact)
    held = {driver(at): at.coordinate(driver(at)).value}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", sp.SpatialPinWarning)
        found = sp.assembly_modes(mechanism, held)
    meant = sp.assembly_modes(exact, held)
    assert len(found) == len(meant)
    for x, y in zip(found, meant, strict=True):
        assert 0.0 < x.gap < 20.0 * size
        assert np.abs(values(x) - values(y)).max() < 20.0 * size


def test_modes_of_several_groups_of_rounded_loops_are_those_of_the_exact_ones():
    exact, mechanism = (rounded.exported("excavator", r) for r in (
        rounded.exactly, rounded.to_digits(6)))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", sp.SpatialPinWarning)
        found, meant = (sp.assembly_modes(m, most_starts=300) for m in (mechanism, exact))
    assert len(found) == len(meant) > 1
    for x, y in zip(found, meant, strict=True):
        assert 0.0 < x.gap < 2e-4
        assert np.abs(values(x) - values(y)).max() < 2e-4


# ------------------------------------------------------------ forces


@SOME_ROUNDED
def test_dynamics_are_those_of_the_exact_mechanism(name, digits):
    exact, mechanism, size = both(name, digits)
    states = [sp.solve_rates(m, assembled(m), {driver(assembled(m)): 1.0})
              for m in (mechanism, exact)]
    found, meant = (sp.forward_dynamics(m, s)
                    for m, s in zip((mechanism, exact), states, strict=True))
    assert np.abs(found.a - meant.a).max() < 300.0 * size * max(np.abs(meant.a).max(), 1.0)
    assert found.determined == meant.determined
    largest = max(np.abs(f.vector).max() for f in meant.reactions.values())
    assert set(found.reactions) == set(meant.reactions)
    for pair, force in meant.reactions.items():
        assert np.abs(found.reactions[pair].vector - force.vector).max() < 300.0 * size * largest
    efforts = [sp.inverse_dynamics(m, s).efforts
               for m, s in zip((mechanism, exact), states, strict=True)]
    for key, effort in efforts[1].items():
        assert abs(efforts[0][key] - effort) < 300.0 * size * max(abs(effort), 1.0)


def test_kinetostatics_along_a_motion_are_those_of_the_exact_mechanism():
    exact, mechanism, size = both("four-bar", "6 decimals")
    at = assembled(mechanism).coordinate("h0").value
    turn = at + np.linspace(0.0, 6.0, 25)
    found, meant = (sp.kinetostatics(m, sp.sweep(m, "h0", turn, speed=2.0))
                    for m in (mechanism, exact))
    assert np.abs(found.efforts["h0"] - meant.efforts["h0"]).max() < 1e3 * size
    assert {k: v.tolist() for k, v in found.determined.items()} == {
        k: v.tolist() for k, v in meant.determined.items()}


@pytest.mark.parametrize("name", ["four-bar", "Bennett", "Bricard"])
def test_simulations_keep_their_energy_and_follow_the_exact_one(name):
    exact, mechanism, size = both(name, "6 decimals")
    times = np.linspace(0.0, 1.0, 11)
    found, meant = (sp.simulate(m, sp.solve_rates(m, assembled(m), {"h0": 1.0}), 1.0, times=times)
                    for m in (mechanism, exact))
    assert found.energy_drift < 1e-9
    assert np.abs(found.q - meant.q).max() < 100.0 * size
    assert max(found.state(k).gap for k in range(11)) < 20.0 * size


@pytest.mark.filterwarnings("ignore::spatial_pin.SpatialPinWarning")
def test_limits_and_settings_of_a_rounded_four_bar_are_those_of_the_exact_one():
    exact, found = (rounded.exported("four_bar", rounding)
                    for rounding in (rounded.exactly, rounded.to_digits(6)))
    wanted, ends = (sp.limits(m, "rocker_pin") for m in (exact, found))
    assert [e.kind for e in (ends.lower, ends.upper)] == ["limit", "limit"]
    np.testing.assert_allclose([ends.lower.value, ends.upper.value],
                               [wanted.lower.value, wanted.upper.value], rtol=0.0, atol=1e-5)
    curve = sp.trace(found, "rocker_pin", step=0.1)
    assert curve.closure_error.max() < 1e-12 and curve.mechanism.whole is found
    task = {"driver": "crank", "values": np.linspace(0.0, 1.0, 5)}
    assert sp.tradeoff(found, task, settings=[sp.Accuracy()], repeats=1).rows[0].error < 1e-9


@pytest.mark.filterwarnings("ignore::spatial_pin.SpatialPinWarning")
def test_what_rounded_numbers_cannot_have_is_refused_in_words():
    mechanism = rounded.exported("four_bar", rounded.to_digits(6))
    state = sp.assemble(mechanism, {"crank": 0.5})
    with pytest.raises(sp.SpatialPinError, match=r"numbers are rounded .* write more digits"):
        sp.dynamics_derivatives(mechanism, state)


@pytest.mark.parametrize(("seed", "rate", "digits"), [
    (1, 1.0, 7), pytest.param(109, 1.0, 8, marks=pytest.mark.slow),
    pytest.param(6, 1.0, 7, marks=pytest.mark.slow),
    pytest.param(23, -1.0, 7, marks=pytest.mark.slow),
    pytest.param(110, 1.0, 9, marks=pytest.mark.slow)])
def test_a_simulation_goes_on_where_its_equations_become_dependent(seed, rate, digits):
    """With others: no choice is independent on all of the motion. Few samples or many."""
    exact, loop = (rounded.line_symmetric(seed, r)
                   for r in (rounded.exactly, rounded.to_digits(digits)))
    start = sp.solve_rates(loop, assembled(loop), {"h0": rate})
    for n in (7, 121):
        times = np.linspace(0.0, 3.0, n)
        meant = sp.simulate(exact, sp.solve_rates(exact, sp.assemble(exact), {"h0": rate}), 3.0,
                            times=times)
        found = sp.simulate(loop, start, 3.0, times=times)
        assert len(found) == n and not found.events
        assert np.abs(found.q - meant.q).max() < 1e-4
        assert found.energy_drift < 1e-8  # energy stays where equations are chosen
        assert found.closure_error.max() < 1e-12
        assert max(float(found.state(k).gap) for k in range(n)) < 100.0 * 10.0**-digits


def test_a_simulation_ends_where_a_rounded_file_contradicts_itself():
    """Four digits: equations open beyond the gap on the way, whichever of them are chosen."""
    loop = rounded.line_symmetric(678015, rounded.to_digits(4))
    start = sp.solve_rates(loop, assembled(loop), {"h0": 1.0})
    motion = sp.simulate(loop, start, 3.0, times=np.linspace(0.0, 3.0, 121))
    assert 5 < len(motion) < 121
    assert [e.kind for e in motion.events] == ["gap"] and "gap=" in motion.events[0].text


def test_a_simulation_of_a_file_that_contradicts_itself_before_the_first_sample():
    loop = rounded.line_symmetric(678015, rounded.to_digits(4))
    start = sp.solve_rates(loop, assembled(loop), {"h0": 1.0})
    with pytest.raises(sp.SingularError, match=r"beyond the gap of .*gap="):
        sp.simulate(loop, start, 3.0, times=[2.9, 3.0])


@pytest.mark.filterwarnings("ignore::spatial_pin.SpatialPinWarning")
def test_forces_from_outside_are_asked_for_once_in_each_sample():
    loop = rounded.bennett(rounded.to_digits(7))
    motion = sp.sweep(loop, "h0", np.linspace(0.0, 0.2, 5), speed=1.0)
    asked, link = [], loop.links[1]

    def external(t, state):
        asked.append(t)
        return {link: pin.Force(np.array([1.0, 2.0, 3.0]), np.zeros(3))}

    loads = sp.inverse_dynamics(loop, motion, external=external)
    assert asked == motion.time.tolist()
    for k in range(5):
        found = sp.inverse_dynamics(loop, motion.state(k), external=external(0.0, None))
        assert loads.efforts["h0"][k] == pytest.approx(found.efforts["h0"], rel=1e-9)
