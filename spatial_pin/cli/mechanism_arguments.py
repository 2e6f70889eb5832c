"""What options say of a mechanism: the mechanism itself, values in its units, names it has."""

from __future__ import annotations

import argparse
import contextlib
import signal
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor, ProcessPoolExecutor
from typing import Any, TypeVar, cast

import numpy as np

import spatial_pin as sp
from spatial_pin.assembly.holding import BASE, SPRINGS, is_base
from spatial_pin.errors import UnknownNameError
from spatial_pin.inverse_kinematics.named_targets import is_angle, is_part
from spatial_pin.mechanism.joint_limits import joint_limits
from spatial_pin.proximity.clearance import standing
from spatial_pin.units import ValueWithUnit, likely_unit

MANY_TURNS = 12.0  # [rad], nearly two turns: larger whole numbers are usually degrees
Result = TypeVar("Result")
RATES = {"speed": "/s", "acceleration": "/s2"}  # end of the unit
NO_SLIDE = 30.0  # characteristic lengths that no slide goes


def loaded(options: argparse.Namespace) -> sp.Mechanism:
    """Return the mechanism; dimensions far off their defaults are hints."""
    given: dict[str, Any] = unique(options, options.parameters)
    how: dict[str, Any] = {"trusted": options.trusted, "free_flyer": options.free_flyer,
                           "packages": dict(options.packages), "model": options.model,
                           "without": options.without}
    plain = {name: x for name, x in given.items() if isinstance(x, ValueWithUnit) and not x.unit}
    if plain:  # first: with far-off numbers a file may not even load
        rest = {name: x for name, x in given.items() if name not in plain}
        usual: Mapping[str, float] = {}
        with contextlib.suppress(sp.SpatialPinError):  # what needs a dimension has no default
            usual = sp.load(options.mechanism, **how, **rest).dimensions
        for name, x in plain.items():  # as far off its default as another unit would bring it?
            times = x / usual[name] if usual.get(name) else 1.0
            if unit := likely_unit(times):
                options.hints.append(
                    f"{name} is {times:.4g} times its default {usual[name]:.6g}: {unit}?")
    return sp.load(options.mechanism, **how, **given)


def unique(
    options: argparse.Namespace, settings: list[tuple[str, Result]], of: str = "values"
) -> dict[str, Result]:
    """Return values by name; two of one name are wrong usage."""
    values = dict(settings)
    if len(values) < len(settings):
        options.usage_error(f"a name is given two {of}")
    return values


def fitting(
    options: argparse.Namespace, mechanism: sp.Mechanism, values: Mapping[str, float],
    rate: str = "",
) -> dict[str, float]:
    """Return coordinate values after a look at their units; names are checked elsewhere.

    Args:
        options: of the command; gets hints.
        mechanism: whose coordinates these are.
        values: by name.
        rate: a key of RATES, where they are speeds or accelerations.
    """
    known = mechanism.coordinate_table
    for name, x in values.items():
        driver = mechanism.drivers.get(name)
        coordinate = known.get(driver.joint if driver else name)
        is_output = not coordinate and isinstance(x, ValueWithUnit) and is_part(mechanism, name)
        if not (coordinate or is_output) or not isinstance(x, ValueWithUnit):
            continue
        unit = coordinate.unit if coordinate else "rad" if is_angle(mechanism, name) else "m"
        if not x.is_for(unit + RATES.get(rate, "")):
            of = f"the {rate} of " if rate else ""
            raise ValueError(f"{of}{name} is in {unit}{RATES.get(rate, '')}, not in {x.unit}")
        if coordinate and not x.unit and not rate:
            options.hints += _strange(mechanism, name, x, coordinate.unit)
    return dict(values)


def _strange(mechanism: sp.Mechanism, name: str, x: float, unit: str) -> list[str]:
    """Return a hint for a coordinate that goes where hardly any does."""
    turns = abs(x) / (2.0 * 3.141592653589793)
    if unit == "rad" and abs(x) > MANY_TURNS and x == int(x):
        return [f"{name} = {x:g} rad is {turns:.3g} turns: {x:g}deg?"]
    if unit == "m" and abs(x) > NO_SLIDE * mechanism.characteristic_length:
        return [f"{name} = {x:g} m is {abs(x) / mechanism.characteristic_length:.3g} times the "
                f"length of the mechanism: {x:g}mm?"]
    factor, word = (np.pi / 180.0, "deg") if unit == "rad" else (1e-3, "mm")
    if abs(x) >= 1.0 and _is_beyond(mechanism, name, x) and not _is_beyond(
            mechanism, name, factor * x):
        return [f"{name} = {x:g} {unit} is beyond its joint limits, and {x:g}{word} is not: "
                f"{x:g}{word}?"]
    return []


def _is_beyond(mechanism: sp.Mechanism, name: str, x: float) -> bool:
    """Whether a value is beyond a joint limit of its coordinate."""
    coordinate = mechanism.coordinate(name).name
    return any(limit.side * (x - limit.value) > 0.0
               for limit in joint_limits(mechanism) if limit.name == coordinate)


