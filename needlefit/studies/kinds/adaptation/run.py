"""Run an adaptation: fit to more and more new insertions, in several orders, and score held-out ones."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import pandas as pd

from needlefit.arrays import Floats
from needlefit.inference.predict import Draws
from needlefit.inference.transferred_prior import TransferProblem, TransferredPrior
from needlefit.project.random_streams import random_stream
from needlefit.studies.folds import Fold
from needlefit.studies.held_out_predictions import tabulate_held_out
from needlefit.studies.job import Job, Settings
from needlefit.studies.kinds.adaptation.schema import AdaptationRecord
from needlefit.studies.kinds.adaptation.task import AdaptationTask, make_task, name_training_set
from needlefit.studies.posterior_fit import PREDICTION_DRAWS, PosteriorFit, fit_posterior
from needlefit.studies.run import Frames, Run
from needlefit.studies.runner import AnalysisPlan, AnalysisTask, FrameRows, run_analysis
from needlefit.studies.score import Row, Scorer, list_length_metrics, list_score_columns, model_predictor

RESAMPLES = 2000
"""Times that orders and needles are drawn again."""

INTERVAL_PERCENTILES = (2.5, 97.5)
"""Percentiles of an interval."""


@dataclass(frozen=True)
class Estimate:
    """A value and its 95 % interval over orders and needles; infinite where a count is never reached."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Resampling:
    """Bootstrap weights of orders (R, O) and of needles (R, H); in the first repetition all are equal."""

    orders: Floats
    needles: Floats

    def means(self, values: Floats) -> Floats:
        """Return the means (R, N) of `values` (O, N, H) in every repetition."""
        averaged: Floats = np.einsum("ro,onh,rh->rn", self.orders, values, self.needles, optimize=True)
        return averaged


def resample(orders: int, needles: int, rng: np.random.Generator) -> Resampling:
    """Draw the bootstrap weights of orders and needles."""
    return Resampling(_weights(orders, rng), _weights(needles, rng))


def estimate_needed_count(means: Floats, counts: Sequence[int], limits: Floats) -> Estimate:
    """Return the smallest count from which on `means` (R, N) stay at or below their limit (R,)."""
    good = means <= limits[:, None]
    # the product from the end is 1 as long as all later counts are good
    from_end = np.cumprod(good[:, ::-1], axis=1).sum(axis=1)  # how many counts stay good
    return estimate(np.array([*counts, np.inf])[len(counts) - from_end])


def estimate(values: Floats) -> Estimate:
    """Return the first of `values` (R,), with the 95 % interval of the others."""
    # inverted_cdf takes an existing value: interpolation with an infinite count would give NaN
    low, high = np.percentile(values[1:], INTERVAL_PERCENTILES, method="inverted_cdf")
    return Estimate(float(values[0]), float(low), float(high))


def _weights(count: int, rng: np.random.Generator) -> Floats:
    drawn = rng.multinomial(count, np.full(count, 1 / count), size=RESAMPLES)
    # row 0 is the estimate itself, the others are its bootstrap repetitions
    return np.vstack([np.ones(count), drawn]) / count


APPROACHES = ("inflated", "new", "none")

PREDICTION_SCORES = ("tip_crps_mm", "shape_crps_mm", "tip_in_50", "tip_in_95", "shape_in_95")


def list_error_names() -> list[str]:
    """Return the metrics for which the needed number of insertions is estimated."""
    return [metric.name for metric in list_length_metrics()]


def list_curve_names() -> list[str]:
    """Return the columns of the learning curves: means over the held-out needles."""
    return [*list_error_names(), *PREDICTION_SCORES]


def conclude(task: AdaptationTask, frames: Frames) -> tuple[str, ...]:
    """Add the tables `orders`, `curves`, `adaptation`, `insertions_needed` and `gains`; return the faults."""
    curves = pd.DataFrame(list(_curve_rows(task, frames["errors"])))
    frames["orders"] = pd.DataFrame(
        [
            {"order": k, "n": n, "insertion": one}
            for k, order in enumerate(task.orders)
            for n, one in enumerate(order, start=1)
        ]
    )
    frames["curves"] = curves
    means = _average_orders(curves).merge(_summarize_fits(frames["fits"]), on=["method", "n"], how="left")
    floors = {
        error: float(frames["errors"][f"floor_{error}"].astype(float).mean()) for error in list_error_names()
    }
    frames["adaptation"] = means.assign(**{f"floor_{error}": floor for error, floor in floors.items()})
    rng = random_stream(task.new.recipe.seed, task.new.name, "drawn again")
    resampling = resample(len(task.orders), len(task.held_out), rng)
    frames["insertions_needed"] = pd.DataFrame(list(_needed_rows(task, frames["errors"], resampling)))
    frames["gains"] = pd.DataFrame(list(_gain_rows(task, frames["errors"], resampling)))
    return _find_faults(frames)


