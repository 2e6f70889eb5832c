"""Makes the pictures of the documentation, each by what it is a picture of.

    python scripts/pictures.py                       # all of them, some twenty minutes
    python scripts/pictures.py docs/reach.png [...]  # these
    python scripts/pictures.py --list                # how each is made

`MADE_BY` says how each is made: by a script, by an example, by the code of a page, or by a browser
that does here what a reader would do with the page. Needs Chromium or Chrome.
"""

from __future__ import annotations

import argparse
import io
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from fnmatch import fnmatch
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image

import spatial_pin as sp
from spatial_pin.view.browser.devtools import Browser
from spatial_pin.view.browser.movie import READY

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGE = (1280, 800)  # of a page that is shown as a reader sees it [pixels]
PICK = """name => {
  const sign = solids.find(solid => solid.name.startsWith(name + ":")).meshes[0];
  ruler.picks.push(pickOf({object: sign, point: new THREE.Vector3()}));
}"""  # a click of the ruler on the sign of a pair


def run(*words: str | Path) -> None:
    """Run a script of the repository."""
    subprocess.run([sys.executable, *words], cwd=ROOT, check=True)


class Script(NamedTuple):
    """A picture that a script writes.

    Attributes:
        words: of the command; "{path}" is the picture, "{name}" its name without the suffix.
    """

    words: str

    def make(self, path: Path) -> None:
        """Write the picture."""
        run(*self.words.format(path=path, name=path.stem).split())

    def __str__(self) -> str:
        """Return the command."""
        return f"python {self.words}"


class Example(NamedTuple):
    """Pictures that an example writes, side by side.

    Attributes:
        name: of the example.
        files: that it writes, from left to right.
        height: of the picture [pixels]; None: as it is.
    """

    name: str
    files: Sequence[str]
    height: int | None = None

    def make(self, path: Path) -> None:
        """Write the picture."""
        with tempfile.TemporaryDirectory() as folder:
            run(f"examples/{self.name}.py", folder)
            images = [Image.open(Path(folder) / name).convert("RGB") for name in self.files]
        tall = self.height or max(image.height for image in images)
        images = [image.resize((round(image.width * tall / image.height), tall),
                               Image.Resampling.LANCZOS) for image in images]
        made = Image.new("RGB", (sum(image.width for image in images), tall))
        for k, image in enumerate(images):
            made.paste(image, (sum(other.width for other in images[:k]), 0))
        made.save(path, optimize=True)

    def __str__(self) -> str:
        """Return the command and what it writes."""
        return f"python examples/{self.name}.py FOLDER: {' beside '.join(self.files)}"


class Code(NamedTuple):
    """A picture that the code of a page writes."""

    def make(self, path: Path) -> None:
        """Write the picture."""
        run("scripts/page_code.py", "--pictures", self.page_of(path))

    def page_of(self, path: Path) -> Path:
        """Return the page that shows the picture."""
        shown = f"]({path.relative_to(DOCS).as_posix()})"
        return next(page for page in sorted(DOCS.glob("*.md"))
                    if shown in page.read_text(encoding="utf-8"))

    def __str__(self) -> str:
        """Return the command."""
        return "python scripts/page_code.py --pictures PAGE"


class Reader(NamedTuple):
    """A picture of a page with which something has been done.

    Attributes:
        look: opens the page in a browser and does it.
    """

    look: str

    def make(self, path: Path) -> None:
        """Write the picture."""
        with Browser(PAGE) as browser:
            image = Image.open(io.BytesIO(READERS[self.look](browser)))
        image.convert("RGB").save(path, quality=88, optimize=True)

    def __str__(self) -> str:
        """Return what is done."""
        return str(READERS[self.look].__doc__)


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
    """A live page: one leg of a platform is asked for more than it can give."""
    with sp.live(sp.load("stewart"), open_browser=False) as viewer:
        browser.open(viewer.url, READY)
        browser.evaluate("""document.querySelector("[data-opens=parts]").click();
          const length = document.querySelector("[aria-label='leg_1, exact value']");
          length.value = 1000; length.onchange();""")
        browser.wait_until("!asking && !waiting.length && !viewer.needs_render")
        return browser.screenshot()


READERS = {"measuring": measuring, "dragging": dragging}
MADE_BY: dict[str, Script | Example | Code | Reader] = {
    "pictures/viewer.jpg": Reader("measuring"),
    "pictures/live.jpg": Reader("dragging"),
    "pictures/examples/*.jpg": Script("scripts/example_pictures.py {name}"),
    "pictures/robots/*.jpg": Script("scripts/gallery_robots.py docs/robots.jpg --pages docs"),
    "pictures/*.jpg": Script("scripts/gallery.py --each docs/pictures --only {name}"),
    "pictures/*.png": Code(),
    "calibration.png": Example("calibration", ["calibration.png"]),
    "clearance.png": Example("clearance", ["clearance.png"]),
    "design.png": Example("design", ["design.png"]),
    "follow.png": Example("excavator", ["excavator.png", "curves.png"], 480),
    "reach.png": Example("digging_range", ["range.png"]),
    "reach_path.png": Example("gough_platform", ["platform.png", "curves.png"], 520),
    "workspace.png": Example("workspace", ["five_bar.png"]),
    "gallery.jpg": Script("scripts/gallery.py {path} --width 1440"),
    "robots.jpg": Script("scripts/gallery_robots.py {path} --width 1440"),  # and --models FOLDER
    "rssr.gif": Script("scripts/gallery.py --animation rssr {path} --trace coupler_b"),
}


def made_by(path: Path) -> Script | Example | Code | Reader:
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
    options = parser.parse_args()
    for path in options.pictures or pictures():
        maker = made_by(path)
        print(f"{path.resolve().relative_to(ROOT)}: {maker}", flush=True)
        if not options.list:
            maker.make(path.resolve())


if __name__ == "__main__":
    main()
