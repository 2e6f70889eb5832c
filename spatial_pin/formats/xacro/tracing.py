"""Numbers of a xacro file that remember how they were computed from its arguments.

While a file is expanded, arguments may be `Traced` numbers. Arithmetic on them is written on a
`Tape`, which then gives every number of the expanded text at other values of the arguments: the
same operations once more, for many values together [GriewankWalther2008, 2]. Where the file
decides by such a number (an `if`, a `max`), the decision is written too; the tape holds for
arguments that lead to the same decisions. Where it cannot follow, as in rounded texts, it ends:
`is_whole` is false.

On its way a number often becomes text. The text of a traced number is no number but a reference:
its row on the tape between two characters of Unicode's private use, after its sign. The reader of
the expanded text gets the number from the tape.
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_REFERENCE = re.compile("\ue000(\\d+)\ue001")
_BETWEEN_WORDS = re.compile(r"""([\s"'<>]+)""")  # of a file


def _distance(*x: Any) -> Any:
    """Return the distance of two points, one behind the other."""
    half = len(x) // 2
    return np.sqrt(sum((a - b) ** 2 for a, b in zip(x[:half], x[half:], strict=True)))


NUMPY: dict[Callable[..., Any], Callable[..., Any]] = {  # of Python's functions of numbers
    **{getattr(math, name): getattr(np, name) for name in (
        "sin", "cos", "tan", "sinh", "cosh", "tanh", "sqrt", "exp", "expm1", "log10", "log2",
        "log1p", "fabs", "degrees", "radians", "fmod", "copysign")},
    math.asin: np.arcsin, math.acos: np.arccos, math.atan: np.arctan, math.atan2: np.arctan2,
    math.asinh: np.arcsinh, math.acosh: np.arccosh, math.atanh: np.arctanh,
    math.log: lambda x, base=math.e: np.log(x) if base == math.e else np.log(x) / np.log(base),
    math.pow: np.power,
    math.hypot: lambda *x: np.sqrt(sum(part * part for part in x)),
    math.dist: _distance,
}
DECISIONS: dict[Callable[..., Any], Callable[..., Any]] = {  # functions whose value must stay
    int: np.trunc, math.floor: np.floor, math.ceil: np.ceil, math.trunc: np.trunc,
}
FREE = (list, tuple, dict, min, max, sorted, any, all, bool, zip, enumerate, reversed, divmod)


Operation = tuple[Callable[..., Any], tuple[Any, ...]]  # a function of numbers, some traced


class Tape:
    """The operations on traced numbers, in order; the arguments, `names`, are the first numbers."""

    def __init__(self, arguments: Mapping[str, float]) -> None:
        self.is_whole = all(math.isfinite(x) for x in arguments.values())
        self.names = list(arguments)
        self._operations: list[Operation | None] = [None] * len(arguments)
        self._values = list(arguments.values())
        self._decisions: list[tuple[Operation, Any]] = []
        self._ordered: dict[Any, list[int]] = {}  # results of `_needed`

    def give_up(self) -> None:
        """Note that something cannot be followed."""
        self.is_whole = False

    def number(self, row: int) -> Traced:
        """Return the number at a place."""
        number = Traced(self._values[row])
        number.tape, number.row = self, row
        return number

    def write(self, value: float, function: Callable[..., Any], *arguments: Any) -> Traced:
        """Return the traced result of a function with traced arguments."""
        self._operations.append((function, arguments))
        self._values.append(value)
        if not math.isfinite(value):
            self.give_up()
        return self.number(len(self._values) - 1)

    def decide(self, value: Any, function: Callable[..., Any], *arguments: Any) -> Any:
        """Return the result of a function that must be the same for other arguments."""
        self._decisions.append(((function, arguments), value))
        return value

    def call(self, function: Callable[..., Any], given: Any, named: Mapping[str, Any]) -> Any:
        """Return the value of a function that is called in an expression."""
        if function is float and len(given) == 1 and not named:
            number = given[0] if isinstance(given[0], Traced) else self.read(given[0])
            return function(given[0]) if number is None else number
        value = function(*given, **named)
        if function in FREE or function is str or not depends((*given, *named.values())):
            return value
        numbers = [*given[0], *given[1]] if function is math.dist else given
        if named or any(depends(x) and not isinstance(x, Traced) for x in numbers):
            self.give_up()
        elif function in NUMPY:
            return self.write(value, NUMPY[function], *numbers)
        elif function in DECISIONS:
            return self.decide(value, DECISIONS[function], *numbers)
        else:
            self.give_up()
        return value

    def text(self, row: int) -> str:
        """Return the reference to a number, and its sign."""
        sign = "-" if math.copysign(1.0, self._values[row]) < 0.0 else ""
        return f"{sign}\ue000{row}\ue001"

    def read(self, text: Any) -> Traced | None:
        """Return the traced number that a text refers to; None if it is no reference."""
        word = text.strip() if isinstance(text, str) else ""
        match = _REFERENCE.fullmatch(word.lstrip("+-"))
        if match is None or len(word) - len(match[0]) > 1:
            return None
        size = self._size(match)
        return -size if word[0] == "-" else size

    def named(self, text: str) -> tuple[str, dict[str, Traced]]:
        """Return an expression with names in place of references to traced numbers."""
        names: dict[str, Traced] = {}

        def name(match: re.Match[str]) -> str:
            key = f"traced_{match[1]}"
            names[key] = self._size(match)
            return key

        return _REFERENCE.sub(name, text), names

    def pieces(self, text: str) -> tuple[list[str], list[int]] | None:
        """Return texts (k + 1,) between traced numbers of a text, and rows (k,), or None."""
        between, rows = list[list[str]]([[]]), list[int]()
        for word in _BETWEEN_WORDS.split(text):
            number = self.read(word) if depends(word) else None
            if number is not None:
                rows.append(number.row)
                between.append([])
            elif depends(word):
                return None
            else:
                between[-1].append(word)
        return ["".join(words) for words in between], rows

    def _size(self, match: re.Match[str]) -> Traced:
        """Return the size of the number of a reference: its sign is before the reference."""
        row = int(match[1])
        if row >= len(self._values):
            self.give_up()
            return self.number(0)
        number = self.number(row)
        return -number if math.copysign(1.0, number) < 0.0 else number

    def at(self, arguments: Array, rows: Iterable[int]) -> tuple[Array, NDArray[np.bool_]]:
        """Return numbers (len(rows), m) at arguments (len(names), m), and which are the file's."""
        wanted, m = list(rows), arguments.shape[1]
        values: list[Any] = list(arguments) + [None] * (len(self._operations) - len(arguments))
        needed = self._needed(tuple(wanted))
        holds = np.full(m, self.is_whole)
        with np.errstate(all="ignore"):  # arguments that give NaN are excluded below
            for row in needed:
                values[row] = _worked_out(self._operations[row], values)
            for operation, value in self._decisions:
                holds &= np.equal(_worked_out(operation, values), value)
        numbers = np.array([np.broadcast_to(values[p], m) for p in wanted]).reshape(len(wanted), m)
        return numbers, holds & np.isfinite(numbers).all(axis=0)

    def _needed(self, wanted: tuple[int, ...]) -> list[int]:
        """Return the rows, in order, of the operations that numbers and decisions are made of."""
        key = wanted, len(self._operations), len(self._decisions)
        if key not in self._ordered:
            todo = [*wanted, *(p for o, _ in self._decisions for p in _operand_rows(o))]
            seen = set()
            while todo:
                row = todo.pop()
                operation = self._operations[row]
                if operation is not None and row not in seen:
                    seen.add(row)
                    todo += _operand_rows(operation)
            self._ordered[key] = sorted(seen)
        return self._ordered[key]


def _operand_rows(operation: Operation) -> list[int]:
    return [x.row for x in operation[1] if isinstance(x, Traced)]


def _worked_out(operation: Operation | None, values: list[Any]) -> Any:
    assert operation is not None
    function, arguments = operation
    return function(*(values[x.row] if isinstance(x, Traced) else x for x in arguments))


def depends(value: Any) -> bool:
    """Whether a value is or holds a traced number or a reference to one."""
    stack = [value]
    while stack:
        item = stack.pop()
        if isinstance(item, Traced) or (isinstance(item, str) and _REFERENCE.search(item)):
            return True
        if isinstance(item, dict):
            stack += [*dict.keys(item), *dict.values(item)]
        elif isinstance(item, list | tuple | set | frozenset):
            stack += list.copy(item) if isinstance(item, list) else item
    return False


def _writing(name: str, function: Callable[..., Any], turned: bool = False) -> Any:
    """Return the method of an operator that gives a number."""
    own = getattr(float, name)

    def method(self: Traced, *others: Any) -> Any:
        value = own(self, *others)
        if value.__class__ is float:
            pair = (*others, self) if turned else (self, *others)
            return self.tape.write(value, function, *pair)
        if value is not NotImplemented:  # a complex power
            self.tape.give_up()
        return value

    return method


def _deciding(name: str, function: Callable[..., Any]) -> Any:
    """Return the method of a comparison."""
    own = getattr(float, name)

    def method(self: Traced, other: Any) -> Any:
        value = own(self, other)
        return value if value is NotImplemented else self.tape.decide(value, function, self, other)

    return method


class Traced(float):
    """A number that depends on arguments of the file, in the place of a plain one."""

    __slots__ = ("row", "tape")
    tape: Tape
    row: int
    __neg__ = _writing("__neg__", operator.neg)

    def __bool__(self) -> bool:
        return bool(self.tape.decide(float.__bool__(self), lambda x: np.not_equal(x, 0.0), self))

    def __str__(self) -> str:
        return self.tape.text(self.row)

    __repr__ = __str__

    def __format__(self, spec: str) -> str:
        if spec:
            self.tape.give_up()
        return str(self)

    def __hash__(self) -> int:  # whoever asks for it goes by the value
        self.tape.give_up()
        return float.__hash__(self)


for _name in ("add", "sub", "mul", "truediv", "floordiv", "mod", "pow", "pos", "abs"):
    setattr(Traced, f"__{_name}__", _writing(f"__{_name}__", getattr(operator, _name)))
for _name in ("add", "sub", "mul", "truediv", "floordiv", "mod", "pow"):
    setattr(Traced, f"__r{_name}__", _writing(f"__r{_name}__", getattr(operator, _name), True))
for _name in ("lt", "le", "gt", "ge", "eq", "ne"):
    setattr(Traced, f"__{_name}__", _deciding(f"__{_name}__", getattr(operator, _name)))
