"""What the kernel is compiled from, and what that makes: read by the build and by the loader.

It imports nothing of the package: the build runs it before there is one.
"""

from __future__ import annotations

import sys
import zlib
from pathlib import Path

LIBRARY = "_kernel" + {"darwin": ".dylib", "win32": ".dll"}.get(sys.platform, ".so")


def source_hash(folder: Path) -> str:
    """Return a hash of the C files in a folder, or nothing where there are none.

    It tells that a file has changed, no more; importing `hashlib` takes 4 ms.
    """
    files = sorted([*folder.glob("*.c"), *folder.glob("*.h")], key=lambda p: p.name)
    if not files:
        return ""
    found = 0
    for file in files:
        text = file.read_bytes().replace(b"\r\n", b"\n")
        found = zlib.crc32(f"{file.name} {len(text)}\n".encode() + text, found)
    return f"{found:016x}"
