"""Processes that run cases on request, so that tools of all environments take turns.

    python -m benchmark.workers MODULE ...

reads one JSON request a line and writes one JSON answer a line. What a library prints goes to
stderr. Between requests a worker sleeps.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import importlib.metadata
import json
import os
import resource
import select
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmark.case import Absent, Case

SCRIPTS = Path(__file__).parent.parent
PATIENCE = 300.0  # for one answer [s]
ONE_THREAD = {name: "1" for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")}


def processor_time() -> float:
    """Return the time that this process and those it waited for have been running [s]."""
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + ended.ru_utime + ended.ru_stime


CLOCKS = {"wall": time.perf_counter, "cpu": processor_time}


class Failed(Exception):
    """A tool could not do its task."""


class Worker:
    """Runs the cases of some modules in this process."""

    def __init__(self, modules: Sequence[str]) -> None:
        loaded = [importlib.import_module(f"benchmark.{name}") for name in modules]
        self.cases: dict[str, Case] = {c.key: c for m in loaded for c in m.CASES}
        self.absent: list[Absent] = [a for m in loaded for a in getattr(m, "ABSENT", ())]
        self._tools: dict[str, Any] = {}
        self._results: dict[str, Any] = {}

    def rows(self) -> dict[str, Any]:
        """Return the cases as data, and the absent ones."""
        names = ("task", "tool", "how", "count", "size", "slow")
        return {"cases": {k: {n: getattr(c, n) for n in names} for k, c in self.cases.items()},
                "absent": [list(a) for a in self.absent]}

    def versions(self, packages: Sequence[str]) -> dict[str, str]:
        """Return the installed versions of packages, and that of Python."""
        versions = {}
        for name in packages:
            try:
                versions[name] = importlib.metadata.version(name)
            except importlib.metadata.PackageNotFoundError:
                continue
        return versions

    def setup(self, key: str) -> None:
        """Build what a case needs."""
        self._tools[key] = self.cases[key].setup()

    def run(self, key: str, number: int = 1, clock: str = "wall") -> float:
        """Return the mean seconds of `number` runs of a case, by an entry of CLOCKS."""
        run, tool, now = self.cases[key].run, self._tools[key], CLOCKS[clock]
        gc.disable()
        try:
            start = now()
            for _ in range(number):
                result = run(tool)
            seconds = now() - start
        finally:
            gc.enable()
        self._results[key] = result
        return seconds / number

    def judge(self, key: str) -> dict[str, float | None]:
        """Return the errors of the last run of a case, and let go of it."""
        errors = self.cases[key].judge(self._tools.pop(key), self._results.pop(key))
        return {name: None if e is None else float(e) for name, e in errors.items()}

    def close(self) -> None:
        """Let go of everything."""
        self._tools.clear()
        self._results.clear()


class Remote:
    """The same in a process of another environment.

    Args:
        python: its interpreter.
        modules: of this package.
    """

    def __init__(self, python: Path, modules: Sequence[str]) -> None:
        self._command = [str(python), "-m", "benchmark.workers", *modules]
        self._start()

    def _start(self) -> None:
        self._log = tempfile.TemporaryFile()  # noqa: SIM115 - closed with the process
        path = os.pathsep.join(filter(None, (str(SCRIPTS), os.environ.get("PYTHONPATH"))))
        self._process = subprocess.Popen(
            self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._log,
            env={**os.environ, **ONE_THREAD, "PYTHONPATH": path})

    def __getattr__(self, verb: str) -> Any:
        if verb.startswith("_"):
            raise AttributeError(verb)
        return lambda *args: self._ask(verb, args)

    def setup(self, key: str) -> None:
        """Build what a case needs, in a new process where the old one has ended."""
        if self._process.poll() is not None:
            self.close()
            self._start()
        self._ask("setup", [key])

    def _ask(self, verb: str, args: Sequence[Any]) -> Any:
        stdin, stdout = self._process.stdin, self._process.stdout
        assert stdin and stdout
        try:
            stdin.write(json.dumps([verb, *args]).encode() + b"\n")
            stdin.flush()
        except (BrokenPipeError, ValueError):
            raise Failed(self._last_words()) from None
        if not select.select([stdout], [], [], PATIENCE)[0]:
            self.close()
            raise Failed(f"no answer within {PATIENCE:g} s")
        line = stdout.readline()
        if not line:
            raise Failed(self._last_words())
        answer = json.loads(line)
        if "failed" in answer:
            raise Failed(answer["failed"])
        return answer["is"]

    def _last_words(self) -> str:
        self._log.seek(0)
        lines = self._log.read().decode(errors="replace").strip().splitlines()
        return "its process ended" + (f": {lines[-1].strip()}" if lines else "")

    def close(self) -> None:
        """End the process."""
        if self._process.poll() is None:
            self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout):
            if stream:
                with contextlib.suppress(OSError):  # unsent data is lost with the process
                    stream.close()
        if not self._log.closed:
            self._log.close()


def sentence(error: BaseException) -> str:
    """Return an error as one line."""
    first = (str(error).strip().splitlines() or [""])[0]
    return f"{type(error).__name__}: {first}"[:200]


def serve(modules: Sequence[str]) -> None:
    """Answer requests until stdin closes."""
    channel = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # libraries print
    worker: Worker | None = None
    for line in sys.stdin:
        verb, *args = json.loads(line)
        try:
            worker = worker or Worker(modules)
            answer = {"is": getattr(worker, verb)(*args)}
        except Exception as error:
            answer = {"failed": sentence(error)}
        channel.write(json.dumps(answer) + "\n")
        channel.flush()


if __name__ == "__main__":
    serve(sys.argv[1:])
