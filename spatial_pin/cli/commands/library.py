"""Commands that look at mechanisms and their files: list, info, check, export."""

from __future__ import annotations

import argparse
import textwrap
from typing import Any

import spatial_pin as sp
from spatial_pin.cli.asked import loaded
from spatial_pin.cli.options import Command, data_options
from spatial_pin.cli.results import WIDTH, finite, tell
from spatial_pin.formats.export import export_urdf
from spatial_pin.formats.files import library_titles
from spatial_pin.motion.report import Info, info
from spatial_pin.operators import OPERATORS


def _list_options(sub: argparse.ArgumentParser) -> None:
    data_options(sub, "the list", "names, titles and sources")


def _list(options: argparse.Namespace) -> None:
    heads = ("name", "title", "source")
    rows = [(name, *words) for name, words in library_titles().items()]
    operators = [(name, *words) for name, words in OPERATORS.items()]
    width = max(len(name) for name, _, _ in (*rows, *operators))
    lines = [*(_line(width, *row) for row in rows), "", "in spatial_pin.operators:",
             *(_line(width, *row) for row in operators)]
    tell(options, "\n".join(lines), [dict(zip(heads, row, strict=True)) for row in rows],
         dict(zip(heads, zip(*rows, strict=True), strict=True)))


def _line(width: int, name: str, title: str, source: str) -> str:
    """Return a line of the list that fits the screen; `info` has the whole source."""
    text = f"{title} ({source})" if source else title
    return f"{name:{width}}  {textwrap.shorten(text, WIDTH - width - 2, placeholder=' ...')}"


def _info_options(sub: argparse.ArgumentParser) -> None:
    data_options(sub, "it", "links, dimensions, joints and so on, one a line,")


def _info(options: argparse.Namespace) -> None:
    report = info(loaded(options))
    tell(options, report, finite(report.as_dict()), _parts(report))


def _parts(report: Info) -> dict[str, list[str]]:
    """Return the parts of a mechanism, one a row."""
    rows: list[tuple[str, str, str]] = [("link", name, "") for name in report.links]
    for kind, parts in (
        ("dimension", report.dimensions), ("joint", report.joints), ("closure", report.closures),
        ("coordinate", report.coordinates), ("frame", report.frames), ("driver", report.drivers),
        ("spring", report.springs), ("resistance", report.resistances),
    ):
        found: dict[str, Any] = dict(parts)
        rows += [(kind, name, x if isinstance(x, str) else repr(x)) for name, x in found.items()]
    return dict(zip(("part", "name", "what"), map(list, zip(*rows, strict=True)), strict=True))


def _check_options(sub: argparse.ArgumentParser) -> None:
    data_options(sub, "what was found, mistakes too,")


def _check(options: argparse.Namespace) -> None:
    try:
        content, lines = _checked(options)
    except sp.SpatialPinError as error:
        mistakes = list(getattr(error, "mistakes", ())) or [str(error)]
        if options.json:
            tell(options, "", {"file": str(options.mechanism), "good": False,
                               "mistakes": mistakes, "notes": []})
        raise
    tell(options, "\n".join(lines), content)


def _checked(options: argparse.Namespace) -> tuple[dict[str, Any], list[str]]:
    mechanism = loaded(options)
    notes = list(mechanism.notices)
    state = sp.assemble(mechanism)
    found = sp.mobility(mechanism, state)
    working = found.dof - len(found.passive)
    lines = [f"note: {notice}" for notice in notes]
    lines.append(f"{mechanism.path}: good: {len(mechanism.links)} links, "
                 f"{len(mechanism.coordinates)} coordinates, {len(mechanism.closures)} closures; "
                 f"the guess closes to {state.closure_error:.1e}")
    if len(mechanism.drivers) != working:
        note = f"{len(mechanism.drivers)} drivers for {working} working freedoms"
        notes.append(note)
        lines.append(f"note: {note}:\n{found}")
    return {"file": str(mechanism.path), "good": True, "mistakes": [], "notes": notes,
            "links": len(mechanism.links), "coordinates": len(mechanism.coordinates),
            "closures": len(mechanism.closures), "drivers": len(mechanism.drivers),
            "working_freedoms": working, "closure_error": state.closure_error}, lines


def _export_options(sub: argparse.ArgumentParser) -> None:
    wanted = sub.add_mutually_exclusive_group(required=True)
    wanted.add_argument("--folder", metavar="F",
                        help="a folder that can be moved: mechanism file, URDF and meshes")
    wanted.add_argument("--urdf", metavar="F",
                        help="expanded URDF; closures go beside it as .toml")
    wanted.add_argument("--mjcf", metavar="F",
                        help="MuJoCo's format (.xml); closures become equalities")
    data_options(sub, "the names of the files")


def _export(options: argparse.Namespace) -> None:
    mechanism = loaded(options)
    if options.folder is not None:
        written = [mechanism.save(options.folder)]
    elif options.mjcf is not None:
        written = [sp.export_mjcf(mechanism, options.mjcf)]
    else:
        written = export_urdf(mechanism, options.urdf)
    tell(options, "", {"mechanism": mechanism.name, "wrote": [str(path) for path in written]},
         files=written)


COMMANDS = {
    "list": Command("mechanisms and operators of the library, with their sources",
                    _list_options, _list, takes_mechanism=False),
    "info": Command("links, joints, closures, coordinates and freedoms", _info_options, _info),
    "check": Command("read a mechanism file and say what is wrong with it", _check_options,
                     _check),
    "export": Command("write the mechanism as plain files", _export_options, _export),
}
