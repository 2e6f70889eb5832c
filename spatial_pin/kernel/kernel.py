"""The kernel of a mechanism: its tree and equations as two flat arrays, and as Python calls it.

The order of the arrays is that of `read_structure` and `read_numbers` in `model.c`. Joints of
several freedoms are split into single ones; the frame of each joint is turned so that its axis is
its local z axis.
"""

from __future__ import annotations

import ctypes
import weakref
from collections.abc import Mapping, Sequence
from itertools import accumulate, pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin._support.lazy import made_anew, made_once
from spatial_pin.constraints.compiled_equations import Constraints, constraints_of
from spatial_pin.constraints.composed_equations import CompiledTerm, Equation, QuantityIndex
from spatial_pin.constraints.composite_joints import TreeArrays, split_of
from spatial_pin.constraints.workspaces import acquired
from spatial_pin.kernel.library import (
    BAD_ARRAYS,
    DONE,
    INT,
    POINTER,
    UNSAFE,
    address,
    check,
    library,
)
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.piecewise import ROOT, CalledFunction, SquareRoot

Ints = NDArray[np.int64]
PRODUCT, SUM, IDLE = range(3)  # kinds of equations, see `kernel.h`
QUANTITIES = ("product", "coordinate", "angle")  # kinds, in the order of `kernel.h`


class Parts(NamedTuple):
    """Numbers of a kernel: of its n joints, and of the vectors fixed in their bodies.

    Attributes:
        rotation: (n, 3, 3) of the placement in the parent, by columns; translation: (n, 3).
        mass: (n,); com: (n, 3); inertia: (n, 3, 3) about the centre of mass.
        gravity: (3,).
        local: (n_vectors, 3) in the axes of the joint that carries the vector.
    """

    rotation: Array
    translation: Array
    mass: Array
    com: Array
    inertia: Array
    gravity: Array
    local: Array


class Packed(NamedTuple):
    """The flat arrays of a kernel.

    Attributes:
        ints: structure: joints, vectors, products, equations.
        reals: placements, inertias, vectors, factors.
        frames: (n, 3, 3) rotations from the axes of the split model's joints to the kernel's:
            Pinocchio's joint rotation is the kernel's times the transpose.
        carriers: (njoints,) joint of the kernel that carries the body of each joint of the model.
        fixed_in: (n_vectors,) what each vector is fixed in: `frame` of its `Term`.
        is_point: (n_vectors,) whether it leads to a point, or is a direction.
        called: functions in code, by their number among those of the equations.
    """

    ints: Ints
    reals: Array
    frames: Array
    carriers: NDArray[np.intp]
    fixed_in: Ints
    is_point: NDArray[np.bool_]
    called: Mapping[int, CalledFunction]

    def parts(self) -> Parts:
        """Return views of the numbers, one kind after the other."""
        n, _, nv, vectors = self.ints[:4].tolist()
        ends = [*accumulate((0, 9 * n, 3 * n, n, n, 3 * n, 9 * n, 3, nv, 3 * vectors))]
        rotation, translation, _, mass, com, inertia, gravity, _, local = (
            self.reals[first:end] for first, end in pairwise(ends))
        return Parts(rotation.reshape(n, 3, 3), translation.reshape(n, 3), mass,
                     com.reshape(n, 3), inertia.reshape(n, 3, 3), gravity, local.reshape(-1, 3))

    def indices(self) -> Parts:
        """Return the indices of the numbers, kind after kind."""
        numbers: Any = np.arange(len(self.reals))
        return self._replace(reals=numbers).parts()


