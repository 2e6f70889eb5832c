"""What is true of a random mechanism, by computations that share nothing with the library.

Only the numbers that are written into the files are used; nothing of spatial_pin and nothing of
Pinocchio is imported. Everything is worked out in extended precision for many configurations at
once; derivatives are differences of eleven points along exact curves, good to about 1e-13.
"""

from __future__ import annotations

import numpy as np

from fuzzing.rotations import (
    FIRST,
    LD,
    PI,
    POINTS,
    SECOND,
    THIRD,
    about,
    from_quaternion,
    from_rpy,
    from_turned,
    normal,
    onto,
    product,
    screw_shift,
    skew_part,
    to_quaternion,
    unit,
)

COORDINATES = {  # (suffix, unit) of each kind of joint, in the order of its velocities
    "revolute": [("", "rad")],
    "continuous": [("", "rad")],
    "prismatic": [("", "m")],
    "screw": [("", "rad")],
    "cylindrical": [("angle", "rad"), ("slide", "m")],
    "universal": [("first", "rad"), ("second", "rad")],
    "spherical": [("x", "rad"), ("y", "rad"), ("z", "rad")],
    "planar": [("x", "m"), ("y", "m"), ("angle", "rad")],
    "floating": [("x", "m"), ("y", "m"), ("z", "m"), ("rx", "rad"), ("ry", "rad"), ("rz", "rad")],
    "fixed": [],
}
NV = {kind: len(names) for kind, names in COORDINATES.items()}
NQ = NV | {"spherical": 4, "floating": 7}
TURNING = ("spherical", "floating")  # kinds with a quaternion
STEP = 4e-3  # of difference stencils: their error and round-off are both near 1e-14


