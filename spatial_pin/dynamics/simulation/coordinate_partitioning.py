"""Coordinate partitioning: independent joint coordinates of a closed mechanism [Wehage1982].

Also bodies that spin freely about a line of their own: their spin needs no integration.
A body that is symmetric about the line through its two ball joints (u, fixed in the body) keeps
the angular velocity about it, and the rest of the mechanism does not feel how it is turned about
it [Routh1905; Goldstein2002, 5.7]. With sigma that angular velocity, d = R u the line, R the body's
rotation relative to the one before it, all seen from there, and w(s) the relative angular velocity
per unit of the coordinate s at which the body has no spin,

    R' = [w s' + sigma d] R,      omega = R^T w s' + sigma u  in the body's own axes.

d and w are functions of s alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.assembly.close import close
from spatial_pin.assembly.state import State
from spatial_pin.assembly.undetermined import lost_rank_words, rank_loss
from spatial_pin.constraints.trees import is_large
from spatial_pin.dynamics.forces import Forces
from spatial_pin.errors import SingularError
from spatial_pin.kernel.kernel import kernel_of
from spatial_pin.kernel.loop_equations import LoopEquations, loops_at, loops_of
from spatial_pin.kernel.rate_solver import rates_of
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.resistance import resists
from spatial_pin.numerics.linalg import (
    Array,
    decompose,
    independent_rows,
    null_space,
    weighty_rows,
)
from spatial_pin.numerics.tolerances import TOLERANCES

NONE = 1e-13  # derivative of an equation that is round-off: others are of order one
PLAIN = 0.1  # a plain coordinate is chosen if its speed is this part of the fastest component's
FREE_SPIN = 1e-9  # largest change of closure equations per unit of a free spin: round-off
SPIN_TRIALS = 3  # other configurations at which a spin is checked to be free


class Freedoms:
    """The freedoms of a closed mechanism at a state, and which coordinates determine them best.

    Results at the last state are stored: new coordinates need them again.

    Args:
        mechanism: the mechanism.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        self._mechanism = mechanism
        self._state: State | None = None
        self._jacobian: Array = np.empty((0, 0))
        self._rows: NDArray[np.intp] = np.empty(0, np.intp)
        self._spaces: dict[bytes, Array] = {}  # freedoms, keyed by the held coordinates

    def equations(self, state: State) -> NDArray[np.intp]:
        """Return which closure equations are independent at a state."""
        if state is not self._state:
            with loops_of(self._mechanism, state.angles) as evaluation:
                evaluation.update(state.q)
                self._jacobian = evaluation.jacobian[: evaluation.constraints.n_closure].copy()
            self._state, self._spaces = state, {}
            if not (is_large(self._mechanism.model) and self._look_for_one_freedom(state)):
                self._rows = independent_rows(self._jacobian)
        return self._rows

    def _look_for_one_freedom(self, state: State) -> bool:
        """Whether the first joint of a large mechanism clearly moves all others.

        And only one choice of equations exists. Checked by rates, at a cost in proportion to the
        number of loops, not to its cube.
        """
        mechanism, nv = self._mechanism, self._mechanism.model.nv
        rows = np.flatnonzero(np.abs(self._jacobian).max(axis=1, initial=0.0) > NONE)
        with kernel_of(mechanism) as kernel:
            if kernel.n_passive or len(rows) != nv - 1:
                return False
            rates = rates_of(kernel, (0,), 1)
            rates.speeds[:], rates.accelerations[:] = 1.0, 0.0
            solved = rates.solve(state.q, state.angles)
            if solved is None:
                return False
            motion: Array = (solved.v / mechanism.velocity_scale)[None]
        self._rows = rows
        self._spaces[np.zeros((0, nv)).tobytes()] = motion / np.linalg.norm(motion)
        return True

    def best(self, state: State, prescribed: Sequence[int]) -> list[int]:
        """Return the velocity entries that determine the motion best, besides the prescribed ones.

        Column-pivoted QR of the freedoms: joints that move most.

        Args:
            state: where.
            prescribed: velocity entries that follow laws.

        Raises:
            SingularError: prescribed coordinates depend on each other, or the loops have lost rank.
        """
        drive = np.zeros((len(prescribed), self._mechanism.model.nv))
        drive[np.arange(len(prescribed)), list(prescribed)] = 1.0
        freedoms = self._without(state, drive)
        if not len(freedoms):
            return []
        return weighty_rows(freedoms.T, len(freedoms)).tolist()

    def plain(self, state: State, apart: Array) -> list[int]:
        """Return the velocity entries of single joints that can be the coordinate, fastest first.

        Args:
            state: where.
            apart: (k, nv) other freedoms; there is one more than these.

        Raises:
            SingularError: the loops have lost rank.
        """
        speeds = np.abs(self._without(state, apart)[0])
        plain = [c.v for c in self._mechanism.coordinate_table.values() if c.q >= 0]
        enough = PLAIN * speeds.max()
        return sorted((v for v in plain if speeds[v] > enough), key=lambda v: -speeds[v])

    def _without(self, state: State, drive: Array) -> Array:
        """Return orthonormal rows (n, nv), scaled, of the motions in which drive (k, nv) rests."""
        rows, key, name = self.equations(state), drive.tobytes(), self._mechanism.name
        if key in self._spaces:
            return self._spaces[key]
        with loops_of(self._mechanism, state.angles) as evaluation:
            if not self._spaces and (lost := rank_loss(evaluation, state.q, len(rows))):
                why = lost_rank_words(evaluation, state.q, lost, "forces")
                raise SingularError(f"mechanism {name!r}: {state}: {why}", state=state)
        svd = decompose(np.vstack([self._jacobian[rows], drive]))
        if svd.rank < len(rows) + len(drive):
            raise SingularError(
                f"mechanism {name!r}: the prescribed coordinates are not independent of each other "
                f"at {state}", state=state)
        self._spaces[key] = svd.null_space
        return self._spaces[key]


