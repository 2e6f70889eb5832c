"""The workspace pool of a mechanism."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any, Generic, TypeVar, TypeVarTuple

from spatial_pin._support.lazy import made_once
from spatial_pin.mechanism.mechanism import Mechanism

Workspace = TypeVar("Workspace")
More = TypeVarTuple("More")


class acquired(Generic[Workspace]):  # with acquired(...) as workspace
    """Acquire a workspace from the pool, and release it; two at the same time are two workspaces.

    It is as its last user left it; one that an error went through is not released to the pool.

    Args:
        mechanism: whose pool it is.
        make: makes one of the mechanism, and of hashable arguments, when the pool has none.
        more: these.
    """

    def __init__(
        self, mechanism: Mechanism, make: Callable[[Mechanism, *More], Workspace], *more: *More
    ) -> None:
        self._idle: list[Workspace] = _pool(mechanism, make, *more)
        self._mechanism, self._make, self._more = mechanism, make, more

    def __enter__(self) -> Workspace:
        """Return the workspace."""
        try:
            self._acquired = self._idle.pop()
        except IndexError:
            self._acquired = self._make(self._mechanism, *self._more)
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
def _pool(mechanism: Mechanism, *kind: Hashable) -> list[Any]:
    """Return the workspaces of a kind that nobody uses."""
    return []
