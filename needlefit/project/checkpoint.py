"""The checkpoint of a running command, `NAME.partial`: what is finished, from which `--resume` goes on.

Each kind of work has a file of rows there: lines of JSON, each behind a digest of it, with arrays as base64.
A row is appended at once, so that a kill leaves whole rows, and perhaps the beginning of one, which is then
set aside. Beside its rows a work may keep one file that a library writes (HDF5), as a whole. No file holds
code. One process at a time may use the folder.
"""

import base64
import hashlib
import json
import math
import os
import re
import secrets
import shutil
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from needlefit.errors import ConfigError, DataError, UnfinishedWorkError
from needlefit.project.folders import (
    FILE_MANAGER_FILES,
    LOCK_NAME,
    MANIFEST,
    find_empty_folders,
    format_manifest,
    is_regular,
    list_all_files,
    not_writable_error,
    read_manifest,
    remove_contents,
    remove_folder,
    require_replaceable,
    try_lock,
)
from needlefit.project.input_files import parse_json, read_bytes
from needlefit.project.progress import Note, no_note

MAX_CHECKPOINT_BYTES = 2**31  # size of a file of rows
ARRAYS_KEY = "arrays"  # of a row: its arrays by name
FILE_KEY = "file"  # of a row: the digest of the file that was kept with it
_DIGEST_CHARACTERS = 16
_ARRAY_TYPES = ("<f8", "<f4", "<i8", "|b1")
_NEW_MANIFEST = f"{MANIFEST}.new"  # takes the place of the manifest once it is written
_OWN_FILE = re.compile(
    rf"({LOCK_NAME}|{re.escape(MANIFEST)}(\.new)?|[0-9a-f]{{16}}\.(jsonl(\.whole)?|h5(\.part)?))"
    r"(\.damaged-\d+)?"
)
_THIS_PROCESS = f"{os.getpid()} {secrets.token_hex(8)}"
"""In the lock file: processes of two containers may have one number."""

_LOCK_TEXT, _MAX_LOCK_BYTES = re.compile(rb"\d* ?[0-9a-f]{0,16}\n?"), 100
"""What the lock holds: nothing at first, then the process that has it, perhaps cut short."""

_held: dict[Path, int] = {}
"""Open lock files of this process: a complete run has its lock until its results stand."""


@dataclass(frozen=True)
class Checkpoint:
    """A folder of finished work, in rows by the name of their work; with folder None nothing is kept.

    What is damaged is set aside, `note` is given a line about it, and the rest is used.
    """

    folder: Path | None
    note: Note = no_note

    def rows(self, work: str, keys: Sequence[str] = ()) -> list[dict[str, Any]]:
        """Return the stored rows of one work, those with all of these `keys`, in the order they were kept.

        A line torn by a kill, or changed since, is none.
        """
        if self.folder is None or not self._file(work).is_file():
            return []
        lines = [line for line in read_bytes(self._file(work), MAX_CHECKPOINT_BYTES).split(b"\n") if line]
        found = [(line, _parse_row(line, keys)) for line in lines]
        if any(row is None for _, row in found):
            self.set_aside(work, [line for line, row in found if row is not None])
        return [row for _, row in found if row is not None]

    def keep_row(
        self, work: str, row: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]] | None = None
    ) -> None:
        """Store a row of JSON values, and arrays, under its key `arrays`; every float survives exactly."""
        if self.folder is None:
            return
        if arrays is not None:
            row = {**row, ARRAYS_KEY: {name: _encode_array(one) for name, one in arrays.items()}}
        text = json.dumps(row).encode("ascii")
        with self._file(work).open("ab") as file:
            file.write(b"\n" + _digest(text) + b" " + text + b"\n")  # the line before may be torn

    def set_aside(self, work: str, whole: Sequence[bytes] = ()) -> None:
        """Give a damaged file another name, and keep its whole lines under the old one."""
        file = self._file(work)
        kept = file.with_name(f"{file.name}.whole")
        kept.write_bytes(b"".join(line + b"\n" for line in whole))
        aside = set_aside(file)
        kept.replace(file)
        self.note(f"{file} was damaged: it is now {aside.name}; {len(whole)} whole rows of it are used")

    def open_file(self, work: str, keys: Sequence[str]) -> tuple[Path, dict[str, Any]]:
        """Return the file that a work writes to, as it was kept last, and the row kept with it, with `keys`.

        Without a kept file, or with a damaged one, which is set aside, there is neither.
        """
        kept = self._file(work, "h5")
        working = kept.with_name(f"{kept.name}.part")
        working.unlink(missing_ok=True)
        if kept.is_file():
            digest = _digest(read_bytes(kept, MAX_CHECKPOINT_BYTES)).decode("ascii")
            for row in self.rows(work, (FILE_KEY, *keys)):
                if row[FILE_KEY] == digest:
                    shutil.copyfile(kept, working)
                    return working, row
            self.note(f"{kept} was damaged: it is now {set_aside(kept).name}, and its work begins again")
        return working, {}

    def keep_file(self, work: str, row: Mapping[str, Any]) -> None:
        """Keep the file that a work writes to as it is now, with a row.

        A kill leaves the file that was kept before, or this one, each with its row.
        """
        kept = self._file(work, "h5")
        working = kept.with_name(f"{kept.name}.part")
        digest = _digest(read_bytes(working, MAX_CHECKPOINT_BYTES)).decode("ascii")
        self.keep_row(work, {**row, FILE_KEY: digest})
        working.replace(kept)
        shutil.copyfile(kept, working)

    def _file(self, work: str, ending: str = "jsonl") -> Path:
        assert self.folder is not None
        return self.folder / f"{hashlib.sha256(work.encode()).hexdigest()[:16]}.{ending}"


