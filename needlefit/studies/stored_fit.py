"""Reopen the fit of a run: data, tissue model, recipe and posterior as they were, wherever its folder lies.

A run keeps a copy of its data (`store`), so that its folder can be moved alone. Where there is none, as of
earlier versions and of large data, the dataset is looked for where it was, then by its name.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from needlefit.datasets.insertion import Dataset
from needlefit.datasets.read import inspect, read
from needlefit.datasets.sources import find_dataset_file
from needlefit.errors import ConfigError, DataError
from needlefit.project.input_files import is_file
from needlefit.project.locate import find_file, is_path
from needlefit.project.result_warnings import ResultWarning
from needlefit.schemas.study import FitRecord, StudyRecord
from needlefit.studies.identity import describe_change, has_data, identify
from needlefit.studies.job import Inputs, Settings
from needlefit.studies.load import load_study
from needlefit.studies.run import Run


def reopen_fit(run: Run, where: str) -> tuple[str, FitRecord, Inputs]:
    """Return the fit of a run, of a study that which it begins with; errors name the run by `where`.

    These are the name of its results, the fit, and what stands for the files that it names.

    Raises ConfigError if the run is no fit, or this version makes another one of it. DataError as of
    `read_data`.
    """
    record = run.record
    if not isinstance(record, FitRecord):
        raise ConfigError(
            f"is of kind {run.kind}, no fit",
            where=where,
            expected="a run of `needlefit tune` or `needlefit validate`",
        )
    stated = run.metadata
    inputs = Inputs(dataset=read_data(run, where), medium=stated.medium, recipe=stated.recipe)
    job = load_study(run.name, record, Settings(inputs=inputs))
    if stated.identity is not None and (changed := describe_change(stated.identity, identify(job))):
        raise ConfigError(
            f"this version makes another fit of it; changed since: {changed}",
            where=where,
            expected="the same insertions, data, tissue model, recipe and options",
            fix=f"run {run.name} again",
        )
    one_fit = len(run.posteriors) == 1 and len(job.folds) == 1
    name = run.name
    if isinstance(record, StudyRecord):
        name, record = f"{name}-tune", record.tuning()
    posterior = run.posterior if one_fit else None
    return name, record, replace(inputs, target=(name, record), posterior=posterior)


def read_data(run: Run, where: str) -> Dataset:
    """Return the dataset of a run: its own copy, else the files that it was read from, if they are the same.

    A copy that differs from those files has a warning. Raises DataError if there is neither; it names
    `where`, the run.
    """
    before = Path(run.timing.get("folder", ""), run.timing.get("dataset", ""))
    before = before if before.suffix == ".toml" else before / "dataset.toml"
    if run.data is not None and is_file(run.data.file):
        dataset = read(run.data.file, root=run.data.root)
        if has_data(run.metadata, dataset):
            return _warn_changed(dataset, run, before)
    changed: Path | None = None
    for file in _list_files(run, before):
        dataset = read(file)
        if has_data(run.metadata, dataset):
            return dataset
        changed = changed or file
    name = run.record.dataset
    if changed is not None:
        raise DataError(
            f"its dataset, {name}, has changed since",
            where=where,
            expected=f"{changed} as it was then",
            fix=f"run {run.name} again, or restore the data",
        )
    was = str(before.parent) if before.is_absolute() else f"{before.parent}, below the folder of that command"
    looked = Path.cwd() / (name if is_path(name) else f"data/{name}")
    raise DataError(
        f"its dataset, {name}, is not found, nor a copy of it in the run",
        where=where,
        expected=f"its folder at {was}, or at {looked}",
        fix=f"copy the dataset to one of these, or run {run.name} again",
    )


def _list_files(run: Run, before: Path) -> Iterator[Path]:
    """Yield the datasets that may be that of a run: where it was, and by its name."""
    if is_file(before):
        yield before
    try:
        dataset_file = find_dataset_file(find_file("dataset", run.record.dataset))
    except ConfigError:
        return
    if dataset_file.absolute() != before.absolute():
        yield dataset_file


def _warn_changed(dataset: Dataset, run: Run, before: Path) -> Dataset:
    """Return the copy of a run's dataset, with a warning if the data of its insertions have changed since."""
    if dataset.files is None or not dataset.files.differ_from(before):
        return dataset
    now = inspect(before).dataset if is_file(before) else None
    if now is not None and has_data(run.metadata, now):
        return dataset  # a comment was changed, or another insertion
    problem = f"the dataset has changed since {run.name}, which uses its own copy"
    fix = f"run {run.name} again to use the new data"
    warning = ResultWarning("data_changed", problem, str(before), fix)
    return replace(dataset, warnings=(*dataset.warnings, warning))
