"""Loops that a URDF states in other people's ways: each is the loop of our own mechanism file.

Library mechanisms are written anew, their zero where they are assembled, with the loop in a dialect
instead of in the TOML; every link must then move as in the library's own mechanism.
"""

import xml.etree.ElementTree as ET

import numpy as np
import pinocchio as pin
import pytest
from mechanisms import content_of

import spatial_pin as sp

STEPS = np.linspace(0.0, 0.35, 8)
SAME = 1e-12  # of the characteristic length, or rad


# ---------------------------------------------------------------- mechanisms, written anew


class Opened:
    """A library mechanism whose zero is its assembled configuration, without its loops.

    `loops` holds (name, type, ((link, placement), (link, placement)), axis) of each.
    """

    def __init__(self, name):
        self.own = sp.load(name)
        self.start = sp.assemble(self.own)
        self.content = content_of(self.own)
        robot = ET.fromstring(self.own.urdf)
        model, data = self.own.model, self.own.model.createData()
        pin.forwardKinematics(model, data, self.start.q)
        elements = {e.get("name"): e for e in robot.findall("joint")}
        for i in range(1, model.njoints):
            origin = elements[model.names[i]].find("origin")
            if origin is None:
                origin = ET.SubElement(elements[model.names[i]], "origin")
            # a joint's frame stands on the last moving joint: what is fixed between stays
            between = model.jointPlacements[i].inverse() * data.liMi[i]
            put(origin, taken(origin) * between)
        for link in robot.findall("link"):
            for shape in (*link.findall("visual"), *link.findall("collision")):
                link.remove(shape)
        self.robot = robot
        mounts = {e.find("child").get("link"): e for e in elements.values()
                  if e.get("type") == "fixed"}
        self.loops = []
        for closure in self.own.closures:
            ends = []
            for frame in closure.frames:
                placement = pin.SE3.Identity()
                while frame in mounts:
                    placement = taken(mounts[frame].find("origin")) * placement
                    frame = mounts[frame].find("parent").get("link")
                ends.append((frame, placement))
            axis = closure.geometry.axes1[:, 2]
            self.loops.append((closure.name, closure.type, tuple(ends), axis))

    def write(self, folder, stated, content=True):
        """Write the tree with the text `stated` in it, and a TOML without closures beside it."""
        text = ET.tostring(self.robot, encoding="unicode")
        (folder / "tree.urdf").write_text(text.replace("</robot>", stated + "</robot>"))
        refined = {k: v for k, v in self.content.items() if k in ("joints", "passive", "drivers")}
        lines = ['name = "again"', 'tree = "tree.urdf"']
        for key, tables in refined.items() if content else ():
            for name, table in tables.items():
                lines.append(f"[{key}.{name}]")
                lines += [f"{k} = {v!r}" for k, v in table.items()]
        (folder / "again.toml").write_text("\n".join(lines))
        return folder / "again.toml"

    def check(self, mech):
        """Every link moves as in the library's mechanism."""
        driver = next(iter(self.own.drivers))
        spins = {self.own.frame_on_joint(p.body)[0] for p in self.own.passives}
        begin = self.start.coordinate(driver).value
        for step in STEPS:
            wanted = sp.assemble(self.own, {driver: begin + step}, self.start)
            found = sp.assemble(mech, {driver: step})
            for link in self.own.links:
                a, b = (s.placement(link) for s in (wanted, found))
                assert np.allclose(a.translation, b.translation, rtol=0, atol=SAME), (link, step)
                if self.own.frame_on_joint(link)[0] not in spins:
                    assert np.allclose(a.rotation, b.rotation, rtol=0, atol=SAME), (link, step)


def taken(origin):
    if origin is None:
        return pin.SE3.Identity()
    xyz, rpy = (np.array([float(x) for x in origin.get(key, "0 0 0").split()])
                for key in ("xyz", "rpy"))
    return pin.SE3(pin.rpy.rpyToMatrix(rpy), xyz)


def put(origin, placement):
    xyz, rpy = texts(placement)
    origin.set("xyz", xyz)
    origin.set("rpy", rpy)


def texts(placement):
    return written(placement.translation), written(pin.rpy.matrixToRpy(placement.rotation))


def written(values):
    return " ".join(repr(float(x)) for x in values)


# ---------------------------------------------------------------- the dialects, as writers

KINDS = {"weld": "fixed"}


def urdf_plus(name, kind, ends, axis):
    (a, at_a), (b, at_b) = ((link, "xyz='{}' rpy='{}'".format(*texts(p))) for link, p in ends)
    return (f"<loop name='{name}' type='{KINDS.get(kind, kind)}'>"
            f"<predecessor link='{a}'><origin {at_a}/></predecessor>"
            f"<successor link='{b}'><origin {at_b}/></successor>"
            f"<axis xyz='{written(axis)}'/></loop>")


def isaac(name, kind, ends, axis):
    (a, at_a), (b, at_b) = ((link, "rpy='{1}' xyz='{0}'".format(*texts(p))) for link, p in ends)
    return (f"<loop_joint name='{name}' type='{kind}'><link1 link='{a}' {at_a}/>"
            f"<link2 link='{b}' {at_b}/><axis xyz='{written(axis)}'/></loop_joint>")


def isaac_manual(name, kind, ends, axis):
    return isaac(name, kind, ends, axis).replace("<link2", "<link1")


