"""The command `spatial-pin`."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from spatial_pin.cli.completion import NAMES, offer

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return 0, 1 for a mechanism or solver error, 2 for usage."""
    words = sys.argv[1:] if arguments is None else arguments
    if words[:1] == [NAMES]:
        return offer(words[1:])
    from spatial_pin.cli.running import main as run  # on use: the commands take long to import

    return run(words)
