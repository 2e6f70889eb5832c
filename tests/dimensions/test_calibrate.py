"""Dimensions, offsets and base found again from measurements, against closed forms."""

from __future__ import annotations

import json
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from folders import DATA
from loaded_library import library

import spatial_pin as sp
from spatial_pin import targets

FILE = DATA / "hexapod" / "hexapod.toml"
LEGS = [f"leg_{k}" for k in range(1, 7)]
PLACES = [f"{part}{x}{k}" for k in range(1, 7) for part in "ft" for x in "xyz"]
BASE = pin.SE3(pin.exp3(np.array([0.3, -0.5, 1.0])), np.array([1.0, 2.0, -0.3]))

# ---------------------------------------------------------------- a Gough platform, closed form


def poses(count, seed):
    rng = np.random.default_rng(seed)
    return [pin.SE3(pin.exp3(rng.uniform(-0.25, 0.25, 3)),
                    np.array([0.0, 0.0, 0.36]) + rng.uniform(-0.06, 0.06, 3))
            for _ in range(count)]


def feet_and_tops(dimensions):
    table = np.array([dimensions[name] for name in PLACES]).reshape(6, 2, 3)
    return table[:, 0], table[:, 1]


def lengths(at, dimensions):
    """Return the lengths of the legs with the platform at a placement."""
    feet, tops = feet_and_tops(dimensions)
    return np.linalg.norm(tops @ at.rotation.T + at.translation - feet, axis=1)


def pose_slopes(at, dimensions):
    """Return derivatives (6, 42) of a pose for all places and offsets: shift, turn in its axes."""
    feet, tops = feet_and_tops(dimensions)
    for_pose, for_rest = np.zeros((6, 6)), np.zeros((6, 42))
    for k in range(6):
        along = at.act(tops[k]) - feet[k]
        along /= np.linalg.norm(along)
        for_pose[k, :3] = along
        for_pose[k, 3:] = -along @ at.rotation @ pin.skew(tops[k])
        for_rest[k, 6 * k : 6 * k + 6] = [*-along, *(along @ at.rotation)]
        for_rest[k, 36 + k] = -1.0
    return -np.linalg.solve(for_pose, for_rest)


@cache
def built():
    """Return a platform as drawn, its dimensions as built, and the offsets of its encoders."""
    drawn, rng = sp.load(FILE), np.random.default_rng(3)
    as_built = {name: drawn.dimensions[name] + rng.uniform(-2e-3, 2e-3) for name in PLACES}
    return drawn, as_built, rng.uniform(-2e-3, 2e-3, 6)


def measured(count, seed, noise=0.0):
    _, dimensions, offsets = built()
    rng = np.random.default_rng(seed + 100)
    found = []
    for at in poses(count, seed):
        read = lengths(at, dimensions) - offsets
        seen = pin.SE3(at.rotation @ pin.exp3(10 * noise * rng.normal(size=3)),
                       at.translation + noise * rng.normal(size=3))
        found.append((dict(zip(LEGS, read.tolist(), strict=True)), {"platform": seen}))
    return found


def test_a_gough_platform_is_found_again_exactly_without_noise():
    drawn, dimensions, offsets = built()
    found = sp.calibrate(drawn, measured(12, 0), PLACES, offsets=LEGS)
    assert max(abs(found.values[name] - x) for name, x in dimensions.items()) < 1e-10
    assert max(abs(found.values[f"{leg}.offset"] - x)
               for leg, x in zip(LEGS, offsets, strict=True)) < 1e-10
    assert not found.undetermined
    assert np.abs(found.residuals).max() < 1e-13 < 1e-4 < np.abs(found.before).max()
    assert found.mechanism.dimensions["tx3"] == found.values["tx3"]
    assert all(state.mechanism is found.mechanism for state in found.states)
    for state, at in zip(found.states, poses(12, 0), strict=True):
        assert np.abs(pin.log6(at.actInv(state.placement("platform"))).vector).max() < 1e-11


def gough_information(seed, count, noise):
    """Return Fisher's information (42, 42) that poses have of all places and offsets."""
    _, dimensions, _ = built()
    weights = 1.0 / np.repeat([noise, 10 * noise], 3)
    rows = [weights[:, None] * pose_slopes(at, dimensions) for at in poses(count, seed)]
    return sum(x.T @ x for x in rows)


