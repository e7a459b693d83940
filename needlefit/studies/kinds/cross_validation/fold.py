"""Run one fold: fit to its insertions, draw parameters, predict and score the insertions that it holds out.

The result depends on the job and the fold alone, so that folds may run beside each other. What they use
besides (`FoldServices`) keeps finished work and shows progress.
"""

import math
import os
import pickle
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from needlefit.datasets.folds import Fold
from needlefit.datasets.insertion import Insertion
from needlefit.inference.doubts import examine_depths
from needlefit.inference.draws import Draws
from needlefit.inference.error_fit import ErrorMinimisingFit, examine_errors
from needlefit.inference.fit import MET_BY_PROFILE, Callbacks, Fit, Start
from needlefit.inference.identifiability.fit_profiles import FitProfiles, profile_parameters
from needlefit.inference.identifiability.verdict import LOG_POSTERIOR_TOLERANCE, identify
from needlefit.inference.likelihood.compared_points import Curve
from needlefit.inference.prior_shift import PriorShift
from needlefit.inference.problem import Problem
from needlefit.inference.sampling.posterior import Posterior
from needlefit.project.callbacks import Progress, no_progress
from needlefit.project.checkpoint import Checkpoint
from needlefit.project.copies import compute_beside
from needlefit.project.tasks import stop_requested
from needlefit.reporting.number_format import format_bare_symbol, format_quantity
from needlefit.reporting.table_files import Row
from needlefit.schemas.run_metadata import CountMetadata
from needlefit.studies.first_page import RunFault, find_fault_kind
from needlefit.studies.fit_warnings import MOSTLY_OUTSIDE, add_counts, describe_point
from needlefit.studies.fold_draws import Specimens, draw_fold_parameters, measure_prior, search_fit
from needlefit.studies.identification import (
    IDENTIFICATION_COLUMNS,
    ParameterRow,
    add_intervals,
    identify_parameters,
    intervals_of_draws,
    list_held,
    reconcile_verdict,
)
from needlefit.studies.job import Job, Settings
from needlefit.studies.kinds.cross_validation.rows import (
    describe_error_fit,
    list_directions,
    list_error_fit,
    list_fitted,
    list_published,
    make_start_row,
)
from needlefit.studies.needle_placement import FittedDraws, place_needles, simulate_fitted_draws
from needlefit.studies.observations import STUDIED, HeldOutPrediction, Tables, find_studied, predict_held_out
from needlefit.studies.run import PREDICTION_METHOD, TUNED_SPECIMENS
from needlefit.studies.score import make_predictors, make_scorer, predict_needle

FitRows = dict[str, Sequence[Any]]  #: rows by the name of the table that they belong to
#: tables of what is scored and predicted, and the simulations outside what the model assumes
SCORED_TABLES = ("errors", "shapes", "outside", "predictive", "bands", "readings", "ends", "curvature")


SEARCH_PHASES = {
    "fitted": "search for the best fit",
    "fitted_metric": "search for the smallest errors",
    "b_alone": "search for b alone",
}
#: steps of progress of a profile, of all posterior draws and of a prediction; a start of a search has 1
PROFILE_STEPS, DRAW_STEPS, PREDICTION_STEPS = 4, 30, 4


