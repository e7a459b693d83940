"""Fit a tissue model to each specimen of many datasets; a dataset that cannot be fitted is a row of its own.

Each dataset is one task, which reads it, fits its specimens and forgets it: memory does not grow with the
cohort, but for the tables of results.
"""

import glob
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pandas as pd

from needlefit.datasets.insertion import Insertion
from needlefit.datasets.sources import compute_digest
from needlefit.errors import ConfigError, NeedlefitError
from needlefit.inference.identifiability.identify import find_bounds
from needlefit.inference.identifiability.precision import posterior_sds
from needlefit.metrics import compute_metrics, list_metrics
from needlefit.project.load import load
from needlefit.project.locate import find_file
from needlefit.project.toml_lines import add_study_context
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.recipe import RecipeRecord
from needlefit.schemas.study import FitRecord
from needlefit.studies.folds import Fold, group_insertions
from needlefit.studies.job import Job, Settings, find_named, prepare
from needlefit.studies.kinds.cohort.schema import CohortRecord
from needlefit.studies.posterior_fit import find_fit
from needlefit.studies.run import Frames, Run
from needlefit.studies.runner import AnalysisPlan, AnalysisTask, FrameRows, run_analysis
from needlefit.studies.score import Row

_WHERE = ("dataset", "specimen", "insertions")
FRAMES: Mapping[str, tuple[str, ...]] = {
    "fits": (*_WHERE, "parameter", "value", "sd", "at_bound", "converged", "origin"),
    "errors": (*_WHERE, "converged", "origin"),  # and the columns of metrics
    "failures": ("dataset", "specimen", "note"),
}
"""`specimen` is that of the insertions fitted together, or the insertion; errors are means over these, in
sample."""


def run(name: str, record: CohortRecord, settings: Settings) -> Run:
    """Fit each specimen of a cohort.

    Raises
    ------
    ConfigError
        If no dataset matches, the tissue model or the recipe is wrong, or nothing could be fitted.
    """
    if find_spec("pyarrow") is None:
        raise ConfigError(
            "a cohort is written as a Parquet file, for which PyArrow is not installed",
            fix="pip install 'needlefit[cluster]'",
        )
    with add_study_context(name, "datasets"):
        files = find_datasets(record)
    load(find_named("medium", record.medium), MediumRecord)  # wrong ones would fail in every dataset
    load(find_named("recipe", record.recipe), RecipeRecord)
    tasks: dict[str, AnalysisTask] = {
        str(file.parent): partial(_fit_dataset, name, file, record, settings) for file in files
    }
    columns = {**FRAMES, "errors": (*FRAMES["errors"], *(metric.name for metric in list_metrics()))}
    also = {"datasets_sha256": {str(file.parent): _digest(file) for file in files}}
    found = run_analysis(name, record, settings, AnalysisPlan((), tasks, columns, _conclude, also))
    made = (found.frames["fits"]["origin"] == "synthetic").any()
    title = f"{len(files)} dataset{'s' * (len(files) > 1)}"
    return replace(found, origin="synthetic" if made else "measured", dataset_title=title)


def find_datasets(record: CohortRecord) -> list[Path]:
    """Return the files `dataset.toml` that a cohort names, each once, in the order of its patterns.

    Raises
    ------
    ConfigError
        If a name is of no dataset, or a pattern matches none.
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
                expected="folders with a dataset.toml, from the folder in which the command runs",
            )
        found |= dict.fromkeys(files)
    return list(found)


def _digest(dataset: Path) -> str:
    """Return a digest of a dataset and of all files beside it."""
    files = [path for path in dataset.parent.rglob("*") if path.is_file() and path != dataset]
    return compute_digest(dataset, (dataset.parent,), files)


def _fit_dataset(name: str, file: Path, record: CohortRecord, settings: Settings) -> FrameRows:
    """Fit every specimen of one dataset; what cannot be read or fitted is a row of `failures`."""
    rows: FrameRows = {"fits": [], "errors": [], "failures": []}
    shared = ("medium", "recipe", "layer_count_rule", "tune")
    keys = record.model_dump(mode="json", by_alias=True, include=set(shared), exclude_defaults=True)
    fit = FitRecord.model_validate({"schema": FitRecord.SCHEMA, "dataset": str(file), **keys})
    try:
        job = prepare(f"{name} {file.parent}", fit, settings)
    except NeedlefitError as error:
        return {**rows, "failures": [{"dataset": str(file.parent), "specimen": "", "note": str(error)}]}
    for specimen, insertions in group_insertions(job.folds[0].tune, record.groups).items():
        where = {"dataset": str(file.parent), "specimen": specimen}
        try:
            fits, errors = _fit_specimen(job, specimen, insertions, settings)
        except NeedlefitError as error:
            rows["failures"].append({**where, "note": str(error)})
            continue
        about = {**where, "insertions": len(insertions), "origin": job.dataset.origin}
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
    sds, converged = posterior_sds(problem, theta), not fit.fault
    rows: list[Row] = [
        {"parameter": one, "value": fit.values[one], "sd": sd, "at_bound": bool(end), "converged": converged}
        for (one, sd), end in zip(sds.items(), find_bounds(problem, theta), strict=True)
    ]
    every = pd.DataFrame([compute_metrics(one) for one in problem.compare(theta)])
    return rows, {"converged": converged, **{str(name): value for name, value in every.mean().items()}}


def _conclude(frames: Frames) -> tuple[str, ...]:
    errors, failures = frames["errors"], frames["failures"]
    if errors.empty:
        raise ConfigError("nothing in the cohort could be fitted", expected=str(failures["note"].iloc[0]))
    open_fits = int((~errors["converged"].astype(bool)).sum())
    return (f"the searches of {open_fits} specimens did not converge",) if open_fits else ()