class Judge:
    """Kinematics of a mechanism of `generate`; numbering: joints in the order of the spec.

    Attributes:
        nq, nv: number of configuration entries and of freedoms of the tree.
        coordinates: their names; `units` their units, `scale` (nv,) one radian or one size.
        linear: (place in q, place in v) of each coordinate that is an entry of q, by name.
        joint_of: number of the joint that moves each link, by name.
    """

    def __init__(self, spec):
        self.spec, self.joints = spec, spec["joints"]
        kinds = [j["kind"] for j in self.joints]
        self.q_at = np.cumsum([0, *(NQ[k] for k in kinds)]).tolist()
        self.v_at = np.cumsum([0, *(NV[k] for k in kinds)]).tolist()
        self.nq, self.nv = self.q_at[-1], self.v_at[-1]
        self.size = LD(spec["size"])
        self.places = [_placement(j) for j in self.joints]
        self.axes = [unit(j["axis"]) if "axis" in j else None for j in self.joints]
        self.second_axes = [unit(j["axis2"]) if "axis2" in j else None for j in self.joints]
        self.frames = {f["name"]: (f["link"], *_placement(f)) for f in spec["frames"]}
        self.joint_of = {j["child"]: i for i, j in enumerate(self.joints)}
        self.coordinates, self.units, self.linear = [], [], {}
        for i, j in enumerate(self.joints):
            for k, (suffix, u) in enumerate(COORDINATES[j["kind"]]):
                name = f"{j['name']}.{suffix}" if suffix else j["name"]
                self.coordinates.append(name)
                self.units.append(u)
                if j["kind"] not in TURNING:
                    self.linear[name] = (self.q_at[i] + k, self.v_at[i] + k)
        self.scale = np.array([self.size if u == "m" else LD(1) for u in self.units])

    # ------------------------------------------------------------ configurations

    def neutral(self):
        """The configuration (nq,) in which the URDF is drawn."""
        q = np.zeros(self.nq, dtype=LD)
        for i, j in enumerate(self.joints):
            if j["kind"] in TURNING:
                q[self.q_at[i + 1] - 1] = 1
        return q

    def integrate(self, q, steps):
        """Configurations (N, nq): q (nq,) or (N, nq) moved along `steps` (N, nv), body axes."""
        steps = np.atleast_2d(steps).astype(LD)
        q = np.broadcast_to(np.asarray(q, dtype=LD), (len(steps), self.nq))
        out = np.empty((len(steps), self.nq), dtype=LD)
        for i, j in enumerate(self.joints):
            a, b = slice(*self.q_at[i : i + 2]), slice(*self.v_at[i : i + 2])
            out[:, a] = _moved(j["kind"], q[:, a], steps[:, b])
        return out

    def difference(self, start, end):
        """The step (nv,) from one configuration to another."""
        step = np.zeros(self.nv, dtype=LD)
        for i, j in enumerate(self.joints):
            a, b = slice(*self.q_at[i : i + 2]), slice(*self.v_at[i : i + 2])
            if j["kind"] in TURNING:
                step[b] = _difference(start[a], end[a])
            else:
                step[b] = end[a] - start[a]
        return step

    def curve(self, q, derivatives, h):
        """Configurations (11, nq) at the stencil's times along a curve with given derivatives.

        In the coordinates of a step from q the third derivative takes brackets of the first two.
        """
        v, a, j = derivatives
        third = j.copy()
        for i, joint in enumerate(self.joints):
            b = self.v_at[i]
            if joint["kind"] == "spherical":
                third[b : b + 3] += np.cross(v[b : b + 3], a[b : b + 3]) / 2
            elif joint["kind"] == "floating":
                slide, turn = slice(b, b + 3), slice(b + 3, b + 6)
                third[slide] += (np.cross(v[turn], a[slide]) + np.cross(v[slide], a[turn])) / 2
                third[turn] += np.cross(v[turn], a[turn]) / 2
        t = (POINTS.astype(LD) * h)[:, None]
        return self.integrate(q, t * v + t**2 / 2 * a + t**3 / 6 * third)

    def _derivatives(self, *given):
        filled = [np.zeros(self.nv) if x is None else x for x in given]
        filled += [np.zeros(self.nv)] * (3 - len(filled))
        return [np.asarray(x, dtype=LD) for x in filled]

    def _step_of(self, derivatives):
        """A stencil's time step in which the curve moves by about `STEP`."""
        sizes = [float(np.abs(x / self.scale).max(initial=0)) for x in derivatives]
        fastest = max(size ** (1 / k) for k, size in enumerate(sizes, start=1))
        return LD(STEP / fastest) if fastest > 1e-290 else LD(STEP)

    # ------------------------------------------------------------ placements

    def placements(self, qs):
        """Rotations (N, links + 1, 3, 3) and places (N, links + 1, 3); the ground comes last."""
        n, ground = len(qs), len(self.joints)
        rotations = np.zeros((n, ground + 1, 3, 3), dtype=LD)
        places = np.zeros((n, ground + 1, 3), dtype=LD)
        rotations[:, ground] = np.eye(3)
        for i, j in enumerate(self.joints):
            parent = self.number(j["parent"])
            r0, p0 = self.places[i]
            base = rotations[:, parent] @ r0
            turn, shift = self._joint(i, qs[:, self.q_at[i] : self.q_at[i + 1]])
            rotations[:, i] = base if turn is None else base @ turn
            places[:, i] = places[:, parent] + rotations[:, parent] @ p0
            if shift is not None:
                places[:, i] += (base @ shift[..., None])[..., 0]
        return rotations, places

    def _joint(self, i, q):
        """Rotation (N, 3, 3) and shift (N, 3) of a joint at its entries of q; None for neither."""
        joint, u = self.joints[i], self.axes[i]
        kind = joint["kind"]
        if kind == "planar":
            f = onto(u)
            return about(f[:, 2], q[:, 2]), q[:, :1] * f[:, 0] + q[:, 1:2] * f[:, 1]
        if kind == "universal":
            return about(u, q[:, 0]) @ about(self.second_axes[i], q[:, 1]), None
        if kind in TURNING:
            return from_quaternion(q[:, -4:]), q[:, :3] if kind == "floating" else None
        turn = about(u, q[:, 0]) if kind not in ("prismatic", "fixed") else None
        if kind == "prismatic":
            return None, q[:, :1] * u
        if kind == "cylindrical":
            return turn, q[:, 1:2] * u
        if kind == "screw":
            return turn, q[:, :1] * u * (LD(joint["lead"]) / (2 * PI))
        return turn, None

    def number(self, link):
        """Number of a link in what `placements` returns."""
        return len(self.joints) if link == "ground" else self.joint_of[link]

    def link_of(self, name):
        """The link that a frame, or a link, belongs to."""
        return self.frames[name][0] if name in self.frames else name

    def frame(self, name, placements):
        """Rotations (N, 3, 3) and places (N, 3) of a frame or link."""
        rotations, places = placements
        k = self.number(self.link_of(name))
        if name not in self.frames:
            return rotations[:, k], places[:, k]
        _, r, p = self.frames[name]
        return rotations[:, k] @ r, places[:, k] + rotations[:, k] @ p

    # ------------------------------------------------------------ closures

    def residual(self, qs):
        """Residuals (N, rows) of all closures; the least alignment (N,), above 0 where closed."""
        qs = np.atleast_2d(qs).astype(LD)
        placements = self.placements(qs)
        values = [self._closure(c, placements, qs) for c in self.spec["closures"]]
        rows = [np.zeros((len(qs), 0), dtype=LD), *(r for r, _ in values)]
        aligned = [np.ones(len(qs), dtype=LD), *(good for _, good in values if good is not None)]
        return np.concatenate(rows, -1), np.min(aligned, axis=0)

    def _closure(self, c, placements, qs):
        if c["type"] == "coupling":
            return self._coupling(c, qs), None
        (r1, p1), (r2, p2) = (self.frame(f, placements) for f in c["frames"])
        back = np.swapaxes(r1, -1, -2)
        shift = (back @ (p2 - p1)[..., None])[..., 0] / self.size
        return CLOSURES[c["type"]](c, back @ r2, shift, self.size)

    def _coupling(self, c, qs):
        places, at = [self.linear[x][0] for x in c["joints"]], self.linear[c["joints"][-1]][1]
        if "ratios" in c:
            total = LD(c["offset"]) + sum(LD(r) * qs[:, k] for r, k in zip(
                c["ratios"], places, strict=True))
            open_by = total / LD(c["ratios"][-1])
        else:
            a, b = places
            law = c["function"]["polynomial"] if "function" in c else [c["offset"], c["ratio"]]
            open_by = qs[:, b] - sum(LD(x) * qs[:, a] ** k for k, x in enumerate(law))
        return (open_by / self.scale[at])[:, None]

    def open_by(self, qs):
        """How far the loops are open (N,); inf where a closure is in its mirror image."""
        rows, aligned = self.residual(qs)
        return np.where(aligned <= 0, np.inf, np.abs(rows).max(-1, initial=0)).astype(float)

    def jacobian(self, q, points=POINTS, weights=FIRST, h=STEP):
        """Derivative (rows, nv) of the residuals for scaled velocities."""
        steps = np.asarray(points, dtype=LD) * LD(h)
        each = np.einsum("p,kv->kpv", steps, np.diag(self.scale)).reshape(-1, self.nv)
        rows = self.residual(self.integrate(q, each))[0].reshape(self.nv, len(steps), -1)
        return (np.einsum("p,kpr->rk", weights, rows) / LD(h)).astype(float)

    def rough_jacobian(self, q):
        """The same from two points each: good to 1e-10, for steps of Newton's method."""
        return self.jacobian(q, (-1, 1), (-0.5, 0.5), 1e-5)

    def derivatives(self, q, v, a=None, j=None):
        """First to third derivative (3, rows) of the residuals along a curve."""
        given = self._derivatives(v, a, j)
        h = self._step_of(given)
        rows, _ = self.residual(self.curve(q, given, h))
        return np.stack([FIRST @ rows / h, SECOND @ rows / h**2, THIRD @ rows / h**3]).astype(float)

    def motion(self, q, v, a=None, j=None):
        """Places and rotations of links and three derivatives along a curve, a `LinkMotion`."""
        given = self._derivatives(v, a, j)
        h = self._step_of(given)
        return LinkMotion(self, self.placements(self.curve(q, given, h)), h)

    # ------------------------------------------------------------ a solver of its own

    def solve(self, q, held=(), values=(), most=60, enough=1e-16):
        """Close the loops from q with coordinates held: least-norm Gauss-Newton, steps halved.

        Returns:
            The configuration (nq,) and how far its loops are open.
        """
        q = np.array(q, dtype=LD)
        for name, x in zip(held, values, strict=True):
            q[self.linear[name][0]] = LD(x)
        stays = {self.linear[name][1] for name in held}
        free = [k for k in range(self.nv) if k not in stays]
        rows = self.residual(q)[0][0]
        best = float(np.abs(rows).max(initial=0))
        for _ in range(most):
            if best < enough:
                break
            wanted = np.zeros(self.nv)
            jacobian = self.rough_jacobian(q)[:, free]
            wanted[free] = np.linalg.lstsq(jacobian, -rows.astype(float), rcond=1e-9)[0]
            largest = float(np.abs(wanted).max(initial=0))
            wanted *= min(1.0, 0.5 / largest) if largest else 1.0
            ways = LD(1) / LD(2) ** np.arange(9)
            tried = self.integrate(q, ways[:, None] * (self.scale * wanted))
            open_by = np.abs(self.residual(tried)[0]).max(-1, initial=0).astype(float)
            k = int(np.argmax(open_by < best)) if (open_by < best).any() else -1
            if k < 0:
                break
            stalls = open_by[k] > 0.5 * best
            q, best = tried[k], float(open_by[k])
            rows = self.residual(q)[0][0]
            if stalls and best < 1e-15:
                break
        return q, best


