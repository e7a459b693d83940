"""Convert values to the types that JSON knows, and compute digests of them."""

import hashlib
import json
from collections.abc import Iterable, Mapping
from typing import Any


def to_json_values(value: object) -> Any:  # noqa: ANN401 - of any type
    """Return mappings, lists, text, numbers and None; numpy's become Python's, NaN and infinity None.

    What is none of these becomes its text.
    """
    from pydantic_core import to_jsonable_python  # late: it takes a tenth of the time of --help

    return to_jsonable_python(value, inf_nan_mode="null", fallback=_to_plain)


def _to_plain(value: object) -> object:
    if hasattr(value, "tolist"):  # numpy arrays and scalars
        return value.tolist()
    if isinstance(value, Mapping):
        return dict(value)
    return [*value] if isinstance(value, Iterable) else str(value)


def digest_values(values: object) -> str:
    """Return the SHA-256 of values as JSON has them; the order of keys does not count."""
    text = json.dumps(to_json_values(values), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()
