"""Load a study or fit: files, parameters, folds; refuse, before hours of work, what cannot be fitted."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from needlefit.datasets.compared import describe_compared, find_left_planes, set_compared
from needlefit.datasets.folds import Fold, make_folds, warn_shared_specimens
from needlefit.datasets.insertion import Dataset
from needlefit.datasets.paper import read_hand_tuned
from needlefit.datasets.read import read
from needlefit.errors import ConfigError, ModelError
from needlefit.inference.doubts import Doubts, find_doubts
from needlefit.inference.forward_model import make_options as mesh
from needlefit.inference.parameter_changes import complete_published, load_changed_medium, search_freed
from needlefit.inference.parameters import Parameters, with_hyperparameters, without_prior
from needlefit.inference.problem import Problem
from needlefit.inference.sampling.samplers import SAMPLERS
from needlefit.mechanics.plan import check_size, count_element_solves
from needlefit.project.result_warnings import ResultWarning
from needlefit.project.toml import add_file_context, add_key_context, find_named, load
from needlefit.project.unit_warnings import medium_warnings
from needlefit.schemas.limits import MAX_EVALUATION_ELEMENT_SOLVES
from needlefit.schemas.recipe import RecipeRecord
from needlefit.schemas.study import FitRecord, StudyRecord
from needlefit.studies.job import Job, Settings, metric_recipe
from needlefit.studies.observations import STUDIED

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
