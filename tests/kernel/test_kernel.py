"""The compiled kernel: Pinocchio's and NumPy's numbers to round-off, whatever was asked before.

Arrays that nobody packed it refuses.
"""

from __future__ import annotations

import ctypes
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import mechanisms
import numpy as np
import odd_mechanisms
import pinocchio as pin
import pytest
import scipy.linalg
from closure_trees import JOINTS, TYPES, somewhere, tree_with
from folders import ROOT
from kernel_checks import (
    SEVERAL,
    asked_at,
    assert_near,
    assert_same_as_pinocchio,
    check_kernel,
    configurations,
    evaluated,
    everything,
)
from loaded_library import library as from_library
from variety import each, few

import spatial_pin as sp
from spatial_pin.kernel.closer import ClosureTask, NamedStruct
from spatial_pin.kernel.kernel import EvaluationStruct, Kernel, address
from spatial_pin.kernel.library import CODES, library
from spatial_pin.kernel.paths import (
    Path as KernelPath,
    PathSamples,
    _AccuracyStruct,
    _PathTask,
    _RowsStruct,
    _ScatterTask,
)
from spatial_pin.kernel.rate_solver import _RateTask
from spatial_pin.settings import Accuracy

SCRIPTS = ROOT / "scripts"
LIBRARY = sorted(p.stem for p in (Path(sp.__file__).parents[1] / "urdf").glob("*.toml"))


# ---------------------------------------------------------------- mechanisms


# ---------------------------------------------------------------- Pinocchio is the authority


@pytest.mark.parametrize("joint", few(JOINTS, "revolute", "screw", "universal", "floating"))
def test_every_joint_with_every_closure(tmp_path, joint):
    for seed, kind in enumerate(TYPES):
        mechanism, rng = tree_with(tmp_path, joint, ("leaf", "right"), kind, seed)
        for _ in range(3):
            assert_same_as_pinocchio(mechanism, *asked_at(mechanism, rng))


@pytest.mark.parametrize("size", few([1e-30, 1e-6, 1.0, 1e6, 1e30], 1e-30, 1.0, 1e6))
def test_all_kinds_together_at_every_size(tmp_path, size):
    for seed in range(6):
        mechanism, rng = everything(tmp_path, seed, size), np.random.default_rng(seed)
        for _ in range(3):
            assert_same_as_pinocchio(mechanism, *asked_at(mechanism, rng))


@pytest.mark.parametrize("first", few(range(0, 40, 10), 0))
def test_random_mechanisms(tmp_path, monkeypatch, first):
    monkeypatch.syspath_prepend(str(SCRIPTS))
    from fuzzing.files import write
    from fuzzing.generate import make

    for seed in range(first, first + 10):
        mechanism, rng = sp.load(write(make(seed), tmp_path)), np.random.default_rng(seed)
        assert_same_as_pinocchio(mechanism, *asked_at(mechanism, rng))


@pytest.mark.parametrize("name", each(LIBRARY))
def test_the_library(name):
    mechanism, rng = from_library(name), np.random.default_rng(1)
    assert_same_as_pinocchio(mechanism, *asked_at(mechanism, rng))
    assert_same_as_pinocchio(mechanism, sp.assemble(mechanism).q, np.zeros(mechanism.model.nv))


@pytest.mark.parametrize("builders", [
    {name: known.build for name, known in mechanisms.KNOWN.items()}, odd_mechanisms.EMPTY,
    odd_mechanisms.FREE], ids=["known", "empty", "free"])
def test_mechanisms_of_other_tests(tmp_path, builders):
    rng = np.random.default_rng(1)
    for build in builders.values():
        mechanism = build(tmp_path)
        assert_same_as_pinocchio(mechanism, *asked_at(mechanism, rng))


