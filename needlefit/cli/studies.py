"""Commands that run studies: tune, validate, predict."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from needlefit.cli import options, screen
from needlefit.cli.execution import begin, require_no_faults, run_studies, show_json_of, show_result
from needlefit.cli.options import (
    argument,
    change_scene,
    name_changes,
    name_parameters,
    option,
    scene_record,
    split_pair,
    split_values,
)


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
        from needlefit.studies.load import load_target

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
        from needlefit.studies.load import load_study_file
        from needlefit.studies.run import name_source

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
            from needlefit.studies.fit_tables import lay_out_matrix
            from needlefit.studies.report import write_combined

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
    target: options.Target,
    scene: Annotated[
        str | None,
        option("The planned insertion: a name or a path (default: as the deepest fitted one).", "SCENE"),
    ] = None,
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
    """
    changes = set_ or []
    keys = [key for key, value in map(split_pair, changes) if value]
    with begin(context) as execution:
        from needlefit.inference.parameter_changes import load_changed_medium
        from needlefit.project.input_files import is_file
        from needlefit.project.locate import find_file
        from needlefit.project.toml import add_file_context
        from needlefit.schemas.names import require_file_name
        from needlefit.studies.kinds.prediction.run import POSTERIOR_FILE, describe_like_deepest, make_scene
        from needlefit.studies.load import load_target
        from needlefit.studies.run import RESULTS_FILE, name_source, restore_run

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
