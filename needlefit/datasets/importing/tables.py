"""Read tables of any layout, text or workbook, and find their curves: long, side by side, or in blocks."""

import codecs
import csv
import io
import re
import unicodedata
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import date, time, timedelta
from functools import cached_property, lru_cache
from itertools import count, groupby, pairwise, zip_longest
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from needlefit.arrays import Floats
from needlefit.datasets.formats.csv import MAX_COLUMNS, check_extent
from needlefit.datasets.importing.decisions import MODULI_GPA
from needlefit.datasets.points import MAX_COORDINATE, MIN_POINTS, Points, find_counters
from needlefit.errors import DataError
from needlefit.geometry.frames import PatientSystem, to_lps
from needlefit.grouping import group_values
from needlefit.project.input_files import open_regular, read_bytes
from needlefit.project.sandbox import READER_BYTES, SandboxArrays, limits_for, read_in_sandbox

TEXT_SUFFIXES = (".csv", ".tsv", ".txt", ".dat", ".asc")
WORKBOOK_FILE = Path(__file__).with_name("workbook.xlsx")  # to fill in; `EXAMPLE_SHEET`s are filled
SHEET_SUFFIXES = (".xlsx", ".xlsm", ".xlsb", ".xls", ".ods")

MAX_TABLE_BYTES, MAX_TABLE_CELLS = 16 * 2**20, 1_000_000  # of a text table; empty cells count
MAX_SHEETS, MAX_SHEET_CELLS = 200, 500_000  # sheets of a workbook that are read, and cells of all of them
MAX_UNPACKED_BYTES = 512 * 2**20  # what a workbook may unpack to
MAX_SHEET_BYTES = 64 * 2**20
SHEET_BYTES_PER_SECOND = 2**20
MAX_CELL_CHARS = 500  # longer text is no header and no number; the rest of it is dropped
SAMPLE_ROWS = 300  # rows by which the separator and the decimal sign are found
MAX_HEADER_ROWS = 6
MAX_LISTED_COLUMNS, MAX_LISTED_TEXTS = 12, 20  # columns of a message, and rows of text that are not used
MAX_JOINED_CURVES = 200  # that a curve is divided into
MIN_JUMP_STEPS = 4.0  # length of a step back, in median steps, that divides a curve into two
MIN_BLOCK_ROWS = 5  # rows at least of each value of a column that tells curves apart without a known name
SEPARATOR_NAMES = {";": "semicolon", "\t": "tab", "|": "bar", ",": "comma", " ": "blanks"}

# Units of length that a header may name, in mm.
UNITS_MM = MappingProxyType(
    {
        **{"mm": 1.0, "millimeter": 1.0, "millimetre": 1.0, "cm": 10.0, "m": 1e3, "dm": 100.0},
        **{"um": 1e-3, "µm": 1e-3, "μm": 1e-3, "micron": 1e-3, "in": 25.4, "inch": 25.4},
    }
)
# What a header, a field of a struct or the first cell of a pair stands for beside coordinates: the first that
# fits its letters, without accents, unit, blanks and signs.
_NUMBERED = r"(id|nr|no|num|number|nummer|numero|s)?"
_NEEDLE = "(?:needle|nadel|aiguille|aguja|ago)"
_ROLES = {
    role: re.compile(pattern)
    for role, pattern in {
        "boundaries": r"(?!.*(sd|std|sigma)$).*(boundary|boundaries|interface|grenze|frontiere|frontera).*",
        "inner diameter": r"(inner|innen|inside)(diameter|durchmesser)",
        "diameter": rf"(outer|aussen|{_NEEDLE})?(diameter|durchmesser|diametre|diametro|gauge|od)",
        "needle length": rf"{_NEEDLE}(length|lange)",
        "modulus": rf"(young|youngs|elastic)?modulus(gpa)?|emodul(gpa)?|{_NEEDLE}material",
        "needle": rf"{_NEEDLE}(type|typ|model|modell|kind|art|spec|tipo)",
        "bevel_side": r".*(bevel|schliff|biseau|bisel|smusso).*|(needle|tip)?(side|seite|cote|lado|lato)",
        "depth": r".*(depth|tiefe|profond|profund).*",
        "layers": r"(nr|no|n|num|number|anzahl|nombre|numero)?(of|de|der)?"
        rf"(layer|schicht|schichten|couche|capa){_NUMBERED}",
        "medium": r"medium|milieu|medio|material|materiau|phantom|fantome|tissue|gewebe|tissu|tejido|tessuto",
        "specimen": rf"(specimen|sample|probe|bloc|block|bloque|echantillon|muestra|campione){_NUMBERED}",
        "hole": rf"(hole|puncture|loch|trou|agujero|foro){_NUMBERED}",
        "name": r"(n|nr|no)?(id|needle|insertion|curve|name|shape|run|trial|test|label|code|measurement|nadel"
        r"|einstich|stich|kurve|versuch|messung|bezeichnung|aiguille|essai|mesure|courbe|nom|ago|aguja|ensayo"
        rf"|insercion|curva)+{_NUMBERED}",
        "sd": r"(point|punkt)?(sd|std|stdev|sigma|standarddeviation|standardabweichung|ecarttype)",
        "index": rf"index|nr|no|n|i|num|row|zeile|(mess)?(point|pt|punkt|punto){_NUMBERED}",
    }.items()
}
# Of these, what all insertions of an import share: answers to questions of the same names.
NEEDLE_ATTRIBUTES = ("needle length", "diameter", "inner diameter", "modulus")
# What an insertion has once.
ATTRIBUTES = (
    *("bevel_side", "depth", "layers", "medium", "specimen", "hole", "boundaries", "needle"),
    *NEEDLE_ATTRIBUTES,
)
# A length in the description of a needle is its diameter below the first, mm, and its length from the second.
MAX_DIAMETER_MM, MIN_LENGTH_MM = 5.0, 20.0

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
    {"coord", "coordinate", "coordinates", "koordinate", "coordenada", "coordonnée", "pos", "position"}
    | {"posición", "axis", "achse", "eje", "axe", "point", "points", "punkt"}
)
_PAIR = re.compile(r"([^:=]{1,60})[:=]\s*(\S.*)")
_NUMBER = re.compile(r"[-+\u2212]?\d+([.,]\d*)?")
_NUMBERS = re.compile(r"[-+\d., ]+")
_GAUGE = re.compile(r"\b(\d{1,2})\s*(?:g|ga|gauge)\b", re.IGNORECASE)
_LENGTH_MM = re.compile(r"(\d+(?:[.,]\d+)?)\s*mm\b", re.IGNORECASE)
_DEGREES = re.compile(r"deg|°|angle|winkel|angolo|[aá]ngulo|grad", re.IGNORECASE)
_SYSTEMS: tuple[tuple[str, PatientSystem | None], ...] = (("xyz", None), ("ras", "RAS"), ("lps", "LPS"))


