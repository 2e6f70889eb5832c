"""Moving mechanisms whose derivatives are compared with differences."""

from __future__ import annotations

import mechanisms as known
import numpy as np
import pinocchio as pin
import pytest
from loaded_library import library
from masses import heavy, with_masses

import spatial_pin as sp

WEIGHT = (1.0, (0.01, 0.02, 0.03), (0.02, 0.03, 0.04))


def sprung(folder):
    """An open chain with springs and dampers of both kinds."""
    tree = heavy(known.turning("shoulder", "ground", "upper", axis=(0, 1, 0))
                 + known.floating("elbow", "upper", "lower", (0.3, 0, 0)), upper=WEIGHT,
                 lower=WEIGHT)
    tree += known.point("hook", "ground", (0.1, 0.4, 0.2))
    tree += known.point("eye", "lower", (0.1, 0, 0.1))
    toml = known.refine("elbow", "spherical")
    toml += ('[[springs]]\nname = "a"\nframes = ["hook", "eye"]\nstiffness = 80.0\ndamping = 4.0\n'
             'free_length = 0.1\n[[springs]]\nname = "b"\njoint = "shoulder"\nstiffness = 9.0\n'
             "damping = 0.5\nfree_angle = 0.3\n")
    return known.load(folder, "sprung", tree, toml)


def nut(folder):
    """A nut on a screw, as a closure of a free body."""
    tree = heavy(known.floating("free", "ground", "nut"), nut=WEIGHT)
    tree += known.point("spindle", "ground", rpy=(0.3, 0.2, 0.1))
    tree += known.point("thread", "nut", rpy=(0.3, 0.2, 0.1))
    return known.load(folder, "nut", tree, known.closure("screw", "screw", "spindle", "thread",
                                                         lead=0.3))


def lamp(folder):
    return with_masses(known.lamp(folder), folder, arm=WEIGHT, shade=WEIGHT)


def rod(folder):
    return with_masses(known.rssr_with_a_rod(folder), folder, crank=WEIGHT, rocker=WEIGHT)


def swash(folder):
    return with_masses(known.swash_point(folder), folder, plate=WEIGHT, piston=WEIGHT)


def pointer(folder):
    return with_masses(known.leaning_pointer(folder), folder, cone=WEIGHT, pointer=WEIGHT)


REGULAR = [*(lambda _, name=name: library(name) for name in (
    "rssr", "rspc", "crank_collar", "stewart", "delta", "swash_plate", "turntable_collar")),
    sprung, nut, lamp, rod, swash, pointer]
NAMES = ["rssr", "rspc", "crank_collar", "stewart", "delta", "swash_plate", "turntable_collar",
         "sprung", "nut", "lamp", "rod", "swash", "pointer"]
CHOSEN = ("rssr", "rspc", "sprung", "nut", "lamp", "rod")  # by default


def some() -> list[object]:
    """Return REGULAR for `parametrize`: six that differ in kind by default, all with `--all`."""
    return [pytest.param(build, marks=() if name in CHOSEN else pytest.mark.slow)
            for name, build in zip(NAMES, REGULAR, strict=True)]


def moving(mech):
    state = sp.assemble(mech, {})
    if mech.drivers:
        return sp.solve_rates(mech, state, dict.fromkeys(mech.drivers, 0.7))
    if mech.closures:  # the nut
        turn = np.concatenate([0.3 / (2 * np.pi) * np.eye(3)[2], np.eye(3)[2]])
        axis = pin.SE3(pin.rpy.rpyToMatrix(0.3, 0.2, 0.1), np.zeros(3))
        return sp.State(mech, state.q, axis.act(pin.Motion(1.3 * turn)).vector, closure_error=0.0,
                        angles=state.angles)
    rng = np.random.default_rng(5)
    q = pin.integrate(mech.model, state.q, rng.uniform(-0.5, 0.5, mech.model.nv))
    return sp.State(mech, q, rng.uniform(-1, 1, mech.model.nv), closure_error=0.0)


EIGHTH = ((1, 4 / 5), (2, -1 / 5), (3, 4 / 105), (4, -1 / 280))


def difference(f, h):
    return sum(c * (f(k * h) - f(-k * h)) for k, c in EIGHTH) / h


def flat(answer):
    """Accelerations, reactions and shaking wrench of `forward_dynamics` in one row."""
    return np.concatenate([answer.a, *(r.vector for r in answer.reactions.values()),
                           answer.on_ground.vector])


def flat_derivative(found, part):
    return np.vstack([getattr(found, f"a_{part}"),
                      *(getattr(r, part) for r in found.reactions.values()),
                      getattr(found.on_ground, part)])


def check(mech, state, efforts, h, tolerance, **loads):
    """Values and derivatives by q, v and efforts along random directions."""
    found = sp.dynamics_derivatives(mech, state, efforts, **loads)

    def near(dq, dv, effort=efforts):
        q = pin.integrate(mech.model, state.q, dq)
        return flat(sp.forward_dynamics(mech, sp.State(
            mech, q, state.v + dv, closure_error=0.0, angles=state.angles), effort, **loads))

    rest = np.zeros(mech.model.nv)
    value = near(rest, rest)
    assert np.concatenate([found.a, *(r.value for r in found.reactions.values()),
                           found.on_ground.value]) == pytest.approx(
        value, abs=1e-11 * np.abs(value).max())
    n, rng = mech.model.nv, np.random.default_rng(2)
    for _ in range(2):
        d = mech.velocity_scale * rng.uniform(-1, 1, n)
        for part, want in (
                ("by_q", difference(lambda e, d=d: near(e * d, rest), h)),
                ("by_v", difference(lambda e, d=d: near(rest, e * d), 0.02))):
            got = flat_derivative(found, part) @ d
            for rows in (slice(0, n), slice(n, None)):
                size = np.abs(np.stack([want[rows], value[rows]])).max(initial=1e-9)
                assert got[rows] == pytest.approx(want[rows], abs=tolerance * size), part
    for name in efforts:
        unit = near(rest, rest, {**efforts, name: efforts[name] + 1.0}) - value
        column = flat_derivative(found, "by_effort")[:, mech.coordinate(name).v]
        assert column == pytest.approx(unit, abs=1e-10 * np.abs(unit).max())
