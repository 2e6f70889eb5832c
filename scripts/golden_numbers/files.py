"""Files of golden numbers: one .npz with the answer of every verb of every mechanism."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from golden_numbers.answer import Answer, Numbers

Golden = dict[tuple[str, str], Answer]  # by mechanism and verb
FIELDS = "values", "scale", "known"


def write(path: Path, golden: Golden) -> None:
    """Write answers to a file."""
    arrays = {}
    for place, answer in golden.items():
        arrays["/".join((*place, "", "asked"))] = np.array("")
        for name, found in answer.items():
            key = "/".join((*place, name))
            if isinstance(found, str):
                arrays[f"{key}/text"] = np.array(found)
                continue
            for field in FIELDS:
                arrays[f"{key}/{field}"] = getattr(found, field)
            arrays[f"{key}/meaning"] = np.array([found.by, "at most" * found.at_most])
    np.savez_compressed(path, **arrays)


def read(path: Path) -> Golden:
    """Return the answers of a file."""
    golden: Golden = {}
    with np.load(path) as arrays:
        for key in arrays.files:
            mechanism, verb, name, kind = key.split("/")
            answer = golden.setdefault((mechanism, verb), {})
            if kind == "text":
                answer[name] = str(arrays[key])
            elif kind == "meaning":
                by, bound = arrays[key].tolist()
                base = key.removesuffix("/meaning")
                answer[name] = Numbers(*(arrays[f"{base}/{x}"] for x in FIELDS), by, bool(bound))
    return golden
