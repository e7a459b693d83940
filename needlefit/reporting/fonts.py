"""Fonts of figures and pages: those that ship with matplotlib and typst, which are the same on every machine.

Letters that these lack, as Chinese ones in a name, are drawn in an installed font. A letter that no font has
is written as its number in Unicode, such as [U+9488], so that two names still differ.
"""

import unicodedata
from collections.abc import Collection
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import typst

FAMILY = "DejaVu Sans"  # of figures
_CATEGORIES = "LMN"  # of Unicode: letters, their marks, digits; signs are the package's own
_FIRST_LACKING = "\u0590"  # Latin, Greek, Cyrillic and Armenian letters stand before


def find_lacking(text: str) -> frozenset[str]:
    """Return the letters of a text that the fonts that ship lack."""
    letters = {one for one in text if one >= _FIRST_LACKING and unicodedata.category(one)[0] in _CATEGORIES}
    known = _read_letters(_bundled_folder() / f"{FAMILY.replace(' ', '')}.ttf") if letters else ()
    return frozenset(one for one in letters if ord(one) not in known)


@cache
def find_fonts(letters: frozenset[str]) -> dict[Path, str]:
    """Return installed fonts that together have these letters as far as any has, with their families."""
    if not letters:
        return {}
    from matplotlib.font_manager import fontManager  # late: it looks for all fonts

    found, left = dict[Path, str](), {*map(ord, letters)}
    upright = (one for one in fontManager.ttflist if one.style == "normal" and one.weight in (400, "normal"))
    for one in sorted(upright, key=lambda one: (one.name, one.fname)):
        path = Path(one.fname)
        if left and path.parent != _bundled_folder() and (known := left & _read_letters(path)):
            found[path] = one.name
            left -= known
    return found


def spell(text: str) -> str:
    """Return a text in which letters that no font has are written as their numbers in Unicode."""
    lacking = find_lacking(text)
    known = frozenset[int]().union(*map(_read_letters, find_fonts(lacking)))
    return text.translate({ord(one): f"[U+{ord(one):04X}]" for one in lacking if ord(one) not in known})


def open_fonts(text: str) -> typst.Fonts:
    """Return the fonts that ship and the installed ones that a text needs."""
    return _open_folders(tuple(dict.fromkeys(path.parent for path in find_fonts(find_lacking(text)))))


@cache
def _open_folders(folders: Collection[Path]) -> typst.Fonts:
    return typst.Fonts(include_system_fonts=False, font_paths=[str(_bundled_folder()), *map(str, folders)])


@cache
def _bundled_folder() -> Path:
    matplotlib = find_spec("matplotlib")  # importing it takes its time, and nothing of it is needed
    assert matplotlib is not None and matplotlib.submodule_search_locations, "matplotlib is a dependency"
    return Path(matplotlib.submodule_search_locations[0], "mpl-data", "fonts", "ttf")


@cache
def _read_letters(font: Path) -> frozenset[int]:
    """Return the numbers of the characters that a font has."""
    from matplotlib.ft2font import FT2Font

    try:
        return frozenset(FT2Font(str(font)).get_charmap())
    except (OSError, RuntimeError):  # removed since, or broken
        return frozenset()