@pytest.mark.slow
def test_a_gough_platform_is_found_again_within_three_sigma_of_the_cramer_rao_bound():
    drawn, dimensions, offsets = built()
    noise, seed = 1e-5, 3
    table = measured(30, seed, noise)
    found = sp.calibrate(drawn, table, PLACES, offsets=LEGS,
                         sigma={"position": noise, "rotation": 10 * noise})
    information = gough_information(seed, 30, noise)
    weights, told = 1.0 / np.repeat([noise, 10 * noise], 3), np.zeros(42)
    for at, (_, seen) in zip(poses(30, seed), table, strict=True):
        error = [*(seen["platform"].translation - at.translation),
                 *pin.log3(at.rotation.T @ seen["platform"].rotation)]
        told += (weights[:, None] * pose_slopes(at, dimensions)).T @ (weights * error)
    bound = np.sqrt(np.diag(np.linalg.inv(information)))
    off = np.array([*found.values.values()]) - [*dimensions.values(), *offsets]
    assert np.all(np.abs(off) < 3.0 * bound)
    assert bound == pytest.approx([*found.sigma.values()], rel=0.01)
    # the efficient estimate of this very noise, but for its square
    assert np.abs((off - np.linalg.solve(information, told)) / bound).max() < 0.1
    assert np.array_equal(found.covariance, found.covariance.T)


def within_bound(errors, informations):
    """Check errors (k, n) of as many estimates against the Cramér-Rao bound, all seeds together.

    Normal errors of that covariance lie within three of its sigmas but for 0.27 %, and the squares
    of their Mahalanobis distances have chi-square's distribution.
    """
    from scipy import stats  # takes half a second

    k, n = errors.shape
    sigmas = np.array([np.sqrt(np.diag(np.linalg.inv(x))) for x in informations])
    beyond = int(np.sum(np.abs(errors) > 3.0 * sigmas))
    assert beyond <= stats.binom.ppf(0.999, k * n, 2.0 * stats.norm.sf(3.0))
    distances = np.array([e @ x @ e for e, x in zip(errors, informations, strict=True)])
    low, high = stats.chi2.ppf((0.001, 0.999), k * n)
    assert low < distances.sum() < high
    assert stats.kstest(distances, stats.chi2(n).cdf).pvalue > 0.001


@pytest.mark.slow
def test_errors_of_gough_platforms_have_the_distribution_of_the_cramer_rao_bound():
    drawn, dimensions, offsets = built()
    noise, count, seeds = 1e-5, 12, range(20, 28)
    true = np.array([*dimensions.values(), *offsets])
    found = [sp.calibrate(drawn, measured(count, seed, noise), PLACES, offsets=LEGS,
                          sigma={"position": noise, "rotation": 10 * noise}) for seed in seeds]
    within_bound(np.array([[*x.values.values()] for x in found]) - true,
                 [gough_information(seed, count, noise) for seed in seeds])


def test_the_base_is_found_by_points_alone():
    _, dimensions, _ = built()
    true = sp.load(FILE, **dimensions)
    at = poses(10, 4)
    points = [f"platform_{k}" for k in (1, 3, 5)]
    tops = feet_and_tops(dimensions)[1]
    some = [name for name in PLACES if name.startswith("t")]
    table = [(dict(zip(LEGS, lengths(x, dimensions).tolist(), strict=True)),
              {name: BASE.act(x.act(tops[int(name[-1]) - 1])) for name in points}) for x in at]
    half = sp.load(FILE, **{k: x for k, x in true.dimensions.items() if k not in some})
    found = sp.calibrate(half, table, some, base=True)
    # the axes of the platform are nowhere to be seen
    assert len(found.undetermined) == 6
    assert found.base.isApprox(BASE, 1e-10)
    assert np.isinf(found.sigma["tx1"]) and np.isfinite(found.sigma["base.rx"])
    first = np.linalg.norm(feet_and_tops({**dimensions, **found.values})[1][0] -
                           feet_and_tops({**dimensions, **found.values})[1][2])
    assert first == pytest.approx(np.linalg.norm(tops[0] - tops[2]), abs=1e-10)


