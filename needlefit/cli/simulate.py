"""`needlefit simulate`: one scene, or a recording of it; the needle's shape after each step."""

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from needlefit.cli import exit_codes, options, screen
from needlefit.cli.options import argument, option, scene_record
from needlefit.errors import NeedlefitError
from needlefit.project.folders import require_output_files
from needlefit.project.locate import find_file, find_view_target
from needlefit.project.result_warnings import WARNINGS_KEY, ResultWarning, to_rows

if TYPE_CHECKING:
    from needlefit.arrays import Floats
    from needlefit.geometry.frames import Placement
    from needlefit.mechanics.scene import Entry, Scene
    from needlefit.mechanics.shape import NeedleShape
    from needlefit.reporting.table_files import Row
    from needlefit.schemas.scene import SceneRecord


@dataclass(frozen=True)
class _Simulated:
    """A needle at the end of its way."""

    title: str
    scene: "Scene"  #: its steps are those that `shapes` belong to
    shapes: "Sequence[NeedleShape]"  #: after each step, up to the one that failed; of a recording the last
    placement: "Placement | None" = None  #: of a measured needle; None of a scene, which contains it
    #: of a recording its steps, and the greatest distance of the tip from where it was recorded, mm
    replayed: Mapping[str, float] | None = None


def simulate(
    context: typer.Context,
    scene: Annotated[
        str | None,
        argument("SCENE", "configs/scenes/<name>.toml or a path; none with --recording."),
    ] = None,
    depth: options.Depth = None,
    set_: options.Changes = None,
    recording: options.Recording = None,
    plot: Annotated[Path | None, option("Draw the final shape and load: .pdf or .png.", "FILE")] = None,
    csv: Annotated[
        Path | None, option("Write the final shape: position (mm), slope, load (N/mm).", "FILE")
    ] = None,
    slicer: Annotated[
        Path | None,
        option(
            "Write the needle for 3D Slicer, a curve for every step: .mrk.json (LPS; a recording of a "
            "measured insertion: in its scan).",
            "FILE",
        ),
    ] = None,
) -> None:
    """Simulate a SCENE, or replay a recording of one.

    A scene has a needle, layers, a bevel, and a depth or steps.

    Deflection is the tip's y in the constraint frame (x along the entry, y to the left).
    """
    from needlefit.mechanics.scene import Scene, simulate_scene
    from needlefit.project.unit_warnings import scene_warnings

    files = {"--plot": plot, "--csv": csv, "--slicer": slicer}
    written = {option: path for option, path in files.items() if path is not None}
    if recording is None:
        if scene is None:
            raise typer.BadParameter("give a SCENE, or a recording with --recording", param_hint="SCENE")
        require_output_files(written, [find_file("scene", scene)])
        where, record = scene_record(scene, depth, set_ or [])
        model = Scene.from_record(record, where)
        done = _Simulated(record.title or scene, model, simulate_scene(model))
    else:
        if scene is not None or depth is not None or set_:
            raise typer.BadParameter(
                "the recording contains its scene: leave out SCENE, --depth and --set",
                param_hint="--recording",
            )
        done, record = _replay_recording(recording, written)
        where = str(recording)

    saved = list[Path]()  # before anything is printed: a name may be none of a picture
    if (plot or csv) and done.shapes[-1].converged:
        from needlefit.reporting.shape_table import draw_shape, tabulate_shape
        from needlefit.reporting.table_files import write_csv

        table = tabulate_shape(done.scene, done.shapes[-1], done.placement)
        for path, write in ((plot, draw_shape), (csv, write_csv)):
            if path is not None:
                write(table, path)
                saved.append(path)
    if slicer is not None:
        from needlefit.reporting.slicer import write_simulated_needle

        placement = done.placement or done.scene.entry.placement
        saved += [slicer] if write_simulated_needle(placement, done.shapes, slicer) else []
    invocation = context.find_root().obj
    summary = summarize_simulation(done.scene, done.shapes, done.placement)
    summary |= {} if done.replayed is None else {"replayed": done.replayed}
    warnings = [*scene_warnings(record, where)]
    if faults := summary["validity"]["faults"]:
        problem = f"the solution is outside what the model assumes: {'; '.join(faults)}"
        warnings.append(ResultWarning("validity", problem, fix="check stiffness, bevel offset and depth"))
    summary |= {WARNINGS_KEY: to_rows(warnings)}
    if invocation.json:
        screen.show_json(summary)
    else:
        screen.print_text(_describe_outcome(summary))
    screen.print_warnings(invocation, warnings)
    if not invocation.json:
        _show_summary(done.title, summary)
    for path in saved:
        screen.print_note(f"written: {path}")
    if not summary["converged"]:
        steps = len(done.scene.steps)
        failed = f"step {len(done.shapes)} of {steps}" if steps > 1 else "the solution"
        screen.print_note(
            f"needlefit: {failed} did not converge ({summary['status']}); the values are no result"
        )
        raise typer.Exit(exit_codes.NOT_CONVERGED)


