"""Forces: what is known of mechanisms under load, by free bodies, energy and virtual work."""

from __future__ import annotations

import mechanisms as known
import mpmath
import numpy as np
import pinocchio as pin
import pytest
from closed_forms import rssr
from hypothesis import HealthCheck, given, settings, strategies as st
from ladders import BARS, DOWN, LENGTHS, G, heavy_four_bar, ladder, leaning, moving
from loaded_library import library
from masses import (
    PlaneBody,
    PlanePin,
    energy_rate,
    heavy,
    needed_by_body,
    plane_forces,
    with_masses,
    wrenches_by_body,
)
from memory import peak_memory
from mpmath import cos, mpf, sin
from variety import each, few

import spatial_pin as sp

LIBRARY = sp.list_mechanisms()


# ---------------------------------------------------------------- one body


def plane_pendulum(folder, toml="", inertia=0.02):
    tree = heavy(known.turning("pin", "ground", "bob", axis=(0, -1, 0)),
                 bob=(1.5, (0.4, 0, 0), (0.0, inertia, inertia)))
    return known.load(folder, "plane_pendulum", tree, toml + known.driver("pin", "pin"))


def test_a_pendulum(tmp_path):
    """The angle is counted from the horizontal upwards."""
    mech, angle, rate = plane_pendulum(tmp_path), 0.3, 1.7
    state = sp.solve_rates(mech, sp.assemble(mech, {"pin": angle}), {"pin": rate})
    answer = sp.forward_dynamics(mech, state, {"pin": 0.25})
    a = (0.25 - 1.5 * G * 0.4 * np.cos(angle)) / (0.02 + 1.5 * 0.4**2)
    assert answer.a == pytest.approx([a], rel=1e-13)
    along, across = (np.array([np.cos(angle), 0, np.sin(angle)]),
                     np.array([-np.sin(angle), 0, np.cos(angle)]))
    force = 1.5 * (0.4 * (a * across - rate**2 * along) + [0, 0, G])
    assert answer.reactions["pin"].linear == pytest.approx(force, rel=1e-13)
    assert answer.reactions["pin"].angular == pytest.approx(np.zeros(3), abs=1e-14)
    assert answer.on_ground.linear == pytest.approx(-force, rel=1e-13)
    assert answer.on_ground.angular == pytest.approx([0, 0.25, 0], abs=1e-13)  # of the drive
    assert answer.determined == {"pin": True}


def test_a_tree_moves_as_the_articulated_body_algorithm_says(tmp_path):
    mech = with_masses(known.pendulum(tmp_path), tmp_path, upper=(1.0, (0.1, 0, 0), (1e-2,) * 3),
                       lower=(0.5, (0.1, 0.02, 0), (1e-3, 2e-3, 3e-3)))
    state = sp.solve_rates(mech, sp.assemble(mech, {"shoulder": 0.4, "elbow": -0.8}),
                           {"shoulder": 2.0, "elbow": -1.0})
    tau = np.array([0.3, -0.2])
    want = pin.aba(mech.model, mech.model.createData(), state.q, state.v, tau)
    found = sp.forward_dynamics(mech, state, {"shoulder": 0.3, "elbow": -0.2})
    assert found.a == pytest.approx(want, rel=1e-12)


def test_gravity_can_be_off_and_a_force_from_outside_acts_at_its_frame(tmp_path):
    mech = plane_pendulum(tmp_path, "gravity = [0.0, 0.0, 0.0]\n")
    state = sp.assemble(mech, {"pin": 0.0})
    assert sp.forward_dynamics(mech, state).a == pytest.approx([0.0])
    load = {"bob": pin.Force(np.array([0, 0, 3.0]), np.array([0, -0.5, 0.1]))}
    answer = sp.forward_dynamics(mech, state, external=load)
    assert answer.a == pytest.approx([0.5 / (0.02 + 1.5 * 0.16)], rel=1e-13)
    assert answer.reactions["pin"].angular == pytest.approx([0, 0, -0.1], abs=1e-14)


def test_a_coordinate_has_one_effort():
    mech = library("four_bar")
    with pytest.raises(ValueError, match="effort of 'crank_pin' is given twice"):
        sp.forward_dynamics(mech, sp.assemble(mech), {"crank": 1.0, "crank_pin": 2.0})


def test_a_coordinate_without_inertia_stays_unless_a_force_acts(tmp_path):
    mech = known.load(tmp_path, "light", known.turning("pin", "ground", "wheel"),
                      known.driver("pin", "pin"))
    state = sp.assemble(mech, {"pin": 0.0})
    with pytest.warns(sp.SpatialPinWarning, match="no link has a mass"):
        assert sp.forward_dynamics(mech, state).a == pytest.approx([0.0])
    with pytest.raises(sp.SingularError, match="pin has no inertia but a force works on it"):
        sp.forward_dynamics(mech, state, {"pin": 1.0})


# ---------------------------------------------------------------- slider-crank, all four cuts

SPEED, ALPHA = mpf("3.0"), mpf("2.0")
CRANK, ROD, SLIDER = (0.8, 0.02, 1e-3), (0.5, 0.06, 2e-3), (1.2, 0.0, 3e-3)  # mass, com, inertia


def crank_angle(t, start):
    return mpf(start) + SPEED * t + ALPHA * t**2 / 2


