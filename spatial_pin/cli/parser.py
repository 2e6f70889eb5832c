"""The words of the command line as options: every command with its own, in one table."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import spatial_pin as sp
from spatial_pin.cli.tables import read_target
from spatial_pin.units import Quantity, quantity

DESCRIPTION = "Spatial mechanisms with closed loops: load, close, move, see."
MECHANISM_HELP = "library name (see `spatial-pin list`), or path of a .toml, .urdf or .xacro file"

Run = Callable[[argparse.Namespace], None]


def options_of(words: Sequence[str], runs: Mapping[str, Run]) -> argparse.Namespace:
    """Return the options that words ask for; their `run` is the command's of `runs`.

    Raises:
        SystemExit: the words are none of a command, or ask for help.
    """
    # argparse takes -90deg for an option, but nothing that begins with a space
    return _parser(runs).parse_args([f" {w}" if re.match(r"-\.?\d", w) else w for w in words])


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


def _parser(runs: Mapping[str, Run]) -> argparse.ArgumentParser:
    parser = _Parser(prog="spatial-pin", description=DESCRIPTION)
    parser.add_argument("--version", action="version", version=f"spatial-pin {sp.__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, (text, add_options) in COMMANDS.items():
        sub = commands.add_parser(name, help=text, description=text)
        sub.set_defaults(run=runs[name], usage_error=sub.error)
        if name != "list":
            _mechanism_options(sub)
        add_options(sub)
    return parser


# ---------------------------------------------------------------- options of the commands


def _mechanism_options(sub: argparse.ArgumentParser) -> None:
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


def _no_options(_: argparse.ArgumentParser) -> None:
    """Add nothing."""


def _list_options(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("--json", metavar="F", help="write the list as JSON (- for the screen)")


def _info_options(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("--json", metavar="F", help="write it as JSON (- for the screen)")


def _assemble_options(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("values", nargs="*", default=[], type=_setting, metavar="DRIVER=VALUE")
    _guess_option(sub)
    sub.add_argument("--limits", action="store_true", help="keep the joint limits")
    sub.add_argument("--release", action=argparse.BooleanOptionalAction, default=True,
                     help="let drivers that are given no value go, as little as possible, where "
                          "the loops cannot close with them at their guess")
    sub.add_argument("--free", action="append", default=[], metavar="DRIVER",
                     help="a driver that goes where the loops take it")
    sub.add_argument("--json", metavar="F", help="write the configuration as JSON")


def _sweep_options(sub: argparse.ArgumentParser) -> None:
    _sweep_arguments(sub)
    sub.add_argument("--hold", action="append", default=[], metavar="NAME",
                     help="a joint or coordinate that stands still, besides a free base; springs "
                          "for all joints that springs act about")
    sub.add_argument("--only", action="append", default=[], metavar="NAME",
                     help="sweep the smallest model that yields this coordinate, link or frame, "
                          "and say what it leaves out")
    _result_options(sub)


def _follow_options(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("table", metavar="TABLE", help="a .csv file: a line of names, as time [s], "
                     "boom [deg], arm; then a line of numbers for every sample")
    sub.add_argument("--hold", action="append", default=[], metavar="NAME",
                     help="a joint or coordinate that stands still, besides a free base")
    sub.add_argument("--stop", action="store_true",
                     help="end before what cannot be reached instead of failing")
    _guess_option(sub)
    _result_options(sub)


def _reach_options(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("targets", nargs="*", default=[], type=_target, metavar="TARGET",
                     help="NAME.position=x,y,z, NAME.pose=x,y,z,rx,ry,rz (rotation vector), "
                          "NAME.direction=x,y,z (of its z axis) or COORDINATE=value")
    sub.add_argument("--path", metavar="TABLE",
                     help="a motion along a .csv file instead: a line of names, as time [s], "
                          "tip.x [mm], tip.y, tip.z and tip.rx, tip.ry, tip.rz (rotation vector), "
                          "or coordinates; then a line of numbers for every sample")
    sub.add_argument("--hold", action="append", default=[], metavar="NAME",
                     help="a joint or coordinate that stands still, besides a free base")
    sub.add_argument("--limits", action=argparse.BooleanOptionalAction, default=True,
                     help="keep the joint limits")
    _guess_option(sub)
    _result_options(sub)


def _workspace_options(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("frame", metavar="FRAME", help="link, frame or joint whose points are wanted")
    sub.add_argument("ranges", nargs="+", type=_range, metavar="NAME=LO..HI",
                     help="drivers, as crank=0..90deg, or parts of the frame's pose: x, y, z, "
                          "turn_x, turn_y, turn_z, as x=-0.2..0.2")
    sub.add_argument("--points", type=_count, help="how many values each of them has")
    sub.add_argument("--task", choices=("position", "pose"),
                     help="what dexterity is of; of a grid of poses, whether the orientation is "
                          "kept")
    sub.add_argument("--limits", action=argparse.BooleanOptionalAction, default=True,
                     help="keep the joint limits")
    sub.add_argument("--on-crossing", choices=("stop", "straight"), default="stop",
                     help="what to do where branches cross (stop)")
    sub.add_argument("--clearance", type=_quantity, metavar="DISTANCE",
                     help="links that are not joined keep this distance; 0: they do not touch")
    sub.add_argument("--sheets", action="store_true",
                     help="look for other branches over the same grid")
    _workers_option(sub)
    _guess_option(sub)
    sub.add_argument("--csv", metavar="F", help="write a row for every point of the grid")
    sub.add_argument("--curves", metavar="F",
                     help="write boundary and singular curves of a grid of two (.csv)")
    sub.add_argument("--picture", metavar="F", help="write a figure (.png, .svg, .pdf)")
    sub.add_argument("--plane", choices=("xy", "xz", "yz"), help="that the figure shows")
    sub.add_argument("--at", type=_quantity, metavar="VALUE",
                     help="where the plane of a cross-section is")
    sub.add_argument("--html", metavar="F", help="write a page with the mechanism and its points")
    sub.add_argument("--json", metavar="F", help="write the table as JSON (- for the screen)")


def _calibrate_options(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("table", metavar="TABLE", help="a .csv file: a line of names, then a line of "
                     "numbers for every pose; columns of drivers are what encoders read, measured "
                     "are tip.x [mm], tip.y, tip.z and tip.rx, tip.ry, tip.rz (rotation vector), "
                     "coordinates, and NAME-OTHER, a distance; an empty field was not measured")
    sub.add_argument("--dimension", action="append", default=[], type=_bounded,
                     metavar="NAME[=LO..HI]", help="a dimension to find, as b or b=0.3..0.4")
    sub.add_argument("--offset", action="append", default=[], metavar="DRIVER",
                     help="a driver whose encoder is off")
    sub.add_argument("--base", action="store_true", help="points and placements were measured in "
                     "axes of their own: find where the mechanism stands in these")
    sub.add_argument("--read", action="append", default=[], metavar="NAME",
                     help="a coordinate that is read, besides the drivers")
    sub.add_argument("--sigma", action="append", default=[], type=_setting, metavar="NAME=VALUE",
                     help="standard deviation of position, rotation, angle, length or encoder, or "
                     "of one quantity, as position=0.02mm, crank.encoder=0.1deg")
    sub.add_argument("--loss", choices=("linear", "soft_l1", "huber", "cauchy", "arctan"),
                     default="linear", help="how much outliers count (linear: as the others)")
    sub.add_argument("--margin", type=_positive, default=1.5,
                     help="what is farther off is an outlier [sigma] (1.5)")
    _guess_option(sub)
    sub.add_argument("--json", metavar="F", help="write what was found (- for the screen)")
    sub.add_argument("--csv", metavar="F", help="write the residuals, one a row")
    sub.add_argument("--folder", metavar="F", help="write the calibrated mechanism into a folder")


def _design_options(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("dimensions", nargs="*", default=[], type=_bounded,
                     metavar="NAME=LO..HI", help="a dimension that may change, and its bounds; "
                     "NAME alone has none; besides those of the file")
    sub.add_argument("--goals", metavar="F", required=True,
                     help="what is asked for: a .toml file with [[goal]] tables and [dimensions], "
                          "or a .csv file with columns as tip.x [mm], tip.y, tip.z (a path), with "
                          "tip.rx, tip.ry, tip.rz (poses), or coordinates (a function), and "
                          "drivers")
    sub.add_argument("--starts", type=_count, default=20, help="local solutions to try (20)")
    sub.add_argument("--method", choices=("multistart", "evolution", "local"),
                     default="multistart", help="where they start (multistart)")
    sub.add_argument("--seed", type=_number_from_zero, default=0, help="of random numbers (0)")
    sub.add_argument("--most", type=_count, default=10, help="designs to tell of (10)")
    _workers_option(sub)
    sub.add_argument("--resume", metavar="F",
                     help="keep what is found in this file, and go on from what it has")
    _guess_option(sub)
    sub.add_argument("--save", metavar="FOLDER", help="write the best as a mechanism")
    sub.add_argument("--json", metavar="F", help="write all as JSON (- for the screen)")
    sub.add_argument("--html", metavar="F", help="write a page that shows the best with its goals")
    sub.add_argument("--report", metavar="F",
                     help="write a page to send and to print: the best with its goals")


def _simulate_options(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("--duration", type=_quantity, required=True, help="how long, as 10 or 500ms")
    sub.add_argument("--rows", type=_count, default=1001, help="number of rows (1001)")
    _start_options(sub, "--speed")
    sub.add_argument("--on-joint-limit", choices=("report", "stop", "ignore"), default="report",
                     help="where a joint passes a limit of the URDF (report)")
    sub.add_argument("--accuracy", choices=("draft", "engineering", "reference"),
                     default="engineering")
    _guess_option(sub)
    _result_options(sub)


def _tradeoff_options(sub: argparse.ArgumentParser) -> None:
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


def _limits_options(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("driver", help="driver or coordinate")
    sub.add_argument("--joints", action="store_true",
                     help="and before a joint reaches a limit of the URDF")
    _guess_option(sub)


def _modes_options(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("values", nargs="*", default=[], type=_setting, metavar="DRIVER=VALUE")
    sub.add_argument("--patience", type=_count, default=1000,
                     help="go on until so many starts have found nothing new (1000)")
    sub.add_argument("--copies", action="store_true",
                     help="every reading of the coordinates, not one for each mode")
    sub.add_argument("--limits", action="store_true",
                     help="only modes that keep the joint limits of the URDF")
    sub.add_argument("--json", metavar="F", help="write the modes as JSON (- for the screen)")
    sub.add_argument("--html", metavar="F", help="write a page that shows them side by side")


def _show_options(sub: argparse.ArgumentParser) -> None:
    _sweep_arguments(sub, needed=False)
    sub.add_argument("--movie", metavar="F", help="write it as a film (.gif, .mp4) instead")
    sub.add_argument("--live", action="store_true",
                     help="move it by hand instead: a slider for every driver, or the one named")
    sub.add_argument("--output", action="append", default=[], metavar="NAME",
                     help="what --live tells besides the drivers, as rocker_pin, coupler.position")
    _look_options(sub)


def _report_options(sub: argparse.ArgumentParser) -> None:
    _sweep_arguments(sub, needed=False)
    sub.add_argument("--html", metavar="F", required=True, help="the file to write")
    sub.add_argument("--output", action="append", default=[], metavar="NAME",
                     help="what its figures show, as rocker_pin or coupler.com.position")
    sub.add_argument("--title", help="heading (the mechanism's title)")


def _export_options(sub: argparse.ArgumentParser) -> None:
    target = sub.add_mutually_exclusive_group(required=True)
    target.add_argument("--folder", metavar="F",
                        help="a folder that can be moved: mechanism file, URDF and meshes")
    target.add_argument("--urdf", metavar="F",
                        help="expanded URDF; closures go beside it as .toml")
    target.add_argument("--mjcf", metavar="F",
                        help="MuJoCo's format (.xml); closures become equalities")


# ---------------------------------------------------------------- options of several commands


def _result_options(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("--csv", metavar="F", help="write coordinates, rates and accelerations")
    sub.add_argument("--json", metavar="F", help="write the same as JSON")
    sub.add_argument("--npz", metavar="F", help="write all arrays")
    sub.add_argument("--plot", metavar="F", help="write a figure (.png, .svg, .pdf)")
    sub.add_argument("--output", action="append", default=[], metavar="NAME",
                     help="what --plot shows, as rocker_pin.ratio or coupler.com.acceleration")
    sub.add_argument("--html", metavar="F", help="write a self-contained page with the animation")
    sub.add_argument("--clearance", action="store_true",
                     help="say how near links come to each other, and where they touch; the page "
                          "shows it")
    _look_options(sub)


def _look_options(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("--trace", action="append", default=[], metavar="NAME",
                     help="draw the path of a link, frame or joint, or of LINK.com")
    sub.add_argument("--arrow", action="append", default=[], metavar="NAME.velocity",
                     help="draw a velocity or acceleration as an arrow")
    sub.add_argument("--axes", action="store_true", help="draw the axes of the joints")
    sub.add_argument("--pairs", action="store_true", help="draw a sign for every pair")
    sub.add_argument("--centres", action="store_true", help="mark the centres of mass")


def _start_options(sub: argparse.ArgumentParser, speed: str) -> None:
    sub.add_argument("--at", action="append", default=[], type=_setting, metavar="DRIVER=VALUE",
                     help="where the simulation starts")
    sub.add_argument(speed, action="append", default=[], type=_setting,
                     metavar="DRIVER=VALUE", help="how it starts, as crank=240rpm")
    sub.add_argument("--effort", action="append", default=[], type=_setting,
                     metavar="JOINT=VALUE", help="a constant torque [N·m] or force [N] in it")


def _workers_option(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("--workers", type=_count, default=1,
                     help="processes that work on it; the answer is the same (1)")


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


# ---------------------------------------------------------------- values of options


def _quantity(text: str) -> float:
    try:
        return quantity(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _positive(text: str) -> float:
    value = _quantity(text)
    if not value > 0.0 or (isinstance(value, Quantity) and value.unit):
        raise argparse.ArgumentTypeError(f"{text!r} is not a positive number without a unit")
    return value


def _count(text: str) -> int:
    if not text.strip().isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of at least 1")
    return int(text)


def _setting(text: str) -> tuple[str, float]:
    name, equals, value = text.partition("=")
    if not (name and equals):
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=VALUE")
    return name, _quantity(value)


def _number_from_zero(text: str) -> int:
    if not text.strip().isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 0 up")
    return int(text)


def _range(text: str) -> tuple[str, tuple[float, float]]:
    name, equals, value = text.partition("=")
    low, dots, high = value.partition("..")
    if not (name and equals and dots):
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=LO..HI")
    return name, (_quantity(low), _quantity(high))


def _bounded(text: str) -> tuple[str, tuple[float, float] | None]:
    name, equals, _ = text.partition("=")
    return _range(text) if equals else (name, None)


def _target(text: str) -> tuple[str, Any]:
    try:
        return read_target(text)
    except (ValueError, TypeError) as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _package(text: str) -> tuple[str, str]:
    name, separator, folder = text.partition("=")
    if not (name and separator and folder):
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=FOLDER")
    return name, folder


COMMANDS: dict[str, tuple[str, Callable[[argparse.ArgumentParser], None]]] = {  # what each does
    "list": ("mechanisms and operators of the library, with their sources", _list_options),
    "info": ("links, joints, closures, coordinates and freedoms", _info_options),
    "assemble": ("close the loops at given driver values", _assemble_options),
    "sweep": ("follow one branch from one driver value to another", _sweep_options),
    "follow": ("follow one branch as several drivers go along a table", _follow_options),
    "reach": ("find the configuration, or the motion, in which frames are where they should be",
              _reach_options),
    "workspace": ("where a frame gets to over ranges of drivers or poses", _workspace_options),
    "calibrate": ("find dimensions, offsets of encoders and the base from measurements",
                  _calibrate_options),
    "design": ("find dimensions with which it does what is asked", _design_options),
    "simulate": ("let it move under gravity, springs and efforts", _simulate_options),
    "tradeoff": ("measure what accuracy settings cost and lose on a motion of it",
                 _tradeoff_options),
    "limits": ("how far a driver can go on its branch", _limits_options),
    "modes": ("all closed configurations at given driver values", _modes_options),
    "show": ("animate a motion in the browser", _show_options),
    "report": ("write a page to send and to print: 3-D, curves, numbers", _report_options),
    "check": ("read a mechanism file and say what is wrong with it", _no_options),
    "export": ("write the mechanism as plain files", _export_options),
}
