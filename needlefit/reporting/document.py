"""Compile blocks of text, tables and figures to one PDF (typst) and one HTML page; equal blocks give equal
bytes.
"""

import base64
import json
import re
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal
from urllib.parse import quote

import jinja2
import typst
from markupsafe import Markup, escape

from needlefit.reporting import needle_page
from needlefit.reporting.fonts import compile_sheet, open_fonts, spell
from needlefit.reporting.needle_page import PageData
from needlefit.reporting.number_format import bind_numbers
from needlefit.reporting.table import TableLayout

Block = dict[str, Any]
Words = str | list[dict[str, str]]
"""The text of a paragraph: one string, or runs: `text`, `style` ("", "em", "strong", "code"), `target`."""


@dataclass(frozen=True)
class Document:
    """The contents of a report, in order."""

    title: str
    subtitle: str
    origin_mark: str  # at the foot of every page: that data were not measured; else empty
    # Made by `heading`, `subheading`, `verdict`, `text`, `note`, `bullets`, `warning`, `table` and `figure`
    blocks: tuple[Block, ...]
    # The needles that the HTML page computes
    explorer: PageData | None = None


def heading(words: str) -> Block:
    return {"kind": "heading", "text": words}


def subheading(words: str, target: str = "") -> Block:
    """Return the heading of a part of a section; links lead to its `target`."""
    return {"kind": "subheading", "text": words, "target": target}


def verdict(words: Words, status: Literal["none", "pass", "warn", "fail"]) -> Block:
    """Return the answer of a run, its first sentence in bold type, marked by its status."""
    if isinstance(words, str):
        head, stop, rest = words.replace("`", "").partition(". ")
        words = [{"text": f"{head}{stop}", "style": "strong", "target": ""}]
        words += [{"text": rest, "style": "", "target": ""}] if rest else []
    return {"kind": "verdict", "text": words, "status": status}


def origin(words: str) -> Block:
    """Return what must be known of the data before any number."""
    return {"kind": "origin", "text": words}


def text(words: Words) -> Block:
    return {"kind": "text", "text": _prose_block(words)}


def note(words: Words) -> Block:
    """Return a paragraph in less prominent type."""
    return {"kind": "note", "text": _prose_block(words)}


def paragraph(head: str, words: str, command: str = "") -> Block:
    """Return a paragraph that begins with a few words in bold type, and may end with a command."""
    parts = [(head, "strong"), (f" {words}", ""), *([(" ", ""), (command, "code")] if command else [])]
    return text([{"text": part, "style": style, "target": ""} for part, style in parts])


def page_break() -> Block:
    """Return the end of the first page; a page that scrolls has none."""
    return {"kind": "page_break"}


def bullets(items: Sequence[Words]) -> Block:
    return {"kind": "list", "items": [_prose_block(words) for words in items]}


def warning(words: Words, link: tuple[str, str] = ("", "")) -> Block:
    """Return a warning: a paragraph in prominent type; `link` is the target and the text of its link."""
    return {"kind": "warning", "text": _prose_block(words), "target": link[0], "link": link[1]}


def _prose_block(words: Words) -> Words:
    """Return text without backticks, which mark names in Markdown; a page would print them."""
    return words.replace("`", "") if isinstance(words, str) else words


def table(display: TableLayout) -> Block:
    return {"kind": "table", **asdict(display)}


# largest width (points) of a figure of which two stand side by side: one column of a paper, 3.5 in
MAX_HALF_WIDTH_PT = 254.0
_MEDIA_BOX = re.compile(rb"/MediaBox\s*\[\s*0\s+0\s+([0-9.]+)")


def figure(path: Path, caption: str) -> Block:
    """Return a figure: the PDF that will be at `path`, in its own size."""
    return {"kind": "figure", "path": path, "caption": caption}


def is_half_width(figure: Path) -> bool:
    """Return whether a PDF is at most half as wide as a page: two of them stand side by side."""
    width = _MEDIA_BOX.search(figure.read_bytes())
    return width is not None and float(width[1]) <= MAX_HALF_WIDTH_PT


