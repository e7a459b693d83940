"""Rows of the tables of a fit: its starts and its parameters."""

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from needlefit.inference.fit import Fit, Start
from needlefit.inference.identifiability.directions import name_determined
from needlefit.inference.identifiability.identify import (
    Identifiability,
    identify,
    objective_excess,
    within_tolerance,
)
from needlefit.inference.parameter_names import HYPERPARAMETERS
from needlefit.inference.problem import Problem
from needlefit.studies.identification import NO_SOURCE
from needlefit.studies.job import Fold, Job
from needlefit.studies.score import Row


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
    **dict.fromkeys(("sd", "low", "high"), math.nan),
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
        if status != "fixed":
            row["determined"] = name_determined(known and not condition, bool(condition) or known or together)
        if source in verdict.sds:
            row["low"] = factor * verdict.spread_low[source]
            row["high"] = factor * verdict.spread_high[source]
        if status == "free":
            row |= {"sd": verdict.sds[name], "note": verdict.notes[name]}
        else:
            tied = f"tied: {source}" if factor == 1 else f"tied: {factor:g} * {source}"
            note = ["fixed" if status == "fixed" else tied]
            row["note"] = "; ".join([*note, *filter(None, [condition])])
        rows.append(row)
    return rows


def list_error_fit(job: Job, fold: Fold, fit: Fit | None) -> Iterator[Row]:
    """Yield the values that minimise the errors; hyperparameters are of the likelihood alone."""
    parameters = job.problem(fold, "fitted_metric").parameters
    for name, value in () if fit is None else fit.values.items():
        if name in HYPERPARAMETERS:
            continue
        factor, source = parameters.ties.get(name, (1.0, name))
        row = {"fold": fold.name, "method": "fitted_metric", "parameter": name, "value": value, **_UNKNOWN}
        row["status"] = parameters.status[name]
        if source in parameters.bounds:
            ends = (factor * bound for bound in parameters.bounds[source])
            row |= dict(zip(("bound_low", "bound_high"), ends, strict=True))
        yield row


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
