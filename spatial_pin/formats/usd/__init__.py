"""USD files, read with OpenUSD's own package: the joint graph that UsdPhysics states."""

from __future__ import annotations

from spatial_pin.errors import MechanismFileError
from spatial_pin.formats.file_access import shown
from spatial_pin.formats.importers import Imported, Request


def read(request: Request) -> Imported:
    """Read a USD file."""
    try:
        from pxr import UsdPhysics  # noqa: F401
    except ImportError as error:
        raise MechanismFileError(f"{shown(request.path)}: reading USD needs OpenUSD: pip install "
                                 "'spatial_pin[usd]'") from error
    from spatial_pin.formats.usd.usd_reader import read_stage

    return read_stage(request)
