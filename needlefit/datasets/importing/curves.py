"""Find the curves of needles in tables, and what tables state of them, by the headers of their columns."""

import re
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import count, product
from pathlib import Path

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.columns import TURN_COLUMNS
from needlefit.datasets.importing.answers import Stated, add_stated
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
# What rows above a table may state of the whole import.
SHARED_ANSWERS = ("boundaries", "needle length", "diameter", "inner diameter", "modulus")
SENSOR = ("sensor", "curvature y", "curvature z", "curvature sd")  # what a row of curvatures states
_KEYS = ("specimen", "needle")  # columns that tell curves apart
_VECTORS = ("entry", "target", "guide", "quaternion")  # columns x, y, z that are no points of a needle
MAX_LABEL_ROWS = 4  # rows above a header in which the names of its columns are looked for
MAX_TITLE_WORDS = 3  # of a title that names a needle
MAX_LISTED_CHARS = 200  # of an unused row
COLUMNS_FIX = "name them with --columns X,Y,Z or --columns needle=NAME,x=NAME,..., by header or number"


@dataclass(frozen=True)
class Readings:
    """What the rows of a tip's track state beside its places."""

    depth: Floats  # (N,), in the unit of its column; empty: no column of depths changes from row to row
    unit: str  # of the depths, as the file states it
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
    stated: dict[str, Stated] = field(default_factory=dict)  # of `ATTRIBUTES`, once for the curve
    axes: str = "x, y, z"  # its coordinates
    readings: Readings | None = None
    shaft: Floats = field(default_factory=lambda: np.empty((0, 3)))  # (K, 3); points up to the entry
    turns: list[tuple[float, Stated]] = field(default_factory=list)  # depths, mm, and where bevels face then
    sensors: list[Floats] = field(default_factory=list)  # (4,) each: `SENSOR` in mm and 1/mm

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
    # Names of needles, and what a row states of one: of all of it, of a turn, or of a sensor.
    needles: list[tuple[str, dict[str, Stated], list[tuple[float, Stated]], list[Floats]]] = field(
        default_factory=list
    )
    setup: dict[str, Stated] = field(default_factory=dict)  # answers by the names of questions
    unused: list[tuple[str, str]] = field(default_factory=list)  # what is not used; where it stands, or why
    unclear: list[UnclearColumnsError] = field(default_factory=list)  # of tables that were left out


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

    def find(self, *meanings: str) -> list[int]:
        """Return the columns with one of some meanings that state something of the curve."""
        named = ((m, one.meaning or one.group) for m, one in enumerate(self.headers))
        return [m for m, one in named if one in meanings and m in self.span and m not in self.columns]


@dataclass
class _Found:
    """A curve that is read: its columns, names in columns, what stands above it, and its rows."""

    group: _Group
    names: tuple[str, ...]
    above: Mapping[str, Stated] = field(default_factory=dict)
    rows: list[int] = field(default_factory=list)


def read_table(cells: CellTable, content: ImportContent) -> None:
    """Add the curves in a table, or what it states of needles; curves without a name have that of the table.

    A table of which nothing states which columns are coordinates is left out. DataError if a cell of a known
    column is not understood.
    """
    reader = _TableReader(cells, content)
    try:
        if not reader.heads:
            reader.read_needles()
    except UnclearColumnsError as error:
        content.unused.append(
            (f"sheet {cells.sheet}" if cells.sheet else f"file {cells.path.name}", error.what)
        )
        content.unclear.append(error)
        return
    curves = [reader.read_curve(one, name) for one, name in reader.find_curves()]
    stem, unnamed = cells.sheet or cells.path.name.split(".")[0] or cells.path.stem, count(1)
    for one in curves:
        one.name = one.name or (f"{stem}-{next(unnamed)}" if len(curves) > 1 else stem)
    content.curves += curves
    content.unused += reader.list_unused()


