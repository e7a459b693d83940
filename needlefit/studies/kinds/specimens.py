"""How much specimens differ: mean and spread of a population in two stages; or the recovery of a known one.

Stage one is the posterior of every specimen by itself; stage two is `specimen_spread`. What a further
specimen may be follows from both. With a recovery, specimens of known mean and spread are simulated, measured
with the errors that the dataset states, and inferred in the same way; counted is how often the intervals held
the truth. There the model that makes the needles is the one that is fitted: it tests the computation.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any, Literal

import numpy as np
import pandas as pd
from pydantic import Field, NonNegativeFloat
from scipy.stats import halfnorm

from needlefit.arrays import Floats
from needlefit.errors import ConfigError, FitError
from needlefit.inference.identifiability.directions import describe_combination
from needlefit.inference.optimize import minimize
from needlefit.inference.parameters import is_logarithmic
from needlefit.inference.predict import wilson_interval
from needlefit.inference.problem import Problem
from needlefit.inference.sampling.importance import Effort, sample_about_fit
from needlefit.inference.specimens import (
    KERNELS_PER_SPECIMEN,
    SpreadModel,
    determined_directions,
    highest_density_interval,
    make_population,
    marginal_density,
)
from needlefit.project.random_streams import random_stream
from needlefit.project.toml import describe_key
from needlefit.reporting.figures import Drawing
from needlefit.reporting.labels import POPULATION_NAMES
from needlefit.reporting.number_format import (
    MISSING,
    format_bare_symbol,
    format_quantity_range,
    insert_symbols,
)
from needlefit.reporting.table import Table, part, pivot
from needlefit.reporting.table_files import to_records
from needlefit.reporting.text import KindText
from needlefit.schemas.analyses import TunedAnalysisRecord
from needlefit.schemas.base import Record
from needlefit.schemas.limits import MAX_REPLICATES
from needlefit.studies.held_out_predictions import fit_posterior
from needlefit.studies.job import Job, Settings, group_insertions, prepare, with_one_bevel
from needlefit.studies.kind import StudyKind
from needlefit.studies.report import StudyReport
from needlefit.studies.run import Frames, Run
from needlefit.studies.runner import AnalysisPlan, AnalysisTask, FrameRows, run_analysis
from needlefit.studies.score import Row
from needlefit.studies.simulated_data import simulate_measurements


class RecoveryRecord(Record):
    """Simulated specimens with a known spread between them."""

    specimens: int = Field(ge=3, le=MAX_REPLICATES)
    """Simulated specimens."""
    replicates: int = Field(ge=1, le=MAX_REPLICATES)
    """Repetitions."""
    spreads: tuple[NonNegativeFloat, ...] = Field(min_length=1)
    """True spreads between specimens, each in turn (SD of the logarithm; of alpha itself)."""
    mean: dict[str, float]
    """Mean parameters of the specimens, by name."""


class SpecimensRecord(TunedAnalysisRecord):
    """`kind = "specimens"`: the spread of the parameters between specimens."""

    kind: Literal["specimens"]
    groups: tuple[Literal["specimen", "insertion"], ...] = ("specimen",)
    """What counts as a specimen, each in turn."""
    spread_prior_sd: float = Field(default=1.0, gt=0)
    """Standard deviation of the half-normal prior of a spread."""
    recovery: RecoveryRecord | None = None
    """Simulation study: is a known spread recovered?"""


KIND = StudyKind("specimens", SpecimensRecord, __name__)

LEVELS = (0.50, 0.95)

#: the combinations of parameters that specimens determine best and worst
COMBINATIONS = ("best_determined", "worst_determined")
NEW_SPECIMENS = 4000  #: further specimens that are drawn of a population

SPECIMEN_STARTS, SPECIMEN_EFFORT = 2, Effort(draws=120, min_ess=150.0)
"""For each simulated specimen: its search, and the importance sampling of its posterior."""

NEEDLE_POINTS = 30  #: at which a simulated needle is measured, about
MAX_SPECIMEN_DRAWS = 100  #: draws of a specimen among which one must have a solution

_INTERVAL_COLUMNS = ("median", "low_50", "high_50", "low_95", "high_95")
_TRUST_COLUMNS = ("pareto_k", "certified")
FRAMES: Mapping[str, tuple[str, ...]] = {
    "population": (
        *("groups", "quantity", "parameter", "combination"),
        *(*_INTERVAL_COLUMNS, "specimens", *_TRUST_COLUMNS),
    ),
    "specimens": ("groups", "specimen", "insertions", "parameter", "mean", "sd", *_TRUST_COLUMNS),
    "densities": ("groups", "parameter", "spread", "density", "prior"),
    "recovered": (
        *("spread", "replicate", "quantity", "parameter", "truth"),
        *(*_INTERVAL_COLUMNS, *_TRUST_COLUMNS),
    ),
}
"""Of logarithms (of alpha itself): `quantity` is the "mean" of the population, the "spread" between
specimens, or a "new" specimen. Intervals of means and new ones are central, those of spreads the shortest:
they may begin at 0."""

COVERAGE_COLUMNS = (
    *("spread", "quantity", "parameter", "level", "replicates", "covered"),
    *("share", "low", "high", "width"),
)


def run(name: str, record: SpecimensRecord, settings: Settings) -> Run:
    """Return the estimated population of specimens, or how well a known one is recovered."""
    job = with_one_bevel(prepare(name, record.tuning(), settings))  # a group may be a single insertion
    tasks: dict[str, AnalysisTask] = {}
    if record.recovery is None:
        for what in record.groups:
            if len(group_insertions(job.folds[0].tune, what)) < 2:
                where = describe_key(job.name, "tune")
                raise ConfigError(
                    f"there is only one {what}: a spread needs two",
                    where=where,
                    key="tune",
                    fix="select more",
                )
            tasks[f"each {what}"] = partial(_measure_population, job, record, what, settings)
    else:
        mean = record.recovery.mean
        if missing := [one for one in job.parameters.free if one not in mean]:
            raise ConfigError(
                f"no mean is given for {', '.join(missing)}",
                where=describe_key(job.name, "recovery.mean"),
                key="recovery.mean",
                expected="one value for each free parameter",
            )
        for key, value in mean.items():
            low, high = job.parameters.bounds.get(key, (math.inf, math.inf))
            free = key in job.parameters.bounds
            if not low < value < high:
                fault = f"{value:g} is not within the bounds of medium {job.record.medium}"
                one_of = ", ".join(job.parameters.free)
                raise ConfigError(
                    fault if free else "this parameter is not free",
                    where=describe_key(job.name, f"recovery.mean.{key}"),
                    key=f"recovery.mean.{key}",
                    expected=f"a number between {low:g} and {high:g}" if free else f"one of {one_of}",
                )
        for spread in record.recovery.spreads:
            for number in range(record.recovery.replicates):
                key = f"spread {spread:g}, replicate {number + 1}"
                tasks[key] = partial(_recover_population, job, record, record.recovery, (spread, number))
    return run_analysis(name, record, settings, AnalysisPlan([job], tasks, FRAMES, _conclude))


def _measure_population(job: Job, record: SpecimensRecord, what: str, settings: Settings) -> FrameRows:
    """Return what the dataset's specimens, or its insertions as if each were one, say of their population."""
    everything = job.problem(job.folds[0])
    model, (posteriors, rows) = _make_model(everything, record), (list[Floats](), list[Row]())
    columns = [everything.names.index(name) for name in model.names]
    for name, members in group_insertions(job.folds[0].tune, what).items():
        problem = replace(everything, insertions=members)
        learned = fit_posterior(job, problem, (what, name), settings)
        if settings.stop():
            return {}
        posteriors.append(learned.draws.thetas)
        about = {"groups": what, "specimen": name, "insertions": len(members)}
        trust = {"pareto_k": learned.k, "certified": not learned.draws.faults}
        moments = (find(posteriors[-1][:, columns], axis=0).tolist() for find in (np.mean, np.std))
        rows += [
            {**about, "parameter": parameter, "mean": mean, "sd": sd, **trust}
            for parameter, mean, sd in zip(model.names, *moments, strict=True)
        ]
    rng = random_stream(job.recipe.seed, job.name, "population", what)
    population, densities = _infer_population(everything, posteriors, record, rng)
    return {
        "population": [{"groups": what, "specimens": len(posteriors), **row} for row in population],
        "specimens": rows,
        "densities": [{"groups": what, **row} for row in densities],
    }


