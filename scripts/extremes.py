"""Accuracy at extremes: errors, bounds, warnings.

Every row is an extreme: its worst error against 50 digits (mpmath: closed forms, or Newton on the
loop equations), with the bound that `tests/accuracy/test_extremes.py` holds it to; or the
error it raises.

    python scripts/extremes.py                # a table for the terminal, with measured errors
    python scripts/extremes.py --markdown     # the table of docs/extremes.md: bounds only

Errors of lengths are relative to the mechanism's size, angles absolute, rates relative to the
largest. Where the library states an error, the row fails if the statement is too small.
"""

from __future__ import annotations

import argparse
import importlib.util
import math
import time
import warnings
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import mpmath as mpm
import numpy as np
from mpmath import mp, mpf

import spatial_pin as sp

DIGITS = 60
GRAVITY = 9.81
SIZES = (1e-9, 1e-3, 1e3, 1e6)
FAR = (1e2, 1e4, 1e5, 5e6, 1e7)  # m from the origin
FOUR_BAR = (0.30, 0.10, 0.28, 0.24)  # ground, crank, coupler, rocker


def _of_tests(name: str) -> Any:
    path = Path(__file__).resolve().parents[1] / "tests" / "support" / f"{name}.py"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


forms, models = _of_tests("closed_forms"), _of_tests("published_models")
closure, inertial, joint = models.closure, models.inertial, models.joint
made, point, rod = models.made, models.point, models.rod


class Understated(AssertionError):
    """The library stated less than the true error."""


class Extreme(NamedTuple):
    """A row of the table.

    Attributes:
        name: of the extreme.
        tried: in what, how far.
        run: returns the worst error, or raises `refusal`.
        bound: of the error; None where it is refused.
        says: the warning, where accuracy degrades.
        refusal: the error class that is to be raised.
    """

    name: str
    tried: str
    run: Callable[[], float]
    bound: float | None
    says: str = ""
    refusal: type[Exception] | None = None


def far(got: float, want: Any, size: float = 1.0) -> float:
    """Return the distance of a float from a reference."""
    return float(abs(mpf(float(got)) - want) / mpf(size))


def relative(got: Iterable[float], want: Iterable[Any]) -> float:
    """Return the largest distance by the largest reference."""
    want = list(want)
    size = max(abs(w) for w in want)
    return max(float(abs(mpf(float(g)) - w) / size) for g, w in zip(got, want, strict=True))


def honest(error: float, estimate: float) -> float:
    """Return an error that must be no larger than the stated one."""
    if error > estimate:
        raise Understated(f"error {error:.1e}, but it says {estimate:.1e}")
    return error


def refused(error: type[Exception], text: str, runs: Iterable[Callable[[], Any]]) -> float:
    """Raise `error` if every run does, with `text` in it; else return NaN."""
    caught = None
    for run in runs:
        try:
            run()
        except error as found:
            if text not in str(found):
                return math.nan
            caught = found
        else:
            return math.nan
    assert caught is not None
    raise caught


# ---------------------------------------------------------------- kinematics


def rssr_of_any_size() -> float:
    worst = 0.0
    for size in SIZES:
        dims = {k: x * size for k, x in zip("abcd", (0.102, 0.381, 0.254, 0.314), strict=True)}
        motion = sp.sweep(sp.load("rssr", **dims), "crank", np.linspace(0, 6.2, 125), speed=25.0)
        points = motion.frame("rocker_b").position
        for row in range(0, 125, 31):
            want = forms.rates(partial(forms.rssr, **dims), motion.driver[row], 25.0, 0.0)
            got = (x[row] for x in motion.coordinate("rocker_pin"))
            for g, w in zip(got, (pose.coordinates["rocker_pin"] for pose in want), strict=True):
                worst = max(worst, far(g, w) / (1.0 + abs(float(w))))
            worst = max(worst, *(far(g, w, size) for g, w in zip(
                points[row], want.value.points["rocker_b"], strict=True)))
    return worst


def slider_crank_with_a_guess_of_another_size() -> float:
    worst = 0.0
    for size in (1e-30, 1e-9, 1e6):
        dims = {"r": 0.05 * size, "l": 0.16 * size}
        guess = None if size < 1.0 else {"slide": 0.2 * size}
        state = sp.assemble(sp.load("slider_crank", **dims), {"crank": 1.0}, guess)
        want = forms.slider_crank(mpf(1), **dims).coordinates["slide"]
        behind = 2 * mpf(dims["r"]) * mpm.cos(1) - want  # the slider on the other side
        got = state.coordinate("slide").value
        worst = max(worst, min(far(got, want, size), far(got, behind, size)))
    return worst


def plane_four_bar(
    masses: Iterable[float] = (1.0, 1.0, 1.0), size: float = 1.0, lean: float = 0.0,
    away: float = 0.0,
) -> sp.Mechanism:
    ground, crank, coupler, rocker = (x * size for x in FOUR_BAR)
    first, second, third = (rod(m, (x, 0, 0)) if m else "" for m, x in zip(
        masses, (crank, coupler, rocker), strict=True))
    tree = joint("continuous", "a", "ground", "crank", (away, 0, 0), mass=first)
    tree += joint("continuous", "b", "crank", "coupler", (crank, 0, 0), rpy=(lean, 0, 0),
                  mass=second)
    tree += joint("continuous", "c", "ground", "rocker", (away + ground, 0, 0), mass=third)
    tree += point("end", "coupler", (coupler, 0, 0)) + point("eye", "rocker", (rocker, 0, 0))
    return made("four_bar", tree, closure("pin", "revolute", "end", "eye") + DRIVEN + GUESS,
                (0.0, -GRAVITY, 0.0))


