"""USD: bodies, joints and loops of UsdPhysics are those of the mechanism, units and all."""

import math
import sys
import warnings
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from folders import DATA

import spatial_pin as sp

pytest.importorskip("pxr")
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics

USD = DATA / "usd"
quiet = pytest.mark.filterwarnings("ignore::spatial_pin.errors.SpatialPinWarning")


class Scene:
    """A stage that is made prim by prim and loaded."""

    def __init__(self, folder: Path, metre: float = 1.0, up: str = "Z") -> None:
        self.path = folder / "s.usda"
        self.stage = Usd.Stage.CreateNew(str(self.path))
        UsdGeom.SetStageMetersPerUnit(self.stage, metre)
        UsdGeom.SetStageUpAxis(self.stage, getattr(UsdGeom.Tokens, up.lower()))

    def body(self, path: str, at=(0, 0, 0), turn=(1, 0, 0, 0), mass=1.0, scale=1.0, com=(0, 0, 0)):
        xform = UsdGeom.Xform.Define(self.stage, path)
        xform.AddTranslateOp().Set(Gf.Vec3d(*map(float, at)))
        xform.AddOrientOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Quatd(*map(float, turn)))
        xform.AddScaleOp().Set(Gf.Vec3f(scale))
        UsdPhysics.RigidBodyAPI.Apply(xform.GetPrim())
        if mass:
            api = UsdPhysics.MassAPI.Apply(xform.GetPrim())
            api.CreateMassAttr(mass)
            api.CreateCenterOfMassAttr(Gf.Vec3f(*map(float, com)))
            api.CreateDiagonalInertiaAttr(Gf.Vec3f(1.0, 1.0, 1.0))
        return xform.GetPrim()

    def joint(self, kind: str, path: str, one, two, at0=(0, 0, 0), at1=(0, 0, 0), axis="Z",
              turn0=(1, 0, 0, 0), turn1=(1, 0, 0, 0)):
        joint = getattr(UsdPhysics, kind).Define(self.stage, path)
        for rel, target in ((joint.CreateBody0Rel(), one), (joint.CreateBody1Rel(), two)):
            if target:
                rel.SetTargets([target])
        joint.CreateLocalPos0Attr(Gf.Vec3f(*map(float, at0)))
        joint.CreateLocalPos1Attr(Gf.Vec3f(*map(float, at1)))
        joint.CreateLocalRot0Attr(Gf.Quatf(*map(float, turn0)))
        joint.CreateLocalRot1Attr(Gf.Quatf(*map(float, turn1)))
        if hasattr(joint, "CreateAxisAttr"):
            joint.CreateAxisAttr(axis)
        return joint

    def load(self, **options) -> sp.Mechanism:
        self.stage.GetRootLayer().Save()
        return sp.load(self.path, **options)

    def drawn(self, path: str) -> pin.SE3:
        matrix = np.array(UsdGeom.XformCache().GetLocalToWorldTransform(
            self.stage.GetPrimAtPath(path)).RemoveScaleShear()).T
        return pin.SE3(matrix[:3, :3], matrix[:3, 3] * UsdGeom.GetStageMetersPerUnit(self.stage))


def gap(one: pin.SE3, two: pin.SE3) -> float:
    return float(np.abs(one.homogeneous - two.homogeneous).max())


# ---------------------------------------------------------------- a four-bar


def rocker_of(theta, a=0.1, b=0.28, c=0.24, d=0.3):
    """Freudenstein's equation solved for the rocker, the open branch."""
    k1, k2, k3 = d / a, d / c, (a * a - b * b + c * c + d * d) / (2 * a * c)
    x = np.cos(theta) - k1 - k2 * np.cos(theta) + k3
    y, z = -2 * np.sin(theta), k1 - (k2 + 1) * np.cos(theta) + k3
    return 2 * np.arctan2(-y - np.sqrt(y * y - 4 * x * z), 2 * x)


@pytest.fixture
def four_bar():
    with pytest.warns(sp.SpatialPinWarning) as told:
        mech = sp.load(USD / "four_bar.usda")
    assert any("cut at joint 'last_pin'" in str(w.message) for w in told)
    return mech


def test_four_bar_follows_freudensteins_equation(four_bar):
    assert [(c.name, c.type) for c in four_bar.closures] == [("last_pin", "revolute")]
    assert list(four_bar.drivers) == ["crank_pin"] and sp.mobility(four_bar).dof == 1
    angles = np.linspace(math.pi / 2, math.pi / 2 + 2 * math.pi, 25)
    rocker = sp.sweep(four_bar, "crank_pin", angles).coordinate("rocker_pin")[0]
    away = rocker - np.array([rocker_of(x) for x in angles])
    assert np.abs(away - 2 * math.pi * np.round(away / (2 * math.pi))).max() < 1e-12


