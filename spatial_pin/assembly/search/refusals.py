"""Error messages of a failed assembly."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from spatial_pin.assembly.redundant_equations import clearly_above, gap_words
from spatial_pin.assembly.search.assembly_problem import ACCEPTED, coordinate_sizes, size_of
from spatial_pin.assembly.search.guesses import COORDINATE_ERROR, MAX_STARTS
from spatial_pin.assembly.search.search import Search
from spatial_pin.assembly.state import State
from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.constraints.vector_products import opposite_axes
from spatial_pin.errors import AssemblyError
from spatial_pin.kernel.loop_equations import LoopEquations
from spatial_pin.mechanism.coordinates import coordinate_value, with_values
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array, decompose
from spatial_pin.numerics.tolerances import TOLERANCES

NO_LENGTH = 30.0  # ratio to the mechanism's size beyond which a length is probably in another unit


def failure(search: Search) -> AssemblyError:
    """Return the error of a failed search, with its best attempt."""
    problem, mechanism = search.problem, search.mechanism
    where = f"mechanism {mechanism.name!r}"
    if problem.given:
        where += f" with {_values(problem.given)}"
    if search.nearest_miss is None:
        q = with_values(mechanism, mechanism.neutral, {**problem.named, **problem.held})
        return AssemblyError(f"{where} cannot be closed: {_too_large(mechanism, q)}",
                             closure_error=np.inf, worst_closure="")
    error, q, worst = search.nearest_miss
    problem.evaluation.update(q)
    state = State(mechanism, q, closure_error=error, angles=problem.evaluation.angles)
    if not error <= ACCEPTED:
        message = f"{where} cannot be closed: {_gap_words(search.worst, error, q, worst)}"
    elif worst.startswith("limit of "):
        own = any(worst.startswith(f"limit of {name}:") for name in problem.held)
        message = (f"{where} closes only outside the joint limits ({worst}); " + (
            "that is the value given: give one within its limits" if own else
            "give values of the drivers at which it stays inside"))
    else:
        message = f"{where} {_mirror_words(search.worst, q)}"
    if problem.standing:
        message += (f"; drivers that were given no value stand at {_values(problem.standing)}: "
                    "give them values, or let them go with release=True or free=[...]")
    return AssemblyError(message, closure_error=error, worst_closure=worst, state=state)


def _values(given: Mapping[str, float]) -> str:
    return ", ".join(f"{name} = {value:.6g}" for name, value in given.items())


def _gap_words(search: Search, error: float, q: Array, worst: str) -> str:
    """Return how far closure `worst` stays open at the best attempt q (nq,), and why."""
    mechanism, whole = search.mechanism, search.problem.whole or search.problem.evaluation
    whole.update(q)
    gap = open_gap(whole.mechanism, whole, worst)
    if search.problem.whole is not None and search.problem.evaluation.closure_error <= ACCEPTED:
        return (f"the file's numbers are rounded, and redundant equations of closure {worst!r} "
                f"open by {gap} there (closure error {error:.1e}), beyond the gap of "
                f"{search.problem.gap:.0e} (gap={clearly_above(error):.0e} allows it)")
    large = size_of(mechanism, q) * COORDINATE_ERROR > ACCEPTED
    words = (f"closure {worst!r} stays open by {gap} (closure error {error:.1e}), the smallest gap "
             "found; ") + (_too_large(mechanism, q) if large else _open_words(search, q, worst))
    constraints = constraints_of(mechanism)
    by_path = [constraints.labels[x.equation].closure for x, turns in zip(
        constraints.angles, constraints.turns, strict=True) if not turns.are_all]
    if worst in by_path and next(c for c in mechanism.closures if c.name == worst).type == "screw":
        words += ("; its joints do not tell how often this screw has turned, so that it is "
                  "assembled within half a turn of the guess: sweep to further turns, or put the "
                  "screw into the tree")
    return words


def _mirror_words(search: Search, q: Array) -> str:
    """Return why loops close only with opposite axes of closures, the evaluation at q (nq,).

    If they close with other driver values, these are the cause; else the frames are.
    """
    problem = search.problem
    opposite = opposite_axes(problem.evaluation.mechanism, problem.evaluation.data)
    names = " and ".join(map(repr, opposite))
    words = (f"closes only with the axes of closure {names} pointing opposite ways, which is "
             "no assembly of it; ")
    elsewhere = _closed_elsewhere(search, q) if problem.held else {}
    if elsewhere:
        values = _values(elsewhere)
        return (f"{words}the values are out of reach: left free, the loops close at "
                f"{values}")
    if not all(opposite.values()):
        return (f"{words}its three axes are interchanged, too: give its two frames "
                "the same orientation where the loop is closed")
    some = "one of its frames" if len(opposite) == 1 else "one frame of each"
    return f"{words}turn {some} round, by half a turn about its x axis"


def _open_words(search: Search, q: Array, worst: str) -> str:
    """Return why loops stay open at the best attempt q (nq,), closure `worst` the most."""
    problem = search.problem
    elsewhere = _closed_elsewhere(search, q) if problem.held else {}
    if not elsewhere:
        return (f"no assembly was found from here, nor does any of {MAX_STARTS} starts close "
                "the loops" + " at other values of the drivers" * bool(problem.held)
                + f": check {suspect_data(search.mechanism, worst)}; if they "
                "are right, give a guess nearer to a closed configuration"
                + ("" if problem.whole else gap_words(search.mechanism)))
    values = _values(elsewhere)
    n, entries = problem.evaluation.constraints.n_closure, problem.entries
    freedoms = int(entries.sum()) - decompose(problem.evaluation.jacobian[:n]).rank
    given = sum(problem.is_relevant(name) for name in problem.given)
    if given > freedoms:
        return (f"{given} coordinates have a value, but the mechanism has {freedoms} "
                f"freedom{'s' * (freedoms != 1)}: leave out {given - freedoms} "
                f"(the nearest values that fit are {values})")
    return ("a value is out of reach: left free, the loops close at "
            f"{values}")


def suspect_data(mechanism: Mechanism, worst: str) -> str:
    """Return the data of the most open closure that may be wrong, as text."""
    closure = {c.name: c for c in mechanism.closures}.get(worst)
    if closure and closure.joints:
        return f"ratio and offset of coupling {worst!r}, and the other closures"
    length = closure.geometry.length if closure else 0.0
    times = length / mechanism.characteristic_length
    hint = "" if times < NO_LENGTH else (
        f" (length = {length:g} m is {times:.3g} times the mechanism's size: {length:g} mm are "
        f"{length / 1e3:g})")
    return f"the frames of {worst!r} and the lengths between them{hint}"


def _closed_elsewhere(search: Search, q: Array) -> dict[str, float]:
    """Return values near the given ones at which the loops close, if there are any.

    The evaluation is then at that configuration.
    """
    problem = search.problem
    other = Search(problem.nearest_to(q), search.limits)
    other.run()
    if other.best is None:
        return {}
    problem.evaluation.update(other.best[1])
    table = problem.mechanism.coordinate_table
    return {name: coordinate_value(problem.mechanism, table[name], other.best[1])
            for name in problem.held if problem.is_relevant(name)}


def _too_large(mechanism: Mechanism, q: Array) -> str:
    """Return which coordinate of q is too large for closing the loops."""
    names, indices, sizes = coordinate_sizes(mechanism)
    name = max(zip(np.abs(q[indices] / sizes).tolist(), names, strict=True))[1]
    value = float(q[mechanism.index_of(mechanism.coordinate_table[name])])
    return (f"{name} = {value:.3g} {mechanism.coordinate_table[name].unit} is so large that its "
            "round-off alone opens the loops; give a value nearer to the mechanism's size of "
            f"{mechanism.characteristic_length:.3g} m (angles: fewer turns)")


def open_gap(mechanism: Mechanism, evaluation: LoopEquations, closure: str) -> str:
    """Return the error of a closure at the evaluation, in m or rad, as text."""
    constraints = evaluation.constraints
    rows = [i for i, label in enumerate(constraints.labels) if label.closure == closure]
    kinds = {c.name: c for c in mechanism.closures}[closure]
    is_length = [row.is_length or (bool(kinds.joints)
                 and mechanism.coordinate(kinds.joints[-1]).unit == "m") for row in kinds.rows]
    values = evaluation.residual[rows]
    lengths = float(np.linalg.norm(values[np.array(is_length)]))
    angles = float(np.linalg.norm(values[~np.array(is_length)]))
    parts, least = [], TOLERANCES.half_precision * max(lengths, angles)
    if lengths > least:
        parts.append(f"{lengths * mechanism.characteristic_length:.1e} m")
    if angles > least:
        parts.append(f"{angles:.1e} rad")
    return " and ".join(parts) or "0"
