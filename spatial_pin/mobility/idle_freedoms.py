"""Passive freedoms of links: the link, its axis, and idle rotations."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin._support.brief import brief
from spatial_pin.assembly.close import close, scaled_row
from spatial_pin.assembly.holding import fixed_base_entries
from spatial_pin.assembly.passive_freedoms import (
    inner_links_of_balls,
    is_in_loop,
    moved_bodies,
    passive_freedoms,
)
from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.mechanism.coordinates import driver_coordinates
from spatial_pin.numerics.linalg import Array, common_rows, decompose, null_space
from spatial_pin.numerics.tolerances import TOLERANCES

# Singular value of twists that counts as zero: axes from files with nine or more digits coincide;
# six digits need `gap`.
ALGEBRA_TOLERANCE = 1e-8
# Motion of a body without an opened loop [rad, characteristic lengths]: a first-order freedom opens
# it by the square, 0.1.
IDLE_MOTION = 0.3
# Random motions of a body, and steps from each, to find an idle one: for a body on two rods, with
# four idle lines, one in two finds one.
IDLE_STARTS, IDLE_STEPS = 24, 50
# relative speed of a body at rest: passive freedoms are known to a tenth of it, the root of round-
# off
IDLE = 1e-7


class PassiveFreedom(NamedTuple):
    """A freedom that moves one link only, about or along an axis of its own, and no driver.

    Attributes:
        link: the link that moves.
        kind: "spin", "slide", or "screw" where it advances as it turns.
        axis: (3,) unit vector along its axis at the configuration, world axes.
        point: (3,) a point of that axis in the world [m].
        text: the freedom in words, with the pairs on the axis.

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


def idle_freedoms(
    evaluation: LoopEquations, q: Array, held: Iterable[int] = ()
) -> list[tuple[str, Array]]:
    """Return (joint name, (k, nv) velocities) of links that move idly about or along own axes.

    q (nq,) is closed. A link on one pair only is not in a loop and does not idle. `held` are
    indices in the velocity vector of other fixed coordinates. The evaluation is left at q.
    """
    mechanism, n = evaluation.mechanism, evaluation.constraints.n_closure
    evaluation.update(q)
    if not n:
        return []
    driven = list(driver_coordinates(mechanism).values())
    still = [*fixed_base_entries(mechanism, driven), *held]
    rows = [*(scaled_row(mechanism, c, q) for c in driven), *np.eye(evaluation.model.nv)[still]]
    tangents = null_space(np.vstack([evaluation.jacobian[:n], *rows]), TOLERANCES.half_precision)
    if not len(tangents):
        return []
    freedoms: list[tuple[str, Array]] = []
    for joint, velocities in passive_freedoms(evaluation, mechanism.velocity_scale * tangents):
        if is_in_loop(mechanism, joint):
            motions = _spins_and_slides(evaluation, joint, velocities)
            if _idles(evaluation, q, joint, motions):
                freedoms.append((joint, motions))
            evaluation.update(q)
    return freedoms


def _spins_and_slides(evaluation: LoopEquations, joint: str, velocities: Array) -> Array:
    """Return the motions of one body, (k, nv), recombined into pure spins and slides.

    Spins are about axes of its own, as far as possible, whatever the axes of the world.
    """
    mechanism, i = evaluation.mechanism, evaluation.mechanism.joint_id(joint)
    columns = evaluation.body_jacobian(i)
    rotation = evaluation.data.oMi[i].rotation
    moves, turns = ((velocities @ part.T) @ rotation for part in (columns[:3], columns[3:]))
    moves = moves / mechanism.characteristic_length
    size = max(np.abs(moves).max(initial=0.0), np.abs(turns).max(initial=0.0), 1e-300)
    moves, turns = (moves / size).T, (turns / size).T
    n = decompose(turns, ALGEBRA_TOLERANCE).rank
    about = common_rows(turns[None], np.zeros((0, len(velocities))), n)
    along = common_rows(moves[None], turns[about], len(velocities) - n)
    velocities = np.linalg.solve(np.vstack([turns[about], moves[along]]).T, velocities)
    spins, slides = velocities[:n], velocities[n:]
    if len(slides) and len(spins):  # take the slide along its axis out of each spin
        linear = slides @ columns[:3].T
        for spin in spins:
            v, w = columns[:3] @ spin, columns[3:] @ spin
            forward = w * (v @ w) / (w @ w)
            spin -= decompose(linear.T, ALGEBRA_TOLERANCE).minimum_norm(forward) @ slides
    return np.vstack([spins, slides])


def _idles(evaluation: LoopEquations, q: Array, joint: str, velocities: Array) -> bool:
    """Whether some of the motions (k, nv) of one body are idle, about a fixed axis.

    Then all of them belong to it. A motion along curves only, like that of a platform on legs, is
    not idle. A body on a rod turns about either end, but not about both at once: if no given motion
    is idle, others are searched from random ones.
    """
    if any(_goes_on(evaluation, q, joint, v) for v in velocities):
        return True
    insides = inner_links_of_balls(evaluation.mechanism)
    if len(velocities) < 2 or not insides.isdisjoint(moved_bodies(evaluation, velocities)):
        return False
    from scipy.optimize import least_squares  # on use: it takes a tenth of a second

    velocities = np.array([_gone(evaluation, q, joint, v)[1] for v in velocities])

    def opened(part: Array) -> Array:
        ends = []
        for sense in (1.0, -1.0):
            evaluation.update(_gone(evaluation, q, joint, sense * part @ velocities)[0])
            ends.append(evaluation.residual.copy())
        return np.concatenate(ends)

    starts = np.random.default_rng(3).normal(size=(IDLE_STARTS, len(velocities)))
    return any(_goes_on(evaluation, q, joint, part @ velocities) for part in (
        least_squares(opened, start, max_nfev=IDLE_STEPS, xtol=TOLERANCES.last_digit,
                      ftol=None, gtol=None).x for start in starts))


