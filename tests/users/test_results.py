"""Results as data: tables with units, forces by their names, and figures of them."""

import copy
import csv
import dataclasses
import io
import pickle
import sys

import numpy as np
import pytest

import spatial_pin as sp

XYZ = "xyz"


@pytest.fixture(scope="module")
def motion() -> sp.Motion:
    return sp.sweep(sp.load("rssr"), "crank", np.linspace(0.0, 6.0, 61), speed=5.0)


@pytest.fixture(scope="module")
def loads(motion) -> sp.Kinetostatics:
    return sp.kinetostatics(motion.mechanism, motion)


@pytest.fixture(scope="module")
def driven() -> sp.Simulation:
    """A four-bar whose crank turns at a constant speed."""
    mechanism = sp.load("four_bar")
    start = sp.solve_rates(mechanism, sp.assemble(mechanism, {"crank": 0.3}), {"crank": 2.0})
    return sp.simulate(mechanism, start, 0.2, drives={"crank": sp.laws.constant_speed(0.3, 2.0)})


def read(text: str) -> dict[str, np.ndarray]:
    rows = list(csv.reader(io.StringIO(text)))
    return dict(zip(rows[0], np.array(rows[1:], float).T, strict=True))


# ---------------------------------------------------------------- forces by their names


def test_forces_are_outputs_of_loads(loads):
    assert loads.output("crank.effort").values is loads.efforts["crank"]
    assert loads.output("crank")[1:] == ("crank effort", "N·m")
    assert loads.output("crank_pin.effort").label == "crank effort"
    assert loads.output("crank.power").unit == "W"
    reaction = loads.output("ball_b.reaction")
    np.testing.assert_array_equal(reaction.values, loads.reactions["ball_b"])
    force, moment = reaction.parts()
    assert (force.label, force.unit) == ("ball_b reaction force", "N")
    np.testing.assert_array_equal(moment.values, loads.reactions["ball_b"][:, 3:])
    np.testing.assert_array_equal(loads.output("ball_b.reaction.force").values, force.values)
    np.testing.assert_array_equal(loads.output("on_ground.moment").values, loads.on_ground[:, 3:])


def test_outputs_of_the_motion_are_outputs_of_its_loads(motion, loads):
    for name in ("rocker_pin", "rocker_pin.rate", "coupler.velocity", "coupler.com.position"):
        np.testing.assert_array_equal(loads.output(name).values, motion.output(name).values)
    with pytest.raises(sp.UnknownNameError, match="did you mean 'rocker_pin'"):
        loads.output("rocker_pn")
    with pytest.raises(sp.UnknownNameError, match=r"no force .*did you mean .crank\.effort"):
        loads.output("crnk.effort")


@pytest.mark.parametrize("name", ["crank.effort", "crank.power", "ball_b.reaction", "on_ground",
                                  "ball_b.reaction.moment"])
def test_a_motion_says_that_forces_need_loads(motion, name, tmp_path):
    with pytest.raises(sp.SpatialPinError, match=r"sp\.kinetostatics\(mechanism, motion\)"):
        motion.output(name)
    with pytest.raises(sp.SpatialPinError, match="kinetostatics"):
        motion.to_csv(tmp_path / "a.csv", [name])
    assert not list(tmp_path.iterdir())


def test_a_driver_in_several_freedoms_has_its_own_effort():
    mechanism = sp.load("excavator")
    motion = sp.sweep(mechanism, "boom", np.linspace(*_span(mechanism, "boom"), 5), speed=0.1)
    loads = sp.kinetostatics(mechanism, motion)
    assert loads.output("boom").unit == "N"
    np.testing.assert_array_equal(loads.output("arm.effort").values, loads.efforts["arm"])


def _span(mechanism: sp.Mechanism, driver: str) -> tuple[float, float]:
    start = sp.assemble(mechanism).coordinate(driver).value
    return start, start + 0.05


def test_energies_and_efforts_are_outputs_of_a_simulation(driven):
    assert driven.output("energy")[1:] == ("energy", "J")
    assert driven.output("crank.effort").values is driven.efforts["crank"]
    assert {"energy [J]", "work [J]", "crank effort [N·m]"} <= set(driven.columns())
    with pytest.raises(sp.SpatialPinError, match="kinetostatics"):
        driven.output("crank_pin.reaction")


