"""Sources: every key that is cited stands in docs/bibliography.md, and every entry is cited."""

import re

from folders import ROOT
from offenders import listed

KEY = re.compile(r"[A-Z][A-Za-z]+\d{4}|Pham")


def cited() -> dict[str, str]:
    """Keys in square brackets, alone or before a place, and a file that cites each."""
    found = {}
    files = [p for folder in ("spatial_pin", "tests", "scripts") for p in (ROOT / folder).rglob("*")
             if p.suffix in (".py", ".c", ".h")]
    for path in files:
        for group in re.findall(r"\[([A-Z][^\[\]]*)\]", path.read_text(encoding="utf-8")):
            for part in re.split(r"[;,]\s*", group):
                if KEY.fullmatch(part.strip()):
                    found[part.strip()] = str(path.relative_to(ROOT))
    return found


def entries() -> list[str]:
    text = (ROOT / "docs" / "bibliography.md").read_text(encoding="utf-8")
    return re.findall(r"^- \*\*\[(\w+)\]\*\*", text, flags=re.MULTILINE)


def test_every_source_that_is_cited_is_entries():
    missing = {key: path for key, path in cited().items() if key not in entries()}
    assert not missing, listed(missing)


def test_every_source_that_is_listed_is_cited_once_in_alphabetical_order():
    assert entries() == sorted(set(entries()), key=str.casefold)
    assert not set(entries()) - set(cited())