@made_once
def packed(mechanism: Mechanism, idle: bool) -> Packed:
    """Return the arrays of a mechanism, made once.

    Args:
        mechanism: the mechanism.
        idle: whether the equations of idle rotations belong to it; forces know none.
    """
    constraints = constraints_of(mechanism)
    model, carriers = split_of(mechanism)
    tree = TreeArrays(model)
    vectors = _VectorTable(constraints, tree.frames, carriers)
    moved, freedoms = np.nonzero(constraints.signs)  # product and freedom of each of their supports
    supports = np.searchsorted(moved, np.arange(len(constraints.constants) + 1))
    n_idle = constraints.n_passive if idle else 0
    n = constraints.n_closure + n_idle
    sums = _Sums(constraints.equations[:n])
    patterns = [np.flatnonzero(row) for row in constraints.occurring[:n]]
    kinds = [SUM if e.terms else PRODUCT for e in constraints.equations[: constraints.n_closure]]
    product = [-1 if e.terms else e.products[0] for e in constraints.equations[:n]]
    starts = np.cumsum([0] + [len(p) for p in patterns])
    turning = [np.where(turns.are_all, turns.row, 0.0) for turns in constraints.turns]
    turned = [np.flatnonzero(row) for row in turning]  # entries of q that count each angle's turns
    head = [model.njoints, model.nq, model.nv, len(vectors.body), len(constraints.constants),
            constraints.n_closure, n_idle, constraints.n_angles,
            len(freedoms), starts[-1], sum(map(len, turned)), len(sums.numbers),
            len(sums.kinds), len(sums.shapes), len(sums.implicit), sums.n_defining]
    directions = [x for e in constraints.equations for x in e.sines_and_cosines]
    return Packed(
        _joined(np.int64, head, tree.kind, tree.parent, tree.iq, tree.iv, vectors.body,
                vectors.flag, *vectors.numbers, supports, freedoms, kinds, [IDLE] * n_idle, product,
                directions, sums.implicit, sums.terms, sums.factors, sums.kinds, sums.indices,
                sums.function, sums.shapes, starts, *patterns,
                np.cumsum([0, *map(len, turned)]), *turned),
        _joined(float, tree.rotation, tree.translation, tree.pitch, tree.mass, tree.com,
                tree.inertia, model.gravity.linear, mechanism.velocity_scale, vectors.local,
                *vectors.factors, constraints.constants, constraints.factors,
                constraints.signs[moved, freedoms], [turns.offset for turns in constraints.turns],
                *(row[at] for row, at in zip(turning, turned, strict=True)), sums.spans,
                sums.numbers,
                *sums.functions),
        tree.frames, carriers, np.array(vectors.fixed_in, np.int64),
        np.array(vectors.flag, bool), sums.called)


class FrameInKernel(NamedTuple):
    """A frame fixed in a body of the kernel.

    Attributes:
        joint: of the kernel, that carries it.
        axes: (9,) its rotation in the joint's axes, by columns.
        origin: (3,) its origin there [m].
    """

    joint: int
    axes: list[float]
    origin: list[float]


@made_once
def frame_in_kernel(mechanism: Mechanism, frame: int) -> FrameInKernel:
    """Return a frame of the model as one of a body of the kernel."""
    own, arrays = mechanism.centred_model.frames[frame], packed(mechanism, True)
    joint = int(arrays.carriers[own.parentJoint])
    turned = arrays.frames[joint].T
    return FrameInKernel(joint, (turned @ own.placement.rotation).T.ravel().tolist(),
                     (turned @ own.placement.translation).tolist())


def with_masses(mechanism: Mechanism) -> Packed:
    """Return the arrays of a mechanism, no idle rotations, with the masses it has now.

    They are those of the last call where masses and gravity are: these are seldom changed.
    """
    model = mechanism.model
    masses = np.array([body.toDynamicParameters() for body in model.inertias]).tobytes()
    return _with_masses(mechanism, masses + model.gravity.linear.tobytes())


@made_anew
def _with_masses(mechanism: Mechanism, masses: bytes) -> Packed:
    model, arrays = mechanism.model, packed(mechanism, False)
    arrays = arrays._replace(reals=arrays.reals.copy())
    _, _, mass, com, inertia, gravity, _ = arrays.parts()
    for joint, body in enumerate(model.inertias):
        if joint:
            i = arrays.carriers[joint]
            own = arrays.frames[i]
            mass[i], com[i], inertia[i] = body.mass, own.T @ body.lever, own.T @ body.inertia @ own
    gravity[:] = model.gravity.linear
    return arrays


