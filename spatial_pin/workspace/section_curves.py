"""Curves in a section of a grid: the boundary, and zeros of a determinant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from spatial_pin._support.checks import finite_number, mapping, positive_number
from spatial_pin.assembly.start_values import turn_free_difference
from spatial_pin.kernel.loop_equations import loops_of
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.workspace.dexterity import SINGULAR, FrameTask
from spatial_pin.workspace.grid_lines import Border, GridConfig
from spatial_pin.workspace.locus import AT_CORNER, LIMIT, RANGE, Locus, Section, walk
from spatial_pin.workspace.workspace_result import Curve, Workspace, unit_of

MEETS = 1e3 * AT_CORNER  # distance of two ends of curves at one corner


class CurvePiece(NamedTuple):
    """A curve of one kind."""

    y: Array
    why: str
    is_closed: bool


def curves_of(
    config: GridConfig, task: FrameTask, borders: Sequence[Border], free: tuple[int, int],
    spans: Array, tolerance: float,
) -> list[Curve]:
    """Return the curves in a section of a grid, pieces of the boundary joined at corners.

    They begin at `borders`. Two coordinates, by their numbers, are `free`; `spans` (k, 2) are the
    ranges of all; `tolerance` is that of the polylines [rad, characteristic lengths].
    """
    kinds = {LIMIT} | ({SINGULAR} if task.is_square else set())
    with loops_of(config.mechanism) as evaluation:
        section = Section(config, task, evaluation, free, spans)
        kinds |= set(section.limits)
        seeds: list[tuple[str, Array, Array]] = [
            (b.why, b.q, b.angles) for b in borders
            if b.why in kinds and b.q is not None and b.angles is not None]
        pieces: list[CurvePiece] = []
        while seeds:
            why, q, angles = seeds.pop(0)
            evaluation.angle_reference[:] = angles
            seeds += _follow(Locus(section, why, tolerance), q, pieces)
        return [_curve(section, chain, tolerance) for chain in joined(pieces)]


def _follow(locus: Locus, q: Array, pieces: list[CurvePiece]) -> list[tuple[str, Array, Array]]:
    """Add the curve near a configuration to the pieces; return starts of curves at its ends."""
    start = locus.beginning(q)
    if start is None or any(  # on a curve that is known
            piece.why == locus.why and _distance(start.y, piece.y) <= 2.0 * locus.tolerance
            for piece in pieces):
        return []
    if any(limit.room(start.q) < -AT_CORNER * limit.size
           for words, limit in locus.section.limits.items() if words != locus.why):
        return []
    ahead = walk(locus, start)
    if ahead.end == "closed":
        pieces.append(CurvePiece(np.array([x.y for x in ahead.spots]), locus.why, True))
        return []
    back = walk(locus, start._replace(t=-start.t, dy=-start.dy))
    spots = [*back.spots[:0:-1], *ahead.spots]
    if len(spots) > 1:  # the last point may be the first, but for whole turns of joints
        difference = turn_free_difference(locus.section.config.mechanism, spots[0].q, spots[-1].q)
        is_closed = ahead.end == back.end == RANGE and bool(np.linalg.norm(difference) < MEETS)
        pieces.append(CurvePiece(np.array([x.y for x in spots]), locus.why, is_closed))
    kinds = {LIMIT, *locus.section.limits}
    return [(end, spot.q, spot.angles) for end, spot in
            ((ahead.end, spots[-1]), (back.end, spots[0])) if end in kinds]


def _distance(y: Array, line: Array) -> float:
    first, edges = line[:-1], np.diff(line, axis=0)
    part = np.einsum("ij,ij->i", y - first, edges) / np.maximum(
        np.einsum("ij,ij->i", edges, edges), TOLERANCES.nothing**2)
    near = first + np.clip(part, 0.0, 1.0)[:, None] * edges
    return float(np.linalg.norm(y - near, axis=1).min())


def joined(pieces: Sequence[CurvePiece]) -> list[list[CurvePiece]]:
    """Return chains of pieces with common ends; curves of determinants stay alone."""
    rest = list(pieces)
    chains: list[list[CurvePiece]] = []
    while rest:
        chain = [rest.pop(0)]
        while not chain[0].is_closed and chain[0].why != SINGULAR:
            grown = _grown(chain, rest)
            if grown is None:
                break
            chain = grown
        chains.append(chain)
    return chains


def _grown(chain: list[CurvePiece], rest: list[CurvePiece]) -> list[CurvePiece] | None:
    """Return a chain with one more piece, which is removed from the rest; None if none meets it."""
    for k, piece in enumerate(rest):
        if piece.is_closed or piece.why == SINGULAR:
            continue
        for oriented in (piece, piece._replace(y=piece.y[::-1])):
            if np.linalg.norm(oriented.y[0] - chain[-1].y[-1]) < MEETS:
                del rest[k]
                return [*chain, oriented]
            if np.linalg.norm(oriented.y[-1] - chain[0].y[0]) < MEETS:
                del rest[k]
                return [oriented, *chain]
    return None


def _curve(section: Section, chain: list[CurvePiece], tolerance: float) -> Curve:
    y = np.concatenate([chain[0].y, *(piece.y[1:] for piece in chain[1:])])
    meets = len(y) > 2 and bool(np.linalg.norm(y[-1] - y[0]) < MEETS)
    is_closed = chain[0].is_closed or (len(chain) > 1 and meets)
    if is_closed:
        at = 0 if meets else len(section.low)  # of the points alone where joints are a turn on
        y[-1, at:] = y[0, at:]
    why: list[str] = []
    for piece in chain:
        why += [piece.why] * (len(piece.y) - 1)
    drivers, points = section.plain(y)
    return Curve(drivers, points, tuple(why), is_closed, tolerance)


def curves(
    result: Workspace, at: Mapping[str, float] | None, tolerance: float
) -> tuple[Curve, ...]:
    """Return the curves in a section of a grid; see `Workspace.curves`."""
    config, ticks, borders, task = result._source
    positive_number(tolerance, "tolerance")
    fixed = dict(mapping({} if at is None else at, "at"))
    for name in fixed:
        if name not in result.names:
            raise ValueError(f"at: {name!r} is no coordinate of the grid: "
                             f"{', '.join(result.names)}")
    free = [k for k, name in enumerate(result.names) if name not in fixed]
    if len(free) != 2:
        raise ValueError(f"at leaves {len(free)} coordinates free of {', '.join(result.names)}; a "
                         "section has two")
    for k, name in enumerate(result.names):
        if k not in free:
            value = finite_number(fixed[name], f"at: {name!r}")
            nearest = float(ticks[k][np.abs(ticks[k] - value).argmin()])
            step = float(ticks[k][1] - ticks[k][0])
            if abs(nearest - value) > TOLERANCES.half_precision * step:
                raise ValueError(f"at: the grid has no value {value:.9g} of {name!r}; the nearest "
                                 f"is {nearest:.9g}")
            borders = [b for b in borders if abs(b.drivers[k] - nearest) < 0.5 * step]
    spans = np.array([[x[0], x[-1]] for x in ticks])
    return tuple(curves_of(config, task, borders, (free[0], free[1]), spans, tolerance))


def curve_columns(result: Workspace, lines: Sequence[Curve]) -> dict[str, Any]:
    """Return the table of curves: a row for each point, with the reason of the next piece."""
    drivers = np.concatenate([c.drivers for c in lines] or [np.empty((0, len(result.names)))])
    points = np.concatenate([c.points for c in lines] or [np.empty((0, 3))])
    units = [unit_of(result.mechanism, name) for name in result.names]
    table: dict[str, Any] = {"curve": np.repeat(np.arange(len(lines)), [len(c) for c in lines])}
    table |= {f"{n} [{u}]": x for n, u, x in zip(result.names, units, drivers.T, strict=True)}
    table |= {f"{result.frame}.{x} [m]": p for x, p in zip("xyz", points.T, strict=True)}
    return table | {"why": np.array([w for c in lines for w in (*c.why, "")])}
