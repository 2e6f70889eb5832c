"""Functions of a joint coordinate, as a coupling b = f(a) has them.

In a mechanism file a function is a table of one of these forms:

    {polynomial = [c0, c1, ...]}                  c0 + c1 a + c2 a^2 ...
    {points = [[a, b], ...], periodic = true}     the quintic spline through points
    {table = "cam.csv", periodic = true}          the same, of a file of two columns

In code it is one of these, or a function a -> (f, f', f'', f''').
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from spatial_pin._support.checks import numbers_or_none
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.piecewise import CalledFunction, Piecewise, quintic_spline

CLOSES = 1e-9  # of the range of values: round-off of a table whose last value is the first
FORMS = ("polynomial", "points", "table")


@dataclass(frozen=True, eq=False)
class CoordinateFunction:
    """A function of a joint coordinate.

    Attributes:
        curve: the function with its derivatives.
        form: it as a mechanism file has it; empty of a function in code.
    """

    curve: Piecewise | CalledFunction
    form: Mapping[str, Any] = field(default_factory=dict)

    def __str__(self) -> str:
        if "polynomial" in self.form:
            return f"a polynomial of degree {len(self.form['polynomial']) - 1}"
        if not self.form:
            return "a function in code"
        return (f"{len(self.form['points'])} points" + ", periodic" * self.form.get("periodic", 0))

    def tabulated(self, values: Any) -> CoordinateFunction:
        """Return it by a table.

        Args:
            values: (n,) rising, of the coordinate [rad or m]; or in how many equal parts a whole
                turn is cut, of a function that repeats with it.

        Raises:
            ValueError: they are none of these, or the function does not repeat.
        """
        repeats = isinstance(values, int | np.integer) and not isinstance(values, bool)
        if repeats and values < 4:
            raise ValueError(f"tabulate: a turn has four parts or more, not {values}")
        at = np.linspace(0.0, 2.0 * np.pi, int(values) + 1) if repeats else np.array(values, float)
        assert isinstance(self.curve, CalledFunction)
        points = np.array([[a, self.curve.function(a)[0]] for a in at.ravel().tolist()])
        return through(points, bool(repeats))


def polynomial(coefficients: Any) -> CoordinateFunction:
    """Return the polynomial of ascending coefficients; refuse others than finite numbers."""
    c = _numbers(coefficients, "polynomial", 1)
    return CoordinateFunction(Piecewise(np.array([0.0, 1.0]), c[None].copy()),
                              {"polynomial": c.tolist()})


def through(points: Any, periodic: bool = False) -> CoordinateFunction:
    """Return the quintic spline through points (n, 2), rows a, b with rising a.

    A periodic one repeats: the last b is the first.

    Raises:
        ValueError: they are no such points.
    """
    rows = _numbers(points, "points", 2)
    least = 5 if periodic else 2
    if rows.shape[1:] != (2,) or len(rows) < least:
        raise ValueError(f"points: {least} or more are needed, each of two numbers a, b"
                         + " (periodic: the last closes the period)" * periodic)
    a, b = rows.T.copy()
    if not np.all(np.diff(a) > 0.0):
        k = int(np.argmin(np.diff(a) > 0.0))
        what = "repeats" if a[k + 1] == a[k] else "goes back behind"
        raise ValueError(f"points: row {k + 2} {what} a = {a[k]:.9g} of the row before; a must "
                         "rise from row to row")
    if periodic:
        if abs(b[-1] - b[0]) > CLOSES * max(float(np.ptp(b)), float(np.abs(b).max())):
            raise ValueError(f"points: periodic, but the last b = {b[-1]:.9g} is not the first, "
                             f"{b[0]:.9g}: the last row is the first one a period on")
        b[-1] = b[0]
    form = {"points": np.column_stack([a, b]).tolist(), **({"periodic": True} if periodic else {})}
    return CoordinateFunction(quintic_spline(a, b, periodic), form)


def called(function: Callable[[float], Any]) -> CoordinateFunction:
    """Return a function in code, a -> (f, f', f'', f'''); refuse one without finite values at 0."""
    derivatives = np.array(function(0.0), float).ravel()
    if derivatives.shape != (4,) or not np.isfinite(derivatives).all():
        raise ValueError("a function of a coupling gives four finite numbers for a: its value and "
                         f"first three derivatives, not {str(derivatives.tolist())[:60]} at a = 0")
    return CoordinateFunction(CalledFunction(function))


def function_of(given: Any, context: Any = None) -> CoordinateFunction:
    """Return a function from its table in a mechanism file, see the module, or from code.

    The context has `rows`, from the name of a file to its rows (n, 2).

    Raises:
        ValueError: it is none; says why.
    """
    if callable(given):
        return called(given)
    words = ("is {polynomial = [0.0, 1.0, 0.5]}, {points = [[0.0, 0.0], ...]} or "
             '{table = "cam.csv"}; the last two may have periodic = true')
    keys = set(given) - {"periodic"} if isinstance(given, Mapping) else set()
    periodic = given.get("periodic", False) if keys else False
    if len(keys) != 1 or not keys <= set(FORMS) or not isinstance(periodic, bool):
        raise ValueError(words)
    (form,) = keys
    if form == "polynomial":
        if periodic:
            raise ValueError("a polynomial is not periodic")
        return polynomial(given[form])
    if form == "points":
        return through(given[form], periodic)
    if context is None or not isinstance(given[form], str):
        raise ValueError(words)
    return through(context.rows(given[form]), periodic)


def _numbers(values: Any, what: str, axes: int) -> Array:
    numbers = numbers_or_none(values)
    if numbers.ndim != axes or not numbers.size or not np.isfinite(numbers).all():
        raise ValueError(f"{what}: finite numbers are needed, not {str(values)[:60]}")
    return numbers
