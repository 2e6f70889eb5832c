"""Compile the kernel (`spatial_pin/kernel/*/*.c`) with the system's C compiler, or with ziglang's.

Hatchling runs this as a build hook; `python scripts/build_kernel.py` compiles in place, for work on
the C files; arguments are further flags. Where no C compiler works, the hook asks pip for `ziglang`
as a build requirement.
"""

from __future__ import annotations

import functools
import importlib.util
import os
import platform
import runpy
import shlex
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

try:
    from hatchling.builders.hooks.plugin.interface import BuildHookInterface
except ImportError:  # compiling in place needs no hatchling
    BuildHookInterface = object  # type: ignore[assignment, misc]

ROOT = Path(__file__).resolve().parent.parent
KERNEL = Path("spatial_pin") / "kernel"
# Contracted multiply-adds would make the last digits depend on the compiler and the processor.
# Vectors go to inlined functions alone: how others are called does not matter (psabi).
FLAGS = ["-std=c99", "-O3", "-ffp-contract=off", "-fno-math-errno", "-fvisibility=hidden",
         "-Wno-psabi", "-shared"]
# Functions are inlined across files, where the compiler can: sweeps and simulations take a few per
# cent less. Every result is the same.
ACROSS_FILES = "-flto"
MACOS = "11.0"  # the first with arm64; Pinocchio's wheels want no older one
NO_COMPILER = ("spatial_pin is compiled when it is installed from source, and no C compiler works"
               " here: install gcc or clang (Debian: apt install gcc libc6-dev; macOS:"
               " xcode-select --install), set CC to one, or `pip install ziglang`")
SAMPLE = "#include <math.h>\n#include <stdlib.h>\ndouble root(double x) { return sqrt(x); }\n"


def compiles(command: list[str]) -> bool:
    """Return whether a compiler makes a shared library; a name alone proves nothing.

    macOS without its developer tools has a `cc` that only prints this; gcc may be there without the
    headers of the C library.
    """
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "sample.c"
        source.write_text(SAMPLE, encoding="utf-8")
        try:
            done = subprocess.run([*command, *platform_flags(), *FLAGS, str(source), "-o",
                                   str(Path(folder) / "sample"), "-lm"],
                                  capture_output=True, check=False)
        except OSError:
            return False
        return done.returncode == 0


@functools.cache
def system_compiler() -> tuple[str, ...]:
    """Return the command of this machine's C compiler ($CC, cc, gcc or clang), or nothing."""
    own = shlex.split(os.environ.get("CC", ""))
    if own:  # a compiler that was named is used, or its own message is shown
        return tuple(own)
    return next((c for c in (("cc",), ("gcc",), ("clang",)) if compiles([*c])), ())


def compiler() -> list[str]:
    """Return the command of the system's C compiler, or of ziglang's."""
    choices = [*system_compiler()]
    if not choices and importlib.util.find_spec("ziglang"):
        # left alone, it compiles for this very processor: a copied library would crash elsewhere
        choices = [sys.executable, "-m", "ziglang", "cc", "-mcpu=baseline"]
    if not choices:
        raise SystemExit(NO_COMPILER)
    return choices


def macos_version() -> str:
    """Return the oldest macOS that the library is to run on."""
    return os.environ.get("MACOSX_DEPLOYMENT_TARGET", MACOS)


def platform_flags() -> list[str]:
    """Return the compiler's flags that this platform wants beside `FLAGS`."""
    if sys.platform == "darwin":
        return ["-fPIC", f"-mmacosx-version-min={macos_version()}"]
    return [] if sys.platform == "win32" else ["-fPIC"]


def wheel_tag() -> str:
    """Return the tag of a wheel for all Pythons of this platform.

    A Mac's is that of what is compiled: Python's own may name an older system or two processors.
    """
    if sys.platform == "darwin":
        major, _, minor = macos_version().partition(".")
        minor = "0" if int(major) >= 11 else minor.partition(".")[0]
        return f"py3-none-macosx_{major}_{minor}_{platform.machine()}"
    return "py3-none-" + sysconfig.get_platform().replace("-", "_").replace(".", "_")


def sources_of(root: Path) -> dict:
    """Return what `spatial_pin/kernel/sources.py` defines, without importing the package."""
    return runpy.run_path(str(root / KERNEL / "sources.py"))


def compile_kernel(root: Path, flags: list[str] | None = None, out: Path | None = None) -> Path:
    """Compile the kernel below `root`; return the shared library.

    Args:
        root: of the source tree.
        flags: for the compiler beside `FLAGS`.
        out: the library; in the package if left out.
    """
    about = sources_of(root)
    folder = root / KERNEL
    out = out or folder / about["LIBRARY"]
    written = out.with_name(f"{out.name}.{os.getpid()}")  # the old one may be in use
    declared = "".join(f'"{line}",' for line in about["prototypes"](folder).splitlines())
    is_of = [f'-DSOURCE_HASH="{about["source_hash"](folder)}"', f"-DPROTOTYPES={declared}"]
    headers = sorted({f"-I{file.parent}" for file in about["c_files"](folder, ".h")})
    compiler_words = compiler()
    if compiles([*compiler_words, ACROSS_FILES]):
        compiler_words.append(ACROSS_FILES)
    command = [*compiler_words, *platform_flags(), *FLAGS, *is_of, *headers, *(flags or []),
               *map(str, about["c_files"](folder, ".c")), "-o", str(written), "-lm"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    except OSError as error:
        raise SystemExit(f"the C compiler {command[0]} cannot be run: {error}") from error
    if done.returncode:
        raise SystemExit(f"the kernel does not compile: {shlex.join(command)}\n{done.stderr}")
    written.replace(out)
    return out


class KernelHook(BuildHookInterface):  # type: ignore[misc, valid-type]
    """Puts the compiled kernel into the wheel, which is one for all Pythons of a platform."""

    PLUGIN_NAME = "custom"

    def dependencies(self) -> list[str]:
        """Return what pip has to install to compile."""
        return [] if system_compiler() else ["ziglang"]

    def initialize(self, version: str, build_data: dict) -> None:
        """Compile, and mark the wheel as one of this platform.

        An editable install has its library in the source tree; another wheel leaves nothing there.
        """
        root = Path(self.root)
        if version == "editable":
            compile_kernel(root)
        else:
            self._folder = tempfile.TemporaryDirectory()
            name = sources_of(root)["LIBRARY"]
            library = compile_kernel(root, out=Path(self._folder.name) / name)
            build_data["force_include"][str(library)] = (KERNEL / name).as_posix()
        build_data["pure_python"] = False
        build_data["tag"] = wheel_tag()

    def finalize(self, version: str, build_data: dict, artifact_path: str) -> None:
        """Remove what was compiled beside the source tree."""
        if version != "editable":
            self._folder.cleanup()


if __name__ == "__main__":
    print(compile_kernel(ROOT, sys.argv[1:]))
