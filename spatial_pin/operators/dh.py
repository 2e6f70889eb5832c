"""Denavit-Hartenberg tables in Craig's convention, and the Pinocchio models they describe.

A row takes frame i-1 to frame i: turn by alpha about x, move by a along x, turn by theta about the
new z, move by d along it [Craig2005, 3.4; Pham, 1.3]. Frame i moves with link i; its z is the axis
of joint i.

To add a joint type, add one entry to `DH_JOINTS`: its Pinocchio joint about z as a function of the
lead, and the (2, n) matrix that takes its n coordinates to the angle and the slide that they add.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin._support.checks import checked, finite_array, finite_number, rows_of
from spatial_pin.errors import suggestion
from spatial_pin.numerics.linalg import Array
from spatial_pin.operators.rotation import rotation_matrix


class DHRow(NamedTuple):
    """One row of a Denavit-Hartenberg table.

    Attributes:
        a: a of i-1, along x of i-1 [m].
        alpha: alpha of i-1, about x of i-1 [rad].
        d: along z of i [m]; a joint that slides adds to it.
        theta: about z of i [rad]; a joint that turns adds to it.
        joint: a name of `DH_JOINTS`.
        name: of the joint; "" for joint1, joint2, ... by row.
        link: of the frame i; "" for link1, link2, ... by row.
        lead: translation per turn of a screw [m].

    Example:
        >>> from spatial_pin import operators
        >>> row = operators.DHRow(a=0.4, alpha=0.0, d=0.1, theta=0.0)  # [m], [rad]
        >>> row.joint, row.a
        ('revolute', 0.4)
    """

    a: float
    alpha: float
    d: float
    theta: float
    joint: str = "revolute"
    name: str = ""
    link: str = ""
    lead: float = 0.0


class DHJoint(NamedTuple):
    """One entry of `DH_JOINTS`; see the module's docstring."""

    model: Callable[[float], pin.JointModel] | None
    motion: Callable[[float], Array]


class DirectionCosines(NamedTuple):
    """Orientation of a link: A (3, 3), dA/dt [1/s] and d2A/dt2 [1/s^2], body to base axes.

    Example:
        >>> from spatial_pin import operators
        >>> table = [operators.DHRow(0.0, 0.0, 0.2, 0.0)]
        >>> found = operators.dh_direction_cosines(table, [0.3], [2.0], [0.0])[0]
        >>> found.cosines.shape, found.rate[1].round(4)  # [1/s]
        ((3, 3), array([ 1.9107, -0.591 ,  0.    ]))
    """

    cosines: Array
    rate: Array
    acceleration: Array


@checked
def dh_placement(a: float, alpha: float, d: float, theta: float) -> pin.SE3:
    """Return frame i in frame i-1: Rot_x(alpha) Trans_x(a) Rot_z(theta) Trans_z(d).

    Source: [Craig2005, eq. 3.6]; the matrix of [Pham, eq. 18] is misprinted. Lengths [m], angles
    [rad].

    Args:
        a: of row i-1, along x of frame i-1 [m].
        alpha: of row i-1, about x of frame i-1 [rad].
        d: along z of frame i [m].
        theta: about z of frame i [rad].

    Raises:
        ValueError: NaN or infinite.

    Example:
        >>> from spatial_pin import operators
        >>> operators.dh_placement(0.4, 0.0, 0.1, np.pi / 2).translation.round(4)  # [m]
        array([0.4, 0. , 0.1])
    """
    about_x = rotation_matrix("x", alpha)
    along_z = about_x[:, 2] * finite_number(d, "d")
    translation = np.array([finite_number(a, "a"), 0.0, 0.0]) + along_z
    return pin.SE3(about_x @ rotation_matrix("z", theta), translation)


@checked
def dh_link_placements(table: Iterable[Any], q: Any) -> list[pin.SE3]:
    """Return the placement of every row's link in the base frame.

    Args:
        table: rows, `DHRow` or tuples in its order.
        q: (n,) joint coordinates in the order of the rows [rad or m]; cylindrical: angle, slide.

    Raises:
        ValueError: a bad row, or another number of coordinates.

    Example:
        >>> from spatial_pin import operators
        >>> table = [operators.DHRow(0.0, 0.0, 0.2, 0.0), operators.DHRow(0.4, 0.0, 0.0, 0.0)]
        >>> found = operators.dh_link_placements(table, [np.pi / 2, 0.0])
        >>> found[1].translation.round(4)  # [m]
        array([0. , 0.4, 0.2])
    """
    rows = checked_table(table)
    placements, current = [], pin.SE3.Identity()
    for row, (angle, slide) in zip(rows, _motions(rows, q, "q"), strict=True):
        current = current * dh_placement(row.a, row.alpha, row.d + slide, row.theta + angle)
        placements.append(current)
    return placements


