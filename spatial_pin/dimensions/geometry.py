"""What a mechanism is to the closure equations: numbers, and all else that is no number."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin.assembly.assemble import periodic
from spatial_pin.assembly.state import center_of_mass
from spatial_pin.constraints.closure_equations import Constraints, constraints_of
from spatial_pin.constraints.sample_coefficients import varying
from spatial_pin.constraints.stacked import Batch
from spatial_pin.constraints.vectorised_tree import FlatJoint, flat_tree_of
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array

NO_LIMIT = 1e300  # [rad]


class Geometry(NamedTuple):
    """The numbers that closure equations and outputs are made of, of one or of m mechanisms.

    Lengths are in m; the rows that measure a length are divided by a characteristic length which
    is the same for all.

    Attributes:
        joints: of the flat tree.
        coefficients: of `Batch`.
        constants: (r, 1) of `Batch`.
        points: (F, 3) all frames in the neutral configuration.
        offsets: (f, 3) points whose motion is asked for, in the axes of the joints `carriers`.
        limits: (2, n, 1) lower and upper limits of angles that count turns.
    """

    joints: list[FlatJoint]
    coefficients: Any
    constants: Any
    points: Any
    offsets: Any
    limits: Any

    def numbers(self) -> Array:
        """Return all numbers of one mechanism as one vector."""
        return np.concatenate([np.ravel(part) for part in self._parts()])

    def _parts(self) -> list[Any]:
        parts = [x for j in self.joints for x in (j.turned, j.offset, j.axis, j.pitch)]
        return [*parts, *self[1:]]

    def sizes(self, length: float) -> Array:
        """Return the size of numbers of each one's kind: `length` for lengths, 1 for directions."""
        joints = [np.full(np.size(x), size) for j in self.joints
                  for x, size in ((j.turned, 1.0), (j.offset, length), (j.axis, 1.0),
                                  (j.pitch, length))]
        rows = self.coefficients.reshape(len(self.coefficients), self.coefficients.shape[1] // 4, 4)
        flags = np.abs(rows[:, :, 3]).max(axis=1, initial=0.0)
        size = np.where(flags > 0.0, flags * length, np.abs(rows).max(axis=(1, 2), initial=0.0))
        rest = [np.full(np.size(x), s) for x, s in (
            (self.constants, 1.0), (self.points, length), (self.offsets, length),
            (self.limits, 1.0))]
        return np.concatenate([*joints, np.repeat(size, self.coefficients.shape[1]), *rest])

    def with_numbers(self, at: NDArray[np.intp], values: Array) -> Geometry:
        """Return the geometry of m mechanisms that differ in the numbers `at`, (len(at), m)."""
        parts, begin = [], 0
        for part in self._parts():
            end = begin + np.size(part)
            own = slice(*np.searchsorted(at, (begin, end)))
            places = tuple(int(k) for k in at[own] - begin)
            if np.ndim(part):
                parts.append(varying(part, places, values[own]))
            else:
                parts.append(values[own][0] if places else part)
            begin = end
        joints = [j._replace(**dict(zip(("turned", "offset", "axis", "pitch"),
                                        parts[4 * k : 4 * k + 4], strict=True)))
                  for k, j in enumerate(self.joints)]
        return Geometry(joints, *parts[4 * len(joints) :])


def is_length(constraints: Constraints) -> NDArray[np.bool_]:
    """Return (n_rows,) which closure rows are divided by the characteristic length."""
    mechanism = constraints.mechanism
    rows = [row.is_length for closure in mechanism.closures for row in closure.rows]
    coupled = [mechanism.coordinate(c.joints[1]).unit == "m" for c in constraints.couplings]
    return np.array([*rows, *coupled], dtype=bool)


def geometry_of(mechanism: Mechanism, points: Iterable[str], length: float) -> Geometry:
    """Return the geometry of one mechanism.

    Args:
        mechanism: the mechanism.
        points: links, frames or joints, or `LINK.com`, whose motion is asked for.
        length: characteristic length by which rows are divided.
    """
    constraints = constraints_of(mechanism)
    batch, n = Batch(constraints), len(constraints.constants)
    coefficients, constants = batch.coefficients.copy(), constraints.constants.copy()
    rows = np.flatnonzero(is_length(constraints)[: constraints.n_products])
    rows = np.append(rows, [product for _, product in constraints.elsewhere]).astype(np.intp)
    ratio = mechanism.characteristic_length / length
    coefficients[n + rows] *= ratio
    constants[rows] *= ratio
    model = mechanism.model
    neutral = batch.tree.place(mechanism.neutral[:, None])[batch.tree.carrier, :, :3, 0]
    places = [neutral[f.parentJoint, 3] + f.placement.translation @ neutral[f.parentJoint, :3]
              for f in model.frames]
    at = [c.q for c in periodic(mechanism)]
    bounds = np.array([model.lowerPositionLimit[at], model.upperPositionLimit[at]])
    return Geometry(
        flat_tree_of(mechanism).joints, coefficients, constants[:, None], np.array(places),
        np.array([_on_joint(mechanism, name)[1] for name in points]).reshape(-1, 3),
        np.clip(bounds, -NO_LIMIT, NO_LIMIT)[:, :, None],
    )


def _on_joint(mechanism: Mechanism, name: str) -> tuple[int, Array]:
    """Return the joint that carries a point and its place in the joint's axes [m]."""
    joint, placement = mechanism.frame_on_joint(name.removesuffix(".com"))
    if not name.endswith(".com"):
        return joint, placement.translation
    return joint, placement.act(center_of_mass(mechanism, name.removesuffix(".com")))


def carriers(mechanism: Mechanism, points: Iterable[str]) -> list[int]:
    """Return the joints that carry the points of `geometry_of`."""
    return [_on_joint(mechanism, name)[0] for name in points]


def kind_of(mechanism: Mechanism, points: Iterable[str]) -> tuple[Any, ...]:
    """Return all of a mechanism that must be alike for its geometry to be compared: no numbers."""
    c, model = constraints_of(mechanism), mechanism.model
    joints = flat_tree_of(mechanism).joints
    return (
        tuple((j.kind, j.parent, j.q, j.v) for j in joints), tuple(model.names),
        tuple(f.parentJoint for f in model.frames), tuple(carriers(mechanism, points)),
        c.labels, tuple((e.kind.code, e.products) for e in c.equations), c.c_abx.shape,
        tuple(Batch(c).bodies.tolist()), tuple(c.factors.flat),
        tuple((x.joints, x.ratio, x.offset) for x in c.couplings),
    )
