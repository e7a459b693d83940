"""The checkpoint of a running command, `NAME.partial`: what is finished, from which `--resume` goes on.

Each kind of work has a file of rows there: lines of JSON with a digest. A row is
appended at once, so that a kill leaves whole rows, and perhaps the beginning of one, which is no row. No file
holds code. One process at a time may use the folder.
"""

import hashlib
import json
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from needlefit.errors import ConfigError, DataError, UnfinishedWorkError
from needlefit.project.callbacks import Note, no_note
from needlefit.project.folders import (
    FILE_MANAGER_FILES,
    LOCK_NAME,
    MANIFEST,
    format_manifest,
    is_regular,
    list_all_files,
    read_manifest,
    require_replaceable,
    take_lock,
)
from needlefit.project.input_files import digest_values, parse_json, read_bytes
from needlefit.project.stored_values import decode, encode

if TYPE_CHECKING:
    from filelock import BaseFileLock

T = TypeVar("T")

MAX_CHECKPOINT_BYTES = 2**31  # largest size of a file of rows (bytes)
DIGEST_KEY = "sha256"  # key of a row whose value is the digest of the rest of the row
_OWN_FILE = re.compile(rf"{LOCK_NAME}|{re.escape(MANIFEST)}|[0-9a-f]{{16}}\.jsonl")

_held: "dict[Path, BaseFileLock]" = {}
"""Locks of this process: a complete run has its lock until its results stand."""


@dataclass(frozen=True)
class Checkpoint:
    """A folder of finished work, in rows by the name of their work; with folder None nothing is kept.

    What is damaged is not used, and `note` is given a line about it.
    """

    folder: Path | None
    note: Note = no_note

    def rows(self, work: str) -> list[dict[str, Any]]:
        """Return the stored rows of one work, in the order they were kept."""
        if self.folder is None or not self._file(work).is_file():
            return []
        lines = [line for line in read_bytes(self._file(work), MAX_CHECKPOINT_BYTES).split(b"\n") if line]
        parsed = [row for line in lines if (row := _parse_row(line)) is not None]
        if len(parsed) < len(lines):
            self.note(f"{self._file(work)} was damaged: {len(parsed)} whole rows of it are used")
        return parsed

    def read(self, work: str, kind: type[T]) -> T | None:
        """Return the first row of one work that is a dataclass of a kind; None if there is none."""
        for row in self.rows(work):
            with suppress(ValueError):  # a row of something else, however whole
                value: T = decode(row, kind)
                return value
        return None

    def keep(self, work: str, value: object) -> None:
        """Store a dataclass, as `read` returns it."""
        self.keep_row(work, encode(value))

    def keep_row(self, work: str, row: Mapping[str, Any]) -> None:
        """Store a row of JSON values; every float survives exactly.

        UnfinishedWorkError if it cannot be written.
        """
        if self.folder is None:
            return
        line = json.dumps({**row, DIGEST_KEY: _digest_row(row)})
        try:
            with self._file(work).open("ab") as file:
                file.write(b"\n" + line.encode("ascii") + b"\n")  # the line before may be torn
        except OSError as error:  # a full disk
            raise UnfinishedWorkError(
                f"what is finished cannot be kept: {error.strerror}",
                expected="a disk with space left",
                fix="free some space; what was kept before is not lost",
                where=self.folder,
            ) from error

    def _file(self, work: str) -> Path:
        assert self.folder is not None
        return self.folder / f"{hashlib.sha256(work.encode()).hexdigest()[:16]}.jsonl"


NO_CHECKPOINT = Checkpoint(None)  # checkpoint that keeps nothing


def _parse_row(line: bytes) -> dict[str, Any] | None:
    """Return the row in a line; None if it is not whole."""
    try:
        row = parse_json(line.decode("ascii"), "")
        if row.pop(DIGEST_KEY) == _digest_row(row):
            return row
    except (AttributeError, DataError, KeyError, MemoryError, TypeError, ValueError):
        pass
    return None


def _digest_row(row: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(row, sort_keys=True).encode("ascii")).hexdigest()


# --- the folder -----------------------------------------------------------------------------------------


