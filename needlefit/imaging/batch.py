"""Reconstruct many scans, in one process or several, or on machines that do not have their files.

A scan that is refused does not stop the others; an error of the program does, after which `--resume` goes on.
"""

import hashlib
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from needlefit.arrays import Floats
from needlefit.errors import DataError, NeedlefitError
from needlefit.geometry.curves import arc_length, interpolate_at_arc
from needlefit.geometry.surfaces import Surface, Triangles, from_triangles, to_triangles
from needlefit.imaging.corrections import describe_changes
from needlefit.imaging.entry import EntryCandidate, list_candidates
from needlefit.imaging.needle import segmentation
from needlefit.imaging.reconstruct import Examination, VolumeSearch, add_views, examine
from needlefit.imaging.reconstruction import IntensityProfile, Reconstruction
from needlefit.imaging.scans import Scan
from needlefit.imaging.volume import VoxelGrid, list_series_files
from needlefit.imaging.volume_files import read_volume
from needlefit.project.checkpoint import ARRAYS_KEY, NO_CHECKPOINT, Checkpoint
from needlefit.project.encode import Arrays, Hook, Hooks, decode, encode
from needlefit.project.processes import one_thread
from needlefit.project.progress import Progress, Stop, never_stop, no_progress
from needlefit.project.tasks import THIS_PROCESS, TaskPool
from needlefit.schemas.reconstruction import ReconstructionRecord

MAX_TUBES, MAX_BALLS = 6, 20  # largest numbers of candidates that are kept
T = TypeVar("T")


@dataclass(frozen=True)
class TubeFinding:
    """A long bright component: its ends (2, 3), LPS, its length and width, mm; whether it was the needle."""

    ends: Floats
    length: float
    width: float
    chosen: bool


@dataclass(frozen=True)
class BallFinding:
    """What has about a marker's size: its centre (3,), LPS, and diameter, mm; whether it is a marker."""

    center: Floats
    diameter: float
    marker: bool


@dataclass(frozen=True)
class Findings:
    """What a scan shows; what could not be found is empty or None."""

    grid: VoxelGrid  # the scan's voxels
    # Largest values along k (J, I), along j (K, I) and along i (K, J), HU.
    projections: tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]
    tubes: tuple[TubeFinding, ...] = ()  # the longest first
    balls: tuple[BallFinding, ...] = ()  # the markers first; none where the scan needs no markers
    needle: Floats | None = None  # (N, 3) or None; the axis from base to tip, LPS, mm
    profile: IntensityProfile | None = None  # along the needle, from its first point
    entries: tuple[EntryCandidate, ...] = ()  # places where soft material begins around the needle
    warnings: tuple[str, ...] = ()  # what a person should know of the scan's files

    @property
    def entry_points(self) -> Floats:
        """Where the entries lie (n, 3), LPS, mm."""
        if self.needle is None or not self.entries:
            return np.empty((0, 3))
        return interpolate_at_arc(self.needle, np.array([one.at for one in self.entries]))


def collect_findings(search: VolumeSearch, examined: Examination) -> Findings:
    """Return what a scan shows, for its page."""
    volume = search.volume
    projections = (volume.values.max(axis=0), volume.values.max(axis=1), volume.values.max(axis=2))
    axis, profile, found = examined.needle_axis, examined.profile, examined.markers
    size, rejected = search.recipe.markers.diameter_mm, () if found is None else found.rejected
    balls = [BallFinding(center, size, True) for center in (() if found is None else found.centers)]
    for one in sorted(rejected, key=lambda one: abs(np.log(one.diameter / size))):  # the most alike first
        balls.append(BallFinding(one.center, one.diameter, False))
    entries: tuple[EntryCandidate, ...] = ()
    if axis is not None and profile is not None:
        entries = _try(lambda: list_candidates(profile, float(arc_length(axis.points)[-1]))) or ()
    return Findings(
        volume.grid,
        projections,
        _list_tubes(search, examined.selection),
        tuple(balls[:MAX_BALLS]),
        None if axis is None else axis.points,
        profile,
        entries,
        volume.warnings,
    )


