"""Where a frame gets to over a grid of drivers, against closed forms."""

from __future__ import annotations

import csv
import itertools
from concurrent.futures import ProcessPoolExecutor

import matplotlib.pyplot as plt
import numpy as np
import pytest
from mechanisms import closure, driver, guess, load, point, turning

import spatial_pin as sp
from spatial_pin.view.scene.film import film
from spatial_pin.view.scene.meshcat_commands import scene
from spatial_pin.workspace_map import workspace as module

GROUND, ARM, ROD = 0.2, 0.12, 0.16  # of the five-bar
ANGLES = (0.3, 2.8)
BARS = {"left": ANGLES, "right": ANGLES}
ARRAYS = ("drivers", "reached", "points", "rotations", "dexterity", "least")


def five_bar(folder) -> sp.Mechanism:
    """Two arms on the ground that are driven, and two rods that meet at the tip above them."""
    tree = (turning("left", "ground", "arm1") + turning("right", "ground", "arm2", (GROUND, 0, 0))
            + turning("elbow1", "arm1", "rod1", (ARM, 0, 0))
            + turning("elbow2", "arm2", "rod2", (ARM, 0, 0))
            + point("tip", "rod1", (ROD, 0, 0)) + point("tip2", "rod2", (ROD, 0, 0)))
    toml = (driver("left", "left") + driver("right", "right")
            + closure("pin", "revolute", "tip", "tip2")
            + guess(left=1.9, right=1.2, elbow1=-1.0, elbow2=1.0))
    return load(folder, "five_bar", tree, toml)


def elbows(drivers):
    """Return the ends of both arms (2, N, 2)."""
    ends = ARM * np.stack([np.cos(drivers), np.sin(drivers)], axis=-1)
    return ends[:, 0], ends[:, 1] + [GROUND, 0.0]


def five_bar_tip(drivers):
    """Return the tip (N, 2) above the elbows; NaN where they are too far apart."""
    a, b = elbows(drivers)
    half = 0.5 * (b - a)
    length = np.linalg.norm(half, axis=1, keepdims=True)
    with np.errstate(invalid="ignore"):
        up = np.sqrt(ROD**2 - length**2) / length
    return a + half + up * np.column_stack([-half[:, 1], half[:, 0]])


def sines(drivers):
    """Return the sines (N, 2) of the angles between arms and rods."""
    tip = five_bar_tip(drivers)
    ways = [(end - base, tip - end) for end, base in zip(
        elbows(drivers), ((0.0, 0.0), (GROUND, 0.0)), strict=True)]
    return np.column_stack([a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0] for a, b in ways]) / (ARM * ROD)


@pytest.fixture(scope="module")
def bars(tmp_path_factory) -> sp.Mechanism:
    return five_bar(tmp_path_factory.mktemp("five_bar"))


@pytest.fixture(scope="module")
def found(bars) -> sp.Workspace:
    return sp.workspace(bars, "tip", BARS, points=25)


def test_a_five_bar_gets_where_its_rods_reach(found):
    tip = five_bar_tip(found.drivers)
    known = ~np.isnan(tip).any(axis=1)
    assert np.count_nonzero(~known) > 50
    np.testing.assert_array_equal(found.reached, known)
    np.testing.assert_allclose(found.points[known, :2], tip[known], atol=1e-12)
    np.testing.assert_allclose(found.points[known, 2], 0.0, atol=1e-12)
    assert np.isnan(found.points[~known]).all()
    assert {why for why, r in zip(found.why, found.reached, strict=True) if not r} == {"limit"}


def test_the_workspace_of_a_five_bar_lies_in_the_annuli_of_both_arms(found):
    for base in ((0.0, 0.0), (GROUND, 0.0)):
        far = np.linalg.norm(found.points[found.reached, :2] - base, axis=1)
        assert abs(ARM - ROD) - 1e-12 < far.min()
        assert far.max() < ARM + ROD + 1e-12


def test_the_boundary_of_a_five_bar_is_where_the_rods_are_in_line(found):
    a, b = elbows(found.boundary.drivers)
    assert set(found.boundary.why) == {"limit"}
    np.testing.assert_allclose(np.linalg.norm(b - a, axis=1), 2 * ROD, rtol=1e-9)
    np.testing.assert_allclose(found.boundary.points[:, :2], 0.5 * (a + b), atol=1e-8)
    lines = found.reached.reshape(25, 25).astype(int)
    ends = sum(np.count_nonzero(np.diff(lines, axis=k)) for k in (0, 1))
    assert len({tuple(x) for x in found.boundary.drivers.round(9)}) == ends


def test_the_singular_curves_of_a_five_bar_are_where_an_arm_and_its_rod_are_in_line(found):
    assert len(found.singular) > 10
    np.testing.assert_allclose(np.abs(sines(found.singular.drivers)).min(axis=1), 0.0, atol=1e-7)
    np.testing.assert_allclose(found.singular.points[:, :2], five_bar_tip(found.singular.drivers),
                               atol=1e-9)
    sign = np.sign(sines(found.drivers)).prod(axis=1).reshape(25, 25)
    changes = 0
    for k in (0, 1):
        first, last = (np.take(sign, range(j, 24 + j), axis=k) for j in (0, 1))
        changes += np.count_nonzero(first * last < 0)
    assert len(found.singular) == changes


