"""What is made of an object when it is first needed, and used again and again.

All of it lies in the object itself and goes with it; copies begin without what `made_once` and
`made_anew` hold. Nothing here locks: before Python 3.12 the `cached_property` of `functools` holds
a lock while it works, one for all objects of a class, so that a process that is forked meanwhile
waits for ever, and threads wait for each other.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import TYPE_CHECKING, Any, TypeVar, TypeVarTuple
from warnings import warn

RESULTS = "_results"  # the attribute that holds them: an object leaves it out of its copies

Owner = TypeVar("Owner")
Made = TypeVar("Made")
More = TypeVarTuple("More")


def made_once(make: Callable[[Owner, *More], Made]) -> Callable[[Owner, *More], Made]:
    """Hold in an object what a function makes of it, and of nothing but hashable arguments."""

    @wraps(make)
    def result(owner: Owner, *more: *More) -> Made:
        key = make, *more
        try:
            results = owner._results  # type: ignore[attr-defined]
        except AttributeError:
            results = _results_of(owner)
        if key not in results:
            results.setdefault(key, make(owner, *more))  # one for all threads
        known: Made = results[key]
        return known

    return result


def made_anew(make: Callable[[Owner, *More], Made]) -> Callable[[Owner, *More], Made]:
    """Hold in an object what a function made of it last: other arguments make it anew."""

    @wraps(make)
    def result(owner: Owner, *more: *More) -> Made:
        results = vars(owner).get(RESULTS) or _results_of(owner)
        last = results.get(make)
        if last is None or last[0] != more:
            last = results[make] = more, make(owner, *more)
        known: Made = last[1]
        return known

    return result


def _results_of(owner: object) -> dict[Any, Any]:
    """Return where results of an object go, by what made them; they begin as none."""
    results: dict[Any, Any] = vars(owner).setdefault(RESULTS, {})
    return results


if TYPE_CHECKING:
    from functools import cached_property
else:

    class cached_property:
        """A property that is worked out when it is first asked for."""

        def __init__(self, work: Any) -> None:
            self.work, self.__doc__ = work, work.__doc__

        def __set_name__(self, owner: type, name: str) -> None:
            self.name = name

        def __get__(self, owner: Any, kind: type | None = None) -> Any:
            if owner is None:
                return self
            value = owner.__dict__[self.name] = self.work(owner)
            return value



def by_new_name(owner: object, old: str, new: str) -> Any:
    """Return an attribute that a user reads by its old name, with a warning."""
    kind = type(owner).__name__
    warn(f"{kind}.{old} is now {kind}.{new}", DeprecationWarning, stacklevel=3)
    return getattr(owner, new)


__all__ = ["by_new_name", "cached_property", "made_anew", "made_once"]
