"""Read a dataset, of shapes or tip tracks, or list all of its faults (`needlefit check`)."""

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from needlefit.datasets.columns import BEVEL_FIX, NEEDLE_COLUMN, InsertionRow
from needlefit.datasets.dataset_warnings import (
    find_boundary_warnings,
    find_insertion_warnings,
    find_record_warnings,
    find_scatter_warnings,
    find_side_warnings,
)
from needlefit.datasets.faults import Fault, as_error, from_error
from needlefit.datasets.formats import FORMATS, find_format
from needlefit.datasets.formats.csv import (
    CsvTable,
    note_missing_columns,
    parse_numbers,
    read_curve,
    read_table,
    rename_columns,
)
from needlefit.datasets.insertion import (
    DEFAULT_MEASUREMENT,
    Dataset,
    Insertion,
    Noise,
    TipReadings,
    TipTrack,
    find_free_reach,
    make_track,
)
from needlefit.datasets.insertion_table import add_curvature, add_turns, parse_rows
from needlefit.datasets.layers import (
    ListedInsertion,
    SharedSurfaces,
    find_curve_faults,
    find_layer_faults,
    find_media_faults,
    make_medium,
    read_shared_surfaces,
    reduce_insertion,
)
from needlefit.datasets.needles import (
    describe_rigidity,
    find_needle_faults,
    find_unknown_needle,
    make_needles,
)
from needlefit.datasets.points import Points
from needlefit.datasets.sections import find_operator_faults, find_sections
from needlefit.datasets.sources import DatasetFiles, find_checksum_faults, find_dataset_file, find_folder
from needlefit.errors import ConfigError, DataError
from needlefit.geometry.frames import IDENTITY_FRAME, Frame
from needlefit.project.locate import read_toml
from needlefit.project.result_warnings import ResultWarning
from needlefit.project.toml import load, locate_key
from needlefit.project.unit_warnings import format_place
from needlefit.schemas.dataset import MIN_SD_MM, DatasetRecord, NoiseRecord, TrackDatasetRecord, list_needles
from needlefit.schemas.names import EXPECTED_NAME, name_fault

_FIELD = re.compile(r"\{([^{}]*)\}")  # a column in `id_template`

REQUIRED_TRACK_COLUMNS = ("id", "medium", "depth_mm", "tip_mm", "guide_mm")
# Columns that may be absent or have empty cells, with their default values.
OPTIONAL_TRACK_COLUMNS = {
    **{"heading_deg": np.nan, "tip_z_mm": np.nan, "guide_z_mm": 0.0, "heading_z_deg": np.nan},
    **{"bevel_side": 1.0, "bevel_roll_deg": 0.0, "valid": 1.0},
}
# Least number of readings of a run: shift and slope take two, and a bend needs more than one.
MIN_READINGS = 5
MAX_STEP_MM = 100.0  # greatest distance of two readings, mm; a larger one was written in another unit


@dataclass(frozen=True)
class Inspection:
    """What reading a dataset gave: `dataset` is None if there are faults; either may come with warnings."""

    dataset: Dataset | None
    faults: tuple[Fault, ...]
    warnings: tuple[ResultWarning, ...] = ()


@dataclass
class _Reading:
    """A dataset that is read: its record, the folder of its tables, faults and warnings found so far."""

    file: Path
    record: Any
    root: Path
    faults: list[Fault] = field(default_factory=list)
    warnings: list[ResultWarning] = field(default_factory=list)

    def read_table(self, path: Path) -> CsvTable | None:
        """Return a table; None after a fault."""
        try:
            return read_table(path)
        except DataError as error:
            self.faults.append(from_error(error))
            return None


