"""The errors of the library; each keeps the evidence it speaks of."""

from __future__ import annotations

import difflib
import sys
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # errors keep a State or a Motion, and use nothing of them
    from numpy.typing import NDArray

    import spatial_pin as sp


LONG_LIST = 40  # from this number on, names that differ only in their endings are shown as one


class SpatialPinError(Exception):
    """Base of every error this library raises about a mechanism.

    It can be copied and sent to another process, with all that it keeps.

    Example:
        >>> try:
        ...     sp.load("four_bra")
        ... except sp.SpatialPinError as error:
        ...     print(str(error)[-24:])
        did you mean 'four_bar'?
    """

    def __reduce__(self) -> tuple[Any, ...]:
        """Make it anew from its message, then give it its fields: no constructor is called."""
        return _again, (type(self), self.args), self.__dict__


def _again(kind: type[SpatialPinError], args: tuple[Any, ...]) -> SpatialPinError:
    return kind.__new__(kind, *args)


class SpatialPinWarning(UserWarning):
    """A warning: the answer is correct, but may not be the answer to your question.

    Example:
        >>> import warnings
        >>> with warnings.catch_warnings():
        ...     warnings.simplefilter("error", sp.SpatialPinWarning)  # makes them errors
        ...     state = sp.assemble(sp.load("rssr"), {"crank": 1.0})
    """


def warn(text: str) -> None:
    """Warn with a SpatialPinWarning, at the line outside of this library that led here."""
    level, frame = 1, sys._getframe(0)
    while frame.f_back and frame.f_globals.get("__name__", "").partition(".")[0] == __package__:
        level, frame = level + 1, frame.f_back
    warnings.warn(text, SpatialPinWarning, stacklevel=level)


class MechanismFileError(SpatialPinError):
    """A mechanism file cannot be used; the message names file, key and remedy.

    Attributes:
        mistakes: a sentence for every mistake in the file, in order.

    Example:
        >>> try:
        ...     sp.load("four_bar", r5=0.3)
        ... except sp.MechanismFileError as error:
        ...     print(str(error).partition(": ")[2], len(error.mistakes))
        no parameter 'r5'; there are: r1, r2, r3, r4 1
    """

    @property
    def mistakes(self) -> tuple[str, ...]:
        """A sentence for every mistake."""
        return tuple(self.__dict__.get("_mistakes", (str(self),)))


class Mistakes:
    """Mistakes of one file, collected and raised together.

    Args:
        where: the file, as its mistakes name it.
    """

    def __init__(self, where: str) -> None:
        self._where = where
        self._errors: list[MechanismFileError] = []

    def __len__(self) -> int:
        return len(self._errors)

    @contextmanager
    def each(self) -> Iterator[None]:
        """Add a mistake that the block raises, and go on after the block."""
        try:
            yield
        except MechanismFileError as error:
            self.note(error)

    def note(self, error: MechanismFileError) -> None:
        """Add a mistake, or several that were raised together, each once."""
        several = error.__dict__.get("_mistakes", ())
        for one in map(MechanismFileError, several) if several else (error,):
            if str(one) not in map(str, self._errors):
                self._errors.append(one)

    def raise_all(self) -> None:
        """Raise the collected mistakes, if there are any.

        Raises:
            MechanismFileError: a single mistake as it was raised; several, one a line.
        """
        if len(self) == 1:
            raise self._errors[0]
        if self._errors:
            texts = tuple(str(error) for error in self._errors)
            lines = (f"  ({k}) {text.removeprefix(f'{self._where}: ')}"
                     for k, text in enumerate(texts, start=1))
            error = MechanismFileError(
                "\n".join([f"{self._where}: {len(texts)} mistakes:", *lines]))
            error.__dict__["_mistakes"] = texts
            raise error


class UnknownNameError(SpatialPinError, LookupError):
    """A link, frame, joint, coordinate or driver of that name does not exist.

    Attributes:
        name: the unknown name.
        valid: the names that exist.

    Example:
        >>> try:
        ...     sp.assemble(sp.load("rssr"), {"crnk": 1.0})
        ... except sp.UnknownNameError as error:
        ...     print(error)
        mechanism 'rssr': no coordinate or driver 'crnk'; did you mean 'crank'?
    """

    def __init__(self, kind: str, name: str, valid: Iterable[str], where: str = "") -> None:
        self.name = name
        self.valid = sorted(set(valid))
        super().__init__(f"{where}no {kind} {name!r}; {suggestion(name, self.valid)}")


