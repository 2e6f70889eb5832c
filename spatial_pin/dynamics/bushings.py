"""Bushings: springs and dampers of two frames in all six directions.

The pose of frame 2 in frame 1 is x = (p, phi), its origin and the rotation vector of its axes. A
bushing has the potential x^T K x / 2 + x^T f0 and the forces F = K x + D x' + f0 by x: it pulls
frame 2 back by the force F_p and the moment J^-T F_phi, in the axes of frame 1 and about the origin
of frame 2, with J the left Jacobian of the rotation vector, omega = J phi' [Sola2018, (145)].

A spring on a component of a ball or floating joint is one of a single row: x is the pose of the
joint, and its coordinates are the entries of x.
"""

from __future__ import annotations

from collections.abc import Callable
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
Coefficients = dict[int, Array]  # of a vector: (4,) by joint
Law = Callable[[float, float], float]
Slopes = Callable[[str, float, float], tuple[float, float]]


class Bushing(NamedTuple):
    """A bushing between frames of two bodies, or of a component of a joint.

    Attributes:
        name: of the spring.
        bodies: their joints.
        placements: of its frames on these.
        stiffness, damping: (6, 6).
        preload: (6,).
        stored: energy where its frames coincide [J].
        component: of x that it acts on; None of a bushing.
        law: force of (component, rate), if it is not linear.
        energy_of: energy of the component [J]; None where a law stores none.
    """

    name: str
    bodies: tuple[int, int]
    placements: tuple[pin.SE3, pin.SE3]
    stiffness: Array
    damping: Array
    preload: Array
    stored: float = 0.0
    component: int | None = None
    law: Law | None = None
    energy_of: Callable[[float], float] | None = None

    @classmethod
    def of(cls, mechanism: Mechanism, spring: Spring, law: Law | None = None) -> Bushing:
        """Return a spring with six components, or on a component of a ball or floating joint."""
        if spring.joint is None:
            (i1, m1), (i2, m2) = (mechanism.centred_frame(f) for f in spring.frames)
            preload = np.array(spring.preload or np.zeros(6), float)
            return cls(spring.name, (i1, i2), (m1, m2), bushing_matrix(spring.stiffness),
                       bushing_matrix(spring.damping), preload)
        coordinate, model = mechanism.prescribed_coordinate(spring.joint), mechanism.centred_model
        joint = mechanism.joint_id(coordinate.joint)
        k = coordinate.component + (3 if mechanism.pair_of(coordinate.joint) == "spherical" else 0)
        alone = np.zeros((6, 6))
        alone[k, k] = 1.0 if spring.is_linear and law is None else 0.0
        return cls(
            spring.name, (int(model.parents[joint]), joint),
            (model.jointPlacements[joint], pin.SE3.Identity()), spring.stiffness * alone,
            spring.damping * alone, -spring.stiffness * spring.free * alone[k],
            0.5 * spring.stiffness * spring.free**2 * alone[k, k], k,
            law or (None if spring.is_linear else spring.force), None if law else spring.energy)

    @property
    def is_linear(self) -> bool:
        """Whether its force is linear in x and its rate."""
        return self.law is None

    @property
    def jumps(self) -> bool:
        """Whether its energy jumps where it is wound beyond half a turn."""
        turns_by_law = self.law is not None and self.component is not None and self.component > 2
        return turns_by_law or bool(self.stiffness[:3, 3:].any() or self.preload[3:].any())

    def pose(self, placements: Array) -> tuple[Array, pin.SE3, pin.SE3]:
        """Return x (6,) and the placements of its frames, from (njoints, 4, 3) those of joints."""
        first, second = (pin.SE3(placements[i, :3].T, placements[i, 3]) * m
                         for i, m in zip(self.bodies, self.placements, strict=True))
        between = first.actInv(second)
        return np.concatenate([between.translation, pin.log3(between.rotation)]), first, second

    def energy(self, placements: Array) -> float:
        """Return the energy that it stores [J]."""
        x, _, _ = self.pose(placements)
        if self.component is not None and self.law:
            return self.energy_of(float(x[self.component])) if self.energy_of else 0.0
        return float(0.5 * x @ self.stiffness @ x + self.preload @ x + self.stored)

    def force(self, x: Array, rates: Array) -> Array:
        """Return F (6,) at x and its rates (6,)."""
        force: Array = self.stiffness @ x + self.damping @ rates + self.preload
        if self.component is not None and self.law:
            force[self.component] = self.law(float(x[self.component]),
                                             float(rates[self.component]))
        return force

    def wrench(self, placements: Array, twists: Array) -> Array:
        """Return the wrench (6,) on its second body about the world's origin.

        Twists (2, 6) of its bodies are: velocity of the point there, then angular velocity.
        """
        x, first, second = self.pose(placements)
        turn = first.rotation
        by_turn = pin.Jlog3(turn.T @ second.rotation).T  # phi' for an angular velocity
        moved = twists[1] - twists[0]
        rates = np.concatenate([
            turn.T @ (moved[:3] + np.cross(moved[3:], second.translation)),
            by_turn @ (turn.T @ moved[3:])])
        force = self.force(x, rates)
        linear, angular = -turn @ force[:3], -turn @ (by_turn.T @ force[3:])
        return np.concatenate([linear, angular + np.cross(second.translation, linear)])

    # ------------------------------------------------------------ by products of vectors

    @property
    def vectors(self) -> tuple[Array, Array]:
        """(12, 4) vectors A on body 1 and B on body 2, by placements: x is made of A . B.

        The axes of frame 1 with the origin of frame 2, which counts from that of frame 1, for p;
        then with the axes of frame 2, for R by rows.
        """
        first, second = (np.column_stack([m.rotation.T, np.zeros(3)]) for m in self.placements)
        end = np.append(self.placements[1].translation, 1.0)
        return (np.vstack([first, np.repeat(first, 3, axis=0)]),
                np.vstack([np.tile(end, (3, 1)), np.tile(second, (3, 1))]))

    @property
    def products(self) -> tuple[list[Coefficients], list[Coefficients]]:
        """Its twelve products A . B, by the bodies that the vectors are on."""
        (i1, i2), (a, b) = self.bodies, self.vectors
        arm = {i2: b[0], i1: -np.append(self.placements[0].translation, 1.0)}
        return [{i1: x} for x in a], [arm] * 3 + [{i2: x} for x in b[3:]]

    def force_derivatives(
        self, values: Array, by_q: Array, slopes_of: Slopes
    ) -> tuple[Array, Array, Array]:
        """Return its forces (12,) by the products, and their derivatives (12, nv) by q and v.

        `values` (2, 12) are its products and their rates, `by_q` (2, 12, nv) their derivatives;
        `slopes_of` returns those of its law at its name, component and rate.
        """
        x, slopes, bent = pose_by_products(values[0])
        rows = slopes @ by_q[0]  # (6, nv)
        turned = np.einsum("imn,n->im", bent, values[1])  # rate of the slopes
        rates_by_q, rates = slopes @ by_q[1] + turned @ by_q[0], slopes @ values[1]
        stiffness, damping, k = self.stiffness.copy(), self.damping.copy(), self.component
        if k is not None and self.law:
            stiffness[k, k], damping[k, k] = slopes_of(self.name, float(x[k]), float(rates[k]))
        force = self.force(x, rates)
        changes = stiffness @ rows + damping @ rates_by_q
        along = np.einsum("i,imn->mn", force, bent)
        return (-force @ slopes, -slopes.T @ changes - along @ by_q[0],
                -slopes.T @ damping @ rows)


def pose_by_products(values: Array) -> tuple[Array, Array, Array]:
    """Return the pose x (6,) of a bushing by its products (12,), and two derivatives."""
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
    matrix = np.array(numbers, float)
    if matrix.ndim == 0:
        return np.diag(np.full(6, float(matrix))) if matrix else np.zeros((6, 6))
    return np.diag(matrix) if matrix.ndim == 1 else matrix


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
