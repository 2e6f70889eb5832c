"""Transmission of a mechanism: speed ratio, mechanical advantage, transmission angle."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from spatial_pin._support.brief import brief
from spatial_pin._support.checks import checked
from spatial_pin.assembly.close import pinned_rows
from spatial_pin.assembly.holding import BASE, Hold
from spatial_pin.assembly.state import State, of_mechanism
from spatial_pin.constraints.pinocchio_views import joint_jacobian
from spatial_pin.errors import SpatialPinError, UnknownNameError
from spatial_pin.kernel.kernel import kernel_of
from spatial_pin.kernel.loop_equations import LoopEquations, loops_of
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Coordinate
from spatial_pin.numerics.linalg import Array, null_space, row_space
from spatial_pin.numerics.tolerances import TOLERANCES
from spatial_pin.rates.depending import equations_for_all_frames, equations_for_entries
from spatial_pin.rates.prescribed import Prescription, driven_coordinates
from spatial_pin.rates.rates import check_not_held


class Transmission(NamedTuple):
    """How a driver moves an output at one configuration.

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

    ratio: float
    mechanical_advantage: float
    angle: float
    at: str

    def __repr__(self) -> str:
        return brief(self, angle="rad")


@checked
def transmission(
    mechanism: Mechanism, state: State, output: str, driver: str | None = None,
    at: str | None = None, *, hold: Hold = BASE,
) -> Transmission:
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
        state: a closed configuration.
        output: coordinate of a one-freedom joint of the tree.
        driver: the driver or coordinate that moves it; the only driver if not given.
        at: closure or joint that moves the output link; needed where there are several.
        hold: names of joints that stand still besides the other drivers, as for `solve_rates`.

    Returns:
        The Transmission: ratio, mechanical advantage, angle [rad].

    Raises:
        UnknownNameError: a name does not exist.
        SpatialPinError: the output's link is moved at several pairs, or at none.
        SingularError: the drivers do not determine the velocities there.

    Example:
        >>> mech = sp.load("four_bar")
        >>> found = sp.transmission(mech, sp.assemble(mech, {"crank": 1.0}), "rocker_pin")
        >>> print(f"ratio {found.ratio:.4f}, {np.degrees(found.angle):.1f}° at {found.at}")
        ratio 0.1935, 59.4° at output_pin
    """
    state = of_mechanism(mechanism, state)
    mechanism = state.mechanism
    if driver is None:
        names = list(mechanism.drivers)
        if len(names) != 1:
            raise SpatialPinError(f"mechanism {mechanism.name!r} has {len(names)} drivers; say "
                                  f"which one moves the output: {', '.join(names)}")
        driver = names[0]
    input_ = mechanism.driven_coordinate(driver)
    check_not_held(mechanism, [input_], hold)
    moved = MovedOutput.of(mechanism, output, input_.name, at, hold)
    angle = moved.angle(mechanism, state.q, state.angles)
    at_output = mechanism.driven_coordinate(output).v
    dependence = equations_for_all_frames(state, moved.given) or equations_for_entries(
        state, moved.given, (at_output,))
    with kernel_of(dependence.state.mechanism) as kernel:
        columns = dependence.among_all(dependence.rates(kernel).columns(), moved.given.n_moving)
    ratio = float(columns[at_output, [c.name for c in moved.given.driven].index(input_.name)])
    advantage = 1.0 / ratio if ratio else math.copysign(math.inf, ratio)
    return Transmission(ratio, advantage, angle, moved.at)


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
        """Return the transmission angle [rad].

        Args:
            mechanism: whose output it is.
            q: (nq,) a closed configuration.
            angles: (n_angles,) of screw closures there [rad].
        """
        with loops_of(mechanism, angles) as evaluation:
            evaluation.update(q)
            own, allowed = _velocities(evaluation, self.joint, self.coordinate, self.given)
            point = evaluation.data.oMi[self.joint].act(self.point)
        return _angle(own, allowed, point / mechanism.characteristic_length)


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


def _velocities(
    evaluation: LoopEquations, joint: int, output: Coordinate, given: Prescription
) -> tuple[Array, Array]:
    """Return the twist of the output's own joint, and possible twists with that joint removed.

    Both relative to the joint's parent, at the world origin in world axes, (6,) and (k, 6), lengths
    relative to the characteristic length; prescribed coordinates are fixed in the latter. Removing
    a joint adds six freedoms between the subtree and the rest.
    """
    n, mechanism = evaluation.constraints.n_closure, evaluation.mechanism
    size = mechanism.characteristic_length
    unit = np.array([size] * 3 + [1.0] * 3)
    loose = evaluation.twist_derivatives(joint) * unit
    turned = [c.name for c in given.driven if c.q < 0]  # components of balls are no entries
    free = np.ones(evaluation.model.nv, dtype=bool)
    free[[output.v, *given.still, *(c.v for c in given.driven if c.q >= 0)]] = False
    rows, _ = pinned_rows(evaluation, free, turned)
    loose = np.vstack([loose, np.zeros((len(rows) - n, loose.shape[1]))])
    allowed = null_space(np.hstack([rows, loose]))[:, rows.shape[1]:]
    own = joint_jacobian(evaluation.data, evaluation.model.nv)[:, output.v]
    return own / unit * mechanism.velocity_scale[output.v], allowed


def _angle(own: Array, allowed: Array, point: Array) -> float:
    """Return the angle between the velocities of a point from two sets of twists [rad]."""
    u, others = (x[..., :3] + np.cross(x[..., 3:], point) for x in (own, allowed))
    if np.linalg.norm(u) < TOLERANCES.nothing:
        u, others = own[3:], allowed[:, 3:]
    basis = row_space(others)
    along = basis.T @ (basis @ u)
    return math.atan2(float(np.linalg.norm(u - along)), float(np.linalg.norm(along)))
