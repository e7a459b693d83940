"""All interactive trials of the server: begun for windows, and from other trials."""

import secrets
from collections.abc import Callable
from dataclasses import replace
from datetime import datetime
from pathlib import Path, PurePath

from needlefit.errors import ModelError
from needlefit.viewer.plans import shift_entry
from needlefit.viewer.recording import Recording
from needlefit.viewer.steering import find_tissue_changes
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
        """Return the window's trial with another insertion, or a new trial.

        ModelError if the dataset has no such insertion.
        """
        if insertion not in trial.viewed_scene.choices:
            raise ModelError(f"there is no insertion `{insertion:.40}`", expected="one of the list")
        there = trial.window_trials.get(insertion)
        if there is None and insertion not in self._viewed_scenes:
            self._viewed_scenes[insertion] = self._reopen(insertion)
        return self._instead(trial, there or self._begin(self._viewed_scenes[insertion]))

    def entered(self, trial: InteractiveTrial) -> InteractiveTrial:
        """Return a new trial at first contact, at the entry of a trial's plan, with its parameters and plan.

        ModelError if the trial has no plan.
        """
        plan = trial.aim.plan
        if plan is None:
            raise ModelError("there is no plan", expected="a plan", fix="plan again")
        other = self._begin(shift_entry(trial.viewed_scene, plan.entry_mm))
        changes = find_tissue_changes(trial.steering.now.tissue, other.scene.tissue)
        if changes:
            other.act(changes, gesture=0)
        moved, aim = plan.move_to_entry(), other.aim
        aim.set(moved.goal.target, moved.goal.radius, moved.goal.obstacles, trial.aim.roll_deg)
        aim.plan, aim.plan_step = moved, other.steering.number
        return self._instead(trial, other)

    def written(self) -> list[Path]:
        return [path for path in self._paths if path.exists()]

    def _instead(self, trial: InteractiveTrial, other: InteractiveTrial) -> InteractiveTrial:
        """Give a window another needle; the caller closes the first one."""
        other.window_trials = trial.window_trials
        other.window_trials[other.shown_insertion] = other
        self._all[other.name] = other
        self._steered.add(other.name)
        return other

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