class StudyProgress:
    """Reports the phases of all folds of a study, each as long as it takes in a typical one."""

    def __init__(self, job: Job, progress: Progress) -> None:
        self._name, self._progress = job.name, progress
        shared = {SEARCH_PHASES[search]: job.recipe.starts for search in job.searches}
        if len(job.folds) == 1:
            shared["profiles"] = PROFILE_STEPS * len(job.parameters.free)
        shared["posterior draws"] = DRAW_STEPS
        self._sizes = {
            fold.name: shared | {"predictions": PREDICTION_STEPS * len(fold.validate)} for fold in job.folds
        }
        self._done: dict[tuple[str, str], float] = {}  # by fold and phase

    def phase(self, fold: Fold, phase: str) -> Callable[..., None]:
        """Return a callback that takes the number of steps of a phase that are done, and of all."""
        return partial(self.report, fold, phase)

    def report(self, fold: Fold, phase: str, step: float = 0, steps: int = 1) -> None:
        """Report so many steps of a phase of a fold as done."""
        self._done[fold.name, phase] = step / steps
        sizes = [(name, *item) for name, phases in self._sizes.items() for item in phases.items()]
        done = sum(self._done.get((name, task), 0.0) * size for name, task, size in sizes)
        number, count = [*self._sizes].index(fold.name) + 1, len(self._sizes)
        place = f"{self._name}: {fold.name} (fold {number} of {count})" if count > 1 else self._name
        self._progress(f"{place}: {phase}", round(done), sum(size for *_, size in sizes))

    def finish(self, fold: Fold, phase: str) -> None:
        """Report all other phases of a fold as done; `phase` goes on."""
        self._done |= {(fold.name, task): 1.0 for task in self._sizes[fold.name]}
        self.report(fold, phase)


@dataclass(frozen=True)
class FoldServices:
    """How the folds of a run are carried out: where finished work is kept, and who sees the progress."""

    settings: Settings
    checkpoint: Checkpoint
    progress: StudyProgress
    #: posteriors of single specimens, by their insertions: folds that share specimens sample each once
    specimens: dict[tuple[str, ...], Draws] = field(default_factory=dict)
    process: int = field(default_factory=os.getpid)

    def here(self, job: Job) -> "FoldServices":
        """Return these, or those of a copy of their process."""
        return self if os.getpid() == self.process else self.copy(job)

    def copy(self, job: Job, **changed: Any) -> "FoldServices":  # noqa: ANN401 - of `Settings`
        """Return those of another process, which nobody watches, with that one's stop."""
        settings = replace(self.settings, pool=None, progress=no_progress, stop=stop_requested, **changed)
        return replace(self, settings=settings, progress=StudyProgress(job, no_progress))


@dataclass(frozen=True)
class FoldResult:
    """What one fold gave: rows of the tables of `Run.frames` and of lists of its metadata; what it states."""

    rows: FitRows
    mode: tuple[float, ...] | None  #: theta of the fit, if it maximises the posterior
    counts: Mapping[str, CountMetadata]  #: of simulations, as of `tabulate_validity`
    search_faults: tuple[str, ...]
    faults: tuple[RunFault, ...]  #: of draws that are not certified
    posterior: Posterior | None  #: if it was asked for
    interrupted: bool


@dataclass(frozen=True)
class FoldDrawn:
    """Draws of a fold's parameters, of its specimens' mean, and the predictions by them."""

    specimens: Specimens
    draws: Draws
    shown: Draws  #: as many as figures show
    posterior: Posterior | None  #: if it was asked for
    fitted: FittedDraws  #: the needles of the draws that are shown
    predicted: tuple[HeldOutPrediction, ...] = ()

    @property
    def count(self) -> CountMetadata:
        """Numbers of the draws that are shown, and of those outside the model's validity."""
        outside = self.fitted.outside
        return CountMetadata(simulations=len(outside), outside=int(outside.sum()))

    def list_modes(self, fit: Fit) -> dict[str, Curve | None]:
        """Return the needles of the posterior mode, by insertion held out, where that is the fit."""
        modes = {
            insertion.id: mode
            for insertion in self.specimens.fold.validate
            if insertion.surfaces and (mode := self.specimens.mode_in(insertion)) is not None
        }
        return {
            name: prediction.mode
            for prediction in self.predicted
            if prediction.point is not None
            and (name := prediction.insertion) in modes
            and np.array_equal(modes[name], fit.theta)
        }


