"""Masses for the mechanisms of `mechanisms.py`, and free bodies to check their forces by."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import NamedTuple

import mechanisms as known
import mpmath
import numpy as np
import pinocchio as pin
import xacro
from folders import ROOT
from mpmath import mpf

import spatial_pin as sp


def inertial(mass, com=(0.0, 0.0, 0.0), inertia=(0.0, 0.0, 0.0)) -> str:
    ixx, iyy, izz = inertia
    return (f'<inertial><origin xyz="{known.words(com)}"/><mass value="{mass!r}"/><inertia '
            f'ixx="{ixx!r}" iyy="{iyy!r}" izz="{izz!r}" ixy="0" ixz="0" iyz="0"/></inertial>')


def heavy(tree: str, **links: tuple) -> str:
    """Give links of a tree (mass, centre of mass, principal moments of inertia)."""
    for link, numbers in links.items():
        empty = f'<link name="{link}"/>'
        assert empty in tree, link
        tree = tree.replace(empty, f'<link name="{link}">{inertial(*numbers)}</link>')
    return tree


def two_rods(mass: float, size: float = 1.0) -> sp.Mechanism:
    """A double pendulum of two rods with a third as its load, `size` long each [m]."""
    rod = (mass, (0.5 * size, 0.0, 0.0), (0.0, mass * size**2 / 12, mass * size**2 / 12))
    tree = known.turning("p", "ground", "upper")
    tree += known.turning("k", "upper", "lower", (size, 0.0, 0.0))
    tree += known.point("load", "lower", (size, 0.0, 0.0))
    tree = heavy(tree, upper=rod, lower=rod, load=rod)
    return known.from_tree("two_rods", tree, gravity=[0.0, -9.81, 0.0])


def simple_pendulum() -> sp.Mechanism:
    """IFToMM A01: 1 kg at the end of a massless rod of 1 m."""
    tree = known.turning("pin", "ground", "rod") + known.point("bob", "rod", (1.0, 0, 0))
    return known.from_tree("simple_pendulum", heavy(tree, bob=(1.0,)), gravity=[0.0, -9.81, 0.0])


def with_masses(mech: sp.Mechanism, folder: Path, toml: str = "", **links: tuple) -> sp.Mechanism:
    """Load a mechanism of `mechanisms.py` again with masses and more lines of TOML before it."""
    tree = heavy((folder / f"{mech.name}.urdf").read_text(encoding="utf-8"), **links)
    (folder / f"{mech.name}.urdf").write_text(tree, encoding="utf-8")
    path = folder / f"{mech.name}.toml"
    head, tree_line, rest = path.read_text(encoding="utf-8").split("\n", 2)
    path.write_text("\n".join([head, tree_line, toml, rest]), encoding="utf-8")
    return sp.load(path)


# ---------------------------------------------------------------- the plane, by free bodies


class PlaneBody(NamedTuple):
    """Mass, moment of inertia, and (x, y, angle) of the centre of mass at a time."""

    mass: float
    inertia: float
    pose: Callable


class PlanePin(NamedTuple):
    """A pin at a point; its force counts on the body `second` ("" for the ground)."""

    first: str
    second: str
    point: Callable


class PlaneForces(NamedTuple):
    """Torque on the crank, force (2,) of every pin, and (normal force, moment) of the guide."""

    torque: float
    pins: dict[str, np.ndarray]
    guide: np.ndarray


def plane_forces(
    bodies: Mapping[str, PlaneBody], pins: Mapping[str, PlanePin], time: float, gravity: float,
    guided: str = "",
) -> PlaneForces:
    """Newton and Euler for every body by itself; the torque acts on the first body.

    The guide is along x and acts at the centre of mass of `guided`.
    """
    names, n = list(bodies), 3 * len(bodies)
    a, b = np.zeros((n, n)), np.zeros(n)
    places = {}
    for k, (name, body) in enumerate(bodies.items()):
        with mpmath.workdps(40):
            x, y, _ = places[name] = [mpf(c) for c in body.pose(mpf(time))]
            rates = [mpmath.diff(lambda t, i=i, pose=body.pose: pose(t)[i], mpf(time), 2)
                     for i in range(3)]
        b[3 * k : 3 * k + 3] = [body.mass * rates[0], body.mass * (rates[1] + gravity),
                                body.inertia * rates[2]]
    for j, pin_ in enumerate(pins.values()):
        x, y = (float(c) for c in pin_.point(mpf(time)))
        for name, sense in ((pin_.first, -1.0), (pin_.second, 1.0)):
            if name:
                k = 3 * names.index(name)
                cx, cy = (float(c) for c in places[name][:2])
                a[k : k + 3, 2 * j : 2 * j + 2] = sense * np.array(
                    [[1, 0], [0, 1], [-(y - cy), x - cx]])
    a[2, n - 1] = 1.0
    if guided:
        k, j = 3 * names.index(guided), 2 * len(pins)
        a[k + 1, j], a[k + 2, j + 1] = 1.0, 1.0
    solution = np.linalg.solve(a, b)
    forces = {name: solution[2 * j : 2 * j + 2] for j, name in enumerate(pins)}
    return PlaneForces(float(solution[-1]), forces, solution[2 * len(pins) : -1])


# ---------------------------------------------------------------- any mechanism, by free bodies


class BodyMotion(NamedTuple):
    """Inertia, and motion of the centre of mass, of the body behind one joint, world axes."""

    mass: float
    inertia: np.ndarray
    com: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    omega: np.ndarray
    alpha: np.ndarray

    @property
    def needed(self) -> np.ndarray:
        """Force and moment about the centre of mass that the motion needs (6,)."""
        turning = self.inertia @ self.alpha + np.cross(self.omega, self.inertia @ self.omega)
        return np.concatenate([self.mass * self.acceleration, turning])


def body_motion(state: sp.State, joint: int) -> BodyMotion:
    model = state.mechanism.model
    inertia, placement = model.inertias[joint], state.data.oMi[joint]
    name = model.names[joint]
    frame = model.getFrameId(name, pin.FrameType.JOINT)
    axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    twist = pin.getFrameVelocity(model, state.data, frame, axes)
    rate = pin.getFrameClassicalAcceleration(model, state.data, frame, axes)
    arm = placement.rotation @ inertia.lever
    turning = np.cross(twist.angular, arm)
    return BodyMotion(
        inertia.mass, placement.rotation @ inertia.inertia @ placement.rotation.T,
        placement.translation + arm, twist.linear + turning,
        rate.linear + np.cross(rate.angular, arm) + np.cross(twist.angular, turning),
        twist.angular.copy(), rate.angular.copy())


def wrenches_by_body(answer, efforts: Mapping[str, float]) -> np.ndarray:
    """Sum at the world's origin of reactions, efforts and gravity on every body (njoints, 6)."""
    state, mech = answer.state, answer.state.mechanism
    model, data = mech.model, mech.model.createData()
    columns = pin.computeJointJacobians(model, data, state.q).reshape(6, -1)
    total = np.zeros((model.njoints, 6))

    def act(joint: int, force: np.ndarray, moment: np.ndarray, at: np.ndarray) -> None:
        total[joint] += np.concatenate([force, moment + np.cross(at, force)])

    for i in range(1, model.njoints):
        borne, at = answer.reactions[model.names[i]], state.data.oMi[i].translation
        act(i, borne.linear, borne.angular, at)
        act(model.parents[i], -borne.linear, -borne.angular, at)
        motion = body_motion(state, i)
        act(i, motion.mass * model.gravity.linear, np.zeros(3), motion.com)
    for closure in mech.closures:
        if closure.frames:
            borne = answer.reactions[closure.name]
            at = state.placement(closure.frames[1]).translation
            bodies = [mech.frame_on_joint(f)[0] for f in closure.frames]
            act(bodies[1], borne.linear, borne.angular, at)
            act(bodies[0], -borne.linear, -borne.angular, at)
    for name, effort in [*efforts.items(), *_of_couplings(answer)]:
        coordinate = mech.driven_coordinate(name)
        joint, at = mech.joint_id(coordinate.joint), state.data.oMi[mech.joint_id(
            coordinate.joint)].translation
        axis = columns[3:, coordinate.v] if coordinate.unit == "rad" else columns[:3, coordinate.v]
        pull = [np.zeros(3), effort * axis][:: 1 if coordinate.unit == "rad" else -1]
        act(joint, *pull, at)
        act(model.parents[joint], -pull[0], -pull[1], at)
    return total