def test_what_base_and_offsets_share_is_named_whatever_the_noise():
    """A turn of the first joint of an arm is a turn of its base."""
    drawn = library("rssr")
    table, rng = [], np.random.default_rng(2)
    for x in np.linspace(0.0, 5.0, 8):
        at = sp.assemble(drawn, {"crank": x + 0.1})
        table.append(({"crank": x}, {"crank": BASE * at.placement("crank")}))
        table[-1][1]["crank"].translation += 1e-3 * rng.normal(size=3)
    found = sp.calibrate(drawn, table, offsets=["crank"], base=True)
    assert len(found.undetermined) == 1 and "crank.offset" in found.undetermined[0]
    assert np.isfinite(found.sigma["base.x"])


# ---------------------------------------------------------------- 6R loop, closed form

SIX = DATA / "line_symmetric" / "line_symmetric.toml"
SIX_TRUE = {"a1": 0.2002, "a2": 0.2507, "a3": 0.1489, "alpha1": 0.9021, "alpha2": 1.2984,
            "alpha3": -0.7015, "d1": 0.0318, "d2": -0.0491, "d3": 0.0422}
SIX_OFFSET = 0.01
SIX_CRANKS = np.linspace(0.5, 5.5, 10)


def half(turns, p):
    """Return the half of the loop, from the ground to the third link: quaternion, translation."""
    turned, at = pin.Quaternion(1.0, 0.0, 0.0, 0.0), np.zeros(3)
    for k, turn in zip((3, 1, 2), turns, strict=True):
        a, alpha, d = (p[f"{name}{k}"] for name in ("a", "alpha", "d"))
        at = at + turned * np.array([a, -d * np.sin(alpha), d * np.cos(alpha)])
        turned = turned * pin.Quaternion(np.cos(alpha / 2), np.sin(alpha / 2), 0.0, 0.0)
        turned = turned * pin.Quaternion(np.cos(turn / 2), 0.0, 0.0, np.sin(turn / 2))
    return turned, at


def third_link(crank, near, p):
    """Return the hinges near others at which the loop is closed, and the third link's placement.

    The half, done twice, is nothing: it is a half-turn (its scalar is zero) without a shift along
    the axis.
    """
    def open_by(turns):
        turned, at = half([crank, *turns], p)
        return np.array([turned.w, turned.vec() @ at])

    for _ in range(30):
        slope = np.array([open_by(near + h) - open_by(near - h) for h in 1e-6 * np.eye(2)]).T / 2e-6
        step = np.linalg.solve(slope, open_by(near))
        near = near - step
        if np.abs(step).max() < 1e-14:
            break
    turned, at = half([crank, *near], p)
    return near, pin.SE3(turned.normalized().toRotationMatrix(), at)


def third_links(cranks, p):
    near, found = np.array([0.2220, 2.7877]), []
    for crank in cranks:
        near, at = third_link(crank, near, p)
        found.append(at)
    return found


def six_measured(seed=0, noise=0.0, misread=0.0):
    """Return cranks as read, with the third link's placements as seen, with normal noise."""
    rng = np.random.default_rng(seed + 1000)
    return [({"crank": crank + misread * rng.normal()},
             {"link_3": pin.SE3(at.rotation @ pin.exp3(10 * noise * rng.normal(size=3)),
                                at.translation + noise * rng.normal(size=3))})
            for crank, at in zip(SIX_CRANKS, third_links(SIX_CRANKS + SIX_OFFSET, SIX_TRUE),
                                 strict=True)]


def six_information(noise, misread=0.0):
    """Return Fisher's information (10, 10) of dimensions and offset.

    Where encoders misread, the crank of each pose is unknown too, and known to `misread`: what is
    left of the rest is Schur's complement.
    """
    true = np.array([*SIX_TRUE.values(), SIX_OFFSET])

    def links(x, more=0.0):
        return third_links(SIX_CRANKS + x[-1] + more, dict(zip(SIX_TRUE, x, strict=False)))

    def slope(ends):
        return np.concatenate([
            np.r_[(b.translation - a.translation) / noise,
                  pin.log3(a.rotation.T @ b.rotation) / (10 * noise)] / 2e-5
            for a, b in zip(*ends, strict=True)])

    rows = np.array([slope((links(true - h), links(true + h))) for h in 1e-5 * np.eye(10)]).T
    if not misread:
        return rows.T @ rows
    own = slope((links(true, -1e-5), links(true, 1e-5))).reshape(-1, 6)
    kept = np.zeros((10, 10))
    for row, along in zip(rows.reshape(-1, 6, 10), own, strict=True):
        mixed = row.T @ along
        kept += row.T @ row - np.outer(mixed, mixed) / (along @ along + misread**-2)
    return kept


