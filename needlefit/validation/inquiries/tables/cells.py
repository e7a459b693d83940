"""Every cell of the paper's tables: what studies and fits came to, beside what the paper prints.

Studies give the table of validation, fits the two of tuning. Layers are where the needle was measured to
cross them, as the paper does it.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import pandas as pd

from needlefit.datasets.insertion import Insertion
from needlefit.datasets.noise import NoiseFloor
from needlefit.inference.optimize import minimize
from needlefit.inference.starts import Fit, Watch
from needlefit.project.load import load
from needlefit.project.places import find
from needlefit.project.records.fit import FitRecord
from needlefit.project.records.study import StudyRecord
from needlefit.project.streams import stream
from needlefit.project.toml_lines import at_key, in_file
from needlefit.validation import paper
from needlefit.validation.folds import Fold
from needlefit.validation.job import Job, Settings, prepare
from needlefit.validation.results import FLOORS, METRICS
from needlefit.validation.score import Rival, Row, Scorer

ERRORS = (
    *("study", "role", "insertion", "medium", "specimen", "layers", "rival"),
    *METRICS,
    *("deflection_mm", "predicted_deflection_mm"),
    *FLOORS,
    "converged",
)
CELL = ("table", "study", "medium", "layers")
CELLS = (*CELL, "metric", "unit", "value", "floor", "paper", "insertions", "not_converged")
"""`layers` is 0 where a row of the paper's table counts all; `floor` is NaN where a metric has none."""

ALL = 0
"""Layers of a row that counts insertions through any number of them."""


def every_job(
    studies: Sequence[str], fits: Sequence[str], settings: Settings, dataset: str | None = None
) -> dict[str, Job]:
    """Return studies and fits by name, on their own dataset or another, scored as the paper does."""
    found = {}
    named = [("studies", name) for name in studies] + [("fits", name) for name in fits]
    for key, name in named:
        with at_key(key):
            file = find("study" if key == "studies" else "fit", name)
        record = load(file, StudyRecord) if key == "studies" else load(file, FitRecord)
        if dataset is not None:
            record = record.model_copy(update={"dataset": dataset})
        with in_file(file):
            found[name] = as_measured(prepare(name, record, replace(settings, file=file)))
    return found


def as_measured(job: Job) -> Job:
    """Return the job without surfaces: only the measured crossings are scored."""
    return with_insertions(job, lambda one: replace(one, surfaces=()))


def with_insertions(job: Job, changed: Callable[[Insertion], Insertion]) -> Job:
    """Return the job with every insertion of its folds changed."""
    folds = tuple(
        Fold(fold.name, tuple(map(changed, fold.tune)), tuple(map(changed, fold.validate)))
        for fold in job.folds
    )
    return replace(job, folds=folds)


def with_starts(job: Job, starts: int | None) -> Job:
    """Return the job with so many random starts of a search; None: as many as its recipe says."""
    if starts is None:
        return job
    return replace(job, recipe=job.recipe.model_copy(update={"starts": starts}))


def floors_of(jobs: Iterable[Job]) -> dict[str, NoiseFloor]:
    """Return the noise floor of every insertion of all jobs, by its id."""
    every = {one.id: (job, one) for job in jobs for one in job.insertions}
    return {name: job.floor(one) for name, (job, one) in every.items()}


def searched(job: Job, search: str, settings: Settings) -> Fit:
    """Return the fit of one search of a job's only fold, as `needlefit validate` and `tune` find it."""
    fold = job.folds[0]
    rng = stream(job.recipe.seed, job.name, fold.name, search, "starts")
    watch = Watch(stop=settings.stop, jobs=settings.jobs)
    return minimize(job.problem(fold, search), job.recipe_of(search), rng, watch)


