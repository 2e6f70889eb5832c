"""The kernel's numbers beside Pinocchio's and NumPy's."""

from __future__ import annotations

import ctypes
import tomllib
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from closure_oracle import Evaluation
from closure_trees import JOINTS, KEYS, TYPES, pose, refinement, somewhere
from mechanisms import between, closure, coupling, floating, load, point
from sameness import assert_same

import spatial_pin as sp
from spatial_pin.constraints.compiled_equations import Constraints
from spatial_pin.kernel.kernel import EvaluationStruct, Kernel
from spatial_pin.kernel.library import address, numbers
from spatial_pin.kernel.loop_equations import loops_at

ROUND_OFF = 1e-14


def everything(folder: Path, seed: int, size: float = 1.0) -> sp.Mechanism:
    """A random tree with a joint of every kind, a closure of every kind between any two bodies."""
    rng = np.random.default_rng(seed)
    tree = toml = ""
    bodies = ["ground"]
    for k, kind in enumerate(rng.permutation([*JOINTS, "revolute", "prismatic"])):
        place = pose(rng)
        tree += floating(f"to_{k}", str(rng.choice(bodies[-4:])), f"body_{k}",
                         size * place["xyz"], place["rpy"])
        text = refinement(f"to_{k}", str(kind), rng)
        toml += text.replace("lead = 0.023", f"lead = {0.023 * size!r}")
        bodies.append(f"body_{k}")
    plain = [x for x in TYPES if not {"curve", "curves"} & KEYS.get(x, {}).keys()]
    for k, kind in enumerate([*plain, "between"]):
        names = []
        for i, body in enumerate(rng.choice(bodies, 4, replace=False)):
            names.append(f"at_{k}_{i}")
            place = pose(rng)
            tree += point(names[-1], body, size * place["xyz"], place["rpy"])
        keys = {name: size * value for name, value in KEYS.get(kind, {}).items()}
        toml += (between(f"c_{k}", names[:2], names[2:]) if kind == "between"
                 else closure(f"c_{k}", kind, *names[:2], **keys))
    turns = [name for name, joint in tomllib.loads(toml)["joints"].items()
             if joint["type"] in ("revolute", "prismatic", "screw")]
    a, b, c = (str(n) for n in rng.choice(turns, 3, replace=False))
    toml += coupling("gear", a, b, 1.7, 0.3) + coupling("rack", b, c, -0.4 * size)
    toml += f'[passive.spin]\nbody = "{bodies[-1]}"\naxis = ["tip", "tail"]\n'
    tree += "".join(point(end, bodies[-1], size * rng.normal(size=3)) for end in ("tip", "tail"))
    return load(folder, "everything", tree, toml)


def asked_at(mechanism: sp.Mechanism, rng: np.random.Generator):
    """A configuration and velocities of ordinary size for the mechanism."""
    scale = mechanism.velocity_scale
    q = pin.integrate(mechanism.model, mechanism.neutral,
                      rng.uniform(-1.3, 1.3, mechanism.model.nv) * scale)
    return q, scale * rng.normal(size=mechanism.model.nv)


class Evaluated(NamedTuple):
    """What one configuration gives.

    Attributes:
        rotations: (n, 3, 3) of the joints of the model in the world, as Pinocchio's.
        translations: (n, 3) [m].
        residual: (n_closure,) closure equations.
        angles: (n_angles,) of screw closures [rad].
        jacobian: (n_closure + n_passive, nv) with respect to v / `velocity_scale`.
        angle_jacobian: (n_angles, nv) of the angles, likewise.
        bias: (n_closure + n_passive,) second derivatives at zero joint acceleration.
    """

    rotations: np.ndarray
    translations: np.ndarray
    residual: np.ndarray
    angles: np.ndarray
    jacobian: np.ndarray
    angle_jacobian: np.ndarray
    bias: np.ndarray


