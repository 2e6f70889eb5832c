"""Links without mass: what has inertia moves as if they were weightless strings and struts.

In any formulation, by any integrator, in structures too; what has no inertia stays at rest if no
force works on it. Truth for what has inertia is Gauss's principle in extended precision.
"""

import mechanisms as known
import numpy as np
import pinocchio as pin
import pytest
from masses import heavy
from variety import few, first

import spatial_pin as sp

COUPLERS = {  # mechanisms, their drivers between, and the joints whose links lose their mass
    "rssr": ((0.0, 6.28), ("ball_a",)),
    "rssr_crossed": ((0.0, 6.28), ("ball_a",)),
    "four_bar": ((0.0, 6.28), ("coupler_pin",)),
    "watt_six_bar": ((0.0, 6.28), ("coupler_pin", "link_pin")),
    "delta": ((0.1, 0.5), ("elbow_1a", "elbow_1b", "elbow_2a", "elbow_3b")),
    "swash_plate": ((0.0, 6.28), ("ball",)),
}


def light(name, joints):
    mech = sp.load(name)
    for joint in joints:
        mech.model.inertias[mech.joint_id(joint)] = pin.Inertia.Zero()
    return mech


def started(mech, between, seed):
    rng = np.random.default_rng(seed)
    state = sp.assemble(mech, {d: rng.uniform(*between) for d in mech.drivers})
    return sp.solve_rates(mech, state, {d: float(rng.normal()) * 2.0 for d in mech.drivers})


@pytest.mark.slow
@pytest.mark.parametrize("integrator", ["DOP853", "RK45", "Radau", "Gauss"])
@pytest.mark.parametrize("name", COUPLERS)
def test_massless_links_move_alike_in_both_formulations(name, integrator):
    """Steps stand on loops a little open: there a massless motion seems to have inertia."""
    between, joints = COUPLERS[name]
    mech = light(name, joints)
    for seed in range(2):
        state, times = started(mech, between, seed), np.linspace(0.0, 0.2, 3)
        exact = sp.simulate(mech, state, 0.2, times=times)
        found = sp.simulate(mech, state, 0.2, times=times, accuracy=sp.Accuracy(
            formulation="projected", integrator=integrator, time_tolerance=1e-7,
            step=2e-3 if integrator == "Gauss" else None))
        gaps = [pin.difference(mech.model, *rows) for rows in zip(exact.q, found.q, strict=True)]
        assert np.abs(gaps).max() < 1e-4 and np.abs(found.v).max() < 1e3
        assert found.energy_drift < 1e-4 and found.closure_error.max() < 1e-12


# ---------------------------------------------------------------- structures


def struts(folder, reach, tilt):
    """Two rods from the ground whose ends meet, and a massless strut with balls across them."""
    a, b, c = (np.array(x) for x in ((0.0, 0.0, 0.0), (reach, 0.0, 0.0), (0.4, 0.0, 0.7)))
    tree = known.turning("left", "ground", "first", axis=(0, 1, 0))
    tree += known.turning("right", "ground", "second", tuple(b), axis=(0, 1, 0))
    tree += known.point("first_end", "first", tuple(c - a))
    tree += known.point("second_end", "second", tuple(c - b))
    across = (0.25 * (c - a), 0.6 * (c - b) + (0.0, tilt, 0.0))
    tree += known.floating("ball", "first", "strut", tuple(across[0]))
    tree += known.point("strut_end", "strut", tuple(b + across[1] - across[0]))
    tree += known.point("eye", "second", tuple(across[1]))
    tree = heavy(tree, first=(3.0, (0.2, 0, 0.3), (0.1, 0.2, 0.1)),
                 second=(1e3, (-0.1, 0, 0.2), (4.0, 7.0, 9.0)))
    return known.load(folder, "struts", tree, "gravity = [1.0, 2.0, -9.81]\n"
                      + known.refine("ball", "spherical")
                      + known.closure("ridge", "revolute", "first_end", "second_end",
                                      axis=[0.0, 1.0, 0.0])
                      + known.closure("knob", "spherical", "strut_end", "eye"))


@pytest.mark.parametrize(("reach", "tilt"), first(1, [
    (0.7, 0.3), (1.0, 0.0), (1.0, 0.3), (1.0, -0.11), (0.7, 0.0), (0.7, -0.11), (1.3, 0.0),
    (1.3, 0.3), (1.3, -0.11)]))
