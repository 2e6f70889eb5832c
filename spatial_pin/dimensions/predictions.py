"""What a mechanism of other dimensions, offsets and base would have measured, and its derivatives.

At a closed configuration q of dimensions p the loops c(q, p) = 0 and the drivers stay what they
are, so that dq/dp = -A^-1 dc/dp, with A the rows of the loops and drivers. What depends on p at the
same q, the rows c and the frames, is differenced: nothing is closed for that.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.assembly.holding import still_entries
from spatial_pin.assembly.state import State
from spatial_pin.constraints.closure_equations import Evaluation, evaluation_of
from spatial_pin.dimensions.homotopy import followed
from spatial_pin.dimensions.measurements import Encoder, Quantity
from spatial_pin.dimensions.variants import Variants
from spatial_pin.errors import SpatialPinError
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import EPS, Array, Decomposition, decompose
from spatial_pin.numerics.tolerances import TOLERANCES

# Part of a dimension's size: second-order differences leave its square, round-off eps over it.
STEP = EPS ** (1.0 / 3.0)
BASE = ("base.x", "base.y", "base.z", "base.rx", "base.ry", "base.rz")


class Unknowns(NamedTuple):
    """What is looked for.

    Attributes:
        dimensions: names.
        offsets: drivers; what their encoders read lacks these.
        has_base: whether the base is one, by six numbers.
        encoders: that read with an error, of which each pose has its own: these are found too, as
            numbers behind the others, but have no name.
    """

    dimensions: tuple[str, ...]
    offsets: tuple[str, ...]
    has_base: bool
    encoders: tuple[Encoder, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the numbers, in their order."""
        return (*self.dimensions, *(f"{name}.offset" for name in self.offsets),
                *(BASE if self.has_base else ()))


class Situation(NamedTuple):
    """A mechanism at some values of the unknowns.

    Attributes:
        mechanism: at its dimensions.
        states: closed, by pose.
        base: of the mechanism in the axes of what measures; None where these are its own.
    """

    mechanism: Mechanism
    states: list[State]
    base: pin.SE3 | None


