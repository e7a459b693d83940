"""Unpack ZIP archives that a stranger may have made, into a temporary folder and within limits.

`zipfile` writes no member outside the folder, no links, and of each no more bytes than the archive states.
"""

import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from needlefit.errors import DataError
from needlefit.project.input_files import open_regular

MAX_ARCHIVE_BYTES = 8 * 2**30  # size of an archive: it may hold more than what is unpacked of it
MAX_MEMBERS = 50_000  # files in an archive

_ENCRYPTED = 1  # a bit of the flags of a member


def unpack_archive(path: Path, folder: Path, total_bytes: int, fix: str) -> None:
    """Unpack an archive of at most `total_bytes` into a folder.

    DataError, with `fix`, if the archive is encrypted, holds another archive or too much; what `zipfile`
    raises if it is damaged.
    """

    def error(problem: str) -> DataError:
        return DataError(problem, expected="a ZIP archive of one scan", fix=fix, where=path)

    with open_regular(path, MAX_ARCHIVE_BYTES) as file, zipfile.ZipFile(file) as archive:
        members = archive.infolist()
        if sum(member.file_size for member in members) > total_bytes:
            raise error(f"unpacks to more than {total_bytes / 2**20:.0f} MiB")
        if len(members) > MAX_MEMBERS:
            raise error(f"holds {len(members)} files")
        if any(member.flag_bits & _ENCRYPTED for member in members):
            raise error("is encrypted")
        if any(member.filename.lower().endswith(".zip") for member in members):
            raise error("holds an archive inside the archive")
        archive.extractall(folder)


@contextmanager
def name_archive(path: Path, folder: Path) -> Iterator[None]:
    """Let errors name the archive and its member, where they name an unpacked file."""
    try:
        yield
    except DataError as error:
        texts = {
            key: text.replace(f"{folder}/", f"{path}, ").replace(str(folder), str(path))
            for key, text in vars(error).items()
        }
        raise DataError(**texts | {"where": texts["where"] or str(path)}) from None
