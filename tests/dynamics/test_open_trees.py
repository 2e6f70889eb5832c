"""Open trees move as Pinocchio says and cost about as much; what loops carry costs the same."""

import subprocess
import sys
import time

import mechanisms as known
import numpy as np
import pinocchio as pin
import pytest
from masses import heavy
from open_trees import BODY, INERTIA, KINDS, bushy, efforts_of, moving, straight, tree
from recursion import accelerations

import spatial_pin as sp


def falling(kinds, n, shape):
    """A mechanism, its state, efforts by name, and joint forces (nv,): no motor acts on a ball."""
    mech = tree(KINDS[kinds], n, straight if shape == "chain" else bushy(n))
    efforts = efforts_of(mech, np.random.default_rng(3).uniform(-1, 1, mech.model.nv))
    return mech, moving(mech), efforts, np.array([efforts.get(c, 0.0) for c in mech.coordinates])


def off(mech, found, want):
    """The largest error by the largest acceleration, in the scale of each coordinate."""
    scale = mech.velocity_scale
    return np.abs((found - want) / scale).max() / np.abs(want / scale).max()


# Quaternions are of unit length to round-off only: in a chain of 70 balls that counts 1e5 times.
EXACT = [(kinds, n, shape) for n in (3, 24, 70) for kinds in KINDS for shape in ("chain", "tree")
         if (kinds, n, shape) != ("balls", 70, "chain")]


@pytest.mark.parametrize("kinds, n, shape", [
    pytest.param(*case, marks=[pytest.mark.slow] * (case[1] == 70)) for case in EXACT])
def test_accelerations_are_right_and_their_error_is_reported(kinds, n, shape):
    mech, state, efforts, tau = falling(kinds, n, shape)
    found = sp.forward_dynamics(mech, state, efforts)
    error = off(mech, found.a, accelerations(mech.model, state.q, state.v, tau))
    assert error < found.error < 40.0 * error + 5e-15


@pytest.mark.parametrize("shape", ["chain", "tree"])
@pytest.mark.parametrize("kinds, n", [
    pytest.param("hinges", 300, marks=pytest.mark.slow), ("hinges", 70), ("slides and hinges", 70),
    ("screws", 70), ("free", 70), ("balls", 24)])
def test_accelerations_and_reactions_are_those_of_pinocchio(kinds, n, shape):
    mech, state, efforts, tau = falling(kinds, n, shape)
    model, data = mech.model, mech.model.createData()
    found = sp.forward_dynamics(mech, state, efforts)
    assert off(mech, found.a, pin.aba(model, data, state.q, state.v, tau)) < 1e-11
    pin.forwardKinematics(model, data, state.q)
    pin.rnea(model, data, state.q, state.v, found.a)
    for k in range(1, model.njoints):
        at = data.oMi[k].rotation
        whole = np.concatenate([at @ data.f[k].linear, at @ data.f[k].angular])
        force = found.reactions[model.names[k]].vector
        own = slice(model.idx_vs[k], model.idx_vs[k] + model.nvs[k])
        if not tau[own].any() and not model.armature[own].any():
            assert force == pytest.approx(whole, abs=1e-9 * max(1.0, np.abs(whole).max()))


@pytest.mark.parametrize("n", [1, 3, 30, 50])
def test_forces_that_balance_are_distinguished_from_forces_that_nearly_do(n):
    """What is left is round-off of the forces: no solver knows more, none is tried for it."""
    mech = tree(KINDS["hinges"], n, straight)
    state = moving(mech)
    rest = sp.State(mech, state.q, closure_error=0.0)
    efforts = sp.inverse_dynamics(mech, rest).efforts
    balanced = sp.forward_dynamics(mech, rest, efforts)
    assert np.abs(balanced.a).max() < 1e-9
    pushed = efforts | {"j0": efforts["j0"] + 1e-3}
    tau = np.array([pushed[c] for c in mech.coordinates])
    found, zero = sp.forward_dynamics(mech, rest, pushed), np.zeros(n)
    error = off(mech, found.a, accelerations(mech.model, rest.q, zero, tau))
    assert error < found.error < 1e-6
    needs = lambda: sp.forward_dynamics(mech, rest, efforts)  # noqa: E731
    assert best(needs, 5) < 5.0 * best(lambda: sp.forward_dynamics(mech, rest, pushed), 5)


