"""Mechanisms drawn with a few digits answer as the exact ones, or are refused for that reason.

The exact mechanism is the drawing in full digits. How far an answer may be off follows from it: a
few exact mechanisms whose dimensions differ a little show how much the answer depends on
dimensions, and a file is allowed so many times the last digit of its numbers. Where that is too
much to compare, or the exact mechanism is near a singular configuration, nothing is said.
"""

from __future__ import annotations

import re
import signal
import tempfile
import time
import traceback
import warnings
from pathlib import Path

import numpy as np

import spatial_pin as sp
from fuzzing.case import Skip, Wrong, need
from fuzzing.drawing import HINGE, SLIDE, draw, welded, with_ball
from fuzzing.drawn_files import EXACT, FORMATS, Writer
from fuzzing.records import Hung

DIGITS = range(4, 13)
SHAKE = 1e-6  # of dimensions, by their units: differences of answers are good to six digits
SHAKES = 2
ATTEMPTS = 8  # drawings of a seed
WIDENED = 5  # gaps in a row that refusals may name, as each looks a little ahead only
ROUNDED = 100.0  # times the last digit of a number, that all numbers together do, or a gap is
FLOOR = 1e-8  # of an answer: what time steps and closing do
VAGUE = 0.2  # part of an answer, above which a comparison is meaningless
SINGULAR = 100.0  # condition of loops and drivers, above which a mechanism is near-singular
SAMPLES, REACH = 51, 0.5  # of a sweep [rad]: none steps over a singular configuration unseen
SLIDES = 0.3  # the reach of a slide, in units
LONGEST = 120  # a mechanism [s of the processor]
NAMED = re.compile(r"gap=(\d[^), ]*)")


def judged(seed):
    """The records of one seed: dictionaries with seed, check, end, text, doubtful, seconds."""
    return Drawn(seed).records()


