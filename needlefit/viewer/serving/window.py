"""Answer the messages of one window: carry out inputs, and advance motions frame by frame."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from time import monotonic
from typing import Any, Protocol

from needlefit.errors import ModelError, NeedlefitError
from needlefit.mechanics.control import Step
from needlefit.mechanics.plan import SAME_DEPTH_MM
from needlefit.viewer.interaction.inputs import Change, find_changes
from needlefit.viewer.recording import (
    RecordedStep,
    Recording,
    find_last_returns,
    keep_for_returns,
    read_recording,
)
from needlefit.viewer.serving.fits import read_offsets, want_fit
from needlefit.viewer.serving.messages import (
    MAX_REPLAY_SPEED,
    MAX_SPEED_MM_S,
    Message,
    scene_message,
    state_message,
)
from needlefit.viewer.serving.plans import MAX_ENTRY_MM, read_goal, read_markups
from needlefit.viewer.serving.trials import InteractiveTrial, TrialRegistry

MAX_FRAME_S = 0.1
"""Longest motion in one frame, s: after a pause the needle does not jump."""


UNDO_PAUSE_S = 0.4
"""Steps of a recording that are farther apart than this, s, are undone one by one."""


_MOVING_NOTHING = (
    *("frame", "hello", "aim", "markups", "fit", "points"),
    *("release_tracker", "forget_estimate"),
)
"""Messages that leave a moving needle as it is."""


class Motion(Protocol):
    """A motion of the needle: `advance` continues it by `dt` seconds and returns whether it goes on."""

    speed: float

    def advance(self, trial: InteractiveTrial, dt: float) -> bool: ...


@dataclass
class Stroke:
    """A motion of the tip: in (out, if `speed` is negative) until it is stopped, or reaches `to`.

    Attributes
    ----------
    speed : float
        mm/s.
    to : float or None
        Depth, mm.
    """

    speed: float
    gesture: int
    to: float | None = None

    def advance(self, trial: InteractiveTrial, dt: float) -> bool:
        """Continue the motion by `dt` seconds; see `Motion`."""
        now, reach = trial.steering.now.step.depth, trial.steering.reach()
        low, high = (0.0, reach) if self.to is None else sorted((now, min(max(self.to, 0.0), reach)))
        depth = min(max(now + self.speed * dt, low), high)
        if abs(depth - now) > SAME_DEPTH_MM:
            trial.act((Change("depth_mm", None, depth),), self.gesture)
        return abs((high if self.speed > 0 else low) - depth) > SAME_DEPTH_MM


class Play:
    """A motion through steps, at constant speed: those of the scene from first contact on, or of a plan."""

    def __init__(self, steps: Sequence[Step], speed: float, gesture: int) -> None:
        self.speed, self._gesture = abs(speed), gesture
        self._steps = iter(steps)
        self._stroke: Stroke | None = None

    def advance(self, trial: InteractiveTrial, dt: float) -> bool:
        """Continue the motion by `dt` seconds; see `Motion`."""
        if self._stroke is None:
            step = next(self._steps, None)
            if step is None:
                return False
            if changes := find_changes(step, trial.steering.now.step, trial.steering.names):
                trial.act(changes, self._gesture)
            distance = step.depth - trial.steering.now.step.depth
            self._stroke = Stroke(self.speed if distance >= 0 else -self.speed, self._gesture, step.depth)
        elif not self._stroke.advance(trial, dt):
            self._stroke = None
        return True


class Replay:
    """A motion through a recording's steps at their own times; steps without pause are one gesture."""

    def __init__(self, steps: Sequence[RecordedStep], times: float) -> None:
        self.speed = abs(times)
        self._steps: Iterator[RecordedStep] = iter(steps)
        self._next = next(self._steps, None)
        self._clock = self._next.time if self._next else 0.0
        self._last, self._gesture = find_last_returns(steps), -1  # a page's own gestures are above 0

    def advance(self, trial: InteractiveTrial, dt: float) -> bool:
        """Continue the motion by `dt` seconds; see `Motion`."""
        self._clock += self.speed * dt
        while self._next and self._next.time <= self._clock:
            trial.act(self._next.changes, self._gesture)
            keep_for_returns(self._next, self._last, trial.pin, trial.unpin)
            before, self._next = self._next, next(self._steps, None)
            if self._next and self._next.time - before.time > UNDO_PAUSE_S:
                self._gesture -= 1
        return self._next is not None


