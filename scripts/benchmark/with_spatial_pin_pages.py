"""This library's pages: how soon one is written, seen, and answered while a slider is dragged."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np

import spatial_pin as sp
from benchmark.case import Absent, Case
from spatial_pin.view.browser.devtools import Browser
from spatial_pin.view.browser.movie import open_page
from spatial_pin.view.browser.picture import find_browser
from spatial_pin.view.page.drive import Drive

NAME = "spatial_pin"
MOVES = 60  # of one slider
STEPS = {"rssr": 0.0175, "delta": 0.0175, "stewart": 0.0002}  # of one move [rad, m]


def setup_page() -> sp.Motion:
    return sp.sweep(sp.load("rssr"), "crank", np.linspace(0.0, 2.0 * np.pi, 361))


@contextmanager
def page_of(motion: sp.Motion) -> Iterator[Path]:
    with tempfile.TemporaryDirectory() as folder:
        yield sp.export_html(motion, Path(folder) / "page.html")


def run_page(motion: sp.Motion) -> None:
    with page_of(motion):
        pass


def run_picture(motion: sp.Motion) -> bytes:
    with page_of(motion) as page, Browser((960, 720)) as browser:
        open_page(browser, page)
        return browser.screenshot()


def nothing(*_: object) -> dict[str, float | None]:
    return {}


def setup_slider(name: str) -> Drive:
    state = sp.assemble(sp.load(name))
    return Drive(state, state.mechanism.drivers)


def run_slider(drive: Drive, step: float) -> float:
    """Drag one slider to and fro; return the largest closure error."""
    driver = next(iter(drive.state.mechanism.drivers))
    start, worst = drive.value(driver), 0.0
    for k in range(MOVES):
        assert drive.move(driver, start + step * min(k + 1, MOVES - 1 - k)) is None
        worst = max(worst, drive.state.closure_error)
    return worst


CASES: tuple[Case, ...] = (
    Case("page", NAME, "export_html", setup_page, run_page, nothing),
    *(Case("slider", NAME, f"live, {name}", partial(setup_slider, name),
           partial(run_slider, step=step), lambda _, worst: {"closure": worst}, MOVES)
      for name, step in STEPS.items()),
)
ABSENT: tuple[Absent, ...] = ()
if find_browser() is None:
    ABSENT += (Absent("page", NAME, "there is no browser for its picture"),)
else:
    CASES += (Case("page", NAME, "export_html, and its picture by a new browser", setup_page,
                   run_picture, nothing, slow=True),)
