"""Interactive trials: each window controls, records and undoes the steps of one needle."""

import asyncio
import secrets
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path, PurePath
from time import monotonic
from typing import Any

from needlefit.errors import ModelError
from needlefit.mechanics.plan import Lattice
from needlefit.mechanics.scene import Scene
from needlefit.planning.steering import StartedInsertion
from needlefit.viewer.live_fit import FitScope
from needlefit.viewer.messages import encode_scene, encode_state
from needlefit.viewer.opening import ShownInsertion, ViewedScene
from needlefit.viewer.plans import TrialAim, continue_insertion, list_changes, restart_insertion, shift_entry
from needlefit.viewer.recording import RecordedStep, Recording, RecordingWriter, make_head
from needlefit.viewer.steering import Change, SteeredNeedle, find_changes, find_tissue_changes

MAX_UNDO = 200  #: number of gestures that can be undone
#: number of trials that are kept. Beyond it, those whose windows closed first are dropped; their recordings
#: stay.
MAX_TRIALS = 32


@dataclass
class TrialFit:
    """A live fit of a trial's parameters."""

    #: the measured insertion before its points were moved; None where nothing is measured
    original: ShownInsertion | None
    wanted: FitScope | None = None  #: what is to be fitted to, until that has begun
    #: by how much the measured points are to be moved, until that has been done
    offsets: list[float] | None = None


