"""Write a folder or a file whole or not at all; only needlefit's own results are replaced."""

import ctypes
import errno
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from needlefit.errors import ConfigError
from needlefit.project.manifest import (
    MANIFEST,
    find_foreign,
    not_replaced_error,
    remove_folder,
    require_replaceable,
    write_manifest,
)
from needlefit.project.outputs import not_writable_error

try:
    import fcntl
except ImportError:  # Windows: what is left stays, since nothing says safely that its owner is gone
    fcntl = None  # type: ignore[assignment]

NEW_NAME, OLD_NAME = "new", "old"
"""In a scratch folder: where something is written; and the result that waits to be put in its place, or was
replaced. What lies in `OLD_NAME` is removed only when it is known to be needlefit's own."""

LOCK_NAME = "lock"
"""A file in it that its process holds locked; the lock goes with the process, however that ends."""

_SCRATCH = ".needlefit-"
"""In the name of a scratch folder, behind that of its place."""

_SCRATCH_NAMES = {LOCK_NAME, f"{LOCK_NAME}.new", NEW_NAME, OLD_NAME, f"{OLD_NAME}.aside"}
_MARK = "a scratch folder of needlefit\n"
REMOVED_LAST = (MANIFEST, "run.json", "dataset.toml")
"""What is removed last of a result: by them it is known, also half removed."""

_AT_FDCWD, _RENAME_EXCHANGE = -100, 2


@contextmanager
def replace_folder(folder: Path) -> Iterator[Path]:
    """Yield an empty folder, of the same name, that takes the place of `folder` when the block ends well.

    It stands beside `folder` until then, so that a failure leaves nothing behind and the old one as it was;
    what a killed process left the next one removes. It gets a manifest. A block that writes
    nothing replaces nothing.

    Raises
    ------
    ConfigError
        If nothing can be written there, or `folder` holds anything foreign, at the begin or at the end.
    """
    folder = folder.resolve()
    require_replaceable(folder)
    with _scratch_folder(folder) as (beside, fresh):
        fresh.mkdir()
        yield fresh
        if any(fresh.iterdir()):
            _tidy(fresh)
            write_manifest(fresh)
            _swap_in(fresh, folder, beside / OLD_NAME)


def _tidy(folder: Path) -> None:
    """Remove empty folders of a result, which would be the user's, and scratch that a failing disk left."""
    for left in sorted(folder.rglob(f".*{_SCRATCH}*")):
        if any((left / name).exists() for name in (NEW_NAME, LOCK_NAME, f"{LOCK_NAME}.new")):
            shutil.rmtree(left)
    for place, _, _ in os.walk(folder, topdown=False):
        if Path(place) != folder and not any(Path(place).iterdir()):
            Path(place).rmdir()


@contextmanager
def create_folder(folder: Path) -> Iterator[Path]:
    """Yield what `replace_folder` does, for a folder that is missing or empty; it gets no manifest:
    it is the user's.

    Raises
    ------
    ConfigError
        If nothing can be written there, or `folder` holds something.
    """
    folder = folder.resolve()
    require_new(folder)
    with _scratch_folder(folder) as (_, fresh):
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

    Raises
    ------
    ConfigError
        If nothing can be written there.
    """
    file = file.resolve()
    with _scratch_folder(file) as (_, fresh):
        yield fresh
        fresh.replace(file)


@contextmanager
def _scratch_folder(place: Path) -> Iterator[tuple[Path, Path]]:
    """Yield a folder beside `place`, on the same disk, which goes when it is left, and the new place in it.

    Raises
    ------
    ConfigError
        If nothing can be written there.
    """
    prefix = f".{place.name}{_SCRATCH}"
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        with suppress(OSError, ConfigError):
            _remove_leftovers(place, prefix)
        made = Path(tempfile.mkdtemp(prefix=prefix, dir=place.parent))
    except OSError as error:
        raise not_writable_error(place, error.strerror or type(error).__name__) from None
    try:
        with _hold_lock(made):
            (made / NEW_NAME).mkdir()
            yield made, made / NEW_NAME / place.name
    finally:
        if not (made / OLD_NAME).exists():  # else it holds what was not seen to be needlefit's own
            with suppress(OSError):
                remove_folder(made, (LOCK_NAME,))


def _swap_in(fresh: Path, folder: Path, old: Path) -> None:
    """Put `fresh` in the place of `folder`, which is looked at again once nobody can add to it."""
    try:
        fresh.rename(folder)  # where there is none, or an empty one
        return
    except OSError as fault:
        if fault.errno not in (errno.ENOTEMPTY, errno.EEXIST):
            raise
    fresh.rename(old)
    _exchange(old, folder)
    faults = find_foreign(old)
    if faults:  # put there while this was computed
        _exchange(old, folder)
        old.rename(fresh)
        raise not_replaced_error(folder, faults)
    remove_folder(old, REMOVED_LAST)


def _exchange(one: Path, other: Path) -> None:
    """Exchange two folders; where the system can do it, at once: there is never none."""
    if _try_exchange(one, other):
        return
    aside = one.with_name(f"{one.name}.aside")
    one.rename(aside)
    other.rename(one)
    try:
        aside.rename(other)
    except BaseException:
        one.rename(other)
        aside.rename(one)
        raise


def _try_exchange(one: Path, other: Path) -> bool:
    """Exchange two folders at once; False where the system or the disk cannot."""
    try:
        rename = ctypes.CDLL(None, use_errno=True).renameat2
    except (AttributeError, OSError, TypeError):
        return False
    done = rename(_AT_FDCWD, os.fsencode(one), _AT_FDCWD, os.fsencode(other), _RENAME_EXCHANGE)
    return bool(done == 0)


@contextmanager
def _hold_lock(folder: Path) -> Iterator[None]:
    """Hold the lock of a scratch folder; it gets its name when it is held, lest another process takes it."""
    with (folder / f"{LOCK_NAME}.new").open("w", encoding="ascii") as file:
        file.write(_MARK)
        file.flush()
        if fcntl is not None:
            with suppress(
                OSError
            ):  # a disk without locks: the folder has none then, and nobody else removes it
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                Path(file.name).rename(folder / LOCK_NAME)
        yield


def _remove_leftovers(place: Path, prefix: str) -> None:
    """Remove the scratch folders of `place` whose process has ended; the only copy of a result goes back."""
    for folder in place.parent.iterdir():
        lock = folder / LOCK_NAME
        if not folder.name.startswith(prefix) or folder.is_symlink() or not lock.is_file():
            continue
        with suppress(OSError), lock.open("r+", encoding="ascii") as file:
            names = {path.name for path in folder.iterdir()}
            if file.read(len(_MARK)) == _MARK and _lock_if_free(file) and names <= _SCRATCH_NAMES:
                _remove_one(folder, place)


def _remove_one(folder: Path, place: Path) -> None:
    """Remove a scratch folder; what waits in it to be replaced only if it is needlefit's own."""
    for leftover in (folder / OLD_NAME, folder / f"{OLD_NAME}.aside"):
        if leftover.exists() and not place.exists():
            leftover.rename(place)  # killed between two renamings
        if leftover.exists() and find_foreign(leftover):
            return
        if leftover.exists():
            remove_folder(leftover, REMOVED_LAST)
    remove_folder(folder, (LOCK_NAME,))


def _lock_if_free(file: IO[str]) -> bool:
    """Whether nobody holds the lock of a file; if so it is held here until the file is closed."""
    if fcntl is None:
        return False
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True
