"""Outputs of a mechanism as a differentiable function of motions, dimensions and efforts."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin._support.checks import as_array, checked, finite_array, names_of
from spatial_pin.assembly.assemble import starting_state
from spatial_pin.assembly.holding import fixed_base_entries
from spatial_pin.assembly.state import State
from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.dimensions.homotopy import followed
from spatial_pin.dimensions.variants import Variants
from spatial_pin.dynamics.forward import forward_dynamics
from spatial_pin.dynamics.kinetostatics import inverse_dynamics
from spatial_pin.errors import (
    AssemblyError,
    SingularError,
    SpatialPinError,
    UnknownNameError,
)
from spatial_pin.function.closed_derivatives import ClosedDerivatives, InputChanges, OpenedError
from spatial_pin.function.moved_geometry import MovedGeometry, moved_geometry
from spatial_pin.function.output_slopes import (
    EFFORT,
    MASS,
    ROTATION,
    Moved,
    function_output,
)
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.motion import Motion
from spatial_pin.motion.outputs import RATES
from spatial_pin.motion.scattered_states import states
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.rates.rates import prescribed_at, solve_rates

VALUE, RATE, ACCELERATION, DIMENSION = "value", "rate", "acceleration", "dimension"


class _Input(NamedTuple):
    """An input of a function: its quantity, and the name of the driver or dimension."""

    name: str
    kind: str
    of: str


class Function:
    """Outputs of a closed mechanism as a differentiable function; made by `function`.

    Read-only; it can be pickled, and used by several threads.

    Attributes:
        mechanism: the mechanism.
        inputs, outputs: the names that `function` was called with.
        labels: names of the k numbers of a row of values: `tip.position.x`.
        home: the State of the guess, from which every row is followed.

    Example:
        >>> mech = sp.load("rssr")
        >>> f = sp.function(mech, ["crank", "b"], ["rocker_pin"])
        >>> f([1.0, 0.381]).shape, f([[1.0, 0.381], [2.0, 0.381]]).shape  # (k,), (N, k)
        ((1,), (2, 1))
        >>> f.jacobian([1.0, mech.dimensions["b"]]).round(4)  # (k, m)
        array([[ 0.4261, -5.8005]])
    """

    def __init__(
        self, mechanism: Mechanism, inputs: Iterable[str], outputs: Iterable[str], guess: Any
    ) -> None:
        self.mechanism = mechanism
        self.inputs, self.outputs = (tuple(names_of(x, what)) for x, what in (
            (inputs, "inputs"), (outputs, "outputs")))
        self._inputs = [_input(mechanism, name) for name in self.inputs]
        self._outputs = [function_output(mechanism, name) for name in self.outputs]
        self._check()
        self.home = starting_state(mechanism, guess)
        own = [x.of for x in self._inputs if x.kind == VALUE]
        names = own or list(mechanism.drivers)
        self._driven = prescribed_at(self.home, names) if names else []
        tied = constraints_of(self.home.mechanism).tied
        loose = np.flatnonzero(~tied).tolist()
        self._still = sorted({*fixed_base_entries(mechanism, self._driven), *loose}
                             - {c.v for c in self._driven})
        self._dimensions = [x.of for x in self._inputs if x.kind == DIMENSION]
        self._variants = Variants(mechanism, self._dimensions) if self._dimensions else None
        self._at_home: MovedGeometry | None = None
        self._needs = {x.needs for x in self._outputs}
        self._has_efforts = any(x.kind == EFFORT for x in self._inputs)
        vectors = {1: ("",), 3: (".x", ".y", ".z"),
                   9: tuple(f".{i}{j}" for i in "xyz" for j in "xyz")}
        self.labels = tuple(x.name + end for x in self._outputs for end in vectors[x.size])

    def _check(self) -> None:
        """Refuse inputs that are named twice or contradict each other, and outputs without rates.

        Raises:
            ValueError: says which.
        """
        for what, names in (("inputs", [(x.kind, x.of) for x in self._inputs]),
                            ("outputs", [x.name for x in self._outputs])):
            if not names:
                raise ValueError(f"{what} is empty: a function needs at least one")
            for k, name in enumerate(names):
                if name in names[:k]:
                    given = (self.inputs if what == "inputs" else self.outputs)[k]
                    raise ValueError(f"{what}: {given!r} is named twice")
        kinds = {x.kind for x in self._inputs}
        if {EFFORT, ACCELERATION} <= kinds:
            raise ValueError("inputs: accelerations follow from efforts, or efforts from "
                             "accelerations: give one of the two")
        for x in self._outputs:
            if x.needs == EFFORT and EFFORT in kinds:
                raise ValueError(f"outputs: {x.name!r} is the effort of a given motion, but the "
                                 "inputs have efforts: give accelerations instead")
            if not x.order or RATE in kinds:
                continue
            if x.order == 1 or not kinds & {ACCELERATION, EFFORT}:
                driver = next(iter(self.mechanism.drivers), "driver")
                raise ValueError(f"outputs: {x.name!r} is a rate, but no input is a rate: add "
                                 f"'{driver}.rate' to the inputs")

    def __call__(self, x: Any) -> Array:
        """Return the outputs (N, k) at inputs x (N, m), or (k,) at (m,).

        Raises:
            AssemblyError: a row cannot be reached; says which.
            SingularError: rates of a row are not determined.
            ValueError: x is NaN or infinite, or has another shape.
        """
        return self._shaped(x, self._worked_out(self._rows(x), False)[0])

    def jacobian(self, x: Any) -> Array:
        """Return the derivatives (N, k, m) at inputs x (N, m), or (k, m) at (m,).

        Raises:
            AssemblyError: a row cannot be reached; says which.
            SingularError: rates of a row are not determined.
            SpatialPinError: an output depends on a freedom that the inputs do not determine, or an
                input alone opens a loop; says which.
            ValueError: x is NaN or infinite, or has another shape.

        Example:
            >>> f = sp.function(sp.load("four_bar"), ["crank", "r2"], ["rocker_pin"])
            >>> f.jacobian([1.0, 0.1]).round(4)  # (k, m)
            array([[ 0.1935, -4.4373]])
        """
        return self._shaped(x, self._worked_out(self._rows(x), True)[1])

    def value_and_jacobian(self, x: Any) -> tuple[Array, Array]:
        """Return the outputs and their derivatives; takes no longer than the derivatives alone.

        Raises:
            SpatialPinError, ValueError: as `jacobian`.

        Example:
            >>> f = sp.function(sp.load("four_bar"), ["crank", "r2"], ["rocker_pin"])
            >>> values, slopes = f.value_and_jacobian([[1.0, 0.1], [2.0, 0.1]])
            >>> values.shape, slopes.shape  # (N, k), (N, k, m)
            ((2, 1), (2, 1, 2))
        """
        values, slopes = self._worked_out(self._rows(x), True)
        return self._shaped(x, values), self._shaped(x, slopes)

    def vjp(self, x: Any, y: Any) -> Array:
        """Return y times the Jacobian: the gradient of a function of the outputs.

        Args:
            x: (N, m) inputs, or (m,).
            y: (N, k) weights of the outputs, or (k,).

        Returns:
            (N, m), or (m,).

        Raises:
            SpatialPinError: as `jacobian`.
            ValueError: x or y is NaN or infinite, or has another shape.

        Example:
            >>> f = sp.function(sp.load("four_bar"), ["crank", "r2"], ["rocker_pin"])
            >>> f.vjp([1.0, 0.1], [2.0]).round(4)  # (m,)
            array([ 0.387 , -8.8745])
        """
        rows = self._rows(x)
        weights = finite_array(y, (*np.shape(x)[:-1], len(self.labels)), "y")
        slopes = self._worked_out(rows, True)[1]
        return self._shaped(x, np.einsum(
            "nk,nkm->nm", weights.reshape(len(rows), -1), slopes))

    def jax(self) -> Callable[[Any], Any]:
        """Return the function for JAX: of arrays (..., m), float64, with values (..., k).

        `jit`, `vmap`, `grad`, `jvp`, `jacfwd` and `jacrev` work; second derivatives raise an error.

        Raises:
            SpatialPinError: JAX is not installed; in a call: x is not float64
                (`jax_enable_x64`).

        Example:
            >>> f = sp.function(sp.load("four_bar"), ["crank", "r2"], ["rocker_pin"])
            >>> g = f.jax()  # doctest: +SKIP
            >>> jax.grad(lambda x: g(x)[0])(jnp.array([1.0, 0.1]))  # doctest: +SKIP
        """
        from spatial_pin.function.frameworks import jax_function

        return jax_function(self)

    def torch(self) -> Callable[[Any], Any]:
        """Return the function for PyTorch: of tensors (..., m), float64, with values (..., k).

        Both modes and `torch.func` work; second derivatives raise an error.

        Raises:
            SpatialPinError: PyTorch is not installed; in a call: x is not float64.

        Example:
            >>> f = sp.function(sp.load("four_bar"), ["crank", "r2"], ["rocker_pin"])
            >>> g = f.torch()  # doctest: +SKIP
            >>> g(torch.tensor([1.0, 0.1], dtype=torch.float64))  # doctest: +SKIP
        """
        from spatial_pin.function.frameworks import torch_function

        return torch_function(self)

    def __reduce__(self) -> tuple[Any, ...]:
        return Function, (self.mechanism, self.inputs, self.outputs, self.home)

    def __repr__(self) -> str:
        return (f"Function({self.mechanism.name!r}, {len(self.inputs)} inputs, "
                f"{len(self.labels)} numbers of {len(self.outputs)} outputs)")

    # ------------------------------------------------------------ rows

    def _rows(self, x: Any) -> Array:
        """Return inputs as rows (N, m)."""
        array, m = as_array(x, "x"), len(self.inputs)
        if array.ndim not in (1, 2) or array.shape[-1] != m:
            raise ValueError(f"x has shape {array.shape}; (N, {m}), or ({m},) for one row, is "
                             f"needed: {', '.join(self.inputs)}")
        return finite_array(array, array.shape, "x").reshape(-1, m)

    def _shaped(self, x: Any, rows: Array) -> Array:
        return rows if np.ndim(x) == 2 else rows[0]

    def _column(self, kind: str) -> list[tuple[int, str]]:
        return [(k, x.of) for k, x in enumerate(self._inputs) if x.kind == kind]

    def _worked_out(self, rows: Array, with_slopes: bool) -> tuple[Array, Array]:
        """Return values (N, k), and derivatives (N, k, m), empty if not wanted."""
        values = np.empty((len(rows), len(self.labels)))
        slopes = np.empty((len(rows), len(self.labels), len(self.inputs) if with_slopes else 0))
        given = self._given() if with_slopes else None
        for at, mechanism, home in self._by_dimensions(rows):
            geometry = self._geometry(mechanism) if with_slopes else None
            motion = self._moving(self._closed(mechanism, home, rows, at), rows, at)
            each = list(map(motion.state, range(len(motion)))) if (
                with_slopes or self._has_efforts) else []
            loads = [self._loads(state, rows[k]) for k, state in zip(at, each, strict=False)]
            if self._has_efforts:
                each = [load.state for load in loads]
                motion = _as_motion(each)
            values[at] = self._values(motion, loads)
            if geometry is not None and given is not None:
                for k, state, load in zip(at.tolist(), each, loads, strict=True):
                    slopes[k] = self._slopes(k, geometry, given, state, load, values[k])
        return values, slopes

    def _by_dimensions(
        self, rows: Array
    ) -> Iterator[tuple[NDArray[np.intp], Mechanism, State | None]]:
        """Yield row numbers with the same dimensions, their mechanism and its first State.

        The State is None if the drivers cannot have the values of the guess at these dimensions.
        """
        columns = [k for k, _ in self._column(DIMENSION)]
        every, group = np.unique(rows[:, columns], axis=0, return_inverse=True)
        own = [self.mechanism.dimensions[name] for name in self._dimensions]
        for k, x in enumerate(every.tolist()):
            at = np.flatnonzero(group.reshape(-1) == k)
            if x == own:
                yield at, self.home.mechanism, self.home
                continue
            try:
                assert self._variants is not None
                mechanism = self._variants.at(
                    dict(zip(self._dimensions, x, strict=True)),
                    self._with_masses and not self._variants.has_masses)
            except SpatialPinError as error:
                raise _unreached(int(at[0]), str(error)) from error
            try:
                yield at, mechanism, followed(mechanism, self._standing, self.home)
            except SpatialPinError:
                yield at, mechanism, None

    @property
    def _with_masses(self) -> bool:
        return bool(self._needs & {EFFORT, MASS}) or self._has_efforts

    @property
    def _standing(self) -> dict[str, float]:
        """The drivers' values at the first State."""
        return {c.name: self.home.coordinate(c.name).value for c in self._driven if c.q >= 0}

    def _closed(
        self, mechanism: Mechanism, home: State | None, rows: Array, at: NDArray[np.intp]
    ) -> Motion:
        """Return the closed states of rows with the same dimensions, at rest.

        The dimensions change first, then the drivers; if that fails, the drivers first.
        """
        values = {self.mechanism.coordinate(name).name: rows[at, column]
                  for column, name in self._column(VALUE)}
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
            {name: rows[at, column] for column, name in self._column(kind)}
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

    def _loads(self, state: State, row: Array) -> Any:
        """Return the forward or inverse dynamics of a state; None if they are not needed."""
        if self._has_efforts:
            efforts = {name: float(row[column]) for column, name in self._column(EFFORT)}
            return forward_dynamics(state.mechanism, state, efforts)
        return inverse_dynamics(state.mechanism, state) if EFFORT in self._needs else None

    def _values(self, motion: Motion, loads: Sequence[Any]) -> Array:
        """Return the outputs (n, k) of states of one mechanism."""
        columns, efforts = list[Array](), dict[str, Array]()
        if EFFORT in self._needs:
            whole = None if loads else inverse_dynamics(motion.mechanism, motion).efforts
            efforts = {n: np.asarray(whole[n] if whole else [load.efforts[n] for load in loads])
                       for n in self.mechanism.drivers}
        for x in self._outputs:
            if x.needs == EFFORT:
                name = _driver(self.mechanism, x.name.removesuffix(f".{EFFORT}"))
                columns.append(efforts[name])
            elif x.name.endswith(f".{ROTATION}"):
                columns.append(motion.frame(x.name.removesuffix(f".{ROTATION}")).rotation)
            elif x.follows:  # each by itself
                columns.append(np.array([motion[k : k + 1].output(x.name).values[0]
                                         for k in range(len(motion))]))
            else:
                columns.append(motion.output(x.name).values)
        return np.hstack([x.reshape(len(motion), -1) for x in columns])

    # ------------------------------------------------------------ derivatives

    def _geometry(self, mechanism: Mechanism) -> MovedGeometry:
        if mechanism is not self.home.mechanism:
            return moved_geometry(mechanism, self._variants, self._with_masses)
        if self._at_home is None:
            self._at_home = moved_geometry(mechanism, self._variants, self._with_masses)
        return self._at_home

    def _given(self) -> InputChanges:
        """Return the derivatives of the given quantities by each input."""
        m, numbers = len(self._inputs), [c.name for c in self._driven]
        values, rates, accelerations = np.zeros((3, len(numbers), m))
        given = InputChanges(
            values, rates, accelerations, np.zeros((self.mechanism.model.nv, m)),
            np.zeros((len(self._dimensions), m)))
        for k, x in enumerate(self._inputs):
            if x.kind == DIMENSION:
                given.dimensions[self._dimensions.index(x.of), k] = 1.0
                continue
            c = self.mechanism.coordinate(x.of)
            if x.kind == EFFORT:
                given.efforts[c.v, k] = 1.0
            else:
                table = {VALUE: given.values, RATE: given.rates,
                         ACCELERATION: given.accelerations}[x.kind]
                table[numbers.index(c.name), k] = 1.0
        return given

    def _slopes(
        self, row: int, geometry: MovedGeometry, given: InputChanges, state: State, load: Any,
        values: Array,
    ) -> Array:
        """Return the derivatives (k, m) of a row."""
        m = len(self._inputs)
        at = ClosedDerivatives(geometry, state, self._driven, self._still)
        try:
            changes = at.changes(given)
            efforts: Array = np.zeros((0, changes.q.shape[1]))
            if load is not None:
                a, borne = at.forced(given, changes, load.a, load.multipliers,
                                     not self._has_efforts)
                if self._has_efforts:
                    changes.a[geometry.v] = a
                else:
                    efforts = borne[[self._driven.index(self.mechanism.coordinate(name))
                                     for name in self.mechanism.drivers]]
        except OpenedError as error:
            raise self._opened(row, error.column, state) from error
        columns = changes.q.shape[1] - m  # of freedoms that nothing determines
        wide = np.hstack([given.dimensions, np.zeros((len(self._dimensions), columns))])
        moved = Moved(at, changes, wide, efforts)
        every: Array = np.vstack([x.slope(moved) for x in self._outputs])
        size = self.mechanism.characteristic_length + np.abs(values) + np.abs(
            every[:, :m]).max(axis=1, initial=0.0)
        loose = np.abs(every[:, m:]).max(axis=1, initial=0.0) > TOLERANCES.half_precision * size
        if loose.any():
            raise SpatialPinError(
                f"row {row}: mechanism {self.mechanism.name!r}: {self.labels[loose.argmax()]!r} "
                "depends on a freedom that the drivers do not determine, such as an idle rotation: "
                "it has no derivatives; choose another output, or drive that freedom")
        return every[:, :m]

    def _opened(self, row: int, column: int, state: State) -> SpatialPinError:
        """Return the error for an input that would open a loop if changed alone."""
        x = self._inputs[min(column, len(self._inputs) - 1)]
        where = f"row {row}: mechanism {self.mechanism.name!r}: "
        if x.kind == DIMENSION:
            return SpatialPinError(
                f"{where}the loops open where {x.name!r} alone is changed (they are "
                "overconstrained), so that there is no derivative; choose a dimension that keeps "
                "them closed")
        return SingularError(
            f"{where}{x.name!r} does not determine the motion there (a dead centre, or drivers "
            "that depend on each other), so that there is no derivative", state=state)


