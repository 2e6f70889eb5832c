"""Reactions of the pairs, from the multipliers of the closure equations and the forces in the tree.

The rows of a loop that is overconstrained bear on each other: their multipliers can be changed
by any self-stress, a vector that the transposed Jacobian takes to zero, without moving anything.
A component of a pair's reaction is unique if no self-stress reaches it [Wojtyra2009].

A coupling is an equation of joint coordinates: its force is an effort at each. The rope, belt or
mesh that it stands for pulls at bodies somewhere, and is borne by the pairs from the one joint to
the other, in all directions in which these do not move. Where a coupling has teeth or strands, it
pulls there instead.

Everything here works on one configuration or on many: arrays may have leading dimensions.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin._support.brief import first_names
from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.dynamics.coupling_forces import coupling_forces
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array, complements
from spatial_pin.numerics.stacked import cross

MANY = ("* one of many (along these axes), the least: loops, or more actuators than freedoms, "
        "can be under stress by themselves")
BESIDE = ("* without the force of {couplings}, which {pairs} bear{s} too: a coupling does not say "
          "where it acts")
UNMOVED = 1e-8  # reaction to a unit self-stress that counts as zero: half of the digits


class Poses(NamedTuple):
    """Placements, Jacobians and closure wrenches at one or many configurations.

    Attributes:
        placements: (..., njoints, 4, 3) columns of the rotation, then the position, of each joint.
        columns: (..., 6, nv) world joint Jacobian.
        rows: (..., n_wrenches, 6) wrench of each closure row at the world origin, then those on
            other bodies than the first two.
    """

    placements: Array
    columns: Array
    rows: Array


class Pairs:
    """The pairs of a mechanism, tree joints and closures, with their reactions.

    Attributes:
        closed: closures between bodies: name, rows, bodies, second frame's origin (4,) on its body.
        other_body_products: forces of closures on other bodies than their first two.
        coupled: the joints that bear the force of a coupling whose point of action is unknown.
        couplings: forces of couplings on bodies, where the point of action is known.
        names: of all pairs, the tree's first, couplings last.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        self.model = model = mechanism.model
        self.length, self.centre = mechanism.characteristic_length, mechanism.centre
        self.closed: list[tuple[str, slice, tuple[int, int], Array]] = []
        at = 0
        for closure in mechanism.closures:
            rows = slice(at, at + closure.n_rows)
            if closure.frames:
                at = rows.stop
                (first, _), (second, x) = map(mechanism.centred_frame, closure.frames[:2])
                self.closed.append((
                    closure.name, rows, (first, second), np.append(x.translation, 1.0)))
        constraints = constraints_of(mechanism)
        self.other_body_products = constraints.other_body_products
        self._of_joints = constraints.of_joints
        self.coupled = sorted(set().union(*joints_between_couplings(mechanism).values()))
        self.couplings = [c for c in coupling_forces(mechanism) if c.lines]
        self.names = [*list(model.names)[1:], *(pair[0] for pair in self.closed),
                      *(c.name for c in self.couplings)]
        self._levels = _levels(list(model.parents))
        self.grounded = [int(i) for i in model.children[0]]
        self.turns = np.array([c.unit == "rad" for c in mechanism.coordinate_table.values()], bool)

    def carried(self, wrenches: Array) -> Array:
        """Return the wrenches of every body and its descendants, summed by joint (njoints, ...)."""
        total = wrenches.copy()
        for joints, parents in self._levels:
            np.add.at(total, parents, total[joints])
        return total

    def summed(self, wrenches: Iterable[tuple[int, Array]]) -> Array:
        """Return wrenches on bodies, about the world origin, summed by body (njoints, 6)."""
        total = np.zeros((self.model.njoints, 6))
        for joint, wrench in wrenches:
            total[joint] += wrench
        return total

    def reactions(
        self, poses: Poses, transmitted: Array, multipliers: Array, given: Array, effort: Array
    ) -> tuple[dict[str, Array], Array]:
        """Return the reactions (..., 6) by pair and the wrench on the fixed link, world axes.

        The latter's moment is about the world's origin, as nothing else here is: all other places
        are relative to the mechanism's centre.

        Args:
            poses: where the bodies are.
            transmitted: (..., njoints, 6) what joints hand on, world axes, about their origins.
            multipliers: (..., n_closure) of the closure equations.
            given: (..., njoints, 6) other wrenches on bodies: springs, forces from outside.
            effort: (..., nv) efforts at joints.
        """
        closed = [(multipliers[..., None, own] @ poses.rows[..., own, :])[..., 0, :]
                  for _, own, _, _ in self.closed]
        coupled = [c.wrench(poses.placements, multipliers) for c in self.couplings]
        acting = [*zip([bodies for _, _, bodies, _ in self.closed], closed, strict=True),
                  *zip([c.bodies for c in self.couplings], coupled, strict=True)]
        for at, (row, _, bodies) in enumerate(
                self.other_body_products, start=multipliers.shape[-1]):
            acting.append((bodies, multipliers[..., row, None] * poses.rows[..., at, :]))
        on_bodies = given + np.zeros((*multipliers.shape[:-1], 1, 1))
        for (first, second), wrench in acting:
            on_bodies[..., first, :] -= wrench
            on_bodies[..., second, :] += wrench
        for c in self.couplings:
            effort = effort - multipliers[..., c.at, None] * c.row
        forces = transmitted.copy()
        forces[..., 3:] += cross(poses.placements[..., 3, :], forces[..., :3])
        forces = forces - np.moveaxis(self.carried(np.moveaxis(on_bodies, -2, 0)), 0, -2)
        at_joints = _moved(forces, poses.placements[..., 3, :])
        by_pair = {self.model.names[i]: self._without_effort(i, at_joints[..., i, :], poses.columns,
                                                           effort)
                 for i in range(1, self.model.njoints)}
        for (name, _, (_, body), point), wrench in zip(self.closed, closed, strict=True):
            by_pair[name] = _moved(wrench, point @ poses.placements[..., body, :, :])
        by_pair |= {c.name: _moved(wrench, c.pose_of(poses.placements))
                  for c, wrench in zip(self.couplings, coupled, strict=True)}
        ground = on_bodies[..., 0, :] - forces[..., self.grounded, :].sum(axis=-2)
        return by_pair, _moved(ground, -self.centre)

    def _without_effort(self, joint: int, force: Array, columns: Array, effort: Array) -> Array:
        """Return the reaction of the pair itself: `force` (..., 6) less the joint's effort.

        The effort of a turning coordinate is a torque, of a slide a force, along its axis.
        """
        at = self.model.idx_vs[joint]
        own = slice(at, at + self.model.nvs[joint])
        turns, tau = self.turns[own], effort[..., own]
        if not np.any(tau):
            return force
        axes = columns[..., own]
        force = force.copy()
        force[..., 3:] -= _along(axes[..., 3:, turns], tau[..., turns])
        force[..., :3] -= _along(axes[..., :3, ~turns], tau[..., ~turns])
        return force

    def unstressed(
        self, poses: Poses, joint_rows: Array, self_stresses: Array,
        internal_efforts: Array | None = None, unmoved: float = UNMOVED,
    ) -> dict[str, NDArray[np.bool_]]:
        """Return by pair which components (..., 6) of its reaction no self-stress changes.

        Self-stresses (..., k, n_closure) are multipliers of length 1, `joint_rows` (..., k, nv) the
        efforts at joints of unit multipliers of `of_joints`, `internal_efforts` (k, nv) those of
        the actuators in each self-stress. Reactions below `unmoved` count as zero. Poses of many
        configurations have an axis of length 1 behind theirs.
        """
        if not self_stresses.shape[-2]:
            return {name: np.ones(6, dtype=bool) for name in self.names}
        unit = np.array([1.0] * 3 + [1.0 / self.length] * 3)
        pulls = joint_rows * np.where(self.turns, 1.0 / self.length, 1.0)
        scale = np.abs(poses.rows * unit).max(axis=(-2, -1), initial=1e-300)
        of_joints = np.abs(pulls).max(axis=(-2, -1), initial=0.0)
        scale = np.maximum(scale, of_joints.reshape(scale.shape))
        efforts = self_stresses[..., self._of_joints] @ joint_rows
        if internal_efforts is not None:
            efforts = efforts + internal_efforts
        none = np.zeros((*poses.placements.shape[:-2], 6))
        by_pair, _ = self.reactions(poses, none, self_stresses, none, efforts)
        return {name: np.abs(wrench * unit).max(axis=-2, initial=0.0) / scale < unmoved
                for name, wrench in by_pair.items()}

    def beside_couplings(
        self, unique: dict[str, NDArray[np.bool_]], poses: Poses
    ) -> dict[str, NDArray[np.bool_]]:
        """Return which unique components (..., 6) by pair no coupling between its joints loads."""
        result = dict(unique)
        for joint in self.coupled:
            at, n = self.model.idx_vs[joint], self.model.nvs[joint]
            motions = poses.columns[..., at : at + n].copy()
            point = poses.placements[..., joint, 3, None, :]
            motions[..., :3, :] += cross(motions[..., 3:, :].mT, point).mT
            motions[..., 3:, :] *= self.length
            bearing = np.linalg.norm(complements(motions), axis=-1)
            name = self.model.names[joint]
            result[name] = unique[name] & (bearing < UNMOVED)
        return result


