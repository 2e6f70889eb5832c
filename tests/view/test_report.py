"""The report as text: what it says, and that nothing leads out of it. No browser needed."""

import html
import itertools
import re
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import spatial_pin as sp
from spatial_pin.motion.default_motion import ROWS, SLIDE, default_motion
from spatial_pin.view.browser.movie import movie
from spatial_pin.view.page.markup import number, table, tiny
from spatial_pin.view.page.plots import default_outputs, plot, svg
from spatial_pin.view.page.report import report
from spatial_pin.view.page.sections import SECTIONS
from spatial_pin.view.scene.look import Look


@pytest.fixture(scope="module")
def rssr() -> sp.Motion:
    return sp.sweep(sp.load("rssr"), "crank", np.linspace(0, 2 * np.pi, 73), speed=25.0)


def read(path) -> str:
    """The report without its 3-D view."""
    return re.sub(r'srcdoc="[^"]*"', "", path.read_text(encoding="utf-8"))


def headings(text: str) -> list[str]:
    return re.findall(r"<h2>(.*?)</h2>", text)


def test_report_of_a_motion_has_its_sections(rssr, tmp_path):
    text = read(report(rssr, tmp_path / "rssr.html"))
    assert headings(text) == [
        "Outputs", "Speed ratios", "Accelerations", "Ranges",
        "Special positions", "Efforts", "Reactions", "Mobility", "Dimensions", "Structure",
        "Accuracy",
    ]
    assert "<h1>RSSR spatial four-bar</h1>" in text
    assert html.escape(str(sp.mobility(rssr.mechanism, rssr.state(21)))) in text
    for name, value in rssr.mechanism.dimensions.items():
        assert f'<td>{name}</td><td class="number">{value:g}</td>' in text
    assert tiny(rssr.closure_error.max()) in text
    assert f"spatial_pin {sp.__version__}" in text and f"Pinocchio {pin.__version__}" in text
    assert "ball_a.x [rad], ball_a.y [rad], ball_a.z [rad]" in text
    assert len(re.findall(r'<svg role="img"', text)) == 4
    greatest = np.rad2deg(rssr.coordinate("rocker_pin").value.max())
    assert f"{greatest:.6g}°" in text
    assert "dead centre of rocker_pin" in text


def test_report_refers_to_nothing_outside_itself(rssr, tmp_path):
    text = report(rssr, tmp_path / "rssr.html").read_text(encoding="utf-8")
    outer = re.sub(r'srcdoc="[^"]*"', "", text)
    assert text.count("default-src 'none'") == 1 and "default-src &#x27;none&#x27;" in text
    assert not re.search(r"<(script|link|img|iframe)[^>]*\b(src|href)\s*=", outer)
    assert not re.findall(r'(?:href|src)="(?!#)[^"]*"', outer)
    assert len(text) < 1.6e6


def test_view_in_the_report_is_the_page(rssr, tmp_path):
    text = report(rssr, tmp_path / "rssr.html", title="A <b>").read_text(encoding="utf-8")
    (view,) = re.findall(r'srcdoc="([^"]*)"', text)
    inner = html.unescape(view)
    assert inner.startswith("<!DOCTYPE html>") and "<h1>A &lt;b&gt;</h1>" in inner
    assert inner.count("</body>") == 1 and "beforeprint" in inner
    assert "<h1>A &lt;b&gt;</h1>" in text


def test_view_in_the_report_has_the_look_asked_for(rssr, tmp_path):
    path = report(rssr, tmp_path / "rssr.html", look=Look(traces=("coupler.com",)))
    assert "path of coupler.com" in path.read_text(encoding="utf-8")


def test_same_motion_gives_the_same_report(rssr, tmp_path):
    first, second = (report(rssr, tmp_path / name) for name in ("a.html", "b.html"))
    assert read(first) == read(second)


def test_report_of_a_state_has_coordinates_instead_of_curves(tmp_path):
    state = sp.assemble(sp.load("stewart"))
    text = read(report(state, tmp_path / "stewart.html"))
    assert headings(text) == ["Configuration", "Mobility", "Dimensions", "Structure", "Accuracy"]
    assert "<svg" not in text and "hook_1.first" in text


def test_report_of_a_limit_tells_it_and_marks_it(tmp_path):
    motion = sp.sweep(sp.load("four_bar"), "rocker_pin", np.linspace(1.8, 2.9, 60), on_limit="stop")
    text = read(report(motion, tmp_path / "limit.html"))
    (event,) = motion.events
    assert html.escape(event.text) in text and number(event.value, "rad", 10) in text
    lines = plot(motion, "crank_pin").axes[0].lines
    assert lines[-1].get_xdata()[0] == pytest.approx(np.rad2deg(event.value))


