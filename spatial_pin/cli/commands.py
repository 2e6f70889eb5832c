"""What the commands do: each calls one public verb and prints; computes nothing."""

from __future__ import annotations

import argparse
import contextlib
import json
import signal
from collections.abc import Iterator, Mapping
from concurrent.futures import Executor, ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

import spatial_pin as sp
from spatial_pin.cli.goal_files import check_bounds, read_goals
from spatial_pin.cli.readings import check_sigma, read_readings
from spatial_pin.cli.tables import read_table, targets_of
from spatial_pin.formats.export import export_urdf
from spatial_pin.formats.files import library_titles
from spatial_pin.motion.default_motion import default_motion
from spatial_pin.motion.report import assembly_summary, info, motion_summary
from spatial_pin.operators import OPERATORS
from spatial_pin.outputs import write_columns, write_text
from spatial_pin.units import Quantity
from spatial_pin.view import Viewer
from spatial_pin.view.page.plots import default_outputs
from spatial_pin.workspace_map.curves import curve_columns
from spatial_pin.workspace_map.poses import PARTS
from spatial_pin.workspace_map.result import unit_of


def _fitting(mechanism: sp.Mechanism, values: Mapping[str, float]) -> dict[str, float]:
    """Return coordinate values after a look at their units; names are checked elsewhere."""
    known = mechanism.coordinate_table
    for name, value in values.items():
        driver = mechanism.drivers.get(name)
        coordinate = known.get(driver.joint if driver else name)
        if coordinate and isinstance(value, Quantity) and not value.is_for(coordinate.unit):
            raise ValueError(f"{name} is in {coordinate.unit}, not in {value.unit}")
    return dict(values)


def _in_units(values: Mapping[str, float], *units: str) -> None:
    for name, value in values.items():
        if isinstance(value, Quantity) and value.unit not in ("", *units):
            raise ValueError(f"{name} is in {' or '.join(units)}, not in {value.unit}")


def _unique(options: argparse.Namespace, settings: list[tuple[str, float]]) -> dict[str, float]:
    values = dict(settings)
    if len(values) < len(settings):
        options.usage_error("a name is given two values")
    return values


def _look(
    options: argparse.Namespace, clearance: sp.Clearance | None = None
) -> sp.Look:
    return sp.Look(pairs=options.pairs or None, axes=options.axes, traces=tuple(options.trace),
                   arrows=tuple(options.arrow), centres=options.centres, clearance=clearance)


def _load(options: argparse.Namespace) -> sp.Mechanism:
    return sp.load(options.mechanism, trusted=options.trusted, free_flyer=options.free_flyer,
                   packages=dict(options.packages),
                   **_unique(options, options.parameters))


def _list(options: argparse.Namespace) -> None:
    rows = [(name, *words) for name, words in library_titles().items()]
    if options.json:
        _write_json([dict(zip(("name", "title", "source"), row, strict=True)) for row in rows],
                    options.json)
        return
    widths = [max(len(row[k]) for row in rows) for k in (0, 1)]
    for name, title, source in rows:
        print(f"{name:{widths[0]}}  {title:{widths[1]}}  {source}")
    print("\nin spatial_pin.operators:")
    for name, (title, source) in OPERATORS.items():
        print(f"{name:{widths[0]}}  {title:{widths[1]}}  {source}")


def _info(options: argparse.Namespace) -> None:
    report = info(_load(options))
    if options.json:
        _write_json(report.as_dict(), options.json)
    else:
        print(report)


def _assemble(options: argparse.Namespace) -> None:
    mechanism = _load(options)
    state = sp.assemble(mechanism, _fitting(mechanism, _unique(options, options.values)),
                        _guess(options), limits=options.limits, release=options.release,
                        free=options.free)
    _tell(options, state)


def _tell(options: argparse.Namespace, state: sp.State) -> None:
    """Say where a configuration is, and write it as asked."""
    mechanism = state.mechanism
    if options.json:
        values = {name: state.coordinate(name).value for name in mechanism.coordinates}
        _write_json({"mechanism": mechanism.name, "coordinates": values, "q": state.q.tolist(),
                     "closure_error": state.closure_error, "released": state.released,
                     "beyond_limits": state.beyond_limits}, options.json)
    if options.json != "-":
        print(assembly_summary(state))


def _limits(options: argparse.Namespace) -> None:
    mechanism = _load(options)
    found = sp.limits(mechanism, options.driver, _guess(options), joints=options.joints)
    print(f"{mechanism.name}, {found}")
    with contextlib.suppress(sp.SpatialPinError):  # most mechanisms are no plane four-bar
        print(sp.grashof(mechanism))