def test_a_6r_loop_is_found_again_exactly_without_noise():
    found = sp.calibrate(sp.load(SIX), six_measured(), list(SIX_TRUE), offsets=["crank"])
    assert max(abs(found.values[name] - x) for name, x in SIX_TRUE.items()) < 1e-10
    assert abs(found.values["crank.offset"] - SIX_OFFSET) < 1e-10
    assert not found.undetermined


@pytest.mark.slow
@pytest.mark.parametrize("misread", [0.0, 2e-4])
def test_errors_of_6r_loops_have_the_distribution_of_the_cramer_rao_bound(misread):
    noise, seeds = 1e-5, range(20)
    true = np.array([*SIX_TRUE.values(), SIX_OFFSET])
    sigma = {"position": noise, "rotation": 10 * noise}
    if misread:
        sigma["crank.encoder"] = misread
    drawn, information = sp.load(SIX), six_information(noise, misread)
    found = [sp.calibrate(drawn, six_measured(seed, noise, misread), list(SIX_TRUE),
                          offsets=["crank"], sigma=sigma) for seed in seeds]
    within_bound(np.array([[*x.values.values()] for x in found]) - true,
                 [information] * len(seeds))
    bound = np.sqrt(np.diag(np.linalg.inv(information)))
    for one in found:
        assert bound == pytest.approx([*one.sigma.values()], rel=0.02)


def test_encoders_that_misread_are_reported_by_pose():
    noise, misread = 1e-5, 2e-3
    table = six_measured(3, noise, misread)
    given = {"position": noise, "rotation": 10 * noise}
    m, plain = sp.load(SIX), {"dimensions": list(SIX_TRUE), "offsets": ["crank"]}
    exact = sp.calibrate(m, table, **plain, sigma=given)
    found = sp.calibrate(m, table, **plain, sigma={**given, "encoder": misread})
    at = [k for k, (_, label) in enumerate(found.labels) if label == "hinge_1.encoder"]
    assert [found.labels[k][0] for k in at] == list(range(10))
    assert {found.units[k] for k in at} == {"rad"}
    true = SIX_CRANKS - [read["crank"] for read, _ in table]
    shift = found.values["crank.offset"] - SIX_OFFSET  # common to all, as the offset has it
    assert found.residuals[at] + shift == pytest.approx(true, abs=5e-4)
    for state, crank in zip(found.states, SIX_CRANKS + SIX_OFFSET, strict=True):
        assert state.coordinate("hinge_1").value == pytest.approx(crank, abs=5e-4)
    off = [np.abs(np.array([*x.values.values()]) - [*SIX_TRUE.values(), SIX_OFFSET])
           / [*found.sigma.values()] for x in (exact, found)]
    assert off[1].max() < 3.5 < off[0].max()
    # encoders that are known to read well are as good as exact ones
    close = sp.calibrate(m, six_measured(3, noise), **plain, sigma={**given, "encoder": 1e-9})
    alone = sp.calibrate(m, six_measured(3, noise), **plain, sigma=given)
    assert close.values == pytest.approx(alone.values, abs=1e-9)
    assert close.sigma == pytest.approx(alone.sigma, rel=1e-4)


# ---------------------------------------------------------------- RSSR, closed form


TRUE = {"a": 0.104, "b": 0.383, "c": 0.2503}


def rocker(crank, near, a, b, c, d=0.314):
    """Return the rocker's angle by the closed form, on the branch of a value nearby."""
    one = np.array([-a * np.cos(crank), 0.0, a * np.sin(crank)])
    # |one - two|² = b², two = (-d - c cos r, c sin r, 0)
    along = one[0] + d
    size = (b * b - c * c - along**2 - one[2] ** 2) / (2.0 * c * along)
    return min((s * np.arccos(size) for s in (1, -1)),
               key=lambda x: abs(np.angle(np.exp(1j * (x - near)))))


def turned(count, offset=0.02, noise=0.0, seed=0):
    rng = np.random.default_rng(seed)
    state = sp.assemble(library("rssr"))
    near, table = state.coordinate("rocker_pin")[0], []
    for crank in np.linspace(0.0, 6.0, count):
        near = rocker(crank + offset, near, **TRUE)
        table.append(({"crank": crank}, {"rocker_pin": near + noise * rng.normal()}))
    return table