# ---------------------------------------------------------------- tables


def test_columns_of_outputs_have_names_components_and_units(motion):
    names = ["rocker_pin", "rocker_pin.ratio", "coupler.velocity"]
    table = motion.columns(names)
    assert list(table) == [
        "time [s]", "crank [rad]", "rocker_pin [rad]", "rocker_pin / crank speed ratio [-]",
        *(f"coupler velocity {x} [m/s]" for x in XYZ)]
    np.testing.assert_array_equal(table["coupler velocity z [m/s]"],
                                  motion.frame("coupler").velocity[:, 2])


def test_loads_as_a_table_have_every_force(loads):
    table = loads.columns()
    np.testing.assert_array_equal(table["crank effort [N·m]"], loads.efforts["crank"])
    np.testing.assert_array_equal(table["ball_a reaction force y [N]"],
                                  loads.reactions["ball_a"][:, 1])
    np.testing.assert_array_equal(table["on ground moment x [N·m]"], loads.on_ground[:, 3])
    assert list(table)[:2] == ["time [s]", "crank [rad]"]
    assert len(table) == 2 + 2 + 6 * (len(loads.reactions) + 1)


@pytest.mark.parametrize("made", ["motion", "loads", "driven"])
def test_csv_is_a_text_a_file_or_an_open_file(made, request, tmp_path):
    found = request.getfixturevalue(made)
    text, opened = found.to_csv(), io.StringIO()
    assert found.to_csv(opened) is None
    path = found.to_csv(tmp_path / "a.csv")
    assert text == opened.getvalue() == path.read_text(encoding="utf-8")
    for head, values in found.columns().items():
        np.testing.assert_array_equal(read(text)[head], values)


def test_the_command_line_writes_the_same_table(motion, run, tmp_path):
    path = tmp_path / "a.csv"
    words = ["sweep", "rssr", "crank", "0", "6", "--steps", "61", "--speed", "5"]
    assert run(*words, "--csv", path)[0] == 0
    assert path.read_bytes() == motion.to_csv(tmp_path / "b.csv").read_bytes()


def test_npz_is_read_by_numpy_without_pickles(loads, motion, tmp_path):
    path = loads.to_npz(tmp_path / "loads", ["crank.effort", "rocker_pin.rate"])
    assert path.name == "loads.npz"
    with np.load(path) as file:
        assert file.files == ["time [s]", "crank [rad]", "crank effort [N·m]",
                              "rocker_pin rate [rad/s]"]
        np.testing.assert_array_equal(file["crank effort [N·m]"], loads.efforts["crank"])
    np.testing.assert_array_equal(np.load(motion.save(tmp_path / "m"))["q"], motion.q)


def test_data_frames_have_units(loads, motion):
    pytest.importorskip("pandas")
    frame = loads.to_dataframe()
    np.testing.assert_array_equal(frame["crank effort [N·m]"], loads.efforts["crank"])
    assert len(frame) == len(motion) and frame.attrs["units"]["crank [rad]"] == "rad"
    assert set(frame.attrs["units"]) == set(frame.columns)
    assert list(motion.to_dataframe("rocker_pin")) == ["time [s]", "crank [rad]",
                                                       "rocker_pin [rad]"]
    frame.loc[0, "crank [rad]"] = 7.0
    assert motion.driver[0] == 0.0


def test_data_sets_keep_vectors_together(loads):
    pytest.importorskip("xarray")
    found = loads.to_xarray(["ball_a.reaction", "coupler.position"])
    assert found["ball_a reaction force"].dims == ("sample", "component")
    assert found["coupler position"].attrs["units"] == "m"
    np.testing.assert_array_equal(found["coupler position"].sel(component="z"),
                                  loads.output("coupler.position").values[:, 2])


