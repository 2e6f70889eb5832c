"""The main job on a real mechanism: an RSSR four-bar from its URDF to numbers, plots and 3-D.

Lecture notes EMT 2431, Example 7.3: a crank of 102 mm turns at 240 rpm and rocks a link of 254 mm
through a coupler of 381 mm with a ball at either end.
"""

from __future__ import annotations

import sys
from math import acos, cos, degrees, pi, radians
from pathlib import Path

import numpy as np

import spatial_pin as sp

SPEED = 240 * 2 * pi / 60  # rad/s


def rocker_angle(phi: float, a: float, b: float, c: float, d: float) -> float:
    """Closed form of the lecture notes."""
    offset = d - a * cos(phi)
    return acos((b * b - a * a - c * c - d * d + 2 * a * d * cos(phi)) / (2 * c * offset))


def main(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    mechanism = sp.load("rssr")
    print(mechanism)

    state = sp.assemble(mechanism, {"crank": radians(60)})
    state = sp.solve_rates(mechanism, state, {"crank": SPEED})
    rocker = state.coordinate("rocker_pin")
    exact = rocker_angle(radians(60), 0.102, 0.381, 0.254, 0.314)
    print(f"crank at 60°, 240 rpm: loop closed to {state.closure_error:.1e} of its size")
    print(f"  rocker angle         {degrees(rocker.value):.10f}°  "
          f"(closed form {degrees(exact):.10f}°)")
    ratio = rocker.rate / SPEED
    print(f"  rocker speed         {rocker.rate:.8f} rad/s, {ratio:.12f} of the crank's")
    print(f"  rocker acceleration  {rocker.acceleration:.8f} rad/s²")
    print(f"  coupler ω            {state.angular_velocity('coupler').round(7)} rad/s")
    tip = sp.jacobian(mechanism, state, "rocker_b")[:3, 0]
    print(f"  tip of the rocker moves {tip.round(6)} m per rad of the crank")

    motion = sp.sweep(mechanism, "crank", np.linspace(0, 2 * pi, 361), speed=SPEED)
    print(f"one turn: {motion}")
    try:
        sp.sweep(sp.load("rssr", b=0.5), "crank", np.linspace(pi, 2 * pi, 181))
    except sp.LimitError as limit:
        print("with a coupler of 500 mm the crank cannot turn fully, and an error tells where it "
              f"stops:\n  {limit}")

    outputs = ["rocker_pin", "rocker_pin.ratio", "coupler.com.acceleration"]
    written = [
        motion.to_csv(folder / "rssr.csv"),
        folder / "rssr.png",
        sp.export_html(motion, folder / "rssr.html", look=sp.Look(traces=("coupler.com",))),
        sp.report(motion, folder / "rssr_report.html"),
    ]
    sp.plot(motion, outputs, folder / "rssr.png")
    try:
        sp.screenshot(motion, folder / "rssr_view.png")
        written.append(folder / "rssr_view.png")
    except sp.SpatialPinError as error:
        print(f"no picture of the 3-D page: {error}")
    for path in written:
        print(f"wrote {path}")
    print(f"open {folder / 'rssr.html'} (3-D) and {folder / 'rssr_report.html'} (everything) in a "
          "browser: they need no server and no network")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "demo_output"))
