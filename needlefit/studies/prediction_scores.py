"""Score a predictive distribution: its intervals, its bands, and what became of it (CRPS, PIT, coverage).

Then how well intervals cover insertions, how wide they are, and errors in units of the noise.
"""

import math
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np
import pandas as pd
import scipy
from scipy.spatial.distance import pdist

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion
from needlefit.inference.curve_bands import CurveBands
from needlefit.inference.likelihood.observations.curvature import SENSOR_STEP_MM
from needlefit.inference.predictive_mixture import (
    INTERVAL_PROBABILITIES,
    PredictiveMixture,
    cdf,
    crps,
    interval,
    quantile,
)
from needlefit.inference.proportion import Proportion, estimate_proportion
from needlefit.metrics import CURVATURE_RMS, OVER_NOISE, TE, TRACK_RMS, verdict_metrics
from needlefit.reporting.table_files import Row

BAND_POINTS = 41  #: number of points of a band that are kept, of up to some 200


def list_band_ends(bands: CurveBands) -> dict[str, Floats]:
    """Return the ends (K,) of simultaneous bands, by what their columns begin with."""
    return {
        f"{side}_{100 * level:.0f}": end
        for level in INTERVAL_PROBABILITIES
        for side, end in zip(("low", "high"), bands.ends(level), strict=True)
    }


def tabulate_band(mixture: PredictiveMixture, bands: CurveBands, measured: Floats) -> Iterator[Row]:
    """Yield median and bands at some of the measured points (K, 2 or 3), the tip the last."""
    kept = np.unique(np.linspace(0, len(measured) - 1, BAND_POINTS).round().astype(np.int64))
    columns = {"x_mm": measured[kept, 0]}
    for plane, ending in enumerate(("mm", "z_mm")[: measured.shape[1] - 1]):
        rows = kept + plane * len(measured)
        (median,) = quantile(PredictiveMixture(mixture.means[:, rows], mixture.sd[rows]), (0.5,))
        columns |= {f"measured_{ending}": measured[kept, 1 + plane], f"median_{ending}": median}
        columns |= {f"{name}_{ending}": end[rows] for name, end in list_band_ends(bands).items()}
    for k in range(len(kept)):
        yield {name: float(values[k]) for name, values in columns.items()}


def tabulate_sensors(insertion: Insertion, about: Floats) -> Iterator[Row]:
    """Yield the curvature at each sensor, from simulated points (B, 3 n, 2 or 3) about the n sensors."""
    if insertion.curvature is None:
        return
    from_tip, *measured, sd = insertion.curvature.T
    across = about.reshape(len(about), len(sd), 3, -1)[..., 1:]
    bent = np.diff(across, n=2, axis=2)[:, :, 0] / SENSOR_STEP_MM**2  # (B, n, planes)
    for plane, direction in enumerate(("y", "z")[: bent.shape[-1]]):
        mixture = PredictiveMixture(bent[..., plane], sd)
        low, high = interval(mixture, 0.95)
        for k, kappa in enumerate(measured[plane]):
            yield {
                **{"s_mm": insertion.depth - from_tip[k], "direction": direction, "kappa_1_per_mm": kappa},
                "kappa_predicted_1_per_mm": mixture.means[:, k].mean(),
                "kappa_sd_1_per_mm": math.hypot(mixture.means[:, k].std(), sd[k]),
                "kappa_in_95": bool(low[k] <= kappa <= high[k]),
            }


#: column that only predictions of curvatures have: the mean score of their readings
CURVATURE_CRPS = "curvature_crps_1_per_m"
SHAPE_CRPS = "shape_crps_mm"
#: column of the mean score over the noise, where insertions have different observations
CRPS_OVER_NOISE = "crps_over_noise"


class PredictedScore(NamedTuple):
    """Columns of the table "predictive" that belong to a metric of verdicts."""

    crps: str  #: continuous ranked probability score
    covered: str  #: what their names of coverage begin with: the tip alone, or all that was read of a needle


