"""Commands of forces, rates and dimensions give what their verbs give, and fail in words."""

from __future__ import annotations

import csv
import io
import json

import numpy as np
import pinocchio as pin
import pytest

import spatial_pin as sp


@pytest.fixture
def found(run):
    """The JSON of a command that succeeds."""

    def found(*words: object):
        code, out, err = run(*words, "--json", "-")
        assert (code, err) == (0, "")
        return json.loads(out)

    return found


@pytest.fixture
def rows(run):
    """The table of a command that succeeds."""

    def rows(*words: object):
        code, out, err = run(*words, "--csv", "-")
        assert (code, err) == (0, "")
        return list(csv.DictReader(io.StringIO(out)))

    return rows


# ---------------------------------------------------------------- statics


def test_statics_holds_weights_and_loads(run, found, rows):
    words = ("statics", "rssr", "crank=60deg", "--load", "rocker_b=0,0,-50N,1,2,3")
    mechanism = sp.load("rssr")
    state = sp.assemble(mechanism, {"crank": np.pi / 3})
    load = pin.Force(np.array([0.0, 0.0, -50.0]), np.array([1.0, 2.0, 3.0]))
    expected = sp.inverse_dynamics(mechanism, state, external={"rocker_b": load})
    content = found(*words)
    assert content["efforts"] == expected.efforts and content["units"] == {"crank": "N·m"}
    for name, force in expected.reactions.items():
        assert content["reactions"][name] == [*force.linear, *force.angular]
    table = {row["quantity"]: row for row in rows(*words)}
    effort = table["crank effort"]
    assert float(effort["value"]) == expected.efforts["crank"] and effort["unit"] == "N·m"
    moment = table["crank_pin reaction moment y"]
    assert float(moment["value"]) == expected.reactions["crank_pin"].angular[1]
    assert (moment["unit"], moment["unique"]) == ("N·m", "True")
    ground = table["on ground force z"]
    assert float(ground["value"]) == expected.on_ground.linear[2]
    text = run(*words)[1]
    assert f"{expected.efforts['crank']:.9g}" in text and "ball_b" in text


def test_statics_by_virtual_work(found):
    """At rest the effort is what potential energy changes by, per unit of the driver."""
    mechanism = sp.load("four_bar")

    def energy(angle: float) -> float:
        state = sp.assemble(mechanism, {"crank": angle})
        return pin.computePotentialEnergy(mechanism.model, mechanism.model.createData(), state.q)

    h = 1e-5
    slope = (energy(1 + h) - energy(1 - h)) / (2 * h)
    assert found("statics", "four_bar", "crank=1")["efforts"]["crank"] == pytest.approx(
        slope, rel=1e-8)


@pytest.mark.slow
def test_statics_over_a_sweep_is_a_curve(found, rows):
    words = ("statics", "excavator", "--over", "boom=2..3", "--steps", "3")
    mechanism = sp.load("excavator")
    motion = sp.sweep(mechanism, "boom", np.linspace(2, 3, 3))
    expected = sp.kinetostatics(mechanism, motion)
    assert found(*words)["columns"]["arm effort [N]"] == expected.efforts["arm"].tolist()
    assert [float(row["boom effort [N]"]) for row in rows(*words)] == (
        expected.efforts["boom"].tolist())
    assert list(rows(*words)[0]) == list(expected.columns())  # reactions too


def test_forces_of_many_are_marked(run):
    text = run("statics", "four_bar")[1]
    assert "*" in text
    assert " ".join(text.split()).endswith("freedoms, can be under stress by themselves")


# ---------------------------------------------------------------- jacobian, transmission


