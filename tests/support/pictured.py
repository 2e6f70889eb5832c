"""What pictures are made of: an arm, every shape, motions of the library."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import coal
import numpy as np
import pinocchio as pin
from chromium import Browser, open_page, shoot

import spatial_pin as sp

RED, BLUE, GREEN = (0.8, 0.1, 0.1), (0.1, 0.2, 0.8), (0.1, 0.6, 0.2)
ARM = """<robot name="arm">
  <link name="base"><visual><geometry><box size="0.2 0.2 0.05"/></geometry>
    <material name="green"><color rgba="0.1 0.6 0.2 1"/></material></visual></link>
  <link name="upper"><visual><origin xyz="0.2 0 0" rpy="0 1.5708 0"/>
    <geometry><cylinder radius="0.03" length="0.4"/></geometry>
    <material name="red"><color rgba="0.8 0.1 0.1 1"/></material></visual></link>
  <link name="lower"><visual><geometry><sphere radius="0.06"/></geometry>
    <material name="blue"><color rgba="0.1 0.2 0.8 1"/></material></visual></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
    <origin xyz="0 0 0.1"/><axis xyz="0 -1 0"/>
    <limit lower="-9" upper="9" effort="1" velocity="1"/></joint>
  <joint name="elbow" type="prismatic"><parent link="upper"/><child link="lower"/>
    <origin xyz="0.4 0 0"/><axis xyz="1 0 0"/>
    <limit lower="-9" upper="9" effort="1" velocity="1"/></joint>
</robot>"""


def arm(text: str = ARM) -> SimpleNamespace:
    model = pin.buildModelFromXML(text)
    visuals = pin.buildGeomFromUrdfString(model, text, pin.GeometryType.VISUAL)
    return SimpleNamespace(
        name="arm",
        title="Arm <1> & co",
        model=model,
        visual_model=visuals,
        pairs=("revolute", "prismatic"),
        closures=(),
        springs=(),
        inertias={},
        links=(),
        frames={},
        coordinate_table={},
        neutral=pin.neutral(model),
        memo={},
        drivers=("shoulder",),
        coordinate=lambda name: SimpleNamespace(unit="rad"),
    )


def state(**changes: object) -> SimpleNamespace:
    made = SimpleNamespace(mechanism=arm(), q=np.array([0.7, 0.0]), closure_error=2e-15)
    made.coordinate = lambda name: (made.q[0], 0.0, 0.0)
    vars(made).update(changes)
    return made


def convex() -> coal.Convex:
    mesh = triangle_mesh()
    mesh.buildConvexRepresentation(False)
    return mesh.convex


def triangle_mesh() -> coal.BVHModelOBBRSS:
    points, faces = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    for p in ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)):
        points.append(np.array(p, float))
    for t in ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)):
        faces.append(coal.Triangle(*t))
    mesh = coal.BVHModelOBBRSS()
    mesh.beginModel(4, 4)
    mesh.addSubModel(points, faces)
    mesh.endModel()
    return mesh


SHAPES = {
    "box": lambda: coal.Box(0.1, 0.2, 0.3),
    "sphere": lambda: coal.Sphere(0.1),
    "ellipsoid": lambda: coal.Ellipsoid(0.1, 0.2, 0.3),
    "cylinder": lambda: coal.Cylinder(0.1, 0.4),
    "cone": lambda: coal.Cone(0.1, 0.4),
    "capsule": lambda: coal.Capsule(0.1, 0.4),
    "plane": lambda: coal.Plane(np.array([0.0, 0.0, 1.0]), 0.1),
    "halfspace": lambda: coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0),
    "triangle": lambda: coal.TriangleP(np.zeros(3), np.eye(3)[0], np.eye(3)[1]),
    "mesh": triangle_mesh,
    "convex": convex,
    "height field": lambda: coal.HeightFieldAABB(1.0, 1.0, np.eye(4)),
}


def shown_as(shape: object, place: pin.SE3 | None = None) -> SimpleNamespace:
    """A state whose only visual is a shape."""
    mechanism = arm()
    mechanism.visual_model = pin.GeometryModel()
    mechanism.visual_model.addGeometryObject(
        pin.GeometryObject("part/1", 1, 0, place or pin.SE3.Identity(), shape)
    )
    return state(mechanism=mechanism)


TURN = np.linspace(0.0, 2 * np.pi, 37)


def rssr(n: int = 37, **settings: object) -> sp.Motion:
    values = np.linspace(0.0, 2 * np.pi, n)
    return sp.sweep(sp.load("rssr"), "crank", values, speed=25.0, **settings)


def without_picture(mechanism: sp.Mechanism) -> sp.Mechanism:
    return replace(mechanism, visual_model=pin.GeometryModel())


def without_picture_of(mechanism: sp.Mechanism, joint: str) -> sp.Mechanism:
    kept = pin.GeometryModel()
    for visual in mechanism.visual_model.geometryObjects:
        if mechanism.model.names[visual.parentJoint] != joint:
            kept.addGeometryObject(visual)
    return replace(mechanism, visual_model=kept)


SHOWN = {  # what is swept, from, to
    "rssr": ("crank", 0.3, 0.3 + 2 * np.pi),
    "four_bar": ("crank", 0.3, 3.0),
    "hooke_joint": ("input", 0.3, 3.0),
    "slider_crank": ("crank", 0.3, 3.0),
    "screw_press": ("screw", 0.0, 6.0),
    "swash_plate": ("shaft", 0.2, 3.0),
}


def swept(name: str, n: int = 61) -> sp.Motion:
    driver, first, last = SHOWN[name]
    return sp.sweep(sp.load(name), driver, np.linspace(first, last, n))


def photograph(browser: Browser, shown, folder: Path, seconds: float = 0.0, **options):
    """A picture of the page of a motion or state."""
    open_page(browser, sp.export_html(shown, folder / "page.html", **options))
    return np.asarray(shoot(browser, seconds), float) / 255
