"""Rewrite TOML files of earlier versions: keys that were renamed, and nothing else.

The keys are listed in `needlefit/schemas/renamed.py`. The text is edited, so that comments and layout stay.
The edited text is then parsed and compared with the renamed tables; a text that differs is not written.
"""

import re
import types
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Union, get_args, get_origin

from pydantic import BaseModel

from needlefit.errors import ConfigError
from needlefit.project.atomic_write import replace_file
from needlefit.project.input_files import parse_toml, read_text
from needlefit.project.load import check
from needlefit.project.toml_lines import find_line
from needlefit.schemas.base import FileRecord
from needlefit.schemas.credibility_statements import CredibilityStatementsRecord
from needlefit.schemas.dataset import (
    DatasetRecord,
    SectionsRecord,
    SourceRecord,
    TrackDatasetRecord,
)
from needlefit.schemas.medium import MaterialRecord, MediumRecord
from needlefit.schemas.recipe import RecipeRecord
from needlefit.schemas.reconstruction import ReconstructionRecord
from needlefit.schemas.recording import RecordingRecord
from needlefit.schemas.renamed import RENAMED_INPUTS, earlier_keys
from needlefit.schemas.scene import SceneRecord
from needlefit.schemas.study import FitRecord
from needlefit.studies.kind import KINDS

Tables = dict[str, Any]

OTHER_FILES: tuple[type[FileRecord], ...] = (
    *(RecipeRecord, MediumRecord, MaterialRecord, SceneRecord, DatasetRecord, TrackDatasetRecord),
    *(SectionsRecord, SourceRecord, ReconstructionRecord, CredibilityStatementsRecord),
)
"""What a TOML file may be besides a study file."""


def list_file_kinds() -> tuple[type[FileRecord], ...]:
    """Return what a TOML file may be: the study file of any kind, of plugins too, or another file."""
    # a fit has fewer keys than the study of the paper that it would be read as
    return FitRecord, *(kind.record for kind in KINDS.values()), *OTHER_FILES


def migrate_file(path: Path, dry_run: bool = False) -> bool:
    """Rewrite a TOML file or a recording in place; return whether there was anything to rewrite.

    With `dry_run` nothing is written.

    Raises
    ------
    ConfigError, DataError
        If it cannot be read, is of no kind that needlefit reads, or cannot be rewritten.
    """
    text = read_text(path)
    if path.suffix == ".csv":
        new = _migrate_recording(text, path)
    else:
        new, _ = migrate_text(text, list_file_kinds(), str(path))
    if new == text:
        return False
    if not dry_run:
        with replace_file(path) as fresh:
            fresh.write_text(new, encoding="utf-8")
    return True


def _migrate_recording(text: str, path: Path) -> str:
    """Return a recording with its head, which is TOML behind `#`, and its inputs renamed."""
    lines = text.splitlines(keepends=True)
    count = next((n for n, line in enumerate(lines) if not line.startswith("#")), len(lines))
    head = "".join(line[1:].removeprefix(" ") for line in lines[:count])
    new, _ = migrate_text(head, (RecordingRecord,), f"{path}, its first lines")
    commented = "".join(f"# {line}".rstrip() + "\n" for line in new.splitlines())
    return commented + "".join(_rename_input(line) for line in lines[count:])


def _rename_input(row: str) -> str:
    cells = row.split(",")
    if len(cells) > 2:  # step, time, input
        cells[2] = RENAMED_INPUTS.get(cells[2], cells[2])
    return ",".join(cells)


def migrate_text(text: str, kinds: Sequence[type[FileRecord]], where: str) -> tuple[str, type[FileRecord]]:
    """Return a TOML text with the keys of today, and the record that it then is.

    Parameters
    ----------
    text : str
    kinds : sequence of record types
        What the file may be; the first one to which the renamed tables conform is taken.
    where : str
        The file, for messages.

    Raises
    ------
    ConfigError
        If the text is no TOML, conforms to no kind, or cannot be edited line by line.
    """
    tables = parse_toml(text, where, ConfigError)
    faults: list[ConfigError] = []
    for kind in kinds:
        renamed = rename_keys(tables, kind)
        try:
            check(renamed, kind, where)
        except ConfigError as fault:
            faults.append(fault)
            continue
        return _edit(text, tables, renamed, kind, where), kind
    raise min(faults, key=lambda fault: fault.what.count("; "))  # of the kind that it resembles most


