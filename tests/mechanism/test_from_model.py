"""Mechanisms made in code, of a Pinocchio model and closures, without files."""

import copy
import pickle
import tomllib

import coal
import numpy as np
import pinocchio as pin
import pytest
from closure_trees import CLOSURE_TYPES
from folders import DATA
from hypothesis import given, strategies as st
from mechanisms import from_text
from sameness import near, same_closures, same_inertias, same_mechanisms, same_models
from variety import each

import spatial_pin as sp


@pytest.fixture(autouse=True)
def _the_same_numbers_in_any_order():
    pin.seed(1)


CASSIE = DATA / "mjcf" / "agility_cassie" / "cassie.xml"
from_model = sp.Mechanism.from_model


def at(x=0.0, y=0.0, z=0.0, *rpy):
    return pin.SE3(pin.rpy.rpyToMatrix(*rpy) if rpy else np.eye(3), np.array([x, y, z]))


def bars():
    """A four-bar linkage, open: three hinges, and inertias that have no names."""
    model = pin.Model()
    model.name = "bars"
    for name, on, place, mass, length in (
            ("crank", 0, at(), 1.0, 0.3), ("coupler", 1, at(0.3), 2.0, 0.6),
            ("rocker", 0, at(0.7), 1.5, 0.5)):
        joint = model.addJoint(on, pin.JointModelRZ(), place, name)
        model.appendBodyToJoint(joint, pin.Inertia.FromBox(mass, length, 0.02, 0.02),
                                at(0.5 * length))
    return model


ENDS = (("coupler", at(0.6)), ("rocker", at(0.5)))
GUESS = {"crank": 0.5, "coupler": 0.5, "rocker": 1.5}
IN_FILE = """<robot name="bars"><link name="world"/><link name="crank"><inertial>
<origin xyz="0.15 0 0"/>CRANK</inertial></link><link name="coupler"><inertial>
<origin xyz="0.3 0 0"/>COUPLER</inertial></link><link name="rocker"><inertial>
<origin xyz="0.25 0 0"/>ROCKER</inertial></link>
<joint name="crank" type="continuous"><parent link="world"/><child link="crank"/>
<axis xyz="0 0 1"/></joint>
<joint name="coupler" type="continuous"><origin xyz="0.3 0 0"/><parent link="crank"/>
<child link="coupler"/><axis xyz="0 0 1"/></joint>
<joint name="rocker" type="continuous"><origin xyz="0.7 0 0"/><parent link="world"/>
<child link="rocker"/><axis xyz="0 0 1"/></joint></robot>"""


def bars_in_file():
    text = IN_FILE
    for name, mass, length in (("CRANK", 1.0, 0.3), ("COUPLER", 2.0, 0.6), ("ROCKER", 1.5, 0.5)):
        moments = pin.Inertia.FromBox(mass, length, 0.02, 0.02).inertia.diagonal()
        xx, yy, zz = (repr(float(x)) for x in moments)
        text = text.replace(name, f'<mass value="{mass}"/><inertia ixx="{xx}" ixy="0" ixz="0" '
                                  f'iyy="{yy}" iyz="0" izz="{zz}"/>')
    return from_text(text, {
        "name": "bars", "tree": "bars.urdf", "guess": GUESS,
        "drivers": {"motor": {"joint": "crank"}},
        "frames": {"revolute_1": {"link": "coupler", "xyz": [0.6, 0.0, 0.0]},
                   "revolute_2": {"link": "rocker", "xyz": [0.5, 0.0, 0.0]}},
        "closures": [{"name": "revolute", "type": "revolute",
                      "frames": ["revolute_1", "revolute_2"]}]}, "bars.toml")


def four_bar(**more):
    return from_model(bars(), [sp.closures.revolute(*ENDS)], drivers={"motor": "crank"},
                      guess=GUESS, **more)


def test_a_linkage_made_in_code_is_that_of_a_file():
    made, loaded = four_bar(), bars_in_file()
    assert made.frames == loaded.frames
    same_closures(made.closures, loaded.closures)
    assert made.characteristic_length == loaded.characteristic_length
    for crank in np.linspace(0.0, 6.0, 7):
        one, other = (sp.solve_rates(m, sp.assemble(m, {"motor": crank}), {"motor": 2.0})
                      for m in (made, loaded))
        for name in ("crank", "coupler", "rocker", "revolute_1"):
            near(one.placement(name).homogeneous, other.placement(name).homogeneous, 1e-14)
            near(one.velocity(name).vector, other.velocity(name).vector, 1e-13)
        near(one.com("coupler").position, other.com("coupler").position, 1e-14)
        forces = [sp.inverse_dynamics(m, s).efforts["motor"]
                  for m, s in ((made, one), (loaded, other))]
        assert forces[0] == pytest.approx(forces[1], abs=1e-12)


@pytest.mark.parametrize("name", each(sp.list_mechanisms()))
def test_every_library_mechanism_can_be_made_in_code(name):
    loaded = sp.load(name)
    made = from_model(
        loaded.model, loaded.closures, drivers={k: d.joint for k, d in loaded.drivers.items()},
        springs=loaded.springs, passives=loaded.passives, guess=loaded.guess, name=loaded.name,
        visual_model=loaded.visual_model, collision_model=loaded.collision_model)
    assert made.pairs == loaded.pairs and made.coordinates == loaded.coordinates
    assert made.links == loaded.links and made.frame_ids.keys() == loaded.frame_ids.keys()
    same_models(made.model, loaded.model)
    same_closures(made.closures, loaded.closures)
    assert made.inertias.keys() == {n for n, x in loaded.inertias.items()
                                    if x.mass or x.inertia.any()}
    same_inertias([made.inertias[n] for n in made.inertias],
                  [loaded.inertias[n] for n in made.inertias], loaded.characteristic_length)
    near(sp.assemble(made).q, sp.assemble(loaded).q, 1e-14)


# ---------------------------------------------------------------- closures

AXIS, SIDE = [0.6, 0.0, 0.8], [0.0, 1.0, 0.0]
CURVE = sp.curves.ellipse([0.3, 0.2])
CONSTRUCTED = {  # type -> (arguments after the frames, what a file says)
    "spherical": ({}, {}), "weld": ({}, {}), "fixed": ({}, {}),
    "revolute": ({"axis": AXIS}, {"axis": AXIS}),
    "prismatic": ({"axis": AXIS}, {"axis": AXIS}),
    "screw": ({"lead": 0.02, "axis": AXIS}, {"lead": 0.02, "axis": AXIS}),
    "cylindrical": ({"axis": AXIS, "equations": [0, 2]}, {"axis": AXIS, "equations": [0, 2]}),
    "universal": ({"axis": AXIS, "axis2": SIDE}, {"axis": AXIS, "axis2": SIDE}),
    "planar": ({}, {}), "distance": ({"length": 0.4}, {"length": 0.4}),
    "rope": ({"length": 0.4}, {"length": 0.4}),
    "point_on_curve": ({"curve": CURVE}, {"curve": "c"}),
    "frame_on_curve": ({"curve": CURVE}, {"curve": "c"}),
    "curve_on_curve": ({"curves": [CURVE, CURVE]}, {"curves": ["c", "c"]}),
    "cam": ({"curve": CURVE, "follower": {"knife": True}},
            {"curve": "c", "follower": {"knife": True}}),
    "point_on_line": ({"axis": AXIS}, {"axis": AXIS}), "point_on_plane": ({}, {}),
    "parallel": ({"axis": AXIS}, {"axis": AXIS}),
    "perpendicular": ({"axis": AXIS, "axis2": SIDE}, {"axis": AXIS, "axis2": SIDE}),
    "coupling": ({"ratio": -2.0, "offset": 0.5}, {"ratio": -2.0, "offset": 0.5}),
}
PLACES = (("arm_6", at(0.1, 0.2, -0.1, 0.3, -0.4, 0.5)),
          ("arm_1", at(0.0, 0.3, 0.1, 1.0, 0.2, 0.1)))
