"""The package is built with its compiled kernel and its mechanism library, wherever it can be."""

import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import venv
import zipfile
from pathlib import Path
from types import SimpleNamespace

import pytest
from folders import ROOT

import spatial_pin as sp
from spatial_pin.kernel.library import compiled_from, opened
from spatial_pin.kernel.sources import LIBRARY, source_hash

sys.path.insert(0, str(ROOT / "scripts"))
import build_kernel

OUTSIDE = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}


@pytest.fixture
def machine(monkeypatch, tmp_path):
    """A machine whose PATH is a folder of the test's, with what compilers it is given."""
    folder = tmp_path / "bin"
    folder.mkdir()
    monkeypatch.setenv("PATH", str(folder))
    monkeypatch.delenv("CC", raising=False)
    build_kernel.system_compiler.cache_clear()

    def add(name, script):
        (folder / name).write_text(f"#!{shutil.which('sh', path=OUTSIDE['PATH'])}\n{script}\n")
        (folder / name).chmod(0o755)

    yield add
    build_kernel.system_compiler.cache_clear()


@pytest.fixture
def tree(tmp_path):
    """A source tree of the kernel alone."""
    (tmp_path / "scripts").mkdir()
    shutil.copytree(ROOT / build_kernel.KERNEL, tmp_path / build_kernel.KERNEL,
                    ignore=shutil.ignore_patterns("_*"))
    return tmp_path


def hook():
    return build_kernel.KernelHook.__new__(build_kernel.KernelHook)


def test_without_a_compiler_the_build_requires_ziglang(machine):
    assert hook().dependencies() == ["ziglang"]


def test_a_compiler_that_only_says_it_is_none_is_none(machine):
    machine("cc", 'echo "xcode-select: note: No developer tools were found" >&2; exit 1')
    assert hook().dependencies() == ["ziglang"]


def test_the_first_compiler_that_works_is_taken(machine):
    real = shutil.which("cc", path=OUTSIDE["PATH"]) or shutil.which("gcc", path=OUTSIDE["PATH"])
    if not real:
        pytest.skip("no C compiler here")
    machine("cc", "exit 1")
    machine("gcc", f'PATH={OUTSIDE["PATH"]} exec {real} "$@"')
    assert hook().dependencies() == []
    assert build_kernel.compiler() == ["gcc"]


@pytest.mark.slow
def test_a_compiler_that_cannot_inline_across_files_is_used_without(machine, tree):
    real = shutil.which("cc", path=OUTSIDE["PATH"]) or shutil.which("gcc", path=OUTSIDE["PATH"])
    if not real:
        pytest.skip("no C compiler here")
    refused = f'case " $* " in *" {build_kernel.ACROSS_FILES} "*) echo no >&2; exit 1;; esac'
    machine("cc", f'{refused}; PATH={OUTSIDE["PATH"]} exec {real} "$@"')
    assert build_kernel.compile_kernel(tree, ["-O0"]).exists()


