"""Closed mechanisms for inverse kinematics, as trees of hinges and slides with points to close.

Every tool loads the same URDF, with universal joints and the six freedoms of a platform as hinges
and slides, and closes the same points. A target is the pose of a frame when the joints that carry
it, `leading`, have certain values; so it can be reached. Results are joints' values, judged by the
kinematics in this file.

The ankle is that of the G1 humanoid, from an MJCF model assembled by feidedao, Copyright (c) 2026
feidedao, MIT License ("The above copyright notice and this permission notice shall be included in
all copies or substantial portions of the Software"); here are its joints and anchors only.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmark import excavator, stewart
from benchmark.case import Case

Array = NDArray[np.float64]
Values = Mapping[str, float]  # joints' values by name

MET = 1e-5  # what counts as met: closures and positions [m], orientations [rad]
TARGETS, SAMPLES = 20, 200  # of a task of single targets, of one of a path
STEPS_AT_MOST = 50  # of tools that are called step by step
TOLERANCE = 1e-10  # at which these stop, of closures and targets [m, rad]


class Joint(NamedTuple):
    """A hinge or slide, or a fixed point; its link has its name with "_link" behind it."""

    name: str
    parent: str
    kind: str  # "revolute", "prismatic" or "fixed"
    xyz: tuple[float, ...] = (0.0, 0.0, 0.0)
    rpy: tuple[float, ...] = (0.0, 0.0, 0.0)
    axis: tuple[float, ...] = (0.0, 0.0, 1.0)


class Target(NamedTuple):
    """Values of the leading joints, and where (4, 4) the frame is then."""

    values: dict[str, float]
    pose: Array


class Robot(NamedTuple):
    """A closed mechanism.

    Attributes:
        name: a key of ROBOTS.
        joints: of the tree, parents first.
        closures: pairs of fixed joints whose links' origins coincide.
        axes: which coordinates of a closure, in the first point's frame, are to close: the others
            do so by themselves.
        frame: whose link a target is for.
        kind: of targets: "placement" or "point" of the frame, or "joints", the leading ones.
        leading: joints that carry the frame: value when home, and how far targets are from there.
        guess: values of the other joints to start from, zero if not here.
        drivers: joints that drive it.
    """

    name: str
    joints: Sequence[Joint]
    closures: Sequence[tuple[str, str]]
    axes: str
    frame: str
    kind: str
    leading: Mapping[str, tuple[float, float]]
    guess: Values
    drivers: Sequence[str]

    @property
    def moving(self) -> list[str]:
        """Names of the joints that move."""
        return [joint.name for joint in self.joints if joint.kind != "fixed"]

    def home(self) -> dict[str, float]:
        """Return values of all joints to start from; loops are nearly closed."""
        values = dict.fromkeys(self.moving, 0.0) | dict(self.guess)
        return values | {name: value for name, (value, _) in self.leading.items()}

    def targets(self) -> list[Target]:
        """Return targets here and there about home."""
        rng = np.random.default_rng(3)
        return [self.target(rng.uniform(-1.0, 1.0, len(self.leading))) for _ in range(TARGETS)]

    def path(self) -> list[Target]:
        """Return targets along a smooth path that begins at home."""
        turns, k = np.linspace(0.0, 2.0 * np.pi, SAMPLES), 1.0 + np.arange(len(self.leading))
        return [self.target(0.7 * np.sin(t * (1.0 + k % 2)) * np.cos(k * t)) for t in turns]

    def target(self, parts: Array) -> Target:
        """Return the target at parts of the way of the leading joints from home."""
        values = {name: value + part * far
                  for part, (name, (value, far)) in zip(parts, self.leading.items(), strict=True)}
        return Target(values, self.placements(self.home() | values)[self.frame])

    def placements(self, values: Values) -> dict[str, Array]:
        """Return (4, 4) of every joint's link in the world."""
        poses = {"ground": np.eye(4)}
        for joint in self.joints:
            pose = poses[joint.parent] @ placement(joint.xyz, joint.rpy)
            axis, value = np.array(joint.axis), values.get(joint.name, 0.0)
            if joint.kind == "revolute":
                pose = pose.copy()
                pose[:3, :3] = pose[:3, :3] @ stewart.exponential(axis * value)
            elif joint.kind == "prismatic":
                pose = pose @ placement(axis * value, (0.0, 0.0, 0.0))
            poses[joint.name] = pose
        return poses

    def judge(self, targets: Sequence[Target], results: Sequence[Values]) -> dict[str, float]:
        """Return the largest errors of the targets that were met, and how many were not."""
        errors = np.array([self.errors(*pair) for pair in zip(targets, results, strict=True)])
        met = (errors < MET).all(axis=1)
        closure, target = errors[met].max(axis=0, initial=0.0)
        return {"closure": float(closure), "target": float(target), "missed": float((~met).sum())}

    def errors(self, target: Target, values: Values) -> tuple[float, float]:
        """Return how far closures are open [m], and it is off its target [m, rad]."""
        pose = self.placements(values)
        gaps = [pose[a][:3, 3] - pose[b][:3, 3] for a, b in self.closures]
        return float(np.linalg.norm(gaps, axis=1).max()), self.off(target, values, pose)

    def off(self, target: Target, values: Values, pose: Mapping[str, Array]) -> float:
        """Return how far it is off its target [m, rad]."""
        if self.kind == "joints":
            return max(abs(values[name] - x) for name, x in target.values.items())
        off = float(np.linalg.norm(pose[self.frame][:3, 3] - target.pose[:3, 3]))
        if self.kind == "point":
            return off
        apart = target.pose[:3, :3].T @ pose[self.frame][:3, :3]
        return max(off, float(np.linalg.norm(apart - np.eye(3))) / math.sqrt(2.0))

    def urdf(self) -> str:
        """Return the tree as a URDF."""
        parts = [LINK.format("ground")]
        for j in self.joints:
            parent = j.parent if j.parent == "ground" else f"{j.parent}_link"
            parts += [LINK.format(f"{j.name}_link"), JOINT.format(
                j.name, j.kind, parent, *(" ".join(map(repr, map(float, x)))
                                          for x in (j.xyz, j.rpy, j.axis)))]
        return f'<robot name="{self.name}">{"".join(parts)}</robot>'

    def write(self, folder: Path) -> Path:
        """Write the URDF and a mechanism file beside it; return the latter."""
        (folder / f"{self.name}.urdf").write_text(self.urdf())
        lines = [f'name = "{self.name}"', f'tree = "{self.name}.urdf"']
        for a, b in self.closures:
            lines += ["[[closures]]", f'name = "{a}_closure"', 'type = "spherical"',
                      f'frames = ["{a}_link", "{b}_link"]']
        lines += [f'[drivers.{name}_driver]\njoint = "{name}"' for name in self.drivers]
        lines += ["[guess]", *(f"{name} = {x!r}" for name, x in self.home().items())]
        path = folder / f"{self.name}.toml"
        path.write_text("\n".join(lines))
        return path


