"""Which folders needlefit may replace or remove: those that carry its stamp, and hold nothing foreign.

The stamp, `needlefit.json`, lists the files that were written with it and their SHA-256. Any other file, a
listed one that was changed since (but `timing.json`), every link and every other empty folder are foreign:
they are somebody's work.
In a checkpoint, which grows while a run goes on, the stamp stands for the few names that a run uses there.
"""

import json
import os
import re
import stat
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path, PurePosixPath
from typing import Any, Literal

from needlefit.errors import ConfigError, DataError
from needlefit.project.files import remove_folder, sha256
from needlefit.project.input_files import read_bytes, read_json
from needlefit.project.outputs import require_writable
from needlefit.project.progress import Note

STAMP = "needlefit.json"

FORMAT = 1

FolderKind = Literal["result", "checkpoint"]

FILE_MANAGER_FILES = frozenset({".DS_Store", "Thumbs.db", "desktop.ini"})
"""What a file manager leaves in a folder that it shows; nobody's work."""

TIMING_FILE = "timing.json"
"""The one file of a result that differs from run to run; without its digest the stamp does not."""

MAX_LISTED_FILES = 5
"""Foreign files that a message names."""

_CHECKPOINT = re.compile(
    r"(lock|[0-9a-f]{16}\.jsonl|[0-9a-f]{16}\.posterior/\d{5}\.(checkpoint|kept|h5)|[^/]+\.(checkpoint|kept))(\.damaged-\d+)?"
    r"|([^/]+/)?\.[^/]+\.needlefit-[^/]+/.*"
)
"""Files of a checkpoint: those of runs and of reconstructions, what was damaged, and, as a kill leaves them,
those that were not written whole."""


_BEGUN = re.compile(r"lock|\.needlefit\.json\.needlefit-[^/]+/(lock|lock\.new|new/needlefit\.json)")
"""Files of a checkpoint that has no stamp yet."""

_CHECKPOINT_FOLDER = re.compile(r"[0-9a-f]{16}\.posterior|([^/]+/)?\.[^/]+\.needlefit-[^/]+(/.*)?")
"""Folders of a checkpoint, which may be empty."""

MAX_STAMP_BYTES = 2**20
"""Size of a stamp of a checkpoint, which has a hundred bytes."""

_LOCK_TEXT, _MAX_LOCK_BYTES = re.compile(rb"\d* ?[0-9a-f]{0,16}\n?"), 64
"""What the lock of a checkpoint holds: nothing at first, then the process that has it, perhaps cut short."""


def write_stamp(folder: Path) -> None:
    """Write the stamp of a result: all that lies in `folder` is from here on known to be needlefit's."""
    files = {
        name: None if name == TIMING_FILE else sha256(folder / name)
        for name in list_readable_files(folder)
        if name != STAMP
    }
    _write(folder / STAMP, {"holds": "result", "files": files})


def checkpoint_stamp(work: str) -> str:
    """Return the text of a checkpoint's stamp; `work` is the digest of what it is of."""
    return _text({"holds": "checkpoint", "work": work})


def read_stamp(folder: Path) -> dict[str, Any]:
    """Return what the stamp of a folder says.

    Raises
    ------
    DataError
        If there is none, or it is damaged.
    """
    path = folder / STAMP
    table = {} if path.is_symlink() else read_json(path)
    if isinstance(table, dict) and table.get("program") == "needlefit" and table.get("format") == FORMAT:
        return table
    raise DataError("is not a stamp of needlefit", where=str(path), expected=f"one of format {FORMAT}")


def find_foreign(folder: Path, holds: FolderKind = "result") -> list[str]:
    """Return what lies in a folder that needlefit did not write, each with the reason; empty if nothing does.

    Links are not followed.

    Raises
    ------
    ConfigError
        If the folder cannot be looked into.
    """
    names = [name for name in list_readable_files(folder) if Path(name).name not in FILE_MANAGER_FILES]
    if holds == "checkpoint":
        faults = _foreign_in_checkpoint(folder, names)
        return [*faults, *_empty_folders(folder, names, _CHECKPOINT_FOLDER.fullmatch)]
    listed = listed_files(folder)
    written = [name for name in names if name != STAMP] if listed else names
    faults = [fault for name in written if (fault := _fault(folder, name, listed))]
    parents = {str(parent) for name in listed for parent in PurePosixPath(name).parents}
    return [*faults, *_empty_folders(folder, names, parents.__contains__)]


def listed_files(folder: Path) -> dict[str, Any]:
    """Return the files that the stamp of a result lists, with their digests; none without a stamp."""
    try:
        listed = read_stamp(folder).get("files")
    except DataError:
        return {}
    return listed if isinstance(listed, dict) else {}


def changed_files(folder: Path) -> list[str]:
    """Return the files that were changed since the stamp of a result was written; none without a stamp."""
    listed = listed_files(folder)
    return [name for name in list_readable_files(folder) if name in listed and _fault(folder, name, listed)]


def require_replaceable(folder: Path) -> None:
    """Raise ConfigError unless a result may be written to `folder`: missing, empty, or needlefit's own."""
    require_writable(folder)  # first: it also sees names that the system does not take
    _require_own(folder.resolve(), "result")


def require_own_checkpoint(folder: Path) -> None:
    """Raise ConfigError unless a checkpoint may be kept in `folder`; else as `require_replaceable`."""
    require_writable(folder)
    _require_own(folder.resolve(), "checkpoint")


