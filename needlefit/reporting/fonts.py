"""Fonts of figures and pages: those that ship with matplotlib and typst, which are the same on every machine.

Letters that these lack, as Chinese ones in a name, are drawn in an installed font. A letter that no font has
is written as its number in Unicode, such as [U+9488], so that two names still differ.
"""

import tempfile
import unicodedata
from collections.abc import Collection
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

import typst

FAMILY = "DejaVu Sans"  # family of fonts of figures
_CATEGORIES = "LMN"  # categories of Unicode: letters, their marks, digits; signs are the package's own
# first letter that the font may lack: Latin, Greek, Cyrillic and Armenian letters stand before
_FIRST_LACKING = "\u0590"


def find_lacking(text: str) -> frozenset[str]:
    """Return the letters of a text that the fonts that ship lack."""
    letters = {
        letter
        for letter in set(text)
        if letter >= _FIRST_LACKING and unicodedata.category(letter)[0] in _CATEGORIES
    }
    bundled = _read_letters(_bundled_folder() / f"{FAMILY.replace(' ', '')}.ttf") if letters else ()
    return frozenset(letter for letter in letters if ord(letter) not in bundled)


@cache
def find_fonts(letters: frozenset[str]) -> dict[Path, str]:
    """Return installed fonts that together have these letters as far as any has, with their families."""
    if not letters:
        return {}
    from matplotlib.font_manager import fontManager  # late: it looks for all fonts

    fonts, left = dict[Path, str](), {*map(ord, letters)}
    upright = (
        font for font in fontManager.ttflist if font.style == "normal" and font.weight in (400, "normal")
    )
    for font in sorted(upright, key=lambda font: (font.name, font.fname)):
        path = Path(font.fname)
        if left and path.parent != _bundled_folder() and (covered := left & _read_letters(path)):
            fonts[path] = font.name
            left -= covered
    return fonts


def spell(text: str) -> str:
    """Return a text in which letters that no font has are written as their numbers in Unicode."""
    lacking = find_lacking(text)
    drawable = frozenset[int]().union(*map(_read_letters, find_fonts(lacking)))
    return text.translate(
        {ord(letter): f"[U+{ord(letter):04X}]" for letter in lacking if ord(letter) not in drawable}
    )


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


PLAIN_SHEET = (
    '#set document(date: none)\n#set page(width: auto, height: auto, margin: 0pt)\n#image("{name}")\n'
)
"""Typst template of a sheet with the drawing alone."""


def compile_sheet(
    drawing: bytes,
    suffix: Literal[".pdf", ".svg"],
    template: str = PLAIN_SHEET,
    form: Literal["pdf", "svg"] = "pdf",
) -> bytes:
    """Return a page that shows a drawing where `template` says {name}, as PDF or SVG.

    Fonts are those of `fonts`: system fonts differ between machines.
    """
    fonts = open_fonts(drawing.decode() if suffix == ".svg" else "")
    with tempfile.TemporaryDirectory(prefix="needlefit-") as folder:
        name, sheet = f"figure{suffix}", Path(folder, "sheet.typ")
        sheet.write_text(template.replace("{name}", name), encoding="utf-8")
        Path(folder, name).write_bytes(drawing)
        compiled = typst.compile(
            str(sheet), root=folder, format=form, font_paths=fonts, ignore_system_fonts=True
        )
    assert isinstance(compiled, bytes)
    return compiled
