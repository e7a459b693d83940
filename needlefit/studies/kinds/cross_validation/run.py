"""Run a study or a fit: fit to some insertions, score on others, each fold by every method."""

import math
import re
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from needlefit.inference.fit import MET_BY_PROFILE, Callbacks, Fit, Start, keep_start, read_starts
from needlefit.inference.identifiability.identify import (
    LOG_POSTERIOR_TOLERANCE,
    FitProfiles,
    profile_parameters,
)
from needlefit.inference.optimize import minimize
from needlefit.inference.problem import Problem
from needlefit.inference.sampling.sample import Snapshots, sample_from_fit
from needlefit.project.checkpoint import Checkpoint, open_checkpoint
from needlefit.project.input_files import read_toml
from needlefit.project.processes import one_thread
from needlefit.project.random_streams import random_stream
from needlefit.schemas.study import FitRecord, StudyRecord
from needlefit.studies import provenance
from needlefit.studies.fit_frames import COLUMNS as FRAMES
from needlefit.studies.fit_warnings import add_warnings
from needlefit.studies.folds import Fold
from needlefit.studies.held_out_predictions import draw_fold_parameters
from needlefit.studies.job import Job, Settings, prepare
from needlefit.studies.kinds.cross_validation.result_rows import (
    ResultRows,
    has_fit,
    record_failures,
    summarize_searches,
    tabulate_draws,
    tabulate_fold,
    tabulate_predictions,
)
from needlefit.studies.needles_in_scan import FoldFit, NeedleInScan, place_needles, tabulate_needles
from needlefit.studies.run import Run
from needlefit.studies.score import Scorer
from needlefit.studies.simulated_data import find_true_value
from needlefit.studies.summary import tabulate_design

__all__ = ["FRAMES", "Settings", "run"]


@one_thread
def run(name: str, record: FitRecord | StudyRecord, settings: Settings) -> Run:
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
        steps = _FoldSteps(job, fold, number, settings)
        fits = _run_searches(job, fold, steps, checkpoint)
        interrupted = any(fit.interrupted for fit in fits.values()) or len(fits) < len(job.searches)
        steps.report_searched()
        examination = None if interrupted else _examine(job, fold, fits, settings)
        if better := _move_to_better(job.problem(fold), fits, examination):
            fits["fitted"] = better
            examination = _examine(job, fold, fits, settings)
        interrupted = interrupted or settings.stop()
        if settings.sample and not interrupted:
            interrupted = _sample(job, fold, fits["fitted"], settings, checkpoint, tables)
        posterior, few = tables.posteriors.get(fold.name), None
        if has_fit(fits) and (fold.validate or not interrupted):
            few, many = draw_fold_parameters(job, fold, fits["fitted"], posterior, settings)
            tabulate_draws(job, fold, many, tables)
            if not few.faults:  # of what is not certified nothing is predicted
                tabulate_predictions(job, fold, few, np.array(fits["fitted"].theta), settings, tables)
        tabulate_fold(job, fold, fits, scorer, tables, examination, few)
        if has_fit(fits):
            known = FoldFit(fits["fitted"], tables.verdicts[fold.name], posterior)
            needles |= place_needles(job, fold, known, tables.bands, settings.jobs)
        if interrupted:
            break
    found = Run(
        kind="cross_validation" if isinstance(record, StudyRecord) else "fit",
        name=name,
        record=record,
        origin=job.dataset.origin,
        dataset_title=job.dataset.title or job.dataset.name,
        frames={
            **{frame: tables.frame(frame) for frame in FRAMES if frame not in ("design", "needles")},
            "design": tabulate_design(job),
            "needles": tabulate_needles(needles.values()),
        },
        posteriors=tables.posteriors,
        run=work | {"layers": _list_layers(job)} | _find_truth(job) | summarize_searches(tables, interrupted),
        timing={"seconds": time.time() - begin, "jobs": settings.jobs, "dataset": str(job.dataset.path)},
        interrupted=interrupted,
    )
    unconverged = {fold: posterior.faults for fold, posterior in tables.posteriors.items()}
    unconverged |= {fold: faults for fold, faults in tables.uncertified.items() if fold not in unconverged}
    faults = find_faults(found.frames["errors"], tables.search_faults, unconverged)
    found = replace(found, faults=faults)
    return add_warnings(found, job)


_TWIN_SOURCE = re.compile(r"needlefit twin build --seed (\d+)")


def _find_truth(job: Job) -> dict[str, dict[str, float]]:
    """Return the true parameters, where the data are our synthetic ones; nothing that fits knows them."""
    path = job.dataset.path / "dataset.toml" if job.dataset.path.is_dir() else job.dataset.path
    if job.dataset.origin != "synthetic" or len(job.folds) > 1 or not path.is_file():
        return {}
    built = _TWIN_SOURCE.fullmatch(str(read_toml(path).get("source", "")))
    if built is None:
        return {}
    known = {name: find_true_value(job, name, int(built[1])) for name in job.parameters.names}
    return {"truth": {name: value for name, value in known.items() if math.isfinite(value)}}


def _list_layers(job: Job) -> dict[str, list[list[float]]]:
    """Return by insertion the layers that it meets, each with the depth at which it begins, mm."""
    return {
        one.id: [list(pair) for pair in zip(one.sequence, (0.0, *one.boundaries.tolist()), strict=True)]
        for one in job.insertions
    }


