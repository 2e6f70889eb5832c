"""A plugin of pytest: a run that leaves a file in the work tree fails, and names the file."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

BEFORE = pytest.StashKey[set[str]]()


def git(folder: Path, *words: str) -> list[str] | None:
    """Return the names that a command of git gives; None without git, or outside of a checkout."""
    try:
        done = subprocess.run(["git", *words, "-z"], cwd=folder, capture_output=True, text=True,
                              check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return [name for name in done.stdout.split("\0") if name]


def untracked(folder: Path) -> set[str]:
    """Return the files below a folder that git neither has nor ignores."""
    return set(git(folder, "ls-files", "--others", "--exclude-standard") or ())


def is_worker(config: pytest.Config) -> bool:
    return hasattr(config, "workerinput")  # of pytest-xdist


def pytest_sessionstart(session: pytest.Session) -> None:
    """Note which files are there before the tests run."""
    if not is_worker(session.config):
        session.config.stash[BEFORE] = untracked(session.config.rootpath)


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    """Let the run fail where there are more of them now."""
    if is_worker(session.config):
        return
    new = untracked(session.config.rootpath) - session.config.stash[BEFORE]
    if new:
        reporter = session.config.pluginmanager.get_plugin("terminalreporter")
        if reporter is not None:
            reporter.write_line("")
            reporter.write_line("The tests left files in the work tree, where they should write to "
                                f"tmp_path: {', '.join(sorted(new))}", red=True)
        session.exitstatus = exitstatus or pytest.ExitCode.TESTS_FAILED
