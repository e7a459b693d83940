"""Read a dataset, of shapes or tip tracks, or list all of its faults (`needlefit check`)."""

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from needlefit.datasets.checks import check_insertions
from needlefit.datasets.columns import BEVEL_FIX, InsertionRow
from needlefit.datasets.digests import digest_insertion
from needlefit.datasets.faults import Fault, as_error, note_fault
from needlefit.datasets.formats import FORMATS, find_format
from needlefit.datasets.formats.csv import CsvTable, note_missing_columns, read_curve, read_table
from needlefit.datasets.insertion import DEFAULT_MEASUREMENT, Dataset, Insertion, Noise, find_free_reach
from needlefit.datasets.insertion_table import add_curvature, add_turns, parse_rows
from needlefit.datasets.layers import (
    Checked,
    ListedInsertion,
    SharedSurfaces,
    find_curve_faults,
    find_layer_faults,
    find_length_faults,
    find_media_faults,
    make_medium,
    read_shared_surfaces,
    reduce_insertion,
)
from needlefit.datasets.needle_warnings import find_copy_warnings, find_side_warnings
from needlefit.datasets.needles import describe_rigidity, find_needle_faults, make_needles
from needlefit.datasets.observations import expects_shape, find_faults, name_observation, place_points
from needlefit.datasets.observations.tip_track import parse_tracks
from needlefit.datasets.points import Points
from needlefit.datasets.record_warnings import (
    PLACEHOLDER,
    find_boundary_warnings,
    find_record_warnings,
    read_assumed,
)
from needlefit.datasets.scatter import find_scatter_warnings, mark_interpolated
from needlefit.datasets.sections import find_operator_faults, find_sections
from needlefit.datasets.sources import DatasetFiles, find_checksum_faults, find_dataset_file, find_folder
from needlefit.errors import ConfigError, DataError
from needlefit.geometry.frames import IDENTITY_FRAME, Frame
from needlefit.project import toml
from needlefit.project.folders import sha256
from needlefit.project.locate import read_toml
from needlefit.project.result_warnings import ResultWarning
from needlefit.project.toml import locate_key
from needlefit.project.unit_warnings import format_place
from needlefit.schemas.dataset import MIN_SD_MM, DatasetRecord, NoiseRecord

_FIELD = re.compile(r"\{([^{}]*)\}")  # pattern of a column in `id_template`


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
    assumed: Mapping[str, str]  # what its import assumed, by key
    faults: list[Fault] = field(default_factory=list)
    warnings: list[ResultWarning] = field(default_factory=list)

    def read_table(self, path: Path) -> CsvTable | None:
        """Return a table; None after a fault."""
        try:
            return read_table(path)
        except DataError as error:
            self.faults.append(error)
            return None


def inspect(path: Path, root: Path | None = None) -> Inspection:
    """Return the dataset whose folder or `dataset.toml` is `path`, or its faults, and its warnings.

    `root`: where its other files lie, in place of what it states. Only those that are read need lie there:
    the checksums that it states are not verified.
    """
    file = find_dataset_file(path)
    try:
        record = load_record(file)
        folder = root or find_folder(record, file)
    except (ConfigError, DataError) as error:
        return Inspection(None, (error,))
    reading = _Reading(file, record, folder, read_assumed(record, file))
    if root is None:
        reading.faults += find_checksum_faults(record.checksums, reading.root)
    reading.faults += find_record_faults(record, file)
    reading.warnings += find_record_warnings(record, file, reading.assumed)
    insertions, files, tables = list[Insertion](), set[Path](), dict[str, Any]()
    if record.lists_insertions:
        insertions, files, tables = _read_shapes(reading)
    remarks = list[str]()
    if record.tip_tracks is not None:
        tracks, table = _read_tracks(reading, remarks)
        _find_double_ids(insertions, tracks, table, reading)
        insertions, files = [*insertions, *tracks], {*files, table}
    if reading.faults:  # each once, without warnings about their places
        places = {fault.where for fault in reading.faults}
        remaining = tuple(warning for warning in reading.warnings if warning.where not in places)
        return Inspection(None, tuple({str(fault): fault for fault in reading.faults}.values()), remaining)
    names = sorted(str(path.relative_to(reading.root)) for path in files)
    sources = DatasetFiles(file.absolute(), reading.root.absolute(), tuple(names))
    needles = [
        (f"Needle {name}: " if name else "Needle: ", needle_record.note)
        for name, needle_record in record.all_needles.items()
    ]
    parts = (("", record.notes), *needles, ("Noise: ", record.noise.note))
    dataset = Dataset(
        name=record.name,
        title=record.name if not record.title or PLACEHOLDER in record.title else record.title,
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
            needle_record.name: describe_rigidity(needle_record, reading.assumed)
            for needle_record in record.all_needles.values()
        },
        pose=record.frame.pose,
        drop_proximal=record.frame.drop_proximal_mm,
        remarks=tuple(remarks),
        **tables,
    )
    return Inspection(dataset, (), dataset.warnings)


