"""Mechanisms with springs whose poses at rest and vibrations are known in closed form."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pinocchio as pin
from loaded_library import library

import spatial_pin as sp


def model_of(gravity: Sequence[float] = (0.0, 0.0, 0.0)) -> pin.Model:
    """An empty model with a gravity of its own."""
    model = pin.Model()
    model.gravity.linear = np.array(gravity)
    return model


def at(*translation: float) -> pin.SE3:
    """A placement without rotation."""
    return pin.SE3(np.eye(3), np.array(translation))


def mark(model: pin.Model, places: Mapping[str, tuple[int, Sequence[float]]]) -> None:
    """Add frames at points of joints."""
    for name, (joint, point) in places.items():
        model.addFrame(pin.Frame(name, joint, at(*point), pin.FrameType.OP_FRAME))


def point_mass(mass: float, *place: float) -> pin.Inertia:
    """A point mass at a place of its joint."""
    return pin.Inertia(mass, np.array(place or (0.0, 0.0, 0.0)), np.zeros((3, 3)))


def sprung_four_bar() -> sp.Mechanism:
    """IFToMM's benchmark of linearization: three rods of 1 m and 1 kg with a diagonal spring."""
    model = model_of((0.0, -9.81, 0.0))
    rod = pin.Inertia(1.0, np.array([0.5, 0.0, 0.0]), np.diag([0.0, 1 / 12, 1 / 12]))
    crank = model.addJoint(0, pin.JointModelRZ(), at(0, 0, 0), "crank")
    coupler = model.addJoint(crank, pin.JointModelRZ(), at(1, 0, 0), "coupler")
    rocker = model.addJoint(0, pin.JointModelRZ(), at(1, 0, 0), "rocker")
    for joint in (crank, coupler, rocker):
        model.appendBodyToJoint(joint, rod, at(0, 0, 0))
    mark(model, {"coupler_end": (coupler, (1, 0, 0)), "rocker_end": (rocker, (1, 0, 0)),
                 "origin": (0, (0, 0, 0))})
    pin_joint = sp.closures.revolute("coupler_end", "rocker_end", axis=(0, 0, 1), name="pin")
    diagonal = sp.Spring("diagonal", ("origin", "coupler_end"), stiffness=25.0, damping=1.0,
                         free_length=np.sqrt(2.0))
    return sp.Mechanism.from_model(model, closures=[pin_joint], drivers=["crank"],
                                   springs=[diagonal])


def truss(mass: float = 1.0) -> sp.Mechanism:
    """Von Mises's truss: springs of 1000 N/m, half span 0.3 m, rest height 0.1 m."""
    model = model_of()
    slide = model.addJoint(0, pin.JointModelPY(), at(0, 0, 0), "y")
    if mass:
        model.appendBodyToJoint(slide, point_mass(mass), at(0, 0, 0))
    mark(model, {"left": (0, (-0.3, 0, 0)), "right": (0, (0.3, 0, 0)), "top": (slide, (0, 0, 0))})
    return sp.Mechanism.from_model(model, drivers=["y"], springs=[
        sp.Spring(side, (side, "top"), stiffness=1000.0, free_length=np.hypot(0.3, 0.1))
        for side in ("left", "right")])


def governor() -> sp.Mechanism:
    """Watt's governor: a ball of 1 kg at a massless arm of 0.4 m, hinged on the axis of a shaft."""
    model = model_of((0.0, 0.0, -9.81))
    shaft = model.addJoint(0, pin.JointModelRZ(), at(0, 0, 0), "shaft")
    arm = model.addJoint(shaft, pin.JointModelRY(), at(0, 0, 0), "arm")
    model.appendBodyToJoint(arm, point_mass(1.0, 0.0, 0.0, -0.4), at(0, 0, 0))
    return sp.Mechanism.from_model(model, drivers=["shaft"])


def turning_arms() -> sp.Mechanism:
    """Two arms of crooked masses, one behind the other, on a shaft."""
    model = model_of((0.0, 0.0, -9.81))
    shaft = model.addJoint(0, pin.JointModelRZ(), at(0, 0, 0), "shaft")
    arm = model.addJoint(shaft, pin.JointModelRY(), at(0.1, 0, 0), "arm")
    bob = model.addJoint(arm, pin.JointModelRX(), at(0, 0.05, -0.3), "bob")
    for joint, mass, place, moments in (
            (shaft, 1.0, (0.0, 0.0, 0.0), (0.1, 0.1, 0.1)),
            (arm, 1.0, (0.02, 0.03, -0.2), (0.02, 0.03, 0.01)),
            (bob, 0.7, (0.05, 0.02, -0.15), (0.01, 0.02, 0.03))):
        model.appendBodyToJoint(joint, pin.Inertia(mass, np.array(place), np.diag(moments)),
                                at(0, 0, 0))
    return sp.Mechanism.from_model(model, drivers=["shaft"], springs=[
        sp.Spring("of_arm", joint="arm", stiffness=1.0, damping=0.3),
        sp.Spring("of_bob", joint="bob", stiffness=2.0, damping=0.1)])


