"""The result of `simulate`, of a scene or of a recording, and the files that can be written of it."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from needlefit.cli import screen
from needlefit.errors import NeedlefitError
from needlefit.project.outputs import require_output_files
from needlefit.project.view_targets import find_view_target

if TYPE_CHECKING:
    from needlefit.geometry.frames import Placement
    from needlefit.mechanics.scene import Entry, Scene
    from needlefit.mechanics.shape import NeedleShape
    from needlefit.project.result_warnings import ResultWarning
    from needlefit.reporting.table_files import Row
    from needlefit.reporting.table_layout import TableLayout
    from needlefit.schemas.scene import SceneRecord


ANIMATION_SPEED_MM_S = 10.0
"""mm/s: how fast a scene goes in in an animation; the model knows no time."""


@dataclass(frozen=True)
class SimulatedScene:
    """A scene carried out, up to the step that failed; `diameter` is the needle's, mm, if it is known."""

    title: str
    scene: "Scene"
    shapes: "tuple[NeedleShape, ...]"
    diameter: float | None


def write_picture(done: SimulatedScene, path: Path) -> None:
    """Draw the needle after each step."""
    from needlefit.reporting.figures.scene import draw_scene

    draw_scene(done.title, done.scene, done.shapes, path)


def write_curves(done: SimulatedScene, path: Path) -> bool:
    """Write the needle for 3D Slicer; False where there is none."""
    from needlefit.studies.slicer import write_scene

    return write_scene(done.scene.entry.placement, done.shapes, path, done.diameter)


def write_table(done: SimulatedScene, path: Path) -> bool:
    """Write the last shape; False where there is none."""
    from needlefit.mechanics.session import NeedleState
    from needlefit.reporting.shape_table import write_shape

    shape = done.shapes[-1]
    if shape.converged:
        last = done.scene.steps[len(done.shapes) - 1]
        write_shape(done.scene, NeedleState(shape, last, done.scene.tissue), path)
    return shape.converged


def write_animation(done: SimulatedScene, path: Path) -> None:
    """Draw the needle on its way, as far as it comes."""
    from needlefit.mechanics.scene import iterate_states
    from needlefit.reporting.figures.animation import animate

    moments = [(gone / ANIMATION_SPEED_MM_S, moment) for gone, moment in iterate_states(done.scene)]
    animate(done.title, done.scene, moments, moments[-1][0], path)


Write = Callable[[Path], bool | None]


@dataclass(frozen=True)
class SimulationOutcome:
    """A needle at the end of its way.

    Attributes
    ----------
    scene : Scene
        Its steps are those that `shapes` belong to.
    shapes : tuple of NeedleShape
        After each step, up to the one that failed.
    files : mapping of str to callable
        By option, what writes such a file; False where there is no needle to write.
    more : dict
        What else `--json` says.
    placement : Placement or None
        Where a measured needle lies; None of a scene, which says so itself.
    """

    title: str
    scene: "Scene"
    shapes: "tuple[NeedleShape, ...]"
    files: Mapping[str, Write]
    more: dict[str, Any]
    placement: "Placement | None" = None
    warnings: "tuple[ResultWarning, ...]" = ()


def simulate_scene(name: str, record: "SceneRecord", where: str) -> SimulationOutcome:
    """Carry out a scene's steps; `where` is named in errors."""
    from needlefit.mechanics.scene import Scene, simulate_scene
    from needlefit.project.unit_warnings import coarse_warnings, scene_warnings

    scene = Scene.from_record(record, where)
    done = SimulatedScene(record.title or name, scene, simulate_scene(scene), record.needle.outer_diameter_mm)
    files: dict[str, Write] = {
        "plot": partial(write_picture, done),
        "csv": partial(write_table, done),
        "slicer": partial(write_curves, done),
        "animation": partial(write_animation, done),
    }
    warnings = (*scene_warnings(record, where), *coarse_warnings(record, where))
    return SimulationOutcome(done.title, scene, done.shapes, files, {}, warnings=warnings)


def replay_recording(path: Path, upto: int | None, outputs: Mapping[str, Path]) -> SimulationOutcome:
    """Carry out a recording, or its steps up to number `upto`.

    Raises
    ------
    ConfigError
        If one of `outputs`, by option, is a file of what was steered, or cannot be written.
    """
    from needlefit.project.unit_warnings import coarse_warnings, scene_warnings
    from needlefit.viewer import export
    from needlefit.viewer.export import replay_to_end
    from needlefit.viewer.recording import read_recording

    recording = read_recording(path)
    require_output_files(outputs, [path, *_view_target_files(recording.head.target)])
    if upto is not None:
        if upto > len(recording.steps):
            raise typer.BadParameter(f"the recording has {len(recording.steps)} steps", param_hint="--step")
        recording = replace(recording, steps=recording.steps[:upto])
    done = replay_to_end(recording)
    files: dict[str, Write] = {
        "plot": partial(export.write_picture, done),
        "csv": partial(export.write_table, done),
        "slicer": partial(export.write_curve, done),
        "animation": partial(export.write_animation, done),
        "html": partial(export.write_share, done),
    }
    more = {"replayed": {"steps": len(recording.steps), "tip_offset_mm": done.tip_offset_mm}}
    planned = recording.head.scene
    warnings = (*scene_warnings(planned, str(path)), *coarse_warnings(planned, str(path)))
    return SimulationOutcome(
        done.title, done.scene, (done.state.shape,), files, more, done.placement, warnings
    )


