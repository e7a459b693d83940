"""A table ready for print: cells as text, column headings, positions of rules."""

from dataclasses import dataclass
from typing import Literal

Align = Literal["left", "right"]


@dataclass(frozen=True)
class TableColumn:
    """A column: heading, unit (below the heading), alignment, and whether it takes the remaining width."""

    label: str
    unit: str = ""
    align: Align = "right"
    wide: bool = False


@dataclass(frozen=True)
class TableLayout:
    """A table of text.

    Attributes
    ----------
    name : str
        Of its file and label.
    caption : str
        What it shows.
    columns : tuple of TableColumn
    rows : tuple of tuple of str
        Cells, as many as there are columns.
    breaks : tuple of int
        Rows before which a thin rule stands.
    strong : tuple of int
        Rows that hold our answer; the others stand beside it.
    notes : tuple of str
        Sentences under the table.
    """

    name: str
    caption: str
    columns: tuple[TableColumn, ...]
    rows: tuple[tuple[str, ...], ...]
    breaks: tuple[int, ...] = ()
    strong: tuple[int, ...] = ()
    notes: tuple[str, ...] = ()


def text_column(label: str, wide: bool = False) -> TableColumn:
    """Return a left-aligned column of text."""
    return TableColumn(label, align="left", wide=wide)


def drop_empty_columns(table: TableLayout) -> TableLayout:
    """Return the table without columns that are empty in all rows."""
    return _select_columns(
        table, [i for i in range(len(table.columns)) if any(row[i] not in ("", "–") for row in table.rows)]
    )


def drop_column(table: TableLayout, label: str) -> TableLayout:
    """Return the table without the column that has this label."""
    return _select_columns(table, [i for i, column in enumerate(table.columns) if column.label != label])


def _select_columns(table: TableLayout, kept: list[int]) -> TableLayout:
    columns = tuple(table.columns[i] for i in kept)
    rows = tuple(tuple(row[i] for i in kept) for row in table.rows)
    return TableLayout(table.name, table.caption, columns, rows, table.breaks, table.strong, table.notes)
