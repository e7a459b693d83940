"""Find the curves of needles in tables, and what tables state of them, by the headers of their columns."""

import re
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.formats.csv import MAX_COLUMNS
from needlefit.datasets.importing.synonyms import (
    COORDINATES,
    UNITS_MM,
    Header,
    Stated,
    find_meaning,
    list_meanings,
    read_header,
    split_unit,
)
from needlefit.datasets.importing.tables import MISSING, CellTable, UnclearColumnsError
from needlefit.datasets.points import Points
from needlefit.errors import ConfigError, DataError
from needlefit.geometry.frames import PatientSystem, to_lps
from needlefit.geometry.surfaces import Surface

ATTRIBUTES = (  # what a table may state of an insertion; the last four are those of all insertions
    *("bevel side", "depth", "medium", "specimen", "hole", "boundaries"),
    *("needle length", "diameter", "inner diameter", "modulus"),
)
_KEYS = ("specimen", "hole", "needle")  # columns that tell curves apart
_VECTORS = ("entry", "target", "guide", "quaternion")  # columns x, y, z that are no points of a needle
MAX_LABEL_ROWS = 4  # rows above a header in which the names of its columns are looked for
MAX_TITLE_WORDS = 3  # of a title that names a needle
MAX_LISTED, MAX_LISTED_CHARS = 20, 200  # rows of a table of which unused cells are listed, and of a text
COLUMNS_FIX = "name them with --columns X,Y,Z or --columns needle=NAME,x=NAME,..., by header or number"


@dataclass(frozen=True)
class Readings:
    """What the rows of a tip's track state beside its places."""

    depth: Floats  # (N,), in the unit of its column; empty: no column of depths changes from row to row
    unit: str  # of the depths, as the file states it
    guide: Floats | None  # (N,), in the unit of the points, from the first on; None: not stated
    is_log: bool  # time or direction of the tip stand in each row, too
    is_deflection: bool  # the points are (depth, deflection, 0)


@dataclass(frozen=True)
class ImportedCurve:
    """One curve of a file, or the places of a tip in one run."""

    name: str  # as the file calls it; empty where it has no name
    points: Points  # in the unit and order of the file
    unit: str = ""  # as the file states it; empty where it does not
    # LPS once points were converted to it, as those of markups are; None where the file states no system.
    system: PatientSystem | None = None
    stated: Mapping[str, Stated] = field(default_factory=dict)  # of `ATTRIBUTES`, once for the curve
    axes: str = ""  # what names its coordinates; empty: nothing
    readings: Readings | None = None


@dataclass(frozen=True)
class ImportedSurface:
    """A surface of a file, in LPS where its system is known; kind and layer are not decided yet."""

    path: Path
    surface: Surface
    system: PatientSystem | None = None


@dataclass
class ImportContent:
    """What the files of an import hold, as they are read."""

    columns: Mapping[str, str] = field(default_factory=dict)  # headers or numbers that are stated, by meaning
    columns_found: set[str] = field(default_factory=set)  # meanings of those that any table has
    files: list[Path] = field(default_factory=list)
    curves: list[ImportedCurve] = field(default_factory=list)
    surfaces: list[ImportedSurface] = field(default_factory=list)
    needles: list[tuple[str, dict[str, Stated]]] = field(default_factory=list)  # names, and what is stated
    setup: dict[str, Stated] = field(default_factory=dict)  # answers by the names of questions
    notes: list[str] = field(default_factory=list)  # how files were read, where that may surprise
    unused: list[tuple[str, str]] = field(default_factory=list)  # what is not used; where it stands, or why
    unclear: UnclearColumnsError | None = None  # of the first table that was left out

    def leave_out(self, what: str, error: UnclearColumnsError) -> None:
        """Name a table as not used."""
        self.unused.append((what, error.what))
        self.unclear = self.unclear or error


def add_stated(known: dict[str, Stated], stated: Mapping[str, Stated]) -> None:
    """Add what is stated to what is known; DataError if the two differ."""
    for what, one in stated.items():
        if known.setdefault(what, one).text != one.text:
            text = f"{what} is {one.text[:60]!r}, and {known[what].text[:60]!r} in {known[what].where}"
            raise DataError(text, where=one.where, expected="one value", fix="correct one of the two")


