"""Find the curves of needles in nested fields: structs and cells of MATLAB, objects and lists of JSON."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import NDArray

from needlefit.arrays import Floats
from needlefit.datasets.points import Points

MAX_TEXT_CHARS = 200  # of a text that is stated of a curve
MAX_STATED_NUMBERS = 20  # numbers of a vector that is
_COORDINATE = re.compile(r"([xyz])(?:_(mm|cm|dm|um|m))?", re.IGNORECASE)  # `x`, `X_mm`
_UNIT_ENDING = re.compile(r"(\w+)_(mm|cm|um)", re.IGNORECASE)  # of a name of points: `needles_cm`


@dataclass
class FieldCurve:
    """One curve, with the fields beside it, and above it, as text."""

    name: str
    values: Floats  # (N, 3)
    stated: dict[str, str] = field(default_factory=dict)
    axes: str = ""  # names of its coordinates; empty where their order alone tells them apart
    unit: str = ""  # at the end of names of its coordinates, or of its points
    columns: dict[str, list[str]] = field(default_factory=dict)  # fields with a text for each point

    def to_points(self, path: Path) -> Points:
        """Return the curve as one of a file."""
        return Points(
            path, self.values, stated=self.stated, axes=self.axes, unit=self.unit, columns=self.columns
        )


Entries = list[list[FieldCurve]]  # the curves of each entry of a list or stack; of anything else one entry


class FieldReader:
    """Finds all curves in a value, and lists what of it is not used; `noun`: what its fields are called."""

    def __init__(self, noun: str) -> None:
        self.noun = noun
        self.unused: list[str] = []

    def find_curves(self, name: str, value: object) -> list[FieldCurve]:
        """Return every array of shape (N, 3) or (3, N), N > 3, and every group of fields x, y and z.

        Names: `a`, `a_1` in a list, an array of structs or a stack (N, 3, K) or (K, N, 3), `a_b` in a struct;
        a struct with one such array gives it its name. x, y and z are vectors of one length, lists of such
        vectors, or matrices with a column for each curve; without z it is 0. Trailing rows of NaN are left
        out, and in stacks and matrices those of zeros.

        Texts, numbers and short vectors beside curves, or above them, are stated of each; of as many as there
        are curves in a list beside them (rows of a matrix, too) each is stated of one. Vectors beside x, y
        and z of their length are `columns`.
        """
        found = [one for entry in self._find(name, value) for one in entry]
        taken: dict[str, int] = {}
        for one in found:  # `a_1` may be the first entry of `a`, and a field
            taken[one.name] = count = taken.get(one.name, 0) + 1
            one.name = one.name if count == 1 else f"{one.name}-{count}"
        return found

    def _find(self, name: str, value: object) -> Entries:
        value = simplify(value)
        if isinstance(value, list):
            rows = _join_rows(value)
            value = value if rows is None else rows
        unused = len(self.unused)
        found: Entries = []
        if isinstance(value, dict):
            found = self._find_in_struct(name, value)
        elif isinstance(value, list):
            parts = [self._find(f"{name}_{n}".strip("_"), part) for n, part in enumerate(value, 1)]
            found = [[one for entry in part for one in entry] for part in parts]
        elif (stack := _to_stack(value)) is not None:
            found = self._name_curves(name, stack)
        elif (points := to_points(value)) is not None:
            found = self._name_curves(name, [points])
        if any(found):
            return found
        self.unused[unused:] = [f"{self.noun} {name}"] if name else []  # one name for all that it holds
        return []

    def _find_in_struct(self, name: str, fields: Mapping[str, object]) -> Entries:
        parts = {key: simplify(part) for key, part in fields.items()}
        found: dict[str, Entries] = {}
        beside: dict[str, object] = {}  # what holds no curves
        coordinates = _take_coordinates(parts)
        own = () if coordinates is None else coordinates.keys
        self._collect(name, {key: part for key, part in parts.items() if key not in own}, found, beside)
        is_other = bool(found) or any(to_points(part) is not None for part in beside.values())
        if coordinates is not None and len(own) < 3 and is_other:  # x and y alone may be anything
            self._collect(name, {key: parts[key] for key in own}, found, beside)
        elif coordinates is not None:
            found[own[0]] = self._place_coordinates(name or "curve", coordinates, beside)
        self._collect_matrices(name, found, beside)
        for key, entries in found.items():
            for curve in (one for entry in entries for one in entry):
                curve.unit = curve.unit or _find_unit(key)
        used = {key for entries in found.values() for key in _state(entries, beside)}
        left = [f"{name}_{key}".strip("_") for key in beside if found and key not in used]
        self.unused += [f"{self.noun} {key}" for key in left]
        groups = [found[key] for key in parts if key in found]
        if len(groups) == 1:
            return groups[0]
        return [[one for entries in groups for entry in entries for one in entry]]

    def _collect(
        self, name: str, parts: Mapping[str, object], found: dict[str, Entries], beside: dict[str, object]
    ) -> None:
        """Add the curves in structs, lists and stacks to what is found, and everything else to `beside`."""
        for key, part in parts.items():
            inner = FieldReader(self.noun)
            is_nested = isinstance(part, list | dict) or _to_stack(part) is not None
            if is_nested and any(entries := inner._find(f"{name}_{key}".strip("_"), part)):
                found[key] = entries
                self.unused += inner.unused
            else:
                beside |= _flatten(key, part)

    def _collect_matrices(self, name: str, found: dict[str, Entries], beside: dict[str, object]) -> None:
        """Move matrices of points from `beside` to what is found; a row for each curve of a list is none."""
        counts = {len(entries) for entries in found.values()}
        arrays = {key: points for key, part in beside.items() if (points := to_points(part)) is not None}
        arrays = {key: points for key, points in arrays.items() if len(points) not in counts}
        for key, points in arrays.items():
            title = name if name and len(arrays) == 1 else f"{name}_{key}".strip("_")
            found[key] = self._name_curves(title, [points])
            del beside[key]

    def _place_coordinates(
        self, name: str, coordinates: "_Coordinates", beside: dict[str, object]
    ) -> Entries:
        """Return the curves of fields x, y and z; one takes the vectors of its length from `beside`."""
        entries = self._name_curves(name, coordinates.curves, coordinates.is_padded)
        for curve in (one for entry in entries for one in entry):
            curve.axes = "x, y, z" if len(coordinates.keys) == 3 else "x, y; z is 0"
        if len(entries) == 1 and entries[0]:
            (curve,), length = entries[0], len(coordinates.curves[0])
            vectors = {key: part for key, part in beside.items() if _is_vector(part, length)}
            columns = {key: _split(part, length) for key, part in vectors.items()}
            curve.columns = {key: own[: len(curve.values)] for key, own in columns.items() if own is not None}
            for key in curve.columns:
                del beside[key]
        return entries

    def _name_curves(self, name: str, curves: Sequence[Floats], is_padded: bool | None = None) -> Entries:
        """Return curves by number, without their padding; an empty one gives an empty entry."""
        kept = _strip_padding(curves, len(curves) > 1 if is_padded is None else is_padded)
        lost = [len(whole) - len(own) for whole, own in zip(curves, kept, strict=True)]
        if any(lost):
            padded = sum(count > 0 for count in lost)
            rows = f"{sum(lost)} rows of NaN or zeros at the end of"
            self.unused.append(f"{rows} {name if len(curves) == 1 else f'{padded} curves of {name}'}")
        numbered = [name] if len(curves) == 1 else [f"{name}_{n}" for n in range(1, len(curves) + 1)]
        return [[FieldCurve(*one)] if len(one[1]) else [] for one in zip(numbered, kept, strict=True)]


def _state(entries: Entries, beside: Mapping[str, object]) -> Iterator[str]:
    """State of curves what stands beside them, its own of each or the same of all; yield what is stated."""
    filled = [entry for entry in entries if entry]
    for key, part in beside.items():
        text = to_text(part)
        of_all = None if text is None else [text] * len(filled)
        choices = [
            (entries, _split(part, len(entries))),
            (filled, _split(part, len(filled))),
            (filled, of_all),
        ]
        ones, texts = next(((ones, texts) for ones, texts in choices if texts is not None), ([], []))
        pairs = [(curve, own) for entry, own in zip(ones, texts, strict=True) for curve in entry]
        kept = [curve.stated.setdefault(key.rpartition(".")[2], own) for curve, own in pairs]
        if any(one == own for one, (_, own) in zip(kept, pairs, strict=True)):
            yield key  # else what stands nearer to the curves states something else


def _find_unit(key: str) -> str:
    """Return the unit at the end of the name of a coordinate or of points; empty if there is none."""
    match = _COORDINATE.fullmatch(key) or _UNIT_ENDING.fullmatch(key)
    return match[2].lower() if match and match[2] else ""


# ---- values


def simplify(value: object) -> object:
    """Return a value without object arrays: lists, arrays of numbers, texts, structs as dicts."""
    if isinstance(value, np.ndarray) and value.dtype.kind in "OUS":
        if value.size and all(isinstance(one, int | float) for one in value.flat):
            return value.astype(np.float64)
        return value.item() if value.ndim == 0 else value.ravel().tolist()
    if isinstance(value, list) and value and all(_is_number(one) for one in value):
        return np.array(value, dtype=np.float64)
    return value


def _join_rows(parts: list[Any]) -> dict[str, Any] | None:
    """Return the fields of an array of structs with one point each as vectors; None of anything else."""
    if not parts or not all(isinstance(one, dict) and one.keys() == parts[0].keys() for one in parts):
        return None
    axes = [key for key in parts[0] if _COORDINATE.fullmatch(key)]
    is_point = len(axes) > 1 and all(_is_number(one[key]) for one in parts for key in axes)
    return {key: [one[key] for one in parts] for key in parts[0]} if is_point else None


def _flatten(key: str, part: object) -> dict[str, object]:
    """Return the fields of a struct without curves, or of an array of such structs, by `key.field`."""
    if isinstance(part, list) and part and all(isinstance(one, dict) for one in part):
        names = dict.fromkeys(name for one in part for name in one)
        part = {name: [one.get(name, "") for one in part] for name in names}
    if not isinstance(part, dict):
        return {key: part}
    inner = {f"{key}.{name}": one for name, one in part.items()}
    return {
        path: value for name, one in inner.items() for path, value in _flatten(name, simplify(one)).items()
    }


def to_points(value: object) -> Floats | None:
    """Return an array of shape (N, 3) or (3, N), N > 3, as points (N, 3); None for anything else."""
    if not _is_real(value) or value.ndim != 2 or 3 not in value.shape or max(value.shape) <= 3:
        return None
    return np.ascontiguousarray(value if value.shape[1] == 3 else value.T, dtype=np.float64)


def _to_stack(value: object) -> list[Floats] | None:
    """Return the curves of one size in an array of three dimensions; None for anything else."""
    if not _is_real(value) or value.ndim != 3 or 3 not in value.shape:
        return None
    if not (value.shape[2] == 3 < value.shape[1]):
        value = np.moveaxis(value, 2, 0)
    curves = [to_points(one) for one in value]
    return None if any(one is None for one in curves) else curves  # type: ignore[return-value]


def to_text(value: object) -> str | None:
    """Return a text, a number or a few numbers as text, without NaN; None for anything else."""
    if isinstance(value, str):
        return value[:MAX_TEXT_CHARS].strip()
    if isinstance(value, list) and len(value) == 1:
        return to_text(value[0])
    if value is None or (isinstance(value, list) and not value):
        return ""
    array = np.asarray(value) if isinstance(value, int | float | np.ndarray | np.generic) else None
    if array is None or array.size > MAX_STATED_NUMBERS or max(array.shape, default=1) < array.size:
        return None
    if not (_is_real(array) or array.dtype == bool):
        return None
    return ", ".join(f"{float(one):.10g}" for one in array.ravel() if np.isfinite(one))


def _is_vector(value: object, length: int) -> bool:
    if isinstance(value, np.ndarray):
        return value.size == max(value.shape, default=0) == length
    return isinstance(value, list) and len(value) == length


def _split(value: object, count: int) -> list[str] | None:
    """Return the texts of `count` entries of a vector or list, or rows of a matrix; None of anything else."""
    if count < 2:
        return None
    if _is_vector(value, count):
        parts = value.ravel().tolist() if isinstance(value, np.ndarray) else value
    elif isinstance(value, np.ndarray) and value.ndim == 2 and count in value.shape:
        parts = [*(value if len(value) == count else value.T)]
    else:
        return None
    texts = [to_text(simplify(one)) for one in parts]  # type: ignore[attr-defined]
    return None if None in texts else texts  # type: ignore[return-value]


@dataclass(frozen=True)
class _Coordinates:
    """The curves of fields x, y and z, and the names of these."""

    keys: Sequence[str]
    curves: Sequence[Floats]
    is_padded: bool  # columns of matrices, of which shorter ones are filled up


def _take_coordinates(fields: Mapping[str, object]) -> _Coordinates | None:
    """Return the curves of fields x, y and, if there is one, z; None where they are none."""
    found = sorted((match[1].lower(), key) for key in fields if (match := _COORDINATE.fullmatch(key)))
    keys = [key for _, key in found]
    units = {_find_unit(key) for key in keys}
    if "".join(axis for axis, _ in found) not in ("xy", "xyz") or len(units) > 1:
        return None
    columns = [_to_columns(fields[key]) for key in keys]
    sizes = {tuple(map(len, one)) for one in columns}
    if len(sizes) > 1 or max(map(len, columns[0]), default=0) <= 3:
        return None
    zeros = [[0.0 * one for one in columns[0]]] * (3 - len(columns))  # NaN where x is
    curves = [np.column_stack(axes).astype(np.float64) for axes in zip(*columns, *zeros, strict=True)]
    is_padded = len(curves) > 1 and all(isinstance(fields[key], np.ndarray) for key in keys)
    return _Coordinates(keys, curves, is_padded)


def _to_columns(value: object) -> list[NDArray[Any]]:
    """Return a vector, the vectors of a list, or the columns of a matrix; nothing of anything else."""
    if isinstance(value, list):
        vectors = [_to_columns(simplify(one)) for one in value]
        return [one[0] for one in vectors] if all(len(one) == 1 for one in vectors) else []
    if not _is_real(value) or not value.size:
        return []
    if value.size == max(value.shape, default=0):
        return [value.ravel()]
    return [*value.T] if value.ndim == 2 else []


def _strip_padding(curves: Sequence[Floats], is_padded: bool) -> list[Floats]:
    """Return curves without NaN at their ends and, if they have been made of one length, without zeros.

    Zeros are padding where a curve ends with several; if every curve ends with one, that is a point.
    """
    kept = [one[: len(one) - _count_trailing(np.isnan(one).all(axis=1))] for one in curves]
    zeros = [_count_trailing(~one.any(axis=1)) for one in kept]
    is_empty = [count == len(one) for count, one in zip(zeros, kept, strict=True)]
    last = min((count for count, empty in zip(zeros, is_empty, strict=True) if not empty), default=0)
    if not is_padded or max(zeros, default=0) < 2:
        return kept
    points = [0 if empty else int(last == 1) for empty in is_empty]
    return [one[: len(one) - count + point] for one, count, point in zip(kept, zeros, points, strict=True)]


def _count_trailing(flags: Any) -> int:  # noqa: ANN401 - numpy's stubs: a scalar, or an array (N,)
    """Return how many values at the end are true."""
    return len(flags) if flags.all() else int(np.argmin(flags[::-1]))


def _is_number(value: object) -> bool:
    return isinstance(value, int | float | np.number) and not isinstance(value, bool)


def _is_real(value: object) -> TypeGuard[NDArray[Any]]:
    if not isinstance(value, np.ndarray):
        return False
    return bool(np.issubdtype(value.dtype, np.number) and not np.iscomplexobj(value))
