"""TOML files: read and check them against records, change keys, write tables.

Every error names the file, the key, and what to do.
"""

import copy
import difflib
import json
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from needlefit.errors import ConfigError
from needlefit.project.input_files import parse_toml, to_json_values
from needlefit.project.locate import FileKind, file_label, find_file, is_path, read_toml
from needlefit.schemas.base import MISSING_KEY, FileRecord

R = TypeVar("R", bound=BaseModel)
F = TypeVar("F", bound=FileRecord)


def load(path: Path, kind: type[R]) -> R:
    """Read `path` and check it against the record `kind`.

    ConfigError if the file is missing, is no TOML, or holds a wrong, missing or unknown key.
    """
    return check(read_toml(path), kind, path)


def check(tables: dict[str, Any], kind: type[R], where: Path | str) -> R:
    """Check parsed tables against the record `kind`; `where` is named in the error.

    Types are strict: `"0.1"` is a text and no number. Members of a list are numbered from 1, as layers
    are: `layers.1` is the first one.

    ConfigError: listing every wrong, missing or unknown key.
    """
    try:
        # as JSON, whose lists strictly are tuples; it has no form for dates, which no key wants
        return kind.model_validate_json(
            json.dumps(tables, default=lambda date: {"date or time": str(date)}), strict=True
        )
    except ValidationError as error:
        faults = _list_faults(error, kind)
        raise ConfigError(
            "; ".join(fault.what for fault in faults),
            where=where if isinstance(where, str) else file_label(where),
            expected="; ".join(
                f"`{fault.key}`: {fault.expected}" if len(faults) > 1 else fault.expected
                for fault in faults
                if fault.expected
            ),
            fix="; ".join(fault.fix for fault in faults),
        ) from None


# ---- what a program gives

IN_MEMORY = "given in Python"
"""Words in a result in place of the name of what has none."""


def read_given(kind: FileKind, value: str | Path | F | Mapping[str, Any], record: type[F]) -> tuple[F, str]:
    """Return what a name, a path, a record or a table of its keys means, and its name.

    ConfigError as of `find_file`, `load` and `check`.
    """
    if isinstance(value, record):
        return value, IN_MEMORY
    if isinstance(value, Mapping):
        table = {
            key: to_json_values(entry) for key, entry in ({"schema": record.SCHEMA} | dict(value)).items()
        }
        return check(table, record, f"{kind} {IN_MEMORY}"), IN_MEMORY
    name = spell_name(value)  # type: ignore[arg-type]  # nothing else is left
    return load(find_file(kind, name), record), name


def spell_name(name: str | Path) -> str:
    """Return a name or path as text; a Path is never taken for a bare name. ConfigError if it is neither."""
    if not isinstance(name, str | Path):
        raise ConfigError(f"is a {type(name).__name__}", expected="a name or a path", where="the argument")
    text = str(name)
    return f"./{text}" if isinstance(name, Path) and not is_path(text) else text


# ---- faults

Location = tuple[int | str, ...]

_UNION_MEMBER = re.compile(r"constrained-|literal\[")  # pydantic's name of the type that was tried
_INPUT = "Input should be "  # pydantic's words before what it expects


def _list_faults(error: ValidationError, kind: type[BaseModel]) -> list[ConfigError]:
    """Return what is wrong with a file that should be a record `kind`, one fault for each key.

    A list is not called too short for members that are wrong themselves.
    """
    by_place = dict[Location, list[ErrorDetails]]()
    for detail in error.errors():
        parts = (part for part in detail["loc"] if not (isinstance(part, str) and _UNION_MEMBER.match(part)))
        missing = detail["ctx"]["location"] if detail["type"] == MISSING_KEY else ()
        by_place.setdefault((*parts, *missing), []).append(detail)
    return [
        _describe_fault(place, errors, kind)
        for place, errors in by_place.items()
        if errors[0]["type"] != "too_short"
        or not any(len(other) > len(place) and other[: len(place)] == place for other in by_place)
    ]


