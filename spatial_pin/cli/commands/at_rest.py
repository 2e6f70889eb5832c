"""Commands of poses at rest: equilibrium, linearize, compliance."""

from __future__ import annotations

from typing import Any

import numpy as np

import spatial_pin as sp
from spatial_pin.cli import options as opt
from spatial_pin.cli.commands.rates_and_forces import ROWS, UNITS, balance, external_forces
from spatial_pin.cli.mechanism_arguments import Options, in_units, or_partial_result, workers
from spatial_pin.cli.printing import grid, print_result
from spatial_pin.motion.summary import EFFORTS
from spatial_pin.units import KINDS

FORCES = {"m": "N", "rad": "N·m"}  # unit of a coordinate: that of its force


def _acting(options: Options) -> dict[str, Any]:
    """Return the arguments for held coordinates, constant speeds and loads."""
    options.check_held()
    efforts = options.unique(options.efforts)
    for name, x in efforts.items():
        unit = EFFORTS[options.loaded.driven_coordinate(name).unit]
        in_units({f"the effort of {name}": x}, *KINDS[unit])
    given: dict[str, Any] = {"hold": options.hold or None, "efforts": efforts or None,
                             "external": external_forces(options) or None}
    if "constant" in options:
        given["speeds"] = options.fitting(options.unique(options.constant), "speed") or None
    return given


def equilibrium(options: Options) -> None:
    """Where it comes to rest under weights, springs and loads, and whether it stays."""
    mechanism = options.loaded
    acting = _acting(options)
    guess = options.state()
    if not options.all:
        result = sp.equilibrium(mechanism, guess, **acting,
                               stable=None if options.nearest else True)
        quantities = _quantities(result)
        units = [unit for _, _, unit in quantities]
        rows = [[name, f"{x:.9g}", unit] for name, x, unit in quantities]
        lines = [f"{mechanism.name}: {str(result).partition(' at rest')[0]} at rest, closed to "
                 f"{result.state.closure_error:.1e}", grid(rows),
                 *(f"  idle: {freedom}" for freedom in result.passive)]
        if result.neutral:
            lines.append(f"  no stiffness in {', '.join(result.neutral)}")
        print_result(options, "\n".join(lines), _content(result), {
            "quantity": [name for name, _, _ in quantities],
            "value": [x for _, x, _ in quantities], "unit": units})
        return
    with workers(options.workers) as executor:
        poses = or_partial_result(lambda: sp.equilibria(
            mechanism, guess, **acting, starts=options.starts, seed=options.seed,
            executor=executor))
    table = {name: x.tolist() for name, x in poses.columns().items()}
    content = {"mechanism": mechanism.name, "starts": poses.starts, "reached": poses.reached,
               "missing": poses.missing, "is_whole": poses.is_whole,
               "poses": [_content(one) | {"reached": n}
                         for one, n in zip(poses, poses.counts, strict=True)]}
    lines = [f"{mechanism.name}: {len(poses)} poses at rest from {poses.starts} starts, "
             f"{poses.reached} of which reached one; about {poses.missing:.0f} more must be "
             "expected"]
    for kind, energy, reached, pose in zip(*(table[x] for x in ("kind", "energy [J]", "reached")),
                                           poses, strict=True):
        lines.append(f"{kind}, {energy:.9g} J, reached {reached} times")
        lines.append(grid([[name, f"{x:.9g}", unit] for name, x, unit in _coordinates(pose)]))
    print_result(options, "\n".join(lines), content, table, is_whole=poses.is_whole)


def _coordinates(result: sp.Equilibrium) -> list[tuple[str, float, str]]:
    state = result.state
    return [(name, float(state.coordinate(name).value), c.unit)
            for name, c in state.mechanism.coordinate_table.items()]


def _quantities(result: sp.Equilibrium) -> list[tuple[str, float, str]]:
    """Return names, values and units of the numbers of a pose at rest."""
    mechanism, names = result.state.mechanism, result.coordinates
    rows = [*_coordinates(result), ("potential energy", result.energy, "J")]

    def unit(name: str) -> str:
        return mechanism.prescribed_coordinate(name).unit
    rows += [(f"stiffness of {name}" + (f" by {other}" if other != name else ""), float(x),
              f"{FORCES[unit(name)]}/{unit(other)}")
             for name, row in zip(names, result.stiffness, strict=True)
             for other, x in zip(names, row, strict=True)]
    rows += [(f"{name} effort", x, FORCES[unit(name)])
             for name, x in result.efforts.items()]
    return rows


def _content(result: sp.Equilibrium) -> dict[str, Any]:
    """Return a pose at rest as JSON has it."""
    mechanism = result.state.mechanism
    return {
        "mechanism": mechanism.name, "stable": result.stable,
        "coordinates": {name: x for name, x, _ in _coordinates(result)},
        "units": {name: unit for name, _, unit in _coordinates(result)},
        "energy": result.energy, "independent": list(result.coordinates),
        "stiffness": result.stiffness.tolist(), "neutral": list(result.neutral),
        "passive": [str(freedom) for freedom in result.passive], "efforts": result.efforts,
        **balance(result), "closure_error": result.state.closure_error}


