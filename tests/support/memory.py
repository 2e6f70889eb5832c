"""How much memory a call takes: the same on every machine, as times are not."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator
from contextlib import contextmanager


class Peak:
    """What is filled in at the end of `peak_memory`.

    Attributes:
        bytes: the most that was held at once, beyond what was held at the beginning.
    """

    bytes = 0


@contextmanager
def peak_memory() -> Iterator[Peak]:
    """Measure what Python and NumPy allocate, without what the kernel in C does."""
    peak = Peak()
    tracemalloc.start()
    try:
        before, _ = tracemalloc.get_traced_memory()
        yield peak
        peak.bytes = tracemalloc.get_traced_memory()[1] - before
    finally:
        tracemalloc.stop()
