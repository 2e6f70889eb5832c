"""Random mechanisms that close by construction.

A spec is plain data: joints, frames, closures, drivers, inertias, springs, and `q`, a configuration
(numbered as in `judge`) in which every closure holds. Closures are added between random links:
frame 2 is put where the pair's relation to frame 1 holds, so no equation has to be solved.
"""

from __future__ import annotations

import math

import numpy as np

from fuzzing.judge import CLOSURES, COORDINATES, NV, TURNING, Judge
from fuzzing.rotations import LD, PI, about, from_rpy, onto, to_rpy, unit

JOINTS = {"revolute": 5, "continuous": 5, "prismatic": 3, "screw": 2, "cylindrical": 2,
          "universal": 3, "spherical": 2.2, "planar": 1.2, "floating": 0.8}  # how often
PLANE_JOINTS = {"revolute": 8, "continuous": 7, "prismatic": 4, "planar": 1}
EQUATIONS = {"revolute": 5, "prismatic": 5, "screw": 5, "cylindrical": 4, "universal": 4,
             "spherical": 3, "planar": 3, "weld": 6, "fixed": 6, "distance": 1, "point_on_line": 2,
             "point_on_plane": 1, "parallel": 2, "perpendicular": 1, "coupling": 1, "rope": 1,
             "point_on_curve": 2, "frame_on_curve": 4, "cam": 1}
IN_A_PLANE = {"revolute": 2, "prismatic": 2, "distance": 1, "coupling": 1, "point_on_line": 1,
              "spherical": 2, "cylindrical": 2, "planar": 3, "point_on_curve": 1, "cam": 1,
              "curve_on_curve": 1}  # independent ones of plane mechanisms
WITH_AXIS = ("revolute", "prismatic", "screw", "cylindrical", "planar", "point_on_line",
             "point_on_plane", "parallel", "perpendicular", "universal")
WEAKER = {"weld": ("spherical", "revolute", "weld"), "fixed": ("spherical",),
          "revolute": ("revolute", "spherical", "cylindrical"), "universal": ("spherical",),
          "cylindrical": ("cylindrical", "parallel"), "planar": ("parallel",),
          "prismatic": ("cylindrical",), "screw": ("cylindrical",)}  # what a closure implies
CURVED = ("point_on_curve", "frame_on_curve", "cam", "curve_on_curve")
RANK = 1e-9  # singular values below this part of the largest are zero


def make(seed):
    """The spec of a seed."""
    rng = np.random.default_rng(seed)
    mode = str(rng.choice(["generic", "aligned", "planar"], p=[0.62, 0.2, 0.18]))
    size = float(10 ** rng.uniform(-3, 3)) if rng.random() < 0.3 else 1.0
    spec = {"seed": int(seed), "mode": mode, "size": size, "joints": [], "frames": [],
            "closures": [], "inertias": {}, "springs": [], "drivers": [], "parameters": {}}
    made = _Maker(rng, spec)
    made.tree()
    made.masses()
    made.configuration()
    made.close()
    made.springs()
    spec["gravity"] = made.gravity()
    made.choose_drivers()
    made.parameters()
    return spec


def rank(matrix):
    """Number of singular values that are not zero."""
    s = np.linalg.svd(matrix, compute_uv=False) if matrix.size else np.zeros(0)
    return int((s > RANK * max(s[0], 1e-2)).sum()) if s.size else 0