def _try(step: Callable[[], T]) -> T | None:
    """Return what a step finds; None if it refuses the scan: another step has raised its error."""
    with suppress(NeedlefitError):
        return step()
    return None


def _list_tubes(search: VolumeSearch, found: segmentation.NeedleSelection | None) -> tuple[TubeFinding, ...]:
    """Return the needle and the other tubes, or, where none is chosen, all."""
    parts = [found.needle, *found.others] if found is not None else _try(search.find_tubes) or []
    chosen = None if found is None else found.needle
    return tuple(
        TubeFinding(segmentation.find_ends(search.volume, part), part.length, part.width, part is chosen)
        for part in parts[:MAX_TUBES]
    )


SINGLE_FILE_SUFFIXES = (".nrrd", ".nii", ".nii.gz", ".mha", ".zip")  # endings of volumes that are one file


@dataclass(frozen=True)
class PackedScan:
    """A scan, the folder that all of its files lie in, and their bytes by their paths in that folder."""

    scan: Scan
    root: Path
    files: tuple[tuple[str, bytes], ...]

    def original(self, error: NeedlefitError, unpacked: Path) -> NeedlefitError:
        """Return an error about unpacked files as one about those that were packed."""
        texts = {name: text.replace(str(unpacked), str(self.root)) for name, text in vars(error).items()}
        return type(error)(**texts)


class PackedScans(Sequence[PackedScan]):
    """Scans that are packed one by one, when they are asked for: their volumes are large."""

    def __init__(self, scans: Sequence[Scan]) -> None:
        self._scans = scans

    def __len__(self) -> int:
        return len(self._scans)

    def __getitem__(self, index: int) -> PackedScan:  # type: ignore[override]  # no slices
        return pack_scan(self._scans[index])


def pack_scan(scan: Scan) -> PackedScan:
    """Return a scan with the bytes of its files; those that are missing are left out."""
    scan = _move(scan, Path.absolute)
    files = sorted({path for path in list_scan_files(scan) if path.is_file()})
    root = Path(os.path.commonpath([path.parent for path in (*scan.files, *files)]))
    return PackedScan(scan, root, tuple((str(path.relative_to(root)), path.read_bytes()) for path in files))


@contextmanager
def unpack_scan(packed: PackedScan) -> Iterator[tuple[Scan, Path]]:
    """Write the files of a packed scan into a folder of this machine; that scan and the folder."""
    with TemporaryDirectory(prefix="needlefit-") as name:
        folder = Path(name)
        for path, data in packed.files:
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_bytes(data)
        yield _move(packed.scan, lambda path: folder / path.relative_to(packed.root)), folder


def list_scan_files(scan: Scan) -> Iterator[Path]:
    """Yield every file that a reconstruction may read.

    One slice stands for its series, and a header for the file of its voxels: all files of the folder count,
    and of those below.
    """
    yield from scan.files[1:]
    alone = scan.volume.name.lower().endswith(SINGLE_FILE_SUFFIXES)
    yield from [scan.volume] if alone else list_series_files(scan.volume)


def _move(scan: Scan, moved: Callable[[Path], Path]) -> Scan:
    """Return a scan whose files are elsewhere."""
    surfaces = tuple(replace(source, path=moved(source.path)) for source in scan.surfaces)
    files = {name: getattr(scan, name) for name in ("volume", "mask", "markers", "fiducials")}
    elsewhere: dict[str, Any] = {name: path and moved(path) for name, path in files.items()}
    return replace(scan, surfaces=surfaces, **elsewhere)


_HOOKS: Hooks = {Surface: Hook(to_triangles, from_triangles, Triangles)}
VERSIONED_PACKAGES = ("numpy", "scipy", "SimpleITK", "pydicom", "scikit-image", "trimesh")


@dataclass(frozen=True)
class ReconstructionFailure:
    """A scan that could not be reconstructed, why, and what was found in it, where it could be read."""

    scan: Scan
    error: NeedlefitError
    findings: Findings | None = None


