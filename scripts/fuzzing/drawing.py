"""Random mechanisms with redundant equations, drawn at a pose where they close exactly.

A drawing is what a CAD program has: where links, hinges and balls are in the world while all
coordinates are zero. Its numbers satisfy what makes the mechanism move (parallel axes, Bennett's
condition, a half turn's symmetry) to round-off. `drawn_files` rounds and writes them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from fuzzing.rotations import about, from_rpy

GROUND = "ground"
BALL, HINGE, SLIDE, WELD = "spherical", "revolute", "prismatic", "weld"


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint, or what closes a loop, of two links.

    Attributes:
        name, kind, parent, child: the kind is one of the words above.
        point: on it in the world (3,) [m].
        axis: its unit vector in the world (3,).
    """

    name: str
    kind: str
    parent: str
    child: str
    point: np.ndarray
    axis: np.ndarray


@dataclass(frozen=True, eq=False)
class Link:
    """Of a link in the world: its frame's rotation (3, 3), mass, centre (3,) and tensor (3, 3)."""

    rotation: np.ndarray
    mass: float
    com: np.ndarray
    tensor: np.ndarray


@dataclass
class Drawing:
    """A mechanism at the pose where it is drawn.

    Attributes:
        family: its kind.
        size: its unit of length [m].
        dof: its freedoms.
        balls: whether a ball may replace a hinge that closes a loop.
        joints: of the tree, parents first; `loops` what closes it.
        couplings: (driving joint, driven joint, ratio).
        drivers: joints that are driven.
        links: by name, the ground left out.
        gravity: (3,) [m/s²].
    """

    family: str
    size: float
    dof: int
    balls: bool = True
    joints: list[Joint] = field(default_factory=list)
    loops: list[Joint] = field(default_factory=list)
    couplings: list[tuple[str, str, float]] = field(default_factory=list)
    drivers: list[str] = field(default_factory=list)
    links: dict[str, Link] = field(default_factory=dict)
    gravity: np.ndarray = field(default_factory=lambda: np.array([0.0, 0.0, -9.81]))

    def origin(self, link):
        """Where a link's frame is: at its joint of the tree; the ground's at the world's origin."""
        return next((j.point for j in self.joints if j.child == link), np.zeros(3))

    def rotation(self, link):
        """The rotation (3, 3) of a link's frame."""
        return np.eye(3) if link == GROUND else self.links[link].rotation


def draw(seed, attempt=0, shake=0.0, again=0):
    """The drawing of a seed.

    Args:
        seed: of all random numbers; of the family too.
        attempt: counts other drawings of that family.
        shake: how far each dimension is off, by its unit: the same kind of mechanism, a little
            different.
        again: which of such mechanisms.
    """
    family = str(np.random.default_rng([6, seed]).choice(list(FAMILIES), p=SHARES))
    maker = _Maker((seed, attempt), shake, again)
    size = 10.0 ** int(maker.rng.integers(-1, 2))
    maker.drawing = Drawing(family, size, 1)
    FAMILIES[family](maker)
    maker.bodies()
    return maker.drawing


def welded(drawing, which):
    """The same mechanism with one link cut in two halves, held together by a weld.

    Args:
        drawing: the mechanism.
        which: number of the loop whose hinge becomes one of the tree.
    """
    loop = drawing.loops[which]
    one, two = loop.parent, loop.child
    half = f"{two}_half"
    links = dict(drawing.links)
    whole = links[two]
    links[two] = replace(whole, mass=whole.mass / 2, tensor=whole.tensor / 2)
    turned = whole.rotation @ from_rpy([0.3, -0.2, 0.5]).astype(float)
    links[half] = replace(links[two], rotation=turned)
    loops = list(drawing.loops)
    loops[which] = Joint(f"{loop.name}_weld", WELD, half, two, loop.point, loop.axis)
    return replace(drawing, links=links, loops=loops,
                   joints=[*drawing.joints, replace(loop, parent=one, child=half)])


def with_ball(drawing, which):
    """The same mechanism, closed by a ball instead of a hinge."""
    loops = list(drawing.loops)
    loops[which] = replace(loops[which], kind=BALL)
    return replace(drawing, loops=loops)


