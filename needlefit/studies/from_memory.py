"""Studies and fits of what Python hands over: names, paths, records, tables, datasets and runs."""

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from needlefit.datasets.insertion import Dataset, Insertion
from needlefit.datasets.read import read
from needlefit.errors import ConfigError
from needlefit.inference.parameter_changes import change_fit, read_priors, set_priors
from needlefit.project.input_files import to_json_values
from needlefit.project.locate import find_file, find_studies
from needlefit.project.processes import count_cores
from needlefit.project.toml import IN_MEMORY, add_file_context, check, read_given, spell_name
from needlefit.schemas.base import FileRecord
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.recipe import RecipeRecord
from needlefit.schemas.study import FitRecord, SelectionRecord
from needlefit.studies.job import Job, Settings, StatedStudy
from needlefit.studies.load import check_study, load_study, load_study_file, load_target, reopen_fit
from needlefit.studies.run import Run

Name = str | Path
Table = Mapping[str, Any]
Medium = Name | MediumRecord | Table
Recipe = Name | RecipeRecord | Table

#: types of options, and how messages state them
_OPTION_TYPES: Mapping[str, tuple[type, str]] = {
    "name": (str, "a text"),
    "seed": (int, "a whole number"),
    "jobs": (int, "a whole number"),
    "tune": (Mapping, 'a table: {"layers": [3]}'),
    "priors": (Mapping, 'a table: {1: "prior.toml"}'),
    "free": (Sequence, 'a list: ["alpha1"]'),
    "fix": (Mapping, 'a table: {"mu1": 4e3}'),
}


def check_types(**options: object) -> None:
    """Raise ConfigError if an option has a wrong type, or `jobs` is below 1. None: it was not given."""
    for name, value in options.items():
        kind, expected = _OPTION_TYPES[name]
        if value is not None and (
            not isinstance(value, kind) or (kind is Sequence and isinstance(value, str))
        ):
            raise ConfigError(f"`{name}` is {value!r:.60}", expected=expected)
    if isinstance(jobs := options.get("jobs"), int) and jobs < 1:
        raise ConfigError(f"`jobs` is {jobs}", expected="1 or more")


def open_fit(target: Name | Dataset | Run, medium: Medium | None, stored: bool = True) -> StatedStudy:
    """Return the fit of a dataset with a medium, of a run, or of a file."""
    if medium is not None:
        return _begin_fit(target, medium, stored)
    if isinstance(target, Dataset):
        fix = 'name the model: fit(dataset, "phantom1")'
        raise ConfigError("a dataset alone cannot be fitted", fix=fix)
    if isinstance(target, Run):
        return reopen_run(target)
    name, record, inputs, file, _ = load_target(spell_name(target))
    return StatedStudy(name, record, inputs, file)


def _begin_fit(target: Name | Dataset | Run, medium: Medium, stored: bool) -> StatedStudy:
    if isinstance(target, Run):
        raise ConfigError("a run has a medium already", fix="leave `medium` out, or give the dataset")
    table = {"schema": FitRecord.SCHEMA, "dataset": IN_MEMORY, "medium": IN_MEMORY}
    empty = StatedStudy("", check(table, FitRecord, "needlefit.fit"))
    job = replace_inputs(empty, target, medium, stored=stored)
    record, inputs = require_fit(job.record), job.inputs
    dataset = read(find_file("dataset", record.dataset)) if inputs.dataset is None else inputs.dataset
    inputs = replace(inputs, dataset=dataset)
    if inputs.medium:
        return StatedStudy(dataset.name, record, inputs)
    stem = Path(record.medium).stem
    if stem in dataset.media and len(dataset.media) > 1:
        media = f"{len(dataset.media)} media of {dataset.name}"
        note = f"Fitted to the insertions into {stem}, one of the {media}."
        record = record.model_copy(update={"tune": SelectionRecord(medium=stem), "note": note})
    return StatedStudy(f"{dataset.name}-{stem}", record, inputs)


def open_study(study: Name | FileRecord | Table) -> StatedStudy:
    """Return a study by its record, its keys, or the name of its file."""
    if isinstance(study, FileRecord):
        return StatedStudy("study", study)
    if isinstance(study, Mapping):
        return StatedStudy("study", check_study(study, "needlefit.validate"))
    (name, file), *others = find_studies(spell_name(study))
    if others:
        raise ConfigError(
            f"`{study}` means several studies",
            expected="a single one",
            fix=f"run them one by one: {', '.join([name, *(other for other, _ in others)])}",
        )
    return StatedStudy(name, load_study_file(file), file=file)


def require_fit(record: FileRecord) -> FitRecord:
    """Return the record of a study that fits and scores, or of a fit; ConfigError for another."""
    if isinstance(record, FitRecord):
        return record
    raise ConfigError(
        "only a study without `kind` takes another dataset, tissue model or recipe",
    )


