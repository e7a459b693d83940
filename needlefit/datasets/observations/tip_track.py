"""Read tip tracks: a table with a row for each reading of a tip on its way, and the guide that was moved."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from needlefit.arrays import Floats, pad_axis
from needlefit.datasets.columns import HOLE_COLUMN, NEEDLE_COLUMN, POINT_SD_COLUMN, SETUP_COLUMN
from needlefit.datasets.digests import digest_track
from needlefit.datasets.faults import Fault, note_fault
from needlefit.datasets.formats.csv import CsvTable, note_missing_columns, parse_numbers, rename_columns
from needlefit.datasets.insertion import GuideMotion, Insertion
from needlefit.datasets.layers import MAX_HEADING_DEG
from needlefit.datasets.needles import find_unknown_needle, make_needles
from needlefit.datasets.observations import HeldObservation
from needlefit.errors import DataError
from needlefit.geometry.frames import IDENTITY_FRAME
from needlefit.mechanics.needle import Needle
from needlefit.schemas.dataset import DatasetRecord
from needlefit.schemas.names import EXPECTED_NAME, name_fault

REQUIRED_TRACK_COLUMNS = ("id", "medium", "depth_mm", "tip_mm", "guide_mm")
# Columns that may be absent or have empty cells, with their default values.
OPTIONAL_TRACK_COLUMNS = {
    **{"heading_deg": np.nan, "tip_z_mm": np.nan, "guide_z_mm": 0.0, "heading_z_deg": np.nan},
    **{"bevel_side": 1.0, "bevel_roll_deg": 0.0, "valid": 1.0, POINT_SD_COLUMN: np.nan},
}
# columns of names that are the same for all readings of a run
NAME_COLUMNS = (NEEDLE_COLUMN, SETUP_COLUMN, HOLE_COLUMN)
# smallest number of readings of a run: shift and slope take two, and a bend needs more than one. Fewer depths
# of one hole are insertions of their own at an import.
MIN_READINGS = 5
MAX_STEP_MM = 100.0  # largest distance of two readings (mm); a larger one was written in another unit


class TipReadings(NamedTuple):
    """The readings of a run."""

    depth: Floats  # (n,); inserted length at each reading, mm; of the first one 0 or more
    # (n, 1), or (n, 2) with z, right-handed with the depth; lateral place of the tip in the tracker's frame,
    # mm: known up to a shift and a slope
    tip: Floats
    # of the same size; lateral place of the guide on the way to each reading, mm, from where it stood at the
    # first.
    guide: Floats
    headings: tuple[Floats, ...] = ()  # (n,) each; directions of the tip as the tracker reports them, rad


def make_track(
    name: str,
    medium: str,
    specimen: str,
    needle: Needle,
    side: int,
    readings: TipReadings,
    layers: tuple[Floats, tuple[int, ...]],
    turns: tuple[tuple[float, float], ...] = (),
) -> Insertion:
    """Return a run whose bevel faces `side` (+1: toward greater tip), but for its `turns`.

    `layers` are the boundaries (m - 1,), mm, and the m layer numbers between them.
    """
    boundaries, sequence = layers
    directions = readings.tip.shape[1]
    tip, guide = (pad_axis(places, 2) for places in (readings.tip, readings.guide))
    before = count_before(readings.depth)
    points = np.column_stack([readings.depth, tip])
    return Insertion(
        id=name, medium=medium, specimen=specimen, needle=needle, layers=len(sequence),
        layers_alternative=len(sequence), depth=float(readings.depth[-1]), side=side,
        frame=IDENTITY_FRAME, pose_source="tracker", pose_shift_sd=0.0, pose_angle_sd=0.0,
        centerline=points, points=points,
        turns=turns, boundaries=boundaries, sequence=sequence, boundary_sd=0.0,
        guide=GuideMotion(np.pad(readings.depth, (before, 0)), *np.pad(guide, ((before, 0), (0, 0))).T),
        observation="tip_track", directions=directions,
        headings=readings.headings,
    )  # fmt: skip


def count_before(depth: Floats) -> int:
    """Return 1 if the needle was in the tissue at the first of the depths (n,), mm: it got there from 0."""
    return int(depth[0] > 0.0)


def _parse_track_columns(
    table: CsvTable, record: DatasetRecord, faults: list[Fault]
) -> dict[str, NDArray[Any]] | None:
    """Return every column (N,) under our names; None after a fault."""
    source = record.tip_tracks
    assert source is not None
    known_columns = (*REQUIRED_TRACK_COLUMNS, *OPTIONAL_TRACK_COLUMNS, *NAME_COLUMNS)
    before = len(faults)
    table = rename_columns(table, source.columns, source.constants, faults)
    for name in sorted((source.columns.keys() | source.constants.keys()) - {*known_columns}):
        note_fault(
            faults,
            table.path,
            f"`columns` or `constants` names {name}",
            f"one of {', '.join(known_columns)}",
            "correct [tip_tracks] of dataset.toml",
        )
    if note_missing_columns(table, REQUIRED_TRACK_COLUMNS, faults) or len(faults) > before:
        return None
    defaults = dict.fromkeys(REQUIRED_TRACK_COLUMNS[2:]) | OPTIONAL_TRACK_COLUMNS
    values = {name: parse_numbers(table, name, faults, default) for name, default in defaults.items()}
    names = (*REQUIRED_TRACK_COLUMNS[:2], *NAME_COLUMNS)
    cells = table.cells.reindex(columns=names, fill_value="")
    texts = {name: cells[name].to_numpy(dtype=str) for name in names}
    return texts | values if len(faults) == before else None


def parse_tracks(
    table: CsvTable, record: DatasetRecord, all_faults: list[Fault], remarks: list[str]
) -> Iterator[Insertion]:
    """Yield the runs of a table; note every fault. A run with a reading marked invalid is left out."""
    if (values := _parse_track_columns(table, record, all_faults)) is None:
        return
    ids, media, needles = values.pop("id"), values.pop("medium"), make_needles(record)
    for id_ in dict.fromkeys(ids.tolist()):
        rows = np.flatnonzero(ids == id_)
        run, medium = {name: column[rows] for name, column in values.items()}, str(media[rows[0]])
        bad = np.flatnonzero(run["valid"] == 0)
        if len(bad):
            remarks.append(
                f"Run {id_} is left out: {len(bad)} of its {len(rows)} readings are marked invalid, "
                f"from {run['depth_mm'][bad[0]]:.0f} mm on."
            )
            continue
        faults = list(_find_run_faults(id_, medium, run, [table.where(int(n)) for n in rows], record))
        all_faults += faults
        if faults:
            continue
        described, depth = record.media[medium], run["depth_mm"] - _find_zero(run["depth_mm"], record)
        tips = [run[name] for name in ("tip_mm", "tip_z_mm") if not np.isnan(run[name]).any()]
        guides, headings = (
            [run[name] for name in names[: len(tips)]]
            for names in (("guide_mm", "guide_z_mm"), ("heading_deg", "heading_z_deg"))
        )
        before = count_before(depth)
        starts, roll = np.pad(depth, (before, 0)), run["bevel_roll_deg"][1 - before :]
        turned = np.flatnonzero(np.diff(roll, prepend=0.0))  # a roll is that on the way to a reading
        track = make_track(
            id_,
            medium,
            described.specimen or medium,
            needles[str(run[NEEDLE_COLUMN][0])],
            int(run["bevel_side"][0]),
            TipReadings(
                depth,
                np.column_stack(tips),
                np.column_stack([guide - guide[0] for guide in guides]),
                tuple(np.radians(heading) for heading in headings if not np.isnan(heading).any()),
            ),
            (np.array(described.boundaries_mm or ()), described.sequence),
            tuple((float(starts[n]), float(roll[n])) for n in turned),
        )
        setup, hole = (str(run[name][0]) for name in NAME_COLUMNS[1:])
        sd = None if np.isnan(run[POINT_SD_COLUMN][0]) else float(run[POINT_SD_COLUMN][0])
        if sd is None:
            del run[POINT_SD_COLUMN]  # digests are those of tables without the column
        digest = partial(digest_track, medium, run, record)
        yield replace(track, setup=setup, hole=hole, point_sd=sd, digest=digest)


def _find_zero(depths: Floats, record: DatasetRecord) -> float:
    """Return the depth (mm), as a table counts it, of the surface of the tissue."""
    assert record.tip_tracks is not None
    return float(depths[0]) if record.tip_tracks.depth_zero == "first_reading" else 0.0


def _find_run_faults(
    id_: str,
    medium: str,
    values: Mapping[str, NDArray[Any]],
    places: Sequence[str],
    record: DatasetRecord,
) -> Iterator[Fault]:
    """Say what is wrong with one run; `places` are those of its readings."""
    first, depth, sides = places[0], values["depth_mm"], values["bevel_side"]
    yield from find_unknown_needle(str(values[NEEDLE_COLUMN][0]), first, record)
    for column in NAME_COLUMNS:
        names = values[column].tolist()
        for n in [n for n, name in enumerate(names) if name != names[0]][:1]:
            yield DataError(
                f"the {column} of run {id_} changes from {names[0]!r} to {names[n]!r}",
                expected=f"one {column} for all of a run",
                fix="correct the cells",
                where=f"{places[n]}",
            )
    if not id_:
        yield DataError(
            "a reading has no id", expected="the run that it belongs to", fix="fill the cell", where=first
        )
    elif fault := name_fault(id_):
        yield DataError(f"id is {id_!r}: {fault}", expected=EXPECTED_NAME, fix="rename the run", where=first)
    if medium not in record.media:
        yield DataError(
            f"run {id_} went into {medium!r}, which is not described",
            expected=", ".join(record.media),
            fix="correct it, or add a table [media.NAME] to dataset.toml",
            where=first,
        )
    if len(depth) < MIN_READINGS:
        yield DataError(
            f"run {id_} has {len(depth)} reading{'s' if len(depth) > 1 else ''}",
            expected=f"at least {MIN_READINGS}",
            fix="add the others, or leave the run out",
            where=first,
        )
    steps = np.diff(depth)
    if np.any(steps <= 0):
        n = int(np.argmin(steps))  # smaller steps back may be noise
        yield DataError(
            f"run {id_} goes from {depth[n]:g} back to {depth[n + 1]:g} mm",
            expected="depths that increase from reading to reading",
            fix="leave out the readings that follow, or the run; of several runs in one file name each in a "
            "column",
            where=f"{places[n + 1]}",
        )
    if depth[0] < _find_zero(depth, record):
        yield DataError(
            f"run {id_} begins at {depth[0]:g} mm",
            expected="depths of 0 or more, from the surface of the tissue",
            fix='correct them; or, if they are of a stage: depth_zero = "first_reading" of [tip_tracks]',
            where=first,
        )
    for n in np.flatnonzero(steps > MAX_STEP_MM)[:1]:
        yield DataError(
            f"run {id_} goes {depth[n + 1] - depth[n]:g} mm deeper between two readings",
            expected=f"mm, at most {MAX_STEP_MM:g} at once",
            fix="convert to mm, or add the readings between",
            where=f"{places[n + 1]}",
        )
    run, deflection = (abs(float(numbers[-1] - numbers[0])) for numbers in (depth, values["tip_mm"]))
    if deflection > np.sin(np.radians(MAX_HEADING_DEG)) * run:
        yield DataError(
            f"run {id_} deflects {deflection:.3g} mm on {run:.3g} mm",
            expected=f"at most {MAX_HEADING_DEG:g} degrees from its direction",
            fix="correct the column of its deflections, or their unit",
            where=first,
        )
    absent = np.flatnonzero(np.isnan(values["tip_z_mm"]))
    if 0 < len(absent) < len(depth):
        yield DataError(
            f"run {id_} has no tip_z_mm here",
            expected="the tip along z in every reading of a run, or in none",
            fix="fill the cell",
            where=f"{places[absent[0]]}",
        )
    if sides[0] not in (1.0, -1.0) or np.ptp(sides) > 0:
        yield DataError(
            f"bevel_side of run {id_} is {sides[0]:g}", expected="1 or -1, one for all of a run", where=first
        )


TIP_TRACK = HeldObservation("tip_track", "tips at depths, as tracked")