CLOSED = np.array([0.3, -0.4, 0.5, -0.6, 0.7, -0.8, 0.0, 0.0, 0.0, 1.0])


def arm():
    """Six hinges and a ball, one after the other."""
    model, on = pin.Model(), 0
    for k, axis in enumerate(np.vstack([np.eye(3), np.eye(3)[::-1]]), 1):
        joint = pin.JointModelRevoluteUnaligned(axis)
        on = model.addJoint(on, joint, at(0.1, 0.05 * k, 0.2, 0.1 * k, 0.2, -0.3), f"arm_{k}")
        model.addJointFrame(on)
        model.appendBodyToJoint(on, pin.Inertia.FromSphere(1.0 + k, 0.1), at(0.05))
    model.addJoint(on, pin.JointModelSpherical(), at(0.2), "ball")
    model.name = "arm"
    return model


def closed_places(kind):
    """Two frames that a closure of this type holds together at `CLOSED`."""
    model, length = arm(), CONSTRUCTED[kind][0].get("length", 0.0)
    data = model.createData()
    pin.forwardKinematics(model, data, CLOSED)
    one = at(0.1, 0.2, -0.1, 0.3, -0.4, 0.5)
    turned = at(0.0, 0.0, length)
    if "curve" in CONSTRUCTED[kind][0]:  # on the vertex of the ellipse
        turned = at(0.3)
    if kind in ("universal", "perpendicular"):  # SIDE is square to AXIS
        turned.rotation = pin.AngleAxis(0.4, np.array(AXIS)).matrix()
    other = data.oMi[1].actInv(data.oMi[6]) * one * turned
    return ("arm_6", one), ("arm_1", other)


NEAR = {f"arm_{k + 1}": float(x) + 0.02 for k, x in enumerate(CLOSED[:6])}


@pytest.mark.parametrize("kind", CLOSURE_TYPES)
def test_each_type_of_closure_has_a_constructor_that_says_what_a_file_says(kind):
    given, said = CONSTRUCTED[kind]
    make, places = getattr(sp.closures, kind), closed_places(kind)
    coupled = kind == "coupling"
    mech = from_model(arm(), [make("arm_1", "arm_2", **given) if coupled else
                              make(places, **given) if kind == "rope" else
                              make(*places, **given)], guess=NEAR)
    content = {"name": "arm", "tree": "arm.urdf", "guess": NEAR,
               "joints": {"ball": {"type": "spherical"}},
               "closures": [{"name": kind, "type": kind, **said}]}
    if "curve" in said:
        content["curves"] = {"c": dict(CURVE.form)}
    if coupled:
        content["closures"][0]["joints"] = ["arm_1", "arm_2"]
    else:
        content["frames"] = {
            f"{kind}_{k}": {"link": link, "xyz": place.translation.tolist(),
                            "rpy": pin.rpy.matrixToRpy(place.rotation).tolist()}
            for k, (link, place) in enumerate(places, 1)}
        content["closures"][0]["frames"] = [f"{kind}_1", f"{kind}_2"]
    loaded = from_text(mech.urdf, content, "arm.toml")
    same_closures(mech.closures, loaded.closures)
    one, other = sp.assemble(mech), sp.assemble(loaded)
    assert one.closure_error < 1e-13
    for name in (*mech.frames, "arm_6", "ball"):
        near(one.placement(name).homogeneous, other.placement(name).homogeneous, 1e-14)


def test_a_distance_may_be_that_of_two_other_frames():
    rod = sp.closures.distance("arm_6", "arm_2", length_between=("arm_4", ("arm_1", at(0.0, 0.3))))
    mech = from_model(arm(), [rod], drivers=["arm_4"])
    assert mech.closures[0].between == ("arm_4", "distance_between_2")
    state = sp.assemble(mech)
    p = {n: state.placement(n).translation for n in ("arm_6", "arm_2", "arm_4")}
    q = state.placement("distance_between_2").translation
    assert np.linalg.norm(p["arm_6"] - p["arm_2"]) == pytest.approx(
        np.linalg.norm(p["arm_4"] - q), abs=1e-12)


def test_the_universe_is_what_stands_still():
    for ground in ("universe", "world"):
        mech = from_model(bars(), [sp.closures.spherical(("coupler", at(0.6)), (ground, at(0.8)))],
                          frames={"mark": (ground, at(0.1)), "centre": (ground, at())},
                          springs=[sp.Spring("s", ("rocker", ground), stiffness=1.0)], guess=GUESS)
        assert mech.frames["spherical_2"].link == mech.frames["mark"].link == "world"
        assert mech.springs[0].frames == ("rocker", "world")
        near(sp.assemble(mech).placement("spherical_1").translation, [0.8, 0.0, 0.0], 1e-14)


def test_closures_without_names_get_one_each():
    ball = sp.closures.spherical(*PLACES)
    named = sp.closures.spherical("arm_6", "arm_2", name="hold")
    mech = from_model(arm(), [ball, ball, named, named,
                              sp.closures.distance("arm_6", "arm_1", 0.3, name="ball")])
    names = [c.name for c in mech.closures]
    assert names == ["spherical", "spherical_2", "hold", "hold_2", "ball_2"]  # ball is a joint
    assert {"spherical_1", "spherical_2_1"} < mech.frames.keys()
    assert len(mech.frames) == 4


@pytest.mark.parametrize(("make", "error", "says"), [
    (lambda c: c.spherical("a", 3), TypeError, "by its name, or as"),
    (lambda c: c.spherical("a", ("b", np.eye(4))), TypeError, "by its name, or as"),
    (lambda c: c.spherical("a", "b", name=""), TypeError, "name of a closure"),
    (lambda c: c.revolute("a", "b", axis=[0, 0, 2]), ValueError, "axis has length 2"),
    (lambda c: c.revolute("a", "b", axis=[0, 1]), ValueError, "axis has shape"),
    (lambda c: c.revolute("a", "b", equations=[0, 9]), ValueError, "0 to 4, ascending"),
    (lambda c: c.revolute("a", "b", equations=[]), ValueError, "0 to 4, ascending"),
    (lambda c: c.distance("a", "b"), ValueError, "one of the two"),
    (lambda c: c.distance("a", "b", 0.0), ValueError, "length"),
    (lambda c: c.distance("a", "b", 1.0, length_between=("a", "c")), ValueError, "one of the two"),
    (lambda c: c.distance("a", "b", length_between=("a",)), ValueError, "two frames"),
    (lambda c: c.screw("a", "b", float("nan")), ValueError, "lead"),
    (lambda c: c.coupling("a", "b", 0.0), ValueError, "ratio is zero"),
    (lambda c: c.coupling("a", ("b", pin.SE3.Identity())), TypeError, "two joints by name"),
])
def test_what_is_no_closure_is_refused_at_once(make, error, says):
    with pytest.raises(error, match=says):
        make(sp.closures)


