"""Answer the messages of one window: carry out inputs, and advance motions frame by frame."""

import math
from collections import deque
from collections.abc import Generator, Iterable, Iterator, Sequence
from time import monotonic
from typing import Any, Literal, get_args

from needlefit.errors import ModelError, NeedlefitError
from needlefit.mechanics.control import Step
from needlefit.mechanics.plan import SAME_DEPTH_MM
from needlefit.viewer.live_fit import KNOTS, FitScope
from needlefit.viewer.messages import MAX_REPLAY_SPEED, MAX_SPEED_MM_S, Message
from needlefit.viewer.plans import MAX_ENTRY_MM, find_placement, read_goal
from needlefit.viewer.recording import (
    RecordedStep,
    Recording,
    find_last_returns,
    keep_for_returns,
    read_recording,
)
from needlefit.viewer.steering import Change, find_changes
from needlefit.viewer.trials import InteractiveTrial, TrialRegistry

MAX_FRAME_S = 0.1  #: longest motion in one frame, s: after a pause the needle does not jump
UNDO_PAUSE_S = 0.4  #: steps of a recording that are farther apart than this, s, are undone one by one
MAX_OFFSET_MM = 50.0  #: a measured point is moved by at most so much, mm
#: messages that leave a moving needle as it is
_MOVING_NOTHING = ("frame", "hello", "aim", "markups", "fit", "points", "release_tracker", "forget_estimate")

#: moves a needle on in every frame, which sends the time since the frame before, s; ends with the motion
Frames = Generator[None, float, None]

Reply = dict[str, Any]


class Motion:
    """What moves a needle by itself: a stroke, the steps of a scene or a plan, or a recording.

    Attributes
    ----------
    speed : float
        mm/s, of a recording a multiple of its own.
    """

    def __init__(self, kind: Literal["stroke", "play", "replay"], speed: float, gesture: int) -> None:
        self.kind, self.speed, self.gesture = kind, speed, gesture
        self._frames: Frames | None = None

    def begin(self, frames: Frames) -> "Motion":
        """Take what moves the needle; the first frame begins it."""
        self._frames = frames
        next(frames)
        return self

    def advance(self, dt: float) -> bool:
        """Continue the motion by `dt` seconds; return whether it goes on."""
        assert self._frames is not None
        try:
            self._frames.send(dt)
        except StopIteration:
            return False
        return True


def _stroke(trial: InteractiveTrial, speed: float, gesture: int, to: float | None = None) -> Frames:
    """Move the tip: in (out, if `speed` is negative) until it is stopped, or reaches the depth `to`, mm."""
    left = math.inf
    while left > SAME_DEPTH_MM:
        dt = yield
        now, reach = trial.steering.now.step.depth, trial.steering.reach()
        low, high = (0.0, reach) if to is None else sorted((now, min(max(to, 0.0), reach)))
        depth = min(max(now + speed * dt, low), high)
        left = abs((high if speed > 0 else low) - depth)
        if abs(depth - now) > SAME_DEPTH_MM:
            trial.act((Change("depth_mm", None, depth),), gesture)


def _play(trial: InteractiveTrial, steps: Iterable[Step], speed: float, gesture: int) -> Frames:
    """Move through steps, at constant speed: those of the scene from first contact on, or of a plan."""
    for step in steps:
        yield
        if changes := find_changes(step, trial.steering.now.step, trial.steering.names):
            trial.act(changes, gesture)
        distance = step.depth - trial.steering.now.step.depth
        yield from _stroke(trial, speed if distance >= 0 else -speed, gesture, step.depth)
    yield


def _replay(trial: InteractiveTrial, steps: Sequence[RecordedStep], motion: Motion) -> Frames:
    """Move through a recording's steps at their own times; steps without pause are one gesture."""
    clock, last, left = steps[0].time, find_last_returns(steps), deque(steps)
    gesture = -1  # a page's own gestures are above 0
    while left:
        dt = yield
        clock += motion.speed * dt  # the speed may have been changed meanwhile
        while left and left[0].time <= clock:
            step = left.popleft()
            trial.act(step.changes, gesture)
            keep_for_returns(step, last, trial.pin, trial.unpin)
            if left and left[0].time - step.time > UNDO_PAUSE_S:
                gesture -= 1


