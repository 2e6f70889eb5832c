"""Mechanisms of the library that stand far from the world's origin, as in site coordinates."""

from pathlib import Path

import numpy as np
from folders import ROOT
from published_models import joint, made, point, rod

import spatial_pin as sp

DIRECTION = np.array([0.1, 1.0, -0.37])


def on_site(tmp_path: Path, name: str, away: float, **dimensions: float) -> sp.Mechanism:
    """Return a mechanism whose base is joined to the world at `away` m along `DIRECTION`."""
    folder = tmp_path / f"{name} {away:g}"
    folder.mkdir()
    for file in ("parts.xacro", f"{name}.toml"):
        (folder / file).write_bytes((ROOT / "urdf" / file).read_bytes())
    tree, base = (ROOT / "urdf" / f"{name}.urdf.xacro").read_text(), sp.load(name).links[0]
    place = " ".join(map(repr, (away * DIRECTION).tolist()))
    (folder / f"{name}.urdf.xacro").write_text(tree.replace("</robot>", (
        f'<link name="site"/><joint name="survey" type="fixed"><parent link="site"/>'
        f'<child link="{base}"/><origin xyz="{place}"/></joint></robot>')))
    return sp.load(folder / f"{name}.toml", **dimensions)


SPRING = """
[drivers.pin]
joint = "pin"

[[springs]]
name = "coil"
frames = ["tip", "post"]
stiffness = 40.0
damping = 0.0
free_length = 0.3
"""


def sprung(away: float) -> sp.Mechanism:
    """Return an arm that a spring pulls to a post on the ground, both `away` from the origin."""
    tree = joint("continuous", "pin", "ground", "arm", (away, away, 0.0),
                 mass=rod(1.0, (0.5, 0.0, 0.0)))
    tree += point("tip", "arm", (0.5, 0.0, 0.0))
    tree += point("post", "ground", (away, away + 1.0, 0.0))
    return made("spring", tree, SPRING, (0.0, -9.81, 0.0))
