"""Checks of a mechanism: names must exist, closures and inertias be possible; and its guess."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from itertools import combinations, pairwise
from typing import Any

import numpy as np
import pinocchio as pin

from spatial_pin._support.lazy import made_once
from spatial_pin.errors import MechanismFileError, Mistakes, SpatialPinError
from spatial_pin.mechanism.coordinates import joint_values, with_values
from spatial_pin.mechanism.mechanism import Mechanism, point_on_body, rigid_distance
from spatial_pin.mechanism.parts import Closure, Driver, Passive, Spring
from spatial_pin.numerics.linalg import EPS, Array
from spatial_pin.numerics.tolerances import TOLERANCES

# Relative to mass times length squared: exporters write inertias with six digits or more.
ROUNDED = 1e-6


def check_mechanism(mechanism: Mechanism, where: str, mistakes: Mistakes | None = None) -> None:
    """Refuse names that do not exist and closures that cannot be; `where` is the file.

    Mistakes are collected, to be raised later, or raised here.
    """
    collected = Mistakes(where) if mistakes is None else mistakes
    for kind in ("closures", "springs"):
        names = [x.name for x in getattr(mechanism, kind)]
        with collected.each():
            for k, name in enumerate(names):
                if name in names[:k]:
                    raise MechanismFileError(f"{where}: {kind}: two are named {name!r}")
    for closure in mechanism.closures:
        with collected.each():
            _check_closure(mechanism, closure, f"{where}: closure {closure.name!r}")
    driven: dict[str, str] = {}
    for driver in mechanism.drivers.values():
        with collected.each():
            _check_driver(mechanism, driver, driven, f"{where}: drivers.{driver.name}")
    for spring in mechanism.springs:
        with collected.each():
            _check_spring(mechanism, spring, f"{where}: spring {spring.name!r}")
    for passive in mechanism.passives:
        with collected.each():
            _check_passive(mechanism, passive, f"{where}: passive.{passive.name}")
    if mistakes is None:
        collected.raise_all()


def sided(mechanism: Mechanism) -> Mechanism:
    """Return a mechanism with the sides of contacts that its guess shows, see `Pair.at_guess`."""
    if not any(c.pair.at_guess for c in mechanism.closures):
        return mechanism
    q = with_values(mechanism, mechanism.neutral, joint_values(mechanism, mechanism.guess))
    data, closures = mechanism.model.createData(), []
    pin.forwardKinematics(mechanism.model, data, q)
    for c in mechanism.closures:
        if c.pair.at_guess:
            one, two = (data.oMi[joint] * at for joint, at in map(
                mechanism.frame_on_joint, c.frames))
            numbers = c.pair.at_guess(c, one.actInv(two), bool(mechanism.guess))
            c = replace(c, numbers={**c.numbers, **numbers})
        closures.append(c)
    return mechanism.with_fields(closures=tuple(closures))


def _check_spring(mechanism: Mechanism, spring: Spring, where: str) -> None:
    bodies = _bodies(mechanism, spring.frames, f"{where}: ")
    if len(bodies) == 2 and bodies[0] == bodies[1]:
        raise MechanismFileError(
            f"{where}: frames {spring.frames[0]!r} and {spring.frames[1]!r} are fixed to the same "
            "body"
        )
    if spring.joint is not None:
        coordinate = _looked_up(mechanism.prescribed_coordinate, spring.joint, f"{where}: ")
        if spring.free_length and coordinate.unit == "rad":
            raise MechanismFileError(
                f"{where}: {spring.joint!r} turns; give free_angle, not free_length")


def _check_driver(mechanism: Mechanism, driver: Driver, driven: dict[str, str], here: str) -> None:
    """Refuse a wrong driver; `driven` gets it, by its coordinate, like those before it."""
    table = mechanism.coordinate_table
    others = mechanism.drivers.keys() - {driver.name}
    if driver.joint in others and driver.joint not in table:
        raise MechanismFileError(
            f"{here}.joint: {driver.joint!r} is a driver, not a joint or coordinate; "
            f"there are: {', '.join(table)}"
        )
    _looked_up(mechanism.prescribed_coordinate, driver.joint, f"{here}.joint: ")
    if driver.name in table and driver.name != driver.joint:
        raise MechanismFileError(
            f"{here}: has the name of another coordinate than its own, {driver.joint!r}"
        )
    if driver.joint in driven:
        raise MechanismFileError(
            f"{here}: {driver.joint!r} is driven by {driven[driver.joint]!r} already"
        )
    driven[driver.joint] = driver.name


def _check_closure(mechanism: Mechanism, closure: Closure, where: str) -> None:
    _all_looked_up(mechanism.driven_coordinate, closure.joints, f"{where}: joints: ")
    for name in closure.joints:
        if closure.joints.count(name) > 1:
            raise MechanismFileError(f"{where}: couples {name!r} with itself")
    ids = _bodies(mechanism, closure.frames, f"{where}: frames: ")
    if closure.acts_at is not None and closure.acts_at.frame:
        _looked_up(mechanism.frame_id, closure.acts_at.frame, f"{where}: frame: ")
    if closure.pair.has_more and closure.frames:
        _check_rope(mechanism, closure, ids, where)
        return
    for (name, body), (other, its) in combinations(zip(closure.frames, ids, strict=True), 2):
        if name == other:
            raise MechanismFileError(f"{where}: joins frame {name!r} with itself")
        if body == its:
            raise MechanismFileError(
                f"{where}: frames {name!r} and {other!r} are fixed to the same body; a closure "
                "joins two bodies that can move against each other")
    frames = _all_looked_up(
        mechanism.frame_on_joint, closure.between, f"{where}: length_between: ")
    if closure.between and set(closure.between) == set(closure.frames):
        raise MechanismFileError(f"{where}: length_between: its own frames, which says nothing")
    length = rigid_distance(*frames) if frames else None
    if length is not None and length <= EPS * mechanism.characteristic_length:
        raise MechanismFileError(
            f"{where}: length_between: {closure.between[0]!r} and {closure.between[1]!r} are at "
            "the same place of one body, and a distance is positive; for no distance use a "
            "spherical closure"
        )


def _check_rope(mechanism: Mechanism, closure: Closure, ids: list[int], where: str) -> None:
    """Refuse a rope that has a part without length, or none that changes its length."""
    for one, two in pairwise(closure.frames):
        length = rigid_distance(*map(mechanism.frame_on_joint, (one, two)))
        if length is not None and length <= EPS * mechanism.characteristic_length:
            raise MechanismFileError(f"{where}: frames {one!r} and {two!r} are at the same place "
                                     "of one body; a part of a rope has a length")
    if len(set(ids)) == 1:
        raise MechanismFileError(f"{where}: frames: all are fixed to the same body; a closure "
                                 "joins two bodies that can move against each other")


def _bodies(mechanism: Mechanism, frames: tuple[str, ...], where: str) -> list[int]:
    return [joint for joint, _ in _all_looked_up(mechanism.frame_on_joint, frames, where)]


def _looked_up(lookup: Any, name: str, where: str) -> Any:
    """Return the result of a look-up by name; the error for an unknown name has `where`."""
    try:
        return lookup(name)
    except SpatialPinError as error:
        raise MechanismFileError(f"{where}{error}") from error


def _all_looked_up(lookup: Any, names: Iterable[str], where: str) -> list[Any]:
    """Return the results of a look-up by names; the error has a mistake for each that fails."""
    named_ones, mistakes = [], Mistakes(where)
    for name in names:
        with mistakes.each():
            named_ones.append(_looked_up(lookup, name, where))
    mistakes.raise_all()
    return named_ones


def _check_passive(mechanism: Mechanism, passive: Passive, where: str) -> None:
    body = _looked_up(mechanism.frame_on_joint, passive.body, f"{where}.body: ")[0]
    if body == 0:
        raise MechanismFileError(f"{where}.body: {passive.body!r} is fixed to the ground")
    for name in passive.axis:
        _looked_up(mechanism.frame_id, name, f"{where}.axis: ")
    points = [point_on_body(mechanism, body, name, f"{where}.axis: ") for name in passive.axis]
    if np.linalg.norm(points[1] - points[0]) < TOLERANCES.tight * mechanism.characteristic_length:
        raise MechanismFileError(
            f"{where}.axis: {passive.axis[0]!r} and {passive.axis[1]!r} are the same point"
        )


@made_once
def impossible_inertias(mechanism: Mechanism) -> tuple[dict[str, str], dict[str, str]]:
    """Return the links of bodies with impossible inertias, and these as text.

    First those with a negative mass or principal moment of inertia; then those with a principal
    moment larger than the sum of the other two. Links that are fixed to one another count as one
    body. Differences that rounding of the file's numbers explains pass.
    """
    model, length = mechanism.model, mechanism.characteristic_length
    faults: tuple[dict[str, str], dict[str, str]] = {}, {}
    for kinds, kind in zip(_kinds(list(model.inertias)[1:], length), faults, strict=True):
        for joint in map(int, np.flatnonzero(kinds) + 1):
            links = [f.name for f in model.frames
                     if f.type == pin.FrameType.BODY and f.parentJoint == joint]
            own = [x for x in links if x in mechanism.inertias]
            at_fault = [x for x in own if np.any(_kinds([mechanism.inertias[x]], length))]
            for name in at_fault or own[:1] or [model.names[joint]]:
                body = mechanism.inertias.get(name, model.inertias[joint])
                moments = ", ".join(f"{x:.4g}" for x in np.linalg.eigvalsh(body.inertia))
                kind[name] = f"mass {body.mass:.4g} kg, principal moments {moments} kg·m²"
    return faults


def refuse_negative_inertias(mechanism: Mechanism) -> None:
    """Refuse a body whose mass, or a moment of inertia, is below zero (SpatialPinError)."""
    for link, words in impossible_inertias(mechanism)[0].items():
        raise SpatialPinError(
            f"mechanism {mechanism.name!r}: link {link!r} has {words}: below zero, which no body "
            "has, so that no forces come of it; mend its <inertial>")


def _kinds(bodies: list[pin.Inertia], length: float) -> Array:
    """Return which bodies have negative, and which else lopsided inertias, shape (2, N)."""
    mass = np.array([x.mass for x in bodies])
    a, b, c = np.linalg.eigvalsh(np.array([x.inertia for x in bodies]).reshape(-1, 3, 3)).T
    slack = ROUNDED * np.maximum(np.maximum(abs(a), abs(c)), abs(mass) * length**2)
    negative = (mass < 0.0) | (a < -slack)
    return np.array([negative, ~negative & (a + b < c - slack)])


@made_once
def has_inertia(mechanism: Mechanism) -> bool:
    """Whether anything that moves has a mass, a moment of inertia or an armature."""
    model = mechanism.model
    return bool(np.any(model.armature)) or any(
        bool(x.mass) or bool(np.any(x.inertia)) for x in list(model.inertias)[1:])
