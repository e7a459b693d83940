"""`needlefit predict`: where the needle of a planned insertion will be, and how sure that is."""

from pathlib import Path
from typing import Annotated

import typer

from needlefit.cli import failure, options, screen
from needlefit.cli.completion import scenes, targets
from needlefit.cli.execution import cores
from needlefit.cli.interruption import stopping
from needlefit.cli.progress import progress
from needlefit.cli.scene_options import Depth, Set, scene_record
from needlefit.cli.warn import warn
from needlefit.project.result_warnings import KEY, as_rows, stored


def predict(
    context: typer.Context,
    target: Annotated[
        str,
        typer.Argument(
            metavar="TARGET", autocompletion=targets, help="What was tuned: a study, a fit, or a path."
        ),
    ],
    scene: Annotated[
        str,
        typer.Option(
            "--scene", metavar="SCENE", autocompletion=scenes, help="The planned insertion: a name or a path."
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
    from draws of the TARGET's posterior: where one was sampled from that, else weighed about a fit made now.
    Prints tip and bands, and writes shape and picture to OUT/predict-TARGET-SCENE/.
    """
    invocation = context.find_root().obj
    with stopping() as stop:  # from here on, so that Ctrl-C never cuts an import in two
        from needlefit.cli.tune import fit_of, in_target
        from needlefit.mechanics.scene import Scene
        from needlefit.project.names import require_file_name
        from needlefit.project.ownership import require_replaceable
        from needlefit.project.unit_warnings import scene_warnings
        from needlefit.reporting.forecast import forecast_layout, tip, unconverged, write_forecast
        from needlefit.validation.forecast import forecast, outside_warnings
        from needlefit.validation.foreknown import foreknown
        from needlefit.validation.job import Settings, prepare
        from needlefit.validation.provenance import work

        where, planned = scene_record(scene, depth, set_ or [])
        name, record = fit_of(target)
        require_file_name(Path(scene).stem, scene)
        folder = out / f"predict-{name.removesuffix('-tune')}-{Path(scene).stem}"
        require_replaceable(folder)
        screen.compile_ahead("lanes", "sensitivity", quiet=invocation.quiet)
        with progress(invocation.quiet) as report:
            settings = Settings(seed=seed, jobs=jobs or cores(), progress=report, stop=stop)
            with in_target(target):
                job = prepare(name, record, settings)
            draws = foreknown(job, run or out / name, settings, required=run is not None)
        if draws is None:
            screen.note("needlefit: interrupted; nothing was written")
            raise typer.Exit(failure.INTERRUPTED)
        found = forecast(Scene.from_record(planned, where), draws, job)
        title, synthetic = planned.title or scene, job.dataset.origin == "synthetic"
        warned = [*job.warnings, *scene_warnings(planned, where), *outside_warnings(found)]
        said = {**work(job), "scene": planned.model_dump(mode="json", by_alias=True), **stored(warned)}
        write_forecast(found, folder, title, said, synthetic)
    if json:
        screen.show_json(
            {"target": name, "scene": scene, **tip(found), KEY: as_rows(warned), "written": str(folder)}
        )
    else:
        screen.show_display(forecast_layout(found, title, synthetic))
        screen.say(f"written: {folder}/")
    warn(invocation, warned)
    if found.faults:
        screen.note(f"needlefit: {name}: the posterior has {unconverged(found)}")
        raise typer.Exit(failure.NOT_CONVERGED)
