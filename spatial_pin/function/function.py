"""Outputs of a mechanism as a differentiable function of motions, dimensions and efforts."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spatial_pin._support.checks import as_array, checked, finite_array, names_of
from spatial_pin.assembly.link_angle import link_angle
from spatial_pin.assembly.state import State, center_of_mass
from spatial_pin.dimensions.changed_state import Load, output_changes
from spatial_pin.dimensions.closed_derivatives import (
    ClosedDerivatives,
    InputChanges,
    OpenedError,
)
from spatial_pin.dimensions.moved_geometry import MovedGeometry, moved_geometry
from spatial_pin.dynamics.coupling_forces import coupling_forces
from spatial_pin.dynamics.force_outputs import rule_of
from spatial_pin.dynamics.forward import forward_dynamics
from spatial_pin.dynamics.kinetostatics import Kinetostatics, inverse_dynamics
from spatial_pin.dynamics.reactions import Pairs
from spatial_pin.errors import SingularError, SpatialPinError, UnknownNameError
from spatial_pin.function.closed_rows import (
    ACCELERATION,
    DIMENSION,
    RATE,
    ClosedRows,
    function_input,
)
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.motion import Motion
from spatial_pin.motion.outputs import EFFORT, NamedOutput, named_output, output_names
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES


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
        self._inputs = [function_input(mechanism, name) for name in self.inputs]
        self._outputs = [_output(mechanism, name) for name in self.outputs]
        self._check()
        self._closed = ClosedRows(mechanism, self._inputs, guess)
        self.home = self._closed.home
        self._at_home: MovedGeometry | None = None
        self._needs = {rule_of(x).needs for x in self._outputs}
        self._has_efforts = any(x.kind == EFFORT for x in self._inputs)
        ends = tuple(f".{x}" for x in "xyz")
        vectors = {1: ("",), 3: ends, 9: tuple(f".{i}{j}" for i in "xyz" for j in "xyz"),
                   6: tuple(f".{x}{end}" for x in ("force", "moment") for end in ends)}
        self.labels = tuple(x.spec + end for x in self._outputs for end in vectors[
            1 if x.component is not None else rule_of(x).size])

    def _check(self) -> None:
        """Refuse inputs that are named twice or contradict each other, and outputs without rates.

        Raises:
            ValueError: says which.
        """
        inputs, outputs = ([x[1:] for x in some] for some in (self._inputs, self._outputs))
        for what, names in (("inputs", inputs), ("outputs", outputs)):
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
            order = rule_of(x).order
            if x.kind == EFFORT and EFFORT in kinds:
                raise ValueError(f"outputs: {x.spec!r} is the effort of a given motion, but the "
                                 "inputs have efforts: give accelerations instead")
            if not order or RATE in kinds:
                continue
            if order == 1 or not kinds & {ACCELERATION, EFFORT}:
                driver = next(iter(self.mechanism.drivers), "driver")
                raise ValueError(f"outputs: {x.spec!r} is a rate, but no input is a rate: add "
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
            SingularError: rates of a row are not determined, or its derivatives have no digit.
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
            "nk,nkm->nm", weights.reshape(len(rows), len(self.labels)), slopes))

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

    def _worked_out(self, rows: Array, with_slopes: bool) -> tuple[Array, Array]:
        """Return values (N, k), and derivatives (N, k, m), empty if not wanted."""
        values = np.empty((len(rows), len(self.labels)))
        slopes = np.empty((len(rows), len(self.labels), len(self.inputs) if with_slopes else 0))
        given = self._closed.changes()
        for at, motion in self._closed.motions(rows, self._with_masses):
            geometry = self._geometry(motion.mechanism) if with_slopes else None
            motion, loads = self._loaded(motion, rows, at)
            values[at] = self._values(motion, loads)
            for i, k in enumerate(at.tolist()):
                if geometry is None:
                    break
                load = None if loads is None else Load.of_sample(loads, i, not self._has_efforts)
                slopes[k] = self._slopes(k, geometry, given, motion.state(i), load, values[k])
        return values, slopes

    @property
    def _with_masses(self) -> bool:
        return bool(self._needs & {"forces", "masses"}) or self._has_efforts

    def _loaded(
        self, motion: Motion, rows: Array, at: NDArray[np.intp]
    ) -> tuple[Motion, Kinetostatics | None]:
        """Return the states with accelerations that efforts give, and the forces if needed."""
        if self._has_efforts:
            efforts = dict.fromkeys(self.mechanism.drivers, np.zeros(len(at))) | {
                name: rows[at, column] for column, name in self._closed.columns(EFFORT)}
            loads = forward_dynamics(motion.mechanism, motion, efforts)
            return replace(motion, a=loads.a), loads
        return motion, (
            inverse_dynamics(motion.mechanism, motion) if "forces" in self._needs else None)

    def _values(self, motion: Motion, loads: Kinetostatics | None) -> Array:
        """Return the outputs (n, k) of states of one mechanism."""
        columns = []
        for x in self._outputs:
            samples = loads if x.family == "force" else motion
            is_angle, is_coordinate = x.family == "angle", x.family == "coordinate"
            angle = link_angle(self.mechanism, x.spec) if is_angle else None
            if (is_coordinate and self.mechanism.coordinate(x.of).q < 0) or (
                    angle is not None and angle.sums is None):  # each by itself: it is continued
                parts = [x.values(motion[k : k + 1]) for k in range(len(motion))]
                columns.append(np.concatenate([np.empty(0), *parts]))
            else:
                columns.append(x.values(samples, rule_of(x)))
        return np.hstack([x.reshape(len(motion), -1) for x in columns])

    # ------------------------------------------------------------ derivatives

    def _geometry(self, mechanism: Mechanism) -> MovedGeometry:
        if mechanism is not self.home.mechanism:
            return moved_geometry(mechanism, self._closed.variants, self._with_masses)
        if self._at_home is None:
            self._at_home = moved_geometry(mechanism, self._closed.variants, self._with_masses)
        return self._at_home

    def _slopes(
        self, row: int, geometry: MovedGeometry, given: InputChanges, state: State,
        load: Load | None, values: Array,
    ) -> Array:
        """Return the derivatives (k, m) of a row."""
        m = len(self._inputs)
        try:
            at = ClosedDerivatives(geometry, state, self._closed.driven, self._closed.still)
            every = np.vstack(output_changes(at, given, load, self._outputs))
        except OpenedError as error:
            raise self._opened(row, error.column, state) from error
        except SingularError as error:
            raise SingularError(f"row {row}: {error}", state=state) from error
        if np.isnan(every).any():
            label = self.labels[int(np.isnan(every).any(axis=1).argmax())]
            raise SpatialPinError(
                f"row {row}: mechanism {self.mechanism.name!r}: {label!r} is one of many, the "
                "least: it has no derivatives; choose an output that is unique")
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


def _output(mechanism: Mechanism, name: str) -> NamedOutput:
    """Return an output by its name.

    Raises:
        UnknownNameError: there is none, or it has no derivatives.
    """
    x = named_output(mechanism, name)
    if x is not None and rule_of(x).needs != "motion" and x.kind not in ("ratio", "advantage"):
        if x.family == "point":
            mechanism.frame_id(mechanism.placed(x.of.removesuffix(".com")))
        if x.of.endswith(".com"):
            center_of_mass(mechanism, x.of.removesuffix(".com"))
        if x.family != "force" or x.of in _loaded_names(mechanism, x.kind):
            return x
    valid = [name for name in (*output_names(mechanism), *(
        f"{n}.{kind}" for kind in (EFFORT, "power", "reaction")
        for n in _loaded_names(mechanism, kind) if n))
        if not name.endswith((".jerk", ".ratio", ".advantage", ".transmission_angle"))]
    raise UnknownNameError("differentiable output", name, valid,
                           f"mechanism {mechanism.name!r}: ")


def _loaded_names(mechanism: Mechanism, kind: str) -> list[str]:
    """Return what has a force of a kind: drivers and their joints, or pairs and couplings."""
    if kind in (EFFORT, "power"):
        return [name for n, d in mechanism.drivers.items() for name in (n, d.joint)]
    return ["", *Pairs(mechanism).names, *(c.name for c in coupling_forces(mechanism))]


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
            by row; forces as `Kinetostatics.output` names them: `effort.crank` (or `crank.effort`),
            the effort that the motion needs, `crank.power`, `PAIR.reaction.force.x`, ...,
            `on_ground.moment`.
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
