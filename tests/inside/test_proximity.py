"""Inside of clearances: hulls of meshes, distances of solids, what lies between samples."""

from __future__ import annotations

import struct

import coal
import numpy as np
import pytest
from carriers import arm, ball, solid
from hypothesis import example, given, strategies as st
from loaded_library import library
from scipy.spatial.transform import Rotation

import spatial_pin as sp
from spatial_pin.motion.default_motion import default_motion
from spatial_pin.proximity.clearance_search import Between
from spatial_pin.proximity.distances import nearest, segments_apart
from spatial_pin.proximity.solids import SUPPORTS, ConvexSolid, hulls, solids_of
from spatial_pin.view.scene.film import film
from spatial_pin.view.scene.meshcat_commands import scene

PAIR = [("post", "crank")]
# Over a whole turn, or to their limits: far outside of its workspace the rods of a pair of the
# delta robot come to lie in one line, however thin they are.
OVERLAP = {"delta": {("rod_2a", "rod_2b"), ("rod_3a", "rod_3b"), ("rod_1a", "rod_3a"),
                     ("rod_1b", "rod_2b")}}


def test_a_mesh_is_the_hulls_of_its_connected_parts(tmp_path):
    """Two boxes in one mesh: a ball passes between them."""
    box = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * 0.1
    faces = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1), (2, 3, 7),
             (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)]
    triangles = [box[list(f)] + [0.0, 0.0, side] for side in (-0.3, 0.3) for f in faces]
    body = b"".join(struct.pack("<12fH", 0, 0, 0, *t.ravel(), 0) for t in triangles)
    (tmp_path / "two.stl").write_bytes(bytes(80) + struct.pack("<I", len(triangles)) + body)
    ground = solid('<mesh filename="two.stl"/>', (1.0, 0.0, 0.0))
    mechanism = arm(tmp_path, ground, ball(0.05, 1.0))
    assert len([s for s in solids_of(mechanism) if s.link == "post"]) == 2
    motion = sp.sweep(mechanism, "turn", np.linspace(-1.0, 1.0, 21))
    assert sp.clearance(motion, PAIR).least.distance == pytest.approx(0.15, abs=1e-8)


def test_a_flat_part_of_a_mesh_has_a_distance():
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]])
    flat, = hulls(square, np.array([[0, 1, 2], [0, 2, 3]]))
    result, there = coal.DistanceResult(), coal.Transform3s()
    there.setTranslation(np.array([0.5, 0.5, 1.0]))
    apart = coal.distance(flat, coal.Transform3s(), coal.Sphere(0.25), there,
                          coal.DistanceRequest(), result)
    assert apart == pytest.approx(0.75, abs=1e-6)


# ---------------------------------------------------------------- solids that overlap

SHAPES = {
    "box": lambda a, b, c: coal.Box(a, b, c),
    "sphere": lambda a, b, c: coal.Sphere(a),
    "cylinder": lambda a, b, c: coal.Cylinder(a, b),
    "capsule": lambda a, b, c: coal.Capsule(a, b),
    "cone": lambda a, b, c: coal.Cone(a, b),
    "ellipsoid": lambda a, b, c: coal.Ellipsoid(a, b, c),
}
SIZES = st.tuples(*[st.floats(0.05, 1.0)] * 3)


def placed(shape, seed: int) -> tuple[ConvexSolid, coal.Transform3s]:
    rng = np.random.default_rng(seed)
    shape.computeLocalAABB()
    frame = coal.Transform3s()
    frame.setRotation(Rotation.random(random_state=rng).as_matrix())
    frame.setTranslation(rng.normal(size=3) * 0.4)
    return ConvexSolid("", 0, np.eye(3), np.zeros(3), shape, np.zeros(3), shape.aabb_radius,
                 np.zeros(3), shape.aabb_radius), frame


@given(st.sampled_from(sorted(SHAPES)), st.sampled_from(sorted(SHAPES)), SIZES, SIZES,
       st.integers(0, 1000))
@example("cylinder", "cone", (0.05000000000000001, 0.5887742445735251, 1.0),
         (0.9477363483439257, 0.4123244314193745, 1.0), 345)  # apart, and coal finds half of it
