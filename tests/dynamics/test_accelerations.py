"""The ladder of accelerations: the KKT system, the least constraint, a refusal."""

from __future__ import annotations

import mechanisms as known
import numpy as np
import pytest
from ladders import ladder, leaning, moving, uniform
from masses import heavy

import spatial_pin as sp

# ---------------------------------------------------------------- where it loses digits


def test_a_singular_configuration_after_a_regular_one_is_refused(tmp_path):
    mech = ladder(tmp_path, 2)
    for _ in range(2):
        sp.forward_dynamics(mech, leaning(mech, 0.7, 1.3)[0])
        with pytest.raises(sp.SingularError, match="lose 2 independent"):
            sp.forward_dynamics(mech, leaning(mech, np.pi / 2, 1.3)[0])


def test_rows_too_many_and_a_resolved_spin(tmp_path):
    """Both together: the ball joint has a point on a line besides."""
    mech = sp.load("rssr")
    toml = mech.path.read_text(encoding="utf-8")
    assert "[passive" in toml
    for file in (mech.tree, mech.tree.parent / "parts.xacro"):
        (tmp_path / file.name).write_text(file.read_text(encoding="utf-8"), encoding="utf-8")
    closures = toml.index("[[closures]]")
    again = '[[closures]]\nname = "again"\ntype = "point_on_line"\n' + next(
        line for line in toml[closures:].splitlines() if line.startswith("frames")) + "\n"
    path = tmp_path / "rssr.toml"
    path.write_text(toml[:closures] + again + toml[closures:], encoding="utf-8")
    doubled = sp.load(path)
    for _ in range(2):
        assert sp.forward_dynamics(doubled, moving(doubled)).a == pytest.approx(
            sp.forward_dynamics(mech, moving(mech)).a, rel=1e-9)


def test_what_round_off_leaves_of_an_equation_that_vanishes_holds_nothing(tmp_path):
    """A crank at the top of its circle, its tip on a plane it touches there; a second one hangs.

    The equation's derivative is cos(pi/2) = 6e-17: scaled up to one it would stop the crank.
    """
    tree = heavy(known.turning("a", "ground", "crank") + known.point("tip", "crank", (1, 0, 0))
                 + known.point("top", "ground", (0, 1, 0), (-np.pi / 2, 0, 0))
                 + known.turning("b", "ground", "other", (3, 0, 0)),
                 crank=uniform(1.0, 1.0), other=uniform(1.0, 1.0))
    mech = known.load(tmp_path, "touching", tree,
                      known.closure("plane", "point_on_plane", "top", "tip"))
    state = sp.State(mech, np.array([np.pi / 2, 0.3]), np.array([1.0, 0.0]), closure_error=0.0)
    with pytest.raises(sp.SingularError, match="lose 1 independent equation"):
        sp.forward_dynamics(mech, state)
