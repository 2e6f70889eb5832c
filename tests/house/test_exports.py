"""What a user gets from the library has a name there: types to annotate with, errors to catch."""

import importlib
import inspect
import pkgutil
import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cached_property
from types import ModuleType

import pytest
from offenders import listed

import spatial_pin as sp
from spatial_pin import errors

PACKAGE = sp.__name__

NO_MODULES = ("__main__", "._kernel")  # a command, and the compiled library


def modules() -> list[ModuleType]:
    names = [m.name for m in pkgutil.walk_packages(sp.__path__, f"{PACKAGE}.")]
    return [importlib.import_module(n) for n in names if not n.endswith(NO_MODULES)]


CLASSES = {
    c.__name__: c for module in modules() for c in vars(module).values()
    if inspect.isclass(c) and c.__module__ == module.__name__
}


def named_in(annotation: object, module: str) -> Iterator[type]:
    """Classes of the library that an annotation names, as seen from a module."""
    text = annotation if isinstance(annotation, str) else getattr(annotation, "__name__", "")
    for word in re.findall(r"(?<![\w.])[A-Za-z]\w+", text):
        found = vars(sys.modules[module]).get(word, CLASSES.get(word))
        if inspect.isclass(found) and found.__module__.startswith(PACKAGE):
            yield found


def yielded(cls: type) -> Iterator[type]:
    """Classes that fields, properties and methods of a class give."""
    for base in cls.__mro__:
        if not base.__module__.startswith(PACKAGE):
            continue
        for name, annotation in vars(base).get("__annotations__", {}).items():
            if not name.startswith("_"):
                yield from named_in(annotation, base.__module__)
        for name, member in vars(base).items():
            if name.startswith("_"):
                continue
            if isinstance(member, property):
                member = member.fget
            elif isinstance(member, cached_property):
                member = member.func
            function = getattr(member, "__func__", member)
            if inspect.isfunction(function):
                yield from named_in(function.__annotations__.get("return"), base.__module__)


def given_to_users() -> dict[type, str]:
    """Every class a public function returns, or that is found in one of these, and through what."""
    found: dict[type, str] = {}
    todo = []
    for name in sp.__all__:
        item = getattr(sp, name)
        if inspect.isfunction(item):
            returned = item.__annotations__.get("return")
            todo += [(c, name) for c in named_in(returned, item.__module__)]
        elif inspect.isclass(item):
            todo.append((item, name))
    while todo:
        cls, through = todo.pop()
        if cls not in found and not cls.__name__.startswith("_"):
            found[cls] = through
            todo += [(c, f"{through} > {cls.__name__}") for c in yielded(cls)]
    return found


# how a closure is made up of equations, and where a machine is: data of the library, not an answer
INSIDE = {"ClosureData", "ConstraintEquation", "Extent", "Key", "Pair", "PairGeometry",
          "SelectedEquations"}


def test_every_type_that_a_user_gets_has_a_name_at_the_top() -> None:
    missing = {c.__name__: through for c, through in given_to_users().items()
               if c.__name__ not in INSIDE and getattr(sp, c.__name__, None) is not c}
    assert not missing, listed(missing)
    assert {"Efforts", "Dynamics", "Sensitivity", "Event"} <= set(sp.__all__)


def test_every_error_of_the_library_has_a_name_at_the_top() -> None:
    ours = {name for name, c in vars(errors).items() if inspect.isclass(c)
            and issubclass(c, Exception)}
    assert ours <= set(sp.__all__)


def test_the_list_of_names_is_sorted_and_true() -> None:
    assert sp.__all__ == sorted(set(sp.__all__))
    assert all(hasattr(sp, name) for name in sp.__all__)


def test_a_command_that_is_called_otherwise_in_python_is_reported():
    with pytest.raises(AttributeError, match=r"does is sp\.inverse_dynamics, over a motion"):
        sp.statics  # noqa: B018
    with pytest.raises(AttributeError, match=r"no attribute 'nothing'$"):
        sp.nothing  # noqa: B018


MODULES = {"closures": sp.closures, "goals": sp.goals, "laws": sp.laws, "targets": sp.targets}


def test_modules_of_constructors_offer_these_and_nothing_else() -> None:
    for name, module in MODULES.items():
        own = {key for key, x in vars(module).items() if inspect.isfunction(x)
               and x.__module__ == module.__name__ and not key.startswith("_")}
        assert dir(module) == sorted(module.__all__) and set(module.__all__) <= own, name
        given: dict[str, object] = {}
        exec(f"from {module.__name__} import *", given)
        assert given.keys() - {"__builtins__"} == set(module.__all__), name


@pytest.mark.parametrize("name", ["closures", "laws"])
def test_what_is_loaded_with_the_library_is_imported_by_its_public_name(name) -> None:
    code = f"from spatial_pin.{name} import *; print(sorted(x for x in dir() if x[0] != '_'))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == f"{dir(getattr(sp, name))}\n"
