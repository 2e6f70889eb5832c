"""Damping, dry friction and armature of joints: closed forms, energy, derivatives, files."""

from __future__ import annotations

import mechanisms as known
import numpy as np
import pinocchio as pin
import pytest
from masses import heavy
from mechanisms import content_of, from_text
from resisting import CASES, HARD, LISTED, hard, resisting
from scipy.integrate import solve_ivp
from variety import first

import spatial_pin as sp

G = 9.81
BOB = (1.5, (0.4, 0, 0), (0.0, 0.02, 0.02))
FORMULATIONS = ("independent", "projected")


def pendulum(folder, toml="", tag=""):
    """The angle is counted from hanging down; unit moment of inertia 0.26 kg·m² about the pin."""
    tree = heavy(known.turning("pin", "ground", "bob", axis=(0, -1, 0), rpy=(0, np.pi / 2, 0)),
                 bob=BOB).replace("</joint>", f"{tag}</joint>")
    return known.load(folder, "pendulum", tree, toml + known.driver("pin", "pin"))


def block(folder, toml="", gravity="[0.0, 0.0, 0.0]"):
    tree = heavy(known.sliding("rail", "ground", "block", axis=(1, 0, 0)),
                 block=(2.0, (0, 0, 0), (0.1, 0.1, 0.1)))
    return known.load(folder, "block", tree, f"gravity = {gravity}\n" + toml
                      + known.driver("rail", "rail"))


def pushed(mech, **rates):
    return sp.solve_rates(mech, sp.assemble(mech, {}), rates)


def simulate(mech, state, duration, formulation="independent", **more):
    accuracy = sp.Accuracy(formulation=formulation, **more.pop("accuracy", {}))
    return sp.simulate(mech, state, duration, accuracy=accuracy, **more)


# ---------------------------------------------------------------- closed forms


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_a_damped_block_slows_down_exponentially(formulation, tmp_path):
    mech = block(tmp_path, "[joints.rail]\ndamping = 3.0\n")
    motion = simulate(mech, pushed(mech, rail=1.3), 2.0, formulation)
    x, v, a = motion.coordinate("rail")
    fall = np.exp(-1.5 * motion.time)
    assert v == pytest.approx(1.3 * fall, abs=1e-11)
    assert x == pytest.approx(1.3 / 1.5 * (1.0 - fall), abs=1e-11)
    assert a == pytest.approx(-1.5 * 1.3 * fall, abs=1e-10)
    assert motion.work == pytest.approx(1.3**2 * (fall**2 - 1.0), abs=1e-11)
    assert motion.energy_drift < 1e-11


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_a_damped_pendulum_swings_as_the_small_oscillation_says(formulation, tmp_path):
    """The damping is that of the URDF."""
    mech = pendulum(tmp_path, tag='<dynamics damping="0.13"/>')
    inertia = 0.02 + 1.5 * 0.4**2
    delta, w0 = 0.13 / (2 * inertia), np.sqrt(1.5 * G * 0.4 / inertia)
    w, start = np.sqrt(w0**2 - delta**2), 1e-3
    motion = simulate(mech, sp.assemble(mech, {"pin": start}), 3.0, formulation)
    t = motion.time
    small = start * np.exp(-delta * t) * (np.cos(w * t) + delta / w * np.sin(w * t))
    assert motion.coordinate("pin")[0] == pytest.approx(small, abs=2 * start**3)
    assert motion.energy_drift < 1e-7  # energies of 1e-6 J beside one of 6 J


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_a_block_rubs_to_rest(formulation, tmp_path):
    """It stops after v0 m / friction, having gone v0² m / 2 friction, up to the slip speed."""
    mech = block(tmp_path, "[joints.rail]\nfriction = 5.0\nslip_speed = 1e-4\n")
    motion = simulate(mech, pushed(mech, rail=2.0), 2.0, formulation)
    x, v, _ = motion.coordinate("rail")
    stop = 2.0 * 2.0 / 5.0
    before = motion.time < stop - 1e-3
    t = motion.time[before]
    assert v[before] == pytest.approx(2.0 - 2.5 * t, abs=1e-4)
    assert x[before] == pytest.approx(2.0 * t - 1.25 * t**2, abs=1e-4)
    assert np.abs(v[motion.time > stop + 1e-2]).max() < 1e-9
    assert x[-1] == pytest.approx(2.0**2 * 2.0 / 2 / 5.0, abs=1e-4)
    assert motion.work[-1] == pytest.approx(-4.0, abs=1e-9)
    assert motion.energy_drift < 1e-9


