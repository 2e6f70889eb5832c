"""What a mechanism is to the closure equations: some numbers, and those as functions of dimensions.

A xacro file computes lengths, places and directions from the dimensions by formulas of its own,
mostly sums and products, else smooth ones. Expanding it costs a thousand times what closing the
loops does. So the numbers are fitted by polynomials in the dimensions, each number in those
dimensions only that move it, of the least degree that gives it to round-off.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import combinations_with_replacement
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin.errors import SpatialPinError
from spatial_pin.kinematics.assembly import periodic
from spatial_pin.kinematics.batch import Batch
from spatial_pin.kinematics.constraints import Constraints, constraints_of
from spatial_pin.kinematics.flat import FlatJoint, flat_tree_of
from spatial_pin.kinematics.state import center_of_mass
from spatial_pin.kinematics.varying import varying
from spatial_pin.linalg import Array
from spatial_pin.mechanism.mechanism import Mechanism

EXACT = 4e-15  # error of a fitted number, by the size of numbers of its kind
MOVED = 1e-15  # change of a number, likewise, that tells it depends on a dimension
NO_LIMIT = 1e300  # [rad]
CHECKS = 8  # samples at which the polynomials are checked and not fitted
HIGHEST = 6  # degree tried
MORE_POINTS = 1.3  # points of a fit by unknowns
LEAST_SPREAD = 1e-2  # of singular values of the powers of dimensions at the points of a fit


class Geometry(NamedTuple):
    """The numbers that closure equations and outputs are made of, of one or of m mechanisms.

    Lengths are in m; the rows that measure a length are divided by a characteristic length which
    is the same for all.

    Attributes:
        joints: of the flat tree.
        coefficients: of `Batch`.
        constants: (r, 1) of `Batch`.
        points: (F, 3) all frames in the neutral configuration.
        offsets: (f, 3) points whose motion is asked for, in the axes of the joints `carriers`.
        limits: (2, n, 1) lower and upper limits of angles that count turns.
    """

    joints: list[FlatJoint]
    coefficients: Any
    constants: Any
    points: Any
    offsets: Any
    limits: Any

    def numbers(self) -> Array:
        """Return all numbers of one mechanism as one vector."""
        return np.concatenate([np.ravel(part) for part in self._parts()])

    def _parts(self) -> list[Any]:
        parts = [x for j in self.joints for x in (j.turned, j.offset, j.axis, j.pitch)]
        return [*parts, *self[1:]]

    def sizes(self, length: float) -> Array:
        """Return the size of numbers of each one's kind: `length` for lengths, 1 for directions."""
        joints = [np.full(np.size(x), size) for j in self.joints
                  for x, size in ((j.turned, 1.0), (j.offset, length), (j.axis, 1.0),
                                  (j.pitch, length))]
        rows = self.coefficients.reshape(len(self.coefficients), -1, 4)
        flags = np.abs(rows[:, :, 3]).max(axis=1, initial=0.0)
        size = np.where(flags > 0.0, flags * length, np.abs(rows).max(axis=(1, 2), initial=0.0))
        rest = [np.full(np.size(x), s) for x, s in (
            (self.constants, 1.0), (self.points, length), (self.offsets, length),
            (self.limits, 1.0))]
        return np.concatenate([*joints, np.repeat(size, self.coefficients.shape[1]), *rest])

    def with_numbers(self, at: NDArray[np.intp], values: Array) -> Geometry:
        """Return the geometry of m mechanisms that differ in the numbers `at`, (len(at), m)."""
        parts, begin = [], 0
        for part in self._parts():
            end = begin + np.size(part)
            own = slice(*np.searchsorted(at, (begin, end)))
            places = tuple(int(k) for k in at[own] - begin)
            if np.ndim(part):
                parts.append(varying(part, places, values[own]))
            else:
                parts.append(values[own][0] if places else part)
            begin = end
        joints = [j._replace(**dict(zip(("turned", "offset", "axis", "pitch"),
                                        parts[4 * k : 4 * k + 4], strict=True)))
                  for k, j in enumerate(self.joints)]
        return Geometry(joints, *parts[4 * len(joints) :])


def is_length(constraints: Constraints) -> NDArray[np.bool_]:
    """Return (n_rows,) which closure rows are divided by the characteristic length."""
    mechanism = constraints.mechanism
    rows = [row.is_length for closure in mechanism.closures for row in closure.rows]
    coupled = [mechanism.coordinate(c.joints[1]).unit == "m" for c in constraints.couplings]
    return np.array([*rows, *coupled], dtype=bool)


