"""How a page looks: round meshes, white bodies on white, dark where the reader's system is."""

from itertools import pairwise

import numpy as np
import pytest
from chromium import READY, Browser, needs_browser
from images import pixels
from variety import first

import spatial_pin as sp

SIZE = (900, 640)
SIDES = 16  # of a prism: its sides meet at 22.5 degrees
pytestmark = [pytest.mark.browser, needs_browser]
URDF = """<robot name="body"><link name="ground"/><link name="body"><visual><geometry>{shape}
</geometry><material name="white"><color rgba="1 1 1 1"/></material></visual></link>
<joint name="turn" type="continuous"><parent link="ground"/><child link="body"/>
<axis xyz="0 0 1"/></joint></robot>"""


@pytest.fixture
def browser(one_browser):
    one_browser.resize(SIZE)
    return one_browser


@pytest.fixture
def opened(browser, tmp_path):
    """Open the page of one body of a shape, which meets the eye with three faces."""
    def opened(shape: str) -> Browser:
        (tmp_path / "body.urdf").write_text(URDF.format(shape=shape), encoding="utf-8")
        state = sp.assemble(sp.load(tmp_path / "body.urdf"), {"turn": 0.0})
        browser.open(sp.export_html(state, tmp_path / "body.html"), READY)
        return browser

    yield opened
    media(browser, "light")


def media(browser: Browser, scheme: str) -> None:
    """Let the system of the reader be dark or light."""
    browser.call("Emulation.setEmulatedMedia",
                 features=[{"name": "prefers-color-scheme", "value": scheme}])


def prism() -> str:
    """A Wavefront mesh of a prism about z, its points shared by sides and ends."""
    angle = 2.0 * np.pi * np.arange(SIDES) / SIDES
    points = [f"v {np.cos(a)} {np.sin(a)} {z}" for z in (-1.0, 1.0) for a in angle]
    k = np.arange(1, SIDES + 1)
    sides = [f"f {a} {b} {b + SIDES} {a + SIDES}" for a, b in zip(k, np.roll(k, -1), strict=True)]
    ends = [f"f {' '.join(map(str, k[::-1]))}", f"f {' '.join(map(str, k + SIDES))}"]
    return "\n".join([*points, *sides, *ends])


def test_mesh_is_shaded_round_and_keeps_its_edges(opened, tmp_path):
    (tmp_path / "prism.obj").write_text(prism(), encoding="utf-8")
    page = opened('<mesh filename="prism.obj"/>')
    found = page.evaluate("""(() => {
      const {geometry, material} = solids.find(s => s.group === "links").meshes[0];
      const {position, normal} = geometry.attributes;
      return [[...position.array], [...normal.array], material.flatShading];
    })()""")
    points, normals = (np.reshape(x, (-1, 3)) for x in found[:2])
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    assert not found[2] and len(points) == 3 * (2 * SIDES + 2 * (SIDES - 2))
    ends = np.abs(normals[:, 2]) > 0.5
    assert ends.sum() == 3 * 2 * (SIDES - 2)
    np.testing.assert_allclose(normals[ends], np.sign(points[ends, 2:]) * [0.0, 0.0, 1.0],
                               atol=1e-6)
    # two of the three triangles about a point of a side may lie in one plane: within a third
    # of the angle between sides the normal is that of the cylinder
    lean = np.einsum("ij,ij->i", normals[~ends], points[~ends] * [1.0, 1.0, 0.0])
    assert lean.min() > np.cos(2.0 * np.pi / SIDES / 3.0)


@pytest.mark.slow
def test_white_body_is_not_drawn_as_white_as_the_paper(opened):
    page = opened('<sphere radius="1"/>')
    page.wait_until("!viewer.needs_render")
    seen = pixels(page.screenshot()).mean(axis=2)
    places = page.evaluate("""(() => { viewer.render(); const found = [];
      for (let y = 60; y < 600; y += 4)
        for (let x = 30; x < 760; x += 4) if (hitAt(x, y)) found.push([x, y]);
      return found; })()""")
    shades = np.array([seen[y, x] for x, y in places])
    assert len(shades) > 1000 and np.mean(shades > 0.99) < 0.08


