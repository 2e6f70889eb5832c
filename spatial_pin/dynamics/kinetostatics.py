"""Forces of a given motion, at a State or over it: torques, bearing loads, shaking forces."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack
from functools import partial
from typing import Any, NamedTuple, overload

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin._support.brief import first_names
from spatial_pin._support.checks import checked
from spatial_pin._support.columns import Quantity, Tabular, read_only
from spatial_pin._support.lazy import acquired
from spatial_pin.assembly.state import State, moving_in_time
from spatial_pin.dynamics.forces import Law, warn_of_no_inertia
from spatial_pin.dynamics.inverse import (
    Actuation,
    Efforts,
    balance,
    drivers_of,
    internal_efforts,
)
from spatial_pin.dynamics.lift_off import lift_offs
from spatial_pin.dynamics.loaded_samples import (
    External,
    LoadedSamples,
    Loads,
    SampleBlock,
    accelerate,
    efforts_over,
)
from spatial_pin.dynamics.reactions import not_unique_marks, why_not_unique
from spatial_pin.dynamics.solvers.equations_of_motion import Equations, Solution
from spatial_pin.errors import Interrupted, SpatialPinError
from spatial_pin.kernel.kkt import FAILED, Accelerated
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.resistance import SlipSpeed
from spatial_pin.motion.limit_events import (
    BeyondLimit,
    beyond,
    effort_limits,
    velocities_beyond,
)
from spatial_pin.motion.motion import Event, Motion, Output, first_samples, require_motion
from spatial_pin.motion.summary import EFFORTS, effort_lines, first_of, heading, tidy, where
from spatial_pin.numerics.linalg import Array


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
    beyond_limits: tuple[BeyondLimit, ...]
    events: tuple[Event, ...]
    error: Array


class Kinetostatics(_Loads, Tabular):
    """Forces over a motion of N samples, read-only; at rest where that is no motion in time.

    `kinetostatics`, which is `inverse_dynamics` over a Motion, and `forward_dynamics` over one
    return it.

    As a table (`columns`, `to_csv`, `to_dataframe`, ...) it has all efforts, powers and reactions,
    or outputs by their names.

    Attributes:
        motion: the motion.
        a: (N, nv) its accelerations [rad/s², m/s²]; those of passive freedoms as forces make them.
            Of `forward_dynamics`, all as forces make them.
        efforts: (N,) by driver or actuated coordinate [N·m about it, N along it]; of
            `forward_dynamics` those that are given.
        power: (N,) of each of them [W]; 0 at rest.
        reactions: (N, 6) by pair, force then moment, as `Dynamics.reactions` [N, N·m].
        on_ground: (N, 6) force and moment at the world's origin on the fixed link: shaking wrench.
        multipliers: (N, n_closure) of the constraint equations, the shortest.
        determined: (N,) by pair, whether its reaction is unique, in all its components.
        unique: (N, 6) by pair, which components of its reaction are unique, world axes.
        beyond_limits: efforts, and velocities of a motion in time, beyond the URDF's limits, each
            with the samples, the worst of them, and how much it is.
        events: "lift off" where the contact of a cam would have to pull, between its samples.
        error: (N,) estimated round-off of the efforts, as `Efforts.error`; of `forward_dynamics` of
            the accelerations, as `Dynamics.error`.

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

        `NAME` or `NAME.effort` and `NAME.power` of a driver, its joint, or an actuated coordinate;
        `PAIR.reaction` (N, 6) of a pair, force then moment, or its parts `PAIR.reaction.force` and
        `PAIR.reaction.moment`; `on_ground`, `on_ground.force` and `on_ground.moment`.

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

    The same as `inverse_dynamics` of every `motion.state(row)`, at a fraction of the cost, and
    what `inverse_dynamics` of the Motion is. For a
    sweep without a speed this is statics: the mechanism is held at rest in every sample.

    Args:
        mechanism: the mechanism.
        motion: from `sweep` or `simulate`.
        actuated: as for `inverse_dynamics`.
        external: forces at frames, world axes: by link, frame or joint a `pin.Force`, or an array
            (N, 6) of force and moment; or a function of the time and the State, or of the State
            alone, that returns such a mapping of forces.
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
    moved = _moved(mechanism, motion)
    actuation = drivers_of(moved) if actuated is None else Actuation(moved, actuated)

    def solve(samples: LoadedSamples) -> None:
        equations, columns = samples.equations, actuation.columns

        def together(piece: SampleBlock) -> tuple[Array, Accelerated] | None:
            solution = equations.core_kkt.of_many(
                piece.q, piece.v, piece.angles, piece.given, samples.given_a[piece.at], columns)
            if solution.facts[:, FAILED].any():
                return None
            samples.efforts[piece.at] = solution.efforts
            joints = np.zeros_like(solution.a)
            joints[:, columns] = solution.efforts
            return joints, solution

        def alone(k: int) -> tuple[Array, Solution, Array]:
            samples.efforts[k], a, closures, error = balance(equations, actuation)
            internal = internal_efforts(equations, actuation)
            return (actuation.generalised(samples.efforts[k], len(a)), (a, closures, error),
                    actuation.all_generalised(internal, len(a)))

        samples.solve(together, alone)

    return loads_over(mechanism, motion, (external, laws, slip_speed),
                      dict.fromkeys(actuation.names), solve)


