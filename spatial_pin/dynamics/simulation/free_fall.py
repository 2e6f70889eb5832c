"""A mechanism that nothing holds, seen from a point that falls with its centre of mass.

Seen from there it has no weight, and is the same mechanism wherever it is and however fast it
flies [Goldstein2002, 1.2]: joint coordinates are integrated near the origin, where they have all
their digits. With r(t) = c + u t + g t²/2 the motion of the centre of mass, the energy is greater
by m u²/2 - m g c (Koenig), and that for all time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin

from spatial_pin.assembly.close import close
from spatial_pin.assembly.state import State
from spatial_pin.dynamics.simulation.problem import Problem
from spatial_pin.dynamics.simulation.result import (
    Energies,
    LeastExchange,
    Simulation,
    energy_drift,
)
from spatial_pin.kernel.loop_equations import loops_of
from spatial_pin.mechanism.inertia import KineticEnergy
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array


def floats(problem: Problem) -> bool:
    """Whether nothing holds or pulls a mechanism but gravity, so that it may be seen from anywhere.

    Efforts given as a function are not known before, and may pull at it.
    """
    mechanism, model = problem.mechanism, problem.model
    if "floating" not in mechanism.pairs:
        return False
    roots = _roots(mechanism)
    if any(mechanism.pairs[i - 1] != "floating" for i in roots):
        return False
    frames = [f for c in mechanism.closures for f in (*c.frames, *c.between)]
    frames += [f for spring in mechanism.springs for f in spring.frames]
    if any(mechanism.frame_on_joint(f)[0] == 0 for f in frames):
        return False
    own = np.concatenate([model.idx_vs[i] + np.arange(6) for i in roots])
    resistance = problem.forces.resistance
    held = [problem.constant[own], model.armature[own]]
    held += [resistance.damping[own], resistance.friction[own]] if resistance else []
    joints = {mechanism.model.names[i] for i in roots}
    driven = any(c.joint in joints for c, _ in problem.drives)
    return not (driven or problem.law or problem.external or any(np.any(x) for x in held)
                or not sum(body.mass for body in model.inertias) > 0.0)


def _roots(mechanism: Mechanism) -> list[int]:
    return [i for i, parent in enumerate(mechanism.model.parents) if i and not parent]


class FreeFall:
    """The motion of the centre of mass, and a mechanism as it is seen from there.

    Args:
        state: where it begins.
        tolerance: closure residual to begin with there: far from the origin digits are lost.

    Attributes:
        mechanism: the same mechanism, weightless.
        state: the same state, seen from the centre of mass.
    """

    def __init__(self, state: State, tolerance: float) -> None:
        self._whole, model = state.mechanism, state.mechanism.centred_model
        self._data = model.createData()
        centre = pin.centerOfMass(model, self._data, state.q, state.v)
        self._start, self._speed = centre.copy(), self._data.vcom[0].copy()
        self._gravity = model.gravity.linear.copy()
        mass = float(self._data.mass[0])
        self._energy = mass * float(0.5 * self._speed @ self._speed - self._gravity @ self._start)
        self._kinetic = KineticEnergy(model)(state.q, state.v)
        weightless = self._whole.model.copy()
        weightless.gravity = pin.Motion.Zero()
        self.mechanism = state.mechanism.with_fields(model=weightless)
        q, v, _ = self._seen(0.0, state.q, state.v, state.a, -1.0)
        with loops_of(self.mechanism, state.angles) as evaluation:
            evaluation.update(q)
            if evaluation.closure_error > tolerance:
                q, _ = close(evaluation, q, np.ones(model.nv, dtype=bool), tolerance)
            self.state = State(self.mechanism, q, v, closure_error=evaluation.closure_error,
                               angles=evaluation.angles)

    def _seen(
        self, t: float, q: Array, v: Array, a: Array, sense: float
    ) -> tuple[Array, Array, Array]:
        """Return q, v, a with the motion of the centre of mass added (1) or taken away (-1)."""
        model, (q, v, a) = self._whole.model, (x.copy() for x in (q, v, a))
        speed = sense * (self._speed + self._gravity * t)
        away = sense * (self._start + (self._speed + 0.5 * self._gravity * t) * t)
        for i in _roots(self._whole):
            base, k, j = model.jointPlacements[i].rotation, model.idx_qs[i], model.idx_vs[i]
            turned = base @ pin.Quaternion(q[k + 3 : k + 7]).toRotationMatrix()
            u = turned.T @ speed
            q[k : k + 3] += base.T @ away
            v[j : j + 3] += u
            a[j : j + 3] += sense * (turned.T @ self._gravity) - np.cross(v[j + 3 : j + 6], u)
        return q, v, a

    def back(self, t: float, state: State) -> State:
        """Return a state at a time as it is seen from the world."""
        q, v, a = self._seen(t, state.q, state.v, state.a, 1.0)
        return State(self._whole, q, v, a, closure_error=state.closure_error, angles=state.angles)

    def watched(self, function: Callable[[float, State], Any] | None) -> Any:
        """Return a function of time and State for the States that are seen from here."""
        return None if function is None else lambda t, state: function(t, self.back(t, state))

    def motion(self, seen: Simulation, start: Energies, efforts: Array) -> Simulation:
        """Return a motion as it is seen from the world.

        Args:
            seen: the motion.
            start: the energies that it started with.
            efforts: (nv,) that act [N·m, N].
        """
        assert seen.time is not None
        rows = [self._seen(*row, 1.0) for row in zip(
            seen.time.tolist(), seen.q, seen.v, seen.a, strict=True)]
        q, v, a = (np.array(x) for x in zip(*rows, strict=True)) if rows else (
            seen.q, seen.v, seen.a)
        energy = seen.energy + self._energy
        start = Energies(self._kinetic, start.total + self._energy, start.work)
        kinetic = np.array(list(map(KineticEnergy(self._whole.model), q, v)))
        return replace(
            seen, mechanism=self._whole, q=q, v=v, a=a, energy=energy,
            energy_drift=energy_drift(
                LeastExchange(self._whole, efforts), kinetic, energy, seen.work, start))
