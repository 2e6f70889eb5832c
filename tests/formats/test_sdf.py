"""SDFormat: what a file says of links, joints, frames and loops is what the mechanism is."""

import math
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from folders import DATA

import spatial_pin as sp


@pytest.fixture(autouse=True)
def _the_same_numbers_in_any_order():
    pin.seed(1)


CASSIE = DATA / "cassie_sdf"
ANY = "ignore::spatial_pin.errors.SpatialPinWarning"
quiet = pytest.mark.filterwarnings(ANY)


def sdf(body: str, version: str = "1.7", model: str = "") -> str:
    return f'<sdf version="{version}"><model name="m" {model}>{body}</model></sdf>'


def link(name: str, pose: str = "", mass: float = 1.0, attributes: str = "") -> str:
    inertia = "".join(f"<{key}>{0.01 * mass}</{key}>" for key in ("ixx", "iyy", "izz"))
    return (f"<link name='{name}'><pose {attributes}>{pose}</pose><inertial><mass>{mass}</mass>"
            f"<inertia>{inertia}</inertia></inertial></link>")


def joint(name: str, kind: str, parent: str, child: str, axis: str = "0 0 1", more: str = "",
          inside: str = "") -> str:
    shown = f"<axis><xyz>{axis}</xyz>{inside}</axis>" if axis else ""
    return (f"<joint name='{name}' type='{kind}'><parent>{parent}</parent><child>{child}</child>"
            f"{more}{shown}</joint>")


def loaded(folder: Path, text: str, name: str = "m.sdf") -> sp.Mechanism:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return sp.load(path)


def placement(mech: sp.Mechanism, name: str, **values: float) -> pin.SE3:
    q = mech.neutral.copy()
    for coordinate, value in values.items():
        q[mech.coordinate(coordinate.replace("__", ".")).q] = value
    data = mech.model.createData()
    pin.framesForwardKinematics(mech.model, data, q)
    return data.oMf[mech.frame_id(name)].copy()


def stated(text: str) -> pin.SE3:
    x, y, z, *angles = map(float, text.split())
    return pin.SE3(pin.rpy.rpyToMatrix(np.array(angles)), np.array([x, y, z]))


def gap(one: pin.SE3, two: pin.SE3) -> float:
    return float(np.abs(one.homogeneous - two.homogeneous).max())


# ---------------------------------------------------------------- Cassie


def freedoms_of_bodies(path: Path) -> int:
    """Freedom of all bodies with all joints as equations between them: no tree, nothing cut."""
    model = ET.parse(path).getroot().find("model")
    links = {x.get("name"): stated(x.findtext("pose")) for x in model.findall("link")}
    order = {name: k for k, name in enumerate(links)}
    rows = []
    for element in model.findall("joint"):
        parent, child = element.findtext("parent"), element.findtext("child")
        at = links[child] * stated(element.findtext("pose") or "0 0 0 0 0 0")
        axis = at.rotation @ np.array([float(x) for x in element.findtext("axis/xyz").split()])
        point = np.zeros((6, 6 * len(links)))
        for name, sign in ((parent, -1.0), (child, 1.0)):
            columns = slice(6 * order[name], 6 * order[name] + 6)
            point[:3, columns] = sign * np.hstack([np.eye(3), -pin.skew(at.translation)])
            point[3:, columns] = sign * np.hstack([np.zeros((3, 3)), np.eye(3)])
        across = np.linalg.svd(axis[None])[2][1:]
        rows.append(point[:3])
        if element.get("type") == "revolute":
            rows.append(across @ point[3:])
    singular = np.linalg.svd(np.vstack(rows), compute_uv=False)
    return 6 * len(links) - int((singular > 1e-9).sum())


@quiet
def test_cassie_has_four_loops_of_rank_ten_and_weighs_what_the_file_says():
    mech = sp.load(CASSIE / "cassie_v2.sdf")
    assert [c.type for c in mech.closures] == ["spherical"] * 4
    assert sum(x.mass for x in mech.inertias.values()) == pytest.approx(32.94, abs=1e-12)
    state = sp.assemble(mech, {})
    assert state.closure_error < 1e-14  # the file draws it closed
    rank = np.linalg.matrix_rank(sp.closure_jacobian(mech, state.q), tol=1e-9)
    assert rank == 10
    assert mech.model.nv - rank == freedoms_of_bodies(CASSIE / "cassie_v2.sdf") == 18


