"""What may stand in `${...}` of a xacro file: sums and lists, not programs.

An expression has Python's grammar, but it is not run as Python. NODES lists the syntax that is
known, FUNCTIONS and METHODS what may be called; everything else is refused by name. No attribute
of an object is ever read: a dot means an entry of a dictionary or of a namespace, or a listed
method. Every value that is made is paid for from a `Budget`, before it is made where it can be
large, so that an expression can neither run without end nor fill the memory.

To offer a function: its line in FUNCTIONS. To offer a piece of syntax: a function from its node
to a function of the scope, and its line in NODES.
"""

from __future__ import annotations

import ast
import math
import operator
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache, reduce
from typing import Any

from spatial_pin.formats.xacro.tracing import Tape, depends

STEPS = 2_000_000  # of all expressions of a file: large robots need 1e5; so many take seconds
BITS = 1024  # of a whole number: those beyond are beyond the range of floating-point numbers too
SHARE = 16  # characters of a text, or elements of a list, that are copied in the time of one step
VISITS = 2  # elements that are looked at, one by one, in the time of one step
LARGEST_FACTORIAL = 1000  # argument of a factorial or binomial; 171! leaves the range of numbers


class RefusedError(Exception):
    """An expression asks for what is not offered, or for too much."""


class Budget:
    """The steps that are left to the expressions of one file.

    Attributes:
        left: how many.
        tape: where operations on traced numbers are written; None if there are none.
    """

    def __init__(self, tape: Tape | None = None) -> None:
        self.left, self.tape = STEPS, tape

    def spend(self, steps: int) -> None:
        """Take so many steps.

        Raises:
            RefusedError: there are none left.
        """
        self.left -= steps
        if self.left < 0:
            raise RefusedError(f"its expressions and macros take more than {STEPS:,} steps or "
                               "values; write fewer or smaller ones")

    def untraced(self, *values: Any) -> None:
        """Note that what is made of values is not written on the tape."""
        if self.tape is not None and depends(values):
            self.tape.give_up()


@dataclass(frozen=True)
class Offered:
    """A function that expressions may call.

    Attributes:
        name: as it is written.
        run: takes the budget, then the arguments.
        kind: the type that it stands for in `isinstance` and `type`, if any.
    """

    name: str
    run: Callable[..., Any] = field(repr=False)
    kind: type | None = None


class Library(dict[str, Any]):
    """A namespace of offered functions: its entries are read with a dot and cannot be changed."""


class Scope:
    """The names in reach of an expression, its variables of comprehensions, and its budget."""

    __slots__ = ("budget", "names", "own")

    def __init__(self, names: Mapping[str, Any], budget: Budget, own: Mapping[str, Any]) -> None:
        self.names, self.budget, self.own = names, budget, own


Value = Callable[[Scope], Any]
NOTHING: dict[str, Any] = {}


def evaluate(text: str, names: Mapping[str, Any], budget: Budget) -> Any:
    """Return the value of an expression.

    Args:
        text: the expression.
        names: value of every name; `GLOBALS` holds those of xacro's that do not touch files.
        budget: what it may spend.

    Raises:
        RefusedError: it asks for what is not offered, or for too much.
        Exception: as Python's own operators, on values that they cannot work with.
    """
    budget.spend(1)
    if budget.tape is not None:
        text, own = budget.tape.named(text)
        return _compiled(text)(Scope(names, budget, own))
    return _compiled(text)(Scope(names, budget, NOTHING))


@lru_cache(maxsize=4096)
def _compiled(text: str) -> Value:
    try:
        return _value(ast.parse(text.strip(), mode="eval").body)
    except (SyntaxError, ValueError) as error:
        raise RefusedError(f"not an expression: {getattr(error, 'msg', error)}") from None
    except (RecursionError, MemoryError):
        raise RefusedError("too deeply nested") from None


def _value(node: ast.AST) -> Value:
    make = NODES.get(type(node))
    if make is None:
        known = type(node).__name__
        raise RefusedError(f"{WORDS.get(known, known)} is not offered here")
    return make(node)