@pytest.mark.parametrize(("closure", "says"), [
    (sp.closures.spherical("arm_7", "arm_2"), "closure 'spherical': frames: .*'arm_7'; did you"),
    (sp.closures.spherical(("arm_7", at(0.1)), "arm_2"), "spherical_1: link: .*'arm_7'; did you"),
    (sp.closures.spherical(("arm_2", at(0.1)), "arm_2"), "the same body"),
    (sp.closures.coupling("arm_1", "ball"), "several coordinates"),
    (sp.closures.spherical(("arm_2", at(float("nan"))), "arm_3"), "NaN"),
])
def test_closures_that_cannot_be_are_refused_by_name(closure, says):
    with pytest.raises((sp.SpatialPinError, ValueError), match=says):
        from_model(arm(), [closure])


# ---------------------------------------------------------------- Pinocchio's constraints


def hands(model):
    return [("larm_effector_body", at(0.0, 0.0, 0.05)), ("rarm_effector_body", at(0.0, 0.0, 0.05))]


def humanoid():
    model = pin.buildSampleModelHumanoid()
    for joint, place in zip(("rarm", "larm", "rleg", "lleg"), (-0.2, 0.2, -0.1, 0.1), strict=True):
        i = model.getJointId(f"{joint}_shoulder1_joint")
        model.jointPlacements[i] = at(0.0, place, 0.4 if "arm" in joint else 0.0) \
            * model.jointPlacements[i]
    return model


def native(model, kind, frame=pin.ReferenceFrame.LOCAL, name=""):
    ids = [model.frames[model.getFrameId(n)].parentJoint for n, _ in hands(model)]
    own = [model.frames[model.getFrameId(n)].placement * p for n, p in hands(model)]
    made = pin.RigidConstraintModel(kind, model, ids[0], own[0], ids[1], own[1], frame)
    made.name = name
    return made


@pytest.mark.parametrize("frame", [
    pin.ReferenceFrame.LOCAL, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED])
@pytest.mark.parametrize(("kind", "make"), [
    (pin.ContactType.CONTACT_3D, sp.closures.spherical),
    (pin.ContactType.CONTACT_6D, sp.closures.weld)])
def test_constraints_of_pinocchio_are_closures(kind, make, frame):
    model = humanoid()
    constrained = from_model(model, [native(model, kind, frame)])
    closed = from_model(model, [make(*hands(model))])
    one, other = sp.assemble(constrained), sp.assemble(closed)
    near(one.q, other.q, 1e-12)
    ends = [one.placement(n) * p for n, p in hands(model)]
    near(ends[0].translation, ends[1].translation, 1e-13)
    if kind == pin.ContactType.CONTACT_6D:
        near(ends[0].rotation, ends[1].rotation, 1e-12)
    again = from_model(constrained.model, constrained.constraint_models())
    near(sp.assemble(again).q, one.q, 1e-12)


@pytest.mark.parametrize("kind", [pin.ContactType.CONTACT_3D, pin.ContactType.CONTACT_6D])
def test_accelerations_are_those_of_pinocchio(kind):
    model = humanoid()
    mech = from_model(model, [native(model, kind)], name="hands")
    state = sp.assemble(mech)
    expected = pinocchio_acceleration(model, native(model, kind), state.q, np.zeros(model.nv))
    near(sp.forward_dynamics(mech, state).a, expected, 1e-10 * np.abs(expected).max())


def pinocchio_acceleration(model, constraint, q, v):
    models = pin.StdVec_RigidConstraintModel()
    models.append(constraint)
    datas = pin.StdVec_RigidConstraintData()
    datas.append(models[0].createData())
    data = model.createData()
    pin.initConstraintDynamics(model, data, models, datas)
    return pin.constraintDynamics(model, data, q, v, np.zeros(model.nv), models, datas,
                                  pin.ProximalSettings(1e-14, 1e-12, 100)).copy()


def test_constraints_and_closures_may_be_mixed_and_get_names():
    model = humanoid()
    ball = native(model, pin.ContactType.CONTACT_3D)
    point = pin.PointAnchorConstraintModel(model, ball.joint1_id, ball.joint1_placement,
                                           ball.joint2_id, ball.joint2_placement)
    frame = pin.FrameAnchorConstraintModel(model, ball.joint1_id, ball.joint1_placement)
    mech = from_model(model, [
        ball, point, pin.ConstraintModel(frame),
        native(model, pin.ContactType.CONTACT_3D, name="x"),
        sp.closures.spherical(*hands(model)), native(model, pin.ContactType.CONTACT_6D, name="x")])
    assert [(c.name, c.type) for c in mech.closures] == [
        ("spherical", "spherical"), ("spherical_2", "spherical"), ("weld", "weld"),
        ("x", "spherical"), ("spherical_3", "spherical"), ("x_2", "weld")]
    assert mech.closures[2].frames[1] == "world"


@pytest.mark.parametrize("read", [pin.buildModelAndConstraintsFromMJCF,
                                  pin.buildModelAndLegacyConstraintsFromMJCF])
def test_what_pinocchio_reads_of_other_formats_is_taken(read, tmp_path):
    model, constraints, *_ = read(str(CASSIE))
    mech = from_model(model, constraints, guess=model.referenceConfigurations["home"])
    assert mech.name == "cassie" and len(mech.coordinates) == 32
    state = sp.assemble(mech)
    assert state.closure_error < 1e-13
    assert sp.mobility(mech, state).dof == 22
    same_mechanisms(sp.load(mech.save(tmp_path)), mech)


def test_constraints_that_hold_nothing_together_are_refused():
    model = humanoid()
    contact = pin.PointContactConstraintModel(model, 1, pin.SE3.Identity())
    for wrong in (contact, pin.ConstraintModel(contact), "larm", 3,
                  pin.RigidConstraintModel(pin.ContactType.CONTACT_UNDEFINED, model, 1)):
        with pytest.raises(sp.ClosureTypeError, match="does not hold two bodies together"):
            from_model(model, [wrong])
    shifted = native(model, pin.ContactType.CONTACT_6D)
    shifted.desired_contact_placement = at(0.1)
    with pytest.raises(sp.ClosureTypeError, match="desired_contact_placement is not zero"):
        from_model(model, [shifted])
    with pytest.raises(sp.ClosureTypeError, match="of another model"):
        from_model(bars(), [native(model, pin.ContactType.CONTACT_3D)])
    with pytest.raises(TypeError, match="closures is a list"):
        from_model(model, "spherical")


