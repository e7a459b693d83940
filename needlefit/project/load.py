"""TOML file -> checked record. Every error names the file, the line, the key, and what to do."""

import difflib
import json
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from needlefit.errors import ConfigError
from needlefit.project import input_files
from needlefit.project.locate import file_label
from needlefit.project.toml_lines import locate_key
from needlefit.schemas.base import MISSING_KEY

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
    themselves.
    """
    found = [_place_missing_key(each) for each in error.errors()]
    places = [_strip_union_members(each["loc"]) for each in found]
    faults = [
        _to_fault(each["type"], place, each, kind)
        for each, place in zip(found, places, strict=True)
        if each["type"] != "too_short" or not any(_within(other, place) for other in places)
    ]
    return _join_faults_of_key(faults)


def _place_missing_key(error: ErrorDetails) -> ErrorDetails:
    """Return an error; that of a key which other keys require as if the record itself required it."""
    if error["type"] != MISSING_KEY:
        return error
    return {**error, "type": "missing", "loc": (*error["loc"], *error["ctx"]["location"])}


def _strip_union_members(location: Location) -> Location:
    """Return a location without pydantic's names for the members of a union."""
    return tuple(part for part in location if not (isinstance(part, str) and _MEMBER.match(part)))


def _join_faults_of_key(faults: list[SchemaFault]) -> list[SchemaFault]:
    """Return the faults, those of one key that could be one thing or another as one."""
    kept: dict[str, SchemaFault] = {}
    for fault in faults:
        first = kept.get(fault.key)
        if first is None:
            kept[fault.key] = fault
        elif first.what == fault.what and fault.expected:
            kept[fault.key] = replace(first, expected=f"{first.expected}, or {fault.expected}")
        else:
            kept[f"{fault.key} {len(kept)}"] = fault
    return list(kept.values())


def _within(place: Location, outer: Location) -> bool:
    return len(place) > len(outer) and place[: len(outer)] == outer


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
    got = (
        f" is {_as_written(value)}" if isinstance(value, str | int | float | bool) else " is of another kind"
    )
    expected = _EXPECTED[fault](error.get("ctx", {}))
    return SchemaFault(key, f"key `{key}`{_describe_length_fault(fault, got)}", expected, f"correct `{key}`")


def _describe_length_fault(fault: str, got: str) -> str:
    return f" {_LENGTH_FAULTS[fault]}" if fault in _LENGTH_FAULTS else got


def _as_written(value: str | float | bool) -> str:
    """Return a value as the file would write it."""
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
    return {} if holder is None else _fields_of(holder)


def _fields_of(kind: type[BaseModel]) -> dict[str, FieldInfo]:
    return {field.alias or name: field for name, field in kind.model_fields.items()}


def _record_at(kind: type[BaseModel], location: Location) -> type[BaseModel] | None:
    """Return the record of the table at `location` of a record; None where that is no single record."""
    for part in location:
        if isinstance(part, int):
            continue  # a list: its members' record was found with its key
        fields = _fields_of(kind)
        if part not in fields:
            continue  # the name of a table in a mapping, found with the mapping's key
        inner = list(_records(fields[part].annotation))
        if len(inner) != 1:
            return None
        kind = inner[0]
    return kind


def _records(annotation: object) -> Iterator[type[BaseModel]]:
    """Yield the records that a type is made of."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for inner in get_args(annotation):
        yield from _records(inner)


def join_by_key(texts: Sequence[tuple[str, str]]) -> str:
    """Join texts on several keys in one line; a single key is not named again."""
    stated = [(key, text) for key, text in texts if text]
    if len(texts) == 1:
        return stated[0][1] if stated else ""
    return "; ".join(f"`{key}`: {text}" for key, text in stated)


R = TypeVar("R", bound=BaseModel)


def load(path: Path, kind: type[R]) -> R:
    """Read `path` and check it against the record `kind`.

    Raises
    ------
    ConfigError
        If the file is missing, is no TOML, or holds a wrong, missing or unknown key.
    """
    return check(read_toml(path), kind, path)


def read_toml(path: Path) -> dict[str, Any]:
    """Return the tables of a TOML file; raise ConfigError with file and line if it cannot be read."""
    return input_files.read_toml(path, ConfigError, file_label(path))


def check(tables: dict[str, Any], kind: type[R], where: Path | str) -> R:
    """Check parsed tables against the record `kind`; `where` is named in the error.

    Types are strict: `"0.1"` is a text and no number. Members of a list are numbered from 1, as layers
    are: `layers.1` is the first one.

    Raises
    ------
    ConfigError
        Listing every wrong, missing or unknown key.
    """
    try:
        # as JSON, whose lists strictly are tuples
        return kind.model_validate_json(json.dumps(tables, default=_encode_date), strict=True)
    except ValidationError as error:
        faults = schema_faults(error, kind)
        raise ConfigError(
            "; ".join(fault.what for fault in faults),
            where=where if isinstance(where, str) else locate_key(where, faults[0].key),
            expected=join_by_key([(fault.key, fault.expected) for fault in faults]),
            fix="; ".join(fault.fix for fault in faults if fault.fix),
        ) from None


def _encode_date(value: object) -> dict[str, str]:
    """Stand in for a date or time, TOML's only values without a JSON form, where no key wants one."""
    return {"date or time": str(value)}
