"""Mechanisms of the library that stand far from the world's origin, as in site coordinates."""

from pathlib import Path

import numpy as np
from folders import ROOT

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
