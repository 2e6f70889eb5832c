"""Passive freedoms, as they are told: of which link, about which line, and what is idle of them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.assembly.close import close, scaled_row
from spatial_pin.assembly.holding import still_entries
from spatial_pin.assembly.passive_freedoms import (
    chain_links,
    driven_groups,
    is_in_loop,
    moved_bodies,
    passive_freedoms,
)
from spatial_pin.brief import brief
from spatial_pin.constraints.closure_equations import Evaluation
from spatial_pin.constraints.pinocchio_views import joint_jacobian
from spatial_pin.mobility.loops import ALGEBRA_TOLERANCE
from spatial_pin.numerics.linalg import Array, decompose, null_space
from spatial_pin.numerics.tolerances import TOLERANCES

# How far a body idles on without opening a loop [rad, characteristic lengths]: a freedom of first
# order only opens one by the square, 0.1, which no tolerance overlooks.
IDLE_WAY = 0.3
# A speed, relative to the fastest, that is none: passive freedoms are known to a tenth of it, the
# root of round-off.
IDLE = 1e-7


class PassiveFreedom(NamedTuple):
    """A freedom that moves one link only, about or along an axis of its own, and no driver.

    Attributes:
        link: the link that moves.
        kind: "spin", "slide", or "screw" where it advances as it turns.
        axis: (3,) unit vector along its axis at the configuration, world axes.
        point: (3,) a point of that axis in the world [m].
        text: the same in words, naming the pairs on the axis.

    Example:
        >>> found = sp.mobility(sp.load("rssr")).passive[0]
        >>> found.kind, found.link, found.axis.shape  # world axes
        ('spin', 'coupler', (3,))
        >>> print(found.text)
        coupler spins about (-0.7774, 0.629, 0) through ball_a and ball_b
    """

    link: str
    kind: str
    axis: Array
    point: Array
    text: str

    def __repr__(self) -> str:
        return brief(self, point="m")

    def __str__(self) -> str:
        return self.text


def passive_freedoms_at(
    evaluation: Evaluation, q: Array, held: Iterable[int] = ()
) -> list[tuple[str, Array]]:
    """Return (joint name, (k, nv) velocities) of the links that are passive at a closed q.

    A link that hangs on one pair only is no part of a loop and not called passive. Velocity
    entries that are `held` stand still.
    """
    mechanism = evaluation.mechanism
    scale, n = mechanism.velocity_scale, evaluation.constraints.n_closure
    evaluation.update(q)
    driven = [mechanism.coordinate(d.joint) for d in mechanism.drivers.values()]
    drive = [scaled_row(mechanism, c, q) for c in driven]
    drive += list(np.eye(len(scale))[[*still_entries(mechanism, driven), *held]])
    tangents = scale * null_space(np.vstack([evaluation.jacobian[:n], *drive]),
                                  TOLERANCES.half_precision)
    if not len(tangents):
        return []
    return [(joint, velocities) for joint, velocities in passive_freedoms(evaluation, tangents)
            if is_in_loop(mechanism, joint)]


def idle_freedoms(
    evaluation: Evaluation, q: Array, held: Iterable[int] = ()
) -> list[tuple[str, Array]]:
    """Return (joint name, (k, nv) velocities) of the links that idle about or along own axes at q.

    Args:
        evaluation: the closure equations; left at q.
        q: (nq,) closed configuration.
        held: places in the velocity vector of coordinates that stand still, besides the drivers.
    """
    found = []
    for joint, velocities in passive_freedoms_at(evaluation, q, held):
        idle = [v for v in _spins_and_slides(evaluation, joint, velocities)
                if _goes_on(evaluation, q, joint, v)]
        evaluation.update(q)
        if idle:
            found.append((joint, np.array(idle)))
    return found


def _spins_and_slides(evaluation: Evaluation, joint: str, velocities: Array) -> Array:
    """Return the motions of one body, (k, nv), recombined into pure slides and spins."""
    mechanism, i = evaluation.mechanism, evaluation.mechanism.joint_id(joint)
    columns = joint_jacobian(evaluation.data, evaluation.model.nv)
    columns = columns * evaluation.constraints.support(i)
    size = np.array([1.0, 1.0, 1.0, *[mechanism.characteristic_length] * 3])
    twists = velocities @ columns.T * size
    svd = decompose(twists[:, 3:].T, ALGEBRA_TOLERANCE)  # rows of vt combine velocities
    slides, spins = svd.vt[svd.rank :] @ velocities, svd.vt[: svd.rank] @ velocities
    if len(slides) and len(spins):  # take the slide along its axis out of each spin
        linear = slides @ columns[:3].T
        for spin in spins:
            v, w = columns[:3] @ spin, columns[3:] @ spin
            along = w * (v @ w) / (w @ w)
            spin -= decompose(linear.T, ALGEBRA_TOLERANCE).minimum_norm(along) @ slides
    return np.vstack([slides, spins])


def _goes_on(evaluation: Evaluation, q: Array, joint: str, v: Array) -> bool:
    """Whether loops stay closed as a body goes on with its velocity, given by v (nv,), for long.

    So does a link that idles about its axis, or along it. What carries a body along a curve of its
    own, like a platform on its legs, is no idle motion: its axis moves.
    """
    mechanism, i = evaluation.mechanism, evaluation.mechanism.joint_id(joint)
    size = np.array([1.0 / mechanism.characteristic_length] * 3 + [1.0] * 3)
    evaluation.update(q)
    twist = joint_jacobian(evaluation.data, evaluation.model.nv) @ (
        v * evaluation.constraints.support(i))
    pace = float(np.linalg.norm(size * twist))
    there = pin.integrate(evaluation.model, q, v * (IDLE_WAY / pace))
    if not chain_links(mechanism).isdisjoint(moved_bodies(evaluation, v[None])):
        return _turns_on(evaluation, there, v, i, twist)
    evaluation.update(there)
    return bool(evaluation.closure_error < ALGEBRA_TOLERANCE)


def _turns_on(evaluation: Evaluation, q: Array, v: Array, body: int, twist: Array) -> bool:
    """Whether a body comes to about q (nq,) along its axis, as chains of hinges that carry it let.

    The hinges do not turn evenly as the body does: they close the loops again.
    """
    mechanism, data, model = evaluation.mechanism, evaluation.data, evaluation.model
    moved = moved_bodies(evaluation, v[None])
    rest = [k for k in range(1, model.njoints) if k not in moved]
    before, places = data.oMi[body].copy(), evaluation.placements[rest].copy()
    hinges = {model.names[k] for k in range(1, model.njoints)
              if k in moved or model.parents[k] in moved}
    driven = {mechanism.coordinate(d.joint) for d in mechanism.drivers.values()}
    free = np.zeros(model.nv, dtype=bool)
    free[[c.v for c in mechanism.coordinate_table.values()
          if c.joint in hinges and c not in driven]] = True
    error = close(evaluation, q, free, TOLERANCES.round_off)[1]
    screw = pin.log6(data.oMi[body] * before.inverse()).vector
    size = np.array([1.0 / mechanism.characteristic_length] * 3 + [1.0] * 3)
    along, way = size * twist / np.linalg.norm(size * twist), size * screw
    off = way - along * (along @ way)
    shifted = np.abs(evaluation.placements[rest] - places).max(initial=0.0)
    return bool(error <= TOLERANCES.closed and along @ way > TOLERANCES.moved * IDLE_WAY
                and max(np.abs(off).max(), shifted) < ALGEBRA_TOLERANCE)


def described(evaluation: Evaluation, joint: str, v: Array) -> PassiveFreedom:
    """Name the motion v (nv,) of the one body that it moves."""
    mechanism, model = evaluation.mechanism, evaluation.model
    i = mechanism.joint_id(joint)
    twist = joint_jacobian(evaluation.data, model.nv) @ (v * evaluation.constraints.support(i))
    link = next(f.name for f in model.frames
                if f.type == pin.FrameType.BODY and f.parentJoint == i)
    spin = float(np.linalg.norm(twist[3:])) * mechanism.characteristic_length
    if spin < TOLERANCES.half_precision * float(np.linalg.norm(twist[:3])):
        axis = _of_one_sense(twist[:3] / np.linalg.norm(twist[:3]))
        return PassiveFreedom(link, "slide", axis, evaluation.data.oMi[i].translation.copy(),
                              f"{link} slides along {_direction(axis)} in joint {joint}")
    omega = float(np.linalg.norm(twist[3:]))
    axis = _of_one_sense(twist[3:] / omega)
    advance = abs(float(axis @ twist[:3])) / (omega * mechanism.characteristic_length)
    point = np.cross(twist[3:], twist[:3]) / omega**2
    through = _pairs_on_axis(evaluation, i, axis, point)
    kind = "spin" if advance < TOLERANCES.half_precision else "screw"
    text = f"{link} {'spins' if kind == 'spin' else 'turns and advances'} about {_direction(axis)}"
    if through:
        text += f" through {' and '.join(through)}"
    return PassiveFreedom(link, kind, axis, point, text)


def _of_one_sense(axis: Array) -> Array:
    """Return an axis (3,) or its opposite, which mean the same: round-off has no say in it."""
    return -axis if axis[np.abs(axis) > TOLERANCES.nothing][0] > 0.0 else axis


def _pairs_on_axis(evaluation: Evaluation, body: int, axis: Array, point: Array) -> list[str]:
    """Return the pairs of a body whose centres lie on an axis."""
    mechanism, model, data = evaluation.mechanism, evaluation.model, evaluation.data
    groups = driven_groups(mechanism)
    centres = {model.names[i]: data.oMi[i].translation for i in range(1, model.njoints)
               if groups[body] in (groups[i], groups[model.parents[i]])}
    for closure in mechanism.closures:
        for frame in (*closure.frames, *closure.between):
            if groups[mechanism.frame_on_joint(frame)[0]] == groups[body]:
                centres[closure.name] = evaluation.frame(mechanism.frame_id(frame)).translation
    limit = TOLERANCES.half_precision * mechanism.characteristic_length
    return [name for name, x in centres.items()
            if np.linalg.norm(np.cross(x - point, axis)) < limit]


def _direction(axis: Array) -> str:
    return "(" + ", ".join(f"{x:.4g}" for x in np.round(axis, 12) + 0.0) + ")"
