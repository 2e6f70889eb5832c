"""One random mechanism: its known properties, and the results of its checks."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from fuzzing.files import write
from fuzzing.generate import rank
from fuzzing.judge import NQ, NV, Judge
from fuzzing.rotations import LD

PLAIN = 1e4  # condition up to which two double-precision solutions agree to 1e-10
GAP = (1e-12, 1e-5)  # singular values between these leave open whether a rank is lost


class Wrong(Exception):
    """An answer of the library does not agree."""


class Skip(Exception):
    """A check does not apply to this mechanism."""


def need(holds, text):
    """Raise Wrong unless it holds."""
    if not holds:
        raise Wrong(text)


def small(values, most, text):
    """Raise Wrong unless all values are numbers of at most this size."""
    values = np.asarray(values, dtype=float)
    worst = float(np.abs(values).max(initial=0)) if np.isfinite(values).all() else np.nan
    need(worst <= most, f"{text}: {worst:.3g} > {most:.1g}")


class Case:
    """A mechanism of `generate`, with its files and its judge.

    Attributes:
        at: configuration that the checks look at, the judge's numbering.
        doubtful: whether a refusal needs a second look: the judge found an answer.
        state, moving, dynamics, motion: what earlier checks had from the library.
    """

    def __init__(self, spec, folder):
        self.spec, self.folder = spec, folder
        self.judge = Judge(spec)
        self.q = self.at = np.array(spec["q"], dtype=LD)
        self.rng = np.random.default_rng(spec["seed"] + 10**6)
        self.size, self.scale = spec["size"], self.judge.scale.astype(float)
        self.path = write(spec, folder)
        self.driven = [self.judge.linear[d["joint"]] for d in spec["drivers"]]
        self.held = [d["joint"] for d in spec["drivers"]]
        self.names = [d["name"] for d in spec["drivers"]]
        self.doubtful = False
        self.state = self.moving = self.dynamics = self.motion = None

    # ------------------------------------------------------------ rank

    @cached_property
    def jacobian(self):
        """Derivative (rows, nv) of the residuals at the known configuration."""
        return self.judge.jacobian(self.q)

    @cached_property
    def spectrum(self):
        """Its singular values."""
        return np.linalg.svd(self.jacobian, compute_uv=False) if self.jacobian.size else np.ones(0)

    @cached_property
    def rank(self):
        """Number of independent equations."""
        return rank(self.jacobian)

    @property
    def dof(self):
        """Number of instantaneous freedoms."""
        return self.judge.nv - self.rank

    @cached_property
    def condition(self):
        """Condition of the independent equations."""
        if not self.rank:
            return 1.0
        return float(max(self.spectrum[0], 1e-2) / self.spectrum[self.rank - 1])

    @cached_property
    def is_plain(self):
        """Whether nobody can doubt the rank."""
        if not self.spectrum.size:
            return True
        parts = self.spectrum / max(self.spectrum[0], 1e-2)
        return not ((parts > GAP[0]) & (parts < GAP[1])).any()

    @cached_property
    def null_space(self):
        """Freedoms (dof, nv), scaled velocities."""
        if not self.jacobian.size:
            return np.eye(self.judge.nv)
        return np.linalg.svd(self.jacobian)[2][self.rank :]

    @cached_property
    def bordered(self):
        """The residuals' derivatives, and below them a row for every driver."""
        rows = np.zeros((len(self.driven), self.judge.nv))
        for k, (_, iv) in enumerate(self.driven):
            rows[k, iv] = 1.0
        return np.vstack([self.jacobian, rows])

    @cached_property
    def driven_condition(self):
        """Condition of loops and drivers together."""
        if not self.bordered.size:
            return 1.0
        s = np.linalg.svd(self.bordered, compute_uv=False)
        return float(s[0] / max(s[min(self.judge.nv, self.rank + len(self.driven)) - 1], 1e-300))

    @property
    def is_driven(self):
        """Whether the drivers determine the motion, plainly."""
        return (0 < self.dof == len(self.driven) and self.is_plain
                and self.driven_condition < 10 * PLAIN)

    @property
    def has_answer(self):
        """Whether drivers determine the motion, here and nearby: no reason to refuse it."""
        return self.is_driven and self.keeps_rank

    def only_if_driven(self):
        """Raise Skip unless the drivers determine the motion."""
        if not self.is_driven:
            raise Skip("the drivers do not determine the motion")

    @cached_property
    def keeps_rank(self):
        """Whether nearby closed configurations have the same rank: freedoms are finite then."""
        if self.rank == len(self.jacobian):
            return True
        for _ in range(2):
            step = self.rng.normal(size=self.dof) @ self.null_space * 0.05 * self.scale
            q, open_by = self.judge.solve(self.judge.integrate(self.q, step)[0])
            if open_by > 1e-13 or rank(self.judge.jacobian(q)) != self.rank:
                return False
        return True

    # ------------------------------------------------------------ numbering

    def link(self, mechanism):
        """Learn where Pinocchio has the judge's numbers."""
        self.mechanism, model = mechanism, mechanism.model
        q_at, v_at = [], []
        for joint in self.judge.joints:
            if joint["kind"] == "fixed":
                continue
            k = model.getJointId(joint["name"])
            need(k < model.njoints, f"joint {joint['name']} is missing")
            need((model.nqs[k], model.nvs[k]) == (NQ[joint["kind"]], NV[joint["kind"]]),
                 f"size of joint {joint['name']}")
            q_at += range(model.idx_qs[k], model.idx_qs[k] + model.nqs[k])
            v_at += range(model.idx_vs[k], model.idx_vs[k] + model.nvs[k])
        self.q_at, self.v_at = np.array(q_at, dtype=int), np.array(v_at, dtype=int)

    def own_q(self, q):
        """The library's q, numbered and as exact as the judge's."""
        return np.asarray(q, dtype=LD)[..., self.q_at]

    def own_v(self, v):
        """The library's velocities, or vectors like them."""
        return np.asarray(v, dtype=LD)[..., self.v_at]

    def their_q(self, q):
        """The judge's q in the library's numbering."""
        out = np.zeros(len(self.q_at))
        out[self.q_at] = np.asarray(q, dtype=float)
        return out

    def their_v(self, v):
        """The judge's velocities in the library's numbering."""
        out = np.zeros(len(self.v_at))
        out[self.v_at] = np.asarray(v, dtype=float)
        return out

    # ------------------------------------------------------------ comparisons

    def need_closed(self, q, what, most=1e-10):
        """Raise Wrong unless the library's configurations q (..., nq) close all loops."""
        need(np.isfinite(np.asarray(q, dtype=float)).all(), f"{what}: NaN")
        small(self.judge.open_by(np.atleast_2d(self.own_q(q))), most, f"{what}: loops open")

    def need_rates(self, q, rates, what, most):
        """Raise Wrong unless rates (velocity, acceleration, jerk) keep the loops closed.

        Args:
            q: the library's configuration.
            rates: one to three of them, the judge's numbering.
            what: of what, for the message.
            most: largest residual of each, by the size of the rates.
        """
        derivatives = self.judge.derivatives(self.own_q(q), *rates)
        for k, (residual, limit) in enumerate(zip(derivatives, most, strict=False)):
            small(residual / self.sizes(rates)[k], limit,
                  f"{what}: derivative {k + 1} of the loops")

    def sizes(self, rates):
        """Sizes of a motion's derivatives, none smaller than what the lower ones make."""
        sizes = [max(float(np.abs(x / self.scale).max(initial=0)), 1e-3) for x in rates]
        for k in range(1, len(sizes)):
            sizes[k] = max([sizes[k], sizes[0] ** (k + 1),
                            *([sizes[1] * sizes[0]] if k == 2 else [])])
        return sizes

    def driver_values(self):
        """Driver values at the known configuration, by name."""
        return {name: float(self.q[iq]) for name, (iq, _) in zip(self.names, self.driven,
                                                                 strict=True)}

    def random_rates(self):
        """Random driver rates, by name."""
        return {name: float(self.rng.normal() * self.scale[iv])
                for name, (_, iv) in zip(self.names, self.driven, strict=True)}
