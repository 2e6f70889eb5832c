"""Arguments that nobody means, for functions that work something out, and what comes of them."""

from __future__ import annotations

import linecache
import math
from collections.abc import Callable, Iterator
from datetime import date
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import pinocchio as pin

import spatial_pin as sp
from spatial_pin import laws, operators

PACKAGE = str(Path(sp.__file__).parent)


class Anything:
    """An object of a kind that the library does not know."""

    def __repr__(self) -> str:
        return "Anything()"


def other_mechanism() -> sp.Mechanism:
    return sp.load("spherical_four_bar")


def garbage() -> dict[str, Callable[[], Any]]:
    """Each made anew, since iterators are used up."""
    other = other_mechanism()
    state = sp.assemble(other)
    motion = sp.sweep(other, next(iter(other.drivers)), [0.0, 0.01])
    made: dict[str, Any] = {
        "None": None, "True": True, "text": "nonsense", "empty text": "", "bytes": b"crank",
        "nan": math.nan, "inf": math.inf, "huge": 1e308, "tiny": 5e-324, "negative": -1.0,
        "zero": 0, "huge whole": 10**400, "complex": 1j, "list": [], "tuple": (), "dict": {},
        "set": {1, "crank"}, "nested": [[1.0, [2.0]], [3.0]], "deep": [[[[[1.0]]]]],
        "names": ["crank", None], "dict of None": {"crank": None}, "dict of text": {"crank": "x"},
        "dict of nan": {"crank": math.nan}, "dict of huge": {"crank": 1e308},
        "dict of lists": {"crank": [1.0, 2.0]}, "numbered": {0: 1.0}, "unknown": {"nobody": 1.0},
        "object": Anything(),
        "lambda": lambda *x: "text", "lambda of None": lambda *x: None,
        "lambda of lists": lambda *x: [1.0, 2.0, 3.0, 4.0], "date": date(2020, 1, 1),
        "array of texts": np.array(["a", "b"]), "array of objects": np.array([None, {}]),
        "array of nan": np.full(5, math.nan), "empty array": np.empty((0, 3)),
        "array of bools": np.array([True, False]), "array of complex": np.array([1j, 2.0]),
        "cube": np.zeros((2, 3, 4)), "dates": np.array(["2020-01-01"], dtype="datetime64[D]"),
        "records": np.zeros(3, dtype=[("a", float), ("b", int)]), "ints": np.arange(7),
        "unsigned": np.arange(3, dtype=np.uint8), "0-d": np.array(1.5), "matrix": np.eye(4),
        "mechanism": other, "state": state, "motion": motion, "accuracy": sp.Accuracy(),
        "SE3": pin.SE3.Identity(), "pin motion": pin.Motion.Zero(), "model": pin.Model(),
        "path": Path("no/such/file"), "surrogate": "\ud800", "nul": "a\0b", "range": range(5),
        "error": ValueError("x"), "module": math,
    }
    calls: dict[str, Callable[[], Any]] = {k: (lambda x=x: x) for k, x in made.items()}
    calls["generator"] = lambda: (x for x in (1.0, 2.0))
    calls["generator of names"] = lambda: (x for x in ("crank", 3))
    return calls


