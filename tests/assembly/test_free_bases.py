"""Free bases: floating joints that carry a whole mechanism, held or let go; bare URDFs driven."""

from __future__ import annotations

import pickle
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from loaded_library import library
from machines import free_bases
from variety import few

import spatial_pin as sp

POSE = [0.3, -0.2, 0.5, 0.4, -0.3, 0.2]
LIBRARY = ("four_bar", "rssr", "stewart", "delta", "double_cardan", "screw_press")
KINDS = ("revolute", "continuous", "prismatic")


def tree(seed: int, joints: int = 8, serial: bool = False) -> str:
    """Return a random open tree, or chain, as URDF text."""
    rng = np.random.default_rng(seed)
    lines = ['<robot name="tree"><link name="l0"/>']
    for k in range(1, joints + 1):
        xyz, rpy, axis = (" ".join(map(repr, x.tolist())) for x in rng.normal(size=(3, 3)))
        lines.append(
            f'<link name="l{k}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" '
            f'ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="j{k}" '
            f'type="{KINDS[rng.integers(3)]}">'
            f'<parent link="l{k - 1 if serial else rng.integers(k)}"/>'
            f'<child link="l{k}"/><origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>'
            '<limit lower="-9" upper="9" effort="9" velocity="9"/></joint>')
    return "".join([*lines, "</robot>"])


def loaded(folder: Path, text: str, **options: bool) -> sp.Mechanism:
    file = folder / "tree.urdf"
    file.write_text(text)
    return sp.load(file, **options)


def random_state(mechanism: sp.Mechanism, seed: int) -> sp.State:
    rng = np.random.default_rng(seed)
    q = pin.integrate(mechanism.model, mechanism.neutral, rng.normal(size=mechanism.model.nv))
    return sp.assemble(mechanism, {}, q)


def pinocchios(mechanism: sp.Mechanism, q: np.ndarray, name: str) -> np.ndarray:
    model = mechanism.model
    return pin.computeFrameJacobian(model, model.createData(), q, model.getFrameId(name),
                                    pin.LOCAL_WORLD_ALIGNED)


@pytest.fixture(params=few(LIBRARY, "four_bar", "stewart", "screw_press"))
def pair(request: pytest.FixtureRequest) -> tuple[sp.Mechanism, sp.Mechanism]:
    """The same mechanism on the ground, and on a free base."""
    return library(request.param), library(request.param, free_flyer=True)


def moved(mechanism: sp.Mechanism) -> dict[str, object]:
    return {**mechanism.guess, "root_joint": POSE}


# ---------------------------------------------------------------- bare URDFs


@pytest.mark.parametrize("seed", range(6))
def test_every_joint_of_a_bare_urdf_is_a_driver(seed: int, tmp_path: Path) -> None:
    mechanism = loaded(tmp_path, tree(seed))
    assert list(mechanism.drivers) == list(mechanism.model.names)[1:]
    state = random_state(mechanism, seed)
    for link in ("l1", "l5", "l8"):
        found = sp.jacobian(mechanism, state, link)
        assert found == pytest.approx(pinocchios(mechanism, state.q, link), abs=1e-13)


def test_one_joint_of_a_bare_urdf_moves_while_the_others_stand(tmp_path: Path) -> None:
    mechanism = loaded(tmp_path, tree(1))
    motion = sp.sweep(mechanism, "j3", np.linspace(0.0, 1.0, 20))
    still = [k for k in range(8) if k != mechanism.coordinate("j3").v]
    assert np.ptp(motion.q[:, still], axis=0) == pytest.approx(np.zeros(7), abs=0)
    assert sp.solve_rates(mechanism, motion.state(3), {"j3": 2.0}).v == pytest.approx(
        2.0 * np.eye(8)[mechanism.coordinate("j3").v], abs=1e-15)


def test_the_efforts_of_a_bare_urdf_at_rest_are_pinocchios(tmp_path: Path) -> None:
    mechanism = loaded(tmp_path, tree(2))
    state = random_state(mechanism, 2)
    gravity = pin.computeGeneralizedGravity(
        mechanism.model, mechanism.model.createData(), state.q)
    found = sp.inverse_dynamics(mechanism, state).efforts
    assert list(found.values()) == pytest.approx(gravity, abs=1e-12)


