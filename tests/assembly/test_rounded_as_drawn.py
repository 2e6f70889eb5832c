"""Loops that close as drawn, though their numbers are rounded: they move all the same."""

import warnings

import numpy as np
import pinocchio as pin
import pytest
import rounded
from variety import paired

import spatial_pin as sp

pytestmark = [pytest.mark.delicate,
              pytest.mark.filterwarnings("ignore::spatial_pin.SpatialPinWarning")]
CORNERS = np.array([(0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.25, 0.21, 0.0), (0.3, 0.0, 0.0)])
EXACT = 17


def four_bar(digits=EXACT, off=0.0, kind="revolute", tilt=(0.3, -0.5, 0.2), **keys):
    """A plane four-bar in space, its numbers rounded to some digits, closed as drawn.

    The closure's frames are placed on both links where the drawn pose has the last pin, so that the
    loop closes exactly there. `off` [rad] tilts the pin between crank and coupler.
    """
    rng, plane = np.random.default_rng(4), pin.exp3(np.array(tilt))
    turns = [pin.exp3(rng.normal(size=3)) for _ in range(3)]  # of the links' frames
    world = [pin.SE3(turn, plane @ corner) for turn, corner in zip(
        turns, CORNERS[[0, 1, 3]], strict=True)]
    model, joints = pin.Model(), []
    model.gravity.linear = plane @ np.array([0.0, -9.81, 0.0])
    for k, (name, parent) in enumerate((("crank", 0), ("coupler", 1), ("rocker", 0))):
        above = world[parent - 1] if parent else pin.SE3.Identity()
        place = above.actInv(world[k])
        axis = turns[k].T @ plane @ np.array([0.0, off if name == "coupler" else 0.0, 1.0])
        rpy = np.round(pin.rpy.matrixToRpy(place.rotation), digits)
        rounded = pin.SE3(pin.rpy.rpyToMatrix(rpy), np.round(place.translation, digits))
        joints.append(model.addJoint(parent, pin.JointModelRevoluteUnaligned(
            np.round(axis, digits) / np.linalg.norm(np.round(axis, digits))), rounded, name))
        com = turns[k].T @ plane @ np.array([0.05, 0.02, 0.0])
        model.appendBodyToJoint(joints[-1], pin.Inertia(1.0, com, 0.01 * np.eye(3)),
                                pin.SE3.Identity())
    data = model.createData()
    pin.forwardKinematics(model, data, pin.neutral(model))
    pin_place = pin.SE3(plane, plane @ CORNERS[2])
    frames = [(name, data.oMi[joint].actInv(pin_place))
              for name, joint in (("coupler", joints[1]), ("rocker", joints[2]))]
    closure = getattr(sp.closures, kind)(*frames, name="pin")
    return sp.Mechanism.from_model(model, [closure], drivers=["crank"], name="drawn", **keys)


def answers(mechanism):
    """Mobility, acceleration, holding torque, a sweep, a Jacobian and a simulated motion."""
    state = sp.assemble(mechanism)
    motion = sp.sweep(mechanism, "crank", np.linspace(0.0, 0.6, 7), speed=2.0)
    return (sp.mobility(mechanism, state).dof, sp.forward_dynamics(mechanism, state).a,
            sp.inverse_dynamics(mechanism, state).efforts["crank"],
            motion.coordinate("rocker").value, motion.coordinate("rocker").acceleration,
            sp.jacobian(mechanism, state, "rocker"),
            sp.simulate(mechanism, state, 0.2).coordinate("crank").value)


@pytest.mark.parametrize(("digits", "kind"), paired(
    [15, 12, 10, 9, 8, 7, 6, 5, 4], ["revolute", "spherical"]))
def test_a_drawn_four_bar_in_rounded_numbers_answers_as_the_exact_one(digits, kind):
    exact, found = answers(four_bar(kind=kind)), answers(four_bar(digits, kind=kind))
    assert found[0] == exact[0] == 1
    for x, y in zip(found[1:], exact[1:], strict=True):
        assert np.abs(x - y).max() < 30.0 * 10.0**-digits * (1.0 + np.abs(y).max()) + 1e-10


@pytest.mark.parametrize("off", [1e-11, 1e-9, 1e-7, 1e-5, 1e-4])
def test_a_hinge_that_is_hardly_tilted_leaves_a_freedom(off):
    exact, found = answers(four_bar()), answers(four_bar(off=off))
    assert found[0] == 1
    assert np.abs(found[1] - exact[1]).max() < 10.0 * off * np.abs(exact[1]).max() + 1e-10


def test_it_is_reported_once_and_carried_by_states_and_motions():
    mechanism = four_bar(6)
    with pytest.warns(sp.SpatialPinWarning, match=r"3 of 5 equations of 'pin' hold to \de-0"):
        state = sp.assemble(mechanism)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        motion = sp.sweep(mechanism, "crank", np.linspace(0.0, 0.5, 6))
        sp.forward_dynamics(mechanism, sp.assemble(mechanism, {"crank": 0.1}))
    assert state.gap < 1e-12  # as drawn it closes
    assert 1e-8 < motion.state(-1).gap < 1e-5
    assert motion.closure_error.max() < 1e-13


