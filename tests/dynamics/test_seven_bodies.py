"""Andrews' squeezing mechanism and a spatial R-S-U-P, against formulations of their own.

The squeezer: seven bodies in the plane, three loops, a spring [HairerWanner1996, VII.7; Andrews and
Ormrod 1986]; mass matrix, forces and constraints are those printed there, solved in mpmath.
R-S-U-P: one coordinate, energies from poses in closed form.
"""

from __future__ import annotations

import mechanisms as known
import mpmath
import numpy as np
import pytest
from masses import heavy
from mpmath import cos, mpf, sin, sqrt
from rsup import CUTS, WEIGHTS, poses, rsup

import spatial_pin as sp

# ---------------------------------------------------------------- the squeezer

MASS = dict(enumerate(("0.04325", "0.00365", "0.02373", "0.00706", "0.07050", "0.00706",
                       "0.05498"), start=1))
INERTIA = dict(enumerate(("2.194e-6", "4.410e-7", "5.255e-6", "5.667e-7", "1.169e-5", "5.667e-7",
                          "1.912e-5"), start=1))
A, B, C = ("-0.06934", "-0.00227"), ("-0.03635", "0.03273"), ("0.014", "0.072")
SIZES = {"d": "0.028", "da": "0.0115", "e": "0.02", "ea": "0.01421", "zf": "0.02", "fa": "0.01421",
         "rr": "0.007", "ra": "0.00092", "ss": "0.035", "sa": "0.01874", "sb": "0.01043",
         "sc": "0.018", "sd": "0.02", "ta": "0.02308", "tb": "0.00916", "u": "0.04",
         "ua": "0.01228", "ub": "0.00449", "zt": "0.04"}
STIFFNESS, FREE, TORQUE = "4530", "0.07785", "0.033"
ANGLES = ("beta", "theta", "gamma", "phi", "delta", "omega", "epsilon")
START = ("-0.0617138900142764496358948458001", "0", "0.455279819163070380255912382449",
         "0.222668390165885884674473185609", "0.487364979543842550225598953530",
         "-0.222668390165885884674473185609", "1.23054744454982119249735015568")
AT_REST = (14222.4439199541138705911625887, -10666.8329399655854029433719415, 0, 0, 0, 0, 0)
# at 0.03 s: reference solution of the Test Set for IVP Solvers [MazziaMagherini2008]
AT_END = (15.81077119629904, -15.75637105984298, 0.04082224013073101, -0.5347301163226948,
          0.5244099658805304, 0.5347301163226948, 1.048080741042263)


def squeezer(folder):
    s = {k: float(v) for k, v in SIZES.items()}
    a, b, c = ((*map(float, p), 0.0) for p in (A, B, C))
    weight = {f"k{i}": (float(MASS[i]), com, tuple(x * float(INERTIA[i]) for x in (
        0.5, 0.5, 1.0))) for i, com in (
        (1, (s["ra"], 0, 0)), (2, (-s["da"], 0, 0)), (3, (s["sb"], -s["sa"], 0)),
        (4, (0, s["ea"] - s["e"], 0)), (5, (s["ta"], s["tb"], 0)),
        (6, (s["zf"] - s["fa"], 0, 0)), (7, (s["ua"], s["ub"], 0)))}
    tree = (known.turning("beta", "ground", "k1") + known.turning("theta", "k1", "k2",
                                                                  (s["rr"], 0, 0))
            + known.turning("gamma", "ground", "k3", b) + known.turning("delta", "ground", "k5", a)
            + known.turning("phi", "k5", "k4", (s["zt"], 0, 0))
            + known.turning("epsilon", "ground", "k7", a)
            + known.turning("omega", "k7", "k6", (0, -s["u"], 0)))
    tree = heavy(tree, **weight)
    for name, on, xyz in (("p2", "k2", (-s["d"], 0, 0)), ("p3", "k3", (0, -s["ss"], 0)),
                          ("p4", "k4", (0, -s["e"], 0)), ("p6", "k6", (s["zf"], 0, 0)),
                          ("eye", "k3", (s["sd"], -s["sc"], 0)), ("anchor", "ground", c)):
        tree += known.point(name, on, xyz)
    toml = (f'gravity = [0.0, 0.0, 0.0]\n[[springs]]\nname = "spring"\nframes = ["eye", "anchor"]\n'
            f"stiffness = {float(STIFFNESS)}\nfree_length = {FREE}\n")
    toml += "".join(known.closure(f"pin{k}", "revolute", "p2", f"p{k}") for k in (3, 4, 6))
    toml += known.driver("motor", "beta") + known.guess(**{
        name: float(x) for name, x in zip(ANGLES, START, strict=True)})
    return known.load(folder, "squeezer", tree, toml)