def test_a_massless_strut_across_a_structure_does_not_spin_by_itself(reach, tilt, tmp_path):
    """The spin moves the heavy rods by the last bit of the numbers: that is no inertia."""
    mech = struts(tmp_path, reach, tilt)
    state = sp.assemble(mech)
    assert sp.mobility(mech, state.q).dof == 1
    found = sp.forward_dynamics(mech, state)
    assert np.abs(found.a).max() < 1e-9
    with pytest.raises(sp.SingularError, match=r"ball.* has no inertia but a force works on it"):
        sp.forward_dynamics(mech, state, external={"strut": pin.Force(np.zeros(3), np.ones(3))})
    for formulation in ("independent", "projected"):
        still = sp.simulate(mech, state, 0.5, times=[0.5],
                            accuracy=sp.Accuracy(formulation=formulation))
        assert np.abs(pin.difference(mech.model, state.q, still.q[-1])).max() < 1e-9


@pytest.mark.parametrize("speed", few([1.0, -30.0], 1.0))
def test_a_strut_that_spins_keeps_its_spin(speed, tmp_path):
    mech = struts(tmp_path, 1.1, 0.2)
    state = sp.assemble(mech)
    spin = sp.mobility(mech, state.q)
    assert len(spin.passive) == 1
    v = speed * np.linalg.svd(sp.closure_jacobian(mech, state.q) * mech.velocity_scale)[2][-1]
    moving = sp.State(mech, state.q, v * mech.velocity_scale, closure_error=state.closure_error)
    assert np.abs(sp.forward_dynamics(mech, moving).a).max() < 1e-9 * speed**2
    for formulation in ("independent", "projected"):
        turned = sp.simulate(mech, moving, 0.3, times=[0.3],
                             accuracy=sp.Accuracy(formulation=formulation))
        np.testing.assert_allclose(turned.v[-1], moving.v, rtol=0.0, atol=1e-8 * abs(speed))


# ---------------------------------------------------------------- energy


def double_pendulum(folder):
    tree = heavy(known.turning("upper", "ground", "arm", axis=(0, 1, 0))
                 + known.turning("lower", "arm", "forearm", (1.0, 0.0, 0.0), axis=(0, 1, 0)),
                 arm=(1.0, (1.0, 0, 0), (0.1, 0.1, 0.1)),
                 forearm=(2.0, (1.0, 0, 0), (0.1, 0.1, 0.1)))
    return known.load(folder, "pendulum", tree, "gravity = [0.0, 0.0, -9.81]\n")


@pytest.mark.filterwarnings("ignore::spatial_pin.SpatialPinWarning")
@pytest.mark.parametrize("formulation", ["independent", "projected"])
def test_a_motion_that_loses_its_energy_is_refused_with_what_came_before(formulation, tmp_path):
    """Steps of a fixed length that is far too long."""
    mech = double_pendulum(tmp_path)
    with pytest.raises(sp.EnergyError, match="energy came from nowhere or was lost") as caught:
        sp.simulate(mech, sp.assemble(mech), 20.0, accuracy=sp.Accuracy(
            formulation=formulation, integrator="RK4", step=0.2))
    motion = caught.value.motion
    assert motion.energy_drift < 0.5 and len(motion.time) < 1001


def test_the_energy_drifts_from_that_of_the_start_whatever_rows_are_requested(tmp_path):
    mech = double_pendulum(tmp_path)
    loose = sp.Accuracy(integrator="RK4", step=0.05)
    all_rows, last = (sp.simulate(mech, sp.assemble(mech), 2.0, times=times, accuracy=loose)
                      for times in (np.linspace(0.0, 2.0, 41), [2.0]))
    assert 0.3 < last.energy_drift / all_rows.energy_drift < 3.0


