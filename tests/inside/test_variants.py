"""Mechanisms at other dimensions from one expansion of their xacro file."""

import math
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from kernel_checks import evaluated

import spatial_pin as sp
from spatial_pin.dimensions import sensitivity, variants
from spatial_pin.dimensions.homotopy import varied
from spatial_pin.dimensions.variants import DimensionNumbers, Variants
from spatial_pin.formats.xacro.tracing import NUMPY, Tape, Traced, depends
from spatial_pin.kernel.kernel import Kernel, address, packed

EPS = np.finfo(float).eps
AXES = ("rspc",)  # the directions of its joints follow from a dimension
FEW = [pytest.param(name, marks=() if name in ("rssr", "rspc") else pytest.mark.slow)
       for name in sp.list_mechanisms()]


@pytest.fixture
def loads(monkeypatch):
    """Mechanisms that were loaded again."""
    found = []
    monkeypatch.setattr(variants, "varied", lambda *x: (found.append(x[1]), varied(*x))[1])
    return found


def other(mechanism: sp.Mechanism, seed: int = 0) -> dict[str, float]:
    normal = np.random.default_rng(seed).normal(size=len(mechanism.dimensions))
    return {name: value * (1.0 + 0.003 * x) + 1e-5 * (value == 0.0) * x
            for (name, value), x in zip(mechanism.dimensions.items(), normal, strict=True)}


def same(one: sp.Mechanism, two: sp.Mechanism, length: float) -> None:
    """All that has a say in how they move is the same to round-off."""
    (a, own), (b, other) = ((packed(x, True), x.model) for x in (one, two))
    assert np.array_equal(a.ints, b.ints) and np.array_equal(a.carriers, b.carriers)
    for x, y in ((a.parts(), b.parts()), (a.indices(), b.indices())):
        for part in ("rotation", "translation", "local"):
            assert getattr(x, part) == pytest.approx(getattr(y, part), abs=8 * EPS * (1 + length))
    assert list(own.names) == list(other.names)
    for x, y in zip(own.frames, other.frames, strict=True):
        assert x.placement.translation == pytest.approx(y.placement.translation,
                                                        abs=8 * EPS * length)
    assert one.characteristic_length == pytest.approx(two.characteristic_length, rel=8 * EPS)
    for name, inertia in one.inertias.items():
        assert two.inertias[name].lever == pytest.approx(inertia.lever, abs=8 * EPS * length)
        assert two.inertias[name].mass == pytest.approx(inertia.mass, rel=16 * EPS)
    for x, y in zip(own.inertias, other.inertias, strict=True):
        assert x.toDynamicParameters() == pytest.approx(
            y.toDynamicParameters(), rel=1e-12, abs=1e-15 * (1.0 + x.mass))
    for x, y in ((one.model.lowerPositionLimit, two.model.lowerPositionLimit),
                 (one.model.upperPositionLimit, two.model.upperPositionLimit)):
        assert np.array_equal(np.isfinite(x), np.isfinite(y))
        assert x == pytest.approx(y, rel=8 * EPS)
    assert one.dimensions == two.dimensions and one.parameters == two.parameters


@pytest.mark.parametrize("name", FEW)
def test_library_mechanisms_are_those_that_loading_gives(name, loads):
    mechanism = sp.load(name)
    made, dimensions = Variants(mechanism, mechanism.dimensions), other(mechanism)
    found = made.at(dimensions)
    assert bool(loads) == (name in AXES)
    same(varied(mechanism, dimensions), found, mechanism.characteristic_length)
    first = next(iter(dimensions))
    some = {first: dimensions[first]}
    same(varied(mechanism, some), made.several([dimensions, some])[1],
         mechanism.characteristic_length)


