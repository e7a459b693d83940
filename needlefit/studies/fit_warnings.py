"""Warn about a finished fit: parameters at bounds, a closer baseline, errors far from the noise floor."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import chdtr, chdtrc

from needlefit.arrays import Floats
from needlefit.inference.baselines import BASELINES
from needlefit.inference.identifiability.precision import BOUND_FRACTION, CUT_OFF_FRACTION, short_name
from needlefit.inference.parameters import Parameters, is_logarithmic
from needlefit.project.result_warnings import ResultWarning, read_warnings, warnings_entry
from needlefit.reporting.labels import medium_name
from needlefit.reporting.number_format import format_quantity
from needlefit.studies.job import Job
from needlefit.studies.run import Run
from needlefit.studies.summary import beats_fit, compare_methods
from needlefit.studies.validity import validity_warnings

VERDICT_KINDS = ("parameter_at_bound", "worse_than_baseline")
"""Of warnings that say that a fit's values, or its predictions, are not to be relied on."""


def add_warnings(results: Run, job: Job, predicted: Iterable[ResultWarning] = ()) -> Run:
    """Return results whose `run` also has the warnings about data, study, fit and predictions."""
    found = [*read_warnings(results.run), *job.warnings]
    found += validity_warnings(results.run)
    if not results.interrupted:
        found += [
            *bound_warnings(results),
            *cut_off_warnings(_list_intervals(results), {"": job.parameters}),
            *baseline_warnings(results),
            *noise_floor_warnings(results),
        ]
    return replace(results, run={**results.run, **warnings_entry([*found, *predicted])})


def verdict_warnings(run: Mapping[str, Any]) -> tuple[ResultWarning, ...]:
    """Return the warnings that belong under the verdict: a bound is reached, a baseline curve is closer."""
    return tuple(one for one in read_warnings(run) if one.kind in VERDICT_KINDS)


def bound_warnings(results: Run) -> Iterator[ResultWarning]:
    """Yield the parameters that a fit left at a bound, and in how many folds."""
    table = results.frames["parameters"]
    free = table[(table["method"] == "fitted") & (table["status"] == "free")]
    folds = table["fold"].nunique()
    for name, rows in free.groupby("parameter", sort=False):
        columns = (rows[key].to_numpy(dtype=np.float64) for key in ("value", "bound_low", "bound_high"))
        ends = [_describe_bound(str(name), *row) for row in zip(*columns, strict=True)]
        yield from _bound_warning(
            f"the fitted {short_name(str(name))}", ends, f" of {folds} folds" if folds > 1 else ""
        )


def _list_intervals(results: Run) -> pd.DataFrame:
    """Return the 95 % intervals of a fit's parameters; one whose profile is open reaches the bound."""
    table = results.frames["parameters"]
    free = table[(table["method"] == "fitted") & (table["status"] == "free")]
    ends = results.frames["identification"].reindex(columns=["fold", "parameter", "end_low", "end_high"])
    both = free.merge(ends, on=["fold", "parameter"], how="left")
    low, high = (
        both[f"interval_{end}"].where(both[f"end_{end}"] != "bound", both[f"bound_{end}"])
        for end in ("low", "high")
    )
    return pd.DataFrame(
        {
            "fit": "",
            **{name: both[name] for name in ("parameter", "value")},
            "p2_5": low.astype(float),
            "p97_5": high.astype(float),
        }
    )


def analysis_bound_warnings(
    fits: pd.DataFrame, parameters: Mapping[str, Parameters]
) -> Iterator[ResultWarning]:
    """Yield the parameters that fits of an analysis left at a bound, and in how many fits.

    Parameters
    ----------
    fits : DataFrame
        A row per fit and `parameter`, with its `value`; the first column names the parameters used.
    parameters : mapping
        These, by name.
    """
    for name, members in fits.groupby(fits.columns[0], sort=False):
        bounds = parameters[str(name)].bounds
        for parameter, rows in members.groupby("parameter", sort=False):
            if parameter in bounds:
                ends = [
                    _describe_bound(str(parameter), value, *bounds[str(parameter)]) for value in rows["value"]
                ]
                yield from _bound_warning(
                    f"the fitted {short_name(str(parameter))} of {name}", ends, f" of {len(rows)} fits"
                )


def cut_off_warnings(
    intervals: pd.DataFrame, parameters: Mapping[str, Parameters]
) -> Iterator[ResultWarning]:
    """Yield the parameters whose value is at no bound while its 95 % interval ends there, in how many fits.

    `intervals` is as the fits of `analysis_bound_warnings`, with `p2_5` and `p97_5` too.
    """
    for name, members in intervals.groupby(intervals.columns[0], sort=False):
        bounds = parameters[str(name)].bounds
        for parameter, rows in members.groupby("parameter", sort=False):
            low, high = bounds[str(parameter)]
            inside = rows[[not _describe_bound(str(parameter), one, low, high) for one in rows["value"]]]
            ends = [
                _describe_bound(str(parameter), end, low, high, CUT_OFF_FRACTION)
                for pair in zip(inside["p2_5"], inside["p97_5"], strict=True)
                for end in pair
            ]
            reached = [end for end in ends if end]
            if reached:
                of = f" of {name!s}" if name else ""
                count = f", in {len(reached)} of {len(rows)} fits" if len(rows) > 1 else ""
                yield ResultWarning(
                    "parameter_at_bound",
                    f"the 95 % interval of {short_name(str(parameter))}{of} ends at its "
                    f"{' and '.join(dict.fromkeys(reached))}{count}: the bound, not the data, limits it",
                    fix="check the data and what the model leaves out, or widen the bounds",
                )


