"""Writing a mechanism for MuJoCo, closed as it is here."""

from __future__ import annotations

from pathlib import Path

from spatial_pin.assembly.assemble import assemble
from spatial_pin.assembly.state import State
from spatial_pin.errors import AssemblyError, warn
from spatial_pin.mechanism.coordinates import require_mechanism
from spatial_pin.mechanism.mechanism import Mechanism


def export_mjcf(mechanism: Mechanism, path: str | Path, state: State | None = None) -> Path:
    """Write a mechanism as MJCF, the format of MuJoCo.

    Balls become `connect`, welds `weld`, hinges two `connect` on their axis, couplings `joint`
    equalities or, of several joints, fixed tendons; distances and ropes tendons whose length is
    held; a closure that is another joint becomes a
    body that moves so on the first frame and is welded to the second. Drivers become motors,
    springs stiffness or tendons. Coordinates are the mechanism's own, and so are names of links.
    MuJoCo itself is not needed.

    Args:
        mechanism: the mechanism.
        path: the file; its name ends in .xml or .mjcf.
        state: where the key "home" is; default the assembled guess.

    Returns:
        The file.

    Raises:
        ClosureTypeError: MuJoCo has no equality that is exactly one of its closures.
        SpatialPinError: something else has no counterpart, or the file cannot be written.

    Example:
        >>> sp.export_mjcf(sp.load("four_bar"), "four_bar.xml").name
        'four_bar.xml'
    """
    from spatial_pin.formats.mjcf.writer import write_mjcf  # when something is exported

    require_mechanism(mechanism)
    if state is not None:
        return write_mjcf(mechanism, path, state.q)
    try:
        q = assemble(mechanism, {}).q
    except AssemblyError as error:
        warn(f"the key \"home\" is the guess, whose loops are open: {error}")
        q = None
    return write_mjcf(mechanism, path, q)
