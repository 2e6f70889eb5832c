"""Inertias of any size, their sums, and the kinetic energy.

Bodies lighter than 2.2e-16 kg, a nanometre machine's, Pinocchio adds wrongly: the centre of mass of
a sum of two `pin.Inertia` is divided by a mass of at least that much. Here masses are counted in a
power of two that makes the lightest about one, which changes no digit of any other.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np
import pinocchio as pin

from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES

# Powers of two between masses that numbers have room for. Squares of lengths take the rest of the
# 1022.
WIDEST = 600


def put_inertias(model: pin.Model, links: Mapping[str, pin.Inertia]) -> None:
    """Set the inertia that every joint of a tree carries from those of its links."""
    parts: list[list[pin.Inertia]] = [[] for _ in range(model.njoints)]
    for frame in model.frames:
        if frame.type == pin.FrameType.BODY and frame.name in links:
            parts[frame.parentJoint].append(frame.placement.act(links[frame.name]))
    for joint, inertias in enumerate(parts):
        if inertias:
            given = sorted(inertias, key=lambda x: x.mass < 0.0)  # no partial sum below zero
            unit, total = _unit(x.mass for x in given), pin.Inertia.Zero()
            for inertia in given:
                total = total + _times(inertia, 1.0 / unit)
            model.inertias[joint] = _times(total, unit)


def moving_mass(model: pin.Model) -> float:
    """Return the mass of all moving links together, as `pin.computeTotalMass` [kg]."""
    return float(sum(body.mass for body in list(model.inertias)[1:]))


def remainder(total: pin.Inertia, parts: Iterable[pin.Inertia]) -> pin.Inertia | None:
    """Return an inertia minus its parts, zero for round-off; None where it is no inertia."""
    given = [total, *parts]
    if len(given) == 1:
        return total
    matrices = np.array([x.toPseudoInertia().toMatrix() for x in given])
    masses, moments = matrices[:, 3, 3], np.abs(matrices[:, :3, :3]).max(axis=(1, 2))
    heavy = masses.max() > 0.0 and moments.max() > 0.0
    length = math.sqrt(moments.max() / masses.max()) if heavy else 1.0  # of the bodies, about
    scale = np.array([1.0 / length] * 3 + [1.0])
    matrices *= scale[:, None] * scale
    rest, least = matrices[0] - matrices[1:].sum(axis=0), TOLERANCES.tight * np.abs(matrices).max()
    if np.abs(rest).max() <= least:
        return pin.Inertia.Zero()
    mass, first, second = rest[3, 3], rest[:3, 3], rest[:3, :3]
    if mass < least:
        if mass < -least or np.abs(first).max() > least:
            return None
        mass, first = 0.0, np.zeros(3)
    lever = first / mass if mass else first
    second = second - mass * np.outer(lever, lever)
    if np.linalg.eigvalsh(second)[0] < -least:
        return None
    return inertia_as_given(mass, length * lever,
                      length**2 * (np.trace(second) * np.eye(3) - second))


def _unit(masses: Iterable[float]) -> float:
    """Return a power of two [kg] that is at most, and near to, the least mass that is not zero."""
    present = [m for m in masses if m > 0.0] or [1.0]
    return 2.0 ** math.floor(max(math.log2(min(present)), math.log2(max(present)) - WIDEST))


def _times(inertia: pin.Inertia, factor: float) -> pin.Inertia:
    return inertia_as_given(inertia.mass * factor, inertia.lever, inertia.inertia * factor)


def inertia_as_given(mass: float, lever: Array, matrix: Array) -> pin.Inertia:
    """Return an inertia of any mass [kg], lever (3,) [m] and matrix (3, 3) about it [kg·m²].

    Pinocchio's constructor refuses negative ones.
    """
    made = pin.Inertia(mass, lever, np.zeros((3, 3)))
    made.inertia = 0.5 * (matrix + matrix.T)
    return made


def fall_energy(model: pin.Model, height: float) -> float:
    """Return the energy [J] that all bodies of a tree release in a fall over a height [m]."""
    return float(np.linalg.norm(model.gravity.linear)) * height * sum(
        body.mass for body in model.inertias)


class KineticEnergy:
    """`pin.computeKineticEnergy` of a tree with armatures, which Pinocchio 4.1 leaves out."""

    def __init__(self, model: pin.Model) -> None:
        self._armature = model.armature.copy()
        self._model, self._data = model, model.createData()
        if np.any(self._armature):
            self._model = model.copy()
            self._model.armature = np.zeros(model.nv)

    def __call__(self, q: Array, v: Array, data: pin.Data | None = None) -> float:
        """Return the energy [J] at q (nq,) and v (nv,); `data` gets the bodies' placements."""
        at = self._data if data is None else data
        bodies = float(pin.computeKineticEnergy(self._model, at, q, v))
        return bodies + 0.5 * float(v @ (self._armature * v))
