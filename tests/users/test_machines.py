"""The machines of the examples answer as closed forms and published numbers do.

Each script is run once; what it worked out is compared with geometry and mechanics that are written
here anew: circles and spheres that meet, moments about pins, virtual work, ordinary integration.
"""

import contextlib
import dataclasses
import functools
import io
import runpy
import sys

import numpy as np
import pinocchio as pin
import pytest
from folders import ROOT
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import spatial_pin as sp

EXAMPLES = ROOT / "examples"


@functools.cache
def ran(name: str, folder: str) -> dict:
    """Run an example without its pictures; return what its names stand for, and what is printed."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", [name, folder])
        patch.setattr(sp, "screenshot", lambda *arguments, **keywords: None)
        with contextlib.redirect_stdout(io.StringIO()) as printed:
            made = runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
    return made | {"printed": printed.getvalue()}


@pytest.fixture
def run(tmp_path_factory):
    """Give what runs an example; tests of those whose extra packages are not there are skipped."""
    folder = str(tmp_path_factory.getbasetemp() / "made")

    def runner(name):
        try:
            return ran(name, folder)
        except (SystemExit, sp.MechanismFileError) as missing:
            if "pip install 'spatial_pin[" not in str(missing):
                raise
            pytest.skip(str(missing))

    return runner


def meet(centre_1, radius_1, centre_2, radius_2, side):
    """Return where two circles meet, left (1) or right (-1) of the way from 1 to 2."""
    way = np.subtract(centre_2, centre_1)
    d = np.hypot(*way)
    along = (radius_1**2 - radius_2**2 + d**2) / (2 * d)
    across = side * np.sqrt(radius_1**2 - along**2)
    return np.asarray(centre_1) + (along * way + across * np.array([-way[1], way[0]])) / d


@pytest.mark.parametrize("script", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.stem)
def test_one_machine_is_studied_in_less_than_sixty_lines(script):
    if (EXAMPLES / "machines" / f"{script.stem}.toml").exists():
        assert len(script.read_text(encoding="utf-8").splitlines()) < 60


# ---------------------------------------------------------------- Jansen's leg

def jansen_foot(crank):
    """Return where the foot is [cm], from circles that meet."""
    tip, pin = 15.0 * np.array([np.cos(crank), np.sin(crank)]), np.array([-38.0, -7.8])
    top = meet(tip, 50.0, pin, 41.5, -1)
    knee = meet(tip, 61.9, pin, 39.3, 1)
    back = meet(top, 55.8, pin, 40.1, -1)
    heel = meet(back, 39.4, knee, 36.7, -1)
    return meet(heel, 65.7, knee, 49.0, -1)


def test_the_foot_of_jansens_leg_is_where_circles_meet(run):
    made = run("jansen_leg")
    wanted = np.array([jansen_foot(crank) for crank in made["motion"].driver[:-1]])
    assert abs(100 * made["foot"][:, [0, 2]] - wanted).max() < 1e-11
    assert abs(made["foot"][:, 1]).max() < 1e-14


# ---------------------------------------------------------------- double wishbone

def turned(point, base, axis, angle):
    """Return a point turned about the line through a base (Rodrigues)."""
    n, r = axis / np.linalg.norm(axis), point - base
    return base + (r * np.cos(angle) + np.cross(n, r) * np.sin(angle)
                   + n * (n @ r) * (1 - np.cos(angle)))


def on_circle(point, base, axis, centre, radius):
    """Return a point turned about a line until it is at a distance, the nearer of both ways.

    E sin a + F cos a + G = 0, solved by half angles.
    """
    n = axis / np.linalg.norm(axis)
    r, d = point - base, centre - base
    across = r - n * (n @ r)
    e, f = -2 * d @ np.cross(n, r), -2 * d @ across
    g = r @ r + d @ d - radius**2 - 2 * (d @ n) * (n @ r)
    root = np.sqrt(e**2 + f**2 - g**2)
    angles = [2 * np.arctan2(-e + s * root, g - f) for s in (1, -1)]
    angles = [(a + np.pi) % (2 * np.pi) - np.pi for a in angles]
    return turned(point, base, axis, min(angles, key=abs))


def three_spheres(centres, radii, near):
    """Return where three spheres meet, the one of both places nearer to a point."""
    a, b, c = centres
    x = (b - a) / np.linalg.norm(b - a)
    i = x @ (c - a)
    y = (c - a - i * x) / np.linalg.norm(c - a - i * x)
    d, j = np.linalg.norm(b - a), y @ (c - a)
    u = (radii[0]**2 - radii[1]**2 + d**2) / (2 * d)
    v = (radii[0]**2 - radii[2]**2 + i**2 + j**2) / (2 * j) - i / j * u
    w = np.sqrt(radii[0]**2 - u**2 - v**2)
    places = [a + u * x + v * y + s * w * np.cross(x, y) for s in (1, -1)]
    return min(places, key=lambda p: np.linalg.norm(p - near))


def wishbone_angles(angle, rack_z=0.233):
    """Return camber, toe-in and caster [degrees] of the suspension, from spheres that meet."""
    front, rear, ball = np.array([[0.15, 0.36, 0.2], [-0.2, 0.36, 0.19], [0.005, 0.69, 0.18]])
    above = np.array([[0.12, 0.43, 0.45], [-0.15, 0.43, 0.435], [-0.02, 0.645, 0.465]])
    rack, steer = np.array([-0.12, 0.37, rack_z]), np.array([-0.135, 0.68, 0.225])
    low = turned(ball, rear, front - rear, angle)
    kingpin = np.linalg.norm(above[2] - ball)
    top = on_circle(above[2], above[1], above[0] - above[1], low, kingpin)
    end = three_spheres([low, top, rack], [np.linalg.norm(steer - p)
                                           for p in (ball, above[2], rack)], steer)
    axes = [np.column_stack([t - b, e - b, np.cross(t - b, e - b)])
            for b, t, e in ((ball, above[2], steer), (low, top, end))]
    axle = axes[1] @ np.linalg.inv(axes[0]) @ [0, 1, 0]
    k = top - low
    return np.degrees([-np.arcsin(axle[2]), np.arctan2(axle[0], axle[1]),
                       np.arctan2(-k[0], k[2])])


def test_the_wheel_of_a_double_wishbone_stands_where_spheres_meet(run):
    made = run("double_wishbone")
    wanted = np.array([wishbone_angles(a) for a in made["motion"].driver]).T
    for name, x in zip(("camber", "toe-in", "caster"), wanted, strict=True):
        assert made["angles"][name] == pytest.approx(x, abs=1e-11)


def test_a_force_on_the_hub_of_a_double_wishbone_works_as_much_as_the_arm(run):
    made = run("double_wishbone")
    car, state = made["motion"].mechanism, made["motion"].state(20)
    held = sp.inverse_dynamics(car, state).efforts["wheel"]
    lift = state.velocity("hub").linear[2]
    load = {"hub": pin.Force(np.array([0, 0, 3430.0]), np.zeros(3))}
    pushed = sp.inverse_dynamics(car, state, external=load).efforts["wheel"]
    assert held - pushed == pytest.approx(3430.0 * lift, rel=1e-12)


# ---------------------------------------------------------------- engine

@pytest.mark.slow
def test_four_cylinders_shake_as_lanchester_says_and_not_at_all_with_his_shafts(run):
    made = run("balanced_engine")
    r, length = 0.043, 0.145
    solids = [(0.033, 0.024, 0.0), (0.008, length - 0.02, (length + 0.02) / 2),
              (0.016, 0.024, length)]  # of a rod: radius, length, place
    masses = [7850 * np.pi * a**2 * b for a, b, _ in solids]
    at_pin = sum(m * x / length for m, (_, _, x) in zip(masses, solids, strict=True))
    ratio = r / length
    second = ratio + ratio**3 / 4 + 15 * ratio**5 / 128 + 35 * ratio**7 / 512
    fourth = -(ratio**3 / 4 + 3 * ratio**5 / 16 + 35 * ratio**7 / 256)
    unit = 4 * (0.5 + at_pin) * r * made["speed"]**2
    found = made["harmonics"].real
    assert found[2] == pytest.approx(unit * second, rel=1e-4)  # the series leaves off at ratio^9
    assert found[4] == pytest.approx(unit * fourth, rel=2e-3)
    assert abs(found[[1, 3, 5]]).max() < 1e-12 * found[2]
    assert abs(made["left"][2]) < 1e-13 * found[2]
    assert made["left"][4].real == pytest.approx(found[4], rel=1e-11)


# ---------------------------------------------------------------- ankle

def pitched_and_rolled(point, pitch, roll):
    """Return where a point of the foot is: roll about x first, then pitch about y."""
    x, y, z = point
    y, z = y * np.cos(roll) - z * np.sin(roll), y * np.sin(roll) + z * np.cos(roll)
    return np.array([x * np.cos(pitch) + z * np.sin(pitch), y,
                     z * np.cos(pitch) - x * np.sin(pitch)])


def ankle_motors(pitch, roll):
    """Return both motors' angles [rad], from circles of crank tips that meet spheres."""
    found = []
    for y, z in ((0.035, 0.26), (-0.035, 0.16)):
        ball = pitched_and_rolled([-0.045, y, 0.0], pitch, roll)
        tip = on_circle(np.array([-0.045, y, z]), np.array([0, y, z]), np.array([0, 1.0, 0]),
                        ball, z)
        found.append(np.arctan2(tip[2] - z, -tip[0]))
    return np.array(found)


