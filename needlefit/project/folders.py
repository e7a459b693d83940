"""Folders of results: where they can be written, whose they are, and how a whole one takes its place.

The manifest of a folder, `needlefit.json`, lists its files and the SHA-256 of each. Only what it lists,
unchanged, may be replaced or removed. Any other file, a listed one that was changed since (but `timing.json`)
and every link are foreign: they are somebody's work. What does not agree with the manifest is not reported
on. It detects accidents and partial edits, not somebody who makes a new manifest.
"""

import hashlib
import json
import os
import shutil
import stat
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from needlefit.errors import ConfigError, DataError
from needlefit.project.callbacks import Note
from needlefit.project.input_files import path_exists, read_json
from needlefit.project.locate import join_names

if TYPE_CHECKING:
    from filelock import BaseFileLock


def require_writable(place: Path) -> None:
    """Raise ConfigError unless a file or folder can be made at `place`.

    Nothing is made: the nearest folder above that exists must be writable.
    """
    folder = Path(os.path.realpath(place)).parent
    while not path_exists(folder) and folder != folder.parent:
        folder = folder.parent
    if not folder.is_dir() or not os.access(folder, os.W_OK | os.X_OK):
        raise not_writable_error(folder, "you may not write there" if folder.is_dir() else "it is a file")


def require_output_files(outputs: Mapping[str, Path], inputs: Iterable[Path]) -> None:
    """Raise ConfigError unless each file that an option names can be written, and is not an input.

    `inputs` are files that the run reads, and folders of such files. ConfigError if a folder is missing or
    cannot be written to, or a file is a folder, an input (also by another name: a link), or named by two
    options.
    """
    read = [Path(os.path.realpath(given)) for given in inputs]
    for option, path in outputs.items():
        require_folder(path)
        place = Path(os.path.realpath(path))
        if place.is_dir():
            raise ConfigError("is a folder", fix=f"name a file with {option}", where=path)
        others = [os.path.realpath(other) for name, other in outputs.items() if name != option]
        is_read = place.exists() and any(
            place.is_relative_to(source) or place.samefile(source) for source in read
        )
        if is_read or str(place) in others:
            raise ConfigError(
                f"is an input of this run, or named twice: {option} would replace it",
                expected="a new file, or one that may be lost",
                fix=f"choose another name with {option}",
                where=path,
            )
        if place.is_file() or not place.exists():  # not a pipe or a terminal
            require_writable(path)


def require_folder(path: Path) -> None:
    """Raise ConfigError unless the folder of a file to write exists."""
    if not path.parent.is_dir():
        raise ConfigError("there is no such folder", fix="make it first", where=path.parent)


def require_no_inputs_within(folder: Path, inputs: Iterable[Path]) -> None:
    """Raise ConfigError if a folder that is to be replaced holds an input of the run."""
    place = Path(os.path.realpath(folder))
    for path in inputs:
        if Path(os.path.realpath(path)).is_relative_to(place):
            raise ConfigError(
                f"holds an input of this run: {path}",
                expected="a folder that is not read",
                fix="choose another folder with --out",
                where=folder,
            )


def not_writable_error(place: Path, reason: str) -> ConfigError:
    """Return what is raised of a place where nothing can be written."""
    return ConfigError(
        f"cannot be written to: {reason}",
        expected="a folder in which you may write",
        fix="choose another one with --out, or check its permissions",
        where=place,
    )


# ---- the manifest

MANIFEST = "needlefit.json"

FORMAT = 1  # version of the format of results, which their manifest states

FILE_MANAGER_FILES = frozenset({".DS_Store", "Thumbs.db", "desktop.ini"})
"""Names of files that a file manager leaves in a folder that it shows; nobody's work."""

TIMING_FILE = "timing.json"
"""Name of the one file of a result that differs from run to run; without its digest the manifest does not."""

MAX_LISTED_FILES = 5  # largest number of files that a message names
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
    """Return what the manifest of a folder states; DataError if there is none, or it is damaged."""
    path = folder / MANIFEST
    table = {} if path.is_symlink() else read_json(path)
    if isinstance(table, dict) and table.get("program") == "needlefit" and table.get("format") == FORMAT:
        return table
    raise DataError("is not a manifest of needlefit", expected=f"one of format {FORMAT}", where=path)