def load_record(file: Path) -> DatasetRecord:
    """Return a `dataset.toml`."""
    return toml.check(read_toml(file), DatasetRecord, file)


def make_noise(record: NoiseRecord) -> Noise:
    """Return the measurement errors that a dataset states."""
    return Noise(
        record.registration_mean_mm,
        record.point_sd_mm,
        record.correlated_sd_mm,
        record.correlation_length_mm,
        math.radians(record.heading_sd_deg),
        math.radians(record.slope_sd_deg),
        math.radians(record.session_slope_sd_deg),
    )


def find_record_faults(record: DatasetRecord, file: Path) -> Iterator[Fault]:
    """Yield what is wrong with a `dataset.toml` by itself."""
    of_tracks = record.tip_tracks is not None
    yield from find_needle_faults(record, file)
    # every fit of tip tracks samples a posterior; every study places further runs by their slopes
    for key, unit in {"point_sd_mm": "mm", "slope_sd_deg": "degrees"}.items():
        if of_tracks and getattr(record.noise, key) <= 0:
            yield DataError(
                f"{key} is not stated, which tip tracks need",
                expected=f"a standard deviation above 0, {unit}",
                fix=f"write noise.{key}",
                where=locate_key(file, f"noise.{key}"),
            )
    for key in ("noise.heading_sd_deg", "noise.slope_sd_deg"):
        if not of_tracks and getattr(record.noise, key.removeprefix("noise.")) > 0:
            yield DataError(
                f"{key} is of tip tracks",
                expected="pose_angle_sd_deg in the table of insertions",
                fix="remove the key",
                where=locate_key(file, key),
            )
    yield from find_media_faults(record, file)


# ---- shapes


def _read_shapes(reading: _Reading) -> tuple[list[Insertion], set[Path], dict[str, Any]]:
    """Return the insertions, all files read, and what a dataset of shapes states alone."""
    record, file, root, faults = reading.record, reading.file, reading.root, reading.faults
    shared = read_shared_surfaces(record, root, faults)
    listed = list(_iterate_insertions(reading, shared))
    depth_column = record.insertions.columns.get("depth_mm", "depth_mm")
    faults += find_length_faults(listed, record.frame.pose, depth_column)
    faults += [*find_layer_faults(listed, record, file), *_find_use_faults(record, listed, file)]
    if not faults:  # of points that have no other fault
        faults += find_operator_faults(record, [entry for entry in listed if entry.is_curve], file)
    if faults:
        return [], set(), {}
    if record.measurement is None or record.measurement.operator == "none":
        listed = mark_interpolated(listed, make_noise(record.noise))
    insertions = [entry.insertion for entry in listed]
    noise = make_noise(record.noise)
    checked = Checked(record, listed, noise, format_place(file), reading.assumed)
    reading.warnings += check_insertions(checked)
    lines, listed_tables = record.centerlines, record.insertions
    pattern, long = (None, None) if lines is None else (lines.pattern, lines.file)
    named = (listed_tables.file, listed_tables.turns, listed_tables.curvature, long)
    tables = [name for name in named if name is not None]
    curves = [entry.insertion.id for entry in listed if entry.is_curve]
    own_files = [pattern.replace("{id}", id_) for id_ in curves] if pattern is not None else []
    own_files += [
        s.file_of(insertion.id)
        for insertion in insertions
        for s in record.media[insertion.medium].surfaces
        if s.own
    ]
    if record.measurement is not None and record.measurement.sections is not None:
        own_files += [record.measurement.sections.replace("{id}", id_) for id_ in curves]
    files = {root / name for name in (*(surface.file for surface in shared), *tables, *own_files)}
    format_ = None if pattern is None else find_format(Path(pattern))
    return insertions, files, {
        "centerline_format": format_.name if format_ else "",
        "measurement": record.measurement or DEFAULT_MEASUREMENT,
    }  # fmt: skip


