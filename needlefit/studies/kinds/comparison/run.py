"""Run a model comparison: each candidate is fitted to all folds but one, and predicts that one."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd

from needlefit.datasets.insertion import Dataset, Insertion
from needlefit.datasets.select import group_independent
from needlefit.errors import ConfigError
from needlefit.inference.parameters import NOISE_SCALE
from needlefit.inference.sampling.importance import MAX_PARETO_K
from needlefit.metrics import headline_metrics
from needlefit.project.load import load
from needlefit.project.locate import find_file
from needlefit.project.toml_lines import describe_key, locate_key, renamed_keys
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.recipe import RecipeRecord
from needlefit.schemas.study import FitRecord
from needlefit.studies.folds import Fold
from needlefit.studies.job import Job, Settings, prepare
from needlefit.studies.kinds.comparison.candidates import ModelCandidate, candidate_job, fit_candidate
from needlefit.studies.kinds.comparison.schema import ComparisonRecord
from needlefit.studies.run import Frames, Run
from needlefit.studies.runner import AnalysisPlan, AnalysisTask, FrameRows, run_analysis
from needlefit.studies.score import Row, Scorer, list_score_columns
from needlefit.studies.simulated_data import simulate_dataset

SIGNIFICANT_SE = 2.0
"""Standard errors from which on a difference is taken for one."""

AHEAD, BEHIND, TIE, REFERENCE = "ahead", "behind", "tie", "reference"


def conclude(record: ComparisonRecord, frames: Frames) -> tuple[str, ...]:
    """Add the tables `differences`, `group_differences` and `comparison`; return the faults."""
    numbers = ("log_density", *list_score_columns(headline_metrics()))
    scores = frames["scores"].astype(dict.fromkeys(numbers, float))
    frames["differences"] = _difference_rows(scores, record.reference)
    rows = list(_comparison_rows(record, frames["differences"], scores, frames["fits"]))
    frames["comparison"] = pd.DataFrame(rows)
    frames["group_differences"] = pd.DataFrame(list(_group_rows(frames["differences"], rows)))
    return (*_find_faults(frames), *(_check_control(record, rows) if record.positive_control else ()))


def _difference_rows(scores: pd.DataFrame, reference: str) -> pd.DataFrame:
    """Return every candidate's log density of each needle, less the reference's."""
    theirs = scores[scores["method"] == reference].set_index("insertion")["log_density"]
    found = scores[["method", "fold", "insertion", "group", "points"]].copy()
    with np.errstate(invalid="ignore"):
        found["difference"] = scores["log_density"] - scores["insertion"].map(theirs)
    return found


def sum_differences(differences: pd.Series, groups: pd.Series) -> tuple[float, float, int]:
    """Return the sum of differences, its standard error over groups, and the number of groups."""
    by = differences.groupby(groups, sort=False).sum()
    error = np.sqrt(len(by)) * by.std(ddof=1) if len(by) > 1 else np.nan
    return float(by.sum()), float(error), len(by)


def monte_carlo_error(scores: pd.DataFrame) -> float:
    """Return the Monte Carlo error of the sum of one candidate's log predictive densities.

    What the needles of a fold share is the same error in all of them: it adds up, and does not average out.
    """
    whole, shared = (scores[key].astype(float) for key in ("log_density_se", "shared_se"))
    folds = shared.groupby(scores["fold"]).sum()
    # the shared error is subtracted per needle and added back once per fold, as a sum: it does not average
    # out
    return float(np.sqrt((whole**2 - shared**2).sum() + (folds**2).sum()))


def verdict(difference: float, error: float) -> str:
    """Return whether a candidate is ahead of the reference, behind it, or not significantly different."""
    # written with `not`, so that a NaN is a tie
    if not abs(difference) > SIGNIFICANT_SE * error:
        return TIE
    return AHEAD if difference > 0 else BEHIND


def _comparison_rows(
    record: ComparisonRecord, differences: pd.DataFrame, scores: pd.DataFrame, fits: pd.DataFrame
) -> Iterator[Row]:
    """Yield one row for each candidate; what draws leave open adds to the scatter between groups."""
    reference = monte_carlo_error(scores[scores["method"] == record.reference])
    for name in record.candidates:
        own, scored = differences[differences["method"] == name], scores[scores["method"] == name]
        fitted = fits[fits["method"] == name]
        difference, scatter, count = sum_differences(own["difference"], own["group"])
        drawn = monte_carlo_error(scored)
        error = math.hypot(scatter, drawn, reference) if name != record.reference else 0.0
        scale = fitted.loc[fitted["parameter"] == NOISE_SCALE, "value"].astype(float)
        yield {
            "method": name,
            "insertions": len(own),
            "groups": count,
            "log_density": float(scored["log_density"].sum()),
            "difference": difference,
            "difference_se": error,
            "verdict": REFERENCE if name == record.reference else verdict(difference, error),
            "draws_se": drawn,
            **{column: float(scored[column].mean()) for column in list_score_columns(headline_metrics())},
            "noise_scale": float(np.exp(np.log(scale).mean())),
            "pareto_k": float(scored["pareto_k"].astype(float).max()),
            "ess": float(scored["ess"].astype(float).min()),
        }


def _group_rows(differences: pd.DataFrame, rows: list[Row]) -> Iterator[Row]:
    """Yield the differences of every group, and their mean with two standard errors, as "mean"."""
    for row in rows:
        if row["verdict"] == REFERENCE:
            continue
        own = differences[differences["method"] == row["method"]]
        each = own.groupby("group", sort=False)["difference"].sum()
        for group, value in each.items():
            yield {"method": row["method"], "group": group, "difference": value}
        mean, error = (row[key] / row["groups"] for key in ("difference", "difference_se"))
        ends = {"low": mean - SIGNIFICANT_SE * error, "high": mean + SIGNIFICANT_SE * error}
        yield {
            "method": row["method"],
            "group": "mean",
            "difference": mean,
            **ends,
            "verdict": row["verdict"],
        }


def _find_faults(frames: Frames) -> tuple[str, ...]:
    scores = frames["scores"]
    failed = int((~scores["converged"].astype(bool)).sum())
    nowhere = int((~np.isfinite(scores["log_density"].astype(float))).sum())
    doubtful = int((scores["pareto_k"].astype(float) > MAX_PARETO_K).sum())
    return (
        *((f"{failed} simulations of held-out insertions did not converge",) if failed else ()),
        *((f"{nowhere} held-out insertions have no density",) if nowhere else ()),
        *(
            (f"{doubtful} log densities are not certified: Pareto k above {MAX_PARETO_K}",)
            if doubtful
            else ()
        ),
    )


def _check_control(record: ComparisonRecord, rows: list[Row]) -> Iterator[str]:
    """Say where a comparison misses a difference that was put in: then it could not tell one elsewhere."""
    missed = [row["method"] for row in rows if row["verdict"] in (TIE, AHEAD)]
    if missed:
        yield (
            f"{record.reference} made these data and is not found ahead of {', '.join(missed)}: this "
            "comparison could not distinguish them elsewhere either"
        )


_WHERE = ("method", "fold")
_SCORED = ("depth_mm", "comparison", "converged")

FRAMES: Mapping[str, tuple[str, ...]] = {
    "scores": (
        *(*_WHERE, "insertion", "group", "points"),
        *("log_density", "log_density_se", "shared_se", "pareto_k", "ess"),
        *_SCORED,  # and the columns of headline metrics
    ),
    "fits": (*_WHERE, "pareto_k", "parameter", "value"),
}
"""`log_density` is of all points of a needle together, in mm^-points; `log_density_se` its Monte Carlo error,
`shared_se` the part of it that is the same for all needles of a fold; `pareto_k` the larger of its two
integrals'."""