def test_a_legend_says_what_the_lines_at_events_mean():
    mech = sp.load("slider_crank")
    at, model = mech.coordinate("slide").q, mech.model
    lower, upper = model.lowerPositionLimit.copy(), model.upperPositionLimit.copy()
    lower[at], upper[at] = 0.1103, 0.3
    model.lowerPositionLimit, model.upperPositionLimit = lower, upper
    motion = sp.sweep(mech, "crank", np.linspace(0.2, 6.0, 61))
    (legend,) = (figure := plot(motion, ["slide", "slide.ratio"])).legends
    assert [text.get_text() for text in legend.get_texts()] == ["joint limit"]
    for axes in figure.axes:
        assert axes.lines[-1].get_xdata()[0] == pytest.approx(np.rad2deg(motion.events[0].value))
    quiet = sp.sweep(mech, "crank", np.linspace(0.2, 1.0, 5))
    assert not plot(quiet, "slide").legends


def test_events_of_a_simulation_are_marked_at_their_times():
    mech = sp.load("stewart")
    state = sp.solve_rates(mech, sp.assemble(mech), {"leg_1": 0.1})
    motion = sp.simulate(mech, state, 0.2, on_joint_limit="stop")
    figure = plot(motion, "slide_1")
    assert [t.get_text() for t in figure.legends[0].get_texts()] == ["joint limit", "stopped"]
    assert figure.axes[0].lines[-1].get_xdata()[0] == motion.events[-1].value == motion.time[-1]


def test_ticks_tell_whole_numbers_where_a_coordinate_hardly_changes():
    """Nothing is to be added to them in one's head, and they have room."""
    motion = sp.sweep(sp.load("slider_crank"), "crank", np.linspace(1.0, 1.00001, 31))
    figure = plot(motion, ["slide", "slide.ratio"])
    figure.canvas.draw()
    for axes in figure.axes:
        assert not axes.yaxis.get_offset_text().get_text()
        for label in axes.get_yticklabels():
            low, high = axes.get_ylim()
            if low <= label.get_position()[1] <= high:
                assert float(label.get_text().replace("\u2212", "-")) == pytest.approx(
                    label.get_position()[1], rel=1e-12)
    boxes = [t.get_window_extent() for t in figure.axes[-1].get_xticklabels() if t.get_text()]
    assert all(a.x1 < b.x0 for a, b in itertools.pairwise(boxes)) and len(boxes) > 2


def test_outputs_are_those_asked_for(rssr, tmp_path):
    text = read(report(rssr, tmp_path / "a.html", outputs=["coupler.com.position", "rocker_pin"]))
    names = re.findall(r'aria-label="([^"]*)"', text)
    assert names == [
        "Outputs of rssr: coupler.com.position, rocker_pin",
        "Speed ratios of rssr: rocker_pin.ratio",
        "Velocities of rssr: coupler.com.velocity",
        "Accelerations of rssr: coupler.com.acceleration, rocker_pin.acceleration",
        "Efforts of rssr: crank effort",
    ]
    assert "x, y and z are world axes" in text
    with pytest.raises(sp.SpatialPinError, match="rocker_pin"):
        report(rssr, tmp_path / "b.html", outputs=["rocker_pni"])


def test_tree_without_loops_is_reported(tmp_path):
    motion = sp.sweep(sp.load("crane"), "slew", np.linspace(0, 1, 11))
    text = read(report(motion, tmp_path / "crane.html"))
    assert "no loops" in text and "boom.com.position" in text
    assert "Speed ratios" not in headings(text)


def test_motion_in_time_without_a_driver_is_reported_over_time(rssr, tmp_path):
    motion = replace(rssr, driver=None, driver_name="", driver_speed=None)
    text = read(report(motion, tmp_path / "a.html"))
    assert "Speed ratios" not in headings(text)
    assert "<dt>Duration</dt>" in text and '<th class="number">at time</th>' in text


def test_motion_without_rows_is_refused(rssr, tmp_path):
    empty = sp.Motion(rssr.mechanism, rssr.driver[:0], "crank", None, rssr.q[:0], rssr.v[:0],
                      rssr.a[:0], rssr.closure_error[:0], rssr.driver_speed[:0])
    with pytest.raises(ValueError, match="no samples"):
        report(empty, tmp_path / "a.html")


def test_a_motion_that_its_drivers_cannot_bring_about_has_no_efforts(rssr, tmp_path):
    idle = replace(rssr.mechanism, drivers={})
    motion = replace(rssr, mechanism=idle, driver=None, driver_name="")
    assert not {"Efforts", "Reactions"} & set(headings(read(report(motion, tmp_path / "a.html"))))


def test_every_section_says_what_it_does():
    assert all(write.__doc__ for write in SECTIONS)


# ---------------------------------------------------------------- pieces


