"""Mass, the centre of all mass, angles of links, components: outputs and targets by one name."""

from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from loaded_library import library
from variety import few

import spatial_pin as sp

TIMES = np.linspace(0.0, 1.0, 21)


@cache
def four_bar() -> sp.Motion:
    return sp.sweep(library("four_bar"), "crank", np.linspace(0.0, 4.0 * np.pi, 61), speed=2.0)


@cache
def excavator() -> tuple[sp.Mechanism, sp.State]:
    mechanism = library("excavator")
    return mechanism, sp.assemble(mechanism)


def at(state: sp.State, name: str) -> float:
    """Return an output of a state, as a motion of one sample tells it."""
    driver = next(iter(state.mechanism.drivers))
    value = state.coordinate(driver).value
    return sp.sweep(state.mechanism, driver, [value], guess=state).output(name).values[0]


# ---------------------------------------------------------------- the outputs


def test_mass_and_its_centre_are_those_of_pinocchio():
    motion = four_bar()
    model = motion.mechanism.model
    data = model.createData()
    assert motion.output("mass").values == pytest.approx(pin.computeTotalMass(model), rel=1e-15)
    assert motion.output("mass").unit == "kg"
    found = [motion.output(f"com.{kind}").values for kind in ("position", "velocity",
                                                              "acceleration")]
    for k in range(len(motion)):
        pin.centerOfMass(model, data, *(np.array(x[k]) for x in (motion.q, motion.v, motion.a)))
        for x, own in zip(found, (data.com[0], data.vcom[0], data.acom[0]), strict=True):
            assert x[k] == pytest.approx(own, abs=1e-12 * (1.0 + np.abs(own).max()))


def test_the_jerk_of_the_centre_is_the_derivative_of_its_acceleration():
    mechanism = library("four_bar")
    h = 1e-4
    motion = sp.sweep(mechanism, "crank", 1.0 + h * np.arange(-1, 2), speed=1.0)
    a = motion.output("com.acceleration").values
    assert motion.output("com.jerk").values[1] == pytest.approx((a[2] - a[0]) / (2 * h), abs=1e-6)


def test_shaking_forces_are_mass_times_acceleration_of_the_centre():
    mechanism = library("four_bar")
    motion = sp.sweep(mechanism, "crank", np.linspace(0.0, 6.0, 7), speed=10.0)
    loads = sp.kinetostatics(mechanism, motion)
    mass, a = (loads.output(x).values for x in ("mass", "com.acceleration"))
    weight = np.array(mechanism.model.gravity.linear)
    assert loads.output("on_ground.force").values == pytest.approx(
        -mass[:, None] * (a - weight), abs=1e-9)


def test_angles_of_links_of_a_plane_mechanism_are_sums_that_count_turns():
    motion = four_bar()
    crank, coupler = (motion.coordinate(x).value for x in ("crank_pin", "coupler_pin"))
    assert motion.output("crank.angle").values == pytest.approx(crank, abs=1e-14)
    assert motion.output("coupler.angle").values == pytest.approx(crank + coupler, abs=1e-12)
    assert np.ptp(motion.output("crank.angle").values) == pytest.approx(4.0 * np.pi)
    two = sp.sweep(motion.mechanism, "crank", [0.0, 4.0 * np.pi])  # turns are not seen between
    assert np.ptp(two.output("crank.angle").values) == pytest.approx(4.0 * np.pi)
    x = motion.frame("coupler").rotation[:, :, 0]  # hinges of the file are about -y
    off = motion.output("coupler.angle").values - np.arctan2(x[:, 2], x[:, 0])
    assert np.sin(off) == pytest.approx(np.zeros(len(motion)), abs=1e-12)
    assert motion.output("coupler.angle.y").values == pytest.approx(
        -motion.output("coupler.angle").values, abs=1e-12)


