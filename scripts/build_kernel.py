"""Compile the kernel (`spatial_pin/kernel/*.c`) with the system's C compiler, or with ziglang's.

Hatchling runs this as a build hook; `python scripts/build_kernel.py` compiles in place, for work on
the C files. Where no C compiler is found, the hook asks pip for `ziglang` as a build requirement.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

try:
    from hatchling.builders.hooks.plugin.interface import BuildHookInterface
except ImportError:  # compiling in place needs no hatchling
    BuildHookInterface = object  # type: ignore[assignment, misc]

KERNEL = Path("spatial_pin") / "kernel"
# Contracted multiply-adds would make the last digits depend on the compiler and the processor.
FLAGS = ["-std=c99", "-O3", "-ffp-contract=off", "-fno-math-errno", "-fvisibility=hidden",
         "-shared", "-fPIC"]
SUFFIX = {"darwin": ".dylib", "win32": ".dll"}.get(sys.platform, ".so")


def system_compiler() -> list[str]:
    """Return the command of the C compiler of this machine ($CC, cc, gcc or clang), or nothing."""
    for name in (os.environ.get("CC", ""), "cc", "gcc", "clang"):
        command = name.split()
        if command and shutil.which(command[0]):
            return command
    return []


def compiler() -> list[str]:
    """Return the command of the system's C compiler, or of ziglang's."""
    found = system_compiler()
    if not found and importlib.util.find_spec("ziglang"):
        found = [sys.executable, "-m", "ziglang", "cc"]
    if not found:
        raise SystemExit("spatial_pin needs a C compiler to be installed from source, and found"
                         " none: install gcc or clang, set CC, or `pip install ziglang`")
    return found


def compile_kernel(root: Path, flags: list[str] | None = None, out: Path | None = None) -> Path:
    """Compile the kernel below `root`; return the shared library.

    Args:
        root: of the source tree.
        flags: for the compiler beside `FLAGS`.
        out: where the library is put, in the package if left out.
    """
    sources = sorted(str(p) for p in (root / KERNEL).glob("*.c"))
    out = out or root / KERNEL / f"_kernel{SUFFIX}"
    command = [*compiler(), *FLAGS, *(flags or []), *sources, "-o", str(out), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"the kernel does not compile: {' '.join(command)}\n{done.stderr}")
    return out


class KernelHook(BuildHookInterface):  # type: ignore[misc, valid-type]
    """Puts the compiled kernel into the wheel, which is one for all Pythons of a platform."""

    PLUGIN_NAME = "custom"

    def dependencies(self) -> list[str]:
        """Return what pip has to install to compile."""
        return [] if system_compiler() else ["ziglang"]

    def initialize(self, version: str, build_data: dict) -> None:
        """Compile, and mark the wheel as one of this platform."""
        if self.target_name != "wheel":
            return
        library = compile_kernel(Path(self.root))
        build_data["artifacts"].append(str(KERNEL / library.name))
        build_data["pure_python"] = False
        platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
        build_data["tag"] = f"py3-none-{platform}"


if __name__ == "__main__":
    print(compile_kernel(Path(__file__).resolve().parent.parent, sys.argv[1:]))
