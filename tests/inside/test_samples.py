"""A Monte Carlo over dimensions: all samples together are what load and assemble make of each."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from closure_trees import JOINTS, KEYS, TYPES
from loaded_library import library
from mechanisms import closure
from variety import few

import spatial_pin as sp
from spatial_pin.dimensions import homotopy, tolerance as module
from spatial_pin.dimensions.varied_samples import DriverMotion, VariedSamples

SAMPLES, COMPARED = 240, 3
CRANK = {"crank": 0.8}


def write(folder: Path, tree: str, toml: str, **dimensions: float) -> Path:
    """Write a mechanism whose tree knows the dimensions by name."""
    known = "".join(f'<xacro:arg name="{k}" default="{v!r}"/>'
                    f'<xacro:property name="{k}" value="$(arg {k})"/>\n'
                    for k, v in dimensions.items())
    (folder / "m.urdf.xacro").write_text(
        '<robot name="m" xmlns:xacro="http://www.ros.org/wiki/xacro">\n'
        f'{known}<link name="ground"/>\n{tree}</robot>\n', encoding="utf-8")
    path = folder / "m.toml"
    path.write_text(f'name = "m"\ntree = "m.urdf.xacro"\n{toml}', encoding="utf-8")
    return path


def joint(kind: str, name: str, parent: str, child: str, xyz: str = "0 0 0", rpy: str = "0 0 0",
          axis: str = "0 0 1", mass: str = "") -> str:
    inertial = (f'<inertial><origin xyz="{mass}"/><mass value="1"/>'
                '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>')
    limit = '<limit lower="-9" upper="9" effort="1" velocity="1"/>' if kind == "prismatic" else ""
    return (f'<link name="{child}">{inertial if mass else ""}</link>'
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>{limit}</joint>\n')


def point(name: str, on: str, xyz: str, rpy: str = "0 0 0") -> str:
    return joint("fixed", f"{name}_mount", on, name, xyz, rpy)


def closing(kind: str, one: str, other: str, **keys: object) -> str:
    more = "".join(f"{k} = {v}\n" for k, v in keys.items())
    return (f'[[closures]]\nname = "{one}_{other}"\ntype = "{kind}"\n'
            f'frames = ["{one}", "{other}"]\n{more}')


DRIVER = '[drivers.crank]\njoint = "crank"\n'
RSSR = {"a": 0.102, "b": 0.381, "c": 0.254, "d": 0.314}


def rssr(folder: Path, passive: bool = True) -> Path:
    tree = (joint("continuous", "crank", "ground", "arm", axis="0 0 1", mass="${a / 2} 0 ${a / 9}")
            + joint("floating", "ball", "arm", "coupler", "${a} 0 0", mass="0.01 ${b / 3} 0.02")
            + joint("continuous", "rocker", "ground", "lever", "${d} 0 0", axis="0 1 0")
            + point("tip", "coupler", "${c / 9} ${b} ${-a / 3}")
            + point("end", "lever", "${-c} 0 0"))
    toml = ('[joints.ball]\ntype = "spherical"\n' + closing("spherical", "tip", "end") + DRIVER
            + ('[passive.spin]\nbody = "coupler"\naxis = ["ball", "tip"]\n' if passive else "")
            + "[guess]\nrocker = 1.23\n")
    return write(folder, tree, toml, **RSSR)


# ---------------------------------------------------------------- one by one


def draws(mechanism: sp.Mechanism, deviations: dict[str, float], n: int) -> Iterator[dict]:
    """The dimensions of the samples, drawn one number after the other."""
    rng = np.random.default_rng(0)
    for _ in range(n):
        yield {k: mechanism.dimensions[k] + x * float(rng.normal()) for k, x in deviations.items()}


def output(state: sp.State, spec: str) -> object:
    name, _, kind = spec.rpartition(".")
    table = state.mechanism.coordinate_table
    if spec in table:
        return state.coordinate(spec).value
    if name in table:
        return state.coordinate(name)._asdict()[kind]
    if name.endswith(".com"):
        return getattr(state.com(name.removesuffix(".com")), kind)
    return {
        "position": lambda: state.placement(name).translation,
        "velocity": lambda: state.velocity(name).linear,
        "acceleration": lambda: state.acceleration(name).linear,
        "angular_velocity": lambda: state.angular_velocity(name),
        "angular_acceleration": lambda: state.angular_acceleration(name),
    }[kind]()


def alone(state: sp.State, outputs: list[str], dimensions: dict) -> list | None:
    """The outputs of one sample, loaded and assembled as anybody would."""
    mechanism = state.mechanism
    drivers = {d.joint: state.coordinate(d.joint) for d in mechanism.drivers.values()}
    try:
        own = sp.assemble(sp.load(mechanism.path, **dimensions),
                          {k: x.value for k, x in drivers.items()}, state)
        if state.v.any():
            own = sp.solve_rates(own.mechanism, own, {k: x.rate for k, x in drivers.items()},
                                 {k: x.acceleration for k, x in drivers.items()})
    except sp.SpatialPinError:
        return None
    return [output(own, spec) for spec in outputs]


@pytest.fixture
def by_themselves(monkeypatch) -> list:
    """Grows by a job for every sample that is solved by itself."""
    jobs, solve = [], module._sample
    monkeypatch.setattr(module, "_sample", lambda *job: (jobs.append(job), solve(*job))[1])
    return jobs


def all_outputs(mechanism: sp.Mechanism, moving: bool) -> list[str]:
    kinds = ["", ".rate", ".acceleration"] if moving else [""]
    outputs = [c + kind for c in mechanism.coordinate_table for kind in kinds]
    kinds = ["position", *(["velocity", "acceleration", "angular_velocity",
                            "angular_acceleration"] if moving else [])]
    outputs += [f"{link}.{kind}" for link in mechanism.links[1:] for kind in kinds]
    kinds = kinds[:3]
    return outputs + [f"{link}.com.{kind}" for link, inertia in mechanism.inertias.items()
                      if inertia.mass > 0 for kind in kinds]


def check(state: sp.State, deviations: dict[str, float], by_themselves: list,
          n: int = SAMPLES, within: float = 2e-14) -> sp.dimensions.tolerance.Tolerance:
    mechanism = state.mechanism
    outputs = [x for x in all_outputs(mechanism, bool(state.v.any()))
               if x.split(".")[0] not in mechanism.drivers]
    found = module.tolerance(mechanism, outputs, deviations, state, samples=n)
    assert not by_themselves and not found.failed
    far = np.array([list(x.values()) for x in draws(mechanism, deviations, n)])
    far = np.argsort(-np.square((far - far.mean(axis=0)) / far.std(axis=0)).sum(axis=1))
    for k, dimensions in enumerate(draws(mechanism, deviations, n)):
        if k in far[:2] or k < COMPARED - 2:
            for spec, value in zip(outputs, alone(state, outputs, dimensions), strict=True):
                np.testing.assert_allclose(found.samples[spec][k], value, rtol=0, err_msg=spec,
                                           atol=within * (1 + np.abs(value).max()))
    return found


# ---------------------------------------------------------------- every kind


@pytest.mark.alike
@pytest.mark.parametrize("kind", TYPES)
def test_every_closure_between_moving_bodies(tmp_path, by_themselves, kind):
    """What the closure leaves free follows from least motion alone, in which lengths count."""
    tree = (joint("continuous", "crank", "ground", "arm", "0 0.1 ${h}", "0.3 ${tilt} 0", "0 1 0")
            + joint("floating", "pose", "ground", "body", "0.2 0 ${-h}", "${tilt} 0 0.4")
            + point("one", "arm", "${a} 0.05 ${a * h}", "0.1 0 ${tilt / 2}")
            + point("two", "body", "0.1 ${-a} 0", "${2 * tilt} 0.2 0"))
    more = KEYS.get(kind, {})
    path = write(tmp_path, tree, closure("one_two", kind, "one", "two", **more) + DRIVER,
                 a=0.3, h=0.2, tilt=0.7)
    state = sp.assemble(sp.load(path), CRANK)
    check(state, {"a": 1e-4, "h": 1e-4, "tilt": 3e-4}, by_themselves)


@pytest.mark.parametrize("kind", JOINTS)
def test_every_joint_of_the_tree(tmp_path, by_themselves, kind):
    toml = f'[joints.held]\ntype = "{kind}"\n' + ("lead = 0.02\n" if kind == "screw" else "")
    tree = (joint("continuous", "crank", "ground", "arm", "0 0.1 ${h}", "0.3 ${h} 0", "0 1 0")
            + joint("floating", "held", "arm", "body", "0.2 0 ${a}", "0 ${a} 0.4", "0.6 0 0.8")
            + joint("continuous", "last", "body", "leaf", "0 ${h} 0", axis="1 0 0")
            + point("one", "leaf", "${a} 0.05 0.3") + point("two", "ground", "0.5 ${-a} ${h}"))
    path = write(tmp_path, tree, toml + closing("point_on_plane", "two", "one") + DRIVER,
                 a=0.3, h=0.2)
    state = sp.assemble(sp.load(path), CRANK)
    check(state, {"a": 1e-4, "h": 1e-4}, by_themselves)


@pytest.mark.parametrize("passive", [True, False])
def test_rates_and_spins_of_the_rssr(tmp_path, by_themselves, passive):
    """A spin that is not resolved takes the rates of least norm."""
    mechanism = sp.load(rssr(tmp_path, passive))
    state = sp.assemble(mechanism, {"crank": 1.0})
    state = sp.solve_rates(mechanism, state, {"crank": 3.0}, {"crank": -2.0})
    check(state, dict.fromkeys(RSSR, 2e-4), by_themselves)


def test_redundant_rows_axes_that_turn_gears_and_slides(tmp_path, by_themselves):
    """A plane slider-crank closed by a spatial revolute, in a plane that the dimensions tilt."""
    tree = (joint("continuous", "crank", "ground", "arm", rpy="${tilt} 0 0")
            + joint("continuous", "pin", "arm", "rod", "${r} 0 0")
            + joint("prismatic", "slide", "ground", "block", rpy="${tilt} 0 0", axis="1 0 0")
            + joint("continuous", "gear", "ground", "wheel", "0 0 1",
                    axis="0 ${math.sin(tilt)} ${math.cos(tilt)}", mass="${r} 0 0")
            + point("one", "rod", "${l} 0 0") + point("two", "block", "0 ${e} 0"))
    toml = (closing("revolute", "one", "two") + DRIVER
            + '[[closures]]\nname = "mesh"\ntype = "coupling"\njoints = ["pin", "gear"]\n'
              'ratio = -1.7\noffset = 0.1\n[guess]\nslide = 0.5\n')
    mechanism = sp.load(write(tmp_path, tree, toml, r=0.1, l=0.35, e=0.02, tilt=0.4))
    state = sp.assemble(mechanism, CRANK)
    state = sp.solve_rates(mechanism, state, {"crank": 3.0}, {"crank": -2.0})
    check(state, {"r": 1e-4, "l": 2e-4, "e": 1e-4, "tilt": 1e-3}, by_themselves)


def test_loops_without_bodies_in_common_and_trees_without_loops(tmp_path, by_themselves):
    tree = joint("continuous", "crank", "ground", "arm", "0 ${a} 0", "${a} 0 0", mass="${a} 0 0")
    mechanism = sp.load(write(tmp_path, tree, DRIVER, a=0.3))
    state = sp.solve_rates(mechanism, sp.assemble(mechanism, CRANK), {"crank": 2.0})
    check(state, {"a": 1e-3}, by_themselves)


def test_a_thousand_library_samples_load_no_file_again(monkeypatch, by_themselves):
    """Rocker angles by the triangle of the RSSR (SEEDS B7), of dimensions drawn here again."""
    loads: list[object] = []
    for place in (module, homotopy):
        monkeypatch.setattr(place, "load", lambda *x, **y: loads.append(x))
    mechanism, deviations = library("rssr"), dict.fromkeys(RSSR, 1e-4)
    state = sp.assemble(mechanism, {"crank": 1.0})
    found = sp.tolerance(mechanism, "rocker_pin", deviations, state, samples=1000)
    drawn = np.array([list(x.values()) for x in draws(mechanism, deviations, 1000)])
    a, b, c, d = drawn.T
    expected = np.arccos((b * b - a * a - c * c - d * d + 2 * a * d * np.cos(1.0))
                         / (2 * c * (d - a * np.cos(1.0))))
    np.testing.assert_allclose(found.samples["rocker_pin"], expected, rtol=0, atol=1e-14)
    assert not loads and not by_themselves
    assert found.sampled["rocker_pin"] == pytest.approx(np.std(expected, ddof=1), rel=1e-10)


def test_a_dimension_is_followed_as_a_slide_of_the_same_length_is(tmp_path):
    """The ground's length, once a dimension and once a driver: homotopy and continuation agree."""
    tree = (joint("continuous", "crank", "ground", "arm", axis="0 1 0")
            + joint("continuous", "pin", "arm", "rod", "0.1 0 0", axis="0 1 0")
            + joint("prismatic", "slide", "ground", "block", "${r1} 0 0", axis="1 0 0")
            + joint("continuous", "rocker", "block", "beam", axis="0 1 0")
            + point("one", "rod", "0.28 0 0") + point("two", "beam", "0.24 0 0"))
    toml = (closing("revolute", "one", "two", axis=[0, 1, 0]) + DRIVER
            + '[drivers.slide]\njoint = "slide"\n[guess]\nrocker = -1.5\n')
    begin = sp.load(write(tmp_path, tree, toml, r1=0.2))
    state = sp.assemble(begin, {"crank": 0.8, "slide": 0.0})
    for length in (-0.05, 0.1, 0.2, 0.22):
        slid = sp.sweep(begin, "slide", [0.0, length], guess=state).state(1)
        held = {"crank": 0.8, "slide": 0.0}
        found = homotopy.followed(homotopy.varied(begin, {"r1": 0.2 + length}), held, state)
        for name in ("pin", "rocker"):
            assert found.coordinate(name)[0] == pytest.approx(slid.coordinate(name)[0], abs=1e-12)
    end = sp.limits(begin, "slide", state).upper.value
    with pytest.raises(sp.SpatialPinError, match="no closed configuration of this branch"):
        homotopy.followed(homotopy.varied(begin, {"r1": 0.2 + end + 1e-3}), held, state)