def test_an_rssr_loop_is_found_again_exactly_without_noise():
    found = sp.calibrate(library("rssr"), turned(12), list(TRUE), offsets=["crank"])
    assert max(abs(found.values[name] - x) for name, x in TRUE.items()) < 1e-10
    assert abs(found.values["crank.offset"] - 0.02) < 1e-10


def test_an_rssr_loop_is_found_again_within_three_sigma_of_the_cramer_rao_bound():
    noise, table = 1e-4, turned(60, noise=1e-4, seed=5)
    found = sp.calibrate(library("rssr"), table, list(TRUE), offsets=["crank"],
                         sigma={"angle": noise})
    true = np.array([*TRUE.values(), 0.02])
    exact = [x[1]["rocker_pin"] for x in turned(60)]

    def angles(p):
        return np.array([rocker(x[0]["crank"] + p[3], near, *p[:3])
                         for x, near in zip(table, exact, strict=True)])

    rows = np.array([angles(true + h) - angles(true - h) for h in 1e-6 * np.eye(4)]).T / 2e-6
    bound = noise * np.sqrt(np.diag(np.linalg.inv(rows.T @ rows)))
    off = np.array([*found.values.values()]) - true
    assert np.all(np.abs(off) < 3.0 * bound)
    assert bound == pytest.approx([*found.sigma.values()], rel=0.03)
    free = sp.calibrate(library("rssr"), table, list(TRUE), offsets=["crank"])
    assert free.values == pytest.approx(found.values, rel=1e-6)
    # without a sigma the residuals tell it, to some 10 %
    assert [*free.sigma.values()] == pytest.approx([*found.sigma.values()], rel=0.3)


def test_angles_alone_do_not_tell_the_size_of_a_mechanism():
    found = sp.calibrate(library("rssr"), turned(12), [*"abcd"], offsets=["crank"])
    assert len(found.undetermined) == 1
    for name in "abcd":
        assert f"{name} +" in found.undetermined[0]
        assert np.isinf(found.sigma[name])
    assert "crank" not in found.undetermined[0] and found.sigma["crank.offset"] < 1e-10
    assert found.values["a"] / found.values["d"] == pytest.approx(TRUE["a"] / 0.314, abs=1e-10)
    assert "unknown" in str(found) and "undetermined" in str(found)
    # a length tells it
    table = turned(12)
    end = sp.assemble(library("rssr", **TRUE), {"crank": 0.02})
    apart = np.linalg.norm(end.placement("ball_a").translation
                           - end.placement("rocker_b").translation)
    table[0][1]["ball_a"] = targets.distance("rocker_b", apart)
    found = sp.calibrate(library("rssr"), table, [*"abcd"], offsets=["crank"])
    assert not found.undetermined
    assert found.values["d"] == pytest.approx(0.314, abs=1e-10)


