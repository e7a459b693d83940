"""Reconstruct many scans, in one process or several.

A scan that is refused does not stop the others; an error of the program does. Reconstructed scans are kept in
a checkpoint.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from operator import attrgetter
from pathlib import Path

from needlefit.datasets.formats.markups import Markups
from needlefit.errors import DataError, NeedlefitError, located
from needlefit.geometry.curves import arc_length, interpolate_at_arc
from needlefit.imaging.constants import PART
from needlefit.imaging.corrections import make_control_points
from needlefit.imaging.needle.follow import list_middles
from needlefit.imaging.needle.segmentation import list_needles
from needlefit.imaging.reconstruct import STAGES, Examination, VolumeSearch, examine
from needlefit.imaging.reconstruction import CurvePicture, Reconstruction, picture_curve
from needlefit.imaging.scans import Scan
from needlefit.imaging.volume import Volume, explain_refusal
from needlefit.imaging.volume_files import read_volume
from needlefit.project.callbacks import Progress, Stop, never_stop, no_progress
from needlefit.project.checkpoint import NO_CHECKPOINT, Checkpoint
from needlefit.project.processes import one_thread
from needlefit.project.tasks import THIS_PROCESS, LocalPool, TaskPool
from needlefit.schemas.reconstruction import ReconstructionRecord

VERSIONED_PACKAGES = ("numpy", "scipy", "SimpleITK", "pydicom", "scikit-image", "trimesh")


@dataclass(frozen=True)
class ReconstructionFailure:
    """A scan that could not be reconstructed, and why."""

    scan: Scan
    error: NeedlefitError
    points: Markups | None = None  # control points of what was found in it, LPS, mm
    entries: Markups | None = None  # the tip, the entries to choose from and faces of guides, likewise
    warnings: tuple[str, ...] = ()  # what a person should know of the scan's files
    picture: CurvePicture | None = None  # of what was taken for the needle


def divide_scan(search: VolumeSearch, scan: Scan) -> tuple[Scan, ...]:
    """Return one scan for each needle that a scan holds, `ID-1`, `ID-2`, ... along L; itself if there is one.

    So is one of which something is stated that only one needle has, or in which nothing is found.
    """
    of_one_needle = (scan.needle_at, scan.stage, scan.corrections.get(scan.id), scan.mask)
    if any(stated is not None for stated in of_one_needle):
        return (scan,)
    with suppress(NeedlefitError):  # its reconstruction says why
        tubes = list_needles(search.tubes, search.recipe.needle.diameter_mm, PART.DIVIDED_NEEDLE)
        middles = [line[len(line) // 2] for line in map(list_middles, tubes)]
        if len(middles) > 1:
            return tuple(
                replace(scan, id=f"{scan.id}-{n}", needle_at=middle, divided=len(tubes))
                for n, middle in enumerate(sorted(middles, key=lambda middle: float(middle[0])), start=1)
            )
    return (scan,)


Result = Reconstruction | ReconstructionFailure


@dataclass(frozen=True)
class ScanResults:
    """The results of the needles of one scan."""

    needles: tuple[Result, ...]


def reconstruct_all(
    scans: Sequence[Scan],
    recipe: ReconstructionRecord,
    every: bool = False,
    pool: TaskPool = THIS_PROCESS,
    progress: Progress = no_progress,
    stop: Stop = never_stop,
    checkpoint: Checkpoint = NO_CHECKPOINT,
    name_work: Callable[[Scan], str] = attrgetter("id"),
) -> tuple[tuple[Result, ...], ...]:
    """Return for every scan, in their order, the reconstruction or failure of its needle, or of each needle.

    Of fewer scans after a stop.

    `every`: whether each needle of a scan is reconstructed.
    `pool`: where scans are reconstructed; each takes several times its own memory.
    `progress`: called with a scan and its stage, and percent done, of 100 a scan.
    `stop`: whether to begin no further scan.
    `checkpoint`: keeps the results of finished scans, which are not made again, by what `name_work` returns.
    """
    works = [name_work(scan) for scan in scans]
    kept = [checkpoint.read(work, ScanResults) for work in works]
    found = {n: results.needles for n, results in enumerate(kept) if results is not None}
    todo = [n for n in range(len(scans)) if n not in found]

    def report(stage: str, done: int = 0, total: int = 1) -> None:
        share = (len(found) + done / total) * STAGES["quality page"]
        progress(stage, round(share), 100 * len(scans))

    report("reconstructing")
    work = partial(reconstruct_needles, recipe=recipe, every=every)
    if isinstance(pool, LocalPool) and (pool.size == 1 or len(todo) == 1):
        work = partial(work, progress=report)  # not from other processes
    for place, needles in pool.run(work, [scans[n] for n in todo], stop):
        n = todo[place]
        found[n] = needles
        # what is refused may not be, once the reader that it lacks is installed
        if all(isinstance(result, Reconstruction) for result in needles):
            checkpoint.keep(works[n], ScanResults(needles))
        report(scans[n].id)
    return tuple(found[n] for n in sorted(found))


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
    try:
        search = VolumeSearch(read_volume(scan.volume, scan.series), recipe)
        needles = divide_scan(search, scan) if every else (scan,)
        ids = [needle.id for needle in needles]
        if unknown := {*scan.answers, *scan.corrections} - {*ids}:
            raise DataError(
                f"holds the needles {', '.join(ids)}, and not {', '.join(sorted(unknown))}",
                expected="answers and corrections that name a needle each",
                fix=f"state its needle: --confirm {ids[0]}:entry=1, or {ids[0]}.corrections.mrk.json",
                where=scan.volume,
            )
    except NeedlefitError as error:
        return (ReconstructionFailure(scan, error),)
    results = list[Result]()
    for n, (id_, needle) in enumerate(zip(ids, needles, strict=True)):

        def report(stage: str, n: int = n, id_: str = id_) -> None:
            share = n + STAGES[stage] / STAGES["quality page"]
            progress(f"{id_}: {stage}", round(100 * share), 100 * len(needles))

        found = Examination(needle)
        try:
            with located(scan.volume):
                results.append(examine(found, search, report))
        except NeedlefitError as error:
            results.append(_describe_failure(search.volume, found, error))
    return tuple(results)


def _describe_failure(volume: Volume, found: Examination, error: NeedlefitError) -> ReconstructionFailure:
    """Return why a scan is refused, with what was found in it as points and in a picture."""
    scan, needle, answers = found.scan, found.curve, found.choice.entries
    refused = ReconstructionFailure(scan, explain_refusal(error, volume), warnings=volume.warnings)
    if needle is None:
        return refused
    along = {"tip": float(arc_length(needle)[-1])}
    for n, answer in enumerate(answers, start=1):
        along[f"entry {n}"] = answer.at
        if answer.guide is not None:
            along[f"guide {n} begins"], along[f"guide {n} ends"] = answer.guide
    points = interpolate_at_arc(needle, [*along.values()])
    entries = interpolate_at_arc(needle, [answer.at for answer in answers])
    return replace(
        refused,
        points=make_control_points(scan.id, needle, next(iter(entries), None), found.markers),
        entries=Markups(Path(scan.id), f"{scan.id} entries", "Fiducial", tuple(along), points),
        picture=picture_curve(volume, needle, entries),
    )