def test_jacobian_is_that_of_the_closed_loops(found, rows, run):
    mechanism = sp.load("delta")
    state = sp.assemble(mechanism, {"arm_1": 0.3})
    expected = sp.jacobian(mechanism, state, "platform")
    content = found("jacobian", "delta", "platform", "arm_1=0.3")
    assert content["matrix"] == expected.tolist()
    assert content["drivers"] == ["arm_1", "arm_2", "arm_3"]
    assert content["units"][0] == ["m/rad"] * 3 and content["units"][3] == ["1"] * 3
    table = rows("jacobian", "delta", "platform", "arm_1=0.3")
    assert [float(row["arm_2 [rad]"]) for row in table] == expected[:, 1].tolist()
    assert [row["component"] for row in table] == ["vx", "vy", "vz", "wx", "wy", "wz"]
    assert [row["of"] for row in table] == ["m"] * 3 + ["rad"] * 3
    assert "e-1" not in run("jacobian", "delta", "platform")[1]  # round-off is not shown


def test_drivers_that_are_held_have_no_column(found):
    content = found("jacobian", "stewart", "platform", "--hold", "leg_1")
    assert content["drivers"] == [f"leg_{k}" for k in range(2, 7)]
    assert np.shape(content["matrix"]) == (6, 5)


def test_jacobian_by_another_coordinate(found):
    content = found("jacobian", "rssr", "crank", "--by", "rocker_pin", "crank=1")
    ratio = found("transmission", "rssr", "rocker_pin", "crank=1")["ratio"]
    assert content["drivers"] == ["rocker_pin"]
    assert np.abs(content["matrix"]).max() == pytest.approx(1 / abs(ratio), rel=1e-9)


def test_transmission_at_a_configuration_and_over_a_turn(found, rows):
    mechanism = sp.load("four_bar")
    expected = sp.transmission(mechanism, sp.assemble(mechanism, {"crank": 1.0}), "rocker_pin")
    content = found("transmission", "four_bar", "rocker_pin", "crank=1")
    assert (content["ratio"], content["angle"]) == (expected.ratio, expected.angle)
    assert content["units"] == {"ratio": "1", "angle": "rad", "mechanical_advantage": "1"}
    table = rows("transmission", "four_bar", "rocker_pin", "--over", "crank=1..7", "--steps", "7")
    assert len(table) == 7
    assert float(table[0]["ratio [-]"]) == pytest.approx(expected.ratio, abs=1e-12)
    along = found("transmission", "four_bar", "rocker_pin", "--over", "crank=1..7")
    angles = along["columns"]["transmission angle [rad]"]
    links = np.array([[0.1, 0.28, 0.24, 0.3]])  # crank, coupler, rocker, ground: closed form
    a, b, c, d = links[0]
    extremes = [np.arccos((b * b + c * c - (d + s * a) ** 2) / (2 * b * c)) for s in (1, -1)]
    least = min(min(x, np.pi - x) for x in extremes)
    assert min(angles) == pytest.approx(least, abs=1e-3)


# ---------------------------------------------------------------- sensitivity, tolerance


def test_sensitivity_of_numbers_vectors_and_rates(found, rows):
    mechanism = sp.load("rssr")
    state = sp.assemble(mechanism, {"crank": 1.0})
    expected = sp.sensitivity(mechanism, state, "rocker_pin", ["b"])
    content = found("sensitivity", "rssr", "rocker_pin", "crank=1", "--to", "b")
    assert content["derivatives"] == expected.derivatives and content["unit"] == "rad"
    table = rows("sensitivity", "rssr", "coupler_b.position", "crank=1")
    assert len(table) == 12 and {row["of"] for row in table} == {
        f"coupler_b.position.{axis}" for axis in "xyz"}
    moving = found("sensitivity", "rssr", "rocker_pin.rate", "crank=1", "--speed", "crank=240rpm")
    assert moving["value"] == pytest.approx(0.42609571985935 * 8 * np.pi, rel=1e-12)


def test_sensitivity_over_a_sweep(found, rows):
    words = ("sensitivity", "rssr", "rocker_pin", "--over", "crank=0..1", "--steps", "4")
    content = found(*words)
    assert len(content["derivatives"]["b"]) == len(content["driver"]["values"]) == 4
    assert [float(row["d/d b"]) for row in rows(*words)] == content["derivatives"]["b"]


