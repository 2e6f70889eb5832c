"""Scripts with which a shell completes commands, options, mechanisms and the names they have."""

from __future__ import annotations

import argparse
import re
import shlex
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

import spatial_pin as sp
from spatial_pin.assembly.holding import BASE, SPRINGS
from spatial_pin.formats.files import list_mechanisms

NAMES = "_names"  # the first word of a command line that asks for names
PLAIN = re.compile(r"[\w.+/-]+")  # no sign that means something to a shell, which expands names

# Which of `KINDS` a word is, by how the help calls it, else by the option's own name.
CALLED = {
    "DRIVER": "coordinate", "DRIVER=VALUE": "coordinate=", "JOINT=VALUE": "coordinate=",
    "DRIVER=LO..HI": "coordinate=", "FRAME": "frame", ("LINK", "LINK"): "frame",
    "OUTPUT": "output", "NAME.velocity": "arrow", "TARGET": "target=",
}
NAMED = {
    "driver": "coordinate", "by": "coordinate", "actuated": "coordinate", "read": "coordinate",
    "hold": "held", "output": "output", "only": "output", "trace": "frame", "loads": "frame=",
    "pair": "pair", "to": "dimension", "dimension": "dimension", "parameters": "dimension=",
    "inputs": "coordinate", "outputs": "output", "constant": "coordinate=",
    "deviation": "dimension=", "dimensions": "dimension=", "ranges": "range=",
}


class _Option(NamedTuple):
    """An option: as it is typed, its help, whether a word follows, and what may begin that one."""

    flag: str
    text: str
    takes_value: bool
    choices: tuple[str, ...]
    kind: str  # of names of the mechanism, "" for none


class _CommandWords(NamedTuple):
    """A command: its help, whether a mechanism comes next, and kinds of the words behind that."""

    name: str
    text: str
    takes_mechanism: bool
    options: tuple[_Option, ...]
    first: str
    rest: str

    @property
    def flags(self) -> str:
        return " ".join(option.flag for option in self.options)


def script(shell: str, parsers: Mapping[str, argparse.ArgumentParser]) -> str:
    """Return the script of a shell, one of `SHELLS`."""
    commands = []
    for name, parser in parsers.items():
        options = []
        for action in parser._actions:
            takes_value, text = action.nargs != 0, " ".join((action.help or "").split())
            choices = tuple(map(str, action.choices or ()))
            options += [_Option(flag, text, takes_value, choices, kind_of(action) * takes_value)
                        for flag in action.option_strings if flag.startswith("--")]
        words = [action for action in parser._actions if not action.option_strings]
        takes_mechanism = bool(words) and words[0].dest == "mechanism"
        behind = words[1:] if takes_mechanism else []
        kinds = [kind_of(action) for action in behind] or [""]
        rest = kinds[-1] if behind and behind[-1].nargs in ("*", "+") else ""
        commands.append(_CommandWords(name, parser.description or "", takes_mechanism,
                                      tuple(options), kinds[0], rest))
    return SHELLS[shell](commands, list_mechanisms())


def kind_of(action: argparse.Action) -> str:
    """Return the kind of names that an argument begins with; "" for none."""
    return CALLED.get(action.metavar or "") or NAMED.get(action.dest, "")


def _values(words: list[_CommandWords], line: Callable[[str, _Option], str]) -> str:
    """Return a line for each option of each command that a value follows."""
    return "\n".join(line(f'"{word.name} {option.flag}")', option)
                     for word in words for option in word.options if option.takes_value)


def _positions(words: list[_CommandWords], first: int, line: Callable[[str, str], str]) -> str:
    """Return a line for each word after the mechanism; `first` is the number of the first."""
    patterns = {f'"{first} {word.name}")': word.first for word in words} | {
        f'*" {word.name}")': word.rest for word in words}
    return "\n".join(line(pattern, kind) for pattern, kind in patterns.items() if kind)


def _filled(shell: str, mechanisms: list[str], **parts: str) -> str:
    """Return the template of a script with its marks replaced."""
    template = files("spatial_pin.cli").joinpath(f"templates/completion.{shell}").read_text("utf-8")
    parts |= {"NAMES": NAMES, "SHELLS": " ".join(SHELLS), "MECHANISMS": " ".join(mechanisms)}
    return re.sub("@([A-Z]+)@", lambda mark: parts[mark[1]], template)


def _bash(words: list[_CommandWords], mechanisms: list[str]) -> str:
    taking = [word.name for word in words if word.takes_mechanism]
    values = _values(words, lambda at, option: f'        {at} kind="{option.kind}"; '
                     f'words="{" ".join(option.choices)}"; value=yes ;;')
    flags = "\n".join(f'        {word.name}) words="{word.flags}" ;;' for word in words)
    positions = _positions(words, 3, lambda at, kind: f'        {at} kind="{kind}" ;;')
    return _filled("bash", mechanisms, VALUES=values, FLAGS=flags, PLACES=positions,
                   WORDS=" ".join(word.name for word in words),
                   TAKING="|".join(f'"2 {name}"' for name in taking))


