"""Reduction: the smallest mechanism with the same outputs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np

from spatial_pin._support.checks import checked
from spatial_pin._support.lazy import by_new_name, made_once
from spatial_pin.assembly.assemble import assembled
from spatial_pin.assembly.state import State, carried_angles, of_mechanism
from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.errors import SpatialPinError
from spatial_pin.kernel.loop_equations import LoopEquations, loops_of
from spatial_pin.mechanism.coordinates import coordinates_of, joint_values, require_mechanism
from spatial_pin.mechanism.equations import linear_ratios
from spatial_pin.mechanism.extent import Extent
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.resistance import resists
from spatial_pin.numerics.linalg import Array, null_space, rank
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.reduction.building import Omission, ReducedModel, built, omissions
from spatial_pin.reduction.influence import OutputInfluence, RequestedOutputs, requested_outputs
from spatial_pin.reduction.replacing import drop_equations, replace_links

ROUNDINGS = 10.0  # of a position in the world, as links are put together
STARTS = 256  # assembled configurations in the cache: 0.2 MB for a hundred coordinates


class Difference(NamedTuple):
    """Largest difference of an output between the reduced and the full model.

    Attributes:
        output: coordinate, frame, or LINK.com.
        driver: the swept driver, or "forward dynamics".
        position: [rad], or [m] by the characteristic length.
        rate: of velocities [-], relative to the largest, or to 1 rad/s or characteristic length
            per s.
        acceleration: of accelerations likewise [-].

    Example:
        >>> found = sp.reduce(sp.load("rssr"), "rocker_pin").verify().differences[0]
        >>> found.output, found.driver, found.position < 1e-10
        ('rocker_pin', 'crank', True)
    """

    output: str
    driver: str
    position: float
    rate: float
    acceleration: float


class Verification(NamedTuple):
    """A comparison of the reduced and the full model; `str()` is a report.

    Attributes:
        differences: one for each output and driver.
        rows: number of samples compared.
        full_seconds, reduced_seconds: how long the sweeps take, but for the first one of a
            mechanism, which prepares it [s].
        remarks: differences between the ends of the two motions, and values that were not reached.
        compared: driver and range of the comparison, in words.

    Example:
        >>> found = sp.reduce(sp.load("rssr"), "rocker_pin").verify()
        >>> found.rows, found.worst < 1e-10, found.remarks
        (361, True, ())
        >>> found.compared
        ('361 rows over crank from 0 to 6.28319 rad',)
    """

    differences: tuple[Difference, ...]
    rows: int
    full_seconds: float
    reduced_seconds: float
    remarks: tuple[str, ...]
    compared: tuple[str, ...] = ()

    @property
    def worst(self) -> float:
        """The largest difference of all."""
        return max(max(d[2:]) for d in self.differences)

    def __str__(self) -> str:
        lines = [f"{self.rows} rows compared, largest difference {self.worst:.1e}; full "
                 f"{1e3 * self.full_seconds:.3g} ms, reduced {1e3 * self.reduced_seconds:.3g} ms"]
        lines += [f"  {x}" for x in self.compared]
        lines += [f"  {d.output} over {d.driver}: position {d.position:.1e}, rate {d.rate:.1e}, "
                  f"acceleration {d.acceleration:.1e}" for d in self.differences]
        return "\n".join([*lines, *(f"  note: {x}" for x in self.remarks)])


@dataclass(frozen=True, eq=False, repr=False)
class Reduced(Mechanism):
    """The smallest mechanism with some outputs of another one; `str()` is a report.

    Attributes:
        full: the full mechanism.
        outputs: names of its outputs.
        welds: coordinates of the full mechanism that are locked, with their values [rad, m].
        dynamics: whether all parts with mass remain.
        omissions: the removed parts, with reasons.

    Example:
        >>> small = sp.reduce(sp.load("rssr"), "rocker_pin")
        >>> small.coordinates, len(small.full.coordinates)
        (('crank_pin', 'rocker_pin'), 5)
        >>> print(f"{sp.assemble(small, {'crank': 1.0}).coordinate('rocker_pin').value:.4f} rad")
        1.5232 rad
    """

    full: Mechanism = None  # type: ignore[assignment]
    outputs: tuple[str, ...] = ()
    welds: Mapping[str, float] = field(default_factory=dict)
    dynamics: bool = False
    omissions: tuple[Omission, ...] = ()

    @property
    def left_out(self) -> tuple[Omission, ...]:
        """The old name of `omissions`; it warns."""
        return tuple(by_new_name(self, "left_out", "omissions"))

    @cached_property
    def extent(self) -> Extent:
        """The extent of the full mechanism, so that closure errors have the same scale."""
        return self.full.extent

    @cached_property
    def unplaced(self) -> Mapping[str, str]:
        """Links, frames and joints with another placement here, each with a removed joint.

        They carry outputs, but the outputs do not depend on the joints that move them.
        """
        full, own = self.full, {self.model.names[i] for i in range(self.model.njoints)}
        own |= {full.coordinate(name).joint for name in self.welds}
        missing_joints = {}
        for name in self.frame_ids:
            if name in full.frame_ids:
                chain = full.model.supports[full.frame_on_joint(name)[0]]
                missing = [full.model.names[i] for i in chain if full.model.names[i] not in own]
                missing_joints.update({name: missing[0]} if missing else {})
        return missing_joints

    def placed(self, name: str) -> str:
        """Return the name of a link, frame or joint if its motion in the world is known here.

        Raises:
            SpatialPinError: a joint that moves it is removed.
        """
        joint = self.unplaced.get(name) if isinstance(name, str) else None
        if joint is not None:
            on = self.full.frame_on_joint(name)[0]
            link = next((x for x in self.full.links if self.full.frame_on_joint(x)[0] == on), name)
            raise SpatialPinError(
                f"mechanism {self.name!r} does not know where {name!r} is: joint {joint!r}, which "
                "moves it, is left out, as no output moves with it; reduce to "
                f"{(*self.outputs, link)} for that")
        return name

    def start(self, values: Mapping[str, float]) -> Array | None:
        """Return the assembly of the full mechanism: removed parts may decide the branch."""
        return _starts(self)(*sorted(values.items()))

    @checked
    def state(self, full: State) -> State:
        """Return a state of the full mechanism as one of this.

        Raises:
            SpatialPinError: it is a state of another mechanism, or a welded joint stands
                elsewhere in it, so that the loops are open here.

        Example:
            >>> mech = sp.load("rssr")
            >>> small = sp.reduce(mech, "rocker_pin")
            >>> small.state(sp.assemble(mech, {"crank": 1.0})).q.round(4)  # crank, rocker [rad]
            array([1.    , 1.5232])
        """
        full = of_mechanism(self.full, full)
        state = carried_over(self, full)
        if state.closure_error > max(_closed(self), 10.0 * full.closure_error):
            raise SpatialPinError(
                f"mechanism {self.name!r}: the loops are open by {state.closure_error:.1e} in "
                "that state: what was welded, or the branch, is another there")
        return state

    @checked
    def verify(
        self, driver: str | None = None, values: Any = None, *, speed: float = 1.0,
        acceleration: float = 0.5, guess: Mapping[str, Any] | None = None,
        hold: Mapping[str, float] | None = None,
    ) -> Verification:
        """Sweep this and the full mechanism side by side and compare the outputs.

        With `dynamics`, accelerations by `forward_dynamics` are compared too, at some samples.

        Args:
            driver: what to sweep; default every driver in turn.
            values: (N,) its values [rad or m], compared as far as both models can go; default its
                range, or a whole turn.
            speed: of the driver [rad/s or m/s].
            acceleration: likewise [rad/s² or m/s²].
            guess: where both assemble, by joints that both have. Where it leads them to different
                branches, a remark says so, and both are compared on that of the full one.
            hold: values of the other drivers; default those of the assembled configuration.

        Returns:
            The Verification; `print` it for a report.

        Raises:
            SpatialPinError: there is nothing to drive.

        Example:
            >>> small = sp.reduce(sp.load("rssr"), "rocker_pin")
            >>> small.verify("crank", np.linspace(0.0, 6.28, 37)).worst < 1e-10
            True
        """
        from spatial_pin.reduction.verification import verification

        return verification(
            self, driver, values, speed, acceleration, guess, dict(hold or {}))

    def __repr__(self) -> str:
        return super().__repr__().replace("Mechanism(", "Reduced(", 1)

    def __str__(self) -> str:
        full, rows = self.full, [constraints_of(m).n_closure for m in (self.full, self)]
        lines = [
            f"{self.name}, reduced to {', '.join(self.outputs)}:",
            f"  coordinates {len(full.coordinates)} -> {len(self.coordinates)}, "
            f"equations {rows[0]} -> {rows[1]}, links and frames "
            f"{len(full.links)} -> {len(self.links)}",
        ]
        if len(self.coordinates) == len(full.coordinates) and rows[0] == rows[1]:
            moved = "these outputs, or parts with mass" if self.dynamics else "these outputs"
            lines.append(f"  nothing is gained: all coordinates and equations move {moved}; "
                         f"{'simulations' if self.dynamics else 'sweeps'} take as long")
        lines.append("  without a State as guess, the full mechanism is assembled first and "
                     "chooses the branch: sweeps of few values take longer than with the full one")
        return "\n".join([*lines, *(f"  left out: {x}" for x in self.omissions)])


@checked
def reduce(
    mechanism: Mechanism,
    outputs: str | Iterable[str],
    *,
    lock: Mapping[str, float] | Iterable[str] = (),
    dynamics: bool = False,
    lump: bool = False,
    guess: Mapping[str, Any] | State | Array | None = None,
) -> Reduced:
    """Return the smallest model with the same outputs.

    These parts are removed: geometry; loops and branches that no output depends on; links with two
    pairs that are no more than equations between their neighbours (a rod with two balls is one
    distance; a leg with a slide that is driven, or an output, is a distance of variable length);
    redundant equations (of plane loops); and, unless `dynamics`, inertias and springs. Drivers
    stay. A removed loop no longer limits the drivers; `Reduced.verify` shows if this matters.

    Args:
        mechanism: the mechanism.
        outputs: names of coordinates, joints (their coordinates), links and frames (their motion
            in the world; of a link also its centre of mass), or outputs as of `Motion.output`;
            with `dynamics` efforts and powers too (`crank.effort`).
        lock: joints, coordinates or drivers that never move, with their values [rad, m], or
            their names only to lock them where the guess has them.
        dynamics: keep all parts with mass, springs and damped joints. The omitted parts are then
            massless, and forward dynamics is exact.
        lump: with `dynamics`, replace rods between balls or universal joints all the same: their
            mass goes to the centres of the two pairs, which keeps the mass, and the centre of mass
            where that lies on the line between them; `omissions` tells how far it moves otherwise,
            and what inertia is lost.
        guess: where to assemble; welded joints are welded there.

    Returns:
        The Reduced, a Mechanism that every function of the library takes.

    Raises:
        AssemblyError: the guess does not close.
        UnknownNameError: a name does not exist.
        SpatialPinError: an output is locked, part of a joint only, a reaction, or an effort
            without `dynamics`.
        ValueError: no outputs, or `lump` without `dynamics`.

    Example:
        >>> mech = sp.load("rssr")
        >>> small = sp.reduce(mech, "rocker_pin")  # the coupler becomes a distance
        >>> small.coordinates, [closure.type for closure in small.closures]
        (('crank_pin', 'rocker_pin'), ['distance'])
        >>> small.verify().worst < 1e-10
        True
    """
    require_mechanism(mechanism)
    given = (outputs,) if isinstance(outputs, str) or not isinstance(outputs, Iterable) else outputs
    names = () if outputs is None else tuple(given)
    if not all(isinstance(name, str) for name in names):
        raise TypeError(f"outputs is {outputs!r}; it is a name, or several")
    if not names:
        raise ValueError("outputs is empty; name at least one coordinate, link or frame")
    if lump and not dynamics:
        raise ValueError("lump=True says where mass goes: it needs dynamics=True")
    requested = requested_outputs(mechanism, names, dynamics)
    for name in requested.frames:
        mechanism.placed(name)
    state, welds, locked = _locked(mechanism, lock, guess)
    for name in requested.coordinates:
        if name in welds:
            raise SpatialPinError(f"mechanism {mechanism.name!r}: output {name!r} is locked")
    influence = OutputInfluence(mechanism, state, locked,
                          _needed(mechanism, requested, welds, dynamics),
                          _bodies(mechanism, requested, dynamics))
    least = influence.least()
    for simplest in (True, False):
        model = ReducedModel(
            mechanism, state.q, least, influence, requested, dynamics=dynamics, lump=lump)
        if simplest:
            replace_links(model)
            drop_equations(model)
        made = built(model)
        if _agrees(made, influence):
            break
    else:
        raise SpatialPinError(f"mechanism {mechanism.name!r}: no smaller model was found that "
                              "moves as it does at the configurations tried")
    parts = {f.name: getattr(made, f.name) for f in fields(Mechanism)}
    parts["guess"] = _coordinates(made, state)
    return Reduced(**parts, full=mechanism, outputs=names, welds=welds,
                   dynamics=dynamics,
                   omissions=tuple(omissions(model, locked)))


@made_once
def _starts(reduced: Reduced) -> Callable[..., Array | None]:
    """Return a cached function that assembles the full mechanism at (name, value) pairs."""
    at = _entries(reduced, reduced.full)

    @lru_cache(STARTS)
    def start(*values: tuple[str, float]) -> Array | None:
        try:
            there = assembled(reduced.full, {**reduced.welds, **dict(values)})
        except SpatialPinError:  # a loop that is left out cannot close there
            return None
        return there.q[at]

    return start


def _entries(reduced: Mechanism, full: Mechanism) -> Array:
    """Return (nq,) indices of a reduced mechanism's entries of q in that of the full one."""
    own, its = reduced.model, full.model
    at = [its.idx_qs[its.getJointId(own.names[i])] + np.arange(own.nqs[i])
          for i in range(1, own.njoints)]
    return np.concatenate([[], *at]).astype(int)


