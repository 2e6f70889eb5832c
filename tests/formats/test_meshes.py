"""Meshes are read when shapes are asked for, and a broken one ends nothing but its own reading."""

from __future__ import annotations

import copy
import pickle
import struct
import subprocess
import sys
from pathlib import Path

import coal
import numpy as np
import pytest

import spatial_pin as sp

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
FACES = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]


def stl() -> bytes:
    faces = [struct.pack("<12fH", 0, 0, 0, *CORNERS[list(face)].ravel(), 0) for face in FACES]
    return bytes(80) + struct.pack("<I", len(FACES)) + b"".join(faces)


def stl_text() -> bytes:
    faces = "".join("facet normal 0 0 0\nouter loop\n" + "".join(
        "vertex {} {} {}\n".format(*CORNERS[k]) for k in face) + "endloop\nendfacet\n"
        for face in FACES)
    return f"solid part\n{faces}endsolid part\n".encode()


def obj() -> bytes:
    return ("".join("v {} {} {}\n".format(*p) for p in CORNERS)
            + "".join("f {} {} {}\n".format(*(k + 1 for k in face)) for face in FACES)).encode()


def ply(points: int = len(CORNERS), faces: int = len(FACES), last: str = "3 1 2 3") -> bytes:
    rows = [*("{} {} {}".format(*p) for p in CORNERS), *(f"3 {a} {b} {c}" for a, b, c in FACES)]
    rows[-1] = last
    return (f"ply\nformat ascii 1.0\nelement vertex {points}\nproperty float x\nproperty float y\n"
            f"property float z\nelement face {faces}\nproperty list uchar int vertex_index\n"
            "end_header\n" + "\n".join(rows) + "\n").encode()


GOOD = {"part.stl": stl(), "text.STL": stl_text(), "part.obj": obj(), "part.ply": ply()}
SEEN = {  # what is seen to be no mesh by how it begins
    "empty.stl": b"", "short.stl": stl()[:-7], "words.stl": b"not a mesh", "words.ply": b"ply\n",
    "longer.ply": ply(points=10**9), "other.ply": obj(), "words.obj": b"not a mesh",
    "other.dae": obj(), "other.glb": obj(), "count.stl": bytes(80) + b"\xff" * 100,
}
BROKEN = {  # what only its reading shows
    "corner.ply": ply(last="3 1 2 999999999"), "below.ply": ply(last="3 1 2 -5"),
    "faces.ply": ply(faces=10**9),
    "nothing.ply": ply(faces=0), "corner.obj": obj() + b"f 1 2 99\n",
    "nan.obj": obj().replace(b"1.0", b"nan"), "half.glb": b"glTF" + bytes(9),
    "half.dae": b"<COLLADA", "some.xyz": b"not a mesh",
}


@pytest.fixture
def load(tmp_path):
    """Load a body of one sphere, one mesh and one box."""

    def load(name: str, content: bytes, kind: str = "visual") -> sp.Mechanism:
        (tmp_path / name).write_bytes(content)
        shapes = "".join(
            f'<{kind}><origin xyz="1 2 3"/><geometry>{shape}</geometry></{kind}>' for shape in (
                '<sphere radius="2"/>', f'<mesh filename="{name}" scale="1 2 -3"/>',
                '<box size="1 1 1"/>'))
        path = tmp_path / "body.urdf"
        path.write_text(f'<robot name="body"><link name="g">{shapes}</link></robot>')
        return sp.load(path)

    return load


def kinds(geometry) -> list[type]:
    return [type(shape.geometry) for shape in geometry.geometryObjects]


@pytest.mark.parametrize("kind", ["visual", "collision"])
@pytest.mark.parametrize("name", GOOD)
def test_a_mesh_has_its_points_its_scale_and_its_place_among_the_shapes(load, name, kind):
    mechanism = load(name, GOOD[name], kind)
    geometry = getattr(mechanism, f"{kind}_model")
    assert kinds(geometry) == [coal.Sphere, coal.BVHModelOBBRSS, coal.Box]
    shape = geometry.geometryObjects[1]
    points = {tuple(p) for p in shape.geometry.vertices().round(12)}
    assert points == {tuple(p) for p in CORNERS * [1, 2, -3]}
    assert shape.geometry.num_tris == len(FACES)
    assert shape.geometry.aabb_local.max_.tolist() == [1, 2, 0]
    assert shape.meshPath.endswith(name) and shape.meshScale.tolist() == [1, 2, -3]
    assert shape.placement.translation.tolist() == [1, 2, 3]
    assert not getattr(mechanism, "collision_model" if kind == "visual" else "visual_model").ngeoms


@pytest.mark.alike
@pytest.mark.parametrize("name", [*SEEN, *BROKEN])
def test_what_is_no_mesh_is_omitted_on_request(load, name):
    mechanism = load(name, {**SEEN, **BROKEN}[name])
    with pytest.warns(sp.SpatialPinWarning, match=rf"link 'g': mesh '{name}' cannot be read"):
        geometry = mechanism.visual_model
    assert kinds(geometry) == [coal.Sphere, coal.Box]
    assert mechanism.visual_model is geometry  # asked for once


def test_good_meshes_beside_a_broken_one_are_read(tmp_path):
    files = {**BROKEN, **SEEN, **GOOD}
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
    shapes = "".join(f'<visual><geometry><mesh filename="{name}"/></geometry></visual>'
                     for name in files)
    path = tmp_path / "body.urdf"
    path.write_text(f'<robot name="body"><link name="g">{shapes}</link></robot>')
    with pytest.warns(sp.SpatialPinWarning, match="cannot be read"):
        read = sp.load(path).visual_model.geometryObjects
    assert [Path(shape.meshPath).name for shape in read] == list(GOOD)


def test_shapes_not_yet_requested_are_copied_and_sent(load):
    mechanism = load("part.stl", stl())
    for other in (copy.deepcopy(mechanism), pickle.loads(pickle.dumps(mechanism)), mechanism):
        assert kinds(other.visual_model) == [coal.Sphere, coal.BVHModelOBBRSS, coal.Box]


@pytest.mark.slow
def test_a_picture_of_a_broken_mesh_does_not_end_the_interpreter(load, tmp_path):
    load("corner.ply", BROKEN["corner.ply"])
    code = ("import sys, warnings, spatial_pin as sp; warnings.simplefilter('ignore'); "
            "m = sp.load(sys.argv[1]); sp.export_html(sp.assemble(m), sys.argv[2])")
    page = tmp_path / "body.html"
    run = subprocess.run([sys.executable, "-c", code, str(tmp_path / "body.urdf"), str(page)],
                         check=False)
    assert run.returncode == 0 and page.stat().st_size > 0
