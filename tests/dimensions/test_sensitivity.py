"""Derivatives of outputs with respect to dimensions, and tolerances, against closed forms."""

from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor

import numpy as np
import pytest
from loaded_library import library
from mpmath import mp, mpf
from variety import few, paired

import spatial_pin as sp

RSSR = {"a": mpf("0.102"), "b": mpf("0.381"), "c": mpf("0.254"), "d": mpf("0.314")}
SPEED, ACCELERATION = 25, 100


def rocker(phi, a, b, c, d):
    """Rocker angle of the RSSR (SEEDS B7)."""
    return mp.acos((b * b - a * a - c * c - d * d + 2 * a * d * mp.cos(phi))
                   / (2 * c * (d - a * mp.cos(phi))))


def exact(order, name):
    """d/d(name) of the rocker's angle, rate or acceleration at crank = 1, in 40 digits."""
    def output(x):
        lengths = {**RSSR, name: x}
        f = [mp.diff(lambda phi: rocker(phi, **lengths), 1, k) for k in (0, 1, 2)]
        return (f[0], f[1] * SPEED, f[2] * SPEED**2 + f[1] * ACCELERATION)[order]

    with mp.workdps(40):
        return float(mp.diff(output, RSSR[name]))


@pytest.fixture(scope="module")
def rssr():
    mechanism = library("rssr")
    state = sp.assemble(mechanism, {"crank": 1.0})
    state = sp.solve_rates(mechanism, state, {"crank": SPEED}, {"crank": ACCELERATION})
    return mechanism, state


@pytest.mark.parametrize(("order", "output"), [
    (0, "rocker_pin"), (1, "rocker_pin.rate"), (2, "rocker_pin.acceleration")])
def test_derivatives_are_those_of_the_closed_form(rssr, order, output):
    found = sp.sensitivity(*rssr, output, ["b", "d"])
    for name, derivative in found.derivatives.items():
        expected = exact(order, name)
        assert derivative == pytest.approx(expected, rel=3e-12)
        assert abs(derivative - expected) <= found.errors[name]


def test_the_limits_of_a_rocker_change_with_the_links_as_the_triangles_say():
    """At the stretched dead centre the rocker closes a triangle of r1, r2 + r3 and r4."""
    mechanism = library("four_bar", r1=0.30, r2=0.10, r3=0.28, r4=0.24)
    state = sp.assemble(mechanism)
    found = sp.sensitivity(mechanism, state, "limit.lower.rocker_pin", ["r1", "r3"])
    with mp.workdps(40):
        def end(r1, r3):
            stretched = r3 + mpf("0.1")
            return mp.pi - mp.acos((r1**2 + mpf("0.24")**2 - stretched**2) / (2 * r1 * mpf("0.24")))
        nominal = {"r1": mpf("0.3"), "r3": mpf("0.28")}
        values = {k: float(mp.diff(lambda x, k=k: end(**{**nominal, k: x}), nominal[k]))
                  for k in nominal}
        assert found.value == pytest.approx(float(end(**nominal)), abs=1e-13)
    assert found.derivatives == pytest.approx(values, rel=1e-10)


def test_vector_outputs_have_vector_derivatives(rssr):
    found = sp.sensitivity(*rssr, "rocker_b.position", ["c"])
    psi = rssr[1].coordinate("rocker_pin").value
    slope = sp.sensitivity(*rssr, "rocker_pin", ["c"]).derivatives["c"]
    expected = [-np.cos(psi) + 0.254 * np.sin(psi) * slope,
                np.sin(psi) + 0.254 * np.cos(psi) * slope, 0.0]
    np.testing.assert_allclose(found.derivatives["c"], expected, atol=1e-11)


def test_wrong_names_are_refused_with_a_suggestion(rssr):
    with pytest.raises(sp.SpatialPinError, match="no dimension 'bb'"):
        sp.sensitivity(*rssr, "rocker_pin", ["bb"])
    with pytest.raises(sp.SpatialPinError, match="rocker_pin"):
        sp.sensitivity(*rssr, "rocker_pim", ["b"])