def evaluated(kernel: Kernel, q, v, reference) -> Evaluated:
    """Placements, closure equations, Jacobian and bias at q, v; angles nearest to `reference`."""
    q, v = numbers(q, (kernel.nq,)), numbers(v, (kernel.nv,))
    reference = numbers(reference, (kernel.n_angles,))
    n, equations = len(kernel.packed.frames), kernel.n_closure + kernel.n_passive
    rows = equations + kernel.n_angles
    rotations, translations = np.empty((n, 3, 3)), np.empty((n, 3))
    residual, angles = np.empty(kernel.n_closure), np.empty(kernel.n_angles)
    jacobian, bias = np.empty((rows, kernel.nv)), np.empty(equations)
    task = EvaluationStruct(1, *map(address, (q, v, reference)), **{
        name: address(x) for name, x in {
            "R": rotations, "p": translations, "residual": residual, "angle": angles,
            "jacobian": jacobian, "bias": bias}.items()})
    kernel.library.kernel_evaluate(kernel.handle, ctypes.byref(task))
    carriers = kernel.packed.carriers
    in_pin = np.einsum("jki,jlk->jil", rotations, kernel.packed.frames)[carriers]
    return Evaluated(in_pin, translations[carriers], residual, angles, jacobian[:equations],
                     jacobian[equations:], bias)


def assert_near(ours: np.ndarray, theirs: np.ndarray, size: float, what: str) -> None:
    """Equal to round-off of numbers of a size."""
    assert ours.shape == theirs.shape, what
    worst = float(np.abs(ours - theirs).max(initial=0.0))
    assert worst <= ROUND_OFF * size, f"{what}: {worst / size:.2g} of {size:.3g}"


def reach(mechanism: sp.Mechanism, places: np.ndarray) -> float:
    """Length that placements are rounded by: how far bodies stand from the world's origin [m]."""
    return max(mechanism.characteristic_length, float(np.abs(places).max(initial=0.0)))


def assert_same_as_pinocchio(mechanism: sp.Mechanism, q: np.ndarray, v: np.ndarray) -> None:
    judge, kernel = Evaluation(Constraints(mechanism)), Kernel(mechanism)
    judge.update(q)
    turns = judge.angles + 2.0 * np.pi * np.arange(1, len(judge.angles) + 1)
    judge.angle_reference[:] = turns
    judge.update(q)
    bias = judge.bias(q, v)
    found = evaluated(kernel, q, v, turns)
    rotations = np.array([m.rotation for m in judge.data.oMi])
    places = np.array([m.translation for m in judge.data.oMi])
    assert_near(found.rotations, rotations, 1.0, "rotations")
    far = reach(mechanism, places)
    assert_near(found.translations, places, far, "translations")
    # equations are products of lengths relative to the characteristic one, and of unit vectors
    far = 1.0 + far / mechanism.characteristic_length
    steep = far * (1.0 + float(np.abs(judge.jacobian).max(initial=0.0)))
    assert_near(found.residual, judge.residual, steep, "residual")
    assert_near(found.angles, judge.angles, 10.0 * (1.0 + np.abs(turns).max(initial=0.0)), "angles")
    assert_near(found.jacobian, judge.jacobian, steep, "Jacobian")
    assert_near(found.angle_jacobian, judge.angle_jacobian, 10.0 * steep, "Jacobian of angles")
    wrenches = loops_at(mechanism, q, turns).row_wrenches()
    size = 1.0 + float(np.abs(judge.row_wrenches()).max(initial=0.0))
    assert_near(wrenches, judge.row_wrenches(), size, "wrenches")
    speed = 1.0 + float(np.abs(v / mechanism.velocity_scale).max(initial=0.0))
    assert_near(found.bias, bias, speed**2 * steep + np.abs(bias).max(initial=0.0), "bias")


SEVERAL = 4


def configurations(mechanism: sp.Mechanism, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.array([somewhere(mechanism, rng) for _ in range(SEVERAL)]).T


def check_kernel(mechanism: sp.Mechanism, q: np.ndarray) -> None:
    """Placements and Jacobians of several configurations (nq, m) are those of Pinocchio."""
    model, kernel = mechanism.model, Kernel(mechanism)
    data, evaluation = model.createData(), Evaluation(Constraints(mechanism))
    placements, jacobians = kernel.placements(q.T), kernel.jacobians(q.T)
    for k in range(q.shape[1]):
        pin.forwardKinematics(model, data, q[:, k])
        for i, own in enumerate(data.oMi):
            assert_same(placements[k, i, :3].T, own.rotation)
            assert_same(placements[k, i, 3], own.translation)
        evaluation.angle_reference[:] = 0.0
        evaluation.update(q[:, k])
        assert_same(jacobians[k], evaluation.jacobian)
