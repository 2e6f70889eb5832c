"""Xacro files are expanded to what xacro itself makes of them."""

import re
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

import spatial_pin as sp
from spatial_pin.formats.xacro.expansion import expand

LIBRARY = Path(sp.load("rssr").tree).parent
HEAD = '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">'
SPACES = HEAD + """
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
TOLD = HEAD + """<!-- xacro:eval-comments -->
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
    assert_same(plain(expand(path, {})), plain(wanted))


def test_the_copies_leave_xacro_as_it_was(tmp_path):
    import xacro

    before = dict(vars(xacro))
    expand(LIBRARY / "rssr.urdf.xacro", {})
    assert vars(xacro) == before and sys.modules["xacro"] is xacro


def test_the_parts_of_the_library_are_at_hand_wherever_a_file_lies(tmp_path):
    path = tmp_path / "r.urdf.xacro"
    path.write_text("""<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">
      <xacro:include filename="$(find spatial_pin)/parts.xacro"/>
      <xacro:body name="ball"><solids>
        <xacro:ball centre="0 0 0" radius="0.1" colour="red"/>
      </solids></xacro:body></robot>""")
    (inertial,) = ET.fromstring(expand(path, {})).iter("inertial")
    assert float(inertial.find("mass").get("value")) == pytest.approx(7850 * 4 / 3 * np.pi * 1e-3)
