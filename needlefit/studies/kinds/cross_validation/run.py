"""Run a study or a fit: fit to some insertions, score on others, each fold by every method."""

import math
import os
import pickle
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
import pandas as pd

from needlefit.datasets.insertion import Insertion
from needlefit.grouping import group_values
from needlefit.inference.error_fit import ErrorMinimisingFit, Target, examine_errors
from needlefit.inference.fit import MET_BY_PROFILE, Callbacks, Fit, Start, keep_start, read_starts
from needlefit.inference.identifiability.identify import (
    LOG_POSTERIOR_TOLERANCE,
    FitProfiles,
    identify,
    profile_parameters,
)
from needlefit.inference.optimize import minimize
from needlefit.inference.predict import Draws
from needlefit.inference.problem import Problem, find_outside_validity
from needlefit.inference.sampling.posterior import Posterior
from needlefit.project.checkpoint import Checkpoint, open_checkpoint
from needlefit.project.locate import read_toml
from needlefit.project.processes import one_thread
from needlefit.project.progress import no_progress
from needlefit.project.random_streams import random_stream
from needlefit.project.tasks import compute_beside, stop_requested
from needlefit.reporting.number_format import format_bare_symbol, format_quantity
from needlefit.schemas.study import FitRecord, StudyRecord
from needlefit.studies.answer import FaultKind, RunFault, find_fault_kind
from needlefit.studies.explorer import describe_insertions
from needlefit.studies.fit_frames import ADVANCE_KEY, DEPTHS_KEY, MEDIAN_METHOD, TUNED_SPECIMENS
from needlefit.studies.fit_frames import COLUMNS as FRAMES
from needlefit.studies.fit_warnings import add_warnings
from needlefit.studies.fold_draws import FoldDraws, Specimens, draw_fold_parameters
from needlefit.studies.held_out_predictions import HeldOutPrediction, predict_held_out
from needlefit.studies.identification import (
    add_intervals,
    identify_parameters,
    intervals_of_draws,
    reconcile_verdict,
)
from needlefit.studies.job import Fold, Job, Settings, prepare
from needlefit.studies.kinds.cross_validation.rows import (
    list_error_fit,
    list_fitted,
    list_published,
    make_start_row,
)
from needlefit.studies.needle_placement import place_needles
from needlefit.studies.needles_in_scan import NeedleInScan, tabulate_needles
from needlefit.studies.other_advance import find_better_advance
from needlefit.studies.provenance import describe_configuration
from needlefit.studies.run import Run
from needlefit.studies.score import Predictor, Row, Scorer, make_predictors
from needlefit.studies.simulated_data import find_true_value
from needlefit.studies.stated_depths import examine_depths
from needlefit.studies.validity import MOSTLY_OUTSIDE, VALIDITY_KEY, ValidityCounts

__all__ = ["FRAMES", "Settings", "run"]

SEARCH_WORDS = {
    "fitted": "search for the best fit",
    "fitted_metric": "search for the smallest errors",
    "hand_tuned_b": "search for b with the paper's moduli",
}
#: steps of progress: of a profile, of all posterior draws and of a prediction; a start of a search has 1
PROFILE_STEPS, DRAW_STEPS, PREDICTION_STEPS = 4, 30, 4


