"""Accelerations where masses differ as far as numbers go: the same from every verb, and right.

Truth is Lagrange's equation of chains of points on massless rods, in 60 digits or more.
"""

import importlib.util

import mechanisms as known
import mpmath
import numpy as np
import pytest
from folders import ROOT
from masses import heavy
from mpmath import mpf
from variety import few

import spatial_pin as sp

SCRIPT = ROOT / "scripts" / "extremes.py"
SPEC = importlib.util.spec_from_file_location("extremes", SCRIPT)
extremes = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(extremes)

G = 9.81
FORMULATIONS = ("independent", "projected")


def chain(points, bends, speeds, lengths, lean=0.0):
    """Return rods of these lengths with points of these masses at their ends, in a plane.

    Args:
        points: masses [kg].
        bends: joint angles [rad].
        speeds: of the joints [rad/s].
        lengths: of the rods [m].
        lean: by which the plane leans against gravity [rad].
    """
    tree, at = "", 0.0
    for k, (mass, length) in enumerate(zip(points, lengths, strict=True)):
        rod = known.turning(f"j{k}", f"rod{k - 1}" if k else "ground", f"rod{k}", (at, 0, 0))
        tree += heavy(rod, **{f"rod{k}": (mass, (length, 0, 0), (0, 0, 0))})
        at = length
    gravity = [0.0, float(-G * np.cos(lean)), float(-G * np.sin(lean))]
    mech = known.from_tree("chain", tree, gravity=gravity)
    names = [f"j{k}" for k in range(len(points))]
    state = sp.assemble(mech, dict(zip(names, bends, strict=True)))
    return mech, sp.solve_rates(mech, state, dict(zip(names, speeds, strict=True)))


def truth(mech, points, bends, speeds, lengths):
    """Return the joint accelerations of `chain`."""
    with mpmath.workdps(150):
        n, g = len(points), -mpf(float(mech.model.gravity.linear[1]))
        angle = [mpmath.fsum(map(mpf, bends[: k + 1])) for k in range(n)]
        rate = [mpmath.fsum(map(mpf, speeds[: k + 1])) for k in range(n)]
        m, rhs = mpmath.zeros(n), mpmath.zeros(n, 1)
        for i in range(n):
            for j in range(n):
                carried = mpmath.fsum(map(mpf, points[max(i, j):])) * lengths[i] * lengths[j]
                m[i, j] = carried * mpmath.cos(angle[i] - angle[j])
                rhs[i] -= carried * mpmath.sin(angle[i] - angle[j]) * rate[j] ** 2
            rhs[i] -= mpmath.fsum(map(mpf, points[i:])) * lengths[i] * g * mpmath.cos(angle[i])
        a = mpmath.lu_solve(m, rhs)
        return [a[0], *(a[k] - a[k - 1] for k in range(1, n))]


def off(got, want):
    size = max(abs(w) for w in want)
    return max(float(abs(mpf(float(g)) - w) / size) for g, w in zip(got, want, strict=True))


ENDS = (1e-17, 1e-9, 1.0, 1e6, 1e12, 1e15, 1e17)
CHAINS = [pytest.param(*numbers, id=name) for name, *numbers in (
    ("two, stretched", (1.0,), (0.4, 0.0), (1.0, 2.0), (1.0, 1.0)),
    ("two, folded back", (0.3,), (0.4, 0.0), (-1.0, 0.5), (0.7, 1.6)),
    ("two, nearly stretched", (1.0,), (0.9, 1e-9), (1.0, -2.0), (0.2, 1.1)),
    ("three, stretched", (1.0, 2.0), (0.4, 0.0, 0.0), (1.0, 2.0, -1.0), (1.0, 0.5, 2.0)),
    ("three, of micrometres", (1e-9, 1e-3), (2.0, 0.0, 0.0), (9.0, 2.0, 5.0), (1e-6, 3e-6, 2e-6)),
)]


@pytest.mark.parametrize("end", few(ENDS, 1e-17, 1.0, 1e12, 1e17))
@pytest.mark.parametrize("points, bends, speeds, lengths", CHAINS)
def test_a_heavy_end_of_a_chain_falls_as_lagrange_says(points, bends, speeds, lengths, end):
    mech, state = chain((*points, end), bends, speeds, lengths, lean=0.3)
    want = truth(mech, (*points, end), bends, speeds, lengths)
    found = sp.forward_dynamics(mech, state)
    assert off(found.a, want) <= found.error < 1e-9
    assert off(found.a, want) < 1e-13


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("end", few(ENDS, 1e-9, 1e15))
@pytest.mark.parametrize("points, bends, speeds, lengths", CHAINS)
def test_every_engine_gives_the_same_accelerations(
    points, bends, speeds, lengths, end, formulation
):
    mech, state = chain((*points, end), bends, speeds, lengths)
    a = sp.forward_dynamics(mech, state).a
    moved = sp.simulate(mech, state, 1e-12, times=[0.0],
                        accuracy=sp.Accuracy(formulation=formulation))
    np.testing.assert_allclose(moved.a[0], a, rtol=0.0, atol=1e-11 * np.abs(a).max())


@pytest.mark.parametrize("end", ENDS)
def test_uncertainty_by_round_off_is_reported_or_refused(end):
    """Heavy points pull at an angle on a light one between: the last bit of an angle matters."""
    numbers = (2.0, 1e14, end), (-0.4, 0.0, 0.7), (0.3, 2.0, -1.0), (1.0, 0.5, 2.0)
    mech, state = chain(*numbers)
    try:
        found = sp.forward_dynamics(mech, state)
    except sp.SingularError as error:
        assert "is lost in round-off beside bodies so much heavier" in str(error) and end > 1e13
    else:
        assert off(found.a, truth(mech, *numbers)) <= found.error < 1.0


@pytest.mark.parametrize("masses, size, angle, speed", [
    ((0.0155, 0.166, 3.67e-10), 2.36, 2.44, 1.65), ((3.6e6, 6.5e-17, 6.2e15), 7.5, 5.95, 3.0),
    ((1.67e-15, 1.54e-5, 1.33e-12), 1.85e-3, 3.91, 6.38), ((0.046, 2849.0, 2e-3), 0.05, 2.1, -4.0),
])
def test_the_error_reported_for_a_loop_bounds_its_error(masses, size, angle, speed):
    """Pivots tell how much grows in units of each freedom; light ones have large units."""
    mech = extremes.plane_four_bar(masses, size)
    state = sp.solve_rates(mech, sp.assemble(mech, {"crank": angle}), {"crank": speed})
    found = sp.forward_dynamics(mech, state)
    with mpmath.workdps(60):
        want, _ = extremes.exact_four_bar(list(map(mpf, masses)), size, angle, speed, 0.0)
        assert off(found.a, want) <= found.error < 1e-6