def test_motors_of_the_ankle_stand_and_pull_as_spheres_and_virtual_work_say(run):
    made, h = run("parallel_ankle"), 1e-5
    for pitch, roll, state, ratios, torques in made["table"]:
        at = np.radians([pitch, roll])
        motors = [state.coordinate(name).value for name in made["names"]]
        assert motors == pytest.approx(ankle_motors(*at), abs=1e-12)
        slopes = np.transpose([(ankle_motors(*(at + s)) - ankle_motors(*(at - s))) / (2 * h)
                               for s in h * np.eye(2)])
        assert ratios == pytest.approx(slopes, abs=1e-8)
        lift = [(pitched_and_rolled([0.12, 0, -0.07], *(at + s))[2]
                 - pitched_and_rolled([0.12, 0, -0.07], *(at - s))[2]) / (2 * h)
                for s in h * np.eye(2)]
        own = sp.inverse_dynamics(made["ankle"], state).efforts  # the weight of its parts
        given = [torques[name] - own[name] for name in made["names"]]
        assert slopes.T @ given == pytest.approx(-60 * 9.81 * np.array(lift), abs=1e-6)


# ---------------------------------------------------------------- Hoberman's ring

def test_hobermans_ring_is_as_wide_as_its_angle_says(run):
    made = run("hoberman_ring")
    x, half, a = -made["motion"].driver, np.pi / 8, 0.5
    middle = a * np.cos(x) / np.sin(half)
    assert made["guides"] == pytest.approx(np.tile(middle, (8, 1)), abs=1e-13)
    outer = (middle + a * np.sin(x - half)) / np.cos(half)
    inner = (middle - a * np.sin(x + half)) / np.cos(half)
    assert made["outer"] == pytest.approx(2 * outer, abs=1e-13)
    assert made["inner"] == pytest.approx(2 * inner, abs=1e-13)
    assert (made["mobility"].dof, made["bent"].dof) == (1, 0)


