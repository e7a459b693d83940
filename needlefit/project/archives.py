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

MAX_ARCHIVE_BYTES = 8 * 2**30
"""Size of an archive: it may hold more than what is unpacked of it."""

MAX_MEMBERS = 50_000
"""Files in an archive, those of archives inside it among them."""

MAX_MEMBER_NAME_CHARS = 500
READ_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""Packing that takes little memory, however the archive was made."""

_ENCRYPTED = 1
_BLOCK_BYTES = 2**20


@dataclass(frozen=True)
class ArchiveLimits:
    """What is unpacked of an archive, and what its errors say.

    Attributes
    ----------
    total_bytes : int
        Size of all files that are unpacked.
    suffixes : tuple of str
        Endings of the files that are unpacked; empty: all.
    levels : int
        Levels of archives inside the archive that are unpacked, too.
    expected, fix : str
        Of errors.
    """

    total_bytes: int
    suffixes: tuple[str, ...] = ()
    levels: int = 0
    expected: str = "a ZIP archive"
    fix: str = "pack the files again, or unpack them and name the folder"


@dataclass
class _Count:
    members: int = 0
    bytes: int = 0


def unpack_archive(path: Path, folder: Path, limits: ArchiveLimits) -> list[str]:
    """Unpack an archive into a folder; return the names of its files, sorted.

    An archive inside it becomes a folder of its name.

    Raises
    ------
    DataError
        If it is damaged, encrypted, nested too deeply, holds too much, or names a file outside itself.
    """
    names: list[str] = []
    _unpack(path, folder, limits, names, _Count())
    return sorted(names)


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
        raise DataError(
            texts["what"],
            where=texts["where"] or str(path),
            expected=texts["expected"],
            fix=texts["fix"],
        ) from None


def _unpack(path: Path, folder: Path, limits: ArchiveLimits, names: list[str], count: _Count) -> None:
    with open_regular(path, MAX_ARCHIVE_BYTES) as file:
        try:
            with zipfile.ZipFile(file) as archive:
                members = [one for one in archive.infolist() if not one.is_dir()]
                count.members += len(members)
                _check_members(members, path, limits, count)
                for one in members:
                    if not limits.suffixes or one.filename.lower().endswith(limits.suffixes):
                        _write_member(archive, one, folder, path, limits, count)
                        names.append(one.filename)
        except DataError:
            raise
        except Exception as fault:  # zipfile and zlib raise whatever the bytes provoke
            raise _archive_error(path, limits, f"is a damaged archive ({type(fault).__name__})") from None
    for inner in [one.filename for one in members if one.filename.lower().endswith(".zip")]:
        if inner in names:
            _unpack_inner(folder / inner, inner, limits, names, count)


def _unpack_inner(file: Path, name: str, limits: ArchiveLimits, names: list[str], count: _Count) -> None:
    """Replace an unpacked archive by a folder of its name with its files."""
    if not limits.levels:
        raise _archive_error(file, limits, "is an archive inside too many others")
    packed = file.rename(file.with_name(f"{file.name}.packed"))
    file.mkdir()
    inner: list[str] = []
    deeper = ArchiveLimits(
        limits.total_bytes, limits.suffixes, limits.levels - 1, limits.expected, limits.fix
    )
    _unpack(packed, file, deeper, inner, count)
    packed.unlink()
    names.remove(name)
    names += [f"{name}/{one}" for one in inner]


def _check_members(members: list[zipfile.ZipInfo], path: Path, limits: ArchiveLimits, count: _Count) -> None:
    if count.members > MAX_MEMBERS:
        raise _archive_error(path, limits, f"holds {count.members} files")
    for one in members:
        name = PurePosixPath(one.filename)
        odd = "\\" in one.filename or ":" in one.filename or not one.filename.isprintable()
        if odd or name.is_absolute() or ".." in name.parts or len(one.filename) > MAX_MEMBER_NAME_CHARS:
            raise _archive_error(path, limits, f"names a file outside itself: {one.filename[:100]!r}")
        if one.flag_bits & _ENCRYPTED:
            raise _archive_error(path, limits, f"is encrypted: {one.filename[:100]!r}")
        if one.compress_type not in READ_METHODS:
            what = f"is packed by method {one.compress_type}, which is not read: {one.filename[:100]!r}"
            raise _archive_error(path, limits, what)


def _write_member(
    archive: zipfile.ZipFile,
    one: zipfile.ZipInfo,
    folder: Path,
    path: Path,
    limits: ArchiveLimits,
    count: _Count,
) -> None:
    place = folder / one.filename
    place.parent.mkdir(parents=True, exist_ok=True)
    with archive.open(one) as source, place.open("xb") as target:
        while block := source.read(_BLOCK_BYTES):
            count.bytes += len(block)
            if count.bytes > limits.total_bytes:
                most = limits.total_bytes / 2**20
                raise _archive_error(path, limits, f"unpacks to more than {most:.0f} MiB")
            target.write(block)


def _archive_error(path: Path, limits: ArchiveLimits, what: str) -> DataError:
    return DataError(what, where=str(path), expected=limits.expected, fix=limits.fix)