@pytest.mark.parametrize("n", [5, 70])
@pytest.mark.parametrize("kinds", [k for k in KINDS if k not in ("balls", "free")])
def test_efforts_are_those_of_rnea(kinds, n):
    mech = tree(KINDS[kinds], n, bushy(n))
    state = moving(mech)
    want = pin.rnea(mech.model, mech.model.createData(), state.q, state.v, state.a)
    found = sp.inverse_dynamics(mech, state, list(mech.coordinates))
    assert list(found.efforts.values()) == pytest.approx(want, abs=1e-12 * np.abs(want).max())
    assert all(found.unique_efforts.values()) and all(found.determined.values())


@pytest.mark.parametrize("shape", ["chain", "tree"])
@pytest.mark.parametrize("kinds", KINDS)
def test_frames_are_where_pinocchio_has_them_and_move_so(kinds, shape):
    mech = tree(KINDS[kinds], 66, straight if shape == "chain" else bushy(5))
    state, model = moving(mech), mech.model
    data = model.createData()
    pin.forwardKinematics(model, data, state.q, state.v, state.a)
    pin.updateFramePlacements(model, data)
    axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    for name in ("link0", "link40", "j65"):
        frame = mech.frame_id(name)
        assert state.placement(name).homogeneous == pytest.approx(
            data.oMf[frame].homogeneous, abs=1e-13)
        for found, want in (
                (state.velocity(name), pin.getFrameVelocity(model, data, frame, axes)),
                (state.acceleration(name),
                 pin.getFrameClassicalAcceleration(model, data, frame, axes))):
            assert found.vector == pytest.approx(want.vector, rel=1e-11, abs=1e-11)


@pytest.mark.parametrize("n", [6, 70])
def test_an_arm_on_a_base_that_nobody_moves_needs_motors_there(n):
    mech = tree(KINDS["free"][:1] + [pin.JointModelRX()] * n, n, straight)
    state = moving(mech)
    with pytest.raises(sp.SpatialPinError, match=r"without actuator carries load.* j0\.x, j0\.y"):
        sp.inverse_dynamics(mech, state, [f"j{k}" for k in range(1, n)])


def test_masses_and_gravity_are_those_of_now():
    """They may be changed in the model at any time."""
    mech = tree(KINDS["hinges"], 70, straight)
    state = moving(mech)
    sp.forward_dynamics(mech, state), sp.inverse_dynamics(mech, state)
    mech.model.inertias[50] = pin.Inertia(3.0, np.array([0.2, 0.1, 0.0]), np.eye(3) * 0.01)
    mech.model.gravity.linear = np.array([1.0, 2.0, 3.0])
    mech.model.armature = mech.model.armature + 0.01
    data = mech.model.createData()
    want = pin.aba(mech.model, data, state.q, state.v, np.zeros(mech.model.nv))
    assert sp.forward_dynamics(mech, state).a == pytest.approx(want, abs=1e-10 * np.abs(want).max())
    want = pin.rnea(mech.model, data, state.q, state.v, state.a)
    assert list(sp.inverse_dynamics(mech, state).efforts.values()) == pytest.approx(
        want, abs=1e-11 * np.abs(want).max())


# ---------------------------------------------------------------- beside and on loops


