"""The kernel's C files: no circles, few functions for Python, structures that Python mirrors."""

from __future__ import annotations

import ctypes
import importlib
import re
from pathlib import Path

import spatial_pin as sp
from spatial_pin.kernel.library import CStructure
from spatial_pin.kernel.sources import c_files, prototypes

FOLDER = Path(sp.__file__).with_name("kernel")
FUNCTIONS = 40  # that Python calls, at most
FIELDS = 45  # of a structure, at most
MODULES = ("constraints.kernel_tree", *(f"kernel.{path.stem}" for path in FOLDER.glob("*.py")))
FUNCTION = re.compile(r"^(?!static)[A-Za-z][\w ]*?[ *]+(\w+)\([^;{]*\)\s*\{", re.M)
MIRROR = re.compile(r"^(?:The first fields of )?(\w+) in (\w+\.[ch])\b")


def code_of(path: Path) -> str:
    """Return a C file without its comments."""
    return re.sub(r"/\*.*?\*/", "", path.read_text(encoding="utf-8"), flags=re.S)


SOURCES = {path.name: code_of(path) for path in c_files(FOLDER, ".c", ".h")}


def calls() -> dict[str, set[str]]:
    """Return the files whose functions each C file calls, by name."""
    at = {name: file for file, code in SOURCES.items() if file.endswith(".c")
          for name in FUNCTION.findall(code)}
    found = {}
    for file, code in SOURCES.items():
        if file.endswith(".c"):
            own = set(re.findall(r"^static[\w *]*?[ *](\w+)\(", code, re.M))
            used = {at[name] for name in set(re.findall(r"\b(\w+)\(", code)) - own if name in at}
            found[file] = used - {file}
    return found


def structures() -> dict[str, list[str]]:
    """Return the fields of all structures, those of structures in them in their place."""
    parts = {}
    for code in SOURCES.values():
        for body, name in re.findall(r"typedef struct(?: \w+)? \{(.*?)\n\} (\w+);", code, re.S):
            parts[name] = [x.strip() for x in body.split(";") if x.strip()]

    def fields(name: str) -> list[str]:
        found = []
        for line in parts[name]:
            if pointer := re.match(r"\w+ \(\*(\w+)\)", line, re.S):  # to a function
                found.append(pointer[1])
                continue
            kind, names = re.match(r"(?:const )?(?:struct )?(\w+)\s+(.*)", line, re.S).groups()
            names = re.sub(r"\[[^]]*\]|\(|\)", "", names)  # of arrays
            for field in names.split(","):
                word = re.search(r"(\w+)$", field.strip())[1]
                found += fields(kind) if kind in parts and "*" not in field else [word]
        return found

    return {name: fields(name) for name in parts}


def flat(mirror: type[ctypes.Structure]) -> list[str]:
    """Return the fields of a structure of ctypes, those of structures in it in their place."""
    return [x for name, kind in mirror._fields_
            for x in (flat(kind) if issubclass(kind, ctypes.Structure) else [name])]


def test_no_c_files_call_each_other_in_a_circle():
    left = calls()
    while ends := [file for file, used in left.items() if not used & left.keys()]:
        for file in ends:
            del left[file]
    assert not left, {file: used & left.keys() for file, used in left.items()}


def test_a_circle_would_be_seen(monkeypatch):
    monkeypatch.setitem(SOURCES, "tree.c", SOURCES["tree.c"] + "void f(void) { path_start(); }")
    left = calls()
    while ends := [file for file, used in left.items() if not used & left.keys()]:
        for file in ends:
            del left[file]
    assert {"tree.c", "following.c", "equations.c"} <= left.keys()


def test_python_calls_few_functions_and_each_says_what_it_does():
    declared = prototypes(FOLDER).splitlines()
    assert len(declared) <= FUNCTIONS
    texts = [path.read_text(encoding="utf-8") for path in c_files(FOLDER, ".c", ".h")]
    for line in declared:
        name = re.search(r"(\w+)\(", line)[1]
        pattern = re.compile(rf"\*/\n[\w *]*\b{name}\(")  # a comment stands above it
        assert any(pattern.search(text) for text in texts), f"{name} does not say what it does"


def test_every_function_for_python_is_called_by_it():
    package = "".join(path.read_text(encoding="utf-8")
                      for path in Path(sp.__file__).parent.rglob("*.py"))
    names = [re.search(r"(\w+)\(", line)[1] for line in prototypes(FOLDER).splitlines()]
    assert not [name for name in names if not re.search(rf"\b{name}\b", package)]


def test_structures_have_one_purpose_each():
    sizes = {}
    for file, code in SOURCES.items():
        for body in re.findall(r"^(?:typedef )?struct(?: \w+)? \{(.*?)\n\}", code, re.S | re.M):
            sizes[file, body] = sum(part.count(",") + 1 for part in body.split(";")[:-1])
    assert len(sizes) > 40 and {key: n for key, n in sizes.items() if n > FIELDS} == {}


def test_mirrors_have_the_fields_of_c():
    known, seen = structures(), set()
    for module in MODULES:
        for mirror in vars(importlib.import_module(f"spatial_pin.{module}")).values():
            if not (isinstance(mirror, type) and issubclass(mirror, ctypes.Structure)) or (
                    mirror in (ctypes.Structure, CStructure)):
                continue
            stated = MIRROR.match(mirror.__doc__ or "")
            assert stated, f"{mirror.__name__} does not say which structure it is"
            name, file = stated.groups()
            assert re.search(rf"\}} {name};", SOURCES[file]), f"{file} has no {name}"
            fields = flat(mirror)
            if not mirror.__doc__.startswith("The first fields"):
                assert fields == known[name], mirror
            else:
                assert fields == known[name][: len(fields)], mirror
            seen.add(name)
    assert len(seen) >= 15, seen
