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


Hooks = Mapping[type, Hook]  # by the type; `kind` declares what `to_plain` returns and `from_plain` is given
Arrays = dict[str, NDArray[Any]]


def encode(value: object, hooks: Hooks, arrays: Arrays, place: str = "") -> object:
    """Return a value as JSON values; its arrays are added to `arrays`, and stand there by their place."""
    if type(value) in hooks:
        return encode(hooks[type(value)].to_plain(value), hooks, arrays, place)
    if is_dataclass(value) and not isinstance(value, type):
        parts = ((field.name, getattr(value, field.name)) for field in fields(value))
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

    ValueError if the value is not of that type.
    """
    if kind in hooks:
        hook = hooks[kind]
        return hook.from_plain(decode(hook.kind, value, hooks, arrays))
    origin, inside = get_origin(kind), get_args(kind)
    if hasattr(origin, "__value__"):  # an alias with a parameter, as NDArray is from NumPy 2.5 on
        return decode(origin.__value__[inside], value, hooks, arrays)
    if origin in (Union, UnionType) and value is None:
        return None
    if origin in (Union, UnionType):  # what is optional: of other unions there are none
        (only,) = (kind for kind in inside if kind is not NoneType)
        return decode(only, value, hooks, arrays)
    if origin is tuple and isinstance(value, list):
        kinds = (inside[0],) * len(value) if len(inside) == 2 and inside[1] is Ellipsis else inside
        return tuple(decode(kind, part, hooks, arrays) for kind, part in zip(kinds, value, strict=True))
    if origin is Mapping and isinstance(value, dict):
        return {key: decode(inside[1], part, hooks, arrays) for key, part in value.items()}
    if origin is np.ndarray:
        (wanted,) = get_args(inside[1])
        array = arrays.get(value) if isinstance(value, str) else None
        if array is not None and array.dtype == np.dtype(wanted):
            return array
    if origin is Literal and type(value) is str and value in inside:
        return value
    if is_dataclass(kind) and isinstance(kind, type) and isinstance(value, dict):
        hints = get_type_hints(kind)
        names = [field.name for field in fields(kind)]
        if sorted(value) == sorted(names):
            return kind(**{name: decode(hints[name], value[name], hooks, arrays) for name in names})
    if kind is Path and isinstance(value, str):
        return Path(value)
    if kind is float and type(value) in (int, float):
        return float(value)
    if kind in (str, int, bool, NoneType) and type(value) is kind:
        return value
    raise ValueError(f"no {getattr(kind, '__name__', kind)}")