def _joined(kind: type, *parts: Any) -> Any:
    return np.concatenate([np.asarray(p, kind).ravel() for p in parts])


class _VectorTable:
    """Vectors fixed in bodies, those of a frame once: at other dimensions frames move apart.

    Attributes:
        fixed_in, body, flag, local: of each vector, see `Packed` and `kernel.h`.
        numbers, factors: of the vectors A, B and X of all products.
    """

    def __init__(
        self, constraints: Constraints, frames: Array, carriers: NDArray[np.intp]
    ) -> None:
        self.fixed_in: list[int] = []
        self.body: list[int] = []
        self.flag: list[int] = []
        self.local: list[Array] = []
        self.numbers: list[Ints] = []
        self.factors: list[Array] = []
        known: dict[tuple[int, bytes, float], int] = {}
        for vectors, width in zip(constraints.terms, (2, 2, 1), strict=True):
            number = np.full((len(vectors), width), -1, np.int64)
            factors = np.zeros((len(vectors), width))
            for i, terms in enumerate(vectors):
                for k, (factor, joint, local, flag, frame) in enumerate(terms):
                    key = frame, np.asarray(local, float).tobytes(), flag
                    if key not in known:
                        known[key] = len(self.body)
                        self.fixed_in.append(frame)
                        self.body.append(int(carriers[joint]))
                        self.flag.append(int(flag))
                        self.local.append(frames[self.body[-1]].T @ local)
                    number[i, k], factors[i, k] = known[key], factor
            self.numbers.append(number)
            self.factors.append(factors)


class _Sums:
    """Arrays of equations that are sums of terms, see `kernel.h`.

    Attributes:
        terms, factors: where the terms of an equation and the quantities of a term begin.
        numbers: of terms.
        kinds, places, function: of quantities; the number of their function, or -1.
        shapes, functions: of functions; numbers of those that are piecewise polynomials.
        called: functions in code, by their number among all.
        implicit, spans: of angles that sums define; these sums follow the equations.
        n_defining: their number.
    """

    def __init__(self, equations: Sequence[Equation]) -> None:
        self.terms, self.factors = [0], [0]
        self.numbers: list[float] = []
        self.kinds: list[int] = []
        self.indices: list[tuple[int, int]] = []
        self.function: list[int] = []
        self.shapes: list[tuple[int, ...]] = []
        self.functions: list[Array] = []
        self.called: dict[int, CalledFunction] = {}
        self.implicit: list[tuple[int, ...]] = []
        self.spans: list[tuple[float, ...]] = []
        self._known: dict[int, int] = {}
        for equation in equations:
            self._add_sum(equation, equation.terms)
        for equation in equations:
            for x in equation.implicit:
                which = sum(periodic << k for k, periodic in enumerate(x.is_periodic))
                self.implicit.append((equation.angles[x.first][0], len(x.spans),
                                      len(self.terms) - 1, which))
                self.spans.append((*x.spans[0], *x.spans[-1]))
                for terms in x.sums:
                    self._add_sum(equation, terms)
        self.n_defining = len(self.terms) - 1 - len(equations)

    def _add_sum(self, equation: Equation, terms: Sequence[CompiledTerm]) -> None:
        for number, factors in terms:
            self.numbers.append(number)
            for factor in factors:
                self._add(equation, factor)
            self.factors.append(len(self.kinds))
        self.terms.append(len(self.numbers))

    def _add(self, equation: Equation, factor: QuantityIndex) -> None:
        """Add a quantity, and the function of it if there is one."""
        if factor.kind == "coordinate":
            coordinate = equation.coordinates[factor.at]
            entry = coordinate.q, coordinate.v
        else:
            entry = (equation.angles[factor.at][0] if factor.kind == "angle"
                     else equation.products[factor.at]), 0
        self.kinds.append(QUANTITIES.index(factor.kind))
        self.indices.append(entry)
        f = factor.function
        if f is not None and id(f) in self._known:
            self.function.append(self._known[id(f)])
            return
        self.function.append(-1 if f is None else len(self.shapes))
        if f is not None:
            self._known[id(f)] = len(self.shapes)
        if isinstance(f, SquareRoot | CalledFunction):  # see `piecewise.h`
            if isinstance(f, CalledFunction):
                self.called[len(self.shapes)] = f
            self.shapes.append((sum(map(len, self.functions)), 0, int(f is not ROOT), 0))
        elif f is not None:
            pieces, width = f.coefficients.shape
            first = sum(map(len, self.functions))
            self.shapes.append((first, pieces, width - 1, int(f.is_periodic)))
            self.functions.append(np.concatenate([f.breaks, f.coefficients.ravel(), [f.rise]]))


