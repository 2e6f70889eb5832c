"""Reports that an engineer can read: of a mechanism, a configuration, a motion."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from spatial_pin._support.brief import counted
from spatial_pin.assembly.assemble import assembled
from spatial_pin.assembly.state import State
from spatial_pin.errors import AssemblyError
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.pairs import COUPLING
from spatial_pin.mechanism.parts import Spring
from spatial_pin.mechanism.resistance import resistance_texts
from spatial_pin.mobility.mobility import Mobility, mobility
from spatial_pin.motion.dead_centres import known_dead_centres
from spatial_pin.motion.motion import Motion
from spatial_pin.motion.summary import error_lines, heading, ranges, unreached_lines
from spatial_pin.numerics.tolerances import TOLERANCES


@dataclass(frozen=True)
class Info:
    """The parts of a mechanism, and its freedoms at the assembled guess.

    Attributes:
        mobility: the freedoms at the assembled guess; None when it does not close.
        frames: frames that the URDF does not have, each with what it is fixed to.
    """

    name: str
    title: str
    source: str
    characteristic_length: float
    links: list[str]
    dimensions: dict[str, float]
    joints: dict[str, str]
    closures: dict[str, str]
    coordinates: dict[str, str]
    drivers: dict[str, str]
    springs: dict[str, str]
    resistances: dict[str, str]
    mobility: Mobility | None
    closure_error: float
    notes: list[str] = field(default_factory=list)
    frames: dict[str, str] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Return everything as plain data."""
        plain = {f.name: getattr(self, f.name) for f in fields(self)}
        m = self.mobility
        plain["mobility"] = m and {
            "kutzbach": m.kutzbach, "grubler": m.grubler, "loops": m.loops, "rank": m.rank,
            "instantaneous": m.instantaneous, "dof": m.dof, "redundant": list(m.redundant),
            "passive": [str(p) for p in m.passive], "overconstrained": m.overconstrained,
        }
        return plain

    def __str__(self) -> str:
        def listing(items: dict[str, str]) -> str:
            width = max(map(len, items), default=0)
            return "\n".join(f"  {name:{width}}  {text}" for name, text in items.items())

        head = [f"{self.name}: {self.title}".rstrip(": ")]
        if self.source:
            head.append(f"source: {self.source}")
        head.append(f"characteristic length: {self.characteristic_length:.6g} m")
        parts = [
            "\n".join(head),
            f"links ({len(self.links)}): {', '.join(self.links)}",
            "dimensions: " * bool(self.dimensions)
            + ", ".join(f"{name} = {x:.6g}" for name, x in self.dimensions.items()),
            f"joints of the tree ({len(self.joints)}):\n{listing(self.joints)}",
            f"closures ({len(self.closures)}):\n{listing(self.closures)}".rstrip(":\n"),
            f"coordinates ({len(self.coordinates)}):\n{listing(self.coordinates)}",
            f"frames ({len(self.frames)}):\n{listing(self.frames)}" * bool(self.frames),
            f"drivers ({len(self.drivers)}):\n{listing(self.drivers)}".rstrip(":\n"),
            f"springs ({len(self.springs)}):\n{listing(self.springs)}" * bool(self.springs),
            f"joints that resist ({len(self.resistances)}):\n{listing(self.resistances)}"
            * bool(self.resistances),
            str(self.mobility or ""),
            "\n".join(self.notes),
        ]
        return "\n".join(part for part in parts if part)


def info(mechanism: Mechanism) -> Info:
    """Return the parts and freedoms of a mechanism; it need not have a closed configuration."""
    try:
        state = assembled(mechanism)
        closed, error = True, state.closure_error
    except AssemblyError as failure:
        assert failure.state is not None
        state, closed, error = failure.state, False, failure.closure_error
    words = "closure error at the guess" if closed else "the guess does not close: closure error"
    notes = [f"{words} {error:.1e}"]
    if mechanism.passives:
        spins = [f"{p.name}: no spin of {p.body!r} about {p.axis[0]} - {p.axis[1]}"
                 for p in mechanism.passives]
        notes.append("passive freedoms resolved: " + "; ".join(spins))
    return Info(
        mechanism.name, mechanism.title, mechanism.source, mechanism.characteristic_length,
        list(mechanism.links), dict(mechanism.dimensions),
        dict(zip(list(mechanism.model.names)[1:], mechanism.pairs, strict=True)),
        {c.name: _closure_text(c) for c in mechanism.closures},
        {c.name: c.unit for c in mechanism.coordinate_table.values()},
        {d.name: f"prescribes {d.joint}" for d in mechanism.drivers.values()},
        {s.name: _spring_text(mechanism, s) for s in mechanism.springs},
        resistance_texts(mechanism),
        mobility(mechanism, state) if closed else None,
        error,
        notes,
        {f.name: f"on {f.link}" for f in mechanism.frames.values()},
    )


