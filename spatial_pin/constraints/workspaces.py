"""Workspaces of a mechanism that are made once and lent out again and again."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from typing import TypeVar

from spatial_pin.mechanism.mechanism import Mechanism

Workspace = TypeVar("Workspace")


@contextmanager
def lent(
    mechanism: Mechanism, key: Hashable, make: Callable[[], Workspace]
) -> Iterator[Workspace]:
    """Lend a workspace, of which there is one for each borrower at the same time.

    It is left as the last borrower left it; one that an error went through is not lent again.

    Args:
        mechanism: that keeps it.
        key: what it is for.
        make: makes one when none is idle.
    """
    idle: list[Workspace] = mechanism.memo.setdefault(("idle", key), [])
    try:
        workspace = idle.pop()
    except IndexError:
        workspace = make()
    yield workspace
    idle.append(workspace)