DRIVEN = '[drivers.crank]\njoint = "a"\n'
GUESS = "[guess]\na = 1.0\nb = -0.41\nc = 1.63\n"


def any_speed() -> float:
    worst, mech = 0.0, sp.load("rssr")
    state = sp.assemble(mech, {"crank": 1.0})
    for speed in (1e-9, 1e-3, 1e3, 1e6, 1e150):
        moved = sp.solve_rates(mech, state, {"crank": speed})
        want = forms.rates(forms.rssr, 1.0, speed, 0.0)
        got = moved.coordinate("rocker_pin")
        worst = max(worst, far(got.rate / speed, want.rate.coordinates["rocker_pin"] / speed),
                    far(got.acceleration / speed / speed,
                        want.acceleration.coordinates["rocker_pin"] / mpf(speed) ** 2))
    return worst


def too_fast() -> float:
    mech = sp.load("rssr")
    state = sp.assemble(mech, {"crank": 1.0})
    return refused(ValueError, "larger than numbers", [
        partial(call, speed) for speed in (1e155, 1e308) for call in (
            lambda x: sp.solve_rates(mech, state, {"crank": x}),
            lambda x: sp.sweep(mech, "crank", [0.0, 0.1], speed=x))])


def too_slow_for_a_time() -> float:
    mech = sp.load("rssr")
    motion = sp.sweep(mech, "crank", [0.0, 0.1], speed=1e-310)
    assert motion.time is None and np.isfinite(motion.v).all()
    want = forms.rates(forms.rssr, 0.1, 1.0, 0.0).rate.coordinates["rocker_pin"]
    return far(motion.coordinate("rocker_pin").rate[1] / 1e-310, want)


def far_angles() -> float:
    mech = sp.load("rssr")
    return max(far(sp.assemble(mech, {"crank": x}).coordinate("rocker_pin").value,
                   forms.rssr(mpf(x)).coordinates["rocker_pin"])
               for x in (2e6 * math.pi + 1.0, 1e9, 1e15, -1e15))


def denormal_steps() -> float:
    mech = sp.load("rssr")
    motion = sp.sweep(mech, "crank", [0.0, 5e-324, 1e-310, 1e-300, 1e-16], speed=1.0)
    want = forms.rates(forms.rssr, 0.0, 1.0, 0.0)
    got = motion.coordinate("rocker_pin")
    return max(relative(x, [w.coordinates["rocker_pin"]] * 5) for x, w in zip(
        got, want, strict=True) if w.coordinates["rocker_pin"])


def one_giant_step() -> float:
    sweep = partial(sp.sweep, sp.load("four_bar"), "crank")
    return refused(sp.SpatialPinError, "too far from the sample before", [
        partial(sweep, [0.0, x]) for x in (1e7, 1e300)])


def no_numbers() -> float:
    mech = sp.load("rssr")
    state = sp.assemble(mech)
    return refused(ValueError, "", [
        partial(call, bad) for bad in (math.nan, math.inf, -math.inf, 10**400) for call in (
            lambda x: sp.assemble(mech, {"crank": x}), lambda x: sp.load("rssr", a=x),
            lambda x: sp.assemble(mech, guess={"crank_pin": x}),
            lambda x: sp.solve_rates(mech, state, {"crank": x}),
            lambda x: sp.sweep(mech, "crank", [0.0, x]),
            lambda x: sp.forward_dynamics(mech, state, {"crank": x}))])


DEAD = {"r1": 0.30, "r2": 0.25, "r3": 0.14, "r4": 0.16}  # a crank that cannot go round
BENT = {"crank_pin": 0.9, "coupler_pin": -0.3, "rocker_pin": 1.5}


def limit_of_crank() -> Any:
    r1, r2, r3, r4 = map(mpf, DEAD.values())
    return mpm.acos((r1**2 + r2**2 - (r3 + r4) ** 2) / (2 * r1 * r2))


def near_a_limit(position: bool) -> float:
    mech, worst = sp.load("four_bar", **DEAD), 0.0
    for distance in (1e-6, 1e-9, 1e-12):
        phi = float(limit_of_crank() - distance)
        rocker = lambda x: forms.four_bar(x, **DEAD).coordinates["rocker_pin"]  # noqa: E731
        state = sp.solve_rates(mech, sp.assemble(mech, {"crank": phi}, BENT), {"crank": 1.0})
        got = state.coordinate("rocker_pin")
        if position:
            worst = max(worst, far(got.value, rocker(mpf(phi))))
            continue
        with mp.workdps(90):
            rate = mpm.diff(rocker, mpf(phi), h=mpf(10) ** -25)
        worst = max(worst, honest(far(got.rate / float(rate), 1), state.rate_error))
    return worst


def swept_to_a_limit() -> float:
    mech, worst = sp.load("four_bar", **DEAD), 0.0
    for distance in (1e-8, 1e-10, 1e-12):
        phi = float(limit_of_crank() - distance)
        motion = sp.sweep(mech, "crank", [*np.linspace(0.5, 1.0, 51), phi], guess=BENT)
        assert [e.kind for e in motion.events] == ["near limit"]
        want = forms.four_bar(mpf(phi), **DEAD).coordinates["rocker_pin"]
        worst = max(worst, far(motion.coordinate("rocker_pin").value[-1], want))
    return worst


def beyond_a_limit() -> float:
    mech, limit = sp.load("four_bar", **DEAD), limit_of_crank()
    worst = 0.0
    for distance in (1e-13, 1e-12, 1e-9, 1e-3):
        try:
            sp.sweep(mech, "crank", [*np.linspace(0.5, 1.0, 51), float(limit + distance)],
                     guess=BENT)
        except sp.LimitError as error:
            worst = max(worst, far(error.limit, limit))
        else:
            return math.nan
    return worst


