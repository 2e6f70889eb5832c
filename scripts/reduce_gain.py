"""What `sp.reduce` gains: time a value of a sweep of the full and of the reduced model.

    python scripts/reduce_gain.py [--rows 361 3600] [--repeats 15] [--page docs/accuracy.md]

Full and reduced sweeps take turns; times are the least, in microseconds of the processor a value,
assembly included (the reduced model remembers where it has assembled). The largest difference of
the outputs (position, rate, acceleration) comes from `verify`. For the RSSR two loops written by
hand for its one distance equation stand beside: Pinocchio for the two joints with the equation by
NumPy-free arithmetic, and plain `math` with the joints' positions written out. Both follow the
branch with a third-order predictor, correct to 1e-13 and give rates and accelerations at every
value. `--page` writes the table into a page of the documentation.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import pinocchio as pin
from benchmark.pages import cells, power, put, rounded

import spatial_pin as sp

LEGS = {f"leg_{k}": f"slide_{k}" for k in range(2, 7)}
CASES = {  # title: mechanism, outputs, what is locked, driver, first and last value
    "RSSR: rocker": ("rssr", ["rocker_pin"], [], "crank", 0.0, 2 * np.pi),
    "RSPC: guide": ("rspc", ["guide.slide"], [], "crank", 0.0, 2 * np.pi),
    "RSPC: slide": ("rspc", ["slide"], [], "crank", 0.0, 2 * np.pi),
    "Gough platform, one leg moves": ("stewart", ["platform"], list(LEGS), "leg_1", 0.385, 0.41),
    "Gough platform, six legs": ("stewart", ["platform"], [], "leg_1", 0.385, 0.41),
    "Delta: platform": ("delta", ["platform"], [], "arm_1", -0.2, 0.2),
    "four-bar: rocker": ("four_bar", ["rocker_pin"], [], "crank", 0.0, 2 * np.pi),
    "Watt six-bar: first rocker": ("watt_six_bar", ["rocker_pin"], [], "crank", 0.0, 2 * np.pi),
    "Peaucellier: inner pin": ("peaucellier", ["upper_inner_pin"], [], "crank", -0.5, 0.5),
}


def least(jobs: Sequence[Callable[[], object]], rows: int, repeats: int) -> list[float]:
    """Return the least time a value of each job [µs of the processor], the jobs taken in turn."""
    times: list[list[float]] = [[] for _ in jobs]
    for _ in range(repeats + 1):
        for job, spent in zip(jobs, times, strict=True):
            start = time.process_time()
            job()
            spent.append(1e6 * (time.process_time() - start) / rows)
    return [min(spent[1:]) for spent in times]


# ---------------------------------------------------------------- by hand


def follow(equation: Callable[..., tuple[float, ...]], values: np.ndarray, y: float) -> np.ndarray:
    """Follow f(x, y) = 0 through x; rows of y, y', y''.

    `equation(x, y)` returns f, fx, fy; with third argument True also fxx, fxy, fyy.
    """
    out = np.empty((len(values), 3))
    x, dy, ddy, before = float(values[0]), 0.0, 0.0, 0.0
    for k, value in enumerate(values.tolist()):
        h = value - x
        x = value
        y += h * (dy + 0.5 * h * (ddy + ((ddy - before) / 3.0 if k > 1 else 0.0)))
        for _ in range(8):
            f, fx, fy = equation(x, y)
            y -= f / fy
            if abs(f) < 1e-13:
                break
        _, fx, fy, fxx, fxy, fyy = equation(x, y, True)
        before = ddy
        dy = -fx / fy
        ddy = -(fxx + dy * (2.0 * fxy + dy * fyy)) / fy
        out[k] = y, dy, ddy
    return out


def rssr_by_math(a: float, b: float, c: float, d: float) -> Callable[..., tuple[float, ...]]:
    """(|AB|² - b²)/2b for A = (-a cos x, 0, a sin x), B = (-d - c cos y, c sin y, 0)."""
    sin, cos = math.sin, math.cos
    constant = 0.5 * (a * a + c * c + d * d - b * b) / b
    ad, ac, cd = a * d / b, a * c / b, c * d / b

    def equation(x: float, y: float, second: bool = False) -> tuple[float, ...]:
        sx, cx, sy, cy = sin(x), cos(x), sin(y), cos(y)
        f = constant - ad * cx + cd * cy - ac * cx * cy
        fx, fy = ad * sx + ac * sx * cy, -cd * sy + ac * cx * sy
        if not second:
            return f, fx, fy
        return f, fx, fy, ad * cx + ac * cx * cy, -ac * sx * sy, -cd * cy + ac * cx * cy

    return equation


def rssr_by_pinocchio(mechanism: sp.Mechanism) -> Callable[..., tuple[float, ...]]:
    """The same from Pinocchio's placements and Jacobians of the two joints."""
    model, (closure,) = mechanism.model, mechanism.closures
    (i, a), (j, b) = ((k, m.translation) for k, m in map(mechanism.frame_on_joint, closure.frames))
    length = closure.geometry.length
    data, q = model.createData(), np.zeros(2)
    first, second = data.oMi[i], data.oMi[j]
    jx, jy = (int(model.idx_vs[k]) for k in (i, j))
    columns, kinematics = data.J, pin.computeJointJacobians
    a, b = a.copy(), b.copy()

    def cross(u, v):
        (x, y, z), (s, t, w) = u, v
        return y * w - z * t, z * s - x * w, x * t - y * s

    def dot(u, v):
        return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]

    def equation(x: float, y: float, more: bool = False) -> tuple[float, ...]:
        q[jx], q[jy] = x, y
        kinematics(model, data, q)
        p, r = first.act(a).tolist(), second.act(b).tolist()
        (ux, uy), (vx, vy) = columns[3:, (jx, jy)].T.tolist(), columns[:3, (jx, jy)].T.tolist()
        d = [s - t for s, t in zip(r, p, strict=True)]
        dp = [s + t for s, t in zip(vx, cross(ux, p), strict=True)]
        dr = [s + t for s, t in zip(vy, cross(uy, r), strict=True)]
        f, fx, fy = (dot(d, d) - length * length) / (2.0 * length), -dot(d, dp), dot(d, dr)
        if not more:
            return f, fx / length, fy / length
        fxx = dot(dp, dp) - dot(d, cross(ux, dp))
        fyy = dot(dr, dr) + dot(d, cross(uy, dr))
        return (f, fx / length, fy / length, fxx / length, -dot(dp, dr) / length, fyy / length)

    return equation


