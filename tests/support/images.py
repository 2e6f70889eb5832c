"""What tests look for in pictures: colours, and where a page's camera sees a point."""

import base64
import io
import json
import math
import re
import zlib

import numpy as np
import pytest
import umsgpack
from PIL import Image

from spatial_pin.view.browser.picture import find_browser
from spatial_pin.view.page.html import RAW_DEFLATE
from spatial_pin.view.scene.framing import ASPECT, FIELD_OF_VIEW, Framing


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


def seen_at(points: np.ndarray, framing: Framing, size: tuple[int, int]) -> np.ndarray:
    """Column and row (K, 2) at which the page's camera sees points (K, 3) of the view [m]."""
    width, height = size
    p = (np.atleast_2d(points) - framing.centre) / framing.radius
    camera = framing.camera * max(1.0, ASPECT * height / width)
    away = np.linalg.norm(camera)
    v = camera / away
    right = np.cross([0.0, 0.0, 1.0], v)
    right /= np.linalg.norm(right)
    up = np.cross(v, right)
    focus = height / 2 / math.tan(math.radians(FIELD_OF_VIEW) / 2)
    flat = np.stack([p @ right, -(p @ up)], axis=1) / (away - p @ v)[:, None]
    return flat * focus + [width / 2, height / 2]



def data_of(text: str) -> dict:
    """The film that a page holds, its commands decoded."""
    found = re.search(r'<script type="application/json" id="film">(.*?)</script>', text, re.S)
    film = json.loads(found[1])
    sizes, packed = film["commands"].values()
    every = io.BytesIO(zlib.decompress(base64.b64decode(packed), RAW_DEFLATE))
    film["commands"] = [umsgpack.unpackb(every.read(size)) for size in sizes]
    return film


def commands(text: str, kind: str) -> list[dict]:
    return [c for c in data_of(text)["commands"] if c["type"] == kind]


needs_browser = pytest.mark.skipif(
    find_browser() is None, reason="no Chromium or Chrome on this machine: pictures not checked"
)


def picture(path) -> np.ndarray:
    from PIL import Image

    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"), float) / 255
