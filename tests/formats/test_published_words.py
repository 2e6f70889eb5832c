"""Files as other programs write them: their words for loops, worlds, models and missing parts."""

import math

import numpy as np
import pinocchio as pin
import pytest

import spatial_pin as sp

quiet = pytest.mark.filterwarnings("ignore::spatial_pin.SpatialPinWarning")
Z = np.array([0.0, 0.0, 1.0])


def written(folder, name, text):
    (folder / name).write_text(text, encoding="utf-8")
    return folder / name


def placed(mech, name, **values):
    """Where a link stands when coordinates have these values and all others are zero."""
    q = mech.neutral.copy()
    for coordinate, value in values.items():
        q[mech.coordinate(coordinate).q] = value
    data = mech.model.createData()
    pin.framesForwardKinematics(mech.model, data, q)
    return data.oMf[mech.frame_id(name)].copy()


# ---------------------------------------------------------------- a plane four-bar in URDF

CRANK, COUPLER, ROCKER, GROUND = 0.1, 0.28, 0.24, 0.3
COSINES = ((COUPLER**2 + 0.2**2 - ROCKER**2) / (2 * COUPLER * 0.2),
           (COUPLER**2 - ROCKER**2 - 0.2**2) / (2 * ROCKER * 0.2))
TURNS = np.arccos(COSINES)  # of coupler and rocker, where the crank lies along the ground


def hinge(name, parent, child, x, turn, more="", kind="continuous"):
    return (f'<link name="{child}"/><joint name="{name}" type="{kind}"><parent link="{parent}"/>'
            f'<child link="{child}"/><origin xyz="{x} 0 0" rpy="0 0 {turn!r}"/>'
            f'<axis xyz="0 0 1"/>{more}</joint>')


def chain(*stated, root='<link name="base"/>', base="base", more=""):
    """Two open chains, drawn closed: crank and coupler, and the rocker."""
    return (f'<robot name="bars">{root}{hinge("j1", base, "crank", 0, 0.0, more)}'
            f'{hinge("j2", "crank", "coupler", CRANK, float(TURNS[0]))}'
            f'{hinge("j3", base, "rocker", GROUND, float(TURNS[1]))}{"".join(stated)}</robot>')


def constraint(kind, axes=""):
    return (f'<constraint name="pin" type="{kind}"><parent link="coupler"/>'
            f'<parent_origin xyz="{COUPLER} 0 0"/><child link="rocker"/>'
            f'<child_origin xyz="{ROCKER} 0 0" rpy="0 0 {float(TURNS[0] - TURNS[1])!r}"/>{axes}'
            "</constraint>")


def closes_as_a_four_bar(mech, driver="j1", one="crank", two="rocker"):
    """The tips of coupler and rocker stay together; their distances are those of the bars."""
    assert sp.mobility(mech).dof == 1
    for angle in (0.0, 0.4, 1.3):
        state = sp.assemble(mech, {driver: angle})
        tip = state.placement(one).act(np.array([CRANK, 0.0, 0.0]))
        end = state.placement(two).act(np.array([ROCKER, 0.0, 0.0]))
        assert np.linalg.norm(tip - end) == pytest.approx(COUPLER, abs=1e-10)


AXIS = '<parent_axis xyz="0 0 1"/>'


@pytest.mark.parametrize(("kind", "axes", "found"), [
    ("spherical_joint", "", "spherical"), ("spherical", "", "spherical"),
    ("revolute_joint", AXIS, "revolute"), ("revolute", AXIS, "revolute"),
    ("revolute_joint", '<parent_axis xyz="0 0 2"/><child_axis xyz="0 0 1"/>', "revolute"),
])
def test_a_constraint_of_a_joint_is_that_joint_with_or_without_the_word(kind, axes, found,
                                                                        tmp_path):
    mech = sp.load(written(tmp_path, "m.urdf", chain(constraint(kind, axes))))
    assert [(c.name, c.type) for c in mech.closures] == [("pin", found)]
    closes_as_a_four_bar(mech)


