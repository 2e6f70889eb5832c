"""Commands for the eye: show, report."""

from __future__ import annotations

import argparse

import spatial_pin as sp
from spatial_pin.cli.arguments import check_names, guess_of, loaded
from spatial_pin.cli.commands.motions import look_of, shown
from spatial_pin.cli.options import (
    LOOK,
    SPRINGS_HELP,
    Command,
    data_options,
    hold_option,
    option,
    sweep_arguments,
)
from spatial_pin.cli.printing import print_result, wrote
from spatial_pin.view import Viewer


def show(options: argparse.Namespace) -> None:
    """Animate a motion in the browser."""
    mechanism = loaded(options)
    if options.live:
        _wait(mechanism, _live(options, mechanism))
        return
    subject, look = shown(options, mechanism), look_of(options)
    if options.movie:
        wrote([sp.movie(subject, options.movie, look=look, progress=True)])
        return
    _wait(mechanism, sp.show(subject, look=look))


def _live(options: argparse.Namespace, mechanism: sp.Mechanism) -> Viewer:
    """The page whose sliders move a mechanism from its guess on."""
    if options.movie or options.last is not None or options.hold:
        options.usage_error("--live takes no values to sweep, holds nothing and makes no film")
    check_names(options, mechanism)
    state = sp.assemble(mechanism, {}, guess_of(options, mechanism))
    named = [options.driver] if options.driver else None
    return sp.live(mechanism, state, drivers=named, outputs=options.output,
                   limits=options.limits is not False)


def _wait(mechanism: sp.Mechanism, viewer: Viewer) -> None:
    with viewer:
        print(f"{mechanism.name}: {viewer.url} (Ctrl-C ends)", flush=True)
        viewer.wait()


def report(options: argparse.Namespace) -> None:
    """Write a page to send and to print: 3-D, curves, numbers."""
    mechanism = loaded(options)
    path = sp.report(shown(options, mechanism), options.html, outputs=options.output or None,
                     title=options.title)
    print_result(options, "", {"mechanism": mechanism.name, "wrote": [str(path)]}, files=[path])


COMMANDS = {
    "show": Command(show, (
        *sweep_arguments(needed=False),
        *hold_option(SPRINGS_HELP),
        option("--movie", metavar="F", help="write it as a film (.gif, .mp4) instead"),
        option("--live", action="store_true",
               help="move it by hand instead: a slider for every driver, or the one named"),
        option("--limits", action=argparse.BooleanOptionalAction,
               help="a joint limit of the URDF is a limit position too; --live keeps them "
                    "at first unless it is told not to"),
        option("--output", action="append", default=[], metavar="NAME",
               help="what --live tells besides the drivers, as rocker_pin, coupler.position"),
        *LOOK,
    )),
    "report": Command(report, (
        *sweep_arguments(needed=False),
        *hold_option(SPRINGS_HELP),
        option("--html", metavar="F", required=True, help="the file to write"),
        option("--output", action="append", default=[], metavar="NAME",
               help="what its figures show, as rocker_pin or coupler.com.position"),
        option("--title", help="heading (the mechanism's title)"),
        *data_options("the name of the file"),
    )),
}
