"""Checks of everything that is true of a mechanism without forces."""

from __future__ import annotations

import json
import math
import pickle

import numpy as np
import pinocchio as pin

import spatial_pin as sp
from fuzzing.case import Skip, need, small
from fuzzing.judge import Judge
from spatial_pin.formats.mechanism_writer import export_urdf

SAMPLES = 50  # of a sweep
AHEAD = 25  # samples of our own way to the first one


def check_load(c):
    """Frames, energy and closure equations of the loaded model are those of the files."""
    c.link(sp.load(str(c.path)))
    m, judge = c.mechanism, c.judge
    need(set(m.coordinates) == set(judge.coordinates), f"coordinates {m.coordinates}")
    data = m.model.createData()
    pin.framesForwardKinematics(m.model, data, c.their_q(c.q))
    placements = judge.placements(c.q[None])
    for name in [*judge.frames, *judge.joint_of]:
        rotation, position = judge.frame(name, placements)
        placement = data.oMf[m.frame_id(name)]
        small((placement.translation - position[0]) / c.size, 1e-11, f"place of {name}")
        small(placement.rotation - rotation[0], 1e-12, f"rotation of {name}")
    rows = sp.closure_jacobian(m, c.their_q(c.q))
    need(len(rows) == len(c.jacobian), f"{len(rows)} closure equations, not {len(c.jacobian)}")
    s = np.linalg.svd(rows * m.velocity_scale, compute_uv=False) if rows.size else np.zeros(0)
    if s.size and c.is_plain:
        need(int((s > 1e-9 * s[0]).sum()) == c.rank, "rank of the closure Jacobian")


def check_state(c):
    """Assembled from a closed configuration, the mechanism stays there."""
    c.state = sp.assemble(c.mechanism, c.driver_values(), guess=c.their_q(c.q))
    c.need_closed(c.state.q, "assemble")
    c.at = c.own_q(c.state.q)
    if c.is_driven and c.driven_condition < 1e4:
        small(c.judge.difference(c.q, c.at) / c.scale, 1e-11 * c.driven_condition,
              "moved away from a closed configuration")


def check_assemble(c):
    """From a guess nearby the loops close, and the drivers have their values."""
    values = c.driver_values()
    step = c.rng.uniform(-0.05, 0.05, c.judge.nv) * c.scale
    guess = c.judge.integrate(c.q, step)[0]
    try:
        state = sp.assemble(c.mechanism, values, guess=c.their_q(guess))
    except sp.SpatialPinError:
        q, open_by = c.judge.solve(guess, c.held, list(values.values()))
        c.doubtful = open_by < 1e-13 and c.judge.open_by(q[None])[0] < 1e-12
        raise
    c.need_closed(state.q, "assemble")
    small(state.closure_error, 1e-10, "stated closure error")
    for (iq, _), value in zip(c.driven, values.values(), strict=True):
        need(float(c.own_q(state.q)[iq]) == value, "a driver does not have its value")


def check_rates(c):
    """Velocities and accelerations keep the loops closed; frames move as they say."""
    speeds, growth = c.random_rates(), c.random_rates()
    try:
        c.moving = sp.solve_rates(c.mechanism, c.state, speeds, growth)
    except sp.SpatialPinError:
        c.doubtful = c.has_answer
        raise
    m, rates = c.moving, [c.own_v(c.moving.v), c.own_v(c.moving.a)]
    for (_, iv), wanted, grown in zip(c.driven, speeds.values(), growth.values(), strict=True):
        small((rates[0][iv] - wanted) / max(abs(wanted), c.scale[iv]), 1e-13, "a driver's speed")
        small((rates[1][iv] - grown) / max(abs(grown), c.scale[iv]), 1e-10, "its acceleration")
    c.need_rates(m.q, rates, "rates", (1e-9, 1e-8))
    motion, (fast, faster) = c.judge.motion(c.at, *rates), c.sizes(rates)
    for name in [*list(c.judge.frames)[:3], c.judge.joints[-1]["child"]]:
        position, velocity, acceleration, _ = motion.frame(name)
        turning, turning_rate, _ = motion.turns(name)
        small((m.placement(name).translation - position) / c.size, 1e-11, f"place of {name}")
        small((m.velocity(name).linear - velocity) / c.size / fast, 1e-9, f"velocity of {name}")
        small((m.acceleration(name).linear - acceleration) / c.size / faster, 1e-8,
              f"acceleration of {name}")
        small((m.angular_velocity(name) - turning) / fast, 1e-9, f"angular velocity of {name}")
        small((m.angular_acceleration(name) - turning_rate) / faster, 1e-8,
              f"angular acceleration of {name}")
    c.only_if_driven()