class LinkMotion:
    """Placements of all links and their first three derivatives, world axes; the ground last.

    Attributes:
        place, rotation: (links + 1, 3) and (links + 1, 3, 3).
        velocity, acceleration, jerk: of the links' origins (links + 1, 3).
        turning, turning_rate, turning_jerk: angular velocity and its derivatives (links + 1, 3).
    """

    def __init__(self, judge, placements, h):
        self.judge = judge
        rotations, places = placements
        middle = len(POINTS) // 2
        self.rotation, self.position = rotations[middle], places[middle]
        along = [(FIRST, h), (SECOND, h**2), (THIRD, h**3)]
        self.velocity, self.acceleration, self.jerk = (
            np.einsum("t,tbi->bi", w, places) / s for w, s in along)
        d1, d2, d3 = (np.einsum("t,tbij->bij", w, rotations) / s for w, s in along)
        back, d1t, d2t = (np.swapaxes(x, -1, -2) for x in (self.rotation, d1, d2))
        self.turning = skew_part(d1 @ back)
        self.turning_rate = skew_part(d2 @ back + d1 @ d1t)
        self.turning_jerk = skew_part(d3 @ back + 2 * d2 @ d1t + d1 @ d2t)

    def point(self, link, arm):
        """Place, velocity, acceleration, jerk (3,) of a point of a link at `arm` (3,) in it."""
        k = self.judge.number(link)
        r = self.rotation[k] @ np.asarray(arm, dtype=LD)
        w, dw, ddw = self.turning[k], self.turning_rate[k], self.turning_jerk[k]
        dr = np.cross(w, r)
        ddr = np.cross(dw, r) + np.cross(w, dr)
        dddr = np.cross(ddw, r) + 2 * np.cross(dw, dr) + np.cross(w, ddr)
        return (self.position[k] + r, self.velocity[k] + dr, self.acceleration[k] + ddr,
                self.jerk[k] + dddr)

    def frame(self, name):
        """The same of a frame's origin."""
        frames = self.judge.frames
        return self.point(self.judge.link_of(name),
                          frames[name][2] if name in frames else np.zeros(3))

    def turns(self, name):
        """Angular velocity, acceleration and jerk (3,) of a frame or link."""
        k = self.judge.number(self.judge.link_of(name))
        return self.turning[k], self.turning_rate[k], self.turning_jerk[k]