def open_checkpoint(
    folder: Path | None, resume: bool, work: Mapping[str, Any], note: Note = no_note
) -> Checkpoint:
    """Open the checkpoint in `folder` for the given work; without `resume` an old one is emptied.

    This process has its lock until `remove_checkpoint` or `release_checkpoint`. A checkpoint whose manifest
    is damaged is emptied; `note` is given a line about what was damaged. With folder None nothing is kept.
    `work` is all that decides the result, as JSON values.

    ConfigError if the checkpoint is of other work, another process uses it, it cannot be written, or the
    folder holds anything that needlefit did not write. UnfinishedWorkError if an interrupted run left part of
    this work there, and `resume` does not ask to go on with it.
    """
    if folder is None:
        return NO_CHECKPOINT
    require_own_checkpoint(folder)
    taken = _lock(folder)
    try:
        _prepare(folder, digest_values(work), resume, note)
    except BaseException:
        if taken:
            release_checkpoint(folder)
        raise
    return Checkpoint(folder, note)


def _prepare(folder: Path, work: str, resume: bool, note: Note) -> None:
    """Leave a checkpoint of the work with this digest alone in a folder."""
    present = _work_of(folder)
    if resume and present is not None:
        if present != work:
            raise ConfigError(
                "the interrupted run was of other work",
                expected="the same data, configuration, seed and versions",
                fix="remove this folder; of a run, or leave out --resume: the work then starts afresh",
                where=folder,
            )
        return
    if present == work and any(path.name not in (LOCK_NAME, MANIFEST) for path in folder.iterdir()):
        raise UnfinishedWorkError(
            "holds the unfinished work of an earlier run",
            fix="go on with --resume (in Python: resume=True), or remove this folder",
            where=folder,
        )
    if present is None and {*list_all_files(folder)} > {LOCK_NAME}:
        note(f"{folder} is damaged: its run starts afresh")
    _remove_files(folder, keep=LOCK_NAME)
    text = format_manifest({"holds": "checkpoint", "work": work})
    (folder / MANIFEST).write_text(text, encoding="ascii")


def _remove_files(folder: Path, keep: str = "") -> None:
    """Remove the files of a checkpoint; the manifest last: a kill leaves what the next run knows."""
    for name in sorted(list_all_files(folder), key=lambda name: (name in (LOCK_NAME, MANIFEST), name)):
        if name != keep:
            (folder / name).unlink()


def remove_checkpoint(folder: Path, note: Note) -> None:
    """Remove the checkpoint of a run that is complete; where it holds anything foreign it stays."""
    if folder.is_dir():
        try:
            faults = find_foreign_in_checkpoint(folder)
            if not faults:
                _lock(folder)
        except ConfigError as error:
            faults = [str(error)]
        if faults:
            note(f"{folder} is not removed: it holds {', '.join(faults)}")
        else:
            with suppress(OSError):  # what stays has its manifest still: the next run removes it
                _remove_files(folder)
                folder.rmdir()
    release_checkpoint(folder)


def abandon_checkpoint(folder: Path, note: Note) -> None:
    """Remove the checkpoint of a run that ended by an error, by which the same run would end again.

    Of a run that did not get as far as to have it, nothing is removed.
    """
    if folder.resolve() in _held:
        remove_checkpoint(folder, note)


def release_checkpoint(folder: Path) -> None:
    """Let other processes have the checkpoint in a folder, if this one has it."""
    if (lock := _held.pop(folder.resolve(), None)) is not None:
        lock.release()


def require_own_checkpoint(folder: Path) -> None:
    """Raise ConfigError unless a checkpoint may be kept in `folder`: missing, empty, or needlefit's own."""
    require_replaceable(folder, find_foreign_in_checkpoint)


def find_foreign_in_checkpoint(folder: Path) -> list[str]:
    """Return what a run does not keep in a checkpoint: all of it where there is neither lock nor manifest.

    A run that ended before its manifest was written leaves its lock.
    """
    names = [name for name in list_all_files(folder) if Path(name).name not in FILE_MANAGER_FILES]
    is_checkpoint = is_regular(folder / LOCK_NAME) or _work_of(folder) is not None
    return [
        name
        for name in names
        if not (is_checkpoint and _OWN_FILE.fullmatch(name) and is_regular(folder / name))
    ]


def _work_of(folder: Path) -> str | None:
    """Return of which work a checkpoint is; None if it has no manifest, or a damaged one."""
    try:
        work = read_manifest(folder).get("work")
    except DataError:
        return None
    return work if isinstance(work, str) else None


def _lock(folder: Path) -> bool:
    """Take the lock of a folder; False where this process has it. ConfigError as of `take_lock`."""
    if folder.resolve() in _held:
        if (folder / LOCK_NAME).exists():
            return False
        release_checkpoint(folder)  # of a folder that was removed meanwhile
    _held[folder.resolve()] = take_lock(folder)
    return True
