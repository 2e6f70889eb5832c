"""Checks of forces: accelerations by a solver of our own, every body's balance, energy."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

import spatial_pin as sp
from fuzzing.case import Skip, need, small
from fuzzing.judge import NV
from fuzzing.rotations import FIRST, LD, POINTS, about, onto

TENSOR = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])  # places of ixx, ixy, ... in a matrix
LIGHT = 1e-9  # of the largest inertia: below it the judge calls a freedom massless
SAMPLES = 6  # of a simulation


# ------------------------------------------------------------ what we know of bodies and springs


def _bodies(c, motion):
    """For each body: link, mass, place, velocity, acceleration, spin, its rate, its tensor."""
    for link, body in c.spec["inertias"].items():
        position, velocity, acceleration, _ = motion.point(link, body["com"])
        turning, rate, _ = motion.turns(link)
        r = motion.rotation[c.judge.number(link)]
        tensor = r @ np.array(body["tensor"], dtype=LD)[TENSOR] @ r.T
        yield link, LD(body["mass"]), position, velocity, acceleration, turning, rate, tensor


def _energy(c, q, v):
    """Kinetic and potential energy of bodies and springs, the judge's numbering [J]."""
    moving = resting = LD(0)
    gravity = np.array(c.spec["gravity"], dtype=LD)
    for _, mass, position, velocity, _, w, _, tensor in _bodies(c, c.judge.motion(q, v)):
        moving += mass * (velocity @ velocity) / 2 + w @ (tensor @ w) / 2
        resting -= mass * (gravity @ position)
    for spring in c.spec["springs"]:
        resting += 0.5 * spring["stiffness"] * _stretch(c, spring, q)[0] ** 2
    return float(moving), float(resting)