def test_four_bar_is_assembled_as_the_file_draws_it(four_bar):
    state = sp.assemble(four_bar, {})
    assert state.released == {} or not state.released
    stage = Usd.Stage.Open(str(USD / "four_bar.usda"))
    for name in ("crank", "coupler", "rocker"):
        matrix = np.array(UsdGeom.XformCache().GetLocalToWorldTransform(
            stage.GetPrimAtPath(f"/four_bar/{name}")).RemoveScaleShear()).T
        drawn = pin.SE3(matrix[:3, :3], 0.01 * matrix[:3, 3])
        assert gap(state.placement(name), drawn) < 1e-7


def test_four_bar_has_the_masses_shapes_and_gravity_of_the_file_in_si(four_bar):
    assert four_bar.model.gravity.linear == pytest.approx([0.0, -1.625, 0.0])
    crank, coupler, rocker = (four_bar.inertias[x] for x in ("crank", "coupler", "rocker"))
    assert crank.mass == pytest.approx(0.1, rel=1e-15)
    assert crank.lever == pytest.approx([0.05, 0.0, 0.0], rel=1e-15)
    assert np.diag(crank.inertia) == pytest.approx([2e-6, 9e-5, 9e-5], rel=1e-14)
    assert coupler.mass == pytest.approx(0.028, rel=1e-6)  # 2 g/cm³ of 28 x 1 x 0.5 cm
    assert coupler.lever == pytest.approx([0.14, 0.0, 0.0], rel=1e-6)
    sides = np.array([0.28, 0.01, 0.005]) ** 2
    assert np.diag(coupler.inertia) == pytest.approx(0.028 / 12 * (sides.sum() - sides), rel=1e-5)
    assert rocker.lever == pytest.approx([0.12, 0.0, 0.0], rel=1e-15)  # in the prim's scale
    upper = four_bar.model.upperPositionLimit[four_bar.coordinate("rocker_pin").q]
    effort = four_bar.model.upperEffortLimit[four_bar.coordinate("crank_pin").v]
    assert upper == pytest.approx(math.pi, rel=1e-15) and effort == pytest.approx(2e-3)


@pytest.mark.parametrize("seed", range(2))
def test_a_skew_four_bar_in_numbers_of_32_bits_follows_freudenstein(tmp_path, seed):
    """Anywhere in space its redundant equations hold to the digits of the file only."""
    rng = np.random.default_rng(seed)
    scene, theta = Scene(tmp_path), 1.0
    phi = rocker_of(theta)
    tip = 0.1 * np.array([math.cos(theta), math.sin(theta), 0.0])
    end = np.array([0.3 + 0.24 * math.cos(phi), 0.24 * math.sin(phi), 0.0])
    beta = math.atan2(*(end - tip)[1::-1])
    q = rng.normal(size=4)
    plane = pin.SE3(pin.Quaternion(q / np.linalg.norm(q)).matrix(), rng.normal(size=3))
    pose = {"crank": (theta, np.zeros(3)), "coupler": (beta, tip),
            "rocker": (phi, np.array([0.3, 0.0, 0.0]))}
    own = {}  # the line of the bar, on its body
    for name, (angle, at) in pose.items():
        body = plane * pin.SE3(pin.utils.rotate("z", angle), at)
        skew = pin.SE3(pin.exp3(rng.normal(size=3)), 0.1 * rng.normal(size=3))
        own[name] = skew.inverse()
        body = body * skew
        turn = pin.Quaternion(body.rotation)
        scene.body(f"/{name}", body.translation, (turn.w, turn.x, turn.y, turn.z))

    def along(length):
        return pin.SE3(np.eye(3), np.array([length, 0.0, 0.0]))

    for name, one, place, two, at in (
            ("i", None, plane, "crank", 0.0), ("j", "crank", along(0.1), "coupler", 0.0),
            ("k", None, plane * along(0.3), "rocker", 0.0),
            ("l", "coupler", along(0.28), "rocker", 0.24)):
        frames = [own[one] * place if one else place, own[two] * along(at)]
        turns = [(t.w, t.x, t.y, t.z) for t in (pin.Quaternion(f.rotation) for f in frames)]
        scene.joint("RevoluteJoint", f"/{name}", f"/{one}" if one else None, f"/{two}",
                    *(f.translation for f in frames), turn0=turns[0], turn1=turns[1])
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        mech = scene.load()
        motion = sp.sweep(mech, "i", np.linspace(1.0, 3.0, 9))
    assert any("numbers are rounded" in str(w.message) for w in told)
    away = motion.coordinate("k")[0] - [rocker_of(x) for x in np.linspace(1.0, 3.0, 9)]
    assert np.abs(away - 2 * math.pi * np.round(away / (2 * math.pi))).max() < 1e-6


# ---------------------------------------------------------------- frames


def random_quaternion(rng):
    q = rng.normal(size=4)
    return tuple(np.float32(q / np.linalg.norm(q)))


