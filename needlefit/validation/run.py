"""Run a study or a fit: fit to some insertions, score on others, each fold by every method."""

import math
import time
from dataclasses import dataclass

import numpy as np

from needlefit.errors import FitError
from needlefit.inference.fit import Callbacks, Fit, Start
from needlefit.inference.identifiability.identify import select_within_tolerance
from needlefit.inference.identifiability.parameter_profiles import FitProfiles, profile_parameters
from needlefit.inference.optimize import minimize
from needlefit.inference.sampling.sample import sample
from needlefit.project.random_streams import random_stream
from needlefit.project.threads import one_thread
from needlefit.schemas.study import FitRecord, StudyRecord
from needlefit.validation import provenance
from needlefit.validation.checkpoint import Checkpoint, open_checkpoint
from needlefit.validation.fit_warnings import add_warnings
from needlefit.validation.folds import Fold
from needlefit.validation.held_out_predictions import draw_fold_parameters, predict_held_out
from needlefit.validation.job import Job, Settings, prepare
from needlefit.validation.needles_in_scan import FoldFit, NeedleInScan, place_needles
from needlefit.validation.result_rows import (
    ResultRows,
    tabulate_draws,
    tabulate_fold,
    tabulate_posterior,
    tabulate_predictions,
)
from needlefit.validation.results import COLUMNS, Results
from needlefit.validation.score import Scorer
from needlefit.validation.summary import tabulate_design

__all__ = ["Settings", "run"]


@one_thread
def run(name: str, record: FitRecord | StudyRecord, settings: Settings) -> Results:
    """Run a study, or a fit, which is a study that scores only its own insertions.

    The same record, data, seed and versions give the same frames for any number of jobs, and after an
    interruption with `resume`.

    Raises
    ------
    ConfigError, DataError
        If anything the record names is missing or wrong.
    FitError
        If a search finds no point that can be solved.
    """
    begin = time.time()
    job = prepare(name, record, settings)
    work = provenance.describe_configuration(job)
    checkpoint = open_checkpoint(settings.checkpoint, settings.resume, work, settings.note)
    floors = {insertion.id: job.floor(insertion) for insertion in job.insertions}
    tables, interrupted = ResultRows(job.parameters.names), False
    scorer = Scorer(job.dataset, job.record.layer_count_rule, floors, tables.counts)
    needles: dict[str, NeedleInScan] = {}
    for number, fold in enumerate(job.folds):
        fits = _run_searches(job, fold, number, settings, checkpoint)
        interrupted = any(fit.interrupted for fit in fits.values()) or len(fits) < len(job.searches)
        examination = None if interrupted else _examine(job, fold, fits, settings)
        interrupted = interrupted or settings.stop()
        tabulate_fold(job, fold, fits, scorer, tables, examination)
        if settings.sample and not interrupted:
            interrupted = _sample(job, fold, fits["fitted"], settings, checkpoint, tables)
        if fold.name in tables.verdicts:
            known = FoldFit(fits["fitted"], tables.verdicts[fold.name], tables.posteriors.get(fold.name))
            needles |= place_needles(job, fold, known, settings.jobs)
            if fold.validate or not interrupted:
                few, many = draw_fold_parameters(job, fold, known, settings.jobs)
                tabulate_draws(job, fold, many, tables)
                tabulate_predictions(predict_held_out(job, fold, few), tables)
        if interrupted:
            break
    found = Results(
        name=name,
        title=record.title or name,
        question=record.question if isinstance(record, StudyRecord) else "",
        record=record,
        origin=job.dataset.origin,
        dataset_title=job.dataset.title or job.dataset.name,
        design=tabulate_design(job),
        **{frame: tables.frame(frame) for frame in COLUMNS if frame != "design"},
        posteriors=tables.posteriors,
        needles=needles,
        run={**work, **provenance.summarize_searches(tables, interrupted)},
        timing={"seconds": time.time() - begin, "jobs": settings.jobs, "dataset": str(job.dataset.path)},
        interrupted=interrupted,
    )
    return add_warnings(found, job)


def _run_searches(
    job: Job, fold: Fold, number: int, settings: Settings, checkpoint: Checkpoint
) -> dict[str, Fit]:
    """Return the fit of everything free, by the metric too if asked, and of b alone about the paper's."""
    fits = {}
    total = len(job.folds) * len(job.searches) * job.recipe.starts
    for order, search in enumerate(job.searches):
        if settings.stop():
            break
        done = (number * len(job.searches) + order) * job.recipe.starts
        label = f"{job.name}: {search.replace('_', ' ')}" + (f" {fold.name}" if len(job.folds) > 1 else "")
        key = f"{fold.name}/{search}"
        kept = checkpoint.finished(key)
        counter = _StartCounter(settings, label, done + len(kept), total, key, checkpoint)
        callbacks = Callbacks(kept, counter.report, settings.stop, counter.approach, settings.jobs)
        rng = random_stream(job.recipe.seed, job.name, fold.name, search, "starts")
        fits[search] = minimize(job.problem(fold, search), job.recipe_of(search), rng, callbacks)
    return fits


@dataclass
class _StartCounter:
    """Keeps each finished start and says how far the run is."""

    settings: Settings
    label: str
    done: int
    total: int
    key: str
    checkpoint: Checkpoint

    def approach(self, done: int, total: int) -> None:
        self.settings.progress(f"{self.label}: approach", done, total)

    def report(self, start: Start) -> None:
        self.checkpoint.keep(self.key, start)
        self.done += 1
        self.settings.progress(self.label, self.done, self.total)


def _examine(job: Job, fold: Fold, fits: dict[str, Fit], settings: Settings) -> FitProfiles | None:
    """Return the profiles of the fit; many folds are scored, not examined."""
    if len(job.folds) > 1 or not math.isfinite(fits["fitted"].objective):
        return None
    settings.progress(f"{job.name}: profiles", 0, 1)
    return profile_parameters(job.problem(fold), fits["fitted"], settings.jobs, settings.stop)


def _sample(
    job: Job, fold: Fold, fit: Fit, settings: Settings, checkpoint: Checkpoint, tables: ResultRows
) -> bool:
    """Sample the posterior of one fold; return whether it was interrupted."""

    def step(done: int, total: int) -> None:
        settings.progress(f"{job.name}: posterior", done, total)

    rng = random_stream(job.recipe.seed, job.name, fold.name, "posterior")
    callbacks = Callbacks(stop=settings.stop, step=step, jobs=settings.jobs)
    others = [start.theta for start in select_within_tolerance(fit) if start.theta != fit.theta]
    ends = np.array([fit.theta, *others])
    snapshots = checkpoint.snapshots(fold.name)
    try:
        posterior = sample(job.problem(fold), ends, job.recipe.sample, rng, callbacks, snapshots)
    except FitError:
        if settings.stop():  # before there is anything to keep: there is no posterior to write
            return True
        raise
    tabulate_posterior(job, fold, posterior, tables)
    return posterior.interrupted
