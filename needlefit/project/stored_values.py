"""Store dataclasses as JSON values, from which the same are read to the last bit: arrays by their bytes."""

from base64 import b64decode, b64encode
from dataclasses import fields, is_dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ConfigDict, TypeAdapter

from needlefit.errors import NeedlefitError

_ARRAY, _ERROR = {"dtype", "shape", "bytes"}, {"error", "parts"}  # keys of what stands for these
_ERRORS: list[type[NeedlefitError]] = [NeedlefitError, *NeedlefitError.__subclasses__()]


def encode(value: object) -> Any:  # noqa: ANN401 - whatever JSON holds
    """Return dataclasses, arrays, errors and paths, and tuples and dicts of them, as JSON has them."""
    if isinstance(value, np.ndarray):
        data = np.ascontiguousarray(value)
        return {"dtype": data.dtype.str, "shape": data.shape, "bytes": b64encode(data.data).decode()}
    if isinstance(value, NeedlefitError):
        return {"error": type(value).__name__, "parts": vars(value)}
    if is_dataclass(value):
        return {field.name: encode(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, tuple | list):
        return [encode(item) for item in value]
    if isinstance(value, dict):
        return {name: encode(item) for name, item in value.items()}
    return str(value) if isinstance(value, Path) else value


def decode(values: Any, kind: Any) -> Any:  # noqa: ANN401 - whatever JSON holds
    """Return what `encode` made these values of, by its type: a dataclass, or a tuple of such.

    ValueError if they are of another.
    """
    return _adapt(kind).validate_python((_restore(values),))[0]


@lru_cache(maxsize=4)  # such an adapter is made of the types of all fields
def _adapt(kind: Any) -> TypeAdapter[Any]:  # noqa: ANN401 - a type, or a union of them
    # a configuration cannot be stated for a dataclass itself
    return TypeAdapter(tuple[kind], config=ConfigDict(arbitrary_types_allowed=True))


def _restore(value: Any) -> Any:  # noqa: ANN401 - whatever JSON holds
    """Return values of JSON with the arrays and errors that stand in them."""
    if isinstance(value, list):
        return [_restore(item) for item in value]
    if not isinstance(value, dict):
        return value
    if value.keys() == _ARRAY:
        array = np.frombuffer(b64decode(value["bytes"]), np.dtype(value["dtype"]))
        return array.reshape(value["shape"]).copy()
    if value.keys() == _ERROR:
        (kind,) = (kind for kind in _ERRORS if kind.__name__ == value["error"])
        return kind(**value["parts"])
    return {name: _restore(item) for name, item in value.items()}
