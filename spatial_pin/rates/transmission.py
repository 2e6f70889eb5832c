"""Transmission of a mechanism: speed ratio, mechanical advantage, transmission angle."""

from __future__ import annotations

from typing import TYPE_CHECKING, Generic, NamedTuple, TypeVar, overload

import numpy as np

from spatial_pin._support.brief import brief
from spatial_pin._support.checks import checked
from spatial_pin.assembly.close import scaled_row
from spatial_pin.assembly.holding import BASE, Hold
from spatial_pin.assembly.state import PIECE, State, angles_of, samples_of
from spatial_pin.errors import SpatialPinError, UnknownNameError
from spatial_pin.kernel.kernel import kernel_of
from spatial_pin.kernel.loop_equations import twist_derivatives
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Coordinate
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.stacked import cross, padded_null_spaces, padded_row_spaces
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.rates.depending import solved_for_entries
from spatial_pin.rates.prescribed import Prescription, driven_coordinates, solved_by
from spatial_pin.rates.rates import check_not_held

if TYPE_CHECKING:
    import spatial_pin as sp


Number = TypeVar("Number", bound=float | Array)  # of a State; (N,) of a Motion


class Transmission(NamedTuple, Generic[Number]):
    """How a driver moves an output at one configuration; of a Motion with arrays (N,).

    Attributes:
        ratio: output speed per driver speed [in their units].
        mechanical_advantage: output effort per driver effort without losses [in their units],
            1/ratio; infinite at a dead centre of the output.
        angle: transmission angle, 0 to pi/2 [rad]; 0 where the driver cannot move the output.
        at: where it is taken: the pair that the output link is moved at.

    Example:
        >>> mech = sp.load("four_bar")
        >>> found = sp.transmission(mech, sp.assemble(mech, {"crank": 1.0}), "rocker_pin")
        >>> print(f"{np.degrees(found.angle):.1f}° at {found.at}")
        59.4° at output_pin
        >>> abs(found.ratio * found.mechanical_advantage - 1.0) < 1e-12
        True
    """

    ratio: Number
    mechanical_advantage: Number
    angle: Number
    at: str

    def __repr__(self) -> str:
        return brief(self, angle="rad")


@overload
def transmission(
    mechanism: Mechanism, state: State, output: str, driver: str | None = None,
    at: str | None = None, *, hold: Hold = BASE,
) -> Transmission[float]: ...


@overload
def transmission(
    mechanism: Mechanism, state: sp.Motion, output: str, driver: str | None = None,
    at: str | None = None, *, hold: Hold = BASE,
) -> Transmission[Array]: ...


