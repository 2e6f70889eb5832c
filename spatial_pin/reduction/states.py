"""States of a mechanism as states of a reduced one."""

from __future__ import annotations

import numpy as np

from spatial_pin.assembly.state import State
from spatial_pin.constraints.closure_equations import evaluation_of
from spatial_pin.mechanism.mechanism import Mechanism


def carried_over(reduced: Mechanism, state: State) -> State:
    """Return what a state says of the joints that a reduced mechanism has kept."""
    q, full, own = reduced.neutral.copy(), state.mechanism.model, reduced.model
    for i in range(1, own.njoints):
        j = full.getJointId(own.names[i])
        q[own.idx_qs[i] :][: own.nqs[i]] = state.q[full.idx_qs[j] :][: full.nqs[j]]
    at = [state.mechanism.coordinate_table[name].v for name in reduced.coordinates]
    screws = [c.name for c in state.mechanism.closures if c.type == "screw"]
    angles = np.array([state.angles[screws.index(c.name)]
                       for c in reduced.closures if c.type == "screw"])
    with evaluation_of(reduced, angles) as evaluation:
        evaluation.update(q)
        return State(reduced, q, state.v[at], state.a[at], in_time=state.in_time,
                     closure_error=evaluation.closure_error, angles=evaluation.angles)
