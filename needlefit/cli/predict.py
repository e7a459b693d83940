"""`needlefit predict`: the needle of a planned insertion, with its uncertainty."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from needlefit.cli import exit_codes, options, screen
from needlefit.cli.execution import Execution
from needlefit.cli.exit_codes import catch_interrupts
from needlefit.cli.options import Depth, Set, complete_scenes, complete_targets, list_set_keys, scene_record
from needlefit.cli.show_results import show_run, show_warnings
from needlefit.project.input_files import is_file

if TYPE_CHECKING:
    from needlefit.studies.run import Run


def predict(
    context: typer.Context,
    target: Annotated[
        str,
        typer.Argument(
            metavar="TARGET",
            autocompletion=complete_targets,
            help="What was tuned: a study, a fit, or a path.",
        ),
    ],
    scene: Annotated[
        str,
        typer.Option(
            "--scene",
            metavar="SCENE",
            autocompletion=complete_scenes,
            help="The planned insertion: a name or a path.",
        ),
    ],
    run: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Result of `tune TARGET --sample` (default: OUT/TARGET-tune)."),
    ] = None,
    specimen: Annotated[
        Literal["new", "same"] | None,
        typer.Option(
            help="new: into a specimen that was not fitted to; same: into one that was (default: new, with "
            "the spread between specimens unless the TARGET's `specimens` leaves it out).",
            show_default=False,
        ),
    ] = None,
    depth: Depth = None,
    set_: Set = None,
    seed: options.Seed = None,
    jobs: options.Jobs = None,
    out: options.Out = Path("reports"),
    resume: options.Resume = False,
    strict: options.Strict = False,
    explain: options.Explain = False,
    json: options.Json = False,
    quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Predict a planned insertion with the parameters fitted to a TARGET's data.

    The scene defines needle, depth, layer depths, bevel side and controls. Moduli and bevel offset are draws
    of the TARGET's posterior: the sampled posterior if there is one, else importance-weighted draws about a
    new fit. For a new specimen the spread between specimens is added. What the scene states of the rules must
    agree with the fit. Prints the tip with its intervals, and writes shape and figure to
    OUT/predict-TARGET-SCENE/.
    """
    with catch_interrupts(
        context.find_root().obj
    ) as stop:  # from here on, so that Ctrl-C never cuts an import in two
        from needlefit.project.toml_lines import add_file_context
        from needlefit.schemas.names import require_file_name
        from needlefit.studies.job import load_medium
        from needlefit.studies.kind import find_kind
        from needlefit.studies.kinds.prediction.forecast import make_scene
        from needlefit.studies.kinds.prediction.run import POSTERIOR_FILE
        from needlefit.studies.targets import load_target

        scene_name, planned = scene_record(scene, depth, set_ or [])
        target_name, fitted, file = load_target(target)
        with add_file_context(file):
            medium, _ = load_medium(fitted)
        make_scene(planned, scene_name, medium, list_set_keys(set_ or []))
        require_file_name(Path(scene).stem, scene)
        name = f"predict-{target_name.removesuffix('-tune')}-{Path(scene).stem}"
        execution = Execution(context.find_root().obj, out, seed, jobs, resume, stop)
        execution.prepare([name])
        if run is None and is_file(out / target_name / POSTERIOR_FILE):
            run = out / target_name
        record = find_kind("prediction").make_record(
            target=target,
            scene=planned,
            scene_name=scene_name,
            posterior=None if run is None else str(run),
            specimen=specimen,
        )
        found = execution.run_and_write(name, record)
        execution.remove_checkpoint(name)
    _show(execution, found, scene, json)
    if found.faults:
        from needlefit.studies.kinds.prediction.report import describe_faults

        screen.print_note(f"needlefit: {target_name}: {describe_faults(found)}")
        raise typer.Exit(exit_codes.NOT_CONVERGED)


def _show(execution: Execution, found: "Run", scene: str, json: bool) -> None:
    from needlefit.studies.report import run_to_json

    folder = execution.folder(found.name)
    if json:
        screen.show_json({**run_to_json(found), "scene": scene, "written": str(folder)})
        show_warnings(execution.invocation, found)
    else:
        show_run(execution.invocation, found, folder)
