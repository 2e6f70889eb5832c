"""A state as a picture, a motion as a film file: photographs of its page by a browser.

To add a format: a function from the path, the times, the camera and the frames a second to nothing,
and its line in WRITERS.
"""

from __future__ import annotations

import io
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from spatial_pin._support.checks import checked, picture_size, positive_number
from spatial_pin._support.output_files import named_path, replacing, write_bytes
from spatial_pin._support.progress import progress_bar
from spatial_pin.errors import SpatialPinError
from spatial_pin.view.browser import Browser
from spatial_pin.view.page.html import export_html
from spatial_pin.view.scene.film import film
from spatial_pin.view.scene.look import overlaid

if TYPE_CHECKING:
    from PIL import Image

    from spatial_pin.assembly.state import State
    from spatial_pin.motion.motion import Motion
    from spatial_pin.synthesis.ranked_designs import Design, Designs
    from spatial_pin.view.scene.look import Look

Shoot = Callable[[float], "Image.Image"]

READY = "typeof seek === 'function' && !viewer.needs_render"  # of page.html
COLOURS = 128  # of a GIF: half of those it can have, as shades of few bodies need no more
PALETTE_FRAMES = 8  # that a GIF's colours are taken from: bodies keep theirs, shades change little
MOST_FRAMES = 100_000  # a day of photographing
FASTEST_GIF = 50.0  # frames a second: browsers show shorter ones for 0.1 s


def open_page(browser: Browser, page: Path | str) -> None:
    """Open a page of `export_html` or `show`, stopped at its first sample, without its player."""
    browser.open(page, READY)
    browser.evaluate("document.body.classList.add('bare'); dress(); share(); seek(0)")


