"""Every public name has an example in its docstring, and the examples are true.

An example is written for `import numpy as np`, `import pinocchio as pin`, `import spatial_pin as
sp`. Numbers in what it prints are held to the digits that are written.
"""

import doctest
import inspect
import re

import numpy as np
import pinocchio as pin
import pytest

import spatial_pin as sp
from spatial_pin import operators
from spatial_pin.lazy import cached_property
from spatial_pin.view.browser.picture import find_browser

MODULES = ("closures", "goals", "laws", "targets")  # of constructors
BROWSER = {"movie", "screenshot"}  # need one
OPTIONAL = {"Tabular.to_dataframe": "pandas", "Tabular.to_xarray": "xarray"}
INNER = {  # methods of public types that the library has for itself, or for who extends it
    "Closure": {"turned", "with_equations"},
    "Goal": {"check", "unit_of"},
    "JointLimit": {"closing"},
    "Mechanism": {
        "coordinate_table", "driven_coordinate", "frame_ids", "frame_on_joint", "joint_id",
        "loading", "pair_of", "place_of", "placed", "prescribed_coordinate", "start", "unplaced",
        "velocity_scale", "with_equations", "with_fields"},
    "Reduced": {"characteristic_length", "placed", "start", "unplaced"},
    "Tabular": {"quantities"},  # those of each result say what they are
    "Target": {"check", "pulled", "residual", "wishes"},
}
RESULTS = ("Return ", "Ask ", "Write ")  # first words that say what comes back
NUMBER = re.compile(r"(?<![\w.])[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?(?![\w])")


class Numbers(doctest.OutputChecker):
    """Takes numbers for equal that differ by half of the last digit written, or 1e-3 at most."""

    def check_output(self, want, got, optionflags):
        words = [re.sub(r"\s+", "", NUMBER.sub(" # ", text)) for text in (want, got)]
        told, found = NUMBER.findall(want), NUMBER.findall(got)
        nearness = min([1e-3, *(0.51 * last_digit(x) for x in told)])
        return words[0] == words[1] and all(
            abs(float(a) - float(b)) <= nearness for a, b in zip(told, found, strict=True))


def last_digit(text):
    """Return what one of the last digit of a number counts, as it is written."""
    mantissa, _, exponent = text.partition("e")
    return 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))


def members(kind):
    """Yield (name, object) of what a public class has besides fields, each where it is written."""
    for owner in kind.__mro__:
        if not owner.__module__.startswith("spatial_pin"):
            continue
        for name, found in vars(owner).items():
            found = getattr(found, "__func__", found)
            shown = isinstance(found, property | cached_property) or inspect.isfunction(found)
            if shown and not name.startswith("_") and name not in INNER.get(owner.__name__, ()):
                yield f"{owner.__name__}.{name}", found


def constructors(module):
    for name, found in vars(getattr(sp, module)).items():
        if (inspect.isfunction(found) and found.__module__ == getattr(sp, module).__name__
                and not name.startswith("_") and returns_of(found) in RETURNED):
            yield f"{module}.{name}", found


def returns_of(function):
    return str(function.__annotations__.get("return"))


RETURNED = {"Closure", "DriverLaw", "Target", *(
    returns_of(x) for x in vars(sp.goals).values()
    if inspect.isfunction(x) and x.__module__ == sp.goals.__name__)}


def documented():
    """Return what has a docstring for a user, by name."""
    found = {"spatial_pin": sp}
    for name in sp.__all__:
        thing = found[name] = getattr(sp, name)
        if inspect.isclass(thing):
            found.update(members(thing))
    for module in MODULES:
        found.update(constructors(module))
    for name in operators.__all__:
        if callable(getattr(operators, name)):
            found[f"operators.{name}"] = getattr(operators, name)
    return found


NAMES = documented()


def example_of(name):
    return doctest.DocTestParser().get_doctest(
        inspect.getdoc(NAMES[name]) or "", {"np": np, "pin": pin, "sp": sp}, name, None, None)


def is_in_the_example_of_its_class(name):
    """A property may be shown by the example of its class."""
    kind, _, member = name.partition(".")
    return isinstance(NAMES[name], property | cached_property) and any(
        re.search(rf"\.{member}\b", x.source) for x in example_of(kind).examples)


