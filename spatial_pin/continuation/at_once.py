"""A sweep in one call of the kernel: from the guess through all values.

What `assembled` and `follow` would do one after the other, where nothing is to be decided on the
way: of few samples the price of calls is most of what a sweep costs.
"""

from __future__ import annotations

from typing import NamedTuple

from spatial_pin._support.lazy import made_once
from spatial_pin.assembly.holding import BASE
from spatial_pin.assembly.redundant_equations import as_meant
from spatial_pin.assembly.search.closure_settings import asked_of
from spatial_pin.assembly.search.guesses import read_guess
from spatial_pin.assembly.search.straight import AssemblyPlan, leads_nowhere, straight_plan
from spatial_pin.assembly.state import State
from spatial_pin.continuation import path_following as following
from spatial_pin.continuation.path_following import there_and_back
from spatial_pin.continuation.start import moving_drivers
from spatial_pin.kernel.beginning import Beginning
from spatial_pin.kernel.closer import Closer
from spatial_pin.kernel.paths import PathSamples, prescribed_places
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array
from spatial_pin.rates.rates import check_not_held, prescribed_first
from spatial_pin.settings import Accuracy

# Freedoms up to which it is done: of more, calls cost little beside the work, and what a plan keeps
# is no longer small.
MOST_FREEDOMS = 100


class SweepPlan(NamedTuple):
    """What a sweep does, but for values.

    Attributes:
        assembly: of the first value.
        driven: what is prescribed, the driver first, as the kernel counts.
        idle: what begins paths, each for one caller at a time.
    """

    assembly: AssemblyPlan
    driven: list[int]
    idle: list[Beginning]


def swept_at_once(
    mechanism: Mechanism, driver: str, held: tuple[str, ...], values: Array, accuracy: Accuracy,
    tolerance: float, guess: State | None,
) -> tuple[int, PathSamples] | None:
    """Return how far a sweep goes, and its samples; None where more is decided than values.

    Args:
        mechanism: the mechanism.
        driver: the coordinate that is swept.
        held: names of what stands still.
        values: (n,) of the driver.
        accuracy: of the motion.
        tolerance: closure residual of the first value.
        guess: a State, or None for the file's guess.
    """
    if guess is not None and (guess.mechanism is not mechanism or (held and held != (BASE,))):
        return None  # joints held by name stand where the State has them
    if as_meant(mechanism, accuracy) is not mechanism:
        return None
    start = read_guess(mechanism, guess)
    plan = _plan(mechanism, driver, held, start.names)
    first: float = values.item(0)
    if plan is None or not abs(first) < plan.assembly.largest or (
            len(values) * mechanism.model.nv > following.CHUNK) or (
            accuracy.corrections is None and there_and_back(values) is not None):
        return None
    q = plan.assembly.start(start, (first,))
    if q is None:
        return None
    try:
        beginning = plan.idle.pop()
    except IndexError:
        beginning = Beginning(Closer(mechanism), plan.driven)
    found = beginning.follow(
        q, plan.assembly.places[0], first, None if guess is None else guess.angles, values,
        accuracy, asked_of(mechanism, plan.assembly.left, tolerance), leads_nowhere(accuracy))
    plan.idle.append(beginning)
    return found


@made_once
def _plan(
    mechanism: Mechanism, driver: str, held: tuple[str, ...], named: tuple[str, ...]
) -> SweepPlan | None:
    """Return what a sweep does from a guess with these names; None where they do not decide it."""
    check_not_held(mechanism, [mechanism.coordinate_table[driver]], held)
    if mechanism.model.nv > MOST_FREEDOMS or type(mechanism).start is not Mechanism.start:
        return None  # where a reduced mechanism begins it knows itself
    assembly = straight_plan(mechanism, (driver,), named, True)
    if assembly is None:
        return None
    driven, still = prescribed_first(mechanism, (driver,), held)
    moving = moving_drivers(mechanism, driven, still)
    if moving and len(moving) < len(mechanism.drivers):
        return None  # it is told of each that it moves
    closer = Closer(mechanism)
    k = closer.kernel
    places = prescribed_places(k, driven, still)
    if not closer.knows_mirrors or not 0 <= k.nv - k.n_passive - len(places) <= k.n_closure:
        return None
    return SweepPlan(assembly, places, [Beginning(closer, places)])
