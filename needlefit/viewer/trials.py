"""Interactive trials: each window controls one needle, whose steps are recorded.

The page simulates the needle and sends its steps. Where a tracker moves it, it is simulated here, and the
page follows.
"""

import asyncio
import secrets
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from datetime import datetime
from functools import partial
from pathlib import Path, PurePath
from time import monotonic
from typing import TYPE_CHECKING, Any, get_args

from needlefit.errors import ModelError, NeedlefitError
from needlefit.mechanics.control import Step
from needlefit.mechanics.plan import SAME_DEPTH_MM, Lattice
from needlefit.mechanics.scene import Scene
from needlefit.planning.goals import Goal
from needlefit.planning.steering import (
    PlanLimits,
    StartedInsertion,
    find_reachable_region,
    plan_steering,
)
from needlefit.viewer.messages import (
    MAX_REPLAY_SPEED,
    Message,
    encode_draws,
    encode_fault,
    encode_measured,
    encode_recorded,
    encode_scene,
    encode_tables,
    round_lengths,
)
from needlefit.viewer.opening import list_needles, replace_needle
from needlefit.viewer.plans import (
    BEYOND_TARGET_MM,
    MAX_ENTRY_MM,
    TrialAim,
    continue_insertion,
    draw_challenge,
    find_placement,
    list_changes,
    plan_message,
    read_goal,
    shift_entry,
)
from needlefit.viewer.recording import RecordedStep, Recording, RecordingWriter, replay
from needlefit.viewer.steering import Change, SteeredNeedle, find_tissue_changes
from needlefit.viewer.viewed_scene import ViewedScene

if TYPE_CHECKING:  # where it is used it is imported: it takes half a second to load
    from needlefit.viewer.live_fit import FitScope

MAX_KEPT = 400  #: states to which an undo may return that are kept; others are simulated again
#: number of trials that are kept. Beyond it, those whose windows closed first are dropped; their recordings
#: stay.
MAX_TRIALS = 32
MAX_OFFSET_MM = 50.0  #: a measured point is moved by at most so much, mm
Reply = dict[str, Any]


class InteractiveTrial:
    """An interactive insertion, from first contact on: recorded to `path` as the needle moves.

    A page simulates its needle and sends its steps; the needle here follows them once somebody asks for it.
    `name` is part of the recording's name; `source` is a recording that can be carried out again.
    """

    def __init__(
        self, name: str, viewed_scene: ViewedScene, path: Path, source: Recording | None = None
    ) -> None:
        self.name, self.viewed_scene, self.source = name, viewed_scene, source
        self.scene = Scene.from_record(viewed_scene.record, viewed_scene.name)
        self.steps: list[RecordedStep] = []
        self.recorder = RecordingWriter(path, viewed_scene.make_head())
        self.aim = TrialAim()
        self.measured = viewed_scene.shown  #: the measured insertion before its points were moved
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
            **self.describe_steps(self.steps, known),
        }

    def describe_steps(self, steps: Sequence[RecordedStep], known: int = 0) -> dict[str, Any]:
        """Return steps, without some that are known, as the page carries them out."""
        return {
            "past": [encode_recorded(step) for step in steps[known:]],
            "tables": encode_tables(self.scene.tissue, steps),
        }

    def describe_draws(self) -> dict[str, Any]:
        """Return the message of the draws of a band."""
        assert self.viewed_scene.spread is not None
        return {"kind": "draws", "draws": encode_draws(self.viewed_scene.spread, self.scene.tissue.law)}

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

    def another(self, trial: InteractiveTrial, insertion: str) -> InteractiveTrial:
        """Return the window's trial with another insertion, or a new trial.

        ModelError if the dataset has no such insertion.
        """
        if insertion not in trial.viewed_scene.choices:
            raise ModelError(f"there is no insertion `{insertion:.40}`", expected="one of the list")
        there = trial.window_trials.get(insertion)
        if there is None and insertion not in self._viewed_scenes:
            self._viewed_scenes[insertion] = self._reopen(insertion)
        return self._instead(trial, there or self._begin(self._viewed_scenes[insertion], None))

    def with_needle(self, trial: InteractiveTrial, name: str) -> InteractiveTrial:
        """Return a new trial with one of the needles that are offered, in the tissue as it is now.

        ModelError if there is none of that name, or a measured needle is shown, which was another one.
        """
        if name not in list_needles(trial.viewed_scene):
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


