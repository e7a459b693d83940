"""Load a study or fit with everything that it names: dataset, medium, recipe, hand-tuned method and folds."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from needlefit.datasets.insertion import Dataset, Insertion
from needlefit.datasets.noise import NoiseFloor, estimate_noise_floor
from needlefit.datasets.read import read
from needlefit.errors import ConfigError, ModelError
from needlefit.inference.forward_model import make_options as mesh
from needlefit.inference.material import set_material_prior
from needlefit.inference.parameters import Parameters, with_noise_scale
from needlefit.inference.problem import Problem
from needlefit.inference.ties import NOISE_SCALE
from needlefit.mechanics.insertion_limits import check_size, count_element_solves
from needlefit.project.load import load
from needlefit.project.locate import FileKind, find_file
from needlefit.project.progress import Note, Progress, Stop, never_stop, no_note, no_progress
from needlefit.project.random_streams import random_stream
from needlefit.project.result_warnings import ResultWarning
from needlefit.project.toml_lines import add_file_context, add_key_context, locate_key
from needlefit.project.unit_warnings import medium_warnings
from needlefit.schemas.limits import MAX_EVALUATION_ELEMENT_SOLVES
from needlefit.schemas.medium import MaterialRecord, MediumRecord
from needlefit.schemas.recipe import RecipeRecord
from needlefit.schemas.study import FitRecord, StudyRecord
from needlefit.validation import paper
from needlefit.validation.folds import Fold, make_folds, warn_shared_specimens

_GUIDE_PARAMETER = "guide_distance_mm"


@dataclass(frozen=True)
class Settings:
    """How a run is executed; only `seed` and `sample` change its result.

    Attributes
    ----------
    seed : int or None
        Replaces the recipe's.
    jobs : int
        Threads.
    checkpoint : Path or None
        Folder that keeps finished starts.
    resume : bool
        Go on from the checkpoint.
    sample : bool
        Also sample the posterior.
    progress : callable
        Called with a label, what is done, and of how much.
    stop : callable
        Asked often; True ends the run early, marked `interrupted`.
    note : callable
        Given a line about what was damaged in the checkpoint.
    file : Path or None
        The study's, which warnings about it name.
    """

    seed: int | None = None
    jobs: int = 1
    checkpoint: Path | None = None
    resume: bool = False
    sample: bool = False
    progress: Progress = no_progress
    stop: Stop = never_stop
    note: Note = no_note
    file: Path | None = None

    def place(self, key: str) -> str:
        """Return the name of a key of the study's file for messages; "" where it is not known."""
        return "" if self.file is None else locate_key(self.file, key)


@dataclass(frozen=True)
class Job:
    """The data that `validation.run` works on; `warnings` are about its data and their selection."""

    name: str
    record: FitRecord | StudyRecord
    dataset: Dataset
    medium: MediumRecord
    parameters: Parameters
    recipe: RecipeRecord
    hand_tuned: Mapping[str, float] | None
    folds: tuple[Fold, ...]
    warnings: tuple[ResultWarning, ...] = ()

    @property
    def searches(self) -> tuple[str, ...]:
        """The searches of one fold; the first is the fit that everything else is about."""
        metric = self.recipe.metric and self.recipe.minimize == "posterior"
        return (
            "fitted",
            *(("fitted_metric",) if metric else ()),
            *(
                ("hand_tuned_b",)
                if self.hand_tuned is not None and "bevel_mm" in self.parameters.free
                else ()
            ),
        )

    def recipe_of(self, search: str) -> RecipeRecord:
        """Return the recipe of one search; all minimise the same, except the one named after the metric."""
        return metric_recipe(self.recipe) if search == "fitted_metric" else self.recipe

    @property
    def insertions(self) -> tuple[Insertion, ...]:
        """Every insertion that is fitted to or scored in any fold, once."""
        found = {i.id: i for fold in self.folds for i in (*fold.tune, *fold.validate)}
        return tuple(found.values())

    def floor(self, insertion: Insertion) -> NoiseFloor:
        """Return the noise floor of an insertion."""
        return estimate_noise_floor(
            self.dataset, insertion, random_stream(self.recipe.seed, "noise floor", insertion.id)
        )

    def problem(self, fold: Fold, search: str = "fitted") -> Problem:
        """Return the problem of one search of a fold: all parameters free, or the bevel of the paper's
        set.
        """
        everything = Problem(
            self.dataset,
            fold.tune,
            self.medium,
            self.parameters,
            self.recipe.weights,
            likelihood=self.recipe.likelihood,
        )
        if search == "hand_tuned_b" and self.hand_tuned is not None:
            return everything.with_parameters(self.parameters.with_only(("bevel_mm",), self.hand_tuned))
        if NOISE_SCALE in everything.names and self.recipe_of(search).minimize == "metric":
            others = [name for name in everything.names if name != NOISE_SCALE]  # no error depends on it
            return everything.with_parameters(self.parameters.with_only(others, {NOISE_SCALE: 1.0}))
        return everything


def metric_recipe(recipe: RecipeRecord) -> RecipeRecord:
    """Return the recipe that minimises the metric objective instead of the posterior."""
    return recipe.model_copy(update={"minimize": "metric", "algorithm": recipe.metric_algorithm})