@dataclass(frozen=True)
class ReconstructionBatch:
    """Options of a batch: where it runs, checkpoints and callbacks."""

    # Where scans are reconstructed; each takes as much memory as its volume, several times.
    pool: TaskPool = THIS_PROCESS
    checkpoint: Checkpoint = NO_CHECKPOINT  # what it has of the same scans and versions is taken as it is
    progress: Progress = no_progress  # called with the scan that was finished, how many are, and of how many
    stop: Stop = never_stop  # whether to begin no further scan
    every: bool = False  # whether each needle of a scan is reconstructed


def divide_scan(search: VolumeSearch, scan: Scan) -> tuple[Scan, ...]:
    """Return one scan for each needle that a scan holds, `ID-1`, `ID-2`, ... along L; itself if there is one.

    So is one of which something is stated that only one needle has, or in which nothing is found.
    """
    own = (scan.needle_at, scan.contact, scan.tip, scan.stage, scan.corrections, scan.mask)
    if any(stated is not None for stated in own):
        return (scan,)
    with suppress(NeedlefitError):  # its reconstruction says why
        tubes = search.find_tubes()
        parts = segmentation.list_needles(search.volume, tubes, search.recipe.needle.diameter_mm)
        points = segmentation.locate_needles(search.volume, parts)
        if len(points) > 1:
            ones = enumerate(points, start=1)
            return tuple(replace(scan, id=f"{scan.id}-{n}", needle_at=at, divided=True) for n, at in ones)
    return (scan,)


Result = Reconstruction | ReconstructionFailure


def reconstruct_all(
    scans: Sequence[Scan], recipe: ReconstructionRecord, batch: ReconstructionBatch
) -> tuple[tuple[Result, ...], ...]:
    """Return for every scan, in their order, the reconstruction or failure of its needle, or of each needle.

    Of fewer scans after a stop.
    """
    found: dict[int, tuple[Result, ...]] = {}
    for n, scan in enumerate(scans):
        finished = _read_checkpoint(scan, recipe, batch)
        if finished is not None:
            found[n] = finished
    left = [n for n in range(len(scans)) if n not in found]
    batch.progress("reconstructing", len(found), len(scans))
    remaining = [scans[n] for n in left]
    items = PackedScans(remaining) if batch.pool.remote else remaining
    work = partial(reconstruct_needles, recipe=recipe, collect=True, every=batch.every)
    for at, results in batch.pool.run(work, items, batch.stop):
        scan = remaining[at]
        ones = tuple(_move_to(one, scan) for one in results)  # those of a packed one have other paths
        found[left[at]] = ones
        if all(isinstance(one, Reconstruction) for one in ones):
            arrays: Arrays = {}
            plain = [encode(one, _HOOKS, arrays) for one in ones]
            kept = {"inputs": _digest_inputs(scan, recipe, batch.every), "reconstructions": plain}
            batch.checkpoint.keep_row(_work_of(scan), kept, arrays)
        batch.progress(scan.id, len(found), len(scans))
    return tuple(found[n] for n in sorted(found))


def _move_to(one: Result, scan: Scan) -> Result:
    """Return a result of one needle of `scan` with the files of that scan."""
    own = {name: getattr(one.scan, name) for name in ("id", "needle_at", "divided")}
    return replace(one, scan=replace(scan, **own))


def reconstruct_needles(
    scan: Scan | PackedScan, recipe: ReconstructionRecord, collect: bool = False, every: bool = False
) -> tuple[Result, ...]:
    """Return the reconstruction or failure of the needle of a scan, or of `every` one that it holds.

    `collect`: a failure comes with what was found in the scan.
    """
    if isinstance(scan, Scan):
        return _reconstruct_needles(scan, recipe, collect, every)
    with unpack_scan(scan) as (unpacked, folder):
        found = _reconstruct_needles(unpacked, recipe, collect, every)
    return tuple(
        replace(one, error=scan.original(one.error, folder))
        if isinstance(one, ReconstructionFailure)
        else one
        for one in found
    )


