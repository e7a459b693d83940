"""Read JSON, and lines of it: objects with the points of a curve as N x 3 numbers, or as fields x, y, z."""

import math
from pathlib import Path
from typing import Any

import numpy as np

from needlefit.datasets.fields import FieldReader
from needlefit.datasets.formats import FileFormat, ReadCurves
from needlefit.datasets.formats.markups import holds_markups
from needlefit.errors import DataError
from needlefit.project.input_files import parse_json, read_json, read_text

MAX_NUMBER = 2**63  # largest whole number that is read: beyond it numpy has no integer
MAX_NESTING = 20  # largest depth of objects and lists within each other
_FIX = 'write an object a line: {"id": "n1", "points": [[0, 0, 0], [5, 0.1, 0], ...]}'


def read_curves(path: Path) -> ReadCurves:
    """Return every curve that `FieldReader` finds in a file, or its lines, by name, and what is not used.

    DataError if the file is missing, a line is no JSON, or there is no curve.
    """
    reader, is_whole = FieldReader("field"), path.suffix.lower() == ".json"
    if is_whole:
        objects, name = _to_arrays(read_json(path), str(path)), ""
    else:
        lines = [
            (f"{path}:{n}", line) for n, line in enumerate(read_text(path).split("\n"), 1) if line.strip()
        ]
        objects, name = [_to_arrays(parse_json(line, where), where) for where, line in lines], path.stem
    curves = {curve.name: curve.to_points(path) for curve in reader.find_curves(name, objects)}
    if not curves:
        raise DataError(
            "holds no curve",
            expected="points of a needle in each object, or line, as N x 3 numbers, N > 3",
            fix=_FIX,
            where=path,
        )
    return curves, reader.unused


def _to_arrays(value: Any, where: str, depth: int = 0) -> object:  # noqa: ANN401 - whatever a line holds
    """Return a value with arrays for lists of numbers of one length."""
    if depth > MAX_NESTING:
        raise DataError(
            f"has more than {MAX_NESTING} levels",
            expected="an object of numbers and lists",
            fix=_FIX,
            where=where,
        )
    if isinstance(value, dict):
        return {key: _to_arrays(part, where, depth + 1) for key, part in value.items()}
    if isinstance(value, int) and abs(value) > MAX_NUMBER:  # more digits than a float has
        return math.inf
    if not isinstance(value, list):
        return value
    try:
        array = np.array(value)
    except ValueError:  # lists of several lengths
        array = np.empty(0, dtype=object)
    return array if array.dtype.kind in "iuf" else [_to_arrays(part, where, depth + 1) for part in value]


JSONL = FileFormat(
    "jsonl",
    (".jsonl", ".ndjson", ".json"),
    read_curves,
    is_of_format=lambda path: not holds_markups(path),
)
