"""A kind of closure is one entry in the table of pairs: a sum of quantities of any form.

Two kinds that the library does not have are added here, a pair of gears on crossed axes and a point
on a spline, and go from a mechanism file through all that the library does.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from closure_trees import check_derivatives, pose, refinement
from derivative_cases import check
from folders import ROOT
from kernel_checks import asked_at, assert_same_as_pinocchio
from mechanisms import closure, driver, floating, load, point
from mpmath import atan2, cos, exp, mp, sin, taylor
from scipy.interpolate import PPoly, make_interp_spline

import spatial_pin as sp
from spatial_pin.accuracy.extended import Extended
from spatial_pin.cli import main
from spatial_pin.constraints.compiled_equations import ANGLE, COORDINATE, PRODUCT, Constraints
from spatial_pin.constraints.composed_equations import composed_rates
from spatial_pin.constraints.pinocchio_views import joint_jacobian
from spatial_pin.kernel import kernel
from spatial_pin.kernel.loop_equations import LoopEquations, loops_at
from spatial_pin.mechanism.equations import (
    Angle,
    ConstraintEquation,
    Cosine,
    Displacement,
    FunctionOf,
    JointCoordinate,
)
from spatial_pin.mechanism.pairs import PAIRS, Key, Pair
from spatial_pin.numerics.piecewise import Piecewise
from spatial_pin.numerics.taylor import Taylor, argument

# ---------------------------------------------------------------- series


def series(function, order: int = 3) -> Taylor:
    return Taylor([float(c) for c in taylor(function, 0, order)])


def test_products_and_angles_of_series_are_those_of_functions():
    x, y = (lambda t: sin(t + 1) * exp(t)), (lambda t: cos(2 * t + 1) + t**3)
    for found, function in (
            (series(x) * series(y) - 2.0 * series(x) + 1.0, lambda t: x(t) * y(t) - 2 * x(t) + 1),
            (argument(series(x), series(y)), lambda t: atan2(x(t), y(t)))):
        with mp.workdps(30):
            expected = [float(c) for c in taylor(function, 0, 3)]
        np.testing.assert_allclose(found.values, expected, rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("order", [0, 1, 2])
def test_changes_are_derivatives_by_a_second_parameter(order):
    h = 1e-5
    slope = np.array([0.3, -0.7, 0.2])[: order + 1]
    other = np.array([-0.5, 0.1, 0.4])[: order + 1]
    s, c = np.array([0.6, 1.0, -0.5])[: order + 1], np.array([-0.2, 0.7, 0.9])[: order + 1]

    def of(e: float) -> Taylor:
        sine, cosine = Taylor([*(s + e * slope)]), Taylor([*(c + e * other)])
        return sine * cosine - argument(sine, cosine, 7.0)

    sine, cosine = Taylor([*s], [*slope]), Taylor([*c], [*other])
    found = sine * cosine - argument(sine, cosine, 7.0)
    assert found.values == of(0.0).values
    for k in range(order + 1):
        expected = (of(h).values[k] - of(-h).values[k]) / (2.0 * h)
        assert found.changes[k] == pytest.approx(expected, rel=1e-8, abs=1e-8)


# ---------------------------------------------------------------- two new kinds


def crossed_gears(c: sp.Closure) -> tuple[ConstraintEquation, ...]:
    """z1 * angle 1 + z2 * angle 2 = 0, of two gears relative to the carrier of both, frame 1."""
    first, second = c.numbers["teeth"] / np.max(c.numbers["teeth"])
    one, two = c.geometry.axes1, c.geometry.axes2
    return (ConstraintEquation((
        (float(first), (Angle(one, one, (0, 1)),)), (float(second), (Angle(two, two, (0, 2)),)))),)


def on_spline(c: sp.Closure) -> tuple[ConstraintEquation, ...]:
    """Origin 2 lies where a quintic spline through points, in frame 1, has the parameter s."""
    x, y, z = (c.numbers[key] for key in "xyz")
    ends = np.arange(len(x), dtype=float)
    pieces = [PPoly.from_spline(make_interp_spline(ends, row, k=5)) for row in (x, y, z)]
    curves = [Piecewise(p.x[5:-5], p.c[::-1, 5:-5].T.copy()) for p in pieces]
    return tuple(ConstraintEquation(((1.0, (Displacement(e),)),
                                     (-1.0, (FunctionOf(f, JointCoordinate(0)),))), is_length=True)
                 for e, f in zip(np.eye(3), curves, strict=True))


def cam(c: sp.Closure) -> tuple[ConstraintEquation, ...]:
    """slide - rise * sine * cosine of the turn: what a cam with two lobes would do."""
    x, y, z = c.geometry.axes1.T
    of = c.geometry.axes2[:, 0]
    lobes = (-c.numbers["rise"], (Cosine(y, of), Cosine(x, of)))
    return (ConstraintEquation(((1.0, (Displacement(z),)), lobes), is_length=True),)


def on_third(c: sp.Closure) -> tuple[ConstraintEquation, ...]:
    """The origin of frame 3 lies in the plane of y and z of frame 1; frame 2 does not matter."""
    return (ConstraintEquation(((1.0, (Displacement(np.array([1.0, 0.0, 0.0]), (0, 2)),)),),
                               is_length=True),)


BESIDE = Pair(5, on_third, uses_axis=False, n_frames=3)
CAM = Pair(5, cam, keys=(Key("rise"),))
GEARS = Pair(5, crossed_gears, uses_axis2=True, n_frames=3, keys=(Key("teeth", is_list=True),))
SPLINE = Pair(3, on_spline, uses_axis=False, n_joints=1,
              keys=tuple(Key(key, is_list=True) for key in "xyz"))


@pytest.fixture(autouse=True)
def new_kinds(monkeypatch):
    """What a kind costs: one entry in `PAIRS`."""
    monkeypatch.setitem(PAIRS, "crossed_gears", GEARS)
    monkeypatch.setitem(PAIRS, "on_spline", SPLINE)
    monkeypatch.setitem(PAIRS, "cam", CAM)
    monkeypatch.setitem(PAIRS, "beside", BESIDE)


LINK = """<link name="{}"><inertial><origin xyz="0.1 0.02 0.03"/><mass value="{}"/>
<inertia ixx="0.03" iyy="0.02" izz="0.04" ixy="0" ixz="0.001" iyz="0"/></inertial></link>"""
JOINT = """<joint name="{}" type="{}"><parent link="{}"/><child link="{}"/>
<origin xyz="{}" rpy="{}"/><axis xyz="{}"/>
<limit effort="1" velocity="1" lower="-100" upper="100"/></joint>"""
# an arm carries both gears of a pair, the second one moves a crank of its own
GEARED = "\n".join([
    '<robot name="geared" xmlns:xacro="http://www.ros.org/wiki/xacro">',
    '<xacro:arg name="reach" default="0.4"/><xacro:property name="reach" value="$(arg reach)"/>',
    '<link name="ground"/>', LINK.format("arm", 2.0), LINK.format("gear_1", 0.5),
    LINK.format("gear_2", 0.7),
    JOINT.format("shoulder", "continuous", "ground", "arm", "0 0 0.2", "0.3 0 0", "0 0 1"),
    JOINT.format("pin_1", "continuous", "arm", "gear_1", "0.1 0 0", "0 0 0", "0 0 1"),
    JOINT.format("pin_2", "continuous", "arm", "gear_2", "${reach} 0 0.1", "0 0 0", "0.6 0 0.8"),
    "</robot>"])
TEETH = '''
[[closures]]
name = "teeth"
type = "crossed_gears"
frames = ["arm", "gear_1", "gear_2"]
axis = [0, 0, 1]
axis2 = [0.6, 0, 0.8]
teeth = [17, 40]
[drivers.arm]
joint = "shoulder"
[drivers.gear]
joint = "pin_1"
'''
# a point of a lever's slider follows a spline; s is the coordinate of a slide without mass
TRACKED = "\n".join([
    '<robot name="tracked" xmlns:xacro="http://www.ros.org/wiki/xacro">',
    '<xacro:arg name="height" default="0.1"/><xacro:property name="height" value="$(arg height)"/>',
    '<link name="ground"/><link name="marker"/>', LINK.format("lever", 2.0),
    LINK.format("slider", 0.5), LINK.format("rod", 0.3), '<link name="tip"/>',
    JOINT.format("s", "prismatic", "ground", "marker", "0 0 0", "0 0 0", "1 0 0"),
    JOINT.format("hinge", "continuous", "ground", "lever", "0 0 ${height}", "0 0 0", "0 0 1"),
    JOINT.format("slide", "prismatic", "lever", "slider", "0 0 0", "0 0 0", "1 0 0"),
    JOINT.format("lift", "prismatic", "slider", "rod", "0 0 0", "0 0 0", "0 0 1"),
    JOINT.format("end", "fixed", "rod", "tip", "0 0 0", "0 0 0", "0 0 1"),
    "</robot>"])
T = np.linspace(-0.7, 0.7, 9)
POINTS = {"x": 0.5 * np.cos(T), "y": 0.6 * np.sin(T), "z": 0.1 + 0.05 * np.sin(3 * T)}
TRACK = '''
[[closures]]
name = "track"
type = "on_spline"
frames = ["ground", "tip"]
joints = ["s"]
''' + "".join(f"{key} = {[round(float(x), 6) for x in row]}\n" for key, row in POINTS.items()) + '''
[drivers.lever]
joint = "hinge"
[guess]
hinge = 0.0
slide = 0.5
s = 4.0
'''


def made(folder, kind: str) -> sp.Mechanism:
    tree, name = (GEARED, "geared") if kind == "gears" else (TRACKED, "tracked")
    (folder / f"{name}.urdf.xacro").write_text(tree)
    path = folder / f"{name}.toml"
    path.write_text(f'name = "{name}"\ntree = "{name}.urdf.xacro"\n' +
                    (TEETH if kind == "gears" else TRACK))
    return sp.load(path)


SPEEDS = {"gears": {"arm": 1.3, "gear": -0.7}, "spline": {"lever": 1.1}}
VALUES = {"gears": {"arm": 0.4, "gear": 0.9}, "spline": {"lever": 0.25}}
both = pytest.mark.parametrize("kind", ["gears", "spline"])


def moving(mechanism: sp.Mechanism, kind: str) -> sp.State:
    accelerations = {name: 0.3 * x for name, x in SPEEDS[kind].items()}
    return sp.solve_rates(mechanism, sp.assemble(mechanism, VALUES[kind]), SPEEDS[kind],
                          accelerations)


@both
def test_a_kind_is_one_entry_and_the_kernel_is_as_exact_as_pinocchio(tmp_path, kind):
    mechanism = made(tmp_path, kind)
    state = moving(mechanism, kind)
    assert state.closure_error < 1e-14
    rng = np.random.default_rng(2)
    for _ in range(4):
        q = pin.integrate(mechanism.model, state.q, 0.2 * rng.normal(size=mechanism.model.nv))
        v = rng.normal(size=mechanism.model.nv)
        check_derivatives(LoopEquations(mechanism), q, v)
        assert_same_as_pinocchio(mechanism, q, v)


@pytest.mark.parametrize("joint", ["revolute", "spherical"])
def test_an_equation_may_multiply_quantities(tmp_path, joint):
    rng = np.random.default_rng(3)
    tree = floating("to_a", "ground", "a", **pose(rng)) + floating("to_b", "a", "b", **pose(rng))
    tree += point("at_a", "ground", **pose(rng)) + point("at_b", "b", **pose(rng))
    toml = refinement("to_a", joint, rng) + refinement("to_b", "cylindrical", rng)
    mechanism = load(tmp_path, "lobes", tree, toml + driver("turn", "to_b.angle") + closure(
        "c", "cam", "at_a", "at_b", rise=0.4))
    for _ in range(5):
        q, v = asked_at(mechanism, rng)
        check_derivatives(LoopEquations(mechanism), q, v)
        assert_same_as_pinocchio(mechanism, q, v)
    (terms,) = Constraints(mechanism).sums
    p = rng.normal(size=(4, 3))  # of its products, derivatives 0 to 3: the rule of Leibniz
    third = p[3, 1] * p[0, 2] + 3 * (p[2, 1] * p[1, 2] + p[1, 1] * p[2, 2]) + p[0, 1] * p[3, 2]
    found = composed_rates(Constraints(mechanism), list(p), [], np.zeros(1))
    assert found == pytest.approx(p[3, 0] + terms[1][0] * third, rel=1e-14)


def test_the_kinds_of_quantities_are_numbered_as_in_the_kernel():
    text = (ROOT / "spatial_pin" / "kernel" / "core" / "kernel.h").read_text()
    for name, code in (("PRODUCT", kernel.PRODUCT), ("SUM", kernel.SUM), ("IDLE", kernel.IDLE),
                       ("OF_PRODUCT", PRODUCT), ("COORDINATE", COORDINATE), ("ANGLE", ANGLE)):
        assert f" {name} = {code}" in text


def among_others(folder) -> sp.Mechanism:
    """The gears on their arm, the second one beside a loop that another arm closes."""
    tree = GEARED.replace("</robot>", "\n".join([
        LINK.format("slider", 0.4), LINK.format("rod", 0.3), LINK.format("spindle", 0.2),
        JOINT.format("slot", "prismatic", "ground", "slider", "0.7 0.1 0.2", "0.1 0.2 0", "1 0 0"),
        JOINT.format("knee", "continuous", "slider", "rod", "0 0 0", "0 0 0", "0 0 1"),
        JOINT.format("nut", "continuous", "ground", "spindle", "0 0 0", "0 0 0", "0 0 1"),
        '<link name="tip"/>',
        JOINT.format("end", "fixed", "rod", "tip", "-0.3 0 0", "0 0 0", "0 0 1"), "</robot>"]))
    (folder / "among.urdf.xacro").write_text(tree)
    others = '''
[[closures]]
name = "rest"
type = "point_on_plane"
frames = ["arm", "tip"]
axis = [0, 1, 0]
[[closures]]
name = "third"
type = "beside"
frames = ["ground", "slider", "tip"]
[[closures]]
name = "thread"
type = "coupling"
joints = ["nut", "shoulder"]
ratio = 1.5
'''
    path = folder / "among.toml"
    path.write_text('name = "among"\ntree = "among.urdf.xacro"\n' + TEETH + others)
    return sp.load(path)


def test_equations_are_right_in_any_company(tmp_path):
    """An angle's products are no neighbours here, and a plain equation acts on its third frame."""
    mechanism, rng = among_others(tmp_path), np.random.default_rng(4)
    q = pin.integrate(mechanism.model, mechanism.neutral, rng.normal(size=mechanism.model.nv))
    v = rng.normal(size=mechanism.model.nv)
    check_derivatives(LoopEquations(mechanism), q, v)
    assert_same_as_pinocchio(mechanism, q, v)
    first, second = (q[mechanism.coordinate(name).q] for name in ("pin_1", "pin_2"))
    rows = loops_at(mechanism, q)
    teeth = rows.residual[rows.constraints.closure_of.index("teeth")]
    assert teeth == pytest.approx(17 / 40 * first + second, abs=1e-13)
    state = sp.State(mechanism, q, v)
    judged = Extended(mechanism).rows(q[None].astype(np.longdouble), v[None].astype(np.longdouble),
                                      0.0 * v[None].astype(np.longdouble), state.angles[None])
    assert judged[0][0] == pytest.approx(rows.residual, abs=1e-14)
    pulls = rows.row_wrenches()  # virtual work: what rows do is their wrenches on two bodies
    columns = joint_jacobian(rows.data, mechanism.model.nv)
    support, c = rows.constraints.supports, rows.constraints
    work = np.zeros((c.n_closure, mechanism.model.nv))
    ends = [(k, k, [mechanism.frame_on_joint(f)[0] for f in closure.frames[:2]])
            for closure in mechanism.closures if closure.frames
            for k in [c.closure_of.index(closure.name)]]
    ends += [(row, c.n_closure + k, both) for k, (row, _, both) in enumerate(c.other_body_products)]
    for row, wrench, (one, two) in ends:
        work[row] += (pulls[wrench] @ columns) * (support[two] - support[one])
    work[c.of_joints] += rows.joint_rows()
    assert work * mechanism.velocity_scale == pytest.approx(rows.jacobian[: c.n_closure], abs=1e-13)
    assert sp.mobility(mechanism).dof == 2
    closed = sp.assemble(mechanism, {"arm": 0.3, "gear": 0.5})
    assert closed.coordinate("pin_2").value == pytest.approx(-17 / 40 * 0.5, abs=1e-13)
    check(mechanism, sp.solve_rates(mechanism, closed, {"arm": 0.7, "gear": -0.4}),
          {"shoulder": 0.3, "pin_1": 0.2}, 3e-3, 1e-9)


