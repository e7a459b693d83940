"""Send a scan with the bytes of its files to a machine that does not have them."""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from needlefit.errors import NeedlefitError
from needlefit.imaging.scan import Scan
from needlefit.imaging.volume import list_series_files

SINGLE_FILE_SUFFIXES = (".nrrd", ".nii", ".nii.gz", ".mha", ".zip")
"""Endings of volumes that are one file."""


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
    mask, markers, fiducials = (
        None if path is None else moved(path) for path in (scan.mask, scan.markers, scan.fiducials)
    )
    return replace(
        scan, volume=moved(scan.volume), mask=mask, markers=markers, fiducials=fiducials, surfaces=surfaces
    )
