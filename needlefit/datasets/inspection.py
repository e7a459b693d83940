"""Read and check all files of a dataset of shapes once; the result is the dataset, or all of its faults."""

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from needlefit.datasets.columns import InsertionRow
from needlefit.datasets.dataset_warnings import (
    find_centerline_column_warnings,
    find_insertion_column_warnings,
    find_insertion_warnings,
    find_placeholder_cells,
    find_record_warnings,
)
from needlefit.datasets.faults import Fault, from_error
from needlefit.datasets.formats import FORMATS, find_format
from needlefit.datasets.formats.csv import CsvTable, note_missing_columns, read_curve, read_table
from needlefit.datasets.insertion import (
    DEFAULT_MEASUREMENT,
    Dataset,
    Insertion,
    Noise,
    find_free_reach,
)
from needlefit.datasets.insertion_table import parse_rows
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
from needlefit.datasets.points import Points
from needlefit.datasets.sections import (
    find_centerline_faults,
    find_operator_faults,
    find_sections,
    locate_sections,
)
from needlefit.datasets.sources import compute_digest, find_checksum_faults, find_dataset_file, find_folders
from needlefit.errors import ConfigError, DataError
from needlefit.geometry.frames import IDENTITY_FRAME, Frame
from needlefit.mechanics.needle import Needle
from needlefit.project.input_files import is_file
from needlefit.project.result_warnings import ResultWarning
from needlefit.project.toml import load, locate_key
from needlefit.project.unit_warnings import likely_modulus
from needlefit.schemas.dataset import (
    MIN_SD_MM,
    DatasetRecord,
    FrameRecord,
    InsertionsRecord,
    NoiseRecord,
    TrackDatasetRecord,
)
from needlefit.schemas.scene import NeedleRecord


@dataclass(frozen=True)
class LongTable:
    """A table that holds many centrelines: the rows of each, by insertion id."""

    table: CsvTable
    groups: dict[str, np.ndarray]

    def part(self, rows: np.ndarray) -> CsvTable:
        """Return some of the rows as a new table."""
        return replace(
            self.table, cells=self.table.cells.iloc[rows].reset_index(drop=True), lines=self.table.lines[rows]
        )


def read_long_table(path: Path, record: DatasetRecord, found: list[Fault]) -> LongTable | None:
    """Read the long table and sort its rows by insertion; return None after a fault."""
    group_columns = list(record.centerlines.group_by)
    try:
        table = read_table(path)
    except DataError as error:
        found.append(from_error(error))
        return None
    if note_missing_columns(table, group_columns, found):
        return None
    names = _make_group_names(table.cells[group_columns], record.insertions.id_template, path, found)
    rows: dict[str, list[int]] = {}
    for row, name in enumerate(names):
        rows.setdefault(name, []).append(row)
    long = LongTable(table, {name: np.array(of_name) for name, of_name in rows.items()})
    _check_constant(long, record.insertions, found)
    return long


_FIELD = re.compile(r"\{([^{}]*)\}")
"""A column in `id_template`."""


def _make_group_names(keys: pd.DataFrame, template: str | None, path: Path, found: list[Fault]) -> list[str]:
    """Return every row's insertion id, from the template over the group columns."""
    template = template or "_".join(f"{{{column}}}" for column in keys)
    cells = [{str(k): str(v) for k, v in row.items()} for row in keys.to_dict("records")]
    try:
        # not str.format, whose attributes and widths a dataset from elsewhere could misuse
        return [_FIELD.sub(lambda field, row=row: row[field[1]], template) for row in cells]  # type: ignore[misc]
    except KeyError:
        what = f"insertions.id_template is {template!r}"
        expected = f"text with {{...}} around columns of group_by: {', '.join(map(str, keys))}"
        found.append(Fault(f"{path}:1", what, expected, "use only these names in it"))
        return []


