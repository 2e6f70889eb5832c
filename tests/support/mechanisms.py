"""Small mechanisms written as URDF and TOML text, each with a known answer.

`KNOWN` lists them; every test that is parametrised over it also tests a new entry. A builder
takes the folder to write to. Closed forms return the coordinates at a driver value (mpmath), as
`closed_forms.Pose`, smooth over the range of the sweep. Sources: the relations are those of plane
and spatial trigonometry, Freudenstein's equation, and Bennett's and Bricard's loops
[McCarthy2011, Baker1979].
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import closed_forms
import numpy as np
import pinocchio as pin
from closed_forms import Pose, rotation, vector
from loaded_library import library
from mpmath import acos, asin, atan2, cos, findroot, mpf, pi as mp_pi, sin, sqrt, tan

import spatial_pin as sp

# ---------------------------------------------------------------- text


def from_text(urdf: str, content: Mapping[str, Any], name: str) -> sp.Mechanism:
    """Return the mechanism of plain URDF text and of a mechanism file as `tomllib` reads it."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"{name.removesuffix('.toml')}.toml"
        tree = path.with_suffix(".urdf")
        tree.write_text(urdf, encoding="utf-8")
        lines = {**content, "tree": tree.name}.items()
        path.write_text("".join(f"{key} = {toml_of(value)}\n" for key, value in lines), "utf-8")
        return sp.load(path).with_fields(path=None, tree=None)


def from_tree(name: str, tree: str, **content: Any) -> sp.Mechanism:
    """Return the mechanism of a tree below link `ground`, of which no file is kept."""
    urdf = f'<robot name="{name}">\n<link name="ground"/>\n{tree}</robot>\n'
    return from_text(urdf, {"name": name, **content}, name)


def toml_of(value: Any) -> str:
    """A value as TOML has it in one line."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{json.dumps(k)} = {toml_of(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list | tuple | np.ndarray):
        return "[" + ", ".join(map(toml_of, value)) + "]"
    if isinstance(value, float):
        return repr(float(value))
    return json.dumps(value)


def content_of(mechanism: sp.Mechanism) -> dict[str, Any]:
    """Return what the mechanism's own file says, as `tomllib` reads it."""
    with TemporaryDirectory() as folder:
        return tomllib.loads(mechanism.save(folder).read_text(encoding="utf-8"))


def words(values) -> str:
    return " ".join(repr(float(x)) for x in values)


def rpy_facing(z, x=None) -> tuple[float, ...]:
    """Roll, pitch, yaw of a frame whose z axis points along `z` (and x near `x`)."""
    z = np.array(z, float) / np.linalg.norm(z)
    hint = np.array(x, float) if x is not None else np.eye(3)[np.argmin(np.abs(z))]
    x_axis = hint - (hint @ z) * z
    x_axis /= np.linalg.norm(x_axis)
    return tuple(pin.rpy.matrixToRpy(np.column_stack([x_axis, np.cross(z, x_axis), z])))


def joint(kind, name, parent, child, xyz=(0, 0, 0), rpy=(0, 0, 0), axis=None, limits=None) -> str:
    """A URDF joint and its child link."""
    text = f'<link name="{child}"/>\n<joint name="{name}" type="{kind}">'
    text += f'<parent link="{parent}"/><child link="{child}"/>'
    text += f'<origin xyz="{words(xyz)}" rpy="{words(rpy)}"/>'
    if axis is not None:
        text += f'<axis xyz="{words(axis)}"/>'
    if limits is not None:
        text += f'<limit lower="{limits[0]!r}" upper="{limits[1]!r}" effort="1e6" velocity="1e6"/>'
    return text + "</joint>\n"


def turning(name, parent, child, xyz=(0, 0, 0), axis=(0, 0, 1), rpy=(0, 0, 0)) -> str:
    return joint("continuous", name, parent, child, xyz, rpy, axis)


def sliding(name, parent, child, xyz=(0, 0, 0), axis=(0, 0, 1), rpy=(0, 0, 0)) -> str:
    return joint("prismatic", name, parent, child, xyz, rpy, axis, (-1e3, 1e3))


def floating(name, parent, child, xyz=(0, 0, 0), rpy=(0, 0, 0)) -> str:
    """To be refined in the TOML text."""
    return joint("floating", name, parent, child, xyz, rpy)


def point(name, on, xyz=(0, 0, 0), rpy=(0, 0, 0)) -> str:
    return joint("fixed", f"{name}_mount", on, name, xyz, rpy)


def load(folder: Path, name: str, tree: str, toml: str) -> sp.Mechanism:
    """Write the tree below link `ground` and the mechanism file, and load them."""
    (folder / f"{name}.urdf").write_text(
        f'<robot name="{name}">\n<link name="ground"/>\n{tree}</robot>\n', encoding="utf-8"
    )
    path = folder / f"{name}.toml"
    path.write_text(f'name = "{name}"\ntree = "{name}.urdf"\n{toml}', encoding="utf-8")
    return sp.load(path)


