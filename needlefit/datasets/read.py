"""Read a dataset, of shapes or tip tracks, or list all of its faults (`needlefit check`)."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from needlefit.arrays import Floats
from needlefit.datasets.dataset_warnings import (
    BendResult,
    find_boundary_warnings,
    find_placeholder_cells,
    find_record_warnings,
    find_side_warnings,
    find_track_bend_side,
)
from needlefit.datasets.faults import Fault, as_error, from_error
from needlefit.datasets.formats.csv import (
    MISSING_COLUMN_FIX,
    CsvTable,
    note_missing_columns,
    parse_numbers,
    read_table,
)
from needlefit.datasets.insertion import Dataset
from needlefit.datasets.inspection import (
    Inspection,
    find_needle_faults,
    find_repeated_ids,
    inspect_dataset,
    make_dataset,
    make_noise,
)
from needlefit.datasets.noise import find_spacing_warnings
from needlefit.datasets.sources import compute_digest, find_checksum_faults, find_dataset_file, find_folders
from needlefit.datasets.tip_tracks import TipReadings, TipTrack, make_track
from needlefit.errors import ConfigError, DataError
from needlefit.project.result_warnings import ResultWarning
from needlefit.project.toml import load, locate_key, read_toml
from needlefit.project.unit_warnings import format_place
from needlefit.schemas.dataset import TrackDatasetRecord
from needlefit.schemas.names import EXPECTED_NAME, name_fault

REQUIRED_TRACK_COLUMNS = ("id", "medium", "depth_mm", "tip_mm", "guide_mm")
OPTIONAL_TRACK_COLUMNS = {"heading_deg": np.nan, "bevel_side": 1.0, "valid": 1.0}
"""Columns that may be absent or have empty cells, with their default values."""

MIN_READINGS = 5
"""Least number of readings of a run: shift and slope take two, and a bend needs more than one."""

MAX_STEP_MM = 100.0
"""Greatest distance of two readings, mm; a larger one was written in another unit."""


@dataclass(frozen=True)
class ParsedTracks:
    """The runs of a table without faults, and notes on the runs left out."""

    tracks: tuple[TipTrack, ...]
    remarks: tuple[str, ...]


@dataclass(frozen=True)
class _RunRows:
    """Columns of one run, (n,) each, and the row of the table in which it begins."""

    id: str
    medium: str
    rows: NDArray[np.int64]
    values: dict[str, Floats]


def parse_tracks(table: CsvTable, record: TrackDatasetRecord, found: list[Fault]) -> ParsedTracks:
    """Return the runs of a table; note every fault. A run with a reading marked invalid is left out."""
    before, tracks, remarks = len(found), [], []
    for run in _iterate_runs(table, record, found):
        bad = np.flatnonzero(run.values["valid"] == 0)
        if len(bad):
            at = run.values["depth_mm"][bad[0]]
            remarks.append(
                f"Run {run.id} is left out: {len(bad)} of its {len(run.rows)} readings are marked invalid, "
                f"from {at:.0f} mm on."
            )
            continue
        faults = list(_find_run_faults(run, table, record))
        found += faults
        if not faults:
            medium, values = record.media[run.medium], run.values
            heading = np.radians(values["heading_deg"])
            readings = TipReadings(
                depth=values["depth_mm"] - values["depth_mm"][0],
                tip=values["tip_mm"],
                guide=values["guide_mm"] - values["guide_mm"][0],
                heading=None if np.isnan(heading).any() else heading,
            )
            tracks.append(
                make_track(
                    run.id,
                    run.medium,
                    medium.specimen or run.medium,
                    int(values["bevel_side"][0]),
                    readings,
                    (np.array(medium.boundaries_mm), medium.layers),
                )
            )
    return ParsedTracks(tuple(tracks) if len(found) == before else (), tuple(remarks))


def _iterate_runs(table: CsvTable, record: TrackDatasetRecord, found: list[Fault]) -> Iterator[_RunRows]:
    """Yield the runs in the order of their first rows; none where a column or a number is missing."""
    source, constants = record.tip_tracks, record.tip_tracks.constants
    theirs = {
        name: source.columns.get(name, name) for name in (*REQUIRED_TRACK_COLUMNS, *OPTIONAL_TRACK_COLUMNS)
    }
    absent = {theirs[name]: str(constants[name]) for name in theirs if name in constants}
    table = CsvTable(table.path, table.cells.assign(**absent), table.lines)
    wanted = [theirs[name] for name in REQUIRED_TRACK_COLUMNS] + list(source.columns.values())
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
    if note_missing_columns(table, list(dict.fromkeys(wanted)), found, MISSING_COLUMN_FIX) or unknown:
        return
    values = _parse_values(table, theirs, found)
    if values is None:
        return
    ids, media = (table.cells[theirs[name]].to_numpy(dtype=str) for name in ("id", "medium"))
    for id_ in dict.fromkeys(ids.tolist()):
        rows = np.flatnonzero(ids == id_)
        yield _RunRows(
            id_, str(media[rows[0]]), rows, {name: column[rows] for name, column in values.items()}
        )


def _parse_values(table: CsvTable, theirs: Mapping[str, str], found: list[Fault]) -> dict[str, Floats] | None:
    """Return every column of numbers (N,) under our names; None after a fault."""
    before = len(found)
    values = {name: parse_numbers(table, theirs[name], found) for name in REQUIRED_TRACK_COLUMNS[2:]}
    for name, default in OPTIONAL_TRACK_COLUMNS.items():
        values[name] = np.full(len(table.lines), default)
        if theirs[name] in table.cells:
            given = parse_numbers(table, theirs[name], found, optional=True)
            values[name] = np.where(np.isnan(given), default, given)
    return values if len(found) == before else None


def _find_run_faults(run: _RunRows, table: CsvTable, record: TrackDatasetRecord) -> Iterator[Fault]:
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
    if len(depth) < MIN_READINGS:
        what = f"run {run.id} has {len(depth)} reading{'s' if len(depth) > 1 else ''}"
        expected = f"at least {MIN_READINGS}: a shift and a slope are the tracker's"
        yield Fault(first, what, expected, "add the others, or leave the run out")
    for n in np.flatnonzero(np.diff(depth) <= 0)[:1]:
        yield Fault(
            table.where(int(run.rows[n + 1])),
            f"run {run.id} goes from {depth[n]:g} back to {depth[n + 1]:g} mm",
            "depths that increase from reading to reading",
            "leave out what follows, or mark the run's readings with valid = 0",
        )
    for n in np.flatnonzero(np.diff(depth) > MAX_STEP_MM)[:1]:
        where = table.where(int(run.rows[n + 1]))
        what = f"run {run.id} goes {depth[n + 1] - depth[n]:g} mm deeper between two readings"
        expected = f"mm, at most {MAX_STEP_MM:g} at once"
        yield Fault(where, what, expected, "convert to mm, or add the readings between")
    sides = run.values["bevel_side"]
    if sides[0] not in (1.0, -1.0) or np.ptp(sides) > 0:
        yield Fault(first, f"bevel_side of run {run.id} is {sides[0]:g}", "1 or -1, one for all of a run", "")


def holds_tracks(path: Path) -> bool:
    """Return whether `path`, a dataset's folder or `dataset.toml`, is a dataset of tip tracks."""
    try:
        return "tip_tracks" in read_toml(find_dataset_file(path))
    except ConfigError:
        return False  # whoever reads it says what is wrong