def _placement(entry):
    return from_rpy(entry["rpy"]), np.array(entry["xyz"], dtype=LD)


def _moved(kind, q, step):
    if kind not in TURNING:
        return q + step
    turned = normal(product(q[:, -4:], to_quaternion(step[:, -3:])))
    if kind == "spherical":
        return turned
    shift = from_quaternion(q[:, 3:]) @ (screw_shift(step[:, 3:]) @ step[:, :3, None])
    return np.concatenate([q[:, :3] + shift[..., 0], turned], -1)


def _difference(start, end):
    back = start[-4:] * np.array([-1, -1, -1, 1])
    turn = from_turned(product(back[None], end[None, -4:])[0])
    if len(start) == 4:
        return turn
    shift = from_quaternion(start[None, 3:])[0].T @ (end[:3] - start[:3])
    slide = np.linalg.solve(screw_shift(turn[None])[0].astype(float), shift.astype(float))
    return np.concatenate([slide, turn])


# ------------------------------------------------------------ residuals of closures
# of (closure, relative rotation (N, 3, 3), shift (N, 3) in frame 1 by size, size):
# rows (N, k), and what is above 0 unless the closure is in its mirror image


def _axis(c):
    return unit(c.get("axis", [1, 0, 0] if c["type"] == "universal" else [0, 0, 1]))


def _lines(c, r, d):
    """Rows that keep axes parallel, rows that keep them in line, and the cosine between them."""
    f = onto(_axis(c))
    turned = r @ f[:, 2]
    return (np.stack([turned @ f[:, 0], turned @ f[:, 1]], -1),
            np.stack([d @ f[:, 0], d @ f[:, 1]], -1), turned @ f[:, 2])


def _revolute(c, r, d, size):
    parallel, _, cosine = _lines(c, r, d)
    return np.concatenate([d, parallel], -1), cosine


def _prismatic(c, r, d, size):
    return np.concatenate([_lines(c, r, d)[1], skew_part(r)], -1), _trace(r)


def _cylindrical(c, r, d, size):
    parallel, in_line, cosine = _lines(c, r, d)
    return np.concatenate([in_line, parallel], -1), cosine


