"""The same report as one HTML file that needs no network: figures inside it, light or dark, for any width."""

import base64
import re
import tempfile
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path

import jinja2
import typst
from markupsafe import Markup, escape

from needlefit.reporting.document import Block, Document, version_text

ENLARGED = 1.7
"""px of the page per pt of a figure: its letters are made for paper, and stand beside larger ones here."""

_POWER = re.compile(r"\^(-?\d+(?:\.\d+)?)")
_INSIDE = re.compile(rb'xlink:href="(data:image/svg\+xml;base64,[^"]+)"')
_WIDTH = re.compile(rb'<svg [^>]*width="([0-9.]+)pt"')
_PATH = re.compile(rb' d="[^"]*"')
_DIGITS = re.compile(rb"(\.\d\d)\d+")
_INDENT = re.compile(rb"\n\s+")
_SHEET = '#set page(width: auto, height: auto, margin: 0pt)\n#image("figure.pdf")\n'


def compile_html(document: Document) -> bytes:
    """Return the page of a report; equal documents give equal bytes."""
    blocks = list(_numbered(document))
    template = (files("needlefit.reporting") / "templates" / "report.html").read_text(encoding="utf-8")
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["powers"] = _powers
    page = environment.from_string(template).render(
        title=document.title,
        subtitle=document.subtitle,
        synthetic=document.synthetic,
        version=version_text(),
        blocks=blocks,
        sections=[block for block in blocks if block["kind"] == "heading"],
        mark=_mark,
    )
    return page.encode("utf-8")


def _numbered(document: Document) -> Iterator[Block]:
    """Yield the blocks with a place to link to, figures with their picture; empty tables are left out."""
    counts = {"heading": 0, "figure": 0, "table": 0}
    for block in document.blocks:
        kind = block["kind"]
        if kind == "table" and not block["rows"]:
            continue
        if kind not in counts:
            yield block
            continue
        counts[kind] += 1
        numbered = {key: value for key, value in block.items() if key != "path"}
        numbered |= {"number": counts[kind], "id": f"{kind}-{counts[kind]}"}
        yield numbered | (_picture(block["path"].read_bytes()) if kind == "figure" else {})


def _picture(pdf: bytes) -> Block:
    """Return a figure as the address of an SVG that holds it, and how wide it is shown, px."""
    with tempfile.TemporaryDirectory(prefix="needlefit-") as name:
        sheet = Path(name) / "sheet.typ"
        sheet.write_text(_SHEET, encoding="utf-8")
        (Path(name) / "figure.pdf").write_bytes(pdf)
        svg = typst.compile(str(sheet), root=name, format="svg", ignore_system_fonts=True)
    assert isinstance(svg, bytes)
    inside, width = _INSIDE.search(svg), _WIDTH.search(svg)
    assert inside is not None and width is not None, "typst sets a PDF as an SVG within its own"
    return {"picture": _smaller(inside[1]), "width": round(ENLARGED * float(width[1]))}


def _smaller(address: bytes) -> str:
    """Return the address of an SVG with its paths to 0.01 pt: a third of it is further digits."""
    kind, _, data = address.partition(b",")
    drawing = _PATH.sub(lambda path: _DIGITS.sub(rb"\1", path[0]), base64.b64decode(data))
    small = base64.b64encode(_INDENT.sub(b"\n", drawing))
    return f"{kind.decode('ascii')},{small.decode('ascii')}"


def _powers(words: str) -> Markup:
    """Return text with powers raised: mu * b^1.9."""
    raised = _POWER.sub(lambda found: f"<sup>{found[1].replace('-', '−')}</sup>", str(escape(words)))
    return Markup(raised)  # noqa: S704 - escaped first; the pattern adds only the tags


def _mark(block: Block) -> Markup:
    return Markup('<span class="mark">Synthetic data. </span>') if block["synthetic"] else Markup()
