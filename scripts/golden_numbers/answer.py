"""Golden numbers: what a verb answers, each with its size and the error that the library states.

Files of them are one .npz with the answer of every verb of every mechanism.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import spatial_pin as sp

Array = np.ndarray
ROUND_OFF = 8.0 * float(np.finfo(float).eps)  # closure error that `State.rate_error` reckons with
MORE = 1.0  # by which a stated error may grow, relative to itself: it is an estimate
NUMBER = re.compile(r"[-+]?(?:\d+\.\d*|\.\d+|\d+)(?:[eE][-+]?\d+)?")


class Numbers(NamedTuple):
    """An array of an answer; the others are spread over its shape.

    Attributes:
        values: the numbers.
        scale: size that differences are relative to.
        known: error that the library itself states, relative to the scale; 0 where it states none.
        by: what states it.
        at_most: whether smaller numbers are as good: errors and drifts.
    """

    values: Array
    scale: Array
    known: Array
    by: str = ""
    at_most: bool = False


Answer = dict[str, Numbers | str]  # texts are golden too
Golden = dict[tuple[str, str], Answer]  # by mechanism and verb
FIELDS = "values", "scale", "known"


def write(path: Path, golden: Golden) -> None:
    """Write answers to a file."""
    arrays = {}
    for case, answer in golden.items():
        arrays["/".join((*case, "", "asked"))] = np.array("")
        for name, value in answer.items():
            key = "/".join((*case, name))
            if isinstance(value, str):
                arrays[f"{key}/text"] = np.array(value)
                continue
            for field in FIELDS:
                arrays[f"{key}/{field}"] = getattr(value, field)
            arrays[f"{key}/meaning"] = np.array([value.by, "at most" * value.at_most])
    np.savez_compressed(path, **arrays)


def read(path: Path) -> Golden:
    """Return the answers of a file."""
    golden: Golden = {}
    with np.load(path) as arrays:
        for key in arrays.files:
            mechanism, verb, name, kind = key.split("/")
            answer = golden.setdefault((mechanism, verb), {})
            if kind == "text":
                answer[name] = str(arrays[key])
            elif kind == "meaning":
                by, bound = arrays[key].tolist()
                base = key.removesuffix("/meaning")
                answer[name] = Numbers(*(arrays[f"{base}/{x}"] for x in FIELDS), by, bool(bound))
    return golden


def numbers(values: Any, scale: Any = 1.0, known: Any = 0.0, by: str = "") -> Numbers:
    """Return an array of an answer."""
    return Numbers(*(np.array(x, dtype=float) for x in (values, scale, known)), by)


def at_most(values: Any, allowed: float) -> Numbers:
    """Return errors, which may be smaller, or as large as the allowed one."""
    return Numbers(np.array(values, dtype=float), np.array(1.0), np.array(allowed),
                   "what was allowed", True)


def configuration_scale(mechanism: sp.Mechanism) -> Array:
    """Return the size (nq,) of entries of a configuration: lengths as the mechanism, angles 1."""
    size = np.ones(mechanism.model.nq)
    for joint in mechanism.model.joints[1:]:
        own = mechanism.velocity_scale[joint.idx_v : joint.idx_v + joint.nv]
        if joint.nq == joint.nv:
            size[joint.idx_q : joint.idx_q + joint.nq] = own
        elif joint.nv in (3, 6) and own[0] != 1.0:  # slides, before a quaternion or (cos, sin)
            slides = 3 if joint.nv == 6 else 2
            size[joint.idx_q : joint.idx_q + slides] = own[:slides]
    return size


def paces(mechanism: sp.Mechanism, rates: Array) -> Array:
    """Return the largest rate of each sample (N, 1) [rad, characteristic lengths per unit]."""
    largest = np.abs(rates / mechanism.velocity_scale).max(axis=1, initial=0.0, keepdims=True)
    return np.where(largest > 0.0, largest, 1.0)


def closed_to(errors: Any, closure_errors: Any) -> Any:
    """Return stated errors of rates where loops are closed worse than to round-off."""
    return np.asarray(errors) * np.maximum(1.0, np.asarray(closure_errors) / ROUND_OFF)


def motion(
    given: sp.Motion, known: Any = None, by: str = "", *, along: bool = False
) -> Answer:
    """Return the samples of a motion, and its events.

    Args:
        given: the motion.
        known: (N, 1) stated error of each sample's rates relative to their size; default what the
            states of a driver's motion say. Configurations are known better, as the driver's part
            of the rates is.
        by: what states it.
        along: whether samples are counted along the curve, so that what is lost where branches
            cross is lost for all that follow.
    """
    mechanism, n = given.mechanism, len(given)
    answer: Answer = {}
    if known is None:
        lost = np.array([given.state(k).rate_error for k in range(n)])
        known, by = closed_to(np.where(np.isfinite(lost), lost, 1.0),
                              given.closure_error).reshape(n, 1), "rate_error and closure_error"
        answer["rate error"] = at_most(lost, MORE * lost)
    known = np.maximum.accumulate(known) if along else known
    pace, own = paces(mechanism, given.v), mechanism.velocity_scale
    bend = np.maximum(paces(mechanism, given.a), pace**2)
    placed = known / _ahead(given, pace)
    answer |= {
        "q": numbers(given.q, configuration_scale(mechanism), placed, by),
        "v": numbers(given.v, pace * own, known, by),
        "a": numbers(given.a, bend * own, known, by),
        "angles": numbers(given.angles, 1.0, placed if given.angles.size else 0.0, by),
        "closure error": at_most(given.closure_error, sp.Accuracy().tolerance),
    }
    for name, values in (("driver", given.driver), ("time", given.time)):
        if values is not None:
            answer[name] = numbers(values, np.abs(values).max(initial=1e-300),
                                   known[:, 0] if along else 0.0, by)
    at_values = given.driver is not None and not along  # at given values
    return answer | events(given.events, None if at_values else known)


def _ahead(given: sp.Motion, pace: Array) -> Array:
    """Return how many times faster than the driver joints move (N, 1), 1 at least."""
    if given.driver is None:
        return np.ones_like(pace)
    speed = np.abs(given.driver_speed).reshape(-1, 1) / np.max(
        given.mechanism.velocity_scale[given.mechanism.coordinate(given.driver_name).v])
    return np.maximum(pace / np.maximum(speed, 1e-300), 1.0)


def events(given: Sequence[sp.Event], known: Any = None) -> Answer:
    """Return events: kinds, samples before them, words of their sentences, and values.

    Args:
        given: the events.
        known: (N, 1) stated error of each sample, where events are known no better.
    """
    errors = [crossing(e.kind) for e in given]
    if known is not None and len(known):
        errors = [max(error, float(known[min(e.row, len(known) - 1), 0]))
                  for error, e in zip(errors, given, strict=True)]
    return {"events": "\n".join(f"{e.kind}, sample {e.row}: {without_numbers(e.text)}"
                                for e in given),
            "event values": numbers([e.value for e in given], 1.0, errors,
                                    "branches that cross, and its samples")}


def without_numbers(text: str) -> str:
    """Return a sentence with a sign in the place of every number."""
    return NUMBER.sub("#", text)


def crossing(kind: str) -> float:
    """Return how well an event or bound is known: to the root of round-off where branches cross."""
    return float(np.sqrt(ROUND_OFF)) if kind in ("branch point", "singular") else 0.0


def state(given: sp.State, prefix: str = "") -> Answer:
    """Return a state's configuration, placements of its links, and closure error."""
    mechanism = given.mechanism
    known, by = stated(given)
    turned, moved = placements(given, mechanism.links)
    return {
        f"{prefix}q": numbers(given.q, configuration_scale(mechanism), known, by),
        f"{prefix}rotations": numbers(turned, 1.0, known, by),
        f"{prefix}positions": numbers(moved, mechanism.characteristic_length, known, by),
        f"{prefix}closure error": at_most(given.closure_error, sp.Accuracy().tolerance),
    }


