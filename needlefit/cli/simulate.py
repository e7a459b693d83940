"""`needlefit simulate`: one scene, the needle's shape after each of its steps."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from needlefit.cli import failure, options, screen
from needlefit.cli.completion import scenes
from needlefit.cli.plausibility import doubts
from needlefit.cli.scene_options import Depth, Set, scene_record

if TYPE_CHECKING:
    from needlefit.mechanics.scene import Entry, Scene
    from needlefit.mechanics.shape import NeedleShape
    from needlefit.project.records.scene import SceneRecord


def simulate(
    scene: Annotated[
        str,
        typer.Argument(metavar="SCENE", autocompletion=scenes, help="configs/scenes/<name>.toml or a path."),
    ],
    depth: Depth = None,
    set_: Set = None,
    json: options.Json = False,
    plot: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Draw the needle: .png, .pdf or .svg.")
    ] = None,
    slicer: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Write the needle for 3D Slicer: .mrk.json, a curve for every step, or .ply, a tube of the "
            "last. Scene coordinates are taken as LPS, in the plane z = 0; mm.",
        ),
    ] = None,
    verbose: options.Verbose = False,
) -> None:
    """Simulate a SCENE: a needle, layers, a bevel, and a depth or steps.

    Deflection is the tip's y in the constraint frame (x along the entry, y to the left).
    """
    where, record = scene_record(scene, depth, set_ or [])
    for doubt in doubts(record):
        screen.note(f"needlefit: warning: {doubt}")
    title = record.title or scene
    built, shapes = _insert(record, where)
    answer = summary(built, shapes)
    if plot is not None:  # before anything is printed: the name may be none of a picture
        from needlefit.reporting.figures.scene import draw_scene

        draw_scene(title, built, shapes, plot)
        screen.note(f"drawn: {plot}")
    if slicer is not None:
        from needlefit.reporting.slicer import write_scene

        if write_scene(built.entry, shapes, slicer, record.needle.outer_diameter_mm):
            screen.note(f"written: {slicer}")
    if json:
        screen.show_json(answer)
    else:
        _print(title, answer)
    from needlefit.mechanics.shape import STEEP

    if answer["max_slope"] > STEEP:
        screen.note(
            f"needlefit: warning: slopes reach {answer['max_slope']:.2f}: the model assumes small ones, "
            f"up to about {STEEP:g}"
        )
    if not answer["converged"]:
        failed = f"step {len(shapes)} of {len(built.steps)}" if len(built.steps) > 1 else "the solution"
        screen.note(f"needlefit: {failed} did not converge ({answer['status']}); what it prints is no result")
        raise typer.Exit(failure.NOT_CONVERGED)


def summary(scene: "Scene", shapes: "Sequence[NeedleShape]") -> dict[str, Any]:
    """Return what `--json` prints, of the last step that was tried and, in `steps`, of each; lengths in mm.

    `shapes` end with the last step, or with the one that failed.
    """
    pairs = zip(scene.steps, shapes, strict=False)
    steps = [{"depth_mm": step.depth} | _summary_of_step(scene.entry, shape) for step, shape in pairs]
    for step, before in zip(steps[:0:-1], steps[-2::-1], strict=True):
        step["iterations"] -= before["iterations"]  # a shape counts from first contact
    unreached = dict.fromkeys(steps[0], None) | {"converged": False, "status": "not reached", "iterations": 0}
    left = [unreached | {"depth_mm": step.depth} for step in scene.steps[len(shapes) :]]
    return steps[-1] | {
        "max_slope": max(float(abs(shape.slope).max()) for shape in shapes),
        "boundaries_mm": scene.tissue.boundaries,
        "constraints_mm": shapes[-1].constraints,
        "iterations": shapes[-1].iterations,
        "steps": steps + left,
    }


def _summary_of_step(entry: "Entry", shape: "NeedleShape") -> dict[str, Any]:
    from needlefit.mechanics.shape import positions

    slope = float(shape.slope[-1])
    return {
        "deflection_mm": shape.deflection,
        "tip_slope": slope,
        "tip_mm": entry.to_world(positions(shape, shape.x[-1:]))[0],
        "tip_angle_deg": math.degrees(entry.angle + math.atan(slope)),
        "converged": shape.converged,
        "status": shape.status,
        "iterations": shape.iterations,
    }


def _insert(record: "SceneRecord", where: str) -> tuple["Scene", "tuple[NeedleShape, ...]"]:
    from needlefit.mechanics.scene import Scene, insert

    screen.compile_ahead()
    scene = Scene.from_record(record, where)
    return scene, insert(scene)


def _print(title: str, answer: dict[str, Any]) -> None:
    x, y = answer["tip_mm"]
    interfaces = ", ".join(f"{depth:g}" for depth in answer["boundaries_mm"]) or "none"
    state = "yes" if answer["converged"] else f"NO: {answer['status']}"
    rows = [
        ("depth", f"{answer['depth_mm']:g} mm"),
        ("deflection", f"{_found(answer['deflection_mm'])} mm, tip in the constraint frame"),
        ("tip", f"({_found(x)}, {_found(y)}) mm in the world"),
        ("boundaries", interfaces + (" mm" if interfaces != "none" else "")),
        ("converged", f"{state} ({answer['iterations']} Newton iterations)"),
    ]
    screen.say(title)
    if len(answer["steps"]) > 1:
        for n, step in enumerate(answer["steps"], start=1):
            screen.say(f"  {f'step {n}':<11} {_line(step)}")
    for label, text in rows:
        screen.say(f"  {label:<11} {text}")


def _found(value: float) -> str:
    """Return a length in print; a dash where the needle was not found."""
    return f"{value:z.3f}" if math.isfinite(value) else "–"


def _line(step: dict[str, Any]) -> str:
    """Return a step in one line."""
    depth = f"{step['depth_mm']:g} mm deep"
    if not step["converged"]:
        return f"{depth}: {step['status'] if step['status'] == 'not reached' else 'NO: ' + step['status']}"
    x, y = step["tip_mm"]
    deflection, angle = step["deflection_mm"], step["tip_angle_deg"]
    return f"{depth}, deflection {deflection:z.3f} mm, tip ({x:z.3f}, {y:z.3f}) mm at {angle:z.2f}°"