def _modes(options: argparse.Namespace) -> None:
    mechanism = _load(options)
    modes = sp.assembly_modes(mechanism, _fitting(mechanism, _unique(options, options.values)),
                              copies=options.copies, limits=options.limits,
                              patience=options.patience, progress=True)
    if options.json:
        _write_json([{"branch": mode.branch, "closure_error": mode.closure_error,
                      "q": mode.q.tolist()} for mode in modes], options.json)
    if options.json != "-":
        print(f"{mechanism.name}: {modes}")
        for k, mode in enumerate(modes, start=1):
            print(f"{k}: branch {mode.branch or '?'}\n{assembly_summary(mode)}")
        if options.html and modes:
            look = sp.Look(ghosts=tuple(modes[1:]), beside=True)
            print(f"wrote {sp.export_html(modes[0], options.html, look=look)}")
        if any(mode.branch.startswith("singular") for mode in modes):
            print("a singular mode can move to first order with the given values held")


def _guess(options: argparse.Namespace) -> dict[str, float] | None:
    return _unique(options, options.guess) or None


def _sweep_task(options: argparse.Namespace, mechanism: sp.Mechanism) -> dict[str, Any]:
    """The arguments of the sweep that was asked for."""
    for quantity_ in (options.first, options.last, options.speed, options.acceleration):
        _fitting(mechanism, {options.driver: quantity_})
    values = np.linspace(options.first, options.last, options.steps)
    if options.acceleration and options.speed is None:
        options.usage_error("--acceleration needs a --speed")
    return {"driver": options.driver, "values": values, "speed": options.speed,
            "acceleration": options.acceleration, "guess": _guess(options),
            "on_limit": "stop" if options.stop else "raise"}


def _run_sweep(options: argparse.Namespace, mechanism: sp.Mechanism) -> sp.Motion:
    task = _sweep_task(options, mechanism)
    if getattr(options, "only", None):
        mechanism, task["guess"] = _reduced(options, mechanism)
    if getattr(options, "hold", None):
        task["hold"] = ["base", *options.hold]
    return sp.sweep(mechanism, progress=True, **task)


def _reduced(
    options: argparse.Namespace, mechanism: sp.Mechanism
) -> tuple[sp.Reduced, sp.State]:
    """The model that yields `--only`, the other drivers locked, and where the sweep begins."""
    state = sp.assemble(mechanism, {options.driver: options.first}, _guess(options))
    driven = mechanism.driven_coordinate(options.driver).name
    others = {d.joint: state.coordinate(d.joint).value for d in mechanism.drivers.values()
              if d.joint != driven and d.joint not in options.only and d.name not in options.only}
    is_driver = driven in (d.joint for d in mechanism.drivers.values())
    found = sp.reduce(mechanism, [*options.only, *[driven] * (not is_driver)], lock=others,
                      guess=state)
    if options.json != "-":
        print(found)
    return found, found.state(state)


def _sweep(options: argparse.Namespace) -> None:
    _write(options, _run_sweep(options, _load(options)))


def _follow(options: argparse.Namespace) -> None:
    mechanism = _load(options)
    values, times = read_table(options.table, mechanism)
    _write(options, sp.follow(mechanism, values, times, guess=_guess(options),
                              hold=["base", *options.hold],
                              on_limit="stop" if options.stop else "raise",
                              on_crossing="stop" if options.stop else "straight", progress=True))


def _reach(options: argparse.Namespace) -> None:
    mechanism = _load(options)
    targets = _targets(options)
    if options.path:
        _reach_path(options, mechanism, targets)
        return
    if not targets:
        options.usage_error("there is no target: name some, or give a table by --path")
    if any((options.csv, options.npz, options.plot, options.clearance)):
        options.usage_error("--csv, --npz, --plot and --clearance tell of a motion: they need "
                            "--path")
    state = sp.assemble(mechanism, {}, _guess(options))
    _fitting(mechanism, {n: x for n, x in targets.items() if not isinstance(x, list)})
    found = sp.reach(mechanism, targets, state, hold=["base", *options.hold],
                     limits=options.limits)
    _tell(options, found)
    if options.json != "-":
        for name in mechanism.drivers:
            value, unit = found.coordinate(name).value, mechanism.coordinate(name).unit
            print(f"  driver {name} = {value:.15g} {unit}")
    if options.html:
        print(f"wrote {sp.export_html(found, options.html, look=_look(options))}")


