"""One rule for every file that a file of a mechanism names, whatever reads it.

Each reader has a case: a file that names another one by a path. That other one is read from below
the file's folder and from packages, and from elsewhere for who trusts; it is looked at before it is
opened. Where the mechanism moves without it, as with meshes, it is left out and told.
"""

import os
import struct

import numpy as np
import pytest

import spatial_pin as sp
from spatial_pin.formats.importers import IMPORTERS

pytestmark = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes on this system")
LINK = '<robot name="m"><link name="base"/>{}</robot>'
XACRO = '<robot name="m" xmlns:xacro="http://www.ros.org/wiki/xacro"><link name="base"/>{}</robot>'
CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
STL = bytes(80) + struct.pack("<I", 4) + b"".join(
    struct.pack("<12fH", 0, 0, 0, *CORNERS[list(face)].ravel(), 0)
    for face in ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)))
TOML = 'name = "m"\ntree = "{name}"\n'
SDF = ('<sdf version="1.9"><model name="m"><link name="base"><inertial><mass>1</mass>'
       '</inertial><visual name="v"><geometry><mesh><uri>'
       "{name}</uri></mesh></geometry></visual></link><joint name='j' type='fixed'><parent>world"
       "</parent><child>base</child></joint></model></sdf>")
BODY = '<body name="b"><joint name="j"/><geom size=".1"/>{}</body>'
MJCF = "<mujoco>{}<worldbody>{}</worldbody></mujoco>"
MESH = ('<asset><mesh name="part" file="{name}"/></asset>',
        BODY.format('<geom type="mesh" mesh="part"/>'))
USDA = '#usda 1.0\n(\n    metersPerUnit = 1\n{layer})\n{prim}'
ARM = ('def Xform "a" (prepend apiSchemas = ["PhysicsRigidBodyAPI"]) {{}}\n'
       'def PhysicsRevoluteJoint "j" {{\n    rel physics:body1 = <{root}/a>\n}}\n')
ROBOT = ('#usda 1.0\n(\n    defaultPrim = "robot"\n    metersPerUnit = 1\n)\n'
         'def Xform "robot" {\n' + ARM.format(root="/robot") + "}\n")
LAYER = "#usda 1.0\n(\n    metersPerUnit = 1\n)\n" + ARM.format(root="")
OUTSIDE = "nor in an installed package"

# "importer: what is named": the file, its text with {name}, what is named, whether it is needed
CASES = {
    "urdf: a mechanism file's tree": ("m.toml", TOML, ("part.urdf", LINK.format("")), True),
    "urdf: a xacro's include": (
        "m.urdf.xacro", XACRO.format('<xacro:include filename="{name}"/>'),
        ("part.xacro", XACRO.format("").replace('<link name="base"/>', "")), True),
    "urdf: a xacro's table": (
        "m.urdf.xacro", XACRO.format('<xacro:property name="x" '
                                     'value="${{xacro.load_yaml(\'{name}\').x}}"/>'
                                     '<link name="l_${{x}}"/><joint name="f" type="fixed">'
                                     '<parent link="base"/><child link="l_${{x}}"/></joint>'),
        ("part.yaml", "x: 1"), True),
    "urdf: a mesh": (
        "m.urdf", LINK.format("").replace(
            "/>", '><visual><geometry><mesh filename="{name}"/></geometry></visual></link>', 1),
        ("part.stl", STL), False),
    "sdf: a mesh": ("m.sdf", SDF, ("part.stl", STL), False),
    "mjcf: an include": (
        "m.xml", MJCF.format("", BODY.format("") + '<include file="{name}"/>'),
        ("part.xml", "<mujoco>" + BODY.format("").replace('"b"', '"c"').replace('"j"', '"k"')
         + "</mujoco>"), True),
    "mjcf: a model": (
        "m.xml", MJCF.format('<asset><model name="arm" file="{name}"/></asset>',
                             BODY.format("") + '<attach model="arm" body="c" prefix="x"/>'),
        ("part.xml", MJCF.format("", BODY.format("").replace('"b"', '"c"').replace('"j"', '"k"'))),
        True),
    "mjcf: a mesh": ("m.xml", MJCF.format(*MESH), ("part.stl", STL), False),
    "usd: a reference": (
        "m.usda", USDA.format(layer="", prim='def Xform "r" (references = @{name}@) {{}}\n'),
        ("part.usda", ROBOT), True),
    "usd: a payload": (
        "m.usda", USDA.format(layer="", prim='def Xform "r" (payload = @{name}@) {{}}\n'),
        ("part.usda", ROBOT), True),
    "usd: a sublayer": (
        "m.usda", USDA.format(layer="    subLayers = [@{name}@]\n", prim=""),
        ("part.usda", LAYER), True),
    "statement: a robot": (
        "robot.yaml", "closed_loop: []\nurdf: {name}\n", ("part.urdf", LINK.format("")), True),
    "folder: a robot": (
        "own/robot.yaml", "closed_loop: []\nurdf: {name}\n", ("part.urdf", LINK.format("")), True),
}
NEEDS = {"mjcf": "mujoco", "usd": "pxr"}
OTHERS = {  # what is there in place of the file that is named
    "a pipe": os.mkfifo, "a folder": os.mkdir,
    "a device": lambda path: os.symlink("/dev/zero", path),
}


