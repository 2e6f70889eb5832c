"""Third derivatives of closed motions.

With the twist nu of a body in its own axes and H its 4 x 4 matrix, the stacked placements of
`spatial_pin.constraints` have G' = H^T G, G'' = H^T G' + H'^T G and
G''' = H^T G'' + 2 H'^T G' + H''^T G. nu'' follows from the derivatives of nu' (`TreeMotion`).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pinocchio as pin

from spatial_pin._support.brief import words
from spatial_pin._support.checks import checked, finite_number
from spatial_pin.assembly.holding import BASE, Hold
from spatial_pin.assembly.state import State, center_of_mass, mass_shares, of_mechanism
from spatial_pin.constraints.composed_equations import composed_rates, vector_matrix
from spatial_pin.constraints.trees import TreeMotion, twist_matrices
from spatial_pin.errors import SpatialPinError
from spatial_pin.kernel.kernel import kernel_of
from spatial_pin.kernel.loop_equations import loops_of
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array
from spatial_pin.rates.prescribed import (
    Prescription,
    chosen_at,
    driven_coordinates,
    refuse_components,
)

BINOMIALS = (1,), (1, 1), (1, 2, 1), (1, 3, 3, 1)


class Jerks:
    """Third derivatives of a closed motion at one State.

    Attributes:
        state: position, velocity and acceleration.
        j: (nv,) derivative of `state.a` [rad/s³, m/s³].

    Example:
        >>> mech = sp.load("four_bar")
        >>> state = sp.solve_rates(mech, sp.assemble(mech, {"crank": 1.0}), {"crank": 10.0})
        >>> sp.solve_jerks(mech, state).j.round(1)  # (nv,) [rad/s³]
        array([   0. , -205.3, -688.4])
    """

    def __init__(self, state: State, j: Array, bodies: Array) -> None:
        self.state, self.j = state, j
        self._bodies = bodies  # (njoints, 6) second derivatives of the twists, joint axes

    @checked
    def coordinate(self, name: str) -> float:
        """Return the third derivative of a joint coordinate [rad/s³ or m/s³].

        Raises:
            UnknownNameError: there is no such coordinate, one-freedom joint or driver.
            SpatialPinError: it is a component of a rotation vector.

        Example:
            >>> mech = sp.load("four_bar")
            >>> state = sp.solve_rates(mech, sp.assemble(mech, {"crank": 1.0}), {"crank": 10.0})
            >>> print(f"{sp.solve_jerks(mech, state).coordinate('rocker_pin'):.1f} rad/s³")
            -688.4 rad/s³
        """
        c = self.state.mechanism.coordinate(name)
        if c.q < 0:
            raise SpatialPinError(
                f"mechanism {self.state.mechanism.name!r}: {c.name!r} is a component of a joint "
                f"that can turn about any axis; ask for the jerk of a frame it carries"
            )
        return float(self.j[c.v])

    @checked
    def frame(self, name: str) -> pin.Motion:
        """Return the jerk of a link, frame or joint, world axes.

        Linear: third derivative of the position of its origin [m/s³]. Angular: second derivative
        of its angular velocity [rad/s³].

        Raises:
            UnknownNameError: there is no such link, frame or joint.

        Example:
            >>> mech = sp.load("four_bar")
            >>> state = sp.solve_rates(mech, sp.assemble(mech, {"crank": 1.0}), {"crank": 10.0})
            >>> sp.solve_jerks(mech, state).frame("coupler_b").linear.round(2)  # [m/s³]
            array([170.53,   0.  , -60.65])
        """
        mechanism = self.state.mechanism
        joint, placement = mechanism.frame_on_joint(mechanism.placed(name))
        return self._at(joint, placement.translation)

    @checked
    def com(self, name: str) -> Array:
        """Return the jerk of a link's own centre of mass, world axes (3,) [m/s³].

        Raises:
            SpatialPinError: the link has no mass.

        Example:
            >>> mech = sp.load("four_bar")
            >>> state = sp.solve_rates(mech, sp.assemble(mech, {"crank": 1.0}), {"crank": 10.0})
            >>> sp.solve_jerks(mech, state).com("coupler").round(2)  # [m/s³]
            array([127.34,   0.  , -57.34])
        """
        mechanism = self.state.mechanism
        joint, placement = mechanism.frame_on_joint(mechanism.placed(name))
        return self._at(joint, placement.act(center_of_mass(mechanism, name))).linear

    def whole_com(self) -> Array:
        """Return the jerk of the centre of mass of all moving links, world axes (3,) [m/s³].

        Raises:
            SpatialPinError: they have no mass.

        Example:
            >>> mech = sp.load("four_bar")
            >>> state = sp.solve_rates(mech, sp.assemble(mech, {"crank": 1.0}), {"crank": 10.0})
            >>> sp.solve_jerks(mech, state).whole_com().shape  # [m/s³]
            (3,)
        """
        return sum((share * self._at(joint, lever).linear
                    for joint, share, lever in mass_shares(self.state.mechanism)), np.zeros(3))

    def _at(self, joint: int, point: Array) -> pin.Motion:
        data = self.state.data
        twist, accel = data.v[joint].vector, data.a[joint].vector
        jerk = self._bodies[joint]
        rows = placement_rates(data.oMi[joint].homogeneous[:3].T, twist, accel, jerk)[3]
        angular = jerk[3:] + np.cross(twist[3:], accel[3:])
        return pin.Motion(np.append(point, 1.0) @ rows, data.oMi[joint].rotation @ angular)

    def __repr__(self) -> str:
        return f"Jerks({self.state!r}, j={words(self.j)})"


@checked
def solve_jerks(
    mechanism: Mechanism, state: State, jerks: Mapping[str, float] | None = None, *,
    hold: Hold = BASE,
) -> Jerks:
    """Solve the third derivatives of all joints of a closed, moving state.

    Args:
        mechanism: the mechanism.
        state: from `solve_rates`; its v and a are taken as they are.
        jerks: third derivative of each driver or coordinate [rad/s³, m/s³]; default zero.
        hold: names of joints that stand still, as for `solve_rates`.

    Returns:
        The Jerks, for any coordinate, frame or centre of mass.

    Raises:
        SingularError: the drivers do not determine the motion there.
        UnknownNameError: a name does not exist.
        ValueError: a value is NaN or infinite.

    Example:
        >>> mech = sp.load("four_bar")
        >>> state = sp.solve_rates(mech, sp.assemble(mech, {"crank": 1.0}), {"crank": 10.0})
        >>> round(sp.solve_jerks(mech, state).coordinate("rocker_pin"), 1)  # [rad/s³]
        -688.4
    """
    state = of_mechanism(mechanism, state)
    mechanism = state.mechanism
    jerks = jerks or {}
    j_of = {mechanism.driven_coordinate(name).name: finite_number(x, f"jerk of {name!r}")
            for name, x in jerks.items()}
    tree = TreeMotion(mechanism, (state.q, state.v, state.a))
    _, by_q, by_v, columns = tree.by_motion(np.arange(len(tree.joints)))
    bodies = by_q @ state.v + by_v @ state.a  # (njoints, 6) at zero joint jerk, joint axes
    given = Prescription.of(mechanism, driven_coordinates(mechanism, jerks), hold)
    refuse_components(mechanism, given.driven)
    drive = np.array([j_of.get(c.name, 0.0) for c in given.driven])
    with (kernel_of(mechanism) as kernel, loops_of(mechanism, state.angles) as evaluation):
        rates = given.rates(kernel)
        if rates.solve(state.q, state.angles, ()) is None:
            rates.solve(state.q, state.angles, (), chosen=chosen_at(state, given))
        evaluation.update(state.q)
        c = evaluation.constraints
        twists, accels = evaluation.move(state.q, state.v, state.a)
        flat = [g.reshape(-1, 3) for g in placement_rates(
            evaluation.placements, twists, accels, bodies)]
        n, matrix = len(c.constants), vector_matrix(c)
        a, b = ([matrix[part] @ g for g in flat] for part in (slice(0, n), slice(n, 2 * n)))
        products = [sum(binomial * np.vecdot(a[order - k], b[k])  # of a . b [Leibniz]
                        for k, binomial in enumerate(BINOMIALS[order])) for order in range(4)]
        products[0] = products[0] - c.constants
        idle = [axis @ bodies[joint, 3:] for joint, axis in c.idle_axes]
        rows = composed_rates(c, products, [state.q, state.v, state.a], state.angles)
        j = rates.answer(np.concatenate([rows, idle]), drive)
    return Jerks(state, j, bodies + columns @ j)


def placement_rates(g: Array, twist: Array, accel: Array, jerk: Array) -> list[Array]:
    """Return stacked placements (..., 4, 3) and their first three derivatives.

    g (..., 4, 3) has the columns of the rotation, then the position; the twist (..., 6) is that of
    the body in its own axes, linear first; `accel` and `jerk` are its derivatives.
    """
    h, dh, ddh = map(twist_matrices, (twist, accel, jerk))
    g1 = h @ g
    g2 = h @ g1 + dh @ g
    return [g, g1, g2, h @ g2 + 2.0 * dh @ g1 + ddh @ g]
