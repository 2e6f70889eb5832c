"""The truth about freedom: by formula, by rank, and by finite motion."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin.assembly.assemble import ACCEPTED, assembled
from spatial_pin.assembly.close import close, scaled_row
from spatial_pin.assembly.holding import free_bases, still_entries
from spatial_pin.assembly.passive_freedoms import (
    chain_links,
    driven_groups,
    is_in_loop,
    moved_bodies,
    passive_freedoms,
)
from spatial_pin.assembly.rounding import closed_there, rounding_of
from spatial_pin.assembly.state import State, all_angles, of_mechanism
from spatial_pin.checks import checked
from spatial_pin.constraints.closure_equations import Evaluation, constraints_of
from spatial_pin.constraints.pinocchio_views import joint_jacobian
from spatial_pin.errors import SpatialPinError
from spatial_pin.mechanism.coordinates import finite_array, needed
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.pairs import COUPLING
from spatial_pin.mechanism.parts import Closure
from spatial_pin.numerics.linalg import (
    Array,
    decompose,
    independent_rows,
    null_space,
    rank,
    row_space,
)

# A closed singular configuration is known to the square root of round-off only; what is nearer to
# one than this counts as singular.
SINGULAR = 1e-6
SHUT = 1e-9  # closure error with which a configuration is closed
# lengths of finite trial motions [rad, characteristic lengths], the shorter where links turn back;
# still shorter ones would take a linkage that is shaky to third order for one that moves
PROBES = (0.05, 0.005)
MOVED = 0.3  # part of it that must be left after closing to count as motion
FAR = 0.3  # rad, characteristic lengths, that a body idles on without opening a loop
SMALL_PROBE = 0.005  # the same at a configuration that was reached by the longest
TRIALS = 6  # trial motions for each instantaneous freedom
ALGEBRA_TOLERANCE = 1e-8
SIDE = 1e-9  # component of a direction that is round-off
IDLE = 1e-7  # speed by that of the fastest that is none: passive freedoms are known to 1e-8
MAX_NAMES = 8


class PassiveFreedom(NamedTuple):
    """A freedom that moves one link only, about or along an axis of its own, and no driver.

    Attributes:
        link: the link that moves.
        kind: "spin", "slide", or "screw" where it advances as it turns.
        axis: (3,) world direction of its axis at the configuration.
        point: (3,) a point of that axis in the world [m].
        text: the same in words, naming the pairs on the axis.
    """

    link: str
    kind: str
    axis: Array
    point: Array
    text: str

    def __str__(self) -> str:
        return self.text


class Loop(NamedTuple):
    """An independent loop.

    Attributes:
        closure: the closure that closes it.
        joints: the joints of the tree on its way.
        order: dimension of the motions its pairs generate (lambda in the mobility formula).
        kind: what these motions are.
    """

    closure: str
    joints: tuple[str, ...]
    order: int
    kind: str


@dataclass(frozen=True, eq=False)
class Mobility:
    """Freedoms of a mechanism at a closed configuration; `str()` is a report.

    Attributes:
        kutzbach: freedoms by the formula with lambda = 6 for every loop.
        grubler: freedoms by the formula with the lambda of each loop as recognised.
        loops: number of independent loops; `loop_list` describes them.
        rank: rank of the closure Jacobian.
        instantaneous: coordinates minus rank.
        dof: finite freedom, the largest local dimension of the closed configurations there,
            passive freedoms included.
        passive: the passive freedoms.
        redundant: names of closure equations that follow from the others there.
        overconstrained: whether there are any.
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

    def __str__(self) -> str:
        mechanism = self.mechanism
        rows = constraints_of(mechanism).n_rows
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
            f"  finite freedom {self.dof}{self._finite_words()}",
        ]
        if self.redundant:
            names = ", ".join(self.redundant[:MAX_NAMES])
            more = f" and {len(self.redundant) - MAX_NAMES} more" * (
                len(self.redundant) > MAX_NAMES)
            lines.append(f"  redundant equations ({len(self.redundant)}): {names}{more}")
        lines += [f"  passive freedom: {p}" for p in self.passive]
        return "\n".join(lines + self._notes())

    def _finite_words(self) -> str:
        working = self.dof - len(self.passive)
        return f", of which {len(self.passive)} passive and {working} working" * bool(self.passive)

    def _notes(self) -> list[str]:
        notes = [f"  note: {joint} carries all of it as a free base: 6 of the freedoms, which are "
                 "held unless hold says otherwise" for joint in free_bases(self.mechanism)]
        if self.instantaneous > self.dof:
            notes.append(
                f"  note: {self.instantaneous - self.dof} freedom(s) are instantaneous only "
                "(they lead to no closed configuration)"
            )
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

    Raises:
        AssemblyError: no q was given and the guess does not close.
        SpatialPinError: the configuration is not closed.
    """
    needed(mechanism)
    state = assembled(mechanism) if q is None else q
    if isinstance(state, State):
        state = of_mechanism(mechanism, state)
        mechanism, x = state.mechanism, state.q
    else:
        x = finite_array(state, (mechanism.model.nq,), "q")
        mechanism = closed_there(mechanism, x)
    evaluation = Evaluation(constraints_of(mechanism))
    if isinstance(state, State):
        evaluation.turns[:] = state.angles
    evaluation.update(x)
    if evaluation.closure_error > SHUT:
        raise SpatialPinError(
            f"mechanism {mechanism.name!r}: mobility asks for a closed configuration; closure "
            f"{evaluation.worst_closure()!r} is open by {evaluation.closure_error:.1e}"
        )
    jacobian = evaluation.jacobian[: evaluation.constraints.n_rows].copy()
    every, rounding = _with_all_rows(evaluation), rounding_of(mechanism)
    n, labels = every.constraints.n_rows, every.constraints.labels
    independent = independent_rows(every.jacobian[:n], max(SINGULAR, rounding)).tolist()
    redundant = tuple(f"{labels[i].closure}[{labels[i].equation}]"
                      for i in range(n) if i not in set(independent))
    r = rank(jacobian, SINGULAR)
    nv = mechanism.model.nv
    closures = [c for c in every.mechanism.closures if c.type != COUPLING]
    loops = tuple(_loop(every, c, max(ALGEBRA_TOLERANCE, rounding)) for c in closures)
    couplings = len(every.constraints.couplings)
    freedoms = nv + sum(6 - c.n_rows for c in closures)
    full = r == len(jacobian)
    dof = nv - r if full else _finite_freedom(evaluation, x, null_space(jacobian, SINGULAR))
    passive = [(joint, v) for joint, velocities in idle_freedoms(evaluation, x)
               for v in velocities]
    if dof < nv - r:  # leave out what is instantaneous only
        scale = mechanism.velocity_scale
        passive = [(joint, v) for joint, v in passive if finite_dimension(
            evaluation, x, (v / scale / np.linalg.norm(v / scale))[None])]
        evaluation.update(x)
    return Mobility(
        every.mechanism,
        kutzbach=nv - n,
        grubler=freedoms - sum(loop.order for loop in loops) - couplings,
        loop_list=loops,
        rank=r,
        instantaneous=nv - r,
        dof=dof,
        passive=tuple(_describe(evaluation, joint, v) for joint, v in passive),
        redundant=redundant,
    )


def _with_all_rows(evaluation: Evaluation) -> Evaluation:
    """Return an evaluation, at the same configuration, with the equations left out of its file."""
    mechanism = evaluation.mechanism
    if mechanism.whole is None:
        return evaluation
    every = Evaluation(constraints_of(mechanism.whole))
    every.turns[:] = all_angles(mechanism, evaluation.angles)
    every.update(evaluation.q)
    return every


# ---------------------------------------------------------------- finite freedom


def _finite_freedom(evaluation: Evaluation, q: Array, tangents: Array) -> int:
    """Return the largest dimension of the closed configurations near q, by trial motions.

    A trial moves along a random tangent and closes the loops again. Where that leaves a real
    displacement, the point found is a generic one, and the nullity there is the dimension; where
    every trial falls back to q, the freedoms are instantaneous only. (Where no equation is
    redundant, there is nothing to try: the nullity at q is the dimension.)
    """
    rng = np.random.default_rng(1)
    for probe in PROBES:
        best = _trial_motions(evaluation, q, tangents, probe, rng)
        if best:
            return best
    return 0


def _trial_motions(
    evaluation: Evaluation, q: Array, tangents: Array, probe: float, rng: np.random.Generator
) -> int:
    """Return the largest dimension of the closed configurations that trial motions come to."""
    scale = evaluation.mechanism.velocity_scale
    free = np.ones(len(scale), dtype=bool)
    n = evaluation.constraints.n_rows
    best = 0
    for _ in range(TRIALS * len(tangents)):
        direction = rng.normal(size=len(tangents)) @ tangents
        step = probe * direction / np.linalg.norm(direction)
        start = pin.integrate(evaluation.model, q, scale * step)
        found, error = close(evaluation, start, free, 1e-14)
        moved = pin.difference(evaluation.model, q, found) / scale
        if error > ACCEPTED or np.linalg.norm(moved) < MOVED * probe:
            continue
        there = null_space(evaluation.jacobian[:n], SINGULAR)
        small = probe * SMALL_PROBE / PROBES[0]
        best = max(best, len(finite_motions(evaluation, found, there, probe=small)))
        if best == len(tangents):
            break
    return best


def finite_dimension(
    evaluation: Evaluation, q: Array, tangents: Array, free: NDArray[np.bool_] | None = None
) -> int:
    """Return how many independent trial motions along `tangents` survive closing the loops at q.

    The nullity is only a bound: a part that is shaky in every configuration adds to it. For the
    arguments see `finite_motions`.
    """
    return len(finite_motions(evaluation, q, tangents, free))


def finite_motions(
    evaluation: Evaluation, q: Array, tangents: Array, free: NDArray[np.bool_] | None = None,
    probe: float = SMALL_PROBE,
) -> Array:
    """Return orthonormal scaled velocities (d, nv) that span what is left of trial motions.

    Args:
        evaluation: the closure equations; left anywhere.
        q: (nq,) closed configuration.
        tangents: (k, nv) scaled velocities that open no loop at q.
        free: (nv,) which velocities may close the loops again; default all.
        probe: length of a trial motion.
    """
    scale = evaluation.mechanism.velocity_scale
    free = np.ones(len(scale), dtype=bool) if free is None else free
    left = [np.zeros(len(scale))]
    for tangent in tangents:
        start = pin.integrate(evaluation.model, q, scale * probe * tangent)
        found, error = close(evaluation, start, free, 1e-14)
        if error <= ACCEPTED:
            left.append(pin.difference(evaluation.model, q, found) / (scale * probe))
    svd = decompose(np.array(left))
    return svd.vt[: np.count_nonzero(svd.s > MOVED)]


# ---------------------------------------------------------------- loops


def _loop(evaluation: Evaluation, closure: Closure, tolerance: float) -> Loop:
    """Recognise the loop of a closure by the motions that its pairs generate."""
    mechanism, constraints = evaluation.mechanism, evaluation.constraints
    rows = [i for i, label in enumerate(constraints.labels) if label.closure == closure.name]
    joints = joints_between(mechanism, closure.frames)
    size = np.array([constraints.scale] * 3 + [1.0] * 3)
    columns = joint_jacobian(evaluation.data, mechanism.model.nv)
    twists = [columns[:, mechanism.model.idx_vs[i] + k] * size
              for i in joints for k in range(mechanism.model.nvs[i])]
    wrenches = evaluation.wrenches[rows] / size
    own = null_space(wrenches / np.linalg.norm(wrenches, axis=1, keepdims=True))
    algebra = _generated_algebra(np.vstack([*twists, own]) if twists else own, tolerance)
    names = tuple(mechanism.model.names[i] for i in joints)
    return Loop(closure.name, names, len(algebra), _algebra_name(algebra, tolerance))


def joints_between(mechanism: Mechanism, frames: Iterable[str]) -> list[int]:
    """Return the indices of the tree joints between two frames."""
    first, second = (
        set(mechanism.model.supports[mechanism.frame_on_joint(f)[0]]) for f in frames
    )
    return sorted((first ^ second) - {0})


def _generated_algebra(twists: Array, tolerance: float) -> Array:
    """Return an orthonormal basis of the Lie algebra that twists (k, 6), linear first, generate."""
    basis = row_space(twists, tolerance)
    while True:  # it grows to dimension 6 at most
        brackets = [_bracket(a, b) for i, a in enumerate(basis) for b in basis[:i]]
        larger = row_space(np.vstack([basis, *brackets]), tolerance)
        if len(larger) <= len(basis):
            return larger
        basis = larger


def _bracket(a: Array, b: Array) -> Array:
    v, w, x, y = a[:3], a[3:], b[:3], b[3:]
    return np.concatenate([np.cross(w, x) - np.cross(y, v), np.cross(w, y)])


def _algebra_name(algebra: Array, tolerance: float) -> str:
    turns = rank(algebra[:, 3:], tolerance) if len(algebra) else 0
    names = {
        (1, 0): "one direction", (2, 0): "translations in a plane", (3, 0): "translations",
        (1, 1): "one axis", (2, 1): "one axis (turn and slide)", (3, 1): "planar",
        (4, 1): "planar with slide along the axis", (3, 3): "spherical",
        (6, 3): "spatial",
    }
    return names.get((len(algebra), turns), f"subgroup of dimension {len(algebra)}")


# ---------------------------------------------------------------- passive freedoms


def passive_freedoms_at(evaluation: Evaluation, q: Array) -> list[tuple[str, Array]]:
    """Return (joint name, (k, nv) velocities) of the links that are passive at a closed q.

    A link that hangs on one pair only is no part of a loop and not called passive.
    """
    mechanism = evaluation.mechanism
    scale, n = mechanism.velocity_scale, evaluation.constraints.n_rows
    evaluation.update(q)
    driven = [mechanism.coordinate(d.joint) for d in mechanism.drivers.values()]
    drive = [scaled_row(mechanism, c, q) for c in driven]
    drive += list(np.eye(len(scale))[list(still_entries(mechanism, driven))])
    tangents = null_space(np.vstack([evaluation.jacobian[:n], *drive]), SINGULAR) * scale
    if not len(tangents):
        return []
    return [(joint, velocities) for joint, velocities in passive_freedoms(evaluation, tangents)
            if is_in_loop(mechanism, joint)]


def idle_freedoms(
    evaluation: Evaluation, q: Array, held: Iterable[int] = ()
) -> list[tuple[str, Array]]:
    """Return (joint name, (k, nv) velocities) of the links that idle about or along own axes at q.

    Args:
        evaluation: the closure equations; left at q.
        q: (nq,) closed configuration.
        held: places in the velocity vector of coordinates that stand still, besides the drivers.
    """
    at, found = list(held), []
    for joint, velocities in passive_freedoms_at(evaluation, q):
        scaled = velocities / evaluation.mechanism.velocity_scale
        still = null_space(scaled[:, at].T / np.abs(scaled).max(), IDLE) @ velocities
        idle = [v for v in _spins_and_slides(evaluation, joint, still)
                if _goes_on(evaluation, q, joint, v)] if len(still) else []
        evaluation.update(q)
        if idle:
            found.append((joint, np.array(idle)))
    return found


def _spins_and_slides(evaluation: Evaluation, joint: str, velocities: Array) -> Array:
    """Return the motions of one body, (k, nv), recombined into pure slides and spins."""
    mechanism, i = evaluation.mechanism, evaluation.mechanism.joint_id(joint)
    columns = joint_jacobian(evaluation.data, evaluation.model.nv)
    columns = columns * evaluation.constraints.support(i)
    size = np.array([1.0, 1.0, 1.0, *[mechanism.characteristic_length] * 3])
    twists = velocities @ columns.T * size
    svd = decompose(twists[:, 3:].T, ALGEBRA_TOLERANCE)  # rows of vt combine velocities
    slides, spins = svd.vt[svd.rank :] @ velocities, svd.vt[: svd.rank] @ velocities
    if len(slides) and len(spins):  # take the slide along its axis out of each spin
        linear = slides @ columns[:3].T
        for spin in spins:
            v, w = columns[:3] @ spin, columns[3:] @ spin
            along = w * (v @ w) / (w @ w)
            spin -= decompose(linear.T, ALGEBRA_TOLERANCE).minimum_norm(along) @ slides
    return np.vstack([slides, spins])


def _goes_on(evaluation: Evaluation, q: Array, joint: str, v: Array) -> bool:
    """Whether loops stay closed as a body goes on with its velocity, given by v (nv,), for long.

    So does a link that idles about its axis, or along it. What carries a body along a curve of its
    own, like a platform on its legs, is no idle motion: its axis moves.
    """
    mechanism, i = evaluation.mechanism, evaluation.mechanism.joint_id(joint)
    size = np.array([1.0 / mechanism.characteristic_length] * 3 + [1.0] * 3)
    evaluation.update(q)
    twist = joint_jacobian(evaluation.data, evaluation.model.nv) @ (
        v * evaluation.constraints.support(i))
    pace = float(np.linalg.norm(size * twist))
    there = pin.integrate(evaluation.model, q, v * (FAR / pace))
    if not chain_links(mechanism).isdisjoint(moved_bodies(evaluation, v[None])):
        return _turns_on(evaluation, there, v, i, twist)
    evaluation.update(there)
    return bool(evaluation.closure_error < ALGEBRA_TOLERANCE)


def _turns_on(evaluation: Evaluation, q: Array, v: Array, body: int, twist: Array) -> bool:
    """Whether a body comes to about q (nq,) along its axis, as chains of hinges that carry it let.

    The hinges do not turn evenly as the body does: they close the loops again.
    """
    mechanism, data, model = evaluation.mechanism, evaluation.data, evaluation.model
    moved = moved_bodies(evaluation, v[None])
    rest = [k for k in range(1, model.njoints) if k not in moved]
    before, places = data.oMi[body].copy(), evaluation.placements[rest].copy()
    hinges = {model.names[k] for k in range(1, model.njoints)
              if k in moved or model.parents[k] in moved}
    driven = {mechanism.coordinate(d.joint) for d in mechanism.drivers.values()}
    free = np.zeros(model.nv, dtype=bool)
    free[[c.v for c in mechanism.coordinate_table.values()
          if c.joint in hinges and c not in driven]] = True
    error = close(evaluation, q, free, 1e-14)[1]
    screw = pin.log6(data.oMi[body] * before.inverse()).vector
    size = np.array([1.0 / mechanism.characteristic_length] * 3 + [1.0] * 3)
    along, way = size * twist / np.linalg.norm(size * twist), size * screw
    off = way - along * (along @ way)
    shifted = np.abs(evaluation.placements[rest] - places).max(initial=0.0)
    return bool(error <= ACCEPTED and along @ way > MOVED * FAR
                and max(np.abs(off).max(), shifted) < ALGEBRA_TOLERANCE)


def _describe(evaluation: Evaluation, joint: str, v: Array) -> PassiveFreedom:
    """Name the motion v (nv,) of the one body that it moves."""
    mechanism, model = evaluation.mechanism, evaluation.model
    i = mechanism.joint_id(joint)
    twist = joint_jacobian(evaluation.data, model.nv) @ (v * evaluation.constraints.support(i))
    link = next(f.name for f in model.frames
                if f.type == pin.FrameType.BODY and f.parentJoint == i)
    spin = float(np.linalg.norm(twist[3:])) * mechanism.characteristic_length
    if spin < 1e-6 * float(np.linalg.norm(twist[:3])):
        axis = _of_one_sense(twist[:3] / np.linalg.norm(twist[:3]))
        return PassiveFreedom(link, "slide", axis, evaluation.data.oMi[i].translation.copy(),
                              f"{link} slides along {_direction(axis)} in joint {joint}")
    omega = float(np.linalg.norm(twist[3:]))
    axis = _of_one_sense(twist[3:] / omega)
    advance = abs(float(axis @ twist[:3])) / (omega * mechanism.characteristic_length)
    point = np.cross(twist[3:], twist[:3]) / omega**2
    through = _pairs_on_axis(evaluation, i, axis, point)
    kind = "spin" if advance < 1e-6 else "screw"
    text = f"{link} {'spins' if kind == 'spin' else 'turns and advances'} about {_direction(axis)}"
    if through:
        text += f" through {' and '.join(through)}"
    return PassiveFreedom(link, kind, axis, point, text)


def _of_one_sense(axis: Array) -> Array:
    """Return an axis (3,) or its opposite, which mean the same: round-off has no say in it."""
    return -axis if axis[np.abs(axis) > SIDE][0] > 0.0 else axis


def _pairs_on_axis(evaluation: Evaluation, body: int, axis: Array, point: Array) -> list[str]:
    """Return the pairs of a body whose centres lie on an axis."""
    mechanism, model, data = evaluation.mechanism, evaluation.model, evaluation.data
    pin.updateFramePlacements(model, data)
    groups = driven_groups(mechanism)
    centres = {model.names[i]: data.oMi[i].translation for i in range(1, model.njoints)
               if groups[body] in (groups[i], groups[model.parents[i]])}
    for closure in mechanism.closures:
        for frame in (*closure.frames, *closure.between):
            if groups[mechanism.frame_on_joint(frame)[0]] == groups[body]:
                centres[closure.name] = data.oMf[mechanism.frame_id(frame)].translation
    limit = 1e-6 * mechanism.characteristic_length
    return [name for name, x in centres.items()
            if np.linalg.norm(np.cross(x - point, axis)) < limit]


def _direction(axis: Array) -> str:
    return "(" + ", ".join(f"{x:.4g}" for x in np.round(axis, 12) + 0.0) + ")"
