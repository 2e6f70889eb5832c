"""Defects of linkages of the literature, against what is known of their circuits and branches.

Of a plane four-bar it is known which of its configurations are on one circuit and one branch: where
Grashof's condition holds, a crank that turns fully has two circuits, one on each side of the
diagonal, and one that does not has two for its angles above and below the ground link, of two
branches each; where it does not hold, there is one circuit of two branches [ChaseMirth1993].
Watt's second six-bar is two of them in a row: its output has two sides for each side of its first
loop, which dead centres of the second loop join.
"""

from math import acos, cos, hypot, pi, sin

import numpy as np
import pytest
import synthesis_forms as forms
from variety import few

import spatial_pin as sp
from spatial_pin.synthesis.defects import Circuit, defects

LINE = forms.CASES["line_of_five"]
GRAVE = ("circuit", "branch", "order")


def four_bar(bar: forms.FourBar):
    return sp.load(forms.SYNTHESIS / "four_bar_path.toml", **bar._asdict())


def states_of(mechanism, bar, crank, sides):
    """Return states at crank angles, on their sides of the diagonal."""
    found = []
    for phi, side in zip(crank, sides, strict=True):
        rest = bar.r1 - bar.r2 * np.exp(1j * phi)
        coupler = np.angle(rest) + side * np.arccos(
            (bar.r3**2 + abs(rest) ** 2 - bar.r4**2) / (2 * bar.r3 * abs(rest)))
        rocker = np.angle(bar.r3 * np.exp(1j * coupler) - rest)
        found.append(sp.assemble(mechanism, {"crank": phi}, guess={
            "crank_pin": phi, "coupler_pin": coupler - phi, "rocker_pin": rocker}))
    return found


def grave(found):
    return [x for x in found if x.kind in GRAVE]


# ---------------------------------------------------------------- five points on a line


def of_line(row):
    """Return the four-bar of a solution of [MorganWampler1990], its crank angles and sides."""
    (x1, y1, x2, y2), turns = row
    first, second = complex(x1, y1), complex(x2, y2)
    points = np.array(LINE["points"]) @ [1, 1j]
    turned = np.exp(1j * np.array([0.0, *turns]))
    tips, ends = points + turned * first, points + turned * second
    tracer = -first * np.exp(-1j * np.angle(second - first))
    bar = forms.FourBar(1.0, abs(tips[0]), abs(second - first), abs(ends[0] - 1.0),
                        tracer.real, tracer.imag, 0.0, 0.0, 0.0)
    sides = np.sign(((1.0 - tips).conj() * (ends - tips)).imag)
    return bar, np.angle(tips), sides


def parts(bar, crank, sides):
    """Return the circuit and the branch of each configuration, by Grashof's condition."""
    lengths = sorted((bar.r1, bar.r2, bar.r3, bar.r4))
    holds = lengths[0] + lengths[3] < lengths[1] + lengths[2]
    if not holds:
        return [(0, side) for side in sides]
    if lengths[0] in (bar.r1, bar.r2):
        return [(side, 0) for side in sides]
    return list(zip(np.sign(np.sin(crank)), sides, strict=True))


@pytest.mark.parametrize("k", few(range(LINE["real"]), 0, 1, 3, 8))
def test_defects_of_all_four_bars_through_five_points_are_those_of_their_sides(k):
    bar, crank, sides = of_line(LINE["exact"][k])
    mechanism = four_bar(bar)
    states = states_of(mechanism, bar, crank, sides)
    for state, point in zip(states, LINE["points"], strict=True):
        assert state.placement("tracer").translation[:2] == pytest.approx(point, abs=3e-3)
    truth = parts(bar, crank, sides)
    circuits = {circuit for circuit, _ in truth}
    branches = set(truth)
    kinds = [x.kind for x in defects(mechanism, states)]
    assert "not judged" not in kinds
    assert ("circuit" in kinds) == (len(circuits) > 1)
    assert kinds.count("branch") == sum(
        len({b for c, b in branches if c == circuit}) > 1 for circuit in circuits)


def test_the_five_points_are_an_example_of_every_kind():
    kinds = [{"circuit": len({c for c, _ in p}) > 1, "branch": len(set(p)) > len({c for c, _ in p})}
             for p in (parts(*of_line(row)) for row in LINE["exact"])]
    assert any(x["circuit"] for x in kinds) and any(x["branch"] for x in kinds)
    assert any(not x["circuit"] and not x["branch"] for x in kinds)


# ---------------------------------------------------------------- benchmark paths


def test_six_points_on_a_line_are_met_in_order_by_a_crank_that_turns():
    """[Cabrera2002] asks for the order of the crank's angles, and for Grashof's condition."""
    case = forms.CASES["line_of_six"]
    bar, crank = forms.published(case), np.array(case["published"]["crank"])
    mechanism = four_bar(bar)
    side = min((1, -1), key=lambda s: forms.timed_error(bar, case["points"], crank, s))
    states = states_of(mechanism, bar, crank, [side] * 6)
    assert grave(defects(mechanism, states)) == []
    order = [0, 2, 1, 3, 4, 5]
    found = grave(defects(mechanism, [states[k] for k in order]))
    assert [x.kind for x in found] == ["order"]
    other = states_of(mechanism, bar, crank[1:2], [-side])
    found = grave(defects(mechanism, [states[0], *other, *states[2:]]))
    assert [(x.kind, x.samples) for x in found] == [("circuit", (0, 1, 2, 3, 4, 5))]