# ---------------------------------------------------------------- what is left to assemble


def lever(folder: Path, r1: float = 0.3) -> sp.Mechanism:
    tree = (joint("continuous", "crank", "ground", "arm", axis="0 1 0")
            + joint("continuous", "pin", "arm", "rod", "${r2} 0 0", axis="0 1 0")
            + joint("continuous", "rocker", "ground", "beam", "${r1} 0 0", axis="0 1 0")
            + point("one", "rod", "${r3} 0 0") + point("two", "beam", "${r4} 0 0"))
    toml = (closing("revolute", "one", "two", axis=[0, 1, 0]) + DRIVER
            + "[guess]\nrocker = -1.5\n")
    return sp.load(write(folder, tree, toml, r1=r1, r2=0.1, r3=0.28, r4=0.24))


@pytest.mark.parametrize("n", few([40, 80], 40))
def test_samples_that_cannot_be_closed_are_counted(tmp_path, by_themselves, n):
    """The crank stands 0.06 rad before its limit, which the dimensions move."""
    mechanism = lever(tmp_path, 0.45)
    end = sp.limits(mechanism, "crank").upper.value
    state = sp.assemble(mechanism, {"crank": end - 0.06})
    deviations = {"r1": 5e-3, "r3": 5e-3}
    found = sp.tolerance(mechanism, ["rocker"], deviations, state, samples=n)
    each = [alone(state, ["rocker"], x) for x in draws(mechanism, deviations, n)]
    closed = np.array([x[0] for x in each if x is not None])
    assert 0 < found.failed == n - len(closed) < n / 2
    assert 0 < len(by_themselves) < n
    np.testing.assert_allclose(found.samples["rocker"], closed, rtol=0, atol=1e-11)


