"""Forces of couplings on bodies, along the lines of their teeth or strands.

Along a motion of a coupling's own joints that moves nothing else, with the carrier at rest, the
bodies of its first and last joint roll on each other at the pitch point: both have the velocity
along t there. The tooth force on the second body is, with pressure angle alpha in the normal
section and helix angle beta [Norton, Machine Design, ch. 12-13],

    F t + |F| tan(alpha) / cos(beta) e + F tan(beta) g

with e into that body, away from the other, and g along the pitch line, both square to t. Where the
axes cross, as of a worm and its wheel, the bodies slide along their teeth: these lie along the
relative velocity, and with n square to them and to e the force is F n + |F| tan(alpha) e. A strand
pulls both bodies towards each other along its own line. F is what virtual power makes of the
coupling's multiplier: F t . (J2 - J1) = multiplier * row.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.errors import MechanismFileError
from spatial_pin.mechanism.force_paths import Strands, Teeth
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Closure
from spatial_pin.numerics.linalg import Array, decompose
from spatial_pin.numerics.stacked import cross

ROLLING = 1e-6  # part of the speed at a point that bodies may miss it by: rounded numbers of a file
CROSSED = 1e-3  # sine of the angle of velocities at a point, above which they are not parallel
HELIX_DIGITS = 1e-4  # rad: rounded angles of a file


class ForceLine(NamedTuple):
    """A line of force between two bodies, in the axes of the body that carries them.

    Attributes:
        point: (3,) on it [m].
        along: (3,) unit vector, of a positive force on the second body.
        aside: (3,) of what goes with its size.
        by_multiplier: force of a unit of the multiplier [N].
        pretension: [N]; None: it pushes as well.
    """

    point: Array
    along: Array
    aside: Array
    by_multiplier: float
    pretension: float | None = None

    def force(self, multipliers: Array) -> Array:
        """Return the force (..., 3) on the second body, in the axes of the carrier."""
        size = self.by_multiplier * multipliers
        if self.pretension is not None:
            size = np.maximum(np.maximum(self.pretension + 0.5 * size, size), 0.0)
        return size[..., None] * self.along + np.abs(size)[..., None] * self.aside

    def slope(self, multiplier: float) -> Array:
        """Return the derivative (3,) of `force` with respect to the multiplier."""
        size, by = self.by_multiplier * multiplier, self.by_multiplier
        if self.pretension is not None:  # a slack strand takes nothing, the other one all
            by *= 0.5 if abs(size) < 2.0 * self.pretension else float(size > 0.0)
        return by * (self.along + np.sign(size) * self.aside)


class CouplingForce(NamedTuple):
    """The force of a coupling on the bodies of its first and last joint.

    Attributes:
        name: of the coupling.
        at: number of its equation.
        row: (nv,) efforts at joints of a unit of its multiplier; 0 where a function makes them.
        bodies: of the first joint and the last.
        last: place of the last joint coordinate in v.
        carrier: the body that the lines are fixed in.
        lines: of force; none if it is not known where it acts.
    """

    name: str
    at: int
    row: Array
    bodies: tuple[int, int]
    last: int
    carrier: int
    lines: tuple[ForceLine, ...]

    def effort(self, multipliers: Array) -> Array:
        """Return its effort at its last joint (...) [N·m or N]."""
        return multipliers[..., self.at] * self.row[self.last]

    def pose_of(self, placements: Array) -> Array:
        """Return where its reaction is about (..., 3): a point on its first line."""
        at = placements[..., self.carrier, :, :]
        return self.lines[0].point @ at[..., :3, :] + at[..., 3, :]

    def wrench(self, placements: Array, multipliers: Array) -> Array:
        """Return the wrench (..., 6) on the second body at the world's origin.

        Args:
            placements: (..., njoints, 4, 3) columns of the rotation, then the position.
            multipliers: (..., n_closure).
        """
        at = placements[..., self.carrier, :, :]
        total = np.zeros((*multipliers.shape[:-1], 6))
        for line in self.lines:
            force = line.force(multipliers[..., self.at])[..., None, :] @ at[..., :3, :]
            force = force[..., 0, :]
            point = line.point @ at[..., :3, :] + at[..., 3, :]
            total[..., :3] += force
            total[..., 3:] += cross(point, force)
        return total


def coupling_forces(mechanism: Mechanism) -> list[CouplingForce]:
    """Return the forces of all couplings.

    Raises:
        MechanismFileError: a pitch point or strand is not where its joints would roll or pull.
    """
    constraints, forces = constraints_of(mechanism), []
    for closure in mechanism.closures:
        if closure.frames or not closure.joints:
            continue
        at = constraints.closure_of.index(closure.name)
        row = np.zeros(mechanism.model.nv)
        for weight, factors in constraints.sums[at]:
            if len(factors) == 1 and factors[0][2] < 0:  # a coordinate, not a function of it
                row[constraints.coordinates[factors[0][1]][2]] = weight
        first, last = (mechanism.joint_id(mechanism.coordinate(closure.joints[k]).joint)
                       for k in (0, -1))
        path = closure.acts_at
        carrier, placement = int(mechanism.model.parents[first]), pin.SE3.Identity()
        if not carrier:
            placement.translation = -mechanism.centre
        if path is not None and path.frame:
            carrier, placement = mechanism.centred_frame(path.frame)
        forces.append(CouplingForce(closure.name, at, row, (first, last),
                                   mechanism.coordinate(closure.joints[-1]).v, carrier, (
            () if path is None else tuple(_lines(mechanism, closure, path, row, (first, last),
                                                 (carrier, placement))))))
    return forces


def _lines(
    mechanism: Mechanism, closure: Closure, path: Teeth | Strands, row: Array,
    bodies: tuple[int, int], carried: tuple[int, pin.SE3],
) -> list[ForceLine]:
    """Return the lines of force of teeth or strands, in the axes of the joint that carries them."""
    model, (carrier, placement) = mechanism.centred_model, carried
    data = model.createData()
    columns = pin.computeJointJacobians(model, data, mechanism.neutral)
    where = f"mechanism {mechanism.name!r}: closure {closure.name!r}"
    supports = constraints_of(mechanism).supports
    to_world = data.oMi[carrier] * placement
    own = [mechanism.coordinate(name).v for name in closure.joints]
    rows = np.vstack([row[own], *((columns * supports[carrier])[:, own])])
    free = decompose(rows).null_space
    if len(free) != 1 or not free[0][0]:
        raise MechanismFileError(
            f"{where}: frame {path.frame or model.names[carrier]!r} does not carry its joints: "
            "beside it they have to move by one freedom, as gears on their carrier")
    v = np.zeros(model.nv)
    v[own] = free[0] / free[0][0]
    moving = columns * supports[bodies[0]], columns * supports[bodies[1]]
    pieces = ([_tooth_line(where, path, to_world, moving, v, row)] if isinstance(path, Teeth)
              else _strand_lines(where, path, to_world, moving, row))
    back = data.oMi[carrier].inverse()
    return [x._replace(point=back.act(x.point), along=back.rotation @ x.along,
                       aside=back.rotation @ x.aside) for x in pieces]


def _tooth_line(
    where: str, teeth: Teeth, to_world: pin.SE3, moving: tuple[Array, Array], v: Array, row: Array
) -> ForceLine:
    p = to_world.act(teeth.point)
    (v1, w1), (v2, w2) = ((_at(x, p) @ v, x[3:] @ v) for x in moving)
    speed = float(np.linalg.norm(v1))
    apart = float(np.linalg.norm(v1 - v2))
    arms = [np.cross(x, w) / (w @ w) if np.any(w) else None for x, w in ((v1, w1), (v2, w2))]
    if np.linalg.norm(np.cross(v1, v2)) > CROSSED * speed * float(np.linalg.norm(v2)):
        n, e = _crossed_teeth(where, teeth, (v1, w1), v2)
        aside = math.tan(teeth.pressure_angle) * _outwards(arms, e) * e
        return ForceLine(p, n, aside, _by_multiplier(where, p, n, moving, row))
    if speed == 0.0 or apart > ROLLING * speed:
        raise MechanismFileError(
            f"{where}: teeth: at the point the bodies move at {speed:.6g} and "
            f"{np.linalg.norm(v2):.6g} m/s, {apart:.3g} m/s apart, when the first joint moves at "
            "1 rad/s or m/s; it is where the pitch circles touch, whose radii are in the "
            "coupling's ratio")
    t = v1 / speed
    line = (w2 - w1 if teeth.pitch_line is None
            else to_world.rotation @ teeth.pitch_line)  # relative rotation: about the pitch line
    across = line - (line @ t) * t
    if np.linalg.norm(across) <= ROLLING * max(float(np.linalg.norm(line)), 1e-300):
        across = next((w - (w @ t) * t for w in (w1, w2) if np.any(w)), np.zeros(3))
    if not np.any(across):
        raise MechanismFileError(f"{where}: teeth: both joints slide, and have no pitch line")
    g = across / np.linalg.norm(across)
    e = np.cross(t, g)
    # a right-handed tooth leans from the axis that it turns about towards its motion
    hand = math.copysign(1.0, w1 @ g) if np.any(w1) else -math.copysign(1.0, w2 @ g)
    along = t - hand * math.tan(teeth.helix_angle) * g
    aside = math.tan(teeth.pressure_angle) / math.cos(teeth.helix_angle) * _outwards(arms, e) * e
    return ForceLine(p, along, aside, _by_multiplier(where, p, t, moving, row))


def _outwards(arms: Sequence[Array | None], e: Array) -> float:
    """Return 1 if a direction (3,) leads from the first body into the second, else -1.

    Args:
        arms: of both, from their axes to the point; None of a rack.
        e: square to both pitch surfaces.
    """
    away = [None if arm is None else float(arm @ e) for arm in arms]
    if away[0] is None or (away[1] is not None and away[0] * away[1] > 0.0
                           and abs(away[0]) > abs(away[1])):  # a rack, or a ring about a pinion
        return -math.copysign(1.0, away[1] or 1.0)
    return math.copysign(1.0, away[0])


def _crossed_teeth(
    where: str, teeth: Teeth, first: tuple[Array, Array], v2: Array
) -> tuple[Array, Array]:
    """Return the normal of teeth in the plane of both velocities, and the one of that plane.

    Raises:
        MechanismFileError: their helix angle is not that of the ratio.
    """
    v1, w1 = first
    e = np.cross(v1, v2)
    e /= np.linalg.norm(e)
    tooth = (v1 - v2) / np.linalg.norm(v1 - v2)
    if np.any(w1):
        axis = w1 / np.linalg.norm(w1)
        tooth = tooth * math.copysign(1.0, tooth @ axis)
        helix = math.atan2(float(tooth @ v1) / float(np.linalg.norm(v1)), float(tooth @ axis))
        if teeth.helix_angle and abs(helix - teeth.helix_angle) > HELIX_DIGITS:
            raise MechanismFileError(
                f"{where}: teeth: helix_angle is {teeth.helix_angle:.9g} rad; where axes cross it "
                f"follows from the ratio and the point, and is {helix:.9g} rad here (leave it out, "
                "or change these)")
    n = np.cross(e, tooth)
    return n * math.copysign(1.0, n @ v1), e


def _strand_lines(
    where: str, strands: Strands, to_world: pin.SE3, moving: tuple[Array, Array], row: Array
) -> list[ForceLine]:
    lines = []
    for one, two in strands.points:
        p1, p2 = to_world.act(one), to_world.act(two)
        u = (p1 - p2) / np.linalg.norm(p1 - p2)  # it pulls the second body towards the first
        lines.append(ForceLine(p2, u, np.zeros(3), _by_multiplier(where, p2, u, moving, row),
                          strands.pretension if len(strands.points) == 2 else None))
    if len(lines) == 2 and lines[0].by_multiplier * lines[1].by_multiplier > 0.0:
        raise MechanismFileError(f"{where}: strands: both get tighter with the same torque; of a "
                                 "belt one does")
    return lines


def _by_multiplier(
    where: str, p: Array, t: Array, moving: tuple[Array, Array], row: Array
) -> float:
    """Return F of a unit of the multiplier from F t . (J2 - J1) = multiplier * row."""
    power = t @ (_at(moving[1], p) - _at(moving[0], p))
    factor = float(row @ row) / float(power @ row) if power @ row else 0.0
    if not factor or np.abs(factor * power - row).max() > ROLLING * np.abs(row).max():
        raise MechanismFileError(
            f"{where}: a force along {np.round(t, 6).tolist()} at {np.round(p, 6).tolist()} m does "
            "not act on its joints in the coupling's ratio: check the point, and the frame that "
            "carries it")
    return factor


def _at(columns: Array, point: Array) -> Array:
    """Return velocities (3, nv) of a point of a body from its Jacobian about the world's origin."""
    return columns[:3] - pin.skew(point) @ columns[3:]
