"""Read CT volumes: DICOM series, NRRD, NIfTI and MetaImage files, and ZIP archives of them."""

import os
import re
import sys
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

from needlefit.errors import ConfigError, DataError
from needlefit.imaging.volume import ARCHIVE_SUFFIX, IMAGE_SUFFIXES, READABLE_VOLUMES, Volume, max_voxels
from needlefit.project.folders import MAX_LISTED_FILES
from needlefit.project.input_files import is_dir, is_file, list_files, open_regular, path_exists
from needlefit.project.reader_process import MEMORY_VARIABLE, Arrays, read_in_process

CT_PACKAGES = ("SimpleITK", "pydicom", "nibabel", "skimage")
MAX_HEADER_BYTES = 2**16  # part of an image file (bytes) that is searched as its header, a text
DETACHED_SUFFIXES = (".nhdr", ".mhd")
DATA_FILE = re.compile(rb"^(?:data ?file|ElementDataFile)\s*[:=]\s*(.*\S)", re.IGNORECASE | re.MULTILINE)
READ_SECONDS = 600.0  # longest processor time (s) in which a file must be read: a damaged one may never end


def read_volume(path: Path, series: str | None = None) -> Volume:
    """Read the volume in a file or folder; its geometry is checked first.

    `path`: a folder with a DICOM series in it or below, one file of the series, an NRRD, NIfTI or MetaImage
    file, or a .zip of any of these.
    `series`: number or UID of the DICOM series, where a folder holds several; an image file has none.

    DataError if there is no such volume, or its geometry cannot be trusted; nothing is guessed. ConfigError
    if the packages that read scans are not installed.
    """
    if not path_exists(path):
        problem = "there is no such file or folder"
        raise DataError(problem, expected=READABLE_VOLUMES, fix="check the path", where=path)
    require_packages()
    with open_member(path, series) as place:
        if is_image_file(place):
            return read_image_file(place)[0]
        arguments = {"path": str(place), "series": series}
        reader = "needlefit.imaging.dicom:read_series"
        notes, arrays = read_in_process(reader, place, arguments, seconds=READ_SECONDS)
        return Volume(**arrays, warnings=tuple(notes))


@contextmanager
def open_member(path: Path, series: str | None = None) -> Iterator[Path]:
    """Yield a path; of a .zip the one image file in it, or a folder with its DICOM files.

    Errors then name the archive. DataError if it is damaged, encrypted or too large, or holds another, or
    several scans.
    """
    if not path.name.lower().endswith(ARCHIVE_SUFFIX):
        yield path
        return
    with TemporaryDirectory(prefix="needlefit-scan-") as name:
        arguments = {"path": str(path), "folder": name, "total_bytes": 4 * max_voxels()}
        try:
            read_in_process(f"{__name__}:unpack_scan", path, arguments, seconds=READ_SECONDS)
            yield _choose_member(Path(name), series)
        except DataError as error:
            what, where = (text.replace(name, str(path)) for text in (error.what, error.where))
            raise error.replace(what=what, where=where or path) from None


def unpack_scan(_arrays: Arrays, path: str, folder: str, total_bytes: int) -> None:
    """Unpack the archive of a scan; in the child process.

    `zipfile` writes no member outside the folder, no links, and of each no more bytes than the archive
    states.
    """
    with open_regular(Path(path), sys.maxsize) as file, zipfile.ZipFile(file) as archive:
        members = archive.infolist()
        size = sum(member.file_size for member in members)
        is_encrypted = any(member.flag_bits & 1 for member in members)
        if is_encrypted or size > total_bytes:
            raise DataError(
                "is encrypted" if is_encrypted else f"unpacks to more than {total_bytes / 2**20:.0f} MiB",
                expected="a ZIP archive of one scan",
                fix="pack it again, or unpack it and name the folder; "
                f"{MEMORY_VARIABLE} grants more than the default",
                where=path,
            )
        archive.extractall(folder)


def _choose_member(folder: Path, series: str | None) -> Path:
    """Return what is meant in an unpacked archive: an image file, or the folder of a DICOM series."""
    files = list_files(folder)
    images = [file for file in files if is_image_file(file)]
    if series is not None or not images:
        return folder
    if len(images) > 1 or any(map(begins_as_dicom, files)):
        names = ", ".join(str(file.relative_to(folder)) for file in files[:MAX_LISTED_FILES])
        raise DataError(
            f"holds {len(files)} files: {names}",
            expected="one image file, or DICOM files alone",
            fix="unpack it and name the scan's file or folder; of DICOM give the series with --series",
            where=folder,
        )
    return images[0]


def list_series_files(path: Path) -> list[Path]:
    """Return the files that may be read for a path, sorted: in and below a folder, or beside a DICOM file.

    A header with detached voxels is followed by the file that it names.
    """
    if is_dir(path):
        return list_files(path)
    if path.suffix.lower() in DETACHED_SUFFIXES:
        with open_regular(path, sys.maxsize) as content:
            stated = DATA_FILE.findall(content.read(MAX_HEADER_BYTES))
        return [path, *filter(is_file, (path.parent / os.fsdecode(name) for name in stated))]
    if path.name.lower().endswith((*IMAGE_SUFFIXES, ARCHIVE_SUFFIX)) or not begins_as_dicom(path):
        return [path]
    return sorted(file for file in path.parent.iterdir() if is_file(file) and file.name[0] != ".")


def begins_as_dicom(path: Path) -> bool:
    """Return whether a file begins like a DICOM file: with a preamble of 128 bytes, and its name."""
    with open_regular(path, sys.maxsize) as content:
        return content.read(132).endswith(b"DICM")


def is_image_file(place: Path) -> bool:
    """Return whether a path is, by its name, an image file rather than DICOM."""
    return place.name.lower().endswith(IMAGE_SUFFIXES)


def read_image_file(path: Path) -> tuple[Volume, dict[str, str]]:
    """Read the volume in an image file, and the texts of its header about segments.

    DataError and ConfigError as `read_volume`.
    """
    require_packages()
    with open_regular(path, sys.maxsize):  # no device or pipe
        reader = "needlefit.imaging.image_files:read_image"
        header, arrays = read_in_process(reader, path, {"path": str(path)}, seconds=READ_SECONDS)
        return Volume(**arrays, warnings=tuple(header["warnings"])), header["texts"]


def require_packages() -> None:
    """Raise ConfigError if a package that reads scans, or finds layers in them, is not installed."""
    for name in CT_PACKAGES:
        if find_spec(name) is None:
            raise ConfigError(
                f"scans need the package {name}, which is not installed",
                expected="the packages of the extra `ct`",
                fix="pip install 'needlefit[ct]'",
            )
