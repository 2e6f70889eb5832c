"""The public names and where they are made, for type checkers and for loading on first use."""

from ._support.columns import Quantity as Quantity
from .accuracy.reference import Errors as Errors
from .accuracy.tradeoff import Measured as Measured, Tradeoff as Tradeoff, tradeoff as tradeoff
from .assembly.assemble import assemble as assemble
from .assembly.export_mjcf import export_mjcf as export_mjcf
from .assembly.state import (
    FrameMotion as FrameMotion,
    Gap as Gap,
    PointRates as PointRates,
    RelativeMotion as RelativeMotion,
    State as State,
)
from .dimensions.calibrate import Calibration as Calibration, calibrate as calibrate
from .dimensions.sensitivity import Sensitivity as Sensitivity, sensitivity as sensitivity
from .dimensions.tolerance import Tolerance as Tolerance, tolerance as tolerance
from .dynamics.derivatives.derivatives import (
    Derivatives as Derivatives,
    dynamics_derivatives as dynamics_derivatives,
)
from .dynamics.derivatives.reaction_derivatives import Linear as Linear
from .dynamics.equilibrium import (
    Equilibria as Equilibria,
    Equilibrium as Equilibrium,
    equilibria as equilibria,
    equilibrium as equilibrium,
)
from .dynamics.equilibrium_path import (
    EquilibriumPath as EquilibriumPath,
    equilibrium_path as equilibrium_path,
)
from .dynamics.forward import forward_dynamics as forward_dynamics
from .dynamics.inverse import Efforts as Efforts
from .dynamics.kinetostatics import (
    Kinetostatics as Kinetostatics,
    inverse_dynamics as inverse_dynamics,
    kinetostatics as kinetostatics,
)
from .dynamics.linearization import (
    Linearization as Linearization,
    compliance as compliance,
    linearize as linearize,
)
from .dynamics.simulation.result import Projection as Projection
from .dynamics.simulation.simulate import Simulation as Simulation, simulate as simulate
from .dynamics.state_forces import Dynamics as Dynamics
from .errors import (
    AssemblyError as AssemblyError,
    ClosureTypeError as ClosureTypeError,
    ContinuumError as ContinuumError,
    EnergyError as EnergyError,
    Interrupted as Interrupted,
    LimitError as LimitError,
    MechanismFileError as MechanismFileError,
    ReachError as ReachError,
    SampleError as SampleError,
    SingularError as SingularError,
    SpatialPinError as SpatialPinError,
    SpatialPinWarning as SpatialPinWarning,
    StepLimitError as StepLimitError,
    UnknownNameError as UnknownNameError,
)
from .formats.drawing import Drawing as Drawing
from .formats.files import list_mechanisms as list_mechanisms, load as load
from .function.control_loop import ControlLoop as ControlLoop
from .function.function import Function as Function, function as function
from .inverse_kinematics import targets as targets
from .inverse_kinematics.reach import reach as reach
from .inverse_kinematics.reach_path import reach_path as reach_path
from .inverse_kinematics.targets import Target as Target
from .mechanism import closures as closures, curves as curves, laws as laws
from .mechanism.coordinates import CoordinateRates as CoordinateRates
from .mechanism.mechanism import Mechanism as Mechanism
from .mechanism.parts import (
    Closure as Closure,
    Coordinate as Coordinate,
    Driver as Driver,
    Frame as Frame,
    Passive as Passive,
    Spring as Spring,
)
from .mobility.assembly_modes import assembly_modes as assembly_modes
from .mobility.grashof import Grashof as Grashof, grashof as grashof
from .mobility.idle_freedoms import PassiveFreedom as PassiveFreedom
from .mobility.mobility import Loop as Loop, Mobility as Mobility, mobility as mobility
from .mobility.mode_check import AssemblyModes as AssemblyModes, Continuum as Continuum
from .motion.dead_centres import dead_centres as dead_centres
from .motion.follow import follow as follow
from .motion.limit_events import (
    BeyondLimit as BeyondLimit,
    JointLimit as JointLimit,
    Passing as Passing,
)
from .motion.limits import Bound as Bound, Range as Range, limits as limits
from .motion.motion import (
    ErrorEstimate as ErrorEstimate,
    Event as Event,
    Motion as Motion,
    Output as Output,
)
from .motion.scattered_states import states as states
from .motion.sweep import sweep as sweep
from .motion.trace import trace as trace
from .proximity.clearance import (
    Clearance as Clearance,
    Contact as Contact,
    PairClearance as PairClearance,
    clearance as clearance,
)
from .rates.jacobians import (
    Influence as Influence,
    closure_jacobian as closure_jacobian,
    influence as influence,
    jacobian as jacobian,
    jacobian_rate as jacobian_rate,
)
from .rates.jerks import Jerks as Jerks, solve_jerks as solve_jerks
from .rates.rates import solve_rates as solve_rates
from .rates.transmission import Transmission as Transmission, transmission as transmission
from .reduction.building import Omission as Omission
from .reduction.reduce import (
    Difference as Difference,
    Reduced as Reduced,
    Verification as Verification,
    reduce as reduce,
)
from .settings import Accuracy as Accuracy
from .synthesis import goals as goals
from .synthesis.defects import Defect as Defect
from .synthesis.design import design as design
from .synthesis.precision import Goal as Goal
from .synthesis.ranked_designs import (
    Design as Design,
    Designs as Designs,
    GoalError as GoalError,
    Met as Met,
)
from .view import (
    Look as Look,
    Viewer as Viewer,
    export_html as export_html,
    live as live,
    movie as movie,
    plot as plot,
    report as report,
    screenshot as screenshot,
    show as show,
)
from .view.scene.layers.arrows import Vectors as Vectors
from .workspace.workspace import workspace as workspace
from .workspace.workspace_result import (
    Borders as Borders,
    Curve as Curve,
    Workspace as Workspace,
)

__version__: str
