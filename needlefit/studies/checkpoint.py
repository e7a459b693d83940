"""Store what an interrupted run has finished, so that it resumes to the same result."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from needlefit.errors import DataError, FitError
from needlefit.inference.fit import Start, start_from_dict, start_to_dict
from needlefit.inference.sampling.sample import Snapshots
from needlefit.project.atomic_write import replace_file
from needlefit.project.checkpoint_file import MAX_CHECKPOINT_BYTES, set_aside
from needlefit.project.checkpoint_folder import claim_checkpoint, hash_work
from needlefit.project.input_files import parse_json, read_bytes
from needlefit.project.progress import Note, no_note

_DIGEST_CHARACTERS = 16


@dataclass(frozen=True)
class Checkpoint:
    """A folder of finished work: one file of starts per search, and sampler snapshots per fold.

    Whatever else is finished piece by piece is kept as rows of JSON values, each behind a digest of it. None
    keeps nothing. What is damaged is set aside, `note` is given a line about it, and the rest is used.
    """

    folder: Path | None
    note: Note = no_note

    def finished(self, search: str) -> dict[int, Start]:
        """Return the stored starts of one search."""
        try:
            starts = [start_from_dict(row) for row in self.rows(search)]
        except FitError:  # rows of something else, however whole
            self._set_aside(search, [])
            return {}
        return {start.index: start for start in starts}

    def keep(self, search: str, start: Start) -> None:
        """Store a finished start."""
        self.keep_row(search, start_to_dict(start))

    def rows(self, work: str, keys: Sequence[str] = ()) -> list[dict[str, Any]]:
        """Return the stored rows of one file, those with all of these `keys`.

        A line torn by a kill, or changed since, is none.
        """
        if self.folder is None or not self._file(work).is_file():
            return []
        lines = [line for line in read_bytes(self._file(work), MAX_CHECKPOINT_BYTES).split(b"\n") if line]
        found = [(line, _parse_row(line, keys)) for line in lines]
        if any(row is None for _, row in found):
            self._set_aside(work, [line for line, row in found if row is not None])
        return [row for _, row in found if row is not None]

    def keep_row(self, work: str, row: Mapping[str, Any]) -> None:
        """Store a row; every float survives exactly."""
        if self.folder is None:
            return
        text = json.dumps(row).encode("ascii")
        with self._file(work).open("ab") as file:
            file.write(b"\n" + _digest(text) + b" " + text + b"\n")  # the line before may be torn

    def snapshots(self, fold: str) -> Snapshots:
        """Return the store of the sampler's snapshots of one fold."""
        folder = None if self.folder is None else self.folder / f"{_hash_name(fold)}.posterior"
        return Snapshots(folder, self.note)

    def _file(self, search: str) -> Path:
        assert self.folder is not None
        return self.folder / f"{_hash_name(search)}.jsonl"

    def _set_aside(self, work: str, whole: list[bytes]) -> None:
        """Give the damaged file another name, and keep its whole lines under the old one."""
        file = self._file(work)
        aside = set_aside(file)
        with replace_file(file) as fresh:
            fresh.write_bytes(b"".join(line + b"\n" for line in whole))
        self.note(f"{file} was damaged: it is now {aside.name}; {len(whole)} whole rows of it are used")


def open_checkpoint(
    folder: Path | None, resume: bool, work: Mapping[str, Any], note: Note = no_note
) -> Checkpoint:
    """Open the checkpoint in `folder` for the given work; without `resume` an old one is emptied.

    Parameters
    ----------
    folder : Path or None
    resume : bool
    work : mapping
        All that decides the result, as JSON values: a checkpoint of other work is refused.
    note : callable
        Given a line about each part that was damaged.

    Raises
    ------
    ConfigError
        If the checkpoint belongs to other work, or another process uses it, or the folder holds anything that
        needlefit did not write.
    """
    if folder is None:
        return Checkpoint(None)
    claim_checkpoint(folder, hash_work(work), resume, note)
    return Checkpoint(folder, note)


def _parse_row(line: bytes, keys: Sequence[str]) -> dict[str, Any] | None:
    """Return the row in a line; None if it is not as it was written."""
    digest, _, text = line.partition(b" ")
    if digest != _digest(text):
        return None
    try:
        row = parse_json(text.decode("ascii"), "")
    except (DataError, UnicodeDecodeError):
        return None
    return row if isinstance(row, dict) and row.keys() >= set(keys) else None


def _digest(text: bytes) -> bytes:
    return hashlib.sha256(text).hexdigest()[:_DIGEST_CHARACTERS].encode("ascii")


def _hash_name(name: str) -> str:
    """Return a name for files: a fold may be named anything."""
    return hashlib.sha256(name.encode()).hexdigest()[:16]
