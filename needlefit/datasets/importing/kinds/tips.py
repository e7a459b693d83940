"""Tips alone: a row for each depth of a needle, with the place of its tip or the deflection."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from needlefit.datasets.importing.curves import ImportedCurve, TipReading
from needlefit.datasets.importing.draft_table import Records, TableDraft
from needlefit.datasets.importing.kinds import RowKind
from needlefit.datasets.importing.tips import TipPlacer
from needlefit.datasets.point_labels import divide_labels
from needlefit.datasets.points import MIN_POINTS


def propose_tips(draft: TableDraft, is_stated: bool) -> list[Records]:
    """Return the columns of deflections at depths, or of places with a name for each row; ask for one."""
    taken, points = draft.taken, draft.points
    if not points:
        if "depth" in taken and "needle" not in taken and len(unknown := draft.list_unknown()) > 1:
            draft.ask_column("deflection", unknown, "|".join(str(column.name) for column in unknown))
        return []
    if is_stated or draft.are_deflections:
        return points
    if not draft.names_rows:
        return []
    has_x = "x" in taken or any(column.header.axis == "x" for column in draft.axis_columns)
    is_depth = "depth" in taken and not has_x
    is_placed = not divide_labels(draft.names) and taken.keys() & {"depth", "entry_point", "bevel_side"}
    return points if is_depth or len(draft.names) < MIN_POINTS or is_placed else []


def complete_tips(draft: TableDraft, records: Records) -> None:
    """Assume that rows without a name are needles."""
    if "needle" not in records:
        draft.draft.assumed["needle"] = f"{len(draft.table.rows)} needles, one a row: no column names them"


def join_tips(shape: ImportedCurve, curve: ImportedCurve, at_end: NDArray[np.bool_]) -> ImportedCurve:
    """Add readings of a tip to the shape at whose end they are; return the others."""
    for n in np.flatnonzero(at_end):
        sd = None if curve.points.sd is None else float(curve.points.sd[n])
        if "point_sd" in curve.stated:
            sd = curve.stated["point_sd"].to_number("point_sd", is_above=True)
        shape.tips.append(TipReading(curve.line[n, 1:], sd, curve.points.where(int(n))))
    return replace(curve, points=curve.points.part(np.flatnonzero(~at_end)))


TIPS = RowKind(
    "tips",
    propose_tips,
    4,
    has_points=True,
    placer=TipPlacer,
    stand_beside=join_tips,
    complete=complete_tips,
)
