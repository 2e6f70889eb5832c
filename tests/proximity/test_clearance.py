"""How far links stay apart over a motion, against closed forms, and where they touch."""

from __future__ import annotations

import json

import numpy as np
import pytest
from carriers import arm, ball, solid
from loaded_library import library
from variety import few

import spatial_pin as sp


def rod(radius: float, length: float, x: float, rpy=(0.0, 0.0, 0.0)) -> str:
    return solid(f'<cylinder radius="{radius}" length="{length}"/>', (x, 0.0, 0.0), rpy)


PAIR = [("post", "crank")]


def test_the_distance_of_two_balls_is_the_closed_form(tmp_path):
    mechanism = arm(tmp_path, ball(0.1, 1.0, 0.5, 0.2), ball(0.05, 1.0))
    motion = sp.sweep(mechanism, "turn", np.linspace(0.0, 2 * np.pi, 37))
    found = sp.clearance(motion, PAIR).least
    tip = np.column_stack([np.cos(motion.driver), np.sin(motion.driver), 0 * motion.driver])
    apart = np.linalg.norm(tip - [1.0, 0.5, 0.2], axis=1) - 0.15
    assert found.distances == pytest.approx(apart, abs=1e-15)
    assert np.linalg.norm(found.points[:, 1] - found.points[:, 0], axis=1) == pytest.approx(
        apart, abs=1e-14)
    angle = np.arctan2(0.5, 1.0)
    least = np.hypot(np.hypot(1.0, 0.5) - 1.0, 0.2) - 0.15
    assert found.value == pytest.approx(angle, abs=1e-6)
    assert found.distance == pytest.approx(least, abs=1e-13)
    assert not found.contacts


@pytest.mark.parametrize("steps", [10, 37, 361])
def test_balls_begin_and_cease_to_touch_where_the_closed_form_says(tmp_path, steps):
    mechanism = arm(tmp_path, ball(0.1, 1.0, 0.5), ball(0.05, 1.0))
    motion = sp.sweep(mechanism, "turn", np.linspace(-1.0, 2.0, steps))
    found = sp.clearance(motion, PAIR)
    far = np.hypot(1.0, 0.5)
    half = np.arccos((1.0 + far**2 - 0.15**2) / (2.0 * far))
    middle = np.arctan2(0.5, 1.0)
    assert [(e.kind, e.value) for e in found.events] == [
        ("touch", pytest.approx(middle - half, abs=1e-12)),
        ("part", pytest.approx(middle + half, abs=1e-12))]
    contact, = found.least.contacts
    assert contact == pytest.approx((middle - half, middle + half), abs=1e-12)
    assert found.least.distance == pytest.approx(far - 1.0 - 0.15, abs=1e-13)
    assert motion.driver[found.events[0].row - 1] <= contact.begin <= (
        motion.driver[found.events[0].row])


@pytest.mark.parametrize(("samples", "turns"), [(2, 1), (4, 1.5), (5, 9), (3, 20)])
@pytest.mark.parametrize("from_rest", [False, True])
def test_no_touch_is_missed_between_samples_whole_turns_apart(tmp_path, samples, turns, from_rest):
    mechanism = arm(tmp_path, ball(0.1, 1.0, 0.5), ball(0.05, 1.0))
    times = np.linspace(0.0, 1.0, samples)
    angle = -1.0 + 2 * np.pi * turns * (times**2 if from_rest else times)
    rates = {"turn": 4 * np.pi * turns * times} if from_rest else None
    found = sp.clearance(sp.follow(mechanism, {"turn": angle}, times, rates=rates), PAIR)
    far, middle = np.hypot(1.0, 0.5), np.arctan2(0.5, 1.0)
    half = np.arccos((1.0 + far**2 - 0.15**2) / (2.0 * far))
    passed = (middle + np.array([-half, half]) + 2 * np.pi * np.arange(int(turns + 0.7))[:, None]
              + 1.0) / (2 * np.pi * turns)
    passed = (np.sqrt(passed) if from_rest else passed).ravel()
    assert [e.value for e in found.events] == pytest.approx(passed[passed < 1.0], abs=1e-11)


def test_a_tolerance_moves_where_links_count_as_touching(tmp_path):
    mechanism = arm(tmp_path, ball(0.1, 1.0, 0.5), ball(0.05, 1.0))
    motion = sp.sweep(mechanism, "turn", np.linspace(-1.0, 2.0, 91))
    far, middle = np.hypot(1.0, 0.5), np.arctan2(0.5, 1.0)
    for tolerance in (0.1, -0.02):
        half = np.arccos((1.0 + far**2 - (0.15 + tolerance) ** 2) / (2.0 * far))
        contact, = sp.clearance(motion, PAIR, tolerance=tolerance).least.contacts
        assert contact == pytest.approx((middle - half, middle + half), abs=1e-12)
    assert not sp.clearance(motion, PAIR, tolerance=-0.05).touching


