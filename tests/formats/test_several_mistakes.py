"""Several mistakes of a mechanism file are found in one run; a single one is told as ever."""

from __future__ import annotations

import copy
import pickle
from pathlib import Path

import pytest
from variety import each

import spatial_pin as sp

GOOD = {
    "top": 'name = "bad"\ntree = "four.urdf"\n',
    "closure": '[[closures]]\nname = "pin"\ntype = "revolute"\nframes = ["coupler_b", "rocker_b"]\n'
               "axis = [0, 0, 1]\n",
    "driver": '[drivers.crank]\njoint = "crank_pin"\n',
    "spring": '[[springs]]\nname = "s"\nframes = ["coupler_b", "ground"]\nstiffness = 1.0\n',
    "frame": '[frames.tip]\nlink = "coupler"\nxyz = [0, 0, 0.1]\n',
    "guess": "[guess]\ncrank_pin = 0.3\n",
}
BAD = {  # part: what replaces what, and what is said of it
    "top": ("tree", 'titel = "x"\ntree', "titel is not a key of this table; did you mean 'title'?"),
    "closure": ("coupler_b", "couplr_b",
                "closure 'pin': frames: mechanism 'bad': no link, frame or joint 'couplr_b'; "
                "did you mean 'coupler_b'?"),
    "driver": ("crank_pin", "krank_pin", "drivers.crank.joint: mechanism 'bad': no coordinate or "
                                         "driver 'krank_pin'; did you mean 'crank_pin'?"),
    "spring": ("1.0", "-1.0", "springs[0]: stiffness is -1.0; it must be finite and at least 0"),
    "guess": ("crank_pin", "roker_pin", "no joint, coordinate or driver 'roker_pin'; did you mean "
                                        "'rocker_pin'?"),
}


@pytest.fixture
def write(tmp_path):
    """Write a mechanism file with some of its parts replaced, and a tree beside it."""
    sp.load("four_bar").save(tmp_path / "tree")
    (tmp_path / "four.urdf").write_bytes((tmp_path / "tree" / "four_bar.urdf").read_bytes())

    def write(*bad: str, **texts: str) -> Path:
        parts = {**GOOD, **texts}
        for part in bad:
            parts[part] = parts[part].replace(*BAD[part][:2])
        path = tmp_path / "bad.toml"
        path.write_text("".join(parts.values()))
        return path

    return write


def refusal(path: Path) -> sp.MechanismFileError:
    with pytest.raises(sp.MechanismFileError) as error:
        sp.load(path)
    return error.value


def test_the_good_file_is_good(write):
    assert [c.name for c in sp.load(write()).closures] == ["pin"]


@pytest.mark.parametrize("part", BAD)
def test_a_single_mistake_is_one_sentence(write, part):
    error = refusal(write(part))
    assert "\n" not in str(error) and BAD[part][2] in str(error)
    assert error.mistakes == (str(error),)


def test_all_mistakes_are_reported_together(write, run):
    path = write(*[part for part in BAD if part != "driver"])
    error = refusal(path)
    first, *rest = str(error).splitlines()
    assert first == f"{path}: 4 mistakes:" and len(rest) == len(error.mistakes) == 4
    for part in set(BAD) - {"driver"}:
        assert any(BAD[part][2] in line for line in rest), part
        assert any(BAD[part][2] in text and str(path) in text for text in error.mistakes)
    code, _, err = run("check", path)
    assert (code, err) == (1, f"spatial-pin: {error}\n")


def test_what_follows_from_another_mistake_is_not_reported(write):
    text = GOOD["guess"].replace("crank_pin", "crank")  # by a driver that is not read
    error = refusal(write(driver='[drivers.crank]\njoin = "crank_pin"\n', guess=text))
    assert len(error.mistakes) == 1 and "unknown key 'join'" in str(error)
    error = refusal(write(frame='[frames.tip]\nlink = 3\n', spring=GOOD["spring"].replace(
        "ground", "tip")))
    assert len(error.mistakes) == 1 and "frames.tip: link must be text" in str(error)


def test_strange_keys_of_a_table_that_is_wrong_are_reported_too(write):
    error = refusal(write(closure=GOOD["closure"].replace("revolute", "revolut") + "colour = 3\n"))
    assert len(error.mistakes) == 2
    assert "type is 'revolut'" in error.mistakes[0] and "colour" in error.mistakes[1]


@pytest.mark.parametrize("more", ["", "[guess]\nkrank = 0.0\n",
                                  '[[springs]]\nname = "t"\njoint = "krank"\nstiffness = 1.0\n'])
def test_a_driver_that_has_the_name_of_its_missing_joint(more, write):
    error = refusal(write(driver='[drivers.krank]\njoint = "krank"\n', guess=more))
    assert "drivers.krank.joint: mechanism 'bad': no coordinate or driver 'krank'; there are: " \
           "coupler_pin, crank_pin, rocker_pin" in error.mistakes[0]
    assert len(error.mistakes) == 1 + ("springs" in more)


