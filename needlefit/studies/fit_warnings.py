"""Warn about finished fits: one table of rules, each with its condition and the key of its text."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import scipy

from needlefit.inference.identifiability.directions import (
    BOUND_FRACTION,
    CUT_OFF_FRACTION,
    UNINFORMED_SD_RATIO,
    short_name,
)
from needlefit.inference.parameters import BEVEL_SPREAD, is_logarithmic, is_shape_parameter
from needlefit.project.result_warnings import ResultWarning, read_warnings, warnings_entry
from needlefit.reporting.number_format import format_quantity
from needlefit.reporting.table_files import Row
from needlefit.reporting.text import KindText
from needlefit.studies.fit_frames import select_fitted, select_free
from needlefit.studies.run import Run
from needlefit.studies.validity import list_outside

if TYPE_CHECKING:
    from needlefit.studies.job import Job

TEXT = KindText("warnings")


@dataclass(frozen=True)
class WarningRule:
    """A kind of warning about a finished fit."""

    kind: str  #: of the warning, which programs may rely on
    find: Callable[[Run], Iterable[Row]]  #: the condition: run -> the values of the text, for each case found
    text: str = ""  #: key of the blocks of `warnings.md.j2`; the kind if empty
    complete: bool = True  #: whether only a run that was not interrupted is examined


def add_warnings(results: Run, job: "Job") -> Run:
    """Return results whose `run` also has the warnings about data, study, fit and predictions."""
    found = [*read_warnings(results.run), *job.warnings]
    found += [one for rule in RULES for one in apply_rule(rule, results)]
    return replace(results, run={**results.run, **warnings_entry(found)})


def apply_rule(rule: WarningRule, results: Run) -> Iterator[ResultWarning]:
    if not (rule.complete and results.interrupted):
        for values in rule.find(results):
            yield write_warning(rule.kind, values, rule.text)


def write_warning(kind: str, values: Mapping[str, Any], text: str = "") -> ResultWarning:
    """Return a warning in the words of `warnings.md.j2`."""
    key = text or kind
    return ResultWarning(kind, TEXT.sentence(key, values), fix=TEXT.sentence(f"{key}_fix", values))


# ---- parameters at their bounds


def _select_bounded(results: Run) -> pd.DataFrame:
    """Return the rows of free parameters that no bound should limit.

    A shape parameter to which the data add nothing lies anywhere within its bounds, which are its prior.
    """
    free, keys = select_free(results.frames["parameters"]), ["fold", "parameter"]
    ratios = results.frames["identification"].reindex(columns=[*keys, "sd_ratio"])
    shape = free["parameter"].map(is_shape_parameter).to_numpy(dtype=bool)
    uninformed = free[keys].merge(ratios, on=keys, how="left")["sd_ratio"] >= UNINFORMED_SD_RATIO
    return free[~(shape & uninformed.to_numpy())]


def _find_bounds(results: Run) -> Iterator[Row]:
    """Yield the parameters that a fit left at a bound, and in how many folds."""
    free = _select_bounded(results)
    folds = results.frames["parameters"]["fold"].nunique()
    for name, rows in free.groupby("parameter", sort=False):
        columns = (rows[key].to_numpy(dtype=np.float64) for key in ("value", "bound_low", "bound_high"))
        ends = [_describe_bound(str(name), *row) for row in zip(*columns, strict=True)]
        yield from _count_ends(str(name), ends, folds, "folds" if folds > 1 else "")


def _find_interval_bounds(results: Run) -> Iterator[Row]:
    """Yield the 95 % intervals of a fit that end at a bound; one whose profile is open reaches it."""
    ends = results.frames["identification"].reindex(columns=["fold", "parameter", "end_low", "end_high"])
    both = _select_bounded(results).merge(ends, on=["fold", "parameter"], how="left")
    for side in ("low", "high"):
        open_end = both[f"end_{side}"] == "bound"
        both[f"interval_{side}"] = both[f"interval_{side}"].mask(open_end, both[f"bound_{side}"])
    for name, rows in both.groupby("parameter", sort=False):
        bounds = (float(rows["bound_low"].iloc[0]), float(rows["bound_high"].iloc[0]))
        fits = rows[["value", "interval_low", "interval_high"]].astype(float).to_numpy().tolist()
        yield from _find_cut_off(str(name), fits, bounds)


def _find_cut_off(name: str, fits: Sequence[Sequence[float]], bounds: tuple[float, float]) -> Iterator[Row]:
    """Yield that intervals end at a bound; `fits` are value, low and high end of each."""
    reached = [
        end
        for value, *interval in fits
        if not _describe_bound(name, value, *bounds)
        for one in interval
        if (end := _describe_bound(name, one, *bounds, CUT_OFF_FRACTION))
    ]
    yield from _count_ends(name, reached, len(fits), "")


def _count_ends(name: str, ends: Sequence[str], total: int, many: str) -> Iterator[Row]:
    """Yield the values about fits that ended at these bounds, "" for those that did not, if any did."""
    reached = [end for end in ends if end]
    if reached:
        about = {"parameter": short_name(name), "bounds": list(dict.fromkeys(reached))}
        yield {**about, "count": len(reached), "total": total, "many": many}


def _describe_bound(name: str, value: float, low: float, high: float, near: float = BOUND_FRACTION) -> str:
    """Return at which bound a value lies, to within the part `near` of the bounds; "" if at none."""
    least, at, most = (math.log(one) if is_logarithmic(name) else one for one in (low, value, high))
    place = (at - least) / (most - least)
    if place < near and name != BEVEL_SPREAD:  # next to 0 it says that bevels do not differ
        return f"lower bound, {format_quantity(name, low)}"
    return f"upper bound, {format_quantity(name, high)}" if place > 1 - near else ""


# ---- errors beside the noise floor

#: factor between in-sample errors and their noise floor, either way, below which no warning is given
FAR_FROM_FLOOR = 2.0
CHANCE = 1e-3  #: probability of such a factor by chance, below which it is one


def _find_wrong_noise(results: Run, too_large: bool) -> Iterator[Row]:
    """Yield the media in which in-sample errors lie far below (above) their noise floor: it is `too_large`.

    The floor f is the mean error that the stated noise gives. If one error of the pose made up all of it,
    errors would be half-normal, e = f sqrt(pi / 2) |z|, and the sum of 2/pi (e / f)^2 over n insertions
    chi-square with n degrees of freedom. Noise of the points varies less, so that the test is conservative.
    """
    errors = select_fitted(results.frames["errors"], "tune")
    errors = errors[errors["floor_ipe_mean_mm"] > 0]
    squares = (errors["ipe_mean_mm"] / errors["floor_ipe_mean_mm"]) ** 2
    means = errors.assign(square=squares).groupby(["medium", "insertion"])["square"].mean()
    for medium, some in means.groupby("medium"):
        count, total, rms = len(some), 2 / np.pi * float(some.sum()), float(np.sqrt(some.mean()))
        far = rms < 1 / FAR_FROM_FLOOR if too_large else rms > FAR_FROM_FLOOR
        if far and (scipy.special.chdtr if too_large else scipy.special.chdtrc)(count, total) < CHANCE:
            yield {"medium": str(medium), "count": count, "rms": rms}


#: of fits and cross-validations, in the order in which their warnings are kept
RULES: Sequence[WarningRule] = (
    WarningRule(
        "validity",
        lambda run: [{"parts": parts}] if (parts := list_outside(run.run)) else [],
        complete=False,
    ),
    WarningRule("parameter_at_bound", _find_bounds),
    WarningRule("parameter_at_bound", _find_interval_bounds, "interval_at_bound"),
    WarningRule("noise_too_large", partial(_find_wrong_noise, too_large=True)),
    WarningRule("noise_too_small", partial(_find_wrong_noise, too_large=False)),
)