class _Maker:
    """Draws mechanisms, number after number."""

    def __init__(self, seed, shake, again):
        self.rng = np.random.default_rng([7, *seed])
        self.shaken, self.shake = np.random.default_rng([8, *seed, again]), shake

    # ------------------------------------------------------------ numbers

    def number(self, low, high, shape=None):
        """Random numbers, each a little off where the mechanism is to be."""
        return self.rng.uniform(low, high, shape) + self.shake * self.shaken.normal(size=shape)

    def direction(self):
        v = self.rng.normal(size=3)
        return _unit(_unit(v) + self.shake * self.shaken.normal(size=3))

    def across(self, axis):
        """A direction well away from an axis (3,)."""
        one, two = _frame(axis)
        t, tilt = self.number(-3.1, 3.1), self.number(-0.5, 0.5)
        return _unit(math.cos(t) * one + math.sin(t) * two + tilt * axis)

    def point(self):
        """A point (3,), in units."""
        return self.number(-0.5, 0.5, 3)

    def plane(self):
        """A function of x and y, in units, into a random plane, and its normal (3,).

        Points come somewhere on the line through (x, y) along the normal.
        """
        normal, origin = self.direction(), self.point()
        one, two = _frame(normal)
        t = self.number(-3.1, 3.1)
        one, two = (math.cos(t) * one + math.sin(t) * two, math.cos(t) * two - math.sin(t) * one)

        def point(xy, lifted=True):
            lift = self.number(-0.1, 0.1) if lifted else 0.0
            return origin + xy[0] * one + xy[1] * two + lift * normal
        return point, normal, (one, two)

    def corners(self, n):
        """Corners (n, 2) of a polygon, in units, none near its neighbours."""
        share = self.number(0.5, 1.5, n)
        turns = np.cumsum(share / share.sum()) * 2 * math.pi
        return self.number(0.45, 0.9, n)[:, None] * np.stack([np.cos(turns), np.sin(turns)], 1)

    # ------------------------------------------------------------ joints

    def join(self, parent, child, point, axis, kind=HINGE):
        """Add a joint of the tree; return its name."""
        name = f"j{len(self.drawing.joints)}"
        self.drawing.joints.append(Joint(name, kind, parent, child, point, axis))
        return name

    def close(self, one, two, point, axis):
        """Close a loop by a hinge."""
        one, two = (two, one) if two == GROUND else (one, two)
        name = f"c{len(self.drawing.loops)}"
        self.drawing.loops.append(Joint(name, HINGE, one, two, point, axis))

    def ring(self, points, axes, kinds=None, at=None):
        """A loop of joints around; link k is between joints k and k + 1, the last is the ground.

        Args:
            points: in order around (n, 3), in units.
            axes: their axes (n, 3).
            kinds: of joints, by default hinges.
            at: number of the joint that closes the loop, by default any hinge after the first.
        """
        n = len(points)
        kinds = kinds or [HINGE] * n
        links = [*(f"l{k}" for k in range(n - 1)), GROUND]
        if at is None:
            at = int(self.rng.choice([k for k in range(1, n) if kinds[k] == HINGE]))
        names = [""] * n
        for k in range(at):
            names[k] = self.join(links[k - 1], links[k], points[k], axes[k], kinds[k])
        for k in range(n - 1, at, -1):
            names[k] = self.join(links[k], links[k - 1], points[k], axes[k], kinds[k])
        self.close(links[at - 1], links[at], points[at], axes[at])
        return names

    def drive(self, dof, names):
        """Say how many freedoms there are, and which joints are driven."""
        self.drawing.dof, self.drawing.drivers = dof, names

    # ------------------------------------------------------------ masses

    def bodies(self):
        """Scale lengths; give every link a frame, a mass and an inertia that a body can have."""
        d = self.drawing
        d.joints = [replace(j, point=d.size * j.point) for j in d.joints]
        d.loops = [replace(j, point=d.size * j.point) for j in d.loops]
        for joint in d.joints:
            mass = self.number(0.5, 2.0)
            points = d.size * 0.15 * (self.rng.normal(size=(4, 3))
                                      + self.shake * self.shaken.normal(size=(4, 3)))
            tensor = sum(mass / 4 * ((p @ p) * np.eye(3) - np.outer(p, p))
                         for p in points - points.mean(0))
            tensor = tensor + 0.01 * mass * d.size**2 * np.eye(3)  # of a body, rounded as well
            # of frames the shake is none of the mechanism
            rotation = from_rpy(self.rng.uniform([-3, -1.3, -3], [3, 1.3, 3])).astype(float)
            d.links[joint.child] = Link(
                rotation, mass, joint.point + d.size * 0.6 * self.point(), tensor)
        d.gravity = 9.81 * self.direction()


