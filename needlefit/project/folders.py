"""Folders of results: where they can be written, whose they are, and how a whole one takes its place.

The manifest of a folder, `needlefit.json`, lists its files and the SHA-256 of each. It says whose a folder
is: only what it lists, unchanged, may be replaced or removed. Any other file, a listed one that was changed
since (but `timing.json`) and every link are foreign: they are somebody's work. It also says whether a result
is the one that was written: what does not agree with it is not reported on. It detects accidents and partial
edits, not somebody who makes a new manifest.
"""

import ctypes
import hashlib
import json
import os
import shutil
import stat
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

from needlefit.errors import ConfigError, DataError
from needlefit.project.input_files import path_exists, read_json
from needlefit.project.locate import join_names
from needlefit.project.progress import Note

if TYPE_CHECKING:
    from filelock import BaseFileLock


MAX_NAME_BYTES = 231  # of a result: a scratch folder beside it has a longer name, which systems limit to 255
MAX_PATH_BYTES = 3500  # of a result: what lies in it has longer paths, which systems limit to 4096


def require_writable(place: Path) -> None:
    """Raise ConfigError unless a file or folder can be made at `place`, with what is written beside it.

    Nothing is made: the nearest folder above that exists must be writable.
    """
    if "\0" in str(place):
        raise not_writable_error(Path(repr(place.name)), "its name holds a zero byte")
    place = Path(os.path.realpath(place))  # what Path.resolve refuses is judged below
    if place == place.parent:
        raise not_writable_error(place, "it is the root of the file system")
    folder = place.parent
    while not path_exists(folder) and folder != folder.parent:
        folder = folder.parent
    effective = os.access in os.supports_effective_ids
    if not folder.is_dir() or not os.access(folder, os.W_OK | os.X_OK, effective_ids=effective):
        raise not_writable_error(folder, "you may not write there" if folder.is_dir() else "it is a file")
    longest = max(len(os.fsencode(part)) for part in place.parts)
    if longest > MAX_NAME_BYTES or len(os.fsencode(place)) > MAX_PATH_BYTES:
        raise not_writable_error(folder, f"a name has {longest} bytes, of at most {MAX_NAME_BYTES}")


def require_output_files(outputs: Mapping[str, Path], inputs: Iterable[Path]) -> None:
    """Raise ConfigError unless each file that an option names can be written, and is not an input.

    `inputs` are files that the run reads, and folders of such files. ConfigError if a folder is missing or
    cannot be written to, or a file is a folder, an input (also by another name: a link), or named by two
    options.
    """
    sources = list(inputs)
    for option, path in outputs.items():
        require_folder(path)
        if path.is_dir():
            raise ConfigError(
                "is a folder",
                where=str(path),
                expected="the name of a file",
                fix=f"name a file with {option}",
            )
        for source in sources if path_exists(path) else ():
            within = source.is_dir() and Path(os.path.realpath(path)).is_relative_to(os.path.realpath(source))
            if within or (path_exists(source) and path.samefile(source)):
                raise ConfigError(
                    f"is an input of this run, which {option} would replace",
                    where=str(path),
                    expected="a new file, or one that may be lost",
                    fix=f"choose another name with {option}",
                )
        if path_exists(path) and not stat.S_ISREG(path.stat().st_mode):
            continue  # a pipe or a terminal
        require_writable(path)
    for (one, path), (other, same) in combinations(outputs.items(), 2):
        if os.path.realpath(path) == os.path.realpath(same):
            raise ConfigError(
                f"is named by both {one} and {other}",
                where=str(path),
                expected="a file of its own for each",
                fix="choose another name for one of them",
            )


def require_folder(path: Path) -> None:
    """Raise ConfigError unless the folder of a file to write exists."""
    if not path.parent.is_dir():
        raise ConfigError("there is no such folder", where=str(path.parent), fix="make it first")


