"""Accelerations and reactions at a State."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin._support.brief import first_names, words
from spatial_pin._support.lazy import acquired
from spatial_pin.assembly.state import State
from spatial_pin.dynamics.forces import Law
from spatial_pin.dynamics.reactions import why_not_unique
from spatial_pin.dynamics.solvers.equations_of_motion import Equations
from spatial_pin.mechanism.resistance import SlipSpeed
from spatial_pin.numerics.linalg import Array

# Forces besides gravity, efforts and closures, as `Equations.update` takes them: those on frames,
# laws of springs, slip speed of dry friction.
Load = tuple[Any, Mapping[str, Law] | None, SlipSpeed | None]


class Dynamics:
    """Accelerations and reactions of a mechanism under given forces.

    Reactions are worked out at first use.

    Attributes:
        a: (nv,) joint accelerations [rad/s², m/s²].
        error: estimated round-off of `a`, relative to its largest entry: large where a heavy body
            hangs on links too light to push it.
        undetermined: coordinates that move without inertia, so that nothing determines their
            accelerations: those given are the least, of the links that they move.

    Example:
        >>> mech = sp.load("four_bar")
        >>> found = sp.forward_dynamics(mech, sp.assemble(mech, {"crank": 1.0}), {"crank": 0.1})
        >>> found.a.shape, found.multipliers.shape  # (nv,), (equations,)
        ((3,), (5,))
        >>> found.reactions["output_pin"].linear.round(3)  # on the rocker [N], world axes
        array([ 1.381, -0.   , -1.826])
        >>> found.unique["output_pin"]  # (6,): what acts across the plane is one of many
        array([ True, False,  True, False,  True, False])
        >>> found.determined["output_pin"], found.on_ground.linear.shape
        (False, (3,))
    """

    def __init__(
        self, state: State, load: Load, a: Array, closures: Array, effort: Array,
        error: float = 0.0, undetermined: tuple[str, ...] = (),
    ) -> None:
        a.flags.writeable = False
        self.a, self.error, self._at = a, error, state
        self.undetermined = undetermined
        self._load, self._closures, self._effort = load, closures, effort

    @cached_property
    def state(self) -> State:
        """The State with these accelerations."""
        at = self._at
        return State(at.mechanism, at.q, at.v, self.a, closure_error=at.closure_error,
                     angles=at.angles, rate_error=at.rate_error)

    @contextmanager
    def _equations(self) -> Iterator[Equations]:
        mechanism = self._at.mechanism
        with acquired(mechanism.whole or mechanism, Equations) as equations:
            equations.update(self._at, *self._load)
            yield equations

    @cached_property
    def multipliers(self) -> Array:
        """(n_closure,) of the closure equations, so that M a + b = f + J^T multipliers.

        J is `closure_jacobian`; the shortest ones where rows depend on each other.
        """
        with self._equations() as equations:
            return equations.multipliers(self._closures)

    @cached_property
    def _borne(self) -> tuple[dict[str, pin.Force], pin.Force]:
        with self._equations() as equations:
            multipliers = equations.multipliers(self._closures)
            wrenches, ground = equations.reactions(self.a, multipliers, self._effort)
        return {name: pin.Force(wrench) for name, wrench in wrenches.items()}, pin.Force(ground)

    @property
    def reactions(self) -> dict[str, pin.Force]:
        """Reactions of all pairs, world axes [N, N·m].

        A joint of the tree: on its child link, at the joint's origin. A closure: on the link of its
        second frame, at that frame's origin. What drivers, springs, damping and friction do about
        or along the pair's own axis is not part of it, nor is what an armature takes there: it is
        a term of the joint's balance of efforts alone, as in Pinocchio and MuJoCo.
        """
        return self._borne[0]

    @property
    def on_ground(self) -> pin.Force:
        """The shaking wrench: force and moment on the fixed link, at the world's origin.

        Joints, closures, drivers and springs together [N, N·m].
        """
        return self._borne[1]

    @cached_property
    def of_loops(self) -> dict[str, NDArray[np.bool_]]:
        """Components of each pair's reaction that self-stresses of the loops do not change."""
        with self._equations() as equations:
            return equations.unique_in_loops()

    @cached_property
    def unique(self) -> dict[str, NDArray[np.bool_]]:
        """Uniqueness of the components of each pair's reaction, (6,) force then moment, world axes.

        Those are not that an overconstrained loop can be under stress with by itself: all but the
        forces in the plane and the moment about its normal, where a plane loop of hinges holds
        its links in the plane more than once. Nor those of the pairs from one joint of a coupling
        to its other: where the coupling's force acts is not known, and it is no part of them.
        """
        with self._equations() as equations:
            return equations.unique()

    @property
    def determined(self) -> dict[str, bool]:
        """Whether each pair's reaction is unique, in all its components."""
        return {name: bool(each.all()) for name, each in self.unique.items()}

    def why_not_unique(self) -> list[str]:
        """Return why some reactions are not unique.

        Returns:
            A sentence for each reason; none where all are unique.

        Example:
            >>> mech = sp.load("four_bar")
            >>> found = sp.forward_dynamics(mech, sp.assemble(mech, {"crank": 1.0}))
            >>> print(found.why_not_unique()[0][:50])
            * one of many (along these axes), the least: loops
        """
        mechanism = self._at.mechanism
        marked = [name for name, is_unique in self.determined.items() if not is_unique]
        return why_not_unique(mechanism.whole or mechanism, marked)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self._at!r}, a={words(self.a)})"

    def __str__(self) -> str:
        lines = []
        for name, r in self.reactions.items():
            each = self.unique[name]
            lines.append(f"{name}: force {_words(r.linear, each[:3])} N, "
                         f"moment {_words(r.angular, each[3:])} N·m")
        lines += self.why_not_unique()
        if self.undetermined:
            lines.append("accelerations that nothing determines, the least are given: "
                         f"{first_names(self.undetermined)} move without inertia")
        return "\n".join(lines)


def _words(x: Array, unique: NDArray[np.bool_]) -> str:
    marked = (f"{c:.6g}" + "*" * (not one) for c, one in zip(x, unique, strict=True))
    return "(" + ", ".join(marked) + ")"
