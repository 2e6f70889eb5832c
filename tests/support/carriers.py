"""A crank that turns past a post: links of balls and rods."""

import spatial_pin as sp


def solid(shape: str, xyz=(0.0, 0.0, 0.0), rpy=(0.0, 0.0, 0.0), kind: str = "visual") -> str:
    place = " ".join(map(str, xyz)), " ".join(map(str, rpy))
    return (f'<{kind}><origin xyz="{place[0]}" rpy="{place[1]}"/><geometry>{shape}</geometry>'
            f"</{kind}>")


def ball(radius: float, x: float = 0.0, y: float = 0.0, z: float = 0.0, kind="visual") -> str:
    return solid(f'<sphere radius="{radius}"/>', (x, y, z), kind=kind)


def arm(folder, ground: str, turning: str, more: str = "", name: str = "arm"):
    """Return a crank about z on a carrier without a shape, a post on the ground."""
    (folder / f"{name}.urdf").write_text(
        f'<robot name="{name}"><link name="post">{ground}</link><link name="carrier"/>'
        f'<link name="crank">{turning}</link>{more}'
        '<joint name="slide" type="fixed"><parent link="post"/><child link="carrier"/></joint>'
        '<joint name="turn" type="continuous"><parent link="carrier"/><child link="crank"/>'
        '<axis xyz="0 0 1"/></joint></robot>')
    return sp.load(folder / f"{name}.urdf")
