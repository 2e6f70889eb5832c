"""Applied forces: springs and dampers, efforts at joints, external wrenches.

A spring between two frames acts along the line between their origins with the wrench of a distance
row, one about a joint on its coordinate. Bushings, and springs on a component of a ball or floating
joint, are in `bushings`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin._support.checks import as_array, finite_number, is_finite, mapping
from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.constraints.pinocchio_views import joint_jacobian
from spatial_pin.dynamics.bushings import Bushing, Law
from spatial_pin.errors import SpatialPinError, UnknownNameError, warn
from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.mechanism_checks import has_inertia
from spatial_pin.mechanism.parts import Spring
from spatial_pin.mechanism.resistance import Resistance, SlipSpeed
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES


class LineSpring(NamedTuple):
    """A spring between points of two bodies, in the frames of their joints."""

    mechanism: Mechanism
    name: str
    bodies: tuple[int, int]
    points: tuple[Array, Array]
    sign: Array
    law: Law
    energy: Callable[[float], float] | None
    is_linear: bool

    def between(self, placements: Array) -> tuple[float, Array, Array]:
        """Return its length, the unit vector along it, and its second end.

        Length and vector are zero if its ends coincide within round-off.
        """
        first, second = (x @ placements[i] for i, x in zip(self.bodies, self.points, strict=True))
        d = second - first
        length = float(np.sqrt(d @ d))
        size = self.mechanism.characteristic_length + float(np.abs(second).max())
        if length <= TOLERANCES.last_digit * size:
            return 0.0, np.zeros(3), second
        return length, d / length, second

    def row(self, evaluation: LoopEquations) -> tuple[Array, float, Array]:
        """Return d(length)/dv (nv,), the length, and the unit wrench of lengthening (6,)."""
        length, along, end = self.between(evaluation.placements)
        (x, y, z), (a, b, c) = end.tolist(), along.tolist()  # np.cross takes ten times as long
        wrench = np.array([a, b, c, y * c - z * b, z * a - x * c, x * b - y * a])
        jacobian = joint_jacobian(evaluation.data, evaluation.model.nv)
        return (wrench @ jacobian) * self.sign, length, wrench

    def pull(self, evaluation: LoopEquations, v: Array) -> tuple[float, Array]:
        """Return its force, and the unit wrench of lengthening (6,).

        Where its ends coincide, they part in the direction of their motion.
        """
        row, length, wrench = self.row(evaluation)
        if length:
            return self.law(length, float(row @ v)), wrench
        x, y, z = (self.points[1] @ evaluation.placements[self.bodies[1]]).tolist()
        along = np.array([[1.0, 0.0, 0.0, 0.0, z, -y], [0.0, 1.0, 0.0, -z, 0.0, x],
                          [0.0, 0.0, 1.0, y, -x, 0.0]])  # unit forces at the point
        parting = (along @ joint_jacobian(evaluation.data, evaluation.model.nv)) * self.sign
        if not self.can_part(parting):
            return 0.0, wrench
        if force := self.law(0.0, 0.0):
            raise self.without_direction(f"force of {force:.6g} N")
        motion = parting @ v
        pace = float(np.sqrt(motion @ motion))
        return (self.law(0.0, pace), motion @ along / pace) if pace else (0.0, wrench)

    def can_part(self, parting: Array) -> bool:
        """Whether velocities move its ends apart, by the derivatives (3, nv) of their offset."""
        size = self.mechanism.characteristic_length * TOLERANCES.tight
        return bool(np.abs(parting).max(initial=0.0) > size)

    def without_direction(self, what: str) -> SpatialPinError:
        """Return the error of a spring whose force or damping has no direction."""
        return SpatialPinError(
            f"mechanism {self.mechanism.name!r}: the two frames of spring {self.name!r} coincide, "
            f"where its {what} has no direction: start where its frames are apart, or give it a "
            "joint instead of frames")


class JointSpring(NamedTuple):
    """A spring about, or along, a joint coordinate."""

    name: str
    q: int
    v: int
    law: Law
    energy: Callable[[float], float] | None
    is_linear: bool


def _finite_law(name: str, law: Any) -> Law:
    """Return a law of a spring that refuses what is no finite force."""
    if not callable(law):
        raise TypeError(f"laws: the law of spring {name!r} is {law!r}; it must be a function of "
                        "(length, rate) that returns a force")

    def finite(x: float, rate: float) -> float:
        force: Any = law(x, rate)
        if type(force) is float and math.isfinite(force):
            return force
        return finite_number(force, f"force of spring {name!r} by its law at ({x:.6g}, {rate:.6g})")

    return finite


class Forces:
    """The springs of a mechanism, and damping and friction of its joints.

    Args:
        mechanism: the mechanism.
        laws: by spring name, force as a function of (length, rate) [m, m/s] or (coordinate, rate),
            positive pulling together (or back), instead of stiffness and damping.
        slip_speed: of dry friction, see `Resistance`; default the file's.

    Attributes:
        resistance: damping and dry friction of the joints.
        exist: whether there is any spring, or any resistance.
        numbers: stiffness, damping and free length of each spring, by name.
    """

    def __init__(
        self, mechanism: Mechanism, laws: Mapping[str, Law] | None = None,
        slip_speed: SlipSpeed | None = None,
    ) -> None:
        laws = dict(laws or {})
        names = [spring.name for spring in mechanism.springs]
        for name in laws:
            if name not in names:
                raise UnknownNameError("spring", name, names, f"mechanism {mechanism.name!r}: ")
            laws[name] = _finite_law(name, laws[name])
        self.mechanism = mechanism
        self.resistance = Resistance(mechanism, slip_speed)
        self.lines: list[LineSpring] = []
        self.turns: list[JointSpring] = []
        self.bushings: list[Bushing] = []
        for spring in mechanism.springs:
            self._add(spring, laws.get(spring.name))
        self.exist = bool(mechanism.springs or self.resistance)
        self.numbers = {s.name: (s.stiffness, s.damping, s.free) for s in mechanism.springs}

    def _add(self, spring: Spring, law: Law | None) -> None:
        m = self.mechanism
        if spring.is_bushing and law:
            raise SpatialPinError(f"mechanism {m.name!r}: spring {spring.name!r} is a bushing, "
                                  "whose force is no function of one length: it takes no law")
        coordinate = m.prescribed_coordinate(spring.joint) if spring.joint else None
        if spring.is_bushing or (coordinate and coordinate.q < 0):
            self.bushings.append(Bushing.of(m, spring, law))
            return
        is_linear = spring.is_linear and not law
        energy = None if law else spring.energy
        law = law or spring.force
        if coordinate:
            self.turns.append(JointSpring(
                spring.name, coordinate.q, coordinate.v, law, energy, is_linear))
            return
        (i1, m1), (i2, m2) = (m.centred_frame(f) for f in spring.frames)
        supports = constraints_of(m).supports
        sign = supports[i2] - supports[i1]
        points = tuple(np.append(x.translation, 1.0) for x in (m1, m2))
        self.lines.append(LineSpring(m, spring.name, (i1, i2), points, sign, law, energy,  # type: ignore[arg-type]
                                     is_linear))

    @property
    def on_frames(self) -> bool:
        """Whether a spring acts between frames, or is a bushing."""
        return bool(self.lines or self.bushings)

    @property
    def laws_on_frames(self) -> bool:
        """Whether one of these has a law."""
        return not (all(x.is_linear for x in self.lines)
                    and all(x.is_linear for x in self.bushings))

    def packed(
        self, carriers: NDArray[np.intp], frames: Array
    ) -> tuple[list[NDArray[np.int64]], list[Array]]:
        """Return springs between frames, and bushings, for the kernel.

        Args:
            carriers: the kernel's joint that carries the body of each joint.
            frames: (n, 3, 3) axes of the kernel's joints.

        Returns:
            Bodies of springs between frames (n, 2), whether each has a law (n,), and these of
            bushings, whose laws count components from 1; points (n, 2, 3), stiffness, damping and
            free length (n, 3), and numbers of bushings (m, 103), see bushings.c.
        """
        lines, bushings = self.lines, self.bushings
        ends = [(carriers[j], x[:3]) for line in lines
                for j, x in zip(line.bodies, line.points, strict=True)]
        ints: list[Any] = [
            [j for j, _ in ends], [not x.is_linear for x in lines],
            [carriers[j] for x in bushings for j in x.bodies],
            [0 if x.component is None or x.is_linear else 1 + x.component for x in bushings]]
        parts = [part for x in bushings for part in (
            *(frames[carriers[j]].T @ y for j, m in zip(x.bodies, x.placements, strict=True)
              for y in (*m.rotation.T, m.translation)),
            x.stiffness.ravel(), x.damping.ravel(), x.preload, [x.stored])]
        reals: list[Any] = [
            [frames[j].T @ x for j, x in ends], [self.numbers[x.name] for x in lines],
            np.concatenate(parts) if parts else []]
        return [np.array(x, np.int64) for x in ints], [np.array(x, float) for x in reals]

    def generalised(self, evaluation: LoopEquations, q: Array, v: Array) -> Array:
        """Return the generalised forces (nv,) of all, after `evaluation.update(q)`."""
        return self.turning(q, v) + generalised(evaluation, self.wrenches(evaluation, v))

    def turning(self, q: Array, v: Array) -> Array:
        """Return the generalised forces (nv,) of joint springs, damping and friction."""
        total = self.resistance.forces(v) if self.resistance else np.zeros(len(v))
        for turn in self.turns:
            total[turn.v] -= turn.law(float(q[turn.q]), float(v[turn.v]))
        return total

    def wrenches(self, evaluation: LoopEquations, v: Array) -> list[tuple[int, Array]]:
        """Return (joint, wrench (6,) on its body about the world origin) of springs on frames."""
        on_bodies = []
        for bushing in self.bushings:
            twists = np.array([evaluation.body_jacobian(i) @ v for i in bushing.bodies])
            wrench = bushing.wrench(evaluation.placements, twists)
            on_bodies += [(bushing.bodies[0], -wrench), (bushing.bodies[1], wrench)]
        for line in self.lines:
            force, wrench = line.pull(evaluation, v)
            on_bodies += [(line.bodies[0], force * wrench), (line.bodies[1], -force * wrench)]
        return on_bodies

    def energy(self, evaluation: LoopEquations, q: Array) -> float:
        """Return the energy stored in springs [J]; springs with a law store none."""
        total = sum(bushing.energy(evaluation.placements) for bushing in self.bushings)
        for line in self.lines:
            if line.energy:
                total += line.energy(line.between(evaluation.placements)[0])
        for turn in self.turns:
            if turn.energy:
                total += turn.energy(float(q[turn.q]))
        return total


def warn_of_no_inertia(
    mechanism: Mechanism, efforts: object = None, external: object = None
) -> None:
    """Warn where forces work on a mechanism none of whose links has any inertia.

    Not with external forces: then the efforts that they need are of interest.
    """
    if external or has_inertia(mechanism) or not mechanism.model.nv:
        return
    acting = [word for word, acts in (
        ("gravity", np.any(mechanism.model.gravity.vector)), ("springs", mechanism.springs),
        ("efforts", efforts)) if acts]
    if acting:
        warn(
            f"mechanism {mechanism.name!r}: no link has a mass or a moment of inertia, so that "
            f"weights are missing from all forces and nothing is moved by {' and '.join(acting)}; "
            "give the links an <inertial> in the URDF")


def joint_efforts(mechanism: Mechanism, efforts: Mapping[str, float] | None) -> Array:
    """Return efforts by driver, joint or coordinate as generalised forces (nv,) [N·m, N].

    Raises:
        UnknownNameError: a name does not exist.
        ValueError: a value is NaN or infinite, or one coordinate has two.
    """
    total = np.zeros(mechanism.model.nv)
    given: set[int] = set()
    for name, value in mapping(efforts, "efforts").items():
        coordinate = mechanism.driven_coordinate(name)
        if coordinate.v in given:
            raise ValueError(f"effort of {coordinate.name!r} is given twice")
        given.add(coordinate.v)
        total[coordinate.v] = finite_number(value, f"effort at {name!r}")
    return total


def forces_on_frames(
    mechanism: Mechanism, external: Any, n: int, what: str
) -> tuple[dict[str, Any], dict[str, Array]]:
    """Return forces at frames that are constant, and rows (n, 6) of force and moment, by frame.

    Raises:
        UnknownNameError: there is no such frame.
        ValueError: rows are not as many as there are samples or times, `what` they are of, or not
            finite.
    """
    fixed, tables = dict[str, Any](), dict[str, Array]()
    for name, force in mapping(external, "external").items():
        mechanism.frame_id(name)
        if not isinstance(force, np.ndarray | list | tuple):
            fixed[name] = force
            continue
        rows = tables[name] = as_array(force, f"external force at {name!r}")
        if rows.shape != (n, 6):
            raise ValueError(
                f"external force at {name!r} has shape {rows.shape}; give a pin.Force, or a row of "
                f"force and moment for each of the {n} {what}: ({n}, 6)")
        if not is_finite(rows):
            raise ValueError(f"external force at {name!r} is NaN or infinite")
    return fixed, tables


def external_wrenches(
    mechanism: Mechanism, evaluation: LoopEquations, external: Any
) -> list[tuple[int, Array]]:
    """Return (joint, wrench (6,) about the world origin) of forces given at frames, world axes.

    Raises:
        TypeError: they are a function, as only a Motion takes.
        UnknownNameError: there is no such frame.
        SpatialPinError: it is no `pin.Force`.
        ValueError: it is not finite.
    """
    if callable(external):
        raise TypeError("external is a function, which needs a Motion; for a State give a mapping "
                        "from frames to forces")
    wrenches = []
    for name, force in (external or {}).items():
        joint, placement = mechanism.centred_frame(name)
        if not isinstance(force, pin.Force):
            raise SpatialPinError(f"external force at {name!r} is no pin.Force but "
                                  f"{type(force).__name__}")
        if not np.all(np.isfinite(force.vector)):
            raise ValueError(f"external force at {name!r} is NaN or infinite")
        point = np.append(placement.translation, 1.0) @ evaluation.placements[joint]
        (x, y, z), (fx, fy, fz) = point.tolist(), force.linear.tolist()  # np.cross takes 40 us
        moment = force.angular + np.array([y * fz - z * fy, z * fx - x * fz, x * fy - y * fx])
        wrenches.append((joint, np.concatenate([force.linear, moment])))
    return wrenches


def generalised(evaluation: LoopEquations, wrenches: list[tuple[int, Array]]) -> Array:
    """Return the generalised forces (nv,) of wrenches on bodies, after `evaluation.update`."""
    total = np.zeros(evaluation.model.nv)
    jacobian = joint_jacobian(evaluation.data, evaluation.model.nv)
    for joint, wrench in wrenches:
        total += (wrench @ jacobian) * evaluation.constraints.supports[joint]
    return total