def with_limbs(folder, n, below):
    """A four-bar that swings, arms of n hinges on its coupler, its rocker and the ground.

    It hangs on an arm of some hinges itself.
    """
    bodies, tree = [], ""

    def arm(name, base, n):
        nonlocal tree
        for k in range(n):
            axis = [(0, 1, 0), (1, 0, 0), (0, 0.6, 0.8)][k % 3]
            tree += known.turning(f"{name}_{k}", base, f"{name}{k}", (0.1, 0, 0), axis=axis)
            base = f"{name}{k}"
            bodies.append(base)
        return base

    carrier = arm("d", "ground", below)
    tree += known.turning("crank", carrier, "one", axis=(0, 1, 0))
    tree += known.turning("knee", "one", "two", (0.3, 0, 0), axis=(0, 1, 0))
    tree += known.turning("rocker", carrier, "three", (0.5, 0, 0), axis=(0, 1, 0))
    tree += known.point("end", "two", (0.5, 0, 0)) + known.point("tip", "three", (0.4, 0, 0))
    bodies += ["one", "two", "three"]
    for name, base in (("a", "two"), ("b", "three"), ("c", "ground")):
        arm(name, base, n)
    text = known.closure("pin", "revolute", "end", "tip", axis=(0, 1, 0))
    text += "[drivers.crank]\njoint = \"crank\"\n[guess]\ncrank = 1.0\nknee = -0.6\nrocker = 1.6\n"
    return known.load(folder, "limbs", heavy(tree, **dict.fromkeys(bodies, BODY)), text)


def swinging(mech, seed=2):
    rng = np.random.default_rng(seed)
    arms = [c for c in mech.coordinates if "_" in c]
    state = sp.assemble(mech, {"crank": 1.0},
                        guess=dict(zip(arms, rng.uniform(-0.4, 0.4, len(arms)), strict=True))
                        | {"knee": -0.6, "rocker": 1.6})
    state = sp.solve_rates(mech, state, {"crank": 1.5}, hold=arms)
    v = state.v.copy()
    v[[mech.coordinate(c).v for c in arms]] = rng.uniform(-1, 1, len(arms))
    return sp.State(mech, state.q, v, closure_error=state.closure_error)


@pytest.mark.parametrize("n, below", [(3, 0), (30, 0), (0, 6), (2, 6), (12, 30), (0, 100)])
def test_limbs_on_loops_and_arms_below_them_move_as_newton_says(n, below, tmp_path):
    """Forces balance at every joint, and the loops stay closed."""
    mech = with_limbs(tmp_path, n, below)
    state, model = swinging(mech), mech.model
    rng = np.random.default_rng(6)
    tau = rng.uniform(-0.3, 0.3, model.nv)
    found = sp.forward_dynamics(mech, state, efforts_of(mech, tau))
    needed = pin.rnea(model, model.createData(), state.q, state.v, found.a)
    jacobian = sp.closure_jacobian(mech, state.q)
    assert needed - tau == pytest.approx(jacobian.T @ found.multipliers, abs=1e-9)
    h = 1e-5
    later, before = (sp.closure_jacobian(mech, state.q + s * state.v) for s in (h, -h))
    assert jacobian @ found.a == pytest.approx(-(later - before) / (2 * h) @ state.v, abs=1e-6)
    assert found.error < (1e-8 if below > 6 else 1e-9)
    back = sp.inverse_dynamics(mech, found.state, ["crank", *(c for c in mech.coordinates
                                                              if "_" in c)])
    loop = [mech.coordinate(c).v for c in ("crank", "knee", "rocker")]
    free = np.linalg.svd(jacobian[:, loop])[2][-1]
    assert back.efforts["crank"] * free[0] == pytest.approx(tau[loop] @ free, abs=1e-9)
    for name, value in back.efforts.items():
        if name != "crank":
            assert value == pytest.approx(tau[mech.coordinate(name).v], abs=1e-9)


def test_a_limb_without_inertia_is_reported_as_before(tmp_path):
    tree = known.turning("a", "ground", "one", axis=(0, 1, 0))
    tree += known.turning("b", "one", "two", (0.3, 0, 0), axis=(0, 1, 0))
    mech = known.load(tmp_path, "light", heavy(tree, one=BODY), "")
    found = sp.forward_dynamics(mech, sp.assemble(mech, {"a": 0.3}))
    assert found.undetermined == ("b",)
    with pytest.raises(sp.SingularError, match="b has no inertia but a force works on it"):
        sp.forward_dynamics(mech, sp.assemble(mech, {"a": 0.3}), {"b": 1.0})


