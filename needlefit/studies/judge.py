"""Judge predictions: the checks of the first page, and the verdict, from the stored tables of a run.

One fit is described: "predicts", "predicts in part" or "does not predict" these needles. Several fits are
judged by paired differences between our scores and those of each curve. Insertions that share a fit, a
specimen or a hole err alike: their mean is one trial. Scores are the tip error of the predictive median, and
the CRPS of the predicted tip. A curve predicts a point; its CRPS is its error. Of two that miss alike a
distribution has the smaller CRPS, and a wrong spread is seen in CRPS alone: both scores are needed.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import pandas as pd
import scipy

from needlefit.inference.baselines import BASELINES
from needlefit.schemas.recipe import RecipeRecord
from needlefit.studies.advice import list_contradictions, list_doubts
from needlefit.studies.answer import Check, Finding, Status, is_printed_as_one
from needlefit.studies.coverage import MAX_AIMING_WIDTH_MM, count_covered, measure_tips, median_width
from needlefit.studies.fit_frames import MEDIAN_METHOD
from needlefit.studies.run import Run
from needlefit.studies.scored_groups import TE, ScoredGroup, pool_insertions, select_group

#: tip error over the measurement noise, up to which one fit predicts, and beyond which it does not
MAX_NOISE_RATIO, FAR_NOISE_RATIO = 2.0, 5.0
#: probability of each error: to call fits that are as good as a curve better, or worse
SIGNIFICANCE = 0.05
SIDES = {"smaller": 1.0, "larger": -1.0}  #: signs of Student's t of a smaller and of a larger score
MIN_COVERED_95, COVERED_50 = 0.9, (0.25, 0.75)  #: shares of tips in their intervals that pass
MIN_TIPS_50 = 4  #: tips below which their share in 50 % intervals cannot be judged
CRPS = "tip_crps_mm"  #: column of the table "predictive": continuous ranked probability score of a tip

Outcome = Literal[
    "predicts", "in part", "does not predict", "generalises", "not shown", "does not generalise"
]
STATUS: Mapping[Outcome, Status] = {
    **{"predicts": "pass", "in part": "warn", "does not predict": "fail"},
    **{"generalises": "pass", "not shown": "warn", "does not generalise": "fail"},
}
#: whether several fits are closer than every curve; None: not shown
CLOSER: Mapping[Outcome, bool | None] = {
    "generalises": True,
    "not shown": None,
    "does not generalise": False,
}


@dataclass(frozen=True)
class Judgement:
    """What the verdict on some insertions states."""

    outcome: Outcome
    error_mm: float  #: mean tip error
    noise_ratio: float | None  #: over that of the measurement noise; None where none is stated
    curve: str  #: the curve without mechanics that is closest, by its name; "" without any
    curve_mm: float | None
    fits: int | None = None  #: of how many fits, if of several

    @property
    def equals_noise(self) -> bool:
        """Whether the error is that of the measurement noise, as far as it is printed."""
        return self.noise_ratio is not None and is_printed_as_one(self.noise_ratio)

    @property
    def curve_is_closer(self) -> bool:
        return self.curve_mm is not None and self.curve_mm < self.error_mm


def choose_method(run: Run) -> str:
    """Return the method whose errors are judged: the predictive median, of a run without any the fit."""
    return MEDIAN_METHOD if (run.frames["errors"]["method"] == MEDIAN_METHOD).any() else "fitted"


def judge(run: Run, group: ScoredGroup) -> Judgement | None:
    """Judge the predictions of a group of insertions; None if no simulation of it converged."""
    method = choose_method(run)
    error = group.get(TE, method=method)
    if error is None:
        return None
    ratio, curve = group.over_floor(TE, method=method), find_closest_curve(group)
    nearest = None if curve is None else group.get(TE, method=curve)
    fits = run.frames["errors"]["fold"].nunique()
    if fits > 1:
        errors = select_group(run.frames["errors"], group)
        held = errors[(errors["role"] == "validate") & (errors["boundaries"] == "measured")]
        if method == MEDIAN_METHOD:
            scores = run.frames["predictive"][["fold", "insertion", CRPS]]
            held = held.merge(scores.assign(method=method), "left", ["fold", "insertion", "method"])
        outcome = judge_fits(held, method, TE)
    else:
        outcome = describe_fit(error, ratio, nearest)
    return Judgement(outcome, error, ratio, curve or "", nearest, fits if fits > 1 else None)


def judge_tracks(runs: pd.DataFrame, error_mm: float, curve_mm: float) -> Outcome:
    """Judge predicted tip tracks by their table "runs"; describe one fit by its mean error and a curve's."""
    if runs["fold"].nunique() == 1:
        return describe_fit(error_mm, None, curve_mm)
    named = {"run": "hole", "rms_mm": TE, "crps_mm": CRPS}
    each = runs["run"] + runs["direction"]  # both directions of a run are one trial
    return judge_fits(runs.rename(columns=named).assign(insertion=each), "fitted")