@dataclass(frozen=True)
class FoldFits:
    """The fits of a fold by the names of their searches, their profiles, and draws about the first one."""

    job: Job  #: with those parameters alone held whose posterior is their prior
    fits: Mapping[str, Fit]
    profiles: FitProfiles | None
    drawn: FoldDrawn | None
    error_fit: ErrorMinimisingFit | None
    shifts: Mapping[str, PriorShift]  #: by the parameters that are held
    interrupted: bool


def run_fold(job: Job, fold: Fold, services: FoldServices) -> FoldResult:
    """Fit to the insertions of a fold, learn what they determine, score and predict the others."""
    fits = fit_fold(job, fold, services)
    services.progress.finish(fold, "errors")
    job = fits.job
    drawn, least = fits.drawn, fits.error_fit
    predicted = drawn.predicted if drawn else ()
    usable = {name: fit for name, fit in fits.fits.items() if math.isfinite(fit.objective)}
    fitted, problem = usable.get("fitted"), job.problem(fold)
    # what leans on stated depths; without stated noise that cannot be known
    first = fold is job.folds[0] and fitted is not None and fitted.minimized == "posterior"
    rows: FitRows = {} if fitted is None else _describe_fit(job, fold, fitted, fits, drawn)
    parts = [*_score(job, fold, usable, drawn), *(prediction.rows for prediction in predicted)]
    if fitted is not None and not fold.validate:
        parts += _describe_readings(job, fold, fitted)
    rows |= {name: join_rows(parts, name) for name in SCORED_TABLES}
    rows |= {
        "parameters": [
            *rows.get("parameters", ()),
            *list_error_fit(job, fold, least),
            *list_published(job, fold),
        ],
        "error_fit": [] if least is None else [describe_error_fit(fold, least)],
        "draws": list(_list_draws(job, fold, drawn)) if drawn else [],
        "stated_depths": examine_depths(problem, np.array(fitted.theta)) if fitted and first else [],
        "starts": [
            {"fold": fold.name, "fit": name, **make_start_row(job.problem(fold, name), start, fit)}
            for name, fit in fits.fits.items()
            for start in fit.starts
        ],
        "medians": [  # insertions whose prediction is the predictive median
            {
                "fold": fold.name,
                "insertion": prediction.insertion,
                **describe_point(prediction.point, job.parameters),
            }
            for prediction in predicted
            if prediction.point is not None and prediction.point.is_median
        ],
    }
    if fitted is not None:
        several = len(job.folds) > 1  # of which only what they hold out is placed
        simulated = drawn.fitted if drawn else None
        rows["needles"] = [*place_needles(problem, fold, fitted, simulated, predicted, fitted=not several)]
    return FoldResult(
        rows=rows,
        mode=fitted.theta if fitted and fitted.minimized == "posterior" else None,
        counts={
            "draws": drawn.count if drawn else CountMetadata(),
            "predicted": add_counts(part.simulations for part in predicted),
        },
        search_faults=tuple(_find_search_faults(fits)),
        faults=tuple(_find_draw_faults(drawn)) if drawn else (),
        posterior=drawn.posterior if drawn else None,
        interrupted=fits.interrupted,
    )


def join_rows(parts: Iterable[Tables], table: str) -> list[Row]:
    """Return the rows of a table, or of a list of metadata, from all parts that have any."""
    return [row for part in parts for row in part.get(table, ())]


def _describe_readings(job: Job, fold: Fold, fit: Fit) -> Iterator[Tables]:
    """Yield rows about what was read of insertions fitted to beside the fit's needle."""
    for insertion in fold.tune:
        curve = predict_needle(fit.values, job.medium, insertion)
        where = {"fold": fold.name, "insertion": insertion.id}
        for name in insertion.observations:
            if curve is not None and name in STUDIED:
                tables = STUDIED[name].describe_fitted(job, insertion, curve)
                yield {table: [where | row for row in rows] for table, rows in tables.items()}


# ---- fits and draws


