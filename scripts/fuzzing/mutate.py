"""Damaged mechanism files: whatever is done to them, they load or are refused in words.

same     the damage changed nothing that matters
other    another possible mechanism, whose loops then close, or are refused in words
error    a SpatialPinError
wrong    it loads, but holds numbers that are none, or stays open
crashed  any other exception
hung     longer than a call may take
"""

from __future__ import annotations

import functools
import random
import re
import signal
import tempfile
import traceback
import warnings
from pathlib import Path

import numpy as np
import pinocchio as pin

import spatial_pin as sp

LONGEST = 10  # load and assemble [s of the processor]
NUMBER = re.compile(r"(?<![\w.])-?\d+\.?\d*(?:[eE][-+]?\d+)?")
QUOTED = re.compile(r'"([^"\n]*)"')
NUMBERS = ("0", "-1", "1e308", "-1e308", "1e-308", "5e-324", "1e400", "nan", "inf", "-inf", "1e20",
           "1e-20", "-0.0", "0x10", "1_000", "1,5", "", "true", "9" * 400, "1e", "--1", "1.5.2",
           "1e16", "1e-9", "null", "0 0", "2", "9**9**9", "[1] * 10**9")
WORDS = ("", "ground", "x" * 5000, "\u202e", "é", "a b", "a.b", "../../x", "/etc/passwd",
         "universe", "root_joint", "\\n", "__class__", "%s", "{0}", "${1/0}", "${9**9**9}",
         "${(lambda: 0)()}", "$(arg nope)", "$(env PATH)", "$(find nope)", "A" * 300, "-", ".",
         "revolute", "floating", "weld", "<", "&", "\x7f", "NaN", "$")
VALUES = ("[]", "{}", "true", '""', "1", "1.5", '["a", "b"]', "[1, 2, 3]", "1979-05-27", "[[1]]",
          "{a=1}", "'x'", "[1e400, 0, 0]", "-1", "a" + ".a" * 500 + "=1")
STRAY = "<>\"'&=[]{}#\n\t\0\x01.,-e9$\u00a0"


class Hung(BaseException):
    """The time is over."""


