"""Quantities of a motion by name: of coordinates, frames, centres of mass, the whole mechanism."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
import pinocchio as pin

from spatial_pin._support.checks import names_of
from spatial_pin._support.columns import XYZ, Quantity
from spatial_pin.assembly.curve_contacts import contact_closure, contact_coordinates
from spatial_pin.assembly.link_angle import ANGLE, link_angle
from spatial_pin.assembly.state import angles_of, center_of_mass, mass_shares
from spatial_pin.constraints.trees import tree_of
from spatial_pin.errors import SpatialPinError, UnknownNameError
from spatial_pin.mechanism.curves import curves_in
from spatial_pin.mechanism.inertia import moving_mass
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.motion import FRAME_UNITS, FrameMotion, Motion, Output
from spatial_pin.numerics.linalg import Array
from spatial_pin.rates.jerks import Jerks, solve_jerks
from spatial_pin.rates.pressure_angle import UNITS as CONTACT_UNITS, contact_quantity
from spatial_pin.rates.transmission import MovedOutput

RATES = ("rate", "velocity")  # two words for the first derivative of a coordinate
CONTACT_RATES = ("value", "rate", "acceleration")
COORDINATE_OUTPUTS = (*RATES, "acceleration", "jerk", "ratio", "advantage", "transmission_angle")
FORCES = ("effort", "power", "reaction", "reaction.force", "reaction.moment")  # NAME.effort, ...
ENDINGS = tuple(f".{kind}" for kind in FORCES)
ON_GROUND = ("on_ground", "on_ground.force", "on_ground.moment")
MASS, WHOLE = "mass", "com"  # of all moving links: their mass; WHOLE.position, ... of its centre
VECTORS = (*FRAME_UNITS, "force", "moment")  # NAME.position.z, ... is a component
KINDS = sorted({*COORDINATE_OUTPUTS, *FORCES, *FRAME_UNITS, *CONTACT_UNITS}, key=len, reverse=True)


def frame(motion: Motion, name: str) -> FrameMotion:
    """Return the motion of the origin of a link, frame or joint; see `Motion.frame`."""
    mechanism = motion.mechanism
    return _at(motion, *mechanism.frame_on_joint(mechanism.placed(name)))


def com(motion: Motion, name: str) -> FrameMotion:
    """Return the motion of a link's own centre of mass; see `Motion.com`."""
    mechanism = motion.mechanism
    offset = pin.SE3(np.eye(3), center_of_mass(mechanism, name))
    joint, placement = mechanism.frame_on_joint(mechanism.placed(name))
    return _at(motion, joint, placement * offset)


def whole_com(motion: Motion) -> FrameMotion:
    """Return the motion of the centre of mass of all moving links; it turns with nothing.

    Raises:
        SpatialPinError: they have no mass.
    """
    sums = [np.zeros((len(motion), 3)) for _ in range(3)]
    for joint, share, lever in mass_shares(motion.mechanism):
        at = _at(motion, joint, pin.SE3(np.eye(3), lever))
        for x, part in zip(sums, (at.position, at.velocity, at.acceleration), strict=True):
            x += share * part
    position, velocity, acceleration = sums
    still = np.zeros_like(position)
    return FrameMotion(position, np.repeat(np.eye(3)[None], len(motion), axis=0), velocity,
                       acceleration, still, still)


def component(spec: str) -> tuple[str, int | None]:
    """Return the name of a vector, and the index of the component that a name has, or None."""
    whole, _, last = spec.rpartition(".")
    is_one = last in XYZ and whole.rpartition(".")[2] in VECTORS
    return (whole, XYZ.index(last)) if is_one else (spec, None)


def component_of(vector: Output, k: int) -> Output:
    """Return a component of a vector (N, 3) as an output."""
    return Output(vector.values[:, k], f"{vector.label} {XYZ[k]}", vector.unit)


def is_of_whole(mechanism: Mechanism, spec: str) -> bool:
    """Whether an output is of all moving links together: their mass or its centre."""
    if spec in mechanism.coordinate_table or spec in mechanism.drivers:
        return False
    name, _, kind = component(spec)[0].rpartition(".")
    return spec == MASS or (name == WHOLE and WHOLE not in mechanism.frame_ids
                            and kind in FRAME_UNITS and not kind.startswith("angular"))


