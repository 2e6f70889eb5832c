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
from importlib import import_module
from typing import TYPE_CHECKING, Any

from spatial_pin.errors import (
    AssemblyError,
    ClosureTypeError,
    ContinuumError,
    EnergyError,
    Interrupted,
    LimitError,
    MechanismFileError,
    ReachError,
    SingularError,
    SpatialPinError,
    SpatialPinWarning,
    StepLimitError,
    UnknownNameError,
)
from spatial_pin.formats.files import list_mechanisms, load
from spatial_pin.mechanism import closures, laws
from spatial_pin.mechanism.coordinates import CoordinateRates
from spatial_pin.mechanism.mechanism import Mechanism
from spatial_pin.mechanism.parts import Closure, Coordinate, Driver, Frame, Passive, Spring
from spatial_pin.mobility.mobility import Mobility, mobility
from spatial_pin.settings import Accuracy

if TYPE_CHECKING:
    from spatial_pin._support.columns import Quantity
    from spatial_pin.accuracy.reference import Errors
    from spatial_pin.accuracy.tradeoff import Measured, Tradeoff, tradeoff
    from spatial_pin.assembly.assemble import assemble
    from spatial_pin.assembly.export_mjcf import export_mjcf
    from spatial_pin.assembly.state import Gap, PointRates, RelativeMotion, State
    from spatial_pin.dimensions.calibrate import Calibration, calibrate
    from spatial_pin.dimensions.sensitivity import Sensitivity, sensitivity
    from spatial_pin.dimensions.tolerance import Tolerance, tolerance
    from spatial_pin.dynamics.derivatives.derivatives import Derivatives, dynamics_derivatives
    from spatial_pin.dynamics.derivatives.reaction_derivatives import Linear
    from spatial_pin.dynamics.forward import Dynamics, forward_dynamics
    from spatial_pin.dynamics.inverse import Efforts, inverse_dynamics
    from spatial_pin.dynamics.kinetostatics import Kinetostatics, kinetostatics
    from spatial_pin.dynamics.simulation.result import Projection
    from spatial_pin.dynamics.simulation.simulate import Simulation, simulate
    from spatial_pin.inverse_kinematics import targets
    from spatial_pin.inverse_kinematics.reach import reach
    from spatial_pin.inverse_kinematics.reach_path import reach_path
    from spatial_pin.inverse_kinematics.targets import Target
    from spatial_pin.mobility.assembly_modes import assembly_modes
    from spatial_pin.mobility.grashof import Grashof, grashof
    from spatial_pin.mobility.idle_freedoms import PassiveFreedom
    from spatial_pin.mobility.independent_loops import Loop
    from spatial_pin.mobility.mode_list import AssemblyModes, Continuum
    from spatial_pin.motion.dead_centres import dead_centres
    from spatial_pin.motion.follow import follow
    from spatial_pin.motion.joint_limit_events import JointLimit, Passing
    from spatial_pin.motion.limits import Bound, Range, limits
    from spatial_pin.motion.motion import Event, FrameMotion, Motion, Output
    from spatial_pin.motion.rated_limits import BeyondLimit
    from spatial_pin.motion.sweep import sweep
    from spatial_pin.motion.trace import trace
    from spatial_pin.proximity.clearance import Clearance, Contact, PairClearance, clearance
    from spatial_pin.rates.jacobians import (
        Influence,
        closure_jacobian,
        influence,
        jacobian,
        jacobian_rate,
    )
    from spatial_pin.rates.jerks import Jerks, solve_jerks
    from spatial_pin.rates.rates import solve_rates
    from spatial_pin.rates.transmission import Transmission, transmission
    from spatial_pin.reduction.losses import Difference, Omission, Verification
    from spatial_pin.reduction.reduce import Reduced, reduce
    from spatial_pin.synthesis import goals
    from spatial_pin.synthesis.defects import Defect
    from spatial_pin.synthesis.design import design
    from spatial_pin.synthesis.precision import Goal
    from spatial_pin.synthesis.ranked_designs import Design, Designs, GoalError, Met
    from spatial_pin.view import (
        Look,
        Viewer,
        export_html,
        live,
        movie,
        plot,
        report,
        screenshot,
        show,
    )
    from spatial_pin.view.scene.layers.arrows import Vectors
    from spatial_pin.workspace_map.workspace import workspace
    from spatial_pin.workspace_map.workspace_result import Borders, Curve, Workspace

__version__ = "0.2.0"

