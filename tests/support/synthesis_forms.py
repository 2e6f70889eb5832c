"""Closed forms of dimensional synthesis, independent of the library.

Function generators: [Freudenstein1955] of the plane four-bar and its spatial counterpart of the
RSSR [DenavitHartenberg1960], linear in three combinations of lengths. Poses in the plane: the
centre-point curve of four and all dyads of five [BottemaRoth1979], by 40 digits. Paths: the coupler
curve of the four-bar in the numbers of [Cabrera2002], and its error against given points. The cases
of `data/synthesis/cases.toml` are those of [Cabrera2002], [KunjurKrishnamurty1997],
[YuTangWang2007], [Bulatovic2016], [MorganWampler1990] and [Breiding2019], with dimensions found by
[Mejia2018] among others.
"""

from __future__ import annotations

import tomllib
from typing import NamedTuple

import numpy as np
import synthesis_forms as forms
from folders import DATA
from mpmath import cos, log, matrix as mp_matrix, mp, mpc, mpf, radians, sin, sqrt
from scipy.optimize import minimize_scalar

DIGITS = 40
SYNTHESIS = DATA / "synthesis"
CASES = tomllib.loads((SYNTHESIS / "cases.toml").read_text(encoding="utf-8"))


# ---------------------------------------------------------------- function generators


class FunctionGenerator(NamedTuple):
    """Lengths of a loop that generates a function; a negative one points the other way."""

    a: float  # input crank
    b: float  # coupler
    c: float  # output crank
    d: float  # distance of the two axes


def function_generator(phi, psi, alpha=0, d=1) -> FunctionGenerator:
    """The RSSR whose output is at psi where its input is at phi, at three pairs of angles [rad].

    Both cranks lie in the planes through the common normal of the axes; alpha is their twist [rad],
    at 0 the linkage is the plane four-bar. With A = a (cos phi, sin phi, 0) and
    B = (d, 0, 0) + c (cos psi, cos alpha sin psi, sin alpha sin psi), |A - B| = b says
        k1 cos psi - k2 cos phi + k3 = cos phi cos psi + cos alpha sin phi sin psi,
    k1 = d / a, k2 = d / c, k3 = (a² + c² + d² - b²) / (2 a c).
    """
    with mp.workdps(DIGITS):
        pairs = [(mpf(x), mpf(y)) for x, y in zip(phi, psi, strict=True)]
        alpha, d = mpf(alpha), mpf(d)
        rows = [[cos(y), -cos(x), mpf(1)] for x, y in pairs]
        right = [cos(x) * cos(y) + cos(alpha) * sin(x) * sin(y) for x, y in pairs]
        k1, k2, k3 = mp.lu_solve(mp_matrix(rows), mp_matrix(right))
        a, c = d / k1, d / k2
        return FunctionGenerator(a, sqrt(a**2 + c**2 + d**2 - 2 * a * c * k3), c, d)


def generated(generator: FunctionGenerator, phi, psi, alpha=0):
    """Distance of the two balls less the coupler's length, at one pair of angles."""
    a, b, c, d = generator
    A = [a * cos(phi), a * sin(phi), 0]
    B = [d + c * cos(psi), c * cos(alpha) * sin(psi), c * sin(alpha) * sin(psi)]
    return sqrt(sum((x - y) ** 2 for x, y in zip(A, B, strict=True))) - b


def chebyshev_points(start, end, count: int = 3) -> list:
    """Precision points between two ends, spaced as the zeros of Chebyshev's polynomial."""
    return [(mpf(start) + end) / 2 - (mpf(end) - start) / 2 * cos(mp.pi * (2 * i + 1) / (2 * count))
            for i in range(count)]


# ---------------------------------------------------------------- poses in the plane


class Dyad(NamedTuple):
    """A crank that guides a body: centre point in the ground, circle point in the body [m]."""

    centre: complex
    circle: complex

    def length(self, pose) -> float:
        """Length of the crank at a pose (x + iy, angle)."""
        return abs(pose[0] + mp.expj(pose[1]) * self.circle - self.centre)


