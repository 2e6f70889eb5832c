"""Mechanisms as differentiable functions: values as of states, derivatives as of differences."""

import pickle

import numpy as np
import pinocchio as pin
import pytest
from differences import differences, far_off, moving_function
from loaded_library import library
from variety import each

import spatial_pin as sp

FREE_SPINS = "rssr", "rssr_crossed", "swash_plate"  # the coupler's own rotation is not determined


def outputs_of(mech):
    """Return outputs of all kinds, of what the drivers determine."""
    single = [c for c in mech.coordinates if mech.coordinate(c).q >= 0][-3:]
    links = mech.links[1:3]
    kinds = ["position", "velocity", "acceleration", "angular_velocity", "angular_acceleration"]
    if mech.name not in FREE_SPINS:
        kinds.append("rotation")
    heavy = next((x for x in links if x in mech.inertias and mech.inertias[x].mass > 0.0), None)
    return [*single, *(f"{c}.rate" for c in single), *(f"{c}.acceleration" for c in single),
            *(f"{x}.{kind}" for x in links for kind in kinds),
            *((f"{heavy}.com.position", f"{heavy}.com.acceleration", "com.velocity")
              if heavy else ())]


def dimensions_of(mech, n=3):
    """Return dimensions that keep the loops closed."""
    good = []
    for name in mech.dimensions:
        try:
            sp.function(mech, [f"dimension.{name}"], [mech.coordinates[-1]]).jacobian(
                [mech.dimensions[name]])
        except sp.SpatialPinError:
            continue
        good.append(name)
        if len(good) == n:
            break
    return good


@pytest.mark.parametrize("name", each(sp.list_mechanisms()))
def test_derivatives_are_those_of_differences(name):
    mech = library(name)
    outputs = [*outputs_of(mech), *(f"effort.{d}" for d in mech.drivers)]
    f, x, sizes = moving_function(sp, mech, outputs, dimensions_of(mech, 2))
    values, exact = f.value_and_jacobian(x)
    assert far_off(f, exact, differences(f, x, sizes), values, sizes) < 1e-9


@pytest.mark.parametrize("name", each(sp.list_mechanisms()))
def test_accelerations_under_efforts_have_derivatives(name):
    mech = library(name)
    outputs = [f"{c}.acceleration" for c in mech.drivers]
    f, x, sizes = moving_function(sp, mech, outputs, dimensions_of(mech, 1), efforts=True)
    values, exact = f.value_and_jacobian(x)
    assert far_off(f, exact, differences(f, x, sizes), values, sizes) < 1e-8


def forces_of(mech, state):
    """Return the names of powers and of all components of reactions that are unique."""
    unique = sp.inverse_dynamics(mech, state).unique
    return [*(f"{d}.power" for d in mech.drivers), "on_ground", *(
        f"{pair}.reaction.{part}.{axis}" for pair, each in unique.items()
        for k, part in enumerate(("force", "moment")) for i, axis in enumerate("xyz")
        if each[3 * k + i])]


@pytest.mark.parametrize("name", each([
    name for name in sp.list_mechanisms() if name not in ("bricard", "excavator")]))
def test_reactions_and_powers_have_derivatives(name):
    mech = library(name)
    state = sp.solve_rates(mech, sp.assemble(mech), {d: 1.0 for d in mech.drivers})
    for efforts in (False, True):
        f, x, sizes = moving_function(
            sp, mech, forces_of(mech, state)[efforts * len(mech.drivers) :],
            dimensions_of(mech, 1), efforts)
        values, exact = f.value_and_jacobian(x)
        assert far_off(f, exact, differences(f, x, sizes), values, sizes) < 1e-9


def test_reactions_of_drivers_without_an_effort_have_derivatives():
    """The effort of a driver that is no input is zero."""
    mech = library("delta")
    pair = mech.drivers["arm_2"].joint
    f = sp.function(mech, ["arm_1", "arm_1.rate", "effort.arm_1"],
                    [f"{pair}.reaction.force", "arm_2.power", "on_ground.force"])
    x = np.array([f.home.coordinate("arm_1").value, 1.0, 2.0])
    values, exact = f.value_and_jacobian(x)
    assert values[3] == 0.0
    assert far_off(f, exact, differences(f, x, np.ones(3)), values, np.ones(3)) < 1e-9


