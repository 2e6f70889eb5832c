"""The scalar equations of closures.

An equation is a sum of terms: a number times quantities. A quantity is a scalar product of vectors
that are fixed in two frames, the angle of one frame relative to another, a joint coordinate, a
parameter of a curve that other sums define, or a function of one of these. With d the vector from
origin i to origin j, u a vector fixed in frame i and w a vector fixed in frame j, the scalar
products are [Haug1989, 9.4]:

================  ==========  ====================================================
quantity          value       an equation of it
================  ==========  ====================================================
Displacement      u . d       origin j lies in the plane through origin i normal to u
Cosine            u . w       the angle between two directions is given
Square            d . d / 2L  the origins are L apart, or as far as two other frames
PointDistance     sqrt(d.d)   the lengths of several parts have a given sum
================  ==========  ====================================================

d, u and w are linear in the entries of oMi and oMj, so that value, Jacobian and higher rates of
every quantity come from one product rule (`kernel/core/equations.c`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.piecewise import Function

FIRST_TWO = (0, 1)  # the two frames of a closure that most quantities belong to


class Displacement(NamedTuple):
    """Component [m] of the vector between two origins along u (3,), in the axes of the first.

    Less an offset [m]; or along a direction in the axes of the second, `of_second`.
    """

    u: Array
    frames: tuple[int, int] = FIRST_TWO
    offset: float = 0.0
    of_second: bool = False


class Cosine(NamedTuple):
    """Scalar product of u (3,) in the axes of the first frame and w (3,) in those of the second."""

    u: Array
    w: Array
    frames: tuple[int, int] = FIRST_TWO


class Square(NamedTuple):
    """Squared distance of two origins over 2 `length` [m]; None: of the last two in the guess."""

    length: float | None
    frames: tuple[int, int] = FIRST_TWO


class Angle(NamedTuple):
    """Angle [rad] of the second frame relative to the first about their z axes, counting turns.

    Attributes:
        axes1: (3, 3) x, y, z in columns, in the axes of the first frame.
        axes2: (3, 3) the same in the axes of the second.
        frames: which.
    """

    axes1: Array
    axes2: Array
    frames: tuple[int, int] = FIRST_TWO


class Bearing(NamedTuple):
    """Angle [rad] at which the second frame's origin is seen from a point, counting turns.

    Attributes:
        axes: (3, 3) x, from which it counts, y, and z, about which it does, in the first frame.
        centre: (3,) the point, in the first frame [m].
        frames: which.
    """

    axes: Array
    centre: Array
    frames: tuple[int, int] = FIRST_TWO


class JointCoordinate(NamedTuple):
    """A joint coordinate [rad or m]: which of the closure's `joints`."""

    joint: int


@dataclass(frozen=True, eq=False)
class ImplicitParameters:
    """One or two numbers at which as many sums vanish, as where a point is nearest to a curve.

    They count turns, as angles do, and are near those of before; 0 stands for nothing before.

    Attributes:
        sums: of the parameters -> terms of as many sums, lengths or not; of one that is positive
            at a root that is wanted; and of one that is least there.
        spans: of each, where roots are looked for if there was nothing before.
        is_periodic: of each, whether it may be that many spans more.
    """

    sums: Callable[..., tuple[ConstraintEquation, ...]]
    spans: tuple[tuple[float, float], ...]
    is_periodic: tuple[bool, ...]

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameters."""
        return tuple(Parameter(self, k) for k in range(len(self.spans)))

    @cached_property
    def definition(self) -> tuple[ConstraintEquation, ...]:
        """The sums."""
        return self.sums(*self.parameters)


class Parameter(NamedTuple):
    """One of some parameters."""

    of: ImplicitParameters
    which: int


class FunctionOf(NamedTuple):
    """A function of another quantity."""

    function: Function
    argument: Angle | Bearing | JointCoordinate | Displacement | Parameter


class PointDistance(NamedTuple):
    """Distance [m] of two origins, which do not coincide."""

    frames: tuple[int, int] = FIRST_TWO


ScalarProduct = Displacement | Cosine | Square
Quantity = (ScalarProduct | Angle | Bearing | JointCoordinate | Parameter | FunctionOf
            | PointDistance)
Term = tuple[float, tuple[Quantity, ...]]


@dataclass(frozen=True, eq=False)
class ConstraintEquation:
    """One scalar closure equation: the sum of its terms is zero.

    Attributes:
        terms: a number and the quantities that it is multiplied by.
        is_length: whether the sum is a length [m] (to be divided by the characteristic length); of
            coordinates alone it has the unit of the first.
    """

    terms: tuple[Term, ...]
    is_length: bool = False


def combined(
    equations: Sequence[ConstraintEquation], weights: Sequence[float]
) -> ConstraintEquation:
    """Return the sum of equations, each times a weight; of equations that are no lengths in m."""
    terms = ((weight * number, factors) for equation, weight in zip(equations, weights, strict=True)
             for number, factors in equation.terms if weight)
    return ConstraintEquation(tuple(terms), is_length=True)


def linear_ratios(equation: ConstraintEquation) -> tuple[dict[int, float], float] | None:
    """Return ratio by joint, and offset, of a sum of joint coordinates; None of others."""
    ratios, offset = {}, 0.0
    for number, factors in equation.terms:
        if not factors:
            offset += number
        elif len(factors) == 1 and isinstance(factors[0], JointCoordinate):
            ratios[factors[0].joint] = number
        else:
            return None
    return ratios, offset
