"""Bushings: springs and dampers in six directions between two frames."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import spatial_pin as sp

RNG = np.random.default_rng(11)
ROOT = RNG.normal(size=(6, 6))
FULL = 50.0 * ROOT @ ROOT.T + np.diag([3000.0, 3000.0, 3000.0, 200.0, 200.0, 200.0])
DAMPING = ROOT.T @ ROOT
SIX = (1000.0, 900.0, 800.0, 50.0, 60.0, 70.0)


def turned(size, at):
    return pin.SE3(pin.exp3(size * RNG.normal(size=3)), np.array(at))


FRAMES = {"wall": ("universe", turned(0.2, [0.12, 0.22, 0.29])),
          "back": ("body", turned(0.2, [0.1, 0.2, 0.3])),
          "hand": ("arm", turned(0.2, [0.1, 0.2, 0.1])),
          "rest": ("universe", pin.SE3(np.eye(3), np.array([0.22, 0.2, 0.2])))}


def hung(damping=True) -> sp.Mechanism:
    """A body with an arm, which hangs on two bushings alone."""
    model = pin.Model()
    body = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
    arm = model.addJoint(body, pin.JointModelRY(),
                         pin.SE3(np.eye(3), np.array([0.1, 0.0, 0.1])), "arm")
    for joint, mass in ((body, 3.0), (arm, 1.0)):
        inertia = pin.Inertia(mass, np.array([0.05, 0.02, -0.1]), np.diag([0.03, 0.02, 0.04]))
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    springs = [sp.Spring("full", ("wall", "back"), stiffness=FULL,
                         damping=DAMPING if damping else 0.0, preload=(3, -2, 1, 0.5, 0, -1)),
               sp.Spring("six", ("hand", "rest"), stiffness=SIX)]
    return sp.Mechanism.from_model(model, frames=FRAMES, springs=springs, name="hung")


def somewhere(mechanism):
    rng = np.random.default_rng(3)
    q = pin.integrate(mechanism.model, mechanism.neutral, 0.3 * rng.normal(size=7))
    return sp.State(mechanism, q, rng.normal(size=7))


def energy(mechanism, state):
    """Kinetic, of weights, and of the bushings by their potential, with Pinocchio alone."""
    model, data = mechanism.model, mechanism.model.createData()
    total = pin.computeKineticEnergy(model, data, state.q, state.v) + (
        pin.computePotentialEnergy(model, data, state.q))
    for spring in mechanism.springs:
        between = state.placement(spring.frames[0]).actInv(state.placement(spring.frames[1]))
        x = np.concatenate([between.translation, pin.log3(between.rotation)])
        stiffness = np.array(spring.stiffness)
        stiffness = np.diag(stiffness) if stiffness.ndim == 1 else stiffness
        total += 0.5 * x @ stiffness @ x + np.array(spring.preload or np.zeros(6)) @ x
    return total


def test_its_force_is_the_slope_of_its_potential():
    mechanism = hung(damping=False)
    state = sp.State(mechanism, somewhere(mechanism).q)
    a = sp.forward_dynamics(mechanism, state).a
    mass = pin.crba(mechanism.model, mechanism.model.createData(), state.q)
    force = (np.triu(mass) + np.triu(mass, 1).T) @ a
    for k, unit in enumerate(np.eye(7)):
        def at(h, unit=unit):
            return energy(mechanism, sp.State(mechanism, pin.integrate(
                mechanism.model, state.q, h * unit)))
        slope = (8.0 * (at(1e-3) - at(-1e-3)) - (at(2e-3) - at(-2e-3))) / 12e-3
        assert force[k] == pytest.approx(-slope, abs=1e-7)


def test_derivatives_are_differences_of_forward_dynamics():
    mechanism = hung()
    state = somewhere(mechanism)
    found = sp.dynamics_derivatives(mechanism, state)

    def a(q, v):
        return sp.forward_dynamics(mechanism, sp.State(mechanism, q, v)).a

    for k, unit in enumerate(np.eye(7)):
        def by_q(h, unit=unit):
            ends = [a(pin.integrate(mechanism.model, state.q, s * h * unit), state.v)
                    for s in (1.0, -1.0)]
            return (ends[0] - ends[1]) / (2.0 * h)
        wanted = (4.0 * by_q(5e-4) - by_q(1e-3)) / 3.0
        assert np.abs(found.a_by_q[:, k] - wanted).max() < 1e-9 * np.abs(found.a_by_q).max()
        ends = [a(state.q, state.v + h * unit) for h in (1e-3, -1e-3)]
        wanted = (ends[0] - ends[1]) / 2e-3
        assert np.abs(found.a_by_v[:, k] - wanted).max() < 1e-9 * np.abs(found.a_by_v).max()


def test_energy_is_conserved_where_nothing_damps():
    mechanism = hung(damping=False)
    motion = sp.simulate(mechanism, somewhere(mechanism), 0.2, times=np.linspace(0.0, 0.2, 5))
    energies = [energy(mechanism, motion.state(k)) for k in range(5)]
    assert np.ptp(energies) < 1e-10 * max(energies)
    assert motion.energy_drift < 1e-10


def test_compliance_is_how_much_a_small_force_moves_the_pose_at_rest():
    mechanism = hung()
    rest = sp.equilibrium(mechanism)
    assert rest.stable and len(rest.coordinates) == 7
    found = sp.compliance(mechanism, rest.state, "arm")
    assert np.abs(found - found.T).max() < 1e-13 * np.abs(found).max()
    for k in range(6):
        poses = []
        for h in (1e-2, -1e-2):
            wrench = np.zeros(6)
            wrench[k] = h
            poses.append(sp.equilibrium(mechanism, rest.state, external={
                "arm": pin.Force(wrench)}).state.placement("arm"))
        moved = np.concatenate([poses[0].translation - poses[1].translation,
                                pin.log3(poses[0].rotation @ poses[1].rotation.T)]) / 2e-2
        assert np.abs(found[:, k] - moved).max() < 1e-7 * np.abs(found).max()


@pytest.mark.parametrize("stiffer", [1e4, 1e6])
def test_it_tends_to_the_rigid_joint_as_its_stiffness_grows(stiffer):
    """Two rods hinged by a bushing that is free about the hinge's axis swing as by a hinge."""
    def pendulum(closure, springs):
        model = pin.Model()
        for name in ("upper", "lower"):
            kind = pin.JointModelRY() if name == "upper" else pin.JointModelFreeFlyer()
            joint = model.addJoint(0, kind, pin.SE3.Identity(), name)
            rod = pin.Inertia(1.0, np.array([0.0, 0.0, -0.25]), np.eye(3) * 0.02)
            model.appendBodyToJoint(joint, rod, pin.SE3.Identity())
        frames = {"end": ("upper", pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.5])))}
        return sp.Mechanism.from_model(model, closure, frames=frames, springs=springs,
                                       guess={"lower": [0.0, 0.0, -0.5, 0.0, 0.0, 0.0]})
    hinge = sp.closures.revolute("end", "lower", axis=(0, 1, 0), name="hinge")
    stiff = [stiffer] * 4 + [0.0, stiffer]
    soft = pendulum((), [sp.Spring("hinge", ("end", "lower"), stiffness=stiff)])
    rigid = pendulum((hinge,), ())
    wanted = sp.linearize(rigid, sp.equilibrium(rigid).state).frequencies
    found = sp.linearize(soft, sp.equilibrium(soft).state).frequencies
    assert found[:2] == pytest.approx(wanted, rel=30.0 / stiffer)


