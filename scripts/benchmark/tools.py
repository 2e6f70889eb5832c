"""Who is measured, and the environments where they are."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

FOLDER = Path(__file__).parent.parent.parent / ".venv-peers"  # one environment each, made once


class Tool(NamedTuple):
    """A tool of the benchmark.

    Attributes:
        title: its name in the table.
        modules: of this package, with its cases.
        versions: packages whose versions are reported.
        installs: what pip installs for it; nothing where it runs in this environment.
        bars: tasks with bars that are measured beside it.
    """

    title: str
    modules: tuple[str, ...]
    versions: tuple[str, ...]
    installs: tuple[str, ...] = ()
    bars: tuple[str, ...] = ()


OWN = Tool("this environment",
           ("with_spatial_pin", "with_spatial_pin_forces", "with_spatial_pin_search",
            "with_spatial_pin_reach", "with_pinocchio", "with_pinocchio_forces", "with_scipy"),
           ("pin", "numpy", "scipy"))

PEERS = (
    Tool("MuJoCo", ("with_mujoco",), ("mujoco",), ("mujoco", "scipy"),
         ("a02", "a04")),
    Tool("Drake", ("with_drake", "with_drake_reach"), ("drake",),
         ("drake", "scipy")),
    Tool("Exudyn", ("with_exudyn",), ("exudyn",),
         ("exudyn", "scipy")),
    Tool("placo", ("with_placo_reach",), ("placo",), ("placo", "scipy"),
         ("reach-gough", "reach-delta", "reach-excavator", "reach-ankle")),
    Tool("pylinkage", ("with_pylinkage", "with_pylinkage_design"),
         ("pylinkage", "numba"),
         ("pylinkage", "numba", "scipy"),  # its synthesis imports SciPy and does not ask for it
         ("four_bar",)),
    Tool("pink", ("with_pink_reach",), ("pin-pink",), ("pin-pink", "daqp", "scipy")),
)


def selected(peers: bool, bars: bool) -> tuple[Tool, ...]:
    """Return the peers to measure: all, or those of the bars."""
    return tuple(tool for tool in PEERS if (tool.bars if bars else peers))


def is_there(tool: Tool, folder: Path) -> bool:
    """Whether a tool's environment has been made."""
    stamp = folder / tool.title.lower() / "installed"
    return stamp.exists() and stamp.read_text() == "\n".join(tool.installs)


def environment(tool: Tool, folder: Path, say: Callable[[str], None] = print) -> Path:
    """Return the interpreter of a tool's own environment; make it where it is not there yet.

    Raises:
        subprocess.CalledProcessError: it could not be made.
    """
    home = folder / tool.title.lower()
    python = home / "bin" / "python"
    if is_there(tool, folder):
        return python
    say(f"installing {' '.join(tool.installs)} into {home} (once) ...")
    subprocess.run([sys.executable, "-m", "venv", str(home)], check=True, capture_output=True,
                   text=True)
    subprocess.run([str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check",
                    *tool.installs], check=True, capture_output=True, text=True)
    (home / "installed").write_text("\n".join(tool.installs))
    return python