def _curve_rows(task: AdaptationTask, errors: pd.DataFrame) -> Iterator[Row]:
    """Yield every order's mean errors over the held-out needles, for each way and count."""
    numbers = errors.assign(**{name: errors[name].astype(float) for name in list_curve_names()})
    means = numbers.groupby(["method", "learned_from"], sort=False)[list_curve_names()].mean()
    known = {key: means.loc[key].to_dict() for key in means.index}
    for approach in APPROACHES:
        for order, ids in enumerate(task.orders):
            for n in task.counts:
                name = "nothing" if approach == "none" else name_training_set(ids, n)
                if (approach, name) in known:
                    yield {"method": approach, "order": order, "n": n} | known[approach, name]


def _average_orders(curves: pd.DataFrame) -> pd.DataFrame:
    """Return mean, median and range over orders of the errors, and the mean of all else."""
    grouped = curves.groupby(["method", "n"], sort=False)
    found = grouped[list_curve_names()].mean()
    for error in list_error_names():
        for what in ("median", "min", "max"):
            found[error.replace("_mm", f"_{what}_mm")] = grouped[error].agg(what)
    return found.reset_index()


def _summarize_fits(fits: pd.DataFrame) -> pd.DataFrame:
    """Return how many sets of insertions were learned from, and how well their draws can be trusted."""
    each = fits.drop_duplicates(["method", "learned_from"]).astype({"pareto_k": float, "sampled": bool})
    by = each.groupby(["method", "n"], sort=False)
    return by.agg(groups=("learned_from", "size"), pareto_k=("pareto_k", "max"), sampled=("sampled", "sum"))


def _means(
    task: AdaptationTask, errors: pd.DataFrame, approach: str, error: str, resampling: Resampling
) -> Floats:
    """Return the mean errors (R, N) of a way at every count, as they are and drawn again."""
    wanted = errors[errors["method"] == approach].astype({error: float})
    table = wanted.pivot(index="learned_from", columns="insertion", values=error)
    ids = [one.id for one in task.held_out]
    sets = [
        ["nothing" if approach == "none" else name_training_set(order, n) for n in task.counts]
        for order in task.orders
    ]
    known = table.reindex([name for names in sets for name in names])[ids].to_numpy(dtype=np.float64)
    return resampling.means(known.reshape(len(task.orders), len(task.counts), len(ids)))


def _needed_rows(task: AdaptationTask, errors: pd.DataFrame, resampling: Resampling) -> Iterator[Row]:
    """Yield from which count on each way stays near what all new ones give, and near the floor."""
    for error in list_error_names():
        means = {approach: _means(task, errors, approach, error, resampling) for approach in APPROACHES}
        floors = _means(task, errors, "none", f"floor_{error}", resampling)[:, 0]
        for target, levels in (("all", means["new"][:, -1]), ("floor", floors)):
            limits = levels + task.record.margin_mm
            for approach in APPROACHES:
                known = np.isfinite(means[approach][0])  # from new insertions alone nothing is known at 0
                counts = [n for n, there in zip(task.counts, known, strict=True) if there]
                found = estimate_needed_count(means[approach][:, known], counts, limits)
                about = {
                    "method": approach,
                    "metric": error,
                    "target": target,
                    "value": float(levels[0]),
                }
                counted = {"n": found.value, "low": found.low, "high": found.high}
                yield {**about, "limit_mm": float(limits[0]), **counted}


def _gain_rows(task: AdaptationTask, errors: pd.DataFrame, resampling: Resampling) -> Iterator[Row]:
    """Yield by how much the inflated posterior errs less than each method, count by count."""
    for error in list_error_names():
        mine = _means(task, errors, "inflated", error, resampling)
        for baseline in ("new", "none"):
            gain = _means(task, errors, baseline, error, resampling) - mine
            for k, n in enumerate(task.counts):
                if np.isfinite(gain[0, k]):
                    found = estimate(gain[:, k])
                    about = {"metric": error, "baseline": baseline, "n": n, "difference": found.value}
                    yield {**about, "low": found.low, "high": found.high}


def _find_faults(frames: Frames) -> tuple[str, ...]:
    errors = frames["errors"]
    failed = int((~errors["converged"].astype(bool)).sum())
    unpredicted = int(errors["tip_crps_mm"].isna().sum())
    return (
        *((f"{failed} simulations of held-out insertions did not converge",) if failed else ()),
        *((f"{unpredicted} held-out insertions could not be predicted",) if unpredicted else ()),
    )


