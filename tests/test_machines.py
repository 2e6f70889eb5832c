"""The machines of the examples answer as closed forms and published numbers do.

Each script is run once; what it worked out is compared with geometry and mechanics that are written
here anew: circles and spheres that meet, moments about pins, virtual work, ordinary integration.
"""

import functools
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest

import spatial_pin as sp

EXAMPLES = Path(__file__).parent.parent / "examples"


@functools.cache
def ran(name: str, folder: str) -> dict:
    """Run an example without its pictures and return what its names stand for."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", [name, folder])
        patch.setattr(sp, "screenshot", lambda *arguments, **keywords: None)
        return runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")


@pytest.fixture
def run(tmp_path_factory):
    """Give what runs an example."""
    folder = str(tmp_path_factory.getbasetemp() / "made")
    return lambda name: ran(name, folder)


def meet(centre_1, radius_1, centre_2, radius_2, side):
    """Return where two circles meet, left (1) or right (-1) of the way from 1 to 2."""
    way = np.subtract(centre_2, centre_1)
    d = np.hypot(*way)
    along = (radius_1**2 - radius_2**2 + d**2) / (2 * d)
    across = side * np.sqrt(radius_1**2 - along**2)
    return np.asarray(centre_1) + (along * way + across * np.array([-way[1], way[0]])) / d


@pytest.mark.parametrize("script", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.stem)
def test_a_machine_is_asked_in_less_than_sixty_lines(script):
    if (EXAMPLES / "machines" / f"{script.stem}.toml").exists():
        assert len(script.read_text(encoding="utf-8").splitlines()) < 60


# ---------------------------------------------------------------- Jansen's leg

def jansen_foot(crank):
    """Return where the foot is [cm], from circles that meet."""
    tip, pin = 15.0 * np.array([np.cos(crank), np.sin(crank)]), np.array([-38.0, -7.8])
    top = meet(tip, 50.0, pin, 41.5, -1)
    knee = meet(tip, 61.9, pin, 39.3, 1)
    back = meet(top, 55.8, pin, 40.1, -1)
    heel = meet(back, 39.4, knee, 36.7, -1)
    return meet(heel, 65.7, knee, 49.0, -1)


def test_the_foot_of_jansens_leg_is_where_circles_meet(run):
    made = run("jansen_leg")
    wanted = np.array([jansen_foot(crank) for crank in made["motion"].driver[:-1]])
    assert abs(100 * made["foot"][:, [0, 2]] - wanted).max() < 1e-11
    assert abs(made["foot"][:, 1]).max() < 1e-14