def test_a_reaction_that_is_one_of_many_has_no_derivative():
    f = sp.function(library("four_bar"), ["crank"], ["output_pin.reaction.force"])
    assert f([1.0]).shape == (3,)
    with pytest.raises(sp.SpatialPinError, match=r"row 0: .*force\.y' is one of many, the least"):
        f.jacobian([1.0])


def test_values_are_those_of_states():
    mech = library("delta")
    f = sp.function(mech, ["arm_1", "arm_2.rate", "arm_3.acceleration"],
                    ["platform.position", "platform.acceleration", "effort.arm_1", "com.position",
                     "platform.rotation", "arm_1.power", "on_ground.force"])
    x = np.array([0.1, 2.0, 3.0])
    state = sp.solve_rates(mech, sp.assemble(mech, {"arm_1": 0.1}, guess=f.home),
                           {"arm_2": 2.0}, {"arm_3": 3.0})
    wanted = [*state.placement("platform").translation, *state.acceleration("platform").linear,
              sp.inverse_dynamics(mech, state).efforts["arm_1"],
              *pin.centerOfMass(mech.model, mech.model.createData(), state.q),
              *state.placement("platform").rotation.ravel(), state.coordinate("arm_1").rate
              * sp.inverse_dynamics(mech, state).efforts["arm_1"],
              *sp.inverse_dynamics(mech, state).on_ground.linear]
    assert f(x) == pytest.approx(wanted, abs=1e-12)
    assert len(f.labels) == len(wanted)


def test_derivatives_for_dimensions_are_those_of_sensitivity():
    mech = library("four_bar")
    state = sp.solve_rates(mech, sp.assemble(mech, {"crank": 1.0}), {"crank": 10.0})
    f = sp.function(mech, ["crank", "crank.velocity", *mech.dimensions], ["crank.effort"])
    slopes = f.jacobian([1.0, 10.0, *mech.dimensions.values()])[0, 2:]
    known = sp.sensitivity(mech, state, "crank.effort").derivatives
    assert slopes == pytest.approx([known[name] for name in mech.dimensions], rel=1e-9)


@pytest.mark.parametrize("name", ["four_bar", "rssr", "excavator"])
def test_angles_of_links_have_derivatives(name):
    mech = library(name)
    f, x, sizes = moving_function(
        sp, mech, [f"{mech.links[-1]}.angle.y", f"{mech.links[1]}.angle.x"], dimensions_of(mech))
    values, exact = f.value_and_jacobian(x)
    assert far_off(f, exact, differences(f, x, sizes), values, sizes) < 1e-9


def test_components_of_balls_have_derivatives():
    mech = library("stewart")
    outputs = ["pose.rx", "pose.rx.rate", "pose.ry.acceleration", "pose.x.acceleration"]
    f, x, sizes = moving_function(sp, mech, outputs)
    x[:6] += 0.02 * np.arange(6) * sizes[:6]
    values, exact = f.value_and_jacobian(x)
    assert far_off(f, exact, differences(f, x, sizes), values, sizes) < 1e-9


def test_other_dimensions_are_on_the_branch_of_the_guess():
    mech, sizes = library("four_bar"), dict(library("four_bar").dimensions)
    for start in (1.2, -1.2):
        guess = sp.assemble(mech, {"crank": 1.0}, guess={"crank_pin": 1.0, "rocker_pin": start})
        f = sp.function(mech, ["crank", "r2"], ["rocker_pin"], guess=guess)
        longer = library("four_bar", r2=sizes["r2"] * 1.1)
        state = sp.assemble(longer, {"crank": 2.0}, guess=guess)
        assert f([2.0, sizes["r2"] * 1.1])[0] == pytest.approx(
            state.coordinate("rocker_pin").value, abs=1e-12)


