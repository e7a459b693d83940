"""Estimate how much specimens differ: mean and spread of a population in two stages; check by simulation.

Stage one is the posterior of every specimen by itself; stage two is `specimen_spread`. What a further
specimen may be follows from both. With a recovery, specimens of known mean and spread are made up, measured
with the errors that the dataset states, and inferred in the same way; counted is how often the intervals held
the truth. There the model that makes the needles is the one that is fitted: it proves the computation.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pandas as pd
from scipy.stats import halfnorm

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion
from needlefit.errors import ConfigError, FitError
from needlefit.inference.identifiability.precision import describe_combination
from needlefit.inference.optimize import minimize
from needlefit.inference.problem import Problem
from needlefit.inference.sampling.importance import Effort, sample_about_fit
from needlefit.inference.specimens import (
    KERNELS_PER_SPECIMEN,
    Population,
    Specimen,
    best_determined,
    highest_density_interval,
    make_specimen,
    marginal_density,
)
from needlefit.project.random_streams import random_stream
from needlefit.project.toml_lines import describe_key
from needlefit.studies.folds import group_insertions
from needlefit.studies.job import Job, Settings, prepare, with_one_bevel
from needlefit.studies.kinds.specimens.schema import RecoveryRecord, SpecimensRecord
from needlefit.studies.posterior_fit import fit_posterior
from needlefit.studies.proportions import wilson_interval
from needlefit.studies.run import Frames, Run
from needlefit.studies.runner import AnalysisPlan, AnalysisTask, FrameRows, run_analysis
from needlefit.studies.score import Row
from needlefit.studies.simulated_data import simulate_measurement

POSTERIOR_DRAWS = 100
"""Draws of a specimen's posterior that the Gaussian kernels in its place are made of."""

LEVELS = (0.50, 0.95)

BEST_DETERMINED = "best_determined"
"""The combination of parameters that specimens tell best."""

NEW_SPECIMENS = 4000
"""Further specimens that are drawn of a population."""

_POPULATION_KEYS = ("groups", "quantity", "parameter", "combination")
_INTERVAL_COLUMNS = ("median", "low_50", "high_50", "low_95", "high_95")
FRAMES: Mapping[str, tuple[str, ...]] = {
    "population": (*_POPULATION_KEYS, *_INTERVAL_COLUMNS, "specimens", "pareto_k", "certified"),
    "specimens": ("groups", "specimen", "insertions", "parameter", "mean", "sd", "pareto_k", "certified"),
    "densities": ("groups", "parameter", "spread", "density", "prior"),
    "recovered": (
        "spread",
        "replicate",
        "quantity",
        "parameter",
        "truth",
        *_INTERVAL_COLUMNS,
        "pareto_k",
        "certified",
    ),
}
"""Of logarithms (of alpha itself): `quantity` is the "mean" of the population, the "spread" between
specimens, or a "new" specimen. Intervals of means and new ones are central, those of spreads the shortest:
they may begin at 0."""

COVERAGE_COLUMNS = (
    "spread",
    "quantity",
    "parameter",
    "level",
    "replicates",
    "covered",
    "share",
    "low",
    "high",
    "width",
)


@dataclass(frozen=True)
class _SpecimenPosterior:
    """One specimen: what was inserted into it, and what these insertions tell."""

    name: str
    insertions: int
    known: Specimen
    k: float
    trusted: bool


def run(name: str, record: SpecimensRecord, settings: Settings) -> Run:
    """Return the estimated population of specimens, or how well a known one is recovered.

    Raises
    ------
    ConfigError, DataError
        If anything the record names is missing or wrong.
    FitError
        If a specimen has no solution.
    """
    job = with_one_bevel(prepare(name, record.tuning(), settings))  # a group may be a single insertion
    _check(job, record)
    tasks: dict[str, AnalysisTask] = {}
    if record.recovery is None:
        for what in record.groups:
            tasks[f"each {what}"] = partial(_measure_population, job, record, what, settings)
    else:
        for spread in record.recovery.spreads:
            for number in range(record.recovery.replicates):
                key = f"spread {spread:g}, replicate {number + 1}"
                tasks[key] = partial(_recover_population, job, record, record.recovery, (spread, number))
    return run_analysis(name, record, settings, AnalysisPlan([job], tasks, FRAMES, _conclude))


