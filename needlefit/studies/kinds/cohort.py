"""Fit a tissue model to each specimen of many datasets; a dataset that cannot be fitted is a row of its own.

Each dataset is one task, which reads it, fits its specimens and forgets it. To another machine a dataset is
sent as it was read here, with the tissue model and the recipe: no file is looked up there.
"""

import glob
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
from pydantic import Field

from needlefit.datasets.folds import Fold, divide_insertions
from needlefit.datasets.formats import FORMATS
from needlefit.datasets.insertion import Dataset, Insertion
from needlefit.datasets.read import read
from needlefit.datasets.sources import digest_folders
from needlefit.errors import ConfigError, NeedlefitError
from needlefit.geometry.curves import compare_curves
from needlefit.inference.identifiability.directions import format_sd
from needlefit.inference.identifiability.precision import find_bounds, posterior_sds
from needlefit.inference.parameter_names import is_logarithmic
from needlefit.mechanics.laws import LAWS
from needlefit.metrics import METRICS, compute_metrics, headline_metrics, list_metrics
from needlefit.project.checkpoint import open_checkpoint
from needlefit.project.locate import find_file, join_names
from needlefit.project.result_warnings import ResultWarning, to_stored_rows
from needlefit.project.toml import add_study_context, find_named, load
from needlefit.project.unit_warnings import medium_warnings
from needlefit.registry import plugin_versions
from needlefit.reporting.figures import Drawing
from needlefit.reporting.number_format import (
    format_bare_symbol,
    format_quantity,
    format_quantity_range,
    join_metrics,
)
from needlefit.reporting.table import Table
from needlefit.reporting.table_files import to_records
from needlefit.reporting.text import KindText
from needlefit.schemas.analyses import AnalysisRecord
from needlefit.schemas.deciding import select_deciding
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.origin import combine_origins
from needlefit.schemas.recipe import RecipeRecord
from needlefit.schemas.run_metadata import CohortMetadata
from needlefit.schemas.study import FitRecord, LayerCountRule, SelectionRecord
from needlefit.studies.answer import Answer, FaultKind, RunFault
from needlefit.studies.fold_draws import find_fit
from needlefit.studies.identity import make_identity
from needlefit.studies.job import Job, Settings
from needlefit.studies.kind import StudyKind
from needlefit.studies.load import load_study, print_notes
from needlefit.studies.provenance import PACKAGES, describe_model_options, package_versions
from needlefit.studies.report import StudyReport, answer_in_words
from needlefit.studies.run import Frames, Run
from needlefit.studies.runner import AnalysisTask, FrameRows, join_rows, run_tasks
from needlefit.studies.score import Row


class CohortRecord(AnalysisRecord):
    """`kind = "cohort"`: the same fit for each specimen of many datasets."""

    kind: Literal["cohort"]
    datasets: tuple[str, ...] = Field(min_length=1)
    """Datasets: names in `data/`, paths of folders, or patterns of paths such as `"specimens/*"`."""
    medium: str
    """Name of a tissue model in `configs/media/`, or the path of its file."""
    recipe: str = "default"
    """Name of a recipe in `configs/recipes/`, or the path of its file."""
    layer_count_rule: LayerCountRule = "listed"
    """Number of layers of an insertion that ends at a boundary: as its row lists it, or the other count."""
    tune: SelectionRecord = Field(default=SelectionRecord())
    """Insertions that are fitted, in each dataset."""
    groups: Literal["specimen", "insertion"] = "specimen"
    """What is fitted together."""


KIND = StudyKind("cohort", CohortRecord, __name__, CohortMetadata)

MAX_NAMED_COPIES = 8  #: datasets that a warning names