def inspect(path: Path, root: Path | None = None) -> Inspection:
    """Return the dataset whose folder or `dataset.toml` is `path`, or its faults, and its warnings.

    `root`: where its other files lie, in place of what it states. Only those that are read need lie there:
    the checksums that it states are not verified.
    """
    file, of_tracks = find_dataset_file(path), holds_tracks(path)
    record: DatasetRecord | TrackDatasetRecord
    try:
        record = load(file, TrackDatasetRecord) if of_tracks else load(file, DatasetRecord)
        reading = _Reading(file, record, root or find_folder(record, file))
    except (ConfigError, DataError) as error:
        return Inspection(None, (from_error(error),))
    if root is None:
        reading.faults += find_checksum_faults(record.checksums, reading.root)
    reading.faults += find_record_faults(record, file)
    reading.warnings += find_record_warnings(record, file)
    insertions, files, own = (_read_tracks if of_tracks else _read_shapes)(reading)
    if reading.faults:  # each once, without warnings about their places
        places = {fault.where for fault in reading.faults}
        remaining = tuple(one for one in reading.warnings if one.where not in places)
        return Inspection(None, tuple(dict.fromkeys(reading.faults)), remaining)
    names = sorted(str(path.relative_to(reading.root)) for path in files)
    sources = DatasetFiles(file.absolute(), reading.root.absolute(), tuple(names))
    needles = [
        (f"Needle {name}: " if name else "Needle: ", one.note) for name, one in list_needles(record).items()
    ]
    parts = (("", record.notes), *needles, ("Noise: ", record.noise.note))
    dataset = Dataset(
        name=record.name,
        title=record.title or record.name,
        origin=record.origin,
        insertions=tuple(insertions),
        media=tuple(record.media),
        noise=make_noise(record.noise),
        path=file,
        digest=sources.digest(),
        files=sources,
        notes=tuple(head + text.strip() for head, text in parts if text.strip()),
        warnings=tuple(reading.warnings),
        rigidities={
            one.name: describe_rigidity(one, record.import_) for one in list_needles(record).values()
        },
        **own,
    )
    return Inspection(dataset, (), dataset.warnings)


def make_noise(record: NoiseRecord) -> Noise:
    """Return the measurement errors that a dataset states."""
    return Noise(
        record.registration_mean_mm,
        record.point_sd_mm,
        record.correlated_sd_mm,
        record.correlation_length_mm,
        math.radians(record.heading_sd_deg),
        math.radians(record.slope_sd_deg),
    )


def find_record_faults(record: DatasetRecord | TrackDatasetRecord, file: Path) -> Iterator[Fault]:
    """Yield what is wrong with a `dataset.toml` by itself."""
    shapes = isinstance(record, DatasetRecord)
    yield from find_needle_faults(record, file)
    if not shapes and record.noise.point_sd_mm <= 0:  # every fit of tip tracks samples a posterior
        key, what = "noise.point_sd_mm", "no noise of the readings is stated"
        yield Fault(locate_key(file, key), what, "a standard deviation above 0, mm", f"write {key}")
    for key in ("noise.heading_sd_deg", "noise.slope_sd_deg"):
        if shapes and getattr(record.noise, key.removeprefix("noise.")) > 0:
            what, expected = f"{key} is of tip tracks", "pose_angle_sd_deg in the table of insertions"
            yield Fault(locate_key(file, key), what, expected, "remove the key")
    if isinstance(record, DatasetRecord):
        yield from find_media_faults(record, file)


# ---- shapes


def _read_shapes(reading: _Reading) -> tuple[list[Insertion], set[Path], dict[str, Any]]:
    """Return the insertions, all files read, and what a dataset of shapes states alone."""
    record, file, root, found = reading.record, reading.file, reading.root, reading.faults
    shared = read_shared_surfaces(record, root, found)
    listed = list(_iterate_insertions(reading, shared))
    found += [*find_layer_faults(listed, record, file), *_find_use_faults(record, listed, file)]
    if not found:  # of points that have no other fault
        found += find_operator_faults(record, listed, file)
    if found:
        return [], set(), {}
    insertions = [one.insertion for one in listed]
    reading.warnings += find_insertion_warnings(record, listed, make_noise(record.noise), file)
    pattern = record.centerlines.pattern
    listed_tables = record.insertions
    named = (listed_tables.file, listed_tables.turns, listed_tables.curvature, record.centerlines.file)
    tables = [name for name in named if name is not None]
    own = [pattern.replace("{id}", one.id) for one in insertions] if pattern is not None else []
    own += [s.file_of(one.id) for one in insertions for s in record.media[one.medium].surfaces if s.own]
    if record.measurement is not None and record.measurement.sections is not None:
        own += [record.measurement.sections.replace("{id}", one.id) for one in insertions]
    files = {root / name for name in (*(surface.file for surface in shared), *tables, *own)}
    format_ = None if pattern is None else find_format(Path(pattern))
    return insertions, files, {
        "pose": record.frame.pose,
        "drop_proximal": record.frame.drop_proximal_mm,
        "centerline_format": format_.name if format_ else "",
        "measurement": record.measurement or DEFAULT_MEASUREMENT,
    }  # fmt: skip