def slider_crank_forces(start):
    r, length = mpf(known.R), mpf(known.L)

    def crank(t):
        phi = crank_angle(t, start)
        return mpf(CRANK[1]) * cos(phi), mpf(CRANK[1]) * sin(phi), phi

    def pin_a(t):
        phi = crank_angle(t, start)
        return r * cos(phi), r * sin(phi)

    def rod_angle(t):
        return known.slider_crank(crank_angle(t, start)).coordinates["wrist_pin"]

    def rod(t):
        x, y = pin_a(t)
        beta = rod_angle(t)
        return x + mpf(ROD[1]) * cos(beta), y + mpf(ROD[1]) * sin(beta), beta

    def wrist(t):
        (x, y), beta = pin_a(t), rod_angle(t)
        return x + length * cos(beta), y + length * sin(beta)

    bodies = {"crank": PlaneBody(CRANK[0], CRANK[2], crank), "rod": PlaneBody(ROD[0], ROD[2], rod),
              "slider": PlaneBody(SLIDER[0], SLIDER[2], lambda t: (*wrist(t), mpf(0)))}
    pins = {"main_pin": PlanePin("", "crank", lambda t: (mpf(0), mpf(0))),
            "crank_pin": PlanePin("crank", "rod", pin_a),
            "wrist_pin": PlanePin("rod", "slider", wrist)}
    return plane_forces(bodies, pins, 0.0, G, "slider")


CUTS = {  # centres of mass of crank and rod in their frames, on which body each pair's force counts
    known.cut_at_wrist_pin: (CRANK[1], ROD[1], {"main_pin": 1, "crank_pin": 1, "wrist_pin": 1}),
    known.cut_at_crank_pin: (CRANK[1], ROD[1] - known.L,
                             {"main_pin": 1, "crank_pin": 1, "wrist_pin": -1}),
    known.cut_at_slide: (CRANK[1], ROD[1], {"main_pin": 1, "crank_pin": 1, "slider_pin": 1}),
    known.cut_at_main_pin: (CRANK[1] - known.R, ROD[1] - known.L,
                            {"main_pin": 1, "crank_pin": -1, "wrist_pin": -1}),
}


def heavy_slider_crank(build, folder):
    crank, rod, _ = CUTS[build]
    return with_masses(build(folder), folder, DOWN, crank=(
        CRANK[0], (crank, 0, 0), (CRANK[2],) * 3),
                       rod=(ROD[0], (rod, 0, 0), (ROD[2],) * 3),
                       slider=(SLIDER[0], (0, 0, 0), (SLIDER[2],) * 3))


@pytest.mark.parametrize("start", [0.4, 2.0, 4.5])
@pytest.mark.parametrize("build", CUTS)
def test_slider_crank_by_free_bodies(build, start, tmp_path):
    mech = heavy_slider_crank(build, tmp_path)
    want = slider_crank_forces(start)
    pose = {k: float(v) for k, v in known.slider_crank(start).coordinates.items()}
    if build is known.cut_at_main_pin:
        pose["crank_pin"] = -pose["crank_pin"]
    state = sp.assemble(mech, {}, guess={k: v for k, v in pose.items() if k in mech.coordinates})
    turned = "main_pin" if "main_pin" in mech.coordinates else None
    if turned:
        state = sp.assemble(mech, {turned: start}, guess=state)
        state = sp.solve_rates(mech, state, {turned: float(SPEED)}, {turned: float(ALPHA)})
        answer = sp.inverse_dynamics(mech, state, [turned])
        assert answer.efforts[turned] == pytest.approx(want.torque, rel=1e-11)
    else:  # the crank's torque from outside, on the crank and back on the ground
        slide = known.slider_crank
        with mpmath.workdps(40):
            x, v, a = (float(mpmath.diff(
                lambda t: slide(crank_angle(t, start)).coordinates["slide"], 0, n))
                for n in range(3))
        state = sp.assemble(mech, {"slide": x}, guess=state)
        state = sp.solve_rates(mech, state, {"slide": v}, {"slide": a})
        torque = {"crank": pin.Force(np.zeros(3), np.array([0, 0, want.torque]))}
        answer = sp.inverse_dynamics(mech, state, external=torque)
        assert answer.efforts["slider"] == pytest.approx(0.0, abs=1e-9 * abs(want.torque) / known.R)
    for name, sense in CUTS[build][2].items():
        force = want.pins["wrist_pin" if name == "slider_pin" else name]
        assert sense * answer.reactions[name].linear[:2] == pytest.approx(force, rel=1e-9), name
    assert answer.reactions["slide"].linear[1] == pytest.approx(want.guide[0], rel=1e-9)
    assert answer.reactions["slide"].angular[2] == pytest.approx(want.guide[1], abs=1e-9)


# ---------------------------------------------------------------- plane four-bar


def four_bar_forces(start):
    from closed_forms import four_bar

    r1, r2, r3, _ = map(mpf, LENGTHS)

    def angles(t):
        phi = crank_angle(t, start)
        c = four_bar(phi, *LENGTHS).coordinates
        return phi, phi + c["coupler_pin"], c["rocker_pin"]

    def tip(t):
        phi, beta, _ = angles(t)
        return r2 * cos(phi) + r3 * cos(beta), r2 * sin(phi) + r3 * sin(beta)

    def along(k, base, c):
        def pose(t):
            angle = angles(t)[k]
            x, y = base(t)
            return x + mpf(c) * cos(angle), y + mpf(c) * sin(angle), angle
        return pose

    def origin(t):
        return mpf(0), mpf(0)

    def crank_end(t):
        return r2 * cos(angles(t)[0]), r2 * sin(angles(t)[0])

    def pivot(t):
        return r1, mpf(0)

    bases = {"crank": origin, "coupler": crank_end, "rocker": pivot}
    bodies = {name: PlaneBody(BARS[name][0], BARS[name][2], along(k, base, BARS[name][1]))
              for k, (name, base) in enumerate(bases.items())}
    pins = {"crank_pin": PlanePin("", "crank", origin),
            "coupler_pin": PlanePin("crank", "coupler", crank_end),
            "rocker_pin": PlanePin("", "rocker", pivot),
            "output_pin": PlanePin("coupler", "rocker", tip)}
    return plane_forces(bodies, pins, 0.0, G)


def four_bar_state(mech, start):
    from closed_forms import four_bar

    at = {k: float(v) for k, v in four_bar(mpf(start), *LENGTHS).coordinates.items()}
    state = sp.assemble(mech, {"crank": start}, guess=at)
    return sp.solve_rates(mech, state, {"crank": float(SPEED)}, {"crank": float(ALPHA)})