def alike(one: sp.Mechanism, two: sp.Mechanism) -> None:
    """All that their files say is the same, numbers to round-off."""
    for a, b in zip(*(ET.fromstring(x.urdf).iter() for x in (one, two)), strict=True):
        assert (a.tag, a.text, a.keys()) == (b.tag, b.text, b.keys())
        changed = [key for key in a.attrib if a.get(key) != b.get(key)]
        x, y = ([float(word) for key in changed for word in part.get(key).split()]
                for part in (a, b))
        assert x == pytest.approx(y, rel=64 * EPS, abs=64 * EPS * np.abs([1.0, *y]).max())
    assert [c.name for c in one.closures] == [c.name for c in two.closures]
    assert (one.notices, one.path, one.tree, one.loading) == (
        two.notices, two.path, two.tree, two.loading)
    assert one.dimensions == two.dimensions
    for a, b in zip(one.model.inertias, two.model.inertias, strict=True):
        x, y = a.toDynamicParameters(), b.toDynamicParameters()
        assert x == pytest.approx(y, rel=1e-12, abs=1e-15 * (1.0 + np.abs(y).max()))
    for part in ("damping", "friction", "armature", "upperEffortLimit", "upperVelocityLimit",
                 "upperPositionLimit", "lowerPositionLimit"):
        assert getattr(one.model, part) == pytest.approx(getattr(two.model, part), rel=8 * EPS)
    for a, b in ((one.visual_model, two.visual_model), (one.collision_model, two.collision_model)):
        for x, y in zip(a.geometryObjects, b.geometryObjects, strict=True):
            assert (x.name, x.parentJoint) == (y.name, y.parentJoint)
            assert x.placement.isApprox(y.placement, 1e-12)


@pytest.mark.parametrize("name", FEW)
def test_whole_mechanisms_are_those_that_loading_gives(name, loads):
    """Masses and shapes too, and axes that turn."""
    mechanism = sp.load(name)
    made = Variants(mechanism, mechanism.dimensions)
    for seed in range(2):
        dimensions = other(mechanism, seed)
        alike(made.whole(dimensions), varied(mechanism, dimensions))
    assert not loads


@pytest.mark.parametrize("name", [
    "rssr", *(pytest.param(name, marks=pytest.mark.slow) for name in (
        "four_bar", "slider_crank", "delta", "excavator"))])
def test_masses_and_clearances_of_whole_mechanisms_are_those_of_loaded_ones(name, loads):
    mechanism = sp.load(name)
    dimensions = other(mechanism, 5)
    driver = next(iter(mechanism.drivers))
    found = []
    for one in (Variants(mechanism, mechanism.dimensions).whole(dimensions),
                varied(mechanism, dimensions)):
        start = sp.assemble(one)
        value = start.coordinate(one.drivers[driver].joint).value
        motion = sp.sweep(one, driver, value + np.linspace(0.0, 0.1, 3), guess=start)
        found.append([[x.mass for x in one.model.inertias],
                      [pair.distance for pair in sp.clearance(motion).pairs],
                      *sp.kinetostatics(one, motion).efforts.values()])
    for a, b in zip(*found, strict=True):
        assert a == pytest.approx(b, rel=1e-9, abs=1e-11)
    assert len(found[0]) > 2 and not loads


@pytest.mark.parametrize("name", FEW)
def test_derivatives_are_those_of_loaded_mechanisms(name, monkeypatch):
    mechanism = sp.load(name)
    driver, dimension = next(iter(mechanism.drivers)), next(iter(mechanism.dimensions))
    start = sp.assemble(mechanism)
    value = start.coordinate(mechanism.drivers[driver].joint).value
    state = sp.solve_rates(mechanism, sp.assemble(mechanism, {driver: value + 0.05}, guess=start),
                           {driver: 2.0})
    moved = [c for c in mechanism.coordinates if c != mechanism.drivers[driver].joint]
    outputs = [f"{moved[-1]}{kind}" for kind in ("", ".rate", ".acceleration")]

    def derivatives():
        found = sensitivity.sensitivities(mechanism, state, outputs, [dimension])
        return [(x.derivatives[dimension], x.errors[dimension]) for x in found]

    new = derivatives()
    monkeypatch.setattr(Variants, "tree", None)
    for (a, error), (b, _) in zip(new, derivatives(), strict=True):
        assert a == pytest.approx(b, abs=3.0 * error)


@pytest.mark.parametrize("name", FEW)
def test_numbers_of_the_kernel_are_those_of_loaded_mechanisms(name):
    """Placements, closure equations, their derivatives and rates of the bodies."""
    mechanism, dimensions = sp.load(name), []
    tree = Variants(mechanism, mechanism.dimensions).tree
    for seed in range(3):
        dimensions.append(other(mechanism, seed))
    found = tree.at(np.array([[x[k] for x in dimensions] for k in tree.dimensions]))
    numbers = DimensionNumbers(mechanism, tree, []).at(found)
    kernel, rng = Kernel(mechanism), np.random.default_rng(4)
    q = pin.integrate(mechanism.model, mechanism.neutral,
                      rng.uniform(-1, 1, kernel.nv) * mechanism.velocity_scale)
    v, turns = rng.normal(size=kernel.nv) * mechanism.velocity_scale, np.zeros(kernel.n_angles)
    for own, varied_numbers in zip(dimensions, numbers.varied, strict=True):
        reals = numbers.base.copy()
        reals[numbers.indices] = varied_numbers
        kernel.library.kernel_set_numbers(kernel.handle, address(reals), len(reals))
        one, two = (evaluated(x, q, v, turns) for x in (kernel, Kernel(varied(mechanism, own))))
        for a, b in list(zip(one, two, strict=True))[tree.turns_axes:]:  # bodies' axes turn too
            assert a == pytest.approx(b, abs=16 * EPS * (1.0 + np.abs(b).max(initial=0.0)))


