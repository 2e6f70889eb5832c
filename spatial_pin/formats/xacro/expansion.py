"""xacro files: parametric URDF, expanded without trusting it.

The package `xacro` does the expanding, with three parts of it replaced: expressions are worked out
by `expressions`, not by Python; files are read only from the file's own folder and from packages
(unless the file is trusted); and all values are paid for from one budget. xacro keeps its state in
globals of its module, so every expansion has a copy of that module of its own: threads do not
meet, nothing stays behind, and other users of xacro in the process are not disturbed.
"""

from __future__ import annotations

import glob
import importlib
import importlib.util
import math
import os
import re
import threading
from collections.abc import Callable, Mapping
from functools import lru_cache
from importlib.machinery import ModuleSpec
from itertools import pairwise
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any, NoReturn
from xml.dom import Node, minidom
from xml.parsers.expat import ExpatError

import numpy as np

from spatial_pin.errors import MechanismFileError, suggestion, warn
from spatial_pin.formats.file_access import (
    REMEDY,
    check_file,
    is_file,
    library_folder,
    package_folders,
    parse_xml,
    read_text,
    shown,
)
from spatial_pin.formats.importers import Request
from spatial_pin.formats.xacro.expressions import (
    GLOBALS,
    SHARE,
    Budget,
    Library,
    Offered,
    RefusedError,
    evaluate,
    measure,
)
from spatial_pin.formats.xacro.tracing import Tape

MACRO = 50  # steps of calling a macro
PLACE = 40  # steps of putting one thing in the place of another
SIBLINGS = 500  # elements that are searched in the time of one step
_XACRO = re.compile(r"""\sxmlns:xacro\s*=\s*["']([^"']*)""")  # xacro goes by the prefix
_IMPORTING = threading.Lock()
_TOKEN = re.compile(
    r"\$\$+(?=[{(])"          # dollars before a bracket: one less, and what follows is text
    r"|\$\{(?P<value>[^}]*)\}"
    r"|\$\((?P<command>[^)]*)\)"
    r"|[^$]+|\$(?![{(])")
# xacro's own pattern of a macro's parameter, but without its exponential number of ways to match
_PARAMETER = re.compile(
    r"^\s*([^\s:=]+?)\s*:?=\s*(\^\|?)?"
    r"(\$\{.*?\}|\$\(.*?\)|(?:'[^']*+'|\"[^\"]*+\"|[^\s'\"]++)++|)(?:\s+|$)(.*)")
if hasattr(os, "register_at_fork"):  # a child must not be born while an import is half done
    os.register_at_fork(before=_IMPORTING.acquire, after_in_parent=_IMPORTING.release,
                        after_in_child=_IMPORTING.release)


def expand(request: Request) -> str:
    """Return the URDF text of a `.urdf` or `.xacro` file with its parameters put in.

    Raises:
        MechanismFileError: it cannot be read or expanded, or needs something that is refused.
        TypeError: a parameter is neither a number nor a text.
        ValueError: a parameter is NaN or infinite.
    """
    path = request.path
    check_file(path)
    if path.suffix != ".xacro":
        return read_text(path)
    mappings = _checked_parameters(request) if request.parameters else {}
    if path.parent != library_folder():
        return Expansion(request).text(mappings)
    changed = max(file.stat().st_mtime_ns for file in path.parent.glob("*.xacro"))
    return _library_text(path, tuple(mappings.items()), changed)


@lru_cache(maxsize=200)
def _library_text(path: Path, mappings: tuple[tuple[str, str], ...], changed: int) -> str:
    """Return the expanded text of a library file: four fifths of the time of loading it."""
    return Expansion(Request(path)).text(dict(mappings))


def traced(request: Request, arguments: Mapping[str, float]) -> tuple[str, Tape]:
    """Expand a xacro file with some arguments traced, by their values.

    Returns:
        The text that `expand` returns, with references to the tape in the places of numbers that
        depend on the arguments.
    """
    tape = Tape(arguments)
    mappings = {name: xacro_text(value) for name, value in request.parameters.items()}
    mappings |= {name: tape.text(row) for row, name in enumerate(arguments)}
    return Expansion(request, tape).text(mappings), tape