def assembled_beyond() -> float:
    mech, limit = sp.load("four_bar", **DEAD), limit_of_crank()
    return refused(sp.AssemblyError, "out of reach", [
        partial(sp.assemble, mech, {"crank": float(limit + x)}, BENT) for x in (1e-9, 1e-6, 1.0)])


def assembled_just_beyond() -> float:
    limit = float(limit_of_crank())
    mech = sp.load("four_bar", **DEAD)
    gaps = []
    for distance in (1e-12, 1e-11):
        state = sp.assemble(mech, {"crank": limit + distance}, BENT)
        r1, r2, r3, r4 = DEAD.values()
        tip = math.hypot(r1 - r2 * math.cos(limit + distance), r2 * math.sin(limit + distance))
        gap = (tip - r3 - r4) / mech.characteristic_length  # what cannot be closed
        if state.closure_error < 0.5 * gap:
            raise Understated(f"open by {gap:.1e}, but it says {state.closure_error:.1e}")
        gaps.append(state.closure_error)
    return max(gaps)


def hooke(angle: Any, beta: Any) -> Any:
    return angle + mpm.atan2((1 - mpm.cos(beta)) * mpm.tan(angle),
                             mpm.cos(beta) + mpm.tan(angle) ** 2)


def shafts_nearly_in_line() -> float:
    worst = 0.0
    for beta in (1e-3, 1e-6, 1e-9, 1e-12, 1e-15):
        motion = sp.sweep(sp.load("hooke_joint", beta=beta), "input", np.linspace(0, 6.2, 63))
        for row in range(0, 63, 7):
            x = mpf(motion.driver[row])
            worst = max(worst, far(motion.coordinate("output").value[row], hooke(x, mpf(beta))))
    return worst


def twists_nearly_nothing() -> float:
    worst = 0.0
    for alpha in (1e-3, 1e-6, 1e-9, 1e-12, 1e-15):
        mech = sp.load("bennett", alpha=alpha, beta=2.0 * alpha)
        motion = sp.sweep(mech, "crank", np.linspace(0.5, 2.5, 41))
        assert sp.mobility(mech, motion.q[0]).dof == 1
        a, b = mpf(alpha), mpf(2.0 * alpha)
        k = mpm.sin((b + a) / 2) / mpm.sin((b - a) / 2)
        for row in range(0, 41, 8):
            want = 2 * mpm.atan(k / mpm.tan(mpf(motion.driver[row]) / 2))
            worst = max(worst, far(motion.coordinate("follower_pin").value[row], want))
    return worst


def axis_that_leans() -> float:
    return refused(sp.AssemblyError, "cannot be closed", [
        partial(sp.assemble, plane_four_bar(lean=lean), {"crank": 1.0}, gap=0.0)
        for lean in (1e-3, 1e-6, 1e-9, 1e-10)])


def axis_that_hardly_leans() -> float:
    errors = []
    for lean in (1e-12, 1e-13, 1e-15):
        state = sp.assemble(plane_four_bar(lean=lean), {"crank": 1.0})
        honest(0.5 * lean, state.closure_error)
        errors.append(state.closure_error)
    return max(errors)


def short_crank() -> float:
    worst = 0.0
    for r in (1e-3, 1e-6, 1e-9, 1e-12, 1e-15, 1e-100):
        motion = sp.sweep(sp.load("slider_crank", r=r), "crank", np.linspace(0, 6.2, 63))
        for row in (0, 9, 36):
            x = mpf(motion.driver[row])
            with mp.workdps(130):
                want = forms.rates(partial(forms.slider_crank, r=r), x, 1.0, 0.0)
            slide = motion.coordinate("slide")
            worst = max(worst, far(slide.value[row], want.value.coordinates["slide"]))
            if r > 1e-20:
                worst = max(worst, far(slide.rate[row], want.rate.coordinates["slide"], r))
    return worst


def long_links(names: tuple[str, ...]) -> float:
    """Return the worst angle of a turn; some links are 1e2 to 1e6 times as long as the crank."""
    worst, crank = 0.0, FOUR_BAR[1]
    for ratio in (1e2, 1e4, 1e6):
        dims = dict(zip(("r1", "r2", "r3", "r4"), FOUR_BAR, strict=True))
        dims |= {name: (dims[name] if "r1" in names else crank) * ratio for name in names}
        form, mech = partial(forms.four_bar, **dims), sp.load("four_bar", **dims)
        guess = {name: float(x) for name, x in form(mpf(0.3)).coordinates.items()}
        motion = sp.sweep(mech, "crank", np.linspace(0.3, 6.2, 60), speed=1.0, guess=guess)
        got, fastest = motion.coordinate("rocker_pin"), np.abs(motion.v).max()
        for row in range(0, 60, 12):
            want = forms.rates(form, motion.driver[row], 1.0, 0.0)
            error = far(got.value[row], want.value.coordinates["rocker_pin"])
            worst = max(worst, honest(error, motion.error.positions))
            honest(far(got.rate[row], want.rate.coordinates["rocker_pin"], fastest),
                   motion.error.rates)
        assert motion.error.largest < 1e-7  # bounds of use, a thousand times the errors at most
    return worst


def longer_links() -> float:
    """Sweep a four-bar whose coupler and rocker are 1e7 times as long as its crank, or more."""
    for ratio in (1e7, 1e8, 1e9):
        dims = dict(zip(("r1", "r2", "r3", "r4"), FOUR_BAR, strict=True))
        dims |= {name: FOUR_BAR[1] * ratio for name in ("r3", "r4")}
        form, mech = partial(forms.four_bar, **dims), sp.load("four_bar", **dims)
        guess = {name: float(x) for name, x in form(mpf(0.3)).coordinates.items()}
        try:
            sp.sweep(mech, "crank", np.linspace(0.3, 6.2, 60), speed=1.0, guess=guess)
        except sp.SingularError as error:
            refusal = error
            assert "lengths of its links" in str(error)
        else:
            return math.inf
    raise refusal


