"""The files of a random mechanism: a URDF, plain or xacro, and the TOML beside it."""

from __future__ import annotations

PLAIN = ("revolute", "continuous", "prismatic", "fixed", "planar")  # joints that URDF has
MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


def write(spec, folder):
    """Write the files into a folder; return the path of the mechanism file."""
    name = f"m{spec['seed']}"
    tree = f"{name}.urdf.xacro" if spec["parameters"] else f"{name}.urdf"
    (folder / tree).write_text("\n".join(_tree(spec, name)))
    path = folder / f"{name}.toml"
    path.write_text("\n".join([f'name = "{name}"', f'tree = "{tree}"',
                               f"gravity = {_value(spec['gravity'])}", *_tables(spec)]) + "\n")
    return path


def _tree(spec, name):
    named = {(p["frame"], p["at"]): n for n, p in spec["parameters"].items()}
    yield f'<robot name="{name}" xmlns:xacro="http://www.ros.org/wiki/xacro">'
    for n, p in spec["parameters"].items():
        yield f'<xacro:arg name="{n}" default="{p["value"]!r}"/>'
        yield f'<xacro:property name="{n}" value="$(arg {n})"/>'
    for link in ["ground", *(j["child"] for j in spec["joints"])]:
        yield f'<link name="{link}">{_inertial(spec["inertias"].get(link))}</link>'
    for j in spec["joints"]:
        yield _joint(j)
    for f in spec["frames"]:
        xyz = " ".join("${" + named[f["name"], k] + "}" if (f["name"], k) in named
                       else repr(float(x)) for k, x in enumerate(f["xyz"]))
        yield (f'<link name="{f["name"]}"/><joint name="{f["name"]}_fix" type="fixed">'
               f'<parent link="{f["link"]}"/><child link="{f["name"]}"/>'
               f'<origin xyz="{xyz}" rpy="{_numbers(f["rpy"])}"/></joint>')
    yield "</robot>"


def _inertial(body):
    if body is None:
        return ""
    tensor = " ".join(f'{k}="{x!r}"' for k, x in zip(MOMENTS, body["tensor"], strict=True))
    return (f'<inertial><origin xyz="{_numbers(body["com"])}"/><mass value="{body["mass"]!r}"/>'
            f"<inertia {tensor}/></inertial>")


def _joint(j):
    kind = j["kind"] if j["kind"] in PLAIN else "floating"
    text = (f'<joint name="{j["name"]}" type="{kind}"><parent link="{j["parent"]}"/>'
            f'<child link="{j["child"]}"/>'
            f'<origin xyz="{_numbers(j["xyz"])}" rpy="{_numbers(j["rpy"])}"/>')
    if kind not in ("fixed", "floating"):
        text += f'<axis xyz="{_numbers(j["axis"])}"/>'
    if kind in ("revolute", "prismatic"):
        text += '<limit lower="-1e5" upper="1e5" effort="1e9" velocity="1e9"/>'
    return text + "</joint>"


def _tables(spec):
    for j in spec["joints"]:
        if j["kind"] not in (*PLAIN, "floating"):
            yield f"[joints.{j['name']}]\ntype = \"{j['kind']}\""
            yield from (f"{k} = {_value(j[k])}" for k in ("axis", "axis2", "lead") if k in j)
    for name, shape in spec.get("curves", {}).items():
        yield f"[curves.{name}]"
        yield from (f"{k} = {_value(x)}" for k, x in shape.items())
    for c in spec["closures"]:
        yield "[[closures]]"
        yield from (f"{k} = {_value(x)}" for k, x in c.items() if k not in ("shape", "other"))
    for d in spec["drivers"]:
        yield f'[drivers.{d["name"]}]\njoint = "{d["joint"]}"'
    for s in spec["springs"]:
        yield "[[springs]]"
        yield from (f"{k} = {_value(x)}" for k, x in s.items())


def _numbers(values):
    return " ".join(repr(float(x)) for x in values)


def _value(x):
    if isinstance(x, str):
        return f'"{x}"'
    if isinstance(x, list):
        return "[" + ", ".join(_value(y) for y in x) + "]"
    if isinstance(x, dict):
        return "{" + ", ".join(f"{k} = {_value(y)}" for k, y in x.items()) + "}"
    return repr(float(x))