# ---------------------------------------------------------------- joints


def one_joint(joint, **more):
    model = pin.Model()
    i = model.addJoint(0, joint, at(0.1, 0.2, 0.3, 0.4, 0.5, 0.6), "pair")
    model.appendBodyToJoint(i, pin.Inertia.FromBox(2.0, 0.1, 0.2, 0.3), at(0.3, 0.1))
    j = model.addJoint(i, pin.JointModelRY(), at(0.4), "last")
    model.appendBodyToJoint(j, pin.Inertia.FromSphere(1.0, 0.1), at(0.2))
    for key, value in more.items():
        setattr(model, key, value)
    return model


def composite(*joints, placement=None):
    made = pin.JointModelComposite()
    for joint in joints:
        made.addJoint(joint, *([] if placement is None else [placement]))
    return made


X, Y, Z = np.eye(3)
A = np.array([0.6, 0.0, 0.8])
SAME = {  # joints that stay what they are
    "RX": (pin.JointModelRX(), "revolute"), "RY": (pin.JointModelRY(), "revolute"),
    "unaligned": (pin.JointModelRevoluteUnaligned(A), "revolute"),
    "PZ": (pin.JointModelPZ(), "prismatic"),
    "unaligned slide": (pin.JointModelPrismaticUnaligned(A), "prismatic"),
    "HX": (pin.JointModelHX(0.1), "screw"), "HZ": (pin.JointModelHZ(-0.2), "screw"),
    "unaligned screw": (pin.JointModelHelicalUnaligned(A, 0.3), "screw"),
    "spherical": (pin.JointModelSpherical(), "spherical"),
    "free": (pin.JointModelFreeFlyer(), "floating"),
    "universal": (pin.JointModelUniversal(X, Y), "universal"),
    "cylindrical": (composite(pin.JointModelRZ(), pin.JointModelPZ()), "cylindrical"),
    "planar": (composite(pin.JointModelPX(), pin.JointModelPY(), pin.JointModelRZ()), "planar"),
}
OTHER = {  # joints that get other coordinates: q, v and efforts of theirs from those of ours
    "RUBX": (pin.JointModelRUBX(), "revolute"), "RUBZ": (pin.JointModelRUBZ(), "revolute"),
    "planar": (pin.JointModelPlanar(), "planar"),
    "composite of one": (composite(pin.JointModelPY()), "prismatic"),
    "composite of two": (composite(pin.JointModelRX(), pin.JointModelRY()), "universal"),
}


@pytest.mark.parametrize("case", SAME)
def test_pairs_stay_what_they_are_and_move_exactly_alike(case, tmp_path):
    joint, pair = SAME[case]
    model = one_joint(joint)
    mech = from_model(model, name="one")
    assert mech.pairs == (pair, "revolute")
    q, v, a = pin.randomConfiguration(model, -np.ones(model.nq), np.ones(model.nq)), *(
        np.random.default_rng(1).normal(size=(2, model.nv)))
    for found, expected in zip(motions(mech.model, q, v, a), motions(model, q, v, a), strict=True):
        near(found, expected, 0.0)
    again = sp.load(mech.save(tmp_path))
    same_mechanisms(again, mech)
    for found, expected in zip(motions(again.model, q, v, a), motions(model, q, v, a), strict=True):
        near(found, expected, 1e-13)


def motions(model, q, v, a):
    data = model.createData()
    pin.forwardKinematics(model, data, q, v, a)
    places = [x.homogeneous for x in data.oMi] + [x.vector for x in (*data.v, *data.a)]
    return [*places, pin.rnea(model, data, q, v, a)]


@pytest.mark.parametrize("case", OTHER)
def test_other_forms_of_a_pair_become_the_pair(case, tmp_path):
    joint, pair = OTHER[case]
    model = one_joint(joint)
    mech = from_model(model, name="one")
    assert mech.pairs == (pair, "revolute")
    own = np.random.default_rng(2).uniform(-1.0, 1.0, mech.model.nq)
    theirs = own
    if model.nq > mech.model.nq:
        angle = own[-2]
        theirs = np.concatenate([own[:-2], [np.cos(angle), np.sin(angle)], own[-1:]])
    for i in (1, 2):
        near(place(mech.model, own, i), place(model, theirs, i), 1e-15)
    energy = [pin.computePotentialEnergy(m, m.createData(), q)
              for m, q in ((mech.model, own), (model, theirs))]
    assert energy[0] == pytest.approx(energy[1], rel=1e-14)
    same_mechanisms(sp.load(mech.save(tmp_path)), mech)


def place(model, q, joint):
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    return data.oMi[joint].homogeneous


def test_wheels_about_any_axis_count_their_turns():
    model = pin.buildModelFromXML(
        '<robot name="wheel"><link name="base"/><link name="rim"/><joint name="hub" '
        'type="continuous"><parent link="base"/><child link="rim"/><axis xyz="0.6 0 0.8"/></joint>'
        "</robot>")
    assert (model.nq, model.joints[1].shortname()) == (2, "JointModelRevoluteUnboundedUnaligned")
    mech = from_model(model)
    near(place(mech.model, np.array([7.0]), 1), place(model, np.array([np.cos(7), np.sin(7)]), 1),
         1e-15)
    assert sp.sweep(mech, "hub", [0.0, 7.0, 20.0]).coordinate("hub").value[-1] == 20.0


@pytest.mark.parametrize(("joint", "says"), [
    (pin.JointModelTranslation(), "'pair' is a JointModelTranslation.*three prismatic"),
    (pin.JointModelSphericalZYX(), "'pair' is a JointModelSphericalZYX.*JointModelSpherical"),
    (pin.JointModelEllipsoid(0.1, 0.2, 0.3), "'pair' is a JointModelEllipsoid"),
    (composite(pin.JointModelPX(), pin.JointModelRX()), "Composite of .*PX.*one joint for each"),
    (composite(pin.JointModelRX(), pin.JointModelPX(), placement=at(0.1)), "Composite of"),
    (composite(pin.JointModelRX(), pin.JointModelSphericalZYX()), "Composite of"),
    (pin.JointModelUniversal(X, A), "axes are not perpendicular"),
])
def test_joints_that_are_no_pair_are_refused_by_name(joint, says):
    with pytest.raises(sp.SpatialPinError, match=says):
        from_model(one_joint(joint))


def test_a_mimicking_joint_gets_its_coordinate_and_a_coupling(tmp_path):
    model = pin.buildSampleModelManipulator(True)
    mech = from_model(model, name="copycat")
    (coupling,) = mech.closures
    assert coupling.joints == ("wrist1_joint", "wrist1_mimic_joint")
    assert (coupling.ratio, coupling.offset) == (2.5, 0.75)
    q = pin.randomConfiguration(model)
    own = np.append(q, 2.5 * q[-1] + 0.75)
    for i in range(1, model.njoints):
        near(place(mech.model, own, i), place(model, q, i), 1e-14)
    same_mechanisms(sp.load(mech.save(tmp_path)), mech)