def _check_constant(long: LongTable, record: InsertionsRecord, found: list[Fault]) -> None:
    """Note a column that should have one value for an insertion and has several."""
    if record.file is not None:
        return
    for column in record.columns.values():
        if column not in long.table.cells:
            continue
        text = long.table.cells[column]
        for name, rows in long.groups.items():
            other = np.flatnonzero((text.iloc[rows] != text.iloc[rows[0]]).to_numpy())
            if len(other):
                where = long.table.where(int(rows[other[0]]))
                what = f"column `{column}` changes within insertion {name}"
                fix = "fix the cells, or distinguish the insertions by this column too (group_by)"
                found.append(Fault(where, what, "one value", fix))


def find_points(
    row: InsertionRow, folder: Path, record: DatasetRecord, long: LongTable | None
) -> tuple[Points | None, list[Fault]]:
    """Return an insertion's points in the world (None after a fault) and the faults of their cells.

    Points of a format that holds coordinates of the scan are brought from there into the world.
    """
    found: list[Fault] = []
    lines = record.centerlines
    try:
        if lines.pattern is None:
            if long is None or row.id not in long.groups:
                return None, [
                    Fault(
                        str(folder / (lines.file or "")),
                        f"has no rows of insertion {row.id}",
                        "rows of every insertion",
                        "add them, or remove the insertion from the table",
                    )
                ]
            return read_curve(long.part(long.groups[row.id]), lines.columns, found), found
        path = folder / lines.pattern.replace("{id}", row.id)
        format_ = find_format(path) or FORMATS["csv"]
        points = format_.read_one(path, lines.columns, found)
        if points is None or (points := _require_finite(points, found)) is None:
            return None, found
        if format_.in_scan:
            patient = row.patient or make_patient_frame(record.frame)
            points = replace(points, values=patient.to_world(points.values))
        return points, found
    except DataError as error:
        return None, [*found, from_error(error)]


def make_patient_frame(record: FrameRecord) -> Frame:
    """Return the patient coordinates, as a frame in the world, of scans whose row states no others."""
    return IDENTITY_FRAME if record.lps_to_world is None else Frame.from_rows(record.lps_to_world)


def _require_finite(points: Points, found: list[Fault]) -> Points | None:
    bad = points.unusable()
    if len(bad) == 0:
        return points
    what = f"has {len(bad)} points that are NaN, infinite or too far away"
    found.append(Fault(points.where(int(bad[0])), what, "finite numbers, mm", "remove or fix these points"))
    return None


MAX_MODULUS_GPA = 1000.0
"""No needle is stiffer: tungsten carbide has 700 GPa, steel 200."""

BEVEL_FIX = "point bevel_x, bevel_y, bevel_z across the entry direction, or leave the three cells empty"


@dataclass(frozen=True)
class Inspection:
    """What reading a dataset gave: `dataset` is None if there are faults; either may come with warnings."""

    dataset: Dataset | None
    faults: tuple[Fault, ...]
    warnings: tuple[ResultWarning, ...] = ()


def inspect_dataset(path: Path) -> Inspection:
    """Read the dataset whose folder or `dataset.toml` is `path`, collecting every fault."""
    file = find_dataset_file(path)
    try:
        record = load(file, DatasetRecord)
        roots = find_folders(record, file)
    except (ConfigError, DataError) as error:
        return Inspection(None, (from_error(error),))
    found: list[Fault] = []
    for root in roots:
        found += find_checksum_faults(record.checksums, root)
    found += [*find_needle_faults(record.needle, file), *find_media_faults(record, file)]
    shared = read_shared_surfaces(record, roots[0], found)
    unused: list[ResultWarning] = []
    listed = [one for root in roots for one in _iterate_insertions(record, root, shared, found, unused)]
    found += find_repeated_ids("insertion", (one.insertion.id for one in listed), file)
    found += [*find_layer_faults(listed, record, file), *find_reach_faults(record, listed, file)]
    found += [*find_sd_faults(record, listed, file), *find_track_noise_faults(record, file)]
    if not found:  # of points that have no other fault
        found += find_operator_faults(record, listed, file)
    warnings = [*find_record_warnings(record, file), *unused]
    if found:
        return make_refusal(found, warnings)
    insertions = [one.insertion for one in listed]
    warnings += find_insertion_warnings(record, listed, make_noise(record.noise), file)
    files = {roots[0] / surface.file for surface in shared}
    for root in roots:
        files |= _list_files(record, root, insertions)
    pattern = record.centerlines.pattern
    format_ = None if pattern is None else find_format(Path(pattern))
    dataset = make_dataset(
        record,
        file,
        insertions,
        compute_digest(file, roots, files),
        pose=record.frame.pose,
        drop_proximal=record.frame.drop_proximal_mm,
        centerline_format=format_.name if format_ else "",
        measurement=record.measurement or DEFAULT_MEASUREMENT,
        warnings=tuple(warnings),
    )
    return Inspection(dataset, (), tuple(warnings))


