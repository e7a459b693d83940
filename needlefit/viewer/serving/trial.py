"""One needle in one window: steered, recorded, undone."""

from collections.abc import Sequence
from pathlib import Path
from time import monotonic

from needlefit.errors import ModelError
from needlefit.mechanics.scene import Scene
from needlefit.viewer.hand.inputs import Change
from needlefit.viewer.hand.steering import Steering
from needlefit.viewer.recording.log import Recorded, Recorder, Recording, head_of
from needlefit.viewer.subject import Subject

MOST_UNDONE = 200
"""Gestures that can be undone."""


class Trial:
    """An interactive insertion, from first contact on.

    Parameters
    ----------
    name : str
        Which one it is; part of the recording's name.
    subject : Subject
        What is shown and steered.
    path : Path
        Of the recording, written as the needle moves.
    source : Recording, optional
        One to carry out again.

    Attributes
    ----------
    speed : float
        Steps a second that its needle can make here.
    kin : dict of str -> Trial
        The last needle of the same window beside each insertion that it has shown, this one among them.
    """

    def __init__(self, name: str, subject: Subject, path: Path, source: Recording | None = None) -> None:
        self.name, self.subject, self.source = name, subject, source
        self.scene = Scene.from_record(subject.record, subject.name)
        self.steering = Steering(self.scene, subject.first_cell)
        scene = subject.record.model_dump(mode="json", by_alias=True)
        head = head_of(subject.name, subject.first_cell, scene, subject.placement)
        self.recorder = Recorder(path, head)
        self.speed = self.steering.speed()
        self._began: float | None = None
        self._lost = False
        self._past: list[int] = []
        self._future: list[int] = []
        self._gesture: int | None = None
        self._pinned: set[int] = set()
        self.kin = {self.beside: self}

    @property
    def beside(self) -> str:
        """The insertion that lies beside the needle; empty where there is none."""
        return self.subject.measured.id if self.subject.measured else ""

    @property
    def can_undo(self) -> bool:
        """Whether there is a gesture to undo."""
        return bool(self._past)

    @property
    def can_redo(self) -> bool:
        """Whether there is one to carry out again."""
        return bool(self._future)

    def time(self) -> float:
        """Return the time since the first step, s."""
        if self._began is None:
            self._began = monotonic()
        return monotonic() - self._began

    def act(self, changes: Sequence[Change], gesture: int | None = None) -> None:
        """Carry out and record one step; steps of the same gesture are undone together.

        Raises
        ------
        ModelError
            If the model does not take it; then nothing has happened.
        OSError
            If it cannot be recorded.
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
            left = [*self._future, *self._past[: 1 - MOST_UNDONE]]
            self._past, self._future = [*self._past[1 - MOST_UNDONE :], number], []
            self._forget(left)

    def undo(self) -> None:
        """Take the last gesture back."""
        self._go(self._past, self._future)

    def redo(self) -> None:
        """Carry out again what was taken back last."""
        self._go(self._future, self._past)

    def reset(self) -> None:
        """Return to first contact; that, too, can be undone."""
        self.act((Change("return_to", None, 0.0),))

    def pin(self) -> None:
        """Keep the needle as it stands, for a replay that returns to it."""
        self._pinned.add(self.steering.number)
        self.steering.keep()

    def unpin(self, number: int) -> None:
        """Let go of what was pinned at a step."""
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
        if self._lost:  # what came after a gap could not be replayed
            raise ModelError(
                f"the recording {self.recorder.path} has ended: it could not be written",
                expected="room on the disk, and a folder that may be written to",
                mend="make room, then open the page in a new window",
            )
        time = self.time()
        moment = self.steering.apply(changes)
        recorded = Recorded(self.steering.number, time, tuple(changes), float(moment.shape.u[-1]))
        self._lost = True
        self.recorder.write(recorded)
        self._lost = False
