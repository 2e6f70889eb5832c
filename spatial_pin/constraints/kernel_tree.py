"""A tree of joints in the compiled kernel: motions, forces and accelerations, see `articulated.c`.

Time and memory grow with the number of joints; a `pin.Data` takes memory with its cube, 4 GB for
400 freedoms, and some of its algorithms time with the square. Results are those of Pinocchio.
"""

from __future__ import annotations

import ctypes
import weakref
from collections.abc import Callable, Mapping, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin._support.lazy import made_once
from spatial_pin.constraints.composite_joints import (
    TreeArrays,
    in_kernel,
    inertias,
    split,
    split_of,
)
from spatial_pin.kernel.library import DONE, INT, POINTER, REAL, SINGULAR, address, check, library
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.stacked import cross

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


class TreePlacements:
    """Placements (njoints, 4, 3) as `pin.Data.oMi` has them, each made at its first use."""

    def __init__(self, placements: Array) -> None:
        self._placements = placements

    def __getitem__(self, joint: int) -> pin.SE3:
        at = self._placements[joint]
        return pin.SE3(at[:3].T, at[3])


class _TreeTask(ctypes.Structure):
    """TreeTask in articulated.h."""

    _fields_ = [("n", INT), *((name, POINTER) for name in (
        "q", "v", "a", "armature", "R", "p", "jacobian", "velocity", "acceleration", "tau",
        "wrench", "springs", "of_springs", "outside", "by_q", "by_v"))]
    _fields_ += [("n_products", INT), *((name, POINTER) for name in (
        "bodies", "a_parts", "b_parts", "values", "product_by_q", "product_by_v", "weights",
        "bent"))]


class _SpringsStruct(ctypes.Structure):
    """Springs in springs.h; without laws."""

    _fields_ = [("n_lines", INT), ("n_bushings", INT), *((name, POINTER) for name in (
        "line_body", "line_law", "bushing_body", "bushing_law", "line_point", "line_spring",
        "bushing", "force", "moment")), ("n_coincident", INT), ("first_bushing", INT),
        ("law", POINTER), ("power", REAL)]


class TreeSprings:
    """Springs between points, and bushings, that lessen the joint forces of a `KernelTree`.

    Args:
        n_joints: of the kernel.
        ints: bodies (n, 2) of springs between points, whether each has a law (n,), and those of
            bushings; none has one.
        reals: points (n, 2, 3), numbers (n, 3), and those of bushings (m, 103), see bushings.c.
    """

    def __init__(
        self, n_joints: int, ints: Sequence[NDArray[np.int64]], reals: Sequence[Array]
    ) -> None:
        self._alive = *ints, *reals, *np.zeros((2, n_joints, 3))
        self._struct = _SpringsStruct(len(ints[1]), len(ints[3]), *map(address, self._alive))
        self.address = ctypes.addressof(self._struct)

    def coincide(self) -> bool:
        """Whether points of a spring have coincided since the last call."""
        n, self._struct.n_coincident = self._struct.n_coincident, 0
        return bool(n)


class TreeProducts:
    """Products A . B of vectors that two bodies carry; `addresses` tell the kernel where they are.

    Args:
        bodies: (n, 2) joints of the kernel that carry them.
        a_parts, b_parts: (n, 2, 4) what each carries of A and of B, in its axes, and 1 for a point.
    """

    def __init__(self, bodies: NDArray[np.int64], a_parts: Array, b_parts: Array) -> None:
        self._alive = bodies, a_parts, b_parts
        self.addresses = len(bodies), *map(address, self._alive)


