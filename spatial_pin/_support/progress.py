"""Progress bars on stderr, after a second, where that is a terminal."""

from __future__ import annotations

import sys
from typing import Any


class _Hidden:
    """The bar that nobody sees."""

    n = 0.0

    def update(self, done: float = 1.0) -> None:
        """Show nothing."""

    def reset(self) -> None:
        """Show nothing."""

    def set_postfix(self, **values: object) -> None:
        """Show nothing."""

    def close(self) -> None:
        """Show nothing."""

    def __enter__(self) -> _Hidden:
        return self

    def __exit__(self, *error: object) -> None:
        pass


def progress_bar(total: float, name: str, shown: bool) -> Any:
    """Return a bar as `tqdm` makes it.

    Args:
        total: amount of work.
        name: text before the bar.
        shown: whether the bar is wanted.
    """
    if not shown or sys.stderr is None or not sys.stderr.isatty():
        return _Hidden()
    from tqdm import tqdm  # on use: it takes 5 ms to import

    return tqdm(total=total, desc=name, delay=1.0, leave=False)
