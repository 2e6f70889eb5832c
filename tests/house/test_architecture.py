"""House rules: imports go one way, only the command line prints, public names are documented."""

import ast
import importlib
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

import spatial_pin as sp
from spatial_pin import methods

PACKAGE = Path(sp.__file__).parent
MODULES = sorted(p for p in PACKAGE.rglob("*.py") if p != PACKAGE / "__init__.py")
MOST = 13  # modules of a folder
# rooms in the order of their layers, files of no room at the top among them; rooms inside of rooms
# likewise, where files beside them may stand anywhere that makes no circle
LAYERS = {
    "": ["errors", "brief", "lazy", "methods", "outputs", "figures", "progress", "executors",
         "checks", "columns", "settings", "units", "kernel.sources", "kernel.library", "numerics",
         "operators", "mechanism", "formats", "constraints", "kernel", "assembly", "rates",
         "mobility", "continuation", "motion", "proximity", "inverse_kinematics", "workspace_map",
         "dynamics", "dimensions", "reduction", "accuracy", "synthesis", "view",
         "cli", "__main__"],
    "formats": ["xacro", "meshes", "urdf", "graph", "sdf", "dialects", "usd", "mjcf",
                "pinocchio_model"],
    "formats.dialects": ["beside"],
    "assembly": ["search"],
    "mobility": ["modes"],
    "reduction": ["model"],
    "dynamics": ["solvers", "derivatives", "simulation"],
    "dynamics.simulation": ["formulations", "running"],
    "synthesis": ["demands"],
    "view": ["scene", "page", "browser"],
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
INNER = ("Motion.bodies", "Motion.rate_error", "Motion.summary", "Tradeoff.table")  # of others


def name_of(path: Path) -> str:
    """Return the dotted name of a file, inside the package."""
    return ".".join(path.relative_to(PACKAGE).with_suffix("").parts)


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


NAMES = {name_of(path) for path in MODULES}


@cache
def imports_of(path: Path) -> frozenset[str]:
    """Return the modules that one imports, anywhere in it, for type checking too."""

    def found() -> Iterator[str]:
        for node in ast.walk(tree_of(path)):
            if isinstance(node, ast.Import):
                yield from (a.name for a in node.names)
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                for a in node.names:
                    inside = f"{node.module}.{a.name}".removeprefix("spatial_pin.")
                    is_module = inside in NAMES or f"{inside}.__init__" in NAMES
                    yield f"{node.module}.{a.name}" if is_module else node.module

    own = {n.removeprefix("spatial_pin.") for n in found() if n.startswith("spatial_pin.")}
    return frozenset(n if n in NAMES else f"{n}.__init__" for n in own)


def edges_in(room: str) -> Iterator[tuple[str, str, str]]:
    """Yield what imports what of the files and rooms of a room, and by which line of imports."""
    prefix = f"{room}." if room else ""
    for path in MODULES:
        module = name_of(path)
        for imported in imports_of(path):
            if module.startswith(prefix) and imported.startswith(prefix):
                a, b = (n if n in LOADER and not room else n.removeprefix(prefix).split(".")[0]
                        for n in (module, imported))
                if a != b:
                    yield a, b, f"{module} imports {imported}"


def rooms() -> list[str]:
    """Return every package by its dotted name, the whole as an empty one."""
    return sorted({name_of(p).rpartition(".")[0] for p in MODULES})


def test_every_room_has_a_layer():
    for room in rooms()[1:]:
        parent, _, name = room.rpartition(".")
        assert name in LAYERS.get(parent, ()), room
    for path in PACKAGE.glob("*.py"):
        assert path.stem == "__init__" or path.stem in LAYERS[""], path


@pytest.mark.parametrize("room", LAYERS)
def test_imports_go_from_higher_layers_to_lower_ones_only(room):
    order = LAYERS[room]
    for a, b, line in edges_in(room):
        if a in order and b in order:
            assert order.index(b) < order.index(a), line


@pytest.mark.parametrize("room", rooms())
def test_no_files_or_rooms_import_each_other_in_a_circle(room):
    graph: dict[str, set[str]] = {}
    for a, b, _ in edges_in(room):
        graph.setdefault(a, set()).add(b)
        graph.setdefault(b, set())
    while graph:
        free = [a for a, imported in graph.items() if not imported & graph.keys()]
        assert free, f"among these of {room or 'the package'}: {sorted(graph)}"
        for a in free:
            del graph[a]


def test_data_types_import_no_solver_and_no_format():
    for module, barred in DATA_TYPES.items():
        for imported in imports_of(PACKAGE / f"{module.replace('.', '/')}.py"):
            assert not any(f"{imported}.".startswith(f"{room}.") for room in barred), (
                f"{module} imports {imported}")


def test_no_folder_holds_too_many_files():
    counts = Counter(path.parent for path in MODULES if path.name != "__init__.py")
    assert not {str(p): n for p, n in counts.items() if n > MOST}


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_only_the_command_line_prints(path):
    calls = [n for n in ast.walk(tree_of(path))
             if isinstance(n, ast.Call) and getattr(n.func, "id", "") == "print"]
    assert not calls or name_of(path).startswith("cli.")


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_the_first_line_of_a_module_says_what_it_is(path):
    words = ast.get_docstring(tree_of(path)) or ""
    assert words.partition("\n")[0].strip().endswith((".", ":", ",")), path


def factorisations_in(path: Path) -> set[str]:
    """Return the factorisations that tell ranks, or solve by one, that a module calls."""
    names = set()
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Attribute):
            from_library = any(x in ast.unparse(node.value) for x in ("linalg", "lapack"))
            names |= {node.attr} if from_library else set()
        elif isinstance(node, ast.ImportFrom) and "linalg" in (node.module or "").split("."):
            names |= {a.name for a in node.names} if "spatial_pin" not in node.module else set()
    return {n for n in names if n in FACTORISATIONS or n[1:] in FACTORISATIONS}


def test_factorisations_that_tell_ranks_are_mathematics_without_mechanisms():
    found = {name_of(path): kinds for path in MODULES if (kinds := factorisations_in(path))}
    beyond = {name: kinds for name, kinds in found.items() if not name.startswith("numerics.")}
    assert not beyond


def test_every_public_name_exists_and_is_documented():
    for name in sp.__all__:
        assert getattr(sp, name).__doc__, name


@pytest.mark.parametrize("name", methods.names())
def test_what_a_data_type_offers_is_worked_out_by_a_documented_function(name):
    kind, _, method = name.partition(".")
    assert methods.method(name).__doc__
    assert hasattr(getattr(sp, kind), method) or name in INNER


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
