"""Spatial mechanisms with closed loops on Pinocchio.

`load` makes a Mechanism; `assemble` closes its loops and returns a State; `sweep`, `follow`,
`reach_path` and `simulate` move it and return a Motion; the other functions answer questions about
these. All numbers are in SI units and radians; arrays of a motion have one row per sample. Errors
derive from `SpatialPinError`.

Example:
    >>> mech = sp.load("rssr")
    >>> sp.mobility(mech).dof  # the crank turns, and the coupler spins about its own line
    2
    >>> motion = sp.sweep(mech, "crank", np.linspace(0.0, 2.0 * np.pi, 361), speed=25.0)
    >>> motion.coordinate("rocker_pin").value[[0, 180]].round(4)  # [rad]
    array([1.2329, 2.0234])
    >>> loads = sp.kinetostatics(mech, motion)
    >>> loads.efforts["crank"].shape  # (N,) [N·m]
    (361,)
"""

import sys
from typing import Any

import lazy_loader

from spatial_pin.mechanism import closures, curves, laws

__version__ = "0.2.0"

# Public names are imported on first use: a mechanism is loaded with less than half of the modules.
_public, _, __all__ = lazy_loader.attach_stub(__name__, __file__)

# so that `from spatial_pin.closures import spherical` works as `sp.closures.spherical` does
sys.modules.update({f"{__name__}.closures": closures, f"{__name__}.curves": curves,
                    f"{__name__}.laws": laws})

# commands of `spatial-pin` that are called otherwise here
_COMMANDS = {
    "statics": "sp.inverse_dynamics, over a motion sp.kinetostatics", "modes": "sp.assembly_modes",
    "check": "sp.load", "info": "sp.mobility", "export": "Mechanism.save",
}


def __getattr__(name: str) -> Any:
    if name not in __all__:
        verb = _COMMANDS.get(name)
        hint = f"; what the command {name!r} does is {verb}" if verb else ""
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}{hint}")
    value = _public(name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