def describe_fit(error_mm: float, noise_ratio: float | None, curve_mm: float | None) -> Outcome:
    """Describe one fit by its mean tip error, as a multiple of the noise, and that of the closest curve."""
    far = noise_ratio is not None and noise_ratio > FAR_NOISE_RATIO
    if far or (curve_mm is not None and curve_mm < error_mm):
        return "does not predict"
    return "predicts" if noise_ratio is not None and noise_ratio <= MAX_NOISE_RATIO else "in part"


def judge_fits(errors: pd.DataFrame, method: str = MEDIAN_METHOD, metric: str = TE) -> Outcome:
    """Return whether several fits generalise: whether both their scores are better than every curve's.

    They generalise if tip errors and CRPS are significantly smaller than those of every curve. They do not if
    either is significantly larger than that of a curve; as of many comparisons one may be so by chance, these
    have Holm's correction.

    `errors`: rows of the table "errors" of held-out insertions, with `fold`, `specimen`, `hole`, `insertion`,
    `method` and the `metric` (mm): those of `method`, and of the curves by their names. `tip_crps_mm` is
    the CRPS (mm) of `method`, and of curves if it is not their metric; without this column a point was
    predicted, and the metric decides.
    """
    found = compare_with_curves(errors, method, metric)
    if (found["p_larger"] * len(found) <= SIGNIFICANCE).any():
        return "does not generalise"
    return "generalises" if len(found) and (found["p_smaller"] <= SIGNIFICANCE).all() else "not shown"


def compare_with_curves(errors: pd.DataFrame, method: str, metric: str = TE) -> pd.DataFrame:
    """Compare the scores of a method with those of each curve on the same insertions.

    `errors` as in `judge_fits`. A trial is the mean over insertions that share a fit, a specimen or a hole.

    Returns
    -------
    DataFrame
        A row for each score and curve with at least two trials: `score`, `curve`, `trials`, `difference_mm`
        (the method's score less the curve's) and the p values of its being smaller and larger than 0 by
        Student's t: `p_smaller`, `p_larger`.
    """
    scores = [metric, CRPS] if CRPS in errors else [metric]
    table = errors.replace([np.inf, -np.inf], np.nan).pivot(
        index=["fold", "specimen", "hole", "insertion"], columns="method", values=scores
    )
    curves = [name for name in BASELINES.names() if (metric, name) in table]
    gaps = {score: -table[score][curves].fillna(table[metric][curves]) for score in scores}
    found = pd.concat({score: gaps[score].add(table[score][method], axis=0) for score in scores}, axis=1)
    trials = found.groupby(join_trials(table.index.to_frame(index=False))).mean()
    count, mean = trials.count(), trials.mean()
    with np.errstate(divide="ignore", invalid="ignore"):  # equal differences have no scatter
        t = np.where(trials.std() > 0, mean * np.sqrt(count) / trials.std(), np.copysign(np.inf, mean))
    sides = {f"p_{side}": scipy.special.stdtr(count - 1, sign * t) for side, sign in SIDES.items()}
    about = {"trials": count, "difference_mm": mean, **sides}
    return pd.DataFrame(about)[count > 1].rename_axis(["score", "curve"]).reset_index()


def join_trials(rows: pd.DataFrame) -> list[int]:
    """Return the trial of each row: rows of the same fold, specimen or hole are of one trial."""
    trial = list(range(len(rows)))
    for key in (rows["fold"], rows["specimen"], rows["specimen"] + "/" + rows["hole"]):
        first: dict[Any, int] = {}
        for number, name in enumerate(key):
            old, new = trial[number], trial[first.setdefault(name, number)]
            trial = [new if one == old else one for one in trial]
    return trial


