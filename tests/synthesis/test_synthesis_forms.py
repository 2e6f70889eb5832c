"""What designs are held to: closed forms agree with geometry, published dimensions with errors."""

import numpy as np
import pytest
import synthesis_forms as forms
from mpmath import mp, mpc, mpf, pi
from scipy.optimize import least_squares
from synthesis_forms import logarithm

import spatial_pin as sp

PATHS = [name for name, case in forms.CASES.items() if "published" in case]




@pytest.mark.parametrize("alpha", [0, "0.3", pi / 3, "1.4"])
def test_function_generators_meet_their_three_points_to_40_digits(alpha):
    with mp.workdps(forms.DIGITS):
        phi, psi = logarithm(60, 90, 75, 60)
        found = forms.function_generator(phi, psi, mpf(alpha))
        for x, y in zip(phi, psi, strict=True):
            assert abs(forms.generated(found, x, y, mpf(alpha))) < mpf(10) ** -38


def test_a_twist_of_nothing_is_the_plane_freudenstein_equation():
    with mp.workdps(forms.DIGITS):
        a, b, c, d = (0.3, 1.1, 0.8, 1.0)
        phi, psi = [], []
        for angle in (0.4, 1.0, 1.9):  # rocker of a plane four-bar, tip left of the diagonal
            tip = mpf(a) * mp.expj(angle)
            y = mp.findroot(lambda t, A=tip: abs(d + c * mp.expj(t) - A) ** 2 - mpf(b) ** 2, 1.5)
            phi, psi = [*phi, mpf(angle)], [*psi, y]
        found = forms.function_generator(phi, psi)
        assert max(abs(x - y) for x, y in zip(found, (a, b, c, d), strict=True)) < mpf(10) ** -35


def test_an_rssr_of_the_library_turns_as_the_spatial_equation_says():
    with mp.workdps(forms.DIGITS):
        phi, psi = logarithm(60, 90, 75, 60)
        found = forms.function_generator(phi, psi, pi / 3)
    lengths = dict(zip("abcd", map(float, found), strict=True))
    mech = sp.load(forms.SYNTHESIS / "rssr_function.toml", alpha=np.pi / 3, **lengths)
    for x, y in zip(phi, psi, strict=True):
        state = sp.assemble(mech, {"crank": float(x)}, guess={"follower_pin": float(y)})
        assert state.coordinate("follower_pin")[0] == pytest.approx(float(y), abs=1e-12)


def coupler_poses(count=5):
    """Poses (x + iy, angle) of the body of a known four-bar, to 40 digits, and its two dyads."""
    g, h, u, v, r2, r4 = mpc(0), mpc(2, "-0.3"), mpc(0), mpc("2.6", "-0.4"), 1, mpf("3.4")
    poses, turn = [], mpf("1.2")
    for angle in ("0.2", "0.8", "1.4", "2.8", "3.7")[:count]:
        tip = g + r2 * mp.expj(mpf(angle))
        turn = mp.findroot(
            lambda t, tip=tip: abs(tip + mp.expj(t) * (v - u) - h) ** 2 - r4**2, turn)
        poses.append((tip - mp.expj(turn) * u, turn))
    return poses, (forms.Dyad(g, u), forms.Dyad(h, v))


def test_five_poses_of_a_four_bar_give_back_its_two_dyads_among_four():
    with mp.workdps(forms.DIGITS):
        poses, known = coupler_poses()
        found = forms.burmester_dyads(poses)
        assert len(found) == 4
        for dyad in found:
            lengths = [dyad.length(pose) for pose in poses]
            assert max(lengths) - min(lengths) < mpf(10) ** -35
        for dyad in known:
            assert min(abs(dyad.centre - x.centre) + abs(dyad.circle - x.circle)
                       for x in found) < mpf(10) ** -35


def test_centre_points_of_five_poses_lie_on_the_cubics_of_any_four():
    with mp.workdps(forms.DIGITS):
        poses, _ = coupler_poses()
        for dyad in forms.burmester_dyads(poses):
            for left_out in range(5):
                four = poses[:left_out] + poses[left_out + 1:]
                assert abs(forms.centre_curve(four, dyad.centre)) < mpf(10) ** -30
        assert abs(forms.centre_curve(poses[:4], mpc(1, 1))) > 1e-3


@pytest.mark.parametrize("name", PATHS)
def test_published_dimensions_have_the_error_that_is_reported(name):
    case = forms.CASES[name]
    bar, points = forms.published(case), case["points"]
    if "crank" in case["published"]:
        error = forms.timed_error(bar, points, case["published"]["crank"])
    elif "step" in case:
        steps = np.radians(case["step"]) * np.arange(len(points))
        starts = np.linspace(0, 2 * np.pi, 361)
        start = min(starts, key=lambda t: forms.timed_error(bar, points, t + steps))
        error = least_squares(
            lambda t: abs(forms.coupler_points(bar, t[0] + steps) - points @ np.array([1, 1j])),
            [start], xtol=1e-14).cost * 2
    else:
        error = forms.free_error(bar, points)
    assert error == pytest.approx(case["error"], rel=0.05 if case["error"] < 1e-15 else 2e-4)


def open_by(v, points):
    """Return by how much (8,) a four-bar with pivots at 0 and 1 misses five points x + iy.

    v: the coupler's two pins, seen from the tracer in its first position (4,), and by how much it
    has turned at the other four points [rad].
    """
    turn = np.exp(1j * np.r_[0, v[4:]])
    r, s = (abs(points + turn * (v[i] + 1j * v[i + 1]) - i / 2) ** 2 for i in (0, 2))
    return np.r_[r[1:] - r[0], s[1:] - s[0]]


def exact(start, points):
    """Return the exact solution near a start, or None."""
    end = least_squares(open_by, start, args=(points,), method="lm", max_nfev=200, xtol=1e-15,
                        ftol=1e-15)
    return end.x if end.cost < 1e-22 else None


def test_as_many_four_bars_are_exact_at_five_points_as_are_published():
    case = forms.CASES["line_of_five"]
    points = case["points"] @ np.array([1, 1j])
    found = [exact(np.array(pins + turns), points) for pins, turns in case["exact"]]
    assert len(found) == case["real"]
    for v, (pins, _) in zip(found, case["exact"], strict=True):
        assert v is not None and np.allclose(v[:4], pins, atol=1e-4)
    assert min(abs(v - w).max() for i, v in enumerate(found) for w in found[:i]) > 0.01


@pytest.mark.slow
def test_no_other_four_bar_is_exact_at_five_points():
    case, rng = forms.CASES["line_of_five"], np.random.default_rng(1)
    points, known = case["points"] @ np.array([1, 1j]), [pins for pins, _ in case["exact"]]
    for _ in range(300):
        v = exact(np.r_[2 * rng.normal(size=4), rng.uniform(-np.pi, np.pi, 4)], points)
        assert v is None or any(np.allclose(v[:4], pins, atol=1e-4) for pins in known)
