"""Load a study of any kind: its file, the data that it needs, the fit that it names, parameters, folds.

What cannot be fitted is refused before hours of work.
"""

import os
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from needlefit.datasets.compared import describe_compared, find_left_planes, set_compared
from needlefit.datasets.folds import Fold, make_folds, warn_shared_specimens
from needlefit.datasets.insertion import Dataset
from needlefit.datasets.paper import read_hand_tuned
from needlefit.datasets.read import inspect, read
from needlefit.datasets.sources import DATASET_FILE, find_dataset_file
from needlefit.errors import ConfigError, DataError, ModelError
from needlefit.inference.doubts import Doubts, find_doubts
from needlefit.inference.forward_model import make_options as mesh
from needlefit.inference.parameter_changes import complete_published, load_changed_medium, search_freed
from needlefit.inference.parameters import Parameters, with_hyperparameters, without_prior
from needlefit.inference.problem import Problem
from needlefit.inference.sampling.samplers import SAMPLERS
from needlefit.mechanics.plan import check_size, count_element_solves
from needlefit.project.input_files import is_file, to_json_values
from needlefit.project.locate import find_file, find_study_or_fit, is_path, read_toml
from needlefit.project.processes import one_thread
from needlefit.project.result_warnings import ResultWarning, to_stored_rows
from needlefit.project.toml import add_file_context, add_key_context, check, find_named, load
from needlefit.project.unit_warnings import medium_warnings
from needlefit.schemas.base import FileRecord
from needlefit.schemas.deciding import select_deciding
from needlefit.schemas.limits import MAX_EVALUATION_ELEMENT_SOLVES
from needlefit.schemas.origin import Origin
from needlefit.schemas.recipe import RecipeRecord
from needlefit.schemas.run_metadata import AnalysisMetadata
from needlefit.schemas.study import FitRecord, StudyRecord, TargetRecord
from needlefit.studies.fit_warnings import warn_of_doubts
from needlefit.studies.identity import describe_change, describe_configuration, has_data, identify
from needlefit.studies.job import Inputs, Job, Settings, metric_recipe
from needlefit.studies.kind import find_kind
from needlefit.studies.observations import STUDIED
from needlefit.studies.run import RUN_FILE, Run, name_source, read_sources, restore_run

PATH_KEYS = frozenset(["dataset", "medium", "recipe", "priors", "target", "fits", "studies"])
"""Keys of study files whose values may be paths, alone, in a list or a table."""


def read_study_table(path: Path) -> dict[str, Any]:
    """Return the keys of a study or fit, the paths in them relative to the working folder.

    In the file they are relative to its folder.
    """
    return {key: _rebase(key, value, path.parent) for key, value in read_toml(path).items()}


def _rebase(key: str, value: Any, folder: Path) -> Any:  # noqa: ANN401 - whatever the file holds
    if isinstance(value, str) and key in PATH_KEYS and is_path(value):
        # never absolute unless the file says so: it is kept with the results
        return value if Path(value).is_absolute() else f"./{Path(os.path.relpath(folder / value)).as_posix()}"
    if isinstance(value, list):
        return [_rebase(key, part, folder) for part in value]
    if isinstance(value, Mapping) and key not in ("tune", "validate"):  # there `medium` is a name in the data
        return {
            inner: _rebase(key if key == "priors" else inner, part, folder) for inner, part in value.items()
        }
    return value


def load_fit_file(path: Path) -> FitRecord:
    """Load the file of a fit; ConfigError if it does not hold what a fit wants."""
    return check(read_study_table(path), FitRecord, path)


def load_study_file(path: Path) -> FileRecord:
    """Load a study file and check it against the record of its kind.

    Raises ConfigError if it does not hold what a study of its kind wants.
    """
    table = read_study_table(path)
    with add_file_context(path):
        record = _record_type(table)
    return check(table, record, path)


def check_study(table: Mapping[str, Any], where: str) -> FileRecord:
    """Return the record of a study whose keys are given in memory; errors as of `load_study_file`."""
    plain: dict[str, Any] = {key: to_json_values(value) for key, value in table.items()}
    return check(plain, _record_type(plain), where)


def _record_type(table: Mapping[str, Any]) -> type[FileRecord]:
    return find_kind(table["kind"]).record if "kind" in table else StudyRecord