def _unit(v):
    return v / np.linalg.norm(v)


def _frame(axis):
    """Two unit vectors square to an axis (3,), and to each other."""
    one = _unit(np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))]))
    return one, np.cross(axis, one)


def _turned(axis, angle, v):
    return about(axis, np.array([angle]))[0].astype(float) @ v


# ---------------------------------------------------------------- families


def _plane_loop(m):
    n = int(m.rng.choice([4, 5, 6], p=[0.6, 0.25, 0.15]))
    point, normal, _ = m.plane()
    names = m.ring([point(x) for x in m.corners(n)], [normal] * n)
    tree = [x for x in names if x]
    m.drive(n - 3, tree[: n - 3])


def _parallelogram(m):
    """A coupler on three or two parallel cranks of one length."""
    point, normal, (one, two) = m.plane()
    n = int(m.rng.integers(2, 4))
    pivots = np.array([[0.0, 0.0], [0.9, 0.0], [0.4, 0.5]])[:n] + m.number(-0.15, 0.15, (n, 2))
    t, length = m.number(0.6, 1.1), m.number(0.4, 0.7)
    crank = length * (math.cos(t) * one + math.sin(t) * two)
    for k, pivot in enumerate(pivots):
        at = point(pivot)
        m.join(GROUND, f"crank{k}", at, normal)
        if k == 0:
            m.join("crank0", "coupler", at + crank, normal)
        else:
            m.close(f"crank{k}", "coupler", at + crank, normal)
    m.drive(1, ["j0"])


def _slider_crank(m):
    point, normal, (one, two) = m.plane()
    corners, t = m.corners(4), m.number(-0.4, 0.4)
    along = corners[0] - corners[2]
    along = _unit(_turned(normal, t, along[0] * one + along[1] * two))
    m.ring([point(x) for x in corners], [normal, normal, normal, along],
           [HINGE, HINGE, HINGE, SLIDE])
    m.drive(1, ["j0"])


def _trammel(m):
    """A rod on two slides: the ellipsograph."""
    point, normal, (one, two) = m.plane()
    t = m.number(1.0, 2.1)
    ways = [one, math.cos(t) * one + math.sin(t) * two]
    points = [point(x) for x in ((0.0, 0.0), (0.5, 0.1), (0.1, 0.6), (0.2, 0.1))]
    m.ring(points, [ways[0], normal, normal, ways[1]], [SLIDE, HINGE, HINGE, SLIDE])
    m.drive(1, ["j0"])


def _spherical_loop(m):
    """Hinges whose lines meet in a point."""
    n = int(m.rng.choice([4, 5], p=[0.75, 0.25]))
    middle, up = m.point(), m.direction()
    one, two = _frame(up)
    axes = [_unit(x * one + y * two + m.number(0.4, 0.8) * up) for x, y in m.corners(n)]
    names = m.ring([middle + m.number(0.2, 0.6) * a for a in axes], axes)
    m.drive(n - 3, [x for x in names if x][: n - 3])


def _chain(m, steps, angles):
    """Points and axes of hinges, from steps (length, twist) between them and their angles."""
    rotation, point = from_rpy(m.number(-3, 3, 3)).astype(float), m.point()
    points, axes = [point], [rotation[:, 2]]
    for (length, twist), angle in zip(steps, angles, strict=False):
        rotation = rotation @ from_rpy([0, 0, angle]).astype(float)
        point = point + length * rotation[:, 0]
        rotation = rotation @ from_rpy([twist, 0, 0]).astype(float)
        points.append(point)
        axes.append(rotation[:, 2])
    return [p + m.number(-0.1, 0.1) * a for p, a in zip(points, axes, strict=True)], axes


