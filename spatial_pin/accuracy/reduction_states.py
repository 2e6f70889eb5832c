"""States of a mechanism as states of a reduced one."""

from __future__ import annotations

from spatial_pin.kinematics.constraints import Evaluation, constraints_of
from spatial_pin.kinematics.state import State
from spatial_pin.mechanism.configuration import joint_vector, with_values
from spatial_pin.mechanism.mechanism import Mechanism


def carried_over(reduced: Mechanism, state: State) -> State:
    """Return what a state says of the joints that a reduced mechanism has kept."""
    values: dict[str, float] = {}
    for joint in list(reduced.model.names)[1:]:
        names = [c.name for c in reduced.coordinate_table.values() if c.joint == joint]
        values.update(zip(names, joint_vector(state.mechanism, state.q, joint).tolist(),
                          strict=True))
    q = with_values(reduced, reduced.neutral, values)
    at = [state.mechanism.coordinate_table[name].v for name in reduced.coordinates]
    evaluation = Evaluation(constraints_of(reduced))
    screws = [c.name for c in state.mechanism.closures if c.type == "screw"]
    own = [c.name for c in reduced.closures if c.type == "screw"]
    if len(evaluation.turns):
        evaluation.turns[:] = [state.angles[screws.index(name)] for name in own]
    evaluation.update(q)
    return State(reduced, q, state.v[at], state.a[at], closure_error=evaluation.closure_error,
                 angles=evaluation.angles)