def test_no_answer_depends_on_earlier_calls_or_other_rows():
    mech = library("rssr")
    f = sp.function(mech, ["crank", "b"], ["rocker_pin", "coupler_b.position"])
    x = np.array([[1.0, 0.381], [5.0, 0.383], [-2.0, 0.381], [1.1, 0.381]])
    together = f(x)
    assert np.array_equal(f(x), together)
    again = pickle.loads(pickle.dumps(f))
    assert np.array_equal(again(x), together)
    assert np.array_equal(again.jacobian(x), f.jacobian(x))
    alone = np.array([f(row) for row in x[::-1]])[::-1]
    assert alone == pytest.approx(together, abs=1e-14)
    assert np.array_equal([f(row) for row in x], alone)


def test_products_with_derivatives():
    f = sp.function(library("four_bar"), ["crank", "r2"], ["rocker_pin", "coupler_b.position"])
    x, rng = np.array([[1.0, 0.1], [2.0, 0.11]]), np.random.default_rng(0)
    y = rng.normal(size=(2, 4))
    assert f.vjp(x, y) == pytest.approx(np.einsum("nk,nkm->nm", y, f.jacobian(x)))
    assert f.vjp(x[0], y[0]).shape == (2,)
    assert f.jacobian(x).shape == (2, 4, 2)
    assert f(np.empty((0, 2))).shape == (0, 4)
    assert f.vjp(np.empty((0, 2)), np.empty((0, 4))).shape == (0, 2)


FILE = """
name = "rod"
tree = "rod.urdf.xacro"
[[closures]]
name = "rod"
type = "distance"
frames = ["a", "b"]
length = "${l}"
[[springs]]
name = "spring"
frames = ["a", "b"]
stiffness = "${100 * m}"
free_length = "${0.5 * l}"
[drivers.lever]
joint = "lever"
[guess]
lever = 0.2
"""
TREE = """
<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="rod">
<xacro:arg name="r" default="0.5"/><xacro:arg name="l" default="1.02"/>
<xacro:arg name="m" default="2.0"/><link name="ground"/><link name="a"/><link name="b"/>
<link name="lever"><inertial><origin xyz="0 0 0.2"/><mass value="$(arg m)"/>
<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
<link name="arm"><inertial><origin xyz="0 0 0.2"/><mass value="1"/>
<inertia ixx="0.05" ixy="0" ixz="0" iyy="0.05" iyz="0" izz="0.05"/></inertial></link>
<joint name="lever" type="continuous"><parent link="ground"/><child link="lever"/>
<axis xyz="0 1 0"/></joint>
<joint name="arm" type="continuous"><parent link="ground"/><child link="arm"/>
<origin xyz="1 0 0"/><axis xyz="0.1 1 0"/></joint>
<joint name="ja" type="fixed"><parent link="lever"/><child link="a"/>
<origin xyz="0 0 $(arg r)"/></joint>
<joint name="jb" type="fixed"><parent link="arm"/><child link="b"/><origin xyz="0 0 0.4"/></joint>
</robot>"""


def test_dimensions_that_the_mechanism_file_computes_with(tmp_path):
    (tmp_path / "rod.toml").write_text(FILE)
    (tmp_path / "rod.urdf.xacro").write_text(TREE)
    mech = sp.load(tmp_path / "rod.toml")
    f, x, sizes = moving_function(
        sp, mech, ["arm", "arm.acceleration", "effort.lever", "rod.reaction.force",
                   "on_ground.moment"], list(mech.dimensions))
    values, exact = f.value_and_jacobian(x)
    assert far_off(f, exact, differences(f, x, sizes), values, sizes) < 1e-9


def test_a_row_that_cannot_be_reached_is_named():
    f = sp.function(library("four_bar", r2=0.25), ["crank", "crank.rate"], ["rocker_pin"])
    with pytest.raises(sp.AssemblyError, match=r"row 1: .*crank"):
        f([[1.0, 0.0], [3.0, 0.0]])
    for bad in (np.nan, np.inf):
        with pytest.raises(ValueError, match="NaN or infinite"):
            f([bad, 0.0])
    with pytest.raises(ValueError, match=r"shape \(3,\).*crank, crank.rate"):
        f([1.0, 2.0, 3.0])


