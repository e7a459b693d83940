"""TOML files: read and check them against records, find the lines of keys, change keys, write tables.

Every error names the file, the line, the key, and what to do.
"""

import copy
import difflib
import json
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import takewhile
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from needlefit.errors import ConfigError, NeedlefitError
from needlefit.project import input_files
from needlefit.project.input_files import MAX_CONFIG_BYTES, parse_toml, read_text
from needlefit.project.locate import file_label
from needlefit.schemas.base import MISSING_KEY

R = TypeVar("R", bound=BaseModel)


def load(path: Path, kind: type[R]) -> R:
    """Read `path` and check it against the record `kind`.

    ConfigError if the file is missing, is no TOML, or holds a wrong, missing or unknown key.
    """
    return check(read_toml(path), kind, path)


def read_toml(path: Path) -> dict[str, Any]:
    """Return the tables of a TOML file; raise ConfigError with file and line if it cannot be read."""
    return input_files.read_toml(path, ConfigError, file_label(path))


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
        faults = schema_faults(error, kind)
        keys = (f"`{fault.key}`: " if len(faults) > 1 else "" for fault in faults)
        expected = [
            f"{key}{fault.expected}" for key, fault in zip(keys, faults, strict=True) if fault.expected
        ]
        raise ConfigError(
            "; ".join(fault.what for fault in faults),
            where=where if isinstance(where, str) else locate_key(where, faults[0].key),
            expected="; ".join(expected),
            fix="; ".join(fault.fix for fault in faults if fault.fix),
        ) from None


# ---- faults

Location = tuple[int | str, ...]
ErrorContext = dict[str, Any]


@dataclass(frozen=True)
class SchemaFault:
    """One wrong, missing or unknown key of a file."""

    key: str
    what: str
    expected: str
    fix: str


_TYPE_NAMES: dict[type, str] = {
    float: "a number, without quotes",
    int: "a whole number, without quotes",
    str: 'a text, in quotes ("...")',
    bool: "true or false, without quotes",
}
_EXPECTED: dict[str, Callable[[ErrorContext], str]] = {
    "greater_than": lambda stated: f"a number above {stated['gt']:g}",
    "greater_than_equal": lambda stated: f"a number of at least {stated['ge']:g}",
    "less_than": lambda stated: f"a number below {stated['lt']:g}",
    "less_than_equal": lambda stated: f"a number of at most {stated['le']:g}",
    "multiple_of": lambda stated: f"a multiple of {stated['multiple_of']:g}",
    "finite_number": lambda _: "a finite number",
    "literal_error": lambda stated: str(stated["expected"]).replace("'", '"'),
    "too_short": lambda stated: f"a list of at least {stated['min_length']}",
    "too_long": lambda stated: f"a list of at most {stated['max_length']}",
    "string_pattern_mismatch": lambda _: "a letter, then letters, digits, - or _",
    "float_type": lambda _: _TYPE_NAMES[float],
    "float_parsing": lambda _: _TYPE_NAMES[float],
    "int_type": lambda _: _TYPE_NAMES[int],
    "int_parsing": lambda _: _TYPE_NAMES[int],
    "int_from_float": lambda _: _TYPE_NAMES[int],
    "string_type": lambda _: _TYPE_NAMES[str],
    "bool_type": lambda _: _TYPE_NAMES[bool],
    "bool_parsing": lambda _: _TYPE_NAMES[bool],
    "tuple_type": lambda _: "a list: [..., ...], or a table [[...]] for each member",
    "dict_type": lambda _: "a table of keys and values",
    "model_type": lambda _: "a table of keys and values",
}
_MEMBER = re.compile(r"constrained-|literal\[")
_LENGTH_FAULTS = {"too_short": "has too few members", "too_long": "has too many members"}


def schema_faults(error: ValidationError, kind: type[BaseModel]) -> list[SchemaFault]:
    """Return what is wrong with a file that should be a record `kind`.

    Members of a list are numbered from 1. A list is not called too short for members that are wrong
    themselves. What could be one thing or another is one fault.
    """
    found: list[tuple[Location, ErrorDetails]] = []
    for each in error.errors():
        if each["type"] == MISSING_KEY:  # of a key which other keys require: as if the record required it
            each = {**each, "type": "missing", "loc": (*each["loc"], *each["ctx"]["location"])}
        names_member = (isinstance(part, str) and _MEMBER.match(part) for part in each["loc"])
        parts = zip(each["loc"], names_member, strict=True)
        found.append((tuple(part for part, is_member in parts if not is_member), each))
    kept: dict[str, SchemaFault] = {}
    for place, each in found:
        if each["type"] == "too_short" and any(
            len(other) > len(place) and other[: len(place)] == place for other, _ in found
        ):
            continue
        fault = _to_fault(each["type"], place, each, kind)
        first = kept.get(fault.key)
        if first is None:
            kept[fault.key] = fault
        elif first.what == fault.what and fault.expected:
            kept[fault.key] = replace(first, expected=f"{first.expected}, or {fault.expected}")
        else:
            kept[f"{fault.key} {len(kept)}"] = fault
    return list(kept.values())


