"""Find the curves of needles in tables, and what tables state of them, by the headers of their columns."""

import re
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import count, pairwise, product
from pathlib import Path

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.columns import TURN_COLUMNS
from needlefit.datasets.importing.answers import Stated, add_stated
from needlefit.datasets.importing.curves import ATTRIBUTES, ImportContent, ImportedCurve, NeedleRow, Readings
from needlefit.datasets.importing.questions import QUESTIONS
from needlefit.datasets.importing.synonyms import (
    INDEX,
    UNITS_MM,
    Header,
    find_meaning,
    load_axes,
    read_header,
    split_unit,
)
from needlefit.datasets.importing.tables import MISSING, CellTable, UnclearColumnsError, UnclearLayoutError
from needlefit.datasets.points import MIN_POINTS, Points
from needlefit.errors import DataError
from needlefit.geometry.frames import PatientSystem

# What holds from its row above the points on, of all needles, until another row restates it.
SHARED_ANSWERS = tuple(one for one in ATTRIBUTES if one not in ("depth", "bevel side", "medium", "specimen"))
SENSOR = ("sensor", "curvature y", "curvature z", "curvature sd")  # what a row of curvatures states
_KEYS = ("specimen", "needle")  # columns that tell curves apart
_VECTORS = ("entry point", "pose")  # columns x, y, z that state something of each needle
_NO_POINTS = (*_VECTORS, "target", "guide", "quaternion")  # columns x, y, z that are no points of a needle
_LABEL = re.compile(r"(.*?)[\s_.:-]*(\d+)")  # of a point: the stem, and its number
MAX_LABEL_ROWS = 6  # rows above a header in which the names of its columns are looked for
MAX_TITLE_WORDS = 3  # of a title that names a needle
MAX_LISTED_CHARS = 200  # of an unused row
COLUMNS_FIX = "name them with --columns X,Y,Z or --columns needle=NAME,x=NAME,..., by header or number"


