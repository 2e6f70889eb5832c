"""Jobs done here or by the workers of an executor; results come in the order of the jobs."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Executor, Future
from itertools import starmap
from typing import Any


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
