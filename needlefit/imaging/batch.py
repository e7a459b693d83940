"""Reconstruct many scans, in one process or several, or on machines that see their files in the same place.

A scan that is refused does not stop the others; an error of the program does.
"""

from collections.abc import Callable, Sequence
from contextlib import chdir, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np

from needlefit.datasets.markups import Markups
from needlefit.errors import NeedlefitError
from needlefit.geometry.curves import arc_length, interpolate_at_arc
from needlefit.imaging.corrections import make_control_points
from needlefit.imaging.entry import list_candidates
from needlefit.imaging.needle import segmentation
from needlefit.imaging.reconstruct import VolumeSearch, add_views, examine
from needlefit.imaging.reconstruction import Reconstruction
from needlefit.imaging.scans import Scan
from needlefit.imaging.volume_files import read_volume
from needlefit.project.processes import one_thread
from needlefit.project.progress import Progress, Stop, never_stop, no_progress
from needlefit.project.tasks import THIS_PROCESS, TaskPool
from needlefit.schemas.reconstruction import ReconstructionRecord

T = TypeVar("T")


VERSIONED_PACKAGES = ("numpy", "scipy", "SimpleITK", "pydicom", "scikit-image", "trimesh")


@dataclass(frozen=True)
class ReconstructionFailure:
    """A scan that could not be reconstructed, and why."""

    scan: Scan
    error: NeedlefitError
    points: Markups | None = None  # control points of what was found in it, LPS, mm
    warnings: tuple[str, ...] = ()  # what a person should know of the scan's files


@dataclass(frozen=True)
class ReconstructionBatch:
    """Options of a batch: where it runs, and callbacks."""

    # Where scans are reconstructed; each takes as much memory as its volume, several times.
    pool: TaskPool = THIS_PROCESS
    progress: Progress = no_progress  # called with the scan that was finished, how many are, and of how many
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
    batch.progress("reconstructing", 0, len(scans))
    work = partial(reconstruct_needles, recipe=recipe, every=batch.every, folder=Path.cwd())
    for at, results in batch.pool.run(work, scans, batch.stop):
        found[at] = results
        batch.progress(scans[at].id, len(found), len(scans))
    return tuple(found[n] for n in sorted(found))


@one_thread
def reconstruct_needles(
    scan: Scan, recipe: ReconstructionRecord, every: bool = False, folder: Path = Path()
) -> tuple[Result, ...]:
    """Return the reconstruction or failure of the needle of a scan, or of `every` one that it holds.

    Relative paths of the scan count from `folder`.
    """
    with chdir(folder):
        read = partial(read_volume, scan.volume, scan.series, scan.acquisition)
        search = _try_step(scan, lambda: VolumeSearch(read(), recipe))
        if isinstance(search, ReconstructionFailure):
            return (search,)
        needles = divide_scan(search, scan) if every else (scan,)
        return tuple(_try_step(one, partial(_reconstruct_needle, search, one)) for one in needles)


def _reconstruct_needle(search: VolumeSearch, scan: Scan) -> Result:
    found = examine(search.volume, scan, search.recipe, search)
    if found.error is None and found.reconstruction is not None:
        return add_views(found.reconstruction, search.volume)
    failed = found.error or NeedlefitError("nothing was found", where=str(scan.volume))
    needle = None if found.needle_axis is None else found.needle_axis.points
    balls = np.empty((0, 3)) if found.markers is None else found.markers.centers
    entry, profile = None, found.profile
    if needle is not None and profile is not None:
        with suppress(NeedlefitError):  # another step has raised its error
            for rise in list_candidates(profile, float(arc_length(needle)[-1])):
                (entry,) = interpolate_at_arc(needle, [rise.at])  # of the last, as tissue holds the tip
    points = make_control_points(scan.id, needle, entry, balls)
    return ReconstructionFailure(scan, failed, points, search.volume.warnings)


def _try_step(scan: Scan, work: Callable[[], T]) -> T | ReconstructionFailure:
    try:
        return work()
    except NeedlefitError as error:
        return ReconstructionFailure(scan, error)
