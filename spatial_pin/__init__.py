"""Spatial mechanisms with closed loops on Pinocchio."""

from importlib import import_module
from typing import Any

from spatial_pin.accuracy.reference import Errors
from spatial_pin.accuracy.tradeoff import Measured, Tradeoff, tradeoff
from spatial_pin.accuracy.tradeoff_view import plot as _plot_of_tradeoff
from spatial_pin.accuracy.tradeoff_view import table as _table_of_tradeoff
from spatial_pin.assembly.assemble import assemble
from spatial_pin.assembly.export_mjcf import export_mjcf
from spatial_pin.assembly.state import Gap, PointRates, RelativeMotion, State
from spatial_pin.dimensions.sensitivity import Sensitivity, sensitivity
from spatial_pin.dimensions.tolerance import Tolerance, tolerance
from spatial_pin.dynamics.derivatives.derivatives import Derivatives, dynamics_derivatives
from spatial_pin.dynamics.derivatives.reactions import Linear
from spatial_pin.dynamics.forward import Dynamics, forward_dynamics
from spatial_pin.dynamics.inverse import Efforts, inverse_dynamics
from spatial_pin.dynamics.kinetostatics import Kinetostatics, kinetostatics
from spatial_pin.dynamics.simulation.result import Projection
from spatial_pin.dynamics.simulation.simulate import Simulation, simulate
from spatial_pin.errors import (
    AssemblyError,
    ClosureTypeError,
    ContinuumError,
    EnergyError,
    LimitError,
    MechanismFileError,
    SingularError,
    SpatialPinError,
    SpatialPinWarning,
    StepLimitError,
    UnknownNameError,
)
from spatial_pin.formats.export import save as _save
from spatial_pin.formats.files import list_mechanisms, load
from spatial_pin.formats.pinocchio_model.from_model import mechanism_of as _from_model
from spatial_pin.mechanism import closures, laws
from spatial_pin.mechanism.coordinates import CoordinateRates
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.named_frames import Frame
from spatial_pin.mechanism.parts import Closure, Coordinate, Driver, Passive, Spring
from spatial_pin.methods import offer as _offer
from spatial_pin.mobility.grashof import Grashof, grashof
from spatial_pin.mobility.idle_freedoms import PassiveFreedom
from spatial_pin.mobility.loops import Loop
from spatial_pin.mobility.mobility import Mobility, mobility
from spatial_pin.mobility.mode_list import AssemblyModes, Continuum
from spatial_pin.mobility.modes import assembly_modes
from spatial_pin.motion import outputs as _outputs
from spatial_pin.motion.dead_centres import dead_centres
from spatial_pin.motion.joint_limits import JointLimit, Passing
from spatial_pin.motion.limits import Range, limits
from spatial_pin.motion.motion import Event, FrameMotion, Motion, Output
from spatial_pin.motion.summary import summary as _summary
from spatial_pin.motion.sweep import sweep
from spatial_pin.motion.trace import trace
from spatial_pin.rates.jacobians import (
    Influence,
    closure_jacobian,
    influence,
    jacobian,
    jacobian_rate,
)
from spatial_pin.rates.jerks import Jerks, solve_jerks
from spatial_pin.rates.rates import rate_error as _rate_error
from spatial_pin.rates.rates import solve_rates
from spatial_pin.rates.transmission import Transmission, transmission
from spatial_pin.reduction.differences import Verification
from spatial_pin.reduction.reduce import Reduced, reduce
from spatial_pin.reduction.report import Omission
from spatial_pin.reduction.verification import verification as _verification
from spatial_pin.settings import Accuracy

__version__ = "0.1.0"

_offer({
    "Mechanism.from_model": _from_model,
    "Mechanism.save": _save,
    "Motion.bodies": _outputs.bodies,
    "Motion.com": _outputs.com,
    "Motion.frame": _outputs.frame,
    "Motion.output": _outputs.output,
    "Motion.rate_error": _rate_error,
    "Motion.summary": _summary,
    "Reduced.verify": _verification,
    "Tradeoff.plot": _plot_of_tradeoff,
    "Tradeoff.table": _table_of_tradeoff,
})

# they load meshcat and matplotlib
_SEEN_ON_USE = dict.fromkeys(("Look", "Viewer", "export_html", "live", "movie", "plot", "report",
                              "screenshot", "show"), "spatial_pin.view")
_SEEN_ON_USE["Vectors"] = "spatial_pin.view.scene.layers.arrows"

__all__ = [
    "Accuracy",
    "AssemblyError",
    "AssemblyModes",
    "Closure",
    "ClosureTypeError",
    "Continuum",
    "ContinuumError",
    "Coordinate",
    "CoordinateRates",
    "Derivatives",
    "Driver",
    "Dynamics",
    "Efforts",
    "EnergyError",
    "Errors",
    "Event",
    "Frame",
    "FrameMotion",
    "Gap",
    "Grashof",
    "Influence",
    "Jerks",
    "JointLimit",
    "Kinetostatics",
    "LimitError",
    "Linear",
    "Look",
    "Loop",
    "Measured",
    "Mechanism",
    "MechanismFileError",
    "Mobility",
    "Motion",
    "Omission",
    "Output",
    "Passing",
    "Passive",
    "PassiveFreedom",
    "PointRates",
    "Projection",
    "Range",
    "Reduced",
    "RelativeMotion",
    "Sensitivity",
    "Simulation",
    "SingularError",
    "SpatialPinError",
    "SpatialPinWarning",
    "Spring",
    "State",
    "StepLimitError",
    "Tolerance",
    "Tradeoff",
    "Transmission",
    "UnknownNameError",
    "Vectors",
    "Verification",
    "Viewer",
    "assemble",
    "assembly_modes",
    "closure_jacobian",
    "closures",
    "dead_centres",
    "dynamics_derivatives",
    "export_html",
    "export_mjcf",
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
        return getattr(import_module(_SEEN_ON_USE[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
