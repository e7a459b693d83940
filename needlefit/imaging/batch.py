"""Reconstruct many scans, in one process or several.

A scan that is refused does not stop the others; an error of the program does. Finished scans are kept in a
checkpoint.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from needlefit.datasets.formats.markups import Markups
from needlefit.errors import DataError, NeedlefitError
from needlefit.geometry.curves import interpolate_at_arc
from needlefit.imaging.constants import PART
from needlefit.imaging.corrections import make_control_points
from needlefit.imaging.needle.follow import list_middles
from needlefit.imaging.needle.segmentation import list_needles
from needlefit.imaging.reconstruct import STAGES, VolumeSearch, examine, picture_curve
from needlefit.imaging.reconstruction import CurvePicture, Reconstruction, render_views
from needlefit.imaging.scans import Scan
from needlefit.imaging.volume import explain_refusal
from needlefit.imaging.volume_files import read_volume
from needlefit.project.callbacks import Progress, Stop, never_stop, no_progress
from needlefit.project.checkpoint import NO_CHECKPOINT, Checkpoint
from needlefit.project.processes import one_thread
from needlefit.project.stored_values import decode, encode
from needlefit.project.tasks import THIS_PROCESS, LocalPool, TaskPool
from needlefit.schemas.reconstruction import ReconstructionRecord

T = TypeVar("T")


VERSIONED_PACKAGES = ("numpy", "scipy", "SimpleITK", "pydicom", "scikit-image", "trimesh")


@dataclass(frozen=True)
class ReconstructionFailure:
    """A scan that could not be reconstructed, and why."""

    scan: Scan
    error: NeedlefitError
    points: Markups | None = None  # control points of what was found in it, LPS, mm
    entries: Markups | None = None  # the entries to choose from, faces of guides and the tip, likewise
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
    checkpoint: Checkpoint = NO_CHECKPOINT  # keeps the results of finished scans, which are not made again


def divide_scan(search: VolumeSearch, scan: Scan) -> tuple[Scan, ...]:
    """Return one scan for each needle that a scan holds, `ID-1`, `ID-2`, ... along L; itself if there is one.

    So is one of which something is stated that only one needle has, or in which nothing is found.
    """
    own = (scan.needle_at, scan.stage, scan.corrections, scan.mask)
    if any(stated is not None for stated in own):
        return (scan,)
    with suppress(NeedlefitError):  # its reconstruction says why
        size = search.recipe.needle.diameter_mm
        parts = list_needles(search.tubes, size, PART.DIVIDED_NEEDLE)
        away = [np.linalg.norm(part.points - part.points.mean(axis=0), axis=1) for part in parts]
        middles = [part.points[np.argmin(off)] for part, off in zip(parts, away, strict=True)]
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
    kept = [batch.checkpoint.rows(scan.id) for scan in scans]
    found = {n: _read_results(rows[0]) for n, rows in enumerate(kept) if rows}
    todo = [n for n in range(len(scans)) if n not in found]

    def report(stage: str, done: int = 0, total: int = 1) -> None:
        share = (len(found) + done / total) * STAGES["quality page"]
        batch.progress(stage, round(share), 100 * len(scans))

    report("reconstructing")
    work = partial(reconstruct_needles, recipe=recipe, every=batch.every)
    if isinstance(batch.pool, LocalPool) and (batch.pool.size == 1 or len(todo) == 1):
        work = partial(work, progress=report)  # not from other processes
    for place, results in batch.pool.run(work, [scans[n] for n in todo], batch.stop):
        n, row = todo[place], {"results": encode(results)}
        batch.checkpoint.keep_row(scans[n].id, row)
        found[n] = _read_results(row)  # as after --resume
        report(scans[n].id)
    return tuple(found[n] for n in sorted(found))


def _read_results(row: Mapping[str, Any]) -> tuple[Result, ...]:
    results: tuple[Result, ...] = decode(row["results"], tuple[Result, ...])
    return results


@one_thread
def reconstruct_needles(
    scan: Scan,
    recipe: ReconstructionRecord,
    every: bool = False,
    progress: Progress = no_progress,
) -> tuple[Result, ...]:
    """Return the reconstruction or failure of the needle of a scan, or of `every` one that it holds.

    `progress` is called with the needle and the stage that begins, and the percent done, of 100 a needle.
    """
    progress(f"{scan.id}: reading", 0, 100)
    search = _try_step(scan, lambda: VolumeSearch(read_volume(scan.volume, scan.series), recipe))
    if isinstance(search, ReconstructionFailure):
        return (search,)
    needles = divide_scan(search, scan) if every else (scan,)
    ids = [part.id for part in needles]
    if scan.answers.keys() - ids:
        error = DataError(
            f"holds the needles {', '.join(ids)}, but an answer is about {', '.join(scan.answers)}",
            expected="answers that name a needle each",
            fix=f"state its needle: --confirm {ids[0]}:entry=1",
            where=scan.volume,
        )
        return (ReconstructionFailure(scan, error),)
    found = []
    for n, part in enumerate(needles):

        def report(stage: str, n: int = n, id_: str = part.id) -> None:
            share = n + STAGES[stage] / STAGES["quality page"]
            progress(f"{id_}: {stage}", round(100 * share), 100 * len(needles))

        found.append(_try_step(part, partial(_reconstruct_needle, search, part, report)))
    return tuple(found)


def _reconstruct_needle(search: VolumeSearch, scan: Scan, report: Callable[[str], None]) -> Result:
    found = examine(search.volume, scan, search.recipe, search, report)
    report("pictures")
    if found.error is None and found.reconstruction is not None:
        one = found.reconstruction
        place = one.patient, one.frame, one.needle_axis.points
        one = replace(one, views=render_views(search.volume, *place))
        if scan.corrections is None:
            return one
        moved = [name for name, places in vars(scan.corrections).items() if places is not None]
        return replace(one, warnings=(f"corrected by hand: {', '.join(moved)}", *one.warnings))
    failed = found.error or NeedlefitError("nothing was found", where=scan.volume)
    failed = explain_refusal(failed, search.volume)
    needle = None if found.needle_axis is None else found.needle_axis.points
    if needle is None and (tube := found.selection) is not None:  # about where it is
        axis = tube.axis
        needle = list_middles(tube.needle) if axis is None else axis.spline(np.arange(0.0, axis.length, 1.0))
    balls = np.empty((0, 3)) if found.markers is None else found.markers.centers
    entries, entry, listed = np.empty((0, 3)), found.entry, None
    if needle is not None and entry is not None:
        answers = entry.answers or (entry,)
        entries, places = interpolate_at_arc(needle, [answer.at for answer in answers]), {"tip": needle[-1]}
        for n, (answer, point) in enumerate(zip(answers, entries, strict=True), start=1):
            ends = interpolate_at_arc(needle, answer.guide or ())
            labels = f"guide {n} begins", f"guide {n} ends"
            places |= {f"entry {n}": point, **dict(zip(labels, ends, strict=False))}
        listed = Markups(
            Path(scan.id), f"{scan.id} entries", "Fiducial", tuple(places), np.array([*places.values()])
        )
    points = make_control_points(scan.id, needle, entries[0] if len(entries) else None, balls)
    picture = None if needle is None else picture_curve(search.volume, needle, entries)
    return ReconstructionFailure(scan, failed, points, listed, search.volume.warnings, picture, found.asked)


def _try_step(scan: Scan, work: Callable[[], T]) -> T | ReconstructionFailure:
    try:
        return work()
    except NeedlefitError as error:
        return ReconstructionFailure(scan, error)
