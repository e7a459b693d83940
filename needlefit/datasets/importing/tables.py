"""Read tables of any layout, text or workbook, and find their curves: long, side by side, or in blocks."""

import codecs
import csv
import io
import re
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import date, time, timedelta
from functools import cached_property
from itertools import groupby
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from needlefit.datasets.formats.csv import MAX_COLUMNS
from needlefit.datasets.points import MAX_COORDINATE, Points
from needlefit.errors import DataError
from needlefit.geometry.frames import PatientSystem, to_lps
from needlefit.project.input_files import open_regular, read_bytes
from needlefit.project.sandbox import READER_BYTES, SandboxArrays, limits_for, read_in_sandbox

TEXT_SUFFIXES = (".csv", ".tsv", ".txt", ".dat", ".asc")
SHEET_SUFFIXES = (".xlsx", ".xlsm", ".xlsb", ".xls", ".ods")

MAX_TABLE_BYTES, MAX_TABLE_CELLS = 16 * 2**20, 1_000_000  # of a text table; empty cells count
MAX_SHEETS, MAX_SHEET_CELLS = 200, 500_000  # sheets of a workbook that are read, and cells of all of them
MAX_UNPACKED_BYTES = 512 * 2**20  # what a workbook may unpack to
MAX_SHEET_BYTES = 64 * 2**20
SHEET_BYTES_PER_SECOND = 2**20
MAX_CELL_CHARS = 500  # longer text is no header and no number; the rest of it is dropped
SAMPLE_ROWS = 300  # rows by which the separator and the decimal sign are found
MAX_HEADER_ROWS = 6
MAX_LISTED_COLUMNS = 12
MIN_BLOCK_ROWS = 5  # rows at least of each value of a column that tells curves apart without a known name
SEPARATOR_NAMES = {";": "semicolon", "\t": "tab", "|": "bar", ",": "comma", " ": "blanks"}

# Units of length that a header may name, in mm.
UNITS_MM = MappingProxyType(
    {
        **{"mm": 1.0, "millimeter": 1.0, "millimetre": 1.0, "cm": 10.0, "m": 1e3, "dm": 100.0},
        **{"um": 1e-3, "µm": 1e-3, "μm": 1e-3, "micron": 1e-3, "in": 25.4, "inch": 25.4},
    }
)
# Headers of the column that tells the curves of a long table apart.
NAME_COLUMNS = frozenset(
    {"id", "needle", "insertion", "curve", "name", "shape", "run", "trial", "label"}
    | {"nadel", "einstich", "kurve", "versuch", "aiguille", "insertionid", "needleid", "ago", "aguja"}
)
# Headers of what an insertion has once: without blanks and signs, and the column of `insertions.csv`.
ATTRIBUTE_COLUMNS = MappingProxyType(
    {
        **{"medium": "medium", "material": "medium", "phantom": "medium", "tissue": "medium"},
        **{"specimen": "specimen", "sample": "specimen", "probe": "specimen", "block": "specimen"},
        **{"hole": "hole", "puncture": "hole"},
        **{"bevelside": "bevel_side", "bevel": "bevel_side"},
    }
)
# Headers of a column that counts points.
INDEX_COLUMNS = frozenset(["index", "nr", "no", "n", "i", "point", "punkt", "pointid", "row", "zeile"])

