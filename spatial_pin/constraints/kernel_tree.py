"""A tree of joints in the compiled kernel: motions, forces and accelerations, see `articulated.c`.

Time and memory grow with the number of joints; a `pin.Data` takes memory with its cube, 4 GB for
400 freedoms, and some of its algorithms time with the square. Results are those of Pinocchio.
"""

from __future__ import annotations

import ctypes
import weakref
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin._support.lazy import made_once
from spatial_pin.constraints.composite_joints import TreeArrays, in_kernel, inertias
from spatial_pin.kernel.library import (
    DONE,
    INT,
    POINTER,
    REAL,
    SINGULAR,
    CStructure,
    address,
    check,
    library,
)
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array

# Rows, columns and indices of the entries of a mass matrix.
MassEntries = tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]
PackedSprings = Callable[
    [NDArray[np.intp], Array], tuple[Sequence[NDArray[np.int64]], Sequence[Array]]]
WHOLE = 60  # freedoms from which on the kernel moves a tree: a `pin.Data` has 10 MB there
BRANCHES = 4  # at the ground, from which on each subtree is small beside the tree


def is_in_kernel(model: pin.Model) -> bool:
    """Whether the kernel moves a tree: it is too large for a `pin.Data`."""
    return model.nv >= WHOLE


def is_large(model: pin.Model) -> bool:
    """Whether a tree is large, and has branches that do not depend on each other."""
    return model.nv >= WHOLE and len(model.children[0]) >= BRANCHES


class TreeTask(CStructure):
    """TreeTask in articulated.h: motions of a tree, and what is wanted of them."""

    _fields_ = ("n", INT), *((name, POINTER) for name in (
        "q", "v", "a", "armature", "R", "p", "jacobian", "velocity", "acceleration", "tau",
        "wrench", "springs", "of_springs", "outside", "by_q", "by_v")), ("n_products", INT), *(
            (name, POINTER) for name in ("bodies", "a_parts", "b_parts", "values", "product_by_q",
                                         "product_by_v", "weights", "bent"))


class _SpringsStruct(ctypes.Structure):
    """Springs in springs.h; without laws."""

    _fields_ = [("n_lines", INT), ("n_bushings", INT), *((name, POINTER) for name in (
        "line_body", "line_law", "bushing_body", "bushing_law", "line_point", "line_spring",
        "bushing", "force", "moment")), ("n_coincident", INT), ("first_bushing", INT),
        ("law", POINTER), ("power", REAL)]


class TreeSprings:
    """Springs between points, and bushings, that lessen the joint forces of a `KernelTree`.

    Args:
        tree: the arrays of the tree.
        pack: what returns them by the carriers of joints and their axes, see `Forces.packed`; none
            has a law.
    """

    def __init__(self, tree: TreeArrays, pack: PackedSprings) -> None:
        ints, reals = pack(tree.carriers, tree.frames)
        self._alive = *ints, *reals, *np.zeros((2, len(tree.kind), 3))
        self._struct = _SpringsStruct(len(ints[1]), len(ints[3]), *map(address, self._alive))
        self.address = ctypes.addressof(self._struct)

    def coincide(self) -> bool:
        """Whether points of a spring have coincided since the last call."""
        n, self._struct.n_coincident = self._struct.n_coincident, 0
        return bool(n)


