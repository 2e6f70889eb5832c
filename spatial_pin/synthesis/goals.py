"""Goals of `design`: each function returns a goal.

A goal with a weight is met as well as possible: the sum of weight² residual² is minimised, with
lengths relative to the characteristic length, angles in rad, and other quantities relative to their
bound. A goal with `weight=None` is met exactly. By default paths, poses and functions have the
weight 1, and goals for the whole mechanism have no weight.

Example:
    >>> goals = [sp.goals.turns("crank"), sp.goals.swing("rocker_pin", 1.0)]  # [rad]
    >>> [goal.name for goal in goals]
    ['full turn of crank', 'swing of rocker_pin']
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from spatial_pin._support.checks import (
    checked,
    finite_array,
    finite_number,
    finite_points,
    mapping,
    positive_number,
)
from spatial_pin.numerics.linalg import Array
from spatial_pin.synthesis.demands import (
    DeadCentres,
    FullTurn,
    LeastClearance,
    LeastTransmission,
    MostEffort,
    MostMass,
    MostSize,
    Swing,
    WithinLimits,
)
from spatial_pin.synthesis.precision import FunctionGoal, PathGoal, PosesGoal

__all__ = [
    "clearance", "dead_centres", "effort", "function", "joint_limits", "mass", "path", "poses",
    "size", "swing", "transmission", "turns",
]


def __dir__() -> list[str]:
    return __all__


def _weight(weight: float | None) -> float | None:
    if weight is None:
        return None
    if not finite_number(weight, "weight") > 0.0:
        raise ValueError(f"weight is {weight:g}; it is larger than 0, or None for a goal that is "
                         "to be met exactly")
    return float(weight)


def _timed(drivers: Mapping[str, Any] | None, k: int) -> dict[str, Array]:
    return {name: finite_array(values, (k,), f"drivers: values of {name!r}")
            for name, values in mapping({} if drivers is None else drivers, "drivers").items()}


@checked
def path(
    frame: str, points: Any, drivers: Mapping[str, Any] | None = None, *, closed: bool = False,
    scale: bool = False, placement: bool = False, input_offset: bool = False,
    weight: float | None = 1.0,
) -> PathGoal:
    """Ask that the origin of a frame goes through points.

    Args:
        frame: name of a link, frame or joint.
        points: (k, 3), or (k, 2) in the x-y plane of the world [m]; one alone may be (3,).
        drivers: {name: (k,)} values of drivers at the points [rad or m]; None: the timing is free.
        closed: whether the path comes back to its first point.
        scale: whether the points may be scaled together.
        placement: whether the points may be moved and turned together.
        input_offset: whether the drivers count from a zero that is found with the dimensions.
        weight: as for all goals: None is exact.

    Raises:
        ValueError: points or values are not numbers, or not as many.

    Example:
        >>> points = [[0.05, 0.0, 0.10], [0.0, 0.0, 0.12], [-0.05, 0.0, 0.10]]  # (k, 3) [m]
        >>> goal = sp.goals.path("coupler_b", points, placement=True)  # wherever they are drawn
        >>> goal.name, goal.weight
        ('path of coupler_b', 1.0)
    """
    array = np.asarray(points)
    flat = array.shape[-1:] == (2,)
    rows = np.atleast_2d(finite_points(points, 2 if flat else 3, "points"))
    if flat:
        rows = np.hstack([rows, np.zeros((len(rows), 1))])
    if not len(rows):
        raise ValueError("path: there are no points")
    return PathGoal(
        weight=_weight(weight), frame=frame, points=rows, placement=placement, scale=scale,
        drivers=_timed(drivers, len(rows)), input_offset=input_offset, closed=closed)


@checked
def poses(
    frame: str, placements: Sequence[Any], drivers: Mapping[str, Any] | None = None, *,
    scale: bool = False, placement: bool = False, input_offset: bool = False,
    weight: float | None = 1.0,
) -> PosesGoal:
    """Ask that a frame goes through placements.

    Args:
        frame: name of a link, frame or joint.
        placements: `pinocchio.SE3` or (4, 4) of the frame in the world.
        drivers: as for `path`.
        scale: whether the places may be scaled together.
        placement: whether the placements may be moved and turned together.
        input_offset: as for `path`.
        weight: as for all goals: None is exact.

    Raises:
        ValueError: a placement is none.

    Example:
        >>> poses = [pin.SE3(pin.utils.rotate("y", x), np.array([x, 0.0, 0.1])) for x in (0.0, 0.2)]
        >>> sp.goals.poses("coupler", poses).name
        'poses of coupler'
    """
    targets = [_placement(x, i) for i, x in enumerate(placements)]
    if not targets:
        raise ValueError("poses: there are no placements")
    return PosesGoal(
        weight=_weight(weight), frame=frame, points=np.array([x.translation for x in targets]),
        rotations=np.array([x.rotation for x in targets]), placement=placement, scale=scale,
        drivers=_timed(drivers, len(targets)), input_offset=input_offset)


def _placement(given: Any, i: int) -> pin.SE3:
    if isinstance(given, pin.SE3):
        return given
    array = finite_array(given, (4, 4), f"placement {i}")
    rotation = array[:3, :3]
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-9 or np.linalg.det(rotation) < 0.0:
        raise ValueError(f"placement {i} has no rotation in its first three rows and columns")
    return pin.SE3(rotation, array[:3, 3])


@checked
def function(
    output: str, values: Any, drivers: Mapping[str, Any], *, offset: bool = False,
    input_offset: bool = False, weight: float | None = 1.0,
) -> FunctionGoal:
    """Ask that a coordinate follows drivers.

    Args:
        output: name of a coordinate of a joint of one freedom, or of a cylinder's or the like.
        values: (k,) of it [rad or m]; angles are met but for whole turns.
        drivers: {name: (k,)} values of drivers at the same configurations.
        offset: whether the output counts from a zero that is found with the dimensions.
        input_offset: whether the drivers do.
        weight: as for all goals: None is exact.

    Raises:
        ValueError: values are not numbers, or not as many; there are no drivers.

    Example:
        >>> crank = np.linspace(1.0, 2.0, 5)  # (k,) [rad]
        >>> goal = sp.goals.function("rocker_pin", 1.6 + 0.4 * (crank - 1.0), {"crank": crank})
        >>> goal.name
        'function of rocker_pin'
    """
    array = finite_array(values, np.shape(values), "values")
    if array.ndim != 1 or not len(array):
        raise ValueError(f"function: values of {output!r} are a list of numbers")
    timed = _timed(drivers, len(array))
    if not timed:
        raise ValueError("function: drivers names no driver; give {name: values}")
    return FunctionGoal(weight=_weight(weight), output=output, values=array, offset=offset,
                    drivers=timed, input_offset=input_offset)


# ---------------------------------------------------------------- of the mechanism as a whole


def _values(values: Any) -> Array | None:
    if values is None:
        return None
    array = np.atleast_1d(finite_array(values, np.shape(values), "values"))
    if array.ndim != 1 or not len(array):
        raise ValueError("values are a list of driver values, or None for all that it can have")
    return array


@checked
def swing(
    output: str, angle: float, driver: str | None = None, *, values: Any = None,
    weight: float | None = None,
) -> Swing:
    """Ask how far an output goes to and fro while a driver turns, or goes from limit to limit.

    Limits are those of the loops, as `limits` finds them; those of joints are for `joint_limits`.

    Args:
        output: name of a coordinate.
        angle: from its least to its largest value [rad or m].
        driver: what moves it; the only driver if not given.
        values: (k,) driver values that are gone through instead.
        weight: as for all goals.

    Raises:
        ValueError: the angle is not larger than 0.

    Example:
        >>> sp.goals.swing("rocker_pin", np.radians(60.0)).name  # [rad]
        'swing of rocker_pin'
    """
    return Swing(weight=_weight(weight), output=output, angle=positive_number(angle, "angle"),
                 driver=driver, at=_values(values))


@checked
def transmission(
    output: str, at_least: float, driver: str | None = None, *, pair: str | None = None,
    values: Any = None, weight: float | None = None,
) -> LeastTransmission:
    """Ask that the transmission angle of an output is nowhere smaller.

    Args:
        output: name of a coordinate of a joint of one freedom.
        at_least: angle, up to pi/2 [rad].
        driver: what moves it; the only driver if not given. It counts over a turn of it, or from
            limit to limit, where it is zero: name `values` then.
        pair: closure or joint that moves the output's link, as `at` of `transmission`.
        values: (k,) driver values at which it counts instead.
        weight: as for all goals.

    Raises:
        ValueError: the angle is none that it can have.

    Example:
        >>> sp.goals.transmission("rocker_pin", np.radians(40.0)).name  # [rad]
        'transmission to rocker_pin'
    """
    angle = positive_number(at_least, "at_least")
    if angle > np.pi / 2.0:
        raise ValueError(f"transmission: at_least is {angle:g} rad; it is pi/2 at most")
    return LeastTransmission(weight=_weight(weight), output=output, at_least=angle, driver=driver,
                             pair=pair, at=_values(values))


@checked
def turns(driver: str | None = None, *, weight: float | None = None) -> FullTurn:
    """Ask that a driver turns all the way round, without a limit.

    It keeps half a degree of transmission angle away from one.

    Args:
        driver: name of a driver or coordinate that turns; the only driver if not given.
        weight: as for all goals.

    Raises:
        ValueError: the weight is not positive.

    Example:
        >>> sp.goals.turns("crank").name
        'full turn of crank'
    """
    return FullTurn(weight=_weight(weight), driver=driver)


@checked
def joint_limits(
    driver: str | None = None, *, values: Any = None, weight: float | None = None,
) -> WithinLimits:
    """Ask that no joint passes its limits of the URDF while a driver moves.

    Without it they are passed if that serves the other goals, and a design says so in its defects.

    Args:
        driver: what moves it; the only driver if not given. It counts over a turn of it, or from
            limit to limit of the loops; limits of its own joint do not, name `values` for them.
        values: (k,) driver values that are gone through instead.
        weight: as for all goals.

    Raises:
        ValueError: a value is not finite, or the weight not positive.

    Example:
        >>> sp.goals.joint_limits().name
        'joint limits'
    """
    return WithinLimits(weight=_weight(weight), driver=driver, at=_values(values))


@checked
def dead_centres(
    output: str, values: Any, driver: str | None = None, *, weight: float | None = None,
) -> DeadCentres:
    """Ask that an output stands still at values of a driver.

    Args:
        output: name of a coordinate. For dead centres of a driver itself, name it here, and another
            coordinate as the driver.
        values: (k,) of the driver [rad or m].
        driver: what moves it; the only driver if not given.
        weight: as for all goals.

    Raises:
        ValueError: there are no values.

    Example:
        >>> sp.goals.dead_centres("rocker_pin", [0.5, 3.7], "crank").name  # of the crank [rad]
        'dead centres of rocker_pin'
    """
    at = _values(values)
    if at is None:
        raise ValueError("dead_centres: values of the driver are needed: say where they are to be")
    return DeadCentres(weight=_weight(weight), output=output, driver=driver, at=at)


@checked
def effort(
    at_most: float, driver: str | None = None, *, loads: Mapping[str, Any] | None = None,
    values: Any = None, weight: float | None = None,
) -> MostEffort:
    """Ask that a driver needs nowhere a larger effort to hold the mechanism at rest.

    Args:
        at_most: effort either way [N m or N].
        driver: which one; the only driver if not given. It counts over a turn of it, or from limit
            to limit, where it may be infinite: name `values` then.
        loads: {frame: pinocchio.Force or (6,)}, force and moment at the origin of a link, frame or
            joint, world axes, besides gravity.
        values: (k,) driver values at which it counts instead.
        weight: as for all goals.

    Raises:
        ValueError: the effort, or the weight, is not positive and finite.

    Example:
        >>> load = pin.Force(np.array([0.0, 0.0, -50.0]), np.zeros(3))  # [N], [N·m], world axes
        >>> sp.goals.effort(2.0, "crank", loads={"coupler_b": load}).name  # at most 2 N·m
        'effort of crank'
    """
    wrenches = {name: finite_array(load.vector if isinstance(load, pin.Force) else load, (6,),
                                f"load at {name!r}")
             for name, load in mapping(loads, "loads").items()}
    return MostEffort(weight=_weight(weight), at_most=positive_number(at_most, "at_most"),
                      driver=driver, loads=wrenches, at=_values(values))


@checked
def size(
    at_most: float, driver: str | None = None, *, values: Any = None, weight: float | None = None,
) -> MostSize:
    """Ask that no two joints or closures are ever farther apart.

    Args:
        at_most: distance [m].
        driver: what moves it; the only driver if not given. It counts over a turn of it, or from
            limit to limit.
        values: (k,) driver values at which it counts instead.
        weight: as for all goals.

    Raises:
        ValueError: the distance, or the weight, is not positive and finite.

    Example:
        >>> sp.goals.size(0.6).name  # [m]
        'size'
    """
    return MostSize(weight=_weight(weight), at_most=positive_number(at_most, "at_most"),
                    driver=driver, at=_values(values))


@checked
def mass(at_most: float, *, weight: float | None = None) -> MostMass:
    """Ask that all moving links together weigh no more.

    Args:
        at_most: mass [kg].
        weight: as for all goals.

    Raises:
        ValueError: the mass, or the weight, is not positive and finite.

    Example:
        >>> sp.goals.mass(1.5, weight=1.0).name  # [kg]
        'mass'
    """
    return MostMass(weight=_weight(weight), at_most=positive_number(at_most, "at_most"))


@checked
def clearance(
    at_least: float, pairs: Iterable[tuple[str, str]] | None = None, driver: str | None = None, *,
    values: Any = None, weight: float | None = None,
) -> LeastClearance:
    """Ask that links that are not joined stay apart, as `sp.clearance` measures it.

    Args:
        at_least: distance [m].
        pairs: names of two links each; default all that are not joined.
        driver: what moves them; the only driver if not given. It counts over a turn of it, or from
            limit to limit.
        values: (k,) driver values that are gone through instead.
        weight: as for all goals.

    Raises:
        ValueError: the distance is no number; pairs are none.

    Example:
        >>> sp.goals.clearance(0.02, pairs=[("crank", "rocker")]).name  # [m]
        'clearance'
    """
    named: tuple[tuple[str, str], ...] | None = None
    if pairs is not None:
        pairs = list(pairs)
        for pair in pairs:
            if isinstance(pair, str) or np.shape(pair) != (2,):
                raise ValueError(f"clearance: a pair is the names of two links, not {pair!r}")
        named = tuple((str(first), str(second)) for first, second in pairs)
    if named == ():
        raise ValueError("clearance: pairs is empty: name two links each, or leave it out for all")
    return LeastClearance(weight=_weight(weight), at_least=finite_number(at_least, "at_least"),
                          pairs=named, driver=driver, at=_values(values))