# imported when they are first asked for: loading a mechanism needs less than half of the modules
# (`mobility` has the name of its package and would be taken for it)
_ON_USE = {
    "accuracy.reference": "Errors",
    "accuracy.tradeoff": "Measured Tradeoff tradeoff",
    "assembly.assemble": "assemble",
    "assembly.export_mjcf": "export_mjcf",
    "assembly.state": "Gap PointRates RelativeMotion State",
    "_support.columns": "Quantity",
    "dimensions.calibrate": "Calibration calibrate",
    "dimensions.sensitivity": "Sensitivity sensitivity",
    "dimensions.tolerance": "Tolerance tolerance",
    "dynamics.derivatives.derivatives": "Derivatives dynamics_derivatives",
    "dynamics.derivatives.reaction_derivatives": "Linear",
    "dynamics.forward": "Dynamics forward_dynamics",
    "dynamics.inverse": "Efforts inverse_dynamics",
    "dynamics.kinetostatics": "Kinetostatics kinetostatics",
    "dynamics.simulation.result": "Projection",
    "dynamics.simulation.simulate": "Simulation simulate",
    "inverse_kinematics": "targets",
    "inverse_kinematics.reach": "reach",
    "inverse_kinematics.reach_path": "reach_path",
    "inverse_kinematics.targets": "Target",
    "mobility.grashof": "Grashof grashof",
    "mobility.idle_freedoms": "PassiveFreedom",
    "mobility.independent_loops": "Loop",
    "mobility.mode_list": "AssemblyModes Continuum",
    "mobility.assembly_modes": "assembly_modes",
    "motion.dead_centres": "dead_centres",
    "motion.follow": "follow",
    "motion.joint_limit_events": "JointLimit Passing",
    "motion.limits": "Bound Range limits",
    "motion.motion": "Event FrameMotion Motion Output",
    "motion.rated_limits": "BeyondLimit",
    "motion.sweep": "sweep",
    "motion.trace": "trace",
    "proximity.clearance": "Clearance Contact PairClearance clearance",
    "rates.jacobians": "Influence closure_jacobian influence jacobian jacobian_rate",
    "rates.jerks": "Jerks solve_jerks",
    "rates.rates": "solve_rates",
    "rates.transmission": "Transmission transmission",
    "reduction.losses": "Difference Omission Verification",
    "reduction.reduce": "Reduced reduce",
    "synthesis": "goals",
    "synthesis.defects": "Defect",
    "synthesis.design": "design",
    "synthesis.precision": "Goal",
    "synthesis.ranked_designs": "Design Designs GoalError Met",
    "view": "Look Viewer export_html live movie plot report screenshot show",
    "view.scene.layers.arrows": "Vectors",
    "workspace_map.workspace_result": "Borders Curve Workspace",
    "workspace_map.workspace": "workspace",
}
_MODULES = {name: module for module, names in _ON_USE.items() for name in names.split()}

__all__ = [
    "Accuracy",
    "AssemblyError",
    "AssemblyModes",
    "BeyondLimit",
    "Borders",
    "Bound",
    "Calibration",
    "Clearance",
    "Closure",
    "ClosureTypeError",
    "Contact",
    "Continuum",
    "ContinuumError",
    "Coordinate",
    "CoordinateRates",
    "Curve",
    "Defect",
    "Derivatives",
    "Design",
    "Designs",
    "Difference",
    "Driver",
    "Dynamics",
    "Efforts",
    "EnergyError",
    "Errors",
    "Event",
    "Frame",
    "FrameMotion",
    "Gap",
    "Goal",
    "GoalError",
    "Grashof",
    "Influence",
    "Interrupted",
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
    "Met",
    "Mobility",
    "Motion",
    "Omission",
    "Output",
    "PairClearance",
    "Passing",
    "Passive",
    "PassiveFreedom",
    "PointRates",
    "Projection",
    "Quantity",
    "Range",
    "ReachError",
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
    "Target",
    "Tolerance",
    "Tradeoff",
    "Transmission",
    "UnknownNameError",
    "Vectors",
    "Verification",
    "Viewer",
    "Workspace",
    "assemble",
    "assembly_modes",
    "calibrate",
    "clearance",
    "closure_jacobian",
    "closures",
    "dead_centres",
    "design",
    "dynamics_derivatives",
    "export_html",
    "export_mjcf",
    "follow",
    "forward_dynamics",
    "goals",
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
    "reach",
    "reach_path",
    "reduce",
    "report",
    "screenshot",
    "sensitivity",
    "show",
    "simulate",
    "solve_jerks",
    "solve_rates",
    "sweep",
    "targets",
    "tolerance",
    "trace",
    "tradeoff",
    "transmission",
    "workspace",
]


# so that `from spatial_pin.closures import spherical` works as `sp.closures.spherical` does
sys.modules.update({f"{__name__}.closures": closures, f"{__name__}.laws": laws})

# commands of `spatial-pin` that are called otherwise here
_COMMANDS = {
    "statics": "sp.inverse_dynamics, over a motion sp.kinetostatics", "modes": "sp.assembly_modes",
    "check": "sp.load", "info": "sp.mobility", "export": "Mechanism.save",
}

if not TYPE_CHECKING:  # type checkers take the imports above, so that a wrong name is one

    def __getattr__(name: str) -> Any:
        if name not in _MODULES:
            verb = _COMMANDS.get(name)
            hint = f"; what the command {name!r} does is {verb}" if verb else ""
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}{hint}")
        found = getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
        globals()[name] = found
        return found


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