def shoot(browser: Browser, seconds: float) -> Image.Image:
    """Return the picture of the open page at a time of its film [s]."""
    from PIL import Image

    browser.evaluate(f"seek({seconds:.6f})")
    with Image.open(io.BytesIO(browser.screenshot())) as image:
        return image.convert("RGB")


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
        motion_or_state: a motion or a state; a design as in `export_html`.
        path: PNG file to write.
        row: number of the sample, negative from its end.
        size: width and height [pixels].
        title: heading; the mechanism's title if not given.
        look: extras of the picture besides the bodies.

    Returns:
        The path written.

    Raises:
        UnknownNameError: `look` names a point or vector that does not exist.
        ValueError: the size is none.
        SpatialPinError: there is no such sample, or no browser.

    Example:
        >>> state = sp.assemble(sp.load("rssr"), {"crank": 1.0})
        >>> sp.screenshot(state, "rssr.png", size=(640, 480)).name
        'rssr.png'
    """
    path, size = named_path(path), picture_size(size)
    motion_or_state, look = overlaid(motion_or_state, look)
    shown, n = film(motion_or_state), len(np.atleast_2d(motion_or_state.q))
    if not -n <= row < n:
        raise SpatialPinError(f"there is no sample {row}: {n} samples are 0 to {n - 1}, "
                              f"or -{n} to -1")
    nearest = np.argmin(np.abs(shown.rows - row % n))  # of a long motion not every sample is shown
    with tempfile.TemporaryDirectory() as folder, Browser(size) as browser:
        page = export_html(motion_or_state, Path(folder) / "page.html", title=title, look=look)
        open_page(browser, page)
        browser.evaluate(f"seek({shown.seconds[nearest]:.6f})")
        return write_bytes(path, browser.screenshot())


def write_gif(
    path: Path, seconds: Sequence[float], camera: Shoot, fps: float, colours: int = COLOURS
) -> None:
    """Write an endless GIF with one palette, `fps` frames a second at most 50, at times [s]."""
    from PIL import Image

    if fps > FASTEST_GIF:
        raise ValueError(f"{fps:g} frames a second; a GIF shows at most {FASTEST_GIF:g}")
    # the palette suits some of the frames; a colour counts by the square root of its pixels, or the
    # white ground would take most of it
    some = seconds[:: -(-len(seconds) // PALETTE_FRAMES)]
    pixels = np.concatenate([np.asarray(camera(t)).reshape(-1, 3) for t in some])
    keys = (pixels >> 3).astype(int) @ [1 << 10, 1 << 5, 1]  # alike to five bits are one colour
    _, which, count = np.unique(keys, return_inverse=True, return_counts=True)
    means = np.stack([np.bincount(which, channel) / count for channel in pixels.T], axis=1)
    row = np.repeat(np.round(means).astype(np.uint8), np.ceil(np.sqrt(count)).astype(int), axis=0)
    palette = Image.fromarray(row[None]).quantize(
        colours, method=Image.Quantize.MEDIANCUT, kmeans=2, dither=Image.Dither.NONE)
    ends = np.round(100.0 * np.arange(len(seconds) + 1) / fps).astype(int)  # as GIF has them
    frames = (camera(t).quantize(palette=palette, dither=Image.Dither.NONE) for t in seconds)
    first = next(frames)
    first.save(path, save_all=True, append_images=frames, loop=0, optimize=True,
               duration=[10 * int(x) for x in np.diff(ends)])


def write_mp4(path: Path, seconds: Sequence[float], camera: Shoot, fps: float) -> None:
    """Write an MP4 (H.264) that every player shows; needs imageio-ffmpeg."""
    try:
        from imageio_ffmpeg import write_frames
    except ImportError as error:
        raise SpatialPinError(
            "an .mp4 needs imageio-ffmpeg: pip install 'spatial_pin[movie]'; a .gif needs nothing"
        ) from error
    first = camera(seconds[0])
    writer: Any = write_frames(
        str(path), first.size, fps=fps, codec="libx264", quality=8, macro_block_size=2,
        output_params=["-movflags", "+faststart"], ffmpeg_log_level="error",
    )
    try:
        writer.send(None)
        for t in seconds:
            writer.send(camera(t).tobytes())
    finally:
        writer.close()


@checked
def movie(
    motion: Motion | State | Design | Designs,
    path: str | Path,
    *,
    fps: float = 25.0,
    size: tuple[int, int] = (960, 720),
    title: str | None = None,
    look: Look | None = None,
    progress: bool = False,
) -> Path:
    """Write a motion as a film; needs Chromium or Chrome, and for .mp4 the extra `movie`.

    It lasts as long as the page of `export_html` plays: the motion's own time, unless that is too
    fast or too slow to watch. The picture then has a note.

    Args:
        motion: the motion; a design as in `export_html`.
        path: file to write, .gif (which repeats for ever) or .mp4.
        fps: frames a second, for a .gif at most 50.
        size: width and height [pixels]; odd ones are made even in an .mp4.
        title: heading; the mechanism's title if not given.
        look: extras of the picture, as in `export_html`.
        progress: whether to show a progress bar on stderr once it has taken a second.

    Returns:
        The path written.

    Raises:
        SpatialPinError: there is no browser, or imageio-ffmpeg is wanted and missing.
        ValueError: the suffix is not known, nothing moves, or a number cannot be.

    Example:
        >>> mech = sp.load("rssr")
        >>> motion = sp.sweep(mech, "crank", np.linspace(0.0, 0.4, 5), speed=2.0)
        >>> sp.movie(motion, "rssr.gif", fps=10, size=(320, 240)).name
        'rssr.gif'
    """
    path = named_path(path)
    write = WRITERS.get(path.suffix.lower())
    if write is None:
        raise ValueError(f"{path.name}: a movie is written as {' or '.join(WRITERS)}")
    fps, size = positive_number(fps, "fps"), picture_size(size)
    shown, look = overlaid(motion, look)
    duration = float(film(shown).seconds[-1])
    if duration == 0.0:
        raise ValueError("one configuration is no movie: `screenshot` makes a picture of it")
    if not 0.5 < duration * fps <= MOST_FRAMES:
        raise ValueError(f"fps is {fps:.3g}; the movie lasts {duration:.3g} s, and has 1 to "
                         f"{MOST_FRAMES} frames")
    seconds = (np.arange(round(duration * fps)) / fps).tolist()
    bar = progress_bar(len(seconds), path.name, progress)
    with tempfile.TemporaryDirectory() as folder, bar, Browser(size) as browser:
        page = export_html(shown, Path(folder) / "page.html", title=title, look=look)
        open_page(browser, page)

        def camera(t: float) -> Image.Image:
            bar.update()
            return shoot(browser, t)

        with replacing(path) as target:
            write(target, seconds, camera, fps)
    return path


WRITERS: dict[str, Callable[[Path, Sequence[float], Shoot, float], None]] = {
    ".gif": write_gif,
    ".mp4": write_mp4,
}
