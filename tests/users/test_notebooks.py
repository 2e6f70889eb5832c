"""In notebooks: what results show of themselves, stored, exported, and played when opened."""

import html
import importlib.util
import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from folders import ROOT
from images import needs_browser

import spatial_pin as sp

NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))


@pytest.fixture(scope="module")
def motion() -> sp.Motion:
    return sp.sweep(sp.load("rssr"), "crank", np.linspace(0.0, 6.0, 61), speed=5.0)


def shown(name: str, motion: sp.Motion):
    """Return an object that has a table of its own."""
    mechanism = motion.mechanism
    makers = {
        "Mechanism": lambda: mechanism, "Motion": lambda: motion,
        "State": lambda: motion.state(7), "Mobility": lambda: sp.mobility(mechanism),
        "Kinetostatics": lambda: sp.kinetostatics(mechanism, motion),
        "Tradeoff": lambda: sp.tradeoff(mechanism, settings=[sp.Accuracy()], repeats=1),
    }
    return makers[name]()


@pytest.mark.parametrize("name", ["Mechanism", "Motion", "State", "Mobility", "Kinetostatics",
                                  "Tradeoff"])
def test_results_show_a_small_table(motion, name):
    found = shown(name, motion)._repr_html_()
    assert "rssr" in found and "<table>" in found and len(found) < 4000
    assert "<script" not in found and "<iframe" not in found
    tags = re.findall(r"<(/?)(\w+)", found)
    assert [t for s, t in tags if not s].count("tr") == [t for s, t in tags if s].count("tr")


def test_tables_have_units_and_numbers(motion):
    text = motion._repr_html_()
    assert "rad/s" in text and "rocker_pin" in text and "closure error at most" in text
    loads = sp.kinetostatics(motion.mechanism, motion)
    text = loads._repr_html_()
    assert "N·m" in text and "largest force [N]" in text
    assert f"{loads.efforts['crank'].max():.6g}" in text


def test_a_table_of_many_rows_is_cut():
    found = sp.load("stewart")._repr_html_()
    assert "and 4 more" in found and "pose.z" not in found


def test_motions_without_samples_or_with_events_have_a_table(motion):
    arrays = ("driver", "time", "q", "v", "a", "closure_error", "driver_speed")
    empty = replace(motion, **{name: getattr(motion, name)[:0] for name in arrays})
    assert "rssr: 0 samples" in empty._repr_html_()
    loads = sp.kinetostatics(motion.mechanism, empty)
    assert "0 samples" in loads._repr_html_()
    traced = sp.trace(sp.load("slider_crank"), "slide")
    assert traced.events and html.escape(traced.events[0].text) in traced._repr_html_()


def test_names_that_are_markup_are_shown_as_they_are(tmp_path):
    name = "<img src=x onerror=alert(1)>"
    path = sp.load("four_bar").save(tmp_path)
    path.write_text(re.sub(r'(?m)^title = .*$', f'title = "{name}"', path.read_text()))
    mechanism = sp.load(path)
    assert mechanism.title == name
    assert html.escape(name) in mechanism._repr_html_()
    assert name not in mechanism._repr_html_()


# ---------------------------------------------------------------- pictures and pages


def unquoted(frame: str) -> str:
    """Return the page that a frame holds."""
    (quoted,) = re.fullmatch(r'<iframe srcdoc="([^"]*)" style="[^"]*">[^<]+</iframe>',
                             frame).groups()
    return quoted.replace("&quot;", '"').replace("&amp;", "&")


@pytest.mark.slow
def test_a_figure_needs_no_pyplot():
    code = ("import sys, spatial_pin as sp; "
            "sp.plot(sp.sweep(sp.load('rssr'), 'crank', [0.0, 0.1]), 'rocker_pin')._repr_png_(); "
            "assert 'matplotlib.pyplot' not in sys.modules")
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_figure_is_its_picture_without_any_magic(motion):
    figure = sp.plot(motion, "rocker_pin")
    picture = figure._repr_png_()
    width = int.from_bytes(picture[16:20], "big")
    assert picture.startswith(b"\x89PNG") and width == 750
    assert len(picture) < 60_000
    from matplotlib.figure import Figure

    assert isinstance(figure, Figure)


def test_a_shown_page_is_in_the_frame_itself(motion):
    with sp.show(motion, open_browser=False) as viewer:
        text = viewer._repr_html_()
    page = unquoted(text)
    assert page.startswith("<!DOCTYPE html>") and page.endswith("</html>\n")
    assert "<title>RSSR spatial four-bar</title>" in page and "127.0.0.1" not in page
    assert viewer._repr_html_() == text  # it needs no server


def test_a_report_is_a_path_that_shows_its_page(motion, tmp_path):
    path = sp.report(motion, tmp_path / "report.html", outputs="rocker_pin")
    assert isinstance(path, Path) and path == tmp_path / "report.html"
    assert unquoted(path._repr_html_()) == path.read_text("utf-8")
    assert path.parent._repr_html_() is None
    path.unlink()
    assert path._repr_html_() is None


def test_a_live_page_has_a_still_one_beside_it():
    with sp.live(sp.load("rssr"), open_browser=False) as viewer:
        text = viewer._repr_html_()
        assert f'src="{viewer.url}"' in text and "data-still=" in text
    assert "iframe" not in viewer._repr_html_()


# ---------------------------------------------------------------- the notebooks of the project


def runner():
    """Return the script that runs the notebooks."""
    pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    pytest.importorskip("pandas")
    spec = importlib.util.spec_from_file_location("notebooks", ROOT / "scripts" / "notebooks.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def shown_by(cell: dict) -> list[set[str]]:
    """Return what the outputs of a cell are: printed text, or kinds of data."""
    assert not [o for o in cell["outputs"] if o["output_type"] == "error"]
    return [set(o.get("data", {"printed": 0})) for o in cell["outputs"]]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_stored_notebooks_are_run_small_and_without_errors(path):
    book = json.loads(path.read_text("utf-8"))
    code = [cell for cell in book["cells"] if cell["cell_type"] == "code"]
    assert path.stat().st_size < runner().MOST_BYTES and 10 <= len(book["cells"]) <= 15
    assert [cell["execution_count"] for cell in code] == list(range(1, len(code) + 1))
    assert all(shown_by(cell) for cell in code)
    assert any("image/png" in kinds for cell in code for kinds in shown_by(cell))
    assert "/tmp/" not in path.read_text("utf-8")


@pytest.mark.slow
@pytest.mark.browser
@needs_browser
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_run_and_show_what_is_stored(path):
    stored, again = json.loads(path.read_text("utf-8")), runner().run(path)
    for old, new in zip(stored["cells"], again.cells, strict=True):
        if old["cell_type"] == "code":
            assert shown_by(new) == shown_by(old), new["source"]
