"""Commands that run studies: tune, validate, predict."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from needlefit.cli import options, screen
from needlefit.cli.execution import begin, require_no_faults, run_studies, show_json_of, show_result
from needlefit.cli.options import (
    argument,
    change_scene,
    name_changes,
    name_parameters,
    option,
    read_numbers,
    scene_record,
    split_pair,
    split_values,
)

if TYPE_CHECKING:
    from needlefit.planning.prior_forecast import PriorForecast
    from needlefit.schemas.scene import SceneRecord


def tune(
    context: typer.Context,
    target: options.Target,
    design: Annotated[
        bool,
        option("Which parameters the design determines, before any measurement.", None, "--design"),
    ] = False,
    no_sample: Annotated[
        bool,
        option("Intervals by importance sampling alone, without MCMC.", None, "--no-sample"),
    ] = False,
    free: options.Free = None,
    fix: options.Fix = None,
) -> None:
    """Fit the parameters of a TARGET (mu, alpha, b).

    Prints each parameter with its 95 % interval, and which ones the data do not determine. The posterior is
    sampled by importance sampling, then by MCMC.

    With --design no measured shape is used: shapes are simulated with the paper's parameters or the middle of
    the bounds. Fisher information, profile likelihoods and posterior SD / prior SD go to OUT/TARGET-design/.

    An alpha that moves no measured point by a tenth of its noise is not searched: its posterior is its prior,
    and the table states by how much that moves the tips. --free alpha searches it nevertheless, --fix
    alpha1=1 holds it; both take any parameter.

    Results go to OUT/TARGET/ (default: ./reports); of a study only the fit is run, to OUT/STUDY-tune/. With
    --free or --fix the folder is named after these too: phantom1-free=alpha. The folder slicer/ holds every
    needle, measured and fitted with the 95 % band of the parameters, for 3D Slicer. Ctrl-C writes the best
    result so far, marked as interrupted, and prints the command that continues; a second Ctrl-C stops at
    once.
    """
    with begin(context) as execution:
        from needlefit.inference.parameter_changes import change_fit
        from needlefit.project.toml import add_file_context
        from needlefit.studies.job import StatedStudy
        from needlefit.studies.study_files import load_target

        fit = load_target(target)
        name, record, inputs, file, _ = fit
        if free or fix:
            values = split_values(fix or [])
            with add_file_context(file):
                record, medium = change_fit(record, inputs.medium, free or [], values, str(file))
            name, inputs = f"{name}{name_parameters(free or [], values)}", replace(inputs, medium=medium)
        if design:
            about = f"{name.removesuffix('-tune')}-design"
            execution.prepare_result(about, fit.sources)
            inputs = replace(inputs, target=(name, record))
            with add_file_context(file):
                identified = execution.run_kind("identification", about, inputs, target=target)
            show_result(execution, identified)
            return
        with add_file_context(file):
            execution.prepare_result(name, fit.sources, None if inputs.dataset else record)
            results = execution.run(StatedStudy(name, record, inputs), sample=not no_sample)
        if results.interrupted and "fitted" not in set(results.frames["errors"]["method"]):
            raise execution.interrupted()  # nothing found yet: an earlier result stays
        execution.write(results)
        show_result(execution, results)
        if results.interrupted:
            raise execution.interrupted()
        execution.remove_checkpoint(name)
    require_no_faults(f"{results.name}: {fault}" for fault in results.faults)


def validate(
    context: typer.Context,
    study: Annotated[
        str,
        argument(
            "STUDY",
            "study1 ... study5, all (those five), another, or a path.",
        ),
    ],
) -> None:
    """Run a STUDY, such as: fit some insertions, predict others.

    `all` runs the paper's five studies and the fits of its tuning tables. Results go to OUT/STUDY/
    (default: ./reports).

    Prints and writes tables, figures and a report, with the paper's numbers beside ours, and slicer/: every
    needle, measured and predicted with its 95 % band, for 3D Slicer.

    Ctrl-C saves what is finished and prints the command that continues; a second Ctrl-C stops at once.
    """
    with begin(context) as execution:
        from needlefit.project.locate import EVERY_STUDY, PAPER_FITS, find_file, find_studies
        from needlefit.project.toml import add_file_context, load
        from needlefit.schemas.study import FitRecord
        from needlefit.studies.job import StatedStudy
        from needlefit.studies.store import name_source
        from needlefit.studies.study_files import load_study_file

        combined = [study] if study == EVERY_STUDY else []
        files = dict(find_studies(study))
        todo = [StatedStudy(name, load_study_file(path), file=path) for name, path in files.items()]
        fits = {name: find_file("fit", name) for name in PAPER_FITS if combined}
        todo += [StatedStudy(name, load(path, FitRecord), file=path) for name, path in fits.items()]
        files |= fits
        execution.prepare([*files, *combined], files)
        for work in todo:
            with add_file_context(work.file):
                execution.prepare_result(work.name, [name_source(files[work.name])], work.record)
        runs = run_studies(execution, todo)
        if combined:
            from needlefit.studies.combined_report import write_combined
            from needlefit.studies.fit_tables import lay_out_matrix

            write_combined(runs, execution.folder(study))
            if not execution.invocation.json:
                screen.print_written(execution.folder(study))
                screen.print_line()
                studies = [run for run in runs if run.kind == "cross_validation"]
                screen.show_display(lay_out_matrix(studies), notes=False)
        execution.write_reference(runs)
        if execution.invocation.json:
            show_json_of(runs)
        for work in todo:  # not before all are done: a group is resumed as a whole
            execution.remove_checkpoint(work.name)
    require_no_faults(f"{run.name}: {fault}" for run in runs for fault in run.faults)


def predict(
    context: typer.Context,
    target: Annotated[
        str | None,
        argument("TARGET", "A study, a fit, a path, or the folder of a run; none with --medium."),
    ] = None,
    scene: Annotated[
        str | None,
        option("The planned insertion: a name or a path (default: as the deepest fitted one).", "SCENE"),
    ] = None,
    medium: Annotated[
        str | None,
        option(
            "Before any data: a tissue model, or published media, one for all layers or one for each: "
            "gelatine,liver.",
            "FILE|NAMES",
        ),
    ] = None,
    aim: Annotated[
        str | None,
        option("With --medium: target in the constraint frame, mm (default: median tip).", "X,Y[,Z]"),
    ] = None,
    radius: Annotated[
        float, option("With --medium: distance from it that counts as a hit.", "MM", min=0.01)
    ] = 2.0,
    pose_sd: Annotated[
        str,
        option("With --medium: standard deviations of entry point and direction, per axis.", "MM,DEGREES"),
    ] = "0.5,0.5",
    specimen: options.Specimen = None,
    depth: options.Depth = None,
    set_: options.Changes = None,
) -> None:
    """Predict a planned insertion with what was fitted to a TARGET.

    The scene defines needle, depth, layer depths, bevel side and controls. Moduli and bevel offset are draws
    of the TARGET's posterior: the sampled posterior if there is one, else importance-weighted draws about a
    new fit. For a new specimen the spread between specimens is added. What the scene states of the rules must
    agree with the fit. Repeats the verdict and failed checks of OUT/TARGET, prints the tip with its
    intervals, and writes shape and figure to OUT/predict-TARGET-SCENE/ (default: ./reports). With --depth,
    --set or --specimen the folder is named after these too: predict-study3-study3-depth_mm=60.

    With --medium and no TARGET: the spread of the tip before any data, the chance of a hit, and which
    parameter, or error of the entry pose, dominates.
    """
    changes = set_ or []
    keys = [key for key, value in map(split_pair, changes) if value]
    if medium is not None or target is None:
        if medium is None or target is not None or scene is None:
            raise typer.BadParameter("give a TARGET, or --medium with --scene", param_hint="TARGET")
        named_scene = scene_record(scene, depth, changes)
        _predict_before_data(context, named_scene, keys, medium, aim, radius, pose_sd)
        return
    with begin(context) as execution:
        from needlefit.inference.parameter_changes import load_changed_medium
        from needlefit.project.input_files import is_file
        from needlefit.project.locate import find_file
        from needlefit.project.toml import add_file_context
        from needlefit.schemas.names import require_file_name
        from needlefit.studies.kinds.prediction.run import POSTERIOR_FILE
        from needlefit.studies.kinds.prediction.scene import describe_like_deepest, make_scene
        from needlefit.studies.store import RESULTS_FILE, name_source, restore_run
        from needlefit.studies.study_files import load_target

        fit = load_target(target)
        target_name, fitted, inputs, file, run = fit
        with add_file_context(file):
            fitted_medium = inputs.medium or load_changed_medium(fitted)[0]
            like = describe_like_deepest(fitted, inputs, fitted_medium) if scene is None else None
        if like is not None:
            scene, table, source = like
            scene_name, planned = change_scene(table, scene, depth, changes)
        else:
            assert scene is not None
            scene_name, planned = scene_record(scene, depth, changes)
            source = find_file("scene", scene)
        make_scene(planned, scene_name, fitted_medium, keys)
        require_file_name(Path(scene).stem, scene)
        about = f"{target_name.removesuffix('-tune')}-{Path(scene).stem}"
        name = f"predict-{about}{name_changes(depth, changes, specimen)}"
        execution.prepare_result(name, [*fit.sources, name_source(source)])
        tuned = execution.folder(target_name) if run is None else file.parent
        judged = execution.folder(target_name.removesuffix("-tune"))
        if run is None and is_file(judged / RESULTS_FILE):
            run = restore_run(judged)
        predicted = execution.run_kind(
            "prediction",
            name,
            replace(inputs, judged=run),
            target=target,
            scene=planned,
            scene_name=scene_name,
            posterior=str(tuned) if is_file(tuned / POSTERIOR_FILE) else None,
            specimen=specimen,
        )
    show_result(execution, predicted, {"scene": scene, "written": str(execution.folder(name))})
    require_no_faults(f"{target_name}: {fault}" for fault in predicted.faults)


# ---- `predict --medium`: the tip of a planned insertion before any data, by priors alone

_POSE_ERRORS = {"pose_shift_mm": "place of the entry", "pose_angle_deg": "direction at the entry"}
MIN_SHOWN_SHARE = 0.005  # smallest share of the tip's variance of a parameter that is listed


def _predict_before_data(
    context: typer.Context,
    scene: "tuple[str, SceneRecord]",
    changed: Sequence[str],
    medium: str,
    aim: str | None,
    radius: float,
    pose_sds: str,
) -> None:
    """Print where the tip of a scene will be by draws from the priors of a tissue model, or published moduli.

    `scene`: what messages call it, and its keys, of which the user `changed` some.
    """
    from needlefit.mechanics.published import read_moduli
    from needlefit.planning.prior_forecast import describe_published, forecast_by_prior, list_published
    from needlefit.project.locate import is_path, list_names, unknown_name_error
    from needlefit.project.toml import find_named, load
    from needlefit.schemas.medium import MediumRecord
    from needlefit.studies.kinds.prediction.scene import make_scene

    name, planned = scene
    if published := list_published(medium):
        model = describe_published(published, len(planned.layers), planned.rules.advance)
    elif is_path(medium) or medium in (media := list_names("medium")):
        model = load(find_named("medium", medium), MediumRecord)
    else:
        raise unknown_name_error("medium", medium, [*media, *read_moduli()])
    target = None if aim is None else read_numbers(aim, (2, 3), "--aim", "X,Y or X,Y,Z")
    shift, angle = map(abs, read_numbers(pose_sds, (2, 2), "--pose-sd", "SHIFT,DEGREES"))
    planned_scene = make_scene(planned, name, model, changed)
    forecast = forecast_by_prior(
        planned_scene, model, radius, target, context.find_root().obj.seed or 1, (shift, angle)
    )
    if context.find_root().obj.json:
        sources = [source._asdict() for source in published]
        screen.show_json(
            {"scene": name, "medium": medium, **_summarize_forecast(forecast, radius), "sources": sources}
        )
        return
    _show_forecast(forecast, radius, "median tip" if target is None else "target")
    for source in published:
        screen.print_text(
            f"{source.name}: {source.quantity} {source.low:g} to {source.high:g} kPa ({source.source})."
        )
    if published:
        screen.print_text("A fitted μ may differ: it is no material constant.")


def _summarize_forecast(forecast: "PriorForecast", radius: float) -> dict[str, object]:
    ends = ("median", "low", "high")
    return {
        **{
            f"tip_{axis}_mm": dict(zip(ends, forecast.interval(n), strict=True))
            for n, axis in enumerate("xyz")
        },
        "target_mm": forecast.target.tolist(),
        "radius_mm": radius,
        "hits": forecast.hits,
        "parameters": [
            {
                "parameter": name,
                "low": forecast.priors[name][0],
                "high": forecast.priors[name][1],
                "share": share,
            }
            for name, share in forecast.shares.items()
        ],
        "draws": len(forecast.tips),
        "failed": forecast.failed,
        "outside_validity": forecast.outside,
    }


def _show_forecast(forecast: "PriorForecast", radius: float, aim: str) -> None:
    """Print the tip, the chance of a hit, and the parameters that matter."""
    import pandas as pd

    from needlefit.reporting.number_format import format_bare_symbol, format_quantity_range

    places = []
    for axis, (median, low, high) in (("y", forecast.interval(1)), ("z", forecast.interval(2))):
        if axis == "y" or high > low:
            places.append(f"{axis} = {median:z.2f} mm (95 % interval {low:z.2f} to {high:z.2f} mm)")
    first, most = next(iter(forecast.shares.items()))
    subject = f"The {_POSE_ERRORS[first]}" if first in _POSE_ERRORS else format_bare_symbol(first)
    names = {name: _POSE_ERRORS.get(name) or format_bare_symbol(name) for name in forecast.shares}
    screen.print_text(
        f"Before any data the tip is predicted at {', '.join(places)}. It ends within {radius:g} mm of the "
        f"{aim} in {100 * forecast.hits:.0f} % of {len(forecast.tips)} draws. {subject} "
        f"dominates: {100 * most:.0f} % of the variance of the tip."
    )
    rows = [
        {
            "parameter": names[name],
            "95 % of its prior": format_quantity_range(name, *forecast.priors[name]),
            "part of the variance": f"{100 * share:.0f} %",
        }
        for name, share in forecast.shares.items()
        if share >= MIN_SHOWN_SHARE
    ]
    screen.show_frame(pd.DataFrame(rows), "")
    if forecast.failed or forecast.outside:
        outside = f"{forecast.outside} needles are outside what the model assumes"
        screen.print_text(f"{forecast.failed} draws cannot be solved; {outside}.")