def test_gap_0_takes_the_numbers_as_exact():
    mechanism = four_bar(6, gap=0.0)
    state = sp.assemble(mechanism)
    assert sp.mobility(mechanism, state).dof == 0 and state.mechanism is mechanism
    with pytest.raises(sp.SpatialPinError, match=r"if its file's numbers are rounded .* gap="):
        sp.sweep(mechanism, "crank", np.linspace(0.0, 0.5, 6))
    again = four_bar(6)
    assert sp.assemble(again, gap=0.0).mechanism is again
    assert sp.assemble(again).mechanism.whole is again


def test_where_digits_are_too_few_the_refusal_names_the_gap_that_would_do():
    mechanism = four_bar(off=3e-3)
    with pytest.raises(sp.SingularError, match=r"load\(\.\.\., gap=\de-0\d\)") as refused:
        sp.sweep(mechanism, "crank", np.linspace(0.0, 0.5, 6))
    report = str(sp.mobility(mechanism))
    assert "mobility of drawn: 0" in report and "gap=" in report
    gap = float(str(refused.value).partition("gap=")[2].partition(")")[0])
    wide = four_bar(off=3e-3, gap=gap)
    assert sp.mobility(wide).dof == 1
    assert sp.sweep(wide, "crank", np.linspace(0.0, 0.5, 6)).state(-1).gap < gap


def test_a_motion_ends_where_redundant_equations_open_beyond_the_gap():
    mechanism = four_bar(off=2e-4, gap=2e-4)
    values = np.linspace(0.0, 3.0, 61)
    motion = sp.sweep(mechanism, "crank", values, on_limit="stop")
    assert motion.events[-1].kind == "gap" and motion.driver[-1] == pytest.approx(1.0, abs=0.1)
    with pytest.raises(sp.LimitError, match="redundant equations of closure 'pin'") as end:
        sp.sweep(mechanism, "crank", values)
    assert len(end.value.motion) == len(motion)


def test_every_followed_motion_ends_where_the_gap_opens():
    mechanism, values = four_bar(off=2e-4, gap=2e-4), np.linspace(0.0, 3.0, 61)
    timed = sp.follow(mechanism, {"crank": values}, times=values, on_limit="stop")
    traced = sp.trace(mechanism, "crank")
    with pytest.raises(sp.LimitError, match="redundant equations of closure 'pin'") as end:
        sp.reach_path(mechanism, {"crank": values}, times=values)
    for motion in (timed, traced, end.value.motion):
        assert motion.events[-1].kind == "gap"
        assert np.abs(motion.coordinate("crank").value).max() == pytest.approx(1.0, abs=0.15)


def test_save_keeps_the_gap(tmp_path):
    mechanism = four_bar(6, gap=2e-5)
    again = sp.load(mechanism.save(tmp_path / "saved"))
    assert again.gap == 2e-5 and sp.load(again.path, gap=0.0).gap == 0.0


# ------------------------------------------------------------ which equations stay


PIVOTS = np.array([(0.0, 0.0, 0.0), (0.9, 0.1, 0.0), (0.4, 0.55, 0.0)])


def parallel_cranks(digits, folded, ahead, seed=4, **keys):
    """A coupler on three parallel cranks; one loop of two of them folds `ahead` of the drawn pose.

    Args:
        digits: of all numbers; it closes as drawn.
        folded: the two cranks whose pivots and pins come to lie on a line.
        ahead: rad.
        seed: of the links' frames.
        **keys: of the mechanism.
    """
    rng, plane = np.random.default_rng(seed), pin.exp3(np.array((0.3, -0.5, 0.2)))
    line = PIVOTS[folded[1]] - PIVOTS[folded[0]]
    angle = np.arctan2(line[1], line[0]) - ahead
    crank = 0.5 * np.array([np.cos(angle), np.sin(angle), 0.0])
    links = [("crank0", 0, PIVOTS[0]), ("coupler", 1, PIVOTS[0] + crank),
             ("crank1", 0, PIVOTS[1]), ("crank2", 0, PIVOTS[2])]
    world = [pin.SE3(pin.exp3(rng.normal(size=3)), plane @ at) for _, _, at in links]
    model, joints = pin.Model(), []
    for k, (name, parent, _) in enumerate(links):
        place = (world[parent - 1] if parent else pin.SE3.Identity()).actInv(world[k])
        axis = np.round(world[k].rotation.T @ plane @ np.array([0.0, 0.0, 1.0]), digits)
        rpy = np.round(pin.rpy.matrixToRpy(place.rotation), digits)
        rounded_place = pin.SE3(pin.rpy.rpyToMatrix(rpy), np.round(place.translation, digits))
        joints.append(model.addJoint(parent, pin.JointModelRevoluteUnaligned(
            axis / np.linalg.norm(axis)), rounded_place, name))
        model.appendBodyToJoint(joints[-1], pin.Inertia(1.0, np.zeros(3), 0.01 * np.eye(3)),
                                pin.SE3.Identity())
    data = model.createData()
    pin.forwardKinematics(model, data, pin.neutral(model))
    closures = []
    for k in (1, 2):
        at = pin.SE3(plane, plane @ (PIVOTS[k] + crank))
        closures.append(sp.closures.revolute(
            *((name, data.oMi[joint].actInv(at)) for name, joint in (
                (f"crank{k}", joints[k + 1]), ("coupler", joints[1]))), name=f"pin{k}"))
    return sp.Mechanism.from_model(model, closures, drivers=["crank0"], name="cranks", **keys)