def _circle_equations(poses) -> list[list]:
    """One row a pose but the first: coefficients of (P, Q, u, v, x, y, 1), of which the sum is 0.

    The circle point w = u + iv of the body is at the same distance from the centre g = x + iy at
    every pose p + e^{ia} w as at the first, where the body's axes are those of the ground; with
    P = xu + yv and Q = yu - xv this is linear.
    """
    first, turn = poses[0][0], poses[0][1]
    rows = []
    for p, angle in poses[1:]:
        t, e = (p - first) * mp.expj(-turn), mp.expj(angle - turn)
        s = mp.conj(t) * e
        rows.append([1 - e.real, -e.imag, s.real, -s.imag, -t.real, -t.imag, abs(t) ** 2 / 2])
    return rows


def centre_curve(poses, centre):
    """Value of the cubic of four poses at a centre point: 0 where some circle point exists.

    Poses are (x + iy, angle) of the body. It is the determinant of the three linear equations that
    the circle point's two coordinates obey.
    """
    with mp.workdps(DIGITS):
        poses = [(mpc(p), mpf(a)) for p, a in poses]
        g = (mpc(centre) - poses[0][0]) * mp.expj(-poses[0][1])
        rows = [[cP * g.real + cQ * g.imag + cu, cP * g.imag - cQ * g.real + cv,
                 cx * g.real + cy * g.imag + c]
                for cP, cQ, cu, cv, cx, cy, c in _circle_equations(poses)]
        return mp.det(mp_matrix(rows))