# ---------------------------------------------------------------- joints in any order


def crossed():
    """A loop of two arms whose joints take turns: not in the order of the branches."""
    model, ends = pin.Model(), [0, 0]
    for k in range(6):
        side = k % 2
        place = pin.SE3(np.eye(3), np.array([0.4 * side, 0.0, 0.0]) if k < 2
                        else np.array([0.3, 0.0, 0.0]))
        ends[side] = model.addJoint(ends[side], pin.JointModelRY(), place, f"j{k}")
        model.appendBodyToJoint(ends[side], INERTIA, pin.SE3.Identity())
    tip = pin.SE3(np.eye(3), np.array([0.3, 0.0, 0.0]))
    return sp.Mechanism.from_model(
        model, [sp.closures.distance(("j4", tip), ("j5", tip), 0.5, "rod")], drivers=["j0"])


def test_joints_in_any_order_have_the_accelerations_that_forces_need():
    """Pinocchio's mass matrix is wrong for them, without a word."""
    mech = crossed()
    state = sp.assemble(mech, {"j0": 0.4}, guess={"j1": -0.4, "j2": 0.5, "j3": -0.2, "j4": 0.1})
    v = np.random.default_rng(4).uniform(-1, 1, 6)
    jacobian = sp.closure_jacobian(mech, state.q)
    v -= np.linalg.pinv(jacobian) @ (jacobian @ v)
    state = sp.State(mech, state.q, v, closure_error=state.closure_error)
    found = sp.forward_dynamics(mech, state)
    needed = pin.rnea(mech.model, mech.model.createData(), state.q, v, found.a)
    assert needed == pytest.approx(jacobian.T @ found.multipliers, abs=1e-10)
    by = sp.dynamics_derivatives(mech, state)
    h, move = 1e-6, np.random.default_rng(5).uniform(-1, 1, 6)
    after, before = (sp.forward_dynamics(mech, sp.State(
        mech, state.q + s * move, v, closure_error=0.0)).a for s in (h, -h))
    assert by.a_by_q @ move == pytest.approx((after - before) / (2 * h), rel=1e-6, abs=1e-4)


# ---------------------------------------------------------------- cost


def best(call, times=30):
    found = []
    for _ in range(times):
        began = time.process_time()
        for _ in range(5):
            call()
        found.append((time.process_time() - began) / 5.0)
    return min(found)


@pytest.mark.slow
@pytest.mark.parametrize("n", [2, 30, 100, 300])
def test_they_cost_about_as_much_as_pinocchio(n):
    mech = tree(KINDS["hinges"], n, straight)
    state, model = moving(mech), mech.model
    data, none = model.createData(), np.zeros(n)
    aba = best(lambda: pin.aba(model, data, state.q, state.v, none))
    rnea = best(lambda: pin.rnea(model, data, state.q, state.v, state.a))
    assert best(lambda: sp.forward_dynamics(mech, state)) < 5.0 * aba + 50e-6
    assert best(lambda: sp.inverse_dynamics(mech, state)) < 5.0 * rnea + 50e-6


@pytest.mark.parametrize("call", [
    lambda mech, state: sp.forward_dynamics(mech, state),
    lambda mech, state: sp.inverse_dynamics(mech, state),
    lambda mech, state: sp.State(mech, state.q, state.v, closure_error=0.0).placement("link99")],
    ids=["forward", "inverse", "placement"])
def test_cost_grows_with_the_number_of_joints(call):
    states = [moving(tree(KINDS["hinges"], n, straight)) for n in (250, 1000)]
    few, many = (best(lambda s=s: call(s.mechanism, s), 10) for s in states)
    assert many < 4.0**1.3 * few