def _input(mechanism: Mechanism, name: str) -> _Input:
    """Return an input by its name: of a driver, or its joint, or a dimension.

    Raises:
        UnknownNameError: there is none.
    """
    own = {**{d.joint: n for n, d in mechanism.drivers.items()},
           **{n: n for n in mechanism.drivers}}
    if name in own:
        return _Input(name, VALUE, own[name])
    stem, _, kind = name.rpartition(".")
    if name.startswith("effort."):
        stem, kind = name.removeprefix("effort."), EFFORT
    if stem in own and kind in (*RATES, ACCELERATION, EFFORT):
        return _Input(name, RATE if kind in RATES else kind, own[stem])
    dimension = name.removeprefix("dimension.")  # where a driver has its name
    if dimension in mechanism.dimensions:
        return _Input(name, DIMENSION, dimension)
    valid = [*own, *(f"{n}.{k}" for n in own for k in (*RATES, ACCELERATION)),
             *(f"effort.{n}" for n in own), *mechanism.dimensions]
    raise UnknownNameError("input", name, valid, f"mechanism {mechanism.name!r}: ")


def _driver(mechanism: Mechanism, name: str) -> str:
    return name if name in mechanism.drivers else next(
        n for n, d in mechanism.drivers.items() if d.joint == name)


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


