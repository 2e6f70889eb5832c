"""A mechanism whose dimensions are freedoms of its joints and frames.

A dimension moves joints and frames on the bodies that carry them. As a floating joint in front of
each of them would move it too, all derivatives by q give those by dimensions. How placements and
masses follow from the dimensions is differenced (eighth order), as the file's expressions can be
any: no loop is closed for that.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.assembly.state import State
from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.constraints.composite_joints import AXIAL, joint_kind
from spatial_pin.constraints.trees import Motion
from spatial_pin.dimensions.traced_tree import PlacementBatch, TracedTree, copied
from spatial_pin.dimensions.variants import Variants
from spatial_pin.errors import SpatialPinError
from spatial_pin.formats.xacro.xacro_arguments import written_dimensions
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array

# Step of differences relative to the dimension, or characteristic length (1 for angles) if it is
# zero. Eighth order has an error of 1e-21, and round-off 4e-15 over the step.
DIFFERENCE = 2e-3
AROUND = (1, -1, 2, -2, 3, -3, 4, -4)  # steps at which geometry or outputs are evaluated
# weights of eighth and of sixth order there, for a step of one; the difference tells the error
EIGHTH, SIXTH = (np.array([np.sign(k) * weights.get(abs(k), 0.0) for k in AROUND]) for weights in (
    {1: 4 / 5, 2: -1 / 5, 3: 4 / 105, 4: -1 / 280}, {1: 3 / 4, 2: -3 / 20, 3: 1 / 60}))
SHORTER = (1.0, 1.0 / 8.0, 1.0 / 64.0, 1.0 / 512.0)  # steps, where the branch ends within one


class MovedGeometry(NamedTuple):
    """A mechanism with a floating joint before each joint and frame that dimensions move.

    Attributes:
        mechanism: with these joints; closures and frames are those of the original.
        joint: (njoints,) number in it of each joint of the original.
        q, v: entries of the original in its configuration and velocity.
        moves: (nv, n) joint velocities there per unit rate of each dimension.
        inertias: (n, 10 (njoints - 1)) of the bodies' inertias, by dimension, as
            `pin.Inertia.toDynamicParameters` orders them; `moves` does not have them.
        levers: (n, 3) by link, of its centre of mass in its own frame, where it changes.
        axes: (n, passives, 3) of the axes of idle rotations, in the frames of their joints.
        written: dimensions that the mechanism file itself computes with, by number: weights of the
            mechanisms around, and these.
        steps: (n,) of the differences.
    """

    mechanism: Mechanism
    joint: NDArray[np.intp]
    q: NDArray[np.intp]
    v: NDArray[np.intp]
    moves: Array
    inertias: Array
    levers: dict[str, Array]
    axes: Array
    written: dict[int, tuple[Array, list[Mechanism]]]
    steps: Array

    def motion(self, state: State, a: Array) -> Motion:
        """Return q, v and a of the mechanism with added joints, which are at rest."""
        q, v, wide = self.mechanism.neutral.copy(), *np.zeros((2, self.mechanism.model.nv))
        q[self.q], v[self.v], wide[self.v] = state.q, state.v, a
        return q, v, wide


# Geometry at several sets of dimensions: placements of joints and frames, by whether it is a joint
# and its number; inertias of joints (s or 1, 10); levers (s or 1, 3) of links; axes (s or 1, 3) of
# idle rotations. Constant placements are missing. Axes of joints are turned to those of the
# mechanism itself, the bodies with them.
Sampled = tuple[
    dict[tuple[bool, int], PlacementBatch], dict[int, Array], dict[str, Array], list[Array]]


def difference_steps(mechanism: Mechanism, own: Array) -> Array:
    """Return the steps (n,) of differences for dimensions with the values (n,)."""
    steps: Array = DIFFERENCE * np.where(own != 0.0, np.abs(own), mechanism.characteristic_length)
    return steps


def moved_geometry(
    mechanism: Mechanism, variants: Variants | None, with_masses: bool,
    stencils: Sequence[Array] = (EIGHTH,),
) -> MovedGeometry:
    """Return a mechanism with joints that its dimensions move.

    Without variants there are no dimensions. `with_masses`: whether inertias and levers are wanted.
    With several stencils all dimensions count once for each.

    Raises:
        SpatialPinError: there is no such mechanism at dimensions nearby.
    """
    names, model = [] if variants is None else variants.names, mechanism.model
    n = len(names) * len(stencils)
    own = np.array([mechanism.dimensions[name] for name in names])
    steps = difference_steps(mechanism, own)
    if variants is None:
        sampled: Sampled = {}, {}, {}, []
        written = dict[int, list[Mechanism]]()
    else:
        sampled, written, steps = _around(mechanism, variants, own, steps, with_masses)
    weights = np.vstack([np.kron(np.diag(1.0 / steps), stencil) for stencil in stencils])

    def slope(x: Array) -> Array:
        """Return derivatives (n, ...) from samples (1 + 8 n, ...), the first at the dimensions."""
        return np.tensordot(weights, x[1:], 1) if len(x) > 1 else np.zeros((n, *x.shape[1:]))

    poses, bodies, levers, idle = sampled
    twists = {key: _twists(pose, slope) for key, pose in poses.items()}
    moving = {key for key, x in twists.items() if x.any()}
    larger, joint, moved = _with_floating_joints(mechanism, moving)
    q, v = (_entries(first, count, joint.tolist()) for first, count in (
        (larger.model.idx_qs, larger.model.nqs), (larger.model.idx_vs, larger.model.nvs)))
    moves, inertias = np.zeros((larger.model.nv, n)), np.zeros((n, model.njoints - 1, 10))
    for key, j in moved.items():
        moves[larger.model.idx_vs[j] : larger.model.idx_vs[j] + 6] = twists[key].T
    for i, x in bodies.items():
        inertias[:, i - 1] = slope(x)
    axes = np.zeros((n, len(mechanism.passives), 3))
    for i, x in enumerate(idle):
        axes[:, i] = slope(x)
    return MovedGeometry(
        larger, joint, q, v, moves, inertias.reshape(n, 10 * (model.njoints - 1)),
        {name: slope(x) for name, x in levers.items()}, axes,
        {k + i * len(names): (stencil / steps[k], around) for k, around in written.items()
         for i, stencil in enumerate(stencils)}, steps)


def _twists(pose: PlacementBatch, slope: Callable[[Array], Array]) -> Array:
    """Return the twists (n, 6) of a placement, in its own axes."""
    turn = pose.rotation[0].T
    spun = turn @ slope(pose.rotation)
    skew = 0.5 * (spun - spun.swapaxes(1, 2))
    return np.column_stack([slope(pose.translation) @ turn.T, skew[:, 2, 1], skew[:, 0, 2],
                            skew[:, 1, 0]])


def _around(
    mechanism: Mechanism, variants: Variants, own: Array, steps: Array, with_masses: bool
) -> tuple[Sampled, dict[int, list[Mechanism]], Array]:
    """Return samples at dimensions (n,) and at eight values around each, those of the file too.

    Also the steps, which are shorter where there is no mechanism within them.
    """
    file_itself = written_dimensions(mechanism.content, variants.names)
    tree = None if file_itself else variants.tree
    if tree is not None and (tree.turns_axes or (with_masses and not tree.has_masses)):
        tree = None
    first: SpatialPinError | None = None
    for part in SHORTER:
        h = steps * part
        every = np.hstack([own[:, None], own[:, None] + np.kron(np.diag(h), AROUND)])
        if tree is not None:
            sampled = _traced(mechanism, tree, every, with_masses)
            if sampled is not None:
                return sampled, {}, h
        try:
            several = variants.several(
                [dict(zip(variants.names, x, strict=True)) for x in every.T.tolist()],
                with_masses)
        except SpatialPinError as error:
            first = first or error
            continue
        for x in several:  # lengths are relative to the same one
            x.__dict__["extent"] = mechanism.extent
        written = {k: several[1 + 8 * k : 9 + 8 * k]
                   for k, name in enumerate(variants.names) if name in file_itself}
        return _loaded(mechanism, several), written, h
    assert first is not None
    raise first


def _traced(
    mechanism: Mechanism, tree: TracedTree, dimensions: Array, with_masses: bool
) -> Sampled | None:
    """Return the samples of a traced file at dimensions (n, s); None if some are not traced."""
    at, model = tree.at(dimensions, with_masses), mechanism.model
    if not at.holds.all():
        return None
    inertias: dict[int, Array] = {}
    several = tree.inertias_at(at.inertials) if with_masses else {}
    for name, own in mechanism.inertias.items() if with_masses else ():
        k = mechanism.frame_ids.get(name, 0)
        joint = model.frames[k].parentJoint
        if joint and (name in several or k in at.frames):
            pose, there = at.frame(model, k), several.get(name, [own])
            inertias[joint] = inertias.get(joint, 0.0) + np.array([
                pose.at(j).act(there[j % len(there)]).toDynamicParameters()
                for j in range(dimensions.shape[1])])
    axes = [at.idle_axis(mechanism, mechanism.frame_on_joint(passive.body)[0], passive.axis)
            for passive in mechanism.passives]
    poses = {(is_joint, k): pose for is_joint, some in ((True, at.joints), (False, at.frames))
             for k, pose in some.items()}
    return poses, inertias, at.levers, axes


def _loaded(mechanism: Mechanism, several: Sequence[Mechanism]) -> Sampled:
    """Return the samples of mechanisms."""
    model, poses = mechanism.model, dict[tuple[bool, int], list[pin.SE3]]()
    inertias: list[list[Array]] = [[] for _ in range(model.njoints)]
    axes: list[list[Array]] = [[] for _ in mechanism.passives]
    names = [frame.name for frame in model.frames]
    for x in several:
        if [frame.name for frame in x.model.frames] != names:
            raise SpatialPinError(
                f"mechanism {mechanism.name!r}: it has other links or frames at dimensions "
                f"{dict(x.parameters)}, so that there are no derivatives by these")
        back = [_turn(x.model.joints[i], model.joints[i]) for i in range(model.njoints)]
        for i in range(1, model.njoints):
            poses.setdefault((True, i), []).append(
                back[model.parents[i]] * x.model.jointPlacements[i] * back[i].inverse())
            inertias[i].append(back[i].act(x.model.inertias[i]).toDynamicParameters())
        for k, frame in enumerate(x.model.frames):
            poses.setdefault((False, k), []).append(back[frame.parentJoint] * frame.placement)
        for known, (joint, axis) in zip(
                axes, constraints_of(x).idle_axes if axes else (), strict=True):
            known.append(back[joint].rotation @ axis)
    moved = {key: PlacementBatch(np.array([x.rotation for x in some]),
                                 np.array([x.translation for x in some]))
             for key, some in poses.items() if any(x != some[0] for x in some)}
    return (moved, {i: np.array(x) for i, x in enumerate(inertias) if i},
            {name: np.array([x.inertias[name].lever for x in several])
             for name in mechanism.inertias}, [np.array(x) for x in axes])


def _turn(joint: pin.JointModel, nominal: pin.JointModel) -> pin.SE3:
    """Return the least rotation that takes the axis of a joint to the nominal one."""
    if joint.nv == 1 and nominal.shortname().removeprefix("JointModel")[0] in AXIAL:
        own, wanted = (joint_kind(x.extract())[1] for x in (joint, nominal))
        if own is not None and wanted is not None and not np.array_equal(own, wanted):
            return pin.SE3(pin.Quaternion.FromTwoVectors(own, wanted).matrix(), np.zeros(3))
    return pin.SE3.Identity()


def _with_floating_joints(
    mechanism: Mechanism, moving: Collection[tuple[bool, int]]
) -> tuple[Mechanism, NDArray[np.intp], dict[tuple[bool, int], int]]:
    """Return the mechanism with a floating joint in front of some joints and frames.

    These are given, and returned, as (whether it is a joint, its number). Also returned is the
    number in the mechanism of each joint, and of each floating joint by what it carries.
    """
    if not moving:
        return mechanism, np.arange(mechanism.model.njoints), {}
    model, out = mechanism.model, pin.Model()
    out.gravity, out.name = model.gravity, model.name
    number, moved, pairs = [0], dict[tuple[bool, int], int](), list[str]()

    def carrier(parent: int, placement: pin.SE3, key: tuple[bool, int]) -> tuple[int, pin.SE3]:
        """Return parent and placement of a joint or frame, behind a floating joint if it moves."""
        is_joint, k = key
        if key not in moving:
            return number[parent], placement
        moved[key] = out.addJoint(number[parent], pin.JointModelFreeFlyer(), placement,
                                  f"dimensions of {'joint' if is_joint else 'frame'} {k}")
        pairs.append("floating")
        return moved[key], pin.SE3.Identity()

    for i in range(1, model.njoints):
        at = carrier(model.parents[i], model.jointPlacements[i], (True, i))
        number.append(out.addJoint(at[0], model.joints[i], at[1], model.names[i]))
        pairs.append(mechanism.pairs[i - 1])
        out.inertias[number[-1]] = model.inertias[i]
    for k, frame in enumerate(model.frames):
        if k:  # the universe's own is there
            parent, placement = carrier(frame.parentJoint, frame.placement, (False, k))
            out.addFrame(pin.Frame(frame.name, parent, 0, placement, frame.type), False)
    v = _entries(out.idx_vs, out.nvs, number)

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
    return larger, np.array(number), moved


def _entries(first: Sequence[int], count: Sequence[int], joints: Sequence[int]) -> NDArray[np.intp]:
    """Return the entries of joints in a vector, without those of the universe."""
    return np.concatenate([np.zeros(0, np.intp), *(
        np.arange(first[j], first[j] + count[j], dtype=np.intp) for j in joints[1:])])
