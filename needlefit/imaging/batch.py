"""Many scans, one after the other or side by side; one that fails loses nothing of the others."""

import hashlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path

from needlefit.errors import DataError, NeedlefitError
from needlefit.geometry.surfaces import Surface, Triangles, from_triangles, to_triangles
from needlefit.imaging.reconstruct import reconstruct
from needlefit.imaging.reconstruction import Reconstruction
from needlefit.imaging.scan import Scan
from needlefit.project.encode import Arrays, Hook, Hooks, decode, encode
from needlefit.project.kept import Kept, read_kept, set_aside, write_kept
from needlefit.project.processes import in_processes
from needlefit.project.records.reconstruction import ReconstructionRecord
from needlefit.project.watching import Note, Progress, Stop, never, silent, unheard

WHOLE = (".nrrd", ".nii", ".nii.gz", ".mha")
"""Endings of volumes that are one file."""

KIND = "reconstruction"
"""Of the files in which finished ones are kept."""

_HOOKS: Hooks = {Surface: Hook(to_triangles, from_triangles, Triangles)}

PACKAGES = ("numpy", "scipy", "SimpleITK", "pydicom", "scikit-image", "trimesh")


@dataclass(frozen=True)
class Failure:
    """A scan that could not be reconstructed, and why."""

    scan: Scan
    error: NeedlefitError


@dataclass(frozen=True)
class Batch:
    """How many scans are worked on.

    Attributes
    ----------
    jobs : int
        At once; each takes as much memory as its volume, several times.
    keep : Path or None
        A folder for what is finished.
    resume : bool
        Whether what is kept there of the same scans, files and versions is taken as it is.
    progress : callable
        Told which scan was finished, how many are, and of how many.
    stop : callable
        Whether to begin no further scan.
    note : callable
        Given a line about what is kept and damaged.
    """

    jobs: int = 1
    keep: Path | None = None
    resume: bool = False
    progress: Progress = silent
    stop: Stop = never
    note: Note = unheard


def reconstruct_all(
    scans: Sequence[Scan], recipe: ReconstructionRecord, batch: Batch
) -> tuple[Reconstruction | Failure, ...]:
    """Return what came of every scan, in their order; where `batch.stop` said so, of fewer."""
    found: dict[int, Reconstruction | Failure] = {}
    for n, scan in enumerate(scans):
        kept = _kept(scan, recipe, batch)
        if kept is not None:
            found[n] = kept
    left = [n for n in range(len(scans)) if n not in found]
    batch.progress("reconstructing", len(found), len(scans))
    work = partial(attempt, recipe=recipe)
    for at, one in in_processes(work, [scans[n] for n in left], batch.jobs, batch.stop):
        found[left[at]] = one
        if isinstance(one, Reconstruction):
            _keep(one, recipe, batch)
        batch.progress(scans[left[at]].id, len(found), len(scans))
    return tuple(found[n] for n in sorted(found))


def attempt(scan: Scan, recipe: ReconstructionRecord) -> Reconstruction | Failure:
    """Return the reconstruction of a scan, or why there is none."""
    try:
        return reconstruct(scan, recipe)
    except NeedlefitError as error:
        return Failure(scan, error)
    except Exception as error:  # what nobody foresaw in one scan must not cost the others their results
        what = f"unexpected {type(error).__name__}: {error}"
        return Failure(scan, NeedlefitError(what, where=str(scan.volume)))


def _kept(scan: Scan, recipe: ReconstructionRecord, batch: Batch) -> Reconstruction | None:
    """Return what is kept of a scan; None if nothing, of another scan or recipe, or damaged."""
    if batch.keep is None or not batch.resume or not _file(scan, batch.keep).is_file():
        return None
    file = _file(scan, batch.keep)
    try:
        kept = read_kept(file, KIND, _stamp(scan, recipe))
        return None if kept is None else replace(_decoded(kept, file), scan=scan)
    except DataError:
        batch.note(f"{file} was damaged: it is now {set_aside(file).name}; {scan.id} is reconstructed again")
        return None


def _keep(one: Reconstruction, recipe: ReconstructionRecord, batch: Batch) -> None:
    if batch.keep is None:
        return
    arrays: Arrays = {}
    values = {KIND: encode(one, _HOOKS, arrays)}
    write_kept(_file(one.scan, batch.keep), KIND, _stamp(one.scan, recipe), Kept(values, arrays))


def _decoded(kept: Kept, file: Path) -> Reconstruction:
    """Return the reconstruction that a file keeps; DataError if it keeps none."""
    try:
        one = decode(Reconstruction, kept.values.get(KIND), _HOOKS, kept.arrays)
    except (ValueError, TypeError, IndexError, OverflowError) as error:
        raise DataError(f"holds no reconstruction: {error}", where=str(file)) from None
    if not isinstance(one, Reconstruction):
        raise DataError("holds no reconstruction", where=str(file))
    return one


def _file(scan: Scan, keep: Path) -> Path:
    return keep / f"{scan.id}.kept"


def _stamp(scan: Scan, recipe: ReconstructionRecord) -> str:
    """Return a digest of all that decides a reconstruction; of files their size and time."""
    arrays: Arrays = {}
    plain = json.dumps([encode(scan, _HOOKS, arrays), [[name, one.tolist()] for name, one in arrays.items()]])
    parts = [plain, recipe.model_dump_json(), *(version(name) for name in ("needlefit", *PACKAGES))]
    for path in sorted(set(_files(scan))):
        status = path.stat()
        parts.append(f"{path} {status.st_size} {status.st_mtime_ns}")
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()


def _files(scan: Scan) -> Iterator[Path]:
    """Yield every file that a reconstruction may read.

    One slice stands for its series, and a header for the file of its voxels: all files of the folder count.
    """
    given = (scan.mask, scan.markers, scan.fiducials, *(one.path for one in scan.surfaces))
    yield from (path for path in given if path is not None)
    alone = scan.volume.name.lower().endswith(WHOLE)
    folder = scan.volume if scan.volume.is_dir() else scan.volume.parent
    yield from [scan.volume] if alone else (path for path in folder.iterdir() if path.is_file())