def _screw(c, r, d, size):
    rows, cosine = _cylindrical(c, r, d, size)
    f, lead = onto(_axis(c)), LD(c["lead"]) / size
    turned = r @ f[:, 0]
    slide = d @ f[:, 2] - lead * np.arctan2(turned @ f[:, 1], turned @ f[:, 0]) / (2 * PI)
    slide = slide - lead * np.round(slide / lead)
    return np.concatenate([rows, slide[:, None]], -1), cosine


def _perpendicular(c, r, d, size):
    return ((r @ unit(c.get("axis2", [0, 1, 0]))) @ _axis(c))[:, None], None


def _universal(c, r, d, size):
    return np.concatenate([d, _perpendicular(c, r, d, size)[0]], -1), None


def _planar(c, r, d, size):
    parallel, _, cosine = _lines(c, r, d)
    return np.concatenate([(d @ _axis(c))[:, None], parallel], -1), cosine


def _trace(r):
    return np.trace(r, axis1=1, axis2=2) - 2


def _off_curve(shape, d, size):
    """How far a point (N, 3) is off a curve (N, 2), and the tangent (N, 3) there."""
    x, y, z = d.T
    if "ellipse" in shape:
        a, b = (LD(k) / size for k in shape["ellipse"]["semi_axes"])
        rows = np.stack([(x * x / a**2 + y * y / b**2 - 1) * a * b / (a + b), z], -1)
        return rows, np.stack([-y / b**2, x / a**2, 0 * z], -1)
    if "helix" in shape:
        r, rise = LD(shape["helix"]["radius"]) / size, LD(shape["helix"]["lead"]) / (2 * PI) / size
        climb = z - rise * np.arctan2(y, x)
        climb = climb - 2 * PI * rise * np.round(climb / (2 * PI * rise))
        return np.stack([(x * x + y * y - r * r) / (2 * r), climb], -1), np.stack(
            [-y, x, rise + 0 * z], -1)
    along = np.array(shape["points"][1], dtype=LD) - np.array(shape["points"][0], dtype=LD)
    f = onto(unit(along))  # points on a line
    d = d - np.array(shape["points"][0], dtype=LD) / size
    return np.stack([d @ f[:, 0], d @ f[:, 1]], -1), along + 0 * d


def _frame_on_curve(c, r, d, size):
    rows, tangent = _off_curve(c["shape"], d, size)
    tangent = tangent / np.sqrt((tangent**2).sum(-1))[:, None]
    across = np.cross(tangent, r[..., 2])
    f = onto(unit([0.3, 0.5, 0.8]))  # two directions; tangents are seldom square to both
    side = np.cross(tangent, f[:, 2])
    side = side / np.sqrt((side**2).sum(-1))[:, None]
    other = np.cross(tangent, side)
    aligned = np.stack([(across * side).sum(-1), (across * other).sum(-1)], -1)
    return np.concatenate([rows, aligned], -1), (tangent * r[..., 2]).sum(-1)


def _touching_circles(c, r, d, size):
    away = d - np.array(c["shape"]["circle"]["centre"], dtype=LD) / size
    apart = LD(c["shape"]["circle"]["radius"] + c["other"]) / size
    return (np.sqrt(away[:, 0] ** 2 + away[:, 1] ** 2) - apart)[:, None], None


CLOSURES = {
    "revolute": _revolute,
    "prismatic": _prismatic,
    "cylindrical": _cylindrical,
    "screw": _screw,
    "universal": _universal,
    "perpendicular": _perpendicular,
    "spherical": lambda c, r, d, size: (d, None),
    "planar": _planar,
    "weld": lambda c, r, d, size: (np.concatenate([d, skew_part(r)], -1), _trace(r)),
    "fixed": lambda c, r, d, size: (np.concatenate([d, skew_part(r)], -1), _trace(r)),
    "distance": lambda c, r, d, size: (
        (np.sqrt((d * d).sum(-1)) - LD(c["length"]) / size)[:, None], None),
    "rope": lambda c, r, d, size: (
        (np.sqrt((d * d).sum(-1)) - LD(c["length"]) / size)[:, None], None),
    "point_on_curve": lambda c, r, d, size: (_off_curve(c["shape"], d, size)[0], None),
    "frame_on_curve": _frame_on_curve,
    "cam": _touching_circles,
    "curve_on_curve": _touching_circles,
    "point_on_line": lambda c, r, d, size: (_lines(c, r, d)[1], None),
    "point_on_plane": lambda c, r, d, size: ((d @ _axis(c))[:, None], None),
    "parallel": lambda c, r, d, size: _lines(c, r, d)[::2],
}