CURVE = "[curves.{}]\nellipse = {{semi_axes = [0.3, 0.2]}}\n"


def closure(name, kind, first, second, **keys) -> str:
    lines = [f'name = "{name}"', f'type = "{kind}"', f'frames = ["{first}", "{second}"]']
    plain = {key: v if isinstance(v, str | Mapping) or key == "curves" else np.asarray(
        v, float).tolist() for key, v in keys.items()}
    lines += [f"{key} = {toml_of(v)}" for key, v in plain.items()]
    names = {keys["curve"]} if "curve" in keys else set(keys.get("curves", ()))
    curve = "".join(map(CURVE.format, sorted(names)))
    return "[[closures]]\n" + "\n".join(lines) + "\n" + curve


def between(name, frames, others) -> str:
    """A distance between two frames that is that of two others."""
    pairs = ["[" + ", ".join(f'"{f}"' for f in pair) + "]" for pair in (frames, others)]
    return (f'[[closures]]\nname = "{name}"\ntype = "distance"\nframes = {pairs[0]}\n'
            f"length_between = {pairs[1]}\n")


def coupling(name, first, second, ratio, offset=0.0) -> str:
    return (f'[[closures]]\nname = "{name}"\ntype = "coupling"\njoints = ["{first}", "{second}"]\n'
            f"ratio = {ratio!r}\noffset = {offset!r}\n")


def driver(name, joint_name) -> str:
    return f'[drivers.{name}]\njoint = "{joint_name}"\n'


def refine(name, kind, **keys) -> str:
    lines = [f"{key} = {list(map(float, v)) if np.ndim(v) else repr(float(v))}"
             for key, v in keys.items()]
    return f'[joints.{name}]\ntype = "{kind}"\n' + "\n".join(lines) + "\n"


def guess(**values) -> str:
    lines = [f'"{k}" = {list(map(float, v)) if np.ndim(v) else repr(float(v))}'
             for k, v in values.items()]
    return "[guess]\n" + "\n".join(lines) + "\n"


TILT = {"xyz": (0.3, -0.2, 0.5), "rpy": (0.4, -0.7, 1.1)}


def tilted(tree: str) -> str:
    """The same tree on a base that is moved and turned."""
    return point("base", "ground", **TILT) + tree.replace('"ground"', '"base"')


# ---------------------------------------------------------------- slider-crank, cut anywhere

R, L, E = 0.05, 0.16, 0.02  # crank, rod, offset; in the x-y plane, all axes along z
CRANK = turning("main_pin", "ground", "crank")
RAIL = sliding("slide", "ground", "slider", (0, E, 0), (1, 0, 0))


def cut_at_wrist_pin(folder: Path, wrap=str) -> sp.Mechanism:
    tree = (CRANK + turning("crank_pin", "crank", "rod", (R, 0, 0)) + RAIL
            + point("rod_end", "rod", (L, 0, 0)))
    return load(folder, "cut_at_wrist_pin", wrap(tree), driver("crank", "main_pin") + closure(
        "wrist_pin", "revolute", "rod_end", "slider") + guess(crank_pin=-0.1, slide=0.2))


def cut_at_crank_pin(folder: Path, wrap=str) -> sp.Mechanism:
    tree = (CRANK + point("crank_end", "crank", (R, 0, 0)) + RAIL
            + turning("wrist_pin", "slider", "rod") + point("rod_end", "rod", (-L, 0, 0)))
    return load(folder, "cut_at_crank_pin", wrap(tree), driver("crank", "main_pin") + closure(
        "crank_pin", "revolute", "crank_end", "rod_end") + guess(wrist_pin=-0.1, slide=0.2))


def cut_at_slide(folder: Path, wrap=str) -> sp.Mechanism:
    tree = (CRANK + turning("crank_pin", "crank", "rod", (R, 0, 0))
            + turning("slider_pin", "rod", "slider", (L, 0, 0)) + point("rail", "ground", (0, E,
                                                                                           0)))
    return load(folder, "cut_at_slide", wrap(tree), driver("crank", "main_pin") + closure(
        "slide", "prismatic", "rail", "slider", axis=(1, 0, 0)) + guess(crank_pin=-0.1))


def cut_at_main_pin(folder: Path, wrap=str) -> sp.Mechanism:
    tree = (RAIL + turning("wrist_pin", "slider", "rod") + point("bearing", "ground")
            + turning("crank_pin", "rod", "crank", (-L, 0, 0)) + point("hub", "crank", (-R, 0, 0)))
    return load(folder, "cut_at_main_pin", wrap(tree), driver("slider", "slide") + closure(
        "main_pin", "revolute", "bearing", "hub") + guess(wrist_pin=-0.1, crank_pin=1.0,
                                                          slide=0.17))


