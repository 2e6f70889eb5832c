"""Reactions of the pairs that bear the force of a coupling, which does not say where it acts."""

import mechanisms as known
import numpy as np
import pytest
from masses import heavy

import spatial_pin as sp

BODY = (2.0, (0.05, 0.02, 0.01), (0.02, 0.03, 0.04))
ROPE = 'name = "rope"\ntype = "coupling"\njoints = ["drum", "guide"]\nratio = 0.2\n'
ALONG = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}


def hoist(folder, axis=(0, 1, 0), rpy=(0, 0, 0), more="", closures=""):
    """A drum, a car on a guide at its rim, and a winch that nothing couples."""
    tree = known.turning("drum", "ground", "barrel", axis=axis, rpy=rpy)
    tree += known.sliding("guide", "ground", "car", (0.2, 0, 0), axis=(0, 0, 1))
    tree += known.turning("winch", "ground", "wheel", (1, 0, 0), axis=(0, 0, 1)) + more
    text = "[[closures]]\n" + ROPE + closures + '[drivers]\nd = { joint = "drum" }\n'
    text += 'w = { joint = "winch" }\n'
    return known.load(folder, "hoist", heavy(tree, barrel=BODY, car=BODY, wheel=BODY), text)


def unique(found, name):
    return "".join("xyz"[k % 3] if one else "-" for k, one in enumerate(found.unique[name]))


@pytest.mark.parametrize("verb", [sp.forward_dynamics, sp.inverse_dynamics])
@pytest.mark.parametrize("name", ALONG)
def test_the_pairs_of_both_joints_are_unique_where_they_move_alone(name, verb, tmp_path):
    mech = hoist(tmp_path, ALONG[name])
    found = verb(mech, sp.assemble(mech, {"d": 0.4}))
    own = "xyz".index(name)
    assert unique(found, "drum") == "-" * (3 + own) + name + "-" * (2 - own)
    assert unique(found, "guide") == "--z---"
    assert unique(found, "winch") == "xyzxyz"
    assert found.determined == {"drum": False, "guide": False, "winch": True}


def test_an_axis_between_those_of_the_world_leaves_nothing_unique(tmp_path):
    mech = hoist(tmp_path, rpy=(0.4, 0.0, 0.3))
    assert unique(sp.inverse_dynamics(mech, sp.assemble(mech)), "drum") == "------"


def test_every_pair_between_the_two_joints_bears_it_and_none_before_or_behind(tmp_path):
    """A pulley at the hand, pulled from the shoulder over the elbow."""
    names = ("waist", "shoulder", "elbow", "wrist", "finger")
    links = ("ground", "column", "upper", "lower", "hand", "tip")
    tree = "".join(known.turning(name, links[k], links[k + 1], (0.3, 0, 0), axis=(0, 1, 0))
                   for k, name in enumerate(names))
    tree = heavy(tree, **{link: BODY for link in links[1:]})
    mech = known.load(tmp_path, "arm", tree, '[[closures]]\nname = "tendon"\ntype = "coupling"\n'
                      'joints = ["shoulder", "wrist"]\n')
    found = sp.forward_dynamics(mech, sp.assemble(mech, {"elbow": 0.4}))
    assert found.determined == {"waist": True, "shoulder": False, "elbow": False, "wrist": False,
                                "finger": True}
    assert unique(found, "elbow") == "----y-"


def test_a_nut_on_its_screw_bears_it_in_all_that_does_not_move(tmp_path):
    tree = heavy(known.joint("floating", "nut", "ground", "block"), block=BODY)
    mech = known.load(tmp_path, "nut", tree, known.refine("nut", "cylindrical") + (
        '[[closures]]\nname = "lead"\ntype = "coupling"\njoints = ["nut.angle", "nut.slide"]\n'
        "ratio = 0.01\n"))
    assert unique(sp.forward_dynamics(mech, sp.assemble(mech)), "nut") == "--z--z"


def test_gears_of_a_loop_leave_the_pins_of_its_rods_as_they_are():
    mech = sp.load("geared_five_bar")
    found = sp.forward_dynamics(mech, sp.assemble(mech))
    coupling = next(c for c in mech.closures if c.type == "coupling")
    for name in found.reactions:
        in_plane = found.unique[name][[0, 2, 4]] if found.unique[name][0] else found.unique[name]
        assert in_plane.any() and found.determined[name] is False
        if name in coupling.joints:
            assert not found.unique[name][:3].any()
        else:
            assert found.unique[name][:3].sum() == 2


def test_every_sample_of_a_motion_is_marked(tmp_path):
    mech = hoist(tmp_path)
    loads = sp.kinetostatics(mech, sp.sweep(mech, "d", [0.0, 1.0, 2.0], speed=1.0, hold=["winch"]))
    assert not loads.determined["drum"].any() and loads.determined["winch"].all()
    assert loads.marks("drum") == (" *xyz", " *xz") and loads.marks("winch") == ("", "")


WHY = ("* without the force of 'rope', which drum, guide bear too: a coupling does not say where "
       "it acts")


def test_results_say_why(tmp_path, run):
    mech = hoist(tmp_path)
    state = sp.assemble(mech)
    loads = sp.kinetostatics(mech, sp.sweep(mech, "d", [0.0, 1.0], speed=1.0, hold=["winch"]))
    for found in (sp.inverse_dynamics(mech, state), sp.forward_dynamics(mech, state), loads):
        assert found.why_not_unique() == [WHY]
        assert WHY in str(found) and "one of many" not in str(found)
    assert WHY.replace("'", "&#x27;") in loads._repr_html_()
    code, text, _ = run("statics", mech.path)
    assert code == 0 and WHY in " ".join(text.split()) and "one of many" not in text
    sp.report(loads.motion, tmp_path / "page.html", outputs=["d", "drum.reaction.force"])
    assert WHY.replace("'", "&#x27;") in (tmp_path / "page.html").read_text(encoding="utf-8")


def test_both_reasons_are_reported_where_both_hold(tmp_path):
    """A second hinge about the winch's axis beside the rope."""
    more = known.point("one", "ground", (1, 0, 0.3)) + known.point("two", "wheel", (0, 0, 0.3))
    mech = hoist(tmp_path, more=more, closures=known.closure("upper", "revolute", "one", "two"))
    text = str(sp.inverse_dynamics(mech, sp.assemble(mech)))
    assert WHY in text and "one of many" in text


def test_without_couplings_nothing_is_marked():
    mech = sp.load("rssr")
    found = sp.forward_dynamics(mech, sp.assemble(mech))
    assert all(found.determined.values()) and not found.why_not_unique()
    assert np.all([each.all() for each in found.unique.values()])
