"""Parts that all rooms use: whole files, values worked out once, digits that a spread warrants."""

import signal
import subprocess
import sys
import threading

import numpy as np
import pytest

import spatial_pin as sp
from spatial_pin.dimensions.sensitivity import with_spread
from spatial_pin.lazy import cached_property
from spatial_pin.outputs import replacing

OLD = "what was there before"


@pytest.mark.skipif(sys.platform == "win32", reason="a signal of POSIX")
def test_a_kill_on_the_way_loses_nothing(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text(OLD)
    code = ("import os, signal, sys; from pathlib import Path\n"
            "from spatial_pin.outputs import replacing\n"
            "with replacing(Path(sys.argv[1])) as target:\n"
            "    target.write_text('half'); os.kill(os.getpid(), signal.SIGKILL)\n")
    done = subprocess.run([sys.executable, "-c", code, str(path)], timeout=60)
    assert done.returncode == -signal.SIGKILL
    assert path.read_text() == OLD


def test_an_error_on_the_way_leaves_no_trace(tmp_path):
    with pytest.raises(RuntimeError), replacing(tmp_path / "a.txt") as target:
        target.write_text("half")
        raise RuntimeError
    assert not list(tmp_path.iterdir())


def test_what_a_mechanism_works_out_when_asked_holds_no_lock():
    """While one thread works it out, a child, or another thread, can too."""

    class Part:
        @cached_property
        def size(self) -> int:
            if threading.current_thread() is not threading.main_thread():
                begun.set()
                assert go_on.wait(60)
            return 7

    assert isinstance(vars(sp.Mechanism)["characteristic_length"], type(vars(Part)["size"]))
    begun, go_on = threading.Event(), threading.Event()
    thread = threading.Thread(target=lambda: Part().size)
    thread.start()
    assert begun.wait(60)
    part = Part()
    assert part.size == 7 and vars(part) == {"size": 7}
    go_on.set()
    thread.join()


@pytest.mark.parametrize(("value", "deviation", "unit", "text"), [
    (1.23456789, 0.00214, "rad", "1.2346 ± 0.0021 rad"),
    (1234.5678, 31.4, "m/s²", "1235 ± 31 m/s²"),
    (0.0, 0.0321, "m", "0.000 ± 0.032 m"),
    (1.25, 3e-17, "m", "1.25 ± 0 m"),
    (1.23456e-7, 3.2e-9, "1", "(1.235 ± 0.032)e-7"),
    (2.5e9, 4.4e7, "N", "(2.500 ± 0.044)e9 N"),
    (np.inf, np.nan, "", "inf ± nan"),
    (np.array([1.0, 2.0]), np.array([0.1, 0.0]), "m", "[1.00 ± 0.10, 2 ± 0] m"),
])
def test_a_value_has_the_digits_that_its_spread_warrants(value, deviation, unit, text):
    assert with_spread(value, deviation, unit) == text
