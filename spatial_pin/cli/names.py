"""Names of what is to be drawn and written, checked before any work is done for them."""

from __future__ import annotations

import argparse
import contextlib

import numpy as np

import spatial_pin as sp
from spatial_pin.assembly.holding import SPRINGS, is_base
from spatial_pin.errors import UnknownNameError
from spatial_pin.proximity.clearance import standing


def check_names(options: argparse.Namespace, mechanism: sp.Mechanism) -> None:
    """Refuse outputs, traces, arrows and what is to stand still that do not exist.

    Raises:
        UnknownNameError: says what there is instead.
    """
    check_held(options, mechanism)
    if not any(getattr(options, key, ()) for key in ("output", "trace", "arrow")):
        return
    motion = standing(sp.State(mechanism, np.array(mechanism.neutral), closure_error=np.nan))
    for name in getattr(options, "output", ()):
        _ask(motion, name)
    for name in getattr(options, "trace", ()):
        mechanism.frame_id(name.removesuffix(".com"))
    for name in getattr(options, "arrow", ()):
        _check_arrow(motion, name)


def check_held(options: argparse.Namespace, mechanism: sp.Mechanism) -> None:
    """Refuse names of what is to stand still that do not exist."""
    for name in getattr(options, "hold", ()):
        if name not in (*mechanism.model.names, SPRINGS) and not is_base(mechanism, name):
            mechanism.coordinate(name)


def _ask(motion: sp.Motion, output: str) -> None:
    """Ask a motion for an output: one that cannot be had of this motion may be had of another."""
    try:
        motion.output(output)
    except UnknownNameError:
        raise
    except (sp.SpatialPinError, ValueError):
        return


def _check_arrow(motion: sp.Motion, arrow: str) -> None:
    from spatial_pin.view.scene.layers.arrows import LOADS, rates  # imported on use: meshcat

    mechanism = motion.mechanism
    pair, _, kind = arrow.rpartition(".")
    if kind in LOADS:
        pairs = [*list(mechanism.model.names)[1:], *(c.name for c in mechanism.closures)]
        if pair not in pairs:
            raise UnknownNameError("pair", pair, pairs, f"mechanism {mechanism.name!r}: ")
        return
    with contextlib.suppress(ValueError):
        rates(motion, arrow)
