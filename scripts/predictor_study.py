"""What the predictor's order, step, Newton corrections and the cut of a loop cost, and lose.

RSPC: one turn of the crank for every predictor order (0 to 3), step and number of corrections;
largest errors against the closed form. Predictions without corrections drift; a corrected step
starts anew each time; loose tolerances interpolate. RSSR: the same linkage with its loop cut at a
joint, in a body, and with the coupler replaced by one distance.

    python scripts/predictor_study.py --json study.json --figure study.png

Settings take turns within one run, so that noise hits all alike. Times are those of `sp.sweep`,
less those of a sweep of one value: assembly is left out, position, velocity and acceleration are
in. They are lower quartiles of the repeats, because other work on the machine only adds.
"""

from __future__ import annotations

import argparse
import gc
import importlib.util
import json
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from benchmark.report import machine
from benchmark.rssr import Problem
from benchmark.tools import OWN
from benchmark.workers import Worker
from numpy.typing import NDArray

import spatial_pin as sp

Array = NDArray[np.float64]
Job = Callable[[], Any]

ORDERS = (0, 1, 2, 3)
CORRECTIONS = (0, 1, 2, None)
DEGREES = (0.25, 0.5, 1.0, 2.0, 5.0, 10.0)
TIGHT, LOOSE = 1e-13, (1e-4, 1e-6)  # tolerances; samples are interpolated to the loose ones
SHOWN = 1.0  # step of the work-precision diagram [degrees]
LEAST_TIMED = 1440  # steps in one measurement: one turn or several
QUARTILE = 25  # percentile of the repeats that is reported
ERRORS = ("position", "velocity", "acceleration", "closure")


# RSPC: order, step, corrections


@dataclass(frozen=True)
class Rspc:
    """Closed form of the RSPC: z(φ) = (δ, x_D, u) and its derivatives with respect to φ.

    B = (l1 sinφ sinα, -l1 sinφ cosα, h + l1 cosφ), r the distance of B from the guide, b = |CF|:
    u = b (r/l2 - 1), δ = atan2(d - B_y, B_z), x_D = B_x + u a/b.
    """

    h: float = 0.30
    alpha: float = np.pi / 3.0
    d: float = 0.25
    l1: float = 0.10
    l2: float = 0.20
    a: float = 0.15

    def exact(self, phi: Array) -> Array:
        """Return (3, 3, N): z, z' and z'' for φ (N,)."""
        sin, cos = self.l1 * np.sin(phi), self.l1 * np.cos(phi)
        sa, ca, b = np.sin(self.alpha), np.cos(self.alpha), np.hypot(self.l2, self.a)
        y, y1, y2 = self.d + ca * sin, ca * cos, -ca * sin  # d - B_y
        z, z1, z2 = self.h + cos, -sin, -cos
        r = np.hypot(y, z)
        r1 = (y * y1 + z * z1) / r
        r2 = (y1 * y1 + z1 * z1 + y * y2 + z * z2 - r1 * r1) / r
        delta1 = (y1 * z - y * z1) / r**2
        delta2 = (y2 * z - y * z2) / r**2 - 2.0 * r1 * delta1 / r
        u, u1, u2 = b * (r / self.l2 - 1.0), b / self.l2 * r1, b / self.l2 * r2
        k = self.a / b
        return np.array([
            [np.arctan2(y, z), sa * sin + k * u, u],
            [delta1, sa * cos + k * u1, u1],
            [delta2, -sa * sin + k * u2, u2],
        ])

    def check(self) -> str:
        """Compare `exact` with its 40-digit numerical derivatives, where mpmath is there."""
        if importlib.util.find_spec("mpmath") is None:
            return "closed form not checked (mpmath is not installed)"
        import mpmath

        h, alpha, d, l1, l2, a = map(mpmath.mpf, asdict(self).values())

        def z(phi: Any, row: int) -> Any:
            b, y = mpmath.hypot(l2, a), d + l1 * mpmath.sin(phi) * mpmath.cos(alpha)
            height = h + l1 * mpmath.cos(phi)
            u = b * (mpmath.hypot(y, height) / l2 - 1)
            x_d = l1 * mpmath.sin(phi) * mpmath.sin(alpha) + u * a / b
            return (mpmath.atan2(y, height), x_d, u)[row]

        phi, worst = np.linspace(0.0, 2.0 * np.pi, 25), 0.0
        with mpmath.workdps(40):
            for (order, row, i), value in np.ndenumerate(self.exact(phi)):
                true = mpmath.diff(lambda x, row=row: z(x, row), phi[i], order)
                worst = max(worst, abs(float(true - value)))
        return f"closed form against 40-digit differentiation: {worst:.0e}"


