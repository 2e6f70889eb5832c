"""When two mechanisms are the same."""

import numpy as np

import spatial_pin as sp

ARRAYS = ("lowerPositionLimit", "upperPositionLimit", "lowerVelocityLimit", "upperVelocityLimit",
          "lowerEffortLimit", "upperEffortLimit", "damping", "armature", "lowerDryFrictionLimit",
          "upperDryFrictionLimit")


def near(found, expected, tolerance):
    np.testing.assert_allclose(np.asarray(found), np.asarray(expected), rtol=0.0, atol=tolerance)


def same_inertias(found, expected, size):
    largest = max((abs(x.mass) for x in expected), default=0.0)
    heaviest = max((np.abs(x.toPseudoInertia().toMatrix()).max() for x in expected), default=0.0)
    for x, y in zip(found, expected, strict=True):
        near(x.mass, y.mass, 1e-15 * largest)
        near(x.mass * x.lever, y.mass * y.lever, 4e-15 * largest * size)
        near(x.toPseudoInertia().toMatrix(), y.toPseudoInertia().toMatrix(), 1e-14 * heaviest)


def same_models(found, expected, size=1.0):
    """Joints, coordinates, limits, what resists, inertias and named frames are the same."""
    assert list(found.names) == list(expected.names)
    assert found.idx_qs.tolist() == expected.idx_qs.tolist()
    assert found.idx_vs.tolist() == expected.idx_vs.tolist()
    assert list(found.parents) == list(expected.parents)
    near(found.gravity.vector, expected.gravity.vector, 0.0)
    for key in ARRAYS:
        np.testing.assert_array_equal(getattr(found, key), getattr(expected, key), err_msg=key)
    for x, y in zip(found.jointPlacements, expected.jointPlacements, strict=True):
        near(x.rotation, y.rotation, 4e-15)
        near(x.translation, y.translation, 4e-15 * size)
    same_inertias(list(found.inertias), list(expected.inertias), size)


def same_frames(found, expected):
    """What is called alike stands alike."""
    assert found.frame_ids.keys() == expected.frame_ids.keys()
    for name in expected.frame_ids:
        (i, x), (j, y) = found.frame_on_joint(name), expected.frame_on_joint(name)
        assert i == j, name
        near(x.rotation, y.rotation, 4e-15)
        near(x.translation, y.translation, 4e-15 * expected.characteristic_length)


def same_closures(found, expected):
    assert len(found) == len(expected)
    for x, y in zip(found, expected, strict=True):
        for key in ("name", "type", "frames", "joints", "ratio", "offset", "equations", "between"):
            assert getattr(x, key) == getattr(y, key), (x.name, key)
        assert (x.geometry is None) == (y.geometry is None)
        if y.geometry is not None:
            near(x.geometry.axes1, y.geometry.axes1, 2e-16)
            near(x.geometry.axes2, y.geometry.axes2, 2e-16)
            assert x.geometry.length == y.geometry.length
            assert x.geometry.lead == y.geometry.lead


def same_mechanisms(found, expected):
    for key in ("name", "title", "source", "pairs", "springs", "passives", "frames"):
        assert getattr(found, key) == getattr(expected, key), key
    assert dict(found.drivers) == dict(expected.drivers)
    assert found.guess.keys() == expected.guess.keys()
    for key, value in expected.guess.items():
        np.testing.assert_array_equal(found.guess[key], value)
    assert found.coordinates == expected.coordinates
    same_models(found.model, expected.model, expected.characteristic_length)
    same_frames(found, expected)
    same_closures(found.closures, expected.closures)
    assert found.inertias.keys() == expected.inertias.keys()
    same_inertias([found.inertias[n] for n in expected.inertias],
                  list(expected.inertias.values()), expected.characteristic_length)
    speeds = [x.slip_speeds if x.slip_speeds.size else np.full(x.model.nv, np.nan)
              for x in (found, expected)]
    np.testing.assert_array_equal(*speeds)


def sizes(mechanism):
    """Coordinates and equations."""
    return len(mechanism.coordinates), len(sp.closure_jacobian(mechanism, mechanism.neutral))


def assert_same(one: np.ndarray, other: np.ndarray, by: float = 1e-13) -> None:
    """Arrays are equal to a part of the largest number, or of 1."""
    np.testing.assert_allclose(one, other, rtol=0, atol=by * (1.0 + np.abs(other).max(initial=0)))
