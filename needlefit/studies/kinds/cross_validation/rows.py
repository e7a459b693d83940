"""Rows of the tables of a fit: its starts and its parameters."""

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from needlefit.inference.error_fit import ErrorMinimisingFit
from needlefit.inference.fit import Fit, Start
from needlefit.inference.identifiability.directions import name_determined
from needlefit.inference.identifiability.identify import (
    Identifiability,
    identify,
    objective_excess,
    within_tolerance,
)
from needlefit.inference.parameter_names import HYPERPARAMETERS, to_value
from needlefit.inference.problem import Problem
from needlefit.studies.identification import NO_SOURCE
from needlefit.studies.job import Fold, Job
from needlefit.studies.score import Row

#: Of the table "starts": every start of every search, then a column per parameter. `objective` is what was
#: `minimized`: the negative log "posterior", or mm of the "metric"; `excess` is how far it is above the best
#: of its search, in units of the tolerance (0.1; 1 % or 0.002 mm); `joined` is the start that it met and went
#: on with.
START_COLUMNS = (
    *("fold", "fit", "start", "minimized", "objective", "excess", "within_tolerance"),
    *("evaluations", "gradients", "failed_solves", "stopped", "joined"),
)
#: Of the table "parameters": values per fold and method. `sd` is of ln for moduli and lengths, of the value
#: for alpha; `low`, `high` is the range among starts within tolerance of the best; `interval_low`,
#: `interval_high` is the 95 % interval that is printed, `draw_source` what it is from, `median` that of the
#: same draws. `status` is "prior" where the posterior of a parameter is its prior, which moves a tip by
#: `tip_shift_mm` at most. `determined` is "yes", "only together" (with the others held it is), or "no".
PARAMETER_COLUMNS = (
    *("fold", "method", "parameter", "value", "status", "bound_low", "bound_high"),
    *("sd", "low", "high", "interval_low", "interval_high", "draw_source"),
    *("median", "tip_shift_mm"),
    *("determined", "condition", "note"),
)
#: Of the table "error_fit": per fold the objective of the error-minimising fit, at the reported point, at the
#: least one, and the tolerance within which it is not significantly larger, with its two estimates.
ERROR_FIT_COLUMNS = (
    *("fold", "objective_mm", "tolerance_mm"),
    *("tolerance_by_noise_mm", "tolerance_by_insertions_mm", "evaluations"),
)
#: of the table "directions": combinations of parameters, and the SD to which each is known
DIRECTION_COLUMNS = ("fold", "parameters", "sd", "sd_ratio", "note")


def make_start_row(problem: Problem, start: Start, fit: Fit) -> Row:
    """Return a start of a fit, with its values."""
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


#: of a row of "parameters": what is known of fitted ones only
_UNKNOWN: Row = {
    **dict.fromkeys(("bound_low", "bound_high"), math.nan),
    **NO_SOURCE,
    **dict.fromkeys(("sd", "low", "high", "tip_shift_mm"), math.nan),
    **dict.fromkeys(("determined", "condition", "note"), ""),
}


def list_fitted(job: Job, fold: Fold, fit: Fit, verdict: Identifiability) -> list[Row]:
    """Return the fitted values with what the data say of them; a tied one shares its source's verdict."""
    rows = []
    for name, value in fit.values.items():
        status, (factor, source) = job.parameters.status[name], job.parameters.ties.get(name, (1.0, name))
        low, high = job.parameters.bounds.get(name, (math.nan, math.nan))
        condition = verdict.conditions.get(name, "")
        row = {"fold": fold.name, "method": "fitted", "parameter": name, "value": value, "status": status}
        row |= {**_UNKNOWN, "bound_low": low, "bound_high": high, "condition": condition}
        known, together = (some.get(source, False) for some in (verdict.determined, verdict.together))
        if status in ("free", "tied"):
            row["determined"] = name_determined(known and not condition, bool(condition) or known or together)
        if source in verdict.sds:
            row["low"] = factor * verdict.spread_low[source]
            row["high"] = factor * verdict.spread_high[source]
        if status == "free":
            row |= {"sd": verdict.sds[name], "note": verdict.notes[name]}
        elif status != "prior" or name in job.parameters.ties:
            tied = f"tied: {source}" if factor == 1 else f"tied: {factor:g} * {source}"
            note = ["fixed" if status == "fixed" else tied]
            row["note"] = "; ".join([*note, *filter(None, [condition])])
        rows.append(row)
    return rows


def list_error_fit(job: Job, fold: Fold, found: ErrorMinimisingFit | None) -> Iterator[Row]:
    """Yield the values with the least errors, each with its range (`low`, `high`) within the tolerance.

    Hyperparameters are of the likelihood alone.
    """
    if found is None:
        return
    parameters = job.problem(fold, "fitted_metric").parameters
    ranges = {one.name: one for one in found.ranges}
    for name, value in found.fit.values.items():
        if name in HYPERPARAMETERS:
            continue
        factor, source = parameters.ties.get(name, (1.0, name))
        row = {"fold": fold.name, "method": "fitted_metric", "parameter": name, "value": value, **_UNKNOWN}
        row["status"] = parameters.status[name]
        if source in parameters.bounds:
            low, high = (factor * bound for bound in parameters.bounds[source])
            row |= {"bound_low": low, "bound_high": high}
        if source in ranges:
            low, high = (to_value(source, end) for end in (ranges[source].low, ranges[source].high))
            row |= {"low": factor * low, "high": factor * high}
        yield row


def describe_error_fit(fold: Fold, found: ErrorMinimisingFit) -> Row:
    """Return the objective of the fit that minimises the errors, and its tolerance."""
    return {
        "fold": fold.name,
        "objective_mm": found.fit.objective,
        "tolerance_mm": found.tolerance.value,
        "tolerance_by_noise_mm": found.tolerance.by_noise,
        "tolerance_by_insertions_mm": found.tolerance.by_insertions,
        "evaluations": found.fit.evaluations,
    }


def list_directions(fold: Fold, fit: Fit, verdict: Identifiability) -> Iterator[Row]:
    """Yield the combinations of parameters that the posterior determines best; others have no SD."""
    for one in verdict.directions if fit.minimized == "posterior" else ():
        row = {"parameters": one.parameters, "sd": one.sd, "sd_ratio": one.sd_ratio, "note": one.words}
        yield {"fold": fold.name, **row}


def list_published(job: Job, fold: Fold, retuned: Fit | None) -> list[Row]:
    """Return the paper's set, and that set with the bevel alone fitted."""
    if job.hand_tuned is None:
        return []
    sets: dict[str, Mapping[str, Any]] = {"hand_tuned": job.hand_tuned}
    found: Mapping[str, bool] = {}
    if retuned is not None:
        sets["hand_tuned_b"] = retuned.values
        found = identify(job.problem(fold, "hand_tuned_b"), retuned).determined
    rows = []
    for method, values in sets.items():
        for name, value in values.items():
            free = method == "hand_tuned_b" and name == "bevel_mm"
            row = {"fold": fold.name, "method": method, "parameter": name, "value": value}
            row |= {"status": "free" if free else "published", **_UNKNOWN}
            rows.append(row | {"determined": name_determined(found.get(name, False), False) if free else ""})
    return rows
