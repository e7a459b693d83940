"""Plans of a shown needle: from first contact or from where it stands, and their recordings."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from needlefit.errors import ConfigError
from needlefit.geometry.frames import Placement
from needlefit.mechanics.control import Step
from needlefit.mechanics.plan import SAME_DEPTH_MM
from needlefit.mechanics.scene import Scene
from needlefit.planning.steering import StartedInsertion, SteeringPlan
from needlefit.viewer.interaction.inputs import Change, find_changes
from needlefit.viewer.interaction.steering import SteeredNeedle
from needlefit.viewer.recording import RecordedStep, RecordingWriter, make_head
from needlefit.viewer.viewed_scene import ViewedScene


def begin_insertion(viewed_scene: ViewedScene) -> StartedInsertion:
    """Return a scene's insertion at first contact, under the inputs of its first step."""
    scene = Scene.from_record(viewed_scene.record, viewed_scene.name)
    first = scene.steps[0]
    rules = replace(scene.rules, first_cell=viewed_scene.first_cell)
    start = Step(0.0, first.bevel, first.controls)
    return StartedInsertion(scene.needle, scene.tissue, rules, (start,), viewed_scene.spread)


def continue_insertion(steering: SteeredNeedle, viewed_scene: ViewedScene) -> StartedInsertion:
    """Return the insertion of a steered needle from where it stands."""
    rules = replace(steering.scene.rules, first_cell=steering.first_cell)
    path = steering.input_path()
    return StartedInsertion(steering.scene.needle, steering.now.tissue, rules, path, viewed_scene.spread)


def restart_insertion(steering: SteeredNeedle, viewed_scene: ViewedScene) -> StartedInsertion:
    """Return the insertion of a steered needle at first contact, with its present parameters.

    One that stands there keeps its inputs; another gets those of the scene's first step.
    """
    there = continue_insertion(steering, viewed_scene)
    if steering.now.step.depth <= SAME_DEPTH_MM:
        return there
    first = steering.scene.steps[0]
    bevel = replace(steering.now.step.bevel, side=first.bevel.side)
    return replace(there, path=(Step(0.0, bevel, first.controls),))


def find_placement(viewed_scene: ViewedScene) -> Placement:
    """Return where the constraint frame lies.

    Raises
    ------
    ConfigError
        If that is not known.
    """
    if viewed_scene.placement is not None:
        return Placement.from_record(viewed_scene.placement)
    if viewed_scene.measured is None:
        return Scene.from_record(viewed_scene.record, viewed_scene.name).entry.placement
    raise ConfigError(
        f"where {viewed_scene.name} lies in its scan is not known",
        expected="a target in the constraint frame",
        fix="give it with --target X,Y,Z",
    )


SPEED_MM_S = 10.0
"""Speed of insertion in the recording of a plan."""

RECORDED_STEP_MM = 1.0
"""The needle goes in by so much in each recorded step; that changes nothing of where it ends."""


def write_plan(viewed_scene: ViewedScene, plan: SteeringPlan, path: Path) -> None:
    """Write a plan from first contact as a recording, which `view` and `simulate` replay.

    Its entry is that of the plan.

    Raises
    ------
    OSError
        If it cannot be written.
    ModelError
        If a step has no needle with the scene's parameters.
    """
    viewed_scene = shift_entry(viewed_scene, plan.entry_mm)
    scene = Scene.from_record(viewed_scene.record, viewed_scene.name)
    steering = SteeredNeedle(scene, viewed_scene.first_cell)
    tables = viewed_scene.record.model_dump(mode="json", by_alias=True)
    head = make_head(viewed_scene.name, viewed_scene.first_cell, tables, viewed_scene.placement)
    path.unlink(missing_ok=True)
    recorder, time = RecordingWriter(path, head), 0.0
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
    return replace(
        viewed_scene, record=record, placement=placement, note=note, measured=None, scanned=None, shown=None
    )
