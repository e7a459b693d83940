"""A table ready for print: cells as text, column headings, positions of rules."""

from dataclasses import dataclass, replace
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


def drop_empty_columns(table: TableLayout) -> TableLayout:
    """Return the table without columns that are empty in all rows."""
    kept = [i for i in range(len(table.columns)) if any(row[i] not in ("", "–") for row in table.rows)]
    columns = tuple(table.columns[i] for i in kept)
    rows = tuple(tuple(row[i] for i in kept) for row in table.rows)
    return replace(table, columns=columns, rows=rows)
