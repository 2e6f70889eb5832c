"""Small motions about a pose at rest: vibrations, transfer functions, compliance."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from spatial_pin._support.checks import (
    as_array,
    checked,
    is_finite,
    names_of,
    positive_number,
    whole_number,
)
from spatial_pin._support.columns import XYZ, Quantity, Tabular, chosen
from spatial_pin.assembly.state import State, of_mechanism
from spatial_pin.dynamics.derivatives.derivatives import exact_mechanism
from spatial_pin.dynamics.derivatives.small_motions import (
    AppliedLoads,
    ReducedEquations,
    SmallMotions,
)
from spatial_pin.dynamics.equilibrium import NEUTRAL, independent_motions, stability_of, vibrations
from spatial_pin.dynamics.forces import Law
from spatial_pin.errors import SingularError, SpatialPinError
from spatial_pin.kernel.loop_equations import loops_at
from spatial_pin.mechanism.coordinates import (
    coordinate_gradient,
    coordinate_value,
    driver_coordinates,
)
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.motion.follow import follow
from spatial_pin.motion.motion import Motion
from spatial_pin.numerics.linalg import Array, decompose
from spatial_pin.numerics.tolerances import TOLERANCES

AT_REST = 1e-6  # largest unbalanced force of a pose at rest, relative to its terms
AMPLITUDE = 0.1  # largest coordinate of a shape [rad, characteristic lengths]: well visible
NO_DECAY = 1e-14  # decay that counts as none, relative to the largest eigenvalue: round-off
SHAPE_SAMPLES = 61  # samples of one period of a shape: one per 6 degrees of phase


class Linearization(Tabular):
    """The linear equations of small motions: M y'' + C y' + K y = B u.

    y are small changes of `coordinates`, u of `inputs`. As a table (`columns`, `to_csv`,
    `to_dataframe`, ...) it has a row for each vibration.

    Attributes:
        state: the pose at rest.
        coordinates: names of the n independent coordinates.
        mass, damping, stiffness: (n, n) M, C (gyroscopic terms included) and K (of weights,
            preloaded springs and moving axes too).
        inputs, outputs: names.

    Example:
        >>> mech = sp.load("four_bar")
        >>> found = sp.linearize(mech, sp.equilibrium(mech).state)
        >>> found.frequencies.round(3)  # [Hz]
        array([2.058])
        >>> found.stable
        True
    """

    def __init__(
        self, at: SmallMotions, names: Sequence[str], reduced: ReducedEquations,
        inputs: Mapping[str, Array], outputs: Mapping[str, tuple[Array, Array]], neutral: int,
    ) -> None:
        self.state, self.coordinates = at.state, tuple(names)
        self.mass, self.damping, self.stiffness = (
            reduced.mass, reduced.damping, reduced.stiffness)
        self.inputs, self.outputs = tuple(inputs), tuple(outputs)
        n = len(names)
        self._b = np.array([*inputs.values()]).reshape(len(inputs), n).T
        self._c = np.array([np.concatenate(x) for x in outputs.values()]).reshape(
            len(outputs), 2 * n)
        self._loads, self._neutral = at.loads, neutral
        sizes = np.abs(reduced.mass).max(initial=0.0)
        if n and decompose(reduced.mass / (sizes or 1.0)).rank < n:
            raise SingularError(
                f"mechanism {at.loads.mechanism.name!r}: {at.state}: a motion of "
                f"{', '.join(names)} has no inertia, so that it does not vibrate: give its links "
                "mass, or hold it", state=at.state)

    @property
    def eigenvalues(self) -> NDArray[np.complex128]:
        """(2n,) eigenvalues [1/s], by their size.

        Example:
            >>> mech = sp.load("four_bar")
            >>> sp.linearize(mech, sp.equilibrium(mech).state).eigenvalues.imag.round(2)  # [rad/s]
            array([-12.93,  12.93])
        """
        return self._roots()[0]

    def _roots(self) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """Return the eigenvalues by their size, those of neutral motions zero, and their forms."""
        roots, forms = vibrations(self.mass, self.damping, self.stiffness)
        order = np.lexsort((roots.imag, roots.real, np.abs(roots).round(12)))
        roots, forms = roots[order], forms[order]
        slow = np.abs(roots) <= np.sqrt(NEUTRAL) * np.abs(roots).max(initial=0.0)
        slow[2 * self._neutral:] = False
        return np.where(slow, 0.0, roots), forms

    @property
    def stable(self) -> bool:
        """Whether no eigenvalue has a positive real part, or is zero."""
        eigenvalues = self.eigenvalues
        least = NEUTRAL * np.abs(eigenvalues).max(initial=0.0)
        return bool(np.all(eigenvalues.real <= least) and np.all(np.abs(eigenvalues) > least))

    @property
    def frequencies(self) -> Array:
        """(n,) frequencies of the vibrations [Hz], ascending: the size of λ over 2π.

        A pair of real eigenvalues of one sign has √(λ₁ λ₂) in its place; a motion that grows,
        or that nothing drives back, has frequency 0.
        """
        return np.array([frequency for frequency, _, _ in self._modes()])

    @property
    def damping_ratios(self) -> Array:
        """(n,) damping ratios, in the order of `frequencies`: 1 is critical; NaN at frequency 0.

        Example:
            >>> mech = sp.load("four_bar")  # without dampers
            >>> sp.linearize(mech, sp.equilibrium(mech).state).damping_ratios.round(9)
            array([0.])
        """
        return np.array([ratio for _, ratio, _ in self._modes()])

    def _modes(self) -> list[tuple[float, float, NDArray[np.complex128]]]:
        """Return (frequency, damping ratio, form) of each motion.

        A free motion takes a decaying eigenvalue along, if not a second zero, one that grows
        the decaying one of about its size; what then decays is paired, the fastest with the
        slowest.
        """
        (roots, forms), n = self._roots(), len(self.coordinates)
        least = NEUTRAL * np.abs(roots).max(initial=0.0)
        none = NO_DECAY * np.abs(roots).max(initial=0.0)
        modes = [(float(abs(x)) / (2.0 * np.pi),
                  float(-x.real / abs(x)) if abs(x.real) > none else 0.0, form)
                 for x, form in zip(roots, forms, strict=True)
                 if x.imag > least and x.real <= least]
        real = np.flatnonzero(np.abs(roots.imag) <= least)
        real = real[np.argsort(roots.real[real])]
        x = roots.real[real]
        decaying = real[x < -least].tolist()
        for growing in x[x > least]:
            if decaying:
                del decaying[int(np.argmin(np.abs(roots.real[decaying] + growing)))]
        zeros = int(np.count_nonzero(np.abs(x) <= least))
        del decaying[len(decaying) - max(0, 2 * self._neutral - zeros):]
        while len(decaying) > 1:
            fast, slow = decaying.pop(0), decaying.pop()
            size = np.sqrt(roots.real[fast] * roots.real[slow])
            modes.append((float(size) / (2.0 * np.pi), float(
                -0.5 * (roots.real[fast] + roots.real[slow]) / size), forms[slow]))
        modes += [(0.0, np.nan, np.zeros(n, complex))] * (n - len(modes))
        return sorted(modes, key=lambda mode: mode[0])

    def state_space(self) -> tuple[Array, Array, Array, Array]:
        """Return A (2n, 2n), B (2n, m), C (k, 2n), D (k, m) of x' = A x + B u, z = C x + D u.

        x are the changes of `coordinates`, then their rates; u of the inputs, z of the outputs, as
        `scipy.signal.StateSpace` and `control.ss` take them.

        Example:
            >>> mech = sp.load("four_bar")
            >>> found = sp.linearize(mech, sp.equilibrium(mech).state)
            >>> [x.shape for x in found.state_space()]  # A, B, C, D
            [(2, 2), (2, 1), (1, 2), (1, 1)]
        """
        n = len(self.coordinates)
        inverse = np.linalg.inv(self.mass)
        a = np.block([[np.zeros((n, n)), np.eye(n)],
                      [-inverse @ self.stiffness, -inverse @ self.damping]])
        b = np.vstack([np.zeros_like(self._b), inverse @ self._b])
        return a, b, self._c.copy(), np.zeros((len(self._c), b.shape[1]))

    def frequency_response(self, omega: Any) -> NDArray[np.complex128]:
        """Return the complex amplitudes (len(omega), outputs, inputs) per unit of each input.

        Args:
            omega: (len(omega),) angular frequencies [rad/s].

        Raises:
            ValueError: one is NaN or infinite.

        Example:
            >>> mech = sp.load("four_bar")
            >>> found = sp.linearize(mech, sp.equilibrium(mech).state)
            >>> found.frequency_response([0.0]).real.round(4)  # rad per N·m at rest
            array([[[0.7641]]])
        """
        omega = np.atleast_1d(as_array(omega, "omega"))
        if not is_finite(omega):
            raise ValueError("omega has a value that is NaN or infinite")
        n = len(self.coordinates)
        response = np.zeros((len(omega), len(self._c), self._b.shape[1]), complex)
        for out, w in zip(response, omega, strict=True):
            y = np.linalg.solve(
                self.stiffness - w * w * self.mass + 1j * w * self.damping, self._b)
            out[:] = self._c[:, :n] @ y + self._c[:, n:] @ (1j * w * y)
        return response

    def shape(self, k: int, amplitude: float | None = None) -> Motion:
        """Return one period of a vibration, loops closed, for `sp.show`.

        Args:
            k: its number in `frequencies`.
            amplitude: of the coordinate that moves most [rad, m]; default 0.1 rad, or a tenth of
                the characteristic length.

        Raises:
            ValueError: there is no such vibration, or its frequency is 0.

        Example:
            >>> mech = sp.load("four_bar")
            >>> found = sp.linearize(mech, sp.equilibrium(mech).state)
            >>> len(found.shape(0, amplitude=0.05))  # samples of one period
            61
        """
        frequencies = self.frequencies
        if not 0 <= whole_number(k, "k") < len(frequencies) or not frequencies[k] > 0.0:
            raise ValueError(f"there is no vibration {k}: those with a frequency are "
                             f"{np.flatnonzero(frequencies > 0.0).tolist()}")
        omega = 2.0 * np.pi * frequencies[k]
        mechanism = self._loads.mechanism
        entries = [mechanism.prescribed_coordinate(x) for x in self.coordinates]
        scale = mechanism.velocity_scale[[c.v for c in entries]]
        form = self._modes()[k][2] / scale
        form = form / form[np.argmax(np.abs(form))]
        size = AMPLITUDE if amplitude is None else positive_number(amplitude, "amplitude") / (
            scale[np.argmax(np.abs(form))])
        times = np.linspace(0.0, 1.0 / frequencies[k], SHAPE_SAMPLES)
        waves = (size * scale[:, None] * form[:, None]) * np.exp(1j * omega * times)
        at = self.state
        values: dict[str, Any] = {
            name: coordinate_value(mechanism, c, at.q) + wave.real
            for name, c, wave in zip(self.coordinates, entries, waves, strict=True)}
        for c in self._loads.held:
            values[c.name] = coordinate_value(mechanism, c, at.q) + (
                self._loads.speeds.get(c, 0.0) * times)
        return follow(mechanism, values, times, guess=at)

    def quantities(self, outputs: str | Iterable[str] | None = None) -> dict[str, Quantity]:
        """Return quantities by name: frequencies and damping ratios.

        Args:
            outputs: names of the wanted outputs; default all.

        Raises:
            UnknownNameError: there is none of a name.

        Example:
            >>> mech = sp.load("four_bar")
            >>> list(sp.linearize(mech, sp.equilibrium(mech).state).columns())
            ['frequency [Hz]', 'damping ratio [-]']
        """
        table = {"frequency": Quantity(self.frequencies, "Hz"),
                 "damping ratio": Quantity(self.damping_ratios, "-")}
        return chosen(table, outputs, "linearization")

    def __repr__(self) -> str:
        modes = ", ".join(f"{x:.6g}" for x in self.frequencies)
        return (f"Linearization({', '.join(self.coordinates)}: {modes} Hz)" if modes else
                "Linearization()")

    def __str__(self) -> str:
        pairs = zip(self.frequencies, self.damping_ratios, strict=True)
        lines = [f"small motions about {self.state} in {', '.join(self.coordinates)}"]
        for k, (frequency, ratio) in enumerate(pairs):
            lines.append(f"  {k}: {frequency:.9g} Hz, damping ratio {ratio:.6g}" if frequency else
                         f"  {k}: no vibration")
        return "\n".join(lines)


@checked
def linearize(
    mechanism: Mechanism,
    state: State,
    *,
    hold: str | Iterable[str] | None = None,
    speeds: Mapping[str, float] | None = None,
    inputs: Iterable[str] | None = None,
    outputs: Iterable[str] | None = None,
    efforts: Mapping[str, float] | None = None,
    external: Mapping[str, pin.Force] | None = None,
    laws: Mapping[str, Law] | None = None,
    coordinates: Iterable[str] | None = None,
) -> Linearization:
    """Linearize the motion about a pose at rest, loops closed.

    Args:
        mechanism: the mechanism.
        state: the pose at rest, from `equilibrium`, with the same `hold`, `speeds` and forces.
        hold: names of joints, coordinates or drivers that stand still; "base" for a free base.
        speeds: by driver or coordinate, a constant speed [rad/s, m/s].
        inputs: drivers, joints or coordinates whose efforts are inputs; default the drivers that
            move.
        outputs: coordinates, "NAME.rate" for their rates, "FRAME.position.x" for a coordinate of
            a frame's origin; default `coordinates`.
        efforts: by driver, joint or coordinate, constant [N·m, N].
        external: by link, frame or joint, the force on it at its origin, world axes, constant.
        laws: of springs, as for `equilibrium`.
        coordinates: the independent coordinates; default as for `equilibrium`.

    Returns:
        The Linearization.

    Raises:
        SpatialPinError: the mechanism is not at rest there; says how it would be accelerated.
        SingularError: the loops lose rank there, or a motion has no inertia.
        UnknownNameError: a name does not exist.

    Example:
        >>> mech = sp.load("four_bar")
        >>> found = sp.linearize(mech, sp.equilibrium(mech).state, outputs=["crank"])
        >>> a, b, c, d = found.state_space()
        >>> found.frequency_response([1.0]).shape  # (frequencies, outputs, inputs)
        (1, 1, 1)
    """
    state = of_mechanism(mechanism, state)
    at = _at_rest(mechanism, state, AppliedLoads(
        exact_mechanism(state), hold, speeds, efforts, external, laws))
    wished = None if coordinates is None else names_of(coordinates, "coordinates")
    at.loads.springs.refuse_undirected()
    verdict = stability_of(at)
    names, rates, motions = independent_motions(at, verdict.free, wished)
    reduced = at.reduced(motions, rates)
    _refuse_motion(at, names, reduced)
    mechanism = at.loads.mechanism
    moved = [name for name, c in driver_coordinates(mechanism).items() if at.loads.leaves(c)]
    given = moved if inputs is None else names_of(inputs, "inputs")
    wanted = names if outputs is None else names_of(outputs, "outputs")
    return Linearization(
        at, names, reduced,
        {name: motions @ _rate(at, name) for name in given},
        {name: _output(at, motions, name) for name in wanted}, len(verdict.neutral))


@checked
def compliance(
    mechanism: Mechanism,
    state: State,
    frame: str,
    *,
    hold: str | Iterable[str] | None = None,
    efforts: Mapping[str, float] | None = None,
    external: Mapping[str, pin.Force] | None = None,
    laws: Mapping[str, Law] | None = None,
) -> Array:
    """Return the compliance of a frame: its displacement by a small wrench, loops closed.

    Args:
        mechanism: the mechanism.
        state: the pose at rest, from `equilibrium`, with the same `hold` and forces.
        frame: link, frame or joint; joined bodies give way by their springs and weights.
        hold: names of joints, coordinates or drivers that stand still; "base" for a free base.
        efforts: as for `equilibrium`, as are external and laws.
        external: see `efforts`.
        laws: see `efforts`.

    Returns:
        (6, 6) translation [m], then rotation [rad], of the frame per force [N], then moment
        [N·m], at its origin, world axes. Symmetric where all loads have a potential.

    Raises:
        SpatialPinError: the mechanism is not at rest there, or nothing drives back a motion of the
            frame.
        SingularError: the loops lose rank there.
        UnknownNameError: a name does not exist.

    Example:
        >>> mech = sp.load("four_bar")
        >>> found = sp.compliance(mech, sp.equilibrium(mech).state, "coupler")
        >>> found.shape, bool(np.allclose(found, found.T, rtol=0, atol=1e-12))
        ((6, 6), True)
    """
    state = of_mechanism(mechanism, state)
    at = _at_rest(mechanism, state, AppliedLoads(
        exact_mechanism(state), hold, None, efforts, external, laws))
    mechanism = at.loads.mechanism
    verdict = stability_of(at)
    motions = verdict.free * mechanism.velocity_scale
    reduced = at.reduced(motions)
    _refuse_motion(at, mechanism.coordinates, reduced)
    moved = loops_at(mechanism, at.state.q).frame_jacobian(mechanism.frame_id(frame)) @ motions.T
    svd = decompose(reduced.stiffness, NEUTRAL)
    loose = svd.null_space @ moved.T
    if np.abs(loose).max(initial=0.0) > TOLERANCES.half_precision * np.abs(
            moved).max(initial=0.0):
        names = [mechanism.coordinates[v] for v in np.flatnonzero(
            np.abs(svd.null_space @ verdict.free).max(axis=0) > TOLERANCES.half_precision)]
        raise SpatialPinError(
            f"mechanism {mechanism.name!r}: nothing drives {frame!r} back where "
            f"{', '.join(names)} move: hold one of them, or give it a spring")
    flexibility: Array = moved @ np.array([svd.minimum_norm(row) for row in moved]).T
    return flexibility


def _at_rest(mechanism: Mechanism, state: State, loads: AppliedLoads) -> SmallMotions:
    """Return the equations about a state, which is at rest or moves at the given speeds."""
    at = SmallMotions(loads, state)
    apart = np.abs((state.v - at.state.v) / loads.mechanism.velocity_scale)
    if state.v.any() and apart.max() > AT_REST * np.abs(state.v).max():
        name = loads.mechanism.coordinates[int(np.argmax(apart))]
        raise SpatialPinError(
            f"mechanism {mechanism.name!r}: the state moves ({name!r}): give the speeds that are "
            "constant as speeds=, or a state at rest")
    return at


def _refuse_motion(at: SmallMotions, names: Sequence[str], reduced: ReducedEquations) -> None:
    """Refuse a pose that is not at rest.

    Raises:
        SpatialPinError: says how it would be accelerated.
    """
    if np.all(np.abs(reduced.load) <= AT_REST * reduced.sizes[0]):
        return
    mechanism = at.loads.mechanism
    a = decompose(reduced.mass).minimum_norm(reduced.load) @ reduced.motions
    k = int(np.argmax(np.abs(a / mechanism.velocity_scale)))
    raise SpatialPinError(
        f"mechanism {mechanism.name!r}: it is not at rest at {at.state}: "
        f"{mechanism.coordinates[k]} would be accelerated by {a[k]:.6g} "
        f"{mechanism.coordinate(mechanism.coordinates[k]).unit}/s²; `equilibrium` finds the pose "
        "at rest under the same forces")


def _rate(at: SmallMotions, name: str) -> Array:
    """Return the rate (nv,) of a coordinate by the joints' velocities."""
    mechanism = at.loads.mechanism
    return coordinate_gradient(mechanism, mechanism.prescribed_coordinate(name), at.state.q)


def _output(at: SmallMotions, motions: Array, name: str) -> tuple[Array, Array]:
    """Return the change (n,) of an output by coordinates, and by their rates."""
    mechanism, none = at.loads.mechanism, np.zeros(len(motions))
    frame, _, axis = name.rpartition(".position.")
    if frame and axis in XYZ:
        moved = loops_at(mechanism, at.state.q).frame_jacobian(mechanism.frame_id(frame))
        return motions @ moved[XYZ.index(axis)], none
    of, dot, kind = name.rpartition(".")
    if dot and kind == "rate" and name not in mechanism.coordinate_table:
        return none, motions @ _rate(at, of)
    return motions @ _rate(at, name), none