@pytest.mark.parametrize(
    ("name", "driver", "expected"),
    [
        ("rssr", "crank", ["rocker_pin"]),
        ("four_bar", "crank", ["rocker_pin"]),
        ("four_bar", "rocker_pin", ["crank_pin"]),
        ("slider_crank", "crank", ["slide"]),
        ("rspc", "crank", ["guide.angle", "guide.slide"]),
        ("delta", "arm_1", ["pose.position"]),
        ("crane", "slew", ["boom.com.position", "cab.com.position"]),
    ],
)
def test_usual_outputs_are_what_moves_from_the_ground_on(name, driver, expected):
    mechanism = sp.load(name)
    state = sp.assemble(mechanism)
    first = state.coordinate(driver).value
    motion = sp.sweep(mechanism, driver, np.linspace(first, first + 0.1, 5), guess=state)
    assert default_outputs(motion) == expected


@pytest.mark.parametrize("name", sp.list_mechanisms())
def test_every_mechanism_of_the_library_has_a_usual_motion(name):
    motion = default_motion(sp.load(name))
    assert isinstance(motion, sp.Motion) and len(motion) > ROWS // 4
    assert motion.driver_name == next(iter(motion.mechanism.drivers))
    assert motion.time is None and default_outputs(motion)


def test_usual_motion_slides_a_little_and_turns_away_from_a_limit():
    slid = default_motion(sp.load("stewart"))
    assert np.ptp(slid.driver) == pytest.approx(SLIDE * slid.mechanism.characteristic_length)
    rocked = default_motion(sp.load("four_bar"), "rocker_pin")
    (event,) = rocked.events
    assert event.kind == "limit" and 1 < len(rocked) < ROWS


def test_usual_motion_of_a_mechanism_without_drivers_is_its_state():
    mechanism = replace(sp.load("rssr"), drivers={})
    assert isinstance(default_motion(mechanism), sp.State)


def test_usual_outputs_of_what_stands_still_are_its_driver():
    motion = sp.sweep(sp.load("rssr"), "crank", [0.4])
    assert default_outputs(motion) == ["crank_pin"]


def test_numbers_read_well():
    assert number(np.pi / 2, "rad") == "90°"
    assert number(-0.25, "m") == "−0.25\u202fm"
    assert number(-3e-17, "m/s²") == "0\u202fm/s²"
    assert tiny(8.4e-15) == "8.4\u00a0·\u00a010⁻¹⁵" and tiny(0.0) == "0"


def test_table_escapes_what_it_is_given():
    text = table(("<name>", "value"), [("a & b", "1")], numbers=1)
    assert "&lt;name&gt;" in text and '<td>a &amp; b</td><td class="number">1</td>' in text


def test_svg_is_one_element_with_identifiers_of_its_own(rssr):
    first, second = (svg(plot(rssr, "rocker_pin", title=""), name) for name in ("one", "two"))
    assert first.startswith('<svg role="img" aria-label="one"') and "<?xml" not in first

    def clips(text):
        return set(re.findall(r'<clipPath id="(\w+)"', text))

    assert clips(first) and not clips(first) & clips(second)


def test_plot_without_a_title_has_none(rssr):
    assert plot(rssr, "rocker_pin", title="").get_suptitle() == ""


@pytest.mark.parametrize(
    ("name", "rows", "fps", "message"),
    [
        ("a.avi", 5, 25, r"\.gif or \.mp4"),
        ("a.gif", 5, 0, "positive"),
        ("a.gif", 1, 25, "no movie"),
    ],
)
def test_movie_that_cannot_be_is_refused_at_once(rssr, tmp_path, name, rows, fps, message):
    motion = sp.sweep(rssr.mechanism, "crank", np.linspace(0.1, 0.2, rows))
    with pytest.raises(ValueError, match=message):
        movie(motion, tmp_path / name, fps=fps)


def test_the_report_of_a_simulation_balances_its_energy(rssr, tmp_path):
    mechanism = rssr.mechanism
    state = sp.solve_rates(mechanism, sp.assemble(mechanism), {"crank": 3.0})
    simulated = sp.simulate(mechanism, state, 0.2, times=np.linspace(0.0, 0.2, 21))
    text = sp.report(simulated, tmp_path / "r.html").read_text(encoding="utf-8")
    assert "Energy and work balance to" in text


def test_the_report_tells_efforts_reactions_and_dead_centres(rssr, tmp_path):
    text = sp.report(rssr, tmp_path / "r.html").read_text(encoding="utf-8")
    for words in ("crank effort [N·m]", "fixed link, all together", "dead centre of rocker_pin"):
        assert words in text
    loads = sp.kinetostatics(rssr.mechanism, rssr)
    largest = np.linalg.norm(loads.reactions["ball_b"][:, :3], axis=1).max()
    assert f"{largest:.6g}" in text
