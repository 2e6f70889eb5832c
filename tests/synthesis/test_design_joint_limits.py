"""Joint limits of the URDF in designs: named where a motion passes them, kept where that is asked.

The mechanism is the library's four-bar, whose rocker has limits. Its least and its largest angle
are where crank and coupler are folded and stretched, by the law of cosines.
"""

import numpy as np
import pytest
from crank_rockers import ends, limited_four_bar, of_limits

import spatial_pin as sp

goals = sp.goals
BOUNDS = {"r2": (0.02, 0.3), "r3": (0.05, 0.6), "r4": (0.05, 0.6)}


@pytest.fixture(scope="module")
def limited(tmp_path_factory):
    """Return what loads the four-bar with limits of its rocker."""
    return limited_four_bar(tmp_path_factory.mktemp("limited"))


# ---------------------------------------------------------------- named


@pytest.mark.slow
def test_motions_of_demands_pass_limits_too(limited):
    mechanism = limited(0.0, 1.9)
    best = sp.design(mechanism, [goals.swing("rocker_pin", 1.0), goals.turns()], BOUNDS,
                     starts=1)[0]
    assert max(ends(best)) > 1.9
    (found,) = of_limits(best.defects)  # both goals are about one motion: it is told once
    assert found.text.startswith("swing of rocker_pin: the upper limit 1.9 rad of rocker_pin")
    assert "joint limit: swing of rocker_pin" in str(best)


# ---------------------------------------------------------------- whole turns


def test_drawn_starts_lead_to_joints_within_their_limits(limited):
    """Drawn configurations are up to half a turn away."""
    phi, psi = np.radians([40.0, 85.0, 130.0]), np.radians([80.0, 100.0, 130.0])
    found = sp.design(limited(-0.5, 3.0), goals.function("rocker_pin", psi, {"crank": phi}),
                      BOUNDS, starts=4)
    assert len(found)
    for design in found:
        assert not any(state.beyond_limits for state in design.states)


# ---------------------------------------------------------------- kept


@pytest.mark.slow
def test_limits_are_kept_where_that_is_requested(limited):
    mechanism = limited(0.0, 1.9)
    best = sp.design(mechanism, [goals.swing("rocker_pin", 1.0), goals.turns(),
                                 goals.joint_limits()], BOUNDS, starts=1)[0]
    assert max(ends(best)) <= 1.9 + 1e-9
    assert np.ptp(ends(best)) == pytest.approx(1.0, abs=1e-9)
    assert not of_limits(best.defects) and "joint limits: met" in str(best)


def test_limits_where_there_are_none_are_refused():
    with pytest.raises(ValueError, match="joint limits: no joint of mechanism 'four_bar' has any"):
        sp.design(sp.load("four_bar"), goals.joint_limits(), BOUNDS)
