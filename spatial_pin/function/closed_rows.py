"""Rows of inputs of a function as closed states of a mechanism."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin.assembly.assemble import starting_state
from spatial_pin.assembly.state import State
from spatial_pin.dimensions.closed_derivatives import InputChanges, fixed_entries
from spatial_pin.dimensions.homotopy import followed
from spatial_pin.dimensions.variants import Variants
from spatial_pin.errors import AssemblyError, SingularError, SpatialPinError, UnknownNameError
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.motion import Motion
from spatial_pin.motion.outputs import EFFORT, RATES
from spatial_pin.motion.scattered_states import states
from spatial_pin.numerics.linalg import Array
from spatial_pin.rates.rates import prescribed_at, solve_rates

VALUE, RATE, ACCELERATION, DIMENSION = "value", "rate", "acceleration", "dimension"


class FunctionInput(NamedTuple):
    """An input of a function: its quantity, and the name of the driver or dimension."""

    name: str
    kind: str
    of: str


class ClosedRows:
    """Closes the loops for rows of inputs, on the branch of a guess.

    Inputs are what the columns of a row are.

    Attributes:
        home: the State of the guess.
        driven, still: prescribed coordinates, and velocity entries that do not move.
        variants: the mechanism at other dimensions; None if no input is one.
    """

    def __init__(
        self, mechanism: Mechanism, inputs: Sequence[FunctionInput], guess: Any
    ) -> None:
        self.mechanism, self._inputs = mechanism, inputs
        self.home = starting_state(mechanism, guess)
        names = [name for _, name in self.columns(VALUE)] or list(mechanism.drivers)
        self.driven = prescribed_at(self.home, names) if names else []
        self.still = fixed_entries(self.home.mechanism, self.driven)
        self.dimensions = [name for _, name in self.columns(DIMENSION)]
        self.variants = Variants(mechanism, self.dimensions) if self.dimensions else None

    def columns(self, kind: str) -> list[tuple[int, str]]:
        """Return number and name of the inputs of a kind."""
        return [(k, x.of) for k, x in enumerate(self._inputs) if x.kind == kind]

    def motions(
        self, rows: Array, with_masses: bool
    ) -> Iterator[tuple[NDArray[np.intp], Motion]]:
        """Yield numbers of rows with the same dimensions, and their states with rates.

        Raises:
            AssemblyError, SingularError: a row cannot be reached, or has no rates; says which.
        """
        columns = [k for k, _ in self.columns(DIMENSION)]
        every, group = np.unique(rows[:, columns], axis=0, return_inverse=True)
        own = [self.mechanism.dimensions[name] for name in self.dimensions]
        for k, x in enumerate(every.tolist()):
            at = np.flatnonzero(group.reshape(-1) == k)
            mechanism, home = self.home.mechanism, self.home if x == own else None
            if x != own:
                assert self.variants is not None
                try:
                    mechanism = self.variants.at(
                        dict(zip(self.dimensions, x, strict=True)), with_masses)
                except SpatialPinError as error:
                    raise _unreached(int(at[0]), str(error)) from error
                with suppress(SpatialPinError):  # drivers may not have the guess's values there
                    home = followed(mechanism, self._standing, self.home)
            yield at, self._moving(self._closed(mechanism, home, rows, at), rows, at)

    def changes(self) -> InputChanges:
        """Return the derivatives of the given quantities by each input."""
        m, numbers = len(self._inputs), [c.name for c in self.driven]
        values, rates, accelerations = np.zeros((3, len(numbers), m))
        given = InputChanges(
            values, rates, accelerations, np.zeros((self.mechanism.model.nv, m)),
            np.zeros((len(self.dimensions), m)))
        for k, x in enumerate(self._inputs):
            if x.kind == DIMENSION:
                given.dimensions[self.dimensions.index(x.of), k] = 1.0
                continue
            c = self.mechanism.coordinate(x.of)
            if x.kind == EFFORT:
                given.efforts[c.v, k] = 1.0
            else:
                table = {VALUE: given.values, RATE: given.rates,
                         ACCELERATION: given.accelerations}[x.kind]
                table[numbers.index(c.name), k] = 1.0
        return given

    @property
    def _standing(self) -> dict[str, float]:
        """The drivers' values at the first State."""
        return {c.name: self.home.coordinate(c.name).value for c in self.driven if c.q >= 0}

    def _closed(
        self, mechanism: Mechanism, home: State | None, rows: Array, at: NDArray[np.intp]
    ) -> Motion:
        """Return the closed states of rows with the same dimensions, at rest.

        The dimensions change first, then the drivers; if that fails, the drivers first.
        """
        values = {self.mechanism.coordinate(name).name: rows[at, column]
                  for column, name in self.columns(VALUE)}
        known, reasons = None, dict.fromkeys(range(len(at)), "the dimensions cannot be reached")
        if home is not None and not values:
            return _as_motion([home] * len(at))
        if home is not None:
            known = states(mechanism, values, home)
            reasons = known.unreached
        if known is not None and not reasons:
            return known
        first = int(at[min(reasons)])
        if mechanism is self.home.mechanism:
            raise _unreached(first, reasons[min(reasons)])
        before = states(self.home.mechanism, values, self.home) if values else _as_motion(
            [self.home] * len(at))
        solved = []
        for i, k in enumerate(at.tolist()):
            if known is not None and i not in reasons:
                solved.append(known.state(i))
                continue
            try:
                if i in before.unreached:
                    raise SpatialPinError(before.unreached[i])
                held = self._standing | {name: float(x[i]) for name, x in values.items()}
                solved.append(followed(mechanism, held, before.state(i)))
            except SpatialPinError as error:
                raise _unreached(k, str(error)) from error
        return _as_motion(solved)

    def _moving(self, motion: Motion, rows: Array, at: NDArray[np.intp]) -> Motion:
        """Return the states of rows with their rates."""
        speeds, accelerations = (
            {name: rows[at, column] for column, name in self.columns(kind)}
            for kind in (RATE, ACCELERATION))
        if not speeds and not accelerations:
            return motion
        try:
            return solve_rates(motion.mechanism, motion, speeds, accelerations)
        except SingularError as error:
            for i, k in enumerate(at.tolist()):
                try:
                    solve_rates(motion.mechanism, motion[i : i + 1], *(
                        {name: float(x[i]) for name, x in of.items()}
                        for of in (speeds, accelerations)))
                except SingularError as at_row:
                    raise SingularError(f"row {k}: {at_row}", state=at_row.state) from error
            raise


