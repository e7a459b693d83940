"""Load a study or fit with everything that it names: dataset, medium, recipe, hand-tuned method and folds."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

from needlefit.datasets.dataset_warnings import is_copy
from needlefit.datasets.insertion import Dataset, Insertion
from needlefit.datasets.noise import NoiseFloor, estimate_noise_floor
from needlefit.datasets.planes import leaves_plane, set_planes
from needlefit.datasets.read import read
from needlefit.datasets.select import select_insertions
from needlefit.errors import ConfigError, ModelError
from needlefit.inference.forward_model import make_options as mesh
from needlefit.inference.likelihood.observation import require_curvature
from needlefit.inference.parameter_changes import change_parameters
from needlefit.inference.parameters import (
    Parameters,
    state_usual_bounds,
    with_hyperparameters,
    without_bevel_spread,
    without_prior,
)
from needlefit.inference.problem import Problem
from needlefit.inference.sampling.posterior import Posterior
from needlefit.mechanics.plan import check_size, count_element_solves
from needlefit.project.json_values import to_json_values
from needlefit.project.locate import FileKind, find_file, join_names
from needlefit.project.progress import Note, Progress, Stop, never_stop, no_note, no_progress
from needlefit.project.random_streams import random_stream
from needlefit.project.result_warnings import ResultWarning
from needlefit.project.tasks import LocalPool, TaskPool, stop_requested, threads_of_task
from needlefit.project.toml import add_file_context, add_key_context, check, load, locate_key
from needlefit.project.unit_warnings import medium_warnings
from needlefit.reporting import paper
from needlefit.schemas.limits import MAX_EVALUATION_ELEMENT_SOLVES
from needlefit.schemas.medium import MaterialRecord, MediumRecord, ParameterRecord, spell_parameter
from needlefit.schemas.recipe import RecipeRecord
from needlefit.schemas.study import FitRecord, StudyRecord

MAX_NAMED_SPECIMENS = 8  #: specimens that a warning names


@dataclass(frozen=True)
class Fold:
    """One fold: the insertions fitted to and those scored."""

    name: str
    tune: tuple[Insertion, ...]
    validate: tuple[Insertion, ...]


def make_folds(record: FitRecord | StudyRecord, dataset: Dataset) -> tuple[Fold, ...]:
    """Return the folds of a study, or the single fold of a fit, which scores nothing.

    Raises ConfigError if a selection matches nothing, an insertion or a copy of it stands on both sides, or
    there is nothing to leave out.
    """
    tune = select_insertions(dataset, record.tune, record.layer_count_rule)
    if not isinstance(record, StudyRecord):
        return (Fold("all", tune, ()),)
    if record.leave_out is not None:
        return tuple(map(_require_no_copies, leave_out(tune, record.leave_out)))
    validate: dict[str, Insertion] = {}
    for n, selection in enumerate(record.validate_, start=1):
        chosen = select_insertions(dataset, selection, record.layer_count_rule, f"validate.{n}")
        validate |= {insertion.id: insertion for insertion in chosen}
    both = sorted(validate.keys() & {insertion.id for insertion in tune})
    if both:
        raise ConfigError(
            f"{', '.join(both)} would both tune and validate",
            expected="insertions on one side only",
            fix="narrow [tune] or [[validate]]",
            key="validate",
        )
    return (_require_no_copies(Fold("all", tune, tuple(validate.values()))),)


def _require_no_copies(fold: Fold) -> Fold:
    """Return a fold; ConfigError if it holds out a copy of an insertion fitted to: it tests nothing."""
    pairs = ((one, other) for one in fold.validate for other in fold.tune if is_copy(one, other))
    if found := next(pairs, None):
        one, other = found
        raise ConfigError(
            f"{one.id} is held out, and is a copy of {other.id}, which is fitted to",
            expected="an insertion of its own: errors on a copy are those of the fit",
            fix=f"remove {one.id} from the dataset, or restore its own file",
            key="validate",
        )
    return fold


def warn_shared_specimens(name: str, folds: Iterable[Fold], where: str = "") -> list[ResultWarning]:
    """Return a warning if held-out insertions share specimens with those fitted to.

    Such a study says how well a model knows the specimens that it was fitted to, not others.
    """
    shared: dict[str, None] = {}
    for fold in folds:
        held = {one.specimen for one in fold.validate}
        shared |= dict.fromkeys(one.specimen for one in fold.tune if one.specimen in held)
    if not shared:
        return []
    named = join_names(list(shared), MAX_NAMED_SPECIMENS)
    what = f"insertions into a specimen are fitted to and held out ({named}): errors in new specimens may "
    fix = "hold out whole specimens, or write same_specimen = true in the study if it is meant"
    return [ResultWarning("same_specimen", f"{what}be larger", where or f"study {name}", fix)]


def leave_out(insertions: tuple[Insertion, ...], what: str) -> tuple[Fold, ...]:
    """Return one fold for each "insertion" or "specimen", which it leaves out.

    Raises ConfigError if there is only one.
    """
    held = group_insertions(insertions, what)
    if len(held) < 2:
        within = what == "specimen" and len(insertions) > 1
        raise ConfigError(
            f"there is only one {what}: none can be left out",
            expected=f"insertions into two {what}s or more" if within else f"two {what}s or more",
            fix='write leave_out = "insertion" and same_specimen = true to predict insertions into this '
            "specimen, or add insertions into another one"
            if within
            else "select more insertions",
            key="leave_out",
        )
    return tuple(
        Fold(f"without {name}", tuple(i for i in insertions if i not in members), members)
        for name, members in held.items()
    )


def group_insertions(insertions: tuple[Insertion, ...], what: str) -> dict[str, tuple[Insertion, ...]]:
    """Group the insertions by "specimen", or each "insertion" by itself, in their order."""
    names = [insertion.specimen if what == "specimen" else insertion.id for insertion in insertions]
    return {
        name: tuple(i for i, own in zip(insertions, names, strict=True) if own == name)
        for name in dict.fromkeys(names)
    }


_GUIDE_PARAMETER = "guide_distance_mm"

#: noise floors of insertions that are in use, by what else they depend on
_floors: WeakKeyDictionary[Insertion, dict[object, NoiseFloor]] = WeakKeyDictionary()


@dataclass(frozen=True)
class Inputs:
    """What a program has in memory; it takes the place of the files that the study file of one fit names."""

    #: the name of the results of the fit that a study is about, and the fit
    target: tuple[str, FitRecord] | None = None
    #: dataset, medium, recipe: of the fit; the medium has its priors
    dataset: Dataset | None = None
    medium: MediumRecord | None = None
    recipe: RecipeRecord | None = None
    posterior: Posterior | None = None  #: that was sampled of the target
    judged: Any = None  #: the `Run` of the target whose verdict a prediction repeats


#: kinds of warnings that are also printed before the work, which takes long and is of no use then
DATA_WARNINGS = ("units", "bevel_side", "axis_unit", "common_pose", "data_changed")


@dataclass(frozen=True)
class Settings:
    """How a run is executed; only `seed`, `sample` and `inputs` change its result.

    In another process it has these, and of the rest what that process has: its request to stop, its threads.
    """

    seed: int | None = None  #: replaces the recipe's
    jobs: int = 1  #: threads of a fit, or processes where the work falls into tasks
    pool: TaskPool | None = None  #: where tasks run; None: in processes of this machine
    checkpoint: Path | None = None  #: folder that keeps finished starts
    resume: bool = False  #: go on from the checkpoint
    sample: bool = False  #: also sample the posterior
    progress: Progress = no_progress  #: called with a label, what is done, and of how much
    stop: Stop = never_stop  #: asked often; True ends the run early, marked `interrupted`
    first: Note = no_note  #: given the first finding in one line, long before the run ends
    note: Note = no_note  #: given a line about what was damaged in the checkpoint
    file: Path | None = None  #: the study's, which warnings about it name
    inputs: Inputs = Inputs()  #: what is not read from files

    def place(self, key: str) -> str:
        """Return the name of a key of the study's file for messages; "" where it is not known."""
        return "" if self.file is None else locate_key(self.file, key)

    def task_pool(self) -> TaskPool:
        return self.pool or LocalPool(self.jobs)

    def __reduce__(self) -> tuple[Callable[..., "Settings"], tuple[object, ...]]:
        return _settings_of_task, (self.seed, self.sample, self.file, self.inputs)


