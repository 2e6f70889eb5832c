"""Commands of configurations: assemble, limits, modes, reach."""

from __future__ import annotations

import argparse
import contextlib
from typing import Any

import spatial_pin as sp
from spatial_pin.cli import options as opt
from spatial_pin.cli.commands.motions import look_of, write_followed
from spatial_pin.cli.mechanism_arguments import Options, or_partial_result
from spatial_pin.cli.printing import SCREEN, print_result
from spatial_pin.cli.tables import read_table, targets_of
from spatial_pin.inverse_kinematics.named_targets import read_targets
from spatial_pin.inverse_kinematics.targets import CoordinateValue
from spatial_pin.motion.report import assembly_summary, shown_value


def assemble(options: Options) -> None:
    """Close the loops at given driver values."""
    mechanism = options.loaded
    values = options.fitting(options.unique(options.values))
    state = sp.assemble(mechanism, values, options.start_guess, limits=options.limits,
                        release=options.release, free=options.free)
    print_result(options, assembly_summary(state), _content(state), _table(state))


def _content(state: sp.State) -> dict[str, Any]:
    """Return a configuration as JSON has it."""
    mechanism = state.mechanism
    table = mechanism.coordinate_table
    return {"mechanism": mechanism.name,
            "coordinates": {name: state.coordinate(name).value for name in table},
            "units": {name: c.unit for name, c in table.items()},
            "drivers": {name: state.coordinate(name).value for name in mechanism.drivers},
            "q": state.q.tolist(), "closure_error": state.closure_error,
            "released": dict(state.released), "beyond_limits": dict(state.beyond_limits)}


def _table(state: sp.State) -> dict[str, list[Any]]:
    """Return the coordinates of a configuration, one a row."""
    table = state.mechanism.coordinate_table
    return {"coordinate": list(table),
            "value": [float(state.coordinate(name).value) for name in table],
            "unit": [c.unit for c in table.values()]}


# ---------------------------------------------------------------- limits, modes


def limits(options: Options) -> None:
    """How far a driver can go on its branch."""
    mechanism = options.loaded
    options.check_names()
    result = sp.limits(mechanism, options.driver, options.start_guess,
                      joints=options.joints, hold=options.held)
    text, grashof = f"{mechanism.name}, {result}", None
    with contextlib.suppress(sp.SpatialPinError):  # most mechanisms are no plane four-bar
        grashof = sp.grashof(mechanism)
        text += f"\n{grashof}"
    ends = {"lower": result.lower, "upper": result.upper}
    content = {"mechanism": mechanism.name, "driver": result.driver, "unit": result.unit,
               **{name: end._asdict() for name, end in ends.items()},
               "full_turn": result.full_turn, "grashof": grashof and grashof._asdict()}
    print_result(options, text, content,
                 {"end": list(ends),
                  f"value [{result.unit}]": [float(x.value) for x in ends.values()],
                  "kind": [x.kind for x in ends.values()]})


def modes(options: Options) -> None:
    """All closed configurations at given driver values."""
    mechanism = options.loaded
    values = options.fitting(options.unique(options.values))
    modes = or_partial_result(lambda: sp.assembly_modes(
        mechanism, values, copies=options.copies, limits=options.limits,
        patience=options.patience, progress=True))
    lines = [f"{mechanism.name}: {modes}"]
    for k, mode in enumerate(modes, start=1):
        lines += [f"{k}: branch {mode.branch or '?'}", assembly_summary(mode)]
    if any(mode.branch.startswith("singular") for mode in modes):
        lines.append("a singular mode can move to first order with the given values held")
    table = {"mode": list(range(1, len(modes) + 1)), "branch": [m.branch for m in modes],
             **{f"{name} [{c.unit}]": [float(m.coordinate(name).value) for m in modes]
                for name, c in mechanism.coordinate_table.items()},
             "closure error [-]": [float(m.closure_error) for m in modes]}
    files = []
    if options.html and modes:
        look = sp.Look(ghosts=tuple(modes[1:]), side_by_side=True)
        files.append(sp.export_html(modes[0], options.html, look=look))
    print_result(options, "\n".join(lines), [
                {"branch": mode.branch, "closure_error": mode.closure_error, "q": mode.q.tolist(),
                 "coordinates": _content(mode)["coordinates"]} for mode in modes],
                 table, files, modes.is_whole)


# ---------------------------------------------------------------- reach