def test_the_dexterity_of_a_five_bar_is_that_of_its_closed_form(bars, found):
    rows = np.flatnonzero(found.reached)[::17]
    h = 1e-6
    steps = [found.drivers[rows] + h * e for e in np.vstack([np.eye(2), -np.eye(2)])]
    tips = [five_bar_tip(x) for x in steps]
    jacobians = np.stack([tips[0] - tips[2], tips[1] - tips[3]], axis=-1) / (2 * h)
    s = np.linalg.svd(jacobians / bars.characteristic_length, compute_uv=False)
    good = ~np.isnan(s).any(axis=1)
    np.testing.assert_allclose(found.dexterity[rows][good], (s[:, 1] / s[:, 0])[good], atol=1e-5)
    np.testing.assert_allclose(found.least[rows][good], s[good, 1], atol=1e-5)
    assert (found.task, found.directions, found.n_drivers) == ("position", 2, 2)
    np.testing.assert_allclose(found.condition[rows] * found.dexterity[rows], 1.0)


def spheres(drivers, side, top, arm, rod):
    """Return the point (N, 3) below that is a rod's length from three centres; NaN without one."""
    yaw = np.deg2rad([-90.0, 30.0, 150.0])
    out = side * np.sqrt(3) / 6 - top * np.sqrt(3) / 3 + arm * np.cos(drivers)
    centres = np.stack([out * np.cos(yaw), out * np.sin(yaw), -arm * np.sin(drivers)], axis=-1)
    p1 = centres[:, 0]
    ex = centres[:, 1] - p1
    d = np.linalg.norm(ex, axis=1)
    ex /= d[:, None]
    i = np.einsum("ij,ij->i", ex, centres[:, 2] - p1)
    ey = centres[:, 2] - p1 - i[:, None] * ex
    j = np.linalg.norm(ey, axis=1)
    ey /= j[:, None]
    x = d / 2
    y = (i**2 + j**2 - 2 * i * x) / (2 * j)
    with np.errstate(invalid="ignore"):
        z = np.sqrt(rod**2 - x**2 - y**2)
    ez = np.cross(ex, ey)
    return p1 + x[:, None] * ex + y[:, None] * ey - z[:, None] * ez


def test_a_delta_gets_where_three_spheres_meet():
    mechanism = sp.load("delta", ll=0.7)
    ranges = {f"arm_{k}": (-1.5, 2.4) for k in (1, 2, 3)}
    found = sp.workspace(mechanism, "platform", ranges, points=4, on_crossing="straight")
    side, top, arm, rod = 0.567, 0.076, 0.524, 0.7
    where = spheres(found.drivers, side, top, arm, rod)
    known = ~np.isnan(where).any(axis=1)
    assert known.any()
    assert not known.all()
    np.testing.assert_array_equal(found.reached, known)
    np.testing.assert_allclose(found.points[known], where[known], atol=1e-10)
    np.testing.assert_allclose(found.rotations[known], np.broadcast_to(
        np.eye(3), (np.count_nonzero(known), 3, 3)), atol=1e-10)
    assert (found.task, found.directions) == ("position", 3)
    part = sp.workspace(mechanism, "platform", ranges, points=4)  # where the platform may turn too
    assert "branch point" in part.why
    np.testing.assert_array_equal(found.reached & part.reached, part.reached)
    np.testing.assert_allclose(part.points[part.reached], where[part.reached], atol=1e-10)


def test_legs_of_a_gough_platform_are_as_long_as_its_poses_say():
    mechanism = sp.load("stewart")
    ranges = {f"leg_{k}": (0.36, 0.42) for k in (1, 3, 6)}
    found = sp.workspace(mechanism, "platform", ranges, points=5)
    assert found.reached.all()
    ways = np.repeat(np.deg2rad([0.0, 120.0, 240.0]), 2)
    side = np.tile([-1.0, 1.0], 3)
    feet, tops = ways + side * np.deg2rad(20), ways + side * np.deg2rad(45)
    feet, tops = (r * np.column_stack([np.cos(x), np.sin(x), 0 * x])
                  for r, x in ((0.30, feet), (0.18, tops)))
    balls = found.points[:, None] + np.einsum("nij,kj->nki", found.rotations, tops)
    lengths = np.linalg.norm(balls - feet, axis=2)
    home = sp.assemble(mechanism, {}).coordinate("slide_2").value
    wanted = np.full(lengths.shape, home)
    wanted[:, [0, 2, 5]] = found.drivers
    np.testing.assert_allclose(lengths, wanted, atol=1e-12)
    assert (found.task, found.directions, found.n_drivers) == ("pose", 6, 6)