def burmester_dyads(poses) -> list[Dyad]:
    """All real dyads of five poses (x + iy, angle) of a body in the plane: none, two or four.

    The four equations leave a plane of solutions in (P, Q, u, v, x, y, 1); P = xu + yv and
    Q = yu - xv are two conics in it, which meet in at most four points.
    """
    with mp.workdps(DIGITS):
        poses = [(mpc(p), mpf(a)) for p, a in poses]
        basis = _null_space(_circle_equations(poses))
        conics = [_conic(basis, product) for product in (_first_product, _second_product)]
        found = []
        for z in _meeting_points(*conics):
            u, v, x, y, one = (sum(c * row[k] for c, row in zip(z, basis, strict=True))
                               for k in range(2, 7))
            if abs(one) < mpf(10) ** (-DIGITS // 3) * max(map(abs, (u, v, x, y, one))):
                continue  # at infinity
            centre = poses[0][0] + mp.expj(poses[0][1]) * mpc(x / one, y / one)
            found.append(Dyad(centre, mpc(u / one, v / one)))
        return found


def _first_product(z, w):
    return z[0] * w[6] - z[4] * w[2] - z[5] * w[3]


def _second_product(z, w):
    return z[1] * w[6] - z[5] * w[2] + z[4] * w[3]


def _null_space(rows) -> list[list]:
    """Three vectors that span what four equations in seven unknowns leave."""
    _, _, V = mp.svd_r(mp_matrix([*rows, *[[mpf(0)] * 7] * 3]))
    return [list(V[k, :]) for k in (4, 5, 6)]


def _conic(basis, product) -> list[list]:
    """Symmetric 3x3 matrix of a product in the coordinates of a basis."""
    return [[(product(p, q) + product(q, p)) / 2 for q in basis] for p in basis]


def _meeting_points(C, D) -> list[tuple]:
    """Real points (s, t, 1) in which two conics meet: roots of the resultant, a quartic in t."""
    a, b = ([[M[0][0]], [2 * M[0][2], 2 * M[0][1]], [M[2][2], 2 * M[1][2], M[1][1]]]
            for M in (C, D))  # of s², s and 1, by powers of t

    def cross(i, j):
        return _less(_times(a[i], b[j]), _times(a[j], b[i]))

    quartic = _less(_times(cross(0, 2), cross(0, 2)), _times(cross(0, 1), cross(1, 2)))
    found = []
    for root in np.roots([float(x) for x in quartic[::-1]]):
        if abs(root.imag) < 1e-9 * max(1, abs(root)):
            t = mp.findroot(lambda x: _value(quartic, x), mpf(root.real))
            at = [_value(f, t) for f in (cross(0, 1), cross(0, 2))]
            found.append((-at[1] / at[0], t, mpf(1)))
    return found


def _times(p, q):
    out = [mpf(0)] * (len(p) + len(q) - 1)
    for i, x in enumerate(p):
        for j, y in enumerate(q):
            out[i + j] += x * y
    return out


def _less(p, q):
    size = max(len(p), len(q))
    p, q = ([*r, *[mpf(0)] * (size - len(r))] for r in (p, q))
    return [x - y for x, y in zip(p, q, strict=True)]


def _value(p, t):
    return sum(x * t**k for k, x in enumerate(p))


# ---------------------------------------------------------------- coupler curves


class FourBar(NamedTuple):
    """Plane four-bar in the numbers of [Cabrera2002]; lengths in one unit, angles in rad."""

    r1: float  # ground
    r2: float  # crank
    r3: float  # coupler
    r4: float  # rocker
    cx: float  # tracer, along the coupler from the crank's tip
    cy: float  # tracer, to the left of the coupler
    theta0: float  # angle of the ground link
    x0: float  # pivot of the crank
    y0: float


def coupler_points(bar: FourBar, crank, side: int = 1) -> np.ndarray:
    """Points x + iy of the tracer at angles of the crank against the ground link.

    `side`: 1 with the rocker's tip to the left of the line from the crank's tip to the rocker's
    pivot, -1 to the right. NaN where the loop does not close.
    """
    tip = bar.r2 * np.exp(1j * np.asarray(crank))
    rest = bar.r1 - tip
    with np.errstate(invalid="ignore"):
        coupler = np.angle(rest) + side * np.arccos(
            (bar.r3**2 + abs(rest) ** 2 - bar.r4**2) / (2 * bar.r3 * abs(rest)))
    return (bar.x0 + 1j * bar.y0
            + np.exp(1j * bar.theta0) * (tip + (bar.cx + 1j * bar.cy) * np.exp(1j * coupler)))


def timed_error(bar: FourBar, points, crank, side: int = 1) -> float:
    """Sum of squared distances [unit²] of points (k, 2) from the tracer at given crank angles."""
    z = np.asarray(points) @ [1, 1j]
    return float(np.sum(abs(coupler_points(bar, crank, side) - z) ** 2))


def free_error(bar: FourBar, points, side: int = 1) -> float:
    """Sum of squared distances [unit²] of points (k, 2) from the coupler curve (of one circuit)."""
    grid = np.linspace(0, 2 * np.pi, 20001)
    curve = coupler_points(bar, grid, side)
    total = 0.0
    for z in np.asarray(points) @ [1, 1j]:
        near = grid[np.nanargmin(abs(curve - z))]
        best = minimize_scalar(lambda t, z=z: abs(coupler_points(bar, t, side) - z) ** 2,
                               bounds=(near - 1e-3, near + 1e-3), method="bounded",
                               options={"xatol": 1e-12})
        total += float(best.fun)
    return total


def published(case: dict) -> FourBar:
    """Dimensions that a case's source gives; its tracer may stand in polar coordinates."""
    given = dict(case["published"])
    given.pop("crank", None)
    if "length" in given:
        tracer = given.pop("length") * np.exp(1j * given.pop("angle"))
        given |= {"cx": float(tracer.real), "cy": float(tracer.imag)}
    return FourBar(**given)



def logarithm(start, swing, to, by):
    """Three pairs of angles [rad] that generate y = log2 x, 1 <= x <= 2, from degrees."""
    x = forms.chebyshev_points(1, 2)
    return ([radians(start + swing * (u - 1)) for u in x],
            [radians(to + by * log(u, 2)) for u in x])
