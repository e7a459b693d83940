"""What `simulate` prints: where the needle ends, and where it stood after each step."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from needlefit.cli import screen

if TYPE_CHECKING:
    from needlefit.geometry.frames import Placement
    from needlefit.mechanics.scene import Entry, Scene
    from needlefit.mechanics.shape import NeedleShape


def summarize_simulation(
    scene: "Scene", shapes: "Sequence[NeedleShape]", placement: "Placement | None" = None
) -> dict[str, Any]:
    """Return what `--json` prints, of the last step that was tried and, in `steps`, of each; lengths in mm.

    `shapes` end with the last step, or with the one that failed; `placement` is where a measured needle lies.
    """
    from needlefit.mechanics.validity import find_worst

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
        "deflection_mm": shape.deflection,
        "tip_slope": slope,
        "tip_mm": (placement or entry).to_world(compute_positions(shape, shape.x[-1:]))[0],
        "tip_angle_deg": math.degrees(entry.angle + math.atan(slope)),
        "converged": shape.converged,
        "status": shape.status,
        "valid": shape.valid,
        "iterations": shape.iterations,
    }


def show_summary(title: str, summary: dict[str, Any]) -> None:
    """Print a summary in lines under a title."""
    interfaces = ", ".join(f"{depth:g}" for depth in summary["boundaries_mm"]) or "none"
    state = "yes" if summary["converged"] else f"NO: {summary['status']}"
    rows = [
        ("depth", f"{summary['depth_mm']:g} mm"),
        ("deflection", f"{_format_length(summary['deflection_mm'])} mm, tip in the constraint frame"),
        ("tip", f"({', '.join(map(_format_length, summary['tip_mm']))}) mm in the world"),
        ("boundaries", interfaces + (" mm" if interfaces != "none" else "")),
        ("converged", f"{state} ({summary['iterations']} Newton iterations)"),
        ("valid", _describe_validity(summary)),
    ]
    if "replayed" in summary:
        rows.append(("replayed", _describe_replay(**summary["replayed"])))
    screen.print_line(title)
    if len(summary["steps"]) > 1:
        for n, step in enumerate(summary["steps"], start=1):
            screen.print_line(f"  {f'step {n}':<11} {_format_step(step)}")
    for label, text in rows:
        screen.print_line(f"  {label:<11} {text}")


def _describe_validity(summary: dict[str, Any]) -> str:
    """Return whether the needle keeps to what the model assumes."""
    if not summary["converged"]:
        return "NO: no solution"
    faults = summary["validity"]["faults"]
    return f"NO: {'; '.join(faults)}" if faults else f"yes (slopes up to {summary['max_slope']:.3f})"


def _describe_replay(steps: int, tip_offset_mm: float) -> str:
    text = f"{steps} step{'' if steps == 1 else 's'}, the tip "
    return text + (
        f"up to {tip_offset_mm:.1g} mm from where it was recorded"
        if tip_offset_mm
        else "as recorded, bit for bit"
    )


def _format_length(value: float) -> str:
    """Return a length in print; a dash where the needle was not found."""
    return f"{value:z.3f}" if math.isfinite(value) else "–"


def _format_step(step: dict[str, Any]) -> str:
    """Return a step in one line."""
    depth = f"{step['depth_mm']:g} mm deep"
    if not step["converged"]:
        return f"{depth}: {step['status'] if step['status'] == 'not reached' else 'NO: ' + step['status']}"
    x, y = step["tip_mm"]
    deflection, angle = step["deflection_mm"], step["tip_angle_deg"]
    return f"{depth}, deflection {deflection:z.3f} mm, tip ({x:z.3f}, {y:z.3f}) mm at {angle:z.2f}°"
