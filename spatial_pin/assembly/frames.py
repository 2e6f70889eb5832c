"""Where frames are and how they move: from the whole tree, or from a subtree of a large one.

A `pin.Data` of 400 freedoms takes 4 GB and seconds to make; a frame needs its own branch only.
"""

from __future__ import annotations

import pinocchio as pin

from spatial_pin.constraints.trees import Subtree, is_large, subtrees_of
from spatial_pin.lazy import made_once
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array


class FrameSubtree:
    """A subtree with its frames.

    Args:
        subtree: some branches of the tree.
        whole: the model of the tree.

    Attributes:
        model: of the branches.
        frames: place in it of frames of the whole model.
    """

    def __init__(self, subtree: Subtree, whole: pin.Model) -> None:
        self.model, self._q, self._v = subtree.model, subtree.q, subtree.v
        own = {0: 0} | {int(joint): k for k, joint in enumerate(subtree.joints.tolist(), start=1)}
        self.frames = {
            i: self.model.addFrame(pin.Frame(f"{i}", own[f.parentJoint], 0, f.placement, f.type))
            for i, f in enumerate(whole.frames) if f.parentJoint in own}

    def data(self, q: Array, v: Array, a: Array) -> pin.Data:
        """Return data with the kinematics of the branches at a motion of the whole tree."""
        data = self.model.createData()
        pin.forwardKinematics(self.model, data, q[self._q], v[self._v], a[self._v])
        pin.updateFramePlacements(self.model, data)
        return data


@made_once
def frame_subtrees(mechanism: Mechanism) -> list[FrameSubtree]:
    """Return the subtrees of a mechanism's tree, made once; none if it is taken whole."""
    if not is_large(mechanism.model):
        return []
    return [FrameSubtree(subtree, mechanism.model) for subtree in subtrees_of(mechanism.model)]


class Located:
    """A motion of a tree, asked for single frames.

    Args:
        mechanism: the mechanism.
        motion: its q (nq,), v and a (nv,).
    """

    def __init__(self, mechanism: Mechanism, motion: tuple[Array, Array, Array]) -> None:
        self._subtrees, self._motion = frame_subtrees(mechanism), motion
        self._known: dict[int, pin.Data] = {}

    @property
    def is_whole(self) -> bool:
        """Whether the tree is taken whole: then nothing is found here."""
        return not self._subtrees

    def find(self, frame: int) -> tuple[pin.Model, pin.Data, int]:
        """Return model and data of the subtree that a frame of the whole tree is on, and its place.

        Args:
            frame: Pinocchio's index of it.
        """
        for k, subtree in enumerate(self._subtrees):
            if frame in subtree.frames:
                if k not in self._known:
                    self._known[k] = subtree.data(*self._motion)
                return subtree.model, self._known[k], subtree.frames[frame]
        raise IndexError(f"no frame {frame}")