@pytest.mark.slow
def test_a_branch_that_ends_nearby_is_an_error_not_a_number():
    """The four-bar 1 + 1 + 1 = 3 closes at the stretched position only."""
    mechanism = library("four_bar", r1=0.3, r2=0.1, r3=0.1, r4=0.1)
    with pytest.raises(sp.SpatialPinError):
        sp.sensitivity(mechanism, sp.assemble(mechanism), "rocker_pin", ["r1"])


def test_linear_propagation_and_samples_agree_for_small_deviations(rssr):
    deviations = {"b": 1e-5, "d": 2e-5}
    with ThreadPoolExecutor(2) as pool:
        found = sp.tolerance(rssr[0], ["rocker_pin"], deviations, rssr[1], samples=60,
                             executor=pool)
    expected = np.hypot(exact(0, "b") * 1e-5, exact(0, "d") * 2e-5)
    assert found.linear["rocker_pin"] == pytest.approx(expected, rel=1e-9)
    assert found.sampled["rocker_pin"] == pytest.approx(expected, rel=0.35)
    assert found.failed == 0
    again = sp.tolerance(rssr[0], ["rocker_pin"], deviations, rssr[1], samples=60)
    np.testing.assert_array_equal(found.samples["rocker_pin"], again.samples["rocker_pin"])


def test_processes_draw_the_same_samples(rssr):
    with ProcessPoolExecutor(2) as pool:
        found = sp.tolerance(rssr[0], ["rocker_pin"], {"d": 2e-5}, rssr[1], samples=20,
                             executor=pool)
    alone = sp.tolerance(rssr[0], ["rocker_pin"], {"d": 2e-5}, rssr[1], samples=20)
    np.testing.assert_array_equal(found.samples["rocker_pin"], alone.samples["rocker_pin"])


@pytest.mark.slow
def test_a_dask_cluster_draws_the_same_samples(rssr):
    """Two worker processes; numbers as without any."""
    distributed = pytest.importorskip("distributed")
    with (distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None,
                                   host="127.0.0.1") as cluster,
          distributed.Client(cluster) as client):
        found = sp.tolerance(rssr[0], ["rocker_pin"], {"d": 2e-5}, rssr[1], samples=20,
                             executor=client.get_executor())
    alone = sp.tolerance(rssr[0], ["rocker_pin"], {"d": 2e-5}, rssr[1], samples=20)
    np.testing.assert_array_equal(found.samples["rocker_pin"], alone.samples["rocker_pin"])


def test_tolerances_are_those_of_the_guess_if_no_state_is_given(rssr):
    found = sp.tolerance(rssr[0], "rocker_pin", {"d": 1e-5})
    state = sp.assemble(rssr[0])
    assert found.nominal["rocker_pin"] == pytest.approx(state.coordinate("rocker_pin").value)


def test_dimensions_are_given_with_their_values():
    assert sp.load("rssr", d=0.315).dimensions == {"a": 0.102, "b": 0.381, "c": 0.254, "d": 0.315}
    assert sp.load("rspc").dimensions["alpha"] == pytest.approx(np.pi / 3)


@pytest.mark.parametrize(("crank", "scale"), paired([0.0, -3e-7, 1e-4], [1.0, 1e4]))
def test_the_error_reported_of_a_value_near_zero_is_that_of_its_angle(crank, scale):
    """A joint near its zero is known no better than any other: to round-off of a radian."""
    r, length = 0.05 * scale, 0.16 * scale
    mechanism = library("slider_crank", r=r, l=length)
    state = sp.assemble(mechanism, {"crank": crank}, {"coupler_pin": 0.0, "slide": r + length})
    found = sp.sensitivity(mechanism, state, "coupler_pin", ["r", "l"])
    leaning = np.sin(crank) / np.sqrt(length**2 - (r * np.sin(crank)) ** 2)
    for name, expected in (("r", -leaning), ("l", leaning * r / length)):
        assert abs(found.derivatives[name] - expected) <= found.errors[name]
        assert found.errors[name] < 1e-9 / scale


def test_steps_are_shorter_where_the_branch_ends_at_nearby_dimensions():
    """A crank longer than its coupler, so near its limit that a shorter coupler does not reach."""
    crank, coupler, spare = 0.2, 0.16, 5e-4
    mechanism = library("slider_crank", r=crank, l=coupler)
    state = sp.assemble(mechanism, {"crank": np.arcsin((coupler - spare) / crank)})
    found = sp.sensitivity(mechanism, state, "slide", ["l"])
    wanted = coupler / np.sqrt(coupler**2 - (coupler - spare) ** 2)
    assert abs(abs(found.derivatives["l"]) - wanted) < min(1e-6 * wanted, found.errors["l"])


