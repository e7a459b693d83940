"""What the viewer shows of one name of the command line: a scene, a recording, or a measured insertion.

It can be steered: here is where its insertion begins, and its plan as a recording.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np

from needlefit.errors import ConfigError
from needlefit.geometry.frames import Placement
from needlefit.mechanics.control import Step
from needlefit.planning.recording import RecordedStep, Recording, make_head
from needlefit.planning.steered_needle import Change, SteeredNeedle, find_changes, make_steered_scene
from needlefit.project.random_streams import random_stream
from needlefit.project.result_warnings import ResultWarning
from needlefit.schemas.scene import PlacementRecord, RecordingRecord, SceneRecord

if TYPE_CHECKING:
    from needlefit.inference.forward_model import ParameterDraws
    from needlefit.planning.steering import StartedInsertion, SteeringPlan
    from needlefit.studies.run import Run

SPEED_MM_S = 10.0  #: speed of insertion in the recording of a plan
#: the needle goes in by so much in each recorded step; that changes nothing of where it ends
RECORDED_STEP_MM = 1.0


@dataclass(frozen=True, kw_only=True)
class ViewedScene:
    """A scene, or a measured insertion as one, with what is known of its parameters and its position."""

    name: str  #: opens it again
    title: str
    note: str  #: where the parameters come from, and what cannot be shown and why; sentences
    record: SceneRecord  #: the scene: needle, tissue and inputs
    #: depth of the first constraint point, mm, with which a `Session` ends as `simulate` and `predict` do
    first_cell: float
    #: the position of a measured needle; None for a scene, which contains its own, and where it is not known
    placement: PlacementRecord | None = None
    is_measured: bool = False
    spread: "ParameterDraws | None" = None  #: draws of the parameters, for the band of a fit and for plans
    #: what these are for: a specimen that was not fitted, with the spread between specimens, or one that was
    specimen: Literal["new", "same", ""] = ""
    origin_mark: str = ""  #: that its data were not measured
    measured: Mapping[str, Any] | None = None  #: the measured needle as the page has it
    fitted_depths: tuple[float, ...] = ()  #: of the insertions that a run has fitted, mm
    fitted_directions: int = 2  #: how many deflections a run has fitted, along y, and z
    warnings: tuple[ResultWarning, ...] = ()  #: what is suspicious in the dataset or the run that it is from
    run: "Run | None" = None  #: that it is from

    def make_head(self) -> RecordingRecord:
        return make_head(self.name, self.first_cell, self.record, self.placement)

    def begin_insertion(self) -> "StartedInsertion":
        """Return the insertion at first contact, under the inputs of the first step.

        A bevel that is rolled out of the plane begins at a roll of 0: it cut nothing yet, and a plan rolls
        it.
        """
        from needlefit.planning.steering import StartedInsertion  # late: it takes longer than a scene

        scene = make_steered_scene(self.record, self.name)
        first = scene.steps[0]
        rules = replace(scene.rules, first_cell=self.first_cell)
        bevel = replace(first.bevel, side=1, roll_deg=0.0) if first.bevel.toward[1] else first.bevel
        start = Step(0.0, bevel, first.controls)
        return StartedInsertion(scene.needle, scene.tissue, rules, (start,), self.spread)

    def vary_gain(self, sd: float) -> Self:
        """Return the scene with draws of the part of each move of the base that reaches the needle, about 1.

        ConfigError if its parameters are exact.
        """
        if self.spread is None:
            raise ConfigError(
                "the parameters are exact, so that a plan has no probability",
                expected="a run with certified draws",
                fix="leave --gain-sd out",
                where=self.name,
            )
        gain = 1 + sd * random_stream(0, "gain", self.name).standard_normal(len(self.spread))
        return replace(self, spread=replace(self.spread, gain=gain))

    def find_placement(self) -> Placement:
        """Return where the constraint frame lies; ConfigError if that is not known."""
        if self.placement is not None:
            return Placement.from_record(self.placement)
        if not self.is_measured:
            return make_steered_scene(self.record, self.name).entry.placement
        raise ConfigError(
            f"where {self.name} lies in its scan is not known",
            expected="a target in the constraint frame",
            fix="give it with --target X,Y,Z",
        )

    def shift_entry(self, shift: float) -> Self:
        """Return the scene with its entry elsewhere, `shift` mm along y."""
        if not shift:
            return self
        entry = self.record.entry
        angle = math.radians(entry.angle_deg)
        x, y = entry.x_mm - shift * math.sin(angle), entry.y_mm + shift * math.cos(angle)
        record = self.record.model_copy(update={"entry": entry.model_copy(update={"x_mm": x, "y_mm": y})})
        placement = self.placement
        if placement is not None:
            placed = Placement.from_record(placement)
            frame = replace(placed.frame, origin=placed.frame.to_world([[0.0, shift, 0.0]])[0])
            placement = replace(placed, frame=frame).to_record()
        return replace(self, record=record, placement=placement)

    def record_plan(self, plan: "SteeringPlan") -> Recording:
        """Return a plan from first contact, at the entry of the plan, as a recording.

        ModelError if a step has no needle with the scene's parameters.
        """
        shifted = self.shift_entry(plan.entry_mm)
        steering = SteeredNeedle(make_steered_scene(shifted.record, shifted.name), shifted.first_cell)
        steps, time = [], 0.0
        for changes in list_changes(steering, plan.steps):
            depths = [change.value for change in changes if change.name == "depth_mm"]
            time += sum(abs(depth - steering.now.step.depth) for depth in depths) / SPEED_MM_S
            state = steering.apply(changes)
            steps.append(RecordedStep(steering.number, time, changes, state.shape.tip_lateral))
        return Recording(shifted.make_head(), tuple(steps))


def list_changes(steering: SteeredNeedle, steps: Sequence[Step]) -> Iterator[tuple[Change, ...]]:
    """Yield the changes that lead a needle through steps, piece by piece; each is applied at once."""
    for step in steps:
        now = steering.now.step
        count = max(1, math.ceil(abs(step.depth - now.depth) / RECORDED_STEP_MM))
        for depth in np.linspace(now.depth, step.depth, count + 1)[1:].tolist():
            inputs = find_changes(step, steering.now.step, steering.names)
            yield (*inputs, Change("depth_mm", None, depth))
