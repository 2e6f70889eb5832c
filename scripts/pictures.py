"""Make the pictures of the documentation.

    python scripts/pictures.py                              # all of them, some twenty minutes
    python scripts/pictures.py docs/pictures/NAME.jpg [...] # these, also of new mechanisms
    python scripts/pictures.py docs/robots.jpg docs/pictures/robots/*.jpg --models FOLDER ...
    python scripts/pictures.py --list                       # how each is made

`MADE_BY` says how each is made: by the library's mechanism or the robot of its name, by an example,
by the code of a page, or by a browser that does here what a reader would do with the page. Files of
robots and meshes of examples are sought in the folders of `--models`, such as clones of
mujoco_menagerie and example-parallel-robots. The page of a robot is written with its picture. Needs
Chromium or Chrome.
"""

from __future__ import annotations

import argparse
import io
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from fnmatch import fnmatch
from math import ceil, pi
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).parent))

import numpy as np
import robots
from PIL import Image, ImageDraw, ImageFont

import spatial_pin as sp
from spatial_pin.motion.default_motion import default_motion
from spatial_pin.view.browser import Browser
from spatial_pin.view.pictures import READY, open_page, shoot, write_gif
from spatial_pin.view.scene.film import film

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
TILE = (480, 360)  # [pixels]
CAPTION = 30  # height of the name under a tile [pixels]
SHEET = 1440  # width of a sheet [pixels]
PART = 0.15  # of a mechanism's usual motion, after which its picture is taken
FRAMES, FPS, COLOURS = 48, 16, 64  # of an animation
SMALL = 800  # most width and height of an example's picture [pixels]
PAGE = (1280, 800)  # of a page that is shown as a reader sees it [pixels]
PICK = """name => {
  const sign = solids.find(solid => solid.name.startsWith(name + ":")).meshes[0];
  ruler.picks.push(pickOf({object: sign, point: new THREE.Vector3()}));
}"""  # a click of the ruler on the sign of a pair

Folders = Sequence[Path]  # of models


class Maker(NamedTuple):
    """How a picture is made.

    Attributes:
        words: what makes it, in words.
        make: writes it, of its path and the folders of models.
    """

    words: str
    make: Callable[[Path, Folders], None]


def run(*words: str | Path) -> None:
    """Run a script of the repository."""
    subprocess.run([sys.executable, *words], cwd=ROOT, check=True)


def save(image: Image.Image, path: Path, quality: int = 85) -> None:
    """Write a small file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    image.convert("RGB").save(path, quality=quality, optimize=True)


# ---------------------------------------------------------------- mechanisms and robots


def shots(states: Iterable[sp.State]) -> Iterator[Image.Image]:
    """Yield a picture of each state, all by one browser."""
    with tempfile.TemporaryDirectory() as folder, Browser(TILE) as browser:
        for state in states:
            open_page(browser, sp.export_html(state, Path(folder) / "page.html"))
            browser.evaluate("document.getElementById('says').style.display = 'none'")
            yield shoot(browser, 0.0)


def sheet(captions: Sequence[str], images: Sequence[Image.Image], most: int) -> Image.Image:
    """Return all pictures on one sheet with their captions, a few in a row."""
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


def narrow(image: Image.Image) -> Image.Image:
    """Return a sheet as wide as a page."""
    size = SHEET, round(SHEET * image.height / image.width)
    return image.resize(size, Image.Resampling.LANCZOS)


def midway(name: str) -> sp.State:
    """Return a mechanism at a part of its usual motion, or as it is assembled."""
    shown = default_motion(sp.load(name))
    return shown if isinstance(shown, sp.State) else shown.state(int(PART * len(shown)))


def library_sheet(names: Sequence[str]) -> Image.Image:
    """Return mechanisms of the library on one sheet."""
    captions = [f"{name}: {sp.load(name).title}".rstrip(": ") for name in names]
    return sheet(captions, list(shots(map(midway, names))), 6)


def of_library(path: Path, _: Folders) -> None:
    """Write the picture of the library's mechanism of that name."""
    (image,) = shots([midway(path.stem)])
    save(image, path)