def test_what_friction_should_hold_creeps_at_a_part_of_the_slip_speed(tmp_path):
    """On a slope; at rest itself a regularised law has no friction."""
    toml = "[joints.rail]\nfriction = 5.0\n"
    mech = block(tmp_path, toml, gravity="[1.25, 0.0, -9.0]")
    at_rest = sp.assemble(mech, {"rail": 0.0})
    assert sp.forward_dynamics(mech, at_rest).a == pytest.approx([1.25], rel=1e-13)
    motion = simulate(mech, at_rest, 1.0, slip_speed=0.02)
    creep = 0.02 * mech.characteristic_length * np.arctanh(2.0 * 1.25 / 5.0)
    assert motion.v[-1] == pytest.approx([creep], rel=1e-9)


def test_the_slip_speed_of_a_call_goes_before_that_of_the_file(tmp_path):
    mech = block(tmp_path, "[joints.rail]\nfriction = 5.0\nslip_speed = 0.5\n")
    state = pushed(mech, rail=0.2)
    for slip, want in ((None, 0.5), (0.3, 0.3 * mech.characteristic_length), ({"rail": 0.1}, 0.1)):
        answer = sp.forward_dynamics(mech, state, slip_speed=slip)
        assert answer.a == pytest.approx([-2.5 * np.tanh(0.2 / want)], rel=1e-13)
        efforts = sp.inverse_dynamics(mech, state, slip_speed=slip).efforts
        assert efforts["rail"] == pytest.approx(5.0 * np.tanh(0.2 / want), rel=1e-13)
    with pytest.raises(ValueError, match="slip_speed of 'rail'"):
        sp.forward_dynamics(mech, state, slip_speed={"rail": 0.0})
    with pytest.raises(sp.SpatialPinError, match="'rial'"):
        sp.forward_dynamics(mech, state, slip_speed={"rial": 0.1})


def test_an_armature_adds_to_the_inertia_and_nothing_to_what_the_pin_bears(tmp_path):
    plain, geared = pendulum(tmp_path), pendulum(tmp_path, "[joints.pin]\narmature = 0.3\n")
    assert geared.model.armature.tolist() == [0.3]
    state = sp.solve_rates(geared, sp.assemble(geared, {"pin": 0.7}), {"pin": 1.1})
    inertia = 0.02 + 1.5 * 0.4**2
    a = (0.25 - 1.5 * G * 0.4 * np.sin(0.7)) / (inertia + 0.3)
    answer = sp.forward_dynamics(geared, state, {"pin": 0.25})
    assert answer.a == pytest.approx([a], rel=1e-13)
    same = sp.solve_rates(plain, sp.assemble(plain, {"pin": 0.7}), {"pin": 1.1}, {"pin": a})
    bare = sp.inverse_dynamics(plain, same)
    assert bare.efforts["pin"] == pytest.approx(0.25 - 0.3 * a, rel=1e-12)
    assert answer.reactions["pin"].vector == pytest.approx(bare.reactions["pin"].vector, abs=1e-13)
    assert answer.on_ground.vector == pytest.approx(bare.on_ground.vector, abs=1e-13)


# ---------------------------------------------------------------- loops


def moving(mech):
    state = sp.assemble(mech, {})
    return sp.solve_rates(mech, state, dict.fromkeys(mech.drivers, 0.7),
                          dict.fromkeys(mech.drivers, 0.4))


@pytest.mark.parametrize(("name", "joints"), first(4, CASES))
def test_efforts_are_those_without_and_what_resists(name, joints):
    """By virtual work, and as accelerations under these efforts are those they were for."""
    mech, bare = hard(name, joints), sp.load(name).model
    state = moving(mech)
    found = sp.inverse_dynamics(mech, state)
    model, v, a = mech.model, state.v, found.a
    slip = np.where(np.isnan(mech.slip_speeds), 1.0, mech.slip_speeds)
    extra = (model.damping * v + model.armature * a
             + model.upperDryFrictionLimit * np.tanh(v / slip))
    work = pin.rnea(bare, bare.createData(), state.q, v, a) @ v
    assert np.any(extra)
    assert sum(found.power.values()) == pytest.approx(work + extra @ v, rel=1e-9)
    forward = sp.forward_dynamics(mech, state, found.efforts)
    assert forward.a == pytest.approx(a, rel=1e-7, abs=1e-7 * np.abs(a).max())


@pytest.mark.parametrize(("name", "joints"), first(2, CASES[:4]))
@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_energy_goes_where_the_joints_resist(name, joints, formulation):
    mech = hard(name, joints)
    motion = simulate(mech, moving(mech), 0.6, formulation, accuracy={"time_tolerance": 1e-9})
    assert motion.energy_drift < 1e-6
    assert np.all(np.diff(motion.work) <= 0.0) and motion.work[-1] < 0.0