def test_samples_far_away_stay_on_the_branch(tmp_path, by_themselves):
    mechanism = lever(tmp_path)
    state = sp.assemble(mechanism, CRANK)
    deviations = dict.fromkeys(mechanism.dimensions, 0.014)
    found = sp.tolerance(mechanism, ["rocker"], deviations, state, samples=SAMPLES)
    drawn = np.array([list(x.values()) for x in draws(mechanism, deviations, SAMPLES)])
    r1, r2, r3, r4 = drawn.T
    x, z = r2 * np.cos(0.8) - r1, r2 * np.sin(0.8)  # from the rocker's pin to the crank's end
    far = np.hypot(x, z)
    inner = np.arccos((far**2 + r4**2 - r3**2) / (2 * far * r4))
    nominal = state.coordinate("rocker").value
    gaps = [np.angle(np.exp(1j * (np.arctan2(z, x) + s * inner - nominal))) for s in (1, -1)]
    same = min(gaps, key=lambda gap: np.abs(gap).max())
    assert found.failed == 0
    np.testing.assert_allclose(found.samples["rocker"], nominal + same, rtol=0, atol=3e-14)
    assert not by_themselves


@pytest.mark.parametrize("way", few(["together", "one by one"], "together"))
def test_samples_fail_only_where_the_triangle_cannot_be_closed(monkeypatch, by_themselves, way):
    """Deviations of 5 % turn the rocker by up to a radian; the RSSR's closed form tells it all."""
    if way == "one by one":
        monkeypatch.setattr(module.VariedSamples, "of", lambda *args: None)
    mechanism = library("rssr")
    state = sp.assemble(mechanism, {"crank": 0.0})
    state = sp.solve_rates(mechanism, state, {"crank": 1.0})
    n = 600 if way == "together" else 60
    found = sp.tolerance(mechanism, "rocker_pin", {"a": 0.01, "b": 0.02, "d": 0.02}, state,
                         samples=n, seed=3)
    a, b, d = (found.dimensions[name] for name in "abd")
    c = mechanism.dimensions["c"]
    cosine = (b * b - a * a - c * c - d * d + 2 * a * d) / (2 * c * (d - a))
    np.testing.assert_array_equal(found.is_closed, np.abs(cosine) <= 1.0)
    assert found.failed == np.count_nonzero(np.abs(cosine) > 1.0) == (way == "together")
    expected = np.arccos(cosine[found.is_closed])
    assert np.abs(expected - found.nominal["rocker_pin"]).max() > (0.3 if n < 600 else 1.0)
    np.testing.assert_allclose(found.samples["rocker_pin"], expected, rtol=0, atol=2e-14)
    assert len(by_themselves) == 60 if way == "one by one" else 0 < len(by_themselves) < 10