Faults = Mapping[str, Sequence[str]]
"""By fold."""


def find_faults(errors: pd.DataFrame, search_faults: Faults, not_converged: Faults) -> tuple[str, ...]:
    """Return what did not converge: scored simulations of the fit, its search, a posterior."""
    fitted = errors[errors["method"] == "fitted"]
    failed = int((~fitted["converged"].astype(bool)).sum())
    faults = [f"{failed} of {len(fitted)} simulations of the fit did not converge"] if failed else []
    folds: dict[str, list[str]] = {}
    for fold, reasons in search_faults.items():
        for fault in reasons:
            folds.setdefault(fault, []).append(fold)
    faults += [
        fault if found == ["all"] else f"{', '.join(found)}: {fault}" for fault, found in folds.items()
    ]
    faults += [f"the posterior has not converged: {why}" for each in not_converged.values() for why in each]
    return tuple(faults)


@dataclass(frozen=True)
class _FoldSteps:
    """Where one fold lies among the steps of a run.

    The steps of a fold are its starts, and as many again as one search has for its posterior draws and
    predictions; their true share of the time varies, and differs little between folds.
    """

    job: Job
    fold: Fold
    number: int
    settings: Settings

    @property
    def label(self) -> str:
        """The run, and of several folds which one."""
        folds = len(self.job.folds)
        return (
            f"{self.job.name}: {self.fold.name} (fold {self.number + 1} of {folds})"
            if folds > 1
            else self.job.name
        )

    def report(self, what: str, done: int) -> None:
        """Report so many steps of this fold as done."""
        per_fold = (len(self.job.searches) + 1) * self.job.recipe.starts
        self.settings.progress(
            f"{self.label}: {what}", self.number * per_fold + done, len(self.job.folds) * per_fold
        )

    def report_searched(self) -> None:
        """Report that all searches of the fold are done."""
        self.report("posterior draws and predictions", len(self.job.searches) * self.job.recipe.starts)


def _run_searches(job: Job, fold: Fold, steps: _FoldSteps, checkpoint: Checkpoint) -> dict[str, Fit]:
    """Return the fit of everything free, by the metric too if asked, and of b alone about the paper's."""
    fits, settings = {}, steps.settings
    for order, search in enumerate(job.searches):
        if settings.stop():
            break
        key = f"{fold.name}/{search}"
        kept = read_starts(checkpoint, key)
        counter = _StartCounter(
            steps, search.replace("_", " "), order * job.recipe.starts + len(kept), key, checkpoint
        )
        callbacks = Callbacks(
            kept, counter.report, settings.stop, counter.approach, settings.jobs, settings.part_pool
        )
        rng = random_stream(job.recipe.seed, fold.name, search, "starts")
        fits[search] = minimize(job.problem(fold, search), job.recipe_of(search), rng, callbacks)
    return fits


@dataclass
class _StartCounter:
    """Keeps each finished start and says how far the run is."""

    steps: _FoldSteps
    search: str
    done: int
    key: str
    checkpoint: Checkpoint

    def approach(self, done: int, total: int) -> None:
        self.steps.report(f"{self.search}, approach {done} of {total}", self.done)

    def report(self, start: Start) -> None:
        keep_start(self.checkpoint, self.key, start)
        self.done += 1
        self.steps.report(self.search, self.done)


def _examine(job: Job, fold: Fold, fits: dict[str, Fit], settings: Settings) -> FitProfiles | None:
    """Return the profiles of the fit; many folds are scored, not examined."""
    if len(job.folds) > 1 or not math.isfinite(fits["fitted"].objective):
        return None
    return profile_parameters(
        job.problem(fold), fits["fitted"], settings.jobs, settings.stop, settings.part_pool
    )


def _move_to_better(problem: Problem, fits: Mapping[str, Fit], profiles: FitProfiles | None) -> Fit | None:
    """Return the fit at the best point that its profiles met, if that is better than all its starts."""
    if profiles is None or profiles.gain <= LOG_POSTERIOR_TOLERANCE:
        return None
    fit, theta, best = fits["fitted"], np.array(profiles.best), profiles.best
    objective = -problem.log_posterior(theta)
    if not objective < fit.objective:
        return None
    met = Start(len(fit.starts), best, best, objective, evaluations=0, failures=0, stopped=MET_BY_PROFILE)
    values = problem.values(theta)
    return replace(fit, theta=best, values=values, objective=objective, starts=(*fit.starts, met))


def _sample(
    job: Job, fold: Fold, fit: Fit, settings: Settings, checkpoint: Checkpoint, tables: ResultRows
) -> bool:
    """Sample the posterior of one fold; return whether it was interrupted."""

    def step(done: int, total: int) -> None:
        settings.progress(f"{job.name}: posterior", done, total)

    rng = random_stream(job.recipe.seed, fold.name, "posterior")
    callbacks = Callbacks(stop=settings.stop, step=step, jobs=settings.jobs)
    snapshots = Snapshots(checkpoint, fold.name)
    posterior = sample_from_fit(job.problem(fold), fit, job.recipe.sample, rng, callbacks, snapshots)
    if posterior is None:  # there is no posterior to write
        return True
    tables.posteriors[fold.name] = posterior
    record_failures(job, fold, posterior, tables)
    return posterior.interrupted