@pytest.mark.parametrize("over", [1e-3, 1e-6, 1e-8, 1e-10, 1e-12])
def test_the_error_near_a_configuration_with_all_links_in_line_is_a_bound(over):
    """The angle between ground diagonal and rocker is that of a triangle with sides l, r3, r4."""
    mechanism = library("four_bar", r3=0.16 + over)
    found = sp.sensitivity(
        mechanism, sp.assemble(mechanism, {"crank": np.pi}), "rocker_pin", ["r3"])
    with mp.workdps(40):
        r1, r2, r3, r4 = (mpf(mechanism.dimensions[f"r{k}"]) for k in (1, 2, 3, 4))
        crank = mpf(np.pi)
        diagonal = mp.sqrt(r1**2 + r2**2 - 2 * r1 * r2 * mp.cos(crank))
        cosine = (diagonal**2 + r4**2 - r3**2) / (2 * diagonal * r4)
        slope = r3 / (diagonal * r4 * mp.sqrt(1 - cosine**2))
        off = float(abs(abs(mpf(found.derivatives["r3"])) - slope))
    assert off <= found.errors["r3"] < 0.1 * slope


def test_a_derivative_without_a_digit_is_refused():
    """All links of the four-bar are in line at crank = pi: no other coupler has a branch to it."""
    mechanism = library("four_bar", r3=0.16)
    state = sp.assemble(mechanism, {"crank": np.pi - 1e-8})
    with pytest.raises(sp.SpatialPinError, match="no closed configuration of this branch"):
        sp.sensitivity(mechanism, state, "rocker_pin", ["r3"])


# ---------------------------------------------------------------- over a motion


OUTPUTS = ["rocker_pin", "rocker_pin.rate", "rocker_pin.acceleration", "rocker_pin.ratio",
           "coupler.velocity", "rocker_pin.transmission_angle"]


@pytest.mark.parametrize("output", few(
    OUTPUTS, "rocker_pin.acceleration", "coupler.velocity", "rocker_pin.transmission_angle"))
def test_of_a_motion_it_is_that_of_every_sample(output):
    mechanism = library("rssr")
    motion = sp.sweep(mechanism, "crank", np.linspace(0.0, 6.0, 5), 2.0, -1.0)
    found = sp.sensitivity(mechanism, motion, output, ["b", "d"])
    assert found.value == pytest.approx(motion.output(output).values, rel=1e-12, abs=1e-13)
    assert found.unit == motion.output(output).unit and "d/d b" in str(found)
    for k in range(len(motion)):
        alone = sp.sensitivity(mechanism, motion.state(k), output, ["b", "d"])
        for name in ("b", "d"):
            size = np.abs(alone.derivatives[name]).max()
            np.testing.assert_allclose(found.derivatives[name][k], alone.derivatives[name],
                                       rtol=0, atol=1e-13 * size)
            assert found.errors[name][k] == pytest.approx(alone.errors[name], rel=1e-6)


@pytest.mark.parametrize(("name", "driver", "output", "dimension"), [
    pytest.param("rssr", "crank", "rocker_pin", "a", marks=pytest.mark.slow),
    ("rspc", "crank", "rod.acceleration", "alpha"),
    ("four_bar", "rocker_pin", "crank_pin.rate", "r2"),
    pytest.param("stewart", "leg_1", "platform.position", "rb", marks=pytest.mark.slow)])
def test_of_a_motion_it_is_how_motions_of_changed_files_differ(name, driver, output, dimension):
    """By differences of sweeps; a joint that is no driver is held too where it is swept."""
    mechanism = sp.load(name)
    start = sp.assemble(mechanism).coordinate(driver).value
    values = start + 0.1 * np.linspace(0.1, 1.0, 4)
    motion = sp.sweep(mechanism, driver, values, 1.5)
    found = sp.sensitivity(mechanism, motion, output, [dimension]).derivatives[dimension]
    own, h = mechanism.dimensions[dimension], 1e-3 * mechanism.dimensions[dimension]
    others = []
    for k in (-2, -1, 1, 2):
        changed = sp.load(name, **{dimension: own + k * h})
        drivers = {driver: start} if driver in mechanism.drivers else {}
        guess = sp.assemble(changed, drivers, guess=motion.state(0))
        others.append(sp.sweep(changed, driver, values, 1.5, guess=guess).output(output).values)
    a, b, c, d = others
    expected = (a - 8 * b + 8 * c - d) / (12 * h)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-7 * np.abs(expected).max())
    assert found.shape == motion.output(output).values.shape