def run(name: str, record: ComparisonRecord, settings: Settings) -> Run:
    """Run a comparison study.

    Raises
    ------
    ConfigError, DataError
        If anything the record names is missing or wrong.
    """
    return run_analysis(name, record, settings, plan(record, _prepare_job(name, record, settings), settings))


def plan(record: ComparisonRecord, job: Job, settings: Settings) -> AnalysisPlan:
    """Return the tasks: one for each candidate and fold."""
    jobs = {name: candidate_job(name, job) for name in record.candidates}
    tasks: dict[str, AnalysisTask] = {
        f"{name}, {fold.name}": partial(_run_task, name, jobs[name], fold, settings)
        for name in record.candidates
        for fold in job.folds
    }
    parameters = {str(name): each.parameters for name, each in jobs.items()}
    frames = {**FRAMES, "scores": (*FRAMES["scores"], *list_score_columns(headline_metrics()))}
    return AnalysisPlan(tuple(jobs.values()), tasks, frames, partial(conclude, record), parameters=parameters)


def _prepare_job(name: str, record: ComparisonRecord, settings: Settings) -> Job:
    table = {"schema": FitRecord.SCHEMA, "dataset": record.dataset or name, "medium": record.medium}
    how = {"recipe": record.recipe, "layer_count_rule": record.layer_count_rule, "tune": record.insertions}
    fit = FitRecord.model_validate({**table, **how})
    with renamed_keys({"tune": "insertions"}):
        job = prepare(name, fit, settings, _make_dataset(name, record, settings))
    if job.recipe.minimize != "posterior":
        raise ConfigError(
            "densities need the errors of the points",
            where=f"study {name}"
            if job.dataset.noise.stated
            else locate_key(job.dataset.path, "noise.point_sd_mm"),
            key="recipe" if job.dataset.noise.stated else "",
            expected='a dataset that states its noise, and a recipe with minimize = "posterior"',
        )
    chosen = job.folds[0].tune
    if len(set(_group_repeats(chosen))) < 2:
        raise ConfigError(
            "there is only one group of repeats: none can be left out",
            where=describe_key(name, "folds"),
            key="folds",
            expected="insertions of two groups, at least",
            fix="select more in [insertions]",
        )
    return replace(job, folds=deal_folds(chosen, record.folds))


