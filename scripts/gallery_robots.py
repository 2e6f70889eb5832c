"""Pictures of published robots with closed loops, all on one sheet.

    python scripts/gallery_robots.py [robots.jpg] [--models FOLDER ...] [--width 1440]

Robots of the installed package example-robot-data are always there; the others are sought in the
folders given, such as clones of mujoco_menagerie and example-parallel-robots. Needs Chromium or
Chrome.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from gallery import pictures, sheet

import spatial_pin as sp

DATA = "cmeel.prefix/share/example-robot-data/robots"
COLUMNS = 3


class Robot(NamedTuple):
    """A robot to be pictured.

    Attributes:
        caption: what stands under its picture.
        file: where it lies, below the folder of its kind; a folder for formats that are one.
        posed: gives the state to show, of the file.
    """

    caption: str
    file: str
    posed: Callable[[Path], sp.State]


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

    def stand(path: Path) -> sp.State:
        robot = sp.load(path, free_flyer=True)
        state = sp.assemble(robot, guess=pose)
        ground = [closure(foot, ("universe", state.placement(foot))) for foot in feet]
        held = sp.Mechanism.from_model(robot.model, ground, guess=state.q, name=robot.name,
                                       visual_model=robot.visual_model)
        return sp.assemble(held)

    return stand


LEGS = ("FL", "FR", "HL", "HR")
SQUAT = {"_3_joint": -0.5, "_4_joint": 1.0, "_5_joint": -0.5}  # of a leg of Talos [rad]
ROBOTS = (
    Robot("Cassie (SDFormat)", "cassie_description/robots/cassie_v2.sdf", at_guess),
    Robot("Solo12 on four feet", "solo_description/robots/solo12.urdf", standing(
        [f"{leg}_FOOT" for leg in LEGS], sp.closures.spherical,
        {f"{leg}_{joint}": angle * (1 if leg[0] == "F" else -1)
         for leg in LEGS for joint, angle in (("HFE", 0.7), ("KFE", -1.4))})),
    Robot("Talos on both feet", "talos_data/robots/talos_reduced.urdf", standing(
        ["left_sole_link", "right_sole_link"], sp.closures.weld,
        {f"leg_{side}{joint}": angle for side in ("left", "right")
         for joint, angle in SQUAT.items()})),
    Robot("Cassie (MJCF)", "agility_cassie/cassie.xml", at_guess),
    Robot("Robotiq 2F-85 (MJCF)", "robotiq_2f85/2f85.xml", at_guess),
    Robot("G1 ankle (MJCF)", "g1_ankle/urdf/23urdf311.xml", at_guess),
    Robot("Two legs like Digit's (URDF, robot.yaml)", "digit_like_2legs", at_guess),
    Robot("Leg of WL-16 (URDF, robot.yaml)", "wl16_like", at_guess),
    Robot("Delta (URDF, robot.yaml)", "robot_delta", at_guess),
)


def found(models: Sequence[Path]) -> Iterator[tuple[Robot, Path]]:
    """Yield the robots that are there, with where."""
    roots = [Path(place) / DATA for place in sys.path]
    roots += [place for folder in models for place in (folder, *folder.glob("*/"))]
    for robot in ROBOTS:
        places = [root / robot.file for root in roots if (root / robot.file).exists()]
        if places:
            yield robot, places[0].resolve()
        else:
            print(f"not found: {robot.file}", file=sys.stderr)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description="Pictures of robots with closed loops.")
    parser.add_argument("path", nargs="?", type=Path, default=Path("robots.jpg"),
                        help="the sheet (robots.jpg)")
    parser.add_argument("--models", nargs="+", type=Path, default=[], metavar="FOLDER",
                        help="folders of models")
    parser.add_argument("--width", type=int, help="of the sheet, to make it smaller [pixels]")
    options = parser.parse_args(arguments)
    robots = list(found(options.models))
    with tempfile.TemporaryDirectory() as folder:
        states = (robot.posed(path) for robot, path in robots)
        images = list(pictures(states, Path(folder)))
    made = sheet([robot.caption for robot, _ in robots], images, COLUMNS)
    if options.width:
        made = made.resize((options.width, round(options.width * made.height / made.width)))
    made.save(options.path, optimize=True)
    print(f"wrote {options.path}")


if __name__ == "__main__":
    main()