def fit_fold(job: Job, fold: Fold, services: FoldServices) -> FoldFits:
    """Fit to the insertions of a fold, and draw parameters about the fit.

    While draws are made, a copy of this process goes on with the other searches and the profiles.
    """
    stop = services.settings.stop
    (first, *others), profiles = job.searches, None
    fits = search_fits(job, fold, [first], services)
    if first in fits and job.response_at is None and job.responds_to_moves(fold):
        return fit_fold(replace(job, response_at=fits[first].values), fold, services)
    job = job.holding(fits[first].held) if first in fits else job
    _note_fit(job, fits, services)
    beside: list[Callable[[], bytes]] = [
        lambda: pickle.dumps(search_fits(job, fold, others, services.here(job))),
        lambda: pickle.dumps(_profile(job, fold, fits, services.here(job))),
    ]
    with compute_beside(() if services.settings.jobs == 1 else beside, stop) as finish:
        drawn = _draw(job, fold, fits, services)
        if not stop():
            more, profiles = map(pickle.loads, finish() or [work() for work in beside])
            fits |= more
    interrupted = any(fit.interrupted for fit in fits.values()) or len(fits) < len(job.searches)
    if better := _move_to_better(job.problem(fold), fits, profiles):
        fits["fitted"], drawn = better, None
        profiles = _profile(job, fold, fits, services)
    drawn = drawn or _draw(job, fold, fits, services)
    interrupted = interrupted or stop()
    shifts: Mapping[str, PriorShift] = {}
    if (fit := _find_fit(fits)) is not None:  # at the fit and at draws
        thetas = [np.array([fit.theta]), *([drawn.draws.thetas] if drawn else [])]
        shifts = measure_prior(job, fold, np.concatenate(thetas))
    hidden = [name for name, shift in shifts.items() if shift.is_hidden]
    if len(hidden) < len(shifts) and not interrupted:  # one moves needles of draws, not of the fit
        return fit_fold(job.holding(hidden), fold, services)
    drawn = None if drawn is None else _predict(fold, drawn, services)
    error_fit = _minimise_errors(job, fold, fits, drawn, services)
    return FoldFits(job, fits, profiles, drawn, error_fit, shifts, interrupted)


def search_fits(job: Job, fold: Fold, searches: Iterable[str], services: FoldServices) -> dict[str, Fit]:
    """Return the fits of searches: of everything free, by the metric if asked, and of b alone."""
    fits = {}
    for search in searches:
        if services.settings.stop():
            break
        step = services.progress.phase(fold, SEARCH_PHASES[search])
        fits[search] = search_fit(job, fold, search, services.settings, services.checkpoint, step)
    return fits


def _find_fit(fits: Mapping[str, Fit], search: str = "fitted") -> Fit | None:
    """Return the fit of a search that found a point that can be solved; None without one."""
    fit = fits.get(search)
    return fit if fit is not None and math.isfinite(fit.objective) else None


def _note_fit(job: Job, fits: Mapping[str, Fit], services: FoldServices) -> None:
    """Print the best fit, before there are intervals."""
    fit = _find_fit(fits)
    if len(job.folds) > 1 or fit is None or fit.interrupted:
        return
    values = (
        f"{format_bare_symbol(name)} {format_quantity(name, fit.values[name])}"
        for name in job.parameters.searched.free
    )
    services.settings.first(f"{job.name}: best fit: {', '.join(values)}; intervals follow")


def _profile(job: Job, fold: Fold, fits: Mapping[str, Fit], services: FoldServices) -> FitProfiles | None:
    """Return the profiles of the posterior about the fit; many folds are scored, not examined."""
    fit = _find_fit(fits)
    if len(job.folds) > 1 or fit is None or fit.interrupted or fit.minimized != "posterior":
        return None
    step, settings = services.progress.phase(fold, "profiles"), services.settings
    step(0)
    return profile_parameters(job.problem(fold), fit, settings.jobs, settings.stop, step)


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


