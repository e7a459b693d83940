"""Tabulate the results of one fold as rows of the tables of `Run`."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd

from needlefit.arrays import Floats
from needlefit.inference.fit import Fit, Start
from needlefit.inference.identifiability.identify import (
    LOG_POSTERIOR_TOLERANCE,
    Assessment,
    FitProfiles,
    Identifiability,
    identify,
    objective_excess,
    select_within_tolerance,
    within_tolerance,
)
from needlefit.inference.parameters import Theta
from needlefit.inference.predict import Draws
from needlefit.inference.problem import Problem, explain_failure, find_outside_validity
from needlefit.inference.sampling.posterior import Posterior
from needlefit.studies.fit_frames import COLUMNS
from needlefit.studies.folds import Fold
from needlefit.studies.held_out_predictions import predict_held_out
from needlefit.studies.identification import identify_parameters, reconcile_verdict
from needlefit.studies.job import Job, Settings
from needlefit.studies.new_specimens import NewSpecimens
from needlefit.studies.parameter_intervals import NO_SOURCE, add_intervals, intervals_of_draws
from needlefit.studies.score import Row, Scorer, make_predictors
from needlefit.studies.summary import count_reasons
from needlefit.studies.validity import VALIDITY_KEY, ValidityCounts


@dataclass
class ResultRows:
    """The rows that a run collects, by table of `Run`; `names` are the medium's parameters."""

    names: tuple[str, ...]
    errors: list[Row] = field(default_factory=list)
    shapes: list[Row] = field(default_factory=list)
    starts: list[Row] = field(default_factory=list)
    failures: list[Row] = field(default_factory=list)
    parameters: list[Row] = field(default_factory=list)
    directions: list[Row] = field(default_factory=list)
    identification: list[Row] = field(default_factory=list)
    profiles: list[Row] = field(default_factory=list)
    predictive: list[Row] = field(default_factory=list)
    predictive_training: list[Row] = field(default_factory=list)
    uncertified: dict[str, tuple[str, ...]] = field(default_factory=dict)
    bands: list[Row] = field(default_factory=list)
    draws: list[Row] = field(default_factory=list)
    searches: dict[str, dict[str, Row]] = field(default_factory=dict)
    posteriors: dict[str, Posterior] = field(default_factory=dict)
    verdicts: dict[str, Identifiability] = field(default_factory=dict)
    search_faults: dict[str, list[str]] = field(default_factory=dict)
    counts: ValidityCounts = field(default_factory=ValidityCounts)

    def frame(self, name: str) -> pd.DataFrame:
        """Return one table; without rows it still has its columns."""
        rows = getattr(self, name)
        values = self.names if name in ("starts", "failures", "profiles", "draws") else ()
        return pd.DataFrame(rows) if rows else pd.DataFrame(columns=[*COLUMNS[name], *values])


def tabulate_fold(
    job: Job,
    fold: Fold,
    fits: Mapping[str, Fit],
    scorer: Scorer,
    tables: ResultRows,
    examination: FitProfiles | None = None,
    draws: Draws | None = None,
) -> None:
    """Score every method of one fold, and add rows on searches, parameters and profiles.

    Parameters are judged by the posterior's `draws`; without certified ones, by the information.
    """
    usable = {name: fit for name, fit in fits.items() if math.isfinite(fit.objective)}
    for name, fit in fits.items():
        problem = job.problem(fold, name)
        place = {"fold": fold.name, "fit": name}
        tables.starts += [{**place, **_start_row(problem, start, fit)} for start in fit.starts]
        ends = [start.theta for start in fit.starts if math.isfinite(start.objective)]
        tables.counts.starts.add(len(ends), int(find_outside_validity(problem, ends).sum()))
        for start in fit.starts:
            tables.failures += _failure_rows({**place, "start": start.index}, problem, start.failed)
    tables.searches[fold.name] = {name: _search_row(fit) for name, fit in fits.items()}
    if faults := _search_faults(fits.get("fitted"), examination):
        tables.search_faults[fold.name] = faults
    if "fitted" in usable:
        verdict = identify(job.problem(fold), usable["fitted"], draws.certified if draws else None)
        judgements: Mapping[str, Assessment] = {}
        if examination is not None:
            found = identify_parameters(
                job.problem(fold), examination, verdict.sds, verdict, verdict.loosened
            )
            tables.identification += [{"fold": fold.name, **row} for row in found.rows]
            tables.profiles += [{"fold": fold.name, **row} for row in found.points]
            judgements, verdict = found.judgements, reconcile_verdict(verdict, found.judgements)
        tables.verdicts[fold.name] = verdict
        tables.directions += [
            {"fold": fold.name, "sd": one.sd, "sd_ratio": one.sd_ratio, "note": one.words}
            for one in verdict.directions
        ]
        fitted = _fitted_rows(job, fold, usable["fitted"], verdict, judgements)
        judged = [row for row in tables.identification if row["fold"] == fold.name]
        sampled = intervals_of_draws(job.parameters, draws, tables.posteriors.get(fold.name))
        add_intervals(fitted, judged, sampled, job.parameters.ties)
        tables.parameters += fitted
    if "fitted_metric" in usable:
        tables.parameters += _metric_rows(job, fold, usable["fitted_metric"])
    tables.parameters += _published_rows(job, fold, usable.get("hand_tuned_b"))
    for method, curves in make_predictors(job, fold, usable).items():
        for role, insertions in (("tune", fold.tune), ("validate", fold.validate)):
            for insertion in insertions:
                place = {"fold": fold.name, "role": role, "method": method}
                errors, shapes = scorer.score(place, insertion, curves)
                tables.errors += errors
                tables.shapes += shapes