def _replay_recording(path: Path, outputs: Mapping[str, Path]) -> "tuple[_Simulated, SceneRecord]":
    """Carry out a recording; return also its scene.

    ConfigError if one of `outputs`, by option, is a file of what was steered, or cannot be written.
    """
    from needlefit.geometry.frames import Placement
    from needlefit.planning.steered_needle import begin_replay, read_recording, replay

    recording = read_recording(path)
    head, shown = recording.head, list[Path]()
    with suppress(NeedlefitError):  # the scene, or the folder of the run or dataset, unless it is gone
        target = find_view_target(head.target, "scene")
        shown.append(target.path.parent if target.kind == "dataset" else target.path)
    require_output_files(outputs, [path, *shown])
    steering = begin_replay(recording)
    off = max(replayed.tip_offset_mm for replayed in replay(recording, steering))
    state = steering.now
    simulated = _Simulated(
        head.scene.title or head.target,
        replace(steering.scene, tissue=state.tissue, steps=(state.step,)),
        (state.shape,),
        Placement.from_record(head.placement) if head.placement else None,
        {"steps": len(recording.steps), "tip_offset_mm": off},
    )
    return simulated, head.scene


def summarize_simulation(
    scene: "Scene", shapes: "Sequence[NeedleShape]", placement: "Placement | None"
) -> dict[str, Any]:
    """Return what `--json` prints, of the last step that was tried and, in `steps`, of each; lengths in mm.

    `shapes` end with the last step, or with the one that failed; `placement` is where a measured needle lies.
    """
    from needlefit.mechanics.shape import find_worst
    from needlefit.mechanics.torsion import find_roll

    steps = [
        {"depth_mm": step.depth}
        | _summarize_step(scene.entry, shape, placement)
        | {"roll_at_tip_deg": find_roll(step.bevel)}
        for step, shape in zip(scene.tip_steps, shapes, strict=False)
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

    angle, elevation = shape.tip_direction
    return {
        "tip_lateral_mm": shape.tip_lateral,
        "tip_z_mm": shape.tip_z if shape.converged else math.nan,
        "tip_slope": float(shape.slope[-1]),
        "tip_slope_z": float(shape.slope_z[-1]),
        "tip_mm": (placement or entry.placement).to_world(compute_positions(shape, shape.x[-1:]))[0],
        "tip_angle_deg": math.degrees(entry.angle + angle),
        "tip_elevation_deg": math.degrees(elevation),
        "converged": shape.converged,
        "status": shape.status,
        "valid": shape.valid,
        "iterations": shape.iterations,
    }


def _show_summary(title: str, summary: dict[str, Any]) -> None:
    """Print a row for each step and, of a recording, the difference from it."""
    from needlefit.reporting.table import Table

    rows: list[Row] = []
    for number, step in enumerate(summary["steps"], start=1):
        converged, row = step["converged"], {"step": number, "inserted_mm": step["depth_mm"]}
        state = ("ok" if step["valid"] else "outside the model's limits") if converged else step["status"]
        place = _format_place(step["tip_mm"]) if converged else None
        named = ("tip_lateral_mm", "roll_at_tip_deg", "tip_angle_deg")
        tip = {key: step[key] if converged else None for key in named}
        tip |= {"tip_z": step["tip_z_mm"] if converged else None, "tip_position": place}
        rows.append(row | tip | {"step_state": state})
    columns = ["step", "inserted_mm", "tip_lateral_mm", "tip_position", "tip_angle_deg", "step_state"]
    if any(step["tip_z_mm"] or step["roll_at_tip_deg"] not in (None, 0, 180) for step in summary["steps"]):
        columns[3:3] = ["tip_z", "roll_at_tip_deg"]
    screen.print_line()
    screen.print_text(title)
    caption = "Steps: tip in the world." if len(rows) > 1 else "Tip in the world."
    screen.show_display(Table("steps", rows, columns, caption=caption).lay_out(), notes=False)
    if replayed := summary.get("replayed"):
        screen.print_line(
            f"Replayed: {replayed['steps']} steps, tip up to {replayed['tip_offset_mm']:.1g} mm "
            "from the recorded one"
        )


def _describe_outcome(summary: dict[str, Any]) -> str:
    depth = f"depth {summary['depth_mm']:g} mm"
    if not summary["converged"]:
        return f"NOT CONVERGED at {depth}: {summary['status']}."
    place = _format_place(summary["tip_mm"])
    valid = "" if summary["valid"] else "; outside what the model assumes"
    lateral, z = summary["tip_lateral_mm"], summary["tip_z_mm"]
    side = f"{_format_length(abs(lateral))} mm to the {'right' if lateral < 0 else 'left'}"
    beside = f", {_format_length(z)} mm along z," if z else ""
    return f"Tip {side}{beside} of the entry axis at {depth}; tip at ({place}) mm in the world{valid}."


def _format_place(place: "Floats") -> str:
    """Return coordinates in print; without z of a tip in the plane z = 0."""
    return ", ".join(map(_format_length, place if place[2] else place[:2]))


def _format_length(value: float) -> str:
    """Return a length in print; a dash where the needle was not found."""
    return f"{value:z.3f}".replace("-", "−") if math.isfinite(value) else "–"
