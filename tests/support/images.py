"""What tests look for in pictures: colours, and where a page's camera sees a point."""

import base64
import io
import json
import re
import zlib
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import umsgpack
from chromium import needs_browser
from PIL import Image
from scipy.spatial.transform import Rotation

import spatial_pin as sp

__all__ = ["clips", "colour_mask", "commands", "data_of", "ink", "matrix_of", "middle", "near",
           "needs_browser", "page", "paths", "picture", "pixels", "points_of", "z_axis"]


def pixels(png: bytes) -> np.ndarray:
    """A picture as (height, width, 3), 0 to 1."""
    with Image.open(io.BytesIO(png)) as image:
        return np.asarray(image.convert("RGB"), float) / 255


def colour_mask(image: np.ndarray, colour) -> np.ndarray:
    """Where the picture has the hue of a colour, however lit."""
    c = np.array(colour[:3]) - np.mean(colour[:3])
    p = image - image.mean(axis=2, keepdims=True)
    size = np.linalg.norm(p, axis=2)
    return (size > 0.1) & (p @ c > 0.95 * size * np.linalg.norm(c))


def ink(image: np.ndarray) -> np.ndarray:
    """Where the picture is not white."""
    return np.any(image < 0.97, axis=2)


def middle(mask: np.ndarray) -> np.ndarray:
    """Column and row of the middle of what a mask holds."""
    return np.argwhere(mask).mean(axis=0)[::-1]


def near(mask: np.ndarray, column: float, row: float, reach: int = 8) -> bool:
    """Whether a mask holds something within so many pixels of a point."""
    rows, columns = np.ogrid[: mask.shape[0], : mask.shape[1]]
    return bool(mask[np.hypot(rows - row, columns - column) <= reach].any())


def page(shown: object, **options: object) -> str:
    """The text of the page of a motion, state or design."""
    with TemporaryDirectory() as folder:
        return sp.export_html(shown, Path(folder) / "page.html", **options).read_text("utf-8")


def data_of(text: str) -> dict:
    """The film that a page holds, its commands decoded."""
    found = re.search(r'<script type="application/json" id="film">(.*?)</script>', text, re.S)
    film = json.loads(found[1])
    sizes, packed = film["commands"].values()
    every = io.BytesIO(zlib.decompress(base64.b64decode(packed), wbits=-15))
    film["commands"] = [umsgpack.unpackb(every.read(size)) for size in sizes]
    return film


def commands(text: str, kind: str) -> list[dict]:
    return [c for c in data_of(text)["commands"] if c["type"] == kind]


def paths(text: str) -> list[str]:
    """Names of the objects that a page shows."""
    return [c["path"].removeprefix("/mechanism/") for c in commands(text, "set_object")]


def matrix_of(text: str, path: str) -> np.ndarray:
    """Where a page puts the object of a name, (4, 4)."""
    (found,) = [c["matrix"] for c in commands(text, "set_transform")
                if c["path"] == f"/mechanism/{path}"]
    return np.reshape(found, (4, 4)).T


def picture(path) -> np.ndarray:
    from PIL import Image

    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"), float) / 255

def clips(text: str) -> dict[str, dict[str, np.ndarray]]:
    """The tracks of everything that moves, by the end of its path."""
    (animation,) = commands(text, "set_animation")
    found = {}
    for entry in animation["animations"]:
        tracks = entry["clip"]["tracks"]
        width = {"vector3": 3, "quaternion": 4}
        found[entry["path"].rpartition("/")[2]] = {
            t["name"]: np.frombuffer(t["values"].data, "<f4").reshape(-1, width[t["type"]])
            for t in tracks
        }
    return found


def points_of(text: str, name: str) -> np.ndarray:
    (command,) = [c for c in commands(text, "set_object") if c["path"] == f"/mechanism/{name}"]
    position = command["object"]["geometries"][0]["data"]["attributes"]["position"]["array"]
    return np.frombuffer(position.data, "<f4").reshape(-1, 3)


def z_axis(quaternions: np.ndarray) -> np.ndarray:
    """The z axes (K, 3) of orientations (K, 4), x y z w."""
    return Rotation.from_quat(quaternions).as_matrix()[:, :, 2]