@pytest.mark.parametrize("start", [0.3, 1.9, 4.0])
def test_four_bar_by_free_bodies(start, tmp_path):
    mech, want = heavy_four_bar(tmp_path), four_bar_forces(start)
    answer = sp.inverse_dynamics(mech, four_bar_state(mech, start))
    assert answer.efforts["crank"] == pytest.approx(want.torque, rel=1e-11)
    for name, force in want.pins.items():
        assert answer.reactions[name].linear[:2] == pytest.approx(force, rel=1e-9), name
        assert answer.reactions[name].linear[2] == pytest.approx(0.0, abs=1e-12)
    shaking = -want.pins["crank_pin"] - want.pins["rocker_pin"]
    assert answer.on_ground.linear[:2] == pytest.approx(shaking, rel=1e-9)


def test_a_torque_curve_is_inverse_dynamics_of_every_row(tmp_path):
    mech = heavy_four_bar(tmp_path)
    first = four_bar_state(mech, 0.3)
    motion = sp.sweep(mech, "crank", np.linspace(0.3, 0.3 + 2 * np.pi, 31), speed=3.0,
                      acceleration=2.0, guess=first)
    curve = sp.kinetostatics(mech, motion)
    assert curve.efforts["crank"][0] == pytest.approx(four_bar_forces(0.3).torque, rel=1e-10)
    for k in (0, 11, 30):
        answer = sp.inverse_dynamics(mech, motion.state(k))
        assert curve.efforts["crank"][k] == answer.efforts["crank"]
        assert curve.power["crank"][k] == pytest.approx(answer.power["crank"], rel=1e-14)
        assert curve.on_ground[k] == pytest.approx(answer.on_ground.vector, rel=1e-12, abs=1e-12)
        assert curve.multipliers[k] == pytest.approx(answer.multipliers, rel=1e-12, abs=1e-12)
        for name, force in answer.reactions.items():
            assert curve.reactions[name][k] == pytest.approx(force.vector, rel=1e-12, abs=1e-12)
            assert curve.determined[name][k] == answer.determined[name]


def test_a_force_that_follows_the_motion(tmp_path):
    """A tangential load on the rocker's end, as a function of the state."""
    mech = heavy_four_bar(tmp_path, "")
    motion = sp.sweep(mech, "crank", np.linspace(0.3, 1.0, 5), speed=0.0,
                      guess=four_bar_state(mech, 0.3))

    def load(state):
        return {"rocker": pin.Force(np.zeros(3), np.array([0, 0, state.coordinate("crank").value]))}

    curve, free = sp.kinetostatics(mech, motion, external=load), sp.kinetostatics(mech, motion)
    for k in range(5):
        state = motion.state(k)
        ratio = sp.solve_rates(mech, state, {"crank": 1.0}).coordinate("rocker_pin").rate
        assert curve.efforts["crank"][k] - free.efforts["crank"][k] == pytest.approx(
            -ratio * motion.driver[k], rel=1e-10)


# ---------------------------------------------------------------- spatial, by energy


def test_rssr_torque_by_energy(tmp_path):
    """Rod without mass, constant speed: torque times speed is the rate of energy."""
    mech = with_masses(known.rssr_with_a_rod(tmp_path), tmp_path, crank=(0.4, (-0.05, 0, 0), (
        1e-3,) * 3), rocker=(0.9, (-0.1, 0, 0), (2e-3, 3e-3, 4e-3)))
    speed, at = mpf(5), mpf("0.8")

    def energy(t):
        phi = at + speed * t
        rate = mpmath.diff(lambda x: rssr(x).coordinates["rocker_pin"], phi) * speed
        rocker = (mpf("4e-3") + mpf("0.9") * mpf("0.1") ** 2) * rate**2 / 2
        return rocker + mpf("0.4") * mpf("9.81") * mpf("0.05") * sin(phi)

    with mpmath.workdps(40):
        want = float(mpmath.diff(energy, 0) / speed)
    state = sp.solve_rates(mech, sp.assemble(mech, {"crank": 0.8}), {"crank": 5.0})
    answer = sp.inverse_dynamics(mech, state)
    assert answer.efforts["crank"] == pytest.approx(want, rel=1e-11)
    rod = answer.reactions["coupler"]
    along = state.placement("b").translation - state.placement("a").translation
    assert np.linalg.norm(np.cross(rod.linear, along)) < 1e-12 * np.linalg.norm(rod.linear)
    assert rod.angular == pytest.approx(np.zeros(3), abs=1e-14)


@pytest.mark.parametrize("build", [known.press_tree, known.press_closure])
def test_a_press_lifts_with_lead_over_two_pi(build, tmp_path):
    mech = build(tmp_path)
    load = {"ram": pin.Force(np.array([0, 0, -500.0]), np.zeros(3))}
    answer = sp.inverse_dynamics(mech, sp.assemble(mech, {"nut": 0.7}), external=load)
    assert answer.efforts["nut"] == pytest.approx(-500.0 * known.LEAD / (2 * np.pi), rel=1e-12)
    assert abs(answer.reactions["thread"].linear[2]) == pytest.approx(500.0, rel=1e-12)


@pytest.mark.parametrize("build", [known.hooke_closure, known.hooke_tree])
def test_hooke_torques_are_as_the_inverse_speeds(build, tmp_path):
    mech, angle = build(tmp_path), 0.9
    shaft = "out" if build is known.hooke_closure else "wheel"
    load = {shaft: pin.Force(np.zeros(3), -2.0 * np.array(known.OUT))}
    answer = sp.inverse_dynamics(mech, sp.assemble(mech, {"input": angle}), external=load)
    ratio = mpmath.diff(lambda x: known.hooke_answer(x).coordinates["output"], mpf(angle))
    assert answer.efforts["input"] == pytest.approx(2.0 * float(ratio), rel=1e-12)


