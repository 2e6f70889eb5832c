"""The KKT system of a mechanism in the kernel, see `kkt.c`."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin.constraints.kernel_tree import (
    KernelTree,
    MassEntries,
    TreeTask,
    mass_entries,
)
from spatial_pin.kernel.kernel import Kernel
from spatial_pin.kernel.library import INT, POINTER, CStructure, address, check, numbers
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import EPS, Array

Positions = NDArray[Any]
# A tree relative to the centre; its task with products, the closure equations, and room for their
# changes, but no motion; derivatives (n, 2, nv) of joint forces by their own entries of q and of v,
# resisting ones positive, if any.
Changes = tuple[KernelTree, TreeTask, Array | None]


class _KktTask(CStructure):
    """KktTask in kkt.c."""

    _fields_ = ("n", INT), *((name, POINTER) for name in (
        "tree", "q", "v", "reference", "mass", "force", "armature", "rounding")), (
            "n_actuated", INT), *((name, POINTER) for name in (
                "actuated", "efforts", "a", "closures", "multipliers", "entry", "chosen", "facts",
                "single", "changes", "slopes", "a_by", "multipliers_by"))


PIVOT, RANK, ERROR, FAILED = 0, 2, 3, 5  # among the facts


class Accelerated(NamedTuple):
    """Accelerations, or efforts, of a tree with loops at n configurations.

    Attributes:
        a: (n, nv) accelerations.
        efforts: (n, k) of actuators.
        closures: (n, nv) joint forces of the closures.
        multipliers: (n, n_closure) 0 of equations that are left out.
        chosen: (n, n_closure) indices of the independent equations, first in each row.
        facts: (n, 6) as in kkt.c: the rank of the closure equations, the estimated error of
            accelerations or efforts, and whether there are no results are among them.
        a_by: (n, 3, nv, nv) derivatives of accelerations, by each entry of q, v and joint forces.
        multipliers_by: (n, 3, nv, n_closure) likewise.
    """

    a: Array
    efforts: Array
    closures: Array
    multipliers: Array
    chosen: NDArray[np.int64]
    facts: Array
    a_by: Array
    multipliers_by: Array


class KKT:
    """M a + b = f + J^T multipliers, J a + gamma = 0; one caller at a time.

    Args:
        mechanism: the mechanism.
        mass_entries: rows, columns and indices in `mass` of all entries of its mass matrix that can
            be other than zero.

    Attributes:
        mass: numbers of the mass matrix, to be filled in.
        pivot: smallest over largest pivot of the last solution, 0 where there is none.
        error: estimated round-off of it, relative to its size.
        error_of_tree, is_of_forces: the same of a `CoreKKT`, and whether it is mostly round-off of
            the joint forces: no solver can be better.
        a: (nv,) the accelerations.
        rank: how many independent equations there are.
        closures: (nv,) joint forces of the closures.
        multipliers: (n_closure,) 0 of equations that are left out.
    """

    def __init__(self, mechanism: Mechanism, mass_entries: MassEntries) -> None:
        self._kernel = kernel = Kernel(mechanism)
        self._library, nv, n_closure = kernel.library, kernel.nv, kernel.n_closure
        closures = groupby(kernel.constraints.closure_of)
        groups = np.cumsum([0, *(len(list(group)) for _, group in closures)])  # by closure
        ints = np.concatenate([groups, *mass_entries]).astype(np.int64)
        handle, n_masses = ctypes.c_void_p(), int(mass_entries[2].max(initial=-1)) + 1
        check(self._library.kkt_create(kernel.handle, address(ints), len(groups) - 1,
                                       len(mass_entries[0]), n_masses,
                                       mechanism.characteristic_length, ctypes.byref(handle)))
        self._handle = handle
        self.pivot, self.error, self.rank = 1.0, 0.0, 0
        self._at = np.nonzero(kernel.constraints.occurring[:n_closure])
        self._values, self._chosen = np.empty(len(self._at[0])), np.empty(n_closure, np.int64)
        self._q, self._reference = np.empty(kernel.nq), np.empty(kernel.n_angles)
        self._v, self._force, self.a = np.empty((3, nv))
        self.mass, self._facts = np.empty(n_masses), np.empty(6)
        self.closures, self.multipliers = np.empty(nv), np.empty(n_closure)
        # signs of round-off of joint forces: as a coin gives them
        rounding = EPS * np.random.default_rng(0).choice([-1.0, 1.0], nv)
        self._task = _KktTask.of(
            n=1, q=self._q, v=self._v, reference=self._reference, mass=self.mass, force=self._force,
            rounding=rounding, a=self.a, closures=self.closures, multipliers=self.multipliers,
            entry=self._values, chosen=self._chosen, facts=self._facts)
        self._at_task = ctypes.byref(self._task)

    def accelerations(
        self, q: Array, v: Array, reference: Array | Sequence[float], given: Array, needed: Array
    ) -> Array:
        """Return accelerations (nv,), 0 where they are not determined; the next call overwrites.

        Args:
            q: (nq,) configuration; `mass` is that there.
            v: (nv,) joint velocities.
            reference: (n_angles,) from which the angles of screws count [rad].
            given: (nv,) joint forces f.
            needed: (nv,) joint forces b that the motion needs without acceleration.
        """
        np.subtract(given, needed, out=self._force)
        self._solve(q, v, reference)
        return self.a

    def _solve(self, q: Array, v: Array, reference: Any) -> float:
        """Solve for the joint forces that there are; returns whether there is no solution."""
        self._q[:], self._v[:] = q, v
        if len(reference):
            self._reference[:] = reference
        code = self._library.kkt_accelerations(self._handle, self._at_task)
        if code:
            check(code)
        has_none: float
        self.pivot, self.error, rank, self.error_of_tree, of_forces, has_none = (
            self._facts.tolist())
        self.rank, self.is_of_forces = int(rank), of_forces > 0.0
        return has_none

    def solve(self, force: Array, gamma: Array) -> tuple[Array, Array]:
        """Return accelerations (k, nv) and multipliers (k, n_closure) with the last matrix.

        Args:
            force: (k, nv) joint forces f - b.
            gamma: (k, n_closure) second derivatives of the closure equations without acceleration.
        """
        n = len(force)
        force, gamma = numbers(force, (n, len(self._v))), numbers(gamma, (n, len(self._chosen)))
        a, multipliers = np.empty_like(force), np.empty_like(gamma)
        self._library.kkt_solve(self._handle, n, *map(address, (force, gamma, a, multipliers)))
        return a, multipliers

    @property
    def entries(self) -> tuple[Positions, Positions, Array]:
        """Rows, columns and values (nnz,) of the Jacobian for scaled velocities, at that place."""
        rows, columns = self._at
        return rows, columns, self._values.copy()

    @property
    def rows(self) -> Positions:
        """Indices of the independent equations that were chosen, ascending."""
        return self._chosen[: self.rank].copy()


class CoreKKT(KKT):
    """The KKT system of a tree's core; its other joints, outside of loops, are eliminated.

    Masses and gravity are those that the tree has at a call.

    Args:
        mechanism: the mechanism.
        tree: the tree.
    """

    def __init__(self, mechanism: Mechanism, tree: KernelTree) -> None:
        super().__init__(mechanism, mass_entries(tree, False))
        self._tree = tree
        self._task.put(tree=tree.handle, armature=tree.armature)

    def of_tree(
        self, q: Array, v: Array, reference: Array | Sequence[float], force: Array
    ) -> bool:
        """Find accelerations; False if there are none: a freedom outside of loops has no inertia.

        Args:
            q: (nq,) configuration.
            v: (nv,) joint velocities.
            reference: as for `accelerations`.
            force: (nv,) joint forces f.
        """
        self._tree.take_masses()
        self._force[:] = force
        return not self._solve(q, v, reference)

    def efforts_of(
        self, q: Array, v: Array, a: Array, reference: Array | Sequence[float], force: Array,
        actuated: NDArray[np.int64],
    ) -> Array | None:
        """Return the efforts (k,) of actuators that accelerations need, and find `closures`.

        Idle rotations that no actuator holds have the accelerations that forces give them, and `a`
        has all. None where it is not clear that closures and actuators together bear any other
        force in one way, and in one way only.

        Args:
            q: (nq,) configuration.
            v: (nv,) joint velocities.
            a: (nv,) joint accelerations.
            reference: as for `accelerations`.
            force: (nv,) other joint forces.
            actuated: (k,) velocity entries that have efforts.
        """
        self._tree.take_masses()
        self.a[:], self._force[:], efforts = a, force, np.empty(len(actuated))
        task = self._task
        task.n_actuated, task.actuated, task.efforts = (
            len(actuated), address(actuated), address(efforts))
        failed = self._solve(q, v, reference)
        task.actuated = None
        return None if failed else efforts

    def of_many(
        self, q: Array, v: Array, reference: Array, force: Array, a: Array | None = None,
        actuated: NDArray[np.int64] | None = None, changes: Changes | None = None,
    ) -> Accelerated:
        """Return what `of_tree` finds at many configurations, or what `efforts_of` does.

        Args:
            q: (n, nq) configurations.
            v: (n, nv) joint velocities.
            reference: (n, n_angles) from which the angles of screws count [rad].
            force: (n, nv) joint forces.
            a: (n, nv) accelerations, where efforts are wanted; those of idle rotations follow.
            actuated: (k,) velocity entries that have efforts.
            changes: what derivatives of the accelerations need, where all joints are the core's.
        """
        self._tree.take_masses()
        n, nv, k, nc = len(q), len(self.a), 0 if actuated is None else len(actuated), len(
            self.multipliers)
        m, own = n if changes else 0, (self._q, self._v, self._reference, self._force)
        out = Accelerated(np.empty((n, nv)) if a is None else np.array(a),
                          np.empty((n, k)), np.empty((n, nv)), np.empty((n, nc)),
                          np.empty((n, nc), np.int64), np.empty((n, len(self._facts))),
                          np.empty((m, 3, nv, nv)), np.empty((m, 3, nv, nc)))
        task, given = _KktTask.from_buffer_copy(self._task), (q, v, reference, force)
        if n == 1:
            for room, one in zip(own, given, strict=True):
                room[:] = one
        else:
            task.put(**{name: numbers(x, (n, len(room))) for name, x, room in zip(
                ("q", "v", "reference", "force"), given, own, strict=True)})
        task.put(n=n, n_actuated=k, actuated=actuated, **out._asdict())
        if changes:
            tree, of_tree, slopes = changes
            slopes = None if slopes is None else numbers(slopes, (n, 2, nv))
            task.put(single=tree.handle, changes=ctypes.addressof(of_tree), slopes=slopes)
        check(self._library.kkt_accelerations(self._handle, ctypes.byref(task)))
        return out
