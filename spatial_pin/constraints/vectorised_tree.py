"""Placements, joint Jacobians and rates of many configurations together, over flat arrays.

The constants come from the Pinocchio model, every number agrees with Pinocchio to round-off; what
is saved is Python's price for a call per configuration. Configurations lie along the last axis.
World vectors are kept as five rows (x, y, z, x, y), so that a cross product is two products of
slices and a difference.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.constraints.composite_joints import split_of
from spatial_pin.constraints.sample_coefficients import Varying, times
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array

WRAPPED = [0, 1, 2, 0, 1]


def dot(x: Array, y: Array) -> Array:
    """Return x . y of world vectors (..., 5, m)."""
    return (x[..., :3, :] * y[..., :3, :]).sum(axis=-2)


def cross(x: Array, y: Array) -> Array:
    """Return x × y of world vectors (..., 5, m)."""
    first = x[..., 1:4, :] * y[..., 2:5, :]
    first -= x[..., 2:5, :] * y[..., 1:4, :]
    return np.concatenate([first, first[..., :2, :]], axis=-2)


class FlatJoint(NamedTuple):
    """A joint of one kind: "turn", "slide", "screw", "ball" or "free".

    What it is made of may be `Varying`, as configurations of different dimensions have it.

    Attributes:
        at, parent: joints of the split model.
        q, v: its first places in configuration and velocity.
        n: number of its freedoms.
        turned: (9, 3) parts of its rotation that are constant, times cosine and times sine, each
            three columns in the parent's axes; (3, 3) the placement alone if it does not turn
            about an axis.
        offset: (3,) origin in the parent's axes [m].
        axis: (3,) in its own axes.
        pitch: slide per radian [m/rad].
    """

    kind: str
    at: int
    parent: int
    q: int
    v: int
    n: int
    turned: Any
    offset: Any
    axis: Any
    pitch: Any


class FlatTree:
    """The tree of a mechanism as constants.

    Attributes:
        carrier: joint of the split model that carries the body of each joint.
        n_joints: number of joints of the split model, the ground included.
        joints: all but the ground, parents first.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        model, self.carrier = split_of(mechanism)
        self.n_joints, self.nv, self.nq = model.njoints, model.nv, model.nq
        self.joints = [_joint(model, i) for i in range(1, model.njoints)]
        self._moved = np.repeat(np.arange(model.njoints), model.nvs)  # joint of each freedom

    def place(self, q: Array) -> Array:
        """Return G (njoints, 4, 5, m): columns of R, then p, at the configurations q (nq, m)."""
        g = np.empty((self.n_joints, 4, 5, q.shape[1]))
        g[0] = 0.0
        for axis, row in ((0, 0), (0, 3), (1, 1), (1, 4), (2, 2)):
            g[0, axis, row] = 1.0
        for j in self.joints:
            parent, own = g[j.parent], g[j.at]
            if j.parent or isinstance(j.turned, Varying) or isinstance(j.offset, Varying):
                own[3] = parent[3] + times(j.offset, parent[:3])
                parts = times(j.turned, parent[:3])
            else:  # the axes of the ground are those of the world
                own[3], parts = j.offset[WRAPPED, None], j.turned[:, WRAPPED, None]
            if j.kind in ("ball", "free"):
                _place_ball(j, q, parts, own)
                continue
            if j.kind == "slide":
                own[:3] = parts
            else:
                np.multiply(parts[3:6], np.cos(q[j.q]), out=own[:3])
                own[:3] += parts[6:] * np.sin(q[j.q])
                own[:3] += parts[:3]
            if j.kind != "turn":
                own[3] += times(j.axis, own[:3]) * (j.pitch * q[j.q])
        return g

    def columns(self, g: Array) -> Array:
        """Return the world joint Jacobian (6, nv, m), linear first, at the world origin."""
        turns, slides = np.zeros((2, self.nv, 5, g.shape[3]))
        for j in self.joints:
            axes = _axes(j, g[j.at])
            if j.kind != "slide":
                at = j.v + 3 * (j.kind == "free")
                turns[at : at + len(axes)] = axes
            if j.kind in ("slide", "screw"):
                slides[j.v] = j.pitch * axes[0]
            elif j.kind == "free":
                slides[j.v : j.v + 3] = axes
        slides += cross(g[self._moved, 3], turns)
        return np.concatenate([slides[:, :3], turns[:, :3]], axis=1).swapaxes(0, 1)

    def rates(self, g: Array, v: Array) -> tuple[Array, Array]:
        """Return rates at zero joint acceleration.

        Args:
            g: of `place`.
            v: (nv, m) joint velocities.

        Returns:
            (njoints, 2, 5, m) angular velocity and velocity of the joint origins, and
            (njoints, 2, 5, m) the same accelerations, classical; world axes.
        """
        m = g.shape[3]
        first, second = np.zeros((2, self.n_joints, 2, 5, m))
        for j in self.joints:
            axes = _axes(j, g[j.at])
            w, speed = first[j.parent]
            alpha, acceleration = second[j.parent]
            if j.parent:
                arm = g[j.at, 3] - g[j.parent, 3]
                swing = cross(w, arm)
                speed = speed + swing
                acceleration = acceleration + cross(alpha, arm) + cross(w, swing)
            sliding = None
            if j.kind in ("slide", "screw"):
                sliding = axes[0] * (j.pitch * v[j.v])
            elif j.kind == "free":
                sliding = (axes * v[j.v : j.v + 3, None]).sum(axis=0)
            if j.kind != "slide":
                own = j.v + 3 * (j.kind == "free")
                turn = (axes * v[own : own + len(axes), None]).sum(axis=0)
                alpha = alpha + cross(w, turn) if j.parent else alpha
            if sliding is not None:
                # the slide is fixed in the body that it carries (of a screw and a free joint)
                speed = speed + sliding
                acceleration = acceleration + cross(w, sliding)
                acceleration += cross(w if j.kind != "free" else w + turn, sliding)
            if j.kind != "slide":
                w = w + turn
            first[j.at, 0], first[j.at, 1] = w, speed
            second[j.at, 0], second[j.at, 1] = alpha, acceleration
        return first, second

    def entry_rates(self, q: Array, v: Array, a: Array) -> tuple[Array, Array]:
        """Return first and second derivatives (nq, m) of the entries of configurations q (nq, m).

        For joint velocities v and accelerations a, both (nv, m).
        """
        first, second = np.empty_like(q), np.empty_like(q)
        for j in self.joints:
            if j.kind not in ("ball", "free"):
                first[j.q], second[j.q] = v[j.v], a[j.v]
                continue
            free = 3 * (j.kind == "free")
            p, w, alpha = (x[k : k + n] for x, k, n in ((q, j.q + free, 4), (v, j.v + free, 3),
                                                        (a, j.v + free, 3)))
            dp = 0.5 * _times(p, w)
            first[j.q + free : j.q + free + 4] = dp
            second[j.q + free : j.q + free + 4] = 0.5 * (_times(p, alpha) + _times(dp, w))
            if free:
                axes = _rotation(p)
                u, du = v[j.v : j.v + 3], a[j.v : j.v + 3]
                turning = np.array([w[k - 2] * u[k - 1] - w[k - 1] * u[k - 2] for k in range(3)])
                first[j.q : j.q + 3] = np.einsum("jim,jm->im", axes, u)
                second[j.q : j.q + 3] = np.einsum("jim,jm->im", axes, du + turning)
        return first, second

    def normalize(self, q: Array) -> None:
        """Scale the quaternions of q (nq, m) to one, in place."""
        for j in self.joints:
            if j.kind in ("ball", "free"):
                p = q[j.q + 3 * (j.kind == "free") :][:4]
                p /= np.sqrt(np.einsum("im,im->m", p, p))

    def displace(self, q: Array, step: Array) -> Array:
        """Return q (nq, m) moved by joint displacements (nv, m), exactly as `pin.integrate`."""
        moved = np.empty_like(q)
        for j in self.joints:
            if j.kind not in ("ball", "free"):
                moved[j.q] = q[j.q] + step[j.v]
                continue
            free = 3 * (j.kind == "free")
            p, w = q[j.q + free : j.q + free + 4], step[j.v + free : j.v + free + 3]
            half = 0.5 * np.sqrt((w * w).sum(axis=0))
            moved[j.q + free : j.q + free + 4] = (
                np.cos(half) * p + _times(p, 0.5 * np.sinc(half / np.pi) * w))
            if free:
                u = step[j.v : j.v + 3]
                moved[j.q : j.q + 3] = q[j.q : j.q + 3] + np.einsum(
                    "jim,jm->im", _rotation(p), _slid(u, w, half))
        self.normalize(moved)
        return moved

    def integrate(self, q: Array, step: Array) -> Array:
        """Return q (nq, m) moved by small joint displacements (nv, m), to second order in turns."""
        first, second = self.entry_rates(q, step, np.zeros_like(step))
        moved = q + first + 0.5 * second
        self.normalize(moved)
        return moved


