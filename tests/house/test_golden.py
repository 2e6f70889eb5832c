"""`scripts/golden.py` accepts its own numbers, and sees one that has changed."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest
from folders import ROOT

SCRIPTS = ROOT / "scripts"
SPEC = importlib.util.spec_from_file_location("golden", SCRIPTS / "golden.py")
golden = importlib.util.module_from_spec(SPEC)
before = list(sys.path)
SPEC.loader.exec_module(golden)
sys.path[:] = before
CHOSEN = ["--only", "four_bar", "--verbs", "sweep,limits,mobility"]


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    path = tmp_path_factory.mktemp("golden") / "old.npz"
    assert golden.main(["save", str(path), *CHOSEN]) == 0
    return path


def changed(saved, key: str, change) -> Path:
    path = saved.with_name("new.npz")
    with np.load(saved) as arrays:
        content = {name: arrays[name] for name in arrays.files}
    content[key] = change(content[key])
    np.savez(path, **content)
    return path


def test_it_accepts_what_is_answered_now(saved, capsys):
    assert golden.main(["compare", str(saved), *CHOSEN]) == 0
    assert ", 0 within what is allowed, 0 beyond it" in capsys.readouterr().out


def test_it_sees_a_changed_number(saved, capsys):
    path = changed(saved, "four_bar/sweep/361 exact q/values", lambda q: q + 3e-13 * (q == q.max()))
    assert golden.main(["compare", str(saved), str(path)]) == 1
    told = capsys.readouterr().out
    assert "BEYOND four_bar              sweep        3.0e-13 (allowed 1.0e-13) 361 exact q" in told
    assert golden.main(["compare", str(saved), str(path), "--tolerance", "1e-12"]) == 0


def test_it_sees_a_changed_word_but_no_last_digit(saved, capsys):
    for key, old, new, code in (("four_bar/limits/crank/text", "none", "limit", 1),
                                ("four_bar/mobility/report/text", "freedom", "freed0m", 1),
                                ("four_bar/mobility/report/text", "1e-06", "2e-06", 0)):
        path = changed(saved, key, lambda text, old=old, new=new: np.array(
            str(text).replace(old, new)))
        assert golden.main(["compare", str(saved), str(path)]) == code
    assert "BEYOND" in capsys.readouterr().out


def test_errors_may_shrink(saved):
    key = "four_bar/sweep/361 closure error/values"
    assert golden.main(["compare", str(saved), str(changed(saved, key, np.zeros_like))]) == 0
    assert golden.main(["compare", str(saved), str(changed(saved, key, lambda x: x + 1e-12))]) == 1


def test_unknown_names_are_reported(capsys):
    with pytest.raises(SystemExit):
        golden.main(["save", "x.npz", "--only", "five_bar"])
    assert "no mechanism 'five_bar'; there are" in capsys.readouterr().err