def test_stewart_leg_forces_by_the_transposed_jacobian():
    mech = library("stewart")
    pose = {f"leg_{k}": value for k, value in enumerate((0.43, 0.46, 0.44, 0.45, 0.42, 0.47), 1)}
    state = sp.assemble(mech, pose)
    load = pin.Force(np.array([30.0, -20.0, -500.0]), np.array([3.0, -5.0, 7.0]))
    loaded = sp.inverse_dynamics(mech, state, external={"platform": load})
    free = sp.inverse_dynamics(mech, state)
    centre = state.placement("platform").translation
    columns = []
    for k in range(1, 7):
        foot = state.data.oMi[mech.joint_id(f"hook_{k}")].translation
        top = state.placement(f"platform_{k}").translation
        along = (top - foot) / np.linalg.norm(top - foot)
        columns.append(np.concatenate([along, np.cross(top - centre, along)]))
    forces = np.linalg.solve(np.array(columns).T, -load.vector)
    found = [loaded.efforts[f"leg_{k}"] - free.efforts[f"leg_{k}"] for k in range(1, 7)]
    assert found == pytest.approx(forces, rel=1e-10)


# ---------------------------------------------------------------- springs


def spring(**keys) -> str:
    lines = [f"{k} = {v!r}" if not isinstance(v, str) else f'{k} = "{v}"' for k, v in keys.items()]
    return "[[springs]]\n" + "\n".join(lines).replace("'", '"') + "\n"


def test_a_spring_and_damper_between_frames(tmp_path):
    tree = heavy(known.turning("pin", "ground", "bob", axis=(0, -1, 0)),
                 bob=(1.5, (0.4, 0, 0), (0.0, 0.02, 0.02)))
    tree += known.point("hook", "ground", (0, 0, 0.5)) + known.point("eye", "bob", (0.3, 0, 0))
    mech = known.load(tmp_path, "sprung", tree, known.driver("pin", "pin") + spring(
        name="s", frames=["eye", "hook"], stiffness=40.0, damping=3.0, free_length=0.2))
    angle, rate = 0.25, 1.3

    def length(x):
        return mpmath.sqrt((mpf("0.3") * cos(x)) ** 2 + (mpf("0.5") - mpf("0.3") * sin(x)) ** 2)

    slope, inertia = float(mpmath.diff(length, angle)), 0.02 + 1.5 * 0.16
    weight = 1.5 * G * 0.4 * np.cos(angle)
    state = sp.solve_rates(mech, sp.assemble(mech, {"pin": angle}), {"pin": rate})
    pull = 40.0 * (float(length(angle)) - 0.2) + 3.0 * slope * rate
    answer = sp.forward_dynamics(mech, state)
    assert answer.a == pytest.approx([(-pull * slope - weight) / inertia], rel=1e-12)
    law = sp.forward_dynamics(mech, state, laws={"s": lambda x, dx: 7.0 * x**3 + dx**2})
    pull = 7.0 * float(length(angle)) ** 3 + (slope * rate) ** 2
    assert law.a == pytest.approx([(-pull * slope - weight) / inertia], rel=1e-12)
    # the ground bears what bob, spring and weight do not balance among themselves
    need = 1.5 * 0.4 * (law.a[0] * np.array([-np.sin(angle), 0, np.cos(angle)])
                        - rate**2 * np.array([np.cos(angle), 0, np.sin(angle)]))
    assert law.on_ground.linear == pytest.approx(-need - [0, 0, 1.5 * G], rel=1e-12)
    with pytest.raises(sp.SpatialPinError, match="spring"):
        sp.forward_dynamics(mech, state, laws={"t": lambda x, dx: 0.0})


def test_a_spring_about_a_joint(tmp_path):
    mech = plane_pendulum(tmp_path, spring(
        name="s", joint="pin", stiffness=5.0, damping=0.2, free_angle=0.1))
    state = sp.solve_rates(mech, sp.assemble(mech, {"pin": 0.6}), {"pin": -2.0})
    torque = -5.0 * 0.5 + 0.2 * 2.0 - 1.5 * G * 0.4 * np.cos(0.6)
    answer = sp.forward_dynamics(mech, state)
    assert answer.a == pytest.approx([torque / (0.02 + 1.5 * 0.16)], rel=1e-13)
    assert answer.reactions["pin"].angular == pytest.approx(np.zeros(3), abs=1e-13)


@pytest.mark.parametrize("key", ["free_length", "free_angle"])
def test_a_spring_along_a_slide(tmp_path, key):
    tree = heavy(known.sliding("slide", "ground", "block", axis=(1, 0, 0)), block=(1.5,))
    toml = spring(name="s", joint="slide", stiffness=5.0, damping=0.2, **{key: -0.1})
    mech = known.load(tmp_path, "block", tree, toml)
    state = sp.solve_rates(mech, sp.assemble(mech, {"slide": 0.6}), {"slide": -2.0})
    assert sp.forward_dynamics(mech, state).a == pytest.approx([(-5.0 * 0.7 + 0.2 * 2.0) / 1.5])
    assert known.content_of(mech)["springs"][0][key] == -0.1


# ---------------------------------------------------------------- actuation


def heavy_five_bar(folder):
    link = (0.4, (0.06, 0, 0), (1e-3,) * 3)
    return with_masses(known.five_bar(folder), folder, DOWN, crank1=link, crank2=link, rod1=link,
                       rod2=link)