def linearize(options: Options) -> None:
    """How it rings about the pose at rest: frequencies, damping, shapes."""
    mechanism = options.loaded
    acting = _acting(options)
    state = sp.equilibrium(mechanism, options.state(), **acting,
                           stable=None if options.nearest else True).state
    system = sp.linearize(mechanism, state, **acting, inputs=options.inputs or None,
                         outputs=options.outputs or None)
    a, b, c, d = system.state_space()
    content = {
        "mechanism": mechanism.name, "coordinates": list(system.coordinates),
        "at": {name: state.coordinate(name).value for name in mechanism.coordinate_table},
        "frequencies": system.frequencies, "damping_ratios": system.damping_ratios,
        "eigenvalues": [[x.real, x.imag] for x in system.eigenvalues.tolist()],
        "stable": system.stable, "mass": system.mass, "damping": system.damping,
        "stiffness": system.stiffness, "inputs": list(system.inputs),
        "outputs": list(system.outputs), "a": a, "b": b, "c": c, "d": d,
        "closure_error": state.closure_error}
    pairs = enumerate(zip(system.frequencies, system.damping_ratios, strict=True))
    rows = [[str(k), f"{f:.9g}" if f else "none", f"{ratio:.6g}" if f else ""]
            for k, (f, ratio) in pairs]
    lines = [f"{mechanism.name}: small motions about {state}",
             grid(rows, ("", "frequency [Hz]", "damping ratio"))]
    files = []
    if options.html:
        files.append(sp.export_html(system.shape(options.shape), options.html))
    print_result(options, "\n".join(lines), content,
                 {name: x.tolist() for name, x in system.columns().items()}, files)


def compliance(options: Options) -> None:
    """How much a frame at rest gives way to a small force and moment."""
    mechanism = options.loaded
    mechanism.frame_id(options.frame)
    acting = _acting(options)
    state = sp.equilibrium(mechanism, options.state(), **acting).state
    result = sp.compliance(mechanism, state, options.frame, **acting)
    heads = [f"{'f' if row[0] == 'v' else 'm'}{row[1]}" for row in ROWS]
    names = [f"{'d' if row[0] == 'v' else 'r'}{row[1]}" for row in ROWS]
    units = [UNITS[row[0]] for row in ROWS]
    small = 1e-12 * np.abs(result).max(initial=0.0)
    lines = [f"{mechanism.name}: how {options.frame} moves at its origin per force [N] and moment "
             "[N·m], world axes, loops closed",
             grid([[name, unit, *(f"{x if abs(x) > small else 0.0:.4g}" for x in row)]
                   for name, unit, row in zip(names, units, result, strict=True)],
                  ("", "of", *heads))]
    print_result(options, "\n".join(lines), {
        "mechanism": mechanism.name, "frame": options.frame, "rows": names, "by": heads,
        "matrix": result.tolist(),
        "coordinates": {name: state.coordinate(name).value for name in mechanism.coordinate_table},
        "closure_error": state.closure_error},
        {"component": names, "of": units,
         **{f"{head} [{FORCES[unit]}]": result[:, k].tolist()
            for k, (head, unit) in enumerate(zip(heads, units, strict=True))}})


LOADS = (
    opt.many("--hold", 'a joint, coordinate or driver that is held; "base": a free base (nothing)'),
    opt.many("--effort", "a constant torque [N·m] or force [N] in it", dest="efforts",
             type=opt.setting, metavar="JOINT=VALUE"),
    opt.many("--load",
             "a force [N], and moment [N·m], on a link or frame at its origin, world axes",
             dest="loads", type=opt.numbers, metavar="NAME=FX,FY,FZ[,MX,MY,MZ]"),
)
TURNING = (
    opt.many("--speed", "what turns at a constant speed, as shaft=240rpm: rest is relative to it",
             dest="constant", type=opt.setting, metavar="NAME=VALUE"),
    opt.switch("--nearest", "the pose at rest nearest to the guess, be it stable or not"),
)
COMMANDS = {
    "equilibrium": opt.Command(equilibrium, (
        *opt.CONFIGURATION, *LOADS, *TURNING,
        opt.switch("--all", "all poses at rest, stable and unstable ones"),
        opt.option("--starts", "number of starts of --all (60)", type=opt.count, default=60),
        opt.option("--seed", "of the random starts (0)", type=opt.from_zero, default=0),
        *opt.WORKERS,
        *opt.data_options("the pose, stiffness and reactions", "the pose and its stiffness"),
    )),
    "linearize": opt.Command(linearize, (
        *opt.CONFIGURATION, *LOADS, *TURNING,
        opt.many("--input", "whose effort is an input of the state space (the drivers)",
                 dest="inputs"),
        opt.many("--output", "an output of it, as rocker_pin, rocker_pin.rate or FRAME.position.x",
                 dest="outputs"),
        opt.option("--shape", "the vibration that --html plays, by its number (0)",
                   type=opt.from_zero, default=0, metavar="K"),
        opt.file_option("--html", "write a page that plays a vibration"),
        *opt.data_options("frequencies, matrices and state space",
                          "frequencies and damping ratios"),
    )),
    "compliance": opt.Command(compliance, (
        opt.option("frame", "link, frame or joint that gives way", metavar="FRAME"),
        *opt.CONFIGURATION, *LOADS,
        *opt.data_options("the matrix", "the matrix"),
    )),
}