@dataclass(frozen=True)
class StudyCheck:
    """A study without faults."""

    kind: str  #: "fit", "cross-validation", or the kind that the file states
    #: insertions fitted to and held out, in each fold; empty of other kinds
    folds: tuple[tuple[int, int], ...] = ()
    warnings: tuple[ResultWarning, ...] = ()  #: about the data and the study
    origin: Origin = "measured"  #: of the data
    doubts: Doubts = field(default_factory=Doubts)  #: about its needles, of a quick fit; none of other kinds


@one_thread
def check_study_file(kind: Literal["study", "fit"], path: Path) -> StudyCheck:
    """Check a study or fit and everything that it names.

    Of a fit or a cross-validation all its data are read, and a quick fit judges its needles; of other kinds
    there must be the fit that they are about.

    Raises ConfigError, DataError if anything in it is missing or wrong.
    """
    record: FileRecord = load_fit_file(path) if kind == "fit" else load_study_file(path)
    with add_file_context(path):
        if not isinstance(record, FitRecord):
            if isinstance(record, TargetRecord):
                with add_key_context("target"):
                    load_target(record.target)
            return StudyCheck(str(record.kind))  # type: ignore[attr-defined]  # of every other kind
        job = load_study(path.stem, record, Settings(file=path))
    folds = tuple((len(fold.tune), len(fold.validate)) for fold in job.folds)
    named = "cross-validation" if isinstance(record, StudyRecord) else "fit"
    doubts = find_odd_needles(job)
    warnings = (*job.warnings, *warn_of_doubts(doubts))
    return StudyCheck(named, folds, warnings, job.dataset.origin, doubts)


class Target(NamedTuple):
    """A fit that a study is about: the name of its results, the fit, and the file that it stands in.

    Of a run, `inputs` are what it has stored of the fit.
    """

    name: str
    record: FitRecord
    inputs: Inputs
    file: Path
    run: Run | None = None

    @property
    def sources(self) -> list[str]:
        """The file that it stands in; of a run, the one of which that was made."""
        run_sources = [] if self.run is None else read_sources(self.run.timing, self.file.parent)
        return run_sources or [name_source(self.file)]


def load_target(target: str) -> Target:
    """Return the fit that a name, a path or the folder of a run means: what was fitted there.

    Of a study with several [[folds]], STUDY:NAME names one.

    Raises ConfigError if there is no such study or fit, or it does more than tune. DataError if a run is
    damaged, or its dataset is missing or was changed.
    """
    folder = Path(target)
    if is_file(folder / RUN_FILE) and not is_file(folder / DATASET_FILE):
        run = restore_run(folder)
        return Target(*reopen_fit(run, str(folder)), folder / RUN_FILE, run)
    study, _, wanted = ("", "", "") if is_file(Path(target)) else target.rpartition(":")
    kind, path = find_study_or_fit(study or target)
    record = load_fit_file(path) if kind == "fit" else load_study_file(path)
    if isinstance(record, StudyRecord) and record.folds:
        wanted = wanted if study else ""
        for fold in record.folds:
            if fold.name == wanted or (not wanted and len(record.folds) == 1):
                return Target(f"{path.stem}-{fold.name}-tune", record.tuning(fold), Inputs(), path)
        raise ConfigError(
            f"is a study of {len(record.folds)} fits" + (f", none of them {wanted}" if wanted else ""),
            where=path,
            expected=f"one of {', '.join(f'{path.stem}:{fold.name}' for fold in record.folds)}",
            fix="name the study and the fit, with a colon between them",
        )
    if study:
        find_study_or_fit(target)  # says that there is none of that name
    if kind == "fit" and isinstance(record, FitRecord):
        return Target(path.stem, record, Inputs(), path)
    if not isinstance(record, StudyRecord):
        raise ConfigError(
            "is a study that is not tuned by itself",
            where=path,
            fix=f"use: {shlex.join(('needlefit', 'validate', target))}",
        )
    return Target(f"{path.stem}-tune", record.tuning(), Inputs(), path)


def is_study(target: str) -> bool:
    """Return whether what was fitted is named by a study, which also holds insertions out."""
    return not is_file(Path(target) / RUN_FILE) and find_study_or_fit(target.partition(":")[0])[0] == "study"