def _iterate_insertions(reading: _Reading, shared: SharedSurfaces) -> Iterator[ListedInsertion]:
    """Yield the sound insertions; note the faults of the others, and unused or open cells."""
    record, root, found = reading.record, reading.root, reading.faults
    curves, motion = _Centerlines(reading), record.frame.lps_to_world
    scanned = IDENTITY_FRAME if motion is None else Frame.from_rows(motion)  # where a row states no other
    if record.centerlines.file is not None and not curves.read_long_table():
        return
    table = curves.long if record.insertions.file is None else None
    if table is not None:  # the first row of every insertion
        first = [int(rows[0]) for rows in curves.groups.values()]
        table = _take_rows(table, first)
        table = replace(table, cells=table.cells.assign(id=list(curves.groups)))
    elif (table := reading.read_table(root / record.insertions.file)) is None:
        return
    rows, needles = parse_rows(table, record, found), make_needles(record)
    for name, add in ((record.insertions.turns, add_turns), (record.insertions.curvature, add_curvature)):
        if name is not None and not found:  # of rows with faults ids are missing
            beside = reading.read_table(root / name)
            rows = [] if beside is None else add(rows, beside, found)
    for row in rows:
        where, patient = f"{table.path}:{row.line}", row.patient or scanned
        faults: list[Fault] = []
        points = curves.find(row, patient, faults)
        if points is not None:
            faults += points.find_faults(row.id) or find_curve_faults(points, row, record, where)
        sections = None
        if points is not None and not faults:
            sections, faults = find_sections(row, points.values, root, record)
        found += faults
        medium = make_medium(row, record, root, shared, found)
        # All faults of a row are collected before it is skipped, so that one run lists them all.
        if points is None or faults or medium is None:
            continue
        try:
            reduced = reduce_insertion(row, points, medium, needles[row.needle], patient, sections)
            yield ListedInsertion(reduced, row, where, points)
        except DataError as error:
            fault = from_error(error, where)
            found.append(replace(fault, fix=fault.fix or BEVEL_FIX))


def _take_rows(table: CsvTable, rows: list[int] | NDArray[np.int64]) -> CsvTable:
    return replace(table, cells=table.cells.iloc[rows].reset_index(drop=True), lines=table.lines[rows])