def ros(name, kind, ends, axis):
    (a, at_a), (b, at_b) = ((link, "xyz='{}' rpy='{}'".format(*texts(p))) for link, p in ends)
    return (f"<constraint name='{name}' type='{kind}'>"
            f"<parent link='{a}'/><parent_origin {at_a}/><parent_axis xyz='{written(axis)}'/>"
            f"<child link='{b}'/><child_origin {at_b}/><child_axis xyz='{written(axis)}'/>"
            "</constraint>")


def gazebo(name, kind, ends, axis):
    (a, _), (b, at) = ends
    pose = " ".join(texts(at))
    kind = {"spherical": "ball", "weld": "fixed"}.get(kind, kind)
    return (f"<gazebo><joint name='{name}' type='{kind}'><parent>{a}</parent><child>{b}</child>"
            f"<pose>{pose}</pose><axis><xyz>{written(axis)}</xyz></axis></joint></gazebo>")


def drake(name, kind, ends, axis):
    (a, at_a), (b, at_b) = ends
    return (f"<drake:ball_constraint xmlns:drake='http://drake.mit.edu' name='{name}'>"
            f"<drake:ball_constraint_body_A name='{a}'/><drake:ball_constraint_body_B name='{b}'/>"
            f"<drake:ball_constraint_p_AP value='{texts(at_a)[0]}'/>"
            f"<drake:ball_constraint_p_BQ value='{texts(at_b)[0]}'/></drake:ball_constraint>")


def drake_undeclared(name, kind, ends, axis):
    return drake(name, kind, ends, axis).replace(" xmlns:drake='http://drake.mit.edu'", "")


def onshape(name, kind, ends, axis):
    made = ""
    turn = pin.SE3(pin.Quaternion.FromTwoVectors(pin.ZAxis, axis).matrix(), np.zeros(3))
    tip = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.1]))
    for side, (link, placement) in enumerate(ends, start=1):
        frames = {"": placement * turn}
        if kind == "revolute":
            frames["_z"] = placement * turn * tip
        for suffix, at in frames.items():
            frame = f"closing_{name}_{side}{suffix}"
            xyz, rpy = texts(at)
            made += (f"<link name='{frame}'/><joint name='{frame}_frame' type='fixed'>"
                     f"<origin xyz='{xyz}' rpy='{rpy}'/><parent link='{link}'/>"
                     f"<child link='{frame}'/></joint>")
    return made


WRITERS = {  # dialect: (writer, the types of loops that it has; None for all)
    "URDF+": (urdf_plus, None), "Isaac": (isaac, None), "Isaac's manual": (isaac_manual, None),
    "ROS": (ros, None), "Gazebo": (gazebo, ("revolute", "spherical", "prismatic")),
    "Drake": (drake, ("spherical",)), "Drake, undeclared": (drake_undeclared, ("spherical",)),
    "onshape": (onshape, ("revolute", "spherical")),
}
MECHANISMS = ("four_bar", "bennett", "spherical_four_bar", "slider_crank", "oldham", "rssr",
              "crank_collar", "swash_plate", "watt_six_bar")


@pytest.mark.alike
@pytest.mark.parametrize("name", MECHANISMS)
def test_a_loop_moves_as_our_own_in_every_dialect_that_can_say_it(name, tmp_path):
    opened = Opened(name)
    kinds = {kind for _, kind, _, _ in opened.loops}
    tried = 0
    for dialect, (write, known) in WRITERS.items():
        if known is None or kinds <= set(known):
            folder = tmp_path / f"{tried}"
            folder.mkdir()
            path = opened.write(folder, "".join(write(*loop) for loop in opened.loops))
            mech = sp.load(path)
            assert len(mech.closures) == len(opened.loops), dialect
            assert {c.type for c in mech.closures} == kinds, dialect
            assert all(c.source for c in mech.closures), dialect
            opened.check(mech)
            tried += 1
    assert tried >= 4


# ---------------------------------------------------------------- whole files

TREE = """<robot name="four"><link name="base"/><link name="a"/><link name="b"/><link name="c"/>
<joint name="j1" type="continuous"><parent link="base"/><child link="a"/>
  <origin rpy="0 {t1} 0"/><axis xyz="0 1 0"/></joint>
<joint name="j2" type="continuous"><origin xyz="0 0 {crank}" rpy="0 {t2} 0"/>
  <parent link="a"/><child link="b"/><axis xyz="0 1 0"/></joint>
<joint name="j3" type="continuous"><origin xyz="{ground} 0 0" rpy="0 {t3} 0"/>
  <parent link="base"/><child link="c"/><axis xyz="0 1 0"/></joint>
"""
Y = np.array([0.0, 1.0, 0.0])
LENGTHS = {"parallelogram": (1.0, 2.0, 1.0, 2.0), "crank-rocker": (0.3, 1.1, 0.8, 1.0),
           "double crank": (1.2, 0.9, 1.1, 0.4)}  # crank, coupler, rocker, ground [m]


