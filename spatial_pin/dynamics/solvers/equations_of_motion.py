"""The equations of motion of a closed mechanism at one State, with its forces.

All closure equations that depend on others are left out when accelerations are solved for, so that
nothing is regularised; the multipliers of all of them are then the shortest that bear the same
loads.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin._support.lazy import acquired
from spatial_pin.assembly.redundant_equations import rounding_of
from spatial_pin.assembly.state import State
from spatial_pin.constraints.pinocchio_views import joint_jacobian
from spatial_pin.dynamics.forces import Forces, Law, external_wrenches, generalised
from spatial_pin.dynamics.reactions import UNMOVED, Pairs, Poses
from spatial_pin.dynamics.solvers.accelerations import MotionEquations
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.mechanism_checks import refuse_negative_inertias
from spatial_pin.mechanism.resistance import SlipSpeed
from spatial_pin.numerics.linalg import Array

# Laws of springs and slip speed where the mechanism has its own.
OWN: tuple[dict[str, Law], SlipSpeed | None] = {}, None


class Equations(MotionEquations):
    """The equations of motion with the forces that act, and the reactions that they cause.

    Attributes:
        given: (nv,) generalised forces of springs, resistance and external wrenches.
        turning: (nv,) those of springs about joints, and of resistance.
        wrenches: (joint, (6,)) external wrenches and springs on bodies, at the world origin.
    """

    def __init__(self, mechanism: Mechanism, large: bool | None = None) -> None:
        refuse_negative_inertias(mechanism)
        super().__init__(mechanism, large)
        self._laws = OWN
        self.springs = Forces(mechanism)

    def update(
        self, state: State, external: Mapping[str, pin.Force] | None = None,
        laws: Mapping[str, Law] | None = None, slip_speed: SlipSpeed | None = None,
    ) -> None:
        """Move to a State of this mechanism, under given forces.

        Args:
            state: configuration and velocity.
            external: wrenches at links, frames or joints, world axes [N, N·m].
            laws: of springs, see `Forces`.
            slip_speed: of dry friction, see `Forces`.
        """
        self.move_to(state)
        own = OWN if not laws and slip_speed is None else (
            dict(laws or {}), dict(slip_speed) if isinstance(slip_speed, Mapping) else slip_speed)
        if own is not self._laws and own != self._laws:
            self._laws, self.springs = own, Forces(self.mechanism, *own)
        springs, self.wrenches = self.springs, []
        self.given = self.turning = (
            springs.turning(state.q, state.v) if springs.exist else self.rest)
        if external:
            self.wrenches += external_wrenches(self.mechanism, self.evaluation, external)
        if springs.exist and (springs.lines or springs.bushings):
            self.wrenches += springs.wrenches(self.evaluation, state.v)
        if self.wrenches:
            self.given = self.turning + generalised(self.evaluation, self.wrenches)

    @property
    def applied(self) -> Array:
        """(nv,) generalised forces of springs and external wrenches, without resistance."""
        resistance = self.springs.resistance
        return self.given - resistance.forces(self.state.v) if resistance else self.given

    def mass(self) -> Array:
        """Return the mass matrix (nv, nv)."""
        return self.bodies.matrix(self.state.q)

    def motion_forces(self, a: Array) -> Array:
        """Return M a + b (nv,)."""
        return self.bodies.inverse_dynamics(self.state.q, self.state.v, a)

    # ------------------------------------------------------------ reactions

    @cached_property
    def pairs(self) -> Pairs:
        """The pairs of the mechanism."""
        return Pairs(self.mechanism)

    def poses(self) -> Poses:
        """Return the placements of the bodies as views, overwritten at the next State."""
        evaluation = self.evaluation
        return Poses(evaluation.placements, joint_jacobian(evaluation.data, self.model.nv),
                     evaluation.row_wrenches())

    def transmitted(self, a: Array) -> Array:
        """Return a view on the forces (njoints, 6) through joints at accelerations a (nv,)."""
        return self.bodies.transmitted(self.state.q, self.state.v, a)

    def reactions(
        self, a: Array, multipliers: Array, effort: Array
    ) -> tuple[dict[str, Array], Array]:
        """Return the reactions (6,) by pair and the wrench (6,) on the fixed link."""
        return self.pairs.reactions(
            self.poses(), self.transmitted(a), multipliers, self.pairs.summed(self.wrenches),
            self.at_joints(effort, multipliers, a))

    def at_joints(self, effort: Array, multipliers: Array, a: Array) -> Array:
        """Return efforts (nv,) with those of joint springs, couplings and rotors.

        A rotor (armature) that speeds up with its joint takes its part of the effort: the rest is
        what the bodies are moved with.
        """
        total = effort + self.turning - self.model.armature * a
        of_joints = self.constraints.of_joints
        if len(of_joints):
            total = total + multipliers[of_joints] @ self.joint_rows
        return total

    def unique_in_loops(self, efforts: Array | None = None) -> dict[str, NDArray[np.bool_]]:
        """Return by pair which components (6,) of its reaction no self-stress of loops changes.

        Args:
            efforts: (k, nv) of actuators that the loops bear, and that may act besides.
        """
        stresses = self.self_stresses
        pressing = np.zeros((len(stresses), len(self.scale)))
        if efforts is not None and len(efforts):
            borne = np.array([self.multipliers(-e) for e in efforts])
            size = np.maximum(np.linalg.norm(borne, axis=1), 1e-300)[:, None]
            stresses = np.vstack([stresses, borne / size])
            pressing = np.vstack([pressing, efforts / size])
        rounding = 0.0 if self._rank is None else rounding_of(self.state.mechanism)
        return self.pairs.unstressed(self.poses(), self.joint_rows, stresses, pressing,
                                     max(rounding, UNMOVED))

    def unique(self, efforts: Array | None = None) -> dict[str, NDArray[np.bool_]]:
        """Return by pair which components (6,) of its reaction are unique.

        Args:
            efforts: as for `unique_in_loops`.
        """
        result = self.unique_in_loops(efforts)
        return result | {name: result[name] & never for name, never in
                        self.pairs.unaffected_by_couplings(self.poses()).items()}


def equations_of(mechanism: Mechanism) -> acquired[Equations]:
    """Acquire the equations of a mechanism, made once for each thread that asks at the same time.

    They choose everything anew at every State.
    """
    return acquired(mechanism, Equations)