class Files:
    """A file in a folder of its own that names another."""

    def __init__(self, root, case):
        self.importer = case.partition(":")[0]
        if self.importer in NEEDS:
            pytest.importorskip(NEEDS[self.importer])
        name, self.text, (self.part, self.content), self.is_needed = CASES[case]
        self.root, self.path = root, root / "own" / name.removeprefix("own/")
        (root / "own").mkdir()
        (root / "far").mkdir()
        if self.importer == "folder":
            (root / "own" / "decoy.urdf").write_text(LINK.format(""))

    def put(self, *folder):
        """Write the file that is named into a folder; return it."""
        path = self.root.joinpath(*folder, self.part)
        path.parent.mkdir(exist_ok=True, parents=True)
        content = self.content
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    def load(self, name, **options):
        """Load the file that names another by a name."""
        self.path.write_text(self.text.format(name=name))
        return sp.load(self.path.parent if self.importer == "folder" else self.path, **options)

    def is_read(self, name, **options):
        """It is loaded without a word; what is named is there."""
        mech = self.load(name, **options)
        assert self.is_needed or mech.visual_model.ngeoms == self.shapes(mech)

    def shapes(self, mech):
        return 2 if self.importer == "mjcf" else 1

    def is_barred(self, name, says=OUTSIDE):
        """It is refused, or loaded without what is named, and told."""
        if self.is_needed:
            with pytest.raises(sp.MechanismFileError, match=says):
                self.load(name)
            return
        with pytest.warns(sp.SpatialPinWarning, match=says):
            mech = self.load(name)
        assert mech.visual_model.ngeoms == self.shapes(mech) - 1


@pytest.fixture(params=CASES)
def files(request, tmp_path):
    return Files(tmp_path, request.param)


def test_every_importer_that_can_name_files_has_a_case():
    assert {case.partition(":")[0] for case in CASES} == IMPORTERS.keys()


@pytest.mark.alike
@pytest.mark.parametrize("name", ["{part}", "./{part}", "inner/{part}", "../own/{part}"])
def test_what_lies_below_the_folder_is_read(files, name):
    files.put("own", *name.split("/")[:-1][-1:]) if "inner" in name else files.put("own")
    files.is_read(name.format(part=files.part))


@pytest.mark.alike
@pytest.mark.parametrize("how", ["upwards", "absolute", "by a link", "by a linked folder"])
def test_what_lies_elsewhere_is_read_for_who_trusts(files, how):
    far = files.put("far")
    name = {"upwards": f"../far/{far.name}", "absolute": str(far), "by a link": far.name,
            "by a linked folder": f"linked/{far.name}"}[how]
    if how == "by a link":
        (files.root / "own" / far.name).symlink_to(far)
    if how == "by a linked folder":
        (files.root / "own" / "linked").symlink_to(far.parent)
    files.is_barred(name)
    files.is_read(name, trusted=True)


@pytest.mark.alike
def test_what_lies_in_a_package_is_read(files, monkeypatch):
    far = files.put("far")
    (far.parent / "package.xml").write_text("<package><name>far</name></package>")
    files.is_read(f"../far/{far.name}")
    (far.parent / "package.xml").unlink()
    files.is_barred(f"../far/{far.name}")
    if files.importer != "statement":  # whose files are found before the packages are known
        files.is_read(f"../far/{far.name}", packages={"far": far.parent})
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(files.root))
    files.is_read(f"../far/{far.name}")


@pytest.mark.parametrize("kind", OTHERS)
@pytest.mark.parametrize("trusted", [False, True])
def test_what_is_no_plain_file_is_not_waited_for(files, kind, trusted):
    OTHERS[kind](files.root / "own" / files.part)
    if not files.is_needed:
        with pytest.warns(sp.SpatialPinWarning):
            mech = files.load(files.part, trusted=trusted)
            assert mech.visual_model.ngeoms == files.shapes(mech) - 1
        return
    with pytest.raises(sp.MechanismFileError):
        files.load(files.part, trusted=trusted)


