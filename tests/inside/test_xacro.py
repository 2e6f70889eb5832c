"""Xacro files are expanded to what xacro itself makes of them, in a limited number of steps."""

import re
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from variety import each
from xacro_arms import HEAD, arm

import spatial_pin as sp
from spatial_pin.formats.importers import Request
from spatial_pin.formats.xacro import expressions
from spatial_pin.formats.xacro.expansion import expand

LIBRARY = Path(sp.load("rssr").tree).parent
R = HEAD.replace("arm", "r")
SPACES = R + """
  <!-- first --> <!-- second -->
  <xacro:property name="block">  <!-- kept apart -->  <a x="1">  </a> text <b/> </xacro:property>
  <xacro:macro name="twice" params="n *one **many">
    <!-- of a macro: ${nothing} -->
    <c n="${2 * n}"> <xacro:insert_block name="one"/> <xacro:insert_block name="many"/> </c>
  </xacro:macro>

  <xacro:twice n="3"> <d> <!-- --> </d> <many> <e/> two <f> </f> </many> </xacro:twice>
  <xacro:insert_block name="block"/>
  <g>  ${1 + 1}  <!-- in between -->  ${'a'}  </g> <h> </h> <i><!-- alone --></i>
  <xacro:if value="true"> <!-- inside --> <j/> </xacro:if>
  <xacro:unless value="${False or 1}"> <k/> </xacro:unless>
</robot>"""
TOLD = R + """<!-- xacro:eval-comments -->
<!-- ${1 + 1} --><a> <b/> <!-- ${nothing} --> </a></robot>"""


def plain(text: str) -> str:
    """The elements, attributes and words of XML text."""
    root = ET.fromstring(text)
    for element in root.iter():
        element.text, element.tail = (" ".join((x or "").split())
                                      for x in (element.text, element.tail))
    return ET.tostring(root, encoding="unicode")


def assert_same(found: str, wanted: str) -> None:
    """The same words, and numbers but for round-off: sums of Python itself changed in 3.12."""
    number = r"(-?\d+(?:\.\d+)?(?:e[-+]?\d+)?)"
    texts = [re.split(number, text) for text in (found, wanted)]
    words, others = (text[::2] for text in texts)
    assert words == others
    numbers, other_numbers = (np.array(text[1::2], dtype=float) for text in texts)
    np.testing.assert_allclose(numbers, other_numbers, rtol=1e-14, atol=1e-18)


@pytest.mark.parametrize("source", [SPACES, TOLD, *(
    name for name in ("rssr", "bricard", "watt_six_bar"))], ids=lambda s: s[:8])
def test_it_is_what_xacro_makes(source, tmp_path):
    import xacro

    path = LIBRARY / f"{source}.urdf.xacro"
    if source.startswith("<"):
        path = tmp_path / "r.urdf.xacro"
        path.write_text(source)
    wanted = xacro.process_file(str(path)).toxml()
    assert_same(plain(expand(Request(path))), plain(wanted))


def test_the_copies_leave_xacro_as_it_was(tmp_path):
    import xacro

    before = dict(vars(xacro))
    expand(Request(LIBRARY / "rssr.urdf.xacro"))
    assert vars(xacro) == before and sys.modules["xacro"] is xacro


def test_the_parts_of_the_library_are_at_hand_wherever_a_file_lies(tmp_path):
    path = tmp_path / "r.urdf.xacro"
    path.write_text("""<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">
      <xacro:include filename="$(find spatial_pin)/parts.xacro"/>
      <xacro:body name="ball"><solids>
        <xacro:ball centre="0 0 0" radius="0.1" colour="red"/>
      </solids></xacro:body></robot>""")
    (inertial,) = ET.fromstring(expand(Request(path))).iter("inertial")
    assert float(inertial.find("mass").get("value")) == pytest.approx(7850 * 4 / 3 * np.pi * 1e-3)


# ---------------------------------------------------------------- limits


@pytest.fixture
def write(tmp_path):
    """Write a file; returns its path."""

    def write(text: str, name: str = "arm.urdf.xacro") -> Path:
        (tmp_path / name).write_text(text, encoding="utf-8")
        return tmp_path / name

    return write


def doubling(first: str, step: str, names: str = "a") -> str:
    """Sixty properties or macros, each made of two of the one before."""
    return "".join([first.replace("NEW", f"{x}0") + "".join(
        step.replace("OLD", f"{x}{k}").replace("NEW", f"{x}{k + 1}") for k in range(60))
        for x in names])


NEST = ('<xacro:property name="NEW" value="${[1, 2]}"/>',
        '<xacro:property name="NEW" value="${[OLD, OLD]}"/>')