def test_more_actuators_than_freedoms_share_by_least_squares(tmp_path):
    mech = heavy_five_bar(tmp_path)
    state = moving(mech, {"left": 2.0, "right": 1.0})
    two = sp.inverse_dynamics(mech, state)
    elbow = [float(mpmath.diff(lambda x, i=i: known.five_bar_answer(*(
        (x, mpf(1)) if i == 0 else (mpf(2), x))).coordinates["elbow1"], [2, 1][i])) for i in (0, 1)]
    b = np.column_stack([np.eye(2), elbow])  # rates of left, right, elbow per freedom
    load = b[:, :2] @ [two.efforts["left"], two.efforts["right"]]
    for weights in ({"left": 1.0, "right": 1.0, "elbow1": 1.0},
                    {"left": 2.0, "right": 0.5, "elbow1": 10.0}):
        w = np.diag(1.0 / np.array(list(weights.values())))
        want = w @ b.T @ np.linalg.solve(b @ w @ b.T, load)
        three = sp.inverse_dynamics(mech, state, weights)
        assert list(three.efforts.values()) == pytest.approx(want, rel=1e-10)
        assert three.a == pytest.approx(two.a)
        assert sum(three.power.values()) == pytest.approx(sum(two.power.values()), rel=1e-11)


def test_a_freedom_that_nobody_drives_is_named(tmp_path):
    mech = heavy_five_bar(tmp_path)
    with pytest.raises(sp.SpatialPinError, match=r"1 freedom has no actuator; actuate 1 more "
                                                 r"of elbow1, right, elbow2, such as"):
        sp.inverse_dynamics(mech, moving(mech, {"left": 2.0, "right": 1.0}), ["left"])
    with pytest.raises(ValueError, match="positive"):
        sp.inverse_dynamics(mech, moving(mech, {"left": 2.0, "right": 1.0}), {"left": 0.0})


def test_a_passive_freedom_needs_no_actuator():
    mech = library("rssr")
    answer = sp.inverse_dynamics(mech, moving(mech))
    again = sp.forward_dynamics(mech, answer.state, answer.efforts)
    assert again.a == pytest.approx(answer.a, rel=1e-9, abs=1e-10)


# ---------------------------------------------------------------- overconstrained loops

PAIRS_OF_A_DOOR = {  # closures at the lower and upper hinge, and whether each is determined
    "two hinges": (("revolute", "revolute"), (False, False)),
    "hinge and loose ring": (("revolute", "cylindrical"), (False, False)),
    "ball and ring": (("spherical", "point_on_line"), (True, True)),
    "hinge alone": (("revolute",), (True,)),
}


def door(folder, kinds):
    tree = heavy(known.floating("free", "ground", "leaf"),
                 leaf=(20.0, (0.4, 0, 0), (1.0, 1.5, 0.5)))
    toml = DOWN.replace("0.0, -9.81, 0.0", "0.0, 0.0, -9.81") + known.driver("pull", "free.y")
    for kind, side, z in zip(kinds, ("low", "high"), (-0.8, 0.8), strict=False):
        tree += known.point(f"post_{side}", "ground", (0, 0, z))
        tree += known.point(f"leaf_{side}", "leaf", (0, 0, z))
        toml += known.closure(side, kind, f"post_{side}", f"leaf_{side}")
    return known.load(folder, "door", tree, toml.replace(known.driver("pull", "free.y"), ""))


@pytest.mark.parametrize("name", PAIRS_OF_A_DOOR)
def test_a_door(name, tmp_path):
    """Swings the same however it is hung; what its hinges share is said to be undetermined."""
    kinds, unique = PAIRS_OF_A_DOOR[name]
    mech = door(tmp_path, kinds)
    state = sp.assemble(mech, {})
    v = np.array([0, 0, 0, 0, 0, 2.0])
    state = sp.State(mech, state.q, v, closure_error=state.closure_error)
    push = {"leaf": pin.Force(np.zeros(3), np.array([0, 0, 6.0]))}
    answer = sp.forward_dynamics(mech, state, external=push)
    assert answer.state.angular_acceleration("leaf") == pytest.approx(
        [0, 0, 6.0 / (0.5 + 20 * 0.16)], rel=1e-12, abs=1e-12)
    assert {k: answer.determined[k] for k in ("low", "high")[: len(kinds)]} == dict(
        zip(("low", "high"), unique, strict=False))
    total = sum((answer.reactions[s].linear for s in ("low", "high")[: len(kinds)]), np.zeros(3))
    a = answer.state.angular_acceleration("leaf")[2]
    assert total == pytest.approx([-20 * 0.4 * 4.0, 20 * 0.4 * a, 20 * G], rel=1e-12)
    if name == "ball and ring":
        couple = 20 * G * 0.4 / 1.6  # the weight tips the leaf away from the upper hinge
        assert answer.reactions["high"].linear[0] == pytest.approx(-couple - 16.0, rel=1e-12)
        assert answer.reactions["low"].linear[2] == pytest.approx(20 * G, rel=1e-12)


def closed_by(kind, folder):
    mech = heavy_four_bar(folder)
    path = folder / f"{mech.name}.toml"
    path.write_text(path.read_text(encoding="utf-8").replace('type = "revolute"',
                                                             f'type = "{kind}"'), encoding="utf-8")
    return sp.load(path)


@pytest.mark.parametrize(("kind", "unique"), [
    ("revolute", False), ("cylindrical", False), ("spherical", False), ("point_on_line", True)])
def test_a_plane_loop_in_space(kind, unique, tmp_path):
    """Forces in the plane are unique in any case; pairs that hold it in the plane too are not."""
    mech = closed_by(kind, tmp_path)
    state, want = four_bar_state(mech, 0.3), four_bar_forces(0.3)
    answer = sp.inverse_dynamics(mech, state)
    assert set(answer.determined.values()) == {unique}
    assert answer.efforts["crank"] == pytest.approx(want.torque, rel=1e-11)
    for name, force in want.pins.items():
        assert answer.reactions[name].linear[:2] == pytest.approx(force, rel=1e-9), name