# Separators and decimal signs, in the order in which equally good ones are taken.
_LAYOUTS = (
    *((";", ","), (";", "."), ("\t", ","), ("\t", "."), ("|", ","), ("|", ".")),
    *((",", "."), (" ", ","), (" ", ".")),
)
_BOMS = ((codecs.BOM_UTF8, "utf-8-sig"), (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"))
_MISSING = frozenset({"nan", "na", "n/a", "-", "--", "null", "none", "#n/a", "inf", "-inf", "+inf"})
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
class CellTable:
    """The cells of a text table or of one sheet, as stripped text."""

    path: Path
    rows: Sequence[Sequence[str]]  # blank rows are among them; rows may differ in length
    first: int = 1  # line or row in its file of the first one, from 1
    sheet: str = ""  # name of the sheet; empty for a text table
    # "." or ","; in a sheet, where numbers are stored as such, "." and commas are read too.
    decimal: str = "."
    separator: str = ""  # between the cells; empty for a sheet
    layout: str = ""  # how the file was read, for people

    def where(self, row: int) -> str:
        """Return the place of a row for a message."""
        sheet = f", sheet {self.sheet!r}, row " if self.sheet else ":"
        return f"{self.path}{sheet}{self.first + row}"

    def number(self, text: str) -> float | None:
        """Return the number in a cell; None where there is none."""
        found = parse_number(text, self.decimal)
        return parse_number(text, ",") if found is None and self.sheet else found

    def column(self, rows: Iterable[int], column: int) -> list[str]:
        """Return the cells of a column in some rows; empty where a row ends before it."""
        return [row[column] if column < len(row) else "" for row in (self.rows[n] for n in rows)]

    def header(self, row: int) -> list[str]:
        """Return the cells of a header row, without the sign that makes it a comment."""
        first, *others = self.rows[row]
        return [first.lstrip("#% "), *others]

    def names_axes(self, rows: Iterable[int]) -> bool:
        """Whether one of these header rows names two axes or more."""
        return any(sum(bool(_split_axis(cell)[0]) for cell in self.header(n)) > 1 for n in rows)


def parse_number(text: str, decimal: str) -> float | None:
    """Return a number written with a decimal sign; None for anything else.

    With a decimal comma, points before it separate thousands.
    """
    plain = text.replace("\u00a0", "").replace("\u2212", "-").strip()
    if decimal == ",":
        whole, comma, rest = plain.partition(",")
        groups = whole.lstrip("+-").split(".")
        thousands = len(groups) > 1 and all(len(group) == 3 for group in groups[1:])
        if "." in rest or ("." in whole and not (comma and thousands)):
            return None
        plain = f"{whole.replace('.', '')}.{rest}" if comma else whole
    if not plain or plain.lower().strip("+-") in ("nan", "inf", "infinity") or "_" in plain:
        return None
    try:
        value = float(plain)
    except ValueError:
        return None
    return value if abs(value) <= MAX_COORDINATE else None


def is_missing(text: str) -> bool:
    """Whether a cell says that there is no number: empty, NaN, n/a, a dash."""
    return not text or text.lower() in _MISSING


# ---- text


def read_text_cells(path: Path) -> CellTable:
    """Read a text table.

    DataError if the file is missing, too large, no text, or holds no row with two numbers.
    """
    text, encoding = _decode(read_bytes(path, MAX_TABLE_BYTES), path)
    lines = text.splitlines()
    _require_extent(len(lines), 1, path)
    sample = [line for line in lines if line.strip()][: 2 * SAMPLE_ROWS]
    separator, decimal = max(_LAYOUTS, key=lambda layout: _score(sample, *layout))
    if _score(sample, separator, decimal) <= 0:
        expected = "rows of coordinates: two or three numbers between separators"
        fix = "export the points of the needles as a table, one point a row"
        raise DataError("holds no table of numbers", where=str(path), expected=expected, fix=fix)
    rows = [_split(line, separator) for line in lines]
    _require_extent(len(rows), max(map(len, rows), default=0), path)
    sign = "decimal comma" if decimal == "," else "decimal point"
    layout = f"{SEPARATOR_NAMES[separator]}-separated, {sign}, {encoding}"
    return CellTable(path, rows, decimal=decimal, separator=separator, layout=layout)


def _decode(data: bytes, path: Path) -> tuple[str, str]:
    """Return the text of a file and its encoding: by its byte order mark, else UTF-8, else Windows-1252."""
    encodings = [name for mark, name in _BOMS if data.startswith(mark)]
    if not encodings and len(data) > 3 and 0 in data[:200]:
        encodings = ["utf-16-le" if data[1:200:2].count(0) > data[0:200:2].count(0) else "utf-16-be"]
    for encoding in encodings or ["utf-8", "cp1252", "latin-1"]:
        try:
            text = data.decode(encoding)
        except UnicodeDecodeError:
            continue
        if "\0" not in text:
            return text, encoding.upper().replace("-SIG", "").replace("CP1252", "Windows-1252")
    what = "cannot be read as text"
    fix = "save it again as CSV (UTF-8), or name the right file"
    raise DataError(what, where=str(path), expected="text in UTF-8, UTF-16 or Latin-1", fix=fix)


def _split(line: str, separator: str) -> list[str]:
    line = line.strip("\ufeff").strip(None if separator == " " else " \r\n")
    if separator == " ":
        return line.split()
    try:
        (cells,) = csv.reader([line], delimiter=separator, skipinitialspace=True) if line else [[]]
    except (csv.Error, ValueError):
        cells = line.split(separator)
    return [cell.strip()[:MAX_CELL_CHARS] for cell in cells]


def _score(lines: Sequence[str], separator: str, decimal: str) -> int:
    """Return how well a layout explains lines: numbers in rows with two of them, less cells that are none.

    Three coordinates beside four columns of names still count as a table.
    """
    total = 0
    for line in lines[-SAMPLE_ROWS:]:  # a header may be long, the numbers stand at the end
        cells = [cell for cell in _split(line, separator) if not is_missing(cell)]
        numbers = sum(parse_number(cell, decimal) is not None for cell in cells)
        total += 5 * numbers - 2 * len(cells) if numbers > 1 else 0
    return total


def _require_extent(rows: int, columns: int, path: Path) -> None:
    if columns > MAX_COLUMNS or rows * columns > MAX_TABLE_CELLS:
        what = f"is too large: {rows} rows of {columns} columns"
        expected = f"at most {MAX_COLUMNS} columns, and {MAX_TABLE_CELLS:,} cells"
        fix = "check that it is the file that you meant, or divide it"
        raise DataError(what, where=str(path), expected=expected, fix=fix)


# ---- workbooks


def read_sheets(path: Path) -> tuple[CellTable, ...]:
    """Read every sheet of an Excel or OpenDocument workbook that is not empty.

    DataError if the file is missing, too large, no workbook, protected by a password, or holds no cells.
    """
    with open_regular(path, MAX_SHEET_BYTES) as file:
        size = file.seek(0, io.SEEK_END)
        file.seek(0)
        unpacked = 0
        if file.read(4) == b"PK\x03\x04":  # a ZIP archive must not claim to unpack to gigabytes
            file.seek(0)
            try:
                unpacked = sum(one.file_size for one in zipfile.ZipFile(file).infolist())
            except Exception as fault:  # zipfile raises whatever the bytes provoke
                raise _workbook_error(path, f"is a damaged archive ({type(fault).__name__})") from None
    if unpacked > MAX_UNPACKED_BYTES:
        raise _workbook_error(path, f"unpacks to {unpacked / 2**20:.0f} MiB")
    allowed = limits_for(READER_BYTES, READER_BYTES, size / SHEET_BYTES_PER_SECOND)
    found, _ = read_in_sandbox(f"{__name__}:read_workbook", path, allowed, {"path": str(path)})
    sheets = [CellTable(path, rows, 1 + above, name) for name, above, rows in found if any(map(any, rows))]
    if not sheets:
        raise DataError(
            "holds no cells", where=str(path), expected="a sheet with coordinates", fix="name the right file"
        )
    return tuple(sheets)


def _workbook_error(path: Path, what: str) -> DataError:
    expected = f"an Excel or OpenDocument workbook of at most {MAX_SHEET_CELLS:,} cells, without password"
    fix = "save the sheet with the coordinates again, or export it as CSV"
    return DataError(what, where=str(path), expected=expected, fix=fix)


def read_workbook(_results: SandboxArrays, path: str) -> list[tuple[str, int, list[list[str]]]]:
    """Return name, number of rows left out above, and rows of each sheet; in the child process."""
    from python_calamine import CalamineWorkbook

    file, sheets, count = Path(path), [], 0
    try:
        book = CalamineWorkbook.from_filelike(io.BytesIO(read_bytes(file, MAX_SHEET_BYTES)))
        if len(book.sheet_names) > MAX_SHEETS:
            raise _workbook_error(file, f"has {len(book.sheet_names)} sheets")
        for name in book.sheet_names:
            sheet = book.get_sheet_by_name(name)
            count += sheet.height * sheet.width
            if count > MAX_SHEET_CELLS or sheet.width > MAX_COLUMNS:
                raise _workbook_error(file, f"is too large: sheet {name[:60]!r} has {count:,} cells")
            rows = [[_sheet_text(cell) for cell in row] for row in sheet.to_python(skip_empty_area=True)]
            sheets.append((name[:MAX_CELL_CHARS], sheet.start[0] if sheet.start else 0, rows))
    except (MemoryError, DataError):
        raise
    except BaseException as fault:  # its reader raises, and its panics are no Exception
        raise _workbook_error(file, f"cannot be read ({type(fault).__name__})") from None
    return sheets


def _sheet_text(cell: Any) -> str:  # noqa: ANN401 - whatever a sheet holds
    if isinstance(cell, bool | date | time | timedelta):
        return str(cell)
    if isinstance(cell, int | float):
        return repr(int(cell)) if float(cell).is_integer() and abs(cell) < 2**53 else repr(float(cell))
    return "".join(one if one.isprintable() else " " for one in str(cell))[:MAX_CELL_CHARS].strip()


# ---- curves


@dataclass(frozen=True)
class ImportedCurve:
    """One curve of a file."""

    name: str  # as the file calls it; empty where it has no name
    points: Points  # in the unit and order of the file
    unit: str = ""  # as the file states it; empty where it does not
    # LPS once points were converted to it, as those of markups are; None where the file states no system.
    system: PatientSystem | None = None
    # Columns of `insertions.csv` that the file states for it.
    attributes: Mapping[str, str] = field(default_factory=dict)
    remarks: tuple[tuple[str, str, str], ...] = ()  # what was taken how, and why, where it was not obvious


@dataclass(frozen=True)
class _Axes:
    """The columns of one curve: its name in the header, places of x, y, z (z may be missing), their unit."""

    name: str
    columns: tuple[int, ...]
    unit: str
    system: PatientSystem | None
    why: str


def find_curves(cells: CellTable, columns: Sequence[str] = ()) -> tuple[ImportedCurve, ...]:
    """Return the curves in a table; none where it holds no coordinates.

    `columns`: the headers, or numbers from 1, of x, y and z, where the user states them.

    DataError if the columns of the coordinates cannot be found, or a coordinate is no number.
    """
    found: list[ImportedCurve] = []
    header: Sequence[int] = ()
    for head, body in _divide(cells):
        header = head if not header or cells.names_axes(head) else header
        part = _Part(cells, body, header[-MAX_HEADER_ROWS:])
        all_axes = part.find_axes(columns)
        title = _find_title(cells, head) if len(all_axes) == 1 else ""
        for axes in all_axes:
            found += part.read_curves(axes, title)
    joined: dict[object, ImportedCurve] = {}
    for n, one in enumerate(found):
        first = joined.setdefault(one.name or n, one)
        if first is not one:
            both = [part.points for part in (first, one)]
            lines = np.concatenate([part.lines for part in both if part.lines is not None])
            values = np.concatenate([part.values for part in both])
            joined[one.name] = replace(first, points=replace(both[0], values=values, lines=lines))
    return tuple(joined.values())


def _divide(cells: CellTable) -> Iterator[tuple[Sequence[int], Sequence[int]]]:
    """Yield the header rows and the rows of numbers of each part: text, or a blank row, stands above it."""
    head: list[int] = []
    body: list[int] = []
    blank = False
    for n, row in enumerate(cells.rows):
        if not any(row):
            blank = True
            continue
        filled = [cell for cell in row if cell]
        numbers = sum(cells.number(cell) is not None for cell in filled)
        is_data = numbers > 1 and 3 * numbers >= len(filled) and not row[0].startswith(("#", "%"))
        if body and (blank or not is_data):
            yield head, body
            head, body = [], []
        (body if is_data else head).append(n)
        blank = False
    if body:
        yield head, body


def _find_title(cells: CellTable, head: Sequence[int]) -> str:
    """Return the only filled cell of the first of the header rows that has one, such as `Needle 3`."""
    for n in head[-MAX_HEADER_ROWS:]:
        filled = [cell for cell in cells.header(n) if cell]
        filled = [" ".join(filled)] if cells.separator == " " and not cells.names_axes((n,)) else filled
        if len(filled) == 1 and not _split_axis(filled[0])[0]:
            return filled[0]
    return ""


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


def _find_unit_row(rows: Sequence[Sequence[str]]) -> dict[int, str]:
    """Return the unit of each column where one header row holds nothing but units."""
    for row in rows:
        bare = {n: text.strip("[]()").lower() for n, text in enumerate(row) if text}
        lengths = {n: text for n, text in bare.items() if text in UNITS_MM}
        if len(lengths) > 1 and all(len(text) <= 10 for text in bare.values()):
            return lengths
    return {}


def _make_axes(key: str, columns: Mapping[str, int], unit: str, where: str) -> _Axes | None:
    """Return the axes of one key of a header; None where it names no two axes of one system."""
    why = f"header: {Path(where).name}"
    for letters, system in _SYSTEMS:
        if all(one in columns for one in letters):
            return _Axes(key, tuple(columns[one] for one in letters), unit, system, why)
    planar = tuple(columns[one] for one in "xyz" if one in columns)
    return _Axes(key, planar, unit, None, why) if len(planar) == 2 else None


@dataclass(frozen=True)
class _Part:
    """Rows of numbers of a table (`body`), and the header rows that name their columns."""

    cells: CellTable
    body: Sequence[int]
    header: Sequence[int]

    @cached_property
    def heads(self) -> list[list[str]]:
        """The cells of the header rows."""
        return [self.cells.header(n) for n in self.header]

    @cached_property
    def units(self) -> dict[int, str]:
        """The unit of each column where a header row holds units alone."""
        return _find_unit_row(self.heads)

    @cached_property
    def columns(self) -> list[list[str]]:
        """The cells of each column."""
        width = max(len(self.cells.rows[n]) for n in self.body)
        return [self.cells.column(self.body, column) for column in range(width)]

    @cached_property
    def names(self) -> list[str]:
        """The columns' headers, letters alone: of the row with most words, no title and no units."""
        labels = [row for row in self.heads if sum(map(bool, row)) > 1 and not _find_unit_row([row])]
        if self.cells.separator == " ":  # the words of a title are cells, too
            labels = [row for row in labels if len(row) == len(self.columns)]
        label_row = max(labels, key=lambda row: sum(map(bool, row)), default=[])
        return ["".join(_WORD.findall(_split_unit(text)[0])).lower() for text in label_row]

    def find_axes(self, stated: Sequence[str]) -> list[_Axes]:
        """Return the columns of every curve: as stated, by the header, or by the number of columns."""
        width = max(map(len, self.heads), default=0)
        for n in self.body if width > 1 and self.cells.separator == "," else ():
            count = len([cell for cell in self.cells.rows[n][width:] if cell])
            if count:
                what = f"has {width + count} cells under {width} columns"
                where = self.cells.where(n)
                fix = "decimal commas need another separator: save it with semicolons or tabs"
                raise DataError(what, where=where, expected="as many cells as the header", fix=fix)
        if stated:
            places = []
            for name in stated:
                place = next((row.index(name) for row in self.heads if name in row), None)
                if place is None and name.isdecimal() and int(name) > 0:
                    place = int(name) - 1
                if place is None:
                    names = [text for row in self.heads for text in row if text][:MAX_LISTED_COLUMNS]
                    where = self.cells.where(self.header[-1]) if self.header else str(self.cells.path)
                    expected = f"one of {', '.join(names) or 'the numbers of the columns'}"
                    fix = "name the columns of x, y and z with --columns, by their headers or numbers"
                    raise DataError(f"there is no column {name!r}", where=where, expected=expected, fix=fix)
                places.append(place)
            units = [_split_unit(row[places[0]])[1] for row in self.heads if places[0] < len(row)]
            unit = next(filter(None, units), self.units.get(places[0], ""))
            return [_Axes("", tuple(places), unit, None, "--columns")]
        named = next((n for n in reversed(self.header) if self.cells.names_axes((n,))), None)
        return ([] if named is None else self._find_named(named)) or self._count_axes()

    def _find_named(self, row: int) -> list[_Axes]:
        """Return the axes that a header row names, of every group of columns that the rows above it name."""
        groups = self._fill_groups(self.heads[: self.header.index(row)])
        found: dict[str, dict[str, int]] = {}
        units: dict[str, str] = {}
        for column, text in enumerate(self.cells.header(row)):
            axis, rest = _split_axis(text)
            if axis:
                key = "_".join(word for word in (groups.get(column, ""), rest) if word)
                found.setdefault(key, {}).setdefault(axis, column)
                units.setdefault(key, _split_unit(text)[1] or self.units.get(column, ""))
        merged = {letter: column for columns in found.values() for letter, column in columns.items()}
        if len(merged) == len(found) == sum(map(len, found.values())):
            # each header has a word of its own beside its axis: "depth x", "deflection y"
            found, units = {"": merged}, {"": next(filter(None, units.values()), "")}
        where = self.cells.where(row)
        axes = [_make_axes(key, columns, units[key], where) for key, columns in found.items()]
        return [one for one in axes if one is not None]

    def _fill_groups(self, rows: Sequence[Sequence[str]]) -> dict[int, str]:
        """Return the name above each column, which the first of merged cells holds; one alone is a title."""
        for row in reversed(rows):
            filled = {n: text for n, text in enumerate(row) if text}
            if len(filled) > 1:
                found, current = {}, ""
                for n in range(len(self.columns)):
                    found[n] = current = filled.get(n, current)
                return found
        return {}

    def _count_axes(self) -> list[_Axes]:
        """Return the axes of a table whose header names none: by the number of its columns."""
        names = dict(enumerate(self.names))
        others = {n for n, name in names.items() if name in NAME_COLUMNS or name in ATTRIBUTE_COLUMNS}
        numbers = [[self.cells.number(text) for text in column] for column in self.columns]
        counts = [len(column) - column.count(None) for column in numbers]
        full = [n for n, count in enumerate(counts) if count > 0.5 * len(self.body) and n not in others]
        if full and (len(full) % 3 == 1 or names.get(full[0]) in INDEX_COLUMNS):
            steps = np.diff(np.array(numbers[full[0]], dtype=np.float64))
            full = full[1:] if len(steps) and (steps == 1).all() else full
        if len(list(filter(None, self.names))) >= max(len(full), 2) and len(full) != 3:
            full = []  # names that are not known must not be overruled
        if len(full) == 2:
            return [_Axes("", tuple(full), self.units.get(full[0], ""), None, "two columns of numbers")]
        if not full or len(full) % 3:
            shown = ", ".join(text for row in self.heads for text in row if text)[:300]
            raise DataError(
                "the columns of the coordinates are not clear: "
                f"{shown or f'{len(self.columns)} columns without names'}",
                where=self.cells.where(self.body[0]),
                expected="columns called x, y, z (or two, or three for every curve)",
                fix="name them with --columns X,Y,Z, by header or number, or in the file",
            )
        blocks = [tuple(full[n : n + 3]) for n in range(0, len(full), 3)]
        why = f"{len(full)} columns of numbers"
        return [
            _Axes(str(n) if len(blocks) > 1 else "", block, self.units.get(block[0], ""), None, why)
            for n, block in enumerate(blocks, 1)
        ]

    def read_curves(self, axes: _Axes, title: str) -> Iterator[ImportedCurve]:
        """Yield the curve of some columns, or several where a column of the table names them."""
        named = enumerate(self.names)
        known = next((n for n, name in named if name in NAME_COLUMNS and n not in axes.columns), None)
        key = self._find_key_column(axes) if known is None else known
        names = self.columns[key] if key is not None and key < len(self.columns) else [""] * len(self.body)
        groups: dict[str, list[int]] = {}
        for row, name in zip(self.body, names, strict=True):
            groups.setdefault(name, []).append(row)
        planar = len(axes.columns) == 2
        remarks = [("axes", "x, y; z = 0" if planar else "x, y, z", axes.why)]
        if known is None and key is not None and self.names:
            why = "the column changes from curve to curve alone"
            remarks.append(("curves", f"one for each {self.names[key]}", why))
        system: PatientSystem | None = "LPS" if axes.system else None
        for name, rows in groups.items():
            points = self._read_points(rows, axes)
            if points is not None:
                stated = self._find_attributes(rows, axes)
                yield ImportedCurve(
                    name or axes.name or title, points, axes.unit, system, stated, tuple(remarks)
                )

    def _find_key_column(self, axes: _Axes) -> int | None:
        """Return the column that tells curves apart without a known name.

        Without a header the first one with text in every row, else the first whose value is one along each of
        several blocks of rows.
        """
        if not self.names:
            others = (n for n in range(len(self.columns)) if n not in axes.columns)
            return next(
                (
                    n
                    for n in others
                    if all(self.columns[n])
                    and not any(self.cells.number(text) is not None for text in self.columns[n])
                ),
                None,
            )
        # a table without another name may have one curve a hole
        attributes = {name for name, ours in ATTRIBUTE_COLUMNS.items() if ours != "hole"}
        skipped = {"", *attributes, *INDEX_COLUMNS}
        for column, (name, texts) in enumerate(zip(self.names, self.columns, strict=False)):
            blocks = [(text, len(list(run))) for text, run in groupby(texts)]
            distinct = len(set(texts))
            if column in axes.columns or name in skipped or not all(texts):
                continue
            if 1 < distinct == len(blocks) and min(count for _, count in blocks) >= MIN_BLOCK_ROWS:
                return column
        return None

    def _read_points(self, rows: Sequence[int], axes: _Axes) -> Points | None:
        """Return the points of some rows, in LPS where the axes state a system; None where all are empty.

        Rows after the last point may be empty. DataError if a cell is no number, or a row in between has only
        some of its coordinates.
        """
        cells = self.cells
        texts = zip(*(cells.column(rows, column) for column in axes.columns), strict=True)
        filled = [
            (row, cells_) for row, cells_ in zip(rows, texts, strict=True) if not all(map(is_missing, cells_))
        ]
        values = np.zeros((len(filled), 3))
        for n, (row, coordinates) in enumerate(filled):
            numbers = [cells.number(text) for text in coordinates]
            if None in numbers:
                bad = coordinates[numbers.index(None)]
                what = f"a coordinate is {bad[:40]!r}" if bad else "a coordinate is empty"
                expected = f"numbers with a decimal {'comma' if cells.decimal == ',' else 'point'}"
                fix = "correct the cell, or empty the whole row"
                raise DataError(what, where=cells.where(row), expected=expected, fix=fix)
            values[n, : len(numbers)] = numbers
        if not filled:
            return None
        values = values if axes.system is None else to_lps(values, axes.system)
        return Points(cells.path, values, np.array([cells.first + row for row, _ in filled], dtype=np.int64))

    def _find_attributes(self, rows: Sequence[int], axes: _Axes) -> dict[str, str]:
        """Return what the table states once for a curve, in columns whose cells are the same all through."""
        found = {}
        for column, name in enumerate(self.names):
            texts = set(self.cells.column(rows, column)) - {""}
            if name in ATTRIBUTE_COLUMNS and column not in axes.columns and len(texts) == 1:
                found[ATTRIBUTE_COLUMNS[name]] = re.sub(r'[,"]', " ", texts.pop())
        return found
