"""The command `spatial-pin`: parses, calls one public verb, prints; computes nothing."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import re
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import spatial_pin as sp
from spatial_pin.formats.export import export_urdf
from spatial_pin.formats.files import library_titles
from spatial_pin.motion.default_motion import usual_motion
from spatial_pin.motion.report import assembly_summary, info, motion_summary
from spatial_pin.operators import OPERATORS
from spatial_pin.outputs import figure_suffix, write_text
from spatial_pin.units import Quantity, quantity
from spatial_pin.view import Viewer
from spatial_pin.view.page.plots import usual_outputs

DESCRIPTION = "Spatial mechanisms with closed loops: load, close, move, see."
FILES = ("csv", "npz", "plot", "html", "json", "movie", "urdf")  # options that name a file to write
MECHANISM_HELP = "library name (see `spatial-pin list`), or path of a .toml, .urdf or .xacro file"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return 0, 1 for a mechanism or solver error, 2 for usage."""
    words = sys.argv[1:] if arguments is None else arguments
    # argparse takes -90deg for an option, but nothing that begins with a space
    options = _parser().parse_args([f" {w}" if re.match(r"-\.?\d", w) else w for w in words])
    warnings.showwarning = _show_warning
    try:
        _check_files(options)
        options.run(options)
        sys.stdout.flush()
    except BrokenPipeError:  # the reader has seen enough; nothing is left to flush at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except (sp.SpatialPinError, ValueError) as error:
        print(f"spatial-pin: {error}", file=sys.stderr)
        return 1
    except OSError as error:
        what = f"{error.filename}: " if error.filename else "cannot write: "
        print(f"spatial-pin: {what}{error.strerror or error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    return 0


def _check_files(options: argparse.Namespace) -> None:
    """Refuse files that cannot be written before any work is done for them.

    Raises:
        ValueError: there is no such folder, it is not to be written in, or it is a folder; or a
            figure's name has no suffix that tells how to write it.
    """
    for name in FILES:
        path = getattr(options, name, None)
        if not path or (name == "json" and path == "-"):
            continue
        if name == "plot":
            figure_suffix(Path(path), "--plot")
        folder = Path(path).parent
        if Path(path).is_dir():
            raise ValueError(f"--{name} {path}: this is a folder; give the name of a file")
        if not folder.is_dir():
            raise ValueError(f"--{name} {path}: there is no folder {str(folder)!r}")
        if not os.access(path if Path(path).exists() else folder, os.W_OK):
            raise ValueError(f"--{name} {path}: not allowed to write there")


def _show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    print(f"spatial-pin: warning: {message}", file=sys.stderr)


class _Parser(argparse.ArgumentParser):
    """Takes options between the words of a command: `assemble rssr --set d=315mm crank=60deg`."""

    _within = False

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        if self.get_default("run") is None or self._within:
            return super().parse_known_args(args, namespace)
        self._within = True  # the next line calls this again, for options and words in turn
        try:
            return self.parse_known_intermixed_args(args, namespace)
        finally:
            self._within = False


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="spatial-pin", description=DESCRIPTION)
    parser.add_argument("--version", action="version", version=f"spatial-pin {sp.__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    def command(name: str, run: Callable[[argparse.Namespace], None], text: str,
                mechanism: bool = True) -> argparse.ArgumentParser:
        sub = commands.add_parser(name, help=text, description=text)
        sub.set_defaults(run=run, usage_error=sub.error)
        if mechanism:
            sub.add_argument("mechanism", metavar="M", help=MECHANISM_HELP)
            sub.add_argument("--set", dest="parameters", action="append", default=[], type=_setting,
                             metavar="NAME=VALUE", help="a dimension of the mechanism, as d=315mm")
            sub.add_argument("--trusted", action="store_true",
                             help="its xacro files may read files outside their folder")
            sub.add_argument("--free-flyer", action="store_true",
                             help="a floating joint carries its root link")
            sub.add_argument("--package", dest="packages", action="append", default=[],
                             type=_package, metavar="NAME=FOLDER",
                             help="where package://NAME lies, as its files name meshes")
        return sub

    listing = command("list", _list, "mechanisms and operators of the library, with their sources",
                      mechanism=False)
    listing.add_argument("--json", metavar="F", help="write the list as JSON (- for the screen)")

    sub = command("info", _info, "links, joints, closures, coordinates and freedoms")
    sub.add_argument("--json", metavar="F", help="write it as JSON (- for the screen)")

    sub = command("assemble", _assemble, "close the loops at given driver values")
    sub.add_argument("values", nargs="*", default=[], type=_setting, metavar="DRIVER=VALUE")
    _guess_option(sub)
    sub.add_argument("--limits", action="store_true", help="keep the joint limits")
    sub.add_argument("--release", action=argparse.BooleanOptionalAction, default=True,
                     help="let drivers that are given no value go, as little as possible, where "
                          "the loops cannot close with them at their guess")
    sub.add_argument("--free", action="append", default=[], metavar="DRIVER",
                     help="a driver that goes where the loops take it")
    sub.add_argument("--json", metavar="F", help="write the configuration as JSON")

    sub = command("sweep", _sweep, "follow one branch from one driver value to another")
    _sweep_arguments(sub)
    sub.add_argument("--hold", action="append", default=[], metavar="NAME",
                     help="a joint or coordinate that stands still, besides a free base; springs "
                          "for all joints that springs act about")
    sub.add_argument("--only", action="append", default=[], metavar="NAME",
                     help="sweep the smallest model that yields this coordinate, link or frame, "
                          "and say what it leaves out")
    _result_options(sub)

    sub = command("simulate", _simulate, "let it move under gravity, springs and efforts")
    sub.add_argument("--duration", type=_quantity, required=True, help="how long, as 10 or 500ms")
    sub.add_argument("--rows", type=_count, default=1001, help="number of rows (1001)")
    _start_options(sub, "--speed")
    sub.add_argument("--on-joint-limit", choices=("report", "stop", "ignore"), default="report",
                     help="where a joint passes a limit of the URDF (report)")
    sub.add_argument("--accuracy", choices=("draft", "engineering", "reference"),
                     default="engineering")
    _guess_option(sub)
    _result_options(sub)

    sub = command("tradeoff", _tradeoff,
                  "measure what accuracy settings cost and lose on a motion of it")
    _sweep_arguments(sub, needed=False)
    sub.add_argument("--simulate", nargs="?", const=0.0, type=_quantity, metavar="DURATION",
                     help="a simulation instead of a sweep, as 10 or 500ms "
                          "(a few seconds under gravity)")
    _start_options(sub, "--begin")  # --speed is that of a sweep
    sub.add_argument("--rows", type=_count, help="number of its rows (201)")
    sub.add_argument("--repeats", type=_count, default=5, help="runs of each setting (5)")
    sub.add_argument("--error", type=_positive, help="name the cheapest setting for this error")
    sub.add_argument("--json", metavar="F", help="write the table as JSON (- for the screen)")
    sub.add_argument("--plot", metavar="F", help="write a figure (.png, .svg, .pdf)")

    sub = command("limits", _limits, "how far a driver can go on its branch")
    sub.add_argument("driver", help="driver or coordinate")
    sub.add_argument("--joints", action="store_true",
                     help="and before a joint reaches a limit of the URDF")
    _guess_option(sub)

    sub = command("modes", _modes, "all closed configurations at given driver values")
    sub.add_argument("values", nargs="*", default=[], type=_setting, metavar="DRIVER=VALUE")
    sub.add_argument("--patience", type=_count, default=1000,
                     help="go on until so many starts have found nothing new (1000)")
    sub.add_argument("--copies", action="store_true",
                     help="every reading of the coordinates, not one for each mode")
    sub.add_argument("--limits", action="store_true",
                     help="only modes that keep the joint limits of the URDF")
    sub.add_argument("--json", metavar="F", help="write the modes as JSON (- for the screen)")
    sub.add_argument("--html", metavar="F", help="write a page that shows them side by side")

    sub = command("show", _show, "animate a motion in the browser")
    _sweep_arguments(sub, needed=False)
    sub.add_argument("--movie", metavar="F", help="write it as a film (.gif, .mp4) instead")
    sub.add_argument("--live", action="store_true",
                     help="move it by hand instead: a slider for every driver, or the one named")
    sub.add_argument("--output", action="append", default=[], metavar="NAME",
                     help="what --live tells besides the drivers, as rocker_pin, coupler.position")
    _look_options(sub)

    sub = command("report", _report, "write a page to send and to print: 3-D, curves, numbers")
    _sweep_arguments(sub, needed=False)
    sub.add_argument("--html", metavar="F", required=True, help="the file to write")
    sub.add_argument("--output", action="append", default=[], metavar="NAME",
                     help="what its figures show, as rocker_pin or coupler.com.position")
    sub.add_argument("--title", help="heading (the mechanism's title)")

    sub = command("check", _check, "read a mechanism file and say what is wrong with it")

    sub = command("export", _export, "write the mechanism as plain files")
    target = sub.add_mutually_exclusive_group(required=True)
    target.add_argument("--folder", metavar="F",
                        help="a folder that can be moved: mechanism file, URDF and meshes")
    target.add_argument("--urdf", metavar="F",
                        help="expanded URDF; closures go beside it as .toml")
    target.add_argument("--mjcf", metavar="F",
                        help="MuJoCo's format (.xml); closures become equalities")
    return parser


