"""Linkages as CAD programs export them: tilted, on frames turned at random, numbers rounded."""

import re
import struct
import tomllib
import xml.etree.ElementTree as ET

import numpy as np
import pinocchio as pin
from loaded_library import library
from mechanisms import from_text


def to_digits(n):
    """Return the rounding to `n` decimals."""
    return lambda text: repr(round(float(text), n))


def to_float32(text):
    """Return a number as single precision has it."""
    return repr(struct.unpack("f", struct.pack("f", float(text)))[0])


def exactly(text):
    return text


NUMBERS = re.compile(r'(xyz|rpy)="([^"]*)"')


def rounded_text(urdf, rounding):
    """Return a URDF text with its placements and axes rounded."""
    def again(match):
        return f'{match[1]}="{" ".join(map(rounding, match[2].split()))}"'
    return NUMBERS.sub(again, urdf)


def words(x):
    return " ".join(repr(float(c)) for c in x)


def origin(placement):
    rpy = pin.rpy.matrixToRpy(placement.rotation)
    return f'<origin xyz="{words(placement.translation)}" rpy="{words(rpy)}"/>'


def hinge(name, parent, child, placement, axis):
    return f"""<link name="{child}"><inertial><origin xyz="0.02 -0.01 0.03"/><mass value="0.7"/>
      <inertia ixx="0.002" iyy="0.003" izz="0.0025" ixy="0" ixz="0" iyz="0"/></inertial></link>
      <joint name="{name}" type="continuous"><parent link="{parent}"/><child link="{child}"/>
      {origin(placement)}<axis xyz="{words(axis)}"/></joint>"""


def mark(name, parent, placement):
    return f"""<link name="{name}"/><joint name="fixed_{name}" type="fixed">
      <parent link="{parent}"/><child link="{name}"/>{origin(placement)}</joint>"""


def step(length, twist=0.0, offset=0.0):
    """Return the placement of the next hinge line after one: along x by `length`, about it."""
    return pin.SE3(pin.utils.rotate("x", twist), np.array([length, 0.0, offset]))


def loop(steps, angles, rounding=exactly, *, closure="revolute", drivers=1, seed=5):
    """Return a loop of hinges.

    Args:
        steps: placement of each hinge line on the one before, the last one back to the first.
        angles: a closed configuration, of all hinges but the last [rad], for the guess.
        rounding: of the numbers of the file.
        closure: that closes it at the last hinge.
        drivers: how many hinges are driven.
        seed: of tilt and frames.
    """
    rng = np.random.default_rng(seed)
    tilt = pin.SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3) * 0.2)
    parts, parent, before = ['<link name="ground"/>'], "ground", tilt
    for k in range(len(angles)):
        turned = pin.SE3(pin.exp3(rng.normal(size=3)), np.zeros(3))
        axis = turned.rotation[2]
        parts.append(hinge(f"h{k}", parent, f"link{k}", before * turned, axis))
        before, parent = turned.inverse() * steps[k], f"link{k}"
    parts.append(mark("end", parent, before))
    parts.append(mark("start", "ground", tilt * steps[-1].inverse()))
    text = rounded_text(f'<robot name="loop">{"".join(parts)}</robot>', rounding)
    content = {"name": "loop", "tree": "loop", "closures": [
        {"name": "last", "type": closure, "frames": ["start", "end"]}],
        "drivers": {f"h{k}": {"joint": f"h{k}"} for k in range(drivers)},
        "guess": {f"h{k}": float(a) for k, a in enumerate(angles)}}
    return from_text(text, content, "loop.toml")


def plane(lengths, rounding=exactly, **options):
    """Return a plane loop of hinges with sides of these lengths, on a circle in the guess."""
    lengths = np.array(lengths)
    low, high = 0.5 * lengths.max(), lengths.sum()
    for _ in range(200):  # circumscribed circle
        r = 0.5 * (low + high)
        total = 2.0 * np.arcsin(np.minimum(lengths / (2.0 * r), 1.0)).sum()
        low, high = (r, high) if total > 2.0 * np.pi else (low, r)
    arcs = 2.0 * np.arcsin(np.minimum(lengths / (2.0 * r), 1.0))
    # hinge k lies between sides k-1 and k; side -1 is the ground
    turns = 0.5 * (np.roll(arcs, 1) + arcs)[:-1]
    steps = [step(x) for x in lengths]
    return loop(steps, turns, rounding, **options)