@quiet
@pytest.mark.parametrize("seed", range(3))
def test_joint_frames_are_those_that_usds_own_parser_finds(tmp_path, seed):
    """Scaled bodies, targets below bodies, and numbers of 32 bits."""
    rng = np.random.default_rng(seed)
    scene = Scene(tmp_path, metre=0.1)
    UsdGeom.Xform.Define(scene.stage, "/w").AddScaleOp().Set(Gf.Vec3f(0.5))
    for k, name in enumerate("abc"):
        scene.body(f"/w/{name}", rng.normal(size=3), random_quaternion(rng), scale=1.0 + k)
    mount = UsdGeom.Xform.Define(scene.stage, "/w/b/mount")
    mount.AddTranslateOp().Set(Gf.Vec3d(1, 2, 3))
    scene.joint("FixedJoint", "/i", None, "/w/a", rng.normal(size=3), rng.normal(size=3),
                turn0=random_quaternion(rng), turn1=random_quaternion(rng))
    for name, one, two in (("j", "/w/a", "/w/b/mount"), ("k", "/w/b", "/w/c")):
        scene.joint("SphericalJoint", f"/{name}", one, two, rng.normal(size=3), rng.normal(size=3),
                    turn0=random_quaternion(rng), turn1=random_quaternion(rng))
    mech = scene.load()
    data = mech.model.createData()
    pin.framesForwardKinematics(mech.model, data, mech.neutral)
    parse = getattr(UsdPhysics, "UsdPhysicsLoadStageFromPrimRange", None)
    if parse is None:
        pytest.skip("this version of USD has no parser of its own")
    found = {}
    for kind, (paths, descriptions) in parse(scene.stage, ["/"]).items():
        if "Joint" not in str(kind):
            continue
        for path, joint in zip(paths, descriptions, strict=True):
            for body, position, turn in (
                    (joint.body0, joint.localPose0Position, joint.localPose0Orientation),
                    (joint.body1, joint.localPose1Position, joint.localPose1Orientation)):
                link = str(body).rpartition("/")[2] or mech.links[0]
                x, y, z = turn.GetImaginary()
                local = pin.SE3(pin.Quaternion(turn.GetReal(), x, y, z).normalized().matrix(),
                                0.1 * np.array(position, dtype=float))
                at = data.oMf[mech.frame_id(link)] * local
                found.setdefault(str(path), []).append(at)
    assert all(gap(*frames) < 1e-6 for frames in found.values()) and len(found) == 3
    for name in "jk":
        assert gap(found[f"/{name}"][0], data.oMf[mech.frame_id(name)]) < 1e-6


@quiet
def test_links_are_guessed_where_the_file_draws_them(tmp_path):
    """One joint of each kind, each away from its zero."""
    scene = Scene(tmp_path)
    at = pin.SE3.Identity()
    moved = {
        "RevoluteJoint": pin.SE3(pin.exp3(np.array([0.0, 0.0, 0.9])), np.zeros(3)),
        "PrismaticJoint": pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.3])),
        "SphericalJoint": pin.SE3(pin.exp3(np.array([0.3, -0.4, 0.8])), np.zeros(3)),
        "FixedJoint": pin.SE3.Identity(),
    }
    last, rng = None, np.random.default_rng(0)
    for k, (kind, motion) in enumerate(moved.items()):
        turn0, turn1 = random_quaternion(rng), random_quaternion(rng)
        frames = [pin.SE3(pin.Quaternion(*map(float, t)).normalized().matrix(), p)
                  for t, p in ((turn0, np.array([1.0, 0.5, 0.25])),
                               (turn1, np.array([0.5, 0.0, -0.25])))]
        at = at * frames[0] * motion * frames[1].inverse()
        q = pin.Quaternion(at.rotation)
        scene.body(f"/b{k}", at.translation, (q.w, q.x, q.y, q.z))
        scene.joint(kind, f"/j{k}", last, f"/b{k}", *(f.translation for f in frames),
                    turn0=turn0, turn1=turn1)
        last = f"/b{k}"
    mech = scene.load()
    state = sp.assemble(mech, {})
    for k in range(len(moved)):
        assert gap(state.placement(f"b{k}"), scene.drawn(f"/b{k}")) < 1e-6
    assert mech.guess["j0"] == pytest.approx(0.9, abs=1e-6)
    assert mech.guess["j2"] == pytest.approx([0.3, -0.4, 0.8], abs=1e-6)


@quiet
def test_animated_bodies_stand_where_their_animation_begins(tmp_path):
    scene = Scene(tmp_path)
    translate = UsdGeom.Xformable(scene.body("/a")).GetOrderedXformOps()[0]
    translate.GetAttr().Clear()
    for time, x in ((3.0, 7.0), (1.0, 5.0)):
        translate.Set(Gf.Vec3d(x, 0, 0), time)
    assert sp.assemble(scene.load(), {}).placement("a").translation.tolist() == [5.0, 0.0, 0.0]


def test_a_joint_written_from_child_to_parent_keeps_its_sign(tmp_path):
    scene = Scene(tmp_path)
    scene.body("/a")
    scene.body("/b", (-1, 0, 0))
    scene.joint("FixedJoint", "/hold", None, "/a")
    scene.joint("RevoluteJoint", "/j", "/b", "/a", at0=(1, 0, 0), axis="X")
    mech = scene.load()
    state = sp.assemble(mech, {"j": 0.4})
    assert np.allclose(state.placement("b").rotation, pin.utils.rotate("x", -0.4), atol=1e-15)
    assert state.placement("b").translation == pytest.approx([-1.0, 0.0, 0.0])


