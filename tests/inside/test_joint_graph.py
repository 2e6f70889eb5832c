"""Joint graphs: which joint of a loop is cut, and joints that the tree walks against the file."""

import itertools
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from spatial_pin.formats.graph.joint_graph import (
    WORLD,
    GraphJoint,
    JointGraph,
    Link,
    SpanningTree,
    in_loops,
)
from spatial_pin.formats.graph.open_tree import coordinates_at
from spatial_pin.mechanism.pairs import JOINT_TYPES, PAIRS

MOVING = [kind for kind in JOINT_TYPES if kind != "fixed"]
X, Y, Z = np.eye(3)


def motion(joint: GraphJoint, q: np.ndarray) -> pin.SE3:
    """Placement of a joint's frame on its child in that on its parent, by Pinocchio."""
    model = pin.Model()
    model.addJoint(0, PAIRS[joint.type].joint(joint.axis, joint.axis2, joint.lead),
                   pin.SE3.Identity(), "j")
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    return data.oMi[1].copy()


def sample(kind: str, seed: int = 0) -> tuple[GraphJoint, np.ndarray]:
    """A joint about skew axes, and a configuration of it."""
    rng = np.random.default_rng(seed)
    turn = pin.exp3(rng.normal(size=3))
    joint = GraphJoint("j", kind, "a", "b", axis=turn[:, 0], axis2=turn[:, 1], lead=0.3)
    model = pin.Model()
    model.addJoint(0, PAIRS[kind].joint(joint.axis, joint.axis2, joint.lead), pin.SE3.Identity(),
                   "j")
    return joint, pin.integrate(model, pin.neutral(model), rng.uniform(-1.2, 1.2, model.nv))


@pytest.mark.parametrize("kind", MOVING)
def test_coordinates_are_found_where_the_links_are_drawn(kind):
    joint, q = sample(kind)
    relative = motion(joint, q)
    values, reached = coordinates_at(joint, relative)
    assert np.abs(reached.homogeneous - relative.homogeneous).max() < 1e-14
    if PAIRS[kind].is_linear:
        assert np.allclose(values, q, atol=1e-14)
    else:
        assert np.allclose(values[-3:], pin.log3(relative.rotation), atol=1e-14)


@pytest.mark.parametrize("turns", [-2.3, 0.4, 1.7])
def test_a_screw_counts_its_turns_by_its_slide(turns):
    joint, _ = sample("screw")
    values, _ = coordinates_at(joint, motion(joint, np.array([2 * np.pi * turns])))
    assert values[0] == pytest.approx(2 * np.pi * turns, abs=1e-12)


@pytest.mark.parametrize("kind", [k for k in MOVING if PAIRS[k].freedom == 1])
def test_a_turned_joint_of_one_coordinate_keeps_its_sign(kind):
    joint, q = sample(kind)
    turned = motion(joint.turned(), q)
    assert np.abs((turned * motion(joint, q)).homogeneous - np.eye(4)).max() < 1e-14


def test_a_turned_universal_joint_takes_its_pins_the_other_way_round():
    joint, q = sample("universal")
    turned = motion(joint.turned(), q[::-1].copy())
    assert np.abs((turned * motion(joint, q)).homogeneous - np.eye(4)).max() < 1e-14


def ring(kinds, **changes) -> JointGraph:
    """A loop through the world: joint k joins link k - 1 and link k."""
    names = [WORLD, *(f"l{k}" for k in range(1, len(kinds))), WORLD]
    joints = []
    for k, kind in enumerate(kinds):
        joint = GraphJoint(f"j{k}", kind, names[k], names[k + 1], axis=X, axis2=Y)
        joints.append(replace(joint, **changes.get(joint.name, {})))
    return JointGraph(tuple(Link(name, massless=False) for name in names[1:-1]), tuple(joints))


def cut_of(graph: JointGraph) -> str:
    joint, = SpanningTree(graph).cut
    return joint.name