def verbs(folder: Path) -> Iterator[tuple[str, Callable[..., Any], dict[str, Any]]]:
    """Every public function and method that takes anything, with arguments that are good."""
    m = sp.load("four_bar")
    at = sp.solve_rates(m, sp.assemble(m, {"crank": 0.4}), {"crank": 1.0})
    motion = sp.sweep(m, "crank", np.linspace(0.3, 0.5, 4), speed=1.0)
    short = {"crank": 0.4}
    a, s, g = {"mechanism": m}, {"mechanism": m, "state": at}, {"guess": None, "accuracy": None}
    yield "assemble", sp.assemble, {**a, "drivers": short, **g, "limits": False}
    yield "closure_jacobian", sp.closure_jacobian, {**a, "q": at}
    yield "dead_centres", sp.dead_centres, {"motion": motion, "output": "rocker_pin"}
    force = {**s, "efforts": {"crank": 1.0}, "external": None, "laws": None}
    yield "dynamics_derivatives", sp.dynamics_derivatives, {**force, "slopes": None}
    yield "forward_dynamics", sp.forward_dynamics, force
    acting = {"actuated": ["crank"], "external": None, "laws": None}
    yield "inverse_dynamics", sp.inverse_dynamics, {**s, **acting}
    yield "kinetostatics", sp.kinetostatics, {**a, "motion": motion, **acting}
    yield "grashof", sp.grashof, s
    yield "influence", sp.influence, s
    yield "jacobian", sp.jacobian, {**s, "name": "coupler"}
    yield "jacobian_rate", sp.jacobian_rate, {**s, "name": "coupler"}
    yield "limits", sp.limits, {**a, "driver": "crank", "guess": None, "joints": False}
    yield "mobility", sp.mobility, {**a, "q": at}
    yield "reduce", sp.reduce, {**a, "outputs": "rocker_pin", "lock": (), "dynamics": False,
                                "lump": False, "guess": None}
    yield "sensitivity", sp.sensitivity, {**s, "output": "rocker_pin", "parameters": ["r2"]}
    yield "solve_jerks", sp.solve_jerks, {**s, "jerks": {"crank": 1.0}}
    yield "solve_rates", sp.solve_rates, {**s, "speeds": short, "accelerations": short}
    yield "sweep", sp.sweep, {**a, "driver": "crank", "values": [0.3, 0.4], "speed": 1.0,
                              "acceleration": 0.0, **g, "hold": None, "on_limit": "raise",
                              "on_crossing": "straight"}
    yield "tolerance", sp.tolerance, {**a, "outputs": "rocker_pin", "deviations": {"r2": 1e-5},
                                      "state": at, "samples": 2, "executor": None, "seed": 0}
    yield "trace", sp.trace, {**a, "driver": "crank", "guess": None, "step": 0.5, "most_rows": 9}
    yield "tradeoff", sp.tradeoff, {**a, "task": {"driver": "crank", "values": [0.3, 0.4]},
                                    "settings": [sp.Accuracy()], "repeats": 1, "budget": 0.01}
    yield "transmission", sp.transmission, {**s, "output": "rocker_pin", "driver": "crank",
                                            "at": None}
    yield from _settings()
    yield from _results(m, at, motion, folder)
    yield from _formulas()


def long_verbs(folder: Path) -> Iterator[tuple[str, Callable[..., Any], dict[str, Any]]]:
    """Those that write, serve, search or simulate; no browser is to be had while they are tried."""
    m = sp.load("four_bar")
    at = sp.solve_rates(m, sp.assemble(m, {"crank": 0.4}), {"crank": 1.0})
    motion = sp.sweep(m, "crank", np.linspace(0.3, 0.5, 4), speed=1.0)
    shown = {"motion_or_state": motion}
    drawn = {"title": None, "look": None}
    looks = {"pairs": None, "axes": False, "traces": (), "arrows": (), "centres": False,
             "ghosts": (), "side_by_side": False}
    yield "load", sp.load, {"source": "four_bar", "trusted": False, "r2": 0.1}
    yield "assembly_modes", sp.assembly_modes, {
        "mechanism": m, "drivers": {"crank": 0.4}, "free": (), "copies": False, "limits": False,
        "patience": 50, "most_starts": 60, "seed": 0, "accuracy": None, "progress": False}
    yield "simulate", sp.simulate, {
        "mechanism": m, "state": at, "duration": 0.01, "efforts": None, "times": None,
        "accuracy": sp.Accuracy(most_steps=200), "drives": None, "laws": None, "slip_speed": None,
        "stop_when": None, "on_joint_limit": "report", "progress": False}
    yield "tolerance", sp.tolerance, {
        "mechanism": m, "outputs": "rocker_pin", "deviations": {"r2": 1e-5}, "samples": 2,
        "executor": None, "progress": False}
    yield "show", _stopped(sp.show), {**shown, "look": None, "open_browser": False}
    yield "live", _stopped(sp.live), {
        "mechanism": m, "state": at, "drivers": None, "outputs": (), **drawn, "port": 0,
        "open_browser": False}
    yield "export_html", sp.export_html, {**shown, "path": folder / "a.html", **drawn}
    yield "screenshot", sp.screenshot, {
        **shown, "path": folder / "a.png", "row": 0, "size": (100, 100), **drawn}
    yield "movie", sp.movie, {
        "motion": motion, "path": folder / "a.gif", "fps": 25.0, "size": (100, 100), **drawn,
        "progress": False}
    yield "report", sp.report, {**shown, "path": folder / "r.html", "outputs": "crank", **drawn}
    yield "plot", sp.plot, {
        "motion": motion, "outputs": "crank", "path": folder / "p.svg", "title": None}
    yield "Look", lambda **k: sp.export_html(motion, folder / "b.html", look=sp.Look(**k)), looks
    yield "Look at a state", lambda **k: sp.export_html(
        at, folder / "c.html", look=sp.Look(**k)), looks


