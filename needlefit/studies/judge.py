"""Judge predictions: the checks of the first page, and the verdict, from the stored tables of a run.

Insertions that share a fit, a specimen or a hole err alike: they are one trial. With three trials or more our
scores are tested against those of every curve by paired differences: "generalises", "not shown" or "does not
generalise". Scores are the tip error of our prediction, and the CRPS of the predicted tip. A curve
predicts a point; its CRPS is its error. Of two that miss alike a distribution has the smaller CRPS, and a
wrong spread is seen in CRPS alone: both scores are needed.

With fewer trials, as of one fit or one specimen, nothing is tested. The tip error is compared with those of
two references that are fixed beforehand: "closer than both" ("closer by one needle" where that one decides),
"not clearly closer", "as close" or "worse than one". That states what holds on these needles. How often
either rule is wrong: `studies/judge_rates.py`, `studies/one_fit_rates.py`.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import pandas as pd
import scipy

from needlefit.inference.baselines import BASELINES
from needlefit.metrics import CURVATURE_RMS, METRICS
from needlefit.schemas.recipe import RecipeRecord
from needlefit.studies.advice import list_contradictions, list_doubts
from needlefit.studies.answer import Check, Finding, Status, is_printed_as_one
from needlefit.studies.coverage import (
    MAX_AIMING_WIDTH_MM,
    WIDTH_ERROR_COLUMN,
    count_covered,
    join_trials,
    measure_tips,
    median_width,
)
from needlefit.studies.fit_frames import PREDICTION_METHOD, FitFrames
from needlefit.studies.outcome import Outcome
from needlefit.studies.prediction_scores import CURVATURE_CRPS
from needlefit.studies.run import Run
from needlefit.studies.scored_groups import TE, ScoredGroup, pool_insertions, select_group

REFERENCES = ("straight", "constant_curvature")  #: the curves that one fit is compared with
#: independent trials from which on differences are tested
MIN_TRIALS = 3
#: tip error over the measurement noise up to which the model errs no more than the measurements
MAX_NOISE_RATIO = 2.0
#: difference of tip errors that noise alone may make, over the noise floor, of one needle: errors to opposite
#: sides differ by twice the noise, of SD 1.25 floors. Of several needles it is divided by the root of their
#: number. By it at most 5 % of words are false (`studies/one_fit_rates.py`).
NOISE_GUARD = 4.2
#: probability of each error: to call fits that are as good as a curve better, or worse
SIGNIFICANCE = 0.05
SIDES = {"smaller": 1.0, "larger": -1.0}  #: signs of Student's t of a smaller and of a larger score


class PredictedScore(NamedTuple):
    """Columns of the table "predictive" that belong to a metric of verdicts."""

    crps: str  #: continuous ranked probability score
    covered: str  #: what their names of coverage begin with: the tip alone, or all that was read of a needle


#: by metric of verdicts
PREDICTED = {
    TE: PredictedScore("tip_crps_mm", "tip"),
    CURVATURE_RMS.name: PredictedScore(CURVATURE_CRPS, "shape"),
}
CRPS = PREDICTED[TE].crps


@dataclass(frozen=True)
class Comparison:
    """Our tip errors beside those of the references, on the same needles."""

    outcome: Outcome
    reference: str = ""  #: the one with the smaller tip error; "" if none was scored
    reference_error: float | None = None
    margin: float | None = None  #: difference of errors that counts as none; None: not stated
    needles: int = 0
    closer: int = 0  #: needles on which our error is smaller than that reference's
    hangs_on: tuple[str, ...] = ()  #: needles of which, if one is left out, the outcome is another


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
        found = self.compared
        if found is None or found.reference_error is None or found.margin is None:
            return False
        return abs(self.error - found.reference_error) < found.margin

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


def judge(run: Run, group: ScoredGroup) -> Judgement | None:
    """Judge the predictions of a group of insertions; None if no simulation of it converged."""
    frames = FitFrames.of(run)
    method, score = frames.method, group.score
    error = group.get(score, method=method)
    if error is None:
        return None
    errors = select_group(frames.select_errors(group.head.role), group)
    trials = len(set(join_trials(errors)))
    ratio, specimens = group.over_floor(score, method=method), errors["specimen"].nunique()
    if trials < MIN_TRIALS:
        noise = group.get(score, "floor")
        margin = run.record.margin_mm if score == TE else None
        found = compare_with_references(errors, method, noise, margin, score)
        outcome, curve, nearest = found.outcome, found.reference, found.reference_error
    else:
        if method == PREDICTION_METHOD:
            scores = frames.predictive[["fold", "insertion", PREDICTED[score].crps]]
            errors = errors.merge(scores.assign(method=method), "left", ["fold", "insertion", "method"])
        found, outcome = None, judge_fits(errors, method, score)
        curve = find_closest_curve(group) or ""
        nearest = group.get(score, method=curve)
    if list_contradictions(run.warnings):
        outcome = Outcome.UNDECIDED
    return Judgement(outcome, score, error, ratio, curve, nearest, trials, specimens, found)


def judge_tracks(runs: pd.DataFrame, margin_mm: float | None) -> Outcome:
    """Judge predicted tip tracks by their table "runs"; one fit is compared if the study states a margin."""
    named = {"run": "hole", "rms_mm": TE, "crps_mm": CRPS}
    each = runs["run"] + runs["direction"]  # both directions of a run are one trial
    errors = runs.rename(columns=named).assign(insertion=each)
    if len(set(join_trials(errors))) < MIN_TRIALS:
        return compare_with_references(errors, "fitted", None, margin_mm).outcome
    return judge_fits(errors, "fitted")


def compare_with_references(
    errors: pd.DataFrame,
    method: str,
    noise: float | None,
    margin: float | None = None,
    score: str = TE,
) -> Comparison:
    """Compare errors with those of the references on the same needles; nothing is tested.

    The references were fixed before any needle was predicted, so neither is the best of many by chance. The
    model is worse only where it errs by more than twice the noise, too: noise explains less than that.

    `errors` as in `judge_fits`. `noise`: the noise floor of the `score`; it is the margin, too, unless a
    margin is stated, but a difference that noise alone may make is always within it (`NOISE_GUARD`).
    """
    finite = errors.replace([np.inf, -np.inf], np.nan)
    table = finite.pivot(index=["fold", "specimen", "hole", "insertion"], columns="method", values=score)
    references = [name for name in REFERENCES if name in table]
    table = table[[method, *references]].dropna()
    if not references or table.empty:
        return Comparison(Outcome.UNDECIDED)
    holes = [table.index.get_level_values(name) for name in ("specimen", "hole")]
    needle = pd.Series(zip(*holes, strict=True), table.index)
    noise, needles = noise or 0.0, needle.nunique()
    margin = max(noise if margin is None else margin, NOISE_GUARD * noise / math.sqrt(needles))
    nearest = str(table[references].mean().idxmin())
    gaps = (table[nearest] - table[method]).groupby(needle).mean()

    def find_outcome(rows: pd.DataFrame) -> Outcome:
        mean = rows.mean()
        closer_by = mean[references] - mean[method]
        if margin == 0:  # neither noise nor margin is stated
            return Outcome.UNDECIDED
        if (closer_by > margin).all():
            return Outcome.CLOSER
        if (closer_by < -margin).any() and mean[method] > MAX_NOISE_RATIO * noise:
            return Outcome.WORSE
        return Outcome.AS_CLOSE

    outcome, hangs_on = find_outcome(table), list[str]()
    for rows in (table.loc[labels] for labels in needle.groupby(needle).groups.values()):
        left = table.drop(rows.index)
        if len(left) and find_outcome(left) != outcome:
            *_, hole, insertion = rows.index[0]
            hangs_on.append(str(insertion if len(rows) == 1 else hole))
    if outcome is Outcome.CLOSER and hangs_on:
        outcome = Outcome.CLOSER_BY_ONE_NEEDLE
    if outcome is Outcome.AS_CLOSE and table[method].mean() < table[nearest].mean():
        outcome = Outcome.NOT_CLEARLY_CLOSER
    return Comparison(
        outcome,
        nearest,
        float(table[nearest].mean()),
        margin or None,
        needles,
        int((gaps > 0).sum()),
        tuple(hangs_on),
    )


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
    found = compare_with_curves(errors, method, score)
    if (found["p_larger"] * len(found) <= SIGNIFICANCE).any():
        return Outcome.DOES_NOT_GENERALISE
    better = len(found) and (found["p_smaller"] <= SIGNIFICANCE).all()
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
    gaps = {score: -table[score][curves].fillna(table[error][curves]) for score in scores}
    found = pd.concat({score: gaps[score].add(table[score][method], axis=0) for score in scores}, axis=1)
    trials = found.groupby(join_trials(table.index.to_frame(index=False))).mean()
    count, mean = trials.count(), trials.mean()
    with np.errstate(divide="ignore", invalid="ignore"):  # equal differences have no scatter
        t = np.where(trials.std() > 0, mean * np.sqrt(count) / trials.std(), np.copysign(np.inf, mean))
    sides = {f"p_{side}": scipy.special.stdtr(count - 1, sign * t) for side, sign in SIDES.items()}
    about = {"trials": count, "difference": mean, **sides}
    return pd.DataFrame(about)[count > 1].rename_axis(["score", "curve"]).reset_index()


def find_closest_curve(group: ScoredGroup) -> str | None:
    """Return the curve without mechanics with the smallest error."""
    errors = {name: group.get(group.score, method=name) for name in BASELINES.names()}
    known = {name: error for name, error in errors.items() if error is not None}
    return min(known, key=lambda name: known[name], default=None)


# ---- checks


def list_checks(run: Run, role: str = "validate") -> tuple[Finding, ...]:
    """Return the checks of all insertions that are scored together; of a fit of those fitted to."""
    group, found = pool_insertions(run, role), list[Finding]()
    judged = None if group is None else judge(run, group)
    if role == "tune":
        found.append(Finding(Check.HELD_OUT, None))
    if judged is not None:
        found += (check_curves(judged), check_noise(judged))
    predictive = FitFrames.of(run).predictive
    if len(predictive) and role == "validate":
        held_out, score = (group.head.insertions, group.score) if group else (0, TE)
        found += check_intervals(predictive, run.metadata.recipe, held_out, score)
    return (*found, check_data(run))


def check_curves(judged: Judgement) -> Finding:
    """Return whether the model is closer than the curves that it was compared with."""
    one = Finding(
        Check.CURVES,
        judged.outcome.passed,
        judged.error,
        judged.curve_error,
        judged.curve,
        judged.trials,
        score=judged.score,
    )
    if (found := judged.compared) is None:
        return one
    return replace(
        one,
        margin_mm=found.margin,
        needles=found.needles,
        closer=found.closer,
        hangs_on=", ".join(found.hangs_on),
    )


def check_noise(judged: Judgement) -> Finding:
    """Return whether the error is at most twice that of the measurement noise."""
    return Finding(Check.NOISE, judged.within_noise, judged.noise_ratio, MAX_NOISE_RATIO, score=judged.score)


def check_intervals(
    predictive: pd.DataFrame, recipe: RecipeRecord | None, held_out: int = 0, score: str = TE
) -> Iterator[Finding]:
    """Yield how many tips lie in their intervals; with the 95 % intervals, how wide these are.

    A share fails if its 95 % confidence interval, by trials, excludes what was predicted. One trial has none.
    There no tip in its 95 % interval fails: however tips depend on each other, right intervals miss all of
    them in at most 5 % of cases. Of the `held_out` insertions those that could not be predicted have no
    interval.
    """
    covered_by = PREDICTED[score].covered
    predictive = predictive.dropna(subset=f"{covered_by}_in_95")
    missing = max(0, held_out - len(predictive))
    if score != TE:  # of readings no width is asked for
        for check, level in ((Check.INTERVALS, 0.95), (Check.COVERAGE_50, 0.5)):
            yield _check_coverage(predictive, check, level, score, missing)
        return
    width, deflection = median_width(predictive), float(measure_tips(predictive, "measured").median())
    # tips of one fit share its draws: the median width errs about as much as one of them
    width_error = float(predictive[WIDTH_ERROR_COLUMN].median()) if WIDTH_ERROR_COLUMN in predictive else None
    limit = MAX_AIMING_WIDTH_MM if recipe is None else recipe.aiming_width_mm
    intervals = _check_coverage(predictive, Check.INTERVALS, 0.95, score, missing)
    yield replace(
        intervals,
        passed=False if width > limit else intervals.covered,
        width_mm=width,
        width_error_mm=width_error,
        max_width_mm=limit,
        deflection_mm=deflection,
    )
    middle = _check_coverage(predictive, Check.COVERAGE_50, 0.5, score, missing)
    yield replace(middle, beyond=_count_beyond(predictive))


def _check_coverage(
    predictive: pd.DataFrame, check: Check, level: float, score: str, missing: int
) -> Finding:
    """Return how many insertions lie in what holds them with a probability of `level`."""
    share = count_covered(predictive, f"{PREDICTED[score].covered}_in_{100 * level:.0f}")
    covered: bool | None = share.low <= level <= share.high
    if share.groups == 1:
        covered = False if check is Check.INTERVALS and share.hits == 0 else None
    return Finding(
        check,
        covered,
        share.hits,
        level * share.trials,
        trials=share.groups,
        tips=share.trials,
        missing=missing,
        covered=covered if check is Check.INTERVALS else None,
        score=score,
    )


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
    """Return the status of a verdict; of data that contradict themselves nothing is shown, good or bad."""
    return "warn" if list_contradictions(run.warnings) else status