def parse_columns(text: str) -> dict[str, str]:
    """Return the columns that `--columns` states, by meaning; ConfigError if it is not understood."""
    parts = [part.strip() for part in text.split(",")] if text.strip() else []
    pairs = [part.partition("=")[::2] for part in parts if "=" in part] or zip("xyz", parts, strict=False)
    stated = {meaning.strip(): name.strip() for meaning, name in pairs}
    known = ("x", "y", "z", *list_meanings())
    if len(stated) < len(parts) or not {*stated} <= {*known} or not all(stated.values()):
        what, fix = f"--columns is {text[:60]!r}", "write X,Y,Z or MEANING=HEADER, with commas between them"
        raise ConfigError(what, expected=f"headers or numbers of {', '.join(known)}", fix=fix)
    return stated


@dataclass(frozen=True)
class _Group:
    """The columns of one curve: places of x, y, z (z may be missing); `span` may state something of it."""

    name: str = ""
    columns: tuple[int, ...] = ()
    unit: str = ""
    system: PatientSystem | None = None
    span: Container[int] = range(MAX_COLUMNS)


@dataclass(frozen=True)
class _Head:
    """A header row, what its columns mean, and the columns of each curve."""

    row: int  # -1: there is none
    headers: Sequence[Header]
    groups: Sequence[_Group] = ()

    def find(self, group: _Group, *meanings: str) -> list[int]:
        """Return the columns with one of some meanings that state something of a group."""
        named = ((m, one.meaning or one.group) for m, one in enumerate(self.headers))
        return [
            m for m, meaning in named if meaning in meanings and m in group.span and m not in group.columns
        ]


@dataclass
class _Found:
    """A curve that is read: its columns, names in columns, what stands above it, and its rows."""

    head: _Head
    group: _Group
    names: tuple[str, ...] = ()
    above: Mapping[str, Stated] = field(default_factory=dict)
    rows: list[int] = field(default_factory=list)


def read_table(cells: CellTable, content: ImportContent) -> None:
    """Add the curves in a table, or what it states of needles; curves without a name have that of the table.

    UnclearColumnsError if nothing says which columns are coordinates. DataError if a cell of a known column
    is not understood.
    """
    reader = _TableReader(cells, content)
    curves = list(reader.read_curves()) if reader.heads else []
    if not reader.heads:
        reader.read_needles()
    stem = cells.sheet or cells.path.name.split(".")[0] or cells.path.stem
    unnamed, numbers = sum(not one.name for one in curves), count(1)
    if unnamed > 1:
        content.notes.append(f"{stem}: {unnamed} blocks of rows without names are {unnamed} needles")
    for one in curves:
        own = f"{stem}-{next(numbers)}" if unnamed > 1 and not one.name else stem
        content.curves.append(replace(one, name=one.name or own))
    content.unused += reader.list_unused()


