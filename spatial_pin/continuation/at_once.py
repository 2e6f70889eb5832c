"""A sweep in one call of the kernel: from the guess through all values.

What `assembled` and `follow` would do one after the other, where nothing is to be decided on the
way: of few samples the price of calls is most of what a sweep costs.
"""

from __future__ import annotations

from typing import NamedTuple

from spatial_pin.assembly.holding import BASE
from spatial_pin.assembly.rounding import as_meant
from spatial_pin.assembly.search.guesses import Guess, read_guess
from spatial_pin.assembly.search.straight import Plan as Assembly
from spatial_pin.assembly.search.straight import leads_nowhere, straight_plan
from spatial_pin.assembly.search.targets import asked_of
from spatial_pin.assembly.state import State
from spatial_pin.continuation import follow as following
from spatial_pin.continuation.evaluation_order import there_and_back
from spatial_pin.continuation.start import moving_drivers
from spatial_pin.kernel.beginning import Beginning
from spatial_pin.kernel.closer import Closer
from spatial_pin.kernel.paths import Samples, prescribed_places
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array
from spatial_pin.rates.rates import check_not_held, prescribed_first
from spatial_pin.settings import Accuracy

# Freedoms up to which it is done: of more, calls cost little beside the work, and what a plan keeps
# is no longer small.
MOST_FREEDOMS = 100


class Plan(NamedTuple):
    """What a sweep does, but for values.

    Attributes:
        assembly: of the first value.
        begin: (nq,) the file's guess, or None where it begins at a State.
        driven: what is prescribed, the driver first, as the kernel counts.
        idle: what begins paths, each for one caller at a time.
    """

    assembly: Assembly
    begin: Array | None
    driven: list[int]
    idle: list[Beginning]


def swept_at_once(
    mechanism: Mechanism, driver: str, held: tuple[str, ...], values: Array, accuracy: Accuracy,
    tolerance: float, guess: State | None,
) -> tuple[int, Samples] | None:
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
    plan = _known_plan(mechanism, driver, held, start, guess is None)
    first: float = values.item(0)
    if plan is None or not abs(first) < plan.assembly.largest or (
            len(values) * mechanism.model.nv > following.CHUNK) or (
            accuracy.corrections is None and there_and_back(values) is not None):
        return None
    q = plan.begin if guess is None else plan.assembly.start(start, (first,))
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


def _known_plan(
    mechanism: Mechanism, driver: str, held: tuple[str, ...], guess: Guess, is_of_file: bool
) -> Plan | None:
    """Return what a sweep does, made once, and anew if the guess of the file is another."""
    key = "sweep", driver, held, is_of_file
    known: tuple[Guess, Plan | None] | None = mechanism.memo.get(key)
    if known is None or (is_of_file and known[0] is not guess):
        known = mechanism.memo[key] = guess, _plan(mechanism, driver, held, guess, is_of_file)
    return known[1]


def _plan(
    mechanism: Mechanism, driver: str, held: tuple[str, ...], guess: Guess, is_of_file: bool
) -> Plan | None:
    """Return what a sweep does; None where names do not decide it."""
    check_not_held(mechanism, [mechanism.coordinate_table[driver]], held)
    if mechanism.model.nv > MOST_FREEDOMS or type(mechanism).start is not Mechanism.start:
        return None  # where a reduced mechanism begins it knows itself
    assembly = straight_plan(mechanism, (driver,), guess.names, True)
    begin = None if assembly is None else assembly.start(guess, (0.0,))
    if assembly is None or (begin is None and is_of_file):
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
    return Plan(assembly, begin if is_of_file else None, places, [Beginning(closer, places)])
