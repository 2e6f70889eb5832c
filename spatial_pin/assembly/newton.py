"""The square system of a closed mechanism, and what is wrong where there is none."""

from __future__ import annotations

from collections.abc import Container, Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.assembly.close import close, scaled_row
from spatial_pin.assembly.holding import BASE, SPRINGS, free_bases, still_entries
from spatial_pin.assembly.passive_freedoms import is_in_loop, passive_freedoms
from spatial_pin.constraints.closure_equations import Evaluation
from spatial_pin.errors import SingularError
from spatial_pin.mechanism.coordinates import coordinate_bias
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Coordinate, VelocityEntry
from spatial_pin.numerics.linalg import (
    EPS,
    Array,
    Factors,
    aligned,
    common_rows,
    decompose,
    independent_rows,
    pivots_of,
    rows_factored,
    rows_solved,
)
from spatial_pin.numerics.tolerances import TOLERANCES

SINGULAR_PIVOT = TOLERANCES.singular
STEP = TOLERANCES.trial_step
CORRECTIONS = 8  # Newton steps of a trial: four square a hundredth down to round-off
REGULAR_TRIALS = 4  # of which one nearly always closes, as each is short
# Part of the way on which equations would turn to dependence, by how they turn over a trial step,
# on which none is looked for again: they may turn faster farther on, but not four times.
SURE_WAY = 0.25
LONGEST_SURE = 0.1  # rad, characteristic lengths, of it at most: ten trial steps