def short_coupler(r3: float) -> tuple[sp.Mechanism, sp.State, Callable[[Any], Any]]:
    dims = {"r1": 0.30, "r2": 0.06 + 0.5 * r3, "r3": r3, "r4": 0.24}
    coupler = lambda x: forms.four_bar(x, **dims).coordinates["coupler_pin"]  # noqa: E731
    pose = forms.four_bar(mpf(0), **dims).coordinates
    mech = sp.load("four_bar", **dims)
    guess = {name: float(pose[name]) for name in ("crank_pin", "coupler_pin", "rocker_pin")}
    return mech, sp.assemble(mech, {"crank": 0.0}, guess), coupler


def short_couplers() -> float:
    worst = 0.0
    for r3 in (1e-3, 1e-5, 1e-6):
        mech, state, coupler = short_coupler(r3)
        moved = sp.solve_rates(mech, state, {"crank": 1.0})
        with mp.workdps(90):
            want = [mpm.diff(coupler, 0, k, h=mpf(10) ** -20) for k in (1, 2)]
        got = moved.coordinate("coupler_pin")[1:]
        worst = max(worst, *(honest(far(g / float(w), 1), moved.rate_error)
                             for g, w in zip(got, want, strict=True)))
    return worst


def shorter_couplers() -> float:
    cases = [short_coupler(r3)[:2] for r3 in (1e-9, 1e-10, 1e-12)]
    return refused(sp.SingularError, "reliable", [
        partial(sp.solve_rates, mech, state, {"crank": 1.0}) for mech, state in cases])


def repeated(n: int) -> float:
    """Close a four-bar by n hinges on one axis: five equations each, two of them needed."""
    ground, crank, coupler, rocker = FOUR_BAR
    tree = joint("continuous", "a", "ground", "crank")
    tree += joint("continuous", "b", "crank", "coupler", (crank, 0, 0))
    tree += joint("continuous", "c", "ground", "rocker", (ground, 0, 0))
    toml = DRIVEN + GUESS
    for i in range(n):
        tree += point(f"end_{i}", "coupler", (coupler, 0, 0.001 * i))
        tree += point(f"eye_{i}", "rocker", (rocker, 0, 0.001 * i))
        toml += closure(f"pin_{i}", "revolute", f"end_{i}", f"eye_{i}")
    mech = made("repeated", tree, toml, (0.0, -GRAVITY, 0.0))
    mobility = sp.mobility(mech)
    assert (mobility.dof, mobility.rank, len(mobility.redundant)) == (1, 2, 5 * n - 2)
    motion = sp.sweep(mech, "crank", np.linspace(0, 6.2, 32))
    return max(far(y, pose_of_four_bar(mpf(x))[2])
               for x, y in zip(motion.driver, motion.coordinate("c").value, strict=True))


def upside_down() -> float:
    rng, worst = np.random.default_rng(1), 0.0
    mech = sp.load("rssr")
    want = forms.rssr(mpf(1)).coordinates["rocker_pin"]
    for _ in range(30):
        guess = {"rocker_pin": rng.uniform(-np.pi, np.pi), "ball_a": rng.uniform(-3.0, 3.0, 3)}
        got = mpf(sp.assemble(mech, {"crank": 1.0}, guess).coordinate("rocker_pin").value)
        gaps = [got - w - 2 * mpm.pi * mpm.nint((got - w) / (2 * mpm.pi)) for w in (want, -want)]
        worst = max(worst, float(min(map(abs, gaps))))
    return worst


def upside_down_everywhere() -> float:
    rng, worst = np.random.default_rng(2), 0.0
    for name in ("four_bar", "bricard", "oldham", "stewart", "delta", "sarrus", "double_cardan"):
        mech = sp.load(name)
        for _ in range(3):
            guess = {c.joint: rng.uniform(-3.0, 3.0) for c in mech.coordinate_table.values()
                     if c.name == c.joint}
            with warnings.catch_warnings():  # legs far beyond their limits are intended
                warnings.simplefilter("ignore", sp.SpatialPinWarning)
                worst = max(worst, sp.assemble(mech, guess=guess).closure_error)
    return worst


def ten_loops_on_one_body() -> float:
    tree, toml, posts = joint("continuous", "hub", "ground", "plate"), "", []
    for i in range(10):
        turn, length = 0.2 * math.pi * i + 0.1, 1.5 + 0.05 * i
        post = ((2.0 + 0.1 * i) * math.cos(turn), (2.0 + 0.1 * i) * math.sin(turn))
        eye = (0.5 * math.cos(turn), 0.5 * math.sin(turn))
        tree += joint("continuous", f"post_{i}", "ground", f"arm_{i}", (*post, 0))
        tree += joint("continuous", f"knee_{i}", f"arm_{i}", f"rod_{i}", (0.8, 0, 0))
        tree += point(f"tip_{i}", f"rod_{i}", (length, 0, 0)) + point(f"eye_{i}", "plate",
                                                                      (*eye, 0))
        toml += closure(f"pin_{i}", "revolute", f"eye_{i}", f"tip_{i}")
        posts.append((post, eye, length))
    mech = made("flower", tree, toml + '[drivers.hub]\njoint = "hub"\n', (0.0, 0.0, -GRAVITY))
    assert sp.mobility(mech).dof == 1
    motion, worst = sp.sweep(mech, "hub", np.linspace(0.1, 0.4, 31)), 0.0
    for row in (0, 15, 30):
        hub = mpf(motion.driver[row])
        for i, (post, eye, length) in enumerate(posts):
            x, y = (mpm.cos(hub) * eye[0] - mpm.sin(hub) * eye[1] - post[0],
                    mpm.sin(hub) * eye[0] + mpm.cos(hub) * eye[1] - post[1])
            got = [motion.coordinate(f"{name}_{i}").value[row] for name in ("post", "knee")]
            want = mpm.findroot(partial(_open, x, y, mpf(length)), [mpf(g) for g in got])
            worst = max(worst, *(far(g, w) for g, w in zip(got, want, strict=True)))
    return worst