def compile_pdf(document: Document) -> bytes:
    blocks, pictures = list(_number_blocks(document)), dict[str, Path]()
    for block in blocks:
        if "path" in block:
            block["file"] = f"{block['id']}.pdf"
            pictures[block["file"]] = block.pop("path")
    head = {key: _bind_words(getattr(document, key)) for key in ("title", "subtitle", "origin_mark")}
    payload = head | {"version": find_version(), "blocks": blocks}
    return compile_template("report.typ", payload, pictures)


def _bind_words(value: Any) -> Any:  # noqa: ANN401 - text, runs of text, or what a block holds of them
    """Return text in which numbers are not broken from their units; commands stay as they are typed."""
    if isinstance(value, str):
        return bind_numbers(value)
    if isinstance(value, list | tuple):
        return [_bind_words(part) for part in value]
    if isinstance(value, dict) and value.get("style") != "code":
        return {key: _bind_words(part) if key in _WORDS_KEYS else part for key, part in value.items()}
    return value


_WORDS_KEYS = ("text", "items", "caption", "notes", "rows", "columns", "label", "unit")
"""Keys of blocks, and of what they hold, whose values are printed."""


def _number_blocks(document: Document) -> Iterator[Block]:
    """Yield copies of the blocks, with a place to link to; empty tables are left out."""
    counts = {"heading": 0, "figure": 0, "table": 0}
    for block in map(_bind_words, document.blocks):
        kind = block["kind"]
        if kind == "table" and not block["rows"]:
            continue
        if kind not in counts:
            yield {**block}
            continue
        if kind == "table" and not block["caption"]:  # it has no number, and no link leads to it
            yield {**block, "number": 0, "id": block["name"]}
            continue
        counts[kind] += 1
        more = {"half": is_half_width(block["path"])} if kind == "figure" else {}
        yield {**block, **more, "number": counts[kind], "id": f"{kind}-{counts[kind]}"}


def compile_template(
    template: str, payload: Block, pictures: Mapping[str, Path] = MappingProxyType({})
) -> bytes:
    """Return the PDF of a template with its data and pictures; the keys are the names used in the template.

    Fonts are typst's own and those of `fonts`: system fonts differ between machines.
    """
    words = spell(json.dumps(payload, ensure_ascii=False))
    with tempfile.TemporaryDirectory(prefix="needlefit-") as name:
        folder = Path(name)
        page = folder / template
        page.write_bytes((files("needlefit.reporting") / "templates" / template).read_bytes())
        (folder / "data.json").write_text(words, encoding="utf-8")
        for path, picture in pictures.items():
            (folder / path).write_bytes(picture.read_bytes())
        pdf = typst.compile(str(page), root=name, font_paths=open_fonts(words), ignore_system_fonts=True)
    assert isinstance(pdf, bytes)
    return pdf


def find_version() -> str:
    """Return needlefit's version; empty if it runs from a source tree that is not installed."""
    try:
        return version("needlefit")
    except PackageNotFoundError:
        return ""


_LABEL_TEMPLATE = """#set document(date: none)
#set page(width: auto, height: auto, margin: 0pt)
#set text(font: "Libertinus Serif", size: 8pt, fill: rgb("#B23A00"))
#stack(spacing: 2pt, pad(top: 2pt, left: 3pt)[{mark}], image("{name}"))
"""


def label_figure(path: Path, origin_mark: str) -> bytes:
    """Return a figure with the mark of its data above it, as PDF."""
    return compile_sheet(path.read_bytes(), ".pdf", _LABEL_TEMPLATE.replace("{mark}", origin_mark))


SVG_SCALE = 1.7
"""Pixels of the page per point of a figure: the text of a figure is sized for paper, that of the page is
larger."""

