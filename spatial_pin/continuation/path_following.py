"""Samples of a branch at driver values, in the best order, through branch points."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin.continuation.branch_points import passage
from spatial_pin.continuation.path_tracker import STRETCH, PathPoint, PathTracker
from spatial_pin.continuation.pseudo_arclength import CROSSINGS, Stopped
from spatial_pin.errors import SpatialPinError
from spatial_pin.kernel.paths import PathSamples
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array

# Values are sorted if following them in the given order is more than this many times longer.
# Random values are, values with one or two reversals are not.
SORTED_FROM = 3.0
# Joint coordinates computed in one call of the kernel: 0.1 s, so that Ctrl-C is answered.
CHUNK = 200_000


class Followed(NamedTuple):
    """The samples of a followed branch, and how it ended.

    Attributes:
        samples: the first `done` of them are done.
        done: how many.
        stop: what ended it before the last; None if nothing did.
        crossed: branch points passed, each with the number of the sample behind it.
        undriven: the same of configurations in which the drivers alone do not determine a motion
            that targets do.
        is_cut: whether Ctrl-C ended it.
        released: sentences on held coordinates that do not stand where the guess has them.
    """

    samples: PathSamples
    done: int
    stop: Stopped | None = None
    crossed: Sequence[tuple[float, int]] = ()
    undriven: Sequence[tuple[float, int]] = ()
    is_cut: bool = False
    released: Sequence[str] = ()


def both_ways_order(values: Array) -> list[NDArray[np.intp]] | None:
    """Return the indices of values above the first one, rising, and below it, falling.

    None where following the values as given is not much longer.
    """
    if len(values) < 3 or not np.count_nonzero(values[1:] < values[:-1]):
        return None
    with np.errstate(over="ignore"):
        length = np.abs(values[1:] - values[:-1]).sum()
        if length / SORTED_FROM <= abs(values[-1] - values[0]):  # as most are
            return None
        first, low, high = values[0], values.min(), values.max()
        if not length / SORTED_FROM > high - low + min(high - first, first - low):
            return None
    order = np.argsort(values, kind="stable")
    up, down = order[values[order] >= first], order[values[order] < first][::-1]
    return [part for part in (up, down) if part.size]


def followed_both_ways(
    tracker: PathTracker, values: Array, ways: list[NDArray[np.intp]], bar: Any
) -> Followed | None:
    """Return the samples, followed in the order of their values, up and down from the first.

    None where the branch ends or crosses another, the tracker at the start again: which samples
    come before that depends on the requested order.
    """
    samples = tracker.room_for(len(values))
    for k, order in enumerate(ways):
        own = tracker.room_for(len(order))
        if k:
            tracker.start()
        try:
            for _ in _follow(tracker, values[order], own, None):
                pass
        except (Stopped, SpatialPinError):
            bar.reset()
            tracker.start()
            return None
        bar.update(len(order))
        for whole, part in zip(samples, own, strict=True):
            whole[order] = part
    return Followed(samples, len(values))


def followed(
    tracker: PathTracker, values: Array, samples: PathSamples, passes: bool, bar: Any,
    n_done: int = 0,
) -> Followed:
    """Write the samples of a branch at values of the parameter, as far as it goes.

    The tracker is at the first value, or behind the `n_done` samples that the kernel has computed.
    `passes`: whether to go straight on where branches cross.

    Raises:
        SingularError: the driver does not determine the motion at the start.
        KeyboardInterrupt: before anything was followed.
    """
    done, crossed = n_done, list[tuple[float, int]]()
    try:
        for done in _follow(tracker, values, samples, crossed if passes else None, n_done):
            bar.update(done - bar.n)
    except Stopped as caught:
        return Followed(samples, caught.sample, caught.with_traceback(None), crossed)
    except KeyboardInterrupt:
        if not done:
            raise
        return Followed(samples, done, None, crossed, is_cut=True)
    return Followed(samples, len(values), None, crossed)


def _follow(
    tracker: PathTracker, values: Array, samples: PathSamples,
    crossed: list[tuple[float, int]] | None, n_done: int = 0,
) -> Iterator[int]:
    """Write the samples of a branch; yields the number of those done.

    Branch points that are passed are added to `crossed`, if that is a list, as (value, sample).

    Raises:
        Stopped: a value cannot be reached; says which, and where the branch ended.
        SingularError: the driver does not determine the motion there.
    """
    k, chunk = 0, chunk_of(tracker.mechanism)
    while k < len(values):
        last = tracker.here if k else None
        if n_done:
            done, n_done = n_done, 0
        else:
            part = samples if len(values) <= chunk and not k else samples.between(k, k + chunk)
            done = tracker.follow(values[k : k + chunk], part)
        k += done
        if done:
            yield k
        if k == len(values) or done == chunk:
            continue
        if done:
            last = PathPoint.of(samples, k - 1, float(values[k - 1]))
        if last is not None and tracker.distance(last, tracker.here.s) < STRETCH:
            tracker.move_to(last)  # clear of what lies ahead, and not too far to go again
        try:
            tracker.reach(float(values[k]))
        except Stopped as stopped:
            stopped.sample = k
            k = _pass_branch_point(tracker, values, samples, stopped, crossed)
        else:
            samples.put(k, tracker.here[1:])
            k += 1
        yield k


def chunk_of(mechanism: Mechanism) -> int:
    """Return how many samples are followed at a time."""
    return max(CHUNK // max(mechanism.model.nv, 1), 1)


def _pass_branch_point(
    tracker: PathTracker, values: Array, samples: PathSamples, stopped: Stopped,
    crossed: list[tuple[float, int]] | None,
) -> int:
    """Cross a branch point before a sample; return the first sample after the crossing.

    Samples before it that lie on the passage are taken from there too: it is the more exact.

    Raises:
        Stopped: it is no branch point, or one that is not to be passed.
    """
    if crossed is None or stopped.kind not in CROSSINGS:
        raise stopped
    crossing = passage(tracker, stopped)
    if crossing is None:
        raise stopped
    k = stopped.sample
    while k > 0 and crossing.holds(float(values[k - 1])):
        k -= 1
    crossed[:] = [(x, at) for x, at in crossed if at < k or not crossing.holds(x)]
    for at in range(k, len(values)):
        value = float(values[at])
        crossed += [(x, at) for x in crossing.passed(float(values[max(at - 1, 0)]), value)]
        tracker.move_to(crossing.point_at(value))
        if not crossing.holds(value):
            if at == stopped.sample and not abs(value - tracker.here.s) < abs(
                    value - stopped.value):  # no nearer than before
                raise stopped
            return at
        samples.put(at, tracker.here[1:])
    return len(values)
