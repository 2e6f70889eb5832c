"""Inside of workspaces: what is shown of one, and what an interruption leaves."""

import numpy as np
import pytest
from five_bars import BARS, five_bar

import spatial_pin as sp
from spatial_pin.view.scene.film import film
from spatial_pin.view.scene.meshcat_commands import scene
from spatial_pin.workspace import workspace as module


@pytest.fixture(scope="module")
def found(tmp_path_factory) -> sp.Workspace:
    bars = five_bar(tmp_path_factory.mktemp("bars"))
    return sp.workspace(bars, "tip", BARS, points=25)


@pytest.fixture
def interrupted(monkeypatch):
    """Ctrl-C after some two hundred points."""
    class Bar:
        n = 0

        def __enter__(self):
            return self

        def __exit__(self, *error):
            pass

        def update(self, done):
            self.n += done
            if self.n > 200:
                raise KeyboardInterrupt

    monkeypatch.setattr(module, "progress_bar", lambda *args: Bar())


def test_a_command_that_was_interrupted_writes_what_was_found_and_says_so(
    interrupted, tmp_path, run
):
    table = tmp_path / "points.csv"
    code, said, _ = run("workspace", "excavator", "teeth", "boom=2.6..2.8", "bucket=2.1..2.4",
                        "--points", "30", "--csv", table)
    assert code == 130 and "cut short" in said
    assert table.read_text().count("\n") == 901


def test_results_from_before_an_interruption_are_returned(found, interrupted):
    with pytest.raises(sp.Interrupted) as stopped:
        sp.workspace(found.mechanism, "tip", BARS, points=25)
    part = stopped.value.result
    assert not part.is_whole
    assert "cut short" in str(part)
    assert 200 < np.count_nonzero(part.reached) < np.count_nonzero(found.reached)
    np.testing.assert_array_equal(part.points[part.reached], found.points[part.reached])
    assert "not looked at" in part.why


def test_points_and_borders_are_balls_of_the_scene(found):
    row = int(np.flatnonzero(found.reached)[0])
    layer = scene(film(found.state(row)), sp.Look(workspace=found)).layer
    balls = [item for item in layer.items if item.name.startswith("workspace")]
    assert balls[-1].name == "workspace ends"
    n = sum(len(item.solid.geometry.vertices) for item in balls) / 6
    assert n == np.count_nonzero(found.reached) + len(found.boundary)
    assert any("dexterity" in entry.text for entry in layer.legend)
