"""How far a reduced mechanism is from the full one: what `Reduced.verify` returns."""

from __future__ import annotations

from typing import NamedTuple


class Difference(NamedTuple):
    """How far an output of the reduced model is from that of the full one, at worst.

    Attributes:
        output: coordinate, frame, or LINK.com.
        driver: what was swept; or "forward dynamics".
        position: [rad], or [m] by the characteristic length.
        rate: of velocities [-], relative to the largest, or to 1 rad/s or characteristic length
            per s.
        acceleration: of accelerations likewise [-].

    Example:
        >>> found = sp.reduce(sp.load("rssr"), "rocker_pin").verify().differences[0]
        >>> found.output, found.driver, found.position < 1e-10
        ('rocker_pin', 'crank', True)
    """

    output: str
    driver: str
    position: float
    rate: float
    acceleration: float


class Verification(NamedTuple):
    """What a comparison found; `str()` is a report.

    Attributes:
        differences: one for each output and driver.
        rows: number of samples compared.
        full_seconds, reduced_seconds: how long the sweeps took [s].
        remarks: where the two did not end alike, or not where they were asked to.
        compared: over which values of which driver, in words.

    Example:
        >>> found = sp.reduce(sp.load("rssr"), "rocker_pin").verify()
        >>> found.rows, found.worst < 1e-10, found.remarks
        (361, True, ())
        >>> found.compared
        ('361 rows over crank from 0 to 6.28319 rad',)
    """

    differences: tuple[Difference, ...]
    rows: int
    full_seconds: float
    reduced_seconds: float
    remarks: tuple[str, ...]
    compared: tuple[str, ...] = ()

    @property
    def worst(self) -> float:
        """The largest difference of all."""
        return max(max(d[2:]) for d in self.differences)

    def __str__(self) -> str:
        lines = [f"{self.rows} rows compared, largest difference {self.worst:.1e}; full "
                 f"{1e3 * self.full_seconds:.3g} ms, reduced {1e3 * self.reduced_seconds:.3g} ms"]
        lines += [f"  {x}" for x in self.compared]
        lines += [f"  {d.output} over {d.driver}: position {d.position:.1e}, rate {d.rate:.1e}, "
                  f"acceleration {d.acceleration:.1e}" for d in self.differences]
        return "\n".join([*lines, *(f"  note: {x}" for x in self.remarks)])