@checked
def function(
    mechanism: Mechanism, inputs: Iterable[str], outputs: Iterable[str],
    guess: Mapping[str, Any] | State | Array | None = None,
) -> Function:
    """Return outputs of a mechanism as a differentiable function of its inputs.

    `f(x)` closes the loops for each row of inputs, on the branch of the guess. From there the
    dimensions change along a straight line, then the drivers, as in `states`. No result depends on
    earlier calls. `f.jacobian(x)` has the exact derivatives with the loops closed, by implicit
    differentiation. `f.vjp(x, y)` is y times the Jacobian.

    Args:
        mechanism: the mechanism.
        inputs: of a driver its value `crank` [rad, m], `crank.rate` (or `.velocity`) and
            `crank.acceleration`; dimensions, as `sensitivity` names them (`dimension.boom` if a
            driver has the same name); efforts `effort.crank` [N·m, N], from which accelerations
            follow. Drivers that are not named keep their values from the guess; rates that are not
            named are zero.
        outputs: as `Motion.output` names coordinates, angles of links, and positions, velocities
            and accelerations of frames and centres of mass; `FRAME.rotation`, its nine numbers row
            by row; `effort.crank` (or `crank.effort`), the effort that the motion needs.
        guess: the first configuration, as for `assemble`.

    Returns:
        The Function.

    Raises:
        AssemblyError: the guess does not close.
        UnknownNameError: there is no such input or output.
        ValueError: an input is named twice, inputs contradict each other, or rates are wanted
            without a rate among the inputs.

    Example:
        >>> mech = sp.load("four_bar")
        >>> f = sp.function(mech, ["crank", "crank.rate", "r2"], ["rocker_pin", "effort.crank"])
        >>> x = [[1.0, 10.0, mech.dimensions["r2"]]]
        >>> f(x).round(4)  # (N, k): [rad], [N·m]
        array([[1.6255, 0.9714]])
        >>> f.jacobian(x).shape  # (N, k, m)
        (1, 2, 3)
    """
    return Function(mechanism, inputs, outputs, guess)
