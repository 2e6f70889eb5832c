"""The scalar equations that closures are made of.

With frames 1 and 2 at oM1 and oM2, let d be the vector from origin 1 to origin 2, u a vector
fixed in frame 1 and w a vector fixed in frame 2. Every primitive is a scalar product of two such
vectors [Haug1989, 9.4]:

==========  ======================  ============================================
primitive   equation                meaning
==========  ======================  ============================================
point       u . d = 0               origin 2 lies in the plane through 1 normal to u
dot         u . w = c               angle between two directions
distance    (d . d - L^2) / 2L = 0  origins are L apart, or as far as two other frames
screw       u . d = pitch * angle   slide along u proportional to the turn about u
==========  ======================  ============================================

d, u and w are linear in the entries of oM1 and oM2, so that value, Jacobian and higher rates of
every primitive come from one product rule (`spatial_pin.constraints.closure_equations`). The screw
adds the relative angle of two directions, a function of two dot products.
"""

from __future__ import annotations

from dataclasses import dataclass

from spatial_pin.numerics.linalg import Array


@dataclass(frozen=True, eq=False)
class ConstraintEquation:
    """One scalar closure equation.

    Attributes:
        u: (3,) vector in the axes of frame 1; None for a distance.
        w: (3,) vector in the axes of frame 2; None where the second factor is d.
        offset: the constant c of a dot equation, or the length L of a distance equation [m].
        pitch: slide per radian of a screw equation [m/rad], else None.
        angle_from: (2, 3) for a screw equation: the directions in frame 1 (x then y, normal to u)
            against which the direction `angle_of` (3,) of frame 2 is measured.
        angle_of: see `angle_from`.
        kind: in the table `spatial_pin.constraints.kinds`.
    """

    u: Array | None = None
    w: Array | None = None
    offset: float = 0.0
    pitch: float | None = None
    angle_from: Array | None = None
    angle_of: Array | None = None
    kind: str = "product"

    @property
    def is_length(self) -> bool:
        """Whether the value is a length (to be divided by the characteristic length)."""
        return self.w is None


def point(u: Array) -> ConstraintEquation:
    """Return the equation u . d = 0."""
    return ConstraintEquation(u=u)


def dot(u: Array, w: Array, cosine: float = 0.0) -> ConstraintEquation:
    """Return the equation u . w = cosine."""
    return ConstraintEquation(u=u, w=w, offset=cosine)


def distance(length: float) -> ConstraintEquation:
    """Return the equation |d| = length [m]."""
    return ConstraintEquation(offset=length)


def screw(axes1: Array, axes2: Array, pitch: float) -> ConstraintEquation:
    """Return the equation slide = pitch [m/rad] * angle about z; `axes` (3, 3) hold x, y, z."""
    return ConstraintEquation(u=axes1[:, 2], pitch=pitch, angle_from=axes1[:, :2].T,
                              angle_of=axes2[:, 0], kind="screw")