def _iterate_insertions(reading: _Reading, shared: SharedSurfaces) -> Iterator[ListedInsertion]:
    """Yield the sound insertions; note the faults of the others, and unused or open cells."""
    record, root, all_faults = reading.record, reading.root, reading.faults
    curves = None if record.centerlines is None else _Centerlines(reading)
    motion = record.frame.lps_to_world
    scanned = IDENTITY_FRAME if motion is None else Frame.from_rows(motion)  # where a row states no other
    if curves is not None and record.centerlines.file is not None and not curves.read_long_table():
        return
    table = curves.long if curves is not None and record.insertions.file is None else None
    if curves is not None and table is not None:  # the first row of every insertion
        first = [int(rows[0]) for rows in curves.groups.values()]
        table = _take_rows(table, first)
        table = replace(table, cells=table.cells.assign(id=list(curves.groups)))
    elif (table := reading.read_table(root / record.insertions.file)) is None:
        return
    rows, needles = parse_rows(table, record, all_faults), make_needles(record)
    add_sensors = partial(add_curvature, needles=needles)
    for name, add in ((record.insertions.turns, add_turns), (record.insertions.curvature, add_sensors)):
        if name is not None and not all_faults:  # of rows with faults ids are missing
            beside = reading.read_table(root / name)
            rows = [] if beside is None else add(rows, beside, all_faults)
    hashed = cache(sha256)  # insertions share surfaces
    for row in rows:
        where, patient = f"{table.path}:{row.line}", row.patient or scanned
        faults: list[Fault] = []
        is_curve = curves is not None and curves.is_expected(row)
        row = replace(row, observation=name_observation(row, is_curve))
        if curves is None or not is_curve:
            faults += find_faults(row, where, record.frame.pose)
            row, points = (row, None) if faults else place_points(row, table.path)
        elif (points := curves.find(row, patient, faults)) is not None:
            faults += points.find_faults(row.id) or find_curve_faults(points, row, record, where)
            faults += find_faults(row, where, record.frame.pose) if row.tip_y is not None else ()
        sections = None
        if points is not None and is_curve and not faults:
            try:
                sections = find_sections(row, points.values, root, record)
            except (ConfigError, DataError) as error:
                faults.append(error)
        all_faults += faults
        medium = make_medium(row, record, root, shared, all_faults)
        # All faults of a row are collected before it is skipped, so that one run lists them all.
        if points is None or faults or medium is None:
            continue
        try:
            reduced = reduce_insertion(row, points, medium, needles[row.needle], patient, sections)
            surfaces = [hashed(root / s.file_of(row.id)) for s in record.media[row.medium].surfaces]
            digest = partial(digest_insertion, row, points, sections, record, surfaces)
            reduced = replace(reduced, digest=digest, where=where)
            yield ListedInsertion(reduced, row, where, points, is_curve)
        except DataError as error:
            all_faults.append(error.replace(where=error.where or where, fix=error.fix or BEVEL_FIX))


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
        record, faults, group_by = self.record, self.reading.faults, list(self.record.centerlines.group_by)
        path = self.root / str(record.centerlines.file)
        table = self.reading.read_table(path)
        if table is None or note_missing_columns(table, group_by, faults):
            return False
        template = record.insertions.id_template or "_".join(f"{{{column}}}" for column in group_by)
        keys = table.cells[group_by].to_dict("records")
        try:
            # not str.format, whose attributes and widths a dataset from elsewhere could misuse
            names = [_FIELD.sub(lambda part, row=row: str(row[part[1]]), template) for row in keys]
        except KeyError:
            note_fault(
                faults,
                f"{path}:1",
                f"insertions.id_template is {template!r}",
                f"text with {{...}} around columns of group_by: {', '.join(group_by)}",
                "use only these names in it",
            )
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
                    note_fault(
                        faults,
                        table.where(int(rows[other[0]])),
                        f"column `{column}` changes within insertion {name}",
                        "one value",
                        "fix the cells, or distinguish the insertions by this column too (group_by)",
                    )
        return True

    def is_expected(self, row: InsertionRow) -> bool:
        """Return whether an insertion has a centreline, or states nothing that stands in its place."""
        if expects_shape(row):
            return True
        pattern = self.record.centerlines.pattern
        return row.id in self.groups if pattern is None else self._name_file(row).is_file()

    def _name_file(self, row: InsertionRow) -> Path:
        """Return the file of an insertion where each has one."""
        return self.root / str(self.record.centerlines.pattern).replace("{id}", row.id)

    def find(self, row: InsertionRow, patient: Frame, faults: list[Fault]) -> Points | None:
        """Return an insertion's points in the world; None after a fault.

        Points of a format that holds coordinates of the scan are brought from there into the world.
        """
        lines = self.record.centerlines
        if lines.pattern is None:
            if self.long is None or row.id not in self.groups:
                note_fault(
                    faults,
                    self.root / (lines.file or ""),
                    f"has no rows of insertion {row.id}",
                    "rows of every insertion",
                    "add them, or remove the insertion from the table",
                )
                return None
            return read_curve(_take_rows(self.long, self.groups[row.id]), lines.columns, faults)
        path = self._name_file(row)
        try:
            format_ = find_format(path) or FORMATS["csv"]
            points = format_.read_one(path, lines.columns, faults)
        except DataError as error:
            faults.append(error)
            return None
        if points is None or not format_.in_scan:
            return points
        return replace(points, values=patient.to_world(points.values))


