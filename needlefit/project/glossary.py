"""The terms of the glossary, a page that ships with the package."""

import re
from dataclasses import dataclass
from functools import cache

from needlefit.project.input_files import read_text
from needlefit.project.locate import shipped_folder

GLOSSARY_PAGE = "docs/glossary.md"

_ROW = re.compile(
    r"^\| (?P<name>[^|]+) \| (?P<symbol>[^|]*) \| (?P<unit>[^|]*) \| (?P<meaning>[^|]+) \| \[", re.MULTILINE
)


@dataclass(frozen=True)
class Term:
    """A term: its name, symbol and unit (empty without one), and what it means."""

    name: str
    symbol: str
    unit: str
    meaning: str


@cache
def read_terms() -> dict[str, Term]:
    """Return the terms by name."""
    page = read_text(shipped_folder() / GLOSSARY_PAGE)
    rows = [{key: text.strip() for key, text in one.groupdict().items()} for one in _ROW.finditer(page)]
    return {row["name"]: Term(**row) for row in rows}