def _view_target_files(target: str) -> list[Path]:
    """Return the scene, or the folder of the run or dataset, that a recording is of; none if it is gone."""
    try:
        view_target = find_view_target(target)
    except NeedlefitError:
        return []
    return [view_target.path.parent if view_target.kind == "dataset" else view_target.path]


def summarize_simulation(
    scene: "Scene", shapes: "Sequence[NeedleShape]", placement: "Placement | None" = None
) -> dict[str, Any]:
    """Return what `--json` prints, of the last step that was tried and, in `steps`, of each; lengths in mm.

    `shapes` end with the last step, or with the one that failed; `placement` is where a measured needle lies.
    """
    from needlefit.mechanics.shape import find_worst

    pairs = zip(scene.steps, shapes, strict=False)
    steps = [
        {"depth_mm": step.depth} | _summarize_step(scene.entry, shape, placement) for step, shape in pairs
    ]
    for step, before in zip(steps[:0:-1], steps[-2::-1], strict=True):
        step["iterations"] -= before["iterations"]  # a shape counts from first contact
    unreached = dict.fromkeys(steps[0], None) | {
        "converged": False, "status": "not reached", "valid": False, "iterations": 0,
    }  # fmt: skip
    left = [unreached | {"depth_mm": step.depth} for step in scene.steps[len(shapes) :]]
    validity = find_worst([shape.validity for shape in shapes])
    return steps[-1] | {
        "max_slope": validity.max_slope,
        "valid": all(shape.valid for shape in shapes),
        "validity": validity.table(),
        "boundaries_mm": scene.tissue.boundaries,
        "constraints_mm": shapes[-1].constraints,
        "iterations": shapes[-1].iterations,
        "steps": steps + left,
    }


def _summarize_step(entry: "Entry", shape: "NeedleShape", placement: "Placement | None") -> dict[str, Any]:
    from needlefit.mechanics.shape import compute_positions

    slope = float(shape.slope[-1])
    return {
        "tip_lateral_mm": shape.tip_lateral,
        "tip_slope": slope,
        "tip_mm": (placement or entry).to_world(compute_positions(shape, shape.x[-1:]))[0],
        "tip_angle_deg": math.degrees(entry.angle + slope),
        "converged": shape.converged,
        "status": shape.status,
        "valid": shape.valid,
        "iterations": shape.iterations,
    }


def show_summary(title: str, summary: dict[str, Any]) -> None:
    """Print a row for each step, and boundaries, iterations and, of a recording, the difference from it."""
    interfaces = ", ".join(f"{depth:g}" for depth in summary["boundaries_mm"])
    screen.print_line()
    screen.print_text(title)
    screen.show_display(_lay_out_steps(summary["steps"]), notes=False)
    screen.print_line(f"Layer boundaries: {f'{interfaces} mm' if interfaces else 'none'}")
    state = "" if summary["converged"] else "not converged, "
    slope = f"; largest slope {summary['max_slope']:.3f}" if summary["converged"] else ""
    screen.print_line(f"Solution: {state}{summary['iterations']} Newton iterations{slope}")
    if "replayed" in summary:
        screen.print_line(f"Replayed: {_describe_replay(**summary['replayed'])}")


def describe_outcome(summary: dict[str, Any]) -> str:
    """Return where the needle ends in one sentence, or that no solution was found."""
    depth = f"depth {summary['depth_mm']:g} mm"
    if not summary["converged"]:
        return f"NOT CONVERGED at {depth}: {summary['status']}."
    place = ", ".join(map(_format_length, summary["tip_mm"]))
    valid = "" if summary["valid"] else "; outside what the model assumes"
    lateral = summary["tip_lateral_mm"]
    side = f"{_format_length(abs(lateral))} mm to the {'right' if lateral < 0 else 'left'}"
    return f"Tip {side} of the entry axis at {depth}; tip at ({place}) mm in the world{valid}."


def _lay_out_steps(steps: Sequence[Mapping[str, Any]]) -> "TableLayout":
    from needlefit.reporting.table import Table

    rows = [_describe_step(number, step) for number, step in enumerate(steps, start=1)]
    columns = ("step", "inserted_mm", "tip_lateral_mm", "tip_position", "tip_angle_deg", "step_state")
    caption = "Steps: tip in the world." if len(rows) > 1 else "Tip in the world."
    return Table("steps", caption, rows, columns).lay_out()


def _describe_step(number: int, step: Mapping[str, Any]) -> "Row":
    found = bool(step["converged"])
    state = ("ok" if step["valid"] else "outside the model's limits") if found else str(step["status"])
    place = ", ".join(map(_format_length, step["tip_mm"])) if found else None
    lengths = {"tip_lateral_mm": step["tip_lateral_mm"] if found else None, "inserted_mm": step["depth_mm"]}
    angle = step["tip_angle_deg"] if found else None
    return {"step": number, **lengths, "tip_position": place, "tip_angle_deg": angle, "step_state": state}


def _describe_replay(steps: int, tip_offset_mm: float) -> str:
    text = f"{steps} step{'' if steps == 1 else 's'}, tip "
    return text + (
        f"up to {tip_offset_mm:.1g} mm from the recorded one"
        if tip_offset_mm
        else "identical to the recorded one"
    )


def _format_length(value: float) -> str:
    """Return a length in print; a dash where the needle was not found."""
    return f"{value:z.3f}".replace("-", "−") if math.isfinite(value) else "–"
