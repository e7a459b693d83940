"""Blocks of text, tables and figures -> one PDF, by typst; no date, no path, the same bytes every time."""

import json
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from pathlib import Path
from typing import Any

import typst

from needlefit.reporting.display import Display

Block = dict[str, Any]


@dataclass(frozen=True)
class Document:
    """What a report says, in order.

    Attributes
    ----------
    title, subtitle : str
    synthetic : bool
        Whether every page is headed SYNTHETIC DATA.
    blocks : tuple
        Made by `heading`, `text`, `bullets`, `warning`, `table` and `figure`.
    """

    title: str
    subtitle: str
    synthetic: bool
    blocks: tuple[Block, ...]


def heading(words: str) -> Block:
    """Return a section's heading."""
    return {"kind": "heading", "text": words}


def text(words: str) -> Block:
    """Return a paragraph."""
    return {"kind": "text", "text": words}


def bullets(items: Sequence[str]) -> Block:
    """Return a list."""
    return {"kind": "list", "items": list(items)}


def warning(words: str) -> Block:
    """Return a paragraph that cannot be overlooked."""
    return {"kind": "warning", "text": words}


def table(display: Display, synthetic: bool) -> Block:
    """Return a table."""
    return {"kind": "table", "synthetic": synthetic, **asdict(display)}


def figure(path: Path, caption: str, synthetic: bool) -> Block:
    """Return a figure: the PDF at `path`, set at its own size."""
    return {"kind": "figure", "file": path.name, "path": path, "caption": caption, "synthetic": synthetic}


def compile_pdf(document: Document) -> bytes:
    """Return the PDF; only fonts that come with typst are used."""
    with tempfile.TemporaryDirectory(prefix="needlefit-") as name:
        folder = Path(name)
        template = files("needlefit.reporting") / "templates" / "report.typ"
        (folder / "report.typ").write_bytes(template.read_bytes())
        (folder / "data.json").write_text(json.dumps(_payload(document, folder)), encoding="utf-8")
        pdf = typst.compile(str(folder / "report.typ"), root=name, ignore_system_fonts=True)
    assert isinstance(pdf, bytes)
    return pdf


def _payload(document: Document, folder: Path) -> Block:
    """Return what the template reads; figures are put beside it, and a table without rows is left out."""
    blocks = []
    for block in document.blocks:
        if block["kind"] == "table" and not block["rows"]:
            continue
        if "path" in block:
            (folder / block["file"]).write_bytes(block["path"].read_bytes())
        blocks.append({key: value for key, value in block.items() if key != "path"})
    head = {"title": document.title, "subtitle": document.subtitle, "synthetic": document.synthetic}
    return head | {"version": _version(), "blocks": blocks}


def _version() -> str:
    try:
        return version("needlefit")
    except PackageNotFoundError:  # run from a source tree that is not installed
        return ""
