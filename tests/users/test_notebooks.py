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

import spatial_pin as sp
from spatial_pin.figures import NOTEBOOK_DPI
from spatial_pin.formats.export import export_urdf
from spatial_pin.view.browser.devtools import Browser
from spatial_pin.view.browser.picture import find_browser
from spatial_pin.view.page.notebook import PagePath, watched

NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
CELLS = (
    "import numpy as np, spatial_pin as sp\n"
    "motion = sp.sweep(sp.load('rssr'), 'crank', np.linspace(0, 6, 61), speed=5.0)",
    "motion",
    "sp.plot(motion, ['rocker_pin', 'coupler.velocity'])",
    "sp.show(motion)",
    "sp.live(motion.mechanism)",
)


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
    export_urdf(sp.load("four_bar"), tmp_path / "a.urdf")
    text = (tmp_path / "a.toml").read_text()
    title = re.sub(r'(?m)^title = .*$', f'title = "{name}"', text)
    (tmp_path / "a.toml").write_text(title)
    mechanism = sp.load(tmp_path / "a.toml")
    assert mechanism.title == name
    assert html.escape(name) in mechanism._repr_html_()
    assert name not in mechanism._repr_html_()


# ---------------------------------------------------------------- pictures and pages


def unquoted(frame: str) -> str:
    """Return the page that a frame holds."""
    (quoted,) = re.fullmatch(r'<iframe srcdoc="([^"]*)" style="[^"]*">[^<]+</iframe>',
                             frame).groups()
    return quoted.replace("&quot;", '"').replace("&amp;", "&")


def test_a_figure_needs_no_pyplot():
    code = ("import sys, spatial_pin as sp; "
            "sp.plot(sp.sweep(sp.load('rssr'), 'crank', [0.0, 0.1]), 'rocker_pin')._repr_png_(); "
            "assert 'matplotlib.pyplot' not in sys.modules")
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_figure_is_its_picture_without_any_magic(motion):
    figure = sp.plot(motion, "rocker_pin")
    picture = figure._repr_png_()
    width = int.from_bytes(picture[16:20], "big")
    assert picture.startswith(b"\x89PNG") and width == round(7.5 * NOTEBOOK_DPI)
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
    assert PagePath(tmp_path / "a.png")._repr_html_() is None


def test_a_live_page_has_a_still_one_beside_it():
    with sp.live(sp.load("rssr"), open_browser=False) as viewer:
        text = viewer._repr_html_()
        assert f'src="{viewer.url}"' in text and "data-still=" in text
    assert "iframe" not in viewer._repr_html_()
    assert 'data-still="a &amp; &quot;b"' in watched("http://127.0.0.1:1/", 'a & "b')


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
@pytest.mark.skipif(find_browser() is None, reason="no Chromium or Chrome on this machine")
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_run_and_show_what_is_stored(path):
    stored, again = json.loads(path.read_text("utf-8")), runner().run(path)
    for old, new in zip(stored["cells"], again.cells, strict=True):
        if old["cell_type"] == "code":
            assert shown_by(new) == shown_by(old), new["source"]


# ---------------------------------------------------------------- a notebook, run and exported


@pytest.fixture(scope="module")
def exported(tmp_path_factory) -> Path:
    """The exported page of a notebook, whose kernel is gone."""
    nbformat = pytest.importorskip("nbformat")
    nbclient = pytest.importorskip("nbclient")
    nbconvert = pytest.importorskip("nbconvert")
    pytest.importorskip("ipykernel")
    folder = tmp_path_factory.mktemp("notebook")
    book = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(x) for x in CELLS])
    nbclient.NotebookClient(book, timeout=120, resources={"metadata": {"path": folder}}).execute()
    kinds = [{kind for o in cell.outputs for kind in o.get("data", {})} for cell in book.cells]
    assert kinds == [set(), {"text/html", "text/plain"}, {"image/png", "text/plain"},
                     *[{"text/html", "text/plain"}] * 2]
    text, _ = nbconvert.HTMLExporter().from_notebook_node(book)
    page = folder / "notebook.html"
    page.write_text(text, encoding="utf-8")
    return page


# until the still page is there, the frame shows the browser's own page of a server not found, which
# may not be looked into
PLAYS = """(() => {
  try { return typeof frames[1].seek === "function"; } catch { return false; }
})()"""


@pytest.mark.slow
@pytest.mark.browser
@pytest.mark.skipif(find_browser() is None, reason="no Chromium or Chrome on this machine")
@pytest.mark.filterwarnings("ignore")
def test_an_exported_notebook_plays_its_pages(exported):
    with Browser((480, 360)) as browser:  # small: all pages of a notebook are drawn at once
        browser.open(exported, "frames.length === 2")
        browser.wait_until("typeof frames[0].seek === 'function'")
        assert browser.evaluate("frames[0].document.title") == "RSSR spatial four-bar"
        browser.evaluate("frames[0].document.querySelector('#player button').click()")
        browser.wait_until("document.querySelectorAll('iframe')[1].srcdoc.length > 1e5")
        browser.wait_until(PLAYS)
        assert "crank" in browser.evaluate("frames[1].document.body.innerText")
        assert not browser.evaluate("frames[1].document.querySelector('#dials')")
        assert browser.evaluate("[...document.images].some(i => i.naturalWidth === 750)")
