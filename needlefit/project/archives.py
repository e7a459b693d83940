"""Unpack ZIP archives that a stranger may have made, into a temporary folder and within limits.

Every name is checked before anything is written, and every byte written is counted: an archive may state
other sizes than it has. Links are written as plain files, so that nothing leaves the folder.
"""

import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from needlefit.errors import DataError
from needlefit.project.input_files import open_regular

MAX_ARCHIVE_BYTES = 8 * 2**30  # size of an archive: it may hold more than what is unpacked of it
MAX_MEMBERS = 50_000  # files in an archive, those of archives inside it among them
MAX_MEMBER_NAME_CHARS = 500
READ_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""Packing that takes little memory, however the archive was made."""

_ENCRYPTED = 1
_BLOCK_BYTES = 2**20


@dataclass(frozen=True)
class ArchiveLimits:
    """What is unpacked of an archive, and what its errors say."""

    total_bytes: int  # size of all files that are unpacked
    suffixes: tuple[str, ...] = ()  # endings of the files that are unpacked; empty: all
    levels: int = 0  # levels of archives inside the archive that are unpacked, too
    # `expected`, `fix`: of errors
    expected: str = "a ZIP archive"
    fix: str = "pack the files again, or unpack them and name the folder"


def unpack_archive(path: Path, folder: Path, limits: ArchiveLimits) -> list[str]:
    """Unpack an archive into a folder; return the names of its files, sorted.

    An archive inside it becomes a folder of its name.

    DataError if it is damaged, encrypted, nested too deeply, holds too much, or names a file outside itself.
    """
    return sorted(_Unpacking(limits).unpack(path, folder, limits.levels))


@contextmanager
def name_archive(path: Path, folder: Path) -> Iterator[None]:
    """Let errors name the archive and its member, where they name an unpacked file."""
    try:
        yield
    except DataError as error:
        texts = {}
        for key in ("what", "where", "expected", "fix"):
            text = getattr(error, key).replace(f"{folder}/", f"{path}, ")
            texts[key] = text.replace(f"{folder}\\", f"{path}, ").replace(str(folder), str(path))
        raise DataError(**texts | {"where": texts["where"] or str(path)}) from None


class _Unpacking:
    """An archive with those inside it, whose files and bytes count together."""

    def __init__(self, limits: ArchiveLimits) -> None:
        self._limits, self._members, self._bytes = limits, 0, 0

    def unpack(self, path: Path, folder: Path, levels: int) -> list[str]:
        """Unpack one archive, with so many levels of archives inside it; return the names of its files."""
        names: list[str] = []
        with open_regular(path, MAX_ARCHIVE_BYTES) as file:
            try:
                with zipfile.ZipFile(file) as archive:
                    members = [one for one in archive.infolist() if not one.is_dir()]
                    self._check_members(members, path)
                    for one in members:
                        suffixes = self._limits.suffixes
                        if not suffixes or one.filename.lower().endswith(suffixes):
                            self._write_member(archive, one, folder, path)
                            names.append(one.filename)
            except DataError:
                raise
            except Exception as fault:  # zipfile and zlib raise whatever the bytes provoke
                raise self._error(path, f"is a damaged archive ({type(fault).__name__})") from None
        for name in [one for one in names if one.lower().endswith(".zip")]:  # a folder of its name
            inner = folder / name
            if not levels:
                raise self._error(inner, "is an archive inside too many others")
            packed = inner.rename(inner.with_name(f"{inner.name}.packed"))
            inner.mkdir()
            found = self.unpack(packed, inner, levels - 1)
            packed.unlink()
            names.remove(name)
            names += [f"{name}/{one}" for one in found]
        return names

    def _check_members(self, members: list[zipfile.ZipInfo], path: Path) -> None:
        self._members += len(members)
        if self._members > MAX_MEMBERS:
            raise self._error(path, f"holds {self._members} files")
        for one in members:
            name, shown = PurePosixPath(one.filename), f"{one.filename[:100]!r}"
            odd = "\\" in one.filename or ":" in one.filename or not one.filename.isprintable()
            if odd or name.is_absolute() or ".." in name.parts or len(one.filename) > MAX_MEMBER_NAME_CHARS:
                raise self._error(path, f"names a file outside itself: {shown}")
            if one.flag_bits & _ENCRYPTED:
                raise self._error(path, f"is encrypted: {shown}")
            if one.compress_type not in READ_METHODS:
                what = f"is packed by method {one.compress_type}, which is not read: {shown}"
                raise self._error(path, what)

    def _write_member(self, archive: zipfile.ZipFile, one: zipfile.ZipInfo, folder: Path, path: Path) -> None:
        place, most = folder / one.filename, self._limits.total_bytes
        place.parent.mkdir(parents=True, exist_ok=True)
        with archive.open(one) as source, place.open("xb") as target:
            while block := source.read(_BLOCK_BYTES):
                self._bytes += len(block)
                if self._bytes > most:
                    raise self._error(path, f"unpacks to more than {most / 2**20:.0f} MiB")
                target.write(block)

    def _error(self, path: Path, what: str) -> DataError:
        return DataError(what, where=str(path), expected=self._limits.expected, fix=self._limits.fix)