def test_wrong_names_are_refused_of_a_motion_too(rssr):
    motion = sp.sweep(rssr[0], "crank", [1.0, 1.1])
    with pytest.raises(sp.SpatialPinError, match="no dimension 'bb'"):
        sp.sensitivity(rssr[0], motion, "rocker_pin", ["bb"])
    with pytest.raises(sp.SpatialPinError, match="rocker_pin"):
        sp.sensitivity(rssr[0], motion, "rocker_pim", ["b"])
    with pytest.raises(TypeError, match="a State or Motion is needed"):
        sp.sensitivity(rssr[0], 3.0, "rocker_pin")


BEAM = """<robot name="beam" xmlns:xacro="{address}">
  <xacro:arg name="length" default="0.4"/> <xacro:arg name="mass" default="2.0"/>
  <xacro:property name="half" value="${{$(arg length) / 2}}"/>
  <link name="base"/>
  <link name="beam"><inertial><mass value="${{$(arg mass) * $(arg length)}}"/>
    <origin xyz="${{half}} 0 0"/>
    <inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="hinge" type="continuous">
    <parent link="base"/> <child link="beam"/> <axis xyz="0 -1 0"/>
  </joint>
</robot>
"""


@pytest.fixture
def beam(tmp_path):
    """A beam on a driven hinge, whose mass grows with its length: mass m l, centre at l / 2."""
    (tmp_path / "beam.urdf.xacro").write_text(BEAM.format(address="http://www.ros.org/wiki/xacro"))
    (tmp_path / "beam.toml").write_text('name = "beam"\ntree = "beam.urdf.xacro"\n')
    return sp.load(tmp_path / "beam.toml")


def test_forces_change_with_dimensions_and_the_masses_these_make(beam):
    angle, speed, g, length, m = 0.7, 3.0, 9.81, 0.4, 2.0
    state = sp.assemble(beam, {"hinge": angle})
    effort = sp.sensitivity(beam, state, "hinge.effort")
    assert effort.unit == "N·m"
    assert effort.value == pytest.approx(m * g * length**2 / 2 * np.cos(angle), rel=1e-13)
    assert effort.derivatives["length"] == pytest.approx(m * g * length * np.cos(angle), rel=1e-9)
    assert effort.derivatives["mass"] == pytest.approx(g * length**2 / 2 * np.cos(angle), rel=1e-9)
    assert 0.0 < effort.errors["length"] < 1e-6
    moving = sp.solve_rates(beam, state, speeds={"hinge": speed})
    pull = sp.sensitivity(beam, moving, "hinge.reaction")
    inward = -m * length * speed**2 * np.array([np.cos(angle), 0.0, np.sin(angle)])
    assert pull.derivatives["length"][:3] == pytest.approx(
        inward + np.array([0.0, 0.0, m * g]), rel=1e-9, abs=1e-9)
    power = sp.sensitivity(beam, moving, "hinge.power")
    assert power.value == pytest.approx(speed * effort.value, rel=1e-13)


