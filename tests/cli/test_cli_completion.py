"""Shell completion: what shells offer, and that every shell knows every command and option."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

import spatial_pin as sp

SHELLS = ("bash", "zsh", "fish")
INSTALLED = [pytest.param(shell, marks=pytest.mark.skipif(
    shutil.which(shell) is None, reason=f"there is no {shell}")) for shell in SHELLS]


@pytest.fixture
def script(run):
    @cache
    def script(shell: str) -> str:
        code, text, err = run("completion", shell)
        assert (code, err) == (0, "")
        return text

    return script


# What each shell is to run where the last of some words is being typed; {line} has them quoted.
ASKED = {
    "bash": """source {path}; COMP_WORDS=({line}); COMP_CWORD={last}; _spatial_pin
               printf "%s\\n" "${{COMPREPLY[@]}}" """,
    "zsh": """compdef() {{ }}; _files() {{ }}; _describe() {{ print -l ${{commands%%:*}} }}
              compadd() {{
                  while [[ $1 != -- ]]; do shift; done; shift
                  for name; do [[ $name != $words[CURRENT]* ]] || print -r -- $name; done
              }}
              source {path}; words=({line}); CURRENT=$(({last} + 1)); _spatial_pin""",
    "fish": "source {path}; complete -C (string join -- ' ' {line})",
}


@pytest.fixture
def asked(script, tmp_path):
    """What a shell offers where the last of some words is being typed."""
    command = tmp_path / "bin" / "spatial-pin"
    command.parent.mkdir()
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m spatial_pin "$@"\n')
    command.chmod(0o755)
    paths = [str(Path(sp.__file__).parents[1]), os.environ.get("PYTHONPATH", "")]
    known = {**os.environ, "PATH": f"{command.parent}{os.pathsep}{os.environ['PATH']}",
             "PYTHONPATH": os.pathsep.join(filter(None, paths)), "HOME": str(tmp_path)}

    def asked(shell: str, *words: str) -> list[str]:
        path = tmp_path / f"completion.{shell}"
        path.write_text(script(shell), encoding="utf-8")
        line = " ".join(f"'{word}'" for word in ("spatial-pin", *words))
        code = ASKED[shell].format(path=path, line=line, last=len(words))
        plain = {"bash": ["--norc", "-eu"], "zsh": ["-f"], "fish": ["--no-config"]}[shell]
        run = subprocess.run([shell, *plain, "-c", code], capture_output=True, text=True,
                             cwd=tmp_path, env=known)
        assert not run.stderr
        return [row.split("\t")[0] for row in run.stdout.splitlines() if row]

    return asked


@pytest.fixture
def offered(asked):
    return lambda *words: asked("bash", *words)


def test_bash_offers_commands(offered, commands):
    assert set(offered("s")) == {name for name in commands if name.startswith("s")}
    assert set(offered("")) == {*commands, "--help", "--version"}


def test_bash_offers_mechanisms_and_files(offered, tmp_path):
    (tmp_path / "rod.urdf").write_text("")
    names = {name for name in sp.list_mechanisms() if name.startswith("r")}
    assert set(offered("sweep", "r")) == {*names, "rod.urdf"}
    assert offered("sweep", "rssr", "crank", "r") == []  # files, which bash knows by itself


def test_bash_offers_options_and_what_they_may_be(offered):
    assert offered("sweep", "rssr", "--st") == ["--steps", "--stop"]
    assert offered("simulate", "rssr", "--accuracy", "") == ["draft", "engineering", "reference"]
    assert offered("simulate", "rssr", "--csv", "") == []
    assert offered("completion", "f") == ["fish"]


NAMES = (
    (("sweep", "rssr", "r"), {"rocker_pin"}),
    (("limits", "rssr", "cr"), {"crank", "crank_pin"}),
    (("assemble", "rssr", "--limits", "cr"), {"crank=", "crank_pin="}),
    (("jacobian", "rssr", "rocker_"), {"rocker_b", "rocker_b_mount", "rocker_pin"}),
    (("jacobian", "rssr", "coupler", "rocker"), {"rocker_pin="}),
    (("sweep", "rssr", "--hold", "b"), {"ball_a", "ball_a.x", "ball_a.y", "ball_a.z", "base"}),
    (("statics", "rssr", "--over", "cr"), {"crank=", "crank_pin="}),
    (("transmission", "rssr", "rocker_pin", "--driver", "rock"), {"rocker_pin"}),
    (("transmission", "rssr", "--pair", "ball"), {"ball_a", "ball_b"}),
    (("tolerance", "rssr", "rocker_pin", "--deviation", "d"), {"d="}),
    (("workspace", "delta", "platform", "t"), {"turn_x=", "turn_y=", "turn_z="}),
    (("reach", "rssr", "rocker_b.p"), {"rocker_b.pose=", "rocker_b.position="}),
)


@pytest.fixture
def answered(asked, script, run, tmp_path):
    """Shells as `asked`, where the command's answers lie ready: they are of this process."""
    folder = tmp_path / "answers"
    folder.mkdir()
    for kind in set(re.findall(r'kind="(\w+=?)"', script("bash"))):
        for mechanism in {words[1] for words, _ in NAMES}:
            _, names, _ = run("_names", kind, mechanism)
            (folder / f"_names {kind} {mechanism}").write_text(names, encoding="utf-8")
    command = tmp_path / "bin" / "spatial-pin"
    command.write_text(f'#!/bin/sh\nexec cat "{folder}/$*"\n')
    return asked