GROWING = {
    "lists within lists": doubling(*NEST) + "<x y='${a60}'/>",
    "equal lists within lists": doubling(*NEST, names="ab") + "<x y='${a60 == b60}'/>",
    "tuples as keys": doubling(
        '<xacro:property name="NEW" value="${(1, 2)}"/>',
        '<xacro:property name="NEW" value="${(OLD, OLD)}"/>') + "<x y='${dict([(a60, 1)])}'/>",
    "texts": doubling(
        '<xacro:property name="NEW" value="abcdefgh"/>',
        '<xacro:property name="NEW" value="${OLD}${OLD}"/>') + "<x y='${a60}'/>",
    "sums of texts": doubling(
        '<xacro:property name="NEW" value="abcdefgh"/>',
        '<xacro:property name="NEW" value="${OLD + OLD}"/>') + "<x y='${a60}'/>",
    "numbers": doubling(
        '<xacro:property name="NEW" value="7"/>',
        '<xacro:property name="NEW" value="${OLD * OLD}"/>') + "<x y='${a60}'/>",
    "macros": doubling(
        '<xacro:macro name="NEW"><x/></xacro:macro>',
        '<xacro:macro name="NEW"><xacro:OLD/><xacro:OLD/></xacro:macro>') + "<xacro:a60/>",
    "empty macros": doubling(
        '<xacro:macro name="NEW"></xacro:macro>',
        '<xacro:macro name="NEW"><xacro:OLD/><xacro:OLD/></xacro:macro>') + "<xacro:a60/>",
    "blocks": doubling(
        '<xacro:property name="NEW"><x/></xacro:property>',
        '<xacro:property name="NEW"><xacro:insert_block name="OLD"/>'
        '<xacro:insert_block name="OLD"/></xacro:property>') + '<xacro:insert_block name="a60"/>',
    "a macro that calls itself": (
        '<xacro:macro name="a"><xacro:a/></xacro:macro><xacro:a/>'),
    "a macro that calls itself with a growing list": (
        '<xacro:macro name="a" params="l"><xacro:a l="${l + l}"/></xacro:macro>'
        '<xacro:a l="${[1]}"/>'),
    "a property that is itself": '<xacro:property name="a" value="${a + 1}"/><x y="${a}"/>',
    "properties of each other": (
        '<xacro:property name="a" value="${b}"/><xacro:property name="b" value="${a}"/>'
        '<x y="${a}"/>'),
    "a parameter with a quote too few": (
        f"<xacro:macro name='a' params='b:={'x' * 60}&apos;'/><xacro:a/>"),
    "a file that includes itself": '<xacro:include filename="arm.urdf.xacro"/>',
    "elements within elements": "<x>" * 5000 + "</x>" * 5000,
    "a list that holds itself": (
        '<xacro:property name="a" value="${[1]}" lazy_eval="false"/>'
        '<x y="${a.append(a)}" z="${a == [a]}" w="${a}"/>' + "<x y='${[a] * 9**6}'/>" * 9),
}


@pytest.mark.parametrize("case", GROWING)
def test_what_grows_without_end_is_refused(write, case, monkeypatch):
    monkeypatch.setattr(expressions, "STEPS", 50_000)  # as with more, but sooner
    with pytest.raises(sp.MechanismFileError, match=r"arm\.urdf\.xacro"):
        sp.load(write(arm("1", GROWING[case])))


@pytest.mark.parametrize("name", each(sp.list_mechanisms()))
def test_the_library_needs_a_fifth_of_what_is_allowed_at_most(name, monkeypatch):
    monkeypatch.setattr(expressions, "STEPS", expressions.STEPS // 5)
    sp.load(name)


YAMLS = {
    "an alias in itself": "a: &a [*a, *a]\nx: 1",
    "lists of lists": "".join([f"a{k}: &a{k} [*a{k - 1}, *a{k - 1}]\n" if k else "a0: &a0 [1, 2]\n"
                              for k in range(60)]),
    "tables merged into tables": "a0: &a0 {x: 1}\n" + "".join(
        f"a{k}: &a{k}\n  <<: [{', '.join([f'*a{k - 1}'] * 9)}]\n" for k in range(1, 60)),
    "a deep list": "a: " + "[" * 5000 + "]" * 5000,
    "a number without end": "a: " + "9" * 100_000,
    "a number of base sixty": "a: 1" + ":59" * 100_000,
    "an object": "a: !!python/object/apply:os.system ['true']",
    "no YAML": "a: [",
    "an expression": "a: !degrees (lambda: 1)()",
}


@pytest.mark.parametrize("case", YAMLS)
def test_a_yaml_file_that_is_more_than_data_is_refused(write, case, monkeypatch):
    monkeypatch.setattr(expressions, "STEPS", 50_000)
    write(YAMLS[case], "table.yaml")
    with pytest.raises(sp.MechanismFileError, match=r"(table\.yaml|arm\.urdf\.xacro): "):
        sp.load(write(arm("${a}", '<xacro:property name="a" '
                          'value="${xacro.load_yaml(\'table.yaml\').a}"/>')))