class Damage:
    """One file of a library mechanism, damaged by one seed.

    Args:
        seed: of everything that is random.
        folder: where the files are written.
    """

    def __init__(self, seed, folder):
        self.rng, self.folder = random.Random(seed), folder
        self.name = self.rng.choice(sp.list_mechanisms())
        self.write_files()
        path = folder / self.rng.choice(sorted(x.name for x in folder.iterdir()))
        self.is_toml = path.suffix == ".toml"
        text = path.read_text()
        for _ in range(self.rng.choice([1, 1, 1, 2, 3])):
            text = self.rng.choice(self.WAYS)(self, text) or "\n"
        path.write_bytes(self.bytes_of(text))

    def write_files(self):
        """Copy the mechanism's files, the tree as it is or expanded."""
        library = Path(sp.__file__).parent / "urdf"
        library = library if library.is_dir() else library.parent.parent / "urdf"
        toml = (library / f"{self.name}.toml").read_text()
        if self.rng.random() < 0.4:
            (self.folder / f"{self.name}.urdf").write_text(_whole(self.name).urdf)
            toml = toml.replace(".urdf.xacro", ".urdf")
        else:
            for file in ("parts.xacro", f"{self.name}.urdf.xacro"):
                (self.folder / file).write_text((library / file).read_text())
        (self.folder / f"{self.name}.toml").write_text(toml)

    # ------------------------------------------------------------ ways of damage

    def a_line(self, text):
        """Delete, repeat, move or join lines."""
        lines = text.split("\n")
        i, k = (self.rng.randrange(len(lines)) for _ in range(2))
        how = self.rng.randrange(4)
        if how == 0:
            del lines[i]
        elif how == 1:
            lines[k:k] = lines[min(i, k) : max(i, k) + 1]
        elif how == 2:
            lines[i], lines[k] = lines[k], lines[i]
        else:
            lines[i : i + 2] = [" ".join(lines[i : i + 2])]
        return "\n".join(lines)

    def a_number(self, text):
        """Write something else for a number."""
        return self.replaced(text, NUMBER, 0, NUMBERS)

    def a_word(self, text):
        """Write something else between quotes."""
        return self.replaced(text, QUOTED, 1, WORDS + NUMBERS)

    def a_value(self, text):
        """Give a key a value of another kind."""
        pattern = re.compile(r"= *([^\n=]+)$", re.M) if self.is_toml else QUOTED
        return self.replaced(text, pattern, 1, VALUES)

    def a_name(self, text):
        """Call something by the name of something else."""
        words = sorted(set(re.findall(r"[A-Za-z_]{3,}", text))) or ["x"]
        old, new = self.rng.choice(words), self.rng.choice(words)
        return re.sub(rf"\b{old}\b", new, text, count=self.rng.randint(1, 2))

    def an_attribute(self, text):
        """Leave out an attribute."""
        return self.replaced(text, re.compile(r' \w+="[^"\n]*"'), 0, ("",))

    def a_character(self, text):
        """Drop a character, or add one that means something."""
        k = self.rng.randrange(len(text))
        if self.rng.random() < 0.5:
            return text[:k] + text[k + 1 :]
        return text[:k] + self.rng.choice(STRAY) + text[k:]

    def two_tokens(self, text):
        """Exchange two words or signs."""
        tokens = re.findall(r"\w+|\W", text)
        a, b = (self.rng.randrange(len(tokens)) for _ in range(2))
        tokens[a], tokens[b] = tokens[b], tokens[a]
        return "".join(tokens)

    def the_end(self, text):
        """Cut off the end."""
        return text[: self.rng.randrange(len(text))]

    def some_depth(self, text):
        """Put an element, or a list, into itself very often."""
        k, depth = self.rng.randrange(len(text)), self.rng.choice([50, 3000])
        both = ("[" * depth, "]" * depth) if self.is_toml else ("<link>" * depth, "</link>" * depth)
        return text[:k] + both[0] + both[1] + text[k:]

    def replaced(self, text, pattern, group, by):
        """Write one of `by` for one match of a pattern."""
        matches = list(pattern.finditer(text))
        if not matches:
            return text
        m = self.rng.choice(matches)
        return text[: m.start(group)] + self.rng.choice(by) + text[m.end(group) :]

    def bytes_of(self, text):
        """The file's bytes; in some files a few of them are others."""
        data = bytearray(text.encode("utf-8", "surrogatepass"))
        if self.rng.random() < 0.06:
            for _ in range(self.rng.randint(1, 4)):
                data[self.rng.randrange(len(data))] = self.rng.randrange(256)
        return bytes(data)

    WAYS = (a_line, a_number, a_number, a_number, a_word, a_word, a_value, a_name, an_attribute,
            a_character, two_tokens, the_end, some_depth)

    # ------------------------------------------------------------ what comes of it

    @staticmethod
    def judged(seed):
        """The record of one seed: a dictionary with seed, name, end, text."""
        with tempfile.TemporaryDirectory() as folder:
            damage = Damage(seed, Path(folder))
            return {"seed": seed, "name": damage.name} | damage.ended()

    def ended(self):
        """What loading and assembling do, within a time."""
        signal.signal(signal.SIGPROF, _too_long)
        signal.setitimer(signal.ITIMER_PROF, LONGEST)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error", RuntimeWarning)
                return self.loaded()
        except Hung as error:
            return {"end": "hung", "text": _where(error)}
        except sp.SpatialPinError as error:
            return {"end": "error", "text": str(error)[:300]}
        except Exception as error:
            return {"end": "crashed", "text": f"{type(error).__name__}: {error}"[:300]
                    + f" at {_where(error)}"}
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)

    def loaded(self):
        """Load the mechanism; where it is another one, close it and let it move."""
        m = sp.load(str(self.folder / f"{self.name}.toml"))
        if not _is_finite(m):
            return {"end": "wrong", "text": "numbers of the model are not finite"}
        if _described(m) == _described(_whole(self.name)):
            return {"end": "same", "text": ""}
        try:
            state = sp.assemble(m)
            if not state.closure_error < 1e-9:
                return {"end": "wrong", "text": f"assembled, open by {state.closure_error}"}
            sp.forward_dynamics(m, sp.solve_rates(m, state, dict.fromkeys(m.drivers, 1.0)))
        except sp.SpatialPinError:
            pass  # another mechanism may have no configuration, or no motion
        return {"end": "other", "text": ""}


@functools.cache
def _whole(name):
    return sp.load(name)


def _too_long(*_):
    raise Hung


def _where(error):
    frames = [f for f in traceback.extract_tb(error.__traceback__) if "spatial_pin" in f.filename]
    return " < ".join(f"{Path(f.filename).name}:{f.lineno}" for f in frames[:-4:-1])


def _is_finite(m):
    model = m.model
    numbers = [model.gravity.vector, *(f.placement.homogeneous for f in model.frames),
               *(p.homogeneous for p in model.jointPlacements)]
    for i in model.inertias:
        numbers += [[i.mass], i.lever, i.inertia]
    return all(np.isfinite(x).all() for x in numbers)


def _described(m):
    """Everything that matters of a mechanism, as text."""
    data = m.model.createData()
    pin.framesForwardKinematics(m.model, data, pin.neutral(m.model))
    places = np.round([f.homogeneous for f in data.oMf], 12) + 0.0
    return repr([list(m.coordinates), [repr(c) for c in m.closures], [repr(s) for s in m.springs],
                 {k: (d.joint, repr(d)) for k, d in m.drivers.items()}, repr(m.guess),
                 [str(i) for i in m.model.inertias], [f.name for f in m.model.frames],
                 places.tolist(), m.model.gravity.vector.tolist(),
                 m.model.lowerPositionLimit.tolist(), m.model.upperPositionLimit.tolist()])
