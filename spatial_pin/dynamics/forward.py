"""Forward dynamics: accelerations and reactions under given forces."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, overload

import pinocchio as pin
from numpy.typing import ArrayLike

from spatial_pin._support.checks import checked
from spatial_pin._support.lazy import acquired
from spatial_pin.assembly.state import State, moving_in_time
from spatial_pin.dynamics.forces import Law, joint_efforts, warn_of_no_inertia
from spatial_pin.dynamics.kinetostatics import Kinetostatics, forward_over
from spatial_pin.dynamics.loaded_samples import External
from spatial_pin.dynamics.solvers.equations_of_motion import Equations
from spatial_pin.dynamics.state_forces import Dynamics
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.resistance import SlipSpeed
from spatial_pin.motion.motion import Motion


@overload
def forward_dynamics(
    mechanism: Mechanism, state: State, efforts: Mapping[str, float] | None = None, *,
    external: Mapping[str, pin.Force] | None = None, laws: Mapping[str, Law] | None = None,
    slip_speed: SlipSpeed | None = None,
) -> Dynamics: ...
@overload
def forward_dynamics(
    mechanism: Mechanism, state: Motion, efforts: Mapping[str, ArrayLike] | None = None, *,
    external: External | None = None, laws: Mapping[str, Law] | None = None,
    slip_speed: SlipSpeed | None = None,
) -> Kinetostatics: ...
@checked
def forward_dynamics(
    mechanism: Mechanism,
    state: State | Motion,
    efforts: Mapping[str, Any] | None = None,
    *,
    external: External | None = None,
    laws: Mapping[str, Law] | None = None,
    slip_speed: SlipSpeed | None = None,
) -> Dynamics | Kinetostatics:
    """Solve accelerations, multipliers and reactions of a closed mechanism under forces.

    Gravity, the file's springs, damping and dry friction of joints (URDF, or the mechanism file)
    act always, armatures add to the inertia. Drivers are free unless an effort is given.
    Loops are hard: accelerations are exact whether they are overconstrained or not. Of links
    without inertia that nothing determines, the least accelerations are taken
    (`Dynamics.undetermined`).

    Args:
        mechanism: the mechanism.
        state: configuration and velocity; or a Motion, for all its N samples.
        efforts: by driver, joint or coordinate [N·m about it, N along it]; over a Motion each may
            be an array (N,).
        external: by link, frame or joint, the force on it at its origin, world axes; over a Motion
            each may be an array (N, 6), force and moment, or all a function of the time and the
            State, or of the State alone, that returns such a mapping.
        laws: by spring, force as a function of (length, rate) instead of stiffness and damping,
            positive pulling together; about a joint torque of (angle, rate), positive turning back.
        slip_speed: speed at which dry friction has 76 % of its full value (tanh 1), instead of the
            file's: one for all coordinates [rad/s, characteristic lengths per second], or by
            driver, joint or coordinate [rad/s, m/s]. Slower joints rub less, joints at rest not at
            all.

    Returns:
        The Dynamics; over a Motion the Kinetostatics, at rest where that is no motion in time.

    Raises:
        SingularError: the loops lose rank there, or a freedom that forces act on has no inertia.
        UnknownNameError: a name does not exist.
        ValueError: a value is NaN or infinite.

    Example:
        >>> mech = sp.load("four_bar")
        >>> state = sp.assemble(mech, {"crank": 1.0})
        >>> found = sp.forward_dynamics(mech, state, {"crank": 0.1})  # [N·m], and gravity
        >>> found.a.round(3)  # (nv,) [rad/s²]
        array([-32.917,  40.914,  -6.37 ])
        >>> found.reactions["output_pin"].linear.round(3)  # on the rocker [N], world axes
        array([ 1.381, -0.   , -1.826])
    """
    if not isinstance(state, State):
        return forward_over(mechanism, state, efforts, (external, laws, slip_speed))
    state = moving_in_time(mechanism, state)
    mechanism, load = state.mechanism, (external, laws, slip_speed)
    with acquired(mechanism, Equations) as equations:
        equations.update(state, *load)
        effort = joint_efforts(mechanism, efforts) if efforts else equations.rest
        a, closures, error = equations.solve(
            effort + equations.given if efforts else equations.given)
        undetermined = equations.undetermined
    warn_of_no_inertia(mechanism, efforts, external)
    return Dynamics(state, load, a, closures, effort, error, undetermined)