def check_jacobian(c):
    """Closed-loop Jacobians are those of our own solution, and so are their rates."""
    c.only_if_driven()
    judge, k = c.judge, len(c.driven)
    ours = np.zeros((judge.nv, k))
    if k:
        right = np.vstack([np.zeros((len(c.jacobian), k)),
                           np.diag([1 / c.scale[iv] for _, iv in c.driven])])
        ours = np.linalg.lstsq(c.bordered, right, rcond=1e-11)[0] * c.scale[:, None]
    influence = sp.influence(c.mechanism, c.state)
    first = c.own_v(influence.first.T).T.astype(float)
    most = 1e-10 * max(1.0, c.driven_condition)
    size = np.abs(ours / c.scale[:, None]).max(initial=1e-300)
    small((first - ours) / c.scale[:, None] / size, most, "influence coefficients")
    name = list(judge.frames)[-1] if judge.frames else judge.joints[-1]["child"]
    jacobian = sp.jacobian(c.mechanism, c.state, name)
    for column, rates in zip(jacobian.T, ours.T, strict=True):
        motion = judge.motion(c.at, rates)
        fast = np.abs(rates / c.scale).max()
        small((column[:3] - motion.frame(name)[1]) / c.size / fast, most, f"jacobian of {name}")
        small((column[3:] - motion.turns(name)[0]) / fast, most, f"angular jacobian of {name}")
    rates = [c.own_v(c.moving.v), c.own_v(c.moving.a)]
    speeds, growth = (np.array([x[iv] for _, iv in c.driven], dtype=float) for x in rates)
    motion, faster = judge.motion(c.at, *rates), c.sizes(rates)[1]
    got = jacobian @ growth + sp.jacobian_rate(c.mechanism, c.moving, name) @ speeds
    small((got[:3] - motion.frame(name)[2]) / c.size / faster, 1e-8, "jacobian's rate")
    small((got[3:] - motion.turns(name)[1]) / faster, 1e-8, "angular jacobian's rate")


def check_jerk(c):
    """Third derivatives keep the loops closed; frames have the jerk that they say."""
    c.only_if_driven()
    wanted = c.random_rates()
    jerks = sp.solve_jerks(c.mechanism, c.moving, wanted)
    rates = [c.own_v(x) for x in (c.moving.v, c.moving.a, jerks.j)]
    c.need_rates(c.moving.q, rates, "jerks", (1e-9, 1e-8, 1e-7))
    size = c.sizes(rates)[2]
    for (_, iv), x in zip(c.driven, wanted.values(), strict=True):
        small((rates[2][iv] - x) / c.scale[iv] / size, 1e-9, "a driver's jerk")
    name = list(c.judge.frames)[-1] if c.judge.frames else c.judge.joints[-1]["child"]
    motion, jerk = c.judge.motion(c.at, *rates), jerks.frame(name)
    small((jerk.linear - motion.frame(name)[3]) / c.size / size, 1e-6, f"jerk of {name}")
    small((jerk.angular - motion.turns(name)[2]) / size, 1e-6, f"angular jerk of {name}")


def _own_sweep(c, values, k):
    """Our own way along the branch (N, nq), in steps of less than a degree; None where it ends."""
    judge, at = c.judge, [float(c.at[iq]) for iq, _ in c.driven]
    q, scale, samples = c.at.copy(), c.scale[c.driven[k][1]], []
    for value in values:
        parts = max(1, math.ceil(abs(value - at[k]) / scale / 0.0127))
        for x in np.linspace(at[k], value, parts + 1)[1:]:
            rows = len(c.jacobian)
            square = np.vstack([judge.rough_jacobian(q), c.bordered[rows:]])
            s = np.linalg.svd(square, compute_uv=False)
            if s[judge.nv - 1] < 2e-4 * s[0]:
                return None
            right = np.zeros(len(square))
            right[rows + k] = (x - at[k]) / scale
            step = np.linalg.lstsq(square, right, rcond=1e-11)[0]
            at[k] = x
            q, open_by = judge.solve(judge.integrate(q, step * c.scale)[0], c.held, at, most=8)
            if open_by > 1e-13:
                return None
        samples.append(q)
    return np.array(samples)