@quiet
@pytest.mark.parametrize("name", ["cassie_v2", "cassie"])
def test_every_link_of_cassie_stands_where_the_file_draws_it(name):
    mech = sp.load(CASSIE / f"{name}.sdf")
    for element in ET.parse(CASSIE / f"{name}.sdf").getroot().iter("link"):
        assert gap(placement(mech, element.get("name")), stated(element.findtext("pose"))) < 1e-12


@quiet
def test_gearboxes_of_cassie_couple_motor_and_joint():
    mech = sp.load(CASSIE / "cassie.sdf")
    gears = {c.name: c for c in mech.closures if c.type == "coupling"}
    assert len(gears) == 10 and len(mech.closures) == 16
    assert gears["left-roll-joint"].joints == ("left-roll-ip", "left-roll-op")
    assert gears["left-roll-joint"].ratio == -0.04  # output = -ratio * input
    state = sp.assemble(mech, {"left-roll-ip": 1.0})
    assert state.coordinate("left-roll-op")[0] == pytest.approx(-0.04, abs=1e-14)


@quiet
def test_springs_dampers_and_limits_of_cassie_act_on_its_joints():
    mech = sp.load(CASSIE / "cassie_v2.sdf")
    springs = {s.joint: s.stiffness for s in mech.springs}
    assert springs == {f"{side}-{name}": k for side in ("left", "right") for name, k in (
        ("knee-shin-joint", 1500.0), ("tarsus-spring-joint", 1250.0))}
    knee = mech.coordinate("left-knee-op")
    assert mech.model.damping[knee.v] == 1.0
    assert mech.model.lowerPositionLimit[knee.q] == -2.07694
    assert mech.model.upperPositionLimit[knee.q] == 0.13963


def test_what_a_cut_joint_cannot_keep_is_reported():
    with pytest.warns(sp.SpatialPinWarning) as told:
        sp.load(CASSIE / "cassie_v2.sdf")
    texts = [str(w.message) for w in told]
    assert any("does not act: 'left-pitch-rod-joint' (damping 0.01)" in t for t in texts)
    assert any("4 loops are cut at the joints 'left-pitch-rod-joint' (spherical)" in t
               for t in texts)
    assert any("floats there: link 'pelvis' (joint 'root_joint')" in t for t in texts)
    assert any("not read: <plugin name='CassiePlugin'" in t for t in texts)


@quiet
def test_cassie_is_saved_as_a_folder_that_loads_as_the_same_mechanism(tmp_path):
    mech = sp.load(CASSIE / "cassie.sdf")
    mech.save(tmp_path / "cassie")
    again = sp.load(next((tmp_path / "cassie").glob("*.toml")))
    q = pin.randomConfiguration(mech.model, np.full(mech.model.nq, -1.0), np.ones(mech.model.nq))
    assert again.coordinates == mech.coordinates
    assert np.allclose(sp.closure_jacobian(again, q), sp.closure_jacobian(mech, q), atol=1e-14)
    assert [s.joint for s in again.springs] == [s.joint for s in mech.springs]


# ---------------------------------------------------------------- a four-bar


def four_bar(a: float, b: float, c: float, d: float, theta: float, phi: float, **more: str) -> str:
    """Crank a at the origin, coupler b, rocker c at (d, 0): drawn at crank theta, rocker phi."""
    p = a * math.cos(theta), a * math.sin(theta)
    r = d + c * math.cos(phi), c * math.sin(phi)
    beta = math.atan2(r[1] - p[1], r[0] - p[0])
    return sdf(
        link("crank", f"0 0 0 0 0 {theta!r}") + link("coupler", f"{p[0]!r} {p[1]!r} 0 0 0 {beta!r}")
        + link("rocker", f"{d!r} 0 0 0 0 {phi!r}")
        + joint("crank_pin", "revolute", "world", "crank")
        + joint("coupler_pin", "revolute", "crank", "coupler")
        + joint("rocker_pin", "continuous", "world", "rocker")
        + joint("last_pin", "revolute", "coupler", "rocker", more=f"<pose>{c!r} 0 0 0 0 0</pose>",
                **more))


