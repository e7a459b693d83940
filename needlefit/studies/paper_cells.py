"""Compute every cell of the paper's tables from studies and fits, beside the published value.

Studies give the table of validation, fits the two of tuning. Layers are where the needle was measured to
cross them, as the paper does it.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import pandas as pd

from needlefit.datasets.insertion import Dataset, Insertion
from needlefit.datasets.noise import NoiseFloor
from needlefit.inference.fit import Callbacks, Fit
from needlefit.inference.optimize import minimize
from needlefit.metrics import METRICS, headline_metrics, list_metrics
from needlefit.project.locate import find_file
from needlefit.project.random_streams import random_stream
from needlefit.project.toml import add_file_context, add_key_context, load
from needlefit.schemas.recipe import RecipeRecord
from needlefit.schemas.study import FitRecord, StudyRecord
from needlefit.studies import paper
from needlefit.studies.fit_frames import list_score_columns
from needlefit.studies.job import Fold, Inputs, Job, Settings, find_named, load_medium, prepare
from needlefit.studies.score import Predictor, Row, Scorer
from needlefit.studies.scored_groups import PUBLISHED, aggregate

ERROR_COLUMNS = (
    *("study", "role", "insertion", "medium", "specimen", "layers", "method"),
    *("deflection_mm", "predicted_deflection_mm", "converged"),
)
"""Facts of a row of errors; a column for each metric and noise floor follows."""

CELL_KEYS = ("grouping", "study", "medium", "layers")
CELL_COLUMNS = (*CELL_KEYS, "metric", "unit", "value", "floor", "paper", "insertions", "not_converged")
"""`layers` is 0 where a row of the paper's table counts all; `floor` is NaN where a metric has none."""

ALL_LAYERS = 0  #: layers of a row that counts insertions through any number of them


@dataclass(frozen=True)
class LoadedFit:
    """A study or fit with the tissue model and recipe that it names, for a machine without these files."""

    record: FitRecord | StudyRecord
    inputs: Inputs
    file: Path


def load_fits(studies: Sequence[str], fits: Sequence[str]) -> dict[str, LoadedFit]:
    """Return studies and fits by name, with what they name but their datasets."""
    found = {}
    named = [("studies", name) for name in studies] + [("fits", name) for name in fits]
    for key, name in named:
        with add_key_context(key):
            file = find_file("study" if key == "studies" else "fit", name)
        record = load(file, StudyRecord) if key == "studies" else load(file, FitRecord)
        with add_file_context(file):
            recipe = load(find_named("recipe", record.recipe), RecipeRecord)
            found[name] = LoadedFit(record, Inputs(medium=load_medium(record)[0], recipe=recipe), file)
    return found


def prepare_jobs(studies: Sequence[str], fits: Sequence[str], settings: Settings) -> dict[str, Job]:
    """Return studies and fits by name, on their own dataset, scored as in the paper."""
    found = {}
    for name, fit in load_fits(studies, fits).items():
        with add_file_context(fit.file):
            found[name] = without_surfaces(prepare(name, fit.record, replace(settings, file=fit.file)))
    return found


def prepare_on_dataset(fits: Mapping[str, LoadedFit], settings: Settings, dataset: Dataset) -> dict[str, Job]:
    """Return the jobs of loaded fits by name, on another dataset than their own."""
    return {
        name: without_surfaces(prepare(name, fit.record, replace(settings, inputs=fit.inputs), dataset))
        for name, fit in fits.items()
    }


def without_surfaces(job: Job) -> Job:
    """Return the job without surfaces, so that only the measured layer crossings are scored."""
    return with_insertions(job, lambda one: replace(one, surfaces=()))


def with_insertions(job: Job, changed: Callable[[Insertion], Insertion]) -> Job:
    folds = tuple(
        Fold(fold.name, tuple(map(changed, fold.tune)), tuple(map(changed, fold.validate)))
        for fold in job.folds
    )
    return replace(job, folds=folds)


def with_starts(job: Job, starts: int | None) -> Job:
    """Return the job with this number of random starts per search; None keeps the recipe's."""
    if starts is None:
        return job
    return replace(job, recipe=job.recipe.model_copy(update={"starts": starts}))


def compute_floors(jobs: Iterable[Job]) -> dict[str, NoiseFloor]:
    """Return the noise floor of every insertion of all jobs, by its id."""
    every = {one.id: (job, one) for job in jobs for one in job.insertions}
    return {name: job.floor(one) for name, (job, one) in every.items()}


