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
from needlefit.grouping import group_values

MAX_TEXT_CHARS = 200  # longest text that is stated of a curve (characters)
MAX_STATED_NUMBERS = 20  # largest number of numbers in a vector that is stated of a curve
# pattern of a coordinate: `x`, `X_mm`
_COORDINATE = re.compile(r"([xyz])(?:_(mm|cm|dm|um|m))?", re.IGNORECASE)
# pattern of a name of points with a unit: `needles_cm`
_UNIT_ENDING = re.compile(r"(\w+)_(mm|cm|um)", re.IGNORECASE)


@dataclass
class FieldCurve:
    """One curve, with the fields beside it, and above it, as text."""

    name: str
    values: Floats  # (N, 3)
    stated: dict[str, str] = field(default_factory=dict)
    unit: str = ""  # at the end of names of its coordinates, or of its points
    columns: dict[str, list[str]] = field(default_factory=dict)  # fields with a text for each point

    def to_points(self, path: Path) -> Points:
        """Return the curve as one of a file."""
        return Points(path, self.values, stated=self.stated, unit=self.unit, columns=self.columns)


Entries = list[list[FieldCurve]]  # the curves of each entry of a list or stack; of anything else one entry


class FieldReader:
    """Finds all curves in a value, and remarks what of it is ignored; `noun`: what its fields are called."""

    def __init__(self, noun: str) -> None:
        self.noun = noun
        self.unused = list[str]()
        self.axes = 3  # number of coordinates of a point in an array
        self.curve_fields: set[str] = set()  # names of fields that hold curves in an entry of a list

    def find_curves(self, name: str, value: object) -> list[FieldCurve]:
        """Return every array of shape (N, 3) or (3, N), N > 3, and every group of fields x, y and z.

        Where there is neither, arrays (N, 2) or (2, N) are curves in a plane, whose z is 0. Where a field
        holds curves in some entries of a list, three numbers in another entry are a tip: N = 1.
        Names: `a`, `a_1` in a list, an array of structs or a stack (N, 3, K) or (K, N, 3), `a_b` in a struct;
        a struct with one such array gives it its name. x, y and z are vectors of one length, lists of such
        vectors, or matrices with a column for each curve; without z it is 0. Trailing rows of NaN are left
        out, and in stacks and matrices those of zeros.

        Texts, numbers and short vectors beside curves, or above them, are stated of each; of as many as there
        are curves in a list beside them (rows of a matrix, too) each is stated of one. Vectors beside a
        curve, of its length, are `columns`.
        """
        plain, curves = simplify(value), list[FieldCurve]()
        for self.axes in (3, 2):
            if not curves:
                self.unused.clear()
                curves = [curve for entry in self._find(name, plain) for curve in entry]
        taken: dict[str, int] = {}
        for curve in curves:  # `a_1` may be the first entry of `a`, and a field
            taken[curve.name] = count = taken.get(curve.name, 0) + 1
            curve.name = curve.name if count == 1 else f"{curve.name}-{count}"
        return curves

    def _find(self, name: str, value: object) -> Entries:
        unused = len(self.unused)
        if isinstance(value, dict):
            entries = self._find_in_struct(name, value)
        elif isinstance(value, list):
            structs = [part for part in value if isinstance(part, dict)]
            self.curve_fields |= {
                key
                for struct in structs
                for key, part in struct.items()
                if len(to_curves(part, self.axes)) == 1
            }
            parts = [self._find(_join(name, n), part) for n, part in enumerate(value, 1)]
            entries = [[curve for entry in part for curve in entry] for part in parts]
        else:
            entries = self._name_curves(name, to_curves(value, self.axes))
        if any(entries):
            return entries
        self.unused[unused:] = (
            [f"{self.noun} {name} ignored"] if name else []
        )  # one name for all that it holds
        return []

    def _find_in_struct(self, name: str, fields: Mapping[str, object]) -> Entries:
        axes = _find_coordinates(fields)
        by_field: dict[str, Entries] = {}
        arrays: dict[str, list[Floats]] = {}
        beside: dict[str, object] = {}  # what holds no curves
        for key, part in fields.items():
            unused, curves = len(self.unused), [] if key in axes else to_curves(part, self.axes)
            if not curves and key in self.curve_fields and _is_real(part) and part.size == 3:
                curves = [part.astype(np.float64).reshape(1, 3)]
            is_nested = len(curves) > 1 or (isinstance(part, list | dict) and key not in axes)
            if is_nested and any(entries := self._find(_join(name, key), part)):
                by_field[key] = entries
                continue
            del self.unused[unused:]
            if curves:
                arrays[key] = curves
            elif key not in axes:
                beside |= _flatten(key, part)
        counts = {len(entries) for entries in by_field.values()}
        if axes and (len(axes) == 3 or not (by_field or arrays)):  # x and y alone may be anything
            by_field[axes[0]] = self._place_coordinates(name, {key: fields[key] for key in axes}, beside)
        else:
            beside |= {key: fields[key] for key in axes}
        columns = set[str]()
        for key, curves in arrays.items():
            if len(curves[0]) in counts:  # a row for each curve of a list
                beside[key] = fields[key]
            else:
                by_field[key] = self._name_curves(
                    name if name and len(arrays) == 1 else _join(name, key), curves
                )
                columns |= _take_columns(by_field[key], len(curves[0]), beside)
        beside = {key: part for key, part in beside.items() if key not in columns}
        for key, entries in by_field.items():
            for curve in (member for entry in entries for member in entry):
                curve.unit = curve.unit or _find_unit(key)
        used = {key for entries in by_field.values() for key in _state(entries, beside)}
        self.unused += [
            f"{self.noun} {_join(name, key)} ignored" for key in beside if by_field and key not in used
        ]
        groups = [by_field[key] for key in fields if key in by_field]
        return (
            groups[0]
            if len(groups) == 1
            else [[member for group in groups for entry in group for member in entry]]
        )

    def _place_coordinates(self, name: str, axes: Mapping[str, object], beside: dict[str, object]) -> Entries:
        """Return the curves of fields x, y and z; one takes the vectors of its length from `beside`."""
        columns = [_to_columns(part) for part in axes.values()]
        zeros = [[0.0 * vector for vector in columns[0]]] * (3 - len(columns))  # NaN where x is
        curves = [
            np.column_stack(vectors).astype(np.float64) for vectors in zip(*columns, *zeros, strict=True)
        ]
        is_padded = len(curves) > 1 and all(isinstance(part, np.ndarray) for part in axes.values())
        entries = self._name_curves(name or "curve", curves, is_padded)
        for key in _take_columns(entries, len(curves[0]), beside):
            del beside[key]
        return entries

    def _name_curves(self, name: str, curves: Sequence[Floats], is_padded: bool | None = None) -> Entries:
        """Return curves by number, without their padding; an empty one gives an empty entry."""
        kept = _strip_padding(curves, len(curves) > 1 if is_padded is None else is_padded)
        lost = [len(whole) - len(stripped) for whole, stripped in zip(curves, kept, strict=True)]
        if any(lost):
            padded = sum(count > 0 for count in lost)
            place = name if len(curves) == 1 else f"{padded} curves of {name}"
            self.unused.append(f"{sum(lost)} rows of NaN or zeros at the end of {place} ignored")
        names = [name if len(curves) == 1 else f"{name}_{n}" for n, _ in enumerate(kept, 1)]
        return [[FieldCurve(*named)] if len(named[1]) else [] for named in zip(names, kept, strict=True)]