def _bound_warning(what: str, ends: Sequence[str], of: str) -> Iterator[ResultWarning]:
    """Yield the warning about fits that ended at these bounds, "" for those that did not, if any did."""
    reached = [end for end in ends if end]
    if reached:
        bounds = " and ".join(dict.fromkeys(reached))
        where = f", in {len(reached)}{of}" if of else ""
        yield ResultWarning(
            "parameter_at_bound",
            f"{what} lies at its {bounds}{where}, so its value is no estimate",
            fix="check bevel sides, units and layers of the data, or widen the bounds in the tissue model",
        )


def _describe_bound(name: str, value: float, low: float, high: float, near: float = BOUND_FRACTION) -> str:
    """Return at which bound a value lies, to within the part `near` of the bounds; "" if at none."""
    least, at, most = (math.log(one) if is_logarithmic(name) else one for one in (low, value, high))
    place = (at - least) / (most - least)
    if place < near:
        return f"lower bound, {format_quantity(name, low)}"
    return f"upper bound, {format_quantity(name, high)}" if place > 1 - near else ""


def baseline_warnings(results: Run) -> Iterator[ResultWarning]:
    """Yield the closest baseline curve, if it is significantly closer to the scored insertions than the fit.

    That is by two standard errors, or by half of the error on a single insertion (`beats_fit`).
    """
    held_out = bool((results.frames["errors"]["role"] == "validate").any())
    role = "validate" if held_out else "tune"
    table = compare_methods(results, role=role)
    better = [row for _, row in table.iterrows() if row["method"] in BASELINES and beats_fit(row)]
    if better:
        best = min(better, key=lambda row: float(row["difference_mm"]))
        error, fit = best["ipe_mean_mm"], best["ipe_mean_mm"] - best["difference_mm"]
        which = "held-out insertions" if held_out else "insertions fitted to"
        # a curve follows errors of the entry pose, for which the fit allows
        within_noise = not held_out and fit - error < _mean_noise_floor(results)
        yield ResultWarning(
            "worse_than_baseline",
            f"{BASELINES[str(best['method'])].description} is closer to the {which} than the fitted model "
            f"(mean in-plane error {error:.3f} mm against {fit:.3f} mm)",
            fix="the difference is below the noise floor: compare both on held-out insertions"
            if within_noise
            else "do not rely on this model there; check bevel sides, layers and needle of the data",
        )


FAR_FROM_FLOOR = 2.0
"""Factor between in-sample errors and their noise floor, either way, below which no warning is given."""

CHANCE = 1e-3
"""Probability of such a factor by chance, below which it is one."""


def noise_floor_warnings(results: Run) -> Iterator[ResultWarning]:
    """Yield, by medium, that in-sample errors lie far below or far above their noise floor.

    The floor f is the mean error that the stated noise gives. If one error of the pose made up all of it,
    errors would be half-normal, e = f sqrt(pi / 2) |z|, and the sum of 2/pi (e / f)^2 over n insertions
    chi-square with n degrees of freedom. Noise of the points varies less, so that the test is conservative.
    """
    errors = results.frames["errors"].query(
        "role == 'tune' and method == 'fitted' and boundaries == 'measured'"
    )
    errors = errors[errors["floor_ipe_mean_mm"] > 0]
    squares = (errors["ipe_mean_mm"] / errors["floor_ipe_mean_mm"]) ** 2
    means = errors.assign(square=squares).groupby(["medium", "insertion"])["square"].mean()
    for medium, some in means.groupby("medium"):
        yield from _compare_with_floor(str(medium), some.to_numpy(np.float64))


def _compare_with_floor(medium: str, squares: Floats) -> Iterator[ResultWarning]:
    """Yield the warning about the squared ratios (n,) of errors and floor on a medium, if there is one."""
    count, rms, total = len(squares), float(np.sqrt(squares.mean())), 2 / np.pi * float(squares.sum())
    found = f"in-sample errors on {medium_name(medium)} (n = {count}) are {rms:.2g} × their noise floor"
    if rms < 1 / FAR_FROM_FLOOR and chdtr(count, total) < CHANCE:
        yield ResultWarning(
            "noise_too_large",
            f"{found}: the stated noise is too large",
            fix="measure point_sd_mm, pose_shift_sd_mm and pose_angle_sd_deg again",
        )
    if rms > FAR_FROM_FLOOR and chdtrc(count, total) < CHANCE:
        yield ResultWarning(
            "noise_too_small",
            f"{found}: the model misses something, or the stated noise is too small",
            fix="check bevel sides, layers and specimens of the data; intervals are too narrow",
        )


def _mean_noise_floor(results: Run) -> float:
    """Return the mean in-plane error that measurement noise alone gives, mm; 0 where none is stated."""
    floors = results.frames["errors"]["floor_ipe_mean_mm"].to_numpy(dtype=np.float64)
    return float(np.mean(floors[np.isfinite(floors)])) if np.isfinite(floors).any() else 0.0