def _targets(options: argparse.Namespace) -> dict[str, Any]:
    """Return values of coordinates, and lists of the targets of frames."""
    frames: dict[str, list[Any]] = {}
    for name, target in options.targets:
        if isinstance(target, sp.Target):
            frames.setdefault(name, []).append(target)
    values = [(name, x) for name, x in options.targets if not isinstance(x, sp.Target)]
    if both := frames.keys() & dict(values):
        options.usage_error(f"{min(both)!r} is given as a frame and as a coordinate")
    return {**_unique(options, values), **frames}


def _reach_path(
    options: argparse.Namespace, mechanism: sp.Mechanism, standing: dict[str, Any]
) -> None:
    """Go along a table of targets; coordinates named beside it stand still."""
    if any(isinstance(target, list) for target in standing.values()):
        options.usage_error("beside --path only COORDINATE=value: frames are columns of the table")
    if not options.limits:
        options.usage_error("--no-limits is of single targets: limits passed are told of a path")
    columns, times = read_table(options.path, mechanism)
    targets = targets_of(options.path, mechanism, columns)
    state = sp.assemble(mechanism, {}, _guess(options))
    _write(options, sp.reach_path(
        mechanism, {**targets, **_fitting(mechanism, standing)}, times, state,
        hold=["base", *options.hold], progress=True))


def _workspace(options: argparse.Namespace) -> None:
    mechanism = _load(options)
    ranges = dict(options.ranges)
    if len(ranges) < len(options.ranges):
        options.usage_error("a name is given two ranges")
    for k in (0, 1):
        _fitting(mechanism, {name: span[k] for name, span in ranges.items()})
        for name, span in ranges.items():
            unit = unit_of(mechanism, name) if name in PARTS else ""
            if unit and not span[k].is_for(unit):
                raise ValueError(f"{name} is in {unit}, not in {span[k].unit}")
    with _workers(options.workers) as executor:
        found = sp.workspace(mechanism, options.frame, ranges, points=options.points,
                             guess=_guess(options), task=options.task, limits=options.limits,
                             on_crossing=options.on_crossing, clearance=options.clearance,
                             sheets=options.sheets, executor=executor, progress=True)
    if options.json != "-":
        print(found)
    for path in _mapped(options, found):
        if options.json != "-":
            print(f"wrote {path}")
    if not found.is_whole:
        raise KeyboardInterrupt


def _mapped(options: argparse.Namespace, found: sp.Workspace) -> Iterator[Path | str]:
    """Write what was asked for of a workspace, and yield the files."""
    if options.csv:
        yield found.to_csv(options.csv)
    if options.curves:
        yield write_columns(Path(options.curves), curve_columns(found, found.curves()))
    if options.picture:
        found.plot(options.picture, plane=options.plane, at=options.at)
        yield options.picture
    if options.html:
        yield sp.export_html(sp.assemble(found.mechanism, {}, _guess(options)), options.html,
                             look=sp.Look(workspace=found))
    if options.json:
        columns = {name: [None if x != x else x for x in np.asarray(column).tolist()]
                   for name, column in found.columns().items()}
        _write_json({"mechanism": found.mechanism.name, "frame": found.frame,
                     "columns": columns}, options.json)
        if options.json != "-":
            yield options.json


def _calibrate(options: argparse.Namespace) -> None:
    mechanism = _load(options)
    dimensions, sigma = dict(options.dimension), _unique(options, options.sigma)
    if len(dimensions) < len(options.dimension):
        options.usage_error("a dimension is named twice")
    check_sigma(mechanism, sigma)
    found = sp.calibrate(mechanism, read_readings(options.table, mechanism, options.read),
                         dimensions, offsets=options.offset, base=options.base,
                         sigma=sigma or None, loss=options.loss, margin=options.margin,
                         guess=_guess(options))
    written: list[Path | str] = []
    if options.csv:
        written.append(found.to_csv(options.csv))
    if options.folder:
        written.append(found.mechanism.save(options.folder))
    if options.json:
        _write_json(found.as_dict(), options.json)
        written.append(options.json)
    if options.json != "-":
        print(found)
        print("".join(f"wrote {path}\n" for path in written), end="")


def _design(options: argparse.Namespace) -> None:
    mechanism = _load(options)
    goals, bounds = read_goals(options.goals, mechanism)
    bounds |= dict(options.dimensions)
    if len(dict(options.dimensions)) < len(options.dimensions):
        options.usage_error("a name is given two ranges")
    if not bounds:
        options.usage_error("nothing may change: name dimensions, as r2=50mm..0.6")
    check_bounds(bounds)
    with _workers(options.workers) as executor:
        found = sp.design(mechanism, goals, bounds, guess=_guess(options), starts=options.starts,
                          method=options.method, seed=options.seed, executor=executor,
                          progress=True, resume=options.resume, most=options.most)
    if options.json != "-":
        print(found)
    for path in _designed(options, found):
        if options.json != "-":
            print(f"wrote {path}")
    if not found.is_whole:
        raise KeyboardInterrupt