def test_a_damped_four_bar_moves_as_an_integration_of_its_own_says():
    """In the crank's angle, by power: d(kinetic + potential)/dt = -damping . rates²."""
    damping = {"crank_pin": 0.3, "coupler_pin": 0.2, "rocker_pin": 0.1}
    bare = sp.load("four_bar")
    mech = resisting(bare, **{k: {"damping": c} for k, c in damping.items()
                              if k in bare.coordinates})
    c = mech.model.damping
    assert np.count_nonzero(c) >= 2
    driver, = bare.drivers
    at = bare.coordinate(driver).v
    data = bare.model.createData()

    def reduced(angle):
        state = sp.solve_rates(bare, sp.assemble(bare, {driver: angle}), {driver: 1.0})
        return state.q, state.v, state.a

    def rate(_, y):
        q, t, curved = reduced(y[0])
        m = t @ pin.crba(bare.model, data, q) @ t
        rest = pin.rnea(bare.model, data, q, y[1] * t, y[1] ** 2 * curved)
        return [y[1], (-t @ rest - (t * c) @ t * y[1]) / m]

    state = sp.solve_rates(mech, sp.assemble(mech, {driver: 0.3}), {driver: 2.0})
    motion = sp.simulate(mech, state, 0.5, times=[0.0, 0.25, 0.5])
    own = solve_ivp(rate, (0.0, 0.5), [0.3, 2.0], rtol=1e-9, atol=1e-10, t_eval=motion.time)
    assert motion.q[:, bare.coordinate(driver).q] == pytest.approx(own.y[0], abs=1e-7)
    assert motion.v[:, at] == pytest.approx(own.y[1], abs=1e-6)


def test_kinetostatics_is_inverse_dynamics_of_every_row():
    mech = hard("rssr", {"crank_pin": HARD, "ball_a": LISTED})
    motion = sp.sweep(mech, "crank", np.linspace(0.0, 1.0, 4), speed=2.0, acceleration=0.5)
    rows = sp.kinetostatics(mech, motion)
    for k in range(4):
        one = sp.inverse_dynamics(mech, motion.state(k))
        assert rows.efforts["crank"][k] == pytest.approx(one.efforts["crank"], rel=1e-12)
        for name, force in one.reactions.items():
            assert rows.reactions[name][k] == pytest.approx(force.vector, rel=1e-9, abs=1e-11)


@pytest.mark.parametrize(("name", "joints"), [CASES[1], CASES[3], CASES[4]])
def test_derivatives_with_all_that_resists(name, joints):
    """Of accelerations and reactions, against central differences."""
    mech = hard(name, joints)
    state = moving(mech)
    found = sp.dynamics_derivatives(mech, state)
    nv, size = mech.model.nv, mech.velocity_scale

    def both(q, v):
        answer = sp.forward_dynamics(mech, sp.State(mech, q, v, closure_error=0.0,
                                                 angles=state.angles))
        return answer.a, np.concatenate([answer.reactions[n].vector for n in found.reactions])

    rng = np.random.default_rng(2)
    for _ in range(2):
        d, h = size * rng.uniform(-1, 1, nv), 1e-5
        ends = [both(pin.integrate(mech.model, state.q, s * h * d), state.v) for s in (1, -1)]
        turned = [both(state.q, state.v + s * h * d) for s in (1, -1)]
        reactions = [np.vstack([getattr(r, k) for r in found.reactions.values()])
                     for k in ("by_q", "by_v")]
        for (more, less), by, border in ((ends, found.a_by_q, reactions[0]),
                                         (turned, found.a_by_v, reactions[1])):
            for got, k in ((by @ d, 0), (border @ d, 1)):
                want = (more[k] - less[k]) / (2 * h)
                assert got == pytest.approx(want, abs=2e-5 * max(np.abs(want).max(), 1.0))


PAIRS = {"spherical": 3, "universal": 2, "cylindrical": 2, "planar": 3, "floating": 6, "screw": 1}