_WHERE = ("dataset", "specimen", "insertions")
FRAMES: Mapping[str, tuple[str, ...]] = {
    "fits": (*_WHERE, "parameter", "value", "sd", "at_bound", "converged", "origin"),
    "errors": (*_WHERE, "converged", "origin"),  # and the columns of metrics
    "failures": ("dataset", "specimen", "note"),
}
"""`specimen` is that of the insertions fitted together, or the insertion; errors are means over these, in
sample."""


def run(name: str, record: CohortRecord, settings: Settings) -> Run:
    """Fit each specimen of a cohort."""
    with add_study_context(name, "datasets"):
        files = find_datasets(record)
    medium_file = find_named("medium", record.medium)
    medium = load(medium_file, MediumRecord)
    recipe = load(find_named("recipe", record.recipe), RecipeRecord)
    if settings.seed is not None:
        recipe = recipe.model_copy(update={"seed": settings.seed})
    settings = replace(settings, inputs=replace(settings.inputs, medium=medium, recipe=recipe))
    source = _SentDataset if settings.task_pool().remote else _LocalDataset
    tasks: dict[str, AnalysisTask] = {
        str(file.parent): partial(_fit_dataset, name, file, source(file), record, settings) for file in files
    }
    metrics = tuple(metric.name for metric in list_metrics())
    columns = {
        "fits": FRAMES["fits"],
        "errors": (*FRAMES["errors"], *metrics),
        "failures": (*FRAMES["failures"], "origin"),
    }
    digests = {str(file.parent): digest_folders(file) for file in files}
    warnings = list(medium_warnings(medium, medium_file))
    first: dict[str, str] = {}
    pairs = [(one, first.setdefault(digest, one)) for one, digest in digests.items()]
    if copies := [f"{one} (as {other})" for one, other in pairs if one != other]:
        words = "datasets with the same files are fitted more than once"
        words = f"{words}: {join_names(copies, MAX_NAMED_COPIES)}"
        warnings.insert(0, ResultWarning("same_dataset", words, "", "list each dataset once"))
    every = ((registry, one) for registry in (METRICS, FORMATS) for one in registry.names())
    records = {"medium": medium, "recipe": recipe}
    stored = {key: one.model_dump(mode="json", by_alias=True) for key, one in records.items()}
    stored["rules"] = describe_model_options(medium)
    parts = {
        "options of the analysis": select_deciding(record, ("datasets", "medium", "recipe")),
        "tissue model": select_deciding(medium),
        "recipe": select_deciding(recipe),
        "data": sorted(digests.values()),
    }
    work = CohortMetadata(
        name=name,
        identity=make_identity(parts, {}),
        # of plugins all that may read a dataset
        versions=package_versions(PACKAGES) | plugin_versions((LAWS, medium.law), *every),
        study=record.model_dump(mode="json", by_alias=True),
        parts=[stored],
        datasets_sha256=digests,
    )
    checkpoint = open_checkpoint(settings.checkpoint, settings.resume, work.work, settings.note)
    done = run_tasks(tasks, name, settings, checkpoint)
    rows, interrupted = join_rows(done), len(done) < len(tasks)
    frames: Frames = {
        frame: pd.DataFrame(rows.get(frame, []), columns=list(names)) for frame, names in columns.items()
    }
    return Run(
        kind=str(record.kind),
        name=name,
        record=record,
        origin=combine_origins(frames["errors"]["origin"]),
        dataset_title=f"{len(files)} dataset{'s' * (len(files) > 1)}",
        frames=frames,
        metadata=work.state(warnings=to_stored_rows(warnings)),
        timing={},
        interrupted=interrupted,
        faults=() if interrupted else _conclude(frames),
    )


def find_datasets(record: CohortRecord) -> list[Path]:
    """Return the files `dataset.toml` that a cohort names, each once, in the order of its patterns.

    Raises ConfigError if a name is of no dataset, or a pattern matches none.
    """
    found: dict[Path, None] = {}
    for pattern in record.datasets:
        if not glob.has_magic(pattern):
            found[find_file("dataset", pattern)] = None
            continue
        matches = sorted(glob.glob(pattern, recursive=True))  # noqa: PTH207  absolute ones too
        files = [file for path in matches if (file := Path(path) / "dataset.toml").is_file()]
        if not files:
            raise ConfigError(
                f"the pattern {pattern!r} matches no dataset",
                key="datasets",
                expected="folders with a dataset.toml",
            )
        found |= dict.fromkeys(files)
    return list(found)


