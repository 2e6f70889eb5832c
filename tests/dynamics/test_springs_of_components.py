"""Springs and dampers on single components of ball, planar and floating joints."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from derivative_cases import check

import spatial_pin as sp

BODY = pin.Inertia(2.0, np.array([0.05, 0.02, -0.3]), np.diag([0.05, 0.04, 0.02]))
SPRINGS = (
    sp.Spring("lean", joint="hip.x", stiffness=40.0, damping=0.3, free_angle=0.2),
    sp.Spring("swing", joint="hip.y", law=((-1.0, -30.0), (0.0, 0.0), (0.4, 9.0), (1.0, 40.0))),
    sp.Spring("stop", joint="hip.z", stiffness=25.0, damping=0.1, tension_only=True),
    sp.Spring("lift", joint="box.z", stiffness=500.0, damping=2.0, free_length=-0.05),
    sp.Spring("side", joint="box.x", stiffness=300.0),
    sp.Spring("ahead", joint="box.y", stiffness=200.0),
    sp.Spring("roll", joint="box.rx", stiffness=30.0, damping=0.2),
    sp.Spring("pitch", joint="box.ry", stiffness=20.0),
    sp.Spring("yaw", joint="box.rz", stiffness=10.0, free_angle=0.4))


def leg(springs=SPRINGS, damped=True):
    """A turned foot carries a leg by a ball joint, and a box floats at its end."""
    model = pin.Model()
    foot = model.addJoint(0, pin.JointModelRX(), pin.SE3(pin.rpy.rpyToMatrix(0.2, 0.1, 0.3),
                                                         np.array([0.3, 0.2, 0.1])), "foot")
    hip = model.addJoint(foot, pin.JointModelSpherical(),
                         pin.SE3(pin.rpy.rpyToMatrix(-0.3, 0.2, 0.1), np.array([0.1, 0.0, 0.2])),
                         "hip")
    box = model.addJoint(hip, pin.JointModelFreeFlyer(),
                         pin.SE3(pin.rpy.rpyToMatrix(0.1, -0.2, 0.3), np.array([0.0, 0.1, -0.4])),
                         "box")
    for joint in (foot, hip, box):
        model.appendBodyToJoint(joint, BODY, pin.SE3.Identity())
    own = springs if damped else [
        sp.Spring(s.name, joint=s.joint, stiffness=s.stiffness, free_angle=s.free_angle,
                  free_length=s.free_length) for s in springs if not s.law]
    own = [*own, sp.Spring("ankle", joint="foot", stiffness=60.0)]
    return sp.Mechanism.from_model(model, springs=own, name="leg")


def somewhere(mechanism, seed=3):
    rng = np.random.default_rng(seed)
    model = mechanism.model
    q = pin.integrate(model, mechanism.neutral, 0.3 * rng.normal(size=model.nv))
    return sp.State(mechanism, q, rng.normal(size=model.nv))


def energy(mechanism, state):
    """Kinetic, of weights, and of springs by the coordinates that they are on."""
    model, data = mechanism.model, mechanism.model.createData()
    return (pin.computeKineticEnergy(model, data, state.q, state.v)
            + pin.computePotentialEnergy(model, data, state.q)
            + sum(s.energy(state.coordinate(s.joint).value) for s in mechanism.springs))


def test_its_force_is_the_slope_of_its_energy_and_its_damper_takes_the_rate():
    mechanism = leg()
    model, moving = mechanism.model, somewhere(mechanism)
    still = sp.State(mechanism, moving.q)
    mass = pin.crba(model, model.createData(), still.q)
    mass = np.triu(mass) + np.triu(mass, 1).T
    force = mass @ sp.forward_dynamics(mechanism, still).a
    for k, unit in enumerate(np.eye(model.nv)):
        def at(h, unit=unit):
            return energy(mechanism, sp.State(mechanism, pin.integrate(model, still.q, h * unit)))
        slope = (8.0 * (at(1e-3) - at(-1e-3)) - (at(2e-3) - at(-2e-3))) / 12e-3
        assert force[k] == pytest.approx(-slope, abs=1e-8)
    bias = pin.nonLinearEffects(model, model.createData(), moving.q, moving.v) - (
        pin.nonLinearEffects(model, model.createData(), moving.q, 0.0 * moving.v))
    taken = moving.v @ (mass @ sp.forward_dynamics(mechanism, moving).a + bias - force)
    rates = {s.name: moving.coordinate(s.joint).rate for s in mechanism.springs}
    acts = moving.coordinate("hip.z").value > 0.0
    wanted = -sum(s.damping * rates[s.name] ** 2 for s in mechanism.springs
                  if s.name != "stop" or acts)
    assert taken == pytest.approx(wanted, rel=1e-11)


def test_derivatives_of_accelerations_and_reactions_are_differences():
    mechanism = leg()
    check(mechanism, somewhere(mechanism), {"foot": 0.4}, 3e-3, 1e-10,
          laws={"swing": lambda x, rate: 30.0 * x**3 + 2.0 * np.sin(rate) * x})


def test_energy_is_kept_where_nothing_damps():
    mechanism = leg(damped=False)
    motion = sp.simulate(mechanism, somewhere(mechanism), 0.5, times=np.linspace(0.0, 0.5, 6))
    energies = [energy(mechanism, motion.state(k)) for k in range(6)]
    assert np.ptp(energies) < 1e-10 * np.abs(energies).max()
    assert np.ptp(motion.energy) < 1e-10 * np.abs(energies).max()


def test_laws_are_called_in_time_as_at_one_state():
    mechanism = leg()
    start = somewhere(mechanism)
    motion = sp.simulate(mechanism, start, 0.1, times=np.linspace(0.0, 0.1, 4))
    for k in range(4):
        a = sp.forward_dynamics(mechanism, motion.state(k)).a
        assert motion.a[k] == pytest.approx(a, abs=1e-9 * np.abs(a).max())


def test_it_rests_and_rings_by_its_springs():
    mechanism = leg()
    rest = sp.equilibrium(mechanism)
    assert rest.stable
    assert rest.energy == pytest.approx(energy(mechanism, rest.state), rel=1e-12)
    small = sp.linearize(mechanism, rest.state)
    assert np.all(small.frequencies > 0.0)
    held = sp.equilibrium(mechanism, {"hip.x": 0.3}, hold="springs")
    assert held.state.coordinate("hip.x").value == pytest.approx(0.3, abs=1e-12)


def test_of_a_planar_joint_too():
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPlanar(), pin.SE3.Identity(), "puck")
    model.appendBodyToJoint(joint, BODY, pin.SE3.Identity())
    mechanism = sp.Mechanism.from_model(model, springs=[
        sp.Spring(c, joint=f"puck.{c}", stiffness=k) for c, k in (
            ("x", 100.0), ("y", 200.0), ("angle", 3.0))])
    rest = sp.equilibrium(mechanism, {"puck": [0.1, -0.2, 0.4]})
    assert rest.stable
    assert rest.stiffness == pytest.approx(np.diag([100.0, 200.0, 3.0]), abs=1e-9)


TREE = """<robot name="r"><link name="ground"/><link name="body"><inertial><mass value="2"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="float" type="floating"><parent link="ground"/><child link="body"/></joint></robot>"""


def file(tmp_path, text):
    (tmp_path / "r.urdf").write_text(TREE)
    (tmp_path / "r.toml").write_text(
        f'name = "r"\ntree = "r.urdf"\n[[springs]]\nname = "s"\njoint = "float.rz"\n{text}\n')
    return tmp_path / "r.toml"


def test_a_file_states_it_and_save_writes_it(tmp_path):
    mechanism = sp.load(file(tmp_path, "stiffness = 3.0\ndamping = 0.1\nfree_angle = 0.5"))
    mechanism.save(tmp_path / "again")
    again = sp.load(next((tmp_path / "again").glob("*.toml")))
    assert again.springs == mechanism.springs


def test_mujocos_ball_has_no_spring_of_one_component(tmp_path):
    mechanism = sp.load(file(tmp_path, "stiffness = 3.0"))
    with pytest.raises(sp.SpatialPinError, match=r"'s' is on one component of a floating joint"):
        sp.export_mjcf(mechanism, tmp_path / "r.xml")


def test_a_component_that_turns_has_no_free_length(tmp_path):
    with pytest.raises(sp.MechanismFileError, match="free_angle"):
        sp.load(file(tmp_path, "stiffness = 3.0\nfree_length = 0.1"))


def test_matrices_are_in_the_coordinates_of_a_ball_not_in_its_angular_velocity():
    """The stiffness is the second derivative of the energy by the rotation vector."""
    model = pin.Model()
    hip = model.addJoint(0, pin.JointModelSpherical(), pin.SE3.Identity(), "hip")
    model.appendBodyToJoint(hip, BODY, pin.SE3.Identity())
    mechanism = sp.Mechanism.from_model(model, springs=[
        sp.Spring(c, joint=f"hip.{c}", stiffness=20.0, free_angle=free)
        for c, free in zip("xyz", (0.5, -0.8, 0.7), strict=True)])
    rest = sp.equilibrium(mechanism)
    assert rest.coordinates == ("hip.x", "hip.y", "hip.z")
    at = np.array([rest.state.coordinate(c).value for c in rest.coordinates])
    assert np.linalg.norm(at) > 0.7

    def potential(x):
        values = dict(zip(rest.coordinates, x, strict=True))
        return energy(mechanism, sp.assemble(mechanism, values))
    h, units = 1e-3, np.eye(3)
    for j in range(3):
        for k in range(3):
            wanted = sum(a * b * potential(at + h * (a * units[j] + b * units[k]))
                         for a in (1, -1) for b in (1, -1)) / (4.0 * h * h)
            assert rest.stiffness[j, k] == pytest.approx(wanted, abs=1e-5)
    small = sp.linearize(mechanism, rest.state, inputs=["hip.x"], outputs=["hip.y", "hip.z.rate"])
    assert small.stiffness == pytest.approx(rest.stiffness, abs=1e-11)
    response = small.frequency_response([0.0])[0]
    assert response[0, 0] == pytest.approx(np.linalg.inv(small.stiffness)[1, 0], rel=1e-11)
    assert response[1, 0] == 0.0


def test_what_holds_a_component_works_with_its_rate_and_bends_with_it():
    """The energy as a function of the rotation vector and an elbow, one of which is held."""
    model = pin.Model()
    hip = model.addJoint(0, pin.JointModelSpherical(), pin.SE3.Identity(), "hip")
    elbow = model.addJoint(hip, pin.JointModelRY(), pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.3])),
                           "elbow")
    for joint in (hip, elbow):
        model.appendBodyToJoint(joint, BODY, pin.SE3.Identity())
    mechanism = sp.Mechanism.from_model(model, drivers=["hip.x", "elbow"], springs=[
        sp.Spring("twist", joint="hip.z", stiffness=5.0)])
    names = ("hip.x", "hip.y", "hip.z", "elbow")
    for hold in ("hip.x", "hip"):
        held = sp.equilibrium(mechanism, {"hip": [0.2, 0.1, 0.3]}, hold=hold)
        at = np.array([held.state.coordinate(name).value for name in names])

        def potential(x):
            return energy(mechanism, sp.assemble(mechanism, dict(zip(names, x, strict=True))))

        def slope(k, x, potential=potential):
            ends = [potential(x + h * np.eye(4)[k]) for h in (2e-3, 1e-3, -1e-3, -2e-3)]
            return (8.0 * (ends[1] - ends[2]) - (ends[0] - ends[3])) / 12e-3
        assert held.stable and held.stiffness == pytest.approx(held.stiffness.T, abs=1e-11)
        for name, effort in held.efforts.items():
            assert effort == pytest.approx(slope(names.index(name), at), abs=1e-9)
        free = [names.index(name) for name in held.coordinates]
        for j, row in zip(free, held.stiffness, strict=True):
            for k, found in zip(free, row, strict=True):
                way = 1e-3 * np.eye(4)[k]
                wanted = (slope(j, at + way) - slope(j, at - way)) / 2e-3
                assert found == pytest.approx(wanted, abs=1e-4)
