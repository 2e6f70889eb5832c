"""Commands that look at mechanisms and their files: new, list, info, check, export."""

from __future__ import annotations

import contextlib
import os
import re
import textwrap
import warnings
from collections.abc import Iterable
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

import spatial_pin as sp
from spatial_pin._support.brief import counted
from spatial_pin._support.output_files import write_text
from spatial_pin.cli import options as opt
from spatial_pin.cli.completion import SHELLS
from spatial_pin.cli.mechanism_arguments import Options
from spatial_pin.cli.printing import WIDTH, on_screen, print_result, say
from spatial_pin.dynamics.coupling_forces import coupling_forces
from spatial_pin.errors import SpatialPinError
from spatial_pin.formats.file_access import toml_text
from spatial_pin.formats.files import library_titles
from spatial_pin.formats.mechanism_writer import export_urdf, robot_of
from spatial_pin.mechanism.coordinates import coordinates_of
from spatial_pin.mechanism.joint_limits import joint_limits
from spatial_pin.mechanism.pairs import COUPLING
from spatial_pin.mobility.mobility import driver_advice
from spatial_pin.motion.report import info as info_of
from spatial_pin.operators import OPERATORS

FRAMES, JOINTS = "frames", "joints"
CLOSURES = {  # of an example of each kind: a comment, its needs, further keys
    "spherical": ("a ball", FRAMES, ""),
    "revolute": ("a hinge; axis is z of both frames unless it is given", FRAMES,
                 "axis = [0, 0, 1]"),
    "prismatic": ("a slide along the axis, which does not turn", FRAMES, "axis = [0, 0, 1]"),
    "cylindrical": ("slides along the axis and turns about it", FRAMES, "axis = [0, 0, 1]"),
    "screw": ("turns by 2 pi while it slides by the lead [m]", FRAMES, "lead = 0.01"),
    "universal": ("two crossed pins, the first in frame 1, the second in frame 2", FRAMES,
                  "axis = [1, 0, 0]\naxis2 = [0, 1, 0]"),
    "planar": ("slides and turns in the plane normal to the axis", FRAMES, "axis = [0, 0, 1]"),
    "weld": ("both frames coincide", FRAMES, ""),
    "distance": ("a rod with balls at both ends [m]", FRAMES, "length = 0.2"),
    "point_on_line": ("the second frame's origin on the axis of the first", FRAMES,
                      "axis = [0, 0, 1]"),
    "point_on_plane": ("the second frame's origin in the plane normal to the axis", FRAMES,
                       "axis = [0, 0, 1]"),
    "parallel": ("both axes stay parallel", FRAMES, "axis = [0, 0, 1]"),
    "perpendicular": ("an axis of frame 1 normal to one of frame 2", FRAMES,
                      "axis = [0, 0, 1]\naxis2 = [0, 0, 1]"),
    "point_on_curve": ("the second frame's origin on a curve that the first carries", FRAMES,
                       "curve = \"my_curve\"\n[curves.my_curve]\ncircle = {radius = 0.05}"),
    "frame_on_curve": ("likewise, and its z along the tangent: a carriage on a track", FRAMES,
                       "curve = \"my_track\"\n[curves.my_track]\n"
                       "helix = {radius = 0.2, lead = 0.1}"),
    "curve_on_curve": ("two profiles that touch in their plane", FRAMES,
                       "curves = [\"my_oval\", \"my_wheel\"]\n[curves.my_oval]\n"
                       "ellipse = {semi_axes = [0.05, 0.03]}\n[curves.my_wheel]\n"
                       "circle = {radius = 0.04}"),
    "cam": ("a cam and its follower, in the plane of the cam", FRAMES,
            "curve = \"my_cam\"\nfollower = {roller = 0.008}\n[curves.my_cam]\n"
            "ellipse = {semi_axes = [0.05, 0.03]}"),
    "rope": ("over points without size: the sum of their distances is the length [m]", FRAMES,
             "length = 0.5"),
    COUPLING: ("gears, rack and pinion: second = ratio * first + offset", JOINTS, "ratio = -2.0"),
}
WORD = 20  # letters of a column of names, at least


