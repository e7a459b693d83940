"""Convert values to the types that JSON knows, and compute digests of them."""

import hashlib
import json
import math
from collections.abc import Iterable, Mapping
from typing import Any


def to_json_values(value: Any) -> Any:  # noqa: ANN401 - of any type
    """Return mappings, lists, text, numbers and None; numpy's become Python's, NaN and infinity None.

    What is none of these becomes its text.
    """
    if hasattr(value, "tolist"):  # numpy arrays and scalars
        is_finite = (
            type(value).__module__ == "numpy" and value.dtype.kind == "f" and math.isfinite(value.sum())
        )
        value = value.tolist()
        if is_finite:  # each number as it is: the sum of others is not finite
            return value
    if isinstance(value, str | int) or value is None:
        return value
    if isinstance(value, Mapping):
        return {str(key): to_json_values(inner) for key, inner in value.items()}
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return [to_json_values(inner) for inner in value] if isinstance(value, Iterable) else str(value)


def digest_values(values: object) -> str:
    """Return the SHA-256 of values as JSON has them; the order of keys does not count."""
    text = json.dumps(to_json_values(values), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()
