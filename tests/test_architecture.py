"""House rules: imports go one way, only the command line prints, public names are documented."""

import ast
from pathlib import Path

import pytest

import spatial_pin as sp

PACKAGE = Path(sp.__file__).parent
LAYERS = ["errors", "outputs", "checks", "settings", "units", "numerics", "operators", "mechanism",
          "formats", "constraints", "kernel", "assembly", "rates", "mobility", "continuation",
          "motion", "dimensions", "dynamics", "reduction", "accuracy", "view", "cli", "__main__"]
UPWARD = {"mechanism.mechanism": "formats"}  # yet to be cut
MODULES = sorted(p for p in PACKAGE.rglob("*.py") if p != PACKAGE / "__init__.py")


LOADER = ("kernel.library", "kernel.sources")  # of the compiled library: they know no mechanism


def layer_of(module: str) -> int:
    name = module.removeprefix("spatial_pin.")
    return LAYERS.index("numerics" if name.startswith(LOADER) else name.split(".")[0])


def imports_of(path: Path) -> list[str]:
    """Modules of the package that are imported, type checking apart."""
    found = []

    def visit(node: ast.AST) -> None:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
                continue
            if isinstance(child, ast.ImportFrom) and child.module:
                names = [child.module] + [f"{child.module}.{a.name}" for a in child.names]
                found.extend(n for n in names if n.startswith("spatial_pin."))
            elif isinstance(child, ast.Import):
                found.extend(a.name for a in child.names if a.name.startswith("spatial_pin."))
            visit(child)

    visit(ast.parse(path.read_text(encoding="utf-8")))
    return [n for n in found if n.split(".")[1] in LAYERS]


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_a_module_imports_only_from_layers_above_it(path):
    module = ".".join(("spatial_pin", *path.relative_to(PACKAGE).with_suffix("").parts))
    for imported in imports_of(path):
        if UPWARD.get(module.removeprefix("spatial_pin.")) != imported.split(".")[1]:
            assert layer_of(imported) <= layer_of(module), f"{module} imports {imported}"


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_only_the_command_line_prints(path):
    calls = [n for n in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
             if isinstance(n, ast.Call) and getattr(n.func, "id", "") == "print"]
    assert not calls or path.parent.name == "cli"


def test_rank_revealing_factorisations_live_in_one_module():
    allowed = {"linalg.py"}
    for path in MODULES:
        text = path.read_text(encoding="utf-8")
        if path.name not in allowed:
            assert "linalg.svd" not in text and "linalg.qr" not in text, path


def test_every_public_name_exists_and_is_documented():
    for name in sp.__all__:
        assert getattr(sp, name).__doc__, name


def test_usual_verbs_need_no_scipy():
    """Importing a part of it takes a quarter of a second, more than all of theirs."""
    import subprocess
    import sys

    code = ("import sys, numpy, spatial_pin as sp; m = sp.load('rssr'); "
            "s = sp.solve_rates(m, sp.assemble(m, {'crank': 1.0}), {'crank': 2.0}); "
            "sp.sweep(m, 'crank', numpy.linspace(0.0, 7.0, 99)); sp.jacobian(m, s, 'coupler'); "
            "sp.forward_dynamics(m, s).reactions; sp.inverse_dynamics(m, s); sp.mobility(m); "
            "print([name for name in sys.modules if name.partition('.')[0] in ('scipy', 'yaml')])")
    run = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert run.stdout == "[]\n"


def test_importing_the_library_loads_neither_meshcat_nor_matplotlib():
    import subprocess
    import sys

    code = ("import sys, spatial_pin; "
            "sys.exit(any(m in sys.modules for m in ('meshcat', 'matplotlib', 'xacro')))")
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