def closed_four_bar(crank, coupler, rocker, ground):
    """A plane four-bar that is closed at zero, and its loop: pins along y, links along z or x.

    Angles turn from z towards x.
    """
    t1 = 0.3
    tip = crank * np.array([np.sin(t1), np.cos(t1)])
    way = np.array([ground, 0.0]) - tip
    far = np.hypot(*way)
    to = np.arctan2(-way[1], way[0])  # angle of the x axis of the coupler
    at = np.arccos((coupler**2 + far**2 - rocker**2) / (2.0 * coupler * far))
    turned = to - at
    end = tip + coupler * np.array([np.cos(turned), -np.sin(turned)])
    t3 = np.arctan2(end[0] - ground, end[1])
    text = TREE.format(t1=repr(float(t1)), t2=repr(float(turned - t1)), t3=repr(float(t3)),
                       crank=crank, ground=float(ground))
    ends = (("b", pin.SE3(np.eye(3), np.array([coupler, 0.0, 0.0]))),
            ("c", pin.SE3(np.eye(3), np.array([0.0, 0.0, rocker]))))
    return text, ends, t1, t3


def freudenstein(crank, coupler, rocker, ground, input_angle, output_angle):
    """Freudenstein's equation, zero where the four-bar closes; angles from the ground link."""
    k1, k2 = ground / crank, ground / rocker
    k3 = (crank**2 - coupler**2 + rocker**2 + ground**2) / (2.0 * crank * rocker)
    return (k1 * np.cos(output_angle) - k2 * np.cos(input_angle) + k3
            - np.cos(input_angle - output_angle))


PINS = [(dialect, kind) for dialect, (_, known) in WRITERS.items()
        for kind in ("revolute", "spherical") if known is None or kind in known]


@pytest.mark.parametrize(("dialect", "kind"), PINS)
@pytest.mark.parametrize("lengths", LENGTHS)
def test_a_four_bar_of_any_lengths_obeys_freudenstein_and_has_one_freedom(
        lengths, dialect, kind, tmp_path):
    write, _ = WRITERS[dialect]
    text, ends, t1, t3 = closed_four_bar(*LENGTHS[lengths])
    path = tmp_path / "four.urdf"
    path.write_text(text + write("l", kind, ends, Y) + "</robot>")
    mech = sp.load(path)
    assert [c.type for c in mech.closures] == [kind]
    assert sp.mobility(mech).dof == 1
    state = None
    for q in np.linspace(0.0, 0.6, 7):
        state = sp.assemble(mech, {"j1": q}, state)
        angles = (np.pi / 2 - t1 - state.coordinate("j1").value,
                  np.pi / 2 - t3 - state.coordinate("j3").value)
        assert abs(freudenstein(*LENGTHS[lengths], *angles)) < 1e-12


def four_bar(folder, stated, name="four.urdf"):
    """Write a parallelogram with the text `stated` in it; return the path."""
    text = closed_four_bar(*LENGTHS["parallelogram"])[0]
    (folder / name).write_text(text + stated + "</robot>")
    return folder / name


# ---------------------------------------------------------------- nothing is dropped

JOINS = {  # what is stated: the words of the refusal
    "<tie_rod name='t'><end link='b'/><end link='c'/></tie_rod>": "<tie_rod name='t'>.*'b', 'c'",
    "<rope between='b' and='c'/>": "<rope>: joins the links 'b', 'c'",
    "<belt><pulley>b</pulley><pulley>c</pulley></belt>": "<belt>: joins the links 'b', 'c'",
    "<drake:linear_bushing_rpy><drake:bushing_frameA name='b'/><drake:bushing_frameC name='c'/>"
    "</drake:linear_bushing_rpy>": "<linear_bushing_rpy>: joins",
    "<drake:tendon_constraint><drake:tendon_constraint_joint name='j1' a='1'/>"
    "</drake:tendon_constraint>": "<tendon_constraint>: joins",
    "<gazebo><plugin name='p'><loop_joint name='l' parent='b' child='c'/></plugin></gazebo>":
        "<loop_joint name='l'>: joins the links 'b', 'c'",
    "<gazebo><plugin name='p'><close><link1>b</link1><link2>c</link2></close></plugin></gazebo>":
        "<close>: joins the links 'b', 'c'",
    "<gazebo><joint name='g' type='gearbox'><parent>b</parent><child>c</child></joint></gazebo>":
        "<joint name='g'>: .*'gearbox'",
    "<drake:joint name='r' type='curvilinear'><parent link='b'/><child link='c'/></drake:joint>":
        "<joint name='r'>: .*'curvilinear'",
    "<loop name='l' type='cam'><predecessor link='b'/><successor link='c'/></loop>":
        "<loop name='l'>: a loop of type 'cam'",
    "<loop name='l' type='ball'><predecessor link='b'/><successor link='cc'/></loop>":
        "<loop name='l'>: link 'cc' does not exist; did you mean 'c'",
    "<loop_joint name='l' type='spherical'><link1 link='b'/></loop_joint>":
        "<loop_joint name='l'>: joins 1 links",
    "<link name='d'/><joint name='j4' type='fixed'><parent link='b'/><parent link='c'/>"
    "<child link='d'/></joint>": "<joint name='j4'>: has several <parent>",
    "<link name='closing_x_1'/><joint name='m' type='fixed'><parent link='b'/>"
    "<child link='closing_x_1'/></joint>": "'closing_x_1': there is no 'closing_x_2'",
}


@pytest.mark.parametrize("stated", JOINS)
def test_what_joins_links_and_cannot_be_imported_is_refused_by_its_name(stated, tmp_path):
    with pytest.raises(sp.MechanismFileError, match=JOINS[stated]) as failure:
        sp.load(four_bar(tmp_path, stated))
    assert "four.urdf" in str(failure.value)


