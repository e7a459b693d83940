"""A prediction in four steps: what is known of the fit, draws of its parameters, the needle, its warnings."""

import shlex
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from needlefit.inference.identifiability.precision import find_model_error
from needlefit.inference.identifiability.profile import minimize_squares
from needlefit.inference.predict import Draws, thin_posterior
from needlefit.project.checkpoint import NO_CHECKPOINT, Checkpoint, open_checkpoint
from needlefit.project.progress import no_note
from needlefit.project.result_warnings import ResultWarning, to_stored_rows
from needlefit.project.unit_warnings import extrapolation_warnings, scene_warnings
from needlefit.schemas.run_metadata import PredictionMetadata
from needlefit.studies.advice import advise
from needlefit.studies.answer import RunFault, find_fault_kind
from needlefit.studies.explorer import choose_drawn
from needlefit.studies.fit_warnings import describe_point, write_warning
from needlefit.studies.fold_draws import (
    PREDICTION_DRAWS,
    Specimens,
    choose_specimen,
    draw_fold_parameters,
    measure_prior,
    search_fit,
)
from needlefit.studies.identification import ParameterRow, add_intervals, intervals_of_draws
from needlefit.studies.identity import describe_change, identify
from needlefit.studies.job import Inputs, Job, Settings
from needlefit.studies.kinds.prediction import PredictionRecord
from needlefit.studies.kinds.prediction.forecast import forecast, tabulate_forecast
from needlefit.studies.kinds.prediction.scene import make_scene, require_fitted_kind
from needlefit.studies.report import find_report, recall
from needlefit.studies.run import Run
from needlefit.studies.store import posterior_file_names, restore_run
from needlefit.studies.study_files import begin_run, is_study, prepare_target, prepare_with_held_out

(POSTERIOR_FILE,) = posterior_file_names(1)

#: advice on a fit with which it may be used all the same
MAY_BE_USED = ("predictable", "parameters_undetermined")

FRAMES: Mapping[str, tuple[str, ...]] = {
    "parameters": ParameterRow._fields,  # of the fit
    # a row per point: arc length from the entry, depth along the entry axis, y of the needle, ends of its
    # pointwise intervals ("needle") and of simultaneous bands ("band")
    "forecast": (
        *("s_mm", "x_mm", "needle_predicted_mm"),
        *(
            f"{part}_{level}_{end}_mm"
            for part in ("needle", "band")
            for level in ("50", "95")
            for end in ("low", "high")
        ),
    ),
}


def draw_parameters(
    job: Job, run: Run | None, settings: Settings, checkpoint: Checkpoint = NO_CHECKPOINT
) -> Draws | None:
    """Return draws of the posterior of a run of this fit, or without one about a new fit.

    None after a stop.
    """
    posterior = settings.inputs.posterior if run is None else run.posterior
    (fold,) = job.folds
    if posterior is not None:  # whose mode is the minimum to which its best draw leads
        best = dict(zip(posterior.names, posterior.best.tolist(), strict=True))
        begin = job.parameters.restrict(job.parameters.theta(best))
        mode = job.parameters.extend(minimize_squares(job.problem(fold).searched, begin).theta)
        return replace(thin_posterior(posterior, job.parameters, PREDICTION_DRAWS), mode=mode)
    fit = search_fit(job, fold, "fitted", settings, checkpoint)
    if fit.interrupted:
        return None
    draws = draw_fold_parameters(job, fold, fit, settings).draws
    # without a search that has converged nothing is certified
    judged = replace(draws, faults=(fit.fault, *draws.faults)) if fit.fault else draws
    return None if settings.stop() else judged


class _Known(NamedTuple):
    """What earlier results give to a prediction: a posterior, a verdict; warnings about what is not used."""

    sampled: Run | None
    judged: Run | None
    warnings: list[ResultWarning]


def _find_known(record: PredictionRecord, job: Job, settings: Settings) -> _Known:
    """Return the results of the fit; those of another one, or of earlier versions, are not used."""
    inputs, run_warnings = settings.inputs, list[ResultWarning]()
    if inputs.target is not None:  # a run, from which the job was made
        return _Known(None, inputs.judged, run_warnings)
    sampled = None if record.posterior is None else restore_run(Path(record.posterior))
    if sampled is not None and (changed := describe_change(sampled.metadata.identity, identify(job))):
        problem = f"the posterior of {sampled.name} is not used; changed since: {changed}"
        run_warnings.append(_warn("tune", record.target, problem))
        sampled = None
    if (judged := inputs.judged) is None:
        return _Known(sampled, sampled, run_warnings)
    quiet = replace(settings, note=no_note, inputs=Inputs(dataset=job.measured))
    study = prepare_with_held_out(record, job.name, quiet)
    if changed := describe_change(judged.metadata.identity, identify(study)):
        problem = f"the verdict of {judged.name} is not repeated; changed since: {changed}"
        command = "validate" if judged.kind == "cross_validation" else "tune"
        run_warnings.append(_warn(command, record.target, problem))
        judged = None
    return _Known(sampled, judged, run_warnings)


def _warn(command: str, target: str, problem: str) -> ResultWarning:
    return ResultWarning(
        "data_changed", problem, fix=f"renew it: {shlex.join(('needlefit', command, target))}"
    )


