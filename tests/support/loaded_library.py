"""Mechanisms of the library, read once a process: reading one takes longer than most tests."""

import pickle
from functools import cache

import numpy as np

import spatial_pin as sp


@cache
def _pickled(name: str, dimensions: tuple[tuple[str, float], ...]) -> bytes:
    assert name in sp.list_mechanisms(), "other files may change between two tests"
    return pickle.dumps(sp.load(name, **dict(dimensions)))


def library(name: str, **dimensions: float) -> sp.Mechanism:
    """Return what `sp.load` does: a mechanism of its own, of which nothing was computed before."""
    return pickle.loads(_pickled(name, tuple(dimensions.items())))


def thrown(name: str, seed: int) -> tuple[sp.Mechanism, sp.State]:
    """Return a mechanism as its file has it, and a state with random speeds of its drivers."""
    mechanism = sp.load(name)
    speeds = np.random.default_rng(seed).uniform(-4.0, 4.0, len(mechanism.drivers))
    return mechanism, sp.solve_rates(
        mechanism, sp.assemble(mechanism), dict(zip(mechanism.drivers, speeds, strict=True)))