def test_a_constraint_of_a_cut_link_holds_both_frames_together(tmp_path):
    cut = hinge("j4", "rocker", "half", ROCKER, float(TURNS[0] - TURNS[1]))
    stated = ('<constraint name="cut" type="link"><parent link="coupler"/><child link="half"/>'
              f'<parent_origin xyz="{COUPLER} 0 0"/></constraint>')
    mech = sp.load(written(tmp_path, "m.urdf", chain(cut, stated)))
    assert [c.type for c in mech.closures] == ["weld"]
    closes_as_a_four_bar(mech)
    assert "j4" in mech.coordinates


def test_the_axes_of_a_universal_constraint_are_its_two_pins(tmp_path):
    axes = '<parent_axis xyz="0 1 0"/><child_axis xyz="0.6 0 0.8"/>'
    mech = sp.load(written(tmp_path, "m.urdf", chain(constraint("universal_joint", axes))))
    closure, = mech.closures
    np.testing.assert_allclose(closure.geometry.axes1[:, 2], [0.0, 1.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(closure.geometry.axes2[:, 2], [0.6, 0.0, 0.8], atol=1e-15)


def test_a_slide_between_frames_of_one_orientation_takes_the_parents_axis(tmp_path):
    stated = ('<constraint name="rail" type="prismatic_joint"><parent link="base"/>'
              '<parent_axis xyz="0 1 0"/><child link="crank"/></constraint>')
    mech = sp.load(written(tmp_path, "m.urdf", chain(stated)))
    closure, = mech.closures
    assert closure.type == "prismatic"
    for axes in (closure.geometry.axes1, closure.geometry.axes2):
        np.testing.assert_allclose(axes[:, 2], [0.0, 1.0, 0.0], atol=1e-15)


# ---------------------------------------------------------------- Drake's world, missing limits


def test_a_world_that_nothing_defines_is_the_ground(tmp_path):
    path = written(tmp_path, "m.urdf", chain(constraint("revolute", AXIS), root="", base="world"))
    with pytest.warns(sp.SpatialPinWarning, match="link 'world' is not defined: it is the ground"):
        mech = sp.load(path)
    assert mech.links[0] == "world"
    closes_as_a_four_bar(mech)
    np.testing.assert_array_equal(placed(mech, "rocker").translation, [GROUND, 0.0, 0.0])


@quiet
@pytest.mark.parametrize("stated", [
    '<drake:joint name="b" type="ball"><parent link="world"/><child link="arm"/></drake:joint>'
    '<link name="arm"/>',
    '<drake:ball_constraint><drake:ball_constraint_body_A name="coupler"/><drake:'
    f'ball_constraint_p_AP value="{COUPLER} 0 0"/><drake:ball_constraint_body_B name="world"/>'
    '<drake:ball_constraint_p_BQ value="0.252 0.235 0"/></drake:ball_constraint>'])
def test_what_drake_hangs_on_the_world_stands_still(stated, tmp_path):
    mech = sp.load(written(tmp_path, "m.urdf", chain(stated)))
    assert "world" in mech.links and mech.frame_on_joint("base")[0] == 0
    assert any("link 'world' is not defined" in notice for notice in mech.notices)


@quiet
def test_a_world_that_is_defined_or_not_named_changes_nothing(tmp_path):
    named = chain(root='<link name="world"/>', base="world")
    mech = sp.load(written(tmp_path, "m.urdf", named))
    assert mech.links.count("world") == 1 and not mech.notices
    with pytest.raises(sp.MechanismFileError, match="parent link 'wurld' does not exist"):
        sp.load(written(tmp_path, "m.urdf", named.replace('link="world"', 'link="wurld"')))


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
@pytest.mark.parametrize(("limit", "says", "bounds"), [
    ("", "no <limit>, counts as unlimited", (-math.inf, math.inf)),
    ('<limit lower="-1" upper="2"/>',
     "no effort and no velocity in <limit>, counts as unlimited in that", (-1.0, 2.0)),
    ('<limit lower="-1" upper="2" velocity="3"/>',
     "no effort in <limit>, counts as unlimited in that", (-1.0, 2.0))])
def test_a_joint_without_limits_is_unlimited_and_reported(kind, limit, says, bounds, tmp_path):
    text = ('<robot name="m"><link name="base"/>'
            + hinge("j", "base", "a", 0, 0.0, limit, kind) + "</robot>")
    with pytest.warns(sp.SpatialPinWarning, match=f"joint 'j': {says}"):
        mech = sp.load(written(tmp_path, "m.urdf", text))
    assert (mech.model.lowerPositionLimit[0], mech.model.upperPositionLimit[0]) == bounds
    assert mech.model.upperEffortLimit[0] == math.inf
    assert mech.model.upperVelocityLimit[0] == (3.0 if "velocity" in limit else math.inf)
    assert sp.assemble(mech, {"j": min(20.0, bounds[1])}).coordinate("j").value == min(
        20.0, bounds[1])


@quiet
def test_a_loop_of_hinges_without_limits_is_cut(tmp_path):
    loop = hinge("j4", "rocker", "coupler", ROCKER, 0.0, kind="revolute").replace(
        '<link name="coupler"/>', "")
    mech = sp.load(written(tmp_path, "m.urdf", chain(loop)))
    assert len(mech.closures) == 1 and any("no <limit>" in notice for notice in mech.notices)


# ---------------------------------------------------------------- Gazebo's DetachableJoint


def detachable(model="bars", child="half", parent="coupler_tip", name="DetachableJoint"):
    inside = f"<child_model>{model}</child_model>" if model is not None else ""
    return (f'<plugin filename="libgz-sim-detachable-joint-system.so" name="gz::sim::systems::'
            f'{name}"><parent_link>{parent}</parent_link>{inside}<child_link>{child}</child_link>'
            "<detach_topic>/x</detach_topic></plugin>")


HALVES = (f'<link name="coupler_tip"/><joint name="tip" type="fixed"><parent link="coupler"/>'
          f'<child link="coupler_tip"/><origin xyz="{COUPLER} 0 0"/></joint>'
          + hinge("j4", "rocker", "half", ROCKER, 0.3))


@pytest.mark.parametrize("model", ["bars", "__model__", None])
def test_a_detachable_joint_in_a_urdf_welds_two_links_where_they_stand(model, tmp_path):
    text = chain(HALVES, f"<gazebo>{detachable(model)}</gazebo>")
    mech = sp.load(written(tmp_path, "m.urdf", text))
    assert [c.type for c in mech.closures] == ["weld"]
    assert sp.assemble(mech, {"j1": 0.0}).coordinate("j4").value == pytest.approx(0.0, abs=1e-12)
    closes_as_a_four_bar(mech)


def test_a_detachable_joint_that_grips_another_model_is_omitted_and_reported(tmp_path):
    path = written(tmp_path, "m.urdf", chain(HALVES, f"<gazebo>{detachable('box', 'lid')}"
                                                     "</gazebo>"))
    with pytest.warns(sp.SpatialPinWarning, match="takes hold of the model 'box', which is not"):
        assert not sp.load(path).closures


def test_a_detachable_joint_to_a_link_of_the_same_name_elsewhere_is_refused(tmp_path):
    path = written(tmp_path, "m.urdf", chain(HALVES, f"<gazebo>{detachable('box')}</gazebo>"))
    with pytest.raises(sp.MechanismFileError, match=r"link 'half' of the model 'box'.*without="):
        sp.load(path)


@quiet
def test_links_that_are_fixed_to_each_other_are_not_welded_again(tmp_path):
    plugin = detachable(child="coupler", parent="coupler_tip")
    assert not sp.load(written(tmp_path, "m.urdf",
                               chain(HALVES, f"<gazebo>{plugin}</gazebo>"))).closures


# ---------------------------------------------------------------- SDFormat

INERTIA = ("<inertial><mass>1</mass><inertia><ixx>.1</ixx><iyy>.1</iyy><izz>.1</izz></inertia>"
           "</inertial>")


def link(name, pose="", inertial=INERTIA, more=""):
    return f'<link name="{name}"><pose {pose}</pose>{inertial}{more}</link>'


def at(x, y=0.0, turn=0.0, of=""):
    return f"{of}>{x!r} {y!r} 0 0 0 {turn!r}"


def joint(name, parent, child, more="", axis="<xyz>0 0 1</xyz>", kind="revolute"):
    return (f'<joint name="{name}" type="{kind}"><parent>{parent}</parent><child>{child}</child>'
            f"<axis>{axis}</axis>{more}</joint>")


def sdf(*parts, version="1.9", name="bars", drake=' xmlns:drake="http://drake.mit.edu"'):
    return f'<sdf version="{version}"{drake}><model name="{name}">{"".join(parts)}</model></sdf>'


END = (CRANK + COUPLER * math.cos(TURNS[0]), COUPLER * math.sin(TURNS[0]))
BARS = (link("crank", at(0.0)), link("coupler", at(CRANK, 0.0, float(TURNS[0]))),
        link("rocker", at(GROUND, 0.0, float(TURNS[1]))), joint("j1", "world", "crank"),
        joint("j2", "crank", "coupler"), joint("j3", "world", "rocker"))
HALF = (link("half", at(*map(float, END), 0.2)), joint("j4", "rocker", "half"))
TIPS = (f'<frame name="Ccm" attached_to="coupler"><pose>{COUPLER / 2} 0 0 0 0 0</pose></frame>'
        '<frame name="Scm" attached_to="half"><pose relative_to="Ccm"/></frame>')


@quiet
@pytest.mark.parametrize("stated", [
    detachable(parent="coupler"), detachable(None, parent="coupler"),
    detachable("__model__", parent="coupler"),
    TIPS + "<drake:weld_constraint><parent>Ccm</parent><child>Scm</child></drake:weld_constraint>",
])
def test_welds_of_gazebo_and_drake_close_the_loop_of_an_sdf(stated, tmp_path):
    mech = sp.load(written(tmp_path, "m.sdf", sdf(*BARS, *HALF, stated)))
    assert [c.type for c in mech.closures] == ["weld"] and "j4" in mech.coordinates
    closes_as_a_four_bar(mech)


@quiet
def test_drakes_prefix_need_not_be_declared(tmp_path):
    stated = "<drake:weld_constraint><parent>coupler</parent><child>half</child>"
    half = HALF[0].replace("<pose ", '<pose relative_to="coupler" ').replace(
        f">{float(END[0])!r} {float(END[1])!r} 0 0 0 0.2", ">0 0 0 0 0 0")
    text = sdf(*BARS, half, HALF[1].replace("<axis>", f'<pose relative_to="rocker">{ROCKER} 0 0 '
               "0 0 0</pose><axis>"), stated + "</drake:weld_constraint>", drake="")
    mech = sp.load(written(tmp_path, "m.sdf", text))
    closes_as_a_four_bar(mech)


def drakes(kind, more=""):
    return (f"<drake:{kind}><drake:{kind}_body_A>coupler</drake:{kind}_body_A><drake:{kind}_body_B>"
            f"rocker</drake:{kind}_body_B><drake:{kind}_p_AP>{COUPLER} 0 0</drake:{kind}_p_AP>"
            f"<drake:{kind}_p_BQ>{ROCKER} 0 0</drake:{kind}_p_BQ>{more}</drake:{kind}>")


@quiet
def test_a_ball_and_a_distance_of_drake_close_the_loop_of_an_sdf(tmp_path):
    mech = sp.load(written(tmp_path, "m.sdf", sdf(*BARS, drakes("ball_constraint"))))
    assert [c.type for c in mech.closures] == ["spherical"]
    closes_as_a_four_bar(mech)
    key = "distance_constraint"
    rod = drakes(key, f"<drake:{key}_distance>0.02</drake:{key}_distance>")
    mech = sp.load(written(tmp_path, "m.sdf", sdf(*BARS, rod)))
    assert [(c.type, c.geometry.length) for c in mech.closures] == [("distance", 0.02)]
    soft = rod.replace(f"</drake:{key}>", f"<drake:{key}_stiffness>9</drake:{key}_stiffness>"
                                          f"</drake:{key}>")
    with pytest.raises(sp.MechanismFileError, match=r"yields: it is a spring.*without="):
        sp.load(written(tmp_path, "m.sdf", sdf(*BARS, soft)))


@quiet
def test_drakes_mimic_is_a_coupling(tmp_path):
    text = sdf(link("a", ">0 0 0 0 0 0"), link("b", ">1 0 0 0 0 0"), joint("j", "world", "a"),
               joint("k", "a", "b", '<drake:mimic joint="j" multiplier="-2" offset="0.5"/>'))
    mech = sp.load(written(tmp_path, "m.sdf", text))
    coupling, = mech.closures
    assert (coupling.joints, coupling.ratio, coupling.offset) == (("j", "k"), -2.0, 0.5)
    assert sp.assemble(mech, {"j": 0.3}).coordinate("k").value == pytest.approx(-0.1, abs=1e-14)


# ---------------------------------------------------------------- several models, models in models


def world(*models):
    inside = "".join(f'<model name="{name}">{parts}</model>' for name, parts in models)
    return f'<sdf version="1.9"><world name="w">{inside}</world></sdf>'


ONE = link("a", ">0 0 0 0 0 0") + joint("j", "world", "a")


@quiet
def test_one_of_several_models_is_chosen_by_its_name(tmp_path, run):
    two = link("b", ">0 0 1 0 0 0") + joint("k", "world", "b")
    path = written(tmp_path, "w.sdf", world(("one", ONE), ("two", two)))
    with pytest.raises(sp.MechanismFileError, match=r"'one', 'two'; load\(\.\.\., model='one'\)"):
        sp.load(path)
    mech = sp.load(path, model="two")
    assert mech.name == "two" and mech.coordinates == ("k",)
    assert "of 2 models only 'two' is read" in mech.notices
    assert sp.load(path, **mech.loading).coordinates == ("k",)
    with pytest.raises(sp.MechanismFileError, match="no model 'tow'; did you mean 'two'"):
        sp.load(path, model="tow")
    over = written(tmp_path, "over.toml", 'name = "over"\ntree = "w.sdf"\n')
    assert sp.load(over, model="one").coordinates == ("j",)
    assert run("info", path, "--model", "two")[0] == 0
    code, _, told = run("info", path)
    assert code == 1 and "--model 'one'" in told


def test_files_of_one_model_have_none_to_choose(tmp_path):
    path = written(tmp_path, "m.urdf", chain())
    with pytest.raises(sp.MechanismFileError, match="only a file of SDFormat may hold several"):
        sp.load(path, model="bars")
    with pytest.raises(TypeError, match="model is the name of one, not 3"):
        sp.load(path, model=3)
    text = ('<robot name="m" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arg name="model" '
            'default="a"/><link name="$(arg model)"/></robot>')
    assert sp.load(written(tmp_path, "m.urdf.xacro", text), model="b").links == ("b",)


INNER = (link("b", ">0.1 0 0 0 0 0.3") + link("c", ' relative_to="b">0.2 0 0 0 0 0')
         + joint("k", "b", "c", "<pose>0.01 0 0 0 0 0.1</pose>",
                 '<xyz expressed_in="__model__">0 1 0</xyz>'))
FLAT = {  # the same by hand: names, and poses that the inner model's own frame stands for
    'name="': 'name="in::', "<parent>b<": "<parent>in::b<", "<child>c<": "<child>in::c<",
    'relative_to="b"': 'relative_to="in::b"', 'expressed_in="__model__"': 'expressed_in="in"'}


@quiet
@pytest.mark.parametrize("pose", [">0.5 0.2 0 0 0.4 0.7", ' relative_to="a">0.5 0 0.1 0.2 0 0'])
def test_a_nested_model_is_the_model_that_is_written_out(pose, tmp_path):
    flat = INNER
    for old, new in FLAT.items():
        flat = flat.replace(old, new)
    flat = flat.replace("<pose >", '<pose relative_to="in">')
    outer = link("a", ">0.3 0 0 0 0 0.5") + joint("j", "world", "a") + joint("m", "a", "in::b")
    placing = pose if "relative_to" in pose else f' relative_to="__model__"{pose}'
    frame = f'<frame name="in" attached_to="in::b"><pose{placing}</pose></frame>'
    one = sp.load(written(tmp_path, "one.sdf", sdf(outer, f'<model name="in"><pose{pose}</pose>'
                                                   f"{INNER}</model>")))
    two = sp.load(written(tmp_path, "two.sdf", sdf(outer, frame, flat)))
    assert one.coordinates == two.coordinates and set(one.links) == set(two.links)
    for name in one.frame_ids:
        np.testing.assert_allclose(placed(one, name, **{"j": 0.3, "m": -0.4, "in::k": 0.9}),
                                   placed(two, name, **{"j": 0.3, "m": -0.4, "in::k": 0.9}),
                                   atol=1e-15)


@quiet
def test_models_are_nested_to_any_depth_and_placed_by_any_frame(tmp_path):
    deep = ('<model name="in" placement_frame="grip"><pose>1 0 0 0 0 0</pose>'
            f'<frame name="grip" attached_to="b"><pose>0 0 0.5 0 0 0</pose></frame>{link("b")}'
            f'<model name="deep"><pose relative_to="grip">0 2 0 0 0 0</pose>{link("d")}</model>'
            f'{joint("k", "b", "deep::d")}</model>').replace("<pose </pose>", "")
    mech = sp.load(written(tmp_path, "m.sdf", sdf(
        link("a", ">0 0 0 0 0 0"), joint("j", "world", "a"), deep, joint("m", "a", "in::b"))))
    np.testing.assert_allclose(placed(mech, "in::b").translation, [1.0, 0.0, -0.5], atol=1e-15)
    np.testing.assert_allclose(placed(mech, "in::deep::d").translation, [1.0, 2.0, 0.0],
                               atol=1e-15)
    assert set(mech.coordinates) == {"j", "m", "in::k"}
    path = tmp_path / "m.sdf"
    assert sp.load(path, model="bars::in::deep").links[-1] == "d"


@quiet
def test_loops_and_mimics_go_through_nested_models(tmp_path):
    inner = (link("half", at(*map(float, END), 0.2)) + joint("j5", "half", "twin")
             + link("twin", at(*map(float, END))))
    follow = inner.replace("</axis>", '<mimic joint="j4x"/></axis>')
    text = sdf(*BARS, f'<model name="in">{inner}</model>', joint("j4", "rocker", "in::half"),
               detachable("in", "half", "coupler"))
    mech = sp.load(written(tmp_path, "m.sdf", text))
    assert [c.type for c in mech.closures] == ["weld"]
    assert sp.mobility(mech).dof == 2  # and the twin turns on its own
    with pytest.raises(sp.MechanismFileError, match="no joint 'in::j4x'"):
        sp.load(written(tmp_path, "m.sdf", text.replace(inner, follow)))


@pytest.mark.parametrize(("inner", "says"), [
    ('<model name="in"><include><uri>model://x</uri></include></model>', "include"),
    ('<model name="in"/>', "nested model 'in': no <link>"),
    (f"<model>{link('b', '>0 0 0 0 0 0')}</model>", "nested model '' has no name")])
def test_nested_models_that_cannot_be_read_are_refused_by_name(inner, says, tmp_path):
    with pytest.raises(sp.MechanismFileError, match=says):
        sp.load(written(tmp_path, "m.sdf", sdf(ONE, inner)))


# ---------------------------------------------------------------- inertias from shapes

SHAPES = {  # mass of 1 kg/m³, moments of 1 kg
    "<box><size>1 2 3</size></box>": (6.0, [13 / 12, 10 / 12, 5 / 12]),
    "<sphere><radius>2</radius></sphere>": (32 / 3 * math.pi, [1.6] * 3),
    "<cylinder><radius>1</radius><length>2</length></cylinder>":
        (2 * math.pi, [7 / 12, 7 / 12, 0.5]),
    "<ellipsoid><radii>1 2 3</radii></ellipsoid>": (8 * math.pi, [2.6, 2.0, 1.0]),
}


@quiet
@pytest.mark.parametrize("shape", SHAPES)
def test_an_automatic_inertia_is_that_of_the_collision_shapes(shape, tmp_path):
    volume, moments = SHAPES[shape]
    collision = (f'<collision name="c"><pose>0.5 0 0 0 0 0</pose><density>3</density><geometry>'
                 f"{shape}</geometry></collision>")
    text = sdf(link("a", ">0 0 0 0 0 0", '<inertial auto="true"/>', collision),
               joint("j", "world", "a"), version="1.11")
    inertia = sp.load(written(tmp_path, "m.sdf", text)).inertias["a"]
    assert inertia.mass == pytest.approx(3.0 * volume, rel=1e-13)
    np.testing.assert_allclose(inertia.lever, [0.5, 0.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(inertia.inertia / inertia.mass, np.diag(moments), atol=1e-13)


def test_where_shapes_have_no_volume_the_link_moves_and_its_mass_is_reported(tmp_path):
    mesh = '<collision name="c"><geometry><mesh><uri>x.stl</uri></mesh></geometry></collision>'
    text = sdf(link("a", ">0 0 0 0 0 0", '<inertial auto="true"/>', mesh), joint("j", "world", "a"),
               version="1.11")
    with pytest.warns(sp.SpatialPinWarning, match="not weighed: the mass of collision 'c' of link"):
        mech = sp.load(written(tmp_path, "m.sdf", text))
    assert mech.inertias["a"].mass == 0.0
    assert sp.assemble(mech, {"j": 1.0}).placement("a").rotation[0, 1] == pytest.approx(
        -math.sin(1.0))


# ---------------------------------------------------------------- going on without

BUSHING = ("<drake:linear_bushing_rpy><drake:bushing_frameA name='coupler'/><drake:bushing_frameC "
           "name='rocker'/></drake:linear_bushing_rpy>")
ROPE = "<rope name='cord' between='coupler' and='rocker'/>"


def goes_on(path, name, *rest, says="without"):
    """It is refused with the word by which it is read all the same; return what is read."""
    with pytest.raises(sp.MechanismFileError, match=says) as failure:
        sp.load(path)
    assert f"load(..., without=['{name}'])" in str(failure.value)
    with pytest.warns(sp.SpatialPinWarning, match=f"left out by load.*{name}"):
        mech = sp.load(path, without=[name, *rest])
    assert mech.loading["without"] == (name, *rest)
    return mech


@pytest.mark.filterwarnings("always::spatial_pin.SpatialPinWarning")
@pytest.mark.parametrize(("stated", "name"), [(BUSHING, "linear_bushing_rpy"), (ROPE, "cord"),
                                              ("<belt><end>coupler</end><end>rocker</end></belt>",
                                               "belt")])
def test_a_urdf_is_read_without_an_element_that_cannot_be(stated, name, tmp_path, run):
    path = written(tmp_path, "m.urdf", chain(stated))
    assert goes_on(path, name).coordinates == ("j1", "j2", "j3")
    code, _, error = run("info", path)
    assert code == 1 and f"--without '{name}'" in error
    code, _, error = run("info", path, "--without", name)
    assert code == 0 and "left out" in error


@quiet
def test_a_joint_is_omitted_by_its_name_but_no_link_of_that_name(tmp_path):
    text = chain(ROPE, "<link name='cord'/>", hinge("j4", "cord", "tip", 0, 0.0))
    mech = sp.load(written(tmp_path, "m.urdf", text), without=["cord", "j4"])
    assert {"cord", "tip"} <= set(mech.links) and "j4" not in mech.coordinates


def test_names_that_nothing_has_are_refused(tmp_path):
    path = written(tmp_path, "m.urdf", chain())
    with pytest.raises(sp.MechanismFileError, match="no element or joint 'j22'; did you mean 'j2'"):
        sp.load(path, without=["j22"])
    for wrong in ("j2", [3], 3):
        with pytest.raises(TypeError, match="without is a list of names"):
            sp.load(path, without=wrong)


def test_an_sdf_is_read_without_a_plugin_that_joins(tmp_path):
    plugin = '<plugin name="Grasp" filename="libgrasp.so"/>'
    mech = goes_on(written(tmp_path, "m.sdf", sdf(ONE, plugin)), "Grasp", says="joins links")
    assert mech.coordinates == ("j",)


def test_an_mjcf_is_read_without_an_equality_that_has_no_closure(tmp_path):
    pytest.importorskip("mujoco")
    path = written(tmp_path, "m.xml", """<mujoco><worldbody><body name="a"><joint name="j"/>
      <geom size=".1"/><site name="s"/></body><body name="b"><joint name="k"/><geom size=".1"/>
      <site name="t"/></body></worldbody><tendon><spatial name="cord"><site site="s"/>
      <site site="t"/></spatial></tendon><equality><tendon name="taut" tendon1="cord"/>
      <joint name="gear" joint1="j" joint2="k"/></equality></mujoco>""")
    with pytest.warns(sp.SpatialPinWarning, match=r"left out by load.*'taut' \(tendon\)"):
        mech = sp.load(path, without=["taut"])
    assert [c.type for c in mech.closures] == ["coupling"]
    with pytest.raises(sp.MechanismFileError, match="no element or joint 'tout'; did you mean"):
        sp.load(path, without=["tout"])


def test_a_stage_is_read_without_a_joint(tmp_path):
    pytest.importorskip("pxr")
    from folders import DATA

    path = DATA / "usd" / "four_bar.usda"
    with pytest.warns(sp.SpatialPinWarning, match="left out by load.*last_pin"):
        mech = sp.load(path, without=["last_pin"])
    assert not mech.closures


# ---------------------------------------------------------------- xacro


@pytest.mark.parametrize("text", [chain(more='<dynamics damping="${d}"/>'),
                                  chain().replace('xyz="0 0 1"', 'xyz="0 0 ${z}"', 1),
                                  chain().replace('xyz="0 0 1"', 'xyz="0 0 $(arg z)"', 1)])
def test_an_expression_in_a_plain_urdf_hints_at_xacro(text, tmp_path):
    with pytest.raises(sp.MechanismFileError, match=r"xacro's: name the file \.urdf\.xacro"):
        sp.load(written(tmp_path, "m.urdf", text))


def test_a_name_that_holds_an_expression_is_reported(tmp_path):
    text = chain().replace("rocker", "${side}_rocker")
    with pytest.warns(sp.SpatialPinWarning, match=r"\$\{side\} is in it as text"):
        assert "${side}_rocker" in sp.load(written(tmp_path, "m.urdf", text)).links


XACRO = ('<robot name="m" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arg name="{name}" '
         'default="{default}"/><link name="base"/><link name="a"/><joint name="j" '
         'type="continuous"><parent link="base"/><child link="a"/><origin xyz="{use} 0 0"/>'
         '<axis xyz="0 0 1"/></joint></robot>')


@pytest.mark.parametrize("use", ["$(arg reach)", "${2 * $(arg reach)}", "${xacro.arg('reach')}"])
def test_an_empty_xacro_argument_is_named(use, tmp_path):
    path = written(tmp_path, "m.urdf.xacro", XACRO.format(name="reach", default="", use=use))
    with pytest.raises(sp.MechanismFileError, match="empty xacro arguments: reach"):
        sp.load(path)
    assert placed(sp.load(path, reach=0.5), "a").translation[0] in (0.5, 1.0)
    full = written(tmp_path, "f.urdf.xacro", XACRO.format(name="reach", default="1", use=use))
    with pytest.raises(sp.MechanismFileError, match="empty xacro arguments: reach"):
        sp.load(full, reach="")
    bare = written(tmp_path, "b.urdf.xacro", XACRO.format(name="reach", default="", use=use)
                   .replace(' default=""', ""))
    with pytest.raises(sp.MechanismFileError, match="empty xacro arguments: reach"):
        sp.load(bare)


def test_an_error_that_has_nothing_to_do_with_arguments_names_none(tmp_path):
    text = XACRO.format(name="reach", default="1", use="$(arg reach)").replace(
        'parent link="base"', 'parent link="bass"')
    with pytest.raises(sp.MechanismFileError) as failure:
        sp.load(written(tmp_path, "m.urdf.xacro", text))
    assert "empty" not in str(failure.value)
