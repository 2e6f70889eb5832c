"""Distances that are those of two other frames: rows, rates, forces, files, pictures."""

from __future__ import annotations

import mechanisms as known
import numpy as np
import pinocchio as pin
import pytest
from closure_trees import ENDS, tree_between
from derivative_cases import WEIGHT, check
from masses import with_masses
from mechanisms import RAM, between, load, point

import spatial_pin as sp

LINKS = ("trunk", "left", "leaf", "right")
every_place = pytest.mark.parametrize("ends", ENDS, ids=["beside", "within", "across"])


# ---------------------------------------------------------------- motion


def test_jerks_are_the_rates_of_accelerations(tmp_path):
    mechanism = known.arm_on_a_ram(tmp_path)
    start = sp.assemble(mechanism, {"ram": 0.3})
    h, found = 1e-3, []
    for t in (-2 * h, -h, h, 2 * h):  # stroke 0.3 + 0.7 t + 0.4 t² + 0.1 t³
        value, speed, acceleration = 0.3 + 0.7 * t + 0.4 * t**2 + 0.1 * t**3, (
            0.7 + 0.8 * t + 0.3 * t**2), 0.8 + 0.6 * t
        state = sp.assemble(mechanism, {"ram": value}, start)
        state = sp.solve_rates(mechanism, state, {"ram": speed}, {"ram": acceleration})
        found.append(state.coordinate("shoulder").acceleration)
    rate = (found[0] - 8 * found[1] + 8 * found[2] - found[3]) / (12 * h)
    state = sp.solve_rates(mechanism, start, {"ram": 0.7}, {"ram": 0.8})
    jerks = sp.solve_jerks(mechanism, state, {"ram": 0.6})
    assert isinstance(jerks, sp.Jerks)
    assert jerks.coordinate("shoulder") == pytest.approx(rate, rel=1e-8)


def test_scattered_dimensions_are_closed_together(tmp_path):
    """Samples over flat arrays, against every sample assembled by itself."""
    known.arm_on_a_ram(tmp_path)
    text = (tmp_path / "arm_on_a_ram.urdf").read_text(encoding="utf-8")
    text = text.replace('xyz="0.3 0.0 0.1"', 'xyz="${r} 0 0.1"').replace(
        'xyz="0.02 0.03 -0.01"', 'xyz="${w} 0.03 -0.01"')
    head = ('<robot name="ram" xmlns:xacro="http://www.ros.org/wiki/xacro">'
            '<xacro:arg name="r" default="0.3"/><xacro:arg name="w" default="0.02"/>'
            '<xacro:property name="r" value="$(arg r)"/>'
            '<xacro:property name="w" value="$(arg w)"/>')
    text = text.replace('<robot name="arm_on_a_ram">', head)
    assert "${r}" in text and "${w}" in text
    (tmp_path / "ram.urdf.xacro").write_text(text, encoding="utf-8")
    toml = (tmp_path / "arm_on_a_ram.toml").read_text(encoding="utf-8")
    (tmp_path / "ram.toml").write_text(toml.replace("arm_on_a_ram.urdf", "ram.urdf.xacro"))
    mechanism = sp.load(tmp_path / "ram.toml")
    state = sp.assemble(mechanism, {"ram": 0.3})
    scatter = {"r": 1e-3, "w": 2e-3}
    found = sp.tolerance(mechanism, "shoulder", scatter, state, samples=40)
    for k in range(0, 40, 8):
        own = sp.load(tmp_path / "ram.toml", **{n: found.dimensions[n][k] for n in scatter})
        angle = sp.assemble(own, {"ram": 0.3}).coordinate("shoulder").value
        assert found.samples["shoulder"][k] == pytest.approx(angle, abs=1e-12)


