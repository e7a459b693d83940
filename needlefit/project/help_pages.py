"""Texts that ship with the package: what each warning means, and terms."""

import posixpath
import re
from dataclasses import dataclass
from functools import cache

from needlefit.project.input_files import read_text
from needlefit.project.locate import shipped_folder

TROUBLESHOOTING_PAGE = "docs/troubleshooting.md"  # page with a section for every kind of warning

_SECTION_PATTERN = re.compile(
    r"^\((?P<key>[\w-]+)\)=\n#+ (?P<title>.+)\n(?P<body>(?:(?!\([\w-]+\)=|#).*\n)*)", re.MULTILINE
)
_LINK_PATTERN = re.compile(r"\[([^\]]+)\]\(([^)#]*)(?:#[^)]*)?\)")


@dataclass(frozen=True)
class Topic:
    """What is printed about a key, such as "parameter-at-bound": a title, then paragraphs and items of lists.

    An item of a list begins with "- ".
    """

    key: str
    title: str
    paragraphs: tuple[str, ...] = ()
    symbol: str = ""  # another key: TE of the tip error

    @property
    def names(self) -> frozenset[str]:
        """What it is found by: the key, the symbol, the title; of a list with commas each member."""
        listed = (self.key, self.symbol, self.title)
        return frozenset(name for name_list in listed for name in (name_list, *name_list.split(", ")) if name)


@cache
def read_sections() -> dict[str, Topic]:
    page = read_text(shipped_folder() / TROUBLESHOOTING_PAGE)

    def name_page(link: re.Match[str]) -> str:  # in place of a link
        path = posixpath.normpath(posixpath.join(posixpath.dirname(TROUBLESHOOTING_PAGE), link[2]))
        return f"{link[1]} ({path})" if link[2] else link[1]

    sections = {}
    for match in _SECTION_PATTERN.finditer(page):
        parts = re.split(r"\n\s*\n|\n(?=- )", match["body"].strip())
        plain = (_LINK_PATTERN.sub(name_page, " ".join(part.split())).replace("**", "") for part in parts)
        sections[match["key"]] = Topic(match["key"], match["title"], tuple(plain))
    return sections


# --- the glossary ---------------------------------------------------------------------------------------

GLOSSARY_PAGE = "docs/glossary.md"

# - **[name](page)** symbol [unit]: meaning, which may go on in indented lines
_TERM = re.compile(
    r"^- \*\*\[?(?P<name>[^]*]+)(?:\]\([^)]+\))?\*\*(?P<symbol>[^[:]*)(?:\[(?P<unit>[^]]+)\])?:"
    r"(?P<meaning>.+(?:\n  .+)*)",
    re.MULTILINE,
)


@cache
def read_terms() -> list[Topic]:
    terms = []
    for match in _TERM.finditer(read_text(shipped_folder() / GLOSSARY_PAGE)):
        name, symbol, unit, meaning = (
            " ".join((match[part] or "").split()) for part in ("name", "symbol", "unit", "meaning")
        )
        terms.append(Topic(name, ", ".join(filter(None, (name, symbol, unit))), (meaning,), symbol))
    return terms
