"""The reference of all TOML files: every key of every file that a user may write.

The examples are from files that load: the shipped ones and those in `docs/examples/`.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from typing import Any

from pages import keep
from pydantic import BaseModel
from sphinx.application import Sphinx

from needlefit.project.locate import read_toml, shipped_folder
from needlefit.project.toml import dumps
from needlefit.project.toml_reference import (
    FileKind,
    KeyDescription,
    TableDescription,
    describe_files,
    find_owner,
    find_record,
    format_value,
    list_files,
)
from needlefit.studies.kind import list_records

PAGE = "reference/toml.md"
EXAMPLES = {
    "study": ("studies/study3.toml", "studies/stereo_insertions.toml", "studies/guided_tip.toml"),
    "fit": ("configs/fits/phantom1.toml",),
    "medium": ("configs/media/phantom2.toml",),
    "dataset": ("data/twin/dataset.toml", "data/twin_turned/dataset.toml", "data/thin_gel/dataset.toml"),
    "tracks_dataset": ("data/guided_tips/dataset.toml",),
    "scene": ("configs/scenes/phantom1.toml", "configs/scenes/figure1.toml"),
}
"""Shipped examples of kinds of file, the best first; further ones are `docs/examples/NAME*.toml`."""

Examples = Mapping[tuple[type[BaseModel], str], str]  #: an example of a key, by record and field
MAX_EXAMPLE_LINES = 45
"""Longer files are not shown whole."""

OPENING = """\
# TOML reference

Every key of every file that you may write. The examples are from files that load.

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
    files = list_files(list_records())
    elsewhere = dict(pair for one in reversed(files) for pair in collect_examples(one).items())
    yield OPENING
    yield from (f"- [{one.title}](#{_anchor(one.title)})" for one in files)
    for file, tables in describe_files(files):
        examples = {**elsewhere, **collect_examples(file)}
        for number, table in enumerate(tables):
            yield f"\n{'###' if number else '##'} {table.title}\n\n{_escape(table.summary)}\n"
            yield from () if number else _show_example(file)
            yield from _show_keys(table, examples)


def _show_example(file: FileKind) -> Iterator[str]:
    text = (shipped_folder() / list_examples(file)[0]).read_text(encoding="utf-8")
    if len(text.splitlines()) <= MAX_EXAMPLE_LINES:
        yield f"```toml\n{text}```\n"


def _show_keys(table: TableDescription, examples: Examples) -> Iterator[str]:
    yield "| key | value | meaning | example |\n|---|---|---|---|"
    yield from (_show_key(one, examples.get((one.owner, one.field), "")) for one in table.keys)


def _show_key(one: KeyDescription, text: str) -> str:
    place = one.described_in
    more = f" Keys: [{_escape(place)}](#{_anchor(place)})." if place else ""
    example = "`" + text.replace("|", r"\|") + "`" if text else ""
    return f"| `{one.key}` | {_escape(one.value)} | {_escape(one.meaning)}{more} | {example} |"


def _anchor(title: str) -> str:
    return re.sub(r"[^\w -]", "", title).lower().replace(" ", "-")


def _escape(text: str) -> str:
    """Return text as a cell; within backticks only bars need an escape."""
    parts = text.replace("|", r"\|").split("`")
    return "`".join(part if n % 2 else part.replace("<", r"\<") for n, part in enumerate(parts))


def list_examples(file: FileKind) -> tuple[str, ...]:
    """Return the example files of a kind of file, the best first."""
    folder = shipped_folder()
    studies = sorted(folder.glob("studies/*.toml")) if file.name not in EXAMPLES else []
    of_kind = [path for path in studies if read_toml(path).get("kind") == file.name]
    own = [*of_kind, *sorted(folder.glob(f"docs/examples/{file.name}*.toml"))]
    return (*EXAMPLES.get(file.name, ()), *(path.relative_to(folder).as_posix() for path in own))


@cache
def collect_examples(file: FileKind) -> dict[tuple[type[BaseModel], str], str]:
    """Return an example of every key that the example files hold, by record and field."""
    found = dict[tuple[type[BaseModel], str], str]()
    for path in list_examples(file):
        for key, text in _walk(file.record, read_toml(shipped_folder() / path), ()):
            found.setdefault(key, text)
    return found


def _walk(
    record: type[BaseModel], table: Mapping[str, Any], path: Sequence[str]
) -> Iterator[tuple[tuple[type[BaseModel], str], str]]:
    """Yield an example of every key of a table, and of the tables within it."""
    for name, field in record.model_fields.items():
        key = field.alias or name
        if key not in table:
            continue
        value, inner = table[key], find_record(field.annotation)
        yield (find_owner(record, name), name), _show(key, value, (*path, key), is_table=inner is not None)
        if inner:
            for step, one in _tables(value):
                yield from _walk(inner, one, (*path, key, *step))


def _tables(value: Any) -> Iterator[tuple[tuple[str, ...], Mapping[str, Any]]]:  # noqa: ANN401 - a TOML value
    """Yield the tables of a value: itself, those of a list, or those of a table by name."""
    if isinstance(value, list):
        yield from (((), one) for one in value)
    elif isinstance(value, Mapping) and value and all(isinstance(one, Mapping) for one in value.values()):
        yield from (((name,), one) for name, one in value.items())
        yield (), value
    elif isinstance(value, Mapping):
        yield (), value


MAX_EXAMPLE_CHARS = 60


def _show(key: str, value: Any, path: Sequence[str], *, is_table: bool) -> str:  # noqa: ANN401 - a TOML value
    if is_table and isinstance(value, list) and not isinstance(value[0], list | float):
        return f"[[{'.'.join(path)}]]"
    if is_table and isinstance(value, Mapping):
        return f"[{'.'.join(path)}]"
    if isinstance(value, Mapping):
        first = next(iter(value.items()), None)
        return f"{key} = {{ {dumps(dict([first])).strip()} }}" if first else f"{key} = {{}}"
    text = format_value(value)
    if len(text) > MAX_EXAMPLE_CHARS:
        text = text[: MAX_EXAMPLE_CHARS - 5].rpartition(" ")[0] + (
            ' ..."' if isinstance(value, str) else " ...]"
        )
    return f"{key} = {text}"  # fmt: skip
