"""The checkpoint folder of a running command, `NAME.partial`, which one process at a time may use."""

import errno
import hashlib
import json
import os
import secrets
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from needlefit.errors import ConfigError, DataError, UnfinishedWorkError
from needlefit.project.atomic_write import LOCK_NAME, replace_file
from needlefit.project.checkpoint_file import set_aside
from needlefit.project.files import remove_contents, remove_folder
from needlefit.project.outputs import not_writable_error
from needlefit.project.ownership import (
    STAMP,
    checkpoint_stamp,
    find_foreign,
    is_lock_only,
    read_stamp,
    require_own_checkpoint,
)
from needlefit.project.progress import Note

try:
    import fcntl
except ImportError:  # Windows: two runs may meet in one folder there
    fcntl = None  # type: ignore[assignment]

_THIS_PROCESS = f"{os.getpid()} {secrets.token_hex(8)}"
"""In the lock file: processes of two containers may have one number."""

_MAX_LOCK_BYTES = 100


class Lock:
    """The lock of a folder, held until it is released or nobody refers to it any more."""

    def __init__(self, file: int) -> None:
        self._file: int | None = file

    def release(self) -> None:
        """Let others have it."""
        if self._file is not None:
            os.close(self._file)
            self._file = None

    def __del__(self) -> None:
        self.release()


_held: dict[Path, Lock] = {}
"""Locks of this process. A complete run has its lock until its results stand and its folder is gone."""


def hold_checkpoint(folder: Path) -> None:
    """Take the lock of a checkpoint that another process of this program released, until it is removed."""
    with suppress(ConfigError):  # somebody else was faster, and has it
        if folder.is_dir() and (lock := _lock(folder)) is not None:
            _held[folder.resolve()] = lock


def release_checkpoint(folder: Path) -> None:
    """Let other processes have the checkpoint in a folder, if this one has it."""
    if (lock := _held.pop(folder.resolve(), None)) is not None:
        lock.release()


def hash_work(work: Mapping[str, Any]) -> str:
    """Return the digest of all that decides a result, given as JSON values."""
    return hashlib.sha256(json.dumps(work, sort_keys=True).encode()).hexdigest()


def claim_checkpoint(folder: Path, work: str, resume: bool, note: Note) -> None:
    """Make `folder` the checkpoint of the work with this digest; with `resume` what is there stays.

    This process has its lock, where the system has locks, until `remove_checkpoint` or `release_checkpoint`.
    A checkpoint whose stamp is damaged is set aside.

    Raises
    ------
    ConfigError
        If another process has it, it holds anything foreign, cannot be written, or is of other work.
    UnfinishedWorkError
        If an interrupted run left part of this work there, and `resume` does not say to go on with it.
    """
    require_own_checkpoint(folder)
    lock = _lock(folder)
    if not is_lock_only(folder) and _work_of(folder) is None:
        note(f"{folder} is damaged: it is now {set_aside(folder).name}, and its run starts afresh")
        lock = _lock(folder)
    _prepare(folder, work, resume)
    if lock is not None:
        _held[folder.resolve()] = lock


def _prepare(folder: Path, work: str, resume: bool) -> None:
    """Leave a checkpoint of this work alone in a folder."""
    if resume and (found := _work_of(folder)) is not None:
        if found != work:
            raise ConfigError(
                "the interrupted run was of other work",
                where=str(folder),
                expected="the same data, configuration, seed and versions",
                fix="run again without --resume, which starts afresh",
            )
        return
    if _work_of(folder) == work and _holds_results(folder):
        raise UnfinishedWorkError(
            "holds the unfinished work of an earlier run, which was interrupted or killed",
            where=str(folder),
            expected="--resume (in Python: resume=True), which goes on with it",
            fix="to start afresh instead, remove this folder",
        )
    _empty(folder)
    with replace_file(folder / STAMP) as fresh:
        fresh.write_text(checkpoint_stamp(work), encoding="ascii")


def remove_checkpoint(folder: Path, note: Note) -> None:
    """Remove the checkpoint of a run that is complete; where it holds anything foreign it stays."""
    if not folder.is_dir():
        release_checkpoint(folder)
        return
    lock = None
    try:
        faults = find_foreign(folder, "checkpoint")
        lock = None if faults else _lock(folder)
    except ConfigError as error:
        faults = [str(error)]
    if faults:
        note(f"{folder} is not removed: it holds {', '.join(faults)}")
    else:
        with suppress(OSError):  # what stays has its stamp still: the next run removes it
            remove_folder(folder, (LOCK_NAME, STAMP))
    release_checkpoint(folder)
    if lock is not None:
        lock.release()


def _work_of(folder: Path) -> str | None:
    """Return of which work a checkpoint is; None if it has no stamp, or a damaged one."""
    try:
        work = read_stamp(folder).get("work")
    except DataError:
        return None
    return work if isinstance(work, str) else None


def _holds_results(folder: Path) -> bool:
    return any(one.name not in (LOCK_NAME, STAMP) for one in folder.iterdir())


def _empty(folder: Path) -> None:
    """Remove all but the lock from a checkpoint in which nothing is foreign."""
    remove_contents(folder, (STAMP,), keep=(LOCK_NAME,))


def _lock(folder: Path) -> Lock | None:
    """Make the folder, and take its lock; None where the system, or the disk, has no locks.

    Raises
    ------
    ConfigError
        If another process has it, or nothing can be written there.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        file = os.open(folder / LOCK_NAME, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o666)
    except OSError as error:
        raise not_writable_error(folder, error.strerror or type(error).__name__) from None
    if fcntl is None:
        os.close(file)
        return None
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        holder = os.pread(file, _MAX_LOCK_BYTES, 0).decode("ascii", "replace").strip()
        os.close(file)
        if error.errno in (errno.EWOULDBLOCK, errno.EACCES) and holder != _THIS_PROCESS:
            raise _busy_error(folder, holder.partition(" ")[0]) from None
        return None
    os.ftruncate(file, 0)
    os.pwrite(file, f"{_THIS_PROCESS}\n".encode("ascii"), 0)
    return Lock(file)


def _busy_error(folder: Path, process: str) -> ConfigError:
    return ConfigError(
        f"another run of needlefit (process {process or 'unknown'}) is writing there",
        where=str(folder),
        expected="one run at a time for each folder of results",
        fix="wait until it has ended, or choose another folder with --out",
    )
