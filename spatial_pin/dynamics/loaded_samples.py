"""What acts on the samples of a motion: solved in the kernel, some hundred samples in a call.

A sample that needs more than one system of equations is solved by itself, as a State is: where
masses differ much, passive freedoms turn under forces, or actuators share their work.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin._support.checks import as_array, is_finite, mapping
from spatial_pin._support.lazy import acquired
from spatial_pin.assembly.state import State, angles_of, moving_in_time
from spatial_pin.constraints.kernel_tree import KernelTree, TreeSprings, centred_tree
from spatial_pin.dynamics.forces import Law, forces_on_frames, joint_efforts
from spatial_pin.dynamics.reactions import Poses
from spatial_pin.dynamics.solvers.equations_of_motion import DOUBTFUL, Equations, Solution
from spatial_pin.errors import SpatialPinError
from spatial_pin.kernel.kernel import Kernel
from spatial_pin.kernel.kkt import ERROR, FAILED, RANK, Accelerated
from spatial_pin.kernel.library import numbers
from spatial_pin.kernel.loop_equations import joint_rows, row_wrenches
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.resistance import SlipSpeed
from spatial_pin.motion.motion import Motion
from spatial_pin.numerics.linalg import Array, solved_transposed

SAMPLES_AT_ONCE = 256  # samples that are solved in one call: their arrays stay in the cache

External = Mapping[str, Any] | Callable[..., Mapping[str, pin.Force]]
Loads = tuple[External | None, Mapping[str, Law] | None, SlipSpeed | None]
# Forces at frames of a sample, by its number and its State.
ForcesAt = Callable[[int, State], Mapping[str, pin.Force]]


class SampleBlock(NamedTuple):
    """Samples that are solved together, and the forces that act on them besides efforts.

    Attributes:
        at: numbers of the samples of the motion.
        q, v, angles: (k, ...) configurations, joint velocities, angles of screws.
        given: (k, nv) joint forces of springs, resistance and forces from outside.
        turning: (k, nv) those of springs about joints and of resistance.
        wrenches: (k, njoints, 6) those on bodies, at the world's origin.
    """

    at: slice
    q: Array
    v: Array
    angles: Array
    given: Array
    turning: Array
    wrenches: Array


class LoadedSamples:
    """Samples of a motion under forces, with the reactions that these cause.

    Args:
        mechanism: the mechanism of the motion, as the user loaded it.
        motion: the motion.
        equations: of its mechanism.
        bearing: of all equations of the file.
        loads: forces at frames, laws of springs, slip speed.
        n_efforts: how many efforts there are.

    Attributes:
        v, given_a: (N, nv) rates of the motion in time; zero where it is none.
        a, efforts, multipliers, error: (N, ...) of the samples that are done.
        reactions, unique: (N, pairs, 6); on_ground: (N, 6).
        done: how many there are; at: the sample that the equations are at.
    """

    def __init__(
        self, mechanism: Mechanism, motion: Motion, equations: Equations, bearing: Equations,
        loads: Loads, n_efforts: int,
    ) -> None:
        external, self._laws, self._slip_speed = loads
        self.mechanism, self.motion = mechanism, motion
        self.equations, self.bearing = equations, bearing
        self._external = forces_at(mechanism, motion, external)
        n, nv, pairs = len(motion), bearing.model.nv, len(bearing.pairs.names)
        moving = motion.per == "s"
        self.v = motion.v if moving else np.zeros((n, nv))
        self.given_a = motion.a if moving else np.zeros((n, nv))
        self.efforts, self.a = np.empty((n, n_efforts)), np.empty((n, nv))
        self.multipliers, self.error = np.empty((n, bearing.n_closure)), np.empty(n)
        self.reactions, self.on_ground = np.empty((n, pairs, 6)), np.empty((n, 6))
        self.unique = np.ones((n, pairs, 6), dtype=bool)
        self.done = self.at = 0
        self.is_together = bearing is equations and not equations.is_large  # solved in the kernel

    def state(self, k: int) -> State:
        """Return sample k, which errors name from now on."""
        self.at = k
        return moving_in_time(self.mechanism, self.motion.state(k))

    def _set_sample(self, k: int) -> None:
        """Move the equations to sample k, under its forces."""
        state = self.state(k)
        external = self._external(k, state) if self._external else None
        for each in {self.equations, self.bearing}:
            each.update(state, external, self._laws, self._slip_speed)

    def solve(
        self, together: Callable[[SampleBlock], tuple[Array, Accelerated] | None],
        alone: Callable[[int], tuple[Array, Solution, Array]],
    ) -> None:
        """Solve all samples, some hundred in a call where the kernel can.

        `together` returns efforts (k, nv) at joints, and the solution, of a block; None where it
        has none, or a doubtful one. `alone` returns those of one sample, where the equations are,
        and efforts (m, nv) at joints that balance each other.
        """
        bearing, n = self.bearing, len(self.motion)
        size = SAMPLES_AT_ONCE if self.is_together else 1
        for first in range(0, n, size):
            if not (first and self.is_together):  # the first one sets the laws of springs
                self._set_sample(first)
            piece = self._loaded(slice(first, min(first + size, n)))
            solution = together(piece) if self.is_together else None
            if solution is not None:
                self._take(piece, *solution)
            else:  # one by one; their reactions follow together
                forces = []
                for k in range(piece.at.start, piece.at.stop):
                    if self.is_together:
                        self._set_sample(k)
                    at_joints, (self.a[k], closures, self.error[k]), internal = alone(k)
                    if bearing.pairs.coupled or len(internal) or (
                            bearing.n_closure and bearing.spaces.rank < bearing.n_closure):
                        self.unique[k] = list(bearing.unique(internal).values())
                    forces.append((at_joints, closures))
                joints, closed = map(np.array, zip(*forces, strict=True))
                self._bear(piece, joints, closed, None)
            self.done = piece.at.stop

    def _loaded(self, at: slice) -> SampleBlock:
        """Return samples with the forces that act on them."""
        equations, motion, springs = self.equations, self.motion, self.equations.springs
        k, q, v, angles = at.stop - at.start, motion.q[at], self.v[at], angles_of(motion)[at]
        if not self.is_together:  # one sample, where the equations are
            return SampleBlock(at, q, v, angles, equations.given[None], equations.turning[None],
                               self.bearing.pairs.summed(equations.wrenches)[None])
        turning = np.zeros((k, equations.model.nv))
        wrenches = np.zeros((k, equations.model.njoints, 6))
        if springs.exist:
            turning[:] = [springs.turning(*x) for x in zip(q, v, strict=True)]
        given = turning.copy()
        if self._external or springs.on_frames:
            found = None if self._external else _spring_wrenches(equations, q, v)
            if found is not None:
                wrenches, forces = found
                given += forces
            for row in range(k if found is None else 0):
                self._set_sample(at.start + row)
                given[row] = equations.given
                wrenches[row] = equations.pairs.summed(equations.wrenches)
        return SampleBlock(at, q, v, angles, given, turning, wrenches)

    def _take(self, piece: SampleBlock, at_joints: Array, solution: Accelerated) -> None:
        """Take accelerations and efforts (k, nv) at joints of a piece that the kernel solved."""
        equations, at = self.equations, piece.at
        self.a[at], self.error[at] = solution.a, solution.facts[:, ERROR]
        ranks, n = solution.facts[:, RANK].astype(np.int64), equations.n_closure
        equations.ranks.check_many(ranks, piece.q, lambda k: self.state(at.start + k))
        multipliers = None if n and ranks.min() < n else solution.multipliers
        poses, rows, stresses = self._bear(piece, at_joints, solution.closures, multipliers)
        if stresses is not None:
            marks = equations.pairs.unstressed(Poses(*(x[:, None] for x in poses)), rows, stresses)
            for pair, each in enumerate(equations.pairs.beside_couplings(marks, poses).values()):
                self.unique[at, pair] = each
            return
        for k in range(at.start, at.stop):  # ranks differ
            self._set_sample(k)
            self.unique[k] = list(equations.unique().values())

    def _bear(
        self, piece: SampleBlock, at_joints: Array, closures: Array, multipliers: Array | None
    ) -> tuple[Poses, Array, Array | None]:
        """Find the reactions of a piece, and the shortest multipliers if there are none.

        Returns poses, `LoopEquations.joint_rows` (k, of_joints, nv), and self-stresses (k, s, n):
        None where there are more at some samples than at others.
        """
        bearing, at, angles, a = self.bearing, piece.at, piece.angles, self.a[piece.at]
        with acquired(bearing.mechanism, centred_tree) as tree:
            placements, columns, transmitted = _in_motion(tree, piece.q, piece.v, a)
        stresses: Array | None = np.zeros((len(a), 0, bearing.n_closure))
        if not self.is_together:  # one sample, where these equations are
            multipliers, angles = bearing.multipliers(closures[0])[None], (
                bearing.angle_reference[None])
        elif multipliers is None:
            with acquired(bearing.mechanism, Kernel) as kernel:
                jacobians = kernel.jacobians_and_columns(piece.q, angles)[0]
            multipliers, stresses = solved_transposed(
                jacobians[:, : bearing.n_closure], bearing.scale * closures)
        assert multipliers is not None
        c, total = bearing.constraints, at_joints + piece.turning - bearing.model.armature * a
        rows = joint_rows(c, placements, piece.q, angles)
        total += (multipliers[:, None, c.of_joints] @ rows)[:, 0]
        poses = Poses(placements, columns, row_wrenches(c, placements, piece.q, angles))
        reactions, self.on_ground[at] = bearing.pairs.reactions(
            poses, transmitted, multipliers, piece.wrenches, total)
        self.multipliers[at] = multipliers
        for pair, wrench in enumerate(reactions.values()):
            self.reactions[at, pair] = wrench
        return poses, rows, stresses


def _in_motion(tree: KernelTree, *motions: Array) -> tuple[Array, Array, Array]:
    """Return placements (m, njoints, 4, 3), Jacobians (m, 6, nv) and forces (m, njoints, 6).

    Of motions q (m, nq), v and a (m, nv); forces are as of `KernelTree.transmitted`.
    """
    m, n, nv = len(motions[0]), len(tree.arrays.kind), tree.model.nv
    rotations, positions = np.empty((m, n, 3, 3)), np.empty((m, n, 3))
    columns, wrench = np.empty((m, 6, nv)), np.empty((m, n, 6))
    tree.prepared(*(numbers(x, (m, x.shape[1])) for x in motions), R=rotations, p=positions,
                  jacobian=columns, tau=np.empty((m, nv)), wrench=wrench)()
    wrench[:, 0] = 0.0
    return tree.placed(rotations, positions), columns, wrench[:, tree.arrays.carriers]


def _spring_wrenches(equations: Equations, q: Array, v: Array) -> tuple[Array, Array] | None:
    """Return the wrenches (k, njoints, 6) of springs on frames, and their joint forces (k, nv).

    None of springs with laws, or whose frames coincide: the kernel does not know them.
    """
    springs = equations.springs
    if springs.laws_on_frames:
        return None
    (q, v), columns = (np.array(x, order="C") for x in (q, v)), np.empty((len(q), 6, v.shape[1]))
    with acquired(equations.mechanism, centred_tree) as tree:
        packed = TreeSprings(tree.arrays, springs.packed)
        of_joints = np.empty((len(q), len(tree.arrays.kind), 6))
        tree.prepared(q, v, np.zeros_like(v), tau=np.empty_like(v), jacobian=columns,
                      springs=packed.address, of_springs=of_joints)()
        wrenches = of_joints[:, tree.arrays.carriers]
    if packed.coincide():
        return None
    forces = np.zeros_like(v)
    bodies = {i for x in springs.lines for i in x.bodies}
    for joint in bodies.union(*(x.bodies for x in springs.bushings)):
        own = (wrenches[:, joint, None] @ columns)[:, 0]
        forces += own * equations.constraints.supports[joint]
    return wrenches, forces


def accelerate(samples: LoadedSamples, efforts: Array) -> None:
    """Solve the accelerations of samples under efforts (N, nv) at joints.

    Raises:
        SingularError: as `forward_dynamics`.
    """
    equations = samples.equations

    def together(piece: SampleBlock) -> tuple[Array, Accelerated] | None:
        at_joints = efforts[piece.at]
        solution = equations.core_kkt.of_many(
            piece.q, piece.v, piece.angles, piece.given + at_joints)
        facts = solution.facts
        is_sure = not facts[:, FAILED].any() and np.all(facts[:, ERROR] <= DOUBTFUL)
        return (at_joints, solution) if is_sure else None

    def alone(k: int) -> tuple[Array, Solution, Array]:
        return efforts[k], equations.solve(efforts[k] + equations.given), efforts[:0]

    samples.solve(together, alone)


def efforts_over(
    mechanism: Mechanism, motion: Motion, efforts: Mapping[str, Any] | None
) -> dict[str, Array]:
    """Return efforts (N,) by name: each a constant, or one of each sample [N·m, N].

    Raises:
        UnknownNameError: a name does not exist.
        ValueError: a value is not finite, or there are not as many as samples.
    """
    rows, n = dict[str, Array](), len(motion)
    for name, given in mapping(efforts, "efforts").items():
        values = as_array(given, f"effort at {name!r}")
        if values.shape not in ((), (n,)):
            raise ValueError(f"effort at {name!r} has shape {values.shape}; give a number, or one "
                             f"for each of the {n} samples: ({n},)")
        if not is_finite(values):
            raise ValueError(f"effort at {name!r} is NaN or infinite")
        rows[name] = np.broadcast_to(values, (n,)).copy()
    joint_efforts(mechanism, dict.fromkeys(rows, 0.0))  # which refuses names
    return rows


def forces_at(mechanism: Mechanism, motion: Motion, external: External | None) -> ForcesAt | None:
    """Return forces at frames by sample; None if there are none.

    Args:
        mechanism: whose frames they act at.
        motion: of N samples.
        external: by frame a `pin.Force` or rows (N, 6); or a function of the State, or of the time
            and the State.

    Raises:
        UnknownNameError: there is no such frame.
        ValueError: rows are not as many as samples, or not finite.
    """
    if callable(external):
        law = external
        if len(inspect.signature(law).parameters) > 1:
            if motion.time is None:
                raise SpatialPinError("external is a function of the time, and the motion has "
                                      "none: give a function of the State")
            times = motion.time
            return lambda k, state: mapping(law(float(times[k]), state), "external")
        return lambda k, state: mapping(law(state), "external")
    if not external:
        return None
    fixed, tables = forces_on_frames(mechanism, external, len(motion), "samples")
    return lambda k, state: fixed | {name: pin.Force(rows[k].copy())
                                     for name, rows in tables.items()}