WORDS = {"Lambda": "lambda", "NamedExpr": "an assignment (:=)", "JoinedStr": "an f-string",
         "Await": "await", "Yield": "yield", "YieldFrom": "yield", "Starred": "a star (*)",
         "DictComp": "a dictionary comprehension"}


# ---------------------------------------------------------------- size


def _paid(value: Any, budget: Budget) -> Any:
    """Return a value that was made, paid for."""
    kind = value.__class__
    if kind is float or kind is bool or value is None:
        return value
    if kind is int:
        if value.bit_length() > BITS:
            raise RefusedError("a whole number leaves the range of numbers (1e308)")
    elif kind is complex:
        raise RefusedError("the result is complex")
    elif hasattr(kind, "__len__"):
        budget.spend(len(value) // SHARE)
    return value


HOLDERS = (str, list, tuple, dict, set, frozenset, range)


def measure(value: Any, budget: Budget) -> None:
    """Pay for going once through all that a value holds, however deep."""
    kind = value.__class__
    if kind is float or kind is int or (kind is str and len(value) < SHARE):
        return
    if not isinstance(value, HOLDERS):
        return
    size, most = 0, budget.left * VISITS
    stack = [value]
    while stack:
        item = stack.pop()
        size += 1
        if isinstance(item, str):
            size += len(item) // SHARE
        elif isinstance(item, range):
            size += len(item)
        elif isinstance(item, dict):
            stack += [*dict.keys(item), *dict.values(item)]
        elif isinstance(item, HOLDERS):
            stack += list.copy(item) if isinstance(item, list) else item  # as it is, not wrapped
        if size > most:
            break
    budget.spend(size // VISITS + 1)


def _items(values: Any, budget: Budget) -> list[Any]:
    """Return the elements of a value as a list, paid for before it is made."""
    if hasattr(values.__class__, "__len__"):
        budget.spend(len(values) // SHARE)
    return list(values)


# ---------------------------------------------------------------- operators


def _times(a: Any, b: Any, budget: Budget) -> Any:
    for many, count in ((a, b), (b, a)):
        if isinstance(many, str | list | tuple) and isinstance(count, int):
            budget.spend(len(many) * max(count, 0) // SHARE)
    return a * b


def _power(a: Any, b: Any, budget: Budget) -> Any:
    if isinstance(a, int) and isinstance(b, int) and abs(a) > 1 and b * a.bit_length() > 2 * BITS:
        raise RefusedError("a power leaves the range of numbers (1e308)")
    return a**b


def _shifted(a: Any, b: Any, budget: Budget) -> Any:
    if isinstance(b, int) and b > BITS:
        raise RefusedError("a shift leaves the range of numbers (1e308)")
    return a << b


def _modulo(a: Any, b: Any, budget: Budget) -> Any:
    if isinstance(a, str):
        measure(b, budget)
        if re.search(r"%(\([^()%]*\))?[^a-zA-Z%]*(\*|\d{4})", a):
            raise RefusedError("a format wider than 999, or of a width *, is not offered here")
        budget.spend(sum(int(width) for width in re.findall(r"\d{1,3}", a)) // SHARE)
        if a.count("%") > a.count("%s"):  # another format rounds
            budget.untraced(b)
    return a % b


OPERATORS: dict[type[ast.AST], Callable[[Any, Any, Budget], Any]] = {
    ast.Add: lambda a, b, budget: a + b,
    ast.Sub: lambda a, b, budget: a - b,
    ast.Mult: _times,
    ast.Div: lambda a, b, budget: a / b,
    ast.FloorDiv: lambda a, b, budget: a // b,
    ast.Mod: _modulo,
    ast.Pow: _power,
    ast.LShift: _shifted,
    ast.RShift: lambda a, b, budget: a >> b,
    ast.BitAnd: lambda a, b, budget: a & b,
    ast.BitOr: lambda a, b, budget: a | b,
    ast.BitXor: lambda a, b, budget: a ^ b,
}
SIGNS: dict[type[ast.AST], Callable[[Any], Any]] = {
    ast.UAdd: operator.pos, ast.USub: operator.neg, ast.Not: operator.not_,
    ast.Invert: operator.invert,
}
COMPARISONS: dict[type[ast.AST], Callable[[Any, Any], Any]] = {
    ast.Eq: operator.eq, ast.NotEq: operator.ne, ast.Lt: operator.lt, ast.LtE: operator.le,
    ast.Gt: operator.gt, ast.GtE: operator.ge, ast.Is: operator.is_, ast.IsNot: operator.is_not,
    ast.In: lambda a, b: a in b, ast.NotIn: lambda a, b: a not in b,
}


def _binary(node: ast.BinOp) -> Value:
    if type(node.op) not in OPERATORS:
        raise RefusedError("the operator @ is not offered here")
    left, right, apply = _value(node.left), _value(node.right), OPERATORS[type(node.op)]

    def value(scope: Scope) -> Any:
        return _paid(apply(left(scope), right(scope), scope.budget), scope.budget)

    return value


def _unary(node: ast.UnaryOp) -> Value:
    operand, apply = _value(node.operand), SIGNS[type(node.op)]
    return lambda scope: apply(operand(scope))


def _boolean(node: ast.BoolOp) -> Value:
    operands, stops_at = [_value(x) for x in node.values], isinstance(node.op, ast.Or)

    def value(scope: Scope) -> Any:
        for operand in operands:
            result = operand(scope)
            if bool(result) is stops_at:
                break
        return result

    return value


def _comparison(node: ast.Compare) -> Value:
    first = _value(node.left)
    rest = [(COMPARISONS[type(op)], _value(x)) for op, x in
            zip(node.ops, node.comparators, strict=True)]

    def value(scope: Scope) -> Any:
        left, result = first(scope), True
        for compare, right in rest:
            other = right(scope)
            _compared(left, other, scope.budget)
            result = compare(left, other)
            if not result:
                break
            left = other
        return result

    return value


def _compared(left: Any, right: Any, budget: Budget) -> None:
    """Pay for a comparison."""
    if not isinstance(left, float | int) or not isinstance(right, float | int):
        budget.untraced(left, right)
    measure(left, budget)
    if isinstance(right, range) and isinstance(left, int):
        return  # a number is sought in it without going through it
    if not isinstance(right, dict) or isinstance(left, dict):  # a key is sought in the same way
        measure(right, budget)


def _conditional(node: ast.IfExp) -> Value:
    test, yes, no = _value(node.test), _value(node.body), _value(node.orelse)
    return lambda scope: yes(scope) if test(scope) else no(scope)


# ---------------------------------------------------------------- literals, names, entries


def _constant(node: ast.Constant) -> Value:
    constant = node.value
    if not isinstance(constant, str | int | float | None):
        raise RefusedError(f"{str(constant)[:20]} is not offered here: only numbers and texts are")
    _paid(constant, Budget())
    return lambda scope: constant


def _name(node: ast.Name) -> Value:
    name = node.id
    if name.startswith("__"):
        raise RefusedError(f"the name {name} is not offered here")

    def value(scope: Scope) -> Any:
        if name in scope.own:
            return scope.own[name]
        try:
            return scope.names[name]
        except KeyError as error:
            hint = f"; write python.{name}" if name in _PYTHON else ""
            raise RefusedError(f"name {str(error.args[0])!r} is not defined{hint}") from None

    return value


def _sequence(node: ast.List | ast.Tuple | ast.Set) -> Value:
    elements = _elements(node.elts)
    if isinstance(node, ast.List):
        return elements
    kind = tuple if isinstance(node, ast.Tuple) else set

    def value(scope: Scope) -> Any:
        found = elements(scope)
        if kind is set:
            measure(found, scope.budget)
        return kind(found)

    return value


def _elements(nodes: list[ast.expr]) -> Callable[[Scope], list[Any]]:
    """Return what gives the list of some values, of which `*values` are several."""
    parts = [(isinstance(x, ast.Starred), _value(x.value if isinstance(x, ast.Starred) else x))
             for x in nodes]

    def values(scope: Scope) -> list[Any]:
        scope.budget.spend(len(parts))
        found: list[Any] = []
        for starred, part in parts:
            found += _items(part(scope), scope.budget) if starred else [part(scope)]
        return found

    return values


def _dictionary(node: ast.Dict) -> Value:
    if None in node.keys:
        raise RefusedError("** is not offered here")
    pairs = [(_value(k), _value(v)) for k, v in zip(node.keys, node.values, strict=True) if k]

    def value(scope: Scope) -> Any:
        found = [(k(scope), v(scope)) for k, v in pairs]
        measure(found, scope.budget)
        return dict(found)

    return value


def _subscript(node: ast.Subscript) -> Value:
    holder, index = _value(node.value), _value(node.slice)

    def value(scope: Scope) -> Any:
        held, place = holder(scope), index(scope)
        measure(place, scope.budget)
        if isinstance(held, str):
            scope.budget.untraced(held)
        try:
            return _paid(held[place], scope.budget)
        except (KeyError, AttributeError):  # as xacro's own dictionaries raise it
            raise RefusedError(f"there is no {place!r} in it") from None

    return value


def _slice(node: ast.Slice) -> Value:
    ends = [_value(x) if x else None for x in (node.lower, node.upper, node.step)]
    return lambda scope: slice(*(end(scope) if end else None for end in ends))


def _entry(node: ast.Attribute) -> Value:
    holder, name = _value(node.value), _checked(node.attr)
    return lambda scope: _entry_of(holder(scope), name)


def _checked(name: str) -> str:
    if name.startswith("__"):
        raise RefusedError(f"the attribute {name} is not offered here")
    return name


def _entry_of(holder: Any, name: str) -> Any:
    if not isinstance(holder, dict):
        raise RefusedError(f"the attribute {name} of a {_kind(holder)} is not offered here")
    try:
        return holder[name]
    except (KeyError, AttributeError):  # as xacro's own dictionaries raise it
        raise RefusedError(f"there is no {name!r} in it") from None


def _kind(value: Any) -> str:
    return "function" if isinstance(value, Offered) else type(value).__name__


def _comprehension(node: ast.ListComp | ast.GeneratorExp | ast.SetComp) -> Value:
    element, kind = _value(node.elt), set if isinstance(node, ast.SetComp) else list
    loops = [(_target(g.target), _value(g.iter), [_value(x) for x in g.ifs])
             for g in node.generators]

    def turns(scope: Scope, depth: int) -> Iterable[Any]:
        if depth == len(loops):
            scope.budget.spend(1)
            yield element(scope)
            return
        target, values, tests = loops[depth]
        for item in _items(values(scope), scope.budget):
            inner = Scope(scope.names, scope.budget, {**scope.own, **target(item)})
            if all(test(inner) for test in tests):
                yield from turns(inner, depth + 1)

    return lambda scope: kind(turns(scope, 0))


def _target(node: ast.expr) -> Callable[[Any], dict[str, Any]]:
    """Return what gives the variables of a comprehension their values."""
    if isinstance(node, ast.Name):
        name = _checked(node.id)
        return lambda item: {name: item}
    if not isinstance(node, ast.Tuple | ast.List):
        raise RefusedError("only names can be the variables of a comprehension")
    parts = [_target(x) for x in node.elts]

    def values(item: Any) -> dict[str, Any]:
        pieces = list(item)
        if len(pieces) != len(parts):
            raise RefusedError(f"{len(pieces)} values for {len(parts)} names")
        return {k: v for part, x in zip(parts, pieces, strict=True) for k, v in part(x).items()}

    return values


# ---------------------------------------------------------------- calls


def _call(node: ast.Call) -> Value:
    if any(k.arg is None for k in node.keywords):
        raise RefusedError("** is not offered here")
    arguments = _elements(node.args)
    keywords = {k.arg: _value(k.value) for k in node.keywords if k.arg}
    function = _callee(node.func)

    def value(scope: Scope) -> Any:
        run = function(scope)
        given = arguments(scope)
        named = {key: argument(scope) for key, argument in keywords.items()}
        scope.budget.spend(1)
        return _paid(run(scope.budget, *given, **named), scope.budget)

    return value


def _callee(node: ast.expr) -> Callable[[Scope], Callable[..., Any]]:
    written = ast.unparse(node)[:60]
    if not isinstance(node, ast.Attribute):
        found = _value(node)
        return lambda scope: _runnable(found(scope), written)
    holder, name = _value(node.value), _checked(node.attr)

    def method(scope: Scope) -> Callable[..., Any]:
        owner = holder(scope)
        kind = next((k for k in METHODS if isinstance(owner, k)), None)
        if kind is None or isinstance(owner, Library) or name not in METHODS[kind]:
            if not isinstance(owner, dict):
                raise RefusedError(f"the method {name} of a {_kind(owner)} is not offered here")
            return _runnable(_entry_of(owner, name), written)
        return lambda budget, *a, **k: _method(kind, name, budget, owner, *a, **k)

    return method


def _runnable(function: Any, written: str) -> Callable[..., Any]:
    if not isinstance(function, Offered):
        raise RefusedError(f"{written} is not a function that is offered here")
    return function.run


METHODS: dict[type, tuple[str, ...]] = {
    str: ("capitalize", "casefold", "center", "count", "endswith", "find", "index", "isalnum",
          "isalpha", "isdigit", "islower", "isnumeric", "isspace", "isupper", "join", "ljust",
          "lower", "lstrip", "partition", "removeprefix", "removesuffix", "replace", "rfind",
          "rindex", "rjust", "rpartition", "rsplit", "rstrip", "split", "splitlines", "startswith",
          "strip", "swapcase", "title", "upper", "zfill"),
    list: ("append", "copy", "count", "extend", "index", "insert", "pop", "remove", "reverse",
           "sort"),
    tuple: ("count", "index"),
    dict: ("copy", "get", "items", "keys", "pop", "setdefault", "update", "values"),
    set: ("add", "difference", "discard", "intersection", "issubset", "union"),
}
WIDENING = ("center", "ljust", "rjust", "zfill")
WHOLE_WORDS = ("join", "split", "rsplit", "splitlines", "strip", "lstrip", "rstrip")  # or nothing


def _method(kind: type, name: str, budget: Budget, owner: Any, *given: Any, **named: Any) -> Any:
    for argument in given:
        measure(argument, budget)
    if kind is not dict:
        measure(owner, budget)
    if kind is str and name not in WHOLE_WORDS:
        budget.untraced(owner, given)
    if name in WIDENING and given and isinstance(given[0], int):
        budget.spend(max(given[0], 0) // SHARE)
    if name == "replace" and len(given) > 1:
        times = owner.count(given[0])
        budget.spend(times * len(given[1]) // SHARE)
    if name == "join" and given:
        given = (_items(given[0], budget),)
        texts = sum(len(text) for text in given[0] if isinstance(text, str))
        budget.spend((len(given[0]) * len(owner) + texts) // SHARE)
    result = getattr(kind, name)(owner, *given, **named)
    return list(result) if name in ("items", "keys", "values") else result


def _direct(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function whose work is that of going once through its arguments."""

    def run(budget: Budget, *given: Any, **named: Any) -> Any:
        for argument in (*given, *named.values()):
            measure(argument, budget)
        if budget.tape is not None:
            return budget.tape.call(function, given, named)
        return function(*given, **named)

    return run


def _listed(function: Callable[..., Iterable[Any]]) -> Callable[..., Any]:
    """Return a function that gives a list where Python's gives it element by element."""

    def run(budget: Budget, *given: Any, **named: Any) -> Any:
        return list(_direct(function)(budget, *given, **named))

    return run


def _small(function: Callable[..., int]) -> Callable[..., Any]:
    def run(budget: Budget, *given: Any) -> Any:
        if any(isinstance(x, int) and x > LARGEST_FACTORIAL for x in given):
            raise RefusedError(f"only of numbers up to {LARGEST_FACTORIAL}")
        return function(*given)

    return run


def _folded(combine: Callable[[Any, Any, Budget], Any], start: Any) -> Callable[..., Any]:
    """Return a function that combines the elements of a list one by one."""

    def run(budget: Budget, values: Any, start: Any = start) -> Any:
        return reduce(lambda a, b: _paid(combine(a, b, budget), budget),
                      _items(values, budget), start)

    return run


def _round(budget: Budget, value: Any, digits: int | None = None) -> Any:
    if isinstance(digits, int) and abs(digits) > BITS:
        raise RefusedError(f"only to {BITS} digits")
    budget.untraced(value)
    return round(value, digits)


def _mapped(budget: Budget, function: Any, *lists: Any) -> list[Any]:
    run = _runnable(function, "map's first argument")
    return [_paid(run(budget, *given), budget)
            for given in zip(*(_items(x, budget) for x in lists), strict=False)]


def _filtered(budget: Budget, function: Any, values: Any) -> list[Any]:
    run = _runnable(function, "filter's first argument") if function is not None else None
    return [x for x in _items(values, budget) if (run(budget, x) if run else x)]


def _isinstance(budget: Budget, value: Any, kinds: Any) -> bool:
    several = kinds if isinstance(kinds, tuple) else (kinds,)
    return isinstance(value, tuple(k.kind for k in several if isinstance(k, Offered) and k.kind))


def _type(budget: Budget, value: Any) -> Offered:
    for offered in (_TYPES["bool"], *_TYPES.values()):
        if offered.kind is not None and isinstance(value, offered.kind):
            return offered
    raise RefusedError(f"the type of a {_kind(value)} is not offered here")


def _length(budget: Budget, value: Any) -> int:
    if isinstance(value, str):
        budget.untraced(value)
    return len(value)


_TYPES = {kind.__name__: Offered(kind.__name__, _direct(kind), kind) for kind in
          (list, dict, str, float, int, bool, tuple, set, frozenset)}
_RANGE = Offered("range", lambda budget, *given: range(*given))
_OLD = {  # in the namespace `python`, and by themselves
    **{name: _TYPES[name] for name in ("list", "dict", "str", "float", "int", "bool")},
    "map": Offered("map", _mapped), "len": Offered("len", _length),
    "min": Offered("min", _direct(min)), "max": Offered("max", _direct(max)),
    "round": Offered("round", _round), "sorted": Offered("sorted", _direct(sorted)),
    "range": _RANGE, "True": True, "False": False,
}
_PYTHON = Library({
    **_OLD, **_TYPES,
    "abs": Offered("abs", lambda budget, x: abs(x)), "all": Offered("all", _direct(all)),
    "any": Offered("any", _direct(any)), "divmod": Offered("divmod", _direct(divmod)),
    "enumerate": Offered("enumerate", _listed(enumerate)),
    "filter": Offered("filter", _filtered), "isinstance": Offered("isinstance", _isinstance),
    "ord": Offered("ord", _direct(ord)), "repr": Offered("repr", _direct(repr)),
    "reversed": Offered("reversed", _listed(reversed)),
    "sum": Offered("sum", _folded(OPERATORS[ast.Add], 0)), "type": Offered("type", _type),
    "zip": Offered("zip", _listed(zip)),
})
_MATH = Library({name: Offered(name, _direct(entry)) if callable(entry) else entry
                 for name, entry in vars(math).items() if not name.startswith("_")})
_MATH.update(
    {name: Offered(name, _small(vars(math)[name])) for name in ("factorial", "comb", "perm")},
    prod=Offered("prod", _folded(_times, 1)),
    lcm=Offered("lcm", lambda budget, *given: _folded(lambda a, b, _: math.lcm(a, b), 1)(
        budget, given)),
)
_MATH.pop("sumprod", None)
GLOBALS: dict[str, Any] = {**_MATH, **_OLD, "python": _PYTHON, "math": _MATH}

NODES: dict[type[ast.AST], Callable[[Any], Value]] = {
    ast.Constant: _constant,
    ast.Name: _name,
    ast.List: _sequence,
    ast.Tuple: _sequence,
    ast.Set: _sequence,
    ast.Dict: _dictionary,
    ast.BinOp: _binary,
    ast.UnaryOp: _unary,
    ast.BoolOp: _boolean,
    ast.Compare: _comparison,
    ast.IfExp: _conditional,
    ast.Subscript: _subscript,
    ast.Slice: _slice,
    ast.Attribute: _entry,
    ast.Call: _call,
    ast.ListComp: _comprehension,
    ast.SetComp: _comprehension,
    ast.GeneratorExp: _comprehension,
}
