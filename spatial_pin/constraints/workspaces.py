"""What is made once of a mechanism and used again and again; its workspace pool."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from functools import wraps
from typing import Generic, TypeVar, TypeVarTuple

from spatial_pin.mechanism.mechanism import Mechanism

Made = TypeVar("Made")
More = TypeVarTuple("More")
Workspace = TypeVar("Workspace")


def made_once(
    make: Callable[[Mechanism, *More], Made]
) -> Callable[[Mechanism, *More], Made]:
    """Keep with a mechanism what a function makes of it, and of nothing but hashable arguments."""

    @wraps(make)
    def kept(mechanism: Mechanism, *more: *More) -> Made:
        key = make, *more
        if key not in mechanism.memo:
            mechanism.memo[key] = make(mechanism, *more)
        found: Made = mechanism.memo[key]
        return found

    return kept


class acquired(Generic[Workspace]):  # with acquired(...) as workspace
    """Acquire a workspace from the pool, and release it; two at the same time are two workspaces.

    It is as its last user left it; one that an error went through is not released to the pool.

    Args:
        mechanism: whose pool it is.
        key: what it is for.
        make: makes one when the pool has none.
    """

    def __init__(self, mechanism: Mechanism, key: Hashable, make: Callable[[], Workspace]) -> None:
        self._idle: list[Workspace] = mechanism.memo.setdefault(("idle", key), [])
        self._make = make

    def __enter__(self) -> Workspace:
        """Return the workspace."""
        try:
            self._acquired = self._idle.pop()
        except IndexError:
            self._acquired = self._make()
        return self._acquired

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        """Release it to the pool."""
        if kind is None:
            self._idle.append(self._acquired)