def carried_over(reduced: Mechanism, state: State) -> State:
    """Return a state of the full mechanism as a state of a reduced one."""
    q = state.q[_entries(reduced, state.mechanism)]
    at = [state.mechanism.coordinate_table[name].v for name in reduced.coordinates]
    angles = carried_angles(state.mechanism, state.angles, reduced)
    with loops_of(reduced, angles) as evaluation:
        evaluation.update(q)
        return State(reduced, q, state.v[at], state.a[at], in_time=state.in_time,
                     closure_error=evaluation.closure_error, angles=evaluation.angles)


def _locked(
    mechanism: Mechanism, lock: Mapping[str, float] | Iterable[str],
    guess: Mapping[str, Any] | State | Array | None,
) -> tuple[State, dict[str, float], frozenset[int]]:
    """Return the assembled state, values of locked coordinates, and their joints."""
    if isinstance(lock, Mapping):
        values = joint_values(mechanism, lock)
    else:
        names = [lock] if isinstance(lock, str) else list(lock)
        there = assembled(mechanism, None, guess)
        values = {}
        for name in names:
            coordinate = mechanism.driven_coordinate(name)
            values[coordinate.name] = there.coordinate(coordinate.name).value
        guess = there
    for _ in mechanism.closures:  # a joint geared to a locked one is locked
        for c in mechanism.closures:
            ratios = linear_ratios(c.rows[0]) if c.joints and not c.frames else None
            if ratios is not None:
                names = [mechanism.coordinate(name).name for name in c.joints]
                free = [name for name in names if name not in values]
                if len(free) == 1:
                    known = sum(ratios[0][k] * values[name] for k, name in enumerate(names)
                                if name not in free)
                    values[free[0]] = -(known + ratios[1]) / ratios[0][names.index(free[0])]
    joints = set()
    for name in values:
        joint = mechanism.coordinate(name).joint
        missing = [c.name for c in coordinates_of(mechanism, joint) if c.name not in values]
        if missing:
            raise SpatialPinError(
                f"mechanism {mechanism.name!r}: {name!r} alone cannot be locked: lock all "
                f"coordinates of {joint!r} ({', '.join(missing)} too)")
        joints.add(mechanism.joint_id(joint))
    state = assembled(mechanism, values, guess)
    return state, values, frozenset(joints)


