"""Go through every file of a dataset once: the dataset, or everything that is wrong with it."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from needlefit.datasets.centerlines import LongTable, find_points, patient_frame, read_long
from needlefit.datasets.column_warnings import centerline_columns, insertion_columns
from needlefit.datasets.curve_faults import curve_faults
from needlefit.datasets.dataset_warnings import insertion_warnings, placeholder_cells, record_warnings
from needlefit.datasets.faults import Fault, from_error
from needlefit.datasets.formats.csv import Table, read_table
from needlefit.datasets.insertion import Dataset, Insertion, Noise
from needlefit.datasets.layers import Shared, medium_of, read_shared
from needlefit.datasets.layers_met import Placed, media_faults, surface_faults
from needlefit.datasets.reach import reach_from_tip
from needlefit.datasets.reduce import reduce
from needlefit.datasets.rows import parse_rows
from needlefit.datasets.sources import checksum_faults, dataset_file, digest, folders
from needlefit.errors import ConfigError, DataError
from needlefit.mechanics.needle import Needle
from needlefit.project.input_files import is_file
from needlefit.project.load import load
from needlefit.project.result_warnings import ResultWarning
from needlefit.project.toml_lines import locate_key
from needlefit.project.unit_warnings import likely_modulus
from needlefit.schemas.dataset import MIN_SD_MM, DatasetRecord, NoiseRecord
from needlefit.schemas.scene import NeedleRecord

STIFFEST_GPA = 1000.0
"""No needle is stiffer: tungsten carbide has 700 GPa, steel 200."""

POINT_ACROSS = "point bevel_x, bevel_y, bevel_z across the entry direction, or leave the three cells empty"


@dataclass(frozen=True)
class Inspection:
    """What came of reading a dataset: `dataset` is None if there are faults; warnings there may be anyway."""

    dataset: Dataset | None
    faults: tuple[Fault, ...]
    warnings: tuple[ResultWarning, ...] = ()


def inspect(path: Path) -> Inspection:
    """Read the dataset whose folder or `dataset.toml` is `path`, collecting every fault."""
    file = dataset_file(path)
    try:
        record = load(file, DatasetRecord)
        roots = folders(record, file)
    except (ConfigError, DataError) as error:
        return Inspection(None, (from_error(error),))
    found: list[Fault] = []
    for root in roots:
        found += checksum_faults(record.checksums, root)
    found += [*needle_faults(record.needle, file), *media_faults(record, file)]
    shared = read_shared(record, roots[0], found)
    unused: list[ResultWarning] = []
    placed = [one for root in roots for one in _insertions(record, root, shared, found, unused)]
    found += repeated("insertion", (one.insertion.id for one in placed), file)
    found += [*surface_faults(placed, record, file), *reach_faults(record, placed, file)]
    found += sd_faults(record, placed, file)
    warnings = [*record_warnings(record, file), *unused]
    if found:
        return refused(found, warnings)
    insertions = [one.insertion for one in placed]
    warnings += insertion_warnings(record, placed, noise_of(record.noise), file)
    files = {roots[0] / surface.file for surface in shared}
    for root in roots:
        files |= _files(record, root, insertions)
    dataset = _dataset(record, file, insertions, digest(file, roots, files))
    return Inspection(replace(dataset, warnings=tuple(warnings)), (), tuple(warnings))


def _insertions(
    record: DatasetRecord, root: Path, shared: Shared, found: list[Fault], unused: list[ResultWarning]
) -> Iterator[Placed]:
    """Yield the sound insertions of one folder; note the faults of the others, and unused or open cells."""
    long = None
    if record.centerlines.file is not None:
        long = read_long(root / record.centerlines.file, record, found)
        if long is None:
            return
    table = _table(record, root, long, found)
    if table is None:
        return
    unused += insertion_columns(record, map(str, table.cells.columns), table.path)
    unused += placeholder_cells(table)
    headers: set[tuple[str, ...]] = set()
    for row in parse_rows(table, record, found):
        where = f"{table.path}:{row.line}"
        points, faults = find_points(row, root, record, long)
        if points is not None:
            if points.columns not in headers:  # of files with the same header the first is named
                unused += centerline_columns(record, points.columns, points.path)
            headers.add(points.columns)
            faults += curve_faults(points, row, record, where)
        found += faults
        medium = medium_of(row, record, root, shared, found)
        if points is None or faults or medium is None:
            continue
        try:
            insertion = reduce(row, points, medium, row.patient or patient_frame(record.frame))
        except DataError as error:
            fault = from_error(error, where)
            found.append(replace(fault, fix=fault.fix or POINT_ACROSS))
            continue
        yield Placed(insertion, where)


def needle_faults(needle: NeedleRecord, file: Path) -> Iterator[Fault]:
    """Say whether a needle's modulus was written in another unit."""
    modulus = needle.youngs_modulus_gpa
    if modulus is None or modulus <= STIFFEST_GPA:
        return
    unit, in_gpa = likely_modulus(modulus)
    yield Fault(
        locate_key(file, "needle.youngs_modulus_gpa"),
        f"needle.youngs_modulus_gpa is {modulus:g}{f': this looks like {unit}' if unit else ''}",
        "GPa: about 200 for steel, 40 to 80 for nitinol",
        f"write {in_gpa:.3g}" if unit else "write it in GPa",
    )


