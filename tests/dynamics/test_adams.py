"""One body on one joint, against ADAMS: accelerations and reactions, as tree joint and as closure.

Positions and velocities are taken from the data, six digits, and put into the equations of motion;
what comes out must be the data's accelerations and reactions, exactly so at the start.
"""

from functools import cache
from pathlib import Path
from typing import NamedTuple

import mechanisms as known
import numpy as np
import pinocchio as pin
import pytest
from folders import DATA

import spatial_pin as sp

ADAMS = DATA / "adams_joints"
GRAVITY = "gravity = [0.0, 0.0, -9.80665]\n"
ARM = 2.0  # distance of the centre of mass from the joint [m]
SLENDER = (0.04, 0.1, 0.1)
UPRIGHT = (0.1, 0.04, 0.1)
ON_THE_WAY = 1e-4  # accuracy of the data, by their largest values


@cache
def read(case: str, quantity: str) -> np.ndarray:
    return np.loadtxt(ADAMS / f"{case}_ADAMS_{quantity}.txt", skiprows=3)[:, 1:]


def heavy(tree: str, link: str, com=(0.0, 0.0, 0.0), inertia=SLENDER) -> str:
    """Give a link of the tree 1 kg."""
    ixx, iyy, izz = inertia
    return tree.replace(f'<link name="{link}"/>', f'<link name="{link}"><inertial><origin xyz='
                        f'"{known.words(com)}"/><mass value="1"/><inertia ixx="{ixx}" iyy="{iyy}" '
                        f'izz="{izz}" ixy="0" ixz="0" iyz="0"/></inertial></link>')


class Case(NamedTuple):
    """A joint at `at`, its frame turned about x by `turn`; the body's arm lies along its x axis."""

    data: str
    pair: str
    at: tuple[float, float, float]
    turn: float


CASES = {case.data: case for case in (
    Case("Revolute_Case01", "revolute", (0.0, 0.0, 0.0), -np.pi / 2),
    Case("Spherical_Case02", "spherical", (1.0, 2.0, 3.0), -np.pi / 4),
    Case("Cylindrical_Case02", "cylindrical", (0.0, 0.0, 0.0), -np.pi / 2),
    Case("Prismatic_Case02", "prismatic", (1.0, 2.0, 3.0), -np.pi / 4),
)}


def as_tree_joint(case: Case, folder: Path) -> sp.Mechanism:
    rpy = (case.turn, 0, 0)
    if case.pair in ("revolute", "prismatic"):
        add = {"revolute": known.turning, "prismatic": known.sliding}[case.pair]
        tree, refined = add("pair", "ground", "body", case.at, rpy=rpy), ""
    else:
        tree = known.floating("pair", "ground", "body", case.at, rpy)
        axis = {"axis": (0, 0, 1)} if case.pair == "cylindrical" else {}
        refined = known.refine("pair", case.pair, **axis)
    tree = heavy(tree, "body", (ARM, 0, 0)) + known.point("com", "body", (ARM, 0, 0))
    return known.load(folder, "tree", tree, GRAVITY + refined)


def as_closure(case: Case, folder: Path) -> sp.Mechanism:
    tree = heavy(known.floating("free", "ground", "com"), "com")
    tree += known.point("arm", "com", (-ARM, 0, 0))
    tree += known.point("post", "ground", case.at, (case.turn, 0, 0))
    return known.load(folder, "closure", tree, GRAVITY + known.closure(
        "pair", case.pair, "post", "arm"))


class Row(NamedTuple):
    """Motion of the centre of mass, world axes."""

    position: np.ndarray
    rotation: np.ndarray
    velocity: np.ndarray
    omega: np.ndarray


def rows_of(case: str) -> list[Row]:
    quaternions = read(case, "Quat")[:, [1, 2, 3, 0]]
    rotations = [pin.Quaternion(x / np.linalg.norm(x)).matrix() for x in quaternions]
    return [Row(*row) for row in zip(read(case, "Pos"), rotations, read(case, "Vel"),
                                     read(case, "Avel"), strict=True)]