def _of_couplings(answer) -> list[tuple[str, float]]:
    """What couplings do at their joints, by the multipliers of their rows, which come last."""
    mech = answer.state.mechanism
    couplings = [c for c in mech.closures if c.joints]
    rows = sp.closure_jacobian(mech, answer.state.q)[len(answer.multipliers) - len(couplings) :]
    multipliers = answer.multipliers[len(answer.multipliers) - len(couplings) :]
    return [(name, float(x * row[mech.driven_coordinate(name).v]))
            for closure, row, x in zip(couplings, rows, multipliers, strict=True)
            for name in closure.joints]


def needed_by_body(state: sp.State) -> np.ndarray:
    """Wrench at the world's origin that the motion of every body needs (njoints, 6)."""
    total = np.zeros((state.mechanism.model.njoints, 6))
    for i in range(1, len(total)):
        motion = body_motion(state, i)
        need = motion.needed
        total[i] = np.concatenate([need[:3], need[3:] + np.cross(motion.com, need[:3])])
    return total


def energy_rate(state: sp.State) -> float:
    """Rate of kinetic plus potential energy [W], body by body."""
    total = 0.0
    gravity = state.mechanism.model.gravity.linear
    for i in range(1, state.mechanism.model.njoints):
        motion = body_motion(state, i)
        need = motion.needed
        total += (need[:3] - motion.mass * gravity) @ motion.velocity + need[3:] @ motion.omega
    return float(total)

