"""Legs whose length is all that matters become distances: same outputs, same names, fewer unknowns.

A door, hung in two hinges or in two pins square to each other, is held by a leg between balls. The
leg is made longer by what joint it has: a slide, a slide beside the line of the balls, a screw, a
knee, a slide in a slide.
"""

import mechanisms as known
import numpy as np
import pytest
from loaded_library import library
from mechanisms import (
    between,
    closure,
    coupling,
    driver,
    floating,
    guess,
    load,
    point,
    refine,
    sliding as slide,
    turning as hinge,
)
from sameness import sizes
from variety import paired

import spatial_pin as sp

CLOSE = 5e-12  # position, rate and acceleration; the ends of some ranges are not far from limits
FOOT, TOP = (0.7, 0.1, -0.2), (0.4, 0.05, 0.3)  # ends of the leg on the ground and on the door


def telescope(parts: str) -> tuple[str, str, str, dict[str, float]]:
    """Joints from link `lower` to link `upper`, more TOML, the driver's joint, and a guess."""
    along = {"axis": (1.0, 0.0, 0.0)}
    return {
        "slide": (slide("stroke", "lower", "upper", **along), "", "stroke", {"stroke": 0.75}),
        "slide aside": (slide("stroke", "lower", "upper", (0.05, 0.1, 0.0), (0.8, 0.6, 0.0)), "",
                        "stroke", {"stroke": 0.7}),
        "screw": (floating("stroke", "lower", "upper", (0.72, 0, 0)),
                  refine("stroke", "screw", axis=(1, 0, 0), lead=0.02), "stroke", {"stroke": 1.0}),
        "knee": (hinge("stroke", "lower", "upper", (0.5, 0, 0), (0, 0, 1)), "", "stroke",
                 {"stroke": 1.1}),
        "slides": (slide("first", "lower", "middle", **along)
                   + slide("stroke", "middle", "upper", (0.3, 0, 0), **along),
                   driver("lift", "first"), "stroke",
                   {"first": 0.2, "stroke": 0.25}),
    }[parts]


LEGS = ("slide", "slide aside", "screw", "knee", "slides")


def door(folder, parts="slide", foot="universal", *, from_door=False, extra="", more=""):
    """A door on hinges along z with one leg to the ground, tip 0.3 beyond its last joint."""
    leg, toml, joint, start = telescope(parts)
    tip = (0.0, 0.0, 0.0) if parts.startswith(("slide", "screw")) else (0.45, 0.0, 0.0)
    near, near_at, far, far_at = ("ground", FOOT, "door", TOP)
    if from_door:
        near, near_at, far, far_at = far, far_at, near, near_at
    tree = hinge("hinge", "ground", "door") + point("far", far, far_at)
    toml += driver("ram", joint) + extra
    if foot == "floating":
        tree += floating("foot", "ground", "lower") + point("near", near, near_at)
        toml += closure("heel", "spherical", "lower", "near")
    else:
        tree += floating("foot", near, "lower", near_at)
        keys = {"axis": (0, 1, 0), "axis2": (0, 0, 1)} if foot == "universal" else {}
        toml += refine("foot", foot, **keys)
    tree += leg + point("tip", "upper", tip)
    toml += closure("ball", "spherical", "tip", "far")
    return load(folder, "door", tree + more, toml + guess(hinge=0.9, **start))


def about(mechanism, driver="ram", reach=0.04, n=31):
    """Values of a driver on both sides of where the guess closes."""
    value = sp.assemble(mechanism).coordinate(driver).value
    return np.linspace(value - reach, value + reach, n)


# ---------------------------------------------------------------- which legs


@pytest.mark.parametrize("from_door", [False, True], ids=["from the ground", "from the door"])
@pytest.mark.parametrize(("parts", "foot"), paired(
    [*LEGS], ["universal", "spherical", "floating"]))
def test_a_leg_between_balls_is_one_equation(tmp_path, parts, foot, from_door):
    full = door(tmp_path, parts, foot, from_door=from_door)
    reduced = sp.reduce(full, "hinge")
    inner = 2 if parts == "slides" else 1
    assert sizes(reduced) == (1 + inner, 1)
    assert {"hinge", "stroke"} <= set(reduced.coordinates)
    (closure_,) = reduced.closures
    assert closure_.type == "distance" and closure_.between
    hold = {"first": sp.assemble(full).coordinate("first").value} if inner == 2 else None
    found = reduced.verify("ram", about(full), hold=hold)
    assert found.worst < CLOSE and found.rows == 31, str(found)
    (note,) = [x for x in reduced.omissions if x.what == "leg"]
    assert note.name == "lower" and "'stroke' alone change" in note.why