def test_only_the_overconstrained_loop_is_undetermined(tmp_path):
    """A four-bar, and on its rocker a pendulum: the pendulum's pin is determined."""
    mech = heavy_four_bar(tmp_path)
    tree = (tmp_path / f"{mech.name}.urdf").read_text(encoding="utf-8")
    extra = heavy(known.turning("swing", "rocker", "bob", (0.1, 0, 0)),
                  bob=(0.2, (0.1, 0, 0), (1e-3,) * 3))
    (tmp_path / f"{mech.name}.urdf").write_text(tree.replace("</robot>", extra + "</robot>"),
                                                encoding="utf-8")
    mech = sp.load(tmp_path / f"{mech.name}.toml")
    determined = sp.forward_dynamics(mech, sp.assemble(mech, {"crank": 0.3})).determined
    assert {name for name, unique in determined.items() if unique} == {"swing"}


LINK = {"mass": 0.5, "inertia": (1e-3, 2e-3, 2.5e-3)}


def test_a_gear_and_a_lock_share_a_torque_that_no_bearing_feels(tmp_path):
    """Two bodies on one axis, held together twice: the torque between them is one of many.

    The bearings are told as not unique too: nothing says where the gear's force acts.
    """
    tree = heavy(
        known.turning("a", "ground", "one") + known.turning("b", "ground", "other")
        + known.point("x", "one") + known.point("y", "other"),
        one=(1.0, (0.1, 0.0, 0.2)), other=(2.0, (0.1, 0.3, 0.0)))
    mech = known.load(
        tmp_path, "held_twice", tree,
        known.driver("turn", "a") + known.coupling("gear", "a", "b", 1.0) + known.closure(
            "lock", "perpendicular", "x", "y", axis=(1, 0, 0), axis2=(0, 1, 0)))
    state = sp.solve_rates(mech, sp.assemble(mech), {"turn": 1.0})
    answer = sp.forward_dynamics(mech, state, {"turn": 3.0})
    assert answer.determined == {"a": False, "b": False, "lock": False}
    assert any("'gear'" in reason for reason in answer.why_not_unique())
    # the bearings bear what each body needs, whoever turns it, but for the torque about the axis
    need, bodies = needed_by_body(answer.state), [mech.joint_id(j) for j in "ab"]
    for name, body, link in zip("ab", bodies, ("one", "other"), strict=True):
        weight = np.array([0.0, 0.0, -9.81 * mech.model.inertias[body].mass])
        arm = answer.state.com(link).position
        needed = need[body] - np.concatenate([weight, np.cross(arm, weight)])
        np.testing.assert_allclose(answer.reactions[name].vector[:5], needed[:5], atol=1e-12)
        assert abs(answer.reactions[name].angular[2]) < 1e-12


def heavy_chain(build, folder, n):
    links = {f"link{k}": (LINK["mass"], (0.1, 0.01, 0), LINK["inertia"]) for k in range(1, n + 1)}
    return with_masses(build(folder), folder, **links)


def perpendicular(one, other):
    axes = {letter: np.eye(3)[k] for k, letter in enumerate("xyz")}
    return known.closure(f"{one}{other}", "perpendicular", "end", "start", axis=axes[one],
                         axis2=axes[other])


FIVE_OF_SIX = (known.closure("sideways", "point_on_line", "end", "start", axis=(0, 1, 0))
               + perpendicular("x", "y") + perpendicular("y", "z") + perpendicular("z", "x"))


@pytest.mark.parametrize(("build", "n", "closures", "start"), [
    (known.bennett, 3, known.closure("tip", "point_on_line", "end", "last"), 1.0),
    (known.bennett, 3, known.closure("level", "parallel", "end", "last"), 1.0),
    (known.bricard, 6, FIVE_OF_SIX, 0.7)])
def test_paradoxical_loops_move_as_with_fewer_equations(build, n, closures, start, tmp_path):
    """An overconstrained loop moves as with closures that have no equation too many."""
    full = heavy_chain(build, tmp_path, n)
    path = tmp_path / f"{full.name}.toml"
    text = path.read_text(encoding="utf-8")
    at, end = text.index("[[closures]]"), text.index("[guess]")
    path.write_text(text[:at] + closures + text[end:], encoding="utf-8")
    fewer = sp.load(path)
    state = sp.assemble(full, {"crank": start})
    state = sp.solve_rates(full, state, {"crank": 1.3})
    other = sp.State(fewer, state.q, state.v, closure_error=state.closure_error)
    first, second = sp.forward_dynamics(full, state), sp.forward_dynamics(fewer, other)
    assert first.a == pytest.approx(second.a, rel=1e-9)
    assert not any(first.determined.values())
    assert all(second.determined.values())


@pytest.mark.parametrize("name", ["bennett", "bricard", "four_bar", "sarrus"])
def test_multipliers_are_the_shortest(name):
    mech = library(name)
    answer = sp.forward_dynamics(mech, moving(mech))
    jacobian = sp.closure_jacobian(mech, answer.state.q) * mech.velocity_scale
    u, s, _ = np.linalg.svd(jacobian)
    stresses = u[:, np.count_nonzero(s > 1e-10 * s[0]) :]
    assert stresses.shape[1] > 0
    assert stresses.T @ answer.multipliers == pytest.approx(
        np.zeros(stresses.shape[1]), abs=1e-11 * np.abs(answer.multipliers).max())


# ---------------------------------------------------------------- every mechanism


@pytest.mark.parametrize("name", each(LIBRARY))
def test_reactions_and_efforts_move_every_body(name):
    """Reactions, efforts and weight on each body are what its motion needs [d'Alembert]."""
    mech = library(name)
    answer = sp.inverse_dynamics(mech, moving(mech))
    got, need = wrenches_by_body(answer, answer.efforts), needed_by_body(answer.state)
    size = max(np.abs(need).max(), *(np.abs(r.vector).max() for r in answer.reactions.values()))
    assert got[0] == pytest.approx(answer.on_ground.vector, abs=1e-10 * size)
    for i in range(1, mech.model.njoints):
        assert got[i] == pytest.approx(need[i], abs=1e-10 * size), mech.model.names[i]