@contextlib.contextmanager
def _workers(count: int) -> Iterator[Executor | None]:
    """Make processes that leave Ctrl-C to this one; none for one."""
    if count == 1:
        yield None
        return
    with ProcessPoolExecutor(count, initializer=signal.signal,
                             initargs=(signal.SIGINT, signal.SIG_IGN)) as executor:
        yield executor


def _designed(options: argparse.Namespace, found: sp.Designs) -> Iterator[Path | str]:
    """Write what was asked for of designs, and yield the files."""
    if options.json:
        _write_json(found.as_dict(), options.json)
        yield options.json
    if not found:
        return
    if options.save:
        yield found[0].mechanism.save(options.save)
    if options.html:
        yield sp.export_html(found, options.html)
    if options.report:
        yield sp.report(found, options.report)


def _beginning(
    options: argparse.Namespace, mechanism: sp.Mechanism, speeds: list[tuple[str, float]],
    duration: float,
) -> tuple[sp.State, dict[str, float]]:
    """The state that a simulation starts from, and the efforts."""
    start = _fitting(mechanism, _unique(options, options.at))
    rates = _fitting(mechanism, _unique(options, speeds))
    _in_units({"duration": duration}, "s", "ms")
    efforts = _unique(options, options.effort)
    _in_units(efforts, "N", "kN", "Nm", "N·m")
    state = sp.assemble(mechanism, start, _guess(options))
    if rates:  # without, it starts from rest, drivers or none
        state = sp.solve_rates(mechanism, state, rates)
    return state, efforts


def _simulate(options: argparse.Namespace) -> None:
    mechanism = _load(options)
    state, efforts = _beginning(options, mechanism, options.speed, options.duration)
    times = np.linspace(0.0, options.duration, options.rows)
    motion = sp.simulate(mechanism, state, options.duration, efforts, times,
                         sp.Accuracy.named(options.accuracy),
                         on_joint_limit=options.on_joint_limit, progress=True)
    _write(options, motion)
    if options.json != "-":
        print(f"energy drift {motion.energy_drift:.1e} of what is exchanged; {motion.steps} steps "
              f"of the integrator in {', '.join(motion.coordinates)}")


def _tradeoff(options: argparse.Namespace) -> None:
    mechanism = _load(options)
    found = sp.tradeoff(mechanism, _task(options, mechanism), repeats=options.repeats,
                        progress=True)
    if options.json != "-":
        print(found)
    if options.json:
        _write_json(found.as_dict(), options.json)
    if options.plot:
        found.plot(options.plot)
    if options.json == "-":
        return
    for path in filter(None, (options.json, options.plot)):
        print(f"wrote {path}")
    if options.error is not None:
        pick = sp.Accuracy.for_error(options.error, measured=found)
        print(f"cheapest for an error of {options.error:.3g}: {pick}")


def _task(options: argparse.Namespace, mechanism: sp.Mechanism) -> str | dict[str, Any]:
    """What a trade-off is measured on."""
    if options.simulate is None:
        if options.at or options.begin or options.effort or options.rows:
            options.usage_error("--at, --begin, --effort and --rows need --simulate")
        if options.driver is None:
            return "sweep"
        if options.last is None:
            options.usage_error("a sweep needs a driver, a first and a last value")
        return _sweep_task(options, mechanism)
    if options.driver is not None or options.speed is not None or options.acceleration:
        options.usage_error("--simulate takes no driver to sweep: its speeds are given by --begin")
    said = options.at or options.begin or options.effort or options.rows or options.guess
    if not options.simulate:
        if said:
            options.usage_error("--simulate needs a duration where more is said")
        return "simulate"
    state, efforts = _beginning(options, mechanism, options.begin, options.simulate)
    return {"state": state, "duration": options.simulate, "efforts": efforts,
            "times": np.linspace(0.0, options.simulate, options.rows or 201)}


def _write(options: argparse.Namespace, motion: sp.Motion) -> None:
    """Say what a motion is, and write it as asked."""
    is_said = options.json != "-"
    if is_said:
        print(motion_summary(motion))
    found = sp.clearance(motion, progress=True) if options.clearance else None
    if is_said and found is not None:
        print(found)
    written = list(_written(options, motion, found))
    if is_said:
        print("".join(f"wrote {path}\n" for path in written), end="")


