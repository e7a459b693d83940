"""What `needlefit explain` prints: warnings, terms, columns of tables, keys of files."""

import ast
import csv
import inspect
import re
import textwrap
import types
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from itertools import pairwise
from typing import Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from needlefit.datasets.importing.meanings import MEANINGS
from needlefit.grouping import group_values
from needlefit.project.help_pages import Topic, read_sections, read_terms
from needlefit.project.toml import dumps, list_inner_records
from needlefit.reporting.table import find_column, list_columns
from needlefit.schemas.base import FileRecord
from needlefit.schemas.dataset import DatasetRecord, SectionsRecord
from needlefit.schemas.mapping import MappingRecord
from needlefit.schemas.medium import MaterialRecord, MediumRecord
from needlefit.schemas.recipe import RecipeRecord
from needlefit.schemas.reconstruction import ReconstructionRecord
from needlefit.schemas.scene import SceneRecord
from needlefit.schemas.study import FitRecord, StudyRecord
from needlefit.studies.kind import KINDS, find_kind, list_records

# ---- the keys of files, read out of the schemas that check them


@dataclass(frozen=True)
class FileKind:
    """A kind of TOML file, and its schema."""

    name: str
    title: str
    record: type[FileRecord]


FILES = (
    FileKind("study", "Study", StudyRecord),
    FileKind("fit", "Fit", FitRecord),
    FileKind("medium", "Tissue model", MediumRecord),
    FileKind("prior", "Prior of a material", MaterialRecord),
    FileKind("recipe", "Recipe", RecipeRecord),
    FileKind("dataset", "Dataset", DatasetRecord),
    FileKind("mapping", "Mapping of an import", MappingRecord),
    FileKind("sections", "Cross-sections of a needle", SectionsRecord),
    FileKind("scene", "Scene", SceneRecord),
    FileKind("reconstruction", "Reconstruction", ReconstructionRecord),
)


def list_files(studies: Mapping[str, type[FileRecord]]) -> tuple[FileKind, ...]:
    """Return the kinds of file: those above, then the further ones of `studies`, by the kind of study."""
    listed = [file.record for file in FILES]
    further = (
        FileKind(name, f"Study of kind `{name}`", study)
        for name, study in studies.items()
        if study not in listed
    )
    return (*FILES, *further)


@dataclass(frozen=True)
class KeyDescription:
    """A key of a table: what it takes, and what it means."""

    key: str
    value: str
    meaning: str


@dataclass(frozen=True)
class TableDescription:
    """A table of a file, or the file itself: its title, what it is, and its keys."""

    title: str
    summary: str
    keys: tuple[KeyDescription, ...]


def describe_files(
    studies: Mapping[str, type[FileRecord]],
) -> list[tuple[FileKind, list[TableDescription]]]:
    """Return the tables of all files of `list_files`; what one describes is not described again."""
    described = dict[type[BaseModel], str]()
    described_files = []
    for file in list_files(studies):
        described[file.record] = file.title
        described_files.append((file, list(_describe_record(file.record, "", file.title, described))))
    return described_files


def _describe_record(
    record: type[BaseModel], path: str, title: str, described: dict[type[BaseModel], str]
) -> Iterator[TableDescription]:
    """Yield the keys of a record, then those of the tables within it that were not described."""
    keys, inner = [], []
    for name, field in record.model_fields.items():
        key, record_in = field.alias or name, next(list_inner_records(field.annotation), None)
        if record_in and record_in not in described:
            path_in = ".".join(filter(None, (path, key)))
            inner.append((record_in, path_in))
            described[record_in] = f"{title}: {path_in}"
        value = f"up to {record.SCHEMA}, required" if name == "schema_" else _describe_value(field)  # type: ignore[attr-defined]
        keys.append(KeyDescription(key, value, _find_meaning(record, name)))
    summary = " ".join((inspect.getdoc(record) or "").partition("\n\n")[0].split())
    yield TableDescription(described[record], summary, tuple(keys))
    for record_in, path_in in inner:
        yield from _describe_record(record_in, path_in, title, described)


def _find_meaning(record: type[BaseModel], name: str) -> str:
    """Return the docstring of a field, of the record or of a base class; KeyError if none has it."""
    for kind in record.__mro__:
        if name in (meanings := _field_docstrings(kind)):
            return meanings[name]
    raise KeyError(f"{record.__name__}.{name} has no docstring")


@cache
def _field_docstrings(record: type) -> dict[str, str]:
    if not issubclass(record, BaseModel) or record is BaseModel:
        return {}
    body = ast.parse(textwrap.dedent(inspect.getsource(record))).body[0].body  # type: ignore[attr-defined]
    return {
        ast.unparse(field.target): " ".join(str(text.value.value).split())
        for field, text in pairwise(body)
        if isinstance(field, ast.AnnAssign)
        and isinstance(text, ast.Expr)
        and isinstance(text.value, ast.Constant)
    }


TYPES = {float: "float", int: "integer", str: "string", bool: "boolean"}  # names of types in TOML
LIMITS = {
    **{"ge": "≥ {:g}", "gt": "> {:g}", "le": "≤ {:g}", "lt": "< {:g}"},
    **{"min_length": "at least {}", "max_length": "at most {}"},
}


def _describe_value(field: FieldInfo) -> str:
    """Return type, bounds and default of a key."""
    bounds = (
        (words, getattr(limit, name, None)) for limit in field.metadata for name, words in LIMITS.items()
    )
    parts = [
        _describe_type(field.annotation),
        *(words.format(bound) for words, bound in bounds if bound is not None),
    ]
    if field.is_required():
        parts.append("required")
    else:
        value = field.get_default(call_default_factory=True)
        if not (value in (None, "", {}, ()) or isinstance(value, BaseModel)):
            parts.append(f"default `{_format_value(value)}`")
    return ", ".join(parts)


def _describe_type(annotation: Any) -> str:  # noqa: ANN401 - whatever may stand in an annotation
    """Return what a key takes, in words."""
    origin, inner = get_origin(annotation), get_args(annotation)
    if origin is Literal:
        return " or ".join(f"`{_format_value(part)}`" for part in inner)
    if origin in (Union, types.UnionType):
        return " or ".join(dict.fromkeys(_describe_type(part) for part in inner if part is not type(None)))
    if hasattr(annotation, "__metadata__"):  # of Annotated
        return _describe_type(inner[0])
    if origin is dict:
        return f"table of {_describe_type(inner[1])} by name"
    if origin is tuple:
        return f"array of {_describe_type(inner[0])}" + (f" × {len(inner)}" if inner[-1] is not ... else "")
    return "table" if any(list_inner_records(annotation)) else TYPES.get(annotation, "value")


def _format_value(value: Any) -> str:  # noqa: ANN401 - a TOML value
    """Return a value as a TOML file has it."""
    return dumps({"key": value}).partition("= ")[2].strip() if value != "" else '""'


# ---- all topics


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
    if not matching and name.endswith(".csv"):
        matching = [*_describe_result(name)]
    # a key with its table, such as guide.thickness_mm
    return matching if matching or "." not in name else find_topics(name.rpartition(".")[2])


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


def _describe_result(name: str) -> Iterator[Topic]:
    """Yield the columns of the tables of results that are written as a file."""
    for frames in (find_kind(kind).frames for kind in KINDS.names()):
        columns = [find_column(key) for key in frames.get(name.removesuffix(".csv"), ())]
        if columns:
            lines = (f"- {column.key}: {column.explanation or column.label}" for column in columns)
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