def _result_options(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("--csv", metavar="F", help="write coordinates, rates and accelerations")
    sub.add_argument("--json", metavar="F", help="write the same as JSON")
    sub.add_argument("--npz", metavar="F", help="write all arrays")
    sub.add_argument("--plot", metavar="F", help="write a figure (.png, .svg, .pdf)")
    sub.add_argument("--output", action="append", default=[], metavar="NAME",
                     help="what --plot shows, as rocker_pin.ratio or coupler.com.acceleration")
    sub.add_argument("--html", metavar="F", help="write a self-contained page with the animation")
    _look_options(sub)


def _look_options(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("--trace", action="append", default=[], metavar="NAME",
                     help="draw the path of a link, frame or joint, or of LINK.com")
    sub.add_argument("--arrow", action="append", default=[], metavar="NAME.velocity",
                     help="draw a velocity or acceleration as an arrow")
    sub.add_argument("--axes", action="store_true", help="draw the axes of the joints")
    sub.add_argument("--pairs", action="store_true", help="draw a sign for every pair")
    sub.add_argument("--centres", action="store_true", help="mark the centres of mass")


def _look(options: argparse.Namespace) -> sp.Look:
    return sp.Look(pairs=options.pairs or None, axes=options.axes, traces=tuple(options.trace),
                   arrows=tuple(options.arrow), centres=options.centres)


def _start_options(sub: argparse.ArgumentParser, speed: str) -> None:
    sub.add_argument("--at", action="append", default=[], type=_setting, metavar="DRIVER=VALUE",
                     help="where the simulation starts")
    sub.add_argument(speed, action="append", default=[], type=_setting,
                     metavar="DRIVER=VALUE", help="how it starts, as crank=240rpm")
    sub.add_argument("--effort", action="append", default=[], type=_setting,
                     metavar="JOINT=VALUE", help="a constant torque [N·m] or force [N] in it")


def _guess_option(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("--guess", action="append", default=[], type=_setting, metavar="JOINT=VALUE",
                     help="start from here instead of the file's guess")


def _sweep_arguments(sub: argparse.ArgumentParser, needed: bool = True) -> None:
    sub.add_argument("driver", nargs=None if needed else "?", help="driver or coordinate")
    sub.add_argument("first", nargs=None if needed else "?", type=_quantity)
    sub.add_argument("last", nargs=None if needed else "?", type=_quantity)
    sub.add_argument("--steps", type=_count, default=361, help="number of values (361)")
    sub.add_argument("--speed", type=_quantity, help="of the driver, as 240rpm; without one the "
                     "motion has no time, and its forces are those at rest")
    sub.add_argument("--acceleration", type=_quantity, default=0.0)
    sub.add_argument("--stop", action="store_true",
                     help="end at a limit position instead of failing")
    _guess_option(sub)


def _quantity(text: str) -> float:
    try:
        return quantity(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


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


def _positive(text: str) -> float:
    value = _quantity(text)
    if not value > 0.0 or (isinstance(value, Quantity) and value.unit):
        raise argparse.ArgumentTypeError(f"{text!r} is not a positive number without a unit")
    return value


def _count(text: str) -> int:
    if not text.strip().isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of at least 1")
    return int(text)


def _unique(options: argparse.Namespace, settings: list[tuple[str, float]]) -> dict[str, float]:
    values = dict(settings)
    if len(values) < len(settings):
        options.usage_error("a name is given two values")
    return values


def _setting(text: str) -> tuple[str, float]:
    name, equals, value = text.partition("=")
    if not (name and equals):
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=VALUE")
    return name, _quantity(value)


# ---------------------------------------------------------------- commands


def _package(text: str) -> tuple[str, str]:
    name, separator, folder = text.partition("=")
    if not (name and separator and folder):
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=FOLDER")
    return name, folder


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
    if options.json != "-":
        print(motion_summary(motion))
    written = []
    if options.csv:
        written.append(motion.to_csv(options.csv))
    if options.npz:
        written.append(motion.save(options.npz))
    if options.plot:
        sp.plot(motion, options.output or _with_ratios(motion), options.plot)
        written.append(options.plot)
    if options.html:
        written.append(sp.export_html(motion, options.html, look=_look(options)))
    if options.json:
        columns = {name: column.tolist() for name, column in motion.columns().items()}
        _write_json({"mechanism": motion.mechanism.name, "columns": columns,
                     "events": [event._asdict() for event in motion.events]}, options.json)
        written.append(options.json)
    if options.json != "-":
        for path in written:
            print(f"wrote {path}")


def _with_ratios(motion: sp.Motion) -> list[str]:
    """The outputs looked at first, each coordinate with its speed ratio."""
    coordinates = motion.mechanism.coordinate_table
    if motion.driver is None:
        return usual_outputs(motion)
    return [name for output in usual_outputs(motion)
            for name in ([output, f"{output}.ratio"] if output in coordinates else [output])]


def _shown(options: argparse.Namespace, mechanism: sp.Mechanism) -> sp.Motion | sp.State:
    """The sweep that was asked for, or what a mechanism is shown with when none was."""
    if options.last is not None:
        return _run_sweep(options, mechanism)
    said = (options.first, options.speed, options.acceleration or None, options.guess or None)
    if any(x is not None for x in said):
        options.usage_error("a sweep needs a driver, a first and a last value")
    return usual_motion(mechanism, options.driver, options.steps)


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


if __name__ == "__main__":
    raise SystemExit(main())