class Drawn:
    """One drawing, its exact answers, and one file of it in a few digits.

    Attributes:
        kind, digits: of the file.
        drawing: the mechanism.
        cut: how its first loop is closed in the file: hinge, ball or weld.
    """

    def __init__(self, seed, kind=None, digits=None):
        self.seed, self.rng = seed, np.random.default_rng([9, seed])
        self.kind = str(self.rng.choice(list(FORMATS)))
        self.digits = int(self.rng.choice(DIGITS))
        self.kind, self.digits = kind or self.kind, digits or self.digits
        self.drawing = self.changed = draw(seed)
        self.cut = "hinge"

    @property
    def name(self):
        """What the file is."""
        return f"{self.drawing.family}, {self.kind}, {self.cut}, {self.digits} digits"

    # ------------------------------------------------------------ what comes of it

    def records(self):
        """One record for every answer, or one for all where none was compared."""
        began, made = time.perf_counter(), []
        signal.signal(signal.SIGPROF, _too_long)
        signal.setitimer(signal.ITIMER_PROF, LONGEST)
        try:
            with warnings.catch_warnings(), tempfile.TemporaryDirectory() as folder:
                warnings.simplefilter("error")
                warnings.simplefilter("ignore", sp.SpatialPinWarning)
                self.folder = Path(folder)
                made = self.compared()
        except Skip as why:
            made = [("exact", "skipped", str(why))]
        except Wrong as why:
            made = [("load", "wrong", str(why))]
        except Hung:
            made = [("load", "hung", "")]
        except Exception as error:
            at = traceback.extract_tb(error.__traceback__)[-1]
            made = [("load", "crashed", f"{type(error).__name__}: {error} at "
                                         f"{Path(at.filename).name}:{at.lineno}")]
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
        seconds = round(time.perf_counter() - began, 3)
        return [{"seed": self.seed, "check": check, "end": end, "name": self.name,
                 "text": text, "doubtful": False, "seconds": seconds}
                for check, end, text in made]

    def compared(self):
        """(answer, end, text) of every answer of the file, at the gap that its refusal names."""
        exact, others = self.reference()
        self.close()
        path = Writer(self.changed, self.digits, self.rng).write(self.folder, "drawn", self.kind)
        answers, gap, ends = Answers(sp.load(path), self.drawing, exact.sense), None, []
        for _ in range(WIDENED):
            wider = answers.gap_named()
            if wider is None or not (gap or 0.0) < wider <= ROUNDED * 10.0**-self.digits:
                break
            gap = wider
            ends.append((f"gap {len(ends) + 1}", "refused", f"gap={gap}"))
            answers = Answers(sp.load(path, gap=gap), self.drawing, exact.sense)
        remark = f"with gap={gap}: " if gap else ""
        return ends + [(x, end, remark + text) for x, end, text in self.against(
            answers, exact, others)]

    def reference(self):
        """The exact answers, and those of mechanisms that are a little different."""
        for attempt in range(ATTEMPTS):
            self.drawing = draw(self.seed, attempt)
            exact = self.exactly(self.drawing)
            if "sweep" in exact.refused and "LimitError" in exact.refused["sweep"]:
                continue
            need(not exact.refused, f"exact: {'; '.join(exact.refused.values())}")
            need(exact.values["dof"] == self.drawing.dof,
                 f"exact: {exact.values['dof']} freedoms, not {self.drawing.dof}")
            if exact.condition() > SINGULAR:
                continue
            others = [self.exactly(draw(self.seed, attempt, SHAKE, k), exact.sense)
                      for k in range(SHAKES)]
            if not any(x.refused for x in others):
                return exact, others
        raise Skip("no drawing away from limits and singular configurations")

    def exactly(self, drawing, sense=None):
        """The answers of a drawing in full digits."""
        path = Writer(drawing, EXACT, self.rng).write(self.folder, "exact", "urdf")
        return Answers(sp.load(path), drawing, sense)

    def close(self):
        """Choose how the file closes a loop: by its hinge, a ball, or a weld within a link."""
        senses = {"hinge": lambda d, _: d, "weld": welded}
        if self.drawing.balls:
            senses["ball"] = with_ball
        self.cut = str(self.rng.choice(list(senses)))
        which = int(self.rng.integers(0, len(self.drawing.loops)))
        self.changed = senses[self.cut](self.drawing, which)

    def against(self, answers, exact, others):
        """(answer, end, text) of the answers of a file that were not refused for its digits."""
        rounding = 10.0**-self.digits
        for name, text in answers.refused.items():
            yield name, "wrong", f"refused: {text}"
        if "dof" in answers.values:
            dof = answers.values["dof"]
            right = dof == self.drawing.dof
            yield ("dof", "right" if right else "wrong",
                   "" if right else f"{dof} freedoms, not {self.drawing.dof}")
        for name in set(answers.values) - {"dof"}:
            common = sorted(set(answers.values[name]) & set(exact.values[name]))
            mine, wanted, *near = (np.concatenate([x.values[name][k] for k in common])
                                   for x in (answers, exact, *others))
            size = np.abs(wanted).max(initial=0.0)
            depends = max(np.abs(x - wanted).max(initial=0.0) for x in near) / SHAKE + size
            most = ROUNDED * rounding * depends + FLOOR * size
            if most > VAGUE * size:
                yield name, "skipped", "depends on dimensions too much"
                continue
            off = np.abs(mine - wanted).max(initial=0.0)
            times = off / (rounding * depends)
            yield (name, "right" if off <= most else "wrong",
                   f"{off:.1e} of {size:.1e}, {times:.3g} times the last digit")