def numbers(array: Array, shape: tuple[int, ...]) -> Array:
    """Return an array as contiguous doubles of a shape, as C reads it; copied if it is read-only.

    The address of a read-only array takes several times as long to ask for as a small copy.
    """
    out = np.ascontiguousarray(array, float)
    out = out if out.flags.writeable else out.copy()
    if out.shape != shape:
        raise ValueError(f"an array of shape {out.shape} stands where {shape} is needed")
    return out


class EvaluationStruct(ctypes.Structure):
    """Evaluation in kernel.h: configurations, and the storage of the results."""

    _fields_ = [
        ("m", INT), ("q", POINTER), ("v", POINTER), ("reference", POINTER), ("base", POINTER),
        ("n_reals", INT), ("n_varied", INT), *((name, POINTER) for name in (
            "varied_index", "varied", "R", "p", "residual", "angle", "jacobian", "linear",
            "angular", "bias"))]


class Kernel:
    """A mechanism in the compiled kernel; one caller at a time.

    Args:
        mechanism: the mechanism.
        arrays: what it is made of, if that is not the whole mechanism.

    Attributes:
        constraints: its equations.
        handle: of the C structure.
        library: the compiled functions.
        packed: what it was made of.
        solvers: what works in its memory, made once.
        path: which path it follows.
    """

    def __init__(self, mechanism: Mechanism, arrays: Packed | None = None) -> None:
        self.constraints = c = constraints_of(mechanism)
        self.mechanism = mechanism
        self.packed: Packed = arrays or packed(mechanism, True)
        self.nq, self.nv = mechanism.model.nq, mechanism.model.nv
        self.n_closure, self.n_passive, self.n_angles = c.n_closure, c.n_passive, c.n_angles
        self.library = library()
        handle = ctypes.c_void_p()
        ints, reals = self.packed.ints, self.packed.reals
        called = np.zeros(max(self.packed.called, default=-1) + 1, np.intp)
        for number, function in self.packed.called.items():
            called[number] = function.address
        check(self.library.kernel_create(
            address(ints), len(ints), address(reals), len(reals), address(called), len(called),
            ctypes.byref(handle)))
        self.handle = handle
        self.solvers: dict[Any, Any] = {}
        self.path: object = None
        weakref.finalize(self, self.library.kernel_destroy, handle)
        self._q, self._angles = np.empty(self.nq), np.empty(self.n_angles)
        self._taken = address(self._q), address(self._angles)

    def copied_addresses(self, q: Array, angles: Array) -> tuple[int, int]:
        """Return the addresses of copies of q (nq,) and of angles of screws (n_angles,), for C."""
        self._q[:], self._angles[:] = q, angles
        return self._taken

    def placements(self, q: Array) -> Array:
        """Return the joint placements (m, njoints, 4, 3) at q (m, nq): columns of R, then p."""
        m, n, carriers = len(q), len(self.packed.frames), self.packed.carriers
        rotations, translations = np.empty((m, n, 3, 3)), np.empty((m, n, 1, 3))
        self._evaluate(q, R=rotations, p=translations)
        columns = self.packed.frames[carriers] @ rotations[:, carriers]  # turned to z, and back
        return np.concatenate([columns, translations[:, carriers]], axis=2)

    def jacobians(self, q: Array) -> Array:
        """Return (m, n_closure + n_passive, nv) at q (m, nq), by v / `velocity_scale`."""
        return self.jacobians_and_columns(q, np.zeros((len(q), self.n_angles)))[0]

    def jacobians_and_columns(self, q: Array, reference: Array) -> tuple[Array, Array]:
        """Return `jacobians`, and the joint Jacobian (m, nv, 6) about the world's origin.

        Args:
            q: (m, nq) configurations.
            reference: (m, n_angles) from which the angles of screws count [rad].
        """
        n = self.n_closure + self.n_passive
        jacobian = np.empty((len(q), n + self.n_angles, self.nv))
        linear, angular = np.empty((2, len(q), self.nv, 3))
        self._evaluate(q, reference, jacobian=jacobian, linear=linear, angular=angular)
        return jacobian[:, :n], np.concatenate([linear, angular], axis=2)

    def errors(self, q: Array, reference: Array) -> Array:
        """Return the largest absolute closure equations (m,) at q (m, nq)."""
        residual = np.empty((len(q), self.n_closure))
        self._evaluate(q, reference, residual=residual)
        return np.abs(residual).max(axis=1, initial=0.0)

    def _evaluate(self, q: Array, reference: Array | None = None, **outputs: Array) -> None:
        """Evaluate q (m, nq), the angles of screws counting from a reference, or from zero."""
        q, shape = numbers(q, (len(q), self.nq)), (len(q), self.n_angles)
        reference = np.zeros(shape) if reference is None else numbers(reference, shape)
        self.library.kernel_evaluate(self.handle, ctypes.byref(EvaluationStruct(
            len(q), address(q), reference=address(reference),
            **{name: address(x) for name, x in outputs.items()})))

    def displaced(self, q: Array, steps: Array) -> Array:
        """Return q (m, nq) moved by joint displacements (m, nv), as `pin.integrate`."""
        q = np.array(numbers(q, (len(q), self.nq)))
        steps = numbers(steps, (len(q), self.nv))
        self.library.kernel_integrate(self.handle, len(q), address(q), address(steps))
        return q