def require_no_inputs_within(folder: Path, inputs: Iterable[Path]) -> None:
    """Raise ConfigError if a folder that is to be replaced holds an input of the run."""
    place = Path(os.path.realpath(folder))
    for path in inputs:
        if Path(os.path.realpath(path)).is_relative_to(place):
            raise ConfigError(
                f"holds an input of this run: {path}",
                where=str(folder),
                expected="a folder of results that is not read",
                fix="choose another folder with --out",
            )


def not_writable_error(place: Path, reason: str) -> ConfigError:
    """Return what is raised of a place where nothing can be written."""
    return ConfigError(
        f"cannot be written to: {reason}",
        where=str(place),
        expected="a folder in which you may write",
        fix="choose another one with --out, or check its permissions",
    )


# ---- the manifest

MANIFEST = "needlefit.json"

FORMAT = 1

FILE_MANAGER_FILES = frozenset({".DS_Store", "Thumbs.db", "desktop.ini"})
"""What a file manager leaves in a folder that it shows; nobody's work."""

TIMING_FILE = "timing.json"
"""The one file of a result that differs from run to run; without its digest the manifest does not."""

MAX_LISTED_FILES = 5  # files that a message names
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

    DataError names the files.
    """
    changes = [f"{name} {how}" for name, how in find_changes(folder).items()]
    if changes and not unverified:
        raise DataError(
            f"does not agree with its manifest: {join_names(changes, MAX_LISTED_FILES)}",
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

    ConfigError if the folder cannot be looked into.
    """
    names = [name for name in list_all_files(folder) if Path(name).name not in FILE_MANAGER_FILES]
    listed = listed_files(folder)
    written = [name for name in names if name != MANIFEST] if listed else names
    return [fault for name in written if (fault := _find_fault(folder, name, listed))]


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


def require_replaceable(folder: Path, find: Callable[[Path], list[str]] | None = None) -> None:
    """Raise ConfigError unless `folder` may be written to: missing, empty, or needlefit's own result.

    `find` returns what is foreign in a folder of another kind.
    """
    require_writable(folder)  # first: it also sees names that the system does not take
    if (place := folder.resolve()).exists() or place.is_symlink():
        faults = (find or find_foreign)(place) if place.is_dir() else ["it is a file"]
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
    with suppress(OSError, ConfigError), _scratch_folder(folder.resolve()) as fresh:
        folder.rename(fresh)  # it goes with the scratch folder


def not_replaced_error(folder: Path, faults: list[str]) -> ConfigError:
    """Return what is raised of a folder that holds what is foreign."""
    named = join_names(faults, MAX_LISTED_FILES)
    return ConfigError(
        f"is not replaced: needlefit did not write this in it, or it was changed since: {named}",
        where=str(folder),
        expected=f"no such folder, an empty one, or one that holds only what its {MANIFEST} lists, unchanged",
        fix="move those files away, or choose another folder with --out",
    )


