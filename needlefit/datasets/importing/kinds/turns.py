"""Turns of the bevel: a row for each depth from which on it faces another way."""

from collections.abc import Sequence

from needlefit.datasets.importing.curves import ImportedCurve
from needlefit.datasets.importing.draft_table import Columns, TableDraft
from needlefit.datasets.importing.kinds import RowKind
from needlefit.datasets.importing.mapped_table import MappedTable
from needlefit.datasets.importing.stated import Stated
from needlefit.errors import DataError


def propose_turns(draft: TableDraft, is_stated: bool) -> dict[str, Columns]:
    """Return no columns but those of all, where a header states the depths of turns."""
    taken = draft.taken
    is_ours = {"depth_mm", "bevel_roll_deg"} <= {*draft.table.headers}
    if draft.points or not (is_stated or is_ours or "turn_depth" in taken):
        return {}
    if "depth" in taken:
        taken["turn_depth"] = taken.pop("depth")
    return {"": {}}


def read_turns(mapped: MappedTable, curve: ImportedCurve, rows: Sequence[int]) -> None:
    """Add the depths of turns, mm, and where the bevel faces then."""
    for n in rows:
        text = "".join(mapped.cells["bevel_side"][n])
        if not text:
            raise DataError(
                "nothing states where the bevel faces from this depth on",
                expected="bevel_side of each turn, as 90 deg",
                fix=f"fill in the cell; or {mapped.name_edit('columns.bevel_side.column')}",
                where=mapped.table.places[n],
            )
        cell = Stated(text, mapped.read_unit("bevel_side", n), mapped.where(n, "bevel_side"))
        curve.turns.append((mapped.read_number("turn_depth", n), cell))


TURNS = RowKind("turns", propose_turns, 2, read=read_turns)
