"""A xacro file of an arm whose reach is an expression."""

HEAD = '<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro">'
LINKS = ('<link name="base"/><link name="hand"/><joint name="slide" type="fixed">'
         '<parent link="base"/><child link="hand"/><origin xyz="{x} 0 0"/></joint></robot>')
NAMES = ('<xacro:arg name="given" default="0.125"/><xacro:property name="abs_" value="2"/>'
         '<xacro:property name="side" value="left"/>'
         '<xacro:property name="table" value="${xacro.load_yaml(\'table.yaml\')}"/>')


def arm(x: str, before: str = "") -> str:
    """An arm whose reach is an expression."""
    return HEAD + before + LINKS.format(x=x)