class SquareSystem:
    """The square linear system of a mechanism whose freedoms are all driven or passive.

    Its rows are independent closure rows, resolved passive freedoms, drivers, what stands still,
    and for each passive freedom that is not resolved a row that asks for the least motion; its
    unknowns are scaled velocities.

    Attributes:
        evaluation: the closure equations at the current configuration.
        driven: the prescribed coordinates.
        still: places in the velocity vector that are zero.
        rows: indices of the independent closure rows.
        scale: (nv,) velocity of a unit of each unknown.
        passive: (k, nv) unresolved passive freedoms at the last `refresh_passive`, orthonormal.
        selected_pivot: smallest over largest pivot where the rows were selected.
        size: length of the longest independent closure row wherever they were selected.

    Args:
        evaluation: the closure equations.
        driven: the prescribed coordinates.
        q: (nq,) where rows are selected at once.
        still: default those of the free bases that nobody drives.
    """

    def __init__(
        self, evaluation: Evaluation, driven: Sequence[Coordinate], q: Array | None = None,
        still: Sequence[int] | None = None,
    ) -> None:
        self.evaluation = evaluation
        self.driven = tuple(driven)
        self.still = still_entries(evaluation.mechanism, driven) if still is None else tuple(still)
        self.scale = evaluation.mechanism.velocity_scale
        nv = evaluation.model.nv
        self._drive = np.zeros((len(self.driven) + len(self.still), nv))
        for row, v in zip(self._drive, (*self.drive_at, *self.still), strict=True):
            row[v] = 1.0
        self._drive_scale = np.array([self.scale[c.v] for c in self.driven])
        self.is_bent = any(c.q < 0 for c in self.driven)
        self._bent = [(k, c) for k, c in enumerate(self.driven)
                      if c.q < 0 and not isinstance(c, VelocityEntry)]
        self.matrix = np.zeros((nv, nv))
        self._whole = False
        self.size = 0.0
        if q is not None:
            self.select(q)

    def _aim(self) -> None:
        """Turn the rows of driven coordinates whose rates are no entries of the velocity."""
        evaluation = self.evaluation
        for k, c in self._bent:
            self._drive[k] = scaled_row(evaluation.mechanism, c, evaluation.q)

    def select(self, q: Array) -> None:
        """Choose the independent rows at q.

        Raises:
            SingularError: the drivers are not independent there, or a freedom is not driven.
        """
        evaluation = self.evaluation
        evaluation.update(q)
        self._aim()
        n, p, d = evaluation.constraints.n_rows, evaluation.constraints.n_passive, len(self._drive)
        self.rows = independent_rows(evaluation.jacobian[:n])
        r = len(self.rows)
        lengths = np.linalg.norm(evaluation.jacobian[self.rows], axis=1)
        self.size = max(self.size, float(lengths.max(initial=0.0)))
        regular = np.vstack([evaluation.jacobian[self.rows], evaluation.jacobian[n:], self._drive])
        svd = decompose(regular)
        if svd.rank < r + p + d:
            raise SingularError(self._dependence(np.delete(
                regular, slice(r + p, r + p + len(self.driven)), axis=0)))
        self.passive = svd.null_space
        if len(self.passive):
            self._check_passive(q)
        self._whole = r == n and not len(self.passive)
        self._closure = slice(0, r)
        self._spin = slice(r, r + p)
        self._drivers = slice(r + p, r + p + len(self.driven))
        self._prescribed = slice(r + p, r + p + d)
        self._fill = slice(r + p + d, None)
        self.matrix[self._prescribed] = self._drive
        self.matrix[self._fill] = self.passive
        if self._whole:  # let the evaluation write its Jacobian straight into the matrix
            evaluation.jacobian = self.matrix[: r + p]
        elif evaluation.jacobian.base is not None:
            evaluation.jacobian = np.zeros((n + p, evaluation.model.nv))
        self._rhs = np.zeros(len(self.matrix))
        evaluation.update(q)
        self.factor()
        self.selected_pivot = self.pivots()[1]

    def move(self, q: Array) -> None:
        """Go to q, with the rows chosen before if that is a choice that any q would make.

        Raises:
            SingularError: as `select`.
        """
        self.evaluation.update(q)
        if self._whole and self.factor() and self.pivots()[1] > TOLERANCES.regular:
            return
        self.select(q)

    @property
    def has_redundant_rows(self) -> bool:
        """Whether closure rows were left out because they follow from the others."""
        return len(self.rows) < self.evaluation.constraints.n_rows

    def _dependence(self, closures: Array) -> str:
        """Return why drivers are not independent, from the rows of all else."""
        names = ", ".join(repr(c.name) for c in self.driven)
        where = f"mechanism {self.evaluation.mechanism.name!r}: "
        drive = self._drive[: len(self.driven)]
        if self.still and decompose(closures).rank < len(closures):
            return (f"{where}what is held cannot all stand still beside the loops and the base: "
                    "they move it together; hold less")
        freedom = closures.shape[1] - decompose(closures).rank
        moving = drive @ decompose(closures).null_space.T
        if freedom < len(self.driven):
            rank = decompose(closures, TOLERANCES.near_singular).rank
            if closures.shape[1] - rank >= len(self.driven):
                return (f"{where}singular configuration: branches cross so near that round-off "
                        "hides which equations depend on others; start further from it")
            kept = common_rows(moving[None], np.zeros((0, freedom)), freedom)
            more = ", ".join(repr(c.name) for k, c in enumerate(self.driven) if k not in kept)
            return (f"{where}{len(self.driven)} coordinates are prescribed ({names}), but the "
                    f"closed mechanism has {freedom} freedom{'s' * (freedom != 1)} there; "
                    f"prescribe fewer: leave out {len(self.driven) - freedom}, such as {more}, "
                    "which the others move")
        moved = np.abs(moving).max(axis=1, initial=0.0)
        stuck = ", ".join(repr(c.name) for c, m in zip(self.driven, moved, strict=True)
                          if m < TOLERANCES.near_singular)
        if stuck:
            return (f"{where}singular configuration: {stuck} is at a limit position (dead centre) "
                    "there, where no speed of it moves the mechanism; start beside it, or "
                    "prescribe another coordinate")
        kept = common_rows(moving[None], np.zeros((0, moving.shape[1])), len(self.driven))
        follow = [repr(c.name) for k, c in enumerate(self.driven) if k not in kept]
        return (f"{where}singular configuration: the prescribed {names} depend on each other "
                f"there, for the loops let them move together only: {', '.join(follow)} "
                f"go{'es' * (len(follow) == 1)} as the others do; prescribe another coordinate "
                "instead")

    def _check_passive(self, q: Array) -> None:
        """Refuse freedoms that are not the motion of one link: somebody must drive them."""
        mechanism, null_space = self.evaluation.mechanism, self.passive
        found = [(joint, v) for joint, v in passive_freedoms(
            self.evaluation, null_space * self.scale, self.driven)
                 if joint not in free_bases(mechanism)]
        determined = sum(len(v) for _, v in found) == len(null_space)
        if determined:
            self._check_free()
        self.check_regular(q)
        if determined:
            return
        missing = len(null_space) - sum(len(v) for joint, v in found if is_in_loop(
            mechanism, joint))  # a link that hangs at an end is prescribed with the rest
        moving = np.abs(null_space).max(axis=0) > 1e-8 * np.abs(null_space).max()
        names = [c for c, m in zip(mechanism.coordinates, moving, strict=True) if m]
        picked = independent_rows(np.where(moving[:, None], null_space.T, 0.0))[:missing]
        chosen = [mechanism.coordinates[v] for v in sorted(picked)]
        given = ", ".join(repr(c.name) for c in self.driven) or "nothing"
        raise SingularError(
            f"mechanism {mechanism.name!r}: {given} is prescribed, and {missing} of its freedoms "
            f"are not prescribed; prescribe {missing} more of {', '.join(names)}, such as "
            + _ways_to_prescribe(mechanism, chosen, set(names)))

    def check_regular(self, q: Array) -> None:
        """Refuse a configuration q at which the loops lose independent equations.

        Also where the freedom won moves one link only, like a passive one: a single distance whose
        row vanishes frees the link it holds. And where there seem to be as many freedoms as
        drivers, but they are instantaneous only.
        """
        lost = rank_loss(self.evaluation, q, len(self.rows))
        if lost:
            raise SingularError(f"mechanism {self.evaluation.mechanism.name!r}: "
                                + lost_rank(self.evaluation, q, lost, "drivers"))

    def _check_free(self) -> None:
        """Refuse passive freedoms that closures do hold, by a lever too short to be of use."""
        evaluation = self.evaluation
        n = evaluation.constraints.n_rows
        held = np.abs(evaluation.jacobian[:n] @ self.passive.T).max(axis=1, initial=0.0)
        if held.max(initial=0.0) > TOLERANCES.zero:
            mechanism, row = evaluation.mechanism, int(held.argmax())
            sizes = np.abs(self.passive).max(axis=0)
            names = [c for c, s in zip(mechanism.coordinates, sizes, strict=True) if s > 1e-6]
            raise SingularError(
                f"mechanism {mechanism.name!r}: {', '.join(names)}: closure "
                f"{evaluation.constraints.labels[row].closure!r} holds them by a lever of only "
                f"{held[row]:.0e} of the mechanism's size; no digit of their rates is reliable")

    def factor(self) -> bool:
        """Factor the matrix at the evaluation's configuration; False when it is singular."""
        k = self.matrix
        if self._bent:
            self._aim()
            k[self._prescribed] = self._drive
        if not self._whole:
            jacobian, n = self.evaluation.jacobian, self.evaluation.constraints.n_rows
            k[self._closure] = jacobian[self.rows]
            k[self._spin] = jacobian[n:]
            k[self._fill] = self.passive
        self._lu, self._pivots, is_regular = rows_factored(k)
        return is_regular

    def refresh_passive(self) -> None:
        """Recompute the unresolved passive freedoms, oriented as before."""
        if not len(self.passive):
            return
        n, jacobian = self.evaluation.constraints.n_rows, self.evaluation.jacobian
        regular = np.vstack([jacobian[self.rows], jacobian[n:], self._drive])
        null_space = decompose(regular).null_space
        if len(null_space) == len(self.passive):
            self.passive = aligned(null_space, self.passive)

    def pivots(self) -> tuple[int, float]:
        """Return the sign of the determinant, and smallest over largest pivot, as last factored."""
        return pivots_of(self._lu, self._pivots)

    def solve(self, rhs: Array) -> Array:
        """Solve the factored system for (nv,) or (nv, k) right-hand sides; unknowns are scaled."""
        return rows_solved(self._lu, self._pivots, rhs)

    def correction(self, spun: Sequence[float] = ()) -> Array:
        """Return the Newton correction (nv,), scaled, that closes the loops, drivers held.

        Args:
            spun: spin of each resolved passive freedom to take back [rad].
        """
        rhs = self._rhs
        for k, angle in enumerate(spun, start=self._spin.start):
            rhs[k] = -angle
        residual = self.evaluation.residual
        np.negative(residual if self._whole else residual[self.rows], out=rhs[self._closure])
        return self.solve(rhs)

    @property
    def drive_at(self) -> list[int]:
        """Places of the driven coordinates in the velocity vector."""
        return [c.v for c in self.driven]

    @property
    def driver_rows(self) -> slice:
        """Rows of the matrix that prescribe the drivers."""
        return self._drivers

    @property
    def prescribed_rows(self) -> slice:
        """Rows of the matrix that prescribe the drivers, then what stands still."""
        return self._prescribed

    @property
    def closure_rows(self) -> slice:
        """Rows of the matrix that close the loops."""
        return self._closure

    @property
    def spin_rows(self) -> slice:
        """Rows of the matrix that hold the resolved passive freedoms."""
        return self._spin

    def driver_rates(self) -> Array:
        """Return (nv, n_drivers): joint velocities per unit speed of each driver."""
        rhs = np.zeros((len(self.matrix), len(self.driven)))
        rhs[self._drivers] = np.diag(1.0 / self._drive_scale)
        return self.scale[:, None] * self.solve(rhs)

    def acceleration(self, q: Array, v: Array, drive: Array) -> Array:
        """Return (nv,) joint accelerations at velocity v for driver accelerations (n_drivers,)."""
        for k, c in self._bent:
            drive = drive.copy()
            drive[k] -= coordinate_bias(self.evaluation.mechanism, c, q, v)
        return self._answer(self.evaluation.bias(q, v), drive)

    def rates_of(self, bias: Array, drive: Array) -> Array:
        """Return the joint rates (nv,), of any order, that answer a bias and prescribed rates.

        Args:
            bias: (n_rows + n_passive,) derivative of the rows at zero joint rates of that order.
            drive: (n_drivers,) derivatives of the driven coordinates.

        Raises:
            MechanismFileError: a driven coordinate is a component of a ball or a floating joint.
        """
        for _, c in self._bent:
            self.evaluation.mechanism.driven_coordinate(c.name)  # refuses it
        return self._answer(bias, drive)

    def _answer(self, bias: Array, drive: Array) -> Array:
        n = self.evaluation.constraints.n_rows
        rhs = np.zeros(len(self.matrix))
        np.negative(bias[:n] if self._whole else bias[self.rows], out=rhs[self._closure])
        np.negative(bias[n:], out=rhs[self._spin])
        rhs[self._drivers] = drive / self._drive_scale
        rates: Array = self.scale * self.solve(rhs)
        if not self._bent:
            rates[self.drive_at] = drive  # as asked for, to the last digit
        return rates


