"""Options of several commands, the values of options, and the type of a command."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Collection, Sequence
from typing import Any, NamedTuple

from spatial_pin.cli.printing import SCREEN
from spatial_pin.cli.tables import read_target
from spatial_pin.dimensions.bounds import Bounds
from spatial_pin.units import ValueWithUnit, quantity

SPRINGS_HELP = "; springs for all joints that springs act about"
MECHANISM_HELP = ("library name (see `spatial-pin list`), or path of a mechanism file (.toml), or "
                  "of a robot: .urdf, .xacro, .xml (MJCF), .sdf, .usd, .yaml")
AT_HELP = "values of drivers or coordinates, as crank=60deg; the others keep those of the guess"


Option = tuple[str, dict[str, Any]]  # flag and settings, as `add_argument` takes them


class Command(NamedTuple):
    """A command of `spatial-pin`."""

    run: Callable[[Any], None]  # its function, whose docstring is the help
    options: tuple[Option, ...]  # of its parser
    takes_mechanism: bool = True  # whether its first word names a mechanism
    one_of: tuple[Option, ...] = ()  # options that exclude each other; one must be given

    @property
    def text(self) -> str:
        """Its line in the help."""
        words = (self.run.__doc__ or "").rstrip(".")
        return words[:1].lower() + words[1:]


# ---------------------------------------------------------------- options


def option(flag: str, help: str, **settings: Any) -> Option:
    """Return an option, or a word that a command takes."""
    return flag, {"help": help, **settings}


def many(
    flag: str, help: str, metavar: str | tuple[str, ...] = "NAME", **settings: Any
) -> Option:
    """Return an option that may be given again and again."""
    return option(flag, help, metavar=metavar, action="append", default=[], **settings)


def switch(flag: str, help: str) -> Option:
    """Return an option without a value."""
    return option(flag, help, action="store_true")


def file_option(flag: str, help: str, **settings: Any) -> Option:
    """Return an option that names a file."""
    return option(flag, help, metavar="F", **settings)


def data_options(json: str, csv: str = "") -> tuple[Option, ...]:
    """Return `--json` and, where there is a table, `--csv`, with the words for their contents."""
    return tuple(file_option(flag, f"write {what} as {form} (to the screen without F)", nargs="?",
                             const=SCREEN)
                 for flag, what, form in (("--json", json, "JSON"), ("--csv", csv, "a table"))
                 if what)


def hold_option(more: str = "") -> Option:
    """Return the option of held coordinates."""
    return many("--hold", f"a joint or coordinate that is held, besides a free base{more}")


def sweep_arguments(needed: bool = True) -> tuple[Option, ...]:
    """Return the options of a sweep: driver, first and last value, steps, speed."""
    times = None if needed else "?"
    return (
        option("driver", "driver or coordinate", nargs=times),
        option("first", "value, as -60deg", nargs=times, type=value),
        option("last", "value, as 0.3m", nargs=times, type=value),
        option("--steps", "number of values (361)", type=count, default=361),
        option("--speed",
               "of the driver, as 240rpm; without one the motion has no time, and its forces are "
               "those at rest", type=value),
        option("--acceleration", "of the driver", type=value, default=0.0),
        switch("--stop", "end at a limit position instead of failing"),
        *GUESS,
    )


def over_options(held: str = f"{SPRINGS_HELP} (--over)") -> tuple[Option, ...]:
    """Return the options of a sweep without speed, for a row at each value."""
    return (
        option("--over", "do it all along a sweep of this driver or coordinate", type=span,
               metavar="DRIVER=LO..HI"),
        option("--steps", "number of values of --over (361)", type=count, default=361),
        hold_option(held),
    )


def start_options(speed: str) -> tuple[Option, ...]:
    """Return the options of the start of a simulation."""
    return (
        many("--at", "configuration at the start of the simulation", type=setting,
             metavar="DRIVER=VALUE"),
        many(speed, "speed at the start, as crank=240rpm", type=setting, metavar="DRIVER=VALUE"),
        many("--effort", "a constant torque [N·m] or force [N] in it", type=setting,
             metavar="JOINT=VALUE"),
    )


# ---------------------------------------------------------------- values


def value(text: str) -> ValueWithUnit:
    """Return a number with a unit or without one."""
    try:
        return quantity(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def above_zero(text: str) -> ValueWithUnit:
    """Return a number above zero, with a unit or without one."""
    number = value(text)
    if not number > 0.0:
        raise argparse.ArgumentTypeError(f"{text!r} is not above zero")
    return number


def not_negative(text: str) -> ValueWithUnit:
    """Return a number from zero up, with a unit or without one."""
    number = value(text)
    if number < 0.0:
        raise argparse.ArgumentTypeError(f"{text!r} is negative")
    return number


def positive(text: str) -> float:
    """Return a number above zero without a unit."""
    number = value(text)
    if not number > 0.0 or number.unit:
        raise argparse.ArgumentTypeError(f"{text!r} is not a positive number without a unit")
    return number


def count(text: str) -> int:
    """Return a whole number of at least 1."""
    if not text.strip().isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of at least 1")
    return int(text)


def from_zero(text: str) -> int:
    """Return a whole number from 0 up."""
    if not text.strip().isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 0 up")
    return int(text)


def _named(text: str, form: str, sign: str = "=") -> tuple[str, str]:
    """Return name and value of a text; refuse one of another form, without the sign in it."""
    name, equals, given = text.partition("=")
    if not (name and equals and sign in equals + given):
        raise argparse.ArgumentTypeError(f"{text!r} is not {form}")
    return name, given


def setting(text: str) -> tuple[str, float]:
    """Return name and value of `NAME=VALUE`."""
    name, given = _named(text, "NAME=VALUE")
    return name, value(given)


def spread(text: str) -> tuple[str, float]:
    """Return name and value of `NAME=VALUE`, which is not negative."""
    name, number = setting(text)
    if number < 0.0:
        raise argparse.ArgumentTypeError(f"{text!r} is negative")
    return name, number


def rising(text: str) -> tuple[str, tuple[ValueWithUnit, ValueWithUnit]]:
    """Return name and ends of `NAME=LO..HI`, the smaller one first."""
    name, (low, high) = span(text)
    if not low < high:
        raise argparse.ArgumentTypeError(f"{text!r}: the smaller one goes first")
    return name, (low, high)


def span(text: str) -> tuple[str, tuple[ValueWithUnit, ValueWithUnit]]:
    """Return name and ends of `NAME=LO..HI`."""
    name, given = _named(text, "NAME=LO..HI", "..")
    low, _, high = given.partition("..")
    return name, (value(low), value(high))


def bounded(text: str) -> tuple[str, Bounds]:
    """Return name and ends of `NAME=LO..HI`; None for an end left out, and for those of `NAME`."""
    if "=" not in text:
        return text, None
    name, given = _named(text, "NAME=LO..HI", "..")
    low, _, high = given.partition("..")
    return name, (value(low) if low else None, value(high) if high else None)


def numbers(text: str) -> tuple[str, tuple[ValueWithUnit, ...]]:
    """Return name and numbers of `NAME=A,B,C`."""
    name, given = _named(text, "NAME=A,B,C")
    return name, tuple(value(word) for word in given.split(","))


def target(text: str) -> tuple[str, Any]:
    """Return name and target of `reach`."""
    try:
        return read_target(text)
    except (ValueError, TypeError) as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def package(text: str) -> tuple[str, str]:
    """Return name and folder of `NAME=FOLDER`."""
    name, folder = _named(text, "NAME=FOLDER")
    if not folder:
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=FOLDER")
    return name, folder


# ---------------------------------------------------------------- options of several commands

MECHANISM = (
    option("mechanism", MECHANISM_HELP, metavar="M"),
    many("--set", "a dimension of the mechanism, as d=315mm", dest="parameters", type=setting,
         metavar="NAME=VALUE"),
    switch("--trusted", "its xacro files may read files outside their folder"),
    switch("--free-flyer", "a floating joint carries its root link"),
    many("--package", "where package://NAME lies, as its files name meshes", dest="packages",
         type=package, metavar="NAME=FOLDER"),
    option("--model", "which model of an SDFormat file with several", metavar="NAME"),
    many("--without", "an element or joint of its tree's file that is left out"),
)
GUESS = (
    many("--guess", "start from here instead of the file's guess", type=setting,
         metavar="JOINT=VALUE"),
)
CONFIGURATION = (
    option("values", AT_HELP, nargs="*", default=[], type=setting, metavar="DRIVER=VALUE"),
    *GUESS,
)
RATE_OPTIONS = (
    many("--speed", "how fast a driver goes, as crank=240rpm (0)", type=setting,
         metavar="DRIVER=VALUE"),
    many("--acceleration", "acceleration of a driver (0)", type=setting, metavar="DRIVER=VALUE"),
)
WORKERS = (
    option("--workers", "processes that work on it; the answer is the same (1)", type=count,
           default=1),
)
LOOK = (
    many("--trace", "draw the path of a link, frame or joint, or of LINK.com"),
    many("--arrow", "draw a velocity or acceleration as an arrow", metavar="NAME.velocity"),
    switch("--axes", "draw the axes of the joints"),
    switch("--pairs", "draw a sign for every pair"),
    switch("--centres", "mark the centres of mass"),
)
RESULT = (
    *data_options("the motion and its events", "coordinates, rates and accelerations"),
    file_option("--npz", "write all arrays"),
    file_option("--plot", "write a figure (.png, .svg, .pdf)"),
    many("--output",
         "what --plot shows, as rocker_pin.ratio, coupler.com.acceleration or crank.effort"),
    file_option("--html", "write a self-contained page with the animation"),
    switch("--clearance",
           "say how near links come to each other, and where they touch; the page shows it"),
    *LOOK,
)


# ---------------------------------------------------------------- ranges as people write them

RANGES = (bounded, rising, span)  # readers of NAME=LO..HI
DATA = ("--json", "--csv")  # options whose file may be left out


def as_taken(words: Sequence[str], parser: argparse.ArgumentParser) -> list[str]:
    """Return the words of a command with ranges, and data for the screen, as its parser takes them.

    `crank 0 360deg`, `crank 0..360deg`, `crank=0..360deg` and `crank=0 360deg` are one range: three
    words where the parser takes a first and a last value, else one.
    """
    actions = parser._actions
    valued = {flag for action in actions if action.nargs != 0 for flag in action.option_strings}
    ranged = {flag for action in actions if action.type in RANGES
              for flag in action.option_strings or [""]}
    has_ends = any(action.dest == "first" for action in actions)
    taken: list[str] = []
    for word in words:
        name, ends = _range(word)
        before, known = _range(taken[-1]) if taken else ("", [])
        if taken and taken[-1] in DATA and "=" in word:
            taken += [SCREEN, word]  # NAME=VALUE is no file
        elif has_ends and ends and _option(taken, valued) == "":
            taken += [name, *ends] if name else ends
        elif ends and not name and before and len(known) < 2 and _option(
                taken[:-1], valued) in ranged:
            taken[-1] += f"..{word}" if known else f"={word}"
        else:
            taken.append(word)
    return taken


def _option(words: Sequence[str], valued: Collection[str]) -> str:
    """Return the option that the next word is a value of, "" for none."""
    return words[-1] if words and words[-1] in valued else ""


def _range(word: str) -> tuple[str, list[str]]:
    """Return the name, "" without one, and the numbers of `NAME=LO..HI`, or of a part of it."""
    name, equals, given = word.partition("=")
    numbers = (given if equals else word).split("..")
    try:
        for number in numbers:
            quantity(number)
    except ValueError:
        return ("" if equals or word.startswith("-") else word), []
    return (name if equals else ""), numbers if len(numbers) < 3 else []
