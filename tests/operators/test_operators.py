"""The textbook operators: worked numbers, 40-digit truth, round trips, and Pinocchio's placements.

Worked numbers are those of the lecture notes EMT 2431, worked to more digits; where the notes are
misprinted the test says so.
"""

from __future__ import annotations

import math

import mpmath as mp
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st

from spatial_pin import operators as op

PI = math.pi
DEG = PI / 180.0
ROUND_OFF = 2e-15  # of a few products of matrices with entries up to 1
DIGITS = 40

examples = settings()  # as the tests are run: few, or all
lengths = st.floats(-10.0, 10.0, allow_subnormal=False)
points = st.tuples(lengths, lengths, lengths).map(np.array)
small = st.floats(-12.0, -1.0).map(lambda e: 10.0**e)  # 1e-12 to 0.1
angles = st.one_of(
    st.floats(0.0, PI), small, small.map(lambda x: PI - x), st.sampled_from([0.0, PI / 2, PI])
)
axes = st.one_of(
    points.filter(lambda v: np.linalg.norm(v) > 1e-3).map(lambda v: v / np.linalg.norm(v)),
    st.sampled_from([s * e for e in np.eye(3) for s in (1.0, -1.0)]),
    st.sampled_from([np.array([1.0, -1.0, 0.0]) / math.sqrt(2), np.ones(3) / math.sqrt(3)]),
)
rotations = st.builds(op.rotation_matrix, axes, angles)
placements = st.builds(lambda r, p: pin.SE3(r, p), rotations, points)

every_axis = pytest.mark.parametrize("axis", "xyz")


def apart(a: pin.SE3, b: pin.SE3) -> float:
    """Greatest difference of two placements."""
    return float(np.abs(a.homogeneous - b.homogeneous).max())


def placed(joint: pin.JointModel, q: object, offset: object = (0.0, 0.0, 0.0)) -> pin.SE3:
    """Pinocchio's placement of one joint that stands at `offset`."""
    model = pin.Model()
    model.addJoint(0, joint, pin.SE3(np.eye(3), np.array(offset, dtype=float)), "joint")
    data = model.createData()
    pin.forwardKinematics(model, data, np.atleast_1d(np.array(q, dtype=float)))
    return data.oMi[1].copy()


def composite(*joints: pin.JointModel) -> pin.JointModel:
    model = pin.JointModelComposite()
    for joint in joints:
        model.addJoint(joint)
    return model


def named(kind: str, axis: str, *args: float) -> pin.JointModel:
    return getattr(pin, f"JointModel{kind}{axis.upper()}")(*args)


