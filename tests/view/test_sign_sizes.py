"""Signs of pairs are of the size of the parts that meet there, wherever their frames are."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from images import commands, matrix_of, page

import spatial_pin as sp

PATH = 0.4 * (1.0 - np.cos(0.3))  # of the lever's end along the plate, from side to side [m]


def press(away: float, kind: str) -> sp.Motion:
    """Return a lever that lifts a plate by its end; the plate's frame is off to the side."""
    def at(x, z=0.0):
        return pin.SE3(np.eye(3), np.array([x, 0.0, z]))

    model = pin.Model()
    for name, joint in (("lever", pin.JointModelRY()), ("plate", pin.JointModelPZ())):
        index = model.addJoint(0, joint, at(0.0), name)
        model.addBodyFrame(f"{name}_link", index, at(0.0), 0)
    model.addFrame(pin.Frame("tower", index, 0, at(0.0, 1.0), pin.FrameType.OP_FRAME))
    make = getattr(sp.closures, kind)
    touch = make(("plate_link", at(away)), ("lever_link", at(0.4)), name="touch")
    mechanism = sp.Mechanism.from_model(model, [touch], drivers=["lever"])
    return sp.sweep(mechanism, "lever", np.linspace(-0.3, 0.3, 11), speed=1.0)


def disc(motion: sp.Motion) -> tuple[float, np.ndarray]:
    """Return the radius of the plane that is drawn, and where its middle is on the plate."""
    text = page(motion, look=sp.Look(pairs=True))
    (drawn,) = [c for c in commands(text, "set_object") if c["path"].endswith(" touch 0")]
    radius = max(point["x"] for point in drawn["object"]["geometries"][0]["points"])
    return radius, matrix_of(text, drawn["path"].removeprefix("/mechanism/"))[:3, 3]


@pytest.mark.parametrize("away", [0.0, 0.2, -0.2, 0.4])
def test_the_plane_of_a_point_is_drawn_where_the_point_is_and_no_larger(away):
    radius, middle = disc(press(away, "point_on_plane"))
    assert PATH / 2 < radius < 0.2  # the lever is 0.4 m long
    assert middle == pytest.approx([0.4 - PATH / 2, 0.0, 0.0], abs=1e-3)


def test_the_size_of_the_plane_does_not_depend_on_where_its_frame_is():
    sizes = [disc(press(away, "point_on_plane"))[0] for away in (0.0, 0.1, 0.3)]
    assert sizes == pytest.approx([sizes[1]] * 3, rel=0.3)