def _find_use_faults(record: DatasetRecord, listed: Iterable[ListedInsertion], file: Path) -> Iterator[Fault]:
    """Yield free shapes of which comparisons leave nothing, and points without error and without noise."""
    stated = make_noise(record.noise).stated
    for entry in listed:
        try:
            if record.frame.pose == "free":
                find_free_reach(record.frame.drop_proximal_mm, entry.insertion)
        except DataError as error:
            yield error.at(error.where or locate_key(file, "frame.drop_proximal_mm"))
        if not stated and entry.insertion.sd is not None and (entry.insertion.sd < MIN_SD_MM).any():
            yield DataError(
                f"{entry.insertion.id} has points whose sd_mm is 0, and no other noise is stated",
                expected="a standard deviation above 0, mm",
                fix=(
                    "correct the column, or state noise.point_sd_mm in "
                    f"{locate_key(file, 'noise.point_sd_mm')}"
                ),
                where=entry.where,
            )


# ---- tip tracks


def _read_tracks(reading: _Reading, remarks: list[str]) -> tuple[list[Insertion], Path]:
    """Return the runs, and their table; note which are left out."""
    record, faults = reading.record, reading.faults
    path, before = reading.root / record.tip_tracks.file, len(faults)
    table = reading.read_table(path)
    tracks = [] if table is None else list(parse_tracks(table, record, faults, remarks))
    if not tracks and len(faults) == before:
        faults.append(
            DataError(
                "no run is left: every one is marked invalid",
                expected="at least one valid run",
                where=reading.file,
            )
        )
    if not faults:
        noise, where = make_noise(record.noise), format_place(reading.file)
        column = record.tip_tracks.columns.get("bevel_side", "bevel_side")
        reading.warnings += find_side_warnings([(track, str(path)) for track in tracks], noise, column)
        reading.warnings += find_copy_warnings(
            [(track, str(path), track.centerline) for track in tracks], noise
        )
        reading.warnings += find_boundary_warnings(record, tracks, where)
        # under a guide that moves, a track is no smooth curve
        reading.warnings += find_scatter_warnings(
            [track for track in tracks if not track.guided], noise, where("noise.point_sd_mm")
        )
    return tracks, path


def _find_double_ids(
    insertions: Sequence[Insertion], tracks: Sequence[Insertion], table: Path, reading: _Reading
) -> None:
    """Note runs whose name an insertion of the other table has."""
    if double := sorted({insertion.id for insertion in insertions} & {track.id for track in tracks}):
        problem = f"run {double[0]} has the name of an insertion"
        reading.faults.append(
            DataError(problem, expected="names that are used once", fix="rename it", where=str(table))
        )


# ---- what others call


def read(path: Path, root: Path | None = None) -> Dataset:
    """Return the dataset whose folder or `dataset.toml` is `path`; see `inspect`.

    DataError listing every fault that `check` finds.
    """
    inspection = inspect(path, root)
    if inspection.dataset is None:
        raise as_error(inspection.faults, find_dataset_file(path))
    return inspection.dataset


def read_shapes(path: Path) -> Dataset:
    """Return `read(path)` for what works on whole shapes alone; DataError as of `require_shapes`."""
    return require_shapes(read(path))


def require_shapes(dataset: Dataset) -> Dataset:
    """Return a dataset of shapes; DataError if it holds tip tracks."""
    if any(insertion.in_tracker_frame for insertion in dataset.insertions):
        raise DataError(
            "holds tip tracks, no shapes",
            expected="a dataset with [centerlines]",
            fix="tune and predict take it; this does not",
            where=dataset.path,
        )
    return dataset


def check(path: Path) -> list[Fault]:
    """Return every fault of the dataset whose folder or `dataset.toml` is `path`."""
    return list(inspect(path).faults)