def test_samples_are_reported_with_their_dimensions():
    mechanism = library("rssr")
    state = sp.assemble(mechanism, {"crank": 1.0})
    found = sp.tolerance(mechanism, "rocker_pin", {"b": 1e-5, "d": 2e-5}, state, samples=200)
    by = np.stack([found.dimensions[name][found.is_closed] for name in ("b", "d")])
    by -= [[mechanism.dimensions["b"]], [mechanism.dimensions["d"]]]
    slopes = np.linalg.lstsq(by.T, found.samples["rocker_pin"] - found.nominal["rocker_pin"])[0]
    linear = sp.sensitivity(mechanism, state, "rocker_pin", ["b", "d"]).derivatives
    np.testing.assert_allclose(slopes, [linear["b"], linear["d"]], rtol=1e-3)


@pytest.mark.parametrize(("formula", "side"), [
    ("${max(a, 0.3)}", -1.0), ("${0.2 if a > 0.3 else 0.21}", 1.0),
    ("${0.2 + math.fabs(a - 0.3)}", 0.0)])
def test_samples_at_which_the_file_decides_otherwise_are_made_by_themselves(
        tmp_path, by_themselves, formula, side):
    tree = (joint("continuous", "crank", "ground", "arm") + joint(
        "prismatic", "slide", "ground", "block", axis="1 0 0")
        + point("one", "arm", f"{formula} 0 0") + point("two", "block", "0.5 0 0"))
    path = write(tmp_path, tree, closing("distance", "one", "two", length=0.6) + DRIVER, a=0.3)
    state = sp.assemble(sp.load(path), CRANK)
    found = sp.tolerance(state.mechanism, "slide", {"a": 1e-3}, state, samples=60)
    others = np.count_nonzero(side * (found.dimensions["a"] - 0.3) > 0.0)
    assert len(by_themselves) == others and (0 < others < 60 or not side)
    for k, x in enumerate(draws(state.mechanism, {"a": 1e-3}, 8)):
        assert found.samples["slide"][k] == pytest.approx(alone(state, ["slide"], x)[0], abs=2e-15)