NO_CHECKPOINT = Checkpoint(None)  # keeps nothing


def _parse_row(line: bytes, keys: Sequence[str]) -> dict[str, Any] | None:
    """Return the row in a line; None if it is not as it was written."""
    digest, _, text = line.partition(b" ")
    if digest != _digest(text):
        return None
    try:
        row = parse_json(text.decode("ascii"), "")
        if isinstance(row, dict) and row.keys() >= set(keys):
            if ARRAYS_KEY in row:
                row[ARRAYS_KEY] = {name: _decode_array(*one) for name, one in row[ARRAYS_KEY].items()}
            return row
    except (AttributeError, DataError, TypeError, ValueError):  # UnicodeDecodeError and binascii's among them
        pass
    return None


def _digest(text: bytes) -> bytes:
    return hashlib.sha256(text).hexdigest()[:_DIGEST_CHARACTERS].encode("ascii")


def _encode_array(array: NDArray[Any]) -> tuple[str, list[int], str]:
    plain = np.ascontiguousarray(array).reshape(array.shape)
    kind = plain.dtype.newbyteorder("<").str
    if kind not in _ARRAY_TYPES:
        raise TypeError(f"no array of {array.dtype} is kept")
    data = base64.b64encode(plain.astype(kind, copy=False).tobytes()).decode("ascii")
    return kind, list(plain.shape), data


def _decode_array(kind: str, shape: list[int], data: str) -> NDArray[Any]:
    """Return the array; ValueError if its size, type or shape is not one that is written."""
    if (
        kind not in _ARRAY_TYPES
        or len(shape) > 8
        or not all(type(n) is int and 0 <= n < 2**40 for n in shape)
    ):
        raise ValueError("no array")
    decoded = base64.b64decode(data, validate=True)
    if len(decoded) != math.prod(shape) * np.dtype(kind).itemsize:
        raise ValueError("an array of another size")
    return np.frombuffer(bytearray(decoded), kind).reshape(shape)


def set_aside(path: Path) -> Path:
    """Give a damaged file or folder a new name, `NAME.damaged-1` or the first that is free; return it."""
    for number in range(1, 10_000):
        aside = path.with_name(f"{path.name}.damaged-{number}")
        if aside.exists() or aside.is_symlink():
            continue
        if path.is_dir():
            path.rename(aside)  # fails on a folder that holds anything
            return aside
        try:
            os.link(path, aside)  # unlike a renaming it overwrites nothing
        except FileExistsError:
            continue
        except OSError:  # a disk without links
            path.rename(aside)
            return aside
        path.unlink()
        return aside
    raise DataError("is damaged, and thousands of damaged ones lie beside it", where=str(path))


# --- the folder -----------------------------------------------------------------------------------------


def open_checkpoint(
    folder: Path | None, resume: bool, work: Mapping[str, Any], note: Note = no_note
) -> Checkpoint:
    """Open the checkpoint in `folder` for the given work; without `resume` an old one is emptied.

    This process has its lock, where the system has locks, until `remove_checkpoint` or `release_checkpoint`.
    A checkpoint whose manifest is damaged is set aside; `note` is given a line about each part that was
    damaged. With folder None nothing is kept. `work` is all that decides the result, as JSON values.

    ConfigError if the checkpoint is of other work, another process uses it, it cannot be written, or the
    folder holds anything that needlefit did not write. UnfinishedWorkError if an interrupted run left part of
    this work there, and `resume` does not say to go on with it.
    """
    if folder is None:
        return NO_CHECKPOINT
    require_own_checkpoint(folder)
    locked = _lock(folder)
    try:
        if _work_of(folder) is None and not {*list_all_files(folder)} <= {LOCK_NAME, _NEW_MANIFEST}:
            damaged = _held.pop(folder.resolve(), None)
            note(f"{folder} is damaged: it is now {set_aside(folder).name}, and its run starts afresh")
            locked = _lock(folder)
            if damaged is not None:
                os.close(damaged)
        _prepare(folder, hashlib.sha256(json.dumps(work, sort_keys=True).encode()).hexdigest(), resume)
    except BaseException:
        if locked:
            release_checkpoint(folder)
        raise
    return Checkpoint(folder, note)