class Window:
    """One authenticated page, and the needle that it controls.

    Motions advance only when the page requests its next frame, by the time since
    the frame before. A page that is hidden or gone therefore stops its needle.
    """

    def __init__(self, trials: TrialRegistry, trial: InteractiveTrial) -> None:
        self.trials, self.trial = trials, trial
        self.last_message_id = 0
        self._motion: Motion | None = None
        self._paused: Motion | None = None
        self._at = 0.0

    def answer(self, message: Message) -> Iterator[Reply]:
        """Carry out a message; yield the replies."""
        self.last_message_id = message.id
        trial = self.trial
        try:
            self._do(message)
        except (NeedlefitError, OSError) as error:
            self._motion = None
            refused = error if isinstance(error, NeedlefitError) else _write_error(error, trial)
            content = {"what": refused.what, "expected": refused.expected, "fix": refused.fix}
            yield {"kind": "refused", "answers": self.last_message_id, **content}
        if self.trial is not trial or message.do == "hello":
            yield self.trial.describe_scene() | {"tracked": self.trials.shared}
        yield self.state()

    @property
    def moves(self) -> bool:
        """Whether the needle goes on by itself."""
        return self._motion is not None

    @property
    def _stroke_gesture(self) -> int | None:
        """The gesture of the stroke that goes on; None where none does."""
        return self._motion.gesture if self._motion and self._motion.kind == "stroke" else None

    def state(self) -> Reply:
        """Return the needle as it stands."""
        strokes = self._stroke_gesture is not None
        return self.trial.describe_state() | {
            "answers": self.last_message_id,
            "moving": self._motion.speed if self._motion and strokes else 0,
            "playing": self.moves and not strokes,
            "paused": self._paused is not None,
        }

    def _do(self, message: Message) -> None:
        if message.fault:
            raise message.fault
        if message.do not in _MOVING_NOTHING and not self._joins_stroke(message):
            self._take_over(message)
        trial = self.trial
        match message.do:
            case "change":
                self._change(message)
            case "frame":
                self._frame()
            case "move":
                self._move(message)
            case "play":
                if trial.steering.number:
                    trial.reset()
                self._start_play(trial.steering.scene.steps, message)
            case "replay":
                self._start_replay(message)
            case "show":
                self.trial = self.trials.another(trial, message.text("insertion"))
            case "aim":
                trial.aim.set(*read_goal(message))
            case "markups":
                trial.aim.read_markups(message, find_placement(trial.viewed_scene))
            case "challenge":
                trial.reset()
                trial.aim.set(None, read_goal(message)[1], ())
                trial.aim.challenged = True
            case "align":
                self._align()
            case "fit":
                trial.fit.wanted = _read_scope(trial, message)
            case "points":
                trial.fit.offsets, trial.fit.wanted = _read_offsets(message), _read_scope(trial, message)
            case "plan":
                self._want_plan(message)
            case "run":
                if trial.aim.plan is not None and trial.aim.entry_mm:
                    self.trial = self.trials.entered(trial)
                self._start_play(self._next_steps(message), message)
            case "undo":
                trial.undo()
            case "redo":
                trial.redo()
            case "reset":
                trial.reset()

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
        if message.do == "halt" and self._motion and self._motion.kind == "replay":
            self._paused = self._motion
        elif message.do not in ("halt", "replay"):
            self._paused = None
        self._motion = None

    def _joins_stroke(self, message: Message) -> bool:
        """Whether a message steers a needle that is being inserted, and does not insert it itself."""
        inserts = "insert_mm" in message.content or any(c.name == "depth_mm" for c in message.changes)
        return message.do == "change" and self._stroke_gesture is not None and not inserts

    def _change(self, message: Message) -> None:
        if any(change.name == "return_to" for change in message.changes):
            raise ModelError("`return_to` is written by the program", expected="undo, redo or reset")
        changes = message.changes
        if "insert_mm" in message.content:
            now, reach = self.trial.steering.now.step.depth, self.trial.steering.reach()
            depth = min(max(now + message.number("insert_mm"), 0.0), max(reach, now))
            changes = (*changes, Change("depth_mm", None, depth))
        if changes:  # what is done during a stroke is undone with it
            stroke = self._stroke_gesture
            self.trial.act(changes, message.gesture if stroke is None else stroke)

    def _move(self, message: Message) -> None:
        to = None if message.content.get("to_mm") is None else message.number("to_mm")
        speed = message.number("speed_mm_s", most=MAX_SPEED_MM_S)
        if to is not None:
            speed = abs(speed) if to >= self.trial.steering.now.step.depth else -abs(speed)
        gesture = message.gesture or message.id
        self._start(Motion("stroke", speed, gesture).begin(_stroke(self.trial, speed, gesture, to)))

    def _start_play(self, steps: Iterable[Step], message: Message) -> None:
        speed = abs(message.number("speed_mm_s", 10.0, MAX_SPEED_MM_S))
        frames = _play(self.trial, steps, speed, message.id)
        self._start(Motion("play", speed, message.id).begin(frames))

    def _start_replay(self, message: Message) -> None:
        times = abs(message.number("times", 1.0, MAX_REPLAY_SPEED))
        if self._paused is None:
            source = _choose_replay(self.trial)
            self.trial = self.trials.again(self.trial, source)
            motion = Motion("replay", times, -1)
            motion.begin(_replay(self.trial, source.steps, motion))
        else:
            motion, self._paused = self._paused, None
            motion.speed = times
        self._start(motion)

    def _start(self, motion: Motion) -> None:
        self._motion, self._at = motion, monotonic()

    def _frame(self) -> None:
        now = monotonic()
        dt, self._at = min(now - self._at, MAX_FRAME_S), now
        if self._motion and not self._motion.advance(dt):
            self._motion = None


def _read_scope(trial: InteractiveTrial, message: Message) -> FitScope:
    """Return what a page wants to fit to; ModelError if nothing is measured, or there is no such choice."""
    scopes: dict[str, FitScope] = {scope: scope for scope in get_args(FitScope)}
    scope = message.text("scope")
    if trial.viewed_scene.shown is None or scope not in scopes:
        raise ModelError(
            f"there is nothing measured to fit to (`{scope:.20}`)",
            expected=f"a measured insertion, and one of {', '.join(scopes)}",
        )
    return scopes[scope]


def _read_offsets(message: Message) -> list[float]:
    """Return by how much measured points are moved, mm; ModelError if these are not so many numbers."""
    rows = message.content.get("offsets")
    if not isinstance(rows, list) or len(rows) != KNOTS:
        raise ModelError("these are no offsets of points", expected=f"{KNOTS} numbers, mm")
    one_by_one = (Message("points", content={"offset": offset}) for offset in rows)
    return [one.number("offset", None, MAX_OFFSET_MM, "mm") for one in one_by_one]


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
