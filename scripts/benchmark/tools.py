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
        versions: packages whose versions are told.
        installs: what pip installs for it; nothing where it runs in this environment.
    """

    title: str
    modules: tuple[str, ...]
    versions: tuple[str, ...]
    installs: tuple[str, ...] = ()


OWN = Tool("this environment",
           ("with_spatial_pin", "with_spatial_pin_forces", "with_pinocchio",
            "with_pinocchio_forces", "with_scipy"),
           ("pin", "numpy", "scipy"))

PEERS = (
    Tool("MuJoCo", ("with_mujoco", "with_mujoco_forces"), ("mujoco",), ("mujoco", "scipy")),
    Tool("Drake", ("with_drake", "with_drake_forces"), ("drake",), ("drake", "scipy")),
    Tool("Exudyn", ("with_exudyn", "with_exudyn_rssr", "with_exudyn_cube"), ("exudyn",),
         ("exudyn", "scipy")),
    Tool("placo", ("with_placo",), ("placo",), ("placo", "scipy")),
    Tool("pink", ("with_pink",), ("pin-pink",), ("pin-pink", "daqp", "scipy")),
)


def environment(tool: Tool, folder: Path, say: Callable[[str], None] = print) -> Path:
    """Return the interpreter of a tool's own environment; make it where it is not there yet.

    Raises:
        subprocess.CalledProcessError: it could not be made.
    """
    home = folder / tool.title.lower()
    python, stamp = home / "bin" / "python", home / "installed"
    wanted = "\n".join(tool.installs)
    if stamp.exists() and stamp.read_text() == wanted:
        return python
    say(f"installing {' '.join(tool.installs)} into {home} (once) ...")
    subprocess.run([sys.executable, "-m", "venv", str(home)], check=True, capture_output=True,
                   text=True)
    subprocess.run([str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check",
                    *tool.installs], check=True, capture_output=True, text=True)
    stamp.write_text(wanted)
    return python
