"""Quantities of a motion by name: of coordinates, frames, centres of mass, the whole mechanism.

`named_output` reads a name; `KINDS` has a rule for each kind of output. A rule works its values out
of samples: of a Motion, of closed samples at other dimensions, or of samples whose imaginary parts
are derivatives (`dimensions.changed_state`). A new kind of output is an entry of `KINDS`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np

from spatial_pin._support.checks import names_of
from spatial_pin._support.columns import XYZ, Quantity
from spatial_pin.assembly.curve_contacts import contact_closure, contact_coordinates
from spatial_pin.assembly.link_angle import ANGLE, link_angle
from spatial_pin.assembly.state import angles_of, center_of_mass, mass_shares
from spatial_pin.constraints.trees import tree_of
from spatial_pin.errors import SpatialPinError, UnknownNameError
from spatial_pin.mechanism.curves import curves_in
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.motion import FRAME_UNITS, FrameMotion, Motion, Output
from spatial_pin.numerics.linalg import Array
from spatial_pin.rates.jerks import solve_jerks
from spatial_pin.rates.pressure_angle import UNITS as CONTACT_UNITS, contact_quantity
from spatial_pin.rates.transmission import MovedOutput

RATES = ("rate", "velocity")  # two words for the first derivative of a coordinate
MASS, WHOLE = "mass", "com"  # of all moving links: their mass; WHOLE.position, ... of its centre
EFFORT, ROTATION = "effort", "rotation"
FORCES = (EFFORT, "power", "reaction", "reaction.force", "reaction.moment")  # NAME.effort, ...
ENDINGS = tuple(f".{kind}" for kind in FORCES)
ON_GROUND = ("on_ground", "on_ground.force", "on_ground.moment")
VECTORS = (*FRAME_UNITS, "force", "moment")  # NAME.position.z, ... is a component


class OutputKind(NamedTuple):
    """A kind of output.

    Attributes:
        values: returns it (N, ...) of samples.
        unit: returns its unit in samples.
        order: of its highest time derivative.
        size: how many numbers it has.
        needs: "" of configurations and rates, "masses", "forces" of loads, or "motion" of what a
            Motion alone has; what needs no "motion" has derivatives.
        label: returns its name in tables; by default the name with spaces.
    """

    values: Callable[[Any, NamedOutput], Array]
    unit: Callable[[Any, NamedOutput], str]
    order: int = 0
    size: int = 1
    needs: str = ""
    label: Callable[[Any, NamedOutput], str] | None = None


class NamedOutput(NamedTuple):
    """An output, as its name says.

    Attributes:
        spec: the name.
        family: what it is of, a key of `KINDS`; or "force".
        kind: which quantity.
        of: name of the coordinate, frame, closure or pair; `LINK.com` of a centre of mass.
        component: number of a component of a vector, or None.
    """

    spec: str
    family: str
    kind: str
    of: str
    component: int | None = None

    @property
    def rule(self) -> OutputKind:
        """Its rule; that of a force is in `dynamics.force_outputs`."""
        return KINDS[self.family][self.kind]

    def values(self, samples: Any, rule: OutputKind | None = None) -> Array:
        """Return its values (N, ...) in samples."""
        values = (rule or self.rule).values(samples, self)
        return values if self.component is None else values[:, self.component]

    def of_samples(self, samples: Any, rule: OutputKind | None = None) -> Output:
        """Return its values in samples, with label and unit."""
        rule = rule or self.rule
        label = rule.label(samples, self) if rule.label else label_of(self.spec)
        return Output(self.values(samples, rule), label, rule.unit(samples, self))


def named_output(mechanism: Mechanism, spec: str) -> NamedOutput | None:
    """Read the name of an output; None if it is none of the mechanism.

    Whether its frame, link or pair exists is not looked up.

    Raises:
        SpatialPinError: it is an angle of a link that turns about no axis of its own.
    """
    if _is_coordinate(mechanism, spec):
        return NamedOutput(spec, "coordinate", "value", spec)
    if is_force(spec):
        return _named_force(spec)
    whole, k = component(spec)
    name, _, kind = whole.rpartition(".")
    if is_of_whole(mechanism, spec):
        return NamedOutput(spec, "whole", kind or MASS, WHOLE, k)
    if k is None:
        contact = spec if spec.endswith((".s", ".s2")) else name
        if contact_closure(mechanism, contact) is not None:
            kind = "value" if contact == spec else kind
            if kind in KINDS["contact"]:
                return NamedOutput(spec, "contact", kind, contact)
        if kind in CONTACT_UNITS and contact_closure(mechanism, f"{name}.s") is not None:
            return NamedOutput(spec, "curve", kind, name)
        if link_angle(mechanism, spec) is not None:
            return NamedOutput(spec, ANGLE, ANGLE, spec)
        if kind in KINDS["coordinate"] and _is_coordinate(mechanism, name):
            return NamedOutput(spec, "coordinate", kind, name)
    return NamedOutput(spec, "point", kind, name, k) if name and kind in KINDS["point"] else None


def _named_force(spec: str) -> NamedOutput:
    whole, k = component(spec)
    if whole in ON_GROUND:
        return NamedOutput(spec, "force", whole, "", k)
    if whole.startswith(f"{EFFORT}."):
        return NamedOutput(spec, "force", EFFORT, whole.removeprefix(f"{EFFORT}."), k)
    ending = max((x for x in ENDINGS if whole.endswith(x)), key=len)
    return NamedOutput(spec, "force", ending[1:], whole.removesuffix(ending), k)


def _is_coordinate(mechanism: Mechanism, name: str) -> bool:
    return name in mechanism.coordinate_table or name in mechanism.drivers


def _rate(order: int) -> OutputKind:
    """Return the value, rate or acceleration of a coordinate or of a contact."""
    def unit(samples: Any, x: NamedOutput) -> str:
        own = "m" if x.family == "contact" else samples.mechanism.coordinate(x.of).unit
        return samples.rate_unit(own, order) if order else own

    return OutputKind(lambda samples, x: samples.coordinate(x.of)[order], unit, order)


def _ratio(samples: Any, x: NamedOutput) -> Array:
    """Return the speed ratio (N,), or its inverse."""
    speed, rate = samples.driver_speed, samples.coordinate(x.of).rate
    if len(samples.swept) and np.any(speed == 0.0):
        raise SpatialPinError(f"{x.of}.ratio: the driver stands still in this motion")
    with np.errstate(divide="ignore"):
        ratio: Array = rate / speed if x.kind == "ratio" else speed / rate
    return ratio


def _ratio_unit(samples: Any, x: NamedOutput) -> str:
    units = samples.mechanism.coordinate(x.of).unit, samples.driver_unit
    one, two = units if x.kind == "ratio" else units[::-1]
    return "1" if one == two else f"{one}/{two}"


def _transmission_angles(motion: Motion, x: NamedOutput) -> Array:
    if not len(motion.swept):
        return np.empty(0)
    moved = MovedOutput.of(motion.mechanism, x.of, motion.driver_name)
    return moved.angles(motion.mechanism, motion.q, angles_of(motion))


def _point(samples: Any, x: NamedOutput) -> Array:
    """Return a quantity of a frame, or of a centre of mass."""
    if x.of.endswith(".com") or x.family == "whole":
        moving = samples.com(x.of.removesuffix(".com"))
    else:
        moving = samples.frame(x.of)
    values: Array = getattr(moving, x.kind)
    return values.reshape(len(values), -1) if x.kind == ROTATION else values


def _jerk(motion: Motion, x: NamedOutput) -> Array:
    driver = {motion.driver_name: 0.0} if len(motion.swept) else {}
    jerks = (solve_jerks(motion.mechanism, motion.state(k), driver) for k in range(len(motion)))
    if x.family == "coordinate":
        return np.array([j.coordinate(x.of) for j in jerks])
    body = x.of.removesuffix(".com")
    rows = [j.whole_com() if x.family == "whole" else j.frame(x.of).linear if x.of == body
            else j.com(body) for j in jerks]
    return np.array(rows).reshape(-1, 3)


def _angle(samples: Any, x: NamedOutput) -> Array:
    angle = link_angle(samples.mechanism, x.spec)
    assert angle is not None
    return angle.along(samples.frame(samples.mechanism.model.frames[angle.frame].name).rotation,
                       samples.q)


def _of_curve(motion: Motion, x: NamedOutput) -> Array:
    """Return the shape of a cam at its contact."""
    closure = contact_closure(motion.mechanism, f"{x.of}.s")
    assert closure is not None
    return contact_quantity(motion.mechanism, closure, x.kind, motion.q, motion.angles)


def _angle_label(samples: Any, x: NamedOutput) -> str:
    angle = link_angle(samples.mechanism, x.spec)
    assert angle is not None
    return angle.label


def _of_point(kind: str) -> OutputKind:
    """Return a quantity of a frame or of a centre of mass."""
    order, jerks = FRAME_UNITS[kind][1], kind == "jerk"
    return OutputKind(_jerk if jerks else _point, lambda samples, x: samples.frame_unit(x.kind),
                      order, 3, needs="motion" if jerks else "")


POINT = {kind: _of_point(kind) for kind in FRAME_UNITS}
KINDS: dict[str, dict[str, OutputKind]] = {
    "coordinate": {
        "value": _rate(0), "rate": _rate(1), "velocity": _rate(1), "acceleration": _rate(2),
        "jerk": OutputKind(
            _jerk, lambda motion, x: motion.rate_unit(motion.mechanism.coordinate(x.of).unit, 3),
            3, needs="motion"),
        "ratio": OutputKind(_ratio, _ratio_unit, 1, label=lambda samples, x: (
            f"{x.of} / {samples.driver_name} speed ratio")),
        "advantage": OutputKind(_ratio, _ratio_unit, 1, label=lambda samples, x: (
            f"{x.of} mechanical advantage")),
        "transmission_angle": OutputKind(
            _transmission_angles, lambda motion, x: "rad", needs="motion")},
    "contact": {kind: rule._replace(
        needs="motion", label=lambda motion, x: x.spec.replace(".", " "))
        for kind, rule in (("value", _rate(0)), ("rate", _rate(1)), ("acceleration", _rate(2)))},
    "curve": {kind: OutputKind(_of_curve, lambda motion, x: CONTACT_UNITS[x.kind], needs="motion")
              for kind in CONTACT_UNITS},
    ANGLE: {ANGLE: OutputKind(_angle, lambda samples, x: "rad", label=_angle_label)},
    "point": POINT | {ROTATION: OutputKind(_point, lambda samples, x: "1", 0, 9)},
    "whole": {MASS: OutputKind(lambda samples, x: samples.moving_mass, lambda samples, x: "kg",
                               needs="masses")}
             | {kind: rule._replace(needs=rule.needs or "masses") for kind, rule in POINT.items()
                if not kind.startswith("angular")},
}
COORDINATE_OUTPUTS = tuple(kind for kind in KINDS["coordinate"] if kind != "value")
LABELLED = sorted({*COORDINATE_OUTPUTS, *FORCES, *FRAME_UNITS, *CONTACT_UNITS}, key=len,
                  reverse=True)


def frame(samples: Any, name: str) -> FrameMotion:
    """Return the motion of the origin of a link, frame or joint; see `Motion.frame`."""
    mechanism = samples.mechanism
    joint, placement = mechanism.frame_on_joint(mechanism.placed(name))
    return at_point(samples, joint, placement.rotation, placement.translation)


def com(samples: Any, name: str) -> FrameMotion:
    """Return the motion of a link's own centre of mass, or of `WHOLE`; see `Motion.com`."""
    mechanism = samples.mechanism
    if name == WHOLE and name not in mechanism.frame_ids:
        return whole_com(samples, mass_shares(mechanism))
    lever = center_of_mass(mechanism, name)
    joint, placement = mechanism.frame_on_joint(mechanism.placed(name))
    return at_point(samples, joint, placement.rotation, placement.act(lever))


