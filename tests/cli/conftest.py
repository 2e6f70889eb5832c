"""What tests of commands share: the names of all of them."""

from __future__ import annotations

import re

import pytest


@pytest.fixture
def commands(run) -> set[str]:
    """The names of all commands, as the help has them."""
    _, text, _ = run("--help")
    return set(re.findall(r"^  ([a-z]\w+) ", text, flags=re.MULTILINE))