def test_a_mimicking_joint_of_a_bare_urdf_is_no_driver(tmp_path: Path) -> None:
    text = tree(3).replace('<limit', '<mimic joint="j1" multiplier="-2"/><limit')
    first = text.index("<mimic")
    cut = text.index("/>", first) + 2
    text = text[:first] + text[cut:]  # j1 itself mimics nothing
    mechanism = loaded(tmp_path, text)
    assert list(mechanism.drivers) == ["j1"]
    state = sp.assemble(mechanism, {"j1": 0.2})
    whole = pinocchios(mechanism, state.q, "l8")
    expected = whole @ np.array([1.0, *[-2.0] * 7])
    assert sp.jacobian(mechanism, state, "l8")[:, 0] == pytest.approx(expected, abs=1e-13)


def test_components_of_joints_of_several_freedoms_have_columns_too(tmp_path: Path) -> None:
    text = tree(4)
    for joint, kind in (("j2", "floating"), ("j4", "planar")):
        at = text.index('type="', text.index(f'joint name="{joint}"')) + 6
        text = text[:at] + kind + text[text.index('"', at):]
    mechanism = loaded(tmp_path, text)
    state = random_state(mechanism, 4)
    bodies = {c.joint for c in mechanism.coordinate_table.values()}
    kept = [v for v, c in enumerate(mechanism.coordinate_table.values())
            if c.joint not in free_bases(mechanism)]
    assert "j2" in bodies
    for link in ("l2", "l4", "l8"):
        found = sp.jacobian(mechanism, state, link)
        assert found == pytest.approx(pinocchios(mechanism, state.q, link)[:, kept], abs=1e-13)


def test_drivers_may_be_any_of_the_joints_of_a_file_with_loops_and_no_drivers(
    tmp_path: Path,
) -> None:
    source = Path(library("four_bar").path or "").read_text()
    lines = source.splitlines()
    at = next(i for i, line in enumerate(lines) if line.startswith("[drivers"))
    del lines[at : at + 2]
    for name in ("four_bar.urdf.xacro", "parts.xacro"):
        tmp_path.joinpath(name).write_text(
            Path(library("four_bar").path or "").with_name(name).read_text())
    tmp_path.joinpath("bare.toml").write_text("\n".join(lines))
    bare, driven = sp.load(tmp_path / "bare.toml"), library("four_bar")
    joint = next(iter(driven.drivers.values())).joint
    assert not bare.drivers
    state = sp.assemble(bare, {joint: 0.3})
    same = sp.assemble(driven, {joint: 0.3})
    link = driven.links[-1]
    assert sp.jacobian(bare, state, link, [joint]) == pytest.approx(
        sp.jacobian(driven, same, link), abs=1e-14)
    with pytest.raises(sp.SingularError, match="prescribe 1 more of"):
        sp.jacobian(bare, state, link)


# ---------------------------------------------------------------- loading


def test_a_free_flyer_is_pinocchios(tmp_path: Path) -> None:
    mechanism = loaded(tmp_path, tree(5), free_flyer=True)
    model = pin.buildModelFromUrdf(str(tmp_path / "tree.urdf"), pin.JointModelFreeFlyer())
    assert list(mechanism.model.names) == list(model.names)
    assert mechanism.free_flyer and mechanism.model.nv == model.nv == 14
    state = random_state(mechanism, 5)
    q = pin.neutral(model)  # continuous joints have two entries there
    q[:7] = state.q[:7]
    for name in mechanism.drivers:
        joint, angle = model.joints[model.getJointId(name)], state.coordinate(name).value
        own = [angle] if joint.nq == 1 else [np.cos(angle), np.sin(angle)]
        q[joint.idx_q : joint.idx_q + joint.nq] = own
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    for k, frame in enumerate(model.frames):
        if frame.type == pin.FrameType.BODY and frame.name != "universe":
            assert state.placement(frame.name).isApprox(data.oMf[k], 1e-13)


def test_what_stands_still_beside_a_free_base_has_a_name(tmp_path: Path) -> None:
    mechanism = loaded(tmp_path, tree(5), free_flyer=True)
    assert mechanism.frame_on_joint("world")[0] == 0
    taken = tree(5).replace('"l3"', '"world"')
    assert loaded(tmp_path, taken, free_flyer=True).frame_on_joint("ground")[0] == 0


