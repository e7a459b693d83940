"""A table of readings: cells -> runs, and what is wrong with a run."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from needlefit.datasets.faults import Fault
from needlefit.datasets.formats.csv import MAPPED, Table, missing_columns, numbers
from needlefit.datasets.tracks.track import Track
from needlefit.schemas.dataset import TrackDatasetRecord
from needlefit.schemas.names import EXPECTED_NAME, name_fault

Floats = NDArray[np.float64]

REQUIRED = ("id", "medium", "depth_mm", "tip_mm", "guide_mm")
OPTIONAL = {"heading_deg": np.nan, "bevel_side": 1.0, "valid": 1.0}
"""Columns that may be absent, or have empty cells, and what then stands for them."""

FEWEST = 5
"""Readings of a run: two of them are taken by shift and slope, and a bend needs more than one."""

LARGEST_STEP = 100.0
"""mm between two readings; more was written in another unit."""


@dataclass(frozen=True)
class Parsed:
    """The sound runs of a table, and which were left out."""

    tracks: tuple[Track, ...]
    remarks: tuple[str, ...]


@dataclass(frozen=True)
class _Rows:
    """Columns of one run, (n,) each, and the row of the table in which it begins."""

    id: str
    medium: str
    rows: NDArray[np.int64]
    values: dict[str, Floats]


def parse(table: Table, record: TrackDatasetRecord, found: list[Fault]) -> Parsed:
    """Return the runs of a table; note every fault. A run with a reading marked invalid is left out whole."""
    before, tracks, remarks = len(found), [], []
    for run in _runs(table, record, found):
        bad = np.flatnonzero(run.values["valid"] == 0)
        if len(bad):
            at = run.values["depth_mm"][bad[0]]
            remarks.append(
                f"Run {run.id} is left out: {len(bad)} of its {len(run.rows)} readings are marked invalid, "
                f"from {at:.0f} mm on."
            )
            continue
        faults = list(_faults(run, table, record))
        found += faults
        if not faults:
            tracks.append(_track(run, record))
    return Parsed(tuple(tracks) if len(found) == before else (), tuple(remarks))


def _runs(table: Table, record: TrackDatasetRecord, found: list[Fault]) -> Iterator[_Rows]:
    """Yield the runs in the order of their first rows; none where a column or a number is missing."""
    source, constants = record.tip_tracks, record.tip_tracks.constants
    theirs = {name: source.columns.get(name, name) for name in (*REQUIRED, *OPTIONAL)}
    absent = {theirs[name]: str(constants[name]) for name in theirs if name in constants}
    table = Table(table.path, table.cells.assign(**absent), table.lines)
    wanted = [theirs[name] for name in REQUIRED] + list(source.columns.values())
    unknown = sorted((source.columns.keys() | constants.keys()) - theirs.keys())
    found += [
        Fault(
            str(table.path),
            f"`columns` or `constants` names {name}",
            f"one of {', '.join(theirs)}",
            "correct [tip_tracks] of dataset.toml",
        )
        for name in unknown
    ]
    if missing_columns(table, list(dict.fromkeys(wanted)), found, MAPPED) or unknown:
        return
    values = _values(table, theirs, found)
    if values is None:
        return
    ids, media = (table.cells[theirs[name]].to_numpy(dtype=str) for name in ("id", "medium"))
    for id_ in dict.fromkeys(ids.tolist()):
        rows = np.flatnonzero(ids == id_)
        yield _Rows(id_, str(media[rows[0]]), rows, {name: column[rows] for name, column in values.items()})


def _values(table: Table, theirs: Mapping[str, str], found: list[Fault]) -> dict[str, Floats] | None:
    """Return every column of numbers (N,) under our names; None after a fault."""
    before = len(found)
    values = {name: numbers(table, theirs[name], found) for name in REQUIRED[2:]}
    for name, default in OPTIONAL.items():
        values[name] = np.full(len(table.lines), default)
        if theirs[name] in table.cells:
            given = numbers(table, theirs[name], found, optional=True)
            values[name] = np.where(np.isnan(given), default, given)
    return values if len(found) == before else None


def _faults(run: _Rows, table: Table, record: TrackDatasetRecord) -> Iterator[Fault]:
    """Say what is wrong with one run."""
    first, depth = table.where(int(run.rows[0])), run.values["depth_mm"]
    if not run.id:
        yield Fault(first, "a reading has no id", "the run that it belongs to", "fill the cell")
    elif fault := name_fault(run.id):
        yield Fault(first, f"id is {run.id!r}: {fault}", EXPECTED_NAME, "rename the run")
    if run.medium not in record.media:
        known = ", ".join(record.media)
        fix = "correct it, or add a table [media.NAME] to dataset.toml"
        yield Fault(first, f"run {run.id} went into {run.medium!r}, which is not described", known, fix)
    if len(depth) < FEWEST:
        yield Fault(
            first,
            f"run {run.id} has {len(depth)} reading{'s' if len(depth) > 1 else ''}",
            f"at least {FEWEST}: a shift and a slope are the tracker's",
            "add the others, or leave the run out",
        )
    for n in np.flatnonzero(np.diff(depth) <= 0)[:1]:
        yield Fault(
            table.where(int(run.rows[n + 1])),
            f"run {run.id} goes from {depth[n]:g} back to {depth[n + 1]:g} mm",
            "depths that increase from reading to reading",
            "leave out what follows, or mark the run's readings with valid = 0",
        )
    for n in np.flatnonzero(np.diff(depth) > LARGEST_STEP)[:1]:
        yield Fault(
            table.where(int(run.rows[n + 1])),
            f"run {run.id} goes {depth[n + 1] - depth[n]:g} mm deeper between two readings",
            f"mm, at most {LARGEST_STEP:g} at once",
            "convert to mm, or add the readings between",
        )
    sides = run.values["bevel_side"]
    if sides[0] not in (1.0, -1.0) or np.ptp(sides) > 0:
        yield Fault(first, f"bevel_side of run {run.id} is {sides[0]:g}", "1 or -1, one for all of a run", "")


def _track(run: _Rows, record: TrackDatasetRecord) -> Track:
    medium, values = record.media[run.medium], run.values
    heading = np.radians(values["heading_deg"])
    return Track(
        id=run.id,
        medium=run.medium,
        specimen=medium.specimen or run.medium,
        side=int(values["bevel_side"][0]),
        depth=values["depth_mm"] - values["depth_mm"][0],
        tip=values["tip_mm"],
        guide=values["guide_mm"] - values["guide_mm"][0],
        boundaries=np.array(medium.boundaries_mm),
        sequence=medium.layers,
        heading=None if np.isnan(heading).any() else heading,
    )