@pytest.mark.parametrize("joint", [
    pin.JointModelRUBX, pin.JointModelPlanar, pin.JointModelSpherical, pin.JointModelFreeFlyer])
def test_a_configuration_of_the_model_may_be_the_guess(joint):
    model = one_joint(joint())
    pin.seed(5)
    q = pin.randomConfiguration(model, -np.ones(model.nq), np.ones(model.nq))
    model.referenceConfigurations["home"] = q
    mech = from_model(model, guess=q)
    for own in (sp.assemble(mech).q, mech.model.referenceConfigurations["home"]):
        for i in (1, 2):
            near(place(mech.model, own, i), place(model, q, i), 1e-14)
    copycat = pin.buildSampleModelManipulator(True)
    q = pin.randomConfiguration(copycat)
    found = sp.assemble(from_model(copycat, guess=q)).q
    near(found, np.append(q, 2.5 * q[-1] + 0.75), 1e-13)


def test_limits_resistance_and_gravity_are_kept(tmp_path):
    model = one_joint(
        pin.JointModelSpherical(), damping=np.array([0.1, 0.2, 0.3, 0.4]),
        armature=np.array([0.0, 0.0, 0.01, 0.02]), upperDryFrictionLimit=np.full(4, 0.5),
        lowerDryFrictionLimit=np.full(4, -0.5), upperEffortLimit=np.array([1.0, 2.0, 3.0, 4.0]),
        lowerEffortLimit=np.array([-1.0, -2.0, -3.0, -2.0]),
        lowerPositionLimit=np.array([-0.5] * 4 + [-1.0]),
        upperPositionLimit=np.array([0.5] * 3 + [np.inf] + [2.0]),
        upperVelocityLimit=np.array([1.0, 1.0, 1.0, 7.0]))
    model.gravity.linear = np.array([1.0, 2.0, -3.0])
    mech = from_model(model, name="one")
    model.lowerVelocityLimit = -model.upperVelocityLimit  # addJoint puts the upper there
    for side in ("lower", "upper"):  # and the largest number where there is none
        limits = getattr(model, f"{side}PositionLimit")
        limits[np.abs(limits) == np.finfo(float).max] *= 2.0
    same_models(mech.model, model)
    same_mechanisms(sp.load(mech.save(tmp_path)), mech)


@pytest.mark.parametrize(("more", "says"), [
    ({"damping": np.array([-1.0, 0.0])}, "'pair': damping is .* not negative"),
    ({"lowerPositionLimit": np.array([2.0, 0.0]), "upperPositionLimit": np.array([1.0, 1.0])},
     "'pair': its lower position limit"),
    ({"upperEffortLimit": np.array([0.0, np.nan])}, "'last': its lower effort limit"),
])
def test_impossible_numbers_are_refused_by_joint(more, says):
    with pytest.raises(sp.SpatialPinError, match=says):
        from_model(one_joint(pin.JointModelRX(), **more))


def spoilt(part):
    """A model with one number that is none."""
    model = one_joint(pin.JointModelRX())
    none = np.array([0.0, 0.0, np.nan])
    if part == "gravity":
        model.gravity.linear = none
    elif part == "armature":
        model.armature = np.array([0.0, np.nan])
    elif part == "placement":
        model.jointPlacements[1] = pin.SE3(np.eye(3), none)
    elif part == "frame":
        model.addFrame(pin.Frame("tool", 1, 0, pin.SE3(np.eye(3), none), pin.FrameType.OP_FRAME))
    else:
        model.inertias[1] = pin.Inertia(1.0, none, np.eye(3))
    return model


@pytest.mark.parametrize("part", ["gravity", "armature", "placement", "frame", "inertia"])
def test_a_model_with_a_number_that_is_none_is_refused(part):
    with pytest.raises(ValueError, match=f"{part}.* has a value that is NaN or infinite"):
        from_model(spoilt(part))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_parts_with_a_number_that_is_none_are_refused(value):
    with pytest.raises(ValueError, match="guess: 'pair' has a value that is NaN or infinite"):
        from_model(one_joint(pin.JointModelRX()), guess={"pair": value})
    for name in ("stiffness", "damping", "free_length", "free_angle"):
        with pytest.raises(ValueError, match=f"{name} of spring 's' has a value that is NaN"):
            sp.Spring("s", joint="pair", **{name: value})
    for name in ("xyz", "rpy"):
        with pytest.raises(ValueError, match=f"{name} of frame 'f' has a value that is NaN"):
            sp.Frame("f", "link", **{name: (0.0, value, 0.0)})


@pytest.mark.parametrize("ends", [{}, {"frames": ("a",)}, {"frames": ("a", "b"), "joint": "j"}])
def test_a_spring_acts_between_two_frames_or_at_a_joint(ends):
    with pytest.raises(ValueError, match="spring 's' needs either two frames or a joint"):
        sp.Spring("s", stiffness=1.0, **ends)


# ---------------------------------------------------------------- links and frames


def test_inertias_belong_to_links():
    model = pin.Model()
    i = model.addJoint(0, pin.JointModelRX(), at(), "pin")
    lump, tool = pin.Inertia.FromSphere(2.0, 0.1), pin.Inertia.FromBox(1.0, 0.1, 0.2, 0.3)
    model.appendBodyToJoint(i, lump, at(0.2))
    model.addBodyFrame("bar", i, at(0.0, 0.0, 0.1), 0)
    model.addFrame(pin.Frame("tool", i, 0, at(0.5), pin.FrameType.BODY, tool))
    mech = from_model(model)
    assert mech.inertias.keys() == {"bar", "tool"}
    assert mech.inertias["tool"] == tool
    near(mech.inertias["bar"].lever, [0.2, 0.0, -0.1], 1e-15)
    assert mech.inertias["bar"].mass == pytest.approx(2.0, rel=1e-15)
    near(mech.inertias["bar"].inertia, lump.inertia, 1e-15)
    same_inertias(list(mech.model.inertias), list(model.inertias), 1.0)
    state = sp.assemble(mech)
    near(state.com("bar").position, [0.2, 0.0, 0.0], 1e-15)
    near(state.com("tool").position, [0.5, 0.0, 0.0], 1e-15)


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_inertias_are_distinguished_at_any_size(unit):
    model = pin.Model()
    i = model.addJoint(0, pin.JointModelRX(), at(), "pin")
    near_one, far_one = pin.Inertia.FromBox(2.0, unit, 2 * unit, 3 * unit), pin.Inertia.FromBox(
        1.0, 0.1 * unit, 0.2 * unit, 0.3 * unit)
    disc = pin.Inertia(0.0, np.zeros(3), np.diag([0.2, 0.1, 0.1]) * unit**2)
    model.addFrame(pin.Frame("near", i, 0, at(0.5 * unit), pin.FrameType.BODY, near_one))
    model.addFrame(pin.Frame("far", i, 0, at(3 * unit), pin.FrameType.BODY, far_one))
    mech = from_model(model)
    assert mech.inertias == {"near": near_one, "far": far_one}
    model.appendBodyToJoint(i, disc, at())  # turns, and weighs nothing
    mech = from_model(model)
    assert mech.inertias["far"] == far_one and mech.inertias["near"].mass == 2.0
    near(mech.inertias["near"].inertia, near_one.inertia + disc.inertia, 1e-11 * unit**2)
    alone = pin.Model()
    alone.addJoint(0, pin.JointModelRX(), at(), "pin")
    alone.appendBodyToJoint(1, far_one, at(1e4 * unit))
    assert from_model(alone).inertias["pin"] == alone.inertias[1]