def _check(job: Job, record: SpecimensRecord) -> None:
    """Refuse a population of one, and a recovery about an incomplete mean."""
    if record.recovery is not None:
        missing = [one for one in job.parameters.free if one not in record.recovery.mean]
        if missing:
            raise ConfigError(
                f"no mean is given for {', '.join(missing)}",
                where=describe_key(job.name, "recovery.mean"),
                key="recovery.mean",
                expected="one value for each free parameter",
            )
        _check_mean(job, record.recovery.mean)
        return
    for what in record.groups:
        if len(group_insertions(job.folds[0].tune, what)) < 2:
            raise ConfigError(
                f"there is only one {what}: a spread needs two",
                where=describe_key(job.name, "tune"),
                key="tune",
                fix="select more",
            )


def _check_mean(job: Job, mean: Mapping[str, float]) -> None:
    """Refuse a mean that the medium does not have, or has only beyond its bounds."""
    for name, value in mean.items():
        key = f"recovery.mean.{name}"
        where = describe_key(job.name, key)
        if name not in job.parameters.bounds:
            free = ", ".join(job.parameters.free)
            raise ConfigError("this parameter is not free", where=where, key=key, expected=f"one of {free}")
        low, high = job.parameters.bounds[name]
        if not low < value < high:
            raise ConfigError(
                f"{value:g} is not within the bounds of medium {job.record.medium}",
                where=where,
                key=key,
                expected=f"a number between {low:g} and {high:g}",
            )


def _measure_population(job: Job, record: SpecimensRecord, what: str, settings: Settings) -> FrameRows:
    """Return what the dataset's specimens, or its insertions as if each were one, say of their population."""
    everything = job.problem(job.folds[0])
    found = []
    for name, members in group_insertions(job.folds[0].tune, what).items():
        problem = replace(everything, insertions=members)
        learned = fit_posterior(job, problem, (what, name), settings, POSTERIOR_DRAWS)
        if settings.stop():
            return {}
        kernels = make_specimen(learned.draws.thetas)
        found.append(_SpecimenPosterior(name, len(members), kernels, learned.k, not learned.draws.faults))
    rng = random_stream(job.recipe.seed, job.name, "population", what)
    population = _infer_population(everything, [one.known for one in found], record, rng)
    return {
        "population": [{"groups": what, "specimens": len(found), **row} for row in population.rows],
        "specimens": [row for one in found for row in _specimen_rows(what, one, everything.names)],
        "densities": [{"groups": what, **row} for row in population.densities],
    }


def _specimen_rows(what: str, one: _SpecimenPosterior, names: tuple[str, ...]) -> list[Row]:
    sds = np.sqrt(np.diag(one.known.covariance))
    about = {"groups": what, "specimen": one.name, "insertions": one.insertions}
    trust = {"pareto_k": one.k, "certified": one.trusted}
    return [
        {**about, "parameter": name, "mean": float(mean), "sd": float(sd), **trust}
        for name, mean, sd in zip(names, one.known.mean, sds, strict=True)
    ]


@dataclass(frozen=True)
class _PopulationRows:
    """Rows of what specimens say of their population, and densities of the spreads."""

    rows: list[Row]
    densities: list[Row]