def _bennett(m):
    a, alpha = m.number(0.4, 0.6), m.number(0.5, 0.9)
    beta = m.number(1.1, 1.5)
    b = a * math.sin(beta) / math.sin(alpha)
    one = m.number(0.7, 1.6)
    ratio = math.sin(0.5 * (beta + alpha)) / math.sin(0.5 * (beta - alpha))
    two = 2 * math.atan(ratio / math.tan(0.5 * one))
    names = m.ring(*_chain(m, [(a, alpha), (b, beta), (a, alpha)], [one, two, -one]))
    m.drive(1, [x for x in names if x][:1])


def _bricard(m):
    """Six hinges: three, and their images by half a turn about a line."""
    line, middle = m.direction(), m.point()
    half = 2 * np.outer(line, line) - np.eye(3)
    points = [0.4 * m.direction() + 0.3 * m.point() for _ in range(3)]
    axes = [m.direction() for _ in range(3)]
    names = m.ring([*(middle + p for p in points), *(middle + half @ p for p in points)],
                   [*axes, *(half @ a for a in axes)])
    m.drawing.balls = False  # one would be a freedom more
    m.drive(1, [x for x in names if x][:1])


def _sarrus(m):
    """A platform on two folding legs of three parallel hinges each: it moves along a line."""
    first = m.direction()
    second = m.across(first)
    along = _unit(np.cross(first, second))
    middle, rise, points = m.point(), m.number(0.4, 0.8), []
    for axis in (first, second):
        out = np.cross(along, axis)
        foot = middle + 0.3 * m.number(0.5, 1.0) * out + 0.2 * m.number(-1, 1) * axis
        head = middle + rise * along + 0.3 * m.number(0.2, 0.7) * out
        knee = middle + rise * m.number(0.3, 0.7) * along + m.number(0.5, 0.8) * out
        points.append([foot, knee, head])
    names = m.ring([*points[0], *points[1][::-1]], [first] * 3 + [second] * 3)
    m.drawing.balls = False
    m.drive(1, [x for x in names if x][:1])


def _six_bar(m):
    """A plane four-bar, and two more links from one of its links to the ground."""
    point, normal, _ = m.plane()
    corners = m.corners(4)
    names = m.ring([point(x) for x in corners], [normal] * 4, at=3)
    on = str(m.rng.choice(["l1", "l2"]))
    end = corners[2] + m.number(0.2, 0.4, 2)
    knee = end + m.number(0.3, 0.6, 2) * m.rng.choice([-1, 1], 2)
    foot = knee + m.number(0.3, 0.6) * np.array(_frame2(m, end - knee))
    m.join(GROUND, "foot", point(foot), normal)
    m.join("foot", "knee", point(knee), normal)
    m.close("knee", on, point(end), normal)
    m.drive(1, names[:1])


def _frame2(m, v):
    t = math.atan2(v[1], v[0]) + m.number(1.0, 2.1)
    return math.cos(t), math.sin(t)


def _geared(m):
    """A plane five-bar whose two cranks are geared."""
    point, normal, _ = m.plane()
    names = m.ring([point(x) for x in m.corners(5)], [normal] * 5, at=int(m.rng.integers(2, 4)))
    ratio = float(m.rng.choice([-2.0, -1.0, -0.5, 0.5, 1.0, 2.0]))
    m.drawing.couplings.append((names[0], names[4], ratio))
    m.drive(1, names[:1])