def _checked_parameters(request: Request) -> dict[str, str]:
    valid = arguments_of(Expansion(request))
    for name, value in request.parameters.items():
        if name not in valid:
            raise MechanismFileError(
                f"{request.path}: no parameter {name!r}; {suggestion(name, valid)}")
        if isinstance(value, str):
            continue
        try:
            if np.ndim(value):  # NumPy 2.0 takes an array of one number for a number
                raise TypeError
            number = float(value)
        except OverflowError:
            raise ValueError(
                f"parameter {name!r} is too large; a finite number is needed") from None
        except (TypeError, ValueError):
            raise TypeError(f"parameter {name!r} is a {type(value).__name__}; a number is needed, "
                            "or a text") from None
        if not math.isfinite(number):
            raise ValueError(f"parameter {name!r} is {number}; a finite number is needed")
    return {name: xacro_text(value) for name, value in request.parameters.items()}


def xacro_text(value: object) -> str:
    """Return a value as the text that xacro reads it from, to the last digit."""
    if isinstance(value, str | bool | np.bool_):
        return str(value)
    return repr(float(value))  # type: ignore[arg-type]


def arguments_of(expansion: Expansion) -> dict[str, str]:
    """Return names and defaults of the arguments that a xacro file and its includes declare."""
    arguments: dict[str, str] = {}
    files, seen = [expansion.path], set()
    while files:
        file = files.pop()
        if file in seen:
            continue
        seen.add(file)
        text = read_text(file)
        own = _XACRO.findall(text)
        for element in parse_xml(text, file).iter():
            namespace, _, tag = str(element.tag).removeprefix("{").rpartition("}")
            if "xacro" not in namespace and namespace not in own:
                continue
            if tag == "arg":
                arguments.setdefault(element.get("name", ""), element.get("default", ""))
            elif tag == "include":
                files += expansion.included(element.get("filename", ""), file)
    return arguments


def with_defaults(text: str, values: Mapping[str, float]) -> str:
    """Return the text of a xacro file with other defaults of its arguments."""
    def other(match: re.Match[str]) -> str:
        name = match[2]
        return f"{match[1]}{xacro_text(values[name])}{match[3]}" if name in values else match[0]

    return re.sub(r'(<xacro:arg name="([^"]*)" default=")[^"]*(")', other, text)


@lru_cache(maxsize=4096)
def _tokens(text: str) -> tuple[tuple[str, str], ...]:
    """Return the parts of a text, each with its kind: "text", "value" or "command"."""
    parts, at = [], 0
    while at < len(text):
        match = _TOKEN.match(text, at)
        if match is None:
            raise RefusedError(f"a bracket is not closed: {text[at:at + 60]}")
        at, token = match.end(), match[0]
        if token.startswith("$$") and text[at:at + 1] in ("{", "("):
            parts.append(("text", token[1:] + text[at]))
            at += 1
        elif match.lastgroup:
            parts.append((match.lastgroup, match[match.lastgroup]))
        else:
            parts.append(("text", token))
    return tuple(parts)