def _make_dataset(name: str, record: ComparisonRecord, settings: Settings) -> Dataset | None:
    """Return the dataset that the record states itself, None where it names one."""
    if record.synthetic is None:
        return None
    seed = (
        load(find_file("recipe", record.recipe), RecipeRecord).seed
        if settings.seed is None
        else settings.seed
    )
    return simulate_dataset(
        name, record.synthetic, load(find_file("medium", record.medium), MediumRecord), seed
    )


def deal_folds(insertions: tuple[Insertion, ...], count: int) -> tuple[Fold, ...]:
    """Return folds to which needles, or groups of repeats, are assigned in turn.

    Raises
    ------
    ConfigError
        If there are fewer of these than folds.
    """
    names = _group_repeats(insertions)
    most = len(set(names))
    if count > most:
        raise ConfigError(
            f"{count} folds cannot be dealt from {most} needles, repeats in a specimen counted as one",
            key="folds",
            expected=f"{most} at most",
        )
    order = {name: k % count for k, name in enumerate(dict.fromkeys(names))}
    held = [order[name] for name in names]
    return tuple(
        Fold(
            f"fold {k + 1}",
            tuple(one for one, own in zip(insertions, held, strict=True) if own != k),
            tuple(one for one, own in zip(insertions, held, strict=True) if own == k),
        )
        for k in range(count)
    )


def _group_repeats(insertions: tuple[Insertion, ...]) -> tuple[str, ...]:
    return group_independent([one.id for one in insertions], [one.specimen for one in insertions])


def _run_task(name: str, job: Job, fold: Fold, settings: Settings) -> FrameRows:
    """Fit one candidate to all folds but one, and ask how probable it makes that one."""
    found = fit_candidate(name, job, fold, settings)
    if found is None:
        return {}
    head: Row = {"method": name, "fold": fold.name}
    together = _group_repeats((*fold.tune, *fold.validate))[len(fold.tune) :]
    scores = [
        {**head, "group": group, **_score_insertion(job, found, insertion)}
        for insertion, group in zip(fold.validate, together, strict=True)
    ]
    about = {**head, "pareto_k": found.known.k}
    fits = [{**about, "parameter": key, "value": value} for key, value in found.values.items()]
    return {"scores": scores, "fits": fits}


def _score_insertion(job: Job, found: ModelCandidate, insertion: Insertion) -> Row:
    """Return how probable the points of a needle are, and the errors of the best curve."""
    floor = job.floor(insertion)
    scorer = Scorer(job.dataset, job.record.layer_count_rule, {insertion.id: floor})
    scored = scorer.score({}, insertion, found.predictor)[0][-1]  # the planned path comes last
    predicted = found.predict_density(insertion)
    return {
        "insertion": insertion.id,
        "points": len(insertion.planar),
        "log_density": predicted.log_density,
        "log_density_se": predicted.se,
        "shared_se": predicted.shared_se,
        "pareto_k": predicted.k,
        "ess": predicted.effective_sample_size,
        **{key: scored[key] for key in (*_SCORED, *list_score_columns(headline_metrics()))},
    }
