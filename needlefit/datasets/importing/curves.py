"""Find the curves of needles in tables, and what tables state of them, by the headers of their columns."""

import re
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.importing.answers import Stated
from needlefit.datasets.importing.synonyms import (
    UNITS_MM,
    Header,
    find_meaning,
    list_meanings,
    read_header,
    split_unit,
)
from needlefit.datasets.importing.tables import MISSING, CellTable, UnclearColumnsError
from needlefit.datasets.points import Points
from needlefit.errors import ConfigError, DataError
from needlefit.geometry.curves import arc_length
from needlefit.geometry.frames import PatientSystem
from needlefit.geometry.surfaces import Surface

# What a table may state of an insertion.
ATTRIBUTES = ("bevel side", "depth", "medium", "specimen")
_KEYS = ("specimen", "needle")  # columns that tell curves apart
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


@dataclass
class ImportedCurve:
    """One curve of a file, or the places of a tip in one run; a plan brings it into mm, and cuts it."""

    name: str  # as the file calls it; empty where it has no name
    points: Points
    unit: str = ""  # as the file states it; empty where it does not
    # LPS once points were converted to it, as those of markups are; None where the file states no system.
    system: PatientSystem | None = None
    stated: Mapping[str, Stated] = field(default_factory=dict)  # of `ATTRIBUTES`, once for the curve
    axes: str = ""  # what names its coordinates; empty: nothing
    readings: Readings | None = None
    shaft: Floats = field(default_factory=lambda: np.empty((0, 3)))  # (K, 3); points up to the entry

    @property
    def line(self) -> Floats:
        """The points (N, 3)."""
        return self.points.values

    @property
    def length(self) -> float:
        """The length along the points."""
        return float(arc_length(self.line)[-1])


@dataclass
class ImportContent:
    """What the files of an import hold, as they are read."""

    columns: Mapping[str, str] = field(default_factory=dict)  # headers or numbers that are stated, by meaning
    columns_found: set[str] = field(default_factory=set)  # meanings of those that any table has
    files: list[Path] = field(default_factory=list)
    curves: list[ImportedCurve] = field(default_factory=list)
    # With their files and systems; in LPS where it is known. Kind and layer are not decided yet.
    surfaces: list[tuple[Surface, Path, PatientSystem | None]] = field(default_factory=list)
    needles: list[tuple[str, dict[str, Stated]]] = field(default_factory=list)  # names, and what is stated
    setup: dict[str, Stated] = field(default_factory=dict)  # answers by the names of questions
    notes: list[str] = field(default_factory=list)  # how files were read, where that may surprise
    unused: list[tuple[str, str]] = field(default_factory=list)  # what is not used; where it stands, or why
    unclear: UnclearColumnsError | None = None  # of the first table that was left out

    def leave_out(self, what: str, error: UnclearColumnsError) -> None:
        """Name a table as not used."""
        self.unused.append((what, error.what))
        self.unclear = self.unclear or error


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
    """The columns of one curve below a row of headers."""

    row: int  # of the headers; -1: there are none
    headers: Sequence[Header]
    span: Container[int]  # columns that may state something of the curve
    columns: tuple[int, ...] = ()  # of x, y and z; z may be missing
    name: str = ""
    unit: str = ""

    def find(self, *meanings: str) -> list[int]:
        """Return the columns with one of some meanings that state something of the curve."""
        named = ((m, one.meaning or one.group) for m, one in enumerate(self.headers))
        return [m for m, one in named if one in meanings and m in self.span and m not in self.columns]