def has_fit(fits: Mapping[str, Fit]) -> bool:
    """Return whether the search of everything free found a point that can be solved."""
    return "fitted" in fits and math.isfinite(fits["fitted"].objective)


def record_failures(job: Job, fold: Fold, posterior: Posterior, tables: ResultRows) -> None:
    """Add what had no solution while the posterior of a fold was sampled."""
    for ensemble, thetas in enumerate(posterior.failed):
        place = {"fold": fold.name, "fit": "posterior", "start": ensemble}
        tables.failures += _failure_rows(place, job.problem(fold), thetas)


def tabulate_draws(job: Job, fold: Fold, draws: Draws, tables: ResultRows) -> None:
    """Add draws of a fold's parameters, in Pa and mm."""
    about = {"fold": fold.name, **draws.describe()}
    if draws.faults:
        tables.uncertified[fold.name] = draws.faults
    tables.draws += [{**about, **job.parameters.values(theta)} for theta in draws.thetas]
    tables.counts.draws.add(
        len(draws.thetas), int(find_outside_validity(job.problem(fold), draws.thetas).sum())
    )


def tabulate_predictions(
    job: Job, fold: Fold, draws: Draws, theta: Floats, settings: Settings, tables: ResultRows
) -> None:
    """Add the predictions of the insertions that a fold holds out, searched at `theta`.

    Those into new specimens are predicted as the paper does too, by what was tuned alone.
    """
    new = NewSpecimens(job, fold, theta)
    jobs, pool = settings.jobs, settings.part_pool
    for one in predict_held_out(job, fold, draws, new, jobs, pool, bands=True):
        tables.predictive.append(one.row)
        tables.bands += one.band
        tables.counts.predicted.add(one.solved, one.outside)
    others = tuple(one for one in fold.validate if new.differs(one))
    plain = predict_held_out(job, replace(fold, validate=others), draws, None, jobs, pool)
    tables.predictive_training += [one.row for one in plain]


def _search_faults(fit: Fit | None, examination: FitProfiles | None) -> list[str]:
    """Return why the best point of a search may not be the best there is."""
    faults = [fit.fault] if fit is not None and fit.fault else []
    if examination is not None and examination.gain > LOG_POSTERIOR_TOLERANCE:
        faults.append(
            f"the profiles met a log posterior {examination.gain:.3g} above that of the fit: raise the "
            "recipe’s starts or evaluations"
        )
    return faults


def _start_row(problem: Problem, start: Start, fit: Fit) -> Row:
    return {
        "start": start.index,
        "minimized": fit.minimized,
        "objective": start.objective,
        "excess": objective_excess(start, fit),
        "within_tolerance": within_tolerance(start, fit),
        "evaluations": start.evaluations,
        "gradients": start.gradients,
        "failed_solves": start.failures,
        "stopped": start.stopped,
        "joined": start.joined,
        **problem.values(np.array(start.theta)),
    }


def _failure_rows(place: Row, problem: Problem, thetas: Iterable[Theta]) -> list[Row]:
    """Return one row per theta that failed, simulated again for the insertion and the reason."""
    found = [(explain_failure(problem, theta), problem.values(theta)) for theta in thetas]
    return [{**place, "insertion": f.insertion, "note": f.reason, **values} for f, values in found]


_UNITS = {"posterior": "negative_log_posterior", "metric": "objective_mm"}


def _search_row(fit: Fit) -> Row:
    return {
        _UNITS[fit.minimized]: fit.objective if math.isfinite(fit.objective) else None,
        "values": dict(fit.values),
        "starts": len(fit.starts),
        "equal_starts": len(select_within_tolerance(fit)),
        "evaluations": fit.evaluations,
        "gradients": fit.gradients,
        "failed_solves": fit.failures,
    }