def _infer_population(
    problem: Problem, known: list[Specimen], record: SpecimensRecord, rng: np.random.Generator
) -> _PopulationRows:
    population = Population(tuple(known), (problem.lower, problem.upper), record.spread_prior_sd)
    found = population.posterior(rng)
    weights, names = np.exp(found.log_weights), problem.names
    means, taus = np.split(found.thetas, 2, axis=1)
    stiff = best_determined(known)
    every = [(name, "", axis) for name, axis in zip(names, np.eye(len(names)), strict=True)]
    every += [(BEST_DETERMINED, describe_combination(stiff, names), stiff)] if len(names) > 1 else []
    rows: list[Row] = []
    densities: list[Row] = []
    trust = {"pareto_k": found.k, "certified": found.certified}
    again = rng.choice(len(weights), size=NEW_SPECIMENS, p=weights)
    for name, words, axis in every:
        mean, spread = means @ axis, np.sqrt(taus**2 @ axis**2)
        new = mean[again] + spread[again] * rng.standard_normal(NEW_SPECIMENS)
        ends = {
            "mean": _central_intervals(mean, weights),
            "spread": _shortest_intervals(spread, weights),
            "new": _central_intervals(new, np.full(NEW_SPECIMENS, 1 / NEW_SPECIMENS)),
        }
        for what, five in ends.items():
            head = {"quantity": what, "parameter": name, "combination": words}
            rows.append({**head, **dict(zip(_INTERVAL_COLUMNS, five, strict=True)), **trust})
        densities += _density_rows(name, spread, weights, record.spread_prior_sd)
    return _PopulationRows(rows, densities)


def _central_intervals(values: Floats, weights: Floats) -> list[float]:
    """Return the median, and the ends of central intervals, of weighted draws (N,)."""
    order = np.argsort(values, kind="stable")
    passed = np.cumsum(weights[order])
    at = [0.5, *(end for level in LEVELS for end in ((1 - level) / 2, (1 + level) / 2))]
    return [float(values[order[min(int(np.searchsorted(passed, p)), len(values) - 1)]]) for p in at]


def _shortest_intervals(values: Floats, weights: Floats) -> list[float]:
    """Return the median, and the ends of the shortest intervals, of weighted draws (N,) from 0 on."""
    ends = [end for level in LEVELS for end in highest_density_interval(values, weights, level, 0.0)]
    return [_central_intervals(values, weights)[0], *ends]


def _density_rows(name: str, spread: Floats, weights: Floats, prior_sd: float) -> list[Row]:
    """Return the density of a spread, and of its prior where it is a parameter's own."""
    grid, density = marginal_density(spread, weights, 0.0)
    prior = np.full(len(grid), np.nan) if name == BEST_DETERMINED else halfnorm.pdf(grid, scale=prior_sd)
    columns = {"spread": grid, "density": density, "prior": prior}
    return [
        {"parameter": name, **dict(zip(columns, map(float, row), strict=True))}
        for row in zip(*(column[::4] for column in columns.values()), strict=True)
    ]


def _recover_population(
    job: Job, record: SpecimensRecord, recovery: RecoveryRecord, at: tuple[float, int]
) -> FrameRows:
    """Make up specimens of a known population, and return what is found of it."""
    spread, number = at
    rng = random_stream(job.recipe.seed, job.name, "recovery", str(spread), number)
    everything = job.problem(job.folds[0])
    mean = job.parameters.theta({**job.parameters.fixed, **recovery.mean})
    known = []
    for _ in range(recovery.specimens):
        problem = simulate_specimen(job, mean, spread, rng)
        known.append(infer_specimen(job, problem, rng))
    population = _infer_population(everything, known, record, rng)
    truths = dict(zip(everything.names, mean.tolist(), strict=True))
    rows = []
    for row in population.rows:
        if row["quantity"] == "new" or row["parameter"] == BEST_DETERMINED:
            continue
        truth = spread if row["quantity"] == "spread" else truths[row["parameter"]]
        kept = {
            key: row[key] for key in ("quantity", "parameter", *_INTERVAL_COLUMNS, "pareto_k", "certified")
        }
        rows.append({"spread": spread, "replicate": number + 1, "truth": truth, **kept})
    return {"recovered": rows}