@pytest.mark.slow
def test_page_is_dark_where_the_system_is_and_a_picture_is_not(opened):
    page = opened('<box size="1 1 1"/>')
    corner = "getComputedStyle(document.querySelector('#tools button')).backgroundColor"
    light = page.evaluate(corner)
    for scheme, is_dark in (("dark", True), ("light", False)):
        media(page, scheme)
        page.wait_until(f"document.body.classList.contains('dark') === {str(is_dark).lower()}")
        page.wait_until("!viewer.needs_render")
        sky = pixels(page.screenshot())[300, 20]
        assert (sky.max() < 0.5) == is_dark and (sky.min() == 1.0) != is_dark
        assert (page.evaluate(corner) == light) != is_dark
    media(page, "dark")
    page.evaluate("location.hash = '#bare'; 1")
    page.wait_until("document.body.classList.contains('bare') && !viewer.needs_render")
    assert pixels(page.screenshot())[300, 20].min() == 1.0


@pytest.mark.slow
def test_words_of_a_dark_page_can_be_read(opened):
    """Their contrast is at least 4.5, as the Web Content Accessibility Guidelines ask."""
    page = opened('<box size="1 1 1"/>')
    media(page, "dark")
    page.wait_until("document.body.classList.contains('dark')")
    colours = page.evaluate("""
      ["sky", "paper", "ink", "faint", "alarm", "told", "blue", "orange", "green"].map(
        name => getComputedStyle(document.body).getPropertyValue("--" + name).trim()
      ).map(colour => new THREE.Color(colour).toArray())""")
    sky, paper, *words = (luminance(np.array(c)) for c in colours)
    for ground, least in ((sky, min(words[:4])), (paper, min(words))):  # curves stand on paper
        assert (least + 0.05) / (ground + 0.05) > 4.5


def luminance(colour: np.ndarray) -> float:
    """Relative luminance of an sRGB colour (3,), as WCAG 2 defines it."""
    linear = np.where(colour <= 0.04045, colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


@pytest.mark.slow
def test_edges_are_lines_between_faces_that_meet_at_an_angle(opened, tmp_path):
    (tmp_path / "prism.obj").write_text(prism(), encoding="utf-8")
    page = opened('<mesh filename="prism.obj"/>')
    script = "solids.find(s => s.group === 'links').meshes[0].children"
    ends = np.reshape(page.evaluate(f"[...{script}[0].geometry.attributes.position.array]"),
                      (-1, 2, 3))
    assert len(ends) == 2 * SIDES  # round both ends, none along the sides
    assert np.all(np.abs(ends[:, :, 2]) == 1.0) and np.all(ends[:, 0, 2] == ends[:, 1, 2])
    page.evaluate("setShown('group', 'edges', false); 1")
    assert not page.evaluate(f"{script}[0].visible")
    page.evaluate("setShown('group', 'edges', true); toggleTool('section'); 1")
    assert page.evaluate(f"{script}[0].visible && !{script}[0].material.visible")


@pytest.mark.parametrize(("shape", "edges"), first(1, [
    ('<box size="1 2 3"/>', [12]), ('<sphere radius="1"/>', []),
    ('<cylinder radius="1" length="1e-4"/>', [2 * 50])]))
def test_box_has_twelve_edges_and_a_ball_none(opened, shape, edges):
    count = "solids.find(s => s.group === 'links').meshes[0].children.map(" \
            "lines => lines.geometry.attributes.position.count / 2)"
    assert opened(shape).evaluate(count) == edges


@pytest.mark.slow
def test_link_of_a_long_list_is_found_by_a_part_of_its_name(browser, tmp_path):
    names = [f"link_{k}" for k in range(20)]
    links = "".join(f'<link name="{name}"><visual><geometry><sphere radius="0.1"/></geometry>'
                    '</visual></link>' for name in names)
    joints = "".join(f'<joint name="j{k}" type="continuous"><parent link="{a}"/><child link="{b}"/>'
                     '<origin xyz="0.3 0 0"/></joint>'
                     for k, (a, b) in enumerate(pairwise(names)))
    (tmp_path / "chain.urdf").write_text(f'<robot name="chain">{links}{joints}</robot>')
    state = sp.assemble(sp.load(tmp_path / "chain.urdf"), {})
    browser.open(sp.export_html(state, tmp_path / "chain.html"), READY)
    shown = "[...document.querySelectorAll('#parts [data-link]')].filter(" \
            "b => b.checkVisibility()).map(b => b.dataset.link)"
    browser.evaluate("toggleTool('parts'); document.querySelector('#parts [type=search]').focus()")
    assert browser.evaluate(shown) == names
    for kind in ("keyDown", "keyUp"):  # typed, although a key of the page
        browser.call("Input.dispatchKeyEvent", type=kind, key="1", code="Digit1", text="1",
                     windowsVirtualKeyCode=49)
    assert browser.evaluate(shown) == [name for name in names if "1" in name]
    browser.call("Input.insertText", text="X")
    assert browser.evaluate(shown) == []
