"""Read files as grids of cells: texts, workbooks, and formats with a structure of their own."""

import codecs
import csv
import io
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import date, time, timedelta
from functools import partial
from itertools import pairwise, zip_longest
from pathlib import Path
from typing import Any

from needlefit.datasets.formats import find_format
from needlefit.datasets.formats.csv import check_extent
from needlefit.datasets.importing.meanings import EXPORTS, find_meaning, is_bore, read_header
from needlefit.datasets.points import MAX_COORDINATE, Points
from needlefit.errors import DataError
from needlefit.geometry.frames import PatientSystem
from needlefit.project.input_files import open_regular, read_bytes, read_once
from needlefit.project.reader_process import BYTES_PER_SECOND, READER_BYTES, Arrays, read_in_process
from needlefit.schemas.mapping import ColumnName, TableRecord

TEXT_SUFFIXES = (".csv", ".tsv", ".txt", ".dat", ".asc", ".lvm")
SHEET_SUFFIXES = (".xlsx", ".xlsm", ".xlsb", ".xls", ".ods")
MAX_TABLE_BYTES = 16 * 2**20  # largest text table (bytes)
MAX_TABLE_CELLS = 1_000_000  # largest table (cells, empty ones included)
MAX_SHEET_BYTES = 64 * 2**20  # largest workbook (bytes)
MAX_CELL_CHARS = 500  # longest text of a cell (characters): longer text is no header and no number
UNIT_FIELDS = ("unit", "units")  # names of columns and of fields beside a curve, in lower case


class SheetNumber(str):
    """A cell of a sheet that is a number, not a text: its decimal sign is a point."""

    __slots__ = ()


_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([ed][-+]?\d+)?", re.IGNORECASE)


@dataclass(frozen=True)
class Table:
    """The cells of a text file or of one sheet, as stripped text; laid out, those below its headers.

    Rows that are laid out have as many cells as there are headers; it has no `lines` where the file has none.
    """

    path: Path
    rows: Sequence[Sequence[str]]  # blank rows are among them; rows may differ in length
    sheet: str = ""  # empty for a text file
    file: str = ""  # what its file is called among others of the same name
    is_only_sheet: bool = False  # all other sheets of its workbook are empty
    lines: Sequence[int] = ()  # of the file, on which a row begins; empty: row n is line n
    is_transposed: bool = False  # its rows are columns of the file
    headers: tuple[str, ...] = ()
    places: Sequence[str] = ()  # of each row
    decimal: str = "."
    thousands: str = ""
    system: PatientSystem | None = None  # of the scan, which the format states
    unit: str = ""  # of lengths without one of their own, which the file states
    first_headers: tuple[tuple[str, ...], ...] = ()  # texts of the rows of headers
    remarked: tuple[str, ...] = ()  # last headers: of values that stand above the rows, in no column
    unread: Sequence[str] = ()  # what states nothing of the needles: lines, remarks on how the file was read

    @property
    def name(self) -> str:
        """What a needle without a name is called: the sheet if it is one of several, else the file."""
        is_of_file = self.is_only_sheet or not self.sheet
        return name_stem(self.path, self.file) if is_of_file else self.sheet

    @property
    def where(self) -> str:
        """Its file, and of a workbook its sheet."""
        return f"{self.path}, sheet {self.sheet}" if self.sheet else str(self.path)

    def place(self, row: int) -> str:
        """Return the place of a row, counted from 0."""
        if self.sheet or self.is_transposed:
            return f"{self.where}, {'column' if self.is_transposed else 'row'} {row + 1}"
        return f"{self.path}:{self.lines[row] if self.lines else row + 1}"

    def transpose(self) -> "Table":
        """Return the table whose rows are the columns of this one."""
        rows = [[*row] for row in zip_longest(*self.rows, fillvalue="")]
        return replace(self, rows=rows, lines=(), is_transposed=True)

    def find(self, name: ColumnName) -> int | None:
        """Return the column with a header or number; None if there is none, or several."""
        if isinstance(name, int):
            return name - 1 if 1 <= name <= len(self.headers) else None
        for texts in (self.headers, *self.first_headers):
            matches = [n for n, text in enumerate(texts) if text == name]
            if len(matches) == 1:
                return matches[0]
        return None

    def fill_down(self, names: Sequence[ColumnName]) -> "Table":
        """Return the table in which a blank cell of some columns is the one above."""
        rows = [[*row] for row in self.rows]
        for column in [place for name in names if (place := self.find(name)) is not None]:
            for above, row in pairwise(rows):
                row[column] = row[column] or above[column]
        return replace(self, rows=rows)

    def number(self, text: str) -> float | None:
        """Return the number in a cell; None where there is none."""
        return parse_number(text, self.decimal, self.thousands)