@checked
def transmission(
    mechanism: Mechanism, state: State | sp.Motion, output: str, driver: str | None = None,
    at: str | None = None, *, hold: Hold = BASE,
) -> Transmission[float] | Transmission[Array]:
    """Return speed ratio, mechanical advantage and transmission angle of an output.

    The transmission angle is the angle between two velocities of the point `at` of the output link:
    the velocity that the output can have there, and the velocity that the coupler could have if the
    output were disconnected and all drivers were locked. Forces at the point are normal to the
    second, so the sine of the angle is their working part. It is the angle between coupler and
    rocker of a four-bar, and the complement of the pressure angle of a slider-crank or cam
    [Hain1967, ch. 2]. If the point does not move (Hooke's joint), angular velocities are used
    instead.

    Args:
        mechanism: the mechanism.
        state: a closed configuration; or a Motion, for all its samples at a time.
        output: coordinate of a one-freedom joint of the tree.
        driver: the driver or coordinate that moves it; the only driver if not given.
        at: closure or joint that moves the output link; needed where there are several.
        hold: names of joints that stand still besides the other drivers, as for `solve_rates`.

    Returns:
        The Transmission: ratio, mechanical advantage, angle [rad]; of a Motion arrays (N,).

    Raises:
        UnknownNameError: a name does not exist.
        SpatialPinError: the output's link is moved at several pairs, or at none.
        SingularError: the drivers do not determine the velocities there, or at a sample.

    Example:
        >>> mech = sp.load("four_bar")
        >>> found = sp.transmission(mech, sp.assemble(mech, {"crank": 1.0}), "rocker_pin")
        >>> print(f"ratio {found.ratio:.4f}, {np.degrees(found.angle):.1f}° at {found.at}")
        ratio 0.1935, 59.4° at output_pin
        >>> motion = sp.sweep(mech, "crank", np.linspace(0.0, 6.28, 181))
        >>> angles = sp.transmission(mech, motion, "rocker_pin").angle  # (N,)
        >>> print(f"at least {np.degrees(angles.min()):.1f}°")
        at least 44.4°
    """
    samples = samples_of(mechanism, state)
    mechanism = samples.mechanism
    if driver is None:
        names = list(mechanism.drivers)
        if len(names) != 1:
            raise SpatialPinError(f"mechanism {mechanism.name!r} has {len(names)} drivers; say "
                                  f"which one moves the output: {', '.join(names)}")
        driver = names[0]
    input_ = mechanism.driven_coordinate(driver)
    check_not_held(mechanism, [input_], hold)
    moved = MovedOutput.of(mechanism, output, input_.name, at, hold)
    given, at_output = moved.given, mechanism.driven_coordinate(output).v
    column = [c.name for c in given.driven].index(input_.name)

    ratio = solved_by(samples, given, ("columns",), lambda at, _: solved_for_entries(
        at, given, (at_output,), "columns"))[0][..., at_output, column].copy()
    with np.errstate(divide="ignore"):
        advantage = 1.0 / ratio
    if isinstance(samples, State):
        angle = moved.angle(mechanism, samples.q, samples.angles)
        return Transmission(float(ratio), float(advantage), angle, moved.at)
    return Transmission(ratio, advantage, moved.angles(
        mechanism, samples.q, angles_of(samples)), moved.at)


def transmission_angle(mechanism: Mechanism, state: State, output: str, driver: str) -> float:
    """Return the transmission angle as `transmission` does, at dead centres too [rad]."""
    return MovedOutput.of(mechanism, output, driver).angle(mechanism, state.q, state.angles)