LINK = ('<link name="{}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" '
        'ixz="0" iyz="0"/></inertial></link>')
JOINT = ('<joint name="{0}" type="{1}"><parent link="{2}"/><child link="{0}_link"/>'
         '<origin xyz="{3}" rpy="{4}"/><axis xyz="{5}"/>'
         '<limit lower="-10" upper="10" effort="1" velocity="1e9"/></joint>')
X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


def placement(xyz: Sequence[float], rpy: Sequence[float]) -> Array:
    """Return (4, 4) of a position and roll, pitch and yaw, as URDF has them."""
    M = np.eye(4)
    for axis, angle in zip((Z, Y, X), reversed(rpy), strict=True):
        M[:3, :3] = M[:3, :3] @ stewart.exponential(np.array(axis) * angle)
    M[:3, 3] = xyz
    return M


def free(xyz: tuple[float, ...]) -> list[Joint]:
    """Return six joints that leave a platform all its freedoms; the last is "platform"."""
    slides = [Joint(f"pose_{n}", parent, "prismatic", axis=a, xyz=at) for n, parent, a, at in (
        ("x", "ground", X, xyz), ("y", "pose_x", Y, (0.0,) * 3), ("z", "pose_y", Z, (0.0,) * 3))]
    return [*slides, Joint("pose_roll", "pose_z", "revolute", axis=X),
            Joint("pose_pitch", "pose_roll", "revolute", axis=Y),
            Joint("platform", "pose_pitch", "revolute", axis=Z)]


POSE = ("pose_x", "pose_y", "pose_z", "pose_roll", "pose_pitch", "platform")


