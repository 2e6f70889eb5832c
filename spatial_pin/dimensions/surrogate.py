"""The geometry of a mechanism as a function of its dimensions, learnt from a few loads.

A xacro file computes lengths, places and directions from the dimensions by formulas of its own,
mostly sums and products, else smooth ones. Expanding it costs a thousand times what closing the
loops does. So the numbers are fitted by polynomials in the dimensions, each number in those
dimensions only that move it, of the least degree that gives it to round-off.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import combinations_with_replacement
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spatial_pin.dimensions.geometry import Geometry, geometry_of, kind_of
from spatial_pin.errors import SpatialPinError
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array, condition, least_squares

EXACT = 4e-15  # error of a fitted number, by the size of numbers of its kind
MOVED = 1e-15  # change of a number, likewise, that tells it depends on a dimension
CHECKS = 8  # samples at which the polynomials are checked and not fitted
HIGHEST = 6  # degree tried
MORE_POINTS = 1.3  # points of a fit by unknowns
WORST_SPREAD = 100.0  # condition of the products of dimensions at the points of a fit


class _Group(NamedTuple):
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
        degree: of the polynomials, at most.
        loads: number of mechanisms it was learnt from.
    """

    def __init__(self, nominal: Geometry, at: NDArray[np.intp], groups: list[_Group],
                 loads: int) -> None:
        self.nominal, self.at, self.loads = nominal, at, loads
        self.degree = max((int(g.powers.sum(axis=1).max()) for g in groups), default=0)
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
    return np.array([[c.count(k) for k in range(s)] for c in chosen], dtype=np.intp)


class _NotSmooth(Exception):
    """No polynomial within the budget gives the numbers."""


class _Learner:
    """Loads mechanisms at points of the dimensions (k,); numbers are by their sizes.

    Attributes:
        x: the points to fit through.
        loads: how many were loaded.
    """

    def __init__(
        self, mechanism: Mechanism, load: Callable[[Array], Mechanism], points: list[str],
        budget: int,
    ) -> None:
        self._load, self._points, self._budget = load, points, budget
        self._length = mechanism.characteristic_length
        self._kind = kind_of(mechanism, points)
        self.nominal = geometry_of(mechanism, points, self._length)
        self._base = self.nominal.numbers()
        self.sizes = np.maximum(self.nominal.sizes(self._length), 1e-300)
        self._rng = np.random.default_rng(1)
        self.x: list[Array] = []
        self._numbers: list[Array] = []
        self.loads = 0

    def numbers(self, x: Array) -> Array:
        """Return what the numbers at a point are more than the nominal ones."""
        self.loads += 1
        other = self._load(x)
        if kind_of(other, self._points) != self._kind:
            raise _NotSmooth
        found = geometry_of(other, self._points, self._length).numbers()
        return (found - self._base) / self.sizes

    def add(self, x: Array) -> Array:
        """Take a point to fit through; return its numbers."""
        self.x.append(x)
        self._numbers.append(self.numbers(x))
        return self._numbers[-1]

    def dependence(self, k: int) -> NDArray[np.bool_]:
        """Return (numbers, k): which number moves as a dimension goes from end to end."""
        base = 0.4 + 0.3 * np.cos(5.0 * np.arange(k))  # where no formula is likely to be special
        first = self.add(base)
        moves = [[self.add(np.where(np.arange(k) == i, end, base)) - first for end in (-1.0, 1.0)]
                 for i in range(k)]
        return np.array((np.abs(moves) > MOVED).any(axis=1)).T

    def group(
        self, numbers: NDArray[np.intp], at: NDArray[np.intp], of: NDArray[np.intp],
        checks: tuple[Array, Array],
    ) -> _Group:
        """Fit numbers `at` as polynomials in the dimensions `of` of the least degree that will do.

        Raises:
            _NotSmooth: there is none.
        """
        for degree in range(1, HIGHEST + 1):
            powers = _powers(len(of), degree)
            self._spread(powers, of)
            seen = np.array(self.x), np.array(self._numbers)
            (basis, known), (other, wanted) = ((_products(x[:, of].T, powers), y[:, at].T)
                                               for x, y in (seen, checks))
            coefficients = least_squares(basis.T, known.T).T
            error = max(np.abs(coefficients @ basis - known).max(),
                        np.abs(coefficients @ other - wanted).max())
            if error <= EXACT:
                return _Group(numbers, of, powers, coefficients * self.sizes[at, None])
        raise _NotSmooth

    def _spread(self, powers: NDArray[np.intp], of: NDArray[np.intp]) -> None:
        """Add points until there are enough for as many unknowns."""
        missing = math.ceil(MORE_POINTS * len(powers)) - len(self.x)
        while missing > 0 or condition(_products(np.array(self.x)[:, of].T, powers)) > WORST_SPREAD:
            if self.loads + max(missing, 1) > self._budget:
                raise _NotSmooth
            self.add(self._rng.uniform(-1.0, 1.0, len(self.x[0])))
            missing -= 1


def fit(
    mechanism: Mechanism, load: Callable[[Array], Mechanism], samples: Array,
    points: list[str], budget: int,
) -> FittedGeometry | None:
    """Fit the geometry over a cloud of dimensions.

    It is checked at samples, the farthest and some between, that the fit has not seen.

    Args:
        mechanism: at the nominal dimensions, which are 0.
        load: the mechanism at dimensions (k,).
        samples: (N, k) the cloud, from -1 to 1 in every dimension.
        points: as for `geometry_of`.
        budget: number of loads at most.

    Returns:
        The fit; None if the numbers are not that smooth, or the mechanism is not of one kind.
    """
    k = samples.shape[1]
    if 2 * k + 1 + CHECKS > min(budget, len(samples)):
        return None
    learner = _Learner(mechanism, load, points, budget)
    order = np.argsort(-np.square(samples).sum(axis=1), kind="stable")
    far = samples[np.r_[order[: CHECKS // 2], order[CHECKS // 2 :: len(order) // (CHECKS // 2)]]]
    try:
        checks = far, np.array([learner.numbers(x) for x in far])
        depends = learner.dependence(k)
        depends[(np.abs(checks[1]) > EXACT).any(axis=0) & ~depends.any(axis=1)] = True
        at = np.flatnonzero(depends.any(axis=1))
        groups = []
        for of in np.unique(depends[at], axis=0):
            members = np.flatnonzero((depends[at] == of).all(axis=1))
            groups.append(learner.group(members, at[members], np.flatnonzero(of), checks))
    except (SpatialPinError, _NotSmooth):
        return None
    return FittedGeometry(learner.nominal, at, groups, learner.loads)