def test_a_ring_of_sixteen_loops_is_regular_wherever_it_stands(run):
    """Nothing has to hold it: its centre of mass stays where it is."""
    made = run("hoberman_ring")
    for row in range(0, 121, 8):
        state = made["motion"].state(row)
        assert abs(sp.inverse_dynamics(made["ring"], state).efforts["opening"]) < 1e-11


# ---------------------------------------------------------------- door closer

def closer_angles(door):
    """Return angles of the closer's shaft and rod [rad], from circles that meet."""
    shaft = np.array([0.15, -0.08])
    shoe = 0.45 * np.array([np.cos(door), np.sin(door)])
    shoe += 0.04 * np.array([-np.sin(door), np.cos(door)])
    elbow = meet(shaft, 0.28, shoe, 0.34, -1)
    return np.array([np.arctan2(*(elbow - shaft)[::-1]), np.arctan2(*(shoe - elbow)[::-1])])


def closing(door, rate, inertias, law):
    """Return the door's acceleration, by Lagrange's equation of one freedom."""
    h = 1e-4

    def turning(angle):
        """Return rates of shaft and rod per unit of the door's, and the inertia it feels."""
        shaft, rod = ((-closer_angles(angle + 2 * h) + 8 * closer_angles(angle + h)
                       - 8 * closer_angles(angle - h) + closer_angles(angle - 2 * h)) / (12 * h))
        a, b = closer_angles(angle)
        (_, _, at_door), (_, _, at_arm), (m, x, at_rod) = inertias
        v = 0.28 * shaft * np.array([-np.sin(a), np.cos(a)])
        v += x * rod * np.array([-np.sin(b), np.cos(b)])
        return shaft, at_door + at_arm * shaft**2 + m * v @ v + at_rod * rod**2

    shaft, inertia = turning(door)
    slope = (turning(door + 1e-3)[1] - turning(door - 1e-3)[1]) / 2e-3
    moment = -law(closer_angles(door)[0], shaft * rate) - 30.0 * shaft * rate
    return (shaft * moment - slope * rate**2 / 2) / inertia


