"""Measure what a new specimen costs: errors on held-out needles against the number of insertions fitted to.

Three approaches to the new medium are scored on one fixed set of held-out needles, through the layers of
their planned paths. "Inflated": the posterior of the old medium, widened by how much media differ
(`inference.specimens`), is the prior, and new insertions update it. "New": new insertions alone, from
the new medium's bounds. "None": the old model as it is. Errors are those of the best fit, as in the tables of
studies; the CRPS and the intervals are of draws of the posterior.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from math import factorial
from typing import Any, Literal

import numpy as np
import pandas as pd
from pydantic import Field

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion
from needlefit.errors import ConfigError
from needlefit.inference.fit import Fit
from needlefit.inference.predict import Draws
from needlefit.inference.specimens import TransferProblem, TransferredPrior
from needlefit.project.random_streams import random_stream
from needlefit.project.toml import renamed_keys
from needlefit.reporting.columns import DIGITS
from needlefit.reporting.figures import Drawing, Look, Panel
from needlefit.reporting.labels import APPROACH_COLOURS, APPROACH_NAMES, medium_name
from needlefit.reporting.number_format import format_mm
from needlefit.reporting.table import Table, part, pivot
from needlefit.reporting.table_files import Row, select_records, to_records
from needlefit.reporting.text import KindText
from needlefit.schemas.analyses import AnalysisRecord
from needlefit.schemas.base import Record
from needlefit.schemas.limits import MAX_REPLICATES
from needlefit.schemas.study import FitRecord, LayerCountRule, SelectionRecord
from needlefit.studies import score
from needlefit.studies.fit_frames import list_length_metrics, list_score_columns
from needlefit.studies.held_out_predictions import (
    PREDICTION_DRAWS,
    PosteriorFit,
    fit_posterior,
    tabulate_held_out,
)
from needlefit.studies.job import Fold, Job, Settings, prepare
from needlefit.studies.kind import StudyKind
from needlefit.studies.report import StudyReport
from needlefit.studies.run import Frames, Run
from needlefit.studies.runner import AnalysisPlan, AnalysisTask, FrameRows, list_faults, run_analysis


class KnownMediumRecord(Record):
    """A medium and the insertions into it."""

    medium: str
    """Name of the tissue model."""
    insertions: SelectionRecord
    """Insertions into it."""


class NewMediumRecord(KnownMediumRecord):
    """The new medium, its insertions, and those that are held out."""

    held_out: tuple[str, ...] = Field(min_length=1)
    """Insertions, by id, that are predicted and never fitted."""


class BetweenMediaRecord(Record):
    """How far the parameters of two media differ."""

    ln_mu_sd: float = Field(ge=0)
    """Standard deviation of ln mu between media."""
    ln_bevel_sd: float = Field(ge=0)
    """Standard deviation of the logarithm of the bevel parameter (b or θ) between media."""
    alpha_sd: float = Field(default=0.0, ge=0)
    """Standard deviation of alpha between media."""
    source: str
    """Where these numbers come from."""


class AdaptationRecord(AnalysisRecord):
    """`kind = "adaptation"`: how many insertions a new medium needs, with and without the posterior of an
    earlier one.
    """

    kind: Literal["adaptation"]
    dataset: str
    """Name of a dataset in `data/`, or the path of its folder."""
    recipe: str = "default"
    """Name of a recipe in `configs/recipes/`, or the path of its file."""
    layer_count_rule: LayerCountRule = "listed"
    """Number of layers of an insertion that ends at a boundary: as its row lists it, or the other count."""
    old: KnownMediumRecord
    """The medium whose posterior is the prior of the new one."""
    new: NewMediumRecord
    """The new medium."""
    between_media: BetweenMediaRecord
    """How far media differ."""
    orders: int = Field(default=6, ge=1, le=MAX_REPLICATES)
    """Random orders in which the new insertions are added."""
    counts: tuple[int, ...] | None = None
    """Numbers of insertions that are fitted; without it, every number."""
    margin_mm: float = Field(default=0.1, gt=0)
    """Two errors within this margin count as equal."""


KIND = StudyKind("adaptation", AdaptationRecord, __name__)

RESAMPLES = 2000  #: times that orders and needles are drawn again

APPROACHES = ("inflated", "new", "none")

PREDICTION_SCORES = ("tip_crps_mm", "shape_crps_mm", "tip_in_50", "tip_in_95", "shape_in_95")

_WHERE = ("method", "learned_from", "n")
_SCORED = ("depth_mm", "boundaries", "converged")
_PREDICTED = (
    *("tip_crps_mm", "shape_crps_mm", "tip_in_50", "tip_in_95"),
    *("shape_in_50", "shape_in_95", "certified"),
)


def list_frames() -> dict[str, tuple[str, ...]]:
    """Return the columns of the frames; `learned_from` names new insertions, joined by +, or "nothing"."""
    scores = list_score_columns(list_length_metrics())
    return {
        "errors": (*_WHERE, "insertion", *_SCORED, *scores, *_PREDICTED),
        "fits": (*_WHERE, "pareto_k", "sampled", "parameter", "value"),
    }


@dataclass(frozen=True)
class AdaptationTask:
    """The data that all tasks of an adaptation share."""

    record: AdaptationRecord
    settings: Settings
    old: Job
    new: Job
    held_out: tuple[Insertion, ...]  #: new ones that are never fitted to
    training: Mapping[str, Insertion]  #: the other new ones, by id
    orders: tuple[tuple[str, ...], ...]  #: orders of their ids, all different

    @property
    def counts(self) -> tuple[int, ...]:
        """The numbers of insertions fitted to, ascending."""
        given = self.record.counts
        return tuple(range(len(self.training) + 1)) if given is None else tuple(sorted(set(given)))

    @property
    def sets(self) -> tuple[tuple[str, ...], ...]:
        """The different sets of first insertions of the orders; within a set the order does not matter."""
        firsts = (tuple(sorted(order[:n])) for n in self.counts for order in self.orders)
        return tuple(dict.fromkeys(firsts))

    @cached_property
    def old_posterior(self) -> PosteriorFit:
        """The fit and posterior of the old medium; computed once, the same in every process."""
        (fold,) = self.old.folds
        return fit_posterior(self.old, self.old.problem(fold), (fold.name,), self.settings)

    @cached_property
    def transferred(self) -> TransferredPrior:
        """The widened old posterior, as the prior of the new medium's parameters."""
        between = self.record.between_media
        kinds = {"mu": between.ln_mu_sd, "alpha": between.alpha_sd}
        kinds |= dict.fromkeys(("bevel", "cut_angle"), between.ln_bevel_sd)
        spread = {
            name: next((sd for kind, sd in kinds.items() if name.startswith(kind)), 0.0)
            for name in self.new.parameters.free
        }
        fit, thetas = self.old_posterior.fit.values, self.old_posterior.draws.thetas
        return TransferredPrior.from_draws(self.old.parameters, fit, thetas, self.new.parameters, spread)


