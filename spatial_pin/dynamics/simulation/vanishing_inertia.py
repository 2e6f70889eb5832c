"""Where the inertia of a motion vanishes: links without it would have to be infinitely fast.

At the dead centre of a crank and a rod without inertia the slider that they carry cannot go on, and
nothing but it has momentum. Near such a configuration the inertia of the motion, per square of the
fastest speed, falls to zero in proportion to the time that is left, and so do the steps of an
integrator. Bodies are counted with a size of their inertias of one: light ones are slow to turn,
but turn.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
import pinocchio as pin

from spatial_pin.mechanism.inertia import KineticEnergy, inertia_as_given
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array
from spatial_pin.numerics.tolerances import TOLERANCES

SINGULAR = "singular"  # kind of the event
NEGLIGIBLE = 1e-6  # inertia of a motion relative to that of its bodies: a step is a millionth then
SMALL = 1e-2  # the same relative to the largest before, where a motion cannot be followed
SHORTENED = 1e-4  # step relative to the longest so far, from which on the inertia is looked at
DECREASED = 0.8  # inertia relative to that at the last look, from which on it is looked at again
CLOSE_BY = 3.0  # way to where it vanishes, in ways that the last looks are apart


class VanishingInertia:
    """Looks whether a motion comes to where it has no inertia.

    Args:
        mechanism: what moves.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        self._mechanism, self._scale = mechanism, mechanism.velocity_scale
        self._looks: list[tuple[float, float]] = []  # times and inertias, three at most

    @cached_property
    def _energy(self) -> KineticEnergy | None:
        """Kinetic energies with inertias of size one; None if every motion has inertia."""
        model, length = self._mechanism.model.copy(), self._mechanism.characteristic_length
        has_none = False
        for joint in range(1, model.njoints):
            body = model.inertias[joint]
            size = body.mass * length**2 + float(np.trace(body.inertia))
            least = min(body.mass * length**2, float(np.linalg.eigvalsh(body.inertia)[0]))
            has_none |= not least > TOLERANCES.nothing * size
            if size > 0.0:
                model.inertias[joint] = inertia_as_given(
                    body.mass / size, body.lever, body.inertia / size)
        model.armature = (model.armature > 0.0) / self._scale**2
        return KineticEnergy(model) if has_none else None

    def inertia(self, q: Array, v: Array) -> float:
        """Return the inertia of the motion v (nv,) at q (nq,), infinite if it cannot vanish."""
        square = float(np.square(v / self._scale).sum())
        if self._energy is None or not square > 0.0:
            return np.inf
        return self._energy(q, v) / square

    def is_ahead(self, t: float, q: Array, v: Array, shortened: float) -> bool:
        """Whether it vanishes just ahead of a step that ends at q (nq,) and v (nv,).

        Args:
            t: end of the step [s].
            q: configuration.
            v: velocity.
            shortened: the step relative to the longest so far.
        """
        found = self.inertia(q, v) if shortened < SHORTENED else np.inf
        if not found < NEGLIGIBLE or (self._looks and found > self._looks[-1][1]):
            self._looks.clear()
            return False
        if not self._looks or found < DECREASED * self._looks[-1][1]:
            self._looks = [*self._looks[-2:], (t, found)]
        return _has_zero_ahead(self._looks)

    def was_ahead(self, times: Array, q: Array, v: Array) -> bool:
        """Whether it vanishes just behind the last of N samples (N, nq) and (N, nv).

        Of a motion that cannot be followed, with steps of whatever length.
        """
        found = [self.inertia(*row) for row in zip(q, v, strict=True)]
        most = max((x for x in found if np.isfinite(x)), default=0.0)
        return bool(found and found[-1] < SMALL * most
                    and _has_zero_ahead([*zip(times.tolist(), found, strict=True)][-3:]))

    def words(self, t: float, q: Array, v: Array) -> str:
        """Return a sentence for the event of a motion that ends at a time [s]."""
        model, length = self._mechanism.model, self._mechanism.characteristic_length
        data = model.createData()
        pin.forwardKinematics(model, data, q, v)
        pace = [float(np.linalg.norm(x.vector * np.repeat([1.0 / length, 1.0], 3)))
                for x in data.v]
        joint = int(np.argmax(pace))
        link = next((f.name for f in model.frames if f.type == pin.FrameType.BODY
                     and f.parentJoint == joint), model.names[joint])
        return (f"dead centre of what has no inertia at {t:.12g} s: the link {link!r} would have "
                "to become infinitely fast")


def _has_zero_ahead(looks: Sequence[tuple[float, float]]) -> bool:
    """Whether a parabola through three times and values that fall has a zero soon.

    One of a motion that comes near such a place and passes it has none.
    """
    if len(looks) < 3:
        return False
    times, values = np.array(looks).T
    if not values[0] > values[1] > values[2]:
        return False
    along, left = (times - times[2]) / (times[2] - times[0]), values / values[0]
    zeros = np.roots(np.linalg.solve(np.vander(along, 3), left))
    return bool(np.any((zeros.imag == 0.0) & (zeros.real > 0.0) & (zeros.real < CLOSE_BY)))
