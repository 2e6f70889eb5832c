"""A guess may be written with the dimensions of the tree: it goes with them to any size."""

import pickle

import numpy as np
import pytest

import spatial_pin as sp

NO_LENGTHS = {  # dimensions that do not grow with a mechanism: angles, a pressure, a flow
    "alpha", "beta", "gamma", "tilt", "phase", "alpha1", "alpha2", "alpha3", "alpha4", "beta_1",
    "beta_2", "lug_angle", "pressure", "flow"}
ANGLES_OF_STEWART = {"base", "platform"}

XACRO = """<robot name="m" xmlns:xacro="http://www.ros.org/wiki/xacro">
<xacro:arg name="r" default="0.1"/><xacro:arg name="l" default="${3 * $(arg r)}"/>
<xacro:arg name="side" default="left"/>
<xacro:property name="r" value="$(arg r)"/><xacro:property name="l" value="$(arg l)"/>
<link name="base"/><link name="crank"/><link name="rod"/><link name="slider"/><link name="end"/>
<joint name="crank_pin" type="continuous"><parent link="base"/><child link="crank"/>
  <axis xyz="0 0 1"/></joint>
<joint name="rod_pin" type="continuous"><parent link="crank"/><child link="rod"/>
  <origin xyz="${r} 0 0"/><axis xyz="0 0 1"/></joint>
<joint name="end" type="fixed"><parent link="rod"/><child link="end"/><origin xyz="${l} 0 0"/>
  </joint>
<joint name="slide" type="prismatic"><parent link="base"/><child link="slider"/>
  <axis xyz="1 0 0"/><limit lower="${-9 * l}" upper="${9 * l}" effort="1"
  velocity="1"/></joint></robot>"""
TOML = """name = "m"
tree = "m.urdf.xacro"
[[closures]]
name = "wrist"
type = "revolute"
frames = ["end", "slider"]
[drivers.crank]
joint = "crank_pin"
[guess]
"""


def slider_crank(folder, guess):
    (folder / "m.urdf.xacro").write_text(XACRO)
    (folder / "m.toml").write_text(TOML + guess)
    return folder / "m.toml"


def farthest(found, expected, size):
    """How far a link of one state is from that of another, lengths for that size."""
    unit = size * expected.mechanism.characteristic_length
    return max(float(np.abs(part).max()) for link in expected.mechanism.links
               for a, b in [(found.placement(link), expected.placement(link))]
               for part in ((a.translation - size * b.translation) / unit, a.rotation - b.rotation))


def scaled(name, mech, size):
    fixed = NO_LENGTHS | (ANGLES_OF_STEWART if name == "stewart" else set())
    return sp.load(name, **{key: size * value for key, value in mech.dimensions.items()
                            if key not in fixed})


def stays_on_its_branch(name, sizes):
    mech = sp.load(name)
    nominal = sp.assemble(mech)
    for size in sizes:
        state = sp.assemble(scaled(name, mech, size))
        assert not state.released, size
        assert farthest(state, nominal, size) < 1e-6, size


@pytest.mark.alike
@pytest.mark.delicate
@pytest.mark.parametrize("name", sp.list_mechanisms())
def test_every_library_mechanism_stands_on_the_same_branch_a_hundred_times_as_large(name):
    stays_on_its_branch(name, [100.0])


@pytest.mark.slow
@pytest.mark.delicate
@pytest.mark.parametrize("name", sp.list_mechanisms())
def test_and_at_any_size_between(name):
    stays_on_its_branch(name, [0.01, 0.1, 0.5, 3.0, 10.0])


@pytest.mark.parametrize(("crank", "rod"), [(0.05, 0.16), (0.3, 1.0), (0.02, 5.0), (0.4, 0.5)])
def test_the_slider_crank_has_its_slide_before_the_crank_in_any_proportion(crank, rod):
    state = sp.assemble(sp.load("slider_crank", r=crank, l=rod))
    assert state.coordinate("crank_pin").value == pytest.approx(0.6, abs=1e-12)
    expected = crank * np.cos(0.6) + np.sqrt(rod**2 - (crank * np.sin(0.6))**2)
    assert state.coordinate("slide").value == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(("text", "value"), [
    ("${atan2(r, l)}", np.arctan2(0.2, 0.6)), ("${r} ", 0.2), ("-${r}", -0.2),
    ("$(arg r)", 0.2), ("${2 * $(arg r)}", 0.4), ("${math.pi / 3}", np.pi / 3),
    ("${1.0 if side == 'left' else -1.0}", 1.0), ("${radians(30)}", np.pi / 6),
    ("$(eval 3 * r)", 0.6), ("${l - 3 * r}", 0.0)])