def test_what_is_too_large_is_not_opened(files, monkeypatch):
    part = files.put("own")
    with part.open("ab") as stream:
        stream.truncate(200_000_000)  # a hole, which takes no room
    if files.is_needed:
        with pytest.raises(sp.MechanismFileError, match="200,000,000 bytes"):
            files.load(files.part)
    else:
        with pytest.warns(sp.SpatialPinWarning, match="too large|200,000,000 bytes"):
            files.load(files.part)


# ---------------------------------------------------------------- what else a file can name


def written(folder, name, content):
    (folder / name).parent.mkdir(exist_ok=True, parents=True)
    (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    return folder / name


@pytest.mark.parametrize("text", [
    MJCF.format("", BODY.format("") + '<flexcomp name="f" type="mesh" file="../far/part.stl"/>'),
    MJCF.format('<extension><plugin plugin="p"><instance name="i"><config key="table" '
                'value="/etc/passwd"/></instance></plugin></extension>', BODY.format("")),
    MJCF.format("<asset/>", '<include file="../far/part.xml"/>') + "&",
    MJCF.format('<asset><model name="arm" file="../../../etc/passwd"/></asset>', BODY.format("")),
])
def test_what_mujoco_opens_as_it_reads_is_looked_at_before(text, tmp_path):
    pytest.importorskip("mujoco")
    written(tmp_path, "far/part.stl", STL)
    with pytest.raises(sp.MechanismFileError, match=rf"{OUTSIDE}|not well-formed"):
        sp.load(written(tmp_path, "own/m.xml", text))


def test_textures_skins_and_height_fields_of_mujoco_are_never_opened(tmp_path):
    pytest.importorskip("mujoco")
    for name in ("t.png", "s.skn", "h.png"):
        (tmp_path / name).symlink_to("/dev/zero")
    path = written(tmp_path, "m.xml", MJCF.format(
        '<asset><texture name="t" type="2d" file="t.png"/><material name="m" texture="t"/><hfield '
        'name="h" file="h.png" size="1 1 1 1"/></asset>',
        BODY.format('<geom size=".1" material="m"/>') + '<geom type="hfield" hfield="h"/>'))
    with pytest.warns(sp.SpatialPinWarning, match="height field 'h' is left out"):
        assert sp.load(path).coordinates == ("j",)


def test_an_inertia_from_a_mesh_elsewhere_is_not_known_and_reported(tmp_path):
    pytest.importorskip("mujoco")
    far = written(tmp_path, "far/part.stl", STL)
    text = MJCF.format(f'<asset><mesh name="part" file="{far}"/></asset>',
                       '<body name="b"><joint/><geom type="mesh" mesh="part"/></body>')
    with pytest.warns(sp.SpatialPinWarning, match=r"of bodies \(b\) comes from mesh files "
                                                  r"that are not read"):
        assert "b" not in sp.load(written(tmp_path, "own/m.xml", text)).inertias


def test_layers_of_layers_and_of_variants_are_looked_at_before_usd_opens_them(tmp_path):
    pytest.importorskip("pxr")
    os.mkfifo(tmp_path / "pipe.usda")
    inner = USDA.format(layer="", prim='def Xform "r" (references = @pipe.usda@) {}\n')
    variant = USDA.format(layer="", prim=(
        'def Xform "r" (\n    variants = {\n        string v = "a"\n    }\n'
        '    prepend variantSets = "v"\n) {\n    variantSet "v" = {\n        "a" {\n        }\n'
        '        "b" (\n            references = @pipe.usda@\n        ) {\n        }\n    }\n}\n'))
    clips = USDA.format(layer="", prim=(
        'def Xform "r" (\n    clips = {\n        dictionary default = {\n            asset[] '
        'assetPaths = [@pipe.usda@]\n            string primPath = "/r"\n        }\n    }\n) {\n}'
        "\n"))
    written(tmp_path, "inner.usda", inner)
    outer = USDA.format(layer="    subLayers = [@inner.usda@]\n", prim="")
    for text in (outer, variant, clips):
        with pytest.raises(sp.MechanismFileError, match="is a pipe, socket or device"):
            sp.load(written(tmp_path, "m.usda", text))


def test_names_of_layers_that_are_worked_out_are_for_who_trusts(tmp_path):
    pytest.importorskip("pxr")
    text = USDA.format(layer='    expressionVariables = { string V = "part" }\n',
                       prim='def Xform "r" (references = @`"./${V}.usda"`@) {}\n')
    written(tmp_path, "part.usda", ROBOT)
    path = written(tmp_path, "m.usda", text)
    with pytest.raises(sp.MechanismFileError, match=r"a name that is worked out; .*trusted=True"):
        sp.load(path)
    assert sp.load(path, trusted=True).coordinates == ("j",)


# ---------------------------------------------------------------- parts of meshes

OBJ = "mtllib {}\nusemtl red\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
MTL = "newmtl red\nKd 1 0 0\n"


def drawn(folder, name, content):
    """The mechanism with a mesh as its one shape."""
    written(folder, name, content)
    text = LINK.format("").replace(
        "/>", f'><visual><geometry><mesh filename="{name}"/></geometry></visual></link>', 1)
    return sp.load(written(folder, "m.urdf", text))


def colours(mech):
    from spatial_pin.formats.mesh_files import mesh_colours

    path = mech.visual_model.geometryObjects[0].meshPath
    return [colour for _, colour in mesh_colours(path)]


@pytest.mark.parametrize(("name", "is_read"), [
    ("part.mtl", True), ("../far/part.mtl", False), ("linked.mtl", False), ("pipe.mtl", False),
    ("inner/part.mtl", True)])
def test_materials_of_a_mesh_are_read_from_its_folder_only(name, is_read, tmp_path):
    own = tmp_path / "own"
    for folder in ("own", "own/inner", "far"):
        written(tmp_path, f"{folder}/part.mtl", MTL)
    (own / "linked.mtl").symlink_to(tmp_path / "far" / "part.mtl")
    os.mkfifo(own / "pipe.mtl")
    mech = drawn(own, "part.obj", OBJ.format(name))
    assert colours(mech) == [(1.0, 0.0, 0.0, 1.0) if is_read else None]


@pytest.mark.parametrize("text", [OBJ.format("pipe.mtl") + "v 1 1 1 \\\n\nf 1 2 4\n",
                                  "o a\rmtllib pipe.mtl\r" + OBJ.format("x") + "curv \\\n 1\n"])
def test_a_mesh_that_another_reader_is_given_names_no_materials(text, tmp_path):
    """That reader would wait for the pipe."""
    os.mkfifo(tmp_path / "pipe.mtl")
    assert drawn(tmp_path, "part.obj", text).visual_model.ngeoms == 1


GLTF = ('{{"asset": {{"version": "2.0"}}, "buffers": [{{"byteLength": 36, {0}}}], "bufferViews": '
        '[{{"buffer": 0, "byteLength": 36}}], "accessors": [{{"bufferView": 0, "componentType": '
        '5126, "count": 3, "type": "VEC3", "min": [0,0,0], "max": [1,1,0]}}], "meshes": '
        '[{{"primitives": [{{"attributes": {{"POSITION": 0}}}}]}}], "nodes": [{{"mesh": 0}}], '
        '"scenes": [{{"nodes": [0]}}], "scene": 0}}')


@pytest.mark.parametrize(("uri", "is_read"), [
    ('"uri": "part.bin"', True), ('"uri": "../far/part.bin"', False), ('"uri": "pipe.bin"', False),
    ('"\\u0075ri": "\\u002e\\u002e/far/part.bin"', False),
    ('"uri": "..%2Ffar%2Fpart.bin"', False),
    ('"uri": "../far/part.bin", "uri": "part.bin"', False), ('"uri": "gone.bin"', False)])
def test_buffers_of_a_mesh_are_read_from_its_folder_only(uri, is_read, tmp_path):
    own = tmp_path / "own"
    for folder in ("own", "far"):
        written(tmp_path, f"{folder}/part.bin", struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0))
    os.mkfifo(own / "pipe.bin")
    mech = drawn(own, "part.gltf", GLTF.format(uri))
    if is_read:
        assert mech.visual_model.ngeoms == 1
        return
    with pytest.warns(sp.SpatialPinWarning, match="is no file in its folder"):
        assert mech.visual_model.ngeoms == 0