TILTED = """
<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="tilted">
<xacro:arg name="tilt" default="0.0"/><link name="ground"/><link name="crank"/><link name="rod"/>
<link name="rocker"/><link name="a"/><link name="b"/>
<joint name="crank" type="continuous"><parent link="ground"/><child link="crank"/>
<axis xyz="0 1 0"/></joint>
<joint name="rod" type="continuous"><parent link="crank"/><child link="rod"/>
<origin xyz="0 0 0.3" rpy="$(arg tilt) 0 0"/><axis xyz="0 1 0"/></joint>
<joint name="rocker" type="continuous"><parent link="ground"/><child link="rocker"/>
<origin xyz="1 0 0"/><axis xyz="0 1 0"/></joint>
<joint name="ja" type="fixed"><parent link="rod"/><child link="a"/><origin xyz="0 0 0.9"/></joint>
<joint name="jb" type="fixed"><parent link="rocker"/><child link="b"/>
<origin xyz="0 0 0.5"/></joint></robot>"""


def test_what_has_no_derivative_says_so(tmp_path):
    free = sp.function(library("rssr"), ["crank"], ["coupler.rotation"])
    with pytest.raises(sp.SpatialPinError, match=r"row 0: .*'coupler\.rotation\.xx' depends on"):
        free.jacobian([1.0])
    (tmp_path / "tilted.urdf.xacro").write_text(TILTED)
    (tmp_path / "tilted.toml").write_text("""
name = "tilted"
tree = "tilted.urdf.xacro"
closures = [{name = "pin", type = "revolute", frames = ["a", "b"], axis = [0, 1, 0]}]
drivers = {crank = {joint = "crank"}}
guess = {crank = 0.2, rod = 1.2}
""")
    alone = sp.function(sp.load(tmp_path / "tilted.toml"), ["crank", "tilt"], ["rocker"])
    with pytest.raises(sp.SpatialPinError, match="the loops open where 'tilt' alone is changed"):
        alone.jacobian([0.3, 0.0])
    assert np.isfinite(sp.function(alone.mechanism, ["crank"], ["rocker"]).jacobian([0.3])).all()


def test_derivatives_without_a_digit_are_refused():
    """Beside a crank angle where all links are in line, so that branches cross."""
    mech = library("four_bar", r3=0.16)  # r1 + r2 = r3 + r4
    f = sp.function(mech, ["crank", "r3"], ["rocker_pin"], sp.assemble(mech, {"crank": 2.8}))
    x = [[2.8, 0.16], [np.pi - 1e-8, 0.16]]
    assert np.isfinite(f(x)).all() and np.isfinite(f.jacobian(x[:1])).all()
    with pytest.raises(sp.SingularError, match=r"row 1: .*derivatives have no reliable digit") as e:
        f.jacobian(x)
    assert e.value.state.coordinate("crank").value == x[1][0]


@pytest.mark.parametrize(("inputs", "outputs", "kind", "words"), [
    (["crnk"], ["rocker_pin"], sp.UnknownNameError, "no input 'crnk'; did you mean 'crank'"),
    (["crank"], ["rocker"], sp.UnknownNameError, "no differentiable output 'rocker'"),
    (["crank"], ["rocker_p.reaction.force"], sp.UnknownNameError, "no differentiable output"),
    (["crank"], ["effort.rocker_pin"], sp.UnknownNameError, "no differentiable output"),
    (["crank"], ["crank.power"], ValueError, "add 'crank.rate' to the inputs"),
    (["crank"], ["rocker_b.jerk"], sp.UnknownNameError, "no differentiable output"),
    (["crank", "crank_pin"], ["rocker_pin"], ValueError, "'crank_pin' is named twice"),
    (["crank"], ["rocker_pin", "rocker_pin"], ValueError, "'rocker_pin' is named twice"),
    (["crank"], ["rocker_pin.rate"], ValueError, "add 'crank.rate' to the inputs"),
    (["crank", "crank.acceleration", "effort.crank"], ["rocker_pin"], ValueError, "one of the two"),
    (["crank", "crank.effort"], ["crank.effort"], ValueError, "give accelerations instead"),
    ([], ["rocker_pin"], ValueError, "inputs is empty"),
    (["crank"], [], ValueError, "outputs is empty"),
])
def test_wrong_inputs_and_outputs_are_named(inputs, outputs, kind, words):
    with pytest.raises(kind, match=words):
        sp.function(library("four_bar"), inputs, outputs)