def _describe_fault(place: Location, errors: list[ErrorDetails], kind: type[BaseModel]) -> ConfigError:
    """Return what is wrong with one key, which is wrong, missing or unknown."""
    key = ".".join(str(part + 1 if isinstance(part, int) else part) for part in place)
    if errors[0]["type"] in ("missing", MISSING_KEY):
        return ConfigError(f"key `{key}` is missing", fix=f"add `{key}`", key=key)
    if errors[0]["type"] == "extra_forbidden":
        keys = _list_keys(_find_record(kind, place[:-1]))
        near = difflib.get_close_matches(str(place[-1]), keys, n=1, cutoff=0.5)
        problem = f"key `{key}` is unknown" + (f"; did you mean `{near[0]}`?" if near else "")
        expected = f"one of {', '.join(keys)}" if keys else ""
        fix = f"correct or remove `{key}`"
        if not near and len(place) > 1 and place[-1] in _list_keys(kind):
            fix = f"move it: `{place[-1]}` is a key of the whole file, above its tables"
        return ConfigError(problem, expected=expected, fix=fix, key=key)
    messages = list(
        dict.fromkeys(error["msg"].removeprefix("Value error, ").replace("Tuple", "List") for error in errors)
    )
    value = errors[0].get("input")
    if all(message.startswith(_INPUT) for message in messages) and isinstance(
        value, str | int | float | bool
    ):
        expected = " or ".join(message.removeprefix(_INPUT).replace("'", '"') for message in messages)
        problem = f"key `{key}` is {json.dumps(value)}"
        return ConfigError(problem, expected=expected, fix=f"correct `{key}`", key=key)
    text, fix = "; ".join(messages), f"correct `{key}`" if key else "correct the keys named"
    return ConfigError(f"key `{key}`: {text}" if key else text, fix=fix, key=key)


def _list_keys(record: type[BaseModel] | None) -> list[str]:
    return [field.alias or name for name, field in record.model_fields.items()] if record else []


def _find_record(kind: type[BaseModel], place: Location) -> type[BaseModel] | None:
    """Return the record of the table at a place of a record; None where that is no single record."""
    for part in place:
        fields = {model_field.alias or name: model_field for name, model_field in kind.model_fields.items()}
        if part not in fields:
            continue  # the number or the name of a table, whose record was found with the key of all
        inner = list(list_inner_records(fields[str(part)].annotation))
        if len(inner) != 1:
            return None
        kind = inner[0]
    return kind


def list_inner_records(annotation: object) -> Iterator[type[BaseModel]]:
    """Yield the records within an annotation, also in lists and tables."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for inner in get_args(annotation):
        yield from list_inner_records(inner)


# ---- where a key stands


def locate_key(path: Path, key: str) -> str:
    """Return how messages name a key of a TOML file."""
    return f"{file_label(path)}, key `{key}`"


@contextmanager
def add_file_context(path: Path | None) -> Iterator[None]:
    """Have every ConfigError from within that names only a key name this file, too; None: of no file."""
    try:
        yield
    except ConfigError as error:
        if not error.key or path is None:
            raise
        located = error.at(locate_key(path, error.key))
        located.key = ""  # of this file: no other is looked through for it
        raise located from None


@contextmanager
def add_key_context(key: str) -> Iterator[None]:
    """Have every ConfigError from within that names no place name this key of the file read."""
    try:
        yield
    except ConfigError as error:
        if error.where or error.key:
            raise
        error.key = key
        raise


def find_named(key: FileKind, name: str) -> Path:
    """Return the file that a study names under `key`; the key is also the kind of file."""
    with add_key_context(key):
        return find_file(key, name)


@contextmanager
def add_study_context(study: str) -> Iterator[None]:
    """Give every ConfigError raised inside, if it names no place, this study."""
    try:
        yield
    except ConfigError as error:
        if error.where:
            raise
        raise error.at(describe_key(study, error.key)) from None


def describe_key(study: str, key: str) -> str:
    """Return the name of a study file's key for messages."""
    return f"study {study}, key `{key}`" if key else f"study {study}"