def _draw(job: Job, fold: Fold, fits: Mapping[str, Fit], services: FoldServices) -> FoldDrawn | None:
    """Return draws of a fold's parameters. None without a fit, and where a fit alone is interrupted."""
    settings, fit = services.settings, _find_fit(fits)
    if fit is None or fit.minimized != "posterior" or (settings.stop() and not fold.validate):
        return None  # where no noise is stated there is no posterior
    sampled = services.progress.phase(fold, "posterior draws")
    sampled(0)
    made = draw_fold_parameters(job, fold, fit, settings, sampled)
    sampled(1)
    callbacks = Callbacks(settings.stop, sampled) if settings.sample else None
    specimens = Specimens(job, fold, made.draws, settings.jobs, callbacks, services.specimens)
    shown = specimens.replace_mean(made.shown)
    return FoldDrawn(
        specimens,
        specimens.replace_mean(made.draws),
        shown,
        made.posterior if settings.sample else None,
        simulate_fitted_draws(job.problem(fold), shown, settings.jobs, bands=len(job.folds) == 1),
    )


def _predict(fold: Fold, drawn: FoldDrawn, services: FoldServices) -> FoldDrawn:
    """Return draws with the predictions of the insertions held out, made by draws that are certified."""
    step = services.progress.phase(fold, "predictions")
    step(0)
    return replace(drawn, predicted=tuple(predict_held_out(drawn.specimens, bands=True, step=step)))


def _minimise_errors(
    job: Job, fold: Fold, fits: Mapping[str, Fit], drawn: FoldDrawn | None, services: FoldServices
) -> ErrorMinimisingFit | None:
    """Return the ranges of the parameters about the fit that minimises the errors."""
    fit = _find_fit(fits, "fitted_metric")
    if fit is None or fit.interrupted or services.settings.stop():
        return None
    problem, settings = job.problem(fold, "fitted_metric"), services.settings
    draws = np.empty((0, len(problem.names)))
    if drawn is not None and len(drawn.draws.thetas):
        draws = drawn.draws.thetas[:, [job.parameters.free.index(name) for name in problem.names]]
    services.progress.report(fold, "errors of the fit")
    rng = job.random(fold.name, "error tolerance")
    callbacks = Callbacks(stop=settings.stop, jobs=settings.jobs)
    return examine_errors(problem, fit, draws, job.parameters, rng, callbacks)


def _find_search_faults(fits: FoldFits) -> Iterator[str]:
    """Yield why the best point of the fit may not be the best."""
    fit, profiles = fits.fits.get("fitted"), fits.profiles
    if fit is not None and fit.fault:
        yield fit.fault
    if profiles is not None and profiles.gain > LOG_POSTERIOR_TOLERANCE:
        yield f"the profiles met a log posterior {profiles.gain:.3g} above that of the fit: raise `starts`"


def _find_draw_faults(drawn: FoldDrawn) -> Iterator[RunFault]:
    """Yield why draws are not certified; a posterior that was asked for has its own faults.

    That is of all insertions together, not of the population of specimens that differ.
    """
    if drawn.posterior is None or drawn.specimens.separate:
        kind = find_fault_kind(drawn.shown)
        yield from (RunFault(kind, f"the posterior: {why}") for why in drawn.shown.faults)


# ---- rows of the tables


def _list_draws(job: Job, fold: Fold, drawn: FoldDrawn) -> Iterator[Row]:
    """Yield draws in Pa and mm: of the specimens' mean, of each and of a new one."""
    draws, thetas_by_specimen = drawn.shown, {TUNED_SPECIMENS: drawn.shown.thetas}
    if not draws.faults:
        thetas_by_specimen |= drawn.specimens.list_draws(draws.thetas)
    for specimen, thetas in thetas_by_specimen.items():
        where = {"fold": fold.name, **draws.describe(), "specimen": specimen}
        yield from ({**where, **job.parameters.values(theta)} for theta in thetas)