def exact_rotation(axis: np.ndarray, angle: object) -> mp.matrix:
    """Rodrigues' formula at 40 digits, for the axis made exactly of length 1."""
    u = [mp.mpf(float(x)) for x in axis]
    n = mp.sqrt(sum(x * x for x in u))
    x, y, z = (c / n for c in u)
    s, c = mp.sin(angle), mp.cos(angle)
    k = mp.matrix([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return mp.eye(3) + s * k + (1 - c) * k * k


# ---------------------------------------------------------------- planar (A5)


def test_tutorial_1_rotates_a_complex_point_by_165_degrees():
    a1 = 0.707 + 0.707j
    a2 = op.complex_rotation(165 * DEG) * a1
    assert a2 == pytest.approx(-0.865895 - 0.499924j, abs=7e-7)
    assert math.degrees(np.angle(a1)) == pytest.approx(45.0)
    assert math.degrees(np.angle(a2)) == pytest.approx(-150.0)  # 210
    assert op.planar_rotation_matrix(165 * DEG) @ [a1.real, a1.imag] == pytest.approx(
        [a2.real, a2.imag], abs=1e-15)
    assert op.complex_rotation_between(a1, a2) == pytest.approx(op.complex_rotation(165 * DEG))


def test_assignment_1_2_rotation_then_translation_and_back_from_three_points():
    before = np.array([[0.866, 5.0], [1.0, 1.0], [1.5, 1.0]])
    motion = op.concatenated(op.planar_rotation(PI / 2), op.planar_translation([1.0, 0.5]))
    after = op.displaced_planar(motion, before)
    assert after == pytest.approx(np.array([[-4.0, 1.366], [0.0, 1.5], [0.0, 2.0]]), abs=1e-15)
    assert op.planar_motion_from_points(before, after) == pytest.approx(motion, abs=1e-14)
    solved = np.vstack([after.T, np.ones(3)]) @ np.linalg.inv(np.vstack([before.T, np.ones(3)]))
    assert solved == pytest.approx(motion, abs=1e-13)  # eq. 17 as printed: nine equations


@examples
@given(st.floats(-PI, PI), lengths, lengths)
def test_both_orders_of_concatenation(angle, x, y):
    c, s = math.cos(angle), math.sin(angle)
    turn, shift = op.planar_rotation(angle), op.planar_translation([x, y])
    later = np.array([[c, -s, x], [s, c, y], [0, 0, 1]])
    earlier = np.array([[c, -s, c * x - s * y], [s, c, s * x + c * y], [0, 0, 1]])
    assert op.concatenated(turn, shift) == pytest.approx(later, abs=1e-14)
    assert op.concatenated(shift, turn) == pytest.approx(earlier, abs=1e-14)


@examples
@given(st.one_of(angles, angles.map(lambda x: -x)), lengths, lengths)
def test_rotation_about_a_point_leaves_it_at_rest_and_is_found_again(angle, x, y):
    motion = op.planar_rotation_about([x, y], angle)
    assert op.displaced_planar(motion, [x, y]) == pytest.approx([x, y], abs=1e-14)
    screw = op.screw_displacement("z", [x, y, 0.0], angle)
    assert apart(op.spatial_from_planar(motion), screw) < 2e-14
    center = op.rotation_center(motion)
    if abs(angle) <= op.planar.SMALLEST_ANGLE:
        assert center is None
    else:
        assert center == pytest.approx([x, y], abs=1e-14 * (1 + 1 / abs(math.sin(angle / 2))))


def test_rotation_about_a_point_with_the_signs_that_the_notes_misprint():
    c, s, x, y = math.cos(0.3), math.sin(0.3), 2.0, -5.0
    derived = [[c, -s, x - x * c + y * s], [s, c, y - x * s - y * c], [0, 0, 1]]
    assert op.planar_rotation_about([x, y], 0.3) == pytest.approx(np.array(derived), abs=1e-15)


def test_pure_translation_has_no_center():
    assert op.rotation_center(op.planar_translation([3.0, 4.0])) is None


@examples
@given(st.floats(-PI, PI), lengths, lengths)
def test_planar_operator_is_the_placement_of_the_planar_joint(angle, x, y):
    motion = op.concatenated(op.planar_rotation(angle), op.planar_translation([x, y]))
    joint = placed(pin.JointModelPlanar(), [x, y, math.cos(angle), math.sin(angle)])
    assert apart(op.spatial_from_planar(motion), joint) < ROUND_OFF
    assert apart(op.planar_placement((0, 0, 0), x, y, angle), joint) < ROUND_OFF


def test_over_determined_motion_is_of_least_squares():
    rng = np.random.default_rng(1)
    before = rng.normal(size=(9, 2))
    motion = op.planar_rotation_about([0.4, -0.2], 2.5)
    after = op.displaced_planar(motion, before) + 1e-3 * rng.normal(size=(9, 2))

    def misfit(m):
        return np.sum((op.displaced_planar(m, before) - after) ** 2)

    found = op.planar_motion_from_points(before, after, tolerance=0.01)
    assert found == pytest.approx(motion, abs=3e-3)
    for step in 1e-5 * np.eye(3):
        for sign in (1.0, -1.0):
            angle, *shift = sign * step
            near = op.concatenated(found, op.planar_rotation(angle), op.planar_translation(shift))
            assert misfit(near) > misfit(found)


@pytest.mark.parametrize(("after", "message"), [
    ([[0, 0], [2, 0], [0, 1]], "points 1 and 2|points 0 and 1"),
    ([[0, 0], [1, 0], [0, -2]], "mirrored"),
    ([[0, 0], [1, 0]], "as many"),
])
def test_points_that_no_rigid_motion_moves_are_refused(after, message):
    with pytest.raises(ValueError, match=message):
        op.planar_motion_from_points([[0, 0], [1, 0], [0, 2]], after)


def test_coincident_points_are_refused():
    with pytest.raises(ValueError, match="coincide"):
        op.planar_motion_from_points(np.ones((3, 2)), np.ones((3, 2)))


# ---------------------------------------------------------------- rotation (A6, A7)

ACCURACY_ANGLES = [
    0.0, 1e-300, 1e-20, 1e-12, 1e-8, 1e-4, 0.1, 1.0, PI / 2, 2.0, 3.0, PI - 1e-4, PI - 1e-7,
    PI - 1e-8, PI - 1e-12, PI - 1e-14, PI, -2.5, 12.3, 1e6,
]


def random_axes(n: int) -> np.ndarray:
    v = np.random.default_rng(7).normal(size=(n, 3))
    return np.vstack([v / np.linalg.norm(v, axis=1)[:, None], np.eye(3),
                      np.array([[1, 1, 0], [0, 1, -1]]) / math.sqrt(2)])


@pytest.mark.parametrize("angle", ACCURACY_ANGLES)
def test_rodrigues_against_40_digits(angle):
    with mp.workdps(DIGITS):
        for axis in random_axes(10):
            exact = exact_rotation(axis, mp.mpf(angle))
            found = op.rotation_matrix(axis, angle)
            error = max(abs(mp.mpf(float(found[i, j])) - exact[i, j])
                        for i in range(3) for j in range(3))
            assert error < 8e-16


def angle_error_of(axis, angle) -> tuple[float, float]:
    """Error of axis and of angle [rad] recovered from the correctly rounded matrix."""
    rounded = np.array(exact_rotation(axis, angle).tolist(), dtype=float)
    u, found = op.axis_angle_from_rotation(rounded)
    exact = [mp.mpf(float(x)) for x in axis]
    n = mp.sqrt(sum(x * x for x in exact))
    axis_error = max(abs(mp.mpf(float(a)) - b / n) for a, b in zip(u, exact, strict=True))
    return float(axis_error), float(abs(mp.mpf(found) - angle))


@pytest.mark.parametrize("exponent", [1, 2, 4, 6, 7, 8, 10, 12, 14])
def test_axis_and_angle_near_pi_against_40_digits(exponent):
    with mp.workdps(DIGITS):
        angle = mp.pi - mp.mpf(10) ** -exponent
        errors = np.array([angle_error_of(axis, angle) for axis in random_axes(20)])
        assert errors.max() < 1e-15


@pytest.mark.parametrize("exponent", [0, 1, 4, 8, 12, 16, 100, 300])
def test_axis_and_angle_near_zero_against_40_digits(exponent):
    with mp.workdps(DIGITS):
        angle = mp.mpf(10) ** -exponent
        errors = np.array([angle_error_of(axis, angle) for axis in random_axes(20)])
        assert errors[:, 0].max() < 1e-15
        assert errors[:, 1].max() < 1e-15 * float(angle) or exponent < 2
        assert errors[:, 1].max() < 1e-15


@examples
@given(axes, angles)
def test_axis_and_angle_are_found_again(axis, angle):
    rotation = op.rotation_matrix(axis, angle)
    u, found = op.axis_angle_from_rotation(rotation)
    assert found == pytest.approx(angle, abs=2e-15)
    assert np.abs(op.rotation_matrix(u, found) - rotation).max() < ROUND_OFF
    if 0.0 < angle < PI:
        assert u == pytest.approx(axis, abs=2e-15)


@examples
@given(axes)
def test_axis_of_a_half_turn_is_the_same_for_both_signs(axis):
    first = op.axis_angle_from_rotation(op.rotation_matrix(axis, PI))
    second = op.axis_angle_from_rotation(op.rotation_matrix(-axis, PI))
    third = op.axis_angle_from_rotation(2.0 * np.outer(axis, axis) - np.eye(3))
    assert first.angle == second.angle == third.angle == PI
    assert first.axis == pytest.approx(second.axis, abs=1e-15)
    assert first.axis == pytest.approx(third.axis, abs=1e-15)
    assert first.axis[np.argmax(np.abs(first.axis) > 1e-9)] > 0.0


def test_half_turns_about_the_coordinate_axes_are_exact():
    for axis in np.eye(3):
        found = op.axis_angle_from_rotation(2.0 * np.outer(axis, axis) - np.eye(3))
        assert np.array_equal(found.axis, axis)
        assert found.angle == PI


def test_no_rotation_has_angle_zero_and_axis_z():
    found = op.axis_angle_from_rotation(np.eye(3))
    assert found.angle == 0.0
    assert np.array_equal(found.axis, [0, 0, 1])


def test_assignment_1_1_three_turns_about_fixed_axes():
    turns = [("z", 30 * DEG), ("y", 30 * DEG), ("x", 30 * DEG)]
    rotation = op.composite_rotation(turns)
    u, angle = op.axis_angle_from_rotation(rotation)
    assert math.degrees(angle) == pytest.approx(55.77113367, abs=5e-9)
    assert u == pytest.approx([0.654654, 0.377964, 0.654654], abs=5e-7)
    moving = [(axis, angle, "moving") for axis, angle in reversed(turns)]
    assert op.composite_rotation(moving) == pytest.approx(rotation, abs=ROUND_OFF)


def test_example_3_2_with_the_sine_that_the_notes_miss_in_entry_2_1():
    a, b, g = 0.3, 0.5, 0.7
    found = op.composite_rotation([("z", a), ("y", b), ("x", g)])
    (ca, sa), (cb, sb), (cg, sg) = ((math.cos(x), math.sin(x)) for x in (a, b, g))
    derived = np.array([
        [cb * ca, -cb * sa, sb],
        [ca * sb * sg + cg * sa, -sa * sb * sg + cg * ca, -sg * cb],
        [-ca * sb * cg + sg * sa, sa * sb * cg + sg * ca, cg * cb],
    ])
    assert found == pytest.approx(derived, abs=1e-15)
    assert abs(found[1, 0] - (ca * sg + cg * sa)) > 0.1


@examples
@given(st.lists(st.tuples(axes, angles, st.sampled_from(["fixed", "moving"])), max_size=5))
def test_composite_rotation_turns_what_it_says(turns):
    rotation = np.eye(3)
    for axis, angle, about in turns:
        in_fixed_axes = axis if about == "fixed" else rotation @ axis
        rotation = np.array([pin.exp3(angle * in_fixed_axes) @ e for e in rotation.T]).T
    assert op.composite_rotation(turns) == pytest.approx(rotation, abs=1e-14)


def test_assignment_1_3():
    rotation = op.rotation_matrix(op.direction_between([0, 0, 0], [2, 2, 2 * math.sqrt(2)]),
                                  30 * DEG)
    assert rotation @ [2, 2, 1] == pytest.approx([1.456286, 2.370499, 1.122481], abs=6e-7)
    assert rotation @ [2, 2, 0] == pytest.approx([1.158919, 2.573132, 0.189469], abs=6e-7)


@examples
@given(axes, st.floats(-10.0, 10.0))
def test_rotation_is_the_placement_of_the_unaligned_revolute_joint(axis, angle):
    joint = placed(pin.JointModelRevoluteUnaligned(axis), angle)
    assert np.abs(op.rotation_matrix(axis, angle) - joint.rotation).max() < ROUND_OFF


@examples
@given(rotations)
def test_nearest_rotation_of_a_rounded_matrix(rotation):
    found = op.nearest_rotation(np.round(rotation, 3))
    assert np.abs(found.T @ found - np.eye(3)).max() < ROUND_OFF
    assert np.abs(found - rotation).max() < 2e-3
    assert np.linalg.det(found) > 0.0


# ---------------------------------------------------------------- screw (A8)


def test_example_3_5_for_both_points():
    """The notes state (0, 1, 3) and compute with (0, 1, 2)."""
    u = np.array([0.0, 1.0, 1.0]) / math.sqrt(2)
    screw = op.screw_displacement(u, [0, 0, 0], 45 * DEG, math.sqrt(2))
    found = op.displaced_points(screw, [[0, 1, 2], [0, 1, 3]])
    printed = [[0.5, 2.146447, 2.853553], [1.0, 2.292893, 3.707107]]
    assert found == pytest.approx(np.array(printed), abs=5e-7)


def test_example_3_6_screw_from_a_matrix_of_three_digits():
    """The notes sum -0.784 where r11 is -0.748."""
    rotation = op.nearest_rotation(
        [[-0.748, 0.263, 0.612], [0.608, -0.093, 0.788], [0.263, 0.963, -0.092]])
    screw = op.screw_from_placement(pin.SE3(rotation, np.array([-3.17, 5.99, 4.94])))
    assert math.degrees(screw.angle) == pytest.approx(165.0, abs=0.15)
    assert screw.direction == pytest.approx(np.array([1, 2, 2]) / 3, abs=1e-3)
    assert screw.translation == pytest.approx(6.24, abs=0.015)
    assert screw.axis_crosses("yz") == pytest.approx([0, 6, 6], abs=0.015)


def test_example_3_6_exactly():
    u = np.array([1.0, 2.0, 2.0]) / 3.0
    screw = op.screw_from_placement(op.screw_displacement(u, [0, 6, 6], 165 * DEG, 6.24))
    assert screw.angle == pytest.approx(165 * DEG, abs=1e-15)
    assert screw.direction == pytest.approx(u, abs=1e-15)
    assert screw.translation == pytest.approx(6.24, abs=1e-14)
    assert screw.axis_crosses("yz") == pytest.approx([0, 6, 6], abs=1e-13)
    assert screw.point @ screw.direction == pytest.approx(0.0, abs=1e-14)
    assert screw.lead == pytest.approx(6.24 * 360 / 165)


def test_example_3_6_rectangle_about_a_line():
    """The notes turn the wrong way about y, and their 4x4 turns by 21.5 degrees."""
    turn = op.screw_displacement(op.direction_between([0, 2, 2], [1, 4, 6]), [0, 2, 2], 30 * DEG)
    found = op.displaced_points(turn, [[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0]])
    derived = [[0.359879, 0.333053, -0.256496], [2.104689, 1.231444, -0.641894],
               [1.257337, 3.014533, -0.321600], [-0.487474, 2.116142, 0.063797]]
    assert found == pytest.approx(np.array(derived), abs=6e-7)
    printed = [[0.9312, 0.1634, -0.3256], [-0.1743, 0.9846, -0.0044], [0.3199, 0.0609, 0.9454]]
    angle = op.axis_angle_from_rotation(op.nearest_rotation(printed)).angle
    assert math.degrees(angle) == pytest.approx(21.5, abs=0.1)


def test_example_3_6_rectangle_by_the_seven_steps():
    """The notes' procedure: bring the axis onto z, turn about z, bring it back."""
    u = op.direction_between([0, 2, 2], [1, 4, 6])
    to_xz = op.rotation_matrix("x", math.atan2(u[1], u[2]))
    to_z = op.rotation_matrix("y", -math.atan2(u[0], math.hypot(u[1], u[2])))
    assert to_z @ to_xz @ u == pytest.approx([0, 0, 1], abs=1e-15)
    onto_z = pin.SE3(to_z @ to_xz, np.zeros(3)) * pin.SE3(np.eye(3), np.array([0.0, -2, -2]))
    turn = onto_z.inverse() * op.elementary_matrix(3, (0, 0, 0), 30 * DEG) * onto_z
    assert apart(turn, op.screw_displacement(u, [0, 2, 2], 30 * DEG)) < ROUND_OFF


def test_tutorial_3_frame_turned_about_an_axis_through_a_point():
    axis = np.array([1.0, 1.0, 0.0]) / math.sqrt(2)
    frame = op.displaced_frame(op.screw_displacement(axis, [1, 2, 3], 30 * DEG), np.eye(4))
    assert frame.translation == pytest.approx([-1.127647, 1.127647, 0.048370], abs=5e-7)


@examples
@given(axes, points, st.floats(-10.0, 10.0), lengths)
def test_screw_operator_is_the_product_of_four(axis, point, angle, translation):
    """[EMT2431, 3.5.1]: to the origin, turn, back, along the axis."""
    four = (pin.SE3(np.eye(3), translation * axis) * pin.SE3(np.eye(3), point)
            * pin.SE3(pin.exp3(angle * axis), np.zeros(3)) * pin.SE3(np.eye(3), -point))
    assert apart(op.screw_displacement(axis, point, angle, translation), four) < 2e-14


@examples
@given(axes, points, angles, lengths)
def test_screw_is_found_again(axis, point, angle, translation):
    placement = op.screw_displacement(axis, point, angle, translation)
    screw = op.screw_from_placement(placement)
    reach = 1.0 + np.linalg.norm(placement.translation)
    assert apart(screw.placement(), placement) < 1e-15 * reach
    assert 0.0 <= screw.angle <= PI
    if op.screw.SMALLEST_ANGLE < angle < PI:
        nearest = point - (axis @ point) * axis
        lost = 1e-15 * reach / math.sin(angle / 2)
        assert screw.point @ screw.direction == pytest.approx(0.0, abs=lost)
        assert screw.point == pytest.approx(nearest, abs=lost)
        assert screw.direction == pytest.approx(axis, abs=2e-15)
        assert screw.translation == pytest.approx(translation, abs=3e-15 * reach)


@examples
@given(placements)
def test_every_placement_is_a_screw(placement):
    screw = op.screw_from_placement(placement)
    assert apart(screw.placement(), placement) < 3e-15 * (1 + np.linalg.norm(placement.translation))


@examples
@given(axes, points, lengths)
def test_half_turn_screws_keep_axis_and_translation(axis, point, translation):
    screw = op.screw_from_placement(op.screw_displacement(axis, point, PI, translation))
    same = 1.0 if screw.direction @ axis > 0.0 else -1.0
    assert screw.angle == PI
    assert screw.direction == pytest.approx(same * axis, abs=1e-15)
    assert screw.translation == pytest.approx(same * translation, abs=1e-14)
    assert screw.point == pytest.approx(point - (axis @ point) * axis, abs=3e-14)


@examples
@given(points.filter(lambda v: np.linalg.norm(v) > 1e-3))
def test_pure_translation_is_a_screw_without_a_turn(shift):
    screw = op.screw_from_placement(pin.SE3(np.eye(3), shift))
    assert screw.angle == 0.0
    assert screw.pitch == math.inf
    assert screw.translation == pytest.approx(np.linalg.norm(shift), rel=1e-15)
    assert screw.placement().translation == pytest.approx(shift, abs=1e-14)
    assert np.array_equal(screw.point, np.zeros(3))


def test_round_off_in_the_rotation_does_not_hide_a_pure_translation():
    turn = op.screw_displacement("x", [0.1, 0.2, 0.3], 1.1)
    shift = pin.SE3(np.eye(3), np.array([1.0, 2.0, 3.0]))
    screw = op.screw_from_placement(turn * turn.inverse() * shift)
    assert screw.angle == 0.0
    assert screw.translation == pytest.approx(math.sqrt(14.0), rel=1e-15)


def test_identity_is_a_screw_of_nothing():
    screw = op.screw_from_placement(np.eye(4))
    assert (screw.angle, screw.translation, screw.pitch) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(("plane", "place"), [("yz", 0), ("xz", 1), ("xy", 2)])
def test_axis_crosses_the_coordinate_planes(plane, place):
    screw = op.ScrewDisplacement(op.direction_between([0, 0, 0], [1, 2, 2]),
                                 np.array([1.0, 5.0, -3.0]), 1.0, 0.0)
    crossing = screw.axis_crosses(plane)
    assert crossing[place] == 0.0
    assert np.cross(crossing - screw.point, screw.direction) == pytest.approx(0.0, abs=1e-14)


def test_axis_parallel_to_a_plane_does_not_cross_it():
    screw = op.ScrewDisplacement(np.array([0.0, 0.6, 0.8]), np.ones(3), 1.0, 0.0)
    assert screw.axis_crosses("yz") is None
    with pytest.raises(ValueError, match="there are yz"):
        screw.axis_crosses("zz")


@examples
@given(axes, st.floats(-10.0, 10.0), st.floats(-1.0, 1.0))
def test_screw_is_the_placement_of_the_helical_joint(axis, angle, pitch):
    joint = placed(pin.JointModelHelicalUnaligned(axis, pitch), angle)
    assert apart(op.helical_displacement(axis, [0, 0, 0], angle, pitch), joint) < 1e-14


@examples
@given(axes, points, angles, lengths)
def test_screw_is_the_placement_of_the_free_flyer(axis, point, angle, translation):
    screw = op.screw_displacement(axis, point, angle, translation)
    joint = placed(pin.JointModelFreeFlyer(), pin.SE3ToXYZQUAT(screw))
    assert apart(screw, joint) < 1e-14


@examples
@given(axes, points, st.floats(1e-3, 3.0), lengths)
def test_screw_agrees_with_the_logarithm_away_from_pi(axis, point, angle, translation):
    screw = op.screw_from_placement(op.screw_displacement(axis, point, angle, translation))
    moment = np.cross(screw.point, screw.direction) + screw.pitch * screw.direction
    twist = screw.angle * np.concatenate([moment, screw.direction])
    assert pin.log6(screw.placement()).vector == pytest.approx(twist, abs=1e-10)


# ---------------------------------------------------------------- elementary matrices (A9)

OFFSET = (2.0, -3.0, 0.5)


def test_tutorial_2_screw_joint():
    screw = op.screw_placement((2, -3, 2), PI, 0.125)
    assert op.displaced_points(screw, [0, 2, 0]) == pytest.approx([2, -5, 2.0625], abs=1e-14)
    assert apart(screw, op.elementary_matrix(6, (2, -3, 2), PI, 0.125)) == 0.0


@pytest.mark.parametrize("case", range(1, 8))
def test_elementary_matrices_entry_by_entry(case):
    a, b, d = OFFSET
    angle, lead = (0.7, 0.2 if case > 3 else 0.0) if case < 7 else (0.0, 0.0)
    c, s, k = math.cos(angle), math.sin(angle), lead * angle / (2 * PI)
    about = {
        1: [[1, 0, 0, a + k], [0, c, -s, b], [0, s, c, d]],
        2: [[c, 0, s, a], [0, 1, 0, b + k], [-s, 0, c, d]],
        3: [[c, -s, 0, a], [s, c, 0, b], [0, 0, 1, d + k]],
    }
    expected = np.array([*about[(case - 1) % 3 + 1], [0, 0, 0, 1]])
    found = op.elementary_matrix(case, OFFSET, angle, lead)
    assert found.homogeneous == pytest.approx(expected, abs=4e-16)


@every_axis
@examples
@given(angle=st.floats(-10.0, 10.0), slide=lengths, lead=st.floats(-1.0, 1.0), offset=points)
def test_link_and_joint_models_are_the_placements_of_pinocchio(axis, angle, slide, lead, offset):
    turn, move = named("R", axis), named("P", axis)
    screw = named("H", axis, lead / (2 * PI))
    pairs = [
        (op.revolute_placement(offset, angle, axis), placed(turn, angle, offset)),
        (op.prismatic_placement(offset, slide, axis), placed(move, slide, offset)),
        (op.screw_placement(offset, angle, lead, axis), placed(screw, angle, offset)),
        (op.cylindrical_placement(offset, angle, slide, axis),
         placed(composite(turn, move), [angle, slide], offset)),
    ]
    for found, joint in pairs:
        assert apart(found, joint) < 2e-14


@examples
@given(st.floats(-PI, PI), st.floats(-PI, PI), points)
def test_universal_model_is_the_placement_of_pinocchio(first, second, offset):
    x, y, _ = np.eye(3)
    joint = placed(pin.JointModelUniversal(x, y), [first, second], offset)
    assert apart(op.universal_placement(offset, first, second), joint) < 2e-14


@examples
@given(angles, angles, angles, points)
def test_spherical_model_is_the_placement_of_pinocchio(first, second, third, offset):
    found = op.spherical_placement(offset, first, second, third)
    revolutes = composite(pin.JointModelRZ(), pin.JointModelRX(), pin.JointModelRZ())
    assert apart(found, placed(revolutes, [first, second, third], offset)) < 2e-14
    ball = placed(pin.JointModelSpherical(), pin.Quaternion(found.rotation).coeffs(), offset)
    assert apart(found, ball) < 2e-14


def test_spherical_model_entry_by_entry_with_the_factor_misprinted_in_entry_1_1():
    t, p, f = 0.4, 0.9, -1.3
    (ct, st_), (cp, sp_), (cf, sf) = ((math.cos(x), math.sin(x)) for x in (t, p, f))
    derived = np.array([
        [ct * cf - st_ * cp * sf, -ct * sf - st_ * cp * cf, st_ * sp_, 0],
        [st_ * cf + ct * cp * sf, -st_ * sf + ct * cp * cf, -ct * sp_, 2.0],
        [sp_ * sf, sp_ * cf, cp, 0],
        [0, 0, 0, 1],
    ])
    found = op.spherical_placement((0, 2.0, 0), t, p, f)
    assert found.homogeneous == pytest.approx(derived, abs=1e-15)
    assert abs(found.rotation[0, 0] - (ct * cf - st_ * sp_ * sf)) > 0.05


@examples
@given(rotations)
def test_euler_angles_are_found_again_at_all_angles(rotation):
    found = op.euler_zxz_from_rotation(rotation)
    again = op.spherical_placement((0, 0, 0), *found).rotation
    assert np.abs(again - rotation).max() < ROUND_OFF
    assert 0.0 <= found.second <= PI


@pytest.mark.parametrize("call", [
    lambda: op.elementary_matrix(8, OFFSET),
    lambda: op.elementary_matrix(7, OFFSET, 0.1),
    lambda: op.elementary_matrix(3, OFFSET, 0.1, 0.2),
    lambda: op.revolute_placement(OFFSET, 0.1, "w"),
    lambda: op.revolute_placement((1.0, 2.0), 0.1),
    lambda: op.screw_placement(OFFSET, math.nan, 0.1),
    lambda: op.prismatic_placement(OFFSET, math.inf),
])
def test_elementary_matrices_refuse_what_they_cannot_mean(call):
    with pytest.raises(ValueError):
        call()


# ---------------------------------------------------------------- Denavit-Hartenberg (A10)

ARM = [
    op.DHRow(0.0, 0.0, 0.3, 0.2, name="waist", link="column"),
    op.DHRow(0.1, -PI / 2, 0.0, -0.4),
    op.DHRow(0.5, 0.3, 0.05, 0.0, "prismatic"),
    op.DHRow(0.2, 0.0, 0.0, 0.7, "fixed", name="elbow", link="bracket"),
    op.DHRow(0.05, PI / 2, 0.1, 0.0, "screw", lead=-0.03),
    op.DHRow(0.0, -1.1, 0.2, 0.4, "cylindrical"),
    op.DHRow(0.0, 0.4, 0.15, 0.0, "fixed", name="flange", link="tool"),
]
coordinates = st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6).map(np.array)


@examples
@given(lengths, st.floats(-PI, PI), lengths, st.floats(-PI, PI))
def test_dh_matrix_entry_by_entry(a, alpha, d, theta):
    """Derived from the four motions; the matrix printed in the paper, eq. 18, lost its signs."""
    (ca, sa), (ct, st_) = ((math.cos(x), math.sin(x)) for x in (alpha, theta))
    derived = np.array([
        [ct, -st_, 0, a],
        [st_ * ca, ct * ca, -sa, -d * sa],
        [st_ * sa, ct * sa, ca, d * ca],
        [0, 0, 0, 1],
    ])
    found = op.dh_placement(a, alpha, d, theta)
    assert found.homogeneous == pytest.approx(derived, abs=4e-15)
    origin = [0, 0, 0]
    motions = (op.screw_displacement("x", origin, alpha, a)
               * op.screw_displacement("z", origin, theta, d))
    assert apart(found, motions) < 4e-15


@examples
@given(coordinates)
def test_dh_model_is_the_product_of_its_placements(q):
    model = op.model_from_dh(ARM)
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    links = ["column", "link2", "link3", "bracket", "link5", "link6", "tool"]
    for link, placement in zip(links, op.dh_link_placements(ARM, q), strict=True):
        frame = data.oMf[model.getFrameId(link, pin.FrameType.BODY)]
        assert apart(frame, placement) < 5 * ROUND_OFF


def test_dh_model_has_named_joints_and_frames():
    model = op.model_from_dh(ARM, name="arm")
    assert model.name == "arm"
    assert list(model.names) == ["universe", "waist", "joint2", "joint3", "joint5", "joint6"]
    assert model.nv == 6
    assert model.frames[model.getFrameId("elbow")].type == pin.FrameType.FIXED_JOINT
    assert model.frames[model.getFrameId("tool")].parentJoint == model.getJointId("joint6")
    parent = model.frames[model.getFrameId("tool")].parentFrame
    assert model.frames[parent].name == "flange"


def test_dh_model_of_a_planar_arm_against_its_closed_form():
    """Three parallel revolutes [Craig2005, Ex. 3.3]."""
    q, (l1, l2) = np.array([0.3, -0.8, 1.7]), (0.5, 0.4)
    tool = op.dh_link_placements([(0, 0, 0, 0), (l1, 0, 0, 0), (l2, 0, 0, 0)], q)[-1]
    x = l1 * math.cos(q[0]) + l2 * math.cos(q[0] + q[1])
    y = l1 * math.sin(q[0]) + l2 * math.sin(q[0] + q[1])
    assert apart(tool, op.revolute_placement((x, y, 0), q.sum())) < ROUND_OFF


@examples
@given(coordinates, coordinates, coordinates)
def test_angular_velocity_and_acceleration_from_direction_cosines_are_pinocchios(q, v, a):
    model = op.model_from_dh(ARM)
    data = model.createData()
    pin.forwardKinematics(model, data, q, v, a)
    pin.updateFramePlacements(model, data)
    links = ["column", "link2", "link3", "bracket", "link5", "link6", "tool"]
    for link, (A, rate, acceleration) in zip(
            links, op.dh_direction_cosines(ARM, q, v, a), strict=True):
        i = model.getFrameId(link, pin.FrameType.BODY)
        world, local = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED, pin.ReferenceFrame.LOCAL
        velocity = [pin.getFrameVelocity(model, data, i, f).angular for f in (world, local)]
        change = [pin.getFrameAcceleration(model, data, i, f).angular for f in (world, local)]
        assert op.spatial_angular_velocity(A, rate) == pytest.approx(velocity[0], abs=1e-13)
        assert op.body_angular_velocity(A, rate) == pytest.approx(velocity[1], abs=1e-13)
        both = A, rate, acceleration
        assert op.spatial_angular_acceleration(*both) == pytest.approx(change[0], abs=1e-12)
        assert op.body_angular_acceleration(*both) == pytest.approx(change[1], abs=1e-12)


def test_what_is_no_rate_of_a_rotation_is_refused():
    with pytest.raises(ValueError, match="not the derivative"):
        op.spatial_angular_velocity(np.eye(3), np.eye(3))
    with pytest.raises(ValueError, match="not the derivative"):
        op.spatial_angular_acceleration(np.eye(3), np.zeros((3, 3)), np.eye(3))


@pytest.mark.parametrize("table", [
    [],
    [(0, 0, 0, 0, "hinge")],
    [(0, math.nan, 0, 0)],
    [(0, 0, 0, 0, "revolute", "a"), (1, 0, 0, 0, "revolute", "a")],
    [(0, 0, 0, 0, "revolute", "", "", 0.1)],
    [(0, 0, 0, 0, "revolute", "universe")],
])
def test_bad_tables_are_refused(table):
    with pytest.raises(ValueError):
        op.model_from_dh(table)


def test_wrong_number_of_coordinates_is_refused():
    with pytest.raises(ValueError, match="q has shape"):
        op.dh_link_placements(ARM, np.zeros(7))


# ---------------------------------------------------------------- what is refused

SKEWED = np.eye(3) + 1e-6 * np.ones((3, 3))


@pytest.mark.parametrize("call", [
    lambda: op.rotation_matrix([1.0, 1.0, 0.0], 0.1),
    lambda: op.rotation_matrix([1.0, 0.0], 0.1),
    lambda: op.rotation_matrix([math.nan, 0.0, 1.0], 0.1),
    lambda: op.rotation_matrix("w", 0.1),
    lambda: op.rotation_matrix("x", math.inf),
    lambda: op.rotation_matrix("x", "30"),
    lambda: op.axis_angle_from_rotation(SKEWED),
    lambda: op.axis_angle_from_rotation(-np.eye(3)),
    lambda: op.axis_angle_from_rotation(np.eye(4)),
    lambda: op.composite_rotation([("x", 0.1, "floating")]),
    lambda: op.nearest_rotation(np.diag([1.0, 1.0, -1.0])),
    lambda: op.nearest_rotation(np.zeros((3, 3))),
    lambda: op.direction_between([1, 2, 3], [1, 2, 3]),
    lambda: op.screw_displacement([2.0, 0.0, 0.0], [0, 0, 0], 0.1),
    lambda: op.screw_displacement("x", [0, 0], 0.1),
    lambda: op.screw_displacement("x", [0, 0, 0], 0.1, math.nan),
    lambda: op.screw_from_placement(pin.SE3(np.eye(3), np.array([math.nan, 0.0, 0.0]))),
    lambda: op.screw_from_placement(2.0 * np.eye(4)),
    lambda: op.screw_from_placement(np.eye(3)),
    lambda: op.displaced_points(np.eye(4), np.zeros((2, 2))),
    lambda: op.displaced_planar(np.eye(3), 1.0),
    lambda: op.displaced_planar(np.diag([1.0, -1.0, 1.0]), [0.0, 0.0]),
    lambda: op.planar_translation([1.0, 2.0, 3.0]),
    lambda: op.complex_rotation(math.nan),
    lambda: op.complex_rotation_between(1.0, 2.0),
    lambda: op.complex_rotation_between(0.0, 0.0),
    lambda: op.complex_rotation_between(complex(math.nan, 0), 1.0),
    lambda: op.rotation_center(np.full((3, 3), math.nan)),
])
def test_bad_input_is_refused(call):
    with pytest.raises(ValueError):
        call()