def whole_com(samples: Any, shares: Iterable[tuple[int, Any, Array]]) -> FrameMotion:
    """Return the motion of the centre of mass of all moving links; it turns with nothing.

    Shares are joint, part of the whole mass and centre of each body, as `mass_shares` has them.
    """
    points = [(np.reshape(share, (-1, 1)), at_point(samples, joint, np.eye(3), lever))
              for joint, share, lever in shares]
    position, velocity, acceleration = (
        sum(share * getattr(at, kind) for share, at in points)
        for kind in ("position", "velocity", "acceleration"))
    still, n = np.zeros(np.shape(position)), len(position)
    return FrameMotion(position, np.repeat(np.eye(3)[None], n, axis=0), velocity, acceleration,
                       still, still)


def component(spec: str) -> tuple[str, int | None]:
    """Return the name of a vector, and the index of the component that a name has, or None."""
    whole, _, last = spec.rpartition(".")
    is_one = last in XYZ and whole.rpartition(".")[2] in VECTORS
    return (whole, XYZ.index(last)) if is_one else (spec, None)


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
    x = named_output(mechanism, spec)
    if x is None or x.kind == ROTATION:
        raise UnknownNameError("output", spec, output_names(mechanism),
                               f"mechanism {mechanism.name!r}: ")
    if x.family == "force":
        raise SpatialPinError(
            f"{spec}: a motion by itself has no forces; loads = sp.kinetostatics(mechanism, "
            f"motion) solves them, and loads.output({spec!r}) or sp.plot(loads, ...) gives this")
    return x.of_samples(motion)


