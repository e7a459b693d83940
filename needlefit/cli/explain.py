"""`needlefit explain`: what a warning, a term, a tissue law, a column of a table or a file means."""

import difflib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated

import typer

from needlefit.cli import options, screen

if TYPE_CHECKING:
    from needlefit.studies.toml_reference import FileKind


@dataclass(frozen=True)
class Topic:
    """What is printed about a key: a title, then paragraphs."""

    key: str
    title: str
    paragraphs: tuple[str, ...] = ()


def _list_warnings() -> Iterator[Topic]:
    from needlefit.project.troubleshooting import read_sections

    yield from (Topic(one.key, one.title, one.paragraphs) for one in read_sections().values())


def _list_files() -> Iterator[Topic]:
    from needlefit.studies.toml_reference import list_files

    yield from (Topic(one.name, one.title) for one in list_files())


def _list_terms() -> Iterator[Topic]:
    from needlefit.project.glossary import read_terms

    for one in read_terms().values():
        yield Topic(one.name, ", ".join(filter(None, (one.name, one.symbol, one.unit))), (one.meaning,))


def _list_laws() -> Iterator[Topic]:
    from needlefit.mechanics.laws import LAWS

    for law in LAWS.values():
        shape = [
            f"{one.name} ({one.symbol}{one.unit and f', {one.unit}'}): {one.explanation}; "
            f"{one.bounds[0]:g} to {one.bounds[1]:g}, usually {one.usual[0]:g} to {one.usual[1]:g}"
            for one in law.parameters
        ]
        yield Topic(law.name, law.label, tuple(shape) or ("No shape parameters.",))


def _list_columns() -> Iterator[Topic]:
    from needlefit.reporting.columns import list_columns

    for one in list_columns().values():
        title = f"{one.label} ({one.unit})" if one.unit else one.label
        yield Topic(one.key, title, (one.explanation,))


_GROUPS: Mapping[str, Callable[[], Iterator[Topic]]] = MappingProxyType(
    {
        "Warnings": _list_warnings,
        "Files": _list_files,
        "Terms": _list_terms,
        "Tissue laws": _list_laws,
        "Columns of tables": _list_columns,
    }
)


def _complete_keys(start: str) -> list[str]:
    return [one.key for group in _GROUPS.values() for one in group() if one.key.startswith(start)]


def explain(
    key: Annotated[
        str,
        typer.Argument(
            metavar="NAME",
            autocompletion=_complete_keys,
            help="A warning as printed (coverage), a file (study.toml), a term, a law, or a column (te_mm).",
        ),
    ] = "",
    json: options.Json = False,
) -> None:
    """Explain a warning, a file with all its keys, a term, a law or a column. Without NAME: list all."""
    groups = {name: list(group()) for name, group in _GROUPS.items()}
    topics = [one for group in groups.values() for one in group]
    found = [one for one in topics if one.key == key] or _find_numbered_column(key)
    if key and not found:
        near = difflib.get_close_matches(key, [one.key for one in topics], n=3)
        raise typer.BadParameter(
            f"`{key}` is no warning, file, term, tissue law or column"
            + (f"; did you mean {' or '.join(near)}?" if near else "")
        )
    if json:
        screen.show_json([asdict(one) for one in (map(_describe, found) if key else topics)])
    elif key:
        for one in map(_describe, found):
            screen.print_text("\n".join([one.title, *one.paragraphs]))
    else:
        for name, members in groups.items():
            screen.print_line(f"\n{name}")
            for one in members:
                screen.print_line(f"  {one.key:28}{one.title}")


def _find_numbered_column(key: str) -> list[Topic]:
    """Return a column whose name has a number, such as mu3_pa."""
    from needlefit.reporting.columns import find_column

    column = find_column(key)
    return [Topic(key, column.label, (column.explanation,))] if key and column.explanation else []


def _describe(topic: Topic) -> Topic:
    """Return a topic with its paragraphs; those of a file are its tables."""
    from needlefit.studies.toml_reference import list_files

    file = next((one for one in list_files() if one.name == topic.key), None)
    return topic if file is None else Topic(topic.key, topic.title, tuple(_describe_file(file)))


def _describe_file(file: "FileKind") -> Iterator[str]:
    from needlefit.studies.toml_reference import describe_files

    ((_, tables),) = describe_files([file])
    for number, table in enumerate(tables):
        yield f"\n{table.title}\n{table.summary}" if number else table.summary
        for one in table.keys:
            more = f" Keys: {one.described_in}." if one.described_in else ""
            yield f"\n  {one.key}: {one.value.replace('**', '').replace('`', '')}"
            yield f"      {one.meaning}{more}"
            yield from (f"      {one.example}",) if one.example else ()