class InteractiveTrial:
    """An interactive insertion, from first contact on.

    Parameters
    ----------
    name : str
        Which one it is; part of the recording's name.
    viewed_scene : ViewedScene
        The scene that is shown and controlled.
    path : Path
        Of the recording, written as the needle moves.
    source : Recording, optional
        One to carry out again.

    Attributes
    ----------
    speed : float
        Steps a second that its needle can make here.
    aim : TrialAim
        Its target and obstacles, and the plan to reach them.
    fit : TrialFit
        What its parameters are to be fitted to.
    window_trials : dict of str -> InteractiveTrial
        The last needle of the same window beside each insertion that it has shown, this one among them.
    lock : asyncio.Lock
        Held while a message is carried out: one that simulates the insertion again runs in a thread.
    """

    def __init__(
        self, name: str, viewed_scene: ViewedScene, path: Path, source: Recording | None = None
    ) -> None:
        self.name, self.viewed_scene, self.source = name, viewed_scene, source
        self.scene = Scene.from_record(viewed_scene.record, viewed_scene.name)
        self.steering = SteeredNeedle(self.scene, viewed_scene.first_cell, valid_only=True)
        record, placement = viewed_scene.record, viewed_scene.placement
        head = make_head(viewed_scene.name, viewed_scene.first_cell, record, placement)
        self.recorder = RecordingWriter(path, head)
        self.speed = self.steering.step_rate()
        self.aim, self.fit = TrialAim(), TrialFit(viewed_scene.shown)
        self._began: float | None = None
        self._write_failed = False
        self._past: list[int] = []
        self._future: list[int] = []
        self._gesture: int | None = None
        self._pinned: set[int] = set()
        self.window_trials = {self.shown_insertion: self}
        self.lock = asyncio.Lock()

    @property
    def shown_insertion(self) -> str:
        """The id of the measured insertion shown with the needle; empty if there is none."""
        return self.viewed_scene.measured.id if self.viewed_scene.measured else ""

    def describe_scene(self) -> dict[str, Any]:
        """Return the message of all that stays constant."""
        return encode_scene(self.viewed_scene, self.steering) | {
            "needle": self.name,
            "recording": self.recorder.path.name,
            "recorded": len(self.source.steps) if self.source else 0,
        }

    def describe_state(self) -> dict[str, Any]:
        """Return the message of all that changes from step to step."""
        steering = self.steering
        return encode_state(self.viewed_scene, steering) | {
            "time_s": self.time() if steering.number else 0.0,
            "undo": bool(self._past),
            "redo": bool(self._future),
            "solver": {"steps": steering.solved, "rate_per_s": self.speed, "failed": steering.failed},
        }

    @property
    def insertion(self) -> StartedInsertion:
        """The insertion of its needle up to where it stands, with the draws of its parameters."""
        return continue_insertion(self.steering, self.viewed_scene.spread)

    @property
    def planned_insertion(self) -> StartedInsertion:
        """The insertion that a plan continues: from first contact where it may shift the entry."""
        begin = restart_insertion if self.aim.entry_mm else continue_insertion
        return begin(self.steering, self.viewed_scene.spread)

    def time(self) -> float:
        """Return the time since the first step, s."""
        if self._began is None:
            self._began = monotonic()
        return monotonic() - self._began

    def act(self, changes: Sequence[Change], gesture: int | None = None) -> None:
        """Carry out and record one step; steps of the same gesture are undone together.

        ModelError if the model does not take it; then nothing has happened. OSError if it cannot be recorded.
        """
        number = self.steering.number
        if begins := gesture is None or gesture != self._gesture:
            self.steering.keep()
        try:
            self._step(changes)
        except Exception:
            self._forget([number])
            raise
        if begins:
            self._gesture = gesture
            left = [*self._future, *self._past[: 1 - MAX_UNDO]]
            self._past, self._future = [*self._past[1 - MAX_UNDO :], number], []
            self._forget(left)

    def undo(self) -> None:
        """Undo the last gesture."""
        self._go(self._past, self._future)

    def redo(self) -> None:
        """Redo the gesture that was undone last."""
        self._go(self._future, self._past)

    def reset(self) -> None:
        """Return to first contact with the present parameters of the model; this can be undone.

        A band and a planner with draws of a fit keep them, and so must the needle.
        """
        before = self.steering.now
        self.act((Change("return_to", None, 0.0),))
        now = self.steering.now
        bevel = replace(before.step.bevel, side=now.step.bevel.side)
        changes = find_changes(replace(now.step, bevel=bevel), now.step, self.steering.names)
        changes = (*find_tissue_changes(before.tissue, now.tissue), *changes)
        if changes:
            self._step(changes)

    def pin(self) -> None:
        """Store the present state, for a replay that returns to it."""
        self._pinned.add(self.steering.number)
        self.steering.keep()

    def unpin(self, number: int) -> None:
        """Delete the state that was stored at a step."""
        self._pinned.discard(number)
        self._forget([number])

    def _go(self, back: list[int], forth: list[int]) -> None:
        if not back:
            return
        number = self.steering.number
        self.steering.keep()
        self._step((Change("return_to", None, float(back[-1])),))
        forth.append(number)
        self._forget([back.pop()])
        self._gesture = None

    def _forget(self, numbers: Sequence[int]) -> None:
        for number in set(numbers) - {*self._past, *self._future, *self._pinned}:
            self.steering.forget(number)

    def _step(self, changes: Sequence[Change]) -> None:
        if self._write_failed:  # what came after a gap could not be replayed
            raise ModelError(
                f"the recording {self.recorder.path} has ended: it could not be written",
                expected="room on the disk, and a folder that may be written to",
                fix="make room, then open the page in a new window",
            )
        time = self.time()
        moment = self.steering.apply(changes)
        recorded = RecordedStep(self.steering.number, time, tuple(changes), moment.shape.tip_lateral)
        # Set before the write and cleared after it: an error of any kind in between leaves it set.
        self._write_failed = True
        self.recorder.write(recorded)
        self._write_failed = False