def output(motion: Motion, spec: str) -> Output:
    """Return a quantity by its name; see `Motion.output`."""
    mechanism = motion.mechanism
    if spec in mechanism.coordinate_table or spec in mechanism.drivers:
        return Output(motion.coordinate(spec).value, spec, mechanism.coordinate(spec).unit)
    whole, k = component(spec)
    if k is not None and not is_force(spec):
        return component_of(_vector(motion, whole) or motion.output(whole), k)
    if is_of_whole(mechanism, spec):
        return _of_whole(motion, spec)
    contact, _, kind = ((spec, "", "value") if spec.endswith((".s", ".s2"))
                        else spec.rpartition("."))
    if contact_closure(mechanism, contact) is not None and kind in CONTACT_RATES:
        order = CONTACT_RATES.index(kind)
        unit = motion.rate_unit("m", order) if order else "m"
        return Output(motion.coordinate(contact)[order], spec.replace(".", " "), unit)
    touched = contact_closure(mechanism, f"{contact}.s") if kind in CONTACT_UNITS else None
    if touched is not None:
        values = contact_quantity(mechanism, touched, kind, motion.q, motion.angles)
        return Output(values, f"{contact} {kind.replace('_', ' ')}", CONTACT_UNITS[kind])
    angle = link_angle(mechanism, spec)
    if angle is not None:
        rotations = motion.frame(mechanism.model.frames[angle.frame].name).rotation
        return Output(angle.along(rotations, motion.q), angle.label, "rad")
    name, _, kind = spec.rpartition(".")
    if kind in COORDINATE_OUTPUTS and (name in mechanism.coordinate_table
                                       or name in mechanism.drivers):
        return _coordinate_output(motion, name, kind)
    vector = _vector(motion, spec)
    if vector is not None:
        return vector
    if is_force(spec):
        raise SpatialPinError(
            f"{spec}: a motion by itself has no forces; loads = sp.kinetostatics(mechanism, "
            f"motion) solves them, and loads.output({spec!r}) or sp.plot(loads, ...) gives this")
    valid = [*mechanism.coordinate_table, *mechanism.drivers,
             MASS, *(f"{WHOLE}.{k}" for k in FRAME_UNITS if not k.startswith("angular")),
             *(f"{n}.{k}" for n in mechanism.frame_ids for k in (*FRAME_UNITS, ANGLE)),
             *(f"{n}.{k}" for n in (*mechanism.coordinate_table, *mechanism.drivers)
               for k in COORDINATE_OUTPUTS),
             *(f"{c.name}.{k}" for c in (mechanism.whole or mechanism).closures
               if curves_in(c.numbers) for k in (*contact_coordinates(c), *CONTACT_UNITS))]
    raise UnknownNameError("output", spec, valid, f"mechanism {mechanism.name!r}: ")


def _vector(motion: Motion, spec: str) -> Output | None:
    """Return a quantity of a point as a vector (N, 3), None for other names."""
    name, _, kind = spec.rpartition(".")
    if kind not in FRAME_UNITS or not name or is_of_whole(motion.mechanism, spec):
        return None
    body, label, unit = name.removesuffix(".com"), label_of(spec), motion.frame_unit(kind)
    if kind == "jerk":
        rows = [j.com(body) if name.endswith(".com") else j.frame(name).linear
                for j in _jerks(motion)]
        return Output(np.array(rows).reshape(-1, 3), label, unit)
    moving = motion.com(body) if name.endswith(".com") else motion.frame(name)
    return Output(getattr(moving, kind), label, unit)


def label_of(spec: str) -> str:
    """Return the name that tables have of an output: `tip velocity` of `tip.velocity`."""
    whole, k = component(spec)
    if k is not None:
        return f"{label_of(whole)} {XYZ[k]}"
    if spec in ON_GROUND:
        return spec.replace("_", " ").replace(".", " ")
    for kind in KINDS:
        if spec.endswith(f".{kind}"):
            return f"{spec.removesuffix(kind)[:-1]} {kind.replace('_', ' ').replace('.', ' ')}"
    return spec


def quantities(
    motion: Motion, outputs: str | Iterable[str] | None = None
) -> dict[str, Quantity]:
    """Return time, driver, and outputs or all coordinates; see `Motion.quantities`."""
    if outputs is not None:
        outputs_of = (motion.output(name) for name in names_of(outputs, "outputs"))
        return {**abscissas(motion), **named(outputs_of)}
    table = abscissas(motion)
    for name in motion.mechanism.coordinates:
        unit = motion.mechanism.coordinate(name).unit
        value, rate, acceleration = motion.coordinate(name)
        table[name] = Quantity(value, unit)
        table[f"{name} rate"] = Quantity(rate, motion.rate_unit(unit))
        table[f"{name} acceleration"] = Quantity(acceleration, motion.rate_unit(unit, 2))
    return table | {"closure error": Quantity(motion.closure_error, "-")}