def _make_model(problem: Problem, record: SpecimensRecord) -> SpreadModel:
    """Return the model of the spread of every free parameter; what is tied with a spread has none."""
    sd, parameters = record.spread_prior_sd, problem.parameters
    tied = {tie.name for tie in parameters.prior.ties}
    own = SpreadModel.of(parameters, sd, sd).names
    others = [name for name in parameters.free if name not in tied and name not in own]
    return SpreadModel.of(parameters, sd, sd, others)


def _infer_population(
    problem: Problem, posteriors: list[Floats], record: SpecimensRecord, rng: np.random.Generator
) -> tuple[list[Row], list[Row]]:
    """Return rows of what draws (K, P) of specimens say of their population, and densities of its spreads."""
    model = _make_model(problem, record)
    names, population = model.names, make_population(problem.parameters, model, posteriors)
    found = population.posterior(rng)
    weights = np.exp(found.log_weights)
    means, covariances = population.split(found.thetas)
    every = [(name, "", axis) for name, axis in zip(names, np.eye(len(names)), strict=True)]
    directions = determined_directions(population.specimens)
    if len(names) > 1:
        ends = zip(COMBINATIONS, directions[[0, -1]], strict=True)
        every += [(name, describe_combination(axis, names), axis) for name, axis in ends]
    rows, densities = list[Row](), list[Row]()
    trust = {"pareto_k": found.k, "certified": found.certified}
    again = rng.choice(len(weights), size=NEW_SPECIMENS, p=weights)
    for name, words, axis in every:
        mean, spread = means @ axis, np.sqrt(np.einsum("p,npq,q->n", axis, covariances, axis))
        new = mean[again] + spread[again] * rng.standard_normal(NEW_SPECIMENS)
        shortest = [end for one in LEVELS for end in highest_density_interval(spread, weights, one, 0.0)]
        intervals = {
            "mean": _central_intervals(mean, weights),
            "spread": [_central_intervals(spread, weights)[0], *shortest],
            "new": _central_intervals(new, np.full(NEW_SPECIMENS, 1 / NEW_SPECIMENS)),
        }
        for what, five in intervals.items():
            head = {"quantity": what, "parameter": name, "combination": words}
            rows.append({**head, **dict(zip(_INTERVAL_COLUMNS, five, strict=True)), **trust})
        grid, density = marginal_density(spread, weights, 0.0)
        own = name not in COMBINATIONS  # a parameter's spread, which has a prior of its own
        prior = halfnorm.pdf(grid, scale=record.spread_prior_sd) if own else np.full(len(grid), np.nan)
        some = np.column_stack([grid, density, prior])[::4].tolist()
        heads = ("spread", "density", "prior")
        densities += [{"parameter": name, **dict(zip(heads, row, strict=True))} for row in some]
    return rows, densities