def slider_crank(phi) -> Pose:
    r, l, e = map(mpf, (R, L, E))  # noqa: E741
    rod = asin((e - r * sin(phi)) / l)
    x = r * cos(phi) + sqrt(l**2 - (r * sin(phi) - e) ** 2)
    return Pose({"main_pin": phi, "crank_pin": rod - phi, "wrist_pin": rod,
                 "slider_pin": -rod, "slide": x}, {}, {})


def slider_crank_from_slide(x) -> Pose:
    r, l, e = map(mpf, (R, L, E))  # noqa: E741
    reach = sqrt(x**2 + e**2)
    phi = atan2(e, x) + acos((r**2 + reach**2 - l**2) / (2 * r * reach))
    rod = atan2(e - r * sin(phi), x - r * cos(phi))
    return Pose({"slide": x, "wrist_pin": rod, "crank_pin": phi - rod}, {}, {})


# ---------------------------------------------------------------- spatial four-bars


def rssr_with_a_rod(folder: Path) -> sp.Mechanism:
    """The RSSR whose coupler is one distance equation."""
    a, b, c, d = 0.102, 0.381, 0.254, 0.314
    tree = (turning("crank_pin", "ground", "crank", axis=(0, 1, 0)) + point("a", "crank", (-a, 0,
                                                                                           0))
            + turning("rocker_pin", "ground", "rocker", (-d, 0, 0), (0, 0, -1))
            + point("b", "rocker", (-c, 0, 0)))
    return load(folder, "rssr_with_a_rod", tree, driver("crank", "crank_pin") + closure(
        "coupler", "distance", "a", "b", length=b) + guess(rocker_pin=1.2))


RAM = {"arm": (0.3, 0.0, 0.1), "anchor": (0.4, 0.0, 0.0), "along": (0.0, 0.6, 0.8),
       "start": (0.02, 0.03, -0.01)}


def arm_on_a_ram(folder: Path) -> sp.Mechanism:
    """An arm about z whose tip is as far from its anchor as a slide elsewhere is long."""
    tree = (turning("shoulder", "ground", "arm") + point("tip", "arm", RAM["arm"])
            + point("anchor", "ground", RAM["anchor"])
            + point("foot", "ground", (0.1, 0.2, 0.3)) + point("heel", "ground", (0.1, 0.2, 0.3))
            + sliding("stroke", "ground", "piston", (0.1, 0.2, 0.3), RAM["along"])
            + point("end", "piston", RAM["start"]))
    return load(folder, "arm_on_a_ram", tree, driver("ram", "stroke") + between(
        "rod", ("anchor", "tip"), ("foot", "end")) + guess(shoulder=1.0, stroke=0.3))


def ram_answer(stroke) -> Pose:
    (r, _, k), (d, _, _) = (vector(*RAM[name]) for name in ("arm", "anchor"))
    length = vector(*RAM["start"]) + stroke * vector(*RAM["along"])
    cosine = (r**2 + d**2 + k**2 - length.dot(length)) / (2 * r * d)
    return Pose({"stroke": stroke, "shoulder": acos(cosine)}, {}, {})


RSSP = {"crank": 0.1, "rod": 0.4, "start": (0.15, 0.05, 0.0), "along": (0.6, 0.0, 0.8)}


def rssp(folder: Path) -> sp.Mechanism:
    """Crank about z, slider along an inclined line, rod with two balls."""
    tree = (turning("crank_pin", "ground", "crank") + floating("ball_a", "crank", "rod", (0.1, 0,
                                                                                          0))
            + point("rod_b", "rod", (0, 0, 0.4))
            + sliding("slide", "ground", "slider", RSSP["start"], RSSP["along"]))
    toml = (refine("ball_a", "spherical") + driver("crank", "crank_pin")
            + closure("ball_b", "spherical", "rod_b", "slider")
            + '[passive.spin]\nbody = "rod"\naxis = ["ball_a", "rod_b"]\n' + guess(slide=0.35))
    return load(folder, "rssp", tree, toml)


def rssp_answer(theta) -> Pose:
    u, start = (vector(*RSSP[k]) for k in ("along", "start"))
    d = start - mpf(RSSP["crank"]) * vector(cos(theta), sin(theta), 0)
    slide = -u.dot(d) + sqrt(u.dot(d) ** 2 - d.dot(d) + mpf(RSSP["rod"]) ** 2)
    return Pose({"crank_pin": theta, "slide": slide}, {}, {})


RSCR_AXIS, RSCR_P0, RSCR_N0, RSCR_H = (0.0, 0.6, 0.8), (0.3, 0.05, 0.1), (0.8, -0.6, 0.0), 0.25
RSCR_CRANK = (0.1, -0.2, 0.25)  # centre of the input crank