def test_what_names_links_without_joining_them_is_unchanged(tmp_path):
    harmless = """
      <sensor name="s"><parent link="a"/><pair first="b" second="c"/></sensor>
      <transmission name="t"><joint name="a"/><actuator name="b"/></transmission>
      <ros2_control name="r" type="system"><joint name="b"/><joint name="c"/></ros2_control>
      <actuated joint1="a" joint2="b"><joint name="c"/></actuated>
      <disable_collisions link1="a" link2="b" reason="Adjacent"/>
      <drake:collision_filter_group name="g"><drake:member link="a"/><drake:member link="b"/>
      </drake:collision_filter_group>
      <material name="grey"><color rgba="1 1 1 1"/></material>
      <gazebo reference="a"><mu1>0.2</mu1></gazebo>
      <gazebo><plugin name="p"><left_joint>j1</left_joint><arm><palm_link>a</palm_link>
        <gripper_link>b</gripper_link><gripper_link>c</gripper_link></arm></plugin></gazebo>"""
    mech = sp.load(four_bar(tmp_path, harmless))
    assert mech.closures == ()


def test_a_gazebo_joint_from_the_world_to_the_base_is_no_loop(tmp_path):
    mech = sp.load(four_bar(tmp_path, "<gazebo><joint name='f' type='fixed'><parent>world</parent>"
                                      "<child>base</child></joint></gazebo>"))
    assert mech.closures == ()


def test_a_gazebo_joint_stands_where_its_pose_says(tmp_path):
    text, ends, _, _ = closed_four_bar(*LENGTHS["crank-rocker"])
    x, y, z = ends[0][1].translation
    poses = {"child": f"<pose degrees='true'>{written(ends[1][1].translation)} 0 90 0</pose>"
                      "<axis><xyz expressed_in='base'>0 1 0</xyz></axis>",
             "parent": f"<pose relative_to='b'>{x} {y} {z} 0 0 0</pose>"
                       "<axis><xyz>0 1 0</xyz></axis>",
             "joint": f"<pose relative_to='j2'>{x} {y} {z} 0.5 0 0</pose>"
                      "<axis><xyz expressed_in='__model__'>0 2 0</xyz></axis>"}
    for name, pose in poses.items():
        path = tmp_path / f"{name}.urdf"
        path.write_text(text + "<gazebo><joint name='l' type='revolute'><parent>b</parent>"
                               f"<child>c</child>{pose}</joint></gazebo></robot>")
        mech = sp.load(path)
        state = sp.assemble(mech, {"j1": 0.4})
        c = state.placement("c").act(ends[1][1].translation)
        b = state.placement("b").act(ends[0][1].translation)
        assert np.allclose(b, c, rtol=0, atol=1e-12)
        assert sp.mobility(mech, state).dof == 1


@pytest.mark.parametrize("turned", [False, True])
def test_a_link_that_only_gazebo_has_joins_the_tree_and_closes_the_loop(turned, tmp_path):
    """Its first joint hangs it on the tree, whichever link that calls the parent."""
    lengths = LENGTHS["crank-rocker"]
    text, ends, t1, t3 = closed_four_bar(*lengths)
    tree = ET.fromstring(text + "</robot>")
    for element in tree.findall("*[@name='c']") + tree.findall("*[@name='j3']"):
        tree.remove(element)
    at = written(ends[0][1].translation)
    joint = f"<parent>c</parent><child>b</child><pose>{at} 0 0 0</pose>" if turned else \
        f"<parent>b</parent><child>c</child><pose relative_to='b'>{at} 0 0 0</pose>"
    stated = f"""<gazebo><joint name="j4" type="revolute">{joint}<axis><xyz>0 1 0</xyz>
        <dynamics><damping>0.5</damping></dynamics></axis></joint></gazebo>
        <gazebo><link name="c"><pose>{lengths[3]} 0 0 0 {t3} 0</pose><inertial><mass>2</mass>
        </inertial></link><joint name="j3" type="revolute"><parent>base</parent><child>c</child>
        <axis><xyz>0 1 0</xyz></axis></joint></gazebo>"""
    path = tmp_path / "four.urdf"
    path.write_text(ET.tostring(tree, encoding="unicode").replace("</robot>", stated + "</robot>"))
    mech = sp.load(path)
    assert [c.name for c in mech.closures] == ["j3"]
    assert mech.inertias["c"].mass == 2.0
    assert mech.model.damping[mech.coordinate("j4").v] == 0.5
    assert sp.mobility(mech).dof == 1
    state = sp.assemble(mech, {"j1": 0.4})
    b, c = (np.arctan2(*state.placement(link).rotation[[0, 2], 2]) for link in "bc")
    assert abs(freudenstein(*lengths, np.pi / 2 - t1 - 0.4, np.pi / 2 - c)) < 1e-12
    begin = sp.assemble(mech, {"j1": 0.0})
    b0, c0 = (np.arctan2(*begin.placement(link).rotation[[0, 2], 2]) for link in "bc")
    sense = -1.0 if turned else 1.0
    assert state.coordinate("j4").value == pytest.approx(sense * (c - b - c0 + b0), abs=1e-12)