def name_set(ids: Iterable[str]) -> str:
    """Return the name of a training set in the tables: its ids, joined by +."""
    return "+".join(sorted(ids)) or "nothing"


def make_task(name: str, record: AdaptationRecord, settings: Settings) -> AdaptationTask:
    """Return the adaptation that a record describes.

    Raises ConfigError, DataError if anything it names is missing or wrong.
    """
    shared, sides = {key: getattr(record, key) for key in ("dataset", "recipe", "layer_count_rule")}, []
    for side, known in (("old", record.old), ("new", record.new)):
        table = {"schema": FitRecord.SCHEMA, "medium": known.medium, "tune": known.insertions}
        with renamed_keys({"tune": f"{side}.insertions", "medium": f"{side}.medium"}):
            sides.append(prepare(f"{name} {side}", FitRecord.model_validate(table | shared), settings))
    old, new = sides
    there = {insertion.id: insertion for insertion in new.insertions}
    training = {one: insertion for one, insertion in there.items() if one not in record.new.held_out}
    unknown = ", ".join(one for one in record.new.held_out if one not in there)
    both = ", ".join(sorted(there.keys() & {insertion.id for insertion in old.insertions}))
    left, most = len(training), max(record.counts or (1,))
    faults = (
        (unknown, "new.held_out", f"held_out names {unknown}, which [new] does not select"),
        (both, "new.insertions", f"{both} would be both old and new"),
        (most > left, "counts", f"{left} new insertions are left to learn from, of {most} asked for"),
        (
            old.recipe.minimize != "posterior",
            "recipe",
            "a fit by errors alone has no posterior to carry over",
        ),
    )
    for wrong, key, fault in faults:
        if wrong:
            expected = "new insertions, some held out and enough left to learn from"
            raise ConfigError(fault, where=f"study {name}", key=key, expected=expected)
    rng = random_stream(new.recipe.seed, name, "orders")
    orders = draw_orders(tuple(training), record.orders, rng)
    held_out = tuple(there[one] for one in record.new.held_out)
    return AdaptationTask(record, settings, old, new, held_out, training, orders)