def test_links_drawn_away_from_their_joints_are_reported(tmp_path):
    scene = Scene(tmp_path)
    scene.body("/a", (0.5, 0, 0))
    scene.body("/b", (3, 0, 0))
    scene.joint("RevoluteJoint", "/i", None, "/a", at1=(-0.5, 0, 0))
    scene.joint("RevoluteJoint", "/j", "/a", "/b", at0=(0.5, 0, 0), at1=(-0.5, 0, 0))
    with pytest.warns(sp.SpatialPinWarning, match="not drawn where their joints hold them.*'j'"):
        mech = scene.load()
    assert sp.assemble(mech, {}).placement("b").translation == pytest.approx([1.5, 0.0, 0.0])


# ---------------------------------------------------------------- bases


def test_a_body_without_a_joint_to_the_world_floats_and_a_kinematic_one_is_held(tmp_path):
    scene = Scene(tmp_path, metre=0.01)
    prim = scene.body("/a", (100, 0, 0))
    with pytest.warns(sp.SpatialPinWarning, match="floats there: link 'a'"):
        mech = scene.load()
    assert mech.pairs == ("floating",)
    assert sp.assemble(mech, {}).placement("a").translation == pytest.approx([1.0, 0.0, 0.0])
    UsdPhysics.RigidBodyAPI(prim).CreateKinematicEnabledAttr(True)
    assert scene.load().pairs == ()


@pytest.mark.parametrize(("up", "expected"), [("Z", [0, 0, -9.81]), ("Y", [0, -9.81, 0])])
def test_without_a_scene_gravity_is_the_earths(tmp_path, up, expected):
    scene = Scene(tmp_path, up=up)
    scene.body("/a")
    scene.joint("RevoluteJoint", "/j", None, "/a")
    assert scene.load().model.gravity.linear.tolist() == expected
    UsdPhysics.Scene.Define(scene.stage, "/scene")  # says nothing: the earth's again
    assert scene.load().model.gravity.linear.tolist() == expected


def test_centimetres_are_assumed_aloud(tmp_path):
    path = tmp_path / "s.usda"
    path.write_text('#usda 1.0\ndef Xform "a" (prepend apiSchemas = ["PhysicsRigidBodyAPI"]) '
                    '{\ndouble3 xformOp:translate = (1, 0, 0)\n'
                    'uniform token[] xformOpOrder = ["xformOp:translate"]\n}\n'
                    'def PhysicsFixedJoint "j" {\nrel physics:body1 = </a>\n'
                    'point3f physics:localPos0 = (1, 0, 0)\n}\n', encoding="utf-8")
    with pytest.warns(sp.SpatialPinWarning, match="metersPerUnit is not stated"):
        mech = sp.load(path)
    assert mech.model.frames[mech.frame_id("a")].placement.translation[0] == 0.01


# ---------------------------------------------------------------- joints


def generic(scene, *locked):
    joint = scene.joint("Joint", "/j", None, "/a")
    for freedom in locked:
        api = UsdPhysics.LimitAPI.Apply(joint.GetPrim(), freedom)
        api.CreateLowAttr(1.0)
        api.CreateHighAttr(-1.0)
    return joint


ALL = ("transX", "transY", "transZ", "rotX", "rotY", "rotZ")


@quiet
@pytest.mark.parametrize(("free", "pair"), [
    ((), None), (("rotY",), "revolute"), (("transX",), "prismatic"),
    (("rotX", "rotY", "rotZ"), "spherical"), (("rotX", "rotZ"), "universal"),
    (("transY", "rotY"), "cylindrical"), (("transX", "transZ", "rotY"), "planar"),
    (ALL, "floating")])
def test_a_generic_joint_is_the_pair_of_its_free_axes(tmp_path, free, pair):
    scene = Scene(tmp_path)
    scene.body("/a")
    generic(scene, *(x for x in ALL if x not in free))
    mech = scene.load()
    assert mech.pairs == ((pair,) if pair else ())
    if pair in ("revolute", "prismatic", "cylindrical"):
        moved = sp.assemble(mech, {mech.coordinates[0]: 0.5}).placement("a")
        motion = pin.log6(moved).vector
        assert np.flatnonzero(np.abs(motion) > 1e-12).tolist() == [
            ALL.index(free[-1])]  # the angle goes first


@pytest.mark.parametrize("free", [("transX", "transY", "transZ"), ("transX", "rotY"),
                                  ("transX", "transY", "rotY")])
def test_a_generic_joint_that_is_no_pair_is_refused_by_name(tmp_path, free):
    scene = Scene(tmp_path)
    scene.body("/a")
    generic(scene, *(x for x in ALL if x not in free))
    with pytest.raises(sp.MechanismFileError, match=rf"s\.usda: /j: .*{', '.join(free)}"):
        scene.load()


