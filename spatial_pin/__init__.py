"""Spatial mechanisms with closed loops on Pinocchio."""

from typing import Any

from spatial_pin.accuracy.reduce import Reduced, reduce
from spatial_pin.accuracy.tradeoff import Tradeoff, tradeoff
from spatial_pin.dynamics.derivatives import dynamics_derivatives
from spatial_pin.dynamics.forward import forward_dynamics
from spatial_pin.dynamics.inverse import inverse_dynamics
from spatial_pin.dynamics.kinetostatics import kinetostatics
from spatial_pin.dynamics.simulate import Simulation, simulate
from spatial_pin.errors import (
    AssemblyError,
    ClosureTypeError,
    LimitError,
    MechanismFileError,
    SingularError,
    SpatialPinError,
    SpatialPinWarning,
)
from spatial_pin.kinematics.assembly import assemble
from spatial_pin.kinematics.dead_centres import dead_centres
from spatial_pin.kinematics.grashof import grashof
from spatial_pin.kinematics.jacobians import closure_jacobian, influence, jacobian, jacobian_rate
from spatial_pin.kinematics.jerks import solve_jerks
from spatial_pin.kinematics.limits import limits, trace
from spatial_pin.kinematics.mobility import Mobility, mobility
from spatial_pin.kinematics.modes import assembly_modes
from spatial_pin.kinematics.motion import FrameMotion, Motion
from spatial_pin.kinematics.rates import solve_rates
from spatial_pin.kinematics.sensitivity import sensitivity
from spatial_pin.kinematics.state import State
from spatial_pin.kinematics.sweep import sweep
from spatial_pin.kinematics.tolerance import tolerance
from spatial_pin.kinematics.transmission import transmission
from spatial_pin.mechanism import laws
from spatial_pin.mechanism.files import list_mechanisms, load
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.settings import Accuracy

__version__ = "0.1.0"

# they load meshcat and matplotlib
_SEEN_ON_USE = ("Look", "export_html", "live", "movie", "plot", "report", "screenshot", "show")

__all__ = [
    "Accuracy",
    "AssemblyError",
    "ClosureTypeError",
    "FrameMotion",
    "LimitError",
    "Look",
    "Mechanism",
    "MechanismFileError",
    "Mobility",
    "Motion",
    "Reduced",
    "Simulation",
    "SingularError",
    "SpatialPinError",
    "SpatialPinWarning",
    "State",
    "Tradeoff",
    "assemble",
    "assembly_modes",
    "closure_jacobian",
    "dead_centres",
    "dynamics_derivatives",
    "export_html",
    "forward_dynamics",
    "grashof",
    "influence",
    "inverse_dynamics",
    "jacobian",
    "jacobian_rate",
    "kinetostatics",
    "laws",
    "limits",
    "list_mechanisms",
    "live",
    "load",
    "mobility",
    "movie",
    "plot",
    "reduce",
    "report",
    "screenshot",
    "sensitivity",
    "show",
    "simulate",
    "solve_jerks",
    "solve_rates",
    "sweep",
    "tolerance",
    "trace",
    "tradeoff",
    "transmission",
]


def __getattr__(name: str) -> Any:
    if name in _SEEN_ON_USE:
        from spatial_pin import view

        return getattr(view, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
