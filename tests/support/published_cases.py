"""Simulations with published answers.

To add one, add a `Case` to CASES. Its answers are numbers at the end of its duration.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import NamedTuple

import numpy as np
import published_models as models

from spatial_pin.assembly.assemble import assembled
from spatial_pin.assembly.state import State
from spatial_pin.dynamics.forward import forward_dynamics
from spatial_pin.dynamics.simulation.simulate import Simulation, simulate
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.numerics.linalg import Array
from spatial_pin.rates.rates import solve_rates
from spatial_pin.settings import Accuracy

IFTOMM = "IFToMM Library of Computational Benchmark Problems, "
ADAMS = "ADAMS, from the test data of Project Chrono, "
STIFF = Accuracy(integrator="Radau", tolerance=1e-15, time_tolerance=4e-9)


class Answer(NamedTuple):
    """What is to come out at the end.

    Attributes:
        values: the numbers.
        size: what one means by 1 of them: errors are counted by it.
    """

    values: tuple[float, ...]
    size: float = 1.0


class Case(NamedTuple):
    """A simulation with a published answer.

    Attributes:
        title: what it is.
        source: who published it.
        build: returns the mechanism.
        begin: returns its state at time 0.
        duration: how long [s].
        read: returns the answers of a simulation by name, those of its last row.
        answers: by name.
        accuracy: how exact the answers are relative to their sizes.
        settings: accuracy settings that reach it.
    """

    title: str
    source: str
    build: Callable[[], Mechanism]
    begin: Callable[[Mechanism], State]
    duration: float
    read: Callable[[Simulation], Mapping[str, Array]]
    answers: Mapping[str, Answer]
    accuracy: float
    settings: Accuracy = Accuracy.named("reference")


class Outcome(NamedTuple):
    """A case as simulated.

    Attributes:
        error: largest error of an answer relative to its size.
        seconds: time that it took.
        closure_error: the largest [-].
        energy_drift: see `Simulation`.
        simulation: the motion.
    """

    error: float
    seconds: float
    closure_error: float
    energy_drift: float
    simulation: Simulation

    def __str__(self) -> str:
        return (f"error {self.error:.1e} in {self.seconds:.3g} s; closure error "
                f"{self.closure_error:.1e}, energy drift {self.energy_drift:.1e}")


def run(case: Case, accuracy: Accuracy | None = None) -> Outcome:
    """Simulate a case.

    Args:
        case: an entry of CASES, or one like it.
        accuracy: settings; default those of the case.

    Returns:
        The Outcome; the time is that of `simulate` alone, with rows at 1001 times.
    """
    mechanism = case.build()
    state = case.begin(mechanism)
    start = time.perf_counter()
    simulation = simulate(mechanism, state, case.duration, accuracy=accuracy or case.settings)
    seconds = time.perf_counter() - start
    found = case.read(simulation)
    error = max(float(np.abs(found[name] - answer.values).max()) / answer.size
                for name, answer in case.answers.items())
    return Outcome(error, seconds, float(simulation.closure_error.max()), simulation.energy_drift,
                   simulation)


# ---------------------------------------------------------------- where they begin


def at(mechanism: Mechanism, **coordinates: float) -> State:
    """Return the state at rest with these coordinates."""
    return assembled(mechanism, coordinates)


def _ladder_state(mechanism: Mechanism) -> State:
    return solve_rates(mechanism, assembled(mechanism, {"pin_0": 0.0}), {"pin_0": -1.0})


def _governor_state(mechanism: Mechanism) -> State:
    tilt = math.pi / 6
    state = assembled(mechanism, {"slide": 0.5, "right_pin": tilt, "left_pin": tilt})
    v = np.zeros(mechanism.model.nv)
    v[mechanism.coordinate("shaft_pin").v] = 2.0 * math.pi
    return State(mechanism, state.q, v, closure_error=state.closure_error)


# ---------------------------------------------------------------- what is read


def _position(frame: str, simulation: Simulation) -> dict[str, Array]:
    return {"position": simulation.state(-1).placement(frame).translation}


def _values(simulation: Simulation, *names: str) -> dict[str, Array]:
    return {name: simulation.coordinate(name).value[-1:] for name in names}


def _rods(simulation: Simulation) -> dict[str, Array]:
    """Return the clockwise angles of all rods of a ladder [rad], and the speed of the first."""
    pins = [n for n in simulation.mechanism.coordinates if n.startswith("pin_")]
    angles = [-simulation.coordinate(pin).value[-1] for pin in pins]
    return {"angles": np.array(angles), "speed": -simulation.coordinate("pin_0").rate[-1:]}


def _governor(simulation: Simulation) -> dict[str, Array]:
    found = _values(simulation, "slide", "right_pin", "left_pin")
    return {**found, "speed": simulation.coordinate("shaft_pin").rate[-1:]}


def on_pair(pair: str, state: State) -> dict[str, Array]:
    """Return motion of frame `com`, and the force on the ground through a pair, each (3,)."""
    answer = forward_dynamics(state.mechanism, state)
    twist, accel = state.velocity("com"), answer.state.acceleration("com")
    return {"position": state.placement("com").translation, "velocity": twist.linear,
            "acceleration": accel.linear, "spin": twist.angular,
            "force": -answer.reactions[pair].linear}


def _on_pair(pair: str, simulation: Simulation) -> dict[str, Array]:
    return on_pair(pair, simulation.state(-1))


# ---------------------------------------------------------------- the cases


def _ladder_case(n: int, angle: float, speed: float) -> Case:
    return Case(
        f"{n} four-bar loops side by side, ten times through the flat configuration",
        IFTOMM + "A02; exact by elliptic functions", partial(models.ladder, n), _ladder_state, 10.0,
        _rods, {"angles": Answer((angle,) * (n + 1)), "speed": Answer((speed,))}, 1e-8)


def _adams_case(
    title: str, source: str, build: Callable[[], Mechanism], pair: str, accuracy: float,
    **answers: tuple[float, ...],
) -> Case:
    sized = {name: Answer(values, max(1.0, *map(abs, values))) for name, values in answers.items()}
    return Case(title, ADAMS + source, build, at, 5.0, partial(_on_pair, pair), sized, accuracy)


HANGING = -math.pi / 2

CASES: dict[str, Case] = {
    "pendulum": Case(
        "a simple pendulum", IFTOMM + "A01; exact by elliptic functions", models.simple_pendulum,
        partial(at, pin=math.pi), 10.0, partial(_position, "bob"),
        {"position": Answer((-0.2750874625761169, -0.9614192050991251, 0.0))}, 1e-8),
    "ladder_1": _ladder_case(1, 31.914741297738025, 1.966934719440319),
    "ladder_2": _ladder_case(2, 31.750597186986102, 1.506642180841829),
    "ladder_5": _ladder_case(5, 31.653957055797653, 1.277587362674054),
    "ladder_10": _ladder_case(10, 31.621729822781873, 1.212262216527867),
    "ladder_20": _ladder_case(20, 31.605549460268490, 1.182061479569949),
    "ladder_40": _ladder_case(40, 31.597433743985738, 1.167622108751707),
    "bricard": Case(
        "six hinges and five rods on a cube, overconstrained",
        IFTOMM + "A04; by an integration to 1e-12", models.bricard, at, 10.0,
        partial(_position, "p3"),
        {"position": Answer((0.999999963806, -1.000269012696, 0.999730951120))}, 1e-8),
    "governor": Case(
        "a flyball governor with stiff springs", IFTOMM + "A05; by an integration to 1e-12",
        models.governor, _governor_state, 10.0, _governor,
        {"slide": Answer((0.619622917061,)), "right_pin": Answer((0.390073701845,)),
         "left_pin": Answer((0.390073701845,)), "speed": Answer((5.548203622655,))}, 1e-8, STIFF),
    "adams_revolute": _adams_case(
        "a body on a hinge", "Revolute_Case01",
        partial(models.on_a_joint, "revolute", models.ZERO, HANGING), "pair", 1e-5,
        position=(-1.99968, 0.0, -0.0355587), velocity=(-0.0146657, 0.0, 0.824742),
        acceleration=(0.510225, 0.0, -9.55839), spin=(0.0, 0.412436, 0.0),
        force=(-0.510225, 0.0, -0.248259)),
    "adams_spherical": _adams_case(
        "a body on a ball", "Spherical_Case02",
        partial(models.on_a_joint, "spherical", (1.0, 2.0, 3.0), -math.pi / 4), "pair", 3e-5,
        position=(-0.999684, 2.0, 2.96444), velocity=(-0.0146657, 0.0, 0.824742),
        acceleration=(0.510211, 0.0, -9.5584), spin=(0.0, 0.412436, 0.0),
        force=(-0.510211, 0.0, -0.248253)),
    "adams_cylindrical": _adams_case(
        "a body that turns on a shaft and slides along it", "Cylindrical_Case02",
        partial(models.on_a_joint, "cylindrical", models.ZERO, HANGING), "pair", 1e-5,
        position=(-1.99968, 0.0, -0.0355587), velocity=(-0.0146657, 0.0, 0.824742),
        acceleration=(0.510231, 0.0, -9.55839), spin=(0.0, 0.412436, 0.0),
        force=(-0.510231, 0.0, -0.248259)),
    "adams_prismatic": _adams_case(
        "a body on a slope", "Prismatic_Case02",
        partial(models.on_a_joint, "prismatic", (1.0, 2.0, 3.0), -math.pi / 4), "pair", 3e-5,
        position=(3.0, -59.2916, -58.2916), velocity=(0.0, -24.5166, -24.5166),
        acceleration=(0.0, -4.90332, -4.90333), spin=(0.0, 0.0, 0.0),
        force=(0.0, 4.90332, -4.90332)),
    "adams_distance": _adams_case(
        "a body on a massless string", "Distance_Case01", models.on_a_string, "pair", 2e-4,
        position=(0.0, -1.999998, -2.779575e-3), velocity=(0.0, -3.244973e-4, 0.2334878),
        acceleration=(0.0, 4.099856e-2, -9.806593), spin=(0.0, 0.0, 0.0),
        force=(0.0, -4.099856e-2, -5.697934e-5)),
    "adams_revolute_spherical": _adams_case(
        "a body on a ball at the end of a massless link", "RevSpherical_Case01", models.on_a_link,
        "pin", 1e-5,
        position=(-1.32782, 1.24003, -1.28683), velocity=(0.662665, -0.663793, 4.82745),
        acceleration=(1.04601e-4, 0.162916, -8.78471), spin=(-1.1297, 2.98615, -0.596732),
        force=(-1.04601e-4, -0.162916, -1.02194)),
}