def test_a_door_shuts_when_an_equation_of_one_freedom_says(run):
    made = run("door_closer")
    model, inertias = made["door"].model, []
    for joint, own in (("hinge", False), ("shaft", False), ("elbow", True)):
        body = model.inertias[model.getJointId(joint)]
        c = body.lever
        about = body.inertia[2, 2] + (0.0 if own else body.mass * (c[0]**2 + c[1]**2))
        inertias.append((body.mass, c[0], about))
    for name, law in (("one valve", lambda angle, rate: 3.0 * (angle + 4.5)),
                      ("with a latching valve", made["latch"])):
        def slope(t, x, law=law):
            return [x[1], closing(x[0], x[1], inertias, law)]

        def shut(t, x):
            return x[0]

        shut.terminal = True
        wanted = solve_ivp(slope, (0, 20), [np.pi / 2, 0.0], method="DOP853", rtol=1e-9,
                           atol=1e-10, events=shut)
        found = made["runs"][name]
        assert found.time[-1] == pytest.approx(wanted.t[-1], rel=1e-5)
        assert found.coordinate("door").rate[-1] == pytest.approx(wanted.y[1, -1], rel=1e-5)
    assert made["moments"][0] > 18.0 and 3.0 < made["runs"]["one valve"].time[-1] < 7.0


# ---------------------------------------------------------------- Cassie

def test_cassies_foot_is_where_mujoco_has_it(run):
    mujoco = pytest.importorskip("mujoco")
    from beside_mujoco import beside, put, without_meshes
    from mujoco_files import CASSIE, closed_by_mujoco

    made, h = run("cassie"), 1e-3
    pair = beside(made["robot"], without_meshes(CASSIE))
    model, data = pair.model, pair.data
    moved = [*made["robot"].drivers, *made["springs"]]
    known = set(range(6)) | {int(model.joint(name).dofadr[0]) for name in moved}
    unknown = np.array(sorted(set(range(model.nv)) - known))
    foot, hip = model.body("left-foot").id, model.body("left-hip-pitch").id

    for row in (0, 40, 80):
        put(pair, made["motion"].q[row])
        closed_by_mujoco(pair, data.qpos.copy(), unknown)
        there = np.linalg.norm(data.xpos[foot] - data.xpos[hip])
        assert made["length"][row] == pytest.approx(there, abs=1e-12)

    put(pair, made["home"].q)
    home = data.qpos.copy()
    for name, slope in zip(made["names"], made["slopes"], strict=True):
        heights = []
        for step in (-2, -1, 1, 2):
            q = home.copy()
            q[model.joint(name).qposadr[0]] += step * h
            closed_by_mujoco(pair, q, unknown)
            heights.append(data.xpos[foot][2])
        assert slope == pytest.approx(np.dot([1, -8, 8, -1], heights) / (12 * h), abs=1e-8)
    softness = made["slopes"]**2 @ [1 / 1500, 1 / 1250]
    assert made["sink"] == pytest.approx(33.312 * 9.81 * softness, rel=2e-5)
    assert mujoco.mj_getTotalmass(model) == pytest.approx(made["weight"] / 9.81, rel=1e-9)
    assert abs(made["bend"][:60] - 13.0).max() < 0.9  # 13 degrees in the papers about it


# ---------------------------------------------------------------- UR5