class SampleError(SpatialPinError, IndexError):
    """A motion has no sample of that number.

    Example:
        >>> motion = sp.sweep(sp.load("rssr"), "crank", [0.0, 0.5, 1.0])
        >>> try:
        ...     motion[3]
        ... except sp.SampleError as error:
        ...     print(error)
        there is no sample 3: 3 samples are 0 to 2, or -3 to -1
    """


class AssemblyError(SpatialPinError):
    """The solver reached no closed configuration.

    Attributes:
        closure_error: the least closure error reached [-, see `Mechanism.characteristic_length`].
        worst_closure: name of the closure that stays open the most.
        state: the State of that best attempt; its loops are open.

    Example:
        >>> try:
        ...     sp.assemble(sp.load("four_bar", r2=0.25), {"crank": 3.0})
        ... except sp.AssemblyError as error:
        ...     print(error.worst_closure, f"{error.closure_error:.3f}")
        output_pin 0.053
    """

    def __init__(
        self, message: str, *, closure_error: float, worst_closure: str,
        state: sp.State | None = None,
    ) -> None:
        super().__init__(message)
        self.closure_error = closure_error
        self.worst_closure = worst_closure
        self.state = state


class LimitError(SpatialPinError):
    """The driver cannot reach a value.

    Attributes:
        limit: the driver value of the limit position, or the value at which a joint goes to
            infinity [rad or m].
        motion: the samples before it.

    Example:
        >>> try:
        ...     sp.sweep(sp.load("four_bar", r2=0.25), "crank", np.linspace(0.0, 3.0, 31))
        ... except sp.LimitError as error:
        ...     print(f"{error.limit:.4f} rad,", len(error.motion), "samples before it")
        2.4751 rad, 25 samples before it
    """

    def __init__(self, message: str, *, limit: float, motion: sp.Motion | None = None) -> None:
        super().__init__(message)
        self.limit = limit
        self.motion = motion


class ReachError(SpatialPinError):
    """Targets cannot be reached.

    Attributes:
        state: the nearest configuration that was reached; its loops are closed.
        distances: distance to each target, by name [lengths relative to the characteristic length,
            rad].
        residuals: the same with its components: from where each target should be to where it is.
        stops: the reasons in words.
        reasons: for each of these "joint limit", "dead centre", "singular direction" (no motion of
            the joints moves the targets along the residuals), "too few freedoms", "nothing moves",
            "steps" (the limit of steps) or "nearest found".
        limits: names of the coordinates whose joint limits stop the motion.
        motion: the samples before it along a path of targets; else None.

    Example:
        >>> try:
        ...     sp.reach(sp.load("delta"), {"platform": [3.0, 0.0, -0.9]})
        ... except sp.ReachError as error:
        ...     print(error.reasons, f"{error.distances['platform']:.2f}")
        ('singular direction',) 1.36
    """

    def __init__(
        self, message: str, *, state: sp.State, distances: dict[str, float],
        residuals: dict[str, NDArray[Any]], stops: tuple[str, ...], reasons: tuple[str, ...],
        limits: tuple[str, ...],
    ) -> None:
        super().__init__(message)
        self.state = state
        self.distances, self.residuals = distances, residuals
        self.stops, self.reasons, self.limits = stops, reasons, limits
        self.motion: sp.Motion | None = None


class Interrupted(KeyboardInterrupt):
    """Ctrl-C, with the unfinished result; `except KeyboardInterrupt` catches it.

    Every long verb raises it. Before there is any result, it is a plain KeyboardInterrupt.

    Attributes:
        motion: the samples until then, a Motion or Simulation; None in a search.
        result: the verb's result until then, with `is_whole` False if it has this attribute. For
            verbs that return a motion it is this motion.

    Example:
        >>> try:
        ...     motion = sp.sweep(sp.load("rssr"), "crank", np.linspace(0.0, 6.28, 1000))
        ... except sp.Interrupted as stopped:
        ...     motion = stopped.motion
        >>> len(motion)
        1000
        >>> sp.Interrupted(motion).found is motion  # another word for its result
        True
    """

    def __init__(self, motion: sp.Motion | None, result: Any = None) -> None:
        super().__init__(f"after {len(motion)} samples" if motion is not None
                         else "before the result was whole")
        self.motion = motion
        self.result: Any = motion if result is None else result

    @property
    def found(self) -> Any:
        """Another word for `result`."""
        return self.result

    def __reduce__(self) -> tuple[Any, ...]:
        """Make it anew from its parts."""
        return type(self), (self.motion, self.result)

    def __repr__(self) -> str:
        return f"Interrupted({self}; not whole: {self.result!r})"


