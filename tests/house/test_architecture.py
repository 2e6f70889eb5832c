"""House rules: imports go one way, only the command line prints, public names are documented."""

import ast
import importlib
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

from offenders import listed

import spatial_pin as sp

PACKAGE = Path(sp.__file__).parent
MODULES = sorted(p for p in PACKAGE.rglob("*.py") if p != PACKAGE / "__init__.py")
MOST = 20  # modules of a folder: files are found by name
# rooms in the order of their layers, files of no room at the top among them; rooms inside of rooms
# likewise, where files beside them may stand anywhere that makes no circle
LAYERS = {
    "": ["errors", "_support", "settings", "units", "kernel.sources", "kernel.library", "numerics",
         "operators", "mechanism", "formats", "constraints", "kernel", "assembly", "rates",
         "mobility", "continuation", "motion", "proximity", "inverse_kinematics", "workspace",
         "dynamics", "dimensions", "function", "reduction", "accuracy", "synthesis", "view",
         "cli", "__main__"],
    "formats": ["xacro", "urdf", "graph", "sdf", "dialects", "usd", "mjcf",
                "pinocchio_model"],
    "dynamics": ["solvers", "derivatives", "simulation"],
    "view": ["scene", "page"],
    "cli": ["commands"],
    "view.scene": ["layers"],
}
LOADER = {"kernel.sources", "kernel.library"}  # of the compiled library: they know no mechanism
DATA_TYPES = {  # a module that is one, and the rooms that it has nothing of
    "mechanism.mechanism": ("formats", "constraints", "kernel", "assembly", "rates"),
    "assembly.state": ("formats", "assembly.square_system", "rates", "mobility", "continuation"),
    "motion.motion": ("formats", "assembly.square_system", "rates", "mobility", "continuation"),
}
FACTORISATIONS = {"svd", "svdvals", "qr", "geqp3", "rq", "lstsq", "pinv", "pinvh", "matrix_rank",
                  "cond", "null_space", "orth", "lu", "lu_factor", "splu", "spilu"}


def name_of(path: Path) -> str:
    """Return the dotted name of a file, inside the package."""
    return ".".join(path.relative_to(PACKAGE).with_suffix("").parts)


NAMES = {name_of(path) for path in MODULES}


class Facts(NamedTuple):
    """What the rules judge of a file."""

    first_line: str  # of its docstring
    imports: frozenset[str]  # modules of the package, anywhere in it, for type checking too
    handed_on: frozenset[str]  # "module:function" that does the work of a public type's method
    prints: list[int]  # lines that call it
    factorisations: set[str]  # those that tell ranks, or solve by one
    classes: list[str]  # without a leading underscore


