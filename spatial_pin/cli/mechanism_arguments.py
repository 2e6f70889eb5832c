"""The options of a command: the mechanism, values in its units, names that it has."""

from __future__ import annotations

import argparse
import contextlib
import signal
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor, ProcessPoolExecutor
from functools import cached_property
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


class Options(argparse.Namespace):
    """The options of a command, as the parser makes them, and what they say of its mechanism."""

    @cached_property
    def loaded(self) -> sp.Mechanism:
        """The mechanism; dimensions far off their defaults are hints."""
        given: dict[str, Any] = self.unique(self.parameters)
        how: dict[str, Any] = {"trusted": self.trusted, "free_flyer": self.free_flyer,
                               "packages": dict(self.packages), "model": self.model,
                               "without": self.without}
        plain = {name: x for name, x in given.items()
                 if isinstance(x, ValueWithUnit) and not x.unit}
        if plain:  # first: with far-off numbers a file may not even load
            rest = {name: x for name, x in given.items() if name not in plain}
            usual: Mapping[str, float] = {}
            with contextlib.suppress(sp.SpatialPinError):  # what needs a dimension has no default
                usual = sp.load(self.mechanism, **how, **rest).dimensions
            for name, x in plain.items():  # as far off its default as another unit would bring it?
                times = x / usual[name] if usual.get(name) else 1.0
                if unit := likely_unit(times):
                    self.hints.append(
                        f"{name} is {times:.4g} times its default {usual[name]:.6g}: {unit}?")
        return sp.load(self.mechanism, **how, **given)

    def unique(self, settings: list[tuple[str, Result]], of: str = "values") -> dict[str, Result]:
        """Return values by name; two of one name are wrong usage."""
        values = dict(settings)
        if len(values) < len(settings):
            self.usage_error(f"a name is given two {of}")
        return values

    def fitting(self, values: Mapping[str, float], rate: str = "") -> dict[str, float]:
        """Return coordinate values after a look at their units; names are checked elsewhere.

        `rate` is a key of RATES, where they are speeds or accelerations.
        """
        mechanism = self.loaded
        for name, x in values.items():
            driver = mechanism.drivers.get(name)
            coordinate = mechanism.coordinate_table.get(driver.joint if driver else name)
            is_output = not coordinate and isinstance(x, ValueWithUnit) and is_part(mechanism, name)
            if not (coordinate or is_output) or not isinstance(x, ValueWithUnit):
                continue
            unit = coordinate.unit if coordinate else "rad" if is_angle(mechanism, name) else "m"
            if not x.is_for(unit + RATES.get(rate, "")):
                of = f"the {rate} of " if rate else ""
                raise ValueError(f"{of}{name} is in {unit}{RATES.get(rate, '')}, not in {x.unit}")
            if coordinate and not x.unit and not rate:
                self.hints += _strange(mechanism, name, x, coordinate.unit)
        return dict(values)

    def check_held(self) -> None:
        """Refuse names of held coordinates that do not exist."""
        for name in getattr(self, "hold", ()):
            if name not in (*self.loaded.model.names, SPRINGS) and not is_base(self.loaded, name):
                self.loaded.coordinate(name)

    def check_names(self) -> None:
        """Refuse names of outputs, traces, arrows and held coordinates that do not exist."""
        self.check_held()
        if not any(getattr(self, key, ()) for key in ("output", "trace", "arrow")):
            return
        mechanism = self.loaded
        motion = standing(sp.State(mechanism, np.array(mechanism.neutral), closure_error=np.nan))
        for name in getattr(self, "output", ()):
            try:
                motion.output(name)
            except UnknownNameError:
                raise
            except (sp.SpatialPinError, ValueError):
                continue  # what this motion cannot have, another may have
        for name in getattr(self, "trace", ()):
            mechanism.frame_id(name.removesuffix(".com"))
        if not getattr(self, "arrow", ()):
            return
        from spatial_pin.view.scene.layers.arrows import LOADS, rates  # imported on use: meshcat

        pairs = [*list(mechanism.model.names)[1:], *(c.name for c in mechanism.closures)]
        for arrow in self.arrow:
            pair, _, kind = arrow.rpartition(".")
            if kind not in LOADS:
                with contextlib.suppress(ValueError):
                    rates(motion, arrow)
            elif pair not in pairs:
                raise UnknownNameError("pair", pair, pairs, f"mechanism {mechanism.name!r}: ")

    @property
    def start_guess(self) -> dict[str, float] | None:
        """The guess that is given, None for that of the file."""
        return self.fitting(self.unique(self.guess)) or None

    @property
    def held(self) -> list[str]:
        """The held coordinates: free bases, and the names after `--hold`."""
        return [BASE, *self.hold]

    def state(self) -> sp.State:
        """Return the configuration of the values, with the rates that are given."""
        state = sp.assemble(self.loaded, self.fitting(self.unique(self.values)), self.start_guess)
        speeds, accelerations = (
            self.fitting(self.unique(getattr(self, key, [])), key) for key in RATES)
        if speeds or accelerations:
            state = sp.solve_rates(self.loaded, state, speeds, accelerations)
        return state

    def motion_over(self, of_rates: bool = False) -> sp.Motion | None:
        """Return the sweep without a speed of `--over`, None where it is not given.

        After Ctrl-C as far as it was followed; `cut_short` says so. Of one configuration rates are
        wanted, or `--hold` is refused there.
        """
        self.check_held()
        if self.over is None:
            if self.hold and not of_rates:
                self.usage_error("--hold belongs to --over: in one configuration nothing moves")
            return None
        name, ends = self.over
        if self.values:
            self.usage_error("--over goes from the guess on: DRIVER=VALUE belongs to one "
                             "configuration")
        for end in ends:
            self.fitting({name: end})
        try:
            return sp.sweep(self.loaded, name, np.linspace(ends[0], ends[1], self.steps),
                            guess=self.start_guess, hold=self.held, progress=True)
        except sp.Interrupted as stopped:  # the samples so far are reported
            self.cut_short = f"cut short after {len(stopped.result)} values"
            return stopped.result

    def along(self, work: Callable[[], Any]) -> Any:
        """Return a result along a motion; after Ctrl-C the unfinished one, with `cut_short`."""
        try:
            return work()
        except sp.Interrupted as stopped:
            self.cut_short = f"cut short after {len(stopped.motion or ())} values"
            return stopped.result