def test_a_thin_pin_between_two_samples_is_not_missed(tmp_path):
    mechanism = arm(tmp_path, rod(0.01, 0.4, 0.7), rod(0.01, 1.0, 0.5, rpy=(0, np.pi / 2, 0)))
    motion = sp.sweep(mechanism, "turn", np.linspace(-0.25, 0.25, 6))  # 0.1 rad, the pins 0.03
    found = sp.clearance(motion, PAIR).least
    assert min(found.distances) > 0.0
    half = np.arcsin(0.02 / 0.7)
    contact, = found.contacts
    assert contact == pytest.approx((-half, half), abs=1e-8)
    assert found.distance == pytest.approx(-0.02, abs=1e-7)


def test_parts_made_to_slide_on_each_other_touch_all_the_way(tmp_path):
    table = solid('<box size="4 4 0.2"/>', (0, 0, -0.15))
    mechanism = arm(tmp_path, table, ball(0.05, 1.0))
    motion = sp.sweep(mechanism, "turn", np.linspace(0.0, 3.0, 31))
    found = sp.clearance(motion, PAIR)
    assert found.least.contacts == ((0.0, 3.0),)
    assert not found.events
    assert abs(found.least.distance) < 1e-10


def test_what_collides_goes_before_what_is_drawn(tmp_path):
    ground = ball(0.3, 1.0, 0.5) + ball(0.1, 1.0, 0.5, kind="collision")
    mechanism = arm(tmp_path, ground, ball(0.05, 1.0))
    motion = sp.sweep(mechanism, "turn", np.linspace(-1.0, 2.0, 31))
    assert sp.clearance(motion, PAIR).least.distance == pytest.approx(np.hypot(1, 0.5) - 1.15)


# ---------------------------------------------------------------- which links


def test_links_that_are_joined_are_not_looked_at_unless_named():
    motion = sp.sweep(library("four_bar"), "crank", np.linspace(0.0, 1.0, 5))
    found = sp.clearance(motion)
    looked_at = {frozenset(p.links) for p in found.pairs}
    assert looked_at == {frozenset(("ground", "coupler")), frozenset(("crank", "rocker"))}
    assert {frozenset(names) for names in found.joined} == {
        frozenset(x) for x in (("ground", "crank"), ("ground", "rocker"), ("crank", "coupler"),
                               ("coupler", "rocker"))}  # the last by the closure
    assert sp.clearance(motion, [("crank", "coupler")]).least.links == ("crank", "coupler")


def test_links_on_both_sides_of_one_without_a_shape_are_joined(tmp_path):
    more = ('<link name="cross"/><link name="shaft">' + ball(0.1, 0.3) + "</link>"
            '<joint name="first" type="continuous"><parent link="crank"/><child link="cross"/>'
            '<axis xyz="1 0 0"/></joint>'
            '<joint name="second" type="continuous"><parent link="cross"/><child link="shaft"/>'
            '<axis xyz="0 1 0"/></joint>')
    mechanism = arm(tmp_path, ball(0.1), ball(0.1, 0.25), more)
    found = sp.clearance(sp.sweep(mechanism, "turn", [0.0, 0.1]))
    assert {frozenset(names) for names in found.joined} == {
        frozenset(("post", "crank")), frozenset(("crank", "shaft"))}
    assert [set(p.links) for p in found.pairs] == [{"post", "shaft"}]


@pytest.mark.parametrize("laps", few([0.3, 1.0], 0.3))
def test_the_delta_robot_passes_all_over_its_workspace(laps):
    mechanism = library("delta")
    lap = np.linspace(0.0, 2.0 * laps * np.pi, round(40 * laps) + 1)
    arms = {f"arm_{k + 1}": 0.25 + 1.15 * np.sin((k + 1) * lap + k) for k in range(3)}
    assert not sp.clearance(sp.follow(mechanism, arms)).touching


@pytest.mark.parametrize(("r", "l"), [
    (0.03, 0.2), *(pytest.param(*sides, marks=pytest.mark.slow)
                   for sides in ((0.06, 0.1), (0.05, 0.14), (0.12, 0.1)))])
