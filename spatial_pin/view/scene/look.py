"""Extras of a picture besides the bodies."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

from spatial_pin._support.checks import check_kind, names_of
from spatial_pin._support.lazy import with_former_field
from spatial_pin.errors import SpatialPinError

if TYPE_CHECKING:
    from spatial_pin.assembly.state import State
    from spatial_pin.motion.motion import Motion
    from spatial_pin.proximity.clearance import Clearance
    from spatial_pin.synthesis.ranked_designs import Design, Designs
    from spatial_pin.view.scene.layers.arrows import Vectors
    from spatial_pin.workspace.workspace_result import Workspace


@with_former_field("beside", "side_by_side")
@dataclass(frozen=True)
class Look:
    """Extras of a picture besides the bodies; open closures and springs are always shown.

    Attributes:
        skeleton: whether links are drawn as sticks from pair to pair; None: those that bring no
            picture of their own.
        shadow: whether there is a shadow on the ground; None: where it is drawn fast enough.
        curves: outputs drawn under the picture, as `spatial_pin.plot` takes them; without any, a
            page has the usual ones behind a button; they grow in a page of `live`; a state has
            none.
        pairs: whether every joint and closure has a sign of its kind; None: where
            the model brings no picture of its own.
        axes: whether the axes of joints and closures are drawn.
        traces: points whose paths are drawn: links, frames, joints; `NAME.com` is a link's centre
            of mass.
        arrows: vectors drawn at their points, with a scale in the legend: `NAME.velocity`,
            `.acceleration`, `.angular_velocity`, `.angular_acceleration` of a link, frame or
            joint, `NAME.com.velocity`, `NAME.com.acceleration` of a link's centre of mass,
            `PAIR.reaction`, `PAIR.moment` of a joint or closure, or any
            `spatial_pin.Vectors`.
        centres: whether the centres of mass are marked.
        ghosts: other states of the same mechanism, or motions of any, drawn half transparent. A
            motion goes with the one that is shown: at the same times, else at the same driver
            values, else from beginning to end; its outputs are dashed curves.
        clearance: a Clearance of the shown motion: links are red where they touch, and a line joins
            the nearest points of the nearest links.
        side_by_side: whether ghosts are solid, in rows and columns with the first, not half
            transparent.
        workspace: a Workspace: reached points, coloured by dexterity, and the ends of the branch.
        design: a Design, whose mechanism is shown: the points and placements of its goals, and the
            paths of their frames; a report also has the values of coordinates in its goals.

    Example:
        >>> mech = sp.load("four_bar")
        >>> motion = sp.sweep(mech, "crank", np.linspace(0.0, 6.28, 91), speed=1.0)
        >>> look = sp.Look(traces=("coupler.com",), arrows=("coupler_b.velocity",), pairs=True)
        >>> sp.export_html(motion, "four_bar.html", look=look).name
        'four_bar.html'
    """

    pairs: bool | None = None
    axes: bool = False
    traces: tuple[str, ...] = ()
    arrows: tuple[str | Vectors, ...] = ()
    centres: bool = False
    ghosts: tuple[State | Motion, ...] = ()
    clearance: Clearance | None = None
    side_by_side: bool = False
    workspace: Workspace | None = None
    design: Design | None = None
    skeleton: bool | None = None
    shadow: bool | None = None
    curves: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for own in fields(self):
            if not str(own.type).startswith("tuple"):
                check_kind(f"Look: {own.name}", str(own.type), getattr(self, own.name))
        for name in ("traces", "curves"):
            names = tuple(names_of(getattr(self, name), f"Look: {name}"))
            object.__setattr__(self, name, names)
        for name, kind in (("arrows", "str | Vectors"), ("ghosts", "State | Motion")):
            values = getattr(self, name)
            if isinstance(values, str) or any(hasattr(values, x) for x in ("_fields", "mechanism")):
                values = (values,)
            check_kind(f"Look: {name}", "Iterable", values)
            values = tuple(values)
            for value in values:
                check_kind(f"Look: {name}", kind, value)
            object.__setattr__(self, name, values)


def overlaid(
    given: Motion | State | Design | Designs, look: Look | None
) -> tuple[Motion | State, Look | None]:
    """Return the motion or state to show, and its look; a motion or a state as they are.

    Of designs the best is shown, and of it the motion through the samples of its first goal.
    Samples that no motion joins are shown beside each other.
    """
    from spatial_pin.synthesis.ranked_designs import Design, Designs  # on use: it takes a while

    if isinstance(given, Designs):
        if not given:
            raise SpatialPinError(f"{given.name}: no design was found that could be shown; ask for "
                                  "more starts, or for less")
        given = given[0]
    if not isinstance(given, Design):
        return given, look
    look = replace(look or Look(), design=given)
    try:
        return given.motion(), look
    except SpatialPinError:  # for a reason among its defects
        first, *others = given.states
        return first, replace(look, ghosts=(*look.ghosts, *others))
