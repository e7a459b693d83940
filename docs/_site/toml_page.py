"""The reference of all TOML files: every key of every file that a user may write."""

import re
from collections.abc import Iterator

from pages import keep
from sphinx.application import Sphinx

from needlefit.project.locate import shipped_folder
from needlefit.studies.toml_reference import (
    FileKind,
    KeyDescription,
    TableDescription,
    describe_files,
    list_files,
)

PAGE = "reference/toml.md"
MAX_EXAMPLE_LINES = 45
"""Longer files are not shown whole."""

OPENING = """\
# TOML reference

Every key of every file that you may write. `needlefit explain study.toml` prints those of a study, and so on.
The examples are from files that load.

- Every file begins with `schema`, the version of its layout. Unknown keys are errors.
- A key's ending is its unit: `_mm`, `_deg`, `_pa`, `_gpa`, `_hu`.
- Names of datasets, tissue models, recipes and scenes are looked up in your working folder, then in the
  shipped project. A name with a `/`, or that ends in `.toml`, is a path; in a study or fit it is relative
  to its file.
- `needlefit simulate --set layers.1.mu_pa=3e5` replaces one value of a scene.
"""


def setup(app: Sphinx) -> dict[str, bool]:
    """Write the page before any is read."""
    app.connect("builder-inited", lambda app: keep(app.srcdir / PAGE, "\n".join(_page()) + "\n"))
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _page() -> Iterator[str]:
    files = list_files()
    yield OPENING
    yield from (f"- [{one.title}](#{_anchor(one.title)})" for one in files)
    for file, tables in describe_files(files):
        for number, table in enumerate(tables):
            yield f"\n{'###' if number else '##'} {table.title}\n\n{_escape(table.summary)}\n"
            yield from () if number else _show_example(file)
            yield from _show_keys(table)


def _show_example(file: FileKind) -> Iterator[str]:
    text = (shipped_folder() / file.examples[0]).read_text(encoding="utf-8")
    if len(text.splitlines()) <= MAX_EXAMPLE_LINES:
        yield f"```toml\n{text}```\n"


def _show_keys(table: TableDescription) -> Iterator[str]:
    yield "| key | value | meaning | example |\n|---|---|---|---|"
    yield from (_show_key(one) for one in table.keys)


def _show_key(one: KeyDescription) -> str:
    place = one.described_in
    more = f" Keys: [{_escape(place)}](#{_anchor(place)})." if place else ""
    example = "`" + one.example.replace("|", r"\|") + "`" if one.example else ""
    return f"| `{one.key}` | {_escape(one.value)} | {_escape(one.meaning)}{more} | {example} |"


def _anchor(title: str) -> str:
    return re.sub(r"[^\w -]", "", title).lower().replace(" ", "-")


def _escape(text: str) -> str:
    """Return text as a cell; within backticks only bars need an escape."""
    parts = text.replace("|", r"\|").split("`")
    return "`".join(part if n % 2 else part.replace("<", r"\<") for n, part in enumerate(parts))