def name_files(paths: Sequence[Path]) -> dict[Path, str]:
    """Return what each of different files is called: its name, after folders of those that share theirs."""
    names, count = {path: path.name for path in paths}, 1
    while alike := {name for name, number in Counter(names.values()).items() if number > 1}:
        count += 1
        names |= {
            path: "/".join(path.absolute().parts[-count:])
            for path, name in names.items()
            if "/" in name or name in alike
        }
    return names


def name_stem(path: Path, name: str = "") -> str:
    """Return the name of a file without its ending; `name`: what it is called, with folders."""
    return name.removesuffix(path.name) + path.name.partition(".")[0]


def parse_number(text: str, decimal: str = ".", thousands: str = "") -> float | None:
    """Return a number with these signs; None for anything else."""
    if isinstance(text, SheetNumber):
        decimal, thousands = ".", ""
    plain = text.replace("\u00a0", "").replace("\u2212", "-").strip()
    plain = plain.replace(thousands, "") if thousands else plain
    if decimal == ",":
        plain = plain.replace(",", ".") if "." not in plain and plain.count(",") < 2 else "?"
    value = float(plain.lower().replace("d", "e")) if _NUMBER.fullmatch(plain) else None
    return value if value is not None and abs(value) <= MAX_COORDINATE else None


def is_like_number(text: str) -> bool:
    """Whether a text is a number, with a decimal point or a comma."""
    return any(parse_number(text, sign) is not None for sign in ".,")


# ---- read files


def read_grids(path: Path, record: TableRecord) -> tuple[Table, ...]:
    """Return the grids of a text file, as its mapping states it, or of a workbook: one for each sheet."""
    if path.suffix.lower() in SHEET_SUFFIXES:
        return read_sheets(path)
    text = decode(read_text_bytes(path), path, record.encoding)
    return (split_text(text, path, record.separator),)


@read_once
def read_text_bytes(path: Path) -> bytes:
    """Return the content of a text table; DataError if it is missing or too large."""
    return read_bytes(path, MAX_TABLE_BYTES)


def decode(data: bytes, path: Path, encoding: str) -> str:
    """Return the text of a file, by its byte order mark, else as stated."""
    is_wide = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    try:
        text = data.decode("utf-16" if is_wide else encoding)
    except (UnicodeDecodeError, LookupError):
        text = "\0"
    if "\0" in text:
        raise DataError(
            f"cannot be read as text in {encoding}",
            expected="text in UTF-8, UTF-16 or Windows-1252",
            fix="state its encoding, or save it again as CSV (UTF-8)",
            where=path,
        )
    return text.removeprefix("\ufeff")


def split_text(text: str, path: Path, separator: str) -> Table:
    """Return the cells of a text; a cell in quotes may hold line breaks and separators."""
    lines = text.splitlines()
    check_extent(len(lines), 1, str(path), MAX_TABLE_CELLS)
    if separator == " ":
        rows = [_split_blanks(line) for line in lines]
        starts: list[int] = []
    else:
        read = partial(csv.reader, delimiter=separator, skipinitialspace=True)
        reader, rows, starts, end = read(f"{line}\n" for line in lines), [], [], 0
        try:
            for cells in reader:
                starts.append(end + 1)
                if reader.line_num > end + 1:  # quotes that are not closed would take in all that follows
                    list(read(lines[end : reader.line_num], strict=True))
                end = reader.line_num
                rows.append([cell.strip()[:MAX_CELL_CHARS] for cell in cells])
        except csv.Error as error:
            raise DataError(
                f"a row cannot be divided into cells: {error}",
                expected="quotes around whole cells, which are closed",
                fix="close the quotes, or remove them",
                where=f"{path}:{end + 1}",
            ) from None
    check_extent(len(rows), max(map(len, rows), default=0), str(path), MAX_TABLE_CELLS)
    return Table(path, rows, lines=starts)


def _split_blanks(line: str) -> list[str]:
    """Return the words of a line; those in quotes are one, and a unit in brackets is of its header."""
    words = re.findall(r'"[^"]*"|\S+', line.replace(" [", "[").replace(" (", "("))
    return [word.strip('"')[:MAX_CELL_CHARS] for word in words]


@read_once
def read_sheets(path: Path) -> tuple[Table, ...]:
    """Read every sheet of an Excel or OpenDocument workbook.

    DataError if the file is missing, too large, no workbook, or protected by a password.
    """
    with open_regular(path, MAX_SHEET_BYTES) as file:
        size = file.seek(0, io.SEEK_END)
    reader, seconds = f"{__name__}:read_workbook", size / BYTES_PER_SECOND
    sheets, _ = read_in_process(reader, path, {"path": str(path)}, READER_BYTES, seconds)
    is_only_sheet = sum(any(map(any, rows)) for _, rows in sheets) == 1
    return tuple(
        Table(path, [[*map(_to_text, row)] for row in rows], name, is_only_sheet=is_only_sheet)
        for name, rows in sheets
    )