def test_a_root_that_floats_already_is_not_made_floating(tmp_path: Path) -> None:
    text = tree(5).replace('<link name="l0"/>', '<link name="w"/><link name="l0"/><joint name='
                           '"up" type="floating"><parent link="w"/><child link="l0"/></joint>')
    with pytest.raises(sp.MechanismFileError, match="'l0' floats on joint 'up' already"):
        loaded(tmp_path, text, free_flyer=True)
    assert free_bases(loaded(tmp_path, text)) == ("up",)


def test_the_name_of_the_root_joint_must_be_free(tmp_path: Path) -> None:
    with pytest.raises(sp.MechanismFileError, match="there is a joint 'root_joint' already"):
        loaded(tmp_path, tree(5).replace('"j3"', '"root_joint"'), free_flyer=True)


def test_free_flyer_is_true_or_false() -> None:
    with pytest.raises(TypeError, match="free_flyer is True or False, not 1"):
        sp.load("rssr", free_flyer=1)


def test_a_mechanism_on_a_free_base_changes_its_dimensions() -> None:
    mechanism = library("rssr", free_flyer=True)
    state = sp.assemble(mechanism, {"crank": 0.1})
    fixed = library("rssr")
    there = sp.assemble(fixed, {"crank": 0.1})
    found, expected = (sp.sensitivity(m, x, "rocker_pin", ["d"])
                       for m, x in ((mechanism, state), (fixed, there)))
    assert found.derivatives["d"] == pytest.approx(expected.derivatives["d"], rel=1e-8)


# ---------------------------------------------------------------- held


@pytest.mark.delicate
def test_which_floating_joints_are_free_bases() -> None:
    assert free_bases(library("four_bar")) == ()
    assert free_bases(library("stewart")) == ()
    assert free_bases(library("stewart", free_flyer=True)) == ("root_joint",)


def test_a_held_base_is_the_ground(pair: tuple[sp.Mechanism, sp.Mechanism]) -> None:
    fixed, free = pair
    driver = next(iter(fixed.drivers))
    c = fixed.coordinate(driver)
    step = 0.3 if c.unit == "rad" else 0.05 * fixed.characteristic_length
    values = sp.assemble(fixed).coordinate(driver).value + np.linspace(0.0, step, 30)
    one = sp.sweep(fixed, driver, values, speed=2.0)
    other = sp.sweep(free, driver, values, speed=2.0, guess=moved(free))
    assert other.q[:, 7:] == pytest.approx(one.q, abs=1e-12)
    for mine, theirs in ((one.v, other.v), (one.a, other.a)):
        assert theirs[:, 6:] == pytest.approx(mine, abs=1e-12 * max(1.0, np.abs(mine).max()))
        assert np.all(theirs[:, :6] == 0.0)
    assert np.ptp(other.q[:, :7], axis=0) == pytest.approx(np.zeros(7), abs=1e-14)


def test_the_jacobian_of_a_held_base_is_that_of_the_ground_turned(
    pair: tuple[sp.Mechanism, sp.Mechanism]
) -> None:
    fixed, free = pair
    one, other = sp.assemble(fixed), sp.assemble(free, {}, moved(free))
    turn = np.kron(np.eye(2), pin.exp3(np.array(POSE[3:])))
    link = fixed.links[-1]
    expected = turn @ sp.jacobian(fixed, one, link)
    assert sp.jacobian(free, other, link) == pytest.approx(expected, abs=1e-12)
    whole = sp.jacobian(free, other, link, hold=None)
    assert whole[:, :-6] == pytest.approx(expected, abs=1e-12)
    tip = pinocchios(free, other.q, link)[:, :6]
    assert whole[:, -6:] == pytest.approx(tip, abs=1e-12)


def test_parts_of_a_base_are_held(tmp_path: Path) -> None:
    mechanism = loaded(tmp_path, tree(0), free_flyer=True)
    state = random_state(mechanism, 0)
    whole = pinocchios(mechanism, state.q, "l8")
    for hold, kept in (("base", []), ("root_joint", []), (None, range(6)), ([], range(6)),
                       ("root_joint.rotation", range(3)), ("root_joint.translation", range(3, 6)),
                       (["root_joint.translation", "root_joint.rotation"], [])):
        found = sp.jacobian(mechanism, state, "l8", hold=hold)
        assert found == pytest.approx(whole[:, [*range(6, 14), *kept]], abs=1e-13)


