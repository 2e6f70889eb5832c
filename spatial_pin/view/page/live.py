"""A page whose sliders move the drivers of a mechanism, which follows its branch.

The page asks this process for the poses of all joints; `ANSWERS` at the end lists its questions.
"""

from __future__ import annotations

import html
import json
import math
import secrets
import threading
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from spatial_pin._support.checks import checked, finite_array, names_of
from spatial_pin.assembly.assemble import starting_state
from spatial_pin.assembly.state import State
from spatial_pin.dynamics.force_outputs import NamedOutputs
from spatial_pin.errors import SingularError, SpatialPinError, UnknownNameError
from spatial_pin.mechanism.joint_limits import joint_limits
from spatial_pin.mobility.assembly_modes import assembly_modes
from spatial_pin.motion.motion import Motion
from spatial_pin.motion.outputs import is_force
from spatial_pin.numerics.linalg import Array
from spatial_pin.view.page.html import packed_script, page, parts_of
from spatial_pin.view.page.jog import STOPS, Grip, Jog, JogStop, pulled, reaches
from spatial_pin.view.page.markup import filled, template
from spatial_pin.view.page.plots import NO_RATES, growing_curves, points_now
from spatial_pin.view.page.server import Service, Viewer, open_in_browser
from spatial_pin.view.scene.film import Film, as_motion, film, length_words, reading, unit_of_length

if TYPE_CHECKING:
    from spatial_pin.mechanism.mechanism import Mechanism
    from spatial_pin.view.scene.anatomy import Signal
    from spatial_pin.view.scene.look import Look

# Samples that the way of one driver is shown by, or those of many drivers together: 3 degrees apart
# over a turn, between which positions are interpolated; and of one of many drivers, either way.
LIVE_SAMPLES, FEWEST_SAMPLES = 121, 13
BEYOND_LIMIT = 0.04  # how far a slider goes beyond a limit relative to its length: seen as a stop
# Starts without a new assembly mode after which there are no more: a mode that one in 30 ends at is
# missed in 3 % of cases, and the page is not kept waiting.
FRUITLESS = 100
MOST_STARTS = 3000  # for assembly modes: about a second, which one waits for a page

Answer = dict[str, Any]


class Dial(NamedTuple):
    """How the values of a driver are written."""

    name: str  # of the driver
    unit: str  # "°", " mm", ..., as it follows the number
    size: float  # of the unit [rad or m]
    digits: int  # decimals shown

    def words(self, value: float) -> str:
        """Return a value [rad or m] with name and unit."""
        number = f"{value / self.size:z.{self.digits}f}".replace("-", "−")
        return f"{self.name} = {number}{self.unit}"

    def stop(self, stop: JogStop) -> str:
        """Return the obstacle in words, with its value."""
        of = f" of {stop.of}" if stop.of else ""
        return f"{STOPS[stop.kind]}{of}: {self.words(stop.value)}"