def list_parameters(job: Job, draws: Draws, mode: Mapping[str, float], judged: Run | None) -> pd.DataFrame:
    """Return the parameters and their 95 % intervals: of an earlier result of this fit, else of the draws."""
    if judged is not None and judged.frames["parameters"]["fold"].nunique() == 1:
        return judged.frames["parameters"][list(ParameterRow._fields)]
    parameters, (fold,) = job.parameters, job.folds
    rows = [
        ParameterRow(
            fold.name, "fitted", name, value, parameters.status[name], *parameters.bounds.get(name, ())
        )
        for name, value in mode.items()
    ]
    problem = job.problem(fold).searched
    model_error = find_model_error(problem, problem.parameters.theta(mode))
    intervals = intervals_of_draws(parameters, draws, None)
    rows, _ = add_intervals(rows, [], intervals, parameters.ties, {}, model_error)
    return pd.DataFrame(rows, columns=list(ParameterRow._fields))


def run(name: str, record: PredictionRecord, settings: Settings) -> Run:
    """Predict the planned insertion of a record.

    Raises ConfigError or DataError if anything the record names is missing or wrong, or its posterior is of
    something else. ModelError if no draw can be solved.
    """
    job = prepare_target(record, settings)
    scene = make_scene(record.scene, record.scene_name, job.medium)
    scene_name = record.scene_name.rpartition("/")[2]
    title = record.scene.title or scene_name
    specimens = Specimens(job, job.folds[0], jobs=settings.jobs)
    where = record.specimen or ("new" if job.record.specimens == "others" else "training only")
    if record.specimen is None and job.record.same_specimen and not specimens.separate:
        where = "same"
    into = choose_specimen(specimens, where)
    about = begin_run(name, record, job, f"Prediction: {title}")
    require_fitted_kind(scene, job)
    sampled, judged, changed = _find_known(record, job, settings)
    checkpoint = open_checkpoint(settings.checkpoint, settings.resume, about.metadata.work, settings.note)
    for change in changed:
        settings.note(f"warning: {change} ({change.help_command})")  # before the work, which takes long
    fitted = draw_parameters(job, sampled, settings, checkpoint)
    if fitted is None:
        return replace(about, interrupted=True)
    if shifts := measure_prior(job, job.folds[0], fitted.thetas):
        job = job.holding([held for held, shift in shifts.items() if shift.is_hidden])
    specimens = replace(specimens, job=job, draws=fitted)
    draws = specimens.draws_in(into)
    forecasted = forecast(scene, specimens, into)
    needle = tabulate_forecast(forecasted).assign(scene=title, converged=not draws.faults)
    warned = [*job.warnings, *changed, *scene_warnings(record.scene, record.scene_name)]
    if forecasted.outside:
        share = f"{forecasted.outside} of {len(forecasted.across)} predicted needles"
        problem = f"{share} are outside what the model assumes (slopes, shortening, compression)"
        warned.append(ResultWarning("validity", problem, fix="read its intervals with care"))
    depths = [insertion.depth for insertion in job.folds[0].tune]
    z_unfitted = forecasted.across.shape[2] > job.dataset.directions
    warned += extrapolation_warnings(scene.depth, depths, z_unfitted=z_unfitted)
    chosen = describe_point(forecasted.point, job.parameters)
    if forecasted.point.is_median:
        warned.append(write_warning("predictive_median", {**chosen, "text": "median_of_scene"}))
    if draws.faults:
        needle.loc[:, needle.columns.str.contains("_low_|_high_")] = np.nan
    stored: Any = about.record
    named = {"scene_name": scene_name, "posterior": record.posterior and Path(record.posterior).name}
    return replace(
        about,
        record=stored.model_copy(update=named),
        frames={
            "forecast": needle,
            "parameters": list_parameters(
                job, specimens.replace_mean(fitted), forecasted.mode, sampled or judged
            ),
        },
        metadata=about.metadata.extend(
            PredictionMetadata,
            study=about.metadata.study | named,
            draw_source=draws.source,
            pareto_k=draws.pareto_k,
            ess=draws.effective_sample_size,
            draws=len(forecasted.across),
            specimen="others" if into is None else where,
            fit_verdict=None if judged is None else recall(judged),
            fit_run=None if judged is None else judged.name,
            fit_changed=changed[-1].what if changed else "",
            fit_advice=None if judged is None else _recall_advice(judged),
            held_out_by_target=settings.inputs.target is None and is_study(record.target),
            failed_solves=forecasted.failed,
            outside_validity=forecasted.outside,
            not_converged=list(draws.faults),
            mode=dict(forecasted.mode),
            nearest=forecasted.nearest and dict(forecasted.nearest),
            **chosen,
            drawn=None if draws.faults else choose_drawn(forecasted.sets),
            warnings=to_stored_rows(warned),
        ),
        faults=tuple(RunFault(find_fault_kind(draws), words) for words in draws.faults),
    )


def _recall_advice(judged: Run) -> dict[str, Any] | None:
    """Return what a fit needs before its predictions are used; None if it may be used."""
    advice = find_report(judged).first_page(judged).advice
    if advice is None or advice.finding in MAY_BE_USED:
        advice = advise(["fit_untested"], {}) if judged.kind == "fit" else None
    return None if advice is None else asdict(advice)