def is_force(spec: object) -> bool:
    """Whether a name is that of a force, which a motion alone does not have."""
    if not isinstance(spec, str):
        return False
    spec = component(spec)[0]
    return spec in ON_GROUND or spec.endswith(ENDINGS)


def abscissas(motion: Motion) -> dict[str, Quantity]:
    """Return the abscissas of samples: time, and the driver where one was swept."""
    columns = {} if motion.time is None else {"time": Quantity(motion.time, "s")}
    if motion.driver is not None:
        columns[motion.driver_name] = Quantity(motion.driver, motion.driver_unit)
    return columns


def named(outputs: Iterable[Output]) -> dict[str, Quantity]:
    """Return outputs by their labels, reactions as force and moment."""
    return {part.label: Quantity(part.values, "-" if part.unit == "1" else part.unit)
            for output in outputs for part in output.parts()}


def _of_whole(motion: Motion, spec: str) -> Output:
    """Return the mass of all moving links, or the motion of its centre."""
    kind = spec.rpartition(".")[2]
    if spec == MASS:
        return Output(np.full(len(motion), moving_mass(motion.mechanism.model)), MASS, "kg")
    if kind == "jerk":
        values = np.array([j.whole_com() for j in _jerks(motion)]).reshape(-1, 3)
    else:
        values = getattr(whole_com(motion), kind)
    return Output(values, f"{WHOLE} {kind}", motion.frame_unit(kind))


def _jerks(motion: Motion) -> Iterator[Jerks]:
    driver = {motion.driver_name: 0.0} if len(motion.swept) else {}
    return (solve_jerks(motion.mechanism, motion.state(k), driver)
            for k in range(len(motion)))


def _coordinate_output(motion: Motion, name: str, kind: str) -> Output:
    _, rate, acceleration = motion.coordinate(name)
    unit = motion.mechanism.coordinate(name).unit
    if kind in RATES:
        return Output(rate, f"{name} {kind}", motion.rate_unit(unit))
    if kind == "acceleration":
        return Output(acceleration, f"{name} acceleration", motion.rate_unit(unit, 2))
    if kind == "jerk":
        jerks = np.array([j.coordinate(name) for j in _jerks(motion)])
        return Output(jerks, f"{name} jerk", motion.rate_unit(unit, 3))
    if kind == "transmission_angle":
        if not len(motion.swept):
            return Output(np.empty(0), f"{name} transmission angle", "rad")
        moved = MovedOutput.of(motion.mechanism, name, motion.driver_name)
        angles = moved.angles(motion.mechanism, motion.q, angles_of(motion))
        return Output(angles, f"{name} transmission angle", "rad")
    if len(motion.swept) and np.any(motion.driver_speed == 0.0):
        raise SpatialPinError(f"{name}.ratio: the driver stands still in this motion")
    by = motion.driver_unit
    if kind == "advantage":
        with np.errstate(divide="ignore"):
            values = motion.driver_speed / rate
        return Output(values, f"{name} mechanical advantage", "1" if unit == by else f"{by}/{unit}")
    return Output(rate / motion.driver_speed, f"{name} / {motion.driver_name} speed ratio",
                  "1" if unit == by else f"{unit}/{by}")


def bodies(motion: Motion) -> tuple[Array, Array, Array]:
    """Return joint placements (N, n, 4, 3), local twists and spatial accelerations (N, n, 6)."""
    tree = tree_of(motion.mechanism.model)
    views = tree.placements, tree.twists, tree.accelerations
    placements, twists, accelerations = (np.empty((len(motion), *view.shape)) for view in views)
    for k in range(len(motion)):
        tree.move(motion.q[k], motion.v[k], motion.a[k])
        placements[k], twists[k], accelerations[k] = views
    return placements, twists, accelerations


def _at(motion: Motion, joint: int, offset: pin.SE3) -> FrameMotion:
    """Motion of the frame at `offset` from a joint frame."""
    placements, twists, accelerations = motion._bodies
    r = placements[:, joint, :3].transpose(0, 2, 1)
    v, w = twists[:, joint, :3], twists[:, joint, 3:]
    a, e = accelerations[:, joint, :3], accelerations[:, joint, 3:]
    p = offset.translation
    turning = np.cross(w, p)
    local = np.stack([
        np.broadcast_to(p, v.shape),
        v + turning,
        a + np.cross(w, v) + np.cross(e, p) + np.cross(w, turning),
        w,
        e,
    ], axis=-1)
    x, dx, ddx, omega, epsilon = np.ascontiguousarray(np.moveaxis(r @ local, -1, 0))
    x += placements[:, joint, 3]
    return FrameMotion(x, r @ offset.rotation, dx, ddx, omega, epsilon)
