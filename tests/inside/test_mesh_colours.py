"""Colours and places of the parts of meshes are those of their files; moving reads none."""

from __future__ import annotations

import pickle
from types import SimpleNamespace

import numpy as np
import pytest
import umsgpack

import spatial_pin as sp
from spatial_pin.formats import mesh_files
from spatial_pin.formats.urdf import geometry
from spatial_pin.view.scene.film import film
from spatial_pin.view.scene.layers.visuals import BODY_COLOURS, body_items
from spatial_pin.view.scene.meshcat_commands import scene

RED, GREEN, URDF = (1.0, 0.0, 0.0, 1.0), (0.0, 0.5, 0.0, 0.25), (0.0, 0.0, 1.0, 1.0)
MTL = "newmtl red\nKd 1 0 0\nnewmtl green\nd 0.25\nKd 0 0.5 0\nnewmtl bare\nNs 10\n"
OBJ = """mtllib part.mtl
v 9 9 9
v 0 0 0
v 1 0 0
v 0 1 0
v 0 0 2
usemtl red
f 2 3 4
usemtl green
f 2/1 3/1/1 -1//1
f 2 3 4 5
usemtl {third}
f 3 4 5
"""


def dae(
    first: str = '<p>0 1 2</p>', kind: str = "triangles", nodes: str = "", unit: str = "0.5",
    diffuse: str = "<color>1 0 0 1</color>", name: str = "robot",
) -> str:
    """Two parts of a mesh: one as asked for, in red; one of a triangle, in green, a metre up."""
    effect = ('<effect id="{0}-effect"><profile_COMMON><technique><lambert><diffuse>{1}</diffuse>'
              "</lambert></technique></profile_COMMON></effect>")
    material = '<material id="{0}"><instance_effect url="#{0}-effect"/></material>'
    inputs = '<input semantic="VERTEX" source="#v" offset="0"/>'
    geometry = (
        '<geometry id="{0}"><mesh><source id="{0}-p">'
        '<float_array id="{0}-a" count="12">'
        '0 0 0 2 0 0 0 2 0 0 0 2</float_array><technique_common>'
        '<accessor source="#{0}-a" count="4" stride="3">'
        '<param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/>'
        '</accessor></technique_common></source><vertices id="v{0}"><input semantic="POSITION" '
        'source="#{0}-p"/></vertices><{1} material="m" count="1">{2}</{1}></mesh></geometry>')
    use = ('<instance_geometry url="#{0}"><bind_material><technique_common><instance_material '
           'symbol="m" target="#{1}"/></technique_common></bind_material></instance_geometry>')
    a = geometry.format("a", kind, inputs.replace("#v", "#va") + first)
    b = geometry.format("b", "triangles", inputs.replace("#v", "#vb") + "<p>0 1 2</p>")
    return (
        '<?xml version="1.0"?><COLLADA version="1.4.1" xmlns="http://www.collada.org/2005/11/COLLADASchema">'
        f'<asset><unit meter="{unit}"/><up_axis>Y_UP</up_axis></asset><library_effects>'
        f'{effect.format("red", diffuse)}{effect.format("green", "<color>0 0.5 0 0.25</color>")}'
        f'</library_effects><library_materials>{material.format("red")}{material.format("green")}'
        f"</library_materials><library_geometries>{a}{b}</library_geometries>"
        f'<library_nodes><node id="up"><translate>0 0 2</translate><rotate>0 0 1 90</rotate>'
        f'{use.format("b", "green")}</node></library_nodes><library_visual_scenes>'
        f'<visual_scene id="s"><node>{use.format("a", "red")}<node><scale>1 1 1</scale>'
        f'<instance_node url="#up"/>{nodes}</node></node></visual_scene></library_visual_scenes>'
        '<scene><instance_visual_scene url="#s"/></scene></COLLADA>')


@pytest.fixture
def load(tmp_path):
    def load(name: str, text: str, material: str = "", **files: str) -> sp.Mechanism:
        (tmp_path / name).write_text(text, encoding="utf-8")
        (tmp_path / "part.mtl").write_text(MTL, encoding="utf-8")
        path = tmp_path / "body.urdf"
        path.write_text(
            f'<robot name="body"><link name="g"/><link name="b"><visual><geometry><mesh '
            f'filename="{name}"/></geometry>{material}</visual></link><joint name="j" '
            'type="continuous"><parent link="g"/><child link="b"/></joint></robot>')
        return sp.load(path)

    return load


def parts(mechanism: sp.Mechanism) -> dict[tuple[float, ...], np.ndarray]:
    """What is drawn: triangles (M, 3, 3) by colour."""
    found = {}
    stage = SimpleNamespace(film=SimpleNamespace(mechanism=mechanism), size=1.0)
    for item in body_items(list(mechanism.visual_model.geometryObjects), stage):
        geometry = item.solid.geometry
        points, faces = np.array(geometry.vertices), np.array(geometry.faces)
        found[tuple(round(x, 6) for x in item.colour)] = points[faces]
    return found


OWN = tuple(round(x, 6) for x in BODY_COLOURS[0])