def kernel_of(mechanism: Mechanism) -> acquired[Kernel]:
    """Acquire a kernel of a mechanism, as if newly made."""
    return acquired(mechanism, Kernel)


class TangentStep(NamedTuple):
    """The end of a step from a closed configuration, on the surface of independent equations.

    Attributes:
        q: (nq,) the end.
        is_closed: whether all other equations hold there.
    """

    q: Array
    is_closed: bool


def tangent_step(
    mechanism: Mechanism, q: Array, reference: Array, rows: NDArray[np.intp], freedoms: Array
) -> TangentStep | None:
    """Return the end of a step in all freedoms, see `correcting.c`; None where there is none.

    Args:
        mechanism: the mechanism.
        q: (nq,) closed configuration.
        reference: (n_angles,) from which the angles of screws count [rad].
        rows: independent closure equations at q.
        freedoms: (k, nv) orthonormal scaled velocities that they leave.
    """
    with acquired(mechanism, _without_idle_rotations) as kernel:
        freedoms = numbers(freedoms, (len(freedoms), kernel.nv))
        chosen, end = np.array(rows, np.int64), np.empty(kernel.nq)
        code = kernel.library.tangent_step(
            kernel.handle, *kernel.copied_addresses(q, reference), address(chosen), len(chosen),
            address(freedoms), len(freedoms), address(end))
    if code == BAD_ARRAYS:
        check(code)
    return TangentStep(end, code == DONE) if code in (DONE, UNSAFE) else None


def _without_idle_rotations(mechanism: Mechanism) -> Kernel:
    return Kernel(mechanism, packed(mechanism, False))
