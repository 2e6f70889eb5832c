"""Paths from a guess in one call of the kernel: loops closed, the path begun and followed."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence

from spatial_pin.kernel.closer import Closer, ClosureSettings
from spatial_pin.kernel.kernel import check, numbers
from spatial_pin.kernel.library import INT, POINTER, REAL, address
from spatial_pin.kernel.paths import PathRows, PathSamples, asked_path
from spatial_pin.numerics.linalg import Array
from spatial_pin.settings import Accuracy


class _Task(ctypes.Structure):
    _fields_ = [("n_chosen", INT), ("driven", POINTER), ("n_driven", INT), ("open", REAL),
                ("value", POINTER), ("n", INT), ("rows", PathRows)]


class Beginning:
    """Begins paths of a mechanism from guesses; one caller at a time.

    Args:
        closer: without pinned coordinates; nobody else's.
        driven: what is prescribed, the driver first; see `prescribed_places`.
    """

    def __init__(self, closer: Closer, driven: Sequence[int]) -> None:
        self._closer, self._kernel, self._library = closer, closer.kernel, closer.kernel.library
        kernel = self._kernel
        n = kernel.nv - kernel.n_passive - len(driven)
        self._has_redundant = n < kernel.n_closure
        self._driven = (INT * len(driven))(*driven)
        self._task = _Task(n, ctypes.addressof(self._driven), len(driven))
        self._rows, self._at_task = self._task.rows, ctypes.byref(self._task)
        self._path = ctypes.c_void_p()
        self._accuracy: Accuracy | None = None  # of the path

    def __del__(self) -> None:
        """Free what C has allocated."""
        if hasattr(self, "_path"):
            self._library.path_destroy(self._path)

    @property
    def independence(self) -> tuple[float, float]:
        """`least` and `left_out` of `Examined`, where the last path begins."""
        _, least, left_out = self._closer.facts.tolist()
        return least, left_out

    def follow(
        self, q: Array, place: int, value: float, angles: Array | None, values: Array,
        accuracy: Accuracy, asked: ClosureSettings, open_by: float,
    ) -> tuple[int, PathSamples] | None:
        """Close the loops from a guess, and follow the path that begins there.

        Args:
            q: (nq,) the guess, also what is named.
            place: of the driver in q.
            value: its first value.
            angles: (n_angles,) that screws count turns from [rad]; None: zero.
            values: (n,) of the driver.
            accuracy: of the path.
            asked: how loops are closed.
            open_by: closure error beyond which a further start has led nowhere.

        Returns:
            How many samples are reached, and the samples with room for all; None where closing
            leaves something to choose, or loops are not regular where it has led.
        """
        if accuracy is not self._accuracy:
            self._follow_by(accuracy)
        kernel, task, rows, n = self._kernel, self._task, self._rows, len(values)
        samples = PathSamples.empty(n, kernel.nq, kernel.nv, kernel.n_angles)
        rows.q, rows.t, rows.c, rows.error, rows.angles = map(address, samples)
        values = numbers(values, (n,))
        task.value, task.n, task.open = address(values), n, open_by
        self._closer.begin_at(q, place, value, angles, asked)
        done = self._library.path_from_guess(
            self._path, self._closer.handle, self._closer.at_task, self._at_task)
        return None if done < 0 else (done, samples)

    def _follow_by(self, accuracy: Accuracy) -> None:
        """Let paths be followed as exactly as that."""
        path = ctypes.c_void_p()
        check(self._library.path_create(
            self._kernel.handle, asked_path(accuracy, self._has_redundant, True),
            ctypes.byref(path)))
        self._library.path_destroy(self._path)
        self._path, self._accuracy = path, accuracy