def _open(x: Any, y: Any, length: Any, p: Any, k: Any) -> list[Any]:
    arm = mpf(0.8)
    return [arm * mpm.cos(p) + length * mpm.cos(p + k) - x,
            arm * mpm.sin(p) + length * mpm.sin(p + k) - y]


def too_large_or_small() -> float:
    return refused(sp.MechanismFileError, "", [
        lambda size=size: sp.assemble(plane_four_bar((0, 0, 0), size))  # type: ignore[misc]
        for size in (1e-300, 1e-150, 1e150, 1e300)])


def too_heavy_or_light() -> float:
    return refused(sp.MechanismFileError, "kg can be worked with", [
        partial(plane_four_bar, (mass, 1.0, 1.0)) for mass in (5e-324, 1e-300, 1e300)])


def a_million_steps() -> float:
    motion = sp.sweep(sp.load("four_bar"), "crank", np.linspace(0, 1e6 * math.pi / 180, 1_000_001))
    assert motion.closure_error.max() < 1e-11  # the last bit of 17 453 rad is 4e-12
    return max(far(motion.coordinate("rocker_pin").value[k], forms.four_bar(
        mpf(motion.driver[k])).coordinates["rocker_pin"]) for k in range(0, 1_000_001, 99_991))


def after_many_turns() -> float:
    """Follow a turn after many turns: every angle of the loop has lost digits to their number."""
    mech, worst = sp.load("four_bar"), 0.0
    start = sp.assemble(mech, {"crank": 0.0}).q
    for turns in (1e3, 1e4, 1e5, 1e6):
        q = start + 2.0 * math.pi * turns * np.array([1.0, -1.0, 0.0])
        motion = sp.sweep(mech, "crank", q[0] + np.linspace(0.0, 6.2, 1001), guess=q)
        assert motion.q[-1, 1] < -6.0 * turns
        for row in (9, 310, 620, 1000):
            want = forms.four_bar(mpf(motion.driver[row])).coordinates["rocker_pin"]
            gap = far(motion.coordinate("rocker_pin").value[row], want)
            worst = max(worst, gap, float(motion.closure_error[row]))
    return worst


# ---------------------------------------------------------------- forces


def pose_of_four_bar(phi: Any, size: float = 1.0) -> list[Any]:
    """Return the links' angles, then x and y of their middles."""
    r1, r2, r3, r4 = (mpf(x * size) for x in FOUR_BAR)
    x, y = r2 * mpm.cos(phi), r2 * mpm.sin(phi)
    d = mpm.sqrt((r1 - x) ** 2 + y**2)
    coupler = mpm.atan2(-y, r1 - x) + mpm.acos((r3**2 + d**2 - r4**2) / (2 * r3 * d))
    dx, dy = r3 * mpm.cos(coupler), r3 * mpm.sin(coupler)
    rocker = mpm.atan2(y + dy, x + dx - r1)
    return [phi, coupler, rocker, x / 2, y / 2, x + dx / 2, y + dy / 2, (r1 + x + dx) / 2,
            (y + dy) / 2]


def exact_four_bar(
    masses: Iterable[float], size: float, phi: float, speed: float, wanted: float
) -> tuple[list[Any], Any]:
    """Return joint accelerations under gravity, and the crank's torque for acceleration `wanted`.

    One equation of motion, from the kinetic energy of the three rods.
    """
    with mp.workdps(110):
        h = mpf(10) ** -25
        before, at, after = (pose_of_four_bar(mpf(phi) + k * h, size) for k in (-1, 0, 1))
        d1 = [(p - m) / (2 * h) for m, p in zip(before, after, strict=True)]
        d2 = [(p - 2 * o + m) / h**2 for m, o, p in zip(before, at, after, strict=True)]
        inertia = bias = weight = mpf(0)
        for i, mass in enumerate(masses):
            moment = mpf(mass) * mpf(FOUR_BAR[i + 1] * size) ** 2 / 12
            for k, m in ((i, moment), (3 + 2 * i, mpf(mass)), (4 + 2 * i, mpf(mass))):
                inertia += m * d1[k] ** 2
                bias += m * d1[k] * d2[k]
            weight += mpf(mass) * mpf(GRAVITY) * d1[4 + 2 * i]
        fall = -(bias * mpf(speed) ** 2 + weight) / inertia
        a, b, c = (d1[i] * fall + d2[i] * mpf(speed) ** 2 for i in range(3))
        return [a, b - a, c], inertia * mpf(wanted) + bias * mpf(speed) ** 2 + weight


RATIOS = ((1, 1, 1), (1e-12, 1, 1), (1, 1e-12, 1), (1, 1, 1e-12), (1, 1e12, 1), (1e12, 1, 1e12),
          (1, 1e12, 1e-12), (1e-12, 1e12, 1), (1e-12, 1, 1e12), (1e-24, 1e-12, 1e-24))


