"""Closing frames of onshape-to-robot: links `closing_NAME_1` and `closing_NAME_2`.

The mate `closing_NAME` becomes a frame on either part; the two origins coincide. A revolute mate
writes also `closing_NAME_1_z` and `closing_NAME_2_z`, 0.1 m along the mate's axis, which coincide
too. The kinds of all other mates (ball, fastened, slider) are not written into the URDF, where
their frames say the common point only: they are balls. A closure of the same name in a mechanism
file says otherwise.
"""

from __future__ import annotations

import re

import numpy as np
import pinocchio as pin

from spatial_pin.formats.dialects.reading import Reading
from spatial_pin.numerics.linalg import Array

FRAME = re.compile(r"closing_(?P<name>.+)_(?P<side>[12])")
ROUNDED_ANGLE = 1e-5  # rad; of a mate's z axis to the point on it where files have six digits


def read_frames(reading: Reading) -> None:
    """Read the closing frames of a robot."""
    links = reading.links
    names = dict.fromkeys(found["name"] for found in map(FRAME.fullmatch, reading.links) if found)
    world = reading.world if names else {}
    for name in names:
        pair = [f"closing_{name}_{side}" for side in (1, 2)]
        for frame, other in (pair, pair[::-1]):
            if frame not in links:
                raise reading.fail(f"closing frame {other!r}", f"there is no {frame!r}, with which "
                                                               "it would coincide")
        on_axis = [f"{frame}_z" for frame in pair]
        present = [frame in links for frame in on_axis]
        if any(present) and not all(present):
            raise reading.fail(f"closing frame {on_axis[present.index(True)]!r}",
                               f"there is no {on_axis[present.index(False)]!r}, with which it "
                               "would coincide")
        _close(f"closing_{name}", pair, on_axis if all(present) else None, world, reading)


def _close(name: str, pair: list[str], on_axis: list[str] | None, world: dict[str, pin.SE3],
           reading: Reading) -> None:
    source, kind = "onshape-to-robot closing frames", "spherical"
    if on_axis is not None:
        axes = [_axis(*both, world, reading) for both in zip(pair, on_axis, strict=True)]
        if any(abs(axis[:2]).max() >= ROUNDED_ANGLE or axis[2] <= 0.0 for axis in axes):
            ends = [(frame, pin.SE3.Identity()) for frame in pair]
            reading.close(name, "revolute", source, ends, (axes[0], axes[1]))
            return
        kind = "revolute"
    reading.add("closures", {"name": name, "type": kind, "frames": pair, "source": source})


def _axis(frame: str, tip: str, world: dict[str, pin.SE3], reading: Reading) -> Array:
    """Return the direction from a frame to the point on the mate's axis, in the frame's axes."""
    offset = world[frame].actInv(world[tip]).translation
    return reading.unit(np.array(offset), f"closing frame {tip!r}")