def test_a_ur5_turns_its_crank_as_pinocchio_and_virtual_work_say(run):
    made = run("ur5_crank")
    arm, motion, joints, turn = (made[name] for name in ("arm", "motion", "joints", "turn"))
    model, data = arm.model, arm.model.createData()
    tool = model.getFrameId("tool0")
    places = [motion.mechanism.coordinate(name) for name in joints]
    for row in range(0, 181, 12):
        q = np.array([motion.q[row, place.q] for place in places])
        v, a = (np.array([x[row, place.v] for place in places]) for x in (motion.v, motion.a))
        angle = motion.driver[row]
        pin.forwardKinematics(model, data, q, v)
        at = pin.updateFramePlacement(model, data, tool)
        there = [0.45 + 0.15 * np.cos(angle), 0.11 + 0.15 * np.sin(angle), 0.26]
        assert at.translation == pytest.approx(there, abs=1e-12)
        assert at.rotation[:, 2] == pytest.approx([0, 0, -1], abs=1e-12)
        # the arm alone, and what a turn of the crank and a turn about the handle make of it
        jacobian = pin.computeFrameJacobian(model, data, q, tool, pin.LOCAL_WORLD_ALIGNED)
        twists = np.zeros((6, 2))
        twists[:2, 0] = -0.15 * np.sin(angle), 0.15 * np.cos(angle)
        twists[5, 1] = 1.0
        ways = np.linalg.solve(jacobian, twists)
        free = pin.rnea(model, data, q, v, a)
        wanted = np.linalg.pinv(ways.T) @ (ways.T @ free + np.array([6.0, 0.0]))
        found = np.array([made["loads"].efforts[name][row] for name in joints])
        assert found == pytest.approx(wanted, abs=1e-9)
        assert found @ v == pytest.approx(6.0 * turn + free @ v, abs=1e-9)


# ---------------------------------------------------------------- hexapod

def hexapod_legs(rotation, place):
    """Return lengths of the six legs [m], by Pythagoras."""
    way, side = np.radians([0, 0, 120, 120, 240, 240]), np.array([-1, 1] * 3)
    foot, top = way + side * np.radians(20), way + side * np.radians(45)
    feet = np.array([0.30 * np.cos(foot), 0.30 * np.sin(foot), 0 * foot])
    tops = np.array([0.18 * np.cos(top), 0.18 * np.sin(top), 0 * top])
    return np.linalg.norm(rotation @ tops + np.reshape(place, (3, 1)) - feet, axis=0)


@pytest.mark.slow
def test_the_legs_of_a_hexapod_are_as_long_as_pythagoras_says(run):
    made = run("hexapod")
    pose = made["pose"]
    assert made["lengths"] == pytest.approx(hexapod_legs(pose.rotation, pose.translation),
                                            abs=1e-13)
    home = hexapod_legs(np.eye(3), [0, 0, 0.36])[0]
    x = np.linspace(-0.15, 0.15, 61)
    inside = [[np.all(hexapod_legs(np.eye(3), [a, b, 0.40]) < 1.2 * home) for b in x] for a in x]
    assert np.array_equal(np.reshape(made["found"].reached, (61, 61)), inside)


@pytest.mark.slow
def test_a_hexapod_gives_way_at_ninety_degrees(run):
    """Fichter 1986: legs in three pairs, turned by a right angle about the axis."""
    made = run("hexapod")
    assert made["lost"].value == pytest.approx(90.0, abs=1e-6)


# ---------------------------------------------------------------- wheel loader

def plane_turned(point, angle):
    """Return a point of the plane turned about the origin."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * point[0] - s * point[1], s * point[0] + c * point[1]])


def z_bar(boom, tilt=1.491):
    """Return the places of pins and the bucket's pitch at an angle of the boom [rad]."""
    base = np.array([0.230, -0.325])
    pivot, pin_ = plane_turned([1.405, 0.257], boom), plane_turned([2.45, 0.0], boom)
    top = meet(base, tilt, pivot, 0.683, 1)
    along = np.arctan2(*(top - pivot)[::-1]) - 3.313
    low = pivot + 0.614 * np.array([np.cos(along), np.sin(along)])
    lug = meet(low, 1.011, pin_, 0.369, 1)
    return base, pivot, pin_, top, low, lug, np.arctan2(*(lug - pin_)[::-1]) - 1.939


def moment(force, at, about):
    """Return the moment of a plane force about a point."""
    r = at - about
    return r[0] * force[1] - r[1] * force[0]


def test_the_bucket_of_a_loader_is_level_and_breaks_out_as_its_pins_say(run):
    made = run("wheel_loader")
    lift = made["lift"]
    for boom, pitch in zip(lift.coordinate("boom_pin").value, made["pitch"], strict=True):
        assert pitch == pytest.approx(np.degrees(z_bar(boom)[-1]), abs=1e-11)
    # crank, link and bucket without their weight: moments about the crank's pin and the bucket's
    base, pivot, pin_, top, low, lug, pitch = z_bar(lift.coordinate("boom_pin").value[0])
    push = (top - base) / np.linalg.norm(top - base)
    pull = (lug - low) / np.linalg.norm(lug - low)
    link = -moment(push, top, pivot) / moment(-pull, low, pivot)  # per newton of the cylinder
    edge = pin_ + plane_turned([0.95, -0.32], pitch)
    per_newton = link * moment(pull, lug, pin_) / moment(np.array([0, 1.0]), edge, pin_)
    slope = made["held"] - made["alone"]
    assert 1e3 / slope == pytest.approx(abs(per_newton), rel=1e-11)
    assert made["most"] == pytest.approx(25e6 * np.pi * 0.07**2, rel=1e-12)
    assert 100e3 < made["breakout"] < 150e3  # loaders of 12 t: about 110 to 130 kN


