"""Turns of the bevel: a row for each depth from which on it faces another way."""

from collections.abc import Sequence

from needlefit.datasets.importing.draft_table import Columns, TableDraft
from needlefit.datasets.importing.kinds import ImportedCurve, RowKind
from needlefit.datasets.importing.mapped_table import MappedTable


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
    mapped.require("turn_depth", "bevel_side")
    for n in rows:
        curve.turns.append((mapped.read_number("turn_depth", n), mapped.read_side(n)))


TURNS = RowKind("turns", propose_turns, 2, read=read_turns)