@one_thread
def run(name: str, record: FitRecord | StudyRecord, settings: Settings) -> Run:
    """Run a study, or a fit, which is a study that scores only its own insertions.

    The same record, data, seed and versions give the same frames for any number of jobs, and after an
    interruption with `resume`.

    Raises ConfigError or DataError if anything the record names is missing or wrong. FitError if a search
    finds no point that can be solved.
    """
    job = prepare(name, record, settings)
    work = describe_configuration(job)
    checkpoint = open_checkpoint(settings.checkpoint, settings.resume, work, settings.note)
    going = _StudyRun(job, settings, checkpoint)
    for number, fold in enumerate(job.folds):
        going.run_fold(number, fold)
        if going.interrupted:
            break
    errors = [] if going.interrupted else going.rows["errors"]
    better = find_better_advance(job, errors, going.scorer, settings)
    found = Run(
        kind="cross_validation" if isinstance(record, StudyRecord) else "fit",
        name=name,
        record=record,
        origin=job.dataset.origin,
        dataset_title=job.dataset.title or job.dataset.name,
        frames={
            **{frame: going.frame(frame) for frame in FRAMES if frame != "needles"},
            "needles": tabulate_needles(going.needles.values()),
        },
        posteriors=going.posteriors,
        run={
            **work,
            # by insertion the layers that it meets, each with the depth at which it begins, mm
            "layers": {
                one.id: list(map(list, zip(one.sequence, (0.0, *one.boundaries.tolist()), strict=True)))
                for one in job.insertions
            },
            **describe_insertions(job),
            **_find_truth(job),
            "search_faults": going.search_faults,
            **({DEPTHS_KEY: going.depths} if going.depths else {}),
            **({ADVANCE_KEY: better} if better else {}),
            VALIDITY_KEY: going.counts.table(),
        },
        timing={"dataset": str(job.dataset.path)},
        interrupted=going.interrupted,
        data=job.dataset.files,
    )
    unconverged = [fault for posterior in going.posteriors.values() for fault in posterior.faults]
    faults = find_faults(found.frames["errors"], going.search_faults, unconverged)
    return add_warnings(replace(found, faults=(*faults, *going.uncertified)), job)


def _find_truth(job: Job) -> dict[str, dict[str, float]]:
    """Return the true parameters, where the data are our synthetic ones; nothing that fits knows them."""
    path = job.dataset.path / "dataset.toml" if job.dataset.path.is_dir() else job.dataset.path
    if job.dataset.origin != "synthetic" or len(job.folds) > 1 or not path.is_file():
        return {}
    seed = read_toml(path).get("truth_seed")
    if not isinstance(seed, int):
        return {}
    problem = job.problem(job.folds[0])
    known = {name: find_true_value(problem, name, seed) for name in job.parameters.names}
    return {"truth": {name: value for name, value in known.items() if math.isfinite(value)}}


def find_faults(
    errors: pd.DataFrame, search_faults: Mapping[str, Sequence[str]], not_converged: Sequence[str]
) -> tuple[RunFault, ...]:
    """Return what did not converge: scored simulations of the fit, its search (by fold), posteriors."""
    fitted = errors[errors["method"] == "fitted"]
    failed = int((~fitted["converged"].astype(bool)).sum())
    faults = [f"{failed} of {len(fitted)} simulations of the fit did not converge"] if failed else []
    folds = group_values((fault, fold) for fold, reasons in search_faults.items() for fault in reasons)
    faults += [
        fault if found == ["all"] else f"{', '.join(found)}: {fault}" for fault, found in folds.items()
    ]
    faults += [f"the posterior has not converged: {why}" for why in not_converged]
    return tuple(RunFault(FaultKind.NOT_CONVERGED, what) for what in faults)


@dataclass(frozen=True)
class _Drawn:
    """Draws of a fold's parameters, and the predictions by them."""

    made: FoldDraws
    specimens: Specimens
    predicted: tuple[HeldOutPrediction, ...]
    outside: int  #: of the draws that are shown, those outside what the model assumes