def _iterate_insertions(
    record: DatasetRecord, root: Path, shared: SharedSurfaces, found: list[Fault], unused: list[ResultWarning]
) -> Iterator[ListedInsertion]:
    """Yield the sound insertions of one folder; note the faults of the others, and unused or open cells."""
    long = None
    if record.centerlines.file is not None:
        long = read_long_table(root / record.centerlines.file, record, found)
        if long is None:
            return
    table = _read_insertion_table(record, root, long, found)
    if table is None:
        return
    unused += find_insertion_column_warnings(record, map(str, table.cells.columns), table.path)
    unused += find_placeholder_cells(table)
    headers: set[tuple[str, ...]] = set()
    for row in parse_rows(table, record, found):
        where = f"{table.path}:{row.line}"
        points, faults = find_points(row, root, record, long)
        if points is not None:
            if points.columns not in headers:  # of files with the same header the first is named
                unused += find_centerline_column_warnings(record, points.columns, points.path)
            headers.add(points.columns)
            faults += find_curve_faults(points, row, record, where)
        sections, more = find_sections(row, root, record)
        faults += more
        if sections is not None and points is not None and not faults:
            faults += find_centerline_faults(
                sections, points.values, str(locate_sections(row.id, root, record))
            )
        found += faults
        medium = make_medium(row, record, root, shared, found)
        # All faults of a row are collected before it is skipped, so that one run lists them all.
        if points is None or faults or medium is None:
            continue
        try:
            patient = row.patient or make_patient_frame(record.frame)
            insertion = reduce_insertion(row, points, medium, patient, sections)
        except DataError as error:
            fault = from_error(error, where)
            found.append(replace(fault, fix=fault.fix or BEVEL_FIX))
            continue
        yield ListedInsertion(insertion, where)


def find_needle_faults(needle: NeedleRecord, file: Path) -> Iterator[Fault]:
    """Yield a fault if a needle's modulus was probably written in another unit."""
    modulus = needle.youngs_modulus_gpa
    if modulus is None or modulus <= MAX_MODULUS_GPA:
        return
    unit, in_gpa = likely_modulus(modulus)
    where = locate_key(file, "needle.youngs_modulus_gpa")
    what = f"needle.youngs_modulus_gpa is {modulus:g}{f': this looks like {unit}' if unit else ''}"
    expected = "GPa: about 200 for steel, 40 to 80 for nitinol"
    yield Fault(where, what, expected, f"write {in_gpa:.3g}" if unit else "write it in GPa")


def _read_insertion_table(
    record: DatasetRecord, root: Path, long: LongTable | None, found: list[Fault]
) -> CsvTable | None:
    """Return the table of insertions: its file, or the first rows of the groups of the long table."""
    if record.insertions.file is None:
        assert long is not None  # the record was checked: one of the two files is given
        first = [int(rows[0]) for rows in long.groups.values()]
        cells = long.table.cells.iloc[first].reset_index(drop=True).assign(id=list(long.groups))
        return replace(long.table, cells=cells, lines=long.table.lines[first])
    try:
        return read_table(root / record.insertions.file)
    except DataError as error:
        found.append(from_error(error))
        return None


def find_reach_faults(
    record: DatasetRecord, listed: Iterable[ListedInsertion], file: Path
) -> Iterator[Fault]:
    """Yield the free shapes that are no longer than the length left out of every comparison."""
    if record.frame.pose != "free":
        return
    for one in listed:
        try:
            find_free_reach(record.frame.drop_proximal_mm, one.insertion)
        except DataError as error:
            yield from_error(error, locate_key(file, "frame.drop_proximal_mm"))