def rocker_of(theta, a, b, c, d):
    """Freudenstein's equation solved for the rocker, the open branch."""
    k1, k2, k3 = d / a, d / c, (a * a - b * b + c * c + d * d) / (2 * a * c)
    x = math.cos(theta) - k1 - k2 * math.cos(theta) + k3
    y = -2 * math.sin(theta)
    z = k1 - (k2 + 1) * math.cos(theta) + k3
    return 2 * math.atan2(-y - math.sqrt(y * y - 4 * x * z), 2 * x)


@pytest.mark.parametrize("theta0", [0.3, 1.2])
def test_four_bar_follows_freudensteins_equation(tmp_path, theta0):
    lengths = (0.1, 0.28, 0.24, 0.3)
    phi0 = rocker_of(theta0, *lengths)
    with pytest.warns(sp.SpatialPinWarning, match="a loop is cut at joint"):
        mech = loaded(tmp_path, four_bar(*lengths, theta0, phi0))
    assert len(mech.closures) == 1 and sp.mobility(mech).dof == 1
    motion = sp.sweep(mech, "crank_pin", np.linspace(0.0, 2 * math.pi, 25))
    for turned, rocker in zip(np.linspace(0.0, 2 * math.pi, 25),
                              motion.coordinate("rocker_pin")[0], strict=True):
        expected = rocker_of(theta0 + turned, *lengths) - phi0
        assert math.remainder(rocker - expected, 2 * math.pi) == pytest.approx(0.0, abs=1e-12)


@quiet
def test_the_joint_without_limits_damping_or_spring_is_cut(tmp_path):
    text = four_bar(0.1, 0.28, 0.24, 0.3, 0.3, rocker_of(0.3, 0.1, 0.28, 0.24, 0.3),
                    inside="<limit><lower>-2</lower><upper>2</upper></limit>")
    assert [c.name for c in loaded(tmp_path, text).closures] == ["coupler_pin"]
    text = text.replace("<xyz>0 0 1</xyz></axis></joint><joint name='rocker_pin'",
                        "<xyz>0 0 1</xyz><dynamics><damping>1</damping></dynamics></axis></joint>"
                        "<joint name='rocker_pin'")
    mech = loaded(tmp_path, text)
    assert "coupler_pin" not in [c.name for c in mech.closures]
    assert mech.model.damping[mech.coordinate("coupler_pin").v] == 1.0


@quiet
@pytest.mark.parametrize(("kinds", "cut"), [
    (("revolute", "ball", "universal", "revolute"), "j1"),
    (("revolute", "revolute", "universal", "prismatic"), "j2"),
    (("prismatic", "revolute", "prismatic", "prismatic"), "j1")])
def test_a_ball_is_cut_before_a_universal_joint_and_that_before_a_revolute(tmp_path, kinds, cut):
    ends = ["world", "a", "b", "c", "world"]
    body = link("a", "0 0 1 0 0 0") + link("b", "1 0 1 0 0 0") + link("c", "1 0 0 0 0 0")
    for k, kind in enumerate(kinds):
        parent, child = (ends[k], ends[k + 1]) if k < 3 else (ends[4], ends[3])
        second = "<axis2><xyz>0 1 0</xyz></axis2>" if kind == "universal" else ""
        body += joint(f"j{k}", kind, parent, child, more=second)
    assert [c.name for c in loaded(tmp_path, sdf(body)).closures] == [cut]


# ---------------------------------------------------------------- poses and frames


def test_poses_are_relative_to_any_frame_and_written_in_any_way(tmp_path):
    text = sdf(
        "<pose>1 2 3 0.1 0.2 0.3</pose>" + link("a", "0.1 0 0 0.5 0 0")
        + "<frame name='f' attached_to='a'><pose>0 0.2 0 0 0.7 0</pose></frame>"
        + "<frame name='g'><pose relative_to='f'/></frame>"
        + link("b", "0 0 0.3 0 0 90", attributes="relative_to='f' degrees='true'")
        + link("c", "0 0 0 0 0 2 2", attributes="relative_to='j' rotation_format='quat_xyzw'")
        + joint("i", "fixed", "world", "a", axis="")
        + joint("j", "revolute", "a", "b", more="<pose>0.4 0 0 0 0 0</pose>")
        + joint("k", "revolute", "b", "c", more="<pose relative_to='f'>0 1 0 0 0 0</pose>"), "1.9")
    mech = loaded(tmp_path, text)
    model, a = stated("1 2 3 0.1 0.2 0.3"), stated("0.1 0 0 0.5 0 0")
    f = model * a * stated("0 0.2 0 0 0.7 0")
    b = f * stated(f"0 0 0.3 0 0 {math.pi / 2!r}")
    for name, expected in {"a": model * a, "f": f, "g": f, "b": b,
                           "j": b * stated("0.4 0 0 0 0 0"), "k": f * stated("0 1 0 0 0 0"),
                           "c": b * stated(f"0.4 0 0 0 0 {math.pi / 2!r}")}.items():
        assert gap(placement(mech, name), expected) < 1e-14, name


