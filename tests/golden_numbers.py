"""Numbers of a result as they were when it was last looked at: `tests/golden/*.json`.

Closed forms and known truths say that a result is right; these that it is still the same, in every part.
A change that is meant is written by `NEEDLEFIT_WRITE_GOLDEN=1 pytest ...`, and its difference reviewed.
"""

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import is_dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np

GOLDEN = Path(__file__).parent / "golden"
MAX_NUMBERS = 24
"""Of a longer array every so many-th number, and its mean and deviation, are kept."""


def flatten(value, name=""):
    """Return the numbers of nested records, mappings, sequences and arrays by their path, without texts."""
    value = vars(value) if is_dataclass(value) else value
    if isinstance(value, Mapping):
        return {k: v for key, one in value.items() for k, v in flatten(one, f"{name}.{key}").items()}
    if isinstance(value, Sequence) and not isinstance(value, str) and any(map(is_nested, value)):
        return flatten({str(n): one for n, one in enumerate(value)}, name)
    if value is None or isinstance(value, str) or any(isinstance(one, str) for one in np.ravel(value)):
        return {}
    numbers = np.ravel(np.asarray(value, dtype=np.float64))
    known = numbers[np.isfinite(numbers)]
    step = -(-len(numbers) // MAX_NUMBERS) or 1
    summary = [len(known), known.mean(), known.std()] if step > 1 and len(known) else []
    return {name: [*summary, *numbers[::step].tolist()]}


def is_nested(value):
    """Return whether a value holds others, or nothing."""
    return is_dataclass(value) or isinstance(value, Mapping | Sequence | np.ndarray | None)


def assert_golden(name, value, rtol=1e-5, wide=MappingProxyType({})):
    """Compare the numbers of a result with those in `tests/golden/NAME.json`.

    `wide`: absolute tolerances of numbers that differ between processors, by the end of their path.
    """
    found, path = flatten(value), GOLDEN / f"{name}.json"
    if os.environ.get("NEEDLEFIT_WRITE_GOLDEN"):
        rounded = {key: [float(f"{one:.9g}") for one in numbers] for key, numbers in found.items()}
        lines = (f"{json.dumps(key)}: {json.dumps(numbers)}" for key, numbers in rounded.items())
        path.write_text("{\n" + ",\n".join(lines) + "\n}\n")
    golden = json.loads(path.read_text())
    assert golden and found.keys() >= golden.keys()
    for key, numbers in golden.items():
        size = np.nanmax(np.abs(np.array([0.0, *numbers])[np.isfinite([0.0, *numbers])]))
        own = next((tolerance for end, tolerance in wide.items() if key.endswith(end)), rtol * size + 1e-9)
        np.testing.assert_allclose(found[key], numbers, rtol=rtol, atol=own, err_msg=key)