ODD = ["a b", 'say "x"', "\u00e4\u6f22", "<b>&'", "a.b", "x/y", "[k]", "1", "true", "#", "_"]


def test_odd_names_are_kept(tmp_path):
    model, on = pin.Model(), 0
    for name in ODD:
        on = model.addJoint(on, pin.JointModelRX(), at(0.1), name)
        model.appendBodyToJoint(on, pin.Inertia.FromSphere(1.0, 0.1), at())
        model.addFrame(pin.Frame(f"{name} tip", on, 0, at(0.0, 0.1), pin.FrameType.OP_FRAME))
    mech = from_model(model, [sp.closures.distance(f"{ODD[-1]} tip", f"{ODD[0]} tip", 0.5,
                                                   name=ODD[1])],
                      drivers={name: name for name in ODD}, guess=dict.fromkeys(ODD, 0.1),
                      name="a \"b\" c: [x] #")
    same_mechanisms(sp.load(mech.save(tmp_path)), mech)


def test_a_model_without_joints_is_a_mechanism(tmp_path):
    mech = from_model(pin.Model(), frames={"tip": ("world", at(0.1))})
    assert mech.links == ("world",) and mech.coordinates == ()
    same_mechanisms(sp.load(mech.save(tmp_path)), mech)


def test_what_the_joint_carries_is_what_counts():
    model = pin.Model()
    i = model.addJoint(0, pin.JointModelRX(), at(), "pin")
    model.addFrame(pin.Frame("bar", i, 0, at(), pin.FrameType.BODY,
                             pin.Inertia.FromSphere(2.0, 0.1)))
    model.inertias[i] = pin.Inertia.FromSphere(0.5, 0.1)  # as after a change of payload
    mech = from_model(model)
    assert mech.inertias["bar"] == model.inertias[i]
    model.inertias[i] = pin.Inertia.Zero()
    assert not from_model(model).inertias


def test_what_says_nothing_is_saved_as_nothing(tmp_path):
    text = four_bar().save(tmp_path).read_text()
    assert "[joints" not in text and "e+308" not in text
    urdf = (tmp_path / "bars.urdf").read_text()
    assert urdf.count('type="continuous"') == 3 and "<limit" not in urdf


def test_joints_without_frames_get_frames_and_links_of_their_names(tmp_path):
    mech = four_bar()
    assert mech.links == ("world", "crank", "coupler", "rocker")
    kinds = {(f.name, f.type) for f in mech.model.frames}
    assert {("crank", pin.FrameType.JOINT), ("crank", pin.FrameType.BODY)} <= kinds
    model = bars()
    model.addFrame(pin.Frame("crank", 1, 0, at(), pin.FrameType.OP_FRAME))
    model.addFrame(pin.Frame("tip", 2, 0, at(0.6, 0.0, 0.1, 0.1, 0.2, 0.3),
                             pin.FrameType.OP_FRAME))
    model.addFrame(pin.Frame("imu", 2, 0, at(0.1), pin.FrameType.SENSOR))
    model.addFrame(pin.Frame("plate", 3, 0, at(0.1), pin.FrameType.BODY))
    model.addFrame(pin.Frame("table", 0, 0, at(-0.1), pin.FrameType.BODY))
    mech = from_model(model, frames={"hand": ("tip", at(0.1))})
    assert mech.links[0] == "world" and {"plate", "table", "rocker"} < set(mech.links)
    assert mech.frames.keys() == {"tip", "imu", "hand"}  # that named as a joint is the joint's
    again = sp.load(mech.save(tmp_path))
    same_mechanisms(again, mech)
    near(again.frame_on_joint("hand")[1].homogeneous,
         (at(0.6, 0.0, 0.1, 0.1, 0.2, 0.3) * at(0.1)).homogeneous, 4e-15)


def test_two_frames_of_one_name_in_two_places_are_refused():
    model = bars()
    model.addFrame(pin.Frame("tip", 1, 0, at(0.1), pin.FrameType.OP_FRAME))
    model.addFrame(pin.Frame("tip", 2, 0, at(0.1), pin.FrameType.SENSOR))
    with pytest.raises(sp.SpatialPinError, match="two frames are named 'tip'"):
        from_model(model)


def test_names_that_are_taken_or_no_names_are_refused():
    with pytest.raises(sp.SpatialPinError, match=r"frames\.crank: .*already"):
        from_model(bars(), frames={"crank": ("rocker", at(0.1))})
    with pytest.raises(sp.SpatialPinError, match="no link, joint or frame 'rocer'; did you mean"):
        from_model(bars(), frames={"tip": ("rocer", at(0.1))})
    with pytest.raises(TypeError, match="is given as"):
        from_model(bars(), frames={"tip": ("rocker", [0.1, 0.0, 0.0])})
    twice = bars()
    twice.addJoint(0, pin.JointModelRX(), at(), "crank")
    with pytest.raises(sp.SpatialPinError, match="two joints are named 'crank'"):
        from_model(twice)
    twice.names[1] = "cra\nnk"
    with pytest.raises(sp.SpatialPinError, match="text that can be read"):
        from_model(twice)


@pytest.mark.parametrize("turn", [np.diag([1.0, 1.0, -1.0]), 2.0 * np.eye(3), np.eye(3) + np.eye(
    3, k=1)])
def test_a_placement_that_is_no_rotation_is_refused(turn):
    wrong = pin.SE3(turn, np.zeros(3))
    model = bars()
    model.jointPlacements[2] = wrong
    with pytest.raises(sp.SpatialPinError, match=r"joint '.*': its placement has a rotation that"):
        from_model(model)
    model = bars()
    model.addFrame(pin.Frame("tip", 1, 0, wrong, pin.FrameType.OP_FRAME))
    with pytest.raises(sp.SpatialPinError, match="frame 'tip' has a rotation that is none"):
        from_model(model)
    with pytest.raises(sp.SpatialPinError, match="frame 'tip': its placement has a rotation"):
        from_model(bars(), frames={"tip": ("crank", wrong)})


