"""What an interrupted run has finished, so that it resumes to the same result."""

import hashlib
import json
import shutil
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from needlefit.errors import ConfigError
from needlefit.inference.sampling.snapshots import Snapshots
from needlefit.inference.starts import Start, from_dict, to_dict
from needlefit.project.replace import replacing_file


@dataclass(frozen=True)
class Checkpoint:
    """A folder: finished starts, one file per search, and a folder of the sampler's snapshots per fold.

    Whatever else is finished piece by piece is kept as rows of JSON values. None keeps nothing.
    """

    folder: Path | None

    def finished(self, search: str) -> dict[int, Start]:
        """Return the starts of one search that are kept; a line torn by a kill is not one."""
        starts = (from_dict(row) for row in self.rows(search))
        return {start.index: start for start in starts}

    def keep(self, search: str, start: Start) -> None:
        """Add a finished start."""
        self.keep_row(search, to_dict(start))

    def rows(self, of: str) -> list[dict[str, Any]]:
        """Return the rows that are kept of some work; a line torn by a kill is none."""
        if self.folder is None or not self._file(of).is_file():
            return []
        found = []
        for line in self._file(of).read_text(encoding="utf-8").splitlines():
            with suppress(json.JSONDecodeError):
                found.append(json.loads(line))
        return found

    def keep_row(self, of: str, row: Mapping[str, Any]) -> None:
        """Add a row; every float survives exactly."""
        if self.folder is None:
            return
        with self._file(of).open("a", encoding="utf-8") as file:
            file.write("\n" + json.dumps(row) + "\n")  # the line before may be torn

    def snapshots(self, fold: str) -> Snapshots:
        """Return where the sampler of one fold keeps its steps."""
        return Snapshots(None if self.folder is None else self.folder / f"{_key(fold)}.posterior")

    def _file(self, search: str) -> Path:
        assert self.folder is not None
        return self.folder / f"{_key(search)}.jsonl"


def _key(name: str) -> str:
    """Return a name for files: a fold may be named anything."""
    return hashlib.sha256(name.encode()).hexdigest()[:16]


def open_checkpoint(folder: Path | None, resume: bool, work: Mapping[str, Any]) -> Checkpoint:
    """Return the checkpoint in `folder` for the given work; without `resume` an old one is emptied.

    Parameters
    ----------
    folder : Path or None
    resume : bool
    work : mapping
        All that decides the result, as JSON values: a checkpoint of other work is refused.

    Raises
    ------
    ConfigError
        If the checkpoint belongs to other work.
    """
    if folder is None:
        return Checkpoint(None)
    digest = hashlib.sha256(json.dumps(work, sort_keys=True).encode()).hexdigest()
    stamp = folder / "work.sha256"
    if resume and stamp.is_file():
        if stamp.read_text(encoding="ascii") != digest:
            raise ConfigError(
                "the interrupted run was of other work",
                where=str(folder),
                expected="the same data, configuration, seed and versions",
                mend="run again without --resume, which starts afresh",
            )
        return Checkpoint(folder)
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    with replacing_file(stamp) as path:  # half a stamp would be taken for that of other work
        path.write_text(digest, encoding="ascii")
    return Checkpoint(folder)