@pytest.mark.parametrize(("third", "last"), [("bare", OWN), ("gone", OWN), ("red", RED)])
def test_a_wavefront_mesh_has_the_colours_of_its_materials(load, third, last):
    drawn = parts(load("part.obj", OBJ.format(third=third)))
    assert set(drawn) == {RED, GREEN, last}
    assert drawn[RED][0].tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    assert drawn[GREEN].tolist() == [
        [[0, 0, 0], [1, 0, 0], [0, 0, 2]], [[0, 0, 0], [1, 0, 0], [0, 1, 0]],
        [[0, 0, 0], [0, 1, 0], [0, 0, 2]]]
    assert drawn[last][-1].tolist() == [[1, 0, 0], [0, 1, 0], [0, 0, 2]]


FACES = {
    "triangles": ("<p>0 1 2 0 2 3</p>", [[0, 1, 2], [0, 2, 3]]),
    "polylist": ("<vcount>3 4</vcount><p>0 1 2 0 1 2 3</p>",
                 [[0, 1, 2], [0, 1, 2], [0, 2, 3]]),
    "polygons": ("<p>0 1 2</p><p>0 1 2 3</p>", [[0, 1, 2], [0, 1, 2], [0, 2, 3]]),
    "trifans": ("<p>0 1 2 3</p>", [[0, 1, 2], [0, 2, 3]]),
    "tristrips": ("<p>0 1 2 3</p>", [[0, 1, 2], [3, 2, 1]]),
}


@pytest.mark.parametrize("kind", FACES)
def test_a_collada_mesh_has_the_colours_and_places_of_its_parts(load, kind):
    text, faces = FACES[kind]
    drawn = parts(load("part.dae", dae(text, kind)))
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])  # half of the file's
    assert drawn[RED].tolist() == corners[faces].tolist()
    np.testing.assert_allclose(drawn[GREEN], [[[0, 0, 1], [0, 1, 1], [-1, 0, 1]]], atol=1e-15)


@pytest.mark.parametrize("diffuse", ['<texture texture="t" texcoord="u"/>', ""])
def test_a_part_without_a_colour_has_the_one_of_its_body(load, diffuse):
    assert set(parts(load("part.dae", dae(diffuse=diffuse)))) == {OWN, GREEN}


COLOUR = '<material name="m"{}><color rgba="0 0 1 1"/></material>'


def test_colours_of_a_mesh_go_before_those_of_a_urdf_unless_it_overrides_them(load):
    assert set(parts(load("part.dae", dae(), COLOUR.format("")))) == {RED, GREEN}
    over = COLOUR.format(' override="true"')
    assert set(parts(load("part.dae", dae(), over))) == {URDF}
    bare = OBJ.format(third="red").replace("mtllib", "# mtllib")
    assert set(parts(load("bare.obj", bare, COLOUR.format("")))) == {URDF}


@pytest.mark.parametrize("bad", [
    dae(nodes='<instance_controller url="#a"/>'), dae(nodes="<lookat>0 0 1 0 0 0 0 1 0</lookat>"),
])
def test_what_is_not_understood_is_drawn_without_colours(load, bad):
    (colour,) = parts(load("part.dae", bad))
    assert colour == OWN


@pytest.mark.parametrize("bad", [
    dae(first="<p>0 1 99</p>"), dae(nodes='<instance_node url="#gone"/>', first="<p>0 1 9</p>"),
])
def test_what_cannot_be_is_omitted(load, bad):
    mechanism = load("part.dae", bad)
    with pytest.warns(sp.SpatialPinWarning, match=r"part\.dae.*cannot be read"):
        assert mechanism.visual_model.ngeoms == 0


def test_nodes_without_end_end(load):
    endless = dae().replace('<rotate>0 0 1 90</rotate>', '<instance_node url="#up"/>')
    mechanism = load("part.dae", endless)
    with pytest.warns(sp.SpatialPinWarning, match=r"part\.dae.*cannot be read"):
        assert mechanism.visual_model.ngeoms == 0


def test_colours_are_there_for_a_copy_sent_elsewhere_and_for_a_file_that_changed(load):
    mechanism = pickle.loads(pickle.dumps(load("part.obj", OBJ.format(third="red"))))
    assert set(parts(mechanism)) == {RED, GREEN}
    changed = OBJ.format(third="red").replace("usemtl green", "usemtl  red")
    assert set(parts(load("part.obj", changed))) == {RED}


def test_loading_and_moving_read_no_mesh(load, monkeypatch):
    monkeypatch.setattr(geometry, "read_meshes", None)
    monkeypatch.setattr(mesh_files, "fault", None)
    mechanism = load("part.obj", OBJ.format(third="red"))
    assert sp.assemble(mechanism).closure_error == 0.0


def test_a_page_has_the_colours(load):
    mechanism = load("part.dae", dae())
    commands = b"".join(scene(film(sp.assemble(mechanism))).commands)
    for red, green, blue in ((255, 0, 0), (0, 128, 0)):
        colour = (red << 16) + (green << 8) + blue
        assert umsgpack.packb({"color": colour})[1:] in commands
