"""A file that nobody trusts is loaded or refused: it runs nothing, reads nothing else, and ends."""

from __future__ import annotations

import os
import signal
import threading
import time
from pathlib import Path

import pytest
from xacro_arms import HEAD, LINKS, NAMES, arm

import spatial_pin as sp


@pytest.fixture
def write(tmp_path):
    """Write a xacro file; returns its path."""

    def write(text: str, name: str = "arm.urdf.xacro") -> Path:
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
        return path

    return write


def reach(path: Path, **options) -> float:
    mechanism = sp.load(path, **options)
    return float(sp.assemble(mechanism).placement("hand").translation[0])


def escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")


# ---------------------------------------------------------------- what expressions are

OFFERED = {  # as they stand in public robots
    "-1.5 + 2 * 3**2 / 4": 3.0,
    "7 // 2 + 7 % 4": 6.0,
    "radians(180) / pi": 1.0,
    "math.degrees(math.pi)": 180.0,
    "sqrt(abs_ * 2) if abs_ >= 0 else -1": 2.0,
    "2 if 'z' in 'xyz' and not 'a' in 'xyz' or False else 0": 2.0,
    "1 if abs_ is not None else 0": 1.0,
    "dict(right=1, left=-1)[side]": -1.0,
    "'0.25 0.5 1'.split(' ')[1]": 0.5,
    "float('1 2 4'.split()[-1])": 4.0,
    "[float(x) for x in '1 2 3'.split() if float(x) > 1][0]": 2.0,
    "python.sum([u * v for u, v in python.zip([1, 2], [3, 4])])": 11.0,
    "list(map(float, ['1', '2']))[1]": 2.0,
    "max([1, 5, 3]) + min(2, 4) + len('abc') + round(2.6)": 13.0,
    "python.int('3') + python.ord('a') - 97": 3.0,
    "'%.2f' % 1.256": 1.26,
    "sorted([3, 1, 2])[0:2][1]": 2.0,
    "(0, 1 + 1)[1]": 2.0,
    "table.arms.inner['reach']": 0.75,
    "table.get('none', 4)": 4.0,
    "xacro.dotify(dict(a=dict(b=6))).a.b": 6.0,
    "xacro.arg('given') * 2 if False else float(xacro.arg('given'))": 0.125,
    "$(arg given) * 2": 0.25,
    "xacro.load_yaml('table.yaml')['list'][1].angle": 2.0,
    "math.dist([0, 0], [3, 4])": 5.0,
    "math.hypot(*[3, 4])": 5.0,
    "python.isinstance(side, str) + (python.type(abs_) == python.int)": 2.0,
    "python.str(1) + str(2)": 12.0,
    "xacro.tokenize('1;2, 3')[2]": 3.0,
}
YAML = "arms: {inner: {reach: 0.75}}\nlist:\n- 1\n- {angle: !degrees 360/pi}\n"
@pytest.mark.parametrize("expression", OFFERED)
def test_an_expression_as_robots_have_them_is_worked_out(write, expression):
    write(YAML, "table.yaml")
    path = write(arm(f"${{{escaped(expression)}}}", NAMES))
    assert reach(path) == pytest.approx(OFFERED[expression], rel=1e-15)


REFUSED = {  # what asks for more than numbers and texts: what the refusal names
    "(lambda: 1)()": "lambda",
    "[f for f in [lambda: 1]]": "lambda",
    "().__class__.__base__.__subclasses__()": "__(class|subclasses)__",
    "''.__len__()": "__len__",
    "abs_.__class__": "__class__",
    "__import__('os').system('true')": "__import__",
    "open('/etc/passwd')": "'open' is not defined",
    "getattr(side, 'upper')()": "'getattr' is not defined",
    "eval('1')": "'eval' is not defined",
    "str.join": "join",
    "math.sin.real": "real",
    "side.format(1)": "format",
    "side.encode()": "encode",
    "python.vars()": "vars",
    "math.update(a=1)": "update",
    "xacro.load_yaml.__globals__": "__globals__",
    "(y := 1)": ":=",
    "f'{1'": "not an expression|f-string",
    "b'a'": "only numbers and texts",
    "1j": "only numbers and texts",
    "abs_ @ abs_": "@",
    "abs_(1)": "abs_ is not a function",
    "python.complex(1)": "complex",
    "(-8) ** 0.5": "complex",
    "sum([1])": "python.sum",
    "raelius": "'raelius' is not defined",
    "1 +": "not an expression",
    "1; 2": "not an expression",
    "1 / 0": "division by zero",
    "table.arm": "'arm'",
    "table['arm']": "'arm'",
    "xacro.fatal('no such hand')": "no such hand",
    "x for": "not an expression",
}