@pytest.mark.parametrize("library", ["pandas", "xarray"])
def test_a_library_that_is_missing_gets_a_clear_error(motion, monkeypatch, library):
    monkeypatch.setitem(sys.modules, library, None)
    convert = motion.to_dataframe if library == "pandas" else motion.to_xarray
    with pytest.raises(sp.SpatialPinError, match=f"needs {library}: pip install .*to_csv"):
        convert()


def test_a_motion_without_time_has_rates_by_its_driver():
    motion = sp.sweep(sp.load("four_bar"), "crank", [0.1, 0.2])
    assert "rocker_pin rate [rad/rad]" in motion.to_csv().splitlines()[0]
    assert "time" not in motion.to_csv()


def test_samples_of_tolerances_are_a_table():
    mechanism = sp.load("rssr")
    found = sp.tolerance(mechanism, ["rocker_pin", "coupler.position"], {"a": 1e-3, "b": 1e-3},
                         samples=30)
    table = found.columns()
    np.testing.assert_array_equal(table["a"], found.dimensions["a"])
    np.testing.assert_array_equal(table["rocker_pin [rad]"][found.is_closed],
                                  found.samples["rocker_pin"])
    assert "coupler position x [m]" in table and len(table["is closed"]) == 30
    assert found.to_csv(outputs="a").splitlines()[0] == "a"
    with pytest.raises(sp.UnknownNameError, match="no column 'c'"):
        found.columns(["c"])
    with pytest.raises(sp.SpatialPinError, match="samples=1000"):
        sp.tolerance(mechanism, ["rocker_pin"], {"a": 1e-3}).to_csv()


@pytest.mark.slow
def test_samples_that_cannot_be_closed_are_nan():
    found = sp.tolerance(sp.load("rssr"), ["rocker_pin"], {"d": 0.3}, samples=40, seed=1)
    assert found.failed
    np.testing.assert_array_equal(np.isnan(found.columns()["rocker_pin [rad]"]),
                                  found.columns()["is closed"] == 0)


def test_a_workspace_is_a_table(tmp_path):
    arms = {name: (0.0, 0.3) for name in ("arm_1", "arm_2", "arm_3")}
    found = sp.workspace(sp.load("delta"), "platform", arms, points=2)
    names = ["platform.z", "dexterity", "why"]
    assert list(found.columns(names)) == ["platform.z [m]", "dexterity [-]", "why"]
    assert len(found.to_csv(outputs=names).splitlines()) == 9
    with np.load(found.to_npz(tmp_path / "w.npz")) as file:
        assert file["why"].tolist() == list(found.why)


# ---------------------------------------------------------------- words and arrays


def test_arrays_of_results_are_read_only(motion, loads, driven):
    kept = [motion.q, motion.v, motion.a, motion.driver, motion.time, motion.closure_error,
            driven.energy, driven.work, driven.efforts["crank"], loads.a, loads.on_ground,
            *loads.efforts.values(), *loads.power.values(), *loads.reactions.values()]
    for again in (copy.copy(driven), pickle.loads(pickle.dumps(driven))):
        kept += [again.q, again.energy, *again.efforts.values()]
    for array in kept:
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0.0


def same(one: sp.Motion, other: sp.Motion) -> bool:
    """Whether two motions have the same in every field, to the bit."""
    assert type(one) is type(other)
    for field in dataclasses.fields(one):
        x, y = getattr(one, field.name), getattr(other, field.name)
        if isinstance(x, dict):
            assert list(x) == list(y)
            x, y = list(x.values()), list(y.values())
        np.testing.assert_equal(x, y, err_msg=field.name)
    return True


@pytest.mark.parametrize("case", ["driven", "limits", "projected"])
def test_a_simulation_comes_back_from_its_file_whole(case, driven, tmp_path):
    run = driven
    if case == "limits":
        mech = sp.load("excavator")
        run = sp.simulate(mech, sp.assemble(mech, {"boom": 2.05}), 0.4)
        assert run.joint_limits
    elif case == "projected":
        mech = sp.load("four_bar")
        run = sp.simulate(mech, sp.assemble(mech, {"crank": 1.0}), 0.1,
                          accuracy=sp.Accuracy(formulation="projected"))
    file = run.save(tmp_path / "run")
    again = sp.Simulation.load(file, run.mechanism)
    assert same(again, run) and str(again) == str(run)
    if case == "driven":
        joint = run.mechanism.drivers["crank"].joint
        np.testing.assert_array_equal(again.efforts[joint], run.efforts["crank"])
    assert type(sp.Motion.load(file, run.mechanism)) is sp.Motion


