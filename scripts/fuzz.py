"""Judge the library's answers for random mechanisms by independent computations.

    python scripts/fuzz.py 0 2000                    seeds 0 to 1999, all checks
    python scripts/fuzz.py 17 18 --only simulate     one seed, one check and what it needs
    python scripts/fuzz.py --files 1000              damaged mechanism files
    python scripts/fuzz.py 0 2000 --drawn            files of 4 to 12 digits: MJCF, SDFormat, URDF

Needs an x86 machine: the judge works in its extended precision. Exit status 1 if an answer is
wrong, or a call crashes or hangs. `fuzzing/` has the checks.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # small matrices: threads only wait
sys.path.insert(0, str(Path(__file__).parent))

import numpy as np
from fuzzing import drawn_checks
from fuzzing.mutate import Damage
from fuzzing.records import BAD, CHECKS, Sums, judged
from tqdm import tqdm


def main(arguments=None):
    options = _options(arguments)
    with _log(options.out) as log:
        if options.files is not None:
            return _files(options, log)
        if np.finfo(np.longdouble).eps > 1e-18 and not options.drawn:
            sys.exit("the judge needs x86's extended precision; --files, --drawn do without it")
        return _mechanisms(options, log)


def _options(arguments):
    p = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    p.add_argument("first", type=int, nargs="?", default=0, help="first seed")
    p.add_argument("last", type=int, nargs="?", help="the seed after the last one")
    p.add_argument("--only", default="", help=f"checks, of {', '.join(CHECKS)}")
    p.add_argument("--files", type=int, metavar="N", help="N damaged files, from the first seed")
    p.add_argument("--drawn", action="store_true",
                   help="mechanisms with redundant equations as MJCF, SDFormat and URDF of 4 to 12 "
                        "digits that close as drawn, beside the exact ones")
    p.add_argument("--jobs", type=int, default=1, help="processes")
    p.add_argument("--out", type=Path, help="write every check that is not right, as JSON lines")
    options = p.parse_args(arguments)
    options.only = tuple(x for x in options.only.split(",") if x)
    unknown = set(options.only) - set(CHECKS)
    if unknown:
        p.error(f"no check {', '.join(sorted(unknown))}; there are {', '.join(CHECKS)}")
    if options.last is None:
        options.last = options.first + (options.files if options.files is not None else 100)
    return options


def _log(path):
    return open(path or os.devnull, "a", encoding="utf-8")


def _mechanisms(options, log):
    seeds = range(options.first, options.last)
    sums = Sums()
    results = (_each(drawn_checks.judged, seeds, options.jobs) if options.drawn
             else _each(_judged, [(s, options.only) for s in seeds], options.jobs))
    for records in results:
        sums.add(records)
        for r in records:
            if r["end"] not in ("right", "skipped"):
                log.write(json.dumps(r) + "\n")
                log.flush()
    print(sums)
    return int(sums.bad > 0)


def _judged(job):
    return judged(*job)


def _files(options, log):
    ends = {}
    for r in _each(Damage.judged, range(options.first, options.last), options.jobs):
        ends.setdefault(r["end"], []).append(r["seed"])
        if r["end"] in BAD:
            log.write(json.dumps(r) + "\n")
            log.flush()
    for end, seeds in sorted(ends.items()):
        print(f"{end:10} {len(seeds)}" + (f": seeds {seeds[:12]}" if end in BAD else ""))
    return int(any(end in BAD for end in ends))


def _each(function, jobs, processes):
    """The function's results, several processes at a time; a process that dies is an error."""
    bar = tqdm(total=len(jobs), disable=not sys.stderr.isatty())
    if processes == 1:
        for job in jobs:
            yield function(job)
            bar.update()
        return
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        for result in pool.imap(function, jobs, chunksize=4):
            yield result
            bar.update()


if __name__ == "__main__":
    sys.exit(main())
