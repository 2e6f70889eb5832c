"""What all tests share: which are left out, how a command is run, and problems of design."""

from __future__ import annotations

import gc
from collections.abc import Sequence

import hypothesis
import pytest
from chromium import browser, one_browser  # noqa: F401 - fixtures
from published_designs import PROBLEMS
from work_tree import pytest_sessionfinish, pytest_sessionstart

from spatial_pin.cli import main

__all__ = ["pytest_sessionfinish", "pytest_sessionstart"]  # a run that leaves files fails

MOST_CASES = 6  # of a function whose cases are marked alike, that run by default

# No test depends on time, or on what was drawn or kept before.
hypothesis.settings.register_profile(
    "always the same", deadline=None, derandomize=True, database=None)
hypothesis.settings.register_profile(
    "few", hypothesis.settings.get_profile("always the same"), max_examples=20)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Let --all add the tests that are marked slow."""
    parser.addoption("--all", action="store_true", help="run the slow tests too")


def pytest_configure(config: pytest.Config) -> None:
    """Draw few examples, unless --all."""
    hypothesis.settings.load_profile("always the same" if config.option.all else "few")


def pytest_collection_modifyitems(config: pytest.Config, items: Sequence[pytest.Item]) -> None:
    """Leave out slow tests, and most of cases alike, unless --all or a name selects them.

    An expression of markers selects slow tests by itself. Of cases that are marked alike the
    default runs a few, evenly apart, with the first and the last.
    """
    if config.option.all or config.option.keyword or any("::" in text for text in config.args):
        return
    left_out = set() if config.option.markexpr else {
        item for item in items if item.get_closest_marker("slow")}
    by_function: dict[str, list[pytest.Item]] = {}
    for item in items:
        if item.get_closest_marker("alike"):
            by_function.setdefault(item.nodeid.partition("[")[0], []).append(item)
    for cases in by_function.values():
        step = max(1.0, (len(cases) - 1) / (MOST_CASES - 1))
        chosen = {round(k * step) for k in range(MOST_CASES)}
        left_out.update(x for k, x in enumerate(cases) if k not in chosen)
    config.hook.pytest_deselected(items=[item for item in items if item in left_out])
    items[:] = [item for item in items if item not in left_out]


def pytest_collection_finish() -> None:
    """Let the collector of garbage leave alone what is there for good: a sixth of the time."""
    gc.collect()
    gc.freeze()


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


@pytest.fixture(scope="module")
def problems():
    """Published problems of synthesis."""
    return PROBLEMS