def prepare(
    name: str, record: FitRecord | StudyRecord, settings: Settings, dataset: Dataset | None = None
) -> Job:
    """Load and check everything that a study or fit names; `dataset`, if given, replaces its own.

    Raises
    ------
    ConfigError, DataError
        If anything it names is missing or wrong.
    """
    dataset = read(find_named("dataset", record.dataset)) if dataset is None else dataset
    medium_file = find_named("medium", record.medium)
    medium = _load_medium(record, medium_file)
    recipe = load(find_named("recipe", record.recipe), RecipeRecord)
    if settings.seed is not None:
        recipe = recipe.model_copy(update={"seed": settings.seed})
    if recipe.minimize == "posterior" and not dataset.noise.stated:
        recipe = metric_recipe(recipe)  # without noise a posterior has no width, and no peak
    with add_file_context(medium_file):
        parameters = Parameters.from_record(medium)
    with add_key_context("paper_parameters"):
        hand = (
            None
            if record.paper_parameters is None
            else hand_tuned_set(record.paper_parameters, parameters, record.medium)
        )
    if recipe.likelihood.noise_scale == "estimated":
        parameters = with_noise_scale(parameters)
        hand = None if hand is None else {**hand, NOISE_SCALE: 1.0}
    divided = make_folds(record, dataset)
    warnings = [*dataset.warnings, *medium_warnings(medium, medium_file)]
    if isinstance(record, StudyRecord) and not record.same_specimen:
        key = "validate" if record.leave_out is None else "leave_out"
        warnings += warn_shared_specimens(name, divided, settings.place(key))
    job = Job(name, record, dataset, medium, parameters, recipe, hand, divided, tuple(warnings))
    _check_layers(job)
    _check_reach(job)
    _check_size(job)
    return job


def find_named(key: FileKind, name: str) -> Path:
    """Return the file that a study names under `key`; the key is also the kind of file."""
    with add_key_context(key):
        return find_file(key, name)


def _load_medium(record: FitRecord | StudyRecord, file: Path) -> MediumRecord:
    """Return the medium, its layers with the priors that the fit names."""
    medium = load(file, MediumRecord)
    for layer, path in record.priors.items():
        material = load(Path(path), MaterialRecord)
        with add_key_context(f"priors.{layer}"):
            medium = set_material_prior(medium, layer, material)
    return medium


def _in_medium(job: Job, key: str) -> str:
    """Return how messages name a key of the medium's file."""
    return locate_key(find_file("medium", job.record.medium), key)


def _check_layers(job: Job) -> None:
    """Refuse a medium with fewer layers than an insertion meets."""
    count = f"{job.medium.layers} layer{'s' if job.medium.layers > 1 else ''}"
    for insertion in job.insertions:
        if max(insertion.sequence) > job.medium.layers:
            raise ConfigError(
                f"medium {job.record.medium} has {count}, insertion {insertion.id} meets "
                f"layer {max(insertion.sequence)}",
                fix="name the medium that the needle went into, or select other insertions",
                key="medium",
            )


def farthest_guide(parameters: Parameters, insertion: Insertion) -> float:
    """Return the largest distance, mm, before the tissue at which a guide can hold the needle; 0 without
    one.
    """
    if _GUIDE_PARAMETER in parameters.bounds:
        return parameters.bounds[_GUIDE_PARAMETER][1]
    return parameters.fixed.get(_GUIDE_PARAMETER, insertion.guide_distance or 0.0)


def _check_reach(job: Job) -> None:
    """Refuse, before hours of work, a needle too short for the deepest insertion and the farthest guide."""
    for insertion in job.insertions:
        guide = farthest_guide(job.parameters, insertion)
        if insertion.depth + guide >= job.dataset.needle.length:
            raise ConfigError(
                f"insertion {insertion.id} is {insertion.depth:g} mm deep; with a guide {guide:g} mm before "
                f"the tissue the needle of {job.dataset.needle.length:g} mm is too short",
                where=_in_medium(job, f"parameters.{_GUIDE_PARAMETER}"),
                expected=f"below {job.dataset.needle.length - insertion.depth:g} mm",
                fix="lessen the guide's distance or its upper bound",
            )


def _check_size(job: Job) -> None:
    """Refuse, before hours of work, insertions of which a single evaluation would take a minute."""
    rules, total = mesh(job.medium), 0.0
    for insertion in job.insertions:
        try:
            check_size((insertion.depth,), rules)
        except ModelError as error:
            raise ConfigError(
                f"insertion {insertion.id}: {error.what}",
                where=_in_medium(job, "constraint_spacing_mm"),
                expected=error.expected,
                fix=error.fix,
            ) from None
        conditions = 1 + 2 * len(insertion.sequence) if job.recipe.likelihood.depths != "fixed" else 1
        total += conditions * count_element_solves((insertion.depth,), rules.spacing, rules.element)
    if total > MAX_EVALUATION_ELEMENT_SOLVES:
        raise ConfigError(
            f"{len(job.insertions)} insertions are {total:.3g} elements to be solved for in one evaluation",
            where=_in_medium(job, "constraint_spacing_mm"),
            expected=f"at most {MAX_EVALUATION_ELEMENT_SOLVES:.3g}",
            fix="select fewer insertions, or take a larger constraint spacing",
        )


def hand_tuned_set(name: str, parameters: Parameters, medium: str) -> dict[str, float]:
    """Return the paper's set, completed by what the medium fixes; ConfigError if its layers differ."""
    published = {**parameters.fixed, **paper.read_hand_tuned(name)}
    missing = [p for p in parameters.names if p not in published]
    if missing:
        raise ConfigError(
            f"the paper's set `{name}` has no {', '.join(missing)}, which medium `{medium}` needs",
            fix="name a set of the same layers, or leave paper_parameters out",
        )
    return {p: published[p] for p in parameters.names}
