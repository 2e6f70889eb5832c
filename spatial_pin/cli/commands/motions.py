"""Commands of motions: sweep, follow, states, simulate, clearance; show, report; their files."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import spatial_pin as sp
from spatial_pin.cli import options as opt
from spatial_pin.cli.mechanism_arguments import RATES, Options, in_units, or_partial_result
from spatial_pin.cli.printing import CutShort, on_screen, print_result, say, wrote
from spatial_pin.cli.tables import name_of_column, read_table
from spatial_pin.dynamics.force_outputs import with_force_values
from spatial_pin.dynamics.simulation.result import growth_lines
from spatial_pin.motion.default_motion import default_motion
from spatial_pin.motion.limit_events import KIND as JOINT_LIMIT
from spatial_pin.motion.report import motion_summary
from spatial_pin.motion.summary import EFFORTS
from spatial_pin.units import KINDS
from spatial_pin.view.page.plots import default_outputs

# ---------------------------------------------------------------- how motions are written


def look_of(options: Options, clearance: sp.Clearance | None = None) -> sp.Look:
    """Return the extras of a picture."""
    return sp.Look(pairs=options.pairs or None, axes=options.axes, traces=tuple(options.trace),
                   arrows=tuple(options.arrow), centres=options.centres, clearance=clearance)


def write_followed(
    options: Options, follow: Callable[[], sp.Motion],
    last: Callable[[Any], str] = lambda motion: "",
) -> None:
    """Follow a motion and write it, `last` below; after Ctrl-C the samples until then."""
    try:
        motion = follow()
        write_motion(options, motion, last(motion))
    except sp.Interrupted as stopped:
        options.clearance = False
        motion = stopped.result
        write_motion(options, motion, f"cut short after {len(motion)} steps", False)
        raise CutShort from None


def write_motion(
    options: Options, motion: sp.Motion, last: str = "", is_whole: bool = True
) -> None:
    """Print a summary of a motion and write its files; `last` goes below."""
    clearance = (or_partial_result(lambda: sp.clearance(motion, progress=True)) if options.clearance
             else None)
    if clearance is not None:
        motion = clearance.motion

    def files() -> Iterator[Path | str]:
        if options.npz:
            yield motion.save(options.npz)
        if options.plot:
            outputs = options.output
            if not outputs:  # those looked at first, each coordinate with its speed ratio
                coordinates = {} if motion.driver is None else motion.mechanism.coordinate_table
                outputs = [name for output in default_outputs(motion) for name in (
                    [output, f"{output}.ratio"] if output in coordinates else [output])]
            sp.plot(motion, with_force_values(motion, outputs, lambda: sp.kinetostatics(
                motion.mechanism, motion)), options.plot)
            yield options.plot
        if options.html:
            yield sp.export_html(motion, options.html, look=look_of(options, clearance))

    lines = [motion_summary(motion), *([str(clearance)] if clearance is not None else []),
             *([last] if last else [])]
    columns = {name: column.tolist() for name, column in motion.columns().items()}
    content = {"mechanism": motion.mechanism.name, "is_whole": is_whole, "columns": columns,
               "events": [event._asdict() for event in motion.events]}
    if motion.unreached:
        content["unreached"] = motion.unreached
    if len(motion.error_estimates):
        content["error"] = motion.error._asdict()
    if clearance is not None:
        content["clearance"] = clearance.as_dict()
    print_result(options, "\n".join(lines), content, motion.columns(),
                 files(), clearance is None or clearance.is_whole)


# ---------------------------------------------------------------- sweep


def sweep_task(options: Options) -> dict[str, Any]:
    """Return the arguments of the sweep of the options."""
    for end in (options.first, options.last):
        options.fitting({options.driver: end})
    for rate in RATES:
        options.fitting({options.driver: getattr(options, rate)}, rate)
    values = np.linspace(options.first, options.last, options.steps)
    if options.acceleration and options.speed is None:
        options.usage_error("--acceleration needs a --speed")
    return {"driver": options.driver, "values": values, "speed": options.speed,
            "acceleration": options.acceleration, "guess": options.start_guess,
            "on_limit": "stop" if options.stop else "raise"}


def run_sweep(options: Options) -> sp.Motion:
    """Return the sweep of the options, up to the first joint limit if limits are kept."""
    mechanism, task = options.loaded, sweep_task(options)
    if getattr(options, "only", None):
        state = sp.assemble(mechanism, {options.driver: options.first}, task["guess"])
        driven = mechanism.driven_coordinate(options.driver).name
        others = [d for d in mechanism.drivers.values() if d.joint != driven]
        outputs = [*options.only, *[driven] * (len(others) == len(mechanism.drivers))]
        locked = {d.joint: state.coordinate(d.joint).value for d in others
                  if not {d.joint, d.name} & set(options.only)}
        reduced = sp.reduce(mechanism, outputs, lock=locked, guess=state)
        if not on_screen(options):
            say(reduced)
        mechanism, task["guess"] = reduced, reduced.state(state)
    if getattr(options, "hold", None):
        task["hold"] = options.held
    motion = sp.sweep(mechanism, progress=True, **task)
    passed = next((event for event in motion.events if event.kind == JOINT_LIMIT), None)
    if passed is None or not getattr(options, "limits", False):
        return motion
    if not options.stop or not passed.row:
        remedy = "; --stop ends the sweep before it" if passed.row else ""
        raise sp.LimitError(f"mechanism {motion.mechanism.name!r}: {passed.text}{remedy}",
                            limit=passed.value, motion=motion)
    part = sp.sweep(motion.mechanism, **{**task, "values": task["values"][: passed.row]})
    return replace(part, events=[*part.events, passed])


def sweep(options: Options) -> None:
    """Follow one branch from one driver value to another."""
    mechanism = options.loaded
    mechanism.coordinate(options.driver)
    options.check_names()
    write_followed(options, lambda: run_sweep(options))


def shown(options: Options) -> sp.Motion | sp.State:
    """Return the sweep of the options; without one, the usual motion of the mechanism."""
    if options.driver is not None:
        options.loaded.coordinate(options.driver)
    options.check_names()
    if options.last is not None:
        return run_sweep(options)
    given = (options.first, options.speed, options.acceleration or None,
            options.guess or None, options.hold or None)
    if any(x is not None for x in given):
        options.usage_error("a sweep needs a driver, a first and a last value")
    return default_motion(options.loaded, options.driver, options.steps)


# ---------------------------------------------------------------- follow, states


def columns_of(options: Options) -> tuple[dict[str, Any], Any]:
    """Return the values of drivers in the table of the options, and times, if it has some."""
    options.check_names()
    values, times = read_table(options.table, options.loaded)
    for name in values:
        with name_of_column(options.table, name):
            options.loaded.prescribed_coordinate(name)
    if not values:
        raise sp.SpatialPinError(f"{options.table}: there is no column of a driver")
    return values, times


def states(options: Options) -> None:
    """Solve configurations at scattered driver values of a table, on one branch."""
    mechanism = options.loaded
    values, _ = columns_of(options)
    write_followed(options, lambda: sp.states(
        mechanism, values, options.start_guess, options.threads, hold=options.held,
        progress=True))


def follow(options: Options) -> None:
    """Follow one branch as several drivers go along a table."""
    mechanism = options.loaded
    values, times = columns_of(options)
    write_followed(options, lambda: sp.follow(
        mechanism, values, times, guess=options.start_guess, hold=options.held,
        on_limit="stop" if options.stop else "raise",
        on_crossing="stop" if options.stop else "straight", progress=True))


# ---------------------------------------------------------------- simulate


def beginning(
    options: Options, speeds: list[tuple[str, float]],
    duration: float,
) -> tuple[sp.State, dict[str, float]]:
    """Return the state that a simulation starts from, and the efforts."""
    mechanism, start = options.loaded, options.fitting(options.unique(options.at))
    rates = options.fitting(options.unique(speeds), "speed")
    in_units({"duration": duration}, "s", "ms")
    efforts = options.unique(options.effort)
    for name, x in efforts.items():
        unit = EFFORTS[mechanism.coordinate(name).unit]
        in_units({f"the effort of {name}": x}, *KINDS[unit])
    state = sp.assemble(mechanism, start, options.start_guess)
    if rates:  # without, it starts from rest, drivers or none
        state = sp.solve_rates(mechanism, state, rates)
    return state, efforts


def simulate(options: Options) -> None:
    """Let it move under gravity, springs and efforts."""
    mechanism = options.loaded
    options.check_names()
    state, efforts = beginning(options, options.speed, options.duration)
    times = np.linspace(0.0, options.duration, options.rows)
    write_followed(options, lambda: sp.simulate(
        mechanism, state, options.duration, efforts, times, sp.Accuracy.named(options.accuracy),
        on_joint_limit=options.on_joint_limit, progress=True), lambda motion: (
            f"energy drift {motion.energy_drift:.1e} of the exchanged energy; {motion.steps} steps "
            f"of the integrator in {', '.join(motion.coordinates)}"
            + "".join(f"\n{line.strip()}" for line in growth_lines(motion))))


# ---------------------------------------------------------------- clearance


def clearance(options: Options) -> None:
    """How near links come to each other, and where they touch."""
    mechanism = options.loaded
    in_units({"tolerance": options.tolerance}, "m", "cm", "mm", "um", "in")
    for link in (link for pair in options.between for link in pair):
        mechanism.frame_id(link)
    if options.at and options.driver is not None:
        options.usage_error("--at is one configuration: it takes no driver to sweep")
    if options.at:
        values = options.fitting(options.unique(options.at))
        subject: sp.Motion | sp.State = sp.assemble(mechanism, values, options.start_guess)
    else:
        subject = shown(options)
    result = or_partial_result(lambda: sp.clearance(
        subject, [(a, b) for a, b in options.between] or None, tolerance=float(options.tolerance),
        progress=True))
    motion = result.motion  # the abscissa of the nearest places
    over = "" if motion.time is None or len(motion) == 1 else "time [s]"
    if motion.driver is not None:
        over = f"{motion.driver_name} [{motion.driver_unit}]"
    table = {"first": [p.links[0] for p in result.pairs],
             "second": [p.links[1] for p in result.pairs],
             "distance [m]": [float(p.distance) for p in result.pairs],
             **({over: [float(p.value) for p in result.pairs]} if over else {}),
             "touches": [bool(p.contacts) for p in result.pairs]}
    content = {"mechanism": mechanism.name, "over": over, **result.as_dict()}
    print_result(options, result, content, table, is_whole=result.is_whole)


# ---------------------------------------------------------------- show, report


def show(options: Options) -> None:
    """Animate a motion in the browser."""
    mechanism = options.loaded
    if options.live:
        if options.movie or options.last is not None or options.hold:
            options.usage_error("--live takes no values to sweep, holds nothing and makes no film")
        options.check_names()
        state = sp.assemble(mechanism, {}, options.start_guess)
        viewer = sp.live(mechanism, state, drivers=[options.driver] if options.driver else None,
                         outputs=options.output, limits=options.limits is not False)
    else:
        subject, look = shown(options), look_of(options)
        if options.movie:
            wrote([sp.movie(subject, options.movie, look=look, progress=True)])
            return
        viewer = sp.show(subject, look=look)
    with viewer:
        print(f"{mechanism.name}: {viewer.url} (Ctrl-C ends)", flush=True)
        viewer.wait()


def report(options: Options) -> None:
    """Write a page to send and to print: 3-D, curves, numbers."""
    mechanism = options.loaded
    path = sp.report(shown(options), options.html, outputs=options.output or None,
                     title=options.title)
    print_result(options, "", {"mechanism": mechanism.name, "wrote": [str(path)]}, files=[path])


COMMANDS = {
    "sweep": opt.Command(sweep, (
        *opt.sweep_arguments(),
        opt.switch("--limits", "a joint limit of the URDF, of any joint, is a limit position too"),
        opt.hold_option(opt.SPRINGS_HELP),
        opt.many("--only",
                 "sweep the smallest model that yields this coordinate, link or frame, and name "
                 "the parts that it leaves out"),
        *opt.RESULT,
    )),
    "follow": opt.Command(follow, (
        opt.option("table",
                   "a .csv file: a line of names, as time [s], boom [deg], arm; then a line of "
                   "numbers for every sample", metavar="TABLE"),
        opt.hold_option(),
        opt.switch("--stop", "end before an unreachable sample instead of failing"),
        *opt.GUESS,
        *opt.RESULT,
    )),
    "states": opt.Command(states, (
        opt.option("table",
                   "a .csv file: a line of names, as arm_1 [deg], arm_2, arm_3; then a line of "
                   "numbers for every configuration, in any order", metavar="TABLE"),
        opt.hold_option(),
        opt.option("--threads", "how many are solved at a time (as many as there are cores)",
                   type=opt.count, metavar="N"),
        *opt.GUESS,
        *opt.RESULT,
    )),
    "simulate": opt.Command(simulate, (
        opt.option("--duration", "how long, as 10 or 500ms", type=opt.above_zero, required=True),
        opt.option("--rows", "number of rows (1001)", type=opt.count, default=1001),
        *opt.start_options("--speed"),
        opt.option("--on-joint-limit", "action where a joint passes a limit of the URDF (report)",
                   choices=("report", "stop", "ignore"), default="report"),
        opt.option("--accuracy", "of the integrator (engineering)",
                   choices=("draft", "engineering", "reference"), default="engineering"),
        *opt.GUESS,
        *opt.RESULT,
    )),
    "clearance": opt.Command(clearance, (
        *opt.sweep_arguments(needed=False),
        opt.hold_option(opt.SPRINGS_HELP),
        opt.many("--at", "at this configuration instead of along a sweep", type=opt.setting,
                 metavar="DRIVER=VALUE"),
        opt.many("--between", "only these two links, joined ones too", nargs=2,
                 metavar=("LINK", "LINK")),
        opt.option("--tolerance", "distance at which links count as touching, as 2mm (0)",
                   type=opt.value, default=0.0, metavar="DISTANCE"),
        *opt.data_options("the pairs of links", "the pairs of links"),
    )),
}
PAGES = {
    "show": opt.Command(show, (
        *opt.sweep_arguments(needed=False),
        opt.hold_option(opt.SPRINGS_HELP),
        opt.file_option("--movie", "write it as a film (.gif, .mp4) instead"),
        opt.switch("--live",
                   "move it by hand instead: a slider for every driver, or the one named"),
        opt.option("--limits",
                   "a joint limit of the URDF is a limit position too; --live keeps them at "
                   "first, unless --no-limits is given", action=argparse.BooleanOptionalAction),
        opt.many("--output",
                 "outputs that --live shows besides the drivers, as rocker_pin, coupler.position"),
        *opt.LOOK,
    )),
    "report": opt.Command(report, (
        *opt.sweep_arguments(needed=False),
        opt.hold_option(opt.SPRINGS_HELP),
        opt.file_option("--html", "the file to write", required=True),
        opt.many("--output", "outputs in its figures, as rocker_pin or coupler.com.position"),
        opt.option("--title", "heading (the mechanism's title)"),
        *opt.data_options("the name of the file"),
    )),
}
