"""Whether an assembly has stayed on the branch of the State that was its guess."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from spatial_pin.assembly.close import closed
from spatial_pin.assembly.holding import still_entries
from spatial_pin.assembly.search.closing import ACCEPTED
from spatial_pin.assembly.search.closure_settings import free_but
from spatial_pin.assembly.search.whole_turns import turned_apart
from spatial_pin.assembly.state import State
from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.errors import SingularError
from spatial_pin.kernel.loop_equations import loops_of
from spatial_pin.mechanism.coordinates import coordinate_value, with_values
from spatial_pin.numerics.linalg import Array, decompose
from spatial_pin.numerics.tolerances import TOLERANCES

# rad, characteristic lengths: what moves no further at once has not changed its branch, but beside
# a singular configuration, where branches are as near to each other as that
SAME_PLACE_BY = 0.3
LEAST_PART = 2.0**-10  # part of the way from which on a step is too short to be worth another
STANDS_APART = 1e-3  # rad, characteristic lengths: more than round-off beside a dead centre


def branch_changed(guess: State, found: State, held: Iterable[str]) -> str:
    """Return a sentence where loops have left the branch of a guess; "" where they have not.

    The coordinates that are held go straight from where the guess has them to where they are, the
    loops closed in short steps: where that does not lead to what was found, the loops that stand
    elsewhere are on another branch. Nothing is looked at where hardly anything has moved.

    Args:
        guess: where the assembly started; of the same mechanism.
        found: what it has led to.
        held: coordinates that have values, and those of drivers that stand.
    """
    mechanism = found.mechanism
    if np.abs(turned_apart(mechanism, guess.q, found.q)).max(initial=0.0) <= SAME_PLACE_BY:
        return ""
    table = mechanism.coordinate_table
    names = list(dict.fromkeys(mechanism.prescribed_coordinate(name).name for name in held))
    still = still_entries(mechanism, (table[name] for name in names))
    free = free_but(mechanism, still, (name for name in names if table[name].q >= 0))
    q, done = _led(guess, found, names, free)
    apart = np.abs(turned_apart(mechanism, q, found.q))
    loops = _loops(found, free, apart > STANDS_APART)
    if not loops:
        return ""
    what = "are on another branch than those of the guess" if done == 1.0 else (
        f"do not go straight from the guess to where they are: {100.0 * done:.3g} % of the way is "
        "all they can go")
    return (f"mechanism {mechanism.name!r}: the loops of {', '.join(loops)} {what}; `sweep` and "
            "`follow` stay on a branch")


def _led(
    guess: State, found: State, names: list[str], free: NDArray[np.bool_]
) -> tuple[Array, float]:
    """Return where coordinates lead that go straight from a guess on, and which part of the way."""
    mechanism = found.mechanism
    ends = {name: [coordinate_value(mechanism, mechanism.coordinate_table[name], state.q)
                   for state in (guess, found)] for name in names}
    pinned = [name for name in names if mechanism.coordinate_table[name].q < 0]
    n = constraints_of(mechanism).n_angles
    reference = guess.angles if guess.angles.size == n else np.zeros(n)
    q, done, step = guess.q, 0.0, 1.0
    while done < 1.0 and step >= LEAST_PART:
        part = min(done + step, 1.0)
        values = {name: (1.0 - part) * a + part * b for name, (a, b) in ends.items()}
        try:
            there = closed(mechanism, with_values(mechanism, q, values), free, reference,
                           TOLERANCES.tight, pinned={name: values[name] for name in pinned})
            is_near = there.error <= ACCEPTED and np.abs(
                turned_apart(mechanism, q, there.q)).max(initial=0.0) <= SAME_PLACE_BY
        except SingularError:
            is_near = False
        if is_near:
            q, done, step = there.q, part, 2.0 * step
        else:
            step *= 0.5
    return q, done


def _loops(found: State, free: NDArray[np.bool_], elsewhere: NDArray[np.bool_]) -> list[str]:
    """Return the closures of what stands elsewhere (nv,), though the loops determine where."""
    with loops_of(found.mechanism, found.angles) as evaluation:
        evaluation.update(found.q)
        rows = evaluation.jacobian[: evaluation.constraints.n_closure]
        loose = np.zeros(len(free), dtype=bool)
        loose[free] = np.abs(decompose(rows[:, free]).null_space).max(
            axis=0, initial=0.0) > TOLERANCES.half_precision
        moved = np.abs(rows[:, elsewhere & free & ~loose]).max(axis=1, initial=0.0) > 0.0
        labels = evaluation.constraints.labels
    return list(dict.fromkeys(labels[k].closure for k in np.flatnonzero(moved)))
