"""Unpack ZIP archives that a stranger may have made, into a temporary folder and within limits.

`zipfile` writes no member outside the folder, no links, and of each no more bytes than the archive states.
"""

import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from needlefit.errors import DataError, refusal
from needlefit.project.input_files import open_regular

MAX_ARCHIVE_BYTES = 8 * 2**30  # size of an archive: it may hold more than what is unpacked of it
MAX_MEMBERS = 50_000  # files in an archive

_ENCRYPTED = 1  # a bit of the flags of a member


def unpack_archive(path: Path, folder: Path, total_bytes: int, levels: int, fix: str) -> int:
    """Unpack an archive of at most `total_bytes` into a folder; return how many bytes were unpacked.

    An archive inside it becomes a folder of its name, down to so many levels. DataError, with `fix`, if the
    archive is encrypted, nested too deeply or holds too much; what `zipfile` raises if it is damaged.
    """

    def error(what: str) -> DataError:
        return refusal(f"""{what}
            expected: a ZIP archive of one scan
            fix: {fix}
            where: {path}""")

    with open_regular(path, MAX_ARCHIVE_BYTES) as file, zipfile.ZipFile(file) as archive:
        members = archive.infolist()
        size = sum(one.file_size for one in members)
        if size > total_bytes:
            raise error(f"unpacks to more than {total_bytes / 2**20:.0f} MiB")
        if len(members) > MAX_MEMBERS:
            raise error(f"holds {len(members)} files")
        if any(one.flag_bits & _ENCRYPTED for one in members):
            raise error("is encrypted")
        unpacked = [Path(archive.extract(one, folder)) for one in members if not one.is_dir()]
    for inner in (one for one in unpacked if one.name.lower().endswith(".zip")):
        if not levels:
            raise error("has archives inside archives, too many")
        packed = inner.rename(inner.with_name(f"{inner.name}.packed"))
        size += unpack_archive(packed, inner, total_bytes - size, levels - 1, fix)
        packed.unlink()
    return size


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