def test_two_thousand_joints_take_little_memory_and_keep_their_digits():
    """A `pin.Data` of them takes 384 GB."""
    script = """
import re, resource, sys, numpy as np, pinocchio as pin, spatial_pin as sp
model, parent = pin.Model(), 0
for k in range(2000):
    place = pin.SE3(np.eye(3), np.array([0.1, 0.0, 0.0]))
    joint = (pin.JointModelRY(), pin.JointModelRX())[k % 2]
    parent = model.addJoint(parent, joint, place, f"j{k}")
    model.appendBodyToJoint(parent, pin.Inertia(1.0, np.array([0.05, 0, 0]), np.eye(3) * 1e-3),
                            pin.SE3.Identity())
mech = sp.Mechanism.from_model(model)
rng = np.random.default_rng(0)
q, v, a = rng.uniform(-0.3, 0.3, (3, 2000))
state = sp.assemble(mech, dict(zip(mech.coordinates, q)))
state = sp.State(mech, state.q, v, a, closure_error=0.0)
efforts = sp.inverse_dynamics(mech, state).efforts
found = sp.forward_dynamics(mech, state, efforts)
state.placement("j1999"), state.acceleration("j1999")
again = sp.inverse_dynamics(mech, found.state).efforts
lost = max(abs(again[name] - x) for name, x in efforts.items())
if sys.platform == "linux":  # where what it was forked from is counted too
    memory = 1e3 * float(re.search(r"VmHWM:\\s+(\\d+)", open("/proc/self/status").read())[1])
else:
    memory = float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
print(lost / max(map(abs, efforts.values())), abs(found.a - a).max() / abs(a).max(), found.error,
      memory)
"""
    words = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True,
                           check=True).stdout.split()
    lost, error, told, memory = map(float, words)
    assert lost < 1e-14 and error < told < 1e-3  # efforts of 1e7 N·m hold the chain up
    assert memory < 1e9


@pytest.mark.delicate
@pytest.mark.parametrize(("kind", "axes"), [("parallel", {"axis": (0.0, 0.6, 0.8)}),
                                            ("spherical", {})])
def test_an_arm_beside_loops_changes_nothing_of_a_link_without_inertia_in_them(kind, axes):
    """Forces do not determine how that link moves: the least accelerations, that close the loop."""
    answers, heavy_one = [], pin.Inertia(1e4, INERTIA.lever, 1e4 * INERTIA.inertia)
    for arms in range(3):
        model = pin.Model()
        for name, joint, inertia in [
                *((f"arm_{k}", pin.JointModelRY(), INERTIA) for k in range(arms)),
                ("moved", pin.JointModelFreeFlyer(), heavy_one),
                ("idle", pin.JointModelSpherical(), pin.Inertia.Zero())]:
            made = model.addJoint(0, joint, pin.SE3.Identity(), name)
            model.appendBodyToJoint(made, inertia, pin.SE3.Identity())
        ends = [(name, pin.SE3.Identity()) for name in ("moved", "idle")]
        mech = sp.Mechanism.from_model(model, [getattr(sp.closures, kind)(*ends, **axes)])
        q, loops = mech.neutral, sp.closure_jacobian(mech, mech.neutral)[:, arms:]
        wanted, v = np.array([0.3, -0.2, 0.5, 0.7, -0.4, 0.6, 0.2, 0.1, -0.3]), np.zeros(arms + 9)
        v[arms:] = wanted - np.linalg.pinv(loops) @ (loops @ wanted)
        found = sp.forward_dynamics(mech, sp.State(mech, q, v))
        opening = [sp.closure_jacobian(mech, pin.integrate(mech.model, q, h * v)) @ v
                   for h in (-1e-4, 1e-4)]
        assert loops @ found.a[arms:] == pytest.approx((opening[0] - opening[1]) / 2e-4, abs=1e-6)
        assert all(name.startswith("idle") for name in found.undetermined) and found.undetermined
        answers.append(found.a[arms:])
    for other in answers[1:]:
        assert other == pytest.approx(answers[0], abs=1e-9)