def placements(given: sp.State, links: Sequence[str]) -> tuple[list[Array], list[Array]]:
    """Return rotations and positions of links in the world."""
    placed = [given.placement(link) for link in links]
    return [p.rotation for p in placed], [p.translation for p in placed]


def stated(given: sp.State) -> tuple[float, str]:
    """Return the error that a state's configuration is known to, and what says so.

    It is what rates that its drivers make would have. Where they make none the configuration is
    singular: known to the root of what closes its loops only.
    """
    try:
        lost = given.rate_error if np.isfinite(given.rate_error) else sp.solve_rates(
            given.mechanism, given).rate_error
    except sp.SpatialPinError:
        return float(np.sqrt(sp.Accuracy().tolerance)), "root of the tolerance: singular"
    return float(closed_to(lost, given.closure_error)), "rate_error and closure_error"


def forces(
    result: Mapping[str, Any], weight: float, length: float, known: float, by: str
) -> Answer:
    """Return wrenches by pair, forces relative to the largest of all, moments likewise.

    Args:
        result: wrenches by name.
        weight: of the mechanism [N], the least size of a force; times `length` [m] of a moment.
        length: its size [m].
        known: stated error.
        by: what states it.
    """
    linear = np.array([f.linear for f in result.values()]).reshape(-1, 3)
    angular = np.array([f.angular for f in result.values()]).reshape(-1, 3)
    return {
        "pairs": ", ".join(result),
        "forces": numbers(linear, np.abs(linear).max(initial=weight), known, by),
        "moments": numbers(angular, np.abs(angular).max(initial=weight * length), known, by),
    }


def with_prefix(prefix: str, answer: Answer) -> Answer:
    """Return an answer under longer names."""
    return {f"{prefix} {name}": x for name, x in answer.items()}