def check_sweep(c):
    """A sweep keeps its branch, as our own way along it does, whatever route it takes."""
    c.only_if_driven()
    k = int(c.rng.integers(0, len(c.driven)))
    name, (iq, iv) = c.names[k], c.driven[k]
    half = 0.3 if c.judge.units[iv] == "rad" else 0.05 * c.size
    here, speed = float(c.at[iq]), float(c.scale[iv])
    values = here + np.linspace(-half, half, SAMPLES)
    ours = _own_sweep(c, np.concatenate([np.linspace(here, values[0], AHEAD + 1)[1:],
                                         values[1:]]), k)
    try:
        lead = sp.sweep(c.mechanism, name, np.linspace(here, values[0], 12), speed, guess=c.state)
        rates, start = (speed, 0.5 * speed), lead.state(-1)
        m = sp.sweep(c.mechanism, name, values, *rates, guess=start)
    except sp.SpatialPinError:
        c.doubtful = ours is not None and c.keeps_rank
        raise
    c.motion, c.sweep = m, (name, values, rates)
    c.need_closed(m.q, "sweep")
    need(len(m.q) == SAMPLES, "samples are missing")
    small((c.own_q(m.q)[:, iq] - values) / c.scale[iv], 1e-13, "driver's values")
    for r in range(0, SAMPLES, 12):
        va = [c.own_v(m.v[r]), c.own_v(m.a[r])]
        c.need_rates(m.q[r], va, f"sample {r}", (1e-9, 1e-8))
        small((va[0][iv] - speed) / speed, 1e-12, "driver's speed in a sample")
        small((va[1][iv] - rates[1]) / speed, 1e-9, "driver's acceleration in a sample")
    if ours is not None:
        _same_places(c, [c.own_q(x) for x in m.q], ours[AHEAD - 1 :], 1e-7, "our own way")
    _other_routes(c, m, name, values, rates, start)


def _other_routes(c, m, name, values, rates, start):
    """Steps of lower order, samples in any order, seven times as many: the same motion."""
    for order in (1, 2):
        other = sp.sweep(c.mechanism, name, values, *rates, guess=start,
                         accuracy=sp.Accuracy(order=order))
        _same_motion(c, m.q, m.v, other.q, other.v, f"steps of order {order}")
    shuffled = np.concatenate([[0], 1 + c.rng.permutation(SAMPLES - 1)])
    other, back = sp.sweep(c.mechanism, name, values[shuffled], *rates, guess=start), \
        np.argsort(shuffled)
    _same_motion(c, m.q, m.v, other.q[back], other.v[back], "samples in another order")
    many = np.linspace(values[0], values[-1], 7 * (SAMPLES - 1) + 1)
    other = sp.sweep(c.mechanism, name, many, *rates, guess=start)
    _same_motion(c, m.q, m.v, other.q[::7], other.v[::7], "many samples")
    c.need_closed(other.q, "many samples")


def _same_motion(c, q, v, other_q, other_v, what):
    _same_places(c, [c.own_q(x) for x in q], [c.own_q(x) for x in other_q], 1e-8, what)
    size = np.maximum(1e-3, np.abs(v).max(1))[:, None]
    small((v - other_v) / size, 1e-6, f"{what}: velocities")


def _same_places(c, poses, wanted, most, what):
    small([np.abs(c.judge.difference(a, b) / c.scale).max()
           for a, b in zip(poses, wanted, strict=True)], most, f"{what}: configurations")


def check_mobility(c):
    """Rank, freedoms and redundant equations are those of our own Jacobian."""
    if not c.is_plain:
        raise Skip("the rank can be doubted")
    result = sp.mobility(c.mechanism, c.state)
    need(result.rank == c.rank, f"rank {result.rank}, ours {c.rank}")
    need(result.instantaneous == c.dof, f"instantaneous {result.instantaneous}, ours {c.dof}")
    need(not c.keeps_rank or result.dof == c.dof, f"dof {result.dof}, ours {c.dof}")
    need(result.overconstrained == (c.rank < len(c.jacobian)), "overconstrained")


def check_reduce(c):
    """A reduced mechanism has the same output, rate and acceleration."""
    if c.motion is None:
        raise Skip("no sweep")
    name, values, rates = c.sweep
    outputs = [n for n in c.judge.linear if n not in c.held]
    if not outputs:
        raise Skip("no output")
    output = str(c.rng.choice(outputs))
    reduced = sp.reduce(c.mechanism, output, guess=c.motion.state(0))
    start = reduced.state(c.motion.state(0))
    less = sp.sweep(reduced, name, values, *rates, guess=start).coordinate(output)
    full, unit = c.motion.coordinate(output), c.scale[c.judge.linear[output][1]]
    fast = max(1e-3, np.abs(full.rate).max() / unit)
    faster = max(fast**2, np.abs(full.acceleration).max() / unit)
    small((less.value - full.value) / unit, 1e-7, f"{output} of {reduced.name}")
    small((less.rate - full.rate) / unit / fast, 1e-6, f"its rate, {output}")
    small((less.acceleration - full.acceleration) / unit / faster, 1e-5, f"acceleration, {output}")
    again = sp.load(str(export_urdf(reduced, c.folder / "reduced.urdf")[-1]))
    need(again.coordinates == reduced.coordinates, "written and read again")