def met_nearest(name):
    """Return what a published linkage has, and the crank angles nearest to its points."""
    case = forms.CASES[name]
    bar = forms.published(case)
    side = min((1, -1), key=lambda s: forms.free_error(bar, case["points"], s))
    grid = np.linspace(0, 2 * np.pi, 7201)[:-1]
    curve = forms.coupler_points(bar, grid, side)
    crank = [nearest(grid, curve, z) for z in np.array(case["points"]) @ [1, 1j]]
    return four_bar(bar), bar, crank, [side] * len(crank)


def test_twelve_points_on_a_closed_curve_are_met_one_after_the_other():
    mechanism, *where = met_nearest("twelve")
    assert grave(defects(mechanism, states_of(mechanism, *where), cyclic=True)) == []


def test_a_point_on_the_other_strand_of_a_figure_eight_is_out_of_order():
    """The ninth point is beside the crossing, and the curve is nearer to it on its way back."""
    mechanism, bar, crank, sides = met_nearest("figure_eight")
    found = grave(defects(mechanism, states_of(mechanism, bar, crank, sides), cyclic=True))
    assert [(x.kind, x.samples) for x in found] == [("order", (8,))]
    crank[8] = 0.5 * (crank[7] + crank[9])
    assert grave(defects(mechanism, states_of(mechanism, bar, crank, sides), cyclic=True)) == []


def nearest(grid, curve, z):
    return float(grid[np.argmin(abs(curve - z))])


# ---------------------------------------------------------------- Watt's six-bar


FIRST = {"r1": 0.30, "r2": 0.10, "r3": 0.28, "r4": 0.24}


def watt(second, crank, sides):
    """Return the six-bar and its state at a crank angle, on sides of both loops' diagonals."""
    dimensions = {**FIRST, **second, "gamma": np.radians(-70.0)}
    mechanism = sp.load("watt_six_bar", **dimensions)
    states = []
    for phi, (one, two) in zip(crank, sides, strict=True):
        coupler, rocker = dyad(FIRST["r1"], FIRST["r2"], FIRST["r3"], FIRST["r4"], phi, one)
        arm = rocker + dimensions["gamma"]
        link, output = dyad(dimensions["r8"], dimensions["r5"], dimensions["r6"],
                            dimensions["r7"], arm, two)
        states.append(sp.assemble(mechanism, {"crank": phi}, guess={
            "crank_pin": phi, "coupler_pin": coupler - phi, "rocker_pin": rocker,
            "link_pin": link - rocker, "output_pin": output}))
        assert np.sin(states[-1].coordinate("output_pin").value - output) == pytest.approx(
            0.0, abs=1e-9)
    return mechanism, states


def dyad(ground, crank, coupler, rocker, phi, side):
    """Return the angles of coupler and rocker of a four-bar."""
    rest = ground - crank * np.exp(1j * phi)
    angle = np.angle(rest) + side * np.arccos(
        (coupler**2 + abs(rest) ** 2 - rocker**2) / (2 * coupler * abs(rest)))
    return angle, np.angle(coupler * np.exp(1j * angle) - rest)


CLOSES = {"r5": 0.05, "r6": 0.25, "r7": 0.16, "r8": 0.30}  # at all angles of its arm
ALL = [(1, 1), (1, -1), (-1, 1), (-1, -1)]


@pytest.mark.parametrize("other", few(ALL[1:], ALL[1]))
def test_watts_six_bar_has_four_circuits_where_its_second_loop_always_closes(other):
    mechanism, states = watt(CLOSES, [0.5, 1.5, 2.5], [(1, 1), other, (1, 1)])
    found = grave(defects(mechanism, states, output="output_pin"))
    assert [(x.kind, x.samples) for x in found] == [("circuit", (0, 1, 2))]
    circuit = Circuit(mechanism, "crank", states[0])
    assert circuit.turns_fully and circuit.borders == []


def test_dead_centres_of_watts_second_loop_join_its_circuits():
    """The arm passes where link and output are in line: there the output's two sides meet."""
    second = dead_centre_within()
    reach = second["r6"] + second["r7"]
    arm = acos((second["r5"] ** 2 + second["r8"] ** 2 - reach**2)
               / (2 * second["r5"] * second["r8"]))
    crank = [phi for phi in np.linspace(0.0, 2 * pi, 61)[:-1] if abs(arm_at(phi)) < arm - 0.02]
    assert 5 < len(crank) < 55  # the second loop closes over a part of the turn only
    some = [crank[0], crank[1], crank[0]]
    mechanism, states = watt(second, some, [(1, 1), (1, 1), (1, -1)])
    found = grave(defects(mechanism, states, output="output_pin"))
    assert [x.kind for x in found] == ["branch"]
    circuit = Circuit(mechanism, "crank", states[0])
    borders = [event.value for event in circuit.borders]
    assert len(borders) == 2
    for value in borders:
        assert abs(arm_at(value)) == pytest.approx(arm, abs=1e-7)


def dead_centre_within():
    """Return a second loop that is stretched within the range of the rocker's arm."""
    low, high = sorted(abs(x) for x in ends_of_arm())
    middle = 0.5 * (low + high)
    r5, r8 = 0.15, 0.30
    reach = hypot(r8 - r5 * cos(middle), r5 * sin(middle))
    return {"r5": r5, "r6": 0.6 * reach, "r7": 0.4 * reach, "r8": r8}


def arm_at(phi):
    """Return the angle of the second arm against the ground at a crank angle."""
    rocker = dyad(*FIRST.values(), phi, 1)[1]
    return np.remainder(rocker + np.radians(-70.0) + pi, 2 * pi) - pi


def ends_of_arm():
    angles = [arm_at(phi) for phi in np.linspace(0.0, 2 * pi, 721)]
    return min(angles), max(angles)