def _ways_to_prescribe(mechanism: Mechanism, names: Sequence[str], moving: Container[str]) -> str:
    """Return how coordinates are prescribed, for messages; `moving` are all that are not."""
    rates = ", ".join(f"{name!r}: 0.0" for name in names)
    base = [BASE] if free_bases(mechanism) else []
    said = (f"solve_rates(..., {{{rates}}}), sweep(..., hold={[*base, *names]}) or "
            f"jacobian(..., drivers=[...]); each may have a [drivers.name] in the file too")
    springs = [spring.joint for spring in mechanism.springs if spring.joint in moving]
    return said + f"; hold={[*base, SPRINGS]} stops the joints with springs" * bool(springs)


class Regular(NamedTuple):
    """A configuration at which the loops lose no equation, and none near it.

    Attributes:
        q: the configuration (nq,).
        rank: of its closure rows.
        radius: how far off others with that rank are regular too [rad, characteristic lengths]:
            rows turn by so little on the way that those chosen here stay independent.
    """

    q: Array
    rank: int
    radius: float

    def holds(self, mechanism: Mechanism, q: Array, rank: int) -> bool:
        """Whether q (nq,), where the rows have this rank, is so near that it is regular too."""
        if rank != self.rank:
            return False
        away = pin.difference(mechanism.model, self.q, q) / mechanism.velocity_scale
        return bool(np.abs(away).max(initial=0.0) <= self.radius)