def _settings_of_task(seed: int | None, sample: bool, file: Path | None, inputs: Inputs) -> Settings:
    """Return the settings of a task in a process of a pool."""
    return Settings(
        seed=seed, jobs=threads_of_task(), sample=sample, stop=stop_requested, file=file, inputs=inputs
    )


@dataclass(frozen=True)
class Job:
    """What a fit works on: data, model, parameters, settings; `warnings` are about the data.

    `medium_file` is None where the medium was given in memory.
    """

    name: str
    record: FitRecord | StudyRecord
    dataset: Dataset
    medium: MediumRecord
    parameters: Parameters
    recipe: RecipeRecord
    hand_tuned: Mapping[str, float] | None
    folds: tuple[Fold, ...]
    warnings: tuple[ResultWarning, ...] = ()
    medium_file: Path | None = None

    def place_in_medium(self, key: str) -> str:
        """Return how messages name a key of the medium."""
        return key if self.medium_file is None else locate_key(self.medium_file, key)

    @property
    def searches(self) -> tuple[str, ...]:
        """The searches of one fold; the first is the fit that everything else is about."""
        metric = self.recipe.metric and self.recipe.minimize == "posterior"
        bevel = self.hand_tuned is not None and "bevel_mm" in self.parameters.free
        return ("fitted", *(["fitted_metric"] * metric), *(["hand_tuned_b"] * bevel))

    def recipe_of(self, search: str) -> RecipeRecord:
        """Return the recipe of one search; all minimise the same, except the one named after the metric."""
        return metric_recipe(self.recipe) if search == "fitted_metric" else self.recipe

    @property
    def insertions(self) -> tuple[Insertion, ...]:
        """Every insertion that is fitted to or scored in any fold, once."""
        found = {i.id: i for fold in self.folds for i in (*fold.tune, *fold.validate)}
        return tuple(found.values())

    def floor(self, insertion: Insertion) -> NoiseFloor:
        """Return the noise floor of an insertion; it is estimated once for all studies of a command."""
        seed, data, known = self.recipe.seed, self.dataset, _floors.setdefault(insertion, {})
        key = (seed, data.noise, data.pose, data.drop_proximal)
        if key not in known:
            known[key] = estimate_noise_floor(
                data, insertion, random_stream(seed, "noise floor", insertion.id)
            )
        return known[key]

    def problem(self, fold: Fold, search: str = "fitted") -> Problem:
        """Return the problem of one search of a fold: all parameters free, or the paper's bevel alone."""
        everything = Problem(
            self.dataset,
            fold.tune,
            self.medium,
            self.parameters,
            self.recipe.weights,
            likelihood=self.recipe.likelihood,
        )
        if search == "hand_tuned_b" and self.hand_tuned is not None:
            one_bevel = without_bevel_spread(self.parameters)
            return everything.with_parameters(one_bevel.with_only(("bevel_mm",), self.hand_tuned))
        if self.recipe_of(search).minimize == "metric":
            return everything.with_parameters(without_prior(self.parameters))
        return everything