def test_what_has_no_effect_is_reported_by_name():
    m = library("stewart")
    state = sp.assemble(m)
    read = {name: state.coordinate(d.joint)[0] for name, d in m.drivers.items()}
    table = [({**read, "leg_1": read["leg_1"] + x}, {}) for x in np.linspace(0.0, 0.02, 4)]
    for given, seen in table:
        seen["platform"] = sp.assemble(m, given).placement("platform")
    found = sp.calibrate(m, table, ["rb", "h"])
    assert found.undetermined == ("h has no effect on the measurements",)
    assert found.values == pytest.approx({"rb": 0.3, "h": 0.36}, abs=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("loss", ["soft_l1", "huber", "cauchy", "arctan"])
def test_outliers_have_little_say_with_a_robust_loss(loss):
    noise, table = 1e-4, turned(60, noise=1e-4, seed=6)
    for i in (7, 20, 41):
        table[i][1]["rocker_pin"] += 0.05
    m, given = library("rssr"), {"offsets": ["crank"], "sigma": {"angle": noise}}
    true = np.array([*TRUE.values(), 0.02])
    plain = sp.calibrate(m, table, list(TRUE), **given)
    found = sp.calibrate(m, table, list(TRUE), loss=loss, **given)
    assert not plain.outliers
    assert {7, 20, 41} <= {i for i, _ in found.outliers}
    sigma = np.array([*found.sigma.values()])
    assert np.all(np.abs(np.array([*found.values.values()]) - true) < 4.0 * sigma)
    assert np.abs((np.array([*plain.values.values()]) - true) / sigma).max() > 10.0


def test_bounds_are_kept():
    found = sp.calibrate(library("rssr"), turned(12), {"a": (0.1, 0.103), "b": None, "c": None},
                         offsets=["crank"])
    assert 0.1 <= found.values["a"] <= 0.103


# ---------------------------------------------------------------- command line


def written(path, heads, rows):
    path.write_text("\n".join(",".join(map(str, row)) for row in [heads, *rows]) + "\n")
    return str(path)


def test_the_command_line_calibrates_by_a_table(tmp_path, run):
    table = written(tmp_path / "t.csv", ["crank [deg]", "rocker_pin [deg]"],
                    [np.rad2deg([read["crank"], seen["rocker_pin"]]) for read, seen in turned(12)])
    words = ["calibrate", "rssr", table, "--dimension", "a", "--dimension", "b=300mm..400mm",
             "--dimension", "c", "--offset", "crank", "--sigma", "angle=0.01deg"]
    names = [tmp_path / name for name in ("found.json", "residuals.csv", "built")]
    code, told, _ = run(*words, "--json", names[0], "--csv", names[1], "--folder", names[2])
    assert code == 0
    assert "rssr: 4 unknowns from 12 numbers of 12 measurements" in told and "wrote" in told
    content = json.loads(names[0].read_text())
    assert content["values"] == pytest.approx({**TRUE, "crank.offset": 0.02}, abs=1e-10)
    lines = names[1].read_text().splitlines()
    assert lines[0] == "measurement,of,unit,residual,before,weight" and len(lines) == 13
    assert lines[1].startswith("1,rocker_pin,rad,")
    loaded = sp.load(names[2] / "rssr.toml")
    there = sp.assemble(loaded, {"crank": 1.0}).placement("rocker_b")
    true = sp.assemble(library("rssr", **TRUE), {"crank": 1.0}).placement("rocker_b")
    assert np.abs(there.translation - true.translation).max() < 1e-9


def test_the_command_line_finds_bases_by_placements_points_and_distances(tmp_path, run):
    mechanism, heads = library("rssr", **TRUE), ["crank", *(
        f"rocker.{x} [mm]" for x in "xyz"), *(f"rocker.r{x} [deg]" for x in "xyz"),
        "ball_a-rocker_b [mm]"]
    rows = []
    for i, crank in enumerate(np.linspace(0.0, 2.0, 8)):
        state = sp.assemble(mechanism, {"crank": crank})
        at = BASE * state.placement("rocker")
        apart = np.linalg.norm(state.placement("ball_a").translation
                               - state.placement("rocker_b").translation)
        turned_by = np.rad2deg(pin.log3(at.rotation)) if i % 2 else [""] * 3  # a point alone
        rows.append([crank, *(1e3 * at.translation), *turned_by, 1e3 * apart if i < 2 else ""])
    words = ["calibrate", "rssr", written(tmp_path / "t.csv", heads, rows), "--base", "--json",
             "-", "--dimension", "a", "--set", f"b={TRUE['b']}", "--set", f"c={TRUE['c']}",
             "--sigma", "position=1mm", "--sigma", "rotation=1deg",
             "--sigma", "length=1mm", "--sigma", "encoder=1e-4"]
    code, said, _ = run(*words)
    assert code == 0
    content = json.loads(said)
    assert content["values"]["base.y"] == pytest.approx(2.0, abs=1e-8)
    assert content["values"]["a"] == pytest.approx(TRUE["a"], abs=1e-8)
    assert {x["of"] for x in content["residuals"]} == {
        *(f"rocker.{kind}.{x}" for kind in ("position", "rotation") for x in "xyz"),
        "ball_a-rocker_b", "crank_pin.encoder"}


@pytest.mark.parametrize(("heads", "row", "more", "words"), [
    (["crank", "rocker_pin"], [0.0, "x"], [], "line 2, column 2: 'x' is no number"),
    (["crank", "nobody"], [0.0, 1.0], [], "nobody"),
    (["crank", "coupler.x"], [0.0, 1.0], [], "row 1: no coupler.y, coupler.z"),
    (["crank", "coupler.x [deg]"], [0.0, 1.0], [], "is in m, not in deg"),
    (["crank", "rocker_pin"], ["", 1.0], [], "driver 'crank' has no value"),
    (["crank", "rocker_pin"], [0.0, ""], [], "nothing was measured"),
    (["crank", "rocker_pin"], [0.0, 1.0], ["--sigma", "angle=1mm"], "angle is in rad, not in mm"),
    (["crank", "rocker_pin"], [0.0, 1.0], ["--sigma", "crank.encoder=1mm"], "is in rad"),
    (["crank", "rocker_pin"], [0.0, 1.0], ["--sigma", "angle=1", "--sigma", "x.encoder=1"],
     "was not measured"),
    (["crank", "rocker_pin"], [0.0, 1.0], ["--dimension", "e"], "no dimension 'e'"),
    (["crank", "rocker_pin"], [0.0, 1.0], ["--json", "/nowhere/x.json"], "there is no folder"),
])
def test_the_command_line_refuses_bad_tables_in_words(heads, row, more, words, tmp_path, run):
    table = written(tmp_path / "t.csv", heads, [row])
    code, _, told = run("calibrate", "rssr", table, "--dimension", "a", *more)
    assert code == 1 and words in told


# ---------------------------------------------------------------- bad input


POINT = {"coupler": [0.0, 0.0, 0.0]}


@pytest.mark.parametrize(("measurements", "given", "error", "words"), [
    (6, {"dimensions": ["e"]}, sp.UnknownNameError, "no dimension 'e'"),
    ([({"crank": 0.0}, {"copler": [0.0, 0.0, 0.0]})], {"dimensions": ["a"]}, sp.UnknownNameError,
     "did you mean 'coupler'"),
    (2, {"dimensions": ["a", "b", "c"]}, ValueError, "3 unknowns need as many numbers"),
    ([({}, {"rocker_pin": 1.0})], {"dimensions": ["a"]}, ValueError, "driver 'crank' has no value"),
    ([({"crunk": 0.0}, POINT)], {"dimensions": ["a"]}, sp.UnknownNameError, "crunk"),
    ([({"crank": np.nan}, POINT)], {"dimensions": ["a"]}, ValueError, "NaN"),
    ([({"crank": 0.0}, {})], {"dimensions": ["a"]}, ValueError, "nothing was measured"),
    ([], {"dimensions": ["a"]}, ValueError, "measurements is empty"),
    ([3.0], {"dimensions": ["a"]}, TypeError, "measurement 1"),
    (6, {}, ValueError, "nothing is looked for"),
    (6, {"dimensions": ["a"], "offsets": ["ball"]}, sp.UnknownNameError, "ball"),
    (6, {"dimensions": ["a"], "offsets": ["rocker_pin"]}, ValueError, "no measurement"),
    (6, {"dimensions": {"a": (0.2, 0.1)}}, ValueError, "the least first"),
    (6, {"dimensions": {"a": (0.2, 0.3)}}, ValueError, "must hold its nominal value"),
    (6, {"dimensions": {"a": 0.2}}, ValueError, "are \\(least, most\\)"),
    (6, {"dimensions": ["a"], "loss": "l1"}, ValueError, "it is one of"),
    (6, {"dimensions": ["a"], "loss": "huber"}, ValueError, "needs sigma"),
    (6, {"dimensions": ["a"], "sigma": {"position": 1.0}}, ValueError, "add 'angle'"),
    (6, {"dimensions": ["a"], "sigma": {"angle": 1.0, "x": 1.0}}, ValueError, "has 'x'"),
    (6, {"dimensions": ["a"], "sigma": {"angle": 0.0}}, ValueError, "positive"),
    (6, {"dimensions": ["a"], "base": True}, ValueError, "7 unknowns"),
    (8, {"dimensions": ["a"], "base": 3}, TypeError, "base must be True"),
    (8, {"dimensions": ["a"], "base": True}, sp.SpatialPinError, "tells where the base"),
    ([({"crank": 0.0}, {"coupler": targets.orientation(np.eye(3))})], {"dimensions": ["a"]},
     sp.SpatialPinError, "can move where the drivers given stand"),
    ([({"crank": 0.0}, {"coupler": targets.centre_of_mass(0.0, 0.0, 0.0)})],
     {"dimensions": ["a"]}, TypeError, "calibration does not take"),
])
def test_bad_input_is_refused_in_words(measurements, given, error, words):
    if isinstance(measurements, int):
        measurements = turned(measurements)
    with pytest.raises(error, match=words):
        sp.calibrate(library("rssr"), measurements, **given)


TILTED = """<robot name="tilted" xmlns:xacro="http://www.ros.org/wiki/xacro">
<xacro:arg name="tilt" default="0"/><xacro:arg name="b" default="0.3"/>
<link name="ground"/><link name="crank"/><link name="coupler"/><link name="rocker"/>
<link name="one"/><link name="two"/>
<joint name="j1" type="continuous"><parent link="ground"/><child link="crank"/>
<axis xyz="0 0 1"/></joint>
<joint name="j2" type="continuous"><parent link="crank"/><child link="coupler"/>
<origin xyz="0.1 0 0" rpy="$(arg tilt) 0 0"/><axis xyz="0 0 1"/></joint>
<joint name="j3" type="continuous"><parent link="ground"/><child link="rocker"/>
<origin xyz="0.3 0 0"/><axis xyz="0 0 1"/></joint>
<joint name="p1" type="fixed"><parent link="coupler"/><child link="one"/>
<origin xyz="$(arg b) 0 0"/></joint>
<joint name="p2" type="fixed"><parent link="rocker"/><child link="two"/>
<origin xyz="0.2 0 0"/></joint></robot>"""


def test_a_dimension_that_opens_the_loops_is_refused(tmp_path):
    (tmp_path / "tilted.urdf.xacro").write_text(TILTED)
    (tmp_path / "tilted.toml").write_text(
        'name = "tilted"\ntree = "tilted.urdf.xacro"\n[[closures]]\nname = "pin"\n'
        'type = "revolute"\nframes = ["one", "two"]\naxis = [0, 0, 1]\n'
        '[drivers.crank]\njoint = "j1"\n[guess]\nj2 = 0.5\nj3 = 1.6\n')
    m = sp.load(tmp_path / "tilted.toml")
    motion = sp.sweep(m, "crank", np.linspace(0.5, 1.0, 6))
    table = [({"crank": x}, {"j3": motion.state(i).coordinate("j3")[0]})
             for i, x in enumerate(motion.driver)]
    assert sp.calibrate(m, table, ["b"]).values["b"] == pytest.approx(0.3, abs=1e-10)
    with pytest.raises(sp.SpatialPinError, match="open where 'tilt' alone is changed"):
        sp.calibrate(m, table, ["tilt"])


def test_a_measurement_that_cannot_be_reached_is_reported_by_number():
    table = measured(8, 0)
    table[3][0]["leg_2"] = 2.0
    with pytest.raises(sp.SpatialPinError, match="measurement 4 cannot be reached"):
        sp.calibrate(built()[0], table, PLACES[:3], offsets=LEGS)


def test_a_measurement_beside_a_singular_configuration_is_refused():
    """All links of the four-bar are in line at crank = pi: no derivative has a digit beside it."""
    mech, crank = library("four_bar", r3=0.16), {"crank": np.pi - 1e-8}
    seen = {"rocker_pin": sp.assemble(mech, crank).coordinate("rocker_pin").value}
    with pytest.raises(sp.SingularError, match="the derivatives have no reliable digit there"):
        sp.calibrate(mech, [(crank, seen)], ["r3"])


def test_a_file_or_table_of_measurements_is_refused_in_words():
    for measurements in ("poses.csv", {"crank": [0.0, 1.0]}):
        with pytest.raises(TypeError, match="spatial-pin calibrate"):
            sp.calibrate(library("four_bar"), measurements, ["r3"])


def test_where_nothing_has_an_effect_round_off_is_not_taken_for_one():
    m = library("geared_five_bar")  # a gear carries this crank whatever the links' lengths are
    table = [({"crank": x}, {"right_pin": sp.assemble(m, {"crank": x}).coordinate("right_pin")[0]})
             for x in np.linspace(0.0, 1.0, 6)]
    found = sp.calibrate(m, table, ["a", "b"])
    assert found.undetermined == tuple(f"{x} has no effect on the measurements" for x in "ab")
    assert np.isinf([*found.sigma.values()]).all()
