"""What rows of a table may be: points of shapes, tips, curvatures, readings of tips, turns, or facts.

Each file has the name of its kind, as `holds` of a mapping states it: how a table of it is recognised, how
its rows are read, and how its needles are placed.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from needlefit.datasets.importing.curve_answers import Placer
from needlefit.datasets.importing.curves import ImportedCurve
from needlefit.datasets.importing.draft_table import Columns, Records, TableDraft
from needlefit.datasets.importing.mapped_table import MappedTable
from needlefit.registry import Registry
from needlefit.schemas.mapping import Holds


@dataclass(frozen=True)
class RowKind:
    """One kind of rows."""

    name: Holds
    #: table, whether a person states the kind -> columns by needle, "" of all; none of other kinds
    propose: Callable[[TableDraft, bool], dict[str, Columns]]
    rank: int  #: the greatest is looked for first
    #: meanings of needles that each row may state anew
    varying: Sequence[str] = ("depth", "point_sd")
    placer: type[Placer] | None = None  #: places its needles; None: rows alone make no needle
    #: table, needle, its rows: adds to the needle what they state beside points
    read: Callable[[MappedTable, ImportedCurve, Sequence[int]], None] = lambda mapped, curve, rows: None
    #: table, columns of a needle: completes them, or asks
    complete: Callable[[TableDraft, Records], None] = lambda draft, records: None


KINDS = Registry(RowKind, __name__, "kind of rows")


def list_kinds() -> list[RowKind]:
    """Return all kinds, in the order in which they are looked for."""
    return sorted(KINDS.values(), key=lambda kind: -kind.rank)