def metric_recipe(recipe: RecipeRecord) -> RecipeRecord:
    """Return the recipe that minimises the metric objective instead of the posterior."""
    return recipe.model_copy(update={"minimize": "metric"})


def prepare(
    name: str, record: FitRecord | StudyRecord, settings: Settings, dataset: Dataset | None = None
) -> Job:
    """Load and check everything that a study or fit names; `dataset`, if given, replaces its own.

    Raises ConfigError or DataError if anything it names is missing or wrong.
    """
    given = settings.inputs
    dataset = dataset or given.dataset or read(find_named("dataset", record.dataset))
    medium, medium_file = (given.medium, None) if given.medium else load_medium(record)
    recipe = given.recipe or load(find_named("recipe", record.recipe), RecipeRecord)
    if settings.seed is not None:
        recipe = recipe.model_copy(update={"seed": settings.seed})
    if recipe.minimize == "posterior" and not dataset.noise.stated:
        recipe = metric_recipe(recipe)  # without noise a posterior has no width, and no peak
    with nullcontext() if medium_file is None else add_file_context(medium_file):
        stated = Parameters.from_record(medium)
    with add_key_context("paper_parameters"):
        hand = (
            None
            if record.paper_parameters is None
            else paper.hand_tuned_set(record.paper_parameters, stated, record.medium)
        )
    if recipe.minimize == "posterior":
        parameters = with_hyperparameters(stated, recipe.likelihood)
    else:
        parameters = without_prior(stated)
    divided = make_folds(record, dataset)
    with add_key_context("planes"):
        everything = [one for fold in divided for one in (*fold.tune, *fold.validate)]
        planes = record.planes
        if medium.torsional_friction_n and any(one.turns for one in everything):
            planes = 2  # while the tip follows the hub even a half turn bends it to the side
            if record.planes == 1:
                why = "torsional friction leads needles that were turned out of their planes"
                raise ConfigError(why, expected="2, or no torsional_friction_n of the medium")
        flattened = everything if planes == 1 and dataset.pose == "known" else []
        left = sorted({one.id for one in flattened if leaves_plane(one, dataset.noise)})
        dataset = set_planes(dataset, everything, planes)
    divided = make_folds(record, dataset)
    doubtful = dataset.pose == "known" and "bevel_plane" in {one.kind for one in dataset.warnings}
    if record.planes is None and (doubtful or dataset.planes == 2):
        settings.note(
            "needles are fitted in space, since some leave their planes (`planes = 1`: in one plane)"
            if dataset.planes == 2
            else "needles are fitted in one plane: errors explain what is out of it (`planes = 2`: in space)"
        )
    warnings = [*dataset.warnings, *medium_warnings(medium, medium_file or record.medium)]
    if left:
        what = f"compared in the plane of their bevels, which they leave: {join_names(left, 8)}"
        if any(one.curvature is not None for one in everything):
            what += ", and by their curvatures along y alone"
        fix = "leave `planes` out, or state 2: needles are then simulated and compared in space"
        warnings.append(ResultWarning("bevel_plane", what, settings.place("planes"), fix))
    if isinstance(record, StudyRecord) and not record.same_specimen:
        key = "validate" if record.leave_out is None else "leave_out"
        warnings += warn_shared_specimens(name, divided, settings.place(key))
    job = Job(name, record, dataset, medium, parameters, recipe, hand, divided, tuple(warnings), medium_file)
    _check_layers(job)
    if job.recipe.likelihood.measurement == "curvature":
        for insertion in (each for fold in job.folds for each in fold.tune):
            require_curvature(insertion)
    check_reach(job)
    _check_size(job)
    for one in dict.fromkeys(job.warnings):
        if one.kind in DATA_WARNINGS:
            settings.note(f"warning: {one}")
    return job


