"""Influence of closures and joints on outputs.

A set of closures is enough if the other loops do not constrain the remaining joints: with T the
motions of the whole closed mechanism, the part of T in the remaining joints must be all motions
that the remaining closures allow. Equal dimensions prove it, as the former are in the latter. At
generic configurations this holds along the branch (the rank of an analytic matrix falls at isolated
points only).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import combinations
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.assembly.close import close
from spatial_pin.assembly.link_angle import link_angle
from spatial_pin.assembly.state import State
from spatial_pin.errors import SpatialPinError, UnknownNameError
from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Closure
from spatial_pin.mobility.mobility import joints_between
from spatial_pin.motion.motion import FRAME_UNITS
from spatial_pin.motion.outputs import COORDINATE_OUTPUTS, component, is_force, is_of_whole
from spatial_pin.numerics.linalg import Array, null_space, rank
from spatial_pin.numerics.tolerances import TOLERANCES

# Closed configurations for ranks: a random one has the generic rank except by chance, and four do
# not all fail.
CONFIGURATIONS = 4
# Their distance from the reference [rad, characteristic lengths], the first that closes: at 0.3 it
# is generic, at 0.03 nearly all loops close.
STEPS = (0.3, 0.1, 0.03)
ALL_SUBSETS = 8  # closures up to which all subsets are tried: 256
PAIRS_OF_CLOSURES = 16  # closures up to which pairs are tried: 120 pairs


class RequestedOutputs(NamedTuple):
    """Outputs, resolved to coordinates and frames."""

    coordinates: tuple[str, ...]  # names of coordinates
    frames: tuple[str, ...]  # names of links and frames, also of joints that stand for frames
    centres: tuple[str, ...]  # links whose centre of mass is an output


def requested_outputs(
    mechanism: Mechanism, outputs: Iterable[str], dynamics: bool
) -> RequestedOutputs:
    """Return the outputs of names: coordinates, joints, drivers, links, frames, or outputs."""
    requested = RequestedOutputs((), (), ())
    for name in outputs:
        if is_force(name):
            force, (name, _, kind) = name, name.rpartition(".")
            if kind not in ("effort", "power"):
                raise SpatialPinError(
                    f"mechanism {mechanism.name!r}: {force}: a smaller model has other pairs, "
                    "whose reactions are others: sp.kinetostatics of the whole mechanism gives "
                    "this")
            if not dynamics:
                raise SpatialPinError(
                    f"mechanism {mechanism.name!r}: {force} depends on masses: reduce with "
                    "dynamics=True, which keeps parts with mass")
        coordinates, frames, centres = _named(mechanism, name)
        requested = RequestedOutputs(requested.coordinates + coordinates, requested.frames + frames,
                                 requested.centres + centres)
    return RequestedOutputs(*(tuple(dict.fromkeys(names)) for names in requested))


def _named(mechanism: Mechanism, name: str) -> RequestedOutputs:
    table = mechanism.coordinate_table
    coordinates = tuple(c.name for c in table.values() if name in (c.name, c.joint))
    if name in mechanism.drivers:
        coordinates += (mechanism.drivers[name].joint,)
    is_frame = name in mechanism.links or (name in mechanism.frame_ids and not coordinates)
    if coordinates or is_frame:
        return RequestedOutputs(coordinates, (name,) * is_frame, ())
    if is_of_whole(mechanism, name):
        raise SpatialPinError(
            f"mechanism {mechanism.name!r}: {name} depends on every link that has mass, so that no "
            "smaller model tells it: a motion of the whole mechanism gives this")
    angle = link_angle(mechanism, name)
    if angle is not None:
        return RequestedOutputs((), (mechanism.model.frames[angle.frame].name,), ())
    stem, _, kind = component(name)[0].rpartition(".")
    if kind == "com" or stem.endswith(".com"):
        link = stem.removesuffix(".com")
        if link in mechanism.frame_ids:
            return RequestedOutputs((), (link,), (link,))
    if kind in ("rate", "ratio", "advantage") or kind in FRAME_UNITS:
        inner = _named(mechanism, stem)
        if kind not in FRAME_UNITS or kind in COORDINATE_OUTPUTS or inner.frames:
            return inner
    known = [*table, *mechanism.drivers, *mechanism.frame_ids,
             *(f"{link}.com" for link in mechanism.links)]
    if kind in COORDINATE_OUTPUTS:
        known = [n for n in known if n in table]
    raise UnknownNameError("coordinate, joint, link or frame", name, known,
                           f"mechanism {mechanism.name!r}: ")


class NeededParts(NamedTuple):
    """The parts of the tree that a set of closures needs."""

    closures: tuple[int, ...]  # indices into `mechanism.closures`
    moving: frozenset[int]  # remaining joints
    # joints that carry some of these but do not move relative to the outputs
    welded: frozenset[int]


class OutputInfluence:
    """The joints and closures of a mechanism that its outputs depend on.

    Args:
        mechanism: the mechanism.
        state: a closed configuration, locked joints at their values.
        locked: fixed joints.
        needed: joints whose coordinates are outputs.
        bodies: joints whose bodies' placements are outputs.

    Attributes:
        configurations: (nq,) closed configurations of the analysis.
        motions: (k, nv) of the closed mechanism at each of them, scaled.
    """

    def __init__(self, mechanism: Mechanism, state: State, locked: Iterable[int],
                 needed: Iterable[int], bodies: Iterable[int]) -> None:
        self.mechanism, self.locked = mechanism, frozenset(locked)
        self.needed, self.bodies = frozenset(needed), frozenset(bodies)
        model = mechanism.model
        self.columns = {i: list(range(model.idx_vs[i], model.idx_vs[i] + model.nvs[i]))
                        for i in range(1, model.njoints)}
        self.free = np.ones(mechanism.model.nv, dtype=bool)
        for i in self.locked:
            self.free[self.columns[i]] = False
        self.evaluation = LoopEquations(mechanism)
        self.evaluation.angle_reference[:] = state.angles
        self.configurations = list(self._generic(state))
        n = self.evaluation.constraints.n_closure
        closure_of = self.evaluation.constraints.closure_of
        self._rows = [[i for i, name in enumerate(closure_of) if name == c.name]
                      for c in mechanism.closures]
        self._jacobians, self.motions = [], []
        for q in self.configurations:
            self.evaluation.update(q)
            jacobian = self.evaluation.jacobian[:n].copy()
            motions = np.zeros((0, mechanism.model.nv))
            inner = null_space(jacobian[:, self.free], 1e-8)
            if len(inner):
                motions = np.zeros((len(inner), mechanism.model.nv))
                motions[:, self.free] = inner
            self._jacobians.append(jacobian)
            self.motions.append(motions)

    def _generic(self, state: State) -> Iterator[Array]:
        """Yield closed configurations of the branch away from the reference, else the reference."""
        evaluation, model = self.evaluation, self.mechanism.model
        scale, n = self.mechanism.velocity_scale, evaluation.constraints.n_closure
        evaluation.update(state.q)
        tangents = null_space(evaluation.jacobian[:n, self.free], 1e-8)
        rng = np.random.default_rng(7)
        count = 0
        for size in STEPS:
            for _ in range(CONFIGURATIONS if len(tangents) else 0):
                step = np.zeros(model.nv)
                direction = rng.normal(size=len(tangents)) @ tangents
                step[self.free] = size * direction / np.linalg.norm(direction)
                q, error = close(evaluation, pin.integrate(model, state.q, scale * step),
                                 self.free, TOLERANCES.round_off)
                moved = np.linalg.norm(pin.difference(model, state.q, q) / scale)
                if error <= TOLERANCES.closed and 0.3 * size < moved < 3.0 * size \
                        and not evaluation.mirrored():
                    count += 1
                    yield q
            if count >= CONFIGURATIONS:
                return
        if not count:
            yield state.q

    def needed_parts(self, closures: Iterable[int]) -> NeededParts:
        """Return the needed joints for a set of closures."""
        chosen = tuple(closures)
        model = self.mechanism.model
        moving = set(self.needed)
        for i in self.bodies:
            moving.update(int(j) for j in model.supports[i])
        for k in chosen:
            moving.update(joints_of(self.mechanism, self.mechanism.closures[k]))
        moving -= {0, *self.locked}
        carried = set(moving) | set(self.bodies)
        for k in chosen:
            closure = self.mechanism.closures[k]
            carried.update(self.mechanism.frame_on_joint(f)[0]
                           for f in (*closure.frames, *closure.between))
        carriers = {int(j) for i in carried for j in model.supports[i]}
        return NeededParts(chosen, frozenset(moving), frozenset(carriers - moving - {0}))

    def is_enough(self, parts: NeededParts) -> bool:
        """Whether the other closures do not constrain the remaining joints."""
        columns = sorted(v for i in parts.moving for v in self.columns[i])
        rows = [r for k in parts.closures for r in self._rows[k]]
        return all(
            rank(motions[:, columns], TOLERANCES.singular)
            == len(columns) - rank(jacobian[rows][:, columns])
            for motions, jacobian in zip(self.motions, self._jacobians, strict=True))

    def least(self) -> NeededParts:
        """Return the least sufficient parts: the fewest coordinates, then the fewest closures.

        Many closures are removed one by one, or in pairs, as long as possible.
        """
        count = len(self.mechanism.closures)
        best = self.needed_parts(range(count))
        if count > ALL_SUBSETS:
            sizes = (1, 2) if count <= PAIRS_OF_CLOSURES else (1,)
            while True:
                smaller = (self.needed_parts(k for k in best.closures if k not in out)
                           for size in sizes for out in combinations(best.closures, size))
                better = next(filter(self.is_enough, smaller), None)
                if better is None:
                    return best
                best = better
        size = self._size(best)
        for n in range(count):
            for chosen in combinations(range(count), n):
                parts = self.needed_parts(chosen)
                if self._size(parts) < size and self.is_enough(parts):
                    best, size = parts, self._size(parts)
        return best

    def _size(self, parts: NeededParts) -> tuple[int, int]:
        return sum(len(self.columns[i]) for i in parts.moving), len(parts.closures)


def joints_of(mechanism: Mechanism, closure: Closure) -> set[int]:
    """Return the joints of the tree in a closure."""
    coupled = {mechanism.joint_id(mechanism.coordinate(name).joint) for name in closure.joints}
    return coupled | {joint for frames in closure.joined
                      for joint in joints_between(mechanism, frames)}