def mass_ratios(size: float, density: float, inverse: bool) -> float:
    worst = 0.0
    for ratio in RATIOS:
        masses = [density * m for m in ratio]
        mech = plane_four_bar(masses, size)
        state = sp.solve_rates(mech, sp.assemble(mech, {"crank": 1.0}), {"crank": 2.0},
                               {"crank": 3.0})
        fall, torque = exact_four_bar(masses, size, 1.0, 2.0, 3.0)
        if inverse:
            effort = sp.inverse_dynamics(mech, state).efforts["crank"]
            worst = max(worst, far(effort / float(torque), 1))
        else:
            result = sp.forward_dynamics(mech, state)
            worst = max(worst, honest(relative(result.a, fall), result.error))
    return worst


def double_pendulum(first: float, second: float, bend: float) -> tuple[sp.Mechanism, sp.State, Any]:
    """Return two point masses on rods of 1 m at 1 and 2 rad/s, and their accelerations."""
    tree = joint("continuous", "p", "ground", "upper", mass=inertial(first, (1, 0, 0), (0, 0, 0)))
    tree += joint("continuous", "k", "upper", "lower", (1, 0, 0),
                  mass=inertial(second, (1, 0, 0), (0, 0, 0)))
    mech = made("double_pendulum", tree, "", (0.0, -GRAVITY, 0.0))
    state = sp.solve_rates(mech, sp.assemble(mech, {"p": 0.3, "k": bend}), {"p": 1.0, "k": 2.0})
    m, n, q, r, g = map(mpf, (first, second, 0.3, bend, GRAVITY))
    with mp.workdps(150):
        sine, cosine = mpm.sin(r), mpm.cos(r)
        # along the upper rod's path and the lower one's, absolute angles
        f1 = n * sine * 9 - (m + n) * g * mpm.cos(q)
        f2 = -n * sine * 1 - n * g * mpm.cos(q + r)
        det = (m + n) * n - (n * cosine) ** 2
        a1 = (n * f1 - n * cosine * f2) / det
        a2 = ((m + n) * f2 - n * cosine * f1) / det
        return mech, state, [a1, a2 - a1]


def pendulums(seconds: Iterable[float], bend: float) -> float:
    worst = 0.0
    for second in seconds:
        mech, state, want = double_pendulum(1.0, second, bend)
        result = sp.forward_dynamics(mech, state)
        worst = max(worst, honest(relative(result.a, want), result.error))
    return worst


def swings(size: float) -> float:
    """Swing a point on a rod, of water's density, ten times: against Jacobi's elliptic function."""
    bob = inertial(1e3 * size**3, (size, 0, 0), (0, 0, 0))
    mech = made("pendulum", joint("continuous", "p", "ground", "rod", mass=bob), "",
                (0.0, -GRAVITY, 0.0))
    period = 2.0 * math.pi * math.sqrt(size / GRAVITY)
    motion = sp.simulate(mech, sp.assemble(mech, {"p": 0.5 - 0.5 * math.pi}), 10 * period,
                         times=np.linspace(0.0, 10 * period, 11))
    k = mpm.sin((mpf(motion.q[0, 0]) + mpm.pi / 2) / 2)
    return max(far(p, 2 * mpm.asin(k * mpm.ellipfun(
        "cd", mpf(t) * mpm.sqrt(mpf(GRAVITY) / mpf(size)), m=k**2)) - mpm.pi / 2)
        for t, p in zip(motion.time, motion.q[:, 0], strict=True))


def spins(speed: float) -> float:
    """Return the energy drift of ten turns of a four-bar."""
    mech = plane_four_bar()
    state = sp.solve_rates(mech, sp.assemble(mech, {"crank": 1.0}), {"crank": speed})
    motion = sp.simulate(mech, state, 10 * 2.0 * math.pi / max(speed, 10.0))
    assert motion.closure_error.max() < 1e-12
    return float(motion.energy_drift)


def falls(masses: Iterable[float], size: float = 1.0) -> float:
    """Return the energy drift of a four-bar that falls from rest."""
    mech = plane_four_bar(masses, size)
    motion = sp.simulate(mech, sp.assemble(mech, {"crank": 1.0}), 6.0 * math.sqrt(size / GRAVITY))
    assert motion.closure_error.max() < 1e-12
    return float(motion.energy_drift)


def far_away(rounded: bool) -> float:
    """Return the worst error of a four-bar's joints and rates, far from the world's origin.

    Args:
        rounded: whether the ground is as long as the two places on it are apart, which are rounded;
            else as long as it was before that, and `rate_error` is to bound what rates have lost.
    """
    worst = 0.0
    for away in FAR:
        mech = plane_four_bar(away=away)
        ground = mpf(away + FOUR_BAR[0]) - mpf(away) if rounded else mpf(FOUR_BAR[0])
        dims = dict(zip(("r1", "r2", "r3", "r4"), (ground, *FOUR_BAR[1:]), strict=True))
        motion = sp.sweep(mech, "crank", np.linspace(0.0, 6.2, 63), speed=1.0)
        for row in range(0, 63, 7):
            want = forms.rates(partial(forms.four_bar, **dims), motion.driver[row], 1.0, 0.0)
            row_values = [x[row] for x in motion.coordinate("c")]
            errors = [far(x, pose.coordinates["rocker_pin"], max(
                abs(y) for y in pose.coordinates.values()))
                for x, pose in zip(row_values, want, strict=True)]
            if not rounded:
                honest(max(errors[1:]), motion.state(row).rate_error)
            worst = max(worst, *errors)
    return worst


def open_far_away() -> float:
    """Return the stated closure error far away, where positions have fewer digits."""
    worst = 0.0
    for away in FAR:
        mech = plane_four_bar(away=away)
        for crank in np.linspace(0.0, 6.0, 13):
            state = sp.assemble(mech, {"crank": float(crank)})
            end, eye = (state.placement(name).translation for name in ("end", "eye"))
            honest(float(np.abs(end - eye).max()) / mech.characteristic_length, state.closure_error)
            worst = max(worst, state.closure_error)
    return worst


