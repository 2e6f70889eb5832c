"""SDFormat, read with standard XML: one model, or a world with one, as a joint graph."""

from spatial_pin.formats.imported import Imported, Importer, Request


def read_sdf(request: Request) -> Imported:
    """Read an SDFormat file.

    Raises:
        MechanismFileError: it cannot be used; says which element and why.
    """
    from spatial_pin.formats.sdf import reading  # when a file is read

    return reading.read_sdf(request)


IMPORTER = Importer("SDFormat", (".sdf", ".world"), lambda path: True, read_sdf)

__all__ = ["IMPORTER", "read_sdf"]