def _written(
    options: argparse.Namespace, motion: sp.Motion, found: sp.Clearance | None
) -> Iterator[Path | str]:
    """Write what was asked for, and yield the files."""
    if options.csv:
        yield motion.to_csv(options.csv)
    if options.npz:
        yield motion.save(options.npz)
    if options.plot:
        sp.plot(motion, options.output or _with_ratios(motion), options.plot)
        yield options.plot
    if options.html:
        yield sp.export_html(motion, options.html, look=_look(options, found))
    if options.json:
        _write_json(_content(motion, found), options.json)
        yield options.json


def _content(motion: sp.Motion, found: sp.Clearance | None) -> dict[str, Any]:
    """Return what a motion is, as JSON has it."""
    columns = {name: column.tolist() for name, column in motion.columns().items()}
    content = {"mechanism": motion.mechanism.name, "columns": columns,
               "events": [event._asdict() for event in motion.events]}
    return content if found is None else {**content, "clearance": found.as_dict()}


def _with_ratios(motion: sp.Motion) -> list[str]:
    """The outputs looked at first, each coordinate with its speed ratio."""
    coordinates = motion.mechanism.coordinate_table
    if motion.driver is None:
        return default_outputs(motion)
    return [name for output in default_outputs(motion)
            for name in ([output, f"{output}.ratio"] if output in coordinates else [output])]


def _shown(options: argparse.Namespace, mechanism: sp.Mechanism) -> sp.Motion | sp.State:
    """The sweep that was asked for, or what a mechanism is shown with when none was."""
    if options.last is not None:
        return _run_sweep(options, mechanism)
    said = (options.first, options.speed, options.acceleration or None, options.guess or None)
    if any(x is not None for x in said):
        options.usage_error("a sweep needs a driver, a first and a last value")
    return default_motion(mechanism, options.driver, options.steps)


def _show(options: argparse.Namespace) -> None:
    mechanism = _load(options)
    if options.live:
        _wait(mechanism, _live(options, mechanism))
        return
    subject, look = _shown(options, mechanism), _look(options)
    if options.movie:
        print(f"wrote {sp.movie(subject, options.movie, look=look, progress=True)}")
        return
    _wait(mechanism, sp.show(subject, look=look))


def _live(options: argparse.Namespace, mechanism: sp.Mechanism) -> Viewer:
    """The page whose sliders move a mechanism from its guess on."""
    if options.movie or options.last is not None:
        options.usage_error("--live takes no values to sweep and makes no film")
    state = sp.assemble(mechanism, {}, _guess(options))
    named = [options.driver] if options.driver else None
    return sp.live(mechanism, state, drivers=named, outputs=options.output)


def _wait(mechanism: sp.Mechanism, viewer: Viewer) -> None:
    with viewer:
        print(f"{mechanism.name}: {viewer.url} (Ctrl-C ends)", flush=True)
        viewer.wait()


def _report(options: argparse.Namespace) -> None:
    subject = _shown(options, _load(options))
    path = sp.report(subject, options.html, outputs=options.output or None, title=options.title)
    print(f"wrote {path}")


def _check(options: argparse.Namespace) -> None:
    mechanism = _load(options)
    for notice in mechanism.notices:
        print(f"note: {notice}")
    state = sp.assemble(mechanism)
    print(f"{mechanism.path}: good: {len(mechanism.links)} links, "
          f"{len(mechanism.coordinates)} coordinates, {len(mechanism.closures)} closures; "
          f"the guess closes to {state.closure_error:.1e}")
    found = sp.mobility(mechanism, state)
    working = found.dof - len(found.passive)
    if len(mechanism.drivers) != working:
        print(f"note: {len(mechanism.drivers)} drivers for {working} working freedoms:\n{found}")


def _export(options: argparse.Namespace) -> None:
    mechanism = _load(options)
    if options.folder is not None:
        written = [mechanism.save(options.folder)]
    elif options.mjcf is not None:
        written = [sp.export_mjcf(mechanism, options.mjcf)]
    else:
        written = export_urdf(mechanism, options.urdf)
    for path in written:
        print(f"wrote {path}")


def _write_json(content: Any, path: str) -> None:
    text = json.dumps(content, indent=1)
    if path == "-":
        print(text)
    else:
        write_text(Path(path), text + "\n")


RUNS = {
    "list": _list,
    "info": _info,
    "assemble": _assemble,
    "sweep": _sweep,
    "follow": _follow,
    "reach": _reach,
    "workspace": _workspace,
    "calibrate": _calibrate,
    "design": _design,
    "simulate": _simulate,
    "tradeoff": _tradeoff,
    "limits": _limits,
    "modes": _modes,
    "show": _show,
    "report": _report,
    "check": _check,
    "export": _export,
}
