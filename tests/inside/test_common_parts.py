"""Parts that all rooms use: whole files, values worked out once, digits that a spread warrants."""

import copy
import pickle
import signal
import subprocess
import sys
import threading

import numpy as np
import pytest

import spatial_pin as sp
from spatial_pin._support.lazy import RESULTS, cached_property, made_anew, made_once
from spatial_pin._support.output_files import replacing
from spatial_pin.constraints.compiled_equations import constraints_of
from spatial_pin.dimensions.sensitivity import with_spread

OLD = "what was there before"


@pytest.mark.skipif(sys.platform == "win32", reason="a signal of POSIX")
def test_a_kill_on_the_way_loses_nothing(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text(OLD)
    code = ("import os, signal, sys; from pathlib import Path\n"
            "from spatial_pin._support.output_files import replacing\n"
            "with replacing(Path(sys.argv[1])) as target:\n"
            "    target.write_text('half'); os.kill(os.getpid(), signal.SIGKILL)\n")
    done = subprocess.run([sys.executable, "-c", code, str(path)], timeout=60)
    assert done.returncode == -signal.SIGKILL
    assert path.read_text() == OLD


def test_an_error_on_the_way_leaves_no_trace(tmp_path):
    with pytest.raises(RuntimeError), replacing(tmp_path / "a.txt") as target:
        target.write_text("half")
        raise RuntimeError
    assert not list(tmp_path.iterdir())


def test_what_a_mechanism_works_out_on_request_holds_no_lock():
    """While one thread works it out, a child, or another thread, can too."""

    class Part:
        @cached_property
        def size(self) -> int:
            if threading.current_thread() is not threading.main_thread():
                begun.set()
                assert go_on.wait(60)
            return 7

    assert isinstance(vars(sp.Mechanism)["characteristic_length"], type(vars(Part)["size"]))
    begun, go_on = threading.Event(), threading.Event()
    thread = threading.Thread(target=lambda: Part().size)
    thread.start()
    assert begun.wait(60)
    part = Part()
    assert part.size == 7 and vars(part) == {"size": 7}
    go_on.set()
    thread.join()


def test_what_is_made_once_is_one_object_for_all_threads_though_several_make_it():
    together = threading.Barrier(2, timeout=60)

    @made_once
    def table(owner: object) -> list[int]:
        together.wait()
        return []

    owner, found = Held(), []
    threads = [threading.Thread(target=lambda: found.append(table(owner))) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found[0] is found[1] is table(owner)
    assert together.n_waiting == 0


class Held:
    """An object that holds what is made of it."""


def test_results_belong_to_one_object_one_function_and_its_arguments():
    @made_once
    def one(owner: object, *more: int) -> list[int]:
        return [1, *more]

    @made_once
    def two(owner: object, *more: int) -> list[int]:
        return [2, *more]

    owner, other = Held(), Held()
    assert one(owner) is one(owner) and one(owner, 3) is one(owner, 3)
    assert one(owner) is not one(other)
    assert (one(owner), one(owner, 3), two(owner, 3)) == ([1], [1, 3], [2, 3])


def test_what_is_made_anew_is_that_of_the_last_arguments_only():
    made = []

    @made_anew
    def text(owner: object, values: dict[str, int]) -> str:
        made.append(values)
        return str(values)

    owner = Held()
    assert [text(owner, {"a": x}) for x in (1, 1, 2, 1)] == ["{'a': 1}"] * 2 + [
        "{'a': 2}", "{'a': 1}"]
    assert made == [{"a": 1}, {"a": 2}, {"a": 1}]


def test_a_mistake_in_what_is_made_is_raised_as_it_is_and_every_time():
    @made_once
    def wrong(owner: object) -> int:
        raise KeyError("own")

    owner = Held()
    for _ in range(2):
        with pytest.raises(KeyError, match="own") as caught:
            wrong(owner)
        assert caught.value.__context__ is None


@pytest.mark.parametrize("copied", [
    copy.copy, copy.deepcopy, lambda m: pickle.loads(pickle.dumps(m)), lambda m: m.with_fields()])
def test_copies_of_a_mechanism_begin_without_what_was_made_of_it(copied):
    mechanism = sp.load("rssr")
    sp.assemble(mechanism, {"crank": 1.0})
    own = constraints_of(mechanism)
    other = copied(mechanism)
    assert own.mechanism is mechanism and constraints_of(mechanism) is own
    assert constraints_of(other).mechanism is other


def test_nothing_that_is_made_of_a_mechanism_shows_among_its_names():
    mechanism = sp.load("rssr")
    sp.assemble(mechanism, {"crank": 1.0})
    assert "memo" not in dir(mechanism)
    assert {name for name in vars(mechanism) if name.startswith("_")} == {RESULTS}


@pytest.mark.parametrize(("value", "deviation", "unit", "text"), [
    (1.23456789, 0.00214, "rad", "1.2346 ± 0.0021 rad"),
    (1234.5678, 31.4, "m/s²", "1235 ± 31 m/s²"),
    (0.0, 0.0321, "m", "0.000 ± 0.032 m"),
    (1.25, 3e-17, "m", "1.25 ± 0 m"),
    (1.23456e-7, 3.2e-9, "1", "(1.235 ± 0.032)e-7"),
    (2.5e9, 4.4e7, "N", "(2.500 ± 0.044)e9 N"),
    (np.inf, np.nan, "", "inf ± nan"),
    (np.array([1.0, 2.0]), np.array([0.1, 0.0]), "m", "[1.00 ± 0.10, 2 ± 0] m"),
])
def test_a_value_has_the_digits_that_its_spread_warrants(value, deviation, unit, text):
    assert with_spread(value, deviation, unit) == text
