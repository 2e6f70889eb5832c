"""Names of a mechanism that a shell offers: what a completion script runs, without the commands.

A shell expands what it is given: names with other than plain signs in them are not offered.
"""

from __future__ import annotations

import re
import shlex
import warnings
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import spatial_pin as sp
from spatial_pin.assembly.holding import BASE, SPRINGS

PLAIN = re.compile(r"[\w.+/-]+")  # no sign that means something to a shell
POSE = ("x", "y", "z", "turn_x", "turn_y", "turn_z")  # of a frame, as `workspace` has them


def offer(words: Sequence[str]) -> int:
    """Print the names of a kind, one a line; nothing where there are none, for whatever reason.

    Args:
        words: the kind, one of `KINDS`, with `=` where a value comes after the name; and the
            mechanism as it is typed.
    """
    try:
        kind, typed = words
        (name,) = shlex.split(typed)
        warnings.simplefilter("ignore")
        mechanism = sp.load(Path(name).expanduser() if name.startswith("~") else name)
        names = dict.fromkeys(KINDS[kind.removesuffix("=")](mechanism))
        equals = "=" * kind.endswith("=")
        print("".join(f"{name}{equals}\n" for name in names if PLAIN.fullmatch(name)), end="",
              flush=True)
    except (Exception, KeyboardInterrupt):  # whoever types is not told of a file in the making
        return 1
    return 0


def _coordinates(mechanism: sp.Mechanism) -> list[str]:
    return [*mechanism.drivers, *mechanism.coordinate_table]


def _joints(mechanism: sp.Mechanism) -> list[str]:
    return list(mechanism.model.names)[1:]


def _frames(mechanism: sp.Mechanism, *of: str) -> list[str]:
    frames = [name for name in mechanism.frame_ids if name != "universe"]
    return [f"{name}.{part}" for name in frames for part in of] or frames


# To add a kind: what there is of it in a mechanism. `completion` says which word is of which.
KINDS: dict[str, Callable[[sp.Mechanism], Iterable[str]]] = {
    "coordinate": _coordinates,
    "held": lambda m: [*_coordinates(m), *_joints(m), BASE, SPRINGS],
    "dimension": lambda m: m.dimensions,
    "frame": _frames,
    "arrow": lambda m: _frames(m, "velocity", "acceleration"),
    "pair": lambda m: [*_joints(m), *(closure.name for closure in m.closures)],
    "output": lambda m: [*_coordinates(m), *_frames(m, "position")],
    "range": lambda m: [*_coordinates(m), *POSE],
    "target": lambda m: [*_coordinates(m), *_frames(m, "position", "pose")],
}
