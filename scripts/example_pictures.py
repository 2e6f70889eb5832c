"""Pictures of the examples for the documentation: each is run, and its first picture kept, small.

    python scripts/example_pictures.py [NAME ...] [--cassie CASSIE.XML]

Without names, all that docs/examples.md shows. Cassie's file of MuJoCo Menagerie, with its meshes,
makes a better picture than the copy without them. Needs Chromium or Chrome.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "examples.md"
WIDTH, QUALITY = 800, 80  # [pixels], of JPEG


def shown() -> list[str]:
    """Return the names of the examples whose pictures the page shows."""
    return re.findall(r"\]\(pictures/examples/(\w+)\.jpg\)", PAGE.read_text(encoding="utf-8"))


def picture(name: str, arguments: list[str], path: Path) -> None:
    """Run an example and write its picture as a small JPEG."""
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([sys.executable, ROOT / "examples" / f"{name}.py", folder, *arguments],
                       check=True, stdout=subprocess.DEVNULL)
        image = Image.open(Path(folder) / f"{name}.png").convert("RGB")
    image.thumbnail((WIDTH, WIDTH))
    path.parent.mkdir(parents=True, exist_ok=True)
    image.save(path, quality=QUALITY, optimize=True)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("names", nargs="*", help="of examples; default all of the page")
    parser.add_argument("--cassie", help="Cassie's file, with meshes")
    options = parser.parse_args()
    for name in options.names or shown():
        path = PAGE.parent / "pictures" / "examples" / f"{name}.jpg"
        picture(name, [options.cassie] if name == "cassie" and options.cassie else [], path)
        print(f"wrote {path} ({path.stat().st_size / 1024:.0f} kB)")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
