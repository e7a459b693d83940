"""Blocks of text, tables and figures -> one PDF, by typst; no date, no path, the same bytes every time."""

import json
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from itertools import count
from pathlib import Path
from types import MappingProxyType
from typing import Any

import typst

from needlefit.project.result_warnings import read_warnings
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
        Made by `heading`, `subheading`, `text`, `note`, `bullets`, `warning`, `empty`, `table` and `figure`.
    """

    title: str
    subtitle: str
    synthetic: bool
    blocks: tuple[Block, ...]


def heading(words: str) -> Block:
    """Return a section's heading."""
    return {"kind": "heading", "text": words}


def subheading(words: str) -> Block:
    """Return the heading of a part of a section."""
    return {"kind": "subheading", "text": words}


def text(words: str) -> Block:
    """Return a paragraph."""
    return {"kind": "text", "text": _prose(words)}


def note(words: str) -> Block:
    """Return a paragraph that stands back."""
    return {"kind": "note", "text": _prose(words)}


def bullets(items: Sequence[str]) -> Block:
    """Return a list."""
    return {"kind": "list", "items": [_prose(words) for words in items]}


def warning(words: str) -> Block:
    """Return a paragraph that cannot be overlooked."""
    return {"kind": "warning", "text": _prose(words)}


def warnings_in(run: Mapping[str, Any], name: str) -> list[Block]:
    """Return a block for each warning that the run called `name` keeps."""
    return [warning(f"WARNING: {name}: {one}.") for one in read_warnings(run)]


def empty(words: str) -> Block:
    """Return an empty box, and in words what is missing in it."""
    return {"kind": "empty", "text": _prose(words)}


def _prose(words: str) -> str:
    """Return words without the backticks by which a terminal and Markdown tell names: a page prints them."""
    return words.replace("`", "")


def table(display: Display, synthetic: bool) -> Block:
    """Return a table."""
    return {"kind": "table", "synthetic": synthetic, **asdict(display)}


def figure(path: Path, caption: str, synthetic: bool) -> Block:
    """Return a figure: the PDF at `path`, set at its own size."""
    return {"kind": "figure", "path": path, "caption": caption, "synthetic": synthetic}


def compile_pdf(document: Document) -> bytes:
    """Return the PDF of a report."""
    pictures = [block["path"] for block in document.blocks if "path" in block]
    numbered = {f"figure-{number}.pdf": path for number, path in enumerate(pictures, start=1)}
    return set_page("report.typ", _payload(document), numbered)


def set_page(template: str, payload: Block, pictures: Mapping[str, Path] = MappingProxyType({})) -> bytes:
    """Return the PDF that a template makes of its data and of pictures, which it knows by these names.

    Only fonts of typst's own are used.
    """
    with tempfile.TemporaryDirectory(prefix="needlefit-") as name:
        folder = Path(name)
        page = folder / template
        page.write_bytes((files("needlefit.reporting") / "templates" / template).read_bytes())
        (folder / "data.json").write_text(json.dumps(payload), encoding="utf-8")
        for known, picture in pictures.items():
            (folder / known).write_bytes(picture.read_bytes())
        pdf = typst.compile(str(page), root=name, ignore_system_fonts=True)
    assert isinstance(pdf, bytes)
    return pdf


def by_name(pictures: Sequence[Path]) -> dict[str, Path]:
    """Return pictures as a template knows them that calls them by the names of their files."""
    return {picture.name: picture for picture in pictures}


def _payload(document: Document) -> Block:
    """Return what the template reads, figures by their number; a table without rows is left out."""
    number = count(1)
    blocks = [
        {key: value for key, value in block.items() if key != "path"}
        | ({"file": f"figure-{next(number)}.pdf"} if "path" in block else {})
        for block in document.blocks
        if block["kind"] != "table" or block["rows"]
    ]
    head = {"title": document.title, "subtitle": document.subtitle, "synthetic": document.synthetic}
    return head | {"version": version_text(), "blocks": blocks}


def version_text() -> str:
    """Return needlefit's version; empty where it is run from a source tree that is not installed."""
    try:
        return version("needlefit")
    except PackageNotFoundError:
        return ""