def test_gears_on_crossed_axes_turn_by_their_teeth_over_many_turns(tmp_path):
    mechanism = made(tmp_path, "gears")
    motion = sp.follow(mechanism, {"arm": np.linspace(0.0, 3.0, 200),
                                   "gear": np.linspace(0.0, 60.0, 200)})
    found = motion.coordinate("pin_2").value
    np.testing.assert_allclose(found, -17 / 40 * motion.coordinate("pin_1").value, atol=1e-12)
    assert sp.mobility(mechanism).dof == 2
    assert sp.assemble(mechanism, {"gear": 50.0}).coordinate("pin_2").value == pytest.approx(
        -17 / 40 * 50.0, abs=1e-12)


def test_a_point_follows_its_spline_to_the_third_derivative(tmp_path):
    mechanism = made(tmp_path, "spline")
    s = np.arange(9.0)
    curve = [make_interp_spline(s, np.round(row, 6), k=5) for row in POINTS.values()]
    motion = sp.sweep(mechanism, "lever", np.linspace(-0.5, 0.5, 41), speed=2.0)
    at = motion.coordinate("s")
    tip = motion.frame("tip")
    for k, x in enumerate(curve):
        np.testing.assert_allclose(tip.position[:, k], x(at.value), atol=1e-13)
        np.testing.assert_allclose(tip.velocity[:, k], x(at.value, 1) * at.rate, atol=1e-12)
        np.testing.assert_allclose(
            tip.acceleration[:, k],
            x(at.value, 2) * at.rate**2 + x(at.value, 1) * at.acceleration, atol=1e-11)
    state = moving(mechanism, "spline")
    jerks = sp.solve_jerks(mechanism, state, {"lever": 0.2})
    v, r, a, j = (*(state.coordinate("s")), jerks.coordinate("s"))
    jerk = [x(v, 3) * r**3 + 3 * x(v, 2) * r * a + x(v, 1) * j for x in curve]
    np.testing.assert_allclose(jerks.frame("tip").linear, jerk, rtol=1e-10)


