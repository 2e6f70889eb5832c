"""The kernel of a mechanism, as Python calls it."""

from __future__ import annotations

import ctypes
import weakref
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin.constraints.compiled_equations import constraints_of
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
from spatial_pin.kernel.packing import Packed, packed
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array


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
