"""Change single keys of a TOML file from the command line: `bevel.offset_mm=0.1`, `layers.1.mu_pa=3e5`."""

import copy
import difflib
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, get_args, get_origin

from pydantic import BaseModel

from needlefit.errors import ConfigError
from needlefit.project.input_files import parse_toml


def override(
    tables: Mapping[str, Any], assignments: Sequence[tuple[str, str]], kind: type[BaseModel], where: str
) -> dict[str, Any]:
    """Return a copy of `tables` in which each dotted key has its new value, or is gone if that is empty.

    Members of a list are numbered from 1: `layers.1` is the first layer, `steps.1` the first step.

    Raises
    ------
    ConfigError
        If the record `kind` has no such key; the nearest ones are listed.
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
        table = _find_table(changed, path)
        if text:
            table[name] = _parsed(text, f"{where}, --set {key}")
        else:
            table.pop(name, None)
    return changed


def list_keys(kind: type[BaseModel], tables: Mapping[str, Any]) -> Iterator[str]:
    """Yield every dotted key that a file of this kind may hold; lists are as long as in `tables`.

    The tables of a mapping are called like the members of the file's list of the same name: what a step
    changes of a guide is `steps.2.guides.template.y_mm` where one of `guides` has the name `template`.
    """
    return _keys(kind, tables, tables)


def _keys(kind: type[BaseModel], tables: Mapping[str, Any], file: Mapping[str, Any]) -> Iterator[str]:
    for name, field in kind.model_fields.items():
        name = field.alias or name
        inner: Any = field.annotation
        if _is_record(inner):
            yield from (f"{name}.{key}" for key in _keys(inner, tables.get(name, {}), file))
        elif get_origin(inner) is tuple and _is_record(get_args(inner)[0]):
            for number, member in enumerate(tables.get(name, []), start=1):
                yield from (f"{name}.{number}.{key}" for key in _keys(get_args(inner)[0], member, file))
        elif get_origin(inner) is dict and _is_record(get_args(inner)[1]):
            for member in (member["name"] for member in file.get(name, []) if "name" in member):
                yield from (f"{name}.{member}.{key}" for key in _keys(get_args(inner)[1], {}, file))
        elif name != "schema":
            yield name


def _is_record(annotation: object) -> bool:
    return isinstance(annotation, type) and issubclass(annotation, BaseModel)


def _find_table(tables: dict[str, Any], path: Sequence[str]) -> dict[str, Any]:
    """Return the table at `path`, making those on the way that the file leaves to defaults."""
    table: Any = tables
    for part in path:
        table = table[int(part) - 1] if part.isdigit() else table.setdefault(part, {})
    found: dict[str, Any] = table
    return found


def _parsed(text: str, where: str) -> object:
    """Return a TOML value; what is none (`ogden`) is a string. ConfigError as `parse_toml`."""
    try:
        tomllib.loads(f"value = {text}")
    except tomllib.TOMLDecodeError:
        return text
    except (RecursionError, ValueError):
        pass  # `parse_toml` says why
    return parse_toml(f"value = {text}", where)["value"]
