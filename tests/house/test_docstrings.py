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
from images import needs_browser
from offenders import listed

import spatial_pin as sp
from spatial_pin import operators

MODULES = ("closures", "goals", "laws", "targets")  # of constructors
PROPERTIES = (property, type(vars(sp.Mechanism)["characteristic_length"]))  # worked out once
BROWSER = {"movie", "screenshot"}  # need one
OPTIONAL = {"Tabular.to_dataframe": "pandas", "Tabular.to_xarray": "xarray"}
LONG = {  # what designs, workspaces and searches give: the example of the verb always runs
    "BeyondLimit", "BeyondLimit.text", "Borders", "Calibration", "Calibration.as_dict", "Curve",
    "Defect", "Design", "Design.as_dict", "Design.motion", "Designs", "Designs.as_dict",
    "GoalError", "JointLimit", "JointLimit.room", "Met", "Passing", "ReachError", "Tradeoff.plot",
    "Workspace", "Workspace.curves", "Workspace.plot"}
INNER = {  # methods of public types that the library has for itself, or for who extends it
    "AssemblyModes": {"found"},  # old names, as those below that warn
    "Closure": {"turned", "with_equations"},
    "Coordinate": {"place"},  # an old name, as Measured.said and Mechanism.kept
    "Goal": {"check", "unit_of"},
    "JointLimit": {"closing"},
    "Look": {"beside"},  # an old name
    "Measured": {"said"},
    "Mechanism": {
        "centred_frame", "centred_model", "coordinate_table", "driven_coordinate", "extent",
        "frame_ids", "frame_on_joint", "index_of", "joint_id", "kept", "loading", "pair_of",
        "placed", "prescribed_coordinate", "start", "unplaced", "velocity_scale", "with_equations",
        "with_fields"},
    "Reduced": {"extent", "left_out", "placed", "start", "unplaced"},
    "Tabular": {"quantities"},  # those of each result say what they are
    "Target": {"check", "for_kernel", "lengths", "pulled", "residual", "wishes"},
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
            shown = isinstance(found, PROPERTIES) or inspect.isfunction(found)
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
    return isinstance(NAMES[name], PROPERTIES) and any(
        re.search(rf"\.{member}\b", x.source) for x in example_of(kind).examples)


def test_every_public_name_has_an_example():
    without = [name for name, thing in NAMES.items()
               if "\nExample:\n" not in (inspect.getdoc(thing) or "")
               and not is_in_the_example_of_its_class(name)]
    assert not without, listed(without)


def test_an_example_has_twelve_lines_at_most():
    lines = {name: len(example_of(name).examples) for name in NAMES}
    long = {name: n for name, n in lines.items() if n > 12}
    assert not long, listed(long)


FUNCTIONS = {name: thing for name, thing in NAMES.items() if inspect.isfunction(thing)}
RAISE_NOTHING = {  # that a caller could mend
    "BeyondLimit.text", "Calibration.as_dict", "Clearance.as_dict", "Design.as_dict",
    "Designs.as_dict", "Dynamics.why_not_unique", "JointLimit.room", "Kinetostatics.marks",
    "Kinetostatics.why_not_unique", "Linearization.state_space", "Motion.frame_unit",
    "Motion.rate_unit", "Output.parts", "Tradeoff.as_dict", "Tradeoff.error_bound",
    "Tradeoff.known_error", "Tradeoff.relative_time", "Viewer.stop",
    "Viewer.wait", "Viewer.wait_until_fetched", "list_mechanisms"}


def arguments_told(words: str) -> list[str]:
    """Return the names that the section of arguments has."""
    section = re.search(r"^Args:\n((?:    .*\n|\n)+)", f"{words}\n", flags=re.MULTILINE)
    names = re.findall(r"^    \*{0,2}(\w+(?:, \w+)*):", section[1] if section else "",
                       flags=re.MULTILINE)
    return ", ".join(names).split(", ")


def test_functions_tell_their_arguments():
    wrong = {}
    for name, function in FUNCTIONS.items():
        words = inspect.getdoc(function)
        taken = [x for x in inspect.signature(function).parameters if x not in ("self", "cls")]
        if ("Args" in words or len(taken) > 1) and arguments_told(words) != taken:
            wrong[name] = f"takes {taken}, tells of {arguments_told(words)}"
    assert not wrong, listed(wrong)


def test_functions_tell_their_result():
    silent = [
        name for name, function in FUNCTIONS.items()
        if "\nReturns:\n" not in inspect.getdoc(function)
        and not inspect.getdoc(function).startswith(RESULTS)
        and function.__annotations__["return"] != "None"]
    assert not silent, listed(silent)


def test_functions_tell_their_errors():
    silent = {name for name, function in FUNCTIONS.items()
              if "\nRaises:\n" not in inspect.getdoc(function)}
    wrong = [f"{name} says what it raises, against the list" for name in RAISE_NOTHING - silent]
    wrong += [f"{name} does not say what it raises" for name in silent - RAISE_NOTHING]
    assert not wrong, listed(wrong)


def fields_with_numbers():
    """Yield (class, field, whether it is an array) of the public types that hold numbers."""
    for name in sp.__all__:
        kind = getattr(sp, name)
        for field, hint in (getattr(kind, "__annotations__", {}) if inspect.isclass(kind) else
                            {}).items():
            hint = str(getattr(hint, "__forward_arg__", hint))
            if not field.startswith("_") and re.search(r"\bArray\b|NDArray|^float\b", hint):
                yield name, field, "Array" in hint


def has_unit_or_shape(name, field, is_array):
    """A shape stands in parentheses, a unit in brackets; a number without one says [-]."""
    words = inspect.getdoc(getattr(sp, name))
    told = re.search(rf"^    (?:\w+, )*{field}(?:, \w+)*:(.*(?:\n        .*)*)", words,
                     flags=re.MULTILINE)
    return told and re.search(r"\([\w ,-]+,?\)" if is_array else r"\[.+\]", told[1], re.DOTALL)


def test_numbers_of_results_have_a_unit_and_arrays_a_shape():
    found = list(fields_with_numbers())
    assert len(found) > 100
    wrong = [x for x in found if not has_unit_or_shape(*x)]
    assert not wrong, listed(wrong)


def test_sections_are_in_the_order_of_google_style():
    order = ("Attributes", "Args", "Returns", "Raises", "Example")
    heads = {name: re.findall(r"^(\w+):\n(?=    \S)", inspect.getdoc(thing) or "",
                              flags=re.MULTILINE) for name, thing in NAMES.items()}
    wrong = {name: there for name, there in heads.items()
             if there != [x for x in order if x in there]}
    assert not wrong, listed(wrong)


# ---------------------------------------------------------------- the examples are true


def group_of(name):
    """Return the group of names whose examples one test runs."""
    if name in BROWSER:
        return "drawn by a browser"
    if name in OPTIONAL:
        return OPTIONAL[name]
    if name in LONG:
        return "long"
    room, _, member = name.partition(".")
    if room in ("operators", *MODULES):
        return "operators and constructors"
    return "members of types" if member else "types" if inspect.isclass(NAMES[name]) else "verbs"


GROUPS = {}
for _name in NAMES:
    if example_of(_name).examples:
        GROUPS.setdefault(group_of(_name), []).append(_name)
MARKS = {
    "drawn by a browser": [pytest.mark.browser, needs_browser, pytest.mark.slow],
    "long": [pytest.mark.slow],
}


@pytest.mark.parametrize("group", [pytest.param(x, marks=MARKS.get(x, ())) for x in GROUPS])
def test_examples_are_true(group, tmp_path, monkeypatch):
    for library in set(OPTIONAL.values()) & {group}:
        pytest.importorskip(library)
    failed, text = [], []
    for name in GROUPS[group]:
        (tmp_path / name).mkdir()
        monkeypatch.chdir(tmp_path / name)
        result = doctest.DocTestRunner(Numbers()).run(example_of(name), out=text.append)
        failed += [name] if result.failed else []
    assert not failed, "".join(text)


def test_the_example_of_a_verb_always_runs():
    assert not LONG & {name for name in sp.__all__ if inspect.isfunction(NAMES[name])}
    assert NAMES.keys() >= LONG | BROWSER | OPTIONAL.keys()