def test_limits_armature_and_drives_are_in_si(tmp_path):
    scene = Scene(tmp_path, metre=0.01)
    UsdPhysics.SetStageKilogramsPerUnit(scene.stage, 0.5)
    scene.body("/a")
    scene.body("/b")
    for kind, name, one, two, freedom in (
            ("RevoluteJoint", "i", None, "/a", "angular"),
            ("PrismaticJoint", "j", "/a", "/b", "linear")):
        joint = scene.joint(kind, f"/{name}", one, two)
        joint.CreateLowerLimitAttr(-90.0)
        joint.CreateUpperLimitAttr(float("inf"))
        joint.GetPrim().CreateAttribute("physxJoint:armature", Sdf.ValueTypeNames.Float).Set(2.0)
        drive = UsdPhysics.DriveAPI.Apply(joint.GetPrim(), freedom)
        drive.CreateStiffnessAttr(5.0)
        drive.CreateMaxForceAttr(8.0)
    with pytest.warns(sp.SpatialPinWarning, match="no springs here: i, j"):
        mech = scene.load()
    assert list(mech.drivers) == ["i", "j"] and mech.springs == ()
    model = mech.model
    assert model.lowerPositionLimit == pytest.approx([-math.pi / 2, -0.9])
    assert np.all(model.upperPositionLimit > 1e300)
    assert model.armature == pytest.approx([2.0 * 0.5 * 1e-4, 2.0 * 0.5])
    assert model.upperEffortLimit == pytest.approx([8.0 * 0.5 * 1e-4, 8.0 * 0.5 * 1e-2])


@quiet
def test_a_driven_joint_is_not_cut_and_an_excluded_one_is(tmp_path):
    cuts = {}
    for case in ("plain", "driven", "excluded"):
        (tmp_path / case).mkdir()
        scene = Scene(tmp_path / case)
        for name, at in (("a", (0, 0, 1)), ("b", (1, 0, 1)), ("c", (1, 0, 0))):
            scene.body(f"/{name}", at)
        ends = (None, "/a", "/b", "/c")
        for k in range(3):
            scene.joint("RevoluteJoint", f"/j{k}", ends[k], ends[k + 1], axis="Y",
                        at0=((0, 0, 1), (1, 0, 0), (0, 0, -1))[k])
        last = scene.joint("RevoluteJoint", "/j3", "/c", None, axis="Y", at1=(1, 0, 0))
        if case == "driven":
            drive = UsdPhysics.DriveAPI.Apply(
                scene.stage.GetPrimAtPath(f"/{cuts['plain']}"), "angular")
            drive.CreateDampingAttr(1.0)
        if case == "excluded":
            last.CreateExcludeFromArticulationAttr(True)
        cuts[case] = scene.load().closures[0].name
    assert cuts["driven"] != cuts["plain"] and cuts["excluded"] == "j3"


@quiet
def test_distances_that_are_held_are_closures_and_bounds_are_omitted(tmp_path):
    scene = Scene(tmp_path, metre=0.1)
    scene.body("/a")
    scene.body("/b", (0, 5, 0))
    scene.joint("RevoluteJoint", "/i", None, "/a")
    scene.joint("RevoluteJoint", "/j", None, "/b", at0=(0, 5, 0))
    rod = scene.joint("DistanceJoint", "/rod", "/a", "/b", at0=(2, 0, 0), at1=(2, 0, 0))
    rod.CreateMinDistanceAttr(5.0)
    rod.CreateMaxDistanceAttr(5.0)
    closure, = scene.load().closures
    assert closure.type == "distance" and closure.geometry.length == 0.5
    rod.CreateMaxDistanceAttr(6.0)
    with pytest.warns(sp.SpatialPinWarning, match="'rod' bounds a distance"):
        assert scene.load().closures == ()


def two_hinges(folder):
    """Two bodies on hinges `i` and `j`; return the scene and the prim of the second hinge."""
    scene = Scene(folder)
    scene.body("/a")
    scene.body("/b")
    scene.joint("RevoluteJoint", "/i", None, "/a")
    prim = scene.joint("RevoluteJoint", "/j", None, "/b").GetPrim()
    return scene, prim


@quiet
def test_a_mimic_is_a_coupling(tmp_path):
    scene, prim = two_hinges(tmp_path)
    prim.AddAppliedSchema("PhysxMimicJointAPI:rotZ")
    for name, value in (("gearing", 2.0), ("offset", 30.0)):
        prim.CreateAttribute(f"physxMimicJoint:rotZ:{name}", Sdf.ValueTypeNames.Float).Set(value)
    prim.CreateRelationship("physxMimicJoint:rotZ:referenceJoint").SetTargets(["/i"])
    state = sp.assemble(scene.load(), {"i": 0.3})
    assert state.coordinate("j")[0] == pytest.approx(-2.0 * 0.3 - math.pi / 6, abs=1e-12)


