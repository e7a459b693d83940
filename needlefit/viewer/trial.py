"""An interactive insertion as the program holds it: its steps, which the page simulates and this records."""

import asyncio
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from time import monotonic
from typing import Any

from needlefit.errors import ModelError
from needlefit.mechanics.control import Step
from needlefit.mechanics.plan import SAME_DEPTH_MM
from needlefit.mechanics.scene import Scene
from needlefit.planning.steering import StartedInsertion
from needlefit.viewer.messages import encode_recorded, encode_scene, encode_tables
from needlefit.viewer.plans import TrialAim, continue_insertion
from needlefit.viewer.recording import RecordedStep, Recording, RecordingWriter, replay
from needlefit.viewer.steering import Change, SteeredNeedle
from needlefit.viewer.viewed_scene import ViewedScene

MAX_KEPT = 400  #: states to which an undo may return that are kept; others are simulated again


class InteractiveTrial:
    """An interactive insertion, from first contact on: recorded to `path` as the needle moves.

    A page simulates its needle and sends its steps; the needle here follows them once somebody asks for it.
    `name` is part of the recording's name.
    """

    def __init__(self, name: str, viewed_scene: ViewedScene, path: Path) -> None:
        self.name, self.viewed_scene = name, viewed_scene
        self.scene = Scene.from_record(viewed_scene.record, viewed_scene.name)
        self.steps: list[RecordedStep] = []
        self.recorder = RecordingWriter(path, viewed_scene.make_head())
        self.aim = TrialAim()
        self._steering = self._begin()
        self._gesture: int | str | None = None  # of the step before, and the steps whose states are kept
        self._kept = deque[int]()
        self._began: float | None = None
        self._write_failed = False
        #: the last needle of the same window beside each insertion that it has shown, this one among them
        self.window_trials = {self.shown_insertion: self}
        #: held while a message is carried out: some run in a thread
        self.lock = asyncio.Lock()

    def _begin(self) -> SteeredNeedle:
        return SteeredNeedle(self.scene, self.viewed_scene.first_cell)

    @property
    def shown_insertion(self) -> str:
        """The id of the measured insertion shown with the needle; empty if there is none."""
        return self.viewed_scene.measured.id if self.viewed_scene.measured else ""

    def describe_scene(self, known: int = 0) -> dict[str, Any]:
        """Return the message of all that stays constant, and of the steps after those that are known."""
        return encode_scene(self.viewed_scene, self._steering) | {
            "needle": self.name,
            "recording": self.recorder.path.name,
            "time_s": self.time() if self.steps else 0.0,
            "known": known,
            "past": [encode_recorded(step) for step in self.steps[known:]],
            "tables": encode_tables(self.scene.tissue, self.steps),
        }

    @property
    def steering(self) -> SteeredNeedle:
        """The needle after all steps; DataError if one cannot be carried out: it is none of a page."""
        for step in self.steps[self._steering.number :]:
            returns = step.changes[0].name == "return_to"
            if returns and not self._steering.has_kept(int(step.changes[0].value)):
                self._steering = self._begin()  # from the first step on, with those kept that are needed
                recording = Recording(self.recorder.head, tuple(self.steps), str(self.recorder.path))
                deque(replay(recording, self._steering), maxlen=0)
                break
            self._keep_before(step.gesture)
            self._steering.apply(step.changes)
        return self._steering

    def _keep_before(self, gesture: int | str | None) -> None:
        """Keep the state at which a gesture begins: an undo may return to it."""
        if gesture is None or isinstance(gesture, str) or gesture != self._gesture:
            self._steering.keep()
            self._kept.append(self._steering.number)
            if len(self._kept) > MAX_KEPT:
                self._steering.forget(self._kept.popleft())
        self._gesture = gesture

    @property
    def insertion(self) -> StartedInsertion:
        """The insertion of its needle up to where it stands, with the draws of its parameters."""
        return continue_insertion(self.steering, self.viewed_scene.spread)

    @property
    def planned_insertion(self) -> StartedInsertion:
        """The insertion that a plan continues: from first contact where it may shift the entry."""
        steering, there = self.steering, self.insertion
        if not self.aim.entry_mm or steering.now.step.depth <= SAME_DEPTH_MM:
            return there
        first = steering.scene.steps[0]  # its inputs hold there, with the present parameters
        bevel = replace(steering.now.step.bevel, side=first.bevel.side)
        return replace(there, path=(Step(0.0, bevel, first.controls),))

    def time(self) -> float:
        """Return the time since the first step, s."""
        if self._began is None:
            self._began = monotonic()
        return monotonic() - self._began

    def act(self, changes: Sequence[Change], gesture: int | str | None = None) -> None:
        """Carry out and record one step; steps of the same gesture are undone together.

        ModelError if the model does not take it; then nothing has happened. OSError if it cannot be recorded.
        """
        self._require_recorder()
        steering, time = self.steering, self.time()
        self._keep_before(gesture)
        tip = steering.apply(changes, valid_only=True).shape.tip_lateral
        self.record(RecordedStep(steering.number, time, tuple(changes), tip, gesture=gesture))

    def record(self, step: RecordedStep) -> None:
        """Append a step; OSError if it cannot be written, StepOrderError if it does not follow the last."""
        self._require_recorder()
        if step.number != len(self.steps) + 1:
            raise StepOrderError(f"step {step.number} follows step {len(self.steps)}")
        if self._began is None:
            self._began = monotonic() - step.time
        # Set before the write and cleared after it: an error of any kind in between leaves it set.
        self._write_failed = True
        self.recorder.write(step)
        self._write_failed = False
        self.steps.append(step)

    def _require_recorder(self) -> None:
        if self._write_failed:  # what came after a gap could not be replayed
            raise RecordingEndedError(
                f"the recording {self.recorder.path} has ended: it could not be written",
                expected="room on the disk, and a folder that may be written to",
                fix="make room, then open the page in a new window",
            )


class StepOrderError(Exception):
    """A page and the program hold different needles: the page begins anew with the recorded steps."""


class RecordingEndedError(ModelError):
    """Nothing more can be recorded."""