def rscr(folder: Path) -> sp.Mechanism:
    """Crank about z with the ball, output about an inclined axis with the cylindrical pair."""
    side = np.cross(RSCR_N0, (0, 0, 1.0))  # from the cylinder's axis to the ball
    tree = (turning("crank_pin", "ground", "crank", RSCR_CRANK) + point("ball", "crank", (0.1, 0,
                                                                                          0))
            + turning("output_pin", "ground", "output", axis=RSCR_AXIS)
            + floating("guide", "output", "coupler", RSCR_P0)
            + point("coupler_ball", "coupler", RSCR_H * side))
    toml = (refine("guide", "cylindrical", axis=RSCR_N0) + driver("crank", "crank_pin")
            + closure("ball", "spherical", "ball", "coupler_ball")
            + guess(crank_pin=0.0, output_pin=-0.1))
    return load(folder, "rscr", tree, toml)


def rscr_answer(theta) -> Pose:
    u, p0, n0 = vector(*RSCR_AXIS), vector(*RSCR_P0), vector(*RSCR_N0)
    ball = vector(*RSCR_CRANK) + mpf(0.1) * vector(cos(theta), sin(theta), 0)

    def gap(phi):
        x = np.cross(rotation(u, -phi) @ ball - p0, n0)
        return x.dot(x) - mpf(RSCR_H) ** 2

    phi = findroot(gap, RSCR_SEED)
    slide = (rotation(u, -phi) @ ball - p0).dot(n0)
    return Pose({"crank_pin": theta, "output_pin": phi, "guide.slide": slide}, {}, {})


RSCR_SEED = mpf("-0.37")

# ---------------------------------------------------------------- Hooke's joint

B = 0.6  # shaft angle, in the x-z plane; input shaft along x
OUT = (np.cos(B), 0.0, np.sin(B))  # output shaft
PIN = (0.0, 1.0, 0.0)  # input pin at 0: normal to the shaft plane
PIN2 = tuple(np.cross(OUT, PIN))  # output pin at 0


def hooke_closure(folder: Path) -> sp.Mechanism:
    tree = (turning("input", "ground", "in", axis=(1, 0, 0))
            + turning("output", "ground", "out", axis=OUT))
    return load(folder, "hooke_closure", tree, driver("input", "input") + closure(
        "cross", "universal", "in", "out", axis=PIN, axis2=PIN2))


def hooke_tree(folder: Path) -> sp.Mechanism:
    """The same with the universal joint in the tree; its output is welded to a wheel."""
    tree = (turning("input", "ground", "in", axis=(1, 0, 0)) + floating("cross", "in", "out")
            + turning("output", "ground", "wheel", axis=OUT)
            + point("bearing", "wheel", rpy=rpy_facing(OUT, PIN2))
            + point("journal", "out", rpy=rpy_facing((1, 0, 0), (0, 0, 1))))
    toml = (refine("cross", "universal", axis=PIN, axis2=(0, 0, 1)) + driver("input", "input")
            + closure("journal", "weld", "bearing", "journal") + guess(cross=[-B, 0.0]))
    return load(folder, "hooke_tree", tree, toml)


def hooke_answer(angle) -> Pose:
    """tan out = cos B tan in, as in + (out - in) to be smooth over turns."""
    c, x, y = cos(mpf(B)), cos(angle), sin(angle)
    return Pose({"input": angle, "output": angle + atan2((c - 1) * x * y, x**2 + c * y**2)}, {}, {})


# ---------------------------------------------------------------- couplings and screws

LEAD = 0.012


def press_tree(folder: Path) -> sp.Mechanism:
    """Ram screwed into the frame and kept from turning by a key on the driven nut's far side."""
    tree = (turning("nut", "ground", "wheel", (0, 0, 0.1)) + sliding("slide", "ground", "ram")
            + floating("thread", "wheel", "spindle")
            + point("spindle_foot", "spindle", (0, 0, -0.1)))
    toml = (refine("thread", "screw", axis=(0, 0, 1), lead=LEAD) + driver("nut", "nut")
            + closure("foot", "weld", "ram", "spindle_foot"))
    return load(folder, "press_tree", tree, toml)


def press_closure(folder: Path) -> sp.Mechanism:
    tree = (turning("nut", "ground", "wheel", (0, 0, 0.1)) + sliding("slide", "ground", "ram")
            + point("ram_thread", "ram", (0, 0, 0.1)))
    return load(folder, "press_closure", tree, driver("nut", "nut") + closure(
        "thread", "screw", "wheel", "ram_thread", lead=LEAD))


def press_answer(angle) -> Pose:
    return Pose({"nut": angle, "slide": -mpf(LEAD) * angle / (2 * mp_pi)}, {}, {})


def press_tree_answer(angle) -> Pose:
    return Pose({**press_answer(angle).coordinates, "thread": -angle}, {}, {})