def _stopped(verb: Callable[..., Any]) -> Callable[..., None]:
    return lambda **given: verb(**given).stop()


def _settings() -> Iterator[tuple[str, Callable[..., Any], dict[str, Any]]]:
    accuracy = {"order": 3, "corrections": None, "tolerance": 1e-13, "time_tolerance": 1e-9,
                "formulation": "independent", "integrator": "RK4", "step": 0.1}
    yield "Accuracy", sp.Accuracy, accuracy
    yield "Accuracy.named", sp.Accuracy.named, {"level": "draft"}
    yield "Accuracy.for_error", sp.Accuracy.for_error, {"error": 1e-3, "task": "sweep",
                                                        "measured": None}
    one = {"start": 0.0, "speed": 1.0}
    yield "constant_speed", laws.constant_speed, one
    yield "ramp", laws.ramp, {**one, "rise_time": 1.0}
    yield "cycloid", laws.cycloid, {"start": 0.0, "end": 1.0, "rise_time": 1.0}
    yield "polynomial", laws.polynomial, {"coefficients": [0.0, 1.0]}
    yield "sine", laws.sine, {"mean": 0.0, "amplitude": 1.0, "frequency": 1.0, "phase": 0.0}
    yield "spline", laws.spline, {"times": [0.0, 1.0, 2.0, 3.0], "values": [0.0, 1.0, 0.0, 2.0]}


def _results(m: sp.Mechanism, at: sp.State, motion: sp.Motion, folder: Path) -> Any:
    names = {"name": "coupler"}
    for method in ("coordinate", "driven_coordinate"):
        yield f"Mechanism.{method}", getattr(m, method), {"name": "crank"}
    for method in ("frame_id", "frame_on_joint", "placed"):
        yield f"Mechanism.{method}", getattr(m, method), names
    for method in ("joint_id", "pair_of"):
        yield f"Mechanism.{method}", getattr(m, method), {"joint": "crank_pin"}
    for method in ("placement", "velocity", "acceleration", "angular_velocity", "com",
                   "angular_acceleration"):
        yield f"State.{method}", getattr(at, method), names
    yield "State.coordinate", at.coordinate, {"name": "crank"}
    yield "State.relative_motion", at.relative_motion, {"point": "coupler", "frame": "rocker"}
    for method in ("frame", "com"):
        yield f"Motion.{method}", getattr(motion, method), names
    yield "Motion.coordinate", motion.coordinate, {"name": "crank"}
    yield "Motion.output", motion.output, {"spec": "coupler.position"}
    yield "Motion.state", motion.state, {"row": 1}
    yield "Motion.to_csv", motion.to_csv, {"path": folder / "a.csv"}
    yield "Motion.save", motion.save, {"path": folder / "a.npz"}
    yield "Motion.load", sp.Motion.load, {"path": motion.save(folder / "b.npz"), "mechanism": m}
    jerks = sp.solve_jerks(m, at, {"crank": 0.0})
    for method in ("frame", "com"):
        yield f"Jerks.{method}", getattr(jerks, method), names
    yield "Jerks.coordinate", jerks.coordinate, {"name": "crank"}
    less = sp.reduce(m, "rocker_pin")
    yield "Reduced.state", less.state, {"full": at}
    yield "Reduced.frame_id", less.frame_id, names
    yield "Reduced.placed", less.placed, names
    yield "Reduced.verify", less.verify, {"driver": "crank", "values": [0.3, 0.4], "speed": 1.0,
                                          "acceleration": 0.5, "guess": None, "hold": None}
    found = sp.tradeoff(m, {"driver": "crank", "values": [0.3, 0.4]}, settings=[sp.Accuracy()],
                        repeats=1, budget=0.01)
    yield "Tradeoff.cheapest", found.cheapest, {"error": 1.0}
    yield "Tradeoff.to_json", found.to_json, {"path": folder / "a.json"}