@checked
def dh_direction_cosines(table: Iterable[Any], q: Any, v: Any, a: Any) -> list[DirectionCosines]:
    """Return every link's direction cosines and their derivatives by the product rule [Pham, 1.3].

    Args:
        table: rows, `DHRow` or tuples in its order.
        q: (n,) joint coordinates in the order of the rows [rad or m].
        v: (n,) their rates [rad/s or m/s].
        a: (n,) their accelerations [rad/s^2 or m/s^2].

    Raises:
        ValueError: a bad row, or another number of coordinates.

    Example:
        >>> from spatial_pin import operators
        >>> table = [operators.DHRow(0.0, 0.0, 0.2, 0.0), operators.DHRow(0.4, 0.0, 0.0, 0.0)]
        >>> found = operators.dh_direction_cosines(table, [0.3, 0.4], [1.0, 2.0], [0.0, 0.0])
        >>> operators.spatial_angular_velocity(found[1].cosines, found[1].rate).round(4)  # [rad/s]
        array([0., 0., 3.])
    """
    rows = checked_table(table)
    angles = (_motions(rows, values, what)[:, 0]
              for values, what in ((q, "q"), (v, "v"), (a, "a")))
    about_z = pin.skew(np.array([0.0, 0.0, 1.0]))
    current, links = DirectionCosines(np.eye(3), np.zeros((3, 3)), np.zeros((3, 3))), []
    for row, angle, rate, acceleration in zip(rows, *angles, strict=True):
        turn = dh_placement(row.a, row.alpha, row.d, row.theta + angle).rotation
        skew = turn @ about_z
        current = _product(current, DirectionCosines(
            turn, rate * skew, acceleration * skew + rate * rate * (skew @ about_z)))
        links.append(current)
    return links


@checked
def model_from_dh(table: Iterable[Any], name: str = "dh") -> pin.Model:
    """Return the Pinocchio model of a Denavit-Hartenberg table.

    Its configuration is zero where the table's theta and d hold. Every row has a body frame named
    after its link, and a joint or, for a fixed row, a fixed-joint frame named after its joint.
    Links have no mass.

    Args:
        table: rows, `DHRow` or tuples in its order.
        name: of the model.

    Raises:
        ValueError: a bad row, or a name that occurs twice.

    Example:
        >>> from spatial_pin import operators
        >>> table = [operators.DHRow(0.0, 0.0, 0.2, 0.0), operators.DHRow(0.4, 0.0, 0.0, 0.0)]
        >>> model = operators.model_from_dh(table, "arm")
        >>> model.nq, list(model.names)[1:]
        (2, ['joint1', 'joint2'])
    """
    model = pin.Model()
    model.name = name
    parent, frame, placement = 0, 0, pin.SE3.Identity()
    for row in checked_table(table):
        placement = placement * dh_placement(row.a, row.alpha, row.d, row.theta)
        joint = DH_JOINTS[row.joint].model
        if joint is None:
            frame = model.addFrame(
                pin.Frame(row.name, parent, frame, placement, pin.FrameType.FIXED_JOINT))
        else:
            parent = model.addJoint(parent, joint(row.lead), placement, row.name)
            frame, placement = model.addJointFrame(parent, frame), pin.SE3.Identity()
        frame = model.addBodyFrame(row.link, parent, placement, frame)
    return model


def checked_table(table: Iterable[Any]) -> list[DHRow]:
    """Return the rows of a table as `DHRow`, numbers checked and names filled in.

    Raises:
        ValueError: no rows, NaN, infinite, an unknown joint, a lead that the joint does not have,
            or a name that occurs twice.
    """
    rows: list[DHRow] = []
    for i, row in enumerate(rows_of(table, DHRow, "row"), start=1):
        if not isinstance(row.joint, str) or row.joint not in DH_JOINTS:
            raise ValueError(f"row {i}: no joint {row.joint!r}; {suggestion(row.joint, DH_JOINTS)}")
        a, alpha, d, theta, lead = (
            finite_number(getattr(row, key), f"row {i}: {key}")
            for key in ("a", "alpha", "d", "theta", "lead"))
        if lead and row.joint != "screw":
            raise ValueError(f"row {i}: a {row.joint} joint has no lead")
        rows.append(DHRow(a, alpha, d, theta, row.joint, row.name or f"joint{i}",
                          row.link or f"link{i}", lead))
    if not rows:
        raise ValueError("the table has no rows")
    names = [name for row in rows for name in (row.name, row.link)]
    twice = sorted({n for n in names if names.count(n) > 1 or n == "universe"})
    if twice:
        raise ValueError(f"names must differ, also from 'universe': {', '.join(twice)}")
    return rows


def _motions(rows: list[DHRow], coordinates: Any, what: str) -> Array:
    """Return (rows, 2): the angle and the slide, or their rates, that the coordinates add."""
    matrices = [DH_JOINTS[row.joint].motion(row.lead) for row in rows]
    sizes = [m.shape[1] for m in matrices]
    values = finite_array(coordinates, (sum(sizes),), what)
    parts = np.split(values, np.cumsum(sizes)[:-1])
    return np.array([m @ x for m, x in zip(matrices, parts, strict=True)]).reshape(-1, 2)


def _product(b: DirectionCosines, c: DirectionCosines) -> DirectionCosines:
    return DirectionCosines(
        b.cosines @ c.cosines,
        b.rate @ c.cosines + b.cosines @ c.rate,
        b.acceleration @ c.cosines + 2.0 * b.rate @ c.rate + b.cosines @ c.acceleration,
    )


def _cylindrical_about_z(_: float) -> pin.JointModel:
    joint = pin.JointModelComposite()
    joint.addJoint(pin.JointModelRZ())
    joint.addJoint(pin.JointModelPZ())
    return joint


DH_JOINTS: dict[str, DHJoint] = {
    "revolute": DHJoint(lambda _: pin.JointModelRZ(), lambda _: np.array([[1.0], [0.0]])),
    "prismatic": DHJoint(lambda _: pin.JointModelPZ(), lambda _: np.array([[0.0], [1.0]])),
    "screw": DHJoint(lambda lead: pin.JointModelHZ(lead / (2.0 * math.pi)),
                     lambda lead: np.array([[1.0], [lead / (2.0 * math.pi)]])),
    "cylindrical": DHJoint(_cylindrical_about_z, lambda _: np.eye(2)),
    "fixed": DHJoint(None, lambda _: np.zeros((2, 0))),
}
