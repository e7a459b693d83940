"""Tip tracks: a row for each reading of a tip on its way, with its depth or place, and that of the guide."""

from collections.abc import Sequence

from needlefit.datasets.importing.curves import ImportedCurve
from needlefit.datasets.importing.draft_table import Records, TableDraft
from needlefit.datasets.importing.kinds import RowKind
from needlefit.datasets.importing.mapped_table import MappedTable
from needlefit.datasets.importing.stated import name_set
from needlefit.datasets.importing.tracks import TrackPlacer

MIN_SIGNS = 2  # of depths that differ, times that differ and a column of a tip: so many make a track


def propose_tracks(draft: TableDraft, is_stated: bool) -> list[Records]:
    """Return the columns of readings: deflections at increasing depths, or places with signs of a track."""
    if is_stated or not (points := draft.points):
        return draft.points
    if draft.are_deflections:
        is_track, reason = draft.increases(draft.taken["depth"]), "the depths of each needle increase"
    else:
        is_tip = any(column.header.beside in ("tip", "deflection") for column in draft.axis_columns)
        is_alone = len(draft.groups) < 2 and not draft.names_rows
        is_track = is_alone and is_tip + len(draft.changing) >= MIN_SIGNS
        reason = f"each row has a {min(draft.changing, default='')} of its own"
    if is_track:
        draft.draft.assumed["holds"] = f"tracks: {reason}; points: {name_set('holds', 'shapes')}"
    return points if is_track else []


def complete_tracks(draft: TableDraft, records: Records) -> None:
    """Ask along which axis a guide is, where nothing states it."""
    guide = records.get("guide")
    is_open = guide is not None and "axes" not in guide and draft.draft.values.get("guide") != "none"
    if guide is not None and is_open and "deflection" not in records:
        draft.draft.ask("guide", draft.where, name=str(guide["column"]))


def read_readings(mapped: MappedTable, curve: ImportedCurve, rows: Sequence[int]) -> None:
    """Add the depths of readings, where a column states them."""
    if (record := mapped.record.columns.get("depth")) is not None:
        curve.stated.pop("depth", None)
        curve.depths = mapped.read_numbers("depth", rows)
        curve.depth_column = str(record.columns[0])


TRACKS = RowKind(
    "tracks",
    propose_tracks,
    6,
    has_points=True,
    placer=TrackPlacer,
    in_tracker_frame=True,
    complete=complete_tracks,
    read=read_readings,
)