@dataclass(frozen=True)
class _LocalDataset:
    """A dataset that the process which fits it reads."""

    file: Path

    def __call__(self) -> Dataset:
        return read(self.file)


class _SentDataset(_LocalDataset):
    """A dataset for another machine: read here when its task is sent, not before, so that memory is flat."""

    def __reduce__(self) -> tuple[Callable[..., Callable[[], Dataset]], tuple[object, ...]]:
        try:
            return partial, (_return_dataset, self())
        except NeedlefitError as error:
            return partial, (_raise_error, error)


def _return_dataset(dataset: Dataset) -> Dataset:
    return dataset


def _raise_error(error: NeedlefitError) -> Dataset:
    raise error


def _fit_dataset(
    name: str, file: Path, source: Callable[[], Dataset], record: CohortRecord, settings: Settings
) -> FrameRows:
    """Fit every specimen of one dataset; what cannot be read or fitted is a row of `failures`.

    `settings.inputs` has the tissue model and the recipe.
    """
    rows: FrameRows = {"fits": [], "errors": [], "failures": []}
    failed = {"dataset": str(file.parent), "specimen": "", "origin": "none"}
    shared = ("medium", "recipe", "layer_count_rule", "tune")
    keys = record.model_dump(mode="json", by_alias=True, include=set(shared), exclude_defaults=True)
    asked = FitRecord.model_validate({"schema": FitRecord.SCHEMA, "dataset": str(file), **keys})
    try:
        dataset = source()
        failed["origin"] = dataset.origin
        job = load_study(f"{name} {file.parent}", asked, settings, dataset)
        print_notes(job, settings)
    except NeedlefitError as error:
        return {**rows, "failures": [{**failed, "note": str(error)}]}
    for specimen, insertions in divide_insertions(job.folds[0].tune, record.groups).items():
        where = {"dataset": str(file.parent), "specimen": specimen, "origin": dataset.origin}
        try:
            fits, errors = _fit_specimen(job, specimen, insertions, settings)
        except NeedlefitError as error:
            rows["failures"].append({**where, "note": str(error)})
            continue
        about = {**where, "insertions": len(insertions)}
        rows["fits"] += [{**about, **row} for row in fits]
        rows["errors"].append({**about, **errors})
        if settings.stop():
            break
    return rows


def _fit_specimen(
    job: Job, specimen: str, insertions: tuple[Insertion, ...], settings: Settings
) -> tuple[list[Row], Row]:
    """Return the parameters of one specimen, and the mean errors of the fit."""
    problem = job.problem(Fold(specimen, insertions, ()))
    fit = find_fit(job, problem, (specimen,), settings)
    theta = np.array(fit.theta)
    sds, converged, compared = posterior_sds(problem, theta), not fit.fault, job.dataset.compared
    rows: list[Row] = [
        {"parameter": one, "value": fit.values[one], "sd": sd, "at_bound": bool(end), "converged": converged}
        for (one, sd), end in zip(sds.items(), find_bounds(problem, theta), strict=True)
    ]
    every = pd.DataFrame([compute_metrics(compare_curves(*pair, compared)) for pair in problem.points(theta)])
    return rows, {"converged": converged, **{str(name): value for name, value in every.mean().items()}}


def _conclude(frames: Frames) -> tuple[RunFault, ...]:
    converged = frames["errors"]["converged"].astype(bool)
    if converged.empty:
        first = str(frames["failures"]["note"].iloc[0])
        raise ConfigError("nothing in the cohort could be fitted", expected=first)
    open_fits = int((~converged).sum())
    what = f"the searches of {open_fits} specimens did not converge"
    return (RunFault(FaultKind.NOT_CONVERGED, what),) if open_fits else ()