def falls_far_away() -> float:
    """Return the energy drift of a four-bar that falls far away; it takes no more work there."""
    runs = []
    for away in (0.0, *FAR):
        mech = plane_four_bar(away=away)
        runs.append(sp.simulate(mech, sp.assemble(mech, {"crank": 1.0}), 1.0))
    assert max(run.evaluations for run in runs) < 1.2 * runs[0].evaluations
    return max(float(run.energy_drift) for run in runs)


def many_steps_in_time() -> float:
    mech = plane_four_bar()
    state = sp.solve_rates(mech, sp.assemble(mech, {"crank": 1.0}), {"crank": 10.0})
    motion = sp.simulate(mech, state, 100.0, times=np.linspace(0.0, 100.0, 11),
                         accuracy=sp.Accuracy(integrator="RK4", step=1e-3))
    assert motion.steps >= 100_000 and motion.closure_error.max() < 1e-12
    return float(motion.energy_drift)


# ---------------------------------------------------------------- the table

HEAVY_ENDS = (1e-100, 1e-20, 1e-12, 1e-6, 1.0, 1e6, 1e9, 1e12, 1e15, 1e17, 1e20)
SAID_BY_RATES = "`rate_error` bounds it"
SAID_BY_FORCES = "`Dynamics.error` bounds it"
SAID_BY_MOTIONS = "`motion.error` bounds it"
BY_CLOSURE_ERROR = "`closure_error` says it"
EXTREMES = (
    Extreme("size", "RSSR of 0.6 nm to 600 km, a turn: points, angles and their rates",
            rssr_of_any_size, 1e-11),
    Extreme("size", "slider-crank of 1e-30 m to 200 km with a guess of another size",
            slider_crank_with_a_guess_of_another_size, 1e-13),
    Extreme("size", "four-bar of 1e-300, 1e-150, 1e150, 1e300 m", too_large_or_small, None,
            refusal=sp.MechanismFileError),
    Extreme("mass", "links of 5e-324, 1e-300, 1e300 kg", too_heavy_or_light, None,
            refusal=sp.MechanismFileError),
    Extreme("speed", "RSSR at 1e-9 to 1e6 and 1e150 rad/s: rates per crank speed", any_speed,
            1e-13),
    Extreme("speed", "RSSR at 1e155, 1e308 rad/s", too_fast, None, refusal=ValueError),
    Extreme("speed", "RSSR at 1e-310 rad/s: its rate per crank speed", too_slow_for_a_time, 1e-12,
            "no time"),
    Extreme("angle", "crank a million turns on, at 1e9 and ±1e15 rad", far_angles, 1e-13),
    Extreme("denormals", "RSSR swept in steps of 5e-324 to 1e-300 rad: rates", denormal_steps,
            1e-12),
    Extreme("steps", "one step of 1e7, 1e300 rad", one_giant_step, None,
            refusal=sp.SpatialPinError),
    Extreme("not a number", "NaN, ±inf, 10**400 for values, speeds, efforts, dimensions, guesses",
            no_numbers, None, refusal=ValueError),
    Extreme("limit", "assembled 1e-6 to 1e-12 rad before it: position",
            partial(near_a_limit, True), 1e-9),
    Extreme("limit", "assembled 1e-6 to 1e-12 rad before it: rates",
            partial(near_a_limit, False), 1e-2, SAID_BY_RATES),
    Extreme("limit", "swept to 1e-8 to 1e-12 rad before it: position",
            swept_to_a_limit, 1e-9, "event `near limit` says it"),
    Extreme("limit", "swept to 1e-13 to 1e-3 rad beyond it: the limit", beyond_a_limit,
            1e-12, "`LimitError` has it"),
    Extreme("limit", "assembled 1e-12, 1e-11 rad beyond it: loops open by",
            assembled_just_beyond, 1e-11, BY_CLOSURE_ERROR),
    Extreme("limit", "assembled 1e-9 to 1 rad beyond it", assembled_beyond, None,
            refusal=sp.AssemblyError),
    Extreme("nearly parallel", "Hooke's joint, shafts 1e-3 to 1e-15 rad from a line",
            shafts_nearly_in_line, 1e-13),
    Extreme("nearly parallel", "Bennett's loop with twists of 1e-3 to 1e-15 rad",
            twists_nearly_nothing, 1e-11),
    Extreme("nearly parallel", "plane four-bar, hinge leaning by 1e-3 to 1e-10 rad, no gap allowed",
            axis_that_leans, None, refusal=sp.AssemblyError),
    Extreme("nearly parallel", "the same, by 1e-12 to 1e-15 rad: loops open by",
            axis_that_hardly_leans, 1e-11, BY_CLOSURE_ERROR),
    Extreme("short link",
            "slider-crank, crank of 1e-3 to 1e-100 m: slide, its rate per crank speed",
            short_crank, 1e-12),
    Extreme("short link", "four-bar, coupler of 1e-3 to 1e-6 m: its rates", short_couplers, 1e-9,
            SAID_BY_RATES),
    Extreme("short link", "four-bar, coupler of 1e-9 to 1e-12 m: rates", shorter_couplers, None,
            refusal=sp.SingularError),
    Extreme("link ratio", "four-bar, links 1e2 to 1e6 times as long as the crank: a turn",
            partial(long_links, ("r1", "r3", "r4")), 1e-14, SAID_BY_MOTIONS),
    Extreme("link ratio", "the same, coupler and rocker alone, nearly in line: a turn",
            partial(long_links, ("r3", "r4")), 1e-9, SAID_BY_MOTIONS),
    Extreme("link ratio", "the same two links, 1e7 to 1e9 times as long", longer_links, None,
            refusal=sp.SingularError),
    Extreme("redundant", "four-bar closed by 200 hinges: 1000 equations, rank 2",
            partial(repeated, 200), 1e-12),
    Extreme("guess", "RSSR, rocker and coupler turned at random, 30 times", upside_down, 1e-12),
    Extreme("guess", "seven mechanisms, every coordinate within ±3: closure error",
            upside_down_everywhere, 1e-12),
    Extreme("shared body", "ten loops on one plate", ten_loops_on_one_body, 1e-12),
    Extreme("mass ratio", "four-bar, neighbours 1e-24 to 1e24 apart: accelerations",
            partial(mass_ratios, 1.0, 1.0, False), 1e-11, SAID_BY_FORCES),
    Extreme("mass ratio", "the same: torque of the crank", partial(mass_ratios, 1.0, 1.0, True),
            1e-11),
    Extreme("mass ratio", "the same of 0.5 nm, down to 1e-48 kg: accelerations",
            partial(mass_ratios, 1e-9, 1e-24, False), 1e-11, SAID_BY_FORCES),
    Extreme("mass ratio", "the same of 500 km: accelerations",
            partial(mass_ratios, 1e6, 1e18, False), 1e-11, SAID_BY_FORCES),
    Extreme("mass ratio", "double pendulum, bent, its end 1e-100 to 1e20 times as heavy",
            partial(pendulums, (1e-100, 1e-20, 1e-12, 1e-6, 1e6, 1e12, 1e20), 0.7), 1e-12,
            SAID_BY_FORCES),
    Extreme("mass ratio", "double pendulum, stretched, its end 1e-100 to 1e20 times as heavy",
            partial(pendulums, HEAVY_ENDS, 0.0), 1e-12, SAID_BY_FORCES),
    Extreme("mass ratio", "double pendulum, 1e-6, 1e-12 rad from stretched, likewise",
            lambda: max(pendulums(HEAVY_ENDS, bend) for bend in (1e-6, 1e-12)), 1e-12,
            SAID_BY_FORCES),
    Extreme("simulation", "pendulum of 1 nm to 1000 km, ten swings: angle",
            lambda: max(swings(size) for size in (1e-9, 1.0, 1e6)), 1e-9),
    Extreme("simulation", "four-bar, ten turns at 1e6 rad/s: energy drift", partial(spins, 1e6),
            1e-9, "`energy_drift` says it"),
    Extreme("simulation", "four-bar falling, neighbours 1e12, 1e24 apart: energy drift",
            lambda: max(falls(m) for m in ((1, 1e-12, 1), (1, 1e12, 1), (1e-12, 1e12, 1))), 1e-9,
            "`energy_drift` says it"),
    Extreme("simulation", "four-bar of 0.5 µm falling: energy drift",
            lambda: falls((1e-15, 1e-15, 1e-15), 1e-6), 1e-9, "`energy_drift` says it"),
    Extreme("far away", "four-bar 100 m to 10 000 km from the origin: angles, their rates",
            partial(far_away, True), 1e-12),
    Extreme("far away", "the same, as against the digits that its places on the ground have lost",
            partial(far_away, False), 1e-7, SAID_BY_RATES),
    Extreme("far away", "the same: loops open by", open_far_away, 1e-8, BY_CLOSURE_ERROR),
    Extreme("far away", "the same, falling: energy drift", falls_far_away, 1e-9,
            "`energy_drift` says it"),
    Extreme("steps", "four-bar swept in a million steps of 1°", a_million_steps, 1e-11),
    Extreme("turns", "four-bar, one more turn after 1e3 to 1e6 turns of its joints: angle, closure",
            after_many_turns, 1e-8, BY_CLOSURE_ERROR),
    Extreme("steps", "four-bar, a hundred thousand steps of RK4, 1 ms: energy drift",
            many_steps_in_time, 1e-5, "`energy_drift` says it"),
)