def read_workbook(_arrays: Arrays, path: str) -> list[tuple[str, list[list[str | float]]]]:
    """Return name and rows of each sheet, from its first cell on; in the child process."""
    from python_calamine import CalamineWorkbook

    book, sheets = CalamineWorkbook.from_filelike(io.BytesIO(read_bytes(Path(path), MAX_SHEET_BYTES))), []
    for name in book.sheet_names:
        sheet = book.get_sheet_by_name(name)
        above, left = sheet.start or (0, 0)
        check_extent(above + sheet.height, left + sheet.width, path, MAX_TABLE_CELLS)
        rows = [[_to_cell(cell) for cell in row] for row in sheet.to_python(skip_empty_area=False)]
        for (top, column), (bottom, _) in sheet.merged_cell_ranges or ():
            bottom = min(bottom, len(rows) - 1)
            check_extent(max(bottom - top, 0), 1, path, MAX_TABLE_CELLS)
            for row in rows[top + 1 : bottom + 1] if column < max(map(len, rows)) else ():
                row[column] = rows[top][column]  # what merged cells hold stands in the first one
        sheets.append((name[:MAX_CELL_CHARS], rows))
    return sheets


def _to_text(cell: str | float) -> str:
    if isinstance(cell, str):
        return cell
    return SheetNumber(repr(int(cell)) if cell.is_integer() and abs(cell) < 2**53 else repr(cell))


def _to_cell(cell: Any) -> str | float:  # noqa: ANN401 - whatever a sheet holds
    if isinstance(cell, bool | date | time | timedelta):
        return str(cell)
    if isinstance(cell, int | float):
        return float(cell)
    return "".join(letter if letter.isprintable() else " " for letter in str(cell))[:MAX_CELL_CHARS].strip()


# ---- formats with a structure of their own


@read_once
def read_structured(path: Path) -> Table:
    """Return the curves of a file of a format with names and points as one table.

    Its headers are `needle`, the axes with their unit, then the fields beside the curves.
    """
    form = find_format(path)
    if form is None or form.read_curves is None or path.suffix.lower() in TEXT_SUFFIXES:
        raise DataError(
            f"has the ending {path.suffix!r}, which is not read",
            expected="a table, a workbook, .mat, .h5, .npz, .npy, .json, .jsonl, markups, or an RT structure",
            fix=EXPORTS.get(path.suffix.lower(), EXPORTS["other"]),
            where=path,
        )
    curves, remarks = form.read_curves(path)
    units = {_read_unit(points) or ("mm" if form.in_scan else "") for points in curves.values()}
    if len(units) > 1 or any(", " in unit for unit in units):
        raise DataError(
            f"states the units {', '.join(sorted(filter(None, units)))}",
            expected="one unit",
            fix="correct the field of the unit",
            where=path,
        )
    (unit,) = units
    keys = dict.fromkeys(key for points in curves.values() for key in (*points.stated, *points.columns))
    names_of = [key for key in keys if read_header(key).meaning == "needle" and not is_bore(key, keys)]
    fields = [key for key in keys if key.lower() not in UNIT_FIELDS and key not in names_of]
    rows, places = list[tuple[str, ...]](), list[str]()
    for name, points in curves.items():
        count = len(points.values)
        beside: dict[str, Sequence[str]] = {
            key: [text] * count for key, text in points.stated.items() if text
        }
        beside |= points.columns
        names = next((beside[key] for key in reversed(beside) if key in names_of), [name] * count)
        coordinates = (map(repr, axis) for axis in points.values.T.tolist())
        rows += zip(names, *coordinates, *(beside.get(key, [""] * count) for key in fields), strict=False)
        places += map(points.where, range(count))
    headers = ("needle", *(f"{axis} [{unit}]" if unit else axis for axis in "xyz"), *fields)
    system: PatientSystem | None = "LPS" if form.in_scan else None
    return Table(path, rows, headers=headers, places=places, system=system, unit=unit, unread=[*remarks])


def _read_unit(points: Points) -> str:
    """Return the unit that names and fields of a curve state; several as one text."""
    texts = {text for key, text in points.stated.items() if key.lower() in UNIT_FIELDS}
    units = {find_meaning("unit", text) or text for text in {*texts, points.unit} if text}
    return ", ".join(sorted(units))