def test_gazebo_before_sdformat_closes_the_gripper_that_mimics_only_copied(tmp_path):
    text = closed_four_bar(*LENGTHS["parallelogram"])[0].replace(
        '<axis xyz="0 1 0"/></joint>\n</robot>', "")
    text = text.replace('<parent link="base"/><child link="c"/>',
                        '<parent link="base"/><child link="c"/><mimic joint="j1" multiplier="-1"/>')
    path = tmp_path / "gripper.urdf"
    path.write_text(text + """<gazebo><joint:hinge name="h"><body1>b</body1><body2>c</body2>
        <anchor>c</anchor><axis>0 1 0</axis><anchorOffset>0 0 1</anchorOffset></joint:hinge>
        </gazebo></robot>""")
    with pytest.warns(UserWarning, match="<mimic> of j3 is left out: <hinge name='h'>"):
        mech = sp.load(path)
    state = sp.assemble(mech, {"j1": 0.4})
    assert state.coordinate("j3").value == pytest.approx(0.4, abs=1e-12)
    assert list(mech.drivers) == ["j1"]  # which j3 followed


# ---------------------------------------------------------------- onshape-to-robot


def test_a_closing_frame_is_a_ball_and_with_points_on_its_axis_a_hinge(tmp_path):
    opened = Opened("bennett")
    name, _, ends, axis = opened.loops[0]
    for kind in ("revolute", "spherical"):
        folder = tmp_path / kind
        folder.mkdir()
        mech = sp.load(opened.write(folder, onshape(name, kind, ends, axis)))
        closure, = mech.closures
        assert (closure.type, closure.name) == (kind, f"closing_{name}")
        assert "onshape-to-robot" in closure.source


def test_the_points_on_the_axis_say_where_the_hinge_points(tmp_path):
    """The two frames of a mate need not have z along the hinge; the points tell."""
    text, ends, _, _ = closed_four_bar(*LENGTHS["parallelogram"])
    skew = pin.SE3(pin.rpy.rpyToMatrix(0.3, 0.2, 0.1), np.zeros(3))
    made = ""
    for side, (link, at) in enumerate(ends, start=1):
        for suffix, placement in (("", at * skew if side == 1 else at),
                                  ("_z", at * pin.SE3(np.eye(3), 0.1 * Y))):
            frame = f"closing_x_{side}{suffix}"
            xyz, rpy = texts(placement)
            made += (f"<link name='{frame}'/><joint name='{frame}_frame' type='fixed'><origin "
                     f"xyz='{xyz}' rpy='{rpy}'/><parent link='{link}'/><child link='{frame}'/>"
                     "</joint>")
    (tmp_path / "four.urdf").write_text(text + made + "</robot>")
    mech = sp.load(tmp_path / "four.urdf")
    assert sp.mobility(mech).dof == 1
    assert sp.assemble(mech, {"j1": 0.5}).coordinate("j3").value == pytest.approx(0.5, abs=1e-12)


# ---------------------------------------------------------------- Drake


def test_drakes_joints_become_joints_of_the_tree(tmp_path):
    path = tmp_path / "drake.urdf"
    path.write_text("""<robot name="d"><link name="base"/><link name="a"/><link name="b"/>
      <link name="c"/><link name="d"/>
      <drake:joint name="ball" type="ball"><parent link="base"/><child link="a"/>
        <origin xyz="1 0 0"/></drake:joint>
      <drake:joint name="cross" type="universal"><parent link="a"/><child link="b"/></drake:joint>
      <drake:joint name="spindle" type="screw"><parent link="b"/><child link="c"/>
        <axis xyz="0 0 1"/><drake:screw_thread_pitch value="0.02"/></drake:joint>
      <drake:joint name="table" type="planar"><parent link="c"/><child link="d"/>
        <axis xyz="0 0 1"/></drake:joint></robot>""")
    mech = sp.load(path)
    assert mech.pairs == ("spherical", "universal", "screw", "planar")
    q = {"cross.first": 0.3, "cross.second": 0.4, "spindle": np.pi}
    state = sp.assemble(mech, q)
    turn = pin.rpy.rpyToMatrix(0.3, 0.0, 0.0) @ pin.rpy.rpyToMatrix(0.0, 0.4, 0.0)
    assert np.allclose(state.placement("b").rotation, turn, atol=1e-14)
    between = state.placement("b").actInv(state.placement("c"))
    assert between.translation[2] == pytest.approx(0.01, abs=1e-15)


def test_drakes_distance_holds_a_length_and_with_a_stiffness_is_a_spring(tmp_path):
    ends = ("<drake:distance_constraint_body_A name='b'/><drake:distance_constraint_p_AP "
            "value='2 0 0'/><drake:distance_constraint_body_B name='c'/>"
            "<drake:distance_constraint_p_BQ value='0 0 1'/>"
            "<drake:distance_constraint_distance value='0.2'/>"
            "<drake:distance_constraint_damping value='3'/>")
    rigid, soft = (four_bar(tmp_path, f"<drake:distance_constraint>{ends}"
                            f"<drake:distance_constraint_stiffness value='{k}'/>"
                            "</drake:distance_constraint>", f"{k}.urdf") for k in ("inf", "500"))
    mech = sp.load(rigid)
    state = sp.assemble(mech, {"j1": 0.1})
    gap = (state.placement("b").act(np.array([2.0, 0.0, 0.0]))
           - state.placement("c").act(np.array([0.0, 0.0, 1.0])))
    assert np.linalg.norm(gap) == pytest.approx(0.2, abs=1e-12)
    spring, = sp.load(soft).springs
    assert (spring.stiffness, spring.damping, spring.free_length) == (500.0, 3.0, 0.2)


