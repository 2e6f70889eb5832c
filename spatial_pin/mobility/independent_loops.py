"""Independent loops: the joints of each, and the motions that they generate together."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from spatial_pin.constraints.pinocchio_views import joint_jacobian
from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Closure
from spatial_pin.numerics.linalg import null_space, rank, row_space

# Singular value of twists that counts as zero: axes from files with nine or more digits coincide;
# six digits need `gap`.
ALGEBRA_TOLERANCE = 1e-8
# by dimension, and number of rotation directions
KINDS = {  # by dimension, and how many directions are turned about
    (1, 0): "one direction", (2, 0): "translations in a plane", (3, 0): "translations",
    (1, 1): "one axis", (2, 1): "one axis (turn and slide)", (3, 1): "planar",
    (4, 1): "planar with slide along the axis", (3, 3): "spherical",
    (6, 3): "spatial",
}


class Loop(NamedTuple):
    """An independent loop.

    Attributes:
        closure: the closure that closes it.
        joints: the joints of the tree that it passes.
        order: dimension of the motions its pairs generate (lambda in the mobility formula).
        kind: name of these motions, such as "planar".

    Example:
        >>> loop = sp.mobility(sp.load("four_bar")).loop_list[0]
        >>> loop.closure, loop.order, loop.kind
        ('output_pin', 3, 'planar')
    """

    closure: str
    joints: tuple[str, ...]
    order: int
    kind: str


def loop_of(evaluation: LoopEquations, closure: Closure, tolerance: float) -> Loop:
    """Return the loop of a closure, classified by the motions that its pairs generate."""
    mechanism, constraints = evaluation.mechanism, evaluation.constraints
    rows = [i for i, label in enumerate(constraints.labels) if label.closure == closure.name]
    joints = sorted({i for frames in closure.joined for i in joints_between(mechanism, frames)})
    size = np.array([constraints.scale] * 3 + [1.0] * 3)
    columns = joint_jacobian(evaluation.data, mechanism.model.nv)
    twists = [columns[:, mechanism.model.idx_vs[i] + k] * size
              for i in joints for k in range(mechanism.model.nvs[i])]
    wrenches = evaluation.row_wrenches()[rows] / size
    lengths = np.linalg.norm(wrenches, axis=1, keepdims=True)
    acting = lengths[:, 0] > 0.0  # others are of the closure's third frame and on
    own = null_space(wrenches[acting] / lengths[acting])
    # an orthonormal basis of the Lie algebra that the twists, linear part first, generate
    algebra, dimension = row_space(np.vstack([*twists, own]) if twists else own, tolerance), -1
    while len(algebra) > dimension:  # it grows to dimension 6 at most
        dimension = len(algebra)
        brackets = [np.append(np.cross(a[3:], b[:3]) - np.cross(b[3:], a[:3]),
                              np.cross(a[3:], b[3:]))
                    for i, a in enumerate(algebra) for b in algebra[:i]]
        algebra = row_space(np.vstack([algebra, *brackets]), tolerance)
    names = tuple(mechanism.model.names[i] for i in joints)
    turns = rank(algebra[:, 3:], tolerance) if len(algebra) else 0
    kind = KINDS.get((len(algebra), turns), f"subgroup of dimension {len(algebra)}")
    return Loop(closure.name, names, len(algebra), kind)


def joints_between(mechanism: Mechanism, frames: Iterable[str]) -> list[int]:
    """Return the indices of the tree joints between two frames."""
    first, second = (
        set(mechanism.model.supports[mechanism.frame_on_joint(f)[0]]) for f in frames
    )
    return sorted((first ^ second) - {0})