def inspect_tracks(path: Path) -> Inspection:
    """Read a dataset of tip tracks, collecting every fault."""
    file = find_dataset_file(path)
    try:
        record = load(file, TrackDatasetRecord)
        roots = find_folders(record, file)
        tables = [read_table(root / record.tip_tracks.file) for root in roots]
    except (ConfigError, DataError) as error:
        return Inspection(None, (from_error(error),))
    found: list[Fault] = [*find_needle_faults(record.needle, file), *_find_noise_faults(record, file)]
    warnings = find_record_warnings(record, file)
    for root in roots:
        found += find_checksum_faults(record.checksums, root)
    tracks: list[TipTrack] = []
    remarks: list[str] = []
    for table in tables:
        warnings += find_placeholder_cells(table)
        parsed = parse_tracks(table, record, found)
        tracks += parsed.tracks
        remarks += parsed.remarks
    found += find_repeated_ids("run", (track.id for track in tracks), file)
    if not tracks and not found:
        found.append(
            Fault(str(file), "no run is left: every one is marked invalid", "at least one valid run")
        )
    if found:
        return Inspection(None, tuple(dict.fromkeys(found)), tuple(warnings))
    warnings += _find_run_warnings(record, tracks, file, str(tables[0].path))
    sum_ = compute_digest(file, roots, [table.path for table in tables])
    own = {"pose": "tracker", "drop_proximal": 0.0, "remarks": tuple(remarks), "warnings": tuple(warnings)}
    dataset = make_dataset(record, file, tracks, sum_, **own)
    return Inspection(dataset, (), tuple(warnings))


