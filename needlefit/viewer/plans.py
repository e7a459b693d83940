"""Targets, obstacles and plans of a shown needle: read, sought, sent to the page, and recorded."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from needlefit.errors import ConfigError, ModelError
from needlefit.geometry.frames import Placement
from needlefit.inference.forward_model import ParameterDraws
from needlefit.mechanics.control import Step
from needlefit.mechanics.scene import Scene
from needlefit.planning.goals import Goal, cut_plane, name_obstacles, read_goal_points
from needlefit.planning.steering import StartedInsertion, SteeringPlan
from needlefit.reporting.needle_page import encode_step
from needlefit.schemas.planning import ObstacleRecord
from needlefit.viewer.messages import Message, round_lengths
from needlefit.viewer.recording import RecordedStep, RecordingWriter
from needlefit.viewer.steering import Change, SteeredNeedle, find_changes
from needlefit.viewer.viewed_scene import ViewedScene

DEFAULT_RADIUS_MM = 2.0  #: a tip that ends within it has reached the target
MAX_OBSTACLES = 16
MAX_PLACE_MM = 1000.0  #: greatest coordinate and radius of a target or an obstacle, mm
MAX_ENTRY_MM = 100.0  #: by how much a plan may shift the entry to either side at most, mm
FAN_NEEDLES = 40  #: needles of a plan that are drawn
BEYOND_TARGET_MM = 8.0  #: the reachable region is shown so far beyond the target
SPEED_MM_S = 10.0  #: speed of insertion in the recording of a plan
#: the needle goes in by so much in each recorded step; that changes nothing of where it ends
RECORDED_STEP_MM = 1.0

GoalParts = tuple[tuple[float, float] | None, float, tuple[ObstacleRecord, ...]]


@dataclass
class TrialAim:
    """Where a trial's needle is to go."""

    goal: Goal | None = None  #: None: there is no target
    radius: float = DEFAULT_RADIUS_MM
    obstacles: tuple[ObstacleRecord, ...] = ()
    plan: SteeringPlan | None = None  #: the last plan for this goal
    plan_step: int = 0  #: step of the needle at which it was sought
    roll_deg: float = 0.0  #: angle about x by which the needle's plane contains a target in space
    #: by how much a plan may shift the entry to either side. Above 0 it begins anew at first contact.
    entry_mm: float = 0.0

    def set(
        self,
        target: tuple[float, float] | None,
        radius: float,
        obstacles: tuple[ObstacleRecord, ...],
        roll_deg: float = 0.0,
    ) -> None:
        """Take another goal; a plan for the one before is dropped."""
        self.goal = None if target is None else Goal(target, radius, obstacles)
        self.radius, self.obstacles, self.roll_deg = radius, obstacles, roll_deg
        self.plan = None

    def read_markups(self, message: Message, placement: Placement) -> None:
        """Take target and obstacles from the text of a file of 3D Slicer; NeedlefitError if it is none."""
        suffix = ".fcsv" if message.text("name").endswith(".fcsv") else ".mrk.json"
        radius = message.number("obstacle_radius", DEFAULT_RADIUS_MM, MAX_PLACE_MM, "mm")
        with TemporaryDirectory() as folder:
            path = Path(folder) / f"markups{suffix}"
            path.write_text(message.text("text"), "utf-8")
            target, balls = read_goal_points(path, placement, radius)
        if target is None and self.goal is not None:  # the file has obstacles alone
            target = (*self.goal.target, 0.0)
        found = cut_plane(target or (1.0, 0.0, 0.0), self.radius, balls[:MAX_OBSTACLES])
        goal = None if target is None else found.goal.target
        self.set(goal, self.radius, found.goal.obstacles, found.roll_deg)

    def to_message(self) -> dict[str, Any]:
        return {
            "kind": "aim",
            "target": None if self.goal is None else list(self.goal.target),
            "radius": self.radius,
            "roll_deg": self.roll_deg,
            "obstacles": [[*one.centre_mm, one.radius_mm, one.name] for one in self.obstacles],
        }


def read_goal(message: Message) -> GoalParts:
    """Return target, radius and obstacles of a message.

    ModelError if one is not a finite number, or there are too many.
    """
    radius = message.number("radius", DEFAULT_RADIUS_MM, MAX_PLACE_MM, "mm")
    if radius <= 0:
        raise ModelError(f"the radius of the target is {radius:g} mm", expected="above 0 mm")
    rows = message.content.get("obstacles", [])
    if not isinstance(rows, list):
        raise ModelError("these are no obstacles", expected="a list of [x, y, radius, name]")
    if len(rows) > MAX_OBSTACLES:
        raise ModelError(f"there are {len(rows)} obstacles", expected=f"up to {MAX_OBSTACLES}")
    parts = [(row[:3], row[3]) if isinstance(row, list) and len(row) == 4 else (row, "") for row in rows]
    names = name_obstacles(label if isinstance(label, str) else "" for _, label in parts)
    circles = []
    for (numbers, _), name in zip(parts, names, strict=True):
        x, y, size = _read_numbers(numbers, 3)
        if size <= 0:
            raise ModelError(f"the radius of {name} is {size:g} mm", expected="above 0 mm")
        circles.append(ObstacleRecord(name=name, centre_mm=(x, y), radius_mm=size))
    target = message.content.get("target")
    x, y = (0.0, 0.0) if target is None else _read_numbers(target, 2)
    return None if target is None else (x, y), radius, tuple(circles)


