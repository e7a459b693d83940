"""Predict a planned insertion from a fit: draws of its posterior, and what they make of a scene.

Draws that are not certified predict nothing: the median stays, marked, and the bands are left out.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from needlefit.errors import ConfigError
from needlefit.inference.fit import Callbacks, keep_start, read_starts
from needlefit.inference.optimize import minimize
from needlefit.inference.predict import Draws, thin_posterior
from needlefit.inference.sampling.posterior import load
from needlefit.project.checkpoint import NO_CHECKPOINT, Checkpoint, open_checkpoint
from needlefit.project.input_files import convert_stored_errors, is_file
from needlefit.project.json_values import to_json_values
from needlefit.project.random_streams import random_stream
from needlefit.project.result_warnings import ResultWarning, warnings_entry
from needlefit.project.run_file import read_run
from needlefit.project.unit_warnings import scene_warnings
from needlefit.studies.held_out_predictions import draw_fold_parameters
from needlefit.studies.interval_width import find_adaptation, warn_if_too_wide
from needlefit.studies.job import Job, Settings
from needlefit.studies.kinds.prediction.forecast import (
    SPECIMEN_COLUMNS,
    Forecast,
    forecast,
    make_scene,
    tabulate_forecast,
)
from needlefit.studies.kinds.prediction.schema import PredictionRecord
from needlefit.studies.new_specimens import NewSpecimens
from needlefit.studies.posterior_fit import PREDICTION_DRAWS
from needlefit.studies.provenance import describe_configuration
from needlefit.studies.run import Run, posterior_file_names
from needlefit.studies.targets import begin_run, prepare_target, target_name

FRAMES: Mapping[str, tuple[str, ...]] = {"specimens": SPECIMEN_COLUMNS}


def run(name: str, record: PredictionRecord, settings: Settings) -> Run:
    """Predict the planned insertion of a record.

    Raises
    ------
    ConfigError, DataError
        If anything the record names is missing or wrong, or its posterior is of something else.
    ModelError
        If no draw can be solved.
    """
    job = prepare_target(record, target_name(record, settings), settings)
    scene = make_scene(record.scene, record.scene_name, job.medium)
    scene_name = record.scene_name.rpartition("/")[2]
    title = record.scene.title or scene_name
    about = begin_run(name, record, job, f"Prediction: {title}")
    folder = None if record.posterior is None else Path(record.posterior)
    checkpoint = open_checkpoint(settings.checkpoint, settings.resume, about.run, settings.note)
    draws = draw_parameters(job, folder, settings, checkpoint)
    if draws is None:
        return replace(about, interrupted=True)
    (fold,) = job.folds
    known = record.specimen or ("new" if job.record.specimens == "others" else "training only")
    new = NewSpecimens(job, fold, draws.thetas.mean(axis=0)) if known == "new" else None
    found = forecast(scene, draws, job, new, known)
    frames = _make_frames(found, title, certified=not draws.faults)
    warned = [*job.warnings, *scene_warnings(record.scene, record.scene_name), *outside_warnings(found)]
    warned += warn_of_width(frames, find_adaptation(about.run["fit"]["dataset"], about.run["fit"]["medium"]))
    stored: Any = about.record
    named = {"scene_name": scene_name, "posterior": folder.name if folder else None}
    return replace(
        about,
        record=stored.model_copy(update=named),
        frames=frames,
        run={
            **about.run,
            "study": about.run["study"] | named,
            "draw_source": draws.source,
            "pareto_k": draws.pareto_k,
            "ess": draws.effective_sample_size,
            "draws": len(found.needle.means),
            "failed_solves": found.failed,
            "outside_validity": found.outside,
            "not_converged": list(draws.faults),
            **warnings_entry(warned),
        },
        faults=draws.faults,
    )


def _make_frames(found: Forecast, title: str, certified: bool) -> dict[str, pd.DataFrame]:
    """Return the tables of a run; the intervals of draws that are not certified are left out."""
    needle = tabulate_forecast(found)
    specimens = pd.DataFrame(found.specimens, columns=list(FRAMES["specimens"]))
    if not certified:
        needle.loc[:, needle.columns.str.contains("_low_|_high_")] = np.nan
        specimens["tip_95_width_mm"] = np.nan
    return {"forecast": needle.assign(scene=title, converged=certified), "specimens": specimens}


def outside_warnings(forecast: Forecast) -> Iterator[ResultWarning]:
    """Yield a warning where draws give needles outside the model's range of validity."""
    if forecast.outside:
        yield ResultWarning(
            "validity",
            f"{forecast.outside} of {len(forecast.needle.means)} predicted needles are outside what the "
            "model assumes (slopes, shortening, compression, rounding)",
            fix="read the bands with care; `needlefit simulate` of the scene names what is exceeded",
        )