def test_frames_that_come_and_go_with_a_dimension(tmp_path, by_themselves):
    tree = (joint("continuous", "crank", "ground", "arm") + point("one", "arm", "${a} 0 0")
            + '<xacro:if value="${a > 0.3}">' + point("extra", "arm", "1 0 0") + "</xacro:if>")
    state = sp.assemble(sp.load(write(tmp_path, tree, DRIVER, a=0.3)), CRANK)
    found = sp.tolerance(state.mechanism, "one.position", {"a": 1e-3}, state, samples=60)
    drawn = np.array([x["a"] for x in draws(state.mechanism, {"a": 1e-3}, 60)])
    assert len(by_themselves) == np.count_nonzero(drawn > 0.3)
    np.testing.assert_allclose(found.samples["one.position"][:, 0], np.cos(0.8) * drawn, rtol=1e-15)


def test_dimensions_that_do_not_scatter(tmp_path, by_themselves):
    state = sp.assemble(sp.load(rssr(tmp_path)), {"crank": 1.0})
    found = sp.tolerance(state.mechanism, "rocker", {"b": 0.0}, state, samples=5)
    np.testing.assert_allclose(found.samples["rocker"], found.nominal["rocker"], atol=2e-15)


def test_outputs_that_take_one_sample_at_a_time(tmp_path, by_themselves):
    mechanism = sp.load(rssr(tmp_path))
    state = sp.solve_rates(mechanism, sp.assemble(mechanism, {"crank": 1.0}), {"crank": 2.0})
    outputs = ["rocker", "rocker.jerk"]
    found = sp.tolerance(mechanism, outputs, {"b": 1e-4}, state, samples=60)
    assert len(by_themselves) == 60
    other = sp.tolerance(mechanism, ["rocker", "rocker.ratio"], {"b": 1e-4}, state, samples=60)
    assert len(by_themselves) == 60
    np.testing.assert_allclose(found.samples["rocker"], other.samples["rocker"], atol=2e-15)
    rates = sp.tolerance(mechanism, ["rocker.rate"], {"b": 1e-4}, state, samples=60)
    np.testing.assert_allclose(2.0 * other.samples["rocker.ratio"], rates.samples["rocker.rate"],
                               rtol=1e-15)


