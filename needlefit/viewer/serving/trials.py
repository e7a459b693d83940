"""The needles of all windows."""

import secrets
from collections.abc import Callable
from datetime import datetime
from pathlib import Path, PurePath

from needlefit.errors import ModelError
from needlefit.viewer.recording.log import Recording
from needlefit.viewer.serving.trial import Trial
from needlefit.viewer.subject import Subject

MOST = 32
"""Needles that are kept; of more, those whose windows closed longest ago are let go, but no recording."""


class Trials:
    """Every window has a needle of its own; a page that comes back finds the one it had.

    Parameters
    ----------
    subject : Subject
        What a new window shows.
    folder : Path
        Where recordings are written.
    reopen : callable
        Name of an insertion -> the subject that shows it.
    source : Recording, optional
        What a new window can replay.
    """

    def __init__(
        self,
        subject: Subject,
        folder: Path,
        reopen: Callable[[str], Subject],
        source: Recording | None = None,
    ) -> None:
        self._subject, self._folder, self._reopen, self._source = subject, folder, reopen, source
        self._all: dict[str, Trial] = {}
        self._subjects: dict[str, Subject] = {}
        self._paths: list[Path] = []
        self._steered: set[str] = set()

    def open(self, name: str) -> Trial:
        """Return the needle of this name, or a new one where there is none."""
        trial = self._all.get(name) or self._begin(self._subject, self._source)
        self._steered.add(trial.name)
        return trial

    def known(self, name: str) -> Trial | None:
        """Return the needle of this name, if there is one."""
        return self._all.get(name)

    def close(self, trial: Trial) -> None:
        """Say that no window steers a needle any more; it is there until too many others are."""
        self._steered.discard(trial.name)
        if trial.name in self._all:  # the youngest of those that nobody steers
            self._all[trial.name] = self._all.pop(trial.name)

    def prepare(self, trial: Trial, insertion: str) -> None:
        """Read what it takes to show another insertion, so that `another` need not; may run beside it."""
        if insertion in trial.subject.choices and insertion not in self._subjects:
            self._subjects[insertion] = self._reopen(insertion)

    def another(self, trial: Trial, insertion: str) -> Trial:
        """Return the needle that the same window had beside another insertion, or a new one.

        Raises
        ------
        ModelError
            If the dataset has no such insertion.
        """
        if insertion not in trial.subject.choices:
            raise ModelError(f"there is no insertion `{insertion:.40}`", expected="one of the list")
        self.prepare(trial, insertion)
        there = trial.kin.get(insertion)
        return self._instead(trial, there or self._begin(self._subjects[insertion], None))

    def again(self, trial: Trial, source: Recording) -> Trial:
        """Return a new needle for the same window, at first contact, for a replay."""
        return self._instead(trial, self._begin(trial.subject, source))

    def written(self) -> list[Path]:
        """Return the recordings that were begun."""
        return [path for path in self._paths if path.exists()]

    def _instead(self, trial: Trial, other: Trial) -> Trial:
        """Give a window another needle; whoever steers the first says himself that he does no more."""
        other.kin = trial.kin
        other.kin[other.beside] = other
        self._all[other.name] = other
        self._steered.add(other.name)
        return other

    def _begin(self, subject: Subject, source: Recording | None) -> Trial:
        name = secrets.token_hex(4)
        path = self._folder / f"{_stem(subject.name)}-{datetime.now():%Y%m%d-%H%M%S}-{name}.csv"
        self._all[name] = Trial(name, subject, path, source)
        self._paths.append(path)
        for old in [one for one in self._all if one not in self._steered and one != name]:
            if len(self._all) <= MOST:
                break
            del self._all[old]
        return self._all[name]


def _stem(subject: str) -> str:
    """Return a subject's name as that of a file: of a path the last two parts."""
    last = "-".join(PurePath(subject.removesuffix(".toml")).parts[-2:])
    return "".join(c if c.isalnum() or c in "-_" else "-" for c in last).strip("-") or "needle"