class XacroFiles:
    """Files and environment variables of one run of xacro."""

    def __init__(self, request: Request, tape: Tape | None = None) -> None:
        self.path, self.trust = request.path, request.trust
        self.budget, self.tape = Budget(tape), tape
        self.xacro: Any = None

    @property
    def file(self) -> str:
        """The file that is being read."""
        stack = self.xacro.filestack if self.xacro is not None else None
        return str(stack[-1]) if stack else str(self.path)

    def package(self, name: str) -> str:
        """Return the folder of a package."""
        folder = Path(self.file).parent.resolve()
        root = next((p for p in package_folders(name, folder, self.trust.packages)
                      if os.path.isdir(p)), None)
        if root is None:
            raise RefusedError(f"no package {name!r}: neither round this file nor below the "
                               "folders of ROS_PACKAGE_PATH or AMENT_PREFIX_PATH; say where it "
                               f"lies: load(..., packages={{{name!r}: FOLDER}})")
        return str(root.resolve())

    def absolute(self, name: str, file: str | None = None) -> str:
        """Return the path of a file that is named in the file being read."""
        return os.path.join(os.path.dirname(file or self.file), str(name))

    def confined(self, name: str) -> Path:
        """Return the path of a file that may be read."""
        try:
            return self.trust.resolved(name)
        except MechanismFileError as error:
            raise MechanismFileError(f"{shown(self.file)}: {error}") from error

    def included(self, name: str, file: Path) -> list[Path]:
        """Return the files of an include, those only that can be known without expanding."""
        try:
            for package in re.findall(r"\$\(find +([^ )]*) *\)", name):
                name = re.sub(rf"\$\(find +{re.escape(package)} *\)", self.package(package), name)
            if "$" in name:
                return []
            return [p for p in map(self.confined, self.matching(self.absolute(name, str(file))))
                    if is_file(p)]
        except (MechanismFileError, RefusedError):
            return []  # for xacro to complain about, if it comes to it

    def matching(self, name: str) -> list[str]:
        """Return the files that match a name with or without wildcards, sorted."""
        if not re.search(r"[*[?]", name):
            return [name]
        folder = os.path.dirname(re.split(r"[*[?]", name)[0])
        self.confined(folder)
        return sorted(glob.glob(name))

    def parse(self, _: None, name: str) -> Any:
        """Return the document of a file."""
        path = self.path if name == str(self.path) else Path(name)  # it may be held in memory
        if not os.path.exists(path) and self.xacro.filestack[1:]:  # an include that may be missing
            self.xacro.filestack.pop()
            error = FileNotFoundError(2, "no such file", name)
            raise self.xacro.XacroException(f"no such file: {shown(name)}", exc=error)
        text = read_text(path)
        self.budget.spend(len(text) // SHARE)
        try:
            document = minidom.parseString(text)
        except (ExpatError, ValueError) as error:
            raise MechanismFileError(f"{shown(name)}: not well-formed XML: {error}") from error
        # half of a file is space between elements, and comments where none is an instruction:
        # xacro would copy it with every macro and leave it out in the end
        dropped = (Node.TEXT_NODE, Node.COMMENT_NODE) if "xacro:eval-comments" not in text else (
            Node.TEXT_NODE,)
        stack: list[Any] = [document.documentElement]
        while stack:
            children = stack.pop().childNodes
            if len(children) == 1 and children[0].nodeType == Node.TEXT_NODE:
                continue
            children[:] = [child for child in children if child.nodeType not in dropped or (
                child.nodeType == Node.TEXT_NODE and child.data and not child.data.isspace())]
            _link([None, *children, None])
            stack += [child for child in children if child.nodeType == Node.ELEMENT_NODE]
        return document

    def load_yaml(self, name: str) -> Any:
        """Return the content of a YAML file."""
        from spatial_pin.formats.xacro.yaml_files import read_yaml

        path = self.confined(self.absolute(name))
        content = read_yaml(path, lambda text: evaluate(text, GLOBALS, self.budget))
        measure(content, self.budget)
        return self.xacro.YamlListWrapper.wrap(content)

    def environment(self, name: str) -> str:
        """Return an environment variable; a file that is not trusted learns of none."""
        if not self.trust.trusted:
            raise RefusedError(f"environment variables are not for files of others; {REMEDY}")
        if name not in os.environ:
            raise RefusedError(f"no environment variable {name!r}; $(optenv {name} default) allows "
                               "for that")
        return os.environ[name]

    def optional(self, name: str, *default: str) -> str:
        """Return an environment variable or the default; that for a file that is not trusted."""
        own = " ".join(default)
        if self.trust.trusted:
            return os.environ.get(name, own)
        if name in os.environ:
            warn(f"{shown(self.file)}: $(optenv {name}) is its default here, {own!r}: environment "
                 f"variables are not for files of others; {REMEDY}")
        return own

    def working_folder(self) -> str:
        """Return the working folder, to a file that is trusted."""
        if not self.trust.trusted:
            raise RefusedError(f"the working folder is not for files of others; {REMEDY}")
        return os.getcwd()


class Expansion(XacroFiles):
    """One run of xacro over a file and what it includes."""

    def guarded(self, run: Callable[[Any], Any]) -> Any:
        """Return the result of `run` with a copy of the module xacro; its errors name the file."""
        self.xacro = _own_xacro(self)
        try:
            return run(self.xacro)
        except MechanismFileError:
            raise
        except Exception as error:  # xacro raises a family of its own, and Python's of its own
            reason = " ".join(str(error).split())[:1000]
            if isinstance(error, RecursionError):
                reason = "macros, includes or elements call each other without end, or too deep"
            raise MechanismFileError(
                f"{shown(self.file)}: xacro cannot expand it: {reason}") from error

    def text(self, mappings: Mapping[str, str]) -> str:
        """Return the expanded text with these values of the arguments."""
        return self.guarded(
            lambda xacro: xacro.process_file(str(self.path), mappings=mappings).toxml())

    def fail(self, what: str, error: Exception) -> NoReturn:
        """Raise the error of one piece of text."""
        text = what if len(what) <= 120 else f"{what[:110]}..."
        reason = " ".join(str(error).split())[:300] or type(error).__name__
        raise MechanismFileError(
            f"{shown(self.file)}: {' '.join(text.split())}: {reason}") from error

    def eval_text(self, text: str, symbols: Any) -> Any:
        """Return a text with its `${...}` and `$(...)` put in; the value itself of one alone."""
        if "$" not in text:
            self.budget.spend(1)
            return text
        try:
            tokens = _tokens(text)
        except RefusedError as error:
            self.fail(text, error)
        parts = [part if kind == "text" else self.worked_out(kind, part, symbols)
                 for kind, part in tokens]
        if len(parts) == 1:
            measure(parts[0], self.budget)
            return parts[0]
        joined = "".join(part if isinstance(part, str) else self.text_of(part) for part in parts)
        self.budget.spend(1 + len(joined) // SHARE)
        return joined

    def text_of(self, value: Any) -> str:
        """Return a value as it is written into a longer text."""
        measure(value, self.budget)
        return str(value)

    def worked_out(self, kind: str, part: str, symbols: Any) -> Any:
        """Return the value of the inside of one `${...}` ("value") or `$(...)` ("command")."""
        written = f"${{{part}}}" if kind == "value" else f"$({part})"
        if "$" in part:
            part = str(self.eval_text(part, symbols))
        try:
            if kind == "value":
                return evaluate(part, symbols, self.budget)
            return self.command(part)
        except (MechanismFileError, RecursionError):
            raise
        except Exception as error:
            self.fail(written, error)

    def command(self, text: str) -> Any:
        """Return the value of `$(arg name)`, `$(find package)` and their like."""
        words = text.split()
        name, rest = (words[0], words[1:]) if words else ("", [])
        if name == "eval":
            names = {**GLOBALS, **{k: self.literal(v) for k, v in self.arguments.items()}}
            return str(evaluate(text.split(None, 1)[1] if rest else "", names, self.budget))
        if name not in COMMANDS:
            raise RefusedError(f"there is no such command; {suggestion(name, COMMANDS)}")
        least, most, run = COMMANDS[name]
        if not least <= len(rest) <= most:
            raise RefusedError(f"{name} takes {least or 'no'} word{'s' if least != 1 else ''}")
        return run(self, *rest)

    def literal(self, text: str) -> Any:
        """Return the number or truth value that a text is, else the text."""
        number = self.tape.read(text) if self.tape is not None else None
        return self.xacro.literal_of_xacro(text) if number is None else number

    @property
    def arguments(self) -> dict[str, str]:
        """Values of the xacro arguments."""
        return self.xacro.substitution_args_context["arg"]

    def argument(self, name: str) -> str:
        """Return the value of an argument."""
        if name not in self.arguments:
            raise RefusedError(f"no argument {name!r}; {suggestion(name, self.arguments)}")
        return self.arguments[name]

    def include_files(self, name: str, symbols: Any) -> list[str]:
        """Return the files of an include."""
        files = self.matching(self.absolute(self.eval_text(name, symbols)))
        if not files:
            warn(f"{shown(self.file)}: no file matches {shown(name)}")
        for file in files:
            path = self.confined(file)
            try:
                if os.path.exists(path):
                    check_file(path)
            except MechanismFileError as error:
                raise MechanismFileError(f"{shown(self.file)}: an include: {error}") from error
        return files

    def macro(self, name: str, macros: Any, symbols: Any) -> Any:
        """Return a macro with the names in its reach, paid for."""
        self.budget.spend(MACRO)
        return self.xacro.resolve_macro_of_xacro(name, macros, symbols)

    def replace_node(self, node: Any, by: Any, content_only: bool = False) -> None:
        """Replace a node by others, or by their children, in one go and paid for."""
        parent, several = node.parentNode, by if isinstance(by, list) else [by] if by else []
        new = [child for one in several for child in (one.childNodes if content_only else [one])]
        stack = list(new)
        while stack:
            children = stack.pop().childNodes
            self.budget.spend(1)
            stack += children
        siblings = parent.childNodes
        self.budget.spend(PLACE + len(siblings) // SIBLINGS)
        index = siblings.index(node)
        for one in several if content_only else ():
            one.childNodes = type(siblings)()
        siblings[index:index + 1] = new
        _link([node.previousSibling, *new, node.nextSibling])
        for one in new:
            one.parentNode = parent
        node.parentNode = node.previousSibling = node.nextSibling = None


COMMANDS: dict[str, tuple[int, int, Callable[..., Any]]] = {  # fewest words, most, function
    "arg": (1, 1, Expansion.argument),
    "find": (1, 1, Expansion.package),
    "env": (1, 1, Expansion.environment),
    "optenv": (1, 100, Expansion.optional),
    "cwd": (0, 0, Expansion.working_folder),
    "dirname": (0, 0, lambda expansion: os.path.abspath(os.path.dirname(expansion.file))),
}


def _link(siblings: list[Any]) -> None:
    """Link neighbours; None at the ends."""
    for before, after in pairwise(siblings):
        if before is not None:
            before.nextSibling = after
        if after is not None:
            after.previousSibling = before


@lru_cache(maxsize=1)
def _xacro_code() -> tuple[ModuleSpec, CodeType]:
    """Return spec and code of the module xacro, for a copy of it."""
    spec = importlib.util.find_spec("xacro")
    loader: Any = spec.loader if spec is not None else None
    if spec is None or loader is None:
        raise ImportError
    return spec, loader.get_code("xacro")


@lru_cache(maxsize=4096)
def _is_valid_name(name: str) -> bool:
    """Whether xacro takes a text for the name of a property, which it parses to find out."""
    return bool(importlib.import_module("xacro").is_valid_name(name))


def _own_xacro(expansion: Expansion) -> ModuleType:
    """Return a new copy of the module xacro, whose dangerous parts are those of `expansion`."""
    with _IMPORTING:
        importlib.import_module("xml.dom.expatbuilder")  # minidom would, outside of the lock
        try:
            spec, code = _xacro_code()
        except ImportError:
            raise MechanismFileError(
                f"{expansion.path}: the package xacro is not installed") from None
        module = importlib.util.module_from_spec(spec)
        exec(code, module.__dict__)
    parts = {
        "eval_text": expansion.eval_text, "parse": expansion.parse,
        "get_include_files": expansion.include_files, "replace_node": expansion.replace_node,
        "resolve_macro": expansion.macro, "load_yaml": expansion.load_yaml,
        "re_macro_arg": _PARAMETER, "is_valid_name": _is_valid_name,
        "eval_extension": None, "safe_eval": None,
        "_global_symbols": {**GLOBALS, **_functions(expansion, module)},
    }
    missing = [name for name in parts if not hasattr(module, name)]
    if missing:
        raise MechanismFileError(f"{expansion.path}: this version of xacro has no {missing[0]}, "
                                 "without which it cannot be confined; install xacro 2.1")
    own: Any = module
    own.resolve_macro_of_xacro = own.resolve_macro
    own.literal_of_xacro = own.Table._eval_literal
    if expansion.tape is not None:
        own.Table._eval_literal = staticmethod(expansion.literal)
    for name, part in parts.items():
        setattr(module, name, part)
    return module


def _functions(expansion: Expansion, module: Any) -> dict[str, Any]:
    """Return the functions of the namespace `xacro`, some also by themselves, as of old."""

    def message(budget: Budget, *words: Any, **_: Any) -> str:
        text = " ".join(expansion.text_of(word) for word in words)
        warn(f"{shown(expansion.file)}: {text}")
        return ""

    def fatal(budget: Budget, *words: Any) -> None:
        raise RefusedError(" ".join(expansion.text_of(word) for word in words))

    def tokenize(budget: Budget, text: str, sep: str = ",; ", skip_empty: bool = True) -> Any:
        measure(text, budget)
        if re.search(r"[\\\[\]^]", sep):
            raise RefusedError("tokenize takes plain letters to part at")
        return module.tokenize(text, sep, skip_empty)

    runs: dict[str, Callable[..., Any]] = {
        "load_yaml": lambda budget, name: expansion.load_yaml(name),
        "abs_filename": lambda budget, name: expansion.absolute(name),
        "dotify": lambda budget, entries: module.YamlDictWrapper(entries),
        "arg": lambda budget, name: expansion.argument(name),
        "message": message, "warning": message, "error": message, "fatal": fatal,
        "tokenize": tokenize, "print_location": lambda budget: "",
    }
    offered = {name: Offered(f"xacro.{name}", run) for name, run in runs.items()}
    old = {name: offered[name] for name in ("load_yaml", "abs_filename", "dotify")}
    return {**old, "xacro": Library(offered)}