def test_a_hydraulic_cylinder_in_the_plane(tmp_path):
    """Pins instead of balls: all moves in planes square to the hinge."""
    tree = (hinge("hinge", "ground", "door") + point("eye", "door", (0.4, 0.05, 0))
            + hinge("trunnion", "ground", "barrel", (0.7, 0.1, 0.2))
            + slide("stroke", "barrel", "piston", axis=(1, 0, 0)) + point("tip", "piston"))
    full = load(tmp_path, "cylinder", tree, driver("ram", "stroke") + closure(
        "pin", "cylindrical", "tip", "eye") + guess(hinge=0.9, stroke=0.5, trunnion=2.5))
    assert sizes(sp.reduce(full, "hinge", dynamics=False)) == (3, 2)  # no plane: it may slide off
    toml = (tmp_path / "cylinder.toml").read_text(encoding="utf-8")
    (tmp_path / "pinned.toml").write_text(toml.replace("cylindrical", "revolute"))
    tree = (tmp_path / "cylinder.urdf").read_text(encoding="utf-8")
    (tmp_path / "cylinder.urdf").write_text(tree.replace('xyz="0.7 0.1 0.2"', 'xyz="0.7 0.1 0"'))
    full = sp.load(tmp_path / "pinned.toml")
    reduced = sp.reduce(full, "hinge")
    assert sizes(reduced) == (2, 1)
    assert reduced.verify("ram", about(full)).worst < CLOSE


def test_a_leg_with_one_pin_keeps_its_plane(tmp_path):
    """As in 3-RPS platforms: pin, slide, ball; the plane of the leg stays an equation."""
    tree = (floating("gimbal", "ground", "door") + point("eye", "door", (0.4, 0.05, 0.3))
            + hinge("trunnion", "ground", "barrel", (0.7, 0.1, -0.2), (0, 1, 0))
            + slide("stroke", "barrel", "piston", axis=(1, 0, 0)) + point("tip", "piston"))
    full = load(tmp_path, "rps", tree, refine("gimbal", "universal", axis=(0, 0, 1),
                                              axis2=(0, 1, 0)) + driver("ram", "stroke") + closure(
        "ball", "spherical", "tip", "eye") + guess(gimbal=[0.1, 0.0], stroke=0.5, trunnion=-2.1))
    reduced = sp.reduce(full, "gimbal")
    assert sizes(reduced) == (3, 2)
    assert [c.type for c in reduced.closures] == ["point_on_plane", "distance"]
    assert reduced.verify("ram", about(full)).worst < CLOSE


def test_the_reach_of_a_universal_joint_is_named_where_it_is_lost(tmp_path):
    """Its ball is not in the plane normal to the pin in the leg: it cannot point anywhere."""
    full = door(tmp_path, from_door=True)
    assert "cannot point" not in str(sp.reduce(full, "hinge"))
    urdf = (tmp_path / "door.urdf").read_text(encoding="utf-8")
    tip = '<child link="tip"/><origin xyz="0.0 0.0 '
    assert urdf.count(f'{tip}0.0"') == 1
    (tmp_path / "door.urdf").write_text(urdf.replace(f'{tip}0.0"', f'{tip}0.5"'))
    full = sp.load(tmp_path / "door.toml")
    reduced = sp.reduce(full, "hinge")
    assert "where its universal joint cannot point, the full mechanism stops" in str(reduced)
    one, other = (sp.limits(m, "ram") for m in (full, reduced))
    lost = one.lower.value - other.lower.value, other.upper.value - one.upper.value
    assert max(lost) > 0.05 and min(lost) > -1e-9


def test_a_resolved_spin_goes_with_its_leg(tmp_path):
    extra = '[passive.spin]\nbody = "upper"\naxis = ["foot", "tip"]\n'
    tree = door(tmp_path, "slide", "spherical")
    text = (tmp_path / "door.toml").read_text(encoding="utf-8")
    assert not tree.passives
    spin = extra.replace('"foot", "tip"', '"stroke", "tip"').replace('"upper"', '"lower"')
    spin = spin.replace('"stroke", "tip"', '"lower", "along"')
    urdf = (tmp_path / "door.urdf").read_text(encoding="utf-8")
    (tmp_path / "door.urdf").write_text(urdf.replace(
        "</robot>", point("along", "lower", (1.0, 0, 0)) + "</robot>"))
    (tmp_path / "door.toml").write_text(text.replace("[guess]", spin + "[guess]"))
    full = sp.load(tmp_path / "door.toml")
    reduced = sp.reduce(full, "hinge")
    assert full.passives and not reduced.passives
    assert sizes(reduced) == (2, 1)
    assert reduced.verify("ram", about(full)).worst < 1e-10  # the spin is integrated
    assert "passive freedom spin" in str(reduced)


