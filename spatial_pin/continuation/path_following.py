"""Samples of a branch at driver values, in the best order, straight on where branches cross."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spatial_pin.continuation.branch_points import passage
from spatial_pin.continuation.cursor import STRETCH, Cursor, PathPoint, Stopped
from spatial_pin.continuation.pseudo_arclength import Arrival
from spatial_pin.continuation.start import Start
from spatial_pin.errors import SpatialPinError
from spatial_pin.kernel.paths import PathSamples
from spatial_pin.numerics.linalg import Array

# Values are sorted first if following them as given is more than so many times longer: random ones
# are; one or two reversals are not, and are followed as given.
SORTED_FROM = 3.0
CHUNK = 200_000  # joint coordinates followed at a time: a tenth of a second


def there_and_back(values: Array) -> list[NDArray[np.intp]] | None:
    """Return the places of values from the first one upwards, and of those from it downwards.

    None where following the values as given is not much longer.

    Args:
        values: (N,) driver values.
    """
    if len(values) < 3:
        return None
    with np.errstate(over="ignore"):
        way = np.abs(values[1:] - values[:-1]).sum()
        if way / SORTED_FROM <= abs(values[-1] - values[0]):  # as most are
            return None
        first, low, high = values[0], values.min(), values.max()
        if not way / SORTED_FROM > high - low + min(high - first, first - low):
            return None
    order = np.argsort(values, kind="stable")
    up, down = order[values[order] >= first], order[values[order] < first][::-1]
    return [part for part in (up, down) if part.size]


def followed_in_order(start: Start, values: Array, bar: Any) -> PathSamples | None:
    """Return the samples, followed in the order of their values from the first on, both ways.

    None where the values as given are no detour, or where the branch ends or crosses another: which
    samples come before that depends on the order asked for.
    """
    ways = there_and_back(values)
    if ways is None:
        return None
    samples = start.samples(len(values))
    for way in ways:
        own = start.samples(len(way))
        try:
            for _ in follow(start, values[way], own, None):
                pass
        except (Stopped, SpatialPinError):
            bar.reset()
            return None
        bar.update(len(way))
        for whole, part in zip(samples, own, strict=True):
            whole[way] = part
    return samples


def followed_as_far(
    start: Start, values: Array, samples: PathSamples, crossed: list[tuple[float, int]] | None,
    bar: Any, begun: int = 0,
) -> tuple[int, Arrival | None, bool]:
    """Write the samples of a branch as far as it goes, as `follow` does, from number `begun` on.

    Returns:
        How many are done, what ended it before the last, if anything did, and whether Ctrl-C did.

    Raises:
        SingularError: the driver does not determine the motion at the start.
        KeyboardInterrupt: before anything was followed.
    """
    done = begun
    try:
        for done in follow(start, values, samples, crossed, begun):
            bar.update(done - bar.n)
    except Stopped as caught:
        return caught.sample, caught.arrival, False
    except KeyboardInterrupt:
        if not done:
            raise
        return done, None, True
    return len(values), None, False


def follow(
    start: Start, values: Array, samples: PathSamples, crossed: list[tuple[float, int]] | None,
    begun: int = 0,
) -> Iterator[int]:
    """Write the samples of a branch at driver values; yields the number of those done.

    Branch points that are passed are added to `crossed`, if that is a list, as (value, sample).
    It goes on after the last of those that the kernel has `begun` with.

    Raises:
        Stopped: a value cannot be reached; says which, and where the branch ended.
        SingularError: the driver does not determine the motion at the start.
    """
    cursor, k = Cursor(start), begun
    if k:
        cursor.stand(PathPoint.of(samples, k - 1, float(values[k - 1])))
    chunk = max(CHUNK // max(start.kernel.nv, 1), 1)
    while k < len(values):
        last = cursor.here if k else None
        part = samples if len(values) <= chunk and not k else samples.between(k, k + chunk)
        done = cursor.follow(values[k : k + chunk], part)
        k += done
        if done:
            yield k
        if k == len(values) or done == chunk:
            continue
        if done:
            last = PathPoint.of(samples, k - 1, float(values[k - 1]))
        if last is not None and cursor.way(last, cursor.here.s) < STRETCH:
            cursor.stand(last)  # clear of what lies ahead, and not too far to go again
        try:
            cursor.reach(float(values[k]))
        except Stopped as stopped:
            stopped.sample = k
            k = _pass_branch_point(cursor, values, samples, stopped, crossed)
        else:
            _put(samples, k, cursor.here)
            k += 1
        yield k


def _put(samples: PathSamples, k: int, place: PathPoint) -> None:
    """Write a place into sample k."""
    samples.q[k], samples.t[k], samples.c[k] = place.q, place.t, place.c
    samples.error[k], samples.angles[k] = place.error, place.angles


def _pass_branch_point(
    cursor: Cursor, values: Array, samples: PathSamples, stopped: Stopped,
    crossed: list[tuple[float, int]] | None,
) -> int:
    """Go straight on at a branch point before a sample; return the first one behind its passage.

    Samples before it that lie on the passage are taken from there too: it is the more exact.

    Raises:
        Stopped: it is no branch point, or one that is not to be passed.
    """
    found = passage(cursor, stopped.arrival) if crossed is not None else None
    if found is None or crossed is None:
        raise stopped
    k = stopped.sample
    while k > 0 and found.holds(float(values[k - 1])):
        k -= 1
    crossed[:] = [(x, at) for x, at in crossed if at < k or not found.holds(x)]
    for at in range(k, len(values)):
        value = float(values[at])
        crossed += [(x, at) for x in found.passed(float(values[max(at - 1, 0)]), value)]
        cursor.stand(found.place(value))
        if not found.holds(value):
            if at == stopped.sample and not abs(value - cursor.here.s) < abs(
                    value - stopped.arrival.value):  # no nearer than before
                raise stopped
            return at
        _put(samples, at, cursor.here)
    return len(values)
