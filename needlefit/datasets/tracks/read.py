"""From `dataset.toml` with `[tip_tracks]` to the runs, or everything that is wrong with them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from needlefit.datasets.bevel_side import Bent, bend_of_track, side_warnings
from needlefit.datasets.dataset_warnings import placeholder_cells, record_warnings
from needlefit.datasets.faults import Fault, as_error, from_error
from needlefit.datasets.formats.csv import read_table
from needlefit.datasets.inspection import needle_faults, noise_of, notes_of, repeated
from needlefit.datasets.noise_warnings import spacing_warnings
from needlefit.datasets.sources import checksum_faults, dataset_file, digest, folders
from needlefit.datasets.tracks.rows import parse
from needlefit.datasets.tracks.track import Track, TrackDataset
from needlefit.errors import ConfigError, DataError
from needlefit.mechanics.needle import Needle
from needlefit.project.load import load, read_toml
from needlefit.project.result_warnings import ResultWarning
from needlefit.project.toml_lines import locate_key
from needlefit.project.unit_warnings import format_place, layer_warnings
from needlefit.schemas.dataset import TrackDatasetRecord


@dataclass(frozen=True)
class Inspection:
    """What came of reading a dataset: `dataset` is None if there are faults."""

    dataset: TrackDataset | None
    faults: tuple[Fault, ...]
    warnings: tuple[ResultWarning, ...] = ()


def holds_tracks(path: Path) -> bool:
    """Return whether the dataset whose folder or `dataset.toml` is `path` is one of tip tracks."""
    try:
        return "tip_tracks" in read_toml(dataset_file(path))
    except ConfigError:
        return False  # whoever reads it says what is wrong


def read_tracks(path: Path) -> TrackDataset:
    """Return the tip tracks of the dataset whose folder or `dataset.toml` is `path`.

    Raises
    ------
    DataError
        Listing every fault.
    """
    found = inspect_tracks(path)
    if found.dataset is None:
        raise as_error(found.faults, dataset_file(path))
    return found.dataset


def inspect_tracks(path: Path) -> Inspection:
    """Read a dataset of tip tracks, collecting every fault."""
    file = dataset_file(path)
    try:
        record = load(file, TrackDatasetRecord)
        roots = folders(record, file)
        tables = [read_table(root / record.tip_tracks.file) for root in roots]
    except (ConfigError, DataError) as error:
        return Inspection(None, (from_error(error),))
    found: list[Fault] = [*needle_faults(record.needle, file), *_noise_faults(record, file)]
    warnings = record_warnings(record, file)
    for root in roots:
        found += checksum_faults(record.checksums, root)
    tracks: list[Track] = []
    remarks: list[str] = []
    for table in tables:
        warnings += placeholder_cells(table)
        parsed = parse(table, record, found)
        tracks += parsed.tracks
        remarks += parsed.remarks
    found += repeated("run", (track.id for track in tracks), file)
    if not tracks and not found:
        found.append(
            Fault(str(file), "no run is left: every one is marked invalid", "at least one valid run")
        )
    if found:
        return Inspection(None, tuple(dict.fromkeys(found)), tuple(warnings))
    warnings += _run_warnings(record, tracks, file, str(tables[0].path))
    sum_ = digest(file, roots, [table.path for table in tables])
    dataset = replace(_dataset(record, file, tracks, remarks, sum_), warnings=tuple(warnings))
    return Inspection(dataset, (), tuple(warnings))


def _noise_faults(record: TrackDatasetRecord, file: Path) -> Iterator[Fault]:
    """Say whether readings have no noise: every fit of tip tracks samples a posterior, which needs one."""
    if record.noise.point_sd_mm <= 0:
        yield Fault(
            locate_key(file, "noise.point_sd_mm"),
            "no noise of the readings is stated",
            "noise.point_sd_mm above 0",
            "write the standard deviation of a reading, mm",
        )


def _run_warnings(
    record: TrackDatasetRecord, tracks: Sequence[Track], file: Path, table: str
) -> Iterator[ResultWarning]:
    """Yield what is suspicious in sound runs."""
    column = record.tip_tracks.columns.get("bevel_side", "bevel_side")
    bent = [Bent(one.id, table, bend_of_track(one, noise_of(record.noise))) for one in tracks]
    yield from side_warnings(bent, column, "runs")
    yield from spacing_warnings(noise_of(record.noise), [one.depth for one in tracks], format_place(file))
    for name, medium in record.media.items():
        depths = [float(one.depth[-1]) for one in tracks if one.medium == name]
        if medium.boundaries_mm and depths:
            key = f"media.{name}.boundaries_mm"
            yield from layer_warnings(medium.boundaries_mm, max(depths), format_place(file), key)


def _dataset(
    record: TrackDatasetRecord, file: Path, tracks: list[Track], remarks: list[str], digest_: str
) -> TrackDataset:
    return TrackDataset(
        name=record.name,
        title=record.title or record.name,
        origin=record.origin,
        needle=Needle.from_record(record.needle),
        tracks=tuple(tracks),
        media=tuple(record.media),
        noise=noise_of(record.noise),
        path=file,
        digest=digest_,
        notes=notes_of(record.notes, record.needle.note, record.noise.note),
        remarks=tuple(remarks),
    )