def _joint(model: pin.Model, i: int) -> FlatJoint:
    joint = model.joints[i]
    joint = joint.extract() if hasattr(joint, "extract") else joint
    placement, name = model.jointPlacements[i], joint.shortname()
    kind, axis, pitch = _kind(joint, name)
    along = np.outer(axis, axis)
    rotation = placement.rotation
    turned = rotation.T.copy()
    if kind in ("turn", "screw"):
        parts = along, np.eye(3) - along, pin.skew(axis)
        turned = np.vstack([(rotation @ part).T for part in parts])
    return FlatJoint(kind, i, int(model.parents[i]), model.idx_qs[i], model.idx_vs[i], model.nvs[i],
                  turned, placement.translation.copy(), axis, pitch)


def _kind(joint: Any, name: str) -> tuple[str, Array, float]:
    if isinstance(joint, pin.JointModelSpherical):
        return "ball", np.zeros(3), 0.0
    if isinstance(joint, pin.JointModelFreeFlyer):
        return "free", np.zeros(3), 0.0
    has_axis = hasattr(joint, "axis")
    axis = np.array(joint.axis) if has_axis else np.eye(3)["XYZ".index(name[-1])]
    if name.startswith("JointModelR"):
        return "turn", axis, 0.0
    if name.startswith("JointModelP"):
        return "slide", axis, 1.0
    if name.startswith("JointModelH"):
        return "screw", axis, float(joint.pitch)
    raise NotImplementedError(f"no flat form of joint {name}")