@quiet
def test_joints_of_mujoco_between_two_bodies_are_in_series(tmp_path):
    """Their chain is the one that MuJoCo's own kinematics has."""
    mujoco = pytest.importorskip("mujoco")
    xml = """<mujoco><worldbody><body pos="0.1 0.2 0.3" euler="10 20 30">
      <joint name="i" axis="1 0 0" pos="0.1 0 0" damping="0.5"/><joint name="s" type="slide"
       axis="0 1 0" armature="2"/><joint name="k" axis="0 0 1" pos="0 0.3 0" stiffness="3"
       frictionloss="0.25"/><geom size="0.1"/></body></worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    w, x, y, z = data.xquat[1]
    scene = Scene(tmp_path)
    scene.body("/a", data.xpos[1], (w, x, y, z))
    body = pin.SE3(pin.Quaternion(w, x, y, z).matrix(), data.xpos[1].copy())
    for kind, name, axis, at in (("RevoluteJoint", "i", "X", [0.1, 0, 0]),
                                 ("PrismaticJoint", "s", "Y", [0, 0, 0]),
                                 ("RevoluteJoint", "k", "Z", [0, 0.3, 0])):
        prim = scene.joint(kind, f"/a/{name}", None, "/a", body.act(np.array(at, dtype=float)), at,
                           axis=axis, turn0=(w, x, y, z)).GetPrim()
        prim.AddAppliedSchema("MjcJointAPI")
        for word, value in {"i": {"damping": 0.5}, "s": {"armature": 2.0},
                            "k": {"stiffness": 3.0, "frictionloss": 0.25}}[name].items():
            prim.CreateAttribute(f"mjc:{word}", Sdf.ValueTypeNames.Double).Set(value)
    motor = scene.stage.DefinePrim("/motor", "MjcActuator")
    motor.CreateRelationship("mjc:target").SetTargets(["/a/k"])
    mech = scene.load()
    assert mech.coordinates == ("i", "s", "k") and list(mech.drivers) == ["k"]
    data.qpos[:] = [0.4, 0.2, -0.7]
    mujoco.mj_kinematics(model, data)
    state = sp.assemble(mech, {"i": 0.4, "s": 0.2, "k": -0.7})
    assert np.abs(state.placement("a").translation - data.xpos[1]).max() < 1e-6
    assert np.abs(state.placement("a").rotation.ravel() - data.xmat[1]).max() < 1e-6
    assert mech.model.damping.tolist() == [0.5, 0.0, 0.0]
    assert mech.model.armature.tolist() == [0.0, 2.0, 0.0]
    assert mech.model.upperDryFrictionLimit.tolist() == [0.0, 0.0, 0.25]
    assert [(s.joint, s.stiffness) for s in mech.springs] == [("k", 3.0)]


@quiet
def test_a_coupling_of_mujoco_counts_in_radians(tmp_path):
    scene, prim = two_hinges(tmp_path)
    prim.AddAppliedSchema("MjcEqualityJointAPI")
    for name, value in (("mjc:coef0", 0.5), ("mjc:coef1", 1.5)):
        prim.CreateAttribute(name, Sdf.ValueTypeNames.Double).Set(value)
    prim.CreateRelationship("mjc:target").SetTargets(["/i"])
    state = sp.assemble(scene.load(), {"i": 0.3})
    assert state.coordinate("j")[0] == pytest.approx(0.5 + 1.5 * 0.3, abs=1e-12)


@quiet
def test_a_mimic_of_newton_counts_the_other_way(tmp_path):
    scene, prim = two_hinges(tmp_path)
    prim.AddAppliedSchema("NewtonMimicAPI")
    prim.AddAppliedSchema("MjcEqualityJointAPI")
    for name, value in (("newton:mimicCoef0", 30.0), ("newton:mimicCoef1", 2.0)):
        prim.CreateAttribute(name, Sdf.ValueTypeNames.Float).Set(value)
    prim.CreateRelationship("newton:mimicJoint").SetTargets(["/i"])
    state = sp.assemble(scene.load(), {"i": 0.3})
    assert state.coordinate("j")[0] == pytest.approx(2.0 * 0.3 + math.pi / 6, abs=1e-12)
    prim.CreateAttribute("mjc:coef2", Sdf.ValueTypeNames.Double).Set(0.5)
    with pytest.raises(sp.MechanismFileError, match=r"/j: MjcEqualityJointAPI: .*higher order"):
        scene.load()


def test_tendons_are_reported(tmp_path):
    scene = Scene(tmp_path)
    scene.body("/a")
    scene.joint("RevoluteJoint", "/j", None, "/a").GetPrim().AddAppliedSchema(
        "PhysxTendonAxisAPI:t")
    with pytest.warns(sp.SpatialPinWarning, match="tendons pull on /j: they are left out"):
        scene.load()


@quiet
def test_three_revolutes_through_a_point_on_bodies_without_mass_are_a_ball(tmp_path):
    scene = Scene(tmp_path)
    scene.body("/bar", (1, 0, 0))
    for name in "xy":
        scene.body(f"/{name}", mass=0.0)
    for name, one, two, axis in (("i", None, "/x", "X"), ("j", "/x", "/y", "Y"),
                                 ("k", "/y", "/bar", "Z")):
        at1 = (-1, 0, 0) if two == "/bar" else (0, 0, 0)
        scene.joint("RevoluteJoint", f"/{name}", one, two, at1=at1, axis=axis)
    assert scene.load().coordinates == ("i", "j", "k")  # in no loop: they keep their names
    scene.joint("SphericalJoint", "/end", None, "/bar", at0=(2, 0, 0), at1=(1, 0, 0))
    mech = scene.load()
    assert sorted([*mech.pairs, *(c.type for c in mech.closures)]) == ["spherical", "spherical"]


# ---------------------------------------------------------------- inertias and shapes


@pytest.mark.parametrize(("kind", "volume", "about", "across"), [
    ("Sphere", 4 / 3 * math.pi * 0.2 ** 3, 0.4 * 0.2 ** 2, 0.4 * 0.2 ** 2),
    ("Cylinder", math.pi * 0.2 ** 2 * 0.6, 0.5 * 0.2 ** 2, 0.2 ** 2 / 4 + 0.6 ** 2 / 12)])
def test_masses_come_from_densities_of_simple_shapes(tmp_path, kind, volume, about, across):
    scene = Scene(tmp_path, metre=0.1)
    prim = scene.body("/a", mass=0.0, scale=2.0)
    shape = getattr(UsdGeom, kind).Define(scene.stage, "/a/shape")
    shape.CreateRadiusAttr(1.0)
    if kind == "Cylinder":
        shape.CreateHeightAttr(3.0)
        shape.CreateAxisAttr("X")
    shape.AddTranslateOp().Set(Gf.Vec3d(0, 1, 0))
    UsdPhysics.CollisionAPI.Apply(shape.GetPrim())
    UsdPhysics.MassAPI.Apply(prim).CreateDensityAttr(3.0)  # kg per cubic decimetre
    scene.joint("RevoluteJoint", "/j", None, "/a")
    inertia = scene.load().inertias["a"]
    assert inertia.mass == pytest.approx(3000.0 * volume, rel=1e-6)
    assert inertia.lever == pytest.approx([0.0, 0.2, 0.0], abs=1e-7)
    assert np.diag(inertia.inertia) == pytest.approx(
        inertia.mass * np.array([about, across, across]), rel=1e-5)


def test_principal_axes_turn_the_moments(tmp_path):
    scene = Scene(tmp_path)
    prim = scene.body("/a", mass=2.0)
    api = UsdPhysics.MassAPI(prim)
    api.CreateDiagonalInertiaAttr(Gf.Vec3f(1, 2, 2.5))
    half = math.sqrt(0.5)
    api.CreatePrincipalAxesAttr(Gf.Quatf(half, 0, 0, half))  # a quarter turn about z
    scene.joint("RevoluteJoint", "/j", None, "/a")
    assert np.allclose(scene.load().inertias["a"].inertia, np.diag([2.0, 1.0, 2.5]), atol=1e-15)


def test_shapes_are_drawn_and_meshes_are_reported(tmp_path):
    scene = Scene(tmp_path, metre=0.01)
    scene.body("/a", (10, 0, 0), scale=2.0)
    cube = UsdGeom.Cube.Define(scene.stage, "/a/cube")
    cube.CreateSizeAttr(3.0)
    cube.CreateDisplayColorAttr([Gf.Vec3f(1, 0, 0)])
    cube.AddTranslateOp().Set(Gf.Vec3d(0, 0, 5))
    cube.AddScaleOp().Set(Gf.Vec3f(1, 2, -3))
    UsdGeom.Mesh.Define(scene.stage, "/a/mesh")
    scene.joint("RevoluteJoint", "/j", None, "/a", at0=(10, 0, 0))
    with pytest.warns(sp.SpatialPinWarning, match=r"1 shape\(s\) of 'a' are not drawn"):
        mech = scene.load()
    shape, = mech.visual_model.geometryObjects
    assert shape.placement.translation == pytest.approx([0.0, 0.0, 0.1])
    assert 2 * shape.geometry.halfSide == pytest.approx([0.06, 0.12, 0.18])
    assert shape.meshColor.tolist() == [1.0, 0.0, 0.0, 1.0]


# ---------------------------------------------------------------- files


@pytest.mark.parametrize("ending", [".usda", ".usdc", ".usd", ".usdz"])
def test_all_endings_of_usd_are_read(tmp_path, ending):
    scene = Scene(tmp_path)
    scene.body("/a")
    scene.joint("RevoluteJoint", "/j", None, "/a")
    target = tmp_path / f"t{ending}"
    if ending == ".usdz":
        from pxr import UsdUtils

        scene.stage.GetRootLayer().Save()
        assert UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath(str(scene.path)), str(target))
    else:
        scene.stage.GetRootLayer().Export(str(target))
    assert sp.load(target).coordinates == ("j",)


def test_names_that_are_written_twice_become_paths(tmp_path):
    scene = Scene(tmp_path)
    for side in ("left", "right"):
        scene.body(f"/{side}/arm")
        scene.joint("RevoluteJoint", f"/{side}/pin", None, f"/{side}/arm")
    mech = scene.load()
    assert mech.coordinates == ("left/pin", "right/pin") and "right/arm" in mech.links


def test_files_from_elsewhere_are_read_on_trust_only(tmp_path):
    (tmp_path / "far").mkdir()
    (tmp_path / "near").mkdir()
    far = Scene(tmp_path / "far")
    far.body("/robot/a")
    far.joint("RevoluteJoint", "/robot/j", None, "/robot/a")
    far.stage.SetDefaultPrim(far.stage.GetPrimAtPath("/robot"))
    far.stage.GetRootLayer().Save()
    near = Scene(tmp_path / "near")
    prim = near.stage.DefinePrim("/r")
    prim.GetReferences().AddReference("../far/s.usda")
    with pytest.raises(sp.MechanismFileError, match="trusted=True"):
        near.load()
    assert near.load(trusted=True).coordinates == ("j",)


@quiet
def test_bodies_of_an_instance_are_read(tmp_path):
    scene = Scene(tmp_path)
    scene.body("/proto/a")
    scene.joint("RevoluteJoint", "/proto/j", None, "/proto/a")
    scene.stage.GetPrimAtPath("/proto").SetActive(True)
    copy = scene.stage.DefinePrim("/copy")
    copy.GetReferences().AddInternalReference("/proto")
    copy.SetInstanceable(True)
    assert sorted(scene.load().coordinates) == ["copy/j", "proto/j"]


@pytest.mark.parametrize(("change", "named"), [
    (lambda s: s.stage.DefinePrim("/gear", "PhysxPhysicsGearJoint"), "PhysxPhysicsGearJoint"),
    (lambda s: s.stage.GetPrimAtPath("/j").AddAppliedSchema("OtherMimicAPI"), "OtherMimicAPI"),
    (lambda s: s.stage.GetPrimAtPath("/j").AddAppliedSchema("MjcEqualityJointAPI"), "mjc:target"),
    (lambda s: UsdPhysics.Joint.Get(s.stage, "/j").GetBody1Rel().SetTargets(["/none"]), "/none"),
    (lambda s: UsdGeom.Xformable(s.stage.GetPrimAtPath("/a")).GetOrderedXformOps()[2].Set(
        Gf.Vec3f(1, 1, -1)), "mirrored"),
    (lambda s: UsdPhysics.RevoluteJoint.Get(s.stage, "/j").CreateLowerLimitAttr(float("nan")),
     "lowerLimit is nan"),
    (lambda s: UsdPhysics.MassAPI.Get(s.stage, "/a").CreateMassAttr(float("inf")), "mass is inf"),
    (lambda s: UsdPhysics.RevoluteJoint.Get(s.stage, "/j").CreateAxisAttr("W"), "'W'"),
    (lambda s: UsdPhysics.RevoluteJoint.Get(s.stage, "/j").CreateLocalRot0Attr(
        Gf.Quatf(float("nan"), 0, 0, 0)), "localRot0 is (nan, 0, 0, 0)"),
    (lambda s: UsdPhysics.MassAPI.Get(s.stage, "/a").CreatePrincipalAxesAttr(
        Gf.Quatf(float("inf"), 1, 0, 0)), "principalAxes is (inf, 1, 0, 0)"),
    (lambda s: UsdGeom.Xformable(s.stage.GetPrimAtPath("/a")).GetOrderedXformOps()[1].Set(
        Gf.Quatd(float("nan"), 0, 0, 0)), "orient is (nan, 0, 0, 0)"),
    (lambda s: s.stage.RemovePrim("/a"), "no rigid body"),
    (lambda s: UsdGeom.SetStageMetersPerUnit(s.stage, 0.0), "metersPerUnit"),
], ids=lambda x: x if isinstance(x, str) else "")
def test_what_cannot_be_read_is_refused_by_name(tmp_path, change, named):
    scene = Scene(tmp_path)
    scene.body("/a")
    scene.joint("RevoluteJoint", "/j", None, "/a")
    change(scene)
    with pytest.raises(sp.MechanismFileError, match=r"s\.usda") as refused:
        scene.load()
    assert named in str(refused.value)


def test_without_openusd_the_package_to_install_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "pxr", None)
    with pytest.raises(sp.MechanismFileError, match=r"pip install 'spatial_pin\[usd\]'"):
        sp.load(USD / "four_bar.usda")


def test_text_nested_so_deep_that_it_would_end_the_process_is_refused(tmp_path):
    path = tmp_path / "s.usda"
    path.write_text("#usda 1.0\n" + 'def Xform "a" {\n' * 1001 + "}\n" * 1001, encoding="utf-8")
    with pytest.raises(sp.MechanismFileError, match=r"s\.usda: more than 1000 prims within"):
        sp.load(path)


@pytest.mark.parametrize("content", [
    b"", b"#usda 1.0\nxxx {", b"#usda 1.0\ncaf\xe9", b"PXR-USDC" + bytes(200)])
@pytest.mark.parametrize("ending", [".usda", ".usdc", ".usdz"])
def test_what_is_no_usd_is_refused(tmp_path, ending, content):
    path = tmp_path / f"s{ending}"
    path.write_bytes(content)
    with pytest.raises(sp.MechanismFileError, match=r"s\.usd"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        sp.load(path)