def listed_files(folder: Path) -> dict[str, Any]:
    """Return the files that the manifest of a result lists, with their digests; none without a manifest."""
    try:
        listed = read_manifest(folder).get("files")
    except DataError:
        return {}
    return listed if isinstance(listed, dict) else {}


def _compare(folder: Path) -> dict[str, str]:
    """Return what in a folder does not agree with its manifest, and how, by file; links are not followed."""
    listed = listed_files(folder)
    names = [name for name in list_all_files(folder) if Path(name).name not in FILE_MANAGER_FILES]
    return {
        name: CHANGED if name in listed else "is not needlefit's"
        for name in names
        if not (listed and name == MANIFEST) and not _is_as_written(folder / name, listed.get(name))
    }


def find_changes(folder: Path) -> dict[str, str]:
    """Return which files of a result were changed since its manifest was written, and how.

    Files that are missing are not among them: a report makes most of them again.
    """
    if not listed_files(folder):
        return {MANIFEST: "is missing or damaged"}
    return {name: how for name, how in _compare(folder).items() if how == CHANGED}


def require_unchanged(folder: Path) -> None:
    """Raise DataError, which names the files, where a result does not agree with its manifest."""
    changes = [f"{name} {how}" for name, how in find_changes(folder).items()]
    if changes:
        raise DataError(
            f"does not agree with its manifest: {join_names(changes, MAX_LISTED_FILES)}",
            expected=f"files with the digests that {MANIFEST} lists",
            fix="run it again; tables, figures and pages may be removed: `needlefit report` makes them again",
            where=folder,
        )


def find_foreign(folder: Path) -> list[str]:
    """Return what lies in a folder of results that needlefit did not write, each with the reason."""
    return [f"{name} {how}" for name, how in _compare(folder).items()]


def _is_as_written(path: Path, digest: object) -> bool:
    """Return whether a file is a regular one, with the digest that the manifest lists."""
    try:
        return is_regular(path) and (path.name == TIMING_FILE or sha256(path) == digest)
    except OSError:
        return False


def require_replaceable(folder: Path, find: Callable[[Path], list[str]] | None = None) -> None:
    """Raise ConfigError unless `folder` may be written to: missing, empty, or needlefit's own result.

    A result is not replaced while the working folder is in it: the shell would stand in a folder that is
    gone. `find` returns what is foreign in a folder of another kind.
    """
    require_writable(folder)
    if (place := folder.resolve()).exists() or place.is_symlink():
        faults = (find or find_foreign)(place) if place.is_dir() else ["it is a file"]
        if faults:
            raise ConfigError(
                f"is not replaced: needlefit did not write all of it: {join_names(faults, MAX_LISTED_FILES)}",
                expected=f"a new or empty folder, or one as its {MANIFEST} lists it",
                fix="move those files away, or choose another folder with --out",
                where=folder,
            )
        if Path.cwd().is_relative_to(place) and not _is_empty(place):
            raise ConfigError(
                "is not replaced: it is the working folder, or holds it",
                expected="another folder",
                fix="go to another folder, or choose one with --out",
                where=folder,
            )


def remove_result(folder: Path, note: Note) -> None:
    """Remove the result of an earlier run, if there is one; where it holds anything foreign it stays."""
    if not folder.is_dir():
        return
    if faults := find_foreign(folder):
        note(f"{folder} of an earlier run is not removed: it holds {join_names(faults, MAX_LISTED_FILES)}")
    else:
        shutil.rmtree(folder, ignore_errors=True)


def list_all_files(folder: Path) -> list[str]:
    """Return the files in a folder and those below, and links to whatever, relative to it, sorted."""

    def fail(fault: OSError) -> None:  # else a folder that may not be read counts as empty
        raise fault

    paths: list[Path] = []
    for place, folders, files in os.walk(folder, onerror=fail):  # follows no link
        paths += [Path(place, name) for name in files]
        paths += [Path(place, name) for name in folders if Path(place, name).is_symlink()]
    return sorted(path.relative_to(folder).as_posix() for path in paths)


def is_regular(path: Path) -> bool:
    """Return whether there is a regular file, and no link to one."""
    try:
        return stat.S_ISREG(path.lstat().st_mode)
    except OSError:
        return False