class KernelTree:
    """A tree of joints; one caller at a time.

    Args:
        model: the tree.
        scale: (nv,) size of each velocity, in which accelerations are compared.
        is_core: (njoints,) joints that loops are built on, with all before them; default none.
        bodies: model whose masses, armatures and gravity count, as they are at a call; default
            `model`, which may be a copy of it.

    Attributes:
        arrays: its single joints.
        handle: of the C structure.
        is_core: (nv,) which velocities are of the core; has_limbs: whether some are not.
        armature: (nv,) of the joints, a view.
    """

    def __init__(
        self, model: pin.Model, scale: Array | None = None,
        is_core: NDArray[np.bool_] | None = None, bodies: pin.Model | None = None,
    ) -> None:
        self.model, self.arrays = model, TreeArrays(model)
        self._library, t, n, nv = library(), self.arrays, len(self.arrays.kind), model.nv
        bodies = model if bodies is None else bodies
        self._inertias, self._masses = inertias(bodies), b""  # views: they see later changes
        self._gravity, self.armature = bodies.gravity.linear, bodies.armature
        head = [n, model.nq, nv, *[0] * 13]  # no equations:
        starts = [0] * 5  # of supports, terms, factors, patterns and turns
        ints = np.concatenate([head, t.kind, t.parent, t.iq, t.iv, starts]).astype(np.int64)
        parts = (t.rotation, t.translation, t.pitch, t.mass, t.com, t.inertia, self._gravity,
                 np.ones(nv) if scale is None else scale)
        self._reals = np.concatenate([np.asarray(x, float).ravel() for x in parts])
        self._kernel, self.handle = ctypes.c_void_p(), ctypes.c_void_p()
        check(self._library.kernel_create(
            address(ints), len(ints), address(self._reals), len(self._reals), None, 0,
            ctypes.byref(self._kernel)))
        weakref.finalize(self, self._library.kernel_destroy, self._kernel)
        core = np.zeros(n, np.int64)
        core[t.carriers] = False if is_core is None else is_core
        for joint in range(n - 1, 0, -1):  # those in front in a joint that is split
            core[t.parent[joint]] |= core[joint]
        check(self._library.tree_create(self._kernel, address(core), ctypes.byref(self.handle)))
        self.is_core = core[t.joint_of] > 0
        self.has_limbs = not self.is_core.all()
        self._q, (self._v, self._a, self._tau) = np.empty(model.nq), np.empty((3, nv))
        self._one = TreeTask.of(n=1, q=self._q, v=self._v, a=self._a, armature=self.armature)

    def take_masses(self) -> None:
        """Take the masses and the gravity that there are now; armatures are always those."""
        now = self._inertias.tobytes() + self._gravity.tobytes()
        if now == self._masses:
            return
        self._masses, t = now, self.arrays
        numbers = in_kernel(self._inertias, t.frames, t.carriers)
        first = 13 * len(t.kind)
        self._reals[first : 2 * first + 3] = np.concatenate(
            [*map(np.ravel, numbers), self._gravity])
        check(self._library.kernel_set_numbers(
            self._kernel, address(self._reals), len(self._reals)))

    # ------------------------------------------------------------ motions

    def evaluate(
        self, q: Array, v: Array | None = None, a: Array | None = None, **wanted: Any
    ) -> None:
        """Evaluate one motion; without a: of no acceleration, without v: placements alone.

        `wanted` has arrays for what is wanted, and what that needs besides, by their names in
        `TreeTask`. Forces have the masses of the last `take_masses`.
        """
        self._q[:], task = q, TreeTask.from_buffer_copy(self._one)
        for name, own, given in (("v", self._v, v), ("a", self._a, a)):
            if given is None:
                wanted[name] = None
            else:
                own[:] = given
        task.put(**wanted)
        self._library.tree_evaluate(self.handle, ctypes.byref(task))

    def prepared(self, q: Array, v: Array, a: Array, **wanted: Any) -> Callable[[], None]:
        """Return what evaluates m motions, contiguous arrays, with the masses that there are then.

        The other arguments are as of `evaluate`.
        """
        task = TreeTask.of(n=len(q), q=q, v=v, a=a, armature=self.armature, **wanted)
        at_task = ctypes.byref(task)

        def work() -> None:
            self.take_masses()
            self._library.tree_evaluate(self.handle, at_task)

        return work

    def placed(self, rotations: Array, positions: Array) -> Array:
        """Return placements (..., njoints, 4, 3) of the model's joints, given the kernel's."""
        at = self.arrays.carriers
        columns = self.arrays.frames[at] @ rotations[..., at, :, :]
        return np.concatenate([columns, positions[..., at, None, :]], axis=-2)

    # ------------------------------------------------------------ forces and accelerations

    def forces(self, q: Array, v: Array, a: Array | None = None) -> Array:
        """Return the joint forces (nv,) of a motion, `pin.rnea`; the next call overwrites them."""
        self.take_masses()
        self.evaluate(q, v, a, tau=self._tau)
        return self._tau

    def transmitted(self, q: Array, v: Array, a: Array) -> Array:
        """Return the forces (njoints, 6) through the joints, world axes, about their origins.

        `pin.Data.f` has them in joint axes.
        """
        self.take_masses()
        wrench = np.empty((len(self.arrays.kind), 6))
        self.evaluate(q, v, a, tau=self._tau, wrench=wrench)
        wrench[0] = 0.0
        return wrench[self.arrays.carriers]

    def masses(self, q: Array, out: Array) -> None:
        """Write the numbers of the mass matrix at q (nq,), by `mass_entries`."""
        self.take_masses()
        self._q[:], one = q, self._one
        self._library.tree_masses(self.handle, one.q, None, None, one.armature, address(out), None)

    def mass_matrix(self, q: Array) -> Array:
        """Return the mass matrix (nv, nv) at q (nq,)."""
        rows, columns, indices = mass_entries(self, True)
        numbers, matrix = np.empty(len(rows)), np.zeros((self.model.nv, self.model.nv))
        self.masses(q, numbers)
        matrix[rows, columns] = numbers[indices]
        return matrix

    def respond(self, q: Array, v: Array, forces: Array) -> bool:
        """Make joint forces (n, nv) the accelerations of an open tree under them alone.

        Returns:
            Whether every freedom has inertia; if not, they stay.
        """
        self.take_masses()
        self._q[:], self._v[:] = q, v
        one, none = self._one, np.zeros((3, self.model.nv))
        code = self._library.tree_masses(self.handle, one.q, one.v, address(none[0]), one.armature,
                                         address(none[1]), address(none[2]))
        if code not in (DONE, SINGULAR):
            check(code)
        if forces.size and not code:  # or there are no joints
            rows = address(forces)
            self._library.tree_accelerations(
                self.handle, len(forces), rows, None, rows, None, None)
        return not code