def _zsh(words: list[_CommandWords], mechanisms: list[str]) -> str:
    taking = [word.name for word in words if word.takes_mechanism]
    texts = {word.name: word.text.replace(":", "\\:") for word in words}
    described = "\n".join(f"        {_quoted(f'{name}:{text}')}" for name, text in texts.items())
    values = _values(words, lambda at, option: f"        {at} " + (
        f"kind={option.kind}" if option.kind else
        f"compadd -- {' '.join(option.choices)}; return" if option.choices else
        "_files; return") + " ;;")
    flags = "\n".join(f"            {word.name}) compadd -- {word.flags} ;;" for word in words)
    positions = _positions(words, 4, lambda at, kind: f"        {at} kind={kind} ;;")
    return _filled("zsh", mechanisms, VALUES=values, FLAGS=flags, PLACES=positions,
                   COMMANDS=described, TAKING="|".join(f'"3 {name}"' for name in taking))


def _fish(words: list[_CommandWords], mechanisms: list[str]) -> str:
    taking = [word.name for word in words if word.takes_mechanism]
    start = "complete -c spatial-pin"
    lines = ["# Completion of spatial-pin; in ~/.config/fish/config.fish:",
             "# spatial-pin completion fish | source"]
    for word in words:
        lines.append(f"{start} -n __fish_use_subcommand -f -a {word.name} -d {_quoted(word.text)}")
        seen = f"__fish_seen_subcommand_from {word.name}"
        for option in word.options:
            offered = _fish_names(option.kind) if option.kind else " ".join(option.choices)
            takes = f" -x -a '{offered}'" if offered else " -r"
            lines.append(f"{start} -n '{seen}' -l {option.flag[2:]}{takes * option.takes_value} "
                         f"-d {_quoted(option.text)}")
        for count, kind in (("-eq 3", word.first), ("-gt 3", word.rest)):
            if kind:
                lines.append(f"{start} -n '{seen}; and test (count (commandline -opc)) {count}' "
                             f"-a '{_fish_names(kind)}'")
    lines.append(f"{start} -n '__fish_seen_subcommand_from {' '.join(taking)}; "
                 f"and test (count (commandline -opc)) -eq 2' -a '{' '.join(mechanisms)}'")
    lines.append(f"{start} -n '__fish_seen_subcommand_from completion' -f -a '{' '.join(SHELLS)}'")
    return "\n".join(lines) + "\n"


def _fish_names(kind: str) -> str:
    return f"(spatial-pin {NAMES} {kind} (commandline -opc)[3] 2>/dev/null)"


def _quoted(text: str) -> str:
    """Return text as one word of zsh and fish; a quote in it is a typographic one there."""
    return "'" + text.replace("'", "’") + "'"


# To add a shell: a function of the commands and the mechanisms' names that returns its script.
SHELLS: dict[str, Callable[[list[_CommandWords], list[str]], str]] = {
    "bash": _bash, "zsh": _zsh, "fish": _fish,
}


# ---------------------------------------------------------------- names of a mechanism


def offer(words: Sequence[str]) -> int:
    """Print the names of a kind, one a line; nothing where there are none, for whatever reason.

    The words are one of `KINDS`, with `=` where a value comes after the name, and the mechanism.
    """
    try:
        kind, typed = words
        (name,) = shlex.split(typed)
        warnings.simplefilter("ignore")
        mechanism = sp.load(Path(name).expanduser() if name.startswith("~") else name)
        names = dict.fromkeys(KINDS[kind.removesuffix("=")](mechanism))
        equals = "=" * kind.endswith("=")
        print("".join(f"{name}{equals}\n" for name in names if PLAIN.fullmatch(name)), end="",
              flush=True)
    except (Exception, KeyboardInterrupt):  # no errors while a file is being written
        return 1
    return 0


def _coordinates(mechanism: sp.Mechanism) -> list[str]:
    return [*mechanism.drivers, *mechanism.coordinate_table]


def _joints(mechanism: sp.Mechanism) -> list[str]:
    return list(mechanism.model.names)[1:]


def _frames(mechanism: sp.Mechanism, *of: str) -> list[str]:
    frames = [name for name in mechanism.frame_ids if name != "universe"]
    return [f"{name}.{part}" for name in frames for part in of] or frames


def _ranges(mechanism: sp.Mechanism) -> list[str]:
    from spatial_pin.workspace.grid_axes import PARTS  # on use: every command imports this

    return [*_coordinates(mechanism), *PARTS]


# To add a kind of word: a function from a mechanism to its words. `completion` has the kinds.
KINDS: dict[str, Callable[[sp.Mechanism], Iterable[str]]] = {
    "coordinate": _coordinates,
    "held": lambda m: [*_coordinates(m), *_joints(m), str(BASE), SPRINGS],
    "dimension": lambda m: m.dimensions,
    "frame": _frames,
    "arrow": lambda m: _frames(m, "velocity", "acceleration"),
    "pair": lambda m: [*_joints(m), *(closure.name for closure in m.closures)],
    "output": lambda m: [*_coordinates(m), *_frames(m, "position")],
    "range": _ranges,
    "target": lambda m: [*_coordinates(m), *_frames(m, "position", "pose")],
}
