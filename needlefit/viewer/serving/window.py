"""One window's side of the server: what a message does to its trial, and what is said back."""

from collections.abc import Iterator
from time import monotonic
from typing import Any

from needlefit.errors import ModelError, NeedlefitError
from needlefit.viewer.hand.inputs import Change
from needlefit.viewer.recording.log import Recording, read
from needlefit.viewer.serving.messages import FASTEST, MOST_TIMES, Message
from needlefit.viewer.serving.motions import LONGEST, Motion, Play, Replay, Stroke
from needlefit.viewer.serving.picture import scene_message, state_message
from needlefit.viewer.serving.trial import Trial
from needlefit.viewer.serving.trials import Trials

Reply = dict[str, Any]


class Window:
    """A page that has said its token, and the needle that it steers.

    Nothing moves by itself: what goes on does so when the page asks for its next frame, and by the time since
    the frame before. A page that is hidden or gone therefore stops its needle.
    """

    def __init__(self, trials: Trials, trial: Trial) -> None:
        self.trials, self.trial = trials, trial
        self.heard = 0
        self._motion: Motion | None = None
        self._paused: Replay | None = None
        self._at = 0.0

    def answer(self, message: Message) -> Iterator[Reply]:
        """Carry a message out; yield what to send back."""
        self.heard = message.id
        trial = self.trial
        try:
            self._do(message)
        except NeedlefitError as error:
            self._motion = None
            yield self._refused(error)
        except OSError as error:
            self._motion = None
            yield self._refused(_unwritten(error, trial))
        if self.trial is not trial or message.do == "hello":
            yield scene_message(self.trial)
        yield self._state()

    def _state(self) -> Reply:
        """Return the needle as it stands."""
        motion = self._motion
        return state_message(self.trial) | {
            "answers": self.heard,
            "moving": motion.speed if isinstance(motion, Stroke) else 0,
            "playing": isinstance(motion, Play | Replay),
            "paused": self._paused is not None,
        }

    def _refused(self, error: NeedlefitError) -> Reply:
        """Return why something was not done."""
        said = {"what": error.what, "expected": error.expected, "mend": error.mend}
        return {"kind": "refused", "answers": self.heard, **said}

    def _do(self, message: Message) -> None:
        if message.fault:
            raise message.fault
        if message.do not in ("frame", "hello") and not self._beside(message):
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
                self._start(Play(self.trial, message.number("speed_mm_s", 10.0, FASTEST), message.id))
            case "replay":
                self._replay(message)
            case "show":
                self.trial = self.trials.another(self.trial, message.text("insertion"))
            case "undo":
                self.trial.undo()
            case "redo":
                self.trial.redo()
            case "reset":
                self.trial.reset()

    def _take_over(self, message: Message) -> None:
        """Stop what goes on by itself: a hand is on the needle. A replay that is only halted can go on."""
        if message.do == "halt" and isinstance(self._motion, Replay):
            self._paused = self._motion
        elif message.do not in ("halt", "replay"):
            self._paused = None
        self._motion = None

    def _beside(self, message: Message) -> bool:
        """Whether a message steers a needle that is being inserted, and does not insert it itself."""
        inserts = "insert_mm" in message.said or any(c.name == "depth_mm" for c in message.changes)
        return message.do == "change" and isinstance(self._motion, Stroke) and not inserts

    def _change(self, message: Message) -> None:
        if any(change.name == "return_to" for change in message.changes):
            raise ModelError("`return_to` is written by the program", expected="undo, redo or reset")
        changes = message.changes
        if "insert_mm" in message.said:
            now, reach = self.trial.steering.now.step.depth, self.trial.steering.reach()
            depth = min(max(now + message.number("insert_mm"), 0.0), max(reach, now))
            changes = (*changes, Change("depth_mm", None, depth))
        if changes:  # what is done during a stroke is undone with it
            gesture = self._motion.gesture if isinstance(self._motion, Stroke) else message.gesture
            self.trial.act(changes, gesture)

    def _stroke(self, message: Message) -> tuple[float, int, float | None]:
        to = None if message.said.get("to_mm") is None else message.number("to_mm")
        speed = message.number("speed_mm_s", most=FASTEST)
        if to is not None:
            speed = abs(speed) if to >= self.trial.steering.now.step.depth else -abs(speed)
        return speed, message.gesture or message.id, to

    def _replay(self, message: Message) -> None:
        times = message.number("times", 1.0, MOST_TIMES)
        if self._paused:
            self._start(self._paused)
            self._paused.speed, self._paused = times, None
            return
        source = _to_replay(self.trial)
        self.trial = self.trials.again(self.trial, source)
        self._start(Replay(source.steps, times))

    def _start(self, motion: Motion) -> None:
        self._motion, self._at = motion, monotonic()

    def _frame(self) -> None:
        now = monotonic()
        dt, self._at = min(now - self._at, LONGEST), now
        if self._motion and not self._motion.advance(self.trial, dt):
            self._motion = None


def _to_replay(trial: Trial) -> Recording:
    """Return what a trial has recorded; while that is only a part of what it replays, the whole of that."""
    source, done = trial.source, trial.steering.number
    if done:
        own = read(trial.recorder.path)
        acts = [step.changes for step in own.steps]
        if source is None or [step.changes for step in source.steps[:done]] != acts:
            source = own
    if source is None or not source.steps:
        raise ModelError("nothing has been recorded", expected="a needle that was moved")
    return source


def _unwritten(error: OSError, trial: Trial) -> ModelError:
    return ModelError(
        f"the recording {trial.recorder.path} cannot be written: {error.strerror}",
        expected="room on the disk, and a folder that may be written to",
        mend="it ends before this step; make room, then open the page in a new window",
    )
