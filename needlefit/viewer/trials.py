"""All interactive trials of the server: begun for windows, and from other trials."""

import secrets
from collections.abc import Callable
from dataclasses import replace
from datetime import datetime
from pathlib import Path, PurePath

from needlefit.errors import ModelError
from needlefit.planning.recording import Recording
from needlefit.viewer.trial import InteractiveTrial
from needlefit.viewer.viewed_scene import ViewedScene

#: number of trials that are kept. Beyond it, those whose windows closed first are dropped; their recordings
#: stay.
MAX_TRIALS = 32


class TrialRegistry:
    """All trials of the server; a page that reconnects gets its own trial again.

    A new window shows `viewed_scene`, at the end of `source` where there is one. Recordings are written to
    `folder`. `reopen` returns the scene that shows the insertion of a name.
    """

    def __init__(
        self,
        viewed_scene: ViewedScene,
        folder: Path,
        reopen: Callable[[str], ViewedScene],
        source: Recording | None = None,
    ) -> None:
        self._viewed_scene, self._folder, self._reopen, self._source = viewed_scene, folder, reopen, source
        self._all: dict[str, InteractiveTrial] = {}
        self._viewed_scenes: dict[str, ViewedScene] = {}
        self._paths: list[Path] = []
        self._steered: set[str] = set()

    def open(self, name: str) -> InteractiveTrial:
        """Return the trial of this name, or a new one if there is none."""
        trial = self._all.get(name) or self._begin(self._viewed_scene, self._source)
        self._steered.add(trial.name)
        return trial

    def known(self, name: str) -> InteractiveTrial | None:
        return self._all.get(name)

    def close(self, trial: InteractiveTrial) -> None:
        """Note that no window controls a trial any more; it is kept until there are too many others."""
        self._steered.discard(trial.name)
        if trial.name in self._all:  # becomes the newest of those without a window
            self._all[trial.name] = self._all.pop(trial.name)

    def another(self, trial: InteractiveTrial, insertion: str) -> InteractiveTrial:
        """Return a new trial with another insertion, for the window of a trial, which the caller closes.

        ModelError if the dataset has no such insertion.
        """
        if insertion not in trial.viewed_scene.choices:
            raise ModelError(f"there is no insertion `{insertion:.40}`", expected="one of the list")
        if insertion not in self._viewed_scenes:
            self._viewed_scenes[insertion] = self._reopen(insertion)
        other = self._begin(self._viewed_scenes[insertion])
        self._steered.add(other.name)
        return other

    def written(self) -> list[Path]:
        return [path for path in self._paths if path.exists()]

    def _begin(self, viewed_scene: ViewedScene, source: Recording | None = None) -> InteractiveTrial:
        name = secrets.token_hex(4)
        last = "-".join(
            PurePath(viewed_scene.name.removesuffix(".toml")).parts[-2:]
        )  # of a path the last two
        stem = "".join(c if c.isalnum() or c in "-_" else "-" for c in last).strip("-") or "needle"
        path = self._folder / f"{stem}-{datetime.now():%Y%m%d-%H%M%S}-{name}.csv"
        self._all[name] = trial = InteractiveTrial(name, viewed_scene, path)
        for step in source.steps if source else ():
            trial.record(replace(step, gesture=-step.number))  # each is undone by itself
        self._paths.append(path)
        for old in [one for one in self._all if one not in self._steered and one != name]:
            if len(self._all) <= MAX_TRIALS:
                break
            del self._all[old]
        return trial
