"""Set a drawing on a page of its own size (typst); equal drawings give equal bytes."""

import tempfile
from pathlib import Path
from typing import Literal

import typst

from needlefit.reporting.fonts import open_fonts

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
