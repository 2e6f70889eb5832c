"""Inside of assembly: what is looked at to close loops, and what is not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from loaded_library import library
from rods_of_hinges import rssr

import spatial_pin as sp
from spatial_pin.accuracy import models
from spatial_pin.assembly import rounding
from spatial_pin.assembly.passive_freedoms import chain_links


def test_loops_that_are_clearly_independent_need_no_singular_values(monkeypatch):
    """Whose cost grows with the cube of the number of loops."""
    def refused(rows):
        raise AssertionError("singular values were asked for")

    monkeypatch.setattr(rounding, "singular_values", refused)
    mechanism = models.ladder(60)
    first = sp.assemble(mechanism, {"pin_0": 0.3})
    assert sp.assemble(mechanism, {"pin_0": 0.4}, first).closure_error < 1e-13


def test_small_singular_values_are_found_where_rows_are_not_clearly_independent():
    rows = np.eye(6)[[0, 1, 2, 3, 4, 2]]
    assert not rounding._nearly_depend(rows, 1e-5)
    for nearly, found in ((1e-12, False), (1e-7, True), (1e-3, False)):
        bent = rows.copy()
        bent[5, 5] = nearly
        assert rounding._nearly_depend(bent, 1e-5) is found


def test_what_links_are_inside_chains(tmp_path: Path) -> None:
    mechanism = rssr(tmp_path, True, 3, 2)
    names = {mechanism.model.names[i] for i in chain_links(mechanism)}
    assert names == {"ball_a_turn0", "ball_a_turn1", "ball_b_turn0"}
    assert not chain_links(library("spherical_four_bar"))
    assert not chain_links(library("double_cardan"))
