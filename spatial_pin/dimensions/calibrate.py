"""Calibration: dimensions, encoder offsets and the base from measurements."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from spatial_pin._support.checks import checked, names_of, positive_number
from spatial_pin._support.output_files import named_path, write_csv, write_text
from spatial_pin.assembly.assemble import assembled
from spatial_pin.assembly.state import State
from spatial_pin.dimensions.bounds import bounds_of
from spatial_pin.dimensions.homotopy import followed, varied
from spatial_pin.dimensions.measurements import (
    UNITS,
    MeasuredQuantity,
    base_from,
    encoders_of,
    read_measurements,
)
from spatial_pin.dimensions.predictions import FittedState, Predictions, Unknowns
from spatial_pin.dimensions.sensitivity import with_spread
from spatial_pin.errors import SpatialPinError, unless_cut
from spatial_pin.mechanism.coordinates import require_mechanism
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.follow import follow
from spatial_pin.numerics.least_squares import LeastSquares, minimised
from spatial_pin.numerics.linalg import Array, decompose, independent_rows
from spatial_pin.numerics.tolerances import TOLERANCES

Scalar = Callable[[Array], Array]
# By name: the loss of a squared residual z, relative to the margin's, and its derivative.
LOSSES: dict[str, tuple[Scalar, Scalar]] = {
    "linear": (lambda z: z, np.ones_like),
    "soft_l1": (lambda z: 2.0 * z / (1.0 + np.sqrt(1.0 + z)), lambda z: 1.0 / np.sqrt(1.0 + z)),
    "huber": (lambda z: np.where(z < 1.0, z, 2.0 * np.sqrt(z) - 1.0),
              lambda z: 1.0 / np.sqrt(np.maximum(z, 1.0))),
    "cauchy": (np.log1p, lambda z: 1.0 / (1.0 + z)),
    "arctan": (np.arctan, lambda z: 1.0 / (1.0 + z * z)),
}


@dataclass(frozen=True, eq=False)
class Calibration:
    """Dimensions, offsets and base that fit measurements best, with their uncertainty.

    Attributes:
        mechanism: at the calibrated dimensions.
        values: by unknown: a dimension, `DRIVER.offset`, `base.x` ... `base.rz` (the last three a
            rotation vector) [m or rad].
        nominal: start values of the unknowns [m or rad].
        sigma: standard deviations [m or rad]; infinite for unknowns that the data do not determine,
            NaN if the residuals must give them and there is no redundant number. Bounds do not
            change them.
        covariance: (n, n) in the order of `values` [m², m rad, rad²]; infinite and NaN likewise.
        residuals: (m,) model less measurement [m or rad], in the measuring axes; for a rotation in
            those of the frame. Residuals of encoders with an error come last.
        before: (m,) residuals at the start values [m or rad].
        labels: (m,) for each residual the number of its measurement, from 0, and its name.
        units: (m,) of the residuals, "m" or "rad".
        weights: (m,) weights of the residuals [-], from 0 to 1: 1 without a robust loss.
        undetermined: combinations of unknowns that the data do not determine, in words.
        base: placement of the mechanism's world in the measuring axes; None if these are the same.
        states: closed states of the mechanism at the measurements.
        is_whole: whether the search converged: False after Ctrl-C, with the best values until then.

    Example:
        >>> mech, built = sp.load("four_bar"), sp.load("four_bar", r3=0.2805)  # nominal, as built
        >>> seen = [({"crank": x}, {"rocker_pin": sp.assemble(built, {"crank": x}).q[2]})
        ...         for x in (0.0, 1.0, 2.0, 4.0)]  # encoder readings and measurements [rad]
        >>> result = sp.calibrate(mech, seen, ["r3"])
        >>> print(f"{result.nominal['r3']:.4f} m is {result.values['r3']:.4f} m")
        0.2800 m is 0.2805 m
        >>> result.residuals.shape, result.covariance.shape  # (m,) [rad], (n, n)
        ((4,), (1, 1))
        >>> result.outliers
        ()
    """

    mechanism: Mechanism
    values: dict[str, float]
    nominal: dict[str, float]
    sigma: dict[str, float]
    covariance: Array
    residuals: Array
    before: Array
    labels: tuple[tuple[int, str], ...]
    units: tuple[str, ...]
    weights: Array
    undetermined: tuple[str, ...]
    base: pin.SE3 | None
    states: tuple[State, ...]
    is_whole: bool = True

    @property
    def outliers(self) -> tuple[tuple[int, str], ...]:
        """Labels of the numbers with a weight below 0.5."""
        return tuple(x for x, w in zip(self.labels, self.weights, strict=True) if w < 0.5)

    def as_dict(self) -> dict[str, Any]:
        """Return the result as plain numbers and lists, as JSON has them: None if unknown.

        Example:
            >>> mech = sp.load("four_bar")
            >>> seen = [({"crank": x}, {"rocker_pin": sp.assemble(mech, {"crank": x}).q[2]})
            ...         for x in (0.0, 1.0, 2.0)]  # [rad]
            >>> print(f"{sp.calibrate(mech, seen, ['r3']).as_dict()['values']['r3']:.4f} m")
            0.2800 m
        """
        def plain(x: float) -> float | None:
            return float(x) if np.isfinite(x) else None

        return {
            "mechanism": self.mechanism.name, "is_whole": self.is_whole,
            "values": self.values, "nominal": self.nominal,
            "sigma": {name: plain(x) for name, x in self.sigma.items()},
            "covariance": [[plain(x) for x in row] for row in self.covariance],
            "undetermined": list(self.undetermined),
            "residuals": [{"measurement": i + 1, "of": label, "unit": unit, "residual": x,
                           "before": y, "weight": w} for (i, label), unit, x, y, w in self._rows()]}

    def _rows(self) -> Iterable[tuple[tuple[int, str], str, float, float, float]]:
        return zip(self.labels, self.units, self.residuals.tolist(), self.before.tolist(),
                   self.weights.tolist(), strict=True)

    def to_csv(self, path: str | Path) -> Path:
        """Write a row for every number measured; return the path.

        Raises:
            OSError: the file cannot be written; an older file stays.

        Example:
            >>> mech = sp.load("four_bar")
            >>> seen = [({"crank": x}, {"rocker_pin": sp.assemble(mech, {"crank": x}).q[2]})
            ...         for x in (0.0, 1.0, 2.0)]  # [rad]
            >>> sp.calibrate(mech, seen, ["r3"]).to_csv("residuals.csv").name
            'residuals.csv'
        """
        rows = [(i + 1, label, unit, x, y, w) for (i, label), unit, x, y, w in self._rows()]
        names, text = ("measurement", "of", "unit", "residual", "before", "weight"), io.StringIO()
        write_csv(text, {name: np.array([row[k] for row in rows], dtype=object)
                         for k, name in enumerate(names)}, "\n")
        return write_text(named_path(path), text.getvalue())

    def __repr__(self) -> str:
        return (f"Calibration({self.mechanism.name!r}: {len(self.values)} unknowns from "
                f"{len(self.residuals)} numbers, {len(self.undetermined)} combinations "
                f"undetermined{'' if self.is_whole else '; cut short'})")

    def __str__(self) -> str:
        poses = len(self.states)
        lines = [f"{self.mechanism.name}: {len(self.values)} unknowns from {len(self.residuals)} "
                 f"numbers of {poses} measurements{'' if self.is_whole else '; cut short'}"]
        width = max(map(len, self.values))
        for name, value in self.values.items():
            spread = self.sigma[name]
            text = with_spread(value, spread) if np.isfinite(spread) else f"{value:.6g} ± unknown"
            lines.append(f"  {name:{width}}  {text}  (was {self.nominal[name]:.6g})")
        for unit in sorted(set(self.units)):
            own = np.array([x == unit for x in self.units])
            now, was = (np.sqrt(np.mean(x[own]**2)) for x in (self.residuals, self.before))
            lines.append(f"  residuals: {now:.3g} {unit} (root mean square), {was:.3g} {unit} "
                         "before")
        if self.outliers:
            lines.append(f"  {len(self.outliers)} numbers count less than half, as outliers")
        lines += [f"  undetermined: {words}" for words in self.undetermined]
        return "\n".join(lines)


@checked
def calibrate(
    mechanism: Mechanism,
    measurements: Iterable[Any],
    dimensions: Iterable[str] | Mapping[str, Any] = (),
    *,
    offsets: Iterable[str] = (),
    base: bool | pin.SE3 = False,
    sigma: Mapping[str, float] | None = None,
    loss: str = "linear",
    margin: float = 1.5,
    guess: Mapping[str, Any] | State | Array | None = None,
) -> Calibration:
    """Find the dimensions, encoder offsets and base that fit measurements best.

    The sum of squares of the residuals is minimised. A residual is the difference between model and
    measurement, in standard deviations. Encoders are exact except for their offsets. If `sigma`
    gives their errors, the drivers' values at each pose are unknowns too. The guess decides the
    branch, which is followed along straight lines of the drivers from one measurement to the next.

    Args:
        mechanism: at its nominal dimensions.
        measurements: a pair for each pose: encoder readings of all drivers, {driver: value [rad or
            m]}, and measured values, {name: value}: a point (3,) [m] or `pinocchio.SE3` of a link,
            frame or joint, the value of a coordinate, or `targets.distance`, `targets.orientation`.
        dimensions: names of the unknown dimensions; or with bounds {name: (least, most) or None};
            None for an end is no bound, like -inf and inf.
        offsets: drivers with an encoder offset: their value is the reading plus the offset.
        base: True: points and placements were measured in axes of their own, whose placement is
            unknown; a placement: its start value.
        sigma: standard deviations, by kind {"position": m, "rotation": rad, "angle": rad, "length":
            m, "encoder": rad or m} or by name of the measured value, `DRIVER.encoder`. None: all
            equal, lengths relative to the characteristic length, and estimated from the residuals.
        loss: "linear", or robust to outliers: "soft_l1", "huber", "cauchy", "arctan", as in
            `scipy.optimize.least_squares`. These need `sigma`.
        margin: residual beyond which a robust loss treats a number as an outlier [sigma].
        guess: branch of the first measurement, as for `assemble`.

    Returns:
        The Calibration: `print` it for a report.

    Raises:
        UnknownNameError: there is no such dimension, driver, frame or coordinate.
        ValueError: there are fewer numbers than unknowns; a driver has no value; bounds, a sigma or
            the loss are not valid.
        AssemblyError: the first measurement cannot be assembled.
        SpatialPinError: another measurement cannot be reached; the drivers do not determine a
            measured value; a dimension opens the loops; the search does not converge.
        SingularError: a measurement is so near a singular configuration that no derivative has a
            digit.
        Interrupted: after Ctrl-C; `.result` has the best values until then.

    Example:
        >>> mech, built = sp.load("four_bar"), sp.load("four_bar", r3=0.2805)  # nominal, as built
        >>> seen = [({"crank": x}, {"rocker_pin": sp.assemble(built, {"crank": x}).q[2]})
        ...         for x in (0.0, 1.0, 2.0, 4.0)]  # encoder readings and measurements [rad]
        >>> result = sp.calibrate(mech, seen, ["r3"])
        >>> print(f"r3 = {result.values['r3']:.6f} m")
        r3 = 0.280500 m
    """
    require_mechanism(mechanism)
    bounds = bounds_of(mechanism, dimensions, around=True)
    if loss not in LOSSES:
        raise ValueError(f"loss is {loss!r}; it is one of {', '.join(LOSSES)}")
    if loss != "linear" and sigma is None:
        raise ValueError(f"loss {loss!r} needs sigma: it defines outliers")
    if not isinstance(base, bool | pin.SE3):
        raise TypeError("base must be True, False, or a pinocchio.SE3 to begin with, not "
                        f"{type(base).__name__}")
    margin = positive_number(margin, "margin")
    drivers, quantities = read_measurements(mechanism, measurements, sigma)
    unknowns = Unknowns.of(
        mechanism, bounds, names_of(offsets, "offsets"), base is not False, drivers,
        encoders_of(mechanism, drivers, sigma))
    n, m = len(unknowns.names), sum(len(q.labels()) for some in quantities for q in some)
    if not n:
        raise ValueError("nothing is looked for: name dimensions or offsets, or set base=True")
    if m < n:
        raise ValueError(f"{n} unknowns need as many numbers at least; {m} were measured: measure "
                         "at more poses, or look for less")
    start = _start(mechanism, drivers, guess)
    quantities = [[q.turned_to(s.mechanism, s.q) for q in some]
                  for some, s in zip(quantities, start, strict=True)]
    placement = base if isinstance(base, pin.SE3) else None
    if base is True:
        placement = base_from([(q.target, state.placement(q.target.name))
                           for state, some in zip(start, quantities, strict=True) for q in some
                           if q.kind in ("position", "rotation")])
    predictions = Predictions(FittedState(start[0].mechanism, start, placement), unknowns, drivers,
                              quantities)
    fit = CalibrationFit(predictions, loss, margin, bounds)
    return unless_cut(fit.result(quantities, sigma is None))


def _start(
    mechanism: Mechanism, drivers: list[dict[str, float]],
    guess: Mapping[str, Any] | State | Array | None,
) -> list[State]:
    """Return the states at the nominal dimensions, on the branch of the guess.

    Drivers lead along straight lines from one measurement to the next, or from the first.
    """
    states = [assembled(mechanism, drivers[0], guess)]
    for i, read in enumerate(drivers[1:], start=2):
        error = None
        for near, was in ((states[-1], drivers[i - 2]), (states[0], drivers[0])):
            begin, end = {**read, **was}, {**was, **read}
            if begin == end:
                states.append(near)
                break
            try:
                there = follow(mechanism, {name: [begin[name], x] for name, x in end.items()},
                               guess=near, on_crossing="raise").state(-1)
            except SpatialPinError as failure:
                error = error or failure
                continue
            states.append(State(there.mechanism, there.q, closure_error=there.closure_error,
                                angles=there.angles))
            break
        if len(states) < i:
            raise SpatialPinError(f"measurement {i} cannot be reached at the nominal dimensions: "
                                  f"{error}") from error
    return states


class CalibrationFit(LeastSquares):
    """The least-squares problem of a calibration, with a loss.

    Steps are those of least squares with the present weights. A loss that reduces outliers is
    concave there, and lies below the weighted squares. Bounds are those of dimensions, which are
    the first unknowns.
    """

    bends, longest, cut, most = False, 1.0, TOLERANCES.zero, 300  # with outliers some dozens
    gain = TOLERANCES.last_digit

    def __init__(
        self, predictions: Predictions, loss: str, margin: float,
        bounds: Mapping[str, tuple[float, float]],
    ) -> None:
        self._predictions, self._margin = predictions, margin
        self._loss = LOSSES[loss]
        n, k = len(predictions.sizes), len(bounds)
        self.moves = np.ones(n, dtype=bool)
        self._gauge: Array = np.empty((0, n))  # rows that are zero times the unknowns
        self.ends = np.full((2, n), np.inf) * np.array([[-1.0], [1.0]])
        if k:
            self.ends[:, :k] = (np.array([*bounds.values()]).T - predictions.nominal
                                 ) / predictions.sizes[:k]
        self._best: Array | None = None  # where the search has come to
        self._is_whole = True

    def _weights(self, errors: Array) -> Array:
        """Return the weights of errors (m,)."""
        return self._loss[1]((errors / self._margin) ** 2)

    def residual(self, x: Array) -> Array:
        """See `LeastSquares`: signed roots of the losses."""
        errors = self._predictions.errors(x)
        counts = self._loss[0]((errors / self._margin) ** 2)
        return np.append(np.copysign(self._margin * np.sqrt(counts), errors), self._gauge @ x)

    def jacobian(self, x: Array) -> Array:
        """See `LeastSquares`, of errors."""
        self._best = x.copy()
        return np.vstack([self._predictions.jacobian(x), self._gauge])

    def model(self, x: Array) -> tuple[Array, Array]:
        """See `LeastSquares`: weighted errors, whose squares have the slopes of the losses."""
        errors, rows = self._predictions.errors(x), self.jacobian(x)
        roots = np.sqrt(self._weights(errors))
        rows[: len(errors)] *= roots[:, None]
        return np.append(roots * errors, self._gauge @ x), rows

    def result(
        self, quantities: list[list[MeasuredQuantity]], scattered: bool
    ) -> Calibration:
        """Return the calibration."""
        p, names = self._predictions, self._predictions.unknowns.names
        encoders, n = p.unknowns.encoders, len(names)
        before = p.errors(np.zeros(len(p.sizes)))
        x = self._solved()
        errors, here = p.errors(x), p.at(x)
        weights = self._weights(errors)
        spread = _Spread(np.sqrt(weights)[:, None] * p.slopes(x), p.whole)
        factor = 1.0
        if scattered:
            redundancy = len(errors) - spread.rank
            factor = float(errors @ errors) / redundancy if redundancy else np.nan
        covariance = spread.covariance(p.sizes, factor)[:n, :n]
        changed = p.dimensions_at(x)
        numbers = [(i, label, UNITS[q.kind]) for i, some in enumerate(quantities)
                for q in some for label in q.labels()]
        numbers += [(e.pose, e.label, e.unit) for e in encoders]
        there = varied(here.mechanism, changed) if changed else here.mechanism
        states = [followed(there, held, state)
                  for held, state in zip(p.held(x), here.states, strict=True)]
        return Calibration(
            there, self._values(x), self._values(np.zeros(len(x))),
            dict(zip(names, np.sqrt(np.diag(covariance)).tolist(), strict=True)), covariance,
            errors * p.sigmas, before * p.sigmas, tuple((i, label) for i, label, _ in numbers),
            tuple(unit for *_, unit in numbers), weights,
            tuple(spread.words(names, p.sizes)), here.base, tuple(states), self._is_whole)

    def _solved(self) -> Array:
        """Return the values x (n,) of the unknowns.

        Combinations that the data do not determine keep their start values, by additional rows. A
        special nominal mechanism may leave more undetermined than the true one; the search then
        continues.
        """
        p = self._predictions
        x: Array = np.zeros(len(p.sizes))
        try:
            spread = _Spread(p.jacobian(x), p.whole)
            while True:
                self._gauge = spread.gauge()
                at, _, has_ended, _ = minimised(self, x, {})
                if not has_ended:
                    raise SpatialPinError(
                        "calibrate: the search has not ended after "
                        f"{self.most} steps; look for fewer unknowns, or bound them")
                x = at.x
                after = _Spread(p.jacobian(x), p.whole)
                if after.rank <= spread.rank:
                    return x
                spread = after
        except KeyboardInterrupt:
            if self._best is None:
                raise
            self._is_whole = False
            return self._best

    def _values(self, x: Array) -> dict[str, float]:
        p = self._predictions
        offsets, base = p.offsets_at(x), p.base_at(x)
        numbers = [*p.dimensions_at(x).values(), *offsets.values()]
        if p.unknowns.has_base and base is not None:
            numbers += [*base.translation, *pin.log3(base.rotation)]
        return dict(zip(p.unknowns.names, map(float, numbers), strict=True))


class _Spread:
    """Spread of unknowns, from a Jacobian with columns scaled to length one.

    Attributes:
        rank: number of determined combinations of unknowns.
    """

    def __init__(self, jacobian: Array, whole: float) -> None:
        lengths = np.linalg.norm(jacobian, axis=0)
        longest = max(float(lengths.max(initial=0.0)), whole)
        nothing = lengths <= TOLERANCES.nothing * longest  # round-off
        self._lengths: Array = np.where(nothing, longest, lengths)
        # differences have ten digits: what depends on each other has singular values of 1e-10
        self._svd = decompose(np.where(nothing, 0.0, jacobian) / self._lengths,
                              TOLERANCES.half_precision)
        self.rank = self._svd.rank

    def gauge(self) -> Array:
        """Return rows (k, n) of the undetermined combinations."""
        return self._svd.null_space * self._lengths

    def covariance(self, sizes: Array, variance: float) -> Array:
        """Return the covariance (n, n) of unknowns of these sizes, as `Calibration` has it."""
        half = self._svd.vt[: self.rank].T / self._svd.s[: self.rank]
        half = half * (sizes / self._lengths)[:, None]
        covariance: Array = variance * (half @ half.T)
        free = np.abs(self._svd.null_space).max(axis=0, initial=0.0) > TOLERANCES.half_precision
        covariance[free] = covariance[:, free] = np.nan
        covariance[free, free] = np.inf
        return covariance

    def words(self, names: tuple[str, ...], sizes: Array) -> Iterable[str]:
        """Yield undetermined combinations as sentences, each with few unknowns."""
        null = self._svd.null_space
        if not len(null):
            return
        chosen = independent_rows(null.T)
        for row in np.linalg.solve(null[:, chosen], null):
            moved = row / self._lengths  # relative to sizes
            moved /= np.abs(moved).max()
            part = [i for i in range(len(names)) if abs(moved[i]) > TOLERANCES.near_singular]
            if len(part) == 1:
                yield f"{names[part[0]]} has no effect on the measurements"
                continue
            change = sizes * moved
            change /= change[part[0]]
            changes = ", ".join(f"{names[i]} {change[i]:+.4g}" for i in part)
            yield f"changed together, {changes} have no effect on the measurements"
