"""Newton's method with a kept matrix, for one configuration after the other."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
from scipy.linalg.blas import dgemv

from spatial_pin.kinematics.branch import Branch
from spatial_pin.linalg import Array

CORRECTIONS = 6  # before a step is given up
CONTRACTION = 1e-2  # square of the factor by which corrections with a kept matrix must shrink
NEAR = 1e-9  # correction [rad, characteristic lengths] that is the last


class Chord:
    """Takes configurations near a branch onto it, all but closed.

    A correction is the product of a kept matrix with the closure rows, and its size the measure of
    closure. The matrix is made anew when corrections shrink slowly.

    Args:
        branch: its evaluation and its spins are used, its place is left alone.
        h: the step from one configuration to the next [rad or m].
    """

    def __init__(self, branch: Branch, h: float) -> None:
        self.branch, self.h = branch, h
        self.model, self.data = branch.model, branch.evaluation.data
        self.is_plain = branch.evaluation.is_plain
        if self.is_plain:
            self.buffers = branch.evaluation.product_buffers()
            self.flat_terms = self.buffers[-1].reshape(-1)
        self.last = (NEAR * min(1.0, branch.mechanism.characteristic_length)) ** 2
        self.is_stale = True

    def close(self, x: Array, value: float) -> Array | None:
        """Return the configuration near x at a driver value, None when corrections go astray."""
        model, branch = self.model, self.branch
        if model.nq != model.nv:
            x = pin.normalize(model, x)
        branch.hold(x, value)
        before = math.inf
        for attempt in range(CORRECTIONS):
            if self.is_stale and not self._renew(x):
                return None
            step = self._correction(x)
            if not attempt:
                for spin, column in zip(branch.spins, self.spin_chord, strict=True):
                    step += spin.error(self.h) * column
            size = step.dot(step)
            x = pin.integrate(model, x, step)
            branch.hold(x, value)
            if attempt and size > CONTRACTION * before:
                self.is_stale = True
            if size <= self.last:
                for spin in branch.spins:
                    spin.accept(self.h)
                return x
            before = size
        return None

    def _correction(self, x: Array) -> Array:
        if not self.is_plain:
            self.branch.evaluation.update(x)
            step: Array = np.dot(self.chord, self.branch.evaluation.residual)
            return step
        g, c_ab, ab, a, b, products = self.buffers
        pin.forwardKinematics(self.model, self.data, x)
        np.dot(c_ab, g, ab)
        np.multiply(a, b, products)
        step = dgemv(1.0, self.chord, self.flat_terms)
        if self.offset is not None:
            step += self.offset
        return step

    def _renew(self, x: Array) -> bool:
        system = self.branch.system
        self.branch.evaluation.update(x)
        if not system.factor():
            return False
        self.chord, self.spin_chord = system.chord()
        if self.is_plain:  # for the terms A * B of all product rows, which are three times as many
            constants = self.branch.evaluation.constraints.constants
            chord = np.zeros((len(self.chord), len(constants)))
            chord[:, : self.chord.shape[1]] = self.chord
            self.offset = -np.dot(chord, constants) if constants.any() else None
            self.chord = np.asfortranarray(np.repeat(chord, 3, axis=1))  # as BLAS likes it
        self.is_stale = False
        return True