def test_no_direction_holds_two_solids_farther_apart_than_their_distance(a, b, one, two, seed):
    first, at_first = placed(SHAPES[a](*one), seed)
    second, at_second = placed(SHAPES[b](*two), seed + 5000)
    found = nearest(first, at_first, second, at_second)
    ways = np.random.default_rng(seed).normal(size=(2000, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    own, other = at_first.getRotation(), at_second.getRotation()
    last = SUPPORTS[type(first.shape)](first.shape, ways @ own) @ own.T
    start = SUPPORTS[type(second.shape)](second.shape, -ways @ other) @ other.T
    between = at_second.getTranslation() - at_first.getTranslation()
    apart = np.sum(ways * (start - last + between), axis=1)
    assert found.distance >= apart.max() - 1e-4
    gap = np.linalg.norm(found.points[1] - found.points[0])
    assert gap == pytest.approx(abs(found.distance), abs=1e-4)


@pytest.mark.slow
def test_library_mechanisms_pass_or_are_known_to_overlap():
    for name in sp.list_mechanisms():
        motion = default_motion(library(name), rows=13)
        found = sp.clearance(motion)
        touching = {tuple(sorted(pair.links)) for pair in found.touching}
        assert touching == OVERLAP.get(name, set()), f"{name}: {found}"


# ---------------------------------------------------------------- motions


SEGMENT = st.tuples(*[st.floats(-1.0, 1.0)] * 3)


@given(SEGMENT, SEGMENT, SEGMENT, st.booleans())
def test_segments_are_as_far_apart_as_a_search_finds_them(between, first, second, alike):
    between, first, second = map(np.array, (between, first, first if alike else second))
    found = float(segments_apart(between[None], first[None], second[None])[0])
    # the points of one segment, each with its nearest of the other
    points = between + np.linspace(-1.0, 1.0, 2001)[:, None] * first
    size = float(second @ second)
    t = np.clip(points @ second / size, -1.0, 1.0) if size > 0.0 else np.zeros(len(points))
    searched = np.linalg.norm(points - t[:, None] * second, axis=1).min()
    assert found == pytest.approx(searched, abs=2e-3)
    assert found <= searched + 4e-6 * (1.0 + np.linalg.norm(first) + np.linalg.norm(second))


def test_configurations_between_samples_are_those_of_a_finer_sweep():
    for name in ("rssr", "four_bar", "spherical_four_bar"):
        mechanism = library(name)
        driver = next(iter(mechanism.drivers))
        fine = sp.sweep(mechanism, driver, np.linspace(0.0, 1.0, 41), speed=2.0)
        coarse = sp.sweep(mechanism, driver, np.linspace(0.0, 1.0, 11), speed=2.0)
        between = Between(coarse)
        for k in range(40):
            row, part = divmod(k, 4)
            state = fine.state(k)
            for found, error in ((between.at(row, part / 4), 1e-5),
                                 (between.closed(row, part / 4), 1e-12)):
                for link in mechanism.links:
                    there = sp.assemble(mechanism, {}, found).placement(link)
                    gap = there.translation - state.placement(link).translation
                    assert np.abs(gap).max() < error, (name, k)
            assert between.value(row, part / 4) == pytest.approx(fine.driver[k])


def test_links_are_red_as_long_as_they_touch(tmp_path):
    mechanism = arm(tmp_path, ball(0.1, 1.0, 0.5), ball(0.05, 1.0))
    motion = sp.sweep(mechanism, "turn", np.linspace(-1.0, 2.0, 31))
    found = sp.clearance(motion, PAIR)
    layer = scene(film(motion), sp.Look(clearance=found)).layer
    red = [item for item in layer.items if item.name.startswith("touching")]
    assert {item.name.split()[1] for item in red} == {"post", "crank"}
    for item in red:
        assert np.array_equal(item.track.scales[:, 0] > 0.0, found.least.distances <= 0.0)
    line = next(item for item in layer.items if item.name == "clearance post and crank")
    assert line.track.scales[:, 2] == pytest.approx(np.abs(found.least.distances), abs=1e-9)
    alarm, = layer.alarms
    assert alarm.name == "post and crank"
    assert np.array_equal(alarm.values > 0.0, found.least.distances < 0.0)
