"""Attributes that have a better name now are still read by their old one, with a warning."""

import pytest

import spatial_pin as sp


def test_a_coordinate_has_its_component_by_its_old_name_too():
    mech = sp.load("rssr")
    with pytest.warns(DeprecationWarning, match="Coordinate.place is now Coordinate.component"):
        assert mech.coordinate("ball_a.y").place == mech.coordinate("ball_a.y").component == 1


def test_a_mechanism_has_its_selected_equations_by_their_old_name_too():
    mech = sp.load("rssr")
    with pytest.warns(DeprecationWarning, match="Mechanism.kept is now Mechanism.selection"):
        assert mech.kept is mech.selection


def test_a_measured_setting_has_its_note_by_its_old_name_too():
    row = sp.tradeoff(sp.load("four_bar"), {"driver": "crank", "values": [0.0, 0.1]},
                      settings=[sp.Accuracy()], repeats=1).rows[0]
    with pytest.warns(DeprecationWarning, match="Measured.said is now Measured.note"):
        assert row.said == row.note


def test_a_look_takes_and_has_its_ghosts_side_by_side_by_the_old_name_too():
    with pytest.warns(DeprecationWarning, match="Look: beside is now side_by_side"):
        look = sp.Look(beside=True)
    with pytest.warns(DeprecationWarning, match="Look.beside is now Look.side_by_side"):
        assert look.beside is look.side_by_side is True
    assert look == sp.Look(side_by_side=True)