class _TableReader:
    """Reads one table, and marks the cells that it uses."""

    def __init__(self, cells: CellTable, content: ImportContent) -> None:
        self.cells, self.content = cells, content
        self.width = max(map(len, cells.rows), default=0)
        self.heads: dict[int, _Head] = {}  # by their rows
        for n in range(len(cells.rows)):
            if len(cells.filled(n)) > 1 and not cells.count_numbers(n):
                self.add_head(n)
        axes = [content.columns[axis] for axis in "xyz" if axis in content.columns]
        if not self.heads and axes and all(map(str.isdecimal, axes)):  # above the first row of numbers there
            for n in range(len(cells.rows)):
                if all(cells.number(cells.cell(n, int(name) - 1)) is not None for name in axes):
                    self.add_head(n - 1 if n and not cells.count_numbers(n - 1) else -1)
                    break

    def use(self, row: int, *columns: int) -> None:
        """Mark cells as used."""
        self.cells.used.update((row, column) for column in columns)

    # ---- headers

    def add_head(self, n: int) -> None:
        """Add a row to the headers if it names coordinates, or depth and deflection."""
        rows = range(n - 1, max(n - 1 - MAX_LABEL_ROWS, -1), -1)
        above = next((m for m in rows if not self.find_pairs(m, self.cells.filled(m))), n)
        is_point = self.heads and self.cells.count_numbers(above) > 1
        is_title = n < 1 or len({*self.cells.rows[above]} - {""}) < 2
        labels = {} if is_point or is_title or above == n else dict(enumerate(self.cells.rows[above]))
        units, lent = self.find_units(n + 1), list[int]()
        headers = []
        for m in range(self.width):
            own = self.cells.cell(n, m).lstrip("#% ") if n >= 0 else ""
            label = labels.get(m, "").lstrip("#% ")
            one = read_header(own)
            if label and not one.meaning and not one.axis:
                one = read_header(f"{label} {own}".strip())
                lent.append(m)
            headers.append(replace(one, unit=one.unit or units.get(m, "")))
        headers = self.apply_columns(headers)
        groups = []
        found = self.find_groups(headers, n)
        starts = sorted(min(group.columns) for group in found)
        for group in found:
            # what stands before the first group is common to all
            end = next((m for m in starts if m > min(group.columns)), self.width)
            span = {*range(starts[0]), *range(min(group.columns), end)}
            label = labels.get(group.columns[0], "")
            text, unit = split_unit(label)
            beside = read_header(f"{text} x").group if text else ""
            if beside in _VECTORS:
                for m in group.columns:
                    headers[m] = replace(headers[m], text=f"{label} {headers[m].text}")
            name = group.name or (beside if len(found) > 1 else "")
            if beside not in _VECTORS:
                groups.append(replace(group, name=name, unit=group.unit or unit, span=span))
            lent += [group.columns[0]] if beside in _VECTORS or (name, unit) != (group.name, "") else []
        if groups:
            self.heads[n] = _Head(n, headers, groups)
            self.use(n, *range(self.width))
            self.use(n + 1, *units)
            self.use(above, *lent)
            for group in groups:
                self.require_single(self.heads[n], group)

    def find_units(self, n: int) -> dict[int, str]:
        """Return the units in a row below a header, by column; none where it holds anything else."""
        if n >= len(self.cells.rows) or self.cells.count_numbers(n):
            return {}
        texts = {m: self.cells.rows[n][m].strip("[]() ") for m in self.cells.filled(n)}
        units = {m: find_meaning("unit", text) for m, text in texts.items()}
        return {m: unit or texts[m] for m, unit in units.items()} if any(units.values()) else {}

    def apply_columns(self, headers: Sequence[Header]) -> list[Header]:
        """Return headers with the meanings that `--columns` states, which no other column then has."""
        texts, places = [one.text for one in headers], dict[int, str]()
        for meaning, name in self.content.columns.items():
            if name in texts:
                places[texts.index(name)] = meaning
            elif name.isdecimal() and 0 < int(name) <= len(texts):
                places[int(name) - 1] = meaning
        self.content.columns_found |= {*places.values()}
        found = []
        for m, one in enumerate(headers):
            meaning, axis = places.get(m, one.meaning), "" if m in places else one.axis
            if m not in places:  # no others are meant then
                meaning = "" if meaning in places.values() else meaning
                axis = "" if "x" in places.values() else axis
            elif meaning in ("x", "y", "z"):
                meaning, axis = "", meaning
            group, unit = "" if m in places else one.group, one.unit or split_unit(one.text)[1]
            found.append(Header(one.text, meaning, axis, group, unit))
        return found

    def find_groups(self, headers: Sequence[Header], n: int) -> list[_Group]:
        """Return the columns of each curve; a letter that comes again begins another one."""
        found: dict[tuple[int, str], dict[str, int]] = {}
        for m, one in enumerate(headers):
            if one.axis and one.group not in _VECTORS:
                turn = next(k for k in count() if one.axis not in found.get((k, one.group), ()))
                found.setdefault((turn, one.group), {})[one.axis] = m
        tips = [m for what in ("depth", "deflection") for m, one in enumerate(headers) if one.meaning == what]
        if not found and len(tips) == 2:
            found[0, ""] = dict(zip("xy", tips, strict=True))
        merged = {letter: m for places in found.values() for letter, m in places.items()}
        if len(found) > 1 and len(merged) == sum(map(len, found.values())):
            found = {(0, ""): merged}  # each axis stands beside a word of its own
        groups = []
        for (_, name), places in found.items():
            letters = next((one for one in COORDINATES if {*one} <= {*places}), "xyz")
            columns = tuple(places[one] for one in letters if one in places)
            units = {headers[m].unit for m in columns}
            if len(units) > 1 or (len(found) > 1 and [*columns] != sorted(columns)):
                what = f"the coordinates are {', '.join(headers[m].text for m in columns)}"
                where, expected = (
                    self.cells.where(max(n, 0), columns[0]),
                    "x, y, z in this order, of one unit",
                )
                raise DataError(what, where=where, expected=expected, fix=COLUMNS_FIX)
            systems: dict[str, PatientSystem] = {"ras": "RAS", "lps": "LPS"}
            groups += [_Group(name, columns, units.pop(), systems.get(letters))] if len(columns) > 1 else []
        return groups

    def require_single(self, head: _Head, group: _Group) -> None:
        """DataError if two columns state the same of a curve."""
        for meaning in ("needle", "sd", *ATTRIBUTES):
            columns = head.find(group, meaning)
            if len(columns) > 1 and meaning != "boundaries":
                what = f"{' and '.join(repr(head.headers[m].text) for m in columns)} may state the {meaning}"
                fix = f"state which one does: --columns {meaning}=HEADER"
                raise DataError(what, where=self.cells.where(max(head.row, 0)), expected="one", fix=fix)

    def find_pairs(self, n: int, filled: Sequence[int]) -> list[tuple[list[int], Header, str]]:
        """Return the pairs of a known name and a value, if some cells of a row are nothing else.

        `bevel | 1 | depth | 40`, `bevel: 1` in one cell, or a title such as `Needle 3`.
        """
        texts = {m: self.cells.rows[n][m].strip("#% ") for m in filled}
        title = texts[filled[0]] if len(filled) == 1 else ""
        if 1 < len(title.split()) <= MAX_TITLE_WORDS and find_meaning("column", title.split()[0]) == "needle":
            return [(list(filled), Header(title, "needle"), title)]
        split = {m: re.split(r"\s*[:=：]\s*", text, maxsplit=1) for m, text in texts.items()}
        couples = zip(filled[::2], filled[1::2], strict=False)
        pairs = [([a, b], texts[a].rstrip(":=： "), texts[b]) for a, b in couples]
        if all(len(parts) == 2 for parts in split.values()):
            pairs = [([m], parts[0], parts[1]) for m, parts in split.items()]
        found = [(places, read_header(name), value) for places, name, value in pairs]
        values = [read_header(split_unit(value)[0]) for *_, value in found]
        is_name = any(one.meaning or one.axis or find_meaning("filler", one.text) for one in values)
        is_known = all(one.meaning in ("needle", *ATTRIBUTES) for _, one, _ in found)
        is_whole = sum(len(places) for places, *_ in found) == len(filled)
        return found if is_known and is_whole and not is_name else []

    # ---- curves

    def find_blocks(self) -> Iterator[tuple[_Head, list[int], list[int]]]:
        """Yield the header, the rows of text above, and the rows of each block of points."""
        head, above, rows = self.heads.get(-1), list[int](), list[int]()
        for n, row in enumerate([*self.cells.rows, []]):
            is_head = n in self.heads
            is_point = head is not None and any(row) and not is_head and self.is_point(head, n, bool(rows))
            if rows and not is_point and head is not None:
                yield head, above, rows
                above, rows = [], []
            head = self.heads.get(n, head)
            if is_point and head is not None:
                self.require_width(head, n)
                rows.append(n)
            elif any(row) and not is_head:
                above.append(n)

    def require_width(self, head: _Head, n: int) -> None:
        """DataError where the cells of a row of text do not stand under those of its header."""
        row, width = self.cells.rows[n], len(self.cells.rows[head.row])
        is_moved = (self.cells.separator == "," and any(row[width:])) or (
            self.cells.separator == " " and len(row) != width
        )
        if head.row >= 0 and is_moved:
            what = f"has {len(row)} cells under {width} columns"
            expected, fix = "as many cells as the header", "save it with semicolons or tabs between"
            raise DataError(what, where=self.cells.where(n), expected=expected, fix=fix)

    def is_point(self, head: _Head, n: int, is_open: bool) -> bool:
        """Whether a row has coordinates, or cells under known headers alone; not one of labels.

        `is_open`: coordinates stand in the row above.
        """
        texts = [[self.cells.cell(n, m) for m in one.columns] for one in head.groups]
        numbers = max(sum(self.cells.number(text) is not None for text in one) for one in texts)
        filled = self.cells.filled(n)
        if numbers > 1 or self.find_pairs(n, filled):
            return numbers > 1
        if (is_open and numbers) or any(text.lower() in MISSING for one in texts for text in one):
            return True
        return not any(map(any, texts)) and any(head.headers[m].meaning for m in filled)

    def read_curves(self) -> Iterator[ImportedCurve]:
        """Yield the curves of the table: one for each name, or, without names, for each block of rows."""
        found: dict[tuple[object, ...], _Found] = {}
        last: dict[tuple[int, int], str] = {}  # names stand in each row, or in the first one
        for block, (head, above, rows) in enumerate(self.find_blocks()):
            for group in head.groups:
                labels = self.read_labels(group, above)
                keys = [m for what in _KEYS for m in head.find(group, what)]
                is_named = bool(head.find(group, "needle", "hole"))
                for n in rows:
                    last |= {(head.row, m): text for m in keys if (text := self.cells.cell(n, m))}
                    names = tuple(last.get((head.row, m), "") for m in keys)
                    key = (group.name, group.columns, names, is_named or block)
                    found.setdefault(key, _Found(head, group, names, labels)).rows.append(n)
        ones = [one for one in found.values() if any(self.list_filled(one))]
        is_unique = len({(one.group.name, *one.names[-1:]) for one in ones}) == len(ones)
        for one in ones:
            yield self.read_curve(one, "-".join(filter(None, one.names[-1:] if is_unique else one.names)))

    def list_filled(self, one: _Found) -> list[int]:
        """Return the rows of a curve in which not all coordinates are missing."""
        texts = {n: [self.cells.cell(n, m) for m in one.group.columns] for n in one.rows}
        return [n for n, row in texts.items() if any(text and text.lower() not in MISSING for text in row)]

    def read_labels(self, group: _Group, rows: Sequence[int]) -> dict[str, Stated]:
        """Return what pairs of cells above a block state of a curve in it, and titles name."""
        stated: dict[str, Stated] = {}
        for n in rows:
            filled = [m for m in self.cells.filled(n) if m in group.span]
            for places, header, text in self.find_pairs(n, filled):
                stated[header.meaning] = Stated(text, header.unit, self.cells.where(n, places[-1]))
                self.use(n, *places)
        return stated

    def read_curve(self, found: _Found, own: str) -> ImportedCurve:
        """Return one curve, with what the table states once for it. `own`: its name in a column."""
        cells, group, head = self.cells, found.group, found.head
        rows = self.list_filled(found)
        keys = head.find(group, *_KEYS)
        for n in {*rows, *found.rows[:1]}:
            self.use(n, *keys)
        values = np.zeros((len(rows), 3))
        values[:, : len(group.columns)] = self.read_numbers(rows, group.columns)
        lines = np.array([cells.first + n for n in rows], dtype=np.int64)
        points = Points(cells.path, to_lps(values, group.system) if group.system else values, lines)
        for m in head.find(group, "sd"):
            unit = head.headers[m].unit or group.unit
            factor = UNITS_MM.get(unit, 1.0) / UNITS_MM.get(group.unit or unit, 1.0)
            points = replace(points, sd=factor * self.read_numbers(rows, [m])[:, 0])
        stated = {**found.above, **self.read_attributes(found)}
        title = stated.pop("needle", None)
        beside = group.name or (title.text if title and not own else "")
        axes = (
            "--columns"
            if "x" in self.content.columns
            else f"header: {Path(cells.where(max(head.row, 0))).name}"
        )
        axes += ", z = 0" if len(group.columns) == 2 else ""
        name = "-".join(filter(None, (own, beside)))
        system: PatientSystem | None = "LPS" if group.system else None
        return ImportedCurve(name, points, group.unit, system, stated, axes, self.read_readings(found, rows))

    def read_numbers(self, rows: Sequence[int], columns: Sequence[int]) -> Floats:
        """Return the numbers in some columns (N, M); DataError at the first cell that is none."""
        values = np.zeros((len(rows), len(columns)))
        for k, n in enumerate(rows):
            for i, m in enumerate(columns):
                text = self.cells.cell(n, m)
                number = self.cells.number(text)
                if number is None:  # errors such as #REF! are read as empty cells
                    what = f"a number is {repr(text[:40]) if text else 'empty'}"
                    expected = f"numbers with a decimal {'comma' if self.cells.decimal == ',' else 'point'}"
                    fix = "correct the cell, or empty all coordinates of its row"
                    raise DataError(what, where=self.cells.where(n, m), expected=expected, fix=fix)
                values[k, i] = number
            self.use(n, *columns)
        return values

    def read_attributes(self, found: _Found) -> dict[str, Stated]:
        """Return what columns state once for a curve; DataError if two cells of one contradict each other."""
        stated: dict[str, Stated] = {}
        for meaning in ATTRIBUTES:
            for m in found.head.find(found.group, meaning):
                header = found.head.headers[m]
                cells = [(self.cells.cell(n, m), n) for n in found.rows if self.cells.cell(n, m)]
                other = next(((text, n) for text, n in cells if text != cells[0][0]), None)
                if not cells or (other and meaning == "depth"):
                    continue  # that of each reading
                if other:
                    what = f"{header.text} is both {cells[0][0][:40]!r} and {other[0][:40]!r}"
                    expected = f"the same in each row of {'-'.join(found.names) or 'the curve'}"
                    fix = f"correct the cell; if other columns tell the needles apart, {COLUMNS_FIX}"
                    raise DataError(what, where=self.cells.where(other[1], m), expected=expected, fix=fix)
                for _, n in cells:
                    self.use(n, m)
                text, where = cells[0][0], self.cells.where(cells[0][1], m)
                before = f"{stated[meaning].text}; " if meaning in stated else ""  # of several boundaries
                stated[meaning] = Stated(before + text, header.unit, where)
        return stated

    def read_readings(self, found: _Found, rows: Sequence[int]) -> Readings | None:
        """Return what makes a curve the track of a tip: depth, time or direction in each row."""
        head, group = found.head, found.group
        is_deflection = any(head.headers[m].meaning == "deflection" for m in group.columns)
        is_log = bool(head.find(group, "time", "quaternion"))
        columns = group.columns[:1] if is_deflection else head.find(group, "depth")
        if len({self.cells.cell(n, m) for n in rows for m in columns}) < 2:
            return Readings(np.empty(0), "", None, is_log, False) if is_log else None
        guides = head.find(group, "guide")
        places = self.read_numbers(rows, guides) if guides else np.zeros((len(rows), 1))
        if np.ptp(places, axis=0).any() and head.headers[guides[0]].axis:
            what, fix = f"{head.headers[guides[0]].text} changes", "name it: --columns guide=HEADER"
            expected = "one column with the lateral position of the guide"
            raise DataError(what, where=self.cells.where(rows[0], guides[0]), expected=expected, fix=fix)
        depth, unit = self.read_numbers(rows, columns)[:, 0], head.headers[columns[0]].unit
        guide = places[:, 0] - places[0, 0] if guides else None
        return Readings(depth, unit or group.unit, guide, is_log, is_deflection)

    # ---- needles, and what is left

    def read_needles(self) -> None:
        """Add what a table without coordinates states of needles, one a row.

        UnclearColumnsError if it does not name needles. DataError if one is listed twice.
        """
        for n, row in enumerate(self.cells.rows):
            head, group = _Head(n, self.apply_columns([read_header(text) for text in row])), _Group()
            keys = head.find(group, "needle")
            if not keys or not head.find(group, *ATTRIBUTES):
                continue
            self.require_single(head, group)
            self.heads[n], units = head, self.find_units(n + 1)
            self.use(n, *range(self.width))
            self.use(n + 1, *units)
            listed: set[str] = set()
            for m in range(n + 1 + bool(units), len(self.cells.rows)):
                name = self.cells.cell(m, keys[0])
                if name in listed:
                    what, fix = f"needle {name!r} is listed twice", "remove the row, or correct its name"
                    where = self.cells.where(m, keys[0])
                    raise DataError(what, where=where, expected="one row for each needle", fix=fix)
                if name:
                    listed.add(name)
                    self.use(m, keys[0])
                    stated = self.read_attributes(_Found(head, group, (name,), rows=[m]))
                    self.content.needles.append((name, stated))
            return
        names = ", ".join(dict.fromkeys(text for row in self.cells.rows[:6] for text in row if text))
        what = f"no header names coordinates: {names[:MAX_LISTED_CHARS]}"
        expected = "columns called x, y, z, or depth and deflection"
        raise UnclearColumnsError(what, where=self.cells.where(0), expected=expected, fix=COLUMNS_FIX)

    def list_unused(self) -> Iterator[tuple[str, str]]:
        """Yield what is not used: columns by their headers, and other cells by their rows."""
        cells, starts = self.cells, sorted(self.heads)
        for n, end in zip(starts, [*starts[1:], len(cells.rows)], strict=True):
            for m, header in enumerate(self.heads[n].headers):
                body = {(k, m) for k in range(n + 1, end) if cells.cell(k, m)}
                if body and not body & cells.used and (header.text or n < 0):
                    cells.used.update(body)
                    yield f"column {header.text or m + 1}", Path(cells.where(max(n, 0))).name
        left: dict[int, list[str]] = {}
        for n, row in enumerate(cells.rows):
            for m, text in enumerate(row):
                if text and (n, m) not in cells.used:
                    left.setdefault(n, []).append(text)
        for n, texts in [*left.items()][:MAX_LISTED]:
            yield f"row {', '.join(texts)}"[:MAX_LISTED_CHARS], Path(cells.where(n)).name
        if len(left) > MAX_LISTED:
            yield f"cells of {len(left) - MAX_LISTED} more rows", cells.path.name