TREE = """<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:arg name="a" default="0.3"/><xacro:arg name="b" default="-0.2"/>
  <xacro:property name="a" value="$(arg a)"/><xacro:property name="b" value="$(arg b)"/>
  <link name="ground"/>
  <joint name="pin" type="continuous"><parent link="ground"/><child link="{child}"/>
    <origin xyz="{x} 0 0" rpy="0 {y} 0"/><axis xyz="0 0 1"/></joint>
  <link name="{child}"/>{more}
  <joint name="mount" type="fixed"><parent link="{child}"/><child link="tip"/>
    <origin xyz="0 {z} 0"/></joint><link name="tip"/>
</robot>"""


def planar(folder: Path, x="0", y="0", z="0", child="arm", more="") -> sp.Mechanism:
    (folder / "r.urdf.xacro").write_text(TREE.format(x=x, y=y, z=z, child=child, more=more))
    (folder / "r.toml").write_text('name = "r"\ntree = "r.urdf.xacro"\n')
    return sp.load(folder / "r.toml")


@pytest.mark.parametrize("formula", [
    "${a * b - b / a + a**2 - 2**b}", "-${a}", "${-b}", "+${a}",
    "${math.sin(a) + math.atan2(a, b) + math.hypot(a, b) + math.dist([a, 0], [1, b])}",
    "${min(a, b) + max(a, b, 0) + python.abs(b)}", "${python.sum([a, b])}",
    "${a if a > 0.25 else 2 * a}", "${int(10 * a) * b}", "${[a, b][1] + dict(x=a).x}",
    "${[float(w) for w in '{} 1'.split()][0] * a}".replace("{}", "2"), "${$(arg b) - $(arg a)}",
    "${2 - $(arg b)}", "$(eval a - b)", "${a % 0.1}", "${a // 0.07}", "${math.log(a, 2) - a}",
    "${float(str(b)) * 2}", "${[float(w) for w in (str(a) + ' ' + str(b)).split()][1]}",
])
def test_formulas_are_followed(formula, tmp_path, loads):
    mechanism = planar(tmp_path, formula, formula, formula)
    made = Variants(mechanism, ["a", "b"])
    for dimensions in ({"a": 0.31, "b": -0.21}, {"a": 0.302}, {"b": -0.197}):
        same(made.at(dimensions), varied(mechanism, dimensions), 1.0)
        alike(made.whole(dimensions), varied(mechanism, dimensions))
    assert not loads


@pytest.mark.parametrize(("formula", "dimensions"), [
    ("${a if a > 0.25 else 2 * a}", {"a": 0.2}), ("${max(a, b)}", {"a": -0.3}),
    ("${int(10 * a) * b}", {"a": 0.5}),
])
def test_where_the_file_decides_otherwise_it_is_loaded(formula, dimensions, tmp_path, loads):
    mechanism = planar(tmp_path, formula)
    made = Variants(mechanism, ["a", "b"])
    made.at({"a": 0.301})
    assert not loads
    same(made.at(dimensions), varied(mechanism, dimensions), 1.0)
    alike(made.whole(dimensions), varied(mechanism, dimensions))
    assert loads == [dimensions] * 2