def test_where_the_length_is_nothing_branches_cross(tmp_path):
    """The row's derivatives vanish there: the car goes on or back."""
    tree = (known.sliding("car", "ground", "cart") + point("end", "cart")
            + known.sliding("stroke", "ground", "piston", (0, 1.0, 0)) + point("tip", "piston"))
    mechanism = load(tmp_path, "fold", tree + point("foot", "ground") + point(
        "base", "ground", (0, 1.0, 0)), known.driver("ram", "stroke") + between(
            "leg", ("foot", "end"), ("base", "tip")) + known.guess(car=0.5, stroke=0.5))
    for n in (2, 3, 22, 400):
        values = np.linspace(0.5, -0.5, n)
        motion = sp.sweep(mechanism, "ram", values)
        np.testing.assert_allclose(motion.coordinate("car").value, values, atol=1e-12)
        (event,) = motion.events
        assert event.kind == "branch point" and event.value == pytest.approx(0.0, abs=1e-10)
        with pytest.raises(sp.SingularError):
            sp.sweep(mechanism, "ram", values, on_crossing="raise")
    state = sp.assemble(mechanism, {"ram": 0.0})
    with pytest.raises(sp.SingularError):
        sp.solve_rates(mechanism, state, {"ram": 1.0})
    modes = sp.assembly_modes(mechanism, {"ram": 0.3})
    assert [m.coordinate("car").value for m in modes] == pytest.approx([-0.3, 0.3], abs=1e-12)


# ---------------------------------------------------------------- forces


@every_place
def test_reactions_and_their_derivatives(tmp_path, ends):
    """Reactions balance every body's motion in space, derivatives are those of differences."""
    mechanism, rng = tree_between(tmp_path, "universal", ends, 1)
    mechanism = with_masses(mechanism, tmp_path, **dict.fromkeys((*LINKS, "side"), WEIGHT))
    n = mechanism.model.nv
    q = pin.integrate(mechanism.model, mechanism.neutral, rng.uniform(-0.7, 0.7, n))
    state = sp.State(mechanism, q, rng.uniform(-1, 1, n), closure_error=0.0)
    check(mechanism, state, {"to_leaf.first": 0.4}, 3e-3, 1e-10)
    answer = sp.forward_dynamics(mechanism, state, {"to_leaf.first": 0.4})
    work = sp.inverse_dynamics(mechanism, sp.State(
        mechanism, q, state.v, answer.a, closure_error=0.0), [*mechanism.coordinates])
    total = pin.computeTotalMass(mechanism.model)
    data = mechanism.model.createData()
    pin.centerOfMass(mechanism.model, data, q, state.v, answer.a)
    weight = total * (data.acom[0] - mechanism.model.gravity.linear)
    np.testing.assert_allclose(answer.on_ground.linear, -weight, atol=1e-10)
    assert work.efforts


def test_the_force_along_a_ram_is_that_of_the_law_of_cosines(tmp_path):
    """Statics: the work of the ram's effort is that of the arm's weight."""
    mechanism = known.arm_on_a_ram(tmp_path)
    mechanism = with_masses(mechanism, tmp_path, "gravity = [0.0, -9.81, 0.0]\n", arm=WEIGHT)
    state = sp.assemble(mechanism, {"ram": 0.3})
    answer = sp.inverse_dynamics(mechanism, state)
    slope = sp.solve_rates(mechanism, state, {"ram": 1.0})
    lift = 9.81 * WEIGHT[0] * slope.com("arm")[1][1]
    assert answer.efforts["ram"] == pytest.approx(lift, rel=1e-12)
    force, line = answer.reactions["rod"].linear, (
        state.placement("tip").translation - state.placement("anchor").translation)
    np.testing.assert_allclose(np.cross(force, line), 0.0, atol=1e-12)
    length = np.linalg.norm(line)
    u = np.array(RAM["along"])
    e = state.placement("end").translation - state.placement("foot").translation
    push = force @ line / length  # the same along either line, by the same work
    assert push * (e @ u) / length == pytest.approx(answer.efforts["ram"], rel=1e-12)


def test_a_falling_arm_keeps_its_energy(tmp_path):
    mechanism = with_masses(known.arm_on_a_ram(tmp_path), tmp_path,
                            "gravity = [0.0, -9.81, 0.0]\n", arm=WEIGHT, piston=WEIGHT)
    start = sp.assemble(mechanism, {"ram": 0.3})
    motion = sp.simulate(mechanism, start, 0.4, accuracy=sp.Accuracy.named("reference"))
    assert motion.coordinate("ram").value[-1] < 0.2
    assert motion.energy_drift < 1e-11 and motion.closure_error.max() < 1e-13
    moved = sp.sweep(mechanism, "ram", np.linspace(0.2, 0.4, 5), speed=1.0)
    rows = sp.kinetostatics(mechanism, moved)
    alone = sp.inverse_dynamics(mechanism, moved.state(2))
    for name, force in alone.reactions.items():
        np.testing.assert_allclose(rows.reactions[name][2], force.vector, atol=1e-13)


