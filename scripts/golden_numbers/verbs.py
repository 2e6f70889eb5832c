"""The answers of every verb for a mechanism."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

import spatial_pin as sp
from golden_numbers import answer
from golden_numbers.answer import Answer, Array, at_most, numbers, with_prefix

TURN = 2.0 * np.pi
SLIDE = 0.15  # characteristic lengths that a slide is driven
WITHIN = 0.97  # part of the way to a limit: rates are good there
BEYOND = 1.02  # part of the way to a limit that is refused
DIGITS = 6  # of driver values, so that answers do not depend on round-off
MOMENTS = (0.1, 0.37, 0.73)  # parts of the usual range at which states are computed
ROWS = 400  # samples of a traced curve
STEP = 0.05  # arc length between them
PATIENCE = 200  # of the search for modes
FALL = 2.0  # duration of a fall, in times of falling by the characteristic length
SPEED, ACCELERATION = 2.0, 0.5  # of a driver, by its unit and second

EXACT = sp.Accuracy.named("reference")


def driver_of(mechanism: sp.Mechanism) -> str:
    """Return the driver that is swept, the first one."""
    return next(iter(mechanism.drivers), mechanism.coordinates[0])


def start_of(mechanism: sp.Mechanism, driver: str) -> float:
    """Return the value of the driver in the guess."""
    return round(sp.assemble(mechanism).coordinate(driver).value, DIGITS)


def paths(mechanism: sp.Mechanism, driver: str) -> list[tuple[float, bool]]:
    """Return how far the driver can go from the guess either way, and whether to a limit."""
    start = start_of(mechanism, driver)
    slides = mechanism.coordinate(driver).unit == "m"
    most = SLIDE * mechanism.characteristic_length if slides else TURN
    try:
        result = sp.limits(mechanism, driver)
    except sp.SpatialPinError:
        return [(most, False), (-most, False)]
    return [(float(np.clip(bound.value - start, -most, most)), abs(bound.value - start) < most)
            for bound in (result.upper, result.lower)]


def usual_values(mechanism: sp.Mechanism, driver: str, n: int) -> Array:
    """Return driver values from the guess on, over a turn or nearly to a limit."""
    path, ends = max(paths(mechanism, driver), key=lambda path: abs(path[0]))
    start = start_of(mechanism, driver)
    return np.linspace(start, round(start + path * (WITHIN if ends else 1.0), DIGITS), n)


def states(mechanism: sp.Mechanism) -> Iterator[tuple[str, sp.State]]:
    """Yield moving states over the usual range, by their part of it."""
    driver = driver_of(mechanism)
    values = usual_values(mechanism, driver, 101)
    motion = sp.sweep(mechanism, driver, values, on_limit="stop")
    for part in MOMENTS:
        at = motion.state(int(part * (len(motion) - 1)))
        yield f"at {part:g}", sp.solve_rates(mechanism, at, {driver: SPEED}, {driver: ACCELERATION})


def sweep(mechanism: sp.Mechanism) -> Answer:
    """Sweep the first driver: many values without a speed, few with one; also to round-off."""
    driver, result = driver_of(mechanism), Answer()
    many, few = (usual_values(mechanism, driver, n) for n in (361, 40))
    for words, accuracy in (("", None), (" exact", EXACT)):
        at_rest = sp.sweep(mechanism, driver, many, on_limit="stop", accuracy=accuracy)
        moving = sp.sweep(mechanism, driver, few, SPEED, ACCELERATION, on_limit="stop",
                          accuracy=accuracy)
        result |= with_prefix(f"361{words}", answer.motion(at_rest))
        result |= with_prefix(f"40{words}", answer.motion(moving))
    return result


def beyond(mechanism: sp.Mechanism) -> Answer:
    """Sweep the first driver through a limit of its own, where it has one."""
    driver, start = driver_of(mechanism), start_of(mechanism, driver_of(mechanism))
    result: Answer = {}
    for path, ends in paths(mechanism, driver):
        if ends:
            values = np.linspace(start, round(start + BEYOND * path, DIGITS), 40)
            side = "up" if path > 0.0 else "down"
            stopped = sp.sweep(mechanism, driver, values, on_limit="stop", on_crossing="stop")
            result |= with_prefix(f"{side} stopped", answer.events(stopped.events))
            result[f"{side} refused"] = refusal(
                lambda values=values: sp.sweep(mechanism, driver, values))
    return result


def trace(mechanism: sp.Mechanism) -> Answer:
    """Trace the curve of the first driver."""
    curve = sp.trace(mechanism, driver_of(mechanism), step=STEP, most_rows=ROWS)
    return answer.motion(curve, along=True)


def limits(mechanism: sp.Mechanism) -> Answer:
    """Ask how far every driver can go."""
    result: Answer = {}
    for driver in mechanism.drivers or [driver_of(mechanism)]:
        size = mechanism.characteristic_length if mechanism.coordinate(
            driver).unit == "m" else 1.0
        for joints in (False, True):
            name = f"{driver}{' with those of joints' if joints else ''}"
            try:
                reach = sp.limits(mechanism, driver, joints=joints)
            except sp.SpatialPinError as error:
                result[name] = sentence(error)
                continue
            ends = np.array([reach.lower.value, reach.upper.value])
            result[name] = f"{reach.lower.kind}, {reach.upper.kind}, turns: {reach.full_turn}"
            result[f"{name} ends"] = numbers(ends, size, [
                answer.crossing(end.kind) for end in (reach.lower, reach.upper)],
                "branches that cross")
    return result


def modes(mechanism: sp.Mechanism) -> Answer:
    """Search the assembly modes at the driver values of the guess.

    Idle links have any pose; no number of the search itself is golden.
    """
    every_mode = sp.assembly_modes(mechanism, patience=PATIENCE)
    idle = {freedom.link for freedom in sp.mobility(mechanism).passive}
    links = [link for link in mechanism.links if link not in idle]
    result: Answer = {"branches": "\n".join(mode.branch for mode in every_mode),
                       "continua": str(len(every_mode.continua))}
    for k, mode in enumerate(every_mode):
        known, by = answer.stated(mode)
        turned, moved = answer.placements(mode, links)
        result[f"{k} rotations"] = numbers(turned, 1.0, known, by)
        result[f"{k} positions"] = numbers(moved, mechanism.characteristic_length, known, by)
    return result


def mobility(mechanism: sp.Mechanism) -> Answer:
    """Ask for the mobility."""
    return {"report": str(sp.mobility(mechanism))}


def assemble(mechanism: sp.Mechanism) -> Answer:
    """Assemble from the file, elsewhere, and far away."""
    driver = driver_of(mechanism)
    values = usual_values(mechanism, driver, 101)
    result = answer.state(sp.assemble(mechanism), "guess ")
    for k in (37, 73):
        name = f"value {k}"
        try:
            there = sp.assemble(mechanism, {driver: values[k]})
        except sp.SpatialPinError as error:
            result[name] = sentence(error)
            continue
        result |= answer.state(there, f"{name} ")
        result[f"{name} released"] = ", ".join(there.released)
    return result


def rates(mechanism: sp.Mechanism) -> Answer:
    """Solve rates, jerks and Jacobians at some states."""
    result: Answer = {}
    own, length = mechanism.velocity_scale, mechanism.characteristic_length
    scale = np.array([length] * 3 + [1.0] * 3)[:, None]
    for name, at in states(mechanism):
        known = answer.stated(at)
        jerk = sp.solve_jerks(mechanism, at).j
        v, a, j = (float(answer.paces(mechanism, x[None])[0, 0]) for x in (at.v, at.a, jerk))
        result |= answer.state(at, f"{name} ") | {
            f"{name} v": numbers(at.v, v * own, *known),
            f"{name} a": numbers(at.a, max(a, v**2) * own, *known),
            f"{name} jerks": numbers(jerk, max(j, v**3) * own, *known)}
        for link in mechanism.links[-2:]:
            for what, matrix in (("jacobian", sp.jacobian(mechanism, at, link)),
                                 ("jacobian rate", sp.jacobian_rate(mechanism, at, link))):
                size = np.abs(matrix / scale).max(initial=max(v, 1.0))
                result[f"{name} {what} of {link}"] = numbers(matrix / scale, size, *known)
    return result


def dynamics(mechanism: sp.Mechanism) -> Answer:
    """Solve forward and inverse dynamics at some states."""
    result: Answer = {}
    own, length = mechanism.velocity_scale, mechanism.characteristic_length
    weight = 9.81 * sum(body.mass for body in mechanism.model.inertias) or 1.0
    for name, at in states(mechanism):
        known, by = answer.stated(at)
        forward, inverse = sp.forward_dynamics(mechanism, at), sp.inverse_dynamics(mechanism, at)
        efforts = np.array(list(inverse.efforts.values()))
        largest = np.abs(efforts).max(initial=weight * length)
        error = max(known, forward.error)
        result |= {
            f"{name} forward a": numbers(
                forward.a, answer.paces(mechanism, forward.a[None])[0] * own, error, "error"),
            f"{name} efforts": numbers(efforts, largest, known, by),
            f"{name} unique": str({pair: each.astype(int).tolist()
                                   for pair, each in inverse.unique.items()}),
            **with_prefix(f"{name} forward", answer.forces(
                forward.reactions, weight, length, error, "error")),
            **with_prefix(f"{name} inverse", answer.forces(
                inverse.reactions, weight, length, known, by)),
        }
    return result


def simulate(mechanism: sp.Mechanism) -> Answer:
    """Let the mechanism fall for a short while, in independent and in projected coordinates.

    What the integrator leaves is the difference to one of reference accuracy.
    """
    driver = driver_of(mechanism)
    start = sp.solve_rates(mechanism, sp.assemble(mechanism), {driver: 1.0})
    duration = float(f"{FALL * np.sqrt(mechanism.characteristic_length / 9.81):.2g}")
    times = np.linspace(0.0, duration, 41)
    result: Answer = {}
    for formulation in ("independent", "projected"):
        try:
            usual, exact = (
                sp.simulate(mechanism, start, duration, times=times,
                            accuracy=sp.Accuracy(formulation=formulation, **settings))
                for settings in ({}, {"tolerance": EXACT.tolerance,
                                      "time_tolerance": EXACT.time_tolerance}))
        except sp.SpatialPinError as error:
            result[formulation] = answer.without_numbers(sentence(error))  # they follow the steps
            continue
        known = integrator_error(usual, exact)
        whole = answer.motion(usual, known, "the integrator's error")
        size = max(float(np.abs(usual.energy).max()), float(np.ptp(usual.energy)), 1e-300)
        whole["energy"] = numbers(usual.energy, size, known.max(initial=0.0),
                                  "the integrator's error")
        whole["energy drift"] = at_most(usual.energy_drift, float(known.max(initial=0.0)))
        result |= with_prefix(formulation, whole)
    return result


def integrator_error(usual: sp.Simulation, exact: sp.Simulation) -> Array:
    """Return the error of a simulation so far (N, 1), by one of reference accuracy."""
    n = min(len(usual), len(exact))
    mechanism, error = usual.mechanism, np.zeros((len(usual), 1))
    own, pace = mechanism.velocity_scale, answer.paces(mechanism, exact.v[:n])
    bend = np.maximum(answer.paces(mechanism, exact.a[:n]), pace**2)
    for a, b, size in ((usual.q, exact.q, answer.configuration_scale(mechanism)),
                       (usual.v, exact.v, pace * own), (usual.a, exact.a, bend * own)):
        error[:n] = np.maximum(error[:n], (np.abs(a[:n] - b[:n]) / size).max(
            axis=1, initial=0.0, keepdims=True))
    settings = sp.Accuracy.named("engineering")
    return np.maximum(np.maximum.accumulate(error), settings.time_tolerance)


def reduce(mechanism: sp.Mechanism) -> Answer:
    """Reduce to a coordinate, and to a link, and sweep the reduced models."""
    driver = driver_of(mechanism)
    driven = {mechanism.coordinate(d.joint).name for d in mechanism.drivers.values()}
    others = [name for name in mechanism.coordinates if name not in driven]
    result: Answer = {}
    for output in [*others[-1:], mechanism.links[-1]]:
        for loaded in (False, True):
            name = f"{output}{' loaded' if loaded else ''}"
            try:
                made = sp.reduce(mechanism, output, dynamics=loaded)
                values = usual_values(made, driver, 40)
                moved = sp.sweep(made, driver, values, on_limit="stop")
            except sp.SpatialPinError as error:
                result[name] = sentence(error)
                continue
            result[name] = str(made)
            result |= with_prefix(name, answer.motion(moved))
    return result


def sensitivity(mechanism: sp.Mechanism) -> Answer:
    """Differentiate a coordinate, and its rate, with respect to two dimensions."""
    driven = {mechanism.coordinate(d.joint).name for d in mechanism.drivers.values()}
    outputs = [name for name in mechanism.coordinates if name not in driven][-1:]
    names = [*mechanism.dimensions]
    names = [*names[:1], *names[1:][-1:]]
    at = next(states(mechanism))[1]
    result: Answer = {}
    for output in outputs:
        try:
            one = sp.sensitivity(mechanism, at, output, names)
        except sp.SpatialPinError as error:
            result[output] = sentence(error)
            continue
        result[f"{output} value"] = numbers(one.value, 1.0, at.rate_error, "rate_error")
        for dimension, value in one.derivatives.items():
            result[f"{output} to {dimension}"] = numbers(
                value, 1.0, one.errors[dimension], "its own error")
    return result


def sentence(error: Exception) -> str:
    """Return a refusal as text."""
    return f"{type(error).__name__}: {error}"


def refusal(question: Callable[[], Any]) -> str:
    """Return how a question is refused."""
    try:
        question()
    except sp.SpatialPinError as error:
        return sentence(error)
    return "no refusal"


def ask(name: str, verb: str) -> Answer:
    """Return what a verb answers of a mechanism of the library, its warnings too."""
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always", sp.SpatialPinWarning)
        try:
            result = VERBS[verb](sp.load(name))
        except sp.SpatialPinError as error:
            result = {"refusal": sentence(error)}
    texts = [str(w.message) for w in heard if issubclass(w.category, sp.SpatialPinWarning)]
    return result | ({"warnings": "\n".join(texts)} if texts else {})


VERBS: dict[str, Callable[[sp.Mechanism], Answer]] = {
    "assemble": assemble,
    "rates": rates,
    "sweep": sweep,
    "beyond": beyond,
    "trace": trace,
    "limits": limits,
    "modes": modes,
    "mobility": mobility,
    "dynamics": dynamics,
    "simulate": simulate,
    "reduce": reduce,
    "sensitivity": sensitivity,
}
