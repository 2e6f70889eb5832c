"""Measure the power of the tests: seed faults, one at a time, and see which test catches each.

    python scripts/mutants.py --jobs 2                     all faults of mutations.toml
    python scripts/mutants.py --only lie-bracket --whole   one, by the whole suite if need be
    python scripts/mutants.py --room kernel --list         what there is

A fault is made in a copy of the tree, the kernel compiled there if it is in a C file. The test
modules named with it run first, up to the first failure: the fast tests, then those of the
selection that judges. Tests that hang have caught it too. A module that is red without any fault
proves nothing: each that has caught something runs without faults as well, once.

Results are kept in a file, by the fault, the code it is in and the state of the tests: what is
known is not run again. Exit status 1 if a fault survives or cannot be judged, 2 if the list of
faults does not fit the code.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import astuple, dataclass
from pathlib import Path

SELECTION = ""  # arguments for pytest: the tests that judge are those that run by default
LONGEST = 300.0  # s that the tests named with a fault may take: at least twice what they need
LONGEST_WHOLE = 3600.0  # s, of the whole suite
ROOT = Path(__file__).resolve().parent.parent
LEFT_OUT = shutil.ignore_patterns(".git", ".venv*", "__pycache__", ".*_cache", ".hypothesis",
                                  "*.egg-info", "build", "dist", "_build", "demo_output", "*.jsonl")


@dataclass(frozen=True)
class Mutation:
    """A fault: see mutations.toml."""

    name: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]

    @property
    def room(self) -> str:
        """The folder of the package that it is in; "files" of a file in none."""
        inside = Path(self.file).parts[1:]
        return inside[0] if len(inside) > 1 else "files"


def read(path: Path = ROOT / "scripts" / "mutations.toml") -> list[Mutation]:
    """Return the faults of a list."""
    rows = tomllib.loads(path.read_text("utf-8"))["mutation"]
    return [Mutation(**{**row, "tests": tuple(row["tests"])}) for row in rows]


def misfits(mutations: list[Mutation], root: Path = ROOT) -> list[str]:
    """Return the mistakes in a list of faults, in words."""
    names, wrong = [m.name for m in mutations], []
    for m in mutations:
        path = root / m.file
        count = path.read_text("utf-8").count(m.old) if path.is_file() else 0
        if count != 1 or m.old == m.new or names.count(m.name) > 1:
            wrong.append(f"{m.name}: its old text must stand once in {m.file}, and stands {count} "
                         f"times; it must differ from the new one, and names from each other")
    return wrong


def modules_of(root: Path, stems: tuple[str, ...]) -> list[str]:
    """Return the files of test modules, wherever they lie; of missing ones none."""
    there = {path.stem: str(path.relative_to(root)) for path in (root / "tests").rglob("test_*.py")}
    return [there[stem] for stem in stems if stem in there]


def failed(text: str) -> str:
    """Return the first test that failed, from what pytest prints, else its last words."""
    match = re.search(r"^(?:FAILED|ERROR) (\S+?\.py(?:::[^\s\[]+)?)", text, re.MULTILINE)
    return match[1] if match else (text.strip().splitlines() or ["nothing"])[-1][:200]


class Judge:
    """Runs tests on copies of a tree.

    Args:
        root: the tree.
        folder: where copies may lie.
        selection: arguments for pytest that say which tests judge.
        longest: time that the tests named with a fault may take [s].
        whole: whether the whole suite judges what these let pass.
    """

    def __init__(
        self, root: Path, folder: Path, selection: list[str], longest: float = LONGEST,
        whole: bool = False,
    ) -> None:
        self._pristine, self._folder, self._whole = folder / "pristine", folder, whole
        self._longest = longest
        self._rounds = [[], selection] if selection else [[]]
        self._running: set[subprocess.Popen[str]] = set()
        self._is_stopped = False
        self._without_fault: dict[tuple[str, ...], tuple[str, float]] = {}
        shutil.copytree(root, self._pristine, symlinks=True, ignore=LEFT_OUT)

    def stop(self) -> None:
        """End the running commands, and run nothing more."""
        self._is_stopped = True
        for process in list(self._running):
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)

    def _run(self, root: Path, words: list[str], longest: float) -> tuple[int | None, str]:
        """Run Python in a tree; return its exit status, None if it took too long, and its words."""
        if self._is_stopped:
            raise KeyboardInterrupt
        env = {**os.environ, "PYTHONPATH": str(root), "OPENBLAS_NUM_THREADS": "1"}
        process = subprocess.Popen(
            [sys.executable, *words], cwd=root, env=env, text=True, errors="replace",
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True)
        self._running.add(process)
        try:
            text = process.communicate(timeout=longest)[0]
            return process.returncode, text
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            return None, process.communicate()[0]
        finally:
            self._running.discard(process)

    def _test(self, root: Path, words: list[str], longest: float) -> tuple[int | None, str]:
        return self._run(root, ["-m", "pytest", "-x", "-q", "-p", "no:cacheprovider",
                                f"--basetemp={root}-tmp", *words], longest)

    @contextlib.contextmanager
    def _copy(self):
        """Give a copy of the tree as it was."""
        with tempfile.TemporaryDirectory(dir=self._folder, ignore_cleanup_errors=True) as folder:
            root = Path(folder) / "tree"
            shutil.copytree(self._pristine, root, symlinks=True)
            yield root

    def _proves_nothing(self, modules: list[str], options: list[str], longest: float | None) -> str:
        """Return why modules prove nothing by failing, or by taking `longest`; else nothing."""
        total = 0.0
        for module in modules:
            key = (module, *options)
            if key not in self._without_fault:
                with self._copy() as root:
                    start = time.monotonic()
                    code, text = self._test(root, [*options, module], self._longest)
                    why = "" if code == 0 else failed(text) if code else "it takes too long"
                    self._without_fault[key] = why, time.monotonic() - start
            why, seconds = self._without_fault[key]
            if why:
                return f"{module} is red without any fault: {why}"
            total += seconds
        return "they take too long without any fault" if longest and total > longest / 2.0 else ""

    def judged(self, mutation: Mutation) -> dict[str, object]:
        """Return what becomes of a fault: its end, by which test, and how long it took [s]."""
        start = time.monotonic()
        with self._copy() as root:
            end, by = self._seeded(mutation, root)
        return {"name": mutation.name, "room": mutation.room, "end": end, "by": by,
                "seconds": round(time.monotonic() - start, 1)}

    def _seeded(self, m: Mutation, root: Path) -> tuple[str, str]:
        modules, path = modules_of(root, m.tests), root / m.file
        if not modules:
            return "error", "none of its test modules exists"
        path.write_text(path.read_text("utf-8").replace(m.old, m.new), "utf-8")
        if path.suffix in (".c", ".h"):
            code, text = self._run(root, ["scripts/build_kernel.py"], self._longest)
            if code != 0:
                return "error", f"it does not compile: {failed(text)}"
        rounds = [(options, modules, self._longest) for options in self._rounds]
        if self._whole:
            own = modules_of(root, ("test_mutants",))  # which sees that the old text is gone
            rounds.append((self._rounds[-1], [f"--ignore={x}" for x in own], LONGEST_WHOLE))
        for options, words, longest in rounds:
            code, text = self._test(root, [*options, *words], longest)
            if code in (0, 5):  # all passed, or none was selected
                continue
            by = failed(text) if code else "timed out"
            blamed = re.findall(r"^[^:\s]+\.py", by) or modules
            why = self._proves_nothing(blamed, options, longest if code is None else None)
            return ("error", why) if why else ("caught", by)
        return "survived", ""


def state_of_tests(root: Path) -> str:
    """Return a hash of the tests and of how they are configured."""
    digest = hashlib.sha256((root / "pyproject.toml").read_bytes())
    for path in sorted((root / "tests").rglob("*")):
        if path.is_file() and "__pycache__" not in path.parts:
            digest.update(str(path.relative_to(root)).encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def table(rows: list[dict[str, object]]) -> str:
    """Return results as a table, and their sums."""
    lines = [f"{row['name']:28}  {row['room']:18}  {row['seconds']:6.1f} s  {row['end']}"
             f"{': ' * bool(row['by'])}{row['by']}" for row in rows]
    ends = [row["end"] for row in rows]
    return "\n".join([*lines, f"{len(rows)} faults: " + ", ".join(
        f"{ends.count(end)} {end}" for end in ("caught", "survived", "error"))])


def _options(arguments: list[str] | None) -> argparse.Namespace:
    p = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    p.add_argument("--only", default="", metavar="NAME,...", help="faults of these names")
    p.add_argument("--room", default="", help="faults in one folder of the package")
    p.add_argument("--list", action="store_true", help="only list the faults")
    p.add_argument("--jobs", type=int, default=1, help="how many run side by side")
    p.add_argument("--longest", type=float, default=LONGEST, metavar="SECONDS",
                   help=f"from when on the tests of a fault count as hanging ({LONGEST:g})")
    p.add_argument("--whole", action="store_true", help="run the whole suite on survivors")
    p.add_argument("--selection", default=SELECTION, metavar="WORDS",
                   help=f"arguments for pytest that say which tests judge ({SELECTION!r})")
    p.add_argument("--results", type=Path, default=ROOT / ".mutants.jsonl", metavar="FILE",
                   help="where results are kept (.mutants.jsonl)")
    return p.parse_args(arguments)


def _chosen(options: argparse.Namespace) -> list[Mutation]:
    mutations = read()
    if wrong := misfits(mutations):
        print(*wrong, sep="\n", file=sys.stderr)
        sys.exit(2)
    only = {x.strip() for x in options.only.split(",") if x.strip()}
    if unknown := only - {m.name for m in mutations}:
        sys.exit(f"no fault {', '.join(sorted(unknown))}; --list lists them")
    chosen = [m for m in mutations
              if (not only or m.name in only) and options.room in ("", m.room)]
    for stem in dict.fromkeys(stem for m in chosen for stem in m.tests):
        if not modules_of(ROOT, (stem,)):
            print(f"there is no tests/**/{stem}.py any more", file=sys.stderr)
    return chosen


def main(arguments: list[str] | None = None) -> int:
    options = _options(arguments)
    chosen, path = _chosen(options), options.results
    if options.list:
        for m in chosen:
            print(f"{m.name:28}  {m.room:18}  {m.file}: {', '.join(m.tests)}")
        return 0
    state = f"{state_of_tests(ROOT)} {options.selection} {options.whole}"
    keys = {m: hashlib.sha256(f"{astuple(m)}{(ROOT / m.file).read_text('utf-8')}{state}".encode())
            .hexdigest()[:16] for m in chosen}
    known = map(json.loads, path.read_text("utf-8").splitlines() if path.exists() else ())
    done = {row["key"]: row for row in known if row["end"] != "error"}
    with (tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder,
          path.open("a", encoding="utf-8") as file, ThreadPoolExecutor(options.jobs) as pool):
        judge = Judge(ROOT, Path(folder), options.selection.split(), options.longest,
                      options.whole)
        jobs = {pool.submit(judge.judged, m): keys[m] for m in chosen if keys[m] not in done}
        try:
            for job in as_completed(jobs):
                row = done[jobs[job]] = {"key": jobs[job], **job.result()}
                file.write(json.dumps(row) + "\n")
                file.flush()
                print(table([row]).splitlines()[0], flush=True)
        finally:  # Ctrl-C ends what runs; what is done is known
            pool.shutdown(wait=False, cancel_futures=True)
            judge.stop()
    rows = [done[keys[m]] for m in chosen]
    print(f"\n{table(rows)}")
    return int(any(row["end"] != "caught" for row in rows))


if __name__ == "__main__":
    sys.exit(main())