def test_drakes_rotor_is_felt_through_its_gear(tmp_path):
    mech = sp.load(four_bar(tmp_path, """<transmission><type>SimpleTransmission</type>
      <actuator name="m"><drake:rotor_inertia value="2e-4"/><drake:gear_ratio value="50"/>
      </actuator><joint name="j1"/></transmission>"""))
    assert "j1" in mech.drivers
    assert mech.model.armature.tolist() == [pytest.approx(0.5), 0.0, 0.0]


# ---------------------------------------------------------------- motors


WELD = "<loop name='shut' type='fixed'><predecessor link='b'/><successor link='c'/></loop>"


def test_all_joints_of_a_tree_drive_it_whatever_motors_are_stated(tmp_path):
    motor = "<transmission name='t'><joint name='j1'/></transmission>"
    assert list(sp.load(four_bar(tmp_path, motor)).drivers) == ["j1", "j2", "j3"]
    assert list(sp.load(four_bar(tmp_path, motor + WELD)).drivers) == ["j1"]


def test_transmissions_and_ros2_control_say_what_is_driven(tmp_path):
    mech = sp.load(four_bar(tmp_path, WELD + """
      <transmission name="t"><joint name="j1"><hardwareInterface>x</hardwareInterface></joint>
      </transmission>
      <ros2_control name="r" type="system">
        <joint name="j3"><command_interface name="position"/></joint>
        <joint name="j2"><state_interface name="position"/></joint></ros2_control>"""))
    assert sorted(mech.drivers) == ["j1", "j3"]


def test_a_joint_that_cannot_be_driven_by_itself_gets_no_driver(tmp_path):
    path = four_bar(tmp_path, WELD + "<transmission name='t'><joint name='j1'/></transmission>"
                              "<transmission name='u'><joint name='j3'/></transmission>"
                              "<transmission name='v'><joint name='elsewhere'/></transmission>")
    path.write_text(path.read_text().replace('<child link="c"/>',
                                             '<child link="c"/><mimic joint="j1"/>'))
    with pytest.warns(UserWarning, match="<mimic> too"):
        assert list(sp.load(path).drivers) == ["j1"]


def test_joints_in_no_loop_are_drivers_beside_the_motors_that_are_stated(tmp_path):
    arm = """<link name="d"/><link name="e"/>
      <joint name="arm" type="continuous"><parent link="base"/><child link="d"/></joint>
      <joint name="hand" type="prismatic"><parent link="d"/><child link="e"/>
        <limit lower="0" upper="1" effort="1" velocity="1"/></joint>
      <transmission name="t"><joint name="j1"/></transmission>"""
    ends = closed_four_bar(*LENGTHS["parallelogram"])[1]
    mech = sp.load(four_bar(tmp_path, arm + ros("l", "revolute", ends, Y)))
    assert sorted(mech.drivers) == ["arm", "hand", "j1"]
    assert sp.sweep(mech, "arm", [0.0, 0.1]).closure_error.max() < 1e-14
    geared = "<coupling name='g'><predecessor link='a'/><successor link='c'/></coupling>"
    assert sorted(sp.load(four_bar(tmp_path, geared)).drivers) == ["j1", "j2"]


@pytest.mark.parametrize("stated", [
    "<ros2_control name='r' type='system'><joint name='j3'><param name='mimic'>j1</param>"
    "<param name='multiplier'>-2</param><command_interface name='position'/></joint>"
    "</ros2_control>",
    "<gazebo><plugin name='p' filename='libroboticsgroup_gazebo_mimic_joint_plugin.so'>"
    "<joint>j1</joint><mimicJoint>j3</mimicJoint><multiplier>-2</multiplier></plugin></gazebo>",
])
def test_a_joint_that_follows_by_what_simulators_declare_is_coupled(stated, tmp_path):
    motor = "<transmission name='t'><joint name='j3'/></transmission>"
    mech = sp.load(four_bar(tmp_path, motor + stated + stated))
    closure, = mech.closures
    assert (closure.type, closure.joints, closure.ratio) == ("coupling", ("j1", "j3"), -2.0)
    assert "j3" not in mech.drivers


# ---------------------------------------------------------------- URDF+


def test_a_coupling_of_urdf_plus_gears_two_links(tmp_path):
    for text in ("<coupling name='g'><predecessor link='a'/><successor link='c'/>"
                 "<ratio value='-2.5'/></coupling>",
                 "<constraint name='g' type='rolling'><predecessor link='a'/>"
                 "<successor link='c'/><ratio value='-2.5'/></constraint>"):
        mech = sp.load(four_bar(tmp_path, text))
        state = sp.assemble(mech, {"j1": 0.2})
        assert state.coordinate("j3").value == pytest.approx(-0.5, abs=1e-13)
    with pytest.raises(sp.MechanismFileError, match=r"2 \(.*j2.*\) and 1"):
        sp.load(four_bar(tmp_path, "<coupling name='g'><predecessor link='b'/>"
                                   "<successor link='c'/></coupling>"))


def test_independent_joints_of_urdf_plus_are_its_drivers(tmp_path):
    path = four_bar(tmp_path, WELD)
    path.write_text(path.read_text().replace('name="j1"', 'name="j1" independent="true"')
                    .replace('name="j2"', 'name="j2" independent="false"'))
    assert list(sp.load(path).drivers) == ["j1"]


