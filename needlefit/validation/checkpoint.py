"""Finished starts of an interrupted run, so that it resumes to the same result."""

import hashlib
import json
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from needlefit.errors import ConfigError
from needlefit.inference.starts import Start, from_dict, to_dict


@dataclass(frozen=True)
class Checkpoint:
    """A folder of finished starts, one file per search; None keeps nothing."""

    folder: Path | None

    def finished(self, search: str) -> dict[int, Start]:
        """Return the starts of one search that are kept; a line torn by a kill is not one."""
        if self.folder is None or not self._file(search).is_file():
            return {}
        starts = {}
        for line in self._file(search).read_text(encoding="utf-8").splitlines():
            try:
                start = from_dict(json.loads(line))
            except json.JSONDecodeError:
                continue
            starts[start.index] = start
        return starts

    def keep(self, search: str, start: Start) -> None:
        """Add a finished start."""
        if self.folder is None:
            return
        with self._file(search).open("a", encoding="utf-8") as file:
            file.write("\n" + json.dumps(to_dict(start)) + "\n")  # the line before may be torn

    def _file(self, search: str) -> Path:
        assert self.folder is not None
        name = hashlib.sha256(search.encode()).hexdigest()[:16]  # a fold may be named anything
        return self.folder / f"{name}.jsonl"


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
    stamp.write_text(digest, encoding="ascii")
    return Checkpoint(folder)