@cache
def facts_of(path: Path) -> Facts:
    """Return what one reading of a file tells."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    imported, prints, factorisations, classes = set(), [], set(), []
    lines, works = handed_on_by(tree)
    for node in ast.walk(tree):
        if node in lines:
            continue  # rooms above it do that work
        if isinstance(node, ast.Import | ast.ImportFrom):
            imported.update(imported_by(node))
            factorisations.update(factorisations_imported_by(node))
        elif isinstance(node, ast.Call) and getattr(node.func, "id", "") == "print":
            prints.append(node.lineno)
        elif isinstance(node, ast.ClassDef):
            classes.append(node.name.lstrip("_"))
        elif isinstance(node, ast.Attribute) and is_factorisation(node.attr) and any(
                x in ast.unparse(node.value) for x in ("linalg", "lapack")):
            factorisations.add(node.attr)
    first = (ast.get_docstring(tree) or "").partition("\n")[0].strip()
    return Facts(first, frozenset(imported), frozenset(works), prints, factorisations, classes)


def handed_on_by(tree: ast.Module) -> tuple[list[ast.ImportFrom], list[str]]:
    """Return the imports of methods of public types that only hand on their work, and to what.

    Such a method is an import and a return: what a data type offers, though rooms above it work
    it out, and it imports them at no other time.
    """
    lines, works = [], []
    for kind in tree.body:
        if not isinstance(kind, ast.ClassDef) or kind.name not in sp.__all__:
            continue
        for node in kind.body:
            body = node.body if isinstance(node, ast.FunctionDef) else []
            body = body[1:] if body and isinstance(body[0], ast.Expr) else body
            match body:
                case [ast.ImportFrom(names=[name]) as line, ast.Return(value=ast.Call() as call)]:
                    work = ast.unparse(call.func)
                    if work.split(".")[0] == name.name:
                        lines.append(line)
                        works.append(f"{line.module}:{work}")
    return lines, works


def imported_by(node: ast.Import | ast.ImportFrom) -> Iterator[str]:
    """Yield the modules of the package that a line of imports names."""
    if isinstance(node, ast.Import):
        named = [a.name for a in node.names]
    elif node.module and not node.level:
        named = [n if inside(n) in NAMES or f"{inside(n)}.__init__" in NAMES else node.module
                 for n in (f"{node.module}.{a.name}" for a in node.names)]
    else:
        named = []
    own = {inside(n) for n in named if n.startswith("spatial_pin.")}
    yield from (n if n in NAMES else f"{n}.__init__" for n in own)


def inside(name: str) -> str:
    return name.removeprefix("spatial_pin.")


def is_factorisation(name: str) -> bool:
    """Whether a function of SciPy, or of LAPACK with the letter of its precision, is one."""
    return name in FACTORISATIONS or name[1:] in FACTORISATIONS


def factorisations_imported_by(node: ast.Import | ast.ImportFrom) -> Iterator[str]:
    module = (isinstance(node, ast.ImportFrom) and node.module) or ""
    if "linalg" in module.split(".") and "spatial_pin" not in module:
        yield from (a.name for a in node.names if is_factorisation(a.name))


def edges_in(room: str) -> Iterator[tuple[str, str, str]]:
    """Yield what imports what of the files and rooms of a room, and by which line of imports."""
    prefix = f"{room}." if room else ""
    for path in MODULES:
        module = name_of(path)
        for imported in facts_of(path).imports:
            if module.startswith(prefix) and imported.startswith(prefix):
                a, b = (n if n in LOADER and not room else n.removeprefix(prefix).split(".")[0]
                        for n in (module, imported))
                if a != b:
                    yield a, b, f"{module} imports {imported}"


def rooms() -> list[str]:
    """Return every package by its dotted name, the whole as an empty one."""
    return sorted({name_of(p).rpartition(".")[0] for p in MODULES})


def test_every_room_has_a_layer():
    parts = [room.rpartition(".") for room in rooms()[1:]]
    without = [f"{parent}.{name}" for parent, _, name in parts
               if name not in LAYERS.get(parent, ())]
    without += [path.name for path in PACKAGE.glob("*.py")
                if path.stem not in ("__init__", *LAYERS[""])]
    assert not without, listed(without)


def test_imports_go_from_higher_layers_to_lower_ones_only():
    upward = [line for room, order in LAYERS.items() for a, b, line in edges_in(room)
              if a in order and b in order and order.index(b) >= order.index(a)]
    assert not upward, listed(upward)


def circle_in(room: str) -> list[str]:
    """Return files and rooms of a room that import each other in a circle, and who imports them."""
    graph: dict[str, set[str]] = {}
    for a, b, _ in edges_in(room):
        graph.setdefault(a, set()).add(b)
        graph.setdefault(b, set())
    while free := [a for a, imported in graph.items() if not imported & graph.keys()]:
        for a in free:
            del graph[a]
    return sorted(graph)


def test_no_files_or_rooms_import_each_other_in_a_circle():
    circles = {room or "the package": names for room in rooms() if (names := circle_in(room))}
    assert not circles, listed(circles)


def test_data_types_import_no_solver_and_no_format():
    wrong = [f"{module} imports {imported}" for module, barred in DATA_TYPES.items()
             for imported in facts_of(PACKAGE / f"{module.replace('.', '/')}.py").imports
             if any(f"{imported}.".startswith(f"{room}.") for room in barred)]
    assert not wrong, listed(wrong)


def test_no_folder_holds_too_many_files():
    counts = Counter(path.parent for path in MODULES if path.name != "__init__.py")
    full = {str(p): n for p, n in counts.items() if n > MOST}
    assert not full, listed(full)


def test_no_class_and_no_module_name_stands_twice():
    """Readers, writers and reports of formats and pages have one name each in their own folder."""
    classes, modules = Counter(), Counter()
    for path in PACKAGE.rglob("*.py"):
        modules[path.stem] += 1
        classes.update(facts_of(path).classes)
    repeated = {"__init__", "__main__", "reader", "writer", "report"}
    assert [name for name, n in classes.items() if n > 1] == []
    assert [name for name, n in modules.items() if n > 1 and name not in repeated] == []


def test_only_the_command_line_prints():
    calls = {name_of(path): facts_of(path).prints for path in MODULES if facts_of(path).prints}
    wrong = {name: lines for name, lines in calls.items() if not name.startswith("cli.")}
    assert not wrong, listed(wrong)


def test_the_first_line_of_a_module_says_what_it_is():
    first = {name_of(path): facts_of(path).first_line for path in MODULES}
    wrong = {name: line for name, line in first.items() if not line.endswith((".", ":", ","))}
    assert not wrong, listed(wrong)


def test_factorisations_that_tell_ranks_are_mathematics_without_mechanisms():
    found = {name_of(path): kinds for path in MODULES
             if (kinds := facts_of(path).factorisations)}
    beyond = {name: kinds for name, kinds in found.items() if not name.startswith("numerics.")}
    assert not beyond, listed(beyond)


def test_every_public_name_exists_and_is_documented():
    without = [name for name in sp.__all__ if not getattr(sp, name).__doc__]
    assert not without, listed(without)


def test_what_a_data_type_offers_is_worked_out_by_a_documented_function():
    works = sorted({work for path in MODULES for work in facts_of(path).handed_on})
    assert works
    wrong = [f"{work} has no docstring" for work in works if not work_named(work).__doc__]
    assert not wrong, listed(wrong)


def work_named(work: str) -> object:
    """Return the function of "module:name", or of "package:module.name"."""
    module, _, name = work.partition(":")
    found: object = importlib.import_module(module)
    for part in name.split("."):
        if not hasattr(found, part):
            importlib.import_module(f"{module}.{part}")
        found = getattr(found, part)
    return found


def test_a_room_does_not_hide_a_verb_of_its_name():
    for room in rooms()[1:]:
        importlib.import_module(f"spatial_pin.{room}")
    assert callable(sp.mobility)


def test_usual_verbs_need_no_scipy():
    """Importing a part of it takes a quarter of a second, more than all of theirs."""
    code = ("import sys, numpy, spatial_pin as sp; m = sp.load('rssr'); "
            "s = sp.solve_rates(m, sp.assemble(m, {'crank': 1.0}), {'crank': 2.0}); "
            "sp.sweep(m, 'crank', numpy.linspace(0.0, 7.0, 99)); sp.jacobian(m, s, 'coupler'); "
            "sp.forward_dynamics(m, s).reactions; sp.inverse_dynamics(m, s); sp.mobility(m); "
            "sp.simulate(m, s, 0.1); sp.sensitivity(m, s, 'rocker_pin', ['a']); "
            "print([name for name in sys.modules if name.partition('.')[0] in ('scipy', 'yaml')])")
    run = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert run.stdout == "[]\n"


def test_loading_a_mechanism_imports_no_solver_of_motion():
    """Verbs are imported when they are first asked for; afterwards they are plain attributes."""
    code = ("import sys, spatial_pin as sp; sp.load('rssr'); "
            "print(sorted({n.split('.')[1] for n in sys.modules if n.startswith('spatial_pin.')} "
            "& {'motion', 'continuation', 'dynamics', 'dimensions', 'reduction', 'view'}), "
            "'sweep' in vars(sp), callable(sp.sweep), 'sweep' in vars(sp), 'trace' in dir(sp))")
    run = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert run.stdout == "[] False True True True\n"


def test_importing_the_library_loads_neither_meshcat_nor_matplotlib():
    code = ("import sys, spatial_pin; "
            "sys.exit(any(m in sys.modules for m in ('meshcat', 'matplotlib', 'xacro')))")
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