def test_forces_of_a_motion_without_speed_are_those_at_rest(beam):
    motion = sp.sweep(beam, "hinge", [0.1, 0.7])
    found = sp.sensitivity(beam, motion, "hinge.reaction.force", ["length"])
    assert found.unit == "N"
    assert found.derivatives["length"] == pytest.approx(
        np.tile([0.0, 0.0, 2.0 * 9.81], (2, 1)), rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("number", few([40, 300], 40))
def test_forces_scatter_with_dimensions(beam, number):
    state = sp.assemble(beam, {"hinge": 0.0})
    names = ["hinge.effort", "hinge.reaction", "hinge"]
    found = sp.tolerance(beam, names, {"length": 1e-3}, state, samples=number)
    length = found.dimensions["length"]
    assert found.samples["hinge.effort"] == pytest.approx(9.81 * length**2, rel=1e-12)
    assert found.samples["hinge.reaction"].shape == (number, 6)
    assert found.linear["hinge.effort"] == pytest.approx(2.0 * 9.81 * 0.4 * 1e-3, rel=1e-9)
    heads = found.to_csv(outputs=["hinge.reaction"]).splitlines()[0].split(",")
    assert heads[0] == "hinge reaction force x [N]" and heads[-1] == "hinge reaction moment z [N·m]"


IDLE = """<robot name="idle" xmlns:xacro="http://www.ros.org/wiki/xacro">
<xacro:arg name="length" default="0.4"/> <xacro:arg name="paint" default="0.3"/>
<xacro:arg name="wear" default="0.0"/> <xacro:property name="worn" value="$(arg wear)"/>
<xacro:arg name="mass" default="2.0"/>
<link name="ground"/> <link name="bar"><inertial><mass value="$(arg mass)"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link> <link name="tip"/>
<joint name="hinge" type="continuous"><parent link="ground"/><child link="bar"/></joint>
<joint name="end" type="fixed"><parent link="bar"/><child link="tip"/>
<origin xyz="$(arg length) 0 0"/></joint>{more}</robot>"""
ROUNDED = '<link name="far${round(1e4 * $(arg length))}"/>'  # a name: nothing follows it


@pytest.fixture(params=["", ROUNDED], ids=["traced", "expanded"])
def idle(request, tmp_path):
    file = tmp_path / "idle.urdf.xacro"
    more = request.param and (request.param + '<joint name="far" type="fixed"><parent link="bar"/>'
                              f'<child link={request.param[11:-2]}/></joint>')
    file.write_text(IDLE.replace("{more}", more))
    return sp.load(file)


def test_dimensions_that_change_nothing_are_reported(idle):
    state = sp.assemble(idle, {"hinge": 0.5})
    found = sp.sensitivity(idle, state, "tip.position")
    assert found.idle == ("paint", "wear")  # the mass changes the file, though not the output
    assert "d/d paint = 0: it changes nothing in the file" in str(found)
    assert sp.sensitivity(idle, state, "tip.position", ["length", "mass"]).idle == ()
    with pytest.warns(sp.SpatialPinWarning, match="wear changes nothing in"):
        sp.sensitivity(idle, state, "tip.position", ["wear", "length"])
    with pytest.warns(sp.SpatialPinWarning, match="paint changes nothing in"):
        sp.tolerance(idle, "tip.position", {"length": 1e-3, "paint": 0.1, "mass": 0.1}, state)
    with pytest.warns(sp.SpatialPinWarning, match="paint, wear change nothing in"):
        sp.design(idle, sp.goals.path("tip", [[0.5, 0.0, 0.0]], drivers={"hinge": [0.0]}),
                  {"length": (0.3, 0.6), "paint": (0.0, 1.0), "wear": (0.0, 1.0)}, method="local")


def test_forces_that_do_not_exist_are_refused(beam):
    state = sp.assemble(beam)
    for name in ("hinje.effort", "beam.reaction"):
        with pytest.raises(sp.SpatialPinError, match="no force"):
            sp.sensitivity(beam, state, name)


@pytest.mark.parametrize("address", ["http://wiki.ros.org/anything", "http://ros.org/wiki/xacro"])
def test_arguments_are_dimensions_whatever_address_the_prefix_has(tmp_path, address):
    file = tmp_path / "beam.urdf.xacro"
    file.write_text(BEAM.format(address=address))
    assert sp.load(file).dimensions == {"length": 0.4, "mass": 2.0}


def test_a_file_without_dimensions_has_no_derivatives(tmp_path):
    file = tmp_path / "fixed.urdf.xacro"
    text = BEAM.format(address="http://www.ros.org/wiki/xacro")
    file.write_text(text.replace("$(arg length)", "0.4").replace("$(arg mass)", "2").replace(
        '<xacro:arg name="length" default="0.4"/> <xacro:arg name="mass" default="2.0"/>', ""))
    mechanism = sp.load(file)
    for output in ("hinge", "hinge.effort"):
        assert sp.sensitivity(mechanism, sp.assemble(mechanism), output).derivatives == {}