GOOD = {  # of the operators' arguments, by name
    "placement": pin.SE3.Identity(), "frame": pin.SE3.Identity(), "rotation": np.eye(3),
    "matrix": np.eye(3), "axis": "z", "angle": 0.3, "cosines": np.eye(3), "rate": np.zeros((3, 3)),
    "acceleration": np.zeros((3, 3)), "before": [[0.0, 0.0], [1.0, 0.0]],
    "after": [[0.0, 0.0], [0.0, 1.0]], "turns": [("z", 0.1)], "offset": [0.1, 0.2, 0.3],
    "slide": 0.1, "table": [(0.1, 0.0, 0.2, 0.0)], "q": [0.1], "v": [0.1], "a": [0.1],
    "alpha": 0.1, "d": 0.1, "theta": 0.1, "start": [0.0, 0.0, 0.0], "end": [0.0, 0.0, 1.0],
    "displacement": np.eye(3), "points": [[0.1, 0.2, 0.3]], "case": 1, "lead": 0.1,
    "direction": [0.0, 0.0, 1.0], "point": [0.1, 0.2, 0.3], "pitch": 0.1, "translation": 0.1,
    "x": 0.1, "y": 0.1, "tolerance": 1e-9, "smallest_angle": 1e-15, "first": 0.1, "second": 0.2,
    "third": 0.3, "name": "dh",
}
OF_FUNCTION = {
    ("rotation_matrix", "axis"): [0.0, 0.0, 1.0], ("axis_vector", "axis"): [0.0, 0.0, 1.0],
    ("dh_placement", "a"): 0.1, ("planar_rotation_about", "point"): [0.1, 0.2],
    ("planar_translation", "displacement"): [0.1, 0.2],
    ("displaced_planar", "points"): [[0.1, 0.2]],
    ("complex_rotation_between", "before"): 1.0 + 0j, ("complex_rotation_between", "after"): 1j,
}


def _formulas() -> Iterator[tuple[str, Callable[..., Any], dict[str, Any]]]:
    import inspect

    for name in operators.__all__ if hasattr(operators, "__all__") else dir(operators):
        function = getattr(operators, name)
        if not inspect.isfunction(function) or name.startswith("_"):
            continue
        keys = [k for k, p in inspect.signature(function).parameters.items()
                if p.kind is not p.VAR_POSITIONAL]
        if keys:
            yield name, function, {k: OF_FUNCTION.get((name, k), GOOD[k]) for k in keys}
        else:
            yield name, lambda operator, f=function: f(np.eye(4), operator), {"operator": np.eye(4)}


def refusal(error: BaseException) -> str:
    """Return "" for an error in words, else where it comes from."""
    frame: TracebackType | None = error.__traceback__
    while frame is not None and frame.tb_next is not None:
        frame = frame.tb_next
    assert frame is not None
    code, line = frame.tb_frame.f_code, frame.tb_lineno
    text = linecache.getline(code.co_filename, line).strip()
    where = f"{Path(code.co_filename).name}:{line} {text[:60]}"
    if isinstance(error, sp.SpatialPinError):
        return ""
    if isinstance(error, OSError) and error.filename is not None:
        return ""
    if not isinstance(error, TypeError | ValueError):
        return f"{type(error).__name__}: {str(error)[:80]} at {where}"
    if not code.co_filename.startswith(PACKAGE) or not text.startswith("raise"):
        return f"{type(error).__name__}: {str(error)[:80]} at {where}"
    return ""
