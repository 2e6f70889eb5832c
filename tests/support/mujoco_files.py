"""MuJoCo's models, and MuJoCo's own answers on them."""

import numpy as np
import pytest
from folders import DATA

import spatial_pin as sp

mujoco = pytest.importorskip("mujoco")
MJCF = DATA / "mjcf"
CASSIE = MJCF / "agility_cassie" / "cassie.xml"
GRIPPER = MJCF / "robotiq_2f85" / "2f85.xml"
ANKLE = MJCF / "g1_ankle" / "g1_ankle.xml"


def opened(file):
    """A mechanism whose mesh files are not there."""
    with pytest.warns(UserWarning, match="mesh") as seen:
        mech = sp.load(file)
    assert all("not there" in str(w.message) for w in seen)
    return mech


def written(tmp_path, text, name="model.xml"):
    path = tmp_path / name
    path.write_text(f"<mujoco>{text}</mujoco>", encoding="utf-8")
    return path


def closed_by_mujoco(pair, q, unknown):
    """MuJoCo's configuration near qpos q, its equalities closed by the unknown velocities."""
    pair.model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    pair.data.qpos[:] = q
    for _ in range(12):
        mujoco.mj_forward(pair.model, pair.data)
        rows = pair.data.efc_type == 0
        jacobian = pair.data.efc_J.reshape(-1, pair.model.nv)[np.ix_(rows, unknown)]
        step = np.zeros(pair.model.nv)
        step[unknown] = -np.linalg.pinv(jacobian, rcond=1e-6) @ pair.data.efc_pos[rows]
        mujoco.mj_integratePos(pair.model, pair.data.qpos, step, 1.0)
    mujoco.mj_forward(pair.model, pair.data)
    return pair.data.qpos.copy()


ARMS = """
<compiler autolimits="true"/>
<worldbody>
  <site name="w" pos=".4 .1 .9" quat="1 .1 .2 .3"/>
  <body name="u" pos="0 0 1"><joint name="u1" axis="0 1 0" ref=".3"/><joint name="u2" axis="1 0 0"/>
    <geom size=".1"/><site name="su" pos=".1 0 .2" quat="1 0 .3 0"/>
    <body name="u_tip" pos="0 0 .5" quat="1 0 1 0"><geom size=".05"/>
      <body name="v" pos=".2 .1 0"><joint name="v1" type="ball"/><geom size=".1" pos=".1 0 0"/>
        <body name="v_end" pos="0 .3 .1"><joint name="v2" type="slide" axis="1 2 3" ref="-.2"/>
          <geom size=".1"/><site name="sv" pos=".1 .1 0" quat="1 .2 0 .5"/></body></body>
    </body></body>
  <body name="f" pos=".5 0 1" quat="1 .2 .3 0"><freejoint/><geom size=".1"/>
    <site name="sf" pos="0 .1 .1" quat="1 1 0 .2"/>
    <body name="f_tip" pos=".1 0 .3" quat="1 1 0 0"><geom size=".1"/></body></body>
</worldbody>"""
SLIDER = """
<worldbody><body name="a"><joint name="q" axis="0 1 0" stiffness="3" springref="20"/>
  <joint name="s" type="slide" axis="1 0 0" stiffness="7" springref=".2"/><geom size=".1"/>
  <site name="sa" pos=".1 0 0"/></body>
  <body name="b" pos="1 0 0"><joint name="p" axis="0 1 0"/><geom size=".1"/><site name="sb"/></body>
  <body name="c" pos="0 0 3" quat="1 1 0 0"><joint name="ball" type="ball"/><geom size=".1"/></body>
  <body name="d" pos="0 0 5"><freejoint/><geom size=".1"/></body>
</worldbody>
<tendon>
  <fixed name="both"><joint joint="q" coef=".5"/><joint joint="p" coef=".5"/></fixed>
  <fixed name="apart"><joint joint="q" coef="1"/><joint joint="s" coef="1"/></fixed>
  <spatial name="string" stiffness="9" springlength=".4">
    <site site="sa"/><site site="sb"/></spatial>
</tendon>
<equality><joint joint1="p" joint2="q"/></equality>"""