@pytest.mark.parametrize("shell", INSTALLED)
def test_names_of_the_mechanism_are_offered(answered, shell):
    offered = [(words, set(answered(shell, *words))) for words, _ in NAMES]
    assert offered == list(NAMES)


@pytest.mark.parametrize("shell", INSTALLED)
@pytest.mark.parametrize(("words", "names"), [
    pytest.param(*x, marks=() if x is NAMES[1] else pytest.mark.slow) for x in NAMES
], ids=lambda x: " ".join(sorted(x)))
def test_names_are_offered_by_the_command_itself(asked, shell, words, names):
    assert set(asked(shell, *words)) == names


@pytest.mark.slow
@pytest.mark.parametrize("shell", INSTALLED)
def test_a_file_that_is_broken_offers_nothing(asked, shell, tmp_path):
    (tmp_path / "bad.toml").write_text("tree = 'no.urdf'\n[drivers")
    for name in ("bad.toml", "nowhere.toml", ""):
        assert asked(shell, "sweep", name, "q") == []


def test_a_name_that_a_shell_would_run_is_not_offered(offered, tmp_path):
    (tmp_path / "arm.urdf").write_text(
        '<robot name="arm"><link name="a"/><link name="$(touch here)"/><link name="plain"/>'
        '<joint name="j" type="revolute"><parent link="a"/><child link="plain"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
        '<joint name="k`touch here`" type="fixed"><parent link="plain"/>'
        '<child link="$(touch here)"/></joint></robot>')
    assert set(offered("jacobian", "arm.urdf", "")) == {"a", "plain", "j"}
    assert not (tmp_path / "here").exists()


def test_names_are_printed_without_a_word_to_standard_error(run):
    code, out, _ = run("_names", "coordinate=", "rssr")
    assert code == 0 and "crank=\n" in out
    for words in (["coordinate", "no.toml"], ["nothing", "rssr"], [], ["held", "'"]):
        assert run("_names", *words) == (1, "", "")


def test_every_shell_knows_every_command_option_and_mechanism(script, run, commands):
    flags = {name: set(re.findall(r"--[a-z][\w-]+", run(name, "--help")[1])) - {"--path"}
             for name in commands}
    for text in map(script, SHELLS):
        for name in sorted(commands):
            lines = [line for line in text.splitlines() if re.search(rf"\b{name}\b", line)]
            assert lines, name
            for flag in flags[name]:
                assert any(flag in line or f"-l {flag[2:]}" in line for line in lines), (name, flag)
        assert all(name in text for name in sp.list_mechanisms())


@pytest.mark.parametrize("shell", INSTALLED)
def test_scripts_are_what_their_shell_reads(script, shell, tmp_path):
    path = tmp_path / "script"
    path.write_text(script(shell), encoding="utf-8")
    subprocess.run([shell, "-n", path], check=True, capture_output=True)