COORDINATES = ("guide.angle", "guide.slide", "slide")


@dataclass(frozen=True)
class Setting:
    """One entry of the study.

    Attributes:
        order: of the predictor.
        corrections: Newton corrections a step, None for as many as the tolerance takes.
        degrees: step of the crank.
        tolerance: of these, or of interpolated samples.
    """

    order: int
    corrections: int | None
    degrees: float
    tolerance: float = TIGHT

    @property
    def steps(self) -> int:
        """Steps in a turn."""
        return round(360.0 / self.degrees)

    @property
    def values(self) -> Array:
        """(steps + 1,) crank angles of one turn [rad]."""
        return np.arange(self.steps + 1.0) * (2.0 * np.pi / self.steps)

    @property
    def accuracy(self) -> sp.Accuracy:
        """What `sp.sweep` is told."""
        return sp.Accuracy(order=self.order, corrections=self.corrections,
                           tolerance=self.tolerance)

    @property
    def loops(self) -> int:
        """Sweeps in one measurement."""
        return -(-LEAST_TIMED // self.steps)

    def run(self, mechanism: sp.Mechanism) -> None:
        """Do what is timed."""
        for _ in range(self.loops):
            self.sweep(mechanism)

    def sweep(self, mechanism: sp.Mechanism) -> sp.Motion:
        """Return the motion of one turn."""
        return sp.sweep(mechanism, "crank", self.values, accuracy=self.accuracy)


def time_in_turns(jobs: list[Job], repeats: int) -> Array:
    """Return (jobs,) seconds of one run, the lower quartile; the order changes in every round."""
    seconds = np.empty((len(jobs), repeats))
    rng = np.random.default_rng(0)
    for job in jobs:
        job()
    for k in range(repeats):
        gc.collect()
        gc.disable()
        for i in rng.permutation(len(jobs)):
            start = time.perf_counter()
            jobs[i]()
            seconds[i, k] = time.perf_counter() - start
        gc.enable()
    return np.percentile(seconds, QUARTILE, axis=1)


def judge(setting: Setting, mechanism: sp.Mechanism) -> dict[str, Any]:
    """Return largest errors [rad and lengths / characteristic length, per unit crank speed]."""
    motion = setting.sweep(mechanism)
    found = np.array([motion.coordinate(name) for name in COORDINATES]).swapaxes(0, 1)
    scale = np.array([1.0, mechanism.characteristic_length, mechanism.characteristic_length])
    gap = np.abs(found - Rspc().exact(setting.values)) / scale[:, None]
    errors = [*gap.max(axis=(1, 2)).tolist(), float(motion.closure_error.max())]
    return {**asdict(setting), **dict(zip(ERRORS, errors, strict=True)), "steps": setting.steps}


def predictor_settings() -> list[Setting]:
    """Return what is studied.

    Order 0 without corrections is left out: it predicts that nothing moves but the crank.
    """
    settings = [Setting(order, corrections, degrees) for order in ORDERS
                for corrections in CORRECTIONS if order or corrections != 0 for degrees in DEGREES]
    return settings + [Setting(3, None, degrees, tolerance) for tolerance in LOOSE
                       for degrees in DEGREES]


def predictor_jobs(mechanism: sp.Mechanism) -> list[Job]:
    """Return what is timed: a sweep of one value, then the settings."""
    jobs: list[Job] = [partial(sp.sweep, mechanism, "crank", [0.0])]
    return jobs + [partial(setting.run, mechanism) for setting in predictor_settings()]


def predictor_rows(mechanism: sp.Mechanism, seconds: Array) -> list[dict[str, Any]]:
    """Return one row per setting."""
    rows = []
    for setting, turn in zip(predictor_settings(), seconds[1:], strict=True):
        micro = 1e6 * float(turn / setting.loops - seconds[0]) / setting.steps
        rows.append({**judge(setting, mechanism), "microseconds": micro})
    return rows


# RSSR: where to cut


class Cut(NamedTuple):
    """One description of the RSSR.

    Attributes:
        title: what the table says.
        tree: the open tree in URDF; empty for the library's own model.
        rest: the closures and what else URDF cannot say, in TOML.
    """

    title: str
    tree: str = ""
    rest: str = ""

    def load(self, folder: Path) -> sp.Mechanism:
        """Write the files into a folder and load them."""
        if not self.tree:
            return sp.load("rssr")
        (folder / "cut.urdf").write_text(f'<robot name="cut">{self.tree}</robot>')
        head = 'name = "cut"\ntree = "cut.urdf"\ndrivers.crank.joint = "crank_pin"\n'
        (folder / "cut.toml").write_text(head + self.rest)
        return sp.load(folder / "cut.toml")


def link(*names: str) -> str:
    return "".join(f'<link name="{name}"/>' for name in names)


def joint(name: str, kind: str, parent: str, child: str, at: str, more: str = "") -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{at}"/>{more}</joint>'
    )


