"""Scripts with which a shell completes commands, options, mechanisms and the names they have."""

from __future__ import annotations

import argparse
import re
import shlex
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
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
    "deviation": "dimension=", "dimensions": "dimension=", "ranges": "range=",
}


class Option(NamedTuple):
    """An option of a command.

    Attributes:
        flag: as it is typed, --steps.
        text: of the help.
        takes_value: whether a word follows it.
        choices: that this word may be, none where it may be anything.
        kind: of names of the mechanism that it may begin with; "" for none.
    """

    flag: str
    text: str
    takes_value: bool
    choices: tuple[str, ...]
    kind: str


class Word(NamedTuple):
    """A command.

    Attributes:
        name: as it is typed.
        text: what it does.
        takes_mechanism: whether a mechanism comes next.
        options: its options.
        first, rest: kinds of names that the words behind the mechanism begin with, "" for none.
    """

    name: str
    text: str
    takes_mechanism: bool
    options: tuple[Option, ...]
    first: str
    rest: str


def script(shell: str, parsers: Mapping[str, argparse.ArgumentParser]) -> str:
    """Return the script of a shell, one of `SHELLS`.

    Args:
        shell: its name.
        parsers: of the commands, by name.
    """
    words = [_word(name, parser) for name, parser in parsers.items()]
    return SHELLS[shell](words, list_mechanisms())


def _word(name: str, parser: argparse.ArgumentParser) -> Word:
    found = []
    for action in parser._actions:
        takes_value = action.nargs != 0
        choices = tuple(map(str, action.choices or ()))
        text = " ".join((action.help or "").split())
        found += [Option(flag, text, takes_value, choices, kind_of(action) * takes_value)
                  for flag in action.option_strings if flag.startswith("--")]
    words = [action for action in parser._actions if not action.option_strings]
    takes_mechanism = bool(words) and words[0].dest == "mechanism"
    behind = words[1:] if takes_mechanism else []
    kinds = [kind_of(action) for action in behind] or [""]
    rest = kinds[-1] if behind and behind[-1].nargs in ("*", "+") else ""
    return Word(name, parser.description or "", takes_mechanism, tuple(found), kinds[0], rest)


def kind_of(action: argparse.Action) -> str:
    """Return the kind of names that an argument begins with; "" for none."""
    return CALLED.get(action.metavar or "") or NAMED.get(action.dest, "")


def _flags(word: Word) -> str:
    return " ".join(option.flag for option in word.options)


def _taking(words: list[Word]) -> list[str]:
    return [word.name for word in words if word.takes_mechanism]


def _values(words: list[Word], line: Callable[[str, Option], str]) -> str:
    """Return a line for each option of each command that a value follows."""
    return "\n".join(line(f'"{word.name} {option.flag}")', option)
                     for word in words for option in word.options if option.takes_value)


def _places(words: list[Word], first: int, line: Callable[[str, str], str]) -> str:
    """Return a line for each word behind the mechanism that a name begins.

    Args:
        words: the commands.
        first: which word of the line is the first one behind the mechanism.
        line: makes one of a pattern of number and command, and of the kind.
    """
    patterns = {f'"{first} {word.name}")': word.first for word in words} | {
        f'*" {word.name}")': word.rest for word in words}
    return "\n".join(line(pattern, kind) for pattern, kind in patterns.items() if kind)


def _bash(words: list[Word], mechanisms: list[str]) -> str:
    values = _values(words, lambda at, option: f'        {at} kind="{option.kind}"; '
                     f'words="{" ".join(option.choices)}"; value=yes ;;')
    flags = "\n".join(f'        {word.name}) words="{_flags(word)}" ;;' for word in words)
    places = _places(words, 3, lambda at, kind: f'        {at} kind="{kind}" ;;')
    return f"""\
# Completion of spatial-pin; in ~/.bashrc: eval "$(spatial-pin completion bash)"
_spatial_pin() {{
    local current=${{COMP_WORDS[COMP_CWORD]}} before=${{COMP_WORDS[COMP_CWORD-1]}}
    local command=${{COMP_WORDS[1]}} words="" value="" kind=""
    COMPREPLY=()
    if ((COMP_CWORD == 1)); then
        words="{' '.join(word.name for word in words)} --help --version"
        COMPREPLY=($(compgen -W "$words" -- "$current"))
        return
    fi
    case "$command $before" in
{values}
    esac
    if [[ -z $value && $current == -* ]]; then
        case "$command" in
{flags}
        esac
        COMPREPLY=($(compgen -W "$words" -- "$current"))
        return
    fi
    [[ -n $value ]] || case "$COMP_CWORD $command" in
        {'|'.join(f'"2 {name}"' for name in _taking(words))})
            compopt -o filenames 2>/dev/null || true
            COMPREPLY=($(compgen -W "{' '.join(mechanisms)}" -- "$current") \\
                       $(compgen -f -- "$current")) ;;
        "2 completion") COMPREPLY=($(compgen -W "{' '.join(SHELLS)}" -- "$current")) ;;
{places}
    esac
    if [[ -n $kind && $current != "=" && $before != "=" ]]; then
        [[ $kind != *= ]] || compopt -o nospace 2>/dev/null || true
        words="$(spatial-pin {NAMES} "$kind" "${{COMP_WORDS[2]}}" 2>/dev/null)"
    fi
    # without words: names of files, by -o default
    [[ -z $words ]] || COMPREPLY=($(compgen -W "$words" -- "$current"))
}}
complete -o default -F _spatial_pin spatial-pin
"""


