"""An error that nobody foresaw: one sentence, where to report it, and a file with the evidence."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq

import spatial_pin as sp


def of_a_root_finder(*_, **__):
    brentq(lambda x: 1.0 + x * x, -1.0, 1.0)


def of_a_factorisation(*_, **__):
    np.linalg.cholesky(-np.eye(2))


def of_nothing(*_, **__):
    return len(None)


def of_a_table(*_, **__):
    dict()["crank"]


def of_several_lines(*_, **__):
    raise RuntimeError("first line\n  second line")


def of_itself(*_, **__):
    return 1 + of_itself()  # Python 3.13.0 never stops without the sum


@pytest.mark.parametrize("fault", [of_a_root_finder, of_a_factorisation, of_nothing, of_a_table,
                                   of_several_lines, of_itself])
def test_an_unforeseen_error_is_one_sentence_and_a_file_with_the_traceback(
        fault, run, monkeypatch, tmp_path):
    monkeypatch.setattr(sp, "assemble", fault)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    code, out, err = run("assemble", "four_bar", "crank=0.3")
    assert (code, out) == (1, "")
    assert err.count("\n") == 1 and "Traceback" not in err
    found = re.fullmatch(r"spatial-pin: this error was not foreseen, .*; please report it at "
                         r"https?://\S+, with the file (\S+)\n", err)
    told = Path(found[1]).read_text("utf-8")
    assert "command: spatial-pin assemble four_bar crank=0.3" in told
    assert f"spatial_pin {sp.__version__}" in told
    assert "Traceback" in told and fault.__name__ in told


def test_where_no_file_can_be_written_the_traceback_is_on_stderr(run, monkeypatch):
    def refused(*_, **__):
        raise OSError("read-only")

    monkeypatch.setattr(sp, "assemble", of_nothing)
    monkeypatch.setattr("tempfile.NamedTemporaryFile", refused)
    code, out, err = run("assemble", "four_bar", "crank=0.3")
    assert (code, out) == (1, "")
    assert "Traceback" in err and err.splitlines()[-1].endswith("with the lines above")


def test_what_the_library_refuses_is_no_unforeseen_error(run):
    code, _, err = run("assemble", "four_bar", "crank=nan")
    assert code in (1, 2) and "not foreseen" not in err