def test_held_drivers_have_no_column(tmp_path: Path) -> None:
    mechanism = loaded(tmp_path, tree(0))
    state = random_state(mechanism, 0)
    whole = pinocchios(mechanism, state.q, "l8")
    found = sp.jacobian(mechanism, state, "l8", hold=["j2", "base"])
    assert found == pytest.approx(np.delete(whole, mechanism.coordinate("j2").v, axis=1))
    with pytest.raises(ValueError, match="'j2' is held, and is to move too"):
        sp.solve_rates(mechanism, state, {"j2": 1.0}, hold=["j2"])
    with pytest.raises(sp.UnknownNameError, match="j22"):
        sp.jacobian(mechanism, state, "l8", hold=["j22"])


def test_a_base_goes_as_prescribed(tmp_path: Path) -> None:
    mechanism = loaded(tmp_path, tree(0), free_flyer=True)
    state = random_state(mechanism, 0)
    twist = np.arange(1.0, 7.0)
    assert sp.solve_rates(mechanism, state, {"root_joint": twist}).v == pytest.approx(
        [*twist, *np.zeros(8)], abs=1e-14)
    motion = sp.sweep(mechanism, "root_joint.z", np.linspace(0.0, 0.5, 6))
    assert motion.frame("l8").velocity == pytest.approx(np.tile([0.0, 0.0, 1.0], (6, 1)))


def test_a_base_that_nobody_holds_is_not_determined(tmp_path: Path) -> None:
    mechanism = loaded(tmp_path, tree(0), free_flyer=True)
    with pytest.raises(sp.SingularError, match=r"6 of its freedoms are not .*root_joint\.rz"):
        sp.sweep(mechanism, "j2", [0.0, 0.1], hold=None)
    with pytest.raises(sp.SingularError, match=r"6 of its freedoms are not .*root_joint\.rz"):
        sp.solve_rates(mechanism, sp.assemble(mechanism), {"j2": 1.0}, hold=None)


def test_the_refusal_of_a_base_that_nobody_holds_says_what_holds_it(tmp_path: Path) -> None:
    """The remedy is one that works: the base by its word, not coordinate by coordinate."""
    mechanism = loaded(tmp_path, tree(0), free_flyer=True)
    for hold in (None, ["j1"]):
        with pytest.raises(sp.SingularError) as refused:
            sp.sweep(mechanism, "j2", [0.0, 0.1], hold=hold)
        assert "nothing holds the free base" in str(refused.value)
        assert "hold=['base'])" in str(refused.value)
    assert len(sp.sweep(mechanism, "j2", [0.0, 0.1], hold=["base"])) == 2


def test_a_base_is_held_whatever_was_computed_before() -> None:
    one, other = (library("rssr", free_flyer=True) for _ in range(2))
    states = [sp.assemble(m, {"crank": 0.3}) for m in (one, other)]
    first = [sp.jacobian(one, states[0], "rocker", hold=h) for h in ("base", None)]
    second = [sp.jacobian(other, states[1], "rocker", hold=h) for h in (None, "base")]
    assert np.array_equal(first[0], second[1]) and np.array_equal(first[1], second[0])


def test_values_and_a_base_are_held_together() -> None:
    fixed, free = library("delta"), library("delta", free_flyer=True)
    names = list(fixed.drivers)
    start = sp.assemble(fixed)
    hold = {names[1]: start.coordinate(names[1]).value + 0.05}
    values = start.coordinate(names[0]).value + np.linspace(0.0, 0.1, 5)
    one, other = (sp.sweep(m, names[0], values, hold=hold) for m in (fixed, free))
    assert other.q[:, 7:] == pytest.approx(one.q, abs=1e-12)
    by_name = sp.sweep(free, names[0], values, hold=["base", names[1]])
    assert np.ptp(by_name.coordinate(names[1]).value) == 0.0


