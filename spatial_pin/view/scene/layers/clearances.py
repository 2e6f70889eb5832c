"""How near links come to each other: a line between their nearest points, red where they touch."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from spatial_pin.errors import SpatialPinError
from spatial_pin.proximity.clearance import Clearance, PairClearance
from spatial_pin.view.scene.film import Reading, length_words, unit_of_length
from spatial_pin.view.scene.layers.bodies import body_items
from spatial_pin.view.scene.shapes import ball, rod
from spatial_pin.view.scene.stage import Entry, Item, Layer, Stage, Track, ball_at, rod_between

TOUCHING = (0.86, 0.08, 0.10, 1.0)
LINE = (0.10, 0.13, 0.17, 1.0)
CLEARANCE_BALL, CLEARANCE_ROD = 0.012, 0.005  # radius relative to the size of the scene
SWELL = 1.02  # red links are drawn over their own colours, so much larger
LINES = 1  # pairs that do not touch and are joined by a line: the nearest


def clearances(stage: Stage, found: Clearance) -> Layer:
    """Return links that touch in red, lines between nearest points, and what is to be said.

    Raises:
        SpatialPinError: it was found over another motion.
    """
    film = stage.film
    if len(found.motion) <= int(film.rows[-1]) or not np.array_equal(
            found.motion.q[film.rows], film.q):
        raise SpatialPinError(
            f"mechanism {film.mechanism.name!r}: the clearance is that of another motion than the "
            "one shown; ask sp.clearance of this one")
    touching = [pair for pair in found.pairs if pair.contacts]
    nearest = [pair for pair in found.pairs if not pair.contacts][:LINES]
    items = [*_red_links(stage, found, touching)]
    for pair in (*touching, *nearest):
        items += _line(stage, pair, TOUCHING if pair.contacts else LINE)
    legend = [Entry(TOUCHING, "links that touch")] * bool(touching)
    legend += [Entry(LINE, f"least over the motion, {_names(p)}: {length_words(p.distance)}")
               for p in nearest]
    alarms = tuple(_alarm(pair, found.tolerance, film.rows) for pair in touching)
    return Layer(tuple(items), np.zeros((0, 3)), tuple(legend), alarms)


def _names(pair: PairClearance) -> str:
    return " and ".join(pair.links)


def _alarm(pair: PairClearance, tolerance: float, rows: NDArray[np.intp]) -> Reading:
    """Return how deep two links overlap, sample by sample."""
    distances = pair.distances[rows]
    depth = np.where(distances <= tolerance, -distances, 0.0)
    size, unit = unit_of_length(float(np.abs(depth).max()) or 1.0)
    return Reading(_names(pair), depth / size, f" {unit}", 2, says=" overlap by ")


def _red_links(stage: Stage, found: Clearance, pairs: list[PairClearance]) -> list[Item]:
    """Return copies in red of links that touch, seen only as long as they do."""
    frames = stage.film.mechanism.model.frames
    rows = stage.film.rows
    is_red = {link: np.zeros(len(rows), dtype=bool) for pair in pairs for link in pair.links}
    for pair in pairs:
        for link in pair.links:
            is_red[link] |= pair.distances[rows] <= found.tolerance
    items = []
    for link, when in is_red.items():
        own = [v for v in stage.visuals if frames[v.parentFrame].name == link]
        for item in body_items(own, stage):
            items.append(Item(f"touching {link} {item.name}", item.solid, TOUCHING,
                              track=_moving(stage, item, when)))
    return items


def _moving(stage: Stage, item: Item, when: NDArray[np.bool_]) -> Track:
    """Return the track of a solid on its joint, of no size where it is not to be seen."""
    poses = stage.poses[:, item.joint]
    turns = Rotation.from_quat(poses[:, 3:])
    places = poses[:, :3] + turns.apply(item.placement[:3, 3])
    turned = (turns * Rotation.from_matrix(item.placement[:3, :3])).as_quat()
    scales = np.repeat(np.where(when, SWELL, 0.0)[:, None], 3, axis=1)
    return Track(np.concatenate([places, turned], axis=1), scales)


def _line(stage: Stage, pair: PairClearance, colour: tuple[float, ...]) -> list[Item]:
    """Return a line between the nearest points of two links, with a ball at either end."""
    a, b = (stage.seen(pair.points[stage.film.rows, k]) for k in (0, 1))
    name, size = f"clearance {_names(pair)}", stage.size
    return [
        Item(name, rod(CLEARANCE_ROD * size), colour, track=rod_between(a, b), through=True),
        *(Item(f"{name} {k}", ball(CLEARANCE_BALL * size), colour, track=ball_at(p), through=True)
          for k, p in enumerate((a, b), start=1)),
    ]
