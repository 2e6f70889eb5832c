"""Commands that look at mechanisms and their files: list, info, check, export."""

from __future__ import annotations

import argparse
import re
import textwrap
from pathlib import Path
from typing import Any

import spatial_pin as sp
from spatial_pin._support.brief import counted
from spatial_pin.cli.completion import SHELLS, script
from spatial_pin.cli.mechanism_arguments import loaded
from spatial_pin.cli.new_files import write_from, write_new
from spatial_pin.cli.options import Command, data_options, option, package
from spatial_pin.cli.printing import WIDTH, on_screen, print_result, say
from spatial_pin.dynamics.coupling_forces import coupling_forces
from spatial_pin.formats.files import library_titles
from spatial_pin.formats.mechanism_writer import export_urdf
from spatial_pin.mobility.mobility import driver_advice
from spatial_pin.motion.report import info as info_of
from spatial_pin.operators import OPERATORS


def list_library(options: argparse.Namespace) -> None:
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


def info(options: argparse.Namespace) -> None:
    """Links, joints, closures, coordinates and freedoms."""
    report = info_of(loaded(options))
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


def check(options: argparse.Namespace) -> None:
    """Read a mechanism file and print its mistakes."""
    try:
        mechanism = loaded(options)
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


def export(options: argparse.Namespace) -> None:
    """Write the mechanism as plain files."""
    mechanism = loaded(options)
    if options.folder is not None:
        written = [mechanism.save(options.folder)]
    elif options.mjcf is not None:
        written = [sp.export_mjcf(mechanism, options.mjcf)]
    else:
        written = export_urdf(mechanism, options.urdf)
    wrote = [str(path) for path in written]
    print_result(options, "", {"mechanism": mechanism.name, "wrote": wrote}, files=written)


def new(options: argparse.Namespace) -> None:
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


def completion(options: argparse.Namespace) -> None:
    """Write a script with which a shell completes these words."""
    print(script(options.shell, options.parsers), end="")


COMMANDS = {
    "new": Command(new, (
        option("name", metavar="NAME", help="of the mechanism, and of its file NAME.toml"),
        option("--from", dest="tree", metavar="FILE",
               help="a tree that there is: .urdf, .xacro or another format that is read; "
                    "without one, a four-bar is written"),
        option("--drawing", action="store_true",
               help="a four-bar as bodies, and joints at places of the world, without a tree"),
        option("--folder", metavar="F", default=".", help="where to write (here)"),
        option("--trusted", action="store_true",
               help="the tree's xacro files may read files outside their folder"),
        option("--package", dest="packages", action="append", default=[],
               type=package, metavar="NAME=FOLDER", help="where package://NAME lies"),
        *data_options("the names of the files"),
    ), takes_mechanism=False),
    "list": Command(list_library, (
        *data_options("the list", "names, titles and sources"),
    ), takes_mechanism=False),
    "info": Command(info, (
        *data_options("it", "links, dimensions, joints and so on, one a line,"),
    )),
    "check": Command(check, (
        *data_options("the result, with mistakes,", "mistakes and notes, one a line,"),
    )),
    "export": Command(export, (
        *data_options("the names of the files"),
    ), one_of=(
        option("--folder", metavar="F",
               help="a folder that can be moved: mechanism file, URDF and meshes"),
        option("--urdf", metavar="F", help="expanded URDF; closures go beside it as .toml"),
        option("--mjcf", metavar="F", help="MuJoCo's format (.xml); closures become equalities"),
    )),
    "completion": Command(completion, (
        option("shell", choices=tuple(SHELLS), help="the shell that is to complete"),
    ), takes_mechanism=False),
}
