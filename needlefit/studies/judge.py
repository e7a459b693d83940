"""Judge predictions: the checks of the first page, and the verdict, from the stored tables of a run.

Insertions that share a fit, a specimen or a hole err alike: they are one trial. With three trials or more our
scores are tested against those of every curve by paired differences: "generalises", "not shown" or "does not
generalise". Scores are the tip error of our prediction, and the CRPS of the predicted tip. A curve
predicts a point; its CRPS is its error. Of two that miss alike a distribution has the smaller CRPS, and a
wrong spread is seen in CRPS alone: both scores are needed.

With fewer trials, as of one fit or one specimen, our predicted tips are compared with those of two references
that are fixed beforehand. Measured tips err as stated, so that it can be tested which of two known
predictions is closer on these needles: "closer than both" ("closer by one needle" where that one decides),
"as close", "worse than one", or "bend too little" where the predictions are too alike. How often either rule
is wrong: `studies/judge_rates.py`, `studies/one_fit_rates.py`.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np
import pandas as pd
import scipy

from needlefit.arrays import Bools
from needlefit.inference.baselines import BASELINES
from needlefit.metrics import METRICS
from needlefit.schemas.recipe import RecipeRecord
from needlefit.schemas.run_metadata import FitMetadata
from needlefit.studies.first_page import (
    ASSUMED,
    Check,
    Finding,
    Outcome,
    Status,
    is_printed_as_one,
    list_contradictions,
    list_doubts,
)
from needlefit.studies.prediction_scores import (
    MAX_AIMING_WIDTH_MM,
    PREDICTED,
    count_covered,
    join_trials,
    measure_tips,
    median_width,
)
from needlefit.studies.run import PREDICTION_METHOD, FitFrames, Run, value_of_run
from needlefit.studies.scored_groups import TE, pool_insertions

REFERENCES = ("straight", "constant_curvature")  #: curves that one fit is compared with
#: smallest number of independent trials with which differences are tested
MIN_TRIALS = 3
#: largest tip error over the measurement noise at which the model errs no more than the measurements
MAX_NOISE_RATIO = 2.0
#: significance of each of two one-sided tests: predictions err less than a curve; they err more than it
SIGNIFICANCE = 0.05
#: smallest power of a test to find an exact prediction closer; below it needles bend too little for the test
MIN_POWER = 0.8
#: normal quantiles: of a significant difference, and of the smallest power
CLOSER_Z, POWER_Z = (float(scipy.special.ndtri(probability)) for probability in (1 - SIGNIFICANCE, MIN_POWER))
#: normal quantile of a significant difference from either of two references (Bonferroni)
WORSE_Z = float(scipy.special.ndtri(1 - SIGNIFICANCE / len(REFERENCES)))
#: columns of the table "errors": the predicted tip minus the measured one, in the needle's frame; the stated
#: standard deviation of the measured tip in any direction across; the part of it that needles may share
TIP_ERRORS = ("tip_error_x_mm", "tip_error_y_mm", "tip_error_z_mm")
TIP_SD, TIP_REGISTERED_SD = "tip_across_sd_mm", "tip_registered_sd_mm"
SIDES = {"smaller": 1.0, "larger": -1.0}  #: signs of Student's t of a smaller and of a larger score


@dataclass(frozen=True)
class Comparison:
    """Our tip errors beside those of the references, on the same needles."""

    outcome: Outcome
    reference: str = ""  #: the one with the smaller tip error; "" if none was scored
    reference_error: float | None = None
    margin: float | None = None  #: difference of errors that the study counts as none
    needles: int = 0
    closer: int = 0  #: needles on which our error is smaller than that reference's
    hangs_on: tuple[str, ...] = ()  #: needles of which, if one is left out, the verdict is another


@dataclass(frozen=True)
class Judgement:
    """What the verdict on some insertions states."""

    outcome: Outcome
    score: str  #: the metric of the verdict
    error: float  #: its mean
    noise_ratio: float | None  #: over that of the measurement noise; None where none is stated
    curve: str  #: what it was compared with: the closest curve, of a comparison the closer reference
    curve_error: float | None
    trials: int  #: independent ones
    specimens: int  #: into which the insertions went
    compared: Comparison | None = None  #: where the trials are too few for a test
    turned_by: tuple[str, ...] = ()  #: odd needles without which the outcome is another

    @property
    def missed(self) -> str:
        """What an error is of: "tips" or "curvatures"."""
        return METRICS[self.score].missed

    @property
    def unit(self) -> str:
        """The unit of its errors."""
        return METRICS[self.score].unit

    @property
    def equals_noise(self) -> bool:
        """Whether the error is that of the measurement noise, as far as it is printed."""
        return self.noise_ratio is not None and is_printed_as_one(self.noise_ratio)

    @property
    def has_reference(self) -> bool:
        """Whether it was compared with a reference that was scored; nothing was tested then."""
        return self.compared is not None and bool(self.compared.reference)

    @property
    def curve_is_closer(self) -> bool:
        return self.curve_error is not None and self.curve_error < self.error

    @property
    def is_within_margin(self) -> bool:
        """Whether the errors of the model and of the closer reference differ by less than the margin."""
        comparison = self.compared
        if comparison is None or comparison.reference_error is None or comparison.margin is None:
            return False
        return abs(self.error - comparison.reference_error) < comparison.margin

    @property
    def within_noise(self) -> bool | None:
        """Whether the error is at most twice that of the measurement noise; None where none is stated."""
        return None if self.noise_ratio is None else self.noise_ratio <= MAX_NOISE_RATIO

    @property
    def status(self) -> Status:
        """The status of the outcome; one trial passes only within twice the noise."""
        far = self.outcome is Outcome.CLOSER and self.within_noise is False
        return "warn" if far else self.outcome.status

    @property
    def advice(self) -> str:
        """What the comparison found, "" without a curve; within the noise no curve is better."""
        if not self.curve:
            return ""
        return "curve_as_good" if self.outcome.passed is False and self.within_noise else self.outcome.advice


@value_of_run
def judge(run: Run) -> Judgement | None:
    """Judge the predictions of all insertions that are scored; None if no simulation of them converged."""
    frames, group = FitFrames.of(run), pool_insertions(run)
    method = frames.method
    if group is None or (error := group.get(group.score, method=method)) is None:
        return None
    errors, score = frames.select_errors(), group.score
    trials = len(set(join_trials(errors)))
    ratio, specimens = group.over_floor(score, method=method), errors["specimen"].nunique()
    if trials < MIN_TRIALS:
        noise = group.get(score, "floor")
        margin = run.record.margin_mm if METRICS[score].unit == "mm" else None
        comparison = compare_with_references(errors, method, noise, margin, score)
        outcome, curve, nearest = comparison.outcome, comparison.reference, comparison.reference_error
    else:
        if method == PREDICTION_METHOD:
            scores = frames.predictive[["fold", "insertion", PREDICTED[score].crps]]
            errors = errors.merge(scores.assign(method=method), "left", ["fold", "insertion", "method"])
        comparison, outcome = None, judge_fits(errors, method, score)
        curve_errors = {
            name: curve_error
            for name in BASELINES.names()
            if (curve_error := group.get(score, method=name)) is not None
        }
        curve = min(curve_errors, key=lambda name: curve_errors[name], default="")
        nearest = curve_errors.get(curve)
    effect = run.knows(FitMetadata).effect
    turned_by = tuple(effect.insertions) if effect and effect.turns else ()
    if find_contradictions(run) or turned_by:
        outcome = Outcome.UNDECIDED
    return Judgement(outcome, score, error, ratio, curve, nearest, trials, specimens, comparison, turned_by)


def compare_with_references(
    errors: pd.DataFrame,
    method: str,
    noise: float | None,
    margin: float | None = None,
    score: str = TE,
) -> Comparison:
    """Compare errors with those of the references on the same needles.

    The references were fixed before any needle was predicted, so neither is the best of many by chance. The
    model is worse only where it errs by more than twice the noise, too: noise explains less than that.

    `errors` as in `judge_fits`; tip errors are tested, with the columns of `compare_predictions`. `noise`:
    the noise floor of the `score`. `margin`: the difference of errors up to which a reference is as good; it
    decides alone where nothing can be tested. Of another score than the tip error it is the noise floor
    where the study states none.
    """
    keys = ["fold", "specimen", "hole", "insertion"]
    finite = errors.replace([np.inf, -np.inf], np.nan).dropna(subset=score)
    errors_by_method = {str(name): rows.set_index(keys) for name, rows in finite.groupby("method")}
    references = [name for name in REFERENCES if name in errors_by_method]
    if method not in errors_by_method or not references:
        return Comparison(Outcome.UNDECIDED)
    compared = reduce(
        pd.MultiIndex.intersection, (errors_by_method[name].index for name in (method, *references))
    )
    if compared.empty:
        return Comparison(Outcome.UNDECIDED)
    margin = margin or (noise if score != TE else None) or None
    tables = {name: errors_by_method[name].loc[compared] for name in (method, *references)}

    def find_outcome(kept: Bools) -> Outcome:
        ours, *others = (table[kept] for table in tables.values())
        error, least = ours[score].mean(), margin or 0.0
        gaps = np.array([other[score].mean() - error for other in others])
        z, exact_z = np.array([compare_predictions(ours, other) for other in others]).T
        if score != TE or not np.isfinite(z).all():
            if margin is None:
                return Outcome.UNDECIDED
            z, exact_z = np.copysign(np.inf, gaps), np.full(len(gaps), np.inf)
        if ((z > CLOSER_Z) & (gaps > least)).all():
            return Outcome.CLOSER
        if ((z < -WORSE_Z) & (gaps < -least)).any() and error > MAX_NOISE_RATIO * (noise or 0.0):
            return Outcome.WORSE
        is_distinguished = (np.abs(z) > CLOSER_Z) | (exact_z > CLOSER_Z + POWER_Z)
        return Outcome.AS_CLOSE if is_distinguished.all() else Outcome.BEND_TOO_LITTLE

    means = {name: float(tables[name][score].mean()) for name in references}
    nearest = min(means, key=lambda name: means[name])
    holes = [compared.get_level_values(name) for name in ("specimen", "hole")]
    needles = pd.Series(zip(*holes, strict=True), compared)
    gaps = (tables[nearest][score] - tables[method][score]).groupby(needles).mean()
    outcome, hangs_on = find_outcome(np.ones(len(compared), dtype=bool)), list[str]()
    for needle in needles.unique():
        kept = (needles != needle).to_numpy()
        if kept.any() and find_outcome(kept).passed != outcome.passed:
            *_, hole, insertion = compared[~kept][0]
            hangs_on.append(str(insertion if sum(~kept) == 1 else hole))
    if outcome is Outcome.CLOSER and hangs_on:
        outcome = Outcome.CLOSER_BY_ONE_NEEDLE
    closer = int((gaps > 0).sum())
    return Comparison(outcome, nearest, means[nearest], margin, len(gaps), closer, tuple(hangs_on))


def compare_predictions(ours: pd.DataFrame, other: pd.DataFrame) -> tuple[float, float]:
    """Compare two predictions of the same tips by their squared distances from the measured ones.

    With predictions p and q of tips t, measured with errors e, the difference of their sums of squares is

        |q - t - e|^2 - |p - t - e|^2 = |q - t|^2 - |p - t|^2 - 2 (q - p) e

    so that its standard deviation is known. How much of e needles have in common is not: of all shares of a
    common registration that with the largest deviation is taken.

    Parameters
    ----------
    ours, other : DataFrame
        Rows of the table "errors" of the same insertions in one order: `TIP_ERRORS`, their `TIP_SD` and
        `TIP_REGISTERED_SD`, and `specimen`.

    Returns
    -------
    z : float
        The difference in standard deviations, normal if both are as close; positive where ours is closer.
        NaN where the errors of measured tips are not known.
    exact_z : float
        Its mean if our prediction is exact: how well these tips can tell the two apart.
    """
    if not {*TIP_ERRORS, TIP_SD, TIP_REGISTERED_SD} <= {*ours}:
        return math.nan, math.nan
    off, others = (rows[list(TIP_ERRORS)].to_numpy(dtype=np.float64) for rows in (ours, other))
    sds = (ours[name].to_numpy(dtype=np.float64) for name in (TIP_SD, TIP_REGISTERED_SD))
    whole, registered = (sd[:, None] for sd in sds)
    apart = others - off
    specimens = ours.index.get_level_values("specimen")
    common = [np.sum((registered * apart)[specimens == name], axis=0) for name in specimens.unique()]
    alone = np.sum((whole**2 - registered**2) * apart**2)
    sd = 2 * math.sqrt(alone + max(np.sum((registered * apart) ** 2), np.sum(np.square(common))))
    if sd == 0:  # no noise is stated, or both are the same
        return (math.nan, math.nan) if not whole.all() else (0.0, 0.0)
    return float(np.sum(others**2 - off**2) / sd), float(np.sum(apart**2) / sd)


def judge_fits(errors: pd.DataFrame, method: str = PREDICTION_METHOD, score: str = TE) -> Outcome:
    """Return whether several fits generalise: whether both their scores are better than every curve's.

    They generalise if tip errors and CRPS are significantly smaller than those of every curve. They do not if
    either is significantly larger than that of a curve; as of many comparisons one may be so by chance, these
    have Holm's correction.

    `errors`: rows of the table "errors" of held-out insertions, with `fold`, `specimen`, `hole`, `insertion`,
    `method` and the tip error: those of `method`, and of the curves by their names. `tip_crps_mm` is the CRPS
    (mm) of `method`, and of curves if it is not their tip error; without this column a point was predicted,
    and tip errors decide.
    """
    comparison = compare_with_curves(errors, method, score)
    if (comparison["p_larger"] * len(comparison) <= SIGNIFICANCE).any():
        return Outcome.DOES_NOT_GENERALISE
    better = len(comparison) and (comparison["p_smaller"] <= SIGNIFICANCE).all()
    return Outcome.GENERALISES if better else Outcome.NOT_SHOWN


def compare_with_curves(errors: pd.DataFrame, method: str, error: str = TE) -> pd.DataFrame:
    """Compare the scores of a method with those of each curve on the same insertions.

    `errors` as in `judge_fits`. A trial is the mean over insertions that share a fit, a specimen or a hole.

    Returns
    -------
    DataFrame
        A row for each score and curve with at least two trials: `score`, `curve`, `trials`, `difference`
        (the method's score less the curve's) and the p values of its being smaller and larger than 0 by
        Student's t: `p_smaller`, `p_larger`.
    """
    crps = PREDICTED[error].crps
    scores = [error, crps] if crps in errors else [error]
    table = errors.replace([np.inf, -np.inf], np.nan).pivot(
        index=["fold", "specimen", "hole", "insertion"], columns="method", values=scores
    )
    curves = [name for name in BASELINES.names() if (error, name) in table]
    others = {score: -table[score][curves].fillna(table[error][curves]) for score in scores}
    gaps = {score: others[score].add(table[score][method], axis=0) for score in scores}
    trials = pd.concat(gaps, axis=1).groupby(join_trials(table.index.to_frame(index=False))).mean()
    count, mean = trials.count(), trials.mean()
    with np.errstate(divide="ignore", invalid="ignore"):  # equal differences have no scatter
        t = np.where(trials.std() > 0, mean * np.sqrt(count) / trials.std(), np.copysign(np.inf, mean))
    sides = {f"p_{side}": scipy.special.stdtr(count - 1, sign * t) for side, sign in SIDES.items()}
    about = {"trials": count, "difference": mean, **sides}
    return pd.DataFrame(about)[count > 1].rename_axis(["score", "curve"]).reset_index()


# ---- checks


@value_of_run
def list_checks(run: Run) -> tuple[Finding, ...]:
    """Return the checks of all insertions that are scored together; of a fit of those fitted to."""
    group, findings, frames = pool_insertions(run), list[Finding](), FitFrames.of(run)
    judged = judge(run)
    if frames.role == "tune":
        findings.append(Finding(Check.HELD_OUT, None))
    if judged is not None:
        ratio = judged.noise_ratio
        noise = Finding(Check.NOISE, judged.within_noise, ratio, MAX_NOISE_RATIO, score=judged.score)
        findings += (check_curves(judged), noise, *check_needles(run, judged))
    if len(frames.predictive) and frames.role == "validate":
        held_out, score = (group.insertions, group.score) if group else (0, TE)
        findings += check_intervals(frames.predictive, run.metadata.recipe, held_out, score)
    # whether no warning casts doubt on data or result; None if the only one is of assumed values
    named = [doubt.kind for doubt in list_doubts(run.warnings)]
    passed = None if set(named) == {ASSUMED} else not named
    unjudged = run.knows(FitMetadata).unjudged
    return (*findings, Finding(Check.DATA, passed, len(named), 0, ", ".join(named), unjudged=unjudged))


def check_curves(judged: Judgement) -> Finding:
    """Return whether the model is closer than the curves that it was compared with."""
    values = (judged.error, judged.curve_error, judged.curve, judged.trials)
    finding = Finding(Check.CURVES, judged.outcome.passed, *values, score=judged.score)
    if (comparison := judged.compared) is None:
        return finding
    return replace(finding, margin_mm=comparison.margin, needles=comparison.needles, closer=comparison.closer)


def check_needles(run: Run, judged: Judgement) -> Iterator[Finding]:
    """Yield whether the outcome is the same without those needles that are in doubt, and without any single
    one that is compared.
    """
    effect, compared = run.knows(FitMetadata).effect, judged.compared
    if effect is None and (compared is None or compared.needles < 2):  # without the only one nothing is left
        return
    hangs_on = compared.hangs_on if compared else ()
    finding = Finding(Check.SAME, not (hangs_on or judged.turned_by), hangs_on=", ".join(hangs_on))
    if effect is not None:
        left_out = ", ".join(effect.insertions)
        finding = replace(finding, left_out=left_out, outcome=effect.outcome, values=effect.values)
    yield finding


#: smallest number of trials of which the 95 % confidence interval of a share, all or none, excludes one half
MIN_COVERAGE_TRIALS = 4


def check_intervals(
    predictive: pd.DataFrame, recipe: RecipeRecord | None, held_out: int, score: str
) -> Iterator[Finding]:
    """Yield how many tips lie in their intervals; of tips, how wide the 95 % intervals are.

    A share fails if its 95 % confidence interval, by trials, excludes what was predicted. One trial has none,
    and two or three cannot exclude one half.
    There no tip in its 95 % interval fails: however tips depend on each other, right intervals miss all of
    them in at most 5 % of cases. Of the `held_out` insertions those that could not be predicted have no
    interval.
    """
    covered_by = PREDICTED[score].covered
    predictive = predictive.dropna(subset=f"{covered_by}_in_95")
    missing = max(0, held_out - len(predictive))

    def check(which: Check, level: float, beyond: int | None = None) -> Finding:
        """Return how many insertions lie in what holds them with a probability of `level`."""
        share = count_covered(predictive, f"{covered_by}_in_{100 * level:.0f}")
        covered: bool | None = share.low <= level <= share.high
        if which is Check.COVERAGE_50 and share.groups < MIN_COVERAGE_TRIALS:
            covered = None
        elif share.groups == 1:
            covered = False if share.hits == 0 else None
        finding = Finding(which, covered, share.hits, level * share.trials, score=score, beyond=beyond)
        return replace(finding, trials=share.groups, tips=share.trials, missing=missing)

    yield check(Check.INTERVALS, 0.95)
    if covered_by != "tip":  # of readings no width is asked for
        yield check(Check.COVERAGE_50, 0.5)
    elif len(predictive):
        width, deflection = median_width(predictive), float(measure_tips(predictive, "measured").median())
        limit = MAX_AIMING_WIDTH_MM if recipe is None else recipe.aiming_width_mm
        yield Finding(Check.WIDTH, width <= limit, width, limit, deflection_mm=deflection)
        yield check(Check.COVERAGE_50, 0.5, _count_beyond(predictive))


def _count_beyond(predictive: pd.DataFrame) -> int:
    """Return how many tips deflect more than their predictive medians."""
    if "tip_z_measured_mm" in predictive:
        return int((measure_tips(predictive, "measured") > measure_tips(predictive, "median")).sum())
    measured, median = predictive["tip_measured_mm"], predictive["tip_median_mm"]
    return int(((measured - median) * np.sign(median) > 0).sum())


def find_contradictions(run: Run) -> list[str]:
    """Return the kinds of warnings by which data contradict themselves, also without the needles in doubt."""
    effect = run.knows(FitMetadata).effect
    return list_contradictions(run.warnings, effect.insertions if effect else ())