def unless_cut(result: Any, motion: sp.Motion | None = None) -> Any:
    """Return a result that is whole.

    Args:
        result: it has an attribute `is_whole`.
        motion: the motion along which it was computed, if any.

    Raises:
        Interrupted: Ctrl-C has cut it short; it holds the results until then.
    """
    if not result.is_whole:
        raise Interrupted(motion, result)
    return result


class SingularError(SpatialPinError):
    """The rates, or the branch to follow, are not determined at a configuration.

    Attributes:
        state: the configuration, when there is one.
        motion: the samples before it, if it was raised by a sweep.

    Example:
        >>> mech = sp.load("slider_crank")
        >>> state = sp.assemble(mech, {"crank": 0.0})  # the slider is at its limit position
        >>> try:
        ...     sp.solve_rates(mech, state, {"slide": 1.0})
        ... except sp.SingularError as error:
        ...     print(str(error).split(",")[0].partition(": ")[2])
        singular configuration: 'slide' is at a limit position there
    """

    def __init__(
        self, message: str, *, state: sp.State | None = None, motion: sp.Motion | None = None
    ) -> None:
        super().__init__(message)
        self.state = state
        self.motion = motion


class EnergyError(SpatialPinError):
    """The energy of a simulation grows without work.

    Attributes:
        motion: the samples before it.

    Example:
        >>> mech = sp.load("four_bar")
        >>> try:
        ...     motion = sp.simulate(mech, sp.assemble(mech, {"crank": 1.0}), 0.1)  # [s]
        ... except sp.EnergyError as error:
        ...     motion = error.motion  # up to where it was refused
        >>> len(motion)
        1001
    """

    def __init__(self, message: str, *, motion: sp.Motion | None = None) -> None:
        super().__init__(message)
        self.motion = motion


class StepLimitError(SpatialPinError):
    """A simulation reached its largest number of steps.

    Attributes:
        motion: the samples before it.

    Example:
        >>> mech = sp.load("four_bar")
        >>> short = sp.Accuracy(most_steps=5)
        >>> try:
        ...     sp.simulate(mech, sp.assemble(mech, {"crank": 1.0}), 10.0, accuracy=short)
        ... except sp.StepLimitError as error:
        ...     print(len(error.motion), "samples before it")
        4 samples before it
    """

    def __init__(self, message: str, *, motion: sp.Motion | None = None) -> None:
        super().__init__(message)
        self.motion = motion


class ContinuumError(SingularError):
    """With the given values held the mechanism can still move: its modes cannot be listed.

    Attributes:
        state: one of the configurations that can move.
        freedoms: its number of freedoms there, without passive ones.
        coordinates: names of the coordinates that move.
        hold: drivers or coordinates that stop it if they are held too.

    Example:
        >>> try:
        ...     sp.assembly_modes(sp.load("four_bar"), free=["crank"])
        ... except sp.ContinuumError as error:
        ...     print(error.freedoms, error.hold)
        1 ('crank',)
    """

    def __init__(
        self, message: str, *, state: sp.State, freedoms: int, coordinates: tuple[str, ...],
        hold: tuple[str, ...],
    ) -> None:
        super().__init__(message, state=state)
        self.freedoms = freedoms
        self.coordinates = coordinates
        self.hold = hold


class ClosureTypeError(SpatialPinError):
    """The closure has no counterpart in the requested form.

    Example:
        >>> try:
        ...     sp.load("four_bar").constraint_models()
        ... except sp.ClosureTypeError as error:
        ...     print(str(error).split("; ")[0].partition(": ")[2])
        closure 'output_pin' is revolute
    """


def suggestion(name: str, valid: Iterable[str]) -> str:
    """Return "did you mean 'x'?" for the nearest valid name, else all names."""
    names = list(dict.fromkeys(valid))
    near = difflib.get_close_matches(str(name), names, n=1, cutoff=0.6)
    if near:
        return f"did you mean {near[0]!r}?"
    return f"there are: {', '.join(_together(names)) or 'none'}"


def _together(names: list[str]) -> Iterator[str]:
    """Yield all names, those of many things that have the same endings together."""
    if len(names) <= LONG_LIST:
        yield from names
        return
    endings: dict[str, list[str]] = {}
    for name in names:
        stem, dot, ending = name.rpartition(".")
        endings.setdefault(stem if dot else name, []).append(dot + ending if dot else "")
    stems: dict[tuple[str, ...], list[str]] = {}
    for stem, its_endings in endings.items():
        stems.setdefault(tuple(its_endings), []).append(stem)
    for ends, alike in stems.items():
        if len(ends) == 1:
            yield from (stem + ends[0] for stem in alike)
        else:
            also = "also " * ("" in ends)
            yield f"{', '.join(alike)} (each {also}with {', '.join(filter(None, ends))})"