def centred_tree(mechanism: Mechanism) -> KernelTree:
    """Return the tree of a mechanism, relative to its centre; to be acquired."""
    return KernelTree(mechanism.centred_model, bodies=mechanism.model)


@made_once
def mass_entries(tree: KernelTree, all_joints: bool) -> MassEntries:
    """Return rows, columns and indices in `masses` of all entries that can be other than zero.

    Of the core alone the others are units, each with a number of its own behind those of the core.
    """
    t, rows, columns = tree.arrays, list[NDArray[np.intp]](), list[NDArray[np.intp]]()
    freedoms = np.split(np.arange(len(t.joint_of)), t.iv[1:])
    for v, joint in enumerate(t.joint_of.tolist()):
        if all_joints or tree.is_core[v]:
            own, up = [np.arange(t.iv[joint], v + 1)], int(t.parent[joint])
            while up:
                own.append(freedoms[up])
                up = int(t.parent[up])
            columns.append(np.concatenate(own))
            rows.append(np.full(len(columns[-1]), v))
    others = np.arange(0) if all_joints else np.flatnonzero(~tree.is_core)
    row, column = (np.concatenate([*x, others]) for x in (rows, columns))
    indices, off_diagonal = np.arange(len(row)), np.flatnonzero(row != column)
    return (np.concatenate([row, column[off_diagonal]]),
            np.concatenate([column, row[off_diagonal]]),
            np.concatenate([indices, off_diagonal]))
