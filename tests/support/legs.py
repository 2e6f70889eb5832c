"""Robots and machines of many legs, made of Pinocchio models."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

import spatial_pin as sp


def at(x: float, y: float, z: float) -> pin.SE3:
    return pin.SE3(np.eye(3), np.array([x, y, z]))


def _on_base(model: pin.Model, base: str) -> int:
    """Add a base of a kind; return its joint."""
    here = pin.SE3.Identity()
    if base == "ground":
        return 0
    if base == "floating":
        return model.addJoint(0, pin.JointModelFreeFlyer(), here, "base")
    if base == "planar":
        return model.addJoint(0, pin.JointModelPlanar(), here, "base")
    joint = 0
    for name, slide in zip("xyz", (pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ),
                           strict=True):
        joint = model.addJoint(joint, slide(), here, f"base_{name}")
    return model.addJoint(joint, pin.JointModelSpherical(), here, "base_ball")


def robot(base: str, legs: int = 2, drivers: Sequence[str] | None = None) -> sp.Mechanism:
    """A robot whose knees are moved by motors at the hips, through rods; an arm is on its back.

    Args:
        base: "floating", "planar", "chain" (three slides and a ball) or "ground".
        legs: how many.
        drivers: default the motors.
    """
    model = pin.Model()
    root = _on_base(model, base)
    model.appendBodyToJoint(root, pin.Inertia(10.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    turns, closures = pin.JointModelRY(), []
    for k in range(legs):
        hip = model.addJoint(root, pin.JointModelRX(), at(-0.1 * k, 0.2, 0.0), f"hip_{k}")
        model.addJoint(hip, turns, at(0.0, 0.0, -0.4), f"knee_{k}")
        motor = model.addJoint(hip, turns, at(0.0, 0.0, -0.05), f"motor_{k}")
        model.addJoint(motor, turns, at(-0.06, 0.0, 0.02), f"rod_{k}")
        closures.append(sp.closures.spherical(
            (f"rod_{k}", at(0.0, 0.0, -0.35)), (f"knee_{k}", at(-0.06, 0.0, 0.02)),
            name=f"rod_end_{k}"))
    shoulder = model.addJoint(root, pin.JointModelRZ(), at(0.0, 0.0, 0.3), "shoulder")
    model.addJoint(shoulder, pin.JointModelSpherical(), at(0.0, 0.0, 0.3), "wrist")
    chosen = [f"motor_{k}" for k in range(legs)] if drivers is None else drivers
    return sp.Mechanism.from_model(model, closures, drivers=chosen, name="robot")


def walker(
    legs: int, sizes: Sequence[float] = (), only: int | None = None, limit: float = np.inf
) -> sp.Mechanism:
    """Jansen's legs on one crank, each a group of three loops of its own.

    Args:
        legs: how many.
        sizes: of the first legs' upper triangles, relative to Jansen's: a small one does not let
            the crank turn round.
        only: the leg whose loops alone are closed.
        limit: of all hinges but the crank, either way [rad].
    """
    model = pin.Model()
    crank, closures = model.addJoint(0, pin.JointModelRY(), at(0.0, 0.0, 0.0), "crank"), []
    for k in range(legs):
        size = sizes[k] if k < len(sizes) else 1.0
        phase, side = 2.0 * np.pi * k / legs, 1.0 if k % 2 else -1.0
        pin_of_crank = at(0.15 * np.cos(phase), 0.0, 0.15 * np.sin(phase))
        for name, parent, place in (
            ("up", crank, pin_of_crank), ("down", crank, pin_of_crank),
            ("tri", 0, at(0.38 * side, 0.0, -0.078)), ("low", 0, at(0.38 * side, 0.0, -0.078)),
            ("link", "tri", at(0.401 * side, 0.0, 0.0)), ("foot", "low", at(0.0, 0.0, -0.393)),
        ):
            on = model.getJointId(f"{parent}_{k}") if isinstance(parent, str) else parent
            model.addJoint(on, pin.JointModelRY(), place, f"{name}_{k}")
        ends = {"a": ("up", (0.0, 0.5 * size), "tri", (0.2 * side * size, 0.36 * size)),
                "b": ("down", (0.0, -0.619), "low", (0.0, -0.393)),
                "c": ("link", (0.0, -0.394), "foot", (0.367 * side, 0.0))}
        closures += [sp.closures.spherical(
            (f"{one}_{k}", at(x[0], 0.0, x[1])), (f"{two}_{k}", at(y[0], 0.0, y[1])),
            name=f"{name}_{k}") for name, (one, x, two, y) in ends.items() if only in (None, k)]
    model.lowerPositionLimit[1:], model.upperPositionLimit[1:] = -limit, limit
    return sp.Mechanism.from_model(model, closures, drivers=["crank"], name=f"walker_{legs}")