def _central_intervals(values: Floats, weights: Floats) -> list[float]:
    """Return the median, and the ends of central intervals, of weighted draws (N,)."""
    order = np.argsort(values, kind="stable")
    passed = np.cumsum(weights[order])
    at = [0.5, *(end for level in LEVELS for end in ((1 - level) / 2, (1 + level) / 2))]
    return [float(values[order[min(int(np.searchsorted(passed, p)), len(values) - 1)]]) for p in at]


def _recover_population(
    job: Job, record: SpecimensRecord, recovery: RecoveryRecord, at: tuple[float, int]
) -> FrameRows:
    """Simulate specimens of a known population, and return what is found of it."""
    spread, number = at
    rng = random_stream(job.recipe.seed, job.name, "recovery", str(spread), number)
    everything = job.problem(job.folds[0])
    mean = job.parameters.theta({**job.parameters.fixed, **recovery.mean})
    recipe, drawn = job.recipe.model_copy(update={"starts": SPECIMEN_STARTS, "minimize": "posterior"}), []
    for _ in range(recovery.specimens):
        problem = _simulate_specimen(job, mean, spread, rng)
        found = sample_about_fit(problem, minimize(problem, recipe, rng), rng, 1, (SPECIMEN_EFFORT,))
        chosen = rng.choice(len(found.thetas), size=KERNELS_PER_SPECIMEN, p=np.exp(found.log_weights))
        drawn.append(found.thetas[chosen])
    population, _ = _infer_population(everything, drawn, record, rng)
    truths = dict(zip(everything.names, mean.tolist(), strict=True))
    rows = [
        {"spread": spread, "replicate": number + 1, **row, "truth": truths[row["parameter"]]}
        for row in population
        if row["quantity"] != "new" and row["parameter"] not in COMBINATIONS
    ]
    return {
        "recovered": [row | ({"truth": spread} if row["quantity"] == "spread" else {}) for row in rows],
    }