def test_no_compiler_at_all_is_reported_with_the_remedy(machine, monkeypatch):
    monkeypatch.setattr(build_kernel.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(SystemExit, match=r"no C compiler works here: install gcc .*pip install"):
        build_kernel.compiler()


def test_a_named_compiler_that_fails_is_shown(machine, monkeypatch, tree):
    machine("mycc", 'echo "mycc: no licence" >&2; exit 3')
    monkeypatch.setenv("CC", "mycc -m64")
    assert hook().dependencies() == []
    with pytest.raises(SystemExit, match=r"does not compile: mycc -m64 .*\n.*no licence"):
        build_kernel.compile_kernel(tree)
    monkeypatch.setenv("CC", "nocc")
    build_kernel.system_compiler.cache_clear()
    with pytest.raises(SystemExit, match="the C compiler nocc cannot be run"):
        build_kernel.compile_kernel(tree)
    assert not list((tree / build_kernel.KERNEL).glob("_kernel*"))


def test_ziglang_compiles_for_any_processor_of_the_kind(machine, monkeypatch):
    monkeypatch.setattr(build_kernel.importlib.util, "find_spec", lambda name: name)
    assert build_kernel.compiler()[1:] == ["-m", "ziglang", "cc", "-mcpu=baseline"]


@pytest.mark.parametrize(("system", "asked", "tag"), [
    ("darwin", "", "py3-none-macosx_11_0_arm64"), ("darwin", "12.3", "py3-none-macosx_12_0_arm64"),
    ("darwin", "10.15", "py3-none-macosx_10_15_arm64"), ("linux", "", "py3-none-linux_aarch64")])
def test_the_wheel_is_one_of_its_platform(monkeypatch, system, asked, tag):
    monkeypatch.setattr(build_kernel, "sys", SimpleNamespace(platform=system))
    monkeypatch.setattr(build_kernel.platform, "machine", lambda: "arm64")
    monkeypatch.setattr(build_kernel.sysconfig, "get_platform", lambda: "linux-aarch64")
    if asked:
        monkeypatch.setenv("MACOSX_DEPLOYMENT_TARGET", asked)
    else:
        monkeypatch.delenv("MACOSX_DEPLOYMENT_TARGET", raising=False)
    assert build_kernel.wheel_tag() == tag


@pytest.mark.slow
def test_a_library_older_than_its_c_files_is_refused(tree):
    folder = tree / build_kernel.KERNEL
    strict = ["-O0", "-Wall", "-Wextra", "-pedantic-errors"]  # C99 and nothing else
    library = build_kernel.compile_kernel(tree, strict)
    assert library == folder / LIBRARY
    assert compiled_from(opened(library)) == source_hash(folder)
    with (folder / "algebra" / "vectors.h").open("a") as file:
        file.write("/* changed */\n")
    with pytest.raises(sp.SpatialPinError, match=r"is older than the C files.*build_kernel\.py"):
        opened(library)
    for file in folder.rglob("*.[ch]"):
        file.unlink()
    opened(library)  # installed from a wheel: there are no C files
    with pytest.raises(sp.SpatialPinError, match=r"cannot be loaded .*install the package"):
        opened(folder / "none.so")


def as_an_index_reads_them(wheel, sdist):
    """The description renders, and its pictures and links are whole addresses."""
    subprocess.run([sys.executable, "-m", "twine", "check", "--strict", str(wheel), str(sdist)],
                   check=True, capture_output=True)
    with zipfile.ZipFile(wheel) as built:
        (name,) = [n for n in built.namelist() if n.endswith(".dist-info/METADATA")]
        description = built.read(name).decode()
    links = re.findall(r"\]\(([^)]+)\)", description)
    assert len(links) > 10
    assert not [link for link in links if not link.startswith("https://")]


@pytest.mark.slow
def test_a_wheel_in_an_empty_environment_loads_by_name_from_another_folder(tmp_path):
    """The wheel is built from the sdist; the dependencies come from this environment."""
    build = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(tmp_path), str(ROOT)]
    subprocess.run(build, check=True, capture_output=True, env=OUTSIDE)
    (wheel,) = tmp_path.glob("spatial_pin-*.whl")
    (sdist,) = tmp_path.glob("spatial_pin-*.tar.gz")
    assert re.fullmatch(r"spatial_pin-[\d.]+-py3-none-(?!any).+\.whl", wheel.name)
    with zipfile.ZipFile(wheel) as built:
        names = built.namelist()
    assert {f"spatial_pin/kernel/{LIBRARY}", "spatial_pin/py.typed"} <= set(names)
    assert not [n for n in names if n.endswith((".c", ".h"))]
    with tarfile.open(sdist) as packed:
        sources = {name.partition("/")[2] for name in packed.getnames()}
    assert {"scripts/build_kernel.py", "spatial_pin/kernel/core/model.c",
            "spatial_pin/kernel/core/kernel.h"} <= sources
    assert not [n for n in sources if n.endswith(LIBRARY)]
    as_an_index_reads_them(wheel, sdist)

    folder = tmp_path / "empty"
    venv.create(folder, with_pip=False)
    python = folder / "bin" / "python"
    site = Path(sysconfig.get_path("purelib", vars={"base": str(folder)}))
    here = Path(sysconfig.get_path("purelib"))
    cmeel = here / "cmeel.prefix" / "lib" / site.parent.name / "site-packages"
    (site / "dependencies.pth").write_text(f"{here}\n{cmeel}\n", encoding="utf-8")
    subprocess.run([sys.executable, "-m", "zipfile", "-e", str(wheel), str(site)], check=True)

    code = ("import spatial_pin as sp; from spatial_pin.kernel.library import library; library(); "
            "m = sp.load('rssr', d=0.315); "
            "print(sp.__file__, sp.assemble(m, {'crank': 0.0}).coordinate('rocker_pin').value)")
    run = subprocess.run([str(python), "-c", code], check=True, capture_output=True, text=True,
                         cwd=tmp_path, env=OUTSIDE)
    file, angle = run.stdout.split()
    assert Path(file).is_relative_to(site)
    assert float(angle) == pytest.approx(1.238712380, abs=1e-8)  # 70.97299137°