def list_all_files(folder: Path) -> list[str]:
    """Return the files in a folder and those below, and links to whatever, relative to it, sorted.

    ConfigError if a folder cannot be looked into.
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


def is_regular(path: Path) -> bool:
    """Return whether there is a regular file, and no link to one."""
    try:
        return stat.S_ISREG(path.lstat().st_mode)
    except OSError:
        return False


# ---- writing beside, and putting in place

LOCK_NAME = "lock"
"""A file that the process which writes to a folder holds locked, until it ends."""

_SCRATCH = ".needlefit-"  # in the name of a scratch folder, behind that of its place
_NEW_NAME, _OLD_NAME = "new", "old"  # in it: what is written; and the result that is being replaced


def take_lock(folder: Path) -> "BaseFileLock | None":
    """Return the lock of a folder, taken; None where it is taken already."""
    from filelock import FileLock, Timeout

    lock = FileLock(folder / LOCK_NAME, blocking=False, thread_local=False)
    try:
        lock.acquire()
    except Timeout:
        return None
    return lock


@contextmanager
def replace_folder(folder: Path) -> Iterator[Path]:
    """Yield an empty folder, of the same name, that takes the place of `folder` when the block ends well.

    It stands beside `folder` until then, so that a failure leaves nothing behind and the old one as it was;
    what a killed process left the next one removes. It gets a manifest. A block that writes
    nothing replaces nothing.

    ConfigError if nothing can be written there, or `folder` holds anything foreign, at the begin or at the
    end.
    """
    folder = folder.resolve()
    require_replaceable(folder)
    with _scratch_folder(folder) as fresh:
        fresh.mkdir()
        yield fresh
        if any(fresh.iterdir()):
            write_manifest(fresh)
            require_replaceable(folder)  # something may have been put there meanwhile
            if not folder.exists():
                fresh.rename(folder)
            elif not _exchange(fresh, folder):
                old = fresh.parent.with_name(_OLD_NAME)
                folder.rename(old)
                try:
                    fresh.rename(folder)
                except BaseException:
                    old.rename(folder)
                    raise


def _exchange(one: Path, other: Path) -> bool:
    """Exchange two folders at once, so that there is never none; False where the system cannot."""
    try:
        rename = ctypes.CDLL(None, use_errno=True).renameat2
    except (AttributeError, OSError, TypeError):
        return False
    here, exchange = -100, 2  # AT_FDCWD, RENAME_EXCHANGE
    return bool(rename(here, os.fsencode(one), here, os.fsencode(other), exchange) == 0)


@contextmanager
def create_folder(folder: Path) -> Iterator[Path]:
    """Yield what `replace_folder` does, for a folder that is missing or empty; it gets no manifest:
    it is the user's.

    ConfigError if nothing can be written there, or `folder` holds something.
    """
    folder = folder.resolve()
    require_new(folder)
    with _scratch_folder(folder) as fresh:
        fresh.mkdir()
        yield fresh
        require_new(folder)
        fresh.rename(folder)  # fails where somebody was quicker


def require_new(folder: Path) -> None:
    """Raise ConfigError if `folder` holds something, or is a file."""
    if folder.is_dir() and not any(folder.iterdir()):
        return
    if folder.exists() or folder.is_symlink():
        raise ConfigError(
            "exists already",
            where=str(folder),
            expected="a new or empty folder",
            fix="choose another folder",
        )


@contextmanager
def replace_file(file: Path) -> Iterator[Path]:
    """Yield a path, of the same name, whose file takes the place of `file` when the block ends well.

    It is for files that the user names, and for those within needlefit's own folders.

    ConfigError if nothing can be written there.
    """
    file = file.resolve()
    with _scratch_folder(file) as fresh:
        yield fresh
        fresh.replace(file)


@contextmanager
def _scratch_folder(place: Path) -> Iterator[Path]:
    """Yield a path of the name of `place`, in a folder beside it, on the same disk, which goes in the end.

    ConfigError if nothing can be written there.
    """
    prefix = f".{place.name}{_SCRATCH}"
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        _remove_leftovers(place, prefix)
        made = Path(tempfile.mkdtemp(prefix=prefix, dir=place.parent))
        lock = take_lock(made)
        (made / _NEW_NAME).mkdir()
    except OSError as error:
        raise not_writable_error(place, error.strerror or type(error).__name__) from None
    try:
        yield made / _NEW_NAME / place.name
    finally:
        if lock is not None:
            lock.release()
        shutil.rmtree(made, ignore_errors=True)


def _remove_leftovers(place: Path, prefix: str) -> None:
    """Remove the scratch folders of `place` whose process has ended; the only copy of a result goes back."""
    for folder in place.parent.iterdir():
        is_scratch = folder.name.startswith(prefix) and (folder / LOCK_NAME).is_file()
        lock = take_lock(folder) if is_scratch and not folder.is_symlink() else None
        if lock is not None:
            if (folder / _OLD_NAME).exists() and not place.exists():
                (folder / _OLD_NAME).rename(place)  # killed between two renamings
            lock.release()
            shutil.rmtree(folder, ignore_errors=True)