def tree_state(mech: sp.Mechanism, case: Case, row: Row) -> sp.State:
    """The joint's coordinates of a row."""
    base = pin.rpy.rpyToMatrix(case.turn, 0, 0)
    relative, spin = base.T @ row.rotation, row.rotation.T @ row.omega
    joint = row.position - row.rotation[:, 0] * ARM
    slide = base[:, 2] @ (joint - np.array(case.at))
    pace = base[:, 2] @ (row.velocity - np.cross(row.omega, row.rotation[:, 0] * ARM))
    angle = np.arctan2(relative[1, 0], relative[0, 0])
    q, v = {"revolute": ([angle], [spin[2]]),
            "spherical": (pin.Quaternion(relative).coeffs(), spin),
            "cylindrical": ([angle, slide], [spin[2], pace]),
            "prismatic": ([slide], [pace])}[case.pair]
    return sp.State(mech, np.array(q), np.array(v), closure_error=0.0)


def floating_state(mech: sp.Mechanism, row: Row) -> sp.State:
    turn = pin.Quaternion(row.rotation).coeffs()
    v = np.concatenate([row.rotation.T @ row.velocity, row.rotation.T @ row.omega])
    return sp.State(mech, np.concatenate([row.position, turn]), v, closure_error=1e-5)


def on_ground(force: pin.Force, at: np.ndarray, about: np.ndarray) -> np.ndarray:
    """The opposite of a force at the point `at`, with its moment about another."""
    moment = force.angular + np.cross(at - about, force.linear)
    return -np.concatenate([force.linear, moment])


def agrees(got: np.ndarray, case: str, quantities: tuple[str, ...], row: int) -> bool:
    """Whether each quantity is right to `ON_THE_WAY` of its largest value, at least `ARM`."""
    errors = [(np.abs(x - read(case, name)[row]).max(), np.abs(read(case, name)).max())
              for x, name in zip(got.reshape(-1, 3), quantities, strict=True)]
    return all(error < ON_THE_WAY * max(size, ARM) for error, size in errors)


QUANTITIES = ("Acc", "Aacc", "Rforce", "Rtorque")


def expected(case: str, row: int) -> np.ndarray:
    return np.concatenate([read(case, name)[row] for name in QUANTITIES])


def found(answer, frame: str, case: Case) -> np.ndarray:
    motion = answer.state.acceleration("com").vector
    at = answer.state.placement(frame).translation
    return np.concatenate([motion, on_ground(answer.reactions["pair"], at, np.array(case.at))])


def by_tree(case, row, folder):
    mech = as_tree_joint(case, folder)
    return found(sp.forward_dynamics(mech, tree_state(mech, case, row)), "body", case)


def by_closure(case, row, folder):
    mech = as_closure(case, folder)
    return found(sp.forward_dynamics(mech, floating_state(mech, row)), "arm", case)


@pytest.mark.parametrize("modelled", [by_tree, by_closure])
@pytest.mark.parametrize("name", CASES)
def test_at_the_start(name, modelled, tmp_path):
    """Six digits printed."""
    case = CASES[name]
    turn = pin.rpy.rpyToMatrix(case.turn, 0, 0)
    start = Row(np.array(case.at) + turn @ (ARM, 0, 0), turn, np.zeros(3), np.zeros(3))
    want = expected(name, 0)
    assert modelled(case, start, tmp_path) == pytest.approx(want, rel=6e-6, abs=2e-6)


@pytest.mark.parametrize("modelled", [by_tree, by_closure])
@pytest.mark.parametrize("name", CASES)
def test_on_the_way(name, modelled, tmp_path):
    case, rows = CASES[name], rows_of(name)
    for k in range(5, 500, 45):
        assert agrees(modelled(case, rows[k], tmp_path), name, QUANTITIES, k), k


# ---------------------------------------------------------------- two points, L apart


def distance_as_closure(folder: Path) -> sp.Mechanism:
    tree = heavy(known.floating("free", "ground", "com"), "com")
    return known.load(folder, "distance", tree, GRAVITY + known.closure(
        "rod", "distance", "ground", "com", length=ARM))


def distance_as_rod(folder: Path) -> sp.Mechanism:
    """A massless rod on a universal joint, with a ball at its end."""
    tree = (known.floating("foot", "ground", "rod") + known.floating("ball", "rod", "com",
                                                                     (0, ARM, 0)))
    toml = known.refine("foot", "universal", axis=(1, 0, 0), axis2=(0, 0, 1))
    return known.load(folder, "rod", heavy(tree, "com"), GRAVITY + toml + known.refine(
        "ball", "spherical"))


