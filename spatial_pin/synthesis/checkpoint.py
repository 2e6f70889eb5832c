"""What a search has found, kept in a file as it comes, so that it can go on."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import fields, is_dataclass
from errno import ENOENT
from pathlib import Path, PurePath
from time import monotonic
from typing import Any

import numpy as np
import pinocchio as pin

from spatial_pin._support.outputs import named_path, write_text
from spatial_pin.assembly.state import State
from spatial_pin.errors import SpatialPinError
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array
from spatial_pin.synthesis.design_problem import LocalSolution
from spatial_pin.synthesis.inner_problem import GoalStates

FORMAT = "spatial_pin design 2"
PAUSE = 1.0  # between two writings [s]: one takes some milliseconds


class Checkpoint:
    """What was found, by number of the start, and rough costs of an evolution in their order.

    It is written when it is left, however that is, and now and then before.

    Args:
        key: of the search.
        path: where it is kept; None: nowhere.

    Raises:
        SpatialPinError: what is there is of another search, or of something else.
        OSError: it cannot be read; there is no such folder.
    """

    def __init__(self, key: str, path: str | Path | None) -> None:
        self.key, self.path = key, None if path is None else named_path(path)
        self.found: dict[int, LocalSolution] = {}
        self.values: list[float] = []
        self._written, self._is_new = monotonic(), False
        if self.path is not None and self.path.exists():
            self._read(self.path)
        elif self.path is not None and not self.path.parent.is_dir():
            raise FileNotFoundError(ENOENT, "there is no folder for the file to resume from",
                                    str(self.path))

    def __enter__(self) -> Checkpoint:
        return self

    def __exit__(self, *error: object) -> None:
        self._write()

    def add(self, number: int, found: LocalSolution) -> None:
        """Keep what was found from a start."""
        self.found[number] = found
        self._changed()

    def add_values(self, values: Sequence[float]) -> None:
        """Keep further rough costs."""
        self.values += values
        self._changed()

    def _changed(self) -> None:
        self._is_new = True
        if monotonic() - self._written > PAUSE:
            self._write()

    def _write(self) -> None:
        if self.path is None or not self._is_new:
            return
        content = {"format": FORMAT, "key": self.key, "values": self.values,
                   "found": {str(k): _table(x) for k, x in sorted(self.found.items())}}
        write_text(self.path, json.dumps(content) + "\n")
        self._written, self._is_new = monotonic(), False

    def _read(self, path: Path) -> None:
        words = f"{path}: not a search for dimensions that was kept; give another file to `resume`"
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
            if content["format"] != FORMAT:
                raise SpatialPinError(words)
            key = content["key"]
            self.values = [float(x) for x in content["values"]]
            self.found = {int(k): _found(x) for k, x in content["found"].items()}
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise SpatialPinError(words) from error
        if key != self.key:
            raise SpatialPinError(
                f"{path}: a search with another mechanism, other goals, bounds, guess, method or "
                "seed; give another file to `resume`, or remove this one")


def _table(found: LocalSolution) -> dict[str, Any]:
    return {"x": found.x.tolist(), "cost": found.cost, "hard": found.hard,
            "evaluations": found.evaluations, "why": found.why,
            "others": [_table(one) for one in found.others],
            "samples": [{"q": s.q.tolist(), "angles": s.angles.tolist(), "at": s.at.tolist()}
                        for s in found.samples]}


def _found(table: Mapping[str, Any]) -> LocalSolution:
    samples = tuple(
        GoalStates(_rows(s["q"], len(s["at"])), _rows(s["angles"], len(s["at"])),
                np.array(s["at"], dtype=np.intp))
        for s in table["samples"])
    return LocalSolution(
        np.array(table["x"], dtype=float), float(table["cost"]), float(table["hard"]), samples,
        int(table["evaluations"]), str(table["why"]),
        tuple(_found(one) for one in table["others"]))


def _rows(values: Any, n: int) -> Array:
    return np.array(values, dtype=float).reshape(n, -1)


# ---------------------------------------------------------------- what tells searches apart


def fingerprint(spec: Any, mechanism: Mechanism, method: str, seed: int) -> str:
    """Return what is the same for two searches only if they look for the same in the same way."""
    files = [path.read_bytes() for path in (mechanism.path, mechanism.tree)
             if isinstance(path, Path) and path.is_file()]
    text = json.dumps([FORMAT, method, seed, _plain(spec)], sort_keys=True)
    digest = hashlib.sha256(text.encode())
    for content in files:
        digest.update(hashlib.sha256(content).digest())
    return digest.hexdigest()


def _plain(value: Any) -> Any:
    """Return a value made of texts, numbers, lists and tables."""
    if is_dataclass(value) and not isinstance(value, type):
        own = {f.name: _plain(getattr(value, f.name)) for f in fields(value)}
        return [type(value).__name__, own]
    if isinstance(value, Mapping):
        return [[_plain(k), _plain(x)] for k, x in sorted(value.items(), key=lambda x: str(x[0]))]
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, pin.SE3):
        return value.homogeneous.tolist()
    if isinstance(value, State):
        return [value.q.tolist(), value.angles.tolist()]
    if isinstance(value, PurePath):
        return value.name
    if isinstance(value, list | tuple | set | frozenset):
        return [_plain(x) for x in value]
    with suppress(TypeError):
        return json.loads(json.dumps(value))
    return [type(value).__name__, _plain(vars(value))]