def test_angles_about_a_named_axis_have_no_jumps_in_space():
    motion = sp.sweep(library("rssr"), "crank", np.linspace(0.0, 4.0 * np.pi, 241), speed=1.0)
    angle = motion.output("crank.angle.x").values
    assert np.abs(np.diff(angle)).max() < 0.2
    for name, first, second in (("coupler.angle.z", 0, 1), ("coupler.angle.y", 2, 0)):
        angle = motion.output(name).values
        x = motion.frame("coupler").rotation[:, :, 0]
        off = angle - np.arctan2(x[:, second], x[:, first])
        turned = off - off[0]
        assert np.sin(turned) == pytest.approx(0.0 * turned, abs=1e-12)
        assert np.abs(np.diff(angle)).max() < 0.5
    with pytest.raises(sp.SpatialPinError, match=r"not parallel.*say about which"):
        excavator_motion().output("bucket.angle")


@cache
def excavator_motion() -> sp.Motion:
    mechanism, state = excavator()
    return sp.follow(mechanism, {"boom": np.linspace(2.7, 2.75, 5)}, guess=state)


def test_the_rate_of_an_angle_in_the_plane_is_the_angular_velocity():
    mechanism, state = excavator()
    motion = sp.follow(mechanism, {"boom": 2.7 + 0.05 * TIMES}, TIMES, guess=state)
    from scipy.interpolate import CubicSpline
    rate = CubicSpline(TIMES, motion.output("bucket.angle.y").values)(TIMES, 1)
    assert motion.output("bucket.angular_velocity.y").values[3:-3] == pytest.approx(
        rate[3:-3], abs=1e-7)


@pytest.mark.parametrize("name", ["coupler.position", "coupler.com.velocity", "com.position"])
def test_components_are_columns_of_the_vector(name):
    motion = four_bar()
    whole = motion.output(name)
    for k, x in enumerate("xyz"):
        part = motion.output(f"{name}.{x}")
        assert np.array_equal(part.values, whole.values[:, k])
        assert (part.label, part.unit) == (f"{whole.label} {x}", whole.unit)
    heads = list(motion.columns([f"{name}.z"]))
    assert heads[-1] == list(motion.columns([name]))[-1]


def test_components_of_forces_are_outputs_of_loads_and_sensitivities():
    motion = four_bar()
    loads = sp.kinetostatics(motion.mechanism, motion)
    force = loads.output("output_pin.reaction.force")
    assert np.array_equal(loads.output("output_pin.reaction.force.z").values, force.values[:, 2])
    assert loads.output("on_ground.moment.y").unit == "N·m"
    with pytest.raises(sp.SpatialPinError, match="kinetostatics"):
        motion.output("output_pin.reaction.force.z")
    state = motion.state(3)
    parts = [sp.sensitivity(motion.mechanism, state, f"output_pin.reaction.force{x}", ["r2"])
             for x in ("", ".z")]
    assert parts[1].derivatives["r2"] == pytest.approx(parts[0].derivatives["r2"][2], rel=1e-12)


@pytest.mark.parametrize("name", ["coupler.angel", "com.positon", "mas", "coupler.position.w"])
def test_names_that_do_not_exist_are_reported_with_those_that_do(name):
    with pytest.raises(sp.UnknownNameError, match="did you mean") as caught:
        four_bar().output(name)
    assert {"mass", "com.position", "coupler.angle"} <= set(caught.value.valid)


def test_a_mechanism_without_mass_has_no_centre(tmp_path):
    (tmp_path / "a.urdf").write_text(
        '<robot name="a"><link name="base"/><link name="arm"/><joint name="j" type="continuous">'
        '<parent link="base"/><child link="arm"/><axis xyz="0 0 1"/></joint></robot>')
    mechanism = sp.load(tmp_path / "a.urdf")
    motion = sp.sweep(mechanism, "j", [0.0, 1.0])
    assert motion.output("mass").values == pytest.approx([0.0, 0.0])
    with pytest.raises(sp.SpatialPinError, match="no mass"):
        motion.output("com.position")
    with pytest.raises(sp.SpatialPinError, match="no mass"):
        sp.reach(mechanism, {"com.position.x": 0.1})


# ---------------------------------------------------------------- where outputs are asked for


@pytest.mark.parametrize("output", few(
    ["mass", "com.position", "com.velocity.z", "coupler.angle", "coupler.angle.y",
     "coupler.velocity.x"], "mass", "com.velocity.z", "coupler.angle"))