@dataclass
class _StudyRun:
    """A run that is going on: what it works on, and what it has found by fold.

    `rows` are those of the tables of `Run`, by table.
    """

    job: Job
    settings: Settings
    checkpoint: Checkpoint
    interrupted: bool = False
    rows: defaultdict[str, list[Row]] = field(default_factory=lambda: defaultdict(list))
    posteriors: dict[str, Posterior] = field(default_factory=dict)
    uncertified: list[RunFault] = field(default_factory=list)
    search_faults: dict[str, list[str]] = field(default_factory=dict)
    counts: ValidityCounts = field(default_factory=ValidityCounts)
    outside: dict[str, float] = field(default_factory=dict)  #: by fold the share of draws outside validity
    needles: dict[str, NeedleInScan] = field(default_factory=dict)
    depths: list[Row] = field(default_factory=list)  #: of the first fold
    #: posteriors of single specimens, which folds share
    specimens: dict[tuple[str, ...], Draws] = field(default_factory=dict)
    parts: dict[tuple[int, str], float] = field(default_factory=dict)  #: done, of each phase of each fold
    process: int = field(default_factory=os.getpid)

    def __post_init__(self) -> None:
        floors = {insertion.id: self.job.floor(insertion) for insertion in self.job.insertions}
        self.scorer = Scorer(self.job.dataset, self.job.record.layer_count_rule, floors, self.counts)

    def frame(self, name: str) -> pd.DataFrame:
        """Return one table; without rows it still has its columns."""
        values = self.job.parameters.names if name in ("starts", "profiles", "draws") else ()
        rows = self.rows[name]
        return pd.DataFrame(rows) if rows else pd.DataFrame(columns=[*FRAMES[name], *values])

    def run_fold(self, number: int, fold: Fold) -> None:
        """Fit to the insertions of a fold, learn what they determine, score and predict the others.

        While draws are made and insertions predicted, a copy of this process goes on with the other searches
        and the profiles.
        """
        job, settings = self.job, self.settings
        (first, *others), profiles, drawn = job.searches, None, None
        fits = self._search(number, fold, [first])
        self._note_fit(fits)
        rest: list[Callable[[], bytes]] = [
            lambda: pickle.dumps(self._go_on()._search(number, fold, others)),
            lambda: pickle.dumps(self._go_on()._examine(number, fold, fits)),
        ]
        with compute_beside(() if settings.jobs == 1 else rest, settings.stop) as finish:
            drawn = self._draw(number, fold, fits)
            if not settings.stop():
                more, profiles = map(pickle.loads, finish() or [work() for work in rest])
                fits |= more
        self.interrupted = any(fit.interrupted for fit in fits.values()) or len(fits) < len(job.searches)
        if better := _move_to_better(job.problem(fold), fits, profiles):
            fits["fitted"], drawn = better, None
            profiles = self._examine(number, fold, fits)
        drawn = drawn or self._draw(number, fold, fits)
        self.interrupted = self.interrupted or settings.stop()
        least = self._examine_errors(number, fold, fits, drawn)
        self.parts |= {(number, phase): 1.0 for phase in self._list_phases(fold)}
        self._report(number, "errors")
        if drawn is not None:
            self._tabulate_draws(fold, drawn)
        self._tabulate_searches(fold, fits, profiles)
        usable = {name: fit for name, fit in fits.items() if math.isfinite(fit.objective)}
        known = "fitted" in usable
        if known:
            self._tabulate_fit(fold, usable["fitted"], profiles, drawn)
        if least is None:
            usable.pop("fitted_metric", None)
        else:
            usable["fitted_metric"] = self._tabulate_error_fit(fold, usable["fitted_metric"], least)
        self.rows["parameters"] += list_published(job, fold, usable.get("hand_tuned_b"))
        for method, curves in make_predictors(job.problem(fold), usable, job.hand_tuned).items():
            for role, insertions in (("tune", fold.tune), ("validate", fold.validate)):
                self._score({"fold": fold.name, "role": role, "method": method}, insertions, curves)
        medians = {
            one.row["insertion"]: one.median for one in (drawn.predicted if drawn else ()) if one.median
        }
        place = {"fold": fold.name, "role": "validate", "method": MEDIAN_METHOD}
        predicted = [one for one in fold.validate if one.id in medians]
        self._score(place, predicted, lambda insertion: {"measured": medians[insertion.id]}, "median")
        if known:
            draws = None if drawn is None else drawn.specimens.replace_mean(drawn.made.shown)
            given = (job.problem(fold), fold, fits["fitted"], draws, self.rows["bands"], settings.jobs)
            placed = place_needles(*given, fitted=len(job.folds) == 1)
            self.needles |= {one.insertion: one for one in placed}

    def _score(
        self, place: Row, insertions: Iterable[Insertion], curves: Predictor, estimate: str = "point"
    ) -> None:
        """Add the errors and the shapes of a method."""
        for insertion in insertions:
            errors, shapes = self.scorer.score(place, insertion, curves)
            self.rows["errors"] += [{**row, "estimate": estimate} for row in errors]
            self.rows["shapes"] += shapes

    def _go_on(self) -> "_StudyRun":
        """Return this run; in a copy of its process, where nobody sees its progress, with that one's stop."""
        if os.getpid() == self.process:
            return self
        other = copy(self)
        other.settings = replace(self.settings, progress=no_progress, stop=stop_requested)
        return other

    def _report(self, number: int, phase: str, step: int = 0, steps: int = 1) -> None:
        """Report so many steps of a phase of a fold as done."""
        job, folds = self.job, self.job.folds
        self.parts[number, phase] = step / steps
        phases = [(n, item) for n, fold in enumerate(folds) for item in self._list_phases(fold).items()]
        done = sum(self.parts.get((n, name), 0.0) * size for n, (name, size) in phases)
        which = f"{job.name}: {folds[number].name} (fold {number + 1} of {len(folds)})"
        label = f"{which if len(folds) > 1 else job.name}: {phase}"
        self.settings.progress(label, round(done), sum(size for _, (_, size) in phases))

    def _list_phases(self, fold: Fold) -> dict[str, int]:
        """Return the steps of each phase of a fold, each about as long in a typical one."""
        job = self.job
        phases = {SEARCH_WORDS[search]: job.recipe.starts for search in job.searches}
        if len(job.folds) == 1:
            phases["profiles"] = PROFILE_STEPS * len(job.parameters.free)
        return phases | {"posterior draws": DRAW_STEPS, "predictions": PREDICTION_STEPS * len(fold.validate)}

    def _note_fit(self, fits: Mapping[str, Fit]) -> None:
        """Tell the user the best fit, before there are intervals."""
        job, fit = self.job, fits.get("fitted")
        if len(job.folds) > 1 or fit is None or fit.interrupted or not math.isfinite(fit.objective):
            return
        values = (
            f"{format_bare_symbol(name)} {format_quantity(name, fit.values[name])}"
            for name in job.parameters.free
        )
        self.settings.first(f"{job.name}: best fit: {', '.join(values)}; intervals follow")

    def _search(self, number: int, fold: Fold, searches: Iterable[str]) -> dict[str, Fit]:
        """Return the fits of searches: of everything free, by the metric if asked, and of b alone."""
        fits = {}
        for search in searches:
            if self.settings.stop():
                break
            fits[search] = self._run_search(number, fold, search)
        return fits

    def _run_search(self, number: int, fold: Fold, search: str) -> Fit:
        """Return the fit of one search; each finished start is kept and reported."""
        job, settings, key = self.job, self.settings, f"{fold.name}/{search}"
        kept, starts = read_starts(self.checkpoint, key), job.recipe.starts
        ended = len(kept)

        def report(approached: int, total: int = starts) -> None:
            self._report(number, SEARCH_WORDS[search], approached + ended, 2 * starts)

        def keep(start: Start) -> None:
            nonlocal ended
            keep_start(self.checkpoint, key, start)
            ended += 1
            report(starts)

        report(0)
        rng = random_stream(job.recipe.seed, fold.name, search, "starts")
        callbacks = Callbacks(kept, keep, settings.stop, report, settings.jobs)
        return minimize(job.problem(fold, search), job.recipe_of(search), rng, callbacks)

    def _examine(self, number: int, fold: Fold, fits: Mapping[str, Fit]) -> FitProfiles | None:
        """Return the profiles of the posterior about the fit; many folds are scored, not examined."""
        fit = fits.get("fitted")
        if len(self.job.folds) > 1 or fit is None or fit.interrupted or not math.isfinite(fit.objective):
            return None
        if fit.minimized != "posterior":  # no noise is stated: there is no posterior
            return None
        step, settings = partial(self._report, number, "profiles"), self.settings
        step(0)
        return profile_parameters(self.job.problem(fold), fit, settings.jobs, settings.stop, step)

    def _examine_errors(
        self, number: int, fold: Fold, fits: Mapping[str, Fit], drawn: "_Drawn | None"
    ) -> ErrorMinimisingFit | None:
        """Return the point to be reported of the fit that minimises the errors."""
        job, settings, fit = self.job, self.settings, fits.get("fitted_metric")
        if fit is None or fit.interrupted or not math.isfinite(fit.objective) or settings.stop():
            return None
        problem, target = job.problem(fold, "fitted_metric"), None
        if drawn is not None and len(drawn.made.draws.thetas):
            thetas = drawn.specimens.replace_mean(drawn.made.draws).thetas
            median = job.parameters.values(np.median(thetas, axis=0))
            columns = [job.parameters.free.index(name) for name in problem.names]
            target = Target(problem.parameters.theta(median), np.std(thetas, axis=0)[columns])
        self._report(number, "errors of the fit")
        rng = random_stream(job.recipe.seed, fold.name, "error tolerance")
        return examine_errors(problem, fit, target, job.parameters, rng)

    def _tabulate_error_fit(self, fold: Fold, fit: Fit, found: ErrorMinimisingFit) -> Fit:
        """Add the parameters that minimise the errors; return the fit at the reported point."""
        problem, tolerance = self.job.problem(fold, "fitted_metric"), found.tolerance
        reported = replace(fit, theta=found.theta, values=problem.values(np.array(found.theta)))
        self.rows["error_fit"].append(
            {
                "fold": fold.name,
                "objective_mm": found.objective,
                "least_objective_mm": found.least,
                "tolerance_mm": tolerance.value,
                "tolerance_by_noise_mm": tolerance.by_noise,
                "tolerance_by_insertions_mm": tolerance.by_insertions,
                "evaluations": found.evaluations,
            }
        )
        self.rows["parameters"] += list_error_fit(problem, fold, reported)
        return reported

    def _draw(self, number: int, fold: Fold, fits: Mapping[str, Fit]) -> "_Drawn | None":
        """Return draws of a fold's parameters, and the predictions of the insertions that it holds out.

        They are made by draws that are certified. None without a fit, and where a fit alone is interrupted.
        """
        job, settings, fit = self.job, self.settings, fits.get("fitted")
        if fit is None or not math.isfinite(fit.objective) or (settings.stop() and not fold.validate):
            return None
        if fit.minimized != "posterior":  # no noise is stated: there is no posterior
            return None
        sampled, step = (partial(self._report, number, phase) for phase in ("posterior draws", "predictions"))
        sampled(0)
        made = draw_fold_parameters(job, fold, fit, settings, self.checkpoint, sampled)
        sampled(1)
        if settings.sample and made.posterior is not None:
            self.posteriors[fold.name] = made.posterior
        specimens = Specimens(job, fold, made.draws, settings.jobs, self.specimens)
        step(0)
        predicted = () if specimens.faults else predict_held_out(specimens, bands=True, step=step)
        outside = find_outside_validity(job.problem(fold), specimens.replace_mean(made.shown).thetas)
        return _Drawn(made, specimens, tuple(predicted), int(outside.sum()))

    def _tabulate_draws(self, fold: Fold, drawn: "_Drawn") -> None:
        """Add predictions, and draws in Pa and mm: of the specimens' mean, of each and of a new one."""
        for one in drawn.predicted:
            self.rows["predictive"].append(one.row)
            self.rows["bands"] += one.band
            self.rows["curvature"] += one.sensors
            self.counts.predicted.add(one.solved, one.outside)
        job, specimens, draws = self.job, drawn.specimens, drawn.specimens.replace_mean(drawn.made.shown)
        about = {"fold": fold.name, **draws.describe()}
        if fold.name not in self.posteriors:
            kind = find_fault_kind(draws)
            self.uncertified += [RunFault(kind, f"the posterior: {why}") for why in draws.faults]
        every = {TUNED_SPECIMENS: draws.thetas} | ({} if draws.faults else specimens.list_draws(draws.thetas))
        for specimen, thetas in every.items():
            where = about | {"specimen": specimen}
            self.rows["draws"] += [{**where, **job.parameters.values(theta)} for theta in thetas]
        self.counts.draws.add(len(draws.thetas), drawn.outside)

    def _tabulate_searches(self, fold: Fold, fits: Mapping[str, Fit], profiles: FitProfiles | None) -> None:
        """Add the starts of a fold, what failed in them, and why the best point may not be the best."""
        for name, fit in fits.items():
            problem, place = self.job.problem(fold, name), {"fold": fold.name, "fit": name}
            self.rows["starts"] += [{**place, **make_start_row(problem, start, fit)} for start in fit.starts]
            ends = [start.theta for start in fit.starts if math.isfinite(start.objective)]
            self.counts.starts.add(len(ends), int(find_outside_validity(problem, ends).sum()))
        faults = [fits["fitted"].fault] if "fitted" in fits and fits["fitted"].fault else []
        if profiles is not None and profiles.gain > LOG_POSTERIOR_TOLERANCE:
            faults.append(
                f"the profiles met a log posterior {profiles.gain:.3g} above that of the fit: raise the "
                "recipe’s starts or evaluations"
            )
        if faults:
            self.search_faults[fold.name] = faults

    def _tabulate_fit(
        self, fold: Fold, fit: Fit, profiles: FitProfiles | None, drawn: "_Drawn | None"
    ) -> None:
        """Add the fitted parameters of a fold and what the data determine.

        They are judged by draws of the posterior; without certified ones, by the information.
        """
        job, problem, posterior = self.job, self.job.problem(fold), self.posteriors.get(fold.name)
        draws = further = None
        if drawn is not None:
            draws = drawn.specimens.replace_mean(drawn.made.draws)
            if drawn.specimens.separate:
                further = None if draws.faults else drawn.specimens.population.new
                self.rows["population"] += drawn.specimens.tabulate_population()
                posterior = None  # the sampler's has one set of parameters, specimens several
        verdict = identify(problem, fit, draws.certified if draws else None, further)
        if fit.minimized == "posterior":
            self.depths = self.depths or examine_depths(problem, np.array(fit.theta))
            self.rows["directions"] += [
                {
                    **{"fold": fold.name, "parameters": one.parameters},
                    **{"sd": one.sd, "sd_ratio": one.sd_ratio, "note": one.words},
                }
                for one in verdict.directions
            ]
        # without stated noise nothing says how far the data can be trusted, outside its validity the model
        invalid = drawn is not None and drawn.outside > MOSTLY_OUTSIDE * len(drawn.made.shown.thetas)
        if fit.minimized != "posterior" or invalid:
            nothing = dict.fromkeys(verdict.determined, False)
            notes = dict.fromkeys(verdict.notes, "most draws are outside what the model assumes")
            verdict = replace(verdict, determined=nothing, together=nothing, conditions={})
            verdict = replace(verdict, notes=notes) if invalid else verdict
        judged: list[Row] = []
        if profiles is not None:
            found = identify_parameters(problem, profiles, verdict.sds, verdict, verdict.loosened)
            judged = [{"fold": fold.name, **row} for row in found.rows]
            self.rows["profiles"] += [{"fold": fold.name, **row} for row in found.points]
            verdict = reconcile_verdict(verdict, found.by_profile)
        fitted = list_fitted(job, fold, fit, verdict)
        sampled = intervals_of_draws(job.parameters, draws, posterior)
        ties, together = job.parameters.ties, verdict.together
        add_intervals(fitted, judged, sampled, ties, together, verdict.model_error)
        self.rows["identification"] += judged
        self.rows["parameters"] += fitted


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
