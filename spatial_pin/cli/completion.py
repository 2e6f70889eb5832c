"""Scripts with which a shell completes commands, options, and names of the library's mechanisms."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from typing import NamedTuple

from spatial_pin.formats.files import list_mechanisms


class Option(NamedTuple):
    """An option of a command.

    Attributes:
        flag: as it is typed, --steps.
        text: of the help.
        takes_value: whether a word follows it.
        choices: that this word may be, none where it may be anything.
    """

    flag: str
    text: str
    takes_value: bool
    choices: tuple[str, ...]


class Word(NamedTuple):
    """A command.

    Attributes:
        name: as it is typed.
        text: what it does.
        takes_mechanism: whether a mechanism comes next.
        options: its options.
    """

    name: str
    text: str
    takes_mechanism: bool
    options: tuple[Option, ...]


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
        found += [Option(flag, text, takes_value, choices)
                  for flag in action.option_strings if flag.startswith("--")]
    takes_mechanism = any(action.dest == "mechanism" for action in parser._actions)
    return Word(name, parser.description or "", takes_mechanism, tuple(found))


def _choices(words: list[Word]) -> list[tuple[str, str, str]]:
    """Return command, option and what it may be, where that is known; "" for none."""
    return [(word.name, option.flag, " ".join(option.choices))
            for word in words for option in word.options if option.takes_value]


def _flags(word: Word) -> str:
    return " ".join(option.flag for option in word.options)


def _taking(words: list[Word]) -> list[str]:
    return [word.name for word in words if word.takes_mechanism]


def _bash(words: list[Word], mechanisms: list[str]) -> str:
    values = "\n".join(f'        "{name} {flag}") words="{choices}"; files=yes ;;'
                       for name, flag, choices in _choices(words))
    flags = "\n".join(f'        {word.name}) words="{_flags(word)}" ;;' for word in words)
    return f"""\
# Completion of spatial-pin; in ~/.bashrc: eval "$(spatial-pin completion bash)"
_spatial_pin() {{
    local current=${{COMP_WORDS[COMP_CWORD]}} before=${{COMP_WORDS[COMP_CWORD-1]}}
    local command=${{COMP_WORDS[1]}} words="" files=""
    COMPREPLY=()
    if ((COMP_CWORD == 1)); then
        words="{' '.join(word.name for word in words)} --help --version"
        COMPREPLY=($(compgen -W "$words" -- "$current"))
        return
    fi
    case "$command $before" in
{values}
    esac
    if [[ -n $files ]]; then  # empty words: names of files, by -o default
        [[ -z $words ]] || COMPREPLY=($(compgen -W "$words" -- "$current"))
        return
    fi
    if [[ $current == -* ]]; then
        case "$command" in
{flags}
        esac
        COMPREPLY=($(compgen -W "$words" -- "$current"))
        return
    fi
    case "$COMP_CWORD $command" in
        {'|'.join(f'"2 {name}"' for name in _taking(words))})
            compopt -o filenames 2>/dev/null || true
            COMPREPLY=($(compgen -W "{' '.join(mechanisms)}" -- "$current") \\
                       $(compgen -f -- "$current")) ;;
        "2 completion") COMPREPLY=($(compgen -W "{' '.join(SHELLS)}" -- "$current")) ;;
    esac
}}
complete -o default -F _spatial_pin spatial-pin
"""


def _zsh(words: list[Word], mechanisms: list[str]) -> str:
    texts = {word.name: word.text.replace(":", "\\:") for word in words}
    described = "\n".join(f"        {_quoted(f'{name}:{text}')}" for name, text in texts.items())
    values = "\n".join(f'        "{name} {flag}") '
                       + (f"compadd -- {choices}" if choices else "_files") + "; return ;;"
                       for name, flag, choices in _choices(words))
    flags = "\n".join(f"            {word.name}) compadd -- {_flags(word)} ;;" for word in words)
    return f"""\
#compdef spatial-pin
# Completion of spatial-pin; in ~/.zshrc, behind compinit: eval "$(spatial-pin completion zsh)"
_spatial_pin() {{
    local -a commands
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
    if [[ $words[CURRENT] == -* ]]; then
        case "$words[2]" in
{flags}
        esac
        return
    fi
    case "$CURRENT $words[2]" in
        {'|'.join(f'"3 {name}"' for name in _taking(words))})
            compadd -- {' '.join(mechanisms)} ;;
        "3 completion") compadd -- {' '.join(SHELLS)}; return ;;
    esac
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
        seen = f"-n '__fish_seen_subcommand_from {word.name}'"
        for option in word.options:
            takes = f" -x -a '{' '.join(option.choices)}'" if option.choices else " -r"
            lines.append(f"{start} {seen} -l {option.flag[2:]}{takes * option.takes_value} "
                         f"-d {_quoted(option.text)}")
    lines.append(f"{start} -n '__fish_seen_subcommand_from {' '.join(_taking(words))}' "
                 f"-a '{' '.join(mechanisms)}'")
    lines.append(f"{start} -n '__fish_seen_subcommand_from completion' -f -a '{' '.join(SHELLS)}'")
    return "\n".join(lines) + "\n"


def _quoted(text: str) -> str:
    """Return text as one word of zsh and fish; a quote in it is a typographic one there."""
    return "'" + text.replace("'", "’") + "'"


# To add a shell: a function of the commands and the mechanisms' names that returns its script.
SHELLS: dict[str, Callable[[list[Word], list[str]], str]] = {
    "bash": _bash, "zsh": _zsh, "fish": _fish,
}
