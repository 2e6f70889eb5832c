"""Goals that cannot be met, alone or together, whatever the dimensions are."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence

import numpy as np

from spatial_pin.dimensions.family import Bodies
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array, decompose
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.synthesis.demands.swing import Swing
from spatial_pin.synthesis.precision import Function, Goal, Path, Poses, Precision


def refuse_contradictions(mechanism: Mechanism, goals: Sequence[Goal]) -> None:
    """Refuse goals that are to be met exactly and ask for two things at one place.

    Goals of precision do if their drivers have the same values and their targets differ, and two
    swings of one motion. Nothing is said of goals with a weight, and of those whose drawing, zeros
    or drivers are free.

    Raises:
        ValueError: names the goals and their samples.
    """
    exact = [goal for goal in goals if isinstance(goal, Precision) and _stands(goal)]
    for first, second in itertools.combinations_with_replacement(exact, 2):
        for i, j in _pairs(mechanism, first, second):
            raise ValueError(
                f"goals contradict: {first.name}, sample {i}, and {second.name}, sample {j}, have "
                "the same drivers and other targets; give one of them a weight, or leave it out")
    swings = [goal for goal in goals if isinstance(goal, Swing) and goal.weight is None]
    for one, other in itertools.combinations(swings, 2):
        if _of_one_motion(mechanism, one, other) and one.angle != other.angle:
            raise ValueError(
                f"goals contradict: {one.name} is to be {one.angle:g} and {other.angle:g}; give "
                "one of them a weight, or leave it out")


def exact_points(goals: Sequence[Goal]) -> list[Path | Poses]:
    """Return the goals that ask for points of the world itself, exactly."""
    return [goal for goal in goals if isinstance(goal, Path | Poses)
            and goal.weight is None and not goal.own_names]


def refuse_off_plane(bodies: Bodies, goals: Sequence[Goal]) -> None:
    """Refuse exact points that are off the plane, or line, that a frame stays in.

    Args:
        bodies: the mechanism at dimensions and joint values anywhere, its loops open: what the
            joints of the tree alone hold in a plane, closed loops do.
        goals: what is asked for.

    Raises:
        ValueError: names the goal and its sample.
    """
    size = bodies.mechanism.characteristic_length
    if not len(bodies.q):
        return
    for goal in exact_points(goals):
        origin = bodies.origin(goal.frame)
        moved = bodies.frame_jacobian(goal.frame, origin)[:, :3]
        ways = np.concatenate([moved.transpose(0, 2, 1).reshape(-1, 3), origin - origin[0]])
        svd = decompose(ways, TOLERANCES.half_precision)
        off = np.linalg.norm((goal.points - origin[0]) @ svd.vt[svd.rank :].T, axis=1)
        worst = int(np.argmax(off))
        if off[worst] > TOLERANCES.nothing * size:
            raise ValueError(
                f"{goal.name}: whatever the dimensions are, {goal.frame!r} stays "
                f"{('at a point', 'on a line', 'in a plane')[svd.rank]}, and sample {worst} is "
                f"{off[worst]:.3g} m off it; ask for points there, or give the goal a weight or "
                "a free placement")


def _of_one_motion(mechanism: Mechanism, one: Swing, other: Swing) -> bool:
    """Return whether two swings are those of one output in one motion."""
    names, outputs = zip(*((mechanism.driven_coordinate(swing.moved_by(mechanism)).name,
                            mechanism.coordinate(swing.output).name) for swing in (one, other)),
                         strict=True)
    if one.at is None or other.at is None:
        same = one.at is other.at
    else:
        same = np.array_equal(one.at, other.at)
    return names[0] == names[1] and outputs[0] == outputs[1] and same


def _stands(goal: Precision) -> bool:
    free = bool(goal.own_names) or goal.input_offset
    return goal.weight is None and bool(goal.drivers) and not free


def _pairs(mechanism: Mechanism, first: Precision, second: Precision) -> Iterator[tuple[int, int]]:
    """Yield numbers of samples at the same drivers with other targets."""
    names = {mechanism.driven_coordinate(name).name: name for name in first.drivers}
    others = {mechanism.driven_coordinate(name).name: name for name in second.drivers}
    if names.keys() != others.keys() or _what(first) != _what(second):
        return
    here = np.array([first.drivers[name] for name in names.values()]).T
    there = np.array([second.drivers[others[name]] for name in names]).T
    for i, j in itertools.product(range(len(first)), range(len(second))):
        same = np.abs(here[i] - there[j]).max() <= TOLERANCES.round_off
        if same and _apart(mechanism, _target(first, i), _target(second, j)):
            yield i, j


def _what(goal: Precision) -> tuple[type, str]:
    name = goal.output if isinstance(goal, Function) else str(getattr(goal, "frame", ""))
    return type(goal), name


def _target(goal: Precision, i: int) -> Array:
    if isinstance(goal, Poses):
        return np.concatenate([goal.points[i], goal.rotations[i].ravel()])
    if isinstance(goal, Path):
        return goal.points[i]
    assert isinstance(goal, Function)
    return goal.values[i : i + 1]


def _apart(mechanism: Mechanism, first: Array, second: Array) -> bool:
    """Return whether targets differ: angles, the only single numbers, but for whole turns."""
    away = first - second
    if len(away) == 1:
        away = 2.0 * np.sin(0.5 * away)
    return bool(np.abs(away).max() > TOLERANCES.tight * max(1.0, mechanism.characteristic_length))