class Desk:
    """A mechanism with a slider for every driver, and the answers to its page.

    Questions are answered one at a time.

    Attributes:
        jog: the mechanism.
        dials: of its drivers.
        paths: of the joints in the picture, and their numbers.
        modes: assembly modes, and the driver values that they are for; None before the first.
    """

    def __init__(
        self, jog: Jog, outputs: tuple[str, ...], curves: tuple[str, ...] = ()
    ) -> None:
        from spatial_pin.view.scene.meshcat_commands import joint_paths

        self.jog = jog
        self.outputs, self.curves = outputs, curves
        self._start = jog.state
        self.modes: tuple[dict[str, float], list[State]] | None = None
        self._lock = threading.Lock()
        self.rows = max(FEWEST_SAMPLES, LIVE_SAMPLES // len(jog.names))
        ways = {name: reaches(jog, name, self.rows) for name in jog.names}
        self.dials = {}
        for name, (ends, _, _) in ways.items():
            size, unit = math.pi / 180, "°"
            if jog.mechanism.coordinate(name).unit != "rad":
                size, word = unit_of_length(max(map(abs, ends)))
                unit = f" {word}"
            self.dials[name] = Dial(name, unit, size, 2)
        q = np.concatenate([samples for _, _, samples in ways.values()])
        n, nv = len(q), jog.mechanism.model.nv  # all ways as a film: the picture has room for them
        still, zeros = np.zeros(n), np.zeros((n, nv))
        angles = np.repeat(jog.state.angles[None], n, axis=0)
        motion = Motion(jog.mechanism, still, "", None, q, zeros, zeros, still, still, [], angles)
        self.film = Film(jog.mechanism, q, still, (), 0.0, (), motion, np.arange(n))
        paths = enumerate(joint_paths(jog.mechanism.model))
        self.paths = {path: joint for joint, path in paths if joint}
        self.says()

    def answer(self, question: Any) -> Answer:
        """Return the answer to a question of the page."""
        kind = question.get("ask") if isinstance(question, dict) else None
        if kind not in ANSWERS:
            raise ValueError(f"a question asks for one of {', '.join(ANSWERS)}, not {kind!r}")
        with self._lock:
            answer = ANSWERS[kind](self, question)
            return {"poses": self.poses(), "values": self.values(), "says": self.says(),
                    "points": self.points(), "signals": self.signals(), **answer}

    # ------------------------------------------------------------ parts of every answer

    def poses(self) -> list[tuple[str, list[float]]]:
        """Return the meshcat path and pose of everything that moves: x y z, x y z w, scales."""
        from spatial_pin.view.scene.layers.glyphs import glyphs
        from spatial_pin.view.scene.layers.visuals import contacts, springs
        from spatial_pin.view.scene.meshcat_commands import item_path, joint_paths
        from spatial_pin.view.scene.stage import Stage, joint_poses, upright

        model = self.jog.mechanism.model
        joints = joint_poses(model, self.jog.state.q[None])
        values = list(zip(joint_paths(model)[1:], joints[0, 1:].tolist(), strict=True))
        stage = Stage(self.film, (), joints, upright(model), 1.0)
        rods = springs(stage).items + contacts(stage).items
        if any(closure.type == "distance" for closure in self.jog.mechanism.closures):
            rods += glyphs(stage, through=True).items
        for item in rods:
            if item.track is not None:
                scales = [] if item.track.scales is None else item.track.scales[0].tolist()
                values.append((item_path(item, model), [*item.track.poses[0].tolist(), *scales]))
        return values

    def values(self) -> dict[str, float]:
        """Return the driver values, each in its dial's unit."""
        return {name: self.jog.value(name) / dial.size for name, dial in self.dials.items()}

    def says(self) -> list[str]:
        """Return the readings."""
        texts = [dial.words(self.jog.value(name)) for name, dial in self.dials.items()]
        if self.outputs:
            motion = NamedOutputs(_now(self.jog), in_time=False)
            texts += [_words(motion, name) for name in self.outputs]
        beyond = self.jog.state.beyond_limits
        texts += [f"beyond limits: {', '.join(beyond)}"] if beyond else []
        return [*texts, f"closure error {self.jog.state.closure_error:.1e}"]

    def points(self) -> list[list[float | None]]:
        """Return the points that the pose adds to the curves; nothing without any."""
        return points_now(_now(self.jog), self.curves) if self.curves else []

    def signals(self) -> list[float]:
        """Return the coordinates, as the inspector of the page shows them."""
        return [float(signal.values[0]) for signal in _signals(self.jog)]

    # ------------------------------------------------------------ answers

    def move(self, question: Mapping[str, Any]) -> Answer:
        """Move a driver; return the obstacle, if there is one."""
        name, value = question.get("driver"), question.get("value")
        dial = self.dials.get(name) if isinstance(name, str) else None
        if dial is None:
            raise UnknownNameError("driver", str(name), self.dials)
        if not isinstance(value, (int, float)):
            raise ValueError(f"{name}: {value!r} is not a number")
        return _stopped(dial, self.jog.move(dial.name, value * dial.size))

    def ranges(self, question: Mapping[str, Any]) -> Answer:
        """Return the range of every slider."""
        ranges = {}
        for name, dial in self.dials.items():  # beyond its limits, and the marks of these
            ends, stops, _ = reaches(self.jog, name, self.rows)
            lower, upper = (end / dial.size for end in ends)
            room = BEYOND_LIMIT * max(upper - lower, 1e-9)
            marks = [{"at": s.value / dial.size, "text": dial.stop(s), "kind": s.kind}
                     for s in stops if s]
            ranges[name] = {"ends": (lower - room * (stops[0] is not None),
                                     upper + room * (stops[1] is not None)), "marks": marks}
        return {"ranges": ranges}

    def limits(self, question: Mapping[str, Any]) -> Answer:
        """Let joint limits be in the way, or not."""
        keep = question.get("keep")
        if not isinstance(keep, bool):
            raise ValueError(f"keep: {keep!r} is not true or false")
        self.jog.keeps_limits = keep
        return self.ranges(question)

    def home(self, question: Mapping[str, Any]) -> Answer:
        """Go back to where the page began."""
        self.jog.move_to(self._start)
        return self.ranges(question)


def _now(jog: Jog) -> Motion:
    """Return the pose of a mechanism as a motion of one sample."""
    return replace(as_motion(jog.state), driver_name=jog.names[0])


def _signals(jog: Jog) -> list[Signal]:
    """Return the coordinates of the pose of a mechanism."""
    from spatial_pin.view.scene.anatomy import signals

    return signals(film(jog.state))


def _stopped(dial: Dial, stop: JogStop | None) -> Answer:
    """Return the obstacle as plain data."""
    if stop is None:
        return {}
    answer = {"kind": stop.kind, "value": stop.value / dial.size, "text": dial.stop(stop)}
    return {"stop": answer}


def mode(desk: Desk, question: Mapping[str, Any]) -> Answer:
    """Go to the next assembly mode at the same driver values."""
    from spatial_pin.view.scene.stage import joint_poses

    jog, mechanism, held = desk.jog, desk.jog.mechanism, desk.jog.held()
    if desk.modes is None or desk.modes[0] != held:
        desk.modes = held, assembly_modes(
            mechanism, held, patience=FRUITLESS, most_starts=MOST_STARTS)
    modes, here = desk.modes[1], -1
    if modes:  # which of them this is, by the placements of its bodies
        q = np.array([jog.state.q, *(mode.q for mode in modes)])
        own, *others = joint_poses(mechanism.model, q)
        there = np.array(others)
        apart = np.linalg.norm(there[..., :3] - own[:, :3], axis=2)
        turned = 1.0 - np.abs(np.sum(there[..., 3:] * own[:, 3:], axis=2))
        here = int((apart / mechanism.characteristic_length + turned).sum(axis=1).argmin())
    for step in range(1, len(modes)):
        k = (here + step) % len(modes)
        try:
            jog.move_to(modes[k])
        except SingularError:
            continue
        return {"note": f"assembly mode {k + 1} of {len(modes)} found", **desk.ranges(question)}
    return {"note": "no other assembly mode was found"}


def drag(desk: Desk, question: Mapping[str, Any]) -> Answer:
    """Move the drivers so that a point of a link comes nearest to the pointer.

    They are moved on their branch, one after the other, and as far as each goes.
    """
    joint = desk.paths.get(str(question.get("joint")))
    if joint is None:
        raise ValueError(f"joint: {question.get('joint')!r} is none that moves")
    vectors = [finite_array(question.get(name), (3,), name)
               for name in ("point", "origin", "direction")]
    length = float(np.linalg.norm(vectors[2]))
    if length == 0.0:
        raise ValueError("direction: it has no length")
    point, origin, direction = vectors[0], vectors[1], vectors[2] / length
    grip = Grip(name="grip", weight=1.0, joint=joint, point=point, origin=origin,
                direction=direction)
    answer: Answer = {}
    for name, value in pulled(desk.jog, grip).items():
        if value != desk.jog.value(name):
            answer = _stopped(desk.dials[name], desk.jog.move(name, value)) or answer
    return answer


def _words(now: NamedOutputs, name: str) -> str:
    """Return an output of a motion of one sample; a force is that at rest."""
    if is_force(name):
        if name.endswith(".power"):
            raise SpatialPinError(NO_RATES.format(name))
        try:
            parts = now.output(name).parts()
        except SingularError:
            return f"{name}: not determined here"
        words = []
        for values, label, unit in parts:
            numbers = ", ".join(f"{x:z.4g}" for x in np.atleast_1d(values[0])).replace("-", "−")
            words.append(f"{label} = {f'({numbers})' if values.ndim > 1 else numbers} {unit}")
        return "; ".join(words)
    value, label, unit = now.output(name)
    if unit not in ("rad", "m", "kg"):
        raise SpatialPinError(NO_RATES.format(name))
    if np.ndim(value) == 1:
        return reading(label, value, unit).text(0)
    size, word = unit_of_length(float(np.abs(value).max()))
    numbers = ", ".join(f"{x / size:z.2f}" for x in value[0]).replace("-", "−")
    return f"{label} = ({numbers}) {word}"


@checked
def live(
    mechanism: Mechanism,
    guess: Mapping[str, Any] | State | Array | None = None,
    *,
    drivers: Iterable[str] | None = None,
    outputs: Iterable[str] = (),
    title: str | None = None,
    look: Look | None = None,
    limits: bool = True,
    port: int = 0,
    open_browser: bool = True,
    state: Mapping[str, Any] | State | Array | None = None,
) -> Viewer:
    """Move a mechanism by hand: a page with a slider for every driver.

    The mechanism stays on its branch. At a branch point it goes straight on. If a driver cannot go
    on (a limit, a singular configuration, a joint limit of any joint), the slider stops and the
    page says so. A switch lets joints pass their limits. A dragged link follows the pointer as far
    as the drivers allow. The page needs this process: `live(mechanism).wait()` keeps it until
    Ctrl-C. The server answers only this machine, and only the page itself.

    Args:
        mechanism: the mechanism.
        guess: the first configuration: a State, or a guess as for `assemble`; default the file's
            guess.
        drivers: drivers, or other coordinates that determine the motion, each with a slider;
            default the mechanism's drivers.
        outputs: other quantities that the page shows, as for `plot`: coordinates, `NAME.position`,
            `crank.effort` and `PAIR.reaction` at rest.
        title: heading; the mechanism's title if not given.
        look: extras of the picture besides the bodies; without arrows, and traces only with one
            driver; its curves grow while the mechanism is moved.
        limits: whether joint limits are kept at first.
        port: on the loopback interface, 0 for any that is free.
        open_browser: whether to open a browser; if none can be, a warning gives the address.
        state: another word for `guess`.

    Returns:
        The Viewer that serves the page.

    Raises:
        AssemblyError: the guess does not close.
        SingularError: the drivers do not determine the motion at the start.
        UnknownNameError: a name does not exist.
        SpatialPinError: there is nothing to move it by, or no port can be had.

    Example:
        >>> viewer = sp.live(sp.load("rssr"), outputs=["rocker_pin"], open_browser=False)
        >>> viewer.running
        True
        >>> viewer.stop()  # a script that is to go on showing waits: viewer.wait()
    """
    from spatial_pin.view.scene.meshcat_commands import scene

    state = starting_state(mechanism, guess, state)
    names = tuple(mechanism.drivers if drivers is None else dict.fromkeys(
        names_of(drivers, "drivers")))
    jog = Jog(state, names)
    jog.keeps_limits = limits and bool(joint_limits(mechanism))
    if look is not None and look.arrows:
        raise SpatialPinError(
            "a page that is moved by hand knows no rates: leave `arrows` out of its look"
        )
    if look is not None and look.traces and len(names) > 1:
        raise SpatialPinError(
            f"a path belongs to one driver, and {len(names)} are moved by hand: leave "
            "`traces` out of the look, or name one driver in `drivers`"
        )
    desk = Desk(jog, tuple(names_of(outputs, "outputs")), () if look is None else look.curves)
    still = None if look is None else replace(look, curves=())
    service = Service(desk.answer, secrets.token_urlsafe(24))
    drawn = scene(desk.film, look)
    over = desk.jog.names[0] if len(desk.jog.names) == 1 else ""  # the abscissa of curves
    abscissa = f"{over} [{desk.dials[over].unit.strip()}]" if over else "movements"
    curves = growing_curves(_now(desk.jog), desk.curves, abscissa)
    parts = parts_of(desk.film, drawn, title, curves, _signals(desk.jog))
    content = {
        "token": service.token,
        "dials": [dial._asdict() for dial in desk.dials.values()],
        "modes": bool(desk.jog.mechanism.closures),
        "limits": bool(joint_limits(desk.jog.mechanism)),
        "keeps": desk.jog.keeps_limits,
        "joints": list(desk.paths),
        "over": over,
    }
    data = json.dumps(content, ensure_ascii=False).replace("<", "\\u003c")
    grid = html.escape(f"ground grid {length_words(drawn.framing.cell)}")
    text = filled("page.html", {
        **parts,
        "NOTES": f"<small>{grid}</small>",
        "CONNECT": "'self'",
        "SCRIPT": packed_script(("live", "drag", "grow")),
        "EXTRA": template("live.html").replace("@LIVE@", data),
    })
    viewer = Viewer(text, port, service, still=lambda: page(state, title, still))
    if open_browser:
        open_in_browser(viewer, "live")
    return viewer


# To let the page ask for something new: a function from a Desk and the question to what its answer
# holds besides poses, values and readings; its line here; and the place in script/live.js that
# asks.
ANSWERS: dict[str, Callable[[Desk, Mapping[str, Any]], Answer]] = {
    "move": Desk.move,
    "ranges": Desk.ranges,
    "home": Desk.home,
    "limits": Desk.limits,
    "mode": mode,
    "drag": drag,
}
