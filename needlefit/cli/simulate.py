"""`needlefit simulate`: one scene, or a recording of it; the needle's shape after each step."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated

import typer

from needlefit.cli import exit_codes, options, screen
from needlefit.cli.exit_codes import Invocation
from needlefit.cli.options import Depth, Set, complete_scenes, scene_record
from needlefit.cli.screen import print_warnings
from needlefit.cli.simulation_outcome import (
    SimulationOutcome,
    describe_outcome,
    replay_recording,
    show_summary,
    simulate_scene,
    summarize_simulation,
)
from needlefit.project.locate import find_file
from needlefit.project.outputs import require_output_files
from needlefit.project.result_warnings import WARNINGS_KEY, ResultWarning, to_rows


def simulate(
    context: typer.Context,
    scene: Annotated[
        str | None,
        typer.Argument(
            metavar="SCENE",
            autocompletion=complete_scenes,
            show_default=False,
            help="configs/scenes/<name>.toml or a path; none with --recording.",
        ),
    ] = None,
    depth: Depth = None,
    set_: Set = None,
    recording: Annotated[
        Path | None,
        typer.Option(metavar="LOG", help="Replay what `needlefit view` recorded: a CSV; no SCENE."),
    ] = None,
    step: Annotated[
        int | None, typer.Option(metavar="N", min=0, help="With --recording: stop after this step.")
    ] = None,
    strict: options.Strict = False,
    json: options.Json = False,
    plot: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Draw the needle: .png, .pdf or .svg.")
    ] = None,
    csv: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write the final shape: position (mm), slope, load (N/mm)."),
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
            help="Animate the insertion: .gif, or .mp4 (needs ffmpeg); a SCENE at 10 mm/s.",
        ),
    ] = None,
    html: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Of a recording: one HTML file that plays it without a server."),
    ] = None,
    verbose: options.Verbose = False,
) -> None:
    """Simulate a SCENE (a needle, layers, a bevel, and a depth or steps), or replay a recording of one.

    Deflection is the tip's y in the constraint frame (x along the entry, y to the left).
    """
    files = {"--plot": plot, "--csv": csv, "--slicer": slicer, "--animation": animation, "--html": html}
    written = {option: path for option, path in files.items() if path is not None}
    if recording is None:
        if scene is None:
            raise typer.BadParameter("give a SCENE, or a recording with --recording", param_hint="SCENE")
        if step is not None:
            raise typer.BadParameter(
                "counts the steps of a recording: it needs --recording", param_hint="--step"
            )
        if html is not None:
            raise typer.BadParameter("is of a recording: it needs --recording", param_hint="--html")
        require_output_files(written, [find_file("scene", scene)])
        where, record = scene_record(scene, depth, set_ or [])
        done = simulate_scene(scene, record, where)
    else:
        if scene is not None or depth is not None or set_:
            raise typer.BadParameter(
                "the recording contains its scene: leave out SCENE, --depth and --set",
                param_hint="--recording",
            )
        done = replay_recording(recording, step, written)
    # before anything is printed: a name may be none of a picture
    saved = [
        path for option, path in written.items() if done.files[option.removeprefix("--")](path) is not False
    ]
    _show(context.find_root().obj, done, saved, json)


def _show(invocation: Invocation, done: SimulationOutcome, saved: Sequence[Path], json: bool) -> None:
    """Print where the needle ends; leave with an exit code of its own where it was not found."""
    summary = summarize_simulation(done.scene, done.shapes, done.placement) | done.more
    warnings = [*done.warnings, *validity_warnings(summary["validity"]["faults"])]
    summary |= {WARNINGS_KEY: to_rows(warnings)}
    if json:
        screen.show_json(summary)
    else:
        screen.print_text(describe_outcome(summary))
    print_warnings(invocation, warnings)
    if not json:
        show_summary(done.title, summary)
    for path in saved:
        screen.print_note(f"written: {path}")
    if not summary["converged"]:
        steps = len(done.scene.steps)
        failed = f"step {len(done.shapes)} of {steps}" if steps > 1 else "the solution"
        screen.print_note(
            f"needlefit: {failed} did not converge ({summary['status']}); the printed values are no result"
        )
        raise typer.Exit(exit_codes.NOT_CONVERGED)


def validity_warnings(faults: Sequence[str]) -> Iterator[ResultWarning]:
    """Yield a warning where a solution is outside what the model assumes."""
    if faults:
        yield ResultWarning(
            "validity",
            f"the solution is outside what the model assumes: {'; '.join(faults)}",
            fix="check stiffness, bevel offset and depth",
        )