_WHERE = ("method", "learned_from", "n")
_SCORED = ("depth_mm", "boundaries", "converged")
_PREDICTED = (
    "tip_crps_mm",
    "shape_crps_mm",
    "tip_in_50",
    "tip_in_95",
    "shape_in_50",
    "shape_in_95",
    "certified",
)


def list_frames() -> dict[str, tuple[str, ...]]:
    """Return the columns of the frames; `learned_from` names new insertions, joined by +, or "nothing"."""
    scores = list_score_columns(list_length_metrics())
    return {
        "errors": (*_WHERE, "insertion", *_SCORED, *scores, *_PREDICTED),
        "fits": (*_WHERE, "pareto_k", "sampled", "parameter", "value"),
    }


def run(name: str, record: AdaptationRecord, settings: Settings) -> Run:
    """Run an adaptation study.

    Raises
    ------
    ConfigError, DataError
        If anything the record names is missing or wrong.
    """
    return run_analysis(name, record, settings, plan(make_task(name, record, settings)))


def plan(task: AdaptationTask) -> AnalysisPlan:
    """Return the tasks: score the old model as it is, and each approach fitted to each new set."""
    tasks: dict[str, AnalysisTask] = {"none": partial(_score_no_update, task)}
    for approach in ("inflated", "new"):
        for ids in task.sets:
            if ids or approach == "inflated":
                tasks[f"{approach}: {_name_set(ids)}"] = partial(_run_task, task, approach, ids)
    also = {"orders": [list(order) for order in task.orders]}
    shared = [partial(getattr, task, "transferred")]
    return AnalysisPlan(
        (task.old, task.new), tasks, list_frames(), partial(conclude, task), also, shared=shared
    )


def _name_set(ids: tuple[str, ...]) -> str:
    return "+".join(ids) or "nothing"


@dataclass(frozen=True)
class _MediumKnowledge:
    """The knowledge of a medium in one approach: best values, draws, and the checks of the draws."""

    values: Mapping[str, float]
    draws: Draws
    k: float = math.nan
    sampled: bool = False


def _from_fit(learned: PosteriorFit) -> _MediumKnowledge:
    return _MediumKnowledge(learned.fit.values, learned.draws, learned.k, learned.sampled)


def _score_no_update(task: AdaptationTask) -> FrameRows:
    return _score_rows(task, task.old, ("none", ()), _from_fit(task.old_posterior))


def _run_task(task: AdaptationTask, approach: str, ids: tuple[str, ...]) -> FrameRows:
    """Learn from a set of new insertions in one way, and score what is held out."""
    if not ids:
        return _score_rows(task, task.new, (approach, ids), _from_prior(task.transferred, task.new))
    fold = Fold(f"{approach}: {_name_set(ids)}", tuple(task.training[one] for one in ids), ())
    problem = task.new.problem(fold)
    if approach == "inflated":
        problem = TransferProblem.of(problem, task.transferred)
    return _score_rows(
        task,
        task.new,
        (approach, ids),
        _from_fit(fit_posterior(task.new, problem, (fold.name,), task.settings)),
    )


def _from_prior(transferred: TransferredPrior, job: Job) -> _MediumKnowledge:
    """Return what is expected before any insertion: the prior's peak, and draws of the prior."""
    drawn = transferred.draw(PREDICTION_DRAWS, random_stream(job.recipe.seed, job.name, "expected"))
    expected = transferred.parameters.values(transferred.parameters.expected)
    return _MediumKnowledge(expected, Draws(drawn, "importance"))


def _score_rows(
    task: AdaptationTask, job: Job, where: tuple[str, tuple[str, ...]], known: _MediumKnowledge
) -> FrameRows:
    """Score every held-out needle along its planned path, and say how it was predicted."""
    approach, ids = where
    head: Row = {"method": approach, "learned_from": _name_set(ids), "n": len(ids)}
    fold = Fold(f"{approach}: {_name_set(ids)}", (), task.held_out)
    predictor = model_predictor(known.values, job.medium, job.dataset)
    rows = [] if known.draws.faults else tabulate_held_out(job, fold, known.draws)
    predicted = {row["insertion"]: row for row in rows}
    errors = []
    for insertion in task.held_out:
        floor = job.floor(insertion)
        scorer = Scorer(job.dataset, job.record.layer_count_rule, {insertion.id: floor})
        scored = scorer.score({}, insertion, predictor)[0][-1]  # the planned path comes last
        row = {**scored, **predicted.get(insertion.id, {})}
        columns = list_frames()["errors"]
        errors.append({**head, **{name: row.get(name) for name in columns if name not in head}})
    about = {**head, "pareto_k": known.k, "sampled": known.sampled}
    fits = [{**about, "parameter": name, "value": value} for name, value in known.values.items()]
    return {"errors": errors, "fits": fits}
