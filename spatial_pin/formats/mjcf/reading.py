"""MJCF, MuJoCo's models, read through the `mujoco` package."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from spatial_pin.formats.imported import Imported, Request
from spatial_pin.formats.mjcf.compiling import compiled, some
from spatial_pin.formats.mjcf.drives import read_drivers, read_guess, read_springs
from spatial_pin.formats.mjcf.loops import read_closures
from spatial_pin.formats.mjcf.tree import Reading, moves_joint, read_tree
from spatial_pin.formats.sources import Trust, shown

UNNAMED = "MuJoCo Model"  # what MuJoCo calls a model without a name


def read(request: Request) -> Imported:
    """Read an MJCF file.

    Raises:
        MechanismFileError: `mujoco` is not installed or refuses the file, or an equality has no
            exact counterpart.
    """
    trust = Trust.of(request.path, request.packages, request.trusted)
    source = compiled(request.path, trust, request.without)
    import mujoco

    names = source.model.names
    said = names[:names.index(b"\0")].decode()
    name = said if said and said != UNNAMED else request.path.stem
    reading = read_tree(mujoco, source, name)
    closures = read_closures(reading, shown(request.path))
    content: dict[str, Any] = {
        "name": name, "gravity": _gravity(reading),
        "order": [place.name for place in reading.joints], "joints": reading.refined,
        "closures": closures,
        "springs": read_springs(reading), "guess": read_guess(reading),
    }
    if reading.model.nu:
        content["drivers"] = read_drivers(reading, closures)
    notices = (*source.notices, *reading.notices, *_left_out(reading))
    return Imported(reading.urdf.text(), content, notices)


def _gravity(reading: Reading) -> list[float]:
    gravity = np.zeros(3) if reading.is_off("GRAVITY") else reading.model.opt.gravity
    return [float(x) for x in gravity]


def _left_out(reading: Reading) -> Iterator[str]:
    """Yield a notice for everything of a model that acts on it and is not read."""
    model = reading.model
    for tendon in range(model.ntendon):
        words = list(_of_tendon(reading, tendon))
        if words:
            name = repr(model.tendon(tendon).name or tendon)
            yield f"tendon {name}: its {', '.join(words)} is left out"
    for flex in range(model.nflex):
        yield f"flex number {flex}: its elasticity is left out"
    for actuator in range(len(model.actuator_trntype)):
        words = list(_of_actuator(reading, actuator))
        if words:
            name = repr(model.actuator(actuator).name or actuator)
            yield f"actuator {name}: its {', '.join(words)} is left out"
    floats = [model.body(b).name for b in np.flatnonzero(model.body_gravcomp)]
    if floats:
        yield f"the gravity compensation of bodies ({some(floats)}) is left out"
    if model.opt.density or model.opt.viscosity:
        yield "the fluid around the bodies (density, viscosity) is left out"
    for joint, place in enumerate(reading.joints):
        words = list(_of_joint(reading, joint))
        if words:
            yield f"joint {place.name!r}: its {', '.join(words)} is left out"


def _of_tendon(reading: Reading, tendon: int) -> Iterator[str]:
    model = reading.model
    lost = {"friction": model.tendon_frictionloss, "range": model.tendon_limited}
    if tendon not in reading.tendons:
        lost = {"stiffness": model.tendon_stiffness, "damping": model.tendon_damping, **lost}
    yield from (word for word, values in lost.items() if values[tendon])
    yield from _nonzero(reading, tendon, {"tendon_armature": "armature"})


def _of_actuator(reading: Reading, actuator: int) -> Iterator[str]:
    joint = reading.model.actuator_trnid[actuator, 0]
    if not (moves_joint(reading)[actuator] and reading.is_single(joint)):
        yield from _nonzero(reading, actuator, {"actuator_armature": "armature",
                                                "actuator_damping": "damping"})
    yield from _nonzero(reading, actuator, {"actuator_dampingpoly": "damping of higher order"})


def _of_joint(reading: Reading, joint: int) -> Iterator[str]:
    dof = int(reading.model.jnt_dofadr[joint])
    yield from _nonzero(reading, dof, {"dof_dampingpoly": "damping of higher order"})
    yield from _nonzero(reading, joint, {"jnt_stiffnesspoly": "stiffness of higher order",
                                         "jnt_springyield": "yielding spring"})


def _nonzero(reading: Reading, place: int, words: dict[str, str]) -> Iterable[str]:
    """Return the words of the arrays of a model, some of which older MuJoCo has not."""
    arrays = {key: getattr(reading.model, key, None) for key in words}
    return [words[key] for key, x in arrays.items() if x is not None and np.any(x[place])]
