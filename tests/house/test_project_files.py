"""The files about the project tell one story: readme, citation, recipe, workflow, metadata."""

import re
import tomllib

import pytest
import yaml
from folders import ROOT

import spatial_pin as sp

README = (ROOT / "README.md").read_text(encoding="utf-8")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def blocks(language):
    fenced = re.findall(r"^```(\w*)\n(.*?)^```$", README, re.MULTILINE | re.DOTALL)
    return [text for name, text in fenced if name == language]


def commands():
    return [line for block in blocks("") for line in block.splitlines()
            if line.startswith("spatial-pin ")]


def test_the_readme_can_be_read_in_one_go():
    assert len(README.splitlines()) <= 150


def test_the_python_of_the_readme_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (program,) = blocks("python")
    exec(compile(program, "README.md", "exec"), {})
    assert (tmp_path / "rocker.png").stat().st_size > 10_000
    assert (tmp_path / "rssr.html").stat().st_size > 100_000


@pytest.mark.parametrize("line", commands())
def test_the_commands_of_the_readme_run(line, tmp_path, monkeypatch, run):
    monkeypatch.chdir(tmp_path)
    code, out, _ = run(*line.split("#")[0].split()[1:])
    assert code in (0, None) and out
    for name in re.findall(r"\S+\.(?:csv|html|png)", line):
        assert (tmp_path / name).stat().st_size > 1000


def test_pages_and_pictures_that_the_readme_names_exist():
    named = re.findall(r"\]\((?!https?:|#)([^)]+)\)", README)
    assert len(named) > 10
    assert [name for name in named if not (ROOT / name).exists()] == []


def test_every_dependency_has_a_line_in_the_readme():
    wanted = [re.match(r"[\w-]+", entry)[0] for entry in PROJECT["dependencies"]]
    wanted += [f"`{extra}`" for extra in PROJECT["optional-dependencies"]
               if extra not in ("test", "bench")]
    table = README[README.index("## What it needs"):]
    assert [name for name in wanted if name not in table] == []


def test_the_security_page_says_where_to_write_what_to_send_and_when_an_answer_comes():
    text = (ROOT / "SECURITY.md").read_text(encoding="utf-8").partition("## Reporting a fault")[2]
    addresses = re.findall(r"<([^>]+)>", text)
    assert [x.partition(":")[0] for x in addresses if "://" in x] == ["https"]
    assert [x.rpartition("@")[2] for x in addresses if "@" in x] == ["example.org"]
    assert all("PLACEHOLDER" in x for x in addresses) and "PLACEHOLDER: both addresses" in text
    for word in ("in private", "\nSend\n", "__version__", "within a week", "days"):
        assert word in text


def test_the_version_is_the_same_everywhere():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    recipe = yaml.safe_load((ROOT / "packaging/conda/recipe.yaml").read_text(encoding="utf-8"))
    assert citation["version"] == recipe["context"]["version"] == sp.__version__
    assert f"## {sp.__version__}" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


def test_the_conda_recipe_requires_what_the_package_requires():
    recipe = yaml.safe_load((ROOT / "packaging/conda/recipe.yaml").read_text(encoding="utf-8"))
    other_names = {"pinocchio": "pin", "meshcat-python": "meshcat", "matplotlib-base": "matplotlib"}
    run = [entry.split() for entry in recipe["requirements"]["run"]]
    asked = {other_names.get(name, name) + bound for name, bound, *_ in
             (entry for entry in run if entry[0] != "python")}
    assert ["python"] in run  # whose versions a package of one Python leaves to `skip`
    assert asked == set(PROJECT["dependencies"])
    oldest = PROJECT["requires-python"].removeprefix(">=")
    assert f'match(python, "<{oldest}")' in recipe["build"]["skip"]


def test_the_workflow_runs_the_scripts_that_exist_under_the_promised_pythons():
    text = (ROOT / ".github/workflows/test.yml").read_text(encoding="utf-8")
    workflow = yaml.safe_load(text)
    matrix = workflow["jobs"]["test"]["strategy"]["matrix"]
    promised = [entry.rsplit(" ", 1)[1] for entry in PROJECT["classifiers"]
                if re.search(r":: 3\.\d+$", entry)]
    assert matrix["python"] == promised
    assert {name.split("-")[0] for name in matrix["os"]} == {"ubuntu", "macos"}
    scripts = re.findall(r"run: \./(scripts/\w+)", text)
    assert len(scripts) >= 4
    assert [name for name in scripts if not (ROOT / name).exists()] == []