def _join(name: str, part: object) -> str:
    return f"{name}_{part}".strip("_")


def _state(entries: Entries, beside: Mapping[str, object]) -> Iterator[str]:
    """State of curves what stands beside them, its own of each or the same of all; yield what is stated."""
    filled = [entry for entry in entries if entry]
    for key, part in beside.items():
        per_entry = _split(part, len(entries))
        texts: Sequence[str | None] = per_entry or _split(part, len(filled)) or [to_text(part)] * len(filled)
        pairs = zip(entries if per_entry else filled, texts, strict=True)
        for curve, text in ((member, text) for entry, text in pairs if text is not None for member in entry):
            if curve.stated.setdefault(key.rpartition(".")[2], text) == text:
                yield key  # else what stands nearer to the curves states something else


def _take_columns(entries: Entries, length: int, beside: Mapping[str, object]) -> set[str]:
    """Let one curve of so many points take the vectors of its length as columns; return their names."""
    if len(entries) != 1 or not entries[0]:
        return set()
    (curve,) = entries[0]
    vectors = {key: part for key, part in beside.items() if _is_vector(part, length)}
    texts = {key: texts for key, part in vectors.items() if (texts := _split(part, length)) is not None}
    curve.columns |= {key: cells[: len(curve.values)] for key, cells in texts.items()}
    return {*texts}


