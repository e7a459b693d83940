"""What `needlefit explain` prints: warnings, terms, columns of tables, keys of files."""

import csv
import re
from collections.abc import Iterator, Mapping
from functools import cache
from importlib.resources import files

from needlefit.datasets.importing.meanings import MEANINGS
from needlefit.grouping import group_values
from needlefit.project.help_pages import Topic, read_sections, read_terms
from needlefit.project.toml_reference import KeyDescription, describe_files
from needlefit.reporting.table import find_column, list_columns
from needlefit.studies.kind import list_records


def read_input_columns() -> list[dict[str, str]]:
    """Return table, column, meaning and default (of an empty cell) of tables that users write."""
    text = files("needlefit.datasets").joinpath("input_tables.csv").read_text(encoding="utf-8")
    return [*csv.DictReader(text.splitlines())]


@cache
def list_topics() -> Mapping[str, tuple[Topic, ...]]:
    """Return all topics by group."""
    return {
        "Warnings and checks": tuple(read_sections().values()),
        "Terms": tuple(read_terms()),
        "Columns of tables": tuple(
            Topic(
                column.key,
                f"{column.label} ({column.unit})" if column.unit else column.label,
                (column.explanation,),
                column.label,
            )
            for column in list_columns().values()
        ),
        "Columns of tables that you write": tuple(
            Topic(
                column["column"],
                f"{column['column']}, of {column['table']}",
                (column["meaning"], *([f"Empty: {column['default']}."] if column["default"] else [])),
            )
            for column in read_input_columns()
        ),
        "Keys of an import": tuple(
            Topic(
                key,
                f"{key}{f' ({meaning.unit})' * bool(meaning.unit)}, key of an import",
                (
                    f"{meaning.text}.",
                    *([f"Else {meaning.usual}: {meaning.reason}."] if meaning.usual else []),
                ),
            )
            for key, meaning in MEANINGS.items()
        ),
        "Files that you write": tuple(_describe_files()),
        "Keys of files": tuple(_describe_keys()),
    }


def find_topics(name: str) -> list[Topic]:
    """Return the topics of a name, as it stands in a file or on a page; none if it is not known."""
    wanted = _fold(name)
    topics = (insertion for group in list_topics().values() for insertion in group)
    matching = [topic for topic in topics if wanted in {_fold(name) for name in topic.names}]
    column = find_column(name)  # its name may have a number, such as mu3_pa
    if not matching and column.explanation:
        matching = [Topic(name, column.label, (column.explanation,))]
    return matching


def _fold(name: str) -> str:
    """Return a name without what words are joined by, and without the number of a percentage or a layer."""
    plain = re.sub(r"\d+ ?% ?|[₀-₉]", "", name)
    return re.sub("[-_ \u00a0]+", " ", plain).strip(" .?:").casefold()


def _describe_files() -> Iterator[Topic]:
    for file, tables in describe_files(list_records()):
        paragraphs = []
        for table in tables:
            paragraphs.append(f"{table.title}. {table.summary}")
            paragraphs += [f"- {key.key} ({key.value}): {key.meaning}" for key in table.keys]
        yield Topic(file.name, f"Keys of the file: {file.title}", tuple(paragraphs), file.title)
    for name, columns in group_values((column["table"], column) for column in read_input_columns()).items():
        lines = (f"- {column['column']}: {column['meaning']}" for column in columns)
        yield Topic(name, f"Columns of {name}", tuple(lines))


def _describe_keys() -> Iterator[Topic]:
    described = describe_files(list_records())
    pairs = (
        (key.key, (table.title, key)) for _, tables in described for table in tables for key in table.keys
    )
    for key, places in group_values(pairs).items():
        titles = ", ".join(dict.fromkeys(title for title, _ in places))
        yield Topic(key, f"{key}, key of: {titles}", tuple(_list_meanings(places)))


def _list_meanings(places: list[tuple[str, KeyDescription]]) -> Iterator[str]:
    """Yield each meaning of a key once, with the tables in which it has it."""
    meanings = group_values(((entry.value, entry.meaning), title) for title, entry in places)
    for (value, meaning), titles in meanings.items():
        head = f"{', '.join(dict.fromkeys(titles))}: " if len(meanings) > 1 else ""
        yield f"{head}{meaning} ({value})"
