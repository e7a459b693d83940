"""`needlefit predict`: where the needle of a planned insertion will be, and how sure that is."""

from pathlib import Path
from typing import Annotated

import typer

from needlefit.cli import exit_codes, options, screen
from needlefit.cli.execution import count_cores
from needlefit.cli.exit_codes import catch_interrupts
from needlefit.cli.options import Depth, Set, complete_scenes, complete_targets, scene_record
from needlefit.cli.progress import show_progress
from needlefit.cli.screen import print_warnings
from needlefit.project.result_warnings import WARNINGS_KEY, to_rows, warnings_entry


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
    depth: Depth = None,
    set_: Set = None,
    seed: options.Seed = None,
    jobs: options.Jobs = None,
    out: options.Out = Path("reports"),
    strict: options.Strict = False,
    json: options.Json = False,
    quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Predict a planned insertion with what a TARGET's data tell.

    The scene says needle, depth, places of the layers, bevel side and controls; moduli and bevel offset come
    from draws of the TARGET's posterior: where one was sampled from that, else importance-weighted about a
    fit made now. Prints tip and bands, and writes shape and picture to OUT/predict-TARGET-SCENE/.
    """
    invocation = context.find_root().obj
    with catch_interrupts() as stop:  # from here on, so that Ctrl-C never cuts an import in two
        from needlefit.cli.tune import add_target_context, load_fit
        from needlefit.mechanics.scene import Scene
        from needlefit.project.ownership import require_replaceable
        from needlefit.project.unit_warnings import scene_warnings
        from needlefit.reporting.forecast import (
            describe_convergence,
            lay_out_forecast,
            summarize_tip,
            write_forecast,
        )
        from needlefit.schemas.names import require_file_name
        from needlefit.validation.forecast import draw_parameters, forecast, outside_warnings
        from needlefit.validation.job import Settings, prepare
        from needlefit.validation.provenance import describe_configuration

        where, planned = scene_record(scene, depth, set_ or [])
        name, record = load_fit(target)
        require_file_name(Path(scene).stem, scene)
        folder = out / f"predict-{name.removesuffix('-tune')}-{Path(scene).stem}"
        require_replaceable(folder)
        screen.compile_ahead("lanes", "sensitivity", quiet=invocation.quiet)
        with show_progress(invocation.quiet) as report:
            settings = Settings(seed=seed, jobs=jobs or count_cores(), progress=report, stop=stop)
            with add_target_context(target):
                job = prepare(name, record, settings)
            draws = draw_parameters(job, run or out / name, settings, required=run is not None)
        if draws is None:
            screen.print_note("needlefit: interrupted; nothing was written")
            raise typer.Exit(exit_codes.INTERRUPTED)
        found = forecast(Scene.from_record(planned, where), draws, job)
        title, synthetic = planned.title or scene, job.dataset.origin == "synthetic"
        warned = [*job.warnings, *scene_warnings(planned, where), *outside_warnings(found)]
        run_table = {
            **describe_configuration(job),
            "scene": planned.model_dump(mode="json", by_alias=True),
            **warnings_entry(warned),
        }
        write_forecast(found, folder, title, run_table, synthetic)
    if json:
        screen.show_json(
            {
                "target": name,
                "scene": scene,
                **summarize_tip(found),
                WARNINGS_KEY: to_rows(warned),
                "written": str(folder),
            }
        )
    else:
        screen.show_display(lay_out_forecast(found, title, synthetic))
        screen.print_line(f"written: {folder}/")
    print_warnings(invocation, warned)
    if found.faults:
        screen.print_note(f"needlefit: {name}: the posterior has {describe_convergence(found)}")
        raise typer.Exit(exit_codes.NOT_CONVERGED)