@pytest.mark.parametrize("name", each(LIBRARY))
def test_power_of_the_drivers_is_the_rate_of_energy(name):
    mech = library(name)
    answer = sp.inverse_dynamics(mech, moving(mech))
    size = sum(abs(p) for p in answer.power.values()) + 1e-3
    assert sum(answer.power.values()) == pytest.approx(energy_rate(answer.state), abs=1e-10 * size)


@pytest.mark.parametrize("name", each(LIBRARY))
def test_forward_undoes_inverse(name):
    mech = library(name)
    answer = sp.inverse_dynamics(mech, moving(mech))
    again = sp.forward_dynamics(mech, answer.state, answer.efforts)
    size = np.abs(answer.a).max()
    assert again.a == pytest.approx(answer.a, abs=1e-9 * size)
    assert again.reactions.keys() == answer.reactions.keys()
    largest = max(np.abs(r.vector).max() for r in answer.reactions.values())
    for pair, force in answer.reactions.items():
        assert again.reactions[pair].vector == pytest.approx(force.vector, abs=1e-9 * largest)


NAMES = ("rssr", "slider_crank", "spherical_four_bar", "stewart", "swash_plate", "watt_six_bar")


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(name=st.sampled_from(NAMES), seed=st.integers(0, 10**6))
def test_inverse_undoes_forward(name, seed):
    mech, rng = library(name), np.random.default_rng(seed)
    state = sp.assemble(mech, {})
    moved = {d: state.coordinate(d).value + rng.uniform(-0.02, 0.02) for d in mech.drivers}
    state = sp.assemble(mech, moved, guess=state)
    state = sp.solve_rates(mech, state, {d: rng.uniform(-2, 2) for d in mech.drivers})
    efforts = {d: float(rng.uniform(-5, 5)) for d in mech.drivers}
    answer = sp.forward_dynamics(mech, state, efforts)
    back = sp.inverse_dynamics(mech, answer.state)
    assert list(back.efforts.values()) == pytest.approx(list(efforts.values()), abs=1e-8)
    work = sum(efforts[d] * state.coordinate(d).rate for d in efforts)
    assert energy_rate(answer.state) == pytest.approx(work, abs=1e-9 * (abs(work) + 1))


@pytest.mark.parametrize("name", ["rssr", "rspc", "crank_collar", "stewart", "delta"])
def test_native_closures_as_pinocchio_solves_them(name):
    mech = library(name)
    state, model = moving(mech), mech.model
    models = pin.StdVec_RigidConstraintModel(mech.constraint_models())
    datas = pin.StdVec_RigidConstraintData([m.createData() for m in models])
    data = model.createData()
    pin.initConstraintDynamics(model, data, models, datas)
    tight = pin.ProximalSettings(1e-13, 1e-10, 40)
    want = pin.constraintDynamics(model, data, state.q, state.v, np.zeros(model.nv), models, datas,
                                  tight)
    found = sp.forward_dynamics(mech, state).a
    assert found == pytest.approx(np.array(want), abs=1e-8 * np.abs(want).max())


# ---------------------------------------------------------------- many loops


@pytest.mark.parametrize("n", [1, 3, 20, 100])
def test_a_ladder_falls_as_one_rod(n, tmp_path):
    mech = ladder(tmp_path, n)
    state, sense = leaning(mech, 0.7, 1.3)
    inertia, weight = (n + 1) / 3 + n, ((n + 1) / 2 + n) * G
    want = sense * weight / inertia * np.sin(0.7)
    assert sp.forward_dynamics(mech, state).a == pytest.approx(want, rel=1e-12)


def test_reactions_take_memory_in_proportion_to_the_number_of_loops(tmp_path):
    """Four times as many loops: by dense factors sixteen times as much."""
    def forces(mech, state):
        answer = sp.forward_dynamics(mech, state)
        assert answer.reactions
        assert not answer.determined["c0"]
        assert sp.inverse_dynamics(mech, state, ["p0"]).reactions

    def memory(n):
        mech = ladder(tmp_path, n)
        state, sense = leaning(mech, 0.7, 1.3)
        state = sp.State(mech, state.q, state.v, sense, closure_error=0.0)
        forces(mech, state)  # what is learnt once
        with peak_memory() as peak:
            forces(mech, state)
        return peak.bytes

    few, many = memory(40), memory(160)
    assert many < 4**1.1 * few


@pytest.mark.parametrize(("n", "lost"), [(30, "30 "), (80, "")])
def test_many_loops_that_lose_rank_are_refused(n, lost, tmp_path):
    """Flat, every window may fold by itself; up to 128 freedoms it is counted.

    What is said is the same whether another configuration was seen before or not.
    """
    mech, said = ladder(tmp_path, n), []
    for _ in range(2):
        with pytest.raises(sp.SingularError, match=f"lose {lost}independent") as caught:
            sp.forward_dynamics(mech, leaning(mech, np.pi / 2, 1.3)[0])
        said.append(str(caught.value))
        sp.forward_dynamics(mech, leaning(mech, 0.7, 1.3)[0])
    assert said[0] == said[1]


@pytest.mark.parametrize("n", few([80, 150], 80))
def test_many_loops_first_met_flat_are_refused(n, tmp_path):
    """Without knowing another configuration; a regular one is taken afterwards."""
    mech = ladder(tmp_path, n)
    for rate in (0.0, 1.3):
        with pytest.raises(sp.SingularError, match="the loops lose independent equations"):
            sp.forward_dynamics(mech, leaning(mech, np.pi / 2, rate)[0])
    state, sense = leaning(mech, 0.7, 1.3)
    weight = ((n + 1) / 2 + n) * G / ((n + 1) / 3 + n)
    want = sense * weight * np.sin(0.7)
    assert sp.forward_dynamics(mech, state).a == pytest.approx(want, rel=1e-12)


