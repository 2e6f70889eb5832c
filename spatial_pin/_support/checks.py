"""Checks of arguments: types, finite numbers, shapes and names."""

from __future__ import annotations

import functools
import math
import os
import re
from collections.abc import Callable, Mapping
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating[Any]]  # as in `numerics.linalg`, which is above
Row = TypeVar("Row")
Function = TypeVar("Function", bound=Callable[..., Any])
LARGEST_INTEGER = 2**63  # of whole numbers: what NumPy counts with
NO_NUMBERS = "USmMcV"  # kinds of arrays: texts, dates, complex numbers, records
FEW = 64  # numbers that Python has looked at before NumPy begins
MOST_PIXELS = 16384  # along a side of a picture that a browser draws
# How far the length of a unit vector may be from 1: nine digits written out, one more lost.
UNIT_TOLERANCE = 1e-9


def as_array(values: Any, what: str) -> Array:
    """Return `values` as float64 of the shape they have.

    Raises:
        ValueError: they are no numbers, or integers too large for one.
    """
    if type(values) is np.ndarray and values.dtype == np.float64:
        return values
    try:
        array = np.asarray(values)
        if array.dtype.kind not in NO_NUMBERS:
            return np.asarray(array, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        pass
    raise ValueError(f"{what} must be finite numbers, not {_beginning(values)}")


def numbers_or_none(values: Any) -> Array:
    """Return `values` as float64 of the shape they have, of shape (0, 0) if they are no numbers."""
    try:
        return np.array(values, float)
    except (TypeError, ValueError):
        return np.empty((0, 0))


def _beginning(values: Any) -> str:
    try:
        return str(values)[:60]
    except ValueError:  # Python does not write integers of thousands of digits
        return "integers of thousands of digits"


# ---------------------------------------------------------------- annotations


def _is_number(value: Any) -> bool:
    if isinstance(value, np.ndarray):
        return value.ndim == 0 and value.dtype.kind in "iuf"
    if isinstance(value, int):
        return not isinstance(value, bool) and math.isfinite(_as_float(value))
    return isinstance(value, float | np.integer | np.floating)


def _is_whole(value: Any) -> bool:
    return (_is_number(value) and abs(_as_float(value)) < LARGEST_INTEGER
            and float(value) == int(value))


def _as_float(value: Any) -> float:
    try:
        return float(value)
    except OverflowError:
        return math.inf


def _is_several(value: Any) -> bool:
    return getattr(value, "__iter__", None) is not None and not isinstance(value, bytes) and not (
        isinstance(value, np.ndarray) and value.ndim == 0)


# annotation: whether a value is of this kind, and the words for the kind
KINDS: dict[str, tuple[Callable[[Any], bool], str]] = {
    "None": (lambda x: x is None, "None"),
    "str": (lambda x: isinstance(x, str), "a name"),
    "bool": (lambda x: isinstance(x, bool | np.bool_), "True or False"),
    "int": (_is_whole, "a whole number"),
    "float": (_is_number, "a number"),
    "complex": (lambda x: _is_number(x) or isinstance(x, complex | np.complexfloating),
                "a complex number"),
    "Mapping": (lambda x: isinstance(x, Mapping), "a mapping as {'name': value}"),
    "Iterable": (_is_several, "a list"),
    "Sequence": (lambda x: _is_several(x) and hasattr(x, "__len__"), "a list"),
    "tuple": (lambda x: isinstance(x, tuple | list | np.ndarray), "a tuple"),
    "Array": (lambda x: isinstance(x, list | tuple | range | np.ndarray), "an array of numbers"),
    "Callable": (callable, "a function"),
    "EffortLaw": (callable, "a function of (time, state)"),
    "External": (lambda x: isinstance(x, Mapping) or callable(x),
                 "a mapping of forces by frame, or a function of the state that returns one"),
    "SlipSpeed": (lambda x: isinstance(x, Mapping) or _is_number(x),
                  "a speed, or a mapping of speeds by joint"),
    "Executor": (lambda x: hasattr(x, "submit"), "an executor of concurrent.futures"),
    "Measurement": (lambda x: hasattr(x, "cheapest"),
                    "what spatial_pin.tradeoff(mechanism, task) returns"),
    "Path": (lambda x: isinstance(x, os.PathLike), "a path"),
    "Output": (lambda x: hasattr(x, "values") and hasattr(x, "label"), "an Output"),
}
# classes whose objects are all of a kind: they need no check of each object
PLAIN: dict[str, tuple[type, ...]] = {
    "None": (type(None),), "str": (str,), "bool": (bool,), "float": (float,), "Mapping": (dict,),
    "Iterable": (list, tuple, dict), "Sequence": (list, tuple),
    "tuple": (tuple, list), "Array": (list, tuple, np.ndarray)}
# arguments that functions refuse in words of their own
OWN_WORDS = ("motion_or_state", "movie.motion", "plot.motion", "reduce.outputs", "tradeoff.task")
MADE_BY = {
    "Mechanism": "sp.load(name or file) makes one",
    "State": "sp.assemble(mechanism, {driver: value}) makes one",
    "Motion": "sp.sweep(mechanism, driver, values) or sp.simulate(mechanism, state, duration) "
              "makes one",
    "Vectors": "spatial_pin.Vectors(...) makes one",
    "Look": "sp.Look(...) makes one",
    "Clearance": "sp.clearance(motion) makes one",
    "Workspace": "sp.workspace(mechanism, frame, {driver: (least, largest)}) makes one",
    "Design": "sp.design(mechanism, goals, {dimension: (least, largest)})[0] is one",
    "Accuracy": "give it as spatial_pin.Accuracy, for example Accuracy.named('engineering')",
}


@functools.cache
def _is_kind_of(own: type, kind: str) -> bool:
    """Whether a class is one of the library, which are all above this module."""
    return any(c.__name__ == kind and c.__module__.startswith("spatial_pin.") for c in own.__mro__)


def _is_of(value: Any, kinds: list[str]) -> bool:
    for kind in kinds:
        own: Any = type(value)
        if _is_kind_of(own, kind) if kind in MADE_BY else KINDS[kind][0](value):
            return True
    return False


def _parts(annotation: str) -> list[str]:
    """Return the kinds that an annotation names: "Mapping[str, float] | None" names two."""
    bare = annotation
    while (inner := re.sub(r"\[[^\[\]]*\]", "", bare)) != bare:
        bare = inner
    return [part.strip().removeprefix("sp.") for part in bare.split("|")]


# verbs of a State that take a Motion too, all its samples at a time
OVER_MOTIONS = ("jacobian", "jacobian_rate", "influence", "solve_rates", "transmission",
                "closure_jacobian", "forward_dynamics", "inverse_dynamics",
                "dynamics_derivatives", "sensitivity")


def _refuse(where: str, kinds: list[str], value: Any) -> None:
    """Raise the error that names the kinds a value may have."""
    own = [kind for kind in kinds if kind in MADE_BY]
    if "State" in own and "Motion" in (kind.__name__ for kind in type(value).__mro__):
        raise TypeError(f"{where}: a State is needed, not a whole Motion: motion[k] is that of "
                        f"sample k. {', '.join(OVER_MOTIONS[:-1])} and {OVER_MOTIONS[-1]} take a "
                        "Motion too")
    if own and set(kinds) <= {*own, "None"}:
        a = "an" if own[0][0] in "AEIO" else "a"
        text = f"{_beginning(value)[:40]!r} of type " if isinstance(value, str) else ""
        raise TypeError(f"{where}: {a} {' or '.join(own)} is needed, not {text}"
                        f"{type(value).__name__}: {MADE_BY[own[0]]}")
    needed = [f"a {kind}" if kind in MADE_BY else KINDS[kind][1] for kind in kinds]
    needed = list(dict.fromkeys(needed))
    words = ", ".join(needed[:-1]) + " or " * (len(needed) > 1) + needed[-1]
    error = ValueError if {"float", "int"} & set(kinds) else TypeError
    raise error(f"{where} must be {words}, not {_shown(value)}")


def _shown(value: Any) -> str:
    if isinstance(value, str | bytes | bool | int | float | complex | type(None)):
        return _beginning(repr(value))
    return f"{_beginning(value)!r} of type {type(value).__name__}"


def check_kind(where: str, annotation: str, value: Any) -> None:
    """Refuse a value of another kind than its annotation.

    Raises:
        TypeError: it is of another kind.
        ValueError: a number is needed.
    """
    kinds = _parts(annotation)
    if not _is_of(value, kinds):
        _refuse(where, kinds, value)


def checked(function: Function) -> Function:
    """Return a public function that refuses arguments of another kind than it is annotated with.

    Kinds that `KINDS` and `MADE_BY` do not know are left to the function, as are values. A whole
    number arrives as an int, whatever it was.

    Raises:
        TypeError: an argument is of another kind.
        ValueError: a number is needed.
    """
    parts = {k: _parts(text) for k, text in function.__annotations__.items() if k != "return"}
    kinds = {k: x for k, x in parts.items()
             if not {k, f"{function.__name__}.{k}"} & set(OWN_WORDS)
             and all(y in KINDS or y in MADE_BY for y in x)}
    plain = {k: {own for kind in x for own in PLAIN.get(kind, ())} for k, x in kinds.items()}
    code = function.__code__
    names = code.co_varnames[: code.co_argcount]
    known: set[tuple[Any, ...]] = set()  # classes of arguments that need no check any more

    @functools.wraps(function)
    def call(*args: Any, **given: Any) -> Any:
        classes = ((*map(type, args), *given, *map(type, given.values())) if given
                   else (*map(type, args),))
        if classes in known:
            return function(*args, **given)
        whole: dict[str, int] = {}
        for name, value in (*zip(names, args, strict=False), *given.items()):
            if name in kinds and type(value) not in plain[name]:
                if not _is_of(value, kinds[name]):
                    _refuse(f"{function.__name__}: {name}", kinds[name], value)
                own: Any = type(value)
                if any(_is_kind_of(own, x) for x in kinds[name] if x in MADE_BY):
                    plain[name].add(own)  # its objects need no check any more
                if kinds[name] == ["int"] and not isinstance(value, int):
                    whole[name] = int(value)
        if whole:
            args = tuple(whole.pop(k, x) for k, x in zip(names, args, strict=False))
        elif all(type(x) in plain[k] for k, x in (*zip(names, args, strict=False), *given.items())
                 if k in kinds):
            known.add(classes)
        return function(*args, **(given | whole))

    return cast(Function, call)


# ---------------------------------------------------------------- values


def is_finite(array: Array) -> bool:
    """Whether no value of an array is NaN or infinite."""
    if array.size < FEW:
        return all(map(math.isfinite, array.ravel().tolist()))
    # of all that are finite the squares are as a rule: their sum is worked out the fastest
    return math.isfinite(np.vdot(array, array)) or bool(np.isfinite(array).all())


def finite_array(values: Any, shape: tuple[int, ...], what: str) -> Array:
    """Return `values` as float64 of that shape.

    Raises:
        ValueError: NaN, infinite, or another shape.
    """
    array = as_array(values, what)
    if array.shape != shape:
        needed = shape or "a single number"
        raise ValueError(f"{what} has shape {array.shape}; {needed} is needed")
    if not is_finite(array):
        raise ValueError(f"{what} has a value that is NaN or infinite")
    return array


def finite_points(values: Any, dimension: int, what: str) -> Array:
    """Return one point (dimension,) or several (N, dimension) as float64.

    Raises:
        ValueError: NaN, infinite, or another shape.
    """
    array = as_array(values, what)
    several = (len(array), dimension) if array.ndim == 2 else (dimension,)
    return finite_array(array, several, what)


def finite_number(value: Any, what: str) -> float:
    """Return `value` as a finite float.

    Raises:
        ValueError: NaN, infinite, or no number.
    """
    if isinstance(value, float) and math.isfinite(value):
        return float(value)
    if value is None or isinstance(value, str | bytes | bool):
        raise ValueError(f"{what} must be a number, not {value!r}")
    return float(finite_array(value, (), what))


def plain_text(value: str, what: str) -> str:
    """Return a text as it is.

    Raises:
        ValueError: it has a character that no file can have.
    """
    if any("\ud800" <= letter <= "\udfff" for letter in value):
        raise ValueError(f"{what} is {value!r:.60}, which no file can be written with")
    return value


def mapping(value: Any, what: str) -> Mapping[str, Any]:
    """Return `value`, names to numbers, as it is; nothing for None.

    Raises:
        TypeError: it is no mapping.
    """
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        raise TypeError(f"{what} must be a mapping as {{'name': value}}, not {_beginning(value)}")
    return value


def names_of(values: Any, what: str) -> list[str]:
    """Return the names in `values`: one, or several.

    Raises:
        TypeError: there is something else among them.
    """
    if isinstance(values, str):
        return [values]
    if not _is_several(values):
        raise TypeError(f"{what} must be names, not {_shown(values)}")
    names = list(values)
    for name in names:
        if not isinstance(name, str):
            raise TypeError(f"{what} must be names, not {_shown(name)}")
    return names


def rows_of(table: Any, make: Callable[..., Row], what: str) -> list[Row]:
    """Return the rows of a table, each as what `make` makes of its entries.

    Raises:
        TypeError: a row has other entries than it needs.
    """
    rows = []
    for i, row in enumerate(table, start=1):
        try:
            rows.append(make(*row))
        except TypeError:
            fields = ", ".join(getattr(make, "_fields", ()))
            raise TypeError(f"{what} {i} is {_shown(row)}; it is made of ({fields})") from None
    return rows


def whole_number(value: Any, what: str) -> int:
    """Return `value` as an int.

    Raises:
        ValueError: NaN, infinite, no number, or not a whole one.
    """
    number = finite_number(value, what)
    if number != int(number):
        raise ValueError(f"{what} is {value}; it is a whole number")
    return int(number)


def generator(seed: int) -> np.random.Generator:
    """Return a generator of random numbers.

    Raises:
        ValueError: the seed is negative.
    """
    if seed < 0:
        raise ValueError(f"seed is {seed}; it is a whole number from 0 up")
    return np.random.default_rng(int(seed))


def positive_number(value: Any, what: str) -> float:
    """Return `value` as a finite float above 0.

    Raises:
        ValueError: NaN, infinite, no number, or not positive.
    """
    if isinstance(value, float) and not 0.0 < value < math.inf:
        raise ValueError(f"{what} is {value}; it must be positive, and finite")
    number = finite_number(value, what)
    if not number > 0.0:
        raise ValueError(f"{what} is {value}; it must be positive")
    return number


def number_from_zero(value: Any, what: str) -> float:
    """Return `value` as a finite float that is not negative.

    Raises:
        ValueError: NaN, infinite, no number, or negative.
    """
    number = finite_number(value, what)
    if number < 0.0:
        raise ValueError(f"{what} is {value}; it cannot be negative")
    return number


def picture_size(size: Any) -> tuple[int, int]:
    """Return width and height [pixels].

    Raises:
        ValueError: they are no two whole numbers that a picture can have.
    """
    try:
        width, height = (whole_number(x, "size") for x in size)
        if min(width, height) >= 1 and max(width, height) <= MOST_PIXELS:
            return width, height
    except (TypeError, ValueError):
        pass
    raise ValueError(f"size is {_beginning(size)}; it is (width, height), each 1 to {MOST_PIXELS} "
                     "pixels")


def unit_vector(values: Any, what: str) -> Array:
    """Return `values` (3,) with its length, which is 1 to `UNIT_TOLERANCE`, made 1 to round-off.

    Raises:
        ValueError: NaN, infinite, another shape, or another length.
    """
    array = finite_array(values, (3,), what)
    length = math.hypot(*array)
    if abs(length - 1.0) > UNIT_TOLERANCE:
        raise ValueError(f"{what} has length {length:.9g}; a unit vector is needed")
    return array / length
