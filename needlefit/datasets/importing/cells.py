"""Read a text table or a spreadsheet as cells, whatever its separator, decimal sign and encoding."""

import codecs
import csv
import io
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date, time, timedelta
from pathlib import Path
from typing import Any

from needlefit.datasets.formats.csv import MAX_COLUMNS
from needlefit.datasets.points import MAX_COORDINATE
from needlefit.errors import DataError
from needlefit.project.input_files import open_regular, read_bytes
from needlefit.project.sandbox import READER_BYTES, SandboxArrays, limits_for, read_in_sandbox

TEXT_SUFFIXES = (".csv", ".tsv", ".txt", ".dat", ".asc")
SHEET_SUFFIXES = (".xlsx", ".xlsm", ".xlsb", ".xls", ".ods")

MAX_TABLE_BYTES, MAX_TABLE_CELLS = 16 * 2**20, 1_000_000
"""Of a text table; empty cells count."""

MAX_SHEETS, MAX_SHEET_CELLS = 200, 500_000
"""Sheets of a workbook that are read, and cells of all of them."""

MAX_UNPACKED_BYTES = 512 * 2**20
"""What a workbook may unpack to."""

MAX_SHEET_BYTES = 64 * 2**20
SHEET_BYTES_PER_SECOND = 2**20
MAX_CELL_CHARS = 500
"""Longer text is no header and no number; the rest of it is dropped."""

SAMPLE_ROWS = 300
"""Rows by which the separator and the decimal sign are found."""

SEPARATOR_NAMES = {";": "semicolon", "\t": "tab", "|": "bar", ",": "comma", " ": "blanks"}

_LAYOUTS = (
    *((";", ","), (";", "."), ("\t", ","), ("\t", "."), ("|", ","), ("|", ".")),
    *((",", "."), (" ", ","), (" ", ".")),
)
"""Separators and decimal signs, in the order in which equally good ones are taken."""

_BOMS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
_MISSING = frozenset({"nan", "na", "n/a", "-", "--", "null", "none", "#n/a", "inf", "-inf", "+inf"})


@dataclass(frozen=True)
class CellTable:
    """The cells of a text table or of one sheet, as stripped text.

    Attributes
    ----------
    rows : sequence of sequences of str
        Blank rows are among them; rows may differ in length.
    lines : sequence of int
        Line or row of each in its file, from 1.
    sheet : str
        Name of the sheet; empty for a text table.
    decimal : str
        "." or ","; in a sheet, where numbers are stored as such, "." and commas are read too.
    separator : str
        Between the cells; empty for a sheet.
    layout : str
        How the file was read, for people.
    """

    path: Path
    rows: Sequence[Sequence[str]]
    lines: Sequence[int]
    sheet: str = ""
    decimal: str = "."
    separator: str = ""
    layout: str = ""

    def where(self, row: int) -> str:
        """Return the place of a row for a message."""
        sheet = f", sheet {self.sheet!r}, row " if self.sheet else ":"
        return f"{self.path}{sheet}{self.lines[row]}"

    def number(self, text: str) -> float | None:
        """Return the number in a cell; None where there is none."""
        found = parse_number(text, self.decimal)
        return parse_number(text, ",") if found is None and self.sheet else found


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


