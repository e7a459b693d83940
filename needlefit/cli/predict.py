"""`needlefit predict`: where the needle of a planned insertion will be, and how sure that is."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from needlefit.cli import failure, options, screen
from needlefit.cli.completion import scenes, targets
from needlefit.cli.execution import cores
from needlefit.cli.interruption import stopping
from needlefit.cli.progress import progress
from needlefit.cli.scene_options import Depth, Set, scene_record

if TYPE_CHECKING:
    from needlefit.inference.draws import Draws
    from needlefit.validation.job import Job, Settings

DRAWS = 400
"""Parameter sets that are simulated."""


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
    json: options.Json = False,
    quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Predict a planned insertion with what a TARGET's data tell.

    The scene says needle, depth, places of the layers, bevel side and controls; moduli and bevel offset come
    from draws of the TARGET's posterior, where one was sampled, else of a Gaussian about a fit made now.
    Prints tip and bands, and writes shape and picture to OUT/predict-TARGET-SCENE/.
    """
    invocation = context.find_root().obj
    with stopping() as stop:  # from here on, so that Ctrl-C never cuts an import in two
        from needlefit.cli.tune import fit_of
        from needlefit.mechanics.scene import Scene
        from needlefit.reporting.forecast import forecast_layout, tip, unconverged, write_forecast
        from needlefit.reporting.write import require_result
        from needlefit.validation.forecast import forecast
        from needlefit.validation.job import Settings, prepare
        from needlefit.validation.provenance import work

        where, planned = scene_record(scene, depth, set_ or [])
        name, record = fit_of(target)
        folder = out / f"predict-{name.removesuffix('-tune')}-{Path(scene).stem}"
        require_result(folder)
        screen.compile_ahead("lanes", "sensitivity", quiet=invocation.quiet)
        with progress(invocation.quiet) as report:
            settings = Settings(seed=seed, jobs=jobs or cores(), progress=report, stop=stop)
            job = prepare(name, record, settings)
            draws = _draws(job, run or out / name, settings)
        built = Scene.from_record(planned, where)
        found = forecast(built, draws, job.parameters, job.medium, job.dataset, settings.jobs)
        title, synthetic = planned.title or scene, job.dataset.origin == "synthetic"
        said = {**work(job), "scene": planned.model_dump(mode="json", by_alias=True)}
        write_forecast(found, folder, title, said, synthetic)
    if json:
        screen.show_json({"target": name, "scene": scene, **tip(found), "written": str(folder)})
    else:
        screen.show_display(forecast_layout(found, title, synthetic))
        screen.say(f"written: {folder}/")
    if found.faults:
        screen.note(f"needlefit: {name}: the posterior has {unconverged(found)}")
        raise typer.Exit(failure.NOT_CONVERGED)


def _draws(job: "Job", run: Path, settings: "Settings") -> "Draws":
    """Return draws of the posterior in `run`, or, where none was sampled, about a fit made now."""
    from needlefit.inference.draws import about_fit, from_posterior
    from needlefit.inference.identify import identify
    from needlefit.inference.optimize import minimize
    from needlefit.inference.posterior import load
    from needlefit.inference.starts import Watch
    from needlefit.project.streams import stream
    from needlefit.validation.forecast import require_same

    sampled = run / "posterior.nc"
    if sampled.is_file():
        require_same(job, run)
        return from_posterior(load(sampled), job.parameters, DRAWS)
    (fold,) = job.folds
    problem = job.problem(fold)
    rng = stream(job.recipe.seed, job.name, fold.name, "fitted", "starts")
    fit = minimize(problem, job.recipe, rng, Watch(stop=settings.stop, jobs=settings.jobs))
    chance = stream(job.recipe.seed, job.name, "predict")
    return about_fit(fit, identify(problem, fit), job.parameters, DRAWS, chance)