def function_input(mechanism: Mechanism, name: str) -> FunctionInput:
    """Return an input by its name: of a driver, or its joint, or a dimension.

    Raises:
        UnknownNameError: there is none.
    """
    own = {**{d.joint: n for n, d in mechanism.drivers.items()},
           **{n: n for n in mechanism.drivers}}
    if name in own:
        return FunctionInput(name, VALUE, own[name])
    stem, _, kind = name.rpartition(".")
    if name.startswith("effort."):
        stem, kind = name.removeprefix("effort."), EFFORT
    if stem in own and kind in (*RATES, ACCELERATION, EFFORT):
        return FunctionInput(name, RATE if kind in RATES else kind, own[stem])
    dimension = name.removeprefix("dimension.")  # where a driver has its name
    if dimension in mechanism.dimensions:
        return FunctionInput(name, DIMENSION, dimension)
    valid = [*own, *(f"{n}.{k}" for n in own for k in (*RATES, ACCELERATION)),
             *(f"effort.{n}" for n in own), *mechanism.dimensions]
    raise UnknownNameError("input", name, valid, f"mechanism {mechanism.name!r}: ")


def _as_motion(states: Sequence[State]) -> Motion:
    """Return states as samples of a motion, which has rates in time."""
    q, v, a, angles = (np.array([getattr(s, x) for s in states]) for x in (
        "q", "v", "a", "angles"))
    errors = np.array([s.closure_error for s in states])
    return Motion(states[0].mechanism, None, "", None, q, v, a, errors, np.ones(len(states)),
                  angles=angles)


def _unreached(row: int, reason: str) -> AssemblyError:
    """Return the error of a row that cannot be reached."""
    return AssemblyError(f"row {row}: {reason}", closure_error=np.inf, worst_closure="")