def point(name: str, on: str, at: str) -> str:
    return link(name) + joint(f"{name}_mount", "fixed", on, name, at)


def cuts(problem: Problem) -> list[Cut]:
    """Return the descriptions, the one with the fewest unknowns first."""
    a, b, c, d = problem.a, problem.b, problem.c, problem.d
    crank = link("ground", "crank") + joint(
        "crank_pin", "continuous", "ground", "crank", "0 0 0", '<axis xyz="0 1 0"/>'
    )
    rocker = link("rocker") + point("rocker_b", "rocker", f"{-c} 0 0") + joint(
        "rocker_pin", "continuous", "ground", "rocker", f"{-d} 0 0", '<axis xyz="0 0 -1"/>'
    )
    coupler = link("coupler") + joint("ball_a", "floating", "crank", "coupler", f"{-a} 0 0")
    middle, end = f"0 {b / 2} 0", f"0 {b} 0"
    return [
        Cut(
            "coupler is one distance",
            crank + rocker + point("crank_a", "crank", f"{-a} 0 0"),
            DISTANCE.format(length=b),
        ),
        Cut("cut at a ball"),
        Cut(
            "cut at a pin",
            crank + coupler + link("rocker") + point("coupler_b", "coupler", end)
            + joint("ball_b", "floating", "coupler", "rocker", end)
            + point("rocker_b", "rocker", "0 0 0")
            + point("pin", "rocker", f"{c} 0 0") + point("bearing", "ground", f"{-d} 0 0"),
            AT_PIN,
        ),
        Cut(
            "cut in the coupler",
            crank + rocker + coupler + link("far_half") + point("near", "coupler", middle)
            + joint("ball_b", "floating", "rocker", "far_half", f"{-c} 0 0")
            + point("far", "far_half", f"0 {-b / 2} 0"),
            IN_COUPLER,
        ),
    ]


DISTANCE = """
[[closures]]
name = "coupler"
type = "distance"
frames = ["crank_a", "rocker_b"]
length = {length}

[guess]
rocker_pin = 1.23
"""

AT_PIN = """
[joints]
ball_a.type = "spherical"
ball_b.type = "spherical"

[[closures]]
name = "rocker_pin"
type = "revolute"
frames = ["bearing", "pin"]

[passive.spin]
body = "coupler"
axis = ["ball_a", "coupler_b"]

[guess]
ball_a = [0, 0, 0.89]
ball_b = [0, 0, -2.12]
"""