# ---- writing beside, and putting in place

LOCK_NAME = "lock"
"""Name of the file that the process which writes to a folder holds locked, until it ends."""


def take_lock(folder: Path) -> "BaseFileLock":
    """Make a folder, if there is none, and return its lock, taken.

    ConfigError if another process has it, or nothing can be written there.
    """
    from filelock import FileLock, Timeout

    lock = FileLock(folder / LOCK_NAME, blocking=False, thread_local=False)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock.acquire()
    except Timeout:
        raise ConfigError(
            "another run of needlefit is writing there",
            expected="one run at a time",
            fix="wait until it has ended, or choose another folder with --out",
            where=folder,
        ) from None
    except OSError as error:
        raise not_writable_error(folder, error.strerror or type(error).__name__) from None
    return lock


@contextmanager
def replace_folder(
    folder: Path, is_result: bool = True, find: Callable[[Path], list[str]] | None = None
) -> Iterator[Path]:
    """Yield an empty folder, of the same name, that takes the place of `folder` when the block ends well.

    It stands beside `folder` until then, so that a failure leaves nothing behind and the old one as it was;
    what a killed process left the next one removes. A block that writes nothing replaces nothing. An empty
    folder is not replaced but filled: it may be the working folder.
    `is_result`: it gets a manifest, and may replace a result; else it is the user's, and must be new, or
    hold nothing that `find` returns as foreign.

    ConfigError if nothing can be written there, another process is writing there, or `folder` holds anything
    foreign, or anything at all where it must be new, at the begin or at the end.
    """
    folder, check = folder.resolve(), require_replaceable if is_result else require_new
    if find is not None:
        check = partial(require_replaceable, find=find)
    check(folder)
    with _scratch_folder(folder) as (fresh, old):
        check(folder)  # a killed process may have left the only copy of a result
        fresh.mkdir()
        yield fresh
        if any(fresh.iterdir()):
            if is_result:
                write_manifest(fresh)
            check(folder)  # something may have been put there meanwhile
            if _is_empty(folder):
                _move_into(folder, fresh)
                return
            if folder.exists():
                folder.rename(old)
            try:
                fresh.rename(folder)
            except BaseException:
                if old.exists():
                    old.rename(folder)
                raise


def _is_empty(folder: Path) -> bool:
    """Return whether there is a folder without anything in it."""
    return folder.is_dir() and not any(folder.iterdir())


def _move_into(folder: Path, fresh: Path) -> None:
    """Move all that `fresh` holds into an empty folder; after a failure that is empty again.

    The manifest goes first: what a killed process leaves then is needlefit's, and may be replaced.
    """
    moved: list[Path] = []
    try:
        for path in sorted(fresh.iterdir(), key=lambda path: path.name != MANIFEST):
            moved.append(path.rename(folder / path.name))
    except BaseException:
        for path in moved:
            path.rename(fresh / path.name)
        raise


def require_new(folder: Path) -> None:
    """Raise ConfigError if `folder` holds something, or is a file."""
    if not _is_empty(folder) and (folder.exists() or folder.is_symlink()):
        raise ConfigError(
            "exists already", expected="a new or empty folder", fix="choose another folder", where=folder
        )


@contextmanager
def replace_file(file: Path) -> Iterator[Path]:
    """Yield a path, of the same name, whose file takes the place of `file` when the block ends well.

    It is for files that the user names, and for those within needlefit's own folders.

    ConfigError if nothing can be written there.
    """
    file = file.resolve()
    with _scratch_folder(file) as (fresh, _):
        yield fresh
        fresh.replace(file)


@contextmanager
def _scratch_folder(place: Path) -> Iterator[tuple[Path, Path]]:
    """Yield where to write what takes the place of `place`, and where to put what it replaces.

    Both are in a folder beside it, on the same disk, which goes in the end.

    ConfigError if nothing can be written there, or another process is writing there.
    """
    scratch = place.with_name(f".{place.name}.needlefit")
    new, old = scratch / "new", scratch / "old"
    lock = take_lock(scratch)
    try:
        if old.exists() and not place.exists():
            old.rename(place)  # its process was killed between two renamings
        shutil.rmtree(new, ignore_errors=True)
        new.mkdir()
        yield new / place.name, old
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
        lock.release()