def test_formats_of_meshes_that_may_name_anything_are_not_read(tmp_path):
    with pytest.warns(sp.SpatialPinWarning, match=r"\.lws is no format of meshes that is read"):
        assert drawn(tmp_path, "part.lws", "LWSC\n3\n").visual_model.ngeoms == 0


def test_a_saved_folder_holds_no_file_that_a_mesh_links_to(tmp_path):
    secret = written(tmp_path, "far/secret.mtl", "secret")
    own = tmp_path / "own"
    own.mkdir()
    (own / "linked.mtl").symlink_to(secret)
    drawn(own, "part.obj", OBJ.format("linked.mtl")).save(tmp_path / "out")
    assert [p.name for p in (tmp_path / "out").rglob("*.*") if p.suffix in (".obj", ".mtl")] == [
        "part.obj"]


# ---------------------------------------------------------------- what is beside a file


@pytest.mark.parametrize(("name", "key"), [
    ("robot.yaml", "closed_loop"), ("loop_closures.yaml", "closures"), ("m.yaml", "closed_loop")])
def test_a_statement_beside_a_robot_is_read_from_its_folder_only(name, key, tmp_path):
    far = written(tmp_path, f"far/{name}", f"{key}: [3]\n")
    path = written(tmp_path, "own/m.urdf", LINK.format(""))
    (path.parent / name).symlink_to(far)
    assert sp.load(path).links == ("base",)  # the link to elsewhere is as if it were not there
    (path.parent / name).unlink()
    written(tmp_path, f"own/{name}", far.read_text())
    with pytest.raises(sp.MechanismFileError, match=rf"{key}\[0\]"):
        sp.load(path)


