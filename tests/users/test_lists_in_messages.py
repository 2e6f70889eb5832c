"""A list in a message names all that there is, however much it is."""

from __future__ import annotations

import re

import pytest

import spatial_pin as sp


def told(call) -> str:
    with pytest.raises(sp.SpatialPinError) as error:
        call()
    return str(error.value).partition("there are: ")[2]


def names_in(text: str) -> set[str]:
    """The names of a list, those told together by their endings one by one."""
    found = set()
    for part in re.split(r"(?<=\)), |(?<=\))$", text):
        stems, _, rest = part.partition(" (each ")
        own = stems.split(", ")
        if not rest:
            found |= set(own)
            continue
        # plain names stand before those that have endings
        endings = rest.rstrip(")").removeprefix("also ").removeprefix("with ").split(", ")
        found |= {f"{stem}{ending}" for stem in own for ending in endings}
        found |= set(own)
    return found


def test_every_mechanism_of_the_library_is_named():
    text = told(lambda: sp.load("zzzzzzzzz"))
    assert text.split(", ") == sp.list_mechanisms() and "..." not in text


@pytest.mark.slow
def test_every_coordinate_and_driver_is_named():
    mech = sp.load("excavator")
    text = told(lambda: mech.coordinate("zzzzzzzzz"))
    assert set(text.split(", ")) == {*mech.coordinates, *mech.drivers}


def test_every_link_frame_and_joint_is_named():
    mech = sp.load("excavator")
    text = told(lambda: mech.frame_id("zzzzzzzzz"))
    assert len(text.split(", ")) > 40 and {*mech.links, *mech.model.names[1:]} <= set(
        text.split(", "))


def test_outputs_are_all_named_in_a_message_that_can_be_read():
    mech = sp.load("excavator")
    motion = sp.sweep(mech, "boom", [2.7, 2.71])
    text = told(lambda: motion.output("zzzzzzzzz"))
    assert len(text) < 2000 and "..." not in text
    named = names_in(text)
    for name in (*mech.drivers, *mech.coordinates):
        assert {name, f"{name}.rate", f"{name}.velocity", f"{name}.ratio"} <= named
    for name in mech.links:
        assert {f"{name}.position", f"{name}.velocity", f"{name}.angle"} <= named
    assert {"mass", "com.position"} <= named