def test_a_loader_lifts_as_much_work_as_its_load_gains(run):
    made = run("wheel_loader")
    lift, loader = made["lift"], made["loader"]
    bare = sp.kinetostatics(loader, lift).efforts["lift"]
    rises = lift.frame("load").velocity[:, 2]  # per metre of the cylinder
    assert made["push"] - bare == pytest.approx(3500 * 9.81 * rises, rel=1e-10)


# ---------------------------------------------------------------- gripper

def pad_at(nut):
    """Return how far the right pad is from the middle [m], from circles that meet."""
    pivot = np.array([0.030, 0.050])
    end = meet(np.array([0.010, nut]), 0.030, pivot, 0.024, 1)
    arm = np.arctan2(*(end - pivot)[::-1]) - np.radians(110)
    return 0.030 + 0.060 * np.cos(arm) - 0.0175


def tilted_jaw(opening, second):
    """Return by how much a jaw leans whose second arm has another length [rad]."""
    def off(tilt, arm):
        lug = 0.060 * np.array([np.cos(arm), np.sin(arm)])
        lug += 0.020 * np.array([np.cos(tilt), np.sin(tilt)])
        return np.hypot(lug[0] - 0.020, lug[1]) - second

    def tilt_of(arm):
        return brentq(off, -0.1, 0.1, args=(arm,), xtol=1e-15)

    def wide(arm):
        pad = plane_turned([-0.0175, 0.032], tilt_of(arm))
        return 2 * (0.030 + 0.060 * np.cos(arm) + pad[0]) - opening

    return tilt_of(brentq(wide, 0.9, 2.1, xtol=1e-15))


def test_a_gripper_closes_and_grips_as_circles_and_virtual_work_say(run):
    made, h = run("parallel_gripper"), 4e-5
    for opening, state, torque, leans in made["table"]:
        nut = state.coordinate("nut").value
        assert 2 * pad_at(nut) == pytest.approx(opening, abs=1e-12)
        slope = np.dot([1, -8, 8, -1], [pad_at(nut + k * h) for k in (-2, -1, 1, 2)]) / (12 * h)
        own = sp.inverse_dynamics(made["exact"], state).efforts["motor"]
        assert torque + own == pytest.approx(200 * slope * 0.002 / (2 * np.pi), rel=1e-9)
        assert abs(leans[0]) < 1e-13
        assert leans[1] == pytest.approx(tilted_jaw(opening, 0.0601), abs=1e-11)


# ---------------------------------------------------------------- bonnet

def test_a_bonnet_opens_as_circles_say_and_is_held_as_energy_says(run):
    made = run("bonnet_hinge")
    motion, car = made["motion"], made["bonnet"]
    rear, front = np.array([0.066, -0.019]), np.array([0.228, 0.042])
    low, high = np.array([-0.070, 0.040]), np.array([-0.030, 0.080])
    edges, data = [], car.model.createData()
    for angle, pitch in zip(motion.driver, made["pitch"], strict=True):
        at = rear + np.hypot(*(low - rear)) * np.array([np.cos(angle), np.sin(angle)])
        other = meet(at, np.hypot(*(high - low)), front, np.hypot(*(high - front)), 1)
        lean = np.arctan2(*(other - at)[::-1]) - np.arctan2(*(high - low)[::-1])
        assert pitch == pytest.approx(np.degrees(lean), abs=1e-11)
        edges.append(at + plane_turned(np.array([-0.070, 0.090]) - low, lean))
    near = np.hypot(*(np.array(edges) - [-0.088, 0.090]).T) - 0.014
    assert made["edge"][:, [0, 2]] == pytest.approx(1e3 * np.array(edges), abs=1e-11)
    assert made["found"].least.distance == pytest.approx(near.min(), abs=1e-10)
    # work of gravity and spring from sample to sample, differences of fourth order
    length = np.linalg.norm(motion.frame("spring_on_bonnet").position
                            - motion.frame("spring_on_body").position, axis=1)
    energy = 0.5 * 340.0 * (1.39 - length)**2
    energy += [pin.computePotentialEnergy(car.model, data, q) for q in motion.q]
    step = motion.driver[1] - motion.driver[0]
    slope = (energy[:-4] - 8 * energy[1:-3] + 8 * energy[3:-1] - energy[4:]) / (12 * step)
    assert made["moment"][2:-2] == pytest.approx(slope, abs=2e-6 * abs(made["moment"]).max())