def write_from(name: str, tree: Path, folder: Path, mechanism: sp.Mechanism) -> list[Path]:
    """Write a mechanism file for the tree that the mechanism was loaded from."""
    if tree.suffix == ".toml" or tree.is_dir():
        kind = "a folder" if tree.is_dir() else "a mechanism file"
        raise SpatialPinError(f"{tree} is {kind}, which is loaded as it is; `spatial-pin export "
                              f"{mechanism.name} --folder {name}` makes a copy to edit")
    path = folder / f"{name}.toml"
    _refuse_existing([path])
    tree_path = Path(os.path.relpath(tree.resolve(), folder.resolve())).as_posix()
    title = {"title": mechanism.title} if mechanism.title else {}
    parts = [HEAD + toml_text({"name": name, **title, "tree": tree_path}),
             _joints(mechanism), _closures(mechanism), _drivers(mechanism),
             MORE.format(link=_ends(mechanism)[0], joint=[*mechanism.model.names, "joint"][1]),
             _guess(mechanism)]
    return [write_text(path, "\n".join(part for part in parts if part))]


def write_new(name: str, folder: Path, drawing: bool = False) -> list[Path]:
    """Write a four-bar to start from: a mechanism file and its tree, or a drawing."""
    start = files("spatial_pin.cli").joinpath("templates")
    templates = {".toml": "DRAWING.toml"} if drawing else {
        suffix: f"NAME{suffix}" for suffix in (".toml", ".urdf.xacro")}
    texts = {folder / f"{name}{suffix}": start.joinpath(file).read_text("utf-8").replace(
        "NAME", name) for suffix, file in templates.items()}
    _refuse_existing(texts)
    return [write_text(path, text) for path, text in texts.items()]


def _refuse_existing(paths: Iterable[Path]) -> None:
    for path in paths:
        if path.exists():
            raise SpatialPinError(f"{path} is there already; choose another name, or another "
                                  "--folder")


# ---------------------------------------------------------------- of a tree that there is


def _joints(mechanism: sp.Mechanism) -> str:
    """Return the tree's joints as comments: their links and limits."""
    ends = {joint.get("name"): [
        "" if (end := joint.find(key)) is None else end.get("link", "") for key in (
            "parent", "child")] for joint in robot_of(mechanism).findall("joint")}
    bounds: dict[str, list[str]] = {}
    for limit in joint_limits(mechanism):
        bounds.setdefault(limit.name, ["", ""])[limit.side > 0] = f"{limit.value:.6g}"
    lines = ["# Joints of the tree, and the links they join:"]
    for joint, pair in zip(list(mechanism.model.names)[1:], mechanism.pairs, strict=True):
        where = " - ".join(ends.get(joint, ()))
        limits = " to ".join(x or "any" for x in bounds.get(joint, ()))
        unit = next((c.unit for c in coordinates_of(mechanism, joint)), "")
        text = f"#   {joint:{WORD}}  {pair:11}  {where}"
        lines.append(f"{text}  ({limits} {unit})" if limits else text.rstrip())
    return "\n".join(lines) + "\n"


def _closures(mechanism: sp.Mechanism) -> str:
    """Return the tree's own loops, and an example of every kind of closure, as comments."""
    lines = ["# Loops: each closure joins two frames of different bodies. Links and frames: "
             "`spatial-pin info`."]
    for closure in mechanism.closures:
        joined = " - ".join(closure.frames or closure.joints)
        lines.append(f"#   stated in the tree already: {closure.name}, {closure.type}: {joined}")
    lines.append("# Take the lines of one kind, without their first two letters:")
    frames = _ends(mechanism)
    joints = [c.name for c in mechanism.coordinate_table.values() if c.q >= 0][:2]
    for kind, (words, needs, more) in CLOSURES.items():
        names = frames if needs == FRAMES else joints
        if len(names) < 2:
            continue
        entry = toml_text({"name": f"my_{kind}", "type": kind, needs: list(names)}) + more
        lines += ["#", f"# # {kind}: {words}", "# [[closures]]",
                  *(f"# {line}" for line in entry.strip().splitlines())]
    return "\n".join(lines) + "\n"


def _ends(mechanism: sp.Mechanism) -> tuple[str, ...]:
    """Return two links of different bodies: the last of the tree, and its root."""
    body = {link: mechanism.frame_on_joint(link)[0] for link in mechanism.links}
    last = max(reversed(body), key=lambda link: body[link])
    return (last,) if body[last] == 0 else (last, min(body, key=lambda link: body[link]))


