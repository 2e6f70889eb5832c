"""Where the files of a mechanism lie, and their text."""

from __future__ import annotations

import os
import re
import stat
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType

from spatial_pin.errors import MechanismFileError

LARGEST_FILE = 100_000_000  # bytes of text: a hundred times the largest robots there are


def shown(path: Path | str) -> str:
    """Return a path for a message: printable, and not longer than anybody reads."""
    text = str(path)
    if not text.isprintable():
        text = repr(text)[1:-1]
    return text if len(text) <= 200 else f"{text[:120]}...{text[-60:]}"


def check_file(path: Path) -> None:
    """Refuse what is no plain file.

    Raises:
        MechanismFileError: it is not there, a folder, a pipe, or larger than any mechanism.
    """
    try:
        status = path.stat()
    except FileNotFoundError:
        raise MechanismFileError(f"{shown(path)}: no such file") from None
    except (OSError, ValueError) as error:  # too long a name, no permission, a loop of links, NUL
        raise MechanismFileError(f"{shown(path)}: {_reason(error)}") from error
    if not stat.S_ISREG(status.st_mode):
        kind = "a folder" if stat.S_ISDIR(status.st_mode) else "a pipe, socket or device"
        raise MechanismFileError(f"{shown(path)} is {kind}, not a file")
    if status.st_size > LARGEST_FILE:
        raise MechanismFileError(f"{shown(path)}: {status.st_size:,} bytes; a file of a mechanism "
                                 f"has at most {LARGEST_FILE:,}")


def _reason(error: Exception) -> str:
    return (getattr(error, "strerror", None) or str(error)).lower()


def is_file(path: Path) -> bool:
    """Return whether there is a plain file that can be asked for."""
    return os.path.isfile(path)  # unlike Path.is_file, false for names that are too long


def read_text(path: Path) -> str:
    """Return the text of a UTF-8 file.

    Raises:
        MechanismFileError: it cannot be read, or is not UTF-8.
    """
    check_file(path)
    try:
        return path.read_text(encoding="utf-8").removeprefix("\ufeff")  # the mark of its order
    except UnicodeDecodeError as error:
        raise MechanismFileError(f"{shown(path)}: not UTF-8 text: {error}") from error
    except OSError as error:
        raise MechanismFileError(f"{shown(path)}: {_reason(error)}") from error


# ---------------------------------------------------------------- packages

LIBRARY = "spatial_pin"  # the package that holds the library: `$(find spatial_pin)/parts.xacro`
MANIFEST = "package.xml"
OF_MODELS = ("GZ_SIM_RESOURCE_PATH", "GAZEBO_MODEL_PATH", "SDF_PATH")  # where Gazebo's models lie
NO_PACKAGES: Mapping[str, Path] = MappingProxyType({})


def library_folder() -> Path:
    """Return the folder of the mechanisms that come with the library."""
    package = Path(__file__).resolve().parent.parent
    shipped = package / "urdf"
    return shipped if shipped.is_dir() else package.parent / "urdf"


def package_folders(name: str, folder: Path, packages: Mapping[str, Path]) -> Iterator[Path]:
    """Yield the folders that may be the ROS package, or Gazebo's model, of that name.

    The surest goes first.

    Args:
        name: of the package.
        folder: of the file that asks for it.
        packages: folders of packages, by name, as `load` was given them.
    """
    if not name or Path(name).name != name:
        return
    if name in packages:
        yield packages[name]
    if name == LIBRARY:
        yield library_folder()
    for root in (*_listed("ROS_PACKAGE_PATH"),
                 *(prefix / "share" for prefix in _listed("AMENT_PREFIX_PATH")),
                 *(root for variable in OF_MODELS for root in _listed(variable))):
        yield root / name
        if root.name == name:
            yield root
    for parent in (folder, *folder.parents):
        if parent.name == name or _manifest_name(parent) == name:
            yield parent
        yield parent / name
    for root in _installed():
        yield root / name


def _installed() -> Iterator[Path]:
    """Yield the folders in which Python packages install ROS packages, such as robots' data."""
    for place in dict.fromkeys(sys.path):
        yield Path(place) / "cmeel.prefix" / "share"
    yield Path(sys.prefix) / "share"


def _listed(variable: str) -> list[Path]:
    return [Path(p) for p in os.environ.get(variable, "").split(os.pathsep) if p]


def _manifest_name(folder: Path) -> str:
    """Return the name that a folder's manifest gives it, "" where it has none."""
    manifest = folder / MANIFEST
    if not is_file(manifest):
        return ""
    try:
        found = re.search(r"<name>\s*([\w.-]+)\s*</name>", read_text(manifest))
    except MechanismFileError:
        return ""
    return found[1] if found else ""


def is_installed(folder: Path, packages: Mapping[str, Path]) -> bool:
    """Return whether a folder is the library, or a ROS package.

    That is what says so itself, or is named by the environment or the caller.
    """
    roots = [library_folder(), *_listed("ROS_PACKAGE_PATH"), *_listed("AMENT_PREFIX_PATH"),
             *packages.values()]
    return is_file(folder / MANIFEST) or any(r.resolve() in (folder, *folder.parents)
                                             for r in roots)
