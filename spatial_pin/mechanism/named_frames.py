"""Frames by name, and frames that a URDF does not have."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from spatial_pin._support.checks import finite_array
from spatial_pin.errors import MechanismFileError, UnknownNameError


@dataclass(frozen=True)
class Frame:
    """A frame that the URDF does not have.

    Attributes:
        name: the frame's name.
        link: the link, frame or joint that it is fixed to.
        xyz: its origin in the axes of `link` [m].
        rpy: its orientation there, as URDF has it: turns about fixed x, y, z in this order [rad].

    Example:
        >>> sp.Frame("tool", "rocker", xyz=(0.0, 0.0, 0.1)).placement.translation  # [m]
        array([0. , 0. , 0.1])
    """

    name: str
    link: str
    xyz: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        for what in ("xyz", "rpy"):
            finite_array(getattr(self, what), (3,), f"{what} of frame {self.name!r}")

    @property
    def placement(self) -> pin.SE3:
        """Its placement on `link`."""
        return pin.SE3(pin.rpy.rpyToMatrix(*self.rpy), np.array(self.xyz))


def frames_by_name(model: pin.Model) -> dict[str, int]:
    """Return Pinocchio's frame index by name; a link goes before a joint of the same name."""
    ranks = {pin.FrameType.BODY: 0, pin.FrameType.JOINT: 1}
    kinds = [frame.type for frame in model.frames]
    order = sorted(range(1, model.nframes), key=lambda i: -ranks.get(kinds[i], 2))
    return {model.frames[i].name: i for i in order}


def add_frames(model: pin.Model, frames: Mapping[str, Frame], where: str) -> None:
    """Put frames into a model, each after the one that it is fixed to.

    Raises:
        MechanismFileError: a name is taken, or is not there, or frames are fixed to each other.
    """
    known = frames_by_name(model)
    for name in frames:
        if name in known or not name or not name.isprintable():
            raise MechanismFileError(
                f"{where}: frames.{name}: " + ("the tree has a link, joint or frame of that name "
                                               "already; choose another" if name in known else
                                               "a frame needs a name that can be read"))
    for name in frames:
        way: dict[str, None] = {}
        while name not in known:
            if name in way:
                raise MechanismFileError(
                    f"{where}: frames.{name}: hangs on itself: {' on '.join([*way, name])}")
            if name not in frames:
                last = next(reversed(way))
                raise MechanismFileError(f"{where}: frames.{last}: link: " + str(
                    UnknownNameError("link, joint or frame", name, [*known, *frames])))
            way[name] = None
            name = frames[name].link
        for new in reversed(way):
            on = model.frames[known[frames[new].link]]
            known[new] = model.addFrame(pin.Frame(
                new, on.parentJoint, known[frames[new].link],
                on.placement * frames[new].placement, pin.FrameType.OP_FRAME), False)