def measure(extreme: Extreme) -> float | Exception:
    """Return the worst error of a row, or the error that it raised as it should."""
    with mp.workdps(DIGITS):
        if extreme.refusal is None:
            return extreme.run()
        try:
            return extreme.run()
        except extreme.refusal as error:
            return error


def holds(extreme: Extreme, result: float | Exception) -> bool:
    """Whether a row is as in the table."""
    if isinstance(result, Exception):
        return extreme.refusal is not None and isinstance(result, extreme.refusal)
    return extreme.bound is not None and result <= extreme.bound


def answer(extreme: Extreme) -> str:
    """Return the last column of the table."""
    if extreme.refusal is not None:
        return f"`{extreme.refusal.__name__}`"
    return f"{extreme.bound:.0e}".replace("e-0", "e-") + (f"; {extreme.says}" if extreme.says
                                                         else "")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--markdown", action="store_true", help="the table of docs/extremes.md")
    parser.add_argument("--only", default="", help="rows with this text in them")
    options = parser.parse_args()
    failed = 0
    if options.markdown:
        print("| extreme | tried | largest error, or the exception |\n|---|---|---|")
    for extreme in EXTREMES:
        if options.only not in f"{extreme.name} {extreme.tried}":
            continue
        start = time.perf_counter()
        try:
            result = measure(extreme)
        except Exception as error:  # whatever it is, the other rows are shown too
            result = error
        good = holds(extreme, result)
        failed += not good
        if options.markdown:
            print(f"| {extreme.name} | {extreme.tried} | {answer(extreme)} |")
            continue
        text = f"{result:.1e}" if isinstance(result, float) else (
            f"{type(result).__name__}: {str(result)[:100]}")
        print(f"{'' if good else 'FAILED '}{extreme.name}: {extreme.tried}\n"
              f"    {answer(extreme)}: {text} ({time.perf_counter() - start:.1f} s)", flush=True)
    return failed


if __name__ == "__main__":
    raise SystemExit(main())