@pytest.mark.parametrize(("version", "axis", "along"), [
    ("1.4", "<xyz>1 0 0</xyz>", "model"),
    ("1.6", "<xyz>1 0 0</xyz>", "joint"),
    ("1.6", "<xyz>1 0 0</xyz><use_parent_model_frame>1</use_parent_model_frame>", "model"),
    ("1.7", "<xyz expressed_in='__model__'>2 0 0</xyz>", "model"),
    ("1.8", "<xyz expressed_in='base'>1 0 0</xyz>", "base")])
def test_axes_are_expressed_in_the_frame_that_the_version_says(tmp_path, version, axis, along):
    text = sdf("<pose>0 0 0 0 0 0.4</pose>" + link("base", "0 0 0 0 0.3 0")
               + link("arm", "0 0 1 0 0 1.1") + joint("hold", "fixed", "world", "base", axis="")
               + f"<joint name='j' type='revolute'><parent>base</parent><child>arm</child>"
               f"<axis>{axis}</axis></joint>", version)
    mech = loaded(tmp_path, text)
    turned = placement(mech, "arm", j=0.8).rotation @ placement(mech, "arm").rotation.T
    yaw = stated("0 0 0 0 0 0.4")
    frames = {"model": yaw, "joint": yaw * stated("0 0 1 0 0 1.1"),
              "base": yaw * stated("0 0 0 0 0.3 0")}
    assert np.allclose(pin.log3(turned), 0.8 * frames[along].rotation[:, 0], atol=1e-14)


def test_files_may_be_as_careless_as_sdformats_own_reader_lets_them(tmp_path):
    """A comment before the declaration, dashes in it, a joint of a link's name, no namespace."""
    body = (link("a", "1 0 0 0 0 0") + "<my:note/>" + joint(
        "a", "universal", "world", "a", axis="1 0 0",
        more="<pose relative_to='world'/><axis2><xyz>0 1 0</xyz><limit><lower>-1</lower>"
             "<upper>1</upper></limit></axis2>", ))
    text = "<!-- a ---- b -->\n<?xml version='1.0'?>\n" + sdf(body)
    with pytest.warns(sp.SpatialPinWarning, match="not read: <note>"):
        mech = loaded(tmp_path, text)
    assert mech.coordinates == ("a.first", "a.second")
    assert np.allclose(placement(mech, "a").translation, [1.0, 0.0, 0.0])
    assert np.allclose(placement(mech, "a", a__second=0.5).translation,
                       [math.cos(0.5), 0.0, -math.sin(0.5)])


def test_axes_of_joints_with_two_are_expressed_in_other_frames_too(tmp_path):
    axes = ("<axis2><xyz expressed_in='__model__'>0 1 0</xyz><dynamics><damping>1</damping>"
            "</dynamics></axis2>")
    text = sdf(link("a", "0 0 0 0 0 0.7") + "<joint name='u' type='universal'><parent>world"
               "</parent><child>a</child><axis><xyz expressed_in='__model__'>1 0 0</xyz></axis>"
               + axes + "</joint>")
    turned = placement(loaded(tmp_path, text), "a", u__first=0.4, u__second=0.9).rotation
    expected = pin.utils.rotate("x", 0.4) @ pin.utils.rotate("y", 0.9) @ pin.utils.rotate("z", 0.7)
    assert np.allclose(turned, expected, atol=1e-14)


def test_a_placement_frame_is_what_the_models_pose_places(tmp_path):
    text = sdf("<pose>1 0 0 0 0 0</pose>" + link("a", "0 0 2 0 0 0")
               + joint("hold", "fixed", "world", "a", axis=""), "1.8", "placement_frame='a'")
    assert np.allclose(placement(loaded(tmp_path, text), "a").translation, [1.0, 0.0, 0.0])


# ---------------------------------------------------------------- joints