def test_sensitivities_are_those_of_mechanisms_made_anew(output):
    state = four_bar().state(4)
    mechanism, h, value = state.mechanism, 1e-5, state.coordinate("crank").value
    found = sp.sensitivity(mechanism, state, output, ["r2", "r3"])
    for name in ("r2", "r3"):
        ends = []
        for sign in (1.0, -1.0):
            other = library("four_bar", **{name: mechanism.dimensions[name] + sign * h})
            guess = {c: state.coordinate(c).value for c in mechanism.coordinates}
            ends.append(sp.sweep(other, "crank", [value], speed=2.0, guess=guess)
                        .output(output).values[0])
        assert found.derivatives[name] == pytest.approx((ends[0] - ends[1]) / (2 * h), abs=1e-6)


def test_an_angle_near_half_a_turn_has_a_derivative_and_a_spread():
    mechanism = library("four_bar")
    state = sp.assemble(mechanism, {"crank": 0.0})
    own = sp.sensitivity(mechanism, state, "coupler.angle", ["r2"])
    turned = sp.assemble(mechanism, {"crank": 2.0 * np.pi}, state)
    assert turned.coordinate("crank").value == pytest.approx(2.0 * np.pi)
    spread = sp.tolerance(mechanism, ["coupler.angle", "mass", "com.position.x"], {"r2": 1e-4},
                          state, samples=20)
    assert spread.linear["coupler.angle"] == pytest.approx(1e-4 * abs(own.derivatives["r2"]))
    assert spread.sampled["coupler.angle"] < 3.0 * spread.linear["coupler.angle"]
    assert spread.linear["mass"] == pytest.approx(
        1e-4 * abs(sp.sensitivity(mechanism, state, "mass", ["r2"]).derivatives["r2"]))


def test_half_a_turn_has_one_sign(tmp_path):
    for yaw in (3.141592653589793, -3.141592653589793):
        (tmp_path / "a.urdf").write_text(
            '<robot name="a"><link name="base"/><link name="arm"/><joint name="j" '
            f'type="continuous"><origin rpy="0 0 {yaw!r}"/><parent link="base"/><child link="arm"/>'
            '<axis xyz="0 0 1"/></joint></robot>')
        motion = sp.sweep(sp.load(tmp_path / "a.urdf"), "j", [0.0, 0.5])
        for name in ("arm.angle", "arm.angle.z"):
            assert motion.output(name).values == pytest.approx([np.pi, np.pi + 0.5], abs=1e-12)


def test_plots_tables_and_pages_take_them(tmp_path):
    motion = four_bar()
    names = ["mass", "com.position", "coupler.angle", "coupler.velocity.x"]
    assert len(sp.plot(motion, names).axes) == 4
    assert list(motion.columns(names))[2:] == [
        "mass [kg]", "com position x [m]", "com position y [m]", "com position z [m]",
        "coupler angle [rad]", "coupler velocity x [m/s]"]
    report = sp.report(motion, tmp_path / "a.html", outputs=names)
    assert "coupler angle" in report.read_text(encoding="utf-8")
    sp.export_html(motion, tmp_path / "b.html", look=sp.Look(curves=("coupler.angle",)))


def test_simulations_have_them():
    mechanism = library("four_bar")
    run = sp.simulate(mechanism, sp.assemble(mechanism, {"crank": 1.0}), 0.2)
    energy, mass, height = (run.output(x).values for x in ("energy", "mass", "com.position.z"))
    data = mechanism.model.createData()
    for k in (0, 100, -1):
        kinetic = pin.computeKineticEnergy(mechanism.model, data, np.array(run.q[k]),
                                           np.array(run.v[k]))
        assert energy[k] == pytest.approx(kinetic + 9.81 * mass[k] * height[k], abs=1e-9)


def test_a_smaller_model_tells_angles_and_components_but_no_sums():
    mechanism = library("excavator")
    reduced = sp.reduce(mechanism, ["boom.angle.y", "boom.velocity.z"])
    assert reduced.verify().worst < 1e-9
    with pytest.raises(sp.SpatialPinError, match="every link that has mass"):
        sp.reduce(mechanism, "com.position.z")
    with pytest.raises(sp.SpatialPinError, match="every link that has mass"):
        sp.reduce(mechanism, "mass")