def _simulate_specimen(job: Job, mean: Floats, spread: float, rng: np.random.Generator) -> Problem:
    """Return the problem of one specimen drawn about the mean, with needles measured with stated errors.

    Raises FitError if hardly any such specimen has a solution.
    """
    everything, planned = job.problem(job.folds[0]), []
    for one in job.folds[0].tune:  # about `NEEDLE_POINTS` of the points of each: neighbours err alike
        step = max(1, len(one.planar) // NEEDLE_POINTS)
        kept = np.arange(len(one.planar) - 1, -1, -step)[::-1]
        sd = None if one.sd is None else one.sd[kept]
        planned.append(replace(one, planar=one.planar[kept], sd=sd, sections=None))
    for _ in range(MAX_SPECIMEN_DRAWS):
        theta = mean + spread * rng.standard_normal(len(mean))
        if np.any(theta < everything.lower) or np.any(theta > everything.upper):
            continue
        values = everything.values(theta)
        stated = job.recipe.likelihood
        known = simulate_measurements(job.dataset, planned, values, job.medium, rng, likelihood=stated)
        if known is not None:
            return replace(everything, insertions=known)
    raise FitError(
        "specimens about this mean have no solution, or lie outside the bounds",
        where="recovery",
        fix="choose a mean farther within the bounds, or smaller spreads",
    )


def _conclude(frames: Frames) -> tuple[str, ...]:
    """Add how often intervals held the truth, with Wilson's 95 % interval, and their median width.

    Returns which posteriors are not to be trusted.
    """
    rows: list[Row] = []
    for key, same in frames["recovered"].groupby(["spread", "quantity", "parameter"], sort=False):
        for level in LEVELS:
            low, high = same[f"low_{100 * level:.0f}"], same[f"high_{100 * level:.0f}"]
            covered = int(((low <= same["truth"]) & (same["truth"] <= high)).sum())
            ends = wilson_interval(covered / len(same), len(same))
            found = (level, len(same), covered, covered / len(same), *ends, float((high - low).median()))
            rows.append(dict(zip(COVERAGE_COLUMNS, (*key, *found), strict=True)))
    frames["coverage"] = pd.DataFrame(rows, columns=list(COVERAGE_COLUMNS))
    every = frames["specimens"]
    doubted = every[~every["certified"].astype(bool)].drop_duplicates(["groups", "specimen"])
    whole = frames["population"].drop_duplicates("groups")
    unsure = whole.loc[~whole["certified"].astype(bool), "groups"]
    return (
        *((f"the posteriors of {len(doubted)} specimens are not certified",) if len(doubted) else ()),
        *(f"the posterior of the population of {groups}s is not certified" for groups in unsure),
    )


# ---- the report

MAX_NAMED_SPECIMENS = 3  #: number of specimens that a sentence names; more are only counted


def describe(result: Run) -> dict[str, Any]:
    """Return what the text prints."""
    record, coverage = result.record, result.frames["coverage"]
    recovered = result.frames["recovered"].drop_duplicates(["spread", "replicate"])
    sums = coverage.groupby(["level", "quantity"], sort=False)[["covered", "replicates"]].sum()
    spreads = to_records(coverage[coverage["quantity"] == "spread"])
    return {
        "recovery": record.recovery and record.recovery.model_dump(),
        "prior_sd": record.spread_prior_sd,
        "groups": [_describe_group(result, what) for what in result.frames["population"]["groups"].unique()],
        "covered": to_records(sums.reset_index()),
        "spreads": [row | {"name": _name_parameter(row)} for row in spreads],
        "populations": len(recovered),
        "uncertified": int((~recovered["certified"].astype(bool)).sum()),
    }


def _describe_group(result: Run, what: str) -> dict[str, Any]:
    """Return spreads, a further specimen, and what lies beyond or near bounds, of one way to group."""
    frames = (result.frames[name] for name in ("population", "specimens"))
    mine, every = (frame[frame["groups"] == what] for frame in frames)
    (medium, *_) = result.run["parts"]
    given = {name: one["bounds"] for name, one in medium["medium"]["parameters"].items() if one["bounds"]}
    bounds = {  # of logarithms, of alpha itself
        name: (math.log(low), math.log(high)) if is_logarithmic(name) else (low, high)
        for name, (low, high) in given.items()
    }
    spreads = [
        {**row, "name": _name_parameter(row)} for row in to_records(mine[mine["quantity"] == "spread"])
    ]
    new = to_records(mine[(mine["quantity"] == "new") & ~mine["parameter"].isin(COMBINATIONS)])
    beyond = [
        row
        for row in new
        if row["parameter"] in bounds
        and (row["low_95"] < bounds[row["parameter"]][0] or row["high_95"] > bounds[row["parameter"]][1])
    ]
    near = []
    for name, rows in every[every["parameter"].isin(list(bounds))].groupby("parameter", sort=False):
        low, high = bounds[str(name)]
        held = rows[rows["mean"].sub(low).combine(high - rows["mean"], min) < 2 * rows["sd"]]
        if len(held):
            names = list(map(str, held["specimen"]))
            which = names if len(names) <= MAX_NAMED_SPECIMENS else [f"{len(names)} {what}s"]
            near.append(f"{_name_parameter({'parameter': name})} of {', '.join(which)}")
    return {
        "what": what,
        "count": int(spreads[0]["specimens"]),
        "spreads": [{**row, "name": _name_parameter(row)} for row in spreads],
        "limits": [_name_parameter(row) for row in spreads if row["low_95"] == 0],
        "new": [f"{_name_parameter(row)} {_format_ends(row)}" for row in new],
        "beyond": [
            f"{_name_parameter(row)} ({_format_ends(row, *bounds[row['parameter']])})" for row in beyond
        ],
        "posteriors": every["specimen"].nunique(),
        "near": near,
    }


def tabulate(result: Run) -> list[Table]:
    """Return mean, spread and a further specimen as a table; or the coverage of the intervals."""
    recovered = result.record.recovery is not None
    rows = [
        {**row, "parameter": _name_parameter(row), "population_quantity": POPULATION_NAMES[row["quantity"]]}
        for row in to_records(result.frames["coverage" if recovered else "population"])
    ]
    if recovered:
        levels = (part(key, level=level) for level in LEVELS for key in ("held_share", "interval_width"))
        columns = ("true_spread", "population_quantity", "parameter", *levels)
        return [Table("coverage", pivot(rows, ["spread", "quantity", "parameter"], ["level"]), columns)]
    for row, found in zip(rows, to_records(result.frames["population"]), strict=True):
        unitless = row["quantity"] == "spread" or found["parameter"] in COMBINATIONS
        row["specimens_of"] = f"{row['specimens']} {row['groups']}s"
        row["own_units_95"] = MISSING if unitless else _format_ends(found)
    columns = (
        *("specimens_of", "parameter", "population_quantity", "population_median", "log_range_50"),
        *("log_range_95", "own_units_95"),
    )
    return [Table("population", rows, columns, groups=("groups",))]


def _name_parameter(row: Row) -> str:
    if row["parameter"] in COMBINATIONS:
        return insert_symbols(str(row["combination"]))
    return format_bare_symbol(str(row["parameter"]))


def _format_ends(row: Row, *ends: float) -> str:
    """Return two ends, or those of the 95 % interval, in the parameter's own unit."""
    name = str(row["parameter"])
    low, high = ends or (row["low_95"], row["high_95"])
    if is_logarithmic(name):
        low, high = math.exp(low), math.exp(high)
    return format_quantity_range(name, low, high)


def draw(result: Run) -> dict[str, Drawing]:
    """Return specimens and spreads, or the intervals of every replicate beside the true values."""
    frames = {name: frame.assign(origin=result.origin) for name, frame in result.frames.items()}

    def name_recovered(every: pd.DataFrame) -> pd.DataFrame:
        names = every["quantity"].map(POPULATION_NAMES) + " of " + every["parameter"].map(_axis_label)
        placed = every.assign(panel=names, place=pd.factorize(every["parameter"])[0])
        return placed.sort_values(["place", "quantity"], kind="stable")

    def name_specimens(every: pd.DataFrame) -> pd.DataFrame:
        ends = {"low": every["mean"] - every["sd"], "high": every["mean"] + every["sd"]}
        return every.assign(**ends, label=every["parameter"].map(_axis_label))

    def name_densities(every: pd.DataFrame) -> pd.DataFrame:
        return every.assign(panel=every["parameter"].map(lambda name: f"spread: {_axis_label(name)}"))

    if result.record.recovery is not None:
        options = {"group": "spread", "label": "true spread\n{:g}"}
        return {"recovered": Drawing("intervals", frames["recovered"], options, name_recovered)}
    known = frames["population"]
    reach = known[known["quantity"] == "spread"][["groups", "parameter", "high_95"]]
    densities = result.frames["densities"].merge(reach, how="left", on=["groups", "parameter"])
    densities = densities.assign(origin=result.origin)
    options = {"by": "groups", "x": "spread", "name": "{}s"}
    dots: dict[str, Any] = {
        **{"rows": ["specimen"], "value": "mean", "by": "groups", "intervals": [("low", "high")]},
        # each panel with an axis of its own
        **{
            "panel": "label",
            "scale": dict.fromkeys(map(_axis_label, frames["specimens"]["parameter"]), "linear"),
        },
    }
    return {
        "specimens": Drawing("dots_with_intervals", frames["specimens"], dots, name_specimens),
        "densities": Drawing("densities", densities, options, name_densities),
    }


def _axis_label(name: str) -> str:
    if name in COMBINATIONS:
        return name.replace("_", "-")
    return f"ln {format_bare_symbol(name)}" if is_logarithmic(name) else format_bare_symbol(name)


REPORT = StudyReport(KindText("specimens"), describe, tabulate, draw)
