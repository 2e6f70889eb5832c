"""What one can do with a page: play it, turn it, point at it, hide parts, measure, read curves."""

import html
import re
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from chromium import NEXT_PICTURE, READY, Browser, click_at, needs_browser
from images import colour_mask, data_of, middle, pixels
from variety import few

import spatial_pin as sp

SIZE = (900, 640)
CODES = {" ": ("Space", 32), "ArrowLeft": ("ArrowLeft", 37), "ArrowRight": ("ArrowRight", 39),
         "Home": ("Home", 36), "End": ("End", 35)}
pytestmark = [pytest.mark.browser, needs_browser]


@pytest.fixture(autouse=True)
def size(one_browser):
    one_browser.resize(SIZE)


@pytest.fixture(scope="module")
def motion():
    return sp.sweep(sp.load("rssr"), "crank", np.linspace(0.3, 0.3 + 2 * np.pi, 61))


@pytest.fixture(scope="module")
def address(motion, tmp_path_factory):
    return sp.export_html(motion, tmp_path_factory.mktemp("page") / "rssr.html")


@pytest.fixture(scope="module")
def seconds(address):
    """When the page shows each sample [s]."""
    return data_of(address.read_text(encoding="utf-8"))["seconds"]


@pytest.fixture(scope="module")
def wide(tmp_path_factory):
    """The page of a wide machine."""
    motion = sp.sweep(sp.load("excavator"), "boom", np.linspace(2.7, 3.3, 31))
    return sp.export_html(motion, tmp_path_factory.mktemp("wide") / "excavator.html")


# What a user can do to a page is taken back as far as a user can; whether that is all of it is
# told by what the page then shows.
BACK = """(() => {
  animator.pause(); setSpeed(1); setEnding("again"); zoomTo(null);
  for (const name of Object.keys(OPENED)) toggleTool(name, false);
  window.atFirst ||= {groups: [...hidden.group], shadow: film.shadow};
  hidden.group = new Set(atFirst.groups); hidden.link.clear(); showParts();
  film.shadow = atFirst.shadow; ruler.svg.replaceChildren();
  for (const box of document.querySelectorAll("#parts [type=checkbox]"))
    box.checked = !atFirst.groups.includes(box.dataset.group);
  view("first"); go(0); pointed.hidden = true; document.activeElement.blur();
  clearTimeout(remembering); history.replaceState(null, "", location.pathname);
})()"""
SHOWN = """(() => {
  viewer.render();
  const elements = [...document.body.querySelectorAll(":not(#triad *)")].filter(
    e => e.checkVisibility());
  const camera = [...viewer.camera.position.toArray(), ...viewer.controls.target.toArray()];
  return JSON.stringify([
    document.body.className, location.hash, innerWidth, innerHeight,
    elements.map(e => [e.tagName, e.id, String(e.className.baseVal ?? e.className)]),
    [...document.querySelectorAll("input, select")].map(e => [e.id, e.checked]),
    [...camera, viewer.camera.fov].map(x => x.toFixed(4)), moved, playing, animator.time,
    animator.playing, [...hidden.group], [...hidden.link], ruler.picks.length, zoomed,
    pairCentres.length, panels.map(p => p.data.name), section.on, inspector.on, chase.asked,
    film.shadow, solids.map(s => [s.name, s.node.visible, s.meshes.map(
      m => [m.material.opacity, m.material.emissive && m.material.emissive.getHex()])]),
  ]);
})()"""


@pytest.fixture(scope="module")
def whole(one_browser, address):
    """What the page shows, stopped at its first sample, when it was just opened."""
    one_browser.resize(SIZE)
    one_browser.open(address, READY)
    one_browser.evaluate(BACK)
    return one_browser.evaluate(SHOWN)


def is_as_new(browser: Browser, address: Path, whole: str) -> bool:
    """Whether the browser still has the page, and it shows what it showed at first."""
    if browser.evaluate("location.pathname") != address.resolve().as_uri().removeprefix("file://"):
        return False
    browser.evaluate(BACK)
    return browser.evaluate(SHOWN) == whole


@pytest.fixture
def page(one_browser, address, whole):
    """The open page, stopped at its first sample; nothing may be complained of afterwards."""
    if not is_as_new(one_browser, address, whole):
        one_browser.open(address, READY)
        one_browser.evaluate(BACK)
    yield one_browser
    one_browser.evaluate("1")
    kinds = ("Runtime.exceptionThrown", "Log.entryAdded")
    assert [e for e in one_browser.events if e["method"] in kinds] == []


def key(browser: Browser, name: str, shift: bool = False) -> None:
    """Press a key, wherever the focus is."""
    code, number = CODES.get(name) or (f"Key{name.upper()}", ord(name.upper()))
    for kind in ("keyDown", "keyUp"):
        browser.call("Input.dispatchKeyEvent", type=kind, key=name, code=code,
                     windowsVirtualKeyCode=number, modifiers=8 * shift)


def box(browser: Browser, selector: str) -> dict[str, float]:
    """Where an element stands once all is laid out: what watches sizes acts after pictures."""
    for _ in range(3):
        browser.evaluate(NEXT_PICTURE)
    script = f"document.querySelector({selector!r}).getBoundingClientRect().toJSON()"
    return browser.evaluate(script)


def click(browser: Browser, selector: str, across: float = 0.5) -> None:
    """Click at an element where it stands in the next picture; the page has met it then."""
    browser.evaluate("met = new Promise(done => addEventListener('click', () => done(true), "
                     "{capture: true, once: true})); 1")
    b = box(browser, selector)
    click_at(browser, b["x"] + across * b["width"], b["y"] + b["height"] / 2)
    browser.evaluate("met")


def point_at(browser: Browser, x: float, y: float) -> None:
    browser.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y, button="none")


def where(browser: Browser, link: str) -> tuple[float, float]:
    """A place of the picture at which a link is seen and nothing stands before it."""
    script = f"""(() => {{
      viewer.render();
      const cross = [[0, 0], [5, 0], [-5, 0], [0, 5], [0, -5]];
      const named = hit => hit && hit.object.userData.solid.name === {link!r};
      for (let y = 60; y < innerHeight - 80; y += 6)
        for (let x = 30; x < innerWidth - 200; x += 6)
          if (cross.every(([a, b]) => named(hitAt(x + a, y + b)))) return [x, y];
    }})()"""
    return tuple(browser.evaluate(script))