@pytest.mark.parametrize("pair", PAIRS)
def test_every_pair_resists_coordinate_by_coordinate(pair, tmp_path):
    """By Pinocchio's own algorithm with the forces put in; derivatives; energy."""
    rng, n = np.random.default_rng(4), PAIRS[pair]
    values = {key: rng.uniform(0.1, 0.5, n).round(3).tolist() for key in LISTED}
    lines = "".join(f"{key} = {x}\n" for key, x in values.items())
    lines += "lead = 0.05\n" if pair == "screw" else ""
    tree = heavy(known.turning("base", "ground", "arm", axis=(0, 1, 0))
                 + known.floating("joint", "arm", "tip", (0.3, 0, 0.1)),
                 arm=(1.0, (0.1, 0, 0), (0.01, 0.02, 0.02)),
                 tip=(0.7, (0.1, 0.02, 0.03), (0.01, 0.015, 0.02)))
    mech = known.load(tmp_path, pair, tree, f'[joints.joint]\ntype = "{pair}"\n{lines}')
    nv, model, data = mech.model.nv, mech.model, mech.model.createData()
    q = pin.integrate(model, mech.neutral, rng.uniform(-0.5, 0.5, nv))
    v = rng.uniform(-1.0, 1.0, nv)
    tau, own = np.zeros(nv), v[1:]
    tau[1:] = -(values["damping"] * own
                + values["friction"] * np.tanh(own / values["slip_speed"]))
    state = sp.State(mech, q, v, closure_error=0.0)
    assert sp.forward_dynamics(mech, state).a == pytest.approx(pin.aba(model, data, q, v, tau),
                                                            rel=1e-10, abs=1e-10)
    found, h = sp.dynamics_derivatives(mech, state), 1e-6

    def a(q, v):
        return sp.forward_dynamics(mech, sp.State(mech, q, v, closure_error=0.0)).a

    for k, d in enumerate(h * np.eye(nv)):
        by_v = (a(q, v + d) - a(q, v - d)) / (2 * h)
        by_q = (a(pin.integrate(model, q, d), v) - a(pin.integrate(model, q, -d), v)) / (2 * h)
        assert found.a_by_v[:, k] == pytest.approx(by_v, abs=1e-7)
        assert found.a_by_q[:, k] == pytest.approx(by_q, abs=1e-7)
    ends = [simulate(mech, state, 0.5, f) for f in FORMULATIONS]
    assert max(m.energy_drift for m in ends) < 1e-9
    assert ends[0].q[-1] == pytest.approx(ends[1].q[-1], abs=1e-8)


def test_drives_work_against_what_resists():
    mech = hard("four_bar", {})
    start = sp.solve_rates(mech, sp.assemble(mech, {"crank": 0.3}), {"crank": 2.0})
    motion = sp.simulate(mech, start, 0.5, drives={"crank": sp.laws.constant_speed(0.3, 2.0)})
    assert motion.energy_drift < 1e-9 and motion.work[-1] != 0.0
    needed = sp.kinetostatics(mech, motion).efforts["crank"]
    assert motion.efforts["crank"] == pytest.approx(needed, rel=1e-8)


# ---------------------------------------------------------------- stiff motions


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_strong_damping_does_not_make_a_simulation_crawl(formulation, tmp_path):
    """Its time constant is 1e-8 s: an explicit method would need 1e8 steps."""
    mech = pendulum(tmp_path, "[joints.pin]\ndamping = 2.6e7\n")
    motion = simulate(mech, sp.assemble(mech, {"pin": 1.0}), 2.0, formulation)
    creep = 1.5 * G * 0.4 / 2.6e7
    assert motion.steps < 300
    assert motion.integrators == ["DOP853", "Radau"] and "(Radau where stiff)" in str(motion)
    assert motion.coordinate("pin")[0][-1] == pytest.approx(
        2 * np.arctan(np.tan(0.5) * np.exp(-creep * 2.0)), rel=1e-10)


def test_friction_that_comes_to_rest_and_goes_on_is_integrated_by_both_methods(tmp_path):
    """A block shaken harder than it rubs: it sticks twice a turn, and slips in between."""
    mech = block(tmp_path, "[joints.rail]\nfriction = 5.0\nslip_speed = 1e-6\n")
    motion = sp.simulate(mech, sp.assemble(mech, {}), 1.6,
                         lambda t, _: {"rail": 8.0 * np.sin(4.0 * t)})
    assert motion.steps < 5000 and motion.energy_drift < 1e-9
    assert motion.integrators == ["DOP853", "Radau"]
    stuck = np.abs(motion.v[:, 0]) < 1e-5
    assert 0.1 < stuck.mean() < 0.7
    assert np.abs(8.0 * np.sin(4.0 * motion.time[stuck])).max() < 5.1