@both
def test_the_independent_judge_knows_it(tmp_path, kind):
    mechanism = made(tmp_path, kind)
    state = moving(mechanism, kind)
    rows = Extended(mechanism).rows(*(x[None].astype(np.longdouble) for x in (
        state.q, state.v, state.a)), state.angles[None])
    assert np.abs(rows[0]).max() < 1e-15 and np.abs(rows[1:]).max() < 1e-13


@both
def test_forces_and_their_derivatives_are_those_of_work(tmp_path, kind):
    mechanism = made(tmp_path, kind)
    state = moving(mechanism, kind)
    inverse = sp.inverse_dynamics(mechanism, state)
    joints = {d: mechanism.drivers[d].joint for d in mechanism.drivers}
    forward = sp.forward_dynamics(mechanism, state, {
        joints[d]: x for d, x in inverse.efforts.items()})
    np.testing.assert_allclose(forward.a, state.a, rtol=1e-10, atol=1e-10)
    check(mechanism, state, {joints[d]: x for d, x in inverse.efforts.items()}, 3e-3, 1e-9)


@both
def test_energy_is_conserved_where_it_falls_freely(tmp_path, kind):
    mechanism = made(tmp_path, kind)
    state = sp.solve_rates(mechanism, sp.assemble(mechanism, VALUES[kind]), SPEEDS[kind])
    motion = sp.simulate(mechanism, state, 0.3, accuracy=sp.Accuracy.named("reference"))
    assert motion.closure_error.max() < 1e-12
    assert abs(motion.energy_drift) < 1e-8 * np.abs(motion.energy).max()


