"""Published robots with closed loops: where their files are, their poses, and a page of each.

Robots of the installed package example-robot-data are always there; the others are sought in the
folders given, such as clones of mujoco_menagerie and example-parallel-robots. `pictures.py` makes
their pictures, and writes their pages.
"""

from __future__ import annotations

import pprint
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import spatial_pin as sp

sys.path.insert(0, str(Path(__file__).parents[1] / "docs" / "extensions"))

from mechanism_words import loops, mobility

DATA = "cmeel.prefix/share/example-robot-data/robots"


class Robot(NamedTuple):
    """A robot to be pictured.

    Attributes:
        name: that of its page.
        caption: text under its picture.
        file: where it lies, below the folder of its kind; a folder for formats that are one.
        source: where the file is from.
        posed: gives the state to show, of the file.
        pose: code that puts it on its feet; empty where the file has its loops.
    """

    name: str
    caption: str
    file: str
    source: str
    posed: Callable[[Path], sp.State]
    pose: str = ""


def at_guess(path: Path) -> sp.State:
    """Return a robot as its file has it, its loops closed."""
    return sp.assemble(sp.load(path))


def standing(
    feet: Sequence[str], closure: Callable[..., sp.Closure], pose: Mapping[str, float]
) -> Callable[[Path], sp.State]:
    """Return what puts a robot on its feet, each held to the ground by a closure.

    Args:
        feet: frames that touch the ground.
        closure: of `sp.closures`.
        pose: values of joints [rad]; the others are zero.
    """

    def on_feet(path: Path) -> sp.State:
        robot = sp.load(path, free_flyer=True)
        state = sp.assemble(robot, guess=pose)
        ground = [closure(foot, ("universe", state.placement(foot))) for foot in feet]
        held = sp.Mechanism.from_model(robot.model, ground, guess=state.q, name=robot.name,
                                       visual_model=robot.visual_model)
        return sp.assemble(held)

    return on_feet


def written(pose: Mapping[str, float]) -> str:
    """Return values of joints as Python, a few on a line."""
    return pprint.pformat(pose, width=80, compact=True, sort_dicts=False).replace("\n", "\n       ")


DATA_OF = "the package example-robot-data"
MENAGERIE = "[MuJoCo Menagerie](https://github.com/google-deepmind/mujoco_menagerie)"
PARALLEL = "[example-parallel-robots](https://github.com/Gepetto/example-parallel-robots)"
STAND = """pose = {guess}
robot = sp.load("{file}", free_flyer=True)
state = sp.assemble(robot, guess=pose)
ground = [sp.closures.{closure}(foot, ("universe", state.placement(foot)))
          for foot in {feet}]
mech = sp.Mechanism.from_model(robot.model, ground, guess=state.q,
                               visual_model=robot.visual_model)"""
LEGS = ("FL", "FR", "HL", "HR")
CROUCH = {f"{leg}_{joint}": angle * (1 if leg[0] == "F" else -1)
          for leg in LEGS for joint, angle in (("HFE", 0.7), ("KFE", -1.4))}
SQUAT = {f"leg_{side}_{joint}_joint": angle for side in ("left", "right")
         for joint, angle in ((3, -0.5), (4, 1.0), (5, -0.5))}
PAWS, SOLES = [f"{leg}_FOOT" for leg in LEGS], ["left_sole_link", "right_sole_link"]
ROBOTS = (
    Robot("cassie", "Cassie (SDFormat)", "cassie_description/robots/cassie_v2.sdf", DATA_OF,
          at_guess),
    Robot("solo12", "Solo12 on four feet", "solo_description/robots/solo12.urdf", DATA_OF,
          standing(PAWS, sp.closures.spherical, CROUCH),
          STAND.format(file="solo12.urdf", guess=written(CROUCH), closure="spherical", feet=PAWS)),
    Robot("talos", "Talos on both feet", "talos_data/robots/talos_reduced.urdf", DATA_OF,
          standing(SOLES, sp.closures.weld, SQUAT),
          STAND.format(file="talos_reduced.urdf", guess=written(SQUAT), closure="weld",
                       feet=SOLES)),
    Robot("cassie_mjcf", "Cassie (MJCF)", "agility_cassie/cassie.xml", MENAGERIE, at_guess),
    Robot("robotiq_2f85", "Robotiq 2F-85 (MJCF)", "robotiq_2f85/2f85.xml", MENAGERIE, at_guess),
    Robot("g1_ankle", "G1 ankle (MJCF)", "g1_ankle/urdf/23urdf311.xml",
          "a published model of one ankle of Unitree's G1", at_guess),
    Robot("digit_like", "Two legs like Digit's (URDF, robot.yaml)", "digit_like_2legs", PARALLEL,
          at_guess),
    Robot("wl16_like", "Leg of WL-16 (URDF, robot.yaml)", "wl16_like", PARALLEL, at_guess),
    Robot("parallel_delta", "robot_delta (URDF, robot.yaml)", "robot_delta", PARALLEL, at_guess),
)


def present(models: Sequence[Path]) -> Iterator[tuple[Robot, Path]]:
    """Yield the robots that are there, with where."""
    roots = [Path(site) / DATA for site in sys.path]
    roots += [site for folder in models for site in (folder, *folder.glob("*/"))]
    for robot in ROBOTS:
        places = [root / robot.file for root in roots if (root / robot.file).exists()]
        if places:
            yield robot, places[0].resolve()
        else:
            print(f"not found: {robot.file}", file=sys.stderr)


def page(robot: Robot, state: sp.State) -> str:
    """Return the page of a robot, Markdown."""
    mechanism = state.mechanism
    file = Path(robot.file).name
    opened = robot.pose or f'mech = sp.load("{file}")'
    return "\n\n".join((
        f"# {robot.caption}",
        f'![{robot.caption}](../pictures/robots/{robot.name}.jpg){{width="480px"}}',
        f"`{file}` of {robot.source}. {len(mechanism.model.names) - 1} joints, "
        f"{mechanism.model.nv} coordinates, {len(mechanism.closures)} closures, "
        f"{sum(body.mass for body in list(mechanism.model.inertias)[1:]):.4g} kg.",
        f"```python\nimport spatial_pin as sp\n\n{opened}\nsp.live(mech)\n```",
        loops(mechanism),
        mobility(mechanism, state),
    )) + "\n"
