"""A picture of a motion or state, taken by a browser without a window."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from spatial_pin._support.checks import checked, picture_size
from spatial_pin._support.outputs import named_path, write_bytes
from spatial_pin.errors import SpatialPinError
from spatial_pin.view.page.html import export_html
from spatial_pin.view.scene.film import Film, film
from spatial_pin.view.scene.overlay import overlaid

if TYPE_CHECKING:
    from spatial_pin.assembly.state import State
    from spatial_pin.motion.motion import Motion
    from spatial_pin.synthesis.ranked_designs import Design, Designs
    from spatial_pin.view.scene.look import Look

BROWSERS = (
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
    "chrome",
    "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
    "/Applications/Chromium.app/Contents/MacOS/Chromium",
)
OPTIONS = (
    "--headless=new",
    "--no-sandbox",  # the page is our own and refuses the network
    "--no-first-run",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--hide-scrollbars",
    "--virtual-time-budget=5000",
)
# its standard input is our pipe: it ends when we do; the browser's children take a moment longer,
# and what they still write keeps the folder from being removed
COMPANION = """folder=$1; shift; exec 3<&0
(cat <&3 >/dev/null; kill -KILL $$
for again in 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20; do
  rm -rf "$folder"; [ -e "$folder" ] || break; sleep 0.2
done
kill -KILL 0) >/dev/null 2>&1 &
exec "$@" </dev/null 3<&-
"""
LONGEST_START = 90.0  # longest a browser may take [s]: longer than one answer of it


def find_browser() -> str | None:
    """Return the program of a Chromium or Chrome on this machine, or None."""
    return next((found for name in BROWSERS if (found := shutil.which(name))), None)


def start(command: Sequence[str], folder: str) -> subprocess.Popen[bytes]:
    """Start a browser that ends with us, however we end.

    It has a process group of its own, and where there is a shell a companion in it, which holds
    the other end of our pipe: once we are gone it ends the group and removes the folder.

    Args:
        command: program and options.
        folder: the browser's own; what it complains of is written to `stderr` there.
    """
    with (Path(folder) / "stderr").open("wb") as said:
        if os.name != "posix":
            return subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                                    stderr=said)
        return subprocess.Popen(["/bin/sh", "-c", COMPANION, "sh", folder, *command],
                                stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=said,
                                start_new_session=True)


def end(process: subprocess.Popen[bytes]) -> None:
    """End a browser, and what is left of its group."""
    if hasattr(os, "killpg"):
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
    process.kill()
    process.wait()
    if process.stdin is not None:
        process.stdin.close()


def photograph(page: Path, fragment: str, path: Path, size: tuple[int, int]) -> None:
    """Write a picture of a page.

    Args:
        page: the page.
        fragment: what to tell it, see page.html: "t=1.5&bare".
        path: PNG file to write.
        size: width and height [pixels].

    Raises:
        SpatialPinError: there is no browser, or it made no picture.
    """
    browser = find_browser()
    if browser is None:
        raise SpatialPinError("a picture needs Chromium or Chrome, and none was found on the PATH")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        shot = Path(profile) / "shot.png"
        command = [browser, *OPTIONS, f"--user-data-dir={profile}", f"--screenshot={shot}"]
        command += [f"--window-size={size[0]},{size[1]}", f"{page.resolve().as_uri()}#{fragment}"]
        process = start(command, profile)
        try:
            process.wait(LONGEST_START)
        except subprocess.TimeoutExpired as error:
            raise SpatialPinError(f"{browser} took more than {LONGEST_START:g} s") from error
        finally:
            end(process)
        if not shot.is_file():
            said = (Path(profile) / "stderr").read_text(errors="replace")[-2000:]
            raise SpatialPinError(f"{browser} made no picture:\n{said}")
        write_bytes(path, shot.read_bytes())


def _moment(shown: Film, source: Motion | State, row: int) -> float:
    """Return when a sample is shown [s]; of a long motion the nearest one that is shown at all."""
    n = len(np.atleast_2d(source.q))
    if not -n <= row < n:
        raise SpatialPinError(f"there is no sample {row}: {n} samples are 0 to {n - 1}, "
                              f"or -{n} to -1")
    return float(shown.seconds[np.argmin(np.abs(shown.rows - row % n))])


@checked
def screenshot(
    motion_or_state: Motion | State | Design | Designs,
    path: str | Path,
    *,
    row: int = 0,
    size: tuple[int, int] = (1280, 960),
    title: str | None = None,
    look: Look | None = None,
) -> Path:
    """Write a picture of a state, or of one sample of a motion; needs Chromium or Chrome.

    Args:
        motion_or_state: what to show; of what `spatial_pin.design` found as in `export_html`.
        path: PNG file to write.
        row: number of the sample, negative from its end.
        size: width and height [pixels].
        title: heading; the mechanism's title if not given.
        look: what is shown besides the bodies.

    Returns:
        The path written.

    Raises:
        UnknownNameError: `look` names a point or vector that does not exist.
        ValueError: the size is none.
        SpatialPinError: there is no such sample, no browser, or it made no picture.

    Example:
        >>> state = sp.assemble(sp.load("rssr"), {"crank": 1.0})
        >>> sp.screenshot(state, "rssr.png", size=(640, 480)).name
        'rssr.png'
    """
    path, size = named_path(path), picture_size(size)
    motion_or_state, look = overlaid(motion_or_state, look)
    seconds = _moment(film(motion_or_state), motion_or_state, row)
    with tempfile.TemporaryDirectory() as folder:
        page = export_html(motion_or_state, Path(folder) / "page.html", title=title, look=look)
        photograph(page, f"t={seconds:.6f}&bare", path, size)
    return path