IN_COUPLER = """
[joints]
ball_a.type = "spherical"
ball_b.type = "spherical"

[[closures]]
name = "coupler"
type = "weld"
frames = ["near", "far"]

[passive.spin]
body = "coupler"
axis = ["ball_a", "near"]

[guess]
rocker_pin = 1.23
ball_a = [0, 0, 0.89]
ball_b = [0, 0, 2.12]
"""


def rocker_tip(problem: Problem) -> Array:
    """Return (3, N, 3): position, velocity and acceleration of B from the closed form."""
    exact = problem.exact()
    psi, rate, acceleration = exact.angle, exact.rate, exact.acceleration
    zero = np.zeros_like(psi)
    radial = np.column_stack([-np.cos(psi), np.sin(psi), zero])
    tangent = np.column_stack([np.sin(psi), np.cos(psi), zero])
    bent = acceleration[:, None] * tangent - rate[:, None] ** 2 * radial
    place = problem.c * np.array([radial, rate[:, None] * tangent, bent])
    place[0] -= [problem.d, 0.0, 0.0]
    return place


def load_cuts() -> dict[str, sp.Mechanism]:
    """Return the mechanisms by title."""
    with tempfile.TemporaryDirectory() as folder:
        return {cut.title: cut.load(Path(folder)) for cut in cuts(Problem())}


def cut_jobs(mechanisms: dict[str, sp.Mechanism]) -> list[Job]:
    """Return what is timed for each description: one value, and a turn."""
    phi = Problem().phi
    return [partial(sp.sweep, mechanism, "crank", values)
            for mechanism in mechanisms.values() for values in (phi[:1], phi)]


def cut_rows(mechanisms: dict[str, sp.Mechanism], seconds: Array) -> list[dict[str, Any]]:
    """Return one row per description: size, largest errors of B [m, per unit crank speed], time."""
    problem, rows = Problem(speed=1.0), []
    exact = rocker_tip(problem)
    seconds = seconds.reshape(len(mechanisms), 2)
    micro = 1e6 * (seconds[:, 1] - seconds[:, 0]) / (len(problem.phi) - 1)
    for (title, mechanism), time_of_step in zip(mechanisms.items(), micro.tolist(), strict=True):
        motion = sp.sweep(mechanism, "crank", problem.phi)
        tip = motion.frame("rocker_b")
        found = np.array([tip.position, tip.velocity, tip.acceleration])
        errors = np.abs(found - exact).max(axis=(1, 2)).tolist()
        errors.append(float(motion.closure_error.max()))
        rows.append({
            "title": title,
            "unknowns": mechanism.model.nv - len(mechanism.drivers),
            "closure rows": sum(closure.n_rows for closure in mechanism.closures),
            "spin rows": len(mechanism.passives),
            **dict(zip(ERRORS, errors, strict=True)),
            "microseconds": time_of_step,
        })
    return rows


# Output


def title_of(row: dict[str, Any]) -> str:
    """Return what the table calls the corrections of a row."""
    if row["corrections"] is None:
        return f"{'interpolated ' * (row['tolerance'] != TIGHT)}to {row['tolerance']:g}"
    return f"{row['corrections']} correction{'s' * (row['corrections'] != 1)}"


def table(rows: list[dict[str, Any]], key: str, form: str) -> str:
    """Return one quantity: settings down, steps across."""
    lines = [" " * 30 + "".join(f"{degrees:8g}°" for degrees in DEGREES)]
    for first in rows[:: len(DEGREES)]:
        same = [r for r in rows if title_of(r) == title_of(first) and r["order"] == first["order"]]
        cells = (format(row[key], form) for row in same)
        name = f"order {first['order']}, {title_of(first)}"
        lines.append(f"{name:<30}" + "".join(f"{cell:>9}" for cell in cells))
    return "\n".join(lines)


