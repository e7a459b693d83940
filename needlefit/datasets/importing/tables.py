"""Read text tables of any separator, decimal sign and encoding, and the sheets of workbooks, as cells."""

import codecs
import csv
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import date, time, timedelta
from pathlib import Path
from typing import Any

from needlefit.datasets.formats.csv import check_extent
from needlefit.datasets.importing.synonyms import read_header
from needlefit.datasets.points import MAX_COORDINATE
from needlefit.errors import DataError, refusal
from needlefit.project.input_files import open_regular, read_bytes
from needlefit.project.reader_process import BYTES_PER_SECOND, READER_BYTES, Arrays, read_in_process

TEXT_SUFFIXES = (".csv", ".tsv", ".txt", ".dat", ".asc")
SHEET_SUFFIXES = (".xlsx", ".xlsm", ".xlsb", ".xls", ".ods")

MAX_TABLE_BYTES = 16 * 2**20  # of a text table
MAX_TABLE_CELLS = 1_000_000  # of any table; empty cells count
MAX_SHEET_BYTES = 64 * 2**20
MAX_CELL_CHARS = 500  # longer text is no header and no number; the rest of it is dropped
SAMPLE_ROWS = 300  # rows by which the separator and the decimal sign are found
MISSING = frozenset(["nan", "na", "n/a", "-", "--", "null", "none", "missing", "#n/a", "inf", "-inf", "+inf"])

_NUMBERS = {
    ".": re.compile(r"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?", re.IGNORECASE),
    ",": re.compile(r"[-+]?(\d{1,3}(\.\d{3})+,\d+|\d+,?\d*|,\d+)(e[-+]?\d+)?", re.IGNORECASE),
}
_NUMBER_START = re.compile(r"[-+\u2212(~<>]*\d")
_LAYOUTS = (  # separators and decimal signs, in the order in which equally good ones are taken
    *((";", ","), (";", "."), ("\t", ","), ("\t", "."), (",", "."), (",", ","), (" ", ","), (" ", ".")),
)


class UnclearTableError(DataError):
    """A table may be read in more than one way."""


class UnclearLayoutError(UnclearTableError):
    """Each row may be a needle, or hold a point of each."""


class UnclearColumnsError(UnclearTableError):
    """No columns of a table are known to be coordinates: it may hold something else."""


Place = tuple[int, int]  # row and column of a cell


@dataclass(frozen=True, eq=False)
class CellTable:
    """The cells of a text table or of one sheet, as stripped text, and which of them were used."""

    path: Path
    rows: Sequence[Sequence[str]]  # blank rows are among them; rows may differ in length
    sheet: str = ""  # name of the sheet; empty for a text table
    decimal: str = "."  # in a sheet, where numbers are stored as such, a comma in a text is read, too
    separator: str = ""  # between the cells; empty for a sheet
    used: set[tuple[int, int]] = field(default_factory=set)  # rows and columns of the cells that were used

    def where(self, row: int, column: int | None = None) -> str:
        """Return the place of a row, or of its cell in a column, for a message."""
        cell = "" if column is None else f", column {column + 1}"
        place = f", sheet {self.sheet}, row {row + 1}" if self.sheet else f":{row + 1}"
        return f"{self.path}{place}{cell}"

    def use(self, row: int, *columns: int) -> None:
        """Mark cells of a row as used."""
        self.used.update((row, column) for column in columns)

    def cell(self, row: int, column: int) -> str:
        """Return a cell; empty where its row ends before it."""
        return self.rows[row][column] if column < len(self.rows[row]) else ""

    def number(self, text: str) -> float | None:
        """Return the number in a cell; None where there is none."""
        found = parse_number(text, self.decimal)
        return parse_number(text, ",") if found is None and self.sheet else found

    def filled(self, row: int) -> list[int]:
        """Return the columns of a row that are not empty."""
        return [column for column, text in enumerate(self.rows[row]) if text]

    def count_numbers(self, row: int) -> int:
        """Return how many cells of a row are numbers."""
        return sum(self.number(text) is not None for text in self.rows[row] if text)


def parse_number(text: str, decimal: str) -> float | None:
    """Return a number written with a decimal sign; None for anything else.

    With a decimal comma, points before it separate thousands.
    """
    plain = text.replace("\u00a0", "").replace("\u2212", "-").strip()
    if not _NUMBERS[decimal].fullmatch(plain):
        return None
    value = float(plain.replace(".", "").replace(",", ".") if decimal == "," else plain)
    return value if abs(value) <= MAX_COORDINATE else None


def is_number_like(text: str) -> bool:
    """Whether a cell begins as a number: also one with another decimal sign, or with a remark behind it."""
    return _NUMBER_START.match(text) is not None


# ---- text


def read_text_cells(path: Path) -> CellTable:
    """Read a text table.

    DataError if the file is missing, too large or no text.
    """
    lines = _decode(read_bytes(path, MAX_TABLE_BYTES), path).splitlines()
    check_extent(len(lines), 1, str(path), MAX_TABLE_CELLS)
    sample = [line for line in lines if line.strip()][: 2 * SAMPLE_ROWS]
    # a blank may stand in any text: it separates cells where no tab does
    has_tabs = 2 * sum("\t" in line for line in sample) > len(sample)
    scores = {one: _score(sample, *one) for one in _LAYOUTS if one[0] != " " or not has_tabs}
    separator, decimal = max(scores, key=lambda layout: scores[layout])
    rows = [_split(line, separator) for line in lines]
    check_extent(len(rows), max(map(len, rows), default=0), str(path), MAX_TABLE_CELLS)
    return CellTable(path, rows, decimal=decimal, separator=separator)


