"""Find the curves of needles in tables, and what tables state of them beside their points."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.importing.answers import Stated
from needlefit.datasets.importing.curves import ATTRIBUTES, ImportContent, ImportedCurve, Readings
from needlefit.datasets.importing.questions import QUESTIONS
from needlefit.datasets.importing.synonyms import INDEX
from needlefit.datasets.importing.table_heads import ColumnGroup, find_pairs
from needlefit.datasets.importing.table_statements import read_attributes, read_numbers
from needlefit.datasets.importing.tables import MISSING, CellTable, UnclearLayoutError, is_number_like
from needlefit.datasets.point_labels import divide_labels
from needlefit.datasets.points import MIN_POINTS, Points
from needlefit.datasets.tip_tracks import MIN_READINGS
from needlefit.errors import refusal
from needlefit.geometry.frames import PatientSystem

# What holds from its row above the points on, of all needles, until another row restates it.
SHARED_ANSWERS = tuple(one for one in ATTRIBUTES if one not in ("depth", "bevel side", "medium", "specimen"))
_KEYS = ("specimen", "needle")  # columns that tell curves apart


@dataclass
class CurveRows:
    """The rows of a curve: its columns, names in columns, and what stands above it."""

    group: ColumnGroup
    names: tuple[str, ...]
    above: Mapping[str, Stated] = field(default_factory=dict)
    rows: list[int] = field(default_factory=list)


class CurveReader:
    """Reads the curves of one table below its rows of headers, and marks the cells that it uses."""

    def __init__(
        self, cells: CellTable, content: ImportContent, heads: Mapping[int, Sequence[ColumnGroup]]
    ) -> None:
        self.cells, self.content, self.heads = cells, content, heads

    def read(self) -> Iterator[ImportedCurve]:
        """Yield the curves of the table.

        UnclearLayoutError if each row may be a needle, or hold a point of each.
        """
        arrays = [n for n in self.heads if self.is_array(n)]
        if arrays and not self.content.layout:
            names = [one.name.strip(" /") for one in self.heads[arrays[0]]]
            raise UnclearLayoutError.of(f"""each row holds {len(names)} places:
                    {names[0] or "x, y, z"}, {names[1] or "x, y, z"}, ...
                expected: {QUESTIONS["layout"].text}
                fix: state --setup layout=rows or --setup layout=columns
                where: {self.cells.where(max(arrays[0], 0))}""")
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
                values[k, : len(one.columns)] = read_numbers(self.cells, [n], one.columns)[0]
            keys = whole.find("needle")
            self.cells.use(n, *keys)
            name, points = "", Points(self.cells.path, values, np.full(len(filled), n + 1))
            if keys:
                name = self.cells.cell(n, keys[0])
            stated = read_attributes(self.cells, whole, [n])
            yield self.make_curve(name, points, groups[0], stated)

    def find_curves(self) -> list[tuple[CurveRows, str]]:
        """Return the curves, each with its name in a column: one for each name, or each block of rows."""
        found: dict[tuple[object, ...], CurveRows] = {}
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
                found.setdefault(key, CurveRows(group, own_names, stated)).rows.append(n)
        ones = [one for one in found.values() if self.list_filled(one)]
        ones = [part for one in ones for part in self.split_tips(one)]
        is_unique = len({(one.group.name, *one.names[-1:]) for one in ones}) == len(ones)
        return [(one, "-".join(filter(None, one.names[-1:] if is_unique else one.names))) for one in ones]

    def split_tips(self, one: CurveRows) -> list[CurveRows]:
        """Return each row by itself where depths and deflections without a name are of no one tip."""
        group, rows = one.group, self.list_filled(one)
        if not group.is_deflection or any(one.names):
            return [one]
        depths = read_numbers(self.cells, rows, group.columns[:1])[:, 0]
        if len(depths) >= MIN_READINGS and (np.diff(depths) > 0).all():
            return [one]
        return [replace(one, rows=[n]) for n in rows]

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
            if len(texts) <= MIN_POINTS or len({*texts.values()}) < len(texts) or groups[0].is_deflection:
                continue
            rows, needles = [*texts], divide_labels([*texts.values()])
            if not needles:
                shown = ", ".join(list(texts.values())[:3])
                column = groups[0].headers[m].text or m + 1
                raise refusal(f"""every row has a name of its own: {shown}, ...
                    expected: in each row the name of its needle
                    fix: if they are points of one needle: --columns "point number={column}"; if they
                        are tips, name the columns depth and deflection
                    where: {self.cells.where(max(head, 0), m)}""")
            found[m] = {rows[k]: name for name, own in needles.items() for k in own}
        return found

    def is_point(self, groups: Sequence[ColumnGroup], n: int, is_open: bool) -> bool:
        """Whether a row has coordinates, in part where `is_open` (the row above has), or only names."""
        texts = [[self.cells.cell(n, m) for m in one.columns] for one in groups]
        numbers = max((sum(self.cells.number(text) is not None for text in one) for one in texts), default=0)
        filled = self.cells.filled(n)
        if any(all(map(is_number_like, one)) for one in texts):
            return True
        if numbers > 1 or not groups or find_pairs(self.cells, n):
            return numbers > 1
        if (is_open and numbers) or any(text.lower() in MISSING for one in texts for text in one):
            return True
        return not any(map(any, texts)) and any(groups[0].headers[m].meaning for m in filled)

    def require_width(self, head: int, n: int) -> None:
        """DataError where the cells of a row of text do not stand under those of its header."""
        row, width = self.cells.rows[n], len(self.cells.rows[head])
        is_longer = self.cells.separator == "," and any(row[width:])
        if head >= 0 and (is_longer or (self.cells.separator == " " and len(row) != width)):
            raise refusal(f"""has {len(row)} cells under {width} columns
                expected: as many as the header
                fix: save it with semicolons or tabs
                where: {self.cells.where(n)}""")

    def list_filled(self, one: CurveRows) -> list[int]:
        """Return the rows of a curve in which not all coordinates are missing.

        A column x that several curves share is filled beyond the end of the shorter ones.
        """
        others = self.heads[one.group.row]
        shared = {m for m in one.group.columns for other in others if other.columns != one.group.columns
                  and m in other.columns}  # fmt: skip
        own = [m for m in one.group.columns if m not in shared]
        texts = {n: [self.cells.cell(n, m) for m in own] for n in one.rows}
        return [n for n, row in texts.items() if any(text and text.lower() not in MISSING for text in row)]

    def read_labels(self, group: ColumnGroup, rows: Sequence[int]) -> dict[str, Stated]:
        """Return what pairs of cells above a block state of a curve in it, and titles name."""
        stated: dict[str, Stated] = {}
        for n in rows:
            meanings = [one.meaning for _, one, _ in find_pairs(self.cells, n)]
            is_of_all = bool(meanings) and {*meanings} <= {*SHARED_ANSWERS}
            is_of_all = is_of_all and len({*meanings}) == len(meanings)
            for places, header, text in find_pairs(self.cells, n, None if is_of_all else group.span):
                stated[header.meaning] = Stated(text, header.unit, self.cells.where(n, places[-1]))
                self.cells.use(n, *places)
        return stated

    def read_curve(self, found: CurveRows, own: str) -> ImportedCurve:
        """Return one curve, with what the table states once for it. `own`: its name in a column."""
        group, rows = found.group, self.list_filled(found)
        for n in {*rows, *found.rows[:1]}:
            self.cells.use(n, *group.find(*_KEYS))
        values = np.zeros((len(rows), 3))
        values[:, : len(group.columns)] = read_numbers(self.cells, rows, group.columns)
        points = Points(
            self.cells.path, values, np.array(rows, dtype=np.int64) + 1, self.read_sd(group, rows)
        )
        stated = {**found.above, **read_attributes(self.cells, group, found.rows)}
        title = stated.pop("needle", Stated("")).text
        name = "-".join(filter(None, (own, group.name or ("" if own else title))))
        curve = self.make_curve(name, points, group, stated, self.read_readings(group, rows))
        curve.guides = self.read_guides(group, rows)
        return curve

    def read_guides(self, group: ColumnGroup, rows: Sequence[int]) -> dict[str, Floats]:
        """Return the places (N, 3) of what may be a guide or the base, by the header of its columns."""
        columns = {group.headers[m].axis: m for m in group.find("guide") if group.headers[m].axis}
        texts = [self.cells.cell(n, m) for n in rows for m in columns.values()]
        if len(columns) < 2 or any(self.cells.number(text) is None for text in texts):
            return {}
        places = np.zeros((len(rows), 3))
        for axis, m in columns.items():
            places[:, "xyz".index(axis)] = read_numbers(self.cells, rows, [m])[:, 0]
        (name, _), *_ = sorted((re.split(r"[\s_./-]", group.headers[m].text)[0], m) for m in columns.values())
        return {name: places}

    def make_curve(
        self,
        name: str,
        points: Points,
        group: ColumnGroup,
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

    def read_sd(self, group: ColumnGroup, rows: Sequence[int]) -> Floats | None:
        """Return the standard deviation of each point (N,), in the unit of the coordinates.

        None if the table states one value, or none.
        """
        columns = group.find("point sd")[:1]
        if len({self.cells.cell(n, m) for n in rows for m in columns}) < 2:
            return None
        unit, own = (group.headers[m].unit for m in (group.columns[0], columns[0]))
        if own not in ("", unit):
            raise refusal(f"""the unit of {group.headers[columns[0]].text} is {own!r}, that of the
                    points {unit!r}
                expected: one unit
                fix: write both in one unit
                where: {self.cells.where(max(group.row, 0), columns[0])}""")
        return read_numbers(self.cells, rows, columns)[:, 0]

    def read_readings(self, group: ColumnGroup, rows: Sequence[int]) -> Readings | None:
        """Return what makes a curve the track of a tip: depth, time or direction in each row."""
        is_deflection = group.is_deflection
        is_log = bool(group.find("time", "quaternion"))
        columns = group.columns[:1] if is_deflection else group.find("depth")
        if len({self.cells.cell(n, m) for n in rows for m in columns}) < 2 and not is_deflection:
            return Readings(np.empty(0), "", is_log, False) if is_log else None
        unit = group.headers[columns[0]].unit or group.headers[group.columns[0]].unit
        return Readings(read_numbers(self.cells, rows, columns)[:, 0], unit, is_log, is_deflection)
