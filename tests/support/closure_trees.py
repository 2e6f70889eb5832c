"""Trees with one joint of every pair, and one closure of every type between two bodies."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from mechanisms import between, closure, floating, load, point, refine

import spatial_pin as sp
from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.mechanism.pairs import COUPLING, JOINT_TYPES, PAIRS, closure_types

__all__ = ["CLOSURE_TYPES", "COUPLING", "JOINT_TYPES", "PAIRS"]  # what others take from here
LENGTH, LEAD = 0.37, 0.023
KEYS = {"distance": {"length": LENGTH}, "rope": {"length": LENGTH},
        "point_on_curve": {"curve": "c"}, "cam": {"curve": "c", "follower": {"roller": 0.02}},
        "frame_on_curve": {"curve": "c"}, "curve_on_curve": {"curves": ["c", "c"]},
        "screw": {"lead": LEAD}}
CLOSURE_TYPES = closure_types()
TYPES = [kind for kind in CLOSURE_TYPES if kind != COUPLING]
JOINTS = [name for name, pair in PAIRS.items() if pair.joint]
STEP = 3e-3  # step of the differences; their error is a few 1e-14 / STEP
FIRST = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])
SECOND = np.array([-1 / 560, 8 / 315, -1 / 5, 8 / 5, -205 / 72, 8 / 5, -1 / 5, 8 / 315, -1 / 560])
PLACES = STEP * np.arange(-4, 5)


def refinement(name: str, kind: str, rng: np.random.Generator) -> str:
    if kind == "floating":
        return ""
    keys, pair = {}, PAIRS[kind]
    axis, other = np.linalg.qr(rng.normal(size=(3, 3)))[0][:2]
    keys |= {"axis": axis} if pair.uses_axis else {}
    keys |= {"axis2": other} if pair.uses_axis2 else {}
    keys |= {"lead": LEAD} if pair.uses_lead else {}
    return refine(name, kind, **keys)


def pose(rng: np.random.Generator) -> dict[str, np.ndarray]:
    return {"xyz": rng.uniform(-0.3, 0.3, 3), "rpy": rng.uniform(-3.0, 3.0, 3)}


def tree_with(folder, joint: str, frames: tuple[str, str], kind: str, seed: int, **keys):
    """A trunk with two branches: joints of one pair everywhere, a closure between two bodies."""
    rng = np.random.default_rng(seed)
    tree, toml = "", ""
    for name, parent in (("trunk", "ground"), ("left", "trunk"), ("leaf", "left"),
                         ("right", "ground")):
        tree += floating(f"to_{name}", parent, name, **pose(rng))
        toml += refinement(f"to_{name}", joint, rng)
    for name in frames:
        tree += point(f"at_{name}", name, **pose(rng))
    toml += closure("c", kind, *(f"at_{name}" for name in frames), **KEYS.get(kind, {}), **keys)
    return load(folder, "tree", tree, toml), rng


ENDS = [  # which links the frames are on, and the two that give the length
    (("leaf", "right"), ("ground", "side")),  # a slide beside the rest, as reductions make it
    (("leaf", "right"), ("trunk", "leaf")),  # links that move both
    (("left", "right"), ("right", "leaf")),
]


def tree_between(folder, joint: str, ends, seed: int):
    """A trunk with two branches and a link beside: joints of one pair, one distance."""
    rng = np.random.default_rng(seed)
    tree, toml, names = "", "", []
    for name, parent in (("trunk", "ground"), ("left", "trunk"), ("leaf", "left"),
                         ("right", "ground"), ("side", "ground")):
        tree += floating(f"to_{name}", parent, name, **pose(rng))
        toml += refinement(f"to_{name}", joint, rng)
    for k, name in enumerate((*ends[0], *ends[1])):
        tree += point(f"end_{k}", name, **pose(rng))
        names.append(f"end_{k}")
    return load(folder, "tree", tree, toml + between("c", names[:2], names[2:])), rng


def two_bodies(folder, kind: str, **keys) -> sp.Mechanism:
    tree = floating("to_a", "ground", "a") + floating("to_b", "ground", "b", (0.5, 0, 0))
    return load(folder, "two_bodies", tree, closure("c", kind, "a", "b", **KEYS.get(kind, {}),
                                                    **keys))


def relative(mechanism: sp.Mechanism, q: np.ndarray) -> pin.SE3:
    data = mechanism.model.createData()
    pin.framesForwardKinematics(mechanism.model, data, q)
    first, second = (data.oMf[mechanism.frame_id(n)] for n in mechanism.closures[0].frames)
    return first.actInv(second)


def somewhere(mechanism: sp.Mechanism, rng: np.random.Generator) -> np.ndarray:
    return pin.integrate(mechanism.model, mechanism.neutral,
                         rng.uniform(-1.3, 1.3, mechanism.model.nv))


def evaluate(evaluation: LoopEquations, q: np.ndarray) -> np.ndarray:
    evaluation.update(q)
    return evaluation.residual.copy()


def along(evaluation: LoopEquations, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """The closure rows at q + v t for t in PLACES."""
    return np.array([evaluate(evaluation, pin.integrate(evaluation.model, q, t * v))
                     for t in PLACES])


def check_derivatives(evaluation: LoopEquations, q: np.ndarray, v: np.ndarray) -> float:
    """Compare Jacobian and bias at q with differences along v; return the size of the rows."""
    rows = along(evaluation, q, v)
    evaluation.update(q)
    jacobian, bias = evaluation.jacobian.copy(), evaluation.bias(q, v)
    size = 1.0 + float(np.abs(rows).max())
    scaled = v / evaluation.mechanism.velocity_scale
    assert np.abs(FIRST @ rows / STEP - jacobian @ scaled).max() < 1e-10 * size
    assert np.abs(SECOND @ rows / STEP**2 - bias).max() < 1e-8 * size
    return size