@pytest.mark.delicate
def test_a_closed_mechanism_on_a_free_base_has_its_modes_and_limits() -> None:
    fixed, free = library("four_bar"), library("four_bar", free_flyer=True)
    driver = next(iter(fixed.drivers))
    modes = [sp.assembly_modes(m, {driver: 0.4}) for m in (fixed, free)]
    assert len(modes[0]) == len(modes[1]) == 2
    for one, other in zip(*modes, strict=True):
        assert other.q[7:] == pytest.approx(one.q, abs=1e-9)
    assert str(sp.limits(free, driver)) == str(sp.limits(fixed, driver))


@pytest.mark.delicate
def test_a_free_base_counts_six_freedoms_that_need_no_driver() -> None:
    found = sp.mobility(library("rssr", free_flyer=True))
    assert (found.dof, len(found.passive)) == (8, 1)
    assert "more driver(s) needed" not in str(found)
    assert "root_joint carries all of it as a free base" in str(found)
    assert "free base" not in str(sp.mobility(library("rssr")))


def test_a_base_falls_while_its_joints_are_driven_by_nobody() -> None:
    free = library("four_bar", free_flyer=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = sp.forward_dynamics(free, sp.assemble(free))
    masses = np.array([x.mass for x in free.model.inertias])
    assert masses.sum() > 0.0
    state = sp.assemble(free)
    model, data = free.model, free.model.createData()
    centre = pin.centerOfMass(model, data, state.q, state.v, found.a)
    assert data.acom[0] == pytest.approx([0.0, 0.0, -9.81], abs=1e-9)
    assert np.isfinite(centre).all()


def test_a_tree_is_saved_with_the_drivers_it_has(tmp_path: Path) -> None:
    bare = loaded(tmp_path, tree(5))
    for drivers in (dict(bare.drivers), {"turn": sp.Driver("turn", "j2")}, {}):
        mechanism = replace(bare, drivers=drivers)
        again = sp.load(mechanism.save(tmp_path / f"saved_{len(drivers)}"))
        assert again.drivers == drivers


def test_a_free_base_is_saved(tmp_path: Path) -> None:
    mechanism = library("rssr", free_flyer=True)
    again = sp.load(mechanism.save(tmp_path / "saved"))
    assert list(again.coordinates) == list(mechanism.coordinates)
    assert free_bases(again) == ("root_joint",)


def test_joints_with_springs_are_held_by_one_word(tmp_path: Path) -> None:
    (tmp_path / "tree.urdf").write_text(tree(7, serial=True))
    toml = tmp_path / "sprung.toml"
    toml.write_text('name = "sprung"\ntree = "tree.urdf"\n' + "".join(
        f'[drivers.j{k}]\njoint = "j{k}"\n' for k in range(3, 9)) + "".join(
        f'[[springs]]\nname = "s{k}"\njoint = "j{k}"\nstiffness = 5.0\n' for k in (1, 2)))
    mechanism = sp.load(toml, free_flyer=True)
    state = random_state(mechanism, 7)
    words = r"2 of its freedoms .* more of .*hold=\['base', 'springs'\] stops the joints"
    with pytest.raises(sp.SingularError, match=words):
        sp.jacobian(mechanism, state, "l8")
    columns = [mechanism.coordinate(name).v for name in mechanism.drivers]
    expected = pinocchios(mechanism, state.q, "l8")[:, columns]
    for hold in (["base", "springs"], ["base", "j1", "j2"]):
        assert sp.jacobian(mechanism, state, "l8", hold=hold) == pytest.approx(expected, abs=1e-13)
        motion = sp.sweep(mechanism, "j5", np.linspace(0.0, 0.4, 5), hold=hold)
        assert np.ptp(motion.coordinate("j1").value) == 0.0
        assert motion.state(3).rate_error < 1e-12


def test_the_rate_of_a_jacobian_of_a_released_base_is_its_derivative(tmp_path: Path) -> None:
    mechanism = loaded(tmp_path, tree(6), free_flyer=True)
    state = random_state(mechanism, 6)
    rng = np.random.default_rng(6)
    speeds = dict(zip(mechanism.drivers, rng.normal(size=8).tolist(), strict=True))
    moving = sp.solve_rates(mechanism, state, {**speeds, "root_joint": rng.normal(size=6)})
    found = sp.jacobian_rate(mechanism, moving, "l8", hold=None)
    h, ends = 1e-5, []
    for step in (h, -h):
        q = pin.integrate(mechanism.model, state.q, step * moving.v)
        ends.append(sp.jacobian(mechanism, sp.assemble(mechanism, {}, q), "l8", hold=None))
    assert found == pytest.approx((ends[0] - ends[1]) / (2 * h), abs=1e-7)
    accel = sp.influence(mechanism, moving, hold=None)
    assert accel.first == pytest.approx(
        np.vstack([np.hstack([np.zeros((6, 8)), np.eye(6)]), np.eye(8, 14)]), abs=1e-14)


def test_a_robot_in_the_air_moves_as_a_free_body(tmp_path: Path) -> None:
    mechanism = loaded(tmp_path, tree(2), free_flyer=True)
    motion = sp.simulate(mechanism, sp.assemble(mechanism), 0.1, times=np.linspace(0.0, 0.1, 5))
    model, data = mechanism.model, mechanism.model.createData()
    heights = [pin.centerOfMass(model, data, q)[2] for q in motion.q]
    fallen = np.array(heights) - heights[0]
    assert fallen == pytest.approx(-0.5 * 9.81 * np.linspace(0.0, 0.1, 5) ** 2, abs=1e-8)


@pytest.mark.slow
@pytest.mark.delicate
def test_limits_and_traces_hold_what_is_named() -> None:
    fixed, free = library("delta"), library("delta", free_flyer=True)
    one, *others = fixed.drivers
    expected = sp.limits(fixed, one)
    for hold in ("base", ["base", *others]):
        found = sp.limits(free, one, hold=hold)
        assert found.lower.value == pytest.approx(expected.lower.value, abs=1e-11)
        assert found.upper.value == pytest.approx(expected.upper.value, abs=1e-8)  # branches cross
    curves = [sp.trace(fixed, one, step=0.1),
              sp.trace(free, one, step=0.1, hold=["base", *others])]
    assert curves[1].q[:, 7:] == pytest.approx(curves[0].q, abs=1e-9)
    with pytest.raises(sp.SingularError, match="6 of its freedoms are not prescribed"):
        sp.limits(free, one, hold=others)


def test_efforts_of_what_floats_are_refused_in_words() -> None:
    free = library("four_bar", free_flyer=True)
    with pytest.raises(sp.SpatialPinError, match=r"root_joint floats freely"):
        sp.inverse_dynamics(free, sp.assemble(free))


# ---------------------------------------------------------------- joints that are called "base"

TURRET = """<robot name="turret"><link name="ground"/><link name="L1"/><link name="L2"/>
<link name="tip"/>
<joint name="base" type="continuous"><parent link="ground"/><child link="L1"/>
  <axis xyz="0 0 1"/></joint>
<joint name="arm" type="continuous"><parent link="L1"/><child link="L2"/><origin xyz="1 0 0"/>
  <axis xyz="0 1 0"/></joint>
<joint name="end" type="fixed"><parent link="L2"/><child link="tip"/><origin xyz="1 0 0"/></joint>
</robot>"""


@pytest.fixture
def turret(tmp_path):
    (tmp_path / "turret.urdf").write_text(TURRET)
    return sp.load(tmp_path / "turret.urdf")


def test_a_hinge_that_is_called_base_is_no_free_base(turret):
    """It moves as any other joint does, unless it is held by its name."""
    state = sp.assemble(turret, {"base": 0.3, "arm": 0.4})
    assert sp.jacobian(turret, state, "tip").shape == (6, 2)
    assert sp.jacobian(turret, state, "tip", hold="base").shape == (6, 1)
    motion = sp.sweep(turret, "base", [0.0, 0.5], speed=2.0)
    np.testing.assert_allclose(motion.v, [[2.0, 0.0]] * 2)
    target = sp.assemble(turret, {"base": 1.0, "arm": -0.7}).placement("tip").translation
    found = sp.reach(turret, {"tip": target}, state)
    np.testing.assert_allclose(found.placement("tip").translation, target, atol=1e-12)
    with pytest.raises(sp.ReachError):
        sp.reach(turret, {"tip": target}, state, hold="base")
    for hold in ("base", ["base"]):
        with pytest.raises(ValueError, match="'base' is held"):
            sp.sweep(turret, "base", [0.0, 0.5], hold=hold)
    assert sp.limits(turret, "base").full_turn
    assert sp.solve_rates(turret, state, {"base": 1.0, "arm": 2.0}).v.tolist() == [1.0, 2.0]


def test_what_was_held_is_known_of_stored_motions(turret, tmp_path):
    for hold, held in (({}, False), ({"hold": "base"}, True)):
        motion = sp.sweep(turret, "arm", [0.0, 0.5], speed=2.0, **hold)
        for twin in (sp.Motion.load(motion.save(tmp_path / "motion"), turret),
                     pickle.loads(pickle.dumps(motion))):
            assert twin.held == motion.held
            assert (twin.held == ("base",)) == held


def test_a_free_base_may_be_called_base(tmp_path):
    """It stands still while something else moves, and moves if it is driven."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    model.appendBodyToJoint(joint, pin.Inertia.Random(), pin.SE3.Identity())
    arm = model.addJoint(joint, pin.JointModelRX(), pin.SE3.Identity(), "arm")
    model.appendBodyToJoint(arm, pin.Inertia.Random(), pin.SE3.Identity())
    mechanism = sp.Mechanism.from_model(model, drivers=["arm"], name="flyer")
    moved = sp.sweep(mechanism, "base.x", [0.0, 0.5], speed=1.0)
    np.testing.assert_allclose(moved.v[:, 0], 1.0)
    stands = sp.sweep(mechanism, "arm", [0.0, 0.5], speed=1.0)
    assert not stands.v[:, :6].any()


@pytest.mark.parametrize("far", [1e3, 5e6, 1e7])
def test_loops_on_a_free_base_move_alike_far_from_the_origin(far):
    """Their coordinates are known to round-off of the base's place, not of their own size."""
    model = pin.Model()
    base = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")

    def add(parent, name, x):
        joint = model.addJoint(parent, pin.JointModelRZ(),
                               pin.SE3(np.eye(3), np.array([x, 0.0, 0.0])), name)
        model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
        return joint

    coupler = add(add(base, "crank", 0.0), "coupler", 0.1)
    rocker = add(base, "rocker", 0.4)
    ends = [(joint, pin.SE3(np.eye(3), np.array([length, 0.0, 0.0])))
            for joint, length in ((coupler, 0.4), (rocker, 0.3))]
    mechanism = sp.Mechanism.from_model(
        model, [sp.closures.revolute(*((model.names[j], place) for j, place in ends), name="pin")],
        drivers=["crank"], guess={"crank": 1.0, "coupler": -0.5, "rocker": 1.5})
    q = sp.assemble(mechanism).q.copy()
    values = np.linspace(1.0, 3.0, 101)
    near = sp.sweep(mechanism, "crank", values, speed=1.0, guess=q)
    q[:3] = far, far / 3.0, 0.0
    motion = sp.sweep(mechanism, "crank", values, speed=1.0, guess=q)
    for found, wanted in ((motion.q, near.q), (motion.v, near.v)):
        assert np.abs(found - wanted)[:, 7:].max() < 1e-14 * far


@pytest.mark.parametrize("setting", ["engineering", "draft"])
def test_a_held_base_stands_exactly_whatever_the_last_digits_of_its_quaternion(
    setting: str
) -> None:
    mech, rng = library("four_bar", free_flyer=True), np.random.default_rng(5)
    values, accuracy = np.linspace(0.0, 25.0, 721), sp.Accuracy.named(setting)
    for turned in rng.normal(size=(25, 3)):
        start = sp.assemble(mech, {"crank": 0.0}, {"root_joint": [0.1, 0.2, 0.3, *turned]}).q.copy()
        at = slice(mech.model.idx_qs[1], mech.model.idx_qs[1] + 7)
        start[at] += 1.5e-16 * rng.normal(size=7)
        base = sp.sweep(mech, "crank", values, guess=start, accuracy=accuracy).q[:, at]
        assert (base == base[0]).all()
        assert base[0] == pytest.approx(start[at], abs=1e-15)
        table = sp.follow(mech, {"crank": values}, values, guess=start, accuracy=accuracy).q[:, at]
        assert (table == table[0]).all()
