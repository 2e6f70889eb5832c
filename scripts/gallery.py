"""Pictures of the mechanism library: all on one sheet, or one of them as an animation.

    python scripts/gallery.py [gallery.png] [--only NAME ...]
    python scripts/gallery.py docs/gallery.jpg --width 1440
    python scripts/gallery.py --each docs/pictures [--only NAME ...]
    python scripts/gallery.py --animation rssr docs/rssr.gif [--trace POINT ...]

A mechanism is shown on the way of a move of its first driver. Needs Chromium or Chrome.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from math import ceil, pi
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

import spatial_pin as sp
from spatial_pin.motion.default_motion import default_motion
from spatial_pin.view.browser.devtools import Browser
from spatial_pin.view.browser.movie import open_page, shoot, write_gif
from spatial_pin.view.page.html import export_html
from spatial_pin.view.scene.film import film
from spatial_pin.view.scene.look import Look

TILE = (480, 360)  # [pixels]
CAPTION = 30  # height of the name under a tile [pixels]
COLUMNS = 6
PART = 0.15  # of the motion, after which the picture is taken
ANIMATION = (480, 360)
FRAMES, FPS, COLOURS = 48, 16, 64


def on_the_way(name: str) -> sp.State:
    """Return a mechanism at a part of its usual motion, or as it is assembled."""
    shown = default_motion(sp.load(name))
    return shown if isinstance(shown, sp.State) else shown.state(int(PART * len(shown)))


def pictures(states: Iterable[sp.State], folder: Path) -> Iterator[Image.Image]:
    """Yield a picture of each state, all by one browser."""
    with Browser(TILE) as browser:
        for state in states:
            open_page(browser, export_html(state, folder / "page.html"))
            browser.evaluate("document.getElementById('says').style.display = 'none'")
            yield shoot(browser, 0.0)


def caption_of(name: str) -> str:
    """Return what stands under the picture of a library mechanism."""
    return f"{name}: {sp.load(name).title}".rstrip(": ")


def sheet(
    captions: Sequence[str], images: Sequence[Image.Image], most: int = COLUMNS
) -> Image.Image:
    """Return all pictures on one sheet with their captions, so many in a row at most."""
    columns = min(most, len(captions))
    width, height = TILE[0], TILE[1] + CAPTION
    made = Image.new("RGB", (columns * width, ceil(len(captions) / columns) * height), "white")
    draw = ImageDraw.Draw(made)
    font = ImageFont.load_default(16)
    for k, (caption, image) in enumerate(zip(captions, images, strict=True)):
        x, y = k % columns * width, k // columns * height
        made.paste(image, (x, y))
        draw.text((x + width / 2, y + TILE[1] + CAPTION / 2), caption, "black", font, "mm")
        draw.rectangle((x, y, x + width - 1, y + height - 1), outline="#d5d9de")
    return made


def animate(name: str, path: Path, traces: Sequence[str]) -> None:
    """Write one turn of a mechanism as a small GIF that repeats for ever."""
    mechanism = sp.load(name)
    driver = next(iter(mechanism.drivers))
    values = np.linspace(0.0, 2 * pi, 4 * FRAMES + 1)
    motion = sp.sweep(mechanism, driver, values, speed=2 * pi * FPS / FRAMES, on_limit="stop")
    seconds = np.linspace(0.0, film(motion).seconds[-1], FRAMES, endpoint=False).tolist()
    with tempfile.TemporaryDirectory() as folder, Browser(ANIMATION) as browser:
        page = export_html(motion, Path(folder) / "page.html", look=Look(traces=tuple(traces)))
        open_page(browser, page)
        browser.evaluate("document.head.insertAdjacentHTML('beforeend', "
                         "'<style>#says h1, #says small { display: none }</style>')")
        write_gif(path, seconds, lambda t: shoot(browser, t), FPS, COLOURS)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description="Pictures of the mechanism library.")
    parser.add_argument("path", nargs="?", type=Path, default=Path("gallery.png"),
                        help="the sheet (gallery.png)")
    parser.add_argument("--width", type=int, help="of the sheet, to make it smaller [pixels]")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="these mechanisms, not all")
    parser.add_argument("--each", type=Path, metavar="FOLDER",
                        help="write a picture of each, FOLDER/NAME.jpg, instead")
    parser.add_argument("--animation", nargs=2, metavar=("NAME", "PATH"),
                        help="write one turn of a mechanism as a GIF instead")
    parser.add_argument("--trace", nargs="+", default=[], metavar="POINT",
                        help="points whose paths the animation shows")
    options = parser.parse_args(arguments)
    if options.animation:
        name, path = options.animation
        animate(name, Path(path), options.trace)
        print(f"wrote {path}")
        return
    names = options.only or sp.list_mechanisms()
    with tempfile.TemporaryDirectory() as folder:
        images = list(pictures(map(on_the_way, names), Path(folder)))
    if options.each:
        path = options.each
        path.mkdir(parents=True, exist_ok=True)
        for name, image in zip(names, images, strict=True):
            image.convert("RGB").save(path / f"{name}.jpg", quality=85, optimize=True)
    else:
        path = options.path
        made = sheet(list(map(caption_of, names)), images)
        if options.width:
            size = options.width, round(options.width * made.height / made.width)
            made = made.resize(size, Image.Resampling.LANCZOS)
        made.save(path, optimize=True)
    print(f"wrote {path}")


if __name__ == "__main__":
    main()