def _stretch(c, spring, q):
    """How far a spring is stretched, and the derivative (nv,) of that."""
    judge, free = c.judge, spring.get("free_length", 0.0) + spring.get("free_angle", 0.0)
    if "joint" in spring:
        iq, iv = judge.linear[spring["joint"]]
        along = np.zeros(judge.nv)
        along[iv] = 1.0
        return float(q[iq]) - free, along
    h = LD(4e-3)
    steps = np.einsum("p,kv->kpv", POINTS * h, np.diag(judge.scale)).reshape(-1, judge.nv)
    placements = judge.placements(judge.integrate(q, steps))
    a, b = (judge.frame(f, placements)[1] for f in spring["frames"])
    lengths = np.sqrt(((b - a) ** 2).sum(-1)).reshape(judge.nv, len(POINTS))
    along = (lengths @ FIRST / (h * judge.scale)).astype(float)
    return float(lengths[0, len(POINTS) // 2]) - free, along


def _pull(c, spring, q, v):
    """Force of a spring (torque of one about a joint), and what it works along (nv,)."""
    stretch, along = _stretch(c, spring, q)
    rate = float(along @ np.asarray(v, dtype=float))
    return -spring["stiffness"] * stretch - spring["damping"] * rate, along


def _spring_forces(c, q, v):
    """Joint forces (nv,) of all springs."""
    total = np.zeros(c.judge.nv)
    for spring in c.spec["springs"]:
        pull, along = _pull(c, spring, q, v)
        total += pull * along
    return total


# ------------------------------------------------------------ forward dynamics


def _mass_matrix(c, q):
    m = pin.crba(c.mechanism.model, c.mechanism.model.createData(), q)
    m = np.triu(m) + np.triu(m, 1).T
    return m[np.ix_(c.v_at, c.v_at)]


def _ours(c, state, efforts):
    """Our accelerations: particular and free part, by the null space of our own Jacobian."""
    v, s = c.own_v(state.v).astype(float), c.scale
    model = c.mechanism.model
    bias = pin.nonLinearEffects(model, model.createData(), state.q, state.v)[c.v_at]
    force = _spring_forces(c, c.at, v) - bias
    for x, (_, iv) in zip(efforts.values(), c.driven, strict=True):
        force[iv] += x
    mass, force = s[:, None] * _mass_matrix(c, state.q) * s, s * force
    jacobian = c.judge.jacobian(c.at)
    gamma = c.judge.derivatives(c.at, v)[1] if jacobian.size else np.zeros(0)
    carried, free = np.zeros(c.judge.nv), np.eye(c.judge.nv)
    if jacobian.size:
        u, sizes, vt = np.linalg.svd(jacobian)
        r = c.rank
        carried, free = -vt[:r].T @ ((u[:, :r].T @ gamma) / sizes[:r]), vt[r:].T
    values, ways = np.linalg.eigh(free.T @ mass @ free) if free.size else (np.ones(0), np.eye(0))
    load = ways.T @ (free.T @ (force - mass @ carried))
    heavy = max(values.max(initial=0.0), np.abs(mass).max(initial=0.0))
    return jacobian, gamma, carried, free @ ways, values, load, heavy, np.abs(force).max(initial=0)


def _moving_state(c):
    """The assembled state with a random velocity that the loops allow."""
    v = c.rng.normal(size=c.dof) @ c.null_space
    jacobian = c.judge.jacobian(c.at)
    if jacobian.size:
        v = v - np.linalg.lstsq(jacobian, jacobian @ v, rcond=1e-10)[0]
    return sp.State(c.mechanism, c.state.q, c.their_v(v * c.scale),
                    closure_error=c.state.closure_error, angles=c.state.angles)


def check_forward(c):
    """Accelerations are those of our own solver; what has no inertia is refused or at rest."""
    if not c.is_plain or c.condition > 1e5:
        raise Skip("the rank can be doubted")
    state = _moving_state(c)
    efforts = {n: float(c.rng.normal()) * (1 if c.judge.units[iv] == "m" else c.size)
               for n, (_, iv) in zip(c.names, c.driven, strict=True)}
    jacobian, gamma, carried, free, values, load, heavy, pull = _ours(c, state, efforts)
    massless = values <= LIGHT * heavy
    try:
        result = sp.forward_dynamics(c.mechanism, state, efforts)
    except sp.SpatialPinError:
        c.doubtful = c.keeps_rank and not massless.any()
        raise
    got = c.own_v(result.a).astype(float) / c.scale
    need(np.isfinite(got).all(), "accelerations are no numbers")
    fast = np.abs(state.v[c.v_at] / c.scale).max(initial=0)
    floor = 1e-3 * max(np.linalg.norm(c.spec["gravity"]) / c.size, pull / max(heavy, 1e-300))
    size = max(np.abs(got).max(initial=0), fast**2, floor)
    if jacobian.size:
        small((jacobian @ got + gamma) / max(size, np.abs(gamma).max()), 1e-8,
              "accelerations open the loops")
    wanted = carried + free[:, ~massless] @ (load[~massless] / values[~massless])
    if massless.any():
        need(np.abs(load[massless]).max() <= 1e-7 * max(pull, 1e-9),
             f"a motion without inertia is pulled, and an answer given: {np.abs(got).max():.1e}")
        rest = got - wanted
        rest -= free[:, massless] @ np.linalg.lstsq(free[:, massless], rest, rcond=None)[0]
        small(rest / max(np.abs(wanted).max(), 1e-6), 1e-5, "accelerations of what has inertia")
        raise Skip("a freedom without inertia")
    spread = values[-1] / values[0] if len(values) else 1.0
    most = min(1e-4, 1e-11 * spread * c.condition + 1e-9 + 10 * result.error)
    small((got - wanted) / max(size, np.abs(wanted).max(initial=0)), most, "accelerations")
    c.dynamics = result, efforts, state


# ------------------------------------------------------------ balance of every body


class _Balance:
    """Sums of the wrenches (6,) on every rigid body, at the world's origin; the ground is -1."""

    def __init__(self, c):
        self.c, self.body = c, {"ground": -1}
        for i, j in enumerate(c.judge.joints):
            self.body[j["child"]] = self.body[j["parent"]] if j["kind"] == "fixed" else i
        self.sums = {k: np.zeros(6) for k in self.body.values()}
        self.largest = dict.fromkeys(self.body.values(), 1e-300)

    def add(self, link, force, moment, at):
        """Add a force at a point and a moment to a link's body."""
        k, turn = self.body[link], np.cross(at, force)
        self.sums[k] += np.concatenate([force, moment + turn]).astype(float)
        self.largest[k] = max(self.largest[k], float(np.abs(force).max()) * self.c.size,
                              float(np.abs(moment).max()), float(np.abs(turn).max()))

    def takes_part(self, link, force, moment):
        """Say how large what cancels in a body's forces and moments is (free fall, free spin)."""
        k = self.body[link]
        self.largest[k] = max(self.largest[k], float(np.abs(force).max()) * self.c.size,
                              float(np.abs(moment).max()))

    def between(self, to, base, force, moment, at):
        """Add what one link does to another, and the opposite."""
        self.add(to, force, moment, at)
        self.add(base, -force, -moment, at)


def _effort(c, i, tau):
    """Force and moment, world axes, of efforts at a joint's coordinates."""
    judge, joint = c.judge, c.judge.joints[i]
    placements = judge.placements(c.at[None])
    parent = placements[0][0, judge.number(joint["parent"])]
    base = (parent @ judge.places[i][0]).astype(float)
    kind, none = joint["kind"], np.zeros(3)
    if kind == "floating":
        own = placements[0][0, i].astype(float)
        return own @ tau[:3], own @ tau[3:]
    if kind == "spherical":
        return none, placements[0][0, i].astype(float) @ tau
    axis = judge.axes[i]
    u = base @ axis.astype(float)
    if kind == "planar":
        f = base @ onto(axis).astype(float)
        return f[:, :2] @ tau[:2], f[:, 2] * tau[2]
    if kind == "universal":
        at = judge.q_at[i]
        second = about(axis, c.at[at : at + 1])[0] @ judge.second_axes[i]
        return none, u * tau[0] + base @ second.astype(float) * tau[1]
    if kind == "prismatic":
        return u * tau[0], none
    return (u * tau[1] if kind == "cylindrical" else none), u * tau[0]


def _need_balance(c, result, efforts, state, v, a):
    """Newton and Euler for every body by itself, from the stated reactions."""
    judge, balance = c.judge, _Balance(c)
    placements, tau = judge.placements(c.at[None]), np.zeros(judge.nv)
    for x, (_, iv) in zip(efforts.values(), c.driven, strict=True):
        tau[iv] += x
    for spring in c.spec["springs"]:
        pull, along = _pull(c, spring, c.at, v)
        if "joint" in spring:
            tau += pull * along
            continue
        links = [judge.frames[f][0] for f in spring["frames"]]
        a1, b1 = (judge.frame(f, placements)[1][0].astype(float) for f in spring["frames"])
        direction = (b1 - a1) / np.linalg.norm(b1 - a1)
        balance.add(links[1], pull * direction, np.zeros(3), b1)
        balance.add(links[0], -pull * direction, np.zeros(3), a1)
    tau += _couplings(c, result, state)
    for i, joint in enumerate(judge.joints):
        if joint["kind"] == "fixed":
            continue
        wrench, at = result.reactions[joint["name"]], placements[1][0, i].astype(float)
        force, moment = _effort(c, i, tau[judge.v_at[i] : judge.v_at[i] + NV[joint["kind"]]])
        balance.between(joint["child"], joint["parent"], wrench.linear + force,
                        wrench.angular + moment, at)
    for closure in c.spec["closures"]:
        if closure["type"] != "coupling":
            wrench = result.reactions[closure["name"]]
            at = judge.frame(closure["frames"][1], placements)[1][0].astype(float)
            one, two = (judge.frames[f][0] for f in closure["frames"])
            balance.between(two, one, wrench.linear, wrench.angular, at)
    gravity = np.array(c.spec["gravity"], dtype=LD)
    motion = judge.motion(c.at, v, a)
    for link, mass, position, _, acceleration, w, rate, tensor in _bodies(c, motion):
        balance.add(link, mass * (gravity - acceleration),
                    -(tensor @ rate + np.cross(w, tensor @ w)), position)
        origin = motion.acceleration[judge.number(link)]
        balance.takes_part(link, mass * np.concatenate([gravity, origin]), tensor @ rate)
    _judge_balance(c, balance, result.on_ground)


def _couplings(c, result, state):
    """Joint forces (nv,) of couplings: their multipliers come last."""
    n = sum(x["type"] == "coupling" for x in c.spec["closures"])
    if not n:
        return np.zeros(c.judge.nv)
    return (result.multipliers[-n:] @ sp.closure_jacobian(c.mechanism, state)[-n:])[c.v_at]


def _judge_balance(c, balance, on_ground):
    unit = np.array([c.size] * 3 + [1.0] * 3)
    size = max(balance.largest.values())
    for k, total in balance.sums.items():
        if k >= 0:
            small(total * unit / size, 1e-7, f"balance of {c.judge.joints[k]['child']}")
    got = np.concatenate([on_ground.linear, on_ground.angular])
    small((got - balance.sums[-1]) * unit / size, 1e-7, "force on the ground")


def check_reactions(c):
    """Every body is in balance under the reactions of forward dynamics."""
    if c.dynamics is None:
        raise Skip("no dynamics")
    result, efforts, state = c.dynamics
    _need_balance(c, result, efforts, state, c.own_v(state.v), c.own_v(result.a))


def check_inverse(c):
    """Efforts give the power that energy grows with, and every body is in balance."""
    c.only_if_driven()
    v, a = c.own_v(c.moving.v), c.own_v(c.moving.a)
    try:
        result = sp.inverse_dynamics(c.mechanism, c.moving)
    except sp.SpatialPinError:
        c.doubtful = c.keeps_rank
        raise
    gravity, parts = np.array(c.spec["gravity"], dtype=LD), []
    for _, mass, _, velocity, acceleration, w, rate, tensor in _bodies(
            c, c.judge.motion(c.at, v, a)):
        parts += [mass * (velocity @ acceleration), -mass * (velocity @ gravity),
                  w @ (tensor @ rate)]
    parts += list(-_spring_forces(c, c.at, v) * v)
    given = [result.efforts[n] * v[iv] for n, (_, iv) in zip(c.names, c.driven, strict=True)]
    size = max(float(np.abs(x)) for x in [*parts, *given, 1e-6 * _weight(c) * _speed(c, v)])
    small((sum(given) - sum(parts)) / max(size, 1e-300), 1e-8, "power")
    _need_balance(c, result, {n: result.efforts[n] for n in c.names}, c.moving, v, a)


def _weight(c):
    return sum(b["mass"] for b in c.spec["inertias"].values()) * 9.81 * c.size


def _speed(c, v):
    return float(np.abs(v / c.scale).max(initial=0))


# ------------------------------------------------------------ simulation


def check_simulate(c):
    """Falling from rest keeps loops closed and energy, in both formulations alike."""
    if not c.dof or not c.is_plain or c.condition > 1e4:
        raise Skip("nothing moves, or the rank can be doubted")
    if not any(b["mass"] for b in c.spec["inertias"].values()):
        raise Skip("nothing has mass")
    free = c.null_space.T * c.scale[:, None]
    mass = _mass_matrix(c, c.state.q)
    heavy = np.abs(c.scale[:, None] * mass * c.scale).max()
    values = np.linalg.eigvalsh(free.T @ mass @ free)
    massless = values[0] < 1e-6 * max(values[-1], heavy)  # a freedom may have none at all
    gravity = max(np.linalg.norm(c.spec["gravity"]), 1.0)
    duration = 0.5 * math.sqrt(c.size * 9.81 / gravity)
    result, refused = {}, {}
    for formulation in ("independent", "projected"):
        try:
            m = _simulated(c, formulation, duration, 1e-9)
        except sp.SpatialPinError as error:
            refused[formulation] = f"{formulation}: {type(error).__name__}: {error}"
            continue
        result[formulation] = m
        _need_honest(c, m, formulation, gravity)
    if refused:
        c.doubtful = len(refused) == 1 and c.keeps_rank and not massless
        raise sp.SpatialPinError("; ".join(refused.values()))
    if not massless:
        _need_alike(c, result, duration)


def _simulated(c, formulation, duration, tolerance):
    return sp.simulate(c.mechanism, c.state, duration, times=np.linspace(0, duration, SAMPLES),
                       accuracy=sp.Accuracy(formulation=formulation, time_tolerance=tolerance))


def _need_honest(c, m, formulation, gravity):
    c.need_closed(m.q, formulation)
    if not any(s["damping"] for s in c.spec["springs"]):
        parts = np.array([_energy(c, c.own_q(q), c.own_v(v))
                          for q, v in zip(m.q, m.v, strict=True)])
        size = max(parts[:, 0].max(), np.ptp(parts[:, 1]), 1e-7 * _weight(c) * gravity / 9.81)
        small((parts.sum(1) - parts[0].sum()) / size, 1e-5,
              f"{formulation}: energy (stated {m.energy_drift:.0e})")
    rates = [c.own_v(m.v[-1]), c.own_v(m.a[-1])]
    result = c.judge.derivatives(c.own_q(m.q[-1]), *rates)
    fast = max(_speed(c, rates[0]), 1e-3)
    small(result[0] / fast, 1e-7, f"{formulation}: velocities open the loops")
    small(result[1] / max(_speed(c, rates[1]), fast**2, 1e-2 * gravity / c.size), 1e-6,
          f"{formulation}: accelerations open the loops")


def _need_alike(c, result, duration):
    if _gap(c, result) < 1e-5:
        return
    tight = {f: _simulated(c, f, duration, 1e-12) for f in result}  # chaotic motions grow errors
    small(_gap(c, tight), 1e-4, "formulations differ at 1e-12")
    small(_gap(c, result), 1e-2, "formulations differ at 1e-9")


def _gap(c, result):
    one, two = (m.q for m in result.values())
    return max(np.abs(c.judge.difference(c.own_q(a), c.own_q(b)) / c.scale).max()
               for a, b in zip(one, two, strict=True))


CHECKS = {  # name: (function, what must have been right before it)
    "forward": (check_forward, ("state",)),
    "reactions": (check_reactions, ("forward",)),
    "inverse": (check_inverse, ("rates",)),
    "simulate": (check_simulate, ("state",)),
}