def test_a_motion_comes_back_from_its_file_whole_and_is_no_simulation(motion, tmp_path):
    mech = motion.mechanism
    for each in (motion, sp.sweep(mech, "crank", [0.0, 0.1], hold=None)):
        file = each.save(tmp_path / "motion")
        assert same(sp.Motion.load(file, mech), each)
        with pytest.raises(sp.SpatialPinError, match="not a simulation"):
            sp.Simulation.load(file, mech)


def test_arrays_of_results_are_float64_in_c_order(motion, loads):
    arrays = [motion.q, motion.v, motion.a, *motion.frame("coupler"), *motion.com("coupler"),
              *motion.coordinate("rocker_pin"), *loads.efforts.values(), *loads.reactions.values()]
    for array in arrays:
        assert array.dtype == np.float64 and array.flags.c_contiguous and len(array) == len(motion)


def test_arrays_of_the_user_are_unchanged():
    values = np.linspace(0.0, 1.0, 5)
    motion = sp.sweep(sp.load("four_bar"), "crank", values)
    values[0] = 9.0
    assert motion.driver[0] == 0.0


def every_result(motion: sp.Motion, loads: sp.Kinetostatics, driven: sp.Simulation):
    """Yield results of all kinds that hold arrays."""
    mechanism, state = motion.mechanism, motion.state(7)
    yield from (mechanism, state, motion, loads, driven, sp.mobility(mechanism))
    yield from (motion.frame("coupler"), motion.output("coupler.velocity"),
                motion.coordinate("rocker_pin"), state.com("coupler"),
                state.relative_motion("coupler_b", "rocker"))
    yield from (sp.solve_jerks(mechanism, state, {"crank": 0.0}),
                sp.influence(mechanism, state), sp.transmission(mechanism, state, "rocker_pin"))
    yield from (sp.forward_dynamics(mechanism, state), sp.inverse_dynamics(mechanism, state))
    changes = sp.dynamics_derivatives(mechanism, state)
    yield from (changes, changes.on_ground)
    yield from (sp.sensitivity(mechanism, motion, "rocker_pin", ["a"]),
                sp.tolerance(mechanism, ["rocker_pin", "coupler.position"], {"a": 1e-3},
                             samples=20))
    rest = sp.equilibrium(mechanism)
    yield from (rest, sp.equilibria(mechanism, starts=4), sp.linearize(mechanism, rest.state))
    yield sp.tradeoff(mechanism, budget=0.3)
    apart = sp.clearance(sp.sweep(sp.load("four_bar"), "crank", np.linspace(0.3, 1.0, 9)))
    yield from (apart, apart.pairs[0])
    arms = {name: (0.0, 0.3) for name in ("arm_1", "arm_2", "arm_3")}
    found = sp.workspace(sp.load("delta"), "platform", arms, points=2)
    yield from (found, found.boundary)


def test_poses_at_rest_and_vibrations_are_tables():
    pandas = pytest.importorskip("pandas")
    mechanism = sp.load("four_bar")
    poses = sp.equilibria(mechanism, starts=20)
    frame = poses.to_dataframe()
    assert isinstance(frame, pandas.DataFrame) and len(frame) == len(poses) == 4
    assert list(frame)[-3:] == ["energy [J]", "kind", "reached"]
    assert frame["crank_pin [rad]"][1] == poses[1].state.coordinate("crank").value
    assert frame.attrs["units"]["energy [J]"] == "J" and sum(frame["reached"]) == poses.reached
    assert poses.to_csv(outputs="kind").split() == ["kind", *frame["kind"]]
    with pytest.raises(sp.UnknownNameError, match="no column 'enrgy'"):
        poses.columns("enrgy")
    small = sp.linearize(mechanism, poses[0].state)
    np.testing.assert_array_equal(small.to_dataframe()["frequency [Hz]"], small.frequencies)
    assert sp.Equilibria().columns()["kind"].shape == (0,)
    assert repr(poses).startswith("Equilibria(2 stable, 2 unstable of 20 starts")