@overload
def inverse_dynamics(
    mechanism: Mechanism, state: State,
    actuated: Iterable[str] | Mapping[str, float] | None = None, *,
    external: Mapping[str, pin.Force] | None = None, laws: Mapping[str, Law] | None = None,
    slip_speed: SlipSpeed | None = None,
) -> Efforts: ...
@overload
def inverse_dynamics(
    mechanism: Mechanism, state: Motion,
    actuated: Iterable[str] | Mapping[str, float] | None = None, *,
    external: External | None = None, laws: Mapping[str, Law] | None = None,
    slip_speed: SlipSpeed | None = None,
) -> Kinetostatics: ...
@checked
def inverse_dynamics(
    mechanism: Mechanism,
    state: State | Motion,
    actuated: Iterable[str] | Mapping[str, float] | None = None,
    *,
    external: External | None = None,
    laws: Mapping[str, Law] | None = None,
    slip_speed: SlipSpeed | None = None,
) -> Efforts | Kinetostatics:
    """Solve the efforts that move a mechanism as `state` says, and the reactions.

    At rest this is statics. All that moves must be actuated, or be without load: a link that hangs
    on a hinge which nobody drives would fall. An exception are passive freedoms (`mobility` names
    them), such as the idle rotation of a rod between two balls: their accelerations are those that
    forces and inertia give them, whatever `state` says. At rest a load that would turn
    them is refused.

    With more actuators than freedoms the efforts of least (weighted) squares are taken;
    `Efforts.unique_efforts` tells which efforts depend on that, `Efforts.unique` which reactions.

    Args:
        mechanism: the mechanism.
        state: configuration, velocity and acceleration, from `solve_rates`; or a Motion, for
            all its samples (`kinetostatics`).
        actuated: drivers, joints or coordinates that have efforts, by default all drivers; with
            weights (a mapping), the sum of weight * effort² is least.
        external: by link, frame or joint, the force on it at its origin, world axes; over a Motion
            as for `forward_dynamics`.
        laws: of springs, as for `forward_dynamics`.
        slip_speed: of dry friction, as for `forward_dynamics`; there is none at rest.

    Returns:
        The Efforts; over a Motion the Kinetostatics.

    Raises:
        SpatialPinError: a freedom is not actuated, or carries load though nobody drives it; says
            which coordinates it moves.
        SingularError: the loops lose rank there.
        UnknownNameError: a name does not exist.
        ValueError: a weight is not positive.

    Example:
        >>> mech = sp.load("four_bar")
        >>> state = sp.solve_rates(mech, sp.assemble(mech, {"crank": 1.0}), {"crank": 10.0})
        >>> found = sp.inverse_dynamics(mech, state)
        >>> round(found.efforts["crank"], 5)  # [N·m]
        0.97137
        >>> found.reactions["output_pin"].linear.round(4)  # on the rocker [N], world axes
        array([-6.2348, -0.    , -8.7523])
    """
    if not isinstance(state, State):
        return kinetostatics(mechanism, state, actuated, external=external, laws=laws,
                             slip_speed=slip_speed)
    state = moving_in_time(mechanism, state)
    mechanism, load = state.mechanism, (external, laws, slip_speed)
    actuation = drivers_of(mechanism) if actuated is None else Actuation(mechanism, actuated)
    warn_of_no_inertia(mechanism, external=external)
    with acquired(mechanism, Equations) as equations:
        equations.update(state, *load)
        efforts, a, closures, error = balance(equations, actuation)
    return Efforts(state, load, a, closures, actuation, efforts, error)