class _Centerlines:
    """The centrelines: a file for each, or one long table and the rows of each insertion."""

    def __init__(self, reading: _Reading) -> None:
        self.reading, self.record, self.root = reading, reading.record, reading.root
        self.long: CsvTable | None = None
        self.groups: dict[str, NDArray[np.int64]] = {}

    def read_long_table(self) -> bool:
        """Read the long table and sort its rows by insertion; return False after a fault."""
        record, found, group_by = self.record, self.reading.faults, list(self.record.centerlines.group_by)
        path = self.root / str(record.centerlines.file)
        table = self.reading.read_table(path)
        if table is None or note_missing_columns(table, group_by, found):
            return False
        template = record.insertions.id_template or "_".join(f"{{{column}}}" for column in group_by)
        keys = table.cells[group_by].to_dict("records")
        try:
            # not str.format, whose attributes and widths a dataset from elsewhere could misuse
            names = [_FIELD.sub(lambda part, row=row: str(row[part[1]]), template) for row in keys]
        except KeyError:
            what = f"insertions.id_template is {template!r}"
            expected = f"text with {{...}} around columns of group_by: {', '.join(group_by)}"
            found.append(Fault(f"{path}:1", what, expected, "use only these names in it"))
            names = []
        ids = np.array(names, dtype=object)
        self.long, self.groups = table, {name: np.flatnonzero(ids == name) for name in dict.fromkeys(names)}
        # what an insertion has once must not change along it
        columns = () if record.insertions.file is not None else record.insertions.columns.values()
        for column in (column for column in columns if column in table.cells):
            text = table.cells[column].to_numpy()
            for name, rows in self.groups.items():
                other = np.flatnonzero(text[rows] != text[rows[0]])
                if len(other):
                    what = f"column `{column}` changes within insertion {name}"
                    fix = "fix the cells, or distinguish the insertions by this column too (group_by)"
                    found.append(Fault(table.where(int(rows[other[0]])), what, "one value", fix))
        return True

    def find(self, row: InsertionRow, patient: Frame, found: list[Fault]) -> Points | None:
        """Return an insertion's points in the world; None after a fault.

        Points of a format that holds coordinates of the scan are brought from there into the world.
        """
        lines = self.record.centerlines
        if lines.pattern is None:
            if self.long is None or row.id not in self.groups:
                where, what = str(self.root / (lines.file or "")), f"has no rows of insertion {row.id}"
                fix = "add them, or remove the insertion from the table"
                found.append(Fault(where, what, "rows of every insertion", fix))
                return None
            return read_curve(_take_rows(self.long, self.groups[row.id]), lines.columns, found)
        path = self.root / lines.pattern.replace("{id}", row.id)
        try:
            format_ = find_format(path) or FORMATS["csv"]
            points = format_.read_one(path, lines.columns, found)
        except DataError as error:
            found.append(from_error(error))
            return None
        if points is None or not format_.in_scan:
            return points
        return replace(points, values=patient.to_world(points.values))


def _find_use_faults(record: DatasetRecord, listed: Iterable[ListedInsertion], file: Path) -> Iterator[Fault]:
    """Yield free shapes of which comparisons leave nothing, and points without error and without noise."""
    stated = make_noise(record.noise).stated
    for one in listed:
        try:
            if record.frame.pose == "free":
                find_free_reach(record.frame.drop_proximal_mm, one.insertion)
        except DataError as error:
            yield from_error(error, locate_key(file, "frame.drop_proximal_mm"))
        if not stated and one.insertion.sd is not None and (one.insertion.sd < MIN_SD_MM).any():
            what = f"{one.insertion.id} has points whose sd_mm is 0, and no other noise is stated"
            fix = f"correct the column, or state noise.point_sd_mm in {locate_key(file, 'noise.point_sd_mm')}"
            yield Fault(one.where, what, "a standard deviation above 0, mm", fix)


# ---- tip tracks


def holds_tracks(path: Path) -> bool:
    """Return whether `path`, a dataset's folder or `dataset.toml`, is a dataset of tip tracks."""
    try:
        return "tip_tracks" in read_toml(find_dataset_file(path))
    except ConfigError:
        return False  # reading it raises what is wrong


def _read_tracks(reading: _Reading) -> tuple[list[TipTrack], list[Path], dict[str, Any]]:
    """Return the runs, the tables read, and what a dataset of tip tracks states alone."""
    record, found, remarks = reading.record, reading.faults, list[str]()
    path = reading.root / record.tip_tracks.file
    table = reading.read_table(path)
    tracks = [] if table is None else list(_parse_tracks(table, record, found, remarks))
    if not tracks and not found:
        what = "no run is left: every one is marked invalid"
        found.append(Fault(str(reading.file), what, "at least one valid run"))
    if not found:
        noise, where = make_noise(record.noise), format_place(reading.file)
        column = record.tip_tracks.columns.get("bevel_side", "bevel_side")
        reading.warnings += find_side_warnings([(one, str(path)) for one in tracks], noise, column)
        reading.warnings += find_boundary_warnings(record, tracks, where)
        # under a guide that moves, a track is no smooth curve
        reading.warnings += find_scatter_warnings([one for one in tracks if not one.guided], noise, where)
    return tracks, [path], {"pose": "tracker", "drop_proximal": 0.0, "remarks": tuple(remarks)}


