"""Mobility: freedoms by formula, by rank, and by finite motion; loops; advice on drivers."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from spatial_pin._support.brief import counted
from spatial_pin._support.checks import checked
from spatial_pin.assembly.assemble import assembled
from spatial_pin.assembly.holding import fixed_base_entries, free_bases
from spatial_pin.assembly.redundant_equations import (
    gap_words,
    rounding_of,
    with_independent_equations,
)
from spatial_pin.assembly.state import State, all_angles, of_mechanism
from spatial_pin.assembly.undetermined import locked_loops_hint
from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.constraints.pinocchio_views import joint_jacobian
from spatial_pin.errors import MechanismFileError, SpatialPinError
from spatial_pin.kernel.loop_equations import LoopEquations, loops_at
from spatial_pin.mechanism.coordinates import driver_coordinates, finite_array, require_mechanism
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Closure
from spatial_pin.mobility.finite_motions import finite_freedom, finite_motions
from spatial_pin.mobility.idle_freedoms import (
    ALGEBRA_TOLERANCE,
    PassiveFreedom,
    described,
    idle_freedoms,
)
from spatial_pin.numerics.linalg import (
    Array,
    common_rows,
    decompose,
    independent_rows,
    null_space,
    rank,
    row_space,
)
from spatial_pin.numerics.tolerances import TOLERANCES

KINDS = {  # by dimension, and how many directions are turned about
    (1, 0): "one direction", (2, 0): "translations in a plane", (3, 0): "translations",
    (1, 1): "one axis", (2, 1): "one axis (turn and slide)", (3, 1): "planar",
    (4, 1): "planar with slide along the axis", (3, 3): "spherical",
    (6, 3): "spatial",
}


class Loop(NamedTuple):
    """An independent loop.

    Attributes:
        closure: the closure that closes it.
        joints: the joints of the tree that it passes.
        order: dimension of the motions its pairs generate (lambda in the mobility formula).
        kind: name of these motions, such as "planar".

    Example:
        >>> loop = sp.mobility(sp.load("four_bar")).loop_list[0]
        >>> loop.closure, loop.order, loop.kind
        ('output_pin', 3, 'planar')
    """

    closure: str
    joints: tuple[str, ...]
    order: int
    kind: str


def loop_of(evaluation: LoopEquations, closure: Closure, tolerance: float) -> Loop:
    """Return the loop of a closure, classified by the motions that its pairs generate."""
    mechanism, constraints = evaluation.mechanism, evaluation.constraints
    rows = [i for i, name in enumerate(constraints.closure_of) if name == closure.name]
    joints = sorted({i for frames in closure.joined for i in joints_between(mechanism, frames)})
    size = np.array([constraints.scale] * 3 + [1.0] * 3)
    columns = joint_jacobian(evaluation.data, mechanism.model.nv)
    twists = [columns[:, mechanism.model.idx_vs[i] + k] * size
              for i in joints for k in range(mechanism.model.nvs[i])]
    wrenches = evaluation.row_wrenches()[rows] / size
    lengths = np.linalg.norm(wrenches, axis=1, keepdims=True)
    acting = lengths[:, 0] > 0.0  # others are of the closure's third frame and on
    own = null_space(wrenches[acting] / lengths[acting])
    # an orthonormal basis of the Lie algebra that the twists, linear part first, generate
    algebra, dimension = row_space(np.vstack([*twists, own]) if twists else own, tolerance), -1
    while len(algebra) > dimension:  # it grows to dimension 6 at most
        dimension = len(algebra)
        brackets = [np.append(np.cross(a[3:], b[:3]) - np.cross(b[3:], a[:3]),
                              np.cross(a[3:], b[3:]))
                    for i, a in enumerate(algebra) for b in algebra[:i]]
        algebra = row_space(np.vstack([algebra, *brackets]), tolerance)
    names = tuple(mechanism.model.names[i] for i in joints)
    turns = rank(algebra[:, 3:], tolerance) if len(algebra) else 0
    kind = KINDS.get((len(algebra), turns), f"subgroup of dimension {len(algebra)}")
    return Loop(closure.name, names, len(algebra), kind)


def joints_between(mechanism: Mechanism, frames: Iterable[str]) -> list[int]:
    """Return the indices of the tree joints between two frames."""
    first, second = (
        set(mechanism.model.supports[mechanism.frame_on_joint(f)[0]]) for f in frames
    )
    return sorted((first ^ second) - {0})


MAX_NAMES = 8  # redundant equations named in a report: they fill one line


@dataclass(frozen=True, eq=False)
class Mobility:
    """Freedoms of a mechanism at a closed configuration; `str()` is a report.

    Attributes:
        mechanism: the mechanism.
        kutzbach: freedoms by the formula with lambda = 6 for every loop.
        grubler: freedoms by the formula with the lambda of each loop as recognised: 3 of plane and
            spherical loops.
        loops: number of independent loops.
        loop_list: the independent loops.
        rank: rank of the closure Jacobian.
        instantaneous: coordinates minus rank.
        dof: finite freedom, the largest local dimension of the closed configurations there,
            passive freedoms included.
        passive: the passive freedoms.
        redundant: names of closure equations that follow from the others there.
        overconstrained: whether there are any.

    Example:
        >>> found = sp.mobility(sp.load("four_bar"))
        >>> found.kutzbach, found.grubler, found.dof, found.loops
        (-2, 1, 1, 1)
        >>> found.overconstrained, found.redundant
        (True, ('output_pin[2]', 'output_pin[3]', 'output_pin[4]'))
    """

    mechanism: Mechanism
    kutzbach: int
    grubler: int
    loop_list: tuple[Loop, ...]
    rank: int
    instantaneous: int
    dof: int
    passive: tuple[PassiveFreedom, ...]
    redundant: tuple[str, ...]

    @property
    def loops(self) -> int:
        """Number of independent loops."""
        return len(self.loop_list)

    @property
    def overconstrained(self) -> bool:
        """Whether closure equations are redundant."""
        return bool(self.redundant)

    def _repr_html_(self) -> str:
        """Return a small table, for a notebook."""
        from spatial_pin.view.page import cards

        return cards.mobility(self)

    def __repr__(self) -> str:
        return (f"Mobility({self.mechanism.name!r}: {self.dof} freedoms, {len(self.passive)} of "
                f"them passive, {len(self.redundant)} redundant equations)")

    def __str__(self) -> str:
        mechanism = self.mechanism
        rows = constraints_of(mechanism).n_closure
        joints = len(mechanism.pairs) + self.loops
        lines = [
            f"mobility of {mechanism.name}: {self.dof}",
            f"  links {len(mechanism.pairs) + 1}, pairs {joints}, independent loops {self.loops}, "
            f"coordinates {len(mechanism.coordinates)}",
            f"  formula with 6 equations a loop (Kutzbach): {self.kutzbach}",
            f"  formula with the order of each loop (Grübler): {self.grubler}",
            *(f"    loop closed by {x.closure}: {x.kind}, order {x.order}"
              for x in self.loop_list),
            f"  closure rank {self.rank} of {rows} equations, instantaneous freedom "
            f"{self.instantaneous}",
            f"  finite freedom {self.dof}" + (
                f", of which {len(self.passive)} passive and {self.dof - len(self.passive)} working"
                if self.passive else ""),
        ]
        if self.redundant:
            names = ", ".join(self.redundant[:MAX_NAMES])
            more = f" and {len(self.redundant) - MAX_NAMES} more" * (
                len(self.redundant) > MAX_NAMES)
            lines.append(f"  redundant equations ({len(self.redundant)}): {names}{more}")
        lines += [f"  passive freedom: {p}" for p in self.passive]
        return "\n".join(lines + self._notes())

    def _notes(self) -> list[str]:
        notes = [f"  note: {joint} carries all of it as a free base: 6 of the freedoms, which are "
                 "held unless hold says otherwise" for joint in free_bases(self.mechanism)]
        if self.instantaneous > self.dof:
            notes.append(
                f"  note: {self.instantaneous - self.dof} freedom(s) are instantaneous only "
                "(they lead to no closed configuration)"
            )
        if not self.dof and (more := gap_words(self.mechanism)):
            notes.append("  note: its loops hold it" + more)
        if self.grubler != self.dof:
            notes.append(f"  note: no formula applies: special dimensions give {self.dof} "
                         f"instead of {self.grubler}")
        missing = (self.dof - len(self.passive) - len(self.mechanism.drivers)
                   - 6 * len(free_bases(self.mechanism)))
        if self.mechanism.drivers and missing > 0:
            notes.append(f"  note: {missing} more driver(s) needed to determine the motion")
        return notes


@checked
def mobility(mechanism: Mechanism, q: Array | State | None = None) -> Mobility:
    """Count the freedoms of a mechanism at a closed configuration, and name them.

    Args:
        mechanism: the mechanism.
        q: (nq,) closed configuration or a State; default the assembled guess.

    Returns:
        The Mobility; `print` it for a report.

    Raises:
        AssemblyError: no q was given and the guess does not close.
        SpatialPinError: the configuration is not closed.

    Example:
        >>> freedom = sp.mobility(sp.load("rssr"))
        >>> freedom.dof, freedom.passive[0].link, freedom.passive[0].kind
        (2, 'coupler', 'spin')
        >>> print(freedom)
        mobility of rssr: 2
          links 4, pairs 4, independent loops 1, coordinates 5
          formula with 6 equations a loop (Kutzbach): 2
          formula with the order of each loop (Grübler): 2
            loop closed by ball_b: spatial, order 6
          closure rank 3 of 3 equations, instantaneous freedom 2
          finite freedom 2, of which 1 passive and 1 working
          passive freedom: coupler spins about (-0.7774, 0.629, 0) through ball_a and ball_b
    """
    require_mechanism(mechanism)
    state = assembled(mechanism) if q is None else q
    if isinstance(state, State):
        state = of_mechanism(mechanism, state)
        mechanism, x = state.mechanism, state.q
    else:
        x = finite_array(state, (mechanism.model.nq,), "q")
        mechanism = with_independent_equations(mechanism)
    evaluation = loops_at(mechanism, x, state.angles if isinstance(state, State) else 0.0)
    if evaluation.closure_error > TOLERANCES.nothing:
        raise SpatialPinError(
            f"mechanism {mechanism.name!r}: mobility asks for a closed configuration; closure "
            f"{evaluation.worst_closure()!r} is open by {evaluation.closure_error:.1e}"
        )
    jacobian = evaluation.jacobian[: evaluation.constraints.n_closure].copy()
    every, rounding = evaluation, rounding_of(mechanism)
    if mechanism.whole is not None:  # with the equations left out of its file
        every = loops_at(mechanism.whole, x, all_angles(mechanism, evaluation.angles))
    constraints, n = every.constraints, every.constraints.n_closure
    independent = independent_rows(every.jacobian[:n],
                                   max(TOLERANCES.half_precision, rounding)).tolist()
    redundant = tuple(f"{constraints.closure_of[i]}[{constraints.row_of[i]}]"
                      for i in range(n) if i not in set(independent))
    r = rank(jacobian, TOLERANCES.half_precision)
    nv = mechanism.model.nv
    closures = [c for c in every.mechanism.closures if c.frames]
    loops = tuple(loop_of(every, c, max(ALGEBRA_TOLERANCE, rounding)) for c in closures)
    of_joints = n - constraints.n_products
    freedoms = nv + sum(6 - c.n_rows for c in closures)
    full = r == len(jacobian)
    dof = nv - r if full else finite_freedom(
        evaluation, x, null_space(jacobian, TOLERANCES.half_precision))
    passive = []
    for joint, velocities in idle_freedoms(evaluation, x):
        if dof < nv - r:  # those that are no instantaneous ones only
            tangents = decompose(velocities / mechanism.velocity_scale).vt[: len(velocities)]
            motions = finite_motions(evaluation, x, tangents)
            evaluation.update(x)
            if len(motions) < len(velocities):
                velocities = motions * mechanism.velocity_scale
        passive += [described(evaluation, joint, v) for v in velocities]
    return Mobility(
        every.mechanism,
        kutzbach=nv - n,
        grubler=freedoms - sum(loop.order for loop in loops) - of_joints,
        loop_list=loops,
        rank=r,
        instantaneous=nv - r,
        dof=dof,
        passive=tuple(passive),
        redundant=redundant,
    )


# ---------------------------------------------------------------- drivers


def driver_advice(state: State, freedom: Mobility) -> str:
    """Return advice if drivers and freedoms differ in number; otherwise an empty text."""
    mechanism = state.mechanism
    drivers = list(driver_coordinates(mechanism).values())
    working = freedom.dof - len(freedom.passive)
    entries = fixed_base_entries(mechanism, drivers)
    free = working - len(entries)
    missing = free - len(drivers)
    count = f"{counted(len(drivers), 'driver')} for {counted(working, 'working freedom')}"
    if not free and drivers:
        raise MechanismFileError(
            f"{mechanism.path}: it cannot move: {count}; {locked_loops_hint(mechanism)}")
    if not free and mechanism.closures:
        return f"it is a structure, which cannot move; if it is to, {locked_loops_hint(mechanism)}"
    if not missing:
        return ""
    evaluation = loops_at(mechanism, state.q, state.angles)
    if missing < 0:
        rows = _tangents(evaluation).T[[c.v for c in drivers]]
        independent = common_rows(rows[None], np.zeros((0, rows.shape[1])), len(drivers))
        needless = ", ".join(f"[drivers.{name}]" for k, name in enumerate(mechanism.drivers)
                             if k not in independent)
        return f"{count}; leave out {-missing}: {needless}"
    # coordinates that are independent of the drivers and move no passive freedom
    rows = _tangents(evaluation).T
    idle = [v for _, velocities in idle_freedoms(evaluation, state.q) for v in velocities]
    still = np.abs(np.array(idle)).max(axis=0, initial=0.0) if idle else np.zeros(len(rows))
    others = [c for c in mechanism.coordinate_table.values()
              if still[c.v] < TOLERANCES.half_precision and c.v not in entries]
    given = rows[[*(c.v for c in drivers), *entries]]
    names = [others[k].name for k in common_rows(rows[[c.v for c in others]][None], given, missing)]
    tables = ", ".join(f'[drivers.NAME] joint = "{name}"' for name in names)
    return f"{count}; add {counted(missing, 'driver')}{', such as ' * bool(names)}{tables}"


def _tangents(evaluation: LoopEquations) -> Array:
    """Return (freedoms, nv) velocities at which the loops stay closed."""
    return null_space(evaluation.jacobian[: evaluation.constraints.n_closure],
                      TOLERANCES.half_precision)