def test_a_robot_of_a_folder_lies_in_it(tmp_path):
    far = written(tmp_path, "far/m.urdf", LINK.format(""))
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "m.urdf").symlink_to(far)
    with pytest.raises(sp.MechanismFileError, match="there is no URDF in this folder"):
        sp.load(tmp_path / "own")


# ---------------------------------------------------------------- the environment


@pytest.mark.parametrize(("command", "says"), [
    ("$(env SECRET)", "environment variables are not for files of others; .*trusted=True"),
    ("$(env NOBODY_HAS_IT)", "environment variables are not for files of others"),
    ("$(cwd)", "the working folder is not for files of others; .*trusted=True"),
    ("${xacro.load_yaml('$(env SECRET)')}", "environment variables are not for files of others")])
def test_a_file_of_others_learns_nothing_of_the_environment(command, says, tmp_path, monkeypatch):
    monkeypatch.setenv("SECRET", "classified")
    (tmp_path / "nowhere").mkdir()
    monkeypatch.chdir(tmp_path / "nowhere")
    text = XACRO.format(f'<link name="{command}"/>')
    with pytest.raises(sp.MechanismFileError, match=says) as failure:
        sp.load(written(tmp_path, "m.urdf.xacro", text))
    assert "classified" not in str(failure.value) and "nowhere" not in str(failure.value)


def test_a_default_goes_before_the_environment_for_a_file_of_others(tmp_path, monkeypatch):
    joint = '<joint name="f" type="fixed"><parent link="base"/><child link="{0}"/></joint>'
    name = "$(optenv SIDE left)"
    path = written(tmp_path, "m.urdf.xacro", XACRO.format(f'<link name="{name}"/>'
                                                          + joint.format(name)))
    monkeypatch.delenv("SIDE", raising=False)
    assert sp.load(path).links == ("base", "left")
    monkeypatch.setenv("SIDE", "secret")
    with pytest.warns(sp.SpatialPinWarning, match=r"\$\(optenv SIDE\) is its default here, 'left'"):
        assert sp.load(path).links == ("base", "left")
    assert sp.load(path, trusted=True).links == ("base", "secret")


def test_a_guess_of_others_learns_nothing_of_the_environment(tmp_path, monkeypatch):
    monkeypatch.setenv("SECRET", "7")
    written(tmp_path, "m.urdf", LINK.format(
        '<link name="a"/><joint name="j" type="continuous"><parent link="base"/><child link="a"/>'
        "</joint>"))
    path = written(tmp_path, "m.toml", TOML.format(name="m.urdf") + '[guess]\nj = "$(env SECRET)"')
    with pytest.raises(sp.MechanismFileError, match="not for files of others") as failure:
        sp.load(path)
    assert "7" not in str(failure.value).partition("m.toml")[2]
    assert sp.load(path, trusted=True).guess["j"] == 7.0


def test_an_error_reads_no_file_that_may_not_be_read(tmp_path):
    """Arguments are looked for in the tree's file only where that may be read."""
    far = written(tmp_path, "far/m.xacro", XACRO.format('<xacro:arg name="hidden" default=""/>'))
    path = written(tmp_path, "own/m.toml", TOML.format(name=f"../far/{far.name}"))
    with pytest.raises(sp.MechanismFileError, match=OUTSIDE) as failure:
        sp.load(path)
    assert "hidden" not in str(failure.value)


def test_what_the_library_ships_is_read_from_anywhere(tmp_path):
    text = XACRO.format('<xacro:include filename="$(find spatial_pin)/parts.xacro"/>')
    assert sp.load(written(tmp_path, "m.urdf.xacro", text)).links == ("base",)
    np.testing.assert_array_equal(sp.load("rssr").neutral[:1], [0.0])