def geometry_of(mechanism: Mechanism, points: Iterable[str], length: float) -> Geometry:
    """Return the geometry of one mechanism.

    Args:
        mechanism: the mechanism.
        points: links, frames or joints, or `LINK.com`, whose motion is asked for.
        length: characteristic length by which rows are divided.
    """
    constraints = constraints_of(mechanism)
    batch, n = Batch(constraints), len(constraints.constants)
    coefficients, constants = batch.coefficients.copy(), constraints.constants.copy()
    rows = np.flatnonzero(is_length(constraints)[: constraints.n_products])
    ratio = mechanism.characteristic_length / length
    coefficients[n + rows] *= ratio
    constants[rows] *= ratio
    model = mechanism.model
    neutral = batch.tree.place(mechanism.neutral[:, None])[batch.tree.carrier, :, :3, 0]
    places = [neutral[f.parentJoint, 3] + f.placement.translation @ neutral[f.parentJoint, :3]
              for f in model.frames]
    at = [c.q for c in periodic(mechanism)]
    bounds = np.array([model.lowerPositionLimit[at], model.upperPositionLimit[at]])
    return Geometry(
        flat_tree_of(mechanism).joints, coefficients, constants[:, None], np.array(places),
        np.array([_on_joint(mechanism, name)[1] for name in points]).reshape(-1, 3),
        np.clip(bounds, -NO_LIMIT, NO_LIMIT)[:, :, None],
    )


def _on_joint(mechanism: Mechanism, name: str) -> tuple[int, Array]:
    """Return the joint that carries a point and its place in the joint's axes [m]."""
    joint, placement = mechanism.frame_on_joint(name.removesuffix(".com"))
    if not name.endswith(".com"):
        return joint, placement.translation
    return joint, placement.act(center_of_mass(mechanism, name.removesuffix(".com")))


def carriers(mechanism: Mechanism, points: Iterable[str]) -> list[int]:
    """Return the joints that carry the points of `geometry_of`."""
    return [_on_joint(mechanism, name)[0] for name in points]


def kind_of(mechanism: Mechanism, points: Iterable[str]) -> tuple[Any, ...]:
    """Return all of a mechanism that must be alike for its geometry to be compared: no numbers."""
    c, model = constraints_of(mechanism), mechanism.model
    joints = flat_tree_of(mechanism).joints
    return (
        tuple((j.kind, j.parent, j.q, j.v) for j in joints), tuple(model.names),
        tuple(f.parentJoint for f in model.frames), tuple(carriers(mechanism, points)),
        c.labels, tuple(c.screws and [(at, sine) for at, sine, _ in c.screws]), c.c_abx.shape,
        tuple(Batch(c).bodies.tolist()), tuple(c.factors.flat),
        tuple((x.joints, x.ratio, x.offset) for x in c.couplings),
    )


# ---------------------------------------------------------------- fitted


@dataclass(frozen=True, eq=False)
class _Group:
    """Numbers that depend on the same dimensions.

    Attributes:
        numbers: their places among those that vary.
        of: the dimensions.
        powers: (T, len(of)) degrees of the products of Chebyshev polynomials.
        coefficients: (len(numbers), T).
    """

    numbers: NDArray[np.intp]
    of: NDArray[np.intp]
    powers: NDArray[np.intp]
    coefficients: Array


class FittedGeometry:
    """The geometry of a mechanism as polynomials in some of its dimensions.

    Attributes:
        nominal: at the nominal dimensions.
        at: places of the numbers that vary.
        loads: number of mechanisms it was learnt from.
    """

    def __init__(self, nominal: Geometry, at: NDArray[np.intp], groups: list[_Group],
                 loads: int) -> None:
        self.nominal, self.at, self.loads = nominal, at, loads
        self._groups = groups
        self._base = nominal.numbers()[at]

    def __call__(self, x: Array) -> Geometry:
        """Return the geometry of m mechanisms, dimensions (k, m) within -1 to 1 of the fit."""
        values = np.empty((len(self.at), x.shape[1]))
        for group in self._groups:
            values[group.numbers] = group.coefficients @ _products(x[group.of], group.powers)
        return self.nominal.with_numbers(self.at, values + self._base[:, None])


def _products(x: Array, powers: NDArray[np.intp]) -> Array:
    """Return products (T, m) of Chebyshev polynomials of x (s, m)."""
    table = np.polynomial.chebyshev.chebvander(x, int(powers.max(initial=0)))
    out = np.ones((len(powers), x.shape[1]))
    for k, degrees in enumerate(powers.T):
        out *= table[k].T[degrees]
    return out


def _powers(s: int, degree: int) -> NDArray[np.intp]:
    """Return (T, s) the degrees in s variables of all products of at most a total degree."""
    chosen = [c for d in range(degree + 1) for c in combinations_with_replacement(range(s), d)]
    return np.array([[c.count(k) for k in range(s)] for c in chosen], dtype=np.intp).reshape(-1, s)


