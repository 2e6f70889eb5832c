"""Published benchmarks: `CASES` at their ends, and row by row against the data in `data/`."""


import numpy as np
import pytest
from folders import DATA
from published_cases import CASES, on_pair, run
from variety import few

import spatial_pin as sp

SLOW = {"ladder_20", "ladder_40", "governor"}
LENGTH = 1e-12  # closure error [-]

BY_DATA = {  # case, columns of the data, what they are
    "pendulum": ("A01_simple_pendulum_exact", [1, 2], lambda s: s.frame("bob").position[:, :2]),
    "ladder_2": ("A02_N2_four_bar_exact", [1, 2], lambda s: np.column_stack(
        [-s.coordinate("pin_2").value, -s.coordinate("pin_2").rate])),
    "bricard": ("A04_bricard_P3", [1, 2, 3], lambda s: s.frame("p3").position),
    "governor": ("A05_flyball_K8e5_C4e4_w2pi", [1, 2, 3, 4], lambda s: np.column_stack(
        [s.coordinate("slide").value, s.coordinate("left_pin").value,
         s.coordinate("shaft_pin").value, s.coordinate("shaft_pin").rate])),
}
ADAMS = {
    "adams_revolute": ("Revolute_Case01", "pair"),
    "adams_spherical": ("Spherical_Case02", "pair"),
    "adams_cylindrical": ("Cylindrical_Case02", "pair"),
    "adams_prismatic": ("Prismatic_Case02", "pair"),
    "adams_distance": ("Distance_Case01", "pair"),
    "adams_revolute_spherical": ("RevSpherical_Case01", "pin"),
}
QUANTITIES = {"position": "Pos", "velocity": "Vel", "acceleration": "Acc", "spin": "Avel",
              "force": "Rforce"}
OF_ADAMS = {"position": 2e-5, "velocity": 5e-5, "acceleration": 2e-4, "spin": 5e-5, "force": 2e-4}


@pytest.fixture(scope="module")
def outcomes():
    """Each case is simulated once."""
    found = {}

    def of(name):
        if name not in found:
            found[name] = run(CASES[name])
        return found[name]

    return of


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow) if n in SLOW else n
                                  for n in CASES])
def test_a_case_ends_as_published(name, outcomes):
    case, outcome = CASES[name], outcomes(name)
    assert outcome.error < case.accuracy, outcome
    assert outcome.closure_error < LENGTH, outcome
    # stiff dampers; noise of the table near change points grows with the number of loops
    drift = {"governor": 1e-8, "ladder_40": 1e-9}.get(name, 1e-10)
    assert outcome.energy_drift < drift, outcome
    assert str(outcome).startswith("error ")


@pytest.mark.parametrize("name", few(BY_DATA, "pendulum", "ladder_2", "bricard"))
def test_every_tenth_of_a_second(name, outcomes):
    file, columns, read = BY_DATA[name]
    want = np.loadtxt(DATA / "iftomm" / f"{file}.csv", delimiter=",")[:, columns]
    assert np.abs(read(outcomes(name).simulation)[::10] - want).max() < 1e-8


@pytest.mark.parametrize("name", ADAMS)
def test_every_tenth_row_of_adams(name, outcomes):
    """By the largest value of each quantity; ADAMS is no more exact than this."""
    file, pair = ADAMS[name]
    mech = outcomes(name).simulation.mechanism
    motion = sp.simulate(mech, CASES[name].begin(mech), 5.0, times=np.linspace(0.0, 5.0, 51))
    rows = [on_pair(pair, motion.state(k)) for k in range(51)]
    for quantity, ending in QUANTITIES.items():
        ending += "_Body1" * (name == "adams_revolute_spherical" and quantity == "force")
        path = DATA / "adams_joints" / f"{file}_ADAMS_{ending}.txt"
        want = np.loadtxt(path, skiprows=3)[::10, 1:]
        off = np.abs([row[quantity] for row in rows] - want).max() / max(1.0, np.abs(want).max())
        assert off < OF_ADAMS[quantity], quantity


def test_less_accuracy_costs_less_time_and_more_error():
    case = CASES["ladder_1"]
    coarse, fine = (run(case, sp.Accuracy.named(level)) for level in ("draft", "reference"))
    assert coarse.simulation.evaluations < 0.4 * fine.simulation.evaluations
    assert 100.0 * fine.error < coarse.error < 1e-2


def test_a_ladder_stays_on_its_branch_through_the_flat_configurations(outcomes):
    """Rods stay parallel, couplers level; each flat configuration is an event."""
    motion = outcomes("ladder_5").simulation
    angles = np.column_stack([motion.coordinate(f"pin_{i}").value for i in range(6)])
    assert np.ptp(angles, axis=1).max() < 1e-12
    assert np.abs(motion.frame("end_0").position[:, 1] - motion.frame("top_1").position[:, 1]
                  ).max() < 1e-13
    assert {event.kind for event in motion.events} == {"branch point"}
    assert len(motion.events) == int(abs(angles[-1, 0]) / np.pi + 0.5)