def joints_between_couplings(mechanism: Mechanism) -> dict[str, list[int]]:
    """Return the joints of each coupling and all joints between them, by coupling.

    Couplings with a line of action are omitted.
    """
    joints_of = {}
    for closure in mechanism.closures:
        if closure.joints and closure.acts_at is None:
            ends = {mechanism.joint_id(mechanism.coordinate(x).joint) for x in closure.joints}
            chains = [set(mechanism.model.supports[joint]) for joint in ends]
            joints_of[closure.name] = sorted(set.union(*chains) - set.intersection(*chains) | ends)
    return joints_of


def why_not_unique(mechanism: Mechanism, pairs: Iterable[str]) -> list[str]:
    """Return why the reactions of some pairs are not unique, a sentence for each reason."""
    names, remaining = mechanism.model.names, set(pairs)
    coupled = {coupling: [names[j] for j in joints if names[j] in remaining]
               for coupling, joints in joints_between_couplings(mechanism).items()}
    borne = {name: None for joints in coupled.values() for name in joints}
    reasons = [MANY] if remaining - set(borne) else []
    if borne:
        couplings = first_names(f"{name!r}" for name, joints in coupled.items() if joints)
        reasons.append(BESIDE.format(couplings=couplings, pairs=first_names(borne),
                                   s="s" * (len(borne) == 1)))
    return reasons


