"""What pydantic finds wrong in a file, in needlefit's words: the key, what was expected there, what to do."""

import difflib
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

Location = tuple[int | str, ...]
Context = dict[str, Any]


@dataclass(frozen=True)
class SchemaFault:
    """One wrong, missing or unknown key of a file."""

    key: str
    what: str
    expected: str
    mend: str


_WORDS: dict[type, str] = {
    float: "a number, without quotes",
    int: "a whole number, without quotes",
    str: 'a text, in quotes ("...")',
    bool: "true or false, without quotes",
}
_EXPECTED: dict[str, Callable[[Context], str]] = {
    "greater_than": lambda said: f"a number above {said['gt']:g}",
    "greater_than_equal": lambda said: f"a number of at least {said['ge']:g}",
    "less_than": lambda said: f"a number below {said['lt']:g}",
    "less_than_equal": lambda said: f"a number of at most {said['le']:g}",
    "finite_number": lambda _: "a finite number",
    "literal_error": lambda said: str(said["expected"]).replace("'", '"'),
    "too_short": lambda said: f"a list of at least {said['min_length']}",
    "too_long": lambda said: f"a list of at most {said['max_length']}",
    "string_pattern_mismatch": lambda _: "a letter, then letters, digits, - or _",
    "float_type": lambda _: _WORDS[float],
    "float_parsing": lambda _: _WORDS[float],
    "int_type": lambda _: _WORDS[int],
    "int_parsing": lambda _: _WORDS[int],
    "int_from_float": lambda _: _WORDS[int],
    "string_type": lambda _: _WORDS[str],
    "bool_type": lambda _: _WORDS[bool],
    "bool_parsing": lambda _: _WORDS[bool],
    "tuple_type": lambda _: "a list: [..., ...], or a table [[...]] for each member",
    "dict_type": lambda _: "a table of keys and values",
    "model_type": lambda _: "a table of keys and values",
}
_MEMBER = re.compile(r"constrained-|literal\[")
_AMISS = {"too_short": "has too few members", "too_long": "has too many members"}


def schema_faults(error: ValidationError, kind: type[BaseModel]) -> list[SchemaFault]:
    """Return what is wrong with a file that should be a record `kind`.

    Members of a list are numbered from 1. A list is not called too short for members that are wrong
    themselves.
    """
    found = error.errors()
    places = [_written(each["loc"]) for each in found]
    faults = [
        _in_words(each["type"], place, each, kind)
        for each, place in zip(found, places, strict=True)
        if each["type"] != "too_short" or not any(_within(other, place) for other in places)
    ]
    return _one_for_each_key(faults)


def _written(location: Location) -> Location:
    """Return a location without pydantic's names for the members of a union."""
    return tuple(part for part in location if not (isinstance(part, str) and _MEMBER.match(part)))


def _one_for_each_key(faults: list[SchemaFault]) -> list[SchemaFault]:
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


def _in_words(fault: str, location: Location, error: ErrorDetails, kind: type[BaseModel]) -> SchemaFault:
    key = ".".join(str(part + 1 if isinstance(part, int) else part) for part in location)
    if fault == "extra_forbidden":
        return _unknown(key, location, kind)
    if fault == "missing":
        return SchemaFault(key, f"key `{key}` is missing", _missing(location, kind), f"add `{key}`")
    message = error["msg"].removeprefix("Value error, ")
    if fault not in _EXPECTED:  # the record's own words, which say what to do
        what, mend = (f"key `{key}`: {message}", f"`{key}`") if key else (message, "the keys named")
        return SchemaFault(key, what, "", f"change {mend} accordingly")
    value = error.get("input")
    got = (
        f" is {_as_written(value)}" if isinstance(value, str | int | float | bool) else " is of another kind"
    )
    expected = _EXPECTED[fault](error.get("ctx", {}))
    return SchemaFault(key, f"key `{key}`{_amiss(fault, got)}", expected, f"correct `{key}`")


def _amiss(fault: str, got: str) -> str:
    return f" {_AMISS[fault]}" if fault in _AMISS else got


def _as_written(value: str | float | bool) -> str:
    """Return a value as the file would write it."""
    if isinstance(value, bool):
        return str(value).lower()
    return f'"{value}"' if isinstance(value, str) else f"{value!r}"


def _unknown(key: str, location: Location, kind: type[BaseModel]) -> SchemaFault:
    known = list(_fields(kind, location[:-1]))
    near = difflib.get_close_matches(str(location[-1]), known, n=1, cutoff=0.5)
    return SchemaFault(
        key,
        f"key `{key}` is unknown" + (f"; did you mean `{near[0]}`?" if near else ""),
        f"one of {', '.join(known)}" if known else "",
        f"write `{near[0]}`, or leave it out" if near else f"leave `{key}` out",
    )


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
        text for type_, text in _WORDS.items() if type_ in (field.annotation, *get_args(field.annotation))
    ]
    return words[0] if words else "a table of keys and values"


def _fields(kind: type[BaseModel], location: Location) -> dict[str, FieldInfo]:
    """Return the keys of the table at `location` of a record; none where that is no single record."""
    for part in location:
        if isinstance(part, int):
            continue  # a list: its members' record was found with its key
        fields = {field.alias or name: field for name, field in kind.model_fields.items()}
        if part not in fields:
            continue  # the name of a table in a mapping, found with the mapping's key
        inner = list(_records(fields[part].annotation))
        if len(inner) != 1:
            return {}
        kind = inner[0]
    return {field.alias or name: field for name, field in kind.model_fields.items()}


def _records(annotation: object) -> Iterator[type[BaseModel]]:
    """Yield the records that a type is made of."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for inner in get_args(annotation):
        yield from _records(inner)


def together(texts: Sequence[tuple[str, str]]) -> str:
    """Return what is said of several keys in one line; of a single one without naming it again."""
    said = [(key, text) for key, text in texts if text]
    if len(texts) == 1:
        return said[0][1] if said else ""
    return "; ".join(f"`{key}`: {text}" for key, text in said)