def test_tolerance_is_reported_linear_and_sampled(run, found, rows):
    words = ("tolerance", "rssr", "rocker_pin", "crank=1", "--deviation", "b=0.1mm",
             "--also", "coupler_b.position")
    mechanism = sp.load("rssr")
    state = sp.assemble(mechanism, {"crank": 1.0})
    expected = sp.tolerance(mechanism, ["rocker_pin", "coupler_b.position"], {"b": 1e-4}, state,
                            samples=100)
    content = found(*words, "--samples", 100)
    assert content["linear"]["rocker_pin"] == expected.linear["rocker_pin"]
    assert content["sampled"]["rocker_pin"] == expected.sampled["rocker_pin"]
    table = rows(*words)
    assert [row["output"] for row in table] == [
        "rocker_pin", *(f"coupler_b.position.{axis}" for axis in "xyz")]
    assert "sampled" not in table[0] and "(linear)" in run(*words)[1]


# ---------------------------------------------------------------- mistakes


@pytest.mark.parametrize(("words", "code", "says"), [
    (("statics", "rssr", "--load", "couplr=1,2,3"), 1, "did you mean 'coupler'?"),
    (("statics", "rssr", "--load", "coupler=1,2"), 2, "a force has 3 numbers, with a moment 6"),
    (("statics", "rssr", "--load", "coupler=1,2,3deg"), 1, "in N or kN, not in deg"),
    (("statics", "rssr", "--load", "coupler"), 2, "is not NAME=A,B,C"),
    (("statics", "rssr", "--actuated", "krank"), 1, "did you mean 'crank'?"),
    (("statics", "rssr", "crank=1", "--over", "crank=0..1"), 2, "--over goes from the guess on"),
    (("statics", "rssr", "--over", "crank=0"), 2, "is not NAME=LO..HI"),
    (("statics", "rssr", "--over", "krank=0..1"), 1, "did you mean 'crank'?"),
    (("statics", "rssr", "--over", "crank=0..1mm"), 1, "crank is in rad, not in mm"),
    (("jacobian", "rssr", "couplr"), 1, "did you mean 'coupler'?"),
    (("jacobian", "rssr", "coupler", "--by", "krank"), 1, "did you mean 'crank'?"),
    (("jacobian", "rssr", "coupler", "--hold", "nix"), 1, "'nix'"),
    (("jacobian", "rssr", "coupler", "--hold", "crank_pin"), 1,
     "nothing moves 'coupler': crank is held; hold less, or name what moves it with --by"),
    (("jacobian", "rssr", "coupler", "--by", "crank", "--hold", "crank"), 1,
     "'crank_pin' is held, and is to move too: choose one"),
    (("limits", "rssr", "crank", "--hold", "crank"), 1,
     "'crank_pin' is held, and is to move too: choose one"),
    (("transmission", "rssr", "roker_pin"), 1, "did you mean 'rocker_pin'?"),
    (("transmission", "rssr", "crank"), 1, "is a driver itself"),
    (("transmission", "stewart", "leg_1"), 1, "say which one moves the output"),
    (("sensitivity", "rssr", "roker_pin"), 1, "rocker_pin"),
    (("sensitivity", "rssr", "rocker_pin", "--to", "e"), 1, "no dimension 'e'"),
    (("tolerance", "rssr", "rocker_pin", "--deviation", "e=1mm"), 1, "no dimension 'e'"),
    (("tolerance", "rssr", "rocker_pin", "--deviation", "b=1s"), 1, "b is in m or cm"),
    (("tolerance", "rssr", "rocker_pin"), 2, "--deviation"),
])
def test_mistakes_are_one_sentence(run, words, code, says):
    got, out, err = run(*words)
    assert got == code and out == "" and says in " ".join(err.split())
    assert "Traceback" not in err and (code == 2 or err.count("\n") == 1)