@pytest.mark.parametrize(("more", "error", "says"), [
    ({"drivers": {"motor": "crnk"}}, sp.SpatialPinError, r"drivers\.motor.*'crnk'; did you mean"),
    ({"drivers": "crank"}, TypeError, "drivers is a list"),
    ({"drivers": {"motor": 1}}, TypeError, "drivers is a dict"),
    ({"drivers": 3}, TypeError, "drivers is a list"),
    ({"guess": {"crnk": 0.1}}, sp.SpatialPinError, "guess: no joint.*did you mean"),
    ({"guess": [0.1]}, ValueError, r"guess has shape \(1,\)"),
    ({"guess": [0.1, 0.2, float("nan")]}, ValueError, "guess has a value"),
    ({"springs": [{"name": "s"}]}, TypeError, "list of sp.Spring"),
    ({"springs": [sp.Spring("s", frames=("crank", "nowhere"))]}, sp.SpatialPinError, "'nowhere'"),
    ({"passives": [sp.Passive("p", "nobody", ("crank", "rocker"))]}, sp.SpatialPinError, "nobody"),
    ({"name": 3}, TypeError, "name is text"), ({"name": "\ud800"}, TypeError, "name is text"),
    ({"frames": {"\ud800": ("crank", at(0.1))}}, sp.SpatialPinError, "can be read"),
    ({"frames": {"tip": ("\ud800", at(0.1))}}, sp.SpatialPinError, "no link, joint or frame"),
    ({"visual_model": "box"}, TypeError, "pin.GeometryModel"),
])
def test_other_mistakes_are_reported(more, error, says):
    with pytest.raises(error, match=says):
        from_model(bars(), **more)


def test_the_coordinates_of_a_tree_drive_it_unless_somebody_says_otherwise(tmp_path):
    for drivers, expected in ((None, ["crank", "coupler", "rocker"]), ([], []),
                              (["rocker"], ["rocker"])):
        mech = from_model(bars(), drivers=drivers)
        assert list(mech.drivers) == expected
        same_mechanisms(sp.load(mech.save(tmp_path / f"{len(expected)}")), mech)
    assert not from_model(bars(), [sp.closures.revolute(*ENDS)]).drivers


def test_a_model_is_needed():
    with pytest.raises(TypeError, match=r"a pin\.Model is needed, not Mechanism"):
        from_model(four_bar())


# ---------------------------------------------------------------- all that is asked of a mechanism


def test_the_model_is_copied():
    model, drawn = bars(), pin.GeometryModel()
    drawn.addGeometryObject(pin.GeometryObject("ball", 1, 0, at(), coal.Sphere(0.1)))
    before = model.saveToString()
    mech = from_model(model, [sp.closures.revolute(*ENDS)], guess=GUESS, visual_model=drawn)
    q = sp.assemble(mech).q.copy()
    assert model.saveToString() == before
    model.jointPlacements[2] = at(9.0)
    model.inertias[1] = pin.Inertia.Zero()
    model.gravity.linear = np.zeros(3)
    model.damping[:] = 3.0
    drawn.geometryObjects[0].geometry.radius = 7.0
    drawn.removeGeometryObject("ball")
    near(sp.assemble(mech).q, q, 0.0)
    assert mech.model.gravity.linear[2] == -9.81 and mech.model.inertias[1].mass == 1.0
    assert not mech.model.damping.any() and mech.visual_model.ngeoms == 1


def test_everything_works_on_it(tmp_path):
    mech = four_bar(springs=[sp.Spring("spring", ("coupler", ("world", at(0.1, -0.5))),
                                       stiffness=20.0)])
    loaded = bars_in_file()
    motion = sp.sweep(mech, "motor", np.linspace(0.0, 6.0, 25), speed=2.0)
    expected = sp.sweep(loaded, "motor", np.linspace(0.0, 6.0, 25), speed=2.0)
    near(motion.q, expected.q, 1e-13)
    near(motion.com("coupler").position, expected.com("coupler").position, 1e-13)
    assert str(sp.mobility(mech)).splitlines()[0] == str(sp.mobility(loaded)).splitlines()[0]
    assert sp.reduce(mech, "rocker").verify().worst < 1e-12
    assert sp.reduce(mech, "coupler", dynamics=True).verify().worst < 1e-12
    assert len(sp.assembly_modes(mech, {"motor": 0.5})) == 2
    assert sp.grashof(mech).type == sp.grashof(loaded).type
    state = sp.assemble(mech, {"motor": 1.0})
    assert np.all(np.isfinite(sp.forward_dynamics(mech, state).a))
    run = sp.simulate(mech, state, 0.1)
    assert np.abs(run.energy_drift).max() < 1e-8
    assert sp.export_html(motion, tmp_path / "a.html").stat().st_size > 1000
    assert sp.report(motion, tmp_path / "b.html").stat().st_size > 1000
    sp.plot(motion, ["rocker"], tmp_path / "c.svg")
    motion.to_csv(tmp_path / "d.csv")


def test_it_is_copied_and_sent_elsewhere():
    drawn = pin.GeometryModel()
    drawn.addGeometryObject(pin.GeometryObject("box", 1, 0, at(), coal.Box(0.1, 0.2, 0.3)))
    mech = four_bar(visual_model=drawn)
    q = sp.assemble(mech, {"motor": 1.0}).q
    for other in (pickle.loads(pickle.dumps(mech)), copy.copy(mech), copy.deepcopy(mech)):
        near(sp.assemble(other, {"motor": 1.0}).q, q, 0.0)
        same_mechanisms(other, mech)
        assert other.visual_model.ngeoms == 1


@pytest.mark.parametrize("ask", [
    lambda m, s: sp.sensitivity(m, s, "rocker", ["a"]),
    lambda m, s: sp.tolerance(m, "rocker", {"a": 0.01}, s),
])
def test_what_needs_dimensions_says_that_there_are_none(ask):
    mech = four_bar()
    assert mech.dimensions == {}
    with pytest.raises(sp.SpatialPinError, match=r"no file|no dimension"):
        ask(mech, sp.assemble(mech))


def test_shapes_are_saved_where_urdf_has_them(tmp_path):
    model = pin.buildSampleModelManipulator()
    drawn = pin.GeometryModel()
    drawn.addGeometryObject(pin.GeometryObject("ball", 6, 15, at(0.1), coal.Sphere(0.1)))
    drawn.addGeometryObject(pin.GeometryObject("box", 2, 0, at(0.1), coal.Box(0.1, 0.2, 0.3)))
    drawn.addGeometryObject(pin.GeometryObject("pill", 4, 0, at(0.1), coal.Capsule(0.1, 0.2)))
    drawn.addGeometryObject(pin.GeometryObject("tube", 3, 0, at(0.1), coal.Cylinder(0.1, 0.2)))
    for shape in drawn.geometryObjects:
        shape.meshColor = np.array([0.1, 0.2, 0.3, 0.5])
    mech = from_model(model, name="arm", visual_model=drawn)
    again = sp.load(mech.save(tmp_path))
    found, wanted = ({(type(o.geometry).__name__, o.parentJoint,
                       tuple(np.round(o.placement.homogeneous, 12).ravel()))
                      for o in m.visual_model.geometryObjects} for m in (again, mech))
    assert found == wanted
    near(again.visual_model.geometryObjects[0].meshColor, [0.1, 0.2, 0.3, 0.5], 1e-6)
    drawn.addGeometryObject(pin.GeometryObject("egg", 1, 0, at(), coal.Ellipsoid(0.1, 0.2, 0.3)))
    with pytest.warns(sp.SpatialPinWarning, match="visual 'egg' is a Ellipsoid"):
        assert from_model(model, visual_model=drawn).visual_model.ngeoms == drawn.ngeoms


