"""Where the files of a mechanism lie, and their text."""

from __future__ import annotations

import os
import re
import stat
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

if sys.platform == "win32":
    from pathlib import WindowsPath as PlainPath
else:
    from pathlib import PosixPath as PlainPath

from spatial_pin.errors import MechanismFileError

LARGEST_FILE = 100_000_000  # bytes of text: a hundred times the largest robots there are
LIBRARY = "spatial_pin"  # the package that holds the library: `$(find spatial_pin)/parts.xacro`
MANIFEST = "package.xml"
OF_PACKAGES = ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH")
OF_MODELS = ("GZ_SIM_RESOURCE_PATH", "GAZEBO_MODEL_PATH", "SDF_PATH")  # where Gazebo's models lie
NO_PACKAGES: Mapping[str, Path] = MappingProxyType({})
REMEDY = "sp.load(..., trusted=True) reads it all the same"


class HeldFile(PlainPath):
    """A path whose file is in memory, its `text`; a path that is made from it has none."""

    text: str | None = None

    @classmethod
    def of(cls, path: Path | str, text: str) -> HeldFile:
        """Return a file of that path and text."""
        made = cls(path)
        made.text = text
        return made

    def __reduce__(self) -> tuple[Any, ...]:
        return (HeldFile.of, (str(self), self.text)) if self.text is not None else (
            Path, (str(self),))

    def is_file(self) -> bool:
        """Whether there is such a file, here or in memory."""
        return self.text is not None or super().is_file()

    def read_bytes(self) -> bytes:
        """Return the text as UTF-8."""
        return super().read_bytes() if self.text is None else self.text.encode()

    def read_text(self, *args: Any, **kwargs: Any) -> str:
        """Return the text."""
        return super().read_text(*args, **kwargs) if self.text is None else self.text


def is_held(path: Path | None) -> bool:
    """Whether a file is in memory."""
    return isinstance(path, HeldFile) and path.text is not None


def shown(path: Path | str) -> str:
    """Return a path for a message: printable, and not longer than anybody reads."""
    text = str(path)
    if not text.isprintable():
        text = repr(text)[1:-1]
    return text if len(text) <= 200 else f"{text[:120]}...{text[-60:]}"


def check_file(path: Path) -> None:
    """Refuse a path that is no plain file."""
    if is_held(path):
        return
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
    """Return whether there is a plain file."""
    return os.path.isfile(path)  # unlike Path.is_file, false for names that are too long


def read_text(path: Path) -> str:
    """Return the text of a UTF-8 file."""
    check_file(path)
    try:
        return path.read_text(encoding="utf-8").removeprefix("\ufeff")  # the mark of its order
    except UnicodeDecodeError as error:
        raise MechanismFileError(f"{shown(path)}: not UTF-8 text: {error}") from error
    except OSError as error:
        raise MechanismFileError(f"{shown(path)}: {_reason(error)}") from error


def library_folder() -> Path:
    """Return the folder of the mechanisms that come with the library."""
    package = Path(__file__).resolve().parent.parent
    shipped = package / "urdf"
    return shipped if shipped.is_dir() else package.parent / "urdf"


def package_folders(name: str, folder: Path, packages: Mapping[str, Path]) -> Iterator[Path]:
    """Yield the folders that may be the ROS package, or Gazebo's model, of that name.

    The surest goes first: `packages` that `load` was given, then what is round the `folder` of the
    file that asks.
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
    for site in dict.fromkeys(sys.path):  # where Python packages install robots' data
        yield Path(site) / "cmeel.prefix" / "share" / name
    yield Path(sys.prefix) / "share" / name


def _listed(variable: str) -> list[Path]:
    return [Path(p) for p in os.environ.get(variable, "").split(os.pathsep) if p]


def _manifest_name(folder: Path) -> str:
    """Return the name that a folder's manifest gives it, "" where it has none."""
    manifest = folder / MANIFEST
    if not is_file(manifest):
        return ""
    try:
        match = re.search(r"<name>\s*([\w.-]+)\s*</name>", read_text(manifest))
    except MechanismFileError:
        return ""
    return match[1] if match else ""


def is_installed(folder: Path, packages: Mapping[str, Path]) -> bool:
    """Return whether a folder is the library, or a package, which has a manifest or is named."""
    listed = (root for variable in (*OF_PACKAGES, *OF_MODELS) for root in _listed(variable))
    return is_file(folder / MANIFEST) or any(
        root.resolve() in (folder, *folder.parents)
        for root in (library_folder(), Path(__file__).parent, *listed, *packages.values()))


@dataclass(frozen=True)
class Trust:
    """The one rule for every file that a file of a mechanism names.

    It is a plain file of bearable size. It lies, links followed, below the folder of the file that
    `load` reads the tree from, or in a package; if the user trusts the file, anywhere. Whoever
    reads a file asks here before anything opens it.

    Attributes:
        home: the folder, resolved.
        packages: folders of packages, by name, as `load` was given them.
        trusted: whether the user trusts the file.
    """

    home: Path
    packages: Mapping[str, Path] = field(default_factory=dict)
    trusted: bool = False

    @classmethod
    def of(
        cls, file: Path, packages: Mapping[str, Path] = NO_PACKAGES, trusted: bool = False
    ) -> Trust:
        """Return the rule for files that a file, or the files of a folder, may name."""
        folder = file if os.path.isdir(file) else file.parent
        return cls(folder.resolve(), packages, trusted)

    def resolved(self, name: Path | str) -> Path:
        """Return where a file lies that may be read if it is there."""
        try:
            path = Path(name).resolve()
        except (OSError, ValueError, RuntimeError) as error:  # too long a name, a loop of links
            raise MechanismFileError(f"{shown(name)}: {error}") from error
        if not (self.trusted or path.is_relative_to(self.home)
                or any(is_installed(parent, self.packages) for parent in path.parents)):
            raise MechanismFileError(f"{shown(name)} lies neither below {shown(self.home)} nor in "
                                     f"an installed package; {REMEDY}")
        return path

    def checked(self, name: Path | str) -> Path:
        """Return where a file lies that may be read; refuse one elsewhere, missing or no file."""
        path = self.resolved(name)
        check_file(path)
        return path

    def allows(self, name: Path | str) -> bool:
        """Return whether there is a file of that name which may be read."""
        try:
            self.checked(name)
        except MechanismFileError:
            return False
        return True