@dataclass
class _Found:
    """A curve that is read: its columns, names in columns, what stands above it, and its rows."""

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
        self.heads: dict[int, list[_Group]] = {}  # the curves below each row of headers
        for n in range(len(cells.rows)):
            if len(cells.filled(n)) > 1 and not cells.count_numbers(n):
                self.add_head(n)
        if not self.heads:  # --columns may number the columns of a table without headers
            self.add_head(-1)

    def use(self, row: int, *columns: int) -> None:
        """Mark cells as used."""
        self.cells.used.update((row, column) for column in columns)

    # ---- headers

    def add_head(self, n: int) -> None:
        """Add a row to the headers if it names coordinates, or depth and deflection.

        A row above may begin the headers, or name curves; the row below may state units.
        """
        own = [read_header(self.cells.cell(n, m).lstrip("#% ") if n >= 0 else "") for m in range(self.width)]
        rows = range(n - 1, max(n - 1 - MAX_LABEL_ROWS, -1), -1)
        above = next((m for m in rows if not self.find_pairs(m, self.cells.filled(m))), n)
        filled = self.cells.filled(above) if 0 <= above < n else []
        is_point = self.heads and self.cells.count_numbers(above) > 1
        if is_point or len(filled) < 2 or any(own[m].axis in ("y", "z") for m in filled):
            filled = []
        units, headers, label = self.find_units(n + 1), list[Header](), ""
        for m, one in enumerate(own):
            label = self.cells.rows[above][m].lstrip("#% ") if m in filled else label if one.axis else ""
            one = one if one.meaning or not label else read_header(f"{label} {one.text}".strip())
            headers.append(replace(one, unit=one.unit or units.get(m, "")))
        headers = self.apply_columns(headers)
        found = self.find_groups(headers, n)
        starts = sorted(min(group.columns) for group in found)
        for group in found:
            first = min(group.columns)
            end = next((m for m in starts if m > first), self.width)
            span = {*range(starts[0]), *range(first, end)}  # what stands before the first is common to all
            name = group.name if len(found) > 1 else own[first].group
            self.heads.setdefault(n, []).append(replace(group, name=name, span=span))
            self.require_single(self.heads[n][-1])
        if found:
            self.use(n, *range(self.width))
            self.use(n + 1, *units)
            self.use(above, *(m for m in filled if headers[m].text != own[m].text))

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
            own, unit = places.get(m, ""), one.unit or split_unit(one.text)[1]
            if own:
                is_axis = own in ("x", "y", "z")
                one = Header(one.text, "" if is_axis else own, own if is_axis else "", unit=unit)
            elif one.meaning in places.values() or (one.axis and "x" in places.values()):
                one = Header(one.text)
            found.append(one)
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
        groups = []
        for (_, name), places in found.items():
            columns = tuple(places[one] for one in "xyz" if one in places)
            units = {headers[m].unit for m in columns}
            if len(units) > 1 or (len(found) > 1 and [*columns] != sorted(columns)):
                what = f"the coordinates are {', '.join(headers[m].text for m in columns)}"
                where, expected = self.cells.where(max(n, 0), columns[0]), "x, y, z in order, of one unit"
                raise DataError(what, where=where, expected=expected, fix=COLUMNS_FIX)
            if len(columns) > 1:
                groups.append(_Group(n, headers, (), columns, name, units.pop()))
        return groups

    def require_single(self, group: _Group) -> None:
        """DataError if two columns state the same of a curve."""
        for meaning in ("needle", "sd", *ATTRIBUTES):
            columns = group.find(meaning)
            if len(columns) > 1:
                what = f"{' and '.join(repr(group.headers[m].text) for m in columns)} may state the {meaning}"
                fix = f"state which one does: --columns {meaning}=HEADER"
                raise DataError(what, where=self.cells.where(max(group.row, 0)), expected="one", fix=fix)

    def find_pairs(self, n: int, filled: Sequence[int]) -> list[tuple[list[int], Header, str]]:
        """Return the pairs of a known name and a value among some cells of a row, if it is none of headers.

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
        return [] if is_name else [one for one in found if one[1].meaning in ("needle", *ATTRIBUTES)]

    # ---- curves

    def find_blocks(self) -> Iterator[tuple[list[_Group], list[int], list[int]]]:
        """Yield the curves of the headers, the rows of text above, and the rows of each block of points."""
        groups, above, rows = self.heads.get(-1, []), list[int](), list[int]()
        for n, row in enumerate([*self.cells.rows, []]):
            is_head = n in self.heads
            is_point = any(row) and not is_head and self.is_point(groups, n, bool(rows))
            if rows and not is_point:
                yield groups, above, rows
                above, rows = [], []
            groups = self.heads.get(n, groups)
            if is_point:
                self.require_width(groups[0].row, n)
                rows.append(n)
            elif any(row) and not is_head:
                above.append(n)

    def require_width(self, head: int, n: int) -> None:
        """DataError where the cells of a row of text do not stand under those of its header."""
        row, width = self.cells.rows[n], len(self.cells.rows[head])
        is_longer = self.cells.separator == "," and any(row[width:])
        if head >= 0 and (is_longer or (self.cells.separator == " " and len(row) != width)):
            what = f"has {len(row)} cells under {width} columns"
            expected, fix = "as many cells as the header", "save it with semicolons or tabs between"
            raise DataError(what, where=self.cells.where(n), expected=expected, fix=fix)

    def is_point(self, groups: Sequence[_Group], n: int, is_open: bool) -> bool:
        """Whether a row has coordinates, or cells under known headers alone; not one of labels.

        `is_open`: coordinates stand in the row above.
        """
        texts = [[self.cells.cell(n, m) for m in one.columns] for one in groups]
        numbers = max((sum(self.cells.number(text) is not None for text in one) for one in texts), default=0)
        filled = self.cells.filled(n)
        if numbers > 1 or not groups or self.find_pairs(n, filled):
            return numbers > 1
        if (is_open and numbers) or any(text.lower() in MISSING for one in texts for text in one):
            return True
        return not any(map(any, texts)) and any(groups[0].headers[m].meaning for m in filled)

    def read_curves(self) -> Iterator[ImportedCurve]:
        """Yield the curves of the table: one for each name, or, without names, for each block of rows."""
        found: dict[tuple[object, ...], _Found] = {}
        last: dict[tuple[int, int], str] = {}  # names stand in each row, or in the first one
        for block, (groups, above, rows) in enumerate(self.find_blocks()):
            for group in groups:
                labels = self.read_labels(group, above)
                keys = [m for what in _KEYS for m in group.find(what)]
                is_named = bool(group.find("needle"))
                for n in rows:
                    last |= {(group.row, m): text for m in keys if (text := self.cells.cell(n, m))}
                    names = tuple(last.get((group.row, m), "") for m in keys)
                    key = (group.name, group.columns, names, is_named or block)
                    found.setdefault(key, _Found(group, names, labels)).rows.append(n)
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
        group, rows = found.group, self.list_filled(found)
        for n in {*rows, *found.rows[:1]}:
            self.use(n, *group.find(*_KEYS))
        values = np.zeros((len(rows), 3))
        values[:, : len(group.columns)] = self.read_numbers(rows, group.columns)
        points = Points(self.cells.path, values, np.array(rows, dtype=np.int64) + 1)
        for m in group.find("sd"):
            unit = group.headers[m].unit or group.unit
            factor = UNITS_MM.get(unit, 1.0) / UNITS_MM.get(group.unit or unit, 1.0)
            points = replace(points, sd=factor * self.read_numbers(rows, [m])[:, 0])
        stated = {**found.above, **self.read_attributes(found)}
        title = stated.pop("needle", None)
        beside = group.name or (title.text if title and not own else "")
        header = f"header: {Path(self.cells.where(max(group.row, 0))).name}"
        axes = "--columns" if "x" in self.content.columns else header
        axes += ", z = 0" if len(group.columns) == 2 else ""
        readings = self.read_readings(group, rows)
        name = "-".join(filter(None, (own, beside)))
        return ImportedCurve(name, points, group.unit, None, stated, axes, readings)

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
            for m in found.group.find(meaning):
                header = found.group.headers[m]
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
                stated[meaning] = Stated(cells[0][0], header.unit, self.cells.where(cells[0][1], m))
        return stated

    def read_readings(self, group: _Group, rows: Sequence[int]) -> Readings | None:
        """Return what makes a curve the track of a tip: depth, time or direction in each row."""
        is_deflection = any(group.headers[m].meaning == "deflection" for m in group.columns)
        is_log = bool(group.find("time", "quaternion"))
        columns = group.columns[:1] if is_deflection else group.find("depth")
        if len({self.cells.cell(n, m) for n in rows for m in columns}) < 2:
            return Readings(np.empty(0), "", None, is_log, False) if is_log else None
        guides, guide = group.find("guide"), None
        if guides:  # x, y and z of one that rests, or its place along one axis
            places = self.read_numbers(rows, guides)
            guide = places[:, 0] - places[0, 0]
            if np.ptp(places, axis=0).any() and group.headers[guides[0]].axis:
                what, fix = f"{group.headers[guides[0]].text} changes", "name it: --columns guide=HEADER"
                expected = "one column with the lateral position of the guide"
                raise DataError(what, where=self.cells.where(rows[0], guides[0]), expected=expected, fix=fix)
        depth, unit = self.read_numbers(rows, columns)[:, 0], group.headers[columns[0]].unit
        return Readings(depth, unit or group.unit, guide, is_log, is_deflection)

    # ---- needles, and what is left

    def read_needles(self) -> None:
        """Add what a table without coordinates states of needles, one a row.

        UnclearColumnsError if it does not name needles. DataError if one is listed twice.
        """
        for n, row in enumerate(self.cells.rows):
            group = _Group(n, self.apply_columns([read_header(text) for text in row]), range(len(row)))
            if keys := group.find("needle") if group.find(*ATTRIBUTES) else []:
                break
        else:
            names = ", ".join(dict.fromkeys(text for row in self.cells.rows[:6] for text in row if text))
            what = f"no header names coordinates: {names[:MAX_LISTED_CHARS]}"
            expected = "columns called x, y, z, or depth and deflection"
            raise UnclearColumnsError(what, where=self.cells.where(0), expected=expected, fix=COLUMNS_FIX)
        self.require_single(group)
        listed, units = set[str](), self.find_units(n + 1)
        self.heads[n] = [group]
        self.use(n, *range(self.width))
        self.use(n + 1, *units)
        for m in range(n + 1 + bool(units), len(self.cells.rows)):
            name, where = self.cells.cell(m, keys[0]), self.cells.where(m, keys[0])
            if name in listed:
                what, fix = f"needle {name!r} is listed twice", "remove the row, or correct its name"
                raise DataError(what, where=where, expected="one row for each needle", fix=fix)
            if name:
                listed.add(name)
                self.use(m, keys[0])
                stated = self.read_attributes(_Found(group, (name,), rows=[m]))
                self.content.needles.append((name, stated))

    def list_unused(self) -> Iterator[tuple[str, str]]:
        """Yield what is not used: columns by their headers, and other cells by their rows."""
        cells, starts = self.cells, sorted(self.heads)
        for n, end in zip(starts, [*starts[1:], len(cells.rows)], strict=True):
            for m, header in enumerate(self.heads[n][0].headers):
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