def _gone(evaluation: LoopEquations, q: Array, joint: str, v: Array) -> tuple[Array, Array]:
    """Return the configuration after a body's motion along v (nv,) from q, and v at that speed."""
    mechanism, i = evaluation.mechanism, evaluation.mechanism.joint_id(joint)
    size = np.array([1.0 / mechanism.characteristic_length] * 3 + [1.0] * 3)
    evaluation.update(q)
    paced = v / max(float(np.linalg.norm(size * (evaluation.body_jacobian(i) @ v))), 1e-300)
    return pin.integrate(evaluation.model, q, IDLE_MOTION * paced), paced


def _goes_on(evaluation: LoopEquations, q: Array, joint: str, v: Array) -> bool:
    """Whether loops stay closed over a long motion of a body with constant velocity v (nv,).

    An idle link does so. A platform on legs does not: its axis moves. Chains of hinges do not turn
    evenly with the body: they close the loops again.
    """
    mechanism, model = evaluation.mechanism, evaluation.model
    body = mechanism.joint_id(joint)
    there, _ = _gone(evaluation, q, joint, v)
    moved = moved_bodies(evaluation, v[None])
    if inner_links_of_balls(mechanism).isdisjoint(moved):
        evaluation.update(there)
        return bool(evaluation.closure_error < ALGEBRA_TOLERANCE)
    twist = evaluation.body_jacobian(body) @ v
    rest = [k for k in range(1, model.njoints) if k not in moved]
    before, poses = evaluation.data.oMi[body].copy(), evaluation.placements[rest].copy()
    hinges = {model.names[k] for k in range(1, model.njoints)
              if k in moved or model.parents[k] in moved}
    driven = driver_coordinates(mechanism).values()
    free = np.zeros(model.nv, dtype=bool)
    free[[c.v for c in mechanism.coordinate_table.values()
          if c.joint in hinges and c not in driven]] = True
    error = close(evaluation, there, free, TOLERANCES.round_off)[1]
    screw = pin.log6(evaluation.data.oMi[body] * before.inverse()).vector
    size = np.array([1.0 / mechanism.characteristic_length] * 3 + [1.0] * 3)
    along, displacement = size * twist / np.linalg.norm(size * twist), size * screw
    off = displacement - along * (along @ displacement)
    shifted = np.abs(evaluation.placements[rest] - poses).max(initial=0.0)
    return bool(error <= TOLERANCES.closed and along @ displacement > TOLERANCES.moved * IDLE_MOTION
                and max(np.abs(off).max(), shifted) < ALGEBRA_TOLERANCE)


def described(evaluation: LoopEquations, joint: str, v: Array) -> PassiveFreedom:
    """Return the motion v (nv,) of one body as a passive freedom."""
    mechanism, model = evaluation.mechanism, evaluation.model
    i = mechanism.joint_id(joint)
    twist = evaluation.body_jacobian(i) @ v
    link = next(f.name for f in model.frames
                if f.type == pin.FrameType.BODY and f.parentJoint == i)
    spin = float(np.linalg.norm(twist[3:])) * mechanism.characteristic_length
    if spin < TOLERANCES.half_precision * float(np.linalg.norm(twist[:3])):
        axis = _of_one_sense(twist[:3] / np.linalg.norm(twist[:3]))
        at = mechanism.centre + evaluation.data.oMi[i].translation
        return PassiveFreedom(link, "slide", axis, at,
                              f"{link} slides along {_direction(axis)} in joint {joint}")
    omega = float(np.linalg.norm(twist[3:]))
    axis = _of_one_sense(twist[3:] / omega)
    advance = abs(float(axis @ twist[:3])) / (omega * mechanism.characteristic_length)
    point = np.cross(twist[3:], twist[:3]) / omega**2
    # pairs between bodies that are moved and others, whose centres lie on the axis
    moved, data = moved_bodies(evaluation, v[None]), evaluation.data
    centres = {model.names[k]: data.oMi[k].translation for k in range(1, model.njoints)
               if (k in moved) != (model.parents[k] in moved)}
    for closure in mechanism.closures:
        for frames in closure.joined:
            mine = [f for f in frames if mechanism.frame_on_joint(f)[0] in moved]
            if len(mine) == 1:
                centres[closure.name] = evaluation.frame(mechanism.frame_id(mine[0])).translation
    limit = TOLERANCES.half_precision * mechanism.characteristic_length
    through = [name for name, x in centres.items()
               if np.linalg.norm(np.cross(x - point, axis)) < limit]
    kind = "spin" if advance < TOLERANCES.half_precision else "screw"
    text = f"{link} {'spins' if kind == 'spin' else 'turns and advances'} about {_direction(axis)}"
    if through:
        text += f" through {' and '.join(through)}"
    return PassiveFreedom(link, kind, axis, mechanism.centre + point, text)


def _of_one_sense(axis: Array) -> Array:
    """Return an axis (3,) or its opposite, which are equivalent, independent of round-off."""
    return -axis if axis[np.abs(axis) > TOLERANCES.nothing][0] > 0.0 else axis


def _direction(axis: Array) -> str:
    return "(" + ", ".join(f"{x:.4g}" for x in np.round(axis, 12) + 0.0) + ")"
