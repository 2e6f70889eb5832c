"""MJCF, MuJoCo's models, read through the `mujoco` package."""

from spatial_pin.formats.imported import Imported, Importer, Request
from spatial_pin.formats.mjcf.compiling import is_mjcf


def read_mjcf(request: Request) -> Imported:
    """Read an MJCF file.

    Raises:
        MechanismFileError: `mujoco` is not installed or refuses the file, or an equality has no
            exact counterpart.
    """
    from spatial_pin.formats.mjcf import reading  # when a file is read

    return reading.read_mjcf(request)


IMPORTER = Importer("MJCF", (".xml", ".mjcf"), is_mjcf, read_mjcf)

__all__ = ["IMPORTER", "read_mjcf"]