def draw_orders(names: tuple[str, ...], count: int, rng: np.random.Generator) -> tuple[tuple[str, ...], ...]:
    """Draw `count` different orders, or all there are, independently of each other."""
    found: dict[tuple[str, ...], None] = {}
    while len(found) < min(count, factorial(len(names))):
        found[tuple(names[k] for k in rng.permutation(len(names)))] = None
    return tuple(found)


def run(name: str, record: AdaptationRecord, settings: Settings) -> Run:
    return run_analysis(name, record, settings, plan(make_task(name, record, settings)))


def plan(task: AdaptationTask) -> AnalysisPlan:
    """Return the tasks: score the old model as it is, and each approach fitted to each new set."""
    tasks: dict[str, AnalysisTask] = {"none": partial(_run_task, task, "none", ())}
    for approach in ("inflated", "new"):
        for ids in task.sets:
            if ids or approach == "inflated":
                tasks[f"{approach}: {name_set(ids)}"] = partial(_run_task, task, approach, ids)
    also = {"orders": [list(order) for order in task.orders]}
    shared = [partial(getattr, task, "transferred")]
    return AnalysisPlan(
        (task.old, task.new), tasks, list_frames(), partial(conclude, task), also, shared=shared
    )


def _run_task(task: AdaptationTask, approach: str, ids: tuple[str, ...]) -> FrameRows:
    """Learn from a set of new insertions in one way, and score held-out needles along their planned paths."""
    job = task.old if approach == "none" else task.new
    name = f"{approach}: {name_set(ids)}"
    learned = _learn(task, approach, Fold(name, tuple(task.training[one] for one in ids), ()))
    values, draws = learned.fit.values, learned.draws
    head: Row = {"method": approach, "learned_from": name_set(ids), "n": len(ids)}
    predictor = score.model_predictor(values, job.medium, job.dataset)
    rows = [] if draws.faults else tabulate_held_out(job, Fold(name, (), task.held_out), draws)
    predicted = {row["insertion"]: row for row in rows}
    errors = []
    for insertion in task.held_out:
        row = {**score.score_planned(job, insertion, predictor), **predicted.get(insertion.id, {}), **head}
        errors.append({name: row.get(name) for name in list_frames()["errors"]})
    about = {**head, "pareto_k": learned.k, "sampled": learned.sampled}
    fits = [{**about, "parameter": name, "value": value} for name, value in values.items()]
    return {"errors": errors, "fits": fits}


def _learn(task: AdaptationTask, approach: str, fold: Fold) -> PosteriorFit:
    """Return what is known in one approach: before any insertion the prior's peak, and draws of the prior."""
    if approach == "none":
        return task.old_posterior
    if not fold.tune:
        prior, rng = task.transferred, random_stream(task.new.recipe.seed, task.new.name, "expected")
        theta, drawn = prior.parameters.expected, Draws(prior.draw(PREDICTION_DRAWS, rng), "importance")
        fit = Fit(tuple(theta), prior.parameters.values(theta), math.nan, (), 0, 0, interrupted=False)
        return PosteriorFit(fit, drawn, math.nan)
    problem = task.new.problem(fold)
    if approach == "inflated":
        problem = TransferProblem.of(problem, task.transferred)
    return fit_posterior(task.new, problem, (fold.name,), task.settings)


# ---- learning curves, and what they say


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

    @classmethod
    def draw(cls, orders: int, needles: int, rng: np.random.Generator) -> "Resampling":
        """Draw the weights of so many orders and needles."""
        drawn = [
            rng.multinomial(count, np.full(count, 1 / count), size=RESAMPLES) for count in (orders, needles)
        ]
        return cls(*(np.vstack([np.ones(one.shape[1]), one]) / one.shape[1] for one in drawn))

    def means(self, values: Floats) -> Floats:
        """Return the means (R, N) of `values` (O, N, H) in every repetition."""
        return np.einsum("ro,onh,rh->rn", self.orders, values, self.needles, optimize=True)


def estimate_needed_count(means: Floats, counts: Sequence[int], limits: Floats) -> Estimate:
    """Return the smallest count from which on `means` (R, N) stay at or below their limit (R,)."""
    good = means <= limits[:, None]
    # the product from the end is 1 as long as all later counts are good
    from_end = np.cumprod(good[:, ::-1], axis=1).sum(axis=1)  # how many counts stay good
    return estimate(np.array([*counts, np.inf])[len(counts) - from_end])


