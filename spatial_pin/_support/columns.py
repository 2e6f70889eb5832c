"""Results as tables: named columns for .csv, NumPy's .npz, pandas and xarray.

A heading is the name of a quantity and its unit: `crank rate [rad/s]`, of a vector one column a
component: `tip velocity x [m/s]`. What has no unit is in [-]; texts and counts have no bracket.
"""

from __future__ import annotations

import importlib
import io
import os
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TextIO, overload

import numpy as np
from numpy.typing import NDArray

from spatial_pin._support.checks import names_of
from spatial_pin._support.output_files import (
    is_special,
    named_path,
    write_bytes,
    write_columns,
    write_csv,
)
from spatial_pin.errors import SpatialPinError, UnknownNameError

if TYPE_CHECKING:
    import pandas
    import xarray

XYZ = ("x", "y", "z")


class Quantity(NamedTuple):
    """Values of a result, a row for each sample.

    Attributes:
        values: (N,) or (N, 3).
        unit: their SI unit, "-" where they have none, "" of texts and counts.

    Example:
        >>> motion = sp.sweep(sp.load("four_bar"), "crank", [0.0, 0.5, 1.0], speed=2.0)
        >>> values, unit = motion.quantities("coupler_b.velocity")["coupler_b velocity"]
        >>> values.shape, unit  # (N, 3)
        ((3, 3), 'm/s')
    """

    values: NDArray[Any]
    unit: str = ""


def heading(name: str, unit: str) -> str:
    """Return the heading of a column."""
    return f"{name} [{unit}]" if unit else name


def flat(quantities: Mapping[str, Quantity]) -> dict[str, NDArray[Any]]:
    """Return columns (N,) by their headings, one for each component of a vector."""
    table: dict[str, NDArray[Any]] = {}
    for name, (values, unit) in quantities.items():
        if values.ndim == 1:
            table[heading(name, unit)] = values
        else:
            for x, component in zip(XYZ, values.T, strict=True):
                table[heading(f"{name} {x}", unit)] = component
    return table


def quantities_of(table: Mapping[str, NDArray[Any]]) -> dict[str, Quantity]:
    """Return columns with headings as quantities."""
    columns = {}
    for head, values in table.items():
        match = re.fullmatch(r"(.*) \[([^\[\]]*)\]", head)
        name, unit = (match[1], match[2]) if match else (head, "")
        columns[name] = Quantity(values, unit)
    return columns


def chosen(
    quantities: dict[str, Quantity], names: str | Iterable[str] | None, what: str
) -> dict[str, Quantity]:
    """Return those of the names, in their order; all for None.

    Raises:
        UnknownNameError: there is none of a name.
    """
    if names is None:
        return quantities
    for name in (wanted := names_of(names, "outputs")):
        if name not in quantities:
            raise UnknownNameError("column", name, quantities, f"{what}: ")
    return {name: quantities[name] for name in wanted}


def _imported(package: str, method: str, install: str) -> Any:
    try:
        return importlib.import_module(package)
    except ImportError as error:
        raise SpatialPinError(f"{method} needs {package}: pip install {install}; to_csv and to_npz "
                              "need nothing") from error


