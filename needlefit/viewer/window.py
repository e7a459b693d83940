"""A window of the interactive simulation: its messages are carried out, and answered."""

from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING, Any

from needlefit.errors import NeedlefitError
from needlefit.viewer.messages import Message, encode_fault
from needlefit.viewer.trial import InteractiveTrial, RecordingEndedError
from needlefit.viewer.trials import TrialRegistry

if TYPE_CHECKING:
    from needlefit.planning.goals import Goal

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
            yield trial.describe_scene()

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
                self.trial = self.trials.another(trial, message.text("insertion"))
                self.orders.clear()
                yield self.trial.describe_scene()
            case "plan":
                from needlefit.viewer.plans import read_goal

                self.orders["plan"] = self._plan(trial, read_goal(message.content), message.id)

    def _is_dropped(self, kind: str) -> bool:
        """Return whether nobody waits for it: another one is ordered, or the window was closed."""
        return self.closed or kind in self.orders

    def _plan(self, trial: InteractiveTrial, goal: "Goal", answers: int) -> Iterator[Reply]:
        """Plan to a goal from where the needle stands."""
        from needlefit.planning.steering import PlanLimits, plan_steering
        from needlefit.viewer.plans import plan_message

        step, insertion = len(trial.steps), trial.insertion
        yield {}
        try:
            dropped = partial(self._is_dropped, "plan")
            plan = plan_steering(insertion, goal, PlanLimits(), threads=1, cancelled=dropped)
        except NeedlefitError as error:
            if not dropped():
                yield {"kind": "plan", "answers": answers, "fault": encode_fault(error)}
            return
        yield plan_message(plan, step, answers, trial.viewed_scene.fitted_depths)
