"""Results about a reduced mechanism: omissions, and comparison with the full one."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from spatial_pin.mechanism.joint_limits import joint_limits
from spatial_pin.reduction.building import ReducedModel


class Difference(NamedTuple):
    """Largest difference of an output between the reduced and the full model.

    Attributes:
        output: coordinate, frame, or LINK.com.
        driver: the swept driver, or "forward dynamics".
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
    """A comparison of the reduced and the full model; `str()` is a report.

    Attributes:
        differences: one for each output and driver.
        rows: number of samples compared.
        full_seconds, reduced_seconds: how long the sweeps take, but for the first one of a
            mechanism, which prepares it [s].
        remarks: differences between the ends of the two motions, and values that were not reached.
        compared: driver and range of the comparison, in words.

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


class Omission(NamedTuple):
    """A removed part of a reduced mechanism.

    Attributes:
        what: "geometry", "inertia", "spring", "joint", "branch", "loop", "link", "leg",
            "equations", "joint limits" or "passive freedom".
        name: of the part; empty for several parts.
        why: the reason in words.

    Example:
        >>> small = sp.reduce(sp.load("rssr"), "rocker_pin")
        >>> [omission.what for omission in small.omissions]
        ['geometry', 'inertia', 'link', 'passive freedom']
        >>> small.omissions[2].name
        'coupler'
    """

    what: str
    name: str
    why: str

    def __str__(self) -> str:
        return f"{self.what}{f' {self.name}' if self.name else ''}: {self.why}"


def omissions(model: ReducedModel, locked: frozenset[int]) -> Iterator[Omission]:
    """Yield the removed parts with reasons."""
    full = model.full
    if len(full.visual_model.geometryObjects) + len(full.collision_model.geometryObjects):
        yield Omission("geometry", "", "shapes to draw and to collide")
    if not model.dynamics:
        heavy = [n for n in full.inertias if n not in model.requested.frames]
        if heavy:
            yield Omission("inertia", "", f"of {len(heavy)} links: only the motion is wanted")
        for spring in full.springs:
            yield Omission("spring", spring.name, "only the motion is wanted")
    yield from _lost_parts(model, locked)
    yield from (Omission(*note) for note in model.notes)
    gone = dict.fromkeys(
        x.name for x in joint_limits(full)
        if full.joint_id(full.coordinate(x.name).joint) not in model.moving | locked)
    if gone:
        yield Omission("joint limits", "", f"of {', '.join(gone)}: where one is passed, the full "
                                           "mechanism says so and this one does not")
    for passive in full.passives:
        if not model.keeps_spin(passive):
            yield Omission("passive freedom", passive.name, f"of {passive.body}, which is left out")


def _lost_parts(model: ReducedModel, locked: frozenset[int]) -> Iterator[Omission]:
    """Yield the removed loops, then the removed joints."""
    for k, closure in enumerate(model.full.closures):
        if k not in model.needed.closures:
            yield Omission("loop", closure.name, (
                "no output depends on it (at "
                f"{len(model.influence.configurations)} generic configurations); where it "
                "cannot close, the full mechanism stops and this one does not"))
    names = model.full.model.names
    for i in sorted(locked):
        yield Omission("joint", names[i], "locked: welded")
    for i in sorted(model.needed.welded - locked):
        yield Omission("joint", names[i], "welded: no wanted output moves with it")
    gone = [names[i] for i in range(1, model.full.model.njoints)
            if i not in model.needed.moving | model.needed.welded | locked]
    if gone:
        yield Omission("branch", "", f"no output depends on: {', '.join(gone)}")