def scored(job: Job, rivals: Mapping[str, Rival], floors: Mapping[str, NoiseFloor]) -> list[Row]:
    """Return the errors of rivals on every insertion of a job's only fold, in sample and held out."""
    scorer, fold = Scorer(job.dataset, job.record.reading, floors), job.folds[0]
    rows = []
    for role, insertions in (("tune", fold.tune), ("validate", fold.validate)):
        for insertion in insertions:
            for name, rival in rivals.items():
                place = {"study": job.name, "role": role, "rival": name}
                rows += scorer.score(place, insertion, rival)[0]
    return [{name: row[name] for name in ERRORS} for row in rows]


def numbers_of(jobs: Mapping[str, Job]) -> dict[str, int]:
    """Return the paper's numbers of the studies among jobs; a fit has none."""
    numbers = {name: getattr(job.record, "paper_study", None) for name, job in jobs.items()}
    return {name: number for name, number in numbers.items() if number is not None}


def cells(errors: pd.DataFrame, numbers: Mapping[str, int], by: Sequence[str] = ()) -> pd.DataFrame:
    """Return every cell, one a row, of one rival's `ERRORS`.

    Parameters
    ----------
    errors : DataFrame
        With the columns `by` beside its own.
    numbers : mapping
        The paper's number of each study.
    by : sequence of str
        What makes tables of their own: a seed, a variation.
    """
    held_out = errors[errors["role"] == "validate"]
    fits = errors[~errors["study"].isin(held_out["study"])]
    layers = ["study", "medium", "layers"]
    frame = pd.concat(
        [
            _table("validation", held_out, [*by, *layers]),
            _table("tuning_by_layers", fits, [*by, *layers]),
            _table("tuning_by_media", fits.assign(layers=ALL), [*by, *layers]),
        ],
        ignore_index=True,
    )
    printed = _printed(frame["study"].unique(), numbers)
    keys = [tuple(row) for row in frame[[*CELL, "metric"]].itertuples(index=False)]
    frame["paper"] = [printed.get(key, float("nan")) for key in keys]
    ours = (frame["table"] != "tuning_by_layers") | frame["paper"].notna()  # the paper's has one phantom
    return frame.loc[ours, [*by, *CELLS]].reset_index(drop=True)


def _table(name: str, errors: pd.DataFrame, keys: list[str]) -> pd.DataFrame:
    """Return the mean over insertions of every metric, long."""
    finite = errors[list(METRICS)].astype(float).replace([float("inf")], float("nan"))
    errors = errors.assign(**finite)
    grouped = errors.groupby(keys, sort=False)
    counts = grouped.agg(insertions=("insertion", "size"), converged=("converged", "sum")).reset_index()
    counts["not_converged"] = counts["insertions"] - counts["converged"].astype(int)
    means = grouped[[*METRICS, *FLOORS]].mean().reset_index().merge(counts, on=keys)
    parts = []
    for metric in METRICS:
        floor = means.get(f"floor_{metric}", float("nan"))
        unit = "percent" if metric.endswith("percent") else "mm"
        part = means[[*keys, "insertions", "not_converged"]]
        parts.append(part.assign(table=name, metric=metric, unit=unit, value=means[metric], floor=floor))
    return pd.concat(parts, ignore_index=True)


def _printed(studies: Iterable[str], numbers: Mapping[str, int]) -> dict[tuple[Any, ...], float]:
    """Return the paper's cells by the keys of ours."""
    found: dict[tuple[Any, ...], float] = {}
    for study in studies:
        for name, keys in _PRINTED.items():
            for row in paper.table(name).to_dict("records"):
                if name != "validation" or row["study"] == numbers.get(study):
                    medium, layers = (row.get(key, ALL) for key in keys)
                    found |= {(name, study, medium, layers, m): float(row[m]) for m in METRICS}
    return found


_PRINTED: Mapping[paper.Table, tuple[str, str]] = {
    "validation": ("validate_medium", "validate_layers"),
    "tuning_by_layers": ("medium", "layers"),
    "tuning_by_media": ("medium", "none"),
}