class Predictions:
    """Errors of the model at values x (n,) of the unknowns, and their derivatives.

    The unknowns have no unit: x is how far they are from where they start, relative to `sizes`.

    Args:
        start: where the search begins.
        unknowns: what is looked for.
        drivers: by coordinate, what the encoders read at each pose.
        quantities: what was measured at each pose.

    Attributes:
        sizes: (n,) of the unknowns [m or rad].
        sigmas: (m,) standard deviations of the numbers measured, those of encoders last.
    """

    def __init__(
        self, start: Situation, unknowns: Unknowns, drivers: Sequence[Mapping[str, float]],
        quantities: Sequence[Sequence[Quantity]],
    ) -> None:
        self._start, self.unknowns, self._drivers = start, unknowns, drivers
        self._quantities, m = quantities, start.mechanism
        self._coordinates = [m.driven_coordinate(name) for name in unknowns.offsets]
        self._variants = Variants(m, unknowns.dimensions)
        self._near = start
        self._last: tuple[bytes, Situation] | None = None
        length = m.characteristic_length
        own = self.nominal = np.array([m.dimensions[name] for name in unknowns.dimensions])
        # a dimension may be a length or an angle, and be zero
        sizes = [*np.maximum(np.abs(own), min(length, 1.0)),
                 *(m.velocity_scale[c.v] for c in self._coordinates),
                 *([length] * 3 + [1.0] * 3 if unknowns.has_base else [])]
        read = [encoder.sigma for encoder in unknowns.encoders]
        self.sizes = np.array([*sizes, *read])
        self.sigmas = np.array(
            [*(q.sigma for some in quantities for q in some for _ in q.labels()), *read])
        self._base = slice(len(sizes) - 6, len(sizes))

    # ------------------------------------------------------------ values

    def at(self, x: Array) -> Situation:
        """Return the mechanism at values of the unknowns, its loops closed at every pose.

        Raises:
            SpatialPinError: they do not close, on the branch that they begin on.
        """
        if self._last is None or self._last[0] != x.tobytes():
            self._last = x.tobytes(), self._made(x)
        return self._last[1]

    def _made(self, x: Array) -> Situation:
        near, dimensions = self._near, self.dimensions_at(x)
        there = self._variants.at(dimensions) if dimensions else near.mechanism
        states = [followed(there, held, state)
                  for held, state in zip(self.held(x), near.states, strict=True)]
        return Situation(there, states, self.base_at(x))

    def held(self, x: Array) -> list[dict[str, float]]:
        """Return where the drivers are at each pose, by coordinate [rad or m]."""
        offsets = self.offsets_at(x)
        found = [{name: value + offsets.get(name, 0.0) for name, value in read.items()}
                 for read in self._drivers]
        for encoder, off in zip(self.unknowns.encoders, self._misread(x), strict=True):
            found[encoder.pose][encoder.coordinate] += encoder.sigma * off
        return found

    def _misread(self, x: Array) -> Array:
        """Return by how much encoders have read too little [sigma]."""
        return x[len(x) - len(self.unknowns.encoders) :]

    def dimensions_at(self, x: Array) -> dict[str, float]:
        """Return the dimensions at values of the unknowns."""
        k = len(self.nominal)
        return dict(zip(self.unknowns.dimensions,
                        (self.nominal + self.sizes[:k] * x[:k]).tolist(), strict=True))

    def offsets_at(self, x: Array) -> dict[str, float]:
        """Return the offsets by coordinate likewise."""
        some = slice(len(self.nominal), len(self.nominal) + len(self._coordinates))
        return dict(zip((c.name for c in self._coordinates),
                        (self.sizes[some] * x[some]).tolist(), strict=True))

    def base_at(self, x: Array) -> pin.SE3 | None:
        """Return the base likewise."""
        if self._start.base is None:
            return None
        if not self.unknowns.has_base:
            return self._start.base
        moved, start = self.sizes[self._base] * x[self._base], self._start.base
        return pin.SE3(pin.exp3(moved[3:]) @ start.rotation, start.translation + moved[:3])

    def errors(self, x: Array) -> Array:
        """Return model less measurements (m,), in standard deviations; infinite where it opens."""
        try:
            here = self.at(x)
        except SpatialPinError:
            return np.full(len(self.sigmas), np.inf)  # SciPy's trust region shrinks then
        parts = []
        for state, quantities in zip(here.states, self._quantities, strict=True):
            with evaluation_of(here.mechanism, state.angles) as evaluation:
                evaluation.update(state.q)
                parts += [q.error(evaluation, here.base)[0] for q in quantities]
        told = np.concatenate(parts)
        return np.concatenate([told / self.sigmas[: len(told)], self._misread(x)])

    # ------------------------------------------------------------ derivatives

    def jacobian(self, x: Array) -> Array:
        """Return the derivatives (m, n) of `errors` for x; raises as `slopes`."""
        found = self.slopes(x)
        if self.unknowns.has_base:  # of exp(w) for w: the turn that is added, from the left
            turns = slice(self._base.stop - 3, self._base.stop)
            found[:, turns] = found[:, turns] @ pin.Jexp3(x[turns]).T
        return found

    def slopes(self, x: Array) -> Array:
        """Return the derivatives (m, n) of `errors` for x, but for small turns of the base.

        Raises:
            SpatialPinError: the drivers do not determine what was measured, or a dimension opens
                the loops.
        """
        here = self._near = self.at(x)
        changes = [self._changes(here, name) for name in self.unknowns.dimensions]
        rows = []
        for i, state in enumerate(here.states):
            with evaluation_of(here.mechanism, state.angles) as evaluation:
                evaluation.update(state.q)
                rows.append(self._pose_rows(i, evaluation, here, [c[i] for c in changes]))
        k = len(self.unknowns.encoders)
        told = np.concatenate(rows) * self.sizes / self.sigmas[: len(self.sigmas) - k, None]
        return np.vstack([told, np.eye(k, len(self.sizes), len(self.sizes) - k)])

    def _changes(self, here: Situation, name: str) -> list[tuple[Array, Array]]:
        """Return by pose the derivatives for a dimension, q being the same.

        Those of the loops' rows, then those of the errors.
        """
        value = here.mechanism.dimensions[name]
        h = STEP * self.sizes[self.unknowns.dimensions.index(name)]
        own = {k: here.mechanism.dimensions[k] for k in self.unknowns.dimensions}
        ends = (float(value + h), float(value - h))
        both = self._variants.several([{**own, name: end} for end in ends])
        found = list[tuple[Array, Array]]()
        for i, state in enumerate(here.states):
            ahead, behind = (self._at_rest(there, state, i, here.base) for there in both)
            wide = ends[0] - ends[1]
            found.append(((ahead[0] - behind[0]) / wide, (ahead[1] - behind[1]) / wide))
        return found

    def _at_rest(
        self, there: Mechanism, state: State, i: int, base: pin.SE3 | None
    ) -> tuple[Array, Array]:
        """Return the loops' rows and the errors of a pose, where no joint has moved."""
        with evaluation_of(there, state.angles) as evaluation:
            evaluation.update(state.q)
            return (evaluation.residual.copy(), np.concatenate(
                [q.error(evaluation, base)[0] for q in self._quantities[i]]))

    def _pose_rows(
        self, i: int, evaluation: Evaluation, here: Situation,
        changes: Sequence[tuple[Array, Array]],
    ) -> Array:
        """Return the derivatives (k, n) of a pose's errors [m, rad] per unit of the unknowns."""
        m, n = here.mechanism, evaluation.constraints.n_closure
        held = [m.driven_coordinate(name) for name in self._drivers[i]]
        stands = [*(c.v for c in held), *still_entries(m, held)]
        svd = decompose(np.vstack([evaluation.jacobian[:n], np.eye(m.model.nv)[stands]]))
        errors = [q.error(evaluation, here.base) for q in self._quantities[i]]
        slopes = np.vstack([s for _, s in errors]) * m.velocity_scale
        self._check_determined(i, svd, slopes)
        columns = [own + slopes @ self._motion(svd, -rows, name, len(stands))
                   for name, (rows, own) in zip(self.unknowns.dimensions, changes, strict=True)]
        driven = np.eye(n + len(stands))[n : n + len(held)]
        of = {c.name: slopes @ svd.minimum_norm(row / m.velocity_scale[c.v])
              for c, row in zip(held, driven, strict=True)}
        still = np.zeros(len(slopes))
        columns += [of.get(c.name, still) for c in self._coordinates]
        found = np.array(columns).reshape(len(columns), len(slopes)).T
        base = [np.vstack([q.base_slope(evaluation, here.base) for q in self._quantities[i]])
                ] if self.unknowns.has_base and here.base is not None else []
        read = np.array([of[e.coordinate] if e.pose == i else still
                         for e in self.unknowns.encoders]).reshape(-1, len(slopes)).T
        return np.hstack([found, *base, read])

    def _motion(self, svd: Decomposition, opened: Array, name: str, n_still: int) -> Array:
        """Return how the joints go (nv,) to keep the loops closed."""
        wanted = np.concatenate([opened, np.zeros(n_still)])
        found = svd.minimum_norm(wanted)
        kept = svd.u[:, : svd.rank]
        left = wanted - kept @ (kept.T @ wanted)
        if np.linalg.norm(left) > TOLERANCES.half_precision * max(
                1.0, float(np.linalg.norm(wanted))):
            raise SpatialPinError(
                f"mechanism {self._start.mechanism.name!r}: the loops open where {name!r} alone is "
                "changed (they are overconstrained); calibrate a dimension that keeps them closed")
        return found

    def _check_determined(self, i: int, svd: Decomposition, slopes: Array) -> None:
        """Refuse what the drivers leave free."""
        free = np.abs(slopes @ svd.null_space.T).max(axis=1, initial=0.0)
        if free.max(initial=0.0) > TOLERANCES.half_precision * np.abs(slopes).max(initial=0.0):
            labels = [label for q in self._quantities[i] for label in q.labels()]
            raise SpatialPinError(
                f"measurement {i + 1}: {labels[int(np.argmax(free))]!r} can move where the drivers "
                "given stand; give values of drivers or coordinates that hold it, or leave it out")
