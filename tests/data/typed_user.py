"""A user's script that touches every verb and result; `mypy --strict` reads it, nobody runs it."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import spatial_pin as sp

Array = NDArray[np.floating]
Flags = NDArray[np.bool_]


def loading() -> sp.Mechanism:
    names: list[str] = sp.list_mechanisms()
    mech: sp.Mechanism = sp.load(names[0], trusted=False, d=0.315)
    chosen: sp.Mechanism = sp.load("world.sdf", model="robot", without=["rope"])
    drawn = sp.Drawing("pendulum", density=7850.0)
    drawn["b"] = 0.3
    drawn.body("bob", mass=2.0 * drawn["b"], com=(drawn["b"], 0.0, -1.0)).drive("pin")
    drawn.hinge("pin", "ground", "bob", at=(drawn["b"], 0.0, 0.0), axis=(0, 1, 0))
    drawn.mechanism(keep=["pin"], b=0.4).with_point("tip", "bob", (0, 0, -1)).with_mass("bob", 1.0)
    built = sp.Mechanism.from_model(
        mech.model, [
            sp.closures.spherical("a", "b"), sp.closures.rope(["a", "b"], 0.4),
            sp.closures.coupling(joints=["a", "b", "c"], ratios=[1.0, 1.0, -2.0]),
            sp.closures.cam("a", "b", sp.curves.circle(0.03), {"roller": 0.008})],
        drivers={"crank": "crank_pin"},
        springs=[sp.Spring("spring", joint="rocker_pin", stiffness=4.0)],
        passives=[sp.Passive("spin", "coupler", ("ball_a", "ball_b"))])
    closure: sp.Closure = built.closures[0]
    driver: sp.Driver = mech.drivers["crank"]
    coordinate: sp.Coordinate = mech.coordinate(driver.joint)
    frame: sp.Frame = mech.frames["tool"]
    length: float = mech.characteristic_length
    title: str = f"{chosen.name} {closure.type} {coordinate.unit} {frame.xyz[0]:.3f} {length:.3f}"
    values: dict[str, float] = dict(mech.dimensions)
    file: Path = mech.save(Path("folder") / title)
    sp.export_mjcf(mech, file.with_suffix(".xml"))
    print(mech.coordinates[0].upper(), mech.links[0].upper(), values["d"] + 1.0)
    return mech


def assembling(mech: sp.Mechanism) -> sp.State:
    accuracy: sp.Accuracy = sp.Accuracy.named("engineering")
    state: sp.State = sp.assemble(mech, {"crank": 0.0}, limits=True, accuracy=accuracy)
    modes: sp.AssemblyModes = sp.assembly_modes(mech, {"crank": 0.0}, seed=1)
    continua: list[sp.Continuum] = list(modes.continua)
    freedom: sp.Mobility = sp.mobility(mech, state)
    loops: tuple[sp.Loop, ...] = freedom.loop_list
    passive: tuple[sp.PassiveFreedom, ...] = freedom.passive
    q: Array = state.q
    gap: sp.Gap = state.gap
    error: float = state.closure_error + gap + state.rate_error + accuracy.tolerance
    released: dict[str, float] = state.released
    beyond: dict[str, float] = state.beyond_limits
    turns: tuple[str, ...] = state.lost_turns
    angle: float = state.coordinate("rocker_pin").value
    grashof: sp.Grashof = sp.grashof(mech, state)
    print(modes[0].branch.upper(), modes.completeness.upper(), len(continua), freedom.dof + 1,
          loops[0].order + 1, passive[0].link.upper(), q.shape, error, released, beyond, turns,
          angle, grashof.type.upper(), freedom.overconstrained is True)
    return modes[0]


def rates(mech: sp.Mechanism, state: sp.State) -> None:
    moving: sp.State = sp.solve_rates(mech, state, {"crank": 25.0}, {"crank": 0.0})
    spin: Array = moving.angular_velocity("coupler")
    centre: sp.PointRates = moving.com("coupler")
    seen: sp.RelativeMotion = moving.relative_motion("coupler", "crank")
    rows: Array = sp.closure_jacobian(mech, moving.q)
    jacobian: Array = sp.jacobian(mech, moving, "coupler")
    rate: Array = sp.jacobian_rate(mech, moving, "coupler")
    influence: sp.Influence = sp.influence(mech, moving)
    jerks: sp.Jerks = sp.solve_jerks(mech, moving)
    ratio: sp.Transmission[float] = sp.transmission(mech, moving, "rocker_pin")
    print(spin.shape, centre.velocity.shape, seen.coriolis.shape, rows.T, jacobian @ rate.T,
          influence.second.ndim, jerks.coordinate("rocker_pin") + 1.0, ratio.angle + ratio.ratio)


def over(mech: sp.Mechanism, motion: sp.Motion) -> sp.Motion:
    try:
        one: sp.State = motion[-1]
    except sp.SampleError as error:
        print(str(error).upper())
    some: sp.Motion = motion[10:20]
    faster: sp.Motion = sp.solve_rates(mech, some, {"crank": np.linspace(0.0, 1.0, 10)})
    ratios: sp.Transmission[Array] = sp.transmission(mech, motion, "rocker_pin")
    path: sp.FrameMotion = one.frame("coupler")
    jacobians: Array = sp.jacobian(mech, motion, "coupler")
    cloud: sp.Motion = sp.states(mech, {"crank": [0.0, 2.0, 1.0]}, threads=2)
    reasons: dict[int, str] = cloud.unreached
    print(ratios.angle.max(), path.velocity.shape, jacobians[0] @ np.ones(1), reasons.keys(),
          motion.placement("coupler").shape, [state.closure_error + 1.0 for state in motion],
          sp.influence(mech, motion).second.shape)
    return faster


def moving(mech: sp.Mechanism) -> sp.Motion:
    motion: sp.Motion = sp.sweep(mech, "crank", np.linspace(0.0, 1.0, 11), speed=1.0)
    both: sp.Motion = sp.follow(mech, {"boom": [0.0, 0.1], "arm": [0.2, 0.2]}, [0.0, 1.0])
    around: sp.Motion = sp.trace(mech, "crank", step=0.02)
    span: sp.Range = sp.limits(mech, "crank")
    bound: sp.Bound = span.lower
    stops: list[sp.Event] = sp.dead_centres(motion, "rocker_pin")
    angle: sp.CoordinateRates[Array] = motion.coordinate("rocker_pin")
    path: sp.FrameMotion = motion.frame("coupler")
    output: sp.Output = motion.output("rocker_pin.rate")
    time: Array | None = motion.time
    row: sp.State = motion.state(-1)
    columns: dict[str, NDArray[Any]] = motion.columns()
    quantity: sp.Quantity = motion.quantities("rocker_pin")["rocker_pin"]
    text: str = motion.to_csv()
    file: Path = motion.save(motion.to_csv("motion.csv").with_suffix(".npz"))
    again: sp.Motion = sp.Motion.load(file, mech)
    off: sp.ErrorEstimate = again.error
    print(angle.rate.max(), path.position.shape, motion.com("coupler").velocity.shape,
          output.unit.upper(), time is None, row.closure_error + 1.0, columns.keys(),
          quantity.unit.upper(), text.upper(),
          again.closure_error.max(), off.positions + off.largest, stops[0].kind.upper(),
          bound.value + 1.0, bound.kind.upper(),
          len(both) + len(around), motion.events[0].text.upper(), span.full_turn is True)
    return motion


def reaching(mech: sp.Mechanism, state: sp.State) -> None:
    target: sp.Target = sp.targets.distance("b", 0.3)
    there: sp.State = sp.reach(mech, {"tip": [0.1, 0.2, 0.3], "a": target}, state)
    path: sp.Motion = sp.reach_path(mech, {"tip": np.zeros((5, 3))}, [0.0, 1.0, 2.0, 3.0, 4.0])
    places: sp.Workspace = sp.workspace(mech, "tip", {"boom": (0.0, 1.0)}, points=11)
    edge: sp.Borders = places.boundary
    curves: tuple[sp.Curve, ...] = places.curves(tolerance=1e-3)
    reached: Flags = places.reached
    print(there.q.shape, len(path), edge.points.shape, curves[0].is_closed is True, reached.any(),
          places.condition.max(), places.state(0).closure_error + 1.0)


def loading_with_forces(mech: sp.Mechanism, state: sp.State, motion: sp.Motion) -> None:
    free: sp.Dynamics = sp.forward_dynamics(mech, state, {"crank": 1.0})
    efforts: sp.Efforts = sp.inverse_dynamics(mech, state, actuated=["crank"])
    effort: float = efforts.efforts["crank"]
    loads: sp.Kinetostatics = sp.kinetostatics(mech, motion)
    beyond: tuple[sp.BeyondLimit, ...] = loads.beyond_limits
    reaction: Array = loads.reactions["ball_b"]
    slopes: sp.Derivatives = sp.dynamics_derivatives(mech, state)
    shaking: sp.Linear = slopes.on_ground
    run: sp.Simulation = sp.simulate(
        mech, state, 1.0, lambda t, now: {"crank": -now.coordinate("crank").rate},
        drives={"fan": sp.laws.constant_speed(0.0, 2.0)}, stop_when=lambda t, now: t - 0.5,
        external={"rocker_b": np.zeros((1001, 6))})
    projection: sp.Projection | None = run.projection
    passed: list[sp.Passing] = run.joint_limits
    limit: sp.JointLimit = passed[0].limit
    determined: bool = free.determined["ball_b"]
    reasons: list[str] = free.why_not_unique() + loads.why_not_unique()
    print(free.a.shape, free.error + effort, determined, reasons, reaction.shape,
          shaking.by_q.shape, slopes.a_by_v.shape, run.energy_drift + run.energy.max(), limit.value,
          beyond[0].most + 1.0, 0 if projection is None else projection.steps + 1)


def dimensions(mech: sp.Mechanism, state: sp.State) -> None:
    slope: sp.Sensitivity = sp.sensitivity(mech, state, "rocker_pin", ["d"])
    spread: sp.Tolerance = sp.tolerance(mech, "rocker_pin", {"d": 1e-4}, samples=100)
    fit: sp.Calibration = sp.calibrate(
        mech, [({"crank": 0.1}, {"rocker_pin": 1.2})], ["d"], offsets=["crank"])
    goal: sp.Goal = sp.goals.path("coupler", [[0.0, 0.1], [0.1, 0.1]])
    designs: sp.Designs = sp.design(mech, [goal, sp.goals.turns()], {"d": (0.2, 0.4)})
    best: sp.Design = designs[0]
    missed: sp.GoalError = best.errors[goal.name]
    defects: tuple[sp.Defect, ...] = best.defects
    met: sp.Met = best.met[0]
    print(slope.unit.upper(), spread.failed + 1, fit.values["d"] + 1.0, fit.covariance.shape,
          best.dimensions["d"] + best.error + missed.rms, defects[0].text.upper(),
          met.targets.shape, best.motion().closure_error.max())


def resting(mech: sp.Mechanism) -> None:
    found: sp.Equilibrium = sp.equilibrium(mech, {"crank": 1.0}, hold="crank", stable=None)
    every: sp.Equilibria = sp.equilibria(mech, starts=4)
    small: sp.Linearization = sp.linearize(mech, every[0].state, outputs=["rocker_pin"])
    soft = sp.compliance(mech, every[0].state, "tip")
    path: sp.EquilibriumPath = sp.equilibrium_path(mech, efforts={"crank": 1.0})
    stable: bool | None = found.stable
    print(stable, found.efforts["crank"] + every.missing + found.energy, soft.shape,
          small.frequencies + 1.0, small.state_space()[0].shape, small.shape(0).closure_error,
          small.frequency_response([1.0]).real, path.load_factor + 1.0)


def judging(mech: sp.Mechanism, motion: sp.Motion) -> None:
    table: sp.Tradeoff = sp.tradeoff(mech, motion, repeats=3)
    row: sp.Measured = table.cheapest(1e-6)
    errors: sp.Errors | None = row.errors
    small: sp.Reduced = sp.reduce(mech, ["rocker_pin"])
    omission: sp.Omission = small.omissions[0]
    proof: sp.Verification = small.verify()
    difference: sp.Difference = proof.differences[0]
    apart: sp.Clearance = sp.clearance(motion, tolerance=1e-3)
    pair: sp.PairClearance = apart.least
    contact: sp.Contact = pair.contacts[0]
    print(row.time_per_step + row.error, 0.0 if errors is None else errors.total + 1.0,
          omission.why.upper(), proof.worst + difference.position, pair.distance + contact.begin)


def differentiating(mech: sp.Mechanism) -> None:
    f: sp.Function = sp.function(mech, ["crank", "b"], ["rocker_pin"], guess={"crank_pin": 0.1})
    slopes = f.jacobian([[1.0, 0.381]])
    print(f.labels[0].upper(), slopes.shape, f.vjp([1.0, 0.381], [1.0]) @ f([1.0, 0.381]))
    g = f.jax() if len(f.inputs) > 1 else f.torch()
    loop: sp.ControlLoop = sp.ControlLoop(mech, frames=["tip"])
    loop.update([0.1], rates={"crank": 2.0})
    print(g([1.0, 0.381]), loop.inertia @ [1.0] + loop.gravity_efforts, loop.state.closure_error)
    print(loop.jacobians["tip"].shape, loop.influence.second.shape, loop.rate_error + 1.0)


def viewing(mech: sp.Mechanism, motion: sp.Motion) -> None:
    speed = sp.Vectors("tip", motion.frame("tip").position, motion.frame("tip").velocity,
                       "velocity", "m/s")
    look: sp.Look = sp.Look(pairs=True, traces=("tip",), arrows=(speed, "tip.acceleration"))
    page: Path = sp.export_html(motion, "page.html", look=look)
    sp.screenshot(motion, page.with_suffix(".png"), row=-1)
    sp.movie(motion, page.with_suffix(".gif"), fps=25)
    sp.report(motion, "report.html", outputs=["rocker_pin"])
    sp.plot(motion, ["rocker_pin", "rocker_pin.rate"], "plot.png", title="").savefig("plot.pdf")
    with sp.show(motion, open_browser=False) as viewer:
        shown: sp.Viewer = viewer
        print(shown.url.upper(), shown.running is True)
    sp.live(mech, outputs=["rocker_pin"]).wait()


def failing(mech: sp.Mechanism) -> None:
    try:
        sp.sweep(mech, "crank", [0.0, 7.0])
    except sp.Interrupted as stopped:
        partial: object = stopped.result
        print(partial, stopped.found)
        followed: sp.Motion | None = stopped.motion
        print(len(followed) if followed is not None else 0)
    except sp.LimitError as error:
        reached: float = error.limit
        print(reached, error.motion.q if error.motion is not None else None)
    except sp.AssemblyError as error:
        open_by: sp.State | None = error.state
        print(error.closure_error + 1.0, error.worst_closure.upper(), open_by)
    except sp.UnknownNameError as error:
        print(error.name.upper(), error.valid[0].upper())
    except sp.ReachError as error:
        nearest: sp.State = error.state
        print(error.distances["tip"] + 1.0, error.reasons[0].upper(), nearest.closure_error + 1.0)
    except sp.ContinuumError as error:
        print(error.freedoms + 1, error.hold[0].upper())
    except (sp.SingularError, sp.EnergyError, sp.StepLimitError) as error:
        print(error.motion)
    except (sp.MechanismFileError, sp.ClosureTypeError, sp.SpatialPinError) as error:
        print(error)