class Tabular:
    """What every result that is a table offers; it gives `quantities`."""

    __slots__ = ()

    def quantities(self, outputs: str | Iterable[str] | None = None) -> dict[str, Quantity]:
        """Return the quantities of the table by their names; see `columns`."""
        raise NotImplementedError

    def columns(self, outputs: str | Iterable[str] | None = None) -> dict[str, NDArray[Any]]:
        """Return the table as arrays (N,) by their headings, such as `crank rate [rad/s]`.

        Args:
            outputs: names of the wanted outputs, in this order; of a motion time and driver come
                before them. Default all that the table has.

        Raises:
            UnknownNameError: there is no such output.

        Example:
            >>> motion = sp.sweep(sp.load("four_bar"), "crank", [0.0, 0.5, 1.0], speed=2.0)
            >>> columns = motion.columns()  # arrays (N,) by their headings
            >>> list(columns)[:3], columns["crank [rad]"].shape
            (['time [s]', 'crank [rad]', 'crank_pin [rad]'], (3,))
            >>> list(motion.columns("coupler_b.velocity"))[2]
            'coupler_b velocity x [m/s]'
        """
        return flat(self.quantities(outputs))

    @overload
    def to_csv(self, path: None = None, outputs: str | Iterable[str] | None = None) -> str: ...

    @overload
    def to_csv(
        self, path: str | Path, outputs: str | Iterable[str] | None = None
    ) -> Path: ...

    @overload
    def to_csv(self, path: TextIO, outputs: str | Iterable[str] | None = None) -> None: ...

    def to_csv(
        self, path: str | Path | TextIO | None = None,
        outputs: str | Iterable[str] | None = None,
    ) -> str | Path | None:
        """Write `columns` as comma-separated values, with all digits.

        Args:
            path: a file's name, or an open text file, or None for the text itself.
            outputs: names of columns; default all.

        Returns:
            The path of the file; the text where there is no path.

        Raises:
            UnknownNameError: there is no such output.
            OSError: it cannot be written; an old file stays.

        Example:
            >>> motion = sp.sweep(sp.load("four_bar"), "crank", [0.0, 0.5, 1.0], speed=2.0)
            >>> motion.to_csv("motion.csv").name
            'motion.csv'
            >>> print(motion.to_csv(outputs=["crank_pin.rate"]))
            time [s],crank [rad],crank_pin rate [rad/s]
            0.0,0.0,2.0
            0.25,0.5,2.0
            0.5,1.0,2.0
        """
        table = self.columns(outputs)
        if path is None:
            text = io.StringIO()
            write_csv(text, table, "\n")
            return text.getvalue()
        if isinstance(path, str | os.PathLike) or not hasattr(path, "write"):
            return write_columns(named_path(path), table)
        write_csv(path, table, "\n")
        return None

    def to_npz(self, path: str | Path, outputs: str | Iterable[str] | None = None) -> Path:
        """Write `columns` as NumPy's .npz; `numpy.load(path)["crank [rad]"]` is a column again.

        Args:
            path: of the file; `.npz` is added where it is missing.
            outputs: names of columns; default all.

        Returns:
            The path.

        Raises:
            UnknownNameError: there is no such output.
            OSError: it cannot be written; an old file stays.

        Example:
            >>> motion = sp.sweep(sp.load("four_bar"), "crank", [0.0, 0.5, 1.0], speed=2.0)
            >>> with np.load(motion.to_npz("motion.npz")) as columns:
            ...     columns["crank [rad]"]
            array([0. , 0.5, 1. ])
        """
        return write_npz(path, self.columns(outputs))

    def to_dataframe(self, outputs: str | Iterable[str] | None = None) -> pandas.DataFrame:
        """Return `columns` as a pandas DataFrame, a row for each sample.

        Its `attrs["units"]` are the units by heading.

        Args:
            outputs: names of columns; default all.

        Raises:
            UnknownNameError: there is no such output.
            SpatialPinError: there is no pandas.

        Example:
            >>> motion = sp.sweep(sp.load("four_bar"), "crank", [0.0, 0.5, 1.0], speed=2.0)
            >>> frame = motion.to_dataframe(["rocker_pin"])
            >>> list(frame.columns), len(frame)
            (['time [s]', 'crank [rad]', 'rocker_pin [rad]'], 3)
        """
        pandas = _imported("pandas", "to_dataframe", "'spatial_pin[pandas]'")
        quantities = self.quantities(outputs)
        frame = pandas.DataFrame(flat(quantities))
        frame.attrs["units"] = {head: x.unit for name, x in quantities.items()
                                for head in flat({name: x})}
        return frame

    def to_xarray(self, outputs: str | Iterable[str] | None = None) -> xarray.Dataset:
        """Return the quantities as an xarray Dataset; vectors have a dimension "component".

        Variables have names without units, which are in `attrs["units"]` of each.

        Args:
            outputs: names of columns; default all.

        Raises:
            UnknownNameError: there is no such output.
            SpatialPinError: there is no xarray.

        Example:
            >>> motion = sp.sweep(sp.load("four_bar"), "crank", [0.0, 0.5, 1.0], speed=2.0)
            >>> found = motion.to_xarray(["coupler_b.velocity"])["coupler_b velocity"]
            >>> found.dims, found.attrs["units"]
            (('sample', 'component'), 'm/s')
        """
        xarray = _imported("xarray", "to_xarray", "xarray")
        quantities = self.quantities(outputs)
        dimensions = ("sample", "component")
        data = xarray.Dataset({name: (dimensions[: x.ndim], np.array(x), {"units": unit})
                               for name, (x, unit) in quantities.items()})
        return data.assign_coords(component=list(XYZ)) if "component" in data.dims else data


def write_npz(path: str | Path, arrays: Mapping[str, Any]) -> Path:
    """Write named arrays as .npz; returns the path.

    The suffix is added where it is missing, but not to the name of a pipe or device.

    Raises:
        OSError: it cannot be written; an old file stays.
    """
    path = named_path(path)
    if path.suffix != ".npz" and not is_special(path):
        path = path.with_name(path.name + ".npz")
    content = io.BytesIO()  # pipes cannot be written out of order
    np.savez_compressed(content, **arrays)
    with content.getbuffer() as whole:  # let go in an error too: freed as garbage it is a crash
        return write_bytes(path, whole)


def read_only(array: NDArray[Any]) -> NDArray[Any]:
    """Return a view of an array, in C order, that cannot be written to."""
    view = np.ascontiguousarray(array).view()
    view.setflags(False)  # type: ignore[call-arg]  # by keyword it takes twice as long
    return view