def by_hand(rows: int, repeats: int) -> None:
    full = sp.load("rssr")
    reduced = sp.reduce(full, "rocker_pin")
    values = np.linspace(0.0, 2.0 * np.pi, rows)
    start = sp.assemble(full, {"crank": 0.0}).coordinate("rocker_pin").value
    plain = rssr_by_math(*(full.dimensions[k] for k in "abcd"))
    pinned = rssr_by_pinocchio(reduced)
    expected = sp.sweep(full, "crank", values).coordinate("rocker_pin")
    for name, equation in (("plain math", plain), ("Pinocchio", pinned)):
        found = follow(equation, values, start)
        worst = max(float(np.abs(x - y).max()) for x, y in zip(found.T, expected, strict=True))
        print(f"  hand loop, {name}: differs from the full model by {worst:.1e}")
    jobs = [lambda: sp.sweep(reduced, "crank", values), lambda: follow(pinned, values, start),
            lambda: follow(plain, values, start), lambda: sp.sweep(full, "crank", values)]
    own, pinocchio, math_only, whole = least(jobs, rows, repeats)
    print(f"  {rows} rows: reduced sweep {own:.1f} µs a row, Pinocchio by hand {pinocchio:.1f} "
          f"(ratio {own / pinocchio:.2f}), math by hand {math_only:.1f} (ratio "
          f"{own / math_only:.2f}), full sweep {whole:.1f}")


def compare(
    title: str, name: str, outputs: list[str], lock: list[str], driver: str, first: float,
    last: float, counts: Sequence[int], repeats: int,
) -> str:
    """Return a line of the table: sizes, times and difference of full and reduced model."""
    full = sp.load(name)
    reduced = sp.reduce(full, outputs, lock=lock)
    worst = reduced.verify(driver, np.linspace(first, last, 361)).worst
    sizes = [(len(m.coordinates), sp.closure_jacobian(m, m.neutral).shape[0])
             for m in (full, reduced)]
    hold = {LEGS[n]: reduced.welds[LEGS[n]] for n in lock}

    def sweep(mechanism: sp.Mechanism, held: dict[str, float], rows: int) -> sp.Motion:
        return sp.sweep(mechanism, driver, np.linspace(first, last, rows), hold=held)

    times = [least([partial(sweep, full, hold, rows), partial(sweep, reduced, {}, rows)],
                   rows, repeats) for rows in counts]
    return cells(title, *(f"{a} → {b}" for a, b in zip(*sizes, strict=True)),
                 *(f"{rounded(a)} → {rounded(b)}" for a, b in times), power(worst))


def six_legs(poses: int, repeats: int) -> None:
    """Assemble Gough's platform at random lengths of its legs, each time from its home."""
    full = sp.load("stewart")
    reduced = sp.reduce(full, ["platform"])
    lengths = 0.3926 + np.random.default_rng(1).uniform(-0.02, 0.02, (poses, 6))
    values = [{f"leg_{k}": x for k, x in enumerate(row, 1)} for row in lengths.tolist()]
    homes = [(m, sp.assemble(m)) for m in (full, reduced)]

    def assemble(mechanism: sp.Mechanism, home: sp.State) -> list[sp.State]:
        return [sp.assemble(mechanism, x, home) for x in values]

    worst = max(float(np.abs(one.placement("platform").homogeneous
                             - other.placement("platform").homogeneous).max())
                for one, other in zip(*(assemble(*home) for home in homes), strict=True))
    a, b = least([partial(assemble, *home) for home in homes], poses, repeats)
    print(f"  {poses} poses assembled: full {1e-3 * a:.2f}, reduced {1e-3 * b:.2f} ms each, "
          f"{a / b:.2f} times; difference {worst:.1e}")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--rows", type=int, nargs="+", default=[361, 3600])
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--page", type=Path, metavar="FILE", help="write the table into a page")
    options = parser.parse_args()
    lines = [cells("asked for", "coordinates", "equations",
                   *(f"{rows} values, µs each" for rows in options.rows), "difference"),
             cells(*["---"] * (4 + len(options.rows)))]
    lines += [compare(title, *case, options.rows, options.repeats) for title, case in CASES.items()]
    print("\n".join(lines))
    if options.page:
        put(options.page, "reduce", lines)
    print("Gough platform, six legs at once:")
    six_legs(20, min(options.repeats, 7))
    print("RSSR by hand:")
    for rows in options.rows:
        by_hand(rows, options.repeats)


if __name__ == "__main__":
    main()
