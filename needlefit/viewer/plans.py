"""Targets, obstacles and plans of a shown needle: read, sought, sent to the page, and recorded."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from needlefit.arrays import are_bounded
from needlefit.errors import ConfigError, ModelError
from needlefit.geometry.frames import Placement
from needlefit.inference.forward_model import ParameterDraws
from needlefit.mechanics.control import Step
from needlefit.planning.goals import Goal
from needlefit.planning.recording import RecordedStep, RecordingWriter
from needlefit.planning.steered_needle import Change, SteeredNeedle, find_changes, make_steered_scene
from needlefit.planning.steering import StartedInsertion, SteeringPlan
from needlefit.project.unit_warnings import extrapolation_warnings
from needlefit.reporting.needle_page import encode_step
from needlefit.schemas.planning import ObstacleRecord
from needlefit.viewer.messages import round_lengths
from needlefit.viewer.viewed_scene import ViewedScene

DEFAULT_RADIUS_MM = 2.0  #: a tip that ends within it has reached the target
MAX_OBSTACLES = 16
MAX_PLACE_MM = 1000.0  #: greatest coordinate and radius of a target or an obstacle, mm
FAN_NEEDLES = 40  #: needles of a plan that are drawn
SPEED_MM_S = 10.0  #: speed of insertion in the recording of a plan
#: the needle goes in by so much in each recorded step; that changes nothing of where it ends
RECORDED_STEP_MM = 1.0


def read_goal(content: Mapping[str, Any]) -> Goal:
    """Return the goal of a page; ModelError without a target, or if a place is no finite number."""
    try:
        target = np.array(content["target"], dtype=np.float64)
        circles = np.array(content.get("obstacles", []), dtype=np.float64).reshape(-1, 3)
        radius = float(content.get("radius", DEFAULT_RADIUS_MM))
        fits = target.shape == (2,) and len(circles) <= MAX_OBSTACLES
        fits &= are_bounded([*target, *circles.ravel(), radius], MAX_PLACE_MM)
        fits &= min([radius, *circles[:, 2]]) > 0
    except (KeyError, OverflowError, TypeError, ValueError):
        fits = False
    if not fits:
        expected = (
            f"x and y, and up to {MAX_OBSTACLES} of x, y, radius: up to {MAX_PLACE_MM:g} mm, radii above 0"
        )
        raise ModelError("these are no target and obstacles", expected=expected)
    obstacles = tuple(
        ObstacleRecord(name=f"obstacle {number}", centre_mm=(at, across), radius_mm=size)
        for number, (at, across, size) in enumerate(circles.tolist(), start=1)
    )
    return Goal((float(target[0]), float(target[1])), radius, obstacles)


def begin_insertion(viewed_scene: ViewedScene) -> StartedInsertion:
    """Return a scene's insertion at first contact, under the inputs of its first step.

    A bevel that is rolled out of the plane begins at a roll of 0: it cut nothing yet, and a plan rolls it.
    """
    scene = make_steered_scene(viewed_scene.record, viewed_scene.name)
    first = scene.steps[0]
    rules = replace(scene.rules, first_cell=viewed_scene.first_cell)
    bevel = replace(first.bevel, side=1, roll_deg=0.0) if first.bevel.toward[1] else first.bevel
    start = Step(0.0, bevel, first.controls)
    return StartedInsertion(scene.needle, scene.tissue, rules, (start,), viewed_scene.spread)


def continue_insertion(steering: SteeredNeedle, spread: ParameterDraws | None) -> StartedInsertion:
    """Return the insertion of a steered needle from where it stands, with draws of its parameters."""
    rules = replace(steering.scene.rules, first_cell=steering.first_cell)
    path = steering.input_path()
    return StartedInsertion(steering.scene.needle, steering.now.tissue, rules, path, spread)


def plan_message(
    found: SteeringPlan, step: int, answers: int, fitted_depths: Sequence[float]
) -> dict[str, Any]:
    solved = found.needles[found.solved]
    drawn = solved[np.linspace(0, len(solved) - 1, min(FAN_NEEDLES, len(solved))).astype(np.intp)]
    nominal = found.nominal if np.isfinite(found.nominal[-1, 0]) else found.nominal[:0]
    return {
        "kind": "plan",
        "step": step,
        "answers": answers,
        "fan": [[round_lengths(column) for column in needle.T] for needle in drawn],
        "x": round_lengths(nominal[:, 0]),
        "y": round_lengths(nominal[:, 1]),
        "path": [encode_step(one) for one in found.steps],
        "turns": len(found.turns),
        "draws": len(found.needles),
        "hits": found.hits,
        "probability": found.probability,
        "low": found.low,
        "high": found.high,
        "warnings": [one.what for one in extrapolation_warnings(found.steps[-1].depth, fitted_depths)],
        **found.describe_misses(),
    }


def find_placement(viewed_scene: ViewedScene) -> Placement:
    """Return where the constraint frame lies; ConfigError if that is not known."""
    if viewed_scene.placement is not None:
        return Placement.from_record(viewed_scene.placement)
    if viewed_scene.measured is None:
        return make_steered_scene(viewed_scene.record, viewed_scene.name).entry.placement
    raise ConfigError.of(f"""where {viewed_scene.name} lies in its scan is not known
        expected: a target in the constraint frame
        fix: give it with --target X,Y,Z""")


def write_plan(viewed_scene: ViewedScene, plan: SteeringPlan, path: Path) -> None:
    """Write a plan from first contact as a recording, which `view` and `simulate` replay.

    Its entry is that of the plan. OSError if it cannot be written. ModelError if a step has no needle with
    the scene's parameters.
    """
    viewed_scene = shift_entry(viewed_scene, plan.entry_mm)
    scene = make_steered_scene(viewed_scene.record, viewed_scene.name)
    steering = SteeredNeedle(scene, viewed_scene.first_cell)
    path.unlink(missing_ok=True)
    recorder, time = RecordingWriter(path, viewed_scene.make_head()), 0.0
    for changes in list_changes(steering, plan.steps):
        moved = sum(change.value - steering.now.step.depth for change in changes if change.name == "depth_mm")
        time += abs(moved) / SPEED_MM_S
        state = steering.apply(changes)
        recorder.write(RecordedStep(steering.number, time, changes, state.shape.tip_lateral))


def list_changes(steering: SteeredNeedle, steps: Sequence[Step]) -> Iterator[tuple[Change, ...]]:
    """Yield the changes that lead a needle through steps, piece by piece; each is applied at once."""
    for step in steps:
        now = steering.now.step
        count = max(1, math.ceil(abs(step.depth - now.depth) / RECORDED_STEP_MM))
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
    return replace(viewed_scene, record=record, placement=placement, note=note, measured=None)
