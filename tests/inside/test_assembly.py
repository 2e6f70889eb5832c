"""Inside of assembly: what is looked at to close loops, and what is not."""

from __future__ import annotations

from pathlib import Path

import published_models as models
from rods_of_hinges import rssr

import spatial_pin as sp
from spatial_pin.assembly import redundant_equations as rounding
from spatial_pin.assembly.passive_freedoms import massless_inner_links


def test_loops_that_are_clearly_independent_need_no_singular_values(monkeypatch):
    """Whose cost grows with the cube of the number of loops."""
    def refused(rows):
        raise AssertionError("singular values were asked for")

    monkeypatch.setattr(rounding, "singular_values", refused)
    mechanism = models.ladder(60)
    first = sp.assemble(mechanism, {"pin_0": 0.3})
    assert sp.assemble(mechanism, {"pin_0": 0.4}, first).closure_error < 1e-13


def test_what_links_are_inside_chains(tmp_path: Path) -> None:
    mechanism = rssr(tmp_path, True, 3, 2)
    names = {mechanism.model.names[i] for i in massless_inner_links(mechanism)}
    assert names == {"ball_a_turn0", "ball_a_turn1", "ball_b_turn0"}
    assert not massless_inner_links(sp.load("spherical_four_bar"))
    assert not massless_inner_links(sp.load("double_cardan"))