def _palletiser(m):
    """An arm of two links; parallel rods hold its gripper level."""
    point, normal, _ = m.plane()
    shoulder, t, s = m.number(-0.2, 0.2, 2), m.number(1.2, 1.9), m.number(-0.5, 0.4)
    elbow = shoulder + m.number(0.5, 0.8) * np.array([math.cos(t), math.sin(t)])
    wrist = elbow + m.number(0.5, 0.8) * np.array([math.cos(s), math.sin(s)])
    back = np.array([m.number(-0.3, -0.2), m.number(-0.1, 0.1)])
    over = np.array([m.number(-0.1, 0.1), m.number(0.2, 0.3)])
    m.join(GROUND, "arm", point(shoulder), normal)
    m.join("arm", "triangle", point(elbow), normal)
    m.join("arm", "forearm", point(elbow), normal)
    m.join("forearm", "gripper", point(wrist), normal)
    m.join(GROUND, "rear_rod", point(shoulder + back), normal)
    m.close("rear_rod", "triangle", point(elbow + back), normal)
    m.join("triangle", "upper_rod", point(elbow + over), normal)
    m.close("upper_rod", "gripper", point(wrist + over), normal)
    m.drive(2, ["j0", "j2"])


def _three_legs(m):
    """A platform in a plane on three legs of three hinges."""
    point, normal, _ = m.plane()
    feet, heads = m.corners(3) * 1.3, m.corners(3) * 0.5
    m.drawing.drivers = []
    for k, (foot, head) in enumerate(zip(feet, heads, strict=True)):
        out = np.array([head[1] - foot[1], foot[0] - head[0]])
        knee = 0.5 * (foot + head) + m.number(0.3, 0.5) * out
        m.drawing.drivers.append(m.join(GROUND, f"arm{k}", point(foot), normal))
        m.join(f"arm{k}", f"rod{k}", point(knee), normal)
        if k == 0:
            m.join("rod0", "platform", point(head), normal)
        else:
            m.close(f"rod{k}", "platform", point(head), normal)
    m.drive(3, m.drawing.drivers)


def _delta(m):
    """A platform on three arms with parallelograms of hinges: it does not turn."""
    up, middle, drivers = m.direction(), m.point(), []
    east, north = _frame(up)
    for k in range(3):
        turn = 2 * math.pi * k / 3 + m.number(-0.2, 0.2)
        out = math.cos(turn) * east + math.sin(turn) * north
        u = np.cross(up, out)
        t = m.number(-0.3, 0.4)
        foot = middle + m.number(0.3, 0.4) * out
        knee = foot + m.number(0.3, 0.4) * (math.cos(t) * out + math.sin(t) * up)
        rod = (-m.number(0.6, 0.8) * up - m.number(0.3, 0.5) * out + m.number(-0.1, 0.1) * u)
        w = m.number(0.08, 0.12) * u
        head, normal = knee + rod, _unit(np.cross(u, rod))
        drivers.append(m.join(GROUND, f"arm{k}", foot, u))
        m.join(f"arm{k}", f"top{k}", knee, u)
        m.join(f"top{k}", f"rod{k}a", knee + w, normal)
        m.join(f"top{k}", f"rod{k}b", knee - w, normal)
        m.join(f"rod{k}a", f"bar{k}", head + w, normal)
        m.close(f"rod{k}b", f"bar{k}", head - w, normal)
        if k == 0:
            m.join("bar0", "platform", head, u)
        else:
            m.close(f"bar{k}", "platform", head, u)
    m.drawing.balls = False
    m.drive(3, drivers)


def _seven_hinges(m):
    """A loop in space without a redundant equation."""
    names = m.ring([m.point() * 1.5 for _ in range(7)], [m.direction() for _ in range(7)])
    m.drawing.balls = False
    m.drive(1, [x for x in names if x][:1])


FAMILIES = {"plane loop": _plane_loop, "parallelogram": _parallelogram,
            "slider-crank": _slider_crank, "trammel": _trammel, "spherical loop": _spherical_loop,
            "Bennett": _bennett, "Bricard": _bricard, "Sarrus": _sarrus, "six-bar": _six_bar,
            "geared five-bar": _geared, "palletiser": _palletiser, "three legs": _three_legs,
            "delta": _delta, "seven hinges": _seven_hinges}
_WEIGHTS = np.array([3, 2, 1.5, 1, 2, 2, 2, 2, 1.5, 1, 1.5, 1, 0.7, 1])
SHARES = _WEIGHTS / _WEIGHTS.sum()
