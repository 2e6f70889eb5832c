"""Assembly modes: all closed configurations for given driver values."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pinocchio as pin
from tqdm import tqdm

from spatial_pin.checks import mapping, positive_number
from spatial_pin.errors import SingularError
from spatial_pin.kinematics.assembly import nearest_turn
from spatial_pin.kinematics.constraints import Evaluation, constraints_of
from spatial_pin.kinematics.mobility import SINGULAR, finite_dimension, passive_freedoms_at
from spatial_pin.kinematics.newton import close, passive_freedoms
from spatial_pin.kinematics.rates import square_system
from spatial_pin.kinematics.state import State
from spatial_pin.linalg import Array, null_space
from spatial_pin.mechanism.configuration import finite_number
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.pairs import PAIRS
from spatial_pin.settings import Accuracy, accuracy_of

SAME = 1e-5  # largest difference of two placements of one mode [characteristic lengths, 1]
CLOSED = 1e-10
SLIDES = 1.5  # starts slide by so many characteristic lengths either way
ITERATIONS = 40


def assembly_modes(
    mechanism: Mechanism,
    drivers: Mapping[str, float] | None = None,
    *,
    patience: int = 200,
    most_starts: int = 100_000,
    seed: int = 0,
    accuracy: Accuracy | None = None,
    progress: bool = False,
) -> list[State]:
    """Find the closed configurations of a mechanism at given driver values, from random starts.

    Configurations that differ by passive freedoms or whole turns are one mode. Nothing proves
    that a finite number of starts has found all; raise `patience` for rare modes.

    Args:
        mechanism: the mechanism.
        drivers: values of all drivers or coordinates to hold [rad, m].
        patience: stop when so many starts in a row have found nothing new.
        most_starts: stop after so many starts in any case.
        seed: of the random starts; the same seed gives the same list.
        accuracy: tolerance to reach; default "engineering".
        progress: show a bar on stderr after a second, if that is a terminal.

    Returns:
        The modes sorted by their coordinates; `State.branch` is the sign of the determinant of
        the closed loops ("+" or "-"; "" where passive freedoms or missing drivers leave it open;
        "singular" for configurations that can move, at least instantaneously, with the drivers
        held: of those that really move only the first one found is listed, as they are many).

    Raises:
        UnknownNameError, ValueError: names that do not exist, values that are not finite.
    """
    positive_number(patience, "patience")
    positive_number(most_starts, "most_starts")
    search = _Search(mechanism, dict(mapping(drivers, "drivers")), accuracy_of(accuracy))
    rng = np.random.default_rng(seed)
    last = 0
    bar = tqdm(total=most_starts, desc=f"{mechanism.name}: modes", delay=1.0, leave=False,
               disable=None if progress else True)
    for k in range(most_starts):
        if search.attempt(search.random_start(rng)):
            last = k
            bar.set_postfix(found=len(search.found))
        bar.update()
        if k - last >= patience:
            break
    bar.close()
    return search.states()


class _Search:
    """Closed configurations found so far, one of each mode."""

    def __init__(
        self, mechanism: Mechanism, drivers: Mapping[str, float], accuracy: Accuracy
    ) -> None:
        self.mechanism, self.tolerance = mechanism, accuracy.tolerance
        self.evaluation = Evaluation(constraints_of(mechanism))
        self.held = {
            mechanism.driven_coordinate(name).name: finite_number(value, f"driver {name!r}")
            for name, value in drivers.items()
        }
        self.free = np.ones(mechanism.model.nv, dtype=bool)
        self.free[[mechanism.coordinate_table[name].v for name in self.held]] = False
        self.found: list[Array] = []
        self.signatures: list[Array] = []
        self.loose: frozenset[int] = frozenset()
        self.knows_loose = False
        self.has_continuum = False

    def _learn_loose(self, q: Array) -> None:
        """Note which bodies are passive at a regular mode; what came before is looked at anew."""
        passive = passive_freedoms_at(self.evaluation, q)
        self.loose = frozenset(self.mechanism.joint_id(joint) for joint, _ in passive)
        self.knows_loose = True
        self.signatures = []
        for earlier in self.found:
            self.evaluation.update(earlier)
            self.signatures.append(self.signature())
        self.evaluation.update(q)

    def _moves(self, q: Array) -> bool:
        """Whether a singular configuration can really move, passive freedoms apart."""
        n = self.evaluation.constraints.n_rows
        inner = null_space(self.evaluation.jacobian[:n, self.free], SINGULAR)
        tangents = np.zeros((len(inner), len(self.free)))
        tangents[:, self.free] = inner
        moving = finite_dimension(self.evaluation, q, tangents, self.free)
        return moving > len(self.loose)

    def _is_singular(self) -> bool:
        """Whether more than passive freedoms is left at the evaluation, the drivers held."""
        n = self.evaluation.constraints.n_rows
        tangents = null_space(self.evaluation.jacobian[:n, self.free], SINGULAR)
        if not len(tangents):
            return False
        whole = np.zeros((len(tangents), len(self.free)))
        whole[:, self.free] = tangents
        scale = self.mechanism.velocity_scale
        passive = sum(len(v) for _, v in passive_freedoms(self.evaluation, whole * scale))
        return passive < len(tangents)

    def random_start(self, rng: np.random.Generator) -> Array:
        """Return a configuration with angles and orientations uniform, slides within a range."""
        mechanism, model = self.mechanism, self.mechanism.model
        q = np.array(mechanism.neutral)
        for c in mechanism.coordinate_table.values():
            if c.q >= 0:
                reach = np.pi if c.unit == "rad" else SLIDES * mechanism.characteristic_length
                q[c.q] = rng.uniform(-reach, reach)
        for i, name in enumerate(mechanism.pairs, start=1):
            if not PAIRS[name].is_linear:
                at, n = model.idx_qs[i], model.nqs[i]
                quaternion = rng.normal(size=4)
                q[at + n - 4 : at + n] = quaternion / np.linalg.norm(quaternion)
                if n == 7:
                    reach = SLIDES * mechanism.characteristic_length
                    q[at : at + 3] = rng.uniform(-reach, reach, 3)
        for name, value in self.held.items():
            q[mechanism.coordinate_table[name].q] = value
        return q

    def attempt(self, start: Array) -> bool:
        """Close the loops from a start; return whether that found a new mode."""
        evaluation = self.evaluation
        q, error = close(evaluation, start, self.free, self.tolerance, ITERATIONS)
        if not error <= CLOSED or evaluation.mirrored():
            return False
        evaluation.update(q)
        singular = self._is_singular()
        if singular and self._moves(q):
            if self.has_continuum:
                return False
            self.has_continuum = True
        evaluation.update(q)
        if not singular and not self.knows_loose:
            self._learn_loose(q)
        signature = self.signature()
        if any(np.abs(signature - other).max() < SAME for other in self.signatures):
            return False
        self.signatures.append(signature)
        self.found.append(nearest_turn(self.mechanism, q, self.held, {}))
        return True

    def signature(self) -> Array:
        """Return what tells modes apart: the placements of all bodies at the evaluation.

        Of a body with a passive freedom only its place counts, and the places of the pairs on it
        that the freedom does not move.
        """
        evaluation, model = self.evaluation, self.mechanism.model
        placements = evaluation.placements / np.array([1.0, 1.0, 1.0, self._length])[:, None]
        bodies = [i for i in range(1, model.njoints) if i not in self.loose]
        parts = [placements[bodies].reshape(-1)]
        pin.updateFramePlacements(model, evaluation.data)
        frames = {f for c in self.mechanism.closures for f in (*c.frames, *c.between)}
        centres = [evaluation.data.oMf[self.mechanism.frame_id(f)].translation / self._length
                   for f in sorted(frames) if self._is_loose(f)]
        return np.concatenate([*parts, *centres])

    @property
    def _length(self) -> float:
        return self.mechanism.characteristic_length

    def _is_loose(self, frame: str) -> bool:
        return self.mechanism.frame_on_joint(frame)[0] in self.loose

    def states(self) -> list[State]:
        """Return the modes found as States, sorted."""
        states = []
        for q in self.found:
            self.evaluation.update(q)
            state = State(self.mechanism, q, closure_error=self.evaluation.closure_error,
                          angles=self.evaluation.angles)
            states.append(State(self.mechanism, q, closure_error=state.closure_error,
                                angles=state.angles, branch=self._branch(state)))
        return sorted(states, key=self._order)

    def _branch(self, state: State) -> str:
        self.evaluation.update(state.q)
        if self._is_singular():
            return "singular"
        try:
            with square_system(state, self.held) as system:
                return "" if len(system.passive) else {1: "+", -1: "-"}[system.pivots()[0]]
        except SingularError:
            return ""

    def _order(self, state: State) -> list[float]:
        fixed = [c for c in self.mechanism.coordinate_table.values()
                 if self.mechanism.joint_id(c.joint) not in self.loose]
        return [round(state.coordinate(c.name).value, 7) for c in fixed]
