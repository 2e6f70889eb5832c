"""Mistakes that a type checker tells a user: the lines marked WRONG; nobody runs it."""
# ruff: noqa: B018

from pathlib import Path

import spatial_pin as sp


def mistakes(mech: sp.Mechanism, state: sp.State, motion: sp.Motion) -> None:
    sp.asemble(mech, {"crank": 0.0})  # WRONG attr-defined
    state.placment("coupler")  # WRONG attr-defined
    state.coordinate("crank").speed  # WRONG attr-defined
    sp.assemble(mech, {"crank": "zero"})  # WRONG dict-item
    sp.assemble(mech, limit=True)  # WRONG call-arg
    sp.sweep("rssr", "crank", [0.0, 1.0]).q  # WRONG arg-type
    motion.to_excel("motion.xlsx")  # WRONG attr-defined
    motion.events[0].name  # WRONG attr-defined
    sp.limits(mech, "crank").lower.worth  # WRONG attr-defined
    sp.mobility(mech).dofs  # WRONG attr-defined
    sp.inverse_dynamics(mech, state).torques  # WRONG attr-defined
    sp.kinetostatics(mech, motion).reaction  # WRONG attr-defined
    sp.simulate(mech, state, 1.0).energies  # WRONG attr-defined
    sp.simulate(mech, state, 1.0, drive={"crank": sp.laws.ramp(0.0, 1.0, 1.0)})  # WRONG call-arg
    sp.clearance(motion).nearest  # WRONG attr-defined
    sp.reach(mech, {"tip": [0.0, 0.0, 0.0]}).poze  # WRONG attr-defined
    sp.workspace(mech, "tip", {}).area  # WRONG attr-defined
    sp.design(mech, sp.goals.path(3, []), {})  # WRONG arg-type
    sp.design(mech, sp.goals.turns(), {})[0].eror  # WRONG attr-defined
    sp.show(motion).adress  # WRONG attr-defined
    sp.Look(trace="tip")  # WRONG call-arg
    sp.Accuracy(tolerance="small")  # WRONG arg-type
    sp.Motion.load(Path("motion.npz"))  # WRONG call-arg
    try:
        sp.reduce(mech, ["a"]).verify().wurst  # WRONG attr-defined
    except sp.LimitError as error:
        error.limits  # WRONG attr-defined
