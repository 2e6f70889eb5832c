"""How each check of a random mechanism ends, and the sums over many.

right     the library's answer agrees with ours
refused   a SpatialPinError; "doubtful" where we found an answer, and the refusal may be false
wrong     an answer that does not agree, or a warning of NumPy
crashed   any other exception
hung      longer than a call may take
skipped   the check has nothing to say about this mechanism
"""

from __future__ import annotations

import collections
import signal
import tempfile
import time
import traceback
import warnings
from pathlib import Path

import spatial_pin as sp
from fuzzing import force_checks, kinematic_checks
from fuzzing.case import Case, Skip, Wrong
from fuzzing.generate import make

CHECKS = kinematic_checks.CHECKS | force_checks.CHECKS
LONGEST = 60  # a check, with our own computations [s of the processor]
BAD = ("wrong", "crashed", "hung")
GOES_ON = ("right", "skipped")


class Hung(BaseException):
    """The time of a check is over; not an Exception, so that nobody catches it."""


def judged(seed, only=()):
    """The records of one seed: dictionaries with check, end, text, doubtful, seconds."""
    ends, records = {}, []
    wanted = _with_needs(only or CHECKS)
    with tempfile.TemporaryDirectory() as folder:
        case = Case(make(seed), Path(folder))
        for name, (check, needs) in CHECKS.items():
            if name in wanted and all(ends.get(n) in GOES_ON for n in needs):
                record = {"seed": seed, "check": name, **_ended(case, check)}
                ends[name] = record["end"]
                records.append(record)
    return records


def _with_needs(names):
    wanted = set(names)
    for name in reversed(CHECKS):
        if name in wanted:
            wanted |= set(CHECKS[name][1])
    return wanted


def _ended(case, check):
    case.doubtful, began = False, time.perf_counter()
    signal.signal(signal.SIGPROF, _too_long)
    signal.setitimer(signal.ITIMER_PROF, LONGEST)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            warnings.simplefilter("ignore", sp.SpatialPinWarning)
            check(case)
        record = {"end": "right", "text": ""}
    except Skip as why:
        record = {"end": "skipped", "text": str(why)}
    except (Wrong, Warning) as why:
        record = {"end": "wrong", "text": str(why)}
    except Hung as why:
        record = {"end": "hung", "text": _where(why)}
    except sp.SpatialPinError as error:
        record = {"end": "refused", "text": f"{type(error).__name__}: {error}"}
    except Exception as error:
        record = {"end": "crashed", "text": f"{type(error).__name__}: {error} at {_where(error)}"}
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
    return record | {"doubtful": record["end"] == "refused" and bool(case.doubtful),
                     "seconds": round(time.perf_counter() - began, 3)}


def _too_long(*_):
    raise Hung


def _where(error):
    """The innermost lines of the library that an exception came through."""
    frames = [f for f in traceback.extract_tb(error.__traceback__) if "spatial_pin" in f.filename]
    return " < ".join(f"{Path(f.filename).name}:{f.lineno}" for f in frames[:-4:-1]) or "our own"


class Sums:
    """Counts of how each check ended, with the seeds of the bad ones."""

    def __init__(self):
        self.seeds = collections.defaultdict(lambda: collections.defaultdict(list))

    def add(self, records):
        """Count the records of a mechanism."""
        for r in records:
            end = "refused?" if r["doubtful"] else r["end"]
            self.seeds[r["check"]][end].append(r["seed"])

    def count(self, *ends):
        """How many checks ended in one of these ways."""
        return sum(len(seeds_of.get(end, ())) for seeds_of in self.seeds.values() for end in ends)

    @property
    def bad(self):
        """How many ended wrong, crashed or hung."""
        return self.count(*BAD)

    def __str__(self):
        lines = []
        for check, records in self.seeds.items():
            lines.append(f"{check:12} " + ", ".join(f"{len(s)} {end}" for end, s in sorted(
                records.items(), key=lambda x: -len(x[1]))))
            lines += [f"{'':12} {end}: seeds {', '.join(map(str, s[:12]))}"
                      + (" ..." if len(s) > 12 else "")
                      for end, s in records.items() if end in (*BAD, "refused?")]
        lines.append(f"wrong, crashed or hung: {self.bad}; refused though we found an answer: "
                     f"{self.count('refused?')} of {self.count('refused', 'refused?')} refusals")
        return "\n".join(lines)