def test_a_massless_plate_that_nothing_turns_does_not_slow_the_steps(tmp_path):
    """What has no inertia goes on in the same coordinates all along, whichever carry it best.

    In others it would go on otherwise: a step in which they change could only be a short one.
    """
    q = np.pi / 2.0
    tree = known.floating("thread", "ground", "nut", (0, 0, -0.25), (-q, 0, 0))
    tree += known.sliding("slide", "nut", "block", (0, 0.125, 0), (0, -1, 0))
    tree += known.turning("hinge", "block", "arm", (0.125, -0.25, -0.5), (0, 0, -1),
                          (2 * q, -q, -q))
    tree += known.floating("plane", "arm", "plate", (0, -0.25, 0.5), (2 * q, q, 2 * q))
    tree += known.turning("axle", "ground", "wheel", (0, -0.25, 0.25), (0, -1, 0), (0, q, 2 * q))
    tree += known.point("rail", "ground", (0.5, 0.125, -0.5), (0, 0, -q))
    tree += known.point("pin", "block", (0.5, 0.5325551697199717, 0.125),
                        (2.33121485325079, 0.30313413533990463, 2.1617888911010774))
    tree += known.point("cross", "wheel", (0.125, 0, 0), (q, 0, -q))
    tree += known.point("hook", "plate", (0.25, 0.375, 0.25),
                        (-0.7670013746007032, -0.962871166369479, 2.2401333876090606))
    tree = heavy(tree, nut=(0.2, (0.05, 0.2, -0.5), (0.015, 0.005, 0.012)),
                 block=(3.7, (-0.3, -0.1, -0.25), (0.47, 0.32, 0.19)),
                 arm=(0.2, (0.1, -0.1, 0.0), (0.007, 0.015, 0.011)),
                 wheel=(1.0, (-0.34, 0.63, -0.1), (0.04, 0.12, 0.14)))
    mech = known.load(tmp_path, "plate", tree, "gravity = [-8.0, 7.1, -9.2]\n"
                      + known.refine("thread", "screw", axis=(0, 1, 0), lead=-0.400455510815363)
                      + known.refine("plane", "planar", axis=(0, -1, 0))
                      + known.closure("guide", "point_on_line", "rail", "pin")
                      + known.closure("hooke", "universal", "cross", "hook", axis=(0, -1, 0)))
    state = sp.assemble(mech)
    steps = {f: sp.simulate(mech, state, 0.1, times=[0.1],
                            accuracy=sp.Accuracy(formulation=f)).steps
             for f in ("independent", "projected")}
    assert steps["projected"] <= 3 * steps["independent"]


def carried_strut(folder, reach):
    """A frame that swings, a rider bolted to it, and a massless strut with balls between them."""
    tree = known.floating("hook", "ground", "frame", rpy=(0.3, -0.2, 0.5))
    tree += known.floating("ball", "frame", "strut", (0.2, -0.3, 0.1), (0.7, 0.1, -0.4))
    tree += known.floating("knob", "strut", "rider", (0.4, 0.2, -0.5), (-0.2, 0.6, 0.3))
    tree += known.turning("flap_pin", "rider", "flap", reach, (0.6, 0.0, 0.8))
    tree += known.point("seat", "frame", (0.5, 0.1, 0.3))
    tree += known.point("foot", "flap", (0.1, 0.2, 0))
    tree = heavy(tree, frame=(2.5, (0.1, 0.2, -0.4), (0.1, 0.2, 0.15)),
                 rider=(2.3, (0.3, 0.0, 0.1), (0.2, 0.1, 0.1)),
                 flap=(0.5, (0.0, 0.1, 0.1), (0.02, 0.01, 0.03)))
    return known.load(folder, "carried", tree, known.refine("hook", "universal")
                      + known.refine("ball", "spherical") + known.refine("knob", "spherical")
                      + known.closure("bolt", "weld", "seat", "foot"))


@pytest.mark.parametrize("reach", few(
    [(-0.2, 0.4, 0.1), (-0.3, 0.3, 0.1), (-0.2, 0.5, -0.1)], (-0.2, 0.4, 0.1)))
def test_a_massless_strut_between_bolted_bodies_does_not_stop_them(reach, tmp_path):
    """The spin moves the bolted bodies by the last bit of the numbers, as no body moves."""
    mech = carried_strut(tmp_path, reach)
    state, times = sp.assemble(mech), np.linspace(0.0, 0.5, 3)
    found = [sp.simulate(mech, state, 0.5, times=times, accuracy=sp.Accuracy(formulation=f))
             for f in ("independent", "projected")]
    for angle in ("hook.first", "hook.second"):
        one, other = (m.coordinate(angle).value for m in found)
        np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-8)
    assert max(m.energy_drift for m in found) < 1e-7
    assert max(m.steps for m in found) < 200