class TrialRegistry:
    """All trials of the server; a page that reconnects gets its own trial again.

    Parameters
    ----------
    viewed_scene : ViewedScene
        What a new window shows.
    folder : Path
        Where recordings are written.
    reopen : callable
        Name of an insertion -> the scene that shows it.
    source : Recording, optional
        What a new window can replay.
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
        self._shared: InteractiveTrial | None = None

    def share(self) -> InteractiveTrial:
        """Return the one trial of all windows, for a tracker that moves it; from the first call on."""
        if self._shared is None:
            self._shared = self._begin(self._viewed_scene, self._source)
        return self._shared

    @property
    def shared(self) -> bool:
        """Whether all windows have one trial, which a tracker moves."""
        return self._shared is not None

    def open(self, name: str) -> InteractiveTrial:
        """Return the trial of this name, or a new one if there is none."""
        trial = self._shared or self._all.get(name) or self._begin(self._viewed_scene, self._source)
        self._steered.add(trial.name)
        return trial

    def known(self, name: str) -> InteractiveTrial | None:
        """Return the trial of this name, if there is one."""
        return self._all.get(name)

    def close(self, trial: InteractiveTrial) -> None:
        """Note that no window controls a trial any more; it is kept until there are too many others."""
        self._steered.discard(trial.name)
        if trial.name in self._all:  # becomes the newest of those without a window
            self._all[trial.name] = self._all.pop(trial.name)

    def prepare(self, trial: InteractiveTrial, insertion: str) -> None:
        """Read the files for showing another insertion, before `another` is called; can run in a thread."""
        if insertion in trial.viewed_scene.choices and insertion not in self._viewed_scenes:
            self._viewed_scenes[insertion] = self._reopen(insertion)

    def another(self, trial: InteractiveTrial, insertion: str) -> InteractiveTrial:
        """Return the window's trial with another insertion, or a new trial.

        ModelError if the dataset has no such insertion.
        """
        if insertion not in trial.viewed_scene.choices:
            raise ModelError(f"there is no insertion `{insertion:.40}`", expected="one of the list")
        self.prepare(trial, insertion)
        there = trial.window_trials.get(insertion)
        return self._instead(trial, there or self._begin(self._viewed_scenes[insertion], None))

    def aligned(self, trial: InteractiveTrial) -> InteractiveTrial:
        """Return a new trial whose constraint points end where the needle stands, taken there by its inputs.

        So `simulate` places them: the last cell is a whole one. ModelError if a step has no needle then.
        """
        depth, spacing = trial.steering.now.step.depth, trial.scene.rules.spacing
        first_cell = Lattice.ending_at(depth, spacing).first_cell
        other = self._begin(replace(trial.viewed_scene, first_cell=first_cell), None)
        for changes in list_changes(other.steering, trial.steering.input_path(), depth):
            other.act(changes, gesture=0)
        other.aim.take(trial.aim)
        return self._instead(trial, other)

    def entered(self, trial: InteractiveTrial) -> InteractiveTrial:
        """Return a new trial at first contact, at the entry of a trial's plan, with its parameters and plan.

        ModelError if the trial has no plan.
        """
        plan = trial.aim.plan
        if plan is None:
            raise ModelError("there is no plan", expected="a plan", fix="plan again")
        other = self._begin(shift_entry(trial.viewed_scene, plan.entry_mm), None)
        changes = find_tissue_changes(trial.steering.now.tissue, other.scene.tissue)
        if changes:
            other.act(changes, gesture=0)
        moved, aim = plan.move_to_entry(), other.aim
        aim.set(moved.goal.target, moved.goal.radius, moved.goal.obstacles, trial.aim.roll_deg)
        aim.plan, aim.plan_step = moved, other.steering.number
        return self._instead(trial, other)

    def again(self, trial: InteractiveTrial, source: Recording) -> InteractiveTrial:
        """Return a new trial for the same window, at first contact, for a replay."""
        other = self._begin(trial.viewed_scene, source)
        other.aim.take(trial.aim)
        return self._instead(trial, other)

    def written(self) -> list[Path]:
        """Return the recordings that have been started."""
        return [path for path in self._paths if path.exists()]

    def _instead(self, trial: InteractiveTrial, other: InteractiveTrial) -> InteractiveTrial:
        """Give a window another needle; the caller closes the first one."""
        other.window_trials = trial.window_trials
        other.window_trials[other.shown_insertion] = other
        self._all[other.name] = other
        self._steered.add(other.name)
        if trial is self._shared:
            self._shared = other
        return other

    def _begin(self, viewed_scene: ViewedScene, source: Recording | None) -> InteractiveTrial:
        name = secrets.token_hex(4)
        path = self._folder / f"{_file_stem(viewed_scene.name)}-{datetime.now():%Y%m%d-%H%M%S}-{name}.csv"
        self._all[name] = InteractiveTrial(name, viewed_scene, path, source)
        self._paths.append(path)
        for old in [one for one in self._all if one not in self._steered and one != name]:
            if len(self._all) <= MAX_TRIALS:
                break
            if self._all[old] is not self._shared:
                del self._all[old]
        return self._all[name]


def _file_stem(viewed_scene: str) -> str:
    """Return a subject's name as that of a file: of a path the last two parts."""
    last = "-".join(PurePath(viewed_scene.removesuffix(".toml")).parts[-2:])
    return "".join(c if c.isalnum() or c in "-_" else "-" for c in last).strip("-") or "needle"
