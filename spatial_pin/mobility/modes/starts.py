"""Random starts of the search for assembly modes, and the descent from them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from spatial_pin.kernel.closer import Closer
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.pairs import PAIRS
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES

BEYOND = 0.25  # part of the range of closed slides that starts go beyond it: modes not yet found
# Starts slide by up to so many characteristic lengths either way: links reach one, and the ground
# stands no farther than half of another from where its frame is drawn.
SLIDES = 1.5
# Steps of a start. Of random starts of `delta` 57 % close in 60 steps, 75 % in 120 and 240; of the
# Gough platform with forty modes 98.5 %, 99.75 % and as many.
ITERATIONS = 120
# starts closed together: few as the first may tell all, later ones many
FEWEST_TOGETHER, MOST_TOGETHER = 64, 512
LARGEST = 1 << 21  # numbers in their Jacobians: 16 MB


class Starts:
    """Configurations of a mechanism, drawn at random, and where descents from them end.

    Args:
        mechanism: the core of what is searched.
        held: its coordinates that are held [rad, m].

    Attributes:
        kernel: of the mechanism.
        free: (nv,) which velocities may close the loops.
    """

    def __init__(self, mechanism: Mechanism, held: Mapping[str, float]) -> None:
        self._mechanism, self._held = mechanism, held
        self._closer = Closer(mechanism)
        self.kernel = self._closer.kernel
        table, nv = mechanism.coordinate_table, mechanism.model.nv
        self.free = np.ones(nv, dtype=bool)
        self.free[[table[name].v for name in held]] = False
        self._most = int(np.clip(LARGEST // max(1, self.kernel.n_closure * nv), 1, MOST_TOGETHER))
        self._size = min(FEWEST_TOGETHER, self._most)
        self._slides = [at for c in table.values() if c.unit == "m" and c.name not in held
                        and (at := mechanism.place_of(c)) >= 0]
        self._low = np.full(len(self._slides), np.inf)
        self._high = -self._low

    def draw(self, rng: np.random.Generator, most: int) -> Array:
        """Return some more configurations (nq, m), `most` at most."""
        m = min(self._size, most) if self.free.any() else 1
        self._size = min(2 * self._size, self._most)
        starts = _random(self._mechanism, self._held, rng, m)
        if self._slides and np.isfinite(self._low).all():
            starts[self._slides, 1::2] = self._slides_near(rng, m // 2)
        return starts

    def descend(self, q: Array) -> tuple[Array, Array]:
        """Return configurations q (nq, m) with their loops closed, and residuals (m,)."""
        found, error = self._closer.descend(q.T, self.free, TOLERANCES.tight, ITERATIONS)
        return found.T, error

    def learn(self, closed: Array) -> None:
        """Learn from closed configurations (nq, m) where slides are."""
        ends = closed[self._slides]
        self._low = np.minimum(self._low, ends.min(axis=1, initial=np.inf))
        self._high = np.maximum(self._high, ends.max(axis=1, initial=-np.inf))

    def _slides_near(self, rng: np.random.Generator, m: int) -> Array:
        """Return slides (n, m) in the range of closed configurations, and a part of it beyond.

        Every other start has them: a mechanism may be small against its distance from the origin.
        """
        low, high = self._low, self._high
        beyond = BEYOND * (high - low)
        return rng.uniform((low - beyond)[:, None], (high + beyond)[:, None],
                           (len(self._slides), m))


def _random(
    mechanism: Mechanism, held: Mapping[str, float], rng: np.random.Generator, m: int
) -> Array:
    """Return configurations (nq, m) with angles and orientations uniform, slides about neutral."""
    model = mechanism.model
    q = np.repeat(np.array(mechanism.neutral)[:, None], m, axis=1)
    reach = rng.uniform(0.0, SLIDES * mechanism.characteristic_length, m)
    for c in mechanism.coordinate_table.values():
        if c.q >= 0:
            q[c.q] = rng.uniform(-1.0, 1.0, m) * (np.pi if c.unit == "rad" else reach)
    for i, name in enumerate(mechanism.pairs, start=1):
        if not PAIRS[name].is_linear:
            at, n = model.idx_qs[i], model.nqs[i]
            quaternion = rng.normal(size=(4, m))
            q[at + n - 4 : at + n] = quaternion / np.linalg.norm(quaternion, axis=0)
            if n == 7:
                q[at : at + 3] = rng.uniform(-1.0, 1.0, (3, m)) * reach
    for name, value in held.items():
        q[mechanism.coordinate_table[name].q] = value
    return q
