"""Joint limits of the URDF in designs: named where a motion passes them, kept where that is asked.

The mechanism is the library's four-bar, whose rocker has limits. Its least and its largest angle
are where crank and coupler are folded and stretched, by the law of cosines.
"""

import numpy as np
import pytest

import spatial_pin as sp
from spatial_pin.synthesis.defects import defects
from spatial_pin.synthesis.demands.candidate import Candidate, in_own_turn

goals = sp.goals
BOUNDS = {"r2": (0.02, 0.3), "r3": (0.05, 0.6), "r4": (0.05, 0.6)}


@pytest.fixture(scope="module")
def limited(tmp_path_factory):
    """Return what loads the four-bar with limits of its rocker."""
    folder, here = tmp_path_factory.mktemp("limited"), sp.load("four_bar").path.parent
    for name in ("four_bar.toml", "parts.xacro"):
        (folder / name).write_bytes((here / name).read_bytes())
    text = (here / "four_bar.urdf.xacro").read_text()
    start = text.index('<joint name="rocker_pin"')
    joint = text[start:].replace('"continuous">', '"revolute">\n    <limit lower="${$(arg low)}" '
                                 'upper="${$(arg high)}" effort="1" velocity="1"/>', 1)
    arguments = '<xacro:arg name="low" default="-3"/><xacro:arg name="high" default="3"/>\n'
    first = text.index("<xacro:arg")
    (folder / "four_bar.urdf.xacro").write_text(
        text[:first] + arguments + text[first:start] + joint)
    return lambda low, high, **more: sp.load(folder / "four_bar.toml", low=low, high=high, **more)


def ends(design=None, a=0.10, b=0.28, c=0.24, d=0.30):
    """Return the rocker's least and largest angle."""
    if design is not None:
        a, b, c = (design.dimensions.get(name, x) for name, x in
                   (("r2", a), ("r3", b), ("r4", c)))
    inner = [np.arccos((c * c + d * d - x * x) / (2.0 * c * d)) for x in (b + a, b - a)]
    return np.pi - inner[0], np.pi - inner[1]


def at(mechanism, *cranks):
    return [sp.assemble(mechanism, {"crank": crank}) for crank in cranks]


def of_limits(found):
    return [defect for defect in found if defect.kind == "joint limit"]


def rocker(state):
    return state.coordinate("rocker_pin").value


# ---------------------------------------------------------------- named


def test_no_limit_that_is_kept_is_named(limited):
    least, most = ends()
    mechanism = limited(least - 1e-6, most + 1e-6)
    assert defects(mechanism, at(mechanism, 0.5, 3.0), cyclic=True) == ()


def test_a_limit_that_is_passed_on_the_way_is_named_with_where_and_how_far(limited):
    """Both samples are within it; the rocker turns back between them."""
    _, most = ends()
    mechanism = limited(1.0, most - 0.01)
    free = sp.load("four_bar")
    turn = sp.sweep(free, "crank", np.linspace(0.0, 2.0 * np.pi, 3601))
    highest = turn.driver[np.argmax(turn.coordinate("rocker_pin").value)]
    states = at(mechanism, highest - 0.8, highest + 0.8)
    assert not any(state.beyond_limits for state in states)
    (found,) = of_limits(defects(mechanism, states))
    assert found.samples == (0, 1)
    assert f"upper limit {most - 0.01:.9g} rad of rocker_pin is passed at crank = " in found.text
    assert ", by up to 0.01 rad" in found.text
    where = float(found.text.partition("crank = ")[2].partition(" ")[0])
    assert rocker(sp.assemble(free, {"crank": where})) == pytest.approx(most - 0.01, abs=1e-10)