def _find_noise_faults(record: TrackDatasetRecord, file: Path) -> Iterator[Fault]:
    """Say whether readings have no noise: every fit of tip tracks samples a posterior, which needs one."""
    if record.noise.point_sd_mm <= 0:
        where = locate_key(file, "noise.point_sd_mm")
        what = "no noise of the readings is stated"
        yield Fault(where, what, "noise.point_sd_mm above 0", "write the standard deviation of a reading, mm")


def _find_run_warnings(
    record: TrackDatasetRecord, tracks: Sequence[TipTrack], file: Path, table: str
) -> Iterator[ResultWarning]:
    """Yield what is suspicious in sound runs."""
    column = record.tip_tracks.columns.get("bevel_side", "bevel_side")
    bend_results = [
        BendResult(one.id, table, find_track_bend_side(one, make_noise(record.noise))) for one in tracks
    ]
    yield from find_side_warnings(bend_results, column, "runs")
    yield from find_spacing_warnings(
        make_noise(record.noise), [one.depths for one in tracks], format_place(file)
    )
    yield from find_boundary_warnings(record, tracks, format_place(file))


def read(path: Path) -> Dataset:
    """Return the dataset, of shapes or tip tracks, whose folder or `dataset.toml` is `path`.

    DataError listing every fault that `check` finds.
    """
    found = inspect(path)
    if found.dataset is None:
        raise as_error(found.faults, find_dataset_file(path))
    return found.dataset


def inspect(path: Path) -> Inspection:
    """Return the dataset whose folder or `dataset.toml` is `path`, or its faults, and its warnings."""
    return inspect_tracks(path) if holds_tracks(path) else inspect_dataset(path)


def read_shapes(path: Path) -> Dataset:
    """Return `read(path)` for what works on whole shapes alone.

    DataError listing every fault that `check` finds, or because it holds tip tracks.
    """
    if holds_tracks(path):
        what = "holds tip tracks, no shapes"
        where = str(find_dataset_file(path))
        fix = "tune, identify, calibrate and predict take it; this does not"
        raise DataError(what, where=where, expected="a dataset with [centerlines]", fix=fix)
    return read(path)


def check(path: Path) -> list[Fault]:
    """Return every fault of the dataset whose folder or `dataset.toml` is `path`."""
    return check_all(path)[0]


def check_all(path: Path) -> tuple[list[Fault], list[ResultWarning]]:
    """Return all faults of a dataset, which prevent a fit, and all warnings, which do not."""
    found = inspect(path)
    return list(found.faults), list(found.warnings)