def test_a_joint_walked_against_its_direction_keeps_name_and_sign(tmp_path):
    """The same arm, its joints written from the base outwards and from the tip inwards."""
    links = (link("base", "0 0 0 0 0 0") + link("a", "0.3 0.1 0 0.4 0 0")
             + link("b", "0.5 0.2 0.3 0 0.6 0.1") + link("c", "0.1 0.2 0.8 0.3 0.6 0.1")
             + joint("hold", "fixed", "world", "base", axis=""))
    joints = [("i", "revolute", "base", "a", "0.3 0.1 0 0 0 0", "0 0.6 0.8"),
              ("j", "prismatic", "a", "b", "0.1 0.2 0 0 0 0.5", "0 0.6 0.8"),
              ("k", "screw", "b", "c", "0 0 0.1 0.2 0 0", "1 0 0")]
    pitch = "<screw_thread_pitch>0.3</screw_thread_pitch>"
    mechs = {}
    for way in (1, -1):
        body = "".join(
            joint(name, kind, *(parent, child)[::way], axis=axis, more=(
                f"<pose relative_to='{parent}'>{pose}</pose>" + pitch * (kind == "screw")))
            for name, kind, parent, child, pose, axis in joints)
        mechs[way] = loaded(tmp_path, sdf(links + body), f"m{way}.sdf")
    values = {"i": 0.7, "j": 0.2, "k": -1.1}
    against = {name: -x for name, x in values.items()}  # each link now moves the other way
    for name in ("a", "b", "c"):
        assert gap(placement(mechs[1], name, **values),
                   placement(mechs[-1], name, **against)) < 1e-14
    tip = stated("0.5 0.2 0.3 0 0.6 0.1") * stated("0 0 0.1 0.2 0 0")
    moved = placement(mechs[1], "c", k=2.0) * placement(mechs[1], "c").inverse()
    assert np.allclose(tip.rotation.T @ moved.act(tip.translation) - tip.rotation.T @
                       tip.translation, [0.3 * 2.0 / (2 * math.pi), 0.0, 0.0], atol=1e-14)


def test_the_older_pitch_of_a_screw_is_a_negative_angle_per_metre(tmp_path):
    for pitch, lead in (("<thread_pitch>-12.566370614359172</thread_pitch>", 0.5),
                        ("<screw_thread_pitch>0.5</screw_thread_pitch><thread_pitch>9"
                         "</thread_pitch>", 0.5), ("", 1.0)):
        mech = loaded(tmp_path, sdf(link("a") + joint("j", "screw", "world", "a", more=pitch)))
        assert placement(mech, "a", j=1.0).translation[2] == pytest.approx(
            lead / (2 * math.pi), rel=1e-14)


def test_a_universal_joint_turns_about_the_parents_axis_first(tmp_path):
    more = "<axis2><xyz>0 1 0</xyz>{}</axis2>"
    text = sdf(link("a") + joint("u", "universal", "world", "a", axis="1 0 0", more=more))
    expected = pin.utils.rotate("x", 0.4) @ pin.utils.rotate("y", 0.9)
    plain = loaded(tmp_path, text.format(""))
    assert plain.pairs == ("universal",)
    limit = "<limit><lower>-1</lower><upper>1</upper></limit><dynamics><damping>2</damping>" \
            "<friction>0.5</friction><spring_stiffness>3</spring_stiffness></dynamics>"
    limited = loaded(tmp_path, text.format(limit), "l.sdf")
    assert limited.pairs == ("revolute", "revolute")  # a coordinate each for what is said of it
    for mech in (plain, limited):
        assert mech.coordinates == ("u.first", "u.second")
        assert np.allclose(placement(mech, "a", u__first=0.4, u__second=0.9).rotation, expected,
                           atol=1e-15)
    second = limited.coordinate("u.second")
    assert limited.model.damping[second.v] == 2.0 and limited.springs[0].joint == "u.second"
    assert limited.model.upperPositionLimit[second.q] == 1.0


def test_the_two_axes_of_revolute2_need_not_be_perpendicular(tmp_path):
    text = sdf(link("a") + joint("u", "revolute2", "world", "a", axis="1 0 0",
                                 more="<axis2><xyz>0.6 0.8 0</xyz></axis2>"))
    mech = loaded(tmp_path, text)
    turned = placement(mech, "a", u__first=0.4, u__second=0.9).rotation
    assert np.allclose(turned, pin.utils.rotate("x", 0.4) @ pin.exp3(
        0.9 * np.array([0.6, 0.8, 0.0])), atol=1e-15)


