"""What the tests of several commands share."""

from __future__ import annotations

import pytest

from spatial_pin.cli import main


@pytest.fixture
def run(capfd):
    """Run a command; returns its exit code and what it prints on stdout and stderr."""

    def run(*words: object) -> tuple[int, str, str]:
        try:
            code = main([str(w) for w in words])
        except SystemExit as end:  # argparse
            code = end.code
        return code, *capfd.readouterr()

    return run
