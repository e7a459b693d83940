"""Interactive trials: each window controls, records and undoes the steps of one needle.

A window's messages are answered here: inputs are carried out, and motions advance frame by frame.
"""

import asyncio
import math
import secrets
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path, PurePath
from time import monotonic
from typing import Any, Literal, get_args

from needlefit.errors import ModelError, NeedlefitError
from needlefit.mechanics.control import Step
from needlefit.mechanics.plan import SAME_DEPTH_MM, Lattice
from needlefit.mechanics.scene import Scene
from needlefit.planning.steering import StartedInsertion
from needlefit.viewer.live_fit import KNOTS, FitScope
from needlefit.viewer.messages import (
    MAX_REPLAY_SPEED,
    MAX_SPEED_MM_S,
    Message,
    encode_fault,
    encode_scene,
    encode_state,
)
from needlefit.viewer.opening import NEEDLES, ViewedScene, replace_needle
from needlefit.viewer.plans import (
    MAX_ENTRY_MM,
    TrialAim,
    continue_insertion,
    find_placement,
    list_changes,
    read_goal,
    shift_entry,
)
from needlefit.viewer.recording import (
    RecordedStep,
    Recording,
    RecordingWriter,
    find_last_returns,
    keep_for_returns,
    read_recording,
)
from needlefit.viewer.steering import Change, SteeredNeedle, find_changes, find_tissue_changes

MAX_UNDO = 200  #: number of gestures that can be undone
#: number of trials that are kept. Beyond it, those whose windows closed first are dropped; their recordings
#: stay.
MAX_TRIALS = 32
MAX_FRAME_S = 0.1  #: longest motion in one frame, s: after a pause the needle does not jump
UNDO_PAUSE_S = 0.4  #: steps of a recording that are farther apart than this, s, are undone one by one
MAX_OFFSET_MM = 50.0  #: a measured point is moved by at most so much, mm
#: messages that leave a moving needle as it is
_MOVING_NOTHING = ("frame", "hello", "aim", "markups", "fit", "points", "release_tracker", "forget_estimate")

#: moves a needle on in every frame, which sends the time since the frame before, s; ends with the motion
Frames = Generator[None, float, None]

Reply = dict[str, Any]


class InteractiveTrial:
    """An interactive insertion, from first contact on: recorded to `path` as the needle moves.

    `name` is part of the recording's name; `source` is a recording that can be carried out again.
    """

    def __init__(
        self, name: str, viewed_scene: ViewedScene, path: Path, source: Recording | None = None
    ) -> None:
        self.name, self.viewed_scene, self.source = name, viewed_scene, source
        self.scene = Scene.from_record(viewed_scene.record, viewed_scene.name)
        self.steering = SteeredNeedle(self.scene, viewed_scene.first_cell, valid_only=True)
        self.recorder = RecordingWriter(path, viewed_scene.make_head())
        self.speed = self.steering.step_rate()  #: steps a second that its needle can make here
        self.aim = TrialAim()
        self.wanted_fit: FitScope | None = None  #: what is to be fitted to, until that has begun
        #: the measured insertion before its points were moved, and by how much they are to be, until they are
        self.measured, self.wanted_offsets = viewed_scene.shown, list[float]()
        self._began: float | None = None
        self._write_failed = False
        self._past: list[int] = []
        self._future: list[int] = []
        self._gesture: int | None = None
        self._pinned: set[int] = set()
        #: the last needle of the same window beside each insertion that it has shown, this one among them
        self.window_trials = {self.shown_insertion: self}
        #: held while a message is carried out: one that simulates the insertion again runs in a thread
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

    def undo(self, *, redo: bool = False) -> None:
        """Undo the last gesture, or redo the one that was undone last."""
        back, forth = (self._future, self._past) if redo else (self._past, self._future)
        if not back:
            return
        number = self.steering.number
        self.steering.keep()
        self._step((Change("return_to", None, float(back[-1])),))
        forth.append(number)
        self._forget([back.pop()])
        self._gesture = None

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

    A new window shows `viewed_scene` and can replay `source`; recordings are written to `folder`; `reopen`
    returns the scene that shows the insertion of a name.
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

    def with_needle(self, trial: InteractiveTrial, name: str) -> InteractiveTrial:
        """Return a new trial with one of `NEEDLES`, in the tissue as it is now.

        ModelError if there is none of that name, or a measured needle is shown, which was another one.
        """
        if not trial.viewed_scene.is_preset or name not in NEEDLES:
            raise ModelError(f"there is no needle `{name:.40}` for this scene", expected="one of the list")
        other = self._begin(replace_needle(trial.viewed_scene, name), None)
        changes = find_tissue_changes(trial.steering.now.tissue, other.scene.tissue)
        if changes:
            other.act(changes, gesture=0)
        return self._instead(trial, other)

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
        last = "-".join(
            PurePath(viewed_scene.name.removesuffix(".toml")).parts[-2:]
        )  # of a path the last two
        stem = "".join(c if c.isalnum() or c in "-_" else "-" for c in last).strip("-") or "needle"
        path = self._folder / f"{stem}-{datetime.now():%Y%m%d-%H%M%S}-{name}.csv"
        self._all[name] = InteractiveTrial(name, viewed_scene, path, source)
        self._paths.append(path)
        for old in [one for one in self._all if one not in self._steered and one != name]:
            if len(self._all) <= MAX_TRIALS:
                break
            if self._all[old] is not self._shared:
                del self._all[old]
        return self._all[name]