@pytest.mark.parametrize("way", ["together", "one by one"])
def test_an_executor_changes_nothing(tmp_path, monkeypatch, by_themselves, way):
    if way == "one by one":
        monkeypatch.setattr(module.VariedSamples, "of", lambda *args: None)
    mechanism = sp.load(rssr(tmp_path))
    state = sp.assemble(mechanism, {"crank": 1.0})
    found = sp.tolerance(mechanism, "rocker", {"b": 1e-4}, state, samples=20)
    assert len(by_themselves) == 20 * (way == "one by one")
    with ThreadPoolExecutor(2) as pool:
        again = sp.tolerance(mechanism, "rocker", {"b": 1e-4}, state, samples=20, executor=pool)
    np.testing.assert_array_equal(found.samples["rocker"], again.samples["rocker"])


def test_a_sample_does_not_depend_on_the_others(tmp_path):
    """Nor on what the kernel's memory was used for before."""
    mechanism = sp.load(rssr(tmp_path))
    state = sp.assemble(mechanism, {"crank": 1.0})
    few, many = (sp.tolerance(mechanism, "rocker", dict.fromkeys(RSSR, 1e-3), state, samples=n)
                 for n in (3, 3000))
    np.testing.assert_array_equal(few.samples["rocker"], many.samples["rocker"][:3])