_EXPONENT_PATTERN = re.compile(r"\^(-?\d+(?:\.\d+)?)")
_INNER_SVG_PATTERN = re.compile(rb'xlink:href="(data:image/svg\+xml;base64,[^"]+)"')
_SVG_WIDTH_PATTERN = re.compile(rb'<svg [^>]*width="([0-9.]+)pt"')
_SVG_PATH_PATTERN = re.compile(rb' d="[^"]*"')
_SVG_DIGITS_PATTERN = re.compile(rb"(?<=\.\d\d)\d+")
_SVG_INDENT_PATTERN = re.compile(rb"\n\s+")


def compile_html(document: Document) -> bytes:
    """Return a report as one HTML page; equal documents give equal bytes."""
    return _render_html("report.html", document).encode("utf-8")


# number of tables of a page's part for a notebook that are open; the tables after these unfold
OPEN_TABLES = 3


def format_html_part(document: Document) -> str:
    """Return a report as a part of an HTML page, without links and without the style of our pages."""
    return _render_html("part.html", document)


def _render_html(template: str, document: Document) -> str:
    blocks = list(_number_blocks(document))
    for block in blocks:
        if "path" in block:
            block |= _encode_figure(block.pop("path").read_bytes())
    ends = [number for number, block in enumerate(blocks) if block["kind"] == "page_break"]
    first, rest = (blocks[: ends[0]], blocks[ends[0] + 1 :]) if ends else ([], blocks)
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("needlefit.reporting"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["powers"] = _raise_exponents
    return environment.get_template(template).render(
        title=document.title,
        subtitle=_bind_words(document.subtitle),
        origin_mark=document.origin_mark,
        version=find_version(),
        first=first,
        blocks=rest,
        sections=[block for block in blocks if block["kind"] == "heading"],
        page=_compose_page(document.explorer),
        open_tables=OPEN_TABLES,
    )


def _encode_figure(pdf: bytes) -> Block:
    """Return a figure as the address of an SVG that holds it, and how wide it is shown, px.

    Its paths are to 0.01 pt: a third of it is further digits. As base64 it would be a third larger.
    """
    svg = compile_sheet(pdf, ".pdf", form="svg")
    inside, width = _INNER_SVG_PATTERN.search(svg), _SVG_WIDTH_PATTERN.search(svg)
    assert inside is not None and width is not None, "typst sets a PDF as an SVG within its own"
    data = inside[1].partition(b",")[2]
    drawing = _SVG_PATH_PATTERN.sub(
        lambda path: _SVG_DIGITS_PATTERN.sub(b"", path[0]), base64.b64decode(data)
    )
    small = _SVG_INDENT_PATTERN.sub(b"\n", drawing).replace(b"'", b"&#39;").replace(b'"', b"'")
    picture = Markup("data:image/svg+xml," + quote(small, safe=" =:/;,()'+-\n"))  # noqa: S704 - no double quote is left
    return {"picture": picture, "width": round(SVG_SCALE * float(width[1]))}


def _raise_exponents(words: str) -> Markup:
    """Return text with powers raised: mu * b^1.9."""
    raised = _EXPONENT_PATTERN.sub(
        lambda match: f"<sup>{match[1].replace('-', '−')}</sup>", str(escape(words))
    )
    return Markup(raised)  # noqa: S704 - escaped first; the pattern adds only the tags


def _compose_page(data: PageData | None) -> dict[str, Any]:
    """Return policy, and of a page that computes needles its part, style and data.

    Nothing in them can end their elements.
    """
    parts = {"script": "", "style": "", "data": ""}
    if data is not None:
        parts |= {
            "script": needle_page.read_package_file(needle_page.SCRIPT),
            "stage": needle_page.read_package_file(needle_page.STAGE),
            "style": needle_page.read_style(),
            "kernel": needle_page.read_kernel(),
            "data": data.pack(),
        }
    policy = needle_page.write_policy([parts["script"]] if data else [])
    return {name: Markup(part) for name, part in (parts | {"policy": policy}).items()}  # noqa: S704
