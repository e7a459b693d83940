"""From `dataset.toml` with `[tip_tracks]` to the runs, or everything that is wrong with them."""

from dataclasses import dataclass
from pathlib import Path

from needlefit.datasets.faults import Fault, as_error, from_error
from needlefit.datasets.formats.csv import read_table
from needlefit.datasets.inspection import needle_faults, noise_of, notes_of, repeated
from needlefit.datasets.sources import checksum_faults, dataset_file, digest, folders
from needlefit.datasets.tracks.rows import parse
from needlefit.datasets.tracks.track import Track, TrackDataset
from needlefit.errors import ConfigError, DataError
from needlefit.mechanics.needle import Needle
from needlefit.project.load import load, read_toml
from needlefit.project.records.tip_tracks import TrackDatasetRecord


@dataclass(frozen=True)
class Inspection:
    """What came of reading a dataset: `dataset` is None if there are faults."""

    dataset: TrackDataset | None
    faults: tuple[Fault, ...]


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
    found: list[Fault] = list(needle_faults(record.needle, file))
    for root in roots:
        found += checksum_faults(record.checksums, root)
    tracks: list[Track] = []
    remarks: list[str] = []
    for table in tables:
        parsed = parse(table, record, found)
        tracks += parsed.tracks
        remarks += parsed.remarks
    found += repeated("run", (track.id for track in tracks), file)
    if not tracks and not found:
        found.append(
            Fault(str(file), "no run is left: every one is marked invalid", "at least one valid run")
        )
    if found:
        return Inspection(None, tuple(dict.fromkeys(found)))
    sum_ = digest(file, roots, [table.path for table in tables])
    return Inspection(_dataset(record, file, tracks, remarks, sum_), ())


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
