"""`cached_property` without a lock.

Before Python 3.12 the one of `functools` holds a lock while it works, one for all objects of a
class: a process that is forked meanwhile waits for ever, and threads wait for each other.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

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

__all__ = ["cached_property"]