def test_the_transmission_angle_is_that_of_rod_and_arm(tmp_path):
    mechanism = known.arm_on_a_ram(tmp_path)
    state = sp.assemble(mechanism, {"ram": 0.3})
    tip, anchor = (state.placement(n).translation for n in ("tip", "anchor"))
    across = np.cross([0, 0, 1.0], tip)
    sine = abs((tip - anchor) @ across) / np.linalg.norm(tip - anchor) / np.linalg.norm(across)
    found = sp.transmission(mechanism, state, "shoulder", "ram")
    assert found.angle == pytest.approx(np.arcsin(sine), abs=1e-12) and found.at == "rod"


# ---------------------------------------------------------------- files and words


def test_it_is_written_and_read_again(tmp_path, run):
    mechanism = known.arm_on_a_ram(tmp_path)
    toml = mechanism.save(tmp_path / "again")
    again = sp.load(toml)
    (closure,) = again.closures
    assert (closure.frames, closure.between) == (("anchor", "tip"), ("foot", "end"))
    values = np.linspace(0.2, 0.4, 5)
    np.testing.assert_array_equal(*(sp.sweep(m, "ram", values).q for m in (mechanism, again)))
    code, said, _ = run("info", toml)
    assert code == 0 and "anchor - tip, as far as foot - end" in said


@pytest.mark.parametrize(("line", "word"), [
    ('length_between = ["foot", "end"]\nlength = 0.3', "one of the two"),
    ('length_between = ["foot", "ende"]', "did you mean 'end'"),
    ('length_between = ["foot", "heel"]', "at the same place of one body"),
    ('length_between = ["tip", "anchor"]', "its own frames"),
    ('length_between = ["foot"]', "must be a list of two names"),
    ("", "length is missing"),
])
def test_what_cannot_be_is_refused(tmp_path, line, word):
    known.arm_on_a_ram(tmp_path)
    path = tmp_path / "arm_on_a_ram.toml"
    text = path.read_text(encoding="utf-8").replace('length_between = ["foot", "end"]', line)
    path.write_text(text, encoding="utf-8")
    with pytest.raises(sp.MechanismFileError, match=word):
        sp.load(path)
    path.write_text(text.replace('"distance"', '"spherical"'), encoding="utf-8")
    if line:
        with pytest.raises(sp.MechanismFileError, match="is not a key"):
            sp.load(path)


def test_pinocchio_has_no_such_closure(tmp_path):
    with pytest.raises(sp.ClosureTypeError):
        known.arm_on_a_ram(tmp_path).constraint_models()


# ---------------------------------------------------------------- a rod as long as a dimension


GAUGE = """<robot name="gauge" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:arg name="rod" default="0.4"/>
  <xacro:macro name="body" params="name"><link name="${name}"><inertial><mass value="1"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  </xacro:macro>
  <xacro:body name="crank"/><xacro:body name="rocker"/>
  <link name="ground"/><link name="crank_tip"/><link name="rocker_tip"/><link name="gauge"/>
  <joint name="crank" type="continuous">
    <parent link="ground"/><child link="crank"/><axis xyz="0 0 1"/></joint>
  <joint name="crank_at" type="fixed">
    <parent link="crank"/><child link="crank_tip"/><origin xyz="0.1 0 0"/></joint>
  <joint name="rocker" type="continuous"><parent link="ground"/><child link="rocker"/>
    <origin xyz="0.35 0 0"/><axis xyz="0 0 1"/></joint>
  <joint name="rocker_at" type="fixed">
    <parent link="rocker"/><child link="rocker_tip"/><origin xyz="0.3 0 0"/></joint>
  <joint name="gauge_at" type="fixed"><parent link="ground"/><child link="gauge"/>
    <origin xyz="$(arg rod) 0 0"/></joint>
</robot>
"""


