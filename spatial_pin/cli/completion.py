"""Scripts with which a shell completes commands, options, mechanisms and the names they have."""

from __future__ import annotations

import argparse
import re
import shlex
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from importlib.resources import files
from pathlib import Path

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


Parsers = Mapping[str, argparse.ArgumentParser]  # of the commands, by their names


def _options(parser: argparse.ArgumentParser) -> Iterator[tuple[str, argparse.Action]]:
    """Yield the options of a command, as they are typed."""
    for action in parser._actions:
        yield from ((flag, action) for flag in action.option_strings if flag.startswith("--"))


def _positional(parser: argparse.ArgumentParser) -> tuple[bool, str, str]:
    """Return whether a mechanism comes first, and the kinds of the next word and of all others."""
    words = [action for action in parser._actions if not action.option_strings]
    takes_mechanism = bool(words) and words[0].dest == "mechanism"
    behind = words[1:] if takes_mechanism else []
    kinds = [kind_of(action) for action in behind] or [""]
    goes_on = bool(behind) and behind[-1].nargs in ("*", "+")
    return takes_mechanism, kinds[0], kinds[-1] * goes_on


def kind_of(action: argparse.Action) -> str:
    """Return the kind of names that an argument begins with; "" for none."""
    return CALLED.get(action.metavar or "") or NAMED.get(action.dest, "")


def _values(parsers: Parsers, line: Callable[[str, argparse.Action], str]) -> str:
    """Return a line for each option of each command that a value follows."""
    return "\n".join(line(f'"{name} {flag}")', action) for name, parser in parsers.items()
                     for flag, action in _options(parser) if action.nargs != 0)


def _positions(parsers: Parsers, first: int, line: Callable[[str, str], str]) -> str:
    """Return a line for each word after the mechanism; `first` is the number of the first."""
    kinds = {name: _positional(parser)[1:] for name, parser in parsers.items()}
    patterns = {f'"{first} {name}")': kind for name, (kind, _) in kinds.items()} | {
        f'*" {name}")': kind for name, (_, kind) in kinds.items()}
    return "\n".join(line(pattern, kind) for pattern, kind in patterns.items() if kind)


def _flags(parsers: Parsers, line: str) -> str:
    """Return a line for each command, with its options."""
    return "\n".join(line.format(name, " ".join(flag for flag, _ in _options(parser)))
                     for name, parser in parsers.items())


def _taking(parsers: Parsers) -> list[str]:
    return [name for name, parser in parsers.items() if _positional(parser)[0]]


def _choices(action: argparse.Action) -> str:
    return " ".join(map(str, action.choices or ()))


def _filled(shell: str, **parts: str) -> str:
    """Return the template of a script with its marks replaced."""
    template = files("spatial_pin.cli").joinpath(f"templates/completion.{shell}").read_text("utf-8")
    parts |= {"NAMES": NAMES, "SHELLS": " ".join(SHELLS), "MECHANISMS": " ".join(list_mechanisms())}
    return re.sub("@([A-Z]+)@", lambda mark: parts[mark[1]], template)


def _bash(parsers: Parsers) -> str:
    values = _values(parsers, lambda at, action: f'        {at} kind="{kind_of(action)}"; '
                     f'words="{_choices(action)}"; value=yes ;;')
    positions = _positions(parsers, 3, lambda at, kind: f'        {at} kind="{kind}" ;;')
    return _filled("bash", VALUES=values, FLAGS=_flags(parsers, '        {}) words="{}" ;;'),
                   PLACES=positions, WORDS=" ".join(parsers),
                   TAKING="|".join(f'"2 {name}"' for name in _taking(parsers)))


def _zsh(parsers: Parsers) -> str:
    texts = {name: (parser.description or "").replace(":", "\\:")
             for name, parser in parsers.items()}
    described = "\n".join(f"        {_quoted(f'{name}:{text}')}" for name, text in texts.items())
    values = _values(parsers, lambda at, action: f"        {at} " + (
        f"kind={kind_of(action)}" if kind_of(action) else
        f"compadd -- {_choices(action)}; return" if action.choices else "_files; return") + " ;;")
    positions = _positions(parsers, 4, lambda at, kind: f"        {at} kind={kind} ;;")
    return _filled("zsh", VALUES=values, FLAGS=_flags(parsers, "            {}) compadd -- {} ;;"),
                   PLACES=positions, COMMANDS=described,
                   TAKING="|".join(f'"3 {name}"' for name in _taking(parsers)))


def _fish(parsers: Parsers) -> str:
    start = "complete -c spatial-pin"
    lines = ["# Completion of spatial-pin; in ~/.config/fish/config.fish:",
             "# spatial-pin completion fish | source"]
    for name, parser in parsers.items():
        text = _quoted(parser.description or "")
        lines.append(f"{start} -n __fish_use_subcommand -f -a {name} -d {text}")
        seen = f"__fish_seen_subcommand_from {name}"
        for flag, action in _options(parser):
            kind = kind_of(action)
            offered = _fish_names(kind) if kind else _choices(action)
            takes = "" if action.nargs == 0 else f" -x -a '{offered}'" if offered else " -r"
            text = _quoted(" ".join((action.help or "").split()))
            lines.append(f"{start} -n '{seen}' -l {flag[2:]}{takes} -d {text}")
        for count, kind in zip(("-eq 3", "-gt 3"), _positional(parser)[1:], strict=True):
            if kind:
                lines.append(f"{start} -n '{seen}; and test (count (commandline -opc)) {count}' "
                             f"-a '{_fish_names(kind)}'")
    lines.append(f"{start} -n '__fish_seen_subcommand_from {' '.join(_taking(parsers))}; and test "
                 f"(count (commandline -opc)) -eq 2' -a '{' '.join(list_mechanisms())}'")
    lines.append(f"{start} -n '__fish_seen_subcommand_from completion' -f -a '{' '.join(SHELLS)}'")
    return "\n".join(lines) + "\n"


def _fish_names(kind: str) -> str:
    return f"(spatial-pin {NAMES} {kind} (commandline -opc)[3] 2>/dev/null)"


def _quoted(text: str) -> str:
    """Return text as one word of zsh and fish; a quote in it is a typographic one there."""
    return "'" + text.replace("'", "’") + "'"


# To add a shell: a function of the commands that returns its script.
SHELLS: dict[str, Callable[[Parsers], str]] = {"bash": _bash, "zsh": _zsh, "fish": _fish}


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
