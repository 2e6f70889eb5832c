"""Long work: progress bars on stderr, after a second, where that is a terminal; and executors."""

from __future__ import annotations

import sys
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Executor, Future
from itertools import starmap
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


def in_order(
    executor: Executor | None, work: Callable[..., Any], jobs: Iterable[tuple[Any, ...]]
) -> Generator[Any]:
    """Yield the result of each job in order; jobs that are not needed any more are cancelled.

    Args:
        executor: where it is done; None: here, one after the other.
        work: the function.
        jobs: arguments of each call.
    """
    if executor is None:
        yield from starmap(work, jobs)
        return
    futures: list[Future[Any]] = []
    try:
        for job in jobs:  # one by one, so that Ctrl-C finds all that were submitted
            futures.append(executor.submit(work, *job))
        for future in futures:
            yield future.result()
    finally:
        for future in futures:
            future.cancel()
