"""An interactive insertion as the program holds it: its steps, which the page simulates and this records."""

import asyncio
from collections import deque
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

from needlefit.errors import ModelError
from needlefit.planning.recording import RecordedStep, Recording, RecordingWriter, replay
from needlefit.planning.steered_needle import SteeredNeedle, make_steered_scene
from needlefit.viewer.messages import encode_recorded, encode_scene, encode_tables
from needlefit.viewer.viewed_scene import ViewedScene

if TYPE_CHECKING:
    from needlefit.planning.steering import StartedInsertion


class InteractiveTrial:
    """An interactive insertion, from first contact on: recorded to `path` as the needle moves.

    A page simulates its needle and sends its steps; the needle here follows them once somebody asks for it.
    `name` is part of the recording's name.
    """

    def __init__(self, name: str, viewed_scene: ViewedScene, path: Path) -> None:
        self.name, self.viewed_scene = name, viewed_scene
        self.scene = make_steered_scene(viewed_scene.record, viewed_scene.name)
        self.steps: list[RecordedStep] = []
        self.recorder = RecordingWriter(path, viewed_scene.make_head())
        self._steering = self._begin()
        self._began: float | None = None
        self._write_failed = False
        #: held while a message is carried out: some run in a thread
        self.lock = asyncio.Lock()

    def _begin(self) -> SteeredNeedle:
        return SteeredNeedle(self.scene, self.viewed_scene.first_cell)

    def describe_scene(self) -> dict[str, Any]:
        """Return the message of all that stays constant, and of the steps so far."""
        return encode_scene(self.viewed_scene, self._steering) | {
            "needle": self.name,
            "recording": self.recorder.path.name,
            "time_s": self.time() if self.steps else 0.0,
            "past": [encode_recorded(step) for step in self.steps],
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
            self._steering.apply(step.changes)
        return self._steering

    @property
    def insertion(self) -> "StartedInsertion":
        """The insertion of its needle up to where it stands, with the draws of its parameters."""
        from needlefit.viewer.plans import continue_insertion  # late: it takes longer than the page

        return continue_insertion(self.steering, self.viewed_scene.spread)

    def time(self) -> float:
        """Return the time since the first step, s."""
        if self._began is None:
            self._began = monotonic()
        return monotonic() - self._began

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
