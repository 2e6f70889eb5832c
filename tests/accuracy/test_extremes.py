"""Every row of the table of docs/extremes.md, as `scripts/extremes.py` has them."""

import importlib.util
import xml.etree.ElementTree as ET
from pathlib import Path

import mechanisms as known
import numpy as np
import pytest
from folders import ROOT
from masses import energy_rate, heavy, two_rods

import spatial_pin as sp

SCRIPT = ROOT / "scripts" / "extremes.py"
SPEC = importlib.util.spec_from_file_location("extremes", SCRIPT)
extremes = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(extremes)

LONG = ("200 hinges", "seven mechanisms", "million steps", "hundred thousand steps",
        "1e-3 to 1e-100 m", "Bennett's loop", "one more turn", "four-bar falling")
ROWS = [pytest.param(row, id=f"{row.name}: {row.tried}".replace(" ", "_"),
                     marks=pytest.mark.slow if any(x in row.tried for x in LONG) else ())
        for row in extremes.EXTREMES]


@pytest.mark.alike
@pytest.mark.parametrize("row", ROWS)
def test_row_of_the_table(row):
    found = extremes.measure(row)
    assert extremes.holds(row, found), f"{row.name}, {row.tried}: {found}"


def test_a_four_bar_closed_by_thirty_hinges_moves_as_one_closed_by_one():
    assert extremes.repeated(30) < 1e-12


@pytest.mark.parametrize("mass", [1e-200, 1e-24, 1e-16, 1e-3, 1e30, 1e150])
def test_inertias_scale_with_the_mass(mass):
    """Pinocchio's own sums are wrong below 2.2e-16 kg and above 1e154 kg."""
    light, usual = two_rods(mass), two_rods(1.0)
    for own, other in zip(light.model.inertias, usual.model.inertias, strict=True):
        np.testing.assert_allclose(own.mass, mass * other.mass, rtol=1e-15)
        np.testing.assert_allclose(own.lever, other.lever, rtol=1e-15, atol=1e-15)
        np.testing.assert_allclose(own.inertia, mass * other.inertia, rtol=1e-14, atol=0.0)


@pytest.mark.parametrize("mass", [1e-24, 1e-16, 1e-3])
def test_derivatives_do_not_depend_on_the_unit_of_mass(mass):
    light, usual = ([m, sp.assemble(m, {"p": 0.3, "k": 0.7})] for m in (
        two_rods(mass), two_rods(1.0)))
    own, other = sp.dynamics_derivatives(*light), sp.dynamics_derivatives(*usual)
    np.testing.assert_allclose(own.a_by_q, other.a_by_q, rtol=1e-10)
    np.testing.assert_allclose(mass * own.a_by_effort, other.a_by_effort, rtol=1e-10)


@pytest.mark.parametrize("formulation", ["independent", "projected"])
def test_a_nanometre_double_pendulum_swings_as_a_large_one(formulation):
    ends = []
    for size, mass in ((1.0, 1.0), (1e-9, 1e-24)):
        mech = two_rods(mass, size)
        motion = sp.simulate(mech, sp.assemble(mech, {"p": 0.3, "k": 0.7}), 0.3 * np.sqrt(size),
                             accuracy=sp.Accuracy(formulation=formulation))
        ends.append(motion.q[-1])
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-8)


def test_a_link_without_mass_stays_as_it_is_beside_light_and_heavy_ones():
    """No threshold takes a light body for one without inertia, nor the other way round."""
    tree = "".join(known.turning(name, "ground", link, axis=(0, 1, 0)) for name, link in (
        ("p", "base"), ("light", "feather"), ("idle", "pointer")))
    tree = heavy(tree, base=(1.0, (1.0, 0, 0)), feather=(1e-20, (1.0, 0, 0)))
    mech = known.from_tree("three", tree, gravity=[0.0, 0.0, -10.0])
    state = sp.assemble(mech, {"p": 0.0, "light": 0.0, "idle": 0.0})
    moved = sp.forward_dynamics(mech, state).state
    found = [moved.coordinate(name).acceleration for name in ("p", "light", "idle")]
    np.testing.assert_allclose(found, [10.0, 10.0, 0.0], rtol=1e-12)
    with pytest.raises(sp.SingularError, match="idle has no inertia"):
        sp.forward_dynamics(mech, state, {"idle": 1e-6})
    with pytest.raises(sp.SingularError, match="no derivatives there"):
        sp.dynamics_derivatives(mech, state)