def rank_loss(evaluation: Evaluation, q: Array, rank: int) -> int:
    """Return how many independent equations the loops lose at q, where their rank is `rank`.

    As many independent rows as that leave a surface through q of as many dimensions as there are
    freedoms at q. Where no equation is lost, the loops are closed on all of it; where branches
    cross, or a freedom is instantaneous only, the other rows open on it: with the second power of
    the way, as a rule [ConnellyWhiteley1996], but a step shows any.

    Args:
        evaluation: the closure equations, their turns at q; it comes back to q.
        q: (nq,) closed configuration.
        rank: of the closure rows there.
    """
    n, nv = evaluation.constraints.n_rows, evaluation.model.nv
    if rank in (n, nv):
        return 0
    known: Regular | None = evaluation.regular
    if known is not None and known.holds(evaluation.mechanism, q, rank):
        return 0
    evaluation.update(q)
    jacobian, error = evaluation.jacobian[:n].copy(), evaluation.closure_error
    svd = decompose(jacobian[independent_rows(jacobian)])
    opened = _opened(evaluation, q, svd.null_space)
    shut = max(TOLERANCES.closed, 2.0 * error)
    if opened is not None and opened < shut:
        turned = np.linalg.norm(evaluation.jacobian[:n] - jacobian) / STEP
        radius = SURE_WAY * svd.s[-1] / max(turned, EPS) if rank else 0.0
        evaluation.regular = Regular(q.copy(), rank, min(float(radius), LONGEST_SURE))
        evaluation.update(q)
        return 0
    lost = _generic_rank(evaluation, q) - rank
    evaluation.update(q)
    return max(lost, int(opened is not None))


