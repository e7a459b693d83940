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
from needlefit.imaging.volume import (
    ARCHIVE_SUFFIX,
    IMAGE_SUFFIXES,
    READABLE_VOLUMES,
    Volume,
    max_volume_bytes,
)
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
    with open_member(path, series) as place:
        if is_image_file(place):
            return read_image_file(place)[0]
        return _read("dicom:read_series", place, series=series)[0]


@contextmanager
def open_member(path: Path, series: str | None = None) -> Iterator[Path]:
    """Yield the path itself; of a .zip that of the image file in it, or of a folder with its DICOM files.

    Errors raised within the block name the archive. DataError if the archive is damaged, encrypted or too
    large, or holds several scans.
    """
    if not path.name.lower().endswith(ARCHIVE_SUFFIX):
        yield path
        return
    with TemporaryDirectory(prefix="needlefit-scan-") as name:
        arguments = {"path": str(path), "folder": name, "total_bytes": max_volume_bytes()}
        try:
            read_in_process(f"{__name__}:unpack_scan", path, arguments, seconds=READ_SECONDS)
            yield _choose_member(Path(name), series)
        except DataError as error:
            what, where = (text.replace(name, str(path)) for text in (error.what, error.where))
            raise error.replace(what=what, where=where or path) from None


def unpack_scan(_arrays: Arrays, path: str, folder: str, total_bytes: int) -> None:
    """Unpack the archive of a scan into a folder; called in the child process.

    `zipfile` writes nothing outside the folder, no links, and no more bytes of a file than stated.
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
    """Return the image file in the folder of an unpacked archive; the folder if it holds a DICOM series."""
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
    """Return the files that are read for a path.

    Of a folder: all files in it and its subfolders, sorted. Of a DICOM file: all files of its folder, sorted.
    Of a header with detached voxels: the header, and the file that it names. Else the file alone.
    """
    if is_dir(path):
        return list_files(path)
    if path.suffix.lower() in DETACHED_SUFFIXES:
        with open_regular(path, sys.maxsize) as content:
            stated = DATA_FILE.findall(content.read(MAX_HEADER_BYTES))
        return [path, *filter(is_file, (path.parent / os.fsdecode(name) for name in stated))]
    if not begins_as_dicom(path):
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
    with open_regular(path, sys.maxsize):  # no device or pipe
        return _read("image_files:read_image", path)


def _read(reader: str, path: Path, **arguments: str | None) -> tuple[Volume, dict[str, str]]:
    """Return the volume and the texts that a reader finds at a path.

    ConfigError if a package that reads scans, or finds layers in them, is not installed.
    """
    for name in CT_PACKAGES:
        if find_spec(name) is None:
            raise ConfigError(
                f"scans need the package {name}, which is not installed",
                expected="the packages of the extra `ct`",
                fix="pip install 'needlefit[ct]'",
            )
    arguments["path"] = str(path)
    (warnings, texts), arrays = read_in_process(
        f"needlefit.imaging.{reader}", path, arguments, seconds=READ_SECONDS
    )
    del arrays["size"]  # that of the values
    return Volume(**arrays, warnings=tuple(warnings)), texts