# ---------------------------------------------------------------- the same names as targets


@pytest.mark.parametrize("asked", [
    {"teeth.position.z": -1.0}, {"teeth.position.z": -1.0, "teeth.position.x": 6.0},
    {"bucket.angle.y": 2.0, "teeth.position.z": -1.0}, {"com.position.z": 1.9},
    {"bucket.com.position.z": 0.5}, {"com.position.x": 0.2, "bucket.angle.y": 1.7},
])
def test_an_output_is_where_it_should_be(asked):
    mechanism, start = excavator()
    state = sp.reach(mechanism, asked, start, hold="swing")
    for name, value in asked.items():
        assert at(state, name) == pytest.approx(value, abs=1e-11)
    assert state.closure_error < 1e-14 and not state.beyond_limits


def test_of_all_places_at_a_height_the_nearest_is_found():
    mechanism, start = excavator()
    state = sp.reach(mechanism, {"teeth.position.z": -0.5}, start, hold="swing")

    def moved(other: sp.State) -> float:
        way = pin.difference(mechanism.model, start.q, other.q) / mechanism.velocity_scale
        return float(way @ way)

    x = state.placement("teeth").translation[0]
    for dx in (-0.02, 0.02):
        beside = sp.reach(mechanism, {"teeth.position.z": -0.5, "teeth.position.x": x + dx}, start,
                          hold="swing")
        assert moved(beside) > moved(state)


def test_weights_hold_for_outputs_too():
    mechanism, start = excavator()
    wish = sp.targets.coordinate(2.0, weight=1.0)
    state = sp.reach(mechanism, {"teeth.position": [6.0, 0.0, -1.0], "bucket.angle.y": wish},
                     start, hold="swing")
    assert state.placement("teeth").translation == pytest.approx([6.0, 0.0, -1.0], abs=1e-11)
    assert at(state, "bucket.angle.y") == pytest.approx(2.0, abs=1e-9)
    both = sp.reach(mechanism, {"teeth.position.z": sp.targets.coordinate(-20.0, weight=1.0),
                                "boom": 2.7}, start, hold="swing")
    assert both.coordinate("boom").value == pytest.approx(2.7, abs=1e-11)


def test_out_of_reach_an_output_is_reported_by_its_name():
    mechanism, start = excavator()
    with pytest.raises(sp.ReachError, match=r"'teeth\.position\.z' stays off") as caught:
        sp.reach(mechanism, {"teeth.position.z": -30.0}, start, hold="swing")
    assert set(caught.value.distances) == {"teeth.position.z"}


@pytest.mark.parametrize(("asked", "error", "words"), [
    ({"teeth.positon.z": 1.0}, sp.UnknownNameError, r"did you mean 'teeth\.position\.z'"),
    ({"tooth.position.z": 1.0}, sp.UnknownNameError, "did you mean 'teeth'"),
    ({"bucket.angle": 1.0}, sp.SpatialPinError, r"bucket\.angle\.z"),
    ({"teeth.velocity.z": 1.0}, sp.SpatialPinError, "says where something is"),
    ({"boom.effort": 1.0}, sp.SpatialPinError, "says where something is"),
    ({"mass": 1.0}, sp.SpatialPinError, "says where something is"),
    ({"teeth.position.z": [1.0, 2.0, 3.0]}, ValueError, r"shape \(3,\)"),
    ({"teeth.position": 1.0}, ValueError, r"shape \(\)"),
    ({"bucket.angle.y": np.nan}, ValueError, "finite"),
    ({"teeth": [6.0, 0.0, -1.0], "teeth.position.z": -2.0}, ValueError,
     "contradict .* z of the origin of 'teeth'"),
    ({"a": sp.targets.centre_of_mass(None, None, 1.0), "com.position.z": 2.0}, ValueError,
     "contradict .* z of the centre of mass"),
])
def test_names_that_are_no_targets_are_refused_in_words(asked, error, words):
    mechanism, start = excavator()
    with pytest.raises(error, match=words):
        sp.reach(mechanism, asked, start)
    if len(asked) == 1 and error is not ValueError:
        with pytest.raises(error, match=words):
            sp.reach_path(mechanism, {name: [1.0, 2.0] for name in asked}, state=start)