def _drivers(mechanism: sp.Mechanism) -> str:
    """Return the first driver, and others as comments."""
    lines = ["# Drivers: as many as the closed mechanism has freedoms (`spatial-pin check`)."]
    drivers = list(mechanism.drivers.values()) or [
        sp.Driver(c.name, c.name) for c in mechanism.coordinate_table.values() if c.q >= 0][:1]
    keep_all = bool(mechanism.closures)  # which drivers move its loops is stated with them
    for k, driver in enumerate(drivers):
        text = toml_text({"drivers": {driver.name: {"joint": driver.joint}}}).strip()
        lines += [line if k == 0 or keep_all else f"# {line}" for line in text.splitlines()]
    return "\n".join(lines) + "\n" if drivers else ""


def _guess(mechanism: sp.Mechanism) -> str:
    """Return the values of the joints with one freedom."""
    state = None
    for limits in (True, False):  # within the joint limits where there is such a configuration
        with contextlib.suppress(sp.AssemblyError), warnings.catch_warnings():
            warnings.simplefilter("ignore", sp.SpatialPinWarning)
            state = sp.assemble(mechanism, limits=limits)
            break
    if state is None:
        return ""
    values = {}
    for c in mechanism.coordinate_table.values():
        if c.name == c.joint and c.q >= 0:
            value = float(np.round(state.coordinate(c.name).value, 6))
            values[c.name] = value + 0.0
    head = "# A rough configuration on the wanted branch [rad, m].\n"
    return head + toml_text({"guess": values}).lstrip() if values else ""


HEAD = """\
# Metres, radians, kilograms. Keys of the top come before the first [table].
# `spatial-pin check FILE` lists mistakes, `spatial-pin show FILE` shows it.
"""
MORE = """\
# More keys that are possible; without the first two letters of its lines it holds:
#
# [joints.{joint}]
# damping = 0.01                  # N·m·s/rad or N·s/m; also friction, armature, lower, upper
#
# [frames.tool]                   # a point that the tree does not have
# link = "{link}"
# xyz = [0.0, 0.0, 0.1]
#
# [[springs]]
# name = "return"
# joint = "{joint}"
# stiffness = 10.0                # N·m/rad or N/m
"""


def list_library(options: Options) -> None:
    """Mechanisms and operators of the library, with their sources."""
    heads = ("name", "title", "source")
    rows = [(name, *words) for name, words in library_titles().items()]
    operators = [(name, *words) for name, words in OPERATORS.items()]
    width = max(len(name) for name, _, _ in (*rows, *operators))
    lines = [*(_line(width, *row) for row in rows), "", "in spatial_pin.operators:",
             *(_line(width, *row) for row in operators)]
    print_result(options, "\n".join(lines), [dict(zip(heads, row, strict=True)) for row in rows],
                 dict(zip(heads, zip(*rows, strict=True), strict=True)))


def _line(width: int, name: str, title: str, source: str) -> str:
    """Return a line of the list that fits the screen; `info` has the whole source."""
    text = f"{title} ({source})" if source else title
    return f"{name:{width}}  {textwrap.shorten(text, WIDTH - width - 2, placeholder=' ...')}"


def info(options: Options) -> None:
    """Links, joints, closures, coordinates and freedoms."""
    report = info_of(options.loaded)
    rows: list[tuple[str, str, str]] = [("link", name, "") for name in report.links]
    for kind, parts in (
        ("dimension", report.dimensions), ("joint", report.joints), ("closure", report.closures),
        ("coordinate", report.coordinates), ("frame", report.frames), ("driver", report.drivers),
        ("spring", report.springs), ("resistance", report.resistances),
    ):
        content: dict[str, Any] = dict(parts)
        rows += [(kind, name, x if isinstance(x, str) else repr(x)) for name, x in content.items()]
    columns = map(list, zip(*rows, strict=True))
    print_result(options, report, report.as_dict(),
                 dict(zip(("part", "name", "what"), columns, strict=True)))