def forward_over(
    mechanism: Mechanism, motion: Motion, efforts: Mapping[str, Any] | None, loads: Loads
) -> Kinetostatics:
    """Return `forward_dynamics` of every sample of a motion, under efforts that may change."""
    moved = _moved(mechanism, motion)
    given, at_joints = efforts_over(moved, motion, efforts), np.zeros((len(motion), moved.model.nv))
    for name, x in given.items():
        at_joints[:, moved.driven_coordinate(name).v] = x
    return loads_over(mechanism, motion, loads, given, partial(accelerate, efforts=at_joints))


def _moved(mechanism: Mechanism, motion: Motion) -> Mechanism:
    """Return the mechanism of a motion; refuse one of another mechanism."""
    require_motion(motion)
    if mechanism not in (motion.mechanism, motion.mechanism.whole):
        raise SpatialPinError(
            f"the motion belongs to mechanism {motion.mechanism.name!r}, not to this load of "
            f"{mechanism.name!r}"
        )
    return motion.mechanism


def loads_over(
    mechanism: Mechanism, motion: Motion, loads: Loads, known: Mapping[str, Array | None],
    solve: Callable[[LoadedSamples], None],
) -> Kinetostatics:
    """Return the forces over a motion.

    Args:
        mechanism: the mechanism, as the user has loaded it.
        motion: the motion.
        loads: forces at frames, laws of springs, slip speed.
        known: efforts (N,) by name; None where they are solved for.
        solve: solves the samples.
    """
    warn_of_no_inertia(mechanism, external=loads[0])
    moved, is_cut = motion.mechanism, False
    with ExitStack() as stack:
        equations = bearing = stack.enter_context(acquired(moved, Equations))
        if moved.whole is not None:
            bearing = stack.enter_context(acquired(moved.whole, Equations))
        samples = LoadedSamples(mechanism, motion, equations, bearing, loads, len(known))
        try:
            solve(samples)
        except SpatialPinError as error:
            k = samples.at
            error.args = (f"{error} ({where(motion, k)}, sample {k})",)
            raise
        except KeyboardInterrupt:
            if not samples.done:
                raise
            motion, is_cut = first_samples(motion, samples.done), True
        names = bearing.pairs.names
    for column, x in enumerate(known.values()):
        if x is not None:
            samples.efforts[:, column] = x
    done = slice(len(motion))
    at_drivers, multipliers = samples.efforts[done], samples.multipliers[done]
    efforts = {name: read_only(x) for name, x in zip(known, at_drivers.T, strict=True)}
    columns = np.array([moved.driven_coordinate(name).v for name in known], np.int64)
    rates = motion.v[:, columns].T * (motion.per == "s")
    power = {name: read_only(x * rate)
             for (name, x), rate in zip(efforts.items(), rates, strict=True)}
    unique: dict[str, NDArray[np.bool_]] = {
        name: samples.unique[done, k] for k, name in enumerate(names)}
    result = Kinetostatics(
        motion, read_only(samples.a[done]), efforts, power,
        {name: read_only(samples.reactions[done, k].copy()) for k, name in enumerate(names)},
        read_only(samples.on_ground[done]), read_only(multipliers),
        {name: np.logical_and.reduce(each, axis=1) for name, each in unique.items()}, unique,
        _beyond_limits(motion, columns, at_drivers),
        tuple(lift_offs(motion, multipliers)), read_only(samples.error[done]))
    if is_cut:
        raise Interrupted(motion, result)
    return result


def _beyond_limits(
    motion: Motion, columns: NDArray[np.int64], efforts: Array
) -> tuple[BeyondLimit, ...]:
    """Return the limits that efforts (N, k) at velocity entries (k,), or velocities, exceed."""
    total = np.zeros((motion.mechanism.model.nv, len(motion)))
    np.add.at(total, columns, efforts.T)
    pairs = [(limit, total[limit.v]) for limit in effort_limits(motion.mechanism)]
    return (*beyond(pairs), *velocities_beyond(motion))
