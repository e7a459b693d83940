"""The manifest of a folder of results, `needlefit.json`: its files, and the SHA-256 of each.

It says whose a folder is: only what it lists, unchanged, may be replaced or removed. Any other file, a listed
one that was changed since (but `timing.json`), every link and every other empty folder are foreign: they are
somebody's work. It also says whether a result is the one that was written: what does not agree with it is not
reported on. It detects accidents and partial edits, not somebody who makes a new manifest.
"""

import hashlib
import json
import os
import shutil
import stat
from collections.abc import Container, Iterable, Mapping
from contextlib import suppress
from pathlib import Path, PurePosixPath
from typing import Any

from needlefit.errors import ConfigError, DataError
from needlefit.project.input_files import read_json
from needlefit.project.outputs import require_writable
from needlefit.project.progress import Note

MANIFEST = "needlefit.json"

FORMAT = 1

FILE_MANAGER_FILES = frozenset({".DS_Store", "Thumbs.db", "desktop.ini"})
"""What a file manager leaves in a folder that it shows; nobody's work."""

TIMING_FILE = "timing.json"
"""The one file of a result that differs from run to run; without its digest the manifest does not."""

MAX_LISTED_FILES = 5
"""Files that a message names."""

CHANGED = "was changed since it was written"


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file's bytes, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def write_manifest(folder: Path) -> None:
    """Write the manifest of a result: all that lies in `folder` is from here on known to be needlefit's."""
    names = [name for name in list_all_files(folder) if name != MANIFEST]
    files = {name: None if name == TIMING_FILE else sha256(folder / name) for name in names}
    (folder / MANIFEST).write_text(format_manifest({"holds": "result", "files": files}), encoding="ascii")


def format_manifest(table: Mapping[str, Any]) -> str:
    """Return the text of a manifest."""
    head = {"program": "needlefit", "format": FORMAT}
    return json.dumps({**head, **table}, indent=2, ensure_ascii=True) + "\n"


def read_manifest(folder: Path) -> dict[str, Any]:
    """Return what the manifest of a folder says; DataError if there is none, or it is damaged."""
    path = folder / MANIFEST
    table = {} if path.is_symlink() else read_json(path)
    if isinstance(table, dict) and table.get("program") == "needlefit" and table.get("format") == FORMAT:
        return table
    raise DataError("is not a manifest of needlefit", where=str(path), expected=f"one of format {FORMAT}")


def listed_files(folder: Path) -> dict[str, Any]:
    """Return the files that the manifest of a result lists, with their digests; none without a manifest."""
    try:
        listed = read_manifest(folder).get("files")
    except DataError:
        return {}
    return listed if isinstance(listed, dict) else {}


def find_changes(folder: Path) -> dict[str, str]:
    """Return what does not agree with the manifest of a result, and how, by file.

    Files that are missing are not: a report makes most of them again.
    """
    listed = listed_files(folder)
    if not listed:
        return {MANIFEST: "is missing or damaged"}
    names = [name for name in list_all_files(folder) if name in listed]
    return {name: CHANGED for name in names if _find_fault(folder, name, listed)}


def require_unchanged(folder: Path, unverified: bool = False) -> tuple[str, ...]:
    """Raise DataError where a result does not agree with its manifest; if `unverified`, return what does not.

    Raises
    ------
    DataError
        That names the files.
    """
    changes = [f"{name} {how}" for name, how in find_changes(folder).items()]
    if changes and not unverified:
        raise DataError(
            f"does not agree with its manifest: {_join(changes)}",
            where=str(folder),
            expected=f"files with the digests that {MANIFEST} lists",
            fix="take the files from a copy, or run it again; tables, figures and pages may be removed: "
            "`needlefit report` makes them again; --unverified (in Python: unverified=True; of `report` "
            "with --out FOLDER) uses files as they are, and marks every page",
        )
    return tuple(changes)


def find_foreign(folder: Path) -> list[str]:
    """Return what lies in a folder of results that needlefit did not write, each with the reason.

    Links are not followed.

    Raises
    ------
    ConfigError
        If the folder cannot be looked into.
    """
    names = [name for name in list_all_files(folder) if Path(name).name not in FILE_MANAGER_FILES]
    listed = listed_files(folder)
    written = [name for name in names if name != MANIFEST] if listed else names
    faults = [fault for name in written if (fault := _find_fault(folder, name, listed))]
    parents = {str(parent) for name in listed for parent in PurePosixPath(name).parents}
    return [*faults, *find_empty_folders(folder, names, parents)]