@both
def test_it_is_written_and_read_back(tmp_path, kind):
    mechanism = made(tmp_path, kind)
    state = sp.assemble(mechanism, VALUES[kind])
    again = sp.load(mechanism.save(tmp_path / "copy"))
    np.testing.assert_allclose(sp.assemble(again, VALUES[kind]).q, state.q, atol=1e-13)
    assert [c.numbers.keys() for c in again.closures] == [
        c.numbers.keys() for c in mechanism.closures]


@both
def test_pages_and_the_command_line_show_it(tmp_path, kind, capsys):
    mechanism = made(tmp_path, kind)
    file = str(mechanism.path)
    driver, value = next(iter(VALUES[kind].items()))
    assert main(["info", file]) == 0
    assert ("crossed_gears" if kind == "gears" else "on_spline") in capsys.readouterr().out
    assert main(["sweep", file, driver, "0", str(value), "--html", str(tmp_path / "a.html")]) == 0
    assert (tmp_path / "a.html").stat().st_size > 10_000


def test_what_a_dimension_changes_is_what_differences_say(tmp_path):
    mechanism = made(tmp_path, "spline")
    state = sp.assemble(mechanism, VALUES["spline"])
    found = sp.sensitivity(mechanism, state, "lift", ["height"])
    assert found.derivatives["height"] == pytest.approx(-1.0, abs=1e-9)  # the track stays


@both
def test_what_no_output_needs_is_omitted(tmp_path, kind):
    mechanism = made(tmp_path, kind)
    output = "gear_2.position" if kind == "gears" else "tip.position"
    reduced = sp.reduce(mechanism, [output])
    assert reduced.verify().worst < 1e-9


def test_wrong_numbers_of_a_kind_are_named(tmp_path):
    made(tmp_path, "gears")
    path = tmp_path / "geared.toml"
    path.write_text(path.read_text().replace("teeth = [17, 40]", 'teeth = ["a"]'))
    with pytest.raises(sp.MechanismFileError, match="teeth"):
        sp.load(path)
    path.write_text(path.read_text().replace('"gear_1", "gear_2"]', '"gear_1"]'))
    with pytest.raises(sp.MechanismFileError, match="three names"):
        sp.load(path)
