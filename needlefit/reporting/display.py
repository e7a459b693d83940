"""A table ready to be set: cells as text, what heads the columns, where a rule stands."""

from dataclasses import dataclass
from typing import Literal

Align = Literal["left", "right"]


@dataclass(frozen=True)
class Column:
    """A column's head, its unit (under the head), its side, and whether it takes the space that is left."""

    label: str
    unit: str = ""
    align: Align = "right"
    wide: bool = False


@dataclass(frozen=True)
class Display:
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
    columns: tuple[Column, ...]
    rows: tuple[tuple[str, ...], ...]
    breaks: tuple[int, ...] = ()
    strong: tuple[int, ...] = ()
    notes: tuple[str, ...] = ()


def text(label: str, wide: bool = False) -> Column:
    """Return a column of words."""
    return Column(label, align="left", wide=wide)


def without_empty(table: Display) -> Display:
    """Return the table without the columns in which no row has anything to say."""
    return _keep(
        table, [i for i in range(len(table.columns)) if any(row[i] not in ("", "–") for row in table.rows)]
    )


def without(table: Display, label: str) -> Display:
    """Return the table without the column of this label."""
    return _keep(table, [i for i, column in enumerate(table.columns) if column.label != label])


def _keep(table: Display, kept: list[int]) -> Display:
    columns = tuple(table.columns[i] for i in kept)
    rows = tuple(tuple(row[i] for i in kept) for row in table.rows)
    return Display(table.name, table.caption, columns, rows, table.breaks, table.strong, table.notes)