def _find_fault(folder: Path, name: str, listed: Mapping[str, Any]) -> str:
    """Return what is foreign about a file; empty if it is as it was written."""
    path = folder / name
    if name not in listed or not is_regular(path):
        return name
    try:
        same = name == TIMING_FILE or sha256(path) == listed[name]
    except OSError:
        return name
    return "" if same else f"{name} (changed since it was written)"


def require_replaceable(folder: Path) -> None:
    """Raise ConfigError unless a result may be written to `folder`: missing, empty, or needlefit's own."""
    require_writable(folder)  # first: it also sees names that the system does not take
    if (place := folder.resolve()).exists() or place.is_symlink():
        faults = find_foreign(place) if place.is_dir() else ["it is a file"]
        if faults:
            raise not_replaced_error(place, faults)


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
    with suppress(OSError):  # what stays has its manifest still: the next run removes it
        remove_folder(folder, (MANIFEST,))


def not_replaced_error(folder: Path, faults: list[str]) -> ConfigError:
    """Return what is raised of a folder that holds what is foreign."""
    return ConfigError(
        f"is not replaced: needlefit did not write this in it, or it was changed since: {_join(faults)}",
        where=str(folder),
        expected=f"no such folder, an empty one, or one that holds only what its {MANIFEST} lists, unchanged",
        fix="move those files away, or choose another folder with --out",
    )


def _join(faults: list[str]) -> str:
    more = len(faults) - MAX_LISTED_FILES
    return ", ".join(faults[:MAX_LISTED_FILES]) + (f" and {more} more" if more > 0 else "")


def list_all_files(folder: Path) -> list[str]:
    """Return the files in a folder and those below, and links to whatever, relative to it, sorted.

    Raises
    ------
    ConfigError
        If a folder cannot be looked into.
    """

    def fail(fault: OSError) -> None:
        reason = fault.strerror or type(fault).__name__
        raise ConfigError(
            f"cannot be looked into: {reason}", where=str(fault.filename), fix="check its permissions"
        )

    found: list[Path] = []
    for place, folders, files in os.walk(folder, onerror=fail):  # follows no link
        found += [Path(place, name) for name in files]
        found += [Path(place, name) for name in folders if Path(place, name).is_symlink()]
    return sorted(path.relative_to(folder).as_posix() for path in found)


def find_empty_folders(folder: Path, names: Iterable[str], own: Container[str]) -> list[str]:
    """Return the outermost folders below one that hold no file, and that are not among needlefit's `own`.

    They vanish when their folder is replaced, and may be meant to be filled.
    """
    filled = {parent for name in names for parent in PurePosixPath(name).parents}
    found: list[PurePosixPath] = []
    for place, folders, _ in os.walk(folder):
        for name in sorted(folders):
            path = PurePosixPath(Path(place, name).relative_to(folder).as_posix())
            empty = path not in filled and not Path(place, name).is_symlink() and str(path) not in own
            if empty and not any(above in found for above in path.parents):
                found.append(path)
    return sorted(f"{path}/ (an empty folder)" for path in found)


def is_regular(path: Path) -> bool:
    """Return whether there is a regular file, and no link to one."""
    try:
        return stat.S_ISREG(path.lstat().st_mode)
    except OSError:
        return False


def remove_folder(folder: Path, last: Container[str]) -> None:
    """Remove a folder with all in it, the files called as `last` says at the end.

    These say whose it is: a removal that a kill or the disk cuts short can then be finished by the next run.
    Links are removed and not followed; OSError where something cannot be.
    """
    remove_contents(folder, last)
    folder.rmdir()


def remove_contents(folder: Path, last: Container[str], keep: Container[str] = ()) -> None:
    """Remove what lies in a folder but for the names `keep`; else as `remove_folder`."""
    for path in sorted(folder.iterdir(), key=lambda path: (path.name in last, path.name)):
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        elif path.name not in keep:
            path.unlink()