def _find_unit(key: str) -> str:
    """Return the unit at the end of the name of a coordinate or of points; empty if there is none."""
    match = _COORDINATE.fullmatch(key) or _UNIT_ENDING.fullmatch(key)
    return match[2].lower() if match and match[2] else ""


# ---- values


def simplify(value: object) -> Any:  # noqa: ANN401 - whatever a file holds
    """Return a value without object arrays: lists, arrays of numbers, texts, structs as dicts.

    An array of structs with one point each is the struct of their columns, those of fields in fields too.
    """
    if isinstance(value, np.ndarray) and value.dtype.kind in "OUS":
        value = value.item() if value.ndim == 0 else value.ravel().tolist()
    if isinstance(value, dict):
        return {key: simplify(part) for key, part in value.items()}
    if not isinstance(value, list) or not value:
        return value
    if all(_is_number(part) for part in value):
        return np.array(value, dtype=np.float64)
    if all(isinstance(part, dict) for part in value) and (columns := _find_columns(value)):
        return columns
    return [simplify(part) for part in value]


def _find_columns(structs: Sequence[Mapping[str, object]]) -> dict[str, object]:
    """Return the columns of structs with one point each; nothing where none, or several, are in each.

    The point may be in a field of a field, whose name is left out: `x` of `pose.position.x`. x, y and z
    beside w are a quaternion.
    """
    rows = [{key[1:]: part for key, part in _flatten("", struct).items()} for struct in structs]
    fields = group_values((key.rpartition(".")[0], key) for key in rows[0])
    axes = {
        name: [key for key in keys if _COORDINATE.fullmatch(key.rpartition(".")[2])]
        for name, keys in fields.items()
        if f"{name}.w".lstrip(".") not in keys
    }
    places = [name for name, keys in axes.items() if len(keys) > 1]
    has_curves = any(to_curves(part, count) for part in rows[0].values() for count in (2, 3))
    if "" not in places and (len(places) != 1 or has_curves):
        return {}
    place = "" if "" in places else places[0]
    if not all(_is_number(row.get(key)) for row in rows for key in axes[place]):
        return {}
    names = {key: key.removeprefix(f"{place}.") if key in axes[place] else key for key in rows[0]}
    return {name: simplify([row.get(key, "") for row in rows]) for key, name in names.items()}


def _flatten(key: str, part: object) -> dict[str, object]:
    """Return the fields of a struct without curves, or of an array of such structs, by `key.field`."""
    if isinstance(part, list) and part and all(isinstance(struct, dict) for struct in part):
        names = dict.fromkeys(name for struct in part for name in struct)
        part = {name: simplify([struct.get(name, "") for struct in part]) for name in names}
    if not isinstance(part, dict):
        return {key: part}
    inner = [_flatten(f"{key}.{name}", struct) for name, struct in part.items()]
    return {path: value for struct in inner for path, value in struct.items()}


def to_curves(value: object, axes: int = 3) -> list[Floats]:
    """Return an array (N, 3) or (3, N), N > 3, as one curve (N, 3); (N, 3, K) and (K, N, 3) as K of them.

    With `axes` 2 the same of arrays of 2 coordinates, whose z is 0. Nothing of anything else.
    """
    if not _is_real(value) or value.ndim not in (2, 3):
        return []
    stack = value[None] if value.ndim == 2 else value
    if value.ndim == 3 and not value.shape[2] == axes < value.shape[1]:
        stack = np.moveaxis(value, 2, 0)
    if axes not in stack.shape[1:] or max(stack.shape[1:]) <= 3:
        return []
    points = stack if stack.shape[2] == axes else stack.swapaxes(1, 2)
    return [*np.pad(points.astype(np.float64), ((0, 0), (0, 0), (0, 3 - axes)))]


