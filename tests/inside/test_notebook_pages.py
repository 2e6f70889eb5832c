"""Pages in notebooks: how they are framed, and that an exported notebook plays them."""

from pathlib import Path

import pytest
from images import needs_browser

from spatial_pin.view.browser import Browser
from spatial_pin.view.page.cards import PagePath, watched

CELLS = (
    "import numpy as np, spatial_pin as sp\n"
    "motion = sp.sweep(sp.load('rssr'), 'crank', np.linspace(0, 6, 61), speed=5.0)",
    "motion",
    "sp.plot(motion, ['rocker_pin', 'coupler.velocity'])",
    "sp.show(motion)",
    "sp.live(motion.mechanism)",
)


def test_only_a_page_is_shown_by_its_path(tmp_path):
    page, picture = tmp_path / "a.html", tmp_path / "a.png"
    page.write_text("<p>seen</p>")
    picture.write_bytes(b"no page")
    assert "seen" in PagePath(page)._repr_html_()
    assert PagePath(picture)._repr_html_() is None
    assert PagePath(tmp_path / "gone.png")._repr_html_() is None


def test_a_still_page_is_quoted_in_its_frame():
    assert 'data-still="a &amp; &quot;b"' in watched("http://127.0.0.1:1/", 'a & "b')


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
@needs_browser
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