def _fitted_rows(
    job: Job, fold: Fold, fit: Fit, verdict: Identifiability, judgements: Mapping[str, Assessment]
) -> list[Row]:
    """Return the fitted values with what the data say of them; a tied one shares its source's verdict."""
    status = job.parameters.status
    rows = []
    for name, value in fit.values.items():
        free = status[name] == "free"
        factor, source = job.parameters.ties.get(name, (1.0, name))
        low, high = job.parameters.bounds.get(name, (math.nan, math.nan))
        condition = verdict.conditions.get(name, "")
        rows.append(
            {
                "fold": fold.name,
                "method": "fitted",
                "parameter": name,
                "value": value,
                "status": status[name],
                "bound_low": low,
                "bound_high": high,
                **NO_SOURCE,
                "sd": verdict.sds[name] if free else math.nan,
                "low": factor * verdict.spread_low[source] if source in verdict.sds else math.nan,
                "high": factor * verdict.spread_high[source] if source in verdict.sds else math.nan,
                "determined": bool(verdict.determined.get(source, False)) and not condition,
                "condition": condition,
                "note": verdict.notes[name]
                if free
                else _describe_status(name, status[name], factor, source)
                + _describe_profile(judgements.get(name))
                + (f"; {condition}" if condition else ""),
            }
        )
    return rows


def _metric_rows(job: Job, fold: Fold, fit: Fit) -> list[Row]:
    """Return the values that the metric objective prefers; the posterior fit has their uncertainty."""
    unknown = {**dict.fromkeys(("bound_low", "bound_high", "sd"), math.nan), **NO_SOURCE}
    ends = np.array([s.theta for s in select_within_tolerance(fit)] or [fit.theta]).reshape(
        -1, len(fit.theta)
    )
    parameters = job.problem(fold, "fitted_metric").parameters
    low, high = (parameters.values(end(ends, axis=0)) for end in (np.min, np.max))
    return [
        {
            "fold": fold.name,
            "method": "fitted_metric",
            "parameter": name,
            "value": value,
            "status": parameters.status[name],
            **unknown,
            "low": low[name],
            "high": high[name],
            "determined": False,
            "condition": "",
            "note": "minimises the metric objective",
        }
        for name, value in fit.values.items()
    ]


def _describe_status(name: str, status: str, factor: float, source: str) -> str:
    return (
        "fixed" if status == "fixed" else f"tied: {source}" if factor == 1 else f"tied: {factor:g} * {source}"
    )


def _describe_profile(judged: Assessment | None) -> str:
    """Return what to add to the note of a fixed parameter that was freed for its profile."""
    return (
        ""
        if judged is None
        else "; the data do not determine it"
        if judged.flat
        else f"; if fitted: {judged.profile_verdict}"
    )


def _published_rows(job: Job, fold: Fold, retuned: Fit | None) -> list[Row]:
    """Return the paper's set, and that set with the bevel alone fitted."""
    if job.hand_tuned is None:
        return []
    sets: dict[str, Mapping[str, Any]] = {"hand_tuned": job.hand_tuned}
    if retuned is not None:
        sets["hand_tuned_b"] = retuned.values
    found = {} if retuned is None else identify(job.problem(fold, "hand_tuned_b"), retuned).determined
    unknown = {**dict.fromkeys(("bound_low", "bound_high", "sd", "low", "high"), math.nan), **NO_SOURCE}
    rows = []
    for method, values in sets.items():
        for name, value in values.items():
            free = method == "hand_tuned_b" and name == "bevel_mm"
            rows.append(
                {
                    "fold": fold.name,
                    "method": method,
                    "parameter": name,
                    "value": value,
                    "status": "free" if free else "published",
                    **unknown,
                    "determined": free and found.get(name, False),
                    "condition": "",
                    "note": "re-tuned alone" if free else "tuned by hand",
                }
            )
    return rows


def summarize_searches(tables: ResultRows, interrupted: bool) -> dict[str, Any]:
    """Return the results of the searches by fold and fit, and the failures in them and in the sampler."""
    every = [search for fold in tables.searches.values() for search in fold.values()]
    sampled = {
        "failed_solves_of_sampler": sum(p.failures for p in tables.posteriors.values()),
        "not_converged": {fold: list(p.faults) for fold, p in tables.posteriors.items() if p.faults},
    }
    return {
        "searches": tables.searches,
        "evaluations": sum(search["evaluations"] for search in every),
        "not_determined": {
            fold: [name for name, known in verdict.determined.items() if not known]
            for fold, verdict in tables.verdicts.items()
        },
        "failed_solves": sum(search["failed_solves"] for search in every),
        **(sampled if tables.posteriors else {}),
        "sampled": bool(tables.posteriors),
        "draws": _describe_draws(tables.frame("draws")),
        "search_faults": tables.search_faults,
        VALIDITY_KEY: tables.counts.table(),
        "recorded_failures": count_reasons(tables.frame("failures")),
        "interrupted": interrupted,
        "budget_limited": False,  # every budget is counted in evaluations, none in time
    }


def _describe_draws(draws: pd.DataFrame) -> dict[str, Any]:
    """Return of each fold where its draws come from, Pareto's k, and their effective number."""
    first = draws.drop_duplicates("fold")
    return {
        str(row["fold"]): {
            "draw_source": row["draw_source"],
            "pareto_k": None if pd.isna(row["pareto_k"]) else float(row["pareto_k"]),
            "ess": None if pd.isna(row["ess"]) else float(row["ess"]),
            "certified": bool(row["certified"]),
        }
        for _, row in first.iterrows()
    }
