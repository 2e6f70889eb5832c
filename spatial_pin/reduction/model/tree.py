"""The open tree of a reduced mechanism: joints and links of the full one, and frames put in."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import pinocchio as pin

from spatial_pin.formats.pinocchio_model.pair_tree import copy_numbers
from spatial_pin.formats.pinocchio_model.urdf_text import LinkTree, urdf_of
from spatial_pin.formats.urdf.elements import fresh
from spatial_pin.mechanism.checks import check_mechanism
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.named_frames import add_frames
from spatial_pin.numerics.linalg import Array
from spatial_pin.reduction.model.links import Bodies, Place


class Tree:
    """Joints that stay, and links on them, as a model of their own.

    Args:
        full: the full mechanism.
        bodies: its rigid bodies, some of its joints welded.
        moving: joints that stay.
    """

    def __init__(self, full: Mechanism, bodies: Bodies, moving: Iterable[int]) -> None:
        self.full, self.bodies = full, bodies
        self.model = pin.Model()
        self.model.name, self.model.gravity = full.model.name, full.model.gravity
        self.inertias: dict[str, pin.Inertia] = {}
        self._place_of = {0: 0}
        self._taken = {f.name for f in full.model.frames} | set(full.model.names)
        for i in sorted(moving):
            self._place_of[i] = self._add_joint(i)

    def _add_joint(self, i: int) -> int:
        given = self.full.model
        body, on = self.bodies.of(int(given.parents[i]))
        k = self.model.addJoint(self._place_of[body], given.joints[i],
                                on * given.jointPlacements[i], given.names[i])
        copy_numbers(given, i, self.model, k)
        self.model.addJointFrame(k, 0)
        return int(k)

    def hold(self, links: set[str], welded: Iterable[int], heavy: Iterable[str]) -> None:
        """Keep links of the full tree, those that hang on welded joints, and inertias.

        Args:
            links: those that something refers to.
            welded: joints that carry some of what stays.
            heavy: links that keep their inertia, if what they are fixed to stays.
        """
        full, there, met = self.full, {*self._place_of, *welded}, set[int]()
        weighed = {name for name in heavy if name in full.inertias
                   and full.frame_on_joint(name)[0] in there}
        for name in full.links:
            joint, placement = full.frame_on_joint(name)
            is_main = joint in there - met and placement.isIdentity(0.0)
            met.update({joint} if is_main else ())
            if is_main or name in weighed or name in links:
                self._add_link(name, is_main and joint in self._place_of)
        for name in weighed:
            self._weigh(name, full.inertias[name])

    def _add_link(self, name: str, is_main: bool) -> None:
        joint, placement = self.bodies.frame(name)
        if is_main:
            self._add_body(name, joint, pin.SE3.Identity(), "")
        else:
            frames = self.full.model.frames
            above = frames[frames[self.full.frame_id(name)].parentFrame].name
            self._add_body(name, joint, placement, above)

    def add(self, wanted: str, place: Place, mass: float = 0.0) -> str:
        """Put a new link on a body, with a point mass if there is one; return its name."""
        name, (body, on) = fresh(wanted, self._taken), self.bodies.of(place.body)
        self._add_body(name, body, on * place.placement, fresh(f"{name}_mount", self._taken))
        if mass > 0.0:
            self._weigh(name, pin.Inertia(mass, np.zeros(3), np.zeros((3, 3))))
        return name

    def _add_body(self, link: str, joint: int, placement: pin.SE3, mount: str) -> None:
        """Add a link on a joint of the full tree, by a fixed joint unless it is moved by that."""
        on, above = self._place_of[joint], 0
        if mount:
            above = self.model.addFrame(
                pin.Frame(mount, on, 0, placement, pin.FrameType.FIXED_JOINT), False)
        self.model.addFrame(pin.Frame(link, on, above, placement, pin.FrameType.BODY), False)

    def _weigh(self, link: str, inertia: pin.Inertia) -> None:
        frame = self.model.frames[self.model.getFrameId(link, pin.FrameType.BODY)]
        self.inertias[link] = inertia
        self.model.inertias[frame.parentJoint] += frame.placement.act(inertia)

    def mechanism(self, frames: Iterable[str], **parts: Any) -> Mechanism:
        """Return the mechanism of this tree.

        Args:
            frames: those of the full mechanism that its URDF does not have, and that stay.
            **parts: its closures, drivers, springs and passives.
        """
        full, none = self.full, pin.GeometryModel()
        kept = {name: full.frames[name] for name in full.frames if name in set(frames)}
        add_frames(self.model, kept, full.name)
        pairs = tuple(full.pairs[i - 1] for i in self._place_of if i)
        made = Mechanism(full.name, self.model, none, none, pairs, title=full.title,
                         source=full.source, inertias=self.inertias, frames=kept,
                         slip_speeds=self._slip_speeds(), **parts)
        check_mechanism(made, f"{full.name} (reduced)")
        return made.with_fields(urdf=urdf_of(made, LinkTree(self.model)))

    def _slip_speeds(self) -> Array:
        full = self.full
        own = [np.arange(full.model.idx_vs[i], full.model.idx_vs[i] + full.model.nvs[i])
               for i in self._place_of if i]
        return full.slip_speeds[np.concatenate([[], *own]).astype(int)] if (
            full.slip_speeds.size) else full.slip_speeds
