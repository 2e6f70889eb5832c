"""A four-bar has its Grashof type however often the pin that closes it is stated."""

import pytest

import spatial_pin as sp

LENGTHS = {"ground": 0.3, "crank": 0.1, "coupler": 0.28, "rocker": 0.24}


def four_bar(folder, *pins, points=""):
    """The library's four-bar, closed by these pins; points are more links of its tree."""
    tree = sp.load("four_bar").urdf.replace("</robot>", f"{points}</robot>")
    (folder / "m.urdf").write_text(tree, encoding="utf-8")
    closures = "".join(f'[[closures]]\nname = "pin_{k}"\ntype = "{kind}"\nframes = ["{a}", "{b}"]\n'
                       + "axis = [0, -1, 0]\n" * (kind != "spherical")
                       for k, (kind, a, b) in enumerate(pins))
    (folder / "m.toml").write_text(
        f'name = "m"\ntree = "m.urdf"\n{closures}[drivers.crank]\njoint = "crank_pin"\n'
        "[guess]\ncrank_pin = 0.0\nrocker_pin = 1.77\n", encoding="utf-8")
    return sp.load(folder / "m.toml")


def beside(y, z=0.0):
    """Points on coupler and rocker that stand beside the pin, along its axis."""
    return "".join(
        f'<link name="{name}"/><joint name="{name}_mount" type="fixed"><parent link="{on}"/>'
        f'<child link="{name}"/><origin xyz="0 {y} {z}"/></joint>'
        for name, on in (("coupler_c", "coupler_b"), ("rocker_c", "rocker_b")))


PIN = ("revolute", "coupler_b", "rocker_b")


@pytest.mark.parametrize("pins", [
    [PIN], [PIN, PIN], [PIN, ("revolute", "rocker_b", "coupler_b"), PIN],
    [PIN, ("revolute", "coupler_c", "rocker_c")], [("spherical", "coupler_c", "rocker_c"), PIN],
    [PIN, ("spherical", "rocker_b", "coupler_b")], [PIN, ("revolute", "ground", "crank")],
    [PIN, ("spherical", "crank", "ground"), PIN]])
def test_a_pin_that_is_stated_several_times_is_one_pin(pins, tmp_path):
    found = sp.grashof(four_bar(tmp_path, *pins, points=beside(0.05)))
    assert found.type == "crank-rocker"
    assert found.lengths == pytest.approx(LENGTHS, abs=1e-9)


@pytest.mark.parametrize("pins", [
    [PIN, ("parallel", "coupler_b", "rocker_b")], [("spherical", "coupler_b", "rocker_b")]])
def test_what_states_no_pin_of_the_loop_makes_no_four_bar(pins, tmp_path):
    with pytest.raises(sp.SpatialPinError, match="not one plane loop of four revolute pairs"):
        sp.grashof(four_bar(tmp_path, *pins))


def test_types_of_four_bars_are_spelled_alike():
    kinds = {sp.grashof(sp.load("four_bar", r1=r1, r2=r2, r3=r3, r4=r4)).type
             for r1, r2, r3, r4 in ((0.3, 0.1, 0.28, 0.24), (0.1, 0.3, 0.28, 0.24),
                                    (0.3, 0.24, 0.1, 0.28), (0.28, 0.24, 0.3, 0.1))}
    assert kinds == {"crank-rocker", "double-crank", "double-rocker", "rocker-crank"}
