"""What a reduced mechanism does without, in words."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from spatial_pin.mechanism.joint_limits import joint_limits
from spatial_pin.reduction.model.model import Model


class Omission(NamedTuple):
    """Something that a reduced mechanism does without.

    Attributes:
        what: "geometry", "inertia", "spring", "joint", "branch", "loop", "link", "leg",
            "equations", "joint limits" or "passive freedom".
        name: of the part; empty where it is many.
        why: in words.

    Example:
        >>> small = sp.reduce(sp.load("rssr"), "rocker_pin")
        >>> [omission.what for omission in small.left_out]
        ['geometry', 'inertia', 'link', 'passive freedom']
        >>> small.left_out[2].name
        'coupler'
    """

    what: str
    name: str
    why: str

    def __str__(self) -> str:
        return f"{self.what}{f' {self.name}' if self.name else ''}: {self.why}"


def omissions(model: Model, locked: frozenset[int]) -> Iterator[Omission]:
    """Yield what was left out and why."""
    full = model.full
    if len(full.visual_model.geometryObjects) + len(full.collision_model.geometryObjects):
        yield Omission("geometry", "", "shapes to draw and to collide")
    if not model.dynamics:
        heavy = [n for n in full.inertias if n not in model.asked.frames]
        if heavy:
            yield Omission("inertia", "", f"of {len(heavy)} links: motion alone is asked for")
        for spring in full.springs:
            yield Omission("spring", spring.name, "motion alone is asked for")
    yield from _lost_loops(model)
    yield from _lost_joints(model, locked)
    yield from (Omission(*note) for note in model.notes)
    yield from _lost_limits(model, locked)
    for passive in full.passives:
        if not model.keeps_spin(passive):
            yield Omission("passive freedom", passive.name, f"of {passive.body}, which is left out")


def _lost_loops(model: Model) -> Iterator[Omission]:
    for k, closure in enumerate(model.full.closures):
        if k not in model.kept.closures:
            yield Omission("loop", closure.name, (
                "no output depends on it (at "
                f"{len(model.influence.configurations)} generic configurations); where it "
                "cannot close, the full mechanism stops and this one does not"))


def _lost_limits(model: Model, locked: frozenset[int]) -> Iterator[Omission]:
    full, still = model.full, model.moving | locked
    gone = dict.fromkeys(x.name for x in joint_limits(full)
                         if full.joint_id(full.coordinate(x.name).joint) not in still)
    if gone:
        yield Omission("joint limits", "", f"of {', '.join(gone)}: where one is passed, the full "
                                           "mechanism says so and this one does not")


def _lost_joints(model: Model, locked: frozenset[int]) -> Iterator[Omission]:
    names = model.full.model.names
    for i in sorted(locked):
        yield Omission("joint", names[i], "locked: welded")
    for i in sorted(model.kept.welded - locked):
        yield Omission("joint", names[i], "welded: nothing asked for moves with it")
    gone = [names[i] for i in range(1, model.full.model.njoints)
            if i not in model.kept.moving | model.kept.welded | locked]
    if gone:
        yield Omission("branch", "", f"no output depends on: {', '.join(gone)}")