class MovedOutput(NamedTuple):
    """An output with a transmission angle.

    Attributes:
        coordinate: the output.
        given: the prescribed coordinates.
        joint: its own joint.
        at: closure or joint that moves its link.
        point: (3,) the point of that, in the joint's frame [m].
    """

    coordinate: Coordinate
    given: Prescription
    joint: int
    at: str
    point: Array

    @classmethod
    def of(
        cls, mechanism: Mechanism, output: str, driver: str, at: str | None = None,
        hold: Hold = BASE,
    ) -> MovedOutput:
        """Return the output; raises like `transmission`."""
        coordinate = mechanism.driven_coordinate(output)
        given = Prescription.of(mechanism, driven_coordinates(mechanism, [driver]), hold)
        named = f"mechanism {mechanism.name!r}: {output!r}"
        if coordinate in given.driven:
            raise SpatialPinError(f"{named} is a driver itself")
        if coordinate.v in given.still:
            raise SpatialPinError(f"{named} is held, and cannot be moved")
        geared = [c.name for c in mechanism.closures if coordinate.name in c.joints]
        if geared:
            raise SpatialPinError(
                f"mechanism {mechanism.name!r}: {coordinate.name!r} is moved by coupling "
                f"{geared[0]!r}, not at a pair of its link: it has no transmission angle")
        joint = mechanism.joint_id(coordinate.joint)
        if mechanism.model.nvs[joint] != 1:
            raise SpatialPinError(
                f"mechanism {mechanism.name!r}: {coordinate.name!r} is one of several coordinates "
                f"of a {mechanism.pair_of(coordinate.joint)} joint; a transmission angle needs an "
                "output of one freedom")
        return cls(coordinate, given, joint, *_moved_at(mechanism, joint, at))

    def angle(self, mechanism: Mechanism, q: Array, angles: Array) -> float:
        """Return the transmission angle at one configuration [rad]; see `angles`."""
        return float(self.angles(mechanism, q[None], angles[None])[0])

    def angles(self, mechanism: Mechanism, q: Array, angles: Array) -> Array:
        """Return the transmission angles (N,) [rad].

        q (N, nq) are closed configurations, `angles` (N, n_angles) those of screw closures there
        [rad].
        """
        size, n = mechanism.characteristic_length, max(PIECE // mechanism.model.nv**2, 1)
        output, given = self.coordinate, self.given
        unit = np.array([size] * 3 + [1.0] * 3)
        free = np.ones(mechanism.model.nv, dtype=bool)
        free[[output.v, *given.still, *(c.v for c in given.driven if c.q >= 0)]] = False
        turned = [c for c in given.driven if c.q < 0]  # components of balls are no entries
        pieces: list[Array] = [np.empty(0)]
        for first in range(0, len(q), n):
            some, turns = q[first : first + n], angles[first : first + n]
            with kernel_of(mechanism) as kernel:
                jacobian, columns = kernel.jacobians_and_columns(some, turns)
                placements = kernel.placements(some)
            # twists relative to the joint's parent, at the world origin in world axes: of the
            # output's own joint, and possible ones with that joint removed, which adds six freedoms
            # between its subtree and the rest, while prescribed coordinates stand still
            loose = twist_derivatives(mechanism, self.joint, some, placements, turns) * unit
            rows = jacobian[:, : loose.shape[1], free]
            if turned:
                pinned = [[scaled_row(mechanism, c, x)[free] for c in turned] for x in some]
                rows = np.concatenate([rows, pinned], axis=1)
                loose = np.concatenate([loose, np.zeros((len(some), len(turned), 6))], axis=1)
            every = padded_null_spaces(np.concatenate([rows, loose], axis=2))
            own = columns[:, output.v] / unit * mechanism.velocity_scale[output.v]
            placed = placements[:, self.joint]  # columns of the rotation, then the position
            points = placed[:, 3] + np.einsum("mci,c->mi", placed[:, :3], self.point)
            pieces.append(_angles(own, every[:, :, rows.shape[2]:], points / size))
        return np.concatenate(pieces)


def _moved_at(mechanism: Mechanism, joint: int, at: str | None) -> tuple[str, Array]:
    """Return the pair that moves a joint's link: its name, and point (3,) in the joint's frame."""
    model = mechanism.model
    pairs = {model.names[i]: model.jointPlacements[i].translation for i in model.children[joint]}
    for closure in mechanism.closures:
        for body, placement in map(mechanism.frame_on_joint, (*closure.frames, *closure.between)):
            if body == joint:
                pairs[closure.name] = placement.translation
    if at is not None:
        if at not in pairs:
            raise UnknownNameError("pair of the output's link", at, list(pairs),
                                   f"mechanism {mechanism.name!r}: ")
        return at, pairs[at]
    if len(pairs) != 1:
        raise SpatialPinError(
            f"mechanism {mechanism.name!r}: the link of {model.names[joint]!r} is held by "
            + (f"several other pairs; say at which it is moved: {', '.join(pairs)}" if pairs else
               "no other pair: nothing moves it but its own joint")
        )
    return next(iter(pairs.items()))


def _angles(own: Array, allowed: Array, points: Array) -> Array:
    """Return the angles (m,) between the velocities of points from two sets of twists [rad]."""
    u = own[:, :3] + cross(own[:, 3:], points)
    others = allowed[:, :, :3] + cross(allowed[:, :, 3:], points[:, None])
    stands = np.linalg.norm(u, axis=1) < TOLERANCES.nothing
    u = np.where(stands[:, None], own[:, 3:], u)
    basis = padded_row_spaces(np.where(stands[:, None, None], allowed[:, :, 3:], others))
    along = np.einsum("mki,mkj,mj->mi", basis, basis, u)
    return np.arctan2(np.linalg.norm(u - along, axis=1), np.linalg.norm(along, axis=1))