def read_text_cells(path: Path) -> CellTable:
    """Read a text table.

    Raises
    ------
    DataError
        If the file is missing, too large, no text, or holds no row with two numbers.
    """
    text, encoding = _decode(read_bytes(path, MAX_TABLE_BYTES), path)
    lines = text.splitlines()
    _require_extent(len(lines), 1, path)
    sample = [line for line in lines if line.strip()][: 2 * SAMPLE_ROWS]
    separator, decimal = max(_LAYOUTS, key=lambda layout: _score(sample, *layout))
    if _score(sample, separator, decimal) <= 0:
        raise DataError(
            "holds no table of numbers",
            where=str(path),
            expected="rows of coordinates: two or three numbers between separators",
            fix="export the points of the needles as a table, one point a row",
        )
    rows = [_split(line, separator) for line in lines]
    _require_extent(len(rows), max(map(len, rows), default=0), path)
    sign = "decimal comma" if decimal == "," else "decimal point"
    layout = f"{SEPARATOR_NAMES[separator]}-separated, {sign}, {encoding}"
    return CellTable(path, rows, range(1, len(rows) + 1), "", decimal, separator, layout)


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
    raise DataError(
        "cannot be read as text",
        where=str(path),
        expected="text in UTF-8, UTF-16 or Latin-1",
        fix="save it again as CSV (UTF-8), or name the right file",
    )


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
        raise DataError(
            f"is too large: {rows} rows of {columns} columns",
            where=str(path),
            expected=f"at most {MAX_COLUMNS} columns, and {MAX_TABLE_CELLS:,} cells",
            fix="check that it is the file that you meant, or divide it",
        )


def read_sheets(path: Path) -> tuple[CellTable, ...]:
    """Read every sheet of an Excel or OpenDocument workbook that is not empty.

    Raises
    ------
    DataError
        If the file is missing, too large, no workbook, protected by a password, or holds no cells.
    """
    _require_small_archive(path)
    with open_regular(path, MAX_SHEET_BYTES) as file:
        size = file.seek(0, io.SEEK_END)
    allowed = limits_for(READER_BYTES, READER_BYTES, size / SHEET_BYTES_PER_SECOND)
    found, _ = read_in_sandbox(f"{__name__}:read_workbook", path, allowed, {"path": str(path)})
    sheets = tuple(
        CellTable(path, rows, range(1 + first, 1 + first + len(rows)), name)
        for name, first, rows in found
        if any(any(row) for row in rows)
    )
    if not sheets:
        raise DataError(
            "holds no cells", where=str(path), expected="a sheet with coordinates", fix="name the right file"
        )
    return sheets


def _require_small_archive(path: Path) -> None:
    """See that a workbook, where it is a ZIP archive, does not claim to unpack to gigabytes."""
    with open_regular(path, MAX_SHEET_BYTES) as file:
        if file.read(4) != b"PK\x03\x04":
            return
        file.seek(0)
        try:
            size = sum(one.file_size for one in zipfile.ZipFile(file).infolist())
        except Exception as fault:  # zipfile raises whatever the bytes provoke
            raise _workbook_error(path, f"is a damaged archive ({type(fault).__name__})") from None
    if size > MAX_UNPACKED_BYTES:
        raise _workbook_error(path, f"unpacks to {size / 2**20:.0f} MiB")


def _workbook_error(path: Path, what: str) -> DataError:
    return DataError(
        what,
        where=str(path),
        expected=f"an Excel or OpenDocument workbook of at most {MAX_SHEET_CELLS:,} cells, without password",
        fix="save the sheet with the coordinates again, or export it as CSV",
    )


def read_workbook(_results: SandboxArrays, path: str) -> list[tuple[str, int, list[list[str]]]]:
    """Return name, number of rows left out above, and rows of each sheet; in the child process."""
    from python_calamine import CalamineWorkbook

    file = Path(path)
    try:
        book = CalamineWorkbook.from_filelike(io.BytesIO(read_bytes(file, MAX_SHEET_BYTES)))
        if len(book.sheet_names) > MAX_SHEETS:
            raise _workbook_error(file, f"has {len(book.sheet_names)} sheets")
        sheets = []
        count = 0
        for name in book.sheet_names:
            sheet = book.get_sheet_by_name(name)
            count += sheet.height * sheet.width
            if count > MAX_SHEET_CELLS or sheet.width > MAX_COLUMNS:
                raise _workbook_error(file, f"is too large: sheet {name[:60]!r} has {count:,} cells")
            first = sheet.start[0] if sheet.start else 0
            rows = [[_sheet_text(cell) for cell in row] for row in sheet.to_python(skip_empty_area=True)]
            sheets.append((name[:MAX_CELL_CHARS], first, rows))
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