def prepare_target(record: TargetRecord, settings: Settings, ending: str = "") -> Job:
    """Return the work of the fit that a record names; its name, which keys random numbers, has this `ending`.

    It takes the place of "-tune".
    """
    fit, file = settings.inputs.target, None
    if fit is None:
        loaded = load_target(record.target)
        fit, file = (loaded.name, loaded.record), loaded.file
        settings = settings if loaded.run is None else replace(settings, inputs=loaded.inputs)
    name, fit_record = fit
    with add_file_context(file):
        return load_study(name.removesuffix("-tune") + ending if ending else name, fit_record, settings)


def prepare_with_held_out(record: TargetRecord, name: str, settings: Settings) -> Job:
    """Return the work of the study that a record names, with what it holds out; of a fit, the fit's."""
    if settings.inputs.target is None and ":" not in record.target and is_study(record.target):
        _, path = find_study_or_fit(record.target)
        study = load_study_file(path)
        if isinstance(study, StudyRecord):
            with add_file_context(path):
                return load_study(name, study, replace(settings, file=path))
    return prepare_target(record, settings)


def begin_run(name: str, record: TargetRecord, job: Job, title: str) -> Run:
    """Return a run without frames: what it is about, and all that decides its result.

    Of a target that was named by an absolute path, the name alone is kept.
    """
    path = Path(record.target)
    target = path.stem if path.is_absolute() else record.target
    named = {"target": target, "title": record.title or title}
    stored = record.model_copy(update=named)
    metadata = describe_configuration(job).extend(
        AnalysisMetadata,
        study=stored.model_dump(mode="json", by_alias=True),
        fit=job.record.model_dump(mode="json", by_alias=True),
        identity=identify(job, select_deciding(stored, ("target", "scene_name", "posterior"))),
        warnings=to_stored_rows(job.warnings),
    )
    data = job.dataset
    timing = {"dataset": str(data.path)}
    return Run(str(record.kind), name, stored, data.origin, data.title or data.name, {}, metadata, timing)


# ---- the fit of a run: data, tissue model, recipe and posterior as they were, wherever its folder lies
#
# A run keeps a copy of its data, so that its folder can be moved alone. Where there is none, as of
# earlier versions and of large data, the dataset is looked for where it was, then by its name.


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


#: kinds of warnings that are also printed before the work, which takes long and is of no use then
DATA_WARNINGS = ("units", "bevel_side", "axis_unit", "data_changed")
_GUIDE_PARAMETER = "guide_distance_mm"


def choose_recipe(record: FitRecord, settings: Settings, dataset: Dataset) -> RecipeRecord:
    """Return the recipe of a study, as the settings and the noise of the data change it."""
    recipe = settings.inputs.recipe or load(find_named("recipe", record.recipe), RecipeRecord)
    if recipe.sample.sampler not in SAMPLERS:
        raise SAMPLERS.unknown_name_error(recipe.sample.sampler, key="sample.sampler")
    if settings.seed is not None:
        recipe = recipe.model_copy(update={"seed": settings.seed})
    if recipe.minimize == "posterior" and not dataset.noise_is_stated:
        recipe = metric_recipe(recipe)  # without noise a posterior has no width, and no peak
    return recipe


def load_study(name: str, record: FitRecord, settings: Settings) -> Job:
    """Load and check all that a study or fit names, but for what is given in memory.

    Raises ConfigError or DataError if anything it names is missing or wrong, the folds cannot be made, or an
    insertion cannot be fitted as the study states.
    """
    given, published = settings.inputs, record.paper_parameters
    measured = given.dataset or read(find_named("dataset", record.dataset))
    recipe = choose_recipe(record, settings, measured)
    medium, medium_file = (given.medium, None) if given.medium else load_changed_medium(record)
    with add_file_context(medium_file):
        stated = search_freed(Parameters.from_record(medium), medium, record.free)
    hand_tuned = None
    if published is not None:
        with add_key_context("paper_parameters"):
            hand_tuned = complete_published(published, read_hand_tuned(published), stated, record.medium)
    is_posterior = recipe.minimize == "posterior"
    parameters = with_hyperparameters(stated, recipe.likelihood) if is_posterior else without_prior(stated)

    folds = make_folds(record, measured)
    chosen = [insertion for fold in folds for insertion in (*fold.tune, *fold.validate)]
    with add_key_context("compared"):
        dataset = set_compared(measured, chosen, record.compared, medium.torsional_friction_n)
    folds = tuple(fold.of_dataset(dataset) for fold in folds)

    file = settings.file
    job = Job(
        name, record, dataset, medium, parameters, recipe, hand_tuned, folds, measured, file, medium_file
    )
    for studied in STUDIED.values():
        studied.check(job)
    _require_feasible(job)
    job = replace(job, warnings=tuple(_find_warnings(job)))
    if record.compared is None and (note := describe_compared(dataset)):
        settings.note(note)
    for warning in dict.fromkeys(job.warnings):  # what a user wants to know before the work, which takes long
        if warning.kind in DATA_WARNINGS:
            settings.note(f"warning: {warning} ({warning.help_command})")
    return job