def output_names(mechanism: Mechanism) -> list[str]:
    """Return the names of the outputs of a motion, for suggestions."""
    coordinates = [*mechanism.coordinate_table, *mechanism.drivers]
    contacts = [c for c in (mechanism.whole or mechanism).closures if curves_in(c.numbers)]
    return [*coordinates, *(name for name in (
                f"{WHOLE}.{kind}" if kind != MASS else MASS for kind in KINDS["whole"])),
            *(f"{n}.{k}" for n in mechanism.frame_ids for k in (*FRAME_UNITS, ANGLE)),
            *(f"{n}.{k}" for n in coordinates for k in COORDINATE_OUTPUTS),
            *(f"{c.name}.{k}" for c in contacts for k in (*contact_coordinates(c), *CONTACT_UNITS))]


def label_of(spec: str) -> str:
    """Return the name that tables have of an output: `tip velocity` of `tip.velocity`."""
    whole, k = component(spec)
    if k is not None:
        return f"{label_of(whole)} {XYZ[k]}"
    if spec in ON_GROUND:
        return spec.replace("_", " ").replace(".", " ")
    for kind in LABELLED:
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
    return spec in ON_GROUND or spec.endswith(ENDINGS) or spec.startswith(f"{EFFORT}.")


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


def bodies(motion: Motion) -> tuple[Array, Array, Array]:
    """Return joint placements (N, n, 4, 3), local twists and spatial accelerations (N, n, 6)."""
    tree = tree_of(motion.mechanism.model)
    views = tree.placements, tree.twists, tree.accelerations
    placements, twists, accelerations = (np.empty((len(motion), *view.shape)) for view in views)
    for k in range(len(motion)):
        tree.move(motion.q[k], motion.v[k], motion.a[k])
        placements[k], twists[k], accelerations[k] = views
    return placements, twists, accelerations


def at_point(samples: Any, joint: int, rotation: Array, p: Array) -> FrameMotion:
    """Return the motion of axes `rotation` at a point p, (3,) or (N, 3), of a joint's frame."""
    placements, twists, accelerations = samples._bodies
    r = placements[:, joint, :3].transpose(0, 2, 1)
    v, w = twists[:, joint, :3], twists[:, joint, 3:]
    a, e = accelerations[:, joint, :3], accelerations[:, joint, 3:]
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
    return FrameMotion(x, r @ rotation, dx, ddx, omega, epsilon)