def rack_and_gears(folder: Path) -> sp.Mechanism:
    """Pinion, wheel and rack; the coupling of the wheel has an offset."""
    tree = (turning("pinion", "ground", "g1") + turning("wheel", "ground", "g2", (0.06, 0, 0))
            + sliding("rack", "ground", "r", (0, -0.02, 0), (1, 0, 0)))
    return load(folder, "rack_and_gears", tree, driver("pinion", "pinion")
                + coupling("teeth", "pinion", "wheel", -0.4, 0.25)
                + coupling("rack_teeth", "pinion", "rack", 0.02, -0.003))


def rack_answer(angle) -> Pose:
    return Pose({"pinion": angle, "wheel": mpf(-0.4) * angle + mpf(0.25),
                 "rack": mpf(0.02) * angle + mpf(-0.003)}, {}, {})


G = {"ground": 0.2, "crank": 0.05, "rod": 0.17, "ratio": -2.0, "offset": 0.3}


def geared_five_bar(folder: Path) -> sp.Mechanism:
    """Two geared cranks and a dyad: repeats after one turn of the slow crank."""
    tree = (turning("left", "ground", "crank1") + turning("right", "ground", "crank2", (0.2, 0, 0))
            + turning("elbow1", "crank1", "rod1", (0.05, 0, 0))
            + turning("elbow2", "crank2", "rod2", (0.05, 0, 0))
            + point("tip1", "rod1", (0.17, 0, 0)) + point("tip2", "rod2", (0.17, 0, 0)))
    toml = (driver("crank", "left") + closure("tip", "revolute", "tip1", "tip2")
            + coupling("teeth", "left", "right", G["ratio"], G["offset"])
            + guess(left=-2.0, right=4.3, elbow1=2.9, elbow2=-2.1))
    return load(folder, "geared_five_bar", tree, toml)


def geared_answer(angle) -> Pose:
    a, b = mpf(G["crank"]), mpf(G["rod"])
    right = mpf(G["ratio"]) * angle + mpf(G["offset"])
    p = vector(a * cos(angle), a * sin(angle), 0)
    q = vector(mpf(G["ground"]) + a * cos(right), a * sin(right), 0)
    d = q - p
    half = sqrt(d.dot(d)) / 2
    base = atan2(d[1], d[0])
    rise = acos(half / b)
    rod1, rod2 = base + rise, base + mp_pi - rise
    return Pose({"left": angle, "right": right, "elbow1": rod1 - angle,
                 "elbow2": rod2 - right}, {}, {})


# ---------------------------------------------------------------- overconstrained loops

ALPHA, BETA = 0.7, 1.2  # twists of Bennett's loop; lengths in proportion to their sines


def chain(links, first="ground") -> str:
    """Revolute joints j1, j2, ... and links of lengths and twists, the last one's end a point."""
    text, parent, xyz, rpy = "", first, (0, 0, 0), (0, 0, 0)
    for k, (a, twist) in enumerate(links, start=1):
        text += turning(f"j{k}", parent, f"link{k}", xyz, rpy=rpy)
        parent, xyz, rpy = f"link{k}", (a, 0, 0), (twist, 0, 0)
    return text + point("end", parent, xyz, rpy)


def bennett(folder: Path) -> sp.Mechanism:
    """Bennett's loop; its fourth link is the ground, with joint 4 a link before joint 1."""
    a, b = 0.3 * np.sin(ALPHA), 0.3 * np.sin(BETA)
    fourth = pin.SE3(pin.rpy.rpyToMatrix(BETA, 0, 0), np.array([b, 0, 0])).inverse()
    tree = chain([(a, ALPHA), (b, BETA), (a, ALPHA)])
    tree += point("last", "ground", fourth.translation, pin.rpy.matrixToRpy(fourth.rotation))
    return load(folder, "bennett", tree, driver("crank", "j1") + closure(
        "j4", "revolute", "end", "last") + guess(j1=1.0, j2=2.3, j3=-1.0))


def bennett_answer(t1) -> Pose:
    k = sin(mpf(BETA + ALPHA) / 2) / sin(mpf(BETA - ALPHA) / 2)
    # tan(t1/2) tan(t2/2) = k, continued over turns of t1
    t2 = 2 * atan2(k * cos(t1 / 2), sin(t1 / 2))
    return Pose({"j1": t1, "j2": t2, "j3": -t1}, {}, {})


def bricard(folder: Path) -> sp.Mechanism:
    """Bricard's threefold loop with right angles, closed by a weld after six tree joints."""
    links = [(0.2, (-1) ** k * np.pi / 2) for k in range(6)]
    tree = chain(links) + point("start", "ground")
    t2 = 2 * np.pi / 3
    return load(folder, "bricard", tree, driver("crank", "j1") + closure(
        "weld", "weld", "end", "start") + guess(j1=0.1, j2=t2, j3=0.1, j4=t2, j5=0.1, j6=t2))


def bricard_answer(t1) -> Pose:
    t2 = acos(-cos(t1) / (1 + cos(t1)))
    return Pose({**{f"j{k}": t1 for k in (1, 3, 5)}, **{f"j{k}": t2 for k in (2, 4, 6)}}, {}, {})