Reply = dict[str, Any]


class Window:
    """One authenticated page, and the needle that it controls.

    Motions advance only when the page requests its next frame, by the time since
    the frame before. A page that is hidden or gone therefore stops its needle.
    """

    def __init__(self, trials: TrialRegistry, trial: InteractiveTrial) -> None:
        self.trials, self.trial = trials, trial
        self.last_message_id = 0
        self._motion: Motion | None = None
        self._paused: Replay | None = None
        self._at = 0.0

    def answer(self, message: Message) -> Iterator[Reply]:
        """Carry out a message; yield the replies."""
        self.last_message_id = message.id
        trial = self.trial
        try:
            self._do(message)
        except NeedlefitError as error:
            self._motion = None
            yield self._refused(error)
        except OSError as error:
            self._motion = None
            yield self._refused(_write_error(error, trial))
        if self.trial is not trial or message.do == "hello":
            yield scene_message(self.trial) | {"tracked": self.trials.shared}
        yield self.state()

    @property
    def moves(self) -> bool:
        """Whether the needle goes on by itself."""
        return self._motion is not None

    def state(self) -> Reply:
        """Return the needle as it stands."""
        motion = self._motion
        return state_message(self.trial) | {
            "answers": self.last_message_id,
            "moving": motion.speed if isinstance(motion, Stroke) else 0,
            "playing": isinstance(motion, Play | Replay),
            "paused": self._paused is not None,
        }

    def _refused(self, error: NeedlefitError) -> Reply:
        """Return why something was not done."""
        content = {"what": error.what, "expected": error.expected, "fix": error.fix}
        return {"kind": "refused", "answers": self.last_message_id, **content}

    def _do(self, message: Message) -> None:
        if message.fault:
            raise message.fault
        if message.do not in _MOVING_NOTHING and not self._joins_stroke(message):
            self._take_over(message)
        match message.do:
            case "change":
                self._change(message)
            case "frame":
                self._frame()
            case "move":
                self._start(Stroke(*self._stroke(message)))
            case "play":
                if self.trial.steering.number:
                    self.trial.reset()
                self._start(Play(self.trial.steering.scene.steps, _read_speed(message), message.id))
            case "replay":
                self._replay(message)
            case "show":
                self.trial = self.trials.another(self.trial, message.text("insertion"))
            case "aim":
                self.trial.aim.set(*read_goal(message))
            case "markups":
                read_markups(self.trial, message)
            case "challenge":
                self.trial.reset()
                self.trial.aim.set(None, read_goal(message)[1], ())
                self.trial.aim.challenged = True
            case "align":
                self._align()
            case "fit":
                want_fit(self.trial, message)
            case "points":
                offsets = read_offsets(message)
                want_fit(self.trial, message)
                self.trial.fit.offsets = offsets
            case "plan":
                self._want_plan(message)
            case "run":
                if self.trial.aim.plan is not None and self.trial.aim.entry_mm:
                    self.trial = self.trials.entered(self.trial)
                self._start(Play(self._next_steps(message), _read_speed(message), message.id))
            case "undo":
                self.trial.undo()
            case "redo":
                self.trial.redo()
            case "reset":
                self.trial.reset()

    def _align(self) -> None:
        if self.trial.steering.now.step.depth <= SAME_DEPTH_MM:
            raise ModelError("the needle stands at the entry", expected="a needle in the tissue")
        if self.trial.steering.now.tissue is not self.trial.scene.tissue:
            raise ModelError(
                "moduli or shape parameters were changed",
                expected="the initial parameters",
                fix="set them back first",
            )
        self.trial = self.trials.aligned(self.trial)

    def _want_plan(self, message: Message) -> None:
        entry, aim = message.number("entry_mm", 0.0, MAX_ENTRY_MM, "mm"), self.trial.aim
        if aim.goal is None:
            raise ModelError("there is no target", expected="a target in the tissue", fix="place one")
        if entry < 0 or (entry and self.trials.shared):
            expected = "0 mm: a tracker moves the needle" if self.trials.shared else "0 mm or above"
            raise ModelError(f"the entry may shift by {entry:g} mm", expected=expected)
        aim.wanted, aim.entry_mm, aim.plan = True, entry, None

    def _next_steps(self, message: Message) -> tuple[Step, ...]:
        """Return the steps of the plan that lie ahead of the tip, or only the first of them."""
        plan, depth = self.trial.aim.plan, self.trial.steering.now.step.depth
        steps = tuple(step for step in plan.steps if step.depth > depth + SAME_DEPTH_MM) if plan else ()
        if not steps:
            raise ModelError(
                "there is no plan from where the needle stands", expected="a plan", fix="plan again"
            )
        return steps[:1] if message.content.get("one") is True else steps

    def _take_over(self, message: Message) -> None:
        """Stop what goes on by itself: a hand is on the needle. A replay that is only halted can go on."""
        if message.do == "halt" and isinstance(self._motion, Replay):
            self._paused = self._motion
        elif message.do not in ("halt", "replay"):
            self._paused = None
        self._motion = None

    def _joins_stroke(self, message: Message) -> bool:
        """Whether a message steers a needle that is being inserted, and does not insert it itself."""
        inserts = "insert_mm" in message.content or any(c.name == "depth_mm" for c in message.changes)
        return message.do == "change" and isinstance(self._motion, Stroke) and not inserts

    def _change(self, message: Message) -> None:
        if any(change.name == "return_to" for change in message.changes):
            raise ModelError("`return_to` is written by the program", expected="undo, redo or reset")
        changes = message.changes
        if "insert_mm" in message.content:
            now, reach = self.trial.steering.now.step.depth, self.trial.steering.reach()
            depth = min(max(now + message.number("insert_mm"), 0.0), max(reach, now))
            changes = (*changes, Change("depth_mm", None, depth))
        if changes:  # what is done during a stroke is undone with it
            gesture = self._motion.gesture if isinstance(self._motion, Stroke) else message.gesture
            self.trial.act(changes, gesture)

    def _stroke(self, message: Message) -> tuple[float, int, float | None]:
        to = None if message.content.get("to_mm") is None else message.number("to_mm")
        speed = message.number("speed_mm_s", most=MAX_SPEED_MM_S)
        if to is not None:
            speed = abs(speed) if to >= self.trial.steering.now.step.depth else -abs(speed)
        return speed, message.gesture or message.id, to

    def _replay(self, message: Message) -> None:
        times = message.number("times", 1.0, MAX_REPLAY_SPEED)
        if self._paused:
            self._start(self._paused)
            self._paused.speed, self._paused = times, None
            return
        source = _choose_replay(self.trial)
        self.trial = self.trials.again(self.trial, source)
        self._start(Replay(source.steps, times))

    def _start(self, motion: Motion) -> None:
        self._motion, self._at = motion, monotonic()

    def _frame(self) -> None:
        now = monotonic()
        dt, self._at = min(now - self._at, MAX_FRAME_S), now
        if self._motion and not self._motion.advance(self.trial, dt):
            self._motion = None


def _read_speed(message: Message) -> float:
    return message.number("speed_mm_s", 10.0, MAX_SPEED_MM_S)


def _choose_replay(trial: InteractiveTrial) -> Recording:
    """Return what a trial has recorded; while that is only a part of what it replays, the whole of that."""
    source, done = trial.source, trial.steering.number
    if done:
        own = read_recording(trial.recorder.path)
        acts = [step.changes for step in own.steps]
        if source is None or [step.changes for step in source.steps[:done]] != acts:
            source = own
    if source is None or not source.steps:
        raise ModelError("nothing has been recorded", expected="a needle that was moved")
    return source


def _write_error(error: OSError, trial: InteractiveTrial) -> ModelError:
    return ModelError(
        f"the recording {trial.recorder.path} cannot be written: {error.strerror}",
        expected="room on the disk, and a folder that may be written to",
        fix="it ends before this step; make room, then open the page in a new window",
    )