#: scores of predictions by metric of verdicts
PREDICTED = {
    TE.name: PredictedScore("tip_crps_mm", "tip"),
    TRACK_RMS.name: PredictedScore(SHAPE_CRPS, "tip"),
    CURVATURE_RMS.name: PredictedScore(CURVATURE_CRPS, "shape"),
    OVER_NOISE.name: PredictedScore(CRPS_OVER_NOISE, "shape"),
}
#: columns that predictions in space have besides; there `tip_pit` is the probability of a tip nearer to the
#: centre, by the spread of tips, `tip_crps_mm` the energy score, and `tip_in_95` is by `tip_pit`
SPATIAL_COLUMNS = ("tip_z_measured_mm", "tip_z_median_mm", "tip_z_95_low_mm", "tip_z_95_high_mm")


def score_tip_in_space(tips: Floats, centre: Floats, measured: Floats) -> Row:
    """Return what became of the prediction of a tip (2,) across the needle, by predicted tips (B, 2).

    The energy score is mean |X - y| - mean |X - X'| / 2 (T. Gneiting, A. E. Raftery, JASA 102 (2007) 359).
    """
    root = np.linalg.cholesky(np.cov(tips.T))
    sizes = np.linalg.norm(np.linalg.solve(root, (tips - centre).T), axis=0)
    pit = float(np.mean(sizes < np.linalg.norm(np.linalg.solve(root, measured - centre))))
    apart = pdist(tips).mean() * (len(tips) - 1) / len(tips)
    low, high = np.quantile(tips[:, 1], [0.025, 0.975]).tolist()
    ends: Row = {}
    for level in INTERVAL_PROBABILITIES:  # along y
        pair = np.quantile(tips[:, 0], [(1 - level) / 2, (1 + level) / 2]).tolist()
        ends |= {
            f"tip_{100 * level:.0f}_{end}_mm": value for end, value in zip(("low", "high"), pair, strict=True)
        }
    (y, z), (y_median, z_median) = measured.tolist(), centre.tolist()
    return {
        **{"tip_measured_mm": y, "tip_median_mm": y_median},
        **{"tip_z_measured_mm": z, "tip_z_median_mm": z_median},
        **{"tip_z_95_low_mm": low, "tip_z_95_high_mm": high, **ends},
        **{"tip_pit": pit, "tip_in_50": pit <= 0.5, "tip_in_95": pit <= 0.95},
        "tip_crps_mm": float(np.linalg.norm(tips - measured, axis=1).mean() - apart / 2),
        "tip_interval_score_mm": math.nan,
    }


def find_end_error(mixture: PredictiveMixture, count: int) -> float:
    """Return the Monte Carlo error of the ends of the tip's widest interval, in parts of its width.

    An end is the quantile of a probability p that draws give with a standard error e: it errs by half the
    distance between the quantiles of p - e and p + e. Of two planes, with `count` points in each, the larger
    error.
    """
    draws, level = len(mixture.means), max(INTERVAL_PROBABILITIES)
    p, end_error = np.array([(1 - level) / 2, (1 + level) / 2]), 0.0
    for tip in range(count - 1, mixture.means.shape[1], count):
        tip_mixture = PredictiveMixture(mixture.means[:, [tip]], mixture.sd[[tip]])
        if not tip_mixture.sd.all():
            return math.inf
        ends = quantile(tip_mixture, p)[:, 0]
        error = scipy.special.ndtr((ends - tip_mixture.means) / tip_mixture.sd).std(axis=0) / math.sqrt(draws)
        low, high = quantile(tip_mixture, np.clip([p - error, p + error], 0.5 / draws, 1 - 0.5 / draws))[
            ..., 0
        ]
        end_error = max(end_error, float((high - low).max() / 2 / np.ptp(ends)))
    return end_error


def score_shape(mixture: PredictiveMixture, measured: Floats, shape_pit: float) -> Row:
    """Return what became of the prediction of points, or of readings, (K,) as a whole."""
    pit, row = cdf(mixture, measured), Row(shape_pit=shape_pit)
    for level in INTERVAL_PROBABILITIES:
        name = f"{100 * level:.0f}"
        row |= {f"shape_in_{name}": shape_pit <= level}
        row |= {f"points_in_{name}": bool((np.abs(pit - 0.5) <= level / 2).all())}
    return row


