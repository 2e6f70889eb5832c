"""Forces over a given motion: torque curves, bearing loads, shaking force and moment."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin._support.brief import first_names
from spatial_pin._support.checks import checked, mapping
from spatial_pin._support.columns import Quantity, Tabular, read_only
from spatial_pin.assembly.state import State, moving_in_time
from spatial_pin.dynamics.forces import Law, warn_of_no_inertia
from spatial_pin.dynamics.inverse import Actuation, actuation_of, balance, internal_efforts
from spatial_pin.dynamics.lift_off import lift_offs
from spatial_pin.dynamics.reactions import Poses, not_unique_marks, why_not_unique
from spatial_pin.dynamics.solvers.equations_of_motion import Equations, equations_of
from spatial_pin.errors import Interrupted, SpatialPinError
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.resistance import SlipSpeed
from spatial_pin.motion.motion import Event, Motion, Output, first_samples, require_motion
from spatial_pin.motion.rated_limits import (
    BeyondLimit,
    beyond,
    effort_limits,
    velocities_beyond,
)
from spatial_pin.motion.summary import EFFORTS, effort_lines, first_of, heading, tidy, where
from spatial_pin.numerics.linalg import Array

External = Mapping[str, pin.Force] | Callable[[State], Mapping[str, pin.Force]]


class _Loads(NamedTuple):
    """The fields of a Kinetostatics; a named tuple allows no other base class."""

    motion: Motion
    a: Array
    efforts: dict[str, Array]
    power: dict[str, Array]
    reactions: dict[str, Array]
    on_ground: Array
    multipliers: Array
    determined: dict[str, NDArray[np.bool_]]
    unique: dict[str, NDArray[np.bool_]]
    beyond_limits: tuple[BeyondLimit, ...] = ()
    events: tuple[Event, ...] = ()


class Kinetostatics(_Loads, Tabular):
    """Forces over a motion of N samples, read-only; at rest where that is no motion in time.

    As a table (`columns`, `to_csv`, `to_dataframe`, ...) it has all efforts, powers and reactions,
    or outputs by their names.

    Attributes:
        motion: the motion.
        a: (N, nv) its accelerations [rad/s², m/s²]; those of passive freedoms as forces make them.
        efforts: (N,) by driver or actuated coordinate [N·m about it, N along it].
        power: (N,) of each of them [W]; 0 at rest.
        reactions: (N, 6) by pair, force then moment, as `Dynamics.reactions` [N, N·m].
        on_ground: (N, 6) force and moment at the world's origin on the fixed link: shaking wrench.
        multipliers: (N, n_closure) of the constraint equations, the shortest.
        determined: (N,) by pair, whether its reaction is unique, in all its components.
        unique: (N, 6) by pair, which components of its reaction are unique, world axes.
        beyond_limits: efforts, and velocities of a motion in time, beyond the URDF's limits, each
            with the samples, the worst of them, and how much it is.
        events: "lift off" where the contact of a cam would have to pull, between its samples.

    Example:
        >>> mech = sp.load("four_bar")
        >>> motion = sp.sweep(mech, "crank", np.linspace(0.0, 6.28, 181), speed=10.0)
        >>> loads = sp.kinetostatics(mech, motion)
        >>> loads.efforts["crank"].shape, loads.reactions["output_pin"].shape, loads.on_ground.shape
        ((181,), (181, 6), (181, 6))
        >>> print(f"at most {abs(loads.power['crank']).max():.2f} W")
        at most 21.42 W
    """

    __slots__ = ()

    @checked
    def output(self, spec: str) -> Output:
        """Return a quantity by its name, all that `Motion.output` returns, and forces.

        `NAME` or `NAME.effort` and `NAME.power` of what has an effort: a driver, its joint, or an
        actuated coordinate; `PAIR.reaction` (N, 6), force then moment, or `PAIR.reaction.force`
        and `PAIR.reaction.moment` of a pair; `on_ground`, `on_ground.force` and
        `on_ground.moment`.

        Raises:
            UnknownNameError: there is no such force, nor such a quantity of the motion.

        Example:
            >>> mech = sp.load("four_bar")
            >>> loads = sp.kinetostatics(mech, sp.sweep(mech, "crank", [0.0, 0.5, 1.0], speed=10.0))
            >>> values, label, unit = loads.output("output_pin.reaction.force")
            >>> values.shape, label, unit  # (N, 3)
            ((3, 3), 'output_pin reaction force', 'N')
            >>> loads.output("crank.effort").values.round(3)  # [N·m]
            array([-0.27 ,  0.214,  0.971])
        """
        from spatial_pin.dynamics.force_outputs import output

        return output(self, spec)

    def quantities(self, outputs: str | Iterable[str] | None = None) -> dict[str, Quantity]:
        """Return quantities by name: time, driver, all efforts, powers and reactions.

        Args:
            outputs: names as `output` takes them; these are returned beside time and driver.

        Raises:
            UnknownNameError: there is no such output.

        Example:
            >>> mech = sp.load("four_bar")
            >>> loads = sp.kinetostatics(mech, sp.sweep(mech, "crank", [0.0, 0.5, 1.0], speed=10.0))
            >>> [(name, x.unit) for name, x in loads.quantities("crank.effort").items()]
            [('time', 's'), ('crank', 'rad'), ('crank effort', 'N·m')]
        """
        from spatial_pin.dynamics.force_outputs import quantities

        return quantities(self, outputs)

    def _repr_html_(self) -> str:
        """Return a small table, for a notebook."""
        from spatial_pin.view.page import cards

        return cards.kinetostatics(self)

    def __repr__(self) -> str:
        units = self.motion.mechanism.coordinate
        efforts = [f"{name} [{EFFORTS[units(name).unit]}]" for name in self.efforts]
        return (f"Kinetostatics({self.motion!r}, efforts {first_names(efforts)}, "
                f"reactions [N, N·m] of {first_names(self.reactions)})")

    def __str__(self) -> str:
        statics = "" if self.motion.per == "s" else " at rest, for the motion has no speed"
        parts = [heading(self.motion), f"efforts{statics}:", *first_of(
            effort_lines(self.motion, self.efforts), "efforts")]
        parts += first_of([f"  {x.text(self.motion)}" for x in self.beyond_limits], "limits")
        parts += first_of([f"  {x.text}" for x in self.events], "events")
        loads = [self._largest(name, x) for name, x in self.reactions.items()]
        parts += ["largest reactions:", *first_of(loads, "pairs"),
                  self._largest("on the fixed link, all together", self.on_ground)]
        return "\n".join([*parts, *(f"  {why}" for why in self.why_not_unique())])

    def _largest(self, name: str, wrench: Array) -> str:
        """Return the largest force and moment (N, 6) of a pair, as a line."""
        texts, parts = [], wrench.reshape(-1, 2, 3)
        for sizes, unit, mark in zip(np.linalg.norm(parts, axis=2).T, ("N", "N·m"),
                                     self.marks(name), strict=True):
            size = tidy(sizes.max(initial=0.0), self.on_ground) if len(sizes) else "0"
            at = f" {where(self.motion, int(sizes.argmax()))}" if size != "0" else ""
            texts.append(f"{size} {unit}{mark}{at}")
        return f"  {name}: {', '.join(texts)}"

    def why_not_unique(self) -> list[str]:
        """Return why some reactions are not unique.

        Returns:
            A sentence for each reason; none where all are unique.

        Example:
            >>> mech = sp.load("four_bar")
            >>> loads = sp.kinetostatics(mech, sp.sweep(mech, "crank", [0.0, 0.5], speed=10.0))
            >>> print(loads.why_not_unique()[0][:50])
            * one of many (along these axes), the least: loops
        """
        mechanism = self.motion.mechanism
        marked = [name for name, each in self.determined.items() if not each.all()]
        return why_not_unique(mechanism.whole or mechanism, marked)

    def marks(self, name: str) -> tuple[str, str]:
        """Return marks for a pair's force and moment, with the axes along which one is of many.

        Args:
            name: of a joint or closure.

        Returns:
            Two texts, empty where all components are determined.

        Example:
            >>> mech = sp.load("four_bar")
            >>> loads = sp.kinetostatics(mech, sp.sweep(mech, "crank", [0.0, 0.5], speed=10.0))
            >>> loads.marks("output_pin")  # of the force and of the moment
            (' *y', ' *xz')
        """
        unique = self.unique.get(name)
        if unique is None:
            return "", ""
        return not_unique_marks(np.logical_and.reduce(unique, axis=0))


class _StoredSamples:
    """Solved samples; the reactions of all are evaluated together later."""

    def __init__(self, equations: Equations, n: int, n_efforts: int) -> None:
        model, rows = equations.model, equations.n_closure
        nj, nv = model.njoints, model.nv
        self.efforts, self.joint_efforts = np.empty((n, n_efforts)), np.empty((n, nv))
        self.a, self.multipliers = np.empty((n, nv)), np.empty((n, rows))
        self.given, self.transmitted = np.zeros((n, nj, 6)), np.empty((n, nj, 6))
        wrenches = equations.constraints.n_wrenches
        self.poses = Poses(np.empty((n, nj, 4, 3)), np.empty((n, 6, nv)),
                           np.empty((n, wrenches, 6)))
        self.unique = np.ones((n, len(equations.pairs.names), 6), dtype=bool)
        self.done = 0

    def fill(self, k: int, equations: Equations, bearing: Equations, actuation: Actuation) -> None:
        """Solve sample k at the state of `equations`; `bearing` has all rows of the file."""
        x, a, closures = balance(equations, actuation)
        self.efforts[k], self.a[k] = x, a
        self.transmitted[k] = bearing.transmitted(a)
        self.multipliers[k] = bearing.multipliers(closures)
        self.joint_efforts[k] = bearing.at_joints(actuation.generalised(x, len(a)),
                                                  self.multipliers[k], a)
        for stored, now in zip(self.poses, bearing.poses(), strict=True):
            stored[k] = now
        if bearing.wrenches:
            self.given[k] = bearing.pairs.summed(bearing.wrenches)
        spare = internal_efforts(equations, actuation)
        if len(spare) or bearing.pairs.coupled or bearing.has_redundant:
            efforts = actuation.all_generalised(spare, len(a))
            self.unique[k] = list(bearing.unique(efforts).values())
        self.done = k + 1

    def end(self) -> None:
        """Drop the samples that are not solved."""
        for name in ("efforts", "joint_efforts", "a", "multipliers", "given", "transmitted",
                     "unique"):
            setattr(self, name, getattr(self, name)[: self.done])
        self.poses = Poses(*(x[: self.done] for x in self.poses))


@checked
def kinetostatics(
    mechanism: Mechanism,
    motion: Motion,
    actuated: Iterable[str] | Mapping[str, float] | None = None,
    *,
    external: External | None = None,
    laws: Mapping[str, Law] | None = None,
    slip_speed: SlipSpeed | None = None,
) -> Kinetostatics:
    """Solve the efforts that a motion needs and the reactions it causes, sample by sample.

    The same as `inverse_dynamics` of every `motion.state(row)`, at a fraction of the cost. For a
    sweep without a speed this is statics: the mechanism is held at rest in every sample.

    Args:
        mechanism: the mechanism.
        motion: from `sweep` or `simulate`.
        actuated: as for `inverse_dynamics`.
        external: forces at frames, world axes, or a function of the State that returns them.
        laws: as for `forward_dynamics`.
        slip_speed: as for `forward_dynamics`.

    Returns:
        The Kinetostatics.

    Raises:
        SpatialPinError: a freedom is not actuated, or the motion is of another mechanism.
        SingularError: the loops lose rank at a sample.
        Interrupted: after Ctrl-C; `.found` has the forces until then.

    Example:
        >>> mech = sp.load("four_bar")
        >>> motion = sp.sweep(mech, "crank", np.linspace(0.0, 6.28, 181), speed=10.0)
        >>> loads = sp.kinetostatics(mech, motion)
        >>> loads.efforts["crank"].shape, loads.reactions["output_pin"].shape  # (N,), (N, 6)
        ((181,), (181, 6))
        >>> print(f"at most {loads.efforts['crank'].max():.3f} N·m")
        at most 2.142 N·m
    """
    require_motion(motion)
    if mechanism not in (motion.mechanism, motion.mechanism.whole):
        raise SpatialPinError(
            f"the motion belongs to mechanism {motion.mechanism.name!r}, not to this load of "
            f"{mechanism.name!r}"
        )
    warn_of_no_inertia(mechanism, external=external)
    moved, is_cut = motion.mechanism, False
    actuation = actuation_of(moved, actuated)
    with ExitStack() as stack:
        equations = bearing = stack.enter_context(equations_of(moved))
        if moved.whole is not None:
            bearing = stack.enter_context(equations_of(moved.whole))
        rows = _StoredSamples(bearing, len(motion), len(actuation.names))
        try:
            for k in range(len(motion)):
                state = moving_in_time(mechanism, motion.state(k))
                given = external(state) if callable(external) else external
                for each in {equations, bearing}:
                    each.update(state, mapping(given, "external"), laws, slip_speed)
                rows.fill(k, equations, bearing, actuation)
        except SpatialPinError as error:
            error.args = (f"{error} ({where(motion, k)}, sample {k})",)
            raise
        except KeyboardInterrupt:
            if not rows.done:
                raise
            rows.end()
            motion, is_cut = first_samples(motion, rows.done), True
        reactions, ground = bearing.pairs.reactions(
            rows.poses, rows.transmitted, rows.multipliers, rows.given, rows.joint_efforts)
        unique = dict(zip(bearing.pairs.names, rows.unique.swapaxes(0, 1), strict=True))
    efforts = {name: read_only(x)
               for name, x in zip(actuation.names, rows.efforts.T, strict=True)}
    rates = motion.v[:, actuation.columns].T * (motion.per == "s")
    power = {name: read_only(x * rate)
             for (name, x), rate in zip(efforts.items(), rates, strict=True)}
    loads = Kinetostatics(motion, read_only(rows.a), efforts, power,
                          {name: read_only(x) for name, x in reactions.items()},
                          read_only(ground), read_only(rows.multipliers),
                          {name: each.all(axis=1) for name, each in unique.items()}, unique,
                          _beyond_limits(motion, actuation, rows.efforts),
                          _lift_offs(motion, rows.multipliers))
    if is_cut:
        raise Interrupted(motion, loads)
    return loads


def _lift_offs(motion: Motion, multipliers: Array) -> tuple[Event, ...]:
    """Return where contacts of cams begin to pull, given multipliers (N, n_closure)."""
    if motion.driver is not None:
        at, what = motion.driver, f"at {motion.driver_name} = {{:.9g}} {motion.driver_unit}"
    elif motion.time is not None:
        at, what = motion.time, "at {:.9g} s"
    else:
        at, what = np.arange(len(motion), dtype=float), "in sample {:.9g}"
    return tuple(lift_offs(motion.mechanism, multipliers, at, what))


def _beyond_limits(motion: Motion, actuation: Actuation, efforts: Array) -> tuple[BeyondLimit, ...]:
    """Return the limits that efforts (N, k) or velocities exceed."""
    total = np.zeros((motion.mechanism.model.nv, len(motion)))
    np.add.at(total, actuation.columns, efforts.T)
    pairs = [(limit, total[limit.v]) for limit in effort_limits(motion.mechanism)]
    return (*beyond(pairs), *velocities_beyond(motion))