TREE = """<robot name="r"><link name="ground"/><link name="body"><inertial><mass value="2"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="float" type="floating"><parent link="ground"/><child link="body"/></joint></robot>"""


def file(tmp_path, text):
    (tmp_path / "r.urdf").write_text(TREE)
    (tmp_path / "r.toml").write_text(
        'name = "r"\ntree = "r.urdf"\n[[springs]]\nname = "mount"\n'
        f'frames = ["ground", "body"]\n{text}\n')
    return tmp_path / "r.toml"


def test_a_file_states_six_numbers_or_six_by_six_and_save_writes_them(tmp_path):
    six = sp.load(file(tmp_path, f"stiffness = {list(SIX)}\ndamping = {[1.0] * 6}"))
    assert six.springs[0].stiffness == SIX and six.springs[0].is_bushing
    text = f"stiffness = {FULL.tolist()}\npreload = [1.0, 0.0, 0.0, 0.0, 0.0, 2.0]"
    for mechanism in (six, sp.load(file(tmp_path, text))):
        mechanism.save(tmp_path / "again")
        again = sp.load(next((tmp_path / "again").glob("*.toml")))
        assert again.springs == mechanism.springs


@pytest.mark.parametrize(("text", "words"), [
    (f"stiffness = {[np.nan, *SIX[1:]]}", "six finite numbers"),
    ("stiffness = [1.0, 2.0]", "six finite numbers"),
    ("stiffness = [1, 1, 1, 1, 1, -1]", "not negative"),
    (f"stiffness = {ROOT.tolist()}", "symmetric"),
    (f"stiffness = {list(SIX)}\nfree_length = 0.1", "free_length is not a key of this table;"),
    (f"stiffness = {list(SIX)}\npreload = [1.0]", "six finite numbers"),
    ('stiffness = [["a"]]', "six finite numbers"),
])
def test_what_is_no_bushing_is_refused_by_name(tmp_path, text, words):
    with pytest.raises(sp.MechanismFileError, match=words):
        sp.load(file(tmp_path, text))