def test_frames_of_many_branches_are_where_the_whole_tree_has_them(tmp_path):
    mech, rng = ladder(tmp_path, 40), np.random.default_rng(4)
    state = sp.State(mech, *rng.uniform(-1, 1, (3, mech.model.nv)), closure_error=0.0)
    model, data = mech.model, mech.model.createData()
    pin.forwardKinematics(model, data, state.q, state.v, state.a)
    pin.updateFramePlacements(model, data)
    axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    for name in ("ground", "p7", "r7", "c0", "e39", "t40"):
        frame = mech.frame_id(name)
        assert state.placement(name).homogeneous == pytest.approx(
            data.oMf[frame].homogeneous, rel=1e-14, abs=1e-15)
        for found, want in (
                (state.velocity(name), pin.getFrameVelocity(model, data, frame, axes)),
                (state.acceleration(name),
                 pin.getFrameClassicalAcceleration(model, data, frame, axes))):
            assert found.vector == pytest.approx(want.vector, rel=1e-13, abs=1e-13), name
    assert "data" not in vars(state)


def test_many_loops_and_a_wheel_without_inertia(tmp_path):
    """The wheel stays as it is unless a torque acts; the ladder falls all the same."""
    mech = ladder(tmp_path, 40)
    path = tmp_path / f"{mech.name}.urdf"
    wheel = known.turning("axle", "ground", "wheel")
    path.write_text(path.read_text(encoding="utf-8").replace("</robot>", wheel + "</robot>"),
                    encoding="utf-8")
    mech = sp.load(tmp_path / f"{mech.name}.toml")
    sense = np.array([{"p": -1.0, "k": 1.0, "a": 0.0}[name[0]] for name in mech.coordinates])
    state = sp.State(mech, 0.7 * sense, 1.3 * sense, closure_error=0.0)
    want = sense * (41 / 2 + 40) * G / (41 / 3 + 40) * np.sin(0.7)
    assert sp.forward_dynamics(mech, state).a == pytest.approx(want, abs=1e-10)
    with pytest.raises(sp.SingularError, match="axle has no inertia but a force works on it"):
        sp.forward_dynamics(mech, state, {"axle": 1.0})


def test_many_loops_there_and_back(tmp_path):
    mech = ladder(tmp_path, 30)
    state, _ = leaning(mech, 0.7, 1.3)
    answer = sp.forward_dynamics(mech, state, {"p0": 2.0})
    back = sp.inverse_dynamics(mech, answer.state, ["p0"])
    assert back.efforts["p0"] == pytest.approx(2.0, abs=1e-10)
    got, need = wrenches_by_body(answer, {"p0": 2.0}), needed_by_body(answer.state)
    assert got[1:] == pytest.approx(need[1:], abs=1e-9)


# ---------------------------------------------------------------- singular, and sprung


def test_a_flat_parallelogram_is_refused(tmp_path):
    mech = known.bare_four_bar(tmp_path, 0.3, 0.1, 0.3, 0.1)
    mech = with_masses(mech, tmp_path, **dict.fromkeys(("crank", "coupler", "rocker"), (
        1.0, (0.05, 0, 0), (1e-3,) * 3)))
    state = sp.State(mech, np.zeros(3), np.zeros(3), closure_error=0.0)
    for solve in (sp.forward_dynamics, sp.inverse_dynamics):
        with pytest.raises(sp.SingularError, match="the loops lose 1 independent equation"):
            solve(mech, state)


def test_power_with_springs_and_dampers(tmp_path):
    toml = spring(name="line", frames=["tip", "ground"], stiffness=300.0, damping=20.0,
                  free_length=0.1)
    toml += spring(name="turn", joint="rocker_pin", stiffness=4.0, damping=0.3, free_angle=0.5)
    mech = heavy_four_bar(tmp_path, toml)
    state = four_bar_state(mech, 0.3)
    answer = sp.inverse_dynamics(mech, state)
    tip, rocker = state.placement("tip").translation, state.coordinate("rocker_pin")
    rate = tip @ state.velocity("tip").linear / np.linalg.norm(tip)
    pull = 300.0 * (np.linalg.norm(tip) - 0.1) + 20.0 * rate
    torque = 4.0 * (rocker.value - 0.5) + 0.3 * rocker.rate
    work = answer.power["crank"] - pull * rate - torque * rocker.rate
    assert energy_rate(answer.state) == pytest.approx(work, rel=1e-11)
    # by body: the line pulls the coupler at its tip, the turning spring turns the rocker back
    got, need = wrenches_by_body(answer, {**answer.efforts, "rocker_pin": -torque}), needed_by_body(
        answer.state)
    force = -pull * tip / np.linalg.norm(tip)
    got[mech.joint_id("coupler_pin")] += np.concatenate([force, np.cross(tip, force)])
    assert got[1:] == pytest.approx(need[1:], abs=1e-10)
    got[0] -= np.concatenate([force, np.zeros(3)])
    assert got[0] == pytest.approx(answer.on_ground.vector, abs=1e-10)


def test_laws_that_change_between_calls_are_taken_as_they_are_then(tmp_path):
    tree = known.sliding("slide", "ground", "block")
    mech = known.load(tmp_path, "sprung", tree.replace(
        '<link name="block"/>', '<link name="block"><inertial><mass value="2.0"/><inertia '
        'ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'),
        '[[springs]]\nname = "s"\njoint = "slide"\nstiffness = 1.0\n')
    state = sp.assemble(mech, {}, {"slide": 0.5})
    laws = {"s": lambda x, rate: 8.0 * x}
    first = sp.forward_dynamics(mech, state, laws=laws).a[0]
    laws["s"] = lambda x, rate: 0.0
    assert sp.forward_dynamics(mech, state, laws=laws).a[0] - first == pytest.approx(2.0)
    assert sp.forward_dynamics(mech, state).a[0] - first == pytest.approx(2.0 - 0.25)
