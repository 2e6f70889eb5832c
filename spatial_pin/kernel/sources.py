"""The C files of the kernel and its library, for the build and for the loader.

Its C files stand in one folder a job: algebra (dense and sparse matrices, independent rows), core
(the mechanism, its equations and their square system), closing (far from closure), states (rates,
springs and accelerations at one state), path_points and following (continuation), simulating
(equations of motion), integrators (steps in time), branch_points (crossed in time).

It imports nothing of the package: the build runs it before there is one.
"""

from __future__ import annotations

import re
import sys
import zlib
from pathlib import Path

LIBRARY = "_kernel" + {"darwin": ".dylib", "win32": ".dll"}.get(sys.platform, ".so")


def c_files(folder: Path, *suffixes: str) -> list[Path]:
    """Return the C files below a folder with suffixes such as ".c", sorted by name."""
    return sorted((p for p in folder.glob("*/*") if p.suffix in suffixes), key=lambda p: p.name)


def source_hash(folder: Path) -> str:
    """Return a hash of the C files below a folder, or nothing where there are none.

    It tells that a file has changed, no more; importing `hashlib` takes 4 ms.
    """
    files = c_files(folder, ".c", ".h")
    if not files:
        return ""
    checksum = 0
    for file in files:
        text = file.read_bytes().replace(b"\r\n", b"\n")
        checksum = zlib.crc32(f"{file.name} {len(text)}\n".encode() + text, checksum)
    return f"{checksum:016x}"


def prototypes(folder: Path) -> str:
    """Return the prototypes of the functions that Python calls, as C has them, one a line."""
    declared = {}
    for file in c_files(folder, ".c", ".h"):
        for text in re.findall(r"^EXPORT ([^;{}]*\))\s*[;{]", file.read_text("utf-8"), re.M):
            words = " ".join(text.split())
            declared[words[: words.index("(")].split()[-1].lstrip("*")] = words
    return "\n".join(declared.values())
