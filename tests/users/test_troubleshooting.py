"""The page on errors: its messages are those of the code, and every kind of error is on it."""

import ast
import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from offenders import listed

import spatial_pin as sp
from spatial_pin import errors

PACKAGE = Path(sp.__file__).parent
PAGE = PACKAGE.parent / "docs" / "troubleshooting.md"
if not PAGE.is_file():
    pytest.skip("no documentation here", allow_module_level=True)
TEXT = PAGE.read_text(encoding="utf-8")
ENTRY = re.compile(r"^(`.+`) \(([\w, ]+)\)\n: \*\*Cause\.\*\* \S.*\n: \*\*Remedy\.\*\* \S.*$",
                   flags=re.MULTILINE)
ENTRIES = {message: kinds.split(", ") for messages, kinds in ENTRY.findall(TEXT)
           for message in re.findall(r"`([^`]+)`", messages)}
KINDS = {name for name, kind in vars(errors).items()
         if isinstance(kind, type) and issubclass(kind, sp.SpatialPinError)}
GAP = "\0"  # what differs from one message to another


def template(node):
    """Return a text of the code with gaps where it has values."""
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else GAP
    if isinstance(node, ast.JoinedStr):
        return "".join(map(template, node.values))
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return template(node.left) + template(node.right)
    return GAP


@cache
def code():
    """Return the texts of the code with two words, and (file, text) of the errors it raises."""
    texts, errors_raised = set(), []
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant | ast.JoinedStr | ast.BinOp):
                texts.add(template(node))
            elif isinstance(node, ast.Call) and node.args and (
                    getattr(node.func, "id", "") in KINDS - {"UnknownNameError"}):
                errors_raised.append((path.relative_to(PACKAGE).as_posix(),
                                      template(node.args[0])))
    return {text for text in texts if " " in text}, errors_raised


def pattern(message):
    """Return an expression for a message, or for a text of the code that makes it."""
    return re.compile(".*?".join(map(re.escape, parts(message))), flags=re.DOTALL)


def parts(message):
    """Return what a message says whatever its values are."""
    return [part.strip() for part in message.split("…") if part.strip()]


def test_every_entry_has_a_message_a_kind_a_cause_and_a_remedy():
    terms = re.findall(r"^`.*\)$", TEXT, flags=re.MULTILINE)
    assert len(terms) == len(ENTRY.findall(TEXT)) > 100
    known = {*KINDS, "Interrupted", "SpatialPinWarning", "ValueError", "TypeError", "usage"}
    assert {kind for kinds in ENTRIES.values() for kind in kinds} <= known


def test_every_message_is_one_of_the_code():
    texts, _ = code()
    wrong = [message for message in ENTRIES if not any(
        pattern(message).search(text) for text in texts if max(parts(message), key=len) in text)]
    assert not wrong, listed(wrong)


def test_every_error_that_is_raised_is_reported():
    """A new error needs an entry on the page; one that another message is part of has it.

    Of what the code raises, as far as its own words say it.
    """
    patterns = [pattern(message) for message in ENTRIES]
    _, errors_raised = code()
    untold = [(where, text.replace(GAP, "…")) for where, text in errors_raised
              if re.search(r"\w{3}", text.removeprefix("mechanism "))
              and not any(p.search(text) for p in patterns)]
    assert not untold, listed(untold)


def test_every_kind_of_error_is_reported():
    told = {kind for kinds in ENTRIES.values() for kind in kinds}
    assert {*KINDS, "Interrupted", "SpatialPinWarning"} - told == set()


FOUR_BAR, OPEN = sp.load("four_bar"), sp.load("four_bar", r2=0.25)
MET = {  # what a user does, and how the message that comes is told
    "a wrong name": (lambda: sp.load("four_bra"), "no mechanism"),
    "a wrong coordinate": (lambda: sp.assemble(FOUR_BAR, {"crnk": 0.0}), "did you mean"),
    "a wrong dimension": (lambda: sp.load("four_bar", r9=1.0), "no parameter"),
    "out of reach": (lambda: sp.assemble(OPEN, {"crank": 3.0}), "stays open by"),
    "too far": (lambda: sp.sweep(OPEN, "crank", np.linspace(0.0, 3.0, 9)), "is out of reach"),
    "too much": (lambda: sp.solve_rates(FOUR_BAR, sp.assemble(FOUR_BAR),
                                        {"crank": 1.0, "rocker_pin": 1.0}), "are prescribed ("),
    "degrees": (lambda: sp.sweep(FOUR_BAR, "crank", [0.0, 1e7]), "is too far from the sample"),
    "all modes": (lambda: sp.assembly_modes(FOUR_BAR, free=["crank"]), "can still move"),
    "no native form": (lambda: FOUR_BAR.constraint_models(), "native closures"),
    "an effort of a motion": (lambda: sp.sweep(FOUR_BAR, "crank", [0.0, 0.1]).output(
        "crank.effort"), "a motion by itself"),
    "a sample": (lambda: sp.sweep(FOUR_BAR, "crank", [0.0, 0.1]).state(9), "there is no sample"),
    "a whole motion": (lambda: sp.solve_jerks(FOUR_BAR, sp.sweep(FOUR_BAR, "crank", [0.0])),
                       "not a whole Motion"),
    "two things": (lambda: sp.assemble(FOUR_BAR)["crank"], "and a link or frame too"),
    "not a number": (lambda: sp.sweep(FOUR_BAR, "crank", [0.0, np.nan]), "is NaN or inf"),
    "a text": (lambda: sp.sweep(FOUR_BAR, "crank", ["a"]), "must be finite numbers"),
    "no object": (lambda: sp.sweep("four_bar", "crank", [0.0, 1.0]), "is needed, not"),
}


@pytest.mark.parametrize("what", MET)
def test_what_users_meet_is_reported(what):
    """The message as it comes fits an entry, of the kind of error that it is."""
    act, begins = MET[what]
    with pytest.raises((sp.SpatialPinError, ValueError, TypeError)) as caught:
        act()
    (message,) = (m for m in ENTRIES if begins in m and pattern(m).search(str(caught.value)))
    assert type(caught.value).__name__ in ENTRIES[message]