def test_sarrus_passes_through_its_folded_places_whatever_its_dimensions(r, l):  # noqa: E741
    """Its panels turn side by side: pins of others are half a gap away where they come round."""
    motion = sp.sweep(library("sarrus", r=r, l=l), "arm", np.linspace(0.4, 6.5, 26))
    found = sp.clearance(motion)
    assert not found.touching
    assert found.least.distance == pytest.approx(0.15 * 0.04 * l, rel=1e-3)


# ---------------------------------------------------------------- motions


def test_a_touch_between_samples_far_apart_is_where_a_finer_sweep_has_it():
    """Of 0.5 rad a step, over which polynomials through the samples stray by centimetres."""
    mechanism = library("delta")
    far, fine = (sp.sweep(mechanism, "arm_1", np.linspace(0.0, 2.618, n)) for n in (6, 120))
    found, true = (sp.clearance(motion, [("rod_1a", "rod_3a")]).least for motion in (far, fine))
    assert found.contacts and found.contacts[0] == pytest.approx(tuple(true.contacts[0]), abs=1e-7)
    assert found.distance == pytest.approx(true.distance, abs=1e-6)


def test_a_state_is_a_motion_of_one_sample():
    state = sp.assemble(library("four_bar"), {"crank": 1.0})
    found = sp.clearance(state)
    motion = sp.clearance(sp.sweep(state.mechanism, "crank", [1.0, 1.1]))
    assert found.between("ground", "coupler").distance == pytest.approx(
        motion.between("coupler", "ground").distances[0], abs=1e-14)


def test_a_simulation_is_looked_at_over_its_time(tmp_path):
    """A ball on a turning arm that nothing holds back, at a constant speed."""
    mechanism = arm(tmp_path, ball(0.1, 1.0, 0.5), ball(0.05, 1.0))
    text = (tmp_path / "arm.urdf").read_text().replace(
        '<link name="crank">', '<link name="crank"><inertial><mass value="1"/>'
        '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>')
    (tmp_path / "heavy.urdf").write_text(text)
    mechanism = sp.load(tmp_path / "heavy.urdf")
    state = sp.solve_rates(mechanism, sp.assemble(mechanism, {"turn": -1.0}), {"turn": 2.0})
    motion = sp.simulate(mechanism, state, 1.5, times=np.linspace(0.0, 1.5, 16))
    found = sp.clearance(motion, PAIR)
    far, middle = np.hypot(1.0, 0.5), np.arctan2(0.5, 1.0)
    half = np.arccos((1.0 + far**2 - 0.15**2) / (2.0 * far))
    contact, = found.least.contacts
    assert contact == pytest.approx(((middle - half + 1) / 2, (middle + half + 1) / 2), abs=1e-8)
    assert "time = " in found.events[0].text


def test_a_motion_of_several_drivers_is_looked_at_over_time_and_over_samples_alike(tmp_path):
    more = '<link name="other"/><joint name="apart" type="continuous"><parent link="post"/>' \
           '<child link="other"/></joint>'
    mechanism = arm(tmp_path, ball(0.1, 1.0, 0.5), ball(0.05, 1.0), more)
    values = {"turn": np.linspace(-1.0, 2.0, 11), "apart": 0.1 * np.arange(11.0) ** 2}
    contact, = sp.clearance(sp.follow(mechanism, values), PAIR).least.contacts
    far, middle = np.hypot(1.0, 0.5), np.arctan2(0.5, 1.0)
    half = np.arccos((1.0 + far**2 - 0.15**2) / (2.0 * far))
    assert contact == pytest.approx(((middle - half + 1) / 0.3, (middle + half + 1) / 0.3),
                                    abs=1e-9)
    timed = sp.clearance(sp.follow(mechanism, values, np.arange(11.0)), PAIR).least
    assert timed.contacts[0] == pytest.approx(contact, abs=1e-12)


def test_a_traced_curve_is_looked_at_over_its_driver():
    motion, pair = sp.trace(library("four_bar"), "crank", step=0.05), [("crank", "rocker")]
    least = sp.clearance(motion, pair).between("crank", "rocker")
    over = sp.sweep(motion.mechanism, "crank", np.linspace(0.0, 2 * np.pi, 361))
    assert least.distance == pytest.approx(
        sp.clearance(over, pair).between("crank", "rocker").distance, abs=1e-6)


# ---------------------------------------------------------------- shown and told


def test_the_clearance_of_another_motion_is_refused(tmp_path):
    mechanism = library("four_bar")
    one, two = (sp.sweep(mechanism, "crank", np.linspace(0.0, x, 9)) for x in (1.0, 2.0))
    with pytest.raises(sp.SpatialPinError, match="another motion"):
        sp.export_html(two, tmp_path / "page.html", look=sp.Look(clearance=sp.clearance(one)))
    with pytest.raises(TypeError, match=r"sp\.clearance\(motion\) makes one"):
        sp.Look(clearance=3)