def sarrus(folder: Path) -> sp.Mechanism:
    """Two plane chains of three hinges at right angles: the platform rises without turning."""
    tree = ""
    for side, yaw in (("a", 0.0), ("b", np.pi / 2)):
        tree += (point(f"{side}0", "ground", (0.1 * np.cos(yaw), 0.1 * np.sin(yaw), 0), (0, 0, yaw))
                 + turning(f"{side}_low", f"{side}0", f"{side}_arm1", axis=(0, -1, 0))
                 + turning(f"{side}_mid", f"{side}_arm1", f"{side}_arm2", (0.2, 0, 0), (0, -1, 0)))
    tree += turning("a_top", "a_arm2", "platform", (0.2, 0, 0), (0, -1, 0))
    tree += point("hinge", "platform", (-0.1, 0.1, 0), (0, 0, np.pi / 2))
    tree += point("b_tip", "b_arm2", (0.2, 0, 0))
    return load(folder, "sarrus", tree, driver("arm", "a_low") + closure(
        "b_top", "revolute", "hinge", "b_tip", axis=(0, -1, 0)) + guess(
            a_low=0.5, a_mid=2.1, a_top=-2.6, b_low=0.5, b_mid=2.1))


def sarrus_answer(t) -> Pose:
    """Hinges 0.1 from the axis, arms of 0.2: the platform rises by 0.4 sin t."""
    low, mid = t, mp_pi - 2 * t
    return Pose({"a_low": low, "a_mid": mid, "a_top": -low - mid, "b_low": low, "b_mid": mid},
                {}, {"platform": vector(0.1, 0, mpf(0.4) * sin(t)),
                     "hinge": vector(0, 0.1, mpf(0.4) * sin(t))})


def swung(folder):
    """A rod on a ball at a tilted base, its end tied to a crank by another rod."""
    tree = (floating("ball", "ground", "rod", (0.5, 0.1, 0)) + point("rod_end", "rod", (0, 0, 0.4))
            + turning("crank", "ground", "arm") + point("arm_end", "arm", (0.2, 0, 0.35)))
    toml = (refine("ball", "spherical") + closure("tie", "distance", "rod_end", "arm_end",
                                                  length=0.45)
            + driver("tilt", "ball.x") + driver("lean", "ball.y") + driver("spin", "ball.z")
            + guess(ball=[0.1, 0.05, 0.2], crank=0.3))
    return load(folder, "swung", tilted(tree), toml)


# ---------------------------------------------------------------- slots, planes, directions

PLATE, RADIUS = 0.3, 0.08  # tilt of the swash plate, radius of the rods


def swash_plate(folder: Path) -> sp.Mechanism:
    """A slipper on a ball lies flat on the plate."""
    tree = (turning("shaft", "ground", "plate")
            + point("face", "plate", rpy=rpy_facing((np.sin(PLATE), 0, np.cos(PLATE))))
            + sliding("rod", "ground", "piston", (RADIUS, 0, 0))
            + floating("ball", "piston", "slipper") + point("sole", "slipper", (0, 0, 0.01)))
    toml = (refine("ball", "spherical") + driver("shaft", "shaft")
            + closure("contact", "planar", "face", "slipper")
            + '[passive.spin]\nbody = "slipper"\naxis = ["ball", "sole"]\n')
    return load(folder, "swash_plate", tree, toml)


def swash_point(folder: Path) -> sp.Mechanism:
    """The same with the rod's tip on the plane."""
    tree = (turning("shaft", "ground", "plate")
            + point("face", "plate", rpy=rpy_facing((np.sin(PLATE), 0, np.cos(PLATE))))
            + sliding("rod", "ground", "piston", (RADIUS, 0, 0)))
    return load(folder, "swash_point", tree, driver("shaft", "shaft") + closure(
        "contact", "point_on_plane", "face", "piston"))


def swash_answer(angle) -> Pose:
    return Pose({"shaft": angle, "rod": -mpf(RADIUS) * tan(mpf(PLATE)) * cos(angle)}, {}, {})


def yoke(folder: Path, kind: str) -> sp.Mechanism:
    slot = {"point_on_line": (0, 1, 0), "point_on_plane": (1, 0, 0)}[kind]
    tree = (turning("crank_pin", "ground", "crank") + point("pin", "crank", (R, 0, 0))
            + sliding("slide", "ground", "yoke", axis=(1, 0, 0)))
    return load(folder, f"yoke_{kind}", tree, driver("crank", "crank_pin") + closure(
        "slot", kind, "yoke", "pin", axis=slot))


def yoke_answer(angle) -> Pose:
    return Pose({"crank_pin": angle, "slide": mpf(R) * cos(angle)}, {}, {})


LEAN = 0.5