class _Maker:
    """Fills a spec, step after step."""

    def __init__(self, rng, spec):
        self.rng, self.spec = rng, spec
        self.mode, self.size = spec["mode"], spec["size"]

    # ------------------------------------------------------------ numbers

    def direction(self):
        v = self.rng.normal(size=3)
        return (v / np.linalg.norm(v)).tolist()

    def axis(self):
        if self.mode == "generic":
            return self.direction()
        along = np.eye(3)[self.rng.integers(0, 3)]
        return [float(x) for x in along * self.rng.choice([1, -1])]

    def in_plane(self):
        t = self.rng.uniform(-3, 3)
        return [math.cos(t), math.sin(t), 0.0]

    def xyz(self):
        if self.mode == "generic":
            v = self.rng.uniform(-1, 1, 3)
        elif self.mode == "aligned":
            v = self.rng.choice([0.0, 0.0, 0.5, -0.5, 1.0, -1.0, 0.25], 3)
        else:
            v = [*self.rng.uniform(-1, 1, 2), self.rng.choice([0.0, 0.0, 0.1])]
        return (np.asarray(v, dtype=float) * self.size * 0.5).tolist()

    def rpy(self):
        if self.mode == "generic":
            return self.rng.uniform([-3, -1.4, -3], [3, 1.4, 3]).tolist()
        if self.mode == "aligned":
            quarters = [0.0, 0.0, math.pi / 2, -math.pi / 2, math.pi]
            return [float(x) for x in self.rng.choice(quarters, 3)]
        return [0.0, 0.0, float(self.rng.uniform(-3, 3))]

    def length(self):
        return float(self.rng.uniform(-0.5, 0.5) * self.size)

    def pick(self, weights):
        kinds, w = list(weights), np.array(list(weights.values()), dtype=float)
        return str(self.rng.choice(kinds, p=w / w.sum()))

    # ------------------------------------------------------------ tree

    def tree(self):
        rng, n = self.rng, int(self.rng.integers(2, 9))
        for i in range(n):
            parent = "ground" if i == 0 or rng.random() < 0.3 else f"l{rng.integers(0, i)}"
            if parent != "ground" and rng.random() < 0.5:
                parent = f"l{i - 1}"
            self.spec["joints"].append(self.joint(i, parent))
        if rng.random() < 0.15:
            self.spec["joints"].append({"name": f"j{n}", "kind": "fixed", "child": f"l{n}",
                                        "parent": f"l{rng.integers(0, n)}", "xyz": self.xyz(),
                                        "rpy": self.rpy()})

    def joint(self, i, parent):
        if self.mode == "planar":
            kind = self.pick(PLANE_JOINTS)
            axis = [0.0, 0.0, 1.0 if kind == "planar" else float(self.rng.choice([1, -1]))]
            axis = self.in_plane() if kind == "prismatic" else axis
        else:
            kind, axis = self.pick(JOINTS), self.axis()
        joint = {"name": f"j{i}", "kind": kind, "parent": parent, "child": f"l{i}",
                 "xyz": self.xyz(), "rpy": self.rpy()}
        if kind not in TURNING:
            joint["axis"] = axis
        if kind == "universal":
            joint["axis2"] = self.across(np.array(axis))
        if kind == "screw":
            joint["lead"] = self.lead()
        return joint

    def across(self, axis):
        other = self.rng.normal(size=3)
        if self.mode != "generic":
            other = np.eye(3)[(int(np.argmax(np.abs(axis))) + 1) % 3]
        v = np.cross(axis, other)
        return (v / np.linalg.norm(v)).tolist()

    def lead(self):
        return float(self.rng.choice([-1, 1]) * self.rng.uniform(0.05, 0.5) * self.size)

    def masses(self):
        for joint in self.spec["joints"]:
            if self.rng.random() < 0.93:
                mass = float(10 ** self.rng.uniform(-1, 1))
                if self.rng.random() < 0.05:
                    mass *= 10 ** self.rng.uniform(-4, 4)
                self.spec["inertias"][joint["child"]] = self.inertia(mass)

    def inertia(self, mass):
        """Four equal points about the centre of mass: an inertia that a body can have."""
        points = self.rng.normal(size=(4, 3)) * self.size * 0.2
        points -= points.mean(0)
        tensor = sum(mass / 4 * ((p @ p) * np.eye(3) - np.outer(p, p)) for p in points)
        return {"mass": mass, "com": (self.rng.normal(size=3) * 0.3 * self.size).tolist(),
                "tensor": tensor[np.triu_indices(3)].tolist()}

    def configuration(self):
        rng, judge = self.rng, Judge(self.spec)
        step = np.zeros(judge.nv)
        if self.mode == "generic" or rng.random() > 0.25:
            for i, joint in enumerate(self.spec["joints"]):
                turns = 1.2 if joint["kind"] in TURNING else 2.0
                for k, (_, u) in enumerate(COORDINATES[joint["kind"]]):
                    reach = turns if u == "rad" else 0.4 * self.size
                    step[judge.v_at[i] + k] = rng.uniform(-reach, reach)
        self.spec["q"] = judge.integrate(judge.neutral(), step)[0].astype(float).tolist()

    # ------------------------------------------------------------ closures

    def close(self):
        """Add closures until few freedoms remain; now and then a redundant one."""
        rng, spec = self.rng, self.spec
        wanted = int(rng.choice([0, 1, 2, 3, 4], p=[0.04, 0.56, 0.22, 0.1, 0.08]))
        nv, most = Judge(spec).nv, int(rng.integers(2, 11))
        repeats = rng.random() < 0.1
        for _ in range(40):
            have = self.rank()
            if nv - have <= wanted or len(spec["closures"]) == most:
                break
            counts = IN_A_PLANE if self.mode == "planar" else EQUATIONS
            fits = {k: 2 if n >= 3 else 1 for k, n in counts.items() if n <= nv - have - wanted}
            if not fits:
                break
            before = list(spec["closures"]), list(spec["frames"])
            if self.add(self.pick(fits)) and not have < self.rank() <= nv - wanted:
                spec["closures"], spec["frames"] = before
        if repeats and spec["closures"]:
            self.repeat()

    def rank(self):
        return rank(Judge(self.spec).jacobian(np.array(self.spec["q"], dtype=LD)))

    def add(self, kind):
        """Add one closure; False where no two links were found for it."""
        c = {"name": f"c{len(self.spec['closures'])}", "type": kind}
        if kind == "coupling":
            return self.couple(c)
        links = self.two_links()
        if links is None:
            return False
        if kind in WITH_AXIS:
            self.give_axes(c)
        if kind == "screw":
            c["lead"] = self.lead()
        if kind in CURVED:
            self.give_curve(c)
        rotation, shift = self.relation(c)
        self.frames_for(c, links, rotation, shift)
        self.spec["closures"].append(c)
        return True

    def give_curve(self, c):
        """Give it a curve, written under its name, and the circle that touches it."""
        rng, a = self.rng, self.size * self.rng.uniform(0.3, 0.9)
        if c["type"] in ("cam", "curve_on_curve"):
            c["other"] = float(self.size * rng.uniform(0.05, 0.2))
            shape = {"circle": {"radius": a, "centre": [0.3 * a, -0.2 * a, 0.0]}}
        else:
            planar = self.mode == "planar" or rng.random() < 0.4
            slant = [1.0, 0.5, 0.0] if self.mode == "planar" else [1.0, 0.5, -0.8]
            shape = {"ellipse": {"semi_axes": [a, a * rng.uniform(0.4, 1.3)]}} if planar else (
                {"helix": {"radius": a, "lead": a * rng.uniform(0.5, 2.0)}} if rng.random() < 0.5
                else {"points": [[a * k * x for x in slant] for k in range(5)]})
        c["shape"], names = shape, [f"{c['name']}_curve"]
        self.spec.setdefault("curves", {})[names[0]] = shape
        if c["type"] == "curve_on_curve":
            names.append(f"{c['name']}_other")
            self.spec["curves"][names[1]] = {"circle": {"radius": c["other"]}}
            c["curves"] = names
        else:
            c["curve"] = names[0]
        if c["type"] == "cam":
            c["follower"] = {"roller": c["other"]}

    def on_curve(self, c):
        """A point (3,) on its curve, the tangent there, and a point that touches a circle."""
        (form, shape), t = next(iter(c["shape"].items())), self.rng.uniform(-2.5, 2.5)
        along = np.array([math.cos(t), math.sin(t), 0.0])
        ahead = np.array([-math.sin(t), math.cos(t), 0.0])
        if form == "ellipse":
            sizes = np.array([*shape["semi_axes"], 0.0])
            return sizes * along, sizes * ahead
        if form == "helix":
            rise = shape["lead"] / (2.0 * math.pi)
            r = shape["radius"]
            return r * along + [0, 0, rise * t], r * ahead + [0, 0, rise]
        if form == "points":
            line = np.array(shape[1]) - np.array(shape[0])
            return (2.0 + 0.5 * t) * line, line
        return np.array(shape["centre"]) + (shape["radius"] + c["other"]) * along, ahead

    def give_axes(self, c):
        if self.mode == "planar":
            slides = c["type"] in ("prismatic", "point_on_line")
            c["axis"] = self.in_plane() if slides else [0.0, 0.0, 1.0]
        elif self.rng.random() < 0.6:
            c["axis"] = self.axis()
        if c["type"] == "perpendicular" or (c["type"] == "universal" and self.rng.random() < 0.6):
            c["axis2"] = self.axis()

    def couple(self, c):
        judge = Judge(self.spec)
        if len(judge.linear) < 2:
            return False
        form = self.pick({"ratio": 2, "ratios": 1, "function": 1})
        if form == "ratios" and len(judge.linear) > 2:
            return self.couple_several(c, judge)
        a, b = (str(x) for x in self.rng.choice(list(judge.linear), 2, replace=False))
        (qa, va), (qb, vb) = judge.linear[a], judge.linear[b]
        ratio = float(self.rng.choice([-1, 1]) * self.rng.uniform(0.3, 2.0))
        ratio *= float(judge.scale[vb] / judge.scale[va])
        q = self.spec["q"]
        law = {"ratio": ratio, "offset": q[qb] - ratio * q[qa]}
        if form == "function":  # a cubic, whose slope at the configuration is near the ratio
            bent = [ratio * float(x) / float(judge.scale[va]) ** k
                    for k, x in enumerate(self.rng.uniform(-0.3, 0.3, 2), start=1)]
            rise = ratio * q[qa] + bent[0] * q[qa] ** 2 + bent[1] * q[qa] ** 3
            law = {"function": {"polynomial": [q[qb] - rise, ratio, *bent]}}
        self.spec["closures"].append(c | {"joints": [a, b]} | law)
        return True

    def couple_several(self, c, judge):
        """Add a sum of three or four coordinates, as of a differential."""
        n = int(self.rng.integers(3, min(5, len(judge.linear) + 1)))
        names = [str(x) for x in self.rng.choice(list(judge.linear), n, replace=False)]
        at = [judge.linear[name] for name in names]
        ratios = [float(self.rng.choice([-1, 1]) * self.rng.uniform(0.3, 2.0) / judge.scale[v])
                  for _, v in at]
        total = sum(r * self.spec["q"][q] for r, (q, _) in zip(ratios, at, strict=True))
        self.spec["closures"].append(c | {"joints": names, "ratios": ratios, "offset": -total})
        return True

    def two_links(self):
        """Two links that are not fixed to each other, or None."""
        fixed_to = {"ground": "ground"}
        for j in self.spec["joints"]:
            fixed_to[j["child"]] = fixed_to[j["parent"]] if j["kind"] == "fixed" else j["child"]
        for _ in range(30):
            a, b = (str(x) for x in self.rng.choice(list(fixed_to), 2, replace=False))
            if fixed_to[a] != fixed_to[b]:
                return a, b
        return None

    def relation(self, c):
        """A rotation (3, 3) and place (3,) of frame 2 in frame 1 that the pair allows."""
        kind, rng = c["type"], self.rng
        axis = c.get("axis", [1.0, 0.0, 0.0] if kind == "universal" else [0.0, 0.0, 1.0])
        f = onto(axis).astype(float)
        angle = rng.uniform(-2.5, 2.5)
        turned = about(unit(axis), np.array([angle], dtype=LD))[0].astype(float)
        across = f[:, 0] * self.length() + f[:, 1] * self.length()
        none, along, anywhere = np.zeros(3), f[:, 2] * self.length(), self.rng.uniform(-0.5, 0.5, 3)
        free = self.free_rotation()
        point, tangent = self.on_curve(c) if kind in CURVED else (none, np.eye(3)[2])
        spun = about(unit([0, 0, 1]), np.array([angle], dtype=LD))[0].astype(float)
        return {
            "point_on_curve": (free, point), "cam": (free, point), "curve_on_curve": (free, point),
            "frame_on_curve": (onto(tangent).astype(float) @ spun, point),
            "rope": (free, self.some_direction()),
            "revolute": (turned, none), "prismatic": (np.eye(3), along),
            "cylindrical": (turned, along), "spherical": (free, none), "planar": (turned, across),
            "screw": (turned, f[:, 2] * c.get("lead", 0.0) * angle / (2 * float(PI))),
            "weld": (np.eye(3), none), "fixed": (np.eye(3), none),
            "universal": (self.crossed(c, f), none),
            "perpendicular": (self.crossed(c, f), anywhere * self.size),
            "distance": (free, self.some_direction()), "point_on_line": (free, along),
            "point_on_plane": (free, across), "parallel": (turned, anywhere * self.size),
        }[kind]

    def free_rotation(self):
        if self.mode == "planar":
            return from_rpy([0, 0, self.rng.uniform(-3, 3)]).astype(float)
        return from_rpy(self.rng.uniform([-3, -1.4, -3], [3, 1.4, 3])).astype(float)

    def crossed(self, c, f):
        """A rotation that takes axis2 into the plane across the axis."""
        t, s = self.rng.uniform(-3, 3, 2)
        target = f[:, 0] * math.cos(t) + f[:, 1] * math.sin(t)
        start = onto(c.get("axis2", [0, 1, 0]))
        return (onto(target) @ from_rpy([0, 0, s]) @ start.T).astype(float)

    def some_direction(self):
        d = np.array(self.direction())
        if self.mode == "planar":
            d = np.array(self.in_plane())
        return d * self.rng.uniform(0.2, 0.9) * self.size

    def frames_for(self, c, links, rotation, shift):
        """Put frame 1 anywhere on its link, frame 2 where the relation holds."""
        names = c["frames"] = [f"{c['name']}a", f"{c['name']}b"]
        frames = self.spec["frames"]
        frames.append({"name": names[0], "link": links[0], "xyz": self.xyz(), "rpy": self.rpy()})
        judge = Judge(self.spec)
        placements = judge.placements(np.array([self.spec["q"]], dtype=LD))
        (r1, p1), (r2, p2) = ((r[0], p[0]) for r, p in (
            judge.frame(names[0], placements), judge.frame(links[1], placements)))
        offset = r2.T @ (p1 + r1 @ shift - p2)
        frames.append({"name": names[1], "link": links[1], "xyz": [float(x) for x in offset],
                       "rpy": to_rpy(r2.T @ r1 @ rotation)})
        if c["type"] in ("distance", "rope"):
            judge = Judge(self.spec)
            a, b = (judge.frame(name, placements)[1][0] for name in names)
            c["length"] = float(np.sqrt(((a - b) ** 2).sum()))

    def repeat(self):
        """Add a closure that repeats another one, or a part of it."""
        c = dict(self.rng.choice(np.array(self.spec["closures"], dtype=object)))
        if c["type"] in ("coupling", "rope", *CURVED):
            return
        kind = str(self.rng.choice(WEAKER.get(c["type"], (c["type"],))))
        again = {"name": f"c{len(self.spec['closures'])}", "type": kind, "frames": c["frames"]}
        if kind in WITH_AXIS and "axis" in c:
            again["axis"] = c["axis"]
        for key, owner in (("axis2", "universal"), ("axis2", "perpendicular"), ("lead", "screw"),
                           ("length", "distance")):
            if kind == owner and key in c:
                again[key] = c[key]
        self.spec["closures"].append(again)

    # ------------------------------------------------------------ forces, drivers, dimensions

    def springs(self):
        if self.rng.random() > 0.35:
            return
        judge = Judge(self.spec)
        for k in range(int(self.rng.integers(1, 3))):
            damping = float(self.rng.choice([0.0, 0.0, 1.0]) * self.rng.uniform(0, 2))
            spring = {"name": f"s{k}", "stiffness": float(10 ** self.rng.uniform(0, 2)),
                      "damping": damping}
            if self.rng.random() < 0.5 and judge.linear:
                self.about_joint(spring, judge)
            else:
                self.between(spring)

    def about_joint(self, spring, judge):
        name = spring["joint"] = str(self.rng.choice(list(judge.linear)))
        unit_of = judge.units[judge.linear[name][1]]
        free = float(self.rng.uniform(-1, 1))
        if unit_of == "rad":
            spring["free_angle"] = free
            spring["stiffness"] *= self.size**2
            spring["damping"] *= self.size**2
        else:
            spring["free_length"] = free * self.size
        self.spec["springs"].append(spring)

    def between(self, spring):
        links = self.two_links()
        if links is None:
            return
        spring["frames"] = [f"{spring['name']}a", f"{spring['name']}b"]
        for name, link in zip(spring["frames"], links, strict=True):
            xyz = (self.rng.uniform(-0.5, 0.5, 3) * self.size).tolist()
            self.spec["frames"].append({"name": name, "link": link, "xyz": xyz, "rpy": [0.0] * 3})
        spring["free_length"] = float(self.rng.uniform(0, 1) * self.size)
        self.spec["springs"].append(spring)

    def gravity(self):
        if self.mode == "planar":
            return [0.0, -9.81, 0.0]
        return (self.rng.normal(size=3) * 5).tolist() if self.rng.random() < 0.5 else [0, 0, -9.81]

    def choose_drivers(self):
        """Drive as many coordinates as there are freedoms, well away from their dead centres."""
        judge = Judge(self.spec)
        have = judge.jacobian(np.array(self.spec["q"], dtype=LD))
        best = rank(have)
        dof = judge.nv - best
        names = list(judge.linear)
        self.rng.shuffle(names)
        for name in names:
            if len(self.spec["drivers"]) == dof:
                break
            row = np.zeros((1, judge.nv))
            row[0, judge.linear[name][1]] = 1.0
            s = np.linalg.svd(np.vstack([have, row]), compute_uv=False)
            if len(s) > best and s[best] > 5e-3 * s[0]:
                have, best = np.vstack([have, row]), best + 1
                self.spec["drivers"].append({"name": f"d{len(self.spec['drivers'])}",
                                             "joint": name})

    def parameters(self):
        """Let two dimensions of frames be parameters of the file, in some mechanisms."""
        if self.rng.random() > 0.3:
            return
        for frame in self.spec["frames"][:2]:
            k = int(self.rng.integers(0, 2 if self.mode == "planar" else 3))
            self.spec["parameters"][f"p_{frame['name']}"] = {
                "frame": frame["name"], "at": k, "value": frame["xyz"][k]}


assert {*EQUATIONS, *IN_A_PLANE} - {"coupling"} == set(CLOSURES)
assert set(JOINTS) | {"fixed"} == set(NV)