def printed(q, v):
    """Accelerations by the printed equations; q, v by ANGLES (mpf)."""
    s, m, i = ({k: mpf(x) for k, x in d.items()} for d in (SIZES, MASS, INERTIA))
    (xa, ya), (xb, yb), (xc, yc) = ([mpf(x) for x in p] for p in (A, B, C))
    _, th, ga, ph, _, om, _ = q
    vb, vt, _, vp, vd, vo, ve = v
    d, da, e, zf, rr, ss, sc, sd, zt, u = (s[k] for k in (
        "d", "da", "e", "zf", "rr", "ss", "sc", "sd", "zt", "u"))
    ee, zff = s["e"] - s["ea"], s["zf"] - s["fa"]
    mass = mpmath.zeros(7)
    mass[0, 0] = m[1] * s["ra"]**2 + m[2] * (rr**2 - 2 * da * rr * cos(th) + da**2) + i[1] + i[2]
    mass[0, 1] = mass[1, 0] = m[2] * (da**2 - da * rr * cos(th)) + i[2]
    mass[1, 1] = m[2] * da**2 + i[2]
    mass[2, 2] = m[3] * (s["sa"]**2 + s["sb"]**2) + i[3]
    mass[3, 3] = m[4] * ee**2 + i[4]
    mass[3, 4] = mass[4, 3] = m[4] * (ee**2 + zt * ee * sin(ph)) + i[4]
    mass[4, 4] = (m[4] * (zt**2 + 2 * zt * ee * sin(ph) + ee**2)
                  + m[5] * (s["ta"]**2 + s["tb"]**2) + i[4] + i[5])
    mass[5, 5] = m[6] * zff**2 + i[6]
    mass[5, 6] = mass[6, 5] = m[6] * (zff**2 - u * zff * sin(om)) + i[6]
    mass[6, 6] = (m[6] * (zff**2 - 2 * u * zff * sin(om) + u**2)
                  + m[7] * (s["ua"]**2 + s["ub"]**2) + i[6] + i[7])
    xd, yd = sd * cos(ga) + sc * sin(ga) + xb, sd * sin(ga) - sc * cos(ga) + yb
    length = sqrt((xd - xc)**2 + (yd - yc)**2)
    pull = -mpf(STIFFNESS) * (length - mpf(FREE)) / length
    fx, fy = pull * (xd - xc), pull * (yd - yc)
    force = mpmath.matrix([
        mpf(TORQUE) - m[2] * da * rr * vt * (vt + 2 * vb) * sin(th),
        m[2] * da * rr * vb**2 * sin(th),
        fx * (sc * cos(ga) - sd * sin(ga)) + fy * (sd * cos(ga) + sc * sin(ga)),
        m[4] * zt * ee * vd**2 * cos(ph), -m[4] * zt * ee * vp * (vp + 2 * vd) * cos(ph),
        -m[6] * u * zff * ve**2 * cos(om), m[6] * u * zff * vo * (vo + 2 * ve) * cos(om)])

    def closed(*x):
        be, th, ga, ph, de, om, ep = x
        x2, y2 = rr * cos(be) - d * cos(be + th), rr * sin(be) - d * sin(be + th)
        return (x2 - ss * sin(ga) - xb, y2 + ss * cos(ga) - yb,
                x2 - e * sin(ph + de) - zt * cos(de) - xa,
                y2 + e * cos(ph + de) - zt * sin(de) - ya,
                x2 - zf * cos(om + ep) - u * sin(ep) - xa,
                y2 - zf * sin(om + ep) + u * cos(ep) - ya)

    k, rhs = mpmath.zeros(13), mpmath.zeros(13, 1)
    k[:7, :7], rhs[:7, 0] = mass, force
    for row in range(6):
        for column in range(7):
            order = tuple(int(column == c) for c in range(7))
            k[7 + row, column] = k[column, 7 + row] = mpmath.diff(
                lambda *x, row=row: closed(*x)[row], tuple(q), order)
        rhs[7 + row] = -mpmath.diff(lambda t, row=row: closed(*(a + t * b for a, b in zip(
            q, v, strict=True)))[row], 0, 2)
    return mpmath.lu_solve(k, rhs)[:7], [abs(x) for x in closed(*q)]


def by_angle(mech, values):
    out = np.zeros(mech.model.nv)
    for name, x in zip(ANGLES, values, strict=True):
        out[mech.coordinate(name).v] = float(x)
    return out


def test_the_squeezer_starts_as_published(tmp_path):
    mech = squeezer(tmp_path)
    state = sp.State(mech, by_angle(mech, START), closure_error=0.0)
    answer = sp.forward_dynamics(mech, state, {"motor": float(TORQUE)})
    want = by_angle(mech, AT_REST)
    assert answer.a == pytest.approx(want, abs=1e-10 * np.abs(want).max())
    with mpmath.workdps(40):
        again, gaps = printed([mpf(x) for x in START], [mpf(0)] * 7)
        assert max(gaps) < mpf("1e-28")
        assert by_angle(mech, again) == pytest.approx(want, rel=1e-15, abs=1e-15)