def test_a_path_of_components_and_an_angle_is_that_of_points():
    mechanism, start = excavator()
    x, _, z = start.placement("teeth").translation
    xs, zs = x - TIMES, z + 0.3 * np.sin(TIMES)
    angle = {"bucket.angle.y": at(start, "bucket.angle.y") + 0.3 * TIMES}
    parts = sp.reach_path(mechanism, {"teeth.position.x": xs, "teeth.position.z": zs, **angle},
                          TIMES, start, hold="swing")
    points = np.column_stack([xs, 0.0 * TIMES, zs])
    for name in ("teeth", "teeth.position"):
        whole = sp.reach_path(mechanism, {name: points, **angle}, TIMES, start, hold="swing")
        assert np.abs(whole.q - parts.q).max() < 1e-11
    assert parts.output("bucket.angular_velocity.y").values == pytest.approx(0.3, abs=1e-11)
    assert parts.closure_error.max() < 1e-13
    for name, values in (("teeth.position.x", xs), ("teeth.position.z", zs)):
        assert parts.output(name).values == pytest.approx(values, abs=1e-12)


@pytest.mark.parametrize("asked", [
    {"com.position.x": 0.1}, {"teeth.position.z": -0.2}, {"bucket.com.position.z": 0.2},
    {"teeth.position.z": -0.2, "com.position.x": 0.1}, {"com.position": np.array([0.05, 0, -0.1])},
])
def test_paths_that_leave_freedom_meet_their_samples(asked):
    mechanism, start = excavator()
    tables = {name: at(start, name) + (TIMES[:, None] * by if np.ndim(by) else by * TIMES)
              for name, by in asked.items()}
    motion = sp.reach_path(mechanism, tables, TIMES, start, hold="swing")
    assert len(motion) == len(TIMES)
    for name, values in tables.items():
        assert motion.output(name).values == pytest.approx(values, abs=1e-10)
    assert np.ptp(motion.coordinate("swing").value) < 1e-12


def test_a_crank_whose_angle_is_requested_turns_round():
    mechanism = library("four_bar")
    start = sp.assemble(mechanism, {"crank": 0.3})
    motion = sp.reach_path(mechanism, {"crank.angle": 0.3 + 7.0 * TIMES}, TIMES, start)
    assert motion.output("crank.angle").values == pytest.approx(0.3 + 7.0 * TIMES, abs=1e-12)
    state = sp.reach(mechanism, {"crank.angle": 0.3 + 2.0 * np.pi}, start)  # the same direction
    assert state.coordinate("crank").value == pytest.approx(0.3, abs=1e-12)


# ---------------------------------------------------------------- command line


def test_the_command_line_takes_them(tmp_path, run):
    code, _, _ = run("reach", "excavator", "teeth.position.z=-1000mm", "bucket.angle.y=115deg",
                     "--hold", "swing", "--json", "-")
    assert code == 0
    table = tmp_path / "p.csv"
    table.write_text("time [s],teeth.position.x [mm],teeth.position.z,bucket.angle.y [deg]\n"
                     "0,6000,-1,115\n1,6100,-1,112\n2,6200,-1.1,110\n3,6300,-1.2,110\n")
    code, said, _ = run("reach", "excavator", "--path", table, "--hold", "swing", "--csv", "-")
    assert code == 0 and len(said.splitlines()) == 5
    assert run("reach", "excavator", "com.position=0.4,0,1.8@1", "--hold", "swing")[0] == 0


@pytest.mark.parametrize(("word", "says"), [
    ("teeth.position.z=-1deg", "is in m, not in deg"), ("bucket.angle=1", "say about which"),
    pytest.param("bucket.angle.y=2m", "is in rad, not in m", marks=pytest.mark.slow),
    pytest.param("teth.position.z=1", "did you mean 'teeth'", marks=pytest.mark.slow),
])
def test_the_command_line_refuses_in_words(run, word, says):
    code, _, told = run("reach", "excavator", word)
    assert code == 1 and says in " ".join(told.split())
