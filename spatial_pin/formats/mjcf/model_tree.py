"""MuJoCo's compiled bodies, joints, geoms and sites to an open tree.

Joint coordinates are MuJoCo's: where a joint has a `ref`, its zero lies that far before the pose
that the file shows.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Container, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from spatial_pin.formats.mjcf.compiling import MeshFile
from spatial_pin.formats.urdf.elements import (
    UrdfTree,
    fresh,
    inertial,
    numbers_text,
    shape_element,
)
from spatial_pin.mechanism.inertia import inertia_as_given
from spatial_pin.numerics.linalg import Array

WORLD = "world"
SPHERE = Path(__file__).with_name("unit_sphere.obj")
DRAWN_GROUPS = 3  # MuJoCo's viewers show the first three groups of geoms
GREY = np.array([0.5, 0.5, 0.5, 1.0])  # of a geom that has no colour of its own


class PlacedJoint(NamedTuple):
    """A joint: the links that it joins, its zero in the first, and its unit axis (3,) there."""

    name: str
    parent: str
    child: str
    placement: pin.SE3
    axis: Array


class MjcfReading:
    """The bodies, joints, geoms and sites of a model.

    Attributes:
        mujoco: the module.
        model: `mujoco.MjModel`.
        meshes: the file of every mesh asset, by its name.
        urdf: the open tree so far.
        links: name of the link of every body.
        joints: place of every joint.
        refined: what URDF cannot say of joints, by name.
        sites: name of the link of every site, by its number.
        tendons: numbers of the tendons that are read as springs.
        notices: of changes and omissions.
    """

    def __init__(
        self, mujoco: Any, model: Any, meshes: Mapping[str, MeshFile], massless: Container[str],
        name: str,
    ) -> None:
        self.mujoco, self.model, self.meshes = mujoco, model, meshes
        self.links: list[str] = [WORLD]
        self.joints: list[PlacedJoint] = []
        self.refined: dict[str, dict[str, Any]] = {}
        self.sites: dict[int, str] = {}
        self.tendons: set[int] = set()
        self.notices: list[str] = []
        bodies = [model.body(b).name for b in range(model.nbody)]
        joints = [model.joint(j).name for j in range(model.njnt)]
        taken = set(joints)
        for j in range(model.njnt):
            if not joints[j]:  # named after body and kind
                kind = mujoco.mjtJoint(model.jnt_type[j]).name.removeprefix("mjJNT_").lower()
                joints[j] = fresh(f"{model.body(model.jnt_bodyid[j]).name}_{kind}", taken)
        self.urdf = UrdfTree(name, WORLD, [*bodies, *joints])
        for body in range(1, model.nbody):
            self.links.append(_add_body(self, body, joints))
            mass, moments = float(model.body_mass[body]), np.diag(model.body_inertia[body])
            if (mass or np.any(moments)) and bodies[body] not in massless:
                at = pose(model.body_ipos[body], model.body_iquat[body])
                self.urdf.add(self.links[body], inertial(inertia_as_given(
                    mass, at.translation, at.rotation @ moments @ at.rotation.T)))
        for site in range(model.nsite):  # one with name and frame of its body is this body
            wanted, body = model.site(site).name, model.site_bodyid[site]
            placement = pose(model.site_pos[site], model.site_quat[site])
            if wanted == bodies[body] and placement.isIdentity(0.0):
                self.sites[site] = self.links[body]
            elif wanted:
                known = {*self.links, *(joint.name for joint in self.joints)}
                wanted = wanted if wanted not in known else f"{wanted}_site"
                self.sites[site] = self.urdf.frame(wanted, self.links[body], placement)
        for geom in range(model.ngeom):
            _add_geom(self, geom)

    def is_off(self, flag: str) -> bool:
        """Whether the file switches something off for the whole model, such as "GRAVITY"."""
        bit = getattr(self.mujoco.mjtDisableBit, f"mjDSBL_{flag}")
        return bool(self.model.opt.disableflags & int(bit))

    def is_single(self, joint: int) -> bool:
        """Whether a joint has one coordinate: a slide or a hinge."""
        return bool(self.model.jnt_type[joint] >= int(self.mujoco.mjtJoint.mjJNT_SLIDE))


def pose(position: Array, quaternion: Array) -> pin.SE3:
    """Return a placement of a position (3,) and a quaternion (4,) with the real part first."""
    w, x, y, z = quaternion
    return pin.SE3(pin.Quaternion(w, x, y, z).normalized().matrix(), np.array(position))


def shift(position: Array) -> pin.SE3:
    """Return a translation."""
    return pin.SE3(np.eye(3), np.array(position))


def _add_body(reading: MjcfReading, body: int, names: list[str]) -> str:
    """Add a body and the joints before it, and return the name of its link."""
    model, urdf, wanted = reading.model, reading.urdf, reading.model.body(body).name
    link = reading.links[model.body_parentid[body]]
    placement = pose(model.body_pos[body], model.body_quat[body])
    if model.body_mocapid[body] >= 0:
        reading.notices.append(f"mocap body {wanted!r} is fixed where the file has it")
    first, count = model.body_jntadr[body], model.body_jntnum[body]
    if count == 0:
        return urdf.fixed(link, wanted, placement)
    for joint in range(first, first + count):
        anchor = np.array(model.jnt_pos[joint])
        ends = joint == first + count - 1 and not np.any(anchor)
        child = wanted if ends else f"{wanted}_at_{names[joint]}"
        link = _add_joint(reading, joint, names[joint], link, child, placement * shift(anchor))
        placement = shift(-anchor)
    return link if ends else urdf.fixed(link, wanted, placement)


def _add_joint(
    reading: MjcfReading, joint: int, wanted: str, parent: str, child: str, placement: pin.SE3
) -> str:
    """Add a joint at a placement in the parent where its coordinate is `ref`; return its link."""
    model, kinds = reading.model, reading.mujoco.mjtJoint
    kind, axis = model.jnt_type[joint], np.array(model.jnt_axis[joint])
    ref = model.qpos0[model.jnt_qposadr[joint]]
    limits = model.jnt_range[joint] \
        if model.jnt_limited[joint] and not reading.is_off("LIMIT") else None
    written = "floating"
    refinement: dict[str, Any] = {}
    if kind == kinds.mjJNT_FREE:
        placement, limits = pin.SE3.Identity(), None
    elif kind == kinds.mjJNT_BALL:
        if limits is not None:
            reading.notices.append(f"ball joint {wanted!r}: its range is left out")
        refinement, limits = {"type": "spherical"}, None
    elif kind == kinds.mjJNT_HINGE:
        placement = placement * pin.SE3(pin.exp3(-ref * axis), np.zeros(3))
        written = "continuous" if limits is None else "revolute"
    else:
        placement = placement * shift(-ref * axis)
        written = "floating" if limits is None else "prismatic"
        refinement = {"type": "prismatic", "axis": axis.tolist()} if limits is None else {}
    turns = None if written == "floating" else axis
    name, link = reading.urdf.joint(wanted, written, parent, child, placement, turns, limits)
    reading.joints.append(PlacedJoint(name, parent, link, placement, axis))
    dof = model.jnt_dofadr[joint]
    resistances = {
        "damping": 0.0 if reading.is_off("DAMPER") else (
            model.dof_damping[dof] + _of_actuators(reading, joint, "actuator_damping")),
        "friction": 0.0 if reading.is_off("FRICTIONLOSS") else model.dof_frictionloss[dof],
        "armature": model.dof_armature[dof] + _of_actuators(reading, joint, "actuator_armature")}
    refinement |= {key: float(x) for key, x in resistances.items() if x != 0.0}
    refinement |= _effort(reading, joint)
    if refinement:
        reading.refined[name] = refinement
    return link


def _of_actuators(reading: MjcfReading, joint: int, key: str) -> float:
    """Return what actuators add to a joint of one coordinate, by the square of their gears."""
    model = reading.model
    values = getattr(model, key, None)  # older MuJoCo has none
    if values is None or not reading.is_single(joint):
        return 0.0
    own = moves_joint(reading) & (model.actuator_trnid[:, 0] == joint)
    return float(model.actuator_gear[own, 0] ** 2 @ values[own])


def moves_joint(reading: MjcfReading) -> Array:
    """Return which actuators act on a joint and not through something else."""
    kinds, target = reading.mujoco.mjtTrn, reading.model.actuator_trntype
    return (target == int(kinds.mjTRN_JOINT)) | (target == int(kinds.mjTRN_JOINTINPARENT))


def _effort(reading: MjcfReading, joint: int) -> dict[str, float]:
    """Return the limits of what all actuators do at a joint, as `[joints.X]` has them."""
    model, lower, upper = reading.model, -np.inf, np.inf
    own = moves_joint(reading) & (model.actuator_trnid[:, 0] == joint)
    on_tendon = (model.wrap_objid == joint) & (
        model.wrap_type == int(reading.mujoco.mjtWrap.mjWRAP_JOINT))
    if reading.is_single(joint) and np.any(own) and not np.any(on_tendon) and np.all(
            model.actuator_forcelimited[own]):
        ends = model.actuator_gear[own, :1] * model.actuator_forcerange[own]
        lower, upper = float(ends.min(axis=1).sum()) + 0.0, float(ends.max(axis=1).sum()) + 0.0
    if model.jnt_actfrclimited[joint]:
        low, high = model.jnt_actfrcrange[joint]
        lower, upper = max(lower, float(low)), min(upper, float(high))
    if lower > upper or np.inf in (-lower, upper):
        return {}
    return {"effort": upper} if lower == -upper else {"effort": upper, "lower_effort": lower}


def _add_geom(reading: MjcfReading, geom: int) -> None:
    model = reading.model
    solid = _solid(reading, geom)
    if solid is None:
        return
    element, inner = solid
    link = reading.links[model.geom_bodyid[geom]]
    placement = pose(model.geom_pos[geom], model.geom_quat[geom]) * inner
    touches = bool(model.geom_contype[geom] or model.geom_conaffinity[geom])
    if not touches or model.geom_group[geom] < DRAWN_GROUPS:
        colour, material = np.array(model.geom_rgba[geom], dtype=float), model.geom_matid[geom]
        if material >= 0 and np.array_equal(colour, GREY):
            colour = np.array(model.mat_rgba[material], dtype=float)
        reading.urdf.add(link, shape_element(
            "visual", placement, element, colour, f"rgba {numbers_text(colour)}", overrides=True))
    if touches:
        reading.urdf.add(link, shape_element("collision", placement, element))


def _solid(reading: MjcfReading, geom: int) -> tuple[ET.Element, pin.SE3] | None:
    """Return URDF element and its placement in the geom; None for what URDF does not have."""
    model, kinds, here = reading.model, reading.mujoco.mjtGeom, pin.SE3.Identity()
    kind, size = model.geom_type[geom], model.geom_size[geom]
    if kind == kinds.mjGEOM_SPHERE:
        return ET.Element("sphere", radius=numbers_text(size[:1])), here
    if kind == kinds.mjGEOM_BOX:
        return ET.Element("box", size=numbers_text(2.0 * size)), here
    if kind == kinds.mjGEOM_CYLINDER or kind == kinds.mjGEOM_CAPSULE:
        return ET.Element("cylinder" if kind == kinds.mjGEOM_CYLINDER else "capsule",
                          radius=numbers_text(size[:1]), length=numbers_text(2.0 * size[1:2])), here
    if kind == kinds.mjGEOM_ELLIPSOID:
        return ET.Element("mesh", filename=str(SPHERE), scale=numbers_text(size)), here
    if kind != kinds.mjGEOM_MESH:
        return None
    mesh = model.geom_dataid[geom]
    file, scale, placement, fault = reading.meshes[name := model.mesh(mesh).name]
    if file is None:
        sentence = f"mesh {name!r} is left out: {fault}"
        if fault and sentence not in reading.notices:
            reading.notices.append(sentence)
        return None
    centred = pose(model.mesh_pos[mesh], model.mesh_quat[mesh])  # by MuJoCo
    element = ET.Element("mesh", filename=str(file), scale=numbers_text(scale))
    return element, centred.inverse() * placement


def fixed_lengths(reading: MjcfReading, tendon: int) -> dict[int, float]:
    """Return what each joint adds to the length of a fixed tendon; none of a spatial one."""
    model = reading.model
    lengths: dict[int, float] = {}
    for k in range(model.tendon_adr[tendon], model.tendon_adr[tendon] + model.tendon_num[tendon]):
        if model.wrap_type[k] != int(reading.mujoco.mjtWrap.mjWRAP_JOINT):
            return {}
        joint = int(model.wrap_objid[k])
        lengths[joint] = lengths.get(joint, 0.0) + float(model.wrap_prm[k])
    return lengths


def straight_sites(reading: MjcfReading, tendon: int) -> list[int]:
    """Return the sites of a straight tendon between bodies that can move; else none."""
    model = reading.model
    wraps = slice(model.tendon_adr[tendon], model.tendon_adr[tendon] + model.tendon_num[tendon])
    kinds, sites = model.wrap_type[wraps], [int(site) for site in model.wrap_objid[wraps]]
    if len(sites) < 2 or np.any(kinds != int(reading.mujoco.mjtWrap.mjWRAP_SITE)):
        return []
    bodies = {int(model.body_weldid[model.site_bodyid[site]]) for site in sites}
    return sites if len(bodies) > 1 else []


def site_frames(reading: MjcfReading, name: str, sites: list[int]) -> list[str]:
    """Return the links of sites; those of sites without a name are added."""
    model = reading.model
    return [reading.sites.get(site) or reading.urdf.frame(
        f"{name}_{k}", reading.links[model.site_bodyid[site]],
        pose(model.site_pos[site], model.site_quat[site])) for k, site in enumerate(sites, start=1)]