def test_mujocos_springs_have_one_stiffness(tmp_path):
    mechanism = sp.load(file(tmp_path, f"stiffness = {list(SIX)}"))
    with pytest.raises(sp.SpatialPinError, match="'mount' is a bushing"):
        sp.export_mjcf(mechanism, tmp_path / "r.xml")


def test_a_bushing_takes_no_law_of_one_length():
    mechanism = hung()
    with pytest.raises(sp.SpatialPinError, match="bushing"):
        sp.forward_dynamics(mechanism, somewhere(mechanism), laws={"six": lambda x, rate: 0.0})


def test_a_bushing_that_is_wound_beyond_half_a_turn_is_named_where_its_energy_jumps():
    model, stiffness = pin.Model(), np.diag([50.0, 50.0, 50.0, 5.0, 5.0, 5.0])
    model.gravity.linear = np.zeros(3)
    disc = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "disc")
    slide = model.addJoint(disc, pin.JointModelPX(), pin.SE3.Identity(), "slide")
    for joint in (disc, slide):
        model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.eye(3)),
                                pin.SE3.Identity())

    def wound(coupled):
        stiffness[0, 5] = stiffness[5, 0] = coupled
        mechanism = sp.Mechanism.from_model(model, springs=[
            sp.Spring("mount", ("universe", "slide"), stiffness=stiffness)])
        return sp.simulate(mechanism, sp.State(
            mechanism, np.array([0.0, 0.05]), np.array([10.0, 0.0])), 0.6)
    assert wound(0.0).energy_drift < 1e-8
    with pytest.raises(sp.EnergyError, match="'mount' was wound beyond half a turn"):
        wound(8.0)


def test_pages_and_pictures_draw_a_bushing(tmp_path):
    mechanism = sp.load(file(tmp_path, f"stiffness = {list(SIX)}"))
    motion = sp.simulate(mechanism, sp.equilibrium(mechanism).state, 0.01, times=[0.0, 0.01])
    page = sp.export_html(motion, tmp_path / "page.html")
    assert page.stat().st_size > 1000


def test_in_time_it_acts_as_at_one_state_on_bodies_of_any_joint():
    """A chain of all kinds of joints, with a bushing between every two bodies of it."""
    rng, model, joint = np.random.default_rng(5), pin.Model(), 0
    kinds = (pin.JointModelRY(), pin.JointModelPlanar(), pin.JointModelHX(0.1),
             pin.JointModelUniversal(np.eye(3)[0], np.eye(3)[2]), pin.JointModelSpherical(),
             pin.JointModelPX())
    frames, names = {}, ["ground"]
    for kind in kinds:
        joint = model.addJoint(joint, kind, pin.SE3(pin.exp3(rng.normal(size=3)),
                                                    0.3 * rng.normal(size=3)), kind.shortname())
        model.appendBodyToJoint(joint, pin.Inertia(1.0, 0.1 * rng.normal(size=3), 0.05 * np.eye(3)),
                                pin.SE3.Identity())
        names.append(model.names[joint])
    for name in names:
        frames[f"on_{name}"] = ("universe" if name == "ground" else name, pin.SE3(
            pin.exp3(rng.normal(size=3)), 0.2 * rng.normal(size=3)))
    springs = [sp.Spring(f"{a}-{b}", (f"on_{a}", f"on_{b}"), stiffness=FULL, damping=DAMPING)
               for k, a in enumerate(names) for b in names[k + 1 :]]
    mechanism = sp.Mechanism.from_model(model, frames=frames, springs=springs)
    for seed in range(3):
        q = pin.integrate(mechanism.model, mechanism.neutral,
                          np.random.default_rng(seed).normal(size=mechanism.model.nv))
        state = sp.State(mechanism, q, np.ones(mechanism.model.nv))
        a = sp.forward_dynamics(mechanism, state).a
        found = sp.simulate(mechanism, state, 1e-9, times=[0.0, 1e-9]).a[0]
        assert np.abs(found - a).max() < 1e-9 * np.abs(a).max()