@pytest.mark.parametrize("angle", [0.3, 1.0, 2.0, 4.0])
def test_a_massless_coupler_spins_about_its_axis_for_nothing(angle, tmp_path):
    """The spin moves the other bodies by round-off only: that is no inertia, and no force on it."""
    mech = without_mass(tmp_path, "coupler")
    state = sp.solve_rates(mech, sp.assemble(mech, {"crank": angle}), {"crank": 2.0})
    answer = sp.forward_dynamics(mech, state)
    assert energy_rate(answer.state) == pytest.approx(0.0, abs=1e-13 * np.abs(answer.a).max())
    assert np.abs(answer.a).max() < 1e4
    assert answer.error < 1e-10


def without_mass(folder: Path, link: str) -> sp.Mechanism:
    """Return the library's RSSR with a link that has no mass."""
    whole = sp.load("rssr")
    robot = ET.fromstring(whole.urdf)
    found = next(x for x in robot.findall("link") if x.get("name") == link)
    found.remove(found.find("inertial"))
    (folder / "light.urdf").write_text(ET.tostring(robot, encoding="unicode"))
    text = whole.path.read_text(encoding="utf-8")
    (folder / "light.toml").write_text(text.replace("rssr.urdf.xacro", "light.urdf"))
    return sp.load(folder / "light.toml")


def test_derivatives_of_light_bodies_beside_heavy_ones():
    tree = "".join(known.turning(name, "ground", f"{name}_rod", axis=(0, 1, 0))
                   for name in ("p", "light"))
    tree = heavy(tree, p_rod=(1e6, (1.0, 0, 0)), light_rod=(1e-20, (1.0, 0, 0)))
    mech = known.from_tree("two", tree, gravity=[0.0, 0.0, -10.0])
    found = sp.dynamics_derivatives(mech, sp.assemble(mech, {"p": 0.5, "light": 0.5}))
    np.testing.assert_allclose(found.a_by_q, -10.0 * np.sin(0.5) * np.eye(2), rtol=1e-12)
    np.testing.assert_allclose(found.a_by_effort, np.diag([1e20, 1e-6]), rtol=1e-12)


# ---------------------------------------------------------------- the error that is told


@pytest.mark.parametrize("masses", [
    (1, 1, 1), (1e-20, 1e-20, 1e-20), (1e-2, 1, 1e-2), (1, 1e-2, 1), (1e-4, 1, 1), (1, 1e6, 1),
    (1e-8, 1, 1e-8), (1e-24, 1e-12, 1e-24)])
def test_accelerations_are_as_exact_as_they_tell(masses):
    mech = extremes.plane_four_bar(masses)
    state = sp.solve_rates(mech, sp.assemble(mech, {"crank": 1.0}), {"crank": 2.0})
    answer = sp.forward_dynamics(mech, state)
    with extremes.mp.workdps(extremes.DIGITS):
        want = extremes.exact_four_bar(masses, 1.0, 1.0, 2.0, 0.0)[0]
        assert extremes.relative(answer.a, want) <= answer.error < 1e-8


@pytest.mark.parametrize("away", [0.0, 100.0, 1024.0])
def test_it_loses_digits_far_from_the_origin_of_the_world(away):
    mech = extremes.plane_four_bar(away=away)
    state = sp.solve_rates(mech, sp.assemble(mech, {"crank": 1.0}), {"crank": 2.0})
    answer = sp.forward_dynamics(mech, state)
    with extremes.mp.workdps(extremes.DIGITS):
        want = extremes.exact_four_bar((1, 1, 1), 1.0, 1.0, 2.0, 0.0)[0]
        assert extremes.relative(answer.a, want) <= answer.error < 1e-10
