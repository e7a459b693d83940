"""The tables of a fit or cross-validation, and rows of them: its starts and its parameters."""

import math
from collections.abc import Iterator, Mapping
from types import MappingProxyType

import numpy as np

from needlefit.datasets.folds import Fold
from needlefit.inference.error_fit import ErrorMinimisingFit
from needlefit.inference.fit import Fit, Start
from needlefit.inference.identifiability.directions import (
    UNINFORMED_SD_RATIO,
    find_bound_side,
    name_determined,
)
from needlefit.inference.identifiability.verdict import Identifiability, objective_excess, within_tolerance
from needlefit.inference.parameter_names import HYPERPARAMETERS, to_value
from needlefit.inference.problem import Problem
from needlefit.reporting.table_files import Row
from needlefit.studies.identification import FROM_PRIOR, IDENTIFICATION_COLUMNS, PROFILE_COLUMNS, ParameterRow
from needlefit.studies.job import Job
from needlefit.studies.needle_placement import NEEDLE_COLUMNS
from needlefit.studies.observations import PREDICTIVE_COLUMNS
from needlefit.studies.observations.tip_track import END_COLUMNS, READING_COLUMNS
from needlefit.studies.score import ERROR_COLUMNS, SCORE_KEYS

# columns that each table has at least
FRAMES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "errors": ERROR_COLUMNS,
        # the curves that "errors" compares, j = 0 the entry (or the first scored point)
        "shapes": (
            *(*SCORE_KEYS, "j", "measured_x_mm", "measured_y_mm", "measured_z_mm"),
            *("simulated_x_mm", "simulated_y_mm", "simulated_z_mm"),
        ),
        # every start of every search, then a column per parameter. `objective` is what was `minimized`: the
        # negative log "posterior", or mm of the "metric"; `excess` is how far it is above the best of its
        # search, in units of the tolerance (0.1; 1 % or 0.002 mm); `joined` is the start that it met and
        # went on with.
        "starts": (
            *("fold", "fit", "start", "minimized", "objective", "excess", "within_tolerance"),
            *("evaluations", "gradients", "failed_solves", "stopped", "joined"),
        ),
        "parameters": ParameterRow._fields,
        # per fold the objective of the error-minimising fit, at the reported point, at the least one, and
        # the tolerance within which it is not significantly larger, with its two estimates.
        "error_fit": (
            *("fold", "objective_mm", "tolerance_mm"),
            *("tolerance_by_noise_mm", "tolerance_by_insertions_mm", "evaluations"),
        ),
        # combinations of parameters, and the SD to which each is known
        "directions": ("fold", "parameters", "sd", "sd_ratio", "note"),
        "identification": IDENTIFICATION_COLUMNS,
        "profiles": PROFILE_COLUMNS,
        "predictive": PREDICTIVE_COLUMNS,
        # where each insertion held out was predicted to be measured, at its measured x: the median, and the
        # ends of simultaneous bands
        "bands": (
            *("fold", "insertion", "x_mm", "measured_mm", "median_mm"),
            *("low_50_mm", "high_50_mm", "low_95_mm", "high_95_mm"),
        ),
        # the reading of every sensor along y, in space along z, as measured and predicted
        "curvature": (
            *("fold", "insertion", "s_mm", "direction", "kappa_1_per_mm"),
            *("kappa_predicted_1_per_mm", "kappa_sd_1_per_mm", "kappa_in_95"),
        ),
        "readings": READING_COLUMNS,
        "ends": END_COLUMNS,
        # draws of each fold's parameters, with Pareto's k where by importance. `specimen` is "(tuned)" (of
        # several that differ, their mean), one of several that differ, or "(new)"; then a column per
        # parameter.
        "draws": ("fold", "specimen", "draw_source", "pareto_k", "ess", "certified"),
        # how much parameters differ between the specimens that were fitted, by the logarithm: SD, and
        # correlation of mu with the bevel parameter. Empty where one set is for all.
        "population": ("fold", "parameter", "between_sd", "between_correlation", "other_specimens"),
        "needles": NEEDLE_COLUMNS,
    }
)


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