# ---- change single keys: `bevel.offset_mm=0.1`, `layers.1.mu_pa=3e5`


def override(tables: Mapping[str, Any], assignments: Sequence[tuple[str, str]], where: str) -> dict[str, Any]:
    """Return a copy of `tables` in which each dotted key has its new value, or is gone if that is empty.

    Members of a list are numbered from 1: `layers.1` is the first layer, `steps.1` the first step. Tables
    that the file leaves to defaults are made.

    ConfigError if there is no such member of a list, or no such key to remove; that a new key is known is
    checked with its value.
    """
    changed = copy.deepcopy(dict(tables))
    for key, text in assignments:
        *path, name = key.split(".")
        table: Any = changed
        try:
            for part in path:
                if isinstance(table, list):
                    table = dict(enumerate(table, start=1))[int(part)]
                else:
                    table = table.setdefault(part, {})
            if text:
                table[name] = _parse_value(text, where)
            else:
                del table[name]
        except (AttributeError, IndexError, KeyError, TypeError, ValueError):
            raise ConfigError(
                f"there is no key `{key}`",
                expected="a key of the file; layers, guides and steps are numbered from 1",
                fix="correct the name",
                where=where,
            ) from None
    return changed


def _parse_value(text: str, where: str) -> object:
    """Return a TOML value; what is none (`ogden`) is a string."""
    try:
        return parse_toml(f"value = {text}", where)["value"]
    except ConfigError:
        return text


# ---- write


def dumps(tables: Mapping[str, Any], arrays: Collection[str] = ()) -> str:
    """Return `tables` as TOML: values first, then sub-tables; None and empty values are left out.

    `arrays`: names of lists of tables that hold tables; each table of such a list is written as `[[name]]`.
    """
    lines = _write_table({key: value for key, value in tables.items() if key not in arrays}, ())
    for name in arrays:
        for member in tables.get(name, ()):
            values = {key: value for key, value in member.items() if not isinstance(value, Mapping)}
            lines += ["", f"[[{name}]]", *_write_table(values, ())]
            for key, table in member.items():
                lines += _write_table({key: table}, (name,)) if table and isinstance(table, Mapping) else []
    return "\n".join(lines).lstrip("\n") + "\n"


def _write_table(table: Mapping[str, Any], path: tuple[str, ...]) -> list[str]:
    kept = {key: value for key, value in table.items() if value is not None and value not in ("", {}, (), [])}
    values = {key: value for key, value in kept.items() if not isinstance(value, Mapping)}
    lines = [f"{_key(key)} = {_value(value)}" for key, value in values.items()]
    if path and (lines or not kept):
        lines = ["", f"[{'.'.join(map(_key, path))}]", *lines]
    for key, value in kept.items():
        if isinstance(value, Mapping):
            lines += _write_table(value, (*path, key))
    return lines


def _value(value: Any) -> str:  # noqa: ANN401 - whatever a record holds
    if isinstance(value, Mapping):
        kept = {k: v for k, v in value.items() if v is not None and v != {}}
        return "{ " + ", ".join(f"{_key(k)} = {_value(v)}" for k, v in kept.items()) + " }"
    if isinstance(value, list | tuple) and value and isinstance(value[0], Mapping):
        return "[\n" + "".join(f"    {_value(item)},\n" for item in value) + "]"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_value(item) for item in value) + "]"
    return json.dumps(value, ensure_ascii=False)


def _key(key: str) -> str:
    plain = key.isascii() and key.replace("_", "").replace("-", "").isalnum()
    return key if plain else json.dumps(key, ensure_ascii=False)