@dataclass(frozen=True)
class CellTable:
    """The cells of a text table or of one sheet, as stripped text."""

    path: Path
    rows: Sequence[Sequence[str]]  # blank rows are among them; rows may differ in length
    first: int = 1  # line or row in its file of the first one, from 1
    left: int = 0  # empty columns of its sheet that were left out before the first one
    sheet: str = ""  # name of the sheet; empty for a text table
    # "." or ","; in a sheet, where numbers are stored as such, "." and commas are read too.
    decimal: str = "."
    separator: str = ""  # between the cells; empty for a sheet
    layout: str = ""  # how the file was read, for people
    transposed: bool = False  # its rows are the columns of the file

    def where(self, row: int, column: int | None = None) -> str:
        """Return the place of a row, or of its cell in a column, for a message."""
        line = "column" if self.transposed else "row"
        if self.sheet and column is not None:
            across, down = self.left + column + 1, self.first + row
            across, down = (down, across) if self.transposed else (across, down)
            return f"{self.path}, sheet {self.sheet!r}, cell {_name_column(across)}{down}"
        sheet = f", sheet {self.sheet!r}, {line} " if self.sheet else f", {line} " if self.transposed else ":"
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

    def turn_upright(self) -> "CellTable":
        """Return the table with a point in each row: transposed where x, y and z are rows."""
        rows = [row for row in self.rows if any(row)]
        if self.transposed or self.names_axes(n for n, row in enumerate(self.rows) if any(row)):
            return self
        turned = [tuple(column) for column in zip_longest(*self.rows, fillvalue="")]
        axes = [{_split_axis(cell)[0] for cell in column} for column in turned[:MAX_HEADER_ROWS]]
        heads = [n for n, one in enumerate(axes) if any(set(letters[:2]) <= one for letters, _ in _SYSTEMS)]
        numbers = [sum(self.number(cell) is not None for cell in row) for row in rows]
        if not heads and (len(rows) not in (2, 3) or min(numbers) < MIN_POINTS):
            return self
        for n in range(heads[0] if heads else 0):  # numbers of needles above their axes are no points
            turned[n] = (f"#{turned[n][0]}", *turned[n][1:])
        return replace(self, rows=turned, first=1 + self.left, left=self.first - 1, transposed=True)


def _name_column(number: int) -> str:
    """Return the letters of a column of a sheet, from 1: A to Z, AA."""
    letters = ""
    while number:
        number, rest = divmod(number - 1, 26)
        letters = chr(ord("A") + rest) + letters
    return letters