class KernelTree:
    """A tree of joints; one caller at a time.

    Args:
        model: the tree.
        scale: (nv,) size of each velocity, in which accelerations are compared.
        is_core: (njoints,) joints that loops are built on, with all before them; default none.
        whole: mechanism whose model's masses, armatures and gravity count, as they are at a call;
            default those of `model`, which may be a copy of it.

    Attributes:
        placements: (njoints, 4, 3) of the joints, columns of the rotation, then the position.
        columns: (6, nv) world joint Jacobian.
        twists, accelerations: (njoints, 6) spatial ones, joint axes.
        handle: of the C structure.
        is_core: (nv,) which velocities are of the core; has_limbs: whether some are not.
        armature: (nv,) of the joints, a view.
    """

    def __init__(
        self, model: pin.Model, scale: Array | None = None,
        is_core: NDArray[np.bool_] | None = None, whole: Mechanism | None = None,
    ) -> None:
        self.model, (self._split, self._carriers) = model, split(model)
        self._library, self._tree = library(), TreeArrays(self._split)
        bodies, self._heavy = model, self._carriers
        if whole is not None:
            bodies, self._heavy = whole.model, split_of(whole).joint
        self._inertias, self._masses = inertias(bodies), b""  # views: they see later changes
        self._gravity, self.armature = bodies.gravity.linear, bodies.armature
        t, n = self._tree, self._split.njoints
        head = [n, model.nq, model.nv, *[0] * 13]  # no equations:
        starts = [0] * 5  # of supports, terms, factors, patterns and turns
        ints = np.concatenate([head, t.kind, t.parent, t.iq, t.iv, starts]).astype(np.int64)
        parts = (t.rotation, t.translation, t.pitch, t.mass, t.com, t.inertia, self._gravity,
                 np.ones(model.nv) if scale is None else scale)
        self._reals = np.concatenate([np.asarray(x, float).ravel() for x in parts])
        self._kernel, self.handle = ctypes.c_void_p(), ctypes.c_void_p()
        check(self._library.kernel_create(
            address(ints), len(ints), address(self._reals), len(self._reals), None, 0,
            ctypes.byref(self._kernel)))
        weakref.finalize(self, self._library.kernel_destroy, self._kernel)
        core = np.zeros(n, np.int64)
        core[self._carriers] = False if is_core is None else is_core
        for joint in range(n - 1, 0, -1):  # those in front in a joint that is split
            core[t.parent[joint]] |= core[joint]
        check(self._library.tree_create(self._kernel, address(core), ctypes.byref(self.handle)))
        self.has_limbs, self.is_core = not core[1:].all(), np.zeros(model.nv, bool)
        for joint in (np.flatnonzero(core[1:]) + 1).tolist():
            self.is_core[t.iv[joint] : t.iv[joint] + self._split.nvs[joint]] = True
        n = model.njoints
        self.placements, self.columns = np.zeros((n, 4, 3)), np.zeros((6, model.nv))
        self.placements[0, :3] = np.eye(3)
        self.twists, self.accelerations = np.zeros((2, n, 6))
        n, nv = self._split.njoints, model.nv
        self._q, self._v, self._a = np.empty(model.nq), np.empty(nv), np.empty(nv)
        self._tau = np.empty(nv)
        self._R, self._p = np.empty((n, 3, 3)), np.empty((n, 3))
        self._moving = np.empty((2, n, 6))
        self._task = _TreeTask(1, *map(address, (
            self._q, self._v, self._a, self.armature, self._R, self._p)))

    def take_masses(self) -> None:
        """Take the masses and the gravity that there are now; armatures are always those."""
        gravity = self._gravity
        now = self._inertias.tobytes() + gravity.tobytes()
        if now == self._masses:
            return
        self._masses, n = now, self._split.njoints
        mass, com, inertia = in_kernel(self._inertias, self._tree.frames, self._heavy)
        first = 13 * n
        self._reals[first : first + 13 * n + 3] = np.concatenate(
            [mass, com.ravel(), inertia.ravel(), gravity])
        check(self._library.kernel_set_numbers(
            self._kernel, address(self._reals), len(self._reals)))

    # ------------------------------------------------------------ placements and motions

    @property
    def data(self) -> SimpleNamespace:
        """The part of a `pin.Data` that there is: `J` and `oMi`."""
        return SimpleNamespace(J=self.columns, oMi=TreePlacements(self.placements))

    def update(self, q: Array) -> None:
        """Set `placements` and `columns` at the configuration q (nq,)."""
        self._evaluate(q, None, None, jacobian=self.columns)
        self._put_placements()

    def move(self, q: Array, v: Array, a: Array) -> None:
        """Set `placements`, `twists` and `accelerations` of a motion."""
        velocity, acceleration = self._moving
        self._evaluate(q, v, a, velocity=velocity, acceleration=acceleration)
        self._put_placements()
        seen, felt = velocity[self._carriers], acceleration[self._carriers].copy()
        felt[:, :3] -= cross(seen[:, 3:], seen[:, :3])
        for world, local in ((seen, self.twists), (felt, self.accelerations)):
            np.matmul(self.placements[:, None, :3], world.reshape(-1, 2, 3, 1),
                      out=local.reshape(-1, 2, 3, 1))

    def _evaluate(
        self, q: Array, v: Array | None, a: Array | None, products: TreeProducts | None = None,
        **arrays: Array | None,
    ) -> None:
        """Evaluate a motion; a None: no acceleration; v None: placements only."""
        self._q[:], task = q, _TreeTask.from_buffer_copy(self._task)
        if products:
            task.n_products, task.bodies, task.a_parts, task.b_parts = products.addresses
        if v is None:
            task.v = None
        else:
            self._v[:] = v
        if a is None:
            task.a = None
        else:
            self._a[:] = a
        for name, array in arrays.items():
            setattr(task, name, None if array is None else address(array))
        self._library.tree_evaluate(self.handle, ctypes.byref(task))

    def _put_placements(self) -> None:
        at = self._carriers
        np.matmul(self._tree.frames[at], self._R[at], out=self.placements[:, :3])
        self.placements[:, 3] = self._p[at]

    def frame_jacobian(self, frame: int) -> Array:
        """Return the Jacobian (6, nv) of a frame at its origin, world axes, where it is placed."""
        model, at = self.model, self.model.frames[frame]
        jacobian = np.zeros_like(self.columns)
        for i in list(model.supports[at.parentJoint])[1:]:
            own = slice(model.idx_vs[i], model.idx_vs[i] + model.nvs[i])
            jacobian[:, own] = self.columns[:, own]
        placement = self.data.oMi[at.parentJoint] * at.placement
        jacobian[:3] -= pin.skew(placement.translation) @ jacobian[3:]
        return jacobian

    # ------------------------------------------------------------ forces

    def forces(self, q: Array, v: Array, a: Array | None = None) -> Array:
        """Return the joint forces (nv,) of a motion, `pin.rnea`; the next call overwrites them."""
        self.take_masses()
        self._evaluate(q, v, a, tau=self._tau)
        return self._tau

    def springs(self, pack: PackedSprings) -> TreeSprings:
        """Return springs, given what packs them by the carriers of joints and their axes."""
        return TreeSprings(self._split.njoints, *pack(self._carriers, self._tree.frames))

    def prepared(
        self, q: Array, v: Array, a: Array, tau: Array, springs: TreeSprings | None = None
    ) -> Callable[[], None]:
        """Return what writes `forces` of m motions, contiguous arrays, into tau (m, nv).

        Those of springs are taken off.
        """
        m, n = len(q), self._split.njoints
        room = np.empty((m, n, 3, 3)), np.empty((m, n, 3))
        task = _TreeTask(m, *map(address, (q, v, a, self.armature, *room)), tau=address(tau),
                         springs=springs and springs.address)
        at_task = ctypes.byref(task)

        def work(alive: Any = (q, v, a, tau, springs, *room)) -> None:
            self.take_masses()
            self._library.tree_evaluate(self.handle, at_task)

        return work

    def spring_wrenches(self, q: Array, v: Array, springs: TreeSprings) -> tuple[Array, Array]:
        """Return wrenches (m, njoints, 6) of springs at m motions, and Jacobians (m, 6, nv).

        They act on the bodies of joints, about the world's origin, world axes.
        """
        m, n, nv = len(q), self._split.njoints, self.model.nv
        q, v, a = np.array(q, order="C"), np.array(v, order="C"), np.zeros((m, nv))
        columns, tau, wrenches = np.empty((m, 6, nv)), np.empty((m, nv)), np.empty((m, n, 6))
        task = _TreeTask(m, *map(address, (q, v, a, self.armature)), jacobian=address(columns),
                         tau=address(tau), springs=springs.address, of_springs=address(wrenches))
        self._library.tree_evaluate(self.handle, ctypes.byref(task))
        return wrenches[:, self._carriers], columns

    def transmitted(self, q: Array, v: Array, a: Array) -> Array:
        """Return the forces (njoints, 6) through the joints, world axes, about their origins.

        `pin.Data.f` has them in joint axes.
        """
        self.take_masses()
        wrench = self._moving[0]
        self._evaluate(q, v, a, tau=self._tau, wrench=wrench)
        wrench[0] = 0.0
        return wrench[self._carriers]

    def changes_task(self, products: TreeProducts) -> _TreeTask:
        """Return the task of `derivatives` and `products`, none from outside.

        It lacks the motion, the weights, and where `derivatives` go.
        """
        self.take_masses()
        n, nv, task = products.addresses[0], self.model.nv, _TreeTask.from_buffer_copy(self._task)
        values, by, bent = np.empty((3, n)), np.empty((2, 3 * n, nv)), np.empty((nv, nv))
        outside = np.zeros((self._split.njoints, 6))
        self._alive = task, values, by, bent, outside, products  # until the next one
        task.n_products, task.bodies, task.a_parts, task.b_parts = products.addresses
        task.outside, task.values, task.product_by_q, task.product_by_v, task.bent = map(
            address, (outside, values, by[0], by[1], bent))
        return task

    def at_many(self, q: Array, v: Array, a: Array) -> tuple[Array, Array, Array]:
        """Return placements (m, njoints, 4, 3), Jacobians (m, 6, nv) and forces (m, njoints, 6).

        They are as `placements`, `columns` and `transmitted`, of m motions.
        """
        self.take_masses()
        m, n, nv = len(q), self._split.njoints, self.model.nv
        given = [np.ascontiguousarray(x) for x in (q, v, a)]
        given = [x if x.flags.writeable else x.copy() for x in given]
        columns, tau, wrench = np.empty((m, 6, nv)), np.empty((m, nv)), np.empty((m, n, 6))
        rotations, positions = np.empty((m, n, 3, 3)), np.empty((m, n, 3))
        task = _TreeTask(m, *map(address, given), address(self.armature), *map(address, (
            rotations, positions, columns)), tau=address(tau), wrench=address(wrench))
        self._library.tree_evaluate(self.handle, ctypes.byref(task))
        at, placements = self._carriers, np.empty((m, self.model.njoints, 4, 3))
        np.matmul(self._tree.frames[at], rotations[:, at], out=placements[..., :3, :])
        placements[..., 3, :] = positions[:, at]
        wrench[:, 0] = 0.0
        return placements, columns, wrench[:, at]

    def derivatives(
        self, q: Array, v: Array, a: Array, outside: Array, out: Array, products: TreeProducts,
        weights: Array, bent: Array | None,
    ) -> None:
        """Find how `forces` change with q and v, as `pin.computeRNEADerivatives` does.

        They are right for joints whose motion subspace is constant. And second derivatives by q of
        a sum of n products with weights (n,).

        Args:
            q: configuration.
            v: joint velocities.
            a: joint accelerations.
            outside: (njoints, 6) wrenches on the bodies, world axes, about the joints' origins,
                that turn with their bodies.
            out: (2, nv, nv) zeros, to be filled with the transposed derivatives by q and by v.
            products: the products.
            weights: of these.
            bent: (nv, nv) zeros, to be filled: how a row's derivative changes with a column's q; or
                None.
        """
        self.take_masses()
        self._evaluate(q, v, a, products, outside=outside, by_q=out[0], by_v=out[1],
                       weights=weights, bent=bent)

    # ------------------------------------------------------------ products of vectors

    def packed_products(
        self, joints: NDArray[np.intp], a: Sequence[Mapping[int, Array]],
        b: Sequence[Mapping[int, Array]],
    ) -> TreeProducts:
        """Return products of vectors a and b, each given by its parts (4,) by joint, two at most.

        The joints in these stand for `joints` of the tree.
        """
        n, t = len(a), self._tree
        bodies, both = np.zeros((n, 2), np.int64), np.zeros((2, n, 2, 4))
        for row, vectors in enumerate(zip(a, b, strict=True)):
            carried = sorted(set().union(*vectors) - {0}, reverse=True)
            if len(carried) > 2 or (len(carried) == 2 and 0 in set().union(*vectors)):
                raise NotImplementedError("the kernel has no products of vectors on three bodies")
            for side, joint in enumerate([*carried, 0][:2]):
                body = self._carriers[joints[joint]]
                bodies[row, side] = body
                for parts, vector in zip(both, vectors, strict=True):
                    if joint in vector:
                        parts[row, side, :3] = t.frames[body].T @ vector[joint][:3]
                        parts[row, side, 3] = vector[joint][3]
        return TreeProducts(bodies, *both)

    def products(
        self, q: Array, v: Array, a: Array, products: TreeProducts
    ) -> tuple[Array, Array, Array]:
        """Return products and rates (3, n), and derivatives (3, n, nv) by q, then by v."""
        n = products.addresses[0]
        values, by_q, by_v = np.empty((3, n)), *np.zeros((2, 3, n, self.model.nv))
        self._evaluate(q, v, a, products, values=values, product_by_q=by_q, product_by_v=by_v)
        return values, by_q, by_v

    @made_once
    def mass_entries(self, all_joints: bool) -> MassEntries:
        """Return rows, columns and indices in `masses` of all entries that can be other than zero.

        Of the core alone the others are units, each with a number of its own behind those of
        `eliminate`.
        """
        t, rows, columns = self._tree, [], []
        for joint in range(1, self._split.njoints):
            first = int(t.iv[joint])
            if not (all_joints or self.is_core[first]):
                continue
            before: list[int] = []
            up = int(t.parent[joint])
            while up:
                before += range(t.iv[up], t.iv[up] + self._split.nvs[up])
                up = int(t.parent[up])
            for v in range(first, first + self._split.nvs[joint]):
                columns.append(np.array([*range(first, v + 1), *before], np.intp))
                rows.append(np.full(len(columns[-1]), v, np.intp))
        others = np.arange(0) if all_joints else np.flatnonzero(~self.is_core)
        row, column = (np.concatenate([*x, others]) for x in (rows, columns))
        indices, off_diagonal = np.arange(len(row)), np.flatnonzero(row != column)
        return (np.concatenate([row, column[off_diagonal]]),
                np.concatenate([column, row[off_diagonal]]),
                np.concatenate([indices, off_diagonal]))

    def masses(self, q: Array, out: Array) -> None:
        """Write the numbers of the mass matrix at q (nq,), by `mass_entries`."""
        self.take_masses()
        self._q[:] = q
        at = self._task
        self._library.tree_masses(self.handle, at.q, None, None, at.armature, address(out), None)

    def mass_matrix(self, q: Array) -> Array:
        """Return the mass matrix (nv, nv) at q (nq,)."""
        rows, columns, indices = self.mass_entries(True)
        numbers, matrix = np.empty(len(rows)), np.zeros((self.model.nv, self.model.nv))
        self.masses(q, numbers)
        matrix[rows, columns] = numbers[indices]
        return matrix

    # ------------------------------------------------------------ accelerations

    def respond(self, q: Array, v: Array, forces: Array) -> bool:
        """Make joint forces (n, nv) the accelerations of an open tree under them alone.

        Returns:
            Whether every freedom has inertia; if not, they stay.
        """
        self.take_masses()
        self._q[:], self._v[:] = q, v
        at, none = self._task, np.zeros((3, self.model.nv))
        code = self._library.tree_masses(self.handle, at.q, at.v, address(none[0]), at.armature,
                                         address(none[1]), address(none[2]))
        if code not in (DONE, SINGULAR):
            check(code)
        if forces.size and not code:  # or there are no joints
            rows = address(forces)
            self._library.tree_accelerations(
                self.handle, len(forces), rows, None, rows, None, None)
        return not code
