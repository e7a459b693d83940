"""`needlefit simulate`: one scene, one shape."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from needlefit.cli import failure, options, screen
from needlefit.cli.completion import scenes
from needlefit.errors import ConfigError, ModelError

if TYPE_CHECKING:
    from needlefit.mechanics.scene import Scene
    from needlefit.mechanics.shape import NeedleShape
    from needlefit.project.records.scene import SceneRecord


STEEP = 0.3
"""Greatest slope |u'| at which small ones may be assumed: the curvature is then 14 % off."""


def simulate(
    scene: Annotated[
        str,
        typer.Argument(metavar="SCENE", autocompletion=scenes, help="configs/scenes/<name>.toml or a path."),
    ],
    depth: Annotated[
        float | None, typer.Option(metavar="MM", help="Inserted arc length; else the scene's.")
    ] = None,
    set_: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUE",
            help="Change a key of the scene, e.g. bevel.offset_mm=0.1; layers are numbered from 1: "
            "layers.1.mu_pa=3e5 is the first one. May be given again.",
        ),
    ] = None,
    json: options.Json = False,
    plot: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Draw the needle: .png, .pdf or .svg.")
    ] = None,
    verbose: options.Verbose = False,
) -> None:
    """Simulate a SCENE: a needle, layers, a bevel and a depth.

    Deflection is the tip's y in the constraint frame (x along the entry, y to the left).
    """
    where, record = _record(scene, depth, set_ or [])
    title = record.title or scene
    built, shape = _insert(record, where)
    answer = summary(built, shape)
    if plot is not None:  # before anything is printed: the name may be none of a picture
        from needlefit.reporting.figures.scene import draw_scene

        draw_scene(title, built, shape, plot)
        screen.note(f"drawn: {plot}")
    if json:
        screen.show_json(answer)
    else:
        _print(title, answer)
    if answer["max_slope"] > STEEP:
        screen.note(
            f"needlefit: warning: slopes reach {answer['max_slope']:.2f}: the model assumes small ones, "
            f"up to about {STEEP:g}"
        )
    if not shape.converged:
        screen.note(f"needlefit: the solution did not converge ({shape.status}); what it prints is no result")
        raise typer.Exit(failure.NOT_CONVERGED)


def summary(scene: "Scene", shape: "NeedleShape") -> dict[str, Any]:
    """Return what `--json` prints; lengths in mm."""
    from needlefit.mechanics.shape import positions

    tip = scene.entry.to_world(positions(shape, shape.x[-1:]))[0]
    return {
        "depth_mm": scene.depth,
        "deflection_mm": shape.deflection,
        "tip_slope": float(shape.slope[-1]),
        "max_slope": float(abs(shape.slope).max()),
        "tip_mm": tip,
        "boundaries_mm": scene.tissue.boundaries,
        "constraints_mm": shape.constraints,
        "converged": shape.converged,
        "status": shape.status,
        "iterations": shape.iterations,
    }


def _insert(record: "SceneRecord", where: str) -> tuple["Scene", "NeedleShape"]:
    """Simulate; what the model will not take is a fault of the scene, a solution not found is none."""
    from needlefit.mechanics.scene import Scene
    from needlefit.mechanics.simulate import simulate as insert

    screen.note_compiling()
    try:
        scene = Scene.from_record(record)
        shape = insert(scene.needle, scene.tissue, scene.bevel, scene.depth, scene.controls, scene.rules)
    except ModelError as error:
        raise ConfigError(error.what, where=where, expected=error.expected, mend=error.mend) from error
    return scene, shape


def _record(name: str, depth: float | None, assignments: list[str]) -> tuple[str, "SceneRecord"]:
    """Return where the scene stands and what it says, with what the options change."""
    pairs = [_pair(text) for text in assignments]
    if depth is not None:
        pairs.append(("depth_mm", repr(depth)))
    from needlefit.project.load import check, load, read_toml
    from needlefit.project.overrides import override
    from needlefit.project.places import find
    from needlefit.project.records.scene import SceneRecord

    path = find("scene", name)
    record = load(path, SceneRecord)
    if not pairs:
        return str(path), record
    where = f"{path}, changed by {', '.join(f'{key}={value}' for key, value in pairs)}"
    return where, check(override(read_toml(path), pairs, SceneRecord, str(path)), SceneRecord, where)


def _pair(text: str) -> tuple[str, str]:
    key, equals, value = text.partition("=")
    if not (key.strip() and equals and value.strip()):
        raise typer.BadParameter(f"`{text}` is not KEY=VALUE, e.g. bevel.offset_mm=0.1", param_hint="--set")
    return key.strip(), value.strip()


def _print(title: str, answer: dict[str, Any]) -> None:
    x, y = answer["tip_mm"]
    interfaces = ", ".join(f"{depth:g}" for depth in answer["boundaries_mm"]) or "none"
    state = "yes" if answer["converged"] else f"NO: {answer['status']}"
    rows = [
        ("depth", f"{answer['depth_mm']:g} mm"),
        ("deflection", f"{answer['deflection_mm']:.3f} mm, tip in the constraint frame"),
        ("tip", f"({x:.3f}, {y:.3f}) mm in the world"),
        ("boundaries", interfaces + (" mm" if interfaces != "none" else "")),
        ("converged", f"{state} ({answer['iterations']} Newton iterations)"),
    ]
    screen.say(title)
    for label, text in rows:
        screen.say(f"  {label:<11} {text}")