def add_findings(
    failure: ReconstructionFailure, one: Reconstruction, recipe: ReconstructionRecord
) -> ReconstructionFailure:
    """Return the failure of a scan that was reconstructed (`one`), with what was found in it."""
    try:
        volume = read_volume(one.scan.volume, one.scan.series, one.scan.acquisition)
    except NeedlefitError:  # the scan was moved: its page says why it is refused, and no more
        return failure
    profile = replace(one.profile, s=one.profile.s - one.profile.s[0])
    found = Examination(one.scan, None, one.needle_axis, one.markers, one.registration, profile)
    return replace(failure, findings=collect_findings(VolumeSearch(volume, recipe), found))


@one_thread
def _reconstruct_needles(
    scan: Scan, recipe: ReconstructionRecord, collect: bool, every: bool
) -> tuple[Result, ...]:
    read = partial(read_volume, scan.volume, scan.series, scan.acquisition)
    search = _try_step(scan, lambda: VolumeSearch(read(), recipe))
    if isinstance(search, ReconstructionFailure):
        return (search,)
    needles = divide_scan(search, scan) if every else (scan,)
    return tuple(_try_step(one, partial(_reconstruct_needle, search, one, collect)) for one in needles)


def _reconstruct_needle(search: VolumeSearch, scan: Scan, collect: bool) -> Result:
    found = examine(search.volume, scan, search.recipe, search)
    if found.error is None and found.reconstruction is not None:
        one = add_views(found.reconstruction, search.volume)
        if scan.corrections is None:
            return one
        plain = replace(scan, corrections=None)
        before = _try(lambda: examine(search.volume, plain, search.recipe, search).reconstruction)
        return replace(one, warnings=(describe_changes(before, one), *one.warnings))
    failed = found.error or NeedlefitError("nothing was found", where=str(scan.volume))
    return ReconstructionFailure(scan, failed, collect_findings(search, found) if collect else None)


def _try_step(scan: Scan, work: Callable[[], T]) -> T | ReconstructionFailure:
    try:
        return work()
    except NeedlefitError as error:
        return ReconstructionFailure(scan, error)


def _read_checkpoint(
    scan: Scan, recipe: ReconstructionRecord, batch: ReconstructionBatch
) -> tuple[Result, ...] | None:
    """Return what is kept of a scan; None if nothing, of another scan or recipe, or damaged."""
    for row in batch.checkpoint.rows(_work_of(scan), ("inputs", "reconstructions", ARRAYS_KEY))[::-1]:
        if row["inputs"] == _digest_inputs(scan, recipe, batch.every):
            with suppress(DataError):
                return tuple(_move_to(one, scan) for one in _decode_checkpoint(row))
    return None


def _decode_checkpoint(row: Mapping[str, Any]) -> list[Reconstruction]:
    """Return the reconstructions that a row keeps; DataError if it keeps none."""
    try:
        ones = [decode(Reconstruction, one, _HOOKS, row[ARRAYS_KEY]) for one in row["reconstructions"]]
    except (ValueError, TypeError, IndexError, OverflowError) as error:
        raise DataError(f"holds no reconstruction: {error}") from None
    if not all(isinstance(one, Reconstruction) for one in ones):
        raise DataError("holds no reconstruction")
    return ones


def _work_of(scan: Scan) -> str:
    return f"scan {scan.id}"


def _digest_inputs(scan: Scan, recipe: ReconstructionRecord, every: bool) -> str:
    """Return a digest of all that decides a reconstruction; of files their size and time."""
    arrays: Arrays = {}
    plain = json.dumps([encode(scan, _HOOKS, arrays), [[name, one.tolist()] for name, one in arrays.items()]])
    parts = [
        plain,
        f"{every}",
        recipe.model_dump_json(),
        *(version(name) for name in ("needlefit", *VERSIONED_PACKAGES)),
    ]
    for path in sorted(set(list_scan_files(scan))):
        status = path.stat()
        parts.append(f"{path} {status.st_size} {status.st_mtime_ns}")
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()