def _read_numbers(row: object, count: int) -> list[float]:
    if not isinstance(row, list) or len(row) != count:
        raise ModelError(f"{row!r:.60} is no place", expected=f"{count} numbers, mm")
    place = Message("aim", content=dict(zip(("x", "y", "radius"), row, strict=False)))
    return [place.number(key, None, MAX_PLACE_MM, "mm") for key in place.content]


def begin_insertion(viewed_scene: ViewedScene) -> StartedInsertion:
    """Return a scene's insertion at first contact, under the inputs of its first step."""
    scene = Scene.from_record(viewed_scene.record, viewed_scene.name)
    first = scene.steps[0]
    rules = replace(scene.rules, first_cell=viewed_scene.first_cell)
    start = Step(0.0, first.bevel, first.controls)
    return StartedInsertion(scene.needle, scene.tissue, rules, (start,), viewed_scene.spread)


def continue_insertion(steering: SteeredNeedle, spread: ParameterDraws | None) -> StartedInsertion:
    """Return the insertion of a steered needle from where it stands, with draws of its parameters."""
    rules = replace(steering.scene.rules, first_cell=steering.first_cell)
    path = steering.input_path()
    return StartedInsertion(steering.scene.needle, steering.now.tissue, rules, path, spread)


def plan_message(found: SteeringPlan, aim: TrialAim) -> dict[str, Any]:
    solved = found.needles[found.solved]
    drawn = solved[np.linspace(0, len(solved) - 1, min(FAN_NEEDLES, len(solved))).astype(np.intp)]
    nominal = found.nominal if np.isfinite(found.nominal[-1, 0]) else found.nominal[:0]
    return {
        "kind": "plan",
        "step": aim.plan_step,
        "anew": aim.entry_mm > 0,  # it begins at first contact
        "entry_mm": found.entry_mm,
        "fan": [[round_lengths(column) for column in needle.T] for needle in drawn],
        "x": round_lengths(nominal[:, 0]),
        "y": round_lengths(nominal[:, 1]),
        "steps": [
            [one.depth, one.bevel.side, one.controls.base_y, one.controls.base_slope] for one in found.steps
        ],
        "path": [encode_step(one) for one in found.steps],
        "turns": len(found.turns),
        "draws": len(found.needles),
        "hits": found.hits,
        "probability": found.probability,
        "low": found.low,
        "high": found.high,
        **found.describe_misses(),
    }


def find_placement(viewed_scene: ViewedScene) -> Placement:
    """Return where the constraint frame lies; ConfigError if that is not known."""
    if viewed_scene.placement is not None:
        return Placement.from_record(viewed_scene.placement)
    if viewed_scene.measured is None:
        return Scene.from_record(viewed_scene.record, viewed_scene.name).entry.placement
    raise ConfigError(
        f"where {viewed_scene.name} lies in its scan is not known",
        expected="a target in the constraint frame",
        fix="give it with --target X,Y,Z",
    )


def write_plan(viewed_scene: ViewedScene, plan: SteeringPlan, path: Path) -> None:
    """Write a plan from first contact as a recording, which `view` and `simulate` replay.

    Its entry is that of the plan. OSError if it cannot be written. ModelError if a step has no needle with
    the scene's parameters.
    """
    viewed_scene = shift_entry(viewed_scene, plan.entry_mm)
    scene = Scene.from_record(viewed_scene.record, viewed_scene.name)
    steering = SteeredNeedle(scene, viewed_scene.first_cell)
    path.unlink(missing_ok=True)
    recorder, time = RecordingWriter(path, viewed_scene.make_head()), 0.0
    for changes in list_changes(steering, plan.steps, RECORDED_STEP_MM):
        moved = sum(change.value - steering.now.step.depth for change in changes if change.name == "depth_mm")
        time += abs(moved) / SPEED_MM_S
        state = steering.apply(changes)
        recorder.write(RecordedStep(steering.number, time, changes, state.shape.tip_lateral))


def list_changes(
    steering: SteeredNeedle, steps: Sequence[Step], piece_mm: float
) -> Iterator[tuple[Change, ...]]:
    """Yield the changes that lead a needle through steps in pieces of so many mm; each is applied at once."""
    for step in steps:
        now = steering.now.step
        count = max(1, math.ceil(abs(step.depth - now.depth) / piece_mm))
        for depth in np.linspace(now.depth, step.depth, count + 1)[1:].tolist():
            inputs = find_changes(step, steering.now.step, steering.names)
            yield (*inputs, Change("depth_mm", None, depth))


def shift_entry(viewed_scene: ViewedScene, shift: float) -> ViewedScene:
    """Return a scene whose entry lies elsewhere, `shift` mm along y; nothing was measured there."""
    if not shift:
        return viewed_scene
    entry = viewed_scene.record.entry
    angle = math.radians(entry.angle_deg)
    moved = entry.model_copy(
        update={"x_mm": entry.x_mm - shift * math.sin(angle), "y_mm": entry.y_mm + shift * math.cos(angle)}
    )
    placement = viewed_scene.placement
    if placement is not None:
        placed = Placement.from_record(placement)
        frame = replace(placed.frame, origin=placed.frame.to_world([[0.0, shift, 0.0]])[0])
        placement = replace(placed, frame=frame).to_record()
    record = viewed_scene.record.model_copy(update={"entry": moved})
    note = f"{viewed_scene.note} The entry is shifted by {shift:+.2f} mm along y.".strip()
    return replace(viewed_scene, record=record, placement=placement, note=note, measured=None, scanned=None)