@pytest.mark.parametrize("size", [0.0, 1e-300, 1e-9, 1e-4, 1.0, 3.0, 100.0])
def test_displacements_are_pinocchios(tmp_path, size):
    mechanism, rng = everything(tmp_path, 1), np.random.default_rng(5)
    kernel = Kernel(mechanism)
    for _ in range(20):
        q, step = somewhere(mechanism, rng), size * rng.normal(size=mechanism.model.nv)
        expected = pin.integrate(mechanism.model, q, step)
        moved = integrated(kernel, q, step)
        assert_near(moved, expected, 1.0 + float(np.abs(expected).max()), f"step of {size}")


def integrated(kernel: Kernel, q: np.ndarray, step: np.ndarray) -> np.ndarray:
    moved = q.copy()
    library().kernel_integrate(kernel.handle, 1, address(moved), address(step))
    return moved


# ---------------------------------------------------------------- the square system


def square_system(mechanism: sp.Mechanism, rng: np.random.Generator):
    """A kernel, q, and equations, driven freedoms and filled rows that determine everything.

    Driven first is a coordinate that has a value of its own.
    """
    kernel = Kernel(mechanism)
    q, v = asked_at(mechanism, rng)
    jacobian = evaluated(kernel, q, v, np.zeros(kernel.n_angles)).jacobian
    closures, idle = jacobian[: kernel.n_closure], jacobian[kernel.n_closure :]
    unit = np.eye(kernel.nv)
    single = [c.v for c in mechanism.coordinate_table.values() if c.q >= 0]
    first = independent(unit, rng.permutation(single), idle)[:1]
    kept = independent(closures, rng.permutation(kernel.n_closure), np.vstack([idle, unit[first]]))
    rows = np.vstack([closures[kept], idle, unit[first]])
    missing = kernel.nv - len(rows)
    more = independent(unit, rng.permutation(kernel.nv), rows)[: missing // 2]
    rows = np.vstack([rows, unit[more]])
    fill = scipy.linalg.null_space(rows).T
    return kernel, q, kept, np.append(first, more), fill, np.vstack([rows, fill])


def independent(rows: np.ndarray, order: np.ndarray, beside: np.ndarray) -> np.ndarray:
    """Numbers of rows that are well independent of each other and of those beside them."""
    basis, kept = list(beside), []
    for i in order:
        if len(basis) == rows.shape[1]:
            break
        if np.linalg.svd(np.array([*basis, rows[i]]), compute_uv=False).min(initial=1.0) > 0.02:
            basis.append(rows[i])
            kept.append(i)
    return np.sort(np.array(kept, np.int64))


def rates_of_path(kernel: Kernel, q, kept, driven, fill) -> tuple[np.ndarray, np.ndarray]:
    """First and second derivatives by what is driven first, scaled: solutions of the system."""
    path = KernelPath(kernel, kept, driven.tolist(), fill, Accuracy())
    assert path.start(q, np.zeros(kernel.n_angles))
    _, sample = path.here
    return sample.t[0], sample.c[0]


@pytest.mark.parametrize("seed", range(8))
def test_square_systems_are_solved_as_by_numpy(tmp_path, seed):
    """They need not be closed for that: rates at a place depend on it alone."""
    rng = np.random.default_rng(seed)
    mechanism = everything(tmp_path, seed)
    scale = mechanism.velocity_scale
    for _ in range(3):
        kernel, q, kept, driven, fill, matrix = square_system(mechanism, rng)
        first, second = rates_of_path(kernel, q, kept, driven, fill)
        bias = evaluated(kernel, q, first, np.zeros(kernel.n_angles)).bias
        n, idle = len(kept), kernel.n_passive  # rows: chosen, idle, driven, filled
        right = np.zeros((2, kernel.nv))
        right[0, n + idle] = 1.0 / scale[driven[0]]
        right[1, :n], right[1, n : n + idle] = -bias[kept], -bias[kernel.n_closure :]
        for x, b in zip((first / scale, second / scale), right, strict=True):
            # backward error, then the solution itself
            assert np.abs(matrix @ x - b).max() < 1e-13 * (
                1.0 + np.abs(matrix).sum(axis=1).max() * np.abs(x).max())
            other = np.linalg.solve(matrix, b)
            condition = np.linalg.cond(matrix)
            assert np.abs(x - other).max() <= 1e-15 * condition * len(x) * np.abs(other).max()


def test_a_system_without_solution_starts_no_path(tmp_path):
    mechanism = everything(tmp_path, 3)
    kernel, q, kept, driven, fill, _ = square_system(mechanism, np.random.default_rng(3))
    twice = np.array([kept[0], *kept[:-1]])
    path = KernelPath(kernel, twice, driven.tolist(), fill, Accuracy())
    assert not path.start(q, np.zeros(kernel.n_angles))


# ---------------------------------------------------------------- arrays of nobody


HEAD = 14  # counts that begin the integers, see `read_structure` in model.c
WILD = np.array([0, 1, -1, 2, 3, 4, 5, 6, 7, 100, -100, 10**5, 10**8, 10**8 + 1, 2**31, 2**32,
                 2**62, 2**63 - 1, -(2**63)])
ODD = np.array([0.0, -0.0, 1.0, -1.0, 1e308, -1e308, 1e-308, 5e-324, np.nan, np.inf, -np.inf, 1e20])


def made_of(ints: np.ndarray, reals: np.ndarray) -> tuple[str, ctypes.c_void_p]:
    """What the kernel says of arrays, and the kernel if it takes them."""
    # copies of their own: a sanitizer then notices a single entry read beyond the end
    ints, reals, handle = ints.astype(np.int64), reals.astype(float), ctypes.c_void_p()
    code = library().kernel_create(address(ints), len(ints), address(reals), len(reals), None, 0,
                                   ctypes.byref(handle))
    assert (code == 0) == bool(handle)
    return CODES[code], handle


def use(handle: ctypes.c_void_p, ints: np.ndarray, reals: np.ndarray, rng) -> set[str]:
    """Ask everything of a kernel of arrays, at any configuration; how that ended."""
    c = library()
    n, nq, nv, _, _, n_closure, n_idle, n_angles = (int(x) for x in ints[:8])
    q, v, turns = rng.normal(size=nq), rng.normal(size=nv), rng.normal(size=n_angles)
    if rng.random() < 0.3 and nq:
        q[rng.integers(nq)] = rng.choice(ODD)
    sizes = (9 * n, 3 * n, n_closure, n_angles, (n_closure + n_idle + n_angles) * nv,
             n_closure + n_idle)
    out = [np.empty(size) for size in sizes]
    task = EvaluationStruct(1, *map(address, (q, v, turns)), **dict(zip(
        ("R", "p", "residual", "angle", "jacobian", "bias"), map(address, out), strict=True)))
    ends = {c.kernel_evaluate(handle, ctypes.byref(task))}
    c.kernel_integrate(handle, 1, address(q), address(v))
    ends |= use_rates(handle, ints, q, turns, rng) | use_closer(handle, ints, q, turns, rng)
    ends |= use_path(handle, ints, q, turns, rng)
    reals = mutated(reals, ODD, rng).astype(float)
    ends.add(c.kernel_set_numbers(handle, address(reals), len(reals)))
    base, places = reals.copy(), wild_places(len(reals), rng, 3)
    varied = rng.choice(ODD, 3)
    task.base, task.n_reals, task.n_varied = address(base), len(base), 3
    task.varied_index, task.varied = address(places), address(varied)
    ends.add(c.kernel_evaluate(handle, ctypes.byref(task)))
    ends |= use_path(handle, ints, q, turns, rng)
    c.kernel_destroy(handle)
    return {CODES[end] for end in ends}


def wild_places(n: int, rng, *shape: int) -> np.ndarray:
    """Places below n, and sometimes some that are none."""
    found = rng.integers(0, max(n, 1), shape)
    return np.where(rng.random(shape) < 0.1, rng.choice(WILD, shape), found)


def use_rates(handle: ctypes.c_void_p, ints: np.ndarray, q, turns, rng) -> set[int]:
    c, rates = library(), ctypes.c_void_p()
    n, nv, free = int(ints[0]), int(ints[2]), max(int(ints[2] - ints[6] - ints[5]), 0)
    count = free + int(rng.integers(-1, 2)) if rng.random() < 0.5 else int(rng.integers(-1, nv + 2))
    driven = wild_places(nv, rng, max(count, 0))
    moving = int(rng.integers(0, max(count, 0) + 1)) + int(rng.choice([0] * 8 + [-1, 1]))
    end = c.rates_create(handle, address(driven), count, moving, ctypes.byref(rates))
    assert (end == 0) == bool(rates)
    if end:
        return {end}
    m, speed, v, local = 2, np.ones((2, 2, count)), np.empty((3, 2, nv)), rng.normal(size=3)
    first, second = np.empty((m, nv, moving)), np.empty((m, nv, moving, moving))
    jacobians, facts, codes = np.empty((2, m, 6, moving)), np.empty((m, 3)), np.zeros(m, np.int64)
    closed, idle = int(ints[5]), int(ints[6])
    chosen = wild_places(closed, rng, int(rng.integers(0, max(closed, 0) + 1)))
    fill = rng.normal(size=(max(nv - idle - count - len(chosen), 0), nv))
    v[2] = rng.normal(size=(2, nv))
    both = np.array([q, q]), np.array([turns, turns])
    task = _RateTask(
        m, *map(address, both), rng.choice([None, address(chosen)]), len(chosen), address(fill),
        len(fill), address(speed[0]), address(speed[1]), address(v[2]),
        int(wild_places(n, rng, 1)[0]), rng.choice([None, address(local)]), *map(address, (
            codes, first, second, jacobians[0], jacobians[1], v[0], v[1], facts)))
    bias = np.ones(max(closed + idle, 0))
    there = np.empty(int(ints[1]))
    few = rng.normal(size=(max(nv - idle - len(chosen), 0), nv))
    ends = {c.tangent_step(handle, address(q), address(turns), address(chosen), len(chosen),
                           address(few), len(few), address(there)),
            c.rates_solve(rates, ctypes.byref(task)), *codes.tolist()}
    task.speed = None
    for given in ((v[0], None), (None, bias), (v[0], bias)):
        ends |= {c.rates_solve(rates, ctypes.byref(task)), *codes.tolist()}
        ends.add(c.rates_answer(rates, *(None if x is None else address(x) for x in given),
                                address(speed[0]), address(v[1])))
    task.n = -1
    ends.add(c.rates_solve(rates, ctypes.byref(task)))
    return ends


def use_closer(handle: ctypes.c_void_p, ints: np.ndarray, q, turns, rng) -> set[int]:
    c, closer = library(), ctypes.c_void_p()
    nq, nv, closed = int(ints[1]), int(ints[2]), int(ints[5])
    n, m = (int(x) for x in rng.integers(0, 3, 2))
    rotations = np.array([wild_places(closed, rng, n), rng.choice([1, 3, 3, 2], n)])
    pins = np.column_stack([wild_places(nq, rng, m), wild_places(nv, rng, m),
                            wild_places(3, rng, m), wild_places(2, rng, m)])
    end = c.closer_create(handle, address(rotations), n, address(pins), m, None, None, 0,
                          ctypes.byref(closer))
    assert (end == 0) == bool(closer)
    if not end:
        free, pinned = rng.integers(0, 2, nv), rng.choice(ODD, m)
        two, angles, facts, mirrored = (
            np.array([q, q]), turns.copy(), np.empty(4), np.empty(1, np.int64))
        kinds, values = rng.integers(0, 8, nq), rng.choice(ODD, nq)
        limits = rng.choice(ODD, (2, nq))
        named = NamedStruct(rng.choice([None, address(values)]), *map(address, (kinds, *limits)))
        for out in (None, address(angles)):
            end = c.closer_examine(closer, address(two[0]), address(turns), ctypes.byref(named),
                                   address(facts), out, address(mirrored))
        c.closer_descend(closer, 2, address(two), address(free), 1e-3, 4, address(facts))
        end = close_wildly(handle, closer, nv, q, turns, pinned, rng)[0]
    return {end}


def close_wildly(kernel, closer, nv: int, q, turns, pinned, rng, path=None, values=()):
    """Close from one or two starts, and further ones; follow a path from there, if there is one."""
    nq, n = len(q), int(rng.integers(1, 3))
    rows = np.array([q] * (n + 3))
    free, first, kinds = (rng.integers(0, k, size) for k, size in ((2, nv), (2, nv), (8, nq)))
    limits, named, facts = rng.choice(ODD, (2, nq)), rng.choice([*ODD, *q], nq), np.empty(4)
    steps, angles = rng.normal(size=(3, nv)), turns.copy()
    moved, group = (rng.integers(-1, 3, size) for size in (3, nv))
    found = [np.empty(n + 3), np.empty(n + 3, np.int64), np.empty(n + 3)]
    task = ClosureTask(
        n, address(rows), rng.choice([None, address(first)]), address(free), 1e-2, 1e-6, 4,
        address(pinned), address(turns), 1e-12,
        NamedStruct(rng.choice([None, address(named)]), *map(address, (kinds, *limits))),
        int(rng.integers(0, 4)), address(steps), rng.choice([0.0, 1e-2, 1e3]), address(moved),
        address(group), address(found[0]), address(found[2]), address(found[1]),
        rng.choice([None, address(facts)]), address(angles))
    if path is None:
        return library().closer_close(closer, ctypes.byref(task)), 0
    task.m, task.facts = 1, address(facts)
    values, samples = np.array(values), PathSamples.empty(len(values), nq, nv, len(turns))
    path_rows = _RowsStruct(*map(address, samples))
    return 0, library().path_from_guess(
        kernel, ctypes.byref(path), closer, ctypes.byref(task), address(values), len(values),
        ctypes.byref(path_rows))


def use_path(handle: ctypes.c_void_p, ints: np.ndarray, q, turns, rng) -> set[int]:
    """Follow a path a little, whatever the square system is."""
    c, nv, n_closure, n_idle = library(), *(int(ints[k]) for k in (2, 5, 6))
    chosen = rng.integers(-1, n_closure + 1, max(nv - n_idle, 0))
    chosen, driven = np.split(chosen, [rng.integers(len(chosen) + 1)])
    driven, fill = np.split(driven, [rng.integers(len(driven) + 1)])
    if rng.random() < 0.7:
        chosen, driven = np.unique(np.abs(chosen)), np.unique(np.abs(driven))
    if rng.random() < 0.5:
        driven = rng.integers(-1, 2 * nv + 1, len(driven))
    fill = rng.choice(ODD, (max(nv - n_idle - len(chosen) - len(driven), 0), nv))
    here, s = PathSamples.empty(1, len(q), nv, len(turns)), np.empty(1)
    task = _PathTask(
        rng.choice([None, address(chosen)]), len(chosen), address(driven), len(driven),
        address(fill), len(fill),
        _AccuracyStruct(1e-13, 1e-13, 1e-12, 0.1, rng.choice([0.0, 1e-6]), int(rng.integers(0, 4)),
                        int(rng.integers(-1, 3))),
        s=address(s), here=_RowsStruct(*map(address, here)))
    pieces, degree = int(rng.integers(-1, 4)), int(rng.choice([-1, 0, 1, 3, 101]))
    breaks = np.sort(rng.normal(size=max(pieces, 0) + 1))
    numbers = rng.normal(size=(max(pieces, 0), nv, max(degree, 0) + 1))
    if rng.random() < 0.3:  # polynomials of any number, sound or not
        if rng.random() < 0.3:
            breaks[rng.integers(len(breaks))] = rng.choice(ODD)
            numbers[rng.random(numbers.shape) < 0.2] = rng.choice(ODD)
        task.begin, task.n_pieces, task.degree = rng.choice([0.0, 0.1, *ODD]), pieces, degree
        task.breaks, task.coefficients = address(breaks), address(numbers)
    ends = {c.path_start(handle, ctypes.byref(task), address(q), address(turns))}
    samples = PathSamples.empty(4, len(q), nv, len(turns))
    rows = _RowsStruct(*map(address, samples))
    start = s[0] if ends == {0} else 0.0
    values = np.append(start + rng.normal(size=3), rng.choice([np.nan, np.inf, start, *ODD]))
    reached = c.path_follow(handle, address(values), len(values), ctypes.byref(rows))
    assert 0 <= reached <= len(values) * (ends == {0})
    n_values, parts = int(rng.integers(-1, len(driven) + 2)), np.array([0.0, 0.0, 0.0, 1.0])
    line, values4 = rng.normal(size=(len(driven), 2)), rng.normal(size=(4, max(n_values, 0)))
    wanted, parents = wild_places(4, rng, 3), wild_places(4, rng, 4)
    samples.q[:], samples.angles[:], samples.error[:] = q, turns, 0.0
    scatter = _ScatterTask(4, 3, address(wanted), address(parents), n_values, address(values4),
                           address(line), int(rng.integers(0, 2)), rows, address(parts))
    ends.add(c.path_scatter(handle, ctypes.byref(task), ctypes.byref(scatter)))
    closer = ctypes.c_void_p()
    if not c.closer_create(handle, None, 0, None, 0, None, None, 0, ctypes.byref(closer)):
        done = close_wildly(handle, closer, nv, q, turns, np.empty(0), rng, task, values)[1]
        assert -1 <= done <= len(values)
    return ends


def mutated(array: np.ndarray, values: np.ndarray, rng) -> np.ndarray:
    """An array with some entries replaced, or shortened or lengthened."""
    out = array.copy()
    for _ in range(rng.integers(1, 4)):
        out[rng.integers(len(out))] = rng.choice(values)
    if rng.random() < 0.1:
        out = out[: rng.integers(len(out) + 1)]
    elif rng.random() < 0.1:
        out = np.append(out, rng.choice(values, rng.integers(1, 5)))
    return out


def test_every_integer_is_looked_at(tmp_path):
    """Whichever is wild, the arrays are refused, or make a kernel that answers."""
    kernel = Kernel(everything(tmp_path, 6))
    ints, reals = kernel.packed.ints, kernel.packed.reals
    rng, ends = np.random.default_rng(1), set()
    for at in range(len(ints)):
        for value in [*rng.choice(WILD, 2), ints[at] + 1, ints[at] - 1]:
            wild = ints.copy()
            wild[at] = value
            end, handle = made_of(wild, reals)
            ends |= {end} | (use(handle, wild, reals, rng) if handle else set())
    assert ends >= {"done", "arrays that do not fit together", "a singular system"}


@pytest.mark.parametrize("build", [mechanisms.rssp, mechanisms.geared_five_bar,
                                   mechanisms.press_closure, everything])
@pytest.mark.parametrize("times", few([300, 1500], 300))
def test_damaged_arrays_are_refused_or_answered(tmp_path, build, times):
    kernel = Kernel(build(tmp_path, *[1][: build is everything]))
    ints, reals = kernel.packed.ints, kernel.packed.reals
    rng, ends = np.random.default_rng(2), set()
    for _ in range(times):
        bad = mutated(ints, np.append(WILD, rng.choice(ints, 20)), rng)
        numbers = reals if rng.random() < 0.5 else mutated(reals, ODD, rng)
        for wild in (bad, ints):
            end, handle = made_of(wild, numbers)
            ends |= {end} | (use(handle, wild, numbers, rng) if handle else set())
    assert ends >= {"done", "arrays that do not fit together", "not finite"}


def test_arrays_that_end_early_or_late_are_refused(tmp_path):
    kernel = Kernel(everything(tmp_path, 1))
    ints, reals = kernel.packed.ints, kernel.packed.reals
    cuts = [*((ints[:n], reals) for n in range(len(ints))),
            *((ints, reals[:n]) for n in range(len(reals))),
            (np.append(ints, 0), reals), (ints, np.append(reals, 0.0))]
    assert {made_of(*cut)[0] for cut in cuts} == {"arrays that do not fit together"}


# ---------------------------------------------------------------- who asks, and after what


def answers(kernel: Kernel, mechanism: sp.Mechanism, seed: int) -> bytes:
    """All that a kernel says of some configurations, bit by bit."""
    rng, said = np.random.default_rng(seed), []
    for _ in range(5):
        q, v = asked_at(mechanism, rng)
        said += evaluated(kernel, q, v, np.zeros(kernel.n_angles))
        said.append(integrated(kernel, q, v))
    _, q, *system, _ = square_system(mechanism, rng)
    said += rates_of_path(kernel, q, *system)
    return b"".join(np.ascontiguousarray(x).tobytes() for x in said)


def test_answers_do_not_depend_on_earlier_calls(tmp_path):
    mechanism = everything(tmp_path, 2)
    used, c = Kernel(mechanism), library()
    first = answers(used, mechanism, 1)
    assert answers(Kernel(mechanism), mechanism, 1) == first
    answers(used, mechanism, 2)
    bad = np.full(used.nq, np.nan)
    evaluated(used, bad, np.full(used.nv, np.inf), np.zeros(used.n_angles))
    path = KernelPath(used, None, [0], None, Accuracy())
    assert not path.start(bad, np.full(used.n_angles, 1e300))
    own = used.packed.reals
    other = own * 3.0
    assert not c.kernel_set_numbers(used.handle, address(other), len(other))
    evaluated(used, mechanism.neutral, np.ones(used.nv), np.zeros(used.n_angles))
    assert not c.kernel_set_numbers(used.handle, address(own), len(own))
    assert answers(used, mechanism, 1) == first


def test_two_threads_with_a_kernel_each_answer_as_one(tmp_path):
    assert not isinstance(library(), ctypes.PyDLL)  # that is: the interpreter is let go
    made = [everything(tmp_path, seed) for seed in (4, 5)]
    alone = [answers(Kernel(m), m, 7) for m in made]
    kernels = [Kernel(m) for m in made]

    def ask(k: int) -> list[bytes]:
        return [answers(kernels[k], made[k], 7) for _ in range(8)]

    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    try:
        with ThreadPoolExecutor(2) as pool:
            found = list(pool.map(ask, (0, 1)))
    finally:
        sys.setswitchinterval(before)
    assert [set(f) for f in found] == [{a} for a in alone]


def test_arrays_that_are_not_contiguous_are_refused():
    """C would read what stands between their entries."""
    numbers = np.arange(6.0)
    with pytest.raises(TypeError):
        address(numbers[::2])
    numbers.setflags(write=False)
    assert address(numbers) == numbers.ctypes.data
    assert address(np.empty(0)) == address(np.empty((3, 0)))


# ---------------------------------------------------------------- several configurations


@pytest.mark.parametrize("joint", JOINTS)
def test_several_configurations_are_each_pinocchios(tmp_path, joint):
    mechanism, rng = tree_with(tmp_path, joint, ("leaf", "right"), "spherical", 5)
    q = configurations(mechanism, 6)
    check_kernel(mechanism, q)
    steps = rng.uniform(-1.0, 1.0, (mechanism.model.nv, SEVERAL)) * [1.0, 0.1, 1e-4, 1e-9]
    moved = Kernel(mechanism).displaced(q.T, steps.T)
    for k in range(SEVERAL):
        np.testing.assert_allclose(moved[k], pin.integrate(mechanism.model, q[:, k], steps[:, k]),
                                   rtol=0, atol=3e-15)


@pytest.mark.parametrize("name", each(LIBRARY))
def test_several_configurations_of_the_library(name):
    mechanism = from_library(name)
    check_kernel(mechanism, configurations(mechanism, 12))
