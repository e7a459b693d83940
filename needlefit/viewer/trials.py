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

    def open(self, name: str) -> InteractiveTrial:
        """Return the trial of this name, or a new one if there is none."""
        return self._all.get(name) or self._begin(self._viewed_scene, self._source)

    def known(self, name: str) -> InteractiveTrial | None:
        return self._all.get(name)

    def another(self, trial: InteractiveTrial, insertion: str) -> InteractiveTrial:
        """Return a new trial with another insertion, for the window of a trial.

        ModelError if the dataset has no such insertion.
        """
        if insertion not in trial.viewed_scene.choices:
            raise ModelError(f"there is no insertion `{insertion:.40}`", expected="one of the list")
        return self._begin(self._reopen(insertion))

    def written(self) -> list[Path]:
        return [path for one in self._all.values() if (path := one.recorder.path).exists()]

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
        return trial
