"""Convert values to the types that JSON knows."""

import math
from collections.abc import Iterable, Mapping


def to_json_values(value: object) -> object:
    """Return mappings, lists, text, numbers and None; numpy's become Python's, NaN and infinity None.

    What is none of these becomes its text.
    """
    value = value.tolist() if hasattr(value, "tolist") else value  # numpy arrays and scalars
    if isinstance(value, Mapping):
        return {str(key): to_json_values(inner) for key, inner in value.items()}
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, str | int):
        return value
    return [to_json_values(inner) for inner in value] if isinstance(value, Iterable) else str(value)
