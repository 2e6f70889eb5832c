"""Reduced models: smaller, the same outputs on the same branch, and a true list of what went."""

import pickle
import xml.etree.ElementTree as ET

import mechanisms
import numpy as np
import pinocchio as pin
import pytest
from folders import ROOT
from loaded_library import library
from rsup import rsup
from sameness import sizes
from variety import few

import spatial_pin as sp

# a driver's range ends where rates grow without bound, and with them round-off
CLOSE = 5e-11
LINKAGES = [n for n in sp.list_mechanisms() if n != "stewart"]  # which has tests of its own

SMALLEST = [  # mechanism, output, coordinates and equations that are left
    ("rssr", "rocker_pin", 2, 1),  # a distance
    ("four_bar", "rocker_pin", 2, 1),  # a distance in the plane
    ("slider_crank", "slide", 2, 1),
    ("inverted_slider_crank", "rocker_pin", 2, 1),  # a pin in a slot
    ("hooke_joint", "output", 2, 1),  # two directions at right angles
    ("spherical_four_bar", "rocker_pin", 2, 1),  # a chord of the sphere
    ("oldham", "output_pin", 2, 1),  # no relative turn
    ("swash_plate", "slide", 2, 1),  # a point in a plane
    ("rspc", "guide.slide", 3, 2),  # a point on a line
    ("watt_six_bar", "rocker_pin", 2, 1),  # the second four-bar is idle
    ("peaucellier", "upper_inner_pin", 2, 1),
    ("double_cardan", "middle", 2, 1),
    ("delta", "platform", 9, 6),
    ("screw_press", "slide", 2, 1),
    ("bennett", "coupler_pin", 3, 5),  # no equation holds but where the loop is closed
]


@pytest.mark.parametrize(("name", "output", "coordinates", "equations"), [
    pytest.param(*case, id=f"{case[0]}-{case[1]}", marks=() if case[0] in (
        "rssr", "slider_crank", "hooke_joint", "rspc", "double_cardan", "bennett"
    ) else pytest.mark.slow) for case in SMALLEST])
def test_the_smallest_model_is_found_and_yields_the_output(name, output, coordinates, equations):
    reduced = sp.reduce(library(name), output)
    assert sizes(reduced) == (coordinates, equations)
    found = reduced.verify()
    assert found.worst < CLOSE, str(found)
    assert not found.remarks


