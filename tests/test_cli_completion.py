"""Shell completion: what bash offers, and that every shell knows every command and option."""

from __future__ import annotations

import re
import shutil
import subprocess

import pytest

import spatial_pin as sp
from spatial_pin.cli import main
from spatial_pin.cli.commands import COMMANDS
from spatial_pin.cli.completion import SHELLS
from spatial_pin.cli.parser import parser

BASH = shutil.which("bash")


@pytest.fixture
def script(capsys):
    def script(shell: str) -> str:
        assert main(["completion", shell]) == 0
        return capsys.readouterr().out

    return script


@pytest.fixture
def offered(script, tmp_path):
    """What bash offers where the last of some words is being typed."""
    if BASH is None:
        pytest.skip("there is no bash")
    path = tmp_path / "completion.bash"
    path.write_text(script("bash"), encoding="utf-8")

    def offered(*words: str) -> list[str]:
        line = " ".join(f"'{word}'" for word in ("spatial-pin", *words))
        code = (f"source {path}; COMP_WORDS=({line}); COMP_CWORD={len(words)}; _spatial_pin; "
                'printf "%s\\n" "${COMPREPLY[@]}"')
        run = subprocess.run([BASH, "--norc", "-euc", code], capture_output=True, text=True,
                             check=True, cwd=tmp_path)
        return run.stdout.split()

    return offered


def test_bash_offers_commands(offered):
    assert set(offered("s")) == {name for name in COMMANDS if name.startswith("s")}
    assert set(offered("")) == {*COMMANDS, "--help", "--version"}


def test_bash_offers_mechanisms_and_files(offered, tmp_path):
    (tmp_path / "rod.urdf").write_text("")
    names = {name for name in sp.list_mechanisms() if name.startswith("r")}
    assert set(offered("sweep", "r")) == {*names, "rod.urdf"}
    assert offered("sweep", "rssr", "r") == []  # files, which bash knows by itself


def test_bash_offers_options_and_what_they_may_be(offered):
    assert offered("sweep", "rssr", "--st") == ["--steps", "--stop"]
    assert offered("simulate", "rssr", "--accuracy", "") == ["draft", "engineering", "reference"]
    assert offered("simulate", "rssr", "--csv", "") == []
    assert offered("completion", "f") == ["fish"]


@pytest.mark.parametrize("shell", SHELLS)
def test_every_command_option_and_mechanism_is_known(script, shell):
    text = script(shell)
    options = parser().parse_args(["list"]).parsers
    for name, sub in options.items():
        flags = re.findall(r"--[a-z][\w-]+", sub.format_help())
        lines = [line for line in text.splitlines() if re.search(rf"\b{name}\b", line)]
        assert lines, name
        for flag in set(flags) - {"--path"}:
            assert any(flag in line or f"-l {flag[2:]}" in line for line in lines), (name, flag)
    assert all(name in text for name in sp.list_mechanisms())


@pytest.mark.parametrize("shell", SHELLS)
def test_scripts_are_what_their_shell_reads(script, shell, tmp_path):
    program = shutil.which(shell)
    if program is None:
        pytest.skip(f"there is no {shell}")
    path = tmp_path / "script"
    path.write_text(script(shell), encoding="utf-8")
    subprocess.run([program, "-n", path], check=True, capture_output=True)
