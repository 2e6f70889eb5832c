"""Inverse dynamics: the efforts that a given motion needs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cached_property

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin._support.brief import first_names
from spatial_pin._support.checks import names_of, positive_number
from spatial_pin._support.lazy import made_once
from spatial_pin.assembly.holding import untied, velocity_entries
from spatial_pin.assembly.passive_freedoms import is_in_loop, passive_freedoms
from spatial_pin.assembly.state import State
from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.constraints.pinocchio_views import joint_jacobian
from spatial_pin.dynamics.reactions import UNMOVED
from spatial_pin.dynamics.solvers.equations_of_motion import Equations, no_inertia_error
from spatial_pin.dynamics.solvers.least_constraint import ROUNDING
from spatial_pin.dynamics.state_forces import Dynamics, Load
from spatial_pin.errors import SpatialPinError
from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.mechanism.coordinates import driver_coordinates
from spatial_pin.mechanism.inertia import fall_energy
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Coordinate
from spatial_pin.mobility.idle_freedoms import idle_freedoms
from spatial_pin.motion.summary import EFFORTS
from spatial_pin.numerics.linalg import EPS, Array, common_rows, decompose, independent_rows
from spatial_pin.numerics.tolerances import TOLERANCES

NO_MOTOR = "no motor acts on a component of a ball or of a floating joint"


class Actuation:
    """The coordinates that have efforts.

    Attributes:
        names: as they were given.
        coordinates: these; columns: (k,) their indices in the velocity vector.
        root: (k,) one over the square root of each weight.
        shared: (k,) which of them may share the work of others: where a coordinate outside of loops
            has one actuator, that works alone.
        others: coordinates outside of loops that have none, or more than one.
    """

    def __init__(
        self, mechanism: Mechanism, actuated: Iterable[str] | Mapping[str, float] | None = None
    ) -> None:
        if actuated is None:
            self.names = list(mechanism.drivers)
        else:
            self.names = names_of(actuated, "actuated")
        given = actuated if isinstance(actuated, Mapping) else {}
        weights = np.array([positive_number(given.get(n, 1.0), f"weight of {n!r}")
                            for n in self.names])
        self.coordinates: list[Coordinate] = []
        for name in self.names:
            component = mechanism.coordinate_table.get(name)
            joint = component.joint if component else name
            if joint in untied(mechanism):
                raise SpatialPinError(f"mechanism {mechanism.name!r}: {name!r} cannot be actuated: "
                                      f"{_base_hint(mechanism, joint)}")
            self.coordinates.append(mechanism.driven_coordinate(name))
        self.columns = np.array([c.v for c in self.coordinates], dtype=np.int64)
        self.root = 1.0 / np.sqrt(weights)
        tied = constraints_of(mechanism).tied
        is_alone = (np.bincount(self.columns, minlength=len(tied)) == 1) & ~tied
        self.shared, self.others = ~is_alone[self.columns], np.flatnonzero(~is_alone & ~tied)
        self.has_shared = bool(self.shared.any())

    def generalised(self, efforts: Array, nv: int) -> Array:
        """Return efforts (k,) as joint forces (nv,)."""
        return np.bincount(self.columns, efforts, nv).astype(float)

    def all_generalised(self, efforts: Array, nv: int) -> Array:
        """Return rows of efforts (m, k) as joint forces (m, nv)."""
        return np.array([self.generalised(e, nv) for e in efforts]).reshape(-1, nv)


@made_once
def drivers_of(mechanism: Mechanism) -> Actuation:
    """Return the drivers of a mechanism as its actuators."""
    return Actuation(mechanism)


class Efforts(Dynamics):
    """The efforts of a given motion, with its reactions.

    Attributes:
        efforts: by driver or actuated coordinate [N·m about it, N along it].
        power: of each of them [W].
        error: estimated round-off of the efforts, relative to the largest (forces by the
            characteristic length); 1 where nothing else is left of them.

    Example:
        >>> mech = sp.load("four_bar")
        >>> state = sp.solve_rates(mech, sp.assemble(mech, {"crank": 1.0}), {"crank": 10.0})
        >>> found = sp.inverse_dynamics(mech, state)
        >>> print(f"{found.efforts['crank']:.4f} N·m, {found.power['crank']:.3f} W")
        0.9714 N·m, 9.714 W
        >>> found.unique_efforts, found.unique["output_pin"].shape
        ({'crank': True}, (6,))
    """

    def __init__(
        self, state: State, load: Load, a: Array, closures: Array, actuation: Actuation,
        efforts: Array, error: float,
    ) -> None:
        super().__init__(state, load, a, closures, actuation.generalised(efforts, len(a)), error)
        names, self._actuation = actuation.names, actuation
        self.efforts: dict[str, float] = dict(zip(names, efforts.tolist(), strict=True))
        power = efforts * state.v[actuation.columns]
        self.power: dict[str, float] = dict(zip(names, power.tolist(), strict=True))

    @cached_property
    def _internal_efforts(self) -> Array:
        """(k, n) efforts of the actuators that balance each other, of length 1."""
        with self._equations() as equations:
            return internal_efforts(equations, self._actuation)

    @cached_property
    def unique(self) -> dict[str, NDArray[np.bool_]]:
        """Which components of each pair's reaction are unique, force then moment (6,), world axes.

        Those are not that an overconstrained loop can be under stress with by itself, nor those
        that more actuators than freedoms can press for, one against the other, nor those of pairs
        beside a coupling, as in `Dynamics.unique`.
        """
        actuation = self._actuation
        with self._equations() as equations:
            return equations.unique(actuation.all_generalised(self._internal_efforts, len(self.a)))

    @property
    def unique_efforts(self) -> dict[str, bool]:
        """Whether each effort is unique: it is not where actuators can press against each other."""
        free = np.abs(self._internal_efforts).max(axis=0, initial=0.0) < UNMOVED
        return dict(zip(self._actuation.names, free.tolist(), strict=True))

    def __repr__(self) -> str:
        units = self._at.mechanism.coordinate
        efforts = [f"{name} effort = {x:.6g} {EFFORTS[units(name).unit]}"
                   for name, x in self.efforts.items()]
        return f"Efforts({self._at!r}, {first_names(efforts)})"

    def __str__(self) -> str:
        unique = self.unique_efforts
        lines = [f"{name}: {value:.9g}{'*' * (not unique[name])} (power {self.power[name]:.6g} W)"
                 for name, value in self.efforts.items()]
        return "\n".join([*lines, super().__str__()])


def balance(equations: Equations, actuation: Actuation) -> tuple[Array, Array, Array, float]:
    """Return efforts (k,), accelerations (nv,), joint forces (nv,) of the closures, and the error.

    Along every freedom N of the closed loops, N^T (M a + b - f - E x) = 0. The accelerations are
    those of the equations' state but for passive freedoms.

    Raises:
        SpatialPinError: a freedom is not actuated, or carries load.
        SingularError: the loops have lost rank, or a passive freedom has no inertia.
    """
    a, kkt, state = equations.state.a, equations.core_kkt, equations.state
    solution = kkt.efforts_of(
        state.q, state.v, a, equations.angle_reference, equations.given, actuation.columns)
    if solution is not None:
        equations.ranks.check(kkt.rank)
        if state.mechanism.passives:
            a = kkt.a.copy()
        return solution, a, kkt.closures.copy(), kkt.error_of_tree
    freedoms, rank = _freedoms(equations, actuation)
    equations.ranks.check(rank)
    scale = equations.scale
    if len(freedoms):
        pull = freedoms[:, actuation.columns]
        size = np.where(actuation.shared, np.abs(pull).max(axis=0, initial=0.0), 1.0)
        spare = decompose((pull / np.where(size > 0.0, size, 1.0)).T).null_space @ freedoms
        passives = passive_freedoms(
            equations.evaluation, spare * scale, actuation.coordinates) if len(spare) else []
        single_link: list[tuple[str, Array]] = [(joint, x / scale) for joint, x in passives]
        if len(spare) != sum(len(motions) for _, motions in single_link):
            passive = np.vstack([spare[:0], *(motions for _, motions in single_link)])
            active = decompose(passive @ spare.T).null_space @ spare
            raise SpatialPinError(f"mechanism {equations.mechanism.name!r}: "
                                  + _unactuated_words(equations, actuation, active, size))
        if single_link:
            idle = _idle_rotations(equations, single_link)
            a = _unactuated_accelerations(equations, actuation, spare, idle)
    forces, condition = equations.motion_forces(a), 1.0
    wanted = forces - equations.given
    efforts: Array = wanted[actuation.columns]
    if actuation.has_shared:
        shared = actuation.shared
        work, root = freedoms * scale, actuation.root[shared]
        svd = decompose(work[:, actuation.columns[shared]] * root)
        efforts[shared] = root * svd.minimum_norm(work @ wanted)
        condition = float(svd.s[0] / svd.s[svd.rank - 1]) if svd.rank else 1.0
    gross = float((scale * (np.abs(forces) + np.abs(equations.given))).max(initial=0.0))
    most = float(np.abs(scale[actuation.columns] * efforts).max(initial=0.0))
    off = float(min(len(a) * EPS * condition * gross / (most or 1e-300), 1.0)) if gross else 0.0
    return efforts, a, wanted - actuation.generalised(efforts, len(wanted)), off


def internal_efforts(equations: Equations, actuation: Actuation) -> Array:
    """Return orthonormal efforts (m, k) of the actuators that balance each other."""
    shared = actuation.shared
    if np.count_nonzero(shared) < 2:
        return np.zeros((0, len(shared)))
    work = _freedoms(equations, actuation)[0] * equations.scale
    efforts = decompose(work[:, actuation.columns[shared]]).null_space
    widened = np.zeros((len(efforts), len(shared)))
    widened[:, shared] = efforts
    return widened


def _freedoms(equations: Equations, actuation: Actuation) -> tuple[Array, int]:
    """Return the freedoms (k, nv), scaled, that actuators share, and the rank of the loops."""
    if equations.is_sparse:
        return equations.spaces.null_space, equations.spaces.rank
    freedoms, rank = equations.tied_freedoms
    if len(actuation.others):
        free = np.zeros((len(actuation.others), freedoms.shape[1]))
        free[np.arange(len(free)), actuation.others] = 1.0
        freedoms = np.vstack([freedoms, free])
    return freedoms, rank


def _unactuated_words(
    equations: Equations, actuation: Actuation, freedoms: Array, pull: Array
) -> str:
    """Return which freedoms (k, nv), scaled, no actuator moves, and which coordinates move them.

    Each actuator moves something by `pull` (m,) at most: zero at a limit position.
    """
    mechanism, missing = equations.mechanism, len(freedoms)
    bases = _floating(mechanism, equations.moving(freedoms))
    entries = [v for joint in bases for v in velocity_entries(mechanism, joint)]
    others = decompose(freedoms[:, entries].T).null_space @ freedoms  # no base moves
    remedies = []
    if len(others):
        drivers = {c.v: name for name, c in driver_coordinates(mechanism).items() if c.q >= 0}
        driven, n = np.array([*drivers], int), len(others)
        first = driven[common_rows(others.T[driven][None], np.zeros((0, n)), n)]  # drivers first
        remaining = others.T @ decompose(others.T[first].reshape(-1, n)).null_space.T
        own = np.array([c.v for c in mechanism.coordinate_table.values() if c.q >= 0], int)
        rest = own[independent_rows(remaining[own])]  # then where motors can act
        if len(rest) < remaining.shape[1]:
            rest = independent_rows(remaining)
        chosen = [*(drivers[v] for v in first.tolist()), *(mechanism.coordinates[v] for v in rest)]
        moving = ", ".join(equations.moving(others))
        given = [name for name in actuation.names if mechanism.coordinate(name).q >= 0]
        remedies.append(
            f"actuate {len(others)} more of {moving}, such as actuated={[*given, *chosen]}"
            if _bear_motors(equations, chosen) else
            f"what moves is {moving}, and {NO_MOTOR}: model it as a chain of revolute joints")
    remedies += [_base_hint(mechanism, joint) for joint in bases]
    stuck = [name for name, x in zip(actuation.names, pull, strict=True)
             if x < TOLERANCES.near_singular]
    why = (f"{', '.join(map(repr, stuck))} {'is' if len(stuck) == 1 else 'are'} at a limit "
           "position, where no effort there moves anything: ") if stuck else ""
    return (f"{why}{missing} freedom{'s have' if missing > 1 else ' has'} no actuator; "
            f"{'; '.join(remedies)}")


def _floating(mechanism: Mechanism, names: Iterable[str]) -> list[str]:
    """Return the free bases among the joints of some coordinates."""
    moving = {mechanism.coordinate(name).joint for name in names}
    return [joint for joint in untied(mechanism) if joint in moving]


def _base_hint(mechanism: Mechanism, joint: str) -> str:
    """Return a remedy for a free base, on which no motor acts, as text."""
    at, ground = mechanism.joint_id(joint), mechanism.links[0]
    link = next((f.name for f in mechanism.model.frames
                 if f.parentJoint == at and f.type == pin.FrameType.BODY), joint)
    fixed = "load it without free_flyer=True, " if mechanism.free_flyer else ""
    return (f"{joint} floats freely, and no motor acts there: {fixed}hold it, or say where it "
            "stands, by closures of links with the ground, such as "
            f"sp.closures.weld(({ground!r}, state.placement({link!r})), {link!r})")


def _bear_motors(equations: Equations, names: Iterable[str]) -> bool:
    return all(equations.mechanism.coordinate(name).q >= 0 for name in names)


def _unactuated_accelerations(
    equations: Equations, actuation: Actuation, spare: Array, idle: Array
) -> Array:
    """Return accelerations (nv,) with those of idle rotations (m, nv) determined by forces.

    In motion forces determine all passive freedoms (k, nv). At rest none can bear a load.

    Raises:
        SpatialPinError: something works on freedoms that are not passive, or at rest.
    """
    at = equations.state
    a = _with_idle_rotations(equations, idle, at.a) if len(idle) else at.a
    loaded = _loaded(equations, spare, idle, a)
    if loaded and (at.v.any() or at.a.any()):
        idle_of = idle_freedoms(LoopEquations(equations.mechanism), at.q, actuation.columns)
        free = np.vstack([spare[:0], *(motions / equations.scale @ spare.T @ spare
                                       for _, motions in idle_of)])
        a = _with_idle_rotations(equations, free, at.a) if len(free) else a
        loaded = _loaded(equations, spare, idle[:0], a)
    if not loaded:
        return a
    mechanism, bases = equations.mechanism, _floating(equations.mechanism, loaded)
    remedies = [_base_hint(mechanism, joint) for joint in bases]
    others = [name for name in loaded if mechanism.coordinate(name).joint not in bases]
    if others and _bear_motors(equations, others):
        remedies.append(f"actuate one of {', '.join(others)}" if bases else "actuate one of them")
    elif others:
        remedies.append(
            f"{NO_MOTOR}: let masses and forces act on the line through the ends of a rod, or make "
            "one of its balls a universal joint; a simulation tells how it turns else")
    raise SpatialPinError(
        f"mechanism {mechanism.name!r}: a freedom without actuator carries load: weight, a spring, "
        f"a force or inertia works on {', '.join(loaded)}; {'; '.join(remedies)}")


def _idle_rotations(equations: Equations, single_link: list[tuple[str, Array]]) -> Array:
    """Return the idle rotations (k, nv) among motions of one link, by joint.

    They turn a link of a loop and move no centre of mass.
    """
    evaluation, scale = equations.evaluation, equations.scale
    inertias = equations.model.inertias
    heavy = [k for k, body in enumerate(inertias) if k and body.mass > 0.0]
    levers = np.array([[*inertias[k].lever, 1.0] for k in heavy]).reshape(-1, 1, 4)
    columns = joint_jacobian(evaluation.data, len(scale))
    columns = columns * evaluation.constraints.supports[heavy][:, None]
    centres = (levers @ evaluation.placements[heavy])[:, 0]

    def shifts(motions: Array) -> Array:
        """Return the velocities (3 bodies, k) of centres, in characteristic lengths."""
        twists = columns @ (motions * scale).T
        velocities = twists[:, :3] + np.cross(twists[:, 3:], centres[:, :, None], axis=1)
        return velocities.reshape(-1, len(motions)) / equations.mechanism.characteristic_length

    idle = [np.zeros((0, len(equations.scale)))]
    for joint, motions in single_link:
        if is_in_loop(equations.mechanism, joint):
            svd = decompose(shifts(motions))
            moved = svd.s > TOLERANCES.half_precision * np.abs(motions).max()
            idle.append(svd.vt[np.count_nonzero(moved) :] @ motions)
    return np.vstack(idle)


def _loaded(equations: Equations, spare: Array, idle: Array, a: Array) -> list[str]:
    """Return the coordinates of undriven freedoms (k, nv), scaled, that carry a load.

    Weights, springs, forces from outside and the accelerations a (nv,) that are given: an end link
    would fall under them. Of idle rotations (m, nv), whose accelerations are free, springs and
    forces from outside.
    """
    state, scale, mechanism = equations.state, equations.scale, equations.mechanism
    wanted = equations.motion_forces(a) - equations.given
    weight = fall_energy(mechanism.model, mechanism.characteristic_length)
    heaviest = float(np.abs(scale[:, None] * equations.mass() * scale).max(initial=0.0))
    rates = float(np.abs(a / scale).max(initial=0.0))
    rates += float(np.abs(state.v / scale).max(initial=0.0)) ** 2
    round_off = ROUNDING * (weight + heaviest * rates)
    allowed = TOLERANCES.nothing * float(np.abs(scale * wanted).max()) + round_off
    for motions, force in ((spare, wanted), (idle, equations.applied)):
        loads = motions @ (scale * force)
        if np.abs(loads).max(initial=0.0) > allowed:
            return equations.moving(motions[np.abs(loads) > allowed])
    return []


def _with_idle_rotations(equations: Equations, idle: Array, a: Array) -> Array:
    """Return accelerations (nv,) with those of idle rotations (k, nv) determined by forces."""
    work = idle * equations.scale
    mass = equations.mass()
    wanted = equations.motion_forces(a) - equations.given
    heaviest = float(np.abs(equations.scale[:, None] * mass * equations.scale).max()) or 1.0
    inertia, load = work @ mass @ work.T / heaviest, work @ wanted / heaviest
    z = -decompose(inertia).minimum_norm(load)
    size = np.abs(equations.scale * wanted).max() / heaviest
    if np.abs(inertia @ z + load).max() > TOLERANCES.nothing * size:
        raise no_inertia_error(equations.mechanism, equations.moving(idle), equations.state)
    return a + work.T @ z