@pytest.mark.parametrize("change", [
    {"x": "${round(a, 2)}"}, {"x": "${'%.3f' % a}"}, {"x": "${('%s' % a)[:4]}"},
    {"x": "${len(str(a))}"}, {"x": "${float(str(a).replace('-', ''))}"}, {"child": "arm_${a}"},
    {"more": "<gazebo><a>${a}</a></gazebo>"}, {"x": "${1 if str(a) == '0.3' else 2}"},
    {"x": "${dict([(a, 1)])[a]}"}, {"x": "${a}e0"}, {"x": "${math.gamma(a + 3)}"},
    {"x": "${math.fsum([a, b])}"}, {"x": "${1 if a in [b, 0.3] else a}"},
])
def test_what_cannot_be_followed_is_loaded(change, tmp_path, loads):
    mechanism = planar(tmp_path, **change)
    dimensions = {"a": 0.3123, "b": -0.2}
    made = Variants(mechanism, ["a", "b"])
    same(made.at(dimensions), varied(mechanism, dimensions), 1.0)
    alike(made.whole(dimensions), varied(mechanism, dimensions))
    assert loads == [dimensions] * 2


def test_a_number_within_a_word_of_a_shape_is_loaded(tmp_path, loads):
    """How it moves can be followed then, but not what its file says."""
    shape = "<link name='ball'><visual><geometry><sphere radius='{}'/></geometry></visual></link>"
    joint = ("<joint name='more' type='fixed'><parent link='ground'/><child link='ball'/></joint>")
    dimensions = {"a": 0.3123}
    for radius, times in (("${a}", 0), ("${a}e-1", 1)):
        mechanism = planar(tmp_path, "${a}", more=shape.format(radius) + joint)
        made = Variants(mechanism, ["a", "b"])
        same(made.at(dimensions), varied(mechanism, dimensions), 1.0)
        assert not loads
        alike(made.whole(dimensions), varied(mechanism, dimensions))
        assert len(loads) == times


def test_a_mechanism_without_a_xacro_file_is_loaded(tmp_path):
    (tmp_path / "r.urdf").write_text('<robot name="r"><link name="a"/></robot>')
    mechanism = sp.load(tmp_path / "r.urdf")
    with pytest.raises(sp.SpatialPinError):
        Variants(mechanism, []).at({"a": 1.0})


# ---------------------------------------------------------------- the tape


@pytest.mark.parametrize("value", [
    0.0, -0.0, 1.0, -1.0, 0.1, 2.0 / 3.0, 1.0 - 2.0**-53, 1.0 + 2.0**-52, 2.0 - 2.0**-52, 5e-324,
    2.2250738585072014e-308, -1.7976931348623157e308, 9.999999999999999e22,
])
def test_the_reference_to_a_number_is_read_as_that_number(value):
    tape = Tape({"other": 1.0, "it": value})
    text = tape.text(1)
    assert text.startswith("-") == (math.copysign(1.0, value) < 0.0)
    number = tape.read(f" {text} ")
    assert tape.is_whole and number is not None and float.__eq__(number, value)
    (found,), _ = tape.at(np.array([[1.0], [7.25]]), [number.row])
    assert found == 7.25
    assert depends([text]) and depends({"a": number}) and not depends(["0.5", 1.0, None])


def test_a_text_of_another_tape_is_not_taken_for_one_of_its_own():
    tape = Tape({"x": 0.5})
    tape.read(Tape({"x": 0.5, "y": 0.25}).text(1))
    assert not tape.is_whole


@pytest.mark.parametrize("function", [f for f in NUMPY if f is not math.dist],
                         ids=lambda f: f.__name__)
def test_functions_of_numpy_are_those_of_math(function):
    two = function in (math.atan2, math.hypot, math.pow, math.fmod, math.copysign)
    for x in (0.3, 0.7, 1.3):
        if x > 1.0 and function in (math.asin, math.acos, math.atanh):
            continue
        x = x + 1.0 if function is math.acosh else x
        given = (x, 0.4) if two else (x,)
        assert NUMPY[function](*given) == pytest.approx(function(*given), rel=4 * EPS)


def test_arithmetic_is_that_of_numbers():
    tape = Tape({"x": 0.75, "y": -1.5})
    x, y = tape.number(0), tape.number(1)
    found = [x + y, 1 - x, x - 1, 2 * y, x / y, 3 / x, x**2, 2**x, -y, +x, abs(y), y // x, x % 0.5]
    given = np.array([[0.7], [-1.6]])
    a, b = 0.7, -1.6
    expected = [a + b, 1 - a, a - 1, 2 * b, a / b, 3 / a, a**2, 2**a, -b, a, abs(b), b // a,
                a % 0.5]
    numbers, holds = tape.at(given, [z.row for z in found])
    assert all(isinstance(z, Traced) for z in found) and holds.all()
    assert numbers[:, 0].tolist() == expected
    assert tape.at(np.array([[0.0], [1.0]]), [found[5].row])[1].tolist() == [False]
