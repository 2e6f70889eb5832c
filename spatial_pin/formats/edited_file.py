"""A mechanism with a point or a mass more: its mechanism file with one table more, in memory."""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from spatial_pin._support.checks import finite_array, finite_number
from spatial_pin.errors import MechanismFileError, UnknownNameError
from spatial_pin.formats.file_access import HeldFile, read_text
from spatial_pin.formats.files import load, made_of
from spatial_pin.formats.importers import Request
from spatial_pin.formats.mechanism_writer import content_of
from spatial_pin.formats.parsing import parse_toml, toml_text
from spatial_pin.mechanism.mechanism import Mechanism


def with_point(
    mechanism: Mechanism, name: str, body: str, xyz: ArrayLike, rpy: ArrayLike
) -> Mechanism:
    """Return a mechanism with a frame on a body; see `Mechanism.with_point`."""
    places = {key: finite_array(x, (3,), f"{key} of point {name!r}").tolist()
              for key, x in (("xyz", xyz), ("rpy", rpy))}
    if not isinstance(name, str):
        raise TypeError(f"the name of a point is text, not {name!r}")
    if name in mechanism.frame_ids:
        raise MechanismFileError(f"mechanism {mechanism.name!r}: there is a link, joint or frame "
                                 f"{name!r} already; choose another name for the point")
    mechanism.frame_id(body)
    return _edited(mechanism, "frames", name, {"link": body, **places})


def with_mass(
    mechanism: Mechanism, body: str, mass: float, com: ArrayLike, inertia: ArrayLike
) -> Mechanism:
    """Return a mechanism with another mass of a link; see `Mechanism.with_mass`."""
    if body not in mechanism.links:
        raise UnknownNameError("link", body, mechanism.links, f"mechanism {mechanism.name!r}: ")
    shape = np.shape(inertia)
    if shape not in ((), (3,), (3, 3)):
        raise ValueError(f"inertia of {body!r} is one number, three, or (3, 3), not {shape}")
    return _edited(mechanism, "masses", body, {
        "mass": finite_number(mass, f"mass of {body!r}"),
        "com": finite_array(com, (3,), f"com of {body!r}").tolist(),
        "inertia": finite_array(inertia, shape, f"inertia of {body!r}").tolist()})


def _edited(mechanism: Mechanism, table: str, name: str, entry: dict[str, Any]) -> Mechanism:
    """Return a mechanism as its file makes it with one table `[TABLE.NAME]` more.

    The file is where the old one is, over the same tree, so that dimensions go on. Of a mechanism
    without file one says all that there is.
    """
    m, path = mechanism, mechanism.path
    if path is None or os.path.isdir(path):
        content = content_of(m)
        content[table] = {**content.get(table, {}), name: entry}
        request = Request(Path(f"{m.name}.toml"), trusted=m.trusted, packages=dict(m.packages))
        made = made_of(content, Path(f"{m.name}.urdf"), m.urdf, request, ())
        return made.with_fields(
            path=path, tree=m.tree, notices=m.notices, parameters=m.parameters, gap=m.gap,
            free_flyer=m.free_flyer, visual_model=partial(getattr, m, "visual_model"),
            collision_model=partial(getattr, m, "collision_model"))
    own: dict[str, Any] = {"name": m.name, "tree": path.name}
    if path.suffix == ".toml":
        own = parse_toml(read_text(path), path)
    content = {**own, table: {**own.get(table, {}), name: entry}}
    return load(HeldFile.of(path.with_suffix(".toml"), toml_text(content)), **m.loading)
