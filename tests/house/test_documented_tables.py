"""What the pages tell of the package's own folders and tables is so."""

import re

from folders import ROOT
from offenders import listed

from spatial_pin.formats.checked_tables import BELONGS
from spatial_pin.mechanism.pairs import JOINT_TYPES, closure_types

DOCS = ROOT / "docs"
PACKAGE = ROOT / "spatial_pin"


# ---------------------------------------------------------------- where things are


def test_every_room_of_the_package_is_in_the_table_of_the_architecture():
    rooms = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    text = (DOCS / "contributing.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (`\w+`(?:, `\w+`)*) \|", text, flags=re.MULTILINE)
    assert rooms <= {name.strip("`") for row in rows for name in row.split(", ")}


def test_folders_and_files_that_the_page_for_contributors_names_exist():
    """Those of the package are named from its folder on, others from the top."""
    text = (DOCS / "contributing.md").read_text(encoding="utf-8")
    named = {name.rstrip("/") for name in re.findall(r"`(?:\./)?([\w.]+(?:/[\w.]+)*/?)`", text)
             if "/" in name and "PAGE" not in name and "NAME" not in name}
    assert len(named) > 15
    wrong = [name for name in named
             if not any((folder / name).exists() for folder in (ROOT, PACKAGE))]
    assert not wrong, listed(wrong)


def test_every_folder_of_the_kernel_is_described():
    text = (DOCS / "contributing.md").read_text(encoding="utf-8")
    folders = {path.parent.name for path in PACKAGE.glob("kernel/*/*.c")}
    assert len(folders) > 5 and not {name for name in folders if f"`kernel/{name}`" not in text}


def test_every_script_is_in_the_table_of_what_scripts_are_for():
    text = (DOCS / "contributing.md").read_text(encoding="utf-8")
    rows = text.partition("## What the scripts are for")[2].partition("\n## ")[0]
    told = {name for row in re.findall(r"^\| (`.*?`) \|", rows, flags=re.MULTILINE)
            for name in re.findall(r"`([\w.]+)`", row)}
    there = {path.name for path in (ROOT / "scripts").iterdir() if path.name != "__pycache__"}
    assert told == there, listed(told ^ there)


# ---------------------------------------------------------------- the mechanism file


def sections(text):
    """The tables of keys of docs/mechanism_file.md, by what `BELONGS` calls their place."""
    found = {}
    for part in re.split(r"^## ", text, flags=re.MULTILINE)[1:]:
        place = part.split("\n", 1)[0]
        found[place] = re.findall(r"^\| `(\w+)` \|", part, flags=re.MULTILINE)
    return found


def test_every_key_of_a_mechanism_file_has_a_table_where_it_belongs():
    found = sections((DOCS / "mechanism_file.md").read_text(encoding="utf-8"))
    for place, keys in BELONGS.items():
        title = f"`{place[3:]}`" if place.startswith("in ") else "Top of the file"
        assert sorted(found[title]) == sorted(keys), title


def test_every_type_of_joint_and_closure_is_reported():
    found = sections((DOCS / "mechanism_file.md").read_text(encoding="utf-8"))
    assert sorted(found["Types of closures"]) == sorted(closure_types())
    assert sorted(found["Types of joints"]) == sorted(JOINT_TYPES)
