"""A mechanism whose dimensions are freedoms of its joints and frames.

A dimension moves joints and frames on the bodies that carry them. As a floating joint in front of
each of them would move it too, all derivatives by q give those by dimensions. How the placements,
masses and levers in the file change is differenced (eighth order): its xacro can compute them in
any way. No loop is closed for that.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.assembly.state import State
from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.constraints.composite_joints import AXIAL, joint_kind
from spatial_pin.constraints.tree_motion import Motion
from spatial_pin.dimensions.sensitivity import AROUND, DIFFERENCE, EIGHTH
from spatial_pin.dimensions.variants import Variants, copied
from spatial_pin.errors import SpatialPinError
from spatial_pin.formats.xacro.xacro_arguments import written_dimensions
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array

SHORTER = (1.0, 1.0 / 8.0, 1.0 / 64.0, 1.0 / 512.0)  # steps, where the file has no longer one


class MovedGeometry(NamedTuple):
    """A mechanism with a floating joint in front of what dimensions move.

    Attributes:
        mechanism: with these joints; closures and frames are those of the original.
        joint: (njoints,) number in it of each joint of the original.
        q, v: entries of the original in its configuration and velocity.
        moves: (nv, n) joint velocities there per unit rate of each dimension.
        inertias: (n, 10 (njoints - 1)) of the bodies' inertias, by dimension, as
            `pin.Inertia.toDynamicParameters` orders them; `moves` does not have them.
        levers: (n, 3) by link, of its centre of mass in its own frame.
        axes: (n, passives, 3) of the axes of idle rotations, in the frames of their joints.
    """

    mechanism: Mechanism
    joint: NDArray[np.intp]
    q: NDArray[np.intp]
    v: NDArray[np.intp]
    moves: Array
    inertias: Array
    levers: dict[str, Array]
    axes: Array

    def motion(self, state: State, a: Array) -> Motion:
        """Return q, v and a of the mechanism with more joints, which stand still."""
        q, v, wide = self.mechanism.neutral.copy(), *np.zeros((2, self.mechanism.model.nv))
        q[self.q], v[self.v], wide[self.v] = state.q, state.v, a
        return q, v, wide


class _Placed(NamedTuple):
    """What a dimension may change in a mechanism, axes of joints turned to the nominal ones."""

    joints: list[pin.SE3]
    frames: list[pin.SE3]
    inertias: Array
    axes: list[Array]
    levers: dict[str, Array]

    @classmethod
    def of(cls, mechanism: Mechanism, nominal: Mechanism) -> _Placed:
        model = mechanism.model
        back = [_turn(model.joints[i], nominal.model.joints[i]) for i in range(model.njoints)]
        joints = [back[model.parents[i]] * model.jointPlacements[i] * back[i].inverse()
                  for i in range(model.njoints)]
        frames = [back[f.parentJoint] * f.placement for f in model.frames]
        inertias = np.concatenate([np.zeros(0), *(
            back[i].act(model.inertias[i]).toDynamicParameters()
            for i in range(1, model.njoints))])
        axes = [back[joint].rotation @ axis for joint, axis in (
            constraints_of(mechanism).idle_axes if mechanism.passives else ())]
        levers = {name: x.lever for name, x in mechanism.inertias.items()}
        return cls(joints, frames, inertias, axes, levers)


def _turn(joint: pin.JointModel, nominal: pin.JointModel) -> pin.SE3:
    """Return the least rotation that takes the axis of a joint to the nominal one."""
    if joint.nv == 1 and nominal.shortname().removeprefix("JointModel")[0] in AXIAL:
        own, wanted = (joint_kind(x.extract())[1] for x in (joint, nominal))
        if own is not None and not np.array_equal(own, wanted):
            return pin.SE3(pin.Quaternion.FromTwoVectors(own, wanted).matrix(), np.zeros(3))
    return pin.SE3.Identity()


def moved_geometry(
    mechanism: Mechanism, variants: Variants | None, dimensions: Mapping[str, float],
    with_masses: bool,
) -> MovedGeometry:
    """Return the mechanism, which has some dimensions, with joints that these move.

    Args:
        mechanism: at these dimensions.
        variants: makes it at others; None where there are no dimensions.
        dimensions: names and values.
        with_masses: whether inertias and levers are wanted.

    Raises:
        SpatialPinError: there is no such mechanism at dimensions nearby.
    """
    own, slopes = _Placed.of(mechanism, mechanism), []
    for name, value in dimensions.items():
        size = abs(value) or mechanism.characteristic_length
        slopes.append(_differences(mechanism, variants, name, value, DIFFERENCE * size, own,
                                   with_masses))
    n, model = len(slopes), mechanism.model
    joint_moves, frame_moves = (
        np.array([s[k] for s in slopes]).reshape(n, count, 6)
        for k, count in enumerate((model.njoints, model.nframes)))
    mechanism_of, joint, moved = _with_floating_joints(
        mechanism, joint_moves.any(axis=(0, 2)), frame_moves.any(axis=(0, 2)))
    larger = mechanism_of.model
    q, v = (np.concatenate([np.zeros(0, np.intp), *(
        np.arange(first[j], first[j] + count[j])
        for j in joint[1:].tolist())]).astype(np.intp)
        for first, count in ((larger.idx_qs, larger.nqs), (larger.idx_vs, larger.nvs)))
    moves = np.zeros((larger.nv, n))
    for (is_joint, k), j in moved.items():
        own_moves = joint_moves[:, k] if is_joint else frame_moves[:, k]
        moves[larger.idx_vs[j] : larger.idx_vs[j] + 6] = own_moves.T
    inertias, axes = (np.array([s[k] for s in slopes]).reshape(n, *shape) for k, shape in (
        (2, (10 * (model.njoints - 1),)), (3, (len(own.axes), 3))))
    levers = {name: np.array([s[4][name] for s in slopes]).reshape(n, 3) for name in own.levers}
    return MovedGeometry(mechanism_of, joint, q, v, moves, inertias, levers, axes)


def _differences(
    mechanism: Mechanism, variants: Variants | None, name: str, value: float, step: float,
    own: _Placed, with_masses: bool,
) -> tuple[Array, Array, Array, Array, dict[str, Array]]:
    """Return derivatives for a dimension: of joints (.., 6), frames, inertias, axes, levers."""
    assert variants is not None
    if written_dimensions(mechanism.content, [name]):
        raise SpatialPinError(
            f"mechanism {mechanism.name!r}: the mechanism file itself computes with {name!r}; a "
            "function has derivatives for dimensions of the tree (xacro) alone: "
            "`sensitivity` differences the others")
    first: SpatialPinError | None = None
    for part in SHORTER:
        h = step * part
        try:
            around = variants.several([{**_dimensions(mechanism, variants), name: value + k * h}
                                       for k in AROUND],
                                      with_masses and not variants.has_masses)
            break
        except SpatialPinError as error:
            first = first or error
    else:
        assert first is not None
        raise first
    at = {k: _Placed.of(x, mechanism) for k, x in zip(AROUND, around, strict=True)}

    def twists(k: int, which: int) -> Array:
        return np.array([pin.log6(was.actInv(new)).vector
                         for was, new in zip(own[which], at[k][which], strict=True)])

    def slope(f: dict[int, Array]) -> Array:
        return sum(w * (f[k] - f[-k]) for k, w in EIGHTH.items()) / h

    joints, frames = (slope({k: twists(k, which) for k in at}) for which in (0, 1))
    inertias = slope({k: x.inertias for k, x in at.items()})
    axes = slope({k: np.array(x.axes).reshape(-1, 3) for k, x in at.items()})
    levers = {link: slope({k: x.levers[link] for k, x in at.items()}) for link in own.levers}
    return joints, frames, inertias, axes, levers


def _dimensions(mechanism: Mechanism, variants: Variants) -> dict[str, float]:
    return {name: mechanism.dimensions[name] for name in variants.names}


def _with_floating_joints(
    mechanism: Mechanism, joints: Sequence[bool], frames: Sequence[bool]
) -> tuple[Mechanism, NDArray[np.intp], dict[tuple[bool, int], int]]:
    """Return the mechanism with a floating joint in front of some joints and frames.

    Also the number in it of each joint, and of each floating joint by what it carries: (whether
    that is a joint, its number).
    """
    if not any(joints) and not any(frames):
        return (mechanism, np.arange(mechanism.model.njoints), {})
    model, out = mechanism.model, pin.Model()
    out.gravity, out.name = model.gravity, model.name
    number, moved, pairs = [0], dict[tuple[bool, int], int](), list[str]()

    def floating(parent: int, placement: pin.SE3, key: tuple[bool, int]) -> int:
        moved[key] = out.addJoint(parent, pin.JointModelFreeFlyer(), placement,
                                  f"dimensions of {'joint' if key[0] else 'frame'} {key[1]}")
        pairs.append("floating")
        return moved[key]

    for i in range(1, model.njoints):
        parent, placement = number[model.parents[i]], model.jointPlacements[i]
        if joints[i]:
            parent, placement = floating(parent, placement, (True, i)), pin.SE3.Identity()
        number.append(out.addJoint(parent, model.joints[i], placement, model.names[i]))
        pairs.append(mechanism.pairs[i - 1])
        out.inertias[number[-1]] = model.inertias[i]
    for k, frame in enumerate(model.frames):
        if k:  # the universe's own is there
            parent, placement = number[frame.parentJoint], frame.placement
            if frames[k]:
                parent, placement = floating(parent, placement, (False, k)), pin.SE3.Identity()
            out.addFrame(pin.Frame(frame.name, parent, 0, placement, frame.type), False)
    own = np.array(number)
    v = np.concatenate([np.arange(out.idx_vs[j], out.idx_vs[j] + out.nvs[j]) for j in number[1:]])

    def wide(x: Array, rest: float) -> Array:
        many = np.full(out.nv, rest)
        many[v] = x
        return many

    for name in ("armature", "damping", "upperDryFrictionLimit"):
        setattr(out, name, wide(getattr(model, name), 0.0))
    slip = wide(mechanism.slip_speeds, np.nan) if mechanism.slip_speeds.size else np.empty(0)
    larger = copied(mechanism, model=out, pairs=tuple(pairs), passives=(), guess={},
                    slip_speeds=slip, whole=None)
    for name in ("extent", "dimensions"):
        larger.__dict__[name] = getattr(mechanism, name)
    return larger, own, moved