# ---------------------------------------------------------------- excavator

@pytest.mark.slow
def test_the_cylinders_of_an_excavator_do_the_work_of_the_dig(run):
    made = run("excavator")
    motion, model = made["motion"], made["mechanism"].model
    data = model.createData()
    energy = np.array([pin.computeKineticEnergy(model, data, q, v)
                       + pin.computePotentialEnergy(model, data, q)
                       for q, v in zip(motion.q, motion.v, strict=True)])
    step = motion.time[1] - motion.time[0]
    gained = (energy[:-4] - 8 * energy[1:-3] + 8 * energy[3:-1] - energy[4:]) / (12 * step)
    power = sum(made["efforts"][name] * motion.coordinate(name).rate for name in made["lengths"])
    soil = np.array([made["soil"](motion.state(i))["teeth"].linear
                     @ motion.state(i).velocity("teeth").linear for i in range(len(motion))])
    assert abs(soil).max() > 3e4  # the teeth do go through the ground
    # where the splines of the cylinders change, differences of samples have fewer digits
    assert (power + soil)[2:-2] == pytest.approx(gained, abs=5e-4 * abs(power).max())


# ---------------------------------------------------------------- poses at rest


def test_the_springs_of_a_lamp_balance_its_masses(run):
    made = run("anglepoise_lamp")
    model = made["drawn"].model
    moment = {name: model.inertias[model.getJointId(name)].mass * model.inertias[
        model.getJointId(name)].lever[0] for name in ("shoulder", "rod_pin", "elbow")}
    carried = sum(model.inertias[model.getJointId(name)].mass for name in ("plate_pin", "elbow"))
    lower = 9.81 * (moment["shoulder"] + moment["rod_pin"] + 0.34 * carried)
    assert made["wanted"]["lower"] == pytest.approx(lower / (0.06 * 0.10), rel=1e-11)
    upper = 9.81 * moment["elbow"]
    assert made["wanted"]["upper"] == pytest.approx(upper / (0.06 * 0.10), rel=1e-11)
    assert made["found"].stable is None and max(made["worst"].values()) < 1e-12
    assert made["held"].efforts["upper"] == pytest.approx(0.1 * upper, rel=1e-9)


def test_a_switch_snaps_as_the_energy_of_its_spring_says(run):
    made = run("bistable_toggle")
    rod, stiffness, slack = 0.030, 4000.0, 0.028
    height = np.sqrt(rod**2 - slack**2)
    found = [pose.state.coordinate("button").value for pose in made["poses"]]
    assert found == pytest.approx([height, 0.0, -height], abs=1e-12)
    assert [pose.stable for pose in made["poses"]] == [True, False, True]
    assert [pose.stiffness[0, 0] for pose in made["poses"]] == pytest.approx(
        [stiffness * (height / slack)**2, stiffness * (slack / rod - 1.0),
         stiffness * (height / slack)**2], rel=1e-9)
    assert made["poses"][1].energy == pytest.approx(0.5 * stiffness * (rod - slack)**2, rel=1e-9)
    x = np.sqrt(rod**2 - made["way"]**2)
    assert made["force"] == pytest.approx(stiffness * (x - slack) * made["way"] / x, abs=1e-11)


def test_a_delta_robot_is_as_soft_as_its_jacobian_says(run):
    made = run("delta_modes")
    rigid, rest = made["rigid"], made["rest"]
    assert np.abs(rest.state.placement("platform").translation - made["home"].placement(
        "platform").translation).max() < 1e-10
    slopes = sp.jacobian(rigid, made["home"], "platform")[:3]
    free = sp.equilibrium(rigid, made["home"], stable=None, efforts=sp.inverse_dynamics(
        rigid, made["home"]).efforts)  # what the weights are stiff with, without gears
    stiff = made["GEAR"] * np.eye(3) + free.stiffness
    soft = 1e6 * np.diag(slopes @ np.linalg.solve(stiff, slopes.T))
    assert made["give"][:3] == pytest.approx(soft, rel=1e-9)
    assert made["small"].frequencies[0] == pytest.approx(made["small"].frequencies[1], rel=1e-9)


