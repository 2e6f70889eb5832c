"""Which equations of motion a mechanism is given: dense ones, or sparse ones where it is large."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from spatial_pin.constraints.trees import is_large
from spatial_pin.constraints.workspaces import acquired
from spatial_pin.dynamics.solvers.equations import Equations
from spatial_pin.dynamics.solvers.sparse import SparseEquations
from spatial_pin.mechanism.mechanism import Mechanism


def _made_for(mechanism: Mechanism) -> Equations:
    return (SparseEquations if is_large(mechanism.model) else Equations)(mechanism)


@contextmanager
def equations_of(mechanism: Mechanism) -> Iterator[Equations]:
    """Lend the equations of a mechanism, made once for each thread that asks at the same time.

    They have forgotten what was chosen at other configurations.
    """
    with acquired(mechanism, "equations", lambda: _made_for(mechanism)) as equations:
        equations.forget()
        yield equations
