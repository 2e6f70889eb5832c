"""Size and position of a machine: its characteristic length, and a centre close to it.

In site coordinates a machine of 3 m may be 5000 km from the world's origin. Numbers of that size
have seven digits fewer for what happens within it, so solvers work relative to the
centre. This loses no digit: the centre is a multiple of a power of two near the machine's size.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.errors import MechanismFileError
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import EPS, TOLERANCES

SMALLEST = 1.0 / TOLERANCES.largest  # m
# The world's origin, and a frame of the ground without joints, are near a machine within this many
# of its sizes. Coordinates there have all digits but two bits.
SIZES_NEAR = 3.0
# Ratio of lengths of links beyond which pivots of closures fall below the threshold of singularity.
UNLIKE = 1e6


class Extent(NamedTuple):
    """Size of a machine and where it is.

    Attributes:
        length: largest distance between two frames of it at neutral [m]; 1 if 0.
        centre: (3,) close to the middle of these [m]; zero along axes along which the world's
            origin is near.
        frames: which frames count.
        resolution: resolution of coordinates in the world, relative to the length [-]: half a
            unit of the last digit of each of two; 0 if the origin is near.
    """

    length: float
    centre: Array
    frames: NDArray[np.bool_]
    resolution: float


def extent_of(model: pin.Model, joined: Collection[int], where: str) -> Extent:
    """Return the extent of a machine; closures join the frames `joined`.

    Frames of the ground that nothing is joined to, the world's own among them, count where they are
    near the moving and joined parts.

    Raises:
        MechanismFileError: it is so small or large that squares leave the range of numbers.
    """
    joints = [pin.SE3.Identity()]  # every joint is the identity at neutral
    for parent, placement in zip(model.parents[1:], model.jointPlacements[1:], strict=True):
        joints.append(joints[parent] * placement)
    points = np.array([joints[f.parentJoint].act(f.placement.translation) for f in model.frames])
    reach = np.abs(points).max(axis=1)
    span = float(reach.max())
    if not span <= 1.0 / SMALLEST:  # it may be infinite, or NaN
        raise _size_error(model, where, span, int(np.argmax(reach)))
    unit = 2.0 ** math.frexp(span)[1]  # changes no digit
    points /= unit
    away = np.linalg.norm(points, axis=1) > EPS  # bodies of a drawing have the world's frame
    own = np.array([i in joined or (f.parentJoint != 0 and (
        away[i] or f.type == pin.FrameType.JOINT)) for i, f in enumerate(model.frames)])
    near, centre = np.ones(len(points), dtype=bool), np.zeros(3)
    if own.any():
        size = diameter(points[own])
        if not size:  # how far mass is from the joints
            heavy = [x for x in list(model.inertias)[1:] if x.mass > 0.0]
            arms = [float(np.linalg.norm(x.lever) + np.sqrt(np.abs(x.inertia).max() / x.mass))
                    for x in heavy]
            size = (max(arms, default=0.0) or 1.0) / unit
        middle = (points[own].min(axis=0) + points[own].max(axis=0)) / 2
        near = own | (np.linalg.norm(points - middle, axis=1) <= SIZES_NEAR * size)
        if np.linalg.norm(middle) > SIZES_NEAR * size:
            grid = 2.0 ** math.frexp(size)[1]
            centre = unit * grid * np.round(middle / grid) * (np.abs(middle) > SIZES_NEAR * size)
    length = unit * diameter(points[near])
    if length and not SMALLEST <= length <= 1.0 / SMALLEST:
        raise _size_error(model, where, length, int(np.argmax(reach)))
    length = length or 1.0
    return Extent(length, centre, near, EPS * float(np.abs(centre).max()) / length)


def unlike_links(model: pin.Model, extent: Extent) -> str:
    """Return a warning if the lengths of links differ so much that loops lose digits; else "".

    A closure is accurate to round-off of the longest link. The shortest link moves it by its own
    length; near dead centres by the square of the ratio of the two lengths.
    """
    lengths = []
    for joint in range(model.njoints):
        points = [model.jointPlacements[k].translation for k in model.children[joint]]
        points += [frame.placement.translation for frame, counts in zip(
            model.frames, extent.frames, strict=True)
            if counts and frame.parentJoint == joint]
        array = np.array([*points, *[np.zeros(3)] * (joint > 0)]).reshape(-1, 3)
        lengths.append(np.linalg.norm(array[:, None] - array, axis=2).ravel())
    sizes = np.concatenate(lengths)
    sizes = sizes[sizes > EPS * sizes.max(initial=0.0)]
    ratio = float(sizes.max() / sizes.min()) if sizes.size else 1.0
    return "" if ratio < UNLIKE else (
        f"; lengths of its links differ {ratio:.0e} times, which floating-point numbers do not "
        f"resolve in a loop: up to about {UNLIKE:.0e} they do")


def centred(model: pin.Model, centre: Array) -> pin.Model:
    """Return a copy of a tree with all that is joined to the ground relative to a centre (3,)."""
    copy, back = model.copy(), pin.SE3(np.eye(3), -centre)
    for joint in model.children[0]:
        copy.jointPlacements[joint] = back * model.jointPlacements[joint]
    for i, frame in enumerate(model.frames):
        if frame.parentJoint == 0:
            copy.frames[i].placement = back * frame.placement
    return copy


def diameter(points: Array) -> float:
    """Return the largest distance between two of the points (N, 3)."""

    def farthest(point: Array) -> float:
        return float(np.linalg.norm(points - point, axis=1).max())

    radii = np.linalg.norm(points - (points.min(axis=0) + points.max(axis=0)) / 2, axis=1)
    least = farthest(points[int(np.argmax(radii))])
    # two points that are farther apart than that lie at least so far from the middle
    outer = radii > least * (1.0 - 4.0 * np.finfo(float).eps) - radii.max()
    return max([least, *map(farthest, points[outer])])


def _size_error(model: pin.Model, where: str, span: float, frame: int) -> MechanismFileError:
    large = f"{span:.3g} m large" if math.isfinite(span) else "larger than any number"
    return MechanismFileError(
        f"{where}: the mechanism is {large} (frame {model.frames[frame].name!r}); "
        f"only sizes from {SMALLEST:g} to {1.0 / SMALLEST:g} m can be worked with")
