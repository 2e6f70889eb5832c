"""Types by the words of books and other tools: the message has the word that is meant here."""

from __future__ import annotations

import re

import pytest

import spatial_pin as sp

TREE = """<robot name="two"><link name="ground"/><link name="a"/><link name="b"/>
<joint name="one" type="continuous"><parent link="ground"/><child link="a"/></joint>
<joint name="two" type="{kind}"><parent link="ground"/><child link="b"/></joint></robot>"""


def refused(folder, text, kind="floating") -> str:
    """Load a mechanism file, and return why it is refused."""
    (folder / "two.urdf").write_text(TREE.format(kind=kind))
    (folder / "two.toml").write_text(f'name = "two"\ntree = "two.urdf"\n{text}')
    with pytest.raises(sp.MechanismFileError) as told:
        sp.load(folder / "two.toml")
    return str(told.value)


def closure(kind: str) -> str:
    return f'[[closures]]\nname = "x"\ntype = "{kind}"\nframes = ["a", "b"]\n'


def joint(kind: str) -> str:
    return f'[joints.two]\ntype = "{kind}"\n'


@pytest.mark.parametrize(("word", "meant"), [
    ("hinge", "revolute"), ("Hinge", "revolute"), ("pin joint", "revolute"),
    ("slider", "prismatic"), ("ball", "spherical"), ("ball-joint", "spherical"),
    ("cardan", "universal")])
def test_the_intended_word_is_offered_and_is_accepted(word, meant, tmp_path):
    for table in (closure, joint):
        assert refused(tmp_path, table(word)).endswith(f"type is {word!r}; did you mean {meant!r}?")
    (tmp_path / "two.toml").write_text(f'name = "two"\ntree = "two.urdf"\n{joint(meant)}')
    assert sp.load(tmp_path / "two.toml").pair_of("two") == meant


@pytest.mark.parametrize("word", ["gear", "belt", "rack", "mimic", "pulley"])
def test_what_ties_two_joints_is_a_coupling(word, tmp_path):
    for table in (closure, joint):
        text = refused(tmp_path, table(word))
        assert 'type = "coupling", joints = ["a", "b"] and a ratio' in text


@pytest.mark.parametrize(("word", "what"), [("rolling", "contact between bodies is not modelled"),
                                            ("contact", "contact between bodies is not modelled")])
def test_what_is_not_modelled_is_stated_with_where_to_look(word, what, tmp_path):
    for table in (closure, joint):
        text = refused(tmp_path, table(word))
        assert what in text and "`clearance` tells where links touch" in text


def test_a_type_of_the_other_table_is_named_with_its_table(tmp_path):
    assert refused(tmp_path, joint("rod")).endswith(
        "did you mean 'distance'? a mechanism file has that below [[closures]]")
    assert refused(tmp_path, closure("free")).endswith(
        "did you mean 'floating'? a mechanism file has that below [joints.NAME]")


def test_a_urdf_has_hinges_and_balls_too(tmp_path):
    assert "did you mean 'revolute'?" in refused(tmp_path, "", "hinge")
    assert "did you mean 'spherical'? a mechanism file has that below [joints.NAME]" in refused(
        tmp_path, "", "ball")


def test_an_unknown_word_is_answered_with_all_types(tmp_path):
    types = re.findall(r"\w+", refused(tmp_path, closure("zzz")).partition("there are: ")[2])
    assert types[:3] == ["revolute", "prismatic", "screw"] and types[-1] == "coupling"


@pytest.mark.parametrize(("word", "words"), [
    ("hinge", "did you mean 'revolute'?"), ("gear", '"coupling"'),
    ("cable", "did you mean 'rope'?"),
    ("follower", "did you mean 'cam'?"), ("wheel", "not modelled")])
def test_closures_made_in_code_have_other_words_too(word, words):
    with pytest.raises(AttributeError, match=re.escape(words)):
        getattr(sp.closures, word)
