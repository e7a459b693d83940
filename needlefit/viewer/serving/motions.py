"""What goes on by itself from frame to frame: a steady insertion, a scene's own steps, a replay."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

from needlefit.mechanics.plan import NEAR
from needlefit.viewer.hand.inputs import Change, changes_to
from needlefit.viewer.recording.log import Recorded
from needlefit.viewer.recording.replay import keep_for_returns, last_returns
from needlefit.viewer.serving.trial import Trial

LONGEST = 0.1
"""Time that one frame may carry the needle on, s: after a pause it does not leap."""


PAUSE = 0.4
"""Time between two steps of a recording, s, from which on they are undone one by one."""


class Motion(Protocol):
    """Goes on by `dt` seconds; returns whether there is more to come."""

    speed: float

    def advance(self, trial: Trial, dt: float) -> bool: ...


@dataclass
class Stroke:
    """The tip goes in (out, where `speed` is negative) until it is halted, or at `to`.

    Attributes
    ----------
    speed : float
        mm/s.
    gesture : int
    to : float or None
        Depth, mm.
    """

    speed: float
    gesture: int
    to: float | None = None

    def advance(self, trial: Trial, dt: float) -> bool:
        """Go on; `Motion`."""
        now, reach = trial.steering.now.step.depth, trial.steering.reach()
        low, high = (0.0, reach) if self.to is None else sorted((now, min(max(self.to, 0.0), reach)))
        depth = min(max(now + self.speed * dt, low), high)
        if abs(depth - now) > NEAR:
            trial.act((Change("depth_mm", None, depth),), self.gesture)
        return abs((high if self.speed > 0 else low) - depth) > NEAR


class Play:
    """The steps of the scene, at a speed, from first contact on."""

    def __init__(self, trial: Trial, speed: float, gesture: int) -> None:
        self.speed, self._gesture = abs(speed), gesture
        self._steps = iter(trial.steering.scene.steps)
        self._stroke: Stroke | None = None

    def advance(self, trial: Trial, dt: float) -> bool:
        """Go on; `Motion`."""
        if self._stroke is None:
            step = next(self._steps, None)
            if step is None:
                return False
            if changes := changes_to(step, trial.steering.now.step, trial.steering.names):
                trial.act(changes, self._gesture)
            way = step.depth - trial.steering.now.step.depth
            self._stroke = Stroke(self.speed if way >= 0 else -self.speed, self._gesture, step.depth)
        elif not self._stroke.advance(trial, dt):
            self._stroke = None
        return True


class Replay:
    """The steps of a recording, at its own times; steps without a pause between them are one gesture."""

    def __init__(self, steps: Sequence[Recorded], times: float) -> None:
        self.speed = abs(times)
        self._steps: Iterator[Recorded] = iter(steps)
        self._next = next(self._steps, None)
        self._clock = self._next.time if self._next else 0.0
        self._last, self._gesture = last_returns(steps), -1  # a page's own gestures are above 0

    def advance(self, trial: Trial, dt: float) -> bool:
        """Go on; `Motion`."""
        self._clock += self.speed * dt
        while self._next and self._next.time <= self._clock:
            trial.act(self._next.changes, self._gesture)
            keep_for_returns(self._next, self._last, trial.pin, trial.unpin)
            before, self._next = self._next, next(self._steps, None)
            if self._next and self._next.time - before.time > PAUSE:
                self._gesture -= 1
        return self._next is not None