def gough() -> Robot:
    """Return the library's Gough platform."""
    joints, home = free((0.0, 0.0, stewart.HEIGHT)), stewart.HOME
    for k in range(6):
        foot, top = stewart.FEET[k], stewart.TOPS[k]
        dx, dy = (top - foot)[:2]
        lean = (0.0, math.atan2(math.hypot(dx, dy), stewart.HEIGHT), math.atan2(dy, dx))
        joints += [Joint(f"first_{k}", "ground", "revolute", tuple(foot), lean, X),
                   Joint(f"second_{k}", f"first_{k}", "revolute", axis=Y),
                   Joint(f"slide_{k}", f"second_{k}", "prismatic"),
                   Joint(f"rod_{k}", f"slide_{k}", "fixed"),
                   Joint(f"top_{k}", "platform", "fixed", tuple(top))]
    far = dict.fromkeys(POSE[:3], 0.05) | dict.fromkeys(POSE[3:], 0.25)
    return Robot("gough", joints, [(f"rod_{k}", f"top_{k}") for k in range(6)], "xyz", "platform",
                 "placement", {name: (0.0, x) for name, x in far.items()},
                 {f"slide_{k}": float(home[k]) for k in range(6)},
                 [f"slide_{k}" for k in range(6)])


def delta() -> Robot:
    """Return the library's delta robot [Clavel 1988]."""
    base, top, arm, rod, wide = 0.567, 0.076, 0.524, 1.244, 0.13
    inner, corner = base * math.sqrt(3) / 6, top * math.sqrt(3) / 3
    out = inner + arm - corner
    height = math.sqrt(rod**2 - out**2)
    joints, closures = free((0.0, 0.0, -height)), []
    for k in range(3):
        yaw = math.radians(120 * k - 90)
        c, s = math.cos(yaw), math.sin(yaw)
        joints.append(Joint(f"shoulder_{k}", "ground", "revolute", (inner * c, inner * s, 0.0),
                            (0.0, 0.0, yaw), Y))
        for side, y in (("a", -wide / 2), ("b", wide / 2)):
            n = f"{k}{side}"
            joints += [Joint(f"first_{n}", f"shoulder_{k}", "revolute", (arm, y, 0.0),
                             (0.0, math.atan2(-out, -height), 0.0), Y),
                       Joint(f"second_{n}", f"first_{n}", "revolute", axis=X),
                       Joint(f"rod_{n}", f"second_{n}", "fixed", (0.0, 0.0, rod)),
                       Joint(f"top_{n}", "platform", "fixed",
                             (corner * c - y * s, corner * s + y * c, 0.0))]
            closures.append((f"rod_{n}", f"top_{n}"))
    return Robot("delta", joints, closures, "xyz", "platform", "point",
                 {name: (0.0, 0.25) for name in POSE[:3]}, {}, [f"shoulder_{k}" for k in range(3)])


def digger() -> Robot:
    """Return the library's excavator, its swing locked: the teeth stay in a plane."""
    e, down = excavator, (0.0, -1.0, 0.0)

    def hinge(name: str, parent: str, x: float, z: float) -> Joint:
        return Joint(name, parent, "revolute", (x, 0.0, z), axis=down)

    lug = (e.LUG * math.cos(e.LUG_ANGLE), e.LUG * math.sin(e.LUG_ANGLE))
    points = (("boom_lug", "boom", 2.62, 0.86), ("arm_lug", "arm", -0.87, 0.23),
              ("tip", "tipping", e.TIPPING, 0.0), ("link", "connecting", e.CONNECTING, 0.0),
              ("bucket_lug", "bucket", *lug), ("teeth", "bucket", 1.48, 0.0))
    joints = [Joint("swing", "ground", "fixed"), hinge("boom", "swing", 0.085, 1.80),
              hinge("arm", "boom", e.BOOM, 0.0), hinge("bucket", "arm", e.ARM, 0.0),
              hinge("boom_base", "swing", 0.665, 1.22), hinge("arm_base", "boom", 2.95, 1.32),
              hinge("bucket_base", "arm", 0.36, 0.50),
              hinge("tipping", "arm", e.ARM - e.GROUND, 0.03),
              hinge("connecting", "tipping", e.TIPPING, 0.0)]
    for name in ("boom", "arm", "bucket"):
        joints += [Joint(f"{name}_slide", f"{name}_base", "prismatic", axis=X),
                   Joint(f"{name}_rod", f"{name}_slide", "fixed")]
    joints += [Joint(name, parent, "fixed", (x, 0.0, z)) for name, parent, x, z in points]
    closures = [("boom_rod", "boom_lug"), ("arm_rod", "arm_lug"), ("bucket_rod", "tip"),
                ("link", "bucket_lug")]
    guess = {"boom_base": 0.87, "arm_base": -0.15, "bucket_base": 0.08, "tipping": 1.64,
             "connecting": -1.99, "boom_slide": 2.7, "arm_slide": 2.9, "bucket_slide": 2.1}
    leading = {"boom": (0.25, 0.4), "arm": (-1.44, 0.5), "bucket": (-0.4, 0.8)}
    return Robot("excavator", joints, closures, "xz", "teeth", "placement", leading, guess,
                 ["boom_slide", "arm_slide", "bucket_slide"])


