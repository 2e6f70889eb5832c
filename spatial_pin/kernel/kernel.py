"""The kernel of a mechanism: its tree and equations as two flat arrays, and as Python calls it.

The order of the arrays is that of `read_structure` and `read_numbers` in `model.c`. Joints of
several freedoms are split into single ones; the frame of each joint is turned so that its axis is
its local z axis.
"""

from __future__ import annotations

import ctypes
import weakref
from collections.abc import Sequence
from itertools import accumulate, pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin._support.lazy import acquired, made_anew, made_once
from spatial_pin.constraints.compiled_equations import COORDINATE, Constraints, constraints_of
from spatial_pin.constraints.composite_joints import in_kernel, inertias, single_joints
from spatial_pin.kernel.library import (
    BAD_ARRAYS,
    DONE,
    INT,
    POINTER,
    UNSAFE,
    address,
    check,
    library,
    numbers,
)
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.piecewise import ROOT, CalledFunction, SquareRoot

Ints = NDArray[np.int64]
PRODUCT, SUM, IDLE = range(3)  # kinds of equations, see `kernel.h`


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
        fixed_in: (n_vectors,) what each vector is fixed in, see `Constraints.vectors`.
        is_point: (n_vectors,) whether it leads to a point, or is a direction.
    """

    ints: Ints
    reals: Array
    frames: Array
    carriers: NDArray[np.intp]
    fixed_in: Ints
    is_point: NDArray[np.bool_]

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
    c, model = constraints_of(mechanism), mechanism.centred_model
    tree, n_idle = single_joints(mechanism), c.n_passive if idle else 0
    fixed_in, joints, is_point, local = zip(*c.vectors, strict=True) if c.vectors else [()] * 4
    bodies = tree.carriers[np.array(joints, np.intp)]
    parts, factors = ([x[:, :2], x[:, 2:4], x[:, 4]] for x in (c.parts, c.part_factors))
    moved, freedoms = np.nonzero(c.signs)  # product and freedom of each of their supports
    counts, ints, reals = _packed_equations(c, n_idle)
    head = [len(tree.kind), model.nq, model.nv, len(bodies), len(c.constants), c.n_closure, n_idle,
            c.n_angles, len(freedoms), *counts]
    return Packed(
        _joined(np.int64, head, tree.kind, tree.parent, tree.iq, tree.iv, bodies, is_point, *parts,
                np.searchsorted(moved, np.arange(len(c.constants) + 1)), freedoms, *ints),
        _joined(float, tree.rotation, tree.translation, tree.pitch, tree.mass, tree.com,
                tree.inertia, model.gravity.linear, mechanism.velocity_scale,
                np.array(local).reshape(-1, 1, 3) @ tree.frames[bodies],  # in the turned axes
                *factors, c.constants, c.factors, c.signs[moved, freedoms], *reals),
        tree.frames, tree.carriers, np.array(fixed_in, np.int64), np.array(is_point, bool))


def _packed_equations(c: Constraints, n_idle: int) -> tuple[list[int], list[Any], list[Any]]:
    """Return counts, structure and numbers of equations, but for those of the products."""
    kinds = [SUM if product < 0 else PRODUCT for product in c.product] + [IDLE] * n_idle
    product = [*c.product, *range(c.passive_at, c.passive_at + n_idle)]
    patterns = [np.flatnonzero(row) for row in c.occurring[: len(kinds)]]
    # sine and cosine of angles (where sums define these, any product), what counts their turns
    directions = [(x.sine, x.sine + 1) if x.sine >= 0 else
                  (np.searchsorted(c.equation_of, x.equation),) * 2 for x in c.angles]
    spins = [np.flatnonzero(x.row * x.is_of_joints) for x in c.angles]
    implicit = [(angle, len(of.spans), len(kinds) + first,
                 sum(periodic << k for k, periodic in enumerate(of.is_periodic)))
                for angle, first, of in c.implicit]
    sums = [*c.sums, *([] for _ in range(n_idle)), *c.defining]
    terms = [term for terms in sums for term in terms]
    factors = [factor for _, factors in terms for factor in factors]
    entries = [c.coordinates[at][1:] if kind == COORDINATE else (at, 0) for kind, at, _ in factors]
    shapes, functions, first = list[tuple[int, ...]](), list[Array](), 0
    for f in c.functions:  # see `piecewise.h`
        if isinstance(f, SquareRoot | CalledFunction):
            shapes.append((first, 0, int(f is not ROOT), 0))
        else:
            pieces, width = f.coefficients.shape
            shapes.append((first, pieces, width - 1, int(f.is_periodic)))
            functions.append(np.concatenate([f.breaks, f.coefficients.ravel(), [f.rise]]))
            first += len(functions[-1])
    counts = [sum(map(len, patterns)), sum(map(len, spins)), len(terms), len(factors), len(shapes),
              len(implicit), len(c.defining)]
    ints = [kinds, product, directions, implicit,
            _starts(sums), _starts([own for _, own in terms]),
            [kind for kind, _, _ in factors], entries, [f for _, _, f in factors], shapes,
            _starts(patterns), *patterns, _starts(spins), *spins]
    reals = [[x.offset for x in c.angles],
             *(x.row[at] for x, at in zip(c.angles, spins, strict=True)),
             [(*of.spans[0], *of.spans[-1]) for _, _, of in c.implicit],
             [number for number, _ in terms], *functions]
    return counts, ints, reals


def _starts(rows: Sequence[Any]) -> list[int]:
    """Return where each of some rows begins when they are joined, and where the last ends."""
    return [*accumulate(map(len, rows), initial=0)]


class FrameInKernel(NamedTuple):
    """A frame fixed in a body of the kernel.

    Attributes:
        joint: of the kernel, that carries it.
        axes: (9,) its rotation in the joint's axes, by columns.
        origin: (3,) its origin there [m].
    """

    joint: int
    axes: list[float]
    origin: list[float] | Array


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
    return _with_masses(
        mechanism, inertias(model).tobytes() + model.gravity.linear.tobytes())


@made_anew
def _with_masses(mechanism: Mechanism, masses: bytes) -> Packed:
    model, arrays = mechanism.model, packed(mechanism, False)
    arrays = arrays._replace(reals=arrays.reals.copy())
    _, _, mass, com, inertia, gravity, _ = arrays.parts()
    mass[:], com[:], inertia[:] = in_kernel(inertias(model), arrays.frames, arrays.carriers)
    gravity[:] = model.gravity.linear
    return arrays


def _joined(kind: type, *parts: Any) -> Any:
    return np.concatenate([np.asarray(p, kind).ravel() for p in parts])


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
        called = np.array([f.address if isinstance(f, CalledFunction) else 0 for f in c.functions],
                          np.intp)  # functions in code
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
        """Return (m, n_closure + n_passive, nv) at q (m, nq), by v / `velocity_scale`.

        Angles of screws count from zero, which changes no derivative; places along curves are those
        at which the loops are open least.
        """
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


def tangent_step(
    mechanism: Mechanism, q: Array, reference: Array, rows: NDArray[np.intp], freedoms: Array
) -> tuple[Array | None, bool]:
    """Return the end (nq,) of a step in all freedoms, and whether all equations hold there.

    The step is along the surface of the independent equations, see `correcting.c`; None for one
    without an end.

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
    return (end if code in (DONE, UNSAFE) else None), code == DONE


def _without_idle_rotations(mechanism: Mechanism) -> Kernel:
    return Kernel(mechanism, packed(mechanism, False))
