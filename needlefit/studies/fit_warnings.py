"""Warn about finished fits: one table of rules, each with its condition and the key of its text."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
import scipy

from needlefit.datasets.needles import ASSUMED
from needlefit.inference.doubts import Doubts
from needlefit.inference.identifiability.directions import (
    BOUND_FRACTION,
    CUT_OFF_FRACTION,
    UNINFORMED_SD_RATIO,
    find_bound_side,
)
from needlefit.inference.parameter_names import BEVEL_SPREAD, HYPERPARAMETERS, is_shape_parameter
from needlefit.inference.parameters import Parameters
from needlefit.inference.plausible import compute_cut_angle, list_implausible
from needlefit.inference.point_prediction import PointPrediction
from needlefit.mechanics.published import read_cut_angles, read_moduli
from needlefit.mechanics.shape import LIMITS
from needlefit.project.result_warnings import ResultWarning
from needlefit.project.unit_warnings import MU_PA
from needlefit.reporting.number_format import format_quantity
from needlefit.reporting.table_files import Row, select_rows, to_records
from needlefit.reporting.text import KindText
from needlefit.schemas.run_metadata import CountMetadata, FitMetadata, ValidityMetadata
from needlefit.studies.run import FitFrames, Run
from needlefit.studies.scored_groups import find_bevel_sides

TEXT = KindText("warnings")


def list_warnings(run: Run) -> list[ResultWarning]:
    """Return the warnings about a finished fit; of one that was interrupted those about its validity."""
    rules = {"validity": RULES["validity"]} if run.interrupted else RULES
    return [write_warning(kind, values) for kind, find in rules.items() for values in find(run)]


def write_warning(kind: str, values: Mapping[str, Any]) -> ResultWarning:
    """Return a warning in the words of `warnings.md.j2`, those of `values["text"]` if it has any."""
    key = values.get("text", kind)
    fix = TEXT.sentence(f"{key}_fix", values)
    return ResultWarning(kind, TEXT.sentence(key, values), values.get("place", ""), fix)


# ---- parameters at their bounds


def _find_bounds(run: Run) -> list[Row]:
    """Return the parameters that a fit left at a bound, and in how many folds; then intervals that end there.

    A shape parameter to which the data add nothing lies anywhere within its bounds, which are its prior.
    """
    keys = ["fold", "parameter"]
    frames = FitFrames.of(run)
    identified = frames.identification.reindex(columns=[*keys, "sd_ratio", "end_low", "end_high"])
    fits = frames.free_parameters.merge(identified, on=keys, how="left")
    shape = fits["parameter"].map(is_shape_parameter).to_numpy(dtype=bool)
    fits = fits[~(shape & (fits["sd_ratio"] >= UNINFORMED_SD_RATIO).to_numpy(dtype=bool))]
    for side in ("low", "high"):  # one whose profile is open reaches the bound
        end, is_open = fits[f"interval_{side}"], fits[f"end_{side}"] == "bound"
        fits = fits.assign(**{f"interval_{side}": end.mask(is_open, fits[f"bound_{side}"])})
    needles = run.knows(FitMetadata).dataset.rigidity.values()
    is_assumed = any(ASSUMED in needle.origin for needle in needles)
    found = _list_bounds(fits, "folds" if fits["fold"].nunique() > 1 else "")
    return [{**row, "is_assumed": is_assumed and str(row["parameter"]).startswith("mu")} for row in found]


def _list_bounds(fits: pd.DataFrame, many: str) -> list[Row]:
    """Return the values of the texts: which parameters lie at bounds, then which intervals end at them.

    `fits`: a row per fit and parameter, with its bounds.
    """
    described = []
    for name, rows in fits.groupby("parameter", sort=False):
        ends: dict[str, list[str]] = {"parameter_at_bound": [], "interval_at_bound": []}
        for row in to_records(rows):
            bounds = row["bound_low"], row["bound_high"]
            end_text = _describe_bound(str(name), row["value"], *bounds)
            interval = (row.get("interval_low"), row.get("interval_high"))
            cut = [_describe_bound(str(name), end, *bounds, CUT_OFF_FRACTION) for end in interval]
            ends["parameter_at_bound"] += [end_text]
            ends["interval_at_bound"] += [] if end_text else cut
        about = {"parameter": str(name), "total": len(rows), "many": many}
        for text, all_of_end in ends.items():
            if reached := list(filter(None, all_of_end)):
                bounds_reached = list(dict.fromkeys(reached))
                described.append({**about, "text": text, "count": len(reached), "bounds": bounds_reached})
    return sorted(described, key=lambda values: values["text"], reverse=True)


def _describe_bound(
    name: str, value: float | None, low: float, high: float, near: float = BOUND_FRACTION
) -> str:
    """Return at which bound a value lies, to within the part `near` of the bounds; "" if at none."""
    side = "" if value is None else find_bound_side(name, value, low, high, near)
    if not side or (side == "lower" and name == BEVEL_SPREAD):  # next to 0 it says that bevels do not differ
        return ""
    return f"{side} bound ({format_quantity(name, low if side == 'lower' else high)})"


# ---- the predictive median in place of the mode


def describe_point(point: PointPrediction, parameters: Parameters) -> Row:
    """Return what runs store of a choice between mode and median."""
    bounds = {
        name: f"{end} bound ({format_quantity(name, parameters.bounds[name][end == 'upper'])})"
        for name, end in point.at_bound.items()
    }
    return {"mode_fault": point.mode_fault, "at_bound": bounds}


def _find_medians(run: Run) -> Iterator[Row]:
    """Yield how many predictions are medians, and what is wrong with their modes."""
    if medians := run.knows(FitMetadata).medians:
        outside = any(median.mode_fault == "outside" for median in medians)
        yield {
            "count": len(medians),
            "at_bound": {name: bound for median in medians for name, bound in median.at_bound.items()},
            "mode_fault": "outside" if outside else "at_bound",
        }


# ---- errors beside the noise floor

#: largest factor between in-sample errors and their noise floor, either way, without a warning
FAR_FROM_FLOOR = 2.0
MAX_CHANCE = 1e-3  #: largest probability that errors are so far from the floor by chance, with a warning


def _find_wrong_noise(run: Run, too_large: bool) -> Iterator[Row]:
    """Yield the media in which in-sample errors lie far below (above) their noise floor: it is `too_large`.

    The floor f is the mean error that the stated noise gives. If one error of the pose made up all of it,
    errors would be half-normal, e = f sqrt(pi / 2) |z|, and the sum of 2/pi (e / f)^2 over n insertions
    chi-square with n degrees of freedom. Noise of the points varies less, so that the test is conservative.
    """
    errors = FitFrames.of(run).select_errors(role="tune", method="fitted")
    errors = errors[errors["floor_ipe_mean_mm"] > 0]
    squares = (errors["ipe_mean_mm"] / errors["floor_ipe_mean_mm"]) ** 2
    means = errors.assign(square=squares).groupby(["medium", "insertion"])["square"].mean()
    for medium, some in means.groupby("medium"):
        count, total, rms = len(some), 2 / np.pi * float(some.sum()), float(np.sqrt(some.mean()))
        far = rms < 1 / FAR_FROM_FLOOR if too_large else rms > FAR_FROM_FLOOR
        if far and (scipy.special.chdtr if too_large else scipy.special.chdtrc)(count, total) < MAX_CHANCE:
            yield {"medium": str(medium), "count": count, "rms": rms}


def _find_shared_residual(run: Run) -> Iterator[Row]:
    """Yield the residual that all insertions fitted to have in common, beyond the noise and beyond chance.

    The mean square of n independent residual curves would fall to 1/n in their mean; what part is left of it
    gives a t of n - 1 degrees of freedom. Depths of one hole are one curve.
    """
    frames = FitFrames.of(run)
    place = {"role": "tune", "method": "fitted", "boundaries": "measured"}
    errors, shapes = (select_rows(frame, **place) for frame in (frames.errors, frames.shapes))
    residuals = shapes["measured_y_mm"] - shapes["simulated_y_mm"]
    holes = shapes["insertion"].map(errors.drop_duplicates("insertion").set_index("insertion")["hole"])
    sides = shapes["insertion"].map(find_bevel_sides(run))
    for toward, signs in (("bevels", sides), ("axis", 1)) if len(shapes) else ():
        table = shapes.assign(hole=holes, residual=residuals * signs)
        curves = table.pivot_table(index="j", columns="hole", values="residual").to_numpy()
        shared, total = np.mean(curves.mean(axis=1) ** 2), np.mean(curves**2)
        count, rms = curves.shape[1], math.sqrt(shared)
        t = math.sqrt((count - 1) * shared / max(total - shared, 1e-12))
        if rms > errors["floor_ipe_mean_mm"].mean() and 2 * scipy.special.stdtr(count - 1, -t) < MAX_CHANCE:
            yield {"count": count, "rms": rms, "part": shared / total, "toward": toward}
            return


def warn_of_doubts(doubts: Doubts) -> list[ResultWarning]:
    """Return the warnings about needles that the others do not predict, and about stated boundaries."""
    rules = {"needle_outlier": _describe_doubts, "boundary_shift": _describe_shifted_boundary}
    return [write_warning(kind, values) for kind, describe in rules.items() for values in describe(doubts)]


def _describe_shifted_boundary(doubts: Doubts | FitMetadata) -> Iterator[Row]:
    """Yield the boundary that all needles put elsewhere."""
    if doubts.common_doubt is not None and doubts.common_doubt.stated is not None:
        yield vars(doubts.common_doubt)


def _describe_doubts(doubts: Doubts | FitMetadata) -> Iterator[Row]:
    if doubts.common_doubt is not None and doubts.common_doubt.stated is None:
        yield {**vars(doubts.common_doubt), "text": "all_needles"}
    for needle in doubts.odd_needles:
        yield {**vars(needle), "larger": needle.size is not None and needle.size > 0}
    if doubts.deviating is not None:
        yield {"text": "needles_deviate", "count": doubts.deviating[0], "total": doubts.deviating[1]}


def _find_implausible(run: Run) -> Iterator[Row]:
    """Yield the moduli that no tissue has; where all are plausible, a bevel that cuts at no published angle.

    Needles that follow the path of their tips are fitted by both. They are sound: no quick check names them.
    """
    fits = FitFrames.of(run).free_parameters
    medians = {str(name): float(values.median()) for name, values in fits.groupby("parameter")["value"]}
    spacing, is_soft = run.knows(FitMetadata).medium.constraint_spacing_mm, True
    count = fits["fold"].nunique()
    for name in list_implausible(medians, spacing):
        value = medians[name]
        if name.startswith("mu"):
            ends = {modulus.name: modulus.shear_pa[value > MU_PA[1]] for modulus in read_moduli().values()}
            nearest = (max if value > MU_PA[1] else min)(ends, key=lambda name: ends[name])
            factor, is_soft = max(value / ends[nearest], ends[nearest] / value), False
            about = {"published": ends[nearest], "published_of": nearest, "text": "modulus"}
            yield {"parameter": name, "value": value, "fits": count, "factor": factor, **about}
        elif is_soft:
            cut, angle = read_cut_angles(), compute_cut_angle(name, value, spacing)
            about = {"angle": angle, "low": cut.low, "high": cut.high, "text": "bevel"}
            yield {"parameter": name, "value": value, "fits": count, **about}


def _find_outside(run: Run) -> Iterator[Row]:
    """Yield the parts of the run that are outside what the model assumes."""
    if parts := list_outside(run.knows(FitMetadata).validity):
        yield {"parts": parts}


def _find_outside_modes(run: Run) -> Iterator[Row]:
    """Yield the parameters whose posterior mode lies outside their 95 % interval, and at no bound."""
    rows = FitFrames.of(run).free_parameters
    rows = rows[~rows["parameter"].isin(HYPERPARAMETERS)]
    outside = rows[(rows["value"] < rows["interval_low"]) | (rows["value"] > rows["interval_high"])]
    at_bound = [
        bool(_describe_bound(row["parameter"], row["value"], row["bound_low"], row["bound_high"]))
        for row in to_records(outside)
    ]
    outside = outside[~np.array(at_bound, dtype=bool)]
    several = rows["fold"].nunique() > 1
    for row in to_records(outside.drop_duplicates("parameter")):
        fold = row["fold"] if several else ""
        ends = {"low": row["interval_low"], "high": row["interval_high"]}
        yield {"parameter": row["parameter"], "value": row["value"], "fold": fold, **ends}


#: rules of fits and cross-validations, by the kind of the warning, which programs may rely on: run -> the
#: values of the text, for each case that applies
RULES: Mapping[str, Callable[[Run], Iterable[Row]]] = {
    "validity": _find_outside,
    "parameter_at_bound": _find_bounds,
    "mode_interval": _find_outside_modes,
    "predictive_median": _find_medians,
    "noise_too_large": partial(_find_wrong_noise, too_large=True),
    "noise_too_small": partial(_find_wrong_noise, too_large=False),
    "shared_residual": _find_shared_residual,
    "boundary_shift": lambda run: _describe_shifted_boundary(run.knows(FitMetadata)),
    "needle_outlier": lambda run: _describe_doubts(run.knows(FitMetadata)),
    "units": _find_implausible,
}


# ---- simulations outside what the model assumes

#: methods whose invalid predictions give a warning
FITTED_METHODS = ("fitted", "fitted_metric")
#: largest share of draws, or of their needles, outside the model's validity without a warning: tails may be
MAX_OUTSIDE_SHARE = 0.01
#: largest share of draws outside the model's validity with which parameters can be determined
MOSTLY_OUTSIDE = 0.5

_PREDICTED = "predictions of held-out insertions"


def tabulate_validity(
    folds: Sequence[Mapping[str, CountMetadata]], outside: Sequence[Row]
) -> ValidityMetadata:
    """Return the counts of all folds.

    folds
        By kind the simulations of each: "draws" of the posterior, of which one is outside if any of its
        insertions is; "predicted", needles of held-out insertions, one for each draw.
    outside
        Each scored simulation that is outside, by its method.
    """
    return ValidityMetadata(
        **{kind: add_counts(counts[kind] for counts in folds) for kind in ("draws", "predicted")},
        limits={name: limit for name, limit, _ in LIMITS},
        fitted_outside=sum(row["method"] in FITTED_METHODS for row in outside),
    )


def add_counts(counts: Iterable[CountMetadata]) -> CountMetadata:
    """Return the sum of some counts."""
    pairs = [(count.simulations, count.outside) for count in counts]
    simulations, outside = (sum(numbers) for numbers in zip((0, 0), *pairs, strict=True))
    return CountMetadata(simulations=simulations, outside=outside)


def list_outside(validity: ValidityMetadata) -> list[str]:
    """Return in words where fitted, drawn or predicted needles are outside the model's assumptions."""
    fitted = validity.fitted_outside
    counts = {"draws of the posterior": validity.draws, _PREDICTED: validity.predicted}
    return [
        *([f"{fitted} scored simulations of the fit"] if fitted else []),
        *(
            f"{count.outside} of {count.simulations} {words}"
            for words, count in counts.items()
            if count.outside > MAX_OUTSIDE_SHARE * count.simulations
        ),
    ]
