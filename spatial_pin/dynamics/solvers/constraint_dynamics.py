"""Forward dynamics by Pinocchio's `constraintDynamics`, where it is the same and costs less.

Pinocchio closes loops by points and welds. A spherical pair is a point, a hinge two points on its
axis, exactly: one of their six rows is too many. What is too many, there or in an overconstrained
loop, shows in the factors of the Delassus matrix G = J M^-1 J^T: a row that depends on those before
it has the pivot zero, or, with the proximal term mu, of the size of mu. So the pivots are counted:
as many small ones as there are rows too many, none between small and large, loops closed in
position and velocity; anywhere else the answer is left to `equations`, which knows about ranks.

`scripts/native_dynamics.py` measures both side by side.
"""

from __future__ import annotations

import math
from operator import truediv

import numpy as np
import pinocchio as pin
from numpy.lib.stride_tricks import as_strided

from spatial_pin.dynamics.solvers.kkt import ROUNDING
from spatial_pin.errors import ClosureTypeError
from spatial_pin.mechanism.inertia import MassMatrix
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.pairs import COUPLING, PAIRS
from spatial_pin.mechanism.parts import Closure
from spatial_pin.numerics.linalg import EPS, Array

ROWS = 90  # up to which Pinocchio's dense factors are the faster ones
PROXIMAL = 1e-12  # proximal term, by the largest pivot
STEPS = 4  # proximal steps at most; each takes off what the one before left, times the term
TOO_MANY = 1e-8  # pivots below this, by the largest, are of rows too many
DOUBTFUL = 1e-7  # estimated error, a bound on it, above which it is not believed
OPEN = 1e-10  # how far open loops may be, by the mechanism's size, and by its speed


def native_models(mechanism: Mechanism) -> list[pin.RigidConstraintModel]:
    """Return the closures as points and welds of Pinocchio, hinges as two points on their axis.

    Raises:
        ClosureTypeError: a closure is none of these.
    """
    found = []
    for closure in mechanism.closures:
        kind, offsets = _form(closure, mechanism)
        (i1, m1), (i2, m2) = (mechanism.frame_on_joint(f) for f in closure.frames)
        for first, second in offsets:
            found.append(pin.RigidConstraintModel(
                kind, mechanism.model, i1, m1 * _shift(first), i2, m2 * _shift(second),
                pin.ReferenceFrame.LOCAL))
    return found


def _form(
    closure: Closure, mechanism: Mechanism
) -> tuple[pin.ContactType, list[tuple[Array, Array]]]:
    """Return the kind of contact, and its places from the closure's two frames."""
    if closure.type != COUPLING and closure.pair.native is not None:
        return closure.pair.native, [(np.zeros(3), np.zeros(3))]
    if closure.type != COUPLING and closure.pair is PAIRS["revolute"]:
        assert closure.geometry is not None
        axes = [0.5 * mechanism.characteristic_length * x[:, 2]
                for x in (closure.geometry.axes1, closure.geometry.axes2)]
        return pin.ContactType.CONTACT_3D, [(s * axes[0], s * axes[1]) for s in (-1.0, 1.0)]
    raise ClosureTypeError(
        f"mechanism {mechanism.name!r}: closure {closure.name!r} is {closure.type}; only "
        "spherical, weld and revolute closures are points and welds")


def _shift(by: Array) -> pin.SE3:
    return pin.SE3(np.eye(3), by)