@pytest.mark.parametrize("beta", [0.4, 2.5])
def test_the_squeezer_moving_by_the_printed_equations(beta, tmp_path):
    mech = squeezer(tmp_path)
    motion = sp.sweep(mech, "motor", np.linspace(float(START[0]), beta, 40), speed=180.0)
    state = sp.State(mech, motion.q[-1], motion.v[-1], closure_error=motion.closure_error[-1])
    answer = sp.forward_dynamics(mech, state, {"motor": float(TORQUE)})
    with mpmath.workdps(40):
        q, v = ([mpf(float(x[mech.coordinate(name).v])) for name in ANGLES]
                for x in (state.q, state.v))
        want, _ = printed(q, v)
    want = by_angle(mech, want)
    assert answer.a == pytest.approx(want, abs=1e-10 * np.abs(want).max())


def test_the_squeezer_after_thirty_milliseconds(tmp_path):
    mech = squeezer(tmp_path)
    start = sp.State(mech, by_angle(mech, START), closure_error=0.0)
    motion = sp.simulate(mech, start, 0.03, {"motor": float(TORQUE)}, times=[0.0, 0.03],
                         accuracy=sp.Accuracy.named("reference"))
    assert motion.q[-1] == pytest.approx(by_angle(mech, AT_END), abs=5e-9)
    assert motion.closure_error.max() < 1e-12


# ---------------------------------------------------------------- R-S-U-P





def kinetic(phi):
    """Twice the kinetic energy per squared rate of the crank, and the potential energy."""
    step = mpf("1e-12")  # central differences are good to its square
    at, ahead, behind = (poses(x)[0] for x in (phi, phi + step, phi - step))
    inertia, height = mpf(0), mpf(0)
    for name, (mass, com, moments) in WEIGHTS.items():
        turn, place = at[name]
        lever = mpmath.matrix([mpf(x) for x in com])
        rate, pace = ((x - y) / (2 * step) for x, y in zip(ahead[name], behind[name], strict=True))
        velocity = pace + rate * lever
        spin = turn.T * rate
        omega = (spin[2, 1], spin[0, 2], spin[1, 0])
        inertia += mpf(mass) * sum(x**2 for x in velocity)
        inertia += sum(mpf(i) * w**2 for i, w in zip(moments, omega, strict=True))
        height += mpf(mass) * mpf("9.81") * (place + turn * lever)[2]
    return inertia, height


def crank_acceleration(phi, rate, torque):
    phi = mpf(phi)
    slope = mpmath.diff(lambda t: kinetic(t)[0], phi)
    fall = mpmath.diff(lambda t: kinetic(t)[1], phi)
    return (mpf(torque) - slope * mpf(rate)**2 / 2 - fall) / kinetic(phi)[0]


@pytest.mark.parametrize("phi", [0.3, 2.9])
@pytest.mark.parametrize("cut", CUTS)
def test_an_rsup_moves_by_its_energies(cut, phi, tmp_path):
    """Cut at any of its pairs; without torque where the crank is no joint."""
    rate, torque = 3.1, 0.0 if cut == "R" else 0.4
    mech = rsup(tmp_path, cut, phi)
    with mpmath.workdps(50):
        acceleration = crank_acceleration(phi, rate, torque)
        slide, speed, bend = mpmath.taylor(lambda t: poses(t)[1][0], mpf(phi), 2)
        want = float(acceleration), float(speed * acceleration + 2 * bend * mpf(rate)**2)
    driven = {"motor": (float(slide), float(speed) * rate) if cut == "R" else (phi, rate)}
    state = sp.assemble(mech, {"motor": driven["motor"][0]})
    state = sp.solve_rates(mech, state, {"motor": driven["motor"][1]})
    answer = sp.forward_dynamics(mech, state, {"motor": torque})
    found = [answer.state.angular_acceleration("crank") @ answer.state.placement("crank").rotation[
        :, 2], answer.state.acceleration("slider").linear[0]]
    assert state.placement("slider").translation[0] == pytest.approx(float(slide), abs=1e-12)
    assert found == pytest.approx(want, rel=1e-10)
    assert all(answer.determined.values())


def test_the_pairs_of_an_rsup_bear_the_same_wherever_it_is_cut(tmp_path):
    """Up to which of its two bodies a reaction counts for."""
    found = {}
    for cut in ("S", "U", "P"):
        mech = rsup(tmp_path, cut, 0.9)
        state = sp.solve_rates(mech, sp.assemble(mech, {"motor": 0.9}), {"motor": 3.1})
        reactions = sp.forward_dynamics(mech, state, {"motor": 0.4}).reactions
        assert set(reactions) == set("RSUP")
        found[cut] = {name: reactions[name].linear for name in "RSUP"}
    for cut in ("U", "P"):
        for name, force in found[cut].items():
            sense = 1.0 if force @ found["S"][name] > 0 else -1.0
            assert sense * force == pytest.approx(found["S"][name], rel=1e-9, abs=1e-9), name
