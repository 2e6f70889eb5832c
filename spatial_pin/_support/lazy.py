"""Results of an object that are computed once and kept in it, and its pool of workspaces.

All of it lies in the object itself and goes with it; copies begin without what `made_once` and
`made_anew` hold. Nothing here locks: before Python 3.12 the `cached_property` of `functools` holds
a lock while it works, one for all objects of a class, so that a process that is forked meanwhile
waits for ever, and threads wait for each other.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from functools import wraps
from typing import TYPE_CHECKING, Any, Generic, TypeVar, TypeVarTuple
from warnings import warn

RESULTS = "_results"  # the attribute that holds them: an object leaves it out of its copies

Owner = TypeVar("Owner")
Made = TypeVar("Made")
Workspace = TypeVar("Workspace")
More = TypeVarTuple("More")


def made_once(make: Callable[[Owner, *More], Made]) -> Callable[[Owner, *More], Made]:
    """Keep a function's result in its first argument; the other arguments are hashable."""

    @wraps(make)
    def result(owner: Owner, *more: *More) -> Made:
        key = make, *more
        try:
            known: Made = owner._results[key]  # type: ignore[attr-defined]
        except (AttributeError, KeyError):
            is_known = False  # make it outside, or its errors would have this one as context
        else:
            is_known = True
        if not is_known:  # one for all threads
            known = _results_of(owner).setdefault(key, make(owner, *more))
        return known

    return result


def made_anew(make: Callable[[Owner, *More], Made]) -> Callable[[Owner, *More], Made]:
    """Keep a function's last result in its first argument; other arguments compute it again."""

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
        """A property that is computed at its first use."""

        def __init__(self, work: Any) -> None:
            self.work, self.__doc__ = work, work.__doc__

        def __set_name__(self, owner: type, name: str) -> None:
            self.name = name

        def __get__(self, owner: Any, kind: type | None = None) -> Any:
            if owner is None:
                return self
            value = owner.__dict__[self.name] = self.work(owner)
            return value


class acquired(Generic[Workspace]):  # with acquired(...) as workspace
    """Acquire a workspace from the pool, and release it; two at the same time are two workspaces.

    It is as its last user left it; one that an error went through is not released to the pool.

    Args:
        owner: a mechanism, whose pool it is.
        make: makes one of the owner, and of hashable arguments, when the pool has none.
        more: these.
    """

    def __init__(
        self, owner: Owner, make: Callable[[Owner, *More], Workspace], *more: *More
    ) -> None:
        self._idle: list[Workspace] = _pool(owner, make, *more)
        self._owner: Any = owner
        self._make, self._more = make, more

    def __enter__(self) -> Workspace:
        """Return the workspace."""
        try:
            self._acquired = self._idle.pop()
        except IndexError:
            self._acquired = self._make(self._owner, *self._more)
        return self._acquired

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        """Release it to the pool."""
        if kind is None:
            self._idle.append(self._acquired)


class Workspaces:  # with Workspaces() as workspaces
    """Workspaces acquired one after the other, and released together."""

    def __init__(self) -> None:
        self._acquired: list[acquired[Any]] = []

    def __enter__(self) -> Workspaces:
        """Return the workspaces."""
        return self

    def __exit__(self, *error: Any) -> None:
        """Release them to their pools."""
        while self._acquired:
            self._acquired.pop().__exit__(*error)

    def acquire(self, workspace: acquired[Workspace]) -> Workspace:
        """Acquire one more."""
        entered = workspace.__enter__()
        self._acquired.append(workspace)
        return entered

    def release_last(self) -> None:
        """Release the one that was acquired last."""
        self._acquired.pop().__exit__(None)


@made_once
def _pool(owner: object, *kind: Hashable) -> list[Any]:
    """Return the workspaces of a kind that nobody uses."""
    return []


def by_new_name(owner: object, old: str, new: str) -> Any:
    """Return an attribute that a user reads by its old name, with a warning."""
    kind = type(owner).__name__
    warn(f"{kind}.{old} is now {kind}.{new}", DeprecationWarning, stacklevel=3)
    return getattr(owner, new)


def with_former_field(old: str, new: str) -> Callable[[type[Owner]], type[Owner]]:
    """Return a decorator of dataclasses: a field's former name works, with a warning."""

    def decorated(kind: type[Owner]) -> type[Owner]:
        make: Any = kind.__init__

        @wraps(make)
        def init(self: Owner, *args: Any, **named: Any) -> None:
            if old in named:
                warn(f"{kind.__name__}: {old} is now {new}", DeprecationWarning, stacklevel=2)
                named[new] = named.pop(old)
            make(self, *args, **named)

        kind.__init__ = init  # type: ignore[method-assign,assignment]
        setattr(kind, old, property(lambda self: by_new_name(self, old, new)))
        return kind

    return decorated


__all__ = ["Workspaces", "acquired", "by_new_name", "cached_property", "made_anew", "made_once",
           "with_former_field"]