def score_tip(mixture: PredictiveMixture, measured: Floats) -> Row:
    """Return what became of the prediction of the last of some points (K,): the tip."""
    tip = PredictiveMixture(mixture.means[:, -1:], mixture.sd[-1:])
    tip_place = float(measured[-1])
    ends = [(1 + side * level) / 2 for level in INTERVAL_PROBABILITIES for side in (-1, 1)]
    median, *quantiles = quantile(tip, (0.5, *ends))[:, 0].tolist()  # one search finds them all
    row: Row = {"tip_measured_mm": tip_place, "tip_median_mm": median}
    row |= {name: score(tip, tip_place).item() for name, score in (("tip_pit", cdf), ("tip_crps_mm", crps))}
    for level, low, high in zip(INTERVAL_PROBABILITIES, quantiles[::2], quantiles[1::2], strict=True):
        name = f"{100 * level:.0f}"
        row |= {f"tip_{name}_low_mm": low, f"tip_{name}_high_mm": high}
        row |= {f"tip_in_{name}": low <= tip_place <= high}
    # width, and what lies outside at 2 / (1 - level) of it: T. Gneiting, A. E. Raftery, JASA 102 (2007) 359
    beyond = max(low - tip_place, tip_place - high, 0.0)
    return row | {"tip_interval_score_mm": high - low + 2 / (1 - level) * beyond}


# ---- how well intervals cover insertions

#: column of the Monte Carlo standard error of the width of a tip's 95 % interval
WIDTH_ERROR_COLUMN = "tip_95_width_error_mm"
#: column of the expected width of the tip's 95 % interval after one measured insertion into the new specimen
AFTER_ONE_COLUMN = "tip_95_width_after_one_mm"


def join_trials(rows: pd.DataFrame) -> list[int]:
    """Return the trial of each row: rows of the same fold, specimen or hole are of one trial."""
    trial = list(range(len(rows)))
    for key in (rows["fold"], rows["specimen"], rows["specimen"] + "/" + rows["hole"]):
        first = dict[str, int]()
        for number, name in enumerate(key):
            old, new = trial[number], trial[first.setdefault(name, number)]
            trial = [new if number == old else number for number in trial]
    return trial


def count_covered(predictive: pd.DataFrame, column: str) -> Proportion:
    """Return how many insertions lie in their predicted interval; `column` is such as "tip_in_95".

    Its interval counts trials (`join_trials`); of one trial it says nothing.
    """
    return estimate_proportion(list(predictive[column]), [str(trial) for trial in join_trials(predictive)])


def measure_tips(predictive: pd.DataFrame, which: str) -> "pd.Series[float]":
    """Return how far tips deflect, mm: "measured", or the "median" predicted."""
    y, z = f"tip_{which}_mm", f"tip_z_{which}_mm"
    across = predictive[y].abs()
    return across.combine(predictive[z], math.hypot) if z in predictive else across


def median_width(predictive: pd.DataFrame) -> float:
    """Return the median width of the 95 % intervals of tips, mm; in space of the wider one of y and z."""
    width = predictive["tip_95_high_mm"] - predictive["tip_95_low_mm"]
    if "tip_z_95_high_mm" in predictive:
        width = width.combine(predictive["tip_z_95_high_mm"] - predictive["tip_z_95_low_mm"], max)
    return float(width.median())


def tip_error_of_medians(predictive: pd.DataFrame) -> float:
    """Return the mean distance of the medians of predicted tips from the measured ones, mm."""
    off = (predictive["tip_median_mm"] - predictive["tip_measured_mm"]).abs()
    if "tip_z_median_mm" in predictive:
        out = predictive["tip_z_median_mm"] - predictive["tip_z_measured_mm"]
        off = off.combine(out, math.hypot)
    return float(off.mean())


