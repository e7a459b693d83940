"""`needlefit simulate`: one scene, or a recording of it; the needle's shape after each step."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated

import typer

from needlefit.cli import failure, options, screen
from needlefit.cli.completion import scenes
from needlefit.cli.invocation import Invocation
from needlefit.cli.scene_options import Depth, Set, scene_record
from needlefit.cli.show_simulation import show_summary, summary
from needlefit.cli.simulated import Simulated, of_recording, of_scene
from needlefit.cli.warn import warn
from needlefit.project.outputs import require_output_files
from needlefit.project.places import find
from needlefit.project.result_warnings import KEY, ResultWarning, as_rows


def simulate(
    context: typer.Context,
    scene: Annotated[
        str | None,
        typer.Argument(
            metavar="SCENE",
            autocompletion=scenes,
            show_default=False,
            help="configs/scenes/<name>.toml or a path; none with --inputs.",
        ),
    ] = None,
    depth: Depth = None,
    set_: Set = None,
    inputs: Annotated[
        Path | None,
        typer.Option(metavar="LOG", help="Replay what `needlefit view` recorded: a CSV; no SCENE."),
    ] = None,
    step: Annotated[
        int | None, typer.Option(metavar="N", min=0, help="Of a recording, stop after this step.")
    ] = None,
    strict: options.Strict = False,
    json: options.Json = False,
    plot: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Draw the needle: .png, .pdf or .svg.")
    ] = None,
    csv: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write the last shape: place, slope, load along it; mm and N/mm."),
    ] = None,
    slicer: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Write the needle for 3D Slicer: .mrk.json, a curve for every step, or .ply, a tube of the "
            "last. Scene coordinates are taken as LPS, in the plane z = 0; a recording of a measured "
            "insertion lies in its scan; mm.",
        ),
    ] = None,
    animation: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Draw the needle on its way: .gif, or .mp4 (needs ffmpeg); a SCENE at 10 mm/s.",
        ),
    ] = None,
    verbose: options.Verbose = False,
) -> None:
    """Simulate a SCENE (a needle, layers, a bevel, and a depth or steps), or replay a recording of one.

    Deflection is the tip's y in the constraint frame (x along the entry, y to the left).
    """
    files = {"--plot": plot, "--csv": csv, "--slicer": slicer, "--animation": animation}
    written = {option: path for option, path in files.items() if path is not None}
    if inputs is None:
        if scene is None:
            raise typer.BadParameter("give a SCENE, or a recording with --inputs", param_hint="SCENE")
        if step is not None:
            raise typer.BadParameter(
                "counts the steps of a recording: it needs --inputs", param_hint="--step"
            )
        require_output_files(written, [find("scene", scene)])
        where, record = scene_record(scene, depth, set_ or [])
        done = of_scene(scene, record, where)
    else:
        if scene is not None or depth is not None or set_:
            raise typer.BadParameter(
                "the recording holds its scene: leave out SCENE, --depth and --set", param_hint="--inputs"
            )
        done = of_recording(inputs, step, written)
    # before anything is printed: a name may be none of a picture
    for option, path in written.items():
        if done.files[option.removeprefix("--")](path) is not False:
            screen.note(f"{'drawn' if option == '--plot' else 'written'}: {path}")
    _show(context.find_root().obj, done, json)


def _show(invocation: Invocation, done: Simulated, json: bool) -> None:
    """Print where the needle ends; leave with an exit code of its own where it was not found."""
    answer = summary(done.scene, done.shapes, done.placement) | done.more
    warnings = [*done.warnings, *validity_warnings(answer["validity"]["faults"])]
    answer |= {KEY: as_rows(warnings)}
    if json:
        screen.show_json(answer)
    else:
        show_summary(done.title, answer)
    warn(invocation, warnings)
    if not answer["converged"]:
        steps = len(done.scene.steps)
        failed = f"step {len(done.shapes)} of {steps}" if steps > 1 else "the solution"
        screen.note(f"needlefit: {failed} did not converge ({answer['status']}); what it prints is no result")
        raise typer.Exit(failure.NOT_CONVERGED)


def validity_warnings(faults: Sequence[str]) -> Iterator[ResultWarning]:
    """Yield a warning where a solution is outside what the model assumes."""
    if faults:
        yield ResultWarning(
            "validity",
            f"the solution is outside what the model assumes: {'; '.join(faults)}",
            fix="check stiffness, bevel offset and depth",
        )