def find_closest_curve(group: ScoredGroup) -> str | None:
    """Return the curve without mechanics with the smallest tip error."""
    errors = {name: group.get(TE, method=name) for name in BASELINES.names()}
    known = {name: error for name, error in errors.items() if error is not None}
    return min(known, key=lambda name: known[name], default=None)


# ---- checks


def list_checks(run: Run, role: str = "validate") -> tuple[Finding, ...]:
    """Return the checks of all insertions that are scored together; of a fit of those fitted to.

    Of a fit within the noise a closer curve decides nothing: curves were fitted to the same needles.
    """
    group, found = pool_insertions(run, role), list[Finding]()
    judged = None if group is None else judge(run, group)
    if role == "tune":
        found.append(Finding(Check.HELD_OUT, None))
    if judged is not None:
        ratio, error, curve = judged.noise_ratio, judged.error_mm, judged.curve_mm
        passed = CLOSER.get(judged.outcome, None if curve is None else error < curve)
        if role == "tune" and ratio is not None and ratio <= 1:
            passed = None
        curves = (group.get(TE, method=name) for name in BASELINES.names()) if group else ()
        closer = sum(one is not None and one < error for one in curves)
        one = Finding(Check.CURVES, passed, error, curve, judged.curve, fits=judged.fits, closer=closer)
        found.append(one)
        within = None if ratio is None else ratio <= MAX_NOISE_RATIO
        found.append(Finding(Check.NOISE, within, ratio, MAX_NOISE_RATIO))
    predictive = run.frames["predictive"]
    if len(predictive) and role == "validate":
        held_out = int(group.head["insertions"]) if group else 0
        found += check_intervals(predictive, run.metadata.recipe, held_out)
    return (*found, check_data(run))


def check_intervals(
    predictive: pd.DataFrame, recipe: RecipeRecord | None, held_out: int = 0
) -> Iterator[Finding]:
    """Yield how many tips lie in their intervals, and how wide these are.

    Of the `held_out` insertions those that could not be predicted have no interval.
    """
    fits = predictive["fold"].nunique()
    missing = max(0, held_out - len(predictive))
    for check, column in ((Check.COVERAGE_95, "tip_in_95"), (Check.COVERAGE_50, "tip_in_50")):
        found = count_covered(predictive, column)
        one = Finding(check, None, found.hits, trials=found.trials, fits=fits, missing=missing)
        if check is Check.COVERAGE_95:
            needed = max(1, math.floor(MIN_COVERED_95 * found.trials))
            yield replace(one, passed=found.hits >= needed, threshold=needed)
        else:
            low, high = COVERED_50
            inside = low <= found.hits / found.trials <= high
            passed = inside if found.trials >= MIN_TIPS_50 else None
            yield replace(one, passed=passed, threshold=found.trials / 2, beyond=_count_beyond(predictive))
    width, deflection = median_width(predictive), float(measure_tips(predictive, "measured").median())
    limit = MAX_AIMING_WIDTH_MM if recipe is None else recipe.aiming_width_mm
    yield Finding(Check.WIDTH, width <= limit, width, limit, deflection_mm=deflection)


def _count_beyond(predictive: pd.DataFrame) -> int:
    """Return how many tips deflect more than their predictive medians."""
    if "tip_z_measured_mm" in predictive:
        return int((measure_tips(predictive, "measured") > measure_tips(predictive, "median")).sum())
    measured, median = predictive["tip_measured_mm"], predictive["tip_median_mm"]
    return int(((measured - median) * np.sign(median) > 0).sum())


def check_data(run: Run) -> Finding:
    """Return whether any warning casts doubt on the data or on a parameter."""
    named = [one.kind for one in list_doubts(run.warnings)]
    return Finding(Check.DATA, not named, len(named), 0, ", ".join(named))


def limit_status(run: Run, status: Status) -> Status:
    """Return the status of a verdict; data that contradict themselves let nothing pass."""
    return "warn" if status == "pass" and list_contradictions(run.warnings) else status
