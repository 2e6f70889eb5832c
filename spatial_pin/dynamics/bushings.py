"""Bushings: springs and dampers of two frames in all six directions.

The pose of frame 2 in frame 1 is x = (p, phi), its origin and the rotation vector of its axes. A
bushing has the potential x^T K x / 2 + x^T f0 and the forces F = K x + D x' + f0 by x: it pulls
frame 2 back by the force F_p and the moment J^-T F_phi, in the axes of frame 1 and about the origin
of frame 2, with J the left Jacobian of the rotation vector, omega = J phi' [Sola2018, (145)].
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Spring
from spatial_pin.numerics.linalg import Array

# Value of 1 - cos(angle) below which its functions are summed as series: closed forms lose digits.
SERIES = 0.1
TERMS = 24  # terms of these series: the last is 1e-30
# Entries of R whose difference is twice the sine of the rotation about x, y and z.
SINES = (((2, 1), (1, 2)), ((0, 2), (2, 0)), ((1, 0), (0, 1)))
Coefficients = dict[int, Array]


class Bushing(NamedTuple):
    """A bushing between frames of two bodies.

    Attributes:
        name: of the spring.
        bodies: their joints.
        placements: of its frames on these.
        stiffness, damping: (6, 6).
        preload: (6,).
    """

    name: str
    bodies: tuple[int, int]
    placements: tuple[pin.SE3, pin.SE3]
    stiffness: Array
    damping: Array
    preload: Array

    @classmethod
    def of(cls, mechanism: Mechanism, spring: Spring) -> Bushing:
        """Return the bushing of a spring with six components."""
        (i1, m1), (i2, m2) = (mechanism.centred_frame(f) for f in spring.frames)
        return cls(spring.name, (i1, i2), (m1, m2), bushing_matrix(spring.stiffness),
                   bushing_matrix(spring.damping), np.array(spring.preload or np.zeros(6), float))

    def pose(self, placements: Array) -> tuple[Array, pin.SE3, pin.SE3]:
        """Return x (6,) and the placements of its frames, from (njoints, 4, 3) those of joints."""
        first, second = (pin.SE3(placements[i, :3].T, placements[i, 3]) * m
                         for i, m in zip(self.bodies, self.placements, strict=True))
        between = first.actInv(second)
        return np.concatenate([between.translation, pin.log3(between.rotation)]), first, second

    def energy(self, placements: Array) -> float:
        """Return the energy that it stores [J]."""
        x, _, _ = self.pose(placements)
        return float(0.5 * x @ self.stiffness @ x + self.preload @ x)

    def wrench(self, placements: Array, twists: Array) -> Array:
        """Return the wrench (6,) on its second body about the world's origin.

        Args:
            placements: (njoints, 4, 3) of the joints.
            twists: (2, 6) of its bodies: velocity of the point at the world's origin, then angular
                velocity.
        """
        x, first, second = self.pose(placements)
        turn = first.rotation
        by_turn = pin.Jlog3(turn.T @ second.rotation).T  # phi' for an angular velocity
        moved = twists[1] - twists[0]
        rates = np.concatenate([
            turn.T @ (moved[:3] + np.cross(moved[3:], second.translation)),
            by_turn @ (turn.T @ moved[3:])])
        force = self.stiffness @ x + self.damping @ rates + self.preload
        linear, angular = -turn @ force[:3], -turn @ (by_turn.T @ force[3:])
        return np.concatenate([linear, angular + np.cross(second.translation, linear)])

    # ------------------------------------------------------------ by products of vectors

    @property
    def products(self) -> tuple[list[Coefficients], list[Coefficients]]:
        """Its twelve products A . B of vectors linear in the placements: p, then R by rows."""
        (i1, i2), (m1, m2) = self.bodies, self.placements
        axes = [[np.append(m.rotation[:, k], 0.0) for k in range(3)] for m in (m1, m2)]
        arm = {i2: np.append(m2.translation, 1.0)}
        arm[i1] = arm.get(i1, np.zeros(4)) - np.append(m1.translation, 1.0)
        a = [{i1: axis} for axis in axes[0]] + [{i1: axis} for axis in axes[0] for _ in range(3)]
        b = [arm] * 3 + [{i2: axis} for _ in range(3) for axis in axes[1]]
        return a, b

    def force_derivatives(self, values: Array, by_q: Array) -> tuple[Array, Array, Array]:
        """Return the derivatives of its forces.

        Args:
            values: (2, 12) its products and their rates.
            by_q: (2, 12, nv) their derivatives by q.

        Returns:
            (12,) forces by the products; (nv, nv) derivatives of the joint forces by q at constant
            forces by the products, and by v.
        """
        x, slopes, bent = self._functions(values[0])
        rows = slopes @ by_q[0]  # (6, nv)
        turned = np.einsum("imn,n->im", bent, values[1])  # rate of the slopes
        rates_by_q = slopes @ by_q[1] + turned @ by_q[0]
        force = self.stiffness @ x + self.damping @ (slopes @ values[1]) + self.preload
        changes = self.stiffness @ rows + self.damping @ rates_by_q
        along = np.einsum("i,imn->mn", force, bent)
        return (-force @ slopes, -rows.T @ changes - by_q[0].T @ along @ by_q[0],
                -rows.T @ self.damping @ rows)

    def _functions(self, values: Array) -> tuple[Array, Array, Array]:
        """Return x (6,), and its derivatives (6, 12) and (6, 12, 12) by the products."""
        slopes, bent = np.zeros((6, 12)), np.zeros((6, 12, 12))
        slopes[:3, :3] = np.eye(3)
        entries = values[3:].reshape(3, 3)
        g, g1, g2 = angle_over_sine(0.5 * (np.trace(entries) - 1.0))
        cosine = np.zeros(12)
        cosine[[3, 7, 11]] = 0.5
        x = np.zeros(6)
        x[:3] = values[:3]
        for k, (plus, minus) in enumerate(SINES):
            sine = np.zeros(12)
            sine[3 + 3 * plus[0] + plus[1]], sine[3 + 3 * minus[0] + minus[1]] = 0.5, -0.5
            s = float(sine @ values)
            x[3 + k] = g * s
            slopes[3 + k] = g1 * s * cosine + g * sine
            bent[3 + k] = g2 * s * np.outer(cosine, cosine) + g1 * (
                np.outer(cosine, sine) + np.outer(sine, cosine))
        return x, slopes, bent



def bushing_matrix(numbers: object) -> Array:
    """Return a stiffness or damping of a bushing as a matrix: six numbers are its diagonal."""
    found = np.array(numbers, float)
    if found.ndim == 0:
        return np.diag(np.full(6, float(found))) if found else np.zeros((6, 6))
    return np.diag(found) if found.ndim == 1 else found


def angle_over_sine(cosine: float) -> tuple[float, float, float]:
    """Return the angle over its sine as a function of the cosine, and two derivatives.

    Near 1 by its series in u = 1 - cosine, the sum of n! u^n / (2 n + 1)!!.
    """
    u = 1.0 - cosine
    if u < SERIES:
        g = g1 = g2 = 0.0
        term = 1.0  # n! / (2 n + 1)!!
        for n in range(TERMS):
            g += term * u**n
            g1 -= n * term * u ** max(n - 1, 0)
            g2 += n * (n - 1) * term * u ** max(n - 2, 0)
            term *= (n + 1) / (2 * n + 3)
        return g, g1, g2
    angle = float(np.arccos(max(cosine, -1.0)))
    sine = float(np.sin(angle))
    g1 = -(sine - angle * cosine) / sine**3
    return angle / sine, g1, (angle * sine**2 - 3.0 * cosine * (sine - angle * cosine)) / sine**5