def remove_result(folder: Path, note: Note) -> None:
    """Remove the result of an earlier run, if there is one; where it holds anything foreign it stays."""
    if not folder.is_dir():
        return
    try:
        faults = find_foreign(folder)
    except ConfigError as error:
        faults = [str(error)]
    if faults:
        note(f"{folder} of an earlier run is not removed: it holds {', '.join(faults[:MAX_LISTED_FILES])}")
        return
    with suppress(OSError):  # what stays has its stamp still: the next run removes it
        remove_folder(folder, (STAMP,))


def not_replaced_error(folder: Path, faults: list[str]) -> ConfigError:
    """Return what is raised of a folder that holds what is foreign."""
    more = len(faults) - MAX_LISTED_FILES
    named = ", ".join(faults[:MAX_LISTED_FILES]) + (f" and {more} more" if more > 0 else "")
    return ConfigError(
        f"is not replaced: needlefit did not write this in it, or it was changed since: {named}",
        where=str(folder),
        expected=f"no such folder, an empty one, or one that holds only what its {STAMP} lists, unchanged",
        fix="move those files away, or choose another folder with --out",
    )


def list_readable_files(folder: Path) -> list[str]:
    """Return the files in a folder and those below, and links to whatever, relative to it, sorted.

    Raises
    ------
    ConfigError
        If a folder cannot be looked into.
    """
    return sorted(path.relative_to(folder).as_posix() for path in _entries(folder))


def _entries(folder: Path) -> Iterator[Path]:
    def fail(fault: OSError) -> None:
        reason = fault.strerror or type(fault).__name__
        raise ConfigError(
            f"cannot be looked into: {reason}", where=str(fault.filename), fix="check its permissions"
        )

    for place, folders, files in os.walk(folder, onerror=fail):  # follows no link
        yield from (Path(place, name) for name in files)
        yield from (Path(place, name) for name in folders if Path(place, name).is_symlink())


def _require_own(folder: Path, holds: FolderKind) -> None:
    if not folder.exists() and not folder.is_symlink():
        return
    faults = find_foreign(folder, holds) if folder.is_dir() else ["it is a file"]
    if faults:
        raise not_replaced_error(folder, faults)


def _foreign_in_checkpoint(folder: Path, names: list[str]) -> list[str]:
    """Return all names where there is no stamp, however damaged; else those that no run gives.

    A run that ended before its stamp was written leaves its lock, and the stamp half written beside it.
    """
    if not _is_checkpoint_stamp(folder / STAMP):
        return [] if is_lock_only(folder) else names
    return [
        name
        for name in names
        if name != STAMP and not (_CHECKPOINT.fullmatch(name) and _is_file(folder / name))
    ]


def _empty_folders(folder: Path, names: Iterable[str], is_own: Callable[[str], object]) -> list[str]:
    """Return the outermost folders below one that hold no file, and that needlefit does not make.

    They vanish when their folder is replaced, and may be meant to be filled.
    """
    filled = {parent for name in names for parent in PurePosixPath(name).parents}
    found: list[PurePosixPath] = []
    for place, folders, _ in os.walk(folder):
        for name in sorted(folders):
            path = PurePosixPath(Path(place, name).relative_to(folder).as_posix())
            empty = path not in filled and not Path(place, name).is_symlink() and not is_own(str(path))
            if empty and not any(above in found for above in path.parents):
                found.append(path)
    return sorted(f"{path}/ (an empty folder)" for path in found)


def _fault(folder: Path, name: str, listed: dict[str, Any]) -> str:
    """Return what is foreign about a file; empty if it is as it was written."""
    path = folder / name
    if name not in listed or not _is_file(path):
        return name
    if name == TIMING_FILE:
        return ""
    try:
        return "" if sha256(path) == listed[name] else f"{name} (changed since it was written)"
    except OSError:
        return name


def is_lock_only(folder: Path) -> bool:
    """Whether a checkpoint's process had no more than its lock, and perhaps half a stamp, when it ended."""
    names = list_readable_files(folder)
    only = all(_BEGUN.fullmatch(name) and _is_file(folder / name) for name in names)
    return only and _is_lock(folder / "lock")


def _is_checkpoint_stamp(path: Path) -> bool:
    """Return whether a file is the stamp of a checkpoint, or what a failing disk left of one.

    That is its beginning, perhaps with zeros behind: any other text is somebody's.
    """
    if not _is_file(path):
        return False
    try:
        text = read_bytes(path, MAX_STAMP_BYTES).rstrip(b"\0\n")
    except DataError:
        return False
    try:
        return bool(read_stamp(path.parent).get("holds", "checkpoint") == "checkpoint")
    except DataError:
        return _STAMP_BEGIN.startswith(text[: len(_STAMP_BEGIN)])


def _is_lock(path: Path) -> bool:
    """Return whether a file is a lock as `partial` writes it."""
    try:
        text = read_bytes(path, _MAX_LOCK_BYTES)
    except DataError:
        return False
    return _LOCK_TEXT.fullmatch(text) is not None


def _is_file(path: Path) -> bool:
    try:
        return stat.S_ISREG(path.lstat().st_mode)
    except OSError:
        return False


def _write(path: Path, table: dict[str, Any]) -> None:
    path.write_bytes(_text(table).encode("utf-8"))


def _text(table: Mapping[str, Any]) -> str:
    head = {"program": "needlefit", "format": FORMAT}
    return json.dumps({**head, **table}, indent=2, ensure_ascii=True) + "\n"


_STAMP_BEGIN = _text({"holds": "checkpoint"}).partition("\n}")[0].encode("ascii")
"""How every stamp of a checkpoint begins."""