def bennett(rounding=exactly, **options):
    """Return Bennett's loop of four hinges: sin(twist) : length alike in opposite links."""
    a, alpha, beta = 0.3, 0.7, 1.3
    b = a * np.sin(beta) / np.sin(alpha)
    steps = [step(a, alpha), step(b, beta), step(a, alpha), step(b, beta)]
    one = 1.0
    k = np.sin(0.5 * (beta + alpha)) / np.sin(0.5 * (beta - alpha))
    two = 2.0 * np.arctan(k / np.tan(0.5 * one))
    return loop(steps, [one, two, -one], rounding, **options)


def bricard(rounding=exactly, **options):
    """Return Bricard's loop of six hinges with threefold symmetry, twists of a right angle."""
    half = 0.5 * np.pi
    steps = [step(0.25, half * (-1) ** k) for k in range(6)]
    return loop(steps, [1.689, 1.4368, 1.689, 1.4368, 1.689], rounding, **options)


def line_symmetric(seed, rounding=exactly):
    """Return Bricard's loop of which three hinges are the others, half a turn about a line on."""
    rng, half = np.random.default_rng(seed), pin.SE3(np.diag([-1.0, -1.0, 1.0]), np.zeros(3))
    three = [pin.SE3(pin.exp3(rng.normal(size=3)), 0.3 * rng.normal(size=3)) for _ in range(3)]
    hinges = [*three, *(half * x for x in three)]
    steps = [x.actInv(y) for x, y in zip(hinges, [*hinges[1:], hinges[0]], strict=True)]
    return loop(steps, [0.0] * 5, rounding, seed=seed)


def sarrus(rounding=exactly, **options):
    """Return Sarrus' loop: three parallel hinges, then three others square to them."""
    turn = pin.SE3(pin.utils.rotate("y", 0.5 * np.pi), np.array([0.1, 0.0, 0.2]))
    steps = [step(0.3), step(0.3), turn, step(0.3), step(0.3), turn.inverse()]
    return loop(steps, [0.7, np.pi - 1.4, 0.7 - np.pi, -0.7, 1.4 - np.pi], rounding, **options)


def placed(element):
    """Return the placement that an URDF element's origin gives."""
    found = element.find("origin")
    given = {} if found is None else found.attrib
    xyz, rpy = ([float(x) for x in given.get(key, "0 0 0").split()] for key in ("xyz", "rpy"))
    return pin.SE3(pin.rpy.rpyToMatrix(*rpy), np.array(xyz))


def put(element, placement):
    for old in element.findall("origin"):
        element.remove(old)
    element.insert(0, ET.fromstring(origin(placement)))


def exported(name, rounding=exactly, seed=3):
    """Return a mechanism of the library, its links on frames turned at random and rounded.

    Frames that closures, springs or passive axes name stay as they are on their links.
    """
    mechanism = library(name)
    content = tomllib.loads(mechanism.path.read_text(encoding="utf-8"))
    content |= {"tree": name, "guess": dict(mechanism.guess)}
    rng, root = np.random.default_rng(seed), ET.fromstring(mechanism.urdf)
    still = {f for part in ("closures", "springs") for x in content.get(part, ())
             for f in (*x.get("frames", ()), *x.get("length_between", ()))}
    still |= {f for x in content.get("passive", {}).values() for f in (*x["axis"], x["body"])}
    still |= {j.find("child").get("link") for j in root.iter("joint")
              if j.get("name") in content.get("joints", {})}
    bases = {x.get("name") for x in root.iter("link")} - {
        j.find("child").get("link") for j in root.iter("joint")}
    turns = {}
    for link in root.iter("link"):
        turn = pin.exp3(rng.normal(size=3))
        turns[link.get("name")] = pin.SE3(
            np.eye(3) if link.get("name") in still - bases else turn, np.zeros(3))
        for part in [x for x in link if x.tag in ("visual", "collision")]:
            link.remove(part)
        for part in link.findall("inertial"):
            put(part, turns[link.get("name")].inverse() * placed(part))
    for joint in root.iter("joint"):
        one, two = (turns[joint.find(x).get("link")] for x in ("parent", "child"))
        put(joint, one.inverse() * placed(joint) * two)
        axis = joint.find("axis")
        if axis is not None:
            old = np.array([float(x) for x in axis.get("xyz").split()])
            axis.set("xyz", words(two.rotation.T @ old))
    if bases & still:
        raise ValueError(f"{name}: its base is a frame of a closure")
    text = rounded_text(ET.tostring(root, encoding="unicode"), rounding)
    return from_text(text, content, name)