def not_unique_marks(unique: NDArray[np.bool_]) -> tuple[str, str]:
    """Return marks of force and moment: the axes of components (6,) that are not unique."""
    axes = ["".join(axis for axis, is_one in zip("xyz", part, strict=True) if not is_one)
            for part in (unique[:3], unique[3:])]
    force, moment = (f" *{names}" if names else "" for names in axes)
    return force, moment


def _levels(parents: list[int]) -> list[tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Return the joints of a tree and their parents, one level of the tree after the other.

    The deepest first.
    """
    depth = [0] * len(parents)
    for joint, parent in enumerate(parents[1:], start=1):
        depth[joint] = depth[parent] + 1
    levels: list[list[int]] = [[] for _ in range(max(depth))]
    for joint, deep in enumerate(depth):
        if deep:
            levels[-deep].append(joint)
    return [(np.array(joints), np.array([parents[i] for i in joints])) for joints in levels]


def _moved(wrench: Array, point: Array) -> Array:
    """Return wrenches (..., 6) at the world origin with their moment about `point` (..., 3)."""
    moved = wrench.copy()
    moved[..., 3:] -= cross(point, wrench[..., :3])
    return moved


def _along(axes: Array, values: Array) -> Array:
    """Return the shortest x (..., 3) with axes^T x = values; axes (..., 3, k)."""
    if not values.shape[-1]:
        return np.zeros(axes.shape[:-1])
    gram = np.swapaxes(axes, -1, -2) @ axes
    return (axes @ np.linalg.solve(gram, values[..., None]))[..., 0]