class Motion:
    """What moves a needle by itself: a stroke, the steps of a scene or a plan, or a recording.

    `speed` is in mm/s, of a recording a multiple of its own.
    """

    def __init__(self, kind: Literal["stroke", "play", "replay"], speed: float, gesture: int) -> None:
        self.kind, self.speed, self.gesture = kind, speed, gesture
        self.frames: Frames | None = None


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
            if isinstance(error, OSError):
                error = ModelError(
                    f"the recording {trial.recorder.path} cannot be written: {error.strerror}",
                    expected="room on the disk, and a folder that may be written to",
                    fix="it ends before this step; make room, then open the page in a new window",
                )
            yield {"kind": "refused", "answers": self.last_message_id, **encode_fault(error)}
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
        # A message that steers a needle being inserted, and does not insert it itself, joins the stroke.
        inserts = "insert_mm" in message.content or any(c.name == "depth_mm" for c in message.changes)
        joins = message.do == "change" and self._stroke_gesture is not None and not inserts
        if message.do not in _MOVING_NOTHING and not joins:
            # A hand is on the needle: what goes on by itself stops. A replay that is only halted can go on.
            if message.do == "halt" and self._motion and self._motion.kind == "replay":
                self._paused = self._motion
            elif message.do not in ("halt", "replay"):
                self._paused = None
            self._motion = None
        trial = self.trial
        match message.do:
            case "change":
                self._change(message)
            case "frame":
                now = monotonic()
                dt, self._at = min(now - self._at, MAX_FRAME_S), now
                if self._motion and self._motion.frames:
                    try:
                        self._motion.frames.send(dt)
                    except StopIteration:
                        self._motion = None
            case "move":
                self._move(message)
            case "play":
                if trial.steering.number:
                    trial.reset()
                self._play(trial.steering.scene.steps, message)
            case "replay":
                self._replay(message)
            case "show" if message.text("with_needle"):
                self.trial = self.trials.with_needle(trial, message.text("with_needle"))
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
                if trial.steering.now.step.depth <= SAME_DEPTH_MM:
                    raise ModelError("the needle stands at the entry", expected="a needle in the tissue")
                if trial.steering.now.tissue is not trial.scene.tissue:
                    what, fix = "moduli or shape parameters were changed", "set them back first"
                    raise ModelError(what, expected="the initial parameters", fix=fix)
                self.trial = self.trials.aligned(trial)
            case "fit":
                trial.wanted_fit = _read_scope(trial, message)
            case "points":
                rows = message.content.get("offsets")
                if not isinstance(rows, list) or len(rows) != KNOTS:
                    raise ModelError("these are no offsets of points", expected=f"{KNOTS} numbers, mm")
                moves = [Message("points", content={"offset": row}) for row in rows]
                offsets = [one.number("offset", None, MAX_OFFSET_MM, "mm") for one in moves]
                trial.wanted_offsets, trial.wanted_fit = offsets, _read_scope(trial, message)
            case "plan":
                entry, shared = message.number("entry_mm", 0.0, MAX_ENTRY_MM, "mm"), self.trials.shared
                if trial.aim.goal is None:
                    raise ModelError("there is no target", expected="a target in the tissue", fix="place one")
                if entry < 0 or (entry and shared):
                    expected = "0 mm: a tracker moves the needle" if shared else "0 mm or above"
                    raise ModelError(f"the entry may shift by {entry:g} mm", expected=expected)
                trial.aim.wanted, trial.aim.entry_mm, trial.aim.plan = True, entry, None
            case "run":
                if trial.aim.plan is not None and trial.aim.entry_mm:
                    self.trial = self.trials.entered(trial)
                plan, depth = self.trial.aim.plan, self.trial.steering.now.step.depth
                steps = [step for step in plan.steps if step.depth > depth + SAME_DEPTH_MM] if plan else []
                if not steps:
                    what = "there is no plan from where the needle stands"
                    raise ModelError(what, expected="a plan", fix="plan again")
                self._play(steps[:1] if message.content.get("one") is True else steps, message)
            case "undo":
                trial.undo()
            case "redo":
                trial.undo(redo=True)
            case "reset":
                trial.reset()

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
        motion = Motion("stroke", speed, message.gesture or message.id)
        self._start(motion, _stroke(self.trial, speed, motion.gesture, to))

    def _play(self, steps: Iterable[Step], message: Message) -> None:
        motion = Motion("play", abs(message.number("speed_mm_s", 10.0, MAX_SPEED_MM_S)), message.id)
        self._start(motion, _play(self.trial, steps, motion.speed, message.id))

    def _replay(self, message: Message) -> None:
        times = abs(message.number("times", 1.0, MAX_REPLAY_SPEED))
        if self._paused is not None:
            self._motion, self._paused, self._at = self._paused, None, monotonic()
            self._motion.speed = times
            return
        trial = self.trial  # what it has recorded; while that is a part of what it replays, the whole of that
        source, done = trial.source, trial.steering.number
        if done:
            own = read_recording(trial.recorder.path)
            acts = [step.changes for step in own.steps]
            if source is None or [step.changes for step in source.steps[:done]] != acts:
                source = own
        if source is None or not source.steps:
            raise ModelError("nothing has been recorded", expected="a needle that was moved")
        self.trial = self.trials.again(trial, source)
        motion = Motion("replay", times, -1)
        self._start(motion, _replay(self.trial, source.steps, motion))

    def _start(self, motion: Motion, frames: Frames) -> None:
        next(frames)  # the first frame begins it
        motion.frames = frames
        self._motion, self._at = motion, monotonic()


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