def of_robot(path: Path, models: Folders) -> None:
    """Write the picture and the page of a robot, where its file is found."""
    for robot, file in robots.present(models):
        if robot.name == path.stem:
            state = robot.posed(file)
            (image,) = shots([state])
            save(image, path)
            (DOCS / "robots" / f"{robot.name}.md").write_text(robots.page(robot, state),
                                                             encoding="utf-8")


def of_robots(path: Path, models: Folders) -> None:
    """Write the sheet of the robots whose files are found."""
    all_robots = list(robots.present(models))
    images = list(shots(robot.posed(file) for robot, file in all_robots))
    save(narrow(sheet([robot.caption for robot, _ in all_robots], images, 3)), path, 75)


def animate(name: str, path: Path, traces: Sequence[str]) -> None:
    """Write one turn of a mechanism as a small GIF that repeats for ever."""
    mechanism = sp.load(name)
    driver = next(iter(mechanism.drivers))
    values = np.linspace(0.0, 2 * pi, 4 * FRAMES + 1)
    motion = sp.sweep(mechanism, driver, values, speed=2 * pi * FPS / FRAMES, on_limit="stop")
    seconds = np.linspace(0.0, film(motion).seconds[-1], FRAMES, endpoint=False).tolist()
    with tempfile.TemporaryDirectory() as folder, Browser(TILE) as browser:
        look = sp.Look(traces=tuple(traces))
        open_page(browser, sp.export_html(motion, Path(folder) / "page.html", look=look))
        browser.evaluate("document.head.insertAdjacentHTML('beforeend', "
                         "'<style>#says h1, #says small { display: none }</style>')")
        write_gif(path, seconds, lambda t: shoot(browser, t), FPS, COLOURS)


# ---------------------------------------------------------------- examples and pages


def written_by(name: str, files: Sequence[str], *arguments: Path) -> list[Image.Image]:
    """Run an example and return pictures that it writes."""
    with tempfile.TemporaryDirectory() as folder:
        run(f"examples/{name}.py", folder, *arguments)
        return [Image.open(Path(folder) / file).convert("RGB") for file in files]


def of_example(path: Path, models: Folders) -> None:
    """Write the first picture of the example of that name, small; Cassie's with its meshes."""
    meshes = [file for robot, file in robots.present(models) if robot.name == "cassie_mjcf"
              ] if path.stem == "cassie" else []
    (image,) = written_by(path.stem, [f"{path.stem}.png"], *meshes)
    image.thumbnail((SMALL, SMALL))
    save(image, path, 80)


def example(name: str, *files: str, height: int | None = None) -> Maker:
    """Return what writes pictures of an example side by side, of a height [pixels] or as it is."""

    def make(path: Path, _: Folders) -> None:
        images = written_by(name, files)
        tall = height or max(image.height for image in images)
        images = [image.resize((round(image.width * tall / image.height), tall),
                               Image.Resampling.LANCZOS) for image in images]
        made = Image.new("RGB", (sum(image.width for image in images), tall))
        for k, image in enumerate(images):
            made.paste(image, (sum(other.width for other in images[:k]), 0))
        made.save(path, optimize=True)

    return Maker(f"python examples/{name}.py FOLDER: {' beside '.join(files)}", make)


def page_of(path: Path) -> Path:
    """Return the page that shows a picture."""
    shown = f"]({path.relative_to(DOCS).as_posix()})"
    return next(page for page in sorted(DOCS.glob("*.md"))
                if shown in page.read_text(encoding="utf-8"))


def of_code(path: Path, _: Folders) -> None:
    """Write the pictures that the code of a page writes."""
    run("scripts/page_code.py", "--pictures", page_of(path))