def find_sd_faults(record: DatasetRecord, listed: Iterable[ListedInsertion], file: Path) -> Iterator[Fault]:
    """Yield the curves with points whose stated error is 0, if the dataset states no other noise."""
    if make_noise(record.noise).stated:
        return
    for one in listed:
        if one.insertion.sd is not None and (one.insertion.sd < MIN_SD_MM).any():
            what = f"{one.insertion.id} has points whose sd_mm is 0, and no other noise is stated"
            fix = f"correct the column, or state noise.point_sd_mm in {locate_key(file, 'noise.point_sd_mm')}"
            yield Fault(one.where, what, "a standard deviation above 0, mm", fix)


def find_track_noise_faults(record: DatasetRecord, file: Path) -> Iterator[Fault]:
    """Yield the errors that shapes do not have: those of a tracker's readings."""
    for name in ("heading_sd_deg", "slope_sd_deg"):
        if getattr(record.noise, name) > 0:
            what = f"noise.{name} is of tip tracks, and this dataset holds shapes"
            expected = "pose_angle_sd_deg in the table of insertions, for the direction of an entry pose"
            yield Fault(locate_key(file, f"noise.{name}"), what, expected, "remove the key")


def make_refusal(faults: Iterable[Fault], warnings: Iterable[ResultWarning]) -> Inspection:
    """Return the inspection of a dataset with faults, each once, without warnings about their places."""
    places = {fault.where for fault in faults}
    remaining = tuple(one for one in warnings if one.where not in places)
    return Inspection(None, tuple(dict.fromkeys(faults)), remaining)


def find_repeated_ids(what: str, ids: Iterable[str], file: Path) -> Iterator[Fault]:
    """Yield ids that occur in several folders; within one table they were compared before."""
    known_ids: set[str] = set()
    for id_ in ids:
        if id_ in known_ids:
            fix = "rename or remove one of them, or narrow root"
            yield Fault(str(file), f"{what} {id_} is in more than one folder of root", "one of each id", fix)
        known_ids.add(id_)


def _list_files(record: DatasetRecord, root: Path, insertions: list[Insertion]) -> set[Path]:
    tables = {root / name for name in (record.insertions.file, record.centerlines.file) if name is not None}
    pattern = record.centerlines.pattern
    own = {root / pattern.replace("{id}", i.id) for i in insertions} if pattern is not None else set()
    own |= {
        root / one.file_of(i.id) for i in insertions for one in record.media[i.medium].surfaces if one.own
    }
    if record.measurement is not None and record.measurement.sections is not None:
        own |= {locate_sections(i.id, root, record) for i in insertions}
    return tables | {path for path in own if is_file(path)}


def make_dataset(
    record: DatasetRecord | TrackDatasetRecord,
    file: Path,
    insertions: Sequence[Insertion],
    digest_: str,
    **own: Any,  # noqa: ANN401  fields of `Dataset` that only one kind of dataset has
) -> Dataset:
    """Return the dataset of these insertions or tip tracks, as its record describes it."""
    parts = (("", record.notes), ("Needle: ", record.needle.note), ("Noise: ", record.noise.note))
    return Dataset(
        name=record.name,
        title=record.title or record.name,
        origin=record.origin,
        needle=Needle.from_record(record.needle),
        insertions=tuple(insertions),
        media=tuple(record.media),
        noise=make_noise(record.noise),
        path=file,
        digest=digest_,
        notes=tuple(head + text.strip() for head, text in parts if text.strip()),
        outer_diameter=record.needle.outer_diameter_mm,
        **own,
    )


def make_noise(record: NoiseRecord) -> Noise:
    """Return the measurement errors that a dataset states."""
    return Noise(
        record.registration_mean_mm,
        record.point_sd_mm,
        record.correlated_sd_mm,
        record.correlation_length_mm,
        record.correlation,
        math.radians(record.heading_sd_deg),
        math.radians(record.slope_sd_deg),
    )