@pytest.mark.parametrize("text", [
    "<constraint name='l' type='position'><predecessor link='b'><origin xyz='2 0 0'/></predecessor>"
    "<successor link='c'><origin xyz='0 0 1'/></successor></constraint>",
    "<loop_constraint name='l'><parent link='b'/><parent_origin xyz='2 0 0'/><child link='c'/>"
    "<child_origin xyz='0 0 1'/></loop_constraint>",
    "<loop name='l' type='spherical'><predecessor name='b'><origin xyz='2 0 0'/></predecessor>"
    "<sucessor name='c'><origin xyz='0 0 1'/></sucessor></loop>",
])
def test_older_and_misspelt_forms_of_urdf_plus_close_the_loop(text, tmp_path):
    mech = sp.load(four_bar(tmp_path, text))
    assert [c.type for c in mech.closures] == ["spherical"]
    assert sp.assemble(mech, {"j1": 0.4}).coordinate("j3").value == pytest.approx(0.4, abs=1e-12)


# ---------------------------------------------------------------- loop_closures.yaml


def hinge_at(point):
    return (f"closures:\n- {{link_a: b, link_b: c, point: {point.tolist()}, axis: [0, 1, 0]}}\n"
            "dependent: [j2, j3]\nindependent: [j1]\n")


@pytest.mark.parametrize("place", ["four.urdf", "urdf/four.urdf"])
def test_loop_closures_beside_a_urdf_or_in_its_package_close_the_loop(place, tmp_path):
    lengths = LENGTHS["crank-rocker"]
    text, _, t1, t3 = closed_four_bar(*lengths)
    (tmp_path / "urdf").mkdir()
    (tmp_path / place).write_text(text + "</robot>")
    end = np.array([lengths[3], 0, 0]) + lengths[2] * np.array([np.sin(t3), 0.0, np.cos(t3)])
    (tmp_path / "loop_closures.yaml").write_text(hinge_at(end))
    for source in (tmp_path / place, tmp_path, tmp_path / "loop_closures.yaml"):
        mech = sp.load(source)
        assert [c.type for c in mech.closures] == ["revolute"]
        assert list(mech.drivers) == ["j1"]
        state = sp.assemble(mech, {"j1": 0.3})
        assert abs(freudenstein(*lengths, np.pi / 2 - t1 - 0.3,
                                np.pi / 2 - t3 - state.coordinate("j3").value)) < 1e-12


def test_a_mimic_of_what_the_loop_decides_is_omitted_and_reported(tmp_path):
    path = four_bar(tmp_path, "")
    path.write_text(path.read_text().replace(
        '<child link="c"/>', '<child link="c"/><mimic joint="j1" multiplier="0.9"/>'))
    end = np.array([2.0 + np.sin(0.3), 0.0, np.cos(0.3)])
    (tmp_path / "loop_closures.yaml").write_text(hinge_at(end))
    with pytest.warns(UserWarning, match="mimic> of j3 is left out"):
        mech = sp.load(path)
    assert sp.assemble(mech, {"j1": 0.4}).coordinate("j3").value == pytest.approx(0.4, abs=1e-12)


def test_a_mimic_that_may_only_copy_a_loop_is_reported(tmp_path):
    """The two contradict each other where a copy is rounded; a gear beside a loop looks alike."""
    ends = closed_four_bar(*LENGTHS["parallelogram"])[1]
    path = four_bar(tmp_path, isaac("l", "spherical", ends, Y))
    path.write_text(path.read_text().replace('<child link="c"/>',
                                             '<child link="c"/><mimic joint="j1"/>'))
    with pytest.warns(UserWarning, match="j3: moved by a loop, with a <mimic> too"):
        assert len(sp.load(path).closures) == 2


def test_loops_with_a_point_on_either_link_close(tmp_path):
    path = four_bar(tmp_path, "")
    (tmp_path / "loop_closures.yaml").write_text(
        "pin_loops:\n- {name: p, parent: b, child: c, parent_xyz: [2, 0, 0], child_xyz: [0, 0, 1],"
        " axis: [0, 1, 0]}\nactuated_joints: [j1]\nball_limit_deg: 15\n")
    mech = sp.load(path)
    assert [(c.name, c.type) for c in mech.closures] == [("p", "revolute")]
    assert sp.assemble(mech, {"j1": 0.4}).coordinate("j3").value == pytest.approx(0.4, abs=1e-12)
    (tmp_path / "loop_closures.yaml").write_text("rods:\n- {from: b, to: c}\n")
    with pytest.raises(sp.MechanismFileError, match="rods is not a key"):
        sp.load(path)
    for point in ("[1, 2]", "[1, 2, x]", "[1, 2, .nan]", f"[1, 2, 1{'0' * 350}]", "{a: 1}"):
        (tmp_path / "loop_closures.yaml").write_text(
            f"ball_loops:\n- {{parent: b, child: c, parent_xyz: {point}, child_xyz: [0, 0, 1]}}\n")
        with pytest.raises(sp.MechanismFileError, match="parent_xyz must be three finite numbers"):
            sp.load(path)


def test_a_file_about_another_urdf_of_the_folder_is_reported_and_ignored(tmp_path):
    path = four_bar(tmp_path, "")
    (tmp_path / "loop_closures.yaml").write_text(
        "closures:\n- {link_a: arm, link_b: leg, point: [0, 0, 0], axis: [0, 0, 1]}\n")
    with pytest.warns(UserWarning, match=r"loop_closures\.yaml .* other links, arm, leg"):
        assert sp.load(path).closures == ()