def test_a_mimicking_axis_is_a_coupling(tmp_path):
    mimic = ("<mimic joint='i'><multiplier>2</multiplier><offset>0.5</offset>"
             "<reference>0.1</reference></mimic>")
    text = sdf(link("a") + link("b") + joint("i", "revolute", "world", "a")
               + joint("j", "revolute", "world", "b", inside=mimic), "1.11")
    state = sp.assemble(loaded(tmp_path, text), {"i": 0.3})
    assert state.coordinate("j")[0] == pytest.approx(2 * (0.3 - 0.1) + 0.5, abs=1e-14)


@pytest.mark.parametrize(("first", "second", "sign"), [
    (("base", "motor", "0 0 1"), ("base", "arm", "0 0 1"), -1.0),
    (("motor", "base", "0 0 1"), ("base", "arm", "0 0 1"), 1.0),
    (("base", "motor", "0 0 -1"), ("arm", "base", "0 0 1"), -1.0)])
def test_a_gearbox_counts_both_angles_from_its_reference_body(tmp_path, first, second, sign):
    text = sdf(link("base") + link("motor") + link("arm")
               + joint("hold", "fixed", "world", "base", axis="")
               + joint("i", "revolute", *first[:2], axis=first[2])
               + joint("j", "revolute", *second[:2], axis=second[2])
               + joint("g", "gearbox", "motor", "arm", more="<axis2><xyz>0 0 1</xyz></axis2>"
                       "<gearbox_ratio>3</gearbox_ratio><gearbox_reference_body>base"
                       "</gearbox_reference_body>"))
    mech = loaded(tmp_path, text)
    assert mech.closures[0].ratio == sign * 3.0


def test_limits_of_ten_to_the_sixteen_or_inf_are_none(tmp_path):
    inside = "<limit><lower>-inf</lower><upper>1e16</upper><effort>-1</effort></limit>"
    text = sdf(link("a") + link("b") + joint("i", "revolute", "world", "a", inside=inside)
               + joint("j", "prismatic", "world", "b", inside=inside))
    model = loaded(tmp_path, text).model
    assert np.all(np.isinf(model.upperPositionLimit)) and np.all(np.isinf(model.upperEffortLimit))


# ---------------------------------------------------------------- chains that are one pair


def hanging(massless: float = 0.0, offset: float = 0.0, axes=("1 0 0", "0 1 0", "0 0 1"),
            more: str = "") -> str:
    """A bar held by three revolute joints at one end and a ball at the other: a loop."""
    body = (link("bar", "1 0 0 0 0 0") + link("x", "0 0 0 0 0 0", massless)
            + link("y", "0 0 0 0 0 0", massless) + joint("i", "revolute", "world", "x", axes[0])
            + joint("j", "revolute", "x", "y", axes[1], more=f"<pose>0 0 {offset!r} 0 0 0</pose>")
            + joint("k", "revolute", "y", "bar", axes[2], more="<pose>-1 0 0 0 0 0</pose>",
                    inside=more)
            + joint("end", "ball", "world", "bar", axis=""))
    return sdf(body)


def test_three_revolutes_through_a_point_with_massless_links_between_are_a_ball(tmp_path):
    with pytest.warns(sp.SpatialPinWarning) as told:
        mech = loaded(tmp_path, hanging())
    assert "i, j, k meet in one point" in str(told[0].message)
    assert "'i+j+k'" in str(told[0].message) and "cut at joint" in str(told[0].message)
    assert sorted([*mech.pairs, *(c.type for c in mech.closures)]) == ["spherical", "spherical"]
    assert "x" not in mech.frame_ids and sp.mobility(mech).dof == 1


@quiet
@pytest.mark.parametrize("text", [
    hanging(massless=0.1), hanging(offset=0.01), hanging(axes=("1 0 0", "0.6 0.8 0", "0 0 1")),
    hanging(more="<limit><lower>-1</lower><upper>1</upper></limit>"),
    hanging(more="<dynamics><damping>0.1</damping></dynamics>")],
    ids=["mass", "offset", "oblique", "limit", "damping"])
def test_three_revolutes_that_are_more_or_less_than_a_ball_stay(tmp_path, text):
    mech = loaded(tmp_path, text)
    assert "spherical" not in mech.pairs and len(mech.closures) == 1
    assert len(mech.coordinates) == 3