URDF = ROOT / "urdf"
STEEL = 7850.0  # kg/m3


@cache
def urdf(mechanism: str, **parameters: float) -> ElementTree.Element:
    mappings = {key: repr(value) for key, value in parameters.items()}
    document = xacro.process_file(str(URDF / f"{mechanism}.urdf.xacro"), mappings=mappings)
    return ElementTree.fromstring(document.toxml())


def numbers(text: str) -> np.ndarray:
    return np.array(text.split(), dtype=float)


def inertias(mechanism: str, **parameters: float) -> dict[str, pin.Inertia]:
    """The inertia of every moving link as its URDF states it."""
    stated = {}
    for link in urdf(mechanism, **parameters).iter("link"):
        if (inertial := link.find("inertial")) is not None:
            mass = float(inertial.find("mass").get("value"))
            centre = numbers(inertial.find("origin").get("xyz"))
            xx, xy, xz, yy, yz, zz = (
                float(inertial.find("inertia").get(f"i{k}"))
                for k in ("xx", "xy", "xz", "yy", "yz", "zz")
            )
            moments = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            stated[link.get("name")] = pin.Inertia(mass, centre, moments)
    return stated


def solid(visual: ElementTree.Element) -> pin.Inertia:
    """The inertia of a drawn shape as a solid of steel, in its link's frame."""
    origin, shape = visual.find("origin"), visual.find("geometry")[0]
    if shape.tag == "cylinder":
        r, length = float(shape.get("radius")), float(shape.get("length"))
        inertia = pin.Inertia.FromCylinder(STEEL * np.pi * r**2 * length, r, length)
    elif shape.tag == "sphere":
        r = float(shape.get("radius"))
        inertia = pin.Inertia.FromSphere(STEEL * np.pi * r**3 * 4 / 3, r)
    else:
        size = numbers(shape.get("size"))
        inertia = pin.Inertia.FromBox(STEEL * size.prod(), *size)
    rotation = pin.rpy.rpyToMatrix(numbers(origin.get("rpy")))
    return pin.SE3(rotation, numbers(origin.get("xyz"))).act(inertia)
