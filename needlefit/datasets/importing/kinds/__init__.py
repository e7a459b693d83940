"""What rows of a table may be: points of shapes, tips, curvatures, readings of tips, turns, or facts.

Each file has the name of its kind, as `holds` of a mapping states it: how a table of it is recognised, and
how its rows are read.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from needlefit.datasets.importing.curves import ImportedCurve
from needlefit.registry import Registry

if TYPE_CHECKING:
    from needlefit.datasets.importing.curve_answers import Placer
    from needlefit.datasets.importing.draft_table import Columns, Records, TableDraft
    from needlefit.datasets.importing.mapped_table import MappedTable


@dataclass(frozen=True)
class RowKind:
    """One kind of rows."""

    name: str  #: `holds` of a mapping
    #: table, whether a person states the kind -> columns by needle, "" of all; none of other kinds
    propose: "Callable[[TableDraft, bool], dict[str, Columns]]"
    rank: int  #: the greatest is looked for first
    has_points: bool = False  #: rows are places, in the unit of coordinates
    #: places its needles; None: rows alone make no needle
    placer: "type[Placer] | None" = None
    in_tracker_frame: bool = False  #: places are in the frame of a tracker, not in that of the others
    is_line: bool = False  #: its points run along the needle
    is_of_each: bool = False  #: each needle needs a row
    #: shape, needle of the same name, which of its readings are at the end of the shape (N,) -> the others
    stand_beside: Callable[[ImportedCurve, ImportedCurve, NDArray[np.bool_]], ImportedCurve] | None = None
    #: table, needle, its rows: adds to the needle what they state beside points
    read: "Callable[[MappedTable, ImportedCurve, Sequence[int]], None]" = lambda mapped, curve, rows: None
    #: table, columns of a needle: completes them, or asks
    complete: "Callable[[TableDraft, Records], None]" = lambda draft, records: None


KINDS = Registry(RowKind, __name__, "kind of rows")


def list_kinds() -> list[RowKind]:
    """Return all kinds, in the order in which they are looked for."""
    return sorted(KINDS.values(), key=lambda kind: -kind.rank)