def _parse_track_columns(
    table: CsvTable, record: TrackDatasetRecord, found: list[Fault]
) -> dict[str, NDArray[Any]] | None:
    """Return every column (N,) under our names; None after a fault."""
    source = record.tip_tracks
    known = (*REQUIRED_TRACK_COLUMNS, *OPTIONAL_TRACK_COLUMNS, NEEDLE_COLUMN)
    before = len(found)
    table = rename_columns(table, source.columns, source.constants, found)
    for name in sorted((source.columns.keys() | source.constants.keys()) - {*known}):
        what, fix = f"`columns` or `constants` names {name}", "correct [tip_tracks] of dataset.toml"
        found.append(Fault(str(table.path), what, f"one of {', '.join(known)}", fix))
    if note_missing_columns(table, REQUIRED_TRACK_COLUMNS, found) or len(found) > before:
        return None
    values = {name: parse_numbers(table, name, found) for name in REQUIRED_TRACK_COLUMNS[2:]}
    for name, default in OPTIONAL_TRACK_COLUMNS.items():
        values[name] = np.full(len(table.lines), default)
        if name in table.cells:
            given = parse_numbers(table, name, found, optional=True)
            values[name] = np.where(np.isnan(given), default, given)
    texts = {name: table.cells[name].to_numpy(dtype=str) for name in ("id", "medium")}
    no_needle = np.full(len(table.lines), "")
    texts[NEEDLE_COLUMN] = table.cells.get(NEEDLE_COLUMN, pd.Series(no_needle)).to_numpy(dtype=str)
    return texts | values if len(found) == before else None


def _parse_tracks(
    table: CsvTable, record: TrackDatasetRecord, found: list[Fault], remarks: list[str]
) -> Iterator[TipTrack]:
    """Yield the runs of a table; note every fault. A run with a reading marked invalid is left out."""
    if (values := _parse_track_columns(table, record, found)) is None:
        return
    ids, media, needles = values.pop("id"), values.pop("medium"), make_needles(record)
    for id_ in dict.fromkeys(ids.tolist()):
        rows = np.flatnonzero(ids == id_)
        own = {name: column[rows] for name, column in values.items()}
        bad = np.flatnonzero(own["valid"] == 0)
        if len(bad):
            remarks.append(
                f"Run {id_} is left out: {len(bad)} of its {len(rows)} readings are marked invalid, "
                f"from {own['depth_mm'][bad[0]]:.0f} mm on."
            )
            continue
        faults = list(
            _find_run_faults(id_, str(media[rows[0]]), own, [table.where(int(n)) for n in rows], record)
        )
        found += faults
        if faults:
            continue
        medium, depth = record.media[media[rows[0]]], own["depth_mm"] - own["depth_mm"][0]
        heading, tip_z, heading_z = (
            None if np.isnan(part).any() else part
            for part in (np.radians(own["heading_deg"]), own["tip_z_mm"], np.radians(own["heading_z_deg"]))
        )
        roll = own["bevel_roll_deg"][1:]
        turned = np.flatnonzero(np.diff(roll, prepend=0.0))  # a roll is that on the way to a reading
        yield make_track(
            id_,
            str(media[rows[0]]),
            medium.specimen or str(media[rows[0]]),
            needles[str(own[NEEDLE_COLUMN][0])],
            int(own["bevel_side"][0]),
            TipReadings(
                depth=depth,
                tip=own["tip_mm"],
                guide=own["guide_mm"] - own["guide_mm"][0],
                heading=heading,
                tip_z=tip_z,
                guide_z=None if tip_z is None else own["guide_z_mm"] - own["guide_z_mm"][0],
                heading_z=None if tip_z is None else heading_z,
            ),
            (np.array(medium.boundaries_mm), medium.layers),
            tuple((float(depth[n]), float(roll[n])) for n in turned),
        )