def _needed(
    mechanism: Mechanism, requested: RequestedOutputs, welds: Mapping[str, float], dynamics: bool
) -> set[int]:
    """Return the joints with requested, driven or sprung coordinates."""
    names = [*requested.coordinates, *(d.joint for d in mechanism.drivers.values())]
    if dynamics:
        names += [s.joint for s in mechanism.springs if s.joint is not None]
    return {mechanism.joint_id(c.joint) for c in map(mechanism.coordinate, names)
            if c.name not in welds}


def _bodies(mechanism: Mechanism, requested: RequestedOutputs, dynamics: bool) -> set[int]:
    """Return the joints whose bodies have requested placements or mass."""
    bodies = {mechanism.frame_on_joint(name)[0] for name in requested.frames}
    if dynamics:
        model = mechanism.model
        bodies |= {mechanism.frame_on_joint(f)[0] for s in mechanism.springs for f in s.frames}
        for i in range(1, model.njoints):
            if model.inertias[i].mass > 0.0 or np.any(model.inertias[i].inertia) \
                    or resists(mechanism, i):
                bodies.add(i)
    return bodies - {0}


def _agrees(made: Mechanism, influence: OutputInfluence) -> bool:
    """Whether the reduced mechanism is closed, and as free, at the analysed configurations."""
    full = influence.mechanism
    evaluation = LoopEquations(made)
    at = [full.coordinate_table[name].v for name in made.coordinates]
    for q, motions in zip(influence.configurations, influence.motions, strict=True):
        influence.evaluation.update(q)
        state = State(full, q, closure_error=0.0, angles=influence.evaluation.angles)
        own = carried_over(made, state)
        evaluation.angle_reference[:] = own.angles
        evaluation.update(own.q)
        rows = evaluation.jacobian[: evaluation.constraints.n_closure]
        if evaluation.closure_error > _closed(full) or evaluation.mirrored() \
                or len(null_space(rows, 1e-8)) != rank(motions[:, at], TOLERANCES.singular):
            return False
    return True


def _closed(mechanism: Mechanism) -> float:
    """Return the closure error of a closed mechanism with positions in the world [-]."""
    return TOLERANCES.nothing + ROUNDINGS * mechanism.extent.resolution


def _coordinates(mechanism: Mechanism, state: State) -> dict[str, Any]:
    """Return the coordinates of a state by the joints of a reduced mechanism, as a file's guess."""
    out: dict[str, Any] = {}
    for joint in list(mechanism.model.names)[1:]:
        own = [state.coordinate(c.name).value for c in coordinates_of(mechanism, joint)]
        out[joint] = own[0] if len(own) == 1 else own
    return out