def _closure_text(closure: Any) -> str:
    stated = f", from {closure.source}" if closure.source else ""
    if closure.type == COUPLING:
        offset = f" + {closure.offset:g}" if closure.offset else ""
        if "ratio" in closure.numbers:
            a, b = closure.joints
            law = f"{b} = {closure.ratio:g} * {a}{offset}"
        elif closure.ratios:
            parts = (f"{r:g} * {name}" for r, name in zip(closure.ratios, closure.joints,
                                                          strict=True))
            law = f"{' + '.join(parts)}{offset} = 0".replace("+ -", "- ")
        else:
            law = "{1} = f({0}), {2}".format(*closure.joints, closure.numbers["function"])
        acts_at = f", with {type(closure.acts_at).__name__.lower()}" if closure.acts_at else ""
        return f"coupling: {law}{acts_at} (1 equation){stated}"
    length = f", as far as {' - '.join(closure.between)}" if closure.between else ""
    names = " - ".join((*closure.frames, *closure.joints))
    curves, follower = closure.numbers.get("curves"), closure.numbers.get("follower")
    shapes = (curves.one, curves.two) if curves else filter(None, [closure.numbers.get("curve")])
    on = " and ".join(f"{next(iter(x.form))} {x.name}".rstrip() for x in shapes)
    on = f", on {on}" * bool(on) + (f", {next(iter(follower.form))}" if follower else "")
    return (f"{closure.type}: {names}{length}{on} ({counted(closure.n_rows, 'equation')}){stated}")


def _spring_text(mechanism: Mechanism, spring: Spring) -> str:
    turns = spring.joint is not None and mechanism.prescribed_coordinate(spring.joint).unit == "rad"
    per, length = ("N·m/rad", "rad") if turns else ("N/m", "m")
    where = spring.joint or " - ".join(spring.frames)
    if spring.is_bushing:
        return f"{where}: bushing, in all six directions"
    damping = f", {spring.damping:g} {per.replace('/', '·s/')}" if spring.damping else ""
    force = f"law of {len(spring.law)} points" if spring.law else f"{spring.stiffness:g} {per}"
    side = ", pulls only" * spring.tension_only + ", pushes only" * spring.compression_only
    return f"{where}: {force}{damping}{side}, free at {spring.free:g} {length}"


def assembly_summary(state: State) -> str:
    """Return the coordinates of a configuration and how well it is closed."""
    mechanism = state.mechanism
    width = max(map(len, mechanism.coordinates), default=0)
    lines = [f"{mechanism.name}: closed to {state.closure_error:.1e} of "
             f"{mechanism.characteristic_length:.6g} m"]
    for name, c in mechanism.coordinate_table.items():
        value = shown_value(state, name)
        degrees = f" ({np.degrees(value):.9g}°)" if c.unit == "rad" else ""
        lines.append(f"  {name:{width}}  {value:.15g} {c.unit}{degrees}")
    for name, by in state.released.items():
        lines.append(f"  released: driver {name} went {by:+.9g} {mechanism.coordinate(name).unit} "
                     "from where the guess has it, as the loops would not close otherwise")
    for name, by in state.beyond_limits.items():
        side = "upper" if by > 0.0 else "lower"
        lines.append(f"  beyond limits: {name} is {abs(by):.9g} {mechanism.coordinate(name).unit} "
                     f"beyond its {side} joint limit")
    return "\n".join(lines)


def shown_value(state: State, name: str) -> float:
    """Return the value of a coordinate or driver, 0 where it is round-off [rad or m]."""
    mechanism = state.mechanism
    value = float(state.coordinate(name).value)
    size = 1.0 if mechanism.coordinate(name).unit == "rad" else mechanism.characteristic_length
    return 0.0 if abs(value) <= TOLERANCES.round_off * size else value


def motion_summary(motion: Motion) -> str:
    """Return the ranges of a motion's coordinates, its accuracy, its events and dead centres."""
    events = [*known_dead_centres(motion), *motion.events]
    return "\n".join([heading(motion), *error_lines(motion), *ranges(motion),
                      *(f"  {event.text}" for event in events), *unreached_lines(motion)])