def _zsh(words: list[Word], mechanisms: list[str]) -> str:
    texts = {word.name: word.text.replace(":", "\\:") for word in words}
    described = "\n".join(f"        {_quoted(f'{name}:{text}')}" for name, text in texts.items())
    values = _values(words, lambda at, option: f"        {at} " + (
        f"kind={option.kind}" if option.kind else
        f"compadd -- {' '.join(option.choices)}; return" if option.choices else
        "_files; return") + " ;;")
    flags = "\n".join(f"            {word.name}) compadd -- {_flags(word)} ;;" for word in words)
    places = _places(words, 4, lambda at, kind: f"        {at} kind={kind} ;;")
    return f"""\
#compdef spatial-pin
# Completion of spatial-pin; in ~/.zshrc, behind compinit: eval "$(spatial-pin completion zsh)"
_spatial_pin() {{
    local kind=""
    local -a commands equals
    commands=(
{described}
    )
    if (( CURRENT == 2 )); then
        _describe command commands
        return
    fi
    case "$words[2] $words[CURRENT-1]" in
{values}
    esac
    if [[ -z $kind && $words[CURRENT] == -* ]]; then
        case "$words[2]" in
{flags}
        esac
        return
    fi
    [[ -n $kind ]] || case "$CURRENT $words[2]" in
        {'|'.join(f'"3 {name}"' for name in _taking(words))})
            compadd -- {' '.join(mechanisms)} ;;
        "3 completion") compadd -- {' '.join(SHELLS)}; return ;;
{places}
    esac
    if [[ -n $kind && $words[CURRENT] != *=* ]]; then
        [[ $kind != *= ]] || equals=(-S "")
        compadd $equals -- ${{(f)"$(spatial-pin {NAMES} $kind "$words[3]" 2>/dev/null)"}} && return
    fi
    _files
}}
compdef _spatial_pin spatial-pin
"""


def _fish(words: list[Word], mechanisms: list[str]) -> str:
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
    lines.append(f"{start} -n '__fish_seen_subcommand_from {' '.join(_taking(words))}; "
                 f"and test (count (commandline -opc)) -eq 2' -a '{' '.join(mechanisms)}'")
    lines.append(f"{start} -n '__fish_seen_subcommand_from completion' -f -a '{' '.join(SHELLS)}'")
    return "\n".join(lines) + "\n"


def _fish_names(kind: str) -> str:
    return f"(spatial-pin {NAMES} {kind} (commandline -opc)[3] 2>/dev/null)"


def _quoted(text: str) -> str:
    """Return text as one word of zsh and fish; a quote in it is a typographic one there."""
    return "'" + text.replace("'", "’") + "'"


# To add a shell: a function of the commands and the mechanisms' names that returns its script.
SHELLS: dict[str, Callable[[list[Word], list[str]], str]] = {
    "bash": _bash, "zsh": _zsh, "fish": _fish,
}


# ---------------------------------------------------------------- names of a mechanism


def offer(words: Sequence[str]) -> int:
    """Print the names of a kind, one a line; nothing where there are none, for whatever reason.

    Args:
        words: the kind, one of `KINDS`, with `=` where a value comes after the name; and the
            mechanism as it is typed.
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
    except (Exception, KeyboardInterrupt):  # whoever types is not told of a file in the making
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
    from spatial_pin.workspace_map.grid_axes import PARTS  # on use: every command imports this

    return [*_coordinates(mechanism), *PARTS]


# To add a kind: what there is of it in a mechanism. `completion` says which word is of which.
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