def estimate(values: Floats) -> Estimate:
    """Return the first of `values` (R,), with the 95 % interval of the others."""
    # inverted_cdf takes an existing value: interpolation with an infinite count would give NaN
    low, high = np.percentile(values[1:], (2.5, 97.5), method="inverted_cdf")
    return Estimate(float(values[0]), float(low), float(high))


def list_error_names() -> list[str]:
    """Return the metrics for which the needed number of insertions is estimated."""
    return [metric.name for metric in list_length_metrics()]


def conclude(task: AdaptationTask, frames: Frames) -> tuple[str, ...]:
    """Add the tables `orders`, `curves`, `adaptation`, `insertions_needed` and `gains`; return the faults."""
    errors, keys = frames["errors"], ["method", "n"]
    names = [*list_error_names(), *PREDICTION_SCORES]
    numbers = errors.astype(dict.fromkeys(names, float))
    means = numbers.groupby(["method", "learned_from"], sort=False)[names].mean()
    known = {key: means.loc[key].to_dict() for key in means.index}
    frames["orders"] = pd.DataFrame(
        [
            {"order": k, "n": n, "insertion": one}
            for k, order in enumerate(task.orders)
            for n, one in enumerate(order, start=1)
        ]
    )
    # every order's mean errors over the held-out needles, for each approach and count
    curves = pd.DataFrame(
        [
            {"method": approach, "order": order, "n": n, **known[approach, learned]}
            for approach in APPROACHES
            for order, ids in enumerate(task.orders)
            for n in task.counts
            if (approach, learned := "nothing" if approach == "none" else name_set(ids[:n])) in known
        ]
    )
    grouped = curves.groupby(keys, sort=False)
    averages = grouped[names].mean()  # over orders
    for error in list_error_names():
        for what in ("median", "min", "max"):
            averages[error.replace("_mm", f"_{what}_mm")] = grouped[error].agg(what)
    # how many sets of insertions were learned from, and how well their draws can be trusted
    each = frames["fits"].drop_duplicates(["method", "learned_from"])
    fits = each.astype({"pareto_k": float, "sampled": bool}).groupby(keys, sort=False)
    trust = fits.agg(
        groups=("learned_from", "size"), pareto_k=("pareto_k", "max"), sampled=("sampled", "sum")
    )
    floors = {f"floor_{error}": errors[f"floor_{error}"].astype(float).mean() for error in list_error_names()}
    frames["curves"] = curves
    frames["adaptation"] = averages.reset_index().merge(trust, on=keys, how="left").assign(**floors)
    rng = random_stream(task.new.recipe.seed, task.new.name, "drawn again")
    resampling = Resampling.draw(len(task.orders), len(task.held_out), rng)
    frames["insertions_needed"] = pd.DataFrame(list(_needed_rows(task, errors, resampling)))
    frames["gains"] = pd.DataFrame(list(_gain_rows(task, errors, resampling)))
    failed, unpredicted = ~errors["converged"].astype(bool), errors["tip_crps_mm"].isna()
    return list_faults(
        {
            "simulations of held-out insertions did not converge": int(failed.sum()),
            "held-out insertions could not be predicted": int(unpredicted.sum()),
        }
    )