def _opened(evaluation: Evaluation, q: Array, freedoms: Array) -> float | None:
    """Return by how much the loops are open a step from q, on the surface of independent rows.

    The step is a random one of the freedoms (k, nv), scaled, which that surface has at q. None if
    it was not found; the evaluation is left there.
    """
    n, scale = evaluation.constraints.n_rows, evaluation.mechanism.velocity_scale
    rows = independent_rows(evaluation.jacobian[:n])
    v = np.random.default_rng(3).standard_normal(len(freedoms)) @ freedoms
    there = pin.integrate(evaluation.model, q, scale * v * (STEP / float(np.linalg.norm(v))))
    rhs, last = np.zeros(evaluation.model.nv), np.inf
    for _ in range(CORRECTIONS):
        evaluation.update(there)
        residual = evaluation.residual[rows]
        size = float(np.abs(residual).max(initial=0.0))
        if size <= EPS or (size <= TOLERANCES.closed and size > 0.5 * last):
            return evaluation.closure_error
        last = size
        rhs[: len(rows)] = -residual
        x = Factors(np.vstack([evaluation.jacobian[rows], freedoms])).solve(rhs)
        if not np.linalg.norm(x) < STEP:
            return None
        there = pin.integrate(evaluation.model, there, scale * x)
    return None


def _generic_rank(evaluation: Evaluation, q: Array) -> int:
    """Return the closure rank at closed configurations near q."""
    n, model = evaluation.constraints.n_rows, evaluation.model
    free = np.ones(model.nv, dtype=bool)
    rng = np.random.default_rng(3)
    best = 0
    for _ in range(REGULAR_TRIALS):
        step = evaluation.mechanism.velocity_scale * rng.uniform(-0.02, 0.02, model.nv)
        _, error = close(evaluation, pin.integrate(model, q, step), free, TOLERANCES.zero)
        if error <= TOLERANCES.closed:
            best = max(best, len(independent_rows(evaluation.jacobian[:n])))
    return best


def _ways(evaluation: Evaluation, q: Array) -> int:
    """Return in how many independent ways steps from q go on when loops are closed again."""
    evaluation.update(q)
    n, scale = evaluation.constraints.n_rows, evaluation.mechanism.velocity_scale
    freedoms = decompose(evaluation.jacobian[:n]).null_space
    free, rng = np.ones(len(scale), dtype=bool), np.random.default_rng(3)
    left = []
    for _ in range(REGULAR_TRIALS * len(freedoms)):
        v = rng.standard_normal(len(freedoms)) @ freedoms
        start = pin.integrate(evaluation.model, q, scale * v * (STEP / float(np.linalg.norm(v))))
        there, error = close(evaluation, start, free, TOLERANCES.zero)
        moved = pin.difference(evaluation.model, q, there) / (scale * STEP)
        if error <= TOLERANCES.closed and np.linalg.norm(moved) > TOLERANCES.moved:
            left.append(moved / np.linalg.norm(moved))
    evaluation.update(q)
    return int(np.count_nonzero(decompose(np.array(left)).s > TOLERANCES.moved)) if left else 0


def lost_rank(evaluation: Evaluation, q: Array, lost: int, motion: str) -> str:
    """Return why nothing determines the motion at q, in words, where the loops lose equations.

    Args:
        evaluation: the closure equations; it comes back to q.
        q: (nq,) closed configuration.
        lost: how many equations.
        motion: what would determine the motion elsewhere.
    """
    n, ways = evaluation.constraints.n_rows, _ways(evaluation, q)
    freedoms = evaluation.model.nv - len(independent_rows(evaluation.jacobian[:n]))
    equations = f"{lost} independent equation{'s' * (lost != 1)}"
    text = f"singular configuration: the loops lose {equations} there, and "
    if ways <= freedoms - lost:
        nothing = "nothing can move: " * (not ways)
        shaken = f"{lost} freedom{' is' if lost == 1 else 's are'} instantaneous only"
        return f"{text}{nothing}{shaken}: it shakes, but goes nowhere (see sp.mobility)"
    return (f"{text}branches cross, so that the {motion} do not determine the motion; start "
            "beside this configuration")
