"""A sweep in one call of the kernel is the one that is assembled first and followed then."""

import mechanisms
import numpy as np
import pytest
from loaded_library import library
from variety import each

import spatial_pin as sp
from spatial_pin.continuation import path_following as following
from spatial_pin.continuation.path_tracker import PathTracker

FIELDS = ("q", "v", "a", "closure_error", "angles", "driver", "driver_speed", "time")


@pytest.fixture
def one_by_one(monkeypatch):
    """Return a function that sweeps by an assembly and a path of its own."""

    def swept(*arguments, **options):
        with monkeypatch.context() as other:
            other.setattr(PathTracker, "from_guess", lambda *all_of_it: None)
            return sp.sweep(*arguments, **options)

    return swept


@pytest.fixture
def told(monkeypatch):
    """Return a list of how many samples each sweep has got at once; None where it could not."""
    counts, from_guess = [], PathTracker.from_guess

    def asked(*arguments):
        begun = from_guess(*arguments)
        counts.append(None if begun is None else begun[2])
        return begun

    monkeypatch.setattr(PathTracker, "from_guess", asked)
    return counts


def assert_same(one, two):
    """Two motions are equal to the bit, with the same events."""
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name), err_msg=name)
    assert one.events == two.events


def assert_same_or_refused(mechanism, driver, values, one_by_one, **options):
    """A sweep is the one that is assembled first, or both are refused alike."""
    options["on_limit"] = "stop"
    try:
        known = one_by_one(mechanism, driver, values, **options)
    except sp.SpatialPinError as error:
        with pytest.raises(type(error)):
            sp.sweep(mechanism, driver, values, **options)
        return
    assert_same(sp.sweep(mechanism, driver, values, **options), known)


@pytest.mark.parametrize("name", each(sp.list_mechanisms()))
def test_at_once_from_the_guess_of_the_file(name, one_by_one):
    mechanism = library(name)
    for driver in mechanism.drivers:
        start = sp.assemble(mechanism).coordinate(driver).value
        size = mechanism.velocity_scale[mechanism.coordinate(driver).v]
        for n, options in ((1, {}), (19, {"speed": 2.0}), (2, {"hold": None})):
            values = start + size * np.linspace(0.0, 1.0, n)
            assert_same_or_refused(mechanism, driver, values, one_by_one, **options)


@pytest.mark.parametrize("name", each(sp.list_mechanisms()))
def test_at_once_from_a_state(name, one_by_one):
    mechanism = library(name)
    state = sp.assemble(mechanism)
    for driver in mechanism.drivers:
        start = state.coordinate(driver).value
        size = mechanism.velocity_scale[mechanism.coordinate(driver).v]
        for values in (start + size * np.linspace(0.0, -0.3, 7), [start + 0.1 * size]):
            assert_same_or_refused(mechanism, driver, values, one_by_one, guess=state)


def test_most_sweeps_are_got_at_once(told):
    """Else the tests above would compare nothing."""
    names = "rssr", "four_bar", "bennett", "screw_press", "watt_six_bar", "excavator", "crane"
    for name in names:
        mechanism = library(name)
        driver = next(iter(mechanism.drivers))
        state = sp.assemble(mechanism)
        values = state.coordinate(driver).value + 0.01 * np.arange(4.0)
        sp.sweep(mechanism, driver, values)
        sp.sweep(mechanism, driver, values, guess=state)
    assert told == [4] * 2 * len(names)


@pytest.mark.parametrize("tolerance", [1e-3, 1e-6, 1e-13, 1e-15])
def test_whatever_was_swept_before(tolerance, one_by_one):
    """The path that is kept knows nothing of the sweeps before."""
    mechanism, accuracy = library("rssr"), sp.Accuracy(tolerance=tolerance)
    values = np.linspace(0.0, 6.0, 90)
    known = one_by_one(mechanism, "crank", values, accuracy=accuracy)
    for other in (sp.Accuracy(), sp.Accuracy(order=1), sp.Accuracy(corrections=2), accuracy):
        sp.sweep(mechanism, "crank", values[::-1], accuracy=other)
        sp.sweep(mechanism, "crank", [2.0], accuracy=other)
        assert_same(sp.sweep(mechanism, "crank", values, accuracy=accuracy), known)


def test_it_goes_on_where_the_kernel_stops(told, one_by_one):
    """At a limit, and through branch points, which are found as if nothing had been done before."""
    turn = np.linspace(0.0, 7.0, 71)
    for name, parameters, values in (
            ("four_bar", {"r2": 0.25}, turn), ("four_bar", {"r2": 0.25}, turn[[0, -1]]),
            ("bricard", {}, turn), ("excavator", {}, np.linspace(2.7, 4.0, 27))):
        mechanism = library(name, **parameters)
        driver = next(iter(mechanism.drivers))
        motion = sp.sweep(mechanism, driver, values, on_limit="stop")
        assert_same(motion, one_by_one(mechanism, driver, values, on_limit="stop"))
        assert len(motion) < len(values) and motion.events[-1].kind == "limit"
    assert all(0 < n < 71 for n in told)


def test_long_sweeps_are_followed_in_parts(monkeypatch, told, one_by_one):
    """Ctrl-C waits for one part at most."""
    mechanism, values = library("four_bar"), np.linspace(0.0, 3.0, 61)
    known = sp.sweep(mechanism, "crank", values)
    monkeypatch.setattr(following, "CHUNK", 30)
    motion = sp.sweep(mechanism, "crank", values)
    for name in FIELDS[:-1]:  # samples are closed side by side in other groups
        np.testing.assert_allclose(getattr(motion, name), getattr(known, name),
                                   rtol=0.0, atol=1e-13)
    assert motion.events == known.events
    assert told == [61, 10]


@pytest.mark.parametrize("label", each(mechanisms.KNOWN))
def test_mechanisms_with_known_answers_are_swept_alike(label, tmp_path, one_by_one):
    known = mechanisms.KNOWN[label]
    mechanism, options = known.build(tmp_path), {"speed": 2.0}
    if known.hold:
        options["hold"] = known.hold
    assert_same(sp.sweep(mechanism, known.driver, known.values, **options),
                one_by_one(mechanism, known.driver, known.values, **options))


def test_what_the_kernel_has_begun_is_kept_at_ctrl_c(monkeypatch):
    """Where Ctrl-C comes before anything was added to it, too."""

    def interrupted(*arguments):
        raise KeyboardInterrupt

    mechanism, turn = library("four_bar", r2=0.25), np.linspace(0.0, 7.0, 71)
    whole = sp.sweep(mechanism, "crank", turn, on_limit="stop")
    monkeypatch.setattr(PathTracker, "reach", interrupted)
    with pytest.raises(sp.Interrupted) as stopped:
        sp.sweep(mechanism, "crank", turn, on_limit="stop")
    np.testing.assert_array_equal(stopped.value.motion.q, whole.q)
