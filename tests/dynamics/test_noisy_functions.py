"""Simulations that end by functions which have another sign whenever they are asked."""

from itertools import chain, repeat

import pytest

import spatial_pin as sp


@pytest.mark.parametrize("signs", ["+--", "+-++", "++-", "-", "-+"])
def test_a_simulation_ends_where_the_sign_of_a_function_has_changed_whatever_it_is_later(signs):
    """Computed from configurations that are closed anew, a small number is round-off."""
    mech = sp.load("four_bar")
    state, later = sp.assemble(mech, {"crank": 1.0}), chain(signs, repeat(signs[-1]))
    has_changed = False

    def function(t, at):
        nonlocal has_changed
        if has_changed:
            return float(next(later) + "1e-17")
        has_changed = at.coordinate("crank").value < 0.9
        return -1e-17 if has_changed else 1e-17

    motion = sp.simulate(mech, state, 0.5, stop_when=function)
    assert motion.events[-1].kind == "stopped"
    assert 0.85 < motion.coordinate("crank").value[-1] < 0.95


def test_a_simulation_ends_at_the_change_of_sign_of_a_function_of_any_size():
    """A product of two values of it would be zero."""
    mech = sp.load("four_bar")
    motion = sp.simulate(mech, sp.assemble(mech, {"crank": 1.0}), 0.2,
                         stop_when=lambda t, at: 1e-250 * (t - 0.1))
    assert motion.time[-1] == pytest.approx(0.1, abs=1e-12)