def test_axes_that_dimensions_turn(by_themselves):
    """Those of the RSPC: its crank's lies at an angle, its slide's joins two points."""
    mechanism = library("rspc")
    state = sp.assemble(mechanism)
    state = sp.solve_rates(mechanism, state, {"crank": 2.0}, {"crank": -1.0})
    check(state, {name: 3e-4 * (x or 1.0) for name, x in mechanism.dimensions.items()},
          by_themselves, 40, 5e-14)


def test_a_mechanism_without_dimensions_has_no_tolerances(tmp_path):
    (tmp_path / "arm.urdf").write_text('<robot name="arm"><link name="ground"/>'
                                       + joint("continuous", "crank", "ground", "arm")
                                       + "</robot>", encoding="utf-8")
    mechanism = sp.load(tmp_path / "arm.urdf")
    with pytest.raises(sp.SpatialPinError, match="no dimension 'a'"):
        sp.tolerance(mechanism, "crank", {"a": 1e-3}, samples=100)


# ---------------------------------------------------------------- what the kernel is given


def test_numbers_that_are_none_and_places_that_are_not_there(tmp_path, monkeypatch):
    """Neither ends the process, and the next sample is closed as ever."""
    mechanism = sp.load(rssr(tmp_path))
    state = sp.solve_rates(mechanism, sp.assemble(mechanism, CRANK), {"crank": 2.0})
    samples = VariedSamples.of(
        ["b"], ["rocker.acceleration", "tip.velocity"], state, DriverMotion.of(state))
    drawn = np.array([[0.381, np.nan, np.inf, 1e300, 0.0, 0.382, 0.3]])
    good, values = samples.solve(drawn)
    assert good.tolist() == [True, False, False, False, False, True, True]
    again = samples.solve(np.array([[0.382]]))[1]
    for value, alone_ in zip(values, again, strict=True):
        np.testing.assert_array_equal(value[5], alone_[0])
    geometry, numbers = samples.geometry(drawn, 1.0)
    for wrong, error, words in (
            (numbers._replace(indices=numbers.indices + 10**6), sp.SpatialPinError, "do not fit"),
            (numbers._replace(indices=numbers.indices - 10**6), sp.SpatialPinError, "do not fit"),
            (numbers._replace(base=np.zeros(3)), ValueError, "shape")):
        monkeypatch.setattr(samples, "geometry", lambda *_, wrong=wrong: (geometry, wrong))
        with pytest.raises(error, match=words):
            samples.solve(drawn)
