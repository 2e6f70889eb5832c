"""Mechanisms that are drawn: bodies, and joints at places of the world."""

import numpy as np

import spatial_pin as sp


def four_bar(backwards=False):
    """A plane four-bar with dimensions, its statements in this order or the other."""
    d = sp.Drawing("four_bar")
    d["a"], d["b"], d["phi"] = 0.1, 0.3, 0.5
    elbow = d["a"] + d["b"] * np.cos(d["phi"]), d["b"] * d.sin(d["phi"])
    statements = [
        lambda: d.body("crank"), lambda: d.body("coupler", mass=1.0, inertia=0.01),
        lambda: d.body("rocker", density=7850),
        lambda: d.hinge("A", "ground", "crank", at=(0, 0)),
        lambda: d.hinge("B", "crank", "coupler", at=(d["a"], 0)),
        lambda: d.hinge("C", "coupler", "rocker", at=elbow),
        lambda: d.hinge("D", "ground", "rocker", at=(0.35, 0)),
        lambda: d.point("tip", "coupler", at=(0.2, 0.2)), lambda: d.drive("A")]
    for statement in reversed(statements) if backwards else statements:
        statement()
    return d


def slider_crank():
    """A slider-crank, stretched as it is drawn."""
    d = sp.Drawing("slider_crank")
    d["r"], d["l"] = 0.1, 0.3
    d.body("crank").body("rod", mass=1.0).body("block", mass=2.0)
    d.hinge("A", "ground", "crank", at=(0, 0)).hinge("B", "crank", "rod", at=(d["r"], 0))
    d.hinge("C", "rod", "block", at=(d["r"] + d["l"], 0))
    d.slider("S", "ground", "block", at=(d["r"] + d["l"], 0), axis=(1, 0))
    return d.drive("A")


def spherical_four_bar():
    """A spherical four-bar, whose arcs are dimensions."""
    d = sp.Drawing("spherical_four_bar")
    d["alpha"], d["beta"], d["gamma"], d["lift"] = 0.4, 0.9, 0.8, 0.5
    alpha, beta, gamma, lift = (d[x] for x in ("alpha", "beta", "gamma", "lift"))
    d.body("in").body("mid").body("out").drive("A")
    d.hinge("A", "ground", "in", at=(0, 0))
    d.hinge("B", "in", "mid", at=(0, 0), axis=(d.sin(alpha), 0, d.cos(alpha)))
    d.hinge("C", "out", "mid", at=(0, 0),
            axis=(d.sin(gamma) * d.cos(lift), d.sin(gamma) * d.sin(lift), d.cos(gamma)))
    return d.hinge("D", "ground", "out", at=(0, 0), axis=(d.sin(beta), 0, d.cos(beta)))


def bennett(a=0.3, alpha=0.6, beta=1.1, theta=0.7):
    """Bennett's loop: sides a, b, a, b with twists that fit, drawn by Denavit and Hartenberg."""
    b = a * np.sin(beta) / np.sin(alpha)
    # tan(theta1 / 2) tan(theta2 / 2) = sin((beta + alpha) / 2) / sin((beta - alpha) / 2)
    k = np.sin((beta + alpha) / 2) / np.sin((beta - alpha) / 2)
    other = 2 * np.arctan(k / np.tan(theta / 2))
    d = sp.Drawing("bennett").body("one").body("two").body("three").drive("A")
    names = iter((("A", "ground", "one"), ("B", "one", "two"), ("C", "two", "three"),
                  ("D", "three", "ground")))
    place = np.eye(4)
    for turn, side, twist in ((theta, a, alpha), (other, b, beta), (-theta, a, alpha),
                              (-other, b, beta)):
        d.hinge(*next(names), at=place[:3, 3], axis=place[:3, 2])
        c, s, ct, st = np.cos(turn), np.sin(turn), np.cos(twist), np.sin(twist)
        place = place @ np.array([[c, -s * ct, s * st, side * c], [s, c * ct, -c * st, side * s],
                                  [0, st, ct, 0], [0, 0, 0, 1]])
    return d, place


def sarrus():
    """Sarrus's linkage: two pairs of plates at right angles lift a table."""
    d = sp.Drawing("sarrus").body("table").drive("A1")
    for k, (side, axis) in enumerate((((1, 0, 0), (0, 1, 0)), ((0, 1, 0), (1, 0, 0))), 1):
        side = np.array(side, float)
        d.body(f"lower{k}").body(f"upper{k}")
        d.hinge(f"A{k}", "ground", f"lower{k}", at=0.2 * side, axis=axis)
        d.hinge(f"B{k}", f"lower{k}", f"upper{k}", at=0.35 * side + [0, 0, 0.2], axis=axis)
        d.hinge(f"C{k}", f"upper{k}", "table", at=0.2 * side + [0, 0, 0.4], axis=axis)
    return d