COVERAGE_COLUMNS = (
    *("insertions", "tip_in_50", "tip_in_95", "tip_95_width_mm", "tip_median_error_mm"),
    *("shape_in_50", "shape_in_95", "tip_crps_mm", "tip_interval_score_mm"),
)
"""Columns of how well needles were predicted."""


def tabulate_coverage(predictions: pd.DataFrame) -> Row:
    """Return the cells of `COVERAGE_COLUMNS` for some needles: shares within intervals, width, mean score.

    Of curvatures alone no tip is known: those cells are empty.
    """
    asked = [name for name in COVERAGE_COLUMNS if "_in_" in name]
    known = [name for name in asked if predictions[name].notna().any()]
    proportions = {name: count_covered(predictions, name) for name in known}
    shares = {
        name: f"{proportion.hits} ({100 * proportion.low:.0f}–{100 * proportion.high:.0f} %)"
        if proportion.groups > 1
        else str(proportion.hits)
        for name, proportion in proportions.items()
    }
    return {
        **dict.fromkeys(asked),
        **shares,
        "insertions": len(predictions),
        "tip_95_width_mm": median_width(predictions),
        "tip_median_error_mm": tip_error_of_medians(predictions),
        **{name: predictions[name].mean() for name in ("tip_crps_mm", "tip_interval_score_mm")},
    }


#: largest width (mm) of a tip's 95 % interval that serves for aiming, unless a recipe states another
MAX_AIMING_WIDTH_MM = 2.0


def estimate_width_after_one(tips: Floats, known_tips: Floats) -> float:
    """Return how wide the central 95 % of tips are once the tip of another insertion is measured, mm.

    `tips` (B,) are those of an insertion, one for each draw of the parameters, mm; NaN where there is none.
    `known` (B,) are measured tips of another insertion into the same specimen with the same parameters, mm:
    what tips share with them is subtracted, linear in them.
    """
    solved = np.isfinite(tips) & np.isfinite(known_tips)
    (variance, shared), _ = np.cov(known_tips[solved], tips[solved])
    low, high = np.nanquantile(tips - shared / variance * known_tips, [0.025, 0.975])
    return float(high - low)


# ---- errors in units of the noise


def add_errors_over_noise(frames: Mapping[str, pd.DataFrame]) -> dict[str, pd.DataFrame]:
    """Return the frames of a run, with errors and CRPS over the noise of roles whose insertions differ.

    A verdict on needles of which some have shapes, some tips, tracks or curvatures, or that have several of
    these, is on what each of them holds: the mean of its errors by the metrics of verdicts, each divided by
    its noise floor.
    """
    errors, predictive = (frames[name] for name in ("errors", "predictive"))
    metrics = [
        metric.name
        for metric in verdict_metrics()
        if metric.name in errors and f"floor_{metric.name}" in errors
    ]
    held = errors[metrics].notna()
    if {TRACK_RMS.name, TE.name} <= {*metrics}:
        held[TE.name] &= ~held[TRACK_RMS.name]  # the tip of a track is one of its readings
    kinds = (held @ 2 ** np.arange(len(metrics))).groupby(errors["role"]).transform("nunique")
    mixed = (kinds > 1) | (held.sum(axis=1) > 1)
    if not mixed.any():
        return {**frames}
    floors = errors[[f"floor_{name}" for name in metrics]].set_axis(metrics, axis=1)
    over = (errors[metrics] / floors).where(held).mean(axis=1).where(mixed)
    tested = floors.where(held)[mixed & (errors["role"] == "validate")].groupby(errors["insertion"]).first()
    parts = [
        predictive[column] / predictive["insertion"].map(tested[name])
        for name in metrics
        if (column := PREDICTED[name].crps) in predictive
    ]
    crps = pd.concat(parts, axis=1).mean(axis=1) if parts else float("nan")
    errors = errors.assign(**{OVER_NOISE.name: over, f"floor_{OVER_NOISE.name}": over.notna().astype(float)})
    return {**frames, "errors": errors, "predictive": predictive.assign(**{CRPS_OVER_NOISE: crps})}
