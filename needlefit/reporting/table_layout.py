"""Table that is ready to be set: cells as text, headings of columns, places of rules."""

from dataclasses import dataclass
from typing import Literal

Align = Literal["left", "right"]


@dataclass(frozen=True)
class TableColumn:
    """A column's head, its unit (under the head), its side, and whether it takes the space that is left."""

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
    columns : tuple of Column
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
    """Return a column of words."""
    return TableColumn(label, align="left", wide=wide)


def drop_empty_columns(table: TableLayout) -> TableLayout:
    """Return the table without the columns in which no row has anything to say."""
    return _select_columns(
        table, [i for i in range(len(table.columns)) if any(row[i] not in ("", "–") for row in table.rows)]
    )


def drop_column(table: TableLayout, label: str) -> TableLayout:
    """Return the table without the column of this label."""
    return _select_columns(table, [i for i, column in enumerate(table.columns) if column.label != label])


def _select_columns(table: TableLayout, kept: list[int]) -> TableLayout:
    columns = tuple(table.columns[i] for i in kept)
    rows = tuple(tuple(row[i] for i in kept) for row in table.rows)
    return TableLayout(table.name, table.caption, columns, rows, table.breaks, table.strong, table.notes)