# ---------------------------------------------------------------- under a mechanism file


def test_a_mechanism_file_has_the_loops_of_its_tree_too(tmp_path):
    four_bar(tmp_path, urdf_plus("l", "revolute", closed_four_bar(*LENGTHS["parallelogram"])[1], Y))
    file = tmp_path / "four.toml"
    file.write_text('name = "four"\ntree = "four.urdf"\n[drivers.crank]\njoint = "j1"\n')
    mech = sp.load(file)
    assert [c.name for c in mech.closures] == ["l"]
    assert sp.mobility(mech).dof == 1
    file.write_text(file.read_text() + '[[closures]]\nname = "l"\ntype = "spherical"\n'
                    'frames = ["tip", "end"]\n[frames.tip]\nlink = "b"\nxyz = [2, 0, 0]\n'
                    '[frames.end]\nlink = "c"\nxyz = [0, 0, 1]\n')
    with pytest.warns(UserWarning, match="'l' .URDF. <loop>. is left out"):
        mech = sp.load(file)
    assert [c.type for c in mech.closures] == ["spherical"]


def test_a_mechanism_file_may_say_what_closing_frames_are(tmp_path):
    ends = closed_four_bar(*LENGTHS["parallelogram"])[1]
    four_bar(tmp_path, onshape("x", "spherical", ends, Y))
    (tmp_path / "four.toml").write_text(
        'name = "four"\ntree = "four.urdf"\n[[closures]]\nname = "pin"\ntype = "revolute"\n'
        'frames = ["closing_x_1", "closing_x_2"]\n')
    with pytest.warns(UserWarning, match="'closing_x'.* is left out.* the same frames: 'pin'"):
        mech = sp.load(tmp_path / "four.toml")
    assert [(c.name, c.type) for c in mech.closures] == [("pin", "revolute")]


def test_a_loop_that_is_stated_for_several_simulators_still_leaves_one_freedom(tmp_path):
    ends = closed_four_bar(*LENGTHS["parallelogram"])[1]
    mech = sp.load(four_bar(tmp_path, "".join(write("l", "spherical", ends, Y)
                                              for write in (isaac, gazebo, drake))))
    assert sorted(c.name for c in mech.closures) == ["l", "l_2", "l_3"]
    assert sp.mobility(mech).dof == 1


def test_a_loop_in_a_xacro_macro_has_the_dimensions_that_are_requested(tmp_path):
    text = closed_four_bar(*LENGTHS["parallelogram"])[0].replace(
        '<robot name="four">', '<robot name="four" xmlns:xacro="http://www.ros.org/wiki/xacro">'
        '<xacro:arg name="l" default="2"/>').replace('xyz="2.0 0 0"', 'xyz="$(arg l) 0 0"')
    (tmp_path / "four.urdf.xacro").write_text(
        text + '<xacro:macro name="close" params="x"><loop name="l" type="spherical">'
        '<predecessor link="b"><origin xyz="${x} 0 0"/></predecessor>'
        '<successor link="c"><origin xyz="0 0 1"/></successor></loop></xacro:macro>'
        '<xacro:close x="$(arg l)"/></robot>')
    for length in (2.0, 3.0):
        mech = sp.load(tmp_path / "four.urdf.xacro", l=length)
        state = sp.assemble(mech, {"j1": 0.2})
        assert state.coordinate("j3").value == pytest.approx(0.2, abs=1e-12)
        end = state.placement("b").act(np.array([length, 0.0, 0.0]))
        assert np.allclose(end, state.placement("c").act(np.array([0.0, 0.0, 1.0])), atol=1e-12)


def test_a_urdf_may_be_called_xml(tmp_path):
    ends = closed_four_bar(*LENGTHS["parallelogram"])[1]
    path = four_bar(tmp_path, isaac("l", "spherical", ends, Y), "four.xml")
    path.write_text('<?xml version="1.0"?>\n<!-- <mujoco> -->\n' + path.read_text())
    assert len(sp.load(path).closures) == 1


def test_info_shows_every_loop_and_where_it_was_stated(tmp_path, run):
    ends = closed_four_bar(*LENGTHS["parallelogram"])[1]
    path = four_bar(tmp_path, isaac("l", "spherical", ends, Y))
    code, out, _ = run("info", path)
    assert code == 0
    assert "spherical: l_1 - l_2 (3 equations), from Isaac <loop_joint>" in out


@pytest.mark.parametrize("dialect", WRITERS)
def test_a_saved_or_exported_mechanism_keeps_the_loops_of_its_dialect(dialect, tmp_path, run):
    write, _ = WRITERS[dialect]
    text, ends, _, _ = closed_four_bar(*LENGTHS["parallelogram"])
    (tmp_path / "four.urdf").write_text(text + write("l", "spherical", ends, Y) + "</robot>")
    mech = sp.load(tmp_path / "four.urdf")
    (tmp_path / "again").mkdir()
    assert run("export", mech.path, "--urdf", tmp_path / "again" / "four.urdf")[0] == 0
    for file in (mech.save(tmp_path / "saved"), tmp_path / "again" / "four.toml"):
        again = sp.load(file)
        assert [(c.name, c.type, c.source) for c in again.closures] == \
            [(c.name, c.type, c.source) for c in mech.closures]
        assert sp.mobility(again).dof == 1
