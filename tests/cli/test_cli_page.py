"""The page of the command line tells of every command, its mistakes and its JSON as they are."""

from __future__ import annotations

import json
import re
from pathlib import Path

from folders import ROOT
from offenders import listed

import spatial_pin as sp

PAGE = (ROOT / "docs" / "command_line.md").read_text(encoding="utf-8")
NO_JSON = {"show", "completion"}
SWEPT = ["four_bar", "crank", "0", "1", "--steps", "3"]
CALLS = {  # of every command with JSON, but for those that read files or measure time
    "list": [], "info": ["rssr"], "check": ["four_bar"], "assemble": ["rssr", "crank=1"],
    "modes": ["four_bar", "crank=1", "--patience", "50"], "limits": ["four_bar", "crank"],
    "reach": ["four_bar", "rocker_pin=1.7"], "sweep": SWEPT, "clearance": SWEPT,
    "simulate": ["four_bar", "--duration", "0.01", "--rows", "2"],
    "states": ["excavator", "booms.csv"],
    "jacobian": ["delta", "platform"], "transmission": ["four_bar", "rocker_pin"],
    "statics": ["four_bar"], "sensitivity": ["four_bar", "rocker_pin"],
    "tolerance": ["four_bar", "rocker_pin", "--deviation", "r2=1mm"],
    "workspace": ["four_bar", "coupler_b", "crank=0..1", "--points", "3"],
    "tradeoff": [*SWEPT, "--repeats", "1"], "new": ["mine"],
    "export": ["rssr", "--folder", "out"], "report": [*SWEPT, "--html", "r.html"],
}


def told() -> dict[str, set[str]]:
    """The keys that the page's table has, by command."""
    table = PAGE[PAGE.index("## JSON"):]
    found: dict[str, set[str]] = {}
    for commands, keys in re.findall(r"^\| (`.*?) \| (.*) \|$", table, flags=re.MULTILINE):
        for command in re.findall(r"`(\w+)`", commands):
            found[command] = set(re.findall(r"`(\w+)`", keys))
    return found


def test_every_command_has_an_example(commands):
    shown = re.findall(r"^\$ (?:eval \"\$\()?spatial-pin (\w+)\b", PAGE, flags=re.MULTILINE)
    assert len(commands) > 20 and not commands - set(shown)


def test_the_json_of_every_command_is_on_the_page(commands):
    assert sorted(told()) == sorted(commands - NO_JSON)


def test_json_has_the_keys_that_the_page_tells_of(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "booms.csv").write_text("boom\n2.0\n99.0\n", encoding="utf-8")
    maybe = {"columns", "mean", "sampled", "driver", "clearance",  # where asked for
             "kind", "row", "text", "value", "contacts"}  # of events that there are
    wrong = {}
    for command, words in CALLS.items():
        code, out, _ = run(command, *words, "--json", "-")
        found = json.loads(out) if code == 0 else {}
        keys = set(found[0] if isinstance(found, list) else found)
        absent = {key for key in told()[command] if f'"{key}"' not in json.dumps(found)}
        if code or keys - told()[command] or absent - maybe:
            wrong[command] = (code, keys - told()[command], absent - maybe)
    assert not wrong, listed(wrong)


def test_the_hint_on_the_page_is_true(run):
    code, _, err = run("info", "rssr", "--set", "d=315")
    assert code == 0 and err.strip() in PAGE


def test_the_mistakes_on_the_page_are_reported(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    sp.load("rssr").save("plain")
    text = Path("plain/rssr.toml").read_text("utf-8")
    text = text.replace("rssr.urdf", "plain/rssr.urdf").replace('"rssr"', '"bad"', 1)
    text = text.replace('joint = "crank_pin"', 'joint = "krank_pin"')
    text = 'titel = "x"\n' + text + '[[springs]]\nname = "s"\nframes = ["crank", "ground"]\n' \
        "stiffness = -1.0\n"
    Path("bad.toml").write_text(text, "utf-8")
    code, _, err = run("check", "bad.toml")
    assert code == 1 and err.strip() in PAGE