class UnclearColumnsError(DataError):
    """No columns of a table are known to be coordinates: it may hold something else."""


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
    check_extent(len(lines), 1, str(path), MAX_TABLE_CELLS)
    sample = [line for line in lines if line.strip()][: 2 * SAMPLE_ROWS]
    scores = {layout: _score(sample, *layout) or _names_needles(sample, layout[0]) for layout in _LAYOUTS}
    separator, decimal = max(scores, key=lambda layout: scores[layout])
    if scores[separator, decimal] <= 0:
        expected = "rows of coordinates: two or three numbers between separators"
        fix = "export the points of the needles as a table, one point a row"
        raise DataError("holds no table of numbers", where=str(path), expected=expected, fix=fix)
    rows = [_split(line, separator) for line in lines]
    check_extent(len(rows), max(map(len, rows), default=0), str(path), MAX_TABLE_CELLS)
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


def _names_needles(lines: Sequence[str], separator: str) -> bool:
    """Whether a header states something of needles, as in a table of their names and sides alone."""
    roles = [{find_role(cell) for cell in _split(line, separator)} for line in lines[:MAX_HEADER_ROWS]]
    return separator != " " and any("name" in one and not one.isdisjoint(ATTRIBUTES) for one in roles)


# ---- workbooks


def read_sheets(path: Path) -> tuple[CellTable, ...]:
    """Read every sheet of an Excel or OpenDocument workbook.

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
    sheets = [CellTable(path, rows, 1 + above, left, name) for name, (above, left), rows in found]
    if not any(any(map(any, one.rows)) for one in sheets):
        raise DataError(
            "holds no cells", where=str(path), expected="a sheet with coordinates", fix="name the right file"
        )
    return tuple(sheets)


def _workbook_error(path: Path, what: str) -> DataError:
    expected = f"an Excel or OpenDocument workbook of at most {MAX_SHEET_CELLS:,} cells, without password"
    fix = "save the sheet with the coordinates again, or export it as CSV"
    return DataError(what, where=str(path), expected=expected, fix=fix)


def read_workbook(_results: SandboxArrays, path: str) -> list[tuple[str, tuple[int, int], list[list[str]]]]:
    """Return name, rows left out above and columns left out before, and rows of each sheet; in the child
    process.
    """
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
            sheets.append((name[:MAX_CELL_CHARS], sheet.start or (0, 0), rows))
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
    # What the file states once for it, by the keys of `_ROLES`; a number with the unit of its header.
    attributes: Mapping[str, str] = field(default_factory=dict)
    remarks: tuple[tuple[str, str, str], ...] = ()  # what was taken how, and why, where it was not obvious


@dataclass(frozen=True)
class TableContent:
    """The curves of a table, or what it states of needles by their names; what was not used, and where."""

    curves: tuple[ImportedCurve, ...] = ()
    needles: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    unused: tuple[tuple[str, str], ...] = ()
    setup: Mapping[str, str] = field(default_factory=dict)  # answers by the names of questions


@dataclass(frozen=True)
class _Axes:
    """The columns of one curve: its name in the header, places of x, y, z (z may be missing), their unit."""

    name: str
    columns: tuple[int, ...]
    unit: str
    system: PatientSystem | None
    why: str
    span: range = range(MAX_COLUMNS)  # the columns that may state something of this curve
    common: int = 0  # those before this one may state something of all curves


@lru_cache(maxsize=1024)
def find_role(text: str) -> str:
    """Return what a header or a field of a struct stands for, a key of `_ROLES`; "" for anything else."""
    plain = unicodedata.normalize("NFKD", _CAMEL.sub(" ", _split_unit(text)[0])).lower()
    letters = "".join(_WORD.findall("".join(one for one in plain if not unicodedata.combining(one))))
    return next((role for role, pattern in _ROLES.items() if pattern.fullmatch(letters)), "")


def add_unit(text: str, header: str, unit: str = "") -> str:
    """Return a stated number with the unit of its header, where that names one; other texts as they are."""
    if not _NUMBER.fullmatch(text):
        return re.sub(r'[,"]', " ", text) if not _NUMBERS.fullmatch(text) else text
    if _DEGREES.search(header):
        return f"{text} deg"
    return f"{text} {_split_unit(header)[1] or unit}".strip()


def collect_stated(cells: Iterable[tuple[int, str, str, str, str]]) -> tuple[dict[str, str], set[int]]:
    """Return what cells state of one insertion, by `ATTRIBUTES`, and the places of the cells used.

    A cell: its place, role, header, text and unit. The first one of a role counts. A column that is called
    after needles and does not name the curves describes the needle itself: `22G nitinol`.
    """
    found: dict[str, str] = {}
    used: set[int] = set()
    for place, role, header, text, unit in cells:
        stated: dict[str, str] = {}
        if role in ("name", "needle"):
            stated = _parse_needle(text)
        elif role == "diameter" and "gauge" in header.lower() and text.isdecimal():
            stated = {role: f"{text}G"}
        elif role in ATTRIBUTES and text:
            stated = {role: add_unit(text, header, unit)}
        new = {key: value for key, value in stated.items() if key not in found}
        if role == "boundaries" and stated and not new:  # a column for each of several boundaries
            new = {role: f"{found[role]}; {stated[role]}"}
        found |= new
        used |= {place} if new else set()
    return found, used


def _parse_needle(text: str) -> dict[str, str]:
    """Return the gauge or diameter, length and material in a text such as `22G nitinol`."""
    found: dict[str, str] = {}
    for number in _LENGTH_MM.findall(text):
        value = float(number.replace(",", "."))
        if value < MAX_DIAMETER_MM:
            found.setdefault("diameter", f"{value:g}")
        elif value >= MIN_LENGTH_MM:
            found.setdefault("needle length", f"{value:g}")
    if gauge := _GAUGE.search(text):
        found["diameter"] = f"{gauge[1]}G"
    words = [word.lower() for word in _WORD.findall(text)]
    if material := next((word for word in words if word in MODULI_GPA), ""):
        found["modulus"] = material
    return found


def find_curves(cells: CellTable, columns: Sequence[str] = ()) -> TableContent:
    """Return the curves in a table, or what it states of needles; neither where it holds no coordinates.

    `columns`: the headers, or numbers from 1, of x, y and z, where the user states them.

    DataError if the columns of the coordinates cannot be found, or a coordinate is no number.
    """
    if not columns and (found := _find_needles(cells)) is not None:
        return found
    if not columns and (turned := cells.turn_upright()).transposed and not cells.transposed:
        found = find_curves(turned)
        placed = (replace(one, points=replace(one.points, lines=None)) for one in found.curves)
        return replace(found, curves=tuple(placed))
    unused: dict[tuple[str, str], None] = {}
    header: Sequence[int] = ()
    joined: dict[object, ImportedCurve] = {}
    for head, body in _divide(cells):
        header = head if not header or cells.names_axes(head) else header
        part = _Part(cells, body, header[-MAX_HEADER_ROWS:] if body else (), head)
        all_axes = part.all_axes(columns) if body else []
        curves = [one for axes in all_axes for one in part.read_curves(axes, len(all_axes) == 1)]
        for one in curves:
            before = joined.get(one.name)
            if before is None or not one.name or not _goes_on(before.points.values, one.points.values):
                joined[one.name if before is None else len(joined)] = one
            else:
                joined[one.name] = _join(before, one)
        unused |= dict.fromkeys(part.find_unused())
    return TableContent(tuple(joined.values()), {}, tuple(unused) if joined else ())


def _join(one: ImportedCurve, other: ImportedCurve) -> ImportedCurve:
    """Return a curve that goes on in a further part of its table."""
    both = [one.points, other.points]
    lines = np.concatenate([part.lines for part in both if part.lines is not None])
    values = np.concatenate([part.values for part in both])
    sds = [part.sd for part in both if part.sd is not None]
    sd = np.concatenate(sds) if len(sds) == len(both) else None
    lost = (("not used", "standard deviations of points", f"a part of {one.name} has none"),)
    remarks = (*one.remarks, *(lost if sds and sd is None else ()))
    return replace(one, points=replace(one.points, values=values, lines=lines, sd=sd), remarks=remarks)


def _goes_on(before: Floats, after: Floats) -> bool:
    """Whether points (N, 3) go on behind others; not if they begin anew, as those of another needle."""
    step, chord = after[0] - before[-1], before[-1] - before[0]
    return bool(step @ chord >= 0 or 2 * np.linalg.norm(step) <= np.linalg.norm(chord))


def _divide_points(values: Floats) -> list[NDArray[np.int64]]:
    """Return the rows of each part of points (N, 3) that jump back: of several needles below each other."""
    steps = np.diff(values, axis=0)
    with np.errstate(over="ignore", invalid="ignore"):
        lengths = np.linalg.norm(steps, axis=1)
        least = MIN_JUMP_STEPS * float(np.median(lengths[lengths > 0])) if lengths.any() else 0.0
        begin, parts = 0, list[NDArray[np.int64]]()
        for n in np.flatnonzero(lengths > least).tolist():
            chord = values[n] - values[begin]
            if steps[n] @ chord < 0 and 2 * lengths[n] > np.linalg.norm(chord):
                parts.append(np.arange(begin, n + 1))
                begin = n + 1
    parts.append(np.arange(begin, len(values)))
    is_right = len(parts) <= MAX_JOINED_CURVES and min(map(len, parts)) >= MIN_POINTS
    return parts if is_right else [np.arange(len(values))]


def _find_needles(cells: CellTable) -> TableContent | None:
    """Return what a table without coordinates states of needles, one a row; None where it is none."""
    for n, row in enumerate(cells.rows[:SAMPLE_ROWS]):
        roles = [find_role(text) for text in row]
        if any(cells.names_axes((m,)) for m in range(n, min(n + 3, len(cells.rows))) if cells.rows[m]):
            return None
        keys = [column for column, role in enumerate(roles) if role == "name"]
        below = [m for m in range(n + 1, len(cells.rows)) if any(cells.rows[m])]
        if not keys or not below:
            continue
        # of several columns that may name the curves, the one with most names
        key = max(keys, key=lambda column: len({*cells.column(below, column)}))
        units = _find_unit_row(cells.rows[n + 1 : n + 2])
        names = dict(zip(below, cells.column(below, key), strict=True))
        needles: dict[str, Mapping[str, str]] = {}
        used = {key}
        for m, name in names.items():
            others = zip(count(), roles, row, cells.rows[m], strict=False)
            stated, ours = collect_stated(
                (*cell, units.get(cell[0], "")) for cell in others if cell[0] != key
            )
            if name:
                needles[name] = stated
                used |= ours
        if not any(needles.values()):
            continue
        if _lists_needles(cells, names):
            where = Path(cells.where(n)).name
            columns = {m: text for m, text in enumerate(row) if text and m not in used}
            unused = [(f"column {text}", where) for text in columns.values()]
            unused += [
                (f"row {', '.join(filter(None, cells.rows[m]))}"[:MAX_CELL_CHARS], Path(cells.where(m)).name)
                for m, name in names.items()
                if not name and not (units and m == n + 1)
            ]
            return TableContent((), needles, tuple(unused))
        return None
    return None


def _lists_needles(cells: CellTable, names: Mapping[int, str]) -> bool:
    """Whether rows with these names list needles; not where each name has the rows of its points.

    DataError if a needle is listed more than once.
    """
    places = group_values((name, cells.first + row) for row, name in names.items() if name)
    if sum(map(len, places.values())) >= MIN_POINTS * len(places):
        return False
    for name, rows in places.items():
        if len(rows) > 1:
            what = f"needle {name!r} is listed {len(rows)} times, in rows {' and '.join(map(str, rows))}"
            fix = "remove the rows that repeat a needle, or correct their names"
            where = cells.where(rows[1] - cells.first)
            raise DataError(what, where=where, expected="one row for each needle", fix=fix)
    return True


def _divide(cells: CellTable) -> Iterator[tuple[Sequence[int], Sequence[int]]]:
    """Yield the header rows and the rows of numbers of each part: text, or a blank row, stands above it.

    Text below the last part is yielded without numbers.
    """
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
        if is_data and numbers < len(filled) and find_role(filled[0]):
            is_data = not _find_pairs(row)  # "bevel 1 depth 40" above each of two curves
        if body and (blank or not is_data):
            yield head, body
            head, body = [], []
        (body if is_data else head).append(n)
        blank = False
    if head or body:
        yield head, body


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
    """Rows of numbers of a table (`body`), the header rows of their columns, and the text above them."""

    cells: CellTable
    body: Sequence[int]
    header: Sequence[int]
    above: Sequence[int] = ()
    used: set[int] = field(default_factory=set)  # columns
    used_text: set[str] = field(default_factory=set)  # cells above

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
        width = max((len(self.cells.rows[n]) for n in self.body), default=0)
        return [self.cells.column(self.body, column) for column in range(width)]

    @cached_property
    def label_rows(self) -> list[int]:
        """The header rows that name columns: from the lowest one up to a title or a pair of cells."""
        found: list[int] = []
        for n, row in zip(self.header[::-1], self.heads[::-1], strict=True):
            # with blanks as separators, the words of a title are cells, too
            is_title = len({*row} - {""}) < 2 or (
                self.cells.separator == " " and len(row) != len(self.columns)
            )
            if found and (is_title or _find_pairs(row)):
                break
            if found and n < found[0] - 1:
                break  # a blank row, or one of units, is between them
            if not is_title and not _find_unit_row([row]) and not _find_pairs(row):
                found.insert(0, n)
        return found

    @cached_property
    def labels(self) -> list[list[str]]:
        """The cells of the rows that name columns, filled over merged columns."""
        rows = [self.cells.header(n) for n in self.label_rows]
        filled = []
        for row, below in pairwise([*rows, []]):
            full, text = list(row), ""
            for n, cell in enumerate(row):
                text = cell or (text if n < len(below) and below[n] else "")
                full[n] = text
            full += [text] * (len(below) - len(row)) if all(below[len(row) :]) else []
            filled.append(full)
        return filled

    @cached_property
    def names(self) -> list[str]:
        """The columns' headers, with those of the merged cells above them."""
        width = max(map(len, self.labels), default=0)
        columns = ([row[n] for row in self.labels if n < len(row)] for n in range(width))
        return [" ".join(dict.fromkeys(filter(None, column))) for column in columns]

    @cached_property
    def roles(self) -> list[str]:
        """What each column stands for: by its own header, else by that with those above."""
        own = ["" for _ in self.names]
        for row in self.labels:
            own = [text or before for text, before in zip_longest(row, own, fillvalue="")]
        return [find_role(text) or find_role(name) for text, name in zip(own, self.names, strict=True)]

    def all_axes(self, stated: Sequence[str]) -> list[_Axes]:
        """Return the columns of every curve; several groups of them divide the columns among each other."""
        found = sorted(self.find_axes(stated), key=lambda one: min(one.columns))
        # a group of columns that seldom changes is no curve: a target, or an entry, stated in every row
        found = [one for one in found if self._is_moving(one)] or found
        if len(found) < 2:
            return found
        starts = [min(one.columns) for one in found]
        for row in self.heads:  # names above the groups say where each begins
            places = [n for n, text in enumerate(row) if text and (not n or text != row[n - 1])]
            if len(places) == len(found) and all(a <= b for a, b in zip(places, starts, strict=True)):
                starts = places
                break
        ends = [*starts[1:], MAX_COLUMNS]
        return [
            replace(one, span=range(a, b), common=starts[0])
            for one, a, b in zip(found, starts, ends, strict=True)
        ]

    def _is_moving(self, axes: _Axes) -> bool:
        cells = (self.cells.column(self.body, n) for n in axes.columns)
        rows = [texts for texts in zip(*cells, strict=True) if any(texts)]
        return 2 * sum(one != other for one, other in pairwise(rows)) >= len(rows) - 1

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
                    what = f"there is no column {name!r}"
                    raise UnclearColumnsError(what, where=where, expected=expected, fix=fix)
                places.append(place)
            return [_Axes("", tuple(places), self._find_unit(places[0]), None, "--columns")]
        named = next((n for n in reversed(self.header) if self.cells.names_axes((n,))), None)
        return ([] if named is None else self._find_named(named)) or self._count_axes()

    def _find_unit(self, column: int) -> str:
        """Return the unit that a column's headers state, the lowest first, or the row of units."""
        texts = [row[column] for row in (*reversed(self.heads), *reversed(self.labels)) if column < len(row)]
        return next((unit for text in texts if (unit := _split_unit(text)[1])), self.units.get(column, ""))

    def _find_named(self, row: int) -> list[_Axes]:
        """Return the axes that a header row names; a letter that comes again begins another group."""
        found: dict[tuple[int, str], dict[str, int]] = {}
        for column, text in enumerate(self.cells.header(row)):
            axis, rest = _split_axis(text)
            if axis:
                turn = next(n for n in count() if axis not in found.get((n, rest), ()))
                found.setdefault((turn, rest), {})[axis] = column
        merged = {letter: column for columns in found.values() for letter, column in columns.items()}
        if len(merged) == len(found) == sum(map(len, found.values())):
            # each header has a word of its own beside its axis: "depth x", "deflection y"
            found = {(0, ""): merged}
        where = self.cells.where(row)
        axes = [
            _make_axes(rest, columns, self._find_unit(min(columns.values())), where)
            for (_, rest), columns in found.items()
        ]
        return [one for one in axes if one is not None]

    def _count_axes(self) -> list[_Axes]:
        """Return the axes of a table whose header names none: by the number of its columns."""
        roles = dict(enumerate(self.roles))
        others = {n for n, role in roles.items() if role not in ("", "index")}
        numbers = [[self.cells.number(text) for text in column] for column in self.columns]
        counts = [len(column) - column.count(None) for column in numbers]
        full = [n for n, count in enumerate(counts) if count > 0.5 * len(self.body) and n not in others]
        if drop := len(full) % 3 if len(full) > 3 else int(roles.get(next(iter(full), -1)) == "index"):
            counters = find_counters(np.array([numbers[n] for n in full], dtype=np.float64).T)[:drop]
            full = [n for m, n in enumerate(full) if m not in counters] if len(counters) == drop else full
        if len(list(filter(None, self.names))) >= max(len(full), 2) and len(full) != 3:
            full = []  # names that are not known must not be overruled
        if len(full) == 2:
            return [_Axes("", tuple(full), self.units.get(full[0], ""), None, "two columns of numbers")]
        if not full or len(full) % 3:
            shown = ", ".join(text for row in self.heads for text in row if text)[:300]
            raise UnclearColumnsError(
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

    def read_curves(self, axes: _Axes, is_only: bool) -> Iterator[ImportedCurve]:
        """Yield the curve of some columns, or several where columns of the table name them.

        `is_only`: no other curve lies beside it.
        """
        title, above = self._read_above(axes.span)
        keys = self._find_name_columns(axes)
        known = bool(keys)
        if not known and (key := self._find_key_column(axes)) is not None:
            keys = (key,)
        self.used.update(axes.columns, keys)
        names = [
            "-".join(filter(None, texts))
            for texts in zip(*(_fill_down(self.columns[key]) for key in keys), strict=True)
        ] or [""] * len(self.body)
        beside = "" if is_only else title or axes.name
        planar = len(axes.columns) == 2
        remarks = [("axes", "x, y; z = 0" if planar else "x, y, z", axes.why)]
        if keys and not known and self.names:
            why = "the column changes from curve to curve alone"
            remarks.append(("curves", f"one for each {self.names[keys[0]]}", why))
        system: PatientSystem | None = "LPS" if axes.system else None
        for name, rows in group_values(zip(names, self.body, strict=True)).items():
            whole = self._read_points(rows, axes)
            if whole is None:
                continue
            full = "-".join(filter(None, (name, beside))) if name else axes.name or title
            full = title if not name and title and not is_only else full
            if full == title:
                self.used_text.add(title)
            parts = _divide_points(whole.values)
            more = remarks
            if len(parts) > 1:
                why = "divided where the points jump back"
                more = [*remarks, (f"points of {full or self.cells.path.name}", f"{len(parts)} curves", why)]
            for n, part in enumerate(parts, 1):
                points = whole.part(part)
                lines = () if points.lines is None else points.lines.tolist()
                stated = above | self._find_attributes(
                    [line - self.cells.first for line in lines], axes, keys
                )
                own = f"{full}-{n}" if full and len(parts) > 1 else full
                yield ImportedCurve(own, points, axes.unit, system, stated, tuple(more))

    def _read_above(self, span: range) -> tuple[str, dict[str, str]]:
        """Return the title above some columns, such as `Needle 3`, and what pairs of cells there state."""
        stated: dict[str, str] = {}
        titles: list[str] = []
        for n in self.above[-MAX_HEADER_ROWS:]:
            filled = [cell for m, cell in enumerate(self.cells.header(n)) if cell and m in span]
            filled = [" ".join(filled)] if self.cells.separator == " " and not _find_pairs(filled) else filled
            pairs = _find_pairs(filled)
            for (key, value), role in pairs.items():
                stated.setdefault(role, add_unit(value, key))
                self.used_text.update(filled)
            if not pairs and not self.cells.names_axes((n,)) and len(set(filled)) == 1:
                titles.append(filled[0])
        named = [one for one in titles if find_role(next(iter(_WORD.findall(one)), "")) == "name"]
        return stated.pop("name", "") or next(iter([*named[::-1], *titles[::-1]]), ""), stated

    def _find_name_columns(self, axes: _Axes) -> tuple[int, ...]:
        """Return the columns of names that tell curves apart: the one that does, else all that change."""
        width = len(self.columns)
        columns = [
            n for n, role in enumerate(self.roles) if role == "name" and n < width and n not in axes.columns
        ]
        counts = {n: len(set(_fill_down(self.columns[n]))) for n in columns if self.columns[n][0]}
        # a name for each point is that of no curve
        counts = {n: count for n, count in counts.items() if count == 1 or 3 * count <= len(self.body)}
        if not counts:
            return ()
        varied = [n for n, count in counts.items() if count > 1] or list(counts)[:1]
        names = list(zip(*(_fill_down(self.columns[n]) for n in varied), strict=True))
        if len(set(names)) < len(list(groupby(names))):  # names that come again in the next specimen
            named = [n for n, role in enumerate(self.roles) if role in ("specimen", "hole") and n < width]
            varied = [*(n for n in named if len(set(self.columns[n])) > 1), *varied]
        together = len(set(zip(*(_fill_down(self.columns[n]) for n in varied), strict=True)))
        return next(((n,) for n in varied if counts.get(n) == together), tuple(varied))

    def _find_key_column(self, axes: _Axes) -> int | None:
        """Return the column that tells curves apart without a known name.

        The first whose value is one along each of several blocks of rows; without a header also the first one
        with text in every row.
        """
        # a table without another name may have one curve a hole, or a depth
        skipped = {"", *_ROLES} - {"", "hole", "depth"}
        heads = zip_longest(self.roles, self.names, self.columns, fillvalue="")
        for column, (role, name, texts) in enumerate(heads):
            blocks = [(text, len(list(run))) for text, run in groupby(texts)]
            distinct = len(set(texts))
            is_nameless = bool(self.names) and not name
            if column in axes.columns or role in skipped or not texts or not all(texts) or is_nameless:
                continue
            if 1 < distinct == len(blocks) and min(count for _, count in blocks) >= MIN_BLOCK_ROWS:
                return column
            if not self.names and not any(self.cells.number(text) is not None for text in texts):
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
                # errors such as #REF! are read as empty cells
                empty = "empty, or an error such as #REF!" if cells.sheet else "empty"
                what = f"a coordinate is {repr(bad[:40]) if bad else empty}"
                expected = f"numbers with a decimal {'comma' if cells.decimal == ',' else 'point'}"
                fix = "correct the cell, or empty the whole row"
                where = cells.where(row, axes.columns[numbers.index(None)])
                raise DataError(what, where=where, expected=expected, fix=fix)
            values[n, : len(numbers)] = numbers
        if not filled:
            return None
        values = values if axes.system is None else to_lps(values, axes.system)
        lines = np.array([cells.first + row for row, _ in filled], dtype=np.int64)
        return Points(cells.path, values, lines, self._read_sd([row for row, _ in filled], axes))

    def _read_sd(self, rows: Sequence[int], axes: _Axes) -> Floats | None:
        """Return the standard deviations of points, in the unit of the axes; None unless a column has all."""
        roles = enumerate(self.roles)
        column = next((n for n, role in roles if role == "sd" and n in axes.span), None)
        texts = [] if column is None else self.cells.column(rows, column)
        numbers = [number for text in texts if (number := self.cells.number(text)) is not None]
        if column is None or len(numbers) < len(rows):
            return None
        self.used.add(column)
        unit = UNITS_MM.get(self._find_unit(column) or axes.unit, 1.0) / UNITS_MM.get(axes.unit, 1.0)
        return unit * np.array(numbers, dtype=np.float64)

    def _find_attributes(self, rows: Sequence[int], axes: _Axes, keys: Sequence[int]) -> dict[str, str]:
        """Return what the table states once for a curve, in columns whose cells are the same all through.

        `keys`: the columns that name the curves.
        """
        cells = []
        for column, (role, name) in enumerate(zip(self.roles, self.names, strict=True)):
            texts = set(self.cells.column(rows, column)) - {""}
            is_near = column in axes.span or column < axes.common
            is_taken = column in axes.columns or (role == "name" and column in keys)
            if is_near and not is_taken and len(texts) == 1:
                cells.append((column, role, name, texts.pop(), self.units.get(column, "")))
        found, used = collect_stated(cells)
        self.used.update(used)
        return found

    def find_unused(self) -> Iterator[tuple[str, str]]:
        """Yield what no curve used: columns by their headers, and texts above them."""
        place = (*self.header, *self.body, *self.above)[0]
        where = Path(self.cells.where(place)).name
        for column, texts in enumerate(self.columns):
            if column not in self.used and any(texts):
                name = self.names[column] if column < len(self.names) else ""
                yield f"column {name or column + 1}", where
        known = {*self.used_text, *self.names}
        for n in self.above[:MAX_LISTED_TEXTS]:
            row = [cell for cell in self.cells.header(n) if cell]
            is_label = n in self.label_rows or (n in self.header and _find_unit_row([row]))
            text = " ".join(row) if self.cells.separator == " " else ", ".join(dict.fromkeys(row))
            if not is_label and not {*row} <= known and text not in known:
                yield f"text {text!r}"[:MAX_CELL_CHARS], Path(self.cells.where(n)).name


def _fill_down(texts: Sequence[str]) -> list[str]:
    """Return cells of a column of names; an empty one has the name above it."""
    names: list[str] = []
    for text in texts:
        names.append(text or (names[-1] if names else ""))
    return names


def _find_pairs(row: Sequence[str]) -> dict[tuple[str, str], str]:
    """Return the pairs of a name and a value in a row, with what the names stand for; none of a row of names.

    `bevel | 1 | depth | 40`, or `bevel: 1` in a cell.
    """
    filled = [cell for cell in row if cell]
    split = [(match[1].strip("#% "), match[2].strip()) for cell in filled if (match := _PAIR.fullmatch(cell))]
    if len(split) < len(filled):
        split = list(zip(filled[::2], filled[1::2], strict=False)) if len(filled) % 2 == 0 else []
        split = [] if any(find_role(value) or _split_axis(value)[0] for _, value in split) else split
    roles = {pair: find_role(pair[0].rstrip(":= ")) for pair in split}
    return roles if all(role in ("name", *ATTRIBUTES) for role in roles.values()) else {}