def to_text(value: object) -> str | None:
    """Return a text, a number or a few numbers as text, without NaN; None for anything else."""
    if isinstance(value, str):
        return value[:MAX_TEXT_CHARS].strip()
    if value is None or (isinstance(value, list) and len(value) < 2):
        return to_text(value[0]) if value else ""
    array = np.asarray(value) if isinstance(value, int | float | np.ndarray | np.generic) else None
    if array is None or array.size > MAX_STATED_NUMBERS or max(array.shape, default=1) < array.size:
        return None
    if not (_is_real(array) or array.dtype == bool):
        return None
    return ", ".join(f"{float(number):.10g}" for number in array.ravel() if np.isfinite(number))


def _is_vector(value: object, length: int) -> bool:
    if isinstance(value, np.ndarray):
        return value.size == max(value.shape, default=0) == length
    return isinstance(value, list) and len(value) == length


def _split(value: object, count: int) -> list[str] | None:
    """Return the texts of `count` entries of a vector or list, or rows of a matrix; None of anything else."""
    parts: Sequence[object] = ()
    if _is_vector(value, count):
        parts = value.ravel().tolist() if isinstance(value, np.ndarray) else value  # type: ignore[assignment]
    elif isinstance(value, np.ndarray) and value.ndim == 2 and count in value.shape:
        parts = [*(value if len(value) == count else value.T)]
    texts = [text for part in parts if (text := to_text(part)) is not None]
    return texts if count > 1 and len(texts) == len(parts) == count else None


def _find_coordinates(fields: Mapping[str, object]) -> list[str]:
    """Return the names of the fields x, y and, if there is one, z; nothing where they are no curves."""
    named = sorted((match[1].lower(), key) for key in fields if (match := _COORDINATE.fullmatch(key)))
    keys = [key for _, key in named]
    is_named = "".join(axis for axis, _ in named) in ("xy", "xyz") and len({*map(_find_unit, keys)}) == 1
    sizes = {tuple(map(len, _to_columns(fields[key]))) for key in keys} if is_named else set()
    lengths = next(iter(sizes)) if len(sizes) == 1 else ()
    return keys if max(lengths, default=0) > 3 else []


def _to_columns(value: object) -> list[NDArray[Any]]:
    """Return a vector, the vectors of a list, or the columns of a matrix; nothing of anything else."""
    if isinstance(value, list):
        vectors = [_to_columns(part) for part in value]
        return [vector[0] for vector in vectors] if all(len(vector) == 1 for vector in vectors) else []
    if not _is_real(value) or not value.size:
        return []
    if value.size == max(value.shape, default=0):
        return [value.ravel()]
    return [*value.T] if value.ndim == 2 else []


def _strip_padding(curves: Sequence[Floats], is_padded: bool) -> list[Floats]:
    """Return curves without NaN at their ends and, if they have been made of one length, without zeros.

    Zeros are padding where a curve ends with several; if every curve ends with one, that is a point.
    """
    kept = [curve[: len(curve) - _count_trailing(np.isnan(curve).all(axis=1))] for curve in curves]
    zeros = [_count_trailing(~curve.any(axis=1)) for curve in kept]
    is_empty = [count == len(curve) for count, curve in zip(zeros, kept, strict=True)]
    last = min((count for count, empty in zip(zeros, is_empty, strict=True) if not empty), default=0)
    if not is_padded or max(zeros, default=0) < 2:
        return kept
    points = [0 if empty else int(last == 1) for empty in is_empty]
    return [
        curve[: len(curve) - count + point] for curve, count, point in zip(kept, zeros, points, strict=True)
    ]


def _count_trailing(flags: Any) -> int:  # noqa: ANN401 - numpy's stubs: a scalar, or an array (N,)
    """Return how many values at the end are true."""
    return len(flags) if flags.all() else int(np.argmin(flags[::-1]))


def _is_number(value: object) -> bool:
    return isinstance(value, int | float | np.number) and not isinstance(value, bool)


def _is_real(value: object) -> TypeGuard[NDArray[Any]]:
    if not isinstance(value, np.ndarray):
        return False
    return bool(np.issubdtype(value.dtype, np.number) and not np.iscomplexobj(value))
