"""Set a drawing on a page of its own size (typst); equal drawings give equal bytes."""

import tempfile
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

import typst

PLAIN_SHEET = (
    '#set document(date: none)\n#set page(width: auto, height: auto, margin: 0pt)\n#image("{name}")\n'
)
"""The drawing alone."""


def compile_sheet(
    drawing: bytes,
    suffix: Literal[".pdf", ".svg"],
    template: str = PLAIN_SHEET,
    form: Literal["pdf", "svg"] = "pdf",
) -> bytes:
    """Return a page that shows a drawing where `template` says {name}, as PDF or SVG.

    Fonts are typst's own and those that ship with matplotlib: system fonts differ between machines.
    """
    with tempfile.TemporaryDirectory(prefix="needlefit-") as folder:
        name, sheet = f"figure{suffix}", Path(folder, "sheet.typ")
        sheet.write_text(template.replace("{name}", name), encoding="utf-8")
        Path(folder, name).write_bytes(drawing)
        found = typst.compile(
            str(sheet), root=folder, format=form, font_paths=_find_fonts(), ignore_system_fonts=True
        )
    assert isinstance(found, bytes)
    return found


@cache
def _find_fonts() -> typst.Fonts:
    matplotlib = find_spec("matplotlib")  # importing it takes its time, and nothing of it is needed
    assert matplotlib is not None and matplotlib.submodule_search_locations, "matplotlib is a dependency"
    folder = Path(matplotlib.submodule_search_locations[0], "mpl-data", "fonts", "ttf")
    return typst.Fonts(include_system_fonts=False, font_paths=[str(folder)])
