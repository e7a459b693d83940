"""Dataclasses as plain values and arrays, and back: only the types that a declaration names are built."""

from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, NamedTuple, Union, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray


class Hook(NamedTuple):
    """How a type that is no dataclass of plain values is taken apart, and built again."""

    to_plain: Callable[[Any], object]
    from_plain: Callable[[Any], object]
    kind: Any


Hooks = Mapping[type, Hook]
"""By the type; `kind` declares what `to_plain` returns and `from_plain` is given."""

Arrays = dict[str, NDArray[Any]]


def encode(value: object, hooks: Hooks, arrays: Arrays, place: str = "") -> object:
    """Return a value as JSON values; its arrays are added to `arrays`, and stand there by their place."""
    if type(value) in hooks:
        return encode(hooks[type(value)].to_plain(value), hooks, arrays, place)
    if is_dataclass(value) and not isinstance(value, type):
        parts = ((one.name, getattr(value, one.name)) for one in fields(value))
        return {name: encode(part, hooks, arrays, f"{place}.{name}") for name, part in parts}
    if isinstance(value, tuple):
        return [encode(part, hooks, arrays, f"{place}.{n}") for n, part in enumerate(value)]
    if isinstance(value, np.ndarray):
        arrays[place] = value
        return place
    if isinstance(value, Path):
        return str(value)
    return value.item() if isinstance(value, np.generic) else value


def decode(kind: Any, value: Any, hooks: Hooks, arrays: Mapping[str, NDArray[Any]]) -> Any:  # noqa: ANN401
    """Return the value of a declared type that `encode` took apart.

    Raises
    ------
    ValueError
        If the value is not of that type.
    """
    if kind in hooks:
        hook = hooks[kind]
        return hook.from_plain(decode(hook.kind, value, hooks, arrays))
    origin = get_origin(kind)
    if origin in _OF_ORIGIN:
        return _OF_ORIGIN[origin](kind, value, hooks, arrays)
    if is_dataclass(kind) and isinstance(kind, type):
        return _dataclass(kind, value, hooks, arrays)
    if kind is Path and isinstance(value, str):
        return Path(value)
    if kind is float and type(value) in (int, float):
        return float(value)
    if kind in (str, int, bool, NoneType) and type(value) is kind:
        return value
    raise ValueError(f"no {getattr(kind, '__name__', kind)}")


def _dataclass(kind: type, value: Any, hooks: Hooks, arrays: Mapping[str, NDArray[Any]]) -> Any:  # noqa: ANN401
    hints = get_type_hints(kind)
    names = [one.name for one in fields(kind)]
    if not isinstance(value, dict) or sorted(value) != sorted(names):
        raise ValueError(f"not the fields of {kind.__name__}")
    return kind(**{name: decode(hints[name], value[name], hooks, arrays) for name in names})


def _tuple(kind: Any, value: Any, hooks: Hooks, arrays: Mapping[str, NDArray[Any]]) -> Any:  # noqa: ANN401
    kinds = get_args(kind)
    if not isinstance(value, list):
        raise ValueError("no list")
    if len(kinds) == 2 and kinds[1] is Ellipsis:
        kinds = (kinds[0],) * len(value)
    return tuple(decode(one, part, hooks, arrays) for one, part in zip(kinds, value, strict=True))


def _array(kind: Any, value: Any, hooks: Hooks, arrays: Mapping[str, NDArray[Any]]) -> Any:  # noqa: ANN401
    (wanted,) = get_args(get_args(kind)[1])
    found = arrays.get(value) if isinstance(value, str) else None
    if found is None or found.dtype != np.dtype(wanted):
        raise ValueError(f"no array of {np.dtype(wanted)}")
    return found


def _union(kind: Any, value: Any, hooks: Hooks, arrays: Mapping[str, NDArray[Any]]) -> Any:  # noqa: ANN401
    """Return what is optional; of other unions there are none."""
    if value is None:
        return None
    (only,) = (one for one in get_args(kind) if one is not NoneType)
    return decode(only, value, hooks, arrays)


def _literal(kind: Any, value: Any, hooks: Hooks, arrays: Mapping[str, NDArray[Any]]) -> Any:  # noqa: ANN401
    if type(value) is not str or value not in get_args(kind):
        raise ValueError(f"none of {get_args(kind)}")
    return value


_OF_ORIGIN: Mapping[Any, Callable[..., Any]] = {
    tuple: _tuple,
    np.ndarray: _array,
    Union: _union,
    UnionType: _union,
    Literal: _literal,
}