class Spins:
    """Bodies that spin freely about lines of their own.

    Args:
        model: of the mechanism.
        lines: by the ball joint that carries a body, the unit vector (3,) of its line in the body's
            axes; the line passes the joint's centre.

    Attributes:
        joints: the ball joints.
        axes: (k, 3) unit vectors of the lines.
        rows: (k, nv) the joint velocities that are the spins.
    """

    def __init__(self, model: pin.Model, lines: Mapping[int, Array]) -> None:
        self._model, self.joints = model, list(lines)
        self.axes = np.array(list(lines.values())).reshape(-1, 3)
        self.rows = np.zeros((len(lines), model.nv))
        for row, joint, axis in zip(self.rows, self.joints, self.axes, strict=True):
            row[model.idx_vs[joint]:][:3] = axis

    def __len__(self) -> int:
        return len(self.joints)

    def rates(self, q: Array, v: Array) -> list[float]:
        """Return sigma of every body [rad/s], at q (nq,) and v (nv,)."""
        if not self.joints:
            return []
        data = self._model.createData()
        pin.forwardKinematics(self._model, data, q, v)
        return [float(axis @ data.v[joint].angular)
                for joint, axis in zip(self.joints, self.axes, strict=True)]

    def quaternions(self, q: Array) -> list[Array]:
        """Return the quaternion (4,) of every body, at q (nq,)."""
        return [q[self._model.idx_qs[joint]:][:4] for joint in self.joints]


def free_spins(mechanism: Mechanism, state: State, forces: Forces) -> Spins:
    """Return the bodies that spin freely, symmetric about their lines.

    Each is carried by a ball joint that does not resist, carries none itself, and no spring holds
    it beside its line. A bushing holds its bodies about every line.
    """
    model, lines = mechanism.model, dict[int, Array]()
    if "spherical" not in mechanism.pairs:
        return Spins(model, lines)
    evaluation, carriers = loops_at(mechanism, state.q, state.angles), set(model.parents)
    for joint, pair in enumerate(mechanism.pairs, start=1):
        if pair == "spherical" and joint not in carriers:
            first = model.idx_vs[joint]
            own = evaluation.jacobian[: evaluation.constraints.n_closure, first : first + 3]
            axes = null_space(own, FREE_SPIN)
            if len(axes) == 1:  # its rotations about one line move no closure
                lines[joint] = axes[0]
    lines = {joint: axis for joint, axis in lines.items()
             if _is_symmetric(mechanism, joint, axis, forces)}
    spins = Spins(model, lines)
    return spins if _are_free_nearby(evaluation, state.q, spins) else Spins(model, {})


def _is_symmetric(mechanism: Mechanism, joint: int, axis: Array, forces: Forces) -> bool:
    """Whether neither inertia nor forces depend on how a body is turned about its line."""
    inertia, tolerance = mechanism.model.inertias[joint], TOLERANCES.tight

    def off_line(point: Array) -> float:
        return float(np.linalg.norm(point - (point @ axis) * axis))

    near = tolerance * mechanism.characteristic_length
    if resists(mechanism, joint) or any(joint in x.bodies for x in forces.bushings):
        return False
    if off_line(inertia.lever) > near:
        return False
    moments = inertia.inertia
    along = float(axis @ moments @ axis)
    across = 0.5 * (float(np.trace(moments)) - along)
    round_one = across * np.eye(3) + (along - across) * np.outer(axis, axis)
    if np.abs(moments - round_one).max() > tolerance * max(np.abs(moments).max(), 1e-300):
        return False
    return all(off_line(point[:3]) <= near for spring in forces.lines
               for body, point in zip(spring.bodies, spring.points, strict=True) if body == joint)


def _are_free_nearby(evaluation: LoopEquations, q: Array, spins: Spins) -> bool:
    """Whether the spins are free at other closed configurations too."""
    model, n = evaluation.model, evaluation.constraints.n_closure
    rng, free = np.random.default_rng(7), np.ones(model.nv, dtype=bool)
    for _ in range(SPIN_TRIALS if len(spins) else 0):
        step = evaluation.mechanism.velocity_scale * rng.uniform(-0.1, 0.1, model.nv)
        _, error = close(evaluation, pin.integrate(model, q, step), free, 1e-13)
        held = np.abs(evaluation.jacobian[:n] @ spins.rows.T).max(initial=0.0)
        if error > 1e-11 or held > FREE_SPIN:
            return False
    return True
