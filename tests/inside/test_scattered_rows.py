"""Scattered states that Ctrl-C cuts short, and the order in which they are solved."""

import subprocess
import sys

import numpy as np
import pytest
from loaded_library import library

import spatial_pin as sp
from spatial_pin.kernel.paths import Path
from spatial_pin.motion.scattered_states import morton_order


def test_ctrl_c_keeps_what_was_solved(monkeypatch):
    mechanism, calls = library("rssr"), []
    whole = sp.states(mechanism, {"crank": np.linspace(0.0, 3.0, 40)}, threads=1)
    scatter = Path.scatter

    def cut(self, *arguments):
        calls.append(arguments)
        if len(calls) > 4:
            raise KeyboardInterrupt
        scatter(self, *arguments)

    monkeypatch.setattr(Path, "scatter", cut)
    with pytest.raises(sp.Interrupted) as caught:
        sp.states(mechanism, {"crank": np.linspace(0.0, 3.0, 40)}, threads=1)
    found = caught.value.motion
    assert 0 < len(found) < 40
    rows = [whole.coordinate("crank").value.tolist().index(x)
            for x in found.coordinate("crank").value.tolist()]
    assert rows == sorted(rows)
    assert np.array_equal(found.q, whole.q[rows])


def test_ctrl_c_before_anything_is_solved_is_a_plain_one(monkeypatch):
    def cut(self, *arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr(Path, "scatter", cut)
    with pytest.raises(KeyboardInterrupt) as caught:
        sp.states(library("rssr"), {"crank": [0.0, 1.0]})
    assert type(caught.value) is KeyboardInterrupt


CUT = """
import signal, time
import numpy as np
import spatial_pin as sp

mechanism, rng = sp.load("delta"), np.random.default_rng(1)
arms = {name: rng.uniform(0.0, 0.6, 3000) for name in mechanism.drivers}
sp.states(mechanism, arms, threads=2)
began = time.perf_counter()
sp.states(mechanism, arms, threads=2)
whole = time.perf_counter() - began
signal.signal(signal.SIGALRM, signal.default_int_handler)
for _ in range(100):
    try:
        signal.setitimer(signal.ITIMER_REAL, rng.uniform(1e-4, whole))
        try:
            sp.states(mechanism, arms, threads=2)
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
    except KeyboardInterrupt:
        pass
print("alive")
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="no timers of signals there")
def test_no_thread_works_in_freed_memory_after_ctrl_c():
    run = subprocess.run([sys.executable, "-c", CUT], capture_output=True, text=True, check=False)
    assert (run.stdout, run.returncode) == ("alive\n", 0), run.stderr[-500:]


def test_mortons_order_goes_through_one_quarter_after_the_other():
    grid = np.array([(x, y) for x in range(4) for y in range(4)], dtype=float)
    order = grid[morton_order(grid)]
    for quarter in order.reshape(4, 4, 2):
        assert np.ptp(quarter, axis=0).tolist() == [1.0, 1.0]