def _strange(mechanism: sp.Mechanism, name: str, x: float, unit: str) -> list[str]:
    """Return a hint for a coordinate that goes where hardly any does."""
    turns = abs(x) / (2.0 * np.pi)
    if unit == "rad" and abs(x) > MANY_TURNS and x == int(x):
        return [f"{name} = {x:g} rad is {turns:.3g} turns: {x:g}deg?"]
    if unit == "m" and abs(x) > NO_SLIDE * mechanism.characteristic_length:
        return [f"{name} = {x:g} m is {abs(x) / mechanism.characteristic_length:.3g} times the "
                f"length of the mechanism: {x:g}mm?"]
    own = mechanism.coordinate(name).name
    limits = [limit for limit in joint_limits(mechanism) if limit.name == own]
    factor, word = (np.pi / 180.0, "deg") if unit == "rad" else (1e-3, "mm")
    is_beyond, would_be = (any(limit.side * (y - limit.value) > 0.0 for limit in limits)
                           for y in (x, factor * x))
    if abs(x) >= 1.0 and is_beyond and not would_be:
        return [f"{name} = {x:g} {unit} is beyond its joint limits, and {x:g}{word} is not: "
                f"{x:g}{word}?"]
    return []


def in_units(values: Mapping[str, float], *units: str) -> None:
    """Refuse quantities in other units."""
    for name, x in values.items():
        if isinstance(x, ValueWithUnit) and x.unit not in ("", *units):
            raise ValueError(f"{name} is in {' or '.join(units)}, not in {x.unit}")


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