def ankle() -> Robot:
    """Return the G1's ankle: two motors in the shank turn the foot about two axes."""

    def rpy(w: float, x: float, y: float, z: float) -> tuple[float, float, float]:
        return (math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
                math.asin(2 * (w * y - z * x)),
                math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))

    joints = [Joint("pitch", "ground", "revolute", (0.0, 0.0, 0.15), axis=Y),
              Joint("roll", "pitch", "revolute", (0.0, 0.0, -0.017558), axis=X)]
    sides = (("right", (0.022, -0.015, 0.0079999), (0.999214, 0.0030657, 0.039534, -0.00011502), X,
              0.36587, (0.0175, -0.016359, -0.0046245)),
             ("left", (0.022, 0.015, 0.0079999), (0.999141, 0.000350633, 0.0414391, -8.26912e-06),
              (-1.0, 0.0, 0.0), 0.30087, (0.013, 0.016529, -0.0039746)))
    for side, at, quaternion, axis, height, anchor in sides:
        joints += [Joint(f"{side}_u", "roll", "revolute", at, axis=Y),
                   Joint(f"{side}_rod", f"{side}_u", "revolute", rpy=rpy(*quaternion), axis=axis),
                   Joint(f"{side}_motor", "ground", "revolute", (0.022, 0.0, height), axis=X),
                   Joint(f"{side}_horn", f"{side}_motor", "fixed", anchor)]
    open_ = Robot("ankle", joints, [], "xyz", "roll", "joints", {}, {}, [])
    home = open_.placements({})  # MJCF: the anchors coincide where all joints are zero
    for side in ("right", "left"):
        at = np.linalg.solve(home[f"{side}_rod"], home[f"{side}_horn"][:, 3])[:3]
        joints.append(Joint(f"{side}_end", f"{side}_rod", "fixed", tuple(at)))
    return open_._replace(
        joints=joints, closures=[(f"{side}_horn", f"{side}_end") for side in ("right", "left")],
        leading={"pitch": (0.0, 0.4), "roll": (0.0, 0.2)}, drivers=["right_motor", "left_motor"])


ROBOTS = {robot.name: robot for robot in (gough(), delta(), digger(), ankle())}


# ---------------------------------------------------------------- what every tool does


class Tool(NamedTuple):
    """A tool with a mechanism, ready to solve.

    Attributes:
        robot: the mechanism.
        targets: one after another.
        home: configuration that meets the home target, in the tool's terms.
        solve: returns the configuration that meets a target, from another one on.
        values: returns the joints' values of a configuration.
        on: whether each target is solved from the one before, not from home.
    """

    robot: Robot
    targets: Sequence[Target]
    home: Any
    solve: Callable[[Target, Any], Any]
    values: Callable[[Any], Values]
    on: bool


def setup(make: Callable[[Robot], tuple[Any, Any, Any]], name: str, on: bool) -> Tool:
    """Return a tool; `make` gives a rough home, `solve` and `values`."""
    robot = ROBOTS[name]
    rough, solve, values = make(robot)
    home = solve(robot.target(np.zeros(len(robot.leading))), rough)
    return Tool(robot, robot.path() if on else robot.targets(), home, solve, values, on)


def run(tool: Tool) -> list[Any]:
    """Return the configurations found."""
    results, at = [], tool.home
    for target in tool.targets:
        there = tool.solve(target, at)
        results.append(there)
        if tool.on:
            at = there
    return results


def judge(tool: Tool, results: Sequence[Any]) -> dict[str, float | None]:
    """Return the errors."""
    return dict(tool.robot.judge(tool.targets, [tool.values(x) for x in results]))


def cases(
    title: str, how: str, make: Callable[[Robot], tuple[Any, Any, Any]]
) -> tuple[Case, ...]:
    """Return the cases of a tool: single targets and paths of every mechanism."""
    return tuple(
        Case(f"{'path' if on else 'reach'}-{name}", title, how, partial(setup, make, name, on),
             run, judge, SAMPLES if on else TARGETS)
        for name in ROBOTS for on in (False, True))