def test_a_limit_that_is_passed_elsewhere_counts_where_the_driver_goes_all_the_way_round(limited):
    _, most = ends()
    mechanism = limited(1.0, most - 0.01)
    free = sp.load("four_bar")
    low = [x for x in np.linspace(0.0, 6.0, 25)
           if rocker(sp.assemble(free, {"crank": x})) < most - 0.3]
    states = at(mechanism, low[0], low[1])
    assert not of_limits(defects(mechanism, states))
    assert len(of_limits(defects(mechanism, states, cyclic=True))) == 1


def test_samples_beyond_a_limit_are_named(limited):
    angles = [rocker(state) for state in at(sp.load("four_bar"), 0.5, 2.0)]
    mechanism = limited(0.1, 0.5 * sum(angles))
    with pytest.warns(sp.SpatialPinWarning, match="beyond joint limits"):
        states = at(mechanism, 0.5, 2.0)
    beyond = int(np.argmax(angles))
    (found,) = of_limits(defects(mechanism, states))
    assert found.samples == (beyond,)
    assert found.text.startswith(f"sample {beyond} is beyond the upper limit")


def test_motions_of_demands_pass_limits_too(limited):
    mechanism = limited(0.0, 1.9)
    best = sp.design(mechanism, [goals.swing("rocker_pin", 1.0), goals.turns()], BOUNDS,
                     starts=1)[0]
    assert max(ends(best)) > 1.9
    (found,) = of_limits(best.defects)  # both goals are about one motion: it is told once
    assert found.text.startswith("swing of rocker_pin: the upper limit 1.9 rad of rocker_pin")
    assert "joint limit: swing of rocker_pin" in str(best)


# ---------------------------------------------------------------- whole turns


def test_a_joint_that_stands_a_turn_away_is_not_beyond_its_limit(limited):
    mechanism = limited(0.0, 3.0)
    state = sp.assemble(mechanism, {"crank": 1.0})
    place, q = mechanism.coordinate("rocker_pin").q, state.q.copy()
    for turns in (-2, -1, 1):
        q[place] = state.q[place] + 2.0 * np.pi * turns
        np.testing.assert_allclose(in_own_turn(mechanism, q), state.q, atol=1e-14)
        assert in_own_turn(mechanism, q, ["rocker_pin"])[place] == q[place]


def test_drawn_starts_lead_to_joints_within_their_limits(limited):
    """Drawn configurations are up to half a turn away."""
    phi, psi = np.radians([40.0, 85.0, 130.0]), np.radians([80.0, 100.0, 130.0])
    found = sp.design(limited(-0.5, 3.0), goals.function("rocker_pin", psi, {"crank": phi}),
                      BOUNDS, starts=8)
    assert len(found)
    for design in found:
        assert not any(state.beyond_limits for state in design.states)


# ---------------------------------------------------------------- kept


def test_limits_are_kept_where_that_is_asked(limited):
    mechanism = limited(0.0, 1.9)
    best = sp.design(mechanism, [goals.swing("rocker_pin", 1.0), goals.turns(),
                                 goals.joint_limits()], BOUNDS, starts=1)[0]
    assert max(ends(best)) <= 1.9 + 1e-9
    assert np.ptp(ends(best)) == pytest.approx(1.0, abs=1e-9)
    assert not of_limits(best.defects) and "joint limits: met" in str(best)


def test_how_far_joints_are_beyond_is_the_number_of_the_demand(limited):
    least, most = ends()
    mechanism = limited(least + 0.02, most - 0.01)
    asked = goals.joint_limits()
    state = sp.assemble(mechanism, {"crank": 1.3}, limits=False)
    values = asked.values(Candidate(mechanism, (state,))).reshape(2, -1)
    assert values.max(axis=1) == pytest.approx([0.02, 0.01], abs=1e-10)
    assert asked.unit_of(mechanism) == "rad"


def test_limits_where_there_are_none_are_refused():
    with pytest.raises(ValueError, match="joint limits: no joint of mechanism 'four_bar' has any"):
        sp.design(sp.load("four_bar"), goals.joint_limits(), BOUNDS)
