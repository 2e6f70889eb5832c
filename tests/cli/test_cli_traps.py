"""Slips of the pen on the command line: what is written is done, or refused with what is meant."""

from __future__ import annotations

import json

import numpy as np
import pytest


@pytest.mark.parametrize("words", [
    ("--n", "10"), ("--step", "10"), ("--np", "x"), ("--cs", "x"), ("--hol", "springs"),
    ("--js", "x")])
def test_an_abbreviated_option_is_refused_and_writes_nothing(words, run, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    code, out, err = run("sweep", "four_bar", "crank", "0", "1", *words)
    assert (code, out) == (2, "") and f"no option {words[0]!r}; did you mean" in err
    assert not list(tmp_path.iterdir())