def test_a_leg_of_which_more_is_requested_stays(tmp_path):
    full = door(tmp_path)
    for output in ("foot", "lower", "upper", "tip"):
        reduced = sp.reduce(full, ["hinge", output])
        assert not [x for x in reduced.omissions if x.what == "leg"], output
        assert reduced.verify("ram", about(full)).worst < CLOSE
    hung = door(tmp_path, more=hinge("bell", "upper", "clapper"), extra=driver("wind", "bell"))
    assert not [x for x in sp.reduce(hung, "hinge").omissions if x.what == "leg"]


def test_what_gears_its_joint_stays(tmp_path):
    """A wheel in the ground moves the slide by a rack."""
    full = door(tmp_path, more=hinge("wheel", "ground", "disc"))
    toml = (tmp_path / "door.toml").read_text(encoding="utf-8")
    toml = toml.replace('joint = "stroke"', 'joint = "wheel"')
    (tmp_path / "door.toml").write_text(toml.replace(
        "[guess]", coupling("rack", "wheel", "stroke", 0.05, 0.7) + "[guess]"))
    full = sp.load(tmp_path / "door.toml")
    reduced = sp.reduce(full, "hinge")
    assert sizes(reduced) == (3, 2)
    assert reduced.verify("ram", about(full, reach=0.5)).worst < CLOSE


# ---------------------------------------------------------------- Gough's platform


def test_goughs_platform_has_six_coordinates_and_six_lengths():
    full = library("stewart")
    reduced = sp.reduce(full, "platform")
    assert sizes(reduced) == (12, 6)
    assert list(reduced.drivers) == list(full.drivers)
    found = reduced.verify("leg_2", np.linspace(0.385, 0.4, 31), hold={
        f"leg_{k}": 0.3926 + 0.002 * k for k in (1, 3, 4, 5, 6)})
    assert found.worst < CLOSE
    values = {f"leg_{k}": 0.3926 + x for k, x in enumerate(
        (0.004, -0.01, 0.008, 0.013, -0.007, 0.002), 1)}
    speeds = {f"leg_{k}": 0.1 * k for k in range(1, 7)}
    states = []
    for m in (full, reduced):
        state = sp.assemble(m, values, sp.assemble(m))
        states.append(sp.solve_rates(m, state, speeds, {"leg_3": 0.7}))
    one, other = states
    np.testing.assert_allclose(one.placement("platform"), other.placement("platform"), atol=1e-13)
    np.testing.assert_allclose(one.acceleration("platform"), other.acceleration("platform"),
                               rtol=1e-10)
    np.testing.assert_allclose(*(sp.jacobian(s.mechanism, s, "platform") for s in states),
                               atol=1e-11)
    assert other.coordinate("slide_4").rate == pytest.approx(0.4, abs=1e-14)
    mobility = sp.mobility(reduced)
    assert (mobility.kutzbach, mobility.dof, mobility.rank, mobility.passive) == (6, 6, 6, ())


def test_one_leg_that_moves_is_a_sixth_equation():
    full = library("stewart")
    reduced = sp.reduce(full, "platform", lock=[f"leg_{k}" for k in range(2, 7)])
    assert sizes(reduced) == (7, 6)
    motion = sp.sweep(reduced, "leg_1", np.linspace(0.385, 0.41, 61))
    np.testing.assert_allclose(motion.coordinate("slide_1").value, np.linspace(0.385, 0.41, 61),
                               atol=1e-15)
    assert reduced.verify("leg_1", np.linspace(0.385, 0.41, 61)).worst < CLOSE


# ---------------------------------------------------------------- what stays true


def test_a_massless_leg_goes_from_dynamics_and_one_with_mass_stays(tmp_path):
    full = door(tmp_path)
    urdf = (tmp_path / "door.urdf").read_text(encoding="utf-8")
    weight = ('<inertial><origin xyz="0.2 0.1 0.1"/><mass value="2.0"/><inertia ixx="0.1" '
              'iyy="0.2" izz="0.15" ixy="0" ixz="0" iyz="0"/></inertial>')
    heavy = urdf.replace('<link name="door"/>', f'<link name="door">{weight}</link>')
    (tmp_path / "door.urdf").write_text(heavy)
    toml = (tmp_path / "door.toml").read_text(encoding="utf-8").replace(
        'tree = "door.urdf"\n', 'tree = "door.urdf"\ngravity = [0.0, -9.81, 0.0]\n')
    (tmp_path / "door.toml").write_text(toml)
    full = sp.load(tmp_path / "door.toml")
    reduced = sp.reduce(full, "hinge", dynamics=True)
    assert sizes(reduced) == (2, 1)
    states = [sp.solve_rates(m, sp.assemble(m, {"ram": 0.7}), {"ram": 0.3}, {"ram": -0.2})
              for m in (full, reduced)]
    one, other = (sp.inverse_dynamics(s.mechanism, s) for s in states)
    assert other.efforts["ram"] == pytest.approx(one.efforts["ram"], rel=1e-11)
    push = [answer.reactions[name].linear for answer, name in ((one, "ball"), (other, "lower"))]
    assert np.linalg.norm(push[1]) == pytest.approx(np.linalg.norm(push[0]), rel=1e-11)
    assert one.efforts["ram"] == pytest.approx(np.linalg.norm(push[0]), rel=1e-11)
    accelerations = [sp.forward_dynamics(s.mechanism, s, {"ram": 5.0}).a[
        s.mechanism.coordinate("hinge").v] for s in states]
    assert accelerations[1] == pytest.approx(accelerations[0], rel=1e-11)
    (tmp_path / "door.urdf").write_text(heavy.replace(
        '<link name="upper"/>', f'<link name="upper">{weight}</link>'))
    with_mass = sp.load(tmp_path / "door.toml")
    assert sizes(sp.reduce(with_mass, "hinge", dynamics=True)) == sizes(with_mass)
    assert sizes(sp.reduce(with_mass, "hinge")) == (2, 1)


