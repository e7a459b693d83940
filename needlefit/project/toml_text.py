"""Write plain tables as TOML text; the standard library can only read TOML."""

import json
from collections.abc import Mapping
from typing import Any


def dumps(tables: Mapping[str, Any]) -> str:
    """Return `tables` as TOML: values first, then sub-tables; None and empty values are left out."""
    return "\n".join(_lines(tables, ())).lstrip("\n") + "\n"


def _lines(table: Mapping[str, Any], path: tuple[str, ...]) -> list[str]:
    kept = {key: value for key, value in table.items() if value is not None and value not in ("", {}, (), [])}
    values = {key: value for key, value in kept.items() if not isinstance(value, Mapping)}
    lines = [f"{_key(key)} = {_value(value)}" for key, value in values.items()]
    if path and (lines or not kept):
        lines = ["", f"[{'.'.join(map(_key, path))}]", *lines]
    for key, value in kept.items():
        if isinstance(value, Mapping):
            lines += _lines(value, (*path, key))
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
