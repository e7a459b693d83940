"""Find the curves in a table of cells: long with a column of names, side by side, or below each other."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby
from pathlib import Path
from types import MappingProxyType

import numpy as np

from needlefit.datasets.importing.cells import CellTable, is_missing
from needlefit.datasets.points import Points
from needlefit.errors import DataError
from needlefit.geometry.frames import PatientSystem, to_lps

UNITS_MM = MappingProxyType(
    {
        **{"mm": 1.0, "millimeter": 1.0, "millimetre": 1.0, "cm": 10.0, "m": 1e3, "dm": 100.0},
        **{"um": 1e-3, "µm": 1e-3, "μm": 1e-3, "micron": 1e-3, "in": 25.4, "inch": 25.4},
    }
)
"""Units of length that a header may name, in mm."""

NAME_COLUMNS = frozenset(
    {"id", "needle", "insertion", "curve", "name", "shape", "run", "trial", "label"}
    | {"nadel", "einstich", "kurve", "versuch", "aiguille", "insertionid", "needleid", "ago", "aguja"}
)
"""Headers of the column that tells the curves of a long table apart."""

ATTRIBUTE_COLUMNS = MappingProxyType(
    {
        **{"medium": "medium", "material": "medium", "phantom": "medium", "tissue": "medium"},
        **{"specimen": "specimen", "sample": "specimen", "probe": "specimen", "block": "specimen"},
        **{"bevelside": "bevel_side", "bevel": "bevel_side"},
    }
)
"""Headers of what an insertion has once: without blanks and signs, and the column of `insertions.csv`."""

INDEX_COLUMNS = frozenset({"index", "nr", "no", "n", "i", "point", "punkt", "pointid", "row", "zeile"})
"""Headers of a column that counts points."""

MAX_HEADER_ROWS = 6
MAX_LISTED_COLUMNS = 12

_UNIT = re.compile(r"[\[(/]\s*([^\W\d_]{1,10})\s*[\])]?\s*$|[_ ]((?:mm|cm|um|µm|m))$")
_WORD = re.compile(r"[^\W\d_]+|\d+")
_CAMEL = re.compile(r"(?<=[a-z])(?=[A-Z])")
_FILLERS = frozenset(
    {
        "coord",
        "coordinate",
        "coordinates",
        "koordinate",
        "pos",
        "position",
        "axis",
        "achse",
        "point",
        "points",
    }
)
_SYSTEMS: tuple[tuple[str, PatientSystem | None], ...] = (("xyz", None), ("ras", "RAS"), ("lps", "LPS"))


@dataclass(frozen=True)
class ImportedCurve:
    """One curve of a file.

    Attributes
    ----------
    name : str
        As the file calls it; empty where it has no name.
    points : Points
        In the unit and order of the file.
    unit : str
        As the file states it; empty where it does not.
    system : PatientSystem or None
        LPS once points were converted to it, as those of markups are; None where the file states no system.
    attributes : mapping of str
        Columns of `insertions.csv` that the file states for it.
    remarks : tuple of (str, str, str)
        What was taken how, and why, where it was not obvious.
    """

    name: str
    points: Points
    unit: str = ""
    system: PatientSystem | None = None
    attributes: Mapping[str, str] = field(default_factory=dict)
    remarks: tuple[tuple[str, str, str], ...] = ()


@dataclass(frozen=True)
class _Axes:
    """The columns of one curve: its name in the header, places of x, y, z (z may be missing), their unit."""

    name: str
    columns: tuple[int, ...]
    unit: str
    system: PatientSystem | None
    why: str


@dataclass(frozen=True)
class _Part:
    """Rows of numbers with the rows above them that are none."""

    head: tuple[int, ...]
    body: tuple[int, ...]


def find_curves(cells: CellTable, columns: Sequence[str] = ()) -> tuple[ImportedCurve, ...]:
    """Return the curves in a table; none where it holds no coordinates.

    Parameters
    ----------
    columns : sequence of str
        The headers, or numbers from 1, of x, y and z, where the user states them.

    Raises
    ------
    DataError
        If the columns of the coordinates cannot be found, or a coordinate is no number.
    """
    found: list[ImportedCurve] = []
    header: tuple[int, ...] = ()
    for part in _divide(cells):
        if _names_axes(cells, part.head) or not header:
            header = part.head
        title = _find_title(cells, part.head)
        all_axes = _find_axes(cells, part, header, columns)
        for axes in all_axes:
            found += _read_part(cells, part, header, axes, title if len(all_axes) == 1 else "")
    return _join_named(found)


def _join_named(curves: Sequence[ImportedCurve]) -> tuple[ImportedCurve, ...]:
    """Join the parts of a curve that blank rows divide: they have one name."""
    joined: dict[object, ImportedCurve] = {}
    for n, one in enumerate(curves):
        first = joined.get(one.name or n)
        if first is None:
            joined[one.name or n] = one
            continue
        values = np.concatenate([first.points.values, one.points.values])
        parts = [part.points.lines for part in (first, one) if part.points.lines is not None]
        points = replace(first.points, values=values, lines=np.concatenate(parts))
        joined[one.name] = replace(first, points=points)
    return tuple(joined.values())


def _divide(cells: CellTable) -> Iterator[_Part]:
    """Yield the parts of a table: each begins where rows of text, or blank ones, stand above numbers."""
    head: list[int] = []
    body: list[int] = []
    blank = False
    for n, row in enumerate(cells.rows):
        if not any(row):
            blank = bool(body)
        elif not _is_data(cells, row):
            if body:
                yield _Part(tuple(head), tuple(body))
                head, body = [], []
            head.append(n)
        else:
            if blank and body:
                yield _Part(tuple(head), tuple(body))
                head, body = [], []
            body.append(n)
            blank = False
    if body:
        yield _Part(tuple(head), tuple(body))


def _is_data(cells: CellTable, row: Sequence[str]) -> bool:
    filled = [cell for cell in row if cell]
    numbers = sum(cells.number(cell) is not None for cell in filled)
    return numbers > 1 and 3 * numbers >= len(filled) and not row[0].startswith(("#", "%"))


def _header(cells: CellTable, row: int) -> list[str]:
    """Return the cells of a header row, without the sign that makes it a comment."""
    found = list(cells.rows[row])
    found[0] = found[0].lstrip("#% ")
    return found


def _find_title(cells: CellTable, head: Sequence[int]) -> str:
    """Return the only filled cell of the first of the header rows that has one, such as `Needle 3`."""
    for n in head[-MAX_HEADER_ROWS:]:
        filled = [cell for cell in _header(cells, n) if cell]
        filled = [" ".join(filled)] if cells.separator == " " and not _names_axes(cells, (n,)) else filled
        if len(filled) == 1 and not _split_axis(filled[0])[0]:
            return filled[0]
    return ""


def _names_axes(cells: CellTable, head: Sequence[int]) -> bool:
    return any(sum(bool(_split_axis(cell)[0]) for cell in _header(cells, n)) > 1 for n in head)


def _split_unit(text: str) -> tuple[str, str]:
    """Return a header without its unit, and the unit; an unknown one is none."""
    match = _UNIT.search(text)
    unit = next((group for group in match.groups() if group), "") if match else ""
    if match and unit.lower() in UNITS_MM:
        return text[: match.start()], unit.lower()
    return text, ""


def _split_axis(text: str) -> tuple[str, str]:
    """Return the axis that a header names, one of `xyzraslp` or "", and the rest of its words."""
    words = _WORD.findall(_CAMEL.sub(" ", _split_unit(text)[0]))
    axes = [n for n, word in enumerate(words) if word.lower() in tuple("xyzraslp")]
    if len(axes) != 1:
        return "", ""
    rest = [word for n, word in enumerate(words) if n != axes[0] and word.lower() not in _FILLERS]
    return words[axes[0]].lower(), "_".join(rest)


def _find_axes(cells: CellTable, part: _Part, header: Sequence[int], wanted: Sequence[str]) -> list[_Axes]:
    above = header[-MAX_HEADER_ROWS:]
    rows = [_header(cells, n) for n in above]
    width = max(len(cells.rows[n]) for n in part.body)
    _require_width(cells, part, rows)
    units = _find_unit_row(rows)
    if wanted:
        return [_find_stated_axes(cells, rows, units, wanted, header)]
    named = next((n for n in reversed(range(len(above))) if _names_axes(cells, above[n : n + 1])), None)
    if named is None:
        return _count_axes(cells, part, rows, units)
    groups = _fill_groups(rows[:named], width)
    found: dict[str, dict[str, int]] = {}
    stated: dict[str, str] = {}
    for column, text in enumerate(rows[named]):
        axis, rest = _split_axis(text)
        if axis:
            key = "_".join(word for word in (groups.get(column, ""), rest) if word)
            found.setdefault(key, {}).setdefault(axis, column)
            stated.setdefault(key, _split_unit(text)[1] or units.get(column, ""))
    letters = [letter for columns in found.values() for letter in columns]
    if all(len(columns) == 1 for columns in found.values()) and len(set(letters)) == len(letters):
        # each header has a word of its own beside its axis: "depth x", "deflection y"
        units_found = next(filter(None, stated.values()), "")
        found, stated = (
            {"": {letter: n for one in found.values() for letter, n in one.items()}},
            {"": units_found},
        )
    axes = [
        _make_axes(key, columns, stated[key], cells.where(above[named])) for key, columns in found.items()
    ]
    return [one for one in axes if one is not None] or _count_axes(cells, part, rows, units)


def _make_axes(key: str, columns: Mapping[str, int], unit: str, where: str) -> _Axes | None:
    """Return the axes of one key of a header; None where it names no two axes of one system."""
    for letters, system in _SYSTEMS:
        if all(one in columns for one in letters):
            return _Axes(
                key, tuple(columns[one] for one in letters), unit, system, f"header: {Path(where).name}"
            )
    planar = [columns[one] for one in "xyz" if one in columns]
    return _Axes(key, tuple(planar), unit, None, f"header: {Path(where).name}") if len(planar) == 2 else None


def _fill_groups(rows: Sequence[Sequence[str]], width: int) -> dict[int, str]:
    """Return the name above each column: of merged cells the first holds it. One name alone is a title."""
    for row in reversed(rows):
        filled = {n: text for n, text in enumerate(row) if text}
        if len(filled) > 1:
            found, current = {}, ""
            for n in range(width):
                current = filled.get(n, current)
                found[n] = current
            return found
    return {}


def _find_unit_row(rows: Sequence[Sequence[str]]) -> dict[int, str]:
    """Return the unit of each column where one header row holds nothing but units."""
    for row in rows:
        bare = {n: text.strip("[]()").lower() for n, text in enumerate(row) if text}
        lengths = {n: text for n, text in bare.items() if text in UNITS_MM}
        if len(lengths) > 1 and all(len(text) <= 10 for text in bare.values()):
            return lengths
    return {}


def _require_width(cells: CellTable, part: _Part, rows: Sequence[Sequence[str]]) -> None:
    """See that no row has more cells than the header: a decimal comma in a comma-separated table."""
    width = max(map(len, rows), default=0)
    for n in part.body if width > 1 and cells.separator == "," else ():
        count = len([cell for cell in cells.rows[n][width:] if cell])
        if count:
            raise DataError(
                f"has {width + count} cells under {width} columns",
                where=cells.where(n),
                expected="as many cells as the header",
                fix="decimal commas need another separator than the comma: save it with semicolons or tabs",
            )


def _find_stated_axes(
    cells: CellTable,
    rows: Sequence[Sequence[str]],
    units: Mapping[int, str],
    wanted: Sequence[str],
    header: Sequence[int],
) -> _Axes:
    """Return the columns that the user names, by header or by number."""
    places = []
    names = [text for row in rows for text in row if text]
    for name in wanted:
        place = next((row.index(name) for row in rows if name in row), None)
        if place is None and name.isdecimal() and int(name) > 0:
            place = int(name) - 1
        if place is None:
            raise DataError(
                f"there is no column {name!r}",
                where=cells.where(header[-1]) if header else str(cells.path),
                expected=f"one of {', '.join(names[:MAX_LISTED_COLUMNS]) or 'the numbers of the columns'}",
                fix="name the columns of x, y and z with --columns, by their headers or numbers",
            )
        places.append(place)
    stated = [_split_unit(row[places[0]])[1] for row in rows if places[0] < len(row)]
    unit = next(filter(None, stated), units.get(places[0], ""))
    return _Axes("", tuple(places), unit, None, "--columns")


def _count_axes(
    cells: CellTable, part: _Part, rows: Sequence[Sequence[str]], units: Mapping[int, str]
) -> list[_Axes]:
    """Return the axes of a table whose header names none: by the number of its columns."""
    body = [cells.rows[n] for n in part.body]
    width = max(map(len, body))
    names = [_plain(text) for text in _find_labels(cells, rows, width)]
    full = [n for n in range(width) if _count_numbers(cells, body, n) > 0.5 * len(body)]
    full = [
        n
        for n in full
        if not (n < len(names) and (names[n] in NAME_COLUMNS or names[n] in ATTRIBUTE_COLUMNS))
    ]
    counts = bool(full) and full[0] < len(names) and names[full[0]] in INDEX_COLUMNS
    if full and (len(full) % 3 == 1 or counts) and _is_index(cells, body, full[0]):
        full = full[1:]
    if len([name for name in names if name]) >= max(len(full), 2) and len(full) != 3:
        full = []  # names that are not known must not be overruled
    if len(full) == 2:
        return [_Axes("", tuple(full), units.get(full[0], ""), None, "two columns of numbers")]
    if not full or len(full) % 3:
        shown = (
            ", ".join(text for row in rows for text in row if text)[:300] or f"{width} columns without names"
        )
        raise DataError(
            f"the columns of the coordinates are not clear: {shown}",
            where=cells.where(part.body[0]),
            expected="columns called x, y, z (or two, or three for every curve)",
            fix="name them with --columns X,Y,Z, by header or number, or in the file",
        )
    blocks = [tuple(full[n : n + 3]) for n in range(0, len(full), 3)]
    why = f"{len(full)} columns of numbers"
    return [
        _Axes(str(n) if len(blocks) > 1 else "", block, units.get(block[0], ""), None, why)
        for n, block in enumerate(blocks, 1)
    ]


def _count_numbers(cells: CellTable, body: Sequence[Sequence[str]], column: int) -> int:
    return sum(column < len(row) and cells.number(row[column]) is not None for row in body)


def _is_index(cells: CellTable, body: Sequence[Sequence[str]], column: int) -> bool:
    values = [cells.number(row[column]) if column < len(row) else None for row in body]
    steps = np.diff([np.nan if value is None else value for value in values])
    return len(steps) > 0 and bool((steps == 1).all())


def _plain(text: str) -> str:
    return "".join(_WORD.findall(_split_unit(text)[0])).lower()


def _read_part(
    cells: CellTable, part: _Part, header: Sequence[int], axes: _Axes, title: str
) -> Iterator[ImportedCurve]:
    """Yield the curve of some columns, or several where a column of the table names them."""
    heads = [_header(cells, n) for n in header[-MAX_HEADER_ROWS:]]
    width = max(len(cells.rows[n]) for n in part.body)
    names = [_plain(text) for text in _find_labels(cells, heads, width)]
    key = next((n for n, name in enumerate(names) if name in NAME_COLUMNS and n not in axes.columns), None)
    known = key
    if key is None:
        key = _find_block_column(cells, part, axes, names) if names else _find_text_column(cells, part, axes)
    groups: dict[str, list[int]] = {}
    for n in part.body:
        row = cells.rows[n]
        name = row[key] if key is not None and key < len(row) else ""
        groups.setdefault(name, []).append(n)
    for name, rows in groups.items():
        points = _read_points(cells, rows, axes)
        if points is None:
            continue
        planar = len(axes.columns) == 2
        remarks = [("axes", "x, y; z = 0" if planar else "x, y, z", axes.why)]
        if known is None and key is not None and names:
            why = "the column changes from curve to curve alone"
            remarks.append(("curves", f"one for each {names[key]}", why))
        attributes = _find_attributes(cells, rows, names, axes)
        if axes.system is not None:
            points = replace(points, values=to_lps(points.values, axes.system))
        system: PatientSystem | None = "LPS" if axes.system else None
        yield ImportedCurve(name or axes.name or title, points, axes.unit, system, attributes, tuple(remarks))


def _find_labels(cells: CellTable, rows: Sequence[Sequence[str]], width: int) -> Sequence[str]:
    """Return the header row that names the columns: the one with most words, no title and no units."""
    labels = [row for row in rows if sum(map(bool, row)) > 1 and not _find_unit_row([row])]
    if cells.separator == " ":  # the words of a title are cells, too
        labels = [row for row in labels if len(row) == width]
    return max(labels, key=lambda row: sum(map(bool, row)), default=[])


def _find_text_column(cells: CellTable, part: _Part, axes: _Axes) -> int | None:
    """Return the first column of a table without header that holds text in every row."""
    rows = [cells.rows[n] for n in part.body]
    for column in range(max(map(len, rows))):
        texts = [row[column] for row in rows if column < len(row)]
        if column not in axes.columns and len(texts) == len(rows) and not any(map(cells.number, texts)):
            return column if all(texts) else None
    return None


MIN_BLOCK_ROWS = 5
"""Rows at least of each value of a column that tells curves apart without a known name."""


def _find_block_column(cells: CellTable, part: _Part, axes: _Axes, names: Sequence[str]) -> int | None:
    """Return the first column of another name whose value is one along each of several blocks of rows."""
    rows = [cells.rows[n] for n in part.body]
    for column, name in enumerate(names):
        if column in axes.columns or not name or name in ATTRIBUTE_COLUMNS or name in INDEX_COLUMNS:
            continue
        texts = [row[column] if column < len(row) else "" for row in rows]
        blocks = [(text, len(list(run))) for text, run in groupby(texts)]
        distinct = len({text for text, _ in blocks})
        if 1 < distinct == len(blocks) and all(texts) and min(n for _, n in blocks) >= MIN_BLOCK_ROWS:
            return column
    return None


def _read_points(cells: CellTable, rows: Sequence[int], axes: _Axes) -> Points | None:
    """Return the points of some rows; None where all cells are empty. Rows after the last point may be empty.

    Raises
    ------
    DataError
        If a cell is no number, or a row in between has only some of its coordinates.
    """
    values, lines = [], []
    for n in rows:
        texts = [cells.rows[n][c] if c < len(cells.rows[n]) else "" for c in axes.columns]
        if all(map(is_missing, texts)):
            continue
        numbers = [cells.number(text) for text in texts]
        if None in numbers:
            bad = texts[numbers.index(None)]
            raise DataError(
                f"a coordinate is {bad[:40]!r}" if bad else "a coordinate is empty",
                where=cells.where(n),
                expected=f"numbers with a decimal {'comma' if cells.decimal == ',' else 'point'}",
                fix="correct the cell, or empty the whole row",
            )
        values.append(numbers)
        lines.append(cells.lines[n])
    if not values:
        return None
    array = np.array(values, dtype=np.float64)
    if array.shape[1] == 2:
        array = np.column_stack([array, np.zeros(len(array))])
    return Points(Path(cells.path), array, np.array(lines, dtype=np.int64))


def _find_attributes(
    cells: CellTable, rows: Sequence[int], names: Sequence[str], axes: _Axes
) -> dict[str, str]:
    """Return what the table states once for a curve, in columns whose cells are the same all through."""
    found = {}
    for column, name in enumerate(names):
        ours = ATTRIBUTE_COLUMNS.get(name)
        texts = {cells.rows[n][column] for n in rows if column < len(cells.rows[n]) and cells.rows[n][column]}
        if ours and column not in axes.columns and len(texts) == 1:
            found[ours] = re.sub(r'[,"]', " ", texts.pop())
    return found