SPECIMEN_STARTS, SPECIMEN_EFFORT = 2, Effort(draws=120, min_ess=150.0)
"""For each simulated specimen: its search, and the importance sampling of its posterior."""

NEEDLE_POINTS = 30
"""At which a made-up needle is measured, about."""

MAX_SPECIMEN_DRAWS = 100
"""Draws of a specimen among which one must have a solution."""


def simulate_specimen(job: Job, mean: Floats, spread: float, rng: np.random.Generator) -> Problem:
    """Return the problem of one specimen drawn about the mean, with needles measured with stated errors.

    Raises
    ------
    FitError
        If hardly any such specimen has a solution.
    """
    everything = job.problem(job.folds[0])
    for _ in range(MAX_SPECIMEN_DRAWS):
        theta = mean + spread * rng.standard_normal(len(mean))
        if np.any(theta < everything.lower) or np.any(theta > everything.upper):
            continue
        values = everything.values(theta)
        shared: dict[tuple[object, ...], float] = {}
        measurements = [
            simulate_measurement(job.dataset, _thin_points(one), values, job.medium, rng, shared)
            for one in job.folds[0].tune
        ]
        known = tuple(one for one in measurements if one is not None)
        if len(known) == len(measurements):
            return replace(everything, insertions=known)
    raise FitError(
        "specimens about this mean have no solution, or lie outside the bounds",
        where="recovery",
        fix="choose a mean farther within the bounds, or smaller spreads",
    )


def _thin_points(insertion: Insertion) -> Insertion:
    """Return an insertion with about `NEEDLE_POINTS` of its points: neighbours err alike."""
    step = max(1, len(insertion.planar) // NEEDLE_POINTS)
    kept = np.arange(len(insertion.planar) - 1, -1, -step)[::-1]
    sd = None if insertion.sd is None else insertion.sd[kept]
    return replace(insertion, planar=insertion.planar[kept], sd=sd, sections=None)


def infer_specimen(job: Job, problem: Problem, rng: np.random.Generator) -> Specimen:
    """Return the posterior of a simulated specimen, from a flat prior."""
    recipe = job.recipe.model_copy(update={"starts": SPECIMEN_STARTS, "minimize": "posterior"})
    found = sample_about_fit(problem, minimize(problem, recipe, rng), rng, 1, SPECIMEN_EFFORT)
    chosen = rng.choice(len(found.thetas), size=KERNELS_PER_SPECIMEN, p=np.exp(found.log_weights))
    return make_specimen(found.thetas[chosen])


def _conclude(frames: Frames) -> tuple[str, ...]:
    """Add how often intervals held; return which posteriors are not to be trusted."""
    frames["coverage"] = pd.DataFrame(_coverage_rows(frames["recovered"]), columns=list(COVERAGE_COLUMNS))
    every = frames["specimens"]
    doubted = every[~every["certified"].astype(bool)].drop_duplicates(["groups", "specimen"])
    whole = frames["population"].drop_duplicates("groups")
    unsure = whole[~whole["certified"].astype(bool)]
    return (
        *((f"the posteriors of {len(doubted)} specimens are not certified",) if len(doubted) else ()),
        *(
            f"the posterior of the population of {row.groups}s is not certified"
            for row in unsure.itertuples()
        ),
    )


def _coverage_rows(recovered: pd.DataFrame) -> list[Row]:
    """Return how often intervals held the truth, with Wilson's 95 % interval, and their median width."""
    rows: list[Row] = []
    for key, same in recovered.groupby(["spread", "quantity", "parameter"], sort=False):
        for level in LEVELS:
            low, high = same[f"low_{100 * level:.0f}"], same[f"high_{100 * level:.0f}"]
            covered = int(((low <= same["truth"]) & (same["truth"] <= high)).sum())
            ends = wilson_interval(covered / len(same), len(same))
            found = (level, len(same), covered, covered / len(same), *ends, float((high - low).median()))
            rows.append(dict(zip(COVERAGE_COLUMNS, (*key, *found), strict=True)))
    return rows