def sleeved_governor() -> sp.Mechanism:
    """A governor whose arms close a loop through a sleeve on the shaft."""
    model = model_of((0.0, 0.0, -9.81))
    shaft = model.addJoint(0, pin.JointModelRZ(), at(0, 0, 0), "shaft")
    upper = model.addJoint(shaft, pin.JointModelRY(), at(0.02, 0, 0.5), "upper")
    lower = model.addJoint(upper, pin.JointModelRY(), at(0, 0, -0.3), "lower")
    sleeve = model.addJoint(shaft, pin.JointModelPZ(), at(0.02, 0, 0), "sleeve")
    for joint, mass, low, moments in (
            (upper, 0.2, -0.15, (0.002, 0.002, 0.0001)),
            (lower, 1.0, -0.02, (0.002, 0.002, 0.0001)),
            (sleeve, 1.5, 0.0, (0.01, 0.01, 0.02))):
        model.appendBodyToJoint(joint, pin.Inertia(mass, np.array([0.0, 0.0, low]),
                                                   np.diag(moments)), at(0, 0, 0))
    mark(model, {"end": (lower, (0, 0, -0.3)), "lug": (sleeve, (0, 0, 0))})
    return sp.Mechanism.from_model(
        model, closures=[sp.closures.revolute("end", "lug", axis=(0, 1, 0), name="pin")],
        drivers=["shaft"], guess={"upper": -0.6, "lower": 1.2},
        springs=[sp.Spring("oil", joint="sleeve", stiffness=0.0, damping=2.0)])


def plate() -> sp.Mechanism:
    """A plate of 2 kg that hangs on two cords of 0.8 m, 0.15 m from its centre on either side."""
    model = model_of((0.0, 0.0, -9.81))
    free = model.addJoint(0, pin.JointModelFreeFlyer(), at(0, 0, 0), "plate")
    model.appendBodyToJoint(free, pin.Inertia(2.0, np.zeros(3), np.diag([0.01, 0.02, 0.02])),
                            at(0, 0, 0))
    mark(model, {"hook_1": (0, (0.15, 0, 0.8)), "hook_2": (0, (-0.15, 0, 0.8)),
                 "end_1": (free, (0.15, 0, 0)), "end_2": (free, (-0.15, 0, 0))})
    return sp.Mechanism.from_model(model, closures=[
        sp.closures.distance(f"hook_{k}", f"end_{k}", 0.8, name=f"cord_{k}") for k in (1, 2)])


def chain(n: int = 8) -> sp.Mechanism:
    """Masses of 10 kg on a line between springs of 1e5 N/m, from wall to wall."""
    model, joint = model_of(), 0
    places = {"p0": (0, (0, 0, 0)), f"p{n + 1}": (0, (n + 1, 0, 0))}
    for k in range(1, n + 1):
        joint = model.addJoint(joint, pin.JointModelPX(), at(1, 0, 0), f"x{k}")
        model.appendBodyToJoint(joint, point_mass(10.0), at(0, 0, 0))
        places[f"p{k}"] = (joint, (0, 0, 0))
    mark(model, places)
    return sp.Mechanism.from_model(model, springs=[
        sp.Spring(f"s{k}", (f"p{k}", f"p{k + 1}"), stiffness=1e5, free_length=1.0)
        for k in range(n + 1)])


def hung(tied: int = 6) -> sp.Mechanism:
    """A body of 3 kg on a free base, hung on up to six springs between its corners and hooks."""
    model = model_of((0.0, 0.0, -9.81))
    base = model.addJoint(0, pin.JointModelFreeFlyer(), at(0, 0, 0), "base")
    model.appendBodyToJoint(base, pin.Inertia(3.0, np.zeros(3), np.diag([0.03, 0.04, 0.05])),
                            at(0, 0, 0))
    springs = []
    for k in range(tied):
        one, other = np.radians(60.0 * k), np.radians(60.0 * k + 40.0 * (-1) ** k)
        mark(model, {f"hook_{k}": (0, (0.5 * np.cos(one), 0.5 * np.sin(one), 0.6)),
                     f"corner_{k}": (base, (0.2 * np.cos(other), 0.2 * np.sin(other), 0.02 * k))})
        springs.append(sp.Spring(f"s{k}", (f"hook_{k}", f"corner_{k}"), stiffness=200.0 + 30.0 * k,
                                 free_length=0.3))
    return sp.Mechanism.from_model(model, springs=springs)


def with_springs(name: str, seed: int = 1) -> sp.Mechanism:
    """A library mechanism with a spring and a damper about every joint of one freedom.

    The legs of the platform carry it about where it stands.
    """
    mech, rng = library(name), np.random.default_rng(seed)
    home, springs = sp.assemble(mech), []
    for c in mech.coordinate_table.values():
        if c.q >= 0:
            is_leg = name == "stewart" and c.name.startswith("slide")
            middle, size = (home.q[c.q], 2000.0) if is_leg else (0.0, 1.0)
            springs.append(sp.Spring(
                f"about_{c.name}", joint=c.name, stiffness=size * rng.uniform(0.5, 5.0),
                damping=rng.uniform(0.1, 1.0),
                free_angle=middle + rng.uniform(-0.5, 0.5) / size**0.5))
    return mech.with_fields(springs=tuple(springs))
