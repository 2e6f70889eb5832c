"""The benchmark script: one small task from end to end, and the references it judges by."""

import importlib
import importlib.util
import json
import sys
from pathlib import Path

import closed_forms
import numpy as np
import pytest
from folders import ROOT
from published_cases import CASES
from variety import few, first

import spatial_pin as sp

SCRIPTS = ROOT / "scripts"


@pytest.fixture(scope="module")
def bench():
    """The script as a module."""
    before = list(sys.path)
    spec = importlib.util.spec_from_file_location("bench", SCRIPTS / "bench.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    yield module
    sys.path[:] = before


def report_of(bench, capsys, *arguments):
    bench.main(arguments)
    return capsys.readouterr().out


def test_a_task_is_measured_judged_saved_and_compared(bench, capsys, tmp_path):
    saved = tmp_path / "old.json"
    out = report_of(bench, capsys, "--tasks", "jacobian,mobility", "--quick", "--json", str(saved))
    assert "spatial_pin: jacobian" in out and "Pinocchio has no analysis" in out
    old = json.loads(saved.read_text())
    assert {"spatial_pin", "pin", "numpy"} <= old["versions"].keys()
    assert {"cpu", "cores", "python"} <= old["machine"].keys()
    rows = {row["task"]: row for row in old["rows"].values() if row["tool"] == "spatial_pin"}
    assert len(rows["jacobian"]["seconds"]) > 1
    assert rows["jacobian"]["least"] == min(rows["jacobian"]["seconds"]) > 0.0
    assert 0.0 <= rows["jacobian"]["errors"]["ω"] < 1e-13
    assert rows["mobility"]["errors"]["count"] == 0.0
    for row in old["rows"].values():  # as if the machine had been a thousand times faster
        row["seconds"] = [t / 1000.0 for t in row["seconds"]]
        row["least"], row["median"] = min(row["seconds"]), row["median"] / 1000.0
    saved.write_text(json.dumps(old))
    out = report_of(bench, capsys, "--tasks", "jacobian", "--quick", "--compare", str(saved))
    changed = [line for line in out.splitlines() if "SLOWER" in line]
    assert len(changed) == 2 and all("jacobian" in line for line in changed)
    assert any("mobility" in line and "gone" in line for line in out.splitlines())


def test_tables_of_a_page_are_written_below_their_marks(bench, capsys, tmp_path):
    saved, page = tmp_path / "run.json", tmp_path / "page.md"
    report_of(bench, capsys, "--tasks", "jacobian", "--quick", "--json", str(saved))
    names = bench.pages.TABLES
    page.write_text("before\n" + "".join(f"<!-- table: {x} -->\n| old |\n\n{x}\n" for x in names))
    report_of(bench, capsys, "--read", str(saved), "--page", str(page))
    text = page.read_text()
    assert "old" not in text and text.startswith("before\n") and text.endswith("excavator\n")
    line = next(x for x in text.splitlines() if x.startswith("| `jacobian` | "))
    assert line.count("µs") == 2 and "Pinocchio by hand" in line
    with pytest.raises(ValueError, match="has no"):
        bench.pages.put(page, "nothing", [])


def test_every_line_of_a_page_has_its_rows(bench):
    """Those of this environment: the rows of other tools are in theirs."""
    worker = bench.workers.Worker(bench.tools.OWN.modules)
    there = set(worker.rows()["cases"])
    assert {ours for _, ours, _, _ in bench.pages.SINGLE} <= there
    for line in bench.pages.SWEEPS[:5]:
        assert bench.report.key("sweep", 360, line.hows[0], line.tool) in there
    for task, (_, lines) in bench.pages.SIMULATIONS.items():
        for line in lines[:2]:
            assert {bench.report.key(task, 0, how, line.tool) for how in line.hows} <= there
    for kind, (line, *_) in bench.pages.REACHES.items():
        assert {bench.report.key(f"{kind}-{robot}", 0, line.hows[0], line.tool)
                for robot in bench.pages.ROBOTS} <= there
    assert {x for names in bench.pages.PAGES.values() for x in names} == set(bench.pages.TABLES)
    assert set(bench.pages.NEEDS) == set(bench.pages.TABLES)
    assert {x for names in bench.pages.NEEDS.values() for x in names} <= set(bench.TASKS)
    for page, names in bench.pages.PAGES.items():
        text = (SCRIPTS.parent / "docs" / page).read_text(encoding="utf-8")
        assert all(f"<!-- table: {name} -->" in text for name in names)


def test_only_what_lies_beyond_the_spread_is_marked(bench):
    calm = [1.0, 1.02, 1.04, 1.06]
    assert bench.report.moved(calm, [1.03, 1.05, 1.07, 1.09]) == ""
    assert bench.report.moved(calm, [1.2, 1.22, 1.24, 1.26]).strip() == "SLOWER"
    assert bench.report.moved([1.2, 1.22, 1.24, 1.26], calm).strip() == "faster"
    assert bench.report.moved([1.0, 1.5, 2.0, 2.5], [1.0, 1.9, 2.2, 3.0]) == ""
    assert "ψ 1e-12 -> 5e-10" in bench.report.worse({"ψ": 1e-12}, {"ψ": 5e-10})
    assert bench.report.worse({"ψ": 1e-16, "ω": None}, {"ψ": 5e-15, "ω": 1.0}) == ""


@pytest.mark.parametrize(("arguments", "words"), [
    (["--tasks", "sweeps"], "no such task: sweeps"),
    (["--repeats", "0"], "must be positive"),
])
def test_a_wrong_command_line_is_reported(bench, capsys, arguments, words):
    with pytest.raises(SystemExit):
        bench.main(arguments)
    assert words in capsys.readouterr().err


@pytest.mark.parametrize("text", ["[]", "{}", "no JSON", None])
def test_an_old_file_that_is_none_is_reported(bench, tmp_path, text):
    path = tmp_path / "old.json"
    if text is not None:
        path.write_text(text)
    with pytest.raises(SystemExit, match=r"old\.json"):
        bench.main(["--tasks", "jacobian", "--quick", "--compare", str(path)])


def test_a_case_that_fails_is_reported_and_the_others_go_on(bench):
    class Worker(bench.workers.Worker):
        def __init__(self):
            super().__init__(())
            case = importlib.import_module("benchmark.case").Case

            def broken(_):
                raise RuntimeError("out of reach\nand more")

            for how, run in (("good", lambda x: x + 1), ("bad", broken)):
                one = case("jacobian", "someone", how, lambda: 1, run, lambda _, x: {"ω": x - 2})
                self.cases[one.key] = one

    cases, absent = bench.measure.rows_of([Worker()])
    rows, failed = bench.measure.measure(cases, bench.measure.QUICK, lambda _: None)
    assert absent == [] and [row["how"] for row in rows.values()] == ["good"]
    assert failed == [["jacobian", "someone", "bad: RuntimeError: out of reach"]]


@pytest.mark.slow
def test_a_worker_in_another_process_answers_and_dies_in_words(bench):
    remote = bench.workers.Remote(Path(sys.executable), ["with_scipy"])
    try:
        key = "reduced / 360 / by hand / the distance equation, tuned"
        assert remote.rows()["cases"][key]["count"] == 360
        with pytest.raises(bench.workers.Failed, match="KeyError"):
            remote.run(key)
        remote.setup(key)
        assert remote.run(key, 2) > 0.0
        assert remote.judge(key)["ψ"] < 1e-11
        remote._process.kill()
        remote._process.wait()
        with pytest.raises(bench.workers.Failed, match="its process ended"):
            remote.run(key)
        assert bench.measure.run(remote, key, 1, "cpu") > 0.0  # in a new process
    finally:
        remote.close()


@pytest.mark.parametrize("n", [1, 2, 5, 10, 20, 40])
def test_the_ladder_ends_where_the_published_case_does(bench, n):
    ladder = importlib.import_module("benchmark.ladder")
    angles = CASES[f"ladder_{n}"].answers["angles"].values
    assert ladder.angle(n, 10.0) == pytest.approx(angles[0], abs=1e-13)


def test_the_cube_ends_where_the_published_case_does(bench):
    cube = importlib.import_module("benchmark.cube")
    assert tuple(cube.P3) == CASES["bricard"].answers["position"].values


def test_the_closed_form_of_the_rssr_is_that_of_forty_digits(bench):
    problem = importlib.import_module("benchmark.rssr").Problem()
    exact = problem.exact()
    for k in range(0, problem.steps, 90):
        true = closed_forms.rates(closed_forms.rssr, problem.phi[k], problem.speed, 0.0)
        for order, found in enumerate((exact.angle, exact.rate, exact.acceleration)):
            off = float(true[order].coordinates["rocker_pin"] - found[k])
            assert abs(off) < 1e-15 * problem.speed**order


def test_the_bars_are_reported_beside_what_was_measured(bench, capsys, tmp_path):
    out = report_of(bench, capsys, "--bars", "--quick", "--tasks", "jacobian,four_bar",
                    "--environments", str(tmp_path))
    title, *lines = out.splitlines()
    assert title.split() == ["task", "now", "bar", "now/bar", "beside"]
    assert [line.partition("  ")[0] for line in lines[:2]] == [
        "sweep four-bar, 360 values with rates", "jacobian RSSR"]
    assert "no other was measured" in lines[0] and " 12 µs " in lines[1]
    assert "pylinkage" in lines[2] and "not installed" in lines[2] and len(lines) == 3


def test_every_bar_has_its_rows(bench):
    own = bench.workers.Worker(bench.tools.OWN.modules).rows()["cases"]
    for bar in bench.bars.BARS:
        assert bar.row in own
        if isinstance(bar.others, str):
            assert bar.others in bench.TASKS[own[bar.row]["task"]].errors


def test_a_bar_is_held_beside_the_fastest_that_is_as_exact(bench):
    def row(tool, median, error):
        return {"task": "a02", "tool": tool, "how": f"in {median} s", "median": median, "count": 1,
                "errors": {"angle": error}}

    bar = bench.bars.Bar("A02", "a02 / 0 / spatial_pin / simulate, for_error(1e-4)", 1.0, "angle")
    rows = {bar.row: row("spatial_pin", 2.0, 1e-6), "a": row("MuJoCo", 4.0, 1e-9),
            "b": row("MuJoCo", 1.0, 1e-3), "c": row("by hand", 0.1, 1e-9)}
    assert "2*  0.5 (bar 1) to MuJoCo: in 4.0 s" in bench.bars._line(bar, rows)
    rows["d"] = row("MuJoCo", 1.6, 5e-5)
    assert "1.2* (bar 1) to MuJoCo: in 1.6 s, errors 1e-06 and 5e-05" in bench.bars._line(bar, rows)


@pytest.mark.slow
def test_a_ladder_is_measured_in_a_process_of_its_own(bench):
    growth = importlib.import_module("benchmark.growth")
    found, why = growth.measure(2)
    assert why == "" and tuple(found) == growth.STAGES
    assert all(seconds > 0.0 and memory > 10.0 for seconds, memory in found.values())
    grown = {10: {"load": (1.0, 0.0)}, 100: {"load": (20.0, 0.0)}}
    assert growth.power(grown, "load") == (pytest.approx(1.30103), 10, 100)


def test_the_plane_four_bar_turns_as_its_derivatives_say(bench):
    four_bar = importlib.import_module("benchmark.four_bar")
    phi, h = four_bar.angles(24), 1e-5
    _, rate, acceleration = four_bar.solve(phi, 1.0)
    ahead, behind = four_bar.solve(phi + h, 1.0), four_bar.solve(phi - h, 1.0)
    np.testing.assert_allclose((ahead[0] - behind[0]) / (2 * h), rate, atol=1e-9)
    np.testing.assert_allclose((ahead[1] - behind[1]) / (2 * h), acceleration, atol=1e-8)


@pytest.mark.parametrize("robot", ["five-bar", "3-RRR"])
def test_the_falling_robots_fall_alike_in_pinocchio(bench, robot):
    falling, other = (importlib.import_module(f"benchmark.{name}") for name in (
        "falling", "with_pinocchio_forces"))
    state = falling.ROBOTS[robot]()
    theirs = other.setup(state)
    opening = other.opening(theirs, theirs.q)
    assert opening < 1e-15 and opening <= state.closure_error < 2e-15
    np.testing.assert_allclose(
        sp.forward_dynamics(state.mechanism, state).a,
        other.acceleration(theirs, theirs.q, theirs.v), rtol=0, atol=1e-9)


def test_the_platform_solved_by_hand_has_the_legs_it_is_given(bench):
    stewart = importlib.import_module("benchmark.stewart")
    values = stewart.lengths(40)
    x, v, a = stewart.solve(values, stewart.SPEED).transpose(1, 2, 0)
    h = 1e-5 / stewart.SPEED
    ahead, behind = (stewart.solve(values + s * 1e-5, stewart.SPEED).transpose(1, 2, 0)
                     for s in (1, -1))
    np.testing.assert_allclose((ahead[0] - behind[0]) / (2 * h), v, atol=1e-9)
    np.testing.assert_allclose((ahead[1] - behind[1]) / (2 * h), a, atol=1e-8)
    assert np.ptp(x[:, 2]) > 0.005


# ---------------------------------------------------------------- targets in space


@pytest.mark.parametrize("name", few(["gough", "delta", "excavator", "ankle"], "delta", "ankle"))
def test_targets_of_closed_mechanisms_are_met_and_judged(bench, name):
    """By this library; the judge has kinematics of its own, and sees what is off by a little."""
    ours = importlib.import_module("benchmark.with_spatial_pin_reach")
    for case in ours.CASES:
        if case.task.endswith(name):
            tool = case.setup()
            tool = tool._replace(targets=tool.targets[:40])
            errors = case.judge(tool, case.run(tool))
            assert errors["missed"] == 0.0
            assert max(errors["closure"], errors["target"]) < 1e-13
    target, state = tool.targets[3], tool.solve(tool.targets[3], tool.home)
    values = dict(tool.values(state))
    values[next(iter(tool.robot.leading))] += 1e-4
    assert tool.robot.judge([target], [values])["missed"] == 1.0


@pytest.mark.parametrize(("name", "ours", "places"), first(2, [
    ("gough", "stewart", {"platform": "platform"}), ("delta", "delta", {"platform": "platform"}),
    ("excavator", "excavator", {"teeth": "teeth", "tipping": "tipping_link"})]))
def test_mechanisms_for_all_tools_are_those_of_the_library(bench, name, ours, places):
    closed = importlib.import_module("benchmark.closed")
    robot, mechanism = closed.ROBOTS[name], sp.load(ours)
    state = importlib.import_module("benchmark.with_spatial_pin_reach").CASES
    tool = next(c for c in state if c.task == f"reach-{name}").setup()
    for target in tool.targets[:3]:
        values = tool.values(tool.solve(target, tool.home))
        drivers = dict(zip(mechanism.drivers, (values[d] for d in robot.drivers), strict=False))
        found, there = sp.assemble(mechanism, drivers), robot.placements(values)
        for own, other in places.items():
            np.testing.assert_allclose(found.placement(other).homogeneous, there[own], atol=1e-11)