def leaning_pointer(folder: Path) -> sp.Mechanism:
    """A pointer about x stays perpendicular to a direction that leans on a shaft about z."""
    tree = (turning("shaft", "ground", "cone")
            + point("leaning", "cone", rpy=rpy_facing((np.sin(LEAN), 0, np.cos(LEAN))))
            + turning("pointer_pin", "ground", "pointer", (0.1, 0.2, 0.3), (1, 0, 0)))
    return load(folder, "leaning_pointer", tree, driver("shaft", "shaft") + closure(
        "square", "perpendicular", "leaning", "pointer") + guess(pointer_pin=1.5))


def leaning_answer(angle) -> Pose:
    pointer = atan2(cos(mpf(LEAN)), sin(mpf(LEAN)) * sin(angle))
    return Pose({"shaft": angle, "pointer_pin": pointer}, {}, {})


def lamp(folder: Path) -> sp.Mechanism:
    """Two universal joints and a shade that stays parallel to the ground: two freedoms."""
    tree = (floating("foot", "ground", "arm") + floating("neck", "arm", "shade", (0, 0, 0.5)))
    toml = (refine("foot", "universal", axis=(1, 0, 0), axis2=(0, 1, 0))
            + refine("neck", "universal", axis=(0, 1, 0), axis2=(1, 0, 0))
            + driver("pan", "foot.first") + driver("tilt", "foot.second")
            + closure("level", "parallel", "ground", "shade"))
    return load(folder, "lamp", tree, toml)


def lamp_answer(angle) -> Pose:
    return Pose({"foot.first": angle, "foot.second": mpf(0), "neck.first": mpf(0),
                 "neck.second": -angle}, {}, {})


# ---------------------------------------------------------------- the rest


def pendulum(folder: Path) -> sp.Mechanism:
    """A tree without closures: two turning pairs in space, both driven."""
    tree = (turning("shoulder", "ground", "upper") + turning(
        "elbow", "upper", "lower", (0.3, 0, 0), (0, 1, 0)) + point("tip", "lower", (0.2, 0, 0)))
    return load(folder, "pendulum", tree, driver("shoulder", "shoulder") + driver("elbow", "elbow"))


def pendulum_answer(angle) -> Pose:
    reach = mpf(0.3) + mpf(0.2)
    return Pose({"shoulder": angle, "elbow": mpf(0)}, {}, {
        "tip": vector(reach * cos(angle), reach * sin(angle), 0)})


FIVE_BAR = {"ground": 0.2, "crank": 0.1, "rod": 0.18}


def five_bar(folder: Path) -> sp.Mechanism:
    """Plane five-bar with two drivers."""
    g, a, b = FIVE_BAR.values()
    tree = (turning("left", "ground", "crank1") + turning("right", "ground", "crank2", (g, 0, 0))
            + turning("elbow1", "crank1", "rod1", (a, 0, 0))
            + turning("elbow2", "crank2", "rod2", (a, 0, 0))
            + point("tip1", "rod1", (b, 0, 0)) + point("tip2", "rod2", (b, 0, 0)))
    toml = (driver("left", "left") + driver("right", "right")
            + closure("tip", "revolute", "tip1", "tip2")
            + guess(left=2.0, right=1.0, elbow1=-1.2, elbow2=1.2))
    return load(folder, "five_bar", tree, toml)


def five_bar_answer(left, right=1.0) -> Pose:
    g, a, b = map(mpf, FIVE_BAR.values())
    right = mpf(right)
    p = vector(a * cos(left), a * sin(left), 0)
    q = vector(g + a * cos(right), a * sin(right), 0)
    d = q - p
    base, rise = atan2(d[1], d[0]), acos(sqrt(d.dot(d)) / (2 * b))
    return Pose({"left": left, "right": right, "elbow1": base + rise - left,
                 "elbow2": base + mp_pi - rise - right}, {}, {})


def four_bar(**lengths) -> sp.Mechanism:
    """The library's plane four-bar: ground r1, crank r2, coupler r3, rocker r4."""
    return library("four_bar", **lengths)


def bare_four_bar(folder: Path, r1: float, r2: float, r3: float, r4: float) -> sp.Mechanism:
    """The same in the x-y plane, without parts to draw and without a guess."""
    tree = (turning("crank_pin", "ground", "crank") + turning("rocker_pin", "ground", "rocker",
                                                              (r1, 0, 0))
            + turning("coupler_pin", "crank", "coupler", (r2, 0, 0))
            + point("tip", "coupler", (r3, 0, 0)) + point("end", "rocker", (r4, 0, 0)))
    return load(folder, "bare_four_bar", tree, driver("crank", "crank_pin") + closure(
        "output_pin", "revolute", "tip", "end"))