@pytest.mark.parametrize(("chosen", "what", "text"), [
    ({"integrator": "DOP853"}, "damping = 2e3", r"damping of 'pin' is stiff\. Leave the integr"),
    ({"integrator": "RK45"}, "friction = 2e3", r"the dry friction of 'pin' is stiff"),
    ({"integrator": "RK4", "step": 1e-3}, "damping = 910.0", r"0\.00\d s .*'RK4' .*of 'pin'"),
])
def test_an_explicit_integrator_that_creeps_says_so(chosen, what, text, tmp_path):
    mech = pendulum(tmp_path, f"[joints.pin]\n{what}\n")
    start = sp.assemble(mech, {"pin": 1.0})
    with pytest.warns(sp.SpatialPinWarning, match=text):
        sp.simulate(mech, start, 10.0 * chosen.get("step", 0.01), slip_speed=1.0,
                    accuracy=sp.Accuracy(**chosen, time_tolerance=1e-6))


# ---------------------------------------------------------------- files


def test_values_of_the_file_go_before_those_of_the_urdf(tmp_path):
    tag = '<dynamics damping="0.5" friction="0.25"/>'
    model = pendulum(tmp_path, "[joints.pin]\ndamping = 0.0\narmature = 0.1\n", tag).model
    assert model.damping.tolist() == [0.0]
    assert model.upperDryFrictionLimit.tolist() == [0.25]
    assert model.lowerDryFrictionLimit.tolist() == [-0.25]
    assert model.armature.tolist() == [0.1]


@pytest.mark.parametrize(("text", "complaint"), [
    ("damping = -1.0", r"toml: joints\.pin: damping is -1"),
    ("friction = [-1.0]", r"joints\.pin: friction is -1"),
    ("armature = nan", r"joints\.pin: armature is nan"),
    ("dampin = 1.0\ntype = \"revolute\"", r"joints\.pin: dampin is not a key .* did you mean"),
    ("damping = \"much\"", r"joints\.pin: damping must be a number"),
    ("damping = [1.0, 2.0]", r"joints\.pin: damping has 2 numbers; .* 1 coordinate"),
    ("damping = []", r"joints\.pin: damping is an empty list"),
    ("slip_speed = 0.0", r"joints\.pin: slip_speed is 0"),
    ("type = \"fixed\"\nfriction = 1.0", r"friction: joint 'pin' is fixed"),
])
def test_what_cannot_be_is_refused_with_file_and_key(text, complaint, tmp_path):
    with pytest.raises(sp.MechanismFileError, match=complaint):
        pendulum(tmp_path, f"[joints.pin]\n{text}\n").coordinate("pin")


def test_negative_damping_of_a_urdf_is_refused(tmp_path):
    with pytest.raises(sp.MechanismFileError, match=r"joint 'pin': <dynamics damping> is negative"):
        pendulum(tmp_path, tag='<dynamics damping="-0.5"/>')


def same_resistance(one, other):
    assert one.coordinates == other.coordinates
    for key in ("damping", "upperDryFrictionLimit", "lowerDryFrictionLimit", "armature"):
        assert getattr(one.model, key).tolist() == getattr(other.model, key).tolist()
    assert np.array_equal(one.slip_speeds, other.slip_speeds, equal_nan=True)


def test_files_written_keep_what_resists(tmp_path, run):
    tag = '<dynamics damping="0.5" friction="0.25"/>'
    mech = pendulum(tmp_path, "[joints.pin]\ndamping = 0.0\narmature = 0.1\n", tag)
    assert run("export", mech.path, "--urdf", tmp_path / "copy.urdf")[0] == 0
    same_resistance(sp.load(tmp_path / "copy.toml"), mech)
    made = from_text(mech.urdf, content_of(mech), "here.toml")
    same_resistance(made, mech)
    listed = hard("rssr", {"crank_pin": HARD, "ball_a": LISTED})
    saved = listed.save(tmp_path / "folder")
    same_resistance(sp.load(saved), listed)
    assert run("export", saved, "--urdf", tmp_path / "listed.urdf")[0] == 0
    same_resistance(sp.load(tmp_path / "listed.toml"), listed)


def test_a_reduced_mechanism_resists_alike():
    full = hard("watt_six_bar", {})
    reduced = sp.reduce(full, "output_pin", dynamics=True)
    for name in reduced.coordinates:
        at, own = full.coordinate(name).v, reduced.coordinate(name).v
        assert reduced.model.damping[own] == full.model.damping[at] == 0.2
        assert reduced.model.armature[own] == 0.05
        assert reduced.model.upperDryFrictionLimit[own] == 0.3
    assert reduced.verify().worst < 1e-9


def test_info_tells_what_resists(tmp_path, run):
    told = run("info", hard("rssr", {"crank_pin": HARD}).save(tmp_path))[1]
    text = " ".join(told.split())
    assert ("damping 0.2 N·m·s/rad, dry friction 0.3 N·m, armature 0.05 kg·m², slip speed 0.4 rad/s"
            in text)