def test_a_tree_that_is_not_there_hides_nothing(write):
    top = GOOD["top"].replace("four.urdf", "gone.urdf") + 'titel = "x"\n'
    error = refusal(write("spring", top=top))
    assert len(error.mistakes) == 3 and "gone.urdf: no such file" in error.mistakes[0]


def test_mistakes_of_the_tree_and_of_the_file_are_reported_together(write, tmp_path):
    path = write("top")
    urdf = tmp_path / "four.urdf"
    text = urdf.read_text("utf-8")
    for joint in ("crank_pin", "rocker_pin"):
        head, tail = text.split(f'<joint name="{joint}"')
        text = head + f'<joint name="{joint}"' + tail.replace("<axis", '<axis xyz="0 0"/><old', 1)
    urdf.write_text(text, "utf-8")
    error = refusal(path)
    assert len(error.mistakes) == 3 and "titel" in error.mistakes[0]
    assert ["crank_pin" in error.mistakes[1], "rocker_pin" in error.mistakes[2]] == [True, True]
    assert all(str(urdf) in text for text in error.mistakes[1:])
    assert refusal(urdf).mistakes == error.mistakes[1:]


def test_mistakes_of_several_closures_and_drivers(write):
    closures = "".join(GOOD["closure"].replace('"pin"', f'"pin_{k}"').replace("rocker_b", name)
                       for k, name in enumerate(["x", "rocker_b", "y"]))
    drivers = '[drivers.a]\njoint = "u"\n[drivers.b]\njoint = "v"\n'
    error = refusal(write(closure=closures, driver=drivers))
    found = [name for name in ("pin_0", "pin_1", "pin_2", "drivers.a", "drivers.b")
             if any(name in text for text in error.mistakes)]
    assert found == ["pin_0", "pin_2", "drivers.a", "drivers.b"]


def test_the_error_can_be_copied_and_sent(write):
    error = refusal(write("top", "spring"))
    for other in (copy.copy(error), pickle.loads(pickle.dumps(error))):
        assert str(other) == str(error) and other.mistakes == error.mistakes


@pytest.mark.parametrize("name", each(sp.list_mechanisms()))
def test_a_library_file_with_two_mistakes_tells_both(name, tmp_path):
    path = Path(sp.load(name).path)
    for tree in path.parent.glob("*.xacro"):
        (tmp_path / tree.name).write_bytes(tree.read_bytes())
    copied, text = tmp_path / path.name, path.read_text("utf-8")
    copied.write_text(f'nonsense = 1\n{text}\n[frames.here]\nlink = 3\n', encoding="utf-8")
    error = refusal(copied)
    assert len(error.mistakes) == 2, str(error)


TABLES = {  # part: a table with several mistakes, and what is said of each, in order
    "closure": ('[[closures]]\nname = "pin"\ntype = "revolute"\naxis = [0, 0, 3]\ncolour = "red"\n'
                'frames = ["couplr_b", "rockr_b"]\n',
                ["axis has length 3", "colour is not a key", "'couplr_b'; did you mean",
                 "'rockr_b'; did you mean"]),
    "unnamed": ('[[closures]]\ntype = "distance"\nframes = ["coupler_b"]\nlength = -1\n',
                ["name is missing", "must be a list of two names", "it must be positive"]),
    "driver": ('[drivers.crank]\njont = "crank_pin"\nspeed = 3\n',
               ["joint is missing (there is an unknown key 'jont')", "speed is not a key"]),
    "spring": ('[[springs]]\nname = "s"\nframes = ["coupler_b", "groud"]\nstiffness = -1.0\n'
               'damping = "much"\nfree_length = -3\n',
               ["stiffness is -1.0", "damping must be a number", "free_length is -3",
                "'groud'; did you mean"]),
    "frame": ('[frames.tip]\nlink = "coupler"\nxyz = [0, 0]\nrpy = "a"\n',
              ["xyz must be three", "rpy must be three"]),
    "joint": ('[joints.crank_pin]\ndampig = 3\ndamping = -1\nfriction = "x"\n',
              ["damping is -1", "friction must be", "dampig is not a key"]),
    "passive": ('[passive.x]\nbody = 3\naxis = ["a"]\n',
                ["body must be text", "axis must be a list of two names"]),
    "type": ('[[closures]]\nname = "pin"\ntype = "revolut"\nframes = 3\ncolour = "red"\n',
             ["type is 'revolut'; did you mean 'revolute'", "colour is not a key"]),
}


@pytest.mark.parametrize("case", TABLES)
def test_mistakes_within_one_table_are_reported_together(write, case):
    text, says = TABLES[case]
    part = case if case in GOOD else "frame"
    error = refusal(write(**{part: text}))
    assert len(error.mistakes) == len(says), error
    for told, said in zip(error.mistakes, says, strict=True):
        assert said in told


def test_all_unknown_keys_of_the_top_are_reported(write):
    error = refusal(write(top='name = "bad"\ntree = "four.urdf"\ntitel = "x"\nsorce = "y"\n'))
    assert [text.split(": ")[1].split()[0] for text in error.mistakes] == ["titel", "sorce"]