def list_fitted(job: Job, fold: Fold, fit: Fit, verdict: Identifiability) -> Iterator[ParameterRow]:
    """Yield the fitted values with what the data determine; a tied one shares its source's verdict."""
    parameters = job.parameters
    for name, value in fit.values.items():
        status, (factor, source) = parameters.status[name], parameters.ties.get(name, (1.0, name))
        low, high = parameters.bounds.get(name, (math.nan, math.nan))
        condition = verdict.conditions.get(name, "")
        row = ParameterRow(fold.name, "fitted", name, value, status, low, high, condition=condition)
        determined, together = (some.get(source, False) for some in (verdict.determined, verdict.together))
        if status in ("free", "tied"):
            together = bool(condition) or determined or together
            row = row._replace(determined=name_determined(determined and not condition, together))
        if source in verdict.sds:
            low, high = factor * verdict.spread_low[source], factor * verdict.spread_high[source]
            row = row._replace(low=low, high=high)
        if status == "free":
            row = row._replace(sd=verdict.sds[name], note=verdict.notes[name])
            if verdict.sds[name] >= UNINFORMED_SD_RATIO * parameters.prior.sd(name):
                row = row._replace(condition=condition or FROM_PRIOR)
        elif status != "prior" or name in parameters.ties:
            tied = f"tied: {source}" if factor == 1 else f"tied: {factor:g} * {source}"
            notes = ["fixed" if status == "fixed" else tied, condition]
            row = row._replace(note="; ".join(filter(None, notes)))
        yield row


def list_error_fit(job: Job, fold: Fold, error_fit: ErrorMinimisingFit | None) -> Iterator[ParameterRow]:
    """Yield the values with the least errors, each with its range (`low`, `high`) within the tolerance.

    NaN is a value at a bound: errors alone do not determine it.
    Hyperparameters are of the likelihood alone.
    """
    if error_fit is None:
        return
    parameters = job.problem(fold, "fitted_metric").parameters
    ranges = {error_range.name: error_range for error_range in error_fit.ranges}
    for name, value in error_fit.fit.values.items():
        if name in HYPERPARAMETERS:
            continue
        factor, source = parameters.ties.get(name, (1.0, name))
        row = ParameterRow(fold.name, "fitted_metric", name, value, parameters.status[name])
        if source in parameters.bounds:
            low, high = (factor * bound for bound in parameters.bounds[source])
            is_at_bound = find_bound_side(name, value, low, high) != ""
            row = row._replace(value=math.nan if is_at_bound else value, bound_low=low, bound_high=high)
        if source in ranges:
            low, high = (to_value(source, end) for end in (ranges[source].low, ranges[source].high))
            row = row._replace(low=factor * low, high=factor * high)
        yield row


def describe_error_fit(fold: Fold, error_fit: ErrorMinimisingFit) -> Row:
    """Return the objective of the fit that minimises the errors, and its tolerance."""
    return {
        "fold": fold.name,
        "objective_mm": error_fit.fit.objective,
        "tolerance_mm": error_fit.tolerance.value,
        "tolerance_by_noise_mm": error_fit.tolerance.by_noise,
        "tolerance_by_insertions_mm": error_fit.tolerance.by_insertions,
        "evaluations": error_fit.fit.evaluations,
    }


def list_directions(fold: Fold, fit: Fit, verdict: Identifiability) -> Iterator[Row]:
    """Yield the combinations of parameters that the posterior determines best; others have no SD."""
    for direction in verdict.directions if fit.minimized == "posterior" else ():
        row = {
            "parameters": direction.parameters,
            "sd": direction.sd,
            "sd_ratio": direction.sd_ratio,
            "note": direction.words,
        }
        yield {"fold": fold.name, **row}


def list_published(job: Job, fold: Fold) -> Iterator[ParameterRow]:
    """Yield the paper's set."""
    for name, value in (job.hand_tuned or {}).items():
        yield ParameterRow(fold.name, "hand_tuned", name, value, "published")