def _axes(j: FlatJoint, own: Array) -> Array:
    """Return the axes (k, 5, m) of a joint's freedoms; those of a free joint serve twice."""
    if j.kind in ("ball", "free"):
        return own[:3]
    return times(j.axis, own[:3])[None]


def _place_ball(j: FlatJoint, q: Array, axes: Array, own: Array) -> None:
    free = 3 * (j.kind == "free")
    rotation = _rotation(q[j.q + free : j.q + free + 4])
    np.einsum("kxm,jkm->jxm", axes, rotation, out=own[:3])
    if free:
        own[3] += np.einsum("kxm,km->xm", axes, q[j.q : j.q + 3])


def _rotation(p: Array) -> Array:
    """Return rotations (3, 3, m), column by column, of unit quaternions (4, m) in (x, y, z, w)."""
    x, y, z, w = p
    xx, yy, zz = 2.0 * x * x, 2.0 * y * y, 2.0 * z * z
    xy, xz, yz = 2.0 * x * y, 2.0 * x * z, 2.0 * y * z
    wx, wy, wz = 2.0 * w * x, 2.0 * w * y, 2.0 * w * z
    return np.array([[1.0 - yy - zz, xy + wz, xz - wy],
                     [xy - wz, 1.0 - xx - zz, yz + wx],
                     [xz + wy, yz - wx, 1.0 - xx - yy]])


def _slid(u: Array, w: Array, half: Array) -> Array:
    """Return the slide of a screw motion with twist (u, w), both (3, m), and half its angle."""
    b = 0.5 * np.sinc(half / np.pi) ** 2  # (1 - cos t) / t²
    t = 2.0 * np.where(half < 0.1, 1.0, half)
    s = 4.0 * half * half
    series = (1.0 - s / 20.0 * (1.0 - s / 42.0 * (1.0 - s / 72.0 * (1.0 - s / 110.0)))) / 6.0
    c = np.where(half < 0.1, series, (t - np.sin(t)) / t**3)
    once = np.cross(w, u, axis=0)
    return u + b * once + c * np.cross(w, once, axis=0)


def _times(p: Array, w: Array) -> Array:
    """Return the product of quaternions (4, m) with pure ones (3, m)."""
    x, y, z, s = p
    a, b, c = w
    return np.array([s * a + y * c - z * b, s * b + z * a - x * c, s * c + x * b - y * a,
                     -(x * a + y * b + z * c)])


def flat_tree_of(mechanism: Mechanism) -> FlatTree:
    """Return the flat tree of a mechanism, made once."""
    if "flat tree" not in mechanism.memo:
        mechanism.memo["flat tree"] = FlatTree(mechanism)
    found: FlatTree = mechanism.memo["flat tree"]
    return found
