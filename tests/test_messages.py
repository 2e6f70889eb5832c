"""Messages: each tells the one cause that is true, by name and number, and what to do."""

import mechanisms as known
import pytest
from masses import heavy
from test_simulation_extremes import two_rods, uniform

import spatial_pin as sp

FORMULATIONS = ("independent", "projected")


def refusal(call, kind=sp.SpatialPinError):
    """Return the words of the error that a call raises."""
    with pytest.raises(kind) as caught:
        call()
    return str(caught.value)


# ---------------------------------------------------------------- where a simulation ends


CAUSES = ("lose rank", "masses differ", "grow without bound", "jumps")


def only(cause, text):
    assert [c for c in CAUSES if c in text] == [cause], text


def bead(folder):
    tree = heavy(known.sliding("s", "ground", "bead", axis=(1, 0, 0)), bead=uniform(1.0, 1.0))
    return known.load(folder, "bead", tree, "gravity = [0.0, 0.0, 0.0]\n")


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("law, until", [
    (lambda t, s: {"s": -1.0 / max(s.q[0] ** 2, 1e-300)}, "1.110720"),
    (lambda t, s: {"s": float(s.v[0]) ** 2}, "1 s"),
])
def test_a_force_without_bound_ends_the_motion_as_such(law, until, formulation, tmp_path):
    """A bead falls into a centre after pi/sqrt(8) s; one that speed drives is gone after 1 s."""
    mech = bead(tmp_path)
    speed = 0.0 if until.startswith("1.11") else 1.0
    state = sp.solve_rates(mech, sp.assemble(mech, {"s": 1.0}), {"s": speed})
    text = refusal(lambda: sp.simulate(mech, state, 3.0, efforts=law, accuracy=sp.Accuracy(
        formulation=formulation)), sp.SingularError)
    only("grow without bound", text)
    assert f"beyond {until}" in text and "s is accelerated by" in text and "N at s" in text


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_masses_that_differ_too_much_are_named(formulation, tmp_path):
    mech = two_rods(tmp_path, 1e20)
    text = refusal(lambda: sp.simulate(
        mech, sp.assemble(mech, {"p": 0.3, "k": 0.7}), 0.8,
        accuracy=sp.Accuracy(formulation=formulation)), sp.SingularError)
    only("masses differ", text)
    assert "1 kg (moved by joint 'p')" in text and "1e+20 kg (moved by joint 'k')" in text


@pytest.mark.parametrize("name, formulation", [
    ("delta", "independent"), ("stewart", "independent"), ("stewart", "projected")])
def test_loops_that_lose_rank_end_the_motion_as_such(name, formulation):
    mech = sp.load(name)
    text = refusal(lambda: sp.simulate(mech, sp.assemble(mech), 2.0, accuracy=sp.Accuracy(
        formulation=formulation)), sp.SingularError)
    only("lose rank", text)
    assert "smallest singular value has fallen from" in text and "sp.mobility" in text


def test_a_prescribed_coordinate_ends_at_its_limit_position():
    """The rocker of a four-bar turns back; nothing is wrong with masses or forces there."""
    mech = sp.load("four_bar")
    state = sp.solve_rates(mech, sp.assemble(mech, {"crank": 1.0}), {"rocker_pin": 1.0})
    law = sp.laws.constant_speed(state.coordinate("rocker_pin").value, 1.0)
    text = refusal(lambda: sp.simulate(mech, state, 3.0, drives={"rocker_pin": law}),
                   sp.SingularError)
    only("lose rank", text)
    assert "limit position of the prescribed rocker_pin" in text
