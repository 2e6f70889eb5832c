"""A Pinocchio model of any joints as one whose joints are pairs of this library.

Joints that are a pair stay. An angle that Pinocchio keeps as (cos, sin) becomes one
coordinate, so that it counts turns; a mimicking joint gets its coordinate back, with a coupling.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin

from spatial_pin._support.checks import finite_array
from spatial_pin.errors import SpatialPinError
from spatial_pin.formats.urdf.elements import UNBOUNDED
from spatial_pin.mechanism.pairs import COUPLING, PAIRS, axes_from_z, unit
from spatial_pin.mechanism.parts import Closure
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES

Z = np.array([0.0, 0.0, 1.0])
ROUNDED = 1e-6  # of rotations: those of 32 bits, multiplied a few times
LOWER = {"lowerVelocityLimit": "upperVelocityLimit", "lowerEffortLimit": "upperEffortLimit"}
V_ARRAYS = ("lowerEffortLimit", "upperEffortLimit", "lowerVelocityLimit", "upperVelocityLimit",
            "lowerDryFrictionLimit", "upperDryFrictionLimit", "damping", "armature",
            "rotorInertia", "rotorGearRatio")
Q_ARRAYS = ("lowerPositionLimit", "upperPositionLimit", "positionLimitMargin")
NEVER_NEGATIVE = ("damping", "armature", "upperDryFrictionLimit")
INSTEAD = {
    "JointModelTranslation": "three prismatic joints, one on the other",
    "JointModelSphericalZYX": "JointModelSpherical, or three revolute joints",
    "JointModelEllipsoid": "JointModelSpherical, if its radii are equal",
    "JointModelComposite": "one joint for each of its joints, on massless bodies",
    "JointModelUniversal": "two revolute joints: its axes are not perpendicular",
    "JointModelMimic": "the joint itself and sp.closures.coupling",
}

Recognised = tuple[str, pin.JointModel]


def pair_tree(
    given: pin.Model, where: str
) -> tuple[pin.Model, tuple[str, ...], tuple[Closure, ...]]:
    """Return a model as one of pairs, the pair of every joint, and couplings of mimicking joints.

    Raises:
        SpatialPinError: a joint is no pair, or two have one name, or a number is impossible.
        ValueError: a number is NaN or infinite.
    """
    _check_names(given, where)
    finite_array(given.gravity.vector, (6,), f"{where}: gravity")
    new, pairs = pin.Model(), []
    new.name, new.gravity = given.name, given.gravity
    mimicking = {int(i): int(j) for i, j in zip(given.mimicking_joints, given.mimicked_joints,
                                                strict=True)}
    for i in range(1, given.njoints):
        pair, joint = _recognised(given, i, f"{where}: joint {given.names[i]!r}")
        new.addJoint(given.parents[i], joint, given.jointPlacements[i], given.names[i])
        pairs.append(pair)
        copy_numbers(given, i, new, i)
    _check_numbers(new, where)
    for frame in list(given.frames)[1:]:
        check_placement(frame.placement, f"{where}: frame {frame.name!r}")
        new.addFrame(frame, False)
    for i, inertia in enumerate(given.inertias):
        parts = inertia.mass, *inertia.lever, *inertia.inertia.flat
        finite_array(parts, (13,), f"{where}: the inertia on joint {given.names[i]!r}")
        new.inertias[i] = inertia
    for entry in given.referenceConfigurations:
        new.referenceConfigurations[entry.key()] = own_configuration(given, new, entry.data())
    mimics = tuple(
        Closure(f"mimic_{given.names[i]}", COUPLING, joints=(given.names[j], given.names[i]),
                numbers={"ratio": float(given.joints[i].extract().scaling),
                         "offset": float(given.joints[i].extract().offset)})
        for i, j in mimicking.items())
    return new, tuple(pairs), mimics


def check_placement(placement: pin.SE3, what: str) -> None:
    """Refuse a placement whose rotation is mirrored, scaled or sheared, or that is not finite."""
    finite_array(placement.homogeneous, (4, 4), what)
    turn = placement.rotation
    off = float(np.abs(turn @ turn.T - np.eye(3)).max())
    if off > ROUNDED or np.linalg.det(turn) < 0.0:
        raise SpatialPinError(f"{what} has a rotation that is none: mirrored, scaled or sheared "
                              f"(R R' differs from the identity by {off:.3g})")


def own_configuration(given: pin.Model, new: pin.Model, q: Array) -> Array:
    """Return a configuration (nq,) of a model as one of its tree of pairs."""
    new_q = np.zeros(new.nq)
    followed = dict(zip(map(int, given.mimicking_joints), map(int, given.mimicked_joints),
                        strict=True))
    for i in sorted(range(1, given.njoints), key=followed.__contains__):
        here = slice(new.idx_qs[i], new.idx_qs[i] + new.nqs[i])
        own = q[given.idx_qs[i] : given.idx_qs[i] + given.nqs[i]]
        if i in followed:
            joint = given.joints[i].extract()
            own = joint.scaling * new_q[new.idx_qs[followed[i]], None] + joint.offset
        elif len(own) != here.stop - here.start:  # it ends with a cosine and a sine
            own = np.append(own[:-2], math.atan2(own[-1], own[-2]))
        new_q[here] = own
    return new_q


def _check_names(model: pin.Model, where: str) -> None:
    seen: set[str] = set()
    for kind, names in (("joint", list(model.names)), ("frame", [f.name for f in model.frames])):
        for name in names:
            if not name or not name.isprintable():
                raise SpatialPinError(f"{where}: a {kind} is named {name!r}; a name is text that "
                                      "can be read")
            if kind == "joint" and name in seen:
                raise SpatialPinError(f"{where}: two joints are named {name!r}")
            seen.add(name)


def _recognised(model: pin.Model, i: int, where: str) -> Recognised:
    """Return the pair of joint i of a model, and the joint of Pinocchio for it."""
    joint = model.joints[i].extract()
    made = None
    if joint.shortname() != "JointModelMimic":
        made = _pair(joint)
    elif joint.scaling != 0.0 and math.isfinite(joint.scaling):  # its motion has its ratio in it
        data = model.createData()
        pin.forwardKinematics(model, data, pin.neutral(model))
        column = np.array(data.joints[i].S).reshape(6, -1)[:, 0] / float(joint.scaling)
        if column[3:].any():
            pitch = float(column[:3] @ column[3:])
            made = _made("screw" if pitch else "revolute", column[3:], 2.0 * math.pi * pitch)
        else:
            made = _made("prismatic", column[:3])
    if made is None:
        kind = joint.shortname()
        parts = ([part.shortname() for part in joint.joints]
                 if isinstance(joint, pin.JointModelComposite) else [])
        raise SpatialPinError(
            f"{where} is a {kind}{f' of {parts}' if parts else ''}, which is no pair of this "
            f"library ({', '.join(n for n, p in PAIRS.items() if p.joint)}); use "
            f"{INSTEAD.get(kind, 'joints that are')}")
    return made


def _pair(joint: Any) -> Recognised | None:
    kind = joint.shortname().removeprefix("JointModel")
    for begin, make in KINDS.items():
        if kind.startswith(begin):
            return make(joint)
    return None


def joint_axis(joint: Any) -> Array:
    """Return the axis (3,) of a joint that turns about, or slides along, one."""
    if hasattr(joint, "axis"):
        return np.array(joint.axis, dtype=float)
    column = np.array(joint.createData().S).reshape(6, -1)[:, 0]
    return column[3:] if column[3:].any() else column[:3]


def _as_it_is(pair: str) -> Callable[[Any], Recognised | None]:
    return lambda joint: (pair, joint)


def _made(pair: str, axis: Array, lead: float = 0.0) -> Recognised:
    joint = PAIRS[pair].joint
    assert joint is not None
    return pair, joint(unit(axis), axis, lead)


def _universal(joint: Any) -> Recognised | None:
    return ("universal", joint) if abs(joint.axis1 @ joint.axis2) <= TOLERANCES.nothing else None


def _composite(joint: Any) -> Recognised | None:
    """Return the pair that a composite joint is: a universal, cylindrical or planar one."""
    parts = [_pair(part.extract()) for part in joint.joints]
    on_one = all(np.array_equal(p.homogeneous, np.eye(4)) for p in joint.jointPlacements)
    if None in parts or not on_one:
        return None
    kinds = [part[0] for part in parts if part]
    if len(kinds) == 1:
        return parts[0]
    axes = [joint_axis(part[1]) for part in parts if part and part[0] in ("revolute", "prismatic")]
    if kinds == ["revolute", "revolute"] and abs(axes[0] @ axes[1]) <= TOLERANCES.nothing:
        return "universal", pin.JointModelUniversal(*axes)
    if kinds == ["revolute", "prismatic"] and np.abs(axes[0] - axes[1]).max() <= TOLERANCES.tight:
        return "cylindrical", joint
    planar = kinds == ["prismatic", "prismatic", "revolute"]
    if planar and np.abs(np.array(axes).T - axes_from_z(axes[2])).max() <= TOLERANCES.tight:
        return "planar", joint
    return None


KINDS: dict[str, Callable[[Any], Recognised | None]] = {  # by how names begin, the first that does
    **dict.fromkeys(("RUB", "RevoluteUnbounded"), lambda x: _made("revolute", joint_axis(x))),
    "R": _as_it_is("revolute"),
    "Planar": lambda _: _made("planar", Z), "P": _as_it_is("prismatic"),
    "H": _as_it_is("screw"),
    "SphericalZYX": lambda _: None, "Spherical": _as_it_is("spherical"),
    "FreeFlyer": _as_it_is("floating"), "Universal": _universal, "Composite": _composite,
}


def copy_numbers(given: pin.Model, i: int, new: pin.Model, k: int) -> None:
    """Copy limits, resistances and armature of joint i of a model to joint k of another."""
    for names, at, counts in ((V_ARRAYS, "idx_vs", "nvs"), (Q_ARRAYS, "idx_qs", "nqs")):
        there, here = int(getattr(given, at)[i]), int(getattr(new, at)[k])
        had, has = int(getattr(given, counts)[i]), int(getattr(new, counts)[k])
        free = 0 if had == 0 else 2 * (had != has)  # cosine and sine, which have no limits
        for name in names:
            values = getattr(given, name)[there : there + had - free]
            if had != has:
                none = math.copysign(math.inf, -1.0 if name.startswith("lower") else 1.0)
                if "Limit" not in name or "Friction" in name or "Margin" in name:
                    none = 0.0
                values = np.append(values, [none] * (has - len(values)))
            if "Limit" in name and "Friction" not in name:  # the largest number is none
                values = np.where(np.abs(values) >= UNBOUNDED, np.copysign(np.inf, values), values)
            getattr(new, name)[here : here + has] = values


def _check_numbers(model: pin.Model, where: str) -> None:
    for lower, upper in LOWER.items():  # addJoint of Pinocchio 4.1 stores the upper in both
        low, high = getattr(model, lower), getattr(model, upper)
        setattr(model, lower, np.where(low > 0.0, -high, low))
    for i in range(1, model.njoints):
        v = slice(model.idx_vs[i], model.idx_vs[i] + model.nvs[i])
        q = slice(model.idx_qs[i], model.idx_qs[i] + model.nqs[i])
        here = f"{where}: joint {model.names[i]!r}"
        for name in NEVER_NEGATIVE:
            values = finite_array(getattr(model, name)[v], (model.nvs[i],), f"{here}: {name}")
            if np.any(values < 0.0):
                raise SpatialPinError(f"{here}: {name} is {values.tolist()}; it must be finite and "
                                      "not negative")
        for kind, own in (("Position", q), ("Velocity", v), ("Effort", v)):
            low, high = (getattr(model, f"{side}{kind}Limit")[own] for side in ("lower", "upper"))
            if not np.all(low <= high):  # nor NaN
                raise SpatialPinError(f"{here}: its lower {kind.lower()} limit {low.tolist()} is "
                                      f"not below the upper one, {high.tolist()}")
        check_placement(model.jointPlacements[i], f"{here}: its placement")