def reach(options: Options) -> None:
    """Find the configuration, or the motion, in which frames are where they should be."""
    mechanism = options.loaded
    targets = _targets(options)
    if options.path:
        _reach_path(options, targets)
        return
    if not targets:
        options.usage_error("there is no target: name some, or give a table by --path")
    if any((options.npz, options.plot, options.clearance)) or options.csv not in (None, SCREEN):
        options.usage_error("--csv, --npz, --plot and --clearance are for a motion: they need "
                            "--path (but --csv - for the coordinates)")
    options.check_names()
    read_targets(mechanism, targets)
    for name, one in options.targets:  # coordinates, some of them with a weight
        value = one.value if isinstance(one, CoordinateValue) else one
        if not isinstance(value, sp.Target):
            options.fitting({name: value})
    state = sp.assemble(mechanism, {}, options.start_guess)
    reached = sp.reach(mechanism, targets, state, hold=options.held,
                     limits=options.limits)
    lines = [assembly_summary(reached)]
    for name in mechanism.drivers:
        unit = mechanism.coordinate(name).unit
        lines.append(f"  driver {name} = {shown_value(reached, name):.15g} {unit}")
    files = []
    if options.html:
        files.append(sp.export_html(reached, options.html, look=look_of(options)))
    print_result(options, "\n".join(lines), _content(reached), _table(reached), files)


def _targets(options: Options) -> dict[str, Any]:
    """Return values of coordinates, and lists of the targets of frames."""
    frames: dict[str, list[Any]] = {}
    for name, one in options.targets:
        if isinstance(one, sp.Target):
            frames.setdefault(name, []).append(one)
    values = [(name, x) for name, x in options.targets if not isinstance(x, sp.Target)]
    if both := frames.keys() & dict(values):
        options.usage_error(f"{min(both)!r} is given as a frame and as a coordinate")
    return {**options.unique(values), **frames}


def _reach_path(options: Options, standing: dict[str, Any]) -> None:
    """Go along a table of targets; coordinates named with it are held."""
    if any(isinstance(one, list) for one in standing.values()):
        options.usage_error("beside --path only COORDINATE=value: frames are columns of the table")
    if not options.limits:
        options.usage_error("--no-limits is for single targets: a path reports the limits that it "
                            "passes")
    mechanism = options.loaded
    columns, times = read_table(options.path, mechanism)
    targets = targets_of(options.path, mechanism, columns)
    state = sp.assemble(mechanism, {}, options.start_guess)
    write_followed(options, lambda: sp.reach_path(
        mechanism, {**targets, **options.fitting(standing)}, times, state,
        hold=options.held, progress=True))


COMMANDS = {
    "assemble": opt.Command(assemble, (
        *opt.CONFIGURATION,
        opt.switch("--limits", "keep the joint limits"),
        opt.option("--release",
                   "let drivers that are given no value go, as little as possible, where the "
                   "loops cannot close with them at their guess",
                   action=argparse.BooleanOptionalAction, default=True),
        opt.many("--free", "a driver that goes where the loops take it", metavar="DRIVER"),
        *opt.data_options("the configuration", "its coordinates"),
    )),
    "modes": opt.Command(modes, (
        opt.option("values", opt.AT_HELP, nargs="*", default=[], type=opt.setting,
                   metavar="DRIVER=VALUE"),
        opt.option("--patience", "number of starts without a new mode that end the search (1000)",
                   type=opt.count, default=1000),
        opt.switch("--copies", "every reading of the coordinates, not one for each mode"),
        opt.switch("--limits", "only modes that keep the joint limits of the URDF"),
        *opt.data_options("the modes", "the coordinates, a mode in every row,"),
        opt.file_option("--html", "write a page that shows them side by side"),
    )),
    "limits": opt.Command(limits, (
        opt.option("driver", "driver or coordinate"),
        opt.switch("--joints", "and before a joint reaches a limit of the URDF"),
        opt.hold_option(opt.SPRINGS_HELP),
        *opt.GUESS,
        *opt.data_options("both ends", "both ends"),
    )),
    "reach": opt.Command(reach, (
        opt.option("targets",
                   "NAME.position=x,y,z, NAME.pose=x,y,z,rx,ry,rz (rotation vector), "
                   "NAME.orientation=rx,ry,rz, NAME.direction=x,y,z (of its z axis), "
                   "NAME.distance=OTHER,d (of two frames), com=x,y,z (centre of mass, _ for any), "
                   "COORDINATE=value, or another output of one number, as NAME.position.z=value, "
                   "LINK.angle=value; with @w behind it is met as well as the others let it be, "
                   "with the weight w", nargs="*", default=[], type=opt.target, metavar="TARGET"),
        opt.option("--path",
                   "a motion along a .csv file instead: a line of names, as time [s], tip.x [mm], "
                   "tip.y, tip.z and tip.rx, tip.ry, tip.rz (rotation vector), coordinates, or "
                   "other outputs, as tip.position.z, LINK.angle; then a line of numbers for "
                   "every sample", metavar="TABLE"),
        opt.hold_option(),
        opt.option("--limits", "keep the joint limits", action=argparse.BooleanOptionalAction,
                   default=True),
        *opt.GUESS,
        *opt.RESULT,
    )),
}