@pytest.mark.parametrize("name", NAMES)
def test_a_public_name_has_an_example(name):
    words = inspect.getdoc(NAMES[name]) or ""
    assert "\nExample:\n" in words or is_in_the_example_of_its_class(name)
    assert len(example_of(name).examples) <= 12


FUNCTIONS = {name: thing for name, thing in NAMES.items() if inspect.isfunction(thing)}
RAISE_NOTHING = {  # that a caller could mend
    "BeyondLimit.text", "Calibration.as_dict", "Clearance.as_dict", "Design.as_dict",
    "Designs.as_dict", "Dynamics.why_not_unique", "JointLimit.room", "Kinetostatics.marks",
    "Kinetostatics.why_not_unique", "Motion.frame_unit",
    "Motion.rate_unit", "Output.parts", "Tradeoff.as_dict", "Tradeoff.known_error", "Viewer.stop",
    "Viewer.wait", "Viewer.wait_until_fetched", "list_mechanisms"}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_function_tells_its_arguments_its_result_and_its_errors(name):
    words, function = inspect.getdoc(FUNCTIONS[name]), FUNCTIONS[name]
    asked = [x for x in inspect.signature(function).parameters if x not in ("self", "cls")]
    if "Args" in words or len(asked) > 1:
        told = re.search(r"^Args:\n((?:    .*\n|\n)+)", f"{words}\n", flags=re.MULTILINE)[1]
        names = re.findall(r"^    \*{0,2}(\w+(?:, \w+)*):", told, flags=re.MULTILINE)
        assert ", ".join(names).split(", ") == asked
    assert "\nReturns:\n" in words or words.startswith(RESULTS) or (
        function.__annotations__["return"] == "None")
    assert ("\nRaises:\n" in words) != (name in RAISE_NOTHING)


def fields_with_numbers():
    """Yield (class, field, whether it is an array) of the public types that hold numbers."""
    for name in sp.__all__:
        kind = getattr(sp, name)
        for field, hint in (getattr(kind, "__annotations__", {}) if inspect.isclass(kind) else
                            {}).items():
            hint = str(getattr(hint, "__forward_arg__", hint))
            if not field.startswith("_") and re.search(r"\bArray\b|NDArray|^float\b", hint):
                yield name, field, "Array" in hint


@pytest.mark.parametrize(("name", "field", "is_array"), list(fields_with_numbers()))
def test_numbers_of_a_result_have_a_unit_and_arrays_a_shape(name, field, is_array):
    """A shape stands in parentheses, a unit in brackets; a number without one says [-]."""
    words = inspect.getdoc(getattr(sp, name))
    told = re.search(rf"^    (?:\w+, )*{field}(?:, \w+)*:(.*(?:\n        .*)*)", words,
                     flags=re.MULTILINE)
    assert told and re.search(r"\([\w ,-]+,?\)" if is_array else r"\[.+\]", told[1], re.DOTALL)


@pytest.mark.parametrize("name", NAMES)
def test_sections_are_in_the_order_of_google_style(name):
    order = ["Attributes", "Args", "Returns", "Raises", "Example"]
    heads = re.findall(r"^(\w+):\n(?=    \S)", inspect.getdoc(NAMES[name]) or "",
                       flags=re.MULTILINE)
    assert heads == sorted(heads, key=order.index) and len(set(heads)) == len(heads)


@pytest.mark.parametrize("name", [
    pytest.param(name, marks=[
        pytest.mark.browser,
        pytest.mark.skipif(find_browser() is None, reason="no Chromium or Chrome here"),
    ] if name in BROWSER else []) for name in NAMES if example_of(name).examples])
def test_an_example_is_true(name, tmp_path, monkeypatch):
    if name in OPTIONAL:
        pytest.importorskip(OPTIONAL[name])
    monkeypatch.chdir(tmp_path)
    text: list[str] = []
    result = doctest.DocTestRunner(Numbers()).run(example_of(name), out=text.append)
    assert not result.failed, "".join(text)