def find_named(key: FileKind, name: str) -> Path:
    """Return the file that a study names under `key`; the key is also the kind of file."""
    with add_key_context(key):
        return find_file(key, name)


def load_medium(record: FitRecord | StudyRecord) -> tuple[MediumRecord, Path]:
    """Return the medium that a fit names, with its priors and what it frees and fixes, and its file."""
    file = find_named("medium", record.medium)
    medium = set_priors(load(file, MediumRecord), record.priors)
    with add_file_context(file):
        Parameters.from_record(medium)  # faults of the medium itself, before those of the changes
    return change_parameters(medium, record.free, record.fix), file


def change_fit(record: FitRecord, free: Sequence[str], fix: Mapping[str, float], where: str) -> FitRecord:
    """Return a fit that also estimates the parameters `free`, and holds those in `fix` (Pa, mm, degrees).

    They take the place of what the fit itself frees and fixes. `where` is what messages name.

    Raises ConfigError if a name is in both.
    """
    names = [spell_parameter(name) for name in free]
    values = {spell_parameter(name): value for name, value in fix.items()}
    changes: dict[str, Any] = {
        "free": [*(name for name in record.free if name not in values), *names],
        "fix": to_json_values({n: at for n, at in record.fix.items() if n not in names} | values),
    }
    return check(record.model_dump(mode="json", by_alias=True) | changes, type(record), where)