def test_it_can_be_written_and_reduced_again(tmp_path):
    reduced = sp.reduce(door(tmp_path), "hinge")
    again = sp.reduce(reduced, "hinge")
    assert sizes(again) == sizes(reduced)
    toml = reduced.save(tmp_path / "files")
    values = about(reduced, n=5)
    expected = sp.sweep(reduced, "ram", values).coordinate("hinge").value
    for other in (again, sp.load(toml)):
        np.testing.assert_allclose(sp.sweep(other, "ram", values).coordinate("hinge").value,
                                   expected, atol=1e-13)


def test_limits_of_its_joint_stay(tmp_path):
    full = door(tmp_path)
    urdf = (tmp_path / "door.urdf").read_text(encoding="utf-8")
    (tmp_path / "door.urdf").write_text(urdf.replace('lower="-1000.0"', 'lower="0.6"'))
    full = sp.load(tmp_path / "door.toml")
    found = [sp.limits(m, "ram", joints=True) for m in (full, sp.reduce(full, "hinge"))]
    for ends in found:
        assert ends.lower.value == pytest.approx(0.6, abs=1e-12)
    assert found[1].upper.value == pytest.approx(found[0].upper.value, abs=1e-9)


@pytest.mark.delicate
def test_a_leg_that_folds_to_nothing_goes_straight_on_as_it_did(tmp_path):
    """Its length is zero where its ball passes the centre of its foot: branches cross there."""
    tree = (floating("foot", "ground", "lower") + slide("stroke", "lower", "upper",
                                                        axis=(1, 0, 0))
            + slide("car", "ground", "cart", axis=(1, 0, 0)))
    full = load(tmp_path, "fold", tree, refine("foot", "universal", axis=(0, 1, 0),
                                               axis2=(0, 0, 1)) + driver("ram", "stroke") + closure(
        "ball", "spherical", "upper", "cart") + guess(car=0.5, stroke=0.5))
    reduced = sp.reduce(full, "car")
    assert sizes(reduced) == (2, 1)
    values = np.linspace(0.5, -0.5, 24)
    for m in (full, reduced):
        motion = sp.sweep(m, "ram", values)
        np.testing.assert_allclose(motion.coordinate("car").value, values, atol=1e-12)
        (event,) = motion.events
        assert event.kind == "branch point" and event.value == pytest.approx(0.0, abs=1e-10)
        stopped = sp.sweep(m, "ram", values, on_crossing="stop")
        assert len(stopped.q) < len(values) // 2 + 2


@pytest.mark.delicate
def test_change_points_of_one_equation_are_passed(tmp_path):
    """The reduced parallelogram: both derivatives of its distance vanish where it is flat."""
    full = known.bare_four_bar(tmp_path, 0.3, 0.1, 0.3, 0.1)
    reduced = sp.reduce(full, "rocker_pin")
    assert sizes(reduced) == (2, 1)
    values = np.linspace(0.5, 2.5 * np.pi, 30)
    one, other = (sp.sweep(m, "crank", values) for m in (full, reduced))
    np.testing.assert_allclose(*(m.coordinate("rocker_pin").value for m in (one, other)),
                               atol=1e-12)
    for motion in (one, other):
        assert [e.value for e in motion.events] == pytest.approx([np.pi, 2 * np.pi], abs=1e-11)


def test_a_distance_of_variable_length_is_kept_as_it_is(tmp_path):
    full = known.arm_on_a_ram(tmp_path)
    reduced = sp.reduce(full, "shoulder")
    assert sizes(reduced) == (2, 1)
    assert reduced.closures[0].between == ("foot", "end")
    assert sizes(sp.reduce(full, "stroke")) == (1, 0)
    assert "length_between" in between("x", ("a", "b"), ("c", "d"))
