"""A mechanism beside MuJoCo's model of the same file: the same configuration in both."""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

import spatial_pin as sp

FREE, BALL = 0, 1  # types of joints


@dataclass
class Pair:
    """A mechanism and MuJoCo's model and data; joints in MuJoCo's order."""

    mech: sp.Mechanism
    model: object
    data: object

    @property
    def joints(self):
        """(our joint index, MuJoCo's joint index) of every joint: the same order."""
        return [(j + 1, j) for j in range(self.model.njnt)]


def beside(mech, model):
    import mujoco

    return Pair(mech, model, mujoco.MjData(model))


def put(pair, q):
    """Put MuJoCo at our configuration q (nq,)."""
    import mujoco

    for ours, theirs in pair.joints:
        at, to = pair.mech.model.idx_qs[ours], pair.model.jnt_qposadr[theirs]
        kind, count = pair.model.jnt_type[theirs], pair.mech.model.nqs[ours]
        values = q[at:at + count].copy()
        if kind in (FREE, BALL):
            values[-4:] = values[[-1, -4, -3, -2]]
        pair.data.qpos[to:to + count] = values
    mujoco.mj_forward(pair.model, pair.data)


def velocities(pair):
    """Matrix (nv, nv): MuJoCo's velocity of ours, at the configuration of `put`."""
    matrix = np.zeros((pair.model.nv, pair.mech.model.nv))
    for ours, theirs in pair.joints:
        at, to = pair.mech.model.idx_vs[ours], pair.model.jnt_dofadr[theirs]
        count = pair.mech.model.nvs[ours]
        block = np.eye(count)
        if pair.model.jnt_type[theirs] == FREE:
            body = pair.model.jnt_bodyid[theirs]
            block[:3, :3] = pair.data.xmat[body].reshape(3, 3)
        matrix[to:to + count, at:at + count] = block
    return matrix


def random_configuration(mech, rng):
    """Angles up to a turn and lengths up to 1 m, whatever the limits say."""
    parts = []
    for i in range(1, mech.model.njoints):
        x = rng.uniform(-1.0, 1.0, mech.model.nqs[i])
        if mech.model.nqs[i] in (4, 7):
            x[-4:] /= np.linalg.norm(x[-4:])
        parts.append(x if mech.model.nqs[i] > 1 else 3.0 * x)
    return np.concatenate(parts) if parts else np.empty(0)


def placement_gap(pair, q):
    """Largest difference between the placements of bodies and sites here and there [m, -]."""
    put(pair, q)
    data = pair.mech.model.createData()
    pin.framesForwardKinematics(pair.mech.model, data, q)
    worst = 0.0
    model, there = pair.model, pair.data
    sites = [(model.site(s).name, there.site_xpos[s], there.site_xmat[s])
             for s in range(model.nsite) if model.site(s).name not in _others(model)]
    bodies = [(model.body(b).name, there.xpos[b], there.xmat[b]) for b in range(1, model.nbody)]
    for name, position, rotation in bodies + sites:
        if name:
            here = data.oMf[pair.mech.frame_id(name)]
            worst = max(worst, np.abs(here.translation - position).max(),
                        np.abs(here.rotation - rotation.reshape(3, 3)).max())
    return worst


def _others(model):
    return {x.name for x in (*map(model.body, range(model.nbody)),
                             *map(model.joint, range(model.njnt)))}


def mass_matrices(pair, q):
    """The mass matrix of the open tree here and there, both (nv, nv) in our velocities."""
    import mujoco

    put(pair, q)
    theirs = np.zeros((pair.model.nv, pair.model.nv))
    try:
        mujoco.mj_fullM(pair.model, pair.data, theirs)
    except TypeError:  # MuJoCo 3
        mujoco.mj_fullM(pair.model, theirs, pair.data.qM)
    turn = velocities(pair)
    ours = pin.crba(pair.mech.model, pair.mech.model.createData(), q)
    ours = np.triu(ours) + np.triu(ours, 1).T
    return ours, turn.T @ theirs @ turn


def equality_jacobian(pair, q):
    """MuJoCo's Jacobian (ne, nv) of its equalities at q, in our velocities."""
    import mujoco

    put(pair, q)
    pair.model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    mujoco.mj_forward(pair.model, pair.data)
    rows = pair.data.efc_J.reshape(-1, pair.model.nv)[pair.data.efc_type == 0]
    return rows @ velocities(pair)


def without_meshes(path):
    """MuJoCo's model of a file whose mesh files are not there."""
    import mujoco

    spec = mujoco.MjSpec.from_file(str(path))
    for geom in [g for g in spec.geoms if g.type == mujoco.mjtGeom.mjGEOM_MESH]:
        spec.delete(geom)
    for material in spec.materials:
        material.textures = [""] * len(material.textures)
    for element in [*spec.meshes, *spec.textures]:
        spec.delete(element)
    return spec.compile()


def residual(pair, q):
    """Largest equation of MuJoCo's equalities at q [m, -]."""
    put(pair, q)
    return np.abs(pair.data.efc_pos[pair.data.efc_type == 0]).max(initial=0.0)


def rank(matrix):
    """Rank of a matrix whose rows are of similar size."""
    if not matrix.size:
        return 0
    return int(np.linalg.matrix_rank(matrix, tol=1e-8 * np.linalg.norm(matrix, 2)))


def accelerations(pair, q, rng):
    """Acceleration (nv,) of the open tree at q and a random velocity, here and there.

    A floating base turns but does not slide: the derivative of its linear velocity differs there.
    """
    import mujoco

    put(pair, q)
    v = rng.uniform(-1.0, 1.0, pair.mech.model.nv)
    for ours, theirs in pair.joints:
        if pair.model.jnt_type[theirs] == FREE:
            at = pair.mech.model.idx_vs[ours]
            v[at:at + 3] = 0.0
    turn = velocities(pair)
    pair.data.qvel[:] = turn @ v
    mujoco.mj_forward(pair.model, pair.data)
    state = sp.State(pair.mech, q, v, closure_error=0.0)
    return sp.forward_dynamics(pair.mech, state).a, turn.T @ pair.data.qacc_smooth
