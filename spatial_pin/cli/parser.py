"""The words of the command line as options: every command with its own."""

from __future__ import annotations

import argparse
import re
import textwrap
from collections.abc import Iterable, Sequence
from typing import Any

import spatial_pin as sp
from spatial_pin.cli.commands import COMMANDS, GROUPS
from spatial_pin.cli.options import MECHANISM, as_taken
from spatial_pin.errors import suggestion

DESCRIPTION = "Spatial mechanisms with closed loops: load, close, move, see."
MORE = "`spatial-pin COMMAND --help` says what a command takes."
COLUMN, WIDTH = 15, 80  # where the texts of commands begin in the help, and where they end


def options_of(words: Sequence[str]) -> argparse.Namespace:
    """Return the options that words ask for; their `run` is the command's.

    Raises:
        SystemExit: the words are none of a command, or ask for help.
    """
    whole = parser()
    if words and words[0] not in COMMANDS and not words[0].startswith("-"):
        whole.error(f"no command {words[0]!r}; {_near(words[0], COMMANDS)}")
    if words and words[0] in COMMANDS:
        words = as_taken(words, whole.get_default("parsers")[words[0]])
    # argparse takes -90deg for an option, but nothing that begins with a space
    options, rest = whole.parse_known_args(
        [f" {w}" if re.match(r"-\.?\d", w) else w for w in words])
    for word in rest:
        sub = options.parsers[options.command]
        known = [flag for action in sub._actions for flag in action.option_strings]
        sub.error(f"no option {word!r}; {_near(word, known)}" if word.startswith("--") else
                  f"nothing more is expected than was given before {word.strip()!r}")
    return options


def _near(word: str, known: Iterable[str]) -> str:
    """Return the nearest of some words, else where they are told."""
    near = suggestion(word, known)
    return near if near.startswith("did you mean") else "--help says which there are"


class _Parser(argparse.ArgumentParser):
    """Takes options between the words of a command: `assemble rssr --set d=315mm crank=60deg`."""

    _within = False

    def __init__(self, **settings: Any) -> None:
        super().__init__(allow_abbrev=False, **settings)  # --n would be any option with an n

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        if self.get_default("run") is None or self._within:
            return super().parse_known_args(args, namespace)
        self._within = True  # the next line calls this again, for options and words in turn
        try:
            return self.parse_known_intermixed_args(args, namespace)
        finally:
            self._within = False


def _commands() -> str:
    """Return what every command does, subject by subject."""
    lines = []
    for title, group in GROUPS.items():
        lines += ["", f"{title}:"]
        for name, command in group.items():
            lines += textwrap.wrap(command.text, WIDTH, initial_indent=f"  {name:{COLUMN - 2}}",
                                   subsequent_indent=" " * COLUMN)
    return "\n".join([*lines, "", MORE])


def parser() -> argparse.ArgumentParser:
    """Return the parser of all commands."""
    whole = _Parser(prog="spatial-pin", usage="spatial-pin [-h] [--version] COMMAND ...",
                    description=DESCRIPTION, epilog=_commands(),
                    formatter_class=argparse.RawDescriptionHelpFormatter)
    whole.add_argument("--version", action="version", version=f"spatial-pin {sp.__version__}")
    commands = whole.add_subparsers(dest="command", required=True, metavar="COMMAND",
                                    prog="spatial-pin", help=argparse.SUPPRESS)
    parsers: dict[str, argparse.ArgumentParser] = {}
    for name, command in COMMANDS.items():
        sub = parsers[name] = commands.add_parser(name, description=command.text)
        sub.set_defaults(run=command.run, usage_error=sub.error, hints=[], cut_short="",
                         parsers=parsers)
        for flags, settings in MECHANISM if command.takes_mechanism else ():
            sub.add_argument(*flags, **settings)
        group = sub.add_mutually_exclusive_group(required=True) if command.one_of else sub
        for flags, settings in command.one_of:
            group.add_argument(*flags, **settings)
        for flags, settings in command.options:
            sub.add_argument(*flags, **settings)
    whole.set_defaults(parsers=parsers)
    return whole
