"""Starts from an atlas of curves: published paths of free timing are met better than before."""


import numpy as np
import pytest
import synthesis_forms as forms
from drawing_four_bars import bar, side

import spatial_pin as sp

goals = sp.goals


@pytest.mark.slow
@pytest.mark.parametrize(("name", "seed"), [("twelve", 0), ("figure_eight", 0)])
def test_closed_paths_of_free_timing_are_met_better_than_published(problems, name, seed):
    case = forms.CASES[name]
    best = problems[name].solve(starts=8, seed=seed)[0]
    error = forms.free_error(bar(best), case["points"], side(best))  # by closed form
    assert error <= problems[name].error(best) * (1.0 + 1e-6)
    assert error < 0.75 * case["error"]
    assert not [x for x in best.defects if x.kind in ("circuit", "branch", "order")]


# ---------------------------------------------------------------- small atlases


def four_bar(**dimensions):
    return sp.load(forms.SYNTHESIS / "four_bar_path.toml", **dimensions)


# ---------------------------------------------------------------- what it is not for


@pytest.mark.parametrize(("asked", "mechanism", "says"), [
    (goals.turns(), four_bar, "one path of free timing through 4 points or more; there are 0"),
    (goals.path("tracer", np.eye(3)), four_bar, "there are 0"),
    (goals.path("tracer", np.ones((5, 3))), four_bar, "its points are all at one place"),
    (goals.path("tracer", np.eye(5, 3), {"crank": np.arange(5.0)}), four_bar,
     "there are 0"),
    (goals.path("platform", np.eye(5, 3)), lambda: sp.load("delta"),
     "needs one driver that turns; mechanism 'delta' has"),
])
def test_other_goals_are_refused_before_the_work(asked, mechanism, says):
    there = mechanism()
    with pytest.raises(ValueError) as told:
        sp.design(there, asked, list(there.dimensions)[:1], method="atlas")
    assert says in str(told.value)