def test_an_expression_in_a_guess_is_read_as_xacro_reads_it(text, value, tmp_path):
    mech = sp.load(slider_crank(tmp_path, f'crank_pin = "{text}"\n'), r=0.2)
    assert mech.guess["crank_pin"] == pytest.approx(value, abs=1e-15)
    assert sp.assemble(mech).coordinate("crank_pin").value == pytest.approx(value, abs=1e-12)


def test_a_list_in_a_guess_may_hold_expressions(tmp_path):
    path = slider_crank(tmp_path, 'slide = ["${r}", 0.5]\n')
    path.write_text(path.read_text().replace("[guess]", '[joints.slide]\n' 'type = "cylindrical"\n'
                                             "axis = [1, 0, 0]\n[guess]"))
    tree = path.with_name("m.urdf.xacro")
    tree.write_text(XACRO.replace('name="slide" type="prismatic"', 'name="slide" type="floating"'))
    assert sp.load(path).guess["slide"] == [0.1, 0.5]
    path.write_text(path.read_text().replace('["${r}", 0.5]', '"${[r, l]}"'))
    assert sp.load(path, l=0.7).guess["slide"] == [0.1, 0.7]


@pytest.mark.parametrize(("text", "says"), [
    ("${atan2(r, q)}", r"guess: crank_pin: .*name 'q' is not defined \(dimensions are: r, l, side"),
    ("${r", "guess: crank_pin: .*a bracket is not closed"),
    ("${sqrt(-r)}", "guess: crank_pin: .*math domain error"),
    ("${side}", r"guess: crank_pin: .* is 'left', no finite number"),
    ("${r > 0}", r"guess: crank_pin: .* is 'True', no finite number"),
    ("${1e308 * 10}", r"guess: crank_pin: .* is 'inf', no finite number"),
    ("${__import__('os')}", "guess: crank_pin: .*__import__ is not offered"),
    ("atan2(r, l)", "guess: 'crank_pin' must be a number"),
])
def test_what_is_no_expression_of_the_dimensions_is_refused_by_name(text, says, tmp_path):
    with pytest.raises(sp.MechanismFileError, match=says) as failure:
        sp.load(slider_crank(tmp_path, f'crank_pin = "{text}"\n'))
    assert "m.toml" in str(failure.value)


def test_several_wrong_expressions_are_reported_with_what_else_is_wrong(tmp_path):
    path = slider_crank(tmp_path, 'crank_pin = "${q}"\n')
    path.write_text(path.read_text().replace('joint = "crank_pin"', 'joint = "krank_pin"'))
    with pytest.raises(sp.MechanismFileError, match="2 mistakes") as failure:
        sp.load(path)
    assert "name 'q'" in str(failure.value) and "krank_pin" in str(failure.value)


def test_expressions_of_a_plain_urdf_know_numbers_only(tmp_path):
    path = slider_crank(tmp_path, 'crank_pin = "${pi / 4}"\n')
    plain = XACRO.replace("${r}", "0.1").replace("${l}", "0.3").replace("${-9 * l}", "-9").replace(
        "${9 * l}", "9")
    lines = [line for line in plain.splitlines() if "xacro" not in line]
    (tmp_path / "m.urdf").write_text('<robot name="m">\n' + "\n".join(lines))
    path.write_text(path.read_text().replace("m.urdf.xacro", "m.urdf"))
    assert sp.load(path).guess["crank_pin"] == pytest.approx(np.pi / 4)
    path.write_text(path.read_text().replace("pi", "r"))
    with pytest.raises(sp.MechanismFileError, match=r"'r' is not defined \(no dimensions\)"):
        sp.load(path)


def test_a_guess_goes_with_dimensions_that_are_varied_and_is_saved_as_numbers(tmp_path):
    path = slider_crank(tmp_path, 'crank_pin = "${atan2(r, l)}"\nslide = "${r + l}"\n')
    mech = sp.load(path)
    sizes = sp.sensitivity(mech, sp.assemble(mech), "slide", ["r", "l"])
    assert sizes is not None
    again = sp.load(mech.save(tmp_path / "out"))
    assert dict(again.guess) == dict(mech.guess) == pytest.approx(
        {"crank_pin": np.arctan2(0.1, 0.3), "slide": 0.4})
    assert pickle.loads(pickle.dumps(mech)).guess == mech.guess


@pytest.mark.delicate
@pytest.mark.parametrize(("crank", "rod"), [(0.05, 0.16), (0.3, 1.0)])
def test_a_slider_crank_of_any_size_has_a_stroke_of_two_cranks(crank, rod):
    motion = sp.sweep(sp.load("slider_crank", r=crank, l=rod), "crank",
                      np.linspace(0.0, np.pi, 13))
    slide = motion.coordinate("slide").value
    assert (slide.min(), slide.max()) == pytest.approx((rod - crank, rod + crank), rel=1e-9)