def rename_keys(tables: Mapping[str, Any], kind: type[BaseModel]) -> Tables:
    """Return the tables of a file with the earlier keys of a record, and of those in it, renamed."""
    new_names = earlier_keys(kind)
    annotations = {field.alias or name: field.annotation for name, field in kind.model_fields.items()}
    renamed: Tables = {}
    for old, value in tables.items():
        name = new_names.get(old, old)
        renamed[name] = _rename_value(value, annotations.get(name))
    if issubclass(kind, FileRecord) and "schema" in renamed:
        renamed["schema"] = kind.SCHEMA
    return renamed


def _rename_value(value: object, annotation: Any) -> object:  # noqa: ANN401  a type, or a union of types
    """Return a value of a declared type with earlier keys renamed."""
    if isinstance(value, list):
        inner = next((a for a in _alternatives(annotation) if get_origin(a) in (tuple, list)), None)
        item = get_args(inner)[0] if inner is not None else None
        return [_rename_value(one, item) for one in value]
    if not isinstance(value, dict):
        return value
    for one in _alternatives(annotation):
        if get_origin(one) in (dict, Mapping):
            return {name: _rename_value(inner, get_args(one)[1]) for name, inner in value.items()}
    records = [a for a in _alternatives(annotation) if isinstance(a, type) and issubclass(a, BaseModel)]
    return next((rename_keys(value, kind) for kind in records if _is_likely(value, kind)), value)


def _alternatives(annotation: Any) -> Iterator[Any]:  # noqa: ANN401
    """Yield the members of a union, annotations removed."""
    origin = get_origin(annotation)
    if origin in (Union, types.UnionType):
        for one in get_args(annotation):
            yield from _alternatives(one)
    elif hasattr(annotation, "__metadata__"):
        yield from _alternatives(annotation.__origin__)
    elif annotation is not None:
        yield annotation


def _is_likely(table: Mapping[str, Any], kind: type[BaseModel]) -> bool:
    """Whether a record has every key of a table, after renaming."""
    names = {field.alias or name for name, field in kind.model_fields.items()}
    return table.keys() <= names | earlier_keys(kind).keys()


def renamed_paths(tables: object, renamed: object, path: tuple[str, ...] = ()) -> Iterator[tuple[str, str]]:
    """Yield (earlier path, new name) for every key that differs; members of lists are numbered from 1."""
    if isinstance(tables, dict) and isinstance(renamed, dict):
        for (old, value), (new, inner) in zip(tables.items(), renamed.items(), strict=True):
            if old != new:
                yield ".".join((*path, old)), new
            yield from renamed_paths(value, inner, (*path, old))
    elif isinstance(tables, list) and isinstance(renamed, list):
        for n, (value, inner) in enumerate(zip(tables, renamed, strict=True), start=1):
            yield from renamed_paths(value, inner, (*path, str(n)))


def _edit(text: str, tables: Tables, renamed: Tables, kind: type[FileRecord], where: str) -> str:
    lines = text.splitlines(keepends=True)
    edits = list(renamed_paths(tables, renamed))
    for path, new in edits:
        old = path.rpartition(".")[2]
        number = find_line(text, path)
        if number is not None:
            lines[number - 1] = _rename_in_line(lines[number - 1], old, new)
        lines = [_rename_in_header(line, old, new) for line in lines]
    lines = [re.sub(r"^(\s*schema\s*=\s*)\d+", rf"\g<1>{kind.SCHEMA}", line) for line in lines]
    edited = "".join(lines)
    if parse_toml(edited, where, ConfigError) != renamed:
        raise ConfigError(
            "could not be rewritten: its keys are not laid out line by line",
            where=where,
            expected="; ".join(f"`{new}` instead of `{path}`" for path, new in edits),
            fix=f"rename these keys by hand, and write `schema = {kind.SCHEMA}`",
        )
    return edited


def _rename_in_line(line: str, old: str, new: str) -> str:
    """Return a line with a key before `=` renamed, bare or quoted, dotted or not."""
    return re.sub(rf"(?<![\w.-])(\"?){re.escape(old)}\1(?=\s*[.=])", new, line)


def _rename_in_header(line: str, old: str, new: str) -> str:
    """Return a header of a table, `[a.old.b]`, with the name renamed."""
    if not re.match(r"^\s*\[\[?[\w.\s\"-]+\]\]?\s*(#.*)?$", line):
        return line
    return re.sub(rf"(?<=[\[.\s]){re.escape(old)}(?=[\s.\]])", new, line, count=1)