# ---------------------------------------------------------------- playing


def test_keys_play_and_step_without_focus(page, seconds):
    key(page, "ArrowRight")
    assert page.evaluate("animator.time") == pytest.approx(seconds[1], abs=1e-6)
    key(page, "ArrowRight", shift=True)
    assert page.evaluate("animator.time") == pytest.approx(seconds[11], abs=1e-6)
    key(page, "ArrowLeft")
    assert page.evaluate("animator.time") == pytest.approx(seconds[10], abs=1e-6)
    assert page.evaluate("Number(slider.value)") == pytest.approx(seconds[10], abs=1e-6)
    key(page, "End")
    assert page.evaluate("animator.time") == pytest.approx(seconds[-1], abs=1e-6)
    key(page, "Home")
    assert page.evaluate("animator.time") == 0
    key(page, " ")
    assert page.evaluate("animator.playing")
    page.wait_until("animator.time > 0.05")
    key(page, " ")
    assert not page.evaluate("animator.playing")


def test_step_from_between_two_samples_goes_to_the_next_of_them(page, seconds):
    page.evaluate(f"go({(seconds[4] + seconds[5]) / 2}); step(1); 1")
    assert page.evaluate("animator.time") == pytest.approx(seconds[5], abs=1e-6)
    page.evaluate(f"go({(seconds[4] + seconds[5]) / 2}); step(-1); 1")
    assert page.evaluate("animator.time") == pytest.approx(seconds[4], abs=1e-6)


@pytest.mark.slow
def test_buttons_step(page, seconds):
    click(page, "[data-step='1']")
    assert page.evaluate("animator.time") == pytest.approx(seconds[1], abs=1e-6)
    click(page, "[data-step='-1']")
    assert page.evaluate("animator.time") == 0


def test_speed_is_that_of_the_film(page):
    page.evaluate("speeds.value = '4'; speeds.onchange(); 1")
    assert page.evaluate("later(1, 0.5)") == pytest.approx(1.5)
    page.evaluate("animator.clock.getDelta = () => 0.01; go(1); animator.play(); 1")
    page.evaluate("animator.update(); animator.pause(); 1")
    assert (page.evaluate("animator.time") - 1.0) % 0.04 == pytest.approx(0, abs=1e-9)
    assert page.evaluate("animator.time") >= 1.04 - 1e-9
    key(page, "-")
    assert page.evaluate("[playing.speed, speeds.value]") == [2, "2"]


@pytest.mark.slow
def test_end_of_the_film_begins_again_turns_back_or_stops(page):
    end = page.evaluate("animator.duration")
    assert page.evaluate(f"later({end - 0.1}, 0.3)") == pytest.approx(0.2)
    click(page, "#ending")
    turned = page.evaluate(f"[later({end - 0.1}, 0.3), playing.way]")
    assert turned == [pytest.approx(end - 0.2), -1]
    assert page.evaluate("[later(0.1, 0.3), playing.way]") == [pytest.approx(0.2), 1]
    key(page, "r")
    page.evaluate("animator.play(); 1")
    assert page.evaluate(f"later({end - 0.1}, 0.3)") == pytest.approx(end)
    assert not page.evaluate("animator.playing")
    page.evaluate(f"go({end}); toggle(); 1")
    assert page.evaluate("animator.playing && animator.time < 1")


# ---------------------------------------------------------------- views


@pytest.mark.slow
@pytest.mark.parametrize(("pressed", "towards"), [
    ("1", [0, -1, 0]), ("2", [0, 0, 1]), ("3", [1, 0, 0]), ("4", np.array([1, -1, 1]) / 3**0.5),
])
def test_views_look_along_axes_and_hold_everything(page, pressed, towards):
    key(page, pressed)
    direction = page.evaluate(
        "[viewer.camera.position.clone().sub(viewer.controls.target).normalize()]"
        ".flatMap(d => [d.x, -d.z, d.y])")
    np.testing.assert_allclose(direction, towards, atol=1e-5)
    page.wait_until("!viewer.needs_render")
    inside = page.evaluate(
        "extent().map(p => viewer.camera.parent.localToWorld(p.clone()).project(viewer.camera))"
        ".map(p => Math.max(Math.abs(p.x), Math.abs(p.y)))")
    assert 0.7 < max(inside) < 0.95


@pytest.mark.slow
def test_start_and_fit_undo_what_the_user_has_moved(page):
    first = page.evaluate("viewer.camera.position.toArray()")
    page.evaluate("viewer.controls.dispatchEvent({type: 'start'});"
                  "viewer.camera.position.multiplyScalar(3); 1")
    click(page, "[data-view=fit]")
    near = page.evaluate("viewer.camera.position.clone().sub(viewer.controls.target).length()")
    assert near < 1.1 * np.linalg.norm(first)
    click(page, "[data-view=first]")
    np.testing.assert_allclose(page.evaluate("viewer.camera.position.toArray()"), first, atol=1e-6)


