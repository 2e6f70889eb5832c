"""Springs by points of their characteristic, cables and bump stops."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import spatial_pin as sp

POINTS = ((-0.1, -3.0), (0.0, 0.0), (0.02, 1.0), (0.1, 9.0))
TREE = """<robot name="r"><link name="ground"/>
<joint name="slide" type="prismatic"><parent link="ground"/><child link="block"/>
<axis xyz="1 0 0"/><limit lower="-5" upper="5" effort="100" velocity="100"/></joint>
<link name="block"><inertial><mass value="2"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>"""


def block(tmp_path, text: str) -> sp.Mechanism:
    """A block of 2 kg on a slide along x, with one spring."""
    (tmp_path / "r.urdf").write_text(TREE)
    (tmp_path / "r.toml").write_text(
        'name = "r"\ntree = "r.urdf"\ngravity = [0.0, 0.0, 0.0]\n'
        f'[drivers.x]\njoint = "slide"\n[[springs]]\nname = "s"\njoint = "slide"\n{text}\n')
    return sp.load(tmp_path / "r.toml")


def test_between_points_the_force_is_on_a_line_and_beyond_them_it_goes_on():
    spring = sp.Spring("s", joint="x", law=POINTS, free_angle=0.5)
    for elongation, force in ((-0.2, -6.0), (-0.05, -1.5), (0.01, 0.5), (0.06, 5.0), (0.2, 19.0)):
        assert spring.force(0.5 + elongation, 0.0) == pytest.approx(force, abs=1e-12)
    assert spring.slopes(0.5 + 0.06, 0.0) == pytest.approx((100.0, 0.0))


@pytest.mark.parametrize("side", [{}, {"tension_only": True}, {"compression_only": True}])
@pytest.mark.parametrize("law", [{"law": POINTS}, {"stiffness": 30.0}])
def test_energy_is_the_integral_of_the_force(side, law):
    spring = sp.Spring("s", joint="x", free_angle=0.3, **law, **side)
    for end in (-0.15, -0.05, 0.01, 0.2):
        x = np.linspace(0.3, 0.3 + end, 20001)
        force = np.array([spring.force(y, 0.0) for y in x])
        assert spring.energy(0.3 + end) == pytest.approx(np.trapezoid(force, x), abs=1e-8)


def test_a_cable_pulls_only_and_a_bump_stop_pushes_only():
    cable = sp.Spring("c", ("a", "b"), stiffness=10.0, damping=1.0, free_length=1.0,
                      tension_only=True)
    assert cable.force(1.2, 0.0) == pytest.approx(2.0) and cable.force(0.8, 5.0) == 0.0
    assert cable.force(1.2, -9.0) == 0.0  # a damper does not make it push
    assert cable.slopes(0.8, 0.0) == cable.slopes(1.2, -9.0) == (0.0, 0.0)
    stop = sp.Spring("s", joint="x", stiffness=10.0, compression_only=True)
    assert stop.force(-0.2, 0.0) == pytest.approx(-2.0) and stop.force(0.2, -5.0) == 0.0


def test_a_file_states_the_points_or_names_a_table_of_two_columns(tmp_path):
    (tmp_path / "gas.csv").write_text("elongation, force\n-0.1, -3\n0, 0\n0.02, 1\n0.1, 9\n")
    written = block(tmp_path, f"law = {{points = {[list(p) for p in POINTS]}}}")
    named = block(tmp_path, 'law = {table = "gas.csv"}\ntension_only = true')
    assert written.springs[0].law == named.springs[0].law == POINTS
    assert named.springs[0].tension_only and not written.springs[0].tension_only


@pytest.mark.parametrize(("text", "words"), [
    ("law = {points = [[0.0, 0.0]]}", "two points"),
    ("law = {points = [[0.0, 0.0], [0.0, 1.0]]}", "rising"),
    ("law = {points = [[0.0, 0.0], [1.0]]}", "two numbers"),
    ("law = {}", "points = "),
    ('law = "gas.csv"', "points = "),
    ('law = {table = "../gas.csv"}', "lies neither"),
    ('law = {table = "none.csv"}', "none.csv"),
    ("law = {points = [[0.0, 0.0], [1.0, 1.0]]}\nstiffness = 2.0", "one of the two"),
    ("tension_only = true\ncompression_only = true", "one of the two"),
    ("tension_only = 1", "true or false"),
])
def test_what_is_no_law_is_refused_by_name(tmp_path, text, words):
    with pytest.raises(sp.MechanismFileError, match=words):
        block(tmp_path, text)


def test_save_writes_laws_and_load_reads_them(tmp_path):
    mechanism = block(tmp_path, f"law = {{points = {[list(p) for p in POINTS]}}}\n"
                                "damping = 0.5\ncompression_only = true\nfree_length = 0.25")
    mechanism.save(tmp_path / "again")
    again = sp.load(next((tmp_path / "again").glob("*.toml")))
    assert again.springs == mechanism.springs


def test_a_block_on_a_law_moves_as_its_equation_says(tmp_path):
    mechanism = block(tmp_path, f"law = {{points = {[list(p) for p in POINTS]}}}\ndamping = 0.5")
    state = sp.State(mechanism, np.array([0.06]), np.array([0.4]))
    force = -(5.0 + 0.5 * 0.4)
    assert sp.forward_dynamics(mechanism, state).a[0] == pytest.approx(force / 2.0)
    assert sp.inverse_dynamics(mechanism, state).efforts["x"] == pytest.approx(-force)
    found = sp.dynamics_derivatives(mechanism, state)
    assert found.a_by_q[0, 0] == pytest.approx(-50.0) and found.a_by_v[0, 0] == pytest.approx(-0.25)
    motion = sp.simulate(mechanism, state, 0.5)
    assert motion.energy_drift < 1e-8


def test_a_ball_bounces_between_stops_without_loss(tmp_path):
    """Free between the stops: half a period of the spring at each, and straight flights between."""
    mechanism = block(tmp_path, "stiffness = 200.0\ncompression_only = true")
    state = sp.State(mechanism, np.array([0.1]), np.array([-1.0]))
    touch, turn = 0.1, np.pi * np.sqrt(2.0 / 200.0)
    motion = sp.simulate(mechanism, state, touch + turn + 0.1,
                         times=[0.0, touch, touch + 0.5 * turn, touch + turn + 0.1],
                         accuracy=sp.Accuracy(time_tolerance=1e-11))
    wanted = [0.1, 0.0, -np.sqrt(2.0 / 200.0), 0.1]
    assert motion.q[:, 0] == pytest.approx(wanted, abs=1e-7)


def test_a_weight_rests_on_a_bump_stop_and_hangs_on_a_cable():
    model = pin.Model()
    slide = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "z")
    model.appendBodyToJoint(slide, pin.Inertia(2.0, np.zeros(3), np.zeros((3, 3))),
                            pin.SE3.Identity())
    model.addFrame(pin.Frame("hook", 0, pin.SE3(np.eye(3), np.array([0.0, 0.0, 1.0])),
                             pin.FrameType.OP_FRAME))
    stop = sp.Spring("stop", joint="z", stiffness=1000.0, compression_only=True)
    cable = sp.Spring("cable", ("hook", "z"), stiffness=500.0, free_length=0.6, tension_only=True)
    weight = 2.0 * 9.81
    for springs, wanted in (((stop,), -weight / 1000.0), ((cable,), 0.4 - weight / 500.0),
                            ((stop, cable), 0.4 - weight / 500.0)):
        mechanism = sp.Mechanism.from_model(model, springs=springs)
        found = sp.equilibrium(mechanism, {"z": 0.3})
        assert found.state.q[0] == pytest.approx(wanted, abs=1e-11) and found.stable
    with pytest.raises(sp.SpatialPinError, match="without end"):
        sp.equilibrium(sp.Mechanism.from_model(model))


def test_mujocos_springs_have_no_law(tmp_path):
    mechanism = block(tmp_path, "stiffness = 2.0\ntension_only = true")
    with pytest.raises(sp.SpatialPinError, match="'s' is a bushing, has a law"):
        sp.export_mjcf(mechanism, tmp_path / "r.xml")


def test_a_slide_that_rests_between_two_bump_stops_exchanges_their_round_off():
    """A stop is as stiff as a spring of its kind, though on the other side it does not act."""
    model = pin.Model()
    model.gravity.linear = np.zeros(3)
    slide = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slide")
    model.appendBodyToJoint(slide, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    model.addJointFrame(slide)
    stops = []
    for sign, name in ((1.0, "right"), (-1.0, "left")):
        wall = pin.SE3(np.eye(3), sign * np.array([0.3, 0.1, 0.0]))
        model.addFrame(pin.Frame(name, 0, 0, wall, pin.FrameType.OP_FRAME))
        stops.append(sp.Spring(name, frames=("slide", name), stiffness=1e6,  # [N/m]
                               free_length=np.hypot(0.3, 0.1), compression_only=True))
    mechanism = sp.Mechanism.from_model(model, springs=stops)
    motion = sp.simulate(mechanism, sp.State(mechanism, np.array([3e-9])), 0.01)
    assert motion.energy_drift < 1e-7


@pytest.mark.parametrize("force", [np.nan, "strong", None, (1.0, 2.0)])
def test_a_law_that_returns_no_force_is_named(tmp_path, force):
    mech = block(tmp_path, "stiffness = 1.0")
    motion, laws = sp.sweep(mech, "x", [0.0, 0.1], speed=1.0), {"s": lambda length, rate: force}
    for solve in (lambda: sp.forward_dynamics(mech, motion, laws=laws).a,
                  lambda: sp.forward_dynamics(mech, motion[0], laws=laws).a,
                  lambda: sp.simulate(mech, motion[0], 0.1, laws=laws)):
        with pytest.raises(ValueError, match=r"force of spring 's' by its law at \("):
            solve()
    with pytest.raises(TypeError, match=r"the law of spring 's' is 3\.0; it must be"):
        sp.forward_dynamics(mech, motion, laws={"s": 3.0})
    with pytest.raises(ValueError, match="slopes of spring 's'"):
        sp.dynamics_derivatives(mech, motion[0], laws={"s": lambda length, rate: 1.0},
                                slopes={"s": lambda length, rate: 0.0})