def digest(rows: list[dict[str, Any]]) -> str:
    """Return position error and time per step at one step size, in Markdown."""
    lines = ["| order | no correction | 1 | 2 | to 1e-13 |", "|---|---|---|---|---|"]
    for order in ORDERS:
        some = {row["corrections"]: f"{row['position']:.0e}, {row['microseconds']:.1f} µs"
                for row in rows if row["order"] == order and row["degrees"] == SHOWN
                and row["tolerance"] == TIGHT}
        cells = " | ".join(some.get(corrections, "") for corrections in CORRECTIONS)
        lines.append(f"| {order} | {cells} |")
    lines += [f"| 3, {title_of(row)} | | | | {row['position']:.0e}, {row['microseconds']:.1f} µs |"
              for row in rows if row["tolerance"] != TIGHT and row["degrees"] == SHOWN]
    return "\n".join(lines)


def print_report(report: dict[str, Any]) -> None:
    """Print a study."""
    host = report["machine"]
    print(f"{host['cpu']}, {host['cores']} cores, Python {host['python']}; ", end="")
    print(", ".join(f"{name} {version}" for name, version in report["versions"].items()))
    print(f"{report['check']}\n\nRSPC, one turn; largest errors of δ, x_D and u (rad, lengths over "
          "the characteristic length, per unit crank speed)")
    for key in ERRORS:
        print(f"\n{key}\n{table(report['predictor'], key, '.0e')}")
    print(f"\nµs a step\n{table(report['predictor'], 'microseconds', '.2f')}")
    print(f"\nposition error and time per step at {SHOWN:g}°\n{digest(report['predictor'])}")
    print(f"\nRSSR, one turn in {Problem().steps} steps; largest errors of the rocker's end "
          "(m, per unit crank speed); µs a step")
    print(f"{'':<26}unknowns  equations " + "".join(f"{key:>13}" for key in ERRORS)
          + "      µs")
    for row in report["cuts"]:
        equations = f"{row['closure rows']} + {row['spin rows']}"
        print(f"{row['title']:<26}{row['unknowns']:8d}{equations:>11} "
              + "".join(f"{row[key]:13.0e}" for key in ERRORS)
              + f"{row['microseconds']:8.2f}")


COLOURS = ("#E69F00", "#009E73", "#0072B2", "#CC79A7")  # Okabe and Ito, by order
MARKERS = {0: "o", 1: "s", 2: "^", None: "D"}


