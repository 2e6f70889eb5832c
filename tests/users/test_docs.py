"""The documentation says what is: its code runs, its tables are those of the code."""

import importlib.util
import inspect
import re
import sys

import pytest
from folders import ROOT
from offenders import listed

import spatial_pin as sp

DOCS = ROOT / "docs"
PAGES = sorted(path for path in DOCS.glob("*.md"))


def script(name):
    spec = importlib.util.spec_from_file_location(name, ROOT / "scripts" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


page_code = script("page_code")


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("page", [p for p in PAGES if page_code.blocks(p)], ids=lambda p: p.stem)
def test_the_code_of_a_page_runs_and_prints_what_the_page_shows(page):
    with page_code.empty_folder():
        wrong = page_code.run_page(page)
    assert not wrong, "\n\n".join(wrong)


def test_the_runner_tells_of_a_block_that_prints_something_else(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("```python\nprint(1 + 1)\n```\n\n```text\n3\n```\n")
    assert len(page_code.run_page(page)) == 1
    page.write_text("```python\nprint(1 + 1)\n```\n\n```text\n2\n```\n")
    assert not page_code.run_page(page)


def test_the_runner_holds_a_part_of_a_script_to_the_script(tmp_path):
    page = tmp_path / "page.md"
    text = "<!-- from: examples/jansen_leg.py -->\n```python\n{}\n```\n\n```text\n{}\n```\n"
    sweep = 'motion = sp.sweep(leg, "crank", np.linspace(0.0, 2 * np.pi, 721))'
    answer = "A step is 67.9 cm long, the foot is lifted by 22.5 cm."
    with page_code.empty_folder():
        page.write_text(text.format(sweep, answer))
        assert not page_code.run_page(page)
        page.write_text(text.format(sweep.replace("721", "361"), answer))
        assert "has no such lines" in page_code.run_page(page)[0]
        page.write_text(text.format(sweep, answer.replace("67.9", "67.8")))
        assert "prints" in page_code.run_page(page)[0]


def test_commands_of_a_page_end_as_it_says(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("```console\n$ spatial-pin info nothing\n```\n")
    with pytest.raises(AssertionError, match="ends with 1"):
        page_code.run_page(page)
    page.write_text("<!-- ends with 1 -->\n```console\n$ spatial-pin info nothing\n```\n")
    assert not page_code.run_page(page)
    page.write_text("```console\n$ pip install nothing\n```\n")
    with pytest.raises(ValueError, match="say why not"):
        page_code.run_page(page)


def test_only_what_installs_or_takes_hours_is_not_run():
    reasons = {block.why_not for page in PAGES for block in page_code.pieces(page)} - {""}
    assert all(re.match("it installs|it takes .* hours", reason) for reason in reasons), reasons


# ---------------------------------------------------------------- reference


def test_every_public_name_has_a_place_in_the_reference():
    text = "\n".join(path.read_text(encoding="utf-8") for path in (DOCS / "reference").glob("*.md"))
    told = re.findall(r"^\.\. auto\w+:: spatial_pin\.(\w+)$", text, flags=re.MULTILINE)
    assert sorted(told) == sorted({*sp.__all__, "operators"}), listed(
        set(told) ^ {*sp.__all__, "operators"})


INNER = {"of_native", "check_rotations", "read_targets"}  # of importers and solvers


def test_every_function_of_a_public_module_has_a_place_in_the_reference():
    text = "\n".join(path.read_text(encoding="utf-8") for path in (DOCS / "reference").glob("*.md"))
    modules = ("closures", "goals", "laws", "targets")
    told = re.findall(rf"^\.\. autofunction:: spatial_pin\.((?:{'|'.join(modules)})\.\w+)$", text,
                      flags=re.MULTILINE)
    there = {f"{name}.{key}" for name in modules for key, x in vars(getattr(sp, name)).items()
             if key[0] != "_" and key not in INNER and inspect.isfunction(x)
             and x.__module__ == getattr(sp, name).__name__}
    assert set(told) == there, listed(set(told) ^ there)


# ---------------------------------------------------------------- tables made by scripts


def test_the_table_of_extremes_is_that_of_the_script():
    extremes = script("extremes")
    rows = [f"| {x.name} | {x.tried} | {extremes.answer(x)} |" for x in extremes.EXTREMES]
    text = (DOCS / "extremes.md").read_text(encoding="utf-8")
    assert [line for line in text.split("\n") if line.startswith("| ")][1:] == rows


# ---------------------------------------------------------------- the site


def test_pictures_are_small_and_every_library_mechanism_has_one():
    pictures = [p for p in DOCS.rglob("*") if p.suffix in (".png", ".jpg", ".gif", ".svg")]
    large = [p.name for p in pictures if "_build" not in p.parts and p.stat().st_size > 300e3]
    assert not large
    assert {p.stem for p in (DOCS / "pictures").glob("*.jpg")} >= set(sp.list_mechanisms())


@pytest.mark.filterwarnings("ignore::spatial_pin.SpatialPinWarning")
@pytest.mark.parametrize("page", [
    pytest.param(page, marks=pytest.mark.slow if page.stem == "talos" else ())
    for page in sorted((DOCS / "robots").glob("*.md"))], ids=lambda p: p.stem)
def test_pages_of_robots_say_what_their_files_have(page, monkeypatch):
    pytest.importorskip("mujoco")
    monkeypatch.syspath_prepend(ROOT / "scripts")
    robots = importlib.import_module("robots")
    folders = [ROOT / "tests" / "data" / "mjcf", ROOT / "tests" / "data" / "gepetto"]
    files = {robot.name: (robot, path) for robot, path in robots.present(folders)}
    if page.stem not in files:
        pytest.skip("its file is not here")
    robot, path = files[page.stem]
    texts = page.read_text(encoding="utf-8"), robots.page(robot, robot.posed(path))
    told, now = (re.sub(r"[\d.]+ kg", "", text).partition("  closure rank")[0]
                 for text in texts)  # masses may be those of meshes, which are not here
    assert "mobility of" in told and told == now


LISTED = (DOCS / "guides.md").read_text(encoding="utf-8").partition("\n## ")[2]
GUIDES = [DOCS / name for name in re.findall(r"\]\((\w+\.md)\)", LISTED)]
STARTS = [DOCS / "modelling.md", DOCS / "quick_start.md"]  # before the guides


def test_every_verb_has_a_guide_with_a_picture():
    verbs = {name for name in sp.__all__ if inspect.isfunction(getattr(sp, name))}
    told = {path: path.read_text(encoding="utf-8") for path in GUIDES + STARTS}
    assert len(GUIDES) > 15
    for path in GUIDES:
        assert "**What next:**" in told[path], path.name
    told = {path: text for path, text in told.items() if "![" in text or path in STARTS}
    wrong = [verb for verb in verbs
             if not any(re.search(rf"\bsp\.{verb}\b", text) for text in told.values())]
    assert not wrong, listed(wrong)


def under_headings(pattern, entry, text):
    """Return (heading, entries) of the parts of a page that begin with a heading."""
    parts = re.split(pattern, text, flags=re.MULTILINE)[1:]
    return [(heading, re.findall(entry, part, re.MULTILINE))
            for heading, part in zip(parts[::2], parts[1::2], strict=True)]


def test_the_guides_stand_under_the_same_headings_on_every_list():
    listed_guides = under_headings(r"^## (.+)$", r"\]\((\w+)\.md\)", f"\n## {LISTED}")
    assert [heading for heading, _ in listed_guides] == [
        "See it", "Move it", "Load it", "Size it", "Share it"]
    index = (DOCS / "index.md").read_text(encoding="utf-8")
    contents = under_headings(r"^:caption: (.+)$", r"^\w+$", index)
    shown = under_headings(r"^\| \*\*(.+)\*\* \|", r"\]\((\w+)\.md\)",
                           index.partition("[Gallery]")[0])
    assert listed_guides == shown
    assert listed_guides == [entry for entry in contents if entry[0].endswith(" it") and
                             entry[0] != "Behind it"]


def test_every_guide_begins_with_its_question():
    for path in GUIDES:
        first = path.read_text(encoding="utf-8").split("\n\n")[1]
        assert first.startswith("**") and first.split("**")[1].endswith("?"), path.name


def test_how_every_picture_is_made_is_known():
    pictures = script("pictures")
    robots = {robot.name for robot in pictures.robots.ROBOTS}
    for path in pictures.pictures():
        maker = pictures.made_by(path)
        if maker.make is pictures.of_code:
            assert path.name in pictures.page_of(path).read_text(encoding="utf-8")
        if maker.make is pictures.of_example:
            assert (ROOT / "examples" / f"{path.stem}.py").is_file()
        assert maker.make is not pictures.of_library or path.stem in sp.list_mechanisms()
        assert maker.make is not pictures.of_robot or path.stem in robots
        for file in re.findall(r"(?:scripts|examples)/\w+\.py", maker.words):
            assert (ROOT / file).is_file()


@pytest.mark.slow
def test_the_site_builds_without_a_warning(tmp_path):
    pytest.importorskip("sphinx")
    pytest.importorskip("furo")
    pytest.importorskip("ziamath")
    import subprocess
    done = subprocess.run(
        [sys.executable, "-m", "sphinx", "-n", "-W", "--keep-going", "-q", "-d", tmp_path / "trees",
         "-b", "html", DOCS, tmp_path / "html"], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "html" / "index.html").is_file()
    loads = re.compile(r'<(?:script|link|img)[^>]*(?:src|href)="(?:https?:)?//')
    pages = {path.name: path.read_text(encoding="utf-8") for path in tmp_path.glob("html/*.html")}
    assert not [name for name, text in pages.items() if loads.search(text)]
    assert pages["theory.html"].count("<math ") > 50
