"""Reconstruct many scans, in one process or several, or on machines that do not have their files.

A scan that is refused does not stop the others; an error of the program does.
"""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

import numpy as np

from needlefit.datasets.formats.markups import Markups
from needlefit.errors import NeedlefitError
from needlefit.geometry.curves import arc_length, interpolate_at_arc
from needlefit.imaging.constants import PART
from needlefit.imaging.corrections import make_control_points
from needlefit.imaging.entry import choose_entry
from needlefit.imaging.needle.follow import follow_tube
from needlefit.imaging.needle.segmentation import list_needles
from needlefit.imaging.reconstruct import STAGES, VolumeSearch, add_views, examine, picture_curve
from needlefit.imaging.reconstruction import CurvePicture, Reconstruction
from needlefit.imaging.scans import Scan
from needlefit.imaging.volume import list_series_files, to_patient
from needlefit.imaging.volume_files import read_volume
from needlefit.project.processes import one_thread
from needlefit.project.progress import Progress, Stop, never_stop, no_progress
from needlefit.project.tasks import THIS_PROCESS, TaskPool
from needlefit.schemas.reconstruction import ReconstructionRecord

T = TypeVar("T")


SINGLE_FILE_SUFFIXES = (".nrrd", ".nii", ".nii.gz", ".mha", ".zip")  # endings of volumes that are one file


@dataclass(frozen=True)
class PackedScan:
    """A scan, the folder that all of its files lie in, and their bytes by their paths in that folder."""

    scan: Scan
    root: Path
    files: tuple[tuple[str, bytes], ...]


class PackedScans(Sequence[PackedScan]):
    """Scans that are packed one by one, when they are asked for: their volumes are large.

    Files that are missing are left out.
    """

    def __init__(self, scans: Sequence[Scan]) -> None:
        self._scans = scans

    def __len__(self) -> int:
        return len(self._scans)

    def __getitem__(self, index: int) -> PackedScan:  # type: ignore[override]  # no slices
        scan = _move(self._scans[index], Path.absolute)
        files = sorted({path for path in list_scan_files(scan) if path.is_file()})
        root = Path(os.path.commonpath([path.parent for path in (*scan.files, *files)]))
        packed = tuple((str(path.relative_to(root)), path.read_bytes()) for path in files)
        return PackedScan(scan, root, packed)


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


VERSIONED_PACKAGES = ("numpy", "scipy", "SimpleITK", "pydicom", "scikit-image", "trimesh")


@dataclass(frozen=True)
class ReconstructionFailure:
    """A scan that could not be reconstructed, and why."""

    scan: Scan
    error: NeedlefitError
    points: Markups | None = None  # control points of what was found in it, LPS, mm
    warnings: tuple[str, ...] = ()  # what a person should know of the scan's files
    picture: CurvePicture | None = None  # of what was taken for the needle
    asked: int = 0  # how many answers about the entry a person may choose from


@dataclass(frozen=True)
class ReconstructionBatch:
    """Options of a batch: where it runs, and callbacks."""

    pool: TaskPool = THIS_PROCESS  # where scans are reconstructed; each takes several times its own memory
    progress: Progress = no_progress  # called with a scan and its stage, and percent done, of 100 a scan
    stop: Stop = never_stop  # whether to begin no further scan
    every: bool = False  # whether each needle of a scan is reconstructed


def divide_scan(search: VolumeSearch, scan: Scan) -> tuple[Scan, ...]:
    """Return one scan for each needle that a scan holds, `ID-1`, `ID-2`, ... along L; itself if there is one.

    So is one of which something is stated that only one needle has, or in which nothing is found.
    """
    own = (scan.needle_at, scan.stage, scan.corrections, scan.mask)
    if any(stated is not None for stated in own):
        return (scan,)
    with suppress(NeedlefitError):  # its reconstruction says why
        size = search.recipe.needle.diameter_mm
        parts = list_needles(search.volume, search.tubes, size, PART.DIVIDED_NEEDLE)
        points = [to_patient(search.volume, part.voxels) for part in parts]
        middles = [some[np.argmin(np.linalg.norm(some - some.mean(axis=0), axis=1))] for some in points]
        if len(middles) > 1:
            ones = enumerate(sorted(middles, key=lambda middle: float(middle[0])), start=1)
            return tuple(
                replace(scan, id=f"{scan.id}-{n}", needle_at=at, divided=len(parts)) for n, at in ones
            )
    return (scan,)


Result = Reconstruction | ReconstructionFailure