@pytest.mark.slow
def test_words_of_results_are_short_and_have_no_arrays(motion, loads, driven):
    for found in every_result(motion, loads, driven):
        text = repr(found)
        assert len(text) < 420 and "array([" not in text and "\n" not in text, text
        assert text.startswith(type(found).__name__), text


def test_words_of_results_have_units(motion, loads):
    assert repr(motion).startswith("Motion('rssr': 61 samples over crank [rad], closure error")
    assert "crank = 0.7 rad" in repr(motion.state(7))
    assert repr(motion.output("coupler.velocity")) == (
        "Output('coupler velocity': array (61, 3) m/s)")
    assert "efforts crank [N·m], reactions [N, N·m] of crank_pin, ball_a" in repr(loads)
    angle = sp.transmission(motion.mechanism, motion.state(7), "rocker_pin").angle
    assert f"angle={angle:.6g} rad, at='ball_b'" in repr(
        sp.transmission(motion.mechanism, motion.state(7), "rocker_pin"))
    assert "] m, velocity=[" in repr(motion.state(7).com("coupler"))


# ---------------------------------------------------------------- figures


def test_loads_are_drawn_with_force_and_moment_apart(loads):
    figure = sp.plot(loads, ["crank", "ball_b.reaction"])
    assert [a.get_title("left") for a in figure.axes] == [
        "crank effort [N·m]", "ball_b reaction force [N]", "ball_b reaction moment [N·m]"]
    np.testing.assert_array_equal(figure.axes[0].lines[0].get_ydata(), loads.efforts["crank"])
    assert not np.any(figure.axes[2].lines[0].get_ydata())  # a ball's, round-off of the force


def test_a_motion_is_not_drawn_with_forces(motion):
    with pytest.raises(sp.SpatialPinError, match=r"loads = sp\.kinetostatics"):
        sp.plot(motion, ["rocker_pin", "crank.effort"])


@pytest.mark.slow
def test_forces_are_drawn_by_reports_and_the_command_line(motion, driven, run, tmp_path):
    names = ["rocker_pin", "crank.effort", "ball_b.reaction"]
    page = sp.report(motion, tmp_path / "page.html", outputs=names).read_text("utf-8")
    assert "Outputs of rssr: rocker_pin, crank effort, ball_b reaction force, ball_b" in page
    sp.report(driven, tmp_path / "page.html", outputs="crank.effort")
    with pytest.raises(sp.UnknownNameError, match=r"did you mean 'crank\.effort'"):
        sp.report(motion, tmp_path / "page.html", outputs="crnk.effort")
    words = ["sweep", "rssr", "crank", "0", "1", "--plot", tmp_path / "a.svg"]
    code, out, _ = run(*words, *(w for name in names for w in ("--output", name)))
    assert code == 0 and "a.svg" in out
    code, _, err = run(*words, "--output", "crnk.effort")
    assert code != 0 and "did you mean 'crank.effort'" in err


@pytest.mark.parametrize(("count", "asked", "columns"), [
    (1, None, 1), (4, None, 1), (5, None, 2), (10, None, 2), (11, None, 3), (4, 2, 2), (2, 5, 2),
    (7, 1, 1)])
def test_panels_stand_in_columns(motion, count, asked, columns):
    figure = sp.plot(motion, ["rocker_pin"] * count, columns=asked)
    grid = figure.axes[0].get_subplotspec().get_gridspec()
    assert (len(figure.axes), grid.ncols) == (count, columns)
    labelled = [k for k, axes in enumerate(figure.axes) if axes.get_xlabel()]
    assert labelled == list(range(count - columns, count))
    assert len({axes.get_xlim() for axes in figure.axes}) == 1


def test_columns_are_counted_from_one(motion):
    with pytest.raises(ValueError, match="columns is 0"):
        sp.plot(motion, "rocker_pin", columns=0)