@pytest.mark.slow
@pytest.mark.parametrize("name", LINKAGES)
def test_coordinates_and_links_of_the_library_are_yielded(name):
    mechanism = library(name)
    outputs = [*mechanism.coordinates, *mechanism.links[1:]]
    for output in outputs[:: 1 + len(outputs) // 6]:
        reduced = sp.reduce(mechanism, output)
        assert sizes(reduced) <= sizes(mechanism)
        found = reduced.verify()
        # the resolved spin of a rod is integrated from row to row, in either model; the delta
        # robot's ranges end in singular configurations, where accelerations lose eight digits
        limits = (1e-6,) * 3 if reduced.passives else (1e-11, 1e-10, 1e-8)
        for difference in found.differences:
            assert np.all(np.less(difference[2:], limits)), f"{output}: {found}"
        assert not found.remarks or any(x.what == "loop" for x in reduced.omissions)


@pytest.mark.slow
@pytest.mark.parametrize("name", mechanisms.KNOWN)
def test_every_coordinate_of_the_known_mechanisms_is_yielded(name, tmp_path):
    known = mechanisms.KNOWN[name]
    mechanism = known.build(tmp_path)
    for output in [*mechanism.coordinates, *mechanism.links[1:]]:
        reduced = sp.reduce(mechanism, output)
        found = reduced.verify(known.driver, known.values, hold=known.hold)
        assert found.worst < (1e-6 if reduced.passives else 1e-11), f"{output}: {found}"


def test_the_reduced_rssr_is_one_distance_equation_good_to_1e_12():
    full = library("rssr")
    reduced = sp.reduce(full, "rocker_pin")
    (closure,) = reduced.closures
    assert closure.type == "distance"
    assert closure.geometry.length == pytest.approx(0.381, abs=1e-15)
    values = np.linspace(0.0, 2 * np.pi, 721)
    a, b = (sp.sweep(m, "crank", values, 25.13, 1.0).coordinate("rocker_pin")
            for m in (full, reduced))
    for x, y in zip(a, b, strict=True):
        np.testing.assert_allclose(x, y, rtol=0.0, atol=1e-12 * max(1.0, np.abs(x).max()))
    report = str(reduced)
    for word in ("coupler", "distance 0.381 m", "geometry", "coupler_spin", "5 -> 2"):
        assert word in report
    assert sp.mobility(full).dof - len(sp.mobility(full).passive) == sp.mobility(reduced).dof == 1


def test_locked_legs_make_the_stewart_platform_a_body_on_five_rods():
    full = library("stewart")
    legs = [f"leg_{k}" for k in range(2, 7)]
    reduced = sp.reduce(full, ["platform", "hook_1.first"], lock=legs)
    assert sizes(reduced) == (9, 8)
    assert list(reduced.drivers) == ["leg_1"]
    assert [c.type for c in reduced.closures].count("distance") == 5
    found = reduced.verify(values=np.linspace(0.385, 0.41, 61))
    assert found.worst < CLOSE
    assert found.rows == 61


def test_a_locked_value_is_the_one_given():
    full = library("stewart")
    lengths = {f"leg_{k}": 0.395 for k in range(2, 7)}
    reduced = sp.reduce(full, "platform", lock=lengths)
    state = sp.assemble(reduced, {"leg_1": 0.395})
    other = sp.assemble(full, {"leg_1": 0.395, **lengths})
    np.testing.assert_allclose(state.placement("platform").homogeneous,
                               other.placement("platform").homogeneous, atol=1e-12)


@pytest.mark.delicate
@pytest.mark.parametrize("angle", few([-2.5, 0.4, 2.0], 2.0))
@pytest.mark.parametrize(("name", "driver", "output"), [
    ("hooke_joint", "input", "output"), ("rssr", "crank", "rocker_pin"),
    ("oldham", "input", "output_pin"), ("inverted_slider_crank", "bar", "rocker_pin"),
    ("geared_five_bar", "crank", "left_elbow")])
def test_it_assembles_on_the_branch_of_the_full_mechanism(name, driver, output, angle):
    """The cross of Hooke's joint, which tells its two branches apart, is left out."""
    full = library(name)
    reduced = sp.reduce(full, output)
    a, b = (sp.assemble(m, {driver: angle}).coordinate(output).value for m in (full, reduced))
    assert b == pytest.approx(a, abs=1e-10)


def test_a_state_of_the_full_mechanism_can_be_taken_over_with_its_rates():
    full = library("watt_six_bar")
    reduced = sp.reduce(full, "rocker_pin")
    state = sp.solve_rates(full, sp.assemble(full, {"crank": 1.0}), {"crank": 2.0}, {"crank": 3.0})
    own = reduced.state(state)
    again = sp.solve_rates(reduced, own, {"crank": 2.0}, {"crank": 3.0})
    assert own.closure_error < 1e-12
    np.testing.assert_allclose(own.v, again.v, atol=1e-12)
    np.testing.assert_allclose(own.a, again.a, atol=1e-11)
    with pytest.raises(sp.SpatialPinError, match="belongs to"):
        reduced.state(sp.assemble(library("rssr")))


def test_links_frames_and_centres_of_mass_stay_on_request():
    full = library("rssr")
    reduced = sp.reduce(full, ["rocker.com", "rocker_b", "crank_pin.rate"])
    assert sizes(reduced) == (2, 1)
    assert reduced.inertias.keys() == {"rocker"}
    names = {d.output for d in reduced.verify().differences}
    assert names == {"crank_pin", "rocker", "rocker_b", "rocker.com"}
    values = np.linspace(0.0, 6.0, 41)
    a, b = (sp.sweep(m, "crank", values).com("rocker") for m in (full, reduced))
    np.testing.assert_allclose(a.acceleration, b.acceleration, atol=1e-12)


def test_what_moves_nothing_that_is_requested_goes():
    """The last hinge of a chain does not matter for the frame before it; drivers stay."""
    full = library("watt_six_bar")
    reduced = sp.reduce(full, "crank_pin")
    assert reduced.coordinates == ("crank_pin",)
    assert not reduced.closures
    assert {x.name for x in reduced.omissions if x.what == "loop"} == {"b", "d"}
    assert not reduced.visual_model.geometryObjects


def test_a_loop_that_is_omitted_limits_no_more_and_verify_says_so():
    reduced = sp.reduce(library("stewart"), "slide_1")
    assert sizes(reduced) == (6, 0)
    found = reduced.verify("leg_1", np.linspace(0.39, 1.0, 12))
    assert "the full model ends after" in found.remarks[0]
    assert found.worst < CLOSE


def test_reducing_again_changes_nothing():
    reduced = sp.reduce(library("peaucellier"), "upper_outer_pin")
    again = sp.reduce(reduced, "upper_outer_pin")
    assert sizes(again) == sizes(reduced)
    assert again.verify().worst < 1e-12


@pytest.mark.parametrize(("name", "output"), [
    ("rssr", "rocker_pin"), ("four_bar", "coupler"), ("oldham", "output_pin"),
    ("scotch_yoke", "slot"), ("swash_plate", "slide"), ("hooke_joint", "output")])
def test_it_can_be_written_to_files_and_sent_elsewhere(name, output, tmp_path):
    full = library(name)
    reduced = sp.reduce(full, output)
    driver = next(iter(full.drivers))
    toml = reduced.save(tmp_path / "small")
    start = sp.assemble(full).coordinate(driver).value
    values = np.linspace(start, start + 0.2, 11)
    expected = sp.sweep(reduced, driver, values)
    for other in (sp.load(toml), pickle.loads(pickle.dumps(reduced))):
        found = sp.sweep(other, driver, values)
        np.testing.assert_allclose(found.q, expected.q, atol=1e-11)
        assert sizes(other) == sizes(reduced)
    assert "<visual>" not in toml.with_suffix(".urdf").read_text(encoding="utf-8")


def test_a_mechanism_with_redundant_equations_named_is_checked(tmp_path):
    reduced = sp.reduce(library("four_bar"), ["coupler_pin", "rocker_pin"])
    assert [c.equations for c in reduced.closures] == [(0, 1)]
    assert sizes(reduced) == (3, 2)
    assert reduced.verify().worst < CLOSE
    toml = reduced.save(tmp_path)
    text = toml.read_text(encoding="utf-8")
    for bad in ("[1, 0]", "[5]", "[]", "[0, 0]", "true"):
        toml.write_text(text.replace("equations = [0, 1]", f"equations = {bad}"))
        with pytest.raises(sp.MechanismFileError, match="equations must be a list"):
            sp.load(toml)
    with pytest.raises(sp.ClosureTypeError):
        reduced.constraint_models()


# ---------------------------------------------------------------- dynamics


def light_rod(tmp_path):
    """The library's RSSR with a coupler that has no mass."""
    heavy = library("rssr")
    robot = ET.fromstring(heavy.urdf)
    coupler = next(link for link in robot.findall("link") if link.get("name") == "coupler")
    coupler.remove(coupler.find("inertial"))
    (tmp_path / "light.urdf").write_text(ET.tostring(robot, encoding="unicode"))
    text = heavy.path.read_text(encoding="utf-8")
    (tmp_path / "light.toml").write_text(text.replace("rssr.urdf.xacro", "light.urdf"))
    return sp.load(tmp_path / "light.toml")


def test_a_massless_rod_goes_from_dynamics_too_and_nothing_is_lost(tmp_path):
    full = light_rod(tmp_path)
    reduced = sp.reduce(full, "rocker_pin", dynamics=True)
    assert sizes(reduced) == (2, 1)
    found = reduced.verify()
    assert found.worst < CLOSE
    assert {d.driver for d in found.differences} == {"crank", "forward dynamics"}


def test_a_rod_with_mass_stays_in_dynamics_unless_it_is_to_be_lumped():
    full = library("rssr")
    exact = sp.reduce(full, "rocker_pin", dynamics=True)
    assert sizes(exact) == sizes(full)
    assert exact.verify().worst < CLOSE
    lumped = sp.reduce(full, "rocker_pin", dynamics=True, lump=True)
    assert sizes(lumped) == (2, 1)
    total = [sum(i.mass for i in m.model.inertias) for m in (full, lumped)]
    assert total[1] == pytest.approx(total[0], rel=1e-14)
    lost = next(x for x in lumped.omissions if x.what == "inertia")
    rod = full.inertias["coupler"]
    assert f"{rod.inertia[0, 0]:.4g}" in lost.why  # across the rod, which lies along y
    assert f"{rod.mass * 0.381**2 / 4:.4g}" in lost.why
    forces = next(d for d in lumped.verify().differences if d.driver == "forward dynamics")
    assert 1e-3 < forces.acceleration < 0.5


def test_a_rod_is_lumped_so_that_its_centre_of_mass_stays_where_it_is(tmp_path):
    robot = ET.fromstring(library("rssr").urdf)
    coupler = next(link for link in robot.findall("link") if link.get("name") == "coupler")
    coupler.find("inertial").find("origin").set("xyz", "0 0.1 0")  # of 0.381 from ball to ball
    (tmp_path / "light.urdf").write_text(ET.tostring(robot, encoding="unicode"))
    text = library("rssr").path.read_text(encoding="utf-8")
    (tmp_path / "light.toml").write_text(text.replace("rssr.urdf.xacro", "light.urdf"))
    full = sp.load(tmp_path / "light.toml")
    lumped = sp.reduce(full, "rocker_pin", dynamics=True, lump=True)
    for angle in (0.3, 1.2):
        centres = [sp.sweep(m, "crank", [angle, angle + 0.1]).output("com.position").values[0]
                   for m in (full, lumped)]
        assert centres[1] == pytest.approx(centres[0], abs=1e-12)


@pytest.mark.parametrize("resistance", ["damping", "armature", "upperDryFrictionLimit"])
def test_a_rod_whose_ball_takes_a_force_to_be_turned_is_not_lumped(resistance):
    full = library("rssr")
    getattr(full.model, resistance)[full.coordinate("ball_a.x").v] = 0.1
    assert sizes(sp.reduce(full, "rocker_pin", dynamics=True, lump=True)) == sizes(full)


def test_a_lumped_rod_with_a_universal_joint_says_how_far_its_centre_of_mass_moves(tmp_path):
    """It lies (0.02, -0.01) m beside the line between the centres of the two pairs."""
    lumped = sp.reduce(rsup(tmp_path, "S", 0.3), "P", dynamics=True, lump=True)
    (lost,) = [x for x in lumped.omissions if x.what == "inertia"]
    assert lost.name == "rod" and "0.5 kg lumped at the centres of its two pairs; " in lost.why
    assert lost.why.endswith(f"; the centre of mass moves {np.hypot(0.02, 0.01):.3g} m, square to "
                             "the line between them")


def test_planar_equations_change_no_motion_under_gravity():
    reduced = sp.reduce(library("watt_six_bar"), "output_pin", dynamics=True)
    assert sizes(reduced) == (5, 4)
    assert reduced.verify().worst < CLOSE


# ---------------------------------------------------------------- what is refused, and the command


def test_clear_errors():
    full = library("rspc")
    with pytest.raises(LookupError, match="did you mean 'slide'"):
        sp.reduce(full, "slyde")
    with pytest.raises(ValueError, match="outputs is empty"):
        sp.reduce(full, [])
    with pytest.raises(ValueError, match="dynamics=True"):
        sp.reduce(full, "slide", lump=True)
    with pytest.raises(sp.SpatialPinError, match=r"guide\.slide too"):
        sp.reduce(full, "crank_pin", lock={"guide.angle": 0.5})
    with pytest.raises(sp.SpatialPinError, match="is locked"):
        sp.reduce(full, "slide", lock=["slide"])
    with pytest.raises(TypeError, match=r"sp\.load"):
        sp.reduce("rspc", "slide")
    reduced = sp.reduce(full, "slide")
    with pytest.raises(sp.SpatialPinError, match="no file to change dimensions in"):
        sp.sensitivity(reduced, sp.assemble(reduced), "slide")


def test_what_is_geared_to_a_locked_joint_is_locked(tmp_path):
    full = mechanisms.rack_and_gears(tmp_path)
    with pytest.raises(sp.SpatialPinError, match="'wheel' is locked"):
        sp.reduce(full, "wheel", lock={"rack": 0.01})


def test_sweep_only_from_the_command_line(tmp_path, run):
    csv = tmp_path / "x.csv"
    code, out, _ = run("sweep", "rssr", "crank", "0", "90deg", "--steps", "10", "--only",
                       "rocker_pin", "--csv", csv)
    assert code == 0
    assert "coordinates 5 -> 2" in out
    assert "left out: link coupler" in out
    table = np.genfromtxt(csv, delimiter=",", names=True)
    full = sp.sweep(library("rssr"), "crank", np.linspace(0.0, np.pi / 2, 10))
    np.testing.assert_allclose(table["rocker_pin_rad"], full.coordinate("rocker_pin").value,
                               atol=1e-12)
    code, out, _ = run("sweep", "stewart", "leg_1", "0.385", "0.40", "--steps", "9", "--only",
                       "platform")
    assert code == 0 and "coordinates 24 -> 7" in out
    code, _, told = run("sweep", "rssr", "crank", "0", "1", "--only", "rocker_pim")
    assert code == 1 and "did you mean 'rocker_pin'" in told


def test_links_that_carry_an_output_but_stand_elsewhere_tell_no_place(tmp_path):
    full = library("stewart")
    reduced = sp.reduce(full, "slide_1")
    state, motion = sp.assemble(reduced), sp.sweep(reduced, "leg_1", [0.39, 0.4])
    for ask in (lambda: state.placement("piston_1"), lambda: state.velocity("cylinder_1"),
                lambda: motion.frame("slide_1"), lambda: sp.jacobian(reduced, state, "piston_1"),
                lambda: motion.output("piston_1.acceleration"),
                lambda: sp.solve_jerks(reduced, state).frame("piston_1")):
        with pytest.raises(sp.SpatialPinError, match=r"joint 'hook_1'.*reduce to .*'slide_1', '"):
            ask()
    with pytest.raises(sp.SpatialPinError, match="hook_1"):
        sp.reduce(reduced, "piston_1")
    assert sp.report(motion, tmp_path / "report.html").exists()
    asked = sp.reduce(full, ["slide_1", "piston_1"])
    known = sp.assemble(full)
    assert np.allclose(asked.state(known).placement("piston_1").homogeneous,
                       known.placement("piston_1").homogeneous, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("name", few(
    LINKAGES, "crane", "four_bar", "rssr", "screw_press", "geared_five_bar"))
def test_every_link_that_tells_its_place_is_there(name):
    full = library(name)
    state = sp.assemble(full)
    if full.drivers:
        driver = next(iter(full.drivers))
        state = sp.sweep(full, driver, state.coordinate(driver).value + np.linspace(0, 0.02, 3),
                         guess=state).state(2)
    for coordinate in full.coordinates:
        reduced = sp.reduce(full, coordinate)
        own = reduced.state(state)
        for frame in set(reduced.frame_ids) & set(full.frame_ids) - set(reduced.unplaced):
            assert np.allclose(own.placement(frame).homogeneous, state.placement(frame).homogeneous,
                               rtol=0.0, atol=1e-9)


def test_limits_of_joints_that_go_are_reported(tmp_path):
    tree = mechanisms.turning("a", "ground", "arm") + mechanisms.joint(
        "revolute", "b", "arm", "hand", (0.1, 0, 0), (0, 0, 0), (0, 0, 1), (-1.0, 0.5))
    mech = mechanisms.load(tmp_path, "arm", tree, mechanisms.driver("a", "a"))
    told = {x.what: x.why for x in sp.reduce(mech, "a").omissions}
    assert told["joint limits"].startswith("of b: where one is passed")
    kept = sp.reduce(mech, "b")
    assert "joint limits" not in {x.what for x in kept.omissions}
    motion = sp.sweep(kept, "b", [0.0, 1.0], hold={"a": 0.0})
    assert [e.kind for e in motion.events] == ["joint limit"]


def test_verify_times_models_that_are_ready():
    found = sp.reduce(sp.load("rssr"), "rocker_pin").verify()  # prepared once: 30 times as long
    assert found.reduced_seconds < 8.0 * found.full_seconds


def test_verify_tells_where_both_end_and_what_it_cannot_compare():
    reduced = sp.reduce(mechanisms.four_bar(r1=0.4, r2=0.3, r3=0.2, r4=0.15), "rocker_pin")
    at = sp.assemble(reduced).coordinate("crank_pin").value
    found = reduced.verify("crank", [at, at + 2.0 * np.pi])
    assert found.rows == 1 and "both end after 1 of 2 rows: limit" in found.remarks[0]
    with pytest.raises(ValueError, match="values is empty"):
        reduced.verify("crank", [])


@pytest.mark.parametrize(("outputs", "error"), [
    (None, ValueError), ([], ValueError), (5, TypeError), (["slide", 5], TypeError)])
def test_outputs_that_are_no_names_are_refused(outputs, error):
    with pytest.raises(error, match="outputs is"):
        sp.reduce(library("slider_crank"), outputs)


def test_a_mechanism_made_in_code_is_reduced_as_one_that_was_loaded(tmp_path):
    """Links that are fixed to a body may stand before the one that its joint moves."""
    model, one = pin.Model(), pin.SE3.Identity()
    beyond = pin.SE3(np.eye(3), np.array([0.3, 0.0, 0.0]))
    ends = []
    for name, at in (("crank", 0.0), ("rocker", 0.8)):
        here = pin.SE3(np.eye(3), np.array([at, 0.0, 0.0]))
        joint = model.addJoint(0, pin.JointModelRZ(), here, f"{name}_pin")
        ends.append(model.addFrame(pin.Frame(f"{name}_end", joint, 0, beyond, pin.FrameType.BODY)))
        model.addFrame(pin.Frame(name, joint, 0, one, pin.FrameType.BODY))
    full = sp.Mechanism.from_model(
        model, [sp.closures.distance("crank_end", "rocker_end", length=0.8, name="rod")],
        drivers={"motor": "crank_pin"}, guess={"crank_pin": 1.0, "rocker_pin": 1.0})
    reduced = sp.reduce(full, ["rocker_end"])
    assert {"crank_end", "rocker_end", "rocker"} <= set(reduced.links)
    assert reduced.verify(values=np.linspace(1.0, 1.3, 9)).worst < 1e-12
    again = sp.load(reduced.save(tmp_path))
    np.testing.assert_allclose(sp.sweep(again, "motor", [1.0, 1.2]).q,
                               sp.sweep(reduced, "motor", [1.0, 1.2]).q, rtol=0, atol=1e-13)


@pytest.mark.delicate
def test_a_ring_of_scissors_is_verified_on_the_branch_of_its_guess():
    """At the ends of its range, which are branch points, other configurations are near."""
    full = sp.load(ROOT / "examples" / "machines" / "hoberman_ring.toml")
    found = sp.reduce(full, "opening").verify()
    assert found.rows == 361
    assert found.worst < CLOSE
    assert not found.remarks


@pytest.mark.parametrize("name", ["rssr", "slider_crank"])
def test_an_effort_is_the_same_in_the_model_that_is_reduced_to_it(name):
    full = library(name)
    reduced = sp.reduce(full, "crank.effort", dynamics=True)
    found = reduced.verify(values=np.linspace(0.0, 1.0, 11), speed=20.0)
    assert found.worst < CLOSE
    assert "crank.effort" in str(found)
    efforts = [sp.kinetostatics(m, sp.sweep(m, "crank", [0.0, 0.5, 1.0], speed=20.0)).efforts
               for m in (full, reduced)]
    np.testing.assert_allclose(efforts[1]["crank"], efforts[0]["crank"], rtol=1e-11)


@pytest.mark.parametrize(("output", "dynamics", "why"), [
    ("crank.effort", False, "dynamics=True"), ("ball_b.reaction", True, "other pairs"),
    ("on_ground.force", True, "other pairs"), ("krank.power", True, "did you mean 'crank'")])
def test_forces_that_a_smaller_model_does_not_tell_are_refused(output, dynamics, why):
    with pytest.raises(sp.SpatialPinError, match=why):
        sp.reduce(library("rssr"), output, dynamics=dynamics)


@pytest.mark.slow
def test_verify_compares_what_there_is_of_an_endless_slide(tmp_path):
    """A slide along a turning arm to a wall: at a right angle it would be endless."""
    tree = (mechanisms.turning("pin", "ground", "arm")
            + mechanisms.sliding("out", "arm", "block", axis=(1, 0, 0))
            + mechanisms.point("wall", "ground", (1, 0, 0)))
    full = mechanisms.load(tmp_path, "endless", tree, mechanisms.driver("arm", "pin")
                           + mechanisms.closure("on_wall", "point_on_plane", "wall", "block",
                                                axis=(1, 0, 0)) + mechanisms.guess(pin=0.1, out=1))
    reduced = sp.reduce(full, "out")
    found = reduced.verify()
    assert found.rows == 361 and found.worst < 1e-10 and not found.remarks
    assert found.compared == ("361 rows over arm from -1.41372 to 1.41372 rad",)
    asked = reduced.verify("arm", np.linspace(0.0, 2.0, 21))
    assert asked.rows == 16 and asked.compared == ("16 rows over arm from 0 to 1.5 rad",)
    assert any("out runs away without end" in remark for remark in asked.remarks)
    assert asked.compared[0] in str(asked)


def test_a_guess_that_leads_to_two_branches_is_a_remark_and_no_difference():
    mech = library("four_bar")
    small = sp.reduce(mech, "rocker_pin")
    for rocker in (-2.5, -1.5, 4.0):
        found = small.verify("crank", np.linspace(0.5, 1.5, 11), guess={"rocker_pin": rocker})
        assert found.worst < 1e-9 or any("different branches" in x for x in found.remarks)


def test_it_says_when_nothing_is_gained():
    mech = library("rspc")
    small = sp.reduce(mech, list(mech.coordinates))
    assert "nothing is gained" in str(small)
    gained = str(sp.reduce(library("rssr"), "rocker_pin"))
    assert "nothing is gained" not in gained
    assert "without a State as guess, the full mechanism is assembled first" in gained