def prepare_job(study: StatedStudy, seed: int | None, jobs: int | None) -> tuple[Job, int]:
    """Return the job of a study that is computed here, without a run, and the threads to use."""
    check_types(seed=seed, jobs=jobs)
    settings = Settings(seed=seed, jobs=count_cores() if jobs is None else jobs, inputs=study.inputs)
    with add_file_context(study.file):
        return load_study(study.name, require_fit(study.record), settings), settings.jobs


def replace_inputs(
    study: StatedStudy,
    dataset: Name | Dataset | None = None,
    medium: Medium | None = None,
    recipe: Recipe | None = None,
    *,
    stored: bool = True,
) -> StatedStudy:
    """Return a study with other data, another tissue model or recipe.

    Of a run that may be `stored`, the dataset must be what its files hold.
    """
    if dataset is None and medium is None and recipe is None:
        return study
    record, inputs = require_fit(study.record), study.inputs
    changes: dict[str, Any] = {}
    if isinstance(dataset, Dataset):
        inputs = replace(inputs, dataset=_require_unchanged(dataset) if stored else dataset)
        changes["dataset"] = _name_dataset(dataset)
    elif dataset is not None:
        changes["dataset"] = spell_name(dataset)
    if isinstance(medium, Name):
        changes["medium"] = spell_name(medium)
    elif medium is not None:
        given, changes["medium"] = read_given("medium", medium, MediumRecord)
        inputs = replace(inputs, medium=given)
    if recipe is not None:
        chosen, changes["recipe"] = read_recipe(recipe)
        inputs = replace(inputs, recipe=chosen)
    record = check(merge_keys(record, changes), type(record), "needlefit.validate")
    return replace(study, record=record, inputs=inputs)


def change_stated_fit(
    study: StatedStudy,
    tune: Table | None = None,
    recipe: Recipe | None = None,
    priors: Mapping[int, Name] | None = None,
    free: Sequence[str] = (),
    fix: Mapping[str, float] | None = None,
) -> StatedStudy:
    """Return a fit with the changes that were asked for."""
    check_types(tune=tune, priors=priors, free=free, fix=fix)
    record, inputs, fix = require_fit(study.record), study.inputs, fix or {}
    changes: dict[str, Any] = {}
    if tune is not None:
        changes["tune"] = tune
    if priors is not None:
        changes["priors"] = {str(layer): str(file) for layer, file in priors.items()}
    if recipe is not None:
        chosen, changes["recipe"] = read_recipe(recipe)
        inputs = replace(inputs, recipe=chosen)
    record = check(merge_keys(record, changes), type(record), "needlefit.fit")
    medium = inputs.medium and set_priors(inputs.medium, {} if priors is None else read_priors(record))
    record, medium = change_fit(record, medium, free, fix, "needlefit.fit")
    return replace(study, record=record, inputs=replace(inputs, medium=medium))


def reopen_run(run: Run) -> StatedStudy:
    """Return the fit of a run, with its data, medium, recipe and posterior."""
    return StatedStudy(*reopen_fit(run, f"run `{run.name}`"))


def read_recipe(value: Recipe) -> tuple[RecipeRecord, str]:
    """Return a recipe and its name; a table changes keys of the default one."""
    if isinstance(value, Mapping):
        default, _ = read_given("recipe", "default", RecipeRecord)
        value = merge_keys(default, {"title": "", **value})
    return read_given("recipe", value, RecipeRecord)


def merge_keys(record: FileRecord | None, changes: Table) -> dict[str, Any]:
    """Return the keys of a record, with changes, as JSON values."""
    table = {} if record is None else record.model_dump(mode="json", by_alias=True)
    return table | {key: to_json_values(value) for key, value in changes.items()}


def _name_dataset(dataset: Dataset) -> str:
    """Return the name by which a dataset is found again: its bare one, or its path."""
    try:
        stored: Path | None = find_file("dataset", dataset.path.parent.name)
    except ConfigError:
        stored = None
    return dataset.path.parent.name if stored == dataset.path else str(dataset.path)


def _require_unchanged(dataset: Dataset) -> Dataset:
    """Return a dataset that is what its files hold, so that a run's record of it is true."""
    stored = read(dataset.path)
    pairs = zip(dataset.insertions, stored.insertions, strict=False)
    same = len(dataset.insertions) == len(stored.insertions) and all(_is_same(*pair) for pair in pairs)
    if not same or dataset.noise != stored.noise:
        raise ConfigError(
            "the dataset is not what its files hold",
            where=dataset.path,
            expected="a dataset as `load_dataset` returns it",
            fix="select insertions with `tune`; write changed data to a folder of their own",
        )
    return dataset


def _is_same(insertion: Insertion, other: Insertion) -> bool:
    plain = (np.ndarray, float, int, str)
    values = ((getattr(insertion, field.name), getattr(other, field.name)) for field in fields(insertion))
    same = all(np.array_equal(a, b) for a, b in values if isinstance(a, plain))
    return same and insertion.needle == other.needle
