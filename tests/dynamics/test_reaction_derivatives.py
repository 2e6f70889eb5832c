"""Derivatives of reactions, with laws of springs and forces from outside, against differences.

The differences are of eighth order; what a derivative is compared by is the larger of its own
size and that of the reactions.
"""

from __future__ import annotations

import mechanisms as known
import numpy as np
import pinocchio as pin
import pytest
from closure_trees import JOINTS, TYPES, tree_with
from derivative_cases import (
    NAMES,
    REGULAR,
    WEIGHT,
    check,
    difference,
    flat_derivative,
    moving,
    some,
)
from masses import heavy, with_masses
from variety import few

import spatial_pin as sp

LAWS = {"stiffening": lambda x, rate: 30 * x**3 + 2 * np.sin(rate) * x,
        "one-sided": lambda x, rate: max(0.0, x - 0.05) ** 1.5 * (40 + np.tanh(rate))}


def some_efforts(mech):
    table = mech.coordinate_table.values()
    return {c.name: 0.4 for c in list(table)[:3] if c.q >= 0}


@pytest.mark.parametrize("build", some(), ids=NAMES)
def test_every_force_and_reaction(build, tmp_path):
    mech = build(tmp_path)
    h = 3e-4 if mech.name == "rssr" else 3e-3  # near a limit position higher orders are large
    check(mech, moving(mech), some_efforts(mech), h, 1e-11 if h > 1e-3 else 1e-10,
          external=pushed(mech), laws={s.name: LAWS["stiffening"] for s in mech.springs})


def test_a_one_sided_law_away_from_its_kink(tmp_path):
    mech = REGULAR[NAMES.index("sprung")](tmp_path)
    check(mech, moving(mech), some_efforts(mech), 3e-3, 1e-11, external=pushed(mech),
          laws={s.name: LAWS["one-sided"] for s in mech.springs})


def pushed(mech):
    """Any wrenches on the last two links."""
    rng = np.random.default_rng(3)
    return {link: pin.Force(rng.normal(size=6)) for link in list(mech.links)[-2:]}


def heavy_tree(folder, joint, kind, seed=1):
    """A tree of one kind of joints, with masses, a spring, and one closure between two bodies."""
    mech, rng = tree_with(folder, joint, ("leaf", "right"), kind, seed)
    toml = '[[springs]]\nname = "s"\nframes = ["trunk", "at_right"]\nstiffness = 7.0\n'
    mech = with_masses(mech, folder, toml + "free_length = 0.1\ndamping = 0.3\n",
                       **dict.fromkeys(("trunk", "left", "leaf", "right"), WEIGHT))
    n = mech.model.nv
    q = pin.integrate(mech.model, mech.neutral, rng.uniform(-0.7, 0.7, n))
    angles = np.zeros(1 if kind == "screw" else 0)
    return mech, sp.State(mech, q, rng.uniform(-1, 1, n), closure_error=0.0, angles=angles)


@pytest.mark.parametrize("kind", few(
    TYPES, "revolute", "spherical", "screw", "distance", "point_on_line"))
def test_every_closure(kind, tmp_path):
    mech, state = heavy_tree(tmp_path, "floating", kind)
    # the rows of a frame on a curve bend more: their differences converge from a shorter step on
    check(mech, state, {}, 1e-3 if kind == "frame_on_curve" else 3e-3, 1e-10)


@pytest.mark.parametrize("joint", [j for j in JOINTS if j != "floating"])
def test_every_joint(joint, tmp_path):
    mech, state = heavy_tree(tmp_path, joint, "distance")
    check(mech, state, some_efforts(mech), 3e-3, 1e-10)


def test_couplings_and_their_efforts(tmp_path):
    mech = with_masses(known.rack_and_gears(tmp_path), tmp_path, g1=WEIGHT, g2=WEIGHT, r=WEIGHT)
    state = moving(mech)
    check(mech, state, some_efforts(mech), 3e-3, 1e-11)


# ---------------------------------------------------------------- overconstrained loops


def swinging(folder):
    """A plane four-bar in space, and a pendulum on its rocker."""
    swing = heavy(known.turning("swing", "rocker", "bob", (0.1, 0, 0)), bob=WEIGHT)
    mech = known.bare_four_bar(folder, 0.3, 0.1, 0.35, 0.25)
    mech = with_masses(mech, folder, **dict.fromkeys(("crank", "coupler", "rocker"), WEIGHT))
    tree = (folder / f"{mech.name}.urdf").read_text(encoding="utf-8")
    (folder / f"{mech.name}.urdf").write_text(tree.replace("</robot>", swing + "</robot>"),
                                              encoding="utf-8")
    return sp.load(folder / f"{mech.name}.toml")


def test_what_is_one_of_many_has_no_derivative_and_the_rest_has(tmp_path):
    """Along the closed motion: the pendulum's pin and the shaking force are unique."""
    mech = swinging(tmp_path)
    driver = next(iter(mech.drivers), "crank_pin")
    at = mech.coordinate(driver)
    start = sp.assemble(mech, {driver: 0.9})
    kernel = np.linalg.svd(sp.closure_jacobian(mech, start.q))[2][-2:]
    v = kernel.T @ np.linalg.solve(kernel[:, [at.v, -1]].T, [0.7, 1.1])

    def moved(e):
        state = sp.assemble(mech, {driver: 0.9 + 0.7 * e, "swing": 1.1 * e}, guess=start)
        return sp.solve_rates(mech, state, {driver: 0.7, "swing": 1.1})

    state = moved(0.0)
    assert state.v == pytest.approx(v, abs=1e-9)
    found = sp.dynamics_derivatives(mech, state)
    for name, reaction in found.reactions.items():
        if name != "swing":
            assert all(np.isnan(x).all() for x in reaction)
    for pick, got in ((lambda f: f.reactions["swing"].vector, found.reactions["swing"]),
                      (lambda f: f.on_ground.vector, found.on_ground)):
        want = difference(lambda e, pick=pick: pick(sp.forward_dynamics(mech, moved(e))), 5e-3)
        along = got.by_q @ state.v + got.by_v @ state.a
        assert along == pytest.approx(want, abs=1e-9 * np.abs(want).max())


# ---------------------------------------------------------------- laws


def test_slopes_of_laws_may_be_given(tmp_path):
    mech = REGULAR[NAMES.index("sprung")](tmp_path)
    state = moving(mech)
    laws = {"a": lambda x, rate: 5 * x**2 + rate**3, "b": lambda x, rate: np.sin(3 * x) + rate}
    slopes = {"a": lambda x, rate: (10 * x, 3 * rate**2),
              "b": lambda x, rate: (3 * np.cos(3 * x), 1.0)}
    given = sp.dynamics_derivatives(mech, state, laws=laws, slopes=slopes)
    found = sp.dynamics_derivatives(mech, state, laws=laws)
    for part in ("by_q", "by_v"):
        exact = flat_derivative(given, part)
        assert flat_derivative(found, part) == pytest.approx(exact,
                                                             abs=1e-11 * np.abs(exact).max())
    with pytest.raises(sp.SpatialPinError, match="spring with a law"):
        sp.dynamics_derivatives(mech, state, laws={}, slopes=slopes)