def gough_platform(slides=False):
    """A platform on six rods of its height h, or on six legs with slides that are driven."""
    d = sp.Drawing("gough").body("top", mass=5.0, inertia=0.1)
    d["h"] = 0.5
    for k in range(6):
        u = (k // 2) * 2 * np.pi / 3 + (-1) ** k * 0.2
        w = ((k + 1) // 2) * 2 * np.pi / 3 - np.pi / 3 + (-1) ** (k + 1) * 0.2
        below = np.array([0.5 * np.cos(u), 0.5 * np.sin(u), 0.0])
        above = np.array([0.3 * np.cos(w), 0.3 * np.sin(w), d["h"]], dtype=object)
        if not slides:
            d.point(f"b{k}", "ground", at=below).point(f"t{k}", "top", at=above)
            d.rod(f"leg{k}", f"b{k}", f"t{k}")
            continue
        d.body(f"low{k}").body(f"high{k}").drive(f"S{k}")
        d.ball(f"B{k}", "ground", f"low{k}", at=below)
        d.slider(f"S{k}", f"low{k}", f"high{k}", at=below, axis=above - below)
        d.ball(f"T{k}", f"high{k}", "top", at=above)
    return d


def delta():
    """A delta robot: three arms, and two rods from each to the plate."""
    d = sp.Drawing("delta").body("plate", mass=1.0)
    for k in range(3):
        c, s = np.cos(2 * np.pi * k / 3), np.sin(2 * np.pi * k / 3)
        turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        d.body(f"arm{k}").drive(f"M{k}")
        d.hinge(f"M{k}", "ground", f"arm{k}", at=turn @ [0.1, 0, 0], axis=turn @ [0, -1, 0])
        for j in (-1, 1):
            d.point(f"elbow{k}{j}", f"arm{k}", at=turn @ [0.3, 0.03 * j, 0.05])
            d.point(f"wrist{k}{j}", "plate", at=turn @ [0.05, 0.03 * j, -0.4])
            d.rod(f"rod{k}{j}", f"elbow{k}{j}", f"wrist{k}{j}")
    return d


def excavator():
    """A boom and an arm, each moved by a cylinder."""
    d = sp.Drawing("excavator").drive("cylinder1").drive("cylinder2")
    for body in ("boom", "arm", "barrel1", "piston1", "barrel2", "piston2"):
        d.body(body, density=7850)
    y = (0, -1, 0)
    d.hinge("boom_pin", "ground", "boom", at=(0, 0, 0), axis=y)
    d.hinge("arm_pin", "boom", "arm", at=(3, 0, 1.5), axis=y)
    d.hinge("P1", "ground", "barrel1", at=(0.5, 0, -0.3), axis=y)
    d.slider("cylinder1", "barrel1", "piston1", at=(1, 0, 0.5), axis=(1.3, 0, 1.7))
    d.hinge("Q1", "piston1", "boom", at=(1.8, 0, 1.4), axis=y)
    d.hinge("P2", "boom", "barrel2", at=(1.6, 0, 1.8), axis=y)
    d.slider("cylinder2", "barrel2", "piston2", at=(2.4, 0, 2.0), axis=(1.6, 0, 0.3))
    return d.hinge("Q2", "piston2", "arm", at=(3.2, 0, 2.1), axis=y)


def planetary_gear():
    """A sun with 20 teeth, a planet with 40 and a ring with 100 that stands still."""
    d = sp.Drawing("planetary_gear").body("carrier").body("sun").body("planet").drive("C")
    d.hinge("C", "ground", "carrier", at=(0, 0)).hinge("S", "carrier", "sun", at=(0, 0))
    d.hinge("P", "carrier", "planet", at=(0.03, 0))
    d.gear("sun_planet", "S", "P", teeth=(20, 40))
    return d.gear("ring_planet", "C", "P", teeth=(100, 40), internal=True)


def double_wishbone():
    """A wheel between two wishbones, steered by a rod, with a dimension."""
    d = sp.Drawing("double_wishbone").drive("L").drive("W")
    d["z"] = 0.25
    d.body("upper").body("lower").body("upright", mass=8.0).body("wheel", mass=12.0)
    d.hinge("U", "ground", "upper", at=(0, 0.3, d["z"]), axis=(1, 0, 0))
    d.hinge("L", "ground", "lower", at=(0, 0.25, 0), axis=(1, 0, 0.05))
    d.ball("u", "upper", "upright", at=(0.01, 0.6, 0.28)).ball("l", "lower", "upright",
                                                               at=(0, 0.65, 0))
    d.point("rack", "ground", at=(0.1, 0.3, 0.1)).point("arm", "upright", at=(0.12, 0.62, 0.1))
    d.rod("tie", "rack", "arm")
    return d.hinge("W", "upright", "wheel", at=(0, 0.7, 0.14), axis=(0, 1, 0))


DRAWN = {  # by name: the drawing, its freedoms, and how many of them are passive
    "four_bar": (four_bar, 1, 0), "slider_crank": (slider_crank, 1, 0),
    "spherical_four_bar": (spherical_four_bar, 1, 0), "bennett": (lambda: bennett()[0], 1, 0),
    "sarrus": (sarrus, 1, 0), "gough": (gough_platform, 0, 0),
    "gough_slides": (lambda: gough_platform(True), 12, 6), "delta": (delta, 3, 0),
    "excavator": (excavator, 2, 0), "planetary_gear": (planetary_gear, 1, 0),
    "double_wishbone": (double_wishbone, 2, 0),
}