@pytest.mark.parametrize(("kinds", "changes", "cut"), [
    (("revolute",) * 4, {}, "j2"),  # the farthest from the world, the later one of two
    (("revolute", "spherical", "universal", "revolute"), {}, "j1"),
    (("revolute", "revolute", "universal", "fixed"), {}, "j2"),
    (("prismatic", "prismatic", "prismatic", "revolute"), {}, "j3"),
    (("revolute",) * 4, {"j2": {"damping": 1.0}}, "j1"),
    (("revolute",) * 4, {"j1": {"lower": -1.0, "upper": 1.0}, "j2": {"stiffness": 1.0}}, "j3"),
    (("revolute",) * 4, {"j0": {"cut": True}}, "j0"),
    (("revolute", "spherical", "revolute"), {"j1": {"damping": 1.0}}, "j1"),
    (("revolute", "distance", "spherical"), {}, "j1"),
    (("revolute", "floating", "spherical"), {}, "j1")])
def test_the_joint_that_is_cut(kinds, changes, cut):
    graph = ring(kinds, **changes)
    assert cut_of(graph) == cut
    assert cut_of(graph) == cut  # and again


def test_what_is_referred_to_stays():
    for needed in itertools.combinations(["j0", "j1", "j2", "j3"], 3):
        graph = ring(("revolute",) * 4)
        free, = {"j0", "j1", "j2", "j3"} - set(needed)
        assert cut_of(JointGraph(graph.links, graph.joints, needed=frozenset(needed))) == free


@pytest.mark.parametrize("needed", ["j0", "j1", "j2", "j3"])
@pytest.mark.parametrize("but", ["j0", "j1", "j2", "j3"])
def test_joints_with_limits_give_way_to_those_that_are_referred_to(needed, but):
    """The one without limits is cut, of all that are limited another than the one needed."""
    limits = {"lower": -1.0, "upper": 1.0}
    graph = ring(("revolute",) * 4, **{f"j{k}": limits for k in range(4) if f"j{k}" != but})
    cut = cut_of(JointGraph(graph.links, graph.joints, needed=frozenset({needed})))
    assert cut != needed and (cut == but or needed == but)


def test_the_order_of_the_file_does_not_change_which_kind_is_cut():
    graph = ring(("revolute", "spherical", "universal", "prismatic"))
    for order in itertools.permutations(graph.joints):
        assert cut_of(JointGraph(graph.links, order)) == "j1"


def test_branches_of_the_tree_are_short():
    """A ring of 101 equal joints is cut in its middle."""
    tree = SpanningTree(ring(("revolute",) * 101))
    depth = {WORLD: 0}
    for joint in tree.joints:
        depth[joint.child] = depth[joint.parent] + 1
    assert max(depth.values()) == 50 and tree.cut[0].name == "j50"


def test_joints_of_loops_are_those_without_which_their_links_stay_joined():
    rng = np.random.default_rng(1)
    for _ in range(60):
        n, m = rng.integers(1, 9), rng.integers(0, 14)
        names = [WORLD, *(f"l{k}" for k in range(n))]
        joints = [GraphJoint(f"j{k}", "revolute", *(names[i] for i in rng.choice(n + 1, 2, False)))
                  for k in range(m)]

        def joined(one, others):
            reached, before = {one}, 0
            while len(reached) > before:
                before = len(reached)
                reached |= {x for j in others if {j.parent, j.child} & reached
                            for x in (j.parent, j.child)}
            return reached

        expected = {j.name for j in joints
                    if j.child in joined(j.parent, [x for x in joints if x is not j])}
        assert in_loops(joints) == expected


def test_every_link_is_reached_once_whatever_the_graph():
    rng = np.random.default_rng(0)
    for _ in range(50):
        n, m = rng.integers(1, 12), rng.integers(0, 25)
        names = [WORLD, *(f"l{k}" for k in range(n))]
        joints = []
        for k in range(m):
            one, two = rng.choice(n + 1, 2, replace=False)
            kind = str(rng.choice(["revolute", "spherical", "fixed", "distance", "prismatic"]))
            joints.append(GraphJoint(f"j{k}", kind, names[one], names[two],
                                     damping=float(rng.integers(2))))
        links = tuple(Link(x, massless=False) for x in names[1:])
        tree = SpanningTree(JointGraph(links, tuple(joints)))
        reached = [*tree.roots, *(joint.child for joint in tree.joints)]
        assert sorted(reached) == sorted(names[1:])
        assert len(tree.joints) + len(tree.cut) == m
        seen = {WORLD, *tree.roots}
        for joint in tree.joints:  # parents first
            assert joint.parent in seen
            seen.add(joint.child)