def test_the_order_of_the_joints_is_saved(tmp_path):
    model = pin.Model()
    for name in ("z", "a", "m"):
        model.addJoint(0, pin.JointModelRX(), at(), name)
    mech = from_model(model, name="three")
    toml = mech.save(tmp_path)
    same_mechanisms(sp.load(toml), mech)
    assert tomllib.loads(toml.read_text(encoding="utf-8"))["order"] == ["z", "a", "m"]


def test_a_reduced_mechanism_keeps_the_order_of_its_joints(tmp_path):
    model = pin.Model()
    for name in ("rocker", "aside", "crank"):
        joint = model.addJoint(0, pin.JointModelRZ(), at(0.7 * (name == "rocker")), name)
        model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), at(0.1))
    rod = sp.closures.distance(("crank", at(0.3)), ("rocker", at(0.5)), 0.6)
    mech = from_model(model, [rod], drivers=["crank"], name="rod")
    reduced = sp.reduce(mech, "rocker")
    assert list(reduced.model.names)[1:] == ["rocker", "crank"]
    assert reduced.verify().worst < 1e-12
    same_mechanisms(sp.load(reduced.save(tmp_path)), reduced)


def test_a_closed_humanoid_is_saved_and_loaded(tmp_path):
    model = humanoid()
    ankle = sp.closures.distance("lleg_wrist2_joint", "rleg_wrist2_joint", 0.3)
    mech = from_model(model, [native(model, pin.ContactType.CONTACT_3D, name="grip"), ankle],
                      name="humanoid", drivers=["larm_elbow_joint", "chest1_joint"],
                      frames={"eyes": ("head2_joint", at(0.1, 0.0, 0.05))})
    again = sp.load(mech.save(tmp_path / "one"))
    same_mechanisms(again, mech)
    again.save(tmp_path / "two")
    for name in ("humanoid.toml", "humanoid.urdf"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()
    near(sp.assemble(again).q, sp.assemble(mech).q, 1e-12)


# ---------------------------------------------------------------- whatever the tree

JOINTS = [pin.JointModelRX, pin.JointModelPY, pin.JointModelSpherical, pin.JointModelFreeFlyer,
          pin.JointModelRUBZ, lambda: pin.JointModelHY(0.1), pin.JointModelPlanar,
          lambda: pin.JointModelUniversal(X, Z),
          lambda: pin.JointModelRevoluteUnaligned(A)]


@given(st.lists(st.tuples(st.integers(0, len(JOINTS) - 1), st.integers(0, 20), st.booleans(),
                          st.integers(0, 2**31)), min_size=1, max_size=7),
       st.permutations([f"j{k}" for k in range(7)]))
def test_any_tree_is_saved_and_loaded_as_it_was(tmp_path_factory, chosen, names):
    model = pin.Model()
    for k, (kind, on, with_link, seed) in enumerate(chosen):
        rng = np.random.default_rng(seed)
        joint = model.addJoint(on % (k + 1), JOINTS[kind](), random_place(rng), names[k])
        inertia = pin.Inertia.FromBox(*rng.uniform(0.1, 1.0, 4))
        if with_link:
            model.addFrame(pin.Frame(f"link{k}", joint, 0, random_place(rng), pin.FrameType.BODY,
                                     inertia))
        else:
            model.appendBodyToJoint(joint, inertia, random_place(rng))
    mech = from_model(model, name="any")
    same_inertias(list(mech.model.inertias), list(model.inertias), 1.0)
    assert list(mech.model.names) == list(model.names)
    same_mechanisms(sp.load(mech.save(tmp_path_factory.mktemp("any"))), mech)


def random_place(rng):
    return at(*rng.uniform(-1.0, 1.0, 3), *rng.uniform(-3.0, 3.0, 3))


# ---------------------------------------------------------------- couplings of large ratios


def lead_screw(ratio, driver, other_way=False):
    """Return a slide [m] that a motor [rad] moves, 1 m apart, coupled by motor = ratio · slide."""
    model = pin.Model()
    model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slide")
    model.addJoint(0, pin.JointModelRX(), pin.SE3(np.eye(3), np.array([1.0, 0.0, 0.0])), "motor")
    ends = ("motor", "slide", 1.0 / ratio) if other_way else ("slide", "motor", ratio)
    coupling = sp.closures.coupling(*ends[:2], ratio=ends[2])
    return sp.Mechanism.from_model(model, [coupling], drivers=[driver], name="lead screw")


@pytest.mark.parametrize("ratio", [3.0, 99.0, 101.0, 2e3, -6e4])
@pytest.mark.parametrize("driver", ["slide", "motor"])
@pytest.mark.parametrize("other_way", [False, True])
def test_a_coupling_of_any_ratio_is_exact(ratio, driver, other_way):
    """Whichever joint is driven, and whichever is stated first."""
    mechanism = lead_screw(ratio, driver, other_way)
    state = sp.solve_rates(mechanism, sp.assemble(mechanism, {driver: 0.3}), {driver: 2.0})
    of_slide = 0.3 if driver == "slide" else 0.3 / ratio
    slide, motor = state.coordinate("slide"), state.coordinate("motor")
    assert slide.value == pytest.approx(of_slide, rel=1e-15)
    assert motor.value == pytest.approx(ratio * of_slide, rel=1e-15)
    assert motor.rate == pytest.approx(ratio * slide.rate, rel=1e-15)
    motion = sp.sweep(mechanism, driver, [0.0, 0.001, 0.003], speed=2.0)
    slide, motor = motion.coordinate("slide"), motion.coordinate("motor")
    round_off = 1e-15 * abs(ratio)
    np.testing.assert_allclose(motor.value, ratio * slide.value, rtol=0.0, atol=round_off)
    np.testing.assert_allclose(motor.rate, ratio * slide.rate, rtol=1e-15)
    assert not motion.events and motion.closure_error.max() < 1e-13


@pytest.mark.parametrize("ratio", [1e2, 1e4, 1e6])
def test_a_coupling_beside_one_of_a_large_ratio_counts(ratio):
    """Two gears leave two of four hinges free, whatever their ratios."""
    model = pin.Model()
    for k, name in enumerate("abcd"):
        model.addJoint(0, pin.JointModelRZ(), pin.SE3(np.eye(3), np.array([k, 0.0, 0.0])), name)
    gears = [sp.closures.coupling("a", "b", ratio=ratio, name="fast"),
             sp.closures.coupling("c", "d", ratio=1.0, name="slow")]
    mechanism = sp.Mechanism.from_model(model, gears, drivers=["a", "c"], name="gears")
    mobility = sp.mobility(mechanism)
    assert (mobility.rank, mobility.dof, mobility.redundant) == (2, 2, ())
    state = sp.solve_rates(mechanism, sp.assemble(mechanism), {"a": 1.0, "c": 2.0})
    np.testing.assert_allclose(state.v, [1.0, ratio, 2.0, 2.0], rtol=1e-15)
