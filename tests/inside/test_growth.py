"""Mechanisms of many loops: what they cost grows with the number of loops, not with its cube."""

import subprocess
import sys

import numpy as np
import pinocchio as pin
import published_models as models
import pytest
from folders import ROOT
from variety import few

import spatial_pin as sp
from spatial_pin.constraints.trees import LargeTree, Tree, tree_of
from spatial_pin.dynamics.simulation.formulations import independent
from spatial_pin.dynamics.simulation.problem import Problem
from spatial_pin.kernel.integrating import RungeKutta
from spatial_pin.kernel.kernel import kernel_of
from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.kernel.rate_solver import rates_of
from spatial_pin.mechanism.coordinates import with_values

WORK = """
import pathlib, sys
import numpy as np
import spatial_pin as sp
sys.path.append(sys.argv[2])
import published_models as models

mechanism = models.ladder(int(sys.argv[1]))
start = {c: 0.3 if c.startswith("pin") else -0.3 for c in mechanism.coordinates}
state = sp.solve_rates(mechanism, sp.assemble(mechanism, {"pin_0": 0.3}, start), {"pin_0": 1.0})
motion = sp.sweep(mechanism, "pin_0", np.linspace(0.3, 1.3, 20), guess=state)
assert np.abs(motion.coordinate("pin_7").value - motion.driver).max() < 1e-10
height = motion.frame("top_7").position[:, 1]
assert np.abs(height - np.cos(motion.driver)).max() < 1e-10
assert sp.forward_dynamics(mechanism, state).reactions
assert sp.simulate(mechanism, state, 0.1).frame("top_7").position.shape == (1001, 3)
# the peak of this process alone: that of getrusage begins with its parent's
status = pathlib.Path("/proc/self/status").read_text()
print(next(line.split()[1] for line in status.splitlines() if line.startswith("VmHWM")))
"""


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
def test_many_loops_take_little_memory():
    """One `pin.Data` of their 401 freedoms would take 3 GB."""
    found = subprocess.run(
        [sys.executable, "-c", WORK, "200", str(ROOT / "tests" / "support")],
        capture_output=True, text=True, check=True)
    assert int(found.stdout) < 700_000  # kB


@pytest.mark.parametrize("loops", few([200, 1100], 200))
def test_rates_of_a_long_chain_are_clear(loops):
    """Rows of loops of 1 m are short beside a mechanism of 1100 m: that is no dependence."""
    mechanism = models.ladder(loops)
    values = {c: -0.02 if c.startswith("pin") else 0.02 for c in mechanism.coordinates}
    q = with_values(mechanism, mechanism.neutral, values)
    with kernel_of(mechanism) as kernel:
        rates = rates_of(kernel, (mechanism.coordinate("pin_0").v,), 1)
        rates.speeds[:], rates.accelerations[:] = 1.0, 0.0
        v, a, facts = rates.solve(q, np.zeros(kernel.n_angles), ("v", "a", "facts"))
        assert facts[0] < 1.1 / loops
        want = [1.0 if c.startswith("pin") else -1.0 for c in mechanism.coordinates]
        assert v == pytest.approx(want, abs=1e-10)
        assert np.abs(a).max() < 1e-9


@pytest.mark.parametrize("loops", few([200, 1000], 200))
def test_many_loops_that_flatten_together_are_no_crossing_before_they_do(loops):
    """Their determinant falls by 300 orders of magnitude on the way: that was taken for a zero."""
    mechanism = models.ladder(loops)
    values = {c: -0.02 if c.startswith("pin") else 0.02 for c in mechanism.coordinates}
    q = with_values(mechanism, mechanism.neutral, values)
    state = sp.State(mechanism, q, np.zeros(mechanism.model.nv), closure_error=0.0)
    motion = sp.simulate(mechanism, state, 0.001)
    pins = [mechanism.coordinate(f"pin_{i}").q for i in (0, loops // 2, loops)]
    assert np.ptp(motion.q[-1, pins]) < 1e-11


@pytest.mark.parametrize("loops", few([1, 20, 100, 300], 1, 20, 100))
def test_many_loops_far_from_where_they_flatten_are_not_held_for_near(loops):
    """Their determinant is a power of that of one: by it the flat place seemed as much nearer.

    Ways past it were looked for in vain, by some hundred factorisations each.
    """
    mechanism = models.ladder(loops)
    state = sp.assemble(mechanism, {"pin_0": -0.02})
    system = independent(Problem(mechanism, None, None, None, sp.Accuracy()), state)
    y = system.unknowns(state.v, 0.0)
    solver = RungeKutta("DOP853", system, 0.0, y, 1.0, 1e-3, 1.0, 1e-9, np.full(len(y), 1e-9))
    while solver.status == "running":
        solver.step()
    assert solver.status == "finished"
    assert system.kernel.factorisations < 3 * solver.evaluations


def test_a_large_tree_moves_in_the_kernel_as_in_pinocchio():
    mechanism = models.ladder(40)
    own, whole = tree_of(mechanism.model), Tree(mechanism.model)
    assert isinstance(own, LargeTree)
    q, v, a = np.random.default_rng(2).uniform(-1.0, 1.0, (3, mechanism.model.nv))
    for tree in (own, whole):
        tree.update(q)
        tree.move(q, v, a)
    for name in ("placements", "columns", "twists", "accelerations"):
        assert getattr(own, name) == pytest.approx(getattr(whole, name), rel=1e-14, abs=1e-14), name
    assert own.data.oMi[50].homogeneous == pytest.approx(whole.data.oMi[50].homogeneous, abs=1e-15)


@pytest.mark.parametrize("frame", ["rod_3", "end_17", "ground"])
def test_frames_of_an_evaluation_are_pinocchios(frame):
    mechanism = models.ladder(40)
    model, data = mechanism.model, mechanism.model.createData()
    q = np.random.default_rng(3).uniform(-1.0, 1.0, model.nq)
    evaluation = LoopEquations(mechanism)
    evaluation.update(q)
    at = mechanism.frame_id(frame)
    want = pin.computeFrameJacobian(model, data, q, at, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
    pin.updateFramePlacement(model, data, at)
    assert evaluation.frame_jacobian(at) == pytest.approx(want, abs=1e-13)
    assert evaluation.frame(at).homogeneous == pytest.approx(data.oMf[at].homogeneous, abs=1e-15)


def test_what_many_loops_do_is_what_one_does():
    one, many = (models.ladder(n) for n in (1, 60))
    values = np.linspace(0.3, 1.3, 30)
    found = [sp.sweep(m, "pin_0", values, 2.0, guess={
        c: 0.3 if c.startswith("pin") else -0.3 for c in m.coordinates}) for m in (one, many)]
    for name in ("position", "velocity", "acceleration"):
        first, last = (getattr(motion.frame("end_0"), name) for motion in found)
        assert first == pytest.approx(last, abs=1e-11), name