def _decode(data: bytes, path: Path) -> str:
    """Return the text of a file: by its byte order mark, else UTF-8, else Windows-1252."""
    is_wide = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    try:
        text = data.decode("utf-16" if is_wide else "utf-8-sig")
    except UnicodeDecodeError:
        # of two encodings the one in which more headers are known
        texts = [data.decode(name, errors="replace") for name in ("cp1252", "gb18030")]
        text = max(texts, key=_count_known_headers)
    if "\0" in text:
        raise refusal(f"""cannot be read as text
            expected: text in UTF-8, UTF-16 or Windows-1252
            fix: save it again as CSV (UTF-8)
            where: {path}""")
    return text


def _count_known_headers(text: str) -> int:
    """Return how many of the first words and phrases between separators are known as headers."""
    parts = re.split(r"[;,\t\n\r]", text[:MAX_CELL_CHARS])
    return sum(bool(read_header(part.strip()).meaning) for part in parts)


def _split(line: str, separator: str) -> list[str]:
    line = line.strip("\ufeff").strip(None if separator == " " else " \r\n")
    if separator == " ":
        return line.replace(" [", "[").replace(" (", "(").split()
    try:
        (cells,) = csv.reader([line], delimiter=separator, skipinitialspace=True) if line else [[]]
    except (csv.Error, ValueError):
        cells = line.split(separator)
    return [cell.strip()[:MAX_CELL_CHARS] for cell in cells]


def _score(lines: Sequence[str], separator: str, decimal: str) -> int:
    """Return how well a layout explains lines: numbers in rows with two of them, less cells that are none.

    Three coordinates beside four columns of names still count as a table, and so do known headers alone.
    """
    total = 0
    for line in lines[-SAMPLE_ROWS:]:  # a header may be long, the numbers stand at the end
        cells = [cell for cell in _split(line, separator) if cell and cell.lower() not in MISSING]
        numbers = sum(parse_number(cell, decimal) is not None for cell in cells)
        total += 5 * numbers - 2 * len(cells) if numbers > 1 else 0
    heads = [sum(bool(read_header(cell).meaning) for cell in _split(line, separator)) for line in lines[:6]]
    return total + max([one for one in heads if one > 1], default=0)


# ---- workbooks


def read_sheets(path: Path) -> tuple[CellTable, ...]:
    """Read every sheet of an Excel or OpenDocument workbook.

    DataError if the file is missing, too large, no workbook, or protected by a password.
    """
    with open_regular(path, MAX_SHEET_BYTES) as file:
        size = file.seek(0, io.SEEK_END)
    reader, seconds = f"{__name__}:read_workbook", size / BYTES_PER_SECOND
    found, _ = read_in_process(reader, path, {"path": str(path)}, READER_BYTES, seconds)
    return tuple(CellTable(path, rows, name) for name, rows in found)


def read_workbook(_arrays: Arrays, path: str) -> list[tuple[str, list[list[str]]]]:
    """Return name and rows of each sheet, from its first cell on; in the child process."""
    from python_calamine import CalamineWorkbook

    book, sheets = CalamineWorkbook.from_filelike(io.BytesIO(read_bytes(Path(path), MAX_SHEET_BYTES))), []
    for name in book.sheet_names:
        sheet = book.get_sheet_by_name(name)
        above, left = sheet.start or (0, 0)
        check_extent(above + sheet.height, left + sheet.width, path, MAX_TABLE_CELLS)
        rows = [[_sheet_text(cell) for cell in row] for row in sheet.to_python(skip_empty_area=False)]
        _fill_merged(rows, sheet.merged_cell_ranges or (), path)
        sheets.append((name[:MAX_CELL_CHARS], rows))
    return sheets


def _fill_merged(rows: list[list[str]], ranges: Sequence[tuple[Place, Place]], path: str) -> None:
    """Write what merged cells hold, which stands in the first one, into all cells below it."""
    width = max(map(len, rows), default=0)
    inside = [(top, min(bottom, len(rows) - 1), left) for (top, left), (bottom, _) in ranges if left < width]
    check_extent(sum(max(bottom - top, 0) for top, bottom, _ in inside), 1, path, MAX_TABLE_CELLS)
    for top, bottom, left in inside:
        for row in rows[top + 1 : bottom + 1]:
            row[left] = rows[top][left]


def _sheet_text(cell: Any) -> str:  # noqa: ANN401 - whatever a sheet holds
    if isinstance(cell, bool | date | time | timedelta):
        return str(cell)
    if isinstance(cell, int | float):
        return repr(int(cell)) if float(cell).is_integer() and abs(cell) < 2**53 else repr(float(cell))
    return "".join(one if one.isprintable() else " " for one in str(cell))[:MAX_CELL_CHARS].strip()
