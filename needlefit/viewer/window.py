"""A window of the interactive simulation: its messages are carried out, and answered."""

from collections.abc import Iterator
from functools import partial
from typing import Any

from needlefit.errors import ModelError, NeedlefitError
from needlefit.planning.goals import Goal
from needlefit.planning.steering import PlanLimits, find_reachable_region, plan_steering
from needlefit.viewer.messages import Message, encode_fault, round_lengths
from needlefit.viewer.plans import (
    BEYOND_TARGET_MM,
    MAX_ENTRY_MM,
    find_placement,
    plan_message,
    read_goal,
)
from needlefit.viewer.trial import InteractiveTrial, RecordingEndedError
from needlefit.viewer.trials import TrialRegistry

Reply = dict[str, Any]


class Window:
    """One authenticated page, and the needle that it controls."""

    def __init__(self, trials: TrialRegistry, trial: InteractiveTrial) -> None:
        self.trials, self.trial = trials, trial
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

    def _describe(self, known: int = 0) -> Iterator[Reply]:
        aim = self.trial.aim
        yield self.trial.describe_scene(known)
        if aim.goal is not None or aim.obstacles:
            yield aim.to_message()
        if aim.plan is not None:
            yield plan_message(aim.plan, aim)

    def _take(self, trial: InteractiveTrial) -> Iterator[Reply]:
        """Change to another needle."""
        self.trial = trial
        self.orders.clear()
        yield from self._describe()

    def _do(self, message: Message) -> Iterator[Reply]:
        if message.fault:
            raise message.fault
        trial = self.trial
        match message.do:
            case "steps":
                for step in message.steps:
                    trial.record(step)
                yield {"kind": "recorded", "step": len(trial.steps)}
            case "show":
                yield from self._take(self.trials.another(trial, message.text("insertion")))
            case "aim":
                trial.aim.set(*read_goal(message))
                yield trial.aim.to_message()
            case "markups":
                trial.aim.read_markups(message, find_placement(trial.viewed_scene))
                yield trial.aim.to_message()
            case "plan":
                entry = message.number("entry_mm", 0.0, MAX_ENTRY_MM, "mm")
                if trial.aim.goal is None:
                    raise ModelError("there is no target", expected="a target in the tissue", fix="place one")
                if entry < 0:
                    raise ModelError(f"the entry may shift by {entry:g} mm", expected="0 mm or above")
                trial.aim.entry_mm, trial.aim.plan = entry, None
                self.orders["plan"] = self._plan(trial, trial.aim.goal)
            case "reach" if trial.aim.goal is not None:
                self.orders["reach"] = self._reach(trial, trial.aim.goal)
            case "run":
                yield from self._take(self.trials.entered(trial))

    def _is_dropped(self, kind: str) -> bool:
        """Return whether nobody waits for it: another one is ordered, or the window was closed."""
        return self.closed or kind in self.orders

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