def gauged(folder, length, **dimensions):
    """A crank and rocker whose rod is a distance."""
    (folder / "gauge.urdf.xacro").write_text(GAUGE, encoding="utf-8")
    path = folder / "gauge.toml"
    path.write_text(f"""name = "gauge"
tree = "gauge.urdf.xacro"
[[closures]]
name = "rod"
type = "distance"
frames = ["crank_tip", "rocker_tip"]
{length}
[drivers.crank]
joint = "crank"
[guess]
crank = 0.5
rocker = 1.5
""", encoding="utf-8")
    return sp.load(path, **dimensions)


BY_GAUGE = 'length_between = ["ground", "gauge"]'


def test_two_frames_of_one_body_are_a_gauge_whose_length_is_a_dimension(tmp_path):
    values = np.linspace(0.5, 6.8, 60)
    fixed, mechanism = (gauged(tmp_path, x) for x in ("length = 0.4", BY_GAUGE))
    for one, other in zip(*(vars(sp.sweep(m, "crank", values, speed=1.0)).items()
                            for m in (fixed, mechanism)), strict=True):
        if one[0] in ("q", "v", "a"):
            np.testing.assert_allclose(other[1], one[1], atol=1e-12)
    state = sp.assemble(mechanism)
    psi = state.coordinate("rocker").value
    tips = [state.placement(n).translation for n in ("crank_tip", "rocker_tip")]
    along = (tips[1] - tips[0]) / 0.4
    across = 0.3 * np.array([-np.sin(psi), np.cos(psi), 0.0])
    found = sp.sensitivity(mechanism, state, "rocker", ["rod"]).derivatives["rod"]
    assert found == pytest.approx(1.0 / (along @ across), rel=1e-12)


def test_a_gauge_is_written_as_a_length_to_mjcf(tmp_path):
    mechanism = gauged(tmp_path, BY_GAUGE)
    again = sp.load(sp.export_mjcf(mechanism, tmp_path / "made.xml", sp.assemble(mechanism)))
    assert again.closures[0].between == ()
    assert again.closures[0].geometry.length == pytest.approx(0.4, abs=1e-15)


# ---------------------------------------------------------------- reduced


@pytest.mark.parametrize("swapped", [False, True])
def test_a_locked_pair_of_frames_is_a_plain_length(tmp_path, swapped):
    """Two rams of a plate on a knee: one locked, the other moves it."""
    rams = [("first", ("ground", "tip"), ("foot_1", "rod_1")),
            ("second", ("anchor", "corner"), ("foot_2", "rod_2"))]
    mech = load(tmp_path, "two_rams", (
        known.turning("hip", "ground", "thigh")
        + known.turning("knee", "thigh", "plate", (0.5, 0, 0))
        + point("tip", "plate", (0.3, 0.1, 0))
        + point("corner", "plate", (0.1, -0.2, 0))
        + point("anchor", "ground", (0.4, -0.6, 0))
        + point("foot_1", "ground", (2, 0, 0)) + point("foot_2", "ground", (3, 0, 0))
        + known.sliding("ram_1", "foot_1", "rod_1", (0, 0, 0), (0, 0, 1))
        + known.sliding("ram_2", "foot_2", "rod_2", (0, 0, 0), (0, 0, 1))
    ), "".join(known.driver(f"leg_{k}", f"ram_{k}")
               + between(name, *((b, a) if swapped else (a, b)))
               for k, (name, a, b) in enumerate(rams, 1))
        + known.guess(hip=0.3, knee=0.4, ram_1=0.7, ram_2=0.8))
    start = sp.assemble(mech, {"leg_1": 0.7, "leg_2": 0.8})
    small = sp.reduce(mech, "plate", lock={"leg_2": 0.8}, guess=start)
    plain, = (c for c in small.closures if not c.between)
    assert plain.name == "second" and plain.geometry.length == pytest.approx(0.8, abs=1e-15)
    values = np.linspace(0.7, 0.65, 6)
    full = sp.sweep(mech, "leg_1", values, guess=start).frame("plate")
    less = sp.sweep(small, "leg_1", values, guess=small.state(start)).frame("plate")
    for one, other in zip(full, less, strict=True):
        assert np.abs(one - other).max() < 1e-12