# ---- the report

TEXT = KindText("cohort", rules={"failures_named": lambda v: v.failures})
MAX_LISTED = 20  #: failures that the report lists; `failures.csv` has all
MAX_NAMED = 3  #: failures that the first sentence names
MAX_BINS = 40  #: bins of a histogram


def describe_cohort(run: Run) -> dict[str, Any]:
    """Return what the text prints."""
    metrics = [metric.name for metric in headline_metrics()]
    errors, failures = run.frames["errors"], run.frames["failures"]
    pairs = failures[["dataset", "specimen"]].itertuples(index=False)
    names = [f"{dataset} ({specimen})" if specimen else str(dataset) for dataset, specimen in pairs]
    return {
        "specimens": len(errors),
        "datasets": errors["dataset"].nunique(),
        "insertions": int(errors["insertions"].sum()),
        "failures": len(names),
        "named": join_names(names, MAX_NAMED) if names else "",
        "listed": min(len(names), MAX_LISTED),
        "medians": [
            f"{format_bare_symbol(name)} {format_quantity(name, float(rows['value'].median()))}"
            for name, rows in _by_parameter(run)
        ],
        "errors": join_metrics({name: float(errors[name].median()) for name in metrics}),
    }


def answer_cohort(run: Run) -> Answer:
    """Return the first sentence and the parameters; failures make it a warning."""
    failures = len(run.frames["failures"])
    return answer_in_words(run, "warn" if failures else "pass", failures=failures)


def _by_parameter(run: Run) -> Iterator[tuple[str, pd.DataFrame]]:
    for name, rows in run.frames["fits"].groupby("parameter", sort=False):
        yield str(name), rows


def tabulate_cohort(run: Run) -> list[Table]:
    """Return the parameters over specimens, and what could not be fitted."""
    rows = []
    for name, found in _by_parameter(run):
        low, high = np.quantile(found["value"], [0.05, 0.95]).tolist()
        rows.append(
            {
                "parameter": format_bare_symbol(name),
                "specimens": len(found),
                "specimen_median": format_quantity(name, float(found["value"].median())),
                "specimen_range": format_quantity_range(name, low, high),
                "sd": format_sd(float(found["sd"].median()), is_logarithmic(name)),
                "specimens_at_bound": int(found["at_bound"].astype(bool).sum()),
            }
        )
    columns = ("parameter", "specimens", "specimen_median", "specimen_range", "sd", "specimens_at_bound")
    failures = run.frames["failures"][list(FRAMES["failures"])].head(MAX_LISTED)
    failed = [Table("failures", to_records(failures), FRAMES["failures"])] if len(failures) else []
    return [Table("parameters", rows, columns), *failed]


def draw_cohort(run: Run) -> dict[str, Drawing]:
    """Return a histogram of each parameter over specimens: edges of bins in units of files, and counts."""
    found = []
    for name, rows in _by_parameter(run):
        values = rows["value"].to_numpy(dtype=np.float64)
        scale, back = (np.log, np.exp) if is_logarithmic(name) else (np.asarray, np.asarray)
        edges = np.histogram_bin_edges(scale(values), bins=min(MAX_BINS, 5 + len(values) // 5))
        counts, _ = np.histogram(scale(values), edges)
        low, high = back(edges[:-1]), back(edges[1:])
        found.append(pd.DataFrame({"parameter": name, "low": low, "high": high, "specimens": counts}))
    bins = pd.concat(found, ignore_index=True).assign(origin=run.origin)
    return {"distributions": Drawing("histograms", bins, {"counts": "specimens"})}


REPORT = StudyReport(TEXT, describe_cohort, tabulate_cohort, draw_cohort, answer_cohort)