class _TableReader:
    """Reads one table, and marks the cells that it uses."""

    def __init__(self, cells: CellTable, content: ImportContent) -> None:
        self.cells, self.content = cells, content
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
        width = max(map(len, self.cells.rows), default=0)
        own = [read_header(self.cells.cell(n, m).lstrip("#% ") if n >= 0 else "") for m in range(width)]
        rows = range(n - 1, max(n - 1 - MAX_LABEL_ROWS, -1), -1)
        above = next((m for m in rows if not self.find_pairs(m, self.cells.filled(m))), n)
        filled = self.cells.filled(above) if 0 <= above < n else []
        letters = [own[m].axis for m in filled]
        is_numbers = filled and self.cells.count_numbers(above) > 1  # names of needles, if above each x
        if len(filled) < 2 or {"y", "z"} & {*letters} or (is_numbers and {*letters} != {"x"}):
            filled = []
        units, headers, label = self.find_units(n + 1), list[Header](), ""
        for m, one in enumerate(own):
            label = self.cells.rows[above][m].lstrip("#% ") if m in filled else label if one.axis else ""
            one = one if one.meaning or not label else read_header(f"{label} {one.text}".strip())
            headers.append(replace(one, unit=one.unit or units.get(m, "")))
        headers = self.apply_columns(headers)
        # a letter that comes again begins another curve
        found: dict[tuple[int, str], dict[str, int]] = {}
        for m, one in enumerate(headers):
            if one.axis and one.group not in _VECTORS:
                turn = next(k for k in count() if one.axis not in found.get((k, one.group), ()))
                found.setdefault((turn, one.group), {})[one.axis] = m
        tips = [m for what in ("depth", "deflection") for m, one in enumerate(headers) if one.meaning == what]
        if not found and len(tips) == 2:
            found[0, ""] = dict(zip("xy", tips, strict=True))
        alone = [headers[m].text for axes in found.values() if len(axes) == 1 for m in axes.values()]
        found = {key: axes for key, axes in found.items() if len(axes) > 1}
        named = [headers[m].text for axes in found.values() for m in axes.values()]
        if twice := [text for text in alone if text in named]:
            what = f"two columns are called {twice[0]!r}, and only one of them has a partner"
            raise DataError(what, where=self.cells.where(max(n, 0)), expected="each once", fix=COLUMNS_FIX)
        starts = sorted(min(axes.values()) for axes in found.values())
        for (_, name), axes in found.items():
            columns = tuple(axes[one] for one in "xyz" if one in axes)
            if len({headers[m].unit for m in columns}) > 1:
                what = f"the coordinates are {', '.join(headers[m].text for m in columns)}"
                where = self.cells.where(max(n, 0), columns[0])
                raise DataError(what, where=where, expected="one unit", fix=COLUMNS_FIX)
            end = next((m for m in starts if m > min(columns)), width)
            span = {*range(starts[0]), *range(min(columns), end)}  # what stands before the first is of all
            name = name if len(found) > 1 else own[min(columns)].group
            self.heads.setdefault(n, []).append(group := _Group(n, headers, span, columns, name))
            if len(texts := [headers[m].text for m in group.find("needle")]) > 1:
                what, fix = f"{' and '.join(texts)} may name needles", "state --columns needle=HEADER"
                raise DataError(what, where=self.cells.where(max(n, 0)), expected="one column", fix=fix)
        if found:
            self.use(n, *range(width))
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
            m = texts.index(name) if name in texts else int(name) - 1 if name.isdecimal() else -1
            if 0 <= m < len(texts):
                places[m] = meaning
        self.content.columns_found |= {*places.values()}
        taken = {*places.values(), *("xyz" if "x" in places.values() else "")}
        found = []
        for m, one in enumerate(headers):
            own, unit = places.get(m, ""), one.unit or split_unit(one.text)[1]
            if own:
                one = Header(one.text, *(("", own) if own in "xyz" else (own, "")), unit=unit)
            found.append(Header(one.text) if not own and (one.meaning or one.axis) in taken else one)
        return found

    def find_pairs(self, n: int, filled: Sequence[int]) -> list[tuple[list[int], Header, str]]:
        """Return the pairs of a known name and a value among some cells of a row, if it is none of headers.

        `bevel | 1 | depth | 40`, `bevel: 1` in one cell, or a title such as `Needle 3`.
        """
        texts = {m: self.cells.rows[n][m].strip("#% ") for m in filled}
        title = texts[filled[0]] if len(filled) == 1 else ""
        if 1 < len(title.split()) <= MAX_TITLE_WORDS and find_meaning("column", title.split()[0]) == "needle":
            return [(list(filled), Header(title, "needle"), title)]
        head, *others = texts.values() or ("",)
        what = read_header(head.rstrip(":=： "))
        if what.meaning in SHARED_ANSWERS and others and all(re.search(r"\d", text) for text in others):
            return [(list(filled), what, "; ".join(others))]  # `boundaries [cm] | 2 | 4`
        split = {m: re.split(r"\s*[:=：]\s*", text, maxsplit=1) for m, text in texts.items()}
        couples = zip(filled[::2], filled[1::2], strict=False)
        pairs = [([a, b], texts[a].rstrip(":=： "), texts[b]) for a, b in couples]
        if all(len(parts) == 2 for parts in split.values()):
            pairs = [([m], parts[0], parts[1]) for m, parts in split.items()]
        values = [read_header(split_unit(value)[0]) for *_, value in pairs]
        if any(one.meaning or one.axis or find_meaning("filler", one.text) for one in values):
            return []
        found = [(places, read_header(name), value) for places, name, value in pairs]
        return [one for one in found if one[1].meaning in ("needle", *ATTRIBUTES, *SHARED_ANSWERS)]

    # ---- curves

    def find_curves(self) -> list[tuple[_Found, str]]:
        """Return the curves, each with its name in a column: one for each name, or each block of rows."""
        found: dict[tuple[object, ...], _Found] = {}
        names: dict[tuple[int, int], str] = {}  # they stand in each row, or in the first one
        groups, above, labels, block = self.heads.get(-1, []), list[int](), list[dict[str, Stated]](), 0
        for n, row in enumerate(self.cells.rows):
            if n in self.heads or not self.is_point(groups, n, bool(labels)):
                above = [*([] if labels else above), *([n] if any(row) and n not in self.heads else [])]
                groups, labels = self.heads.get(n, groups), []
                continue
            if not labels:
                labels, block = [self.read_labels(one, above) for one in groups], block + 1
            self.require_width(groups[0].row, n)
            for group, label in zip(groups, labels, strict=True):
                keys = [m for what in _KEYS for m in group.find(what)]
                names |= {(group.row, m): text for m in keys if (text := self.cells.cell(n, m))}
                own = tuple(names.get((group.row, m), "") for m in keys)
                key = (group.name, group.columns, own, bool(group.find("needle")) or block)
                found.setdefault(key, _Found(group, own, label)).rows.append(n)
        ones = [one for one in found.values() if self.list_filled(one)]
        is_unique = len({(one.group.name, *one.names[-1:]) for one in ones}) == len(ones)
        return [(one, "-".join(filter(None, one.names[-1:] if is_unique else one.names))) for one in ones]

    def is_point(self, groups: Sequence[_Group], n: int, is_open: bool) -> bool:
        """Whether a row has coordinates, in part where `is_open` (the row above has), or only names."""
        texts = [[self.cells.cell(n, m) for m in one.columns] for one in groups]
        numbers = max((sum(self.cells.number(text) is not None for text in one) for one in texts), default=0)
        filled = self.cells.filled(n)
        if numbers > 1 or not groups or self.find_pairs(n, filled):
            return numbers > 1
        if (is_open and numbers) or any(text.lower() in MISSING for one in texts for text in one):
            return True
        return not any(map(any, texts)) and any(groups[0].headers[m].meaning for m in filled)

    def require_width(self, head: int, n: int) -> None:
        """DataError where the cells of a row of text do not stand under those of its header."""
        row, width = self.cells.rows[n], len(self.cells.rows[head])
        is_longer = self.cells.separator == "," and any(row[width:])
        if head >= 0 and (is_longer or (self.cells.separator == " " and len(row) != width)):
            what, fix = f"has {len(row)} cells under {width} columns", "save it with semicolons or tabs"
            raise DataError(what, where=self.cells.where(n), expected="as many as the header", fix=fix)

    def list_filled(self, one: _Found) -> list[int]:
        """Return the rows of a curve in which not all coordinates are missing."""
        texts = {n: [self.cells.cell(n, m) for m in one.group.columns] for n in one.rows}
        return [n for n, row in texts.items() if any(text and text.lower() not in MISSING for text in row)]

    def read_labels(self, group: _Group, rows: Sequence[int]) -> dict[str, Stated]:
        """Return what pairs of cells above a block state of a curve in it, and titles name."""
        stated: dict[str, Stated] = {}
        for n in rows:
            filled = self.cells.filled(n)
            is_shared = any(one.meaning in SHARED_ANSWERS for _, one, _ in self.find_pairs(n, filled))
            own = filled if is_shared else [m for m in filled if m in group.span]
            for places, header, text in self.find_pairs(n, own):
                one = Stated(text, header.unit, self.cells.where(n, places[-1]))
                if header.meaning in SHARED_ANSWERS:
                    add_stated(self.content.setup, {header.meaning: one})
                else:
                    stated[header.meaning] = one
                self.use(n, *places)
        return stated

    def read_curve(self, found: _Found, own: str) -> ImportedCurve:
        """Return one curve, with what the table states once for it. `own`: its name in a column."""
        group, rows = found.group, self.list_filled(found)
        for n in {*rows, *found.rows[:1]}:
            self.use(n, *group.find(*_KEYS))
        unit, values = group.headers[group.columns[0]].unit, np.zeros((len(rows), 3))
        values[:, : len(group.columns)] = self.read_numbers(rows, group.columns)
        points = Points(self.cells.path, values, np.array(rows, dtype=np.int64) + 1)
        stated = {**found.above, **self.read_attributes(found)}
        title = stated.pop("needle", Stated("")).text
        name = "-".join(filter(None, (own, group.name or ("" if own else title))))
        axes = "x, y, z" if len(group.columns) == 3 else "x, y; z is 0"
        return ImportedCurve(name, points, unit, None, stated, axes, self.read_readings(group, rows))

    def read_numbers(self, rows: Sequence[int], columns: Sequence[int]) -> Floats:
        """Return the numbers in some columns (N, M); DataError at the first cell that is none."""
        values = np.zeros((len(rows), len(columns)))
        for (k, n), (i, m) in product(enumerate(rows), enumerate(columns)):
            if (number := self.cells.number(text := self.cells.cell(n, m))) is None:
                what = f"a number is {text[:40]!r}"
                fix = "correct the cell; to leave the point out, empty all coordinates of its row"
                expected = f"numbers with a decimal {'comma' if self.cells.decimal == ',' else 'point'}"
                raise DataError(what, where=self.cells.where(n, m), expected=expected, fix=fix)
            values[k, i] = number
            self.use(n, m)
        return values

    def read_attributes(self, found: _Found) -> dict[str, Stated]:
        """Return what columns state once for a curve; DataError if two cells of one contradict each other."""
        stated: dict[str, Stated] = {}
        for meaning, m in ((one, m) for one in ATTRIBUTES for m in found.group.find(one)):
            cells = {n: text for n in found.rows if (text := self.cells.cell(n, m))}
            first = next(iter(cells), 0)
            other = next((n for n, text in cells.items() if text != cells[first]), None)
            if not cells or (other is not None and meaning == "depth"):
                continue  # that of each reading
            where = self.cells.where(first if other is None else other, m)
            if other is not None:
                what, expected = f"{meaning} is {cells[first][:40]!r} and {cells[other][:40]!r}", "one value"
                fix = f"correct the cell; if other columns distinguish the needles, {COLUMNS_FIX}"
                raise DataError(what, where=where, expected=expected, fix=fix)
            for n in cells:
                self.use(n, m)
            add_stated(stated, {meaning: Stated(cells[first], found.group.headers[m].unit, where)})
        return stated

    def read_readings(self, group: _Group, rows: Sequence[int]) -> Readings | None:
        """Return what makes a curve the track of a tip: depth, time or direction in each row."""
        is_deflection = any(group.headers[m].meaning == "deflection" for m in group.columns)
        is_log = bool(group.find("time", "quaternion"))
        columns = group.columns[:1] if is_deflection else group.find("depth")
        if len({self.cells.cell(n, m) for n in rows for m in columns}) < 2:
            return Readings(np.empty(0), "", is_log, False) if is_log else None
        unit = group.headers[columns[0]].unit or group.headers[group.columns[0]].unit
        return Readings(self.read_numbers(rows, columns)[:, 0], unit, is_log, is_deflection)

    # ---- needles, and what is left

    def read_needles(self) -> None:
        """Add what a table without coordinates states of needles, their turns or curvatures.

        UnclearColumnsError if it names none.
        """
        for n, row in enumerate(self.cells.rows):
            group = _Group(n, self.apply_columns([read_header(text) for text in row]), range(len(row)))
            if keys := group.find("needle") if group.find(*ATTRIBUTES, *SENSOR[1:3]) else []:
                break
        else:
            texts = dict.fromkeys(text for row in self.cells.rows[:6] for text in row)
            names = ", ".join(text for text in texts if text and self.cells.number(text) is None)
            what = f"no header names coordinates: {names[:MAX_LISTED_CHARS]}"
            expected = "columns called x, y, z, or depth and deflection"
            raise UnclearColumnsError(what, where=self.cells.where(0), expected=expected, fix=COLUMNS_FIX)
        self.heads[n] = [group]
        units = self.find_units(n + 1)
        self.use(n, *range(len(row)))
        self.use(n + 1, *units)
        depth = group.find("turn depth") or (group.find("depth") if {*TURN_COLUMNS[1:]} <= {*row} else [])
        sensor = [m for one in SENSOR for m in group.find(one)[:1]] if group.find(*SENSOR[1:3]) else []
        if 0 < len(sensor) < len(SENSOR):
            lacking = ", ".join(one for one in SENSOR if not group.find(one))
            what, expected = f"a table of curvatures lacks a column: {lacking}", ", ".join(SENSOR)
            raise DataError(what, where=self.cells.where(n), expected=expected, fix=COLUMNS_FIX)
        for m in range(n + 1 + bool(units), len(self.cells.rows)):
            if name := self.cells.cell(m, keys[0]):
                self.use(m, keys[0])
                stated = self.read_attributes(_Found(group, (name,), rows=[m]))
                sensors = [self.read_lengths(group, m, sensor)] if sensor else []
                turns = [float(one) for one in self.read_lengths(group, m, depth)]
                rolls = [stated.pop("bevel side", Stated("", "", self.cells.where(m))) for _ in turns]
                stated = {} if turns else stated  # its depth is that of the turn
                self.content.needles.append((name, stated, [*zip(turns, rolls, strict=True)], sensors))

    def read_lengths(self, group: _Group, n: int, columns: Sequence[int]) -> Floats:
        """Return cells of a row in mm, curvatures in 1/mm; DataError if one or its unit is unknown."""
        values = self.read_numbers([n], columns)[0]
        for k, m in enumerate(columns):
            header = group.headers[m]
            if (unit := header.unit.removeprefix("1/").strip() or "mm") not in UNITS_MM:
                what, where = f"the unit of {header.text} is {header.unit!r}", self.cells.where(group.row, m)
                raise DataError(what, where=where, expected=", ".join(UNITS_MM), fix="correct the header")
            values[k] *= UNITS_MM[unit] ** (-1 if header.meaning in SENSOR[1:] else 1)
        return values

    def list_unused(self) -> Iterator[tuple[str, str]]:
        """Yield what is not used: columns by their headers, and other cells by their rows."""
        cells, starts = self.cells, sorted(self.heads)
        for n, end in zip(starts, [*starts[1:], len(cells.rows)], strict=True):
            for m, header in enumerate(self.heads[n][0].headers):
                body = {(k, m) for k in range(n + 1, end) if cells.cell(k, m)}
                if body and not body & cells.used and (header.text or n < 0):
                    cells.used.update(body)
                    yield f"column {header.text or m + 1}", Path(cells.where(max(n, 0))).name
        for n, row in enumerate(cells.rows):
            if texts := [text for m, text in enumerate(row) if text and (n, m) not in cells.used]:
                yield f"row {', '.join(texts)}"[:MAX_LISTED_CHARS], Path(cells.where(n)).name