def _means(
    task: AdaptationTask, errors: pd.DataFrame, approach: str, error: str, resampling: Resampling
) -> Floats:
    """Return the mean errors (R, N) of a way at every count, as they are and drawn again."""
    wanted = errors[errors["method"] == approach].astype({error: float})
    table = wanted.pivot(index="learned_from", columns="insertion", values=error)
    ids = [one.id for one in task.held_out]
    sets = [
        ["nothing" if approach == "none" else name_set(order[:n]) for n in task.counts]
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
                about = {"method": approach, "metric": error, "target": target, "value": float(levels[0])}
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


# ---- the report

_TARGETS = {"all": "error after all of them", "floor": "noise floor"}


def describe(result: Run) -> dict[str, Any]:
    """Return what the text prints: errors are tip errors, counts those that keep it within the margin."""
    record = result.record
    named: tuple[str, ...] = record.new.insertions.specimens or ()
    new = medium_name(named[0].replace("-", " ") if len(named) == 1 else record.new.medium)
    targets = {}
    for target in _TARGETS:
        rows = select_records(result.frames["insertions_needed"], metric="te_mm", target=target)
        targets[target] = {row["method"]: {**row, "count": _format_count(result, row)} for row in rows}
    curves = to_records(result.frames["adaptation"])
    return {
        "record": record.model_dump(),
        "new": new.capitalize(),
        "most": int(result.frames["adaptation"]["n"].max()),
        "orders": int(result.frames["orders"]["order"].nunique()),
        "targets": targets,
        "untouched": select_records(result.frames["adaptation"], method="none")[0],
        "inflated": select_records(result.frames["adaptation"], method="inflated"),
        "gains": [
            {key: f"{row[key]:+z.3f}".replace("-", "−") for key in ("difference", "low", "high")}
            | {"n": row["n"]}
            for row in select_records(result.frames["gains"], metric="te_mm", baseline="new")
            if row["n"]
        ][:3],
        "floors": [
            f"{metric.label} {format_mm(curves[0][f'floor_{metric.name}'], 3)}"
            for metric in list_length_metrics()
        ],
    }


def _format_count(result: Run, row: Row) -> str:
    """Return a count of insertions with its interval."""
    most = int(result.frames["adaptation"]["n"].max())
    n, low, high = (
        f"more than {most}" if row[end] is None else f"{row[end]:.0f}" for end in ("n", "low", "high")
    )
    count = f"{n} insertion{'' if row['n'] == 1 else 's'}"
    return count if low == high else f"{count} ({low} to {high})"


def tabulate(result: Run) -> list[Table]:
    """Return the learning curves, and the number of insertions from which errors are small enough."""
    metrics, rows, counts = list_error_names(), [], []
    for row in to_records(result.frames["adaptation"]):
        for name in metrics if row["method"] != "none" or not row["n"] else ():
            low, high = (row[name.replace("_mm", f"_{end}_mm")] for end in ("min", "max"))
            ends = {"low": None if format_mm(low, 3) == format_mm(high, 3) else low, "high": high}
            about = {"metric": name, "value": row[name], "method": APPROACH_NAMES[row["method"]]}
            rows.append({**row, **about, **ends, DIGITS: 3})
    columns = (
        *("method", "n", "groups"),
        *(part(key, metric=name) for name in metrics for key in ("value", "order_range")),
        *("tip_crps_mm", "tip_in_50", "tip_in_95", "pareto_k"),
    )
    curves = pivot(rows, ["method", "n"], ["metric"])
    for name in ("new", *APPROACH_NAMES):  # the first states value and limit
        for row in select_records(result.frames["insertions_needed"], method=name):
            low, high = ("∞" if row[end] is None else f"{row[end]:.0f}" for end in ("low", "high"))
            count = "not reached" if row["n"] is None else f"{row['n']:.0f}"
            words = count if low == high else f"{count} ({low}–{high})"
            about = {"target": _TARGETS[row["target"]], "method": APPROACH_NAMES[row["method"]]}
            counts.append({**row, **about, "insertions_needed": words, DIGITS: 3})
    needed = pivot(counts, ["metric", "target"], ["method"])
    parts = (part("insertions_needed", method=name) for name in APPROACH_NAMES.values())
    shown = ("metric", "target", "value", "limit_mm", *parts)
    return [
        Table("adaptation", curves, columns, groups=("method",), heads=1),
        Table("insertions_needed", needed, shown, groups=("metric",)),
    ]


def draw(result: Run) -> dict[str, Drawing]:
    """Return errors, CRPS and coverage over the number of new insertions, a line per approach."""
    frame = result.frames["adaptation"].assign(origin=result.origin)
    if frame.empty:
        return {}
    panels = []
    for metric in list_length_metrics():
        name, floor = metric.name, float(frame[f"floor_{metric.name}"].iloc[0])
        low, high = (name.replace("_mm", f"_{end}_mm") for end in ("min", "max"))
        known = (floor, "noise floor")
        panels.append(Panel(f"{metric.label} (mm)", name, name, low, high, log=True, reference=known))
    share: dict[str, Any] = {"limits": (-0.05, 1.05), "reference": (0.95, "")}
    panels += [
        Panel("CRPS of the tip (mm)", "tip_crps_mm", "tip_crps_mm", log=True),
        Panel("tips in their 95 % interval", "tip_in_95", "tip_in_95", **share),
    ]
    looks = {key: Look(name, APPROACH_COLOURS[key]) for key, name in APPROACH_NAMES.items()}
    options = {"x": "n", "by": "method", "panels": panels, "looks": looks, "columns": 2}
    options["x_label"] = "insertions into the new medium"
    return {"adaptation": Drawing("curves", frame, options)}


REPORT = StudyReport(KindText("adaptation"), describe, tabulate, draw)