def _to_fault(fault: str, location: Location, error: ErrorDetails, kind: type[BaseModel]) -> SchemaFault:
    key = ".".join(str(part + 1 if isinstance(part, int) else part) for part in location)
    if fault == "extra_forbidden":
        return _unknown(key, location, kind)
    if fault == "missing":
        return SchemaFault(key, f"key `{key}` is missing", _missing(location, kind), f"add `{key}`")
    message = error["msg"].removeprefix("Value error, ")
    if fault not in _EXPECTED:  # the record's own words, which say what to do
        what, fix = (f"key `{key}`: {message}", f"`{key}`") if key else (message, "the keys named")
        return SchemaFault(key, what, _forms(kind, location), f"change {fix} accordingly")
    value = error.get("input")
    known = isinstance(value, str | int | float | bool)
    got = _LENGTH_FAULTS.get(fault) or (f"is {_as_written(value)}" if known else "is of another kind")
    return SchemaFault(key, f"key `{key}` {got}", _EXPECTED[fault](error.get("ctx", {})), f"correct `{key}`")


def _as_written(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f'"{value}"' if isinstance(value, str) else f"{value!r}"


def _unknown(key: str, location: Location, kind: type[BaseModel]) -> SchemaFault:
    known = list(_fields(kind, location[:-1]))
    near = difflib.get_close_matches(str(location[-1]), known, n=1, cutoff=0.5)
    forms, table = _forms(kind, location[:-1]), key.rpartition(".")[0]
    return SchemaFault(
        key,
        f"key `{key}` is unknown" + (f"; did you mean `{near[0]}`?" if near else ""),
        forms or (f"one of {', '.join(known)}" if known else ""),
        f"write `{near[0]}`, or leave it out"
        if near
        else f"write `{table}` in one of these forms"
        if forms
        else f"leave `{key}` out",
    )


def _forms(kind: type[BaseModel], location: Location) -> str:
    """Return the ways to write the table at `location` of a record; empty where it states none."""
    return str(getattr(_record_at(kind, location), "FORMS", ""))


def _missing(location: Location, kind: type[BaseModel]) -> str:
    """Return what is missing, as the record declares it."""
    field = _fields(kind, location[:-1]).get(str(location[-1]))
    if field is None:
        return ""
    for limit in field.metadata:
        for name, fault in (("gt", "greater_than"), ("ge", "greater_than_equal")):
            if getattr(limit, name, None) is not None:
                return _EXPECTED[fault]({name: getattr(limit, name)})
    if get_origin(field.annotation) is Literal:
        return " or ".join(map(_as_written, get_args(field.annotation)))
    words = [
        text
        for type_, text in _TYPE_NAMES.items()
        if type_ in (field.annotation, *get_args(field.annotation))
    ]
    return words[0] if words else "a table of keys and values"


def _fields(kind: type[BaseModel], location: Location) -> dict[str, FieldInfo]:
    """Return the keys of the table at `location` of a record; none where that is no single record."""
    holder = _record_at(kind, location)
    return {} if holder is None else {one.alias or name: one for name, one in holder.model_fields.items()}


def _record_at(kind: type[BaseModel], location: Location) -> type[BaseModel] | None:
    """Return the record of the table at `location` of a record; None where that is no single record."""
    for part in location:
        if isinstance(part, int):
            continue  # a list: its members' record was found with its key
        fields = _fields(kind, ())
        if part not in fields:
            continue  # the name of a table in a mapping, found with the mapping's key
        inner = list(_records(fields[part].annotation))
        if len(inner) != 1:
            return None
        kind = inner[0]
    return kind


def _records(annotation: object) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for inner in get_args(annotation):
        yield from _records(inner)


# ---- on which line a key stands: tomllib does not say

_HEADER = re.compile(r"\s*(\[\[?)\s*([^\[\]]+?)\s*\]")
_QUOTES = re.compile("[\"'\\s]")
_ASSIGNMENT = re.compile(r"""\s*((?:[\w.-]|"[^"\n]*"|'[^'\n]*')+)\s*=""")


def find_line(text: str, key: str) -> int | None:
    """Return the line, from 1, on which a key of a TOML text stands; of a missing key that of its table.

    `key` is dotted, members of lists are numbered from 1: `tune.medium`, `validate.2.layers`. None where
    the text does not hold even the key's first part.
    """
    counts: dict[str, int] = {}  # of the members of lists of tables so far
    table, found, length, in_text = "", None, 0, False
    for number, line in enumerate(text.splitlines(), start=1):
        begun, in_text = in_text, in_text ^ ((line.count('"""') + line.count("'''")) % 2 == 1)
        if begun:  # of a text of several lines
            continue
        if header := _HEADER.match(line):
            table = _QUOTES.sub("", header[2])
            if header[1] == "[[":
                counts[table] = counts.get(table, 0) + 1
            for name, count in counts.items():
                if f"{table}.".startswith(f"{name}."):
                    table = f"{name}.{count}{table.removeprefix(name)}"
                    break
            path = table
        elif assignment := _ASSIGNMENT.match(line):
            path = f"{table}.{_QUOTES.sub('', assignment[1])}".removeprefix(".")
        else:
            continue
        equal = takewhile(lambda pair: pair[0] == pair[1], zip(key.split("."), path.split("."), strict=False))
        parts = len(list(equal))
        if parts > length:
            found, length = number, parts
    return found


def locate_key(path: Path, key: str) -> str:
    """Return how messages name a key of a TOML file: file and line, or the file where no line is known."""
    try:
        line = find_line(read_text(path, MAX_CONFIG_BYTES), key)
    except NeedlefitError:
        line = None
    name = file_label(path)
    if line is None:
        return name
    return f"{name}:{line}" if name == str(path) else f"{name}, line {line}"


@contextmanager
def add_file_context(path: Path) -> Iterator[None]:
    """Have every ConfigError from within that names only a key name this file, and the key's line."""
    try:
        yield
    except ConfigError as error:
        if not error.key:
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


@contextmanager
def renamed_keys(names: Mapping[str, str]) -> Iterator[None]:
    """Have every ConfigError from within that names no place name its key as the file read calls it."""
    try:
        yield
    except ConfigError as error:
        first, dot, rest = error.key.partition(".")
        if not error.where and first in names:
            error.key = f"{names[first]}{dot}{rest}"
        raise


@contextmanager
def add_study_context(study: str, key: str = "") -> Iterator[None]:
    """Give every ConfigError raised inside, if it names no place, this study and the key of its file."""
    try:
        yield
    except ConfigError as error:
        if error.where:
            raise
        error.key = error.key or key
        raise error.at(describe_key(study, error.key)) from None


def describe_key(study: str, key: str = "") -> str:
    """Return the name of a study file's key for messages."""
    return f"study {study}, key `{key}`" if key else f"study {study}"


# ---- change single keys: `bevel.offset_mm=0.1`, `layers.1.mu_pa=3e5`


def override(
    tables: Mapping[str, Any], assignments: Sequence[tuple[str, str]], kind: type[BaseModel], where: str
) -> dict[str, Any]:
    """Return a copy of `tables` in which each dotted key has its new value, or is gone if that is empty.

    Members of a list are numbered from 1: `layers.1` is the first layer, `steps.1` the first step.

    ConfigError if the record `kind` has no such key; the nearest ones are listed.
    """
    changed = copy.deepcopy(dict(tables))
    known = list(list_keys(kind, tables))
    for key, text in assignments:
        if key not in known:
            near = difflib.get_close_matches(key, known, n=3, cutoff=0.5) or known
            raise ConfigError(
                f"there is no key `{key}`",
                where=where,
                expected=f"one of {', '.join(near)}",
                fix="use one of these keys; layers, guides and steps are numbered from 1",
            )
        *path, name = key.split(".")
        table: Any = changed
        for part in path:  # tables that the file leaves to defaults are made
            table = table[int(part) - 1] if part.isdigit() else table.setdefault(part, {})
        if text:
            table[name] = _parse_value(text, f"{where}, --set {key}")
        else:
            table.pop(name, None)
    return changed


def list_keys(
    kind: type[BaseModel], tables: Mapping[str, Any], file: Mapping[str, Any] | None = None
) -> Iterator[str]:
    """Yield every dotted key that a file of this kind may hold; lists are as long as in `tables`.

    The tables of a mapping are called like the members of the file's list of the same name: what a step
    changes of a guide is `steps.2.guides.template.y_mm` where one of `guides` has the name `template`.
    """
    file = tables if file is None else file
    for name, field in kind.model_fields.items():
        name = field.alias or name
        inner: Any = field.annotation
        if _is_record(inner):
            yield from (f"{name}.{key}" for key in list_keys(inner, tables.get(name, {}), file))
        elif get_origin(inner) is tuple and _is_record(get_args(inner)[0]):
            for number, member in enumerate(tables.get(name, []), start=1):
                yield from (f"{name}.{number}.{key}" for key in list_keys(get_args(inner)[0], member, file))
        elif get_origin(inner) is dict and _is_record(get_args(inner)[1]):
            for member in (member["name"] for member in file.get(name, []) if "name" in member):
                yield from (f"{name}.{member}.{key}" for key in list_keys(get_args(inner)[1], {}, file))
        elif name != "schema":
            yield name


def _is_record(annotation: object) -> bool:
    return isinstance(annotation, type) and issubclass(annotation, BaseModel)


def _parse_value(text: str, where: str) -> object:
    """Return a TOML value; what is none (`ogden`) is a string. ConfigError as `parse_toml`."""
    try:
        tomllib.loads(f"value = {text}")
    except tomllib.TOMLDecodeError:
        return text
    except (RecursionError, ValueError):
        pass  # `parse_toml` says why
    return parse_toml(f"value = {text}", where)["value"]


# ---- write


def dumps(tables: Mapping[str, Any]) -> str:
    """Return `tables` as TOML: values first, then sub-tables; None and empty values are left out."""
    return "\n".join(_write_table(tables, ())).lstrip("\n") + "\n"


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