def reconstruct_all(
    scans: Sequence[Scan], recipe: ReconstructionRecord, batch: ReconstructionBatch
) -> tuple[tuple[Result, ...], ...]:
    """Return for every scan, in their order, the reconstruction or failure of its needle, or of each needle.

    Of fewer scans after a stop.
    """
    found: dict[int, tuple[Result, ...]] = {}

    def report(stage: str, done: int = 0, total: int = 1) -> None:
        batch.progress(stage, 100 * len(found) + 100 * done // total, 100 * len(scans))

    report("reconstructing")
    items = PackedScans(scans) if batch.pool.remote else scans
    work = partial(reconstruct_needles, recipe=recipe, every=batch.every)
    if batch.pool == THIS_PROCESS or (len(scans) == 1 and not batch.pool.remote):
        work = partial(work, progress=report)  # not from other processes
    for n, results in batch.pool.run(work, items, batch.stop):
        found[n] = tuple(_move_to(one, scans[n]) for one in results)  # those of a packed one have other paths
        report(scans[n].id)
    return tuple(found[n] for n in sorted(found))


def _move_to(one: Result, scan: Scan) -> Result:
    """Return a result of one needle of `scan` with the files of that scan."""
    own = {name: getattr(one.scan, name) for name in ("id", "needle_at", "divided")}
    return replace(one, scan=replace(scan, **own))


@one_thread
def reconstruct_needles(
    scan: Scan | PackedScan,
    recipe: ReconstructionRecord,
    every: bool = False,
    progress: Progress = no_progress,
) -> tuple[Result, ...]:
    """Return the reconstruction or failure of the needle of a scan, or of `every` one that it holds.

    `progress` is called with the needle and the stage that begins, and the percent done, of 100 a needle.
    """
    if isinstance(scan, Scan):
        progress(f"{scan.id}: reading", 0, 100)
        search = _try_step(scan, lambda: VolumeSearch(read_volume(scan.volume, scan.series), recipe))
        if isinstance(search, ReconstructionFailure):
            return (search,)
        needles = divide_scan(search, scan) if every else (scan,)
        found = []
        for n, part in enumerate(needles):

            def report(stage: str, n: int = n, id_: str = part.id) -> None:
                progress(f"{id_}: {stage}", 100 * n + STAGES[stage], 100 * len(needles))

            found.append(_try_step(part, partial(_reconstruct_needle, search, part, report)))
        return tuple(found)
    with TemporaryDirectory(prefix="needlefit-") as name:
        folder = Path(name)
        for path, data in scan.files:
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_bytes(data)
        unpacked = _move(scan.scan, lambda path: folder / path.relative_to(scan.root))
        packed = reconstruct_needles(unpacked, recipe, every)
    ones: list[Result] = []
    for one in packed:
        if isinstance(one, ReconstructionFailure):  # it names the files that were packed
            texts = {key: text.replace(name, str(scan.root)) for key, text in vars(one.error).items()}
            one = replace(one, error=type(one.error)(**texts))
        ones.append(one)
    return tuple(ones)


def _reconstruct_needle(search: VolumeSearch, scan: Scan, report: Callable[[str], None]) -> Result:
    found = examine(search.volume, scan, search.recipe, search, report)
    report("pictures")
    if found.error is None and found.reconstruction is not None:
        one = add_views(found.reconstruction, search.volume)
        if scan.corrections is None:
            return one
        moved = [name for name, places in vars(scan.corrections).items() if places is not None]
        return replace(one, warnings=(f"corrected by hand: {', '.join(moved)}", *one.warnings))
    failed = found.error or NeedlefitError("nothing was found", where=scan.volume)
    needle = None if found.needle_axis is None else found.needle_axis.points
    if needle is None and found.selection is not None:  # about where it is
        axis = found.selection.axis or follow_tube(search.volume, found.selection.needle, search.recipe)
        needle = axis.spline(np.arange(0.0, axis.length, 1.0))
    balls = np.empty((0, 3)) if found.markers is None else found.markers.centers
    entries, profile = np.empty((0, 3)), found.profile
    if needle is not None and profile is not None:
        thickness, length = search.recipe.guide.thickness_mm, float(arc_length(needle)[-1])
        if offered := choose_entry(profile, length, thickness, scan.guide_distance):
            entries = interpolate_at_arc(needle, [one.at for one in offered.answers or (offered,)])
    points = make_control_points(scan.id, needle, entries[0] if len(entries) else None, balls)
    picture = None if needle is None else picture_curve(search.volume, needle, entries)
    return ReconstructionFailure(scan, failed, points, search.volume.warnings, picture, found.asked)


def _try_step(scan: Scan, work: Callable[[], T]) -> T | ReconstructionFailure:
    try:
        return work()
    except NeedlefitError as error:
        return ReconstructionFailure(scan, error)