class Window:
    """One authenticated page, and the needle that it controls, or that a tracker moves (`tracked`)."""

    def __init__(self, trials: TrialRegistry, trial: InteractiveTrial, *, tracked: bool) -> None:
        self.trials, self.trial, self._tracked = trials, trial, tracked
        self.sent = 0  #: steps that the page has, where a tracker moves the needle
        #: what takes long, by kind: the newest order counts. It first yields an empty reply, once it has read
        #: the needle, then those for the page.
        self.orders: dict[str, Iterator[Reply]] = {}
        self.closed = False  #: nobody waits any more for what takes long

    def answer(self, message: Message) -> Iterator[Reply]:
        """Carry out a message; yield the replies. StepOrderError if its steps do not follow the recorded."""
        trial = self.trial
        try:
            yield from self._do(message)
        except RecordingEndedError as error:
            yield {"kind": "ended", **encode_fault(error)}
        except OSError as error:
            what = f"the recording {trial.recorder.path} cannot be written: {error.strerror}"
            expected = "room on the disk, and a folder that may be written to"
            fix = "it ends before this step; make room, then open the page in a new window"
            yield {"kind": "ended", "what": what, "expected": expected, "fix": fix}
        except NeedlefitError as error:
            yield {"kind": "refused", "answers": message.id, **encode_fault(error)}
        if message.do == "hello":
            known = int(message.number("known", 0.0)) if message.text("needle") == trial.name else 0
            yield from self._describe(max(0, min(known, len(trial.steps))))
        else:
            yield from self.new_steps()

    def _describe(self, known: int = 0) -> Iterator[Reply]:
        self.sent, aim = len(self.trial.steps), self.trial.aim
        yield self.trial.describe_scene(known) | {"tracked": self._tracked}
        if aim.goal is not None or aim.obstacles:
            yield aim.to_message()
        if aim.plan is not None:
            yield plan_message(aim.plan, aim)

    def new_steps(self) -> Iterator[Reply]:
        """Yield the steps of a tracked needle that the page does not have."""
        if self._tracked and self.sent < len(self.trial.steps):
            known, self.sent = self.sent, len(self.trial.steps)
            yield {"kind": "steps", **self.trial.describe_steps(self.trial.steps, known)}

    def _take(self, trial: InteractiveTrial) -> Iterator[Reply]:
        """Change to another needle."""
        self.trial = trial
        self.orders.clear()
        yield from self._describe()

    def _do(self, message: Message) -> Iterator[Reply]:
        if message.fault:
            raise message.fault
        trial, tracked = self.trial, self._tracked
        match message.do:
            case "steps":
                if tracked:
                    raise StepOrderError("a tracker moves the needle")
                for step in message.steps:
                    trial.record(step)
                yield {"kind": "recorded", "step": len(trial.steps)}
            case "change":
                if not tracked:
                    raise ModelError("the page carries out its inputs", expected="steps")
                trial.act(message.changes, message.gesture)
            case "replay":
                yield from self._replay(message)
            case "show" if message.text("with_needle"):
                yield from self._take(self.trials.with_needle(trial, message.text("with_needle")))
            case "show":
                yield from self._take(self.trials.another(trial, message.text("insertion")))
            case "align":
                if trial.steering.now.step.depth <= SAME_DEPTH_MM:
                    raise ModelError("the needle stands at the entry", expected="a needle in the tissue")
                if find_tissue_changes(trial.steering.now.tissue, trial.scene.tissue):
                    what, fix = "moduli or shape parameters were changed", "set them back first"
                    raise ModelError(what, expected="the initial parameters", fix=fix)
                yield from self._take(self.trials.aligned(trial))
            case "fit":
                self.orders["fit"] = self._fit(trial, _read_scope(trial, message))
            case "points":
                from needlefit.viewer.live_fit import KNOTS

                rows = message.content.get("offsets")
                if not isinstance(rows, list) or len(rows) != KNOTS:
                    raise ModelError("these are no offsets of points", expected=f"{KNOTS} numbers, mm")
                moves = [Message("points", content={"offset": row}) for row in rows]
                offsets = [one.number("offset", None, MAX_OFFSET_MM, "mm") for one in moves]
                self.orders["fit"] = self._fit(trial, _read_scope(trial, message), offsets)
            case "aim":
                trial.aim.set(*read_goal(message))
                yield trial.aim.to_message()
            case "markups":
                trial.aim.read_markups(message, find_placement(trial.viewed_scene))
                yield trial.aim.to_message()
            case "challenge":
                trial.aim.set(None, read_goal(message)[1], ())
                trial.aim.entry_mm = 0.0
                self.orders["plan"] = self._challenge(trial)
            case "plan":
                entry = message.number("entry_mm", 0.0, MAX_ENTRY_MM, "mm")
                if trial.aim.goal is None:
                    raise ModelError("there is no target", expected="a target in the tissue", fix="place one")
                if entry < 0 or (entry and tracked):
                    expected = "0 mm: a tracker moves the needle" if tracked else "0 mm or above"
                    raise ModelError(f"the entry may shift by {entry:g} mm", expected=expected)
                trial.aim.entry_mm, trial.aim.plan = entry, None
                self.orders["plan"] = self._plan(trial, trial.aim.goal)
            case "reach" if trial.aim.goal is not None:
                self.orders["reach"] = self._reach(trial, trial.aim.goal)
            case "run":
                yield from self._take(self.trials.entered(trial))

    def _replay(self, message: Message) -> Iterator[Reply]:
        times = abs(message.number("times", 1.0, MAX_REPLAY_SPEED))
        trial = self.trial  # what it has recorded; while that is a part of what it replays, the whole of that
        source, done = trial.source, [step.changes for step in trial.steps]
        if done and (source is None or [step.changes for step in source.steps[: len(done)]] != done):
            source = Recording(trial.recorder.head, tuple(trial.steps), str(trial.recorder.path))
        if source is None or not source.steps:
            raise ModelError("nothing has been recorded", expected="a needle that was moved")
        yield from self._take(self.trials.again(trial, source))
        yield {"kind": "replay", "times": times, **self.trial.describe_steps(source.steps)}

    def _fit(
        self, trial: InteractiveTrial, scope: "FitScope", offsets: Sequence[float] = ()
    ) -> Iterator[Reply]:
        """Move measured points, fit and draw; the page takes the fitted values as its input."""
        from needlefit.viewer.live_fit import (
            draw_about,
            find_mode,
            move_points,
            select_insertions,
            show_moved,
        )

        yield {}
        if trial.measured is not None and offsets:
            trial.viewed_scene = show_moved(trial.viewed_scene, move_points(trial.measured, offsets))
            assert trial.viewed_scene.measured is not None
            yield {"kind": "measured", "offsets": offsets, **encode_measured(trial.viewed_scene.measured)}
        shown = trial.viewed_scene.shown
        assert shown is not None
        try:
            mode = find_mode(shown, select_insertions(shown, scope))
            yield mode.to_message(shown.insertion)
            if self._is_dropped("fit"):  # these draws would be of no use
                return
            draws = draw_about(mode, shown.insertion, shown.seed)
        except NeedlefitError as error:
            yield {"kind": "fit", "fault": encode_fault(error, "what", "fix")}
            return
        trial.viewed_scene = replace(trial.viewed_scene, spread=draws.spread)
        yield trial.describe_draws()
        yield draws.to_message()

    def _is_dropped(self, kind: str) -> bool:
        """Return whether nobody waits for it: another one is ordered, or the window was closed."""
        return self.closed or kind in self.orders

    def _challenge(self, trial: InteractiveTrial) -> Iterator[Reply]:
        """Choose a random target, and plan to it."""
        insertion = trial.insertion
        yield {}
        parts = draw_challenge(insertion, trial.scene.depth, trial.aim.radius)
        if trial.aim.goal is None:  # nobody has put another target meanwhile
            trial.aim.set(*parts)
            yield trial.aim.to_message()
        if trial.aim.goal is not None:
            self.orders["plan"] = self._plan(trial, trial.aim.goal)

    def _plan(self, trial: InteractiveTrial, goal: Goal) -> Iterator[Reply]:
        """Plan to a goal from where the needle stands."""
        step, insertion, limits = len(trial.steps), trial.planned_insertion, PlanLimits(trial.aim.entry_mm)
        yield {}
        try:
            dropped = partial(self._is_dropped, "plan")
            plan = plan_steering(insertion, goal, limits, threads=1, cancelled=dropped)
        except NeedlefitError as error:
            if not dropped():
                yield {"kind": "plan", "fault": encode_fault(error)}
            return
        if trial.aim.goal is goal:
            trial.aim.plan, trial.aim.plan_step = plan, step
            yield plan_message(plan, trial.aim)

    def _reach(self, trial: InteractiveTrial, goal: Goal) -> Iterator[Reply]:
        """Find the region that the tip can reach from where it stands."""
        step, insertion = len(trial.steps), trial.insertion
        yield {}
        depth = max(goal.target[0] + BEYOND_TARGET_MM, trial.scene.depth)
        region = find_reachable_region(insertion, depth, threads=1)
        edges = {"low": region.low, "high": region.high}  # from the least share of draws to the greatest
        rows = {name: [round_lengths(one) for one in edge] for name, edge in edges.items()}
        yield {"kind": "reach", "step": step, "x": round_lengths(region.x), **rows}


def _read_scope(trial: InteractiveTrial, message: Message) -> "FitScope":
    """Return what a page wants to fit to; ModelError if nothing is measured, or there is no such choice."""
    from needlefit.viewer.live_fit import FitScope

    scopes: dict[str, FitScope] = {scope: scope for scope in get_args(FitScope)}
    scope = message.text("scope")
    if trial.viewed_scene.shown is None or scope not in scopes:
        raise ModelError(
            f"there is nothing measured to fit to (`{scope:.20}`)",
            expected=f"a measured insertion, and one of {', '.join(scopes)}",
        )
    return scopes[scope]