class _Learner:
    """Mechanisms at some points of the dimensions, as differences from the nominal one."""

    def __init__(self, nominal: Array, sizes: Array, load: Callable[[Array], Array]) -> None:
        self._nominal, self._sizes, self._load = nominal, sizes, load
        self.x: list[Array] = []
        self._numbers: list[Array] = []

    def add(self, x: Array) -> Array:
        """Load a point (k,) and return its numbers."""
        self.x.append(x)
        self._numbers.append((self._load(x) - self._nominal) / self._sizes)
        return self._numbers[-1]

    @property
    def numbers(self) -> Array:
        """(points, numbers) by their sizes."""
        return np.array(self._numbers)


def fit(
    mechanism: Mechanism, load: Callable[[Array], Mechanism], samples: Array,
    points: list[str], budget: int,
) -> FittedGeometry | None:
    """Fit the geometry over a cloud of dimensions.

    A number depends on the dimensions that move it when one goes from end to end of its range, the
    others standing anywhere. It is checked at samples far out and in between that the fit has not
    seen.

    Args:
        mechanism: at the nominal dimensions, which are 0.
        load: the mechanism at dimensions (k,).
        samples: (N, k) the cloud, from -1 to 1 in every dimension.
        points: as for `geometry_of`.
        budget: number of loads at most.

    Returns:
        The fit; None if the numbers are not that smooth, or the mechanism is not of one kind.
    """
    k, length = samples.shape[1], mechanism.characteristic_length
    kind, nominal = kind_of(mechanism, points), geometry_of(mechanism, points, length)
    sizes = np.maximum(nominal.sizes(length), 1e-300)

    def numbers(x: Array) -> Array:
        other = load(x)
        if kind_of(other, points) != kind:
            raise SpatialPinError("of another kind")
        return geometry_of(other, points, length).numbers()

    if 2 * k + 1 + CHECKS > budget:
        return None
    learner = _Learner(nominal.numbers(), sizes, numbers)
    order = np.argsort(-np.square(samples).sum(axis=1), kind="stable")
    checks = [*order[: CHECKS // 2], *order[CHECKS // 2 :: len(order) // (CHECKS // 2)]][:CHECKS]
    rng = np.random.default_rng(1)
    try:
        base = np.array([0.4 + 0.3 * np.cos(5.0 * i) for i in range(k)])
        first = learner.add(base)
        moves = np.array([[learner.add(np.where(np.arange(k) == i, end, base)) - first
                           for end in (-1.0, 1.0)] for i in range(k)])
        wanted = [learner.add(samples[i]) for i in checks]
        fixed = len(learner.x)
        depends = (np.abs(moves) > MOVED).any(axis=1).T  # (numbers, k)
        at = np.flatnonzero(depends.any(axis=1) | (np.abs(learner.numbers) > EXACT).any(axis=0))
        fitting = list(range(fixed - CHECKS))
        sets: dict[bytes, list[int]] = {}
        for i, row in enumerate(depends[at]):
            sets.setdefault(row.tobytes(), []).append(i)
        groups = []
        for members in sets.values():
            found = _group(learner, at, np.array(members), np.flatnonzero(depends[at[members[0]]]),
                           fitting, samples[checks].T, np.array(wanted)[:, at], rng, budget)
            if found is None:
                return None
            groups.append(found)
    except SpatialPinError:
        return None
    scaled = [g.__class__(g.numbers, g.of, g.powers,
                          g.coefficients * sizes[at[g.numbers], None]) for g in groups]
    return FittedGeometry(nominal, at, scaled, len(learner.x))


def _group(
    learner: _Learner, at: NDArray[np.intp], members: NDArray[np.intp], of: NDArray[np.intp],
    fitting: list[int], checks: Array, wanted: Array, rng: np.random.Generator, budget: int,
) -> _Group | None:
    """Fit some numbers by polynomials of the least degree that will do, None if there is none."""
    for degree in range(1, HIGHEST + 1):
        powers = _powers(len(of), degree)
        while True:
            x = np.array([learner.x[i] for i in fitting])
            basis = _products(x[:, of].T, powers)
            spread = np.linalg.norm(basis, 2), np.linalg.norm(basis, -2)
            if len(fitting) >= MORE_POINTS * len(powers) and spread[1] > LEAST_SPREAD * spread[0]:
                break
            if len(learner.x) >= budget:
                return None
            fitting.append(len(learner.x))
            learner.add(rng.uniform(-1.0, 1.0, len(checks)))
        known = learner.numbers[fitting][:, at[members]]
        coefficients = np.linalg.lstsq(basis.T, known, rcond=None)[0].T
        errors = [np.abs(coefficients @ _products(part[of], powers) - goal.T).max()
                  for part, goal in ((x.T, known), (checks, wanted[:, members]))]
        if max(errors) <= EXACT:
            return _Group(members, of, powers, coefficients)
    return None
