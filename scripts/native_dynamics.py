"""Forward dynamics through Pinocchio's constraintDynamics and through our rows, side by side.

For every mechanism of the library whose closures Pinocchio can express, and for longer and longer
ladders: time of the public `forward_dynamics` both ways, of the bare call below it, and by how much
the accelerations differ. `dynamics/solvers/constraint_dynamics.py` takes its limits from here.

Other pairs have a native form too: the cut body in two halves welded together, the pair a joint of
the tree. The coordinate of that joint has to be found first, which is part of the second table.

    python scripts/native_dynamics.py [--repeats 60] [--loops 1 5 10 20] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # small matrices: threads only get in the way

import numpy as np
import pinocchio as pin

import spatial_pin as sp
from spatial_pin.accuracy.models import ladder
from spatial_pin.dynamics.solvers.choose import equations_of
from spatial_pin.dynamics.solvers.constraint_dynamics import NativeDynamics, native_models
from spatial_pin.mechanism.inertia import MassMatrix

# joints of a pair about and along z, and their coordinates among (3 angles, 3 lengths)
PARTS = {"prismatic": (pin.JointModelPZ,), "cylindrical": (pin.JointModelRZ, pin.JointModelPZ),
         "planar": (pin.JointModelPX, pin.JointModelPY, pin.JointModelRZ)}
PLACES = {"prismatic": (5,), "cylindrical": (2, 5), "planar": (3, 4, 2)}
CALLS = 10  # in one measurement; the least of many is what a quiet machine takes


def seconds(call: Callable[[], Any]) -> float:
    begin = time.perf_counter()
    for _ in range(CALLS):
        call()
    return (time.perf_counter() - begin) / CALLS


def compare(mechanism: sp.Mechanism, state: sp.State, repeats: int) -> dict[str, Any] | None:
    """Measure one mechanism, the ways in turns; None if Pinocchio cannot express it."""
    try:
        models = native_models(mechanism)
    except sp.ClosureTypeError:
        return None
    if not models:
        return None
    native = NativeDynamics(mechanism, MassMatrix(mechanism.model), models)
    none = np.zeros(mechanism.model.nv)

    def taking(which: NativeDynamics | None) -> Callable[[], Any]:
        def run() -> Any:
            with equations_of(mechanism) as equations:
                equations.asked, equations.native = True, which
            return sp.forward_dynamics(mechanism, state)
        return run

    ways = {"bare": lambda: pin.constraintDynamics(
                native.model, native.data, state.q, state.v, none, native.models, native.datas,
                native.settings),
            "checked": lambda: native.accelerations(state.q, state.v, none),
            "public": taking(native), "rows": taking(None)}
    times: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(repeats):
        for name, call in ways.items():
            times[name].append(seconds(call))
    ours, theirs = ways["rows"]().a, ways["checked"]()
    differ = (float(np.abs(ours - theirs).max() / np.abs(ours).max(initial=1e-300))
              if theirs is not None else float("nan"))
    return {"name": mechanism.name, "freedoms": mechanism.model.nv,
            "rows": sum(m.residualSize() for m in models), "difference": differ,
            **{f"{name}_us": 1e6 * min(t) for name, t in times.items()}}


class Halves:
    """A mechanism with one closure as `constraintDynamics` takes it, its cut body in two halves.

    The second body gives half of its inertia to a body on the pair's joint, welded to it.
    """

    def __init__(self, mechanism: sp.Mechanism) -> None:
        (closure,) = mechanism.closures
        ends = [mechanism.frame_on_joint(f) for f in closure.frames]
        axes = closure.geometry.axes1, closure.geometry.axes2
        self.ends = [(i, m * pin.SE3(x, np.zeros(3))) for (i, m), x in zip(ends, axes, strict=True)]
        if not self.ends[1][0]:
            raise ValueError("the ground cannot be halved")
        (i1, at1), (i2, at2) = self.ends
        joint = pin.JointModelComposite()
        for part in PARTS[closure.type]:
            joint.addJoint(part())
        self.places = PLACES[closure.type]
        self.whole, self.whole_data = mechanism.model, mechanism.model.createData()
        self.model = mechanism.model.copy()
        half = self.model.addJoint(i1, joint, at1, "half")
        inertia = self.model.inertias[i2]
        shared = pin.Inertia(0.5 * inertia.mass, inertia.lever, 0.5 * inertia.inertia)
        self.model.inertias[i2] = shared
        self.model.appendBodyToJoint(half, at2.actInv(shared), pin.SE3.Identity())
        weld = pin.RigidConstraintModel(pin.ContactType.CONTACT_6D, self.model, half,
                                        pin.SE3.Identity(), i2, at2, pin.ReferenceFrame.LOCAL)
        self.data = self.model.createData()
        self.models = pin.StdVec_RigidConstraintModel([weld])
        self.datas = pin.StdVec_RigidConstraintData([weld.createData()])
        pin.initConstraintDynamics(self.model, self.data, self.models, self.datas)
        self.settings = pin.ProximalSettings(0.0, 1e-10, 4)
        self.q_at, self.at = self.model.idx_qs[half], self.model.idx_vs[half]
        self.rest = np.zeros(self.model.nv)
        self.old = np.delete(np.arange(self.model.nv), slice(self.at, self.at + len(self.places)))

    def __call__(self, q: Any, v: Any) -> Any:
        """Return the accelerations (nv,) of the mechanism, under no forces but gravity."""
        pin.forwardKinematics(self.whole, self.whole_data, q, v)
        data, ((i1, at1), (i2, at2)) = self.whole_data, self.ends
        m = (data.oMi[i1] * at1).actInv(data.oMi[i2] * at2)
        rate = at2.actInv(data.v[i2]) - m.actInv(at1.actInv(data.v[i1]))
        r = m.rotation
        place = np.array([0.0, 0.0, np.arctan2(r[1, 0], r[0, 0]), *m.translation])
        pace = np.concatenate([r @ rate.angular, r @ rate.linear])
        places = list(self.places)
        q, v = np.insert(q, self.q_at, place[places]), np.insert(v, self.at, pace[places])
        a = pin.constraintDynamics(self.model, self.data, q, v, self.rest, self.models, self.datas,
                                   self.settings)
        return a[self.old]


def compare_halves(name: str, repeats: int) -> dict[str, Any]:
    """Measure one mechanism of the library whose closure is a prismatic or a planar pair."""
    mechanism = sp.load(name)
    state = sp.solve_rates(mechanism, sp.assemble(mechanism, {}),
                           dict.fromkeys(mechanism.drivers, 0.7))
    halves = Halves(mechanism)
    ways = {"halves": lambda: halves(state.q, state.v),
            "rows": lambda: sp.forward_dynamics(mechanism, state)}
    times: dict[str, list[float]] = {way: [] for way in ways}
    for _ in range(repeats):
        for way, call in ways.items():
            times[way].append(seconds(call))
    want = ways["rows"]().a
    return {"name": name, "difference": float(np.abs(ways["halves"]() - want).max()
                                              / np.abs(want).max()),
            **{f"{way}_us": 1e6 * min(t) for way, t in times.items()}}


def leaning(windows: int) -> tuple[sp.Mechanism, sp.State]:
    mechanism, angle = ladder(windows), 0.5
    guess = ({f"pin_{i}": -angle for i in range(windows + 1)}
             | {f"knee_{i}": angle for i in range(windows)})
    state = sp.assemble(mechanism, {"pin_0": -angle}, guess)
    return mechanism, sp.solve_rates(mechanism, state, {"pin_0": -1.0})


def main() -> None:
    """Measure, print, save."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=60)
    parser.add_argument("--loops", type=int, nargs="*", default=[1, 5, 10, 20])
    parser.add_argument("--json", metavar="FILE")
    options = parser.parse_args()
    found = []
    print(f"{'':22s} freedoms  rows |     bare  checked   public | by our rows   differ   [us]")
    cases = [*sp.list_mechanisms(), *options.loops]
    for case in cases:
        if isinstance(case, int):
            mechanism, state = leaning(case)
        else:
            mechanism = sp.load(case)
            state = sp.solve_rates(mechanism, sp.assemble(mechanism, {}),
                                   dict.fromkeys(mechanism.drivers, 0.7))
        row = compare(mechanism, state, options.repeats)
        if row is None:
            continue
        found.append(row)
        name = f"{case} windows" if isinstance(case, int) else case
        print(f"{name:22s} {row['freedoms']:8d} {row['rows']:5d} | {row['bare_us']:8.1f} "
              f"{row['checked_us']:8.1f} {row['public_us']:8.1f} | {row['rows_us']:11.1f} "
              f"{row['difference']:8.0e}")
    print("\ncut bodies in two halves, without any check; by our rows the public call      [us]")
    for name in ("oldham", "swash_plate"):
        row = compare_halves(name, options.repeats)
        found.append(row)
        print(f"{name:22s} {row['halves_us']:8.1f} | {row['rows_us']:11.1f} "
              f"{row['difference']:8.0e}")
    if options.json:
        Path(options.json).write_text(json.dumps(found, indent=2))


if __name__ == "__main__":
    main()