def _table(record: DatasetRecord, root: Path, long: LongTable | None, found: list[Fault]) -> Table | None:
    """Return the table of insertions: its file, or the first rows of the groups of the long table."""
    if record.insertions.file is None:
        assert long is not None  # the record says so
        return long.first_rows()
    try:
        return read_table(root / record.insertions.file)
    except DataError as error:
        found.append(from_error(error))
        return None


def reach_faults(record: DatasetRecord, placed: Iterable[Placed], file: Path) -> Iterator[Fault]:
    """Say which free shapes are no longer than what is left out of every comparison."""
    if record.frame.pose != "free":
        return
    for one in placed:
        try:
            reach_from_tip(record.frame.drop_proximal_mm, one.insertion)
        except DataError as error:
            yield from_error(error, locate_key(file, "frame.drop_proximal_mm"))


def sd_faults(record: DatasetRecord, placed: Iterable[Placed], file: Path) -> Iterator[Fault]:
    """Say which curves have points without any error: neither their own, nor one that the dataset states."""
    if noise_of(record.noise).stated:
        return
    for one in placed:
        if one.insertion.sd is not None and (one.insertion.sd < MIN_SD_MM).any():
            yield Fault(
                one.where,
                f"{one.insertion.id} has points whose sd_mm is 0, and no other noise is stated",
                "a standard deviation above 0, mm",
                f"correct the column, or state noise.point_sd_mm in {locate_key(file, 'noise.point_sd_mm')}",
            )


def refused(faults: Iterable[Fault], warnings: Iterable[ResultWarning]) -> Inspection:
    """Return what came of a dataset with faults, each once; of one place the fault is enough."""
    places = {fault.where for fault in faults}
    kept = tuple(one for one in warnings if one.where not in places)
    return Inspection(None, tuple(dict.fromkeys(faults)), kept)


def repeated(what: str, ids: Iterable[str], file: Path) -> Iterator[Fault]:
    """Yield ids that several folders hold; within one table the rows were compared before."""
    seen: set[str] = set()
    for id_ in ids:
        if id_ in seen:
            yield Fault(
                str(file),
                f"{what} {id_} is in more than one folder of root",
                "one of each id",
                "rename or remove one of them, or narrow root",
            )
        seen.add(id_)


def _files(record: DatasetRecord, root: Path, insertions: list[Insertion]) -> set[Path]:
    tables = {root / name for name in (record.insertions.file, record.centerlines.file) if name is not None}
    pattern = record.centerlines.pattern
    own = {root / pattern.replace("{id}", i.id) for i in insertions} if pattern is not None else set()
    own |= {
        root / one.file_of(i.id) for i in insertions for one in record.media[i.medium].surfaces if one.own
    }
    return tables | {path for path in own if is_file(path)}


def _dataset(
    record: DatasetRecord,
    file: Path,
    insertions: list[Insertion],
    digest_: str,
) -> Dataset:
    return Dataset(
        name=record.name,
        title=record.title or record.name,
        origin=record.origin,
        needle=Needle.from_record(record.needle),
        insertions=tuple(insertions),
        media=tuple(record.media),
        noise=noise_of(record.noise),
        pose=record.frame.pose,
        drop_proximal=record.frame.drop_proximal_mm,
        path=file,
        digest=digest_,
        notes=notes_of(record.notes, record.needle.note, record.noise.note),
        outer_diameter=record.needle.outer_diameter_mm,
    )


def notes_of(data: str, needle: str, noise: str) -> tuple[str, ...]:
    """Return what a dataset's makers want known of data, needle and noise, as reports print it."""
    said = (("", data), ("Needle: ", needle), ("Noise: ", noise))
    return tuple(head + text.strip() for head, text in said if text.strip())


def noise_of(record: NoiseRecord) -> Noise:
    """Return the errors that a dataset states."""
    return Noise(
        record.registration_mean_mm, record.point_sd_mm, record.correlated_sd_mm, record.correlation_length_mm
    )