@pytest.mark.parametrize("expression", REFUSED)
def test_everything_else_is_refused_by_name_and_file(write, expression):
    write(YAML, "table.yaml")
    path = write(arm(f"${{{escaped(expression)}}}", NAMES))
    with pytest.raises(sp.MechanismFileError, match=REFUSED[expression]) as refusal:
        sp.load(path)
    assert "arm.urdf.xacro: ${" in str(refusal.value) and "\n" not in str(refusal.value)


HUGE = [  # what would take hours, or all memory
    "9**9**9", "-9**9**9 * 1.0", "10**400", "2**1023 * 2**1023", "1 << 10**9",
    "'a' * 10**9", "10**9 * 'ab'", "[0] * 10**9", "(0,) * 10**10", "len([0] * 10**9)",
    "python.sum(range(10**10))", "[i for i in range(10**9)][0]", "max(range(10**12))",
    "len([0 for i in range(9999) for j in range(9999)])", "0.5 in range(10**15)",
    "factorial(10**7)", "math.comb(10**9, 5 * 10**8)", "math.perm(10**6)",
    "math.prod([10**300] * 10**5)", "math.lcm(*range(1, 10**5))", "round(5, -10**9)",
    "len('%999999999d' % 1)", "len('%*d' % (10**9, 1))", "len('%.999999999f' % 1)",
    "len('a'.center(10**10))", "len('a'.zfill(10**10))", "len('aa'.replace('a', 'b' * 10**7))",
    "len(','.join(['a' * 10**5] * 10**5))", "list(map(len, [range(10**9), list(range(10**9))]))",
    "0x" + "f" * 4000, "9" * 5000, "int('9' * 100000)", "1" + " + 1" * 50_000, "-" * 100_000 + "1",
    "(" * 300 + "1" + ")" * 300, "[" * 5000 + "]" * 5000, "python.sum([[0] * 10**5] * 10**4, [])",
    "float('9' * 400 + 'e' + '9' * 5)",
]


@pytest.mark.alike
@pytest.mark.parametrize("expression", HUGE, ids=lambda text: text[:30])
def test_what_would_not_end_or_not_fit_is_refused(write, expression):
    with pytest.raises(sp.MechanismFileError, match=r"arm\.urdf\.xacro"):
        sp.load(write(arm(f"${{{escaped(expression)}}}")))


# ---------------------------------------------------------------- files that are read

SECRET = HEAD + '<xacro:property name="x" value="7"/></robot>'
READING = {
    "include": '<xacro:include filename="{file}.xacro"/>',
    "include by pattern": '<xacro:include filename="{file}.xac*"/>',
    "include of an expression": '<xacro:include filename="${{\'{file}\' + \'.xacro\'}}"/>',
    "include of an argument": ('<xacro:arg name="f" default="{file}.xacro"/>'
                               '<xacro:include filename="$(arg f)"/>'),
    "load_yaml": '<xacro:property name="x" value="${{xacro.load_yaml(\'{file}.yaml\').x}}"/>',
    "load_yaml of an absolute name": (
        '<xacro:property name="x" '
        'value="${{xacro.load_yaml(xacro.abs_filename(\'{file}.yaml\')).x}}"/>'),
}


@pytest.fixture
def secret(tmp_path):
    """Files beside the folder of the mechanism."""
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    (folder / "parts.xacro").write_text(SECRET)
    (folder / "parts.yaml").write_text("x: 7")
    return folder