def draw(report: dict[str, Any], path: Path) -> None:
    """Write the figure: error over step, time over error, time by cut."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt
    from matplotlib.lines import Line2D

    plt.rcParams.update({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False})
    figure, axes = plt.subplots(
        1, 3, figsize=(12.0, 4.2), width_ratios=(1.0, 1.1, 0.95), layout="constrained"
    )
    draw_steps(axes[0], report["predictor"])
    draw_work(axes[1], report["predictor"])
    draw_cuts(axes[2], report["cuts"])
    grey = {"color": "0.35", "linestyle": ""}
    handles = [Line2D([], [], color=COLOURS[order], lw=2.0) for order in ORDERS]
    handles += [Line2D([], [], marker=marker, mfc="white" if marker == "D" else None, **grey)
                for marker in MARKERS.values()]
    handles += [Line2D([], [], marker="P", markersize=8, color=COLOURS[3], linestyle="")]
    labels = [f"order {order}" for order in ORDERS]
    labels += ["no correction", "1 correction", "2 corrections", "to 1e-13",
               "interpolated to 1e-4, 1e-6"]
    figure.legend(handles, labels, loc="outside lower center", ncols=9, frameon=False,
                  columnspacing=1.2, handletextpad=0.4)
    figure.savefig(path, dpi=100)


def draw_steps(axes: Any, rows: list[dict[str, Any]]) -> None:
    """Draw error over step, one line per order and number of corrections."""
    for order in ORDERS:
        for corrections in (0, 1, 2):
            some = [r for r in rows if r["order"] == order and r["corrections"] == corrections]
            axes.loglog([r["degrees"] for r in some], [r["position"] for r in some], lw=1.3,
                        marker=MARKERS[corrections], markersize=5, color=COLOURS[order])
    axes.set(xlabel="step of the crank [degrees]", ylabel="largest position error of a turn",
             title="RSPC: error of predictor and corrections")
    axes.set_xticks(DEGREES, [f"{degrees:g}" for degrees in DEGREES])
    axes.minorticks_off()
    axes.grid(alpha=0.3)


def draw_work(axes: Any, rows: list[dict[str, Any]]) -> None:
    """Draw time over error at one step, one line per order."""
    shown = [r for r in rows if r["degrees"] == SHOWN]
    for order in ORDERS:
        some = [r for r in shown if r["order"] == order]
        fixed = [r for r in some if r["corrections"] is not None]
        axes.loglog([r["position"] for r in fixed], [r["microseconds"] for r in fixed],
                    color=COLOURS[order], lw=1.3)
        for row in some:
            marker = MARKERS[row["corrections"]] if row["tolerance"] == TIGHT else "P"
            axes.loglog(row["position"], row["microseconds"], color=COLOURS[order], marker=marker,
                        markersize=8 if marker == "P" else 6,
                        mfc="white" if marker == "D" else None)
    axes.set(xlabel="largest position error of a turn", ylabel="time per step [µs]",
             title=f"RSPC: time and error at steps of {SHOWN:g}°")
    ticks = (0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 5.0, 7.0, 10.0)
    axes.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    times = [r["microseconds"] for r in shown]
    axes.set(xlim=(1e-16, 0.1), ylim=(0.8 * min(times), 1.25 * max(times)))
    axes.minorticks_off()
    axes.grid(alpha=0.3)


def draw_cuts(axes: Any, rows: list[dict[str, Any]]) -> None:
    """Draw time by description of the same linkage."""
    place = np.arange(len(rows))[::-1]
    times = [row["microseconds"] for row in rows]
    bars = axes.barh(place, times, 0.5, color=COLOURS[2])
    axes.bar_label(bars, [f"{x:.2g}" for x in times], padding=3)
    names = [f"{r['title']}\n{r['unknowns']} unknown{'s' * (r['unknowns'] > 1)}" for r in rows]
    axes.set_yticks(place, names)
    axes.set(xlabel="time per step [µs]", title="RSSR: one motion, four cuts")
    axes.set_xlim(0.0, 1.2 * max(times))


def study(repeats: int) -> dict[str, list[dict[str, Any]]]:
    """Time everything in turns, and judge it."""
    rspc, mechanisms = sp.load("rspc"), load_cuts()
    model = rspc.model  # where joint limits are passed is no part of a step
    model.lowerPositionLimit = np.full(model.nq, -np.inf)
    model.upperPositionLimit = np.full(model.nq, np.inf)
    jobs, more = predictor_jobs(rspc), cut_jobs(mechanisms)
    seconds = time_in_turns([*jobs, *more], repeats)
    return {
        "predictor": predictor_rows(rspc, seconds[: len(jobs)]),
        "cuts": cut_rows(mechanisms, seconds[len(jobs) :]),
    }


def main() -> None:
    """Measure, print, save."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=25, help="interleaved repeats (25)")
    parser.add_argument("--json", type=Path, help="save the numbers in this file")
    parser.add_argument("--figure", type=Path, help="draw into this file")
    options = parser.parse_args()
    report = {
        "machine": machine(),
        "versions": {"spatial_pin": sp.__version__, **Worker(()).versions(OWN.versions)},
        "repeats": options.repeats,
        "check": Rspc().check(),
        **study(options.repeats),
    }
    print_report(report)
    if options.json:
        options.json.write_text(json.dumps(report, indent=2) + "\n")
    if options.figure:
        draw(report, options.figure)


if __name__ == "__main__":
    main()