def test_joint_limits_are_kept_and_named():
    mechanism = sp.load("stewart")
    ranges = {"leg_1": (0.38, 0.5), "leg_2": (0.38, 0.5)}
    found = sp.workspace(mechanism, "platform", ranges, points=4)
    highest = mechanism.model.upperPositionLimit[mechanism.coordinate("slide_1").q]
    np.testing.assert_array_equal(found.reached, (found.drivers < highest).all(axis=1))
    assert {why.partition(":")[0] for why in found.why} <= {
        "", "joint limit", "no way along the grid"}
    assert any(why.startswith("joint limit: upper limit") for why in found.why)
    ends = found.boundary.drivers.max(axis=1)
    np.testing.assert_allclose(ends, highest, atol=1e-9)
    free = sp.workspace(mechanism, "platform", ranges, points=4, limits=False)
    assert np.count_nonzero(free.reached) > np.count_nonzero(found.reached)


def test_workers_change_nothing(bars, found):
    with ProcessPoolExecutor(2) as pool:
        other = sp.workspace(bars, "tip", BARS, points=25, executor=pool)
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(other, name), getattr(found, name))
    assert other.why == found.why
    for name, side in itertools.product(("drivers", "points"), ("boundary", "singular")):
        np.testing.assert_array_equal(getattr(getattr(other, side), name),
                                      getattr(getattr(found, side), name))
    assert str(other) == str(found)


def test_what_was_found_before_an_interruption_is_kept(bars, found, monkeypatch):
    class Bar:
        n = 0

        def __enter__(self):
            return self

        def __exit__(self, *error):
            pass

        def update(self, done):
            self.n += done
            if self.n > 200:
                raise KeyboardInterrupt

    monkeypatch.setattr(module, "progress_bar", lambda *args: Bar())
    part = sp.workspace(bars, "tip", BARS, points=25)
    assert not part.is_whole
    assert "cut short" in str(part)
    assert 200 < np.count_nonzero(part.reached) < np.count_nonzero(found.reached)
    np.testing.assert_array_equal(part.points[part.reached], found.points[part.reached])
    assert "not looked at" in part.why


def test_a_state_of_it_is_closed_and_stands_there(found):
    row = int(np.flatnonzero(found.reached)[5])
    state = found.state(row)
    np.testing.assert_allclose(state.placement("tip").translation, found.points[row], atol=1e-14)
    assert state.closure_error < 1e-12
    with pytest.raises(sp.SpatialPinError, match="not reached: limit"):
        found.state(int(np.flatnonzero(~found.reached)[0]))
    with pytest.raises(sp.SpatialPinError, match="there is no point"):
        found.state(10**6)


def test_a_report_a_table_and_pictures_are_made_of_it(bars, found, tmp_path):
    text = str(found)
    assert "points reached" in text
    assert "limit" in text
    assert f"vanishes at {len(found.singular)} places" in text
    with found.to_csv(tmp_path / "w.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 625
    assert [float(r["tip.x [m]"]) for r, k in zip(rows, found.reached, strict=True) if k] == list(
        found.points[found.reached, 0])
    figure = found.plot(tmp_path / "w.png")
    assert (tmp_path / "w.png").stat().st_size > 10_000
    assert figure.axes[0].get_xlabel() == "x [m]"
    assert figure.axes[0].get_ylabel() == "y [m]"
    thin = found.plot(plane="yz", at=0.1, thickness=0.01)
    assert len(thin.axes[0].collections[0].get_offsets()) < np.count_nonzero(found.reached)
    with pytest.raises(ValueError, match="plane"):
        found.plot(plane="zz")
    plt.close("all")
    row = int(np.flatnonzero(found.reached)[0])
    layer = scene(film(found.state(row)), sp.Look(workspace=found)).layer
    balls = [item for item in layer.items if item.name.startswith("workspace")]
    assert balls[-1].name == "workspace ends"
    n = sum(len(item.solid.geometry.vertices) for item in balls) / 6
    assert n == np.count_nonzero(found.reached) + len(found.boundary)
    assert any("dexterity" in entry.text for entry in layer.legend)
    with pytest.raises(TypeError, match=r"sp\.workspace\(mechanism, frame"):
        sp.Look(workspace=3)
    with pytest.raises(sp.SpatialPinError, match="that of another one, 'five_bar'"):
        scene(film(sp.assemble(sp.load("four_bar"))), sp.Look(workspace=found))


@pytest.mark.parametrize(("change", "error", "words"), [
    ({"frame": "tap"}, LookupError, "did you mean 'tip'"),
    ({"ranges": {"lift": (0, 1)}}, LookupError, "lift"),
    ({"ranges": {"left": (1.0, 0.5)}}, ValueError, "the first is to be the smaller one"),
    ({"ranges": {"left": (0.0, np.nan)}}, ValueError, "left"),
    ({"ranges": {"left": 1.0}}, ValueError, "left"),
    ({"ranges": {}}, ValueError, "empty"),
    ({"points": 1}, ValueError, "2 at least"),
    ({"points": 500}, ValueError, "200000 at most"),
    ({"points": {"left": 5}}, ValueError, "they are wanted of"),
    ({"task": "place"}, ValueError, "task"),
])
def test_bad_input_is_refused_in_words(bars, change, error, words):
    given = {"frame": "tip", "ranges": BARS, "points": 5} | change
    with pytest.raises(error, match=words):
        sp.workspace(bars, given.pop("frame"), given.pop("ranges"), **given)