@pytest.mark.slow
def test_a_suspension_in_rubber_tends_to_the_hinged_one_and_bounces_as_springs_in_series(run):
    made = run("soft_wishbone")
    rest, held, soft = made["rest"], made["HELD"], made["soft"]
    for component, name in ((1, "lateral"), (5, "aligning")):  # toe and camber by a small load
        ends = []
        for size in (-5.0, 5.0):
            load = {"contact": pin.Force(size * np.eye(6)[component])}
            pose = sp.equilibrium(made["car"], rest.state, hold=held, external=load)
            ends.append(pose.state.placement("hub").rotation)
        turned = pin.log3(ends[1] @ ends[0].T) / 10.0
        assert turned == pytest.approx(soft[3:, component], abs=1e-7 * np.abs(soft).max()), name
    bounce = np.sqrt(1.0 / (1.0 / made["TYRE"] + 1.0 / made["rate"]) / 330.0)
    assert made["small"].frequencies[0] == pytest.approx(bounce / (2.0 * np.pi), rel=0.03)


def test_a_suspension_in_stiff_rubber_is_the_hinged_one(run):
    made = run("soft_wishbone")
    held, rates = made["HELD"], []
    for factor in (1.0, 10.0, 100.0):  # in translation; the rubber is free to turn
        springs = [s if s.name in ("strut", "tyre") else dataclasses.replace(
            s, stiffness=factor * np.array([*s.stiffness[:3], 0.0, 0.0, 0.0]))
            for s in made["car"].springs]
        car = made["car"].with_fields(springs=tuple(springs))
        rest = sp.equilibrium(car, hold=held)
        soft = sp.compliance(car, rest.state, "contact", hold=[*held, "heave"])
        rates.append(1.0 / soft[2, 2] - made["TYRE"])
        height = (rest.state.placement("contact").translation[2]
                  - rest.state.coordinate("heave").value)
    # the energy of the hinged suspension over the height of its wheel
    hinged, angles = sp.load(EXAMPLES / "machines" / "double_wishbone.toml"), []
    model, strut, data = hinged.model, hinged.springs[0], hinged.model.createData()
    for angle in np.linspace(-0.04, 0.0, 17):
        state = sp.assemble(hinged, {"wheel": angle})
        way = state.placement("strut_top").translation - state.placement("strut_foot").translation
        stretch = np.linalg.norm(way) - strut.free_length
        angles.append((state.placement("contact").translation[2], pin.computePotentialEnergy(
            model, data, state.q) + 0.5 * strut.stiffness * stretch**2))
    z, energy = np.array(angles).T
    fit = np.polynomial.Polynomial.fit(z, energy, 10)
    assert rates[1] - rates[0] == pytest.approx(10.0 * (rates[2] - rates[1]), rel=2e-3)  # by 1/k
    limit = (10.0 * rates[2] - rates[1]) / 9.0
    assert limit == pytest.approx(fit.deriv(2)(height), rel=1e-5)


@pytest.mark.slow
def test_a_truss_snaps_at_the_load_of_the_closed_form(run):
    made = run("von_mises_truss")
    half, free = 0.3, np.hypot(0.3, 0.1)
    length = np.cbrt(free * half**2)
    height = np.sqrt(length**2 - half**2)
    assert made["limit"].value == pytest.approx(2000.0 * (free / length - 1.0) * height, abs=1e-11)
    assert made["height"] == pytest.approx(height, abs=1e-11)
    assert made["rest"].stiffness[0, 0] == pytest.approx(200.0, abs=1e-9)
    low = brentq(lambda z: 2000.0 * (1.0 - free / np.hypot(half, z)) * z + made["heavy"],
                 -0.2, -0.1, xtol=1e-15)
    assert made["snapped"].state.coordinate("cap").value == pytest.approx(low, abs=1e-12)


# ---------------------------------------------------------------- the page about them

PAGE = EXAMPLES.parent / "docs" / "examples.md"


def test_pictures_of_examples_are_small():
    sizes = [path.stat().st_size for path in (PAGE.parent / "pictures" / "examples").iterdir()]
    assert len(sizes) == PAGE.read_text(encoding="utf-8").count("](pictures/examples/") >= 12
    assert max(sizes) < 120_000 and sum(sizes) < 1_500_000
