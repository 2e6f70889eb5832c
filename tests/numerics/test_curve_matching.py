"""Parts of closed curves are found again wherever they were moved, turned and scaled."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from variety import paired

from spatial_pin.numerics.curve_matching import lengths_along, matches

EVERY, NONE, ABOUT_Z = ([True] * 3, [False] * 3, [False, False, True])
SIZE, SHIFT = 1.7, np.array([1.0, -2.0, 3.0])


def curves(count=40, n=144):
    """Return smooth closed curves (count, n, 3): sums of three harmonics."""
    rng, t = np.random.default_rng(0), 2.0 * np.pi * np.arange(n) / n
    a, b = rng.normal(size=(2, count, 3, 3)) / np.array([1.0, 3.0, 9.0])[:, None]
    k = np.arange(1, 4)[:, None] * t
    return np.einsum("chi,hn->cni", a, np.cos(k)) + np.einsum("chi,hn->cni", b, np.sin(k))


def moved(curve, turns, shifts, scale):
    rotation = Rotation.from_rotvec(np.array([0.5, -0.8, 1.1]) * turns).as_matrix()
    return (SIZE if scale else 1.0) * curve @ rotation.T + SHIFT * shifts, rotation


@pytest.mark.parametrize("scale", [True, False])
@pytest.mark.parametrize(("free", "part"), paired(
    [(EVERY, EVERY), (ABOUT_Z, EVERY), (NONE, EVERY), (NONE, ABOUT_Z), (NONE, NONE)],
    [(np.arange(5, 144, 6), True), (np.arange(140, 0, -7), True), (np.arange(20, 70, 5), False),
     (np.arange(120, 60, -6), False)]))
def test_a_curve_that_was_moved_is_found_with_how_it_was(free, part, scale):
    (turns, shifts), (rows, is_closed) = free, part
    every = curves()
    whole, rotation = moved(every[7], turns, shifts, scale)
    found = matches(whole[rows], every, is_closed, np.array(shifts), np.array(turns), scale)
    assert found.misfit[7] < 0.2
    if not is_closed:  # lengths of parts are tried in coarse steps, and many curves have such parts
        return
    assert np.argmin(found.misfit) == 7
    assert found.size[7] == pytest.approx(SIZE if scale else 1.0, rel=0.2)
    np.testing.assert_allclose(found.rotation[7], rotation, atol=0.2)
    at = np.interp(found.at[7], lengths_along(every)[7], np.arange(145.0))
    away = np.abs((at - rows + 72.0) % 144.0 - 72.0)
    assert away.max() < 12.0  # of 144 samples


def test_a_misfit_is_what_the_best_motion_leaves():
    every = curves(6)
    other = every[0][::6]
    found = matches(other, every, True, np.array(EVERY), np.array(EVERY), True)
    k = 3
    places = np.interp(found.at[k], lengths_along(every)[k], np.arange(145.0))
    rows = np.rint(places).astype(int) % 144
    there = found.size[k] * (every[k][rows] @ found.rotation[k].T)
    left = (other - other.mean(axis=0)) - (there - there.mean(axis=0))
    size = np.linalg.norm(other - other.mean(axis=0))
    assert np.linalg.norm(left) / size == pytest.approx(found.misfit[k], rel=0.15)


def test_lengths_along_a_circle_are_even():
    t = 2.0 * np.pi * np.arange(10) / 10
    circle = np.stack([np.cos(t), np.sin(t), 0.0 * t], axis=1)[None]
    np.testing.assert_allclose(lengths_along(circle)[0], np.arange(11) / 10, atol=1e-15)