def _prepare(folder: Path, work: str, resume: bool) -> None:
    """Leave a checkpoint of the work with this digest alone in a folder."""
    found = _work_of(folder)
    if resume and found is not None:
        if found != work:
            raise ConfigError(
                "the interrupted run was of other work",
                where=str(folder),
                expected="the same data, configuration, seed and versions",
                fix="run again without --resume, which starts afresh",
            )
        return
    if found == work and any(one.name not in (LOCK_NAME, MANIFEST) for one in folder.iterdir()):
        raise UnfinishedWorkError(
            "holds the unfinished work of an earlier run, which was interrupted or killed",
            where=str(folder),
            expected="--resume (in Python: resume=True), which goes on with it",
            fix="to start afresh instead, remove this folder",
        )
    remove_contents(folder, (MANIFEST,), keep=(LOCK_NAME,))
    new = folder / _NEW_MANIFEST
    new.write_text(format_manifest({"holds": "checkpoint", "work": work}), encoding="ascii")
    new.replace(folder / MANIFEST)  # a kill leaves a whole one, or none


def remove_checkpoint(folder: Path, note: Note) -> None:
    """Remove the checkpoint of a run that is complete; where it holds anything foreign it stays."""
    if not folder.is_dir():
        release_checkpoint(folder)
        return
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
            remove_folder(folder, (LOCK_NAME, MANIFEST))
    release_checkpoint(folder)


def hold_checkpoint(folder: Path) -> None:
    """Take the lock of a checkpoint that another process of this program released, until it is removed."""
    with suppress(ConfigError):  # somebody else was faster, and has it
        if folder.is_dir():
            _lock(folder)


def release_checkpoint(folder: Path) -> None:
    """Let other processes have the checkpoint in a folder, if this one has it."""
    if (lock := _held.pop(folder.resolve(), None)) is not None:
        os.close(lock)


def require_own_checkpoint(folder: Path) -> None:
    """Raise ConfigError unless a checkpoint may be kept in `folder`: missing, empty, or needlefit's own."""
    require_replaceable(folder, find_foreign_in_checkpoint)


def find_foreign_in_checkpoint(folder: Path) -> list[str]:
    """Return what a run does not keep in a checkpoint: all of it where neither lock nor manifest is a run's.

    A run that ended before its manifest was written leaves its lock.
    """
    names = [name for name in list_all_files(folder) if Path(name).name not in FILE_MANAGER_FILES]
    own = _is_lock(folder / LOCK_NAME) or _work_of(folder) is not None
    foreign = [n for n in names if not (own and _OWN_FILE.fullmatch(n) and is_regular(folder / n))]
    return [*foreign, *find_empty_folders(folder, names, ())]


def _is_lock(path: Path) -> bool:
    try:
        return is_regular(path) and bool(_LOCK_TEXT.fullmatch(read_bytes(path, _MAX_LOCK_BYTES)))
    except DataError:
        return False


def _work_of(folder: Path) -> str | None:
    """Return of which work a checkpoint is; None if it has no manifest, or a damaged one."""
    try:
        work = read_manifest(folder).get("work")
    except DataError:
        return None
    return work if isinstance(work, str) else None


def _lock(folder: Path) -> bool:
    """Make the folder, and take its lock; False where this process has it, or the disk has no locks.

    ConfigError if another process has it, or nothing can be written there.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        file = os.open(folder / LOCK_NAME, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o666)
    except OSError as error:
        raise not_writable_error(folder, error.strerror or type(error).__name__) from None
    locked = try_lock(file)
    if not locked:
        holder = os.pread(file, _MAX_LOCK_BYTES, 0).decode("ascii", "replace").strip()
        os.close(file)
        if locked is False and holder != _THIS_PROCESS:
            process = holder.partition(" ")[0] or "unknown"
            raise ConfigError(
                f"another run of needlefit (process {process}) is writing there",
                where=str(folder),
                expected="one run at a time for each folder of results",
                fix="wait until it has ended, or choose another folder with --out",
            )
        return False
    os.ftruncate(file, 0)
    os.pwrite(file, f"{_THIS_PROCESS}\n".encode("ascii"), 0)
    if (before := _held.pop(folder.resolve(), None)) is not None:  # of a folder that was removed meanwhile
        os.close(before)
    _held[folder.resolve()] = file
    return True
