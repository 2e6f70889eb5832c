"""Links without inertia whose accelerations nothing determines: the least, told in their terms."""

import numpy as np
import pinocchio as pin
import pytest

import spatial_pin as sp

HEAVY = pin.Inertia(2.0, np.array([0.2, 0.05, -0.1]), np.diag([0.05, 0.06, 0.07]))
TURNS = [np.eye(3), pin.rpy.rpyToMatrix(0.4, -0.7, 1.1), pin.rpy.rpyToMatrix(-2.0, 0.3, 0.9)]
BALL, FREE = pin.JointModelSpherical(), pin.JointModelFreeFlyer()


def at(*xyz, rpy=(0.0, 0.0, 0.0)):
    return pin.SE3(pin.rpy.rpyToMatrix(*rpy), np.array(xyz, float))


class Built:
    """A heavy arm on two hinges, in a world that is turned, and what is hung on it."""

    def __init__(self, turn):
        self.model, self.turn = pin.Model(), turn
        self.model.gravity.linear = turn @ np.array([0.0, 0.0, -9.81])
        world = pin.SE3(turn, np.zeros(3))
        waist = self.model.addJoint(0, pin.JointModelRZ(), world, "waist")
        self.arm = self.add(waist, pin.JointModelRY(), at(0.1, 0, 0.2), "shoulder", HEAVY)
        self.world = world

    def add(self, parent, joint, place, name, inertia=None):
        made = self.model.addJoint(parent, joint, place, name)
        if inertia is not None:
            self.model.appendBodyToJoint(made, inertia, pin.SE3.Identity())
        return made

    def state(self, closures=(), drivers=("waist", "shoulder")):
        mech = sp.Mechanism.from_model(self.model, closures, drivers=drivers)
        placed = sp.assemble(mech, {"waist": 0.3}, guess={"shoulder": -0.4})
        rng = np.random.default_rng(2)
        wanted = rng.uniform(-2, 2, mech.model.nv)
        jacobian = sp.closure_jacobian(mech, placed.q)
        v = wanted - np.linalg.pinv(jacobian) @ (jacobian @ wanted)
        return sp.State(mech, placed.q, v, closure_error=placed.closure_error)


def plate(turn):
    """On a ball at the arm's end: three freedoms."""
    built = Built(turn)
    built.add(built.arm, BALL, at(0.5, 0, 0, rpy=(0.3, 0.2, 0.1)), "ball")
    return built.state()


def cross(turn):
    """On two hinges at the arm's end."""
    built = Built(turn)
    first = built.add(built.arm, pin.JointModelRX(), at(0.5, 0, 0), "first")
    built.add(first, pin.JointModelRY(), at(0, 0.2, 0), "second")
    return built.state()


def flyer(turn):
    """Held by nothing: six freedoms."""
    built = Built(turn)
    built.add(0, FREE, built.world, "free")
    return built.state()


def tied(turn):
    """Tied to the arm by a string: five freedoms of a body."""
    built = Built(turn)
    built.add(0, FREE, built.world * at(1.0, 0.2, 0.4), "free")
    string = sp.closures.distance(("shoulder", at(0.4, 0, 0)), ("free", at(0.1, 0.1, 0)), 0.5,
                                  "string")
    return built.state([string])


def rod(turn, reverse=False):
    """With a ball at the arm and a ball on the ground, which hold the arm back: one freedom."""
    built = Built(turn)
    one, other = ("shoulder", at(0.4, 0, 0)), ("universe", built.world * at(0.3, 0.5, 0.1))
    if reverse:
        built.add(0, BALL, built.world * at(0.3, 0.5, 0.1), "ball")
    else:
        built.add(built.arm, BALL, at(0.4, 0, 0), "ball")
    closure = sp.closures.spherical(("ball", at(0.6, 0, 0)), one if reverse else other, "end")
    return built.state([closure], ["waist"])


def accelerations(state):
    """Of all bodies, seen from the world that is not turned: origins, then angular."""
    found = sp.forward_dynamics(state.mechanism, state)
    return found, [found.state.acceleration(name) for name in list(state.mechanism.model.names)[1:]]


CASES = {"plate": plate, "cross": cross, "flyer": flyer, "tied": tied, "rod": rod}


@pytest.mark.delicate
@pytest.mark.parametrize("name", CASES)
def test_they_do_not_depend_on_the_axes_of_the_world(name):
    wanted = None
    for turn in TURNS:
        _, moved = accelerations(CASES[name](turn))
        seen = np.array([[turn.T @ x.linear, turn.T @ x.angular] for x in moved])
        wanted = seen if wanted is None else wanted
        assert seen == pytest.approx(wanted, abs=1e-8 * np.abs(wanted).max())


@pytest.mark.parametrize("name, link", [("plate", "ball"), ("flyer", "free")])
def test_a_link_that_nothing_turns_does_not_turn_faster(name, link):
    found, moved = accelerations(CASES[name](TURNS[1]))
    at_link = list(found.state.mechanism.model.names).index(link) - 1
    assert moved[at_link].angular == pytest.approx(np.zeros(3), abs=1e-10)
    if link == "free":
        assert moved[at_link].linear == pytest.approx(np.zeros(3), abs=1e-10)


def test_the_spin_of_a_rod_is_the_same_from_whichever_end_it_is_counted():
    angular = [accelerations(rod(TURNS[1], reverse))[1][2].angular for reverse in (False, True)]
    ends = [rod(TURNS[1], reverse) for reverse in (False, True)]
    along = [state.placement("ball").rotation[:, 0] for state in ends]
    assert [x @ a for x, a in zip(angular, along, strict=True)] == pytest.approx([0, 0], abs=1e-9)


@pytest.mark.parametrize("name", CASES)
def test_they_are_the_least_of_their_bodies(name):
    """No other accelerations of what moves no mass, with the same of the rest, are less."""
    state = CASES[name](TURNS[1])
    model, size = state.mechanism.model, state.mechanism.characteristic_length
    found, _ = accelerations(state)
    rng = np.random.default_rng(5)
    jacobian = np.vstack([sp.closure_jacobian(state.mechanism, state.q),
                          np.eye(2, model.nv)])  # the arm goes its way
    free = np.linalg.svd(jacobian)[2][np.linalg.matrix_rank(jacobian, tol=1e-9):]

    def squares(a):
        at_state = sp.State(state.mechanism, state.q, state.v, a, closure_error=0.0)
        moved = [at_state.acceleration(name) for name in list(model.names)[1:]]
        return sum(x.linear @ x.linear / size**2 + x.angular @ x.angular for x in moved)

    least = squares(found.a)
    for _ in range(5):
        away = 0.1 * rng.normal(size=len(free)) @ free
        assert squares(found.a + away) > least - 1e-9 * max(least, 1.0)


@pytest.mark.parametrize("name, moving", [
    ("plate", {"ball.x", "ball.y", "ball.z"}), ("cross", {"first", "second"}),
    ("flyer", {f"free.{x}" for x in ("x", "y", "z", "rx", "ry", "rz")})])
def test_results_name_what_nothing_determines(name, moving):
    found, _ = accelerations(CASES[name](TURNS[0]))
    assert set(found.undetermined) == moving
    assert "nothing determines, the least are given: " + found.undetermined[0] in str(found)


def test_nothing_is_named_where_every_motion_has_inertia():
    mech = sp.load("rssr")
    found = sp.forward_dynamics(mech, sp.assemble(mech, {"crank": 1.0}))
    assert found.undetermined == () and "nothing determines" not in str(found)
