"""Remedies of errors and warnings in the words of the command line instead of Python's."""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Collection
from typing import NamedTuple

from spatial_pin.assembly.holding import BASE

Said = re.Match[str]


class Remedy(NamedTuple):
    """How what Python is told is said to who types commands.

    Attributes:
        python: pattern of what the library says.
        words: what is said instead.
        flag: the option that a command needs for it; "" for none. Others leave it to the next.
    """

    python: str
    words: str | Callable[[Said], str]
    flag: str = ""


def in_options(text: str, flags: Collection[str]) -> str:
    """Return what the library says with the options of a command in the place of arguments.

    Args:
        text: the message of an error or warning.
        flags: the command's options, as `--hold`.
    """
    for remedy in REMEDIES:
        if not remedy.flag or remedy.flag in flags:
            text = re.sub(remedy.python, remedy.words, text)
    return re.sub(r"`(\w+)`", lambda said: _flag(said, flags), text)


def _flag(said: Said, flags: Collection[str]) -> str:
    """Return the option of an argument's name, where there is one."""
    flag = f"--{said[1].replace('_', '-')}"
    return flag if flag in flags else said[0]


def _each(flag: str) -> Callable[[Said], str]:
    """Return what writes the names of a list, the last group, each behind an option."""
    return lambda said: " ".join(f"{flag} {name}" for name in ast.literal_eval(
        said[said.re.groups]) if name != str(BASE))  # which the commands hold anyway


def _rates(said: Said) -> str:
    return " ".join(f"--speed {name}=0" for name in ast.literal_eval(f"{{{said[1]}}}"))


def _packages(said: Said) -> str:
    return " ".join(f"--package {name}=FOLDER" for name in re.findall(r"'([^']*)'", said[1]))


PRESCRIBED = (r"solve_rates\(\.\.\., \{(.*)\}\), sweep\(\.\.\., hold=(\[.*?\])\) or "
              r"jacobian\(\.\.\., drivers=\[\.\.\.\]\)")

# Tried one after the other. A test holds them against all that the library says.
REMEDIES = (
    Remedy(PRESCRIBED, _each("--hold"), "--hold"),
    Remedy(PRESCRIBED, _rates, "--speed"),
    Remedy(f"(?:, such as )?{PRESCRIBED}; each may have a (.drivers.name.) in the file too",
           r" by a \3 of each in the file"),
    Remedy(r"hold=(\[.*?\])", _each("--hold"), "--hold"),
    Remedy(r"; hold=(\[.*?\]) stops the joints with springs", ""),
    Remedy(r"; nothing holds the free base, which .*? does by default", ""),
    Remedy(r"\bactuated=(\[.*?\])", _each("--actuated")),
    Remedy(r"with release=True or free=\[\.\.\.\]", "by --release or --free NAME", "--free"),
    Remedy(r", or let them go with release=True or free=\[\.\.\.\]", ""),
    Remedy(r" \(see State\.gap; assemble\(gap=0\) refuses them\)", ""),
    Remedy(r"assemble\(limits=True\)", "`spatial-pin assemble --limits`"),
    Remedy(r"give on_joint_limit=\"report\"", "--on-joint-limit report"),
    Remedy(r"on_crossing='raise' asks to stop there; give on_crossing='straight' to go on", ""),
    Remedy(r", or give on_crossing='straight' to go on", ""),
    Remedy(r"with limits=False", "with --no-limits"),
    Remedy(r", such as sp\.closures\.weld\(\(.*?, state\.placement\(.*?\)\), .*?\)", ""),
    Remedy(r"set base=True", "--base"),
    Remedy(r"task='pose'", "--task pose"),
    Remedy(r"load\(\.\.\., gap=(.*?)\)", r"`gap = \1` in the mechanism file"),
    Remedy(r"gap=(.*?) allows it", r"`gap = \1` in the mechanism file allows it"),
    Remedy(r"(?:sp\.)?load\(\.\.\., packages=\{(.*?)\}\)", _packages),
    Remedy(r"sp\.load\(\.\.\., trusted=True\)", "--trusted"),
    Remedy(r"load\(\.\.\., without=\[('.*?'|\".*?\")\]\)", r"--without \1"),
    Remedy(r"load\(\.\.\., model=('.*?'|\".*?\")\)", r"--model \1"),
    Remedy(r"load\(\.\.\., (\w+)=\.\.\.\)", r"--set \1=VALUE"),
    Remedy(r"free_flyer=True", "--free-flyer"),
    Remedy(r"\bsp\.mobility\b", "`spatial-pin info`"),
    Remedy(r"take a smaller time_tolerance or step(, or formulation='independent')?",
           "take --accuracy reference"),
    Remedy(r", a larger time_tolerance, integrator='Radau' .*? Accuracy\(most_steps=.*?\)",
           " or --accuracy draft"),
    Remedy(r"make it smooth, or take Accuracy\(.*?\)", "make it smooth"),
)
