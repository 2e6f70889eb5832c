"""Accelerations of open trees in mpmath, body by body [Featherstone2008, 7.3]: no code of ours.

Spatial vectors are linear before angular, in the axes of each joint.
"""

import numpy as np
import pinocchio as pin
from mpmath import cos, mp, mpf, sin, sqrt


def exact(x):
    return np.vectorize(mpf, otypes=[object])(np.asarray(x, float))


def skew(p):
    x, y, z = p
    return np.array([[mpf(0), -z, y], [z, mpf(0), -x], [-y, x, mpf(0)]])


def blocks(a, b, c, d):
    return np.block([[a, b], [c, d]])


def turned(axis, angle):
    k = skew(axis)
    return exact(np.eye(3)) + sin(angle) * k + (1 - cos(angle)) * k.dot(k)


def of_quaternion(q):
    x, y, z, w = q / sqrt(sum(q * q))
    k = skew((x, y, z))
    return exact(np.eye(3)) + 2 * w * k + 2 * k.dot(k)


def single(joint, q):
    """Rotation, place and motion subspace of a joint at its own q."""
    name = joint.shortname().removeprefix("JointModel")
    none, subspace = exact(np.zeros(3)), exact(np.zeros((6, joint.nv)))
    if name == "FreeFlyer":
        return of_quaternion(q[3:]), q[:3], exact(np.eye(6))
    if name == "Spherical":
        subspace[3:] = exact(np.eye(3))
        return of_quaternion(q), none, subspace
    axis = exact(joint.axis if hasattr(joint, "axis") else np.eye(3)["XYZ".index(name[-1])])
    axis = axis / sqrt(sum(axis * axis))
    slide = {"R": 0, "P": 1}.get(name[0]) if name[0] != "H" else mpf(joint.pitch)
    subspace[:3, 0] = axis * slide
    if name[0] == "P":
        return exact(np.eye(3)), axis * q[0], subspace
    subspace[3:, 0] = axis
    return turned(axis, q[0]), axis * slide * q[0], subspace


def parts(joint, q):
    """The same of its single joints, one after the other."""
    if joint.shortname() == "JointModelUniversal":
        axes = joint.axis1, joint.axis2
        return [single(pin.JointModelRevoluteUnaligned(axis), q[k : k + 1])
                for k, axis in enumerate(axes)]
    return [single(joint, q)]


def inverse(a):
    return np.array((mp.matrix(a.tolist()) ** -1).tolist()).reshape(a.shape)


def accelerations(model, q, v, tau, digits=40):
    """(nv,) joint accelerations under joint forces."""
    with mp.workdps(digits):
        return _accelerations(model, exact(q), exact(v), exact(tau)).astype(float)


def _accelerations(model, q, v, tau):
    armature, zero = exact(model.armature), exact(np.zeros((3, 3)))
    steps, last, speed = [], [-1], {-1: exact(np.zeros(6))}
    for i in range(1, model.njoints):
        up, at, first = last[model.parents[i]], model.jointPlacements[i], model.idx_vs[i]
        turn, place, body = exact(at.rotation), exact(at.translation), model.inertias[i]
        own = q[model.idx_qs[i] : model.idx_qs[i] + model.nqs[i]]
        joint = model.joints[i]
        singles = parts(joint.extract() if hasattr(joint, "extract") else joint, own)
        for k, (rotation, shift, subspace) in enumerate(singles):
            R, p = turn.dot(rotation), place + turn.dot(shift)
            turn, place = exact(np.eye(3)), exact(np.zeros(3))
            X = blocks(R.T, -R.T.dot(skew(p)), zero, R.T)
            rows = slice(first, first + subspace.shape[1])
            first = rows.stop
            moved = subspace.dot(v[rows])
            w = speed[len(steps)] = X.dot(speed[up]) + moved
            cross = blocks(skew(w[3:]), skew(w[:3]), zero, skew(w[3:]))
            m, c, one = mpf(body.mass), skew(exact(body.lever)), exact(np.eye(3))
            inertia = blocks(m * one, -m * c, m * c, exact(body.inertia) - m * c.dot(c))
            inertia = inertia * int(k == len(singles) - 1)
            steps.append([up, X, subspace, rows, cross.dot(moved), inertia,
                          -cross.T.dot(inertia.dot(w))])
            up = len(steps) - 1
        last.append(up)
    for step in reversed(steps):
        up, X, S, rows, bias, inertia, wrench = step
        U = inertia.dot(S)
        D = inverse(S.T.dot(U) + np.diag(armature[rows]))
        u = tau[rows] - S.T.dot(wrench)
        rest = inertia - U.dot(D).dot(U.T)
        if up >= 0:
            steps[up][5] = steps[up][5] + X.T.dot(rest).dot(X)
            steps[up][6] = steps[up][6] + X.T.dot(wrench + rest.dot(bias) + U.dot(D.dot(u)))
        step.append((U, D, u))
    found, motion = exact(np.zeros(model.nv)), {-1: exact(np.zeros(6))}
    motion[-1][:3] = -exact(model.gravity.linear)
    for k, (up, X, S, rows, bias, _, _, (U, D, u)) in enumerate(steps):
        motion[k] = X.dot(motion[up]) + bias
        found[rows] = D.dot(u - U.T.dot(motion[k]))
        motion[k] = motion[k] + S.dot(found[rows])
    return found