class Answers:
    """Answers of the library for one file: values by name, refusals in its words.

    Args:
        mechanism: the loaded one.
        drawing: what it was drawn from.
        way: the sign of the sweep; None: the first that the mechanism can go.
    """

    def __init__(self, mechanism, drawing, sense=None):
        self.mechanism, self.drawing, self.sense = mechanism, drawing, sense
        self.values, self.refused, self.report = {}, {}, ""
        try:
            self.state = sp.assemble(mechanism)
            result = sp.mobility(mechanism, self.state)
        except sp.SpatialPinError as error:
            self.refused["assemble"] = _reason(error)
            return
        self.values["dof"], self.report = result.dof, str(result)
        for name in ("home", "jacobian", "accelerations", "efforts", "sweep", "simulate"):
            try:
                self.values[name] = getattr(self, name)()
            except sp.SpatialPinError as error:
                self.refused[name] = _reason(error)

    def gap_named(self):
        """The gap that a refusal, or the mobility, names; None if none does."""
        for text in (*self.refused.values(), self.report):
            if self.refused or self.values.get("dof") != self.drawing.dof:
                named = NAMED.search(text)
                if named:
                    return float(named[1])
        return None

    @property
    def linear(self):
        """Joints of the drawing, of one coordinate each, that the mechanism has; their units."""
        has = set(self.mechanism.coordinates)
        return {j.name: self.drawing.size if j.kind == SLIDE else 1.0
                for j in self.drawing.joints if j.kind in (HINGE, SLIDE) and j.name in has}

    def places(self, state):
        """Places by the unit of length, and rotations, of all links."""
        points = {}
        for link in self.drawing.links:
            at = state.placement(link)
            points[link] = np.concatenate([at.translation / self.drawing.size,
                                          at.rotation.ravel()])
        return points

    # ------------------------------------------------------------ answers

    def home(self):
        """Places of links where they are drawn."""
        return self.places(self.state)

    def jacobian(self):
        """Of all links, for all drivers."""
        d, columns = self.drawing, {}
        by = np.array([d.size] * 3 + [1.0] * 3)[:, None]
        units = np.array([self.linear.get(x, 1.0) for x in d.drivers])
        for link in d.links:
            columns[link] = (sp.jacobian(self.mechanism, self.state, link) / by * units).ravel()
        return columns

    def accelerations(self):
        """Of joints, under weight alone and at rest."""
        a = sp.forward_dynamics(self.mechanism, self.state).a
        return {n: np.array([a[self.mechanism.coordinate(n).v] / unit])
                for n, unit in self.linear.items()}

    def efforts(self):
        """Of the drivers, in motion."""
        d, rates = self.drawing, {}
        for k, name in enumerate(d.drivers):
            rates[name] = (1.0 + 0.3 * k) * self.linear.get(name, 1.0)
        moving = sp.solve_rates(self.mechanism, self.state, rates)
        efforts = sp.inverse_dynamics(self.mechanism, moving).efforts
        return {n: np.array([efforts[n] * self.linear.get(n, 1.0)]) / d.size**2 for n in d.drivers}

    def sweep(self):
        """Places and velocities of links half a radian away."""
        d, driver = self.drawing, self.drawing.drivers[0]
        unit = self.linear.get(driver, 1.0)
        kind = next(j.kind for j in d.joints if j.name == driver)
        reach = REACH if kind == HINGE else SLIDES * d.size
        senses = (1.0, -1.0) if self.sense is None else (self.sense,)
        for sense in senses:
            try:
                motion = sp.sweep(self.mechanism, driver, sense * np.linspace(0.0, reach, SAMPLES),
                                  speed=unit)
            except sp.SpatialPinError:
                if sense == senses[-1]:
                    raise
                continue
            self.sense, self.moved = sense, motion
            end, result = motion.state(-1), {}
            for link, point in self.places(end).items():
                v = end.velocity(link)
                result[link] = np.concatenate([point, v.linear / d.size, v.angular])
            return result
        return None

    def simulate(self):
        """Places of links after falling for a tenth of a second."""
        motion = sp.simulate(self.mechanism, self.state, 0.1, times=np.linspace(0.0, 0.1, 3))
        if motion.time[-1] < 0.1:
            raise sp.SpatialPinError("; ".join(e.text for e in motion.events))
        return self.places(motion.state(-1))

    def condition(self):
        """Worst condition of loops and drivers together, at home and along the sweep."""
        m, worst = self.mechanism, 0.0
        rank = len(m.coordinates) - self.drawing.dof
        rows = np.zeros((self.drawing.dof, m.model.nv))
        for k, name in enumerate(self.drawing.drivers):
            rows[k, m.coordinate(name).v] = 1.0
        for q in (self.state.q, *self.moved.q):
            loops = sp.closure_jacobian(m, q) * m.velocity_scale
            s = np.linalg.svd(loops, compute_uv=False)
            both = np.linalg.svd(np.vstack([loops, rows]), compute_uv=False)
            worst = max(worst, s[0] / s[rank - 1], both[0] / both[m.model.nv - 1])
        return worst


def _reason(error):
    return f"{type(error).__name__}: {error}"


def _too_long(*_):
    raise Hung