def two_parallelograms(folder: Path, lead: float, second=0.1, weigh=str) -> sp.Mechanism:
    """A row of two: the second one's cranks run ahead of the first one's by an angle.

    Its crank is an arm of the first one's rocker. All lie flat where their cranks are at 0 or pi.

    Args:
        folder: for the files.
        lead: angle of the second parallelogram's cranks against the first one's.
        second: length of the second parallelogram's cranks.
        weigh: gives the links of the tree masses.
    """
    arm = second * np.cos(lead), second * np.sin(lead), 0
    tree = (turning("crank_pin", "ground", "crank")
            + turning("rocker_pin", "ground", "rocker", (0.3, 0, 0))
            + turning("out_pin", "ground", "out", (0.6, 0, 0))
            + turning("coupler_pin", "crank", "coupler", (0.1, 0, 0))
            + turning("link_pin", "rocker", "link", arm)
            + point("tip", "coupler", (0.3, 0, 0)) + point("end", "rocker", (0.1, 0, 0))
            + point("link_tip", "link", (0.3, 0, 0)) + point("out_end", "out", (second, 0, 0)))
    return load(folder, "two_parallelograms", weigh(tree), driver("crank", "crank_pin")
                + closure("first", "revolute", "tip", "end")
                + closure("second", "revolute", "link_tip", "out_end"))


class Known(NamedTuple):
    """A mechanism, the driver and values to sweep, and the answer."""

    build: Callable[[Path], sp.Mechanism]
    driver: str
    values: np.ndarray
    answer: Callable[..., Pose]
    hold: dict[str, float] = {}  # noqa: RUF012 (never changed)


TURN = np.linspace(0.0, 2 * np.pi, 37)
TURNS = np.linspace(-2.0, 30.0, 81)


def rod_answer(phi) -> Pose:
    return Pose(closed_forms.rssr(phi).coordinates, {}, {})


KNOWN = {
    "slider-crank cut at wrist pin": Known(cut_at_wrist_pin, "crank", TURN, slider_crank),
    "slider-crank cut at crank pin": Known(cut_at_crank_pin, "crank", TURN, slider_crank),
    "slider-crank cut at slide": Known(cut_at_slide, "crank", TURN, slider_crank),
    "slider-crank cut at main pin": Known(
        cut_at_main_pin, "slider", np.linspace(0.12, 0.2, 33), slider_crank_from_slide),
    "tilted slider-crank cut at wrist pin": Known(
        lambda f: cut_at_wrist_pin(f, tilted), "crank", TURN, slider_crank),
    "tilted slider-crank cut at slide": Known(
        lambda f: cut_at_slide(f, tilted), "crank", TURN, slider_crank),
    "tilted slider-crank cut at main pin": Known(
        lambda f: cut_at_main_pin(f, tilted), "slider", np.linspace(0.12, 0.2, 33),
        slider_crank_from_slide),
    "RSSR, rod as distance": Known(rssr_with_a_rod, "crank", TURN, rod_answer),
    "arm on a ram": Known(arm_on_a_ram, "ram", np.linspace(0.15, 0.5, 29), ram_answer),
    "RSSP": Known(rssp, "crank", TURN, rssp_answer),
    "RSCR": Known(rscr, "crank", TURN, rscr_answer),
    "Hooke's joint as closure": Known(hooke_closure, "input", TURN, hooke_answer),
    "Hooke's joint in the tree": Known(hooke_tree, "input", TURN, hooke_answer),
    "press, screw in the tree": Known(press_tree, "nut", TURNS, press_tree_answer),
    "press, screw as closure": Known(press_closure, "nut", TURNS, press_answer),
    "rack and gears": Known(rack_and_gears, "pinion", TURNS, rack_answer),
    "geared five-bar": Known(geared_five_bar, "crank", TURNS, geared_answer),
    "Bennett": Known(bennett, "crank", np.linspace(0.5, 5.5, 41), bennett_answer),
    "Bricard": Known(bricard, "crank", np.linspace(0.1, 1.9, 37), bricard_answer),
    "Sarrus": Known(sarrus, "arm", np.linspace(0.2, 1.4, 25), sarrus_answer),
    "swash plate": Known(swash_plate, "shaft", TURN, swash_answer),
    "swash plate, point contact": Known(swash_point, "shaft", TURN, swash_answer),
    "scotch yoke, line": Known(lambda f: yoke(f, "point_on_line"), "crank", TURN, yoke_answer),
    "scotch yoke, plane": Known(lambda f: yoke(f, "point_on_plane"), "crank", TURN, yoke_answer),
    "leaning pointer": Known(leaning_pointer, "shaft", TURN, leaning_answer),
    "lamp": Known(lamp, "pan", np.linspace(-1, 1, 21), lamp_answer, {"tilt": 0.0}),
    "pendulum": Known(pendulum, "shoulder", TURN, pendulum_answer, {"elbow": 0.0}),
    "five-bar": Known(five_bar, "left", np.linspace(1.6, 2.6, 25), five_bar_answer,
                      {"right": 1.0}),
}