@quiet
def test_two_revolutes_through_a_point_in_a_loop_are_a_universal_joint(tmp_path):
    text = hanging().replace("<joint name='k' type='revolute'>", "<joint name='k' type='fixed'>")
    mech = loaded(tmp_path, text)
    assert mech.pairs == ("universal",) and mech.coordinates == ("i+j.first", "i+j.second")


def test_revolutes_outside_of_loops_keep_their_names(tmp_path):
    text = hanging().replace("type='ball'", "type='none'")
    text = text[:text.index("<joint name='end'")] + "</model></sdf>"
    assert loaded(tmp_path, text).coordinates == ("i", "j", "k")


# ---------------------------------------------------------------- worlds, bases, links


def test_a_world_with_one_model_gives_gravity_and_place(tmp_path):
    world = ("<sdf version='1.7'><world name='w'><gravity>0 0 -1.6</gravity><include><uri>"
             "model://sun</uri></include><model name='ground'><static>1</static><link name='g'/>"
             "</model><model name='m'><pose>0 0 5 0 0 0</pose>" + link("a")
             + joint("j", "revolute", "world", "a") + "</model></world></sdf>")
    with pytest.warns(sp.SpatialPinWarning, match="static model 'ground' is left out"):
        mech = loaded(tmp_path, world, "w.world")
    assert mech.model.gravity.linear.tolist() == [0.0, 0.0, -1.6]
    assert placement(mech, "a").translation.tolist() == [0.0, 0.0, 5.0]


def test_a_model_that_is_not_joined_to_the_world_floats_and_a_static_one_is_held(tmp_path):
    body = link("a", "0 0 1 0 0 0") + link("b") + joint("j", "revolute", "a", "b")
    with pytest.warns(sp.SpatialPinWarning, match="floats there: link 'a'"):
        mech = loaded(tmp_path, sdf(body))
    assert mech.pairs == ("floating", "revolute")
    with pytest.warns(sp.SpatialPinWarning, match="static"):
        mech = loaded(tmp_path, sdf("<static>true</static>" + body))
    assert mech.pairs == ("revolute",)


def test_inertias_stand_in_their_own_frames(tmp_path):
    inertial = ("<link name='a'><inertial><pose>0.1 0.2 0.3 0.4 0 0</pose><mass>2</mass><inertia>"
                "<ixx>1</ixx><iyy>2</iyy><izz>2.5</izz></inertia></inertial></link>")
    mech = loaded(tmp_path, sdf(inertial + joint("j", "revolute", "world", "a")))
    turn = pin.utils.rotate("x", 0.4)
    assert mech.inertias["a"].lever.tolist() == [0.1, 0.2, 0.3]
    assert np.allclose(mech.inertias["a"].inertia, turn @ np.diag([1, 2, 2.5]) @ turn.T, atol=1e-15)


def test_a_link_without_inertia_has_the_one_kilogram_that_sdformat_gives_it(tmp_path):
    with pytest.warns(sp.SpatialPinWarning, match="no <inertial>: a"):
        mech = loaded(tmp_path, sdf("<link name='a'/>" + joint("j", "revolute", "world", "a")))
    assert mech.inertias["a"].mass == 1.0


def test_shapes_are_drawn_where_the_file_has_them(tmp_path):
    shapes = ("<link name='a'><inertial><mass>1</mass></inertial>"
              "<visual name='v'><pose relative_to='__model__'>0 0 1 0 0 0</pose><geometry><box>"
              "<size>1 2 3</size></box></geometry><material><diffuse>1 0 0 1</diffuse></material>"
              "</visual><visual name='e'><geometry><ellipsoid/></geometry></visual>"
              "<visual name='s'><geometry><cylinder/></geometry></visual>"
              "<pose>1 0 0 0 0 0</pose></link>")
    with pytest.warns(sp.SpatialPinWarning, match=r"not drawn.*visual 'e' of link 'a'"):
        mech = loaded(tmp_path, sdf(shapes + joint("j", "revolute", "world", "a")))
    shape, other = mech.visual_model.geometryObjects
    assert (other.geometry.radius, other.geometry.halfLength) == (1.0, 0.5)  # SDFormat's default
    assert shape.placement.translation.tolist() == [-1.0, 0.0, 1.0]
    assert shape.meshColor.tolist() == [1.0, 0.0, 0.0, 1.0]


