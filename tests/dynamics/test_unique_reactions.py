"""Which components of a reaction are unique, against the equilibrium of free bodies."""

from __future__ import annotations

import mechanisms as known
import numpy as np
import odd_mechanisms as odd
import pinocchio as pin
import pytest
from machines import three_rods, translation
from masses import with_masses

import spatial_pin as sp

BODY = (0.4, (0.05, 0.02, 0.01), (1e-3, 1.5e-3, 2e-3))


def hinges(mechanism, state):
    """(name, first body, second body, point, axis) of all pairs, which are hinges."""
    model, found = mechanism.model, []
    for i in range(1, model.njoints):
        at = state.placement(model.names[i])
        axis = pin.getJointJacobian(
            model, pin_data(model, state), i, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)[3:]
        found.append((model.names[i], model.parents[i], i, at.translation,
                      axis[:, model.idx_vs[i]]))
    for closure in mechanism.closures:
        first, second = (mechanism.frame_on_joint(f)[0] for f in closure.frames)
        at = state.placement(closure.frames[1])
        axis = at.rotation @ closure.geometry.axes2[:, 2]
        found.append((closure.name, first, second, at.translation, axis))
    return found


def pin_data(model, state):
    data = model.createData()
    pin.computeJointJacobians(model, data, state.q)
    return data


def unique_by_free_bodies(mechanism, state):
    """Components that no loads, which every body bears in balance, reach."""
    pairs = hinges(mechanism, state)
    bodies = mechanism.model.njoints - 1
    size = mechanism.characteristic_length
    balance = np.zeros((6 * bodies, 6 * len(pairs)))
    free = []  # unknown wrenches (6,) on the second body, at the pair, in the columns
    for k, (_, first, second, point, axis) in enumerate(pairs):
        columns = slice(6 * k, 6 * k + 6)
        moved = np.eye(6)
        moved[3:, :3] = pin.skew(point) / size
        for body, sign in ((first, -1.0), (second, 1.0)):
            if body:
                balance[6 * (body - 1) : 6 * body, columns] += sign * moved
        row = np.zeros(6 * len(pairs))
        row[6 * k + 3 : 6 * k + 6] = axis  # a hinge bears no moment about its own axis
        free.append(row)
    stresses = np.vstack([balance, free])
    _, s, vt = np.linalg.svd(stresses)
    rank = int(np.count_nonzero(s > 1e-9 * s[0]))
    reach = np.abs(vt[rank:]).max(axis=0, initial=0.0) > 1e-7
    return {pair[0]: ~reach[6 * k : 6 * k + 6] for k, pair in enumerate(pairs)}


def four_bar(folder, wrap=str):
    mechanism = known.bare_four_bar(folder, 1.0, 0.3, 0.9, 0.8)
    return rewrapped(mechanism, folder, wrap)


def rewrapped(mechanism, folder, wrap):
    path = folder / f"{mechanism.name}.urdf"
    text = path.read_text(encoding="utf-8")
    begin = text.index('<link name="ground"/>') + len('<link name="ground"/>')
    path.write_text(text[:begin] + wrap(text[begin:].replace("</robot>", "")) + "</robot>",
                    encoding="utf-8")
    return sp.load(folder / f"{mechanism.name}.toml")


HINGED = {
    "four-bar": four_bar,
    "tilted four-bar": lambda folder: four_bar(folder, known.tilted),
    "three rods": three_rods,
    "bennett": known.bennett,
    "bricard": known.bricard,
    "sarrus": known.sarrus,
}


@pytest.mark.filterwarnings("ignore::spatial_pin.SpatialPinWarning")
@pytest.mark.parametrize("name", HINGED)
def test_components_are_unique_where_no_stress_reaches_them(name, tmp_path):
    mechanism = HINGED[name](tmp_path)
    driver = next(iter(mechanism.drivers))
    start = sp.assemble(mechanism).coordinate(driver).value
    state = sp.assemble(mechanism, {driver: start + 0.1})
    if name == "three rods":
        state = translation(mechanism, 0.5)
    want = unique_by_free_bodies(mechanism, state)
    got = sp.forward_dynamics(mechanism, state).unique
    assert got.keys() == want.keys()
    for pair in want:
        assert got[pair].tolist() == want[pair].tolist(), pair
    determined = sp.forward_dynamics(mechanism, state).determined
    assert determined == {pair: bool(each.all()) for pair, each in want.items()}


def test_forces_in_the_plane_are_unique_and_the_text_says_so(tmp_path):
    known.bare_four_bar(tmp_path, 1.0, 0.3, 0.9, 0.8)
    mechanism = with_masses(four_bar(tmp_path), tmp_path, crank=BODY, coupler=BODY, rocker=BODY)
    state = sp.solve_rates(mechanism, sp.assemble(mechanism, {"crank": 0.8}), {"crank": 1.0})
    answer = sp.inverse_dynamics(mechanism, state)
    for each in answer.unique.values():
        assert each.tolist() == [True, True, False, False, False, True]
    line = next(x for x in str(answer).splitlines() if x.startswith("crank_pin:"))
    force, moment = line.split("moment")
    assert force.count("*") == 1 and force.index("*") > force.index(",", force.index(",") + 1)
    assert moment.count("*") == 2 and not moment.split(",")[2].count("*")
    assert "one of many" in str(answer)
    motion = sp.sweep(mechanism, "crank", [0.8, 0.9, 1.0], speed=1.0)
    loads = sp.kinetostatics(mechanism, motion)
    for name, each in loads.unique.items():
        assert each.shape == (3, 6) and each[0].tolist() == answer.unique[name].tolist()
        assert loads.determined[name].tolist() == [False] * 3
    assert " N *z" in str(loads) and " N·m *xy" in str(loads)


def test_everything_is_unique_without_redundant_equations(tmp_path):
    mechanism = odd.driven_arm(tmp_path)
    answer = sp.inverse_dynamics(mechanism, sp.assemble(mechanism))
    assert answer.unique["pin"].all() and "*" not in str(answer)
