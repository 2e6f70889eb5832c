"""The Grashof type of a plane four-bar."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from spatial_pin._support.checks import checked
from spatial_pin.assembly.assemble import assembled
from spatial_pin.assembly.state import State, of_mechanism
from spatial_pin.constraints.pinocchio_views import joint_jacobian
from spatial_pin.errors import SpatialPinError
from spatial_pin.kernel.loop_equations import loops_of
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES


class Grashof(NamedTuple):
    """Type of a plane four-bar.

    Attributes:
        lengths: link lengths by name of the link [m], the fixed link first, then round the loop.
        type: "crank-rocker", "rocker-crank", "double-crank", "double-rocker", "triple-rocker" or
            "change point".

    Example:
        >>> found = sp.grashof(sp.load("four_bar"))
        >>> found.type, sorted(found.lengths)
        ('crank-rocker', ['coupler', 'crank', 'ground', 'rocker'])
    """

    lengths: dict[str, float]
    type: str

    def __str__(self) -> str:
        lengths = ", ".join(f"{name} {x:.6g} m" for name, x in self.lengths.items())
        return f"Grashof type: {self.type} ({lengths})"


@checked
def grashof(mechanism: Mechanism, state: State | None = None) -> Grashof:
    """Classify a mechanism that is one plane loop of four revolute pairs [Grashof1883].

    A pair may be stated several times.

    Args:
        mechanism: the mechanism.
        state: a closed configuration; default the assembled guess.

    Returns:
        The Grashof: type and link lengths [m].

    Raises:
        SpatialPinError: it is not a plane four-bar.

    Example:
        >>> found = sp.grashof(sp.load("four_bar"))
        >>> found.type, {name: round(x, 3) for name, x in found.lengths.items()}  # [m]
        ('crank-rocker', {'ground': 0.3, 'crank': 0.1, 'coupler': 0.28, 'rocker': 0.24})
    """
    state = assembled(mechanism) if state is None else of_mechanism(mechanism, state)
    names, centres = _four_bar(mechanism, state)
    lengths = np.linalg.norm(np.roll(centres, -1, axis=0) - centres, axis=1)
    # centres[k] to centres[k + 1] is link k; the last one is the fixed link
    order = [3, 0, 1, 2]
    fixed, first, coupler, last = (float(lengths[k]) for k in order)
    ranked = sorted((fixed, first, coupler, last))
    excess = ranked[0] + ranked[3] - ranked[1] - ranked[2]
    if abs(excess) < TOLERANCES.nothing * sum(ranked):
        kind = "change point"
    elif excess > 0.0:
        kind = "triple-rocker"
    else:
        kind = {fixed: "double-crank", coupler: "double-rocker", first: "crank-rocker",
                last: "rocker-crank"}[ranked[0]]
    return Grashof({names[k]: float(lengths[k]) for k in order}, kind)


def _four_bar(mechanism: Mechanism, state: State) -> tuple[list[str], Array]:
    """Return the links after each of the four pins round the loop, and the pins' centres."""
    model = mechanism.model
    wrong = SpatialPinError(
        f"mechanism {mechanism.name!r} is not one plane loop of four revolute pairs; "
        "it has no Grashof type"
    )
    pins = [c.frames for c in mechanism.closures if c.type == "revolute"]
    if not pins or mechanism.pairs != ("revolute",) * 3 \
            or {c.type for c in mechanism.closures} - {"revolute", "spherical"}:
        raise wrong
    frames = pins[0]
    ends = [mechanism.frame_on_joint(f)[0] for f in frames]
    chains = [list(model.supports[end])[1:] for end in ends]
    chains.sort(key=lambda chain: not any(
        mechanism.driven_coordinate(d.joint).joint == model.names[chain[0]]
        for d in mechanism.drivers.values()) if chain else True)
    first, second = chains
    if len(first) + len(second) != 3 or set(first) & set(second):
        raise wrong
    with loops_of(mechanism, state.angles) as evaluation:
        evaluation.update(state.q)
        poses = [evaluation.data.oMi[i] for i in first]
        poses += [evaluation.frame(mechanism.frame_id(frames[0]))]
        poses += [evaluation.data.oMi[i] for i in reversed(second)]
        centres = np.array([at.translation for at in poses])
        columns = joint_jacobian(evaluation.data, model.nv).copy()
        points = {c.name: evaluation.frame(mechanism.frame_id(c.frames[0])).translation
                  for c in mechanism.closures}
    axes = [columns[3:, model.idx_vs[i]] for i in (*first, *second)]
    if any(np.linalg.norm(np.cross(axes[0], axis)) > TOLERANCES.nothing for axis in axes):
        raise wrong
    bodies = [*first, *reversed(second)]
    loop = [0, *bodies, 0]
    centres -= np.outer(centres @ axes[0], axes[0])
    for closure in mechanism.closures:  # each states one of the pins
        joined = {mechanism.frame_on_joint(f)[0] for f in closure.frames}
        point = points[closure.name]
        apart = np.linalg.norm(point - (point @ axes[0]) * axes[0] - centres, axis=1)
        if not any({*loop[k:k + 2]} == joined
                   and apart[k] <= TOLERANCES.nothing * mechanism.characteristic_length
                   for k in range(4)):
            raise wrong
    links = [next(name for name in mechanism.links if mechanism.frame_on_joint(name)[0] == i)
             for i in bodies]
    return [*links, mechanism.links[0]], centres