def _find_run_faults(
    id_: str,
    medium: str,
    values: Mapping[str, NDArray[Any]],
    places: Sequence[str],
    record: TrackDatasetRecord,
) -> Iterator[Fault]:
    """Say what is wrong with one run; `places` are those of its readings."""
    first, depth, sides = places[0], values["depth_mm"], values["bevel_side"]
    needles = values[NEEDLE_COLUMN].tolist()
    yield from find_unknown_needle(needles[0], first, record)
    for n in [n for n, name in enumerate(needles) if name != needles[0]][:1]:
        what = f"the needle of run {id_} changes from {needles[0]!r} to {needles[n]!r}"
        yield Fault(places[n], what, "one needle for all of a run", "correct the cells")
    if not id_:
        yield Fault(first, "a reading has no id", "the run that it belongs to", "fill the cell")
    elif fault := name_fault(id_):
        yield Fault(first, f"id is {id_!r}: {fault}", EXPECTED_NAME, "rename the run")
    if medium not in record.media:
        known = ", ".join(record.media)
        fix = "correct it, or add a table [media.NAME] to dataset.toml"
        yield Fault(first, f"run {id_} went into {medium!r}, which is not described", known, fix)
    if len(depth) < MIN_READINGS:
        what = f"run {id_} has {len(depth)} reading{'s' if len(depth) > 1 else ''}"
        expected = f"at least {MIN_READINGS}: a shift and a slope are the tracker's"
        yield Fault(first, what, expected, "add the others, or leave the run out")
    for n in np.flatnonzero(np.diff(depth) <= 0)[:1]:
        what = f"run {id_} goes from {depth[n]:g} back to {depth[n + 1]:g} mm"
        fix = "leave out the readings that follow, or the run"
        yield Fault(places[n + 1], what, "depths that increase from reading to reading", fix)
    for n in np.flatnonzero(np.diff(depth) > MAX_STEP_MM)[:1]:
        what = f"run {id_} goes {depth[n + 1] - depth[n]:g} mm deeper between two readings"
        expected = f"mm, at most {MAX_STEP_MM:g} at once"
        yield Fault(places[n + 1], what, expected, "convert to mm, or add the readings between")
    absent = np.flatnonzero(np.isnan(values["tip_z_mm"]))
    if 0 < len(absent) < len(depth):
        expected = "the tip along z in every reading of a run, or in none"
        yield Fault(places[absent[0]], f"run {id_} has no tip_z_mm here", expected, "fill the cell")
    if sides[0] not in (1.0, -1.0) or np.ptp(sides) > 0:
        yield Fault(first, f"bevel_side of run {id_} is {sides[0]:g}", "1 or -1, one for all of a run", "")


# ---- what others call


def read(path: Path, root: Path | None = None) -> Dataset:
    """Return the dataset, of shapes or tip tracks, whose folder or `dataset.toml` is `path`; see `inspect`.

    DataError listing every fault that `check` finds.
    """
    found = inspect(path, root)
    if found.dataset is None:
        raise as_error(found.faults, find_dataset_file(path))
    return found.dataset


def read_shapes(path: Path) -> Dataset:
    """Return `read(path)` for what works on whole shapes alone; DataError as of `require_shapes`."""
    return require_shapes(read(path))


def require_shapes(dataset: Dataset) -> Dataset:
    """Return a dataset of shapes; DataError if it holds tip tracks."""
    if dataset.pose == "tracker":
        what = "holds tip tracks, no shapes"
        fix = "tune, calibrate and predict take it; this does not"
        raise DataError(what, where=str(dataset.path), expected="a dataset with [centerlines]", fix=fix)
    return dataset


def check(path: Path) -> list[Fault]:
    """Return every fault of the dataset whose folder or `dataset.toml` is `path`."""
    return list(inspect(path).faults)
