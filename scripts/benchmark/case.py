"""Cases: calls that are timed, and judges of their results."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

Errors = Mapping[str, float | None]


@dataclass(frozen=True)
class Case:
    """One row of the table.

    1. `setup()` builds what a user builds once, and is not timed.
    2. `run(tool)` does the work, and is timed. It starts from the same rough guess each time.
    3. `judge(tool, result)` compares the result with the truth, and is not timed.

    Attributes:
        task: a key of TASKS.
        tool: who does it.
        how: by which call, with which settings.
        setup: returns what `run` takes.
        run: returns what `judge` takes.
        judge: returns the largest error of each thing the task asks for; None for what the tool
            does not give.
        count: how many values one run solves; times are given by it.
        size: of the problem, where the task comes in sizes: values of a sweep, loops of a ladder.
        slow: leave it out of a quick run.
    """

    task: str
    tool: str
    how: str
    setup: Callable[[], Any]
    run: Callable[[Any], Any]
    judge: Callable[[Any, Any], Errors]
    count: int = 1
    size: int = 0
    slow: bool = False

    @property
    def key(self) -> str:
        """Return what names the row in saved results."""
        return " / ".join((self.task, str(self.size), self.tool, self.how))


class Absent(NamedTuple):
    """A row that is not there, and why, in words."""

    task: str
    tool: str
    why: str


class Task(NamedTuple):
    """A heading of the table.

    Attributes:
        title: of the task; {} becomes the size.
        unit: in which times are shown, µs, ms or s.
        errors: names of the errors, as the columns come.
        note: what the errors are.
    """

    title: str
    unit: str
    errors: tuple[str, ...]
    note: str


MECHANISMS = {"rssr": "RSSR", "delta": "delta robot", "stewart": "Gough platform"}
ROBOTS = {"gough": "Gough platform to placements", "delta": "delta robot to points",
          "excavator": "excavator's bucket to placements", "ankle": "G1's ankle to pitch and roll"}
RSSR = ("closure", "ψ", "ψ'", "ψ''", "ω", "α")
RSSR_NOTE = "closure [m]; rocker [rad, rad/s, rad/s²] and coupler's spin against the closed form"

TASKS: dict[str, Task] = {
    "sweep": Task("RSSR four-bar, one turn in {} values, a value", "µs", RSSR, RSSR_NOTE),
    "stewart": Task("Gough platform, one leg moved through {} values, a value", "µs",
                    ("closure", "x", "x'", "x''"),
                    "platform's centre [m, m/s, m/s²] against Newton on the six leg lengths"),
    "excavator": Task("excavator, three cylinders along a dig of {} samples, a sample", "µs",
                      ("closure", "length"), "closure relative to its size; the cylinders' and the "
                      "connecting link's lengths [m] from the angles"),
    **{f"{kind}-{robot}": Task(f"{words}, {what}", "µs", ("closure", "target", "missed"),
                               "of the targets met to 1e-5 [m, rad]; how many were not")
       for robot, words in ROBOTS.items()
       for kind, what in (("reach", "20 targets, each from home, a target"),
                          ("path", "a path of 200 targets, a target"))},
    "four_bar": Task("plane four-bar, one turn in {} values, a value", "µs", RSSR[1:4],
                     "rocker [rad, rad/s, rad/s²] against the closed form"),
    "reduced": Task("RSSR, the rocker alone asked for, {} values, a value", "µs", RSSR[1:4],
                    "rocker [rad, rad/s, rad/s²] against the closed form"),
    "smaller": Task("sweep of a full and of a reduced model, {} values, a value", "µs",
                    ("coordinates", "equations", "difference"),
                    "how many there are, and how far outputs are apart with rates"),
    "design": Task("published problems of dimensional synthesis", "s",
                   ("published", "error", "designs", "evaluations"), "of the best design, and of "
                   "the best published one; pylinkage solves those of its own tutorials"),
    "rates": Task("velocities and accelerations of one closed RSSR", "µs", RSSR[2:],
                  "rocker and coupler against the closed form"),
    "jacobian": Task("Jacobian of the RSSR's coupler with respect to its crank", "µs", ("ω",),
                     "angular part against the closed form [rad/rad]"),
    "samples": Task("RSSR, a sweep of {} values and the Jacobians of its samples, a value", "µs",
                    ("difference",), "to the Jacobian of each State"),
    "scattered": Task("delta robot, {} scattered values of its arms, a state", "µs",
                      ("closure", "difference"),
                      "closure relative to its size; joints to `assemble` there [rad, m]"),
    "mobility": Task("mobility of a Bricard mechanism, one loop", "µs", ("count",),
                     "distance from the true count, 1"),
    "assembly": Task("RSSR closed from its rough guess", "µs", ("closure", "ψ"),
                     "closure [m], rocker against the closed form [rad]"),
    "modes": Task("all configurations of a closed mechanism", "ms", ("count",),
                  "distance from the known count: 2, 40 [Dietmaier1998], 16 [ManochaCanny1994]"),
    "sensitivity": Task("how the RSSR's rocker changes with its four dimensions", "ms", ("dψ",),
                        "against differences of the closed form [rad/m]"),
    "start": Task("a fresh process: import, load the RSSR", "s", (), ""),
    "page": Task("page of the RSSR, 361 values", "ms", (), ""),
    "slider": Task("one move of a slider of a live page, until its state is there", "µs",
                   ("closure",), "of every state on the way [m]"),
    "forward": Task("forward dynamics of a ladder of {} four-bar loops", "µs", ("acceleration",),
                    "of the first rod [rad/s²] against the closed form"),
    "inverse": Task("efforts of the delta robot's drivers in motion", "µs", ("acceleration",),
                    "of forward dynamics under them, by the largest of the motion"),
    **{f"derivatives-{name}": Task(f"derivatives of forward dynamics, {words}", "µs",
                                   ("symmetry",), "of those by efforts, by the largest")
       for name, words in MECHANISMS.items()},
    "chain": Task("open chain of {} hinges", "µs", ("acceleration",),
                  "relative to the largest, by 40 digits"),
    "a02": Task("IFToMM A02, one loop, 10 s under gravity", "ms", ("angle", "closure"),
                "rod's angle at the end [rad] by elliptic functions, closure [m]"),
    "a04": Task("IFToMM A04, overconstrained Bricard cube, 10 s under gravity", "ms",
                ("position", "closure"), "of corner P3 at the end [m], closure [m]"),
    "platform": Task("Gough platform falling with six freedoms, 0.15 s, 1001 samples", "ms",
                     ("position", "closure"), "of its centre at the end [m] against a simulation "
                     "of reference accuracy, closure relative to its size"),
    "ladder": Task("load, assemble, sweep and simulate a ladder of {} four-bar loops", "s", (), ""),
    "control": Task("cycles of a controller of the delta robot", "µs", (), ""),
    **{name: Task(f"{name} falling for 10 s", "ms", ("energy", "closure"),
                  "relative to the weight's work over a leg, closure [m]")
       for name in ("five-bar", "3-RRR")},
}
FACTORS = {"µs": 1e6, "ms": 1e3, "s": 1.0}