@pytest.mark.parametrize("variable", ["", "GAZEBO_MODEL_PATH", "GZ_SIM_RESOURCE_PATH"])
def test_meshes_of_models_are_found_round_the_file_and_on_gazebos_paths(
        tmp_path, monkeypatch, variable):
    root = tmp_path / ("elsewhere" if variable else "models")
    mesh = root / "arm" / "meshes" / "a.stl"
    (tmp_path / "models" / "arm").mkdir(parents=True)
    mesh.parent.mkdir(parents=True)
    mesh.write_text("solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\n"
                    "vertex 0 1 0\nendloop\nendfacet\nendsolid a\n", encoding="utf-8")
    if variable:
        monkeypatch.setenv(variable, str(root))
    body = link("a").replace("</link>", "<visual name='v'><geometry><mesh><uri>model://arm/meshes/"
                             "a.stl</uri><scale>2 2 2</scale></mesh></geometry></visual></link>")
    mech = loaded(tmp_path / "models" / "arm",
                  sdf(body + joint("j", "revolute", "world", "a")))
    shape, = mech.visual_model.geometryObjects
    assert shape.meshPath == str(mesh) and shape.meshScale.tolist() == [2.0, 2.0, 2.0]


# ---------------------------------------------------------------- refused by name


@quiet
@pytest.mark.parametrize(("text", "named"), [
    (sdf(link("a") + "<include><uri>model://arm</uri></include>"), "model://arm"),
    (sdf(link("a") + "<model name='inner'/>"), "inner"),
    (sdf(link("a") + "<plugin name='finger_mimic' filename='libmimic.so'/>"), "finger_mimic"),
    (sdf(link("a") + link("b") + "<drake:linear_bushing_rpy><bushing_a>a</bushing_a>"
         "<bushing_b>b</bushing_b></drake:linear_bushing_rpy>"), "linear_bushing_rpy"),
    (sdf(link("a"), "1.2"), "1.2"),
    (sdf(link("a") + joint("j", "hinge", "world", "a")), "'hinge'"),
    (sdf(link("a") + joint("j", "revolute", "world", "c")), "'c'"),
    (sdf(link("a") + joint("j", "revolute", "world", "a", axis="0 0 0")), "<xyz> is zero"),
    (sdf(link("a") + joint("j", "revolute", "world", "a", axis="")), "needs <axis>"),
    (sdf(link("a") + joint("j", "revolute", "a", "a")), "with itself"),
    (sdf(link("a", "1 2 3 x 0 0")), "6 finite numbers"),
    (sdf(link("a", "1_0 2 3 0 0 0")), "6 finite numbers"),
    (sdf(link("a", attributes="relative_to='b'") + link("b", attributes="relative_to='a'")),
     "relative to each other"),
    (sdf(link("a") + link("b") + joint("g", "gearbox", "a", "b", more="<axis2/>"
                                                   "<gearbox_reference_body>a"
                                                   "</gearbox_reference_body>")), "gearbox 'g'"),
    (sdf(link("a") + link("a")), "two links are named 'a'"),
    (sdf(link("a") + joint("universe", "revolute", "world", "a")), "joint is named 'universe'"),
    (sdf(link("a") + joint("a&#10;b", "ball", "world", "a")), r"joint is named 'a\nb'"),
    (sdf(link("a", "0 0 0 0.1 0.2 0.3", 1e308) + joint("j", "revolute", "world", "a")), "link 'a'"),
    (sdf(""), "no <link>"),
    ("<sdf version='1.7'/>", "exactly one model"),
    ("<robot/>", "<robot>, not <sdf>"),
    (sdf(link("a", "1 0 0 0 0 0") + link("b") + joint("i", "fixed", "world", "a", axis="")
         + joint("j", "fixed", "a", "b", axis="") + joint("k", "fixed", "b", "a", axis="")
         .replace("</joint>", "<pose relative_to='b'>1 0 0 0 0 0</pose></joint>")), None),
])
def test_what_cannot_be_read_is_refused_by_name(tmp_path, text, named):
    if named is None:  # two fixed joints that agree, for the file draws every joint closed
        assert loaded(tmp_path, text).coordinates == ()
        return
    with pytest.raises(sp.MechanismFileError) as refused:
        loaded(tmp_path, text)
    assert named in str(refused.value) and "m.sdf" in str(refused.value)