@pytest.mark.alike
@pytest.mark.parametrize("file", ["../elsewhere/parts", "{folder}/parts", "link/parts", "parts"])
@pytest.mark.parametrize("how", READING)
def test_files_outside_the_folder_are_read_for_who_trusts(write, secret, tmp_path, how, file):
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "link").symlink_to(secret)
    if file == "parts":
        for suffix in ("xacro", "yaml"):
            (tmp_path / "own" / f"parts.{suffix}").symlink_to(secret / f"parts.{suffix}")
    reading = READING[how].format(file=file.format(folder=secret))
    path = write(arm("${x}", reading), "own/arm.urdf.xacro")
    with pytest.raises(sp.MechanismFileError, match=r"arm\.urdf\.xacro.*trusted=True"):
        sp.load(path)
    assert reach(path, trusted=True) == 7.0


@pytest.mark.parametrize("how", READING)
@pytest.mark.parametrize("file", ["parts", "./parts", "inner/parts", "../own/inner/parts"])
def test_files_below_the_folder_are_read(write, tmp_path, how, file):
    for folder in ("own", "own/inner"):
        write(SECRET, f"{folder}/parts.xacro")
        write("x: 7", f"{folder}/parts.yaml")
    assert reach(write(arm("${x}", READING[how].format(file=file)), "own/arm.xacro")) == 7.0


@pytest.mark.parametrize("how", READING)
def test_files_of_a_package_are_read(write, tmp_path, how, monkeypatch):
    write("x: 7", "arm_description/config/parts.yaml")
    write(SECRET, "arm_description/config/parts.xacro")
    reading = READING[how].format(file="$(find arm_description)/config/parts")
    path = write(arm("${x}", reading), "arm_description/urdf/arm.xacro")
    with pytest.raises(sp.MechanismFileError, match="nor in an installed package"):
        sp.load(path)
    write("<package><name>arm_description</name></package>", "arm_description/package.xml")
    assert reach(path) == 7.0
    elsewhere = write(arm("${x}", reading), "user/arm.xacro")
    assert reach(elsewhere) == 7.0  # a neighbour of the package
    deep = write(arm("${x}", reading), "a/user/arm.xacro")
    with monkeypatch.context() as patch:
        patch.setenv("ROS_PACKAGE_PATH", str(tmp_path))
        assert reach(deep) == 7.0


def test_a_package_may_have_another_name_than_its_folder(write):
    write("<package><name>arm_description</name></package>", "Arm_ROS2/package.xml")
    write(SECRET, "Arm_ROS2/parts.xacro")
    reading = '<xacro:include filename="$(find arm_description)/parts.xacro"/>'
    assert reach(write(arm("${x}", reading), "Arm_ROS2/urdf/arm.xacro")) == 7.0


def test_a_package_that_is_nowhere_is_named(write):
    reading = '<xacro:include filename="$(find gone)/parts.xacro"/>'
    with pytest.raises(sp.MechanismFileError, match=r"no package 'gone'.*ROS_PACKAGE_PATH"):
        sp.load(write(arm("1", reading)))


def test_an_include_that_may_be_missing_may_be_missing(write):
    assert reach(write(arm("1", '<xacro:include filename="gone.xacro" optional="true"/>'))) == 1.0
    with pytest.raises(sp.MechanismFileError, match=r"gone\.xacro"):
        sp.load(write(arm("1", '<xacro:include filename="gone.xacro"/>')))


def test_an_include_of_a_folder_is_refused_by_who_includes_it(write):
    with pytest.raises(sp.MechanismFileError, match=r"arm.*: an include: .* is a folder"):
        sp.load(write(arm("1", '<xacro:include filename="."/>')))


@pytest.mark.parametrize("command", [
    "eval __import__(", "eval open", "find ../..", "arg", "arg a b", "env", "shell ls", "",
    "env NOBODY_HAS_THIS",
])
def test_a_command_that_is_none_is_refused(write, command):
    with pytest.raises(sp.MechanismFileError, match=r"arm\.urdf\.xacro"):
        sp.load(write(arm(f"$({command})")))


def test_commands_as_robots_have_them(write, monkeypatch):
    monkeypatch.setenv("ARM_REACH", "3")
    monkeypatch.delenv("ARM_NONE", raising=False)
    assert reach(write(arm("$(env ARM_REACH)")), trusted=True) == 3.0
    assert reach(write(arm("$(optenv ARM_NONE 4)"))) == 4.0
    assert reach(write(arm("$(eval 2 * given)", NAMES.split("<xacro:property")[0]))) == 0.25