@pytest.mark.slow
def test_parallel_lines_are_drawn_so_in_a_parallel_view(page):
    height = "[[1, 0, 0], [0, 0, -1]].map(([x, y, z]) => [y - 0.2, y + 0.2].map(h => onScreen(" \
             "viewer.camera.parent.localToWorld(new THREE.Vector3(x, h, z)))[1])).map(" \
             "([a, b]) => a - b)"
    key(page, "1")
    page.wait_until("!viewer.needs_render")
    near, far = page.evaluate(height)
    assert abs(near / far - 1) > 0.1
    seen = page.evaluate("extent().length")
    key(page, "p")
    page.wait_until("!viewer.needs_render")
    parallel = page.evaluate(height)
    assert parallel[0] == pytest.approx(parallel[1], rel=0.03)
    assert parallel[0] == pytest.approx((near + far) / 2, rel=0.3) and seen
    shown = pixels(page.screenshot())
    assert colour_mask(shown, (0.0, 0.447, 0.698)).sum() > 500
    key(page, "5")
    key(page, "p")
    home = page.evaluate("[viewer.camera.position.toArray(), home.toArray()]")
    np.testing.assert_allclose(*home, rtol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("size", [(1280, 800), (700, 525), (640, 640), (390, 760)])
def test_buttons_do_not_cover_the_mechanism(page, size):
    page.resize(size)
    page.wait_until(f"Math.abs(viewer.camera.aspect - {size[0] / size[1]}) < 0.01")
    if size[0] < 400:  # where it is framed beside them
        key(page, "f")
    across = page.evaluate("extent().map(p => onScreen(viewer.camera.parent.localToWorld(p))[0])")
    assert min(across) > 0 and max(across) < box(page, "#tools")["x"]


# ---------------------------------------------------------------- parts and names


@pytest.mark.slow
def test_list_hides_links_and_groups_and_shows_pairs(page):
    orange = (0.835, 0.369, 0.0)
    assert not page.evaluate("document.getElementById('parts').checkVisibility()")
    click(page, "[data-opens=parts]")
    rows = page.evaluate(
        "[...document.querySelectorAll('#parts label')].map(l => l.innerText.trim())")
    links = ["ground", "crank", "coupler", "rocker"]
    assert rows == ["Links", "Pairs", "Axes", "Ground grid", "Edges", "Shadow", *links]
    before = pixels(page.screenshot())
    click(page, "#parts label:nth-of-type(8)", 0.9)
    after = pixels(page.screenshot())
    part = np.s_[:, :600]  # beside the list
    assert colour_mask(after[part], orange).sum() < 0.05 * colour_mask(before[part], orange).sum()
    click(page, "#parts label:nth-of-type(8)", 0.9)
    visible = "[...new Set(solids.filter(s => s.group === 'links' && s.node.visible)" \
              ".map(s => s.name))]"
    for expected in (["coupler"], links):
        page.evaluate("document.querySelector('#parts label:nth-of-type(9)').ondblclick(); 1")
        assert page.evaluate(visible) == expected
    assert page.evaluate("solids.filter(s => s.group === 'pairs').every(s => !s.node.visible)")
    click(page, "#parts label:nth-of-type(2)", 0.9)
    assert page.evaluate("solids.filter(s => s.group === 'pairs').every(s => s.node.visible)")
    shown = pixels(page.screenshot())
    assert np.mean(np.any(np.abs(shown[part] - before[part]) > 0.1, axis=2)) > 0.002


@pytest.mark.slow
def test_row_of_the_list_lights_its_link_up(page):
    click(page, "[data-opens=parts]")
    b = box(page, "#parts label:nth-of-type(9)")
    point_at(page, b["x"] + 30, b["y"] + 8)
    lit = "solids.filter(s => s.meshes.some(m => m.material.emissive.getHex())).map(s => s.name)"
    assert set(page.evaluate(lit)) == {"coupler"}
    point_at(page, 20, 300)
    assert page.evaluate(lit) == []


@pytest.mark.parametrize("link", ["crank", "coupler", "rocker", "ground"])
def test_pointer_tells_the_name_of_what_it_is_on(page, link):
    point_at(page, *where(page, link))
    assert page.evaluate("pointed.hidden ? '' : pointed.textContent") == link
    point_at(page, 5, 300)
    assert page.evaluate("pointed.hidden") or page.evaluate("pointed.textContent") == "ground grid"


MESH = """mtllib two.mtl
v 0 0 0\nv 1 0 0\nv 1 0 1\nv 0 0 1\nv 2 0 0\nv 2 0 1
usemtl blue\nf 1 2 3\nf 1 3 4
usemtl orange\nf 2 5 6\nf 2 6 3
"""
MESH_URDF = """<robot name="plate"><link name="ground"/><link name="plate"><visual><geometry>
<mesh filename="two.obj"/></geometry></visual></link><joint name="hinge" type="continuous">
<parent link="ground"/><child link="plate"/><axis xyz="0 0 1"/></joint></robot>"""


@pytest.mark.slow
def test_meshes_have_the_colours_of_their_files(one_browser, tmp_path):
    (tmp_path / "two.obj").write_text(MESH)
    (tmp_path / "two.mtl").write_text(
        "newmtl blue\nKd 0 0.447 0.698\nnewmtl orange\nKd 0.835 0.369 0\n")
    (tmp_path / "plate.urdf").write_text(MESH_URDF)
    state = sp.assemble(sp.load(tmp_path / "plate.urdf"))
    one_browser.resize(SIZE)
    one_browser.open(sp.export_html(state, tmp_path / "plate.html"), READY)
    key(one_browser, "1")
    one_browser.wait_until("!viewer.needs_render")
    seen = pixels(one_browser.screenshot())
    blue, orange = (middle(colour_mask(seen[:, :780], c)) for c in
                    ((0.0, 0.447, 0.698), (0.835, 0.369, 0.0)))
    assert orange[0] > blue[0] + 100 and abs(orange[1] - blue[1]) < 30
    point_at(one_browser, *orange)
    assert one_browser.evaluate("pointed.textContent") == "plate"


# ---------------------------------------------------------------- distances


@pytest.mark.slow
def test_distance_between_two_points_moves_with_the_bodies(page, motion):
    key(page, "m")
    ends = [where(page, "crank"), where(page, "rocker")]
    for x, y in ends:
        click_at(page, x, y)
    page.wait_until("document.querySelectorAll('#ruler text').length === 4")
    distance = "Math.hypot(...inMetres(...ruler.picks.map(inWorld)))"
    first = page.evaluate(distance)
    assert 0 < first < 2 * motion.mechanism.characteristic_length
    assert "mm" in page.evaluate("document.querySelector('#ruler').textContent")
    page.evaluate("go(2); viewer.render(); 1")
    assert abs(page.evaluate(distance) - first) > 1e-3 * first
    key(page, "m")
    page.wait_until("document.querySelector('#ruler').childElementCount === 0")


def near(browser: Browser, pick: str) -> tuple[float, float]:
    """Where the camera sees something that the ruler snaps to, some pixels off."""
    x, y = browser.evaluate(f"viewer.render(); onScreen(inWorld({pick}))")
    return x + 3, y - 2


def middle_of(name: str) -> str:
    return f"pairCentres.find(p => p.of === {name!r})"


@pytest.mark.slow
def test_ruler_snaps_to_the_middles_of_pairs_and_says_so(page, motion):
    page.evaluate("go(film.seconds[17]); 1")
    key(page, "m")
    point_at(page, *near(page, middle_of("rocker_pin")))
    assert page.evaluate("pointed.textContent") == "middle of rocker_pin (revolute)"
    for name in ("rocker_pin", "ball_a"):
        click_at(page, *near(page, middle_of(name)))
    from_, to = (motion.frame(n).position[17] for n in ("rocker_pin", "ball_a"))
    np.testing.assert_allclose(page.evaluate("inMetres(...spanned(ruler.picks))"), to - from_,
                               atol=1e-6)
    page.screenshot()
    said = page.evaluate("document.getElementById('ruler').textContent")
    assert "middle of rocker_pin" in said and "middle of ball_a" in said


@pytest.mark.parametrize("kind", ["origin of ", "corner of ", "surface of ", "axis of "])
def test_ruler_takes_what_it_says(page, motion, kind):
    key(page, "m")
    page.evaluate("go(1); viewer.render(); 1")
    if kind == "origin of ":  # each of this mechanism's is the middle of a pair
        page.evaluate("pairCentres.length = 0; 1")
    x, y = page.evaluate(f"""(() => {{
      for (let y = 60; y < 600; y += 3)
        for (let x = 30; x < 760; x += 3) {{
          const found = snapAt(x, y);
          if (found && found.name.startsWith({kind!r})) return [x, y];
        }}
    }})()""")
    point_at(page, x, y)
    assert page.evaluate("pointed.textContent").startswith(kind)
    click_at(page, x, y)
    off = page.evaluate("((x, y) => offPointer(ruler.picks[0], x, y))" + f"({x}, {y})")
    assert off <= (1.0 if kind == "surface of " else 11.0)


@pytest.mark.slow
def test_paths_have_points_and_round_off_beside_larger_numbers_is_reported_as_zero(
    one_browser, tmp_path
):
    mech = sp.load("delta")
    motion = sp.sweep(mech, "arm_1", np.linspace(-0.5, 1.0, 61), speed=1.0)
    look = sp.Look(traces="platform", curves="platform.position")
    one_browser.resize(SIZE)
    one_browser.open(sp.export_html(motion, tmp_path / "page.html", look=look), READY)
    one_browser.evaluate("go(film.seconds[55]); viewer.render(); drawCursors(); 1")
    x, y = one_browser.evaluate("panels[0].values.slice(0, 2).map(v => v.textContent)")
    across = motion.frame("platform").position[55, 1]
    assert x == "x 0 m" and float(y.split()[1]) == pytest.approx(across, rel=1e-4)
    path = "solids.find(s => s.name === 'path of platform').meshes[0]"
    assert one_browser.evaluate(f"corner({{object: {path}, face: {{a: 0, b: 1, c: 2}}}})[0].name"
                                ) == "point of path of platform"


def test_axes_are_as_far_apart_as_they_come(page, motion):
    script = """(names => {
      go(film.seconds[17]); viewer.render();
      ruler.picks = names.map(name => pairAxes.find(p => p.name === `axis of ${name}`));
      const apart = Math.hypot(...inMetres(...spanned(ruler.picks)));
      ruler.picks[0] = pairCentres.find(p => p.of === "ball_a");
      return [apart, Math.hypot(...inMetres(...spanned(ruler.picks)))];
    })(["crank_pin", "rocker_pin"])"""
    lines, foot = page.evaluate(script)
    model = motion.mechanism.model
    data = model.createData()
    pin.computeJointJacobians(model, data, motion.q[17])
    ids = [model.getJointId(name) for name in ("crank_pin", "rocker_pin", "ball_a")]
    a, b, ball = (data.oMi[j].translation for j in ids)
    u, v = (data.J[3:, model.joints[j].idx_v] for j in ids[:2])
    normal = np.cross(u, v) / np.linalg.norm(np.cross(u, v))
    assert lines == pytest.approx(abs(normal @ (b - a)), abs=1e-6)
    assert foot == pytest.approx(np.linalg.norm(np.cross(ball - b, v)), abs=1e-6)


@pytest.mark.slow
def test_dragging_the_picture_is_no_click_of_the_ruler(page):
    key(page, "m")
    x, y = where(page, "coupler")
    for kind, dx in (("mousePressed", 0), ("mouseMoved", 40), ("mouseReleased", 40)):
        page.call("Input.dispatchMouseEvent", type=kind, x=x + dx, y=y, button="left", clickCount=1)
    assert page.evaluate("ruler.picks.length") == 0


# ---------------------------------------------------------------- what is said of links and pairs


def told(browser: Browser) -> dict[str, str]:
    """What the inspector says."""
    return browser.evaluate("""(() => {
      tellInspected();
      return Object.fromEntries([...table.querySelectorAll("dt")].map(
        dt => [dt.textContent, dt.nextElementSibling.textContent]));
    })()""")


def numbers(text: str) -> list[float]:
    plain = text.replace("−", "-").replace("°", "")
    return [float(x.split()[0]) for x in plain.split(",")]


@pytest.mark.slow
def test_inspector_tells_where_a_link_is_and_what_it_weighs(page, motion):
    key(page, "i")
    click_at(page, *where(page, "coupler"))
    page.evaluate("go(film.seconds[23]); viewer.render(); 1")
    said = told(page)
    assert page.evaluate("whose.value") == "link coupler"
    inertia = motion.mechanism.inertias["coupler"]
    assert float(said["mass"].split()[0]) == pytest.approx(inertia.mass, rel=1e-4)
    placement = motion.state(23).placement("coupler")
    np.testing.assert_allclose(numbers(said["origin"]), 1e3 * placement.translation, atol=0.02)
    np.testing.assert_allclose(numbers(said["centre of mass"]),
                               1e3 * placement.act(inertia.lever), atol=0.02)
    angles = np.rad2deg(pin.rpy.matrixToRpy(placement.rotation))
    np.testing.assert_allclose(numbers(said["roll, pitch, yaw"]), angles, atol=0.01)
    assert said["parent pair"] == "ball_a" and said["other pairs"] == "ball_b"


@pytest.mark.slow
def test_inspector_leads_to_a_pair_and_tells_its_coordinate_and_rate(page, motion):
    key(page, "i")
    page.evaluate("whose.value = 'link rocker'; whose.onchange(); go(film.seconds[23]); 1")
    click(page, "#inspector dd button")
    said = told(page)
    assert page.evaluate("whose.value") == "pair rocker_pin"
    assert said["kind"] == "revolute" and said["between"] == "groundrocker"
    value, rate, _ = (x[23] for x in motion.coordinate("rocker_pin"))
    angle = float(said["rocker_pin"].replace("−", "-")[:-1])
    assert angle == pytest.approx(np.rad2deg(value), rel=1e-4)
    words = said["rocker_pin.rate"].replace("−", "-").split()
    assert float(words[0]) == pytest.approx(rate, rel=1e-4)
    assert words[1] == motion.rate_unit("rad")
    assert not [name for name in said if name.startswith("reaction")]


@pytest.mark.slow
def test_page_of_a_report_tells_reactions(one_browser, tmp_path):
    mech = sp.load("four_bar")
    motion = sp.sweep(mech, "crank", np.linspace(0.0, 6.0, 31), speed=4.0)
    loads = sp.kinetostatics(mech, motion)
    report = sp.report(motion, tmp_path / "a.html").read_text(encoding="utf-8")
    (view,) = re.findall(r'srcdoc="([^"]*)"', report)
    path = tmp_path / "view.html"
    path.write_text(html.unescape(view), encoding="utf-8")
    one_browser.open(path, READY)
    one_browser.evaluate("toggleTool('inspector'); go(film.seconds[9]); inspect('pair crank_pin')")
    (force,) = [v for k, v in told(one_browser).items() if k.startswith("reaction, force")]
    size = np.linalg.norm(loads.reactions["crank_pin"][9, :3])
    assert float(force.split()[0]) == pytest.approx(size, rel=1e-4)


# ---------------------------------------------------------------- a plane that cuts


@pytest.mark.slow
def test_plane_cuts_the_links_at_its_place(page, motion):
    whole = pixels(page.screenshot())
    key(page, "s")
    page.evaluate("cutAcross(2); section.turned = false; sectionSlider.value = -0.02; cutAt(); 1")
    page.wait_until("!viewer.needs_render")
    cut = pixels(page.screenshot())
    assert page.evaluate("sectionPanel.querySelector('output').textContent") == "z = −20 mm"
    heights = """(() => { viewer.render(); const origin = placeInWorld(0), found = [];
      for (let y = 60; y < 600; y += 5) for (let x = 30; x < 760; x += 5) {
        const hit = hitAt(x, y);
        if (hit) found.push(inMetres(origin, hit.point)[2]);
      }
      return [Math.min(...found), Math.max(...found)]; })()"""
    low, high = page.evaluate(heights)
    assert low < -0.1 and -0.03 < high <= -0.02 + 1e-6
    assert np.mean(np.any(np.abs(cut - whole)[100:, :680] > 0.1, axis=2)) > 0.01
    page.evaluate("sectionPanel.querySelector('[data-turn]').onclick(); 1")
    low, _ = page.evaluate(heights)
    assert low >= -0.02 - 1e-6
    key(page, "s")
    page.wait_until("!viewer.needs_render")
    np.testing.assert_allclose(pixels(page.screenshot()), whole, atol=0.02)


@pytest.mark.slow
def test_cut_of_a_closed_body_is_hatched(page):
    page.evaluate("go(0); toggleTool('section'); cutAcross(2); section.turned = false;"
                  "sectionSlider.value = 0.02; cutAt(); view('top'); 1")
    page.wait_until("!viewer.needs_render")
    seen = pixels(page.screenshot())
    x, y = page.evaluate("""(() => { viewer.render();
      for (let y = 60; y < 600; y += 2) for (let x = 30; x < 760; x += 2) {
        const hit = hitAt(x, y);
        if (hit && hit.face.normal.clone().transformDirection(hit.object.matrixWorld)
                     .dot(ray.ray.direction) > 0.5) return [x, y];
      } })()""")
    patch = seen[y - 8 : y + 9, x - 8 : x + 9].mean(axis=2)
    assert patch.min() < 0.4 * patch.max()


# ---------------------------------------------------------------- the shadow


@pytest.mark.slow
def test_shadow_is_off_where_it_is_drawn_slowly_and_can_be_switched_on(page):
    assert page.evaluate("drawsSlowly()")  # these tests have no graphics card
    box_of = "document.querySelector('#parts [data-group=shadow]')"
    assert not page.evaluate(f"{box_of}.checked")
    before = pixels(page.screenshot())
    page.evaluate(f"{box_of}.checked = true; {box_of}.onchange(); 1")
    page.wait_until("!viewer.needs_render")
    after = pixels(page.screenshot())
    darker = (before - after).max(axis=2)
    assert (darker > 0.05).sum() > 1500 and darker.max() < 0.25
    colour = (0.0, 0.447, 0.698)  # links keep theirs
    assert colour_mask(after, colour).sum() == pytest.approx(colour_mask(before, colour).sum(),
                                                             rel=0.01)
    page.evaluate("animator.play(); pace.slow = PATIENCE; pace.last = -1e9; film.shadow = null;"
                  "watchShadow(); animator.pause(); 1")
    assert not page.evaluate(f"{box_of}.checked")


@pytest.mark.slow
def test_shadow_can_be_requested(one_browser, motion, tmp_path):
    page = sp.export_html(motion, tmp_path / "a.html", look=sp.Look(shadow=True))
    one_browser.open(page, READY)
    assert one_browser.evaluate("document.querySelector('#parts [data-group=shadow]').checked")


# ---------------------------------------------------------------- curves


@pytest.mark.slow
def test_curve_is_the_output_and_its_cursor_moves_both_ways(page, motion, seconds):
    assert not page.evaluate("document.getElementById('curves').checkVisibility()")
    height = page.evaluate("pane.clientHeight")
    click(page, "[data-opens=curves]")
    page.wait_until(f"pane.clientHeight < {height} - 100")
    assert page.evaluate("film.curves.name") == "crank [°]"
    values = page.evaluate("film.curves.panels[0].lines[0].values")
    np.testing.assert_allclose(values, np.rad2deg(motion.coordinate("rocker_pin").value), rtol=1e-5)
    page.evaluate(f"go({seconds[20]}); 1")
    page.screenshot()
    assert page.evaluate("panels[0].values[0].textContent") == f"{values[20]:.5g} °"
    cursor = page.evaluate("Number(panels[0].cursor.getAttribute('x1'))")
    b = box(page, "#curves svg")
    click_at(page, b["x"] + cursor + 0.2 * b["width"], b["y"] + 40)
    turned = np.rad2deg(2 * np.pi) * 0.2 * b["width"] / (b["width"] - 54)
    page.screenshot()
    crank = float(page.evaluate("outputs[0].textContent").removeprefix("crank = ")[:-1])
    assert crank == pytest.approx(np.rad2deg(motion.driver[20]) + turned, abs=0.5)
    moved = page.evaluate("Number(panels[0].cursor.getAttribute('x1'))")
    assert moved == pytest.approx(cursor + 0.2 * b["width"], abs=1.5)


@pytest.mark.slow
def test_curves_that_are_requested_are_open(one_browser, motion, tmp_path):
    look = sp.Look(curves=("coupler.com.position", "rocker_pin.ratio"))
    one_browser.resize(SIZE)
    one_browser.open(sp.export_html(motion, tmp_path / "a.html", look=look), READY)
    assert one_browser.evaluate("panels.length") == 2
    captions = one_browser.evaluate("document.getElementById('curves').innerText")
    assert "[m]" in captions and "ratio" in captions
    assert one_browser.evaluate("panels[0].svg.querySelectorAll('path').length") == 3
    colours = pixels(one_browser.screenshot())[int(box(one_browser, "#curves")["y"]) :]
    for colour in ((0.0, 0.447, 0.698), (0.835, 0.369, 0.0), (0.0, 0.62, 0.451)):
        assert colour_mask(colours, colour).sum() > 100
    with pytest.raises(sp.UnknownNameError, match="rocker_pni"):
        sp.export_html(motion, tmp_path / "b.html", look=sp.Look(curves="rocker_pni"))


@pytest.mark.slow
def test_page_of_a_state_has_views_and_names_but_no_curves(one_browser, tmp_path):
    state = sp.assemble(sp.load("stewart"))
    one_browser.open(sp.export_html(state, tmp_path / "a.html"), READY)
    player = "getComputedStyle(document.getElementById('player')).display"
    assert one_browser.evaluate(player) == "none"
    button = "document.querySelector('[data-opens=curves]')"
    assert not one_browser.evaluate(f"{button}.checkVisibility()")
    key(one_browser, "2")
    key(one_browser, " ")
    key(one_browser, "c")
    assert one_browser.evaluate("document.getElementById('curves').hidden")


@pytest.mark.slow
def test_curves_can_be_added_and_taken_away(page, motion):
    click(page, "[data-opens=curves]")
    shown = "panels.map(p => p.data.name)"
    first = page.evaluate(shown)
    click(page, "#curves input")
    page.call("Input.insertText", text="coupler_b.position")
    for kind in ("keyDown", "keyUp"):
        page.call("Input.dispatchKeyEvent", type=kind, key="Enter", code="Enter", text="\r",
                  windowsVirtualKeyCode=13)
    page.wait_until(f"({shown}).length === {len(first) + 1}")
    values = np.array(page.evaluate("panels.at(-1).data.lines.map(l => l.values)")).T
    np.testing.assert_allclose(values, motion.frame("coupler_b").position, atol=1e-6)
    page.evaluate("wanted.value = 'rocker_pin.rate'; addWanted(); 1")
    values = page.evaluate("panels.at(-1).data.lines[0].values")
    np.testing.assert_allclose(values, motion.coordinate("rocker_pin").rate, rtol=1e-6, atol=1e-6)
    assert page.evaluate("panels.at(-1).data.label").endswith(f"[{motion.rate_unit('rad')}]")
    page.evaluate("wanted.value = 'rocker_pni'; addWanted(); 1")
    assert not page.evaluate("wanted.checkValidity()")
    assert page.evaluate(shown) == [*first, "coupler_b.position", "rocker_pin.rate"]
    assert page.evaluate("panels.every(p => p.svg.querySelectorAll('path').length > 0)")
    page.evaluate("panels[0].figure.querySelector('button').click(); 1")
    assert page.evaluate(shown) == ["coupler_b.position", "rocker_pin.rate"]
    assert first[0] in page.evaluate("[...known.children].map(o => o.value)")


@pytest.mark.slow
def test_curves_of_another_motion_are_dashed_where_it_is_shown(one_browser, motion, tmp_path):
    other = sp.sweep(sp.load("rssr", d=0.33), "crank", np.linspace(1.0, 3.0, 31))
    look = sp.Look(curves="rocker_pin", ghosts=other)
    one_browser.resize(SIZE)
    one_browser.open(sp.export_html(motion, tmp_path / "a.html", look=look), READY)
    paths = "[...panels[0].svg.querySelectorAll('path')]"
    assert one_browser.evaluate(f"{paths}.map(p => p.hasAttribute('stroke-dasharray'))") == [
        False, True]
    one_browser.evaluate("go(film.seconds.at(-1)); drawCursors(); 1")
    assert one_browser.evaluate("panels[0].values[1].textContent") == "other – °"
    assert "at the same crank" in one_browser.evaluate("document.body.innerText")


# ---------------------------------------------------------------- narrow windows


def test_everything_fits_a_telephone(one_browser, address):
    one_browser.resize((390, 760))
    one_browser.open(address, READY)
    one_browser.evaluate("toggleTool('parts'); toggleTool('curves'); 1")
    assert one_browser.evaluate("document.documentElement.scrollWidth") <= 390
    for selector in ("#tools", "#parts", "#player", "#curves", "#says"):
        b = box(one_browser, selector)
        assert b["x"] >= 0 and b["right"] <= 390 and b["bottom"] <= 760.5, selector
    tools, says = box(one_browser, "#tools"), box(one_browser, "#says")
    assert says["right"] <= tools["x"] and tools["bottom"] <= box(one_browser, "#player")["y"]
    assert box(one_browser, "#player div")["width"] > 250
    one_browser.evaluate("toggleTool('parts', false); toggleTool('curves', false); 1")
    seen = pixels(one_browser.screenshot())
    column, row = middle(colour_mask(seen[:, :300], (0.0, 0.447, 0.698)))
    assert 50 < column < 300 and 150 < row < 600


@pytest.mark.slow
def test_picture_keeps_two_fifths_of_a_telephone(one_browser, motion, tmp_path):
    look = sp.Look(curves=["rocker_pin", "ball_a.x"])
    one_browser.resize((390, 844))
    one_browser.open(sp.export_html(motion, tmp_path / "page.html", look=look), READY)
    one_browser.evaluate("toggleTool('parts'); toggleTool('inspector'); toggleTool('section'); 1")
    assert box(one_browser, "#below")["y"] > 0.4 * 844


@pytest.mark.slow
def test_all_buttons_stand_above_the_player_of_a_report_on_a_telephone(one_browser, address):
    one_browser.resize((354, 470))  # its picture there
    one_browser.open(address, READY)
    assert box(one_browser, "#tools > :last-child")["bottom"] <= box(one_browser, "#player")["y"]


@pytest.mark.slow
def test_a_legend_that_would_lie_over_the_readings_is_hidden(one_browser, motion, tmp_path):
    look = sp.Look(traces="coupler_b", curves=["rocker_pin", "ball_a.x"])
    one_browser.resize((390, 480))
    one_browser.open(sp.export_html(motion, tmp_path / "page.html", look=look), READY)
    seen = "document.getElementById('legend').checkVisibility({visibilityProperty: true})"
    assert one_browser.evaluate(seen)
    one_browser.evaluate("toggleTool('parts'); toggleTool('inspector'); 1")
    one_browser.wait_until(f"!{seen}")
    assert box(one_browser, "#legend")["y"] < box(one_browser, "#says")["bottom"]
    one_browser.evaluate("toggleTool('parts', false); toggleTool('inspector', false); 1")
    one_browser.wait_until(seen)


@pytest.mark.slow
@pytest.mark.parametrize("size", few([(390, 760), (390, 560), (520, 900)], (390, 560)))
def test_first_view_of_a_wide_machine_is_free_of_what_is_written(one_browser, wide, size):
    one_browser.resize(size)
    one_browser.open(wide, READY)
    over = """seconds => {
      go(seconds); viewer.render();
      const written = "#tools button, #player > *, #triad circle, #says > *";
      const boxes = [...document.querySelectorAll(written)].map(b => b.getBoundingClientRect());
      const within = ([x, y], b) => x > b.left && x < b.right && y > b.top && y < b.bottom;
      const inside = point => boxes.some(b => within(point, b));
      const outside = ([x, y]) => x < 0 || y < 0 || x > pane.clientWidth || y > pane.clientHeight;
      const links = solids.filter(s => s.group === "links");
      const points = links.flatMap(s => s.meshes).flatMap(mesh => {
        const at = mesh.geometry.attributes.position;
        return Array.from({length: at.count}, (_, k) =>
          onScreen(mesh.localToWorld(new THREE.Vector3().fromBufferAttribute(at, k))));
      });
      const across = points.map(([x]) => x);
      const width = Math.max(...across) - Math.min(...across);
      return [points.filter(p => inside(p) || outside(p)).length, width];
    }"""
    for seconds in (0.0, 3.0, 6.0):
        hidden, width = one_browser.evaluate(f"({over})({seconds})")
        assert hidden == 0
        assert width > 0.55 * size[0]


# ---------------------------------------------------------------- browsers without WebGL

WITHOUT_WEBGL = """
  const get = HTMLCanvasElement.prototype.getContext;
  HTMLCanvasElement.prototype.getContext = function (kind, ...more) {
    return kind.startsWith("webgl") ? null : get.call(this, kind, ...more);
  };"""


@pytest.fixture
def without_webgl(one_browser):
    """The browser, whose pages have no WebGL."""
    one_browser.resize(SIZE)
    asked = one_browser.call("Page.addScriptToEvaluateOnNewDocument", source=WITHOUT_WEBGL)
    yield one_browser
    one_browser.call("Page.removeScriptToEvaluateOnNewDocument", identifier=asked["identifier"])


def shot(browser: Browser) -> np.ndarray:
    browser.evaluate("document.body.classList.add('bare'); go(1); 1")
    browser.wait_until("!viewer.needs_render")
    return pixels(browser.screenshot())[150:]  # below what is written


@pytest.mark.slow
def test_picture_without_webgl_is_the_same_and_the_page_says_why(page, without_webgl, address):
    expected = shot(page)
    assert "WebGL" not in page.evaluate("document.body.innerText")
    without_webgl.open(address, READY)
    assert "no WebGL" in without_webgl.evaluate("document.body.innerText")
    assert not without_webgl.evaluate("animator.playing")
    found = shot(without_webgl)
    for colour in ((0.835, 0.369, 0.0), (0.0, 0.447, 0.698), (0.0, 0.62, 0.451)):
        a, b = colour_mask(expected, colour), colour_mask(found, colour)
        assert np.sum(a & b) > 0.85 * np.sum(a | b) > 500
    first = found
    without_webgl.evaluate("go(3); 1")
    without_webgl.wait_until("!viewer.needs_render")
    moved = pixels(without_webgl.screenshot())[150:]
    assert np.mean(np.any(np.abs(moved - first) > 0.1, axis=2)) > 0.01


@pytest.mark.slow
def test_names_views_and_signs_are_there_without_webgl(without_webgl, address):
    without_webgl.open(address, READY)
    point_at(without_webgl, *where(without_webgl, "coupler"))
    assert without_webgl.evaluate("pointed.textContent") == "coupler"
    key(without_webgl, "1")
    without_webgl.evaluate("setShown('group', 'pairs', true); viewer.render(); 1")
    dark = pixels(without_webgl.screenshot())[150:560, :700].max(axis=2) < 0.5
    without_webgl.evaluate("setShown('group', 'pairs', false); viewer.render(); 1")
    less = pixels(without_webgl.screenshot())[150:560, :700].max(axis=2) < 0.5
    assert dark.sum() > less.sum() + 100


# ---------------------------------------------------------------- what the page holds packed


@pytest.mark.slow
def test_page_is_light(address):
    assert address.stat().st_size < 450_000


# ---------------------------------------------------------------- through links, after links


@pytest.mark.slow
def test_links_can_be_seen_through(page):
    before = pixels(page.screenshot())
    blue = colour_mask(before, (0.0, 0.447, 0.698))
    assert blue.sum() > 500
    key(page, "x")
    assert page.evaluate("solids.filter(s => s.group === 'links').flatMap(s => s.meshes).every("
                         "m => m.material.transparent && m.material.opacity < 0.3)")
    through = pixels(page.screenshot())
    assert np.mean(through[blue].min(axis=1) - before[blue].min(axis=1)) > 0.3
    key(page, "x")
    np.testing.assert_allclose(pixels(page.screenshot())[blue], before[blue], atol=0.02)


@pytest.mark.slow
def test_camera_goes_with_a_link(page):
    middle_of = "onScreen(middleOf(largestOf('coupler').userData.solid))"
    seen = page.evaluate(f"go(0); {middle_of}")
    page.evaluate("go(2.5); viewer.render(); 1")
    assert np.hypot(*np.subtract(page.evaluate(middle_of), seen)) > 20
    click(page, "[data-opens=chase]")
    click_at(page, *where(page, "coupler"))
    for seconds in (0.5, 2.5, 4.0):
        page.evaluate(f"go({seconds}); viewer.render(); 1")
        page.screenshot()
        x, y = page.evaluate(middle_of)
        width, height = page.evaluate("[pane.clientWidth, pane.clientHeight]")
        aside = page.evaluate("viewer.camera.view ? viewer.camera.view.offsetX : 0")
        assert (x + aside, y) == pytest.approx((width / 2, height / 2), abs=3)
    key(page, "5")
    page.screenshot()
    assert page.evaluate("chase.solid === null")
    assert not page.evaluate("document.querySelector('[data-opens=chase].on')")


@pytest.mark.slow
def test_follow_key_takes_the_link_under_the_pointer(page):
    point_at(page, *where(page, "crank"))
    key(page, "t")
    assert page.evaluate("chase.solid.name") == "crank"
    key(page, "t")
    assert page.evaluate("chase.solid === null && !chase.asked")


# ---------------------------------------------------------------- the axes of the world


@pytest.mark.slow
@pytest.mark.parametrize(("axis", "sign"), [("x", 1), ("y", -1), ("z", 1)])
def test_click_on_an_axis_looks_along_it(page, axis, sign):
    k = 2 * "xyz".index(axis) + (sign < 0)
    page.evaluate(f"ends[{k}].knob.onclick(); 1")
    page.wait_until("!viewer.needs_render")
    towards = page.evaluate(
        "[viewer.camera.position.clone().sub(viewer.controls.target).normalize()]"
        ".flatMap(d => [d.x, -d.z, d.y])")
    np.testing.assert_allclose(towards, sign * np.eye(3)["xyz".index(axis)], atol=1e-5)


@pytest.mark.slow
def test_axes_of_the_world_are_drawn_as_they_are_seen(page):
    for pressed, shown in (("1", "x"), ("2", "x"), ("3", "y")):
        key(page, pressed)
        page.screenshot()
        k = 2 * "xyz".index(shown)
        place = page.evaluate(f"ends[{k}].knob.getAttribute('transform')")
        found = [float(x) for x in place.removeprefix("translate(")[:-1].split()]
        np.testing.assert_allclose(found, [26, 0], atol=0.01)
    b = box(page, "#triad")
    assert b["right"] <= 900 and b["bottom"] <= 640
    key(page, "5")
    page.screenshot()
    knob = page.evaluate("ends[4].knob.getBoundingClientRect().toJSON()")
    click_at(page, knob["x"] + knob["width"] / 2, knob["y"] + knob["height"] / 2)
    up = page.evaluate("viewer.camera.position.clone().sub(viewer.controls.target).normalize().y")
    assert up == pytest.approx(1.0, abs=1e-5)


# ---------------------------------------------------------------- angle between axes


@pytest.mark.slow
def test_angle_between_the_axes_of_two_pairs(page, motion):
    page.evaluate("setShown('group', 'pairs', true); go(1.5); viewer.render(); 1")
    script = """(() => {
      const signs = solids.filter(s => s.group === "pairs");
      const sign = name => signs.find(s => s.name.startsWith(name + ":")).meshes[0];
      ruler.picks = ["crank_pin", "rocker_pin"].map(
        name => pickOf({object: sign(name), point: new THREE.Vector3()}));
      measure();
      return angleBetween(...ruler.picks);
    })()"""
    found = page.evaluate(script)
    model = motion.mechanism.model
    data = model.createData()
    pin.computeJointJacobians(model, data, motion.q[0])
    ids = [model.getJointId(name) for name in ("crank_pin", "rocker_pin")]  # both on the ground
    axes = [data.J[3:, model.joints[j].idx_v] for j in ids]
    expected = np.degrees(np.arccos(abs(np.dot(*axes))))
    assert found == pytest.approx(expected, abs=0.01)
    texts = page.evaluate("[...document.querySelectorAll('#ruler text')].map(t => t.textContent)")
    assert any(t.startswith("axes ") and t.endswith("°") for t in texts)
    balls = page.evaluate("solids.filter(s => s.name.startsWith('ball_')).map(s => s.along)")
    assert balls and all(along is None for along in balls)


# ---------------------------------------------------------------- curves from nearer


@pytest.mark.slow
def test_wheel_draws_less_of_the_abscissa(page, motion):
    click(page, "[data-opens=curves]")
    b = box(page, "#curves svg")
    x, y = b["x"] + 0.5 * b["width"], b["y"] + 40
    before = page.evaluate(f"panels[0].scale.back({x - b['x']})")
    page.call("Input.dispatchMouseEvent", type="mouseWheel", x=x, y=y, deltaX=0, deltaY=-800)
    page.wait_until("zoomed !== null")
    low, high = page.evaluate("panels[0].scale.x")
    assert high - low < 0.5 * np.ptp(np.rad2deg(motion.driver))
    assert page.evaluate(f"panels[0].scale.back({x - b['x']})") == pytest.approx(before, abs=0.2)
    rows = page.evaluate("panels[0].scale.rows.length")
    assert 2 < rows < len(motion)
    page.evaluate("go(0); 1")
    page.screenshot()
    assert page.evaluate("panels[0].cursor.getAttribute('visibility')") == "hidden"
    page.evaluate("panels[0].svg.ondblclick(); 1")
    assert page.evaluate("zoomed === null && panels[0].scale.rows.length") == len(motion)


# ---------------------------------------------------------------- the address


@pytest.mark.slow
def test_address_shows_the_same_again(page, one_browser, address):
    key(page, "4")
    key(page, "p")
    page.evaluate("viewer.controls.dispatchEvent({type: 'start'});"
                  "viewer.camera.position.multiplyScalar(1.2); go(1.25);"
                  "viewer.controls.dispatchEvent({type: 'end'}); 1")
    page.wait_until("location.hash.includes('t=1.25') && location.hash.includes('view=')")
    state = "[...viewer.camera.position.toArray(), ...viewer.controls.target.toArray()," \
            " viewer.camera.fov, animator.time]"
    expected, seen = page.evaluate(state), pixels(page.screenshot())
    one_browser.open(f"{address.resolve().as_uri()}{page.evaluate('location.hash')}", READY)
    np.testing.assert_allclose(page.evaluate(state), expected, atol=2e-4)
    assert np.mean(np.any(np.abs(pixels(page.screenshot()) - seen) > 0.1, axis=2)) < 0.003
    key(page, "5")
    page.wait_until("!location.hash.includes('view=')")