def check_export(c):
    """What is written, or pickled, is read as the same mechanism."""
    written = sp.load(str(export_urdf(c.mechanism, c.folder / "written.urdf")[-1]))
    step = c.rng.normal(size=c.judge.nv) * 0.1 * c.scale
    q = c.their_q(c.judge.integrate(c.q, step)[0])
    for other, what in ((written, "written"), (pickle.loads(pickle.dumps(c.mechanism)), "pickled")):
        mine = c.mechanism
        need(mine.coordinates == other.coordinates, f"{what}: coordinates")
        need(np.allclose(sp.closure_jacobian(mine, q), sp.closure_jacobian(other, q),
                         rtol=1e-14, atol=1e-15), f"{what}: closure equations")
        need([x.name for x in mine.closures] == [x.name for x in other.closures],
             f"{what}: closures")
        masses = [pin.crba(m.model, m.model.createData(), q) for m in (mine, other)]
        size = np.abs(masses[0]).max(initial=1e-30)
        small((masses[0] - masses[1]) / size, 1e-14, f"{what}: masses")
        need(list(mine.springs) == list(other.springs), f"{what}: springs")
        need(set(mine.drivers) == set(other.drivers), f"{what}: drivers")
    state = pickle.loads(pickle.dumps(c.state))
    need(np.array_equal(state.q, c.state.q), "pickled: state")


def check_sensitivity(c):
    """The derivative of an output by a dimension is the difference of our own solutions."""
    c.only_if_driven()
    outputs = [n for n in c.judge.linear if n not in c.held]
    if not c.spec["parameters"] or not outputs:
        raise Skip("no dimension, or no output")
    output, name = str(c.rng.choice(outputs)), next(iter(c.spec["parameters"]))
    h = 1e-5 * c.size
    values = _by_dimension(c, output, name, h)
    try:
        result = sp.sensitivity(c.mechanism, c.state, output, [name])
    except sp.SpatialPinError:
        c.doubtful = values is not None
        raise
    if values is None:  # loops that do not close for other dimensions have no derivative
        return
    plain = (values[1] - values[-1]) / (2 * h)
    wanted = (8 * (values[1] - values[-1]) - (values[2] - values[-2])) / (12 * h)
    size = max(abs(wanted), c.scale[c.judge.linear[output][1]] / c.size)
    allowed = 10 * result.errors[name] + 0.1 * abs(wanted - plain)
    small((result.derivatives[name] - wanted) / size, max(1e-7, allowed / size), f"d {output}")


def _by_dimension(c, output, name, h):
    """The output at four values of a dimension, by the number of steps; None where it opens."""
    at = [float(c.at[iq]) for iq, _ in c.driven]
    which, values = c.spec["parameters"][name], {}
    for k in (-2, -1, 1, 2):
        spec = json.loads(json.dumps(c.spec))
        frame = next(f for f in spec["frames"] if f["name"] == which["frame"])
        frame["xyz"][which["at"]] += k * h
        q, open_by = Judge(spec).solve(c.at, c.held, at)
        if open_by > 1e-14:
            return None
        values[k] = float(q[c.judge.linear[output][0]])
    return values


def check_history(c):
    """Earlier calls make no difference: a mechanism loaded anew answers alike."""
    fresh = sp.load(str(c.path))
    for guess in (c.their_q(c.q), c.state):
        state = sp.assemble(c.mechanism, c.driver_values(), guess=guess)
        again = sp.assemble(fresh, c.driver_values(), guess=guess)
        need(np.array_equal(state.q, again.q), "assembled anew")
        if c.is_driven:
            small((sp.jacobian(c.mechanism, state, c.judge.joints[-1]["child"])
                   - sp.jacobian(fresh, again, c.judge.joints[-1]["child"])) / max(1.0, c.size),
                  1e-13 * c.driven_condition, "jacobian anew")
    texts = [str(sp.mobility(m, c.state.q)) for m in (c.mechanism, fresh)]
    need(texts[0] == texts[1], "mobility anew")


CHECKS = {  # name: (function, what must have been right before it)
    "load": (check_load, ()),
    "state": (check_state, ("load",)),
    "assemble": (check_assemble, ("load",)),
    "rates": (check_rates, ("state",)),
    "jacobian": (check_jacobian, ("rates",)),
    "jerk": (check_jerk, ("rates",)),
    "sweep": (check_sweep, ("state",)),
    "mobility": (check_mobility, ("state",)),
    "reduce": (check_reduce, ("sweep",)),
    "export": (check_export, ("state",)),
    "sensitivity": (check_sensitivity, ("state",)),
    "history": (check_history, ("state",)),
}
