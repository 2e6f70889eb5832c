"""The value of an expression `${...}` of a xacro file: arithmetic and lists, not programs.

An expression has Python's grammar, but it is not run as Python. `_Evaluation` has a method for each
piece of syntax that is offered, GLOBALS and METHODS list the functions; everything else is refused
by name. No attribute of an object is ever read: a dot means an entry of a dictionary or of a
namespace, or a listed method. Every new value is paid for from a `Budget`, and a large one is paid
for before it is made. So an expression can neither run without end nor fill the memory.

To offer a function: its line in GLOBALS. To offer a piece of syntax: a `visit_` method.
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

STEPS = 2_000_000  # of all expressions of a file: large robots need 1e5; 2e6 take seconds
BITS = 1024  # of a whole number: those beyond are beyond the range of floating-point numbers too
SHARE = 16  # characters of a text, or elements of a list, that are copied in the time of one step
VISITS = 2  # elements that are looked at, one by one, in the time of one step
LARGEST_FACTORIAL = 1000  # argument of a factorial or binomial; 171! leaves the range of numbers


class RefusedError(Exception):
    """An expression uses something that is not offered, or too many steps."""


class Budget:
    """The steps that remain for the expressions of one file, and a tape of traced numbers."""

    def __init__(self, tape: Tape | None = None) -> None:
        self.remaining, self.tape = STEPS, tape

    def spend(self, steps: int) -> None:
        """Take steps."""
        self.remaining -= steps
        if self.remaining < 0:
            raise RefusedError(f"its expressions and macros take more than {STEPS:,} steps or "
                               "values; write fewer or smaller ones")

    def untraced(self, *values: Any) -> None:
        """Note that a result of these values is not on the tape."""
        if self.tape is not None and depends(values):
            self.tape.give_up()


@dataclass(frozen=True)
class Offered:
    """A function that expressions may call, by its name; `kind` is a type that it stands for."""

    name: str
    run: Callable[..., Any] = field(repr=False)
    kind: type | None = None


class Library(dict[str, Any]):
    """A namespace of offered functions: its entries are read with a dot and cannot be changed."""


def evaluate(text: str, names: Mapping[str, Any], budget: Budget) -> Any:
    """Return the value of an expression, its names from a mapping and paid for from a budget.

    Raises:
        RefusedError: it uses syntax or names that are not offered, or needs too many steps.
        Exception: as Python's own operators, on values that they cannot work with.
    """
    budget.spend(1)
    own: Mapping[str, Any] = {}
    if budget.tape is not None:
        text, own = budget.tape.named(text)
    return _Evaluation(names, budget, own).visit(_tree(text))


@lru_cache(maxsize=4096)
def _tree(text: str) -> ast.expr:
    """Return the syntax tree of an expression; all of its syntax is offered."""
    try:
        tree = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError) as error:
        raise RefusedError(f"not an expression: {getattr(error, 'msg', error)}") from None
    except (RecursionError, MemoryError):
        raise RefusedError("too deeply nested") from None
    for node in ast.walk(tree):
        if isinstance(node, ast.comprehension):
            if not all(isinstance(x, TARGETS) for x in ast.walk(node.target)):
                raise RefusedError("only names can be the variables of a comprehension")
        elif isinstance(node, ast.Constant):
            if not isinstance(node.value, str | int | float | None):
                raise RefusedError(f"{str(node.value)[:20]} is not offered here: only numbers and "
                                   "texts are")
            _paid(node.value, Budget())
        elif (reason := _refusal(node)) is not None:
            raise RefusedError(f"{reason} is not offered here")
    return tree


def _refusal(node: ast.AST) -> str | None:
    """Return the syntax or name of a node that is not offered; None if it is offered."""
    kind = type(node).__name__
    if isinstance(node, ast.Name) and node.id.startswith("__"):
        return f"the name {node.id}"
    if isinstance(node, ast.Attribute) and node.attr.startswith("__"):
        return f"the attribute {node.attr}"
    if (isinstance(node, ast.keyword) and node.arg is None) or (
            isinstance(node, ast.Dict) and None in node.keys):
        return "**"
    if isinstance(node, ast.MatMult):
        return "the operator @"
    is_offered = not isinstance(node, ast.expr) or isinstance(node, ast.Starred) or hasattr(
        _Evaluation, f"visit_{kind}")
    return None if is_offered else WORDS.get(kind, kind)


TARGETS = (ast.Name, ast.Tuple, ast.List, ast.expr_context)  # of a comprehension's variables
WORDS = {"Lambda": "lambda", "NamedExpr": "an assignment (:=)", "JoinedStr": "an f-string",
         "Await": "await", "Yield": "yield", "YieldFrom": "yield",
         "DictComp": "a dictionary comprehension"}


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
    size, most = 0, budget.remaining * VISITS
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


class _Evaluation(ast.NodeVisitor):
    """The evaluation of one syntax tree, a method for a kind of node; `own` are its variables."""

    def __init__(self, names: Mapping[str, Any], budget: Budget, own: Mapping[str, Any]) -> None:
        self.names, self.budget, self.own = names, budget, own

    def visit_Constant(self, node: ast.Constant) -> Any:
        return node.value

    def visit_Name(self, node: ast.Name) -> Any:
        if node.id in self.own:
            return self.own[node.id]
        try:
            return self.names[node.id]
        except KeyError as error:
            hint = f"; write python.{node.id}" if node.id in _PYTHON else ""
            raise RefusedError(f"name {str(error.args[0])!r} is not defined{hint}") from None

    def visit_BinOp(self, node: ast.BinOp) -> Any:
        left, right = self.visit(node.left), self.visit(node.right)
        return _paid(OPERATORS[type(node.op)](left, right, self.budget), self.budget)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> Any:
        return SIGNS[type(node.op)](self.visit(node.operand))

    def visit_BoolOp(self, node: ast.BoolOp) -> Any:
        for operand in node.values:
            result = self.visit(operand)
            if bool(result) is isinstance(node.op, ast.Or):
                break
        return result

    def visit_Compare(self, node: ast.Compare) -> Any:
        left, result = self.visit(node.left), True
        for operator_, operand in zip(node.ops, node.comparators, strict=True):
            right = self.visit(operand)
            if not isinstance(left, float | int) or not isinstance(right, float | int):
                self.budget.untraced(left, right)
            measure(left, self.budget)
            is_looked_up = (isinstance(right, range) and isinstance(left, int)) or (
                isinstance(right, dict) and not isinstance(left, dict))
            if not is_looked_up:  # else `in` does not go through it
                measure(right, self.budget)
            result = COMPARISONS[type(operator_)](left, right)
            if not result:
                break
            left = right
        return result

    def visit_IfExp(self, node: ast.IfExp) -> Any:
        return self.visit(node.body if self.visit(node.test) else node.orelse)

    def elements(self, nodes: list[ast.expr]) -> list[Any]:
        """Return the values of a list; `*values` stands for several."""
        self.budget.spend(len(nodes))
        values: list[Any] = []
        for node in nodes:
            values += (_items(self.visit(node.value), self.budget)
                       if isinstance(node, ast.Starred) else [self.visit(node)])
        return values

    def visit_List(self, node: ast.List) -> Any:
        return self.elements(node.elts)

    def visit_Tuple(self, node: ast.Tuple) -> Any:
        return tuple(self.elements(node.elts))

    def visit_Set(self, node: ast.Set) -> Any:
        values = self.elements(node.elts)
        measure(values, self.budget)
        return set(values)

    def visit_Dict(self, node: ast.Dict) -> Any:
        entries = [(self.visit(k), self.visit(v))
                   for k, v in zip(node.keys, node.values, strict=True) if k is not None]
        measure(entries, self.budget)
        return dict(entries)

    def visit_Subscript(self, node: ast.Subscript) -> Any:
        holder, key = self.visit(node.value), self.visit(node.slice)
        measure(key, self.budget)
        if isinstance(holder, str):
            self.budget.untraced(holder)
        try:
            return _paid(holder[key], self.budget)
        except (KeyError, AttributeError):  # as xacro's own dictionaries raise it
            raise RefusedError(f"there is no {key!r} in it") from None

    def visit_Slice(self, node: ast.Slice) -> Any:
        return slice(*(self.visit(x) if x else None for x in (node.lower, node.upper, node.step)))

    def visit_Attribute(self, node: ast.Attribute) -> Any:
        return _entry_of(self.visit(node.value), node.attr)

    def visit_ListComp(self, node: ast.ListComp | ast.GeneratorExp) -> Any:
        return list(self.comprehension(node, 0))

    visit_GeneratorExp = visit_ListComp

    def visit_SetComp(self, node: ast.SetComp) -> Any:
        return set(self.comprehension(node, 0))

    def comprehension(
        self, node: ast.ListComp | ast.GeneratorExp | ast.SetComp, depth: int
    ) -> Iterable[Any]:
        """Yield the elements of a comprehension, of its loops from `depth` on."""
        if depth == len(node.generators):
            self.budget.spend(1)
            yield self.visit(node.elt)
            return
        loop = node.generators[depth]
        for item in _items(self.visit(loop.iter), self.budget):
            own = {**self.own, **_variables(loop.target, item)}
            inner = _Evaluation(self.names, self.budget, own)
            if all(inner.visit(test) for test in loop.ifs):
                yield from inner.comprehension(node, depth + 1)

    def visit_Call(self, node: ast.Call) -> Any:
        function = self.function(node.func)
        given = self.elements(node.args)
        named = {key.arg: self.visit(key.value) for key in node.keywords if key.arg}
        self.budget.spend(1)
        return _paid(function(self.budget, *given, **named), self.budget)

    def function(self, node: ast.expr) -> Callable[..., Any]:
        """Return the function of a call: it takes the budget, then the arguments."""
        if not isinstance(node, ast.Attribute):
            return _runnable(self.visit(node), ast.unparse(node)[:60])
        owner, name = self.visit(node.value), node.attr
        kind = next((k for k in METHODS if isinstance(owner, k)), None)
        if kind is not None and not isinstance(owner, Library) and name in METHODS[kind]:
            return lambda budget, *a, **k: _method(kind, name, budget, owner, *a, **k)
        if isinstance(owner, dict):
            return _runnable(_entry_of(owner, name), ast.unparse(node)[:60])
        raise RefusedError(f"the method {name} of a {_kind(owner)} is not offered here")


def _entry_of(holder: Any, name: str) -> Any:
    if not isinstance(holder, dict):
        raise RefusedError(f"the attribute {name} of a {_kind(holder)} is not offered here")
    try:
        return holder[name]
    except (KeyError, AttributeError):  # as xacro's own dictionaries raise it
        raise RefusedError(f"there is no {name!r} in it") from None


def _variables(target: ast.expr, item: Any) -> dict[str, Any]:
    """Return the variables of a comprehension at one item."""
    if isinstance(target, ast.Name):
        return {target.id: item}
    assert isinstance(target, ast.Tuple | ast.List)
    pieces, parts = list(item), target.elts
    if len(pieces) != len(parts):
        raise RefusedError(f"{len(pieces)} values for {len(parts)} names")
    return {k: v for part, x in zip(parts, pieces, strict=True)
            for k, v in _variables(part, x).items()}


def _kind(value: Any) -> str:
    return "function" if isinstance(value, Offered) else type(value).__name__


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