def test_a_distance_at_the_start(tmp_path):
    want = np.concatenate([read("Distance_Case01", n)[0] for n in ("Acc", "Aacc", "Rforce")])
    mech = distance_as_closure(tmp_path)
    row = Row(np.array([0, ARM, 0]), np.eye(3), np.zeros(3), np.zeros(3))
    closed = sp.forward_dynamics(mech, floating_state(mech, row))
    for answer, force in ((closed, "rod"), (rod_answer(tmp_path), "foot")):
        motion = answer.state.acceleration("com").vector
        assert np.concatenate([motion, -answer.reactions[force].linear]) == pytest.approx(
            want, rel=6e-6, abs=2e-6)


def rod_answer(folder):
    mech = distance_as_rod(folder)
    return sp.forward_dynamics(mech, sp.assemble(mech, {}))


def test_a_distance_on_the_way(tmp_path):
    mech, rows = distance_as_closure(tmp_path), rows_of("Distance_Case01")
    for k in range(5, 500, 45):
        answer = sp.forward_dynamics(mech, floating_state(mech, rows[k]))
        got = np.concatenate([answer.state.acceleration("com").vector,
                              -answer.reactions["rod"].linear])
        assert agrees(got, "Distance_Case01", QUANTITIES[:3], k), k


# ---------------------------------------------------------------- a massless link with a ball


def revolute_and_ball(folder: Path) -> sp.Mechanism:
    tree = (known.turning("pin", "ground", "link") + known.point("tip", "link", (ARM, 0, 0))
            + heavy(known.floating("free", "ground", "com"), "com", inertia=UPRIGHT)
            + known.point("socket", "com", (0, -ARM, 0)))
    return known.load(folder, "ball", tree, GRAVITY + known.closure(
        "ball", "spherical", "tip", "socket"))


def revolute_and_ball_in_the_tree(folder: Path) -> sp.Mechanism:
    tree = (known.turning("pin", "ground", "link")
            + known.floating("ball", "link", "body", (ARM, 0, 0))
            + known.point("com", "body", (0, ARM, 0)))
    return known.load(folder, "ball_tree", heavy(tree, "body", (0, ARM, 0), UPRIGHT),
                      GRAVITY + known.refine("ball", "spherical"))


def ball_state(mech: sp.Mechanism, row: Row) -> sp.State:
    ball = row.position - ARM * row.rotation[:, 1]
    pace = row.velocity - np.cross(row.omega, ARM * row.rotation[:, 1])
    angle = np.arctan2(ball[1], ball[0])
    speed = np.cross(ball, pace)[2] / ARM**2
    base = pin.rpy.rpyToMatrix(0, 0, angle)
    closed = "free" in mech.model.names
    if closed:
        turn = pin.Quaternion(row.rotation).coeffs()
        rest = np.concatenate([row.position, turn]), np.concatenate(
            [row.rotation.T @ row.velocity, row.rotation.T @ row.omega])
    else:
        rest = (pin.Quaternion(base.T @ row.rotation).coeffs(),
                row.rotation.T @ (row.omega - (0, 0, speed)))
    parts = [([angle], [speed]), rest]
    if closed and mech.model.names[1] == "free":
        parts.reverse()
    q, v = (np.concatenate(x) for x in zip(*parts, strict=True))
    return sp.State(mech, q, v, closure_error=1e-5)


BALL = ("Acc", "Aacc", "Rforce_Body1", "Rtorque_Body1", "Rforce_Body2")


def ball_wanted(row: int) -> np.ndarray:
    return np.concatenate([read("RevSpherical_Case01", n)[row] for n in BALL])


def ball_found(answer) -> np.ndarray:
    on_link = answer.reactions["pin"]
    return np.concatenate([answer.state.acceleration("com").vector, -on_link.vector,
                           answer.reactions["ball"].linear])


@pytest.mark.parametrize("build", [revolute_and_ball, revolute_and_ball_in_the_tree])
def test_a_link_with_a_ball(build, tmp_path):
    mech = build(tmp_path)
    start = Row(np.array([ARM, ARM, 0]), np.eye(3), np.zeros(3), np.zeros(3))
    answer = sp.forward_dynamics(mech, ball_state(mech, start))
    assert ball_found(answer) == pytest.approx(ball_wanted(0), rel=6e-6, abs=2e-6)
    rows = rows_of("RevSpherical_Case01")
    for k in range(5, 500, 45):
        got = ball_found(sp.forward_dynamics(mech, ball_state(mech, rows[k])))
        assert agrees(got, "RevSpherical_Case01", BALL, k), k
