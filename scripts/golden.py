"""Golden numbers: the answers of every verb for every mechanism, to compare later.

    python scripts/golden.py save old.npz
    python scripts/golden.py save new.npz --only rssr,watt_six_bar --verbs sweep,limits
    python scripts/golden.py compare old.npz new.npz
    python scripts/golden.py compare old.npz --only rssr      # against the present answers

Differences are relative to a quantity's own size over the motion (rates: of the sample), absolute
for angles. They may be 1e-13, or the error that the library itself states of the number: the
`rate_error` of a state, the error of a solution, what an integrator leaves. Of sentences the words
are equal, and numbers to their last digit. Refusals and warnings are answers too. The exit code is
1 where more differs.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # small matrices: threads only get in the way
sys.path.insert(0, str(Path(__file__).parent))

from golden_numbers import answer, comparison, verbs

import spatial_pin as sp

SHOWN = 40  # differences that are printed, one a mechanism and verb


def compute(only: Sequence[str], wanted: Sequence[str], clock: bool = False) -> answer.Golden:
    """Return the answers of verbs, mechanism by mechanism; prints which library gives them."""
    golden: answer.Golden = {}
    print(f"answers of {Path(sp.__file__).parent}", file=sys.stderr, flush=True)
    for name in only:
        start = time.process_time()
        golden |= {(name, verb): verbs.ask(name, verb) for verb in wanted}
        if clock:
            print(f"{name}: {time.process_time() - start:.1f} s", file=sys.stderr, flush=True)
    return golden


def report(old: answer.Golden, new: answer.Golden, tolerance: float, shown: int) -> Iterator[str]:
    """Yield lines: the largest difference of every mechanism and verb, and how many are equal."""
    differences = comparison.compare(old, new, tolerance)
    beyond = [d for d in differences if d.is_beyond]
    largest: dict[tuple[str, str], comparison.Difference] = {}
    for difference in differences:
        largest.setdefault((difference.mechanism, difference.verb), difference)
    if len(largest) > shown:
        yield f"the {shown} largest of {len(largest)}:"
    for difference in list(largest.values())[:shown]:
        yield f"{'BEYOND ' if difference.is_beyond else 'within '}{difference}"
    both = old.keys() & new.keys()
    n = sum(len(old[key]) for key in both)
    same, near = n - len(differences), len(differences) - len(beyond)
    yield (f"{len(both)} answers of both, {n} quantities: {same} equal to the bit or the word, "
           f"{near} within what is allowed, {len(beyond)} beyond it")
    for where, places in (("old", old.keys() - both), ("new", new.keys() - both)):
        if places:
            yield f"only in the {where} one, not compared: {len(places)} answers"


def parse(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """Return the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    pair = argparse.ArgumentParser(add_help=False)
    pair.add_argument("--only", metavar="M,...", help="mechanisms (all of the library)")
    pair.add_argument("--verbs", metavar="V,...", help=f"of {', '.join(verbs.VERBS)} (all)")
    commands = parser.add_subparsers(dest="command", required=True)
    save = commands.add_parser("save", parents=[pair], help="compute them and write a file")
    save.add_argument("file", type=Path)
    compare = commands.add_parser("compare", parents=[pair], help="compare two files")
    compare.add_argument("old", type=Path)
    compare.add_argument("new", type=Path, nargs="?", help="default: the present answers")
    compare.add_argument("--tolerance", type=float, default=1e-13, help="(1e-13)")
    compare.add_argument("--shown", type=int, default=SHOWN, help=f"lines ({SHOWN})")
    options = parser.parse_args(arguments)
    options.only = _chosen(parser, options.only, sp.list_mechanisms(), "mechanism")
    options.verbs = _chosen(parser, options.verbs, list(verbs.VERBS), "verb")
    return options


def _chosen(
    parser: argparse.ArgumentParser, given: str | None, there: list[str], what: str
) -> list[str]:
    names = given.split(",") if given else there
    for name in names:
        if name not in there:
            parser.error(f"no {what} {name!r}; there are {', '.join(there)}")
    return names


def read(path: Path, options: argparse.Namespace) -> answer.Golden:
    """Return the selected answers of a file."""
    return {(name, verb): golden for (name, verb), golden in answer.read(path).items()
            if name in options.only and verb in options.verbs}


def main(arguments: Sequence[str] | None = None) -> int:
    """Compute, save, compare; return the exit code."""
    options = parse(arguments)
    if options.command == "save":
        answer.write(options.file, compute(options.only, options.verbs, clock=True))
        return 0
    old = read(options.old, options)
    new = read(options.new, options) if options.new else compute(options.only, options.verbs)
    if not old.keys() & new.keys():
        print("nothing to compare: the files have no answer in common", file=sys.stderr)
        return 1
    for line in report(old, new, options.tolerance, options.shown):
        print(line)
    return int(any(d.is_beyond for d in comparison.compare(old, new, options.tolerance)))


if __name__ == "__main__":
    sys.exit(main())