def warn_of_width(frames: Mapping[str, pd.DataFrame], adaptation: str) -> Iterator[ResultWarning]:
    """Yield that the tip's interval is too wide for aiming, with what one insertion would gain.

    `adaptation` is the name of a study that measures it, or empty.
    """
    widths = frames["specimens"].set_index("specimen_treatment")["tip_95_width_mm"].dropna()
    fix = ""
    if "one insertion" in widths:
        study = f" (`needlefit validate {adaptation}`)" if adaptation else ""
        fix = (
            f"one measured insertion into this specimen would narrow it to {widths['one insertion']:.2g} mm "
            f"if the model is right there; a study of kind adaptation{study} measures the gain"
        )
    if len(widths):
        deflection = abs(float(frames["forecast"]["needle_median_mm"].iloc[-1]))
        yield from warn_if_too_wide(float(widths.iloc[0]), deflection, fix=fix)


(POSTERIOR_FILE,) = posterior_file_names(1)


_SEARCH = "fitted"


def draw_parameters(
    job: Job, run: Path | None, settings: Settings, checkpoint: Checkpoint = NO_CHECKPOINT
) -> Draws | None:
    """Return draws of the posterior stored in the folder `run`, or, if there is none, about a new fit.

    Returns
    -------
    Draws or None
        None after a stop.

    Raises
    ------
    ConfigError
        If the posterior is of other data or another configuration, or the folder holds none.
    """
    if settings.inputs.posterior is not None:
        return thin_posterior(settings.inputs.posterior, job.parameters, PREDICTION_DRAWS)
    if run is not None:
        return _draw_from_run(job, run)
    (fold,) = job.folds
    rng = random_stream(job.recipe.seed, fold.name, "fitted", "starts")
    callbacks = Callbacks(
        read_starts(checkpoint, _SEARCH),
        partial(keep_start, checkpoint, _SEARCH),
        settings.stop,
        jobs=settings.jobs,
        pool=settings.part_pool,
    )
    fit = minimize(job.problem(fold), job.recipe, rng, callbacks)
    if fit.interrupted:
        return None
    found, _ = draw_fold_parameters(job, fold, fit, None, settings)
    if settings.stop():
        return None
    return replace(found, faults=(*((fit.fault,) if fit.fault else ()), *found.faults))


def _draw_from_run(job: Job, run: Path) -> Draws:
    if not is_file(run / POSTERIOR_FILE):
        raise ConfigError(
            f"holds no {POSTERIOR_FILE}",
            where=str(run),
            expected="the folder of a run of one fold that was sampled",
            fix="sample it (`needlefit tune TARGET --sample`), or leave --run out",
        )
    require_same_configuration(job, read_run(run), str(run))
    with convert_stored_errors(run / POSTERIOR_FILE):
        return thin_posterior(load(run / POSTERIOR_FILE), job.parameters, PREDICTION_DRAWS)


def require_same_configuration(job: Job, recorded: Mapping[str, Any], where: str) -> None:
    """Raise ConfigError if what a run recorded is of other data or another configuration than `job`."""
    ours = describe_configuration(job)
    pairs = {key: (recorded.get(key), ours[key]) for key in ("dataset", "medium", "folds")}
    recipe = recorded.get("recipe")
    theirs = recipe.get("likelihood") if isinstance(recipe, dict) else None
    pairs["likelihood"] = (theirs, job.recipe.likelihood.model_dump(mode="json"))
    for key, (found, wanted) in pairs.items():
        if found != to_json_values(wanted):
            raise ConfigError(
                f"its posterior is of another {key}",
                where=where,
                expected=f"the {key} that {job.name} names now",
                fix="sample again (`needlefit tune TARGET --sample`), or name the right one with --run",
            )