def check(options: Options) -> None:
    """Read a mechanism file and print its mistakes."""
    try:
        mechanism = options.loaded
        notes = list(mechanism.notices)
        state = sp.assemble(mechanism)
        coupling_forces(mechanism)  # refused here where teeth do not mesh
        result = sp.mobility(mechanism, state)
        working = result.dof - len(result.passive)
        lines = [f"note: {notice}" for notice in notes]
        lines.append(f"{mechanism.path}: good: {counted(len(mechanism.links), 'link')}, "
                     f"{counted(len(mechanism.coordinates), 'coordinate')}, "
                     f"{counted(len(mechanism.closures), 'closure')}; "
                     f"the guess closes to {state.closure_error:.1e}")
        note = driver_advice(state, result)
        if note:
            notes.append(note)
            lines.append(f"note: {note}:\n{result}")
        content = {"file": str(mechanism.path), "good": True, "mistakes": [], "notes": notes,
                   "links": len(mechanism.links), "coordinates": len(mechanism.coordinates),
                   "closures": len(mechanism.closures), "drivers": len(mechanism.drivers),
                   "working_freedoms": working, "closure_error": state.closure_error}
    except sp.SpatialPinError as error:
        mistakes = list(getattr(error, "mistakes", ())) or [str(error)]
        content = {"file": str(options.mechanism), "good": False, "mistakes": mistakes, "notes": []}
        print_result(options, "", content, _faults(content))
        raise
    print_result(options, "\n".join(lines), content, _faults(content))


def _faults(content: dict[str, Any]) -> dict[str, list[str]]:
    """Return mistakes and notes, one a row."""
    rows = [(kind, text) for kind in ("mistake", "note") for text in content[f"{kind}s"]]
    return {"kind": [kind for kind, _ in rows], "text": [text for _, text in rows]}


def export(options: Options) -> None:
    """Write the mechanism as plain files."""
    mechanism = options.loaded
    if options.folder is not None:
        written = [mechanism.save(options.folder)]
    elif options.mjcf is not None:
        written = [sp.export_mjcf(mechanism, options.mjcf)]
    else:
        written = export_urdf(mechanism, options.urdf)
    wrote = [str(path) for path in written]
    print_result(options, "", {"mechanism": mechanism.name, "wrote": wrote}, files=written)


def new(options: Options) -> None:
    """Write a mechanism file to start from."""
    folder = Path(options.folder)
    if not re.fullmatch(r"\w[\w.+-]*", options.name) or options.name.endswith(".toml"):
        options.usage_error(f"{options.name!r} is no name: letters, digits, - and _ make one, "
                            "without .toml")
    if not folder.is_dir():
        raise ValueError(f"--folder {folder}: there is no such folder")
    if options.tree is not None and options.drawing:
        options.usage_error("--from or --drawing: a drawing has no tree")
    if options.tree is None:
        written = write_new(options.name, folder, options.drawing)
    else:
        tree = Path(options.tree)
        mechanism = sp.load(tree, trusted=options.trusted, packages=dict(options.packages))
        written = write_from(options.name, mechanism.path or tree, folder, mechanism)
    print_result(options, "", {"wrote": [str(path) for path in written]}, files=written)
    if not on_screen(options):
        say(f"edit {written[0]}, then: spatial-pin check {written[0]}")


def completion(options: Options) -> None:
    """Write a script with which a shell completes these words."""
    print(SHELLS[options.shell](options.parsers), end="")


COMMANDS = {
    "new": opt.Command(new, (
        opt.option("name", "of the mechanism, and of its file NAME.toml", metavar="NAME"),
        opt.option("--from",
                   "a tree that there is: .urdf, .xacro or another format that is read; without "
                   "one, a four-bar is written", dest="tree", metavar="FILE"),
        opt.switch("--drawing",
                   "a four-bar as bodies, and joints at places of the world, without a tree"),
        opt.file_option("--folder", "where to write (here)", default="."),
        opt.switch("--trusted", "the tree's xacro files may read files outside their folder"),
        opt.many("--package", "where package://NAME lies", dest="packages", type=opt.package,
                 metavar="NAME=FOLDER"),
        *opt.data_options("the names of the files"),
    ), takes_mechanism=False),
    "list": opt.Command(list_library, (
        *opt.data_options("the list", "names, titles and sources"),
    ), takes_mechanism=False),
    "info": opt.Command(info, (
        *opt.data_options("it", "links, dimensions, joints and so on, one a line,"),
    )),
    "check": opt.Command(check, (
        *opt.data_options("the result, with mistakes,", "mistakes and notes, one a line,"),
    )),
    "export": opt.Command(export, (
        *opt.data_options("the names of the files"),
    ), one_of=(
        opt.file_option("--folder", "a folder that can be moved: mechanism file, URDF and meshes"),
        opt.file_option("--urdf", "expanded URDF; closures go beside it as .toml"),
        opt.file_option("--mjcf", "MuJoCo's format (.xml); closures become equalities"),
    )),
    "completion": opt.Command(completion, (
        opt.option("shell", "the shell that is to complete", choices=tuple(SHELLS)),
    ), takes_mechanism=False),
}