@pytest.mark.parametrize(("digits", "folded", "ahead"), [
    (9, (0, 1), -0.33), (9, (0, 2), 0.2), (7, (0, 1), 0.2), (7, (0, 2), -0.2), (6, (0, 1), -0.2),
    (6, (0, 2), 0.33), (5, (0, 1), -0.33), (5, (0, 2), 0.33)])
def test_parallel_cranks_go_on_where_two_of_them_are_folded(digits, folded, ahead):
    """The equations of that loop depend on each other there; those of the other loop do not."""
    mechanism = parallel_cranks(digits, folded, ahead)
    values = np.sign(ahead) * np.linspace(0.0, 0.5, 26)
    motion = sp.sweep(mechanism, "crank0", values)
    for crank in ("crank1", "crank2"):
        assert np.abs(motion.coordinate(crank).value - values).max() < 100.0 * 10.0**-digits


@pytest.mark.parametrize("seed", [5, 12, 13, 14])
def test_loops_that_nearly_count_as_closed_are_assembled(seed):
    """Numbers of eleven digits leave them open by as much as what counts as closed."""
    exact, mechanism = (rounded.plane([0.2, 0.5, 0.45, 0.6], rounding, seed=seed)
                        for rounding in (rounded.exactly, rounded.to_digits(11)))
    found = sp.assemble(mechanism)
    assert found.closure_error < 1e-13 and sp.mobility(mechanism, found).dof == 1
    assert np.abs(found.q - sp.assemble(exact).q).max() < 1e-9


@pytest.mark.parametrize("seed", [0, 1, 5])
def test_with_the_gap_that_a_report_names_the_mechanism_moves(seed):
    report = sp.mobility(parallel_cranks(3, (0, 2), 0.33, seed))
    assert report.dof == 0
    gap = float(str(report).partition("gap=")[2].partition(")")[0])
    assert sp.mobility(parallel_cranks(3, (0, 2), 0.33, seed, gap=gap)).dof == 1


@pytest.mark.parametrize("seed", [0, 3, 5])
def test_the_refusal_to_assemble_names_the_gap_that_would_do(seed):
    sides = [0.2, 0.5, 0.45, 0.6]
    with pytest.raises(sp.AssemblyError, match=r"stays open by .* gap=\de-04") as refused:
        sp.assemble(rounded.plane(sides, rounded.to_digits(4), seed=seed))
    gap = float(str(refused.value).partition("gap=")[2].partition(")")[0])
    mechanism = rounded.plane(sides, rounded.to_digits(4), seed=seed)
    assert sp.mobility(mechanism, sp.assemble(mechanism, gap=gap)).dof == 1


# ------------------------------------------------------------ what bends sharply


@pytest.mark.parametrize("play", [1e-1, 1e-3, 1e-4, 1e-6])
def test_a_four_bar_of_little_play_moves_on_its_small_oval(play):
    """Ground as long as the other three rods less a play: the crank swings a little to and fro."""
    rods = (1.0, 1.0, 1.0)
    model = pin.Model()
    for name, parent, x in (("crank", 0, 0.0), ("coupler", 1, rods[0]), ("rocker", 0, None)):
        at = 3.0 - play if x is None else x
        place = pin.SE3(np.eye(3), np.array([at, 0.0, 0.0]))
        model.addJoint(parent, pin.JointModelRZ(), place, name)
    ends = [("coupler", pin.SE3(np.eye(3), np.array([rods[1], 0.0, 0.0]))),
            ("rocker", pin.SE3(np.eye(3), np.array([-rods[2], 0.0, 0.0])))]
    mechanism = sp.Mechanism.from_model(model, [sp.closures.revolute(*ends, name="pin")],
                                        drivers=["crank"])
    reach = np.arccos(1.0 - 0.2 * play)  # well inside of what the crank can do
    state = sp.assemble(mechanism, {"crank": 0.3 * reach})
    assert sp.mobility(mechanism, state).dof == 1