CHAIN = (f'<robot name="chain"><link name="base">{ball(0.1)}</link>'
         f'<link name="upper">{ball(0.05, 0.25)}</link><link name="lower">{ball(0.1, 0.5)}</link>'
         '<joint name="first" type="continuous"><parent link="base"/><child link="upper"/>'
         '<axis xyz="0 0 1"/></joint><joint name="second" type="continuous">'
         '<parent link="upper"/><child link="lower"/><origin xyz="0.5 0 0"/>'
         '<axis xyz="0 0 1"/></joint></robot>')


def test_the_command_line_tells_where_a_chain_comes_back_to_its_base(tmp_path, run):
    (tmp_path / "chain.urdf").write_text(CHAIN)
    code, told, _ = run("sweep", tmp_path / "chain.urdf", "second", "90deg", "270deg", "--steps",
                        "5", "--clearance", "--json", tmp_path / "out.json")
    assert code == 0
    assert "1 pairs of links over second [rad], 1 of them touch; 2 are joined" in told
    content = json.loads((tmp_path / "out.json").read_text())["clearance"]
    assert content["pairs"][0]["distance"] == pytest.approx(-0.2, abs=1e-9)
    apart = 2.0 * np.arcsin(0.2)  # of the ends of two rods of 0.5 m, 0.2 m from each other
    assert [(e["kind"], e["value"]) for e in content["events"]] == [
        ("touch", pytest.approx(np.pi - apart, abs=1e-9)),
        ("part", pytest.approx(np.pi + apart, abs=1e-9))]


@pytest.mark.slow
def test_the_command_line_tells_and_writes_it(tmp_path, run):
    target = tmp_path / "out.json"
    code, told, _ = run("sweep", "delta", "arm_1", "1.9", "2.6", "--steps", "15", "--clearance",
                        "--json", target)
    assert code == 0
    assert "39 pairs of links over arm_1 [rad], 4 of them touch; 16 are joined" in told
    content = json.loads(target.read_text())["clearance"]
    assert content["pairs"][0]["distance"] < 0.0
    assert {e["kind"] for e in content["events"]} == {"touch", "part"}


@pytest.mark.parametrize(("pairs", "error", "words"), [
    ([("ground", "nobody")], sp.UnknownNameError, "nobody"),
    ([("ground", "ground")], sp.SpatialPinError, "fixed to each other"),
    ([("ground",)], sp.SpatialPinError, "a pair is two links"),
    (["ground"], sp.SpatialPinError, "a pair is two links"),
])
def test_pairs_that_are_none_are_refused(pairs, error, words):
    state = sp.assemble(library("four_bar"))
    with pytest.raises(error, match=words):
        sp.clearance(state, pairs)


def test_other_bad_input_is_refused_in_words(tmp_path):
    state = sp.assemble(library("four_bar"))
    with pytest.raises(ValueError, match="tolerance"):
        sp.clearance(state, tolerance=np.nan)
    with pytest.raises(TypeError, match="Motion"):
        sp.clearance("four_bar")
    with pytest.raises(ValueError, match="pairs is empty"):
        sp.clearance(state, [])
    with pytest.raises(sp.SpatialPinError, match="were not looked at: they are joined"):
        sp.clearance(state).between("ground", "crank")
    bare = arm(tmp_path, "", ball(0.1))
    with pytest.raises(sp.SpatialPinError, match="no <collision> and no <visual>"):
        sp.clearance(sp.assemble(bare), PAIR)
    empty = sp.clearance(sp.assemble(bare))
    assert str(empty).endswith("no two links that are not joined have a shape")
    with pytest.raises(sp.SpatialPinError, match="no two links"):
        _ = empty.least


@pytest.mark.parametrize("numbers", few([(5, 8), (7, 11, 20)], (5, 8)))
def test_pairs_that_are_as_near_as_each_other_stand_by_names_however_many_samples(numbers):
    """The legs of a delta robot whose arms go down together."""
    mechanism = library("delta")
    home = sp.assemble(mechanism)
    orders = []
    for samples in numbers:
        values = {name: home.coordinate(name).value + np.linspace(0.0, 0.5, samples)
                  for name in mechanism.drivers}
        pairs = sp.clearance(sp.follow(mechanism, values)).pairs
        orders.append([pair.links for pair in pairs])
        assert np.diff([pair.distance for pair in pairs]).min() > -1e-9
    assert all(order == orders[0] for order in orders)