def set_priors(medium: MediumRecord, priors: Mapping[str, str]) -> MediumRecord:
    """Return the medium, its layers with the priors of the files that a fit names."""
    for layer, path in priors.items():
        material = load(Path(path), MaterialRecord)
        with add_key_context(f"priors.{layer}"):
            medium = set_material_prior(medium, layer, material)
    return medium


#: a fixed alpha that a test identifies becomes free within this many standard deviations
ALPHA_REACH_SD = 4.0
TEST_LAW = "ogden"  #: the law that alpha and mu of a compression test belong to


def set_material_prior(medium: MediumRecord, layer: str, material: MaterialRecord) -> MediumRecord:
    """Return the medium with the prior of a compression test on one layer.

    An alpha that the medium fixes becomes free within `ALPHA_REACH_SD` standard deviations of its prior's
    mean.

    Raises ConfigError if there is no such layer, the medium's law is another one, or the layer's parameter is
    tied or fixed.
    """
    if layer not in {str(number) for number in range(1, medium.layers + 1)}:
        raise ConfigError(f"there is no layer `{layer}`", expected=f"a number from 1 to {medium.layers}")
    if medium.law != TEST_LAW:
        raise ConfigError(
            f"the medium's law is `{medium.law}`", expected=f"`{TEST_LAW}`: the prior is of its alpha"
        )
    table = state_usual_bounds(medium) | medium.parameters
    for name, stated in ((f"mu{layer}_pa", material.mu_pa), (f"alpha{layer}", material.alpha)):
        if stated is None or name not in table:
            continue
        bounds, tie = table[name].bounds, table[name].tie
        if bounds is None and tie is None and stated.mean is not None and stated.sd is not None:
            bounds = (stated.mean - ALPHA_REACH_SD * stated.sd, stated.mean + ALPHA_REACH_SD * stated.sd)
        if bounds is None:
            fix = "give it bounds" + (", or the prior to the layer that it is tied to" if tie else "")
            state = "tied" if tie else "fixed"
            raise ConfigError(f"a prior is stated for {name}, which is {state}", fix=fix)
        table[name] = ParameterRecord(bounds=bounds, prior=stated)
    return medium.model_copy(update={"parameters": table})


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


def check_reach(job: Job) -> None:
    """Refuse, before hours of work, a needle too short for the deepest insertion and the farthest guide."""
    for insertion in job.insertions:
        stated = job.parameters.fixed.get(_GUIDE_PARAMETER, insertion.guide_distance or 0.0)
        _, guide = job.parameters.bounds.get(_GUIDE_PARAMETER, (0.0, stated))
        length = insertion.needle.length
        if insertion.depth + guide >= length:
            raise ConfigError(
                f"insertion {insertion.id} is {insertion.depth:g} mm deep; with a guide {guide:g} mm before "
                f"the tissue the needle of {length:g} mm is too short",
                where=job.place_in_medium(f"parameters.{_GUIDE_PARAMETER}"),
                expected=f"below {length - insertion.depth:g} mm",
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
                where=job.place_in_medium("constraint_spacing_mm"),
                expected=error.expected,
                fix=error.fix,
            ) from None
        conditions = 1 + 2 * len(insertion.sequence) if job.recipe.likelihood.depths != "fixed" else 1
        total += conditions * count_element_solves((insertion.depth,), rules.spacing, rules.element)
    if total > MAX_EVALUATION_ELEMENT_SOLVES:
        raise ConfigError(
            f"{len(job.insertions)} insertions are {total:.3g} elements to be solved for in one evaluation",
            where=job.place_in_medium("constraint_spacing_mm"),
            expected=f"at most {MAX_EVALUATION_ELEMENT_SOLVES:.3g}",
            fix="select fewer insertions, or take a larger constraint spacing",
        )