class NativeDynamics:
    """Pinocchio's containers for a mechanism, kept, and what tells whether to believe the answer.

    Args:
        mechanism: its closures are all native.
        mass: its mass matrix, and the model with it.
        models: from `native_models`.

    Attributes:
        rank: of the contacts at the last accelerations, by their pivots.
        error: estimated round-off of the last accelerations, by their size.
    """

    def __init__(
        self, mechanism: Mechanism, mass: MassMatrix, models: list[pin.RigidConstraintModel]
    ) -> None:
        self.rank = 0
        self.model, self._unit, self.error = mass.model, mass.unit, 0.0
        self.data = self.model.createData()
        self.models = pin.StdVec_RigidConstraintModel(models)
        self.datas = pin.StdVec_RigidConstraintData([m.createData() for m in models])
        pin.initConstraintDynamics(self.model, self.data, self.models, self.datas)
        self._factors = self.data.constraint_chol
        self._n = self._factors.constraintDim()
        self._inertias = self.data.M.diagonal()
        self._size = mechanism.characteristic_length
        self._by_scale = 1.0 / mechanism.velocity_scale
        self._squares = (mechanism.velocity_scale**2).tolist()
        self._open = self._errors()
        self.settings = pin.ProximalSettings(0.0, PROXIMAL * self._largest(mechanism), STEPS)
        self._rounding = ROUNDING + EPS * self._distance(mechanism)

    def _largest(self, mechanism: Mechanism) -> float:
        """Return the largest pivot of the contacts at neutral, 1 if there is none."""
        rest = np.zeros(self.model.nv)
        pin.constraintDynamics(self.model, self.data, mechanism.neutral, rest, rest, self.models,
                               self.datas, pin.ProximalSettings(0.0, PROXIMAL, 1))
        pivots = np.abs(self._factors.D[: self._n])
        return float(pivots.max()) if np.all(np.isfinite(pivots)) else 1.0

    def _distance(self, mechanism: Mechanism) -> float:
        """Return how far bodies are from the world's origin, at neutral, by their gyration radius.

        Pinocchio adds their inertias up there.
        """
        pin.computeSubtreeMasses(self.model, self.data)
        carried = np.repeat(self.data.mass.tolist(), self.model.nvs)
        own = self._inertias * mechanism.velocity_scale**2
        has = (own > 0.0) & (carried > 0.0)
        return self._size * float(np.sqrt((carried[has] / own[has]).max(initial=0.0)))

    def _errors(self) -> Array:
        """Return a view (n, 2, 6) on the errors of placements and velocities of the contacts."""
        first = self.datas[0]
        starts = [x.linear.__array_interface__["data"][0]
                  for x in (first.contact_placement_error, first.contact_velocity_error)]
        after = (self.datas[1].contact_placement_error.linear.__array_interface__["data"][0]
                 - starts[0] if len(self.datas) > 1 else 0)
        return as_strided(first.contact_placement_error.linear, (len(self.datas), 2, 6),
                          (after, starts[1] - starts[0], 8))

    def accelerations(self, q: Array, v: Array, force: Array) -> Array | None:
        """Return joint accelerations (nv,) under joint forces (nv,), None if they may be wrong."""
        if self._unit != 1.0:
            force = force / self._unit
        a = pin.constraintDynamics(self.model, self.data, q, v, force, self.models, self.datas,
                                   self.settings)
        return a.copy() if self._is_sound() and self._is_closed(v) else None

    def _is_sound(self) -> bool:
        """Whether the pivots are those of as many independent rows, on a mass matrix that is one.

        The inertia of a freedom, by what is left of it when those behind it move freely, and the
        largest pivot of the rows, by the smallest, are how much round-off grows; light freedoms
        have the round-off of the heavy ones' units besides. Comparisons are
        such that NaN fails them.
        """
        pivots = self._factors.D.tolist()
        masses, own = pivots[self._n :], [-x for x in pivots[: self._n]]
        largest = max(own)
        small = TOO_MANY * largest
        sound = [x for x in own if not x < small]
        self.rank = len(sound)
        if not (sound and min(masses) > 0.0):
            return False
        inertias = self._inertias.tolist()
        grown = max(map(truediv, inertias, masses)) * largest / min(sound)
        own = [x * y for x, y in zip(inertias, self._squares, strict=True)]
        self.error = self._rounding * grown * math.sqrt(max(own) / min(own))
        return self.error < DOUBTFUL

    def _is_closed(self, v: Array) -> bool:
        """Whether the loops are closed in position and velocity."""
        place, pace = np.einsum("ijk,ijk->j", self._open, self._open).tolist()
        size = OPEN * self._size
        speed = self._by_scale * v
        return bool(place <= size * size and pace <= size * size * speed.dot(speed))


def native_of(mechanism: Mechanism, mass: MassMatrix) -> NativeDynamics | None:
    """Return what solves a mechanism by `constraintDynamics`; None if it has no such form.

    Args:
        mechanism: the mechanism.
        mass: its mass matrix.
    """
    try:
        models = native_models(mechanism)
    except ClosureTypeError:
        return None
    if not models or sum(m.residualSize() for m in models) > ROWS:
        return None
    return NativeDynamics(mechanism, mass, models)