# ---------------------------------------------------------------- threads and processes


def test_threads_load_at_the_same_time():
    reaches: dict[int, float] = {}

    def run(k: int) -> None:
        reaches[k] = sp.load("rssr", d=0.3 + k / 100).dimensions["d"]

    threads = [threading.Thread(target=run, args=(k,)) for k in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert reaches == {k: 0.3 + k / 100 for k in range(8)}


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of Python, about any fork with threads
def test_a_child_that_is_born_while_another_thread_loads_can_load():
    stop = threading.Event()

    def load_on() -> None:
        while not stop.is_set():
            sp.load("rssr")

    thread = threading.Thread(target=load_on)
    thread.start()
    try:
        for _ in range(5):
            child = os.fork()
            if child == 0:
                signal.alarm(60)  # a deadlock ends, and is seen
                try:
                    os._exit(0 if sp.load("rssr").name == "rssr" else 1)
                except BaseException:
                    os._exit(2)
            assert os.waitpid(child, 0)[1] == 0
    finally:
        stop.set()
        thread.join()


# ---------------------------------------------------------------- texts that are too much

URDF = '<robot name="bench"><link name="base"/></robot>'
TOML = 'name = "bench"\ntree = "bench.urdf"\n'
TOO_MUCH = {  # file: its text, what the refusal says
    "elements": ("bench.urdf", URDF.replace("/>", f">{'<x>' * 5000}{'</x>' * 5000}</link>"),
                 "elements within one another"),
    "elements of a xacro": ("bench.urdf.xacro", arm("1", "<x>" * 5000 + "</x>" * 5000), "too deep"),
    "lists": ("bench.toml", TOML + "x = " + "[" * 5000 + "]" * 5000, "nested too deeply"),
    "tables": ("bench.toml", TOML + "x = " + "{a = " * 5000 + "1" + "}" * 5000, "too deeply"),
    "names of a key": ("bench.toml", TOML + "a" + ".a" * 50_000 + " = 1", "key of more than 8"),
    "names of a quoted key": ("bench.toml", TOML + '"a"' + " . 'a'" * 50_000 + " = 1", "8 names"),
    "names of a table": ("bench.toml", TOML + "[a" + ".a" * 50_000 + "]", "key of more than 8"),
    "names in a table": ("bench.toml", TOML + "x = {a" + ".a" * 50_000 + " = 1}", "more than 8"),
    "letters of a key": ("bench.toml", TOML + "a" * 100_000 + " = 1", "is not a key"),
    "digits": ("bench.toml", TOML + f"gravity = [0, 0, -{'9' * 5000}]", "line 3: gravity: .*1e308"),
    "digits that Python reads": (
        "bench.toml", TOML + f"gravity = [0, 0, {'9' * 4000}]", "gravity must be three finite"),
    "digits of base 16": (
        "bench.toml", TOML + f"gravity = [0, 0, 0x{'f' * 50_000}]", "gravity must be three finite"),
    "digits for a text": ("bench.toml", TOML + f"title = 0x{'f' * 50_000}", "title must be text"),
    "letters of a tree": ("bench.toml", f'name = "bench"\ntree = "{"x" * 5000}.urdf"', "too long"),
    "a tree with no name": ("bench.toml", 'name = "bench"\ntree = "\\u0000.urdf"', "null"),
    "letters of an include": ("bench.urdf.xacro", arm(
        "1", f'<xacro:include filename="{"x" * 5000}"/>'), "no such file|too long"),
    "letters of a package": ("bench.urdf.xacro", arm(
        "1", f'<xacro:include filename="$(find {"x" * 5000})/a"/>'), "no package"),
    "metres": ("bench.urdf", arm("1.7e308").replace(HEAD, '<robot name="a">'), "1.7e.308 m large"),
    "metres in sum": ("bench.urdf", '<robot name="a"><link name="tip"/>' + LINKS.format(
        x="1e308").replace("</robot>", '<joint name="on" type="fixed"><parent link="hand"/>'
                           '<child link="tip"/><origin xyz="1e308 0 0"/></joint></robot>'),
        r"larger than any number \(frame 'on'\); only sizes"),
    "bytes": ("bench.urdf", None, "at most 100,000,000"),
}


@pytest.mark.parametrize("case", TOO_MUCH)
def test_what_is_too_much_is_one_clear_error(write, case, capfd):
    name, text, says = TOO_MUCH[case]
    write(URDF, "bench.urdf")
    path = write(text or URDF, name)
    if text is None:
        os.truncate(path, 10**10)  # a hole
    with pytest.raises(sp.MechanismFileError, match=says) as refusal:
        sp.load(path)
    message = str(refusal.value)
    assert f"/{name}" in message and "\n" not in message and len(message) < 1500
    assert capfd.readouterr() == ("", "")


UNCLOSED = {  # file: its text, 200 kB and more of what begins and does not end
    "comments of SDF": ("m.sdf", "<sdf version='1.7'>" + "<!--" * 50_000),
    "declarations of SDF": ("m.sdf", "<sdf version='1.7'>" + "<?xml" * 50_000),
    "comments of MJCF": ("m.mjcf", "<mujoco>" + "<!--" * 50_000),
    "comments before a root": ("m.xml", "<!---->" * 40 + "<!--" * 50_000),
    "instructions before a root": ("m.xml", "<?a?>" * 40 + "<?" * 50_000),
}


@pytest.mark.parametrize("case", UNCLOSED)
def test_what_begins_and_does_not_end_is_looked_through_once(write, case):
    """Regular expressions took half a minute, or for ever."""
    path = write(UNCLOSED[case][1], UNCLOSED[case][0])
    begin = time.process_time()
    with pytest.raises(sp.MechanismFileError):
        sp.load(path)
    assert time.process_time() - begin < 3.0


def test_many_names_are_no_deep_ones(write):
    write(URDF, "bench.urdf")
    path = write(TOML + f'title = "{"a." * 9999}"  # {"b." * 9999}\n', "bench.toml")
    assert sp.load(path).title == "a." * 9999


@pytest.mark.slow
def test_a_long_chain_and_a_wide_star_are_loaded(write):
    for place in ("l{k}", "l0"):
        links = "".join(f'<link name="l{k}"/>' for k in range(1500))
        joints = "".join(
            f'<joint name="j{k}" type="fixed"><parent link="{place.format(k=k)}"/>'
            f'<child link="l{k + 1}"/><origin xyz="2 0 0"/></joint>' for k in range(1499))
        mechanism = sp.load(write(f'<robot name="many">{links}{joints}</robot>', "many.urdf"))
        assert mechanism.characteristic_length == (2 if place == "l0" else 2998)


SPECIAL = {"a pipe": os.mkfifo if hasattr(os, "mkfifo") else None, "a folder": os.mkdir,
           "a link to itself": lambda path: os.symlink(path, path),
           "a device": lambda path: os.symlink("/dev/zero", path)}


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes on this system")
@pytest.mark.parametrize("kind", SPECIAL)
@pytest.mark.parametrize("role", ["source.toml", "source.urdf", "source.urdf.xacro", "tree",
                                  "include", "yaml", "mesh"])
def test_what_is_no_file_is_not_waited_for(write, tmp_path, kind, role):
    name = {"tree": "part.urdf", "include": "part.xacro", "yaml": "part.yaml",
            "mesh": "part.stl"}.get(role, role)
    SPECIAL[kind](tmp_path / name)
    path = {
        "tree": lambda: write(TOML.replace("bench.urdf", name), "bench.toml"),
        "include": lambda: write(arm("1", '<xacro:include filename="part.xacro"/>')),
        "yaml": lambda: write(arm("${xacro.load_yaml('part.yaml')}")),
        "mesh": lambda: write(URDF.replace("/>", f'><visual><geometry><mesh filename="{name}"/>'
                                           "</geometry></visual></link>"), "bench.urdf"),
    }.get(role, lambda: tmp_path / name)()
    if role == "mesh":
        with pytest.warns(UserWarning, match=r"part\.stl.*left out"):
            assert not sp.load(path).visual_model.ngeoms
    else:
        with pytest.raises(sp.MechanismFileError, match=f"{name}|/dev/zero"):
            sp.load(path, trusted=True)


@pytest.mark.parametrize("source", ["x" * 5000, "x" * 5000 + ".toml", "y/" * 3000 + "a.urdf",
                                    "a\0.toml", "a\0", "\ud800.toml", "", ".", ".."])
def test_a_name_that_cannot_be_one_is_refused_in_words(source):
    with pytest.raises(sp.MechanismFileError) as refusal:
        sp.load(source)
    assert str(refusal.value).isprintable() and len(str(refusal.value)) < 1000


# ---------------------------------------------------------------- arguments and places


@pytest.mark.parametrize(("options", "error", "says"), [
    ({"trusted": 1}, TypeError, "trusted is True or False"),
    ({"trusted": "no"}, TypeError, "trusted is True or False"),
    ({"d": None}, TypeError, "'d' is a NoneType; a number"),
    ({"d": [0.3]}, TypeError, "'d' is a list; a number"),
    ({"d": 1j}, TypeError, "'d' is a complex; a number"),
    ({"d": {}}, TypeError, "'d' is a dict; a number"),
    ({"d": 10**400}, ValueError, "'d' is too large"),
    ({"e": 0.3}, sp.MechanismFileError, "no parameter 'e'; there are: a, b, c, d"),
])
def test_a_wrong_argument_is_refused_in_words(options, error, says):
    with pytest.raises(error, match=says):
        sp.load("rssr", **options)


def test_an_argument_is_a_value_and_no_expression(write):
    path = write(arm("${len('$(arg given)')}", NAMES.split("<xacro:property")[0]))
    assert reach(path, given="abc") == 3.0
    with pytest.raises(sp.MechanismFileError, match="__import__"):
        sp.load(path, given="' + __import__('os').sep + '")


JOINT = '[joints.pin]\ntype = "revolute"\n'
CLOSURE = '[[closures]]\nname = "ball"\ntype = "spherical"\nframes = ["a", "b"]\n'
TOP = r"belongs at the top of the file, before the first \[table\]"
MISPLACED = {
    "gravity after a table": (JOINT + "gravity = [0, 0, 0]", rf"joints\.pin: gravity is.*{TOP}"),
    "gravity in a closure": (CLOSURE + "gravity = [0, 0, 0]", rf"'ball'\): gravity is not.*{TOP}"),
    "gravity in the guess": ("[guess]\ngravity = [0, 0, 0]", rf"guess: gravity is no joint.*{TOP}"),
    "gravity in the drivers": ("[drivers]\ngravity = [0, 0, 0]", rf"drivers\.gravity.*{TOP}"),
    "title in a driver": ('[drivers.motor]\njoint = "pin"\ntitle = "A"', rf"title is not.*{TOP}"),
    "a spring's stiffness in a closure": (
        CLOSURE + "stiffness = 3.0", r"'ball'\): stiffness.*carry neither.*\[\[springs\]\]"),
    "a damper in a closure": (CLOSURE + "damping = 3.0", r"damping.*write \[\[springs\]\] with"),
    "a spring's stiffness in a joint": (
        JOINT + "stiffness = 3.0", r"stiffness is not.*belongs in \[\[springs\]\]"),
    "frames at the top": ('frames = ["a", "b"]', r"frames is not.*\[\[closures\]\] or in \[\[spr"),
    "a body in a spring": ('[[springs]]\nname = "s"\nframes = ["a", "b"]\nbody = "a"',
                           r"springs\[0\]: body is not.*belongs in \[passive\.NAME\]"),
    "the length of a ball": (CLOSURE + "length = 1.0", "length is not a key of this.*'spherical'"),
    "a key of nothing": (CLOSURE + "lenght = 1.0", "lenght is not a key of this table; there are"),
}


@pytest.mark.parametrize("case", MISPLACED)
def test_an_error_names_the_table_where_a_misplaced_key_belongs(write, case):
    write(URDF, "bench.urdf")
    text, says = MISPLACED[case]
    with pytest.raises(sp.MechanismFileError, match=says):
        sp.load(write(TOML + text + "\n", "bench.toml"))