def measuring(browser: Browser) -> bytes:
    """A distance between two pins of an excavator that moves, with the list of links and curves."""
    motion = sp.sweep(sp.load("excavator"), "boom", np.linspace(2.7, 3.3, 121))
    look = sp.Look(traces="bucket", curves=["boom_base", "boom_pin.ratio"])
    with tempfile.TemporaryDirectory() as folder:
        browser.open(sp.export_html(motion, Path(folder) / "page.html", look=look), READY)
        browser.evaluate("""go(film.seconds[60]);
          document.querySelector("[data-opens=parts]").click();
          document.querySelector("#parts label:nth-of-type(2) input").click();
          document.querySelector("[data-opens=ruler]").click();""")
        for pair in ("boom_base", "bucket_pin"):
            browser.evaluate(f"({PICK})('{pair}')")
        browser.evaluate("viewer.render()")
        return browser.screenshot()


def dragging(browser: Browser) -> bytes:
    """A live page: one leg of a platform is moved beyond its limit."""
    with sp.live(sp.load("stewart"), open_browser=False) as viewer:
        browser.open(viewer.url, READY)
        browser.evaluate("""document.querySelector("[data-opens=parts]").click();
          const length = document.querySelector("[aria-label='leg_1, exact value']");
          length.value = 1000; length.onchange();""")
        browser.wait_until("!asking && !waiting.length && !viewer.needs_render")
        return browser.screenshot()


def reader(look: Callable[[Browser], bytes]) -> Maker:
    """Return what writes a page with which something has been done."""

    def make(path: Path, _: Folders) -> None:
        with Browser(PAGE) as browser:
            save(Image.open(io.BytesIO(look(browser))), path, 88)

    return Maker(str(look.__doc__), make)


# ---------------------------------------------------------------- which is made how


MADE_BY = {
    "pictures/viewer.jpg": reader(measuring),
    "pictures/live.jpg": reader(dragging),
    "pictures/examples/*.jpg": Maker("the example of its name, small", of_example),
    "pictures/robots/*.jpg": Maker("the robot of its name in scripts/robots.py", of_robot),
    "pictures/*.jpg": Maker("the library's mechanism of its name", of_library),
    "pictures/*.png": Maker("python scripts/page_code.py --pictures PAGE", of_code),
    "calibration.png": example("calibration", "calibration.png"),
    "clearance.png": example("clearance", "clearance.png"),
    "design.png": example("design", "design.png"),
    "follow.png": example("excavator", "excavator.png", "curves.png", height=480),
    "reach.png": example("digging_range", "range.png"),
    "reach_path.png": example("gough_platform", "platform.png", "curves.png", height=520),
    "workspace.png": example("workspace", "five_bar.png"),
    "gallery.jpg": Maker("all mechanisms of the library on one sheet", lambda path, _: save(
        narrow(library_sheet(sp.list_mechanisms())), path, 75)),
    "robots.jpg": Maker("the robots of scripts/robots.py on one sheet", of_robots),
    "rssr.gif": Maker("one turn of the library's rssr",
                      lambda path, _: animate("rssr", path, ["coupler_b"])),
}


def made_by(path: Path) -> Maker:
    """Return how a picture is made: the first pattern counts."""
    name = path.resolve().relative_to(DOCS).as_posix()
    return next(maker for pattern, maker in MADE_BY.items() if fnmatch(name, pattern))


def pictures() -> list[Path]:
    """Return the pictures of the documentation."""
    return sorted(path for path in DOCS.rglob("*") if path.suffix in (".png", ".jpg", ".gif")
                  and "_build" not in path.parts)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("pictures", nargs="*", type=Path, help="default all")
    parser.add_argument("--list", action="store_true", help="only say how each is made")
    parser.add_argument("--models", nargs="+", type=Path, default=[], metavar="FOLDER",
                        help="folders of models of robots")
    options = parser.parse_args()
    for path in options.pictures or pictures():
        maker = made_by(path)
        print(f"{path.resolve().relative_to(ROOT)}: {maker.words}", flush=True)
        if not options.list:
            maker.make(path.resolve(), options.models)


if __name__ == "__main__":
    main()