@dataclass(frozen=True)
class _Group:
    """The columns of one curve below a row of headers."""

    row: int  # of the headers; -1: there are none
    headers: Sequence[Header]
    span: Container[int]  # columns that may state something of the curve
    columns: tuple[int, ...] = ()  # of x, y and z; z may be missing
    name: str = ""
    system: PatientSystem | None = None  # which the names of the axes state

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

    A table of which nothing states which columns are coordinates is left out. UnclearLayoutError if a needle
    may stand in a row or in columns. DataError if a cell of a known column is not understood.
    """
    reader = _TableReader(cells, content)
    curves = list(reader.read_curves())
    try:
        if not reader.heads and not reader.read_shared():
            reader.read_needles()
    except UnclearColumnsError as error:
        content.unused.append(
            (f"sheet {cells.sheet}" if cells.sheet else f"file {cells.path.name}", error.what)
        )
        content.unclear.append(error)
        return
    stem, unnamed = cells.sheet or cells.path.name.split(".")[0] or cells.path.stem, count(1)
    for one in curves:
        one.name = one.name or (f"{stem}-{next(unnamed)}" if len(curves) > 1 else stem)
    content.curves += curves
    reader.add_unused()


def _name_axes(headers: Sequence[Header]) -> tuple[list[Header], str]:
    """Return headers some of which are axes only together, as `r, a, s`, and the system that they state."""
    words = ["".join(split_unit(one.text)[0].casefold().split()) for one in headers]
    for system, usual, names in load_axes():
        if {*names} <= {*words}:
            axes = dict(zip(names, "xyz", strict=False))
            named = [
                Header(one.text, "", axes[word], "", one.unit or usual) if word in axes else one
                for one, word in zip(headers, words, strict=True)
            ]
            return named, system
    return list(headers), ""


class _TableReader:
    """Reads one table, and marks the cells that it uses."""

    def __init__(self, cells: CellTable, content: ImportContent) -> None:
        self.cells, self.content = cells, content
        self.heads: dict[int, list[_Group]] = {}  # the curves below each row of headers
        for n in range(len(cells.rows)):
            is_units = all(find_meaning("unit", text.strip("[]() ")) for text in cells.rows[n] if text)
            if len(cells.filled(n)) > 1 and not cells.count_numbers(n) and not is_units:
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
        own, stated = _name_axes(own)
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
        found = self.group_axes(headers, n)
        starts = sorted(min(axes.values()) for axes in found.values())
        system: PatientSystem | None = "RAS" if stated == "RAS" else "LPS" if stated == "LPS" else None
        for (_, name), axes in found.items():
            columns = tuple(axes[one] for one in "xyz" if one in axes)
            if len({headers[m].unit for m in columns}) > 1:
                what = f"the coordinates are {', '.join(headers[m].text for m in columns)}"
                where = self.cells.where(max(n, 0), columns[0])
                raise DataError(what, where=where, expected="one unit", fix=COLUMNS_FIX)
            end = next((m for m in starts if m > min(columns)), width)
            span = {*range(starts[0]), *range(min(columns), end)}  # what stands before the first is of all
            name = name if len(found) > 1 else own[min(columns)].group
            self.heads.setdefault(n, []).append(group := _Group(n, headers, span, columns, name, system))
            if len(texts := [headers[m].text for m in group.find("needle")]) > 1:
                what, fix = f"{' and '.join(texts)} may name needles", "state --columns needle=HEADER"
                raise DataError(what, where=self.cells.where(max(n, 0)), expected="one column", fix=fix)
        if found:
            self.use(n, *range(width))
            self.use(n + 1, *units)
            self.use(above, *(m for m in filled if headers[m].text != own[m].text))

    def group_axes(self, headers: Sequence[Header], n: int) -> dict[tuple[int, str], dict[str, int]]:
        """Return the columns of each curve by axis; a letter that comes again begins another curve.

        One column x may be of several curves: `x, y1, y2`. Without axes, depth and deflection are x and y.
        """
        found: dict[tuple[int, str], dict[str, int]] = {}
        for m, one in enumerate(headers):
            if one.axis and one.group not in _NO_POINTS:
                turn = next(k for k in count() if one.axis not in found.get((k, one.group), ()))
                found.setdefault((turn, one.group), {})[one.axis] = m
        with_x = [key for key, axes in found.items() if "x" in axes]
        lacking = [axes for axes in found.values() if "x" not in axes]
        if len(with_x) == 1 and lacking and all("y" in axes for axes in lacking):
            for axes in lacking:
                axes["x"] = found[with_x[0]]["x"]
            if len(found[with_x[0]]) == 1:
                del found[with_x[0]]
        tips = [m for what in ("depth", "deflection") for m, one in enumerate(headers) if one.meaning == what]
        if not found and len(tips) == 2:
            found[0, ""] = dict(zip("xy", tips, strict=True))
        alone = [headers[m].text for axes in found.values() if len(axes) == 1 for m in axes.values()]
        found = {key: axes for key, axes in found.items() if len(axes) > 1}
        named = [headers[m].text for axes in found.values() for m in axes.values()]
        if twice := [text for text in alone if text in named]:
            what = f"two columns are called {twice[0]!r}, and only one of them has a partner"
            raise DataError(what, where=self.cells.where(max(n, 0)), expected="each once", fix=COLUMNS_FIX)
        return found

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
        for name, meaning in self.content.columns.items():
            m = texts.index(name) if name in texts else int(name) - 1 if name.isdecimal() else -1
            if 0 <= m < len(texts):
                places[m] = meaning
                self.content.columns_found.add(name)
        taken = {*places.values(), *("xyz" if "x" in places.values() else "")} - {"unrelated"}
        found = []
        for m, one in enumerate(headers):
            own, unit = places.get(m, ""), one.unit or split_unit(one.text)[1]
            if own:
                one = Header(one.text, *(("", own) if own in "xyz" else (own, "")), unit=unit)
            found.append(Header(one.text) if not own and (one.meaning or one.axis) in taken else one)
        return found

    def find_pairs(self, n: int, filled: Sequence[int]) -> list[tuple[list[int], Header, str]]:
        """Return the pairs of a known name and a value among some cells of a row, if it is none of headers.

        `bevel | 1 | depth | 40`, `bevel: 1` in one cell, `diameter | 0.7 | mm`, `boundaries | 20 | 40`, or a
        title such as `Needle 3`.
        """
        texts = {m: self.cells.rows[n][m].strip("#% ") for m in filled}
        title = texts[filled[0]] if len(filled) == 1 and not re.search("[:=：]", texts[filled[0]]) else ""
        if 1 < len(title.split()) <= MAX_TITLE_WORDS and find_meaning("column", title.split()[0]) == "needle":
            return [(list(filled), Header(title, "needle"), title)]
        head, *others = texts.values() or ("",)
        what = read_header(head.rstrip(":=： "))
        if what.meaning == "boundaries" and others and all(re.search(r"\d", text) for text in others):
            return [(list(filled), what, "; ".join(others))]
        if what.meaning in _VECTORS and len(others) == 3:
            return [(list(filled), what, ",".join(others))]
        if len(others) == 2 and what.meaning in ATTRIBUTES and (unit := find_meaning("unit", others[1])):
            return [(list(filled), replace(what, unit=unit), others[0])]
        split = {m: re.split(r"\s*[:=：]\s*", text, maxsplit=1) for m, text in texts.items()}
        couples = zip(filled[::2], filled[1::2], strict=False)
        pairs = [([a, b], texts[a].rstrip(":=： "), texts[b]) for a, b in couples]
        if all(len(parts) == 2 for parts in split.values()):
            pairs = [([m], parts[0], parts[1]) for m, parts in split.items()]
        values = [read_header(split_unit(value)[0]) for *_, value in pairs]
        if any(one.meaning or one.axis or find_meaning("filler", one.text) for one in values):
            return []
        found = [(places, read_header(name), value) for places, name, value in pairs]
        return [one for one in found if one[1].meaning in ("needle", *ATTRIBUTES)]

    # ---- curves

    def read_curves(self) -> Iterator[ImportedCurve]:
        """Yield the curves of the table.

        UnclearLayoutError if each row may be a needle, or hold a point of each.
        """
        arrays = [n for n in self.heads if self.is_array(n)]
        if arrays and not self.content.layout:
            names = [one.name.strip(" /") for one in self.heads[arrays[0]]]
            what = (
                f"each row holds {len(names)} places: {names[0] or 'x, y, z'}, {names[1] or 'x, y, z'}, ..."
            )
            raise UnclearLayoutError(
                what,
                where=self.cells.where(max(arrays[0], 0)),
                expected=QUESTIONS["layout"].text,
                fix="state --setup layout=rows or --setup layout=columns",
            )
        if arrays and self.content.layout == "rows":
            for n in self.heads:
                yield from self.read_rows(n)
        else:
            for found, name in self.find_curves():
                yield self.read_curve(found, name)

    def is_array(self, n: int) -> bool:
        """Whether the places below a row of headers are numbered, and each row may be a needle.

        They stand beside times or names of needles, or their headers have indices in brackets.
        """
        groups = self.heads[n]
        if len(groups) < MIN_POINTS:
            return False
        stems = {re.sub(r"\d+", "#", one.name) for one in groups}
        beside = groups[0].find("time", "needle")
        is_indexed = INDEX.search(groups[0].headers[groups[0].columns[0]].text)
        return len(stems) == 1 and bool(beside or is_indexed)

    def read_rows(self, head: int) -> Iterator[ImportedCurve]:
        """Yield the curves below a row of headers, each row of which holds all points of one needle."""
        groups = self.heads[head]
        end = min((n for n in self.heads if n > head), default=len(self.cells.rows))
        whole = replace(groups[0], span=range(len(groups[0].headers)), columns=())
        for n in range(head + 1, end):
            filled = [one for one in groups if any(self.cells.cell(n, m) for m in one.columns)]
            if not self.is_point(filled, n, is_open=False) or not filled:
                continue
            values = np.zeros((len(filled), 3))
            for k, one in enumerate(filled):
                values[k, : len(one.columns)] = self.read_numbers([n], one.columns)[0]
            keys = whole.find("needle")
            self.use(n, *keys)
            name, points = "", Points(self.cells.path, values, np.full(len(filled), n + 1))
            if keys:
                name = self.cells.cell(n, keys[0])
            stated = self.read_attributes(_Found(whole, (), rows=[n]))
            yield self.make_curve(name, points, groups[0], stated)

    def find_curves(self) -> list[tuple[_Found, str]]:
        """Return the curves, each with its name in a column: one for each name, or each block of rows."""
        found: dict[tuple[object, ...], _Found] = {}
        names: dict[tuple[int, int], str] = {}  # they stand in each row, or in the first one
        shared: dict[int, dict[str, Stated]] = {}  # what rows above an earlier block state, by group
        stems = {n: self.split_labels(n) for n in self.heads}
        groups, above, labels, block = self.heads.get(-1, []), list[int](), list[dict[str, Stated]](), 0
        for n, row in enumerate(self.cells.rows):
            if n in self.heads or not self.is_point(groups, n, bool(labels)):
                above = [*([] if labels else above), *([n] if any(row) and n not in self.heads else [])]
                groups, labels = self.heads.get(n, groups), []
                continue
            if not labels:
                labels, block = [self.read_labels(one, above) for one in groups], block + 1
                for k, own in enumerate(labels):
                    kept = {what: one for what, one in own.items() if what in SHARED_ANSWERS}
                    shared[k] = shared.get(k, {}) | kept
            self.require_width(groups[0].row, n)
            for k, group in enumerate(groups):
                keys = [m for what in _KEYS for m in group.find(what)]
                for m in keys:
                    if text := self.cells.cell(n, m):
                        names[group.row, m] = stems[group.row].get(m, {}).get(n, text)
                own_names = tuple(names.get((group.row, m), "") for m in keys)
                key = (group.name, group.columns, own_names, bool(group.find("needle")) or block)
                stated = shared[k] | labels[k]
                found.setdefault(key, _Found(group, own_names, stated)).rows.append(n)
        ones = [one for one in found.values() if self.list_filled(one)]
        is_unique = len({(one.group.name, *one.names[-1:]) for one in ones}) == len(ones)
        return [(one, "-".join(filter(None, one.names[-1:] if is_unique else one.names))) for one in ones]

    def split_labels(self, head: int) -> dict[int, dict[int, str]]:
        """Return the stem of each label, by column and row, where each point has its own: `N1-1`, `N2-1`.

        DataError if such labels do not state which needle a point is of.
        """
        groups, found = self.heads[head], dict[int, dict[int, str]]()
        for m in {m for one in groups for m in one.find("needle")}:
            texts = {
                n: self.cells.cell(n, m)
                for n in range(head + 1, len(self.cells.rows))
                if self.cells.cell(n, m) and self.is_point(groups, n, is_open=False)
            }
            is_tips = any(groups[0].headers[k].meaning == "deflection" for k in groups[0].columns)
            if len(texts) <= MIN_POINTS or len({*texts.values()}) < len(texts) or is_tips:
                continue
            parts = {n: _LABEL.fullmatch(text) for n, text in texts.items()}
            stems = {n: part[1] if part else texts[n] for n, part in parts.items()}
            counts = [*stems.values()]
            if len({*counts}) < 2 or min(map(counts.count, counts)) < MIN_POINTS:
                shown = ", ".join(list(texts.values())[:3])
                column = groups[0].headers[m].text or m + 1
                raise DataError(
                    f"every row has a name of its own: {shown}, ...",
                    where=self.cells.where(max(head, 0), m),
                    expected="in each row the name of its needle",
                    fix=f'if they are points of one needle: --columns "point number={column}"',
                )
            found[m] = stems
        return found

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
        """Return the rows of a curve in which not all coordinates are missing.

        A column x that several curves share is filled beyond the end of the shorter ones.
        """
        others = self.heads[one.group.row]
        shared = {m for m in one.group.columns for other in others if other.columns != one.group.columns
                  and m in other.columns}  # fmt: skip
        own = [m for m in one.group.columns if m not in shared]
        texts = {n: [self.cells.cell(n, m) for m in own] for n in one.rows}
        return [n for n, row in texts.items() if any(text and text.lower() not in MISSING for text in row)]

    def read_labels(self, group: _Group, rows: Sequence[int]) -> dict[str, Stated]:
        """Return what pairs of cells above a block state of a curve in it, and titles name."""
        stated: dict[str, Stated] = {}
        for n in rows:
            filled = self.cells.filled(n)
            meanings = [one.meaning for _, one, _ in self.find_pairs(n, filled)]
            is_of_all = bool(meanings) and {*meanings} <= {*SHARED_ANSWERS}
            is_of_all = is_of_all and len({*meanings}) == len(meanings)
            own = filled if is_of_all else [m for m in filled if m in group.span]
            for places, header, text in self.find_pairs(n, own):
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
        points = Points(
            self.cells.path, values, np.array(rows, dtype=np.int64) + 1, self.read_sd(group, rows)
        )
        stated = {**found.above, **self.read_attributes(found)}
        title = stated.pop("needle", Stated("")).text
        name = "-".join(filter(None, (own, group.name or ("" if own else title))))
        return self.make_curve(name, points, group, stated, self.read_readings(group, rows))

    def make_curve(
        self,
        name: str,
        points: Points,
        group: _Group,
        stated: dict[str, Stated],
        readings: Readings | None = None,
    ) -> ImportedCurve:
        """Return a curve, in LPS where the names of its axes state a patient system."""
        axes = "x, y, z" if len(group.columns) == 3 else "x, y; z is 0"
        if group.system == "RAS":
            points, axes = replace(points, values=points.values * [-1.0, -1.0, 1.0]), "R, A, S"
        system: PatientSystem | None = "LPS" if group.system else None
        unit = group.headers[group.columns[0]].unit
        return ImportedCurve(name, points, unit, system, stated, axes, readings)

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

    def read_sd(self, group: _Group, rows: Sequence[int]) -> Floats | None:
        """Return the standard deviation of each point (N,), in the unit of the coordinates.

        None if the table states one value, or none.
        """
        columns = group.find("point sd")[:1]
        if len({self.cells.cell(n, m) for n in rows for m in columns}) < 2:
            return None
        unit, own = (group.headers[m].unit for m in (group.columns[0], columns[0]))
        if own not in ("", unit):
            what = f"the unit of {group.headers[columns[0]].text} is {own!r}, that of the points {unit!r}"
            where = self.cells.where(max(group.row, 0), columns[0])
            raise DataError(what, where=where, expected="one unit", fix="write both in one unit")
        return self.read_numbers(rows, columns)[:, 0]

    def read_attributes(self, found: _Found) -> dict[str, Stated]:
        """Return what columns state once for a curve; DataError if two cells of one contradict each other."""
        stated, group = dict[str, Stated](), found.group
        for meaning in ATTRIBUTES:
            columns = group.find(meaning)
            if not columns:
                continue
            for m in columns:
                cells = {n: text for n in found.rows if (text := self.cells.cell(n, m))}
                first = next(iter(cells), 0)
                other = next((n for n, text in cells.items() if text != cells[first]), None)
                if other is not None and meaning not in ("depth", "point sd"):  # those of each reading
                    where = self.cells.where(other, m)
                    what = f"{meaning} is {cells[first][:40]!r} and {cells[other][:40]!r}"
                    fix = f"correct the cell; if other columns distinguish the needles, {COLUMNS_FIX}"
                    raise DataError(what, where=where, expected="one value", fix=fix)
                if cells and other is None:
                    texts, own = [self.clean(cells[first], meaning)], [m]
                    if meaning in _VECTORS or meaning == "boundaries":  # of several columns
                        own = [k for k in columns if self.cells.cell(first, k)]
                        texts = [self.clean(self.cells.cell(first, k), meaning) for k in own]
                    for n in cells:
                        self.use(n, *own)
                    joined = (", " if meaning in _VECTORS else "; ").join(texts)
                    where = self.cells.where(first, own[0])
                    add_stated(stated, {meaning: Stated(joined, group.headers[m].unit, where)})
        return stated

    def clean(self, text: str, meaning: str) -> str:
        """Return a cell of what has a unit with a decimal point, where it is a number with a comma."""
        is_name = meaning in ("medium", "specimen", "bevel side")
        if is_name or self.cells.decimal != "," or self.cells.number(text) is None:
            return text
        return text.replace(".", "").replace(",", ".")

    def read_readings(self, group: _Group, rows: Sequence[int]) -> Readings | None:
        """Return what makes a curve the track of a tip: depth, time or direction in each row."""
        is_deflection = any(group.headers[m].meaning == "deflection" for m in group.columns)
        is_log = bool(group.find("time", "quaternion"))
        columns = group.columns[:1] if is_deflection else group.find("depth")
        if len({self.cells.cell(n, m) for n in rows for m in columns}) < 2 and not is_deflection:
            return Readings(np.empty(0), "", is_log, False) if is_log else None
        unit = group.headers[columns[0]].unit or group.headers[group.columns[0]].unit
        return Readings(self.read_numbers(rows, columns)[:, 0], unit, is_log, is_deflection)

    # ---- needles, and what is left

    def read_shared(self) -> bool:
        """Add what a table without coordinates and without names of needles states of all needles.

        Its rows are pairs of a name and a value, or one row of values below headers. Return whether it does.
        """
        heads = [[read_header(text) for text in row] for row in self.cells.rows]
        if any(one.meaning == "needle" for row in heads for one in row):
            return False
        rows = [n for n in range(len(heads)) if self.cells.filled(n)]
        named = [n for n in rows if self.find_pairs(n, self.cells.filled(n))]
        stated: dict[str, Stated] = {}
        if len(rows) == 2 and not named:
            group = _Group(rows[0], self.apply_columns(heads[rows[0]]), range(len(heads[rows[0]])))
            stated = self.read_attributes(_Found(group, (), rows=rows[1:]))
            self.use(rows[0], *range(len(heads[rows[0]])))
        for n in named:
            for places, header, text in self.find_pairs(n, self.cells.filled(n)):
                add_stated(
                    stated, {header.meaning: Stated(text, header.unit, self.cells.where(n, places[-1]))}
                )
                self.use(n, *places)
        stated.pop("depth", None)  # which no needles share
        add_stated(self.content.setup, stated)
        return bool(stated)

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
        sensor = self.find_sensors(group)
        for m in range(n + 1 + bool(units), len(self.cells.rows)):
            if name := self.cells.cell(m, keys[0]):
                self.use(m, keys[0])
                others = replace(group, columns=tuple(sensor))
                stated = self.read_attributes(_Found(others, (name,), rows=[m]))
                sensors = [self.read_lengths(group, m, sensor)] if sensor else []
                turns = [float(one) for one in self.read_lengths(group, m, depth)]
                rolls = [stated.pop("bevel side", Stated("", "", self.cells.where(m))) for _ in turns]
                stated = {} if turns else stated  # its depth is that of the turn
                from_base = bool(sensor) and group.headers[sensor[0]].meaning == "sensor from base"
                pairs = [*zip(turns, rolls, strict=True)]
                self.content.needles.append(NeedleRow(name, stated, pairs, sensors, from_base))

    def find_sensors(self, group: _Group) -> list[int]:
        """Return the columns of a table of curvatures in the order of `SENSOR`; none if it is no such table.

        DataError if it lacks one.
        """
        if not group.find(*SENSOR[1:3]):
            return []
        words = {SENSOR[0]: (SENSOR[0], "sensor from base"), SENSOR[3]: (SENSOR[3], "point sd")}
        found = {one: [m for word in words.get(one, (one,)) for m in group.find(word)] for one in SENSOR}
        if lacking := [one for one, columns in found.items() if not columns]:
            what = f"a table of curvatures lacks {', '.join(lacking)}"
            expected = "columns s (from the tip, or from the base), kappa_y, kappa_z and sd"
            fix = "name them with --columns " + ",".join(f'"{one}=HEADER"' for one in lacking)
            raise DataError(what, where=self.cells.where(group.row), expected=expected, fix=fix)
        return [columns[0] for columns in found.values()]

    def read_lengths(self, group: _Group, n: int, columns: Sequence[int]) -> Floats:
        """Return cells of a row in mm, curvatures in 1/mm; DataError if one or its unit is unknown."""
        values = self.read_numbers([n], columns)[0]
        for k, m in enumerate(columns):
            header = group.headers[m]
            if (unit := header.unit.removeprefix("1/").strip() or "mm") not in UNITS_MM:
                what, where = f"the unit of {header.text} is {header.unit!r}", self.cells.where(group.row, m)
                raise DataError(what, where=where, expected=", ".join(UNITS_MM), fix="correct the header")
            is_place = header.meaning in ("sensor", "sensor from base", "depth", "turn depth")
            values[k] *= UNITS_MM[unit] ** (1 if is_place else -1)
        return values

    def add_unused(self) -> None:
        """Add what is not used: columns by their headers, and other cells by their rows.

        A column of numbers under a header that no language knows may hold something that matters.
        """
        cells, starts, content = self.cells, sorted(self.heads), self.content
        for n, end in pairwise([*starts, len(cells.rows)]):
            for m, header in enumerate(self.heads[n][0].headers):
                texts = {(k, m): cells.cell(k, m) for k in range(n + 1, end) if cells.cell(k, m)}
                if not texts or texts.keys() & cells.used:
                    continue
                cells.used.update(texts)
                one = f"column {header.text or m + 1}", Path(cells.where(max(n, 0))).name
                content.unused.append(one)
                numbers = [cells.number(text) for text in texts.values()]
                is_known = bool(header.meaning) or header.group in _NO_POINTS
                is_count = not header.text and numbers == [*range(1, len(numbers) + 1)]
                if not is_known and not is_count and None not in numbers:
                    content.unknown.append(one)
        for n, row in enumerate(cells.rows):
            if texts_left := [text for m, text in enumerate(row) if text and (n, m) not in cells.used]:
                what = f"row {', '.join(texts_left)}"[:MAX_LISTED_CHARS]
                content.unused.append((what, Path(cells.where(n)).name))
