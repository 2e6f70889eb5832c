"""Workspaces of a mechanism that are made once and lent out again and again."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

from spatial_pin.mechanism.mechanism import Mechanism

Workspace = TypeVar("Workspace")


class lent(Generic[Workspace]):  # with lent(...) as workspace
    """Lend a workspace, of which there is one for each borrower at the same time.

    It is left as the last borrower left it; one that an error went through is not lent again.

    Args:
        mechanism: that keeps it.
        key: what it is for.
        make: makes one when none is idle.
    """

    def __init__(
        self, mechanism: Mechanism, key: Hashable, make: Callable[[], Workspace]
    ) -> None:
        self._idle: list[Workspace] = mechanism.memo.setdefault(("idle", key), [])
        self._make = make

    def __enter__(self) -> Workspace:
        """Return the workspace."""
        try:
            self._lent = self._idle.pop()
        except IndexError:
            self._lent = self._make()
        return self._lent

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        """Take it back."""
        if kind is None:
            self._idle.append(self._lent)