def in_units(values: Mapping[str, float], *units: str) -> None:
    """Refuse quantities in other units."""
    for name, x in values.items():
        if isinstance(x, ValueWithUnit) and x.unit not in ("", *units):
            raise ValueError(f"{name} is in {' or '.join(units)}, not in {x.unit}")


def check_names(options: argparse.Namespace, mechanism: sp.Mechanism) -> None:
    """Refuse names of outputs, traces, arrows and held coordinates that do not exist."""
    check_held(options, mechanism)
    if not any(getattr(options, key, ()) for key in ("output", "trace", "arrow")):
        return
    motion = standing(sp.State(mechanism, np.array(mechanism.neutral), closure_error=np.nan))
    for name in getattr(options, "output", ()):
        try:
            motion.output(name)
        except UnknownNameError:
            raise
        except (sp.SpatialPinError, ValueError):
            continue  # what this motion cannot have, another may have
    for name in getattr(options, "trace", ()):
        mechanism.frame_id(name.removesuffix(".com"))
    if not getattr(options, "arrow", ()):
        return
    from spatial_pin.view.scene.layers.arrows import LOADS, rates  # imported on use: meshcat

    pairs = [*list(mechanism.model.names)[1:], *(c.name for c in mechanism.closures)]
    for arrow in options.arrow:
        pair, _, kind = arrow.rpartition(".")
        if kind not in LOADS:
            with contextlib.suppress(ValueError):
                rates(motion, arrow)
        elif pair not in pairs:
            raise UnknownNameError("pair", pair, pairs, f"mechanism {mechanism.name!r}: ")


def check_held(options: argparse.Namespace, mechanism: sp.Mechanism) -> None:
    """Refuse names of held coordinates that do not exist."""
    for name in getattr(options, "hold", ()):
        if name not in (*mechanism.model.names, SPRINGS) and not is_base(mechanism, name):
            mechanism.coordinate(name)


def guess_of(options: argparse.Namespace, mechanism: sp.Mechanism) -> dict[str, float] | None:
    """Return the guess that is given, None for that of the file."""
    return fitting(options, mechanism, unique(options, options.guess)) or None


def state_at(options: argparse.Namespace, mechanism: sp.Mechanism) -> sp.State:
    """Return the configuration that `configuration_options`, and `rate_options`, ask for."""
    values = fitting(options, mechanism, unique(options, options.values))
    state = sp.assemble(mechanism, values, guess_of(options, mechanism))
    speeds, accelerations = (
        fitting(options, mechanism, unique(options, getattr(options, key, [])), key)
        for key in RATES)
    if speeds or accelerations:
        state = sp.solve_rates(mechanism, state, speeds, accelerations)
    return state


def motion_over(
    options: argparse.Namespace, mechanism: sp.Mechanism, of_rates: bool = False
) -> sp.Motion | None:
    """Return the sweep that `--over` asks for, if it does, without a speed.

    After Ctrl-C as far as it was followed; `options.cut_short` says so. Of one configuration rates
    are wanted, or `--hold` is refused there.
    """
    check_held(options, mechanism)
    if options.over is None:
        if options.hold and not of_rates:
            options.usage_error("--hold belongs to --over: in one configuration nothing moves")
        return None
    name, ends = options.over
    if options.values:
        options.usage_error("--over goes from the guess on: DRIVER=VALUE belongs to one "
                            "configuration")
    for end in ends:
        fitting(options, mechanism, {name: end})
    values = np.linspace(ends[0], ends[1], options.steps)
    try:
        return sp.sweep(mechanism, name, values, guess=guess_of(options, mechanism),
                        hold=held(options), progress=True)
    except sp.Interrupted as stopped:  # the samples so far are reported
        options.cut_short = f"cut short after {len(stopped.result)} values"
        return stopped.result


def held(options: argparse.Namespace) -> list[str]:
    """Return the held coordinates: free bases, and the names after `--hold`."""
    return [BASE, *options.hold]


def along(options: argparse.Namespace, work: Callable[[], Any]) -> Any:
    """Return a result along a motion; after Ctrl-C the unfinished one, with `options.cut_short`."""
    try:
        return work()
    except sp.Interrupted as stopped:
        options.cut_short = f"cut short after {len(stopped.motion or ())} values"
        return stopped.result


def or_partial_result(work: Callable[[], Result]) -> Result:
    """Return a result; after Ctrl-C the unfinished one, whose `is_whole` is false."""
    try:
        return work()
    except sp.Interrupted as stopped:
        return cast(Result, stopped.result)


@contextlib.contextmanager
def workers(count: int) -> Iterator[Executor | None]:
    """Make processes that leave Ctrl-C to this one; none for one."""
    if count == 1:
        yield None
        return
    with ProcessPoolExecutor(count, initializer=signal.signal,
                             initargs=(signal.SIGINT, signal.SIG_IGN)) as executor:
        yield executor
