"""Drawings as files in rounded numbers: MJCF, SDFormat, URDF, each with a mechanism file beside it.

Every number is rounded by itself, as CAD exporters do: places, angles or quaternions, and axes,
each in the frame of its link. What closes a loop is written once, at the pose that is drawn, as the
formats have it: MuJoCo and SDFormat work out the other side from that pose. URDF has no such word;
there the second frame is rounded too, or worked out in full digits.
"""

from __future__ import annotations

import math

import numpy as np

from fuzzing.drawing import BALL, GROUND, HINGE, SLIDE, WELD
from fuzzing.files import MOMENTS
from fuzzing.rotations import from_rpy, to_rpy

EXACT = 17
MJCF_JOINT = {HINGE: "hinge", SLIDE: "slide", BALL: "ball"}
SDF_JOINT = {HINGE: "revolute", SLIDE: "prismatic", BALL: "ball", WELD: "fixed"}
URDF_JOINT = {HINGE: "continuous", SLIDE: "prismatic"}
APART = 0.3  # of the two balls that replace a hinge, in units


class Writer:
    """Writes one drawing with a number of digits after the point, of its unit of length.

    Attributes:
        drawing: the mechanism.
        digits: of all numbers; `EXACT` for all there are.
        rng: of what the format leaves open.
    """

    def __init__(self, drawing, digits, rng):
        self.drawing, self.digits, self.rng = drawing, digits, rng

    # ------------------------------------------------------------ numbers

    def plain(self, values):
        """Numbers without unit: angles, axes, quaternions."""
        return " ".join(repr(float(self.round(x))) for x in np.atleast_1d(values))

    def lengths(self, values):
        """Numbers in metres."""
        return " ".join(repr(float(x)) for x in self.round_lengths(values))

    def round(self, x):
        """A number without unit, rounded."""
        return x if self.digits == EXACT else np.round(x, self.digits)

    def round_lengths(self, values):
        """Numbers in metres, rounded: by the unit of length, as numbers of that unit would be."""
        places = self.digits - round(math.log10(self.drawing.size))
        return values if self.digits == EXACT else np.round(values, places)

    def figure(self, x):
        """A number of `digits` digits, wherever its point is: masses and moments."""
        return f"{x:.{self.digits}g}"

    # ------------------------------------------------------------ places

    def local(self, link, point):
        """A point (3,) in a link's frame."""
        d = self.drawing
        return d.rotation(link).T @ (point - d.origin(link))

    def turned(self, link, vector):
        """A vector (3,) in a link's frame."""
        return self.drawing.rotation(link).T @ vector

    def inertia(self, link):
        """Mass, centre (3,) and the six moments of a link, in its frame, as text."""
        own, r = self.drawing.links[link], self.drawing.rotation(link)
        tensor = r.T @ own.tensor @ r
        return (self.figure(own.mass), self.lengths(self.local(link, own.com)),
                [self.figure(tensor[i, k]) for i, k in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2),
                                                        (2, 2))])

    # ------------------------------------------------------------ the mechanism file

    def write(self, folder, name, kind):
        """Write a drawing's files; return the path of the mechanism file.

        Args:
            folder: to write into.
            name: of the files.
            kind: one of `FORMATS`.
        """
        ending, text = FORMATS[kind]
        (folder / f"{name}{ending}").write_text("\n".join(text(self)), encoding="utf-8")
        gravity = ", ".join(self.figure(x) for x in self.drawing.gravity)
        lines = [f'name = "{name}"', f'tree = "{name}{ending}"', f"gravity = [{gravity}]",
                 *(f'[drivers.{x}]\njoint = "{x}"' for x in self.drawing.drivers)]
        if kind == "urdf":
            lines += self._closures()
        path = folder / f"{name}.toml"
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
        return path

    # ------------------------------------------------------------ URDF

    def urdf(self):
        """The tree, and frames of the closures on it."""
        d, self.closed_at = self.drawing, []
        yield '<robot name="drawn">'
        yield f'<link name="{GROUND}"/>'
        for name in d.links:
            mass, com, moments = self.inertia(name)
            tensor = " ".join(f'{k}="{x}"' for k, x in zip(MOMENTS, moments, strict=True))
            yield (f'<link name="{name}"><inertial><origin xyz="{com}"/><mass value="{mass}"/>'
                   f"<inertia {tensor}/></inertial></link>")
        for j in d.joints:
            xyz, rpy = self._on_parent(j.parent, j.point, d.rotation(j.child))
            limit = ('<limit lower="-1e3" upper="1e3" effort="1e6" velocity="1e6"/>'
                     if j.kind == SLIDE else "")
            yield (f'<joint name="{j.name}" type="{URDF_JOINT[j.kind]}">'
                   f'<parent link="{j.parent}"/><child link="{j.child}"/>'
                   f'<origin xyz="{xyz}" rpy="{rpy}"/>'
                   f'<axis xyz="{self.plain(self.turned(j.child, j.axis))}"/>{limit}</joint>')
        exactly = self.rng.random() < 0.5
        for c in d.loops:
            along = _with_z(c.axis, self.rng)
            first = self._on_parent(c.parent, c.point, along)
            second = (self._as_drawn(c, first) if exactly and self.digits != EXACT
                      else self._on_parent(c.child, c.point, along))
            for k, (link, (xyz, rpy)) in enumerate(((c.parent, first), (c.child, second))):
                yield (f'<link name="{c.name}_{k}"/><joint name="{c.name}_{k}_fix" type="fixed">'
                       f'<parent link="{link}"/><child link="{c.name}_{k}"/>'
                       f'<origin xyz="{xyz}" rpy="{rpy}"/></joint>')
        yield "</robot>"

    def _on_parent(self, link, point, rotation):
        return (self.lengths(self.local(link, point)),
                self.plain(to_rpy(self.drawing.rotation(link).T @ rotation)))

    def _as_drawn(self, closure, first):
        """The second frame of a closure where the rounded tree has the first, in full digits."""
        r1, p1 = self._rounded(closure.parent)
        r2, p2 = self._rounded(closure.child)
        xyz, rpy = (np.array([float(x) for x in text.split()]) for text in first)
        at, turn = r2.T @ (p1 + r1 @ xyz - p2), r2.T @ r1 @ from_rpy(rpy).astype(float)
        return " ".join(map(repr, at.tolist())), " ".join(repr(float(x)) for x in to_rpy(turn))

    def _rounded(self, link):
        """Rotation (3, 3) and place (3,) of a link as the rounded numbers have it."""
        if link == GROUND:
            return np.eye(3), np.zeros(3)
        joint = next(j for j in self.drawing.joints if j.child == link)
        r, p = self._rounded(joint.parent)
        xyz, rpy = (np.array([float(x) for x in text.split()]) for text in self._on_parent(
            joint.parent, joint.point, self.drawing.rotation(link)))
        return r @ from_rpy(rpy).astype(float), p + r @ xyz

    def _closures(self):
        for c in self.drawing.loops:
            yield (f'[[closures]]\nname = "{c.name}"\ntype = "{c.kind}"\n'
                   f'frames = ["{c.name}_0", "{c.name}_1"]')
        for one, two, ratio in self.drawing.couplings:
            yield (f'[[closures]]\nname = "gears"\ntype = "coupling"\njoints = ["{one}", "{two}"]\n'
                   f"ratio = {ratio!r}")

    # ------------------------------------------------------------ MJCF

    def mjcf(self):
        """Bodies within each other; connects, welds and joint equalities."""
        yield '<mujoco model="drawn"><compiler angle="radian" inertiafromgeom="false"/><worldbody>'
        yield from self._bodies(GROUND)
        yield "</worldbody><equality>"
        for c in self.drawing.loops:
            yield from self._equality(c)
        for one, two, ratio in self.drawing.couplings:
            yield f'<joint joint1="{two}" joint2="{one}" polycoef="0 {ratio!r} 0 0 0"/>'
        yield "</equality></mujoco>"

    def _bodies(self, parent):
        d = self.drawing
        for j in (x for x in d.joints if x.parent == parent):
            quat = _quaternion(d.rotation(parent).T @ d.rotation(j.child))
            mass, com, m = self.inertia(j.child)
            yield (f'<body name="{j.child}" pos="{self.lengths(self.local(parent, j.point))}" '
                   f'quat="{self.plain(quat)}"><inertial pos="{com}" mass="{mass}" '
                   f'fullinertia="{m[0]} {m[3]} {m[5]} {m[1]} {m[2]} {m[4]}"/>'
                   f'<joint name="{j.name}" type="{MJCF_JOINT[j.kind]}" '
                   f'axis="{self.plain(self.turned(j.child, j.axis))}"/>')
            yield from self._bodies(j.child)
            yield "</body>"

    def _equality(self, c):
        one, two = (x if x != GROUND else "world" for x in (c.parent, c.child))
        if c.kind == WELD:
            yield f'<weld name="{c.name}" body1="{one}" body2="{two}"/>'
            return
        apart = APART * self.drawing.size * c.axis
        for k in range(2 if c.kind == HINGE else 1):
            at = self.lengths(self.local(c.parent, c.point + k * apart))
            yield f'<connect name="{c.name}_{k}" body1="{one}" body2="{two}" anchor="{at}"/>'

    # ------------------------------------------------------------ SDFormat

    def sdf(self):
        """Links in the model's frame, and a graph of joints; which one is cut is the reader's."""
        d = self.drawing
        held = bool(d.couplings) or self.rng.random() < 0.5  # the reader cuts what has no limits
        driven = {two: (one, ratio) for one, two, ratio in d.couplings}
        yield "<sdf version='1.11'><model name='drawn'>"
        for name in d.links:
            mass, com, moments = self.inertia(name)
            tensor = "".join(f"<{k}>{x}</{k}>" for k, x in zip(MOMENTS, moments, strict=True))
            yield (f"<link name='{name}'><pose>{self.lengths(d.origin(name))} "
                   f"{self.plain(to_rpy(d.rotation(name)))}</pose><inertial>"
                   f"<pose>{com} 0 0 0</pose><mass>{mass}</mass>"
                   f"<inertia>{tensor}</inertia></inertial></link>")
        for j in (*d.joints, *d.loops):
            limited = j not in d.loops and (held or j.name in d.drivers)
            yield self._sdf_joint(j, limited, driven.get(j.name))
        yield "</model></sdf>"

    def _sdf_joint(self, j, limited, mimic):
        parent, child = (x if x != GROUND else "world" for x in (j.parent, j.child))
        at = self.lengths(self.local(j.child, j.point))
        text = (f"<joint name='{j.name}' type='{SDF_JOINT[j.kind]}'><parent>{parent}</parent>"
                f"<child>{child}</child><pose>{at} 0 0 0</pose>")
        if j.kind in (HINGE, SLIDE):
            text += f"<axis><xyz>{self.plain(self.turned(j.child, j.axis))}</xyz>"
            if limited:
                reach = 3.1 if j.kind == HINGE else 100.0 * self.drawing.size
                text += f"<limit><lower>{-reach!r}</lower><upper>{reach!r}</upper></limit>"
            if mimic:
                text += (f"<mimic joint='{mimic[0]}'><multiplier>{mimic[1]!r}</multiplier>"
                         "<offset>0</offset><reference>0</reference></mimic>")
            text += "</axis>"
        return text + "</joint>"


FORMATS = {"mjcf": (".xml", Writer.mjcf), "sdf": (".sdf", Writer.sdf),
           "urdf": (".urdf", Writer.urdf)}


def _with_z(axis, rng):
    """A rotation (3, 3) whose z is an axis."""
    one = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    one = one / np.linalg.norm(one)
    two, t = np.cross(axis, one), rng.uniform(-3, 3)
    x = math.cos(t) * one + math.sin(t) * two
    return np.column_stack([x, np.cross(axis, x), axis])


def _quaternion(r):
    """MuJoCo's quaternion w, x, y, z (4,) of a rotation (3, 3)."""
    k = np.array([[r[0, 0] - r[1, 1] - r[2, 2], 0, 0, 0],
                  [r[0, 1] + r[1, 0], r[1, 1] - r[0, 0] - r[2, 2], 0, 0],
                  [r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], r[2, 2] - r[0, 0] - r[1, 1], 0],
                  [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], np.trace(r)]])
    x, y, z, w = np.linalg.eigh(k)[1][:, -1]
    return np.array([w, x, y, z]) * (1.0 if w >= 0 else -1.0)