def _describe_fit(job: Job, fold: Fold, fit: Fit, fits: FoldFits, drawn: FoldDrawn | None) -> FitRows:
    """Return the fitted parameters of a fold and what the data determine.

    They are judged by draws of the posterior; without certified ones, by the information.
    """
    problem, place = job.problem(fold), {"fold": fold.name}
    draws, posterior = (drawn.draws, drawn.posterior) if drawn else (None, None)
    further, population = None, list[Row]()
    if drawn is not None and drawn.specimens.separate:
        further = None if drawn.draws.faults else drawn.specimens.population.new
        population = drawn.specimens.tabulate_population()
        posterior = None  # the sampler's has one set of parameters, specimens several
    verdict = identify(problem, fit, draws.certified if draws else None, further)
    directions = list(list_directions(fold, fit, verdict))
    # without stated noise nothing says how far the data can be trusted, outside its validity the model
    invalid = drawn is not None and drawn.count.outside > MOSTLY_OUTSIDE * drawn.count.simulations
    if fit.minimized != "posterior" or invalid:
        nothing = dict.fromkeys(verdict.determined, False)
        notes = dict.fromkeys(verdict.notes, "most draws are outside what the model assumes")
        verdict = replace(verdict, determined=nothing, together=nothing, conditions={})
        verdict = replace(verdict, notes=notes) if invalid else verdict
    judged, points = list[Row](), list[Row]()
    if fits.profiles is not None:
        identified = identify_parameters(problem.searched, fits.profiles, verdict.sds, verdict)
        judged = [{**place, **row} for row in identified.rows]
        points = [{**place, **row} for row in identified.points]
        verdict = reconcile_verdict(verdict, identified.by_profile)
    held = {row["parameter"]: row for row in list_held(job.parameters, fits.shifts)}
    fitted = list[ParameterRow]()
    for row in list_fitted(job, fold, fit, verdict):
        by_prior = held.get(row.parameter, {}).items()
        fitted.append(row._replace(**{key: value for key, value in by_prior if key in row._fields}))
    sampled = intervals_of_draws(job.parameters, draws, posterior)
    fitted, judged = add_intervals(
        fitted, judged, sampled, job.parameters.ties, verdict.together, verdict.model_error
    )
    if fits.profiles is not None:
        columns = IDENTIFICATION_COLUMNS
        judged += [
            place | {key: of_prior[key] for key in columns if key in of_prior} for of_prior in held.values()
        ]
    return {
        "parameters": fitted,
        "directions": directions,
        "identification": judged,
        "profiles": points,
        "population": population,
    }


# ---- scores


def _score(job: Job, fold: Fold, fits: Mapping[str, Fit], drawn: FoldDrawn | None) -> Iterator[Tables]:
    """Yield the scores of every method on every insertion, then of our predictions."""
    scorer, problem = make_scorer(job), job.problem(fold)
    held = [insertion for insertion in fold.validate if not find_studied(insertion).has_errors]
    fit = fits.get("fitted")
    modes = drawn.list_modes(fit) if drawn and fit else {}
    for method, curves in make_predictors(problem, fits, job.hand_tuned, modes).items():
        for role, insertions in (("tune", fold.tune), ("validate", held)):
            place = {"fold": fold.name, "role": role, "method": method}
            yield from (scorer.score(place, insertion, curves) for insertion in insertions)
    if fit is None:
        return
    predicted = (
        {} if drawn is None else {insertion.insertion: insertion.curve for insertion in drawn.predicted}
    )

    def find_curves(insertion: Insertion) -> dict[str, Curve | None]:
        """Return our prediction, that of the mode where no draws are certified.

        It is compared as all methods are: in the place of what has the measured layers.
        """
        if insertion.id in predicted:
            return {"measured": predicted[insertion.id]}
        mode = None if drawn is None else drawn.specimens.mode_in(insertion)
        values = fit.values if mode is None else problem.values(mode)
        return {"measured": predict_needle(values, problem.medium, insertion)}

    place = {"fold": fold.name, "role": "validate", "method": PREDICTION_METHOD}
    yield from (scorer.score(place, insertion, find_curves) for insertion in held)
