"""What `needlefit explain` prints: warnings, terms, columns of tables, keys of files."""

import re
from collections.abc import Iterator, Mapping
from functools import cache

from needlefit.datasets.input_tables import read_input_columns
from needlefit.grouping import group_values
from needlefit.project.help_pages import Topic, read_sections, read_terms
from needlefit.project.toml_reference import KeyDescription, TableDescription, describe_files, list_files
from needlefit.reporting.columns import find_column, list_columns
from needlefit.studies.kind import list_records


@cache
def list_topics() -> Mapping[str, tuple[Topic, ...]]:
    """Return all topics by group."""
    return {
        "Warnings and checks": tuple(read_sections().values()),
        "Terms": tuple(read_terms()),
        "Columns of tables": tuple(_describe_columns()),
        "Columns of tables that you write": tuple(_describe_input_columns()),
        "Files that you write": tuple(_describe_files()),
        "Keys of files": tuple(_describe_keys()),
    }


def find_topics(name: str) -> list[Topic]:
    """Return the topics of a name, as it stands in a file or on a page; none if it is not known."""
    wanted = _fold(name)
    topics = (one for group in list_topics().values() for one in group)
    found = [one for one in topics if wanted in {_fold(each) for each in one.names}]
    column = find_column(name)  # its name may have a number, such as mu3_pa
    if not found and column.explanation:
        found = [Topic(name, column.label, (column.explanation,))]
    return found


def _fold(name: str) -> str:
    """Return a name without what words are joined by, and without the number of a percentage or a layer."""
    plain = re.sub(r"\d+ ?% ?|[₀-₉]", "", name)
    return re.sub("[-_ \u00a0]+", " ", plain).strip(" .?:").casefold()


def _describe_columns() -> Iterator[Topic]:
    for one in list_columns().values():
        title = f"{one.label} ({one.unit})" if one.unit else one.label
        yield Topic(one.key, title, (one.explanation,), one.label)


def _describe_input_columns() -> Iterator[Topic]:
    for one in read_input_columns():
        empty = f"Empty: {one.default}." if one.default else ""
        yield Topic(one.column, f"{one.column}, of {one.table}", tuple(filter(None, (one.meaning, empty))))


def _describe_files() -> Iterator[Topic]:
    for file, tables in describe_files(list_files(list_records())):
        paragraphs = [line for table in tables for line in _list_keys(table)]
        yield Topic(file.name, f"Keys of the file: {file.title}", tuple(paragraphs), file.title)
    for name, columns in group_values((one.table, one) for one in read_input_columns()).items():
        lines = (f"- {one.column}: {one.meaning}" for one in columns)
        yield Topic(name, f"Columns of {name}", tuple(lines))


def _list_keys(table: TableDescription) -> Iterator[str]:
    yield f"{table.title}. {table.summary}"
    yield from (f"- {one.key} ({one.value}): {one.meaning}" for one in table.keys)


def _describe_keys() -> Iterator[Topic]:
    described = describe_files(list_files(list_records()))
    pairs = (
        (one.key, (table.title, one)) for _, tables in described for table in tables for one in table.keys
    )
    for key, places in group_values(pairs).items():
        titles = ", ".join(dict.fromkeys(title for title, _ in places))
        yield Topic(key, f"{key}, key of: {titles}", tuple(_list_meanings(places)))


def _list_meanings(places: list[tuple[str, KeyDescription]]) -> Iterator[str]:
    """Yield each meaning of a key once, with the tables in which it has it."""
    meanings = group_values(((one.value, one.meaning), title) for title, one in places)
    for (value, meaning), titles in meanings.items():
        head = f"{', '.join(dict.fromkeys(titles))}: " if len(meanings) > 1 else ""
        yield f"{head}{meaning} ({value})"
