"""Tables of reports: declared by rows and keys of columns, whose registry has heads and units; as text."""

import re
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

from needlefit.metrics import METRICS
from needlefit.reporting.columns import METRIC_UNIT, Column, find_column, format_value
from needlefit.reporting.number_format import MISSING

if TYPE_CHECKING:
    from needlefit.reporting.table_files import Row

_PARTS = "parts"  # key of the rows that were merged into one


@dataclass(frozen=True)
class TableColumn:
    """A column: heading, unit (below the heading), alignment, and whether it takes the remaining width."""

    label: str
    unit: str = ""
    align: Literal["left", "right"] = "right"
    wide: bool = False


@dataclass(frozen=True)
class TableLayout:
    """A table of text."""

    name: str  # of its file and label
    caption: str  # what it shows
    columns: tuple[TableColumn, ...]
    rows: tuple[tuple[str, ...], ...]  # cells, as many as there are columns
    breaks: tuple[int, ...] = ()  # rows before which a thin rule stands
    strong: tuple[int, ...] = ()  # rows that hold our answer; the others stand beside it
    notes: tuple[str, ...] = ()  # sentences under the table


_SENTENCE_END = re.compile(r"(?<=\.) ")


def drop_repeated(tables: Iterable[TableLayout]) -> Iterator[TableLayout]:
    """Yield tables that are printed below each other, each sentence of their notes once.

    Not those that differ from one before in their layers alone: by medium, if each has one number of layers.
    """
    seen, sentences = set[tuple[tuple[str, ...], ...]](), set[str]()
    for table in tables:
        kept = [n for n, column in enumerate(table.columns) if column.label != "Layers"]
        cells = tuple(tuple(row[n] for n in kept) for row in table.rows)
        if cells in seen:
            continue
        seen.add(cells)
        split = [_SENTENCE_END.split(note) for note in table.notes]
        notes = [" ".join(sentence for sentence in note if sentence not in sentences) for note in split]
        sentences.update(sentence for note in split for sentence in note)
        yield replace(table, notes=tuple(filter(None, notes)))


@dataclass(frozen=True)
class Cells:
    """A printed column: its head, and the cell of a row."""

    head: TableColumn
    cell: "Callable[[Row], str]"


def _find_unit(column: Column, metrics: Iterable[object]) -> str:
    """Return the unit of a column in rows of these metrics; none where theirs differ."""
    units = {METRICS[str(name)].unit for name in metrics if name in METRICS}
    return column.unit.replace(METRIC_UNIT, units.pop() if len(units) == 1 else "")


def pivot(rows: "Iterable[Row]", index: Sequence[str], by: Sequence[str]) -> "list[Row]":
    """Return one row per entry of the columns `index`; `part` prints columns of the rows that it was made of.

    It has the values of the first of these; they differ in the columns `by`.
    """
    merged: dict[tuple[Hashable, ...], Row] = {}
    for row in rows:
        whole = merged.setdefault(tuple(row[name] for name in index), {**row, _PARTS: {}})
        whole[_PARTS][frozenset((name, row[name]) for name in by)] = row
    return list(merged.values())


def part(key: str, **place: object) -> Cells:
    """Return a column of pivoted rows: `key` where the columns of `place` have these values.

    The place is its heading; below stand what the registry has of `key`: its heading, if any, and unit.
    """
    column, where = find_column(key), frozenset(place.items())
    label = ", ".join(format_value(find_column(name).format, value) for name, value in place.items())
    unit = _find_unit(column, [place.get("metric")])
    head = TableColumn(label, ", ".join(words for words in (column.heading, unit) if words))

    def cell(row: "Row") -> str:
        return column.format_cell(row[_PARTS][where]) if where in row[_PARTS] else MISSING

    return Cells(head, cell)


@dataclass(frozen=True)
class Table:
    """A table of a report."""

    name: str  # of its file and label
    rows: "Iterable[Row]"  # values by key; `to_records` returns those of a DataFrame
    # Keys of the registry, or a `part` of rows that are pivoted
    columns: Sequence[Any]  # str or Cells: a tuple of both is one of objects to mypy
    # Where one of these columns changes, a group begins: a thin rule stands before it
    groups: Sequence[str] = ()
    heads: int = 0  # how many of the first columns name the group, and are blank in its further rows
    # Which rows hold our answer: "", "first" of the table, "groups": the first of each, or the column that
    # says so
    strong: str = ""
    caption: str = ""  # what it shows, where no text of a kind says so
    notes: tuple[str, ...] = ()  # sentences under the table

    def lay_out(self, drop_empty: bool = False) -> TableLayout:
        """Return the table as text, without columns that are empty if wanted."""
        rows = list(self.rows)
        columns: list[Cells] = []
        for given in self.columns:
            if isinstance(given, str):
                column = find_column(given)
                unit = _find_unit(column, {row.get("metric") for row in rows})
                align: Literal["left", "right"] = "left" if column.is_text else "right"
                head = TableColumn(column.label, unit, align, column.format == "prose")
                given = Cells(head, column.format_cell)
            columns.append(given)
        begins = [k for k, row in enumerate(rows) if not k or self._key(row) != self._key(rows[k - 1])]
        cells = tuple(
            tuple(
                "" if self.groups and number < self.heads and k not in begins else column.cell(row)
                for number, column in enumerate(columns)
            )
            for k, row in enumerate(rows)
        )
        breaks = tuple(begins[1:]) if self.groups else ()
        heads = tuple(column.head for column in columns)
        strong = {"": (), "first": (0,), "groups": tuple(begins)}.get(self.strong)
        if strong is None:
            strong = tuple(k for k, row in enumerate(rows) if row[self.strong])
        if drop_empty:
            kept = [i for i in range(len(heads)) if any(row[i] not in ("", "–") for row in cells)]
            heads = tuple(heads[i] for i in kept)
            cells = tuple(tuple(row[i] for i in kept) for row in cells)
        return TableLayout(self.name, self.caption, heads, cells, breaks, strong, self.notes)

    def _key(self, row: "Row") -> list[Any]:
        return [row[name] for name in self.groups]