def run_search(job: Job, search: str, settings: Settings) -> Fit:
    """Return the fit of one search of a job with a single fold, as `validate` and `tune` compute it."""
    fold = job.folds[0]
    rng = random_stream(job.recipe.seed, fold.name, search, "starts")
    callbacks = Callbacks(stop=settings.stop, jobs=settings.jobs)
    return minimize(job.problem(fold, search), job.recipe_of(search), rng, callbacks)


def score_methods(job: Job, methods: Mapping[str, Predictor], floors: Mapping[str, NoiseFloor]) -> list[Row]:
    """Return the errors of methods on every insertion of a job with a single fold, in sample and held out."""
    scorer, fold = Scorer(job.dataset, job.record.layer_count_rule, floors), job.folds[0]
    rows = []
    for role, insertions in (("tune", fold.tune), ("validate", fold.validate)):
        for insertion in insertions:
            for name, method in methods.items():
                place = {"study": job.name, "role": role, "method": name}
                rows += scorer.score(place, insertion, method)[0]
    columns = (*ERROR_COLUMNS, *list_score_columns())
    return [{name: row[name] for name in columns} for row in rows]


def find_paper_numbers(jobs: Mapping[str, Job]) -> dict[str, int]:
    """Return the published numbers of the studies among jobs; a fit has none."""
    numbers = {name: getattr(job.record, "paper_study", None) for name, job in jobs.items()}
    return {name: number for name, number in numbers.items() if number is not None}


def tabulate_cells(errors: pd.DataFrame, numbers: Mapping[str, int], by: Sequence[str] = ()) -> pd.DataFrame:
    """Return all cells of one method's `ERROR_COLUMNS`, one per row.

    `numbers` are the paper's, of each study; `by` are columns of `errors` that make tables of their own: a
    seed, a variation.
    """
    held_out = errors[errors["role"] == "validate"]
    fits = errors[~errors["study"].isin(held_out["study"])]
    grouped = [
        held_out.assign(grouping="validation"),
        fits.assign(grouping="tuning_by_layers"),
        fits.assign(grouping="tuning_by_media", layers=ALL_LAYERS),
    ]
    every = pd.concat(grouped, ignore_index=True).assign(edp_flagged=False)
    frame = aggregate(every, ["grouping", *by, "study", "medium", "layers"])
    units = {metric.name: "percent" if metric.unit == "%" else "mm" for metric in list_metrics()}
    frame = frame.assign(unit=frame["metric"].map(units))
    order = {name: place for place, name in enumerate((*dict(PUBLISHED.values()), *units))}
    frame = frame.sort_values(["grouping", "metric"], key=lambda names: names.map(order), kind="stable")
    printed = _published_cells(frame["study"].unique(), numbers)
    keys = [tuple(row) for row in frame[[*CELL_KEYS, "metric"]].itertuples(index=False)]
    frame["paper"] = [printed.get(key, float("nan")) for key in keys]
    ours = (frame["grouping"] != "tuning_by_layers") | frame["paper"].notna()  # the paper's has one phantom
    return frame.loc[ours, [*by, *CELL_COLUMNS]].reset_index(drop=True)


def _published_cells(studies: Iterable[str], numbers: Mapping[str, int]) -> dict[tuple[Any, ...], float]:
    """Return the paper's cells by the keys of ours."""
    found: dict[tuple[Any, ...], float] = {}
    for study in studies:
        for name, columns in PUBLISHED.values():
            for row in paper.select_rows(name):
                if name != "validation" or row["study"] == numbers.get(study):
                    group = {ours: row[theirs] for theirs, ours in columns.items()}
                    place = (name, study, group["medium"], group.get("layers", ALL_LAYERS))
                    printed = [metric for metric in METRICS.names() if metric in row]
                    found |= {(*place, metric): float(row[metric]) for metric in printed}
    return found


def tabulate_generalisation(fitted: pd.DataFrame, by: Sequence[str]) -> pd.DataFrame:
    """Return the headline metrics and their floors of every study, and whether it `generalises`.

    `fitted` are errors of one method, with the columns `by` beside.
    """
    held_out = fitted[fitted["role"] == "validate"].replace([float("inf")], float("nan"))
    columns = [name for name in list_score_columns(headline_metrics()) if name in held_out]
    means = held_out.groupby([*by, "study"], sort=False)[columns].mean().reset_index()
    limit = generalisation_threshold()
    return means.assign(limit_mm=limit, generalises=means["ipe_mean_mm"] < limit)


def generalisation_threshold() -> float:
    """Return the mean IPE, mm, below which a study generalises."""
    printed = sorted(float(value) for value in paper.read_published_table("validation")["ipe_mean_mm"])
    low, high = max(pairwise(printed), key=lambda pair: pair[1] / pair[0])
    return float((low * high) ** 0.5)