def _find_warnings(job: Job) -> Iterator[ResultWarning]:
    """Yield what is suspicious about data, medium and folds, though the study can be run."""
    record, measured = job.record, job.measured
    yield from measured.warnings
    yield from medium_warnings(job.medium, job.medium_file or record.medium)
    ids = {insertion.id for insertion in job.insertions}
    chosen = [
        insertion for insertion in measured.insertions if insertion.id in ids
    ]  # before turns were projected
    yield from find_left_planes(measured, chosen, record.compared, job.place("compared"))
    if isinstance(record, StudyRecord) and not record.same_specimen:
        key = next(
            key_name for key_name in ("leave_out", "folds", "validate") if getattr(record, key_name, True)
        )
        yield from warn_shared_specimens(job.name, job.folds, job.place(key))


def _require_feasible(job: Job) -> None:
    """Refuse, before hours of work, insertions that medium or needle have no place for, or too many."""
    rules, total = mesh(job.medium), 0.0
    count = f"{job.medium.layers} layer{'s' if job.medium.layers > 1 else ''}"
    for insertion in job.insertions:
        if max(insertion.sequence) > job.medium.layers:
            raise ConfigError(
                f"medium {job.record.medium} has {count}, insertion {insertion.id} meets "
                f"layer {max(insertion.sequence)}",
                fix="name its medium, or select other insertions",
                key="medium",
            )
        stated = job.parameters.fixed.get(_GUIDE_PARAMETER, insertion.guide_distance or 0.0)
        _, guide = job.parameters.bounds.get(_GUIDE_PARAMETER, (0.0, stated))  # the farthest one
        length = insertion.needle.length
        if insertion.depth + guide >= length:
            raise ConfigError(
                f"insertion {insertion.id} is {insertion.depth:g} mm deep; with a guide {guide:g} mm before "
                f"the tissue the needle of {length:g} mm is too short",
                where=job.place_in_medium(f"parameters.{_GUIDE_PARAMETER}"),
                expected=f"below {length - insertion.depth:g} mm",
                fix="lessen the guide's distance or its upper bound",
            )
        try:
            check_size((insertion.depth,), rules)
        except ModelError as error:
            raise ConfigError(
                f"insertion {insertion.id}: {error.what}",
                where=job.place_in_medium("constraint_spacing_mm"),
                expected=error.expected,
                fix=error.fix,
            ) from None
        conditions = 1 + 2 * len(insertion.sequence) if job.recipe.likelihood.depths != "fixed" else 1
        total += conditions * count_element_solves((insertion.depth,), rules.spacing, rules.element)
    if total > MAX_EVALUATION_ELEMENT_SOLVES:  # a single evaluation would take a minute
        raise ConfigError(
            f"{len(job.insertions)} insertions are {total:.3g} elements to be solved for in one evaluation",
            where=job.place_in_medium("constraint_spacing_mm"),
            expected=f"at most {MAX_EVALUATION_ELEMENT_SOLVES:.3g}",
            fix="select fewer insertions, or take a larger constraint spacing",
        )


# ---- needles that the others do not predict


def find_odd_needles(job: Job, mode: Sequence[float] | None = None) -> Doubts:
    """Return the needles that any fold fits to, and the others of these do not predict.

    Those with values of another, or with constant ones, are left out. `mode` (P,): the most probable
    parameters of a fit; None: of a quick one.
    """
    named = {
        name
        for warning in job.dataset.warnings
        if warning.kind in ("copy", "axis_unit")
        for name in warning.insertions
    }
    problem = join_folds(job)
    others = tuple(insertion for insertion in problem.insertions if insertion.id not in named)
    sound = replace(problem, insertions=others or problem.insertions)
    return find_doubts(sound, None if mode is None else np.array(mode))


def join_folds(job: Job) -> Problem:
    """Return the problem of all insertions that any fold fits to."""
    fitted = {insertion.id: insertion for fold in job.folds for insertion in fold.tune}
    return job.problem(Fold("all", tuple(fitted.values()), ()))
